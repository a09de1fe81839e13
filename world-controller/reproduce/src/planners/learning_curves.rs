//! Learning curves of networks of oscillators (thesis 7.7, table 7.5), from gait files of `metamorph learn`.

use super::PlannerTable;
use metamorph_free_modules::gait::document::GaitFile;
use metamorph_protocol::free_module::network::NetworkKind;
use metamorph_report::two_samples::Samples;

/// Trials of an iteration of the thesis, by structure (table 7.3).
const ITERATIONS: [(&str, usize); 3] = [("quad5-sym", 80), ("quad5-unsym", 80), ("struct10", 160)];
/// Mean speeds after five iterations in mm/s (7.7). Of quad5-unsym the text gives the least of the reduced networks.
const AFTER_FIVE: [(&str, NetworkKind, &str); 6] = [
    ("quad5-sym", NetworkKind::Fo, "5"),
    ("quad5-sym", NetworkKind::Blf, "17"),
    ("quad5-sym", NetworkKind::BlfSym, "24"),
    ("quad5-sym", NetworkKind::Sym, "16"),
    ("quad5-unsym", NetworkKind::Fo, "2"),
    ("quad5-unsym", NetworkKind::Blf, "17 at least"),
];
/// Table 7.5: the iteration after which two networks do not differ, for quad5-sym, quad5-unsym and struct10; with a star the
/// one before which they do not.
const PUBLISHED: [(NetworkKind, NetworkKind, [&str; 3]); 6] = [
    (NetworkKind::Fo, NetworkKind::Blf, ["32", "96", "202"]),
    (NetworkKind::Fo, NetworkKind::BlfSym, ["30", "88", "not tested"]),
    (NetworkKind::Fo, NetworkKind::Sym, ["80", "224", "not tested"]),
    (NetworkKind::Blf, NetworkKind::BlfSym, ["92", "none", "not tested"]),
    (NetworkKind::Blf, NetworkKind::Sym, ["57", "84*", "not tested"]),
    (NetworkKind::BlfSym, NetworkKind::Sym, ["35", "82*", "not tested"]),
];
/// Significance level: accepted rate of false findings.
const SIGNIFICANT: f64 = 0.05;
/// Trials after which speeds are listed.
const LISTED: [usize; 5] = [10, 20, 40, 80, 400];

/// The runs of a network, as far as all of them go.
struct Curves {
    kind: NetworkKind,
    /// Of each run the best speed after each trial, in mm/s.
    best: Vec<Vec<f64>>,
    trials: usize,
    collided: usize,
    fell: usize,
    all: usize,
}

impl Curves {
    fn of(file: &GaitFile) -> Option<Curves> {
        let kind = NetworkKind::ALL.into_iter().find(|kind| kind.name() == file.study.network)?;
        let trials = file.runs.iter().map(|run| run.trials.len()).min()?;
        let rising = |best: &mut f64, fitness: f64| {
            *best = best.max(fitness);
            Some(*best)
        };
        let best = file
            .runs
            .iter()
            .map(|run| run.trials.iter().take(trials).map(|t| t.fitness_mm_s).scan(0.0, rising).collect());
        let tried = || file.runs.iter().flat_map(|run| &run.trials);
        let collided = tried().filter(|t| t.collided).count();
        let fell = tried().filter(|t| t.fell).count();
        Some(Curves { kind, best: best.collect(), trials, collided, fell, all: tried().count() })
    }
    /// Returns the best speed of each run after a number of trials, from 1.
    fn after(&self, trials: usize) -> Vec<f64> {
        self.best.iter().map(|run| run[trials - 1]).collect()
    }
    fn median_after(&self, trials: usize) -> f64 {
        let mut speeds = self.after(trials);
        speeds.sort_unstable_by(f64::total_cmp);
        f64::midpoint(speeds[(speeds.len() - 1) / 2], speeds[speeds.len() / 2])
    }
    fn text(&self) -> String {
        let listed = LISTED.iter().filter(|n| **n <= self.trials);
        let speeds: Vec<String> = listed.map(|n| format!("{:.0} after {n}", self.median_after(*n))).collect();
        let [collided, fell] = [self.collided, self.fell].map(|n| 100.0 * n as f64 / self.all.max(1) as f64);
        let (runs, speeds) = (self.best.len(), speeds.join(", "));
        format!("{speeds} mm/s (median of {runs} runs); {collided:.0} % of gaits collide, {fell:.0} % fall")
    }
}

/// Returns in words until which trial two samples of runs differ, and which of them is faster there.
fn compared(a: &Curves, b: &Curves) -> String {
    let trials = a.trials.min(b.trials);
    let p = |n: usize| Samples::new(a.after(n), b.after(n)).map_or(1.0, |samples| samples.compare().p);
    let last = (1..=trials).rev().find(|n| p(*n) < SIGNIFICANT);
    let Some(n) = last else { return format!("none of {trials} trials") };
    let ahead = if a.median_after(n) > b.median_after(n) { a.kind } else { b.kind };
    let which = if n == trials { ", the last one".to_owned() } else { format!(" of {trials}") };
    format!("trial {n}{which} (p = {:.4}); {ahead} is faster", p(n))
}

/// Adds what gait files say beside the published figures. They must be of one structure by name.
pub fn add(table: &mut PlannerTable, files: &[GaitFile]) {
    for (s, (structure, iteration)) in ITERATIONS.iter().enumerate() {
        let of = files.iter().filter(|file| file.study.structure == *structure);
        let curves: Vec<Curves> = of.filter_map(Curves::of).filter(|c| c.trials > 0).collect();
        for curve in &curves {
            let five = AFTER_FIVE.iter().find(|(of, kind, _)| of == structure && *kind == curve.kind);
            let published =
                five.map_or("-".to_owned(), |(.., mm_s)| format!("{mm_s} after {}", 5 * iteration));
            table.row(format!("{structure}, {}: speed by trials", curve.kind), published, curve.text());
        }
        for (first, second, published) in PUBLISHED {
            let found = |kind| curves.iter().find(|c| c.kind == kind);
            let Some((a, b)) = found(first).zip(found(second)) else { continue };
            let trial = published[s].parse::<usize>().map(|n| format!(" (trial {})", n * iteration));
            let published = format!("iteration {}{}", published[s], trial.unwrap_or_default());
            let what = format!("{structure}, {first} and {second} differ until");
            table.row(what, published, compared(a, b));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curves(kind: NetworkKind, speeds: &[[f64; 3]]) -> Curves {
        Curves {
            kind,
            best: speeds.iter().map(|s| s.to_vec()).collect(),
            trials: 3,
            collided: 1,
            fell: 2,
            all: 12,
        }
    }

    #[test]
    fn differences_end_at_the_last_trial_where_samples_differ() {
        let low: Vec<[f64; 3]> =
            (0..8).map(|i| f64::from(i) / 100.0).map(|x| [x, 1.0 + x, 9.0 + x]).collect();
        let high: Vec<[f64; 3]> =
            (0..8).map(|i| f64::from(i) / 99.0).map(|x| [x, 5.0 + x, 9.0 + x]).collect();
        let (low, high) = (curves(NetworkKind::Fo, &low), curves(NetworkKind::Blf, &high));
        let found = compared(&low, &high);
        assert!(found.starts_with("trial 2 of 3 (p = 0.000") && found.ends_with("blf is faster"), "{found}");
        assert_eq!(compared(&low, &low), "none of 3 trials");
        assert!((low.median_after(2) - 1.035).abs() < 1e-9);
        assert!(low.text().ends_with("8 % of gaits collide, 17 % fall"), "{}", low.text());
    }
}
