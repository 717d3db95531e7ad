//! Files of a case: recordings and `BENCH.toml` in one tree, the key in another.

use super::sensors::{MOTOR_STEP, NOISE, USER_STEP};
use super::{ASSUMED, CURRENT_LOOP, Case, Class, LAWS, Rig, Setting};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::io;
use std::path::Path;

const HEADER: &str = "t,com,theta_m,omega_m,i_q,v,theta_u,temperature,load\n";

impl Class {
    /// Its name in keys and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Class::Nothing => "nothing",
            Class::One => "one",
            Class::Two => "two",
            Class::Outside => "outside",
        }
    }
}

impl Setting {
    /// Its name in keys and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Setting::Matched => "matched",
            Setting::Other => "other",
        }
    }
}

impl Rig {
    /// Its name in keys and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Rig::Servo => "servo",
            Rig::ThreePhase => "three_phase",
        }
    }
}

impl Case {
    /// Writes the recordings and `BENCH.toml` into `dir`, the key to `keys_dir` under the name of `dir`.
    pub fn write(&self, dir: &Path, keys_dir: &Path) -> io::Result<()> {
        std::fs::create_dir_all(dir)?;
        std::fs::create_dir_all(keys_dir)?;
        for r in &self.recordings {
            let mut out = String::with_capacity(r.rows.len() * 90);
            out.push_str(HEADER);
            for (k, m) in r.rows.iter().enumerate() {
                let t = (k + 1) as f64 / 1000.0;
                let [com, th, w, i, v, user, temperature, load] = m;
                let _ = writeln!(
                    out,
                    "{t:.3},{com:.9},{th:.7},{w:.4},{i:.5},{v:.4},{user:.9},{temperature:.3},{load:.6}"
                );
            }
            std::fs::write(dir.join(r.file), out)?;
        }
        std::fs::write(dir.join("BENCH.toml"), self.bench())?;
        let name = dir.file_name().map_or_else(|| "case".into(), |n| n.to_string_lossy());
        std::fs::write(keys_dir.join(format!("{name}.json")), format!("{:#}\n", self.key()))
    }

    /// `BENCH.toml`: the same in every case, whatever is hidden.
    pub fn bench(&self) -> String {
        let p = ASSUMED;
        let l = LAWS;
        let mut out = format!(
            r#"[rig]
kind = "rotary"
drive = "current"
drive_constant = {{ value = {}, unit = "N m/A", trust = 0.06 }}
inertia = {{ value = {}, unit = "kg m2", trust = 0.06 }}
viscous = {{ value = {}, unit = "N m s/rad", trust = 0.06 }}
coulomb = {{ value = {}, unit = "N m", trust = 0.06 }}
back_emf_constant = {{ value = {}, unit = "V s/rad", trust = 0.06 }}
resistance = {{ value = {}, unit = "ohm" }}
inductance = {{ value = {}, unit = "H" }}
gear_ratio = {{ value = {}, trust = 0 }}
pole_pairs = {}
supply_voltage = {}

"#,
            p.kt, p.inertia, p.viscous, p.coulomb, p.ke, p.resistance, p.inductance, p.gear, p.pairs, l.supply,
        );
        let _ = write!(
            out,
            r#"# e = clip(position_gain (gear_ratio com - theta_m), speed_limit) - omega_m
# current = clip(speed_gain e + integral_gain integral(e), drive_limit), through a first-order current loop
[rig.controller]
position_gain = {}
speed_gain = {}
integral_gain = {}
speed_limit = {}
drive_limit = {}
rate_hz = {}
current_time_constant_s = {}

"#,
            l.position_gain,
            l.speed_gain,
            l.integral_gain,
            l.speed_limit,
            l.drive_limit,
            super::commands::RATE,
            if self.spec.rig == Rig::Servo { CURRENT_LOOP } else { 0.0 },
        );
        let _ = write!(
            out,
            r#"[channels]
time = {{ column = "t", unit = "s" }}
command = {{ column = "com", unit = "rad", sampling = "mean" }}
position = {{ column = "theta_m", unit = "rad", sampling = "mean", resolution = {MOTOR_STEP:.6e} }}
velocity = {{ column = "omega_m", unit = "rad/s", sampling = "mean", noise = {} }}
current = {{ column = "i_q", unit = "A", sampling = "mean", noise = {} }}
voltage = {{ column = "v", unit = "V", sampling = "mean", noise = {} }}
user_position = {{ column = "theta_u", unit = "rad", sampling = "mean", resolution = {USER_STEP:e} }}
temperature = {{ column = "temperature", unit = "degC", sampling = "mean", noise = {} }}
load = {{ column = "load", unit = "N m", sampling = "mean", noise = {} }}
"#,
            NOISE[0], NOISE[1], NOISE[2], NOISE[3], NOISE[4],
        );
        for r in &self.recordings {
            let _ = write!(out, "\n[[run]]\nfile = \"{}\"\nrole = \"{}\"\n", r.file, r.role);
        }
        out
    }

    /// The key: what is hidden.
    pub fn key(&self) -> Value {
        let p = &self.truth.nominal;
        let effects: Vec<Value> = self
            .effects
            .iter()
            .zip(&self.reached)
            .map(|(e, reached)| {
                let (law, comparable) = e.law();
                let parameters: serde_json::Map<String, Value> = e
                    .parameters(p)
                    .into_iter()
                    .map(|(k, v)| (k.to_string(), json!(v)))
                    .collect();
                json!({
                    "name": e.kind.name(),
                    "outside": super::Kind::OUTSIDE.contains(&e.kind),
                    "parameters": parameters,
                    "law": law,
                    "parameters_comparable": comparable,
                    "severity_reached": reached,
                    "severity_quantity": format!("{:?}", e.kind.quantity()),
                })
            })
            .collect();
        json!({
            "seed": self.seed,
            "rig": self.spec.rig.name(),
            "class": self.spec.class.name(),
            "setting": self.spec.setting.name(),
            "severity": self.spec.severity,
            "effects": effects,
            "nominal": {
                "torque_constant": p.kt, "back_emf_constant": p.ke, "inertia": p.inertia, "viscous": p.viscous,
                "coulomb": p.coulomb, "resistance": p.resistance, "inductance": p.inductance,
                "gear_ratio": p.gear, "pole_pairs": p.pairs,
            },
            "thermal": { "time_constant": self.truth.thermal_time, "resistance": self.truth.thermal_rise },
            "references": {
                "torque_rms": self.references[0], "voltage_rms": self.references[1],
                "current_rms": self.references[2], "temperature_rise": self.references[3],
            },
            "sensors": {
                "gain_velocity_current_voltage": self.sensors.gain,
                "offset_velocity_current_voltage": self.sensors.offset,
                "noise_correlation": self.sensors.correlation,
                "hum_over_noise": self.sensors.hum,
            },
        })
    }
}
