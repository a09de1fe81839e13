//! A structure whose connections hold for the whole run, without bodies: agents are in contact and nothing moves.

use metamorph_kernel::kernel::audited::Audited;
use metamorph_kernel::world::World;
use metamorph_protocol::free_module::gait::FreeModule;
use metamorph_protocol::free_module::gait::body::{BodyPlace, BodyPose};
use metamorph_protocol::free_module::gait::message::{Docking, Follow};
use metamorph_protocol::free_module::structure::{Connection, Structure};
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_protocol::runtime::{Contact, Sensed};
use metamorph_protocol::time::Time;
use std::collections::VecDeque;

/// A structure of modules numbered from 0.
pub struct StructureWorld {
    structure: Structure,
    /// The incarnation of each module whose process has started.
    started: Vec<Option<Incarnation>>,
    /// Contact changes of each module so far.
    revisions: Vec<u32>,
    sessions: u32,
    sensed: VecDeque<(ModuleId, Sensed<BodyPose>)>,
}

impl StructureWorld {
    /// Creates the world of a structure.
    pub fn new(structure: Structure) -> StructureWorld {
        let n = structure.bound();
        StructureWorld {
            structure,
            started: vec![None; n],
            revisions: vec![0; n],
            sessions: 0,
            sensed: VecDeque::new(),
        }
    }

    /// Tells `a` about the contact with `b`, if the process of `a` has started.
    fn tell(&mut self, connection: &Connection, session: Session) {
        let Connection { a, at, b, to, .. } = *connection;
        if self.started[a.index()].is_none() {
            return;
        }
        let revision = &mut self.revisions[a.index()];
        *revision += 1;
        let contact = Contact {
            session,
            peer: b,
            peer_incarnation: self.started[b.index()].unwrap_or_default(),
            peer_port: Port(to as u8),
        };
        let revision = Revision(*revision);
        self.sensed
            .push_back((a, Sensed::Contact { port: Port(at as u8), revision, contact: Some(contact) }));
    }

    /// Returns the structure.
    pub fn structure(&self) -> &Structure {
        &self.structure
    }
}

impl World for StructureWorld {
    type Agent = FreeModule;

    fn len(&self) -> usize {
        self.structure.bound()
    }
    fn place(&self, id: ModuleId) -> BodyPlace {
        BodyPlace { docking: Docking::of(&self.structure, id), pose: BodyPose::default() }
    }
    fn start(&mut self, _now: Time, id: ModuleId, incarnation: Incarnation) {
        self.started[id.index()] = Some(incarnation);
        for connection in self.structure.connections().to_vec() {
            if connection.a == id || connection.b == id {
                self.sessions += 1;
                let session = Session(self.sessions);
                self.tell(&connection, session);
                self.tell(&connection.reversed(), session);
            }
        }
    }
    fn act(&mut self, _now: Time, _id: ModuleId, _sensed: Revision, _action: &Follow) {}
    fn next_event(&self) -> Time {
        Time::NEVER
    }
    fn advance(&mut self, _now: Time) {}
    fn poll(&mut self) -> Option<(ModuleId, Sensed<BodyPose>)> {
        self.sensed.pop_front()
    }
}

impl Audited for StructureWorld {}
