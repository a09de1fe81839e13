//! A structure, analysed, as text.

use metamorph_free_modules::structure::Answer;
use metamorph_protocol::free_module::structure::Joint;
use metamorph_text::format::many;
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;
use std::fmt::Display;

/// Returns the text.
pub fn text(answer: &Answer, paint: Paint) -> String {
    let mut out = format!(
        "{}: {}, {}, fingerprint {}\n",
        paint.strong(&answer.structure),
        many(answer.modules as u64, "module"),
        many(answer.connections as u64, "connection"),
        answer.fingerprint
    );
    let partition = &answer.partition;
    let sets =
        [("dead", &answer.passive), ("cyclic body", &partition.cyclic), ("linear body", &partition.linear)];
    for (name, modules) in sets {
        if !modules.is_empty() {
            out += &format!("  {name:<12} {}\n", listed(modules));
        }
    }
    for link in &partition.links {
        out += &format!("  {:<12} {}\n", "  of it link", listed(link));
    }
    if !answer.spines.is_empty() {
        out += &format!("  {:<12} {}\n", "spine", listed(&answer.spines));
    }
    let mut limbs =
        Table::new(&["limb", "modules", "hip", "knee", "ankle", "pod", "labels", "symmetric with"]);
    for (i, limb) in answer.limbs.iter().enumerate() {
        let joint = |j: Option<Joint>| j.map_or_else(|| "-".to_owned(), |j| j.to_string());
        let group = answer.symmetric.iter().find(|g| g.contains(&i));
        let others: Vec<usize> = group.into_iter().flatten().filter(|o| **o != i).map(|o| o + 1).collect();
        let labels: Vec<String> = limb.labels.iter().map(|l| listed(l)).collect();
        let cells = [
            (i + 1).to_string(),
            listed(&limb.modules),
            joint(limb.hip),
            joint(limb.knee),
            joint(limb.ankle),
            limb.pod.to_string(),
            labels.join(" | "),
            if others.is_empty() { "-".to_owned() } else { listed(&others) },
        ];
        limbs.row(&cells, Vec::new());
    }
    if !answer.limbs.is_empty() {
        out += &format!("\n{}", limbs.text(paint));
    }
    out + &networks(answer, paint)
}

fn networks(answer: &Answer, paint: Paint) -> String {
    let mut table = Table::new(&["network"]);
    table.head(&["oscillators", "couplings", "parameters", "with tree lags"]);
    for n in &answer.networks {
        let numbers = [n.oscillators, n.couplings, n.parameters_thesis_lags, n.parameters_tree_lags];
        table.row(&[n.kind.to_string()], numbers.map(|n| n.to_string()).to_vec());
    }
    let couplings = answer.network.couplings.iter().map(|(a, b, tree)| {
        let mark = if *tree { "" } else { "*" };
        format!("{a}-{b}{mark}")
    });
    let couplings: Vec<String> = couplings.collect();
    let mut out = format!("\n{}\ncouplings of {}:", table.text(paint), answer.network.kind);
    for line in couplings.chunks(8) {
        out += &format!("\n  {}", line.join("  "));
    }
    if answer.network.couplings.iter().any(|(.., tree)| !tree) {
        out += "\n  * closes a cycle: its lag follows from the others with tree lags";
    }
    answer.notes.iter().for_each(|note| out += &format!("\nnote: {note}"));
    out
}

fn listed<T: Display>(items: &[T]) -> String {
    items.iter().map(T::to_string).collect::<Vec<_>>().join(" ")
}
