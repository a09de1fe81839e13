//! Rooms as text: what is refused, what is violated, and what puts it right.

use super::constraint::{check, first};
use super::description::describe;
use super::document::read;
use super::edit::{Edit, EditError, apply};
use super::help::{Least, put_right, snap};
use super::model::{Placement, Room};
use super::{reach, template::Template};
use crate::room::form::{Form, SHAPES};
use metamorph_families::metamodule::motion_database::motions;
use metamorph_processes::family::sources;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::roombots::Kind;
use serde_json::json;

const HEAD: &str =
    "version = 1\n[room]\nsize = [30, 20]\ndoors = [[0, 10]]\nstore = { min = [0, 0], max = [29, 4] }\n";

fn piece(name: &str, at: [i16; 2], turn: u8) -> String {
    format!("[[piece]]\nname = \"{name}\"\nshape = \"chair\"\nat = {at:?}\nturn = {turn}\n")
}

fn room(parts: &[String]) -> Room {
    let text = format!("{HEAD}{}", parts.concat());
    read("room.toml", &text).unwrap_or_else(|wrong| panic!("{wrong}"))
}

fn constraint(kind: &str, rest: &str) -> String {
    format!("[[constraint]]\nkind = \"{kind}\"\n{rest}\n")
}

/// Returns the names of the violated rules of two chairs at these places.
fn violated(a: ([i16; 2], u8), b: ([i16; 2], u8), kind: &str, rest: &str) -> Vec<&'static str> {
    let room = room(&[piece("a", a.0, a.1), piece("b", b.0, b.1), constraint(kind, rest)]);
    check(&room).iter().map(|violation| violation.rule).collect()
}

/// A chair is 3 connectors wide and 4 deep, its back in the north.
#[test]
fn each_rule_is_violated_where_it_should_be() {
    let both = "pieces = [\"a\", \"b\"]";
    let cells = |k: u16| format!("{both}\ncells = {k}");
    let circle = "pieces = [\"a\", \"b\", \"c\"]\naround = \"d\"";
    assert!(read("", &format!("{HEAD}{}", constraint("circle", circle))).is_err());
    let far = ([20, 10], 0);
    for (a, b, kind, rest, expected) in [
        (([5, 5], 0), far, "walkway", "cells = 3".to_owned(), &[][..]),
        (([28, 5], 0), far, "walkway", "cells = 3".to_owned(), &["inside"]),
        (([-1, 5], 0), far, "walkway", "cells = 3".to_owned(), &["inside"]),
        (([5, 5], 0), ([7, 5], 0), "wall", "piece = \"a\"\nwish = true".to_owned(), &["apart", "wall"]),
        (([0, 5], 0), far, "wall", "piece = \"a\"".to_owned(), &[]),
        (([27, 5], 0), far, "wall", "piece = \"a\"".to_owned(), &[]),
        (([5, 5], 0), ([10, 5], 0), "gap", cells(2), &[]),
        (([5, 5], 0), ([10, 5], 0), "gap", cells(3), &["gap"]),
        (([5, 5], 0), ([10, 5], 0), "near", cells(2), &[]),
        (([5, 5], 0), ([10, 5], 0), "near", cells(1), &["near"]),
        (([5, 10], 0), ([5, 5], 0), "facing", both.to_owned(), &[]),
        (([5, 10], 1), ([5, 5], 0), "facing", both.to_owned(), &["facing"]),
        (([5, 10], 2), ([5, 5], 0), "facing", both.to_owned(), &["facing"]),
        (([5, 10], 1), ([12, 10], 0), "facing", both.to_owned(), &[]),
        (([5, 10], 3), ([12, 10], 0), "facing", both.to_owned(), &["facing"]),
        (([5, 10], 0), ([12, 10], 1), "align", format!("{both}\naxis = \"x\""), &[]),
        (([5, 10], 0), ([12, 12], 1), "align", format!("{both}\naxis = \"x\""), &["align"]),
        (([5, 5], 0), ([5, 12], 0), "align", format!("{both}\naxis = \"y\""), &[]),
        (([5, 5], 0), ([7, 12], 0), "align", format!("{both}\naxis = \"y\""), &["align"]),
        (([5, 5], 0), far, "clear", "area = { min = [7, 8], max = [9, 9] }".to_owned(), &["clear"]),
        (([5, 5], 0), far, "clear", "area = { min = [8, 5], max = [9, 9] }".to_owned(), &[]),
        // The room is 30 by 20: beside a chair at its door a square of 10 does not fit, one of 6 does.
        (([0, 5], 0), far, "walkway", "cells = 6".to_owned(), &[]),
        (([0, 8], 0), far, "walkway", "cells = 1".to_owned(), &["walkway", "walkway"]),
    ] {
        assert_eq!(violated(a, b, kind, &rest), expected, "{a:?} {b:?} {kind} {rest}");
    }
}

#[test]
fn circles_are_judged_by_distance_centroid_and_angle() {
    let circle = |places: [[i16; 2]; 4]| {
        let mut parts: Vec<String> =
            places.iter().zip(["a", "b", "c", "d"]).map(|(at, name)| piece(name, *at, 0)).collect();
        parts.push(piece("middle", [14, 8], 0));
        let rest = "pieces = [\"a\", \"b\", \"c\", \"d\"]\naround = \"middle\"\nradius = 6\ntolerance = 0.7";
        parts.push(constraint("circle", rest));
        check(&room(&parts)).into_iter().map(|v| v.why).collect::<Vec<_>>()
    };
    assert_eq!(circle([[20, 8], [14, 14], [8, 8], [14, 2]]), Vec::<String>::new());
    for (places, why) in [
        ([[21, 8], [14, 14], [8, 8], [14, 2]], "7.00 cells"),
        // Two in the north-east.
        ([[20, 8], [14, 14], [8, 8], [18, 4]], "centroid"),
        ([[18, 12], [14, 14], [10, 4], [14, 2]], "angles"),
    ] {
        let found = circle(places);
        assert!(found.len() == 1 && found[0].contains(why), "{places:?}: {found:?}");
    }
}

#[test]
fn wrong_rooms_are_refused_with_place_and_fix() {
    let chair = piece("a", [5, 5], 0);
    for (text, place, why) in [
        ("version = 2".to_owned(), "room.toml:1:11", "version 2"),
        ("[room]\nsize = [4, 4]".to_owned(), "room.toml", "`version`"),
        ("version = 1".to_owned(), "room.toml", "`room`"),
        (HEAD.replace("[30, 20]", "[300, 20]"), "room.toml:3:8", "300 or 20"),
        (HEAD.replace("[29, 4]", "[30, 4]"), "room.toml:5:9", "(30, 4) is not in the room"),
        (HEAD.replace("doors", "windows"), "room.toml:4:1", "windows"),
        (HEAD.replace("= [30", "[30"), "room.toml:3", "TOML"),
        (format!("{HEAD}{chair}{chair}"), "room.toml:12:8", "two pieces"),
        (
            format!("{HEAD}{}", chair.replace("shape = \"chair\"", "cells = [[0, 0, 0]]")),
            "room.toml:8",
            "multiple of four",
        ),
        (
            format!("{HEAD}{}", chair.replace("shape = \"chair\"", "file = \"none.toml\"")),
            "room.toml:8",
            "drawing",
        ),
        (format!("{HEAD}{}", chair.replace("turn = 0", "turn = 4")), "room.toml:10", "4"),
        (format!("{HEAD}{}", chair.replace("shape = \"chair\"", "")), "room.toml:6", "`shape`"),
        (
            format!("{HEAD}{chair}{}", constraint("gap", "pieces = [\"a\", \"b\"]\ncells = 1")),
            "room.toml:13",
            "no piece `b`",
        ),
        (
            format!("{HEAD}{chair}{}", constraint("gap", "pieces = [\"a\", \"a\"]\ncells = 1")),
            "room.toml:13",
            "twice",
        ),
        (format!("{HEAD}{chair}{}", constraint("far", "")), "room.toml:12", "far"),
        (format!("{HEAD}{chair}{}", constraint("wall", "piece = \"a\"\ncells = 1")), "room.toml:14", "cells"),
    ] {
        let found = read("room.toml", &text).expect_err(&text).to_string();
        assert!(found.contains(place) && found.contains(why) && found.contains("fix:"), "{text}\n{found}");
    }
}

#[test]
fn a_piece_snaps_to_the_nearest_place() {
    let parts = [
        piece("a", [5, 5], 0),
        piece("b", [6, 5], 0),
        constraint("gap", "pieces = [\"a\", \"b\"]\ncells = 1"),
    ];
    let room = room(&parts);
    assert_eq!(snap(&room, 1, &|| true), Some(Placement { at: (9, 5), turn: 0 }));
    let mut full = Room { size: (4, 4), doors: Vec::new(), store: None, ..room };
    full.pieces[0].place.at = (0, 0);
    assert_eq!(snap(&full, 1, &|| true), None);
}

/// Compares with all arrangements of two chairs in a small room.
#[test]
fn the_least_total_displacement_is_found() {
    let mut rng = Rng::named(1, "put right", 0);
    for round in 0..12 {
        let mut at = || [rng.below(6) as i16, rng.below(5) as i16];
        let (a, b) = (at(), at());
        let text = format!(
            "version = 1\n[room]\nsize = [9, 8]\n{}{}{}{}",
            piece("a", a, 0),
            piece("b", b, 2),
            constraint("gap", "pieces = [\"a\", \"b\"]\ncells = 1"),
            constraint("wall", "piece = \"a\""),
        );
        let room = read("room.toml", &text).unwrap();
        let mended = put_right(&room, &|| true, &|| true).unwrap();
        let all = || {
            let places = (0..9).flat_map(|x| {
                (0..8).flat_map(move |y| (0..4).map(move |turn| Placement { at: (x, y), turn }))
            });
            places.collect::<Vec<_>>()
        };
        let mut least = u32::MAX;
        let mut tried = room.clone();
        for one in all() {
            for other in all() {
                let total = room.pieces[0].place.distance(one) + room.pieces[1].place.distance(other);
                if total < least {
                    tried.place(&[one, other]);
                    if first(&tried).is_none() {
                        least = total;
                    }
                }
            }
        }
        assert_eq!((mended.total, mended.least), (least, Least::Proven), "round {round}: {a:?} {b:?}");
        tried.place(&mended.placements);
        assert_eq!(first(&tried), None);
    }
}

#[test]
fn templates_stand_apart_and_look_inwards() {
    let form = Form::library(SHAPES[1].1);
    for template in [
        Template::Circle { count: 10, around: (60, 60), radius: 12.0 },
        Template::Row { count: 8, at: (3, 3), gap: 1 },
        Template::Grid { count: (4, 3), at: (3, 3), gap: 2 },
        Template::Auditorium { count: (5, 3), around: (60, 20), radius: 14.0, gap: 6 },
    ] {
        let places = template.places(&form);
        let mut parts: Vec<String> = Vec::new();
        for (i, Placement { at, turn }) in places.iter().enumerate() {
            parts.push(piece(&i.to_string(), [at.0, at.1], *turn));
        }
        let text = format!("version = 1\n[room]\nsize = [120, 120]\n{}", parts.concat());
        let mut room = read("room.toml", &text).unwrap();
        assert!(check(&room).is_empty(), "{template:?}: {:?}", check(&room));
        if let Template::Circle { around, .. } | Template::Auditorium { around, .. } = template {
            let stage = format!("{text}{}", piece("stage", [around.0 - 1, around.1 - 1], 0));
            let facing =
                (0..places.len()).map(|i| constraint("facing", &format!("pieces = [\"{i}\", \"stage\"]")));
            room = read("room.toml", &format!("{stage}{}", facing.collect::<String>())).unwrap();
            assert!(check(&room).is_empty(), "{template:?}: {:?}", check(&room));
        }
    }
}

/// A chair behind a row of boxes has to be built before them; behind a wall that stays there is no order.
#[test]
fn what_is_behind_others_is_built_before_them() {
    let motions = motions(sources(), Kind::Srs).unwrap();
    let parts = || {
        let behind = piece("behind", [2, 14], 0);
        let row = (0..4).map(|i| piece(&format!("row {i}"), [i * 3, 8], 0).replace("chair", "box"));
        row.chain([behind, constraint("reach", "")]).collect::<String>()
    };
    let head = "version = 1\n[room]\nsize = [12, 24]\nstore = { min = [0, 0], max = [11, 4] }\n";
    let open = read("room.toml", &format!("{head}{}", parts())).unwrap();
    let order = reach::order(&open, &motions).unwrap();
    assert_eq!(order[0].piece, 4, "{order:?}");
    assert_eq!(reach::check(&open, &motions), []);
    let seeds = order.iter().map(|stage| stage.levels.iter().flatten().count());
    assert_eq!(seeds.collect::<Vec<_>>(), [6, 4, 4, 4, 4]);
    let head = head.replace("store", "keep_out = [{ min = [0, 12, 0], max = [11, 12, 5] }]\nstore");
    let shut = read("room.toml", &format!("{head}{}", parts())).unwrap();
    let blocked = reach::order(&shut, &motions).unwrap_err();
    assert!(blocked.pieces == [4] && !blocked.cells.is_empty(), "{blocked:?}");
    let violations = reach::check(&shut, &motions);
    assert!(violations.len() == 1 && violations[0].why.contains("behind"), "{violations:?}");
}

const EDITED: &str = "\
# A room with comments.
version = 1
[room]
size = [30, 20]     # by night
store = { min = [0, 0], max = [29, 4] }

[[piece]]
name = \"a\"
shape = \"chair\"
at = [5, 8]         # at the window
[[piece]]
name = \"b\"
shape = \"chair\"
at = [12, 8]
turn = 1
[[piece]]
name = \"c\"
cells = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3]]
at = [20, 8]

[[constraint]]      # the first
kind = \"align\"
pieces = [\"a\", \"b\", \"c\"]
axis = \"x\"
[[constraint]]
kind = \"gap\"
pieces = [\"a\", \"b\"]
cells = 2
[[constraint]]
kind = \"wall\"
piece = \"c\"
wish = true
";

/// Each change does to the text what it says and nothing else, and the changed text is a room.
#[test]
fn changes_keep_the_rest_of_the_text() {
    let place =
        |piece: &str, at: [i16; 2], turn: u8| json!({ "place": { "piece": piece, "at": at, "turn": turn } });
    for (edit, before, after) in [
        (place("a", [6, 9], 0), "at = [5, 8]  ", "at = [6, 9]  "),
        (
            place("a", [6, 9], 3),
            "at = [5, 8]         # at the window\n",
            "at = [6, 9]         # at the window\nturn = 3\n",
        ),
        (place("b", [-1, 8], 0), "at = [12, 8]\nturn = 1", "at = [-1, 8]\nturn = 0"),
        (
            json!({ "colour": { "piece": "c", "colour": "red" } }),
            "at = [20, 8]\n",
            "at = [20, 8]\ncolour = \"red\"\n",
        ),
        (json!({ "resize": { "size": [40, 20] } }), "[30, 20]", "[40, 20]"),
        (json!({ "wish": { "constraint": 3, "wish": false } }), "wish = true", "wish = false"),
        (
            json!({ "release": { "constraint": 2 } }),
            "[[constraint]]\nkind = \"gap\"\npieces = [\"a\", \"b\"]\ncells = 2\n",
            "",
        ),
        (
            json!({ "add": { "name": "d", "shape": "box", "at": [1, 12], "turn": 2, "colour": "red" } }),
            "at = [20, 8]\n",
            "at = [20, 8]\n\n[[piece]]\nname = \"d\"\nshape = \"box\"\nat = [1, 12]\nturn = 2\ncolour = \"red\"\n",
        ),
        (
            json!({ "constrain": { "kind": "near", "pieces": ["c", "a"], "cells": 4, "wish": true } }),
            "wish = true\n",
            "wish = true\n\n[[constraint]]\nkind = \"near\"\npieces = [\"c\", \"a\"]\ncells = 4\nwish = true\n",
        ),
    ] {
        let edits: Vec<Edit> = serde_json::from_value(json!([edit])).unwrap();
        let changed = apply(EDITED, &edits).unwrap();
        assert_eq!(changed, EDITED.replacen(before, after, 1), "{edit}");
        assert_ne!(changed, EDITED, "{edit}");
        assert!(read("room.toml", &changed).is_ok(), "{edit}: {changed}");
    }
    assert_eq!(apply(EDITED, &[]).unwrap(), EDITED);
}

#[test]
fn pieces_are_taken_out_of_and_renamed_in_constraints_and_arranged() {
    let changed = |edit: serde_json::Value| {
        let edits: Vec<Edit> = serde_json::from_value(json!([edit])).unwrap();
        apply(EDITED, &edits)
            .map(|text| read("room.toml", &text).unwrap_or_else(|wrong| panic!("{wrong}\n{text}")))
    };
    let kinds = |room: &Room| room.constraints.iter().map(|c| c.rule.name()).collect::<Vec<_>>();
    // A row of two is still one; a gap beside one piece and a wall behind none are not.
    assert_eq!(kinds(&changed(json!({ "remove": { "piece": "b" } })).unwrap()), ["align", "wall"]);
    assert_eq!(kinds(&changed(json!({ "remove": { "piece": "c" } })).unwrap()), ["align", "gap"]);
    let renamed = changed(json!({ "rename": { "piece": "c", "name": "a new name" } })).unwrap();
    assert_eq!((kinds(&renamed), renamed.find("a new name")), (vec!["align", "gap", "wall"], Some(2)));
    let circle = json!({ "template": "circle", "count": [4, 1], "around": [15, 12], "radius": 6.0, "gap": 0, "shape": "chair", "colour": "green" });
    let arranged = changed(json!({ "arrange": circle })).unwrap();
    assert_eq!((arranged.pieces.len(), arranged.find("chair 4")), (7, Some(6)));
    let inline =
        "version = 1\nroom = { size = [9, 9] }\npiece = [{ name = \"a\", shape = \"chair\", at = [0, 0] }]\n";
    let add: Vec<Edit> = serde_json::from_value(json!([
        { "add": { "name": "b", "cells": [[0, 0, 0], [0, 0, 1], [1, 0, 1], [1, 0, 0]], "pins": [[[0, 0, 0], [0, 0, 1]]], "at": [5, 5] } },
        { "place": { "piece": "a", "at": [1, 1], "turn": 0 } },
        { "constrain": { "kind": "walkway", "cells": 1 } },
    ]))
    .unwrap();
    let room = read("room.toml", &apply(inline, &add).unwrap()).unwrap_or_else(|wrong| panic!("{wrong}"));
    assert_eq!((room.pieces.len(), room.pieces[0].place.at, kinds(&room)), (2, (1, 1), vec!["walkway"]));
    for (edit, why) in [
        (json!({ "remove": { "piece": "d" } }), "no piece `d`"),
        (json!({ "place": { "piece": "", "at": [0, 0], "turn": 0 } }), "no piece ``"),
        (json!({ "release": { "constraint": 4 } }), "no constraint 4"),
        (json!({ "release": { "constraint": 0 } }), "no constraint 0"),
        (json!({ "wish": { "constraint": 9, "wish": true } }), "no constraint 9"),
        (
            json!({ "arrange": { "template": "row", "count": [200, 1], "around": [0, 0], "radius": 1.0, "gap": 0, "shape": "box" } }),
            "1 to 128 pieces",
        ),
        (
            json!({ "arrange": { "template": "row", "count": [2, 1], "around": [0, 0], "radius": 1.0, "gap": 0, "shape": "sofa" } }),
            "no shape `sofa`",
        ),
    ] {
        let error = changed(edit.clone()).err().map(|error| error.to_string()).unwrap_or_default();
        assert!(error.contains(why), "{edit}: {error}");
    }
    assert!(matches!(apply("version = ", &add), Err(EditError::Syntax(_))));
    assert!(matches!(apply("version = 1\nroom = 3\npiece = 4", &add), Err(EditError::NoTable("piece"))));
    assert!(
        serde_json::from_value::<Vec<Edit>>(
            json!([{ "place": { "piece": "a", "at": [0, 0], "turn": 0, "x": 1 } }])
        )
        .is_err()
    );
}

/// What is not known when the time is over is neither kept nor violated.
#[test]
fn descriptions_say_what_is_kept_violated_and_unknown() {
    let states = |room: &Room, going: bool, reach: bool| {
        let motions = motions(sources(), Kind::Srs).unwrap();
        let described = describe(room, reach.then_some(&motions), &|| going);
        let described = serde_json::to_value(&described).unwrap();
        let all = described["constraints"].as_array().unwrap().iter();
        let states: Vec<String> = all
            .map(|c| format!("{} {}", c["kind"].as_str().unwrap(), c["state"].as_str().unwrap()))
            .collect();
        (states, described["complete"] == true)
    };
    let parts = [
        piece("a", [5, 8], 0),
        piece("b", [12, 8], 0),
        constraint("gap", "pieces = [\"a\", \"b\"]\ncells = 9"),
        constraint("reach", ""),
    ];
    let known = room(&parts);
    let gap = "gap violated".to_owned();
    let kept = ["inside kept".to_owned(), "apart kept".to_owned()];
    let with = |reach: &str| [&kept[..], &[gap.clone(), format!("reach {reach}")]].concat();
    assert_eq!(states(&known, true, true), (with("kept"), true));
    assert_eq!(states(&known, true, false), (with("unknown"), true));
    let (unknown, complete) = states(&known, false, false);
    assert!(!complete && unknown.iter().all(|state| state.ends_with("unknown")), "{unknown:?}");
    let over = room(&[piece("a", [5, 8], 0), piece("b", [6, 8], 0), constraint("reach", "")]);
    assert_eq!(states(&over, true, true).0, ["inside kept", "apart violated", "reach unknown"]);
}
