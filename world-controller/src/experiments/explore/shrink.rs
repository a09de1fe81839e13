//! From a scenario that fails to a small one that fails the same way: parts are left out, larger ones
//! first, as long as what is left still fails (Zeller's delta debugging, on structure instead of text).
//!
//! A change anywhere draws different delays, so every candidate is also tried with a few other seeds.

use super::draft::{Break, CubeDraft, Draft, LinkDraft, MetamoduleDraft, SwarmDraft};
use metamorph_protocol::metamodule::params::Teller;

/// Seeds tried besides the present one.
const SEEDS: [u64; 3] = [1, 2, 3];

/// Leaves out what can be left out while `fails` says that it still fails, asking it at most `budget`
/// times. Says how often it was asked.
pub fn shrink(draft: &Draft, budget: u64, mut fails: impl FnMut(&Draft) -> bool) -> (Draft, u64) {
    let (mut small, mut asked) = (draft.clone(), 0);
    loop {
        let mut smaller = None;
        'candidates: for candidate in candidates(&small) {
            for seed in [small.seed].into_iter().chain(SEEDS) {
                if asked == budget {
                    return (small, asked);
                }
                asked += 1;
                let candidate = Draft { seed, ..candidate.clone() };
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

/// Everything that is a little smaller or simpler, what gains most first. No chain of candidates is
/// endless.
fn candidates(draft: &Draft) -> Vec<Draft> {
    let mut found = Vec::new();
    for part in parts(draft.faults.len()) {
        let mut without = draft.clone();
        without.faults.drain(part);
        found.push(without);
    }
    match &draft.swarm {
        SwarmDraft::Cubes(cubes) => fewer_cubes(draft, cubes, &mut found),
        SwarmDraft::Metamodules(metamodules) => fewer_metamodules(draft, metamodules, &mut found),
    }
    simpler_link(draft, &mut found);
    simpler_faults(draft, &mut found);
    found
}

/// Halves, quarters, and so on down to single elements.
fn parts(len: usize) -> Vec<std::ops::Range<usize>> {
    let (mut parts, mut size) = (Vec::new(), len);
    while size > 0 {
        parts.extend((0..len).step_by(size).map(|from| from..(from + size).min(len)));
        size /= 2;
    }
    parts
}

/// A draft of another swarm from which these modules are gone.
fn with(draft: &Draft, swarm: SwarmDraft, gone: std::ops::Range<usize>) -> Draft {
    let mut draft = Draft { swarm, ..draft.clone() };
    for id in gone.rev() {
        draft.faults.retain_mut(|fault| match fault.what.without(id as u32) {
            Some(what) => {
                fault.what = what;
                true
            }
            None => false,
        });
    }
    draft
}

/// The same, and another module suffers what this one would have.
fn with_another(draft: &Draft, swarm: SwarmDraft, gone: usize) -> Draft {
    let other = if gone == 0 { 1 } else { gone - 1 };
    let mut draft = draft.clone();
    for fault in &mut draft.faults {
        fault.what = fault.what.instead(gone as u32, other as u32);
    }
    with(&draft, swarm, gone..gone + 1)
}

fn fewer_cubes(draft: &Draft, cubes: &CubeDraft, found: &mut Vec<Draft>) {
    let mut add = |cubes: CubeDraft, gone| found.push(with(draft, SwarmDraft::Cubes(cubes), gone));
    for goal in (0..cubes.goals.len()).filter(|_| cubes.goals.len() > 1) {
        let mut fewer = cubes.clone();
        fewer.goals.remove(goal);
        add(fewer, 0..0);
    }
    for (i, goal) in cubes.goals.iter().enumerate() {
        for part in parts(goal.cells.len()) {
            let mut fewer = cubes.clone();
            fewer.goals[i].cells.drain(part);
            add(fewer, 0..0);
        }
    }
    for part in parts(cubes.start.len()) {
        let mut fewer = cubes.clone();
        fewer.start.drain(part.clone());
        add(fewer, part);
    }
    // One module and one goal cell less, where there are no more modules than cells.
    for (i, goal) in cubes.goals.iter().enumerate().filter(|(_, g)| g.cells.len() >= cubes.start.len()) {
        for (id, cell) in (0..cubes.start.len()).flat_map(|m| (0..goal.cells.len()).map(move |c| (m, c))) {
            let mut fewer = cubes.clone();
            fewer.start.remove(id);
            fewer.goals[i].cells.remove(cell);
            add(fewer, id..id + 1);
        }
    }
    if !cubes.co_owners {
        add(CubeDraft { co_owners: true, ..cubes.clone() }, 0..0);
    }
    for id in (0..cubes.start.len()).filter(|_| cubes.start.len() > 1) {
        let mut fewer = cubes.clone();
        fewer.start.remove(id);
        found.push(with_another(draft, SwarmDraft::Cubes(fewer), id));
    }
}

fn fewer_metamodules(draft: &Draft, metamodules: &MetamoduleDraft, found: &mut Vec<Draft>) {
    let mut add = |m: MetamoduleDraft, gone| found.push(with(draft, SwarmDraft::Metamodules(m), gone));
    for goal in (0..metamodules.goals.len()).filter(|_| metamodules.goals.len() > 1) {
        let mut fewer = metamodules.clone();
        fewer.goals.remove(goal);
        add(fewer, 0..0);
    }
    let mut fewer_seeds = Vec::new();
    for (i, (_, goal)) in metamodules.goals.iter().enumerate() {
        for (j, level) in goal.levels.iter().enumerate() {
            for seed in 0..level.len() {
                let mut fewer = metamodules.clone();
                fewer.goals[i].1.levels[j].remove(seed);
                fewer.goals[i].1.levels.retain(|l| !l.is_empty());
                fewer_seeds.push(fewer);
            }
        }
    }
    let places = metamodules.start.as_ref().map_or(0, Vec::len);
    // With a seed less one metamodule more can be spared.
    for fewer in [metamodules.clone()].iter().chain(&fewer_seeds) {
        for id in 0..places {
            let mut fewer = fewer.clone();
            if let Ok(places) = &mut fewer.start {
                places.remove(id);
            }
            add(fewer, id..id + 1);
        }
    }
    fewer_seeds.into_iter().for_each(|fewer| add(fewer, 0..0));
    if metamodules.relocate {
        add(MetamoduleDraft { relocate: false, ..metamodules.clone() }, 0..0);
    }
    if metamodules.teller != Teller::Controller {
        add(MetamoduleDraft { teller: Teller::Controller, ..metamodules.clone() }, 0..0);
    }
}

fn simpler_link(draft: &Draft, found: &mut Vec<Draft>) {
    let link = draft.link;
    let simpler = [
        LinkDraft { delay: link.delay, ..LinkDraft::default() },
        LinkDraft { loss: 0, ..link },
        LinkDraft { duplicate: 0, ..link },
        LinkDraft { reorder: 0, ..link },
        LinkDraft { corrupt: 0, ..link },
        LinkDraft { until: link.until.filter(|_| link.harms()), ..link },
        LinkDraft { delay: (link.delay.1, link.delay.1), ..link },
    ];
    found.extend(simpler.into_iter().filter(|l| *l != link).map(|link| Draft { link, ..draft.clone() }));
    if draft.failed_connections > 0 {
        found.push(Draft { failed_connections: 0, ..draft.clone() });
    }
}

fn simpler_faults(draft: &Draft, found: &mut Vec<Draft>) {
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
    use metamorph_module_agent::Family;

    /// Whatever is asked for, nothing else is left; and what is left can be run.
    #[test]
    fn leaves_out_what_does_not_matter() {
        let kills = |d: &Draft| d.faults.iter().filter(|f| matches!(f.what, Break::Kill(_))).count();
        let mut shrunk = 0;
        for seed in 0..200 {
            let (draft, _) = draw(seed, Some(Family::Cube));
            if kills(&draft) == 0 || draft.modules() < 4 {
                continue;
            }
            let fails = |d: &Draft| kills(d) >= 1 && d.modules() >= 3 && d.plan("small.toml", None).is_ok();
            let (small, asked) = shrink(&draft, 20_000, fails);
            assert_eq!((small.faults.len(), small.modules(), small.faults[0].at), (1, 3, 0), "{small}");
            assert_eq!(small.link, LinkDraft { delay: small.link.delay, ..LinkDraft::default() });
            assert!(asked < 20_000 && small.goal_cells() == 1, "{small}");
            shrunk += 1;
        }
        assert!(shrunk > 10);
    }

    #[test]
    fn parts_are_all_the_halves() {
        assert_eq!(parts(3), [0..3, 0..1, 1..2, 2..3]);
        assert!(parts(0).is_empty());
    }
}
