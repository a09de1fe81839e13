//! The assembly of a structure: the disassembly reversed, and carried out from where metamodules and elements are.

use super::isolation::thesis_order;
use super::removal::{Departure, MAX_BUNDLES, Taking};
use super::{Reason, Structure};
use crate::manipulation::colour::colours_differ;
use crate::manipulation::load::Peak;
use crate::manipulation::scene::Hold;
use crate::manipulation::transport::{Answer, ManipulationPlan, Task, TransportReason, plan as search};
use crate::manipulation::verification::{BodyAction, MoverAction, Situation};
use crate::manipulation::walking::{Body, Motion};
use crate::plan::and_or::{Disassembly, Items, Removal, RemovalRefusal, Stuck, disassemble, precedence};
use metamorph_core::lattice::Cell;
use std::collections::BTreeMap;

/// Largest number of bundles that are excluded from the search because they cannot be placed.
pub const MAX_REFUTATIONS: usize = 64;
/// The weight of the lower bound of transports, in hundredths.
const WEIGHT: u32 = 500;

/// Actions that placed one bundle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlacedBundle {
    /// The seats and pieces of the bundle.
    pub items: Items,
    /// The steps, from 0, that must be done before.
    pub after: Vec<usize>,
    /// The actions in order. Movers are numbered as in the start.
    pub actions: Vec<MoverAction>,
    /// The number of hand-overs.
    pub hand_overs: u32,
    /// The largest torques on metamodules with a piece.
    pub peak: Peak,
}

impl PlacedBundle {
    /// Returns the number of landings and grips.
    pub fn connections(&self) -> u32 {
        let is = |a: &&MoverAction| {
            matches!(a.body_action, BodyAction::Move(Motion::Land(_)) | BodyAction::Grip { .. })
        };
        self.actions.iter().filter(is).count() as u32
    }
    /// Returns the number of steps of joints, and the sum of their angles in degrees.
    pub fn turns(&self) -> (u32, u32) {
        let angle = |a: &MoverAction| match a.body_action {
            BodyAction::Move(Motion::Turn { degrees, .. }) => Some(u32::from(degrees)),
            _ => None,
        };
        let angles: Vec<u32> = self.actions.iter().filter_map(angle).collect();
        (angles.len() as u32, angles.iter().sum())
    }
}

/// A plan for a structure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StructurePlan {
    /// The bundles in the order in which they are placed.
    pub bundles: Vec<PlacedBundle>,
    /// The number of bundles that were taken out of the search, since they could not be placed.
    pub refutations: usize,
    /// The least number of connections of any plan: one for each bond, and one for each seat at whose foot no metamodule
    /// stands at the start.
    pub lower: u32,
}

/// Why there is no plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Failure {
    /// A piece has another colour at its goal.
    Colour(usize),
    /// Fewer metamodules than seats.
    TooFew,
    /// The finished structure does not stand.
    Unstable(Reason),
    /// The disassembly ends here: nothing can be taken away.
    Stuck(Stuck<Reason>),
    /// The order of thesis B.5 has taken all metamodules without these pieces.
    LeftOver(Vec<usize>),
    /// A bundle of the order of thesis B.5 cannot be placed.
    NotPlaced {
        /// The bundle.
        bundle: Items,
        /// Why.
        reason: Reason,
    },
    /// Too much work.
    Work,
}

/// The answer of the planner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StructureAnswer {
    /// A plan.
    Plan(StructurePlan),
    /// There is no plan.
    Infeasible(Failure),
    /// Neither a plan nor a proof was found.
    Undecided(Failure),
}

/// Plans a structure with the order of the AND/OR search. Metamodules stand in `bodies` at the start, each free.
pub fn plan_structure(structure: &Structure, bodies: &[Body]) -> StructureAnswer {
    if let Some(failure) = impossible(structure, bodies) {
        return StructureAnswer::Infeasible(failure);
    }
    let mut taking = Taking::new(structure);
    let mut refutations = 0;
    loop {
        let sequence = match disassemble(&mut taking, structure.whole(), MAX_BUNDLES) {
            Disassembly::Sequence(sequence) => sequence,
            Disassembly::Impossible(stuck) => return StructureAnswer::Infeasible(Failure::Stuck(stuck)),
            Disassembly::Undecided(stuck) => {
                return StructureAnswer::Undecided(stuck.map_or(Failure::Work, Failure::Stuck));
            }
        };
        let order: Vec<Removal<Departure>> = sequence.iter().rev().cloned().collect();
        match carried_out(structure, &taking, bodies, &order) {
            Ok(mut bundles) => {
                let after = precedence(&mut taking, &sequence);
                bundles.iter_mut().zip(after).for_each(|(bundle, after)| bundle.after = after);
                let lower = lower_bound(structure, bodies);
                return StructureAnswer::Plan(StructurePlan { bundles, refutations, lower });
            }
            Err((at, refusal)) if refutations < MAX_REFUTATIONS => {
                refutations += 1;
                taking.refute(order[at].standing, order[at].bundle, refusal);
            }
            Err(_) => return StructureAnswer::Undecided(Failure::Work),
        }
    }
}

/// Returns the bundles of a structure in an order in which they can be placed, regardless of where metamodules and
/// elements are; `None` if no such order was found.
pub fn bundles(structure: &Structure) -> Option<Vec<Items>> {
    structure.stable(structure.whole()).ok()?;
    let mut taking = Taking::new(structure);
    let Disassembly::Sequence(sequence) = disassemble(&mut taking, structure.whole(), MAX_BUNDLES) else {
        return None;
    };
    Some(sequence.iter().rev().map(|removal| removal.bundle).collect())
}

/// Plans a structure in the order of thesis B.5, which is not changed.
pub fn plan_as_thesis(structure: &Structure, bodies: &[Body]) -> StructureAnswer {
    if let Some(failure) = impossible(structure, bodies) {
        return StructureAnswer::Infeasible(failure);
    }
    let order = thesis_order(structure);
    if !order.left_over.is_empty() {
        return StructureAnswer::Infeasible(Failure::LeftOver(order.left_over));
    }
    let mut standing = Items::default();
    let mut steps = Vec::new();
    for chain in &order.taken {
        standing = standing.with(chain.items);
        let seat = structure.seats_in(chain.items).next().unwrap_or_default();
        let way = match structure.pieces_in(chain.items).next() {
            Some(piece) => Departure::Carry { seat, piece },
            None => Departure::Walk(seat),
        };
        steps.push(Removal { standing, bundle: chain.items, way });
    }
    match carried_out(structure, &Taking::new(structure), bodies, &steps) {
        Ok(mut bundles) => {
            let steps = 0..bundles.len();
            bundles.iter_mut().zip(steps).for_each(|(bundle, i)| bundle.after = (0..i).collect());
            let lower = lower_bound(structure, bodies);
            StructureAnswer::Plan(StructurePlan { bundles, refutations: 0, lower })
        }
        Err((at, refusal)) => {
            let failure = Failure::NotPlaced { bundle: steps[at].bundle, reason: refusal.reason };
            match refusal.is_proved {
                true => StructureAnswer::Infeasible(failure),
                false => StructureAnswer::Undecided(failure),
            }
        }
    }
}

/// Returns why no order leads to a structure, if that is known without a search.
fn impossible(structure: &Structure, bodies: &[Body]) -> Option<Failure> {
    let differs = |p: &super::Piece| colours_differ(&p.part.start, &p.part.goal);
    if let Some(piece) = structure.pieces.iter().position(differs) {
        return Some(Failure::Colour(piece));
    }
    if bodies.len() < structure.seats.len() {
        return Some(Failure::TooFew);
    }
    structure.stable(structure.whole()).err().map(Failure::Unstable)
}

fn lower_bound(structure: &Structure, bodies: &[Body]) -> u32 {
    let pairs = (0..structure.pieces.len()).flat_map(|p| (0..structure.seats.len()).map(move |s| (p, s)));
    let bonds = pairs.filter(|(piece, seat)| structure.is_bond(*piece, *seat)).count();
    let stands =
        |seat: &&super::Seat| bodies.iter().any(|b| structure.scene().body(b.foothold, 0)[0] == seat[0]);
    (bonds + structure.seats.iter().filter(|seat| !stands(seat)).count()) as u32
}

/// Carries out bundles in this order. On failure returns the number of the bundle that cannot be placed, and why.
fn carried_out(
    structure: &Structure,
    taking: &Taking<'_>,
    bodies: &[Body],
    order: &[Removal<Departure>],
) -> Result<Vec<PlacedBundle>, (usize, RemovalRefusal<Reason>)> {
    let pieces = structure.pieces.iter().map(|piece| piece.part.start.clone()).collect();
    let free = (0..bodies.len()).zip(bodies.iter().copied()).collect();
    let mut at = AssemblyProgress { structure, taking, free, seated: BTreeMap::new(), pieces };
    let mut placed = Vec::new();
    for (i, step) in order.iter().enumerate() {
        placed.push(at.place(step).map_err(|refusal| (i, refusal))?);
    }
    Ok(placed)
}

/// How far an assembly is.
struct AssemblyProgress<'a, 'b> {
    structure: &'a Structure,
    taking: &'b Taking<'a>,
    /// The metamodules that are not in seats, with their numbers.
    free: Vec<(usize, Body)>,
    /// By seat, the metamodule and its pose.
    seated: BTreeMap<usize, (usize, Body)>,
    /// The cells of each piece, sorted.
    pieces: Vec<Vec<Cell>>,
}

impl<'a> AssemblyProgress<'a, '_> {
    fn place(&mut self, step: &Removal<Departure>) -> Result<PlacedBundle, RemovalRefusal<Reason>> {
        let mut placed = PlacedBundle {
            items: step.bundle,
            after: Vec::new(),
            actions: Vec::new(),
            hand_overs: 0,
            peak: Peak::default(),
        };
        match &step.way {
            Departure::Walk(seat) => self.walk_in(*seat, step.standing, &mut placed)?,
            Departure::Carry { seat, piece } => {
                let ends = vec![self.structure.seats[*seat]];
                self.bring(*piece, ends, Some(*seat), &mut placed)?;
            }
            Departure::Taken { piece, holds } => {
                let scene = &self.structure.pieces[*piece].scene;
                let ends = holds.iter().map(|(hold, posture)| scene.body(hold.foothold, *posture));
                self.bring(*piece, ends.collect(), None, &mut placed)?;
            }
        }
        Ok(placed)
    }

    fn task(&self, piece: Option<usize>, ends: Option<Vec<[Cell; 4]>>) -> Task {
        let scene = self.structure.scene();
        let seated = self.seated.values().flat_map(|(_, b)| scene.body(b.foothold, b.posture));
        let others = (0..self.pieces.len()).filter(|p| Some(*p) != piece);
        let fixed = seated.chain(others.flat_map(|p| self.pieces[p].iter().copied())).collect();
        let (start, goal) = match piece {
            Some(piece) => (self.pieces[piece].clone(), self.structure.pieces[piece].part.goal.clone()),
            None => Default::default(),
        };
        let bodies = self.free.iter().map(|(_, body)| *body).collect();
        Task { ends, fixed, ..Task::new(bodies, start, goal, WEIGHT) }
    }

    /// Notes what was done, in terms of the free metamodules.
    fn note(&mut self, actions: &[MoverAction], placed: &mut PlacedBundle) {
        for action in actions {
            let (number, body) = &mut self.free[action.mover];
            match action.body_action {
                BodyAction::Move(Motion::Turn { to, .. }) => body.posture = to,
                BodyAction::Move(Motion::Land(there)) => *body = there,
                BodyAction::Grip { .. } | BodyAction::LetGo => {}
            }
            placed.actions.push(MoverAction { mover: *number, body_action: action.body_action });
        }
    }

    /// Brings one of the free metamodules into a seat, where it grips the pieces that it faces.
    fn walk_in(
        &mut self,
        seat: usize,
        standing: Items,
        placed: &mut PlacedBundle,
    ) -> Result<(), RemovalRefusal<Reason>> {
        let ends = self.structure.ends(seat);
        let task = self.task(None, None);
        let ground = self.taking.ground(0);
        let scene = ground.scene();
        let stand = |b: &Body| (b.foothold, scene.empty(b.foothold)[usize::from(b.posture)]);
        let mut tried: Vec<(u16, usize, Vec<Body>)> = Vec::new();
        for (i, (_, body)) in self.free.iter().enumerate() {
            let distances = ground.distances(stand(body));
            let near = |end: &Body| Some((*distances.get(&stand(end))?, *end));
            let mut reached: Vec<(u16, Body)> = ends.iter().filter_map(near).collect();
            reached.sort_unstable_by_key(|(landings, end)| (*landings, end.foothold, end.posture));
            if let Some((landings, _)) = reached.first() {
                tried.push((*landings, i, reached.into_iter().map(|(_, end)| end).collect()));
            }
        }
        tried.sort_unstable_by_key(|(landings, i, _)| (*landings, *i));
        let situation = Situation::new(ground, &task);
        let found = tried.iter().find_map(|(_, i, ends)| Some((*i, situation.arrived(*i, ends)?)));
        let Some((mover, after)) = found else {
            return Err(RemovalRefusal { reason: Reason::NotFound, is_proved: false });
        };
        let actions = after.actions;
        self.note(&actions, placed);
        let (number, body) = self.free.remove(mover);
        self.seated.insert(seat, (number, body));
        for piece in self.structure.pieces_in(standing) {
            self.grip(piece, seat, placed);
        }
        Ok(())
    }

    /// The metamodule in a seat grips a piece at its goal, if it faces it.
    fn grip(&self, piece: usize, seat: usize, placed: &mut PlacedBundle) {
        let Some((number, body)) = self.seated.get(&seat) else { return };
        let is_here =
            |(hold, posture): &(Hold, u16)| (hold.foothold, *posture) == (body.foothold, body.posture);
        if let Some((hold, posture)) = self.structure.holds(piece, seat).find(is_here) {
            placed
                .actions
                .push(MoverAction { mover: *number, body_action: BodyAction::Grip { grip: hold.grip } });
            placed.peak = placed.peak.max(self.structure.pieces[piece].standing(hold, posture));
        }
    }

    /// Brings a piece from where it rests to its goal. In the end the metamodule that holds it is in one of `ends`. It
    /// stays there if that is a seat; otherwise the metamodules in seats grip the piece, and it releases it.
    fn bring(
        &mut self,
        piece: usize,
        ends: Vec<[Cell; 4]>,
        seat: Option<usize>,
        placed: &mut PlacedBundle,
    ) -> Result<(), RemovalRefusal<Reason>> {
        let task = self.task(Some(piece), Some(ends));
        let ground = self.taking.ground(piece);
        let plan = match search(ground, &task) {
            Answer::Plan(plan) => plan,
            _ => match search(ground, &Task { puts_down: true, ..task.clone() }) {
                Answer::Plan(plan) => plan,
                answer => return Err(self.refusal(piece, &answer)),
            },
        };
        placed.hand_overs += plan.hand_overs;
        placed.peak = placed.peak.max(self.peak(piece, &plan));
        self.note(&plan.actions, placed);
        self.pieces[piece].clone_from(&task.goal);
        let grips = |a: &&MoverAction| matches!(a.body_action, BodyAction::Grip { .. });
        let Some(last) = plan.actions.iter().rev().find(grips).map(|a| a.mover) else { return Ok(()) };
        let seats: Vec<usize> = self.seated.keys().copied().collect();
        seats.into_iter().for_each(|seat| self.grip(piece, seat, placed));
        if let Some(seat) = seat {
            let (number, body) = self.free.remove(last);
            self.seated.insert(seat, (number, body));
            return Ok(());
        }
        placed.actions.push(MoverAction { mover: self.free[last].0, body_action: BodyAction::LetGo });
        placed.hand_overs += 1;
        Ok(())
    }

    fn refusal(&self, piece: usize, answer: &Answer) -> RemovalRefusal<Reason> {
        match answer {
            Answer::Infeasible(reason) => RemovalRefusal {
                reason: Reason::Transport(*reason),
                is_proved: self.is_proof(piece, *reason),
            },
            _ => RemovalRefusal { reason: Reason::NotFound, is_proved: false },
        }
    }

    /// Returns true if that there is no transport is a proof for this bundle. The search knows the hand-overs of some
    /// pieces only; walks depend on where the others have been put.
    fn is_proof(&self, piece: usize, reason: TransportReason) -> bool {
        match reason {
            TransportReason::Colour => true,
            TransportReason::NoGrip | TransportReason::NoPlace | TransportReason::NoTransfer => {
                self.structure.pieces[piece].is_complete
            }
            TransportReason::NoWalk => false,
        }
    }

    /// Returns the largest torques while a piece is carried.
    fn peak(&self, piece: usize, plan: &ManipulationPlan) -> Peak {
        let of = &self.structure.pieces[piece];
        let mut postures: Vec<u16> = self.free.iter().map(|(_, body)| body.posture).collect();
        let mut holder: Option<(usize, u8)> = None;
        let mut peak = Peak::default();
        for action in &plan.actions {
            match action.body_action {
                BodyAction::Move(Motion::Turn { to, .. }) => {
                    if let Some((_, grip)) = holder.filter(|(mover, _)| *mover == action.mover) {
                        let carry = &of.scene.carry()[usize::from(grip)];
                        let step = carry.step_between(postures[action.mover], to);
                        let load = |step| of.loads[usize::from(grip)].peak(step, of.part.grams);
                        peak = peak.max(step.map(load).unwrap_or_default());
                    }
                    postures[action.mover] = to;
                }
                BodyAction::Move(Motion::Land(body)) => postures[action.mover] = body.posture,
                BodyAction::Grip { grip } => holder = Some((action.mover, grip)),
                BodyAction::LetGo => holder = holder.filter(|(mover, _)| *mover != action.mover),
            }
        }
        peak
    }
}
