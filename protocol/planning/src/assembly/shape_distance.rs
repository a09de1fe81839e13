//! The shape distance: the cost from a shape to a goal shape in the graph of shapes, as a table.

use super::shape::Shape;
use super::shape_graph::{Prices, ShapeGraph};
use crate::plan::table::{Id, NO_PARENT, Table};
use crate::plan::{Cost, MAX_COST, Space};
use std::collections::BTreeMap;

/// Distances to one goal shape. With few modules the table has every shape; otherwise only the shapes nearest to
/// the goal.
#[derive(Debug)]
pub struct ShapeDistance {
    table: Table,
    /// A lower bound of the distance of shapes that are not in the table; `None` if these cannot reach the goal.
    beyond: Option<Cost>,
}

impl ShapeDistance {
    /// Computes the distances to a goal, of at most about `most` shapes.
    pub fn to(goal: &Shape, prices: Prices, most: usize) -> ShapeDistance {
        // From the goal edges run backwards: an attachment towards it is a detachment from here.
        let backward = Prices { attach: prices.detach, detach: prices.attach, turn: prices.turn };
        let graph = ShapeGraph { modules: goal.len(), prices: backward };
        let mut table = Table::new(graph.key_width());
        let mut key = vec![0; graph.key_width()];
        goal.key(&mut key);
        table.insert(&key, usize::MAX, || (0, 0, NO_PARENT));
        let mut open: BTreeMap<Cost, Vec<Id>> = BTreeMap::from([(0, vec![0])]);
        let mut beyond = None;
        while let Some(mut level) = open.first_entry() {
            let cost = *level.key();
            let Some(id) = level.get_mut().pop() else {
                level.remove();
                continue;
            };
            if table.is_expanded(id) || table.cost(id) != cost {
                continue;
            }
            if table.len() >= most || cost + backward.turn.max(backward.attach) > MAX_COST {
                beyond = Some(cost + prices.least());
                break;
            }
            table.set_expanded(id);
            let shape = graph.state(table.key(id));
            graph.expand(&shape, &mut |_, step, next| {
                next.key(&mut key);
                let (to, new) = table.insert(&key, usize::MAX, || (cost + step, 0, id));
                if !new && cost + step >= table.cost(to) {
                    return;
                }
                table.improve(to, cost + step, id);
                open.entry(cost + step).or_default().push(to);
            });
        }
        ShapeDistance { table, beyond }
    }

    /// Returns a lower bound of the cost from a shape to the goal; `None` if the goal cannot be reached.
    pub fn of(&self, shape: &Shape) -> Option<Cost> {
        let mut key = [0; Shape::key_width(super::configuration::MAX_MODULES)];
        let key = &mut key[..Shape::key_width(shape.len())];
        shape.key(key);
        match self.table.find(key) {
            Some(id) => {
                let cost = self.table.cost(id);
                Some(self.beyond.map_or(cost, |beyond| cost.min(beyond)))
            }
            None => self.beyond,
        }
    }
    /// Returns true if the distance of a shape is in the table and exact.
    pub fn knows(&self, shape: &Shape) -> bool {
        self.table
            .find(&shape.canonical())
            .is_some_and(|id| self.beyond.is_none_or(|b| self.table.cost(id) <= b))
    }
    /// Returns the number of shapes in the table.
    pub fn len(&self) -> usize {
        self.table.len()
    }
    /// Returns true if there is no shape.
    pub fn is_empty(&self) -> bool {
        self.table.is_empty()
    }
    /// Returns true if every shape that can reach the goal is in the table.
    pub fn is_complete(&self) -> bool {
        self.beyond.is_none()
    }
    /// Returns the bytes of the table.
    pub fn bytes(&self) -> usize {
        self.table.bytes()
    }
}
