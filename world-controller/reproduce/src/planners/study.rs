//! The study of thesis 8.2: what is printed, F values recomputed from it, and the sessions of other people beside it.
//!
//! 24 people arranged furniture, each in two of four conditions: representation (virtual, augmented) by mobility of
//! the camera (static, dynamic), 12 runs each. The runs themselves are not printed.

use super::PlannerTable;
use crate::Experiment;
use metamorph_people::room::study::Session;
use metamorph_people::room::study_format::{Mobility, Representation};

/// Number of runs of one condition.
const RUNS: f64 = 12.0;

/// A measure of table 8.2.
struct Measure {
    name: &'static str,
    /// The unit of a cell.
    unit: &'static str,
    /// Mean and standard deviation: virtual static, virtual dynamic, augmented static, augmented dynamic.
    cells: [(f64, f64); 4],
    /// F and p as printed: of the representation, of the mobility.
    published: [&'static str; 2],
    /// The cells as printed.
    printed: [&'static str; 4],
    /// The same measure of a session.
    of: fn(&Session) -> Option<f64>,
}

const TABLE_8_2: [Measure; 3] = [
    Measure {
        name: "local precision p_l",
        unit: " (m)",
        cells: [(0.73, 0.26), (0.55, 0.29), (0.81, 0.39), (0.60, 0.13)],
        published: [".65, p .42", "5.86, p .0196"],
        printed: [".73 (.26)", ".55 (.29)", ".81 (.39)", ".60 (.13)"],
        of: |session| session.precision.map(|p| p.p_l),
    },
    Measure {
        name: "global precision p_g",
        unit: "",
        cells: [(1.23, 0.19), (1.13, 0.069), (1.19, 0.10), (1.12, 0.081)],
        published: [".57, p .45", "5.94, p .0187"],
        printed: ["1.23 (.19)", "1.13 (.069)", "1.19 (.10)", "1.12 (.081)"],
        of: |session| session.precision.and_then(|p| p.p_g),
    },
    Measure {
        name: "completion time",
        unit: " (s)",
        cells: [(194.13, 102.31), (225.64, 151.96), (185.76, 67.61), (229.38, 69.97)],
        published: [".006, p .94", "1.57, p .22"],
        printed: ["194.13 (102.31)", "225.64 (151.96)", "185.76 (67.61)", "229.38 (69.97)"],
        of: |session| Some(session.time_s),
    },
];

/// The two conditions, by the cells of their first level.
const FACTORS: [(&str, [usize; 2], [usize; 2]); 2] =
    [("representation", [0, 1], [2, 3]), ("mobility", [0, 2], [1, 3])];

/// Number of degrees of freedom of the error of one factor alone.
const ONE_WAY: u32 = 46;
/// Number of degrees of freedom of the error of both factors with their interaction.
const TWO_WAY: u32 = 44;

/// The conditions in the order of [`Measure::cells`].
const CONDITIONS: [(&str, Representation, Mobility); 4] = [
    ("virtual, static", Representation::Virtual, Mobility::Static),
    ("virtual, dynamic", Representation::Virtual, Mobility::Dynamic),
    ("augmented, static", Representation::Augmented, Mobility::Static),
    ("augmented, dynamic", Representation::Augmented, Mobility::Dynamic),
];

/// Other counts in the text of chapter 8.
const COUNTS: [(&str, &str); 8] = [
    ("people; women; mean age", "24; 8; 27.3"),
    ("small, medium, large displacements (table 8.3): virtual, dynamic", "2, 1, 9"),
    ("small, medium, large displacements (table 8.3): augmented, dynamic", "1, 5, 6"),
    ("table placed first: static; dynamic", "20 of 24; 19 of 24"),
    ("preferred to move; preferred augmented", "10 of 12; 9 of 12"),
    ("field of view too small", "16 of 24"),
    ("intuitive; easy", "3.68; 3.59 (of 4)"),
    ("errors in all final arrangements", "3"),
];

/// Makes the table.
pub fn table(sessions: &[Session]) -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::Study);
    for measure in &TABLE_8_2 {
        for ((condition, representation, mobility), printed) in CONDITIONS.iter().zip(measure.printed) {
            let of =
                sessions.iter().filter(|s| s.representation == *representation && s.mobility == *mobility);
            let values: Vec<f64> = of.filter_map(measure.of).collect();
            table.row(format!("{}, {condition}{}", measure.name, measure.unit), printed, spread(&values));
        }
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
    for (what, printed) in COUNTS {
        table.row(what, printed, "");
    }
    table.notes = vec![
        "of each condition: mean (standard deviation); ours are the sessions of --study".to_owned(),
        "F(1,46) takes one factor and 48 independent runs; F(1,44) both factors and their interaction"
            .to_owned(),
        "each person gave two runs, which neither model respects".to_owned(),
        "of mobility, the printed F of p_l is that of one factor, and that of the time that of both"
            .to_owned(),
        "means and deviations are rounded in the thesis, which moves F in the second digit for p_g"
            .to_owned(),
        "people cannot be simulated: what is counted of them is printed as it is".to_owned(),
    ];
    table
}

/// Returns the mean, the standard deviation and the number of the sessions of a condition.
fn spread(values: &[f64]) -> String {
    let many = values.len() as f64;
    let mean = values.iter().sum::<f64>() / many;
    let squares: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
    match values.len() {
        0 => String::new(),
        1 => format!("{mean:.3} (one session)"),
        n => format!("{mean:.3} ({:.3}), {n} sessions", libm::sqrt(squares / (many - 1.0))),
    }
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

    #[test]
    fn sessions_are_beside_the_cells_of_their_condition() {
        let log = |mobility: &str, end: f64| {
            let head = format!(
                r#"{{"study": 1, "representation": "augmented", "mobility": "{mobility}", "table": "t"}}"#
            );
            let look = |t: f64| format!(r#"{{"t": {t}, "action": "look"}}"#);
            metamorph_people::room::study::session(&[head, look(1.0), look(end)].join("\n")).unwrap()
        };
        let sessions = [log("static", 101.0), log("static", 301.0), log("dynamic", 51.0)];
        let table = table(&sessions);
        let of = |what: &str| &table.rows.iter().find(|row| row.what == what).unwrap().ours;
        assert_eq!(of("completion time, augmented, static (s)"), "200.000 (141.421), 2 sessions");
        assert_eq!(of("completion time, augmented, dynamic (s)"), "50.000 (one session)");
        assert_eq!(
            (
                of("completion time, virtual, static (s)").as_str(),
                of("local precision p_l, augmented, static (m)").as_str()
            ),
            ("", "")
        );
    }

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
