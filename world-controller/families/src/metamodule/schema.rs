//! The parts of the JSON schema of scenarios that only metamodules have.

use super::elements::{MASS, TURN};
use super::error::{MAX_COMMUNICATION_RANGE, MAX_FLOOR, MAX_METAMODULES};
use super::field::{MAX_RANGE, MAX_THOUSANDTHS};
use super::scenario::{CLASS, FACES, FALLBACKS, FLOOR, KIND, SEED_AUTHORITIES, SHAPES};
use metamorph_protocol::manipulation::element::{MAX_CELLS, NAMES};
use metamorph_protocol::manipulation::load::MAX_GRAMS;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::elements::MAX_ELEMENTS;
use metamorph_protocol::metamodule::params::{
    Ask, COMMUNICATION_RANGE, LEAST_COMMUNICATION_RANGE, PrecedenceBy, Strategy,
};
use metamorph_protocol::roombots::Kind;
use metamorph_scenario::definitions::{
    NUMBERED, former, names, of, one_of, one_of_its_keys, or, said, seldom, table, text,
};
use metamorph_scenario::family::FamilySchema;
use metamorph_scenario::plan::BEAT;
use serde_json::{Value, json};

/// Returns the schema of the metamodules' sections.
pub fn schema() -> FamilySchema {
    let seeds = json!({ "type": "array", "minItems": 1, "items": of("seed") });
    let mut goal = table(
        "Seeds to be filled, level by level.",
        &[],
        json!({
            "name": said(NUMBERED, text()),
            "at": said("When it replaces the previous goal; left out in the first goal only.", of("time")),
            "shape": said("The shape; left out if there are `levels`.", of("library")),
            "levels": said("The seeds by level; left out if there is a `shape`.", json!({ "type": "array", "items": seeds })),
            "order": said(
                "The order of the seeds in a level.",
                or(SeedOrder::default().name(), names(&SeedOrder::ALL.map(SeedOrder::name))),
            ),
        }),
    );
    goal["oneOf"] = json!([{ "required": ["shape"] }, { "required": ["levels"] }]);
    FamilySchema { swarm: swarm(), goal, protocol: protocol(), shapes: &SHAPES, definitions: definitions() }
}

/// Returns the schema of `[swarm]`.
fn swarm() -> Value {
    let start =
        json!({ "anyOf": [{ "const": "random" }, of("floor"), { "type": "array", "items": of("place") }] });
    let range = or(
        COMMUNICATION_RANGE,
        json!({ "type": "integer", "minimum": LEAST_COMMUNICATION_RANGE, "maximum": MAX_COMMUNICATION_RANGE }),
    );
    table(
        "Two Roombots modules each, which walk over a floor of connectors.",
        &["family"],
        json!({
            "family": said("The kind of modules.", json!({ "const": super::NAME })),
            "kind": said("How the two modules of a metamodule are joined.", or(KIND.name(), names(&Kind::METAMODULES.map(Kind::name)))),
            "count": said(
                "Default: the length of `start`, or one for each seed of the largest goal.",
                json!({ "type": "integer", "minimum": 1, "maximum": MAX_METAMODULES }),
            ),
            "floor": said("The connectors of the floor.", or(json!({ "min": FLOOR.min, "max": FLOOR.max }), of("floor"))),
            "communication_range": said("The communication range in connectors.", range.clone()),
            "hearing": former("communication_range", range),
            "start": said("Drawn from the seed of the run, on the whole floor or in an area of it, or a list.", or("random", start)),
            "turn_time": said("How long a step of a joint takes, and a connection.", or(BEAT.to_string(), of("time"))),
            "failed_connections": seldom("How often a move or a connection fails."),
            "connection": crate::connection::schema(),
            "element": said(
                "Passive elements that metamodules carry, with `strategy = \"planned\"`. If left out, there are none.",
                json!({ "type": "array", "maxItems": MAX_ELEMENTS, "items": of("element") }),
            ),
        }),
    )
}

/// Returns the schema of `[protocol]`.
fn protocol() -> Value {
    table(
        "How metamodules decide.",
        &[],
        json!({
            "strategy": said(
                "How metamodules choose their moves: towards the nearest seed (greedy), by the slope or the step of a field, by plans that they \
                 negotiate, or by one plan of the controller.",
                or(Strategy::default().name(), names(&Strategy::ALL.map(Strategy::name))),
            ),
            "precedence": said(
                "Which of two close together goes first, with `greedy`, `slope` and `step`. Default: within 4 by seed-distance for `greedy`, `off` for the others.",
                json!({ "anyOf": [{ "const": "off" }, of("precedence")] }),
            ),
            "settled_repel": said(
                "Whether settled metamodules repel others, with `slope` and `step`. Default: true.",
                json!({ "type": "boolean" }),
            ),
            "repulsion": said("The repulsion by neighbours. Default: that of the strategy.", of("repulsion")),
            "ask": said(
                "Before which searches for a plan of all together a metamodule asks the operator, with `negotiated`: none, those that begin because nothing moves, or all.",
                or(Ask::ALL[0].0, names(&Ask::ALL.map(|(name, _)| name))),
            ),
            "answer_within": said(
                "How long it waits for the answer before it goes on by itself. Default: three times the patience of metamodules.",
                of("time"),
            ),
            "seed_authority": said("The authority that opens seeds.", one_of(&SEED_AUTHORITIES)),
            "teller": former("seed_authority", one_of(&SEED_AUTHORITIES)),
            "relocate": said(
                "Whether a goal that cannot be built in place is moved.",
                or(bool::default(), json!({ "type": "boolean" })),
            ),
            "fallback": said(
                "What metamodules do under `planned` where the plan leaves seeds unfilled: decide as under `negotiated`, the default, or rest.",
                names(&FALLBACKS.map(|(name, _)| name)),
            ),
            "detector": said(
                "Whether the swarm detects deadlocks by itself.",
                or(bool::default(), json!({ "type": "boolean" })),
            ),
        }),
    )
}

/// Returns what the sections refer to.
fn definitions() -> Vec<(&'static str, Value)> {
    let direction = names(&FACES.map(|(name, _)| name));
    vec![
        (
            "floor",
            table(
                &format!("Both corners belong to it; at most {MAX_FLOOR} connectors along each side."),
                &["min", "max"],
                json!({
                    "min": said("The corner with the smallest coordinates.", of("connector")),
                    "max": said("The corner with the largest coordinates.", of("connector")),
                }),
            ),
        ),
        (
            "place",
            table(
                "The start of a metamodule: a connector, and quarter turns.",
                &["at"],
                json!({
                    "at": said("The connector of the floor.", of("connector")),
                    "class": said("Quarter turns about the connector.", or(CLASS, json!({ "type": "integer", "minimum": 0, "maximum": 3 }))),
                }),
            ),
        ),
        (
            "library",
            one_of_its_keys(table(
                "A goal of the thesis, by the corner of its place.",
                &[],
                json!({
                    "box": said("The box of the thesis, with its corner at this connector.", of("connector")),
                    "chair": said("The chair of the thesis, with its corner at this connector.", of("connector")),
                }),
            )),
        ),
        (
            "element",
            table(
                "A passive element: where it lies at the start, and where it lies or metamodules in seeds hold it in the end.",
                &["shape", "at", "to"],
                json!({
                    "name": said("If left out, `element 1` and so on.", text()),
                    "shape": said(
                        &format!("A name ({NAMES}) or a list of cells."),
                        json!({ "anyOf": [{ "type": "string" }, { "type": "array", "minItems": 1, "maxItems": MAX_CELLS, "items": of("cell") }] }),
                    ),
                    "mass": said("In kilograms.", or(MASS, json!({ "type": "number", "exclusiveMinimum": 0, "maximum": MAX_GRAMS / 1000 }))),
                    "at": said("Its place at the start.", of("lying")),
                    "to": said("Its goal; with several goals of the swarm one for all, or one for each.", json!({
                        "anyOf": [of("lying"), { "type": "array", "minItems": 1, "items": of("lying") }]
                    })),
                }),
            ),
        ),
        (
            "lying",
            table(
                "The cell where cell (0, 0, 0) of an element is, and where its z and x axes point.",
                &["cell"],
                json!({
                    "cell": said("Where cell (0, 0, 0) is.", of("cell")),
                    "turn": said("Where its z axis and its x axis point.", or(TURN, text())),
                }),
            ),
        ),
        (
            "seed",
            table(
                "A connector, and the directions from cell to cell.",
                &["foot", "directions"],
                json!({
                    "foot": said("The connector of the floor.", of("connector")),
                    "directions": said("From each cell to the next.", json!({ "type": "array", "minItems": 3, "maxItems": 3, "items": direction })),
                }),
            ),
        ),
        (
            "precedence",
            table(
                "Of two metamodules within this many connectors the one nearer to an open seed, or with the smaller id, goes first.",
                &["within", "by"],
                json!({
                    "within": said("The distance in connectors.", json!({ "type": "integer", "minimum": 1, "maximum": MAX_COMMUNICATION_RANGE })),
                    "by": said("What decides.", names(&PrecedenceBy::ALL.map(PrecedenceBy::name))),
                }),
            ),
        ),
        (
            "repulsion",
            table(
                "The repulsion by neighbours, in thousandths of the attraction and in cells; the defaults are those of the strategy.",
                &[],
                json!({
                    "strength": said(
                        "The strength, in thousandths of the attraction. Default: that of the strategy.",
                        json!({ "type": "integer", "minimum": 0, "maximum": MAX_THOUSANDTHS }),
                    ),
                    "decay": said(
                        "The decrease with distance. Default: that of the strategy.",
                        json!({ "type": "integer", "minimum": 0, "maximum": 1000 }),
                    ),
                    "range": said(
                        "The range in cells. Default: that of the strategy.",
                        json!({ "type": "integer", "minimum": 1, "maximum": MAX_RANGE }),
                    ),
                }),
            ),
        ),
    ]
}
