//! Plans how one element is brought to its goal, in the terms of a swarm: poses, postures and loads. The search is that
//! of [`metamorph_planning::manipulation::transport`].

use metamorph_agents::metamodule::blueprint::Floor;
use metamorph_agents::metamodule::planning::cooperative::Standstill;
use metamorph_agents::metamodule::pose::{Load, Pose, to_world};
use metamorph_agents::metamodule::setup::Setup;
use metamorph_core::lattice::{Cell, Face};
use metamorph_planning::manipulation::element::{Element, Grip};
use metamorph_planning::manipulation::load::{LoadLimits, Peak};
use metamorph_planning::manipulation::scene::{Foothold, Scene, hand_overs};
use metamorph_planning::manipulation::terrain::Terrain;
use metamorph_planning::manipulation::transport::{
    Answer, Refutations, Task, TransportReason, plan as search,
};
use metamorph_planning::manipulation::verification::{BodyAction, MoverAction};
use metamorph_planning::manipulation::walking::{Body, Motion, WalkingGround};
use metamorph_roombots::Kind;
use metamorph_roombots::lattice_pose::{LatticePose, LatticeRotation};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::ops::RangeInclusive;
use std::sync::{Arc, Mutex, PoisonError};

/// The weight of the lower bound in hundredths.
const WEIGHT: u32 = 500;
/// The most connectors of a floor on which transports are planned: footholds have 16 bits.
const MAX_CONNECTORS: usize = 16_000;
/// Largest number of connectors of a floor that is planned for as a whole.
const WHOLE_FLOOR_MAX: usize = 400;
/// Width of the margin around the places of a transport, in connectors, that is planned for on larger floors.
const MARGIN: i16 = 6;
/// Work of planning one transport, in placements examined, as scenario time is taken for it: a constant, since most of
/// it is the making of graphs that depend on the floor only.
pub const TRANSPORT_WORK: usize = 2_000_000;

/// An action of one metamodule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransportAction {
    /// It turns to a posture; with an element, by one step.
    Turn(u16),
    /// It turns to a posture and lands.
    Land(u16),
    /// It grips the element, or releases it.
    Handle(Load),
}

/// A step of a transport. Each comes after the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TransportStep {
    /// The index of the metamodule in [`Standstill::free`].
    pub body: usize,
    /// Its pose before.
    pub from: Pose,
    /// Its pose afterwards.
    pub to: Pose,
    /// The action.
    pub action: TransportAction,
}

/// A plan for one element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TransportPlan {
    /// The steps, in order.
    pub steps: Vec<TransportStep>,
    /// The number of hand-overs.
    pub hand_overs: u32,
    /// Landings and grips.
    pub connections: u32,
    /// The largest torques while the element is carried.
    pub peak: Peak,
}

/// The answer of the planner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TransportAnswer {
    /// A plan.
    Plan(TransportPlan),
    /// There is no plan with lattice angles in which the element is always held.
    Infeasible(TransportReason),
    /// Neither a plan nor a proof was found.
    Undecided,
}

/// Problem of the planner of one element.
#[derive(Clone, Copy, Debug)]
pub struct Transport<'a> {
    /// The element.
    pub element: usize,
    /// Its cells, sorted.
    pub cells: &'a [Cell],
    /// The cells of its goal, sorted.
    pub goal: &'a [Cell],
    /// True if it lies at its goal in the end, and is not held.
    pub lies: bool,
    /// The edges of the manipulation graph that are taken out at most in each search.
    pub refutations: Refutations,
}

/// Largest number of scenes that are kept.
const MAX_SCENES: usize = 32;

/// The graphs of floors for elements, made when they are first needed. Clones share them, so that the runs of a sweep, which
/// have the same floor and elements, need not make them again.
#[derive(Clone, Default)]
pub struct Scenes(Arc<Mutex<KeptScenes>>);

/// The latest scenes, the oldest first.
type KeptScenes = VecDeque<(SceneKey, Arc<Scene>)>;

/// Inputs from which a scene is made.
#[derive(PartialEq)]
struct SceneKey {
    kind: Kind,
    floor: Floor,
    shape: Element,
    grams: u32,
    grips: Vec<Grip>,
    limits: LoadLimits,
    with_hand_overs: bool,
}

impl fmt::Debug for Scenes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Scenes")
    }
}

impl Scenes {
    fn of(&self, setup: &Setup, element: usize, with_hand_overs: bool) -> Arc<Scene> {
        let (elements, passive) = (&setup.elements, &setup.elements.all()[element]);
        let loads = elements.loads_of(element);
        let grips = loads.iter().filter_map(|load| elements.carry(*load));
        let key = SceneKey {
            kind: setup.kind(),
            floor: setup.floor,
            shape: passive.shape.clone(),
            grams: passive.grams,
            grips: grips.map(|carry| carry.grip().clone()).collect(),
            limits: elements.limits(),
            with_hand_overs,
        };
        // Another run that needs the same scene waits for it.
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, scene)) = kept.iter().find(|(of, _)| *of == key) {
            return Arc::clone(scene);
        }
        let made = Arc::new(scene(setup, element, &loads, with_hand_overs));
        if kept.len() == MAX_SCENES {
            kept.pop_front();
        }
        kept.push_back((key, Arc::clone(&made)));
        made
    }
}

/// Means that a transport may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Means {
    hand_overs: bool,
    puts_down: bool,
}

/// Plans how an element is brought from where it is to its goal, so that its last holder fills one of the open seeds, or
/// so that it lies there. Hand-overs are tried if there is no plan without, and only of an element with one grip: the tables
/// of hand-overs grow with the square of the number of grips. Then the element may be put down on the way as well.
pub fn plan_transport(at: &Standstill, transport: &Transport<'_>, scenes: &Scenes) -> TransportAnswer {
    let loads = at.setup.elements.loads_of(transport.element).len();
    let mut means: Vec<Means> = Vec::new();
    if !transport.lies {
        means.push(Means { hand_overs: false, puts_down: false });
        means.extend((loads == 1).then_some(Means { hand_overs: true, puts_down: false }));
    }
    means.push(Means { hand_overs: false, puts_down: true });
    means.extend((loads == 1).then_some(Means { hand_overs: true, puts_down: true }));
    let mut answer = TransportAnswer::Undecided;
    for means in means {
        answer = planned(at, transport, scenes, means);
        let is_settled =
            matches!(answer, TransportAnswer::Plan(_) | TransportAnswer::Infeasible(TransportReason::Colour));
        if is_settled {
            return answer;
        }
    }
    match loads {
        1 => answer,
        // There may be a plan with hand-overs.
        _ => TransportAnswer::Undecided,
    }
}

fn planned(at: &Standstill, transport: &Transport<'_>, scenes: &Scenes, means: Means) -> TransportAnswer {
    let (setup, element) = (&*at.setup, transport.element);
    if setup.floor.connectors() > MAX_CONNECTORS {
        return TransportAnswer::Undecided;
    }
    let loads = setup.elements.loads_of(element);
    let scene = scenes.of(setup, element, means.hand_overs);
    let window = window(at, transport);
    let ground = WalkingGround::new(&scene, |c| {
        window.as_ref().is_none_or(|[x, y]| x.contains(&(c.half[0] / 2)) && y.contains(&(c.half[1] / 2)))
    });
    let body = |pose: &Pose| Some(Body { foothold: foothold(setup, *pose)?, posture: pose.posture });
    let Some(bodies) = at.free.iter().map(body).collect::<Option<Vec<Body>>>() else {
        return TransportAnswer::Undecided;
    };
    let holder = at.free.iter().position(|pose| setup.elements.of(pose.load) == Some(element));
    let grip_of = |load: Load| loads.iter().position(|l| *l == load);
    let held_by = holder.and_then(|i| Some((i as u8, grip_of(at.free[i].load)? as u8)));
    let open = setup.goal(at.task).open(at.filled);
    let seeds = setup.seeds(at.task).filter(|(seed, _)| open.has(*seed));
    let task = Task {
        held_by,
        ends: (!transport.lies).then(|| seeds.map(|(_, seed)| seed.cells()).collect()),
        puts_down: means.puts_down,
        rests: transport.lies,
        fixed: at.fixed.clone(),
        refutations: transport.refutations,
        ..Task::new(bodies, transport.cells.to_vec(), transport.goal.to_vec(), WEIGHT)
    };
    match search(&ground, &task) {
        Answer::Plan(found) => {
            let connections = found.connections();
            let Some((steps, peak)) = steps_of(at, &loads, &found.actions) else {
                return TransportAnswer::Undecided;
            };
            TransportAnswer::Plan(TransportPlan { steps, hand_overs: found.hand_overs, connections, peak })
        }
        Answer::Infeasible(reason) => TransportAnswer::Infeasible(reason),
        Answer::Undecided { .. } => TransportAnswer::Undecided,
    }
}

/// Returns the part of a large floor that is examined: around the element, its goal, and the free metamodules.
fn window(at: &Standstill, transport: &Transport<'_>) -> Option<[RangeInclusive<i16>; 2]> {
    if at.setup.floor.connectors() <= WHOLE_FLOOR_MAX {
        return None;
    }
    let feet = at.free.iter().map(|pose| pose.foot());
    let cells = transport.cells.iter().chain(transport.goal).map(|c| (c.x, c.y));
    let all: Vec<(i16, i16)> = feet.chain(cells).collect();
    let along = |of: fn(&(i16, i16)) -> i16| {
        let (least, most) = (all.iter().map(of).min()?, all.iter().map(of).max()?);
        Some(least - MARGIN..=most + MARGIN)
    };
    Some([along(|(x, _)| *x)?, along(|(_, y)| *y)?])
}

/// Returns the number of the foothold of a pose: they come by connector, x first, and there by rotation.
fn foothold(setup: &Setup, pose: Pose) -> Option<Foothold> {
    let floor = setup.floor;
    let (x, y) = pose.foot();
    let column = i32::from(floor.max.1) - i32::from(floor.min.1) + 1;
    let connector = (i32::from(x) - i32::from(floor.min.0)) * column + i32::from(y) - i32::from(floor.min.1);
    let up = LatticeRotation::all().filter(|r| r.up() == Face::Up);
    let turn = up.into_iter().position(|r| r == foot(pose).rotation)?;
    floor.has(x, y).then(|| Foothold::try_from(4 * connector + turn as i32).ok())?
}

/// Returns the graphs of the floor for the grips of an element.
fn scene(setup: &Setup, element: usize, loads: &[Load], with_hand_overs: bool) -> Scene {
    let elements = &setup.elements;
    let carry: Vec<_> = loads.iter().filter_map(|load| elements.carry(*load)).cloned().collect();
    let within = |(grip, load): (u8, &Load)| {
        let peaks = (0..).map_while(|step| elements.peak(*load, step));
        ((grip, Face::Down), peaks.map(|peak| peak.within(elements.limits())).collect())
    };
    let within = (0..).zip(loads).map(within).collect();
    let hand_overs = match with_hand_overs {
        true => hand_overs(setup.motions.table(), &elements.all()[element].shape, &carry),
        false => BTreeMap::new(),
    };
    let floor = Terrain::rectangle(setup.floor.min, setup.floor.max);
    Scene::of_tables(Arc::clone(setup.motions.database()), carry, within, hand_overs, floor)
}

/// Returns the pose of the foot on the floor.
pub fn foot(pose: Pose) -> LatticePose {
    let rotation = LatticeRotation::QUARTER.power(pose.state.class);
    LatticePose { rotation, half: [2 * pose.state.x, 2 * pose.state.y, 0] }
}

/// Returns the steps of a plan. Turns of a metamodule without an element become one step, since it finds its own way.
fn steps_of(at: &Standstill, loads: &[Load], actions: &[MoverAction]) -> Option<(Vec<TransportStep>, Peak)> {
    let (setup, mut poses) = (&at.setup, at.free.clone());
    let (mut steps, mut peak): (Vec<TransportStep>, Peak) = (Vec::new(), Peak::default());
    for MoverAction { mover, body_action } in actions {
        let from = poses[*mover];
        let (to, action) = match body_action {
            BodyAction::Move(Motion::Turn { to, .. }) => {
                (Pose { posture: *to, ..from }, TransportAction::Turn(*to))
            }
            BodyAction::Move(Motion::Land(_)) => {
                (setup.motions.turned_around(from)?, TransportAction::Land(from.posture))
            }
            BodyAction::Grip { grip } => {
                let load = *loads.get(usize::from(*grip))?;
                (Pose { load, ..from }, TransportAction::Handle(load))
            }
            BodyAction::LetGo => (Pose { load: Load::NONE, ..from }, TransportAction::Handle(Load::NONE)),
        };
        poses[*mover] = to;
        if let (TransportAction::Turn(posture), true) = (action, from.load != Load::NONE) {
            peak = peak.max(setup.carried_step(from, posture)?.peak);
        }
        let is_walk = from.load == Load::NONE && !matches!(action, TransportAction::Handle(_));
        match steps.last_mut() {
            Some(last)
                if is_walk && last.body == *mover && matches!(last.action, TransportAction::Turn(_)) =>
            {
                (last.to, last.action) = (to, action);
            }
            _ => steps.push(TransportStep { body: *mover, from, to, action }),
        }
    }
    Some((steps, peak))
}

/// Returns the steps by which a metamodule puts the element that it holds down on the floor; `None` if it cannot. It stays at
/// its foothold, and the others where they are.
pub fn put_back(at: &Standstill, body: usize) -> Option<Vec<TransportStep>> {
    let (setup, pose) = (&*at.setup, *at.free.get(body)?);
    setup.held(pose)?;
    let (carry, limits) = (setup.elements.carry(pose.load)?, setup.elements.limits());
    let others = (0..at.free.len()).filter(|i| *i != body).flat_map(|i| setup.occupied(at.free[i]));
    let taken: BTreeSet<Cell> = others.chain(at.fixed.iter().copied()).collect();
    let blocked = carry.set(|cell| taken.contains(&to_world(pose.state, cell)));
    let passes = |step: usize| {
        let within = setup.elements.peak(pose.load, step).is_some_and(|peak| peak.within(limits));
        within && !carry.steps()[step].swept.meets(&blocked)
    };
    let lies = |posture: &u16| {
        setup.held(Pose { posture: *posture, ..pose }).is_some_and(|(_, cells)| setup.rests(&cells))
    };
    let ends = carry.valid_postures().into_iter().filter(lies);
    let path = ends.filter_map(|to| carry.path(pose.posture, to, passes)).min_by_key(Vec::len)?;
    let (mut from, mut steps) = (pose, Vec::new());
    for (_, posture) in path {
        let to = Pose { posture, ..from };
        steps.push(TransportStep { body, from, to, action: TransportAction::Turn(posture) });
        from = to;
    }
    let to = Pose { load: Load::NONE, ..from };
    steps.push(TransportStep { body, from, to, action: TransportAction::Handle(Load::NONE) });
    Some(steps)
}

/// Returns the loads by which metamodules in their seeds can still grip an element at its goal: the number of each
/// metamodule in `settled` with the load.
pub fn missing_bonds(setup: &Setup, goal: u8, settled: &[Pose]) -> Vec<(usize, Load)> {
    let mut missing = Vec::new();
    for (element, passive) in setup.elements.all().iter().enumerate() {
        for (i, pose) in settled.iter().enumerate().filter(|(_, pose)| pose.load == Load::NONE) {
            missing.extend(setup.loads_at(*pose, element, passive.goal(goal)).map(|load| (i, load)));
        }
    }
    missing
}

/// Returns the posture in which a metamodule fills the same seed as in `posture` and its head faces an element at its goal.
/// Without such a posture, or a way to it around the cells `taken`, returns `posture`.
pub fn facing(setup: &Setup, goal: u8, from: Pose, posture: u16, taken: &[Cell]) -> u16 {
    let (motions, elements) = (&setup.motions, setup.elements.all());
    let taken = motions.graph().seen_from(from.state, taken);
    let faces = |to: &u16| {
        let pose = Pose { posture: *to, ..from };
        let mut goals = elements.iter().enumerate();
        goals.any(|(element, passive)| setup.loads_at(pose, element, passive.goal(goal)).is_some())
            && motions.graph().path(from.posture, *to, taken).is_some()
    };
    let chain = motions.graph().chain(posture);
    let same = chain.map_or(&[][..], |chain| motions.filling(chain));
    same.iter().copied().find(faces).unwrap_or(posture)
}
