//! Protocols that are known to be wrong, and the invariants that say so: a harness that cannot see a
//! broken protocol break proves nothing about a sound one.

use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::goal::Growth;
use metamorph_protocol::sabotage::Sabotage;
use metamorph_protocol::time::Span;
use metamorph_sim_bridge::invariants::Invariant;
use metamorph_tests::growth::{Experiment, Ran, ball};

/// Runs a sabotaged experiment for a few seeds until an invariant breaks.
fn breaks(invariant: Invariant, seeds: u64, vary: impl Fn(Experiment) -> Experiment) {
    let mut last: Option<Ran> = None;
    for seed in 1..=seeds {
        let mut experiment = vary(Experiment::slab_to_sphere(20, seed));
        experiment.until_broken = true;
        let ran = experiment.run();
        if ran.broke(invariant) {
            return;
        }
        last = Some(ran);
    }
    let seen = last.map(|r| (r.outcome, r.violations.first().cloned()));
    panic!("{invariant} did not break within {seeds} seeds; the last run: {seen:?}");
}

fn sabotage(mut experiment: Experiment, defect: Sabotage) -> Experiment {
    experiment.setup.params.sabotage = Some(defect);
    experiment
}

/// The connection gradient as published is not safe when messages are late.
#[test]
fn the_published_gradient_tears_the_body() {
    breaks(Invariant::BodyConnected, 3, |mut e| {
        e.setup.params.connectivity = Connectivity::Gradient;
        e
    });
}

#[test]
fn without_sessions_late_messages_are_believed() {
    breaks(Invariant::SessionCurrent, 3, |mut e| {
        e.ignore_sessions = true;
        e
    });
}

#[test]
fn without_a_deadline_a_stopped_module_moves_too_late() {
    breaks(Invariant::MoveWithinLease, 6, |e| sabotage(e.pauses(Span::secs(60)), Sabotage::NoDeadline));
}

#[test]
fn forgetting_silent_children_lets_parents_leave() {
    breaks(Invariant::MoverHasNoDependants, 6, |e| {
        sabotage(e.pauses(Span::secs(300)), Sabotage::DropSilentChildren)
    });
}

#[test]
fn leaving_in_spite_of_locks_is_noticed() {
    breaks(Invariant::MoverSupported, 6, |e| sabotage(e, Sabotage::IgnoreLocks));
}

#[test]
fn believing_old_distances_makes_circles() {
    breaks(Invariant::FieldLoopFree, 3, |e| sabotage(e, Sabotage::AcceptStaleValues));
}

/// The rule that is enough for scaffolds walls in cells of a solid.
#[test]
fn any_lower_neighbour_is_not_enough_for_solids() {
    let walled_in = (1..=3).any(|seed| {
        let mut experiment = Experiment::slab_to_sphere(20, seed);
        experiment.setup.goals = vec![ball(20, Growth::Solid)];
        !sabotage(experiment, Sabotage::AnyLowerOnSolids).run().built()
    });
    assert!(walled_in, "every solid was built by the wrong rule");
}
