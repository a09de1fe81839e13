//! Messages over time: how many went from whom to whom in each stretch of a run, and the last ones of
//! every module. Bounded: when a long run makes too many stretches, two become one.

use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, Time};
use serde::Serialize;
use std::collections::HashMap;
use std::fmt;

/// The number of classes.
const CLASSES: usize = Class::ALL.len();
/// Stands for "no way known".
pub const FAR: u16 = u16::MAX;
/// More stretches than this become half as many.
const MOST_BINS: usize = 2048;
/// More connections in all stretches together than this make half as many stretches.
const MOST_EDGES: usize = 2_000_000;
/// More messages kept than this are thinned out.
const MOST_LOGGED: usize = 2_000_000;
/// Of each module and stretch at least this many are kept.
const KEPT: usize = 6;

/// What a message says, as far as it is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Said {
    /// In words.
    pub what: &'static str,
    /// Whom it is about.
    pub whom: Option<ModuleId>,
    /// How far the sender is from a target.
    pub distance: Option<u16>,
}

impl Said {
    /// Nothing but words.
    pub const fn of(what: &'static str) -> Said {
        Said { what, whom: None, distance: None }
    }
    /// Words about a module.
    pub const fn about(what: &'static str, whom: ModuleId) -> Said {
        Said { whom: Some(whom), ..Said::of(what) }
    }
}

impl fmt::Display for Said {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.what)?;
        if let Some(whom) = self.whom {
            write!(f, " {whom}")?;
        }
        match self.distance {
            None => Ok(()),
            Some(FAR) => f.write_str(", knows no target"),
            Some(distance) => write!(f, ", target at {distance}"),
        }
    }
}

/// Messages from one module to another in one stretch of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// From whom.
    pub from: ModuleId,
    /// To whom.
    pub to: ModuleId,
    /// How many of each class.
    pub counts: [u32; CLASSES],
}

/// One stretch of time.
#[derive(Clone, Debug, Default)]
pub struct Bin {
    /// Messages of each class.
    pub totals: [u64; CLASSES],
    /// Moves completed.
    pub moves: u64,
    /// Goal cells filled at the end of it.
    pub filled: u64,
    /// Goal cells there were then.
    pub goal: u64,
    /// Who talked to whom.
    pub edges: Vec<Edge>,
    /// How far each module said it was from a target, at the end of it; [`FAR`] if it knew of none.
    pub gradient: Vec<u16>,
    /// Modules that had promised another one to stay where they are, at the end of it.
    pub locks: Vec<(ModuleId, ModuleId)>,
}

/// One message, as somebody looks at it.
#[derive(Clone, Copy, Debug)]
pub struct Logged {
    /// When it arrived.
    pub at: Time,
    /// The other module.
    pub peer: ModuleId,
    /// Whether it was sent, rather than received.
    pub sent: bool,
    /// What it was for.
    pub class: Class,
    /// What it said.
    pub said: Said,
}

/// The same for a page.
#[derive(Debug, Serialize)]
pub struct LoggedText {
    /// Microseconds.
    t: u64,
    peer: u32,
    sent: bool,
    class: u8,
    text: String,
}

/// All messages of a run, in stretches of equal length.
#[derive(Debug)]
pub struct Flow {
    width: Span,
    bins: Vec<Bin>,
    edges: usize,
    /// Where an edge of the last bin is in it.
    places: HashMap<(ModuleId, ModuleId), usize>,
    /// How far each module is from a target, as it says itself.
    gradient: Vec<u16>,
    /// For whom it stays where it is.
    locks: Vec<Option<ModuleId>>,
    log: Vec<Vec<Logged>>,
    logged: usize,
    /// The stretch of time in which messages are thinned out.
    thinned: Span,
}

impl Flow {
    /// No messages yet. Stretches begin with this width.
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

    /// How long a stretch is.
    pub fn width(&self) -> Span {
        self.width
    }
    /// All stretches; the last one may still be going on.
    pub fn bins(&self) -> &[Bin] {
        &self.bins
    }

    /// A message has arrived.
    pub fn delivered(&mut self, now: Time, from: ModuleId, to: ModuleId, class: Class, said: Said) {
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

    /// A module is this far from a target and stays for another one, as it says itself.
    pub fn state(&mut self, now: Time, id: ModuleId, gradient: u16, lock: Option<ModuleId>) {
        self.advance(now);
        if let (Some(far), Some(own)) = (self.gradient.get_mut(id.index()), self.locks.get_mut(id.index())) {
            (*far, *own) = (gradient, lock);
        }
    }

    /// A move has ended.
    pub fn moved(&mut self, now: Time) {
        self.advance(now);
        self.current().moves += 1;
    }

    /// How far the goal has come.
    pub fn progress(&mut self, now: Time, filled: u64, goal: u64) {
        self.advance(now);
        let bin = self.current();
        (bin.filled, bin.goal) = (filled, goal);
    }

    /// Nothing follows.
    pub fn finish(&mut self, now: Time) {
        self.advance(now);
        self.close();
    }

    fn current(&mut self) -> &mut Bin {
        self.bins.last_mut().expect("invariant: there is always a bin")
    }

    /// Begins the stretches up to now.
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

    /// Notes the state at the end of the last stretch.
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
        // The last one has just begun and is empty.
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

    /// Keeps the last few messages of each module in each stretch of time, which grows until half of
    /// all messages are gone.
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

    /// The last `count` messages of a module at a time, the latest first.
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

/// Two stretches as one.
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

    fn said() -> Said {
        Said::of("beacon")
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
