"""Leased grants of cubes: who stays while another module moves.

*Modelled.* `protocol/cube/src/negotiation.rs`, `lock_table.rs`, `params.rs`, `turns.rs`,
`motion_planner.rs` and the times of restart in `lib.rs`.

An attempt of a module makes requests, each along a route of modules; all of them are asked to stay, and the
last one of a route may be asked to keep the destination free, too. A module that is asked takes a lock for
`lease * (1 + drift)` of its own clock, counted from the arrival of the request (`Params::keep_for`), and
passes the request on; the last one answers, and the answer comes back over the route. A module grants
nothing while it walks, moves or listens after a restart, and gives up an attempt of its own when it grants
(`Cube::consider`). The body begins to move no later than `lease * (1 - drift) - move - skew` after the
request by the mover's clock (`Params::start_within`), and refuses a later start. A lock ends with a
release, with its lease, or when a denial comes back from further on. A restarted module has forgotten its
locks; it grants nothing and does not move for two leases.

A module beside a dead one can also slide from it, without asking anybody, in the slot of its colour
(`Cube::turn`). The module that it lands on touches the dead one as well, and leaves only in the slot for
departures from `died + suspect + skew` on, since it knows by then that the dead one is silent. Slides begin
only later than that by a lease and a move (`Params::slides_after`).

Messages are facts: what was sent can arrive at any later time, any number of times, or never. Clocks differ
from the controller's by at most the skew, and gain or lose at most a fiftieth of the time that passes.

*Coarser than the code.* The requests of an attempt are known from the beginning. A request may be granted
although its attempt is over. Whom a module gives precedence to is left open. A route ends before a dead
module. A slot is any stretch of time; that moves of different slots do not overlap is taken from the test
`moves_of_different_slots_never_overlap`, that neighbours of a dead module that land on each other differ in
colour from `walkers_and_what_they_land_on_differ_in_colour`.

*Shown.* No module leaves while another one moves over it or lands on it, asked or not. One mover a cell. A
motion ends before the grants that it relies on.

*Assumed.* Two attempts for one cell ask a common module to keep it free (`Cube::ask_co_owners` asks all
that the reserving module knows of). A body refuses to move into a cell that another one is moving into;
attempts that land on a dead module rely on that, since it keeps no cell free, and so do all others for the
same cell. A module that touches a dead one and is neither held by the forest nor waits for a stranger has
its certificate, or has heard it in this contact. Not modelled: calls of the controller, closed epochs,
cycles, and that a module on which another one has landed stays (`Cube::may_carry`).

*Found by the proof:* three steps that the code once took, each now a variant that is refused: see `FOUND`.
"""

from inductive import Model, Part, all_of, any_of, choose, fixed, implies, no, put, where

DEPARTURE = 4
"""The slot for departures; the slots before it are those of the colours."""

FOUND = {
    "PassesWithoutLock": "a grant was passed back by a module that had withdrawn its own lock",
    "LateDenial": "a denial that was overtaken by a grant ended the lock of a module on the way",
    "RestartEndsTurns": "a module left at any time as soon as the dead one beside it had restarted",
}
"""Steps that the code took until a proof without them could not be found."""


def build(defect: str | None = None) -> Model:
    """Returns the model, with a defect if one is named."""
    m = Model("leases", sizes={"Cell": 2, "Slot": 2, "Request": 3, "Attempt": 2, "Module": 3})
    m.rigid = {
        "lease": ("Real",),
        "move": ("Real",),
        "skew": ("Real",),
        "suspect": ("Real",),
        "origin": ("Attempt", "Module"),
        "cell": ("Attempt", "Cell"),
        # Routes.
        "of": ("Request", "Attempt"),
        "on": ("Request", "Module", "Bool"),
        "is_last": ("Request", "Module", "Bool"),
        "next": ("Request", "Module", "Module"),
        "first": ("Request", "Module"),
        "beyond": ("Request", "Module", "Module", "Bool"),
        "keeps": ("Request", "Bool"),
        # Whom an attempt relies on, and by which request it has asked; whom two attempts for a cell have in
        # common.
        "relies": ("Attempt", "Module", "Bool"),
        "request": ("Attempt", "Module", "Request"),
        "reserves": ("Attempt", "Bool"),
        "keeper": ("Attempt", "Attempt", "Module"),
        "keep_request": ("Attempt", "Attempt", "Request"),
        # Slides from dead modules.
        "by_turn": ("Attempt", "Bool"),
        "over_dead": ("Attempt", "Module"),
        "lands_on": ("Attempt", "Module"),
        "colour": ("Module", "Int"),
        "kind": ("Slot", "Int"),
        "slot_begins": ("Slot", "Real"),
        "slot_ends": ("Slot", "Real"),
    }
    m.state = {
        "now": ("Real",),
        "asked": ("Attempt", "Bool"),
        "asked_at": ("Attempt", "Real"),
        "latest": ("Attempt", "Real"),
        "over": ("Attempt", "Bool"),
        "heard": ("Request", "Bool"),
        "launched": ("Attempt", "Bool"),
        "in_slot": ("Attempt", "Bool"),
        "slot": ("Attempt", "Slot"),
        "moving": ("Attempt", "Bool"),
        # The module has restarted since, and does not know of it; the body does.
        "orphaned": ("Attempt", "Bool"),
        "began": ("Attempt", "Real"),
        # When the slide's dead module had been silent for so long that all beside it knew.
        "known_since": ("Attempt", "Real"),
        # Locks, what was answered, and what was denied.
        "lock": ("Module", "Request", "Bool"),
        "until": ("Module", "Request", "Real"),
        "has_passed": ("Module", "Request", "Bool"),
        "answered": ("Request", "Module", "Bool"),
        "denied": ("Request", "Module", "Bool"),
        "walks": ("Module", "Bool"),
        "dead": ("Module", "Bool"),
        "died": ("Module", "Real"),
        "listens_until": ("Module", "Real"),
    }

    def axioms(s):
        def routes(r, h):
            passes_on = all_of(s.on(r, h), no(s.is_last(r, h)))
            behind_first = any_of(h == s.first(r), s.beyond(r, s.first(r), h))
            return all_of(
                implies(passes_on, s.on(r, s.next(r, h))),
                implies(s.on(r, h), all_of(s.on(r, s.first(r)), behind_first)),
                implies(s.on(r, h), no(h == s.origin(s.of(r)))),
                implies(all_of(s.on(r, h), s.keeps(r), s.is_last(r, h)), s.relies(s.of(r), h)),
            )

        def behind(r, h, g):
            nearer = any_of(g == s.next(r, h), s.beyond(r, s.next(r, h), g))
            return implies(s.beyond(r, h, g), all_of(no(s.is_last(r, h)), nearer))

        def requests(a, h):
            r = s.request(a, h)
            return implies(s.relies(a, h), all_of(s.of(r) == a, s.on(r, h)))

        def common(a, b):
            r, h = s.keep_request(a, b), s.keeper(a, b)
            asked = all_of(s.reserves(a), s.reserves(b), s.cell(a) == s.cell(b))
            keeps = all_of(s.of(r) == a, s.keeps(r), s.is_last(r, h), s.on(r, h), h == s.keeper(b, a))
            return implies(asked, keeps)

        def slides(a):
            x, y = s.origin(a), s.lands_on(a)
            colours = all_of(0 <= s.colour(x), s.colour(x) < DEPARTURE, no(s.colour(x) == s.colour(y)))
            return implies(s.by_turn(a), all_of(colours, no(x == y), no(s.reserves(a))))

        def slots(p, q):
            apart = any_of(
                s.slot_ends(p) + s.move() < s.slot_begins(q),
                s.slot_ends(q) + s.move() < s.slot_begins(p),
            )
            return implies(no(s.kind(p) == s.kind(q)), apart)

        return [
            s.lease() > 0,
            s.move() > 0,
            s.skew() >= 0,
            s.suspect() > 0,
            start_within(s) > 0,
            s.every("Request Module", routes),
            s.every("Request Module Module", behind),
            s.every("Attempt Module", requests),
            s.every("Attempt Attempt", common),
            s.every("Attempt", slides),
            s.every("Slot Slot", slots),
        ]

    m.axioms = axioms

    def start_within(s):
        margin = 0 if defect == "IgnoreSkew" else s.skew()
        return s.lease() * 49 / 50 - s.move() - margin

    def latest_end(s, a):
        """The latest end of a move that the sound protocol permits, in true time: the body judges the
        deadline by the controller's clock, or by the mover's."""
        return s.asked_at(a) + s.lease() - s.move() / 49

    def shortest_lock(s):
        """The least true time in which a clock shows the time of a lock."""
        return s.move() if defect == "ShortLease" else s.lease()

    def active(s, a):
        return all_of(s.asked(a), no(s.over(a)))

    def known(s, a):
        """The attempt is active, and its module knows of it."""
        return all_of(active(s, a), no(s.orphaned(a)))

    def lasts(s, a):
        """The attempt moves, or may still begin to."""
        return all_of(active(s, a), any_of(s.now() + s.move() <= latest_end(s, a), s.moving(a)))

    def stays(s, h, r):
        """The module has a lock that lasts long enough, or has forgotten it and neither moves nor grants
        for long enough."""
        ends = latest_end(s, s.of(r))
        return any_of(all_of(s.lock(h, r), s.until(h, r) > ends), s.dead(h), s.listens_until(h) > ends)

    def initial(s):
        return [
            s.every("Attempt", lambda a: all_of(no(s.asked(a)), no(s.over(a)), no(s.moving(a)))),
            s.every("Attempt", lambda a: all_of(no(s.launched(a)), no(s.orphaned(a)))),
            s.every("Module", lambda h: all_of(no(s.dead(h)), no(s.walks(h)))),
            s.every("Request", lambda r: no(s.heard(r))),
            s.every("Request Module", lambda r, h: all_of(no(s.answered(r, h)), no(s.denied(r, h)))),
            s.every("Module Request", lambda h, r: all_of(no(s.lock(h, r)), no(s.has_passed(h, r)))),
        ]

    m.initial = initial

    @m.action("Attempt", "Real")
    def ask(s, a, latest):
        me = s.origin(a)
        is_idle = s.every("Attempt", lambda b: implies(s.origin(b) == me, no(known(s, b))))
        # By the mover's clock, which is ahead of the controller's by at most the skew; or the body judges
        # by the mover's clock, which is slow.
        by_controller = latest <= s.now() + s.skew() + start_within(s)
        by_mover = latest <= s.now() + start_within(s) * 50 / 49
        guard = [no(s.asked(a)), no(s.dead(me)), is_idle, any_of(by_controller, by_mover)]
        if defect != "NoListening":
            guard.append(s.now() >= s.listens_until(me))
        after = s.but(
            asked=put(s.asked, a, True),
            asked_at=put(s.asked_at, a, s.now()),
            latest=put(s.latest, a, latest),
        )
        return all_of(guard), after

    @m.action("Request", "Module", "Real")
    def take_lock(s, r, h, lasts_for):
        """A module on the route grants the request. The last one answers at once."""
        a = s.of(r)

        def mine(b):
            return all_of(s.origin(b) == h, known(s, b))

        moves = s.some("Attempt", lambda b: all_of(mine(b), any_of(s.launched(b), s.moving(b))))

        def own(q):
            return all_of(s.keeps(r), s.is_last(r, h), s.keeps(q), s.is_last(q, h), s.lock(h, q))

        def is_other(q):
            return no(s.origin(s.of(q)) == s.origin(a))

        def same_cell(q):
            return s.cell(s.of(q)) == s.cell(a)

        is_reserved = s.some("Request", lambda q: all_of(own(q), is_other(q), same_cell(q)))
        guard = [
            s.asked(a),
            s.on(r, h),
            no(s.dead(h)),
            no(s.walks(h)),
            no(moves),
            lasts_for >= shortest_lock(s),
        ]
        if defect != "ReserveTwice":
            guard.append(any_of(no(is_reserved), s.lock(h, r)))
        if defect != "NoListening":
            guard.append(s.now() >= s.listens_until(h))
        # A repeated request does not extend the lease.
        until = choose(s.lock(h, r), s.until(h, r), s.now() + lasts_for)
        after = s.but(
            lock=put(s.lock, (h, r), True),
            until=put(s.until, (h, r), until),
            has_passed=put(s.has_passed, (h, r), all_of(s.lock(h, r), s.has_passed(h, r))),
            answered=put(s.answered, (r, h), any_of(s.answered(r, h), s.is_last(r, h))),
            over=where(s.over, mine, True),
        )
        return all_of(guard), after

    @m.action("Request", "Module")
    def pass_back(s, r, h):
        """A module on the way passes the answer of the next one back."""
        guard = [s.on(r, h), no(s.is_last(r, h)), no(s.dead(h)), s.answered(r, s.next(r, h))]
        if defect != "PassesWithoutLock":
            guard.append(s.lock(h, r))
        after = s.but(
            answered=put(s.answered, (r, h), True),
            has_passed=put(s.has_passed, (h, r), s.lock(h, r)),
        )
        return all_of(guard), after

    @m.action("Request", "Module")
    def deny(s, r, h):
        """A module that has no lock denies a request, for any reason."""
        guard = all_of(s.asked(s.of(r)), s.on(r, h), no(s.lock(h, r)), no(s.dead(h)))
        return guard, s.but(denied=put(s.denied, (r, h), True))

    @m.action("Request", "Module")
    def withdraw(s, r, h):
        """A denial comes back from the next module."""
        guard = [s.on(r, h), no(s.is_last(r, h)), s.denied(r, s.next(r, h)), no(s.dead(h))]
        if defect != "LateDenial":
            guard.append(no(s.has_passed(h, r)))
        after = s.but(lock=put(s.lock, (h, r), False), denied=put(s.denied, (r, h), True))
        return all_of(guard), after

    @m.action("Request")
    def hear(s, r):
        a = s.of(r)
        guard = all_of(s.answered(r, s.first(r)), active(s, a), no(s.dead(s.origin(a))))
        return guard, s.but(heard=put(s.heard, r, True))

    def may_leave(s, a):
        """The checks of a module that is about to move, besides those of the forest."""
        me = s.origin(a)
        is_free = s.every("Request", lambda r: no(s.lock(me, r)))
        guard = [known(s, a), no(s.launched(a)), no(s.moving(a)), no(s.dead(me))]
        if defect != "NoDeadline":
            guard.append(s.now() <= s.latest(a))
        if defect != "IgnoreLocks":
            guard.append(any_of(s.walks(me), is_free))
        if defect != "NoListening":
            guard.append(s.now() >= s.listens_until(me))
        return guard

    def colour(s, me):
        return 0 if defect == "OneColour" else s.colour(me)

    def slides_onto(s, a, me):
        """A slide under way, or about to begin, lands on this module."""
        return all_of(s.by_turn(a), s.lands_on(a) == me)

    @m.action("Attempt", "Slot", "Bool")
    def launch(s, a, slot, in_slot):
        """A module that has heard all that it has asked decides to move. If it may be landed on it does so
        in a slot."""
        me = s.origin(a)
        is_granted = s.every("Request", lambda r: implies(s.of(r) == a, s.heard(r)))

        def is_known(b):
            """A dead module from which another one may slide onto this one is known to be dead or silent;
            one that has restarted since says that it listens."""
            d = s.over_dead(b)
            silent = all_of(s.dead(d), s.now() >= s.died(d) + s.suspect() + s.skew())
            listens = s.now() < s.listens_until(d)
            if defect == "RestartEndsTurns":
                listens = False
            if defect in ("IgnoreTurns", "TrustArrival"):
                silent = False
            return all_of(slides_onto(s, b, me), any_of(silent, listens))

        may_be_landed_on = s.some("Attempt", is_known)
        departs = all_of(
            s.kind(slot) == DEPARTURE, s.slot_begins(slot) <= s.now(), s.now() <= s.slot_ends(slot)
        )
        guard = all_of(
            may_leave(s, a),
            no(s.by_turn(a)),
            is_granted,
            choose(in_slot, departs, no(may_be_landed_on)),
        )
        after = s.but(
            launched=put(s.launched, a, True),
            in_slot=put(s.in_slot, a, in_slot),
            slot=put(s.slot, a, slot),
        )
        return guard, after

    @m.action("Attempt")
    def begin(s, a):
        """The body begins, no later than the deadline and the end of the slot, into a cell that is free."""
        in_cell = s.some("Attempt", lambda b: all_of(s.moving(b), no(s.reserves(b)), s.cell(b) == s.cell(a)))
        in_same = s.some("Attempt", lambda b: all_of(s.moving(b), s.cell(b) == s.cell(a)))
        taken = choose(s.reserves(a), in_cell, in_same)
        guard = [s.launched(a), active(s, a), no(s.moving(a)), no(s.by_turn(a)), no(taken)]
        guard.append(implies(s.in_slot(a), s.now() <= s.slot_ends(s.slot(a))))
        if defect != "NoDeadline":
            guard.append(s.now() <= s.latest(a))
        return all_of(guard), s.but(moving=put(s.moving, a, True), began=put(s.began, a, s.now()))

    @m.action("Attempt", "Slot")
    def slide(s, a, slot):
        """A module slides from a dead one in the slot of its colour, into a cell that is free."""
        me, d = s.origin(a), s.over_dead(a)
        silent_since = s.died(d) + s.suspect() + s.skew()
        taken = s.some("Attempt", lambda b: all_of(s.moving(b), s.cell(b) == s.cell(a)))
        guard = [
            may_leave(s, a),
            s.by_turn(a),
            s.dead(d),
            no(taken),
            s.now() >= silent_since + s.lease() + s.move(),
            s.kind(slot) == colour(s, me),
            s.slot_begins(slot) <= s.now(),
            s.now() <= s.slot_ends(slot),
        ]
        after = s.but(
            launched=put(s.launched, a, True),
            in_slot=put(s.in_slot, a, True),
            slot=put(s.slot, a, slot),
            moving=put(s.moving, a, True),
            began=put(s.began, a, s.now()),
            known_since=put(s.known_since, a, silent_since),
        )
        return all_of(guard), after

    @m.action("Attempt")
    def arrive(s, a):
        """The body arrives. Its module is a walker, and has promised nothing at the new cell; if it has
        restarted meanwhile, it is none."""
        me = s.origin(a)
        after = s.but(
            moving=put(s.moving, a, False),
            over=put(s.over, a, True),
            walks=put(s.walks, me, s.now() >= s.listens_until(me)),
            lock=where(s.lock, lambda h, r: h == me, False),
        )
        return s.moving(a), after

    @m.action("Attempt")
    def fail(s, a):
        """The body could not move, and is where it was."""
        return s.moving(a), s.but(moving=put(s.moving, a, False), over=put(s.over, a, True))

    @m.action("Attempt")
    def give_up(s, a):
        """An attempt is given up, or refused by the body."""
        return all_of(known(s, a), no(s.moving(a))), s.but(over=put(s.over, a, True))

    @m.action("Module")
    def park(s, h):
        is_idle = s.every("Attempt", lambda a: implies(s.origin(a) == h, no(known(s, a))))
        return all_of(s.walks(h), is_idle), s.but(walks=put(s.walks, h, False))

    @m.action("Module", "Request")
    def release(s, h, r):
        return s.over(s.of(r)), s.but(lock=put(s.lock, (h, r), False))

    @m.action("Module", "Request")
    def expire(s, h, r):
        guard = all_of(s.lock(h, r), s.now() >= s.until(h, r))
        return guard, s.but(lock=put(s.lock, (h, r), False))

    @m.action("Module")
    def die(s, h):
        """A body that moves goes on to the end."""
        return no(s.dead(h)), s.but(dead=put(s.dead, h, True), died=put(s.died, h, s.now()))

    @m.action("Module")
    def restart(s, h):
        """The process begins again, and knows nothing. Its body still carries out the motion that it was
        asked for."""

        def forgotten(a):
            return all_of(s.origin(a) == h, active(s, a), no(s.launched(a)))

        def orphan(a):
            return all_of(s.origin(a) == h, active(s, a), s.launched(a))

        # Two leases, by a clock that is fast.
        after = s.but(
            dead=put(s.dead, h, False),
            walks=put(s.walks, h, False),
            listens_until=put(s.listens_until, h, s.now() + s.lease() * 2 * 50 / 51),
            over=where(s.over, forgotten, True),
            orphaned=where(s.orphaned, orphan, True),
            lock=where(s.lock, lambda g, r: g == h, False),
            has_passed=where(s.has_passed, lambda g, r: g == h, False),
        )
        return s.dead(h), after

    @m.action("Real")
    def pass_time(s, later):
        in_time = s.every("Attempt", lambda a: implies(s.moving(a), later <= s.began(a) + s.move()))
        return all_of(later >= s.now(), in_time), s.but(now=fixed(later))

    @m.invariant("times are past", "Attempt Module")
    def _(s, a, h):
        return all_of(implies(s.asked(a), s.asked_at(a) <= s.now()), implies(s.dead(h), s.died(h) <= s.now()))

    @m.invariant("deadlines leave time for the move", "Attempt")
    def _(s, a):
        return implies(s.asked(a), s.latest(a) + s.move() <= latest_end(s, a))

    @m.invariant("moves", "Attempt")
    def _(s, a):
        is_off = all_of(s.launched(a), no(s.over(a)))
        timely = all_of(s.began(a) <= s.now(), s.now() <= s.began(a) + s.move(), s.began(a) <= s.latest(a))
        is_known = implies(any_of(s.launched(a), s.over(a)), s.asked(a))
        return all_of(is_known, implies(s.moving(a), all_of(is_off, timely)))

    @m.invariant("one attempt at a time", "Attempt Attempt")
    def _(s, a, b):
        same = all_of(s.origin(a) == s.origin(b), known(s, a), known(s, b))
        return implies(same, a == b)

    @m.invariant("one move at a time", "Attempt Attempt")
    def _(s, a, b):
        same = all_of(s.origin(a) == s.origin(b), lasts(s, a), lasts(s, b))
        return implies(same, a == b)

    @m.invariant("an orphan ends while its module listens", "Attempt")
    def _(s, a):
        me = s.origin(a)
        listens = any_of(s.dead(me), s.listens_until(me) > latest_end(s, a))
        return implies(s.orphaned(a), all_of(s.launched(a), listens))

    @m.invariant("walkers have promised nothing", "Module Request")
    def _(s, h, r):
        return implies(s.walks(h), no(s.lock(h, r)))

    @m.invariant("locks are asked for", "Request Module")
    def _(s, r, h):
        is_asked = all_of(s.asked(s.of(r)), s.on(r, h))
        return all_of(
            implies(s.lock(h, r), is_asked),
            implies(s.answered(r, h), is_asked),
        )

    @m.invariant("a lease ends after the latest move", "Module Request")
    def _(s, h, r):
        return implies(s.lock(h, r), s.until(h, r) > latest_end(s, s.of(r)))

    @m.invariant("who has answered stays", "Request Module")
    def _(s, r, h):
        return implies(all_of(s.answered(r, h), lasts(s, s.of(r))), stays(s, h, r))

    @m.invariant("who has passed an answer back keeps the lock", "Request Module")
    def _(s, r, h):
        is_way = all_of(s.answered(r, h), lasts(s, s.of(r)), s.lock(h, r), no(s.is_last(r, h)))
        return implies(is_way, s.has_passed(h, r))

    @m.invariant("all beyond have answered", "Request Module Module")
    def _(s, r, h, g):
        return implies(all_of(s.answered(r, h), s.beyond(r, h, g)), s.answered(r, g))

    @m.invariant("what is heard was answered", "Request")
    def _(s, r):
        return implies(s.heard(r), s.answered(r, s.first(r)))

    @m.invariant("all has been heard at launch", "Attempt Request")
    def _(s, a, r):
        return implies(all_of(s.launched(a), active(s, a), s.of(r) == a), any_of(s.by_turn(a), s.heard(r)))

    @m.invariant("who moves has promised none", "Attempt Request")
    def _(s, a, r):
        is_off = all_of(s.launched(a), lasts(s, a), lasts(s, s.of(r)))
        return implies(is_off, no(s.answered(r, s.origin(a))))

    @m.invariant("who moves has no lock", "Attempt Request")
    def _(s, a, r):
        is_off = all_of(s.launched(a), lasts(s, a), lasts(s, s.of(r)))
        return implies(is_off, no(s.lock(s.origin(a), r)))

    @m.invariant("one reservation a cell", "Module Request Request")
    def _(s, h, r, q):
        both = all_of(s.lock(h, r), s.lock(h, q), s.keeps(r), s.keeps(q), s.is_last(r, h), s.is_last(q, h))
        same = all_of(both, s.cell(s.of(r)) == s.cell(s.of(q)))
        return implies(same, s.origin(s.of(r)) == s.origin(s.of(q)))

    @m.invariant("one promise a cell", "Module Request Request")
    def _(s, h, r, q):
        both = all_of(
            s.answered(r, h), s.answered(q, h), s.keeps(r), s.keeps(q), s.is_last(r, h), s.is_last(q, h)
        )
        last = all_of(lasts(s, s.of(r)), lasts(s, s.of(q)), s.cell(s.of(r)) == s.cell(s.of(q)))
        return implies(all_of(both, last), s.origin(s.of(r)) == s.origin(s.of(q)))

    @m.invariant("slots are kept", "Attempt")
    def _(s, a):
        slot = s.slot(a)
        kind = choose(s.by_turn(a), colour(s, s.origin(a)), DEPARTURE)
        is_in = all_of(s.slot_begins(slot) <= s.now(), s.kind(slot) == kind)
        begins = implies(
            s.moving(a), all_of(s.slot_begins(slot) <= s.began(a), s.began(a) <= s.slot_ends(slot))
        )
        slides = implies(all_of(s.launched(a), s.by_turn(a)), s.in_slot(a))
        return all_of(slides, implies(all_of(s.launched(a), s.in_slot(a)), all_of(is_in, begins)))

    @m.invariant("slides come late", "Attempt")
    def _(s, a):
        is_late = s.began(a) >= s.known_since(a) + s.lease() + s.move()
        return implies(all_of(s.moving(a), s.by_turn(a)), is_late)

    @m.invariant("who does not know has asked before", "Attempt Attempt")
    def _(s, a, b):
        """A module that moves at any time has asked before it could know that it may be landed on."""
        lands = all_of(slides_onto(s, b, s.origin(a)), s.launched(a), no(s.in_slot(a)), active(s, a))
        d = s.over_dead(b)
        of_death = implies(s.dead(d), s.asked_at(a) <= s.died(d) + s.suspect() + s.skew())
        of_slide = implies(s.moving(b), s.asked_at(a) <= s.known_since(b))
        return implies(lands, all_of(of_death, of_slide))

    @m.invariant("the dead ask nothing", "Attempt")
    def _(s, a):
        h = s.origin(a)
        return implies(all_of(s.asked(a), s.dead(h)), s.asked_at(a) <= s.died(h))

    @m.invariant("what a dead support has asked for is over", "Attempt Attempt")
    def _(s, a, b):
        slides = all_of(s.moving(a), s.by_turn(a), s.origin(b) == s.over_dead(a), s.asked(b))
        return implies(slides, s.asked_at(b) < s.known_since(a))

    @m.invariant("a slide is over a dead module or one that listens", "Attempt")
    def _(s, a):
        d = s.over_dead(a)
        is_same = s.known_since(a) == s.died(d) + s.suspect() + s.skew()
        is_long_dead = all_of(s.dead(d), is_same)
        listens = s.listens_until(d) > s.began(a) + s.move()
        return implies(all_of(s.moving(a), s.by_turn(a)), any_of(is_long_dead, listens))

    @m.goal("supports stay", "Attempt Attempt")
    def _(s, a, b):
        return implies(all_of(s.moving(a), no(s.by_turn(a)), s.moving(b)), no(s.relies(a, s.origin(b))))

    @m.goal("landings stay", "Attempt Attempt")
    def _(s, a, b):
        return implies(all_of(s.moving(a), s.by_turn(a), s.moving(b)), no(s.lands_on(a) == s.origin(b)))

    @m.goal("dead supports stay", "Attempt Attempt")
    def _(s, a, b):
        return implies(all_of(s.moving(a), s.by_turn(a), s.moving(b)), no(s.over_dead(a) == s.origin(b)))

    @m.goal("one mover a cell", "Attempt Attempt")
    def _(s, a, b):
        return implies(all_of(s.moving(a), s.moving(b), s.cell(a) == s.cell(b)), a == b)

    @m.goal("a motion ends within its leases", "Attempt Module")
    def _(s, a, h):
        r = s.request(a, h)
        relies = all_of(s.moving(a), no(s.by_turn(a)), s.relies(a, h), s.lock(h, r))
        return implies(relies, s.began(a) + s.move() < s.until(h, r))

    return m


PART = Part(
    name="leases",
    title="(a) leases",
    build=build,
    found=FOUND,
    refusals={
        "ShortLease": [("take_lock", "a lease ends after the latest move")],
        "NoDeadline": [("begin", "a motion ends within its leases")],
        "IgnoreLocks": [("launch", "who moves has promised none")],
        "ReserveTwice": [("take_lock", "one reservation a cell")],
        "NoListening": [("take_lock", "one promise a cell")],
        "IgnoreSkew": [("ask", "deadlines leave time for the move")],
        "IgnoreTurns": [("launch", "who does not know has asked before")],
        "TrustArrival": [("launch", "who does not know has asked before")],
        "OneColour": [("slide", "landings stay")],
        "PassesWithoutLock": [("pass_back", "who has answered stays")],
        "LateDenial": [("withdraw", "who has answered stays")],
        "RestartEndsTurns": [("launch", "who does not know has asked before")],
    },
)
