//! The parent forest: the connection gradient (thesis 4.1.2) made safe for any message delay.
//!
//! Every module in reserve has one registered parent, closer to the finalized modules than itself; a module
//! with a registered child does not leave. A child changes parents only after the new one has acknowledged
//! it, and a parent forgets a child only when the child says so, in the same contact session. So a parent
//! never leaves, even if messages are late, lost or duplicated.
//!
//! A module that has forgotten its parent keeps all its neighbours from leaving, since any of them may have been its
//! parent. It takes a new parent only with proof that the parent's path to the finalized modules does not lead over
//! the module itself: the path must have been confirmed after the module forgot ([`Rank`]), and a module without a
//! parent does not pass confirmations on. A module that has lost its parent and finds no other one of a sufficient
//! rank asks for the same proof. Finalized modules confirm a path only when asked ([`Beacon::renew`]), so this costs
//! nothing while no module fails.
//!
//! Also here: the published rule without registration, for comparison.

mod last_words;

use super::control::CustodyAnnouncement;
use super::custody::{self, Custody};
use super::message::{Beacon, Claim, Rank, Role};
use super::params::Connectivity;
use super::view::View;
use core::hash::Hash;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::digest::Portable;
use metamorph_core::ids::{ModuleId, Token};
use metamorph_core::lattice::Face;
use metamorph_core::time::{Span, Time};

/// The number that labels a module without a parent.
pub(super) const UNLABELLED: u16 = u16::MAX;
/// The rank of a module that has never had a parent: any module qualifies as its parent.
const UNRANKED: Rank = Rank { rooted: Time::ZERO, label: UNLABELLED };
/// The token of every [`Claim::Parent`]; a [`Claim::Want`] has a unique one instead.
const PARENT_TOKEN: Token = Token(u32::MAX);

/// Why a module may not leave: the module in the way, if it is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Held(pub Option<ModuleId>);

/// Gives every attempt and every candidate parent a unique number.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Tokens(pub u32);

impl Tokens {
    pub fn next(&mut self) -> Token {
        self.0 = self.0.checked_add(1).filter(|t| Token(*t) != PARENT_TOKEN).unwrap_or(0);
        Token(self.0)
    }
}

/// Consequence of a change of the forest for the other parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    None,
    /// Neighbours have to be informed.
    Tell,
    /// Neighbours have to be informed, and a decision may come out differently.
    TellAndDecide,
}

/// A module's place in the forest.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct ParentForest {
    /// The module's rank; without a parent, a bound: the rank of the next parent must be better.
    rank: Rank,
    /// Neighbours are asked for a path to the finalized modules that is confirmed at this time or later; zero if
    /// this module needs none.
    renew: Time,
    parent: Option<Face>,
    /// The neighbour asked to be the next parent.
    want: Option<(Face, Token)>,
    /// Neighbours that are registered as children, with their claims.
    children: [Option<Token>; 6],
    custody: Custody,
}

impl ParentForest {
    /// Creates the state of a module that has never had a parent or, if it has restarted, forgot its parent at time
    /// `restarted`. Modules whose path led over an earlier incarnation may still depend on it, and only a path that is
    /// confirmed after the restart is sure not to lead over it.
    pub fn new(restarted: Option<Time>) -> ParentForest {
        let rank = restarted.map_or(UNRANKED, |rooted| Rank { rooted, label: 0 });
        ParentForest {
            rank,
            renew: Time::ZERO,
            parent: None,
            want: None,
            children: [None; 6],
            custody: Custody::default(),
        }
    }

    /// Feeds all but the children into a hash; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        let ParentForest { rank, renew, parent, want, children: _, custody } = self;
        (rank, renew, parent, want).hash(hasher);
        custody.digest(hasher);
    }
    pub fn rank(&self) -> Rank {
        self.rank
    }
    pub fn parent(&self) -> Option<Face> {
        self.parent
    }
    /// Returns the neighbour's claim to be a child, if it is registered.
    pub fn child(&self, face: Face) -> Option<Token> {
        self.children[face.index()]
    }
    pub fn child_count(&self) -> usize {
        self.children.iter().flatten().count()
    }

    /// Begins a session on a face, or ends it.
    pub fn on_contact(&mut self, face: Face, is_gone: bool) {
        self.children[face.index()] = None;
        self.custody.forget(face);
        if is_gone && self.parent == Some(face) {
            // The contact has ended. A restarted neighbour is a new session instead, and what hangs on it
            // stays so.
            hit(CoveragePoint::CubeParentLost);
            self.parent = None;
            self.rank.label = 0;
        }
        self.want = self.want.filter(|(f, _)| *f != face);
    }
    /// Resets the state of a module that is finalized.
    pub fn on_finalized(&mut self) {
        self.rank.label = 0;
        (self.renew, self.parent, self.want) = (Time::ZERO, None, None);
    }
    /// Starts over with another goal.
    pub fn on_goal(&mut self) {
        self.rank = if self.rank.rooted > Time::ZERO { Rank { label: 0, ..self.rank } } else { UNRANKED };
        (self.renew, self.parent, self.want) = (Time::ZERO, None, None);
        self.children = [None; 6];
        self.custody.on_goal();
    }
    /// Resets the state of a module that has arrived at another cell.
    pub fn on_arrival(&mut self) {
        (self.rank, self.parent, self.want, self.children) = (UNRANKED, None, None, [None; 6]);
        self.custody = Custody::default();
    }
    /// Returns what is known of the custody of dead neighbours.
    pub fn custody(&self) -> &Custody {
        &self.custody
    }
    /// Notes that the neighbour on a face is certified dead.
    pub fn begin_custody(&mut self, v: View<'_>, face: Face, died: Time) {
        if custody::is_announced(v) {
            self.custody.begin(face, died);
        }
        if v.died_finalized(face) {
            self.forget_child(face);
        }
    }
    /// Takes up the announcement of a module that holds a dead neighbour.
    pub fn hear_of_custody(&mut self, v: View<'_>, of: &CustodyAnnouncement) {
        if let Some(face) = self.custody.hear(v, of)
            && self.custody.is_released(v, face)
        {
            hit(CoveragePoint::CubeCustodyReleased);
            self.forget_child(face);
        }
    }
    /// Announces that this module holds a dead neighbour, once it is proved that its own path does not lead over that
    /// neighbour. Returns true if there is a new announcement.
    pub fn tend_custody(&mut self, v: View<'_>, is_moving: bool) -> bool {
        if self.custody.is_empty() || is_moving || v.own.role == Role::Walker || v.is_quarantined() {
            return false;
        }
        let mut is_news = false;
        // A module that stays for one dead neighbour can hold all others as well.
        let stays = self.stays_for_any(v);
        for face in Face::ALL.into_iter().filter(|f| !v.died_finalized(*f)) {
            let Some(died) = self.custody.died(face).filter(|_| !self.custody.is_released(v, face)) else {
                continue;
            };
            let may_hold = || v.own.connectivity() == Connectivity::Forest;
            let is_held = || {
                self.custody.is_announced(face)
                    || self.held_by(v, face).is_some()
                    || (stays && !self.is_fixed(v, face))
            };
            let holds = v.own.role == Role::Final || (may_hold() && is_held());
            if holds && self.is_above_dead(v, face, died) {
                // A later confirmation is announced as well, so that others can let go for it.
                let is_first = self.custody.announce(face, self.rank.rooted);
                if is_first {
                    hit(CoveragePoint::CubeCustodyAnnounced);
                }
                is_news |= is_first;
            }
        }
        is_news
    }
    /// Returns true if it is proved that this module's path does not lead over a dead neighbour, and never will.
    fn is_above_dead(&self, v: View<'_>, face: Face, died: Time) -> bool {
        let is_child = || self.child(face).is_some();
        v.own.role == Role::Final
            || (self.is_attached(v)
                && self.parent != Some(face)
                && (self.rank.rooted > died
                    || v.has(Defect::LetGoUnproved)
                    || (v.has(Defect::ChildProves) && is_child())))
    }
    /// Returns the time at or after which this module's path must be confirmed before it may announce that it holds a
    /// dead neighbour; zero if there is nothing to announce.
    fn custody_needs(&self, v: View<'_>) -> Time {
        if self.custody.is_empty() || v.own.role != Role::Reserve || !self.is_attached(v) {
            return Time::ZERO;
        }
        let needs = |face: &Face| {
            let died = self.custody.died(*face).filter(|_| !self.custody.is_announced(*face))?;
            let lacks_proof = self.parent != Some(*face) && !self.is_above_dead(v, *face, died);
            (lacks_proof && self.held_by(v, *face).is_some()).then_some(died + Span(1))
        };
        Face::ALL.iter().filter_map(needs).max().unwrap_or(Time::ZERO)
    }
    /// Forgets the child on a face: a neighbour that died finalized, or that a better holder has in custody.
    pub fn forget_child(&mut self, face: Face) {
        self.children[face.index()] = None;
    }

    /// Registers or forgets the neighbour on a face as a child, as its beacon asks. Only a later beacon of the same contact ends a
    /// registration; an older one is not taken any more.
    pub fn register_child(&mut self, v: View<'_>, is_idle: bool, face: Face, beacon: &Beacon) {
        let can_adopt = v.own.role != Role::Walker && self.is_attached(v) && is_idle && !v.is_quarantined();
        let child = match beacon.claim {
            _ if beacon.role == Role::Final || beacon.epoch != v.own.epoch => None,
            // A beacon sent before its death came late.
            _ if v.died_finalized(face) => None,
            Claim::None => None,
            // This is also how a restarted parent learns of its children again.
            Claim::Parent(token) => Some(token),
            Claim::Want(token) if can_adopt => Some(token),
            Claim::Want(_) => self.child(face),
        };
        self.children[face.index()] = child;
    }

    /// Returns true if the module is finalized or connected to a finalized one, as far as the rule in use
    /// knows.
    pub fn is_attached(&self, v: View<'_>) -> bool {
        match v.own.connectivity() {
            _ if v.own.role == Role::Final => true,
            Connectivity::Forest => self.parent.is_some(),
            Connectivity::Gradient => self.rank.label != UNLABELLED,
            Connectivity::Cycles => true,
        }
    }

    /// Returns true if the module touches one other only, and that one does not hang on it. It connects no others, so it
    /// may leave although it has no place in the forest, as behind dead modules.
    pub fn is_end(&self, v: View<'_>) -> bool {
        let mut touched = Face::in_mask(v.sides.touching_mask());
        let only = touched.next().filter(|_| touched.next().is_none());
        v.own.connectivity() == Connectivity::Forest
            && only.is_some_and(|f| {
                v.sides.is_certified_dead(f) || v.live(f).is_some_and(|b| b.claim == Claim::None)
            })
    }

    /// Returns the rank announced to the neighbours. By the published rule a module that moves, or is about to, has no
    /// concentration: its neighbours look for others before it leaves.
    pub fn told_rank(&self, v: View<'_>, is_idle: bool) -> Rank {
        let is_withdrawn = match v.own.connectivity() {
            Connectivity::Forest => !self.is_attached(v),
            Connectivity::Gradient => !is_idle,
            Connectivity::Cycles => false,
        };
        if is_withdrawn { Rank { label: UNLABELLED, ..self.rank } } else { self.rank }
    }

    /// Returns the claim announced to a neighbour.
    pub fn claim(&self, v: View<'_>, face: Face) -> Claim {
        match (v.own.connectivity(), v.own.role) {
            (_, Role::Final) | (Connectivity::Cycles, _) | (Connectivity::Gradient, Role::Walker) => {
                Claim::None
            }
            (Connectivity::Gradient, Role::Reserve) => self.gradient_claim(v, face),
            (Connectivity::Forest, Role::Reserve | Role::Walker) => match (self.want, self.parent) {
                (Some((f, token)), _) if f == face => Claim::Want(token),
                (_, Some(f)) if f == face => Claim::Parent(PARENT_TOKEN),
                _ => Claim::None,
            },
        }
    }

    /// Adopts the wanted parent once it has acknowledged, follows the parent's rank, and looks for a better
    /// parent. A walker does so only if it `parks`, and is in reserve once it has a parent.
    pub fn tend(&mut self, v: View<'_>, is_idle: bool, parks: bool, tokens: &mut Tokens) -> Effect {
        match v.own.role {
            Role::Reserve => {}
            Role::Walker if parks => {}
            Role::Walker => {
                let is_told = self.want.take().is_some();
                return if is_told { Effect::Tell } else { Effect::None };
            }
            Role::Final => return if self.renew_root(v) { Effect::Tell } else { Effect::None },
        }
        let before = (self.parent, self.rank, self.want, self.renew);
        match self.dead_root(v) {
            Some(face) if is_idle => self.hang_on_dead(v, face),
            None if is_idle && self.hang_on_connected() => {}
            _ => self.tend_parent(v, is_idle, tokens),
        }
        let is_same = before == (self.parent, self.rank, self.want, self.renew);
        if is_same { Effect::None } else { Effect::TellAndDecide }
    }

    /// Returns the face of a dead neighbour that was finalized or is held by a finalized module, preferably the parent.
    /// Such a neighbour stays connected with the finalized modules permanently.
    fn dead_root(&self, v: View<'_>) -> Option<Face> {
        if v.sides.certified_mask() == 0 && self.custody.is_empty() {
            return None;
        }
        let is_root = |f: &Face| {
            self.is_fixed(v, *f)
                || (v.sides.is_certified_dead(*f) && v.peer(*f).is_some_and(|b| v.is_final(b)))
        };
        self.parent.into_iter().chain(Face::ALL).find(is_root)
    }

    /// Takes the dead neighbour found by `dead_root` as the parent. No acknowledgement is needed, and this module
    /// confirms the path in place of the dead one.
    fn hang_on_dead(&mut self, v: View<'_>, face: Face) {
        if self.parent != Some(face) {
            hit(CoveragePoint::CubeHangsOnDead);
            let vouched = v.peer(face).map_or(Time::ZERO, |b| b.rank.rooted);
            self.rank = Rank { rooted: self.rank.rooted.max(vouched), label: 1 };
            self.parent = Some(face);
        }
        (self.want, self.renew) = (None, Time::ZERO);
        self.renew_root(v);
    }

    /// Takes a dead neighbour as the parent that hangs together with the finalized modules over other dead ones, preferably the
    /// parent: no living module has to stay for that. The path over it is as new as that is certain, and no newer: if one of the dead
    /// in between restarts, its next parent has a newer path, so that does not hang on this module. Returns false if there is no
    /// such neighbour.
    fn hang_on_connected(&mut self) -> bool {
        let connected = |face: Face| Some((self.custody.connected(face)?, face));
        let latest = || Face::ALL.into_iter().filter_map(connected).max_by_key(|(at, _)| *at);
        let Some((at, face)) = self.parent.and_then(connected).or_else(latest) else { return false };
        let rank = Rank { rooted: at, label: 1 };
        if rank.is_above(self.rank) {
            (self.rank, self.parent) = (rank, Some(face));
        } else if self.parent != Some(face) {
            return false;
        }
        (self.want, self.renew) = (None, Time::ZERO);
        true
    }

    fn tend_parent(&mut self, v: View<'_>, is_idle: bool, tokens: &mut Tokens) {
        if let Some((face, token)) = self.want {
            self.adopt_if_acknowledged(v, face, token);
        }
        if let Some(b) = self.parent.and_then(|f| v.peer(f))
            && b.epoch == v.own.epoch
            && b.attached
            && b.rank.below().is_above(self.rank)
        {
            self.rank = b.rank.below();
        }
        if self.want.is_none() && is_idle {
            if all_heard(v) {
                self.look_for_parent(v, tokens);
            } else {
                hit(CoveragePoint::CubeRebornWaits);
            }
        }
    }

    /// Takes a candidate for the parent, if it has acknowledged this request. The token shows that it has registered this request
    /// and not an earlier one, and this module has claimed it in every beacon since.
    fn adopt_if_acknowledged(&mut self, v: View<'_>, face: Face, token: Token) {
        let qualifies = |b: &&Beacon| b.epoch == v.own.epoch && b.attached && b.role != Role::Walker;
        let Some(b) = v.live(face).filter(qualifies) else {
            hit(CoveragePoint::CubeWantDropped);
            self.want = None;
            return;
        };
        let is_worth_it = self.is_worth_it(v, b, self.needs_parent(v));
        if !(b.rank.is_above(self.rank) && is_worth_it) {
            // The candidate was relabelled meanwhile, or the old parent has spoken again. Asking further
            // would keep the candidate from leaving, which may be a child by now: both would wait for each
            // other.
            hit(CoveragePoint::CubeNotAdoptable);
            self.want = None;
        } else if b.ack == Some(token) || v.has(Defect::AdoptUnacknowledged) {
            if self.parent.is_some() {
                hit(CoveragePoint::CubeParentReplaced);
            }
            self.rank = b.rank.below();
            self.parent = Some(face);
            self.want = None;
        }
    }

    /// Confirms this module's path again if asked to. The module is finalized, or its parent is the dead neighbour that
    /// `dead_root` returned.
    fn renew_root(&mut self, v: View<'_>) -> bool {
        let asked = self.asked(v, None);
        // Requests hold times of the controller's clock, and this module's clock may be behind it.
        let renews = asked > self.rank.rooted && asked <= v.now + v.params().skew;
        if renews {
            hit(CoveragePoint::CubeRootRenewed);
            self.rank.rooted = asked;
        }
        renews
    }

    /// Returns the latest time of confirmation that is asked for by a neighbour other than `except`, or needed for the
    /// custody of a dead neighbour.
    fn asked(&self, v: View<'_>, except: Option<Face>) -> Time {
        let others = Face::in_mask(v.sides.heard_mask()).filter(|f| Some(*f) != except);
        let renew = others.filter_map(|f| v.peer(f)).filter(|b| b.epoch == v.own.epoch).map(|b| b.renew);
        renew.max().unwrap_or(Time::ZERO).max(self.custody_needs(v))
    }

    /// Returns the time of confirmation to ask a neighbour for ([`Beacon::renew`]): what this module needs itself, or
    /// what others have asked it for and it does not have. Requests of other neighbours are passed on to the parent,
    /// and a request of the parent to all other neighbours.
    pub fn renewal(&self, v: View<'_>, face: Face) -> Time {
        if v.own.role != Role::Reserve || v.own.connectivity() != Connectivity::Forest {
            return Time::ZERO;
        }
        // Modules that hang on it know last.
        let is_last_resort = self.child(face).is_some();
        let own = if is_last_resort && v.now.since(v.own.settled) <= v.params().suspect {
            Time::ZERO
        } else {
            self.renew
        };
        let passed_on = match self.parent {
            Some(parent) if parent == face => self.asked(v, Some(face)),
            Some(parent) => v.peer(parent).map_or(Time::ZERO, |b| b.renew),
            None => Time::ZERO,
        };
        own.max(if passed_on > self.rank.rooted { passed_on } else { Time::ZERO })
    }

    /// Returns true if the module has no parent, or if any other parent is better than the present one, which is silent
    /// or itself asks for a newer confirmation.
    fn needs_parent(&self, v: View<'_>) -> bool {
        self.parent.is_none_or(|f| {
            // A module with children stays in any case, and leaves its parent only for their sake.
            let is_missed = self.child_count() == 0 || self.asked(v, None) > self.rank.rooted;
            (is_missed && v.live(f).is_none()) || v.peer(f).is_some_and(|b| b.renew > self.rank.rooted)
        })
    }

    /// Returns true if the neighbour that sent `b` is worth having as parent: it leads to a lower label, any parent is
    /// better than the present one, it is steadier, or it stays anyway. A module that may have been finalized before its
    /// restart stays permanently, so its parent should be one that stays as well.
    fn is_worth_it(&self, v: View<'_>, b: &Beacon, needs_parent: bool) -> bool {
        let stays = |f: Face| v.peer(f).is_none_or(|p| p.final_hops != Beacon::NO_FINAL);
        let is_steadier =
            v.may_be_final() && b.final_hops < v.final_hops() && !self.parent.is_some_and(stays);
        b.rank.below().label < self.rank.label || needs_parent || is_steadier || self.is_shared(v, b)
    }

    fn look_for_parent(&mut self, v: View<'_>, tokens: &mut Tokens) {
        let needs_parent = self.needs_parent(v);
        let (mut best, mut is_refused) = (None, false);
        for face in Face::in_mask(v.sides.support_mask()) {
            let Some(b) = v.support(face) else { continue };
            let usable = b.attached
                && b.epoch == v.own.epoch
                && b.claim == Claim::None
                && !b.quarantined
                && self.parent != Some(face)
                && self.is_worth_it(v, b, needs_parent);
            if usable && b.rank.is_above(self.rank) {
                let offer = (b.rank.label, !last_words::stays_for_dead(b), face);
                best = Some(best.map_or(offer, |other: (u16, bool, Face)| other.min(offer)));
            } else {
                is_refused |= usable;
            }
        }
        self.renew = if let Some((.., face)) = best {
            if self.parent.is_some() && needs_parent {
                hit(CoveragePoint::CubeParentSuspected);
            }
            self.want = Some((face, tokens.next()));
            Time::ZERO
        } else if needs_parent && self.rank.label != UNLABELLED {
            hit(CoveragePoint::CubeRenewalAsked);
            self.asked(v, None).max(self.rank.rooted + Span(1))
        } else if is_refused {
            self.rank.rooted
        } else {
            Time::ZERO
        };
    }

    /// Applies the published rule: the label is one more than the least label heard from a neighbour.
    pub fn tend_gradient(&mut self, v: View<'_>) -> Effect {
        if v.own.role == Role::Final {
            return Effect::None;
        }
        let least = Face::in_mask(v.sides.support_mask())
            .filter_map(|f| v.support(f))
            .filter(|b| b.epoch == v.own.epoch && b.attached)
            .map(|b| b.rank.label)
            .min();
        // Without a bound the labels of a part that has lost its source would count up forever.
        let label =
            least.map(|l| l.saturating_add(1)).filter(|l| *l < v.params().range).unwrap_or(UNLABELLED);
        let label = if v.own.role == Role::Reserve { label } else { UNLABELLED };
        if label == self.rank.label {
            return Effect::None;
        }
        self.rank.label = label;
        Effect::TellAndDecide
    }

    /// Returns the claim of the published rule: a module depends on a neighbour if no other has a lower
    /// label.
    fn gradient_claim(&self, v: View<'_>, face: Face) -> Claim {
        let lower = |f: Face| v.support(f).is_some_and(|b| b.attached && b.rank.label < self.rank.label);
        let others = Face::in_mask(v.sides.support_mask()).any(|f| f != face && lower(f));
        if lower(face) && !others { Claim::Parent(PARENT_TOKEN) } else { Claim::None }
    }

    /// Checks whether a module in reserve may leave the body, as far as the forest knows: it is attached and
    /// has no children, and every neighbour is known to be connected without it.
    pub fn may_leave(&self, v: View<'_>) -> Result<(), Held> {
        Face::ALL.into_iter().find_map(|face| self.held_by(v, face)).map_or(Ok(()), Err)
    }

    /// Returns true if the neighbour on a face may hang on this module, as far as it has said.
    pub fn holds(&self, v: View<'_>, face: Face) -> bool {
        self.held_by(v, face).is_some()
    }

    /// Returns why the neighbour on a face may hang on this module, as far as it has said.
    fn held_by(&self, v: View<'_>, face: Face) -> Option<Held> {
        if !v.sides.is_touching(face) || v.died_finalized(face) || self.custody.is_released(v, face) {
            return None;
        }
        if v.sides.is_certified_dead(face) && v.own.connectivity() == Connectivity::Cycles {
            // A cycle keeps it connected.
            return None;
        }
        if self.is_fixed(v, face) && custody::believes(v) && self.child(face).is_none() {
            return None;
        }
        if self.custody.is_announced(face) && !v.has(Defect::ForgetSaid) {
            return Some(Held(v.peer(face).map(|b| b.id)));
        }
        if v.sides.is_certified_dead(face) && !self.is_attached(v) && self.is_end(v) {
            return None;
        }
        let Some(b) = v.peer(face) else {
            return (!v.has(Defect::IgnoreStrangers)).then_some(Held(None));
        };
        let silent = v.now.since(v.sides.heard_at(face)) > v.params().suspect;
        let forgotten = silent && v.has(Defect::DropSilentChildren);
        let free = match b.role {
            _ if b.epoch != v.own.epoch => false,
            _ if forgotten => true,
            Role::Final => true,
            // One that takes a place in the forest is a child as soon as that is acknowledged.
            Role::Walker => !b.supported_here && self.child(face).is_none(),
            // A cycle can only be locked over modules that answer.
            Role::Reserve if v.own.connectivity() == Connectivity::Cycles => !silent,
            Role::Reserve => {
                (b.attached || self.is_end(v)) && b.claim == Claim::None && self.child(face).is_none()
            }
        };
        (!free).then_some(Held(Some(b.id)))
    }

    /// Returns true if a neighbour that seems dead keeps this module from ever leaving.
    pub fn is_pinned(&self, v: View<'_>) -> bool {
        let gone = v.sides.gone();
        // A dead finalized neighbour would have to say whether this one was finalized.
        let holds = |f: Face| v.may_be_final() || self.held_by(v, f).is_some();
        v.own.role == Role::Reserve && Face::in_mask(gone).any(holds)
    }
}

/// Returns true if a restarted module may choose a parent: every neighbour has been heard, however long that takes. An
/// unheard one may be a child in a later goal than this module knows of; a goal that is opened again has no children. A dead
/// neighbour need not be heard, since its certificate names the latest epoch that it can have worked in.
fn all_heard(v: View<'_>) -> bool {
    let is_last_goal = usize::from(v.own.epoch.goal()) + 1 == v.own.setup.goals.len();
    !v.own.restarted || is_last_goal || !v.sides.any_unheard()
}
