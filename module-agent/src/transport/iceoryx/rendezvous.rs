//! The rendezvous of the processes of a run: the iceoryx2 configuration, and the names and quality of service
//! of all channels. Names carry the incarnation, so that a restarted agent need not wait until the remains of
//! its killed predecessor are cleared away.
//!
//! Not here: the global iceoryx2 configuration, and iceoryx2's own cleaning up after dead processes, whose
//! cost grows with the square of the swarm's size. The files of a run are removed by name when it ends.

use crate::run_dir::run_name::{RunName, RunNameError};
use crate::transport::iceoryx::service::Svc;
use crate::transport::iceoryx::space;
use crate::transport::shared_frame::SharedFrame;
use crate::transport::{EGRESS_DEPTH, INBOX_DEPTH, INBOX_SPARE, REPORTS_DEPTH, SpaceShortage};
use iceoryx2::port::backpressure_strategy::BackpressureStrategy;
use iceoryx2::port::{
    DegradationAction, DegradationCause, DegradationInfo, listener, notifier, publisher, subscriber,
};
use iceoryx2::prelude::{
    Config, FileName, Node, NodeBuilder, Path as IoxPath, SemanticString, ServiceName, SignalHandlingMode,
};
use iceoryx2::service::builder::{event, publish_subscribe};
use iceoryx2::service::port_factory;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use std::path::Path;
use std::time::Duration;
use thiserror::Error;

/// The sending end of a channel of frames.
pub type Publisher = publisher::Publisher<Svc, SharedFrame, ()>;
/// The receiving end of a channel of frames.
pub type Subscriber = subscriber::Subscriber<Svc, SharedFrame, ()>;
/// The waking end of a wake-up channel.
pub type Notifier = notifier::Notifier<Svc>;
/// The waiting end of a wake-up channel.
pub type Listener = listener::Listener<Svc>;
/// A channel of frames.
pub type Frames = port_factory::publish_subscribe::PortFactory<Svc, SharedFrame, ()>;
/// A wake-up channel.
pub type Wakes = port_factory::event::PortFactory<Svc>;

/// Number of spare slots at the controller's bell, one for each agent that dies: its slot is not freed.
const CONTROLLER_RINGERS: usize = 20_000;
/// Number of agents that share a channel to the controller; the cost of joining grows with it.
pub const SHARD: u32 = 1_000;
/// Shared memory that a member needs to join and to create its channels, in bytes.
const JOINING: u64 = 64 << 10;
/// The longest time to wait for another process to finish creating a service; long, for loaded machines.
const CREATION_TIMEOUT: Duration = Duration::from_secs(30);

/// Errors of creating and opening a channel.
#[derive(Debug, Error)]
pub enum ChannelError {
    /// The directory is not that of a run.
    #[error(transparent)]
    Run(#[from] RunNameError),
    /// Too little shared memory is free.
    #[error(transparent)]
    OutOfSpace(#[from] SpaceShortage),
    /// The node of this process cannot be created.
    #[error("cannot join the run in shared memory: {0:?}; is {home} writable and not full?", home = crate::run_dir::run_name::HOME)]
    Node(iceoryx2::node::NodeCreationFailure),
    /// A channel of frames cannot be created.
    #[error("cannot create the channel `{name}`: {cause:?}")]
    CreateFrames {
        /// The channel.
        name: String,
        /// The error of iceoryx2.
        cause: publish_subscribe::PublishSubscribeCreateError,
    },
    /// A channel of frames cannot be opened.
    #[error("cannot open the channel `{name}`: {cause:?}")]
    OpenFrames {
        /// The channel.
        name: String,
        /// The error of iceoryx2.
        cause: publish_subscribe::PublishSubscribeOpenError,
    },
    /// A wake-up channel cannot be created.
    #[error("cannot create the wake-up channel `{name}`: {cause:?}")]
    CreateWakes {
        /// The channel.
        name: String,
        /// The error of iceoryx2.
        cause: event::EventCreateError,
    },
    /// A wake-up channel cannot be opened.
    #[error("cannot open the wake-up channel `{name}`: {cause:?}")]
    OpenWakes {
        /// The channel.
        name: String,
        /// The error of iceoryx2.
        cause: event::EventOpenError,
    },
    /// An end of a channel cannot be created, for example because all its slots are taken.
    #[error("cannot attach to the channel `{name}`: {cause}")]
    Attach {
        /// The channel.
        name: String,
        /// The error of iceoryx2.
        cause: String,
    },
}

impl ChannelError {
    /// True if the channel does not exist, or no longer does.
    pub fn is_absent(&self) -> bool {
        use event::EventOpenError as E;
        use publish_subscribe::PublishSubscribeOpenError as P;
        matches!(
            self,
            ChannelError::OpenFrames { cause: P::DoesNotExist | P::IsMarkedForDestruction, .. }
                | ChannelError::OpenWakes { cause: E::DoesNotExist | E::IsMarkedForDestruction, .. }
        )
    }

    /// True if all slots of the channel are taken.
    pub fn is_full(&self) -> bool {
        matches!(self, ChannelError::Attach { cause, .. } if cause.contains("ExceedsMaxSupported"))
    }

    pub(crate) fn attach(name: &str, cause: impl std::fmt::Debug) -> ChannelError {
        ChannelError::Attach { name: name.to_owned(), cause: format!("{cause:?}") }
    }
}

/// Returns the configuration of iceoryx2 for a run.
pub fn config(run: &RunName) -> Config {
    let mut config = Config::default();
    let root = run.root();
    // Invariant: a run's name is twelve lower-case letters and digits, a valid path and file name.
    #[allow(clippy::unwrap_used, reason = "see the invariant above")]
    {
        config.global.set_root_path(&IoxPath::new(root.as_os_str().as_encoded_bytes()).unwrap());
        config.global.prefix = FileName::new(run.prefix().as_bytes()).unwrap();
    }
    config.global.creation_timeout = CREATION_TIMEOUT;
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    config.global.service.cleanup_dead_nodes_on_open = false;
    config.defaults.publish_subscribe.subscriber_expired_connection_buffer = 8;
    config
}

/// One process's membership of a run. Not `Send`: it stays with its thread.
#[derive(Debug)]
pub struct Rendezvous {
    node: Node<Svc>,
}

impl Rendezvous {
    /// Joins the run whose directory is `root`.
    ///
    /// # Errors
    /// If `root` is not the directory of a run, memory is short, or the node cannot be created.
    pub fn join(root: &Path) -> Result<Rendezvous, ChannelError> {
        let run = RunName::of_root(root)?;
        space::require(JOINING)?;
        let node = NodeBuilder::new()
            .config(&config(&run))
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Svc>()
            .map_err(ChannelError::Node)?;
        Ok(Rendezvous { node })
    }

    /// Returns the number of this membership, by which it is reaped.
    pub fn member(&self) -> u128 {
        self.node.id().value()
    }

    /// Creates the channel of frames to one agent that has up to `neighbours` neighbours at a time.
    ///
    /// # Errors
    /// If memory is short, or the channel cannot be created.
    pub fn create_inbox(
        &self,
        id: ModuleId,
        incarnation: Incarnation,
        neighbours: usize,
    ) -> Result<Frames, ChannelError> {
        self.create_frames(&inbox(id, incarnation), neighbours + INBOX_SPARE, INBOX_DEPTH)
    }
    /// Opens the channel of frames to one agent.
    ///
    /// # Errors
    /// If the channel is absent or cannot be opened.
    pub fn open_inbox(&self, id: ModuleId, incarnation: Incarnation) -> Result<Frames, ChannelError> {
        self.open_frames(&inbox(id, incarnation))
    }
    /// Creates the wake-up channel of one agent that has up to `neighbours` neighbours at a time.
    ///
    /// # Errors
    /// If the channel cannot be created.
    pub fn create_bell(
        &self,
        id: ModuleId,
        incarnation: Incarnation,
        neighbours: usize,
    ) -> Result<Wakes, ChannelError> {
        self.create_wakes(&bell(id, incarnation), neighbours + INBOX_SPARE)
    }
    /// Opens the wake-up channel of one agent.
    ///
    /// # Errors
    /// If the channel is absent or cannot be opened.
    pub fn open_bell(&self, id: ModuleId, incarnation: Incarnation) -> Result<Wakes, ChannelError> {
        self.open_wakes(&bell(id, incarnation))
    }
    /// Creates the channel of one shard of agents to the controller of this generation, for `senders` agents
    /// at a time.
    ///
    /// # Errors
    /// If memory is short, or the channel cannot be created.
    pub fn create_reports(
        &self,
        shard: u32,
        generation: u32,
        senders: usize,
    ) -> Result<Frames, ChannelError> {
        self.create_frames(&reports(shard, generation), senders, REPORTS_DEPTH)
    }
    /// Opens the channel from agent `id` to the controller of this generation.
    ///
    /// # Errors
    /// If the channel is absent or cannot be opened.
    pub fn open_reports(&self, id: ModuleId, generation: u32) -> Result<Frames, ChannelError> {
        self.open_frames(&reports(id.0 / SHARD, generation))
    }
    /// Creates the channel of one shard of agents to the agents of other hosts, for `senders` agents at a time.
    ///
    /// # Errors
    /// If memory is short, or the channel cannot be created.
    pub fn create_egress(&self, shard: u32, generation: u32, senders: usize) -> Result<Frames, ChannelError> {
        self.create_frames(&egress(shard, generation), senders, EGRESS_DEPTH)
    }
    /// Opens the channel from agent `id` to the agents of other hosts.
    ///
    /// # Errors
    /// If the channel is absent or cannot be opened.
    pub fn open_egress(&self, id: ModuleId, generation: u32) -> Result<Frames, ChannelError> {
        self.open_frames(&egress(id.0 / SHARD, generation))
    }
    /// Creates the wake-up channel of the controller of this generation, for `senders` agents at a time.
    ///
    /// # Errors
    /// If the channel cannot be created.
    pub fn create_controller_bell(&self, generation: u32, senders: usize) -> Result<Wakes, ChannelError> {
        self.create_wakes(&controller_bell(generation), senders + CONTROLLER_RINGERS)
    }
    /// Opens the wake-up channel of the controller of this generation.
    ///
    /// # Errors
    /// If the channel is absent or cannot be opened.
    pub fn open_controller_bell(&self, generation: u32) -> Result<Wakes, ChannelError> {
        self.open_wakes(&controller_bell(generation))
    }

    fn create_frames(&self, name: &str, senders: usize, depth: usize) -> Result<Frames, ChannelError> {
        self.node
            .service_builder(&service_name(name))
            .publish_subscribe::<SharedFrame>()
            .max_publishers(senders)
            .max_subscribers(1)
            .max_nodes(senders + 1)
            .subscriber_max_buffer_size(depth)
            .history_size(0)
            .enable_safe_overflow(false)
            .create()
            .map_err(|cause| ChannelError::CreateFrames { name: name.to_owned(), cause })
    }
    fn open_frames(&self, name: &str) -> Result<Frames, ChannelError> {
        self.node
            .service_builder(&service_name(name))
            .publish_subscribe::<SharedFrame>()
            .enable_safe_overflow(false)
            .open()
            .map_err(|cause| ChannelError::OpenFrames { name: name.to_owned(), cause })
    }
    fn create_wakes(&self, name: &str, senders: usize) -> Result<Wakes, ChannelError> {
        self.node
            .service_builder(&service_name(name))
            .event()
            .max_notifiers(senders)
            .max_listeners(1)
            .max_nodes(senders + 1)
            .event_id_max_value(1)
            .create()
            .map_err(|cause| ChannelError::CreateWakes { name: name.to_owned(), cause })
    }
    fn open_wakes(&self, name: &str) -> Result<Wakes, ChannelError> {
        self.node
            .service_builder(&service_name(name))
            .event()
            .open()
            .map_err(|cause| ChannelError::OpenWakes { name: name.to_owned(), cause })
    }
}

/// Creates the receiving end of a channel of frames.
///
/// # Errors
/// If all slots of the channel are taken.
pub fn subscribe(frames: &Frames) -> Result<Subscriber, ChannelError> {
    use iceoryx2::prelude::PortFactory as _;
    // By default a sender that cannot be connected costs a warning, and its frames are never received.
    let fail = |cause, _: &DegradationInfo| match cause {
        DegradationCause::FailedToEstablishConnection => DegradationAction::DegradeAndFail,
        DegradationCause::ConnectionCorrupted => DegradationAction::Warn,
    };
    let builder = frames.subscriber_builder().set_degradation_handler(fail);
    builder.create().map_err(|e| ChannelError::attach(frames.name().as_str(), e))
}

/// Creates the sending end of a channel of frames. It never blocks: frames that do not fit are refused.
///
/// # Errors
/// If memory is short, or all slots of the channel are taken.
pub fn publish(frames: &Frames) -> Result<Publisher, ChannelError> {
    use iceoryx2::prelude::PortFactory as _;
    frames
        .publisher_builder()
        .max_loaned_samples(2)
        .backpressure_strategy(BackpressureStrategy::DiscardData)
        .create()
        .map_err(|e| ChannelError::attach(frames.name().as_str(), e))
}

/// Creates the waiting end of a wake-up channel.
///
/// # Errors
/// If all slots of the channel are taken.
pub fn listen(wakes: &Wakes) -> Result<Listener, ChannelError> {
    use iceoryx2::prelude::PortFactory as _;
    wakes.listener_builder().create().map_err(|e| ChannelError::attach(wakes.name().as_str(), e))
}

/// Creates the waking end of a wake-up channel.
///
/// # Errors
/// If all slots of the channel are taken.
pub fn ring(wakes: &Wakes) -> Result<Notifier, ChannelError> {
    use iceoryx2::prelude::PortFactory as _;
    wakes.notifier_builder().create().map_err(|e| ChannelError::attach(wakes.name().as_str(), e))
}

const CONTROLLER_BELL: &str = "ev/controller/";

fn controller_bell(generation: u32) -> String {
    format!("{CONTROLLER_BELL}{generation}")
}
/// True if a channel of this name is the bell of some generation of controller.
pub(crate) fn is_controller_bell(name: &str) -> bool {
    name.starts_with(CONTROLLER_BELL)
}
fn inbox(id: ModuleId, incarnation: Incarnation) -> String {
    format!("in/{id}/{incarnation}")
}
fn bell(id: ModuleId, incarnation: Incarnation) -> String {
    format!("ev/{id}/{incarnation}")
}
fn reports(shard: u32, generation: u32) -> String {
    format!("reports/{shard}/{generation}")
}
fn egress(shard: u32, generation: u32) -> String {
    format!("egress/{shard}/{generation}")
}

fn service_name(name: &str) -> ServiceName {
    // Invariant: the names above are short and printable.
    #[allow(clippy::unwrap_used, reason = "see the invariant above")]
    ServiceName::new(name).unwrap()
}

/// Sets the verbosity of iceoryx2, which writes to standard error by itself. Its relevant results come back
/// as values, so it is quiet unless `verbose`.
pub fn set_verbosity(verbose: bool) {
    use iceoryx2::prelude::{LogLevel, set_log_level};
    set_log_level(if verbose { LogLevel::Warn } else { LogLevel::Fatal });
}
