//! Results of a study as text.

use metamorph_free_modules::gait::document::GaitFile;
use metamorph_free_modules::gait::study::Study;
use metamorph_report::statistics::Spread;
use metamorph_sim_bridge::free_module::trial::TrialOutcome;
use metamorph_text::format::{many, number, whole_percent};
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;

/// Numbers of trials after which the best speed is shown.
const AFTER: [usize; 7] = [10, 20, 40, 80, 120, 240, 400];

/// Returns the speeds of a known gait.
pub fn known(study: &Study, outcomes: &[(f64, TrialOutcome)]) -> String {
    let frictions = study.fitness.frictions();
    let speeds = outcomes.iter().zip(frictions).map(|((speed, outcome), friction)| {
        let end = match (outcome.broken, outcome.collided, outcome.fallen) {
            (true, _, _) => " (broken)",
            (_, true, _) => " (self-collision)",
            (_, _, true) => " (fall)",
            _ => "",
        };
        format!("{} mm/s with friction {friction}{end}", number(*speed))
    });
    format!("the gait of --from: {}", speeds.collect::<Vec<_>>().join(", "))
}

/// Returns the text.
pub fn text(study: &Study, file: &GaitFile, paint: Paint) -> String {
    let part = &file.study;
    let dead: Vec<String> = part.dead.iter().map(u32::to_string).collect();
    let mut out = format!(
        "{}{}: {} with {} parameters, {}, offsets up to {}°, trials of {} s, fitness {}{}\n\n",
        paint.strong(&part.structure),
        if dead.is_empty() { String::new() } else { format!(", {} dead", dead.join(" ")) },
        part.network,
        study.space.dimensions(),
        part.method,
        part.offsets_deg,
        number(part.trial_s),
        format!("{:?}", part.fitness).to_lowercase(),
        if part.upright { ", a fall ends a trial" } else { "" },
    );
    let longest = file.runs.iter().map(|run| run.trials.len()).max().unwrap_or(0);
    let mut after: Vec<usize> = AFTER.into_iter().filter(|n| *n < longest).collect();
    after.push(longest);
    let mut table = Table::new(&["best in mm/s after"]);
    let shares = ["collided", "fell", "broken"].map(str::to_owned);
    let head: Vec<String> = after.iter().map(usize::to_string).chain(shares).collect();
    table.head(&head.iter().map(String::as_str).collect::<Vec<_>>());
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); after.len()];
    for run in &file.runs {
        let best = |n: usize| run.trials.iter().take(n).map(|t| t.fitness_mm_s).fold(0.0, f64::max);
        let count = run.trials.len() as u64;
        let share = |n: usize| whole_percent(n as u64, count.max(1));
        let mut cells: Vec<String> = Vec::new();
        for (n, column) in after.iter().zip(&mut columns) {
            let there = run.trials.len() >= *n;
            cells.push(if there { number(best(*n)) } else { "-".to_owned() });
            column.extend(there.then(|| best(*n)));
        }
        cells.push(share(run.trials.iter().filter(|t| t.collided).count()));
        cells.push(share(run.trials.iter().filter(|t| t.fell).count()));
        cells.push(share(run.trials.iter().filter(|t| t.broken).count()));
        table.row(&[format!("seed {}", run.seed)], cells);
    }
    if file.runs.len() > 1 {
        for (i, name) in ["least", "median", "most"].into_iter().enumerate() {
            let cell = |column: &mut Vec<f64>| {
                Spread::of(column).map_or("-".to_owned(), |s| number([s.min, s.median, s.max][i]))
            };
            table.row(&[name.to_owned()], columns.iter_mut().map(cell).collect());
        }
    }
    out += &table.text(paint);
    if let Some(best) = &file.best {
        let place = format!("gait {} of seed {}", best.trial, best.seed);
        let joints = many(best.joints.len() as u64, "oscillator");
        out += &format!("\nbest: {} mm/s, {place}, {joints}", number(best.fitness_mm_s));
    }
    out
}
