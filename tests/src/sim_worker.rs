//! The program `sim-worker`, so that the tests find it.
fn main() -> std::process::ExitCode {
    sim_worker::dataset::program::main()
}
