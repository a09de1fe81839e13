//! The answer of `metamorph room` as text for people.

use super::help::Least;
use super::model::{CELL_M, Placement};
use super::study::Session;
use super::{Answer, Precision, RoomArgs};
use metamorph_text::escape::Shown as _;
use metamorph_text::format::many;
use std::fmt::Write;

/// Returns the text.
pub(super) fn text(answer: &Answer, args: &RoomArgs) -> String {
    let mut out = String::new();
    let (w, d) = answer.size;
    let _ = writeln!(out, "{}", answer.name.as_deref().unwrap_or(&answer.file));
    let _ = writeln!(
        out,
        "  room      {w} by {d} connectors, {:.1} m by {:.1} m",
        f64::from(w) * CELL_M,
        f64::from(d) * CELL_M
    );
    let _ = writeln!(
        out,
        "  pieces    {}, of {}",
        answer.pieces.len(),
        many(answer.metamodules as u64, "metamodule")
    );
    if let Some(name) = &args.snap {
        let _ = match answer.snap {
            Some(place) => writeln!(out, "  nearest   {name}: {}", at(place)),
            None => writeln!(out, "  nearest   there is no place for {name}"),
        };
    }
    if args.put_right {
        put_right(&mut out, answer);
    }
    let hard = answer.violations.iter().filter(|v| !v.wish).count();
    let _ = match (answer.violations.len(), hard) {
        (0, _) => writeln!(out, "  check     no constraint is violated"),
        (all, 0) => writeln!(out, "  check     {} not fulfilled", many(all as u64, "wish")),
        (_, hard) => writeln!(out, "  check     {} violated", many(hard as u64, "constraint")),
    };
    for violation in &answer.violations {
        let number = violation.constraint.map_or_else(String::new, |n| format!(" {n}"));
        let wish = if violation.wish { " (a wish)" } else { "" };
        let _ = writeln!(out, "    {}{number}{wish}: {}", violation.rule, violation.why);
    }
    for circle in &answer.circles {
        let _ = writeln!(
            out,
            "  circle    {} around {}: {}",
            many(circle.pieces as u64, "piece"),
            circle.around,
            precise(&circle.precision)
        );
    }
    if let Some(session) = &answer.session {
        of_session(&mut out, session, &answer.errors);
    }
    match (&args.write, &answer.order[..]) {
        (Some(path), [_, ..]) => {
            let _ = writeln!(out, "  order     {}", answer.order.join(", "));
            let _ = writeln!(out, "  written   {}", path.shown());
        }
        (Some(_), []) => {
            let _ = writeln!(out, "  written   nothing, since a constraint is violated");
        }
        (None, _) => {}
    }
    out
}

fn at(Placement { at: (x, y), turn }: Placement) -> String {
    format!("at = [{x}, {y}], turn = {turn}")
}

fn put_right(out: &mut String, answer: &Answer) {
    let Some(mended) = &answer.put_right else {
        let _ = writeln!(out, "  put right no way was found");
        return;
    };
    let proof = match mended.least {
        Least::Proven => "the least",
        Least::Heuristic => "not proven least",
    };
    let _ = writeln!(out, "  put right total displacement {} ({proof})", mended.total);
    let moved = answer.pieces.iter().zip(&mended.placements).filter(|(piece, place)| piece.place != **place);
    for (piece, place) in moved {
        let _ = writeln!(out, "    {}: {}", piece.name, at(*place));
    }
}

fn precise(precision: &Precision) -> String {
    let p_g = precision.p_g.map_or_else(|| "none".to_owned(), |p_g| format!("{p_g:.4}"));
    format!("p_l {:.4} m, p_g {p_g}", precision.p_l)
}

fn of_session(out: &mut String, session: &Session, errors: &[String]) {
    let _ = writeln!(out, "  session   {:.1} s from the first action to the last", session.time_s);
    let actions = session.actions.iter().map(|(action, n)| format!("{n} {action:?}").to_lowercase());
    let _ = writeln!(out, "    actions {}", actions.collect::<Vec<_>>().join(", "));
    let _ = writeln!(out, "    eye     {} samples, {:.2} m", session.samples, session.path_m);
    let measures = session.precision.as_ref().map_or_else(|| "no circle".to_owned(), precise);
    let _ = writeln!(out, "    circle  {measures}");
    let _ = writeln!(out, "    errors  {}", errors.len());
    for error in errors {
        let _ = writeln!(out, "      {}", error.escape_debug());
    }
}
