//! What a channel, run, fault, feature and interval is, and how it is stored: the contract that
//! every other crate of the workspace imports. `README.md` beside this crate is its specification.
pub mod channel;
pub mod error;
pub mod fault;
pub mod feature;
pub mod fingerprint;
pub mod recording;
pub mod run_encoder;
pub mod sequence;
pub mod stream;
pub mod telemetry;
pub mod test_kind;
pub mod toml_section;

/// Version of the tables and file metadata of this crate; readers refuse another.
pub const SCHEMA_VERSION: u32 = 1;
