"""A protocol written in Python on a graph of contacts: 50 modules on a ring agree on the average of their values by pairwise
gossip, while a partition cuts the ring for a while. Every exchange keeps the sum, or an invariant says so.

A module offers its value to a neighbour and waits for the answer; both then take the mean (Boyd, Ghosh, Prabhakar and Shah,
"Randomized gossip algorithms", 2006). Values are whole numbers, so the half that is left over stays with one of the two."""

from __future__ import annotations

from typing import Mapping, Optional

import metamorph as mm

COUNT = 50
#: The largest difference between two modules at the end.
CLOSE = 25


@mm.message(kind=0, cls="seed")
class Offer:
    """The value of a module that offers an exchange, and the number of the exchange."""

    value: mm.i32
    number: mm.u32


@mm.message(kind=1, cls="seed")
class Answer:
    """What the one that offered has to add to its value; it is kept until the exchange is known to be over."""

    change: mm.i32
    number: mm.u32


class Gossip(mm.Protocol):
    messages = [Offer, Answer]
    repeat = mm.Param("200ms")

    def start(self, ctx: mm.Context) -> None:
        self.value = 1000 * (self.id % 10)
        # The exchange that this module has offered: port and number. Its value does not change meanwhile.
        self.offered: Optional[tuple[int, int]] = None
        self.number = 0
        # The last exchange with the neighbour at each port: its number and the answer, which is repeated if it was lost.
        self.answered: dict[int, tuple[int, int]] = {}
        ctx.report(Offer(self.value, 0))
        ctx.wake_after(self.repeat)

    def wake(self, ctx: mm.Context) -> None:
        ctx.wake_after(self.repeat)
        if self.offered is None and ctx.ports_up and ctx.random.chance("1/2"):
            self.number += 1
            self.offered = (ctx.ports_up[ctx.random.below(len(ctx.ports_up))], self.number)
        if self.offered is not None:
            ctx.send(self.offered[0], Offer(self.value, self.offered[1]))

    def receive(self, ctx: mm.Context, port: int, message: object) -> None:
        if isinstance(message, Answer):
            if self.offered == (port, message.number):
                self.offered = None
                self.change(ctx, message.change)
        elif isinstance(message, Offer):
            last, answer = self.answered.get(port, (0, 0))
            if message.number > last:
                # While its own value is on offer, a module gives no part of it away. It answers all the same: modules that
                # waited for each other in a circle would wait for ever.
                answer = 0 if self.offered is not None else (self.value - message.value) // 2
                last = message.number
                self.answered[port] = (last, answer)
                self.change(ctx, -answer)
            if message.number == last:
                ctx.send(port, Answer(answer, last))

    def change(self, ctx: mm.Context, by: int) -> None:
        self.value += by
        if by:
            ctx.report(Offer(self.value, 0))


def agreed(reports: Mapping[int, Offer], now_s: float) -> Optional[str]:
    """The run is over when all values are close to each other."""
    values = [report.value for report in reports.values()]
    return "built" if len(values) == COUNT and max(values) - min(values) <= CLOSE else None


def keeps_the_sum(modules: Mapping[int, Gossip], now_s: float) -> Optional[str]:
    """An invariant: apart from what is on its way in answers, the sum of all values stays."""
    if len(modules) < COUNT:
        return None
    pending = 0
    for module in modules.values():
        if module.offered is not None:
            port, number = module.offered
            # On a ring port 0 leads to the next module and port 1 to the one before, which has the other port here.
            peer = modules[(module.id + (1 if port == 0 else -1)) % COUNT]
            last, answer = peer.answered.get(1 - port, (0, 0))
            pending += answer if last == number else 0
    total = sum(module.value for module in modules.values()) + pending
    wanted = sum(1000 * (i % 10) for i in range(COUNT))
    return None if total == wanted else f"the sum is {total}, not {wanted}"


SCENARIO = {
    "version": 1,
    "swarm": {"graph": {"ring": COUNT}},
    "link": {"delay": "10ms..50ms", "loss": "10%"},
    "fault": [{"partition": {"modules": list(range(20)), "from": "1s", "until": "20s"}}],
    "stop": {"timeout": "3000s"},
}

if __name__ == "__main__":
    report = mm.run(SCENARIO, protocol=Gossip, until=agreed, invariants=[keeps_the_sum], journal="gossip.journal")
    print(f"{report.outcome} at {report.time['virtual_s']} s, {report.messages['total']:,} messages, trace {report.trace_hash}")
    journal = mm.Journal("gossip.journal", protocol=Gossip, until=agreed)
    print("carried out again:", journal.verify() or "the same")
    mm.render(journal, "gossip.svg", camera="top")
