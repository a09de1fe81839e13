//! `[swarm.connection]`: the model of the connection mechanism, for families whose connectors close; and what it counts.

use metamorph_protocol::roombots::connection::ConnectionModel;
use metamorph_scenario::definitions::{or, said, table};
use metamorph_scenario::diagnostics::{Diagnostics, Place};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::table::{Node, Read, Section};
use metamorph_sim_bridge::connections::ConnectionCounts;
use metamorph_text::format::{count, many};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

/// The key in `[swarm]`.
pub const KEY: &str = "connection";
/// An example of the table.
const EXAMPLE: &str = "[swarm.connection]\n    compliance_deg_per_nm = 0.8";
/// The largest value of a key in its unit, millimetres or degrees: far beyond every mechanism.
const MOST: f64 = 90.0;

/// The key of what bodies without weight do not have.
const COMPLIANCE: &str = "compliance_deg_per_nm";

/// A key of the table: its name, its description, and the part of the model that it sets, in thousandths of its unit.
struct Key {
    name: &'static str,
    said: &'static str,
    part: fn(&mut ConnectionModel) -> &mut u32,
}

const KEYS: [Key; 6] = [
    Key {
        name: "shift_mm",
        said: "The largest distance of the plates' centres.",
        part: |model| &mut model.shift_um,
    },
    Key {
        name: "twist_deg",
        said: "The largest angle about the normal.",
        part: |model| &mut model.twist_mdeg,
    },
    Key {
        name: "tilt_deg",
        said: "The largest angle between the normals.",
        part: |model| &mut model.tilt_mdeg,
    },
    Key {
        name: "shift_noise_mm",
        said: "Further distance, drawn from 0 to this for every attempt.",
        part: |model| &mut model.shift_noise_um,
    },
    Key {
        name: "twist_noise_deg",
        said: "Further angle about the normal, drawn from 0 to this for every attempt.",
        part: |model| &mut model.twist_noise_mdeg,
    },
    Key {
        name: COMPLIANCE,
        said: "How far a joint yields to the weight that it holds; metamodules only.",
        part: |model| &mut model.compliance_mdeg,
    },
];

/// The table as written.
#[derive(Clone, Debug)]
pub struct RawConnection {
    model: ConnectionModel,
    /// Where it says that joints yield, if it does.
    compliance: Option<Place>,
}

impl RawConnection {
    /// Reads the table, if there is one.
    pub fn read(node: Option<&Node<'_>>, diagnostics: &mut Diagnostics) -> Option<RawConnection> {
        let mut section = Section::of(node?, "[swarm.connection]", EXAMPLE, diagnostics)?;
        let (mut model, mut compliance) = (ConnectionModel::THESIS, None);
        for key in &KEYS {
            let Some(written) = section.node(key.name) else { continue };
            let Some(value) = f64::read(written, diagnostics) else { continue };
            if !(0.0..=MOST).contains(&value) {
                let (got, low, high) = (value.to_string(), "0".to_owned(), MOST.to_string());
                diagnostics.add(written.span(), ScenarioError::Range { what: key.name, got, low, high });
                continue;
            }
            *(key.part)(&mut model) = (value * 1000.0).round() as u32;
            if key.name == COMPLIANCE && model.compliance_mdeg > 0 {
                compliance = Some(written.span().into());
            }
        }
        section.finish(diagnostics);
        Some(RawConnection { model, compliance })
    }

    /// Returns the model.
    pub fn model(&self) -> ConnectionModel {
        self.model
    }
    /// Returns the model for bodies without weight, which do not bend.
    pub fn without_weight(&self, diagnostics: &mut Diagnostics) -> ConnectionModel {
        if let Some(place) = &self.compliance {
            let what = "the bending of free modules, whose world has no gravity".to_owned();
            let instead =
                "remove `compliance_deg_per_nm`, and give the error of postures with `shift_noise_mm`";
            diagnostics.add(place.clone(), ScenarioError::NotYet { what, instead });
        }
        self.model
    }
}

/// Returns the schema of the table.
pub fn schema() -> Value {
    let mut thesis = ConnectionModel::THESIS;
    let of = |key: &Key| {
        let default = f64::from(*(key.part)(&mut thesis)) / 1000.0;
        let schema = json!({ "type": "number", "minimum": 0, "maximum": MOST });
        (key.name.to_owned(), said(key.said, or(default, schema)))
    };
    let keys: Map<String, Value> = KEYS.iter().map(of).collect();
    table(
        "Whether a connector closes: only within the tolerances of the mechanism, and then but for `failed_connections`. If left \
         out, every connector is where it should be.",
        &[],
        Value::Object(keys),
    )
}

/// Describes the model, for `metamorph check`.
pub fn describe(model: &ConnectionModel) -> String {
    let [shift, twist, tilt, shift_noise, twist_noise, compliance] =
        KEYS.map(|key| f64::from(*(key.part)(&mut model.clone())) / 1000.0);
    format!(
        "within {shift} mm, {twist}° about the normal and {tilt}° of tilt; joints yield by {compliance}° per Nm, postures are off by up \
         to {shift_noise} mm and {twist_noise}°"
    )
}

/// Attempts to close a connector.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ConnectionReport {
    /// Attempts; of two sides that close together the one that begins.
    pub attempts: u64,
    /// Those that failed since the connector was too far from its target.
    pub misaligned: u64,
    /// Those within the tolerances whose grippers did not catch.
    pub missed: u64,
    /// The largest distance by which bending took a connector from its target, in millimetres.
    pub bent_at_most_mm: f64,
}

impl ConnectionReport {
    /// Creates the report.
    pub fn of(counts: &ConnectionCounts) -> ConnectionReport {
        ConnectionReport {
            attempts: counts.attempts,
            misaligned: counts.misaligned,
            missed: counts.missed,
            bent_at_most_mm: f64::from(counts.largest_shift_um) / 1000.0,
        }
    }
    /// Returns its line in reports for people.
    pub fn line(&self) -> (&'static str, String) {
        let bent = match self.bent_at_most_mm > 0.0 {
            true => format!("; bent by {:.1} mm at most", self.bent_at_most_mm),
            false => String::new(),
        };
        (
            "connections",
            format!(
                "{} to close a connector: {} too far from its target, {} not caught by the grippers{bent}",
                many(self.attempts, "attempt"),
                count(self.misaligned),
                count(self.missed)
            ),
        )
    }
}
