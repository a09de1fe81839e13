//! The conductor: the thread that owns the world, the director and all channels. It carries
//! actions to bodies and percepts back, reports to the director and its commands to processes.
//!
//! One turn: what the supervisor saw, what agents sent, what is due in the world, the director,
//! then everything that must be told; then it blocks until something rings or is due.

use crate::swarm::SwarmOptions;
use crate::swarm::agents::{Letter, Process, Stage};
use crate::swarm::outcome::{Crash, SwarmError, SwarmOutcome};
use crate::swarm::run_dir::RunDir;
use crate::swarm::supervise::{Event, Life, Supervisor, Task};
use metamorph_module_agent::clock::{Clock, monotonic};
use metamorph_module_agent::inbox::Inbox;
use metamorph_module_agent::ledger::Ledger;
use metamorph_module_agent::outbox::Outbox;
use metamorph_module_agent::rendezvous::Rendezvous;
use metamorph_module_agent::runtime::{Contact, Runtime};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId, Revision};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, Header};
use metamorph_sim_bridge::direct::{Command, Direct};
use metamorph_sim_bridge::world::{Sensed, World};
use rustix::process::Signal;
use std::time::Duration;

/// Processes that start at the same time; more would only compete.
const STARTING: usize = 32;
/// Frames taken in one turn before the world and the director get theirs.
const DRAIN: usize = 2_048;
/// Rounds of world and director in one turn.
const ROUNDS: usize = 64;
/// The longest wait.
const LONGEST_WAIT: Duration = Duration::from_secs(1);

pub struct Conductor<'a, W: World, D> {
    options: &'a SwarmOptions,
    dir: &'a RunDir,
    at: &'a Rendezvous,
    inbox: Inbox,
    supervisor: Supervisor,
    world: &'a mut W,
    director: &'a mut D,
    processes: Vec<Process<W::Agent>>,
    outcome: SwarmOutcome,
    /// When the run was asked for.
    begun: u64,
    epoch: u64,
    clock: Clock,
    last: Time,
    finishing: bool,
    retry_at: Option<u64>,
}

impl<'a, W: World, D: Direct<W>> Conductor<'a, W, D> {
    #[allow(clippy::too_many_arguments, reason = "the one caller hands over all it has set up")]
    pub fn new(
        options: &'a SwarmOptions,
        dir: &'a RunDir,
        at: &'a Rendezvous,
        inbox: Inbox,
        supervisor: Supervisor,
        world: &'a mut W,
        director: &'a mut D,
        begun: u64,
    ) -> Self {
        let processes = (0..world.len() as u32).map(|id| Process::new(ModuleId(id))).collect();
        Conductor {
            options,
            dir,
            at,
            inbox,
            supervisor,
            world,
            director,
            processes,
            outcome: SwarmOutcome::default(),
            begun,
            epoch: begun,
            clock: Clock::new(u64::MAX, options.speed),
            last: Time::ZERO,
            finishing: false,
            retry_at: None,
        }
    }

    pub fn run(mut self) -> Result<SwarmOutcome, SwarmError> {
        self.set_up()?;
        if !self.finishing {
            self.begin();
        }
        while !self.finishing {
            self.turn()?;
        }
        self.stop()?;
        self.read_ledgers();
        Ok(self.outcome)
    }

    fn now(&mut self) -> Time {
        self.last = self.clock.now().max(self.last);
        self.last
    }

    // Starting.

    fn set_up(&mut self) -> Result<(), SwarmError> {
        let deadline = self.begun + nanos(self.options.setup_timeout);
        let count = self.processes.len();
        let (mut next, mut up) = (0, 0);
        while up < count && !self.finishing {
            while next < count && next - up < STARTING {
                self.launch(next, Incarnation(0));
                self.outcome.launched += 1;
                next += 1;
            }
            self.wait_until(deadline)?;
            while let Some(event) = self.supervisor.event() {
                match event {
                    Event::SpawnFailed(life, e) => return Err(self.spawn_error(life, e.to_string())),
                    Event::Exited { life, how, stderr_tail } => {
                        return Err(SwarmError::DiedEarly { id: life.0, how, stderr_tail });
                    }
                    Event::Shutdown => self.interrupt(),
                }
            }
            self.drain()?;
            up = self.processes.iter().filter(|p| p.stage == Stage::Up).count();
            if up < count && monotonic() >= deadline {
                let seconds = self.options.setup_timeout.as_secs();
                return Err(SwarmError::SetupTimeout { missing: count - up, count, seconds });
            }
        }
        // The ways to all agents, so that the first orders do not wait for them.
        for i in 0..self.processes.len() {
            if self.processes[i].stage == Stage::Up {
                self.connect(i)?;
            }
        }
        Ok(())
    }

    fn launch(&mut self, i: usize, incarnation: Incarnation) {
        self.processes[i].launch(incarnation);
        self.supervisor.ask(Task::Spawn((self.processes[i].id, incarnation)));
    }

    fn connect(&mut self, i: usize) -> Result<(), SwarmError> {
        let process = &mut self.processes[i];
        let outbox = Outbox::to_agent(self.at, process.id, process.incarnation)?;
        process.connect(outbox);
        Ok(())
    }

    fn spawn_error(&self, (id, _): Life, cause: String) -> SwarmError {
        SwarmError::Spawn { id, program: self.options.program.clone(), cause }
    }

    /// The clock starts; every agent gets its place, then its contacts.
    fn begin(&mut self) {
        self.epoch = monotonic();
        self.outcome.setup = Duration::from_nanos(self.epoch - self.begun);
        self.clock = Clock::new(self.epoch, self.options.speed);
        for i in 0..self.processes.len() {
            let id = self.processes[i].id;
            self.world.start(Time::ZERO, id, Incarnation(0));
        }
        for i in 0..self.processes.len() {
            self.send_begin(i);
        }
        self.forward_sensed();
        for i in 0..self.processes.len() {
            let id = self.processes[i].id;
            self.director.started(Time::ZERO, id);
            self.obey(Time::ZERO);
        }
        self.flush();
    }

    fn send_begin(&mut self, i: usize) {
        let place = self.world.place(self.processes[i].id);
        self.processes[i].stage = Stage::Running;
        self.tell(i, Letter::Runtime(Runtime::Begin { epoch: self.epoch, place }));
    }

    /// A restarted process is up.
    fn rejoin(&mut self, i: usize) {
        if let Err(e) = self.connect(i) {
            tracing::error!("cannot reach restarted module {i}: {e}");
            return self.give_up(i, "could not be reached after its restart, and was killed");
        }
        let (id, incarnation) = (self.processes[i].id, self.processes[i].incarnation);
        let now = self.now();
        self.world.advance(now);
        // What was sensed up to here was meant for the life before.
        self.forward_sensed();
        self.send_begin(i);
        self.world.start(now, id, incarnation);
        self.forward_sensed();
        self.director.started(now, id);
        self.obey(now);
    }

    // Running.

    fn turn(&mut self) -> Result<(), SwarmError> {
        self.take_events()?;
        let drained = self.drain()?;
        self.play();
        self.flush();
        if self.finishing || drained == DRAIN {
            return Ok(());
        }
        let due = self.world.next_event().min(self.director.wake_at());
        let mut wait =
            if due == Time::NEVER { LONGEST_WAIT } else { self.clock.until(due).min(LONGEST_WAIT) };
        if let Some(retry_at) = self.retry_at {
            wait = wait.min(Duration::from_nanos(retry_at.saturating_sub(monotonic())));
        }
        if !wait.is_zero() {
            self.inbox.wait(wait)?;
        }
        Ok(())
    }

    fn wait_until(&mut self, deadline: u64) -> Result<(), SwarmError> {
        let left = Duration::from_nanos(deadline.saturating_sub(monotonic()));
        Ok(self.inbox.wait(left.min(LONGEST_WAIT))?)
    }

    fn take_events(&mut self) -> Result<(), SwarmError> {
        while let Some(event) = self.supervisor.event() {
            match event {
                Event::Shutdown => self.interrupt(),
                Event::SpawnFailed(life, e) => {
                    self.buried(life, format!("could not be started: {e}"), String::new(), true);
                }
                Event::Exited { life, how, stderr_tail } => {
                    // What it had sent before its end is heard before its end is.
                    for _ in 0..self.processes.len().max(64) {
                        if self.drain()? < DRAIN {
                            break;
                        }
                    }
                    let i = life.0.index();
                    let crashed = self.processes.get(i).is_some_and(|p| !p.condemned);
                    self.buried(life, how, stderr_tail, crashed);
                }
            }
        }
        if self.supervisor.is_gone() {
            return Err(SwarmError::Supervisor(std::io::Error::other("its thread ended")));
        }
        Ok(())
    }

    fn interrupt(&mut self) {
        self.outcome.interrupted = true;
        self.finishing = true;
    }

    fn buried(&mut self, (id, incarnation): Life, how: String, stderr_tail: String, crashed: bool) {
        let now = self.now();
        let verdict = self.processes.get(id.index()).and_then(|p| p.verdict);
        let how = verdict.map_or(how, str::to_owned);
        if crashed {
            tracing::warn!("module {id} {how}");
            self.outcome.crashes.push(Crash { id, incarnation, at: now, how, stderr_tail });
        }
        let Some(process) = self.processes.get_mut(id.index()) else { return };
        process.bury();
        let restart = std::mem::take(&mut process.restart);
        self.director.died(now, id);
        self.obey(now);
        if restart && !self.finishing {
            self.relaunch(id.index());
        }
    }

    fn relaunch(&mut self, i: usize) {
        let Some(next) = self.processes[i].incarnation.0.checked_add(1) else {
            tracing::error!("module {i} cannot be started again: it has had all its lives");
            return;
        };
        self.outcome.restarted += 1;
        self.launch(i, Incarnation(next));
    }

    fn drain(&mut self) -> Result<usize, SwarmError> {
        for taken in 0..DRAIN {
            let Some(frame) = self.inbox.receive()? else { return Ok(taken) };
            if !self.accept(&frame) {
                self.outcome.foreign += 1;
            }
        }
        Ok(DRAIN)
    }

    /// Takes one frame; false if no member of the run can have sent it.
    fn accept(&mut self, frame: &Frame) -> bool {
        let Ok(header) = frame.open() else { return false };
        let i = header.source.index();
        let Some(process) = self.processes.get_mut(i) else { return false };
        let theirs = header.destination == CONTROLLER
            && header.incarnation == process.incarnation
            && header.sequence == process.expected
            && process.stage != Stage::Absent;
        if !theirs {
            return false;
        }
        let next = header.sequence.wrapping_add(1);
        let understood = match header.channel {
            Channel::Runtime => self.hear_hello(i, frame),
            Channel::Body => self.act(header, frame),
            Channel::Control => self.report(header, frame),
            Channel::Peer => false,
        };
        if understood {
            self.processes[i].expected = next;
        }
        understood
    }

    fn hear_hello(&mut self, i: usize, frame: &Frame) -> bool {
        let hello = frame.message::<Runtime<<W::Agent as Agent>::Place>>();
        if !matches!(hello, Ok(Runtime::Hello { .. })) || self.processes[i].stage != Stage::Starting {
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
        self.obey(now);
        true
    }

    /// Lets the world and the director do what is due.
    fn play(&mut self) {
        for _ in 0..ROUNDS {
            let now = self.now();
            self.world.advance(now);
            let moved = self.forward_sensed();
            if !moved && self.director.wake_at() > now {
                break;
            }
            self.director.wake(now, self.world);
            self.obey(now);
            if self.finishing {
                break;
            }
        }
    }

    /// Passes on what bodies sensed; whether there was anything.
    fn forward_sensed(&mut self) -> bool {
        let mut any = false;
        while let Some((id, sensed)) = self.world.poll() {
            any = true;
            let letter = match sensed {
                Sensed::Percept(percept) => Letter::Percept(percept),
                Sensed::Contact { port, revision, contact } => Letter::Runtime(Runtime::Contact {
                    port,
                    revision,
                    contact: contact.map(|c| Contact {
                        session: c.session,
                        peer: c.peer,
                        peer_incarnation: c.peer_incarnation,
                        peer_port: c.peer_port,
                    }),
                }),
            };
            // A dead process senses nothing; a new one is told everything when it starts.
            if self.processes.get(id.index()).is_some_and(|p| p.stage == Stage::Running) {
                self.outcome.body_messages += 1;
                self.tell(id.index(), letter);
            }
        }
        any
    }

    fn tell(&mut self, i: usize, letter: Letter<W::Agent>) {
        let process = &mut self.processes[i];
        if process.condemned || process.tell(letter) {
            return;
        }
        self.give_up(i, "did not take its messages for too long, and was killed");
    }

    /// Kills a process that cannot go on; its end is reported as a crash with this reason.
    fn give_up(&mut self, i: usize, why: &'static str) {
        let process = &mut self.processes[i];
        if process.verdict.is_none() {
            tracing::error!("module {i} {why}");
            process.verdict = Some(why);
            let life = (process.id, process.incarnation);
            self.supervisor.ask(Task::Signal(life, Signal::KILL));
        }
    }

    fn flush(&mut self) {
        self.retry_at = self.processes.iter_mut().filter_map(Process::flush).min();
    }

    /// Carries out what the director wants.
    fn obey(&mut self, now: Time) {
        while let Some(command) = self.director.poll() {
            tracing::debug!(%now, ?command);
            let id = match &command {
                Command::Finish => {
                    self.finishing = true;
                    continue;
                }
                Command::Kill(id) | Command::Pause(id) | Command::Resume(id) => *id,
                Command::Restart(id) | Command::Order(id, _) => *id,
            };
            let Some(process) = self.processes.get_mut(id.index()) else {
                tracing::error!("there is no module {id} for {command:?}");
                continue;
            };
            let life = (id, process.incarnation);
            let alive = process.stage != Stage::Absent;
            match command {
                Command::Kill(_) if alive && !process.condemned => {
                    process.condemned = true;
                    self.outcome.killed += 1;
                    self.supervisor.ask(Task::Signal(life, Signal::KILL));
                }
                Command::Pause(_) if alive => {
                    process.paused = true;
                    self.supervisor.ask(Task::Signal(life, Signal::STOP));
                }
                Command::Resume(_) if alive => {
                    process.paused = false;
                    process.hurry();
                    self.supervisor.ask(Task::Signal(life, Signal::CONT));
                }
                Command::Restart(_) if !alive => self.relaunch(id.index()),
                Command::Restart(_) if process.condemned => process.restart = true,
                Command::Restart(_) => tracing::warn!("module {id} lives and is not started again"),
                Command::Order(_, order) if process.stage == Stage::Running => {
                    self.outcome.control_messages += 1;
                    self.tell(id.index(), Letter::Order(order));
                }
                // The process is dead: there is nobody to do it to.
                _ => {}
            }
        }
    }

    // Ending.

    fn stop(&mut self) -> Result<(), SwarmError> {
        self.outcome.end = self.now();
        self.outcome.wall = Duration::from_nanos(monotonic().saturating_sub(self.epoch));
        let alive = |p: &&Process<W::Agent>| p.stage == Stage::Running && !p.condemned;
        self.outcome.alive = self.processes.iter().filter(alive).count() as u32;
        for i in 0..self.processes.len() {
            let process = &mut self.processes[i];
            let life = (process.id, process.incarnation);
            match process.stage {
                Stage::Absent => continue,
                _ if !process.is_connected() => {
                    // Not up yet, so it cannot be told.
                    process.condemned = true;
                    self.supervisor.ask(Task::Signal(life, Signal::KILL));
                }
                _ => {
                    if process.paused {
                        self.supervisor.ask(Task::Signal(life, Signal::CONT));
                    }
                    process.hurry();
                    self.tell(i, Letter::Runtime(Runtime::Stop));
                }
            }
        }
        let deadline = monotonic() + nanos(self.options.stop_timeout);
        let mut killed = false;
        while self.processes.iter().any(|p| p.stage != Stage::Absent) {
            self.flush();
            self.drain_after_the_end()?;
            let retry = self.retry_at.unwrap_or(u64::MAX);
            self.wait_until(deadline.min(retry).max(monotonic() + 1_000_000))?;
            while let Some(event) = self.supervisor.event() {
                self.ended(event);
            }
            if !killed && monotonic() >= deadline {
                killed = true;
                self.kill_the_rest();
            }
            if self.supervisor.is_gone() {
                return Err(SwarmError::Supervisor(std::io::Error::other("its thread ended")));
            }
        }
        Ok(())
    }

    /// Makes room for agents that still have something to say; nobody listens any more.
    fn drain_after_the_end(&mut self) -> Result<(), SwarmError> {
        for _ in 0..DRAIN * 8 {
            if self.inbox.receive()?.is_none() {
                break;
            }
        }
        Ok(())
    }

    fn ended(&mut self, event: Event) {
        let Event::Exited { life: (id, incarnation), how, stderr_tail } = event else { return };
        let at = self.outcome.end;
        let Some(process) = self.processes.get_mut(id.index()) else { return };
        process.bury();
        let how = process.verdict.map_or(how, str::to_owned);
        if !process.condemned && how != "exited" {
            self.outcome.crashes.push(Crash { id, incarnation, at, how, stderr_tail });
        }
    }

    fn kill_the_rest(&mut self) {
        for process in &mut self.processes {
            if process.stage != Stage::Absent {
                let life = (process.id, process.incarnation);
                process.verdict = Some("did not stop in time, and was killed");
                tracing::error!("module {} did not stop in time and is killed", process.id);
                self.supervisor.ask(Task::Signal(life, Signal::KILL));
            }
        }
    }

    fn read_ledgers(&mut self) {
        for process in &self.processes {
            for life in 0..=process.incarnation.0 {
                match Ledger::read(self.dir.root(), process.id, Incarnation(life)) {
                    Ok(Some(account)) => {
                        self.outcome.tally += account.tally;
                        self.outcome.foreign += account.foreign;
                        self.outcome.wakes += account.wakes;
                    }
                    // Killed before it had started.
                    Ok(None) => {}
                    Err(e) => self.outcome.missing_ledgers.push(e.to_string()),
                }
            }
        }
    }
}

fn nanos(duration: Duration) -> u64 {
    u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX)
}
