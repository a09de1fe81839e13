//! The table of metrics, from the catalogue of the program.

use metamorph_world_controller::metrics::catalogue::{ALL, Metric};

/// Returns the table.
pub fn table() -> String {
    let row = |metric: &Metric| {
        let (unit, of) =
            (metric.unit.unwrap_or("–"), if metric.of_controller { "controller" } else { "every host" });
        let labels: Vec<String> = metric.labels.iter().map(|label| format!("`{label}`")).collect();
        let labels = if labels.is_empty() { "–".to_owned() } else { labels.join(", ") };
        format!(
            "| `{}` | {} | {unit} | {labels} | {of} | {} |\n",
            metric.name,
            metric.kind.name(),
            metric.meaning
        )
    };
    let head = "\n| name | type | unit | further labels | from | meaning |\n|---|---|---|---|---|---|\n";
    head.to_owned() + &ALL.iter().map(row).collect::<String>()
}
