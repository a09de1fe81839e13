"""Written runs of the model in `leases.py`, one for most defects: after each, a module
has left while another one moves over it or lands on it."""

from fractions import Fraction

import leases
from inductive import Run

LEASE, MOVE, SUSPECT = 100, 10, 50
SLOTS = {"colour": (0, 1000, 1002), "departure": (leases.DEPARTURE, 2000, 2020)}


def start(
    defect: str | None,
    requests: dict,
    by_turn: tuple = (),
    skew: int = 0,
    share_cell: bool = False,
) -> Run:
    """Returns a run in which each attempt `x'` of a module `x` makes the request `x''` along a row of
    modules, or slides by turn: then `by_turn` names the attempt, the dead module and the one that it lands
    on."""
    routes = {f"{mover}''": (f"{mover}'", row) for mover, row in requests.items()}
    attempts = [f"{mover}'" for mover in requests] + list(by_turn[:1])
    modules = sorted(
        {a[0] for a in attempts} | {h for _, row in routes.values() for h in row} | set(by_turn[1:])
    )

    def place(r, h):
        return routes[r][1].index(h) if h in routes[r][1] else -1

    def last(r):
        return len(routes[r][1]) - 1

    def request(a):
        """The request of an attempt; any other one for a slide, which makes none."""
        return f"{a}'" if f"{a}'" in routes else next(iter(routes))

    functions = {
        "lease": lambda: LEASE,
        "move": lambda: MOVE,
        "skew": lambda: skew,
        "suspect": lambda: SUSPECT,
        "origin": lambda a: a[0],
        "cell": lambda a: attempts[0] if share_cell else a,
        "of": lambda r: routes[r][0],
        "on": lambda r, h: place(r, h) >= 0,
        "is_last": lambda r, h: place(r, h) == last(r),
        "next": lambda r, h: routes[r][1][min(last(r), place(r, h) + 1)],
        "first": lambda r: routes[r][1][0],
        "beyond": lambda r, h, g: 0 <= place(r, h) < place(r, g),
        "keeps": lambda r: True,
        "relies": lambda a, h: a not in by_turn[:1] and place(request(a), h) >= 0,
        "request": lambda a, h: request(a),
        "reserves": lambda a: a not in by_turn[:1],
        "keeper": lambda a, b: routes[request(a)][1][-1],
        "keep_request": lambda a, b: request(a),
        "by_turn": lambda a: a in by_turn[:1],
        "over_dead": lambda a: by_turn[1] if by_turn else a[0],
        "lands_on": lambda a: by_turn[2] if by_turn else a[0],
        "colour": lambda h: 0 if by_turn and h == by_turn[0][0] else 1,
        "kind": lambda slot: SLOTS[slot][0],
        "slot_begins": lambda slot: SLOTS[slot][1],
        "slot_ends": lambda slot: SLOTS[slot][2],
    }
    members = {
        "Module": modules,
        "Attempt": attempts,
        "Request": list(routes),
        "Cell": attempts,
        "Slot": list(SLOTS),
    }
    return Run(leases.build(defect), members, functions)


def ask(run: Run, attempt: str):
    """Lets a module begin an attempt. Its clock is ahead by the skew, and its deadline leaves no room for
    that."""
    state = run.state
    within = Fraction(49 * LEASE, 50) - MOVE
    run.do("ask", attempt, state.now() + within + state.skew())


def is_granted(run: Run, mover: str, by: str, lasts: int = LEASE):
    """Lets a module ask one other, which grants that, and hear it."""
    ask(run, f"{mover}'")
    run.do("take_lock", f"{mover}''", by, lasts)
    run.do("hear", f"{mover}''")


def depart(run: Run, mover: str):
    """Lets a module that has heard all its answers move at once."""
    run.do("launch", f"{mover}'", "departure", False)
    run.do("begin", f"{mover}'")


def support_leaves(run: Run) -> Run:
    """Lets s, the support of m, leave as well; k grants that."""
    is_granted(run, "s", "k")
    depart(run, "s")
    return run


def short_lease(defect: str | None) -> Run:
    """The lock of s ends after a move, and s leaves together with m."""
    run = start(defect, {"m": "s", "s": "k"})
    is_granted(run, "m", "s", MOVE)
    run.do("pass_time", MOVE)
    run.do("expire", "s", "m''")
    depart(run, "m")
    return support_leaves(run)


def no_deadline(defect: str | None) -> Run:
    """The mover is stopped until the lock of s has ended."""
    run = start(defect, {"m": "s", "s": "k"})
    is_granted(run, "m", "s")
    run.do("pass_time", LEASE)
    run.do("expire", "s", "m''")
    run.do("launch", "m'", "departure", False)
    run.do("begin", "m'")
    return support_leaves(run)


def ignored_locks(defect: str | None) -> Run:
    """The support leaves in spite of its lock."""
    run = start(defect, {"m": "s", "s": "k"})
    is_granted(run, "m", "s")
    depart(run, "m")
    return support_leaves(run)


def reserved_twice(defect: str | None) -> Run:
    """Module k keeps one cell free for m and for n."""
    run = start(defect, {"m": "k", "n": "k"}, share_cell=True)
    is_granted(run, "m", "k")
    is_granted(run, "n", "k")
    depart(run, "m")
    depart(run, "n")
    return run


def no_listening(defect: str | None) -> Run:
    """The support restarts, has forgotten its lock, and leaves at once."""
    run = start(defect, {"m": "s", "s": "k"})
    is_granted(run, "m", "s")
    depart(run, "m")
    run.do("die", "s")
    run.do("restart", "s")
    return support_leaves(run)


def ignored_skew(defect: str | None) -> Run:
    """The clock of the mover is ahead, so that it begins late, and still moves when the lock of s ends."""
    run = start(defect, {"m": "s", "s": "k"}, skew=3)
    is_granted(run, "m", "s")
    run.do("pass_time", 91)
    depart(run, "m")
    run.do("pass_time", LEASE)
    run.do("expire", "s", "m''")
    return support_leaves(run)


def slide_onto_x(defect: str | None) -> Run:
    """Lets y slide from the dead d onto x."""
    run = start(defect, {"x": "k"}, ("y'", "d", "x"))
    run.do("die", "d")
    run.do("pass_time", 1000)
    ask(run, "y'")
    run.do("slide", "y'", "colour")
    return run


def no_turns(defect: str | None) -> Run:
    """The module that is landed on leaves at any time."""
    run = slide_onto_x(defect)
    is_granted(run, "x", "k")
    depart(run, "x")
    return run


def passes_without_lock(defect: str | None) -> Run:
    """The mover m asks its support s, and over that the module l. Two copies of the request reach l; it
    denies the first, so s gives its lock back, and grants the second. The denial to m is lost, and the
    grant arrives."""
    run = start(defect, {"m": "sl", "s": "k"})
    ask(run, "m'")
    run.do("take_lock", "m''", "s", LEASE)
    run.do("deny", "m''", "l")
    run.do("withdraw", "m''", "s")
    run.do("take_lock", "m''", "l", LEASE)
    run.do("pass_back", "m''", "s")
    run.do("hear", "m''")
    depart(run, "m")
    return support_leaves(run)


def late_denial(defect: str | None) -> Run:
    """As before, but the grant overtakes the denial between l and s, which gives its lock back when m moves
    already."""
    run = start(defect, {"m": "sl", "s": "k"})
    ask(run, "m'")
    run.do("take_lock", "m''", "s", LEASE)
    run.do("deny", "m''", "l")
    run.do("take_lock", "m''", "l", LEASE)
    run.do("pass_back", "m''", "s")
    run.do("hear", "m''")
    depart(run, "m")
    run.do("withdraw", "m''", "s")
    return support_leaves(run)


def restart_ends_turns(defect: str | None) -> Run:
    """The module y slides from the dead d onto x. Meanwhile d restarts, x hears that, and leaves."""
    run = slide_onto_x(defect)
    run.do("restart", "d")
    is_granted(run, "x", "k")
    depart(run, "x")
    return run


RUNS = {
    "ShortLease": short_lease,
    "NoDeadline": no_deadline,
    "IgnoreLocks": ignored_locks,
    "ReserveTwice": reserved_twice,
    "NoListening": no_listening,
    "IgnoreSkew": ignored_skew,
    "IgnoreTurns": no_turns,
    "TrustArrival": no_turns,
    "PassesWithoutLock": passes_without_lock,
    "LateDenial": late_denial,
    "RestartEndsTurns": restart_ends_turns,
}
