"""The link between two hosts: fencing, and a stream of bytes.

*Modelled.* `protocol/host-link/src`: the link to one life of the other host, `streams.rs`, and the check of
lives in `lib.rs`.

Fencing, between a guardian and its ward: the guardian counts the ward as dead when it has not heard it for
`fence` (`ends_at`); the ward acts until a fiftieth less than `fence` after the latest time of its own clock
that the guardian is known to have heard (`acts_until`). An acknowledgement carries the sender's clock and
the latest clock heard from the other end (`ack`), so an echo is a time at which the ward spoke and after
which the guardian has heard it. The first lease of a link comes from the greeting, whose number is the time
at which it was sent (`HostLink::meet`); it is an echo like the others.

A stream: parts carry the place of their first byte; the receiver takes those bytes that come next, and
nothing of a part behind a gap (`StreamReceiver::take`). A part belongs to the lives of both ends
(`HostLink::take`, `HostLink::on_content`), and a link to a later life begins a new stream
(`HostLink::meet`).

Packets are facts: what was sent can arrive at any later time, any number of times, or never. There is any
number of packets, parts and lives.

*Coarser than the code.* A part holds one byte: a longer one arrives as several, in any order and with any
of them lost. The window, repetition and acknowledgement of streams are left out, since they decide only
when something is sent. Frames between modules are left out; they are numbered in the same way, with gaps
permitted. Either end may begin another life at any time.

*Shown.* Once the guardian counts the ward as dead, the ward does not act, and never does again in that
life. The bytes that a receiver takes in one life are those that the sender of that life has written, in
order, each once.

*Assumed.* Clocks gain or lose at most a hundredth of the time that passes, each against true time; a clock
never stops. Not modelled: the greeting itself (proofs of the secret, numbers of attempts and challenges),
so that a link to a life exists here as soon as that life does; damage, which a checksum finds.
"""

from inductive import Model, Part, all_of, choose, fixed, implies, no, put

DRIFT = 100
"""A clock gains or loses at most one part in this many."""


def build(defect: str | None = None) -> Model:
    """Returns the model, with a defect if one is named."""
    m = Model("host_link", numbers=2)
    m.rigid = {
        "fence": ("Real",),
    }
    m.state = {
        "now": ("Real",),
        # Fencing. Stamps are the times at which the ward sent a packet, echoes those that an answer returns.
        "sent": ("Packet", "Bool"),
        "stamp": ("Packet", "Real"),
        "answered": ("Answer", "Bool"),
        "echo": ("Answer", "Real"),
        "heard_stamp": ("Real",),
        "heard_at": ("Real",),
        "echoed": ("Real",),
        "ward_heard_at": ("Real",),
        "fenced": ("Bool",),
        # Streams, by the life of the sender.
        "written": ("Life", "Int"),
        "content": ("Life", "Int", "Int"),
        "taken": ("Life", "Int"),
        "got": ("Life", "Int", "Int"),
        "present": ("Life", "Bool"),
    }

    # The shortest true time in which a clock shows the fence, and the longest in which it shows the ward's
    # part of it.
    def silence(s):
        return s.fence() * DRIFT / (DRIFT + 1)

    def lease(s):
        return s.fence() * 49 / 50 * DRIFT / (DRIFT - 1)

    def acts(s):
        since = s.ward_heard_at() if defect == "LeaseByHearing" else s.echoed()
        return s.now() < since + lease(s)

    m.axioms = lambda s: [s.fence() > 0]

    def initial(s):
        return [
            s.now() == 0,
            s.heard_at() == 0,
            s.heard_stamp() == 0,
            s.echoed() == 0,
            s.ward_heard_at() == 0,
            no(s.fenced()),
            s.every("Packet", lambda p: no(s.sent(p))),
            s.every("Answer", lambda a: no(s.answered(a))),
            s.every("Life", lambda life: all_of(s.written(life) == 0, s.taken(life) == 0)),
        ]

    m.initial = initial

    @m.action("Packet")
    def ward_sends(s, p):
        return no(s.sent(p)), s.but(sent=put(s.sent, p, True), stamp=put(s.stamp, p, s.now()))

    @m.action("Packet")
    def guardian_hears(s, p):
        latest = choose(s.stamp(p) > s.heard_stamp(), s.stamp(p), s.heard_stamp())
        # One that is fenced is not heard any more (`Refused::Ended`).
        guard = all_of(s.sent(p), no(s.fenced()))
        return guard, s.but(heard_at=fixed(s.now()), heard_stamp=fixed(latest))

    @m.action("Answer")
    def guardian_answers(s, a):
        guard = no(s.answered(a))
        return guard, s.but(answered=put(s.answered, a, True), echo=put(s.echo, a, s.heard_stamp()))

    @m.action("Answer")
    def ward_hears(s, a):
        latest = choose(s.echo(a) > s.echoed(), s.echo(a), s.echoed())
        return s.answered(a), s.but(echoed=fixed(latest), ward_heard_at=fixed(s.now()))

    @m.action()
    def fence_ward(s):
        guard = all_of(no(s.fenced()), s.now() >= s.heard_at() + silence(s))
        return guard, s.but(fenced=fixed(True))

    @m.action("Real")
    def pass_time(s, later):
        return later >= s.now(), s.but(now=fixed(later))

    @m.action("Life", "Int")
    def write(s, life, byte):
        at = s.written(life)
        after = s.but(content=put(s.content, (life, at), byte), written=put(s.written, life, at + 1))
        return True, after

    @m.action("Life", "Life", "Int")
    def take(s, life, sender, place):
        comes_next = s.taken(life)
        fits = place == comes_next
        if defect == "TakeDoubled":
            fits = place <= comes_next
        if defect == "SkipGaps":
            fits = place >= comes_next
        is_of_life = True if defect == "TrustAnyLife" else sender == life
        guard = all_of(0 <= place, place < s.written(sender), s.present(life), is_of_life, fits)
        got = put(s.got, (life, comes_next), s.content(sender, place))
        return guard, s.but(got=got, taken=put(s.taken, life, comes_next + 1))

    @m.action("Life")
    def begin_life(s, life):
        return True, s.but(present=lambda other: other == life)

    @m.invariant("an echo is a time that the guardian has heard", "")
    def _(s):
        return all_of(s.echoed() <= s.heard_stamp(), s.heard_stamp() <= s.heard_at(), s.heard_at() <= s.now())

    @m.invariant("stamps are of the past", "Packet")
    def _(s, p):
        return implies(s.sent(p), s.stamp(p) <= s.now())

    @m.invariant("the ward has heard in the past", "")
    def _(s):
        return s.ward_heard_at() <= s.now()

    @m.invariant("answers echo what was heard", "Answer")
    def _(s, a):
        return implies(s.answered(a), s.echo(a) <= s.heard_stamp())

    @m.invariant("a fenced ward was silent", "")
    def _(s):
        return implies(s.fenced(), s.now() >= s.heard_at() + silence(s))

    @m.invariant("what was taken was written", "Life")
    def _(s, life):
        return all_of(0 <= s.taken(life), s.taken(life) <= s.written(life))

    @m.goal("a fenced ward is still", "")
    def _(s):
        return implies(s.fenced(), no(acts(s)))

    @m.goal("in order, once, from one life", "Life Int")
    def _(s, life, place):
        is_taken = all_of(0 <= place, place < s.taken(life))
        return implies(is_taken, s.got(life, place) == s.content(life, place))

    m.bounds = lambda s: [s.every("Life", lambda life: s.written(life) <= m.numbers)]
    return m


PART = Part(
    name="host_link",
    title="(d) host link",
    build=build,
    refusals={
        "LeaseByHearing": [("fence_ward", "a fenced ward is still")],
        "TakeDoubled": [("take", "in order, once, from one life")],
        "SkipGaps": [("take", "in order, once, from one life")],
        "TrustAnyLife": [("take", "in order, once, from one life")],
    },
    elements=2,
)
