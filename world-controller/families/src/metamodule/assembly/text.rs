//! The answer of `metamorph plan SCENARIO` for people.

use super::{AssemblyDocument, AssemblyVerdict};
use metamorph_text::format::{count, many};
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;

/// Describes an answer.
pub fn text(answer: &AssemblyDocument, paint: Paint) -> String {
    let mut lines = Vec::new();
    if !answer.thesis_order.is_empty() {
        lines.push("order of thesis B.5, by mean degree centrality in cells:".to_owned());
        for rank in &answer.thesis_order {
            let taken = if rank.taken { "" } else { "   not taken" };
            lines.push(format!(
                "  {:>7.2}  level {}  {}{taken}",
                rank.isolation,
                rank.level,
                rank.items.join(" + ")
            ));
        }
    }
    if let Some(totals) = &answer.totals {
        lines.push(format!(
            "plan: {}, {}, {} (at least {}), {} ({}°); torque up to {:.2} / {:.2} Nm (outer / middle)",
            many(answer.bundles.len() as u64, "bundle"),
            many(totals.hand_overs.into(), "hand-over"),
            many(totals.connections.into(), "connection"),
            count(totals.connections_lower.into()),
            many(totals.turns.into(), "turn"),
            count(totals.degrees.into()),
            totals.peak_outer_nm,
            totals.peak_middle_nm,
        ));
        lines.push(table(answer, paint));
    }
    if let Some(failure) = &answer.failure {
        let verdict = match answer.verdict {
            AssemblyVerdict::Infeasible => "infeasible",
            _ => "undecided",
        };
        lines.push(format!("{verdict} ({}): {}", failure.reason, failure.text));
        if !failure.standing.is_empty() {
            lines.push(format!("  what stands: {}", failure.standing.join(", ")));
        }
        for refusal in &failure.refusals {
            let proved = if refusal.proved { "" } else { ", not proved" };
            lines.push(format!("  {}: {}{proved}", refusal.items.join(" + "), refusal.reason));
        }
    }
    lines.join("\n").trim_end().to_owned()
}

fn table(answer: &AssemblyDocument, paint: Paint) -> String {
    let mut table = Table::new(&["", "bundle", "after", "metamodules"]);
    table.head(&["hand-overs", "connections", "turns", "outer Nm", "middle Nm"]);
    let listed = |numbers: &[usize]| {
        let numbers: Vec<String> = numbers.iter().map(usize::to_string).collect();
        numbers.join(", ")
    };
    for (i, bundle) in answer.bundles.iter().enumerate() {
        let keys = [
            (i + 1).to_string(),
            bundle.items.join(" + "),
            listed(&bundle.after),
            listed(&bundle.metamodules),
        ];
        let numbers = vec![
            bundle.hand_overs.to_string(),
            bundle.connections.to_string(),
            bundle.turns.to_string(),
            format!("{:.2}", bundle.peak_outer_nm),
            format!("{:.2}", bundle.peak_middle_nm),
        ];
        table.whole_row(&keys, numbers);
    }
    table.text(paint)
}
