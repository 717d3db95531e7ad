//! Writes a case: CSV recordings and the bench file, whose constants are off as far as their trust says.

use super::dice::Dice;
use super::draw::Case;
use super::rig::Drive;
use super::sense::{self, Channel};
use super::sim::{self, Trace};
use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::Path;

/// Simulates, measures and writes all runs of a case.
pub fn write(folder: &Path, case: &Case) -> io::Result<()> {
    let mut d = case.dice.clone();
    let (mut d_file, mut d_noise) = (d.fork(), d.fork());
    let traces: Vec<Trace> = case
        .runs
        .iter()
        .map(|r| sim::run(&case.rig, &case.laws, &r.scene))
        .collect();
    let peak = traces.iter().flat_map(|t| &t.i).fold(0.0, |m: f64, i| m.max(i.abs()));
    let list = sense::channels(case, peak, &mut d_file);
    let head = list.iter().map(|c| c.column.as_str()).collect::<Vec<_>>().join(",");
    let to_second = 1.0 / list[0].factor;

    let mut runs = String::new();
    let mut joined = String::new();
    let mut shift = 0.0;
    for (k, (run, trace)) in case.runs.iter().zip(&traces).enumerate() {
        let mut columns = sense::record(case, trace, &list, &mut d_noise);
        let file = if case.rig.one_file {
            "all.csv".to_string()
        } else {
            format!("run_{k}.csv")
        };
        runs += &format!(
            "\n[[run]]\nfile = \"{file}\"\nrole = \"{}\"\nhealth = \"healthy\"\n",
            run.role
        );
        if case.rig.one_file {
            columns[0].iter_mut().for_each(|t| *t += shift / to_second);
            let (from, to) = (columns[0][0] * to_second, columns[0][columns[0].len() - 1] * to_second);
            runs += &format!("window_s = [{:.7}, {:.7}]\n", from - 1e-6, to + 1e-6);
            shift = to + 0.5;
        }
        let rows = rows(&columns, &list);
        if case.rig.one_file {
            joined += &rows;
        } else {
            fs::write(folder.join(file), format!("{head}\n{rows}"))?;
        }
    }
    if case.rig.one_file {
        fs::write(folder.join("all.csv"), format!("{head}\n{joined}"))?;
    }
    fs::write(
        folder.join("bench.toml"),
        rig_text(case, &mut d_file) + &channel_text(&list) + &runs,
    )
}

fn rows(columns: &[Vec<f64>], list: &[Channel]) -> String {
    let n = columns[0].len();
    let mut out = String::with_capacity(n * columns.len() * 14);
    for k in 0..n {
        for (c, (x, channel)) in columns.iter().zip(list).enumerate() {
            if c > 0 {
                out.push(',');
            }
            // writing into a String cannot fail
            let _ = match channel.key {
                "time" => write!(out, "{:.7}", x[k]),
                "position" | "user_position" | "command" => write!(out, "{:.10e}", x[k]),
                _ => write!(out, "{:.6e}", x[k]),
            };
        }
        out.push('\n');
    }
    out
}

fn channel_text(list: &[Channel]) -> String {
    let mut out = "\n[channels]\n".to_string();
    for c in list {
        out += &format!("{} = {{ column = \"{}\", unit = \"{}\"", c.key, c.column, c.unit);
        if c.key != "time" && c.key != "command" {
            out += if c.mean {
                ", sampling = \"mean\""
            } else {
                ", sampling = \"point\""
            };
        }
        if c.delay.1 {
            out += &format!(", delay_s = {:.6e}", c.delay.0);
        }
        if c.stated && c.resolution > 0.0 {
            out += &format!(", resolution = {:.6e}", c.resolution * c.factor);
        }
        if c.stated && c.noise > 0.0 {
            out += &format!(", noise = {:.4e}", c.noise * c.factor);
        }
        out += " }\n";
    }
    out
}

/// A constant as the bench file gives it: off by its own trust, at most two sigma.
fn off(value: f64, unit: &str, trust: f64, d: &mut Dice) -> String {
    let mut error = d.normal();
    while error.abs() > 2.0 {
        error = d.normal();
    }
    format!(
        "{{ value = {:.8e}, unit = \"{unit}\", trust = {trust:.4} }}",
        value * (1.0 + trust * error)
    )
}

fn rig_text(case: &Case, d: &mut Dice) -> String {
    let rig = &case.rig;
    let m = rig.reach();
    let linear = rig.lead.is_some();
    let (name, unit, constant) = match (rig.drive, linear) {
        (Drive::Current, false) => ("current", "N m/A", rig.kt),
        (Drive::Current, true) => ("current", "N/A", rig.kt / m),
        (Drive::Amplifier, false) => ("voltage", "N m/V", rig.kt),
        (Drive::Amplifier, true) => ("voltage", "N/V", rig.kt / m),
        (Drive::Torque, false) => ("torque", "", 1.0),
        (Drive::Torque, true) => ("force", "", 1.0),
    };
    let mut out = format!("[rig]\nkind = \"{}\"\n", if linear { "linear" } else { "rotary" });
    if let Some(lead) = rig.lead {
        out += &format!("lead_m_per_turn = {lead:e}\n");
    }
    out += &format!("drive = \"{name}\"\n");
    let gain = case.laws.i_gain != 0.0;
    if !unit.is_empty() {
        let trust = if gain {
            d.pick(&[0.0, 0.005, 0.01])
        } else {
            d.pick(&[0.0, 0.01, 0.02, 0.03])
        };
        out += &format!("drive_constant = {}\n", off(constant, unit, trust, d));
    }
    let units = if linear {
        ["kg", "N/(m/s)", "N"]
    } else {
        ["kg m2", "N m s/rad", "N m"]
    };
    let values = if linear {
        [rig.j / (m * m), rig.c / (m * m), rig.tc / m]
    } else {
        [rig.j, rig.c, rig.tc]
    };
    for (k, key) in ["inertia", "viscous", "coulomb"].into_iter().enumerate() {
        let trust = d.logu(0.03, 0.3);
        out += &format!("{key} = {}\n", off(values[k], units[k], trust, d));
    }
    if rig.volt {
        let most = if gain { 0.03 } else { 0.1 };
        let (a, b, c) = (d.logu(0.01, most), d.logu(0.05, 0.2), d.logu(0.005, 0.03));
        out += &format!("resistance = {}\n", off(rig.r, "ohm", a, d));
        out += &format!("inductance = {}\n", off(rig.l, "H", b, d));
        out += &format!("back_emf_constant = {}\n", off(rig.kt, "V s/rad", c, d));
        out += &format!(
            "supply_voltage = {{ value = {:.6e}, unit = \"V\", trust = 0.0 }}\n",
            rig.v0
        );
    }
    if rig.gear != 1.0 {
        out += &format!("gear_ratio = {:?}\n", rig.gear);
    }
    let c = &rig.control;
    if c.every > 0 && c.told {
        out += "\n[rig.controller]\n";
        out += &format!(
            "position_gain = {:.8e}\nspeed_gain = {:.8e}\nintegral_gain = {:.8e}\n",
            c.kpos, c.kp, c.ki
        );
        out += &format!("speed_limit = {:.8e}\ndrive_limit = {:.8e}\n", c.w_limit, c.limit);
        out += "velocity = \"measured\"\nposition = \"motor\"\n";
        out += &format!(
            "rate_hz = {:.6}\ncurrent_time_constant_s = {:.6e}\n",
            rig.rate * rig.fine as f64 / c.every as f64,
            c.lag
        );
    }
    out
}
