"""The package against the command: the same runs, bit for bit."""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import metamorph as mm
import numpy as np
import pytest
from metamorph import _program

ROOT = Path(__file__).resolve().parents[3]
SCENARIOS = sorted((ROOT / "deploy" / "scenarios").glob("*.toml"))
SWARM = ROOT / "deploy" / "scenarios" / "swarm.toml"
#: Scenarios that take longer than a few seconds in a debug build.
LONG = {"slab-to-sphere", "disc-to-sphere", "slab-to-disc", "stoy", "rabbit", "swarm-200"}


def command(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([_program.find(), *words], capture_output=True, text=True, cwd=ROOT)


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda p: p.stem)
def test_shipped_scenarios_have_the_hashes_of_the_command(path: Path) -> None:
    if path.stem in LONG and "LONG" not in os.environ:
        pytest.skip("set LONG=1 to run it")
    ours = mm.run(path)
    theirs = json.loads(command("run", str(path), "--link", "sim", "--quiet", "--json", "-").stdout)
    assert (ours.trace_hash, ours.state_hash) == (theirs["trace_hash"], theirs["state_hash"])
    assert ours.messages == theirs["messages"] and ours.moves == theirs["moves"]


def test_a_sweep_has_the_rows_of_the_command(tmp_path: Path) -> None:
    done: list[mm.Progress] = []
    ours = mm.sweep(SWARM, seeds=range(3, 9), vary={"link.loss": ["0%", "5%"]}, jobs=2, progress=done.append)
    out = tmp_path / "out"
    said = command("sweep", str(SWARM), "--seeds", "3..9", "--vary", "link.loss=0%,5%", "--quiet", "--out", str(out))
    assert said.returncode == 0, said.stderr
    lines = (out / "runs.csv").read_text().splitlines()
    header = lines[0].split(",")
    assert ours.runs.columns == header and len(ours) == len(lines) - 1 == 12
    assert list(ours.runs["trace_hash"]) == [line.split(",")[header.index("trace_hash")] for line in lines[1:]]
    assert ours.runs["moves"].dtype.kind == "i" and ours.runs["makespan_s"].dtype == float
    assert all(0 <= p.done <= p.total == 12 for p in done)


def test_steps_make_the_run_that_one_call_makes() -> None:
    whole = mm.run(SWARM, seed=5)
    for events in (1, 7, 1000):
        sim = mm.Simulation(SWARM, seed=5)
        while sim.step(events) == events:
            pass
        assert sim.done and sim.outcome == whole.outcome
        assert (sim.trace_hash, sim.state_hash) == (whole.trace_hash, whole.state_hash)
    sim = mm.Simulation(SWARM, seed=5)
    while not sim.advance("700ms"):
        assert sim.outcome is None and sim.report().outcome == "aborted"
    assert sim.trace_hash == whole.trace_hash


@pytest.mark.parametrize("name", ["swarm", "chair", "box-to-chair"])
def test_what_was_injected_is_repeated_by_the_scenario(name: str) -> None:
    path = ROOT / "deploy" / "scenarios" / f"{name}.toml"
    sim = mm.Simulation(path, seed=2)
    sim.advance("2s")
    for fault in ("kill 1", "restart 1"):
        sim.inject(fault)
        assert sim.step(500) == 500
    sim.run()
    again = mm.run(sim.scenario(), seed=2)
    assert (again.trace_hash, again.state_hash) == (sim.trace_hash, sim.state_hash)
    assert [f["fault"] for f in sim.report().faults if f["module"] == 1] == ["kill", "restart"]


def test_copies_answer_several_questions_about_one_run() -> None:
    sim = mm.Simulation(SWARM, seed=1)
    sim.advance("2s")
    copies = {module: sim.fork() for module in (7, 30)}
    for module, copy in copies.items():
        copy.inject(f"kill {module}")
        copy.run()
        assert mm.run(copy.scenario(), seed=1).trace_hash == copy.trace_hash
    sim.run()
    assert sim.trace_hash == mm.run(SWARM, seed=1).trace_hash
    assert len({sim.trace_hash, *(copy.trace_hash for copy in copies.values())}) == 3
    with pytest.raises(ValueError, match="quadruped|walking"):
        mm.Simulation("quadruped", seed=1).fork()


def test_a_reseeded_copy_is_the_run_of_its_scenario() -> None:
    sim = mm.Simulation(SWARM, seed=1)
    sim.advance("2s")
    ends = set()
    for reseeded in ({"links": 1}, {"links": 2}, {"all": 1}):
        copy = sim.fork(**reseeded)
        copy.inject("kill 7")
        copy.advance("1s")
        copy = copy.fork(**reseeded)
        copy.run()
        ends.add(copy.trace_hash)
        assert mm.run(copy.scenario(), seed=1).trace_hash == copy.trace_hash
    assert len(ends) == 3
    with pytest.raises(ValueError, match="one of the two"):
        sim.fork(links=1, all=2)
    with pytest.raises(mm.ScenarioError, match="links=17@48213"):
        mm.Scenario.load(SWARM).with_change("links").check()


def test_positions_states_and_messages_are_those_of_the_world() -> None:
    sim = mm.Simulation(SWARM, seed=1)
    before = sim.positions()
    assert before.shape == (len(sim.state()), 3) and before.dtype == np.int16
    sim.run()
    after, state = sim.positions(), sim.state()
    assert (before != after).any() and len({tuple(cell) for cell in after}) == len(after), "two in one cell"
    assert [tuple(c) for c in after] == list(zip(state["x"], state["y"], state["z"]))
    assert sim.messages()["sent"].sum() == sim.report().messages["all"]["sent"]
    sim.step()
    assert (sim.positions() == after).all()


def test_errors_name_the_place_and_what_to_do() -> None:
    with pytest.raises(mm.ScenarioError) as caught:
        mm.Scenario.parse('version = 1\n[swarm]\nfamily = "cub"\n').check()
    problem = next(problem for problem in caught.value.problems if "cub" in problem.what)
    assert (problem.line, problem.column) == (3, 10) and problem.what and problem.fix and isinstance(caught.value, ValueError)
    assert pickle.loads(pickle.dumps(caught.value)).problems == caught.value.problems
    with pytest.raises(mm.ScenarioError, match="link.loss"):
        mm.run(SWARM, set={"link.loss": "105%"})
    with pytest.raises(mm.ScenarioError):
        mm.run("no-such-file.toml")
    with pytest.raises(ValueError, match="kill 7"):
        mm.Simulation(SWARM).inject("hit 7")
    with pytest.raises(ValueError, match="no module"):
        mm.Simulation(SWARM).inject("kill 4000")
    with pytest.raises(ValueError, match="no values"):
        mm.sweep(SWARM, seeds=range(2), vary={"link.loss": []})
    with pytest.raises(mm.SweepError, match="105%"):
        mm.sweep(SWARM, seeds=range(2), vary={"link.loss": ["0%", "105%"]})
    with pytest.raises(ValueError, match="consecutive"):
        mm.sweep(SWARM, seeds=[1, 3])


def test_shipped_scenarios_are_found_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert mm.scenarios() == sorted(path.stem for path in SCENARIOS)
    monkeypatch.chdir(tmp_path)
    named, file = mm.run("arch", seed=2), mm.run(ROOT / "deploy" / "scenarios" / "arch.toml", seed=2)
    assert named.trace_hash == file.trace_hash
    assert mm.run("swarm", link="ipc").outcome == "built"
    with pytest.raises(mm.ScenarioError, match="swarm"):
        mm.run("swam")


def test_a_scenario_is_made_of_a_dictionary() -> None:
    keys = {
        "version": 1,
        "seed": 3,
        "swarm": {"start": {"box": {"min": [0, 0, 0], "max": [3, 1, 1]}}},
        "goal": [{"name": "tower", "shape": {"box": {"min": [0, 0, 0], "max": [1, 1, 3]}}}],
    }
    report = mm.run(keys)
    assert (report.outcome, report.seed) == ("built", 3)
    scenario = mm.Scenario(keys)
    assert mm.run(scenario.to_toml() and scenario).trace_hash == report.trace_hash
    assert pickle.loads(pickle.dumps(scenario)) == scenario and scenario.set("seed", 4) != scenario


def test_other_threads_run_and_two_runs_share_the_processors() -> None:
    ticks, ended = 0, threading.Event()

    def count() -> None:
        nonlocal ticks
        while not ended.wait(0.005):
            ticks += 1

    thread = threading.Thread(target=count)
    thread.start()
    mm.sweep(SWARM, seeds=range(8), jobs=1)
    ended.set()
    thread.join()
    assert ticks > 0, "no other thread ran during a sweep"
    sim = mm.Simulation(SWARM, seed=1)
    worker = threading.Thread(target=sim.run)
    worker.start()
    worker.join()
    assert sim.done, "a simulation is carried out by any thread"


@pytest.mark.parametrize("call", ["mm.sweep(S, seeds=range(100000))", "mm.run(S, set={'link.loss': '50%'}, timeout_s=600) and [mm.run(S, seed=i) for i in range(10**6)]"])
def test_ctrl_c_ends_a_long_call(call: str) -> None:
    code = f"import metamorph as mm; S = {str(SWARM)!r}; print('ready', flush=True); {call}"
    # A shell that starts the tests in the background lets them ignore the signal, and Python keeps it so.
    heed = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heed)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    time.sleep(0.3)  # It may be anywhere in the call.
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=600)
    assert process.returncode != 0 and "KeyboardInterrupt" in said


def test_processes_run_by_the_program() -> None:
    report = mm.run(SWARM, link="ipc", seed=1, set={"link.loss": "2%"}, faults=["kill 3@1s"])
    assert (report.link, report.outcome) == ("ipc", "built")
    assert (report.faults[0]["fault"], report.faults[0]["module"]) == ("kill", 3) and report.agents["crashed"] >= 1


def test_another_file_of_its_name_is_no_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = mm.Scenario.parse(mm.Scenario.load("swarm").to_toml())
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenario.toml").write_text("this is no scenario")
    assert mm.run(scenario, link="ipc", seed=1).outcome == "built"
    assert b"<svg" in mm.render(scenario, at="1s").data[:200]


def test_faults_are_objects_or_text() -> None:
    assert mm.Fault.kill(7, at="2s") == "kill 7@2000000000ns" and mm.Fault.resume(3) == "resume 3"
    assert mm.Fault.pause(1, at=1, until="2s") == "pause 1@1000000000ns..2000000000ns"
    cut = mm.Fault.partition_of([3, 4], "1s", "2s")
    objects = mm.run(SWARM, faults=[mm.Fault.kill(7, at="1s"), mm.Fault.restart(7, at="3s"), mm.Fault.pause(2, "1s", "2s"), cut])
    words = ["kill 7@1s", "restart 7@3s", "pause 2@1s..2s", "partition 3,4@1s..2s"]
    texts = mm.run(SWARM, faults=words)
    assert objects.trace_hash == texts.trace_hash and "partition" in list(texts.fault_table["fault"])
    # A sweep has them, too.
    faulty = mm.Scenario.load(SWARM)
    for word in words:
        faulty = faulty.with_fault(word)
    swept = mm.sweep(faulty, seeds=range(1, 3))
    assert texts.trace_hash in list(swept.runs["trace_hash"])
    sim = mm.Simulation(SWARM)
    sim.advance("1s")
    for fault in (mm.Fault.kill(3), mm.Fault.stick(4)):
        sim.inject(fault)
    # Before the fault of the scenario itself.
    sim.advance("500ms")
    assert list(sim.report().fault_table["fault"]) == ["kill", "stick"]
    assert pickle.loads(pickle.dumps(mm.Fault.kill(3))) == mm.Fault.kill(3)
    for wrong in (-1, 1.5, True):
        with pytest.raises(ValueError, match="numbered from 0"):
            mm.Fault.kill(wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="`at` and `until`"):
        mm.Fault.pause(1, at="1s")


def test_sweeps_are_saved_loaded_and_compared(tmp_path: Path) -> None:
    forest = mm.sweep(SWARM, seeds=range(4), vary={"link.loss": ["0%", "5%"]})
    cycles = mm.sweep(SWARM, seeds=range(4), vary={"link.loss": ["0%", "5%"]}, set={"protocol.connectivity": "cycles"})
    theirs = tmp_path / "theirs"
    said = command("sweep", str(SWARM), "--seeds", "0..4", "--vary", "link.loss=0%,5%", "--quiet", "--out", str(theirs))
    assert said.returncode == 0, said.stderr
    forest.save(tmp_path / "ours")
    assert (tmp_path / "ours" / "runs.csv").read_bytes() == (theirs / "runs.csv").read_bytes()
    manifests = [json.loads((d / "manifest.json").read_text()) for d in (tmp_path / "ours", theirs)]
    for manifest in manifests:
        manifest.pop("scenario")
    assert manifests[0] == manifests[1]
    assert mm.Sweep.load(theirs).runs.to_dict() == forest.runs.to_dict()
    with pytest.raises(FileExistsError, match="not empty"):
        forest.save(theirs)
    same, other = mm.diff(forest, theirs), mm.diff(forest, cycles)
    assert len(same.lines) > 0 and not any(same.lines["differs"])
    assert "link.loss=0%" in other.text.replace(" ", "") and "link.loss=5%" in other.text.replace(" ", ""), other.text
    assert len(mm.diff(forest, cycles, by=["link.loss"]).lines) == len(other.lines)
    set_only = [mm.sweep(SWARM, seeds=range(2), set={"protocol.connectivity": name}) for name in ("forest", "cycles")]
    assert len(mm.diff(*set_only).lines) > 5


def test_results_are_shown_in_notebooks() -> None:
    report = mm.run("swarm")
    html = report._repr_html_()
    assert "<b>built</b> swarm, seed 1" in html and "32 of 32 filled" in html and report.repeat in html
    keys = {
        "version": 1,
        "name": "<b>",
        "swarm": {"start": {"box": {"min": [0, 0, 0], "max": [3, 1, 0]}}},
        "goal": [{"shape": {"box": {"min": [0, 0, 0], "max": [1, 1, 1]}}}],
    }
    assert "&lt;b&gt;" in mm.run(keys)._repr_html_(), "a text of a scenario is no HTML"
    sweep = mm.sweep(keys, seeds=range(30))
    shown = sweep._repr_html_()
    assert "<b>30 runs</b>: 30 built" in shown and "and 10 more rows" in shown
    assert shown.count("<tr>") == 21


def test_numbers_that_cannot_be_meant_are_answered() -> None:
    with pytest.raises(TypeError, match=r"write seeds=range\(10\)"):
        mm.sweep("swarm", seeds=10)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="only goes forward"):
        mm.Simulation("swarm").step(-1)
