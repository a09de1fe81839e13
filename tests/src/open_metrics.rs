//! A strict reader of the text format of OpenMetrics 1.0, written from its specification and without code of the program.

use std::collections::{BTreeMap, BTreeSet};

/// A metric as a text has it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Read {
    /// Its type.
    pub kind: String,
    /// Its unit; empty without one.
    pub unit: String,
    /// Its description.
    pub help: String,
    /// Its samples: name, labels and value.
    pub samples: Vec<(String, BTreeMap<String, String>, String)>,
}

impl Read {
    /// Returns the value of the only sample with these labels, among others.
    ///
    /// # Panics
    /// If there are none or several.
    pub fn value(&self, labels: &[(&str, &str)]) -> &str {
        let fits = |found: &BTreeMap<String, String>| {
            labels.iter().all(|(name, value)| found.get(*name).is_some_and(|found| found == value))
        };
        let found: Vec<&str> =
            self.samples.iter().filter(|(_, l, _)| fits(l)).map(|(.., value)| value.as_str()).collect();
        assert_eq!(found.len(), 1, "{labels:?} in {self:?}");
        found[0]
    }

    /// Returns the sum of the values of samples with this label.
    pub fn sum(&self, label: (&str, &str)) -> u64 {
        let fits = |labels: &BTreeMap<String, String>| labels.get(label.0).is_some_and(|v| v == label.1);
        self.samples
            .iter()
            .filter(|(_, labels, _)| fits(labels))
            .filter_map(|(.., n)| n.parse::<u64>().ok())
            .sum()
    }
}

/// Replaces escapes.
fn unescaped(text: &str) -> Result<String, String> {
    let (mut plain, mut chars) = (String::new(), text.chars());
    while let Some(c) = chars.next() {
        match (c, if c == '\\' { chars.next() } else { None }) {
            ('\\', Some('n')) => plain.push('\n'),
            ('\\', Some(c @ ('\\' | '"'))) => plain.push(c),
            ('\\', _) | ('"', _) => return Err(format!("`{text}` is not escaped")),
            (c, _) => plain.push(c),
        }
    }
    Ok(plain)
}

/// Splits a sample into its name, labels and value.
fn sample(line: &str) -> Result<(String, BTreeMap<String, String>, String), String> {
    let wrong = || format!("`{line}` is no sample");
    let (name, mut rest) = line.split_once('{').ok_or_else(wrong)?;
    let mut labels = BTreeMap::new();
    while let Some((label, after)) = rest.split_once("=\"") {
        let mut is_escaped = false;
        let end = after.find(|c| {
            let is_end = c == '"' && !is_escaped;
            is_escaped = c == '\\' && !is_escaped;
            is_end
        });
        let (value, after) = after.split_at(end.ok_or_else(wrong)?);
        if labels.insert(label.to_owned(), unescaped(value)?).is_some() {
            return Err(wrong());
        }
        match after[1..].split_at_checked(1) {
            Some((",", after)) => rest = after,
            Some(("}", after)) => {
                let value = after.strip_prefix(' ').filter(|value| value.parse::<f64>().is_ok());
                return Ok((name.to_owned(), labels, value.ok_or_else(wrong)?.to_owned()));
            }
            _ => return Err(wrong()),
        }
    }
    Err(wrong())
}

/// Reads a text.
///
/// # Errors
/// If the text is not of the format, or has a metric in two places or a sample twice.
pub fn read(text: &str) -> Result<BTreeMap<String, Read>, String> {
    let body = text.strip_suffix("# EOF\n").ok_or("the text does not end with `# EOF`")?;
    let mut metrics: BTreeMap<String, Read> = BTreeMap::new();
    let (mut present, mut seen) = (String::new(), BTreeSet::new());
    for line in body.split_terminator('\n') {
        let wrong = |why: &str| Err(format!("{why}: `{line}`"));
        let Some(described) = line.strip_prefix("# ") else {
            let sample = sample(line)?;
            let metric = metrics.get_mut(&present).ok_or("a sample without a type")?;
            let ending = match metric.kind.as_str() {
                "counter" => "_total",
                "info" => "_info",
                _ => "",
            };
            if sample.0 != format!("{present}{ending}") || !seen.insert((sample.0.clone(), sample.1.clone()))
            {
                return wrong("a sample of another metric, or one that is there already");
            }
            if metric.kind == "stateset"
                && !(sample.1.contains_key(&present) && ["0", "1"].contains(&&*sample.2))
            {
                return wrong("no sample of a set of states");
            }
            metric.samples.push(sample);
            continue;
        };
        let mut words = described.splitn(3, ' ');
        let (Some(what), Some(name), Some(value)) = (words.next(), words.next(), words.next()) else {
            return wrong("an incomplete line");
        };
        if name != present && metrics.insert(name.to_owned(), Read::default()).is_some() {
            return wrong("a metric in two places");
        }
        present = name.to_owned();
        let metric = metrics.entry(present.clone()).or_default();
        if !metric.samples.is_empty() {
            return wrong("a description behind samples");
        }
        match what {
            "TYPE" if ["gauge", "counter", "stateset", "info"].contains(&value) => {
                metric.kind = value.to_owned()
            }
            "UNIT" if name.ends_with(&format!("_{value}")) => metric.unit = value.to_owned(),
            "HELP" => metric.help = unescaped(value)?,
            _ => return wrong("an unknown line"),
        }
    }
    Ok(metrics)
}
