//! A whole case: rig, true laws, hidden effects, runs.

use super::Key;
use super::check;
use super::dice::Dice;
use super::hide::Picker;
use super::laws::Laws;
use super::motion::{Command, Motion, Steps, range};
use super::needs::Needs;
use super::rig::{Drive, Mode, Rig};
use super::sim::{self, Scene};
use std::f64::consts::TAU;

/// One run: its role and what happens in it.
#[derive(Clone, Debug)]
pub struct Run {
    /// `fit` or `heldout`.
    pub role: &'static str,
    /// Command and surroundings.
    pub scene: Scene,
}

/// A drawn case.
#[derive(Clone, Debug)]
pub struct Case {
    /// The rig.
    pub rig: Rig,
    /// True laws.
    pub laws: Laws,
    /// Hidden effects with their parameters.
    pub hidden: Hidden,
    /// Runs.
    pub runs: Vec<Run>,
    /// Draws of the sensors and of the bench file.
    pub dice: Dice,
    /// How the hidden laws depart from the table.
    pub shape: String,
}

impl Case {
    /// Draws the case.
    pub fn new(names: &[&str], strength: f64, seed: u64) -> Case {
        let mut root = Dice::new(seed);
        let (mut d_rig, mut d_run, d_law, dice) = (root.fork(), root.fork(), root.fork(), root.fork());
        let need = Needs::of(names);
        let mut rig = Rig::draw(&need, names, &mut d_rig);
        let runs = draw_runs(&rig, &need, &mut d_run);
        let travel = travel(&rig, &runs);
        // the noise is bounded by what the same effects would do at strength 1, one at a time
        let mut quiet: f64 = 1.0;
        for name in names {
            let (laws, ..) = build(&rig, &[name], 1.0, &d_law, names, travel);
            let trace = sim::run(&rig, &laws, &runs[0].scene);
            quiet = quiet.min(check::visible(&rig, &laws, &trace, name).quieter());
        }
        rig.quieten(quiet);
        let (laws, hidden, shape) = build(&rig, names, strength, &d_law, names, travel);
        Case {
            rig,
            laws,
            hidden,
            runs,
            dice,
            shape,
        }
    }

    /// The truth.
    pub fn key(&self) -> Key {
        let per_unit = if self.rig.drive == Drive::Torque {
            self.rig.reach()
        } else {
            self.rig.kt
        };
        let mut constants = vec![
            ("inertia", self.rig.j),
            ("viscous", self.rig.c),
            ("coulomb", self.rig.tc),
            ("torque_constant", per_unit),
        ];
        if self.rig.volt {
            constants.extend([
                ("resistance", self.rig.r),
                ("inductance", self.rig.l),
                ("back_emf_constant", self.rig.kt),
            ]);
        }
        let commands: Vec<String> = self
            .runs
            .iter()
            .map(|r| format!("{} {}", r.role, r.scene.command.name()))
            .collect();
        let shape = if self.shape.is_empty() {
            String::new()
        } else {
            format!(", other shapes: {}", self.shape)
        };
        Key {
            hidden: self.hidden.clone(),
            constants: constants.into_iter().map(|(k, v)| (k.to_string(), v)).collect(),
            rig: format!("{}, runs [{}]{shape}", self.rig.describe(), commands.join("; ")),
        }
    }
}

type Hidden = Vec<(String, Vec<(String, f64)>)>;

/// The laws of a rig with the effects of `of` at a strength; each effect of `all` has its own draws.
fn build(
    rig: &Rig,
    of: &[&str],
    strength: f64,
    d: &Dice,
    all: &[&str],
    travel: ((f64, f64), f64),
) -> (Laws, Hidden, String) {
    let (j, c, tc, kt) = (rig.j, rig.c, rig.tc, rig.kt);
    let mut laws = Laws {
        j,
        c,
        tc,
        kt,
        r: rig.r,
        l: rig.l,
        ke: kt,
        v0: rig.v0,
        ..Laws::default()
    };
    let mut d = d.clone();
    let (mut shape, mut hidden) = (String::new(), vec![]);
    for name in all {
        let own = d.fork();
        if of.contains(name) {
            let mut p = Picker {
                rig,
                s: strength,
                d: own,
                travel: travel.0,
                widest: travel.1,
                shape: &mut shape,
            };
            let values = p.hide(name, &mut laws);
            hidden.push((
                name.to_string(),
                values.into_iter().map(|(k, v)| (k.to_string(), v)).collect(),
            ));
        }
    }
    (laws, hidden, shape)
}

fn draw_runs(rig: &Rig, need: &Needs, d: &mut Dice) -> Vec<Run> {
    let fits = if d.chance(0.5) { 2 } else { 1 };
    let first = (d.u() * 3.0) as usize;
    (0..=fits)
        .map(|k| {
            let heldout = k == fits;
            // a different kind in each run; the first is never the staircase alone where slow reversals matter
            let kind = (first + k) % 3;
            let w_max = rig.w_max * if k == 0 { 1.0 } else { d.uni(0.8, 1.0) };
            let lo = (rig.f.0 * d.uni(0.95, 1.2)).min(0.5 * rig.f.1);
            let motion = Motion::draw(kind, w_max, (lo, rig.f.1), rig.span, rig.one_way, d);
            let command = match rig.mode {
                Mode::Ideal => Command::Ideal(motion),
                Mode::Spin => {
                    let tf = rig.tc + 0.5 * rig.c * rig.w_max;
                    let low = (rig.tc + 0.6 * tf) / rig.kt;
                    let high = (1.1 * rig.tc + 0.3 * tf + rig.c * rig.w_max) / rig.kt;
                    let slow = (rig.j / rig.c).clamp(0.25, 1.5);
                    Command::Spin(Steps::draw(
                        low,
                        high.max(1.3 * low),
                        (0.5 * slow, 2.5 * slow),
                        rig.span,
                        d,
                    ))
                }
                Mode::Loop if kind == 2 && !need.revolutions && d.chance(0.6) => {
                    let reach = 0.6 * rig.w_max / (TAU * rig.f.0);
                    Command::Jumps(Steps::draw(-reach, reach, (0.3 / rig.f.0, 0.8 / rig.f.0), rig.span, d))
                }
                Mode::Loop => Command::Track(motion),
            };
            let size = rig.t_ref * d.uni(0.5, 0.8);
            let load = vec![
                (0.6 * size, TAU * d.uni(0.08, 0.3), d.phase()),
                (0.4 * size, TAU * d.uni(0.5, 1.7), d.phase()),
            ];
            let temp = [d.uni(12.0, 26.0), d.uni(22.0, 40.0), rig.span * d.uni(0.3, 0.8)];
            let scene = Scene {
                command,
                load,
                temp,
                span: rig.span,
                seed: (d.u() * 1e15) as u64,
            };
            Run {
                role: if heldout { "heldout" } else { "fit" },
                scene,
            }
        })
        .collect()
}

/// Range of the motor's angle that the commands of all runs share, and the width of the widest.
fn travel(rig: &Rig, runs: &[Run]) -> ((f64, f64), f64) {
    let mut all = vec![];
    for run in runs {
        let r = match &run.scene.command {
            Command::Ideal(m) | Command::Track(m) => range(&m.angles(2e-3, (rig.span / 2e-3) as usize, rig.centred)),
            Command::Jumps(s) => {
                let v: Vec<f64> = s.0.iter().map(|x| x.1).collect();
                range(&v)
            }
            Command::Spin(_) => (0.0, 0.4 * rig.w_max * rig.span),
        };
        all.push(r);
    }
    // what all runs share
    let lo = all.iter().map(|r| r.0).fold(f64::MIN, f64::max);
    let hi = all.iter().map(|r| r.1).fold(f64::MAX, f64::min);
    let widest = all.iter().map(|r| r.1 - r.0).fold(0.0, f64::max);
    (if hi > lo { (lo, hi) } else { all[0] }, widest)
}
