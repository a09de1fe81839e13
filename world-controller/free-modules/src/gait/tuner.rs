//! Gaits to try while a structure walks: known ones first, then those that a learner asks for.
//!
//! After a failure the network is built again without the joints of dead modules. The first gaits to try are the one of
//! a gait file for this failure, if there is one, and the former gait as far as its joints are left. The learner begins
//! at the faster of them, or in the middle of the space if that one is of no use any more. With a repertoire, elites
//! come before the learner.

use super::ask_tell::{Learner, Method, Point, Scored};
use super::elites::{Elite, Order};
use super::space::Space;
use metamorph_protocol::free_module::network::NetworkKind;
use metamorph_protocol::free_module::structure::Structure;
use metamorph_protocol::ids::ModuleId;
use metamorph_sim_bridge::free_module::walking::tuner::{Gait, Tuner};
use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

/// The share of the speed of the whole structure below which a gait is of no use: what is near it is slow, too.
const USELESS: f64 = 0.2;

/// A gait of a gait file.
#[derive(Clone, Debug)]
pub struct Known {
    /// The modules that are dead.
    pub dead: BTreeSet<ModuleId>,
    /// The gait.
    pub gait: Gait,
    /// Its speed in mm/s when it was learnt.
    pub speed_mm_s: f64,
}

/// Parameters by which gaits are selected during a run.
#[derive(Clone, Debug)]
pub struct Choice {
    /// The structure, all of whose modules are active.
    pub structure: Structure,
    /// The network.
    pub network: NetworkKind,
    /// Known gaits; one of them is for no dead module.
    pub known: Vec<Known>,
    /// Elites of the whole structure, the fastest first.
    pub elites: Vec<Elite>,
    /// The learner; `None` to try known gaits only. With [`Method::Repertoire`] elites are tried first, and then CMA-ES.
    pub method: Option<Method>,
    /// The number of gaits to try after a failure.
    pub trials: u32,
    /// The seed of the run.
    pub seed: u64,
}

/// Learns while a structure walks.
pub struct OnlineTuner {
    choice: Arc<Choice>,
    /// How often it has begun.
    begun: u64,
    /// The speed of the first gait of the run.
    whole: Option<f64>,
    tried: u32,
    space: Option<Space>,
    /// Gaits to try before the learner's.
    first: VecDeque<Gait>,
    /// The gait walked before, and the elites, if they are to be tried.
    before: Gait,
    order: Option<Order>,
    /// True if the gait whose speed is awaited is an elite.
    is_elite: bool,
    /// The fastest of the gaits tried before the learner's.
    best: Option<(f64, Gait)>,
    /// The gait whose speed is awaited.
    trying: Gait,
    /// The speed of that gait when it was learnt.
    expected: Option<f64>,
    learner: Option<Round>,
}

/// A learner, and the points that it has asked for.
struct Round {
    learner: Box<dyn Learner + Send + Sync>,
    asked: VecDeque<Point>,
    results: Vec<Scored>,
}

impl Round {
    fn next(&mut self) -> Option<Point> {
        if self.asked.is_empty() {
            if !self.results.is_empty() {
                self.learner.tell(&std::mem::take(&mut self.results));
            }
            self.asked = self.learner.ask().into();
        }
        self.asked.pop_front()
    }
}

impl OnlineTuner {
    /// Creates a tuner that has not begun.
    pub fn new(choice: Arc<Choice>) -> OnlineTuner {
        OnlineTuner {
            choice,
            begun: 0,
            whole: None,
            tried: 0,
            space: None,
            first: VecDeque::new(),
            before: Gait::new(),
            order: None,
            is_elite: false,
            best: None,
            trying: Gait::new(),
            expected: None,
            learner: None,
        }
    }

    /// Returns the elite to try next, as far as its joints are left.
    fn elite(&mut self) -> Option<Gait> {
        let (space, order) = (self.space.as_ref()?, self.order.as_mut()?);
        let gait = order.choose().map(|elite| space.gait(&space.point(&elite.gait)));
        self.is_elite = gait.is_some();
        if gait.is_none() {
            self.order = None;
        }
        gait
    }

    /// Returns the next gait of the learner, which begins at the fastest gait so far unless that one is of no use.
    fn learnt(&mut self) -> Option<Gait> {
        let (space, method) = (self.space.as_ref()?, self.choice.method?);
        let least = USELESS * self.whole.unwrap_or(0.0);
        let round = self.learner.get_or_insert_with(|| {
            let useful = self.best.as_ref().filter(|(speed, _)| *speed >= least);
            let start = useful.map(|(_, gait)| space.point(gait));
            let seed = self.choice.seed.wrapping_mul(1_000).wrapping_add(self.begun);
            let method = if method == Method::Repertoire { Method::Cma } else { method };
            let learner = method.learner(space.dimensions(), seed, start);
            Round { learner, asked: VecDeque::new(), results: Vec::new() }
        });
        round.next().map(|point| space.gait(&point))
    }
}

impl Tuner for OnlineTuner {
    fn begin(&mut self, dead: &BTreeSet<ModuleId>, before: &Gait) -> Option<Gait> {
        let Choice { structure, network, known, .. } = &*self.choice;
        let mut structure = structure.clone();
        dead.iter().for_each(|module| structure.set_passive(*module));
        let space = Space::of(&structure, *network).ok()?;
        let of_file = known.iter().find(|known| known.dead == *dead);
        // With another network the former gait is what its joints have in common with the new one.
        let former = (!before.is_empty()).then(|| space.gait(&space.point(before)));
        self.first = of_file.map(|known| known.gait.clone()).into_iter().chain(former).collect();
        self.expected = of_file.map(|known| known.speed_mm_s);
        (self.begun, self.tried) = (self.begun + 1, 1);
        (self.space, self.best, self.learner) = (Some(space), None, None);
        let with_elites = self.choice.method == Some(Method::Repertoire) && !dead.is_empty();
        self.order = with_elites.then(|| Order::new(self.choice.elites.clone()));
        (self.before, self.is_elite) = (before.clone(), false);
        self.trying = self.first.pop_front()?;
        Some(self.trying.clone())
    }

    fn expected(&self) -> Option<f64> {
        self.expected
    }

    fn tell(&mut self, speed_mm_s: f64) -> Option<Gait> {
        self.expected = None;
        self.whole.get_or_insert(speed_mm_s);
        match &mut self.order {
            Some(order) if self.is_elite => order.tell(speed_mm_s),
            // Until the first elite, the gait of the last result is the one walked before.
            Some(order) if self.first.is_empty() => order.heard(&self.before, speed_mm_s),
            _ => {}
        }
        match &mut self.learner {
            Some(round) => round.results.push(Scored { fitness: speed_mm_s, behaviour: Vec::new() }),
            None if self.best.as_ref().is_none_or(|(best, _)| speed_mm_s > *best) => {
                self.best = Some((speed_mm_s, self.trying.clone()));
            }
            None => {}
        }
        if self.tried >= self.choice.trials {
            return None;
        }
        let next = self.first.pop_front().or_else(|| self.elite()).or_else(|| self.learnt())?;
        self.tried += 1;
        self.trying = next;
        Some(self.trying.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::free_module::named;

    fn choice(method: Option<Method>) -> Arc<Choice> {
        let structure = named::structure("quad5-sym").unwrap();
        let space = Space::of(&structure, NetworkKind::BlfSym).unwrap();
        let known = vec![Known { dead: BTreeSet::new(), gait: space.gait(&[0.2; 14]), speed_mm_s: 50.0 }];
        let elite =
            |x: f64, speed_mm_s: f64| Elite { gait: space.gait(&[x; 14]), speed_mm_s, behaviour: vec![x] };
        let elites = vec![elite(0.2, 50.0), elite(0.3, 45.0), elite(0.9, 40.0)];
        let network = NetworkKind::BlfSym;
        Arc::new(Choice { structure, network, known, elites, method, trials: 30, seed: 1 })
    }

    /// The known gait comes first, then what is left of it, then the learner's, which comes closer to what is fast.
    #[test]
    fn known_gaits_come_first_and_the_learner_begins_there() {
        let choice = choice(Some(Method::Cma));
        let mut tuner = OnlineTuner::new(Arc::clone(&choice));
        let intact = tuner.begin(&BTreeSet::new(), &Gait::new()).unwrap();
        assert_eq!((&intact, tuner.expected()), (&choice.known[0].gait, Some(50.0)));
        let dead = BTreeSet::from([ModuleId(2)]);
        let mut passive = choice.structure.clone();
        passive.set_passive(ModuleId(2));
        let space = Space::of(&passive, NetworkKind::BlfSym).unwrap();
        let mut gait = tuner.begin(&dead, &intact).unwrap();
        assert_eq!(tuner.expected(), None);
        assert!(gait.keys().eq(space.oscillators()) && gait.iter().all(|(j, p)| intact[j] == *p));
        let speed = |gait: &Gait| -space.point(gait).iter().map(|x| (x - 0.5) * (x - 0.5)).sum::<f64>();
        let (first, mut best, mut tried) = (speed(&gait), f64::MIN, 1);
        while let Some(next) = tuner.tell(speed(&gait)) {
            gait = next;
            best = best.max(speed(&gait));
            tried += 1;
        }
        assert_eq!(tried, 30);
        assert!(best > first, "{best} {first}");
        assert!(tuner.begin(&(0..5).map(ModuleId).collect(), &gait).is_none());
    }

    /// Returns the mean distance from a point of the first gaits that the learner asks for after a death, if the former gait
    /// had this speed.
    fn distance_of_first_gaits(from: &[f64], former: f64) -> f64 {
        let choice = choice(Some(Method::Cma));
        let mut tuner = OnlineTuner::new(Arc::clone(&choice));
        let intact = tuner.begin(&BTreeSet::new(), &Gait::new()).unwrap();
        assert!(tuner.tell(50.0).is_some());
        let mut passive = choice.structure.clone();
        passive.set_passive(ModuleId(2));
        let space = Space::of(&passive, NetworkKind::BlfSym).unwrap();
        tuner.begin(&BTreeSet::from([ModuleId(2)]), &intact).unwrap();
        let from = &from[..space.dimensions()];
        let distance = |gait: Gait| {
            let point = space.point(&gait);
            point.iter().zip(from).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
        };
        (0..8).map(|_| distance(tuner.tell(former).unwrap())).sum::<f64>() / 8.0
    }

    /// A gait that is of no use after a failure does not hold the learner near it.
    #[test]
    fn the_learner_begins_in_the_middle_if_the_former_gait_is_useless() {
        let (old, middle) = ([0.2; 14], [0.5; 14]);
        let of = |former| [&old, &middle].map(|from| distance_of_first_gaits(from, former));
        let ([old_if_useful, middle_if_useful], [old_if_not, middle_if_not]) = (of(20.0), of(5.0));
        assert!(old_if_useful < middle_if_useful, "{old_if_useful} {middle_if_useful}");
        assert!(middle_if_not < old_if_not, "{middle_if_not} {old_if_not}");
    }

    /// After a failure in which the gait walked before is useless, the elite beside it is passed over.
    #[test]
    fn elites_come_before_the_learner() {
        let choice = choice(Some(Method::Repertoire));
        let mut tuner = OnlineTuner::new(Arc::clone(&choice));
        let intact = tuner.begin(&BTreeSet::new(), &Gait::new()).unwrap();
        assert!(tuner.tell(50.0).is_some(), "the learner's");
        let gait = tuner.begin(&BTreeSet::from([ModuleId(2)]), &intact).unwrap();
        let space = tuner.space.clone().unwrap();
        let of = |elite: &Elite| space.gait(&space.point(&elite.gait));
        assert_eq!(gait, of(&choice.elites[0]), "what is left of the gait walked before");
        assert_eq!(tuner.tell(0.0).unwrap(), of(&choice.elites[2]));
        let learnt = tuner.tell(39.0).unwrap();
        assert!(choice.elites.iter().all(|elite| learnt != of(elite)), "then the learner");
    }

    #[test]
    fn without_a_learner_known_gaits_are_all() {
        let mut tuner = OnlineTuner::new(choice(None));
        let intact = tuner.begin(&BTreeSet::new(), &Gait::new()).unwrap();
        assert!(tuner.tell(1.0).is_none());
        assert!(tuner.begin(&BTreeSet::from([ModuleId(0)]), &intact).is_some() && tuner.tell(1.0).is_none());
    }
}
