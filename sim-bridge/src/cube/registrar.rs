//! The registrar: certifies deaths to all modules that touch a dead one, and forwards the announcement of its
//! best holder to them, so that the others may detach. It vouches for what is dead and which of the dead touch each other; all else
//! is up to those that announce and those that hear of it.

use crate::cube::diagnosis::Known;
use crate::cube::world::CubeWorld;
use metamorph_protocol::cube::control::{CustodyAnnouncement, CustodyKey, Order, Status};
use metamorph_protocol::cube::epoch::Epoch;
use metamorph_protocol::cube::message::Role;
use metamorph_protocol::ids::{ModuleId, Session};
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::runtime::{Command, Contact};
use metamorph_protocol::time::{Span, Time};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

#[derive(Clone, Debug, Hash)]
struct Death {
    died: Time,
    /// The contacts whose module has been informed of the death.
    told: BTreeSet<Session>,
    /// The epoch and the cell of the dead body that `best` is valid for; a body may come to rest after its death.
    of: (Epoch, Option<Cell>),
    /// The best holder of the dead module, or of those that hang together with it.
    best: Option<Offer>,
    /// The contacts whose module has been informed of a holder, and of which one last.
    informed: BTreeMap<Session, Offer>,
}

/// A holder that a dead module can count on; the least is the best. A finalized holder that touches the dead module comes before
/// other finalized ones, since it makes the dead module a root. Holders on loose paths differ by their keys alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Offer {
    is_loose: bool,
    /// Whether the holder is finalized and touches only other modules of the cluster.
    is_apart: bool,
    key: CustodyKey,
}

impl Offer {
    /// Returns the offer of a holder to a dead module. That a finalized one holds it over others of the dead is certain at the time `sure`.
    fn of(mut key: CustodyKey, dead: Cell, sure: Option<Time>) -> Option<Offer> {
        let is_apart = !key.is_loose && key.cell.manhattan(dead) != 1;
        if is_apart {
            key.confirmed = Reverse(sure?);
        }
        Some(Offer { is_loose: key.is_loose, is_apart, key })
    }
    /// Returns the offer of a finalized holder as of a later time: nothing has died or been started since it was certain.
    fn as_of(self, now: Time) -> Offer {
        Offer { key: CustodyKey { confirmed: Reverse(now), ..self.key }, ..self }
    }
}

/// The deaths of a run.
#[derive(Clone, Debug, Default, Hash)]
pub struct Registrar {
    deaths: BTreeMap<ModuleId, Death>,
    /// The time of the last death. Every death gets a later time than the one before, so times identify deaths.
    last: Time,
    /// A time since which nothing has died or been started, if one is known: what hangs together over the dead has done so at that time.
    sure: Option<Time>,
    /// The latest reports of the modules that announce that they hold dead ones.
    news: BTreeMap<ModuleId, Status>,
}

impl Registrar {
    /// Notes the death of a module.
    pub fn died(&mut self, now: Time, id: ModuleId) {
        self.last = now.max(self.last + Span(1));
        self.sure = None;
        let (told, informed) = (BTreeSet::new(), BTreeMap::new());
        let of = (Epoch::default(), None);
        self.deaths.insert(id, Death { died: self.last, told, of, best: None, informed });
        self.news.remove(&id);
    }
    /// Notes that a module was started. Returns true if it had died before.
    pub fn started(&mut self, id: ModuleId) -> bool {
        self.sure = None;
        self.news.remove(&id);
        // Others may have hung together over it.
        self.deaths.values_mut().for_each(|death| death.best = None);
        self.deaths.remove(&id).is_some()
    }
    /// Returns the cell of the finalized module that touches a dead one, so that the dead one stays connected for the present goal.
    pub fn held_for_good_by(&self, id: ModuleId) -> Option<Cell> {
        let best = self.deaths.get(&id)?.best?;
        (!best.is_loose && !best.is_apart).then_some(best.key.cell)
    }
    /// Takes in a report. Returns true if the module announces in it that it holds a dead one.
    pub fn has_news(&mut self, id: ModuleId, report: &Status) -> bool {
        let has_news = report.custody != [Time::ZERO; 6];
        if has_news {
            self.news.insert(id, *report);
        } else {
            self.news.remove(&id);
        }
        has_news
    }

    /// Tells all modules that touch a dead one, once its body rests, that it is dead, since its process has ended and
    /// cannot come back in that contact session; and which module holds it, if one has announced that.
    pub fn tell(
        &mut self,
        now: Time,
        world: &CubeWorld,
        known: &[Known],
        epoch: Epoch,
        seed: Cell,
        commands: &mut VecDeque<Command<Order>>,
    ) {
        // Growth starts in the seed cell, so a dead module there is the root, whatever it has reported.
        let was_final = |id: ModuleId| known[id.index()].is_final(epoch) || world.cell(id) == seed;
        for (victim, death) in &mut self.deaths {
            let of = (epoch, Some(world.cell(*victim)));
            if death.of != of {
                (death.of, death.best) = (of, None);
                death.informed.clear();
                if was_final(*victim) {
                    death.told.clear();
                }
            }
        }
        if self.sure.is_none() && now > self.last {
            self.sure = Some(now);
        }
        self.find_holders(world, epoch, seed, &was_final);
        for (victim, death) in &mut self.deaths {
            // A body that is still moving is held by none, and nothing may hang on it or move over it before it is at
            // rest.
            if world.is_moving(*victim) {
                continue;
            }
            let contacts: Vec<Contact> =
                Face::ALL.into_iter().filter_map(|f| world.contact(*victim, f)).collect();
            let is_present = |session: &Session| contacts.iter().any(|contact| contact.session == *session);
            death.told.retain(is_present);
            death.informed.retain(|session, _| is_present(session));
            for contact in contacts {
                let (port, session, peer) = (contact.peer_port, contact.session, contact.peer);
                if death.told.insert(session) {
                    let (died, finalized) = (death.died, was_final(*victim));
                    let order = Order::Condemn { port, session, epoch, finalized, died };
                    commands.push_back(Command::Order(peer, order));
                }
                let Some(best) = death.best.filter(|best| best.key.cell != world.cell(peer)) else {
                    continue;
                };
                let of_peer = holder(&self.news, epoch, contact, death.died).map(|status| status.confirmed);
                // A module lets go for a finalized holder only as of a time at which its own path was not confirmed later. Nothing
                // has changed since that was certain, so it is certain now.
                let offer = if best.is_apart && self.sure.is_some() { best.as_of(now) } else { best };
                let is_old =
                    |offer: &Offer| offer.is_apart && of_peer.is_some_and(|at| at > offer.key.confirmed.0);
                // A module that does not hold the dead one needs no better holder, unless that makes the dead one a root.
                let needs = || !best.is_loose || of_peer.is_some();
                let is_better = |told: &Offer| (best < *told && needs()) || (is_old(told) && !is_old(&offer));
                if death.informed.get(&session).is_none_or(is_better) {
                    death.informed.insert(session, offer);
                    let (dead, died) = (world.cell(*victim), death.died);
                    let of = CustodyAnnouncement { dead, died, epoch, holder: offer.key };
                    commands.push_back(Command::Order(peer, Order::Custody(of)));
                }
            }
        }
    }

    /// Finds the best holder of every dead module at rest: a module that has announced that it holds it, or another one that hangs
    /// together with it over dead modules. The announcement counts for those of them that died before the path of the
    /// holder was confirmed. A dead module that was finalized holds all that hang together with it.
    fn find_holders(
        &mut self,
        world: &CubeWorld,
        epoch: Epoch,
        seed: Cell,
        was_final: &impl Fn(ModuleId) -> bool,
    ) {
        let resting = |id: &ModuleId| !world.is_moving(*id);
        let mut offers: Vec<(CustodyKey, ModuleId)> = Vec::new();
        for (victim, death) in self.deaths.iter().filter(|(id, _)| resting(id)) {
            if was_final(*victim) {
                offers.push((CustodyKey::new(world.cell(*victim), true, Time::ZERO, seed), *victim));
            }
            for contact in Face::ALL.into_iter().filter_map(|f| world.contact(*victim, f)) {
                if let Some(status) = holder(&self.news, epoch, contact, death.died) {
                    let (cell, is_final) = (world.cell(contact.peer), status.role == Role::Final);
                    offers.push((CustodyKey::new(cell, is_final, status.confirmed, seed), *victim));
                }
            }
        }
        offers.sort_unstable();
        let mut found: BTreeMap<ModuleId, CustodyKey> = BTreeMap::new();
        for (key, victim) in &offers {
            let mut front = vec![*victim];
            while let Some(at) = front.pop() {
                // Over a module that died later the holder may be connected itself.
                let holds = self.deaths.get(&at).is_some_and(|death| key.is_after(death.died));
                if !holds || !resting(&at) || found.contains_key(&at) {
                    continue;
                }
                found.insert(at, *key);
                front.extend(world.cell(at).neighbours().into_iter().filter_map(|c| world.body_at(c)));
            }
        }
        let direct = offers.iter().filter(|(key, _)| !key.is_loose);
        for (victim, key) in found.into_iter().chain(direct.map(|(key, victim)| (*victim, *key))) {
            if let Some(death) = self.deaths.get_mut(&victim)
                && let Some(offer) = Offer::of(key, world.cell(victim), self.sure)
            {
                death.best = Some(death.best.map_or(offer, |best| best.min(offer)));
            }
        }
    }
}

/// Returns the latest report of the module behind a contact of a dead one, if it announces there that it holds the dead module
/// that died at `died`.
fn holder(news: &BTreeMap<ModuleId, Status>, epoch: Epoch, contact: Contact, died: Time) -> Option<&Status> {
    let status = news.get(&contact.peer).filter(|s| s.epoch == epoch)?;
    (status.custody.get(usize::from(contact.peer_port.0)) == Some(&died)).then_some(status)
}
