//! The controller loop: the thread that owns the world, the director and all links to agents. It carries
//! actions to bodies and percepts back, reports to the director and its commands to processes.
//!
//! One tick: events of the launcher, frames from agents, what is due in the world, the director, then
//! messages to agents; then it blocks until it is woken or a timer is due.

mod ending;
mod resuming;
mod space;
mod starting;

use crate::control::READ_EVERY;
use crate::swarm::SwarmOptions;
use crate::swarm::launcher::{Backend, Event, Launcher};
use crate::swarm::links::Links;
use crate::swarm::outcome::{Crash, SwarmError, SwarmOutcome};
use crate::swarm::pace::Pace;
use crate::swarm::process::{ControlMessage, Process, Stage};
use crate::swarm::reserve::Reserve;
use crate::swarm::run_dir::RunDir;
use crate::swarm::signals;
use metamorph_console::shutdown::Urgency;
use metamorph_module_agent::clock::lateness::Late;
use metamorph_module_agent::process::runtime_message::RuntimeMessage;
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_module_agent::transport::{AgentKey, ConnectError, Transport};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{HostId, Incarnation, ModuleId, Revision};
use metamorph_protocol::link::LinkChanges;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, Header};
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::world::World;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::time::Duration;

/// Number of frames taken in one tick before the world and the director have their turn.
const DRAIN: usize = 2_048;
/// Number of rounds of world and director in one tick.
const ROUNDS: usize = 64;
/// Longest time to wait for a message or an event while the swarm starts or ends.
const WAIT_MAX: Duration = Duration::from_secs(1);

/// The services that a controller runs over.
pub struct Services<'a, B: Backend> {
    /// The launcher of agents.
    pub launcher: B::Launcher,
    /// Its inbox.
    pub transport: B::Transport,
    /// The clock of the run.
    pub pace: Pace<B::Clock>,
    /// Shared memory held back.
    pub reserve: Reserve,
    /// The run's directory; `None` for a run that leaves nothing behind.
    pub dir: Option<&'a RunDir>,
}

type ProcessOf<W, B> = Process<<W as World>::Agent, <<B as Backend>::Transport as Transport>::Link>;

/// A host that was lost before the run began, and why, its agents, and the modules to be started elsewhere.
type LostEarly = ((HostId, String), Vec<AgentKey>, Vec<ModuleId>);

/// The controller of one run.
pub struct ControllerLoop<'a, W: World, D, B: Backend> {
    options: &'a SwarmOptions,
    dir: Option<&'a RunDir>,
    // Dropped in this order: all agents are ended, links are closed, then their transport.
    launcher: B::Launcher,
    processes: Vec<ProcessOf<W, B>>,
    transport: B::Transport,
    world: &'a mut W,
    director: &'a mut D,
    links: Links,
    /// Changes of the director to the links between modules.
    link_changes: LinkChanges,
    /// Processes with waiting messages, each once.
    unsent: Vec<usize>,
    outcome: SwarmOutcome,
    /// When the run was asked for.
    begun: u64,
    epoch: u64,
    pace: Pace<B::Clock>,
    last: Time,
    finishing: bool,
    /// True if agents are killed instead of asked to stop.
    hurried: bool,
    reserve: Reserve,
    /// Agents without an inbox, as neighbours have found, and when that was heard (ns of the monotonic clock).
    unreached: BTreeMap<AgentKey, u64>,
    /// When shared memory was last checked (ns of the monotonic clock).
    looked: u64,
    retry_at: Option<u64>,
    /// Agents that were killed from outside before the run began, the signals, and how they ended in words.
    killed_early: Vec<(AgentKey, i32, String)>,
    /// Hosts that were lost before the run began.
    lost_early: Vec<LostEarly>,
    /// Hosts that came back before the run began, and the modules that had none.
    back_early: Vec<(HostId, Vec<ModuleId>)>,
}

impl<'a, W: World, D: DirectorPort<W>, B: Backend> ControllerLoop<'a, W, D, B> {
    /// Creates a controller that has not started any agent. The run was asked for at `begun`.
    pub fn new(
        options: &'a SwarmOptions,
        services: Services<'a, B>,
        world: &'a mut W,
        director: &'a mut D,
        begun: u64,
    ) -> Self {
        let Services { launcher, transport, pace, reserve, dir } = services;
        ControllerLoop {
            options,
            dir,
            launcher,
            processes: (0..world.len() as u32).map(|id| Process::new(ModuleId(id))).collect(),
            transport,
            links: Links::of(world.len() as u64),
            link_changes: LinkChanges::default(),
            world,
            director,
            unsent: Vec::new(),
            outcome: SwarmOutcome::default(),
            begun,
            epoch: begun,
            pace,
            last: Time::ZERO,
            finishing: false,
            hurried: false,
            reserve,
            unreached: BTreeMap::new(),
            looked: begun,
            retry_at: None,
            killed_early: Vec::new(),
            lost_early: Vec::new(),
            back_early: Vec::new(),
        }
    }

    /// Runs the swarm from its start to its end.
    ///
    /// # Errors
    /// If the swarm cannot be started, or its services fail.
    pub fn run(mut self) -> Result<SwarmOutcome, SwarmError> {
        self.set_up()?;
        if !self.finishing {
            self.launcher.await_clocks()?;
            self.begin()?;
        }
        self.run_on()
    }

    fn run_on(mut self) -> Result<SwarmOutcome, SwarmError> {
        while !self.finishing {
            self.tick()?;
        }
        self.options.control.iter().for_each(|queue| queue.lock().close());
        self.stop()?;
        if let Some(account) = self.launcher.settle()? {
            self.outcome.count_hosts(account);
        }
        self.read_counters();
        Ok(self.outcome)
    }

    fn now(&mut self) -> Time {
        self.last = self.pace.now().max(self.last);
        self.last
    }

    fn tick(&mut self) -> Result<(), SwarmError> {
        self.take_events()?;
        self.take_commands();
        self.look_at_space();
        let drained = self.drain()?;
        if self.pace.is_due() {
            self.pace.stretch(self.launcher.longest_delay());
        }
        self.pace.renew().map_err(SwarmError::Clock)?;
        self.step_world();
        self.flush();
        if self.finishing || drained == DRAIN {
            return Ok(());
        }
        let due = self.world.next_event().min(self.director.wake_at());
        let mut wait = self.pace.until(due);
        if self.options.control.is_some() {
            wait = wait.min(READ_EVERY);
        }
        if let Some(retry_at) = self.retry_at {
            wait = wait.min(Duration::from_nanos(retry_at.saturating_sub(self.pace.monotonic())));
        }
        if !wait.is_zero() {
            self.transport.wait(wait)?;
            let now = self.now();
            if due < now {
                self.pace.late(Late { since: due, by: now.since(due) });
            }
        }
        Ok(())
    }

    /// Hands commands of operators to the director. They are in the journal before they are acknowledged.
    fn take_commands(&mut self) {
        let Some(queue) = &self.options.control else { return };
        let now = self.now();
        queue.lock().hand_in(now, |kind, bytes| {
            self.director.input(now, kind, bytes)?;
            self.director.commit();
            Ok(())
        });
    }

    fn wait_until(&mut self, deadline: u64) -> Result<(), SwarmError> {
        let left = Duration::from_nanos(deadline.saturating_sub(self.pace.monotonic()));
        Ok(self.transport.wait(left.min(WAIT_MAX))?)
    }

    fn take_events(&mut self) -> Result<(), SwarmError> {
        while let Some(event) = self.launcher.event()? {
            match event {
                Event::Shutdown(urgency) => self.interrupt(urgency),
                Event::SpawnFailed(agent, e) => {
                    self.ended(agent, format!("could not be started: {e}"), String::new(), true);
                }
                Event::Stopped(agent, signal) => {
                    self.external(agent, &Outside::Stopped { signal: signals::name(signal) });
                }
                Event::Continued(agent) => self.external(agent, &Outside::Continued),
                Event::HostLost { host, why, agents, restarts } => {
                    self.drain_all()?;
                    self.host_lost((host, why), &agents, restarts);
                }
                Event::HostBack(host, restarts) => self.host_back(host, restarts),
                Event::Exited { agent, how, signal, of_machine, stderr_tail } => {
                    // Frames that it sent before its end are taken before its end is handled.
                    self.drain_all()?;
                    let unasked = |p: &&Process<_, _>| !p.terminating;
                    let process = self.processes.get(agent.0.index()).filter(unasked);
                    let running = |p: &&Process<_, _>| p.verdict.is_none() && p.stage == Stage::Running;
                    let is_running = process.is_some_and(|p| running(&p));
                    let outside = process.filter(running).and(signal).filter(|_| !of_machine);
                    let outside = outside.filter(|signal| signals::is_from_outside(*signal));
                    let is_ours = process.is_some();
                    if let Some(signal) = outside {
                        self.killed(agent, signal, how);
                        continue;
                    }
                    if of_machine && is_running {
                        self.end_for_agent(agent.0, &how, &stderr_tail);
                    }
                    self.ended(agent, how, stderr_tail, is_ours);
                }
            }
        }
        Ok(())
    }

    /// Takes note that an agent of this run was killed from outside, and has ended.
    fn killed(&mut self, agent: AgentKey, signal: i32, how: String) {
        self.external(agent, &Outside::Killed { signal: signals::name(signal) });
        self.ended(agent, how, String::new(), false);
    }

    /// Takes note that a host is lost, and its agents with it.
    fn host_lost(&mut self, (host, why): (HostId, String), agents: &[AgentKey], restarts: Vec<ModuleId>) {
        let (how, modules) = (format!("was lost with {host}: {why}"), agents.len() as u32);
        let mut first = None;
        for (id, incarnation) in agents {
            let process = self.processes.get_mut(id.index());
            let runs = |p: &&mut Process<_, _>| {
                p.incarnation == *incarnation && matches!(p.stage, Stage::Running | Stage::Lost)
            };
            if let Some(process) = process.filter(runs) {
                // Also an agent that has not answered the controller that took over.
                process.stage = Stage::Running;
                first.get_or_insert((*id, *incarnation));
            }
        }
        if let Some(first) = first {
            self.external(first, &Outside::HostLost { host, modules, restarts, why });
        }
        agents.iter().for_each(|agent| self.ended(*agent, how.clone(), String::new(), false));
    }

    /// Takes note that a host takes modules again.
    fn host_back(&mut self, host: HostId, restarts: Vec<ModuleId>) {
        let (now, first) = (self.now(), restarts.first().copied());
        let what = Outside::HostBack { host, restarts };
        tracing::warn!("a host is back: {what}");
        self.outcome.external += 1;
        self.world.advance(now);
        self.director.external(now, first.unwrap_or(ModuleId(0)), &what, self.world);
        self.execute(now);
    }

    /// Reports an intervention in a process from outside this run.
    fn external(&mut self, (id, incarnation): AgentKey, what: &Outside) {
        let now = self.now();
        let current = |p: &&mut Process<_, _>| p.incarnation == incarnation && p.stage == Stage::Running;
        let Some(process) = self.processes.get_mut(id.index()).filter(current) else { return };
        match what {
            Outside::HostLost { .. } => tracing::warn!("a host is lost: {what}"),
            what => tracing::warn!("module {id} {what}"),
        }
        process.halted = matches!(what, Outside::Stopped { .. });
        process.resumed_at = now;
        process.hurry();
        self.outcome.external += 1;
        self.world.advance(now);
        self.director.external(now, id, what, self.world);
        self.execute(now);
    }

    fn interrupt(&mut self, urgency: Urgency) {
        self.outcome.interrupted = true;
        self.finishing = true;
        self.hurried = urgency == Urgency::Hurried;
    }

    fn ended(&mut self, (id, incarnation): AgentKey, how: String, stderr_tail: String, crashed: bool) {
        let now = self.now();
        let verdict = self.processes.get(id.index()).and_then(|p| p.verdict);
        let how = verdict.map_or(how, str::to_owned);
        if crashed {
            tracing::warn!("module {id} {how}");
            self.looked = 0;
            self.outcome.crashes.push(Crash { id, incarnation, at: now, how, stderr_tail });
        }
        let Some(process) = self.processes.get_mut(id.index()) else { return };
        process.end();
        self.launcher.reap((id, incarnation));
        let restart = std::mem::take(&mut process.restart);
        self.director.died(now, id);
        self.execute(now);
        if restart && !self.finishing {
            self.relaunch(id.index());
        }
    }

    fn relaunch(&mut self, i: usize) {
        let Some(next) = self.processes[i].incarnation.0.checked_add(1) else {
            tracing::error!("module {i} cannot be started again: it has had all its incarnations");
            return;
        };
        self.outcome.restarted += 1;
        self.launch(i, Incarnation(next));
    }

    /// Takes all frames that wait.
    fn drain_all(&mut self) -> Result<(), SwarmError> {
        for _ in 0..self.processes.len().max(64) {
            if self.drain()? < DRAIN {
                break;
            }
        }
        Ok(())
    }

    fn drain(&mut self) -> Result<usize, SwarmError> {
        for taken in 0..DRAIN {
            let Some(shared) = self.transport.receive()? else { return Ok(taken) };
            if !self.accept(&shared) {
                self.outcome.foreign += 1;
            }
        }
        Ok(DRAIN)
    }

    /// Takes one frame. Returns false if no member of the run can have sent it.
    fn accept(&mut self, shared: &SharedFrame) -> bool {
        let frame = &shared.frame();
        let Ok(header) = frame.open() else { return false };
        let i = header.source.index();
        let Some(process) = self.processes.get_mut(i) else { return false };
        // The first frame of a lost agent shows its sequence number.
        let in_sequence = header.sequence == process.expected || process.stage == Stage::Lost;
        let theirs = header.destination == CONTROLLER
            && header.incarnation == process.incarnation
            && in_sequence
            && process.stage != Stage::Absent;
        if !theirs {
            return false;
        }
        let next = header.sequence.wrapping_add(1);
        let understood = match header.channel {
            Channel::Runtime => self.hear_runtime(header, frame),
            _ if self.processes[i].stage == Stage::Lost => false,
            Channel::Body => self.act(header, frame),
            Channel::Control => self.report(header, frame),
            Channel::Peer => false,
        };
        if understood {
            self.processes[i].expected = next;
            let now = self.now();
            self.judge(i, Late { since: shared.sent(), by: now.since(shared.sent()) });
        }
        understood
    }

    fn hear_runtime(&mut self, header: Header, frame: &Frame) -> bool {
        match frame.message::<RuntimeMessage<<W::Agent as Agent>::Place>>() {
            Ok(RuntimeMessage::Hello { .. }) => self.hear_hello(header.source.index()),
            Ok(RuntimeMessage::Here { told, expected }) => self.hear_here(header, told, expected),
            Ok(RuntimeMessage::Consumed { expected })
                if self.processes[header.source.index()].stage == Stage::Running =>
            {
                self.processes[header.source.index()].has_taken(expected);
                true
            }
            Ok(RuntimeMessage::Late(late)) => {
                self.judge(header.source.index(), late);
                true
            }
            Ok(RuntimeMessage::Unreached { peer, incarnation }) => {
                let now = self.pace.monotonic();
                self.unreached.entry((peer, incarnation)).or_insert(now);
                true
            }
            _ => false,
        }
    }

    /// Notes lateness of a process, or of a frame it sent. The time for which it was stopped does not count.
    fn judge(&mut self, i: usize, late: Late) {
        let process = &self.processes[i];
        let stopped = process.resumed_at.since(late.since);
        if process.stage == Stage::Running && !process.paused {
            self.pace.late(Late { since: late.since + stopped, by: late.by - stopped });
        }
    }

    fn hear_hello(&mut self, i: usize) -> bool {
        if self.processes[i].stage != Stage::Starting {
            return false;
        }
        self.processes[i].stage = Stage::Up;
        if self.processes[i].incarnation > Incarnation(0) {
            self.rejoin(i);
        }
        true
    }

    fn act(&mut self, header: Header, frame: &Frame) -> bool {
        let Ok(action) = frame.message::<<W::Agent as Agent>::Action>() else { return false };
        self.outcome.body_messages += 1;
        let now = self.now();
        self.world.advance(now);
        self.world.act(now, header.source, Revision(header.session), &action);
        true
    }

    fn report(&mut self, header: Header, frame: &Frame) -> bool {
        let Ok(report) = frame.message::<<W::Agent as Agent>::Report>() else { return false };
        self.outcome.control_messages += 1;
        let now = self.now();
        self.world.advance(now);
        self.director.report(now, header.source, report);
        self.execute(now);
        true
    }

    /// Runs the world and the director for everything that is due.
    fn step_world(&mut self) {
        for _ in 0..ROUNDS {
            let now = self.now();
            self.world.advance(now);
            let moved = self.forward_sensed();
            if !moved && self.director.wake_at() > now {
                break;
            }
            self.director.wake(now, self.world);
            self.execute(now);
            if self.finishing {
                break;
            }
        }
    }

    /// Passes on what bodies sensed. Returns true if there was anything.
    fn forward_sensed(&mut self) -> bool {
        let mut any = false;
        while let Some((id, sensed)) = self.world.poll() {
            any = true;
            let message = match sensed {
                Sensed::Percept(percept) => ControlMessage::Percept(percept),
                Sensed::Contact { port, revision, contact } => {
                    ControlMessage::Runtime(RuntimeMessage::Contact { port, revision, contact })
                }
            };
            // A dead process senses nothing; a new one gets all contacts when it starts.
            let hears = |p: &Process<_, _>| matches!(p.stage, Stage::Running | Stage::Lost);
            if self.processes.get(id.index()).is_some_and(hears) {
                self.outcome.body_messages += 1;
                self.tell(id.index(), message);
            }
        }
        any
    }

    fn tell(&mut self, i: usize, message: ControlMessage<W::Agent>) {
        let process = &mut self.processes[i];
        if process.terminating {
            return;
        }
        if process.tell(message) {
            return self.list(i);
        }
        self.give_up(i, "did not take its messages for too long, and was killed");
    }

    /// Changes what the links between modules do, in every agent.
    fn change_links(&mut self, changes: LinkChanges) {
        self.link_changes = changes;
        for i in 0..self.processes.len() {
            if matches!(self.processes[i].stage, Stage::Running | Stage::Lost) {
                self.tell(i, ControlMessage::Runtime(RuntimeMessage::Links(changes)));
            }
        }
    }

    /// Kills a process that cannot continue; its end is reported as a crash with this reason.
    fn give_up(&mut self, i: usize, why: &'static str) {
        let process = &mut self.processes[i];
        if process.verdict.is_none() {
            tracing::error!("module {i} {why}");
            process.verdict = Some(why);
            let agent = process.key();
            self.launcher.signal(agent, Signal::KILL);
        }
    }

    /// Adds a process to the list of those with waiting messages.
    fn list(&mut self, i: usize) {
        if !std::mem::replace(&mut self.processes[i].listed, true) {
            self.unsent.push(i);
        }
    }

    /// Sends to all agents as many messages as they take now.
    fn flush(&mut self) {
        self.director.commit();
        self.retry_at = None;
        let (now, time) = (self.pace.monotonic(), self.now());
        for i in std::mem::take(&mut self.unsent) {
            self.processes[i].listed = false;
            if self.processes[i].needs_link() && !self.connect(i) {
                // Tried again when another link is closed, for which its agent wakes this thread.
                self.list(i);
            } else if let Some(at) = self.processes[i].flush(now, time) {
                self.retry_at = Some(self.retry_at.map_or(at, |earliest| earliest.min(at)));
                self.list(i);
            }
        }
        let too_many = self.links.too_many(self.processes.len());
        if too_many > 0 {
            let idle = |(i, p): (usize, &Process<_, _>)| p.idle_since().map(|since| (since, i));
            let mut idle: Vec<(u64, usize)> = self.processes.iter().enumerate().filter_map(idle).collect();
            idle.sort_unstable();
            idle.into_iter().take(too_many).for_each(|(_, i)| self.processes[i].leave(time));
        }
    }

    /// Opens the link to an agent. Returns false if there is no room for one more.
    fn connect(&mut self, i: usize) -> bool {
        if !self.links.has_room() {
            return false;
        }
        let process = &mut self.processes[i];
        match self.links.open_to(&mut self.transport, process.key()) {
            Ok(link) => process.connect(link),
            // It has just died, and its end will be reported soon.
            Err(ConnectError::Unreachable(e)) => tracing::debug!("module {i} cannot be reached: {e}"),
            Err(ConnectError::OutOfSpace(shortage)) => {
                self.run_short(shortage);
                return false;
            }
            Err(ConnectError::NoSlot(e)) => {
                tracing::debug!("module {i} cannot be reached yet: {e}");
                return false;
            }
            Err(e) => {
                self.hurried = true;
                let lacks = "the controller may lack memory (ulimit -v) or file descriptors (ulimit -n)";
                self.end_early(format!("the controller cannot reach module {i}: {e}; {lacks}"));
                return false;
            }
        }
        true
    }

    /// Carries out the commands of the director.
    fn execute(&mut self, now: Time) {
        while let Some(command) = self.director.poll() {
            tracing::debug!(%now, ?command);
            let id = match &command {
                Command::Finish => {
                    self.finishing = true;
                    continue;
                }
                Command::Links(changes) => {
                    self.change_links(*changes);
                    continue;
                }
                Command::Host(host, change) => {
                    self.launcher.change_host(*host, *change);
                    continue;
                }
                Command::Kill(id) | Command::Pause(id) | Command::Resume(id) => *id,
                Command::Restart(id) | Command::Order(id, _) => *id,
            };
            let Some(process) = self.processes.get_mut(id.index()) else {
                tracing::error!("there is no module {id} for {command:?}");
                continue;
            };
            let agent = process.key();
            let alive = process.stage != Stage::Absent;
            if !matches!(command, Command::Order(..)) {
                self.director.commit();
            }
            match command {
                Command::Kill(_) if alive && !process.terminating => {
                    process.terminating = true;
                    self.outcome.killed += 1;
                    self.launcher.signal(agent, Signal::KILL);
                }
                Command::Pause(_) if alive => {
                    process.paused = true;
                    self.launcher.signal(agent, Signal::STOP);
                }
                Command::Resume(_) if alive => {
                    (process.paused, process.halted) = (false, false);
                    process.resumed_at = now;
                    process.hurry();
                    self.launcher.signal(agent, Signal::CONT);
                }
                Command::Restart(_) if !alive => self.relaunch(id.index()),
                Command::Restart(_) if process.terminating => process.restart = true,
                Command::Restart(_) => tracing::warn!("module {id} is alive and is not started again"),
                Command::Order(_, order) if matches!(process.stage, Stage::Running | Stage::Lost) => {
                    self.outcome.control_messages += 1;
                    self.tell(id.index(), ControlMessage::Order(order));
                }
                // The process is dead, so there is nothing to do.
                _ => {}
            }
        }
    }
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
