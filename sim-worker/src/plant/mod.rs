//! The continuous plant (paper 3.1.2 and 3.1.3), one component a file.
pub mod back_emf;
pub mod backlash;
pub mod end_stop;
pub mod friction;
pub mod inverter;
pub mod mechanics;
pub mod torque;
pub mod windings;
