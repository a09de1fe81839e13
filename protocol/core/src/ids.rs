//! Identifiers: small integer newtypes that cannot be mixed up.

use core::fmt;
use core::hash::{Hash, Hasher};
use serde::{Deserialize, Serialize};

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

/// A set of ports, of which each is below [`PortSet::CAPACITY`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct PortSet(u128);

impl PortSet {
    /// Number of ports that a set has room for.
    pub const CAPACITY: usize = u128::BITS as usize;

    const fn bit(port: Port) -> u128 {
        1 << port.0
    }
    /// Returns true if no port is in the set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
    /// Returns true if a port is in the set.
    pub const fn contains(self, port: Port) -> bool {
        self.0 & PortSet::bit(port) != 0
    }
    /// Adds a port.
    pub const fn insert(&mut self, port: Port) {
        self.0 |= PortSet::bit(port);
    }
    /// Removes a port, if it is in the set.
    pub const fn remove(&mut self, port: Port) {
        self.0 &= !PortSet::bit(port);
    }
    /// Iterates over the ports in the set, in ascending order.
    pub fn iter(self) -> impl Iterator<Item = Port> + use<> {
        let mut left = self.0;
        core::iter::from_fn(move || {
            let port = Port(left.trailing_zeros() as u8);
            left &= left.checked_sub(1)?;
            Some(port)
        })
    }
}

impl FromIterator<Port> for PortSet {
    fn from_iter<I: IntoIterator<Item = Port>>(ports: I) -> PortSet {
        let mut set = PortSet::default();
        ports.into_iter().for_each(|port| set.insert(port));
        set
    }
}

/// The first 32 ports as one number, and the others only if there are any: the hash of a set of the first 32 ports does
/// not depend on the capacity.
impl Hash for PortSet {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        (self.0 as u32).hash(hasher);
        let others = self.0 >> 32;
        if others != 0 {
            (others as u64, (others >> 64) as u32).hash(hasher);
        }
    }
}

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
