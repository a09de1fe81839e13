"""Figures, comparisons and checks of the machine: made by the program `metamorph`, so that they are those of the command
line."""

from __future__ import annotations

import json
import os
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any, NamedTuple, Optional, Sequence, Union
from urllib.parse import quote

from . import _program
from ._api import Report, ScenarioLike, Simulation, Sweep, _scenario, _written
from ._embedded import within
from ._errors import ProgramError
from ._journal import Journal
from ._program import Program
from ._table import Table

PathLike = Union[str, "os.PathLike[str]"]


def _call(*words: str, program: Optional[Program] = None) -> bytes:
    command, environment = program or _program.own()
    done = subprocess.run([*command, *words], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    if done.returncode != 0:
        text = done.stderr.decode(errors="replace").strip()
        raise ProgramError(text or f"the program ended with exit code {done.returncode}")
    return done.stdout


def _that_shows(journal: Journal) -> Program:
    """What shows a journal: the program, or this package if the protocol of the run is written in Python."""
    return within(journal._protocol, None) if journal.family == "python" else _program.own()


class Figure:
    """A figure; a notebook shows it."""

    def __init__(self, data: bytes, format: str) -> None:
        #: The content of the file.
        self.data = data
        #: `"svg"`, `"png"`, `"gif"` or `"apng"`.
        self.format = format

    def save(self, path: PathLike) -> None:
        """Writes the figure to a file."""
        Path(path).write_bytes(self.data)

    def _repr_svg_(self) -> Optional[str]:
        return self.data.decode() if self.format == "svg" else None

    def _repr_png_(self) -> Optional[bytes]:
        return self.data if self.format in ("png", "apng") else None

    def _repr_html_(self) -> Optional[str]:
        if self.format != "gif":
            return None
        import base64

        return f'<img src="data:image/gif;base64,{base64.b64encode(self.data).decode()}">'

    def __repr__(self) -> str:
        return f"<Figure, {self.format}, {len(self.data)} bytes>"


def _options(options: dict[str, Any]) -> list[str]:
    words = []
    for name, value in options.items():
        for one in value if isinstance(value, (list, tuple)) else [value]:
            text = {True: "on", False: "off"}.get(one, str(one)) if isinstance(one, bool) else str(one)
            words.append(f"--{name.replace('_', '-')}={text}")
    return words


def render(
    source: Union[ScenarioLike, Journal, Simulation],
    out: Optional[PathLike] = None,
    *,
    seed: Optional[int] = None,
    format: str = "svg",
    **options: Any,
) -> Figure:
    """Draws a moment of a run, or a moving picture, as `metamorph render` does.

    :param source: a journal or its file, a scenario file, the name of a shipped scenario, a :class:`Scenario`, its
        keys, or a :class:`Simulation`, which is drawn at its present time.
    :param out: a file to write as well; its name says the format.
    :param seed: the seed of a scenario.
    :param format: the format without `out`: svg, pdf, png, gif, apng or mp4.
    :param options: those of the command, such as `at="50%"`, `camera="top"`, `section=["x<11"]`, `legend=False`.
    """
    words = _options(options)
    program = None
    with tempfile.TemporaryDirectory() as directory:
        if isinstance(source, Simulation):
            if "at" not in options:
                words.append(f"--at={source.now_ns}ns")
            suffix = format if out is None else Path(out).suffix[1:]
            drawn = source._run.render(suffix, "&".join(quote(word[2:], safe="=") for word in words))
            if drawn is not None:
                if out is not None:
                    Path(out).write_bytes(drawn)
                return Figure(drawn, suffix)
            seed = source.seed if seed is None else seed
            source = source.scenario()
        if isinstance(source, Journal):
            program = _that_shows(source)
            source = source.path
        if isinstance(source, (str, os.PathLike)):
            file = os.fspath(source)
        else:
            file, extra = _written(_scenario(source), Path(directory))
            words += extra
        words += [] if seed is None else [f"--seed={seed}"]
        target = Path(directory) / f"figure.{format}" if out is None else Path(out)
        _call("render", file, "--quiet", f"--out={target}", *words, program=program)
        return Figure(target.read_bytes(), target.suffix[1:])


class Page:
    """Runs in the browser, as `metamorph view` shows them; a notebook on this machine shows them side by side.

    The pages are served until :meth:`close` is called or the object is gone.
    """

    def __init__(self, sources: Sequence[Union[ScenarioLike, Journal]], seed: Optional[int], height: int) -> None:
        self._directory = tempfile.TemporaryDirectory()
        self._height = height
        self._served: list[subprocess.Popen[str]] = []
        #: The addresses of the pages, for a browser of this machine.
        self.urls: list[str] = []
        try:
            for number, source in enumerate(sources):
                self.urls.append(self._serve(source, seed, Path(self._directory.name) / str(number)))
        except BaseException:
            self.close()
            raise

    def _serve(self, source: Union[ScenarioLike, Journal], seed: Optional[int], directory: Path) -> str:
        words: list[str] = []
        program = _program.own()
        if isinstance(source, Journal):
            file, program = source.path, _that_shows(source)
        elif isinstance(source, (str, os.PathLike)):
            file = os.fspath(source)
        else:
            directory.mkdir()
            file, words = _written(_scenario(source), directory)
        words += [] if seed is None or isinstance(source, Journal) else [f"--seed={seed}"]
        server = subprocess.Popen(
            [*program.command, "view", file, "--embed", *words],
            env=program.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._served.append(server)
        assert server.stdout is not None and server.stderr is not None
        found = re.search(r"http://\S+", server.stdout.readline())
        if found is None:
            raise ProgramError(server.stderr.read().strip() or "the program ended without a page")
        return found[0]

    def close(self) -> None:
        """Ends serving the pages."""
        for server in self._served:
            if server.poll() is None:
                server.terminate()
            server.wait()
            for stream in (server.stdout, server.stderr):
                if stream is not None:
                    stream.close()
        self._served = []
        self._directory.cleanup()

    def __enter__(self) -> Page:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        if hasattr(self, "_served"):
            self.close()

    def _repr_html_(self) -> str:
        frame = f'style="flex:1 1 24em;height:{self._height}px;border:0" title="a run"'
        frames = "".join(f'<iframe src="{url}" {frame}></iframe>' for url in self.urls)
        return f'<div style="display:flex;flex-wrap:wrap;gap:8px">{frames}</div>'

    def __repr__(self) -> str:
        return f"<Page, open {' and '.join(self.urls)} in a browser>"


def view(*sources: Union[ScenarioLike, Journal], seed: Optional[int] = None, height: int = 480) -> Page:
    """Shows runs in the browser; a notebook shows the pages side by side.

    :param sources: journals or their files, or scenarios, which are simulated.
    :param seed: the seed of scenarios.
    :param height: the height of each page in a notebook, in pixels.
    """
    if not sources:
        raise ValueError("view needs at least one run: a journal or a scenario")
    return Page(sources, seed, height)


def export(journal: Journal, out: PathLike, *, schema: str = "foxglove") -> None:
    """Writes a journal as a recording (MCAP) for other viewers, as `metamorph export --mcap` does.

    :param out: the file.
    :param schema: `"foxglove"` or `"ros2"`.
    """
    words = ("export", journal.path, f"--mcap={os.fspath(out)}", f"--schema={schema}")
    _call(*words, program=_that_shows(journal))


class Diff(NamedTuple):
    """A comparison of two sweeps or reports."""

    #: `"sweeps"` or `"reports"`.
    kind: str
    #: One row for each measure, or for each field that differs.
    lines: Table
    #: What `metamorph diff` prints.
    text: str


def diff(
    a: Union[Report, Sweep, PathLike],
    b: Union[Report, Sweep, PathLike],
    *,
    at_least: str = "0%",
    by: Sequence[str] = (),
) -> Diff:
    """Compares two reports, or two sweeps: which measures differ, by how much, with 95 % intervals.

    :param a: a report or its file, or a sweep or a directory that `metamorph sweep --out` or :meth:`Sweep.save` wrote.
    :param b: another one of the same kind.
    :param at_least: of sweeps, say that a measure differs only if its whole interval is beyond this share.
    :param by: of sweeps, the keys for whose values they are compared; default: those that both vary.
    """
    with tempfile.TemporaryDirectory() as directory:
        paths = []
        for name, one in (("a", a), ("b", b)):
            if isinstance(one, Report):
                path = Path(directory) / f"{name}.json"
                path.write_text(one.to_json())
                paths.append(str(path))
            elif isinstance(one, Sweep):
                path = Path(directory) / name
                one.save(path)
                paths.append(str(path))
            else:
                paths.append(os.fspath(one))
        found = Path(directory) / "diff.json"
        keys = [f"--by={key}" for key in by]
        text = _call("diff", *paths, f"--at-least={at_least}", *keys, f"--json={found}").decode()
        content = json.loads(found.read_text())
    rows = content["lines"] if content["kind"] == "sweeps" else content["differences"]
    names = list(rows[0]) if rows else []
    return Diff(content["kind"], Table({name: [row[name] for row in rows] for name in names}), text)


def doctor(modules: int = 200) -> list[dict[str, Any]]:
    """What of this machine limits a swarm of processes, as `metamorph doctor` says it: one dictionary for each check."""
    done = subprocess.run(
        [_program.find(), "doctor", f"--modules={modules}", "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    if not done.stdout:
        raise ProgramError(done.stderr.decode(errors="replace").strip())
    checks: list[dict[str, Any]] = json.loads(done.stdout)
    return checks
