//! The number of parameters of each network (thesis, table 7.2), beside those that our rules give.

use super::PlannerTable;
use crate::Experiment;
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::network::{Lags, Morphology, NetworkKind};

/// A structure of table 7.2 with its cells, in the order of [`NetworkKind::ALL`]. The last two of struct10 are in
/// parentheses in the thesis: the structure has no symmetric limbs.
const PUBLISHED: [(&str, [usize; 4]); 3] =
    [("quad5-sym", [44, 21, 15, 26]), ("quad5-unsym", [44, 21, 17, 30]), ("struct10", [90, 26, 26, 90])];

/// Makes the table.
pub fn table() -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::Thesis7);
    let (mut equal, mut cells) = (0, 0);
    for (name, published) in PUBLISHED {
        let structure = named::structure(name).expect("invariant: a name of the list");
        let morphology = Morphology::of(&structure);
        let count = |kind, lags| {
            let network = morphology.network(kind).expect("invariant: all modules are active");
            network.parameters(lags)
        };
        for (kind, published) in NetworkKind::ALL.into_iter().zip(published) {
            let ours = count(kind, Lags::Thesis);
            cells += 1;
            equal += usize::from(ours == published);
            let differs = if ours == published { "" } else { " (differs)" };
            let tree = count(kind, Lags::Tree);
            let ours = format!("{ours}{differs}; {tree} with tree lags");
            table.row(format!("{name}, {kind}"), published.to_string(), ours);
        }
    }
    table.notes = vec![
        format!("{equal} of {cells} cells are equal"),
        "quad5-unsym, sym: one limb of three joints does not share, which leaves 44 - 2 * 3 * 2 = 32, not 30"
            .to_owned(),
        "equation 7.4 as printed counts every lag twice: 28 and 36 where the table has 21 and 26".to_owned(),
        "structures are read from the counts, since figure 7.3 does not name connectors".to_owned(),
        "table 7.5 takes gait files: `metamorph learn quad5-sym --network N --method pso --fitness thesis --trials 400 \
         --seeds 1..21 --write N.json` for each network N, then `--gaits` with all of them; 400 trials are five iterations"
            .to_owned(),
        "table 7.5 is by an analysis of variance, ours by the test of Mann and Whitney".to_owned(),
        "which network is ahead after few trials depends on the range of offsets, which the thesis does not give: the full one with \
         30° (`learn --offsets`), the reduced ones with 90° and more"
            .to_owned(),
        "the thesis leaves open: the rate of amplitudes, phases at the start, bounds of offsets and lags, friction, the \
         posture at the start, whether time to settle counts, and what a self-collision is"
            .to_owned(),
    ];
    table
}
