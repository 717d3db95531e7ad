//! What flies: failure maps of features, and their inversion to fault intervals, live
//! or of a recording.
pub mod calibration;
pub mod cli;
pub mod curves;
pub mod diagnosis;
pub mod estimate;
pub mod failure_map;
pub mod isotonic;
pub mod live;
pub mod log;
pub mod map_library;
pub mod monotone;
pub mod paving;
pub mod quality;
pub mod receive;
pub mod record;
pub mod report;
pub mod sensitivity;
pub mod smooth;
pub mod uncertainty;
pub mod view;
