//! Releases the shared memory that a dead process held: its slots in the channels of live processes, and its
//! files.
//!
//! iceoryx2 can do this by itself, but for each port of the dead process it lists all shared memory of the
//! machine several times, and it visits every process whose bell the dead one rang: half a second of work for
//! each death in a swarm of 1,000. Here the same code of iceoryx2 runs with a service whose connections are
//! local to this process, where there are none; the files are found by one listing for many deaths.
//!
//! Not here: slots at the controller's bell. To free one, iceoryx2 visits every process that has a bell, so
//! the controller's bell has enough slots for all deaths of a run instead
//! ([`crate::transport::iceoryx::rendezvous`]).

use crate::run_dir::run_name::{HOME, RunName, RunNameError};
use crate::transport::iceoryx::rendezvous::{self, is_controller_bell};
use crate::transport::iceoryx::service::Svc;
use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::prelude::{Config, ServiceName, ZeroCopySend, local};
use iceoryx2::service::Service;
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::service::messaging_pattern::MessagingPattern;
use iceoryx2::service::service_hash::ServiceHash;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use std::collections::BTreeSet;
use std::fmt::Debug;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The service [`Svc`], but with connections local to this process, so that iceoryx2 finds none to remove.
#[derive(Clone, Debug)]
struct DetachedService;

impl ServiceInternal<DetachedService> for DetachedService {}

impl Service for DetachedService {
    type StaticStorage = <Svc as Service>::StaticStorage;
    type ConfigSerializer = <Svc as Service>::ConfigSerializer;
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        <Svc as Service>::PersistentDynamicStorage<T>;
    type Bag = <Svc as Service>::Bag;
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        <Svc as Service>::DynamicStorage<T>;
    type ServiceNameHasher = <Svc as Service>::ServiceNameHasher;
    type SharedMemory = <local::Service as Service>::SharedMemory;
    type ResizableSharedMemory = <local::Service as Service>::ResizableSharedMemory;
    type Connection = <local::Service as Service>::Connection;
    type Event = <Svc as Service>::Event;
    type Monitoring = <Svc as Service>::Monitoring;
    type Reactor = <Svc as Service>::Reactor;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> = <Svc as Service>::ArcThreadSafetyPolicy<T>;
    type BlackboardMgmt<T: Send + Sync + Debug + ZeroCopySend + 'static> =
        <Svc as Service>::BlackboardMgmt<T>;
    type BlackboardPayload = <Svc as Service>::BlackboardPayload;
    type UniqueId = <Svc as Service>::UniqueId;
}

/// Reaps the dead processes of one run.
#[derive(Debug)]
pub struct NodeReaper {
    root: PathBuf,
    prefix: String,
    config: Config,
    /// Ports of dead processes whose files have not been removed yet.
    ports: BTreeSet<String>,
}

impl NodeReaper {
    /// Creates the reaper of the run in `root`.
    ///
    /// # Errors
    /// If `root` is not the directory of a run.
    pub fn of(root: &Path) -> Result<NodeReaper, RunNameError> {
        let run = RunName::of_root(root)?;
        let config = rendezvous::config(&run);
        Ok(NodeReaper { root: root.to_owned(), prefix: run.prefix(), config, ports: BTreeSet::new() })
    }

    /// Frees the channel slots of a dead member of the run. The caller makes sure that it is dead.
    ///
    /// # Errors
    /// If its files cannot be read or removed.
    pub fn reap(&mut self, member: u128) -> io::Result<()> {
        let node: UniqueNodeId = bincode::serde::decode_from_slice(
            &member.to_le_bytes(),
            bincode::config::standard().with_fixed_int_encoding(),
        )
        .map_err(io::Error::other)?
        .0;
        let nodes = self.root.join("nodes");
        let own = nodes.join(member.to_string());
        for entry in fs::read_dir(&own)? {
            let name = entry?.file_name();
            let Some(tag) = name.to_str().and_then(|n| n.strip_prefix(&self.prefix)) else { continue };
            if let Some(port) = tag.strip_suffix(".port_tag") {
                self.ports.insert(port.to_owned());
            } else if let Some(hash) = tag.strip_suffix(".service_tag")
                && let Some(channel) = self.channel(hash)
                && let Err(e) =
                    DetachedService::__internal_remove_node_from_service(&node, &channel, &self.config)
            {
                tracing::debug!("a slot of a dead process could not be given back: {e:?}");
            }
        }
        fs::remove_dir_all(&own)?;
        for end in ["node_monitor", "node_monitor_context", "node_monitor_owner_lock"] {
            gone(fs::remove_file(nodes.join(format!("{}{member}.{end}", self.prefix))))?;
        }
        Ok(())
    }

    /// Returns the channel with this hash, unless it is the controller's bell.
    fn channel(&self, hash: &str) -> Option<ServiceHash> {
        let path = self.root.join("services").join(format!("{}{hash}.service", self.prefix));
        let text = fs::read_to_string(path).ok()?;
        let name = text.lines().find_map(|l| l.strip_prefix("service_name = \"")?.strip_suffix('"'))?;
        if is_controller_bell(name) {
            return None;
        }
        let pattern = if text.contains("[messaging_pattern.PublishSubscribe]") {
            MessagingPattern::PublishSubscribe
        } else {
            MessagingPattern::Event
        };
        let name = ServiceName::new(name).ok()?;
        Some(ServiceHash::new::<<Svc as Service>::ServiceNameHasher>(&name, pattern))
    }

    /// Returns the number of ports whose files wait for [`NodeReaper::clear`].
    pub fn waiting(&self) -> usize {
        self.ports.len()
    }

    /// Removes the files of all members reaped since the last call. A process that has one open keeps it.
    ///
    /// # Errors
    /// If the files cannot be listed or removed.
    pub fn clear(&mut self) -> io::Result<()> {
        for home in [Path::new(HOME), &self.root] {
            for entry in fs::read_dir(home)? {
                let name = entry?.file_name();
                let Some(file) = name.to_str().and_then(|n| n.strip_prefix(&self.prefix)) else { continue };
                if file.split(['_', '.']).any(|part| self.ports.contains(part)) {
                    gone(fs::remove_file(home.join(&name)))?;
                }
            }
        }
        self.ports.clear();
        Ok(())
    }
}

/// Treats the removal of a missing file as a success.
fn gone(removed: io::Result<()>) -> io::Result<()> {
    removed.or_else(|e| if e.kind() == io::ErrorKind::NotFound { Ok(()) } else { Err(e) })
}
