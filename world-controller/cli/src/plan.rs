//! `metamorph plan`: plans the reconfiguration of free modules, exactly; checks plans, compares and counts structures.
//!
//! `ground` reads how a structure stands. Files, planners and checks are in `metamorph_free_modules::plan`.

mod ground;

use crate::{assemblies, runs};
use clap::{Args, ValueEnum};
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Json, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::{Channel, Live, print_error};
use metamorph_free_modules::plan::document::{Answer, PlanFile, Verdict};
use metamorph_free_modules::plan::input::{Structured, structured};
use metamorph_free_modules::plan::solve::{Ended, Planner, Problem};
use metamorph_free_modules::plan::{PlanError, check, compare};
use metamorph_processes::family::sources;
use metamorph_protocol::assembly::action::{Connectors, Rules};
use metamorph_protocol::assembly::collision::Model;
use metamorph_protocol::assembly::configuration::Configuration;
use metamorph_protocol::assembly::named;
use metamorph_protocol::assembly::space::Objective;
use metamorph_protocol::plan::{Limits, Progress};
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::Span;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::command_error::Failure;
use metamorph_text::format::{bytes, count, many};
use std::path::PathBuf;
use std::time::Duration;

/// The end of the command's help.
const EXAMPLES: &str = "\
Examples:
  metamorph plan --from line:4 --to loop:3x3             an optimal plan, proved
  metamorph plan --from line:4 --to loop:3x3 --types 123 --collision final -o plan.json
  metamorph plan --check plan.json                       carry it out, independently of the planner
  metamorph plan --check plan.json --view                and show it in the browser, step by step
  metamorph plan --from zigzag:4 --to line:4 --seed 1 --planner ara --timeout 60s
  metamorph plan --from line:4 --to loop:3x3 --collision core --floor --gravity --up x     a tower
  metamorph plan --distance line:4 ell:4
  metamorph plan --recognise structure.json
  metamorph plan --count line:4
  metamorph plan table                                   metamodules and elements: bundles, hand-overs, torque
  metamorph plan table --planner thesis                  in the order of thesis B.5, which is not changed

Plans free Roombots modules, at most 16: attachments, detachments and steps of joints. A goal given as a shape
leaves joint values free. Structure files are described by `metamorph schema structure`, plans by
`metamorph schema plan`.

A scenario of metamodules with elements is planned by taking its goal apart: the order of its bundles, and how each is
placed from the start of the scenario.

Exit codes:
  0  a plan was found, or the question is answered
  1  the program itself failed, for example because a file could not be written
  2  the command line or a file is wrong; the error names its place, reason and fix
  3  no plan exists: all configurations that can be reached were examined
  4  memory, work or time ended before a plan was found; the answer has the proven bound
  7  stopped by Ctrl-C, SIGTERM or SIGHUP; the answer has the best plan so far and the bound
  8  a plan does not check";

/// The options that a scenario has no use for.
const NOT_OF_SCENARIOS: [&str; 21] = [
    "from",
    "to",
    "types",
    "joints",
    "objective",
    "collision",
    "connectors",
    "floor",
    "gravity",
    "hold",
    "up",
    "weight",
    "memory",
    "timeout",
    "work",
    "check",
    "distance",
    "recognise",
    "count",
    "out",
    "view",
];

/// The options of searches, which answer no other question.
const OF_SEARCHES: [&str; 12] = [
    "types",
    "joints",
    "seed",
    "objective",
    "collision",
    "connectors",
    "planner",
    "weight",
    "memory",
    "timeout",
    "work",
    "out",
];

/// Arguments of `plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// A scenario of metamodules with elements: a TOML file, or a name that `metamorph scenarios` lists; default: none
    #[arg(value_name = "SCENARIO", conflicts_with_all = NOT_OF_SCENARIOS)]
    pub scenario: Option<PathBuf>,
    /// Of a scenario: set a value in it, as for `run` (repeatable)
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    pub set: Vec<String>,
    /// The start: line:N, loop:WxH, ell:N, zigzag:N, quadruped:4|6, tree:NxSEED, or a structure file; default: none
    #[arg(long, value_name = "SHAPE", required_unless_present_any = ["scenario", "check", "distance", "recognise", "count"], requires = "to")]
    pub from: Option<String>,
    /// The goal: a shape, with joint values left free, or a file with joint values; default: none
    #[arg(long, value_name = "SHAPE", requires = "from")]
    pub to: Option<String>,
    /// Of a line: the quarter turns of its connections, one digit 0..3 each; default: all 0
    #[arg(long, value_name = "DIGITS", conflicts_with = "seed")]
    pub types: Option<String>,
    /// A structure file with the joint values of the start; default: all 0
    #[arg(long, value_name = "FILE", conflicts_with_all = ["types", "seed"])]
    pub joints: Option<PathBuf>,
    /// Draw the joint values of the start from this seed; default: all 0. Of a scenario: its seed
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    pub seed: Option<u64>,
    /// What the cost counts
    #[arg(long, value_enum, default_value_t = ObjectiveArg::Actions)]
    pub objective: ObjectiveArg,
    /// What a turn may touch: only the final cells must be free (final), no cell is entered deeper than 11 mm (core), no
    /// bodies touch (strict)
    #[arg(long, value_enum, default_value_t = CollisionArg::Strict)]
    pub collision: CollisionArg,
    /// Which connectors can connect: all, or one of the two must be C0X or C3X (active)
    #[arg(long, value_enum, default_value_t = ConnectorsArg::All)]
    pub connectors: ConnectorsArg,
    /// The floor is solid: nothing goes below the lowest cell of the start, nor deeper into the floor on the way than
    /// --collision permits (final: any depth, core: 11 mm, strict: 2.2 mm)
    #[arg(long, requires = "from")]
    pub floor: bool,
    /// Joints bear the weight: at most 4.9 Nm (outer) and 3.6 Nm (middle), at rest and during turns
    #[arg(long, requires = "from")]
    pub gravity: bool,
    /// With --floor or --gravity: the module whose foot is held by the ground, or with `:head` its other end; the side of
    /// a joint without it moves; default: 0
    #[arg(long, value_name = "MODULE[:head]", requires = "from")]
    pub hold: Option<String>,
    /// With --floor or --gravity: the direction of the start that is up
    #[arg(long, value_enum, default_value_t = Up::Z, allow_hyphen_values = true)]
    pub up: Up,
    /// The planner
    #[arg(long, value_enum, default_value_t = Planner::Auto)]
    pub planner: Planner,
    /// Accept a plan that costs at most W times the least, with portfolio or astar; default: 1
    #[arg(long, value_name = "W", allow_hyphen_values = true)]
    pub weight: Option<String>,
    /// Memory for states, at least 16MiB
    #[arg(long, value_name = "SIZE", default_value = "2GiB", allow_hyphen_values = true)]
    pub memory: String,
    /// Stop after this real time, such as 60s; default: none
    #[arg(long, value_name = "T", allow_hyphen_values = true)]
    pub timeout: Option<String>,
    /// Stop after N expanded states; default: none
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    pub work: Option<u64>,
    /// Check a plan file: carry it out, and name the first action that is not possible
    #[arg(long, value_name = "FILE", conflicts_with_all = ["from", "distance", "recognise", "count", "json"], conflicts_with_all = OF_SEARCHES)]
    pub check: Option<PathBuf>,
    /// Compare two structures; default: none
    #[arg(long, value_names = ["A", "B"], num_args = 2, conflicts_with_all = ["from", "recognise", "count"], conflicts_with_all = OF_SEARCHES)]
    pub distance: Option<Vec<String>>,
    /// Name a shape, its symmetries, and the metamodules in it; default: none
    #[arg(long, value_name = "SHAPE", conflicts_with_all = ["from", "count"], conflicts_with_all = OF_SEARCHES)]
    pub recognise: Option<String>,
    /// Count shapes and configurations by their distance from this one; default: none
    #[arg(long, value_name = "SHAPE", conflicts_with_all = ["from", "objective", "planner", "weight", "out"])]
    pub count: Option<String>,
    /// Write the plan to this file
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write the answer as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// Show the plan in the browser step by step, until Ctrl-C; the address is printed
    #[arg(long, conflicts_with_all = ["distance", "recognise", "count"])]
    pub view: bool,
    /// With --view: the port of the page's address, for example one that is forwarded; default: any free one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..), requires = "view")]
    pub port: Option<u16>,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

/// A direction, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Up {
    /// +x
    X,
    /// -x
    #[value(name = "-x")]
    NegativeX,
    /// +y
    Y,
    /// -y
    #[value(name = "-y")]
    NegativeY,
    /// +z
    Z,
    /// -z
    #[value(name = "-z")]
    NegativeZ,
}

/// An objective, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ObjectiveArg {
    /// Attachments, detachments and steps of joints
    Actions,
    /// Attachments and detachments
    Connections,
    /// Steps of joints
    Turns,
    /// Attachments
    Moves,
}

/// A collision model, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CollisionArg {
    /// The final cells must be free
    Final,
    /// And no cell is entered deeper than 11 mm
    Core,
    /// And no two bodies touch
    Strict,
}

/// Which connectors connect, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ConnectorsArg {
    /// All
    All,
    /// One of the two is C0X or C3X
    Active,
}

/// Exit code: no plan exists.
pub const IMPOSSIBLE: u8 = 3;
/// Exit code: a limit was reached before a plan was found.
pub const UNDECIDED: u8 = 4;
/// Exit code: a plan does not check.
const DIFFERENT: u8 = 8;

/// Answers the request, and returns the exit code and the plan, if there is one that checks.
pub fn plan(args: &PlanArgs, interrupt: &Interrupt) -> Result<(u8, Option<PlanFile>), Failure> {
    if !args.set.is_empty() {
        let fix = "name a SCENARIO, or leave --set out";
        return Err(PlanError::option("--set", "free modules have no scenario", fix).into());
    }
    let mut outputs = Outputs::new();
    for file in [&args.joints, &args.check].into_iter().flatten() {
        outputs.reads("the file", file);
    }
    for shape in [&args.from, &args.to, &args.recognise, &args.count].into_iter().flatten() {
        outputs.reads("the structure", shape.as_ref());
    }
    let json = Json::of(args.json.as_deref(), &mut outputs)?;
    let channel = Channel::beside(json.is_out(), args.quiet);
    if let Some(file) = &args.check {
        return match check::check_file(sources(), file) {
            Ok(plan) => {
                let lower = if plan.lower == plan.cost { ", the least".to_owned() } else { String::new() };
                channel.say(&format!(
                    "valid: {}, cost {}{lower}",
                    many(plan.actions.len() as u64, "action"),
                    plan.cost
                ));
                Ok((0, Some(plan)))
            }
            Err(error @ PlanError::Check { .. }) => {
                print_error(&error.to_string());
                Ok((DIFFERENT, None))
            }
            Err(error) => Err(error.into()),
        };
    }
    if let Some([a, b]) = args.distance.as_deref().map(|d| [&d[0], &d[1]]) {
        let found = compare::distance(
            &structured(sources(), "--distance", a)?,
            &structured(sources(), "--distance", b)?,
            [a, b],
        )?;
        json.write(&found)?;
        channel.say(&compare::distance_text(&found));
        return Ok((0, None));
    }
    if let Some(shape) = &args.recognise {
        let found = compare::recognised(&structured(sources(), "--recognise", shape)?);
        json.write(&found)?;
        channel.say(&compare::recognised_text(&found));
        return Ok((0, None));
    }
    if let Some(shape) = &args.count {
        return Ok((counted(args, shape, &json, channel, interrupt)?, None));
    }
    if matches!(args.planner, Planner::Levels | Planner::Thesis) {
        let fix = "name a scenario, or leave --planner out";
        return Err(PlanError::option("--planner", "this planner is for scenarios with elements", fix).into());
    }
    let problem = problem(args)?;
    let file = args.out.as_ref().map(|file| outputs.writes("-o", file, OutputKind::Json)).transpose()?;
    interrupt.begin();
    let answer = solve(&problem, args.timeout.as_deref().map(timeout).transpose()?, interrupt, !args.quiet);
    // A plan is only as good as its check, which shares nothing with the search.
    if let Some(plan) = &answer.plan
        && let Err(error) = check::check("this plan (an error of the planner)", plan)
    {
        print_error(&error.to_string());
        return Ok((DIFFERENT, None));
    }
    if let (Some(file), Some(plan)) = (&file, &answer.plan) {
        file.write(metamorph_text::escape::json(plan) + "\n")?;
    }
    json.write(&answer)?;
    channel.say(&text(&answer));
    Ok((exit_code(&answer), answer.plan))
}

/// Solves a problem, with a progress line, until the time is over or Ctrl-C ends it.
fn solve(problem: &Problem, timeout: Option<Duration>, interrupt: &Interrupt, shown: bool) -> Answer {
    let (since, mut live) = (Stopwatch::start(), Live::new(shown));
    let answer = problem.solve(&mut |progress| {
        if interrupt.is_set() {
            return Some(Ended::Interrupt);
        }
        if timeout.is_some_and(|limit| since.elapsed() >= limit) {
            return Some(Ended::Time);
        }
        live.show(|| line(&progress(), since));
        None
    });
    live.clear();
    answer
}

fn line(progress: &Progress, since: Stopwatch) -> String {
    let best = progress.upper.map_or_else(|| "none".to_owned(), |u| u.to_string());
    format!(
        "at least {}  best so far {best}  {} expanded  {} kept  {}  {:.0} s",
        progress.lower,
        count(progress.expanded),
        count(progress.kept),
        bytes(progress.bytes),
        since.elapsed().as_secs_f64()
    )
}

fn exit_code(answer: &Answer) -> u8 {
    match (answer.verdict, answer.ended_by.as_deref()) {
        (_, Some("interrupt")) => Outcome::Aborted.exit_code(),
        (Verdict::Optimal | Verdict::Bounded, _) => 0,
        (Verdict::Impossible, _) => IMPOSSIBLE,
        (Verdict::Undecided, _) => UNDECIDED,
    }
}

/// Modules from which counting takes minutes.
const LONG_COUNT: usize = 4;

fn counted(
    args: &PlanArgs,
    shape: &str,
    json: &Json,
    channel: Channel,
    interrupt: &Interrupt,
) -> Result<u8, Failure> {
    let start = start(args, "--count", shape)?;
    interrupt.begin();
    let timeout = args.timeout.as_deref().map(timeout).transpose()?;
    let since = Stopwatch::start();
    if start.len() >= LONG_COUNT && !args.quiet {
        let modules = many(start.len() as u64, "module");
        print_error(&format!(
            "counting what {modules} can become takes minutes; Ctrl-C prints what is counted until then"
        ));
    }
    let mut live = Live::new(!args.quiet);
    let mut is_over = |counted: u64, what: &str| {
        live.show(|| format!("{} {what}", count(counted)));
        interrupt.is_set() || timeout.is_some_and(|limit| since.elapsed() >= limit)
    };
    let found = compare::counted(&start, &rules(args), limits(args)?, &mut is_over);
    live.clear();
    json.write(&found)?;
    channel.say(&compare::counted_text(&found));
    Ok(if interrupt.is_set() { Outcome::Aborted.exit_code() } else { 0 })
}

/// Returns the problem that the options describe.
fn problem(args: &PlanArgs) -> Result<Problem, PlanError> {
    let (from, to) = (args.from.as_deref().unwrap_or_default(), args.to.as_deref().unwrap_or_default());
    let start = start(args, "--from", from)?;
    let goal = structured(sources(), "--to", to)?;
    let (n, m) = (start.len(), goal.shape().len());
    if n != m {
        let reason = format!("the start has {}, the goal {m}", many(n as u64, "module"));
        return Err(PlanError::option("--to", reason, "name a goal of as many modules as the start"));
    }
    let objective = match args.objective {
        ObjectiveArg::Actions => Objective::Actions,
        ObjectiveArg::Connections => Objective::Connections,
        ObjectiveArg::Turns => Objective::Turns,
        ObjectiveArg::Moves => Objective::Moves,
    };
    let standing = ground::standing(args, &start)?;
    let (start, rules) = match &standing {
        Some((start, _, ground)) => (*start, rules(args).on(*ground)),
        None => (start, rules(args)),
    };
    let problem = Problem {
        start,
        goal,
        rules,
        ground: standing.map(|(_, entry, _)| entry),
        objective,
        planner: args.planner,
        weight: weight(args)?,
        limits: limits(args)?,
    };
    if args.planner == Planner::Bidirectional {
        if problem.ground.is_some() {
            let reason = "on the ground it matters where the goal stands, which the goal does not say";
            return Err(PlanError::option("--planner bidirectional", reason, "use --planner astar"));
        }
        let fix = "name a file with joint values by --to, or use --planner astar";
        if matches!(problem.goal, Structured::Shape(_)) {
            return Err(PlanError::option("--planner bidirectional", "the goal has no joint values", fix));
        }
        if objective != Objective::Actions {
            let reason = "it counts actions only";
            return Err(PlanError::option("--planner bidirectional", reason, "use --planner astar"));
        }
    }
    Ok(problem)
}

fn rules(args: &PlanArgs) -> Rules {
    let model = match args.collision {
        CollisionArg::Final => Model::Final,
        CollisionArg::Core => Model::Core,
        CollisionArg::Strict => Model::Strict,
    };
    let connectors = match args.connectors {
        ConnectorsArg::All => Connectors::All,
        ConnectorsArg::Active => Connectors::Active,
    };
    Rules::new(connectors, model)
}

/// Returns the configuration to start from.
fn start(args: &PlanArgs, option: &str, text: &str) -> Result<Configuration, PlanError> {
    let given = structured(sources(), option, text)?;
    if let Some(file) = &args.joints {
        let posed = structured(sources(), "--joints", &file.display().to_string())?;
        let Structured::Configuration(configuration) = posed else {
            let fix = "give every module cells, foot_rotation and joints_deg";
            return Err(PlanError::option("--joints", "the file has no joint values", fix));
        };
        if posed.shape().canonical() != given.shape().canonical() {
            let reason = format!("the file has another shape than {option}");
            return Err(PlanError::option("--joints", reason, "name the file by --from"));
        }
        return Ok(configuration);
    }
    if let Structured::Configuration(configuration) = given {
        if args.seed.is_some() || args.types.is_some() {
            print_error(&format!("note: {option} has joint values, so --seed and --types change nothing"));
        }
        return Ok(configuration);
    }
    let shape = given.shape();
    if let Some(types) = &args.types {
        let place = format!("--types {types}");
        if !text.starts_with("line:") {
            return Err(PlanError::option(&place, "the start is not a line", "use --joints FILE"));
        }
        let digits: Option<Vec<u8>> = types.chars().map(|c| c.to_digit(4).map(|d| d as u8)).collect();
        let wanted = shape.len() - 1;
        return digits.filter(|d| d.len() == wanted).and_then(|d| named::line(&d)).ok_or_else(|| {
            let fix = format!("write {} of 0, 1, 2 or 3", many(wanted as u64, "digit"));
            PlanError::option(&place, "these are not types of the connections", fix)
        });
    }
    if let Some(seed) = args.seed {
        let mut rng = Rng::named(seed, "joint values", 0);
        let mut draw = |n: u64| rng.below(n) as u8;
        return Ok(shape.filled(|_| (draw(4), [draw(3), draw(4), draw(3)])));
    }
    if text.starts_with("line:") {
        let straight = named::line(&vec![0; shape.len() - 1]);
        return Ok(straight.expect("invariant: the shape has that many modules"));
    }
    Ok(shape.filled(|_| (0, [0; 3])))
}

fn weight(args: &PlanArgs) -> Result<u32, PlanError> {
    let Some(text) = &args.weight else { return Ok(100) };
    let wrong = |reason: &str| {
        let fix = "write a number from 1 to 100, such as 1.5";
        PlanError::option(&format!("--weight {text}"), reason, fix)
    };
    let number: f64 = text.parse().map_err(|_| wrong("this is not a number"))?;
    if !(1.0..=100.0).contains(&number) {
        return Err(wrong("the weight must be at least 1 and at most 100"));
    }
    if !matches!(args.planner, Planner::Auto | Planner::Portfolio | Planner::Astar) {
        let fix = "use --planner portfolio or --planner astar";
        return Err(PlanError::option("--weight", "this planner has no single weight", fix));
    }
    Ok((number * 100.0).round() as u32)
}

fn limits(args: &PlanArgs) -> Result<Limits, PlanError> {
    let text = args.memory.trim();
    let wrong = |reason: String| {
        let fix = format!("write at least {}MiB, such as 512MiB or 2GiB", Limits::LEAST_MEMORY >> 20);
        PlanError::option(&format!("--memory {text}"), reason, fix)
    };
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let unit = match &text[end..] {
        "" | "B" => 1,
        "KiB" => 1 << 10,
        "MiB" => 1 << 20,
        "GiB" => 1_u64 << 30,
        _ => return Err(wrong("this is not a size".to_owned())),
    };
    let number: u64 = text[..end].parse().map_err(|_| wrong("this is not a size".to_owned()))?;
    let memory = number.checked_mul(unit).and_then(|n| usize::try_from(n).ok());
    let memory = memory.ok_or_else(|| wrong("this is more than a machine has".to_owned()))?;
    if memory < Limits::LEAST_MEMORY {
        return Err(wrong("this is less than a search needs".to_owned()));
    }
    Ok(Limits { memory, work: args.work.unwrap_or(u64::MAX) })
}

fn timeout(text: &str) -> Result<Duration, PlanError> {
    let span: Result<Span, _> = text.parse();
    match span {
        Ok(Span(nanos)) => Ok(Duration::from_nanos(nanos)),
        Err(error) => {
            let place = format!("--timeout {text}");
            Err(PlanError::option(&place, error.to_string(), "write a time with a unit, such as 60s"))
        }
    }
}

/// Describes an answer.
fn text(answer: &Answer) -> String {
    let mut lines = Vec::new();
    let progress = &answer.progress;
    let by = answer.ended_by.as_deref().map_or_else(String::new, |by| match by {
        "interrupt" => " (interrupted)".to_owned(),
        by => format!(" (out of {by})"),
    });
    match (answer.verdict, answer.cost, &answer.plan) {
        (Verdict::Optimal, Some(cost), Some(plan)) => {
            lines.push(format!("optimal: {}, proved", many(cost.into(), check::unit(plan.objective))));
        }
        (Verdict::Bounded, Some(cost), Some(plan)) => lines.push(format!(
            "a plan of {}{by}; every plan has at least {}, so it is within a factor of {:.2}",
            many(cost.into(), check::unit(plan.objective)),
            answer.lower,
            answer.factor.unwrap_or(0.0)
        )),
        (Verdict::Impossible, ..) => lines.push(format!(
            "impossible: all {} that can be reached were examined",
            many(progress.kept, "configuration")
        )),
        _ => lines.push(format!("no plan was found{by}; every plan costs at least {}", answer.lower)),
    }
    for (i, step) in answer.plan.iter().flat_map(|p| &p.actions).enumerate() {
        lines.push(format!("{:>4}  {}", i, check::words(&step.what)));
    }
    if let Some(c) = &answer.counts {
        lines.push(format!(
            "  {}, {}, {}; {}; {} one after another; {}",
            many(c.turns.into(), "turn"),
            many(c.attachments.into(), "attachment"),
            many(c.detachments.into(), "detachment"),
            many(c.moves.into(), "move"),
            c.makespan,
            many(c.lifted.into(), "cube") + " lifted",
        ));
    }
    lines.push(format!(
        "  {}: {} expanded, {} generated, {} kept in {}",
        answer.planner,
        count(progress.expanded),
        count(progress.generated),
        count(progress.kept),
        bytes(progress.bytes)
    ));
    lines.join("\n")
}

fn execute(args: &PlanArgs, interrupt: &Interrupt) -> Result<u8, Failure> {
    if let Some(scenario) = &args.scenario {
        return assemblies::plan(scenario, args);
    }
    let (exit_code, plan) = plan(args, interrupt)?;
    if let Some(plan) = plan.filter(|_| args.view) {
        runs::view_plan(&plan, args.port, interrupt)?;
    }
    Ok(exit_code)
}

/// The command.
pub static COMMAND: CommandOf<PlanArgs> = CommandOf {
    name: "plan",
    group: Some(Group::Study),
    about: "Plan the reconfiguration of free modules, exactly, or a structure of metamodules and elements; check, compare and count",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, call| execute(&args, call.interrupt),
};
