//! `ema-query`: what `ema query` hands over to.

fn main() -> std::process::ExitCode {
    ema_query::cli::main()
}
