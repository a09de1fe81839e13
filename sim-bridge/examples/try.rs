//! Tries scenarios out from the command line while the protocol is being worked on.

use metamorph_protocol::cube::params::*;
use metamorph_protocol::goal::*;
use metamorph_protocol::ids::*;
use metamorph_protocol::lattice::*;
use metamorph_protocol::link::*;
use metamorph_protocol::shape::*;
use metamorph_protocol::stream::Stream;
use metamorph_protocol::time::*;
use metamorph_sim_bridge::cube_world::*;
use metamorph_sim_bridge::director::*;
use metamorph_sim_bridge::faults::*;
use metamorph_sim_bridge::sim::*;
use std::sync::Arc;

fn arg(name: &str, default: &str) -> String {
    let args: Vec<String> = std::env::args().collect();
    args.iter().position(|a| a == name).map(|i| args[i + 1].clone()).unwrap_or(default.into())
}

fn main() {
    let side: i16 = arg("--side", "20").parse().unwrap();
    let (from, to): (u64, u64) = (arg("--from", "1").parse().unwrap(), arg("--to", "1").parse().unwrap());
    let crash: f64 = arg("--crash", "0").parse().unwrap();
    let share: f64 = arg("--share", "0.74").parse().unwrap();
    let verbose = arg("--verbose", "0") == "1";
    let start =
        Shape::Box { min: Cell::new(0, 0, 0), max: Cell::new(side - 1, side - 1, 0) }.cells().unwrap();
    let c = side / 2;
    let growth = if arg("--growth", "scaffold") == "solid" { Growth::Solid } else { Growth::Scaffold };
    let zf: i16 = arg("--zf", "1").parse().unwrap();
    let mut best = None;
    for r in 1..40u16 {
        let cells = Shape::Sphere { center: Cell::new(c, c, r as i16 * zf), radius: Radius::cells(r) }
            .cells()
            .unwrap();
        let goal = Goal::compile(&cells, Cell::new(c, c, 0), growth).unwrap();
        if goal.len() as f64 > share * start.len() as f64 {
            break;
        }
        best = Some(goal);
    }
    let goal = best.unwrap();
    let delay = Span::millis(50);
    for seed in from..=to {
        let mut params = Params::scaled(Span::secs(1), Span::millis(200), 4 * (side as u16 * 2 + 30));
        params.connectivity = match arg("--connectivity", "forest").as_str() {
            "forest" => Connectivity::Forest,
            "cycles" => Connectivity::Cycles,
            _ => Connectivity::Gradient,
        };
        params.recruit_per_move = Span::millis(arg("--recruit", "1000").parse().unwrap());
        let setup = Arc::new(Setup { params, goals: vec![goal.clone()] });
        let link = LinkModel {
            delay_min: delay,
            delay_max: delay * 4,
            loss: arg("--loss", "0").parse().unwrap(),
            ..LinkModel::default()
        };
        let mut s = Stream::named(seed, "crashes", 0);
        let n = start.len();
        let mut victims = std::collections::BTreeSet::new();
        while victims.len() < (n as f64 * crash) as usize {
            victims.insert(s.below(n as u64) as u32);
        }
        let faults =
            victims.iter().map(|v| (Time(s.below(60_000_000_000)), Fault::Kill(ModuleId(*v)))).collect();
        let world = CubeWorld::new(&start, Span::secs(1), seed);
        let stop =
            Stop { timeout: Time(20_000_000_000_000), stall: Span::secs(400), livelock: Span::secs(1600) };
        let director = Director::new(setup.clone(), n, Schedule::new(faults), stop, Default::default());
        let config = SimConfig {
            setup,
            link,
            seed,
            audit_every: Span::secs(20),
            ignore_sessions: arg("--ignore-sessions", "0") == "1",
        };
        let t = std::time::Instant::now();
        let mut sim = Sim::new(config, world, director);
        let mut at = 0;
        while !sim.run_until(Time(at * 1_000_000_000)) {
            at += 5;
            if arg("--loops", "0") == "1" {
                let (v, _) = sim.violations();
                if let Some(x) = v.iter().find(|x| x.what.contains("without an end")) {
                    let id: u32 = x.what[7..].split(':').next().unwrap().parse().unwrap();
                    for f in Face::ALL {
                        let mut at = (ModuleId(id), f);
                        for _ in 0..7 {
                            let ags = sim.agents();
                            let Some(a) = ags.get(at.0) else { break };
                            let (e, s, _) = a.attraction(at.1);
                            print!(
                                "[{} {:?} {:?} {:?} d{} s{} v{} {s:?}] ",
                                at.0,
                                at.1,
                                a.cell(),
                                a.role(),
                                e.distance,
                                e.source,
                                e.version
                            );
                            use metamorph_protocol::cube::Successor::*;
                            let nb =
                                |id: ModuleId, f: Face| sim.world().body_at(sim.world().cell(id).step(f));
                            at = match s {
                                Some(Own(o)) => (at.0, o),
                                Some(Beside { heading, same_cell }) => {
                                    let Some(b) = nb(at.0, heading) else { break };
                                    if same_cell {
                                        let Some(c) = nb(b, at.1) else { break };
                                        (c, heading.opposite())
                                    } else {
                                        (b, at.1)
                                    }
                                }
                                None => break,
                            };
                        }
                        println!();
                    }
                }
                if !v.is_empty() {
                    break;
                }
            }
            if verbose {
                let mut m = std::collections::BTreeMap::new();
                let (mut targets, mut known, mut open) = (0, 0, 0);
                for (_, a) in sim.agents().iter() {
                    *m.entry((a.role() as u8, a.activity(sim.now()))).or_insert(0) += 1;
                    for f in Face::ALL {
                        let (e, ..) = a.attraction(f);
                        if a.session(f).is_none() {
                            open += 1;
                            if e.is_known() {
                                known += 1;
                                if e.distance == 0 {
                                    targets += 1;
                                }
                            }
                        }
                    }
                }
                println!("t {} targets {targets} known {known}/{open} {m:?}", sim.now());
                println!("{:?}", sim.director().progress());
            }
        }
        let d = sim.director();
        let (v, broken) = sim.violations();
        let total = sim.tally().total();
        println!(
            "seed {seed} n {n} goal {} {:?} known {:?} moves {:?} msgs/n {} wall {:?} broken {broken} events {} trace {:016x} {}",
            goal.len(),
            d.outcome(),
            d.stages()[0].known,
            sim.world().motions(),
            total.sent / n as u64,
            t.elapsed(),
            sim.trace().events(),
            sim.trace().value(),
            d.stall()
                .map(|s| format!(
                    "{:?} unfilled {} cycle {:?} waiting {:?}",
                    s.reason,
                    s.unfilled.len(),
                    s.wait_cycle,
                    s.waiting
                ))
                .unwrap_or_default()
        );
        if arg("--why", "0") == "1" {
            let ags = sim.agents();
            let mut m = std::collections::BTreeMap::new();
            for (id, a) in ags.iter() {
                *m.entry((a.role() as u8, a.activity(sim.now()))).or_insert(0) += 1;
                if a.role() == metamorph_protocol::cube::message::Role::Final {
                    let k = sim.director().known()[id.index()].status.unwrap();
                    println!(
                        "final {id} {} wants {:06b} {}",
                        a.cell(),
                        k.wants,
                        Face::ALL
                            .iter()
                            .filter(|f| k.wants & f.bit() != 0)
                            .map(|f| format!(
                                "{f:?}: {:?} occ {:?} alive {:?} d{} locks {:?}",
                                a.cell().step(*f),
                                sim.world().body_at(a.cell().step(*f)),
                                sim.world().body_at(a.cell().step(*f)).map(|b| ags.get(b).is_some()),
                                a.attraction(*f).0.distance,
                                a.reservations()
                            ))
                            .collect::<Vec<_>>()
                            .join("; ")
                    );
                }
            }
            for y in 0..side {
                let mut row = String::new();
                for x in 0..side {
                    row.push(match sim.world().body_at(Cell::new(x, y, 0)).map(|b| (b, ags.get(b))) {
                        None => '.',
                        Some((_, None)) => 'X',
                        Some((b, Some(a))) => match a.role() as u8 {
                            0 => match a.activity(sim.now()) {
                                "asking" => 'a',
                                "backing off" => 'b',
                                "holding" => 'h',
                                "waiting" => 'w',
                                _ => {
                                    if d.known()[b.index()].status.is_some_and(|s| s.attracted) {
                                        'R'
                                    } else {
                                        'r'
                                    }
                                }
                            },
                            1 => 'W',
                            _ => 'F',
                        },
                    });
                }
                println!("{row}");
            }
            println!("{m:?}");
            if let Some(s) = d.stall() {
                for (id, _) in s.waiting.iter().take(6) {
                    if let Some(a) = ags.get(*id) {
                        println!(
                            "way {id} {:?} {} {} known {:?}",
                            a.role(),
                            a.cell(),
                            a.activity(sim.now()),
                            d.known()[id.index()]
                        );
                    }
                }
            }
        }
        for x in v.iter().take(5) {
            println!("   {x}");
        }
        if verbose {
            for (c, k) in sim.tally().iter() {
                println!("   {c} {k:?}");
            }
        }
    }
}
