//! The study of thesis 8.2: F values recomputed from the means and standard deviations of table 8.2.
//!
//! 24 people arranged furniture, each in two of four conditions: representation (virtual, augmented) by mobility of
//! the camera (static, dynamic), 12 runs each. The runs themselves are not printed.

use super::PlannerTable;
use crate::experiments::reproduce::Experiment;

/// Runs of one condition.
const RUNS: f64 = 12.0;

/// A measure of table 8.2.
struct Measure {
    name: &'static str,
    /// Mean and standard deviation: virtual static, virtual dynamic, augmented static, augmented dynamic.
    cells: [(f64, f64); 4],
    /// F and p as printed: of the representation, of the mobility.
    published: [&'static str; 2],
}

const TABLE_8_2: [Measure; 3] = [
    Measure {
        name: "local precision p_l",
        cells: [(0.73, 0.26), (0.55, 0.29), (0.81, 0.39), (0.60, 0.13)],
        published: [".65, p .42", "5.86, p .0196"],
    },
    Measure {
        name: "global precision p_g",
        cells: [(1.23, 0.19), (1.13, 0.069), (1.19, 0.10), (1.12, 0.081)],
        published: [".57, p .45", "5.94, p .0187"],
    },
    Measure {
        name: "completion time",
        cells: [(194.13, 102.31), (225.64, 151.96), (185.76, 67.61), (229.38, 69.97)],
        published: [".006, p .94", "1.57, p .22"],
    },
];

/// The two conditions, by the cells of their first level.
const FACTORS: [(&str, [usize; 2], [usize; 2]); 2] =
    [("representation", [0, 1], [2, 3]), ("mobility", [0, 2], [1, 3])];

/// Degrees of freedom of the error: of one factor alone, and of both with their interaction.
const ONE_WAY: u32 = 46;
const TWO_WAY: u32 = 44;

/// Makes the table.
pub fn table() -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::Study);
    for measure in &TABLE_8_2 {
        for ((factor, low, high), published) in FACTORS.iter().zip(measure.published) {
            let (one, two) = (one_way(&measure.cells, *low, *high), two_way(&measure.cells, *low, *high));
            let ours = format!(
                "F(1,{ONE_WAY}) {one:.3}, p {:.4}; F(1,{TWO_WAY}) {two:.3}, p {:.4}",
                p_value(one, ONE_WAY),
                p_value(two, TWO_WAY)
            );
            table.row(format!("{}, {factor}", measure.name), format!("F(1,46) {published}"), ours);
        }
        // The diagonals of the table: what is left beside both factors.
        let interaction = two_way(&measure.cells, [0, 3], [1, 2]);
        table.row(format!("{}, interaction", measure.name), "", format!("F(1,{TWO_WAY}) {interaction:.3}"));
    }
    table.notes = vec![
        "F(1,46) takes one factor and 48 independent runs; F(1,44) both factors and their interaction"
            .to_owned(),
        "each person gave two runs, which neither model respects".to_owned(),
        "of mobility, the printed F of p_l is that of one factor, and that of the time that of both"
            .to_owned(),
        "means and deviations are rounded in the thesis, which moves F in the second digit for p_g"
            .to_owned(),
        "people cannot be simulated: nothing else of chapter 8 is reproduced".to_owned(),
    ];
    table
}

/// Returns the sum of squares between two levels, and within the conditions.
fn squares(cells: &[(f64, f64); 4], low: [usize; 2], high: [usize; 2]) -> (f64, f64) {
    let mean = |level: [usize; 2]| (cells[level[0]].0 + cells[level[1]].0) / 2.0;
    let between = RUNS * (mean(low) - mean(high)).powi(2);
    (between, cells.iter().map(|(_, sd)| (RUNS - 1.0) * sd * sd).sum())
}

fn one_way(cells: &[(f64, f64); 4], low: [usize; 2], high: [usize; 2]) -> f64 {
    let (between, within) = squares(cells, low, high);
    let split = |[a, b]: [usize; 2]| RUNS * (cells[a].0 - cells[b].0).powi(2) / 2.0;
    between / ((within + split(low) + split(high)) / f64::from(ONE_WAY))
}

fn two_way(cells: &[(f64, f64); 4], low: [usize; 2], high: [usize; 2]) -> f64 {
    let (between, within) = squares(cells, low, high);
    between / (within / f64::from(TWO_WAY))
}

/// Returns the probability of a larger F(1, n) by chance: Student's distribution of its root, which is a finite sum
/// for an even n (Abramowitz and Stegun 26.7.4).
fn p_value(f: f64, n: u32) -> f64 {
    debug_assert!(n.is_multiple_of(2), "the sum is that of even degrees of freedom");
    let angle = libm::atan(libm::sqrt(f / f64::from(n)));
    let cosine = libm::cos(angle);
    let (mut term, mut sum) = (1.0, 1.0);
    for k in 1..n / 2 {
        let k = f64::from(k);
        term *= (2.0 * k - 1.0) / (2.0 * k) * cosine * cosine;
        sum += term;
    }
    1.0 - libm::sin(angle) * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values computed by another program from the same table.
    #[test]
    fn f_and_p_are_those_of_another_program() {
        let f = [
            [0.585, 0.632, 5.861, 5.691, 0.034],
            [0.478, 0.522, 6.214, 6.039, 0.188],
            [0.006, 0.006, 1.644, 1.574, 0.041],
        ];
        for (measure, expected) in TABLE_8_2.iter().zip(f) {
            let c = &measure.cells;
            let [(_, v, a), (_, s, d)] = FACTORS;
            let ours = [one_way(c, v, a), two_way(c, v, a), one_way(c, s, d), two_way(c, s, d)];
            for (ours, expected) in ours.into_iter().chain([two_way(c, [0, 3], [1, 2])]).zip(expected) {
                assert!((ours - expected).abs() < 6e-4, "{}: {ours} is not {expected}", measure.name);
            }
        }
        let p = [
            (5.86, 46, 0.0195),
            (5.94, 46, 0.0187),
            (1.57, 46, 0.2165),
            (0.65, 46, 0.4243),
            (0.57, 46, 0.4541),
        ];
        for (f, n, expected) in
            p.into_iter().chain([(0.006, 46, 0.9386), (5.691, 44, 0.0214), (1.574, 44, 0.2162)])
        {
            assert!(
                (p_value(f, n) - expected).abs() < 6e-5,
                "F(1,{n}) {f}: {} is not {expected}",
                p_value(f, n)
            );
        }
    }
}
