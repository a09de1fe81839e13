//! The wait loop of one agent: a single thread that drains the inbox, hands inputs to the agent, sends its
//! outputs, and blocks until a sender wakes it or a timer is due. Not here: protocol decisions, polling, and
//! the kind of transport and clock.

use crate::clock::lateness::Lateness;
use crate::clock::source::ClockSource;
use crate::clock::{Clock, Speed};
use crate::journal_file::Writer;
use crate::link_emulator::LinkEmulator;
use crate::process::contacts::{Contacts, Place};
use crate::process::orphan_watch::{ControllerState, OrphanWatch};
use crate::process::receiver::{Received, Receiver};
use crate::process::runtime_message::RuntimeMessage;
use crate::process::sender::Sender;
use crate::process::start::AgentError;
use crate::process::uplink::Uplink;
use crate::process::write_ahead::WriteAhead;
use crate::run_dir::counter_file::CounterStore;
use crate::transport::shared_frame::SharedFrame;
use crate::transport::{Address, AgentKey, Transport};
use metamorph_protocol::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::host::{AgentHost, StepContext};
use metamorph_protocol::ids::{Port, Revision};
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::record::MessageName;
use metamorph_protocol::runtime::Contact;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::Channel;
use std::sync::Arc;
use std::time::Duration;

/// The longest time that an agent waits if it does not watch its controller.
const LONGEST_WAIT: Duration = Duration::from_secs(2);
/// The time after which frames that did not fit into the controller's inbox are sent again.
const UPLINK_RETRY: Duration = Duration::from_millis(5);
/// Number of frames taken from the inbox before anything is sent.
pub(super) const DRAIN: usize = 512;
/// Largest number of drains spent on frames of the old controller before the agent turns to the new one.
const DRAINS: usize = 1_000;
/// Number of wake inputs in one turn; an agent that wants more in one instant gets them after the next drain.
const WAKES: usize = 16;

/// The configuration of one incarnation of an agent.
#[derive(Clone, Debug)]
pub struct AgentConfig<S> {
    /// The module and its incarnation.
    pub agent: AgentKey,
    /// The number of modules in the swarm.
    pub count: u32,
    /// The seed of the run.
    pub seed: u64,
    /// The highest speed of scenario time.
    pub speed: Speed,
    /// The lateness, in scenario time, that the run tolerates. The agent reports more than half of it.
    pub tolerance: Span,
    /// The effects of links on messages.
    pub link: LinkModel,
    /// The setup that all agents of the swarm share.
    pub setup: Arc<S>,
    /// The generation of the controller that the agent connects to at its start.
    pub generation: u32,
}

/// The services that an agent runs over.
#[derive(Debug)]
pub struct AgentServices<T, C> {
    /// Its inbox.
    pub transport: T,
    /// The clock of the run.
    pub clock: C,
    /// The store of its counters.
    pub counters: Box<dyn CounterStore>,
    /// Its part of the journal; `None` if none is kept.
    pub journal: Option<Writer>,
    /// The watch over its controller; `None` if it cannot outlive the controller.
    pub orphan_watch: Option<OrphanWatch>,
}

/// The next step after a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Wait for at most this long, or until a sender wakes the agent.
    Wait(Duration),
    /// The run is over: [`AgentProcess::close`] ends the agent.
    Over,
}

/// One incarnation of an agent over a transport and a clock.
pub struct AgentProcess<A: Agent, T: Transport, C> {
    agent: AgentKey,
    setup: Arc<A::Setup>,
    seed: u64,
    host: Option<AgentHost<A>>,
    clock: Clock<C>,
    lateness: Lateness,
    /// When the agent or its link wants to be woken, as of the last wait.
    due: Time,
    /// The latest scenario time read.
    last: Time,
    receiver: Receiver,
    sender: Sender,
    contacts: Contacts<T::Link>,
    uplink: Uplink<T::Link>,
    write_ahead: WriteAhead,
    /// Number of actions and reports sent so far.
    told: u32,
    orphan_watch: Option<OrphanWatch>,
    /// True if a controller has announced that it took over.
    returned: bool,
    // Last: links are closed before their transport.
    transport: T,
}

impl<A: Agent, T: Transport, C: ClockSource> AgentProcess<A, T, C> {
    /// Connects to the controller and says hello.
    ///
    /// # Errors
    /// If the controller cannot be reached, or the clock cannot be read.
    pub fn new(config: AgentConfig<A::Setup>, services: AgentServices<T, C>) -> Result<Self, AgentError> {
        let AgentConfig { agent, count, seed, speed, tolerance, link, setup, generation } = config;
        let AgentServices { mut transport, clock, counters, journal, orphan_watch } = services;
        let mut uplink = Uplink::new(transport.connect(Address::Controller(generation))?, agent);
        uplink.push(Channel::Runtime, 0, &RuntimeMessage::<A::Place>::Hello { pid: std::process::id() });
        let mut clock = Clock::new(clock, speed).map_err(AgentError::Clock)?;
        uplink.flush(clock.now());
        let (damage_expected, is_divided) = (!link.corrupt.is_zero(), link.hosts.is_some());
        let emulator = LinkEmulator::new(link, seed, agent.0, agent.1, A::PORTS);
        Ok(AgentProcess {
            agent,
            setup,
            seed,
            host: None,
            clock,
            lateness: Lateness::new(tolerance, count),
            due: Time::NEVER,
            last: Time::ZERO,
            receiver: Receiver::new(agent.0, damage_expected),
            sender: Sender::new(agent, emulator),
            contacts: Contacts::new(A::PORTS, is_divided),
            uplink,
            write_ahead: WriteAhead::new(counters, journal),
            told: 0,
            orphan_watch,
            returned: false,
            transport,
        })
    }

    /// Runs the agent until the controller ends it.
    ///
    /// # Errors
    /// If the agent cannot continue, for example because its controller is gone.
    pub fn run(mut self) -> Result<(), AgentError> {
        loop {
            match self.turn()? {
                Turn::Over => return self.close(),
                Turn::Wait(wait) => self.wait(wait)?,
            }
        }
    }

    /// Does all work that needs no waiting.
    ///
    /// # Errors
    /// As for [`AgentProcess::run`].
    pub fn turn(&mut self) -> Result<Turn, AgentError> {
        self.watch_controller()?;
        let drained = self.drain()?;
        self.wake_agent()?;
        let now = self.now();
        self.sender.release(now);
        self.send_burst(now)?;
        let monotonic = self.clock.monotonic();
        self.sender.retry(monotonic, &mut self.contacts, &mut self.transport)?;
        while let Some(class) = self.contacts.expire(monotonic) {
            self.write_ahead.counters.tally[class].expired += 1;
        }
        // Before the controller hears of anything: it may kill this process for what it hears.
        self.write_ahead.commit()?;
        if let Some(late) = self.lateness.report(monotonic) {
            self.push(&RuntimeMessage::Late(late));
        }
        for (peer, incarnation) in self.sender.take_unreached() {
            self.push(&RuntimeMessage::Unreached { peer, incarnation });
        }
        self.uplink.flush(now);
        if self.receiver.is_ending() {
            return Ok(Turn::Over);
        }
        Ok(Turn::Wait(self.poll_timeout(drained)))
    }

    fn wait(&mut self, timeout: Duration) -> Result<(), AgentError> {
        if timeout.is_zero() || self.returned {
            return Ok(());
        }
        self.transport.wait(timeout)?;
        self.write_ahead.counters.wakes += 1;
        let now = self.now();
        self.lateness.taken(self.due.min(now), now);
        Ok(())
    }

    /// Ends the agent: counts the frames left in its inbox and those that still wait for their contact.
    ///
    /// # Errors
    /// If the counts cannot be written.
    pub fn close(mut self) -> Result<(), AgentError> {
        while let Some(shared) = self.transport.receive()? {
            self.accept(&shared)?;
        }
        while let Some(class) = self.contacts.expire(u64::MAX) {
            self.write_ahead.counters.tally[class].expired += 1;
        }
        Ok(self.write_ahead.close()?)
    }

    /// Checks that there is a controller. It hosts the bodies, so without one the agent can do little but
    /// talk to its neighbours.
    fn watch_controller(&mut self) -> Result<(), AgentError> {
        if std::mem::take(&mut self.returned) {
            self.follow_controller()?;
        }
        let now = self.clock.monotonic();
        let Some(watch) = &mut self.orphan_watch else { return Ok(()) };
        match watch.check(now) {
            ControllerState::Alive => Ok(()),
            ControllerState::Missing => self.follow_controller(),
            ControllerState::Gone => Err(AgentError::Orphan(watch.controller())),
            ControllerState::Frozen => Err(AgentError::Frozen(watch.controller())),
        }
    }

    /// Connects to the controller that holds the lease, if its generation is later than that of the last one.
    fn follow_controller(&mut self) -> Result<(), AgentError> {
        let Some(lease) = self.orphan_watch.as_ref().and_then(OrphanWatch::successor) else { return Ok(()) };
        let link = match self.transport.connect(Address::Controller(lease.generation)) {
            Ok(link) => link,
            Err(e) => {
                tracing::debug!("the new controller cannot be reached yet: {e}");
                return Ok(());
            }
        };
        // The old controller sends no more. Its frames are taken first, and not answered.
        for _ in 0..DRAINS {
            self.uplink.clear();
            if self.drain()? < DRAIN && !self.uplink.is_full() {
                break;
            }
        }
        self.write_ahead.commit()?;
        self.uplink.clear();
        self.uplink.redirect(link);
        self.write_ahead.counters.loose = self.contacts.redirect();
        if let Some(watch) = &mut self.orphan_watch {
            watch.follow(lease);
        }
        self.push(&RuntimeMessage::Here { told: self.told, expected: self.receiver.expected() });
        let now = self.now();
        self.uplink.flush(now);
        Ok(())
    }

    fn push(&mut self, message: &RuntimeMessage<A::Place>) {
        self.uplink.push(Channel::Runtime, 0, message);
    }

    fn now(&mut self) -> Time {
        self.last = self.clock.now().max(self.last);
        self.last
    }

    /// Returns how long to block.
    fn poll_timeout(&mut self, drained: usize) -> Duration {
        self.due = Time::NEVER;
        if drained == DRAIN && !self.uplink.is_full() {
            return Duration::ZERO;
        }
        let mut wait = self.orphan_watch.as_ref().map_or(LONGEST_WAIT, OrphanWatch::longest_wait);
        if !self.uplink.is_idle() {
            wait = UPLINK_RETRY;
        }
        if self.uplink.is_full() {
            return wait;
        }
        let host = self.host.as_ref().filter(|_| !self.receiver.is_silent());
        self.due = host.map_or(Time::NEVER, AgentHost::wake_at).min(self.sender.next_due());
        if self.due == Time::NEVER { wait } else { wait.min(self.clock.until(self.due)) }
    }

    fn drain(&mut self) -> Result<usize, AgentError> {
        for taken in 0..DRAIN {
            if self.uplink.is_full() || self.receiver.is_ending() {
                return Ok(taken);
            }
            let Some(shared) = self.transport.receive()? else { return Ok(taken) };
            self.accept(&shared)?;
        }
        Ok(DRAIN)
    }

    fn accept(&mut self, shared: &SharedFrame) -> Result<(), AgentError> {
        let counters = &mut self.write_ahead.counters;
        let clock = &self.clock;
        match self.receiver.accept::<A, _>(shared, &mut self.contacts, counters, || clock.monotonic()) {
            Received::Nothing => return Ok(()),
            Received::Return => {
                self.returned = true;
                return Ok(());
            }
            Received::Leave => {
                self.push(&RuntimeMessage::Consumed { expected: self.receiver.expected() });
                return Ok(());
            }
            Received::Input(input, heard) => self.hear(input, heard, shared)?,
            Received::Begin(place) => self.begin(place),
            Received::Contact { port, revision, contact } => self.change_contact(port, revision, contact)?,
            Received::Links(changes) => self.sender.change_links(changes),
            Received::Stop => {
                self.sender.fall_silent(&mut self.write_ahead.counters);
                self.push(&RuntimeMessage::Silent);
            }
            Received::End => {}
        }
        self.lateness.taken(shared.sent(), self.last);
        Ok(())
    }

    fn begin(&mut self, place: A::Place) {
        // All processes of a run share one clock.
        let now = self.now();
        let birth = Birth { id: self.agent.0, incarnation: self.agent.1, place, seed: self.seed, born: now };
        self.host = Some(match &mut self.write_ahead.journal {
            None => AgentHost::new(&self.setup, birth, now),
            Some(writer) => AgentHost::recorded(&self.setup, birth, now, writer),
        });
    }

    fn change_contact(
        &mut self,
        port: Port,
        revision: Revision,
        contact: Option<Contact>,
    ) -> Result<(), AgentError> {
        let early = self.contacts.change(port, revision, contact);
        self.write_ahead.counters.loose = self.contacts.loose();
        self.sender.reset(port);
        self.hand_in(Input::Contact { port, session: contact.map(|c| c.session) }, None)?;
        for (header, shared) in early {
            let counters = &mut self.write_ahead.counters;
            let received = match self.contacts.place(&header) {
                Place::Here(port) => self.receiver.message::<A>(port, &header, &shared.frame(), counters),
                _ => {
                    counters.foreign += 1;
                    Received::Nothing
                }
            };
            if let Received::Input(input, heard) = received {
                self.hear(input, heard, &shared)?;
            }
        }
        Ok(())
    }

    /// Hands in an input that came in a frame, and measures how long a message was under way.
    fn hear(
        &mut self,
        input: InputOf<A>,
        heard: Option<(MessageName, Class)>,
        shared: &SharedFrame,
    ) -> Result<(), AgentError> {
        self.hand_in(input, heard)?;
        // `last` is the time at which it was handed in.
        if let (Some((_, class)), Some(handed)) = (heard, shared.handed()) {
            let (now, latencies) = (self.last, &mut self.write_ahead.counters.latencies);
            latencies[class].record(now.since(handed));
            latencies.channel.record(now.since(shared.sent()));
        }
        Ok(())
    }

    fn wake_agent(&mut self) -> Result<(), AgentError> {
        for _ in 0..WAKES {
            let now = self.now();
            let due = self.host.as_ref().is_some_and(|host| host.wake_at() <= now);
            if !due || self.uplink.is_full() || self.receiver.is_silent() {
                break;
            }
            self.hand_in(Input::Wake, None)?;
        }
        Ok(())
    }

    /// Hands in one input; `heard` names it if it is a peer's message. Without effect before the agent begins
    /// and after it has fallen silent.
    fn hand_in(&mut self, input: InputOf<A>, heard: Option<(MessageName, Class)>) -> Result<(), AgentError> {
        let now = self.now();
        let Some(host) = self.host.as_mut().filter(|_| !self.receiver.is_silent()) else { return Ok(()) };
        match &mut self.write_ahead.journal {
            None => host.handle(now, input),
            Some(writer) => {
                let peer = |port| self.contacts.get(port).map(|c| c.peer);
                let revision = self.contacts.revision();
                let context = StepContext { heard, revision, peer: &peer, sink: writer };
                host.handle_recorded(now, input, context);
            }
        }
        while let Some(output) = self.host.as_mut().and_then(AgentHost::poll) {
            self.carry_out(now, output)?;
        }
        Ok(())
    }

    fn carry_out(&mut self, now: Time, output: OutputOf<A>) -> Result<(), AgentError> {
        match output {
            Output::Send { port, class, message } => {
                let tally = &mut self.write_ahead.counters.tally;
                self.sender.send(now, (port, class, &message), &self.contacts, tally);
            }
            Output::Act(action) => {
                self.told += 1;
                self.uplink.push(Channel::Body, self.contacts.revision().0, &action);
            }
            Output::Report(report) => {
                self.told += 1;
                self.uplink.push(Channel::Control, 0, &report);
            }
        }
        if self.sender.is_full() { self.send_burst(now) } else { Ok(()) }
    }

    /// Sends the gathered frames. The counters that include them are written first; the counts of those that
    /// could not be sent are written before the next wait.
    fn send_burst(&mut self, now: Time) -> Result<(), AgentError> {
        if self.sender.is_empty() {
            return Ok(());
        }
        self.write_ahead.commit()?;
        let (now, tally) = ((now, self.clock.monotonic()), &mut self.write_ahead.counters.tally);
        self.sender.flush(now, &mut self.contacts, &mut self.transport, tally);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::page::Page;
    use crate::clock::source::MemoryClock;
    use crate::run_dir::counter_file::SharedCounters;
    use crate::transport::memory::{MemoryLink, MemoryNetwork, MemoryTransport};
    use crate::transport::{Link, REPORTS_DEPTH, SendStatus, TransportError};
    use metamorph_protocol::ids::{Incarnation, ModuleId};
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::wire::{CONTROLLER, Frame, Header, Never, Wire};
    use std::hash::Hasher;

    const AGENT: AgentKey = (ModuleId(3), Incarnation(1));

    /// Reports each order one second after it came, as often as the order says.
    struct Alarm {
        due: Time,
        order: Cell,
        reports: i16,
    }

    impl Agent for Alarm {
        type Setup = ();
        type Place = Cell;
        type Message = Never;
        type Action = Never;
        type Percept = Never;
        type Order = Cell;
        type Report = Cell;
        const PORTS: usize = 1;
        fn new(_: &Arc<()>, birth: Birth<Cell>, _: Time) -> Alarm {
            Alarm { due: Time::NEVER, order: birth.place, reports: 0 }
        }
        fn handle(&mut self, now: Time, input: InputOf<Alarm>) {
            match input {
                Input::Order(order) => (self.due, self.order) = (now + Span::secs(1), order),
                Input::Wake => (self.due, self.reports) = (Time::NEVER, self.order.x),
                _ => {}
            }
        }
        fn poll(&mut self) -> Option<OutputOf<Alarm>> {
            let more = self.reports > 0;
            self.reports -= i16::from(more);
            more.then_some(Output::Report(self.order))
        }
        fn wake_at(&self) -> Time {
            self.due
        }
        fn digest(&self, _: &mut dyn Hasher) {}
    }

    /// An agent and its controller, stepped by one thread over a clock that the test moves.
    struct Bench {
        controller: MemoryTransport,
        link: MemoryLink,
        sequence: u32,
        clock: MemoryClock,
        counters: SharedCounters,
        process: AgentProcess<Alarm, MemoryTransport, MemoryClock>,
    }

    impl Bench {
        fn new() -> Bench {
            let network = MemoryNetwork::new();
            let mut controller = network.controller(0);
            let transport = network.agent(AGENT, Alarm::PORTS);
            let link = controller.connect(Address::Agent(AGENT)).unwrap();
            let (clock, counters) = (MemoryClock::manual(), SharedCounters::default());
            clock.write_page(&Page::stopped(0, Time::ZERO).extended(0, u64::MAX, Speed::REAL)).unwrap();
            let config = AgentConfig {
                agent: AGENT,
                count: 1,
                seed: 0,
                speed: Speed::REAL,
                tolerance: Span::secs(1),
                link: LinkModel::default(),
                setup: Arc::new(()),
                generation: 0,
            };
            let services = AgentServices {
                transport,
                clock: clock.clone(),
                counters: Box::new(counters.clone()),
                journal: None,
                orphan_watch: None,
            };
            let process = AgentProcess::new(config, services).unwrap();
            Bench { controller, link, sequence: 0, clock, counters, process }
        }

        fn tell<M: Wire>(&mut self, channel: Channel, message: &M) {
            let header = Header {
                channel,
                kind: message.kind(),
                class: Class::World,
                port: Port(0),
                incarnation: Incarnation(0),
                source: CONTROLLER,
                destination: AGENT.0,
                session: 0,
                sequence: self.sequence,
            };
            self.sequence += 1;
            let now = Time(self.clock.monotonic());
            let frame = SharedFrame::new(&Frame::seal(header, message), now);
            assert_eq!(self.link.send(frame), SendStatus::Sent);
        }

        /// Takes the frames that the agent has sent, and returns their channels and sequence numbers.
        fn heard(&mut self) -> Vec<(Channel, u32)> {
            let taken = std::iter::from_fn(|| self.controller.receive().unwrap());
            taken.map(|shared| shared.frame().open().map(|h| (h.channel, h.sequence)).unwrap()).collect()
        }
    }

    #[test]
    fn an_agent_is_stepped_without_threads_and_wakes_when_the_clock_says_so() {
        let mut bench = Bench::new();
        assert_eq!(bench.heard(), [(Channel::Runtime, 0)], "hello");
        assert_eq!(bench.process.turn().unwrap(), Turn::Wait(LONGEST_WAIT));
        bench.tell(Channel::Runtime, &RuntimeMessage::Begin { place: Cell::default() });
        bench.tell(Channel::Control, &Cell::new(1, 0, 0));
        assert_eq!(bench.process.turn().unwrap(), Turn::Wait(Duration::from_secs(1)));
        bench.clock.advance(999_999_999);
        assert_eq!(bench.process.turn().unwrap(), Turn::Wait(Duration::from_nanos(1)));
        assert_eq!(bench.heard(), []);
        bench.clock.advance(1);
        assert_eq!(bench.process.turn().unwrap(), Turn::Wait(LONGEST_WAIT));
        assert_eq!(bench.heard(), [(Channel::Control, 1)]);
        for sequence in [2, 3] {
            bench.tell(Channel::Runtime, &RuntimeMessage::<Cell>::Stop);
            bench.process.turn().unwrap();
            assert_eq!(bench.heard(), [(Channel::Runtime, sequence)], "silent");
        }
        bench.tell(Channel::Runtime, &RuntimeMessage::<Cell>::End);
        assert_eq!(bench.process.turn().unwrap(), Turn::Over);
        assert!(!bench.counters.read().closed);
        bench.process.close().unwrap();
        assert!(bench.counters.read().closed);
    }

    #[test]
    fn reports_wait_for_a_controller_whose_inbox_is_full_and_arrive_in_order() {
        let mut bench = Bench::new();
        bench.tell(Channel::Runtime, &RuntimeMessage::Begin { place: Cell::default() });
        bench.tell(Channel::Control, &Cell::new(2 * REPORTS_DEPTH as i16, 0, 0));
        bench.process.turn().unwrap();
        bench.clock.advance(1_000_000_000);
        assert_eq!(bench.process.turn().unwrap(), Turn::Wait(UPLINK_RETRY));
        let mut heard = bench.heard();
        assert_eq!(heard.len(), REPORTS_DEPTH);
        while bench.process.turn().unwrap() != Turn::Wait(LONGEST_WAIT) {
            heard.extend(bench.heard());
        }
        heard.extend(bench.heard());
        let numbers: Vec<u32> = heard.iter().map(|(_, sequence)| *sequence).collect();
        assert_eq!(numbers, (0..=2 * REPORTS_DEPTH as u32).collect::<Vec<_>>());
    }

    #[test]
    fn a_killed_agent_ends_with_an_error_and_leaves_its_counters_open() {
        let mut bench = Bench::new();
        bench.process.transport.control().kill();
        let ended = bench.process.turn();
        assert!(matches!(ended, Err(AgentError::Transport(TransportError::Killed))), "{ended:?}");
        assert!(!bench.counters.read().closed);
    }
}
