//! Number formats for human-readable text: one per kind of number, and nouns that agree with their number.
//! Absent: JSON and CSV, which hold plain numbers.

/// Formats an integer with a comma after each group of three digits.
pub fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

/// Formats a number with its noun, given in the singular: `1 move`, `1,058 moves`, `2 processes`.
pub fn many(n: u64, noun: &str) -> String {
    let ending = match (n, noun.ends_with('s')) {
        (1, _) => "",
        (_, true) => "es",
        (_, false) => "s",
    };
    format!("{} {noun}{ending}", count(n))
}

/// Formats an amount of data in B, kB, MB or GB (powers of 1000).
pub fn bytes(n: u64) -> String {
    let in_units = |unit: u64, name: &str| {
        let tenths = (n + unit / 20) / (unit / 10);
        match tenths {
            0..100 => format!("{}.{} {name}", tenths / 10, tenths % 10),
            _ => format!("{} {name}", count((n + unit / 2) / unit)),
        }
    };
    match n {
        0..1_000 => format!("{n} B"),
        1_000..1_000_000 => in_units(1_000, "kB"),
        1_000_000..1_000_000_000 => in_units(1_000_000, "MB"),
        _ => in_units(1_000_000_000, "GB"),
    }
}

/// Formats a duration given in seconds: below 1 s in whole milliseconds, else in seconds with one decimal.
pub fn seconds(s: f64) -> String {
    if s < 0.000_5 {
        "0 s".to_owned()
    } else if s < 0.999_5 {
        format!("{:.0} ms", s * 1_000.0)
    } else {
        let tenths = (s * 10.0).round() as u64;
        format!("{}.{} s", count(tenths / 10), tenths % 10)
    }
}

/// Formats a short time, given in seconds, in µs, ms or s with three digits.
pub fn duration(s: f64) -> String {
    let in_unit = |n: f64, unit: &str| match n {
        99.95.. => format!("{n:.0} {unit}"),
        9.995.. => format!("{n:.1} {unit}"),
        _ => format!("{n:.2} {unit}"),
    };
    match s {
        ..=0.0 => "0 s".to_owned(),
        ..0.000_999_5 => in_unit(s * 1e6, "µs"),
        ..0.999_5 => in_unit(s * 1e3, "ms"),
        _ => in_unit(s, "s"),
    }
}

/// Formats the rate of `n` events in `seconds` as a whole number per second.
pub fn rate(n: u64, seconds: f64) -> String {
    format!("{} a second", count((n as f64 / seconds.max(1e-9)) as u64))
}

/// Formats a share in whole percent, rounded down: 100% means all.
pub fn whole_percent(part: u64, whole: u64) -> String {
    format!("{}%", part * 100 / whole.max(1))
}

/// Lists the first `most` module ids: `1, 2 and 3`, or `1, 2, 3 and 40 more`.
pub fn listed(ids: &[u32], most: usize) -> String {
    let shown: Vec<String> = ids.iter().take(most).map(u32::to_string).collect();
    match (ids.len().saturating_sub(most), shown.as_slice()) {
        (0, [first @ .., last]) if !first.is_empty() => format!("{} and {last}", first.join(", ")),
        (0, _) => shown.join(", "),
        (more, _) => format!("{} and {} more", shown.join(", "), count(more as u64)),
    }
}

/// Joins parts by two spaces into a line of at most `width` columns. The first part is cut if it is too long;
/// any other part that does not fit is left out.
pub fn fitting<'a>(parts: impl IntoIterator<Item = &'a str>, width: usize) -> String {
    let mut line = String::new();
    for part in parts {
        let gap = if line.is_empty() { "" } else { "  " };
        if line.is_empty() {
            line = part.chars().take(width).collect();
        } else if line.chars().count() + gap.len() + part.chars().count() <= width {
            line = line + gap + part;
        }
    }
    line
}

/// Formats a hash as 16 hexadecimal digits, as in reports.
pub fn digits(hash: u64) -> String {
    format!("{hash:016x}")
}

/// Formats a share in percent with one decimal.
pub fn percent(share: f64) -> String {
    format!("{:.1}%", share * 100.0)
}

/// Formats a number with one decimal below 100, and rounded to an integer from there on.
pub fn number(n: f64) -> String {
    match n {
        1_000.0.. => count(n.round() as u64),
        100.0.. => format!("{n:.0}"),
        _ => format!("{n:.1}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_three_digits() {
        for (s, text) in [
            (0.0, "0 s"),
            (8.512e-7, "0.85 µs"),
            (0.000_999_4, "999 µs"),
            (0.001, "1.00 ms"),
            (0.012_34, "12.3 ms"),
            (62.0, "62.0 s"),
        ] {
            assert_eq!(duration(s), text);
        }
    }

    #[test]
    fn a_number_has_one_form() {
        assert_eq!([0, 999, 1_058, 1_234_567].map(count), ["0", "999", "1,058", "1,234,567"]);
        let nouns = [many(1, "move"), many(2, "move"), many(1_058, "process"), many(0, "run")];
        assert_eq!(nouns, ["1 move", "2 moves", "1,058 processes", "0 runs"]);
        let sizes = [0, 999, 1_000, 4_158, 9_999, 20_000, 123_456_789, 5_600_000_000];
        assert_eq!(
            sizes.map(bytes),
            ["0 B", "999 B", "1.0 kB", "4.2 kB", "10 kB", "20 kB", "123 MB", "5.6 GB"]
        );
        let times = [0.0, 0.012, 0.9996, 1.25, 12_345.6];
        assert_eq!(times.map(seconds), ["0 s", "12 ms", "1.0 s", "1.3 s", "12,345.6 s"]);
        assert_eq!(
            (whole_percent(1, 3), whole_percent(0, 0), rate(3_000, 2.0)),
            ("33%".into(), "0%".into(), "1,500 a second".into())
        );
    }

    #[test]
    fn lists_are_cut_and_say_so() {
        let lists = [listed(&[], 3), listed(&[1], 3), listed(&[1, 2, 3], 3), listed(&[1, 2, 3, 4, 5], 3)];
        assert_eq!(lists, ["", "1", "1, 2 and 3", "1, 2, 3 and 2 more"]);
    }

    #[test]
    fn a_line_loses_whole_parts_only() {
        assert_eq!(fitting(["abc", "defgh", "ij"], 7), "abc  ij");
        assert_eq!(fitting(["abcdef"], 4), "abcd");
        assert_eq!(fitting([], 4), "");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(
            [0.04, 99.94, 123.4, 1234.4, 1e6].map(number),
            ["0.0", "99.9", "123", "1,234", "1,000,000"]
        );
        assert_eq!(percent(0.1234), "12.3%");
    }
}
