//! Generates a scenario from a seed: world, start, goals, strategy, link and faults. Worlds are small,
//! because errors among many modules also occur among few, where they can be understood.
//!
//! Each kind of fault is left out of some runs at random, sometimes all kinds: a frequent fault hides errors
//! that only occur without it. Absent: the published connection gradient, which is known to split bodies when
//! messages are late.

use super::commands;
use super::generated_scenario::{
    Break, GeneratedFault, GeneratedHosts, GeneratedLink, GeneratedScenario, OwnLink,
};
use metamorph_families::generated::{Dice, Failing};
use metamorph_processes::family::{Family, all};
use metamorph_protocol::rng::Rng;
use metamorph_scenario::Plan;
use metamorph_scenario::family::fault_keys;
use metamorph_sim_bridge::director::rescue::Rescue;

/// Largest number of attempts to draw a scenario that can be run; some are invalid, such as one with more goals than
/// the floor has room for.
const TRIES_MAX: u64 = 40;

/// Which scenarios are drawn.
#[derive(Clone, Copy, Default)]
pub struct Drawn {
    /// One family only; `None` for all.
    pub family: Option<&'static dyn Family>,
    /// Swarms with passive elements only, of a family that has such. Of others they are drawn without.
    pub elements: bool,
    /// The help of the controller; `None` if it is drawn.
    pub rescue: Option<Rescue>,
}

impl From<Option<&'static dyn Family>> for Drawn {
    fn from(family: Option<&'static dyn Family>) -> Drawn {
        Drawn { family, ..Drawn::default() }
    }
}

impl Drawn {
    /// Returns the options that draw the same.
    pub fn options(self) -> String {
        let family = self.family.map_or(String::new(), |f| format!(" --family {}", f.name()));
        let rescue = self.rescue.map_or(String::new(), |level| format!(" --rescue {level}"));
        format!("{family}{}{rescue}", if self.elements { " --elements" } else { "" })
    }
}

/// Returns the scenario of a seed, and its plan.
pub fn draw(seed: u64, which: impl Into<Drawn>) -> (GeneratedScenario, Plan) {
    let which = which.into();
    // Of all families only one has elements.
    let with_elements = || all().iter().copied().find(|f| f.has_elements()).filter(|_| which.elements);
    let family = which.family.or_else(with_elements);
    for attempt in 0..TRIES_MAX {
        let mut dice = Dice(Rng::named(seed, "explore", attempt));
        let family = family.unwrap_or_else(|| dice.pick(&drawn()));
        let elements = which.elements && family.has_elements();
        let mut draft = draft(&mut dice, seed, family, elements);
        draft.rescue = which.rescue.unwrap_or(draft.rescue);
        if let Some(drawn) = complete(draft) {
            return drawn;
        }
    }
    let rescue = which.rescue.unwrap_or_default();
    complete(GeneratedScenario { seed, rescue, ..smallest(family.unwrap_or(all()[0])) })
        .expect("invariant: the smallest scenario can be read, whatever its seed")
}

/// Returns the families that are drawn if none is named.
fn drawn() -> Vec<&'static dyn Family> {
    all().iter().copied().filter(|family| family.is_drawn()).collect()
}

/// Creates the plan, and stores what its seed decides in the draft.
fn complete(mut draft: GeneratedScenario) -> Option<(GeneratedScenario, Plan)> {
    let plan = draft.plan("explored.toml", None).ok()?;
    if draft.swarm.settle(&plan.swarm) {
        let plan = draft.plan("explored.toml", None).ok()?;
        return Some((draft, plan));
    }
    Some((draft, plan))
}

/// Returns a minimal scenario of the family.
fn smallest(family: &dyn Family) -> GeneratedScenario {
    GeneratedScenario {
        description: String::new(),
        seed: 0,
        swarm: family.smallest(),
        failing: Failing::default(),
        link: GeneratedLink { delay: (10, 100), ..GeneratedLink::default() },
        faults: Vec::new(),
        rescue: Rescue::default(),
        patience: None,
    }
}

/// Number of the first seed for which the help of the controller is drawn. With smaller seeds it is the default.
const RESCUE_FROM: u64 = 1 << 39;

fn rescue(seed: u64) -> Rescue {
    if seed < RESCUE_FROM {
        return Rescue::default();
    }
    Rescue::ALL[Rng::named(seed, "explore, rescue", 0).below(Rescue::ALL.len() as u64) as usize]
}

/// Number of the first seed that may draw permanent impairments. Smaller seeds draw the same scenarios as before these
/// were added.
const LASTING_FROM: u64 = 1 << 32;

/// Returns true if the impairments are permanent: in one of four runs that have impairments but no failing
/// moves, because the default bounds account for the link, but not for repeated failures of moves.
fn lasts(draft: &GeneratedScenario) -> bool {
    let drawn = || Rng::named(draft.seed, "explore, lasting harm", 0).below(4) == 0;
    draft.seed >= LASTING_FROM && draft.link.harms() && draft.failing == Failing::default() && drawn()
}

/// Number of the first seed for which models of connections are drawn.
const CONNECTIONS_FROM: u64 = 1 << 41;

/// Draws a model of connections in one of two runs of a family that has connections.
fn connections(seed: u64, family: &dyn Family) -> Option<(u8, u16)> {
    let mut dice = Dice(Rng::named(seed, "explore, connections", 0));
    // On joints that yield by more, many landings never close.
    let model = (dice.pick(&[0, 3, 5, 8]), dice.pick(&[0, 50, 100]));
    (seed >= CONNECTIONS_FROM && family.has_connections() && dice.once_in(2)).then_some(model)
}

/// Draws what all families share.
fn draft(dice: &mut Dice, seed: u64, family: &dyn Family, elements: bool) -> GeneratedScenario {
    let mut draft = GeneratedScenario {
        description: String::new(),
        seed,
        swarm: if elements { family.generate_with_elements(dice) } else { family.generate(dice) },
        failing: Failing { percent: 0, model: connections(seed, family) },
        link: link(dice),
        faults: Vec::new(),
        rescue: rescue(seed),
        patience: None,
    };
    own_links(&mut draft);
    if !dice.once_in(6) {
        if dice.once_in(3) {
            draft.failing.percent = dice.pick(&[2, 10, 30]);
        }
        draft.faults = faults(dice, &draft);
        draft.faults.retain(|fault| fault_keys(family).contains(&fault.what.key()));
    }
    let commands = commands::draw(&draft, family);
    draft.faults.extend(commands);
    let (hosts, outages) = hosts(seed, draft.modules());
    draft.link.hosts = hosts;
    draft.faults.extend(outages);
    draft.link.until = end_of_harm(dice, &draft);
    draft.patience = family.patience(draft.failing != Failing::default(), draft.link.longest());
    if lasts(&draft) {
        // The bounds follow from the link.
        (draft.link.until, draft.patience) = (None, None);
    }
    draft
}

fn link(dice: &mut Dice) -> GeneratedLink {
    let delay = match dice.0.below(10) {
        0 => (0, 0),
        1 => (1, 10),
        2 => (500, 500),
        3 => (0, 3000),
        4 | 5 => (10, 800),
        _ => (10, 100),
    };
    // Each impairment is present in one of three runs.
    let mut percent = |of: &[u8]| if dice.once_in(3) { dice.pick(of) } else { 0 };
    GeneratedLink {
        delay,
        loss: percent(&[1, 5, 20]),
        duplicate: percent(&[2, 20]),
        reorder: percent(&[2, 20]),
        corrupt: percent(&[1, 5]),
        until: None,
        quantiles: None,
        burst: None,
        own: None,
        hosts: None,
    }
}

/// Number of the first seed for which several hosts are drawn, which go down and come back.
const HOSTS_FROM: u64 = 1 << 40;
/// Largest number of hosts drawn.
const HOSTS_MAX: u64 = 4;

/// Draws hosts, if the seed is large enough and there are modules for them.
fn hosts(seed: u64, modules: usize) -> (Option<GeneratedHosts>, Vec<GeneratedFault>) {
    if seed < HOSTS_FROM || modules < 2 {
        return (None, Vec::new());
    }
    let mut dice = Dice(Rng::named(seed, "explore, hosts", 0));
    let count = dice.within(2, HOSTS_MAX.min(modules as u64)) as u16;
    let fence = (!dice.once_in(4)).then(|| dice.pick(&[500, 3_000, 10_000, 30_000]));
    let delay = dice.pick(&[(0, 0), (10, 100), (300, 900), (0, 3_000)]);
    let drawn = GeneratedHosts { count, delay, loss: dice.pick(&[0, 0, 5, 20]), fence };
    // One of them stays, so that there is room for the modules of the others.
    let stays = dice.0.below(u64::from(count)) as u16;
    let horizon = dice.pick(&[500, 2_000, 6_000]);
    let mut faults = Vec::new();
    for host in (0..count).filter(|host| *host != stays) {
        let at = dice.within(0, horizon) * 10;
        let lasts = dice.pick(&[500, 3_000, 15_000, 60_000]);
        let until = (fence.is_some() && !dice.once_in(3)).then_some(at + lasts);
        if !dice.once_in(3) {
            faults.push(GeneratedFault { what: Break::KillHost(host), at, until });
        }
    }
    (Some(drawn), faults)
}

/// Number of the first seed for which quantiles of the delay, bursts and links of single modules are drawn.
const LINKS_FROM: u64 = 1 << 36;

/// Draws each of them in one of three runs.
fn own_links(draft: &mut GeneratedScenario) {
    if draft.seed < LINKS_FROM {
        return;
    }
    let mut dice = Dice(Rng::named(draft.seed, "explore, links", 0));
    if dice.once_in(3) {
        draft.link.quantiles = Some(dice.pick(&[[2, 20, 80], [50, 400, 2_000], [10, 1_000, 3_000]]));
    }
    if dice.once_in(3) {
        draft.link.burst = Some(dice.pick(&[[1, 10, 90], [5, 50, 100], [2, 5, 40]]));
    }
    if dice.once_in(3) {
        draft.link.own = Some(OwnLink {
            module: dice.0.below(draft.modules() as u64) as u32,
            one_way: dice.once_in(2),
            delay: dice.pick(&[(0, 0), (300, 900), (0, 3_000)]),
            loss: dice.pick(&[0, 20, 50]),
        });
    }
}

/// Draws the end of the impairments in milliseconds, which is not before the end of the last fault;
/// `None` without impairments. Delays are permanent.
fn end_of_harm(dice: &mut Dice, draft: &GeneratedScenario) -> Option<u64> {
    let least = dice.pick(&[10_000, 60_000, 150_000, 600_000]);
    draft.link.harms().then(|| draft.faults.iter().map(|f| f.until.unwrap_or(f.at)).fold(least, u64::max))
}

fn faults(dice: &mut Dice, draft: &GeneratedScenario) -> Vec<GeneratedFault> {
    let (modules, mut faults) = (draft.modules() as u64, Vec::new());
    let most = modules.div_ceil(4).min(4);
    let horizon = dice.pick(&[5_000, 20_000, 60_000, 150_000]);
    // Each kind is left out in half of the runs.
    let kinds = dice.0.below(64);
    for kind in (0..6).filter(|kind| kinds >> kind & 1 == 1) {
        for _ in 0..dice.within(1, most) {
            let id = dice.0.below(modules) as u32;
            let at = dice.within(0, horizon / 10) * 10;
            let until = at + dice.pick(&[500, 3_000, 15_000, 60_000, 200_000]);
            let (what, until) = match kind {
                0 => (Break::Kill(id), None),
                1 => (Break::Restart(id), None),
                2 => (Break::Pause(id), Some(until)),
                3 => (Break::Stick(id), Some(until).filter(|_| !dice.once_in(3))),
                4 => {
                    let side: Vec<u32> = (0..modules as u32).filter(|_| dice.once_in(3)).collect();
                    let side = if side.is_empty() { vec![id] } else { side };
                    (Break::Partition(side), Some(until))
                }
                _ => match draft.swarm.obstacle(dice) {
                    None => continue,
                    Some(cell) => (Break::Obstacle(cell), Some(until).filter(|_| !dice.once_in(4))),
                },
            };
            faults.push(GeneratedFault { what, at, until });
        }
    }
    if dice.once_in(4) {
        storm(dice, modules, &mut faults);
    }
    for element in 0..draft.swarm.elements() {
        for _ in 0..dice.pick(&[0, 0, 1, 3]) {
            let at = dice.within(0, 30_000) * 10;
            faults.push(GeneratedFault { what: Break::Drop(element), at, until: None });
        }
    }
    faults
}

/// Draws many pauses that outlast a lease, or restarts, during the busiest time, the only one at which
/// time-outs and earlier promises matter.
fn storm(dice: &mut Dice, modules: u64, faults: &mut Vec<GeneratedFault>) {
    let (restarts, lasts) = (dice.pick(&[0, 1, 4]), dice.pick(&[9_000, 15_000, 55_000]));
    for _ in 0..dice.within(4, 12) {
        let (id, at) = (dice.0.below(modules) as u32, dice.within(0, 3_000) * 10);
        faults.push(match dice.0.below(4) < restarts {
            true => GeneratedFault { what: Break::Restart(id), at, until: None },
            false => GeneratedFault { what: Break::Pause(id), at, until: Some(at + lasts) },
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::link::Lost;
    use std::collections::BTreeSet;

    #[test]
    fn the_smallest_can_always_be_run() {
        for family in all() {
            let runs = |seed| complete(GeneratedScenario { seed, ..smallest(*family) }).is_some();
            assert!((0..20).all(runs), "{}", family.name());
        }
    }

    /// A seed determines the scenario, and the draft equals the plan.
    #[test]
    fn a_seed_decides_on_everything() {
        let mut texts = BTreeSet::new();
        for seed in 0..60 {
            let (draft, plan) = draw(seed, Drawn::default());
            assert_eq!(draft.to_string(), draw(seed, Drawn::default()).0.to_string());
            assert_eq!((plan.seed, plan.swarm.len()), (seed, draft.modules()));
            let harms = |f: &GeneratedFault| !matches!(f.what, Break::Partition(_));
            let events: usize =
                draft.faults.iter().filter(|f| harms(f)).map(|f| 1 + usize::from(f.until.is_some())).sum();
            assert_eq!(plan.schedule.len(), events, "{draft}");
            texts.insert(draft.to_string());
        }
        assert_eq!(texts.len(), 60);
    }

    /// All levels of help are drawn, for large seeds only, and an option decides for all.
    #[test]
    fn the_help_of_the_controller_is_drawn() {
        let drawn = |from: u64, which: Drawn| -> BTreeSet<Rescue> {
            (from..from + 20).map(|seed| draw(seed, which).1.rescue).collect()
        };
        let cubes = Drawn::from(Some(all()[0]));
        assert_eq!(drawn(0, cubes), BTreeSet::from([Rescue::Plans]));
        assert_eq!(drawn(RESCUE_FROM, cubes), BTreeSet::from(Rescue::ALL));
        for level in Rescue::ALL {
            let chosen = Drawn { rescue: Some(level), ..cubes };
            assert_eq!(drawn(0, chosen), BTreeSet::from([level]));
            assert!(chosen.options().ends_with(&format!("--rescue {level}")));
        }
    }

    /// Quantiles, bursts and links of their own are drawn, alone and together, for large seeds only.
    #[test]
    fn links_of_every_kind_are_drawn() {
        let kinds = |from: u64| -> BTreeSet<[bool; 3]> {
            let link = |seed| draw(seed, Some(all()[0])).1.link;
            (from..from + 300)
                .map(link)
                .map(|link| [link.quantiles.is_some(), link.burst.is_some(), !link.between.is_empty()])
                .collect()
        };
        assert_eq!(kinds(0), BTreeSet::from([[false; 3]]));
        assert_eq!(kinds(LINKS_FROM).len(), 8);
    }

    /// Hosts that are lost, with modules that crash or start elsewhere, and hosts that are back are drawn, for large seeds only.
    #[test]
    fn hosts_are_drawn() {
        let kinds = |from: u64| -> BTreeSet<(bool, bool, bool)> {
            let kind = |seed| {
                let (draft, plan) = draw(seed, Some(all()[0]));
                let lost = plan.link.hosts.as_ref().map(|hosts| hosts.lost());
                let struck = |f: &&GeneratedFault| matches!(f.what, Break::KillHost(_));
                let is_back = draft.faults.iter().filter(struck).any(|f| f.until.is_some());
                (lost.is_some(), matches!(lost, Some(Lost::Elsewhere { .. })), is_back)
            };
            (from..from + 60).map(kind).collect()
        };
        assert_eq!(kinds(RESCUE_FROM), BTreeSet::from([(false, false, false)]));
        let drawn = kinds(HOSTS_FROM);
        assert!(
            [(true, true, true), (true, true, false), (true, false, false)].iter().all(|k| drawn.contains(k))
        );
    }

    /// Permanent impairments are drawn, with the bounds that follow from them, and smaller seeds draw none.
    #[test]
    fn harm_may_last() {
        let lasting = |seed: u64| {
            let (draft, plan) = draw(seed, Some(all()[0]));
            let lasts = draft.link.harms() && draft.link.until.is_none();
            assert!(!lasts || (draft.patience.is_none() && plan.link.harmless_from.is_none()), "{draft}");
            lasts
        };
        assert!((0..200).all(|seed| !lasting(seed)));
        assert!((LASTING_FROM..LASTING_FROM + 200).filter(|seed| lasting(*seed)).count() > 10);
    }
}
