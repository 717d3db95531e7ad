//! `diagnoser` as a user runs it, for the end-to-end tests.

fn main() -> std::process::ExitCode {
    diagnoser::cli::main()
}
