//! `ema-query` as `ema` hands over to it, for the end-to-end tests.

fn main() -> std::process::ExitCode {
    ema_query::cli::main()
}
