"""The parent forest of cubes, and custody of the dead: why the body stays in one piece.

*Modelled.* `protocol/cube/src/parent_forest.rs`, `parent_forest/last_words.rs`, `custody.rs`, `sides.rs`,
`beacon.rs` and the forwarding of announcements in `sim-bridge/src/cube/registrar.rs`.

Beacons are numbered in each contact and direction, and only later ones than the last one are taken. A
module asks a neighbour of better rank to be its parent and adopts it once that has acknowledged the present
request; a parent forgets a child only when the child says so. Ranks are times of confirmation, then depths,
and never get worse. A restarted module has forgotten its parent and children; to the others it is another
contact, which each of them senses at a time of its own, and a body refuses to leave before its module has
sensed all its contacts. A module leaves if it has a parent and no neighbour may hang on it
(`ParentForest::held_by`), or if it touches one other module only.

The controller certifies deaths. A module whose path was confirmed after a death announces that it holds the
dead one, and when its path was confirmed. The controller forwards the announcement to all that touch a dead
module of the same cluster, if the dead modules in between died before that confirmation; the same for a
finalized module that touches the cluster, with a time at which the cluster was certainly connected. A
module lets go of a dead neighbour for a holder that was confirmed later than itself, or for any if it has
announced nothing. A restarted module lets go of none. A dead neighbour that touches a finalized module is
*fixed*: no module holds it, and it serves as a parent. One that hangs together with a finalized module over
other dead ones serves as a parent as of a time.

Beacons and announcements are facts: what was sent can be heard at any later time, any number of times, or
never.

*Ghosts.* The proof needs some things that no module knows: `anchor`, the neighbour over which a module is
connected in truth; `sup`, a finalized module that it touches, if there is one; and its true rank. That of a
module with a parent is its own. That of a dead one rises with each better announcement, to the time of
confirmation, then to the order of holders, then to the number of dead modules up to the holder.

*Coarser than the code.* A module may announce itself, ask, renew and adopt whenever that is permitted. Who
touches a dead module may use its certificate and all announcements about its present death at any time.
Labels are unbounded.

*Shown.* Every module of the body that is not finalized touches a finalized one, or its anchor stays,
touches it, and touches a finalized one or has the better true rank. Since ranks are a strict order and
modules are finitely many, a path from anchor to anchor comes to a finalized module; that last step is
not part of the model.

*Assumed.* A module that leaves is gone, and another module may come: the geometry of moves is left out. Walkers
are no part of the body, and do not die; that what carries them stays is shown in `leases.py`. Finalized
modules remember that they are, after a restart, too (the code has `View::final_hops` for that), and are
connected with each other. A time of confirmation is never later than the controller's clock. A restart and
a certificate come later than the death. One goal.

*Found by the proof:* a step that the code once took, now a variant that is refused: see `FOUND`.
"""

from inductive import Model, Part, all_of, any_of, choose, fixed, implies, no, put, where

NONE, WANT, PARENT = 0, 1, 2
"""Claims."""
HELD, RANKED, SURE = 0, 1, 2
"""Kinds of true ranks with one time, from the worst to the best: a dead module counts on an announced
holder; it is as when it lived; it hangs together with a finalized module over dead ones."""

ROOTED = "each hangs on a better one"
HOLDS = "holders do not hang on the dead"
LET_GO = "who has let go is no anchor"

FOUND = {
    "FinalFirst": "a module let go for a finalized holder that touches only other dead modules, although"
    " that was certain only before its own path was confirmed",
}
"""Steps that the code took until a proof without them could not be found."""


def higher(a, b):
    """Returns the term that a parent of rank `a` suits a module of rank `b`; ranks are times and labels."""
    return any_of(a[0] > b[0], all_of(a[0] == b[0], a[1] < b[1]))


def build(defect: str | None = None) -> Model:
    """Returns the model, with a defect if one is named."""
    m = Model("forest", sizes={"Module": 3, "Word": 2}, numbers=2)
    m.rigid = {
        "touches": ("Module", "Module", "Bool"),
        # The order of holders that were confirmed at the same time.
        "nearer": ("Module", "Module", "Bool"),
    }
    m.state = {
        "now": ("Real",),
        # The body.
        "here": ("Module", "Bool"),
        "gone": ("Module", "Bool"),
        "final": ("Module", "Bool"),
        "walks": ("Module", "Bool"),
        "dead": ("Module", "Bool"),
        "died": ("Module", "Real"),
        "restarted": ("Module", "Bool"),
        "listens": ("Module", "Bool"),
        # The forest, as each module knows it.
        "attached": ("Module", "Bool"),
        "parent": ("Module", "Module"),
        "adopted_at": ("Module", "Int"),
        "root": ("Module", "Real"),
        "label": ("Module", "Int"),
        "wants": ("Module", "Bool"),
        "wanted": ("Module", "Module"),
        "wanted_at": ("Module", "Int"),
        "token": ("Module", "Int"),
        "next_token": ("Module", "Int"),
        # The knowledge of a module about a neighbour; the one that knows comes first.
        "sensed": ("Module", "Module", "Bool"),
        "unheard": ("Module", "Module", "Bool"),
        "heard": ("Module", "Module", "Int"),
        "child": ("Module", "Module", "Bool"),
        "child_token": ("Module", "Module", "Int"),
        "claims": ("Module", "Module", "Int"),
        "is_attached": ("Module", "Module", "Bool"),
        "certified": ("Module", "Module", "Bool"),
        "announced": ("Module", "Module", "Bool"),
        "announced_at": ("Module", "Module", "Real"),
        "let_go": ("Module", "Module", "Bool"),
        "is_fixed": ("Module", "Module", "Bool"),
        "is_sure": ("Module", "Module", "Bool"),
        "sure_at": ("Module", "Module", "Real"),
        # Beacons by sender, receiver and number: the last number, the last one of earlier contacts, and the
        # contents.
        "last": ("Module", "Module", "Int"),
        "floor": ("Module", "Module", "Int"),
        "b_claim": ("Module", "Module", "Int", "Int"),
        "b_token": ("Module", "Module", "Int", "Int"),
        "b_attached": ("Module", "Module", "Int", "Bool"),
        "b_root": ("Module", "Module", "Int", "Real"),
        "b_label": ("Module", "Module", "Int", "Int"),
        "b_ack": ("Module", "Module", "Int", "Int"),
        # Announcements: who holds, since when that is confirmed, the dead module that the holder touches,
        # and the dead modules that the announcement is about in their present deaths, or was in an earlier
        # one.
        "said": ("Word", "Bool"),
        "holder": ("Word", "Module"),
        "confirmed": ("Word", "Real"),
        "of_final": ("Word", "Bool"),
        "direct": ("Word", "Module"),
        "about": ("Word", "Module", "Bool"),
        "was_about": ("Word", "Module", "Bool"),
        # Ghosts.
        "anchor": ("Module", "Module"),
        "sup": ("Module", "Module"),
        "held": ("Module", "Bool"),
        "g_root": ("Module", "Real"),
        "g_kind": ("Module", "Int"),
        "g_holder": ("Module", "Module"),
        "g_depth": ("Module", "Int"),
    }

    def axioms(s):
        def order(x, y):
            return all_of(
                any_of(s.nearer(x, y), s.nearer(y, x), x == y), no(all_of(s.nearer(x, y), s.nearer(y, x)))
            )

        def transitive(x, y, z):
            return implies(all_of(s.nearer(x, y), s.nearer(y, z)), s.nearer(x, z))

        return [
            s.every(
                "Module Module", lambda x, y: implies(s.touches(x, y), all_of(s.touches(y, x), no(x == y)))
            ),
            s.every("Module Module", order),
            s.every("Module", lambda x: no(s.nearer(x, x))),
            s.every("Module Module Module", transitive),
        ]

    m.axioms = axioms

    # Readings of a state.

    def alive(s, x):
        return all_of(s.here(x), no(s.dead(x)))

    def in_body(s, x):
        return all_of(s.here(x), no(s.walks(x)))

    def hangs(s, x):
        return all_of(in_body(s, x), no(s.final(x)))

    def solid(s, x):
        """The module touches a finalized one."""
        return all_of(s.final(s.sup(x)), s.touches(x, s.sup(x)))

    def own(s, x):
        return s.root(x), s.label(x)

    def true_rank(s, x):
        return s.g_root(x), s.g_kind(x), s.g_holder(x), s.g_depth(x)

    def above(s, a, b):
        """One true rank is better than another."""
        nearer = any_of(s.nearer(a[2], b[2]), all_of(a[2] == b[2], a[3] < b[3]))
        same_kind = all_of(a[1] == b[1], choose(a[1] == HELD, nearer, a[3] < b[3]))
        return any_of(a[0] > b[0], all_of(a[0] == b[0], any_of(a[1] > b[1], same_kind)))

    def covers(s, x, w):
        """The true rank of a dead module is at least what an announcement gives, at any depth."""
        kind = s.g_kind(x)
        as_held = any_of(kind > HELD, s.nearer(s.g_holder(x), s.holder(w)), s.g_holder(x) == s.holder(w))
        same = choose(s.of_final(w), kind == SURE, as_held)
        return any_of(s.g_root(x) > s.confirmed(w), all_of(s.g_root(x) == s.confirmed(w), same))

    def covers_told(s, x, root, label):
        """The true rank of a module is at least a rank that a module with a parent has, or had."""
        kind, depth = s.g_kind(x), s.g_depth(x)
        same = any_of(kind == SURE, all_of(kind == RANKED, depth <= label))
        return any_of(s.g_root(x) > root, all_of(s.g_root(x) == root, same))

    def at_least_true(s, x):
        """The rank that the next parent of a module must exceed is no worse than its true rank."""
        kind, depth = s.g_kind(x), s.g_depth(x)
        same = any_of(kind == HELD, all_of(kind == RANKED, s.label(x) <= depth))
        return any_of(s.root(x) > s.g_root(x), all_of(s.root(x) == s.g_root(x), same))

    def valid(s, x, p, k):
        """A beacon of the present contact."""
        return all_of(s.floor(x, p) < k, k <= s.last(x, p))

    def initial(s):
        def module(x):
            rank = all_of(s.g_root(x) == -1, s.g_kind(x) == RANKED, s.g_depth(x) >= 1, s.label(x) >= 1)
            root = s.root(x) == choose(s.final(x), 0, -1)
            nothing = [s.dead(x), s.gone(x), s.attached(x), s.wants(x), s.restarted(x), s.held(x)]
            tokens = all_of(s.token(x) == 0, s.next_token(x) == 1, s.died(x) == 0, s.label(x) == s.g_depth(x))
            finals = implies(s.final(x), all_of(s.here(x), no(s.walks(x))))
            return all_of([no(term) for term in nothing], rank, root, tokens, finals, rooted(s, x))

        def pair(x, y):
            counts = [s.last(x, y), s.heard(x, y), s.floor(x, y), s.child_token(x, y)]
            nothing = [s.child(x, y), s.certified(x, y), s.announced(x, y), s.let_go(x, y)]
            nothing += [s.is_fixed(x, y), s.is_sure(x, y)]
            fresh = all_of(s.unheard(x, y), s.sensed(x, y))
            return all_of([count == 0 for count in counts], [no(term) for term in nothing], fresh)

        return [
            s.now() == 0,
            s.every("Module", module),
            s.every("Module Module", pair),
            s.every("Word", lambda w: no(s.said(w))),
            s.every("Word Module", lambda w, x: all_of(no(s.about(w, x)), no(s.was_about(w, x)))),
        ]

    m.initial = initial

    def forget(s, p_test):
        """Returns the changes of contacts that begin anew; `p_test` tells which, by who knows and of whom."""
        return dict(
            unheard=where(s.unheard, p_test, True),
            child=where(s.child, p_test, False),
            certified=where(s.certified, p_test, False),
            announced=where(s.announced, p_test, False),
            let_go=where(s.let_go, p_test, False),
            is_fixed=where(s.is_fixed, p_test, False),
            is_sure=where(s.is_sure, p_test, False),
        )

    # Beacons and the handshake.

    @m.action("Module", "Module")
    def tell(s, x, p):
        k = s.last(x, p) + 1
        wants = all_of(s.wants(x), s.wanted(x) == p)
        hangs_on = all_of(s.attached(x), s.parent(x) == p)
        claim = choose(s.final(x), NONE, choose(wants, WANT, choose(hangs_on, PARENT, NONE)))
        at = (x, p, k)
        guard = all_of(alive(s, x), s.here(p), s.touches(x, p), s.sensed(x, p))
        after = s.but(
            last=put(s.last, (x, p), k),
            b_claim=put(s.b_claim, at, claim),
            b_token=put(s.b_token, at, s.token(x)),
            b_attached=put(s.b_attached, at, any_of(s.final(x), s.attached(x))),
            b_root=put(s.b_root, at, s.root(x)),
            b_label=put(s.b_label, at, s.label(x)),
            b_ack=put(s.b_ack, at, choose(s.child(x, p), s.child_token(x, p), -1)),
        )
        return guard, after

    @m.action("Module", "Module", "Int")
    def hear(s, p, x, k):
        """A module takes a beacon: it registers or forgets the sender as a child, adopts it as the parent
        if that has acknowledged, and follows the rank of its parent."""
        at = (x, p, k)
        claim, token, said = s.b_claim(*at), s.b_token(*at), (s.b_root(*at), s.b_label(*at))
        guard = [
            alive(s, p),
            s.touches(x, p),
            s.sensed(p, x),
            valid(s, x, p, k),
            k > s.heard(p, x),
        ]
        if defect != "ForgetSaid":
            guard.append(no(s.certified(p, x)))
        may_adopt = all_of(any_of(s.final(p), s.attached(p)), no(s.listens(p)), no(s.walks(p)))
        registers = any_of(claim == PARENT, all_of(claim == WANT, may_adopt))
        acknowledged = all_of(s.wants(p), s.wanted(p) == x)
        if defect != "AdoptUnacknowledged":
            acknowledged = all_of(acknowledged, s.b_ack(*at) == s.token(p))
        usable = all_of(s.b_attached(*at), claim == NONE, no(s.final(p)))
        adopts = all_of(acknowledged, usable, higher(said, own(s, p)))
        below = (said[0], said[1] + 1)
        follows = all_of(s.attached(p), s.parent(p) == x, usable, higher(below, own(s, p)))
        ranks = any_of(adopts, follows)
        after = s.but(
            heard=put(s.heard, (p, x), k),
            unheard=put(s.unheard, (p, x), False),
            claims=put(s.claims, (p, x), claim),
            is_attached=put(s.is_attached, (p, x), s.b_attached(*at)),
            child=put(s.child, (p, x), choose(claim == NONE, False, any_of(registers, s.child(p, x)))),
            child_token=put(s.child_token, (p, x), choose(registers, token, s.child_token(p, x))),
            attached=put(s.attached, p, any_of(adopts, s.attached(p))),
            parent=put(s.parent, p, choose(adopts, x, s.parent(p))),
            anchor=put(s.anchor, p, choose(adopts, x, s.anchor(p))),
            walks=put(s.walks, p, all_of(s.walks(p), no(adopts))),
            wants=put(s.wants, p, all_of(s.wants(p), no(adopts))),
            adopted_at=put(s.adopted_at, p, choose(adopts, s.wanted_at(p), s.adopted_at(p))),
            root=put(s.root, p, choose(ranks, below[0], s.root(p))),
            label=put(s.label, p, choose(ranks, below[1], s.label(p))),
            g_root=put(s.g_root, p, choose(ranks, below[0], s.g_root(p))),
            g_depth=put(s.g_depth, p, choose(ranks, below[1], s.g_depth(p))),
            g_kind=put(s.g_kind, p, choose(ranks, RANKED, s.g_kind(p))),
        )
        return all_of(guard), after

    @m.action("Module", "Module")
    def ask(s, x, p):
        hangs_on = all_of(s.attached(x), s.parent(x) == p)
        guard = all_of(
            alive(s, x),
            s.here(p),
            s.touches(x, p),
            s.sensed(x, p),
            no(s.unheard(x, p)),
            no(s.final(x)),
            no(s.wants(x)),
            no(hangs_on),
        )
        after = s.but(
            wants=put(s.wants, x, True),
            wanted=put(s.wanted, x, p),
            wanted_at=put(s.wanted_at, x, s.last(x, p)),
            token=put(s.token, x, s.next_token(x)),
            next_token=put(s.next_token, x, s.next_token(x) + 1),
        )
        return guard, after

    @m.action("Module")
    def drop_request(s, x):
        return all_of(alive(s, x), s.wants(x)), s.but(wants=put(s.wants, x, False))

    @m.action("Module", "Real")
    def confirm(s, x, at):
        """A finalized module confirms the paths to it anew."""
        guard = all_of(alive(s, x), s.final(x), s.root(x) <= at, at <= s.now())
        return guard, s.but(root=put(s.root, x, at))

    @m.action("Module", "Module")
    def finalize(s, x, q):
        """A module is finalized beside a finalized one, or beside a dead one that touches a finalized one."""
        starts = any_of(s.final(q), all_of(s.dead(q), solid(s, q)))
        guard = all_of(alive(s, x), no(s.listens(x)), s.touches(x, q), s.here(q), starts)
        after = s.but(
            final=put(s.final, x, True),
            walks=put(s.walks, x, False),
            wants=put(s.wants, x, False),
            attached=put(s.attached, x, False),
            label=put(s.label, x, 0),
        )
        return guard, after

    # Leaving and coming.

    def is_free(s, p, y):
        """A neighbour does not hang on a module, as far as that knows."""
        says_so = all_of(no(s.child(p, y)), s.is_attached(p, y), s.claims(p, y) == NONE)
        if defect == "DropSilentChildren":
            says_so = True
        says_so = all_of(no(s.unheard(p, y)), says_so)
        if defect == "IgnoreStrangers":
            says_so = any_of(s.unheard(p, y), says_so)
        if defect != "ForgetSaid":
            says_so = all_of(no(s.announced(p, y)), says_so)
        is_fixed = all_of(s.certified(p, y), s.is_fixed(p, y), no(s.restarted(p)), no(s.child(p, y)))
        return any_of(s.final(y), all_of(s.certified(p, y), s.let_go(p, y)), is_fixed, says_so)

    def leaves(s, x):
        return s.but(here=put(s.here, x, False), gone=put(s.gone, x, True))

    @m.action("Module")
    def leave(s, x):
        def permits(y):
            free = choose(s.walks(y), no(s.child(x, y)), is_free(s, x, y))
            return implies(all_of(s.touches(x, y), s.here(y)), all_of(s.sensed(x, y), free))

        guard = all_of(alive(s, x), hangs(s, x), s.attached(x), no(s.listens(x)), s.every("Module", permits))
        return guard, leaves(s, x)

    @m.action("Module", "Module")
    def leave_end(s, x, only):
        """A module that touches one other only connects no others."""

        def permits(y):
            says_so = all_of(no(s.unheard(x, y)), s.claims(x, y) == NONE, no(s.child(x, y)))
            free = all_of(s.sensed(x, y), y == only, any_of(s.certified(x, y), says_so))
            return implies(all_of(s.touches(x, y), s.here(y)), free)

        return all_of(alive(s, x), hangs(s, x), s.every("Module", permits)), leaves(s, x)

    @m.action("Module")
    def arrive(s, x):
        """A walker comes, and begins a contact with every neighbour."""

        def mine(p, y):
            return any_of(p == x, y == x)

        guard = all_of(no(s.here(x)), no(s.gone(x)))
        after = s.but(
            here=put(s.here, x, True),
            walks=put(s.walks, x, True),
            dead=put(s.dead, x, False),
            final=put(s.final, x, False),
            attached=put(s.attached, x, False),
            wants=put(s.wants, x, False),
            restarted=put(s.restarted, x, False),
            listens=put(s.listens, x, False),
            held=put(s.held, x, False),
            root=put(s.root, x, -1),
            g_root=put(s.g_root, x, -1),
            g_kind=put(s.g_kind, x, RANKED),
            g_depth=put(s.g_depth, x, 1),
            label=put(s.label, x, 1),
            sensed=where(s.sensed, mine, lambda p, y: p == x),
            floor=where(s.floor, mine, s.last),
            about=where(s.about, lambda w, y: y == x, False),
            **forget(s, mine),
        )
        return guard, after

    # Death and restart.

    @m.action("Module")
    def die(s, x):
        guard = all_of(alive(s, x), no(s.walks(x)))
        return guard, s.but(dead=put(s.dead, x, True), died=put(s.died, x, s.now()))

    @m.action("Module", "Module")
    def certify(s, p, x):
        guard = all_of(s.dead(x), s.sensed(p, x), alive(s, p), s.touches(p, x), s.now() > s.died(x))
        return guard, s.but(certified=put(s.certified, (p, x), True))

    @m.action("Module")
    def restart(s, x):
        """The process begins again, and knows nothing but, if it was finalized, that. The others will sense
        a new contact."""

        def own_side(p, y):
            return p == x

        def mine(p, y):
            return any_of(p == x, y == x)

        final = s.final(x)
        guard = all_of(s.dead(x), s.now() > s.died(x), s.now() > s.g_root(x))
        after = s.but(
            dead=put(s.dead, x, False),
            restarted=put(s.restarted, x, True),
            listens=put(s.listens, x, no(final)),
            attached=put(s.attached, x, False),
            wants=put(s.wants, x, False),
            root=put(s.root, x, choose(final, s.root(x), s.now())),
            label=put(s.label, x, 0),
            held=put(s.held, x, False),
            sensed=where(s.sensed, mine, lambda p, y: p == x),
            floor=where(s.floor, mine, s.last),
            about=where(s.about, lambda w, y: y == x, False),
            **forget(s, own_side),
        )
        return guard, after

    @m.action("Module", "Module")
    def sense(s, p, x):
        """A module senses that a contact has begun anew."""

        def mine(q, y):
            return all_of(q == p, y == x)

        guard = all_of(alive(s, p), s.here(x), no(s.sensed(p, x)))
        drops = all_of(s.wants(p), s.wanted(p) == x)
        after = s.but(
            sensed=put(s.sensed, (p, x), True),
            wants=put(s.wants, p, all_of(s.wants(p), no(drops))),
            **forget(s, mine),
        )
        return guard, after

    @m.action("Module")
    def end_listening(s, x):
        return all_of(alive(s, x), s.listens(x)), s.but(listens=put(s.listens, x, False))

    # Custody.

    @m.action("Module", "Module", "Word", "Real")
    def announce(s, p, x, w, confirmed):
        """A module announces that it holds a dead neighbour. The word counts for the death that the module
        knows of."""
        later = s.root(p) > s.died(x)
        if defect == "LetGoUnproved":
            later = True
        if defect == "ChildProves":
            later = any_of(later, s.child(p, x))
        is_above = all_of(s.attached(p), no(s.parent(p) == x), implies(s.sensed(p, x), later))
        guard = all_of(
            alive(s, p),
            in_body(s, p),
            no(s.final(x)),
            s.here(x),
            s.touches(p, x),
            s.certified(p, x),
            no(s.listens(p)),
            no(s.let_go(p, x)),
            any_of(s.final(p), is_above),
            confirmed <= s.root(p),
            no(s.said(w)),
        )
        # The controller forwards what was confirmed after the death.
        counts = all_of(s.sensed(p, x), s.died(x) < confirmed)
        new = (confirmed, HELD, p, 0)
        rises = all_of(counts, no(s.final(p)), above(s, new, true_rank(s, x)))
        after = s.but(
            announced=put(s.announced, (p, x), True),
            announced_at=put(s.announced_at, (p, x), s.root(p)),
            said=put(s.said, w, True),
            holder=put(s.holder, w, p),
            confirmed=put(s.confirmed, w, confirmed),
            of_final=put(s.of_final, w, s.final(p)),
            direct=put(s.direct, w, x),
            about=where(s.about, lambda v, y: v == w, lambda v, y: all_of(y == x, counts, no(s.final(p)))),
            was_about=where(s.was_about, lambda v, y: all_of(v == w, y == x), no(s.final(p))),
            held=put(s.held, x, any_of(s.held(x), all_of(counts, no(s.final(p))))),
            sup=put(s.sup, x, choose(all_of(s.final(p), no(solid(s, x))), p, s.sup(x))),
            anchor=put(s.anchor, x, choose(rises, p, s.anchor(x))),
            g_root=put(s.g_root, x, choose(rises, new[0], s.g_root(x))),
            g_kind=put(s.g_kind, x, choose(rises, new[1], s.g_kind(x))),
            g_holder=put(s.g_holder, x, choose(rises, new[2], s.g_holder(x))),
            g_depth=put(s.g_depth, x, choose(rises, new[3], s.g_depth(x))),
        )
        return guard, after

    def spread(s, cluster, up, depth, root, kind, holder):
        """Gives the dead of a cluster their new anchors and ranks, where these are better."""

        def rises(e):
            return all_of(cluster(e), depth(e) > 0, above(s, (root, kind, holder, depth(e)), true_rank(s, e)))

        return dict(
            held=where(s.held, cluster, True),
            anchor=where(s.anchor, rises, up),
            g_root=where(s.g_root, rises, lambda e: root),
            g_kind=where(s.g_kind, rises, lambda e: kind),
            g_holder=where(s.g_holder, rises, lambda e: holder),
            g_depth=where(s.g_depth, rises, depth),
        )

    def is_cluster(s, cluster, up, depth, first, since):
        """Dead modules that hang together with the first one and died before a time; `up` leads to the
        first one."""

        def member(e):
            nearer = all_of(cluster(up(e)), s.touches(e, up(e)), depth(up(e)) < depth(e), depth(e) > 0)
            return implies(
                cluster(e),
                all_of(s.dead(e), no(s.final(e)), s.died(e) < since, any_of(e == first, nearer)),
            )

        return all_of(cluster(first), depth(first) == 0, s.every("Module", member))

    @m.action("Word", ("Module", "Bool"), ("Module", "Module"), ("Module", "Int"))
    def forward(s, w, cluster, up, depth):
        """The controller forwards an announcement to all that touch a dead module of the cluster."""
        guard = all_of(
            s.said(w),
            no(s.of_final(w)),
            s.about(w, s.direct(w)),
            is_cluster(s, cluster, up, depth, s.direct(w), s.confirmed(w)),
        )
        after = s.but(
            about=where(s.about, lambda v, y: all_of(v == w, cluster(y)), True),
            was_about=where(s.was_about, lambda v, y: all_of(v == w, cluster(y)), True),
            **spread(s, cluster, up, depth, s.confirmed(w), HELD, s.holder(w)),
        )
        return guard, after

    @m.action("Word", "Module", "Module", "Real", ("Module", "Bool"), ("Module", "Module"), ("Module", "Int"))
    def forward_final(s, w, f, first, sure, cluster, up, depth):
        """The controller announces a finalized module that touches a cluster, and when that was certain."""
        guard = all_of(
            no(s.said(w)),
            s.final(f),
            s.touches(first, f),
            sure <= s.now(),
            is_cluster(s, cluster, up, depth, first, sure),
        )
        ranks = spread(s, cluster, up, depth, sure, SURE, f)
        # The first one touches a finalized module itself, and needs no anchor.
        first_rank = (sure, SURE, f, 0)
        rises = above(s, first_rank, true_rank(s, first))
        after = s.but(
            said=put(s.said, w, True),
            holder=put(s.holder, w, f),
            confirmed=put(s.confirmed, w, sure),
            of_final=put(s.of_final, w, True),
            direct=put(s.direct, w, first),
            about=where(s.about, lambda v, y: v == w, lambda v, y: cluster(y)),
            was_about=where(s.was_about, lambda v, y: all_of(v == w, cluster(y)), True),
            sup=put(s.sup, first, choose(solid(s, first), s.sup(first), f)),
            held=ranks["held"],
            anchor=put(ranks["anchor"], first, choose(rises, f, s.anchor(first))),
            g_root=put(ranks["g_root"], first, choose(rises, sure, s.g_root(first))),
            g_kind=put(ranks["g_kind"], first, choose(rises, SURE, s.g_kind(first))),
            g_holder=put(ranks["g_holder"], first, choose(rises, f, s.g_holder(first))),
            g_depth=put(ranks["g_depth"], first, choose(rises, 0, s.g_depth(first))),
        )
        return guard, after

    @m.action("Module", "Module", "Word")
    def let_go_of(s, p, x, w):
        """A module hears of a better holder of a dead neighbour than itself. In a contact that has begun anew
        unnoticed it may still hear of the death before."""
        counts = s.was_about(w, x) if defect == "LetGoOldDeath" else any_of(s.about(w, x), no(s.sensed(p, x)))
        own_time = s.announced_at(p, x)
        ties = any_of(s.of_final(w), s.nearer(s.holder(w), p))
        is_better = any_of(s.confirmed(w) > own_time, all_of(s.confirmed(w) == own_time, ties))
        if defect == "FinalFirst":
            is_better = any_of(s.of_final(w), is_better)
        if defect == "ClusterOrder":
            is_better = ties
        guard = [
            alive(s, p),
            s.here(x),
            s.touches(p, x),
            s.certified(p, x),
            s.said(w),
            counts,
            no(s.holder(w) == p),
            any_of(no(s.announced(p, x)), is_better),
        ]
        if defect != "BelieveAfterRestart":
            guard.append(no(s.restarted(p)))
        after = s.but(let_go=put(s.let_go, (p, x), True), child=put(s.child, (p, x), False))
        return all_of(guard), after

    @m.action("Module", "Module", "Module")
    def learn_fixed(s, p, x, f):
        """A module learns that a dead neighbour touches a finalized module: from the last words of the dead
        one, its certificate, or an announcement of a finalized holder."""
        guard = all_of(
            alive(s, p),
            s.certified(p, x),
            s.here(x),
            s.touches(p, x),
            s.touches(x, f),
            s.final(f),
        )
        # One that has restarted takes it for its parent, and holds it all the same.
        after = s.but(
            is_fixed=put(s.is_fixed, (p, x), True),
            child=put(s.child, (p, x), all_of(s.child(p, x), s.restarted(p))),
            sup=put(s.sup, x, choose(solid(s, x), s.sup(x), f)),
        )
        return guard, after

    def takes_dead_parent(s, x, d, root):
        return s.but(
            attached=put(s.attached, x, True),
            wants=put(s.wants, x, False),
            parent=put(s.parent, x, d),
            anchor=put(s.anchor, x, d),
            adopted_at=put(s.adopted_at, x, s.last(x, d)),
            root=put(s.root, x, root),
            label=put(s.label, x, 1),
            g_root=put(s.g_root, x, root),
            g_kind=put(s.g_kind, x, RANKED),
            g_depth=put(s.g_depth, x, 1),
        )

    @m.action("Module", "Module", "Real")
    def hang_on_dead(s, x, d, root):
        """A module takes a dead neighbour as its parent that was finalized or touches a finalized module,
        and confirms the path itself from then on."""
        stays = any_of(s.final(d), s.is_fixed(x, d))
        guard = all_of(
            alive(s, x),
            hangs(s, x),
            s.certified(x, d),
            s.touches(x, d),
            s.here(d),
            stays,
            s.root(x) <= root,
            root <= s.now(),
        )
        return guard, takes_dead_parent(s, x, d, root)

    @m.action("Module", "Module", "Word")
    def learn_sure(s, x, d, w):
        """A module hears when a dead neighbour was certainly connected with a finalized module over dead
        ones."""
        guard = all_of(
            alive(s, x),
            s.certified(x, d),
            s.here(d),
            s.touches(x, d),
            s.said(w),
            s.of_final(w),
            s.about(w, d),
        )
        after = s.but(
            is_sure=put(s.is_sure, (x, d), True),
            sure_at=put(s.sure_at, (x, d), s.confirmed(w)),
        )
        return guard, after

    @m.action("Module", "Module")
    def hang_on_connected(s, x, d):
        """A module takes such a neighbour as its parent, with a path that is as new as that is certain."""
        guard = all_of(
            alive(s, x),
            hangs(s, x),
            s.is_sure(x, d),
            s.touches(x, d),
            s.here(d),
            higher((s.sure_at(x, d), 1), own(s, x)),
        )
        return guard, takes_dead_parent(s, x, d, s.sure_at(x, d))

    @m.action("Real")
    def pass_time(s, later):
        return later >= s.now(), s.but(now=fixed(later))

    # Invariants.

    def rooted(s, x):
        up = s.anchor(x)
        is_better = any_of(s.final(up), solid(s, up), above(s, true_rank(s, up), true_rank(s, x)))
        return implies(hangs(s, x), any_of(solid(s, x), all_of(in_body(s, up), s.touches(x, up), is_better)))

    @m.goal(ROOTED, "Module")
    def _(s, x):
        return rooted(s, x)

    @m.goal("anchors stay", "Module")
    def _(s, x):
        p = s.anchor(x)
        holds = any_of(
            s.final(p),
            s.dead(p),
            no(s.sensed(p, x)),
            s.unheard(p, x),
            s.child(p, x),
            no(s.is_attached(p, x)),
            no(s.claims(p, x) == NONE),
            s.announced(p, x),
        )
        return implies(all_of(hangs(s, x), no(solid(s, x))), holds)

    @m.goal(HOLDS, "Module Module")
    def _(s, p, x):
        holds = all_of(s.announced(p, x), s.sensed(p, x), alive(s, p), no(s.final(p)))
        return implies(holds, s.announced_at(p, x) > s.died(x))

    @m.goal(LET_GO, "Module Module")
    def _(s, p, x):
        counts = all_of(s.let_go(p, x), s.sensed(p, x), alive(s, p), no(s.final(p)), hangs(s, x))
        return implies(all_of(counts, no(solid(s, x))), all_of(s.held(x), no(s.anchor(x) == p)))

    @m.invariant("anchors of the dead", "Module")
    def _(s, x):
        """A dead module with a holder counts on that, or on another dead one, or on one that was dead and has
        restarted."""
        p = s.anchor(x)
        is_holder = all_of(
            s.g_kind(x) == HELD,
            s.g_holder(x) == p,
            s.announced(p, x),
            no(s.let_go(p, x)),
            s.sensed(p, x),
            s.g_root(x) <= s.announced_at(p, x),
        )
        restarted = all_of(s.restarted(p), s.unheard(p, x), s.sensed(p, x), s.floor(x, p) == s.last(x, p))
        rests = any_of(s.final(p), s.dead(p), restarted, is_holder)
        return implies(all_of(hangs(s, x), s.held(x), no(solid(s, x))), rests)

    @m.invariant("custody is of the dead", "Module Module")
    def _(s, p, x):
        knows = any_of(
            s.certified(p, x), s.announced(p, x), s.let_go(p, x), s.is_fixed(p, x), s.is_sure(p, x)
        )
        is_dead = all_of(s.dead(x), s.here(x), s.died(x) <= s.now())
        of_body = implies(all_of(knows, s.here(x)), no(s.walks(x)))
        return all_of(of_body, implies(all_of(knows, s.sensed(p, x), alive(s, p)), is_dead))

    @m.invariant("times of announcements rise", "Module Module")
    def _(s, p, x):
        return implies(s.announced(p, x), s.announced_at(p, x) <= s.root(p))

    @m.invariant("the restarted let go of none", "Module Module")
    def _(s, p, x):
        return implies(s.let_go(p, x), no(s.restarted(p)))

    @m.invariant("the fixed touch a finalized module", "Module Module")
    def _(s, p, x):
        return implies(all_of(s.is_fixed(p, x), s.here(x)), solid(s, x))

    @m.invariant("what is sure stays true", "Module Module")
    def _(s, p, x):
        at = s.sure_at(p, x)
        covered = any_of(
            s.g_root(x) > at, all_of(s.g_root(x) == at, s.g_kind(x) == SURE), solid(s, x), s.final(x)
        )
        counts = all_of(s.is_sure(p, x), alive(s, p), s.here(x))
        return implies(counts, all_of(at <= s.now(), no(s.walks(x)), covered))

    @m.invariant("words", "Word Module")
    def _(s, w, x):
        counts = all_of(s.said(w), s.held(x), s.dead(x), s.here(x), s.died(x) < s.confirmed(w))
        return implies(s.about(w, x), all_of(counts, s.confirmed(w) <= s.now(), covers(s, x, w)))

    @m.invariant("first words", "Word")
    def _(s, w):
        x = s.direct(w)
        new = (s.confirmed(w), HELD, s.holder(w), 0)
        same = any_of(
            s.g_kind(x) > HELD,
            s.nearer(s.g_holder(x), s.holder(w)),
            all_of(s.g_holder(x) == s.holder(w), s.g_depth(x) <= 0),
        )
        at_least = any_of(s.g_root(x) > new[0], all_of(s.g_root(x) == new[0], same))
        return implies(all_of(s.about(w, x), no(s.of_final(w))), at_least)

    @m.invariant("the held are dead", "Module")
    def _(s, x):
        return implies(s.held(x), all_of(s.dead(x), s.here(x)))

    @m.invariant("true ranks", "Module")
    def _(s, x):
        known = any_of(s.g_kind(x) == HELD, s.g_kind(x) == RANKED, s.g_kind(x) == SURE)
        labels = implies(s.g_kind(x) == RANKED, s.g_depth(x) >= 1)
        depths = all_of(implies(no(s.g_kind(x) == RANKED), s.g_depth(x) >= 0), s.label(x) >= 0)
        before = implies(all_of(s.dead(x), no(s.held(x))), s.g_root(x) <= s.died(x))
        return all_of(
            known, implies(hangs(s, x), labels), implies(hangs(s, x), depths), before, s.g_root(x) <= s.now()
        )

    @m.invariant("times", "Module")
    def _(s, x):
        return all_of(0 <= s.now(), s.root(x) <= s.now(), s.died(x) <= s.now(), s.label(x) >= 0)

    @m.invariant("parents are anchors", "Module")
    def _(s, x):
        same = all_of(s.parent(x) == s.anchor(x), s.root(x) == s.g_root(x), s.label(x) == s.g_depth(x))
        is_placed = all_of(no(s.walks(x)), no(s.final(x)))
        counts = all_of(s.here(x), s.attached(x))
        return implies(counts, all_of(is_placed, implies(no(s.held(x)), all_of(same, s.g_kind(x) == RANKED))))

    @m.invariant("the next parent is better", "Module")
    def _(s, x):
        return implies(all_of(hangs(s, x), no(s.held(x))), at_least_true(s, x))

    @m.invariant("children claim their parents", "Module Int")
    def _(s, x, k):
        p = s.parent(x)
        is_child = all_of(s.here(x), s.attached(x), no(s.held(x)))
        return implies(
            all_of(is_child, valid(s, x, p, k), k > s.adopted_at(x)),
            no(s.b_claim(x, p, k) == NONE),
        )

    @m.invariant("parents know their children", "Module")
    def _(s, x):
        p = s.parent(x)
        is_child = all_of(s.here(x), s.attached(x), no(s.held(x)), alive(s, p), no(s.final(p)))
        since = s.adopted_at(x)
        knows = all_of(s.sensed(p, x), choose(s.unheard(p, x), since <= s.floor(x, p), s.heard(p, x) > since))
        return implies(is_child, knows)

    @m.invariant("requests are repeated", "Module Int")
    def _(s, x, k):
        p = s.wanted(x)
        wants = all_of(alive(s, x), s.wants(x), valid(s, x, p, k), k > s.wanted_at(x))
        return implies(wants, all_of(s.b_claim(x, p, k) == WANT, s.b_token(x, p, k) == s.token(x)))

    @m.invariant("older beacons have older tokens", "Module Module Int")
    def _(s, x, p, k):
        wants = all_of(alive(s, x), s.wants(x), s.wanted(x) == p, k <= s.wanted_at(x), k <= s.last(x, p))
        return implies(all_of(wants, k > s.floor(x, p)), s.b_token(x, p, k) < s.token(x))

    @m.invariant("tokens are given once", "Module Module Int")
    def _(s, x, p, k):
        given = all_of(s.token(x) < s.next_token(x), s.token(x) >= 0, s.child_token(p, x) < s.next_token(x))
        sent = implies(valid(s, x, p, k), s.b_token(x, p, k) < s.next_token(x))
        acked = implies(valid(s, p, x, k), s.b_ack(p, x, k) < s.next_token(x))
        return all_of(given, sent, acked)

    @m.invariant("registered by the present request", "Module Module")
    def _(s, p, x):
        wants = all_of(alive(s, x), s.wants(x), s.wanted(x) == p)
        is_it = all_of(s.child(p, x), s.child_token(p, x) == s.token(x))
        return implies(all_of(wants, is_it, s.sensed(p, x)), s.heard(p, x) > s.wanted_at(x))

    @m.invariant("acknowledged is registered", "Module Module Int")
    def _(s, p, x, k):
        wants = all_of(alive(s, x), s.wants(x), s.wanted(x) == p, s.sensed(x, p))
        is_it = all_of(valid(s, p, x, k), s.b_ack(p, x, k) == s.token(x))
        is_child = all_of(s.heard(p, x) > s.wanted_at(x), s.child(p, x), no(s.unheard(p, x)), s.sensed(p, x))
        return implies(all_of(wants, is_it), is_child)

    @m.invariant("who has registered is there", "Module Module")
    def _(s, p, x):
        is_child = all_of(s.child(p, x), s.sensed(p, x), alive(s, x), no(s.final(x)), s.touches(p, x))
        return implies(is_child, any_of(s.here(p), no(s.wants(x)), no(s.wanted(x) == p)))

    @m.invariant("strangers are no children", "Module Module")
    def _(s, p, x):
        return implies(s.unheard(p, x), no(s.child(p, x)))

    @m.invariant("who has not sensed says nothing", "Module Module")
    def _(s, x, p):
        silent = all_of(s.last(x, p) == s.floor(x, p), s.unheard(p, x))
        return implies(all_of(no(s.sensed(x, p)), s.here(x), s.here(p)), silent)

    @m.invariant("one side has sensed a contact", "Module Module")
    def _(s, x, p):
        return implies(all_of(s.here(x), s.here(p), no(x == p)), any_of(s.sensed(x, p), s.sensed(p, x)))

    @m.invariant("the unattached say so", "Module Module Int")
    def _(s, x, p, k):
        is_loose = all_of(hangs(s, x), no(s.attached(x)), valid(s, x, p, k))
        return implies(is_loose, no(s.b_attached(x, p, k)))

    @m.invariant("the unattached are known as such", "Module Module")
    def _(s, x, p):
        is_loose = all_of(hangs(s, x), no(s.attached(x)), no(s.unheard(p, x)), s.sensed(p, x))
        return implies(is_loose, no(s.is_attached(p, x)))

    @m.invariant("ranks said are past", "Module Module Int")
    def _(s, x, p, k):
        past = all_of(s.b_root(x, p, k) <= s.now(), s.b_label(x, p, k) >= 0)
        return implies(all_of(valid(s, x, p, k), s.b_attached(x, p, k)), past)

    @m.invariant("ranks said are true", "Module Module Int")
    def _(s, x, p, k):
        said = all_of(valid(s, x, p, k), s.here(x), s.b_attached(x, p, k))
        covered = all_of(no(s.walks(x)), covers_told(s, x, s.b_root(x, p, k), s.b_label(x, p, k)))
        return implies(said, any_of(s.final(x), covered))

    @m.invariant("numbers", "Module Module")
    def _(s, x, p):
        wants = implies(all_of(s.wants(x), s.wanted(x) == p), s.wanted_at(x) <= s.last(x, p))
        child = implies(all_of(s.attached(x), s.parent(x) == p), s.adopted_at(x) <= s.last(x, p))
        heard = all_of(s.heard(p, x) <= s.last(x, p), s.floor(x, p) <= s.last(x, p))
        return all_of(heard, wants, child)

    @m.invariant("the dead and the finalized stay", "Module")
    def _(s, x):
        dead = implies(s.dead(x), all_of(s.here(x), no(s.walks(x))))
        final = implies(s.final(x), all_of(s.here(x), no(s.walks(x)), no(s.attached(x)), no(s.wants(x))))
        return all_of(dead, final, implies(s.here(x), no(s.gone(x))))

    def bounds(s):
        return s.every("Module Module", lambda x, p: all_of(0 <= s.floor(x, p), s.last(x, p) <= m.numbers))

    m.bounds = bounds
    return m


PART = Part(
    name="forest",
    title="(b) forest and custody",
    build=build,
    found=FOUND,
    refusals={
        "AdoptUnacknowledged": [("hear", "anchors stay")],
        "DropSilentChildren": [("leave", ROOTED)],
        "IgnoreStrangers": [("leave", ROOTED)],
        "LetGoUnproved": [("announce", HOLDS)],
        "ChildProves": [("announce", HOLDS)],
        "ForgetSaid": [("leave", ROOTED)],
        "LetGoOldDeath": [("let_go_of", LET_GO)],
        "ClusterOrder": [("let_go_of", LET_GO)],
        "BelieveAfterRestart": [("let_go_of", "the restarted let go of none")],
        "FinalFirst": [("let_go_of", LET_GO)],
    },
)
