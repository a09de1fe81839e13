//! Whether documents are valid by a JSON schema. The validator is behind the feature `jsonschema`, which `.ci/run` turns
//! on, since it brings many crates; without the feature, validity is not looked at.

use serde_json::Value;

/// A schema that documents are compared with.
#[derive(Debug)]
pub struct Schema {
    #[cfg(feature = "jsonschema")]
    validator: jsonschema::Validator,
}

#[cfg_attr(not(feature = "jsonschema"), allow(unused_variables, reason = "nothing is compared"))]
impl Schema {
    /// Reads a schema.
    ///
    /// # Panics
    /// If it is none.
    pub fn new(schema: &Value) -> Schema {
        Schema {
            #[cfg(feature = "jsonschema")]
            validator: jsonschema::validator_for(schema).expect("it is a schema"),
        }
    }

    /// Asserts that a document is valid.
    ///
    /// # Panics
    /// If it is not.
    pub fn accepts(&self, document: &Value, name: &str) {
        #[cfg(feature = "jsonschema")]
        {
            let errors = self.validator.iter_errors(document);
            let errors: Vec<String> = errors.map(|e| format!("{} {e}", e.instance_path())).collect();
            assert!(errors.is_empty(), "{name}: {errors:#?}");
        }
    }

    /// Asserts that a document is not valid.
    ///
    /// # Panics
    /// If it is.
    pub fn refuses(&self, document: &Value, name: &str) {
        #[cfg(feature = "jsonschema")]
        assert!(!self.validator.is_valid(document), "the schema takes {name}");
    }
}
