//! Elements that are dropped: a latch opens by itself, and the element falls straight down to the first support.

use super::{ActionInProgress, MetamoduleWorld};
use crate::connections::ActionEnd;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::manipulation::colour::colour;
use metamorph_protocol::metamodule::message::{BodyAction, Percept};
use metamorph_protocol::metamodule::pose::{Load, Pose};

/// Fate of an element whose latches opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Drop {
    /// Nobody held it, or there is no such element.
    NotHeld,
    /// It fell from the hands of these.
    Fell {
        /// The metamodules that held it.
        from: Vec<ModuleId>,
        /// How many cells it fell.
        cells: i16,
        /// The metamodule that it fell on; `None` on the floor or another element.
        on: Option<ModuleId>,
    },
}

impl MetamoduleWorld {
    /// Opens all latches on an element, which falls down. Those who are gripping it fail.
    pub fn drop_element(&mut self, element: usize) -> Drop {
        let from: Vec<ModuleId> = self.holders(element).collect();
        if from.is_empty() {
            return Drop::NotHeld;
        }
        for id in &from {
            let body = &mut self.bodies[id.index()];
            body.pose.load = Load::NONE;
            match &mut body.under_way {
                // It continues without the element, through the same cells.
                Some(under_way) => under_way.to.load = Load::NONE,
                None => {
                    let pose: Pose = body.pose;
                    self.queue.perceive(*id, Percept::Done(pose));
                }
            }
        }
        let elements = &self.setup.elements;
        for body in &mut self.bodies {
            if let Some(ActionInProgress { body_action: BodyAction::Grip(load), end, .. }) =
                &mut body.under_way
                && *end == ActionEnd::Done
                && elements.of(*load) == Some(element)
            {
                *end = ActionEnd::Failed;
            }
        }
        self.elements[element].fallen = true;
        self.action_counts.drops += 1;
        let (cells, on) = self.fall(element);
        self.action_counts.drops_on_bodies += u64::from(on.is_some());
        Drop::Fell { from, cells, on }
    }

    /// Lets elements that have fallen on a body fall on, if it has gone.
    pub(super) fn fall_on(&mut self) {
        for element in 0..self.elements.len() {
            if self.elements[element].fallen {
                self.fall(element);
            }
        }
    }

    /// Lets an element fall straight down, to what is below it. Returns how far, and the body that it lies on.
    fn fall(&mut self, element: usize) -> (i16, Option<ModuleId>) {
        let mut fallen = 0;
        loop {
            let cells = &self.elements[element].cells;
            let down: Vec<Cell> = cells.iter().map(|c| Cell::new(c.x, c.y, c.z - 1)).collect();
            let is_in = |taken: &[Cell]| down.iter().any(|c| taken.contains(c));
            let others = self.elements.iter().enumerate().filter(|(e, _)| *e != element);
            let mut others = others.map(|(_, other)| other.cells.as_slice());
            let floor = down.iter().any(|c| c.z < 0 || self.obstacles.contains(c)) || others.any(is_in);
            let on = self.bodies.iter().position(|body| is_in(body.taken()));
            if floor || on.is_some() {
                return (fallen, on.filter(|_| !floor).map(|i| ModuleId(i as u32)));
            }
            self.elements[element].set(down, &self.setup);
            self.elements[element].odd = odd(&self.elements[element].cells);
            fallen += 1;
        }
    }
}

/// Returns the number of cells of odd colour.
pub(super) fn odd(cells: &[Cell]) -> usize {
    cells.iter().filter(|c| colour(**c) == 1).count()
}
