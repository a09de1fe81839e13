"""The public interface: scenarios, runs, sweeps and simulations in steps."""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess
import tempfile
from collections import Counter
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Any, Callable, Iterable, Mapping, NamedTuple, Optional, Sequence, Union

import numpy as np
from numpy.typing import NDArray

from . import _metamorph as _native
from . import _plot, _program
from ._embedded import NONE, name_of, within
from ._errors import MetamorphError, ProgramError, ScenarioError
from ._processes import Work, rows
from ._program import Program
from ._protocol import Invariant, Protocol, Until, _given
from ._table import Table
from ._time import Duration, nanoseconds

#: A file or the name of a shipped scenario, the keys of a scenario as a mapping, or a scenario.
ScenarioLike = Union[str, "os.PathLike[str]", Mapping[str, Any], "Scenario"]


#: The setting of a scenario whose protocol comes with the call.
_OF_PYTHON = "swarm.family=python"


def _setting(key: str, value: Any) -> str:
    text = value if isinstance(value, str) else _native.to_value(json.dumps(value))
    return f"{key}={text}"


class Scenario:
    """A scenario: a text in the format of scenario files, with values set in it.

    Equal if text, origin and settings are equal. Nothing is checked before it is used, except by :meth:`check`.
    """

    def __init__(self, keys: Mapping[str, Any]) -> None:
        """Makes a scenario of the keys of the format, nested as tables are. Files that it names are relative to
        the current directory."""
        self._origin = "scenario.toml"
        self._text = _native.to_toml(json.dumps(keys))
        self._settings: tuple[str, ...] = ()
        self._faults: tuple[str, ...] = ()

    @classmethod
    def load(cls, path: Union[str, os.PathLike[str]]) -> Scenario:
        """Reads a file, or a scenario that ships with the package, by its name."""
        return cls._of(*_native.load(os.fspath(path)))

    @classmethod
    def parse(cls, text: str) -> Scenario:
        """Takes the text of a scenario."""
        return cls._of("scenario.toml", text)

    @classmethod
    def _of(cls, origin: str, text: str, settings: tuple[str, ...] = (), faults: tuple[str, ...] = ()) -> Scenario:
        scenario = cls.__new__(cls)
        scenario._origin, scenario._text = origin, text
        scenario._settings, scenario._faults = settings, faults
        return scenario

    def set(self, key: str, value: Any) -> Scenario:
        """Returns a copy with a value for a key, such as `link.loss`. Text is taken as in `--set KEY=VALUE`."""
        return self._of(self._origin, self._text, (*self._settings, _setting(key, value)), self._faults)

    def with_fault(self, fault: str) -> Scenario:
        """Returns a copy with one more fault: `kill 7@2s`, `restart 7@3s`, `pause 7@1s..2s` or `partition 7,8@1s..2s`."""
        verb, _, _ = fault.partition(" ")
        if verb not in ("kill", "restart", "pause", "partition"):
            forms = "`kill 7@2s`, `restart 7@3s`, `pause 7@1s..2s` or `partition 7,8@1s..2s`"
            raise ValueError(f"`{fault}` is no fault; write {forms}")
        return self._of(self._origin, self._text, self._settings, (*self._faults, fault))

    def with_change(self, change: str) -> Scenario:
        """Returns a copy with one more change of the simulated run: `links=17@48213` gives links other random numbers after 48,213
        events, `all=17@48213` everything that draws; `rescue=off@48213` ends the help of the controller, `lose=7.0.213@48213`
        withholds a message of module 7, and `sleep=7/1s@48213` lets its process sleep."""
        return self._of(self._origin, self._text, self._settings, (*self._faults, f"change {change}"))

    def _plan(self, seed: Optional[int] = None, protocol: Optional[_native.Protocol] = None) -> _native.Plan:
        settings = [*self._settings, *([_OF_PYTHON] if protocol is not None else [])]
        return _native.Plan(self._origin, self._text, settings, list(self._faults), seed, protocol)

    @property
    def name(self) -> str:
        """Its name, or that of its file."""
        return self._plan().title

    @property
    def family(self) -> str:
        """The family of its modules."""
        return self._plan().family

    @property
    def seed(self) -> int:
        """Its seed."""
        return self._plan().seed

    @property
    def modules(self) -> int:
        """The number of modules."""
        return self._plan().modules

    def check(self) -> str:
        """Returns what `metamorph check` prints; raises :class:`ScenarioError` with every problem."""
        return self._plan().check()

    def to_toml(self) -> str:
        """The text, without the values that were set in it."""
        return self._text

    def _key(self) -> tuple[Any, ...]:
        return self._origin, self._text, self._settings, self._faults

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scenario) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        return f"<Scenario {self._origin}{''.join(f' {s}' for s in self._settings + self._faults)}>"


def _scenario(
    like: ScenarioLike, settings: Optional[Mapping[str, Any]] = None, faults: Iterable[str] = ()
) -> Scenario:
    if isinstance(like, Scenario):
        scenario = like
    elif isinstance(like, Mapping):
        scenario = Scenario(like)
    else:
        scenario = Scenario.load(like)
    for key, value in (settings or {}).items():
        scenario = scenario.set(key, value)
    for fault in faults:
        scenario = scenario.with_fault(fault)
    return scenario


def scenarios() -> list[str]:
    """The names of the scenarios that ship with the package."""
    return [name for name, _ in _native.shipped()]


class Report:
    """The result of a run: every field of the report schema (`metamorph schema report`) is an attribute."""

    def __init__(self, fields: Mapping[str, Any]) -> None:
        self._fields = dict(fields)

    def __getattr__(self, name: str) -> Any:
        try:
            return self.__dict__["_fields"][name]
        except KeyError:
            raise AttributeError(f"a report has no field `{name}`") from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._fields]

    @property
    def messages_by_class(self) -> Table:
        """The messages by class."""
        return _messages([(name, counts) for name, counts in self._fields["messages"]["by_class"].items()])

    @property
    def latency_by_class(self) -> Table:
        """Quantiles of the time from sending to the input of the receiver by class, in seconds, to a sixteenth."""
        by_class = (self._fields["messages"]["latency"] or {"by_class": {}})["by_class"]
        columns: dict[str, list[Any]] = {"class": list(by_class)}
        for name in _QUANTILES:
            columns[name] = [quantiles[name] for quantiles in by_class.values()]
        return Table(columns)

    @property
    def fault_table(self) -> Table:
        """The faults that struck: when, what, which module, and in what state it was."""
        names = ("at_s", "fault", "module", "effect")
        return Table({name: [fault[name] for fault in self._fields["faults"]] for name in names})

    @property
    def standstill_table(self) -> Table:
        """The standstills in the course of the run: since when, until when, what ended each, and the moves of called and of led
        modules meanwhile."""
        events = (self._fields["standstills"] or {"events": []})["events"]
        names = ("since_s", "until_s", "ended_by", "called", "led", "reason")
        return Table({name: [event[name] for event in events] for name in names})

    def plot(self, ax: Optional[Any] = None) -> Any:
        """Draws the messages sent by class. Returns the axes of matplotlib, which must be installed."""
        return _plot.bars(self.messages_by_class, ax)

    def to_dict(self) -> dict[str, Any]:
        """All fields."""
        return dict(self._fields)

    def to_json(self) -> str:
        """All fields as JSON, as `--json` writes them."""
        return json.dumps(self._fields, indent=2)

    def _repr_html_(self) -> str:
        """The result in a notebook: the outcome, why, and the numbers that a paper states."""
        f = self._fields
        built = f["outcome"] == "built"
        rows = {
            "goal": f"{f['goal']['filled']:,} of {f['goal']['cells']:,} filled",
            "agents": f"{f['agents']['launched']:,} launched, {f['agents']['crashed']:,} crashed",
            "moves": f"{f['moves']:,}",
            "messages": f"{f['messages']['total']:,}",
            "collisions": f"{f['collisions']['prevented']:,} prevented, {f['collisions']['suffered']:,} suffered",
            "scenario time": f"{f['time']['virtual_s']:.1f} s",
            "invariants": f"{f['invariants']['checked']:,} checks, {f['invariants']['broken']:,} broken",
            "repeat with": f["repeat"],
        }
        cells = "".join(f"<tr><th>{name}</th><td>{escape(value)}</td></tr>" for name, value in rows.items())
        outcome = f"<b>{escape(f['outcome'])}</b> {escape(f['scenario'])}, seed {f['seed']}"
        why = "" if built else f"<p>{escape(f['reason'])}</p>"
        return f"<p>{outcome}</p>{why}<table>{cells}</table>"

    def __repr__(self) -> str:
        time = self._fields["time"]["virtual_s"]
        return f"<Report {self._fields['scenario']}, seed {self._fields['seed']}: {self._fields['outcome']} at {time:g} s>"


_QUANTILES = ("count", "least_s", "p50_s", "p90_s", "p99_s", "p999_s", "greatest_s")
_COUNTS = ("sent", "delivered", "lost", "duplicated", "overflowed", "expired", "refused", "bytes")


def _messages(rows: Iterable[tuple[str, Mapping[str, int]]]) -> Table:
    rows = list(rows)
    columns: dict[str, list[Any]] = {"class": [name for name, _ in rows]}
    for count in _COUNTS:
        columns[count] = [counts[count] for _, counts in rows]
    return Table(columns)


def run(
    scenario: ScenarioLike,
    *,
    link: str = "sim",
    seed: Optional[int] = None,
    set: Optional[Mapping[str, Any]] = None,
    faults: Iterable[str] = (),
    protocol: Optional[type[Protocol]] = None,
    until: Optional[Until] = None,
    invariants: Sequence[Invariant] = (),
    every: Optional[str] = None,
    journal: Optional[Union[str, os.PathLike[str]]] = None,
    timeout_s: Optional[float] = None,
) -> Report:
    """Runs a scenario to its end.

    :param scenario: a file, the name of a shipped scenario, the keys of a scenario, or a :class:`Scenario`.
    :param link: `"sim"` in virtual time in this process, or `"ipc"` with one process per module, by the program.
    :param seed: the seed, else that of the scenario.
    :param set: values to be set, such as `{"link.loss": "5%"}`.
    :param faults: further faults, such as `"kill 7@2s"`.
    :param protocol: a protocol written in Python, instead of the built-in one; the scenario needs no goal.
    :param until: when a run of this protocol is over.
    :param invariants: what must hold in it; if one does not, the outcome is `unsafe`. Each is called after every event of a
        module; `report.protocol["invariants"]` counts the calls.
    :param every: the time between two calls of the invariants, such as `"100ms"`, instead of after every event.
    :param journal: a file to record the run in.
    :param timeout_s: seconds of real time; then the outcome is `aborted`.
    """
    chosen = _scenario(scenario, set, faults)
    given = _given(protocol, until, invariants, every)
    if link == "ipc":
        if invariants:
            raise ValueError(
                "invariants see the objects of all modules, which are in processes of their own with link=\"ipc\"; check"
                " them with link=\"sim\""
            )
        program = _program.own()
        if protocol is not None:
            if name_of(protocol) == NONE or (until is not None and name_of(until) == NONE):
                raise ValueError(
                    "every process imports the class and `until`, so they must be in a file; write them at the top of a module"
                )
            program = within(protocol, until)
            chosen = chosen.set("swarm.family", "python")
        chosen._plan(seed, given)  # Errors of the scenario are raised here.
        return _run_processes(program, chosen, seed, journal, timeout_s)
    if link != "sim":
        raise ValueError(f"link is {link!r}; write \"sim\" or \"ipc\"")
    text = _native.run(chosen._plan(seed, given), None if journal is None else os.fspath(journal), timeout_s)
    return Report(json.loads(text))


def _written(scenario: Scenario, directory: Path) -> tuple[str, list[str]]:
    """A file of a scenario, and the options for what is set in it."""
    file, text = scenario._origin, scenario.to_toml()
    # Its name may be that of another file.
    is_there = Path(file).read_text() == text if Path(file).is_file() else file in scenarios()
    if not is_there:
        file = str(directory / "scenario.toml")
        Path(file).write_text(text)
    words = [f"--set={setting}" for setting in scenario._settings]
    for fault in scenario._faults:
        verb, _, what = fault.partition(" ")
        words.append(f"--{verb}={what}")
    return file, words


def _run_processes(
    program: Program,
    scenario: Scenario,
    seed: Optional[int],
    journal: Optional[Union[str, os.PathLike[str]]],
    timeout_s: Optional[float],
) -> Report:
    with tempfile.TemporaryDirectory() as directory:
        report = Path(directory) / "report.json"
        file, options = _written(scenario, Path(directory))
        words = [*program.command, "run", file, "--link", "ipc", "--quiet", "--json", str(report), *options]
        words += ["--seed", str(seed)] if seed is not None else []
        words += ["--journal", os.fspath(journal)] if journal is not None else []
        with subprocess.Popen(
            words, env=program.environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        ) as process:
            try:
                _, said = process.communicate(timeout=timeout_s)
            except BaseException as error:
                # The program ends the swarm by itself, and writes a report.
                process.terminate()
                _, said = process.communicate()
                if not isinstance(error, subprocess.TimeoutExpired):
                    raise
        if not report.exists():
            raise ProgramError(said.strip() or f"the program ended with exit code {process.returncode}")
        return Report(json.loads(report.read_text()))


class Sweep:
    """The runs of a sweep."""

    def __init__(self, lines: Iterable[list[str]], varied: int, manifest: str) -> None:
        """Takes the lines of `runs.csv`, the number of varied keys, and the text of `manifest.json`."""
        self._lines, self._manifest = list(lines), manifest
        #: One row for each run, with the columns of `runs.csv`: the varied keys first.
        self.runs = _runs(self._lines, varied)

    def save(self, directory: Union[str, os.PathLike[str]]) -> None:
        """Writes the runs to a new or empty directory, as `metamorph sweep --out` does, for `metamorph diff` and
        :meth:`load`."""
        to = Path(directory)
        to.mkdir(parents=True, exist_ok=True)
        if any(to.iterdir()):
            raise FileExistsError(f"{to} is not empty; name a new or empty directory")
        (to / "manifest.json").write_text(self._manifest)
        with (to / "runs.csv").open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(self._lines)

    @classmethod
    def load(cls, directory: Union[str, os.PathLike[str]]) -> Sweep:
        """Reads a directory that :meth:`save` or `metamorph sweep --out` wrote."""
        manifest = (Path(directory) / "manifest.json").read_text()
        with (Path(directory) / "runs.csv").open(newline="") as file:
            return cls(csv.reader(file), len(json.loads(manifest)["vary"]), manifest)

    def to_pandas(self) -> Any:
        """The runs as a pandas data frame."""
        return self.runs.to_pandas()

    def plot(self, column: str, by: Optional[str] = None, ax: Optional[Any] = None) -> Any:
        """Draws a box of a column, such as `"makespan_s"`, for each value of another one, such as `"link.loss"`. Returns the
        axes of matplotlib, which must be installed."""
        return _plot.boxes(self.runs, column, by, ax)

    def __len__(self) -> int:
        return len(self.runs)

    def _repr_html_(self) -> str:
        """The outcomes in a notebook, with the first runs."""
        outcomes = Counter(self.runs.to_dict()["outcome"])
        said = ", ".join(f"{count:,} {escape(str(outcome))}" for outcome, count in outcomes.most_common())
        return f"<p><b>{len(self):,} runs</b>: {said}</p>{self.runs._repr_html_()}"

    def __repr__(self) -> str:
        return f"<Sweep of {len(self)} runs>"


class Progress(NamedTuple):
    """How far a sweep is."""

    done: int
    total: int


#: Columns of `runs.csv` that are texts; the others, behind the varied keys, are numbers.
_TEXTS = {"outcome", "reason", "trace_hash", "state_hash"}


def _number(text: str) -> Union[int, float, None]:
    if text == "":
        return None
    return float(text) if any(c in text for c in ".eE") else int(text)


def _runs(lines: Iterable[list[str]], varied: int) -> Table:
    header, *rows = lines
    columns: dict[str, list[Any]] = {}
    for i, name in enumerate(header):
        texts = name in _TEXTS or 0 < i <= varied
        values = [row[i] if texts else _number(row[i]) for row in rows]
        columns[name] = values
    return Table(columns)


def sweep(
    scenario: ScenarioLike,
    *,
    seeds: Iterable[int] = range(100),
    vary: Optional[Mapping[str, Sequence[Any]]] = None,
    set: Optional[Mapping[str, Any]] = None,
    jobs: Optional[int] = None,
    protocol: Optional[type[Protocol]] = None,
    until: Optional[Until] = None,
    progress: Optional[Callable[[Progress], object]] = None,
    executor: Optional[Any] = None,
) -> Sweep:
    """Simulates a scenario with many seeds and all combinations of varied values, on several threads.

    The runs are those of `metamorph sweep`, whatever the number of threads or machines. A protocol written in Python holds the
    interpreter, so that its runs go to processes instead: class and `until` must be importable, and a script needs
    `if __name__ == "__main__":`.

    :param seeds: consecutive seeds.
    :param vary: values by key, such as `{"link.loss": ["0%", "5%"]}`.
    :param jobs: threads or processes; by default as many as there are processors. With an executor, the sweep is divided into
        four parts for each of so many workers.
    :param protocol: a protocol written in Python.
    :param until: when a run of this protocol is over.
    :param progress: called at most ten times a second; with an executor, after each part.
    :param executor: what the parts are handed to, each with one thread: any `concurrent.futures.Executor`, such as a process pool,
        `dask.distributed.Client.get_executor()`, or `mpi4py.futures.MPIPoolExecutor`; or an executor of submitit. Its workers need
        this package, and the files that the scenario names in the same place. Ctrl-C cancels what has not begun.
    """
    if isinstance(seeds, int):
        raise TypeError(f"seeds is {seeds}; write seeds=range({seeds}) for the seeds 0 to {seeds - 1}")
    numbers = list(seeds)
    if not numbers or numbers != list(range(numbers[0], numbers[0] + len(numbers))):
        raise ValueError("seeds must be consecutive, such as range(100)")
    chosen = _scenario(scenario, set)
    axes = [(key, [_setting("", value)[1:] for value in values]) for key, values in (vary or {}).items()]
    for key, values in axes:
        if not values:
            raise ValueError(f"vary: `{key}` has no values")
    # A value that does not vary is an axis of one value.
    of_python = [_OF_PYTHON] if protocol is not None else []
    fixed = [tuple(s.split("=", 1)) for s in [*chosen._settings, *of_python]]
    all_axes = [(key, [value]) for key, value in fixed] + axes
    manifest = _native.manifest(
        chosen._origin, chosen._text, list(chosen._faults), (numbers[0], numbers[-1] + 1), all_axes
    )
    if protocol is not None or executor is not None:
        if protocol is not None:
            _given(protocol, until, (), None)
        work = Work(chosen._origin, chosen._text, list(chosen._faults), all_axes, protocol, until)
        done = None if progress is None else lambda done, total: progress(Progress(done, total))
        lines = rows(work, numbers, jobs or len(os.sched_getaffinity(0)), done, executor)
        return Sweep(lines, len(all_axes), manifest)
    told = None if progress is None else lambda done, total: progress(Progress(done, total))
    text = _native.sweep(
        chosen._origin,
        chosen._text,
        list(chosen._faults),
        (numbers[0], numbers[0] + len(numbers)),
        all_axes,
        jobs or len(os.sched_getaffinity(0)),
        told,
        None,
    )
    return Sweep(csv.reader(io.StringIO(text)), len(all_axes), manifest)


class Simulation:
    """A simulated run that is carried out in steps.

    What is injected is part of :meth:`scenario`, so that the run can be repeated by the command.
    """

    def __init__(
        self,
        scenario: ScenarioLike,
        *,
        seed: Optional[int] = None,
        set: Optional[Mapping[str, Any]] = None,
        faults: Iterable[str] = (),
        protocol: Optional[type[Protocol]] = None,
        until: Optional[Until] = None,
        invariants: Sequence[Invariant] = (),
        every: Optional[str] = None,
    ) -> None:
        """Begins a run; the parameters are those of :func:`run`."""
        self._scenario = _scenario(scenario, set, faults)
        self._protocol = (protocol, until, tuple(invariants), every)
        plan = self._scenario._plan(seed, _given(protocol, until, invariants, every))
        self._seed = plan.seed
        self._run = _native.Simulation(plan)

    @property
    def seed(self) -> int:
        """The seed of the run."""
        return self._seed

    @property
    def now_ns(self) -> int:
        """The scenario time in nanoseconds."""
        return self._run.now_ns

    @property
    def now_s(self) -> float:
        """The scenario time in seconds."""
        return self._run.now_ns / 1e9

    @property
    def done(self) -> bool:
        """True when the run is over."""
        return self._run.done

    @property
    def outcome(self) -> Optional[str]:
        """The outcome, when the run is over."""
        return str(self.report().outcome) if self.done else None

    @property
    def trace_hash(self) -> str:
        """The hash of all events so far."""
        return self._run.trace_hash

    @property
    def state_hash(self) -> str:
        """The hash of the states of all modules."""
        return self._run.state_hash

    def step(self, events: int = 1) -> int:
        """Carries out events of the kernel; returns how many: fewer only at the end."""
        if events < 0:
            raise ValueError(f"events is {events}; a run only goes forward, so it must be 0 or more")
        return self._run.step(events)

    def advance(self, span: Duration) -> bool:
        """Runs for a span of scenario time; returns True when the run is over."""
        return self._run.run_until(self._run.now_ns + nanoseconds(span))

    def run(self, until: Optional[Duration] = None) -> bool:
        """Runs to the end, or until a scenario time; returns True when the run is over."""
        return self._run.run_until(2**63 if until is None else nanoseconds(until))

    def positions(self) -> NDArray[np.int16]:
        """The cells of all modules, x y z with z up, as an array of N × 3. Of metamodules the connector that holds.

        A module that moves is in the cell from which it comes until it arrives; :meth:`Journal.positions` rounds where its
        motion has brought it.
        """
        cells: NDArray[np.int16] = np.frombuffer(self._run.cells(), dtype=np.int16).reshape(-1, 3).copy()
        return cells

    def objects(self) -> Mapping[int, Any]:
        """The objects of living modules by number, of a protocol written in Python. Change nothing in them."""
        objects = self._run.objects()
        if objects is None:
            raise ValueError("only a simulation with `protocol=` has objects of Python")
        return MappingProxyType(objects)

    def state(self) -> Table:
        """One row for each module; of a protocol in Python, what its attributes of these names say."""
        names = ("x", "y", "z", "alive", "role", "activity", "goal", "level", "gradient", "lock", "waits_for")
        rows = [(i, *cell, *rest) for i, (cell, *rest) in enumerate(self._run.state())]
        return Table(dict(zip(("module", *names), zip(*rows))))

    def messages(self) -> Table:
        """The messages so far by class."""
        return _messages([(name, dict(zip(_COUNTS, counts))) for name, counts in self._run.messages()])

    def inject(self, fault: str) -> None:
        """Injects a fault now: `kill 7`, `restart 7`, `pause 7`, `resume 7`, `stick 7` or `unstick 7`. It strikes
        a nanosecond later, so that it does not meet what else is due at this instant."""
        at = self._run.inject(fault)
        verb, _, module = fault.strip().partition(" ")
        if verb not in ("kill", "restart"):
            self._unrepeatable = fault
            return
        self._scenario = self._scenario.with_fault(f"{verb} {int(module)}@{at}ns")

    _unrepeatable: Optional[str] = None

    def fork(self, *, links: Optional[int] = None, all: Optional[int] = None) -> Simulation:
        """A copy of the run that goes on by itself: both take the same events until something is injected into one of them.

        With a number as ``links``, the links of the copy draw other random numbers from here on; with ``all``, everything does
        that draws as the run proceeds: links, agents, joints and connections that fail. Copies with different numbers are
        independent futures of one past. Faults, starts and goals are drawn before a run, and stay.

        So one run answers several questions: run it to the instant that matters, and fork it for each. Runs of walking
        structures and of protocols in Python have no copy yet; those raise a ``ValueError``.
        """
        if links is not None and all is not None:
            raise ValueError("`all` includes links; give one of the two")
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__)
        copy._run = self._run.fork()
        for kind, number in (("links", links), ("all", all)):
            if number is not None:
                copy._scenario = copy._scenario.with_change(copy._run.change(kind, number))
        return copy

    def scenario(self) -> Scenario:
        """The scenario with what was injected; simulated with the same seed it has the same trace hash."""
        if self._unrepeatable is not None:
            raise MetamorphError(f"`{self._unrepeatable}` was injected, which cannot be written as a fault of a scenario")
        return self._scenario

    def __reduce__(self) -> tuple[Any, ...]:
        """A simulation is pickled as its scenario, with what was injected, and the time; loading carries it out again."""
        return _again, (self.scenario(), self._seed, *self._protocol, self.now_ns, self.trace_hash)

    def report(self) -> Report:
        """The report so far; before the end its outcome is `aborted`."""
        return Report(json.loads(self._run.report()))


def _again(
    scenario: Scenario,
    seed: int,
    protocol: Optional[type[Protocol]],
    until: Optional[Until],
    invariants: Sequence[Invariant],
    every: Optional[str],
    now_ns: int,
    trace_hash: str,
) -> Simulation:
    """Carries a simulation out until the time and the events that it was pickled at."""
    sim = Simulation(scenario, seed=seed, protocol=protocol, until=until, invariants=invariants, every=every)
    if now_ns > 0:
        sim._run.run_until(now_ns - 1)
    while sim.trace_hash != trace_hash and sim.now_ns <= now_ns and sim.step():
        pass
    if sim.now_ns < now_ns:
        sim._run.run_until(now_ns)
    if sim.trace_hash != trace_hash:
        raise MetamorphError("the simulation was pickled by another version of metamorph, or its protocol has changed")
    return sim


__all__ = ["Duration", "Progress", "Report", "Scenario", "ScenarioError", "Simulation", "Sweep", "run", "scenarios", "sweep"]
