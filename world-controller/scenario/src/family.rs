//! The interface between scenarios and families of modules. A scenario names its family; everything
//! particular to that family is read, checked and described through these traits. Absent: the list of
//! families, which is passed in as [`Families`].

use super::Plan;
use super::bounds::{Bounds, Passage};
use super::diagnostics::{At, Diagnostics};
use super::error::ScenarioError;
use super::faults;
use super::table::{Node, Section};
use metamorph_core::defects::Defect;
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Span;
use metamorph_kernel::director::faults::{Target, WorldFault};
use metamorph_kernel::director::operator::Level;
use metamorph_text::sources::{NoFiles, Sources};
use serde_json::Value;
use std::any::Any;
use std::fmt;
use std::sync::Arc;

/// How scenarios are read: the families that they may name, and where the files come from that they name.
#[derive(Clone, Copy)]
pub struct Families {
    /// The families; the first is the default.
    pub all: &'static [&'static dyn ScenarioFamily],
    /// Gives the files that a scenario names, those that ship with the program among them
    /// ([`WithShipped`](crate::shipped::WithShipped)).
    pub sources: &'static dyn Sources,
}

/// The name of a field of reports, and the schema of its values, which is made when it is asked for.
pub type ReportPart = (&'static str, fn() -> Value);

/// Reads and describes the scenarios of one family.
pub trait ScenarioFamily: Sync {
    /// Returns the name used in scenarios, reports and on command lines.
    fn name(&self) -> &'static str;
    /// Reads the sections whose keys depend on the family. The shared keys of `swarm`, which is `[swarm]`,
    /// have been read already; this method reads its other keys, and all of `others`.
    fn read(
        &self,
        swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> Box<dyn RawSwarm>;
    /// Returns the family's part of the JSON schema of scenarios.
    fn schema(&self) -> FamilySchema;
    /// Returns the name and the JSON schema of the report field that only this family fills; `None` if there
    /// is no such field.
    fn report_part(&self) -> Option<ReportPart> {
        None
    }
    /// Returns true if its scenarios have at least one `[[goal]]`; otherwise they have none.
    fn needs_goal(&self) -> bool {
        true
    }
    /// Returns the keys of the shared `[[fault]]` kinds that apply to it.
    fn faults(&self) -> &'static [&'static str] {
        faults::KINDS
    }
    /// Returns the text of a scenario that builds drawn cells, or why there is none; `None` if it builds no cells.
    fn scenario_of(&self, _drawing: &DrawnStructure<'_>) -> Option<Result<String, String>> {
        None
    }
    /// Returns the `[[fault]]` kinds of its own.
    fn world_faults(&self) -> &'static [WorldFaultKind] {
        &[]
    }
    /// Returns true if a scripted operator knows what helps its swarms.
    fn is_operated(&self) -> bool {
        false
    }
    /// Returns what operators can command besides faults, and not to one module.
    fn world_commands(&self) -> &'static [&'static WorldFault] {
        &[]
    }
    /// Returns all that an operator can command and that hits no module.
    fn commanded_to_world(&self) -> Vec<&'static WorldFault> {
        let faults = self.world_faults().iter().flat_map(|kind| std::iter::once(kind.begin).chain(kind.end));
        faults.chain(self.world_commands().iter().copied()).collect()
    }
}

/// A drawn structure that is to be built.
#[derive(Clone, Copy, Debug)]
pub struct DrawnStructure<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its cells, ascending; connected through faces.
    pub cells: &'a [Cell],
    /// Chains of four of its cells that cover it, each from its end in the lowest layer on; empty if there are none.
    pub standing: &'a [[Cell; 4]],
    /// Why there are none.
    pub why_not_standing: Option<&'a str>,
}

/// A `[[fault]]` kind that only some families have: it hits the world rather than a module.
#[derive(Debug)]
pub struct WorldFaultKind {
    /// The key that names what it hits.
    pub key: &'static str,
    /// Its beginning, at `at`.
    pub begin: &'static WorldFault,
    /// Its end, at `until` if that is given; `None` if it has no end.
    pub end: Option<&'static WorldFault>,
    /// Reads and checks the value of the key.
    pub target: fn(&Node<'_>, &mut Diagnostics) -> Option<Target>,
    /// Returns the schema of the table.
    pub schema: fn() -> Value,
}

/// Returns the keys of all `[[fault]]` kinds of a family.
pub fn fault_keys(family: &dyn ScenarioFamily) -> Vec<&'static str> {
    let own = family.world_faults().iter().map(|kind| kind.key);
    family.faults().iter().copied().chain(own).collect()
}

/// The sections, besides `[swarm]`, whose meaning depends on the family.
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
    /// Definitions that these refer to, by name.
    pub definitions: Vec<(&'static str, Value)>,
}

/// The family's parts of a scenario as written.
pub trait RawSwarm: fmt::Debug {
    /// Returns the time of a move (cubes) or of a step of a joint (metamodules) as written, and its key.
    fn time_step(&self) -> (&Option<At<Span>>, &'static str);
    /// Checks what needs more than one value, and creates the family's part of a plan.
    fn draft(&self, context: &DraftContext, diagnostics: &mut Diagnostics) -> Option<FamilySpec>;
    /// Checks the times that must not be after the end of the run.
    fn check_end(&self, _timeout: Span, _problems: &mut Diagnostics) {}
}

/// The properties of a run known when the family's part of a plan is created.
#[derive(Clone, Copy, Debug)]
pub struct DraftContext {
    /// The time of a move of a cube or of a step of a joint.
    pub time_step: Span,
    /// The message delay that protocols assume.
    pub usual_delay: Span,
    /// The largest difference between the controller's clock and the clock of a host.
    pub skew: Span,
    /// The effect of the link on messages.
    pub passage: Passage,
    /// The seed of the run.
    pub seed: u64,
}

/// A family's part of a plan, before the rest is checked.
pub struct FamilySpec {
    /// The swarm; `None` if something is wrong with it.
    pub swarm: Option<Swarm>,
    /// The number of modules; 0 if unknown.
    pub modules: usize,
    /// The time after its first request in which an action may start if all clocks agree; `None` if actions have no
    /// deadline.
    pub start_within: Option<Span>,
    /// The names of the goals.
    pub goals: Vec<String>,
    /// The default bounds.
    pub patience: Patience,
}

/// The default bounds of a run.
pub struct Patience {
    /// The bound for a standstill, and its ingredients.
    pub bounds: Bounds,
    /// The bound for moves without progress, as a multiple of the bound for a standstill.
    pub livelock: u64,
    /// The time-out, as a multiple of the bound for moves without progress.
    pub timeout: u64,
}

/// A family's part of a plan.
pub trait SwarmPlan: Any + fmt::Debug + Send + Sync {
    /// Returns the name of the family.
    fn family(&self) -> &'static str;
    /// Returns the name of its agents on command lines: that of the family, unless the family has several kinds.
    fn agent(&self) -> &'static str {
        self.family()
    }
    /// Returns the number of modules.
    fn modules(&self) -> usize;
    /// Returns the protocol, for tables of many runs: `forest`, `negotiated`.
    fn protocol(&self) -> String;
    /// Returns the swarm for another seed, or `None` if the seed has no effect on it.
    ///
    /// # Errors
    ///
    /// Start places that cannot be drawn.
    fn with_seed(&self, seed: u64) -> Result<Option<Swarm>, ScenarioError>;
    /// Returns the number of cells that a goal's shape has and the goal does not, since its growth leaves them out.
    fn omitted(&self, _goal: usize) -> usize {
        0
    }
    /// Returns the defect that a test has injected into the protocol, if any.
    fn defect(&self) -> Option<Defect>;
    /// Returns the swarm with another defect.
    fn with_defect(&self, defect: Option<Defect>) -> Swarm;
    /// Returns the contacts at the start, each once; `None` if the family does not know them before a run.
    fn contacts(&self) -> Option<Vec<(ModuleId, ModuleId)>> {
        None
    }
    /// Returns why a fault of the world cannot hit this target; `None` if it can.
    fn no_target(&self, _: &Target) -> Option<ScenarioError> {
        None
    }
    /// Returns true if the controller can help its swarms when they stand still.
    fn has_rescue(&self) -> bool {
        false
    }
    /// Returns the verbs of the commands that steer its modules.
    fn steering(&self) -> &'static [&'static str] {
        &[]
    }
    /// Returns false if all such commands would be refused or have no effect.
    fn heeds(&self, _: &WorldFault) -> bool {
        true
    }
    /// Returns why the level of autonomy refuses all commands with this verb; `None` if it does not.
    fn refused_at(&self, _: Level, _verb: &str) -> Option<String> {
        None
    }
    /// Writes its description for `metamorph check`.
    fn describe(&self, plan: &Plan, out: &mut String) -> fmt::Result;
    /// Returns the family's terms, for reports for people.
    fn words(&self) -> &'static Words;
}

/// The part of a plan that belongs to one family. Clones share it.
#[derive(Clone, Debug)]
pub struct Swarm(Arc<dyn SwarmPlan>);

impl Swarm {
    /// Wraps a family's swarm.
    pub fn new(plan: impl SwarmPlan) -> Swarm {
        Swarm(Arc::new(plan))
    }
    /// Returns the swarm if it has this type.
    pub fn of<S: SwarmPlan>(&self) -> Option<&S> {
        let any: &dyn Any = &*self.0;
        any.downcast_ref()
    }
    /// Returns the swarm of the family that the plan names.
    ///
    /// # Panics
    ///
    /// If the swarm has another type, which a plan of this family never has.
    pub fn own<S: SwarmPlan>(&self) -> &S {
        self.of().expect("invariant: a plan is run by the family that it names")
    }
    /// Returns the number of modules.
    pub fn len(&self) -> usize {
        self.0.modules()
    }
    /// Returns true if there are no modules; a checked swarm has some.
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

/// A family's terms, for reports for people.
#[derive(Clone, Copy, Debug)]
pub struct Words {
    /// One module.
    pub module: &'static str,
    /// Several modules.
    pub modules: &'static str,
    /// One part of a goal.
    pub cell: &'static str,
    /// One part of a goal, short.
    pub part: &'static str,
    /// Several parts of a goal.
    pub cells: &'static str,
    /// The state of a part of a goal that is reached.
    pub filled: &'static str,
    /// The mechanism that prevents collisions between modules, and the instance that refuses impossible actions; `None` if
    /// bodies do not act.
    pub collisions: Option<[&'static str; 2]>,
    /// A predicate for a spare module that makes no progress, for example `is free`.
    pub idle: &'static str,
    /// The unit of time, in the singular.
    pub time_step: &'static str,
    /// One action of a body.
    pub action: &'static str,
}

impl Families {
    /// No family, and no file.
    pub const NONE: Families = Families { all: &[], sources: &NoFiles };

    /// Returns the names of all families.
    pub fn names(&self) -> Vec<&'static str> {
        self.all.iter().map(|family| family.name()).collect()
    }
    /// Returns the family, other than `own`, for which this key is valid in this section.
    pub fn owner(&self, section: SectionKind, key: &str, own: &str) -> Option<&'static str> {
        let others = self.all.iter().filter(|family| family.name() != own);
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
        SectionKind::Fault => return fault_keys(family).contains(&key),
        SectionKind::Swarm => &schema.swarm,
        SectionKind::Goal => &schema.goal,
        SectionKind::Protocol => &schema.protocol,
        SectionKind::Shape => return schema.shapes.contains(&key),
    };
    properties["properties"].get(key).is_some()
}
