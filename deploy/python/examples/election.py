"""A protocol written in Python: 100 modules elect the one with the lowest number, while messages are lost and a module is
killed and restarted. The protocol is that of `deploy/tutorial`, event by event."""

from __future__ import annotations

from typing import Mapping, Optional

import metamorph as mm


@mm.message(kind=0, cls="seed")
class Lowest:
    """The lowest number that a module has heard of."""

    id: mm.u32


class Leader(mm.Protocol):
    messages = [Lowest]
    repeat = mm.Param("500ms")

    def start(self, ctx: mm.Context) -> None:
        self.lowest = self.id
        ctx.report(Lowest(self.lowest))
        ctx.wake_after(self.repeat)

    def contact(self, ctx: mm.Context, port: int, up: bool) -> None:
        if up:
            ctx.send(port, Lowest(self.lowest))

    def receive(self, ctx: mm.Context, port: int, message: Lowest) -> None:
        if message.id < self.lowest:
            self.lowest = message.id
            ctx.report(message)
            ctx.broadcast(message)

    def wake(self, ctx: mm.Context) -> None:
        ctx.wake_after(self.repeat)
        ctx.broadcast(Lowest(self.lowest))


def agreed(reports: Mapping[int, Lowest], now_s: float) -> Optional[str]:
    """The run is over when all modules name the lowest number."""
    return "built" if len(reports) == 100 and all(r.id == 0 for r in reports.values()) else None


def no_number_is_made_up(modules: Mapping[int, Leader], now_s: float) -> Optional[str]:
    """An invariant: no module names a leader with a higher number than its own."""
    wrong = [i for i, module in modules.items() if module.lowest > i]
    return f"modules {wrong} name higher numbers than their own" if wrong else None


SCENARIO = {
    "version": 1,
    "swarm": {"start": {"box": {"min": [0, 0, 0], "max": [9, 9, 0]}}},
    "link": {"delay": "10ms..50ms"},
}
FAULTS = ["kill 7@100ms", "restart 7@800ms"]

if __name__ == "__main__":
    report = mm.run(
        SCENARIO,
        protocol=Leader,
        until=agreed,
        invariants=[no_number_is_made_up],
        set={"link.loss": "5%"},
        faults=FAULTS,
    )
    print(f"{report.outcome} at {report.time['virtual_s']} s, trace {report.trace_hash}")
    counts = report.messages_by_class.to_dict()
    print({name: counts[name][counts["class"].index("seed")] for name in ("sent", "delivered", "lost", "expired")})
    mm.check_determinism(Leader, SCENARIO, set={"link.loss": "5%"}, faults=FAULTS, until=agreed)
    sweep = mm.sweep(SCENARIO, protocol=Leader, until=agreed, seeds=range(10), vary={"protocol.repeat": ["200ms", "1s"]})
    print(sweep.runs["outcome"].tolist().count("built"), "of", len(sweep), "built")
