//! Removes the noise of a tracker: the median of the last samples, then a running mean, for each coordinate.

use std::collections::VecDeque;

/// Number of samples of a median.
const MEDIAN: usize = 9;
/// Weight of a new median in the running mean. The specification of the experiment has 0.08; with 30 samples a second and
/// 20 mm of noise 1/16 selects the right tile more often and sooner (docs/pointing.md).
const WEIGHT: f64 = 1.0 / 16.0;

/// Filters the samples of a track: positions of head and hand, six coordinates.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    last: VecDeque<[f64; 6]>,
    mean: [f64; 6],
    count: u32,
}

impl Filter {
    /// Takes a sample and returns the filtered one. The mean of the first samples is their plain mean.
    pub fn next(&mut self, sample: [f64; 6]) -> [f64; 6] {
        if self.last.len() == MEDIAN {
            self.last.pop_front();
        }
        self.last.push_back(sample);
        self.count = self.count.saturating_add(1);
        let weight = WEIGHT.max(1.0 / f64::from(self.count));
        for (i, mean) in self.mean.iter_mut().enumerate() {
            let mut values: Vec<f64> = self.last.iter().map(|sample| sample[i]).collect();
            values.sort_by(f64::total_cmp);
            let upper = values[values.len() / 2];
            let lower = values[(values.len() - 1) / 2];
            *mean += (f64::midpoint(lower, upper) - *mean) * weight;
        }
        self.mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_outliers_leave_no_trace_and_a_step_is_followed() {
        let mut filter = Filter::default();
        for i in 0..40 {
            let value = if i == 20 { 100.0 } else { 1.0 };
            assert_eq!(filter.next([value; 6]), [1.0; 6], "sample {i}");
        }
        let after: Vec<f64> = (0..60).map(|_| filter.next([2.0; 6])[0]).collect();
        assert!(after.is_sorted() && (1.9..2.0).contains(&after[59]), "{after:?}");
    }
}
