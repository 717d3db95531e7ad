//! What a channel, run, fault, feature and interval is, and how it is stored: the contract that
//! every other crate of the workspace imports. `README.md` beside this crate is its specification.
//!
//! Where to begin: [`Channel`] and [`Feature`] are the tables of what is recorded and what is formed from it;
//! [`FaultState`] and [`TestSequence`] say what a run is of. Telemetry goes in blocks ([`telemetry::TelemetryView`])
//! from a producer into a [`telemetry::TelemetrySink`]: into memory ([`Collector`]), a Parquet file ([`Recorder`],
//! read by [`Recording`]) or shared memory ([`stream::publisher::StreamSink`]). All that comes from outside is
//! refused with [`error::Error`], in one line.
//!
//! Three samples written and read back:
//!
//! ```
//! use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink};
//! use schemas::{Channel, ChannelSet, Collector, FaultState, Recorder, Recording};
//!
//! let file = std::env::temp_dir().join(format!("ema-example-{}.parquet", std::process::id()));
//! let channels = ChannelSet::of([Channel::Com, Channel::ThetaM]);
//! let rate_hz = 10_000.0;
//! let about = schemas::recording::Provenance { actuator: "rig 1".into(), rate_hz, ..Default::default() };
//! let header = TelemetryHeader {
//!     run: 0,
//!     actuator: about.actuator.clone(),
//!     parameters: String::new(),
//!     sensors: "none".into(),
//!     sequence: String::new(),
//!     rate_hz,
//!     channels,
//!     fault: Some(FaultState::NOMINAL),
//!     rest_angle_rad: None,
//! };
//! let mut samples = TelemetryBuffer::new(channels, 3);
//! let mut block = samples.view_mut(1, 3); // sample 1 ends at 1 / rate
//! block.column_mut(Channel::ThetaM).unwrap().copy_from_slice(&[0.0, 0.001, 0.003]);
//!
//! let mut recorder = Recorder::create(&file, &about, channels, false)?;
//! recorder.accept(&header, &samples.view())?;
//! recorder.finish()?; // only now the file has its name
//!
//! let mut read = Collector::default();
//! Recording::open(&file)?.replay(1024, &mut read)?;
//! assert_eq!(read.column(Channel::ThetaM), Some(&[0.0, 0.001, 0.003][..]));
//! # std::fs::remove_file(&file).unwrap();
//! # Ok::<(), schemas::error::Error>(())
//! ```

#![warn(missing_docs, clippy::missing_errors_doc)]

pub mod channel;
mod checksums;
mod declared;
pub mod error;
pub mod fault;
pub mod feature;
pub mod fingerprint;
pub mod foreign;
pub mod guard;
pub mod recording;
pub mod run_encoder;
pub mod sequence;
pub mod stream;
pub mod table;
pub mod telemetry;
pub mod test_kind;
pub mod toml_section;

pub use channel::{Channel, ChannelSet};
pub use fault::FaultState;
pub use feature::Feature;
pub use recording::{Recorder, Recording};
pub use sequence::TestSequence;
pub use telemetry::Collector;

/// Version of the tables and file metadata of this crate; readers refuse another.
pub const SCHEMA_VERSION: u32 = 1;
