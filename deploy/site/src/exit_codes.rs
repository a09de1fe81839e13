//! The page of exit codes, from the help of each command.

use crate::reference::{each, help};

const HEADING: &str = "Exit codes:";

/// Returns the codes of a help text with their meanings.
fn codes(help: &str) -> Vec<(String, String)> {
    let lines = help.lines().skip_while(|line| line.trim() != HEADING).skip(1);
    let mut codes: Vec<(String, String)> = Vec::new();
    for line in lines.take_while(|line| !line.trim().is_empty()) {
        let line = line.trim();
        match (line.split_once(' '), codes.last_mut()) {
            (Some((code, meaning)), _) if code.chars().all(|c| c.is_ascii_digit()) => {
                codes.push((code.to_owned(), meaning.trim().to_owned()));
            }
            (_, Some((_, meaning))) => {
                meaning.push(' ');
                meaning.push_str(line);
            }
            (_, None) => {}
        }
    }
    codes
}

/// Returns the table of a command's exit codes, or `None` if its help lists none.
pub fn table(command: &str) -> Option<String> {
    let name = format!("metamorph {command}");
    let (_, mut command) = each().into_iter().find(|(found, _)| *found == name)?;
    let codes = codes(&help(&mut command));
    (!codes.is_empty()).then(|| format!("\n{}", rows(&codes)))
}

fn rows(codes: &[(String, String)]) -> String {
    let row = |(code, meaning): &(String, String)| format!("| {code} | {} |\n", meaning.replace('|', "\\|"));
    let rows: String = codes.iter().map(row).collect();
    format!("| code | meaning |\n|---|---|\n{rows}")
}

/// Returns the page.
pub fn page() -> String {
    let mut page =
        "# Exit codes\n\nCommands that are not listed here exit with 0 if they succeeded, 1 if the program \
                    itself failed, and 2 if the command line or an input is wrong.\n"
            .to_owned();
    for (name, mut command) in each() {
        let codes = codes(&help(&mut command));
        if !codes.is_empty() {
            page.push_str(&format!("\n## {name}\n\n{}", rows(&codes)));
        }
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_of_a_help_text() {
        let help = "Usage: x\n\nExit codes:\n  0  good\n  7  aborted, and\n     partial\n\nMore.\n";
        let expected = [("0", "good"), ("7", "aborted, and partial")];
        assert_eq!(codes(help), expected.map(|(code, meaning)| (code.to_owned(), meaning.to_owned())));
        assert!(codes("Usage: x").is_empty());
    }
}
