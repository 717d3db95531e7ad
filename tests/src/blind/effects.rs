//! The hidden effects: names, shapes, and what each adds to the true plant.
//!
//! Signs: every torque here is subtracted, `J dw/dt = kt i - b w - Tc sgn w - load - extra`, so it is the residual
//! `kt i - J dw/dt - b w - Tc sgn w - load`. Angles are true motor angles in rad, from 0 at the start of a run.

use super::{Nominal, Rig, Setting};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_3, PI, TAU};

/// Every effect of the candidate list, and those from outside it.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Hash, PartialOrd, Ord)]
pub enum Kind {
    Stribeck,
    LubricatedRise,
    QuadraticDrag,
    ViscousAsymmetry,
    BiasTorque,
    LoadDependentFriction,
    TemperatureDependentFriction,
    PeriodicFriction,
    TightSpot,
    Presliding,
    Cogging,
    TorqueRipple,
    Eccentricity,
    TorqueSaturation,
    SpringLoad,
    Compliance,
    Backlash,
    WindingHeating,
    SupplySag,
    DeadTime,
    TurnShort,
    CommutationOffset,
    EncoderEccentricity,
    CurrentOffset,
    CurrentGain,
    ControlDelay,
    /// Outside: friction proportional to penetration of the last 15 % of the stroke, both ends.
    EndStopRub,
    /// Outside: the user angle creeps against the motor while the transmitted torque exceeds a limit, with loss.
    SlippingCoupling,
    /// Outside: `J (1 + c w^2)`.
    SpeedDependentInertia,
    /// Outside: torque `c w i`.
    SpeedCurrentProduct,
    /// Outside: friction that is there only while the drive speeds up.
    AccelerationFriction,
    /// Outside: friction that decays with the time since the last reversal.
    ReversalFriction,
}

use Kind::*;

/// What the severity of an effect is measured in, and against what (100 % is a tenth of the reference).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Quantity {
    /// rms torque against rms of `kt i`.
    Torque,
    /// rms voltage against rms of `R i + L di/dt` (against all of `v` no heating could reach 10 %).
    Voltage,
    /// rms angle `theta_u N - theta_m` against 1 rad at the motor (100 %: 0.1 rad; assumed).
    PlayAngle,
    /// rms encoder error against 0.2 rad at the motor (100 %: 0.02 rad; assumed).
    EncoderAngle,
    /// rms current (measured or demanded) against rms of the true current.
    Current,
}

impl Kind {
    /// The effects that the study knows by name.
    pub const LIST: [Kind; 26] = [
        Stribeck,
        LubricatedRise,
        QuadraticDrag,
        ViscousAsymmetry,
        BiasTorque,
        LoadDependentFriction,
        TemperatureDependentFriction,
        PeriodicFriction,
        TightSpot,
        Presliding,
        Cogging,
        TorqueRipple,
        Eccentricity,
        TorqueSaturation,
        SpringLoad,
        Compliance,
        Backlash,
        WindingHeating,
        SupplySag,
        DeadTime,
        TurnShort,
        CommutationOffset,
        EncoderEccentricity,
        CurrentOffset,
        CurrentGain,
        ControlDelay,
    ];
    /// Laws that no candidate describes.
    pub const OUTSIDE: [Kind; 6] = [
        EndStopRub,
        SlippingCoupling,
        SpeedDependentInertia,
        SpeedCurrentProduct,
        AccelerationFriction,
        ReversalFriction,
    ];
    const THREE_PHASE: [Kind; 16] = [
        Stribeck,
        LubricatedRise,
        QuadraticDrag,
        ViscousAsymmetry,
        BiasTorque,
        LoadDependentFriction,
        PeriodicFriction,
        TightSpot,
        Cogging,
        TorqueRipple,
        Eccentricity,
        TorqueSaturation,
        SpringLoad,
        DeadTime,
        TurnShort,
        CurrentOffset,
    ];

    /// The effects a rig can hide.
    pub fn drawn(rig: Rig) -> &'static [Kind] {
        match rig {
            Rig::Servo => &Self::LIST,
            Rig::ThreePhase => &Self::THREE_PHASE,
        }
    }

    /// The laws from outside that a rig can hide.
    pub fn drawn_outside(rig: Rig) -> &'static [Kind] {
        match rig {
            Rig::Servo => &Self::OUTSIDE,
            // the slipping coupling and the changing inertia are built into the servo's equations only
            Rig::ThreePhase => &[EndStopRub, SpeedCurrentProduct, AccelerationFriction, ReversalFriction],
        }
    }

    /// Canonical name and parameter keys; the first key is the one that the severity scales.
    fn entry(self) -> (&'static str, &'static [&'static str]) {
        match self {
            Stribeck => ("stribeck", &["torque", "speed", "exponent"]),
            LubricatedRise => ("lubricated_rise", &["torque", "speed"]),
            QuadraticDrag => ("quadratic_drag", &["coefficient"]),
            ViscousAsymmetry => ("viscous_asymmetry", &["coefficient"]),
            BiasTorque => ("bias_torque", &["torque"]),
            LoadDependentFriction => ("load_dependent_friction", &["coefficient"]),
            TemperatureDependentFriction => ("temperature_dependent_friction", &["coefficient"]),
            PeriodicFriction => ("periodic_friction", &["amplitude", "phase", "order"]),
            TightSpot => ("tight_spot", &["torque", "centre", "width"]),
            Presliding => ("presliding", &["stiffness", "damping"]),
            Cogging => ("cogging", &["amplitude", "phase", "order"]),
            TorqueRipple => ("torque_ripple", &["fraction", "phase", "order"]),
            Eccentricity => ("eccentricity", &["zeta", "phase"]),
            TorqueSaturation => ("torque_saturation", &["coefficient"]),
            SpringLoad => ("spring_load", &["stiffness"]),
            Compliance => ("compliance", &["stiffness", "damping", "inertia"]),
            Backlash => ("backlash", &["gap", "inertia"]),
            WindingHeating => ("winding_heating", &["delta_t"]),
            SupplySag => ("supply_sag", &["resistance"]),
            DeadTime => ("dead_time", &["voltage"]),
            TurnShort => ("turn_short", &["fraction", "phase"]),
            CommutationOffset => ("commutation_offset", &["angle"]),
            EncoderEccentricity => ("encoder_eccentricity", &["amplitude", "phase"]),
            CurrentOffset => ("current_offset", &["current"]),
            CurrentGain => ("current_gain", &["gain"]),
            ControlDelay => ("control_delay", &["delay"]),
            EndStopRub => ("end_stop_rub", &["slope", "stroke"]),
            SlippingCoupling => ("slipping_coupling", &["loss", "limit", "slip"]),
            SpeedDependentInertia => ("speed_dependent_inertia", &["coefficient"]),
            SpeedCurrentProduct => ("speed_current_product", &["coefficient"]),
            AccelerationFriction => ("acceleration_friction", &["torque", "acceleration"]),
            ReversalFriction => ("reversal_friction", &["torque", "time"]),
        }
    }

    /// Name in forced cases and keys: the study's word for it.
    pub fn name(self) -> &'static str {
        self.entry().0
    }

    /// Keys of its parameters, as in the study's findings.
    pub fn keys(self) -> &'static [&'static str] {
        self.entry().1
    }

    /// The effect of that name.
    pub fn from_name(name: &str) -> Option<Kind> {
        Self::LIST.into_iter().chain(Self::OUTSIDE).find(|k| k.name() == name)
    }

    /// What its severity is measured in.
    pub fn quantity(self) -> Quantity {
        match self {
            WindingHeating | SupplySag | DeadTime => Quantity::Voltage,
            Backlash => Quantity::PlayAngle,
            EncoderEccentricity => Quantity::EncoderAngle,
            CurrentOffset | CurrentGain | ControlDelay => Quantity::Current,
            _ => Quantity::Torque,
        }
    }

    /// Sets of effects that one command may not tell apart; class `two` takes at most one of each.
    pub fn alias_sets() -> [&'static [Kind]; 6] {
        [
            &[BiasTorque, CurrentOffset],
            &[Compliance, Backlash],
            &[Stribeck, LubricatedRise, QuadraticDrag, Presliding],
            &[TorqueSaturation, CurrentGain, QuadraticDrag],
            &[WindingHeating, DeadTime, SupplySag],
            &[TorqueRipple, Eccentricity, TurnShort, CommutationOffset],
        ]
    }

    /// True if both may be hidden in one case.
    pub fn compatible(self, other: Kind) -> bool {
        self != other
            && !Self::alias_sets()
                .iter()
                .any(|s| s.contains(&self) && s.contains(&other))
    }

    /// Guess of the scaled quantity at 100 % severity, its upper bound, and the power with which the severity follows
    /// it. The scaled quantity is the first key, except: inverse stiffness for presliding and compliance, `gain - 1`.
    pub(super) fn scale(self, p: &Nominal) -> (f64, f64, f64) {
        match self {
            Stribeck | LubricatedRise => (0.01, 0.3, 1.0),
            QuadraticDrag => (6e-8, 1e-5, 1.0),
            ViscousAsymmetry => (2e-5, 1e-3, 1.0),
            BiasTorque => (0.005, 0.05, 1.0),
            LoadDependentFriction => (0.3, 3.0, 1.0),
            // at 35 K the friction must not vanish
            TemperatureDependentFriction => (0.01, 0.025, 1.0),
            PeriodicFriction => (0.007, 0.9 * p.coulomb, 1.0),
            TightSpot => (0.015, 0.2, 1.0),
            // presliding distance 1 rad at the motor; bound: 10 rad
            Presliding => (0.3 / p.coulomb, 10.0 / p.coulomb, 0.5),
            Cogging => (0.007, 0.2, 1.0),
            TorqueRipple => (0.14, 0.6, 1.0),
            Eccentricity => (0.28, 0.7, 1.0),
            TorqueSaturation => (0.06, 0.1, 1.0),
            SpringLoad => (7e-5, 1e-2, 1.0),
            Compliance => (2.0, 20.0, 1.0),
            Backlash => (0.2, 5.0, 1.0),
            WindingHeating => (35.0, 90.0, 1.0),
            SupplySag => (2.0, 10.0, 1.0),
            DeadTime => (0.15, 3.0, 1.0),
            TurnShort => (0.25, 0.6, 1.0),
            CommutationOffset => (0.35, 0.52, 1.5),
            EncoderEccentricity => (0.028, 0.2, 1.0),
            CurrentOffset => (0.06, 1.0, 1.0),
            CurrentGain => (0.1, 0.3, 1.0),
            ControlDelay => (2e-3, 8e-3, 1.0),
            EndStopRub => (2e-3, 1.0, 1.0),
            SlippingCoupling => (0.5, 5.0, 1.0),
            SpeedDependentInertia => (5e-6, 1e-3, 1.0),
            SpeedCurrentProduct => (3e-5, 3e-3, 1.0),
            AccelerationFriction => (0.008, 0.1, 1.0),
            ReversalFriction => (0.015, 0.2, 1.0),
        }
    }
}

/// One hidden effect with its true parameters.
#[derive(Clone, Debug)]
pub struct Effect {
    pub kind: Kind,
    /// The quantity that the severity scales ([`Kind::scale`]), signed.
    pub amp: f64,
    /// Further parameters, in the order of [`Kind::keys`] from the second on.
    pub shape: [f64; 2],
    /// The other law than the table's.
    pub other: bool,
    /// Which of several other laws.
    pub variant: u8,
    /// Parameters were given: not scaled to a severity.
    pub fixed: bool,
}

/// What an effect sees.
pub(super) struct Seen {
    /// Angle, speed and its sign (0 at rest).
    pub th: f64,
    pub w: f64,
    pub sgn: f64,
    pub i: f64,
    pub load: f64,
    /// Temperature above 20 degC.
    pub warm: f64,
    /// Acceleration, 2 ms late, and time since the last reversal.
    pub acc: f64,
    pub since: f64,
}

/// What an effect adds: dry friction level (times sgn w), torque, factors on kt and ke, on R, on L, and voltage.
#[derive(Clone, Copy)]
pub(super) struct Adds {
    pub dry: f64,
    pub torque: f64,
    pub k: f64,
    pub r: f64,
    pub l: f64,
    pub volt: f64,
}

pub(super) const NOTHING: Adds = Adds {
    dry: 0.0,
    torque: 0.0,
    k: 1.0,
    r: 1.0,
    l: 1.0,
    volt: 0.0,
};
/// Temperature coefficient of copper, 1/K.
pub(super) const COPPER: f64 = 0.00393;

/// Six-step conduction of phase q at the angle: +1 on [30, 150) deg electrical, -1 on [210, 330), else 0.
pub(super) fn conduction(th: f64, pairs: f64, q: usize) -> f64 {
    let a = (pairs * th - q as f64 * TAU / 3.0).rem_euclid(TAU) * (180.0 / PI);
    match a {
        a if (30.0..150.0).contains(&a) => 1.0,
        a if (210.0..330.0).contains(&a) => -1.0,
        _ => 0.0,
    }
}

/// Trapezoidal back-EMF shape of phase q: flat on [30, 150] deg, linear between.
pub(super) fn trapezoid(th: f64, pairs: f64, q: usize, shift: f64) -> f64 {
    let a = (pairs * th + shift - q as f64 * TAU / 3.0).rem_euclid(TAU);
    let folded = if a < PI { a.min(PI - a) } else { -(a - PI).min(TAU - a) };
    (folded / (FRAC_PI_3 / 2.0)).clamp(-1.0, 1.0)
}

impl Effect {
    /// Draws the shape parameters; the amplitude is the guess for the severity. `visited` are motor angles of the
    /// fit runs, `stroke` the largest of them.
    pub(super) fn draw(kind: Kind, setting: Setting, p: &Nominal, visited: &[f64], rng: &mut ChaCha8Rng) -> Effect {
        let mut span = |lo: f64, hi: f64| lo + (hi - lo) * rng.random::<f64>();
        let phase = span(-PI, PI);
        let order = [1.0, 2.0, 3.0, 4.0, 6.0, 12.0][(span(0.0, 6.0) as usize).min(5)];
        let negative = span(0.0, 1.0) < 0.5;
        let variant = (span(0.0, 2.0) as u8).min(1);
        let at = (span(0.0, visited.len() as f64) as usize).min(visited.len() - 1);
        let stroke = visited.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        let other = setting == Setting::Other;
        let shape = match kind {
            Stribeck if other => [span(5.0, 60.0), 1.0],
            Stribeck => [span(5.0, 60.0), span(1.0, 2.0)],
            LubricatedRise => [span(20.0, 150.0), 0.0],
            PeriodicFriction | Cogging | TorqueRipple => [phase, order],
            Eccentricity | EncoderEccentricity => [phase, 0.0],
            TightSpot => [visited[at].clamp(-0.7 * stroke, 0.7 * stroke), span(6.0, 30.0)],
            // damping ratio of the bristles; damping ratio and load share; share of the load
            Presliding => [span(0.1, 0.5), 0.0],
            Compliance => [span(0.05, 0.2), span(0.25, 0.55) * p.inertia],
            Backlash => [span(0.15, 0.4) * p.inertia, 0.0],
            TurnShort => [span(0.0, 3.0).floor().min(2.0), 0.0],
            EndStopRub => [stroke, 0.0],
            SlippingCoupling => [span(0.015, 0.025), span(100.0, 400.0)],
            AccelerationFriction => [span(200.0, 600.0), 0.0],
            ReversalFriction => [span(0.04, 0.25), 0.0],
            _ => [0.0; 2],
        };
        let signed = matches!(
            kind,
            ViscousAsymmetry | BiasTorque | CommutationOffset | CurrentOffset | CurrentGain | SpeedCurrentProduct
        );
        let falls = kind == TemperatureDependentFriction || (signed && negative);
        let amp = kind.scale(p).0 * if falls { -1.0 } else { 1.0 };
        Effect {
            kind,
            amp,
            shape,
            other,
            variant,
            fixed: false,
        }
    }

    /// True values under these keys.
    pub fn parameters(&self, p: &Nominal) -> Vec<(&'static str, f64)> {
        let first = match self.kind {
            Presliding | Compliance => 1.0 / self.amp,
            CurrentGain => 1.0 + self.amp,
            _ => self.amp,
        };
        let mut values = vec![first, self.shape[0], self.shape[1]];
        match self.kind {
            Presliding => values[1] = self.bristle_damping(p),
            Compliance => values[1] = self.shaft_damping(p),
            _ => {}
        }
        self.kind.keys().iter().copied().zip(values).collect()
    }

    /// Sets one parameter by its key; false if the key is not one of the effect's.
    pub fn set(&mut self, key: &str, value: f64, p: &Nominal) -> bool {
        let Some(at) = self.kind.keys().iter().position(|k| *k == key) else {
            return false;
        };
        match (self.kind, at) {
            (Presliding | Compliance, 0) => self.amp = 1.0 / value,
            (CurrentGain, 0) => self.amp = value - 1.0,
            (Presliding, 1) => self.shape[0] *= value / self.bristle_damping(p),
            (Compliance, 1) => self.shape[0] *= value / self.shaft_damping(p),
            (_, 0) => self.amp = value,
            _ => self.shape[at - 1] = value,
        }
        self.fixed |= at == 0;
        true
    }

    /// Bristle damping, N m s/rad, from its ratio.
    pub(super) fn bristle_damping(&self, p: &Nominal) -> f64 {
        2.0 * self.shape[0] * (p.inertia / self.amp).sqrt()
    }

    /// Shaft damping, N m s/rad, from its ratio, of the two masses against each other.
    pub(super) fn shaft_damping(&self, p: &Nominal) -> f64 {
        let reduced = self.shape[1] * (p.inertia - self.shape[1]) / p.inertia;
        2.0 * self.shape[0] * (reduced / self.amp).sqrt()
    }

    /// The law in words, and whether the parameters mean the same as in the table.
    pub fn law(&self) -> (&'static str, bool) {
        if !self.other {
            return ("table", true);
        }
        match self.kind {
            Stribeck if self.variant == 0 => ("exponent 1", true),
            Stribeck => ("1/(1 + |w|/ws)", false),
            LubricatedRise => ("|w|/(|w| + w0)", false),
            QuadraticDrag => ("c w |w|^0.7 100^0.3", false),
            ViscousAsymmetry => ("c sqrt(w^2 + 30^2) - 30 c", false),
            LoadDependentFriction => ("mu sqrt(|load| 0.02)", false),
            TemperatureDependentFriction => ("exp(a (T - 20))", false),
            PeriodicFriction | Cogging | TorqueRipple => ("second harmonic of 30 %", true),
            TightSpot => ("exp(-x^4)", false),
            Presliding => (
                "two elements in parallel, 60 % at the stiffness, 40 % at a fifth",
                false,
            ),
            TorqueSaturation => ("kt i (1 - beta i^2)", false),
            SpringLoad => ("k theta (1 + (theta/150)^2)", false),
            Compliance => ("hardening spring", false),
            Backlash => ("kinematic play, no inertia behind it", true),
            WindingHeating => ("kt, ke fall by 0.01 %/K too", true),
            SupplySag => ("no current back into the supply", true),
            DeadTime => ("Vd (2/pi) atan(i/0.1)", false),
            Eccentricity => ("a tenth of it turning twice as fast", true),
            TurnShort => ("L falls with the square", true),
            CommutationOffset => ("rounded trapezoid", false),
            EncoderEccentricity => ("second harmonic of 20 %", true),
            _ => ("table", true),
        }
    }

    /// Error of the encoder at a true angle.
    pub(super) fn encoder(&self, th: f64) -> f64 {
        let second = if self.other {
            0.2 * (2.0 * th + self.shape[0]).sin()
        } else {
            0.0
        };
        self.amp * ((th + self.shape[0]).sin() + second)
    }

    /// `cos(n th + phi)`, with 30 % of a second harmonic for the other law.
    fn wave(&self, th: f64) -> f64 {
        let a = self.shape[1] * th + self.shape[0];
        a.cos() + if self.other { 0.3 * (2.0 * a).cos() } else { 0.0 }
    }

    /// Eccentricity of phase q, Eq. 5 with a phase: `cos(th + phi + 2 pi q/3)`.
    pub(super) fn eccentric(&self, th: f64, q: usize) -> f64 {
        let a = th + self.shape[0] + q as f64 * TAU / 3.0;
        self.amp * (a.cos() + if self.other { 0.1 * (2.0 * a).cos() } else { 0.0 })
    }

    /// What the effect adds to the torque and voltage equations; the plants build the structural effects in.
    /// `servo`: the per-phase effects act through the two phases that conduct.
    pub(super) fn adds(&self, s: &Seen, p: &Nominal, servo: bool) -> Adds {
        let (a, [x, y]) = (self.amp, self.shape);
        let speed = s.w.abs();
        let mut out = NOTHING;
        match self.kind {
            Stribeck if self.other && self.variant == 1 => out.dry = a / (1.0 + speed / x),
            Stribeck => out.dry = a * (-(speed / x).powf(y)).exp(),
            LubricatedRise if self.other => out.dry = a * speed / (speed + x),
            LubricatedRise => out.dry = a * (1.0 - (-speed / x).exp()),
            QuadraticDrag if self.other => out.torque = a * s.w * speed.powf(0.7) * 100f64.powf(0.3),
            QuadraticDrag => out.torque = a * s.w * speed,
            ViscousAsymmetry if self.other => out.torque = a * ((s.w * s.w + 900.0).sqrt() - 30.0),
            ViscousAsymmetry => out.torque = a * speed,
            BiasTorque => out.torque = a,
            LoadDependentFriction if self.other => out.dry = a * (s.load.abs() * 0.02).sqrt(),
            LoadDependentFriction => out.dry = a * s.load.abs(),
            TemperatureDependentFriction => {
                let f = if self.other {
                    (a * s.warm).exp() - 1.0
                } else {
                    a * s.warm
                };
                (out.dry, out.torque) = (f * p.coulomb, f * p.viscous * s.w);
            }
            PeriodicFriction => out.dry = self.wave(s.th) * a,
            TightSpot => {
                let d = ((s.th - x) / y).powi(2);
                out.dry = a * if self.other { (-d * d).exp() } else { (-d).exp() };
            }
            Cogging => out.torque = a * self.wave(s.th),
            TorqueRipple => out.k = 1.0 + a * self.wave(s.th),
            TorqueSaturation => {
                // past its top the torque stays: it does not fall with the current
                let top = if self.other {
                    (3.0 * a).sqrt().recip()
                } else {
                    (2.0 * a).recip()
                };
                let i = s.i.abs().min(top);
                let lost = if self.other { a * i * i * i } else { a * i * i };
                out.torque = p.kt * (lost + s.i.abs() - i).copysign(s.i);
            }
            SpringLoad if self.other => out.torque = a * s.th * (1.0 + (s.th / 150.0).powi(2)),
            SpringLoad => out.torque = a * s.th,
            WindingHeating => {
                out.r = 1.0 + COPPER * s.warm;
                out.k = if self.other { 1.0 - 0.0001 * s.warm } else { 1.0 };
            }
            DeadTime if self.other => out.volt = a * (s.i / 0.1).atan() * (2.0 / PI),
            DeadTime => out.volt = a * (s.i / 0.05).tanh(),
            Eccentricity if servo => {
                out.k = 1.0
                    + (0..3)
                        .map(|q| 0.5 * conduction(s.th, p.pairs, q).abs() * self.eccentric(s.th, q))
                        .sum::<f64>()
            }
            TurnShort if servo => {
                let on = 0.5 * conduction(s.th, p.pairs, x as usize).abs();
                out.k = 1.0 - a * on;
                out.r = 1.0 - a * on;
                out.l = 1.0 - on * if self.other { 1.0 - (1.0 - a).powi(2) } else { a };
            }
            CommutationOffset if servo => {
                let shape = |q| {
                    let e = trapezoid(s.th, p.pairs, q, a);
                    if self.other { 0.9 * e + 0.1 * e * e * e } else { e }
                };
                out.k = (0..3).map(|q| 0.5 * conduction(s.th, p.pairs, q) * shape(q)).sum();
            }
            EndStopRub => out.dry = a * (s.th.abs() - 0.85 * x).clamp(0.0, 0.3 * x),
            SpeedCurrentProduct => out.torque = a * s.w * s.i,
            AccelerationFriction => out.dry = a * (s.sgn * s.acc / x).tanh().max(0.0),
            ReversalFriction => out.dry = a * (-s.since / x).exp(),
            _ => {}
        }
        out
    }
}
