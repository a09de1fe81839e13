//! Surveys: how a module finds a goal cell that no distance leads to.
//!
//! Dead modules pass no distances on, so the field ends at them, although a module can walk over them. A module that may leave,
//! knows that a module of the body has died ([`Beacon::knows_of_death`]) and has heard of no target for long searches the
//! surface itself: depth first, over live modules by requests as ever and over certified dead ones without asking
//! (`turns`), cells near unfilled goal cells first. As soon as it hears of a target it is an ordinary walker again.
//!
//! A survey that finds nothing ends after a number of cells, and a later one goes farther. From the second one on, a module that
//! stands in a goal cell beside a filled one waits there: it was not wanted when it came by first, and a finalized neighbour
//! that sees it wait starts the cell out of turn.
//!
//! [`Beacon::knows_of_death`]: super::message::Beacon::knows_of_death

use super::Cube;
use super::motion_planner::Candidates;
use super::params::{Connectivity, Params};
use alloc::boxed::Box;
use alloc::collections::BTreeSet;
use alloc::vec::Vec;
use core::hash::Hash;
use metamorph_core::digest::Portable;
use metamorph_core::lattice::{Cell, Face, Motion, MotionKind};
use metamorph_core::time::{Span, Time};

/// The number of cells that the first survey visits; each further one visits twice as many, up to [`FARTHEST`] times.
const FIRST_REACH: usize = 48;
/// The largest number of times that the number of cells doubles.
const FARTHEST: u8 = 6;
/// The largest number of times that the wait before a survey doubles.
const LONGEST: u8 = 2;
/// The number of times that a motion is tried before it counts as blocked.
const TRIES: u8 = 5;
/// The number of times that a survey looks for a motion at one cell before it ends.
const LOOKS: u8 = 20;

/// A depth-first search of the surface. Every collection is bounded by the number of cells that it visits.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
struct Survey {
    visited: BTreeSet<Cell>,
    /// The cells from the first one to the present one, without this.
    way: Vec<Cell>,
    /// Goal cells that were found filled.
    filled: BTreeSet<Cell>,
    /// Motions that are impossible, with the cells that they begin at.
    blocked: Vec<(Cell, Motion)>,
    /// The motion that has been begun, or is asked for.
    trying: Option<Motion>,
    /// The number of times that it was tried, or that no motion was found.
    tries: u8,
    /// The goal cells in which the module has waited in vain.
    waited: BTreeSet<Cell>,
}

impl Survey {
    /// Notes that a motion from a cell was denied or refused.
    fn fail(&mut self, cell: Cell, motion: Motion, is_certain: bool) {
        if self.trying.take() != Some(motion) {
            return;
        }
        self.tries += 1;
        if is_certain || self.tries >= TRIES {
            self.blocked.push((cell, motion));
            self.tries = 0;
        }
    }

    fn arrive(&mut self, from: Cell, to: Cell) {
        (self.trying, self.tries) = (None, 0);
        if self.way.last() == Some(&to) {
            self.way.pop();
        } else {
            self.way.push(from);
        }
    }
}

/// State of a module's surveys.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Surveyor {
    survey: Option<Box<Survey>>,
    /// The number of surveys that have found nothing.
    in_vain: u8,
    /// Since when the module has heard of no target, and nothing has changed around it.
    quiet_since: Time,
    /// True if it waits in a goal cell to be finalized out of turn.
    awaits: bool,
}

impl Surveyor {
    pub fn new(now: Time) -> Surveyor {
        Surveyor { survey: None, in_vain: 0, quiet_since: now, awaits: false }
    }
    /// Feeds the state into a hash.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        let Surveyor { survey, in_vain, quiet_since, awaits } = self;
        (survey, in_vain, quiet_since, awaits).hash(hasher);
    }
    /// Returns true if the module waits in a goal cell to be finalized out of turn.
    pub fn awaits(&self) -> bool {
        self.awaits
    }
    pub fn is_surveying(&self) -> bool {
        self.survey.is_some()
    }
    /// Notes that a target is known, or that another goal is worked for.
    pub fn reset(&mut self, now: Time) {
        *self = Surveyor::new(now);
    }
    /// Ends a survey because the module takes a place in the structure.
    pub fn settle(&mut self, now: Time) {
        (self.survey, self.awaits, self.quiet_since) = (None, false, now);
    }
    /// Notes that a neighbour has come or gone.
    pub fn on_contact(&mut self, now: Time) {
        if self.survey.is_none() {
            self.quiet_since = now;
        }
    }
    /// Notes the arrival at a cell.
    pub fn on_arrival(&mut self, now: Time, from: Cell, to: Cell) {
        (self.quiet_since, self.awaits) = (now, false);
        if let Some(survey) = &mut self.survey {
            survey.arrive(from, to);
        }
    }
    /// Notes that a motion from a cell was denied or refused; `is_certain` if it is impossible as long as nothing changes.
    pub fn on_failed(&mut self, cell: Cell, motion: Motion, is_certain: bool) {
        if let Some(survey) = &mut self.survey {
            survey.fail(cell, motion, is_certain);
        }
    }
    /// Returns when a survey begins, if nothing happens until then. Of all modules, those nearest to the goal begin: the way of a
    /// module `distance` cells from it is longer by two moves a cell. `jitter` lets equally near ones begin at different times.
    fn due(&self, p: &Params, distance: u32, jitter: Span) -> Time {
        let wait = p.survey_after * (1 << self.in_vain.min(LONGEST));
        self.quiet_since + wait + p.move_time * (2 * u64::from(distance)) + jitter
    }
    fn reach(&self) -> usize {
        FIRST_REACH << self.in_vain.min(FARTHEST)
    }
}

impl Cube {
    /// Returns true if the module may survey: a module of the body has died, and no one leads this one.
    pub(super) fn may_survey(&self) -> bool {
        self.own.knows_of_death
            && self.own.connectivity() == Connectivity::Forest
            && !self.own.is_closed
            && self.called.is_none()
            && self.steered.is_none()
    }

    /// Returns true if the module waits in its cell to be finalized: the controller called it there, or a survey has led there.
    pub(super) fn waits_here(&self) -> bool {
        self.is_called_here() || self.surveyor.awaits()
    }

    /// Returns the next motion of a survey, or when to decide again. No target is known.
    pub(super) fn survey(&mut self, now: Time, candidates: &Candidates) -> Option<Motion> {
        if !self.surveyor.is_surveying() {
            // The distance to the goal takes long to find, and is not needed before.
            let earliest = self.surveyor.due(self.own.params(), 0, Span::ZERO);
            let due = if now < earliest { earliest } else { self.survey_due() };
            if now < due {
                self.decide_at_latest(due);
                return None;
            }
        }
        let mut survey = self.surveyor.survey.take().unwrap_or_default();
        let cell = self.own.cell;
        survey.visited.insert(cell);
        let filled = Face::in_mask(self.filled & self.own.masks.cells);
        survey.filled.extend(filled.map(|f| cell.step(f)));
        let awaits = self.awaits_here(now, &mut survey);
        if core::mem::replace(&mut self.surveyor.awaits, awaits) != awaits {
            self.invalidate();
        }
        let motion = if awaits {
            self.decide_at_latest(now + self.own.params().heartbeat);
            None
        } else {
            let next = self.next_of_survey(&survey, candidates);
            let is_over = survey.visited.len() > self.surveyor.reach();
            survey.tries += u8::from(next.is_none());
            if is_over || (next.is_none() && (survey.way.is_empty() || survey.tries >= LOOKS)) {
                self.surveyor.in_vain = self.surveyor.in_vain.saturating_add(1);
                self.surveyor.quiet_since = now;
                let due = self.survey_due();
                self.decide_at_latest(due);
                return None;
            }
            if next.is_none() {
                survey.blocked.retain(|(at, _)| *at != cell);
                self.decide_at_latest(now + self.own.params().move_time * 2);
            }
            survey.trying = next;
            next
        };
        self.surveyor.survey = Some(survey);
        motion
    }

    fn decide_at_latest(&mut self, at: Time) {
        self.planner.decide_at = self.planner.decide_at.min(at);
    }

    /// Returns true if the module waits here to be finalized out of turn: it stands in a goal cell beside a filled one, and has
    /// not waited there before.
    fn awaits_here(&self, now: Time, survey: &mut Survey) -> bool {
        let cell = self.own.cell;
        let filled = self.finals | self.forest.fixed_mask(self.view(now));
        let may_fill = self.own.masks.own && filled & self.own.masks.cells != 0;
        if self.surveyor.in_vain == 0 || !may_fill || survey.waited.contains(&cell) {
            return false;
        }
        let waits = now.since(self.own.settled) < self.own.params().out_of_turn_after / 2;
        if !waits {
            survey.waited.insert(cell);
        }
        waits
    }

    /// Returns the motion to the unvisited cell that is nearest to an open goal cell; if there is none, the motion back.
    fn next_of_survey(&self, survey: &Survey, candidates: &Candidates) -> Option<Motion> {
        let cell = self.own.cell;
        let motions = self.survey_motions(survey, candidates);
        let is_open = |c: &Cell| !survey.filled.contains(c) && !survey.visited.contains(c);
        let open: Vec<Cell> = self.own.goal().cells().filter(is_open).collect();
        let left = |at: Cell| open.iter().map(|c| c.manhattan(at)).min().unwrap_or(0);
        let is_new = |m: &&Motion| !survey.visited.contains(&m.destination(cell));
        let new = motions.iter().filter(is_new).min_by_key(|m| left(m.destination(cell)));
        let back = || motions.iter().find(|m| Some(&m.destination(cell)) == survey.way.last());
        new.or_else(back).copied()
    }

    /// Returns the motions that a survey may ask for, over live modules and over dead ones.
    fn survey_motions(&self, survey: &Survey, candidates: &Candidates) -> Vec<Motion> {
        let cell = self.own.cell;
        let is_free = |m: &Motion| !survey.blocked.contains(&(cell, *m));
        let mut motions: Vec<Motion> = candidates.free().filter(is_free).collect();
        for support in Face::in_mask(self.sides.certified_mask()) {
            let headings = support.perpendicular().into_iter().filter(|f| !self.sides.is_touching(*f));
            // It is not known what stands beside a dead module. The body refuses what is not possible.
            let over = |heading| {
                let of = |kind| Motion { kind, support, heading };
                [MotionKind::Slide, MotionKind::Convex].map(of).into_iter().find(is_free)
            };
            motions.extend(headings.filter_map(over));
        }
        motions
    }

    fn survey_due(&self) -> Time {
        let (p, cell) = (self.own.params(), self.own.cell);
        let distance = self.own.goal().cells().map(|c| c.manhattan(cell)).min().unwrap_or(0);
        let jitter =
            u64::from(self.own.id.0).wrapping_mul(0x9E37_79B9_7F4A_7C15) % (p.move_time.0 * 8).max(1);
        self.surveyor.due(p, distance, Span(jitter))
    }
}
