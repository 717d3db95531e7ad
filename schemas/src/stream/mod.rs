//! Telemetry and diagnoses over shared memory, by iceoryx2 publish-subscribe: columns are written
//! in place into a loaned sample and read in place. `README.md` of this crate specifies services,
//! settings and layouts so that programs in other languages can take part.

pub mod arrow_view;
pub mod diagnosis;
pub mod domain;
pub mod frame;
pub mod publisher;
pub mod subscriber;
pub mod wire;

pub use domain::Domain;

/// The service type of all ports: shared memory, and ports that may move between threads.
pub type Ipc = iceoryx2::prelude::ipc_threadsafe::Service;

/// Service (publish-subscribe, and events of the same name) of the telemetry frames.
pub const TELEMETRY: &str = "ema/telemetry";
/// Service (publish-subscribe, and events of the same name) of the diagnoses.
pub const DIAGNOSIS: &str = "ema/diagnosis";
/// Service on which subscribers answer the first and the last frame of a run.
pub const ACKNOWLEDGEMENT: &str = "ema/acknowledgement";

/// Frames that wait for a subscriber before back-pressure or loss begins.
pub const BUFFER_FRAMES: usize = 512;
/// Frames that a subscriber may hold on to at once.
pub const MAX_BORROWED: usize = 8;
/// Subscribers of one domain at once, to a service.
pub const MAX_SUBSCRIBERS: usize = 8;
/// Publishers of one domain at once, to a service.
pub const MAX_PUBLISHERS: usize = 64;
/// Nodes of one domain at once; a process has one or more.
pub const MAX_NODES: usize = 128;
/// Diagnoses that a late subscriber still gets.
pub const DIAGNOSIS_HISTORY: usize = 64;
/// Diagnoses that wait for a subscriber; then the oldest give way.
pub const DIAGNOSIS_BUFFER: usize = 512;

/// A shorter wait for an event is none: the time-out of a socket is counted in microseconds, and 0 is for ever.
const SHORTEST_WAIT: std::time::Duration = std::time::Duration::from_micros(10);

/// Time in nanoseconds of the clock that all processes of the machine share and that never goes
/// back (CLOCK_MONOTONIC).
pub fn now_ns() -> u64 {
    let t = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}
