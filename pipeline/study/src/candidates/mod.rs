pub mod columns;
pub mod shapes;
