//! Recordings of the project's own telemetry as benches: which column is which channel.

use crate::measured::table::{Column, Table};
use schemas::error::{Error, Result};
use std::path::Path;

/// Column, channel, and the rest of its line in `[channels]`. Point-sampled positions, currents as
/// means, as the telemetry of a test bench is.
const CHANNELS: [(&str, &str, &str); 15] = [
    ("com", "command", "unit = \"rad\""),
    ("theta_m", "position", "unit = \"rad\""),
    ("omega_m", "velocity", "unit = \"rad/s\""),
    ("i_q", "current", "unit = \"A\", sampling = \"mean\""),
    ("torque_m", "torque", "unit = \"N m\", sampling = \"mean\""),
    ("theta_u", "user_position", "unit = \"rad\""),
    ("temperature", "temperature", "unit = \"degC\""),
    ("v", "voltage", "unit = \"V\", sampling = \"mean\""),
    ("load", "load", "unit = \"N m\""),
    ("i_a", "i_a", PHASE),
    ("i_b", "i_b", PHASE),
    ("i_c", "i_c", PHASE),
    ("v_a", "v_a", "unit = \"V\", sampling = \"mean\""),
    ("v_b", "v_b", "unit = \"V\", sampling = \"mean\""),
    ("v_c", "v_c", "unit = \"V\", sampling = \"mean\""),
];
const PHASE: &str = "unit = \"A\", sampling = \"mean\", offset = 0.0115";

/// Its columns, duration of a run [s], and the runs' numbers (`None` where there is one).
pub fn columns(path: &Path) -> Result<(Table, f64, Vec<Option<u64>>)> {
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
    Ok((t, last, runs))
}

/// The lines of `[channels]` for the columns that are there. A user's angle that is the motor's through the gear is no
/// second sensor.
///
/// The noise of the reference sensors is said where their grain is seen, else it is estimated.
pub fn channels(table: &Table) -> String {
    let reference = is_reference(table);
    let names = &table.names;
    let mut text = String::from("time = { column = \"t\", unit = \"s\" }\n");
    let has = |n: &str| names.iter().any(|x| x == n);
    for (column, channel, rest) in CHANNELS {
        let duplicate = channel == "torque"
            || channel == "current" && has("i_a")
            || channel == "user_position" && follows(table)
            || channel.starts_with("v_") && ["v_a", "v_b", "v_c"].iter().any(|c| table.numbers(c).is_err());
        if has(column) && !duplicate {
            let noise = match channel {
                "position" if reference => format!(", resolution = {:?}", std::f64::consts::TAU / 65536.0),
                "velocity" if reference => ", noise = 0.2".into(),
                "i_a" | "i_b" | "i_c" if reference => format!(", resolution = {CURRENT_GRAIN_A:?}, noise = 0.02"),
                // the NTB's own, which is exact, but for the relays' chatter
                "v_a" | "v_b" | "v_c" if reference => ", noise = 0.02".into(),
                _ => String::new(),
            };
            text += &format!("{channel} = {{ column = \"{column}\", {rest}{noise} }}\n");
        }
    }
    if has("v_dc") && has("v_a") {
        text += "v_dc = { column = \"v_dc\", unit = \"V\", sampling = \"mean\" }\n";
    }
    text
}

/// Grain of the reference sensors' phase currents: +-25 A in 12 bits [A].
const CURRENT_GRAIN_A: f64 = 50.0 / 4096.0;

/// Whether phase currents and angle stand on the grids of the reference sensors.
fn is_reference(t: &Table) -> bool {
    let on = |name: &str, grain: f64| {
        t.numbers(name).is_ok_and(|x| {
            let n = x.len().min(2000);
            let hits = x[..n]
                .iter()
                .filter(|x| (*x / grain - (*x / grain).round()).abs() < 0.02)
                .count();
            n > 100 && hits * 20 > 19 * n
        })
    };
    on("i_a", CURRENT_GRAIN_A) && on("theta_m", std::f64::consts::TAU / 65536.0)
}

/// Whether the user's angle is the motor's over one ratio, to its last digits.
fn follows(t: &Table) -> bool {
    let (Ok(u), Ok(m)) = (t.numbers("theta_u"), t.numbers("theta_m")) else {
        return false;
    };
    let (mut um, mut mm, mut uu) = (0.0, 0.0, 0.0);
    for (u, m) in u.iter().zip(m) {
        (um, mm, uu) = (um + u * m, mm + m * m, uu + u * u);
    }
    let ratio = um / mm;
    let left: f64 = u.iter().zip(m).map(|(u, m)| (u - ratio * m).powi(2)).sum();
    left < 1e-12 * uu
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
