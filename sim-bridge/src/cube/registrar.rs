//! The registrar: certifies deaths to all modules that touch a dead one, and forwards the announcement of its
//! best holder to them, so that the others may detach. It only forwards; safety is that of the announcements.

use crate::cube::diagnosis::Known;
use crate::cube::world::CubeWorld;
use metamorph_protocol::cube::control::{CustodyAnnouncement, CustodyKey, Order, Status};
use metamorph_protocol::cube::epoch::Epoch;
use metamorph_protocol::cube::message::Role;
use metamorph_protocol::ids::{ModuleId, Session};
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

#[derive(Clone, Debug, Hash)]
struct Death {
    died: Time,
    /// The contacts whose module has been informed of the death.
    told: BTreeSet<Session>,
    /// The epoch and the cell of the dead body that `best` is valid for; a body may come to rest after its death.
    of: (Epoch, Option<Cell>),
    best: Option<(CustodyKey, CustodyAnnouncement)>,
    /// The contacts whose module has been informed of the best holder.
    informed: BTreeSet<Session>,
}

/// The deaths of a run.
#[derive(Clone, Debug, Default, Hash)]
pub struct Registrar {
    deaths: BTreeMap<ModuleId, Death>,
    /// The time of the last death. Every death gets a later time than the one before, so times identify deaths.
    last: Time,
    /// The latest reports of the modules that announce that they hold dead ones.
    news: BTreeMap<ModuleId, Status>,
}

impl Registrar {
    /// Notes the death of a module.
    pub fn died(&mut self, now: Time, id: ModuleId) {
        self.last = now.max(self.last + Span(1));
        let (told, informed) = (BTreeSet::new(), BTreeSet::new());
        self.deaths
            .insert(id, Death { died: self.last, told, of: (Epoch::default(), None), best: None, informed });
        self.news.remove(&id);
    }
    /// Notes that a module was started. Returns true if it had died before.
    pub fn started(&mut self, id: ModuleId) -> bool {
        self.news.remove(&id);
        self.deaths.remove(&id).is_some()
    }
    /// Returns the cell of the finalized module that holds a dead one, so that the dead one stays connected for the present goal.
    pub fn held_for_good_by(&self, id: ModuleId) -> Option<Cell> {
        let (key, _) = self.deaths.get(&id)?.best?;
        (!key.is_loose).then_some(key.holder)
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
        world: &CubeWorld,
        known: &[Known],
        epoch: Epoch,
        seed: Cell,
        commands: &mut VecDeque<Command<Order>>,
    ) {
        for (victim, death) in &mut self.deaths {
            let of = (epoch, Some(world.cell(*victim)));
            // Growth starts in the seed cell, so a dead module there is the root, whatever it has reported.
            let finalized = known[victim.index()].is_final(epoch) || world.cell(*victim) == seed;
            if death.of != of {
                (death.of, death.best) = (of, None);
                death.informed.clear();
                if finalized {
                    death.told.clear();
                }
            }
            // A body that is still moving is held by none, and nothing may hang on it or move over it before it is at
            // rest.
            if world.is_moving(*victim) {
                continue;
            }
            death.take_up(world, *victim, &self.news, seed);
            for contact in Face::ALL.into_iter().filter_map(|f| world.contact(*victim, f)) {
                let (port, session, peer) = (contact.peer_port, contact.session, contact.peer);
                if death.told.insert(session) {
                    let died = death.died;
                    let order = Order::Condemn { port, session, epoch, finalized, died };
                    commands.push_back(Command::Order(peer, order));
                }
                if let Some((key, best)) = death.best
                    && key.holder != world.cell(peer)
                    && death.informed.insert(session)
                {
                    commands.push_back(Command::Order(peer, Order::Custody(best)));
                }
            }
        }
    }
}

impl Death {
    /// Replaces the best announcement if the latest reports hold a better one.
    fn take_up(
        &mut self,
        world: &CubeWorld,
        victim: ModuleId,
        news: &BTreeMap<ModuleId, Status>,
        seed: Cell,
    ) {
        let (epoch, dead) = (self.of.0, world.cell(victim));
        for face in Face::ALL {
            let Some(contact) = world.contact(victim, face) else { continue };
            let port = usize::from(contact.peer_port.0);
            let Some(status) = news.get(&contact.peer).filter(|s| s.epoch == epoch) else { continue };
            if status.custody.get(port) != Some(&self.died) {
                continue;
            }
            let is_final = status.role == Role::Final;
            let announcement = CustodyAnnouncement { dead, died: self.died, epoch, face, is_final };
            let key = announcement.key(seed);
            if self.best.is_none_or(|(best, _)| key < best) {
                self.best = Some((key, announcement));
                self.informed.clear();
            }
        }
    }
}
