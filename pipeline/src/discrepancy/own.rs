//! Recordings of the project's own telemetry as benches: which column is which channel.

use super::table::{Column, Table};
use schemas::error::{Error, Result};
use std::path::Path;

/// Column, channel, and the rest of its line in `[channels]`. Point-sampled positions, currents as
/// means, as the telemetry of a test bench is.
const CHANNELS: [(&str, &str, &str); 9] = [
    ("com", "command", "unit = \"rad\""),
    ("theta_m", "position", "unit = \"rad\""),
    ("omega_m", "velocity", "unit = \"rad/s\""),
    ("i_q", "current", "unit = \"A\", sampling = \"mean\""),
    ("torque_m", "torque", "unit = \"N m\", sampling = \"mean\""),
    ("theta_u", "user_position", "unit = \"rad\""),
    ("temperature", "temperature", "unit = \"degC\""),
    ("v", "voltage", "unit = \"V\", sampling = \"mean\""),
    ("load", "load", "unit = \"N m\""),
];

/// Names of the columns, duration of a run [s], and the runs' numbers (`None` where there is one).
pub fn columns(path: &Path) -> Result<(Vec<String>, f64, Vec<Option<u64>>)> {
    let t = Table::read(path)?.with_q_current();
    if !t.names.iter().any(|n| n == "i_q") {
        let allowed = "a column i_q, or theta_m with i_a, i_b, i_c";
        return Err(Error::bad(&t.file, "header", t.names.join(","), allowed));
    }
    let time = t.numbers("t")?;
    let runs: Vec<Option<u64>> = match t.numbers("run") {
        Ok(r) => {
            let mut all: Vec<u64> = r.iter().map(|x| *x as u64).collect();
            all.dedup();
            all.into_iter().map(Some).collect()
        }
        Err(_) => vec![None],
    };
    let last = time.iter().fold(0.0, |a: f64, b| a.max(*b));
    Ok((t.names.clone(), last, runs))
}

/// The lines of `[channels]` for the columns that are there.
pub fn channels(names: &[String]) -> String {
    let mut text = String::from("time = { column = \"t\", unit = \"s\" }\n");
    for (column, channel, rest) in CHANNELS {
        let duplicate = channel == "torque";
        if names.iter().any(|n| n == column) && !duplicate {
            text += &format!("{channel} = {{ column = \"{column}\", {rest} }}\n");
        }
    }
    text
}

impl Table {
    /// With the columns that follow from others: `t` from `t_ns`, and `i_q` from the phase currents, half
    /// the sum of them times their normalised back-EMF shapes at the measured angle (two pole pairs).
    pub fn with_q_current(mut self) -> Self {
        let get = |t: &Self, name: &str| t.numbers(name).ok().map(<[f64]>::to_vec);
        if get(&self, "t").is_none()
            && let Some(ns) = get(&self, "t_ns")
        {
            self.names.push("t".into());
            self.columns
                .push(Column::Numbers(ns.iter().map(|x| x * 1e-9).collect()));
        }
        if get(&self, "i_q").is_none()
            && let (Some(theta), Some(a), Some(b), Some(c)) = (
                get(&self, "theta_m"),
                get(&self, "i_a"),
                get(&self, "i_b"),
                get(&self, "i_c"),
            )
        {
            let shape = |k: usize, q: f64| sim_worker::effect::shape(2.0 * theta[k] - std::f64::consts::TAU / 3.0 * q);
            let iq =
                (0..theta.len()).map(|k| 0.5 * (a[k] * shape(k, 0.0) + b[k] * shape(k, 1.0) + c[k] * shape(k, 2.0)));
            self.columns.push(Column::Numbers(iq.collect()));
            self.names.push("i_q".into());
        }
        self
    }
}
