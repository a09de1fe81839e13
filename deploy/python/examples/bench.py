"""What Python costs: steps from Python against the same loop in Rust, and a protocol written in Python by event. Figures are
medians of interleaved rounds."""

from __future__ import annotations

import statistics
import time
from typing import Callable, Mapping

import metamorph as mm
from election import Leader

EVENTS = 10_000
ROUNDS = 15


def seconds(work: Callable[[], object]) -> float:
    """Time of the processor, so that other programs count less."""
    before = time.process_time()
    work()
    return time.process_time() - before


def one_by_one(sim: mm.Simulation, events: int) -> None:
    for _ in range(EVENTS // events):
        sim.step(events)


def stepped() -> None:
    """Ratios of calls of `step` to one call, whose loop is in Rust."""
    times: dict[int, list[float]] = {EVENTS: [], 100: [], 1: []}
    for _ in range(ROUNDS):
        for events, found in times.items():
            sim = mm.Simulation("swarm", seed=1)
            found.append(seconds(lambda: one_by_one(sim, events)))
    whole = statistics.median(times[EVENTS])
    for events in (1, 100):
        ratio = statistics.median(times[events]) / whole
        print(f"{EVENTS} events, {events} a call: {ratio:.2f} of the time of one call")


def protocol() -> None:
    """Time of the election by message that arrives."""
    plate = {
        "version": 1,
        "swarm": {"start": {"box": {"min": [0, 0, 0], "max": [29, 29, 0]}}},
        "link": {"delay": "10ms..50ms", "loss": "5%"},
    }

    def over(reports: Mapping[int, object], now_s: float) -> bool:
        return now_s >= 3

    found, delivered = [], 0
    for _ in range(3):
        sim = mm.Simulation(plate, protocol=Leader, until=over)
        found.append(seconds(sim.run))
        delivered = sum(sim.messages()["delivered"])
    each = statistics.median(found) / delivered * 1e6
    print(f"election, 900 modules: {each:.2f} µs for each of {delivered} messages, kernel included")


if __name__ == "__main__":
    stepped()
    protocol()
