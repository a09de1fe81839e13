//! Message counts over time: who sent how many to whom in each bin of a run, and the last messages of each
//! module. Bounded: when a long run has too many bins, pairs of bins are merged.

use metamorph_core::counters::Class;
use metamorph_core::ids::ModuleId;
use metamorph_core::time::{Span, Time};
use serde::Serialize;
use std::collections::HashMap;
use std::fmt;

/// The number of classes.
const CLASSES: usize = Class::ALL.len();
/// Distance of a module that knows no path to a target.
pub const FAR: u16 = u16::MAX;
/// Largest number of bins; beyond, pairs are merged.
const MOST_BINS: usize = 2048;
/// Largest number of edges in all bins together; beyond, pairs of bins are merged.
const MOST_EDGES: usize = 2_000_000;
/// Largest number of messages kept; beyond, they are thinned out.
const MOST_LOGGED: usize = 2_000_000;
/// Number of messages kept per module and interval when the log is thinned out.
const KEPT: usize = 6;

/// The displayed contents of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageLabel {
    /// A description.
    pub what: &'static str,
    /// A number behind it: the module that the message is about, or a value that it carries.
    pub number: Option<i64>,
    /// The sender's distance to a target.
    pub distance: Option<u16>,
}

impl MessageLabel {
    /// Creates contents with a description only.
    pub const fn of(what: &'static str) -> MessageLabel {
        MessageLabel { what, number: None, distance: None }
    }
    /// Creates contents about a module.
    pub const fn about(what: &'static str, whom: ModuleId) -> MessageLabel {
        MessageLabel::with(what, whom.0 as i64)
    }
    /// Creates contents that carry a value.
    pub const fn with(what: &'static str, number: i64) -> MessageLabel {
        MessageLabel { number: Some(number), ..MessageLabel::of(what) }
    }
}

impl fmt::Display for MessageLabel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.what)?;
        if let Some(number) = self.number {
            write!(f, " {number}")?;
        }
        match self.distance {
            None => Ok(()),
            Some(FAR) => f.write_str(", knows no target"),
            Some(distance) => write!(f, ", target at {distance}"),
        }
    }
}

/// Messages from one module to another in one bin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// The sender.
    pub from: ModuleId,
    /// The receiver.
    pub to: ModuleId,
    /// Messages of each class.
    pub counts: [u32; CLASSES],
}

/// One interval of scenario time.
#[derive(Clone, Debug, Default)]
pub struct Bin {
    /// Messages of each class.
    pub totals: [u64; CLASSES],
    /// Moves completed.
    pub moves: u64,
    /// Filled goal cells at the end of the bin.
    pub filled: u64,
    /// Goal cells at the end of the bin.
    pub goal: u64,
    /// Messages per pair of modules.
    pub edges: Vec<Edge>,
    /// Reported distance of each module to a target at the end of the bin; [`FAR`] if it knew none.
    pub gradient: Vec<u16>,
    /// Modules locked at the end of the bin, each with the module it has promised to stay for.
    pub locks: Vec<(ModuleId, ModuleId)>,
}

/// A message in the log of one module.
#[derive(Clone, Copy, Debug)]
pub struct Logged {
    /// Time of arrival.
    pub at: Time,
    /// The other module.
    pub peer: ModuleId,
    /// True if it was sent, false if received.
    pub sent: bool,
    /// Its class.
    pub class: Class,
    /// Its contents.
    pub said: MessageLabel,
}

/// The JSON form for a page.
#[derive(Debug, Serialize)]
pub struct LoggedText {
    /// Time in microseconds.
    t: u64,
    peer: u32,
    sent: bool,
    class: u8,
    text: String,
}

/// All messages of a run, in bins of equal width.
#[derive(Clone, Debug)]
pub struct Flow {
    width: Span,
    bins: Vec<Bin>,
    edges: usize,
    /// Index of each edge in the last bin.
    places: HashMap<(ModuleId, ModuleId), usize>,
    /// Each module's distance to a target, as it reports.
    gradient: Vec<u16>,
    /// The module that each module has promised to stay for.
    locks: Vec<Option<ModuleId>>,
    log: Vec<Vec<Logged>>,
    logged: usize,
    /// The interval over which messages are thinned out.
    thinned: Span,
}

impl Flow {
    /// Creates an empty timeline whose bins start with this width.
    pub fn new(modules: usize, width: Span) -> Flow {
        let width = width.max(Span(1));
        Flow {
            width,
            bins: vec![Bin::default()],
            edges: 0,
            places: HashMap::new(),
            gradient: vec![FAR; modules],
            locks: vec![None; modules],
            log: vec![Vec::new(); modules],
            logged: 0,
            thinned: Span(width.0 / 4),
        }
    }

    /// Returns the width of a bin.
    pub fn width(&self) -> Span {
        self.width
    }
    /// Returns all bins; the last one may be incomplete.
    pub fn bins(&self) -> &[Bin] {
        &self.bins
    }

    /// Counts a message that has arrived.
    pub fn delivered(&mut self, now: Time, from: ModuleId, to: ModuleId, class: Class, said: MessageLabel) {
        self.advance(now);
        let bin = self.bins.last_mut().expect("invariant: there is always a bin");
        bin.totals[class.index()] += 1;
        let place = *self.places.entry((from, to)).or_insert_with(|| {
            bin.edges.push(Edge { from, to, counts: [0; CLASSES] });
            self.edges += 1;
            bin.edges.len() - 1
        });
        bin.edges[place].counts[class.index()] += 1;
        for (whose, peer, sent) in [(from, to, true), (to, from, false)] {
            if let Some(log) = self.log.get_mut(whose.index()) {
                log.push(Logged { at: now, peer, sent, class, said });
                self.logged += 1;
            }
        }
        if self.logged > MOST_LOGGED {
            self.thin();
        }
    }

    /// Records a module's reported distance to a target and lock.
    pub fn state(&mut self, now: Time, id: ModuleId, gradient: u16, lock: Option<ModuleId>) {
        self.advance(now);
        if let (Some(far), Some(own)) = (self.gradient.get_mut(id.index()), self.locks.get_mut(id.index())) {
            (*far, *own) = (gradient, lock);
        }
    }

    /// Counts a completed move.
    pub fn moved(&mut self, now: Time) {
        self.advance(now);
        self.current().moves += 1;
    }

    /// Records the progress of the goal.
    pub fn progress(&mut self, now: Time, filled: u64, goal: u64) {
        self.advance(now);
        let bin = self.current();
        (bin.filled, bin.goal) = (filled, goal);
    }

    /// Completes the timeline.
    pub fn finish(&mut self, now: Time) {
        self.advance(now);
        self.close();
    }

    fn current(&mut self) -> &mut Bin {
        self.bins.last_mut().expect("invariant: there is always a bin")
    }

    /// Appends bins up to `now`.
    fn advance(&mut self, now: Time) {
        while now.0 / self.width.0 >= self.bins.len() as u64 {
            self.close();
            let Bin { filled, goal, .. } = *self.current();
            self.bins.push(Bin { filled, goal, ..Bin::default() });
            if self.bins.len() > MOST_BINS || self.edges > MOST_EDGES {
                self.coarsen();
            }
        }
    }

    /// Records the state at the end of the last bin.
    fn close(&mut self) {
        self.places.clear();
        let gradient = self.gradient.clone();
        let ids = (0..self.locks.len() as u32).map(ModuleId);
        let locks = ids.zip(&self.locks).filter_map(|(id, owner)| Some((id, (*owner)?))).collect();
        let bin = self.current();
        (bin.gradient, bin.locks) = (gradient, locks);
        bin.edges.sort_unstable_by_key(|e| (e.from, e.to));
    }

    fn coarsen(&mut self) {
        // The last bin has just begun and is empty.
        self.bins.pop();
        let mut merged = Vec::with_capacity(self.bins.len() / 2 + 1);
        let mut bins = std::mem::take(&mut self.bins).into_iter();
        while let Some(first) = bins.next() {
            merged.push(match bins.next() {
                Some(second) => merge(first, second),
                None => first,
            });
        }
        self.width = self.width * 2;
        self.edges = merged.iter().map(|b| b.edges.len()).sum();
        let open = merged.last().map_or_else(Bin::default, |b| Bin {
            filled: b.filled,
            goal: b.goal,
            ..Bin::default()
        });
        self.bins = merged;
        self.bins.push(open);
        self.places.clear();
    }

    /// Keeps only the last few messages per module and interval; widens the interval until half of all
    /// messages are dropped.
    fn thin(&mut self) {
        while self.logged > MOST_LOGGED / 2 {
            self.thinned = self.thinned * 2;
            for log in &mut self.log {
                let mut kept = Vec::new();
                for part in log.chunk_by(|a, b| a.at.0 / self.thinned.0 == b.at.0 / self.thinned.0) {
                    kept.extend_from_slice(&part[part.len().saturating_sub(KEPT)..]);
                }
                *log = kept;
            }
            self.logged = self.log.iter().map(Vec::len).sum();
        }
    }

    /// Returns the last `count` messages of a module at a time, the latest first.
    pub fn last_of(&self, id: ModuleId, at: Time, count: usize) -> Vec<LoggedText> {
        let log = self.log.get(id.index()).map_or(&[][..], Vec::as_slice);
        let until = log.partition_point(|l| l.at <= at);
        let text = |l: &Logged| LoggedText {
            t: l.at.0 / 1_000,
            peer: l.peer.0,
            sent: l.sent,
            class: l.class as u8,
            text: l.said.to_string(),
        };
        log[..until].iter().rev().take(count).map(text).collect()
    }
}

/// Merges two bins.
fn merge(mut first: Bin, second: Bin) -> Bin {
    let mut edges = std::mem::take(&mut first.edges);
    edges.extend(second.edges);
    edges.sort_unstable_by_key(|e| (e.from, e.to));
    edges.dedup_by(|next, kept| {
        let same = (next.from, next.to) == (kept.from, kept.to);
        if same {
            kept.counts.iter_mut().zip(next.counts).for_each(|(a, b)| *a += b);
        }
        same
    });
    let mut totals = first.totals;
    totals.iter_mut().zip(second.totals).for_each(|(a, b)| *a += b);
    Bin { totals, moves: first.moves + second.moves, edges, ..second }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said() -> MessageLabel {
        MessageLabel::of("beacon")
    }

    fn talk(flow: &mut Flow, at: u64, from: u32, to: u32) {
        flow.delivered(Time(at), ModuleId(from), ModuleId(to), Class::Seed, said());
    }

    #[test]
    fn messages_are_counted_where_and_when_they_arrive() {
        let mut flow = Flow::new(3, Span(10));
        for at in [0, 9, 10, 35] {
            talk(&mut flow, at, 0, 1);
        }
        talk(&mut flow, 35, 1, 0);
        flow.finish(Time(36));
        let totals: Vec<u64> = flow.bins().iter().map(|b| b.totals[Class::Seed.index()]).collect();
        assert_eq!(totals, [2, 1, 0, 2]);
        let seen: Vec<_> = flow.bins()[3].edges.iter().map(|e| (e.from.0, e.to.0, e.counts[1])).collect();
        assert_eq!(seen, [(0, 1, 1), (1, 0, 1)]);
        let last = flow.last_of(ModuleId(1), Time(34_000_000), 9);
        assert_eq!((last.len(), last[0].sent, last[1].sent), (5, true, false));
        assert_eq!(flow.last_of(ModuleId(1), Time(9), 9).len(), 2);
    }

    #[test]
    fn a_long_run_keeps_all_counts_in_bounded_memory() {
        let mut flow = Flow::new(2, Span(1));
        let n = 100_000u64;
        (0..n).for_each(|at| talk(&mut flow, at, 0, 1));
        assert!(flow.bins().len() <= MOST_BINS && flow.width() > Span(1));
        assert_eq!(flow.bins().iter().map(|b| b.totals[1]).sum::<u64>(), n);
        let of_edges = |b: &Bin| b.edges.iter().map(|e| u64::from(e.counts[1])).sum::<u64>();
        assert!(flow.bins().iter().all(|b| of_edges(b) == b.totals[1] && b.edges.len() <= 1));
    }

    #[test]
    fn what_modules_say_of_themselves_holds_until_they_say_otherwise() {
        let mut flow = Flow::new(2, Span(10));
        flow.state(Time(1), ModuleId(1), 4, Some(ModuleId(0)));
        flow.state(Time(25), ModuleId(1), FAR, None);
        flow.state(Time(25), ModuleId(7), 1, None);
        flow.finish(Time(40));
        let held: Vec<usize> = flow.bins().iter().map(|b| b.locks.len()).collect();
        assert_eq!(held, [1, 1, 0, 0, 0]);
        let far: Vec<u16> = flow.bins().iter().map(|b| b.gradient[1]).collect();
        assert_eq!(far, [4, 4, FAR, FAR, FAR]);
    }

    #[test]
    fn a_time_without_end_is_survived() {
        let mut flow = Flow::new(2, Span(1));
        talk(&mut flow, u64::MAX, 0, 1);
        flow.finish(Time(u64::MAX));
        assert!(flow.bins().len() <= MOST_BINS);
    }

    #[test]
    fn old_messages_are_thinned_out_evenly() {
        let mut flow = Flow::new(2, Span(1_000));
        (0..MOST_LOGGED as u64).for_each(|at| talk(&mut flow, at, 0, 1));
        assert!(flow.logged <= MOST_LOGGED);
        for at in [10_000, 500_000, 1_000_000] {
            let last = flow.last_of(ModuleId(0), Time(at), 3);
            assert_eq!(last.len(), 3, "{at}");
        }
    }
}
