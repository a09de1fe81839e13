//! The latencies of messages in reports.

use crate::schema::{LatencyReport, Quantiles};
use metamorph_core::latency::{Histogram, Latencies};

/// Returns the latencies of a run; `None` if no message was measured.
pub fn report(latencies: &Latencies) -> Option<LatencyReport> {
    let by_class = latencies.iter().filter_map(|(class, h)| Some((class.name().to_owned(), quantiles(h)?)));
    Some(LatencyReport {
        all: quantiles(&latencies.total())?,
        by_class: by_class.collect(),
        channel: quantiles(&latencies.channel),
    })
}

fn quantiles(histogram: &Histogram) -> Option<Quantiles> {
    let at = |per_mille| Some(histogram.quantile(per_mille)?.as_secs_f64());
    Some(Quantiles {
        count: histogram.count(),
        least_s: at(0)?,
        p50_s: at(500)?,
        p90_s: at(900)?,
        p99_s: at(990)?,
        p999_s: at(999)?,
        greatest_s: at(1_000)?,
    })
}
