//! Metrics of a run that is under way: integers that its loop notes, and that another thread makes a text of when it is asked.
//!
//! The loop notes what it has at hand, a few times a second, and leaves it out while the text is being made: it never waits.
//! Counts of messages and scenario time are not noted at all. They are in the run's directory, and are read from there when
//! the text is asked for. Not here: the server, which is in the crate of the page.

pub mod catalogue;
pub mod open_metrics;
mod run_files;

use catalogue::Metric;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_protocol::counters::{Class, Counts, Tally};
use metamorph_protocol::host_link::{ClockInterval, State};
use metamorph_protocol::ids::HostId;
use metamorph_protocol::time::Time;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_text::escape::Shown;
use open_metrics::{Labels, Text, Value};
use run_files::RunFiles;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Shortest time between two notes of one kind, in milliseconds.
const EVERY_MS: u64 = 200;
/// The names of [`RunState`], in its order.
const RUN_STATES: [&str; 4] = ["idle", "starting", "running", "ended"];
/// The states of a link.
const LINK_STATES: [State; 6] =
    [State::Down, State::Greeting, State::Up, State::Silent, State::Fenced, State::Closed];
/// Returns one of the counts of a class.
type CountOf = fn(&Counts) -> u64;
/// The fates of messages, with their counts.
const FATES: [(&str, CountOf); 7] = [
    ("sent", |c| c.sent),
    ("delivered", |c| c.delivered),
    ("lost", |c| c.lost),
    ("duplicated", |c| c.duplicated),
    ("overflowed", |c| c.overflowed),
    ("expired", |c| c.expired),
    ("refused", |c| c.refused),
];

/// The state of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
enum RunState {
    /// A daemon has no run.
    #[default]
    Idle,
    Starting,
    Running,
    Ended,
}

/// The state of a link to another host.
#[derive(Clone, Copy, Debug)]
pub struct Peer {
    /// The state of the link.
    pub state: State,
    /// How far the clock of the other host is ahead, if that is known.
    pub clock: Option<ClockInterval>,
}

/// The metrics of a controller or a daemon. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Metrics(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    noted: Mutex<Noted>,
    files: Mutex<RunFiles>,
    progress: Pause,
    links: Pause,
}

/// The noted numbers of one run.
#[derive(Clone, Debug, Default)]
struct Noted {
    state: RunState,
    run: String,
    host: Option<HostId>,
    /// Labels of the run as a whole.
    about: Labels,
    modules: Option<u64>,
    progress: Option<Progress>,
    /// The speed of the clock in billionths of the one asked for.
    speed: Option<u64>,
    /// Live agents of this host.
    here: Option<u64>,
    /// Live agents of other hosts.
    away: u64,
    peers: BTreeMap<HostId, Peer>,
    /// The time and the messages of a simulated run.
    simulated: Option<(Time, Tally)>,
}

/// Lets something happen at most once in [`EVERY_MS`].
#[derive(Debug)]
struct Pause {
    since: Stopwatch,
    /// When it may happen next, in milliseconds.
    next: AtomicU64,
}

impl Default for Pause {
    fn default() -> Pause {
        Pause { since: Stopwatch::start(), next: AtomicU64::new(0) }
    }
}

impl Pause {
    fn is_over(&self) -> bool {
        // A run does not last longer than 2^64 ms.
        let now = self.since.elapsed().as_millis() as u64;
        let is_over = now >= self.next.load(Ordering::Relaxed);
        if is_over {
            self.next.store(now + EVERY_MS, Ordering::Relaxed);
        }
        is_over
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Metrics {
    /// Notes that the run with this name begins on a host, with its files in `root`; those of a simulated run have none.
    pub fn begin(&self, run: &str, host: HostId, root: Option<&Path>) {
        *lock(&self.0.files) = RunFiles::new(root);
        let mut noted = lock(&self.0.noted);
        let (about, modules) = (std::mem::take(&mut noted.about), noted.modules);
        let (state, run, host) = (RunState::Starting, run.to_owned(), Some(host));
        *noted = Noted { state, run, host, about, modules, ..Noted::default() };
    }

    /// Notes the plan of the run that begins next, which controllers have.
    pub fn describe(&self, plan: &Plan) {
        let mut noted = lock(&self.0.noted);
        noted.modules = Some(plan.swarm.len() as u64);
        noted.about = vec![
            ("scenario", plan.title().shown()),
            ("seed", plan.seed.to_string()),
            ("link", plan.overrides.link.name().to_owned()),
        ];
    }

    /// Notes numbers, unless the text is being made.
    fn note(&self, change: impl FnOnce(&mut Noted)) {
        if let Ok(mut noted) = self.0.noted.try_lock() {
            noted.state = noted.state.max(RunState::Running);
            change(&mut noted);
        }
    }

    /// Notes the progress of the swarm and the speed of its clock in millionths, if it is time.
    pub fn note_progress(&self, progress: impl FnOnce() -> (Progress, u32)) {
        if self.0.progress.is_over() {
            let (progress, millionths) = progress();
            self.note(|noted| {
                (noted.progress, noted.speed) = (Some(progress), Some(u64::from(millionths) * 1_000));
            });
        }
    }

    /// Notes the state of a simulated run, if it is time or the run is over.
    pub fn note_simulated(&self, is_over: bool, state: impl FnOnce() -> (Time, Tally, Progress)) {
        if is_over || self.0.progress.is_over() {
            let (time, tally, progress) = state();
            self.note(|noted| {
                (noted.simulated, noted.progress) = (Some((time, tally)), Some(progress));
            });
        }
    }

    /// Notes the links of this host, if it is time, and the live agents: of this host if it is that of a daemon, or else of
    /// all others.
    pub fn note_links(&self, links: impl FnOnce() -> (BTreeMap<HostId, Peer>, u64)) {
        if self.0.links.is_over() {
            let (peers, agents) = links();
            self.note(|noted| {
                noted.peers = peers;
                match noted.host {
                    Some(HostId::CONTROLLER) => noted.away = agents,
                    _ => noted.here = Some(agents),
                }
            });
        }
    }

    /// Reads the files of the run once more, before they are removed.
    pub fn settle(&self) {
        lock(&self.0.files).read(true);
    }

    /// Notes that the run has ended, with its last progress if this is the controller's.
    pub fn end(&self, progress: Option<Progress>) {
        let mut noted = lock(&self.0.noted);
        noted.progress = progress.or(noted.progress);
        (noted.state, noted.here) = (RunState::Ended, noted.here.map(|_| 0));
    }

    /// Returns the text of all metrics.
    pub fn text(&self) -> String {
        // Copied, so that the loop is not kept from noting.
        let noted = lock(&self.0.noted).clone();
        let (time, tally) = {
            let mut files = lock(&self.0.files);
            files.read(false);
            noted.simulated.unwrap_or((files.time, files.tally))
        };
        noted.text(time, &tally)
    }
}

impl Noted {
    fn text(&self, time: Time, tally: &Tally) -> String {
        let host = self.host.map_or_else(String::new, |host| host.to_string());
        let mut text = Text::new(vec![("run", self.run.clone()), ("host", host)]);
        let version = ("version", metamorph_text::version::version().to_owned());
        let about = [self.about.clone(), vec![version]].concat();
        text.put(&catalogue::RUN, [(about, Value::Count(1))]);
        text.put_states(
            &catalogue::RUN_STATE,
            &RUN_STATES,
            &[(Labels::new(), RUN_STATES[self.state as usize])],
        );
        if self.state == RunState::Idle {
            return text.end();
        }
        text.put_one(&catalogue::SCENARIO_TIME, Some(Value::Nanos(time.0)));
        text.put_one(&catalogue::CLOCK_SPEED, self.speed.map(Value::Share));
        text.put_one(&catalogue::MODULES, self.modules.map(Value::Count));
        self.put_progress(&mut text);
        put_messages(&mut text, tally);
        self.put_links(&mut text);
        text.end()
    }

    fn put_progress(&self, text: &mut Text) {
        let seen = self.progress.as_ref();
        let count = |of: fn(&Progress) -> u64| seen.map(|progress| Value::Count(of(progress)));
        let one =
            |text: &mut Text, metric: &Metric, of: fn(&Progress) -> u64| text.put_one(metric, count(of));
        one(text, &catalogue::AGENTS_ALIVE, |p| p.alive as u64);
        let alive = seen.map(|progress| (progress.alive as u64).saturating_sub(self.away));
        text.put_one(&catalogue::HOST_AGENTS, self.here.or(alive).map(Value::Count));
        one(text, &catalogue::RESTARTS, |p| p.restarts);
        one(text, &catalogue::MOVES, |p| p.moves);
        one(text, &catalogue::STANDSTILLS, |p| p.standstills);
        one(text, &catalogue::GOAL, |p| u64::from(p.stage) + 1);
        one(text, &catalogue::GOAL_CELLS, |p| p.goal as u64);
        one(text, &catalogue::GOAL_CELLS_FILLED, |p| p.filled as u64);
    }

    fn put_links(&self, text: &mut Text) {
        let named = |host: &HostId| vec![("peer", host.to_string())];
        let states = LINK_STATES.map(state_name);
        let holding: Vec<_> =
            self.peers.iter().map(|(host, peer)| (named(host), state_name(peer.state))).collect();
        text.put_states(&catalogue::LINK_STATE, &states, &holding);
        let known = self.peers.iter().filter_map(|(host, peer)| Some((host, peer.clock?)));
        let widths = known.map(|(host, clock)| (named(host), Value::Nanos(clock.high.abs_diff(clock.low))));
        text.put(&catalogue::CLOCK_INTERVAL, widths);
    }
}

fn put_messages(text: &mut Text, tally: &Tally) {
    let class = |class: Class| ("class", class.name().to_owned());
    let fates = tally.iter().flat_map(|(of, counts)| {
        FATES.map(|(fate, count)| (vec![class(of), ("fate", fate.to_owned())], Value::Count(count(counts))))
    });
    text.put(&catalogue::MESSAGES, fates);
    let bytes = tally.iter().map(|(of, counts)| (vec![class(of)], Value::Count(counts.bytes)));
    text.put(&catalogue::SENT_BYTES, bytes);
}

const fn state_name(state: State) -> &'static str {
    match state {
        State::Down => "down",
        State::Greeting => "greeting",
        State::Up => "up",
        State::Silent => "silent",
        State::Fenced => "fenced",
        State::Closed => "closed",
    }
}
