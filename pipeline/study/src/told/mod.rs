pub mod compare;
pub mod compare_motion;
pub mod findings;
pub mod next;
pub mod persist;
pub mod places;
pub mod tell;
pub mod verify;
