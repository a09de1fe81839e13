//! Copies of simulated runs: a copy and its origin take the same events, whenever it was made, until one of them is disturbed.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::record::MessageName;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::kernel::change::ChangeKind;
use metamorph_tests::command::scenario;
use metamorph_world_controller::experiments::explore::draw::draw;
use metamorph_world_controller::family::{all, begin, begin_shown, read_file};
use metamorph_world_controller::run::simulated::{ForkError, SteppedRun};
use metamorph_world_controller::scenario::{LinkKind, Overrides, Plan};
use std::collections::BTreeSet;

/// Copies of each run.
const FORKS: u64 = 9;
/// Drawn scenarios of each family that is drawn.
const DRAWN: u64 = 60;

fn plan(name: &str) -> Plan {
    let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    read_file(&scenario(name), &overrides).unwrap()
}

/// Carries a run out to its end. Returns its hashes, its events and what it has counted.
fn finish(run: &mut dyn SteppedRun) -> (u64, u64, u64, String) {
    let mut events = 0;
    while run.step() {
        events += 1;
    }
    let (report, _) = run.conclude(false, Vec::new());
    let counted = format!(
        "{:?} {:?} {:?} {:?} {:?}",
        run.tally(),
        report.outcome,
        report.move_details,
        report.family_parts,
        report.standstills
    );
    (run.trace_hash(), run.state_hash(), events, counted)
}

/// Copies a run at instants drawn from a seed and at its end, and lets every copy run to its end.
fn copies_end_alike(plan: &Plan, what: &str) {
    let (trace, states, events, counted) = finish(&mut *begin(plan));
    let mut random = Rng::named(plan.seed, "forks", 0);
    let mut at: Vec<u64> = (1..FORKS).map(|_| random.below(events)).chain([events]).collect();
    at.sort_unstable();
    let mut origin = begin(plan);
    let mut done = 0;
    for at in at {
        while done < at && origin.step() {
            done += 1;
        }
        let mut copy = origin.fork().unwrap();
        assert_eq!((copy.now(), copy.trace_hash()), (origin.now(), origin.trace_hash()), "{what} at {at}");
        let mut second = copy.fork().unwrap();
        let (ended, again) = (finish(&mut *copy), finish(&mut *second));
        let expected = (trace, states, events - at, counted.clone());
        assert_eq!(ended, expected, "{what}: the copy after {at} of {events} events");
        assert_eq!(again, expected, "{what}: a copy of that copy");
    }
    let (again, at_end, ..) = finish(&mut *origin);
    assert_eq!((again, at_end), (trace, states), "{what}: the origin of the copies");
}

#[test]
fn copies_of_shipped_scenarios_end_as_their_origins() {
    for name in [
        "swarm.toml",
        "faults.toml",
        "a-third-dies.toml",
        "box.toml",
        "chair-hardware.toml",
        "line-to-loop.toml",
    ] {
        copies_end_alike(&plan(name), name);
    }
}

#[test]
fn copies_of_drawn_scenarios_end_as_their_origins() {
    for family in all().iter().copied().filter(|family| family.is_drawn()) {
        for seed in (0..DRAWN).map(|i| (1 << 41) + 5_000 + i) {
            copies_end_alike(&draw(seed, Some(family)).1, &format!("{} {seed}", family.name()));
        }
    }
}

/// Reseeds a copy at an instant, and compares its end with that of the scenario with this change. Returns its hash.
fn reseeding_is_a_change(plan: &Plan, origin: &dyn SteppedRun, kind: ChangeKind, what: &str) -> u64 {
    let mut copy = origin.fork().unwrap();
    let change = copy.change(kind);
    assert_eq!(change.after, origin.events(), "{what}");
    let mut changed = plan.clone();
    changed.add_change(change);
    let (ended, again) = (finish(&mut *copy), finish(&mut *begin(&changed)));
    assert_eq!((ended.0, ended.1, &ended.3), (again.0, again.1, &again.3), "{what}: {change}");
    ended.0
}

/// Reseeds copies of a run at two instants. Returns the number of copies whose trace differs from that of the run.
fn reseeded(plan: &Plan, what: &str) -> usize {
    let (trace, _, events, _) = finish(&mut *begin(plan));
    let mut random = Rng::named(plan.seed, "reseeded", 0);
    let mut origin = begin(plan);
    let mut at = [random.below(events / 2), random.below(events)];
    at.sort_unstable();
    let mut ends = BTreeSet::new();
    for at in at {
        while origin.events() < at && origin.step() {}
        let id = ModuleId(random.below(plan.swarm.len() as u64) as u32);
        let number = random.below(40) as u32;
        let lost = MessageName { from: id, incarnation: Incarnation(0), number };
        let kinds = [ChangeKind::Links(1), ChangeKind::All(1), ChangeKind::Links(2)];
        for kind in kinds.into_iter().chain([ChangeKind::Lose(lost), ChangeKind::Sleep(id, Span::secs(1))]) {
            ends.insert(reseeding_is_a_change(plan, &*origin, kind, what));
        }
    }
    ends.remove(&trace);
    ends.len()
}

#[test]
fn reseeded_copies_are_runs_of_their_changes() {
    for name in ["swarm.toml", "faults.toml", "a-third-dies.toml", "chair-hardware.toml", "line-to-loop.toml"]
    {
        let differ = reseeded(&plan(name), name);
        assert!(differ >= 3, "{name}: {differ} of 6 copies differ");
    }
    for family in all().iter().copied().filter(|family| family.is_drawn()) {
        let differ: usize = (0..DRAWN / 2)
            .map(|i| (1 << 41) + 6_000 + i)
            .map(|seed| reseeded(&draw(seed, Some(family)).1, &format!("{} {seed}", family.name())))
            .sum();
        assert!(differ as u64 > DRAWN, "{}: {differ} copies differ", family.name());
    }
}

/// A message that is withheld is counted as lost, once; a process that sleeps handles everything afterwards.
#[test]
fn a_message_can_be_lost_and_a_process_can_sleep() {
    let plan = plan("swarm.toml");
    let lost = |change: &str| {
        let mut changed = plan.clone();
        changed.add_change(change.parse().unwrap());
        let mut run = begin(&changed);
        // Before anything that the change could bring about.
        run.run_until(Time(60_000_000));
        let (mut whole, counts) = (begin(&plan), run.tally().total());
        whole.run_until(Time(60_000_000));
        let before = whole.tally().total();
        (counts.lost - before.lost, before.delivered as i64 - counts.delivered as i64)
    };
    assert_eq!(lost("lose=7.0.0@0"), (1, 1));
    assert_eq!(lost("lose=7.0.4000000@0"), (0, 0));
    let (lost_asleep, late) = lost("sleep=7/50ms@0");
    assert_eq!(lost_asleep, 0);
    assert!(late >= 0);
    // A copy that is changed between two events is the run of the change, too; and so is one of a run whose process sleeps.
    let mut origin = begin(&plan);
    origin.run_until(Time(1_234_567_890));
    reseeding_is_a_change(&plan, &*origin, ChangeKind::Sleep(ModuleId(7), Span::secs(3)), "between events");
    let mut asleep = origin.fork().unwrap();
    let mut changed = plan.clone();
    changed.add_change(asleep.change(ChangeKind::Sleep(ModuleId(7), Span::secs(3))));
    reseeding_is_a_change(&changed, &*asleep, ChangeKind::Links(1), "asleep");
}

/// The end of a sleep wakes nothing that was killed, started or stopped since: a later sleep lasts as long as it should.
#[test]
fn a_sleep_ends_with_its_process() {
    for fault in ["kill 7", "pause 7"] {
        let mut run = begin(&plan("swarm.toml"));
        run.run_until(Time(1_000_000_000));
        run.change(ChangeKind::Sleep(ModuleId(7), Span::secs(4)));
        run.run_until(Time(2_000_000_000));
        run.inject(fault.parse().unwrap()).unwrap();
        run.run_until(Time(2_500_000_000));
        let again = if fault.starts_with("kill") { "restart 7" } else { "resume 7" };
        run.inject(again.parse().unwrap()).unwrap();
        run.run_until(Time(3_000_000_000));
        run.change(ChangeKind::Sleep(ModuleId(7), Span::secs(4)));
        let asleep = run.module(ModuleId(7)).summary;
        // The first sleep would have ended at 5 s, the second one ends at 7 s.
        run.run_until(Time(6_900_000_000));
        assert_eq!(run.module(ModuleId(7)).summary, asleep, "{fault}");
        let before = run.tally().total().sent;
        run.run_until(Time(9_000_000_000));
        assert!(run.tally().total().sent > before, "{fault}");
    }
}

/// A copy of a copy, each reseeded, is the run of two changes.
#[test]
fn changes_of_copies_of_copies_add_up() {
    let plan = plan("swarm.toml");
    let mut origin = begin(&plan);
    origin.run_until(Time(1_000_000_000));
    let mut copy = origin.fork().unwrap();
    let first = copy.change(ChangeKind::All(3));
    copy.run_until(Time(2_000_000_000));
    let mut copy = copy.fork().unwrap();
    let second = copy.change(ChangeKind::Links(4));
    let mut changed = plan.clone();
    [second, first].into_iter().for_each(|change| changed.add_change(change));
    let ended = finish(&mut *copy);
    assert_eq!(finish(&mut *begin(&changed)), (ended.0, ended.1, events(&changed), ended.3));
    let repeat = copy.report().repeat;
    assert!(repeat.contains(&format!("--change {first} --change {second}")), "{repeat}");
}

/// Returns the number of events of a whole run.
fn events(plan: &Plan) -> u64 {
    finish(&mut *begin(plan)).2
}

/// A copy that is disturbed is the run of the scenario with that fault, and its origin does not notice.
#[test]
fn a_fault_in_a_copy_strikes_the_copy_alone() {
    let plan = plan("swarm.toml");
    let undisturbed = finish(&mut *begin(&plan));
    let mut origin = begin(&plan);
    origin.run_until(Time(2_000_000_000));
    let mut copies = [origin.fork().unwrap(), origin.fork().unwrap()];
    for (copy, id) in copies.iter_mut().zip([7, 30]) {
        copy.inject(format!("kill {id}").parse().unwrap()).unwrap();
    }
    let ends = copies.each_mut().map(|copy| finish(&mut **copy));
    assert_eq!(finish(&mut *origin).0, undisturbed.0);
    assert!(ends[0].0 != ends[1].0 && ends[0].0 != undisturbed.0);
    assert!(!copies[0].module(ModuleId(7)).is_alive && copies[0].module(ModuleId(30)).is_alive);
    let mut again = begin(&plan);
    again.run_until(Time(2_000_000_000));
    again.inject("kill 7".parse().unwrap()).unwrap();
    assert_eq!(finish(&mut *again).0, ends[0].0);
}

#[test]
fn runs_that_cannot_be_copied_say_why() {
    let walking = begin(&plan("quadruped.toml")).fork();
    assert_eq!(walking.err(), Some(ForkError::Family("walking-module")));
    let (recorded, _) = begin_shown(&plan("swarm.toml"));
    assert_eq!(recorded.fork().err(), Some(ForkError::Recorded));
}
