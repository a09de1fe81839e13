//! Identifiers: small integer newtypes that cannot be mixed up.

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
    /// How often the process of a module has been restarted; 0 for the first incarnation.
    Incarnation(u16)
);
id!(
    /// One unbroken contact between two ports. Every new contact, and every restart of either process, gets a
    /// new one, so that a late message is never credited to the wrong contact.
    Session(u32)
);
id!(
    /// The port that a link leaves a module by: a face of a cube, a neighbour slot of a metamodule.
    Port(u8)
);
id!(
    /// One attempt of one module; unique per module and incarnation.
    Token(u32)
);
id!(
    /// The number of contact changes that a body has seen. An action carries the revision that it was decided on, and
    /// the body refuses it if its contacts have changed since. So on any transport an agent acts on present contacts.
    Revision(u32)
);

/// One of the hosts that a swarm runs on, numbered from 0 and called `h1`, `h2` and so on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Default)]
#[serde(transparent)]
pub struct HostId(pub u16);

impl HostId {
    /// The host of the world-controller.
    pub const CONTROLLER: HostId = HostId(0);

    /// Returns the index of the host in arrays of one entry per host.
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// Returns the host with this name, if it is of the form `h1`.
    pub fn from_name(name: &str) -> Option<HostId> {
        let number: u16 = name.strip_prefix('h').filter(|n| !n.starts_with(['0', '+']))?.parse().ok()?;
        Some(HostId(number - 1))
    }
}

impl fmt::Display for HostId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "h{}", u32::from(self.0) + 1)
    }
}

impl ModuleId {
    /// Returns the index of the module in arrays of one entry per module.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl Port {
    /// Returns the index of the port in arrays of one entry per port.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}
