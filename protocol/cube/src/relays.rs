//! Requests of others on their way: a module that has passed one on repeats it until the answer comes, as long as it holds
//! the lock for it.
//!
//! Were requests repeated by the mover only, each repetition would have to get over all hops that the one before has got
//! over, and be answered over all of them. So where messages are often lost, nearly no attempt would get all of its locks
//! within a lease.

use super::message::{Message, RequestId};
use alloc::vec::Vec;
use core::hash::{Hash, Hasher};
use metamorph_core::lattice::Face;
use metamorph_core::time::{Span, Time};

/// A request that was passed on.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Relay {
    id: RequestId,
    to: Face,
    message: Message,
    again: Time,
    is_repeated: bool,
}

/// Requests that were passed on and are not answered: at most one for each lock.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub(super) struct Relays(Vec<Relay>);

impl Hash for Relays {
    /// Where nothing has to be repeated, the hash of a module is that of one which repeats nothing for others.
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        self.0.iter().filter(|relay| relay.is_repeated).for_each(|relay| relay.hash(hasher));
    }
}

impl Relays {
    /// Takes note that a request has been passed on over a face, to be repeated at `again`.
    pub fn add(&mut self, id: RequestId, to: Face, message: Message, again: Time) {
        self.0.push(Relay { id, to, message, again, is_repeated: false });
    }
    /// Returns true if a request has been passed on and its answer is outstanding.
    pub fn is_open(&self, id: RequestId) -> bool {
        self.0.iter().any(|relay| relay.id == id)
    }
    /// Drops the requests that are answered, and those whose locks are gone.
    pub fn drop_settled(&mut self, is_waited_for: impl Fn(RequestId) -> bool) {
        self.0.retain(|relay| is_waited_for(relay.id));
    }
    /// Removes and returns the requests that were passed on over a face where nothing is any more.
    pub fn take_cut_off(&mut self, is_touching: impl Fn(Face) -> bool) -> Vec<Message> {
        self.0.extract_if(.., |relay| !is_touching(relay.to)).map(|relay| relay.message).collect()
    }
    /// Repeats what is due; `send` sends a message over a face.
    pub fn tend(&mut self, now: Time, interval: Span, mut send: impl FnMut(Face, Message)) {
        for relay in self.0.iter_mut().filter(|relay| now >= relay.again) {
            (relay.again, relay.is_repeated) = (now + interval, true);
            send(relay.to, relay.message);
        }
    }
    /// Returns when the next request is repeated.
    pub fn due(&self) -> Time {
        self.0.iter().map(|relay| relay.again).min().unwrap_or(Time::NEVER)
    }
}

#[cfg(test)]
mod tests {
    use crate::Cube;
    use crate::control::Order;
    use crate::message::{Ask, Beacon, Denial, Message, RequestId};
    use crate::params::{Params, Setup};
    use crate::route::Route;
    use alloc::vec::Vec;
    use metamorph_core::agent::{Agent, Input};
    use metamorph_core::goal::{Goal, Growth};
    use metamorph_core::ids::{ModuleId, Port, Session, Token};
    use metamorph_core::lattice::{Cell, Face};
    use metamorph_core::time::{Span, Time};

    const MOVER: Port = Port(Face::West as u8);
    const NEXT: Port = Port(Face::East as u8);

    /// Returns a module between a mover in the west and another module in the east, which has passed on a request of the mover;
    /// and that request as the mover sent it.
    fn relaying(now: Time) -> (Cube, Message) {
        relaying_along(now, &[Face::East, Face::East])
    }

    /// The same with a route of more hops.
    fn relaying_along(now: Time, hops: &[Face]) -> (Cube, Message) {
        let seed = Cell::new(9, 0, 0);
        let setup = Setup {
            params: Params::scaled(Span::secs(1), Span::millis(100), 100),
            goals: Vec::from([Goal::compile(&[seed, Cell::new(10, 0, 0)], seed, Growth::Solid).unwrap()]),
        };
        let mut cube = Cube::first(setup);
        for (port, id) in [(MOVER, 1), (NEXT, 2)] {
            cube.handle(now, Input::Contact { port, session: Some(Session(1)) });
            let beacon = Message::Beacon(Beacon::first(ModuleId(id)));
            cube.handle(now, Input::Message { port, message: beacon });
        }
        cube.sent();
        let id = RequestId { origin: ModuleId(1), token: Token(1), number: 0 };
        let route = Route::new(hops).unwrap();
        let request = Message::Request { id, age: Span::ZERO, hop: 1, ask: Ask::Lock, route };
        cube.handle(now, Input::Message { port: MOVER, message: request });
        assert!(matches!(cube.sent()[..], [(NEXT, Message::Request { hop: 2, .. })]));
        (cube, request)
    }

    /// A request that is not answered is repeated from here, however often the mover repeats it.
    #[test]
    fn unanswered_requests_are_repeated_on_their_way() {
        let (mut cube, request) = relaying(Time::ZERO);
        cube.handle(Time(1), Input::Message { port: MOVER, message: request });
        assert_eq!(cube.sent(), []);
        let Message::Request { id, route, .. } = request else { unreachable!("it is one") };
        for _ in 0..3 {
            let due = cube.relays.due();
            cube.handle(due, Input::Wake);
            assert!(matches!(cube.sent()[..], [(NEXT, Message::Request { hop: 2, .. })]));
        }
        let granted = Message::Response { id, hop: 1, denial: None, blocker: None, co_owners: 0, route };
        cube.handle(cube.wake_at(), Input::Message { port: NEXT, message: granted });
        assert!(matches!(cube.sent()[..], [(MOVER, Message::Response { hop: 0, denial: None, .. })]));
        assert_eq!(cube.relays.due(), Time::NEVER);
    }

    /// It is repeated no longer than the lock for it lasts.
    #[test]
    fn repetition_ends_with_the_lease() {
        let (mut cube, _) = relaying(Time::ZERO);
        cube.handle(Time::ZERO + cube.own.params().keep_for(), Input::Wake);
        assert_eq!(cube.relays.due(), Time::NEVER);
    }

    /// Two copies of a request may be answered differently. A grant says that this module stays, so it is passed back only with a
    /// lock; and once it has been, a denial ends nothing, since the mover may be on its way.
    #[test]
    fn answers_that_overtake_each_other_leave_the_mover_its_support() {
        let answered = |denials: [Option<Denial>; 2]| {
            let (mut cube, request) = relaying(Time::ZERO);
            let Message::Request { id, route, .. } = request else { unreachable!("it is one") };
            let answers = denials.map(|denial| {
                let message = Message::Response { id, hop: 1, denial, blocker: None, co_owners: 0, route };
                cube.handle(Time(1), Input::Message { port: NEXT, message });
                let back = |(port, message): (Port, Message)| match message {
                    Message::Response { denial, .. } if port == MOVER => Some(denial.is_none()),
                    _ => None,
                };
                cube.sent().into_iter().filter_map(back).collect::<Vec<_>>()
            });
            (answers, cube.locks.len())
        };
        let busy = Some(Denial::Busy);
        assert_eq!(answered([busy, None]), ([Vec::from([false]), Vec::new()], 0));
        assert_eq!(answered([None, busy]), ([Vec::from([true]), Vec::new()], 1));
    }

    /// A module that dies in the middle of a route has not passed the request on for sure. One at its end stays anyway.
    #[test]
    fn requests_over_a_module_that_has_died_are_denied() {
        let answers = |hops: &[Face]| {
            let (mut cube, request) = relaying_along(Time::ZERO, hops);
            let (port, session, died) = (NEXT, Session(1), Time(1));
            let condemn = Order::Condemn { port, session, epoch: cube.epoch(), finalized: false, died };
            cube.handle(Time(2), Input::Order(condemn));
            cube.sent();
            cube.handle(Time(3), Input::Message { port: MOVER, message: request });
            let denial = cube.sent().into_iter().find_map(|(port, message)| match message {
                Message::Response { denial, .. } if port == MOVER => Some(denial),
                _ => None,
            });
            (denial, cube.locks.len())
        };
        assert_eq!(answers(&[Face::East; 3]), (Some(Some(Denial::NoSupport)), 0));
        assert_eq!(answers(&[Face::East; 2]), (Some(None), 1));
    }

    /// If the next module leaves before it has answered, the mover hears so at once.
    #[test]
    fn requests_to_a_module_that_has_left_are_denied() {
        let (mut cube, _) = relaying(Time::ZERO);
        cube.handle(Time(1), Input::Contact { port: NEXT, session: None });
        let is_denial = |(port, message): &(Port, Message)| {
            *port == MOVER
                && matches!(message, Message::Response { hop: 0, denial: Some(Denial::NoSupport), .. })
        };
        assert!(cube.sent().iter().any(is_denial));
        assert_eq!((cube.locks.len(), cube.relays.due()), (0, Time::NEVER));
    }
}
