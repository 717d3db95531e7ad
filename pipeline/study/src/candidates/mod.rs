pub mod columns;
mod loads;
pub mod phases;
pub mod shapes;
pub mod springs;
