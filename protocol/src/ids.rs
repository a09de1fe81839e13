//! Names of things: small integer newtypes that cannot be mixed up.

use serde::{Deserialize, Serialize};
use std::fmt;

macro_rules! id {
    ($(#[$doc:meta])* $name:ident($int:ty)) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Default)]
        #[serde(transparent)]
        pub struct $name(pub $int);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

id!(
    /// One module (or metamodule) of the swarm, numbered from 0 in the order of the start shape.
    ModuleId(u32)
);
id!(
    /// How many times a module's process has been started; 0 is the first life.
    Incarnation(u16)
);
id!(
    /// One unbroken contact between two faces. Every new contact, and every restart of either
    /// process, gets a new one, so that a late message is never credited to the wrong contact.
    Session(u32)
);
id!(
    /// Where a link leaves a module: a face of a cube, a neighbour slot of a metamodule.
    Port(u8)
);
id!(
    /// One attempt of one module; unique per module and life.
    Token(u32)
);
id!(
    /// How many contact changes a body has seen. A body refuses an action that was decided on an
    /// older state of its contacts, which makes sensing as good as synchronous on any transport.
    Revision(u32)
);

impl ModuleId {
    /// The module's place in arrays of one entry per module.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl Port {
    /// The port's place in arrays of one entry per port.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}
