"""Floor locks of metamodules.

*Modelled.* `protocol/agents/src/metamodule/locks.rs`, `inputs.rs`, `execution.rs` and `phase.rs`. A
metamodule that wants to move asks all others in range that may move (`Requester::ports_to_ask`). One that
is asked grants nothing while it listens after a restart, and refuses if its body is in a cell of the motion
or if its own motion crosses it; if it only asks itself for a motion that crosses, it refuses or gives that
up, by an order in which the two need not agree (`judge`, `Metamodule::on_request`). The motion begins when
all have granted it (`Metamodule::set_out`). Its last action ends within a lease of the request
(`Motion::next`; the body refuses later actions). A grant ends with a release, with its lease, or before: it
is replaced when a late copy of another request of the same neighbour comes, since a port has one grant, and
forgotten when the neighbour begins another contact, or is dead (`LockTable`). A restarted metamodule
neither asks nor grants for one lease (`Metamodule::new`), and does not know that its body still carries out
an action of its earlier life. Messages are facts: what was sent can arrive at any later time, any number of
times, or never.

*Coarser than the code.* A grant may be forgotten at any time. The planners avoid the cells that have been
granted; the model lets them plan across these. A request may be granted although its attempt is over. A
body moves in all cells of its motion at once and may stop anywhere in them.

*Shown.* Two motions under way have no cell in common; no body of one that was asked is in a cell of a
motion under way; a motion ends within its own lease and within every grant of it that is remembered.

*The reason* is that both ask each other. Of two attempts with a common cell at most one is
granted by the other's origin while both last. Grants that are remembered only save attempts.

*Assumed.* Attempts with a common cell are in range of each other from the request on, and ask each other;
who is not asked stays (it is settled in the same task, or dead and at rest, and motions are planned around
it). During a lease no clock gains on another: unlike the cubes' leases, these have no margin for drift. A
message and the start of a process take some time. Not modelled: elements that two metamodules carry, and
attachment to the floor.
"""

from inductive import Model, Part, all_of, any_of, choose, fixed, implies, no, put, where


def build(defect: str | None = None) -> Model:
    """Returns the model, with a defect if one is named."""
    m = Model("floor_locks", sizes={"Cell": 2})
    m.rigid = {
        "lease": ("Real",),
        "skew": ("Real",),
        "origin": ("Attempt", "Metamodule"),
        "asks": ("Attempt", "Metamodule", "Bool"),
        "sweeps": ("Attempt", "Cell", "Bool"),
        "crosses": ("Attempt", "Attempt", "Bool"),
    }
    m.state = {
        "now": ("Real",),
        "asked": ("Attempt", "Bool"),
        "asked_at": ("Attempt", "Real"),
        "over": ("Attempt", "Bool"),
        "moving": ("Attempt", "Bool"),
        # The body moves for an earlier life of its metamodule, which does not know it.
        "orphaned": ("Attempt", "Bool"),
        # The answers that were given, and those that the mover has heard.
        "granted": ("Attempt", "Metamodule", "Bool"),
        "heard": ("Attempt", "Metamodule", "Bool"),
        # The grants that are remembered, and their ends.
        "kept": ("Metamodule", "Attempt", "Bool"),
        "until": ("Metamodule", "Attempt", "Real"),
        "dead": ("Metamodule", "Bool"),
        "listens_until": ("Metamodule", "Real"),
        "body": ("Metamodule", "Cell", "Bool"),
    }

    def axioms(s):
        def known(a, b, c):
            both = all_of(s.sweeps(a, c), s.sweeps(b, c), no(s.origin(a) == s.origin(b)))
            return implies(both, s.crosses(a, b))

        def mutual(a, b):
            apart = no(s.origin(a) == s.origin(b))
            asks = all_of(s.asks(a, s.origin(b)), s.asks(b, s.origin(a)), s.crosses(b, a))
            return implies(all_of(s.crosses(a, b), apart), asks)

        return [
            s.lease() > 0,
            s.skew() >= 0,
            s.every("Attempt Attempt Cell", known),
            s.every("Attempt Attempt", mutual),
            s.every("Attempt", lambda a: no(s.asks(a, s.origin(a)))),
        ]

    m.axioms = axioms

    def active(s, a):
        return all_of(s.asked(a), no(s.over(a)))

    def ends(s, a):
        """The latest end of a motion. The mover's clock is ahead by at most the skew, which the deadline
        leaves room for."""
        late = s.skew() if defect == "IgnoreSkew" else 0
        return s.asked_at(a) + s.lease() + late

    def properly(s, a):
        return s.asked_at(a) + s.lease()

    def lasts(s, a):
        """The attempt moves, or may still begin to."""
        return all_of(active(s, a), any_of(s.now() <= properly(s, a), s.moving(a)))

    def initial(s):
        return [
            s.every("Metamodule", lambda h: no(s.dead(h))),
            s.every("Attempt", lambda a: all_of(no(s.asked(a)), no(s.over(a)), no(s.moving(a)))),
            s.every("Attempt", lambda a: no(s.orphaned(a))),
            s.every("Attempt Metamodule", lambda a, h: all_of(no(s.granted(a, h)), no(s.heard(a, h)))),
            s.every("Metamodule Attempt", lambda h, a: no(s.kept(h, a))),
        ]

    m.initial = initial

    @m.action("Attempt")
    def ask(s, a):
        me = s.origin(a)
        is_idle = s.every("Attempt", lambda b: implies(s.origin(b) == me, no(active(s, b))))
        guard = all_of(no(s.asked(a)), no(s.dead(me)), s.now() >= s.listens_until(me), is_idle)
        return guard, s.but(asked=put(s.asked, a, True), asked_at=put(s.asked_at, a, s.now()))

    @m.action("Attempt", "Metamodule")
    def grant(s, a, h):
        def own(b):
            return all_of(s.origin(b) == h, active(s, b), s.crosses(a, b), no(s.orphaned(b)))

        def gives_up(b):
            return all_of(own(b), no(s.moving(b)))

        is_held = s.some("Attempt", lambda b: all_of(own(b), s.moving(b)))
        is_occupied = s.some("Cell", lambda c: all_of(s.body(h, c), s.sweeps(a, c)))
        listens = s.now() < s.listens_until(h)
        guard = [s.asked(a), s.asks(a, h), no(s.dead(h)), s.now() > s.asked_at(a)]
        given_up = gives_up
        if defect == "GrantEverything":

            def given_up(b):
                return False
        else:
            guard.append(no(is_occupied))
            if defect != "ForgetLocks":
                guard.append(no(is_held))
            if defect != "GrantAfterRestart":
                guard.append(no(listens))
        # A repeated request does not extend the lease of a grant that is remembered.
        until = choose(s.kept(h, a), s.until(h, a), s.now() + s.lease())
        after = s.but(
            granted=put(s.granted, (a, h), True),
            kept=put(s.kept, (h, a), defect != "ForgetLocks"),
            until=put(s.until, (h, a), until),
            over=where(s.over, given_up, True),
        )
        return all_of(guard), after

    @m.action("Attempt", "Metamodule")
    def hear(s, a, h):
        guard = all_of(s.granted(a, h), active(s, a), no(s.dead(s.origin(a))))
        return guard, s.but(heard=put(s.heard, (a, h), True))

    @m.action("Attempt")
    def begin(s, a):
        are_heard = s.every("Metamodule", lambda h: implies(s.asks(a, h), s.heard(a, h)))
        guard = [active(s, a), no(s.moving(a)), no(s.dead(s.origin(a))), s.now() <= ends(s, a)]
        if defect != "AskNone":
            guard.append(are_heard)
        return all_of(guard), s.but(moving=put(s.moving, a, True))

    @m.action("Attempt", ("Cell", "Bool"))
    def end(s, a, place):
        """The body stands in some of the cells of its motion."""
        me = s.origin(a)
        guard = all_of(s.moving(a), s.every("Cell", lambda c: implies(place(c), s.sweeps(a, c))))
        after = s.but(
            moving=put(s.moving, a, False),
            over=put(s.over, a, True),
            body=where(s.body, lambda h, c: h == me, lambda h, c: place(c)),
        )
        return guard, after

    @m.action("Attempt")
    def give_up(s, a):
        guard = all_of(active(s, a), no(s.moving(a)))
        return guard, s.but(over=put(s.over, a, True))

    @m.action("Metamodule", "Attempt")
    def release(s, h, a):
        return s.over(a), s.but(kept=put(s.kept, (h, a), False))

    @m.action("Metamodule", "Attempt")
    def expire(s, h, a):
        guard = all_of(s.kept(h, a), s.now() >= s.until(h, a))
        return guard, s.but(kept=put(s.kept, (h, a), False))

    @m.action("Metamodule", "Attempt")
    def forget(s, h, a):
        """A new contact, a certificate of death, or another grant on the same port."""
        return s.kept(h, a), s.but(kept=put(s.kept, (h, a), False))

    @m.action("Metamodule")
    def die(s, h):
        """An action of the body under way goes on to its end."""
        return no(s.dead(h)), s.but(dead=put(s.dead, h, True))

    @m.action("Metamodule")
    def restart(s, h):
        def forgotten(a):
            return all_of(s.origin(a) == h, active(s, a), no(s.moving(a)))

        def orphan(a):
            return all_of(s.origin(a) == h, active(s, a), s.moving(a))

        after = s.but(
            dead=put(s.dead, h, False),
            listens_until=put(s.listens_until, h, s.now() + s.lease()),
            over=where(s.over, forgotten, True),
            orphaned=where(s.orphaned, orphan, True),
            kept=where(s.kept, lambda g, a: g == h, False),
        )

        # Starting a process takes some time.
        def own(a):
            return all_of(s.origin(a) == h, s.asked(a))

        is_later = s.every("Attempt", lambda a: implies(own(a), s.asked_at(a) < s.now()))
        return all_of(s.dead(h), is_later), after

    @m.action("Real")
    def pass_time(s, later):
        def in_time(a):
            return implies(s.moving(a), later <= ends(s, a))

        guard = [later >= s.now()]
        if defect != "OutstayLease":
            guard.append(s.every("Attempt", in_time))
        return all_of(guard), s.but(now=fixed(later))

    @m.invariant("requests are of the past", "Attempt")
    def _(s, a):
        return implies(s.asked(a), s.asked_at(a) <= s.now())

    @m.invariant("only attempts move", "Attempt")
    def _(s, a):
        known = implies(any_of(s.moving(a), s.over(a)), s.asked(a))
        return all_of(known, implies(s.moving(a), no(s.over(a))))

    @m.invariant("grants are answers", "Attempt Metamodule")
    def _(s, a, h):
        was_asked = all_of(s.asked(a), s.asks(a, h), s.asked_at(a) <= s.now())
        return all_of(implies(s.granted(a, h), was_asked), implies(s.heard(a, h), s.granted(a, h)))

    @m.invariant("one attempt at a time", "Attempt Attempt")
    def _(s, a, b):
        same = all_of(s.origin(a) == s.origin(b), active(s, a), active(s, b))
        return implies(same, a == b)

    @m.invariant("an orphan ends while its origin listens", "Attempt")
    def _(s, a):
        me = s.origin(a)
        is_known = any_of(s.dead(me), s.listens_until(me) > properly(s, a))
        return implies(all_of(s.orphaned(a), active(s, a)), all_of(s.moving(a), is_known))

    @m.invariant("who moves was asked before it died", "Attempt")
    def _(s, a):
        return implies(s.orphaned(a), all_of(s.asked(a), s.asked_at(a) <= s.now()))

    @m.invariant("grants outlast the motion", "Metamodule Attempt")
    def _(s, h, a):
        return implies(s.kept(h, a), all_of(s.asked(a), s.until(h, a) > properly(s, a)))

    @m.invariant("all have granted", "Attempt Metamodule")
    def _(s, a, h):
        return implies(all_of(s.moving(a), s.asks(a, h)), s.heard(a, h))

    @m.invariant("two that cross have not granted each other", "Attempt Attempt")
    def _(s, a, b):
        both = all_of(lasts(s, a), lasts(s, b), s.crosses(a, b), no(s.origin(a) == s.origin(b)))
        return implies(both, no(all_of(s.granted(a, s.origin(b)), s.granted(b, s.origin(a)))))

    @m.invariant("bodies are clear of what was granted", "Attempt Metamodule Cell")
    def _(s, a, h, c):
        is_granted = all_of(s.granted(a, h), lasts(s, a), s.body(h, c))
        return implies(is_granted, no(s.sweeps(a, c)))

    @m.goal("one holder a cell", "Attempt Attempt Cell")
    def _(s, a, b, c):
        both = all_of(s.moving(a), s.moving(b), s.sweeps(a, c), s.sweeps(b, c))
        return implies(both, s.origin(a) == s.origin(b))

    @m.goal("no body in the way", "Attempt Metamodule Cell")
    def _(s, a, h, c):
        meets = all_of(s.moving(a), s.asks(a, h), s.sweeps(a, c))
        return implies(meets, no(s.body(h, c)))

    @m.goal("a motion ends within its lease", "Attempt")
    def _(s, a):
        return implies(s.moving(a), s.now() <= properly(s, a))

    @m.goal("a motion ends within its grants", "Metamodule Attempt")
    def _(s, h, a):
        return implies(all_of(s.moving(a), s.kept(h, a)), s.now() < s.until(h, a))

    return m


PART = Part(
    name="floor_locks",
    title="(c) floor locks",
    build=build,
    refusals={
        "GrantEverything": [("grant", "bodies are clear of what was granted")],
        "AskNone": [("begin", "one holder a cell")],
        "ForgetLocks": [("grant", "two that cross have not granted each other")],
        "OutstayLease": [("pass_time", "a motion ends within its lease")],
        "GrantAfterRestart": [("grant", "two that cross have not granted each other")],
        "IgnoreSkew": [("pass_time", "a motion ends within its lease")],
    },
)
