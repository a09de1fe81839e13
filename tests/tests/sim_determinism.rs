//! Determinism is a contract: same experiment and seed, same events and same final states.

use metamorph_protocol::defects::Defect;
use metamorph_protocol::time::Time;
use metamorph_tests::growth::Experiment;

fn eventful(seed: u64) -> Experiment {
    Experiment::slab_to_sphere(8, seed).loss("5%").crashes(5).restarts(5)
}

#[test]
fn a_run_repeats_itself_and_seeds_differ() {
    let (a, b, other) = (eventful(1).run(), eventful(1).run(), eventful(2).run());
    assert_eq!((a.trace, a.digest, a.state, a.tally), (b.trace, b.digest, b.state, b.tally));
    assert_ne!(a.trace, other.trace);
}

/// One number for debug and release builds, for every machine and every process. It changes with the
/// protocol; any other change of it means that determinism is broken.
#[test]
fn golden_trace() {
    let ran = eventful(1).run();
    assert_eq!(format!("{:016x}", ran.trace), "bda1c4050a189831");
}

/// The same for the sampled states of agents and bodies.
#[test]
fn golden_state() {
    let ran = eventful(1).run();
    assert_eq!(format!("{:016x}", ran.state), "ff63f226682c69b6");
}

/// A grant that is announced as long and ends early affects contents alone, until a module relies on it:
/// events are the same, states are not.
#[test]
fn contents_are_told_apart_where_events_are_not() {
    let begun = |defect| {
        let mut experiment = Experiment::slab_to_sphere(8, 1);
        experiment.setup.params.defect = defect;
        experiment.sim()
    };
    let (mut sound, mut broken) = (begun(None), begun(Some(Defect::ShortLease)));
    let mut told = (0..200).map(|i| {
        [&mut sound, &mut broken].map(|sim| {
            sim.run_until(Time(i * 100_000_000));
            (sim.trace().value(), sim.hashes().states)
        })
    });
    let Some(first) = told.find(|[a, b]| a != b) else { panic!("the defect makes no difference") };
    assert_eq!(first[0].0, first[1].0, "the states differ before the events do");
}
