//! Builds a scene from the records of a run, whether it is in progress or in a journal.
//!
//! Of running processes only the controller's records are available; messages between agents are in the
//! agents' parts of the journal.

use crate::visible::{Bodies, Visible};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::{self, Blob, Consumed, Outside, Record, Sink, Who};
use metamorph_protocol::runtime::{Command, Sensed};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::WireError;
use metamorph_scene::parts::Part;
use metamorph_scene::scene::{Event, Scene};
use metamorph_scene::shared::Shared;

/// Builds a scene of one family.
pub struct SceneBuilder<A: Visible> {
    /// The bodies, at their current places.
    pub bodies: Bodies<A>,
    /// The scene to fill.
    pub scene: Shared,
}

impl<A: Visible> SceneBuilder<A> {
    fn place(
        bodies: &mut Bodies<A>,
        scene: &mut Scene,
        (at, id): (Time, ModuleId),
        place: &Blob,
    ) -> Result<(), WireError> {
        scene.lay_out(at, A::elements(&bodies.setup));
        if let Some(known) = bodies.places.get_mut(id.index()) {
            *known = place.read()?;
            scene.placed(id, A::at_rest(&bodies.setup, known).first().map(Part::cell));
            scene.carried(at, id, A::held(&bodies.setup, known));
        }
        Ok(())
    }

    fn write(&mut self, at: Time, who: Who, event: &record::Event) -> Result<(), WireError> {
        use record::Event as E;
        let mut scene = self.scene.lock();
        // Agents of a process run may be slightly ahead of the controller's records.
        let at = scene.reach(at);
        let own = match who {
            Who::Agent(id, _) => Some(id),
            Who::Controller => None,
        };
        match event {
            E::Start { id, place, .. } => {
                Self::place(&mut self.bodies, &mut scene, (at, *id), place)?;
            }
            E::Advance { ended } => {
                for (id, place) in ended {
                    Self::place(&mut self.bodies, &mut scene, (at, *id), place)?;
                }
            }
            E::Act { id, action, .. } => {
                let action: A::Action = action.read()?;
                let Bodies { setup, places, .. } = &self.bodies;
                let begun = places.get(id.index()).and_then(|place| A::motion(setup, place, &action));
                scene.asked(at, *id, begun.map(|(motion, to)| (motion, A::whereabouts(&to))));
            }
            E::Sensed { id, sensed: Sensed::Percept(percept) } => {
                let percept: A::Percept = percept.read()?;
                let Bodies { setup, places, .. } = &self.bodies;
                match places.get(id.index()).and_then(|place| A::carried(setup, place, &percept)) {
                    Some((motion, to)) => scene.asked(at, *id, Some((motion, A::whereabouts(&to)))),
                    None => scene.went(at, *id, A::fate(&percept)),
                }
            }
            E::Report { id, report } => scene.tells(at, *id, A::standing(&report.read()?)),
            E::Started { id } if at > Time::ZERO => scene.note(at, Event::Started(*id)),
            E::Died { id } => scene.died(at, *id),
            E::Command(Command::Pause(id)) => scene.note(at, Event::Paused(*id)),
            E::Command(Command::Resume(id)) => scene.note(at, Event::Resumed(*id)),
            E::External { id, what: Outside::Stopped { .. } } => scene.note(at, Event::Paused(*id)),
            E::External { id, what: Outside::Continued } => scene.note(at, Event::Resumed(*id)),
            E::Command(Command::Order(_, order)) => {
                if let Some(goal) = A::goal(&order.read()?) {
                    scene.goal(at, goal);
                }
            }
            E::Injected { fault, module, cell, by, effect } => {
                let effect = if by.starts_with("operator") { &format!("{by}; {effect}") } else { effect };
                scene.struck(at, *module, *cell, fault, effect);
            }
            E::Step(step) => {
                if let (Some(id), Consumed::Message { class, name, message, .. }) = (own, &step.input) {
                    let said = A::said(&self.bodies.setup, &message.read()?);
                    scene.flow().delivered(at, name.from, id, *class, said);
                }
            }
            E::State(summary) => {
                if let Some(id) = own {
                    scene.flow().state(at, id, A::moves(summary.gradient), summary.lock);
                }
            }
            E::Torn | E::Resumed => {
                scene.trouble(format!("from {at} on, the records of {who} are incomplete"))
            }
            E::Ended { outcome, .. } => scene.ended(outcome),
            _ => {}
        }
        Ok(())
    }
}

impl<A: Visible> Sink for SceneBuilder<A> {
    fn put(&mut self, record: &Record) {
        if let Err(error) = self.write(record.at, record.who, &record.event) {
            let what = format!("a record of {} at {} cannot be decoded: {error}", record.who, record.at);
            self.scene.lock().trouble(what);
        }
    }
    fn commit(&mut self) {}
}
