//! Elections as a family of modules: when a run is over, what must hold, and how modules and messages are shown.

use crate::leader::{Leader, Lowest, Setup};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Span;
use metamorph_sim_bridge::kernel::audited::Agents;
use metamorph_sim_bridge::kernel::graph_world::AgentCheck;
use metamorph_sim_bridge::world::invariants::Invariant;
use metamorph_world_controller::family::graphs::{GraphFamily, GraphProtocol};
use metamorph_world_controller::report::message_timeline::MessageLabel;
use metamorph_world_controller::view::visible::{Colour, Role};

/// The family, for `family::install`.
pub static ELECTION: GraphFamily<Leader> = GraphFamily::new();

const VOTER: Role = Role { name: "voter", colour: Colour::Idle, legend: "votes", about: "votes for {}" };
const AGREED: Role =
    Role { name: "agreed", colour: Colour::Done, legend: "names module 0", about: "names module {}" };

const INVARIANTS: [(Invariant, AgentCheck<Leader>); 1] =
    [(Invariant::new("none-names-a-higher-one"), none_names_a_higher_one)];

/// A module names itself or one with a lower number.
fn none_names_a_higher_one(agents: &Agents<'_, Leader>, id: ModuleId) -> Result<(), String> {
    let named = agents.get(id).map_or(id, Leader::lowest);
    if named <= id { Ok(()) } else { Err(format!("module {id} names {named}")) }
}

impl GraphProtocol for Leader {
    const NAME: &'static str = "election";
    const ABOUT: &'static str = "elect a leader";
    const ROLES: [Role; 3] = [VOTER, VOTER, AGREED];

    fn repeat(setup: &Setup) -> Span {
        setup.repeat
    }

    /// Modules have reached the goal if they name the lowest number that any living one names.
    fn reached(_: &Setup, reports: &[Option<Lowest>]) -> Vec<bool> {
        let lowest = reports.iter().flatten().map(|Lowest(named)| *named).min();
        reports.iter().map(|report| report.map(|Lowest(named)| named) == lowest).collect()
    }

    fn invariants() -> &'static [(Invariant, AgentCheck<Leader>)] {
        &INVARIANTS
    }

    fn label(Lowest(lowest): &Lowest) -> MessageLabel {
        MessageLabel::about("the lowest is", *lowest)
    }

    fn describe(Lowest(lowest): &Lowest) -> String {
        format!("the lowest number is {lowest}")
    }

    fn standing(Lowest(lowest): &Lowest) -> (u8, i32) {
        (if lowest.0 == 0 { 2 } else { 0 }, lowest.0 as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::agent::{Agent as _, Birth};
    use metamorph_protocol::ids::Incarnation;
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::time::Time;
    use metamorph_sim_bridge::kernel::audited::Swarm;
    use metamorph_world_controller::family;
    use metamorph_world_controller::report::schema::Report;
    use metamorph_world_controller::scenario::{LinkKind, Overrides};
    use std::sync::{Arc, Once};

    /// Runs the scenario of this crate on the simulated link.
    fn simulate(seed: u64, loss: &str) -> Report {
        static INSTALLED: Once = Once::new();
        INSTALLED.call_once(|| family::install(&[&ELECTION]).expect("nothing was read before"));
        let text = include_str!("../ring.toml").replace("10%", loss);
        let overrides = Overrides { link: LinkKind::Sim, seed: Some(seed), ..Overrides::default() };
        let plan = family::read_text("ring.toml", &text, &overrides).unwrap_or_else(|why| panic!("{why}"));
        let mut run = family::begin(&plan);
        run.run_until(Time::NEVER);
        run.report()
    }

    struct One(Leader);

    impl Swarm<Leader> for One {
        fn modules(&self) -> usize {
            6
        }
        fn living(&self, index: usize) -> Option<&Leader> {
            (index == 3).then_some(&self.0)
        }
        fn last(&self, index: usize) -> Option<&Leader> {
            self.living(index)
        }
    }

    /// In module 3 is the agent of module 5, which names itself.
    #[test]
    fn a_module_that_names_a_higher_one_is_found() {
        let (id, incarnation) = (ModuleId(5), Incarnation(0));
        let birth = Birth { id, incarnation, place: Cell::default(), seed: 1, born: Time::ZERO };
        let wrong = One(Leader::new(&Arc::default(), birth, Time::ZERO));
        let found = none_names_a_higher_one(&Agents::of(&wrong), ModuleId(3));
        assert_eq!(found, Err("module 3 names 5".to_owned()));
        assert_eq!(none_names_a_higher_one(&Agents::of(&wrong), ModuleId(4)), Ok(()));
    }

    #[test]
    fn one_seed_is_one_run() {
        assert_eq!(simulate(1, "10%").trace_hash, simulate(1, "10%").trace_hash);
        assert_ne!(simulate(1, "10%").trace_hash, simulate(2, "10%").trace_hash);
    }

    #[test]
    fn all_agree_though_messages_are_lost_and_a_module_dies() {
        for seed in 1..=20 {
            let report = simulate(seed, "30%");
            assert_eq!(
                (report.outcome.as_str(), report.agents.alive),
                ("built", 49),
                "seed {seed}: {report:?}"
            );
        }
    }

    #[test]
    fn nobody_agrees_if_nothing_arrives() {
        assert_eq!(simulate(1, "100%").outcome, "deadlock");
    }
}
