"""Protocols written in Python: the twin in Rust, faults, errors, determinism and sweeps."""

from __future__ import annotations

import random
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Mapping, Optional

import metamorph as mm
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

from election import FAULTS, SCENARIO, Leader, Lowest, agreed, no_number_is_made_up  # noqa: E402


def scenario(x: int, y: int, **sections: Any) -> dict[str, Any]:
    start = {"box": {"min": [0, 0, 0], "max": [x - 1, y - 1, 0]}}
    return {"version": 1, "swarm": {"start": start}, "link": {"delay": "10ms..50ms"}, **sections}


@pytest.mark.parametrize("loss", ["0%", "5%"])
def test_the_election_is_event_by_event_that_of_rust(loss: str) -> None:
    # The hashes are those of `deploy/tutorial/tests/twin.rs`.
    golden = {"0%": "b10d646b43a185e1", "5%": "9fac05619f5dba9f"}
    report = mm.run(SCENARIO, protocol=Leader, until=agreed, set={"link.loss": loss})
    assert (report.outcome, report.trace_hash) == ("built", golden[loss])
    counts = report.messages_by_class.to_dict()
    by_class = dict(zip(counts["class"], counts["sent"]))
    assert by_class["seed"] == report.messages["all"]["sent"] > 0


@pytest.mark.parametrize("seed", range(5))
def test_modules_agree_although_one_dies_and_messages_are_lost(seed: int) -> None:
    def call() -> mm.Report:
        return mm.run(
            SCENARIO, seed=seed, protocol=Leader, until=agreed, invariants=[no_number_is_made_up],
            set={"link.loss": "10%", "link.corrupt": "1%", "link.duplicate": "1%"}, faults=FAULTS,
        )

    report, again = call(), call()
    assert report.outcome == "built" and [f["fault"] for f in report.faults] == ["kill", "restart"]
    assert report.time["virtual_s"] > 0.8, "module 7 reports again only after its restart"
    assert (report.trace_hash, report.state_hash) == (again.trace_hash, again.state_hash)
    assert report.messages["all"]["lost"] > 0 and report.messages["all"]["expired"] > 0
    sim = mm.Simulation(
        SCENARIO, seed=seed, protocol=Leader, until=agreed,
        set={"link.loss": "10%", "link.corrupt": "1%", "link.duplicate": "1%"}, faults=FAULTS,
    )
    while sim.step(100) == 100:
        pass
    assert sim.trace_hash == report.trace_hash and {m.lowest for m in sim.objects().values()} == {0}


def test_the_example_runs_as_a_script() -> None:
    script = Path(__file__).resolve().parents[1] / "examples" / "election.py"
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert "built at" in ran.stdout and "20 of 20 built" in ran.stdout, ran.stdout


def test_faults_are_injected_in_steps() -> None:
    sim = mm.Simulation(SCENARIO, protocol=Leader, until=agreed)
    sim.advance("50ms")
    sim.inject("kill 7")
    sim.advance("10ms")
    assert 7 not in sim.objects() and len(sim.objects()) == 99
    sim.advance("2s")
    assert not sim.done and not sim.state()["alive"][7]
    sim.inject("restart 7")
    assert sim.run() and sim.outcome == "built" and sim.objects()[7].incarnation == 1
    again = mm.run(sim.scenario(), protocol=Leader, until=agreed)
    assert again.trace_hash == sim.trace_hash


def test_parameters_are_set_and_checked() -> None:
    fast = mm.run(SCENARIO, protocol=Leader, until=agreed, set={"link.loss": "30%", "protocol.repeat": "50ms"})
    slow = mm.run(SCENARIO, protocol=Leader, until=agreed, set={"link.loss": "30%", "protocol.repeat": "5s"})
    assert fast.time["virtual_s"] < slow.time["virtual_s"]
    for key, value, said in (
        ("protocol.repet", "1s", "`repeat`"),
        ("protocol.repeat", 5, "500ms"),
        ("protocol.repeat", "soon", "no time"),
    ):
        with pytest.raises(mm.ScenarioError, match=said):
            mm.run(SCENARIO, protocol=Leader, set={key: value})
    with pytest.raises(mm.ScenarioError, match=r"no \[\[goal\]\]"):
        mm.run("swarm", protocol=Leader)
    with pytest.raises(mm.ScenarioError, match="protocol="):
        mm.run(SCENARIO, set={"swarm.family": "python"})
    with pytest.raises(ValueError, match="until"):
        mm.run("swarm", until=agreed)
    with pytest.raises(ValueError, match="processes of their own"):
        mm.run(SCENARIO, protocol=Leader, link="ipc", invariants=[no_number_is_made_up])

    class Local(Leader):
        pass

    with pytest.raises(ValueError, match="at the top of a module"):
        mm.run(SCENARIO, protocol=Local, link="ipc")


class Broken(Leader):
    """Fails when it hears of a lower number, at a module other than 0."""

    def receive(self, ctx: mm.Context, port: int, message: Lowest) -> None:
        if message.id < self.lowest:
            raise KeyError("lost")


def test_an_error_names_module_time_and_call() -> None:
    with pytest.raises(mm.ProtocolError, match="message on port") as caught:
        mm.run(SCENARIO, protocol=Broken)
    error = caught.value
    assert error.module is not None and error.now_ns >= 10_000_000 and error.input.startswith("message on port")
    assert isinstance(error.__cause__, KeyError)
    sim = mm.Simulation(SCENARIO, protocol=Broken)
    with pytest.raises(mm.ProtocolError):
        sim.run()

    def wrong(reports: Mapping[int, Lowest], now_s: float) -> str:
        return "finished"

    with pytest.raises(mm.ProtocolError, match="write None, True, or one of built") as caught:
        mm.run(SCENARIO, protocol=Leader, until=wrong)
    assert caught.value.module is None

    class Interrupted(Leader):
        def wake(self, ctx: mm.Context) -> None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mm.run(SCENARIO, protocol=Interrupted)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("ctx.send(6, Lowest(1))", "no port 6"),
        ("ctx.send(0, Lowest(-1))", "`id`"),
        ("ctx.send(0, Lowest(2**32))", "no u32"),
        ("ctx.send(0, Other(1))", "not in `messages`"),
        ("ctx.send(0, Lowest(1), cls='gossip')", "write one of gradient"),
        ("ctx.move('jump', 'down', 'east')", "slide, convex"),
        ("ctx.move('slide', 'down', 'up')", "right angles"),
        ("ctx.wake_after('soon')", "soon"),
        ("ctx.wake_after(-1)", "no duration"),
        ("ctx.random.below(0)", "below 0"),
    ],
)
def test_what_a_context_refuses(change: str, said: str) -> None:
    @mm.message(kind=9, cls="seed")
    class Other:
        id: mm.u8

    class Wrong(Leader):
        def start(self, ctx: mm.Context) -> None:
            exec(change, {"ctx": ctx, "Lowest": Lowest, "Other": Other})

    with pytest.raises(mm.ProtocolError) as caught:
        mm.run(SCENARIO, protocol=Wrong)
    assert said in str(caught.value)


def test_an_invariant_that_breaks_makes_a_run_unsafe() -> None:
    def never_agrees(modules: Mapping[int, Leader], now_s: float) -> Optional[str]:
        return "two modules agree" if now_s > 0 and len({m.lowest for m in modules.values()}) < 100 else None

    report = mm.run(SCENARIO, protocol=Leader, until=agreed, invariants=[never_agrees])
    assert report.outcome == "unsafe"
    violated = report.invariants["violated"][0]
    assert violated["invariant"] == "of-protocol" and "never_agrees: two modules agree" in str(violated)


def test_invariants_are_called_after_every_event_or_as_often_as_asked() -> None:
    states: list[tuple[int, ...]] = []

    def watch(modules: Mapping[int, Leader], now_s: float) -> Optional[str]:
        states.append(tuple(m.lowest for m in modules.values()))
        return None

    def calls(**options: Any) -> int:
        report = mm.run(SCENARIO, protocol=Leader, until=agreed, invariants=[watch], **options)
        (of_watch,) = report.protocol["invariants"]
        assert of_watch["name"] == "watch" and of_watch["calls"] == len(states)
        return of_watch["calls"]

    always = calls()
    changes = [(a, b) for a, b in zip(states, states[1:]) if len(a) == len(b)]
    # An event changes one module, so no state between two calls is missed.
    assert changes and all(sum(x != y for x, y in zip(a, b)) <= 1 for a, b in changes)
    states.clear()
    rarely = calls(every="100ms")
    assert 1 < rarely < always / 10
    for every, said in (("0s", "no time between two checks"), ("soon", "every: ")):
        with pytest.raises(ValueError, match=said):
            calls(every=every)
    with pytest.raises(ValueError, match="for a protocol written in Python"):
        mm.run("swarm", every="1s")


def test_a_run_ends_by_silence_or_by_time() -> None:
    silent = mm.run(SCENARIO, protocol=Leader, until=lambda reports, now_s: None, set={"stop.stall": "5s"})
    assert silent.outcome == "deadlock" and silent.time["virtual_s"] < 10
    timed = mm.run(SCENARIO, protocol=Leader, set={"stop.timeout": "3s"})
    assert (timed.outcome, timed.time["virtual_s"]) == ("timeout", 3.0)
    late = mm.run(SCENARIO, protocol=Leader, until=lambda reports, now_s: now_s >= 4)
    assert (late.outcome, late.time["virtual_s"]) == ("built", 4.0)


class Kept(mm.Protocol):
    """Keeps what the state hash must distinguish."""

    extra: Any = 1

    def start(self, ctx: mm.Context) -> None:
        self.kept = {"set": {3, 1, 2}, "list": [1, 2], "none": None, "flag": True, "bytes": b"x", "far": 2**70, "more": self.extra}


def test_the_state_hash_tells_states_apart_and_refuses_others() -> None:
    def of(value: Any) -> str:
        class With(Kept):
            extra = value

        return str(mm.run(SCENARIO, protocol=With, set={"stop.timeout": "1s"}).state_hash)

    values: list[Any] = [1, 2, True, "1", b"1", (1,), [1], {1}, {1: 1}, None, 2**70, -(2**70), Lowest(1), [[], [1]], [[1], []]]
    assert len({of(value) for value in values}) == len(values)
    assert of({1: 2, 3: 4}) == of({3: 4, 1: 2}) and of({1, 2}) == of(frozenset({2, 1}))
    for value in (1.5, object(), [[[0.5]]]):
        with pytest.raises(mm.ProtocolError, match="`kept`"):
            of(value)


class Returns(Kept):
    extra = 1.5

    def state(self) -> Any:
        return self.id


def test_a_class_may_say_what_its_state_is() -> None:
    assert mm.run(SCENARIO, protocol=Returns, set={"stop.timeout": "1s"}).outcome == "timeout"


@mm.message(kind=1, cls="gradient")
class Fields:
    a: mm.u8
    b: mm.i16
    c: mm.u64
    d: bool
    e: mm.cell
    f: Annotated[bytes, 3]
    g: mm.i64 = -1


class Sends(mm.Protocol):
    messages = [Fields]
    said: Any = None

    def contact(self, ctx: mm.Context, port: int, up: bool) -> None:
        ctx.send(port, self.said, cls="liveness")

    def receive(self, ctx: mm.Context, port: int, message: Fields) -> None:
        assert message == self.said, message
        ctx.report(message)


@pytest.mark.parametrize(
    "said",
    [
        Fields(0, 0, 0, False, (0, 0, 0), b"abc"),
        Fields(255, -(2**15), 2**64 - 1, True, (-16383, 0, 16383), b"\0\0\0", -(2**63)),
        Fields(1, 2**15 - 1, 2**63, True, (1, -1, 2), b"\xff\0a", 2**63 - 1),
    ],
)
def test_every_value_of_every_field_arrives(said: Fields) -> None:
    class Says(Sends):
        pass

    Says.said = said
    report = mm.run(scenario(2, 1), protocol=Says, until=lambda reports, now_s: len(reports) == 2)
    counts = report.messages_by_class.to_dict()
    assert report.outcome == "built"
    assert dict(zip(counts["class"], counts["bytes"]))["liveness"] == 2 * (32 + 1 + 2 + 8 + 1 + 6 + 3 + 8)


def test_messages_are_values() -> None:
    @mm.message(kind=2, cls="seed")
    class Highest:
        id: mm.u32

    others: list[object] = [Highest(3), (3,), Lowest(4)]
    assert Lowest(3) == Lowest(id=3) and all(Lowest(3) != other for other in others) and len({Lowest(3), Lowest(3)}) == 1
    assert repr(Lowest(3)) == "Lowest(id=3)"
    with pytest.raises(AttributeError):
        Lowest(3).id = 4  # type: ignore[misc]
    with pytest.raises(TypeError, match="96"):

        @mm.message(kind=0, cls="seed")
        class Long:
            text: Annotated[bytes, 97]

    with pytest.raises(TypeError, match="fixed layout"):

        @mm.message(kind=0, cls="seed")
        class Loose:
            text: str

    with pytest.raises(ValueError, match="write one of gradient"):

        @mm.message(kind=0, cls="gossip")
        class Unknown:
            id: mm.u8


class Crawler(mm.Protocol):
    """The upper module slides over the row until there is no support."""

    def start(self, ctx: mm.Context) -> None:
        self.path = [self.place]
        if self.place[2] == 1:
            ctx.wake_after(0.5)

    def wake(self, ctx: mm.Context) -> None:
        ctx.move("slide", "down", "east", not_after="1s")

    def sensed(self, ctx: mm.Context, percept: mm.Percept) -> None:
        if percept.cell is not None:
            self.path.append(percept.cell)
            ctx.wake_after("1s")
        else:
            self.path.append((-1, -1, -1))


def test_bodies_move_and_the_world_refuses_what_is_impossible() -> None:
    cells = [[0, 0, 1], *([x, 0, 0] for x in range(4))]
    row = {"version": 1, "swarm": {"start": {"cells": cells}}}
    sim = mm.Simulation(row, protocol=Crawler, set={"stop.timeout": "20s"})
    sim.run()
    mover = next(module for module in sim.objects().values() if len(module.path) > 1)
    assert mover.path == [(0, 0, 1), (1, 0, 1), (2, 0, 1), (3, 0, 1), (-1, -1, -1)]
    assert sim.report().moves == 3 and tuple(sim.positions()[mover.id]) == (3, 0, 1)


class Shuffles(Leader):
    def start(self, ctx: mm.Context) -> None:
        super().start(ctx)
        order = list(range(6))
        ctx.random.shuffle(order)
        self.drawn = (ctx.random.below(1000), ctx.random.chance("50%"), ctx.random.chance(Fraction(1, 3)), order)


class Guesses(Leader):
    def wake(self, ctx: mm.Context) -> None:
        self.guess = random.randrange(10**9)
        super().wake(ctx)


class Ordered(Leader):
    """The order of a set of texts depends on the seed of hashes."""

    def start(self, ctx: mm.Context) -> None:
        super().start(ctx)
        self.names = list({f"name {i}" for i in range(20)})


def test_check_determinism_finds_what_differs() -> None:
    small = scenario(3, 2, stop={"timeout": "2s"})
    mm.check_determinism(Leader, small, seeds=2)
    mm.check_determinism(Shuffles, small, seeds=2)
    with pytest.raises(mm.ProtocolError, match="`guess` of module 0") as caught:
        mm.check_determinism(Guesses, small, seeds=1)
    assert caught.value.module == 0
    with pytest.raises(mm.ProtocolError, match="`names` of module 0"):
        mm.check_determinism(Ordered, small, seeds=1)

    class Local(Leader):
        pass

    with pytest.raises(ValueError, match="top of a module"):
        mm.check_determinism(Local, small)


def test_a_class_in_no_file_is_refused() -> None:
    code = (
        "import metamorph as mm\nclass P(mm.Protocol): pass\n"
        "try: mm.sweep({'version': 1}, protocol=P)\nexcept ValueError as e: print(e)"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "in no file; write class" in ran.stdout, ran


def test_a_sweep_by_processes_has_the_runs_of_this_one() -> None:
    told: list[mm.Progress] = []
    sweep = mm.sweep(
        SCENARIO, protocol=Leader, until=agreed, seeds=range(3, 10), jobs=2,
        vary={"link.loss": ["0%", "5%"], "protocol.repeat": ["250ms", "1s"]}, progress=told.append,
    )
    runs = sweep.runs
    assert len(sweep) == 28 and list(runs["run"]) == list(range(28)) and told[-1] == (28, 28)
    for i in range(28):
        values = {"link.loss": runs["link.loss"][i], "protocol.repeat": runs["protocol.repeat"][i]}
        alone = mm.run(SCENARIO, protocol=Leader, until=agreed, seed=int(runs["seed"][i]), set=values)
        assert (alone.trace_hash, alone.state_hash) == (runs["trace_hash"][i], runs["state_hash"][i])
    with pytest.raises(mm.ProtocolError, match="lost"):
        mm.sweep(SCENARIO, protocol=Broken, seeds=range(2), jobs=1)


def recorded(directory: Path, **more: Any) -> tuple[mm.Report, Path]:
    journal = directory / "run.journal"
    report = mm.run(
        SCENARIO, protocol=Leader, until=agreed, set={"link.loss": "5%"}, faults=FAULTS, journal=journal, **more
    )
    return report, journal


def test_a_run_is_recorded_and_carried_out_again(tmp_path: Path) -> None:
    report, path = recorded(tmp_path)
    plain = mm.run(SCENARIO, protocol=Leader, until=agreed, set={"link.loss": "5%"}, faults=FAULTS)
    assert report.trace_hash == plain.trace_hash, "recording changes nothing"
    journal = mm.Journal(path, protocol=Leader, until=agreed)
    assert (journal.family, journal.modules) == ("python", 100)
    events = journal.events().to_dict()["event"]
    assert events.count("died") == 1 and events.count("restarted") == 1
    assert journal.verify() is None
    # What happened can be read without the class.
    unnamed = mm.Journal(path)
    assert unnamed.per_module().to_dict() == journal.per_module().to_dict()
    with pytest.raises(mm.JournalError, match="name it: Journal"):
        unnamed.verify()


class Other(Leader):
    """Does not repeat what it knows."""

    def wake(self, ctx: mm.Context) -> None:
        pass


def test_another_protocol_does_not_fit_a_journal(tmp_path: Path) -> None:
    _, path = recorded(tmp_path)
    found = mm.Journal(path, protocol=Other, until=agreed).verify()
    assert found is not None and "record " in found, found


def test_records_are_drawn_exported_and_shown(tmp_path: Path) -> None:
    import urllib.error
    import urllib.request

    from mcap.reader import make_reader

    _, path = recorded(tmp_path)
    journal = mm.Journal(path, protocol=Leader)
    figure = mm.render(journal, at="500ms", camera="top")
    assert figure.data.startswith(b"<svg") or b"<svg" in figure.data[:200]
    mm.export(journal, tmp_path / "run.mcap")
    with open(tmp_path / "run.mcap", "rb") as file:
        assert any(True for _ in make_reader(file).iter_messages())
    with mm.view(journal, "swarm", seed=3) as page:
        first, second = page.urls
        assert page._repr_html_().count("<iframe") == 2 and first in page._repr_html_()
        scene = urllib.request.urlopen(first + "scene").read().decode()
        assert "election" not in scene and '"modules"' in scene
        frame = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Dest": "iframe", "Sec-Fetch-Mode": "navigate"}
        shown = urllib.request.urlopen(urllib.request.Request(second, headers=frame))
        assert "frame-ancestors http://localhost:*" in shown.headers["Content-Security-Policy"]
        # Module 3 hears, by the name of the class, of lower numbers.
        told = urllib.request.urlopen(first + "messages?id=3&at=10000000").read().decode()
        assert "Lowest 0" in told, told[:300]
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(urllib.request.Request(first + "scene", headers={"Sec-Fetch-Site": "cross-site"}))
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(first)
    with pytest.raises(mm.ProgramError, match="no such file"):
        mm.view("none.journal")


def test_a_simulation_is_drawn_as_it_is(tmp_path: Path) -> None:
    sim = mm.Simulation(SCENARIO, protocol=Leader, until=agreed)
    sim.advance("100ms")
    sim.inject("kill 7")
    sim.advance("100ms")
    now = mm.render(sim, tmp_path / "now.svg", camera="top")
    assert now.format == "svg" and (tmp_path / "now.svg").read_bytes() == now.data and b"dead" in now.data
    assert mm.render(sim, format="png", legend=False).data.startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="--camera"):
        mm.render(sim, camera="sideways")


@pytest.mark.parametrize("graph", [{"ring": 12}, {"grid": [3, 4]}, {"random": {"modules": 12, "degree": 3}}])
def test_modules_may_have_any_graph_of_contacts(graph: dict[str, Any]) -> None:
    def all_agree(reports: Mapping[int, Lowest], now_s: float) -> bool:
        return len(reports) == 12 and all(r.id == 0 for r in reports.values())

    keys = {"version": 1, "swarm": {"graph": graph}, "link": {"loss": "20%"}}
    report = mm.run(keys, protocol=Leader, until=all_agree, invariants=[no_number_is_made_up])
    assert report.outcome == "built" and report.agents["launched"] == 12
    with pytest.raises(mm.ScenarioError, match="both `start` and `graph`"):
        mm.run({**keys, "swarm": {**SCENARIO["swarm"], "graph": graph}}, protocol=Leader)


def test_the_sum_is_kept_on_a_ring_that_is_cut(tmp_path: Path) -> None:
    import gossip

    report = mm.run(
        gossip.SCENARIO, protocol=gossip.Gossip, until=gossip.agreed, invariants=[gossip.keeps_the_sum],
        journal=tmp_path / "gossip.journal",
    )
    assert report.outcome == "built", report.reason
    assert report.protocol["invariants"][0]["calls"] > 1000
    journal = mm.Journal(tmp_path / "gossip.journal", protocol=gossip.Gossip, until=gossip.agreed)
    assert journal.verify() is None


def sixteen_agree(reports: Mapping[int, Lowest], now_s: float) -> bool:
    return len(reports) == 16 and all(r.id == 0 for r in reports.values())


class Unlucky(Leader):
    """Fails in module 5 when it wakes."""

    def wake(self, ctx: mm.Context) -> None:
        if self.id == 5:
            raise RuntimeError("out of luck")
        super().wake(ctx)


def test_every_module_may_be_a_process_of_its_own(tmp_path: Path) -> None:
    keys = scenario(4, 4, fault=[{"kill": 7, "at": "100ms"}, {"restart": 7, "at": "2s"}])
    journal = tmp_path / "run.journal"
    report = mm.run(
        keys, protocol=Leader, until=sixteen_agree, link="ipc", set={"protocol.repeat": "300ms"}, journal=journal
    )
    assert (report.outcome, report.link, report.agents["restarted"]) == ("built", "ipc", 1), report.reason
    assert report.messages["all"]["sent"] > 48 and report.time["virtual_s"] > 2
    assert mm.Journal(journal, protocol=Leader, until=sixteen_agree).verify() is None


def test_an_error_in_a_process_is_reported() -> None:
    report = mm.run(scenario(4, 4), protocol=Unlucky, until=sixteen_agree, link="ipc", set={"stop.stall": "3s"})
    assert report.outcome == "deadlock" and report.agents["crashed"] == 1
    assert "out of luck" in str(report.notes), report.notes


def test_a_protocol_that_forgets_what_it_answered_does_not_keep_the_sum() -> None:
    import gossip

    class Forgetful(gossip.Gossip):
        def receive(self, ctx: mm.Context, port: int, message: object) -> None:
            self.answered = {}
            super().receive(ctx, port, message)

    report = mm.run(
        gossip.SCENARIO, protocol=Forgetful, until=gossip.agreed, invariants=[gossip.keeps_the_sum]
    )
    assert report.outcome == "unsafe" and "keeps_the_sum: the sum is " in report.reason, report.reason
