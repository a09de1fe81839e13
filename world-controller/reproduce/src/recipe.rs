//! "Optimizing the seeding recipe in comparison with a random choice of the seeds placement reduces the
//! number of deadlocks" (thesis 4.1.3), with the chair: its seeds one by one in the order of the recipe, in
//! a random order within each level, and in a random order that ignores levels.

use super::claims::probability;
use super::compare::Claim;
use super::published::STRATEGIES;
use super::{Goal, Sweeper, assumptions};
use crate::error::ReproduceError;
use metamorph_families::metamodule::generated::face_name;
use metamorph_protocol::metamodule::blueprint::{Seed, chair_of_six};
use metamorph_protocol::rng::Rng;
use metamorph_report::statistics::fisher;
use metamorph_scenario::grid::{Axis, Grid, Seeds};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::format::percent;

/// The maximum number of random orders of each sort: within levels, and without regard to them.
const ORDERS: u64 = 6;
/// Significance level of the tests: accepted rate of false findings.
const SIGNIFICANT: f64 = 0.05;

/// The place of the chair in the experiment.
const CORNER: (i16, i16) = (5, 5);

/// Formats seeds that open one after the other, as a value of `goal.0.levels`.
fn value(seeds: &[Seed]) -> String {
    let one = |s: &Seed| {
        let faces = s.directions.map(|d| format!("\"{}\"", face_name(d))).join(",");
        format!("[{{foot=[{},{}],directions=[{faces}]}}]", s.foot.0, s.foot.1)
    };
    format!("[{}]", seeds.iter().map(one).collect::<Vec<_>>().join(","))
}

fn shuffle(seeds: &mut [Seed], stream: &mut Rng) {
    for i in (1..seeds.len()).rev() {
        seeds.swap(i, stream.below(i as u64 + 1) as usize);
    }
}

/// Returns random orders, without the recipe itself and without duplicates.
fn orders(within_levels: bool) -> Vec<String> {
    let mut orders = vec![recipe()];
    for i in 0..ORDERS * 4 {
        let mut stream = Rng::named(0, "recipe", i);
        let mut levels = chair_of_six(CORNER.0, CORNER.1);
        if within_levels {
            levels.iter_mut().for_each(|level| shuffle(level, &mut stream));
        }
        let mut seeds: Vec<Seed> = levels.into_iter().flatten().collect();
        if !within_levels {
            shuffle(&mut seeds, &mut stream);
        }
        let order = value(&seeds);
        if !orders.contains(&order) && (orders.len() as u64) <= ORDERS {
            orders.push(order);
        }
    }
    orders.split_off(1)
}

fn recipe() -> String {
    let seeds: Vec<Seed> = chair_of_six(CORNER.0, CORNER.1).into_iter().flatten().collect();
    value(&seeds)
}

/// Runs the chair with the recipe and with the random orders, and judges the sentence for both meanings of
/// "random".
pub fn claims(seeds_of_experiment: u64, sweeper: &mut Sweeper<'_>) -> Result<Vec<Claim>, ReproduceError> {
    let sorts = [vec![recipe()], orders(true), orders(false)];
    let mut vary = assumptions::axes(&STRATEGIES);
    vary.truncate(2);
    let mut values = sorts.concat();
    values.sort();
    values.dedup();
    vary.push(Axis { key: "goal.0.levels".to_owned(), values });
    let seeds = Seeds { from: 0, until: assumptions::seeds(seeds_of_experiment) };
    let text = Goal::Chair.text().replace("shape = { chair = [5, 5] }\n", "");
    let summary = sweeper.run(Goal::Chair, &text, Some("-recipe"), &Grid::new(seeds, vary)?)?;
    let [hand, within, anywhere] = sorts.map(|orders| {
        let some = summary.combinations.iter().filter(|c| orders.contains(&c.values[2]));
        some.fold((0, 0), |(built, runs), c| (built + c.ended(Outcome::Built), runs + c.runs))
    });
    let share = |(built, runs): (u64, u64)| built as f64 / runs.max(1) as f64;
    let claim = |sort: &str, random: (u64, u64)| {
        let p = fisher(hand, random);
        Claim {
            says: format!(
                "optimizing the seeding recipe in comparison with a random choice reduces deadlocks ({sort})"
            ),
            found: format!(
                "built by the recipe {} of {} runs, at random {} of {}{}",
                percent(share(hand)),
                hand.1,
                percent(share(random)),
                random.1,
                p.map_or(String::new(), |p| format!(", p = {}", probability(p)))
            ),
            by_tables: None,
            chance: None,
            holds: p.filter(|p| *p < SIGNIFICANT).map(|_| share(hand) > share(random)),
        }
    };
    Ok(vec![
        claim("random within a level: four seeds, then two", within),
        claim("random over all six, levels ignored", anywhere),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_are_different_and_not_the_recipe() {
        for within in [true, false] {
            let orders = orders(within);
            assert_eq!(orders.len() as u64, ORDERS);
            assert!(!orders.contains(&recipe()));
            for (i, order) in orders.iter().enumerate() {
                assert!(!orders[..i].contains(order));
                // The back of the chair comes last while levels count.
                let back = order.find("foot=[5,8]").unwrap().min(order.find("foot=[7,8]").unwrap());
                let legs = ["foot=[5,5]", "foot=[7,5]", "foot=[7,7]", "foot=[5,7]"];
                let is_last = legs.iter().all(|leg| order.find(leg).unwrap() < back);
                assert!(is_last || !within, "{order}");
            }
        }
    }
}
