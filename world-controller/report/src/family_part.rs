//! The results of a run that only one family has.

use serde_json::Value;

/// The results of a run that only one family has: as a field of the report, and as text.
#[derive(Clone, Debug)]
pub struct FamilyPart {
    /// The name of the field.
    pub key: &'static str,
    /// Its value.
    pub value: Value,
    /// The same for people.
    pub text: FamilyText,
}

/// The results that only one family has, as text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FamilyText {
    /// The lines on moves, each with its label, instead of the usual one; empty for the usual one.
    pub moves: Vec<(&'static str, String)>,
    /// A paragraph of the HTML report; empty for none.
    pub note: String,
    /// Steps of joints, if the family has joints: the column `turns` of a sweep.
    pub joint_steps: Option<u64>,
}
