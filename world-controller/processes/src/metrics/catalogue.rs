//! All metrics: their names, kinds, units and meanings, by the conventions of OpenMetrics. The text that is served, its
//! documentation and the dashboard hold to this list.

/// The kind of a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A value that rises and falls.
    Gauge,
    /// A count that only rises; its samples end in `_total`.
    Counter,
    /// A set of states, of which one holds: a sample for each, 1 or 0.
    StateSet,
    /// Labels that do not change during a run; its sample ends in `_info`.
    Info,
}

impl Kind {
    /// Returns the word of the format for this kind.
    pub const fn name(self) -> &'static str {
        match self {
            Kind::Gauge => "gauge",
            Kind::Counter => "counter",
            Kind::StateSet => "stateset",
            Kind::Info => "info",
        }
    }
    /// Returns the ending of the names of samples.
    pub const fn ending(self) -> &'static str {
        match self {
            Kind::Gauge | Kind::StateSet => "",
            Kind::Counter => "_total",
            Kind::Info => "_info",
        }
    }
}

/// A metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Metric {
    /// Its name, without the ending of its samples.
    pub name: &'static str,
    /// Its kind.
    pub kind: Kind,
    /// Its unit, with which the name ends.
    pub unit: Option<&'static str>,
    /// Its labels besides `run` and `host`.
    pub labels: &'static [&'static str],
    /// True if only the controller of a run has it, for the whole swarm.
    pub of_controller: bool,
    /// The meaning, in a sentence.
    pub meaning: &'static str,
}

impl Metric {
    /// Returns the name of its samples.
    pub fn sample(&self) -> String {
        format!("{}{}", self.name, self.kind.ending())
    }

    const fn new(name: &'static str, kind: Kind, meaning: &'static str) -> Metric {
        Metric { name, kind, unit: None, labels: &[], of_controller: false, meaning }
    }
    const fn of_controller(name: &'static str, kind: Kind, meaning: &'static str) -> Metric {
        Metric { of_controller: true, ..Metric::new(name, kind, meaning) }
    }
    const fn measured_in(self, unit: &'static str) -> Metric {
        Metric { unit: Some(unit), ..self }
    }
    const fn labels(self, labels: &'static [&'static str]) -> Metric {
        Metric { labels, ..self }
    }
}

/// The run.
pub const RUN: Metric = Metric::new(
    "metamorph_run",
    Kind::Info,
    "The run, with the version of the program; of a controller also its scenario, seed and link.",
)
.labels(&["scenario", "seed", "link", "version"]);
/// The state of the run.
pub const RUN_STATE: Metric = Metric::new(
    "metamorph_run_state",
    Kind::StateSet,
    "The state of the run: a daemon without one is idle, and when a run has ended its last numbers stay.",
);
/// Scenario time.
pub const SCENARIO_TIME: Metric =
    Metric::new("metamorph_scenario_time_seconds", Kind::Gauge, "Scenario time.").measured_in("seconds");
/// The share of the desired speed of the clock.
pub const CLOCK_SPEED: Metric = Metric::of_controller(
    "metamorph_clock_speed_ratio",
    Kind::Gauge,
    "The speed of scenario time as a share of the one asked for; below 1 while agents are late. Processes only.",
)
.measured_in("ratio");
/// The number of modules.
pub const MODULES: Metric =
    Metric::of_controller("metamorph_modules", Kind::Gauge, "Modules of the swarm, dead ones included.");
/// Live agents of the swarm.
pub const AGENTS_ALIVE: Metric =
    Metric::of_controller("metamorph_agents_alive", Kind::Gauge, "Live agents of the swarm, on all hosts.");
/// Live agents of one host.
pub const HOST_AGENTS: Metric = Metric::new(
    "metamorph_host_agents_alive",
    Kind::Gauge,
    "Live agents of this host. On the simulated link, those of all hosts.",
);
/// Restarts.
pub const RESTARTS: Metric =
    Metric::of_controller("metamorph_restarts", Kind::Counter, "Agents that were started after a death.");
/// Completed moves.
pub const MOVES: Metric = Metric::of_controller("metamorph_moves", Kind::Counter, "Moves completed.");
/// Standstills.
pub const STANDSTILLS: Metric = Metric::of_controller(
    "metamorph_standstills",
    Kind::Counter,
    "Standstills of the swarm that were noticed, with one that lasts.",
);
/// The number of the goal.
pub const GOAL: Metric =
    Metric::of_controller("metamorph_goal", Kind::Gauge, "The goal that is being built, from 1.");
/// Cells of the goal.
pub const GOAL_CELLS: Metric = Metric::of_controller(
    "metamorph_goal_cells",
    Kind::Gauge,
    "Cells of this goal, or what stands for them.",
);
/// Filled cells of the goal.
pub const GOAL_CELLS_FILLED: Metric =
    Metric::of_controller("metamorph_goal_cells_filled", Kind::Gauge, "Its cells that are filled.");
/// Messages.
pub const MESSAGES: Metric = Metric::new(
    "metamorph_messages",
    Kind::Counter,
    "Protocol messages by class and by what became of them, as the agents of this host count them; `sent` are those handed \
     to the link. On the simulated link, of all hosts.",
)
.labels(&["class", "fate"]);
/// Bytes of messages.
pub const SENT_BYTES: Metric =
    Metric::new("metamorph_sent_bytes", Kind::Counter, "Bytes of the messages sent, headers included.")
        .measured_in("bytes")
        .labels(&["class"]);
/// Links between hosts.
pub const LINK_STATE: Metric = Metric::new(
    "metamorph_link_state",
    Kind::StateSet,
    "The state of the link of this host to another one, the peer; of runs on several hosts.",
)
.labels(&["peer"]);
/// The clocks of other hosts.
pub const CLOCK_INTERVAL: Metric = Metric::new(
    "metamorph_clock_interval_seconds",
    Kind::Gauge,
    "Width of the interval in which the difference to the clock of another host, the peer, is known to be.",
)
.measured_in("seconds")
.labels(&["peer"]);

/// All metrics, in the order in which they are served.
pub const ALL: [Metric; 17] = [
    RUN,
    RUN_STATE,
    SCENARIO_TIME,
    CLOCK_SPEED,
    MODULES,
    AGENTS_ALIVE,
    HOST_AGENTS,
    RESTARTS,
    MOVES,
    STANDSTILLS,
    GOAL,
    GOAL_CELLS,
    GOAL_CELLS_FILLED,
    MESSAGES,
    SENT_BYTES,
    LINK_STATE,
    CLOCK_INTERVAL,
];

/// The labels that every sample has.
pub const COMMON_LABELS: [&str; 2] = ["run", "host"];

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn names_follow_the_conventions() {
        let names: BTreeSet<&str> = ALL.iter().map(|metric| metric.name).collect();
        assert_eq!(names.len(), ALL.len());
        for metric in ALL {
            let is_plain = |c: char| c.is_ascii_lowercase() || c == '_';
            assert!(metric.name.starts_with("metamorph_") && metric.name.chars().all(is_plain), "{metric:?}");
            assert!(metric.unit.is_none_or(|unit| metric.name.ends_with(&format!("_{unit}"))), "{metric:?}");
            for reserved in ["_total", "_info", "_created", "_count", "_sum", "_bucket"] {
                assert!(!metric.name.ends_with(reserved), "{metric:?}");
            }
            assert!(metric.meaning.ends_with('.'), "{metric:?}");
        }
    }
}
