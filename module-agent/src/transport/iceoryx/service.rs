//! The variant of iceoryx2 that the processes of a run use: shared memory between processes, except for the
//! one segment that every user of the machine could write, which is in the run's directory.
//!
//! iceoryx2 gives mode 0666 to the counter from which it makes the numbers of members, because members may
//! belong to several users. In a run of this program they never do, and in `/dev/shm` another user could
//! truncate that segment, which ends the next process that reads it. A file in the run's directory, which has
//! mode 0700, is out of reach whatever its own mode is, from its creation on.

use iceoryx2::prelude::{ZeroCopySend, ipc};
use iceoryx2::service::Service;
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_cal::dynamic_storage::file;
use std::fmt::Debug;

/// The service type of iceoryx2 over shared memory between the processes of one user.
#[derive(Clone, Debug)]
pub struct Svc;

impl ServiceInternal<Svc> for Svc {}

impl Service for Svc {
    type StaticStorage = <ipc::Service as Service>::StaticStorage;
    type ConfigSerializer = <ipc::Service as Service>::ConfigSerializer;
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> = file::Storage<T>;
    type Bag = <ipc::Service as Service>::Bag;
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        <ipc::Service as Service>::DynamicStorage<T>;
    type ServiceNameHasher = <ipc::Service as Service>::ServiceNameHasher;
    type SharedMemory = <ipc::Service as Service>::SharedMemory;
    type ResizableSharedMemory = <ipc::Service as Service>::ResizableSharedMemory;
    type Connection = <ipc::Service as Service>::Connection;
    type Event = <ipc::Service as Service>::Event;
    type Monitoring = <ipc::Service as Service>::Monitoring;
    type Reactor = <ipc::Service as Service>::Reactor;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> =
        <ipc::Service as Service>::ArcThreadSafetyPolicy<T>;
    type BlackboardMgmt<T: Send + Sync + Debug + ZeroCopySend + 'static> =
        <ipc::Service as Service>::BlackboardMgmt<T>;
    type BlackboardPayload = <ipc::Service as Service>::BlackboardPayload;
    type UniqueId = <ipc::Service as Service>::UniqueId;
}
