//! Analyses that pages ask for: a page sends what has changed since a revision, and gets the answer for the new one. One
//! analysis is carried out at a time; a newer one of the same page cancels it.

use super::budget::{Budget, LONGEST};
use super::one_at_a_time::{NoAnswer, OneAtATime, PAGES};
use super::site::{Response, read_of_page};
use hyper::StatusCode;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::pairing::pins::{self, Pin};
use metamorph_protocol::pairing::repair::Allowed;
use metamorph_protocol::pairing::{Pairing, PairingError};
use metamorph_protocol::shape::components;
use metamorph_scenario::family::{DrawnStructure, Families};
use metamorph_shapes::analysis::Analysis;
use metamorph_view::http::refused;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Largest number of cells of a drawing.
pub const MAX_CELLS: usize = 20_000;

/// A request for an analysis.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    version: u16,
    /// A name that a page draws at random when it is loaded.
    session: String,
    /// The revision that the answer is for.
    revision: u64,
    /// The revision that `add` and `remove` change; none if `add` is the whole drawing.
    base: Option<u64>,
    #[serde(default)]
    add: Vec<Cell>,
    #[serde(default)]
    remove: Vec<Cell>,
    /// All pins, if they have changed since `base`.
    pins: Option<Vec<Pin>>,
    /// Whether repairs, splits and families are asked for, too.
    #[serde(default)]
    all: bool,
}

/// The drawing of a page.
#[derive(Debug, Default)]
struct Drawing {
    page: String,
    revision: u64,
    cells: BTreeSet<Cell>,
    pins: Vec<Pin>,
    /// The modules that the page shows.
    shown: Vec<[Cell; 2]>,
}

/// The part of a drawing that an analysis works on.
struct Taken {
    cells: BTreeSet<Cell>,
    pins: Vec<Pin>,
    /// The modules that the page shows.
    shown: Vec<[Cell; 2]>,
}

/// The drawings of all pages, and the analyses in progress.
#[derive(Debug, Default)]
pub struct Analyses {
    /// The one heard of last is the last one.
    drawings: Mutex<Vec<Drawing>>,
    work: OneAtATime,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Poisoning is ignored: no statement that can panic leaves the value half changed.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn stale(why: &str) -> Response {
    (StatusCode::CONFLICT, json!({ "result": "stale", "why": why }))
}

impl Analyses {
    /// Answers a request.
    pub async fn answer(self: &Arc<Self>, body: &[u8], families: Families) -> Response {
        let asked = match read_of_page(body, |a: &Asked| a.version, |a| &a.session) {
            Ok(asked) => asked,
            Err(refused) => return refused,
        };
        let (page, revision, all) = (asked.session.clone(), asked.revision, asked.all);
        let Taken { cells, pins, shown } = match self.take(asked) {
            Ok(taken) => taken,
            Err(refused) => return refused,
        };
        let work = move |cancelled| {
            let budget = Budget::new(cancelled, LONGEST);
            analyse(&cells, &pins, &shown, all.then_some(families), &budget)
        };
        let (mut value, shown) = match self.work.carry_out(&page, work).await {
            Ok(analysed) => analysed,
            Err(NoAnswer::Stale) => return stale("a newer request has come"),
            Err(NoAnswer::Failed) => {
                return refused(StatusCode::INTERNAL_SERVER_ERROR, "the analysis has failed");
            }
        };
        let mut drawings = locked(&self.drawings);
        if let Some(drawing) = drawings.iter_mut().find(|d| d.page == page && d.revision == revision) {
            drawing.shown = shown;
        }
        value["revision"] = json!(revision);
        (StatusCode::OK, value)
    }

    /// Takes the changes of a page.
    fn take(&self, asked: Asked) -> Result<Taken, Response> {
        let Asked { session, revision, base, add, remove, pins, .. } = asked;
        let remove: BTreeSet<Cell> = remove.into_iter().collect();
        let mut drawings = locked(&self.drawings);
        let mut drawing = match drawings.iter().position(|d| d.page == session) {
            Some(place) => drawings.remove(place),
            None => Drawing { page: session, ..Drawing::default() },
        };
        let changed = match base {
            None => Ok(BTreeSet::new()),
            Some(base) if base == drawing.revision => Ok(drawing.cells.clone()),
            Some(_) => Err(stale("this revision is not known; send the whole drawing")),
        };
        let changed = changed.and_then(|mut cells| {
            cells.retain(|cell| !remove.contains(cell));
            cells.extend(add);
            let most = format!("a drawing has at most {MAX_CELLS} cells");
            if cells.len() > MAX_CELLS {
                Err(refused(StatusCode::PAYLOAD_TOO_LARGE, &most))
            } else {
                Ok(cells)
            }
        });
        if let Ok(cells) = &changed {
            (drawing.cells, drawing.revision) = (cells.clone(), revision);
            if base.is_none() || pins.is_some() {
                drawing.pins = pins.unwrap_or_default();
            }
        }
        let (pins, shown) = (drawing.pins.clone(), drawing.shown.clone());
        drawings.push(drawing);
        if drawings.len() > PAGES {
            drawings.remove(0);
        }
        Ok(Taken { cells: changed?, pins, shown })
    }
}

/// Analyses cells, and returns the answer and the modules that are shown.
fn analyse(
    cells: &BTreeSet<Cell>,
    pins: &[Pin],
    shown: &[[Cell; 2]],
    families: Option<Families>,
    budget: &Budget,
) -> (Value, Vec<[Cell; 2]>) {
    let listed: Vec<Cell> = cells.iter().copied().collect();
    let going = || budget.is_left();
    let parts = components(&listed);
    let refused = |error: &PairingError| json!({ "result": "refused", "why": error.to_string() });
    let pins = match pins::checked(cells, pins) {
        Ok(pins) => pins,
        Err(error) => return (refused(&error), Vec::new()),
    };
    let mut whole: Option<(Analysis, Vec<[Cell; 2]>, Vec<Cell>)> = None;
    let alone = parts.len() == 1;
    for (part, pins) in parts.iter().zip(pins_of_parts(&parts, pins)) {
        let pairing = match Pairing::pinned(part, &pins) {
            Ok(pairing) => pairing,
            Err(error) => return (refused(&error), Vec::new()),
        };
        let wanted = alone && families.is_some();
        let analysis = Analysis::of(&pairing, wanted.then_some(Allowed::Any), wanted, &going);
        let (pairs, over) = pairing.keeping(shown);
        match &mut whole {
            None => whole = Some((analysis, pairs, over)),
            Some((all, all_pairs, all_over)) => {
                all.join(analysis);
                all_pairs.extend(pairs);
                all_over.extend(over);
            }
        }
    }
    let Some((mut analysis, pairs, over)) = whole else {
        let why = PairingError::Empty.to_string();
        return (json!({ "result": "empty", "why": why, "cells": 0, "parts": 0 }), Vec::new());
    };
    let families = families.filter(|_| alone).map(|families| possible(families, &listed, &analysis));
    // A person wants modules that do not jump about, a file the canonical ones.
    (analysis.pairs, analysis.unpaired) = (pairs.clone(), over);
    let mut value = serde_json::to_value(&analysis).unwrap_or_default();
    value["result"] = json!("analysed");
    value["cells"] = json!(listed.len());
    value["parts"] = json!(parts.len());
    value["families"] = json!(families);
    value["complete"] = json!(!budget.was_ended());
    (value, pairs)
}

/// Returns the pins of each part. The cells of a pin share a face, so they are in one part.
fn pins_of_parts(parts: &[Vec<Cell>], pins: Vec<Pin>) -> Vec<Vec<Pin>> {
    let mut of_parts = vec![Vec::new(); parts.len()];
    if parts.len() == 1 {
        return vec![pins];
    }
    let part_of: BTreeMap<Cell, usize> =
        parts.iter().enumerate().flat_map(|(i, part)| part.iter().map(move |cell| (*cell, i))).collect();
    for pin in pins {
        if let Some(part) = part_of.get(&pin[0]) {
            of_parts[*part].push(pin);
        }
    }
    of_parts
}

/// Says of each family whether it can build the drawing.
fn possible(families: Families, cells: &[Cell], analysis: &Analysis) -> Vec<Value> {
    let standing = analysis.split.as_ref().map(|split| &split.standing);
    let drawing = DrawnStructure {
        name: "drawing",
        cells,
        standing: standing.map(|s| s.chains.as_slice()).unwrap_or_default(),
        why_not_standing: standing.and_then(|s| s.reason.as_deref()),
    };
    let all = families.all.iter().filter_map(|family| Some((family.name(), family.scenario_of(&drawing)?)));
    all.map(|(name, text)| json!({ "name": name, "can": text.is_ok(), "why": text.err() })).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_processes::family::families;

    fn ask(analyses: &Arc<Analyses>, body: &Value) -> Response {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(analyses.answer(body.to_string().as_bytes(), families()))
    }

    fn body(session: &str, revision: u64, base: Option<u64>, add: &[[i16; 3]]) -> Value {
        json!({ "version": 1, "session": session, "revision": revision, "base": base, "add": add, "all": true })
    }

    #[test]
    fn changes_are_answered_and_unknown_revisions_are_not() {
        let analyses = Arc::new(Analyses::default());
        let (status, value) = ask(&analyses, &body("a", 1, None, &[[0, 0, 0], [1, 0, 0], [2, 0, 0]]));
        assert_eq!((status, &value["d"], &value["cells"]), (StatusCode::OK, &json!(1), &json!(3)));
        assert!(value["repairs"].as_array().is_some_and(|r| !r.is_empty()) && value["complete"] == true);
        let (_, value) = ask(&analyses, &body("a", 2, Some(1), &[[3, 0, 0]]));
        assert_eq!((&value["d"], &value["revision"], &value["cells"]), (&json!(0), &json!(2), &json!(4)));
        assert_eq!(ask(&analyses, &body("a", 3, Some(1), &[])).1["result"], "stale");
        assert_eq!(ask(&analyses, &body("b", 3, Some(2), &[])).1["result"], "stale");
        let (_, value) = ask(&analyses, &body("a", 3, Some(2), &[[9, 0, 0], [10, 0, 0]]));
        assert_eq!((&value["parts"], &value["d"], &value["families"]), (&json!(2), &json!(0), &Value::Null));
        assert_eq!(ask(&analyses, &body("c", 1, None, &[])).1["result"], "empty");
    }

    #[test]
    fn pins_are_kept_until_they_are_given_up_and_named_if_they_cost_a_module() {
        let analyses = Arc::new(Analyses::default());
        let mut first =
            body("a", 1, None, &[[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [9, 0, 0], [9, 1, 0]]);
        first["pins"] = json!([[[2, 0, 0], [1, 0, 0]], [[9, 0, 0], [9, 1, 0]]]);
        let (_, value) = ask(&analyses, &first);
        let costly = json!([[[1, 0, 0], [2, 0, 0]]]);
        assert_eq!(
            (&value["d"], &value["d_without_pins"], &value["costly_pins"], &value["parts"]),
            (&json!(2), &json!(0), &costly, &json!(2)),
            "{value}"
        );
        // If the request names no pins, they stay. An empty list removes them, and so does a drawing that is sent again.
        let (_, value) = ask(&analyses, &body("a", 2, Some(1), &[[4, 0, 0], [5, 0, 0]]));
        assert_eq!((&value["d"], &value["pins"][0]), (&json!(2), &costly[0]), "{value}");
        let mut given_up = body("a", 3, Some(2), &[]);
        given_up["pins"] = json!([]);
        assert_eq!(ask(&analyses, &given_up).1["d"], 0);
        // A pin of a cell that goes away is refused until the page sends the others.
        ask(&analyses, &first);
        let mut without = body("a", 2, Some(1), &[]);
        without["remove"] = json!([[9, 0, 0]]);
        let (_, value) = ask(&analyses, &without);
        assert!(
            value["result"] == "refused" && value["why"].as_str().unwrap().contains("[9, 0, 0]"),
            "{value}"
        );
    }

    #[test]
    fn the_modules_that_are_shown_stay_where_they_can() {
        let analyses = Arc::new(Analyses::default());
        let line = |n: i16| (1..n).map(|x| [x, 0, 0]).collect::<Vec<_>>();
        let (_, before) = ask(&analyses, &body("a", 1, None, &line(5)));
        let (_, after) = ask(&analyses, &body("a", 2, Some(1), &[[0, 0, 0]]));
        let pairs = |value: &Value| value["pairs"].as_array().unwrap().clone();
        assert!(pairs(&before).iter().all(|pair| pairs(&after).contains(pair)), "{before} {after}");
    }
}
