//! Recordings of the project's own telemetry as benches: which column is which channel, which piece finds and which proves.

use crate::measured::bench::BenchChannel;
use crate::measured::noise;
use crate::measured::points::{self, Points};
use crate::measured::recording::extent;
use ema_tables::{ChannelMap, Table};
use schemas::error::{Error, Result};
use schemas::toml_section::{self, Section};
use sim_worker::catalogue;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::SensorModel;
use std::path::{Path, PathBuf};

/// Length of the pieces of a recording that is a bench by itself [s] (assumed): each of its motions has its share in what
/// finds and in what proves. And the shortest that may prove anything.
const PIECE_S: f64 = 0.43;
const SHORTEST_S: f64 = 5.0;

/// How near a grain is to that of a sensor that it is the sensor's, relative, and roughness of currents over the sensor's noise
/// beyond which they are no means by it (assumed: 1.1 to 2.2 with means, 4.1 to 6.3 with points, at 1 to 10 kHz).
const SAME_GRAIN: f64 = 0.02;
const ROUGH: f64 = 3.0;

/// Column, channel, and the rest of its line in `[channels]`; SI units but where the file states others. Point-sampled positions, currents as
/// means, as the telemetry of a test bench is.
const CHANNELS: [(&str, &str, &str); 15] = [
    ("com", "command", ""),
    ("theta_m", "position", ""),
    ("omega_m", "velocity", ""),
    ("i_q", "current", ", sampling = \"mean\""),
    ("torque_m", "torque", ", sampling = \"mean\""),
    ("theta_u", "user_position", ""),
    ("temperature", "temperature", ""),
    ("v", "voltage", ", sampling = \"mean\""),
    ("load", "load", ""),
    ("i_a", "i_a", ""),
    ("i_b", "i_b", ""),
    ("i_c", "i_c", ""),
    ("v_a", "v_a", ", sampling = \"mean\""),
    ("v_b", "v_b", ", sampling = \"mean\""),
    ("v_c", "v_c", ", sampling = \"mean\""),
];
/// Offset of a sensor of phase currents, one sigma (assumed) [A].
const PHASE_OFFSET_A: f64 = 0.0115;

/// The bench that recordings of telemetry are. Of a long one, every third piece proves what the others found; of
/// short ones, every third.
///
/// * `mapped` file whose section `[channels]` says which column is what, where it is not called as ours
pub fn bench(paths: &[PathBuf], actuator: &ActuatorParameters, mapped: Option<&Path>) -> Result<Section> {
    let mapped = mapped.map(Mapped::read).transpose()?.unwrap_or_default();
    let mut text = String::from("[rig]\nkind = \"rotary\"\ndrive = \"current\"\n");
    // how far an actuator of the same type differs (assumed)
    let fd = actuator.static_friction_n_m * actuator.dynamic_friction_ratio;
    text += &format!(
        "drive_constant = {{ value = {:?}, trust = 0.02 }}\ninertia = {{ value = {:?}, trust = 0.05 }}\n\
         viscous = {{ value = {:?}, trust = 0.3 }}\ncoulomb = {{ value = {fd:?}, trust = 0.5 }}\n\
         inductance = {{ value = {:?}, trust = 0.03 }}\n",
        actuator.torque_constant_n_m_per_a(),
        actuator.inertia_kg_m2,
        actuator.viscous_n_m_s_per_rad,
        2.0 * actuator.phase_inductance_h,
    );
    let mut all = Vec::new();
    for (i, path) in paths.iter().enumerate() {
        let (table, ends_s, runs) = columns(path, &mapped)?;
        if i == 0 {
            let points = points::of_phases(2.0 * actuator.phase_inductance_h, |c| table.numbers(c).ok());
            if let Some(Points { inductance, trust }) = points {
                text += &format!("inductance_by_points = {{ value = {inductance:?}, trust = {trust:?} }}\n");
            }
            text += &("[channels]\n".to_string() + &channels(&table, &mapped, points.is_some())?);
        }
        let whole = std::path::absolute(path).map_err(|e| Error::io(path, "cannot be found", e))?;
        all.extend(runs.into_iter().map(|r| (whole.display().to_string(), ends_s, r)));
    }
    let short = all.iter().filter(|r| r.1.1 - r.1.0 < SHORTEST_S).count();
    let mut seen = 0;
    for (file, (start_s, end_s), r) in all {
        let duration_s = end_s - start_s;
        let run = r.map_or(String::new(), |r| format!("where = {{ run = {r} }}\n"));
        if duration_s < SHORTEST_S {
            seen += 1;
            // the last of three, or of two
            let proves = short > 1 && (seen % 3 == 0 || seen == short && short < 3);
            let role = if proves { "heldout" } else { "fit" };
            text += &format!("[[run]]\nfile = {file:?}\nrole = {role:?}\n{run}");
            continue;
        }
        // every third piece proves what the others found
        let pieces = (duration_s / PIECE_S).round();
        let mut at = 0.0;
        while at < pieces {
            let (length, role) = if (at as usize).is_multiple_of(3) {
                (2.0, "fit")
            } else {
                (1.0, "heldout")
            };
            let (from, to) = (
                start_s + duration_s * at / pieces,
                start_s + (duration_s * (at + length) / pieces).min(duration_s),
            );
            text += &format!("[[run]]\nfile = {file:?}\nrole = \"{role}\"\nwindow_s = [{from:?}, {to:?}]\n{run}");
            at += length;
        }
    }
    let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    toml_section::parse(&names.join(", "), &text)
}

/// Channels of a bench whose columns are named by a file: names of the bench's, and the rest of their lines.
#[derive(Default)]
struct Mapped {
    lines: Vec<(String, String)>,
    /// what they name is not what it is called
    columns: Vec<String>,
    map: ChannelMap,
}

impl Mapped {
    fn read(path: &Path) -> Result<Self> {
        let map = ChannelMap::read(path)?;
        let mut section = toml_section::read(path)?.section("channels")?;
        let (mut lines, mut columns) = (Vec::new(), Vec::new());
        for key in section.keys() {
            let ours = CHANNELS.iter().find(|c| c.0 == key).map(|c| c.1.to_string());
            let is_known = key == "time" || BenchChannel::ALL.iter().any(|c| c.name() == key);
            if let Some(name) = ours.or_else(|| is_known.then(|| key.clone()))
                && let Some(v) = section.raw(&key)
            {
                columns.extend(v.get("column").and_then(|c| c.as_str()).map(str::to_string));
                lines.push((name, v.to_string()));
            }
        }
        Ok(Self { lines, columns, map })
    }

    fn has(&self, channel: &str) -> bool {
        self.lines.iter().any(|l| l.0 == channel)
    }
}

/// Columns of a file, first and last time of a run [s], and the runs' numbers.
type Columns = (Table, (f64, f64), Vec<Option<u64>>);

/// Its columns, first (in whole seconds) and last time of a run [s], and the runs' numbers (`None` where there is one).
fn columns(path: &Path, mapped: &Mapped) -> Result<Columns> {
    let t = with_q_current(Table::filled(path)?);
    let is_there = |c: &str| mapped.has(c) || CHANNELS.iter().any(|o| o.1 == c && t.names.iter().any(|n| n == o.0));
    let of_phases = ["position", "i_a", "i_b", "i_c"];
    if !is_there("current") && !of_phases.iter().all(|c| is_there(c)) {
        let allowed = "a column i_q, or theta_m with i_a, i_b, i_c; --channels FILE says which column is what";
        return Err(Error::bad(&t.file, "header", t.names.join(","), allowed));
    }
    let (column, to_s) = mapped.map.time_of(&t)?;
    let time = t.numbers(&column)?;
    let runs: Vec<Option<u64>> = match t.numbers("run") {
        Ok(r) => {
            let mut all: Vec<u64> = r.iter().map(|x| *x as u64).collect();
            all.dedup();
            all.into_iter().map(Some).collect()
        }
        Err(_) => vec![None],
    };
    let (first, last) = extent(time.iter().map(|t| t * to_s));
    let ends = (first.floor(), last);
    Ok((t, ends, runs))
}

/// The lines of `[channels]` for the columns that are there. A user's angle that is the motor's through the gear is no
/// second sensor.
///
/// The noise of the reference sensors is said where their grain is seen, else it is estimated.
///
/// * `points` whether the phase currents are
fn channels(table: &Table, mapped: &Mapped, points: bool) -> Result<String> {
    let sensors = catalogue::sensors("reference")?.filter(|s| is_seen(table, s));
    let names = &table.names;
    let mut text = String::new();
    if !mapped.has("time") {
        text += "time = { column = \"t\" }\n";
    }
    for (channel, line) in &mapped.lines {
        text += &format!("{channel} = {line}\n");
    }
    let has = |n: &str| names.iter().any(|x| x == n);
    let sampling = if points { "point" } else { "mean" };
    for (column, channel, rest) in CHANNELS {
        let duplicate = mapped.has(channel)
            || mapped.columns.iter().any(|c| c == column)
            || channel == "torque"
            || channel == "current" && mapped.has("i_a")
            || channel == "current" && has("i_a")
            || channel == "user_position" && follows(table)
            || channel.starts_with("v_") && ["v_a", "v_b", "v_c"].iter().any(|c| table.numbers(c).is_err());
        if has(column) && !duplicate {
            let noise = match (channel, &sensors) {
                ("position", Some(s)) => format!(", resolution = {:?}", s.resolver_count_rad()),
                ("velocity", Some(s)) => format!(", noise = {:?}", s.speed_noise_rad_per_s),
                ("i_a" | "i_b" | "i_c", Some(s)) => {
                    format!(
                        ", resolution = {:?}, noise = {:?}",
                        s.current_count_a(),
                        s.current_noise_a
                    )
                }
                // the NTB's own, which is exact, but for the relays' chatter (assumed)
                ("v_a" | "v_b" | "v_c", Some(_)) => ", noise = 0.02".into(),
                _ => String::new(),
            };
            let of_phase = if channel.starts_with("i_") {
                format!(", sampling = \"{sampling}\", offset = {PHASE_OFFSET_A:?}")
            } else {
                String::new()
            };
            text += &format!("{channel} = {{ column = \"{column}\"{rest}{of_phase}{noise} }}\n");
        }
    }
    if has("v_dc") && !mapped.has("v_dc") {
        text += "v_dc = { column = \"v_dc\", sampling = \"mean\" }\n";
    }
    Ok(text)
}

/// Whether phase currents and angle are those of these sensors.
fn is_seen(t: &Table, sensors: &SensorModel) -> bool {
    match (t.numbers("theta_m"), t.numbers("i_a")) {
        (Ok(angle), Ok(current)) => are_by(angle, current, sensors),
        _ => false,
    }
}

/// Whether an angle and a current stand on the grids of these sensors, not on coarser ones, and the current is no rougher than
/// means by them: points of a current that a bridge makes are.
fn are_by(angle: &[f64], current: &[f64], sensors: &SensorModel) -> bool {
    let is = |x: &[f64], count: f64| (noise::grain(std::iter::once(x)) / count - 1.0).abs() < SAME_GRAIN;
    let of_sensor = sensors.current_noise_a.hypot(sensors.current_count_a() / 12f64.sqrt());
    is(angle, sensors.resolver_count_rad())
        && is(current, sensors.current_count_a())
        && noise::roughness(std::iter::once(current)).is_some_and(|r| r < ROUGH * of_sensor)
}

/// Whether the user's angle is the motor's over one ratio, to its last digits.
fn follows(t: &Table) -> bool {
    let (Ok(u), Ok(m)) = (t.numbers("theta_u"), t.numbers("theta_m")) else {
        return false;
    };
    // a rotor rests at any angle
    let middle = |x: &[f64]| x.iter().sum::<f64>() / x.len().max(1) as f64;
    let (u0, m0) = (middle(u), middle(m));
    let (mut um, mut mm, mut uu) = (0.0, 0.0, 0.0);
    for (u, m) in u.iter().map(|u| u - u0).zip(m.iter().map(|m| m - m0)) {
        (um, mm, uu) = (um + u * m, mm + m * m, uu + u * u);
    }
    let ratio = um / mm;
    let left: f64 = u.iter().zip(m).map(|(u, m)| (u - u0 - ratio * (m - m0)).powi(2)).sum();
    left < 1e-12 * uu
}

/// With the column that follows from others: `i_q` from the phase currents, half the sum of them times their normalised
/// back-EMF shapes at the measured angle (two pole pairs).
pub(crate) fn with_q_current(mut table: Table) -> Table {
    let get = |name: &str| table.numbers(name).ok();
    if get("i_q").is_none()
        && let (Some(theta), Some(a), Some(b), Some(c)) = (get("theta_m"), get("i_a"), get("i_b"), get("i_c"))
    {
        let shape = |k: usize, q: f64| sim_worker::effect::shape(2.0 * theta[k] - std::f64::consts::TAU / 3.0 * q);
        let iq = (0..theta.len()).map(|k| 0.5 * (a[k] * shape(k, 0.0) + b[k] * shape(k, 1.0) + c[k] * shape(k, 2.0)));
        let iq = iq.collect();
        table.push("i_q", iq);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn coarser_angles_and_points_of_a_current_are_not_by_the_reference_sensors() {
        let sensors = catalogue::sensors("reference").expect("read").expect("there");
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut even = |half: f64| half * (2.0 * rng.random::<f64>() - 1.0);
        let angle = |count: f64| -> Vec<f64> {
            let at = |k: usize| 300.0 * (3e-4 * k as f64).sin();
            (0..6000).map(|k| (at(k) / count).round() * count).collect()
        };
        let mut current = |chatter: f64| -> Vec<f64> {
            let count = sensors.current_count_a();
            let of_sensor = sensors.current_noise_a * 3f64.sqrt();
            let mut at = |k: usize| 2.0 * (2e-3 * k as f64).sin() + even(of_sensor) + even(chatter);
            (0..6000).map(|k| (at(k) / count).round() * count).collect()
        };
        let (means, points) = (current(0.0), current(0.1));
        let count = sensors.resolver_count_rad();
        assert!(are_by(&angle(count), &means, &sensors));
        assert!(!are_by(&angle(4.0 * count), &means, &sensors));
        assert!(!are_by(&angle(count), &points, &sensors));
    }
}
