"""Sweeps in parts: by an executor, which may be a cluster, or in processes of their own for protocols written in Python, which
hold the interpreter while they run."""

from __future__ import annotations

import csv
import io
import multiprocessing
import pickle
import sys
import time
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Callable, Iterator, NamedTuple, Optional, Sequence

from . import _metamorph as _native
from ._protocol import Protocol, Until

#: Parts of a sweep for each process: more parts share the work more evenly.
PARTS = 4
#: Seconds between two looks at jobs that cannot be waited for.
LOOK = 0.5


class Work(NamedTuple):
    """A sweep, without its seeds."""

    origin: str
    text: str
    faults: list[str]
    axes: list[tuple[str, list[str]]]
    protocol: Optional[type[Protocol]]
    until: Optional[Until]


def must_be_importable(*given: object) -> None:
    """Raises an error that says what to do if a process of its own could not import these."""
    fix = "write class, messages and functions at the top of a module, so that other processes import them"
    try:
        pickle.dumps(given)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise ValueError(f"{error}; {fix}") from None
    # Without a file, as in a notebook, other processes have no such module.
    if not hasattr(sys.modules["__main__"], "__file__"):
        for one in given:
            if getattr(one, "__module__", None) == "__main__":
                raise ValueError(f"{one!r} is in no file; {fix}")


def part(work: Work, first: int, last: int) -> str:
    """The rows of some seeds; called in a process of its own, or on another machine."""
    given = None if work.protocol is None else _native.Protocol(work.protocol, work.until, [], None)
    return _native.sweep(work.origin, work.text, work.faults, (first, last), work.axes, 1, None, given)


def _submit(executor: Any, work: Work, spans: Sequence[tuple[int, int]]) -> list[Any]:
    """Hands in all parts. What submitit gets in a batch is one job array, whose jobs exist when the batch ends."""
    batch: AbstractContextManager[Any] = executor.batch() if hasattr(executor, "batch") else nullcontext()
    with batch:
        return [executor.submit(part, work, first, last) for first, last in spans]


def _completed(jobs: list[Any]) -> Iterator[Any]:
    """The jobs in the order of their ends. Those that are no futures of the standard library are looked at now and then."""
    if all(isinstance(job, Future) for job in jobs):
        yield from as_completed(jobs)
        return
    left = list(jobs)
    while left:
        ended = [job for job in left if job.done()]
        yield from ended
        left = [job for job in left if job not in ended]
        if left and not ended:
            time.sleep(LOOK)


def rows(
    work: Work,
    seeds: list[int],
    jobs: int,
    progress: Optional[Callable[[int, int], object]],
    executor: Optional[Any] = None,
) -> list[list[str]]:
    """The header and the rows of a sweep, in the order of one process."""
    if work.protocol is not None:
        must_be_importable(work.protocol, work.until)
    combinations = 1
    for _, values in work.axes:
        combinations *= len(values)
    length = max(1, -(-len(seeds) // (jobs * PARTS)))
    spans = [(some[0], some[-1] + 1) for start in range(0, len(seeds), length) if (some := seeds[start : start + length])]
    found: dict[int, list[str]] = {}
    header: list[str] = []
    own = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) if executor is None else None
    submitted: list[Any] = []
    try:
        submitted = _submit(own or executor, work, spans)
        span_of = {id(job): span for job, span in zip(submitted, spans)}
        for job in _completed(submitted):
            (first, last), text = span_of[id(job)], job.result()
            header, *lines = csv.reader(io.StringIO(text))
            start, count = first - seeds[0], last - first
            for number, line in enumerate(lines):
                run = number // count * len(seeds) + start + number % count
                found[run] = [str(run), *line[1:]]
            if progress is not None:
                progress(len(found), len(seeds) * combinations)
    except BaseException:
        for job in submitted:
            job.cancel()
        if own is not None:
            own.shutdown(wait=False, cancel_futures=True)
        raise
    if own is not None:
        own.shutdown()
    return [header, *(found[run] for run in sorted(found))]
