//! Determinism is a contract: same experiment and seed, same events and same final states.

use metamorph_tests::growth::Experiment;

fn eventful(seed: u64) -> Experiment {
    Experiment::slab_to_sphere(8, seed).loss("5%").crashes(5).restarts(5)
}

#[test]
fn a_run_repeats_itself_and_seeds_differ() {
    let (a, b, other) = (eventful(1).run(), eventful(1).run(), eventful(2).run());
    assert_eq!((a.trace, a.digest, a.tally), (b.trace, b.digest, b.tally));
    assert_ne!(a.trace, other.trace);
}

/// One number for debug and release builds, for every machine and every process. It changes with
/// the protocol; when it changes without that, determinism is broken.
#[test]
fn golden_trace() {
    let ran = eventful(1).run();
    assert_eq!(format!("{:016x}", ran.trace), "9d4e6fe9c0f06606");
}
