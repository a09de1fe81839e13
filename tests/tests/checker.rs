//! Positions of bodies, by the independent checker of journals: in shipped scenarios on both links, in drawn
//! ones, and in journals with impossible events.
#![allow(clippy::print_stdout, reason = "results are shown with --nocapture")]
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_module_agent::journal_file::{Head, Reader, RunHead, Writer};
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::{Incarnation, ModuleId, Revision};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::record::{Blob, Event, Record, Sink, Who};
use metamorph_protocol::time::Time;
use metamorph_tests::checked_run::{geometry, record, run_and_check};
use metamorph_tests::checker::{Checked, Geometry, Rule, check};
use metamorph_tests::command::{run_processes, scenario};
use metamorph_world_controller::experiments::explore::draw::draw;
use metamorph_world_controller::family::Family;
use metamorph_world_controller::family::cube::CubeFamily;
use metamorph_world_controller::family::metamodule::MetamoduleFamily;
use metamorph_world_controller::family::metamodule::Metamodules;
use metamorph_world_controller::family::read_file;
use metamorph_world_controller::scenario::{LinkKind, Overrides, Plan};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const CUBE: &dyn Family = &CubeFamily;
const METAMODULE: &dyn Family = &MetamoduleFamily;

/// Checks a run of a shipped scenario on one link.
fn is_sound(name: &str, link: &str, options: &[&str]) -> Checked {
    let dir = tempfile::tempdir().unwrap();
    let (path, file) = (scenario(name).display().to_string(), dir.path().join("journal"));
    let journal = file.display().to_string();
    let fixed = ["run", path.as_str(), "--link", link, "--quiet", "--journal", journal.as_str()];
    let ran = run_processes(&[&fixed, options].concat());
    assert!(matches!(ran.code, Some(0 | 3)), "{ran:?}");
    let plan = read_file(&scenario(name), &Overrides::default()).unwrap();
    let checked = check(&file, geometry(&plan).as_ref()).unwrap_or_else(|breach| panic!("{breach}"));
    println!("{name} on {link}: {checked:?}");
    assert!(checked.done > 10 && checked.done + checked.failed <= checked.begun, "{checked:?}");
    checked
}

#[test]
fn simulated_shipped_scenarios_pass_the_checker() {
    for name in ["arch.toml", "swarm.toml", "swarm-200.toml", "chair.toml"] {
        is_sound(name, "sim", &[]);
    }
    // Moves and connections fail there.
    let (faults, chair) = (is_sound("faults.toml", "sim", &[]), is_sound("chair-hardware.toml", "sim", &[]));
    assert!(faults.failed > 0 && chair.failed > 0);
}

#[test]
fn shipped_scenarios_pass_the_checker_as_processes() {
    is_sound("swarm.toml", "ipc", &["--time-scale", "20", "--restart", "9@4s"]);
    is_sound("box.toml", "ipc", &["--time-scale", "50"]);
    is_sound("chair-hardware.toml", "ipc", &["--time-scale", "50"]);
}

/// Checks every tenth scenario of an exploration, up to these numbers of each family.
fn explored(cubes: u64, metamodules: u64) {
    let mut sum = Checked::default();
    for (family, runs) in [(CUBE, cubes), (METAMODULE, metamodules)] {
        for seed in (0..runs).map(|run| 10 * run + 1) {
            let (_, plan) = draw(seed, Some(family));
            let checked = run_and_check(&plan).unwrap_or_else(|breach| {
                let family = family.name();
                panic!("{breach}\n  metamorph explore --runs 1 --seed {seed} --family {family}")
            });
            sum.bodies += checked.bodies;
            sum.begun += checked.begun;
            sum.done += checked.done;
            sum.failed += checked.failed;
        }
        println!("{runs} runs of {}: {sum:?} so far", family.name());
    }
    assert!(sum.done > 10 * (cubes + metamodules) / 2);
}

#[test]
fn drawn_scenarios_pass_the_checker() {
    explored(60, 20);
}

/// `CHECKED=1000 cargo test --release -p metamorph-tests checker:: -- --ignored --nocapture`; a third of
/// the runs are of metamodules.
#[test]
#[ignore = "minutes: 1,000 runs, or as many as CHECKED says"]
fn many_drawn_scenarios_pass_the_checker() {
    let runs = std::env::var("CHECKED").map_or(1_000, |text| text.parse().expect("CHECKED is a number"));
    explored(runs - runs / 3, runs / 3);
}

/// Runs of cubes with a defect, in which an invariant finds the body torn: the checker finds it, too.
#[test]
fn the_checker_finds_violations_of_invariants() {
    let dir = tempfile::tempdir().unwrap();
    let journal = dir.path().join("journal");
    let mut found = 0;
    for seed in 1..=400 {
        let (draft, _) = draw(seed, Some(CUBE));
        let defect = [Defect::IgnoreLocks, Defect::NoDeadline, Defect::ShortLease][seed as usize % 3];
        let Ok(plan) = draft.plan("drawn.toml", Some(defect)) else { continue };
        let report = record(&plan, &journal);
        let positions = |name: &str| ["body-connected", "mover-supported"].contains(&name);
        let Some(first) = report.invariants.violated.iter().find(|v| positions(&v.invariant)) else {
            continue;
        };
        let Err(breach) = check(&journal, None) else { panic!("seed {seed}: {} was not found", first.what) };
        assert!(
            matches!(breach.rule, Rule::Connected | Rule::Supported | Rule::SupportStays),
            "seed {seed}: {breach}, but the world found {}",
            first.what
        );
        found += 1;
        if found == 5 {
            return;
        }
    }
    panic!("only {found} runs were unsafe");
}

/// A valid journal without the records of agents, to be changed and written again with valid checksums.
struct Journal {
    dir: TempDir,
    plan: Plan,
    geometry: Option<Geometry>,
    head: RunHead,
    records: Vec<Record>,
}

impl Journal {
    fn of(name: &str) -> Journal {
        let dir = tempfile::tempdir().unwrap();
        let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
        let plan = read_file(&scenario(name), &overrides).unwrap();
        let path = dir.path().join("journal");
        record(&plan, &path);
        let mut reader = Reader::open(&path).unwrap();
        let records = reader.by_ref().map(Result::unwrap).filter(|r| r.who == Who::Controller).collect();
        let Head::Run(head) = reader.head().clone() else { panic!("the head of a run") };
        let geometry = geometry(&plan);
        let journal = Journal { dir, plan, geometry, head, records };
        assert_eq!(journal.rule(&journal.records), None, "an unchanged journal is sound");
        journal
    }

    fn path(&self) -> PathBuf {
        self.dir.path().join("changed")
    }

    /// Returns the rule that these records break.
    fn rule(&self, records: &[Record]) -> Option<Rule> {
        write(&self.path(), &self.head, records);
        check(&self.path(), self.geometry.as_ref()).err().map(|breach| breach.rule)
    }

    /// Asserts that the journal breaks a rule if one of its events is changed, at one place at least.
    fn breaks(&self, rule: Rule, edit: impl Fn(&mut Event) -> bool) {
        let mut records = self.records.clone();
        for i in 0..records.len() {
            let before = records[i].event.clone();
            if edit(&mut records[i].event) && self.rule(&records) == Some(rule) {
                return;
            }
            records[i].event = before;
        }
        panic!("{rule:?} is never broken");
    }

    /// Asserts the same for a change of an action.
    fn action_breaks(&self, rule: Rule, edit: impl Fn(&mut Blob)) {
        self.breaks(rule, |event| match event {
            Event::Act { action, begun: true, .. } => {
                edit(action);
                true
            }
            _ => false,
        });
    }

    /// Places the first body in another one.
    fn meets(&self) {
        let place_of = |r: &Record| match &r.event {
            Event::Start { id: ModuleId(1), place, .. } => Some(place.clone()),
            _ => None,
        };
        let other = self.records.iter().find_map(place_of).unwrap();
        self.breaks(Rule::OneBodyPerCell, |event| match event {
            Event::Start { id: ModuleId(0), place, .. } => {
                place.clone_from(&other);
                true
            }
            _ => false,
        });
    }

    /// Makes an action end twice, end elsewhere, or begin before the last one has ended.
    fn does_not_follow(&self) {
        self.breaks(Rule::Follows, |event| match event {
            Event::Advance { ended } if !ended.is_empty() => {
                ended.push(ended[0].clone());
                true
            }
            _ => false,
        });
        self.breaks(Rule::Follows, |event| match event {
            Event::Advance { ended } if !ended.is_empty() => {
                ended[0].1.bytes[0] ^= 1;
                true
            }
            _ => false,
        });
        self.breaks(Rule::Follows, |event| match event {
            Event::Advance { ended } => !std::mem::take(ended).is_empty(),
            _ => false,
        });
    }
}

fn write(path: &Path, head: &RunHead, records: &[Record]) {
    let mut writer = Writer::create(path, &Head::Run(head.clone())).unwrap();
    records.iter().for_each(|record| writer.put(record));
}

fn event(event: Event) -> Record {
    Record { at: Time(1), who: Who::Controller, event }
}

fn start(id: u32, place: Blob) -> Record {
    event(Event::Start { id: ModuleId(id), incarnation: Incarnation(0), place })
}

fn begin(id: u32, action: Blob) -> Record {
    event(Event::Act { id: ModuleId(id), revision: Revision(0), action, begun: true })
}

#[test]
fn impossible_events_of_cubes_are_found() {
    let journal = Journal::of("swarm.toml");
    journal.meets();
    journal.does_not_follow();
    // The bytes of an action are its kind, its support and its heading.
    journal.action_breaks(Rule::Supported, |action| action.bytes[1] ^= 1);
    journal.action_breaks(Rule::Possible, |action| action.bytes[1] = action.bytes[2]);
    journal.action_breaks(Rule::OneBodyPerCell, |action| (action.bytes[1], action.bytes[2]) = (0, 5));
    journal.breaks(Rule::Connected, |event| match event {
        Event::Start { id: ModuleId(0), place, .. } => {
            place.bytes[1] += 1;
            true
        }
        _ => false,
    });
}

/// Five cubes, of which two stand on a line of three: one moves over the line, and then another event happens
/// that would be valid without the move.
#[test]
fn no_cube_disturbs_a_moving_one() {
    let mut journal = Journal::of("swarm.toml");
    journal.head.modules = 5;
    let cells = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 1], [2, 0, 1]].map(Cell::from);
    let starts = (0..).zip(&cells).map(|(id, cell)| start(id, Blob::of(cell)));
    let action = |bytes: [u8; 3]| Blob { kind: 0, bytes: [&bytes[..], &[0; 8]].concat() };
    let (east, west, around) = (action([0, 5, 0]), action([0, 5, 1]), action([1, 0, 2]));
    let moves = begin(3, east);
    let with = |more: Record| [starts.clone().collect(), vec![moves.clone(), more]].concat();
    assert_eq!(journal.rule(&with(event(Event::Wake))), None);
    assert_eq!(journal.rule(&with(begin(4, west))), Some(Rule::Reserved));
    assert_eq!(journal.rule(&with(begin(1, around))), Some(Rule::SupportStays));
}

#[test]
fn impossible_events_of_metamodules_are_found() {
    let journal = Journal::of("box.toml");
    journal.meets();
    journal.does_not_follow();
    // The last bytes of a turn are the number of the step.
    let number = |action: &mut Blob, to: u16| {
        let last = action.bytes.len() - 2;
        action.bytes[last..].copy_from_slice(&to.to_le_bytes());
    };
    journal.action_breaks(Rule::Possible, |action| number(action, u16::MAX));
    journal.action_breaks(Rule::Follows, |action| number(action, 0));
    journal.action_breaks(Rule::Attached, |action| action.kind = 17);
    journal.action_breaks(Rule::Attached, |action| action.kind = 18);
    journal.breaks(Rule::Attached, |event| match event {
        Event::Start { place, .. } => {
            place.bytes[1] = 1;
            true
        }
        _ => false,
    });
    let there = |effect: &str| Event::Injected {
        fault: "block [0, 0, 0]".into(),
        module: None,
        cell: Some(Cell::new(0, 0, 0)),
        by: "scenario".into(),
        effect: format!("[0, 0, 0]: {effect}"),
    };
    let with = |effect| [journal.records.clone(), vec![event(there(effect))]].concat();
    assert_eq!(journal.rule(&with("the obstacle is gone")), None);
    // The body that is in the cell last is met.
    let cells = (0..13).flat_map(|x| (0..13).map(move |y| (x, y)));
    let met = cells.filter(|(x, y)| {
        let fault = format!("block [{x}, {y}, 0]");
        let (by, effect) = ("scenario".into(), "the cell was free".into());
        let obstacle = Event::Injected { fault, module: None, cell: None, by, effect };
        let records = [journal.records.clone(), vec![event(obstacle)]].concat();
        journal.rule(&records) == Some(Rule::OneBodyPerCell)
    });
    assert_eq!(met.count(), 4, "the feet of a box");
}

/// Two upright metamodules whose steps meet in a cell in which neither is.
#[test]
fn no_metamodule_disturbs_a_moving_one() {
    let mut journal = Journal::of("box.toml");
    journal.head.modules = 2;
    let swarm = journal.plan.swarm.of::<Metamodules>().expect("metamodules");
    let table = swarm.setup.motions.table();
    let pose = swarm.poses[0];
    let steps = (0..).zip(table.steps()).filter(|(_, s)| [s.from, s.to].contains(&pose.posture));
    let turn = |n: u16| Blob { kind: 16, bytes: [&[0; 8][..], &n.to_le_bytes()].concat() };
    let turns: Vec<Blob> = steps.map(|(n, _)| turn(n)).collect();
    let mut met = Vec::new();
    for (dx, dy) in [(1, 0), (2, 0), (3, 0), (0, 2), (2, 1), (2, 2)] {
        let starts = [(6, 6), (6 + dx, 6 + dy)].map(|(x, y)| {
            let mut pose = pose;
            (pose.state.x, pose.state.y) = (x, y);
            pose
        });
        let starts = [start(0, Blob::of(&starts[0])), start(1, Blob::of(&starts[1]))].to_vec();
        for first in &turns {
            let alone = [starts.clone(), vec![begin(0, first.clone())]].concat();
            let rule = journal.rule(&alone);
            met.extend(rule);
            if rule.is_none() {
                let both = |second: &Blob| [alone.clone(), vec![begin(1, second.clone())]].concat();
                met.extend(turns.iter().filter_map(|second| journal.rule(&both(second))));
            }
        }
    }
    for rule in [Rule::OneBodyPerCell, Rule::Reserved] {
        assert!(met.contains(&rule), "{rule:?} is never broken");
    }
}

/// A modified file is not a journal for the checker either.
#[test]
fn damaged_files_are_not_checked() {
    let journal = Journal::of("swarm.toml");
    journal.rule(&journal.records);
    let bytes = std::fs::read(journal.path()).unwrap();
    let refused = |damaged: &[u8]| {
        std::fs::write(journal.path(), damaged).unwrap();
        check(&journal.path(), None).is_err_and(|breach| breach.rule == Rule::Readable)
    };
    for at in [0, 8, 20, bytes.len() / 2, bytes.len() - 1] {
        let mut changed = bytes.clone();
        changed[at] ^= 1;
        assert!(refused(&changed), "byte {at} is changed");
        // What ends with a whole record can be read, and it depends on the length of paths where one ends.
        assert!(refused(&bytes[..at]) || refused(&bytes[..at - 1]), "cut after {at} bytes");
    }
}
