pub mod columns;
pub mod phases;
pub mod shapes;
