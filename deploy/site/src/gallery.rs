//! The gallery: every shipped scenario with its picture.

use metamorph_world_controller::family::read_file;
use metamorph_world_controller::scenario::{LinkKind, Overrides, shipped};
use std::path::Path;

/// Returns the page.
///
/// # Panics
/// If a shipped scenario is wrong, which a test of the program excludes.
pub fn page() -> String {
    let mut page =
        "# Gallery\n\nThe scenarios that ship with the program, half-way through a run with their own seed. \
                    [docs/pictures/make](pictures/make) has the commands that draw the pictures.\n"
            .to_owned();
    let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    for name in shipped::names() {
        let plan = read_file(Path::new(name), &overrides).unwrap_or_else(|wrong| panic!("{wrong}"));
        let about = plan.description.as_deref().unwrap_or_default().trim();
        let remarks: Vec<&str> = plan
            .text
            .lines()
            .take_while(|line| line.starts_with('#'))
            .map(|line| line.trim_start_matches('#').trim())
            .collect();
        page.push_str(&format!(
            "\n## {name}\n\n![{name}, half-way](pictures/{name}.svg)\n\n{about} {}\nFamily `{}`, {} modules.\n\n\
             ```sh\nmetamorph run {name} --link sim\n```\n",
            remarks.join(" "),
            plan.swarm.family(),
            plan.swarm.len(),
        ));
    }
    page
}
