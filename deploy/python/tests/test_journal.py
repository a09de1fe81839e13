"""Journals as tables and arrays, the commands of the program from Python, plots, and pickle."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import metamorph as mm
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

from election import SCENARIO, Leader, agreed  # noqa: E402


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, mm.Report]:
    path = tmp_path_factory.mktemp("journal") / "run.journal"
    # With this seed no module moves at the end. Of one that moves, a journal rounds where its motion has brought it, and a
    # simulation has the cell from which it comes.
    return path, mm.run("swarm", seed=9, journal=path, faults=["kill 3@1s"])


def test_a_journal_has_what_a_simulation_in_steps_has(recorded: tuple[Path, mm.Report]) -> None:
    path, report = recorded
    journal = mm.Journal(path)
    assert journal.modules == 42 and journal.duration_s == pytest.approx(report.time["virtual_s"])
    sim = mm.Simulation("swarm", seed=9, faults=["kill 3@1s"])
    cells = [sim.positions()]
    sim.run()
    cells.append(sim.positions())
    found = journal.positions([0, journal.duration_s])
    assert found.shape == (2, 42, 3) and found.dtype == np.int16
    assert (found == np.array(cells)).all()
    states = journal.states(["0s", "2s"])
    assert states.shape == (2, 42) and journal.state_names[states[1][3]] == "dead" != journal.state_names[states[0][3]]
    with pytest.raises(ValueError, match="ascending"):
        journal.positions([2, 1])


def test_events_and_messages_are_those_of_the_report(recorded: tuple[Path, mm.Report]) -> None:
    path, report = recorded
    journal = mm.Journal(path)
    events = journal.events()
    names = events["event"].tolist()
    # A move that is under way when the goal is built is not among those of the report.
    move_s = report.time["virtual_s"] / report.time["move_times"]
    ends = events["time_s"][[name == "moves" for name in names]] + move_s
    assert (ends <= journal.duration_s + 1e-6).sum() - names.count("failed") == report.moves
    assert [(e["fault"], e["module"]) for e in report.faults if e["fault"] == "kill"][0] == ("kill", 3)
    died = [i for i, name in enumerate(names) if name == "died"]
    assert events.to_dict()["module"][died[0]] == 3 and events["time_s"][died[0]] == 1.0
    for bin in ("1s", 0.1):
        messages = journal.messages_over_time(bin)
        for name, counts in report.messages["by_class"].items():
            assert messages[name].sum() == counts["delivered"], name
    with pytest.raises(ValueError, match="longer"):
        journal.messages_over_time(0)
    course = journal.over_time()
    assert course["moves"].sum() == report.moves and course["time_s"][-1] == pytest.approx(journal.duration_s)
    assert course["filled"][-1] == course["goal"][-1] > course["filled"][0]
    assert course["seed"].sum() == report.messages["by_class"]["seed"]["delivered"]
    assert mm.render(journal, at="2s", links="contacts").data == mm.render(path, at="2s", links="contacts").data


def test_a_journal_is_verified_and_damage_is_an_error(recorded: tuple[Path, mm.Report], tmp_path: Path) -> None:
    path, _ = recorded
    assert mm.Journal(path).verify() is None
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    damaged = tmp_path / "damaged.journal"
    damaged.write_bytes(data)
    with pytest.raises(mm.JournalError):
        mm.Journal(damaged)
    with pytest.raises(mm.JournalError):
        mm.Journal(tmp_path / "none.journal")


def test_figures_are_those_of_the_command(recorded: tuple[Path, mm.Report], tmp_path: Path) -> None:
    path, _ = recorded
    figure = mm.render(path, at="50%", legend=False, section=["x<4"])
    assert figure.format == "svg" and figure.data.startswith(b"<svg") and figure._repr_svg_() is not None
    out = tmp_path / "now.png"
    sim = mm.Simulation("swarm", seed=2)
    sim.advance("1s")
    drawn = mm.render(sim, out, width="200px")
    assert out.read_bytes() == drawn.data and drawn.data.startswith(b"\x89PNG")
    keys = {
        "version": 1,
        "swarm": {"start": {"box": {"min": [0, 0, 0], "max": [3, 1, 1]}}},
        "goal": [{"shape": {"box": {"min": [0, 0, 0], "max": [1, 1, 3]}}}],
    }
    assert b'data-cell="3 1 1"' in mm.render(keys, at="0s").data
    with pytest.raises(mm.ProgramError, match="--camera"):
        mm.render("swarm", camera="behind")


def test_reports_are_compared(recorded: tuple[Path, mm.Report]) -> None:
    _, report = recorded
    other = mm.run("swarm", seed=3)
    found = mm.diff(report, other)
    assert found.kind == "reports" and "trace_hash" in found.lines["field"].tolist()
    assert len(mm.diff(report, report).lines) == 0
    assert report.fault_table["module"][0] == 3


def test_the_doctor_looks_at_this_machine() -> None:
    checks = mm.doctor(modules=3)
    assert checks and all({"name", "state", "found", "needs"} <= set(check) for check in checks)


def test_tables_are_read_as_arrow() -> None:
    pa = pytest.importorskip("pyarrow")
    table = mm.Simulation("swarm").state()
    read = pa.table(table)
    assert read.column_names == table.columns and read["module"].to_pylist() == list(range(42))


@pytest.mark.parametrize("by_steps", [True, False])
def test_a_simulation_is_pickled_with_what_was_injected(by_steps: bool) -> None:
    sim = mm.Simulation("swarm", seed=4)
    if by_steps:
        sim.step(777)
    else:
        sim.advance("1.5s")
    sim.inject("kill 5")
    if by_steps:
        sim.step(100)
    else:
        sim.advance("0.25s")
    again = pickle.loads(pickle.dumps(sim))
    assert (again.now_ns, again.trace_hash, again.state_hash) == (sim.now_ns, sim.trace_hash, sim.state_hash)
    sim.run()
    again.run()
    assert (again.trace_hash, again.outcome) == (sim.trace_hash, sim.outcome)


def test_a_simulation_of_a_protocol_is_pickled() -> None:
    sim = mm.Simulation(SCENARIO, protocol=Leader, until=agreed)
    sim.advance("0.2s")
    again = pickle.loads(pickle.dumps(sim))
    assert again.trace_hash == sim.trace_hash and again.run() and again.outcome == "built"


def test_sweeps_and_reports_are_plotted(recorded: tuple[Path, mm.Report]) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    sweep = mm.sweep("line-to-box", seeds=range(4), vary={"link.loss": ["0%", "5%"]})
    ax = sweep.plot("makespan_s", by="link.loss")
    assert [tick.get_text() for tick in ax.get_xticklabels()] == ["0%\nn = 4", "5%\nn = 4"]
    medians = [line.get_ydata()[0] for line in ax.lines if len(set(line.get_ydata())) == 1]
    assert np.median(sweep.runs["makespan_s"][:4]) in medians
    assert sweep.plot("moves", ax=ax) is ax
    with pytest.raises(ValueError, match="the columns are run, link.loss"):
        sweep.plot("makespan")
    bars = recorded[1].plot().patches
    assert sum(bar.get_width() for bar in bars) == recorded[1].messages["all"]["sent"]


def test_latencies_and_figures_of_modules_add_up(recorded: tuple[Path, mm.Report]) -> None:
    path, report = recorded
    latency = report.latency_by_class
    for name, count, p50, p99 in zip(latency["class"], latency["count"], latency["p50_s"], latency["p99_s"]):
        assert count == report.messages["by_class"][name]["delivered"] and 0 < p50 <= p99, name
    modules = mm.Journal(path).per_module()
    assert modules["module"].tolist() == list(range(42)) and modules["deaths"].sum() == report.agents["crashed"]
    for name, counts in report.messages["by_class"].items():
        assert modules[f"sent_{name}"].sum() == counts["sent"] and modules[f"received_{name}"].sum() == counts["delivered"]
