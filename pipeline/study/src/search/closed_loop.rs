//! The rig in closed loop: its known controller follows the measured command with the model in place
//! of the machine, and the drive signal is compared with the measured one.
//!
//! Friction, bristles, torques and the control delay act in the loop. Compliance, backlash, the
//! encoder's error and electrical effects do not, nor do effects that the model's file had already.

use crate::equations::nuisances::Nuisance;
use crate::equations::signals::Signals;
use crate::measured::bench::ControllerLaw;
use crate::measured::filtered::{LowPass, Passes};
use crate::search::fit::{self, Fit};
use crate::search::intervals;
use crate::search::study::Outcome;
use sim_worker::effect::{self, Constants, Dahl, DelayLine, Effect, EffectKind};

/// Fewest steps of the machine in a sample, and their greatest length [s].
const SUBSTEPS: usize = 20;
const LONGEST_S: f64 = 25e-6;
/// Fewest samples that are worth a comparison.
const FEWEST: usize = 64;

/// How far the closed loop is from a run: norm of the difference over that of the measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct ClosedLoop {
    pub run: String,
    pub heldout: bool,
    /// of the drive signal: constants of the model's file, and those found with the effects
    pub nominal: f64,
    pub last: f64,
    /// of the position
    pub position_nominal: f64,
    pub position_last: f64,
}

/// Simulates every fit and held-out run; empty without a controller or a channel `command`.
pub fn closed_loop(o: &Outcome) -> Vec<ClosedLoop> {
    let m = &o.material;
    let Some(law) = m.bench.rig.controller.as_ref().filter(|_| !m.clock.steady) else {
        return Vec::new();
    };
    let current = m.constants.measured_current;
    let held = !current && m.bench.channel(m.bench.rig.drive).is_some_and(|c| !c.mean);
    let loops = [(&o.first_nuisances, &o.nominal), (&m.nuisances, &o.model)].map(|(nuisances, fit)| {
        let machine = Machine::of(o, nuisances, fit);
        Loop {
            made: m.bench.made_of_angle,
            ..Loop::new(law, machine, 1.0 / m.clock.rate_hz, held, current)
        }
    });
    let problems = [(Some(&m.fit), false), (m.held.as_ref(), true)];
    let problems = problems.into_iter().filter_map(|(p, heldout)| Some((p?, heldout)));
    let runs = problems.flat_map(|(p, heldout)| p.names.iter().zip(&p.signals).map(move |(n, s)| (n, s, heldout)));
    runs.filter_map(|(run, s, heldout)| {
        let [(nominal, position_nominal), (last, position_last)] = [loops[0].errors(s)?, loops[1].errors(s)?];
        Some(ClosedLoop {
            run: run.clone(),
            heldout,
            nominal,
            last,
            position_nominal,
            position_last,
        })
    })
    .collect()
}

/// The machine in the loop; SI at the motor.
struct Machine {
    inertia: f64,
    viscous: f64,
    coulomb: f64,
    offset: f64,
    torque_constant: f64,
    /// what the effects refer to
    constants: Constants,
    effects: Vec<Effect>,
}

impl Machine {
    /// * `nuisances` those that the deviations of `fit` are relative to
    fn of(o: &Outcome, nuisances: &[Nuisance], fit: &Fit) -> Self {
        let m = &o.material;
        let value = |name: &str| fit::constant(nuisances, fit, name);
        // torques were fitted in units of the torque constant
        let scale = fit::deviation(nuisances, fit, "torque_constant").map_or(1.0, |(_, x)| 1.0 + x);
        let effect = |t| {
            let mut e = fit::effect_of(t, &m.constants, &m.fit);
            for key in (0..e.kind.keys().len()).filter(|key| intervals::is_torque(e.kind, *key)) {
                e.values[key] *= scale;
            }
            e
        };
        Self {
            inertia: value("inertia"),
            viscous: value("viscous"),
            coulomb: value("coulomb"),
            offset: value("offset"),
            torque_constant: value("torque_constant"),
            constants: m.constants.effect,
            effects: fit.terms.iter().map(effect).collect(),
        }
    }

    fn get(&self, kind: EffectKind) -> Option<&Effect> {
        self.effects.iter().find(|e| e.kind == kind)
    }

    /// Speed after `h` [s]: viscous and dry friction are implicit, so that it stands where friction holds it.
    fn faster(&self, s: &effect::Signals, bristles: Option<&mut Dahl>, h: f64) -> f64 {
        let c = &self.constants;
        let more: f64 = self.effects.iter().map(|e| e.friction(s, c)).sum();
        // the sign of motion is 0 here: without it there is no dry friction in an effect's torque
        let against: f64 = self.effects.iter().map(|e| e.torque(s, c)).sum();
        let push = self.torque_constant * s.current - self.offset - s.load - against;
        let (free, stiff) = (self.inertia * s.omega + h * push, self.inertia + h * self.viscous);
        let Some(b) = bristles else {
            return (free.abs() - h * (self.coulomb + more).max(0.0))
                .max(0.0)
                .copysign(free)
                / stiff;
        };
        b.slide_at(self.coulomb, more, s.omega);
        let (still, slope) = b.linear(free - h * b.stiffness * b.z, h);
        let omega = (free - h * still) / (stiff + h * slope);
        b.step(omega, h);
        omega
    }
}

/// Controller and machine.
struct Loop<'a> {
    law: &'a ControllerLaw,
    machine: Machine,
    dt: f64,
    /// from the law to the drive channel, and from there to the torque [s]
    before: f64,
    after: f64,
    /// the drive channel is a command: the law speaks once a sample, and its output is held
    held: bool,
    /// how the law's speed is made of the angle
    made: Option<LowPass>,
}

impl<'a> Loop<'a> {
    /// The control delay comes before a measured current, but after a command, whose hold is half a sample of it.
    fn new(law: &'a ControllerLaw, machine: Machine, dt: f64, held: bool, current: bool) -> Self {
        let delay = machine.get(EffectKind::ControlDelay).map_or(0.0, |e| e.values[0]);
        let (before, after) = if current { (delay, 0.0) } else { (0.0, delay) };
        Self {
            law,
            machine,
            dt,
            before: law.lag_s + before,
            after: if held { (after - 0.5 * dt).max(0.0) } else { after },
            held,
            made: None,
        }
    }

    /// Relative errors of drive signal and position.
    fn errors(&self, s: &Signals) -> Option<(f64, f64)> {
        let (from, drive, theta) = self.run(s)?;
        let relative = |x: &[f64], y: &[f64]| {
            let energy = |f: &dyn Fn(usize) -> f64| (from..s.n).map(|k| f(k).powi(2)).sum::<f64>();
            let e = (energy(&|k| x[k] - y[k]) / energy(&|k| x[k]).max(1e-300)).sqrt();
            if e.is_finite() { e } else { f64::INFINITY }
        };
        Some((relative(&s.drive, &drive), relative(&s.position, &theta)))
    }

    /// First simulated sample, drive signal and angle; before it they are those measured.
    fn run(&self, s: &Signals) -> Option<(usize, Vec<f64>, Vec<f64>)> {
        let (law, machine, dt) = (self.law, &self.machine, self.dt);
        let command = s.command.as_ref()?;
        let from = 2 + ((self.before + self.after) / dt).ceil() as usize;
        if s.n < from + FEWEST {
            return None;
        }
        let substeps = ((dt / LONGEST_S).ceil() as usize).max(SUBSTEPS);
        let h = dt / substeps as f64;
        let between = |x: &[f64], at: f64| {
            let i = (at as usize).min(s.n - 2);
            x[i] + (at - i as f64).min(1.0) * (x[i + 1] - x[i])
        };
        // the law's output as far as the measured drive shows it
        let past = |at: f64| between(&s.drive, at + self.before / dt);
        let (mut sent, mut acting) = (DelayLine::new(self.before, h), DelayLine::new(self.after, h));
        let (mut drive, mut position) = (s.drive.clone(), s.position.clone());
        for i in 0..from * substeps {
            let at = if self.held { i / substeps * substeps } else { i };
            acting.step(sent.step(past(at as f64 / substeps as f64)));
        }
        let warm = s.temperature.as_ref();
        let user = s.user.as_ref().filter(|_| law.on_user);
        let ahead = user.map_or(0.0, |u| u[from] - s.position[from]);
        let (mut theta, mut omega) = (s.position[from], s.omega[from]);
        let mut bristles = machine.get(EffectKind::Presliding).map(|e| Dahl {
            z: (machine.coulomb / e.values[0]).copysign(omega),
            ..e.bristles(&machine.constants)
        });
        let (mut sum, mut output) = (None, 0.0);
        let passes = |m: LowPass| Passes::new(omega, std::f64::consts::TAU * m.corner_hz * h, m.order);
        let mut passes = self.made.map(passes);
        for k in from..s.n {
            position[k] = theta;
            for i in 0..substeps {
                let at = k as f64 + i as f64 / substeps as f64;
                if i == 0 || !self.held {
                    let reference = law.position_gain * (between(command, at) - theta - ahead);
                    let speed = if law.differenced {
                        (theta - between(&position, at - 2.0)) / (2.0 * dt)
                    } else {
                        passes.as_ref().map_or(omega, Passes::value)
                    };
                    let error = reference.clamp(-law.speed_limit, law.speed_limit) - speed;
                    let first = past(at) - law.speed_gain * error;
                    let sum = sum.get_or_insert(if law.integral_gain == 0.0 { 0.0 } else { first });
                    output = law.speed_gain * error + *sum;
                    if output.abs() < law.drive_limit {
                        *sum += law.integral_gain * error * if self.held { dt } else { h };
                    }
                    output = output.clamp(-law.drive_limit, law.drive_limit);
                }
                let recorded = sent.step(output);
                if i == 0 {
                    drive[k] = recorded;
                }
                let moment = effect::Signals {
                    theta,
                    rest: s.rest,
                    omega,
                    current: acting.step(recorded),
                    load: between(&s.load, at),
                    temperature: warm.map_or(effect::REFERENCE_TEMPERATURE_DEGC, |t| between(t, at)),
                    ..Default::default()
                };
                let after = machine.faster(&moment, bristles.as_mut(), h);
                theta += 0.5 * h * (omega + after);
                omega = after;
                passes.iter_mut().for_each(|p| p.step(omega));
            }
        }
        Some((from, drive, position))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_worker::parameters::ActuatorParameters;

    const N: usize = 3000;
    const DT: f64 = 1e-3;
    const LAW: ControllerLaw = ControllerLaw {
        position_gain: 40.0,
        speed_gain: 0.05,
        integral_gain: 0.3,
        speed_limit: 60.0,
        drive_limit: 8.0,
        differenced: true,
        on_user: false,
        lag_s: 0.0,
    };

    fn machine() -> Machine {
        Machine {
            inertia: 2e-4,
            viscous: 4e-4,
            coulomb: 0.03,
            offset: 0.01,
            torque_constant: 0.1,
            constants: Constants::of(&ActuatorParameters::reference(), 1.0),
            effects: vec![
                Effect::new(EffectKind::Stribeck, &[0.02, 3.0, 1.0]),
                Effect::new(EffectKind::Cogging, &[0.02, 0.4, 5.0]),
                Effect::new(EffectKind::ControlDelay, &[1.2e-3]),
            ],
        }
    }

    fn errors(machine: Machine, s: &Signals) -> (f64, f64) {
        let rig = Loop::new(&LAW, machine, DT, true, false);
        rig.errors(s).expect("long")
    }

    /// An independent simulation in steps of 1 us: explicit, friction by a steep slope.
    fn rig() -> Signals {
        let command = |k: usize| 6.0 * (4.0 * k as f64 * DT).sin();
        let (mut x, mut w, mut sum) = (0.0_f64, 0.0_f64, 0.0);
        let zero = || vec![0.0; N];
        let (mut q, mut speed, mut u) = (zero(), zero(), zero());
        for k in 0..N {
            (q[k], speed[k]) = (x, w);
            let old = if k < 2 { 0.0 } else { q[k - 2] };
            let e = (40.0 * (command(k) - x)).clamp(-60.0, 60.0) - (x - old) / (2.0 * DT);
            u[k] = (0.05 * e + sum).clamp(-8.0, 8.0);
            sum += 0.3 * e * DT;
            for i in 0..1000 {
                // 1.2 ms, of which the hold makes 0.5 ms
                let late = if i < 700 { k.saturating_sub(1) } else { k };
                let dry = (0.03 + 0.02 * (-w.abs() / 3.0).exp()) * (w / 2e-3).clamp(-1.0, 1.0);
                let torque = 0.1 * u[late] - 0.01 - 4e-4 * w - 0.02 * (5.0 * x + 0.4).cos() - dry;
                w += 1e-6 * torque / 2e-4;
                x += 1e-6 * w;
            }
        }
        Signals {
            lost: Vec::new(),
            stepping: Vec::new(),
            phases: None,
            n: N,
            rate_hz: 1.0 / DT,
            start_s: 0.0,
            smooth: 0.0,
            theta: q.clone(),
            omega: speed,
            accel: zero(),
            within: None,
            sign: zero(),
            resting: vec![false; N],
            drive: u,
            drive_rate: zero(),
            load: zero(),
            load_level: zero(),
            has_load: false,
            temperature: None,
            voltage: None,
            supply: None,
            position: q,
            user: None,
            velocity: None,
            command: Some((0..N).map(command).collect()),
            law: None,
            before: Vec::new(),
            rest: 0.0,
        }
    }

    #[test]
    fn the_right_machine_gives_the_measured_drive_signal() {
        let s = rig();
        let right = errors(machine(), &s);
        assert!(right.0 < 0.01 && right.1 < 0.01, "{right:?}");
        let (mut bare, mut heavy) = (machine(), machine());
        bare.effects.clear();
        heavy.inertia *= 1.3;
        for wrong in [bare, heavy] {
            assert!(errors(wrong, &s).0 > 0.1);
        }
    }

    #[test]
    fn friction_and_bristles_hold_a_rotor() {
        let mut m = machine();
        m.effects.truncate(1);
        let mut s = effect::Signals {
            current: 0.5,
            ..Default::default()
        };
        assert_eq!(m.faster(&s, None, 1e-4), 0.0);
        // 0.04 N m on bristles of 4 N m/rad
        let mut b = Dahl::new(4.0, 0.05, 0.0);
        for _ in 0..50_000 {
            s.omega = m.faster(&s, Some(&mut b), 2e-5);
        }
        assert!(s.omega.abs() < 1e-6 && (b.z - 0.01).abs() < 1e-6, "{s:?}, {b:?}");
    }
}
