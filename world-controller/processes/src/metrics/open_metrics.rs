//! The text format of OpenMetrics 1.0, as far as metrics of runs need it: written by hand, since it is short.

use super::catalogue::{Kind, Metric};
use std::fmt::{self, Display, Write};

/// The media type of the text.
pub const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";
/// The last line.
const END: &str = "# EOF\n";
/// Number of nanoseconds in a second.
const NANOS: u64 = 1_000_000_000;

/// The value of a sample. All are integers inside; none is a floating-point number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Value {
    /// A number of things.
    Count(u64),
    /// A time in nanoseconds, written in seconds.
    Nanos(u64),
    /// A share in billionths.
    Share(u64),
}

impl Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Value::Count(n) => write!(f, "{n}"),
            Value::Nanos(n) | Value::Share(n) => write!(f, "{}.{:09}", n / NANOS, n % NANOS),
        }
    }
}

/// Labels of a sample: names and values.
pub type Labels = Vec<(&'static str, String)>;

/// A text that is being written.
#[derive(Debug, Default)]
pub struct Text {
    text: String,
    /// Labels of every sample.
    common: Labels,
}

impl Text {
    /// Begins a text whose samples all have these labels.
    pub fn new(common: Labels) -> Text {
        Text { text: String::new(), common }
    }

    /// Writes a metric with its samples; without any, nothing.
    pub fn put(&mut self, metric: &Metric, samples: impl IntoIterator<Item = (Labels, Value)>) {
        let mut samples = samples.into_iter().peekable();
        if samples.peek().is_none() {
            return;
        }
        let Metric { name, kind, meaning, .. } = metric;
        // Writing to a string does not fail.
        let _ = writeln!(self.text, "# TYPE {name} {}", kind.name());
        if let Some(unit) = metric.unit {
            let _ = writeln!(self.text, "# UNIT {name} {unit}");
        }
        let _ = writeln!(self.text, "# HELP {name} {}", Escaped(meaning));
        for (labels, value) in samples {
            let all = self.common.iter().chain(&labels);
            let all: Vec<String> =
                all.map(|(name, value)| format!("{name}=\"{}\"", Escaped(value))).collect();
            let _ = writeln!(self.text, "{name}{}{{{}}} {value}", kind.ending(), all.join(","));
        }
    }

    /// Writes a gauge or a counter that has one sample.
    pub fn put_one(&mut self, metric: &Metric, value: Option<Value>) {
        self.put(metric, value.map(|value| (Labels::new(), value)));
    }

    /// Writes a set of states for each of these labels, with the one that holds.
    pub fn put_states(&mut self, metric: &Metric, states: &[&str], holding: &[(Labels, &str)]) {
        debug_assert_eq!(metric.kind, Kind::StateSet);
        let samples = holding.iter().flat_map(|(labels, holds)| {
            states.iter().map(move |state| {
                let labels = [labels.clone(), vec![(metric.name, (*state).to_owned())]].concat();
                (labels, Value::Count((state == holds).into()))
            })
        });
        self.put(metric, samples);
    }

    /// Ends the text.
    pub fn end(self) -> String {
        self.text + END
    }
}

/// A text in which backslashes, quotes and ends of lines are escaped.
struct Escaped<'a>(&'a str);

impl Display for Escaped<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.chars().try_for_each(|c| match c {
            '\\' => f.write_str("\\\\"),
            '"' => f.write_str("\\\""),
            '\n' => f.write_str("\\n"),
            c => f.write_char(c),
        })
    }
}
