//! One line that says what a rig is.

use super::rig::{Drive, Rig};
use std::f64::consts::TAU;

impl Rig {
    /// One line of description.
    pub fn describe(&self) -> String {
        let s = &self.sees;
        let mut out = format!(
            "{}{} drive, {:?}{}, J {:.2e}, w_max {:.0} rad/s, friction/inertia torque {:.2}, {} Hz {:.1} s{}, \
             channels {}{}{}{}{}{}, gear {}, encoder {:.1} bits, noise w {:.2e} drive {:.2e}{}, ADC {} bits",
            self.lead
                .map_or("rotary, ".to_string(), |l| format!("linear lead {l:.4} m, ")),
            match self.drive {
                Drive::Current => "current",
                Drive::Torque => "torque",
                Drive::Amplifier => "voltage-as-current",
            },
            self.mode,
            if self.one_way { " one way" } else { "" },
            self.j,
            self.w_max,
            (self.tc + 0.5 * self.c * self.w_max) / (self.j * self.a_max),
            self.rate,
            self.span,
            if self.jitter { " uneven clock" } else { "" },
            match self.has {
                (true, true) => "position+velocity",
                (true, false) => "position",
                _ => "velocity",
            },
            if self.user { "+user" } else { "" },
            if self.volt { "+voltage" } else { "" },
            if self.bus { "+v_dc" } else { "" },
            if self.loaded { "+load" } else { "" },
            if self.temp { "+temperature" } else { "" },
            self.gear,
            (TAU / self.encoder).log2(),
            s.velocity,
            s.drive,
            if s.coloured { " half coloured" } else { "" },
            s.adc,
        );
        let channel = |k: usize| if k == 0 { "drive" } else { "velocity" };
        if let Some((k, x)) = s.known {
            out += &format!(", known delay of {} {x:.2e} s", channel(k));
        }
        let mut nuisance = vec![];
        if let Some((k, x)) = s.unknown {
            nuisance.push(format!("unknown delay of {} {x:.2e} s", channel(k)));
        }
        if s.gain != 0.0 {
            nuisance.push(format!("drive gain {:+.4}", s.gain));
        }
        if s.offset != 0.0 {
            nuisance.push(format!("drive offset {:+.4} of range", s.offset / self.i_ref()));
        }
        if s.hum.0 != 0.0 {
            nuisance.push(format!("hum {} Hz", s.hum.1));
        }
        if !nuisance.is_empty() {
            out += &format!(", nuisance [{}]", nuisance.join(", "));
        }
        out + if self.one_file { ", one file" } else { "" }
    }
}
