"""Written runs of the model in `floor_locks.py` with defects: after each, two metamodules move in one cell,
or one moves after the end of its lease."""

import floor_locks
from inductive import Run

LEASE = 100


def start(defect: str | None, skew: int = 0) -> Run:
    """Returns a run in which the metamodules a and b have one attempt each, a' and b', which cross in a
    cell."""
    functions = {
        "lease": lambda: LEASE,
        "skew": lambda: skew,
        "origin": lambda x: x[0],
        "asks": lambda x, h: x[0] != h,
        "sweeps": lambda x, c: True,
        "crosses": lambda x, y: True,
    }
    members = {"Attempt": ["a'", "b'"], "Metamodule": ["a", "b"], "Cell": ["middle"]}
    return Run(floor_locks.build(defect), members, functions)


def is_granted(run: Run, attempt: str, by: str):
    """Lets a request be granted a little later than it was made, and the motion begin."""
    run.do("pass_time", run.state.now() + 1)
    run.do("grant", attempt, by)
    run.do("hear", attempt, by)
    run.do("begin", attempt)


def grants_everything(defect: str | None) -> Run:
    """Both ask, and each grants what the other asks for."""
    run = start(defect)
    run.do("ask", "a'")
    run.do("ask", "b'")
    is_granted(run, "a'", "b")
    is_granted(run, "b'", "a")
    return run


def asks_none(defect: str | None) -> Run:
    """Neither waits for the other."""
    run = start(defect)
    run.do("ask", "a'")
    run.do("ask", "b'")
    run.do("begin", "a'")
    run.do("begin", "b'")
    return run


def forgets_locks(defect: str | None) -> Run:
    """Metamodule a moves, and grants its cells to b."""
    run = start(defect)
    run.do("ask", "a'")
    is_granted(run, "a'", "b")
    run.do("ask", "b'")
    is_granted(run, "b'", "a")
    return run


def outstays_lease(defect: str | None) -> Run:
    """Metamodule a goes on after its lease, and begins late because its clock is ahead."""
    run = start(defect, skew=3)
    run.do("ask", "a'")
    is_granted(run, "a'", "b")
    run.do("pass_time", LEASE + 2)
    return run


def grants_after_restart(defect: str | None) -> Run:
    """Metamodule a has restarted, does not know that its body moves, and grants its cells to b."""
    run = start(defect)
    run.do("ask", "a'")
    is_granted(run, "a'", "b")
    run.do("die", "a")
    run.do("restart", "a")
    run.do("forget", "b", "a'")
    run.do("ask", "b'")
    is_granted(run, "b'", "a")
    return run


RUNS = {
    "GrantEverything": grants_everything,
    "AskNone": asks_none,
    "ForgetLocks": forgets_locks,
    "OutstayLease": outstays_lease,
    "GrantAfterRestart": grants_after_restart,
    "IgnoreSkew": outstays_lease,
}
