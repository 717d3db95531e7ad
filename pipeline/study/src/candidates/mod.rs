pub mod bristles;
pub mod columns;
pub mod laws;
mod loads;
pub mod phases;
pub mod shapes;
pub mod springs;
