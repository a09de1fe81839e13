//! Scenarios in JSON. An inline table of TOML 1.1 has the same grammar as an object of JSON but for the sign between key
//! and value, so a JSON text becomes a TOML value of the same length, and places in one are places in the other.
//!
//! Not read are `null`, which no key of a scenario takes, and in strings the escape `\/` and pairs of surrogates: all are
//! syntax errors at their place.

/// Returns true if a text is meant as JSON: it begins as an object does, which no TOML document can.
pub fn is_json(text: &str) -> bool {
    text.trim_start().starts_with('{')
}

/// Returns the TOML value of the same length: every colon outside of strings becomes an equals sign.
pub fn as_toml(text: &str) -> String {
    let (mut is_string, mut is_escaped) = (false, false);
    let signs = text.chars().map(|sign| {
        let is_colon = sign == ':' && !is_string;
        match sign {
            '"' if !is_escaped => is_string = !is_string,
            _ => {}
        }
        is_escaped = is_string && sign == '\\' && !is_escaped;
        if is_colon { '=' } else { sign }
    });
    signs.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colons_within_strings_stay() {
        assert_eq!(as_toml(r#"{"a:\"b\\": {"c": "\\\":"}}"#), r#"{"a:\"b\\"= {"c"= "\\\":"}}"#);
        assert!(is_json("\n {}") && !is_json("version = 1"));
    }
}
