//! The live diagnoser as a small program of its own, for a flight or test-bench computer: it does
//! not make maps, it is given them.

fn main() -> std::process::ExitCode {
    diagnoser::cli::main()
}
