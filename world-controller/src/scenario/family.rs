//! What reading and planning need of a family of units. A scenario names its family; everything that only
//! that family has is read, checked and described through these traits. Absent: which families there
//! are, which is handed in as [`Families`].

use super::Plan;
use super::bounds::{Bounds, Passage};
use super::flaw::Flaw;
use super::problems::{At, Problems};
use super::table::{Node, Section};
use metamorph_protocol::defects::Sabotage;
use metamorph_protocol::time::Span;
use serde_json::Value;
use std::any::Any;
use std::fmt;
use std::sync::Arc;

/// The families that a scenario may name; the first is the default.
#[derive(Clone, Copy)]
pub struct Families(pub &'static [&'static dyn ScenarioFamily]);

/// How scenarios of one family are read and described.
pub trait ScenarioFamily: Sync {
    /// The name used in scenarios, reports and on command lines.
    fn name(&self) -> &'static str;
    /// Reads what belongs to the family. `swarm` is `[swarm]`, begun; it and the others are finished here.
    fn read(
        &self,
        swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        problems: &mut Problems,
    ) -> Box<dyn RawSwarm>;
    /// The family's part of the JSON schema of scenarios.
    fn schema(&self) -> FamilySchema;
    /// The kinds of `[[fault]]` that its bodies can suffer, by their keys.
    fn faults(&self) -> &'static [&'static str];
}

/// The sections, besides `[swarm]`, that mean something else in each family.
pub struct Sections<'d, 'i> {
    /// All `[[goal]]` tables.
    pub goals: Option<&'d Node<'i>>,
    /// `[protocol]`.
    pub protocol: Option<&'d Node<'i>>,
}

/// A family's part of the JSON schema.
pub struct FamilySchema {
    /// `[swarm]`.
    pub swarm: Value,
    /// One `[[goal]]`.
    pub goal: Value,
    /// `[protocol]`.
    pub protocol: Value,
    /// The keys of the shape of a goal.
    pub shapes: &'static [&'static str],
    /// What these refer to, by name.
    pub definitions: Vec<(&'static str, Value)>,
}

/// The family's parts of a scenario, as written.
pub trait RawSwarm: fmt::Debug {
    /// The shortest time in which something can be seen to happen, as written, and its key.
    fn time_step(&self) -> (&Option<At<Span>>, &'static str);
    /// Checks everything that needs more than one value, and makes the family's part of a plan.
    fn draft(&self, context: &DraftContext, problems: &mut Problems) -> Option<Draft>;
    /// Checks the times that must not lie beyond the end of the run.
    fn check_end(&self, _timeout: Span, _problems: &mut Problems) {}
}

/// What is known of a run when the family's part of a plan is made.
#[derive(Clone, Copy, Debug)]
pub struct DraftContext {
    /// How long a move of a cube or a step of a joint takes.
    pub time_step: Span,
    /// The delay of messages that protocols reckon with.
    pub usual_delay: Span,
    /// What the link does to messages.
    pub passage: Passage,
    /// The seed of the run.
    pub seed: u64,
}

/// A family's part of a plan, before the rest is checked.
pub struct Draft {
    /// What runs; none if something is wrong with it.
    pub swarm: Option<Swarm>,
    /// How many modules there are; none if that is not known.
    pub modules: usize,
    /// What the goals are called.
    pub goals: Vec<String>,
    /// How long to wait if the scenario does not say.
    pub patience: Patience,
}

/// How long to wait if the scenario does not say.
pub struct Patience {
    /// The bound for standing still, and what it is made of.
    pub bounds: Bounds,
    /// The bound for moving without progress, in bounds for standing still.
    pub livelock: u64,
    /// The latest end, in bounds for moving without progress.
    pub timeout: u64,
}

/// A family's part of a plan: what runs.
pub trait SwarmPlan: Any + fmt::Debug + Send + Sync {
    /// The name of the family.
    fn family(&self) -> &'static str;
    /// The number of modules.
    fn modules(&self) -> usize;
    /// How modules decide, for tables of many runs: `forest`, `negotiated`.
    fn protocol(&self) -> String;
    /// The same with what another seed decides; none if the seed decides nothing here.
    ///
    /// # Errors
    /// The places at the start cannot be drawn.
    fn with_seed(&self, seed: u64) -> Result<Option<Swarm>, Flaw>;
    /// The defect that a test has switched on.
    fn defect(&self) -> Option<Sabotage>;
    /// The same with another defect.
    fn with_defect(&self, defect: Option<Sabotage>) -> Swarm;
    /// Writes what `metamorph check` says of it.
    fn describe(&self, plan: &Plan, out: &mut String) -> fmt::Result;
    /// What reports for people call things.
    fn words(&self) -> &'static Words;
}

/// The part of a plan that belongs to one family. Clones share it.
#[derive(Clone, Debug)]
pub struct Swarm(Arc<dyn SwarmPlan>);

impl Swarm {
    /// The swarm of a family.
    pub fn new(plan: impl SwarmPlan) -> Swarm {
        Swarm(Arc::new(plan))
    }
    /// The swarm, if it is of the family with this type.
    pub fn of<S: SwarmPlan>(&self) -> Option<&S> {
        let any: &dyn Any = &*self.0;
        any.downcast_ref()
    }
    /// How many modules, or metamodules, it has.
    pub fn len(&self) -> usize {
        self.0.modules()
    }
    /// Whether it has none, which no checked one has.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl std::ops::Deref for Swarm {
    type Target = dyn SwarmPlan;

    fn deref(&self) -> &(dyn SwarmPlan + 'static) {
        &*self.0
    }
}

/// What a family calls things, in reports for people.
#[derive(Clone, Copy, Debug)]
pub struct Words {
    /// One of those that move.
    pub module: &'static str,
    /// All of them.
    pub modules: &'static str,
    /// A part of a goal.
    pub cell: &'static str,
    /// The same, for short.
    pub part: &'static str,
    /// Its parts.
    pub cells: &'static str,
    /// What keeps modules out of each other's way.
    pub negotiation: &'static str,
    /// What does if that does not.
    pub body: &'static str,
    /// How one that does nothing is called, if it is needed.
    pub idle: &'static str,
    /// What time is counted in, in the singular.
    pub time_step: &'static str,
    /// What one thing that a body does is called.
    pub action: &'static str,
}

impl Families {
    /// The family of this name.
    pub fn named(&self, name: &str) -> Option<&'static dyn ScenarioFamily> {
        self.0.iter().copied().find(|family| family.name() == name)
    }
    /// The names of all.
    pub fn names(&self) -> Vec<&'static str> {
        self.0.iter().map(|family| family.name()).collect()
    }
    /// The family, other than `own`, in whose scenarios this key means something in this section.
    pub fn owner(&self, section: SectionKind, key: &str, own: &str) -> Option<&'static str> {
        let others = self.0.iter().filter(|family| family.name() != own);
        others.filter(|family| has_key(**family, section, key)).map(|family| family.name()).next()
    }
}

impl PartialEq for Families {
    fn eq(&self, other: &Families) -> bool {
        self.names() == other.names()
    }
}

impl Eq for Families {}

impl fmt::Debug for Families {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.names()).finish()
    }
}

/// A section whose keys differ between families.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SectionKind {
    /// `[swarm]`.
    Swarm,
    /// `[[goal]]`.
    Goal,
    /// `[protocol]`.
    Protocol,
    /// `shape` of a goal, or of a start.
    Shape,
    /// `[[fault]]`.
    Fault,
}

fn has_key(family: &dyn ScenarioFamily, section: SectionKind, key: &str) -> bool {
    let schema = family.schema();
    let properties = match section {
        SectionKind::Fault => return family.faults().contains(&key),
        SectionKind::Swarm => &schema.swarm,
        SectionKind::Goal => &schema.goal,
        SectionKind::Protocol => &schema.protocol,
        SectionKind::Shape => return schema.shapes.contains(&key),
    };
    properties["properties"].get(key).is_some()
}
