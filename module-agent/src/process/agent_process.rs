//! The wait loop of an agent process: one thread that drains its inbox, hands inputs to the agent,
//! sends what comes out, and blocks until something rings or is due. Absent: any decision of a
//! protocol, and polling.

mod sending;

use crate::clock::lateness::Lateness;
use crate::clock::{Clock, monotonic};
use crate::journal_file::{Head, JournalError, Parts, Writer, agent_part};
use crate::link_emulator::{HELD_LIMIT, Impair, Parcel};
use crate::process::args::AgentArgs;
use crate::process::contacts::{Contacts, EARLY_LIMIT, Place};
use crate::process::control_message::Runtime;
use crate::run_dir::controller_lease::{Seat, is_marked};
use crate::run_dir::counter_file::{Account, Ledger, LedgerError};
use crate::run_dir::identity::{Guard, Identity, survive_file_limits};
use crate::run_dir::run_name::RunName;
use crate::run_dir::swarm_file::{SwarmFile, SwarmFileError};
use crate::transport::iceoryx::inbox::{Inbox, InboxError};
use crate::transport::iceoryx::outbox::Outbox;
use crate::transport::iceoryx::rendezvous::{
    ChannelError, INBOX_DEPTH, INBOX_SPARE, Rendezvous, set_verbosity,
};
use crate::transport::iceoryx::shared_frame::Packet;
use crate::transport::iceoryx::space;
use crate::transport::iceoryx::uplink::Uplink;
use metamorph_protocol::agent::{Agent, Birth, Input, InputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::host::{AgentHost, StepContext};
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision};
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::record::{MessageName, Sink};
use metamorph_protocol::runtime::Contact;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, Header};
use rustix::process::{getpgid, getppid, setpgid, setsid};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// The longest wait, if the kernel tells when the controller is gone, and otherwise.
const LONGEST_WAIT: (Duration, Duration) = (Duration::from_secs(2), Duration::from_secs(1));
/// How often the process looks whether its controller still lives, in nanoseconds.
const GUARD_NANOS: u64 = 900_000_000;
/// The wait when the controller's inbox was full.
const UPLINK_RETRY: Duration = Duration::from_millis(5);
/// Frames taken from the inbox before anything is sent.
const DRAIN: usize = 512;
/// Times that the inbox is drained until it must have been empty once.
const DRAINS: usize = 1_000;
/// Wake inputs in one turn; an agent that wants more in one instant gets them after the next drain.
const WAKES: usize = 16;
/// Frames gathered before they are sent.
const BURST: usize = 128;

/// Messages that may be missing from the counts for a process that was killed: in its inbox, taken from it
/// or waiting for their contact, gathered to be sent, or held back by its link.
pub fn in_hand(ports: usize, transparent: bool) -> u64 {
    let inbox = (ports + INBOX_SPARE) * INBOX_DEPTH;
    let held = if transparent { 0 } else { HELD_LIMIT };
    (inbox + DRAIN + EARLY_LIMIT + 2 * BURST + 2 * held) as u64
}

/// Why an agent process ends before it is told to.
#[derive(Debug, Error)]
pub enum AgentError {
    /// The swarm file cannot be read.
    #[error(transparent)]
    Swarm(#[from] SwarmFileError),
    /// The ledger cannot be written.
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    /// A channel that every agent needs cannot be opened.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The inbox failed.
    #[error(transparent)]
    Inbox(#[from] InboxError),
    /// The journal cannot be begun.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// The process cannot say who it is.
    #[error("cannot register this process in {0}: {1}")]
    Register(PathBuf, io::Error),
    /// The clock of the run cannot be read.
    #[error("cannot read the clock of the run in {0}: {1}")]
    Clock(PathBuf, io::Error),
    /// It is not known who controls the run.
    #[error("cannot find out who controls the run in {0}: {1}")]
    Seat(PathBuf, io::Error),
    /// The inbox has no room in shared memory.
    #[error("cannot get memory for the inbox of this agent in {0}: {1}; is shared memory full?")]
    Space(PathBuf, io::Error),
    /// The controller is gone.
    #[error("the controller (process {0}) is gone; an agent does not go on without it")]
    Orphan(i32),
    /// The number of the module is beyond the end of the swarm.
    #[error("this agent is number {0}, but the swarm has only {1} modules")]
    NoSuchModule(u32, u32),
}

/// The directory in which the processes of a run say who they are.
pub fn pid_directory(root: &Path) -> PathBuf {
    root.join("pids")
}

/// The file in which one life of an agent says who it is: its process, then the number of its membership of
/// the run as soon as it has one.
pub fn pid_file(root: &Path, id: ModuleId, life: Incarnation) -> PathBuf {
    pid_directory(root).join(format!("{id}.{life}"))
}

/// Runs one agent until the controller says stop, or is gone. Returns in the first case only; the
/// program then ends with success, and with any other exit code counts as crashed.
pub fn run<A: Agent>(args: &AgentArgs) -> Result<(), AgentError> {
    settle_in(args.verbose);
    let swarm: SwarmFile<A::Setup> = SwarmFile::read(&args.root)?;
    let seat = Seat::read(&args.root).map_err(|e| AgentError::Seat(args.root.clone(), e))?;
    let guard = Guard::new(seat.controller, swarm.patience > 0);
    if guard.controller_is_gone() {
        return Err(AgentError::Orphan(seat.controller.pid));
    }
    if swarm.patience > 0 {
        leave_session();
    }
    if args.id.0 >= swarm.count {
        return Err(AgentError::NoSuchModule(args.id.0, swarm.count));
    }
    register(args, None)?;
    let at = Rendezvous::join(&args.root)?;
    register(args, Some(at.member()))?;
    let inbox = Inbox::create(&at, args.id, args.incarnation, A::PORTS)?;
    space::allocate(&RunName::of_root(&args.root).map_err(ChannelError::Run)?)
        .map_err(|e| AgentError::Space(args.root.clone(), e))?;
    let mut uplink =
        Uplink::new(Outbox::to_controller(&at, args.id, seat.generation)?, args.id, args.incarnation);
    let ledger = Ledger::create(&args.root, args.id, args.incarnation)?;
    // Before the controller knows of this life: each one that it starts has its part of the journal.
    let journal = swarm.journal.as_ref().map(|parts| begin_journal(parts, args)).transpose()?;
    uplink.push(Channel::Runtime, 0, &Runtime::<A::Place>::Hello { pid: std::process::id() });
    let SwarmFile { seed, speed, tolerance, link, setup, patience, count, .. } = swarm;
    let mut clock = Clock::open(&args.root, speed).map_err(|e| AgentError::Clock(args.root.clone(), e))?;
    uplink.flush(clock.now());
    let driver = Driver::<A> {
        args,
        guard,
        seat,
        patience: u64::from(patience) * 1_000_000,
        orphaned: None,
        guarded: monotonic(),
        clock,
        lateness: Lateness::new(tolerance, count),
        due: Time::NEVER,
        setup: Arc::new(setup),
        seed,
        refusal_expected: !link.corrupt.is_zero(),
        impair: new_impair::<A>(link, seed, args),
        contacts: Contacts::new(A::PORTS),
        inbox,
        uplink,
        ledger,
        account: Account::default(),
        burst: Vec::new(),
        peer_sequence: 0,
        expected: 0,
        revision: Revision(0),
        last: Time::ZERO,
        agent: None,
        told: 0,
        returned: false,
        journal,
        silent: false,
        ending: false,
        at,
    };
    driver.run()
}

fn new_impair<A: Agent>(link: LinkModel, seed: u64, args: &AgentArgs) -> Impair {
    Impair::new(link, seed, args.id, args.incarnation, A::PORTS)
}

/// What is logged above the level of debugging is rare: nobody empties the file that it goes to.
fn settle_in(verbose: bool) {
    use tracing::level_filters::LevelFilter;
    let level = if verbose { LevelFilter::DEBUG } else { LevelFilter::WARN };
    // The program may have set up its own.
    let _ = tracing_subscriber::fmt().with_writer(io::stderr).with_max_level(level).try_init();
    set_verbosity(verbose);
    if let Err(e) = survive_file_limits() {
        tracing::debug!("a write beyond the limit of file sizes ends this process: {e}");
    }
    // The controller carries everybody's traffic, so it comes before its agents.
    if let Err(e) = rustix::process::nice(1) {
        tracing::debug!("priority is unchanged: {e}");
    }
}

/// Leaves the session of the controller. When a process dies, the kernel hangs up on those of its children
/// that are stopped and in its session, and they would die with it.
fn leave_session() {
    // Only who does not lead a group can leave; the supervisor has made this process lead one.
    let parent = getppid().ok_or(rustix::io::Errno::SRCH);
    let left =
        parent.and_then(|p| getpgid(Some(p))).and_then(|g| setpgid(None, Some(g))).and_then(|()| setsid());
    if let Err(e) = left {
        tracing::warn!("if this process is stopped when its controller is killed, it dies too: {e}");
    }
}

/// Writes down who this process is, so that it can be found if its controller is killed, and which member
/// of the run, so that it can be buried.
fn register(args: &AgentArgs, member: Option<u128>) -> Result<(), AgentError> {
    let path = pid_file(&args.root, args.id, args.incarnation);
    let member = member.map_or_else(String::new, |m| format!("{m}\n"));
    Identity::own()
        .and_then(|me| std::fs::write(&path, me.to_line() + &member))
        .map_err(|e| AgentError::Register(path, e))
}

/// Creates this incarnation's part of the journal.
fn begin_journal(parts: &Parts, args: &AgentArgs) -> Result<Writer, JournalError> {
    let head = Head::Part { run: parts.run, id: args.id, life: args.incarnation };
    Writer::create(&agent_part(&parts.dir, args.id, args.incarnation), &head)
}

struct Driver<'a, A: Agent> {
    args: &'a AgentArgs,
    guard: Guard,
    seat: Seat,
    /// How long to go on without a controller, in nanoseconds of real time.
    patience: u64,
    /// Since when there has been none.
    orphaned: Option<u64>,
    /// When the controller was last looked for.
    guarded: u64,
    clock: Clock,
    lateness: Lateness,
    /// When the agent or its link wanted to be woken, as of the last wait.
    due: Time,
    setup: Arc<A::Setup>,
    seed: u64,
    /// Whether the link damages frames, so that a damaged one need not be a stranger's.
    refusal_expected: bool,
    impair: Impair,
    contacts: Contacts,
    inbox: Inbox,
    uplink: Uplink,
    ledger: Ledger,
    account: Account,
    burst: Vec<Parcel>,
    peer_sequence: u32,
    /// The controller's next sequence number.
    expected: u32,
    /// The last contact change that the agent knows of.
    revision: Revision,
    last: Time,
    agent: Option<AgentHost<A>>,
    /// Actions and reports so far.
    told: u32,
    /// Another controller says that it has the seat.
    returned: bool,
    /// This incarnation's part of the journal.
    journal: Option<Writer>,
    /// The run is over: nothing is taken or sent any more.
    silent: bool,
    /// Nor does anybody else send.
    ending: bool,
    // Last, so that all ports are gone before the process leaves the run.
    at: Rendezvous,
}

impl<A: Agent> Driver<'_, A> {
    fn run(mut self) -> Result<(), AgentError> {
        loop {
            let drained = self.drain()?;
            self.wake_agent()?;
            let now = self.now();
            self.impair.release(now, &mut self.burst);
            self.send_burst(now)?;
            while let Some(class) = self.contacts.give_up(monotonic()) {
                self.account.tally[class].expired += 1;
            }
            // Before the controller hears of anything: it may kill this process for what it hears.
            self.write_down()?;
            if let Some(late) = self.lateness.report(monotonic()) {
                self.uplink.push(Channel::Runtime, 0, &Runtime::<A::Place>::Late(late));
            }
            self.uplink.flush(now);
            if self.ending {
                return self.end();
            }
            let wait = self.patience(drained);
            if !wait.is_zero() && !self.returned {
                self.inbox.wait(wait)?;
                self.account.wakes += 1;
                let now = self.now();
                self.lateness.taken(self.due.min(now), now);
            }
            if std::mem::take(&mut self.returned) {
                self.follow_seat()?;
            }
            let now = monotonic();
            if now.saturating_sub(self.guarded) < GUARD_NANOS {
                continue;
            }
            self.guarded = now;
            if self.guard.controller_is_gone() {
                self.look_for_controller(now)?;
            }
        }
    }

    /// The controller is gone. Bodies are where it was, so the agent can do little but talk to its
    /// neighbours; but another may take the seat.
    fn look_for_controller(&mut self, now: u64) -> Result<(), AgentError> {
        let since = *self.orphaned.get_or_insert(now);
        // A run that has not begun is not gone on with.
        if !is_marked(&self.args.root) || now.saturating_sub(since) >= self.patience {
            return Err(AgentError::Orphan(self.seat.controller.pid));
        }
        self.follow_seat()
    }

    /// Turns to the controller that has the seat now, if it is another than before.
    fn follow_seat(&mut self) -> Result<(), AgentError> {
        let Ok(seat) = Seat::read(&self.args.root) else { return Ok(()) };
        if seat.generation <= self.seat.generation {
            return Ok(());
        }
        let outbox = match Outbox::to_controller(&self.at, self.args.id, seat.generation) {
            Ok(outbox) => outbox,
            Err(e) => {
                tracing::debug!("the new controller cannot be reached yet: {e}");
                return Ok(());
            }
        };
        // From here on nothing is in the way of what the old one has sent, and it sends no more.
        self.seat = seat;
        for _ in 0..DRAINS {
            self.uplink.clear();
            if self.drain()? < DRAIN && !self.uplink.is_full() {
                break;
            }
        }
        self.write_down()?;
        self.uplink.clear();
        self.uplink.redirect(outbox);
        self.guard = Guard::new(seat.controller, true);
        self.orphaned = None;
        let here = Runtime::<A::Place>::Here { told: self.told, expected: self.expected };
        self.uplink.push(Channel::Runtime, 0, &here);
        let now = self.now();
        self.uplink.flush(now);
        Ok(())
    }

    /// The run is over for the agent. What the link model holds back stays under way for ever.
    fn fall_silent(&mut self) {
        self.silent = true;
        for class in self.impair.drain() {
            self.account.left[class.index()] += 1;
        }
        self.uplink.push(Channel::Runtime, 0, &Runtime::<A::Place>::Silent);
    }

    /// What is counted at the very end: frames in the inbox, to which none is added any more, and frames
    /// that wait for a contact that will not come.
    fn end(mut self) -> Result<(), AgentError> {
        while let Some(packet) = self.inbox.receive()? {
            self.accept(&packet)?;
        }
        while let Some(class) = self.contacts.give_up(u64::MAX) {
            self.account.tally[class].expired += 1;
        }
        self.record();
        Ok(self.ledger.close(&self.account)?)
    }

    /// Writes down what is about to be seen by others: first what happened, then what it adds up to.
    fn write_down(&mut self) -> Result<(), AgentError> {
        self.record();
        Ok(self.ledger.write(&self.account)?)
    }

    fn record(&mut self) {
        if let Some(writer) = &mut self.journal {
            writer.commit();
            self.account.unrecorded = writer.lost().0;
        }
    }

    fn now(&mut self) -> Time {
        self.last = self.clock.now().max(self.last);
        self.last
    }

    /// How long to block.
    fn patience(&mut self, drained: usize) -> Duration {
        self.due = Time::NEVER;
        if drained == DRAIN && !self.uplink.is_full() {
            return Duration::ZERO;
        }
        let mut wait = if self.guard.is_signalled() { LONGEST_WAIT.0 } else { LONGEST_WAIT.1 };
        if !self.uplink.is_idle() {
            wait = UPLINK_RETRY;
        }
        if self.uplink.is_full() {
            return wait;
        }
        let agent = self.agent.as_ref().filter(|_| !self.silent);
        let due = agent.map_or(Time::NEVER, AgentHost::wake_at).min(self.impair.next());
        self.due = due;
        if due == Time::NEVER { wait } else { wait.min(self.clock.until(due)) }
    }

    fn drain(&mut self) -> Result<usize, AgentError> {
        for taken in 0..DRAIN {
            if self.uplink.is_full() || self.ending {
                return Ok(taken);
            }
            let Some(packet) = self.inbox.receive()? else { return Ok(taken) };
            self.accept(&packet)?;
        }
        Ok(DRAIN)
    }

    fn accept(&mut self, packet: &Packet) -> Result<(), AgentError> {
        let frame = &packet.frame();
        let Ok(header) = frame.open() else {
            match packet.damaged_class().filter(|_| self.refusal_expected) {
                Some(class) if self.silent => self.account.left[class.index()] += 1,
                Some(class) => self.account.tally[class].refused += 1,
                None => self.account.foreign += 1,
            }
            return Ok(());
        };
        let accepted = header.destination == self.args.id
            && match header.channel {
                Channel::Peer => return self.accept_peer(header, frame, packet.sent()),
                Channel::Runtime if header.source == CONTROLLER && self.is_aside(frame) => return Ok(()),
                _ if header.source != CONTROLLER || header.sequence != self.expected => false,
                Channel::Runtime => match frame.message() {
                    Ok(message) => self.accept_runtime(message)?,
                    Err(_) => false,
                },
                Channel::Body => match frame.message() {
                    Ok(percept) => self.hand(Input::Percept(percept))?,
                    Err(_) => false,
                },
                Channel::Control => match frame.message() {
                    Ok(order) => self.hand(Input::Order(order))?,
                    Err(_) => false,
                },
            };
        if accepted {
            self.expected = self.expected.wrapping_add(1);
            self.lateness.taken(packet.sent(), self.last);
        } else {
            tracing::debug!(?header, "a frame that no member of the run would send");
            self.account.foreign += 1;
        }
        Ok(())
    }

    /// Takes what the controller says in no sequence; false if this is not of that kind.
    fn is_aside(&mut self, frame: &Frame) -> bool {
        match frame.message::<Runtime<A::Place>>() {
            Ok(Runtime::Return) => self.returned = true,
            Ok(Runtime::Leave) => {
                let taken = Runtime::<A::Place>::Taken { expected: self.expected };
                self.uplink.push(Channel::Runtime, 0, &taken);
            }
            _ => return false,
        }
        true
    }

    fn accept_peer(&mut self, header: Header, frame: &Frame, sent: Time) -> Result<(), AgentError> {
        match self.contacts.place(&header) {
            Place::Here(_) if self.silent => self.account.left[header.class.index()] += 1,
            Place::Here(port) => {
                self.deliver(port, &header, frame)?;
                self.lateness.taken(sent, self.last);
            }
            Place::Ended => self.account.tally[header.class].expired += 1,
            Place::Early => {
                if let Some(class) = self.contacts.keep(monotonic(), header, *frame) {
                    self.account.tally[class].expired += 1;
                }
            }
            Place::Impostor => self.account.foreign += 1,
        }
        Ok(())
    }

    fn deliver(&mut self, port: Port, header: &Header, frame: &Frame) -> Result<(), AgentError> {
        match frame.message::<A::Message>() {
            Ok(message) => {
                self.account.tally[header.class].delivered += 1;
                let (from, life, number) = (header.source, header.incarnation, header.sequence);
                let name = MessageName { from, life, number };
                self.hand_in(Input::Message { port, message }, Some((name, header.class)))?;
            }
            Err(_) => self.account.foreign += 1,
        }
        Ok(())
    }

    fn accept_runtime(&mut self, message: Runtime<A::Place>) -> Result<bool, AgentError> {
        match message {
            Runtime::Begin { place } if self.agent.is_none() => {
                let birth =
                    Birth { id: self.args.id, incarnation: self.args.incarnation, place, seed: self.seed };
                let now = self.now();
                self.agent = Some(match &mut self.journal {
                    None => AgentHost::new(&self.setup, birth, now),
                    Some(writer) => AgentHost::recorded(&self.setup, birth, now, writer),
                });
            }
            Runtime::Contact { port, revision, contact } if self.contacts.has_port(port) => {
                self.change_contact(port, revision, contact)?;
            }
            Runtime::Stop if !self.silent => self.fall_silent(),
            Runtime::End if self.silent => self.ending = true,
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn change_contact(
        &mut self,
        port: Port,
        revision: Revision,
        contact: Option<Contact>,
    ) -> Result<(), AgentError> {
        let early = self.contacts.change(port, contact);
        self.account.loose = self.contacts.loose();
        self.impair.reset(port);
        self.revision = revision;
        self.hand(Input::Contact { port, session: contact.map(|c| c.session) })?;
        for (header, frame) in early {
            match self.contacts.place(&header) {
                Place::Here(port) => self.deliver(port, &header, &frame)?,
                _ => self.account.foreign += 1,
            }
        }
        Ok(())
    }

    fn wake_agent(&mut self) -> Result<(), AgentError> {
        for _ in 0..WAKES {
            let now = self.now();
            let due = self.agent.as_ref().is_some_and(|a| a.wake_at() <= now);
            if !due || self.uplink.is_full() || self.silent {
                break;
            }
            self.hand(Input::Wake)?;
        }
        Ok(())
    }

    /// Hands in one input; false if there is no agent yet to take it.
    fn hand(&mut self, input: InputOf<A>) -> Result<bool, AgentError> {
        self.hand_in(input, None)
    }

    /// The same; `heard` names the message that it is.
    fn hand_in(
        &mut self,
        input: InputOf<A>,
        heard: Option<(MessageName, Class)>,
    ) -> Result<bool, AgentError> {
        let now = self.now();
        let Some(agent) = &mut self.agent else { return Ok(false) };
        if self.silent {
            return Ok(true);
        }
        match &mut self.journal {
            None => agent.handle(now, input),
            Some(writer) => {
                let peer = |port| self.contacts.get(port).map(|c| c.peer);
                let context = StepContext { heard, revision: self.revision, peer: &peer, sink: writer };
                agent.handle_recorded(now, input, context);
            }
        }
        while let Some(output) = self.agent.as_mut().and_then(AgentHost::poll) {
            self.carry_out(now, output)?;
        }
        Ok(true)
    }
}
