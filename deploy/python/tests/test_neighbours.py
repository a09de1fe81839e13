"""What `metamorph export` writes, read by the examples of docs/neighbours.md with the libraries that they name."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
from collections import Counter
from pathlib import Path

import pytest
from metamorph import _program

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = re.findall(r"```(?:python|cpp)\n(.*?)```", (ROOT / "docs" / "neighbours.md").read_text(), re.DOTALL)


def export(directory: Path, *words: str) -> None:
    """Exports a run in which one module dies and another is stopped for a time."""
    journal = directory / "run.journal"
    if not journal.exists():
        faults = ["--kill", "3@1s", "--pause", "7@1s..3s"]
        run = ["run", "swarm", "--link", "sim", "--quiet", *faults, "--journal", str(journal)]
        subprocess.run([_program.find(), *run], check=True)
    subprocess.run([_program.find(), "export", str(journal), *words], check=True, cwd=directory, capture_output=True)


def example(library: str) -> str:
    (found,) = [text for text in EXAMPLES if library in text]
    return found


def test_a_recording_is_read_with_the_messages_of_ros_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder")
    reader = pytest.importorskip("mcap.reader")
    export(tmp_path, "--mcap", "run.mcap", "--schema", "ros2")
    monkeypatch.chdir(tmp_path)
    exec(compile(example("mcap_ros2"), "neighbours.md", "exec"), {})
    said = capsys.readouterr().out.splitlines()
    assert [line.split(" ", 1)[1] for line in said] == ["module_3 dead", "module_7 paused", "module_41 dead", "module_7 alive"]
    with open("run.mcap", "rb") as file:
        decoded = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()]).iter_decoded_messages()
        messages = [(channel.topic, message) for _, channel, _, message in decoded]
    topics = Counter(topic for topic, _ in messages)
    assert topics["/modules"] == topics["/tf"] > 10 and topics["/diagnostics"] == 4 and topics["/rosout"] >= 4
    last = [message for topic, message in messages if topic == "/modules"][-1]
    assert len({marker.ns for marker in last.markers}) == 42
    frames = [message for topic, message in messages if topic == "/tf"][-1].transforms
    places = {f.child_frame_id: (f.transform.translation.x, f.transform.translation.z) for f in frames}
    assert {(m.ns, m.pose.position.x, m.pose.position.z) for m in last.markers} == {(n, *p) for n, p in places.items()}
    cloud = [message for topic, message in messages if topic == "/cloud"][-1]
    assert (cloud.width, cloud.height, len(cloud.data)) == (42, 1, cloud.row_step)
    points = [struct.unpack_from("<fffII", bytes(cloud.data), i * cloud.point_step) for i in range(42)]
    assert {(f"module_{n}", round(x, 3), round(z, 3)) for x, _, z, _, n in points} == {(n, *p) for n, p in places.items()}


def test_rerun_draws_the_recording(tmp_path: Path) -> None:
    program = shutil.which("rerun")
    if not program:
        pytest.skip("rerun is not installed (pip install rerun-sdk)")
    export(tmp_path, "--mcap", "run.mcap", "--schema", "ros2")
    subprocess.run([program, "mcap", "convert", "run.mcap", "-o", "run.rrd"], check=True, cwd=tmp_path)
    said = subprocess.run([program, "rrd", "print", "run.rrd"], check=True, cwd=tmp_path, capture_output=True, text=True).stdout
    assert re.search(r"/cloud .*Points3D:positions", said) and re.search(r"/tf .*Transform3D:translation", said)


def test_a_structure_is_read_as_urdf(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("yourdfpy")
    export(tmp_path, "--at", "50%", "--urdf", "half.urdf")
    monkeypatch.chdir(tmp_path)
    exec(compile(example("yourdfpy"), "neighbours.md", "exec"), {})
    assert capsys.readouterr().out.startswith("43 ")


def test_the_parser_of_gazebo_reads_the_structure(tmp_path: Path) -> None:
    package = ["pkg-config", "--cflags", "--libs", "sdformat12"]
    if not shutil.which("pkg-config") or subprocess.run(package, capture_output=True).returncode:
        pytest.skip("libsdformat-dev is not installed")
    flags = subprocess.run(package, check=True, capture_output=True, text=True).stdout.split()
    export(tmp_path, "--sdf", "end.sdf", "--mass", "0.2")
    (tmp_path / "read.cpp").write_text(example("sdf::Root"))
    subprocess.run(["c++", "-std=c++17", "read.cpp", *flags, "-o", "read"], check=True, cwd=tmp_path)
    said = subprocess.run(["./read"], check=True, cwd=tmp_path, capture_output=True, text=True).stdout
    assert said == "1 models, 42 boxes, 8.4 kg\n"


def test_the_parser_of_ros_reads_the_structure(tmp_path: Path) -> None:
    if not shutil.which("check_urdf"):
        pytest.skip("liburdfdom-tools is not installed")
    export(tmp_path, "--at", "50%", "--urdf", "half.urdf")
    said = subprocess.run(["check_urdf", "half.urdf"], check=True, cwd=tmp_path, capture_output=True, text=True).stdout
    assert "Successfully Parsed XML" in said and len(re.findall(r"child\(\d+\)", said)) == 42
