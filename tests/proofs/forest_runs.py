"""Written runs of the model in `forest.py`: one that takes every action, and one for each defect that tears
the body or leaves a dead module without a holder. Each begins with a body whose modules know nothing of
each other."""

import forest
from inductive import Run

NUMBERS = range(0, 12)
"""The numbers of beacons for which invariants are evaluated; no run sends more in one direction."""


class Body:
    """A run over named modules. `edges` says who touches whom, `anchors` on whom each module hangs in the
    beginning; those that are missing there are finalized. `absent` ones come later."""

    def __init__(
        self, edges: str, anchors: str, defect: str | None = None, absent: str = "", order: str = ""
    ):
        pairs = [tuple(edge) for edge in edges.split()]
        names = sorted({name for pair in pairs for name in pair})
        ranked = list(order) + [name for name in names if name not in order]
        self.anchor = dict(tuple(pair) for pair in anchors.split())
        self.now = 0
        self.words = 0
        finals = [name for name in names if name not in self.anchor and name not in absent]
        depths = {name: self.depth(name) for name in names}
        touching = set(pairs) | {(b, a) for a, b in pairs}
        touched = {name: next((f for f in finals if (name, f) in touching), name) for name in names}
        functions = {
            "touches": lambda x, y: (x, y) in touching,
            "nearer": lambda x, y: ranked.index(x) < ranked.index(y),
            "here": lambda x: x not in absent,
            "final": lambda x: x in finals,
            "anchor": lambda x: self.anchor.get(x, x),
            "sup": touched.get,
            "root": lambda x: 0 if x in finals else -1,
            "label": lambda x: max(1, depths[x]),
            "g_root": lambda x: -1,
            "g_kind": lambda x: forest.RANKED,
            "g_depth": lambda x: max(1, depths[x]),
            "next_token": lambda x: 1,
            "unheard": lambda x, y: True,
            "sensed": lambda x, y: True,
        }
        members = {"Module": names, "Word": [f"word{i}" for i in range(3)], "Int": NUMBERS}
        self.run = Run(forest.build(defect), members, functions)

    def depth(self, name: str) -> int:
        return 1 + self.depth(self.anchor[name]) if name in self.anchor else 0

    @property
    def state(self):
        return self.run.state

    def do(self, action: str, *parameters):
        self.run.do(action, *parameters)

    def at(self, now: int):
        """Lets time pass."""
        self.now = now
        self.do("pass_time", now)

    def talk(self, sender: str, receiver: str):
        """Sends a beacon that arrives."""
        self.do("tell", sender, receiver)
        self.do("hear", receiver, sender, self.state.last(sender, receiver))

    def attach(self, child: str, parent: str):
        """Lets a module take a parent."""
        self.talk(parent, child)
        self.do("ask", child, parent)
        self.talk(child, parent)
        self.talk(parent, child)
        assert self.state.attached(child) and self.state.parent(child) == parent

    def confirm(self, final: str):
        self.do("confirm", final, self.now)

    def restart(self, name: str, *neighbours: str):
        """Lets a module begin again, and those of its neighbours that are named notice."""
        self.do("restart", name)
        for neighbour in neighbours:
            self.do("sense", neighbour, name)

    def announce(self, holder: str, dead: str) -> str:
        """Lets a module announce itself with the time at which its path was confirmed. Returns the word."""
        word = f"word{self.words}"
        self.words += 1
        self.do("announce", holder, dead, word, self.state.root(holder))
        return word

    @staticmethod
    def cluster(*members: str):
        """Returns a cluster in the form of a row: who belongs to it, the next nearer one, and how far each
        one is."""
        depths = {name: i for i, name in enumerate(members)}
        return (
            lambda x: x in depths,
            lambda x: members[max(0, depths.get(x, 0) - 1)],
            lambda x: depths.get(x, 0),
        )

    def forward(self, word: str, *members: str):
        self.do("forward", word, *self.cluster(*members))

    def forward_final(self, final: str, sure: int, *members: str) -> str:
        word = f"word{self.words}"
        self.words += 1
        self.do("forward_final", word, final, members[0], sure, *self.cluster(*members))
        return word

    def torn(self) -> list:
        """Returns the modules of the body that are connected with no finalized one."""
        s = self.state
        body = [x for x in self.run.domain.members["Module"] if s.here(x) and not s.walks(x)]
        reached = [x for x in body if s.final(x)]
        for x in reached:
            reached.extend(y for y in body if s.touches(x, y) and y not in reached)
        return [x for x in body if x not in reached]


def every_action() -> Run:
    """Takes every action. The invariants are to be true at the end.

    F and G are finalized; the others stand in a ring between them, and i comes as a walker."""
    b = Body("Fa ab bc cd dG de ei Ff fj", "aF ba cb dG ed fF jf", absent="i")
    b.attach("a", "F")
    b.attach("b", "a")
    b.attach("c", "b")
    b.attach("d", "G")
    b.attach("e", "d")
    b.talk("d", "c")
    b.do("ask", "c", "d")
    b.do("drop_request", "c")
    b.at(1)
    for name in "abc":
        b.do("die", name)
    b.at(2)
    b.do("certify", "d", "c")
    b.at(3)
    b.confirm("G")
    b.talk("G", "d")
    held = b.announce("d", "c")
    b.forward(held, "c", "b", "a")
    sure = b.forward_final("F", 3, "a", "b", "c")
    b.do("let_go_of", "d", "c", sure)
    b.do("learn_sure", "d", "c", sure)
    b.do("arrive", "i")
    b.do("sense", "e", "i")
    b.talk("e", "i")
    b.attach("i", "e")
    b.talk("d", "e")
    # The cluster is certain at a later time than the path of d, and so becomes its parent.
    b.at(4)
    later = b.forward_final("F", 4, "a", "b", "c")
    b.do("learn_sure", "d", "c", later)
    b.do("hang_on_connected", "d", "c")
    b.do("die", "d")
    b.at(5)
    b.restart("d", "G", "e")
    b.do("certify", "d", "c")
    b.do("end_listening", "d")
    b.at(6)
    b.confirm("G")
    b.attach("d", "G")
    # f touches the finalized F; j hangs on it, and both die. f is fixed, and serves as a parent after j has
    # restarted.
    b.do("die", "f")
    b.at(7)
    b.do("certify", "j", "f")
    b.do("learn_fixed", "j", "f", "F")
    b.do("hang_on_dead", "j", "f", 7)
    b.do("leave", "j")
    b.do("finalize", "d", "G")
    b.do("leave_end", "i", "e")
    return b.run


def silent_child(defect: str | None) -> Run:
    """A parent leaves although it has a child."""
    b = Body("Fa ab", "aF ba", defect)
    b.attach("a", "F")
    b.attach("b", "a")
    b.do("leave", "a")
    return b.run


def stranger(defect: str | None) -> Run:
    """A restarted parent leaves before it has heard its child."""
    b = Body("Fa ab", "aF ba", defect)
    b.attach("a", "F")
    b.attach("b", "a")
    b.do("die", "a")
    b.at(1)
    b.restart("a", "F", "b")
    b.do("end_listening", "a")
    b.at(2)
    b.confirm("F")
    b.attach("a", "F")
    b.do("leave", "a")
    return b.run


def unacknowledged(defect: str | None) -> Run:
    """Module b takes a for its parent, which knows nothing of it and leaves."""
    b = Body("Fa Fc ab bc", "aF cF bc", defect)
    b.attach("c", "F")
    b.attach("b", "c")
    b.attach("a", "F")
    b.talk("b", "a")
    b.talk("a", "b")
    b.do("ask", "b", "a")
    b.talk("a", "b")
    b.talk("b", "c")
    b.do("leave", "a")
    b.do("leave", "c")
    return b.run


def forgotten_announcement(defect: str | None) -> Run:
    """Module a holds the dead b and leaves all the same; c has let go because of it."""
    b = Body("Fa Fc ab bc", "aF cF bc", defect)
    b.attach("c", "F")
    b.attach("b", "c")
    b.attach("a", "F")
    b.talk("b", "a")
    b.do("die", "b")
    b.at(1)
    b.do("certify", "a", "b")
    b.do("certify", "c", "b")
    b.confirm("F")
    b.talk("F", "a")
    word = b.announce("a", "b")
    b.do("let_go_of", "c", "b", word)
    b.do("leave", "c")
    b.do("leave", "a")
    return b.run


def old_death(defect: str | None) -> Run:
    """Module a, the parent of the dead b, lets go of it because c held it in an earlier death."""
    b = Body("Fa Fc ab bc", "aF cF ba", defect)
    b.attach("a", "F")
    b.attach("c", "F")
    b.attach("b", "a")
    b.do("die", "b")
    b.at(1)
    b.do("certify", "c", "b")
    b.confirm("F")
    b.talk("F", "c")
    word = b.announce("c", "b")
    b.at(2)
    b.restart("b", "a", "c")
    b.do("end_listening", "b")
    b.at(3)
    b.confirm("F")
    b.talk("F", "a")
    b.attach("b", "a")
    b.talk("b", "c")
    b.do("die", "b")
    b.at(4)
    b.do("certify", "a", "b")
    b.do("let_go_of", "a", "b", word)
    b.do("leave", "a")
    b.do("leave", "c")
    return b.run


def believing(defect: str | None) -> Run:
    """A restarted module lets go of the dead one that is connected over it."""
    b = Body("Fa ab", "aF ba", defect)
    b.do("die", "a")
    b.do("die", "b")
    b.at(1)
    word = b.forward_final("F", 1, "a", "b")
    b.at(2)
    b.restart("a", "F")
    b.do("end_listening", "a")
    b.do("certify", "a", "b")
    b.do("let_go_of", "a", "b", word)
    b.at(3)
    b.confirm("F")
    b.attach("a", "F")
    b.do("leave", "a")
    return b.run


def final_first(defect: str | None) -> Run:
    """Module h holds a cluster of the dead c and e, and lets go of it because the finalized F touched the
    cluster before two of its modules, a and b, restarted.

    Between F and h stand a, b and c in a row; e touches c, and hangs on z; k hangs on e, and q on k. First
    a, b and c die, and the controller announces to h that F holds them; that takes long. Then a and b
    restart. Module b takes q for its parent, so a may leave. Now e dies, and z announces that it holds e.
    Module h, whose path is newer, announces that it holds c, which e touches, so z lets go of e and leaves.
    At last the first announcement arrives."""
    b = Body("Fa ab bc ch hG ce ez zG ek kq qb", "aF ba cb hG zG ez ke qk", defect)
    for name in "abc":
        b.do("die", name)
    b.at(2)
    b.do("certify", "h", "c")
    sure = b.forward_final("F", 2, "a", "b", "c")
    b.at(3)
    b.restart("a", "F")
    b.restart("b", "a", "q")
    b.do("end_listening", "a")
    b.do("end_listening", "b")
    b.at(4)
    b.confirm("F")
    b.confirm("G")
    for child, parent in ["zG", "ez", "ke", "qk", "bq", "aF"]:
        b.attach(child, parent)
    b.talk("b", "a")
    b.do("leave", "a")
    b.do("die", "e")
    b.at(5)
    b.confirm("G")
    b.talk("G", "z")
    b.do("certify", "z", "e")
    b.announce("z", "e")
    b.at(6)
    b.confirm("G")
    b.attach("h", "G")
    held = b.announce("h", "c")
    b.forward(held, "c", "e")
    b.do("let_go_of", "z", "e", held)
    b.do("leave", "z")
    b.do("let_go_of", "h", "c", sure)
    b.do("leave", "h")
    return b.run


RUNS = {
    "AdoptUnacknowledged": unacknowledged,
    "DropSilentChildren": silent_child,
    "IgnoreStrangers": stranger,
    "ForgetSaid": forgotten_announcement,
    "LetGoOldDeath": old_death,
    "BelieveAfterRestart": believing,
    "FinalFirst": final_first,
}
