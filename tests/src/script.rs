//! A director that carries out a script: do this, wait until that has been seen. It never waits for
//! a time to pass when there is something to see, and gives up at a deadline with what it waited for.

use crate::probe::{ProbeOrder, ProbeReport, ProbeWorld};
use metamorph_protocol::ids::{ModuleId, Port, Session};
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::port::DirectorPort;
use std::collections::VecDeque;

/// What was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// A process is up.
    Started(ModuleId),
    /// A process is gone.
    Died(ModuleId),
    /// An agent reported.
    Report(ModuleId, ProbeReport),
}

/// All that was seen, in order.
#[derive(Clone, Debug, Default)]
pub struct Log(pub Vec<(Time, Seen)>);

impl Log {
    /// Returns how often exactly this was seen.
    pub fn count(&self, seen: Seen) -> usize {
        self.0.iter().filter(|(_, s)| *s == seen).count()
    }
    /// Whether this was reported by this module.
    pub fn has(&self, id: ModuleId, report: ProbeReport) -> bool {
        self.count(Seen::Report(id, report)) > 0
    }
    /// The numbers that a module got by a port, in order.
    pub fn got(&self, id: ModuleId, port: Port) -> Vec<u32> {
        let number = |seen: &Seen| match seen {
            Seen::Report(i, ProbeReport::Got { port: p, number }) if (*i, *p) == (id, port) => Some(*number),
            _ => None,
        };
        self.0.iter().filter_map(|(_, seen)| number(seen)).collect()
    }
    /// The number of messages that all modules got.
    pub fn all_got(&self) -> usize {
        self.0.iter().filter(|(_, s)| matches!(s, Seen::Report(_, ProbeReport::Got { .. }))).count()
    }
    /// The sessions that a module knew on a port, in order; none for no contact.
    pub fn sessions(&self, id: ModuleId, port: Port) -> Vec<Option<Session>> {
        let session = |seen: &Seen| match seen {
            Seen::Report(i, ProbeReport::Contact { port: p, session }) if (*i, *p) == (id, port) => {
                Some(*session)
            }
            _ => None,
        };
        self.0.iter().filter_map(|(_, seen)| session(seen)).collect()
    }
}

type Condition = Box<dyn Fn(&Log) -> bool>;
type Act = Box<dyn FnMut(&mut ProbeWorld)>;

enum Step {
    Command(Command<ProbeOrder>),
    World(Act),
    Until(&'static str, Condition),
    Pass(Span),
    Passed(Time),
}

/// The director.
pub struct Script {
    steps: VecDeque<Step>,
    commands: VecDeque<Command<ProbeOrder>>,
    deadline: Time,
    pings: u32,
    finished: bool,
    /// All that was seen.
    pub log: Log,
    /// What it still waited for at the deadline.
    pub gave_up: Option<&'static str>,
}

impl Script {
    /// Creates an empty script that first waits for `count` modules to start, and gives up after a minute.
    pub fn new(count: u32) -> Script {
        let script = Script {
            steps: VecDeque::new(),
            commands: VecDeque::new(),
            deadline: Time::ZERO + Span::secs(60),
            pings: 0,
            finished: false,
            log: Log::default(),
            gave_up: None,
        };
        script.until("all modules to start", move |log| {
            let started = |seen: &Seen| matches!(seen, Seen::Started(_));
            log.0.iter().filter(|(_, seen)| started(seen)).count() >= count as usize
        })
    }

    /// Sets another deadline, counted from the start of the run.
    pub fn deadline(mut self, after: Span) -> Script {
        self.deadline = Time::ZERO + after;
        self
    }
    /// Gives a command.
    pub fn command(mut self, command: Command<ProbeOrder>) -> Script {
        self.steps.push_back(Step::Command(command));
        self
    }
    /// Gives an order.
    pub fn order(self, id: u32, order: ProbeOrder) -> Script {
        self.command(Command::Order(ModuleId(id), order))
    }
    /// Orders a module to send `count` numbers from `first` on.
    pub fn send(self, id: u32, port: u8, first: u32, count: u32) -> Script {
        self.order(id, ProbeOrder::Send { port: Port(port), first, count })
    }
    /// Waits until a module has handled all orders so far and what its driver had received before.
    pub fn settle(mut self, id: u32) -> Script {
        self.pings += 1;
        let token = self.pings;
        self.order(id, ProbeOrder::Ping(token))
            .until("the answer to a ping", move |log| log.has(ModuleId(id), ProbeReport::Pong(token)))
    }
    /// Changes the world.
    pub fn world(mut self, act: impl FnMut(&mut ProbeWorld) + 'static) -> Script {
        self.steps.push_back(Step::World(Box::new(act)));
        self
    }
    /// Joins two ports and waits until both modules know.
    pub fn join(self, a: (u32, u8), b: (u32, u8)) -> Script {
        let [a, b] = [a, b].map(|(id, port)| (ModuleId(id), Port(port)));
        self.world(move |world| world.join(a, b)).until("a new contact", move |log| {
            let last = |(id, port)| log.sessions(id, port).last().copied().flatten();
            last(a).is_some() && last(a) == last(b)
        })
    }
    /// Separates a port, and waits until both modules know.
    pub fn part(self, a: (u32, u8), b: (u32, u8)) -> Script {
        let [a, b] = [a, b].map(|(id, port)| (ModuleId(id), Port(port)));
        self.world(move |world| world.part(a)).until("the end of a contact", move |log| {
            [a, b].iter().all(|&(id, port)| log.sessions(id, port).last() == Some(&None))
        })
    }
    /// Waits for something to be seen.
    pub fn until(mut self, what: &'static str, condition: impl Fn(&Log) -> bool + 'static) -> Script {
        self.steps.push_back(Step::Until(what, Box::new(condition)));
        self
    }
    /// Waits until a module has got `count` messages by a port.
    pub fn until_got(self, id: u32, port: u8, count: usize) -> Script {
        self.until("messages to arrive", move |log| log.got(ModuleId(id), Port(port)).len() >= count)
    }
    /// Waits until a module's process has died `times` times.
    pub fn until_died(self, id: u32, times: usize) -> Script {
        self.until("a process to die", move |log| log.count(Seen::Died(ModuleId(id))) >= times)
    }
    /// Waits until a module's process has started `times` times.
    pub fn until_started(self, id: u32, times: usize) -> Script {
        self.until("a process to start", move |log| log.count(Seen::Started(ModuleId(id))) >= times)
    }
    /// Lets time pass, where the point is that nothing is to be seen.
    pub fn pass(mut self, span: Span) -> Script {
        self.steps.push_back(Step::Pass(span));
        self
    }

    fn ready(&self) -> bool {
        match self.steps.front() {
            None => !self.finished,
            Some(Step::Until(_, condition)) => condition(&self.log),
            Some(Step::Passed(_)) => false,
            Some(Step::Command(_) | Step::World(_) | Step::Pass(_)) => true,
        }
    }

    fn see(&mut self, now: Time, seen: Seen) {
        self.log.0.push((now, seen));
    }
}

impl DirectorPort<ProbeWorld> for Script {
    fn report(&mut self, now: Time, id: ModuleId, report: ProbeReport) {
        self.see(now, Seen::Report(id, report));
    }
    fn died(&mut self, now: Time, id: ModuleId) {
        self.see(now, Seen::Died(id));
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        self.see(now, Seen::Started(id));
    }

    fn wake(&mut self, now: Time, world: &mut ProbeWorld) {
        loop {
            if matches!(self.steps.front(), Some(Step::Passed(at)) if *at <= now) {
                self.steps.pop_front();
            }
            if !self.ready() {
                break;
            }
            match self.steps.pop_front() {
                Some(Step::Command(command)) => self.commands.push_back(command),
                Some(Step::World(mut act)) => act(world),
                Some(Step::Pass(span)) => self.steps.push_front(Step::Passed(now + span)),
                Some(Step::Until(..) | Step::Passed(_)) => {}
                None => {
                    self.finished = true;
                    self.commands.push_back(Command::Finish);
                }
            }
        }
        if now >= self.deadline && !self.finished {
            self.gave_up = Some(match self.steps.front() {
                Some(Step::Until(what, _)) => what,
                _ => "time to pass",
            });
            self.finished = true;
            self.commands.push_back(Command::Finish);
        }
    }

    fn wake_at(&self) -> Time {
        if self.finished {
            Time::NEVER
        } else if self.ready() {
            Time::ZERO
        } else if let Some(Step::Passed(at)) = self.steps.front() {
            (*at).min(self.deadline)
        } else {
            self.deadline
        }
    }

    fn poll(&mut self) -> Option<Command<ProbeOrder>> {
        self.commands.pop_front()
    }
}
