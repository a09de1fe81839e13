//! On-grid locomotion (thesis 6.3.2): the exact planner and the published two layers, on the published kinds of floors.

use super::PlannerTable;
use super::sample::Ratios;
use crate::Experiment;
use metamorph_console::interrupt::Interrupt;
use metamorph_protocol::on_grid::replanning::Replanner;
use metamorph_protocol::on_grid::two_layer::{Walk, joined, walk};
use metamorph_protocol::on_grid::{ActionTable, GridGround, OnGrid, Span, Standing};
use metamorph_protocol::plan::search::{Method, Search};
use metamorph_protocol::plan::{Limits, Outcome, Step};
use metamorph_protocol::rng::Rng;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::grid::landings;
use metamorph_text::format::count;
use std::rc::Rc;

/// Length of a side of the floor in connectors.
const SIDE: u8 = 20;
/// Height of the columns in cells: more than a module reaches.
const COLUMN: i16 = 3;
/// Number of worlds of experiment 2 and of trials of experiment 3, as published.
const PUBLISHED: u64 = 300;
/// Successes and trials of experiment 3, as printed.
const MAP: (u64, u64) = (210, PUBLISHED);
/// The number of edits of the floor in a trial of replanning, and of edits after which the module walks on.
const EDITS: (u64, u64) = (40, 8);
/// Rectangles of the fixed world: x, y, width, height. The published map is a figure.
const RECTANGLES: [[i16; 4]; 5] = [[3, 3, 3, 5], [9, 2, 2, 6], [14, 5, 4, 3], [5, 12, 7, 2], [15, 13, 2, 5]];

const SPANS: [(Span, &str); 3] =
    [(Span::Feet, "feet only"), (Span::Core, "core cells free"), (Span::Strict, "core and graze cells free")];

/// Returns the smallest number of primitives to the goal (`None` if it cannot be reached), and the number of
/// standings that a search from scratch expands.
fn search(space: &OnGrid, from: Standing) -> (Option<u32>, u64) {
    let limits = Limits { memory: 256 << 20, work: u64::MAX };
    let mut search = Search::new(space.clone(), &from, limits, Method::astar());
    let fewest = match search.advance(u64::MAX) {
        Step::Done(Outcome::Solved { path, .. }) => Some(path.cost),
        _ => None,
    };
    (fewest, search.progress().expanded)
}

fn exact(space: &OnGrid, from: Standing) -> Option<u32> {
    search(space, from).0
}

/// Results of replanning and of complete searches after edits of a floor.
#[derive(Default)]
struct Replanning {
    edits: u64,
    /// Edits after which no way was left.
    impossible: u64,
    repaired: u64,
    anew: u64,
    different: u64,
}

impl Replanning {
    /// Adds a trial in which columns appear and disappear at random while a module walks to its goal.
    fn add(
        &mut self,
        ground: GridGround,
        from: Standing,
        goal: (i16, i16),
        span: Span,
        seed: u64,
        table: &Rc<ActionTable>,
    ) {
        let mut rng = Rng::named(seed, "edits", 0);
        let (mut at, size) = (from, ground.size());
        let mut replanner = Replanner::new(OnGrid { ground, span, goal, actions: table.clone() }, from);
        replanner.landings();
        for edit in 1..=EDITS.0 {
            let mut draw = |n: i16| rng.below(n as u64) as i16;
            let place = (draw(size.0), draw(size.1));
            if place == (at.foot.x, at.foot.y) {
                continue;
            }
            let before = replanner.expanded();
            replanner.set(place.0, place.1, !replanner.space().ground.is_blocked(place.0, place.1));
            let fewest = replanner.landings();
            let (exact, anew) = search(replanner.space(), at);
            self.edits += 1;
            self.impossible += u64::from(exact.is_none());
            self.different += u64::from(exact != fewest);
            self.repaired += replanner.expanded() - before;
            self.anew += anew;
            if edit % EDITS.1 == 0
                && let Some(path) = replanner.path()
                && let Some(next) = path.get(3)
                && *next != path[path.len() - 1]
            {
                at = *next;
                replanner.move_to(at);
            }
        }
    }
    fn text(&self) -> String {
        let mean = |n: u64| n as f64 / self.edits.max(1) as f64;
        let equal = match self.different {
            0 => "the same lengths".to_owned(),
            n => format!("{n} OTHER LENGTHS"),
        };
        format!(
            "{} edits, {} leave no way; {equal}; standings expanded an edit: {:.0}, whole search {:.0}",
            count(self.edits),
            count(self.impossible),
            mean(self.repaired),
            mean(self.anew)
        )
    }
}

/// Results of both planners over a set of trials.
#[derive(Default)]
struct Outcomes {
    trials: u64,
    /// Trials for which the exact planner has a plan.
    exact: u64,
    /// Trials in which the published planner reached the goal.
    published: u64,
    /// Of these, the trials whose ends are not beside a column or the rim, which is where the published planner is said to fail.
    published_inside: u64,
    /// Primitives walked and the smallest number, of each trial where both succeed.
    primitives: Vec<(u64, u64)>,
    /// Trials in which the published planner succeeded although the exact one proved that there is no plan.
    contradictions: u64,
}

impl Outcomes {
    fn add(&mut self, space: &OnGrid, from: Standing) {
        let (best, two_layers) = (exact(space, from), walk(space, from));
        self.trials += 1;
        self.exact += u64::from(best.is_some());
        if let Walk::Reached { primitives, .. } = two_layers {
            self.published += 1;
            let ends = [(from.foot.x, from.foot.y), space.goal];
            self.published_inside += u64::from(ends.into_iter().all(|end| is_inside(&space.ground, end)));
            match best {
                Some(best) => self.primitives.push((u64::from(primitives), u64::from(best))),
                None => self.contradictions += 1,
            }
        }
    }

    /// Adds the rows of an experiment; `published` are the printed counts of all trials, if the text gives them.
    fn rows(&self, table: &mut PlannerTable, name: &str, printed: &str, published: Option<(u64, u64)>) {
        let solvable = (self.published, self.exact);
        if let Some(published) = published {
            let ours = (self.published, self.trials);
            table.share(format!("{name}: reached by two layers"), printed, ours).against(ours, published);
            let inside = (self.published_inside, self.trials);
            table
                .share("  and both ends a cell away from columns and rim", printed, inside)
                .against(inside, published);
            table.share("  reached by two layers, of those with a plan", "", solvable);
        } else {
            table.share(format!("{name}: reached by two layers, of those with a plan"), printed, solvable);
        }
        table.share("  with a plan, by the exact search", "", (self.exact, self.trials));
        let walked = Ratios::new(self.primitives.iter().copied());
        table.ratio("  primitives of two layers over the fewest", "", &walked);
        if self.contradictions > 0 {
            table.row("  CONTRADICTIONS: reached though there is no plan", "", count(self.contradictions));
        }
    }
}

/// True if a connector is at least one cell away from every column and from the rim of the floor.
fn is_inside(ground: &GridGround, (x, y): (i16, i16)) -> bool {
    (-1..=1).all(|dx| (-1..=1).all(|dy| ground.is_free(x + dx, y + dy)))
}

/// Makes the table.
pub fn table(seeds: u64, stop: &Interrupt) -> PlannerTable {
    let mut table = PlannerTable::new(Experiment::OnGrid);
    let actions = Rc::new(ActionTable::new());
    let found = landings(Kind::Single).into_iter().map(|(l, p)| {
        let degrees: Vec<String> = p[0].degrees().iter().map(i16::to_string).collect();
        format!("({}, {}) class {} by {}", l.x, l.y, l.class, degrees.join(" "))
    });
    table.row(
        "table 6.1: atomic primitives",
        "(0,1) π; (0,1) -π/2; (1,0) π/2; (1,0) -π",
        found.collect::<Vec<_>>().join("; "),
    );
    let trials = seeds.min(PUBLISHED);
    for (span, name) in SPANS {
        let mut primitives = [0; 8];
        let mut near = Outcomes::default();
        for goal in (0..25).map(|i| (8 + i % 5, 8 + i / 5)).filter(|g| *g != (10, 10)) {
            let ground = GridGround::open(SIDE, SIDE, COLUMN);
            let space = OnGrid { ground, span, goal, actions: actions.clone() };
            let from = Standing::upright(10, 10, 0);
            near.add(&space, from);
            primitives[exact(&space, from).unwrap_or(0).min(7) as usize] += 1;
        }
        near.rows(&mut table, &format!("1: targets within 2 cells, {name}"), "100 %", None);
        let list: Vec<String> = primitives[1..7].iter().map(ToString::to_string).collect();
        table.row("  targets by their fewest primitives, from one", "", list.join(" "));
        let (mut worlds, mut fixed) = (Outcomes::default(), Outcomes::default());
        for seed in 0..trials {
            if stop.is_set() {
                break;
            }
            let (ground, from, goal) = square(SIDE, seed);
            worlds.add(&OnGrid { ground, span, goal, actions: actions.clone() }, from);
            let (ground, from, goal) = rectangles(seed);
            fixed.add(&OnGrid { ground, span, goal, actions: actions.clone() }, from);
        }
        worlds.rows(&mut table, &format!("2: worlds with one square, {name}"), "100 %", None);
        let name = format!("3: trials in one world, {name}");
        fixed.rows(&mut table, &name, "70 % of 300", Some(MAP));
    }
    for (side, trials) in [(SIDE, trials), (5 * SIDE, trials / 50)] {
        let mut replanning = Replanning::default();
        for seed in 0..trials {
            if stop.is_set() {
                break;
            }
            let (ground, from, goal) = square(side, seed);
            let span = SPANS[seed as usize % 3].0;
            replanning.add(ground, from, goal, span, seed, &actions);
        }
        if replanning.edits > 0 {
            table.row(format!("D* Lite, {side} × {side} connectors"), "D*, no figures", replanning.text());
        }
    }
    table.notes = vec![
        "exact: one search over place, class and posture; none found means that none exists".to_owned(),
        "two layers: the published planner; path among 8 neighbours, composed primitives, other neighbours clockwise".to_owned(),
        "which cells the published spanning area has is not said, so three readings are shown".to_owned(),
        "the map of experiment 3 is a figure; ours has five rectangles, so that a small p may be that of another map. The text gives one cause of failures: ends beside an obstacle or the rim. The second row of 3 counts these as failed".to_owned(),
        "D* Lite: columns come and go while the module walks; it repairs the distances to the goal of all standings, the whole search is A* anew".to_owned(),
        "worlds whose ends are joined over free connectors; by the feet alone a module cannot pass all of them".to_owned(),
    ];
    table
}

/// Draws ends that are free and joined.
fn ends(rng: &mut Rng, ground: &GridGround) -> Option<(Standing, (i16, i16))> {
    let mut draw = |n: u64| rng.below(n) as i16;
    let (width, height) = (ground.size().0 as u64, ground.size().1 as u64);
    let (from, goal) = ((draw(width), draw(height)), (draw(width), draw(height)));
    let class = draw(4) as u8;
    let free = |p: (i16, i16)| ground.is_free(p.0, p.1);
    let good = from != goal && free(from) && free(goal) && joined(ground, from, goal);
    good.then(|| (Standing::upright(from.0, from.1, class), goal))
}

/// Draws a world with one square, of side 1 to 15 on the published floor of 20 by 20.
fn square(size: u8, seed: u64) -> (GridGround, Standing, (i16, i16)) {
    let mut rng = Rng::named(seed, "one square", 0);
    loop {
        let mut ground = GridGround::open(size, size, COLUMN);
        let side = 1 + rng.below(u64::from(size) * 3 / 4) as i16;
        let mut corner = || rng.below(u64::from(size) + 1 - side as u64) as i16;
        ground.block(corner(), corner(), side, side);
        if let Some((from, goal)) = ends(&mut rng, &ground) {
            return (ground, from, goal);
        }
    }
}

fn rectangles(seed: u64) -> (GridGround, Standing, (i16, i16)) {
    let mut rng = Rng::named(seed, "five rectangles", 0);
    let mut ground = GridGround::open(SIDE, SIDE, COLUMN);
    for [x, y, width, height] in RECTANGLES {
        ground.block(x, y, width, height);
    }
    loop {
        if let Some((from, goal)) = ends(&mut rng, &ground) {
            return (ground, from, goal);
        }
    }
}
