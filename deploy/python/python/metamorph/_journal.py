"""Journals as tables and arrays."""

from __future__ import annotations

import os
from typing import Any, Iterable, Optional, Union

import numpy as np
from numpy.typing import NDArray

from . import _metamorph as _native
from ._protocol import Protocol, Until, _given
from ._table import Table
from ._time import Duration, nanoseconds

#: The classes of messages, in the order of their numbers.
CLASSES = ("gradient", "seed", "connectivity", "negotiation", "world", "liveness", "gait")


class Journal:
    """A run that was recorded with `journal=` or `--journal`. Raises :class:`JournalError` if the file is damaged."""

    def __init__(
        self,
        path: Union[str, os.PathLike[str]],
        *,
        protocol: Optional[type[Protocol]] = None,
        until: Optional[Until] = None,
    ) -> None:
        """Reads a journal.

        :param path: the file.
        :param protocol: the class of a run with a protocol written in Python. What happened can be read without it; it names the
            messages on the page, and :meth:`verify` needs it.
        :param until: what ended such a run, for :meth:`verify`.
        """
        #: The file.
        self.path = os.fspath(path)
        self._protocol = protocol
        self._journal = _native.Journal(self.path, _given(protocol, until, (), None))

    @property
    def family(self) -> str:
        """The family of the modules; `"python"` if their protocol is written in Python."""
        return self._journal.family

    @property
    def modules(self) -> int:
        """The number of modules."""
        return self._journal.modules

    @property
    def duration_s(self) -> float:
        """The scenario time of the last event in seconds."""
        return self._journal.duration_ns / 1e9

    @property
    def state_names(self) -> list[str]:
        """The names of the numbers in :meth:`states`."""
        return self._journal.state_names

    def events(self) -> Table:
        """What happened, one row for each event: `time_s`, `event`, `module` (missing if it was not one), `text`.

        Events: moves, failed, refused (actions of bodies), reports (the role of a module), died, restarted, paused,
        resumed, fault, obstacles, goal.
        """
        rows = self._journal.events()
        return Table(
            {
                "time_s": [at / 1e9 for at, _, _, _ in rows],
                "event": [event for _, event, _, _ in rows],
                "module": [module for _, _, module, _ in rows],
                "text": [text for _, _, _, text in rows],
            }
        )

    def messages_over_time(self, bin: Duration = "1s") -> Table:
        """The messages delivered in each span of time, one column for each class."""
        width = nanoseconds(bin)
        if width == 0:
            raise ValueError("bin must be longer than 0 s")
        counts = self._journal.messages(width)
        columns: dict[str, list[float]] = {"time_s": [i * width / 1e9 for i in range(len(counts))]}
        for i, name in enumerate(CLASSES):
            columns[name] = [row[i] for row in counts]
        return Table(columns)

    def over_time(self) -> Table:
        """The course of the run, one row for each time bin of the page of `metamorph view`: the time of its end in
        seconds, the cells of the goal that are filled then and those that it has, the moves completed in it, and the
        messages delivered in it by class."""
        width, bins = self._journal.bins()
        names = ("filled", "goal", "moves", *CLASSES)
        columns: dict[str, list[float]] = {
            "time_s": [min((i + 1) * width, self._journal.duration_ns) / 1e9 for i in range(len(bins))]
        }
        for i, name in enumerate(names):
            columns[name] = [row[i] for row in bins]
        return Table(columns)

    def per_module(self) -> Table:
        """Figures of each module: actions (moves of cubes, turns of joints) begun, failed and refused, deaths of its process,
        messages sent and received by class, bytes received, and the latency that half and 99 % of the messages it received do not exceed, in seconds."""
        rows = self._journal.per_module()
        columns: dict[str, list[Any]] = {"module": list(range(len(rows)))}
        for i, name in enumerate(("actions", "failed", "refused", "deaths")):
            columns[name] = [row[0][i] for row in rows]
        for i, name in enumerate(CLASSES):
            columns[f"sent_{name}"] = [row[1][i] for row in rows]
        for i, name in enumerate(CLASSES):
            columns[f"received_{name}"] = [row[2][i] for row in rows]
        columns["received_bytes"] = [row[3] for row in rows]
        for i, name in enumerate(("latency_p50_s", "latency_p99_s")):
            columns[name] = [_seconds(row[4][i]) for row in rows]
        return Table(columns)

    def positions(self, times_s: Iterable[Duration]) -> NDArray[np.int16]:
        """The cells of all modules at these times, in ascending order, as an array of T × N × 3; of metamodules the
        first cell. A module on its way is where the motion has brought it, rounded to a cell."""
        times = _ascending(times_s)
        cells = np.frombuffer(self._journal.positions(times), dtype=np.int16)
        return cells.reshape(len(times), self.modules, 3).copy()

    def states(self, times_s: Iterable[Duration]) -> NDArray[np.uint8]:
        """The states of all modules at these times, in ascending order, as an array of T × N; see
        :attr:`state_names`."""
        times = _ascending(times_s)
        states = np.frombuffer(self._journal.states(times), dtype=np.uint8)
        return states.reshape(len(times), self.modules).copy()

    def verify(self) -> Optional[str]:
        """Carries the run out again from the recorded inputs. Returns the first difference, or None."""
        return self._journal.verify()

    def __repr__(self) -> str:
        return f"<Journal of {self.modules} modules, {self.duration_s:g} s>"


def _seconds(ns: Optional[int]) -> Optional[float]:
    return None if ns is None else ns / 1e9


def _ascending(times_s: Iterable[Duration]) -> list[int]:
    times = [nanoseconds(t) for t in times_s]
    if times != sorted(times):
        raise ValueError("times must be in ascending order")
    return times
