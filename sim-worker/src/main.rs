//! One share of a fleet's simulations.
fn main() -> std::process::ExitCode {
    sim_worker::dataset::program::main()
}
