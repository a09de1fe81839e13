"""Whether a protocol written in Python makes the same run in every interpreter."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, Any, Iterable, Mapping, NamedTuple, Optional

from . import _metamorph as _native
from ._errors import ProtocolError
from ._processes import must_be_importable
from ._protocol import Protocol, Until

if TYPE_CHECKING:
    from ._api import Duration, Scenario, ScenarioLike


class Moment(NamedTuple):
    """What two runs are compared by."""

    now_ns: int
    trace_hash: str
    #: Hashes of the attributes by module and name.
    parts: dict[tuple[int, str], str]


def moments(
    scenario: Scenario, seed: int, protocol: type[Protocol], until: Optional[Until], every: Duration
) -> list[Moment]:
    """Carries a run out; called in an interpreter of its own."""
    from ._api import Simulation

    sim, found, over = Simulation(scenario, seed=seed, protocol=protocol, until=until), [], False
    while not over:
        over = sim.advance(every)
        parts = {}
        for module, object in sim.objects().items():
            for name, content in _native.state_parts(object, type(object).state is not Protocol.state):
                parts[module, name] = hashlib.blake2b(content, digest_size=8).hexdigest()
        found.append(Moment(sim.now_ns, sim.trace_hash, parts))
    return found


def _differ(a: Moment, b: Moment) -> Optional[tuple[Optional[int], str]]:
    """The first module and attribute that differ, or None and what else does."""
    for module, name in sorted({*a.parts, *b.parts}):
        if a.parts.get((module, name)) != b.parts.get((module, name)):
            return module, f"`{name}` of module {module}"
    return (None, "the events") if a[:2] != b[:2] else None


def check_determinism(
    protocol: type[Protocol],
    scenario: ScenarioLike,
    *,
    seeds: int = 3,
    set: Optional[Mapping[str, Any]] = None,
    faults: Iterable[str] = (),
    until: Optional[Until] = None,
    every: Duration = "100ms",
) -> None:
    """Carries the same runs out in two interpreters with different `PYTHONHASHSEED`, and compares the states of all
    modules. Raises :class:`ProtocolError` with the first module and attribute that differ: the protocol then uses what
    is not the same in every run, such as `random`, a clock, `hash`, or the order of a set.

    :param seeds: the number of runs.
    :param every: the time between two comparisons.
    """
    from ._api import _scenario

    must_be_importable(protocol, until)
    chosen = _scenario(scenario, set, faults)
    before, runs = os.environ.get("PYTHONHASHSEED"), []
    try:
        for hash_seed in ("1", "2"):
            os.environ["PYTHONHASHSEED"] = hash_seed
            with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
                futures = [pool.submit(moments, chosen, seed, protocol, until, every) for seed in range(seeds)]
                runs.append([future.result() for future in futures])
    finally:
        if before is None:
            del os.environ["PYTHONHASHSEED"]
        else:
            os.environ["PYTHONHASHSEED"] = before
    for seed, (one, other) in enumerate(zip(*runs)):
        for a, b in zip(one, other):
            found = _differ(a, b)
            if found is not None:
                module, what = found
                text = f"{protocol.__name__} is not deterministic: seed {seed}, at {a.now_ns / 1e9} s, {what} differs"
                raise ProtocolError(text, module, a.now_ns, "check_determinism")
