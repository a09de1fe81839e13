//! Formats results as text for the terminal.

use super::busy;
use super::chairs;
use super::churn::Churn;
use super::flood;
use super::gait;
use super::growth::{Growth, Row, Run, Shape};
use super::machine::Machine;
use super::swarm::Swarms;
use super::wire;
use metamorph_report::statistics::PowerLaw;
use metamorph_text::format::number;
use metamorph_text::format::{bytes, count, many, percent};
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;

/// Describes the program and the machine.
pub fn machine(version: &str, m: &Machine) -> String {
    format!(
        "metamorph {version} on {}, {}, {}, Linux {}, load {:.1}\n",
        m.processor,
        many(m.processors as u64, "processor"),
        bytes(m.memory_bytes),
        m.kernel,
        m.load
    )
}

/// Formats the flood.
pub fn flood(rows: &[flood::Row], paint: Paint) -> String {
    let mut table = Table::new(&["block"]);
    table.head(&["modules", "messages", "ns/message", "messages/s", "events/s", "bytes/module"]);
    table.head(&["peak MB", "bare queue ns", "heap ns", "over queue", "over smallest"]);
    let smallest = rows.first().map_or(1.0, |r| r.ns_per_message);
    for r in rows {
        table.row(
            &[format!("{0}×{0}×{0}", r.side)],
            vec![
                count(r.modules),
                count(r.messages),
                number(r.ns_per_message),
                number(r.messages_per_s),
                number(r.events_per_s),
                number(r.bytes_per_module),
                count(r.peak_bytes / 1_000_000),
                number(r.queue_ns),
                number(r.heap_ns),
                times(r.ns_per_message / r.queue_ns),
                times(r.ns_per_message / smallest),
            ],
        );
    }
    format!(
        "{}\nHop counts flood a block from a corner; simulated, one thread, trace hash and counters on. Times are\nof the processor.\n{}",
        paint.strong("flood"),
        table.text(paint)
    )
}

/// Formats one run of a growth in a line.
pub fn grown(run: &Run) -> String {
    let walking = &run.walking;
    let of_all = |reason| percent(walking.denied_for(reason));
    format!(
        "{}: {} in {} s, {} violations; {} moves, {} messages and {} attempts a move; {} of the walkers move; denied: {} \
         occupied, {} reserved; {} µs of a processor a message",
        many(run.modules, "module"),
        run.outcome,
        number(run.makespan_s),
        run.violations,
        count(run.moves),
        number(run.messages_per_move()),
        hundredths(walking.attempts_per_move),
        percent(walking.moving),
        of_all("occupied"),
        of_all("reserved"),
        hundredths(micros(run.cpu_s, run.messages))
    )
}

/// Returns the processor time for each of a number of things, in microseconds.
fn micros(cpu_s: f64, of: u64) -> f64 {
    cpu_s * 1e6 / of.max(1) as f64
}

/// Formats a small number with two decimals.
fn hundredths(n: f64) -> String {
    format!("{n:.2}")
}

/// Formats the growth of one shape.
pub fn growth(g: &Growth, paint: Paint) -> String {
    let mut table = Table::new(&["modules"]);
    table.head(&[
        "goal",
        "layers",
        "outcome",
        "violations",
        "makespan s",
        "at least s",
        "box",
        "moves",
        "at least",
    ]);
    table.head(&["times", "messages", "a module", "a move", "cpu s", "µs/message", "µs/cell"]);
    table.head(&["moving", "attempts", "occupied", "reserved", "other"]);
    for r in &g.rows {
        let denied = |reason| r.walking.denials.get(reason).copied().unwrap_or(0);
        let (occupied, reserved) = (denied("occupied"), denied("reserved"));
        let other = r.walking.denials.values().sum::<u64>() - occupied - reserved;
        table.row(
            &[count(r.modules)],
            vec![
                count(r.goal),
                count(r.layers),
                r.outcome.clone(),
                count(r.violations),
                number(r.makespan_s),
                count(r.least_makespan_s),
                count(r.box_sides),
                count(r.moves),
                count(r.least_moves),
                number(r.times_least),
                count(r.messages),
                number(r.messages as f64 / r.modules as f64),
                number(r.messages_per_move),
                number(r.cpu_s),
                hundredths(micros(r.cpu_s, r.messages)),
                number(micros(r.cpu_s, r.goal)),
                percent(r.walking.moving),
                hundredths(r.walking.attempts_per_move),
                count(occupied),
                count(reserved),
                count(other),
            ],
        );
    }
    let (name, about) = match g.shape {
        Shape::Ball => ("growth", "A slab becomes a ball; N counts modules"),
        Shape::SolidPlate => {
            ("pyramid, solid plate", "A pyramid is built from the plate below it; N counts goal cells")
        }
        Shape::PorousPlate => ("pyramid, porous plate", "The same from a plate with tunnels"),
    };
    // Between the two largest sizes: small sizes do not show the asymptotic growth.
    let size = |r: &Row| g.shape.size(r) as f64;
    let lately = |f: fn(&Row) -> f64| match g.rows.as_slice() {
        [.., a, b] => (f(b) / f(a)).ln() / (size(b) / size(a)).ln(),
        _ => 0.0,
    };
    let grows = |what: &str, fit: Option<PowerLaw>, of: fn(&Row) -> f64| match fit {
        Some(f) => format!(
            "  {what} as N^{:.2} (R² {:.3}), in the end N^{:.2}\n",
            f.exponent,
            f.r_squared,
            lately(of)
        ),
        None => String::new(),
    };
    format!(
        "{}\n{about}; simulated, all invariants checked; a move takes 1 s. `at least` are lower bounds for\nevery protocol: the best assignments of cubes to goal cells, each by its shortest path. `box`: the sum of the sides of\nthe box around start and goal. `moving`: the share of the walkers that move; `attempts` for each move; `occupied`, `reserved`\nand `other`: requests denied for that reason.\n{}  fits over these sizes, which bound nothing (in the end: between the two largest)\n{}{}{}{}",
        paint.strong(name),
        table.text(paint),
        grows("seconds grow", g.makespan, |r| r.makespan_s),
        grows("moves grow", g.moves, |r| r.moves as f64),
        grows("the lower bound of moves grows", g.least_moves, |r| r.least_moves as f64),
        grows("messages grow", g.messages, |r| r.messages as f64)
    )
}

/// Formats the chair.
pub fn chairs(rows: &[chairs::Row], paint: Paint) -> String {
    let mut table = Table::new(&["strategy"]);
    table.head(&["runs", "built", "violations", "runs/s", "cpu ms a run"]);
    for r in rows {
        let cells =
            vec![count(r.runs), count(r.built), count(r.violations), number(r.runs_per_s), number(r.cpu_ms)];
        table.row(std::slice::from_ref(&r.strategy), cells);
    }
    let threads = rows.first().map_or(0, |r| r.threads);
    format!(
        "{}\nSix metamodules build the chair; simulated, all invariants checked, {} at the same time.\n{}",
        paint.strong("chairs"),
        many(threads, "run"),
        table.text(paint)
    )
}

/// Formats structures that walk.
pub fn gaits(gaits: &gait::Gaits, paint: Paint) -> String {
    let mut table = Table::new(&["structure"]);
    table.head(&["modules", "bodies", "agents", "both", "phases/s", "without prediction"]);
    for r in &gaits.rows {
        let cells = [r.bodies, r.agents, r.both, r.gait_messages, r.unpredicted].map(number);
        table.row(std::slice::from_ref(&r.structure), [vec![count(r.modules)], cells.into()].concat());
    }
    let mut learners = Table::new(&["learner"]);
    learners.head(&["parameters", "gaits", "cpu µs a gait"]);
    for l in &gaits.learners {
        let cells = vec![count(l.parameters), count(l.asked), number(l.us)];
        learners.row(std::slice::from_ref(&l.learner), cells);
    }
    format!(
        "{}\nStructures walk; simulated seconds by second of processor time of bodies and agents, and messages of class \
         gait a second in lock.\n{}\nLearners without trials.\n{}",
        paint.strong("gait"),
        table.text(paint),
        learners.text(paint)
    )
}

/// Formats the process link.
pub fn wire(rows: &[wire::Row], paint: Paint) -> String {
    let table = |mode: &str, of: fn(&wire::Row) -> wire::Cost| {
        let mut table = Table::new(&[mode]);
        table.head(&["round trip ns", "ours/this", "p50", "p99", "p99.9", "messages/s", "bad placements"]);
        for r in rows {
            let (this, own) = (of(r), rows.first().map_or(of(r), of));
            table.row(
                &[r.mechanism.to_owned()],
                vec![
                    number(this.round_trip_ns),
                    times(own.round_trip_ns / this.round_trip_ns),
                    number(this.p50_ns),
                    number(this.p99_ns),
                    number(this.p99_9_ns),
                    number(this.messages_per_s),
                    format!("{} of {}", this.bad_placements, this.turns),
                ],
            );
        }
        table.text(paint)
    };
    format!(
        "{}\nRound trips of 64 bytes between two processes, and throughput one way: polling on two processors,\nwaiting on one. \
         Mechanisms take turns, each time with new processes; turns in which these lie badly are\ncounted and left out. \
         Quantiles are of single round trips, with the time that reading the clock takes.\n{}{}",
        paint.strong("wire"),
        table("polling", |r| r.polling),
        table("waiting", |r| r.waiting)
    )
}

/// Formats the busy swarm.
pub fn busy(rows: &[busy::Row], paint: Paint) -> String {
    let mut table = Table::new(&["tokens"]);
    table.head(&["metamorph /s", "unix-seqpacket /s", "ours/socket"]);
    for r in rows {
        let ratio = times(r.ours_per_s / r.unix_socket_per_s);
        table.row(&[count(r.tokens.into())], vec![number(r.ours_per_s), number(r.unix_socket_per_s), ratio]);
    }
    let members = rows.first().map_or(0, |r| r.members);
    format!(
        "{}\nTokens passed on around a ring of {} that wait to be woken.\n{}",
        paint.strong("busy"),
        many(members as u64, "process"),
        table.text(paint)
    )
}

/// Formats swarms of processes.
pub fn swarm(s: &Swarms, paint: Paint) -> String {
    let mut table = Table::new(&["processes"]);
    table.head(&["up s", "flood s", "messages", "PSS kB each", "PSS MB", "idle agents %"]);
    table.head(&["idle controller %", "descriptors", "stopped s"]);
    for r in &s.rows {
        table.row(
            &[count(r.modules)],
            vec![
                format!("{:.2}", r.setup_s),
                format!("{:.2}", r.exchange_s),
                count(r.messages),
                number(r.pss_per_agent / 1e3),
                count(r.pss_bytes / 1_000_000),
                format!("{:.2}", r.idle_agents_percent),
                format!("{:.2}", r.idle_controller_percent),
                count(r.descriptors),
                format!("{:.2}", r.stop_s),
            ],
        );
    }
    let ended = s.ended_by.as_ref().map_or(String::new(), |why| format!("  {why}\n"));
    format!(
        "{}\nOne process for each module of a block; a flood goes through it, then it idles. Percent of one processor.\n{}{ended}  {} a process are enough for {}; `ulimit -Hn` sets that limit\n",
        paint.strong("swarm"),
        table.text(paint),
        many(s.descriptors, "descriptor"),
        many(s.modules_by_descriptors, "module")
    )
}

/// Formats deaths in a swarm.
pub fn churn(c: &Churn, paint: Paint) -> String {
    let mut table = Table::new(&["deaths/s wanted"]);
    table.head(&["deaths", "in s", "away ms: median", "worst", "not back", "controller %", "descriptors"]);
    for r in &c.rows {
        let cells = vec![
            count(r.deaths),
            format!("{:.1}", r.seconds),
            format!("{:.1}", r.away_median_ms),
            format!("{:.1}", r.away_worst_ms),
            count(r.missing),
            number(r.controller_percent),
            count(r.descriptors),
        ];
        table.row(&[r.wanted_per_s.to_string()], cells);
    }
    format!(
        "{}\n{} with the cube protocol, {} (PSS) each; modules are killed and started again.\n{}",
        paint.strong("churn"),
        many(c.modules, "process"),
        bytes(c.pss_per_agent as u64),
        table.text(paint)
    )
}

fn times(ratio: f64) -> String {
    format!("{ratio:.2}")
}
