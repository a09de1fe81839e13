//! Joins the parts of a run's journal into one order, in which every cause comes before its effects.
//!
//! All processes of a run share one clock, so the order of time is nearly right. Within one instant, and if
//! clocks should disagree, a record waits for its cause: a message waits for the step that sent it, an order
//! for the controller's record, an action for the step that asked for it. A cause that cannot come, because
//! its file ends earlier, is noted ([`Event::Torn`]) and not waited for; so is a torn end. Parts of another
//! run and missing or damaged parts are errors.

use super::{Consumed, Damage, DamageKind, Event, JournalError, Record, RunHead, Who};
use metamorph_module_agent::journal_file::{Head, Reader, agent_of, agent_part, controller_part};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, VecDeque};
use std::fs;
use std::path::{Path, PathBuf};

/// Number of items that the records emitted so far have produced (`given`) and consumed (`taken`). No item
/// may be consumed before it is produced.
#[derive(Default)]
struct Count {
    given: u32,
    taken: u32,
}

/// Counts over the records emitted so far that concern one incarnation of an agent.
#[derive(Default)]
struct StepCounts {
    /// Messages sent.
    sent: u32,
    /// Actions and reports, from the agent to the controller.
    up: Count,
    /// Contacts, percepts and orders, from the controller to the agent.
    down: Count,
}

struct Stream {
    who: Who,
    reader: Reader,
    next: Option<Record>,
}

/// The parts of a run, being joined.
pub struct Join {
    head: RunHead,
    streams: Vec<Stream>,
    /// The stream of each writer.
    index: BTreeMap<Who, usize>,
    heap: BinaryHeap<Reverse<(u64, usize)>>,
    /// Streams whose next record waits for its cause, by time.
    blocked: Vec<(u64, usize)>,
    incarnations: BTreeMap<(ModuleId, Incarnation), StepCounts>,
    /// The current incarnation of each module, as the controller knows it.
    current: BTreeMap<ModuleId, Incarnation>,
    torn: BTreeSet<Who>,
    /// The time of the latest record.
    last: Time,
    ready: VecDeque<Record>,
    /// Parts without a head: their writers were killed while creating them.
    troubles: Vec<String>,
    /// The directory of the parts.
    parts: PathBuf,
    /// The first damage, until it is reported.
    damage: Option<Damage>,
    over: bool,
}

impl Join {
    /// Opens all parts in a directory.
    pub fn open(parts: &Path) -> Result<Join, JournalError> {
        let controller = controller_part(parts);
        let first = Reader::open(&controller)?;
        let Head::Run(head) = first.head().clone() else {
            return Err(JournalError::Unfit(controller, "this is the part of a module".to_owned()));
        };
        let run = head.run;
        let mut join = Join {
            head,
            streams: Vec::new(),
            index: BTreeMap::new(),
            heap: BinaryHeap::new(),
            blocked: Vec::new(),
            incarnations: BTreeMap::new(),
            current: BTreeMap::new(),
            torn: BTreeSet::new(),
            last: Time::ZERO,
            ready: VecDeque::new(),
            troubles: Vec::new(),
            parts: parts.to_owned(),
            damage: None,
            over: false,
        };
        join.add(Who::Controller, first);
        let entries = fs::read_dir(parts).map_err(|e| JournalError::Read(parts.to_owned(), e))?;
        let mut paths: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
        paths.sort();
        for path in paths {
            let name = path.file_name().and_then(|name| name.to_str());
            let Some(whose) = name.and_then(agent_of) else { continue };
            let damage = |kind| Damage { path: path.clone(), at: 0, kind };
            let reader = match Reader::open(&path) {
                Ok(reader) => reader,
                // Killed while creating its part; if the controller had started it, the part is missing.
                Err(JournalError::NoHead(path)) => {
                    join.troubles.push(format!("{}: nothing was written to this part", path.display()));
                    continue;
                }
                Err(JournalError::Magic(_) | JournalError::Version(..)) => {
                    return Err(damage(DamageKind::NoPart).into());
                }
                Err(e) => return Err(e),
            };
            let kind = match *reader.head() {
                Head::Run(_) => DamageKind::NoPart,
                Head::Part { run: found, .. } if found != run => {
                    DamageKind::OtherRun { expected: run, found }
                }
                Head::Part { id, incarnation, .. } if (id, incarnation) != whose => {
                    DamageKind::OtherPart { id, incarnation }
                }
                Head::Part { id, incarnation, .. } => {
                    join.add(Who::Agent(id, incarnation), reader);
                    continue;
                }
            };
            return Err(damage(kind).into());
        }
        Ok(join)
    }

    /// Returns the head of the journal.
    pub fn head(&self) -> &RunHead {
        &self.head
    }

    /// Returns what was wrong with the parts, once all records are read.
    pub fn troubles(&self) -> Vec<String> {
        let torn = self.streams.iter().filter_map(|s| s.reader.torn()).map(ToString::to_string);
        self.troubles.iter().cloned().chain(torn).collect()
    }

    fn add(&mut self, who: Who, reader: Reader) {
        let stream = self.streams.len();
        self.index.insert(who, stream);
        self.streams.push(Stream { who, reader, next: None });
        self.refill(stream);
    }

    fn refill(&mut self, i: usize) {
        let stream = &mut self.streams[i];
        stream.next = match stream.reader.next() {
            Some(Err(damage)) => {
                self.damage.get_or_insert(damage);
                None
            }
            next => next.and_then(Result::ok),
        };
        let who = stream.who;
        if stream.reader.torn().is_some() && self.torn.insert(who) {
            self.ready.push_back(Record { at: self.last, who, event: Event::Torn });
        }
        if let Some(record) = &stream.next {
            // Agents continue for a moment after the end, until the controller stops them.
            if matches!(record.event, Event::Counted { .. } | Event::Ended { .. }) {
                self.heap.push(Reverse((u64::MAX, i)));
            } else {
                self.heap.push(Reverse((record.at.0, i)));
            }
        }
    }

    fn incarnation(&mut self, id: ModuleId, incarnation: Incarnation) -> &mut StepCounts {
        self.incarnations.entry((id, incarnation)).or_default()
    }

    /// Returns the writer of the cause that this record still waits for; `None` if it waits for none.
    fn cause(&self, record: &Record) -> Option<Who> {
        let incarnation = |id, incarnation| self.incarnations.get(&(id, incarnation));
        match (record.who, &record.event) {
            (Who::Agent(id, l), Event::Born { .. }) => {
                let known = self.current.get(&id).is_some_and(|c| *c >= l);
                (!known).then_some(Who::Controller)
            }
            (Who::Agent(id, l), Event::Step(step)) => match &step.input {
                Consumed::Message { name, .. } => {
                    let sent = incarnation(name.from, name.incarnation).map_or(0, |s| s.sent);
                    (sent <= name.number).then_some(Who::Agent(name.from, name.incarnation))
                }
                Consumed::Wake => None,
                _ => {
                    let waits = incarnation(id, l).is_none_or(|s| s.down.taken >= s.down.given);
                    waits.then_some(Who::Controller)
                }
            },
            (Who::Controller, Event::Act { id, .. } | Event::Report { id, .. }) => {
                let l = *self.current.get(id)?;
                let waits = incarnation(*id, l).is_none_or(|s| s.up.taken >= s.up.given);
                waits.then_some(Who::Agent(*id, l))
            }
            _ => None,
        }
    }

    /// Returns true if the next record of stream `i` may be emitted now: it waits for no cause, or for one
    /// that cannot come any more because its stream is missing or has ended, which is noted
    /// ([`Event::Torn`]).
    fn may_come(&mut self, i: usize) -> bool {
        let Some(record) = &self.streams[i].next else { return false };
        let at = record.at;
        let Some(cause) = self.cause(record) else { return true };
        let is_over = self.index.get(&cause).is_none_or(|c| self.streams[*c].next.is_none());
        if is_over && self.torn.insert(cause) {
            self.ready.push_back(Record { at, who: cause, event: Event::Torn });
        }
        is_over
    }

    fn come(&mut self, i: usize) {
        let Some(mut record) = self.streams[i].next.take() else { return };
        self.last = self.last.max(record.at);
        if matches!(record.event, Event::Counted { .. } | Event::Ended { .. }) {
            record.at = self.last;
        }
        self.note(&record);
        self.ready.push_back(record);
        self.refill(i);
    }

    fn note(&mut self, record: &Record) {
        match (record.who, &record.event) {
            (Who::Agent(id, l), Event::Step(step)) => {
                let incarnation = self.incarnation(id, l);
                incarnation.sent += step.sent.len() as u32;
                incarnation.up.given += step.told.len() as u32;
                if !matches!(step.input, Consumed::Message { .. } | Consumed::Wake) {
                    incarnation.down.taken += 1;
                }
            }
            (_, Event::Start { id, incarnation, .. }) => {
                self.current.insert(*id, *incarnation);
                if !self.index.contains_key(&Who::Agent(*id, *incarnation)) {
                    let path = agent_part(&self.parts, *id, *incarnation);
                    let kind = DamageKind::MissingPart { id: *id, incarnation: *incarnation };
                    self.damage.get_or_insert(Damage { path, at: 0, kind });
                }
            }
            (_, Event::Sensed { id, .. } | Event::Command(Command::Order(id, _))) => {
                if let Some(l) = self.current.get(id).copied() {
                    self.incarnation(*id, l).down.given += 1;
                }
            }
            (_, Event::Act { id, .. } | Event::Report { id, .. }) => {
                if let Some(l) = self.current.get(id).copied() {
                    self.incarnation(*id, l).up.taken += 1;
                }
            }
            _ => {}
        }
    }

    /// Emits the next record, with notes of torn parts, if any. Returns false at the end.
    fn advance(&mut self) -> bool {
        for k in 0..self.blocked.len() {
            let (_, i) = self.blocked[k];
            if self.may_come(i) {
                self.blocked.remove(k);
                self.come(i);
                return true;
            }
        }
        while let Some(Reverse((at, i))) = self.heap.pop() {
            if self.may_come(i) {
                self.come(i);
                return true;
            }
            let place = self.blocked.partition_point(|b| *b < (at, i));
            self.blocked.insert(place, (at, i));
        }
        // A cycle of causes does not occur in an undamaged run: the earliest record comes.
        if self.blocked.is_empty() {
            return false;
        }
        let (_, i) = self.blocked.remove(0);
        self.come(i);
        true
    }
}

impl Iterator for Join {
    type Item = Result<Record, Damage>;

    /// Returns the next record; an error is the last item.
    fn next(&mut self) -> Option<Result<Record, Damage>> {
        if self.over {
            return None;
        }
        while self.ready.is_empty() && self.damage.is_none() && self.advance() {}
        let next = self.ready.pop_front().map(Ok).or_else(|| self.damage.take().map(Err));
        self.over = !matches!(next, Some(Ok(_)));
        next
    }
}
