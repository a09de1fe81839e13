//! Analysis of a drawing by pairing: modules, cells left over, reasons, repairs, splits. The command `shape --modules`
//! and the studio give the same answer.

use metamorph_core::lattice::Cell;
use metamorph_pairing::pins::{Pin, WithoutPins};
use metamorph_pairing::reason::Reason;
use metamorph_pairing::repair::{Allowed, Repair};
use metamorph_pairing::split::{Footing, MAX_SPLIT, NoSplit, Split};
use metamorph_pairing::{Colours, Going, Pairing};
use metamorph_text::format::{count, many};
use serde::Serialize;

/// The answer, as JSON. Cells are `[x, y, z]`.
#[derive(Debug, Serialize)]
pub struct Analysis {
    /// The modules.
    pub pairs: Vec<[Cell; 2]>,
    /// The cells that these pairs leave over.
    pub unpaired: Vec<Cell>,
    /// The number of cells that every pairing leaves over at least.
    pub d: usize,
    /// The number of cells of each colour.
    #[serde(flatten)]
    pub colours: Colours,
    /// The cells that some best pairing leaves over.
    pub free: Vec<Cell>,
    /// The neighbours of `free`.
    pub touch: Vec<Cell>,
    /// Why cells stay left over.
    pub reasons: Vec<Reason>,
    /// The pins: cells that are one module each.
    pub pins: Vec<Pin>,
    /// The number of cells that would be left over without pins.
    pub d_without_pins: usize,
    /// The pins to be given up for that.
    pub costly_pins: Vec<Pin>,
    /// Changes after which none stays left over, and all pins are kept.
    pub repairs: Vec<Repair>,
    /// The splits into chains, if asked for.
    pub split: Option<Splits>,
}

/// The splits into chains of four cells.
#[derive(Debug, Serialize)]
pub struct Splits {
    /// Chains anywhere.
    pub free: SplitAnswer,
    /// Chains with an end in the lowest layer, as seeds of metamodules have.
    pub standing: SplitAnswer,
}

/// One split.
#[derive(Debug, Serialize)]
pub struct SplitAnswer {
    /// `yes`, `no` or `undecided`.
    pub answer: &'static str,
    /// Why there is none.
    pub reason: Option<String>,
    /// The chains.
    pub chains: Vec<[Cell; 4]>,
}

impl Analysis {
    /// Analyses a structure; costly pins, repairs and splits are searched for while `going` returns true.
    pub fn of(pairing: &Pairing, allowed: Option<Allowed>, split: bool, going: Going<'_>) -> Analysis {
        let WithoutPins { unpaired: d_without_pins, costly: costly_pins } = pairing.without_pins_while(going);
        Analysis {
            pairs: pairing.pairs(),
            unpaired: pairing.left_over(),
            d: pairing.unpaired(),
            colours: pairing.colours(),
            free: pairing.free(),
            touch: pairing.touched(),
            reasons: pairing.reasons(),
            pins: pairing.pins().to_vec(),
            d_without_pins,
            costly_pins,
            repairs: allowed
                .map(|allowed| pairing.repairs_while(allowed, going).collect())
                .unwrap_or_default(),
            split: split.then(|| Splits {
                free: SplitAnswer::of(pairing, Footing::Free, going),
                standing: SplitAnswer::of(pairing, Footing::Floor, going),
            }),
        }
    }

    /// Adds the answer about another part of the drawing, which does not touch this one.
    pub fn join(&mut self, other: Analysis) {
        self.pairs.extend(other.pairs);
        self.unpaired.extend(other.unpaired);
        self.d += other.d;
        self.colours.even += other.colours.even;
        self.colours.odd += other.colours.odd;
        self.free.extend(other.free);
        self.touch.extend(other.touch);
        self.reasons.extend(other.reasons);
        self.pins.extend(other.pins);
        self.d_without_pins += other.d_without_pins;
        self.costly_pins.extend(other.costly_pins);
    }
}

impl SplitAnswer {
    fn of(pairing: &Pairing, footing: Footing, going: Going<'_>) -> SplitAnswer {
        let (answer, reason, chains) = match pairing.split_while(footing, going) {
            Split::Yes(chains) => ("yes", None, chains),
            Split::No(reason) => ("no", Some(why(&reason)), Vec::new()),
            Split::Undecided => {
                let limit =
                    format!("the search has a limit; structures above {MAX_SPLIT} cells are not searched");
                ("undecided", Some(limit), Vec::new())
            }
        };
        SplitAnswer { answer, reason, chains }
    }
}

fn why(reason: &NoSplit) -> String {
    match reason {
        NoSplit::Count(cells) => format!("{} cells are not a multiple of four", count(*cells as u64)),
        NoSplit::Unpaired(cells) => format!("{} without a partner", many(*cells as u64, "cell")),
        NoSplit::TooHigh(cell) => format!("the cell {cell} is more than three layers above the lowest one"),
        NoSplit::TooFewFeet { feet, chains } => {
            format!(
                "the lowest layer has {} for {}",
                many(*feet as u64, "cell"),
                many(*chains as u64, "chain")
            )
        }
        NoSplit::Exhausted => "every split was tried".to_owned(),
    }
}
