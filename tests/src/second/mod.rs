//! Synthetic test-bench data: one randomly drawn servo rig per case, measured and written down as a bench file with
//! CSV recordings, and a key that says which physical effects were hidden in it.
//!
//! This module judges a program that finds missing effects. It shares no equation, no integrator and no code with
//! that program: it was written from the published list of effects and the format of the bench file alone, and it has
//! been checked only against itself (torque and voltage balance of the noise-free signals).
//!
//! What is assumed:
//! * All mechanics is computed on the motor's side in rad, N m, s; a linear rig is the same with a lead, written in m,
//!   N, kg. `kt i = J dw/dt + C w + Tc sgn w + load + effects`, effects counted against positive motion.
//! * `v = R i + L di/dt + ke w + effects` where a terminal voltage is measured.
//! * Compliance and backlash split the rig's inertia: the key's `inertia` among the constants is the total, the one in
//!   the effect is the part behind the spring. Half the viscous friction sits behind it.
//! * Friction's reference temperature is 20 degC. Winding heating: `delta_t` is reached at the end of each run, from
//!   zero at its start. Supply sag: the recorded voltage is duty times the nominal supply, the bus is lower by
//!   `Rs * duty * i`.
//! * The controller reads its sensors at a tick and its output acts at once (later by the hidden delay); where the bench
//!   file describes the controller, the log holds exactly what it read, one row a tick.
//! * Breakaway friction is the level of friction at standstill, so it exceeds Coulomb's only with a Stribeck term.
//! * The noise of a rig is drawn, then lowered where the hidden effect at strength 1 would drown: its rms stays above six
//!   times, and what re-tuned constants leave of it above 1.5 times, the noise averaged over 20 ms.
//! * Strengths up to about 1.5 keep all laws within their range.
//! * Resolution and noise in the bench file are in the unit of their channel; a delay means that the value stamped t
//!   belongs to t minus the delay.

mod bench;
mod check;
mod describe;
mod dice;
mod draw;
mod hide;
mod laws;
mod motion;
mod needs;
mod rig;
mod sense;
mod sim;
#[cfg(test)]
mod tests;

use dice::Dice;
use std::io;
use std::path::Path;

pub use needs::{EFFECTS, OUTSIDE};

/// What a case hides.
#[derive(Clone, Debug, PartialEq)]
pub enum Class {
    /// No effect beyond the constants being off within their trust.
    Nothing,
    /// One effect of [`EFFECTS`].
    One(&'static str),
    /// Two different effects of [`EFFECTS`].
    Two(&'static str, &'static str),
    /// A law of [`OUTSIDE`], which no list of candidates holds.
    Outside(&'static str),
}

impl Class {
    /// The names of what is hidden.
    pub fn names(&self) -> Vec<&'static str> {
        match *self {
            Class::Nothing => vec![],
            Class::One(a) | Class::Outside(a) => vec![a],
            Class::Two(a, b) => vec![a, b],
        }
    }
}

/// The truth about a case.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// Each hidden effect: canonical name, parameters by key (SI, motor side). A second order of cogging has the keys
    /// `amplitude_2`, `phase_2`, `order_2`.
    pub hidden: Vec<(String, Vec<(String, f64)>)>,
    /// True constants: inertia, viscous, coulomb, torque_constant (N m per drive unit at the motor) and, where a
    /// voltage is measured, resistance, inductance, back_emf_constant.
    pub constants: Vec<(String, f64)>,
    /// The rig in one line: what was drawn, and nuisances that are no effect.
    pub rig: String,
}

/// Draws a rig, runs it and writes `bench.toml` with its recordings into `folder`, which is made where missing.
/// The same class, strength and seed give the same bytes. `strength` scales the hidden effects only: rig, motion and
/// noise stay as they are.
pub fn make(folder: &Path, class: &Class, strength: f64, seed: u64) -> io::Result<Key> {
    let bad = |text: String| Err(io::Error::new(io::ErrorKind::InvalidInput, text));
    let names = class.names();
    let known = if matches!(class, Class::Outside(_)) {
        OUTSIDE
    } else {
        EFFECTS
    };
    if let Some(name) = names.iter().find(|n| !known.contains(n)) {
        return bad(format!("unknown effect {name}"));
    }
    if let Class::Two(a, b) = class
        && !needs::compatible(a, b)
    {
        return bad(format!("{a} and {b} cannot be hidden together"));
    }
    if !strength.is_finite() || strength < 0.0 {
        return bad(format!("strength {strength}"));
    }
    let case = draw::Case::new(&names, strength, seed);
    std::fs::create_dir_all(folder)?;
    bench::write(folder, &case)?;
    Ok(case.key())
}

/// A class of the wanted kind drawn from a seed: `nothing`, `one`, `two` or `outside`, optionally with a fixed effect.
pub fn class_for(kind: &str, effect: Option<&str>, index: usize, seed: u64) -> io::Result<Class> {
    let mut dice = Dice::new(seed ^ 0x5eed_c1a5);
    let list = if kind == "outside" { OUTSIDE } else { EFFECTS };
    let first = match effect {
        Some(name) => *list
            .iter()
            .find(|e| **e == name)
            .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, format!("unknown effect {name}")))?,
        None => list[index % list.len()],
    };
    match kind {
        "nothing" => Ok(Class::Nothing),
        "one" => Ok(Class::One(first)),
        "outside" => Ok(Class::Outside(first)),
        "two" => {
            let partners: Vec<&'static str> = EFFECTS
                .iter()
                .copied()
                .filter(|e| needs::compatible(first, e))
                .collect();
            Ok(Class::Two(first, dice.pick(&partners)))
        }
        _ => Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("unknown class {kind}"),
        )),
    }
}
