//! Reduces a failing scenario to a small one that fails the same way: parts are removed, larger ones first,
//! while the rest still fails (Zeller's delta debugging, on structure instead of text).
//!
//! Any change alters the delays drawn, so every candidate is also tried with a few other seeds.

use super::generated_scenario::{Break, GeneratedHosts, GeneratedLink, GeneratedScenario};
use metamorph_families::generated::{Failing, GeneratedSwarm, Smaller, parts};

/// Seeds tried besides the current one.
const SEEDS: [u64; 3] = [1, 2, 3];

/// Reduces a scenario step by step, keeping a reduction if `fails` returns true for the result. Calls `fails`
/// at most `budget` times. Returns the smallest failing scenario and the number of calls.
pub fn shrink(
    draft: &GeneratedScenario,
    budget: u64,
    mut fails: impl FnMut(&GeneratedScenario) -> bool,
) -> (GeneratedScenario, u64) {
    let (mut small, mut asked) = (draft.clone(), 0);
    loop {
        let mut smaller = None;
        'candidates: for candidate in candidates(&small) {
            for seed in [small.seed].into_iter().chain(SEEDS) {
                if asked == budget {
                    return (small, asked);
                }
                asked += 1;
                let candidate = GeneratedScenario { seed, ..candidate.clone() };
                if fails(&candidate) {
                    smaller = Some(candidate);
                    break 'candidates;
                }
            }
        }
        match smaller {
            Some(draft) => small = draft,
            None => return (small, asked),
        }
    }
}

/// Returns all slightly smaller or simpler drafts, the most effective reductions first. Repeated reduction
/// terminates.
fn candidates(draft: &GeneratedScenario) -> Vec<GeneratedScenario> {
    let mut found = Vec::new();
    for part in parts(draft.faults.len()) {
        let mut without = draft.clone();
        without.faults.drain(part);
        found.push(without);
    }
    for Smaller { swarm, gone, replaced } in draft.swarm.smaller() {
        found.push(if replaced { with_another(draft, swarm, gone.start) } else { with(draft, swarm, gone) });
    }
    simpler_link(draft, &mut found);
    simpler_faults(draft, &mut found);
    found
}

/// Returns the draft with `swarm`, which lacks the modules `gone`. Faults of these modules alone are removed,
/// and later modules are renumbered in the others.
fn with(
    draft: &GeneratedScenario,
    swarm: Box<dyn GeneratedSwarm>,
    gone: std::ops::Range<usize>,
) -> GeneratedScenario {
    let mut draft = GeneratedScenario { swarm, ..draft.clone() };
    for id in gone.rev() {
        draft.faults.retain_mut(|fault| match fault.what.without(id as u32) {
            Some(what) => {
                fault.what = what;
                true
            }
            None => false,
        });
        draft.link.own = draft.link.own.and_then(|own| own.without(id as u32));
    }
    draft
}

/// Returns the draft with `swarm`, which lacks the module `gone`; a module next to it by number takes over
/// its faults.
fn with_another(draft: &GeneratedScenario, swarm: Box<dyn GeneratedSwarm>, gone: usize) -> GeneratedScenario {
    let other = if gone == 0 { 1 } else { gone - 1 };
    let mut draft = draft.clone();
    for fault in &mut draft.faults {
        fault.what = fault.what.instead(gone as u32, other as u32);
    }
    if let Some(own) = draft.link.own.as_mut().filter(|own| own.module == gone as u32) {
        own.module = other as u32;
    }
    with(&draft, swarm, gone..gone + 1)
}

fn simpler_link(draft: &GeneratedScenario, found: &mut Vec<GeneratedScenario>) {
    let link = draft.link;
    let simpler = [
        GeneratedLink { delay: link.delay, ..GeneratedLink::default() },
        GeneratedLink { loss: 0, ..link },
        GeneratedLink { duplicate: 0, ..link },
        GeneratedLink { reorder: 0, ..link },
        GeneratedLink { corrupt: 0, ..link },
        GeneratedLink { quantiles: None, ..link },
        GeneratedLink { burst: None, ..link },
        GeneratedLink { own: None, ..link },
        GeneratedLink {
            hosts: link.hosts.map(|hosts| GeneratedHosts { loss: 0, delay: link.delay, ..hosts }),
            ..link
        },
        GeneratedLink { until: link.until.filter(|_| link.harms()), ..link },
        GeneratedLink { delay: (link.delay.1, link.delay.1), ..link },
    ];
    found.extend(
        simpler.into_iter().filter(|l| *l != link).map(|link| GeneratedScenario { link, ..draft.clone() }),
    );
    if link.hosts.is_some() {
        let mut without = GeneratedScenario { link: GeneratedLink { hosts: None, ..link }, ..draft.clone() };
        without.faults.retain(|fault| !matches!(fault.what, Break::KillHost(_)));
        found.push(without);
    }
    let failing = draft.failing;
    let simpler = [Failing { percent: 0, ..failing }, Failing { model: None, ..failing }];
    found.extend(
        simpler
            .into_iter()
            .filter(|other| *other != failing)
            .map(|failing| GeneratedScenario { failing, ..draft.clone() }),
    );
}

fn simpler_faults(draft: &GeneratedScenario, found: &mut Vec<GeneratedScenario>) {
    let whole = |millis: u64| millis / 1000 * 1000;
    for (i, fault) in draft.faults.iter().enumerate() {
        let lasts = fault.until.map(|until| until - fault.at);
        let earlier = [0, whole(fault.at / 2), whole(fault.at)];
        for at in earlier.into_iter().filter(|at| *at < fault.at) {
            let mut changed = draft.clone();
            (changed.faults[i].at, changed.faults[i].until) = (at, lasts.map(|l| at + l));
            found.push(changed);
        }
        if let Some(lasts) = lasts {
            for shorter in [whole(lasts / 2), whole(lasts)].into_iter().filter(|s| (1..lasts).contains(s)) {
                let mut changed = draft.clone();
                changed.faults[i].until = Some(fault.at + shorter);
                found.push(changed);
            }
        }
        if let Break::Partition(side) = &fault.what {
            for id in (0..side.len()).filter(|_| side.len() > 1) {
                let mut side = side.clone();
                side.remove(id);
                let mut changed = draft.clone();
                changed.faults[i].what = Break::Partition(side);
                found.push(changed);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::draw::draw;
    use super::*;
    use metamorph_processes::family::all;

    /// Whatever failure is kept, nothing unnecessary remains; and the rest can be run.
    #[test]
    fn leaves_out_what_does_not_matter() {
        let kills =
            |d: &GeneratedScenario| d.faults.iter().filter(|f| matches!(f.what, Break::Kill(_))).count();
        let mut shrunk = 0;
        for seed in 0..200 {
            let (draft, _) = draw(seed, Some(all()[0]));
            if kills(&draft) == 0 || draft.modules() < 4 {
                continue;
            }
            let fails = |d: &GeneratedScenario| {
                kills(d) >= 1 && d.modules() >= 3 && d.plan("small.toml", None).is_ok()
            };
            let (small, asked) = shrink(&draft, 20_000, fails);
            assert_eq!((small.faults.len(), small.modules(), small.faults[0].at), (1, 3, 0), "{small}");
            assert_eq!(small.link, GeneratedLink { delay: small.link.delay, ..GeneratedLink::default() });
            assert!(asked < 20_000 && small.goal_cells() == 1, "{small}");
            shrunk += 1;
        }
        assert!(shrunk > 10);
    }
}
