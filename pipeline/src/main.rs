//! `ema`: prognostics of electromechanical actuators with failure maps.

use std::process::ExitCode;

fn main() -> ExitCode {
    pipeline::cli::main()
}
