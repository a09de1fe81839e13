"""Runs of protocols written in Python, in processes of their own: a protocol holds the interpreter while it runs."""

from __future__ import annotations

import csv
import io
import multiprocessing
import pickle
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Callable, NamedTuple, Optional

from . import _metamorph as _native
from ._protocol import Protocol, Until

#: Parts of a sweep for each process: more parts share the work more evenly.
PARTS = 4


class Work(NamedTuple):
    """A sweep, without its seeds."""

    origin: str
    text: str
    faults: list[str]
    axes: list[tuple[str, list[str]]]
    protocol: type[Protocol]
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
    """The rows of some seeds; called in a process of its own."""
    given = _native.Protocol(work.protocol, work.until, [], None)
    return _native.sweep(work.origin, work.text, work.faults, (first, last), work.axes, 1, None, given)


def rows(
    work: Work, seeds: list[int], jobs: int, progress: Optional[Callable[[int, int], object]]
) -> list[list[str]]:
    """The header and the rows of a sweep, in the order of one process."""
    must_be_importable(work.protocol, work.until)
    combinations = 1
    for _, values in work.axes:
        combinations *= len(values)
    length = max(1, -(-len(seeds) // (jobs * PARTS)))
    starts = range(0, len(seeds), length)
    found: dict[int, list[str]] = {}
    header: list[str] = []
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = {}
        for start in starts:
            some = seeds[start : start + length]
            futures[pool.submit(part, work, some[0], some[-1] + 1)] = (start, len(some))
        try:
            for future in as_completed(futures):
                start, count = futures[future]
                header, *lines = csv.reader(io.StringIO(future.result()))
                for number, line in enumerate(lines):
                    run = number // count * len(seeds) + start + number % count
                    found[run] = [str(run), *line[1:]]
                if progress is not None:
                    progress(len(found), len(seeds) * combinations)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [header, *(found[run] for run in sorted(found))]
