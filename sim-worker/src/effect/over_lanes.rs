//! The effects of all lanes of a test bench, side by side: what has no state of its own runs over the lanes.

use super::inject::Injection;
use super::{EffectKind, Law, equations};
use crate::control::pick;
use crate::lanes::Units;
use crate::parameters::ActuatorParameters;
use schemas::fault::FaultState;

/// Time over which the bus's capacitor levels the supply current [s] (assumed); the source feels
/// the mean of a switching period, not the switching.
const BUS_S: f64 = 1e-4;

/// What the effects of a lane add to its step, in the units of the kernel.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Felt<const N: usize> {
    /// torque against the motor
    pub torque: [f64; N],
    /// added to the levels of static and dynamic friction
    pub friction: [f64; N],
    /// 1 for the actuator's dry friction, 0 where bristles replace it
    pub dry: [f64; N],
    /// inertia over what the motor torque accelerates
    pub agile: [f64; N],
    /// loss of each leg's voltage
    pub drop: [[f64; N]; 3],
    /// half the voltage that a unit of supply current costs
    pub sag: [f64; N],
    /// mean of the supply current up to the last step, levelled by the bus
    pub supply: [f64; N],
    /// weight of a step in that mean; 1 where nothing levels it
    pub bus: [f64; N],
    /// the supply current counts by its size
    pub by_size: [bool; N],
    /// gain of the measured current
    pub gain: [[f64; N]; 3],
    /// whether the three gains differ, so that the measured currents do not add up to the offsets
    pub uneven: [bool; N],
    /// offset of the measured current, in the phases that conduct
    pub offset: [f64; N],
    /// offset of each phase's sensor
    pub sensor: [[f64; N]; 3],
    /// sum of the three
    pub sensors: [f64; N],
    /// one over the turns left of each phase; 0 with all turns
    pub more: [[f64; N]; 3],
    /// one over the sum of `more`; 0 with all turns
    pub even: [f64; N],
    /// factor of each phase's back-EMF coefficient
    pub emf: [[f64; N]; 3],
    /// angle that the commutation is off, in units of 30 electrical degrees
    pub error: [f64; N],
    /// measured speed over the true one
    pub seen: [f64; N],
    /// motor angle at the step's start
    pub th: [f64; N],
}

/// An effect without a state of its own, in all lanes that have it; nothing in the others.
#[derive(Clone, Debug)]
struct Slot<const N: usize> {
    kind: EffectKind,
    /// how many of the kind a lane has before it
    before: usize,
    values: [[f64; N]; 3],
}

/// What the slots add up to.
#[derive(Clone, Debug)]
struct Sum<const N: usize> {
    /// [N m]
    friction: [f64; N],
    /// [N m]
    torque: [f64; N],
}

/// The effects of all lanes of a test bench.
#[derive(Clone, Debug)]
pub struct LaneEffects<const N: usize> {
    /// in one order whatever the company: sums of a lane are the same to the bit
    slots: Vec<Slot<N>>,
    sum: Sum<N>,
    pole_pairs: [f64; N],
    /// electrical angle of the commutation less the measured one [rad]
    commutation: [f64; N],
    /// share of the turns of each phase that is left
    turns: [[f64; N]; 3],
    /// the kernel's current and voltage of 1 A and 1 V
    amperes: [f64; N],
    volts: [f64; N],
    /// from the kernel's speed to rad/s, and from N m to the kernel's torque
    rad_per_s: [f64; N],
    newton_metre: [f64; N],
    /// none in a lane without effects
    lanes: Vec<Option<Injection>>,
    /// what they add to the present step
    pub felt: Felt<N>,
    /// effects that [`LaneEffects::level`] works out
    levels: bool,
    electrical: bool,
    dead_time: bool,
    /// torques that have a state: bristles, and what is behind a compliance
    stateful: bool,
    behind: bool,
    saturated: bool,
    flux: bool,
    delayed: bool,
    /// whether any is in bridge, windings, commutation or their sensors
    currents: bool,
    dt: f64,
}

impl<const N: usize> Default for LaneEffects<N> {
    fn default() -> Self {
        const ONE: f64 = 1.0;
        Self {
            slots: Vec::new(),
            sum: Sum {
                friction: [0.0; N],
                torque: [0.0; N],
            },
            pole_pairs: [ONE; N],
            commutation: [0.0; N],
            turns: [[ONE; N]; 3],
            amperes: [ONE; N],
            volts: [ONE; N],
            rad_per_s: [0.0; N],
            newton_metre: [0.0; N],
            lanes: Vec::new(),
            felt: Felt {
                torque: [0.0; N],
                friction: [0.0; N],
                dry: [ONE; N],
                agile: [ONE; N],
                drop: [[0.0; N]; 3],
                sag: [0.0; N],
                supply: [0.0; N],
                bus: [0.0; N],
                by_size: [false; N],
                gain: [[ONE; N]; 3],
                uneven: [false; N],
                offset: [0.0; N],
                sensor: [[0.0; N]; 3],
                sensors: [0.0; N],
                more: [[ONE; N]; 3],
                even: [0.0; N],
                emf: [[ONE; N]; 3],
                error: [0.0; N],
                seen: [ONE; N],
                th: [0.0; N],
            },
            levels: false,
            electrical: false,
            dead_time: false,
            stateful: false,
            behind: false,
            saturated: false,
            flux: false,
            delayed: false,
            currents: false,
            dt: 0.0,
        }
    }
}

impl<const N: usize> LaneEffects<N> {
    /// Lane after lane.
    pub fn push(&mut self, p: &ActuatorParameters, f: FaultState, rest: f64, load: f64) {
        let l = self.lanes.len();
        let u = Units::new(p);
        let mut own = Injection::new(p, f.fsj, rest, load, p.step_s).filter(|_| Injection::needs_kernel(p));
        if let Some(e) = &mut own
            && let Some(b) = &mut e.bristles
        {
            // the step is explicit: a damping that would turn the motion round within it ends the motion
            let inertia = p.inertia_kg_m2 - e.behind.as_ref().map_or(0.0, |b| b.inertia);
            b.damping = b.damping.min(inertia / p.step_s);
        }
        self.dt = p.step_s;
        self.felt.bus[l] = (p.step_s / BUS_S).min(1.0);
        self.rad_per_s[l] = 1.0 / u.rad_per_s;
        self.newton_metre[l] = u.newton_metre;
        (self.amperes[l], self.volts[l]) = (u.ampere, u.volt);
        if let Some(e) = &own {
            let of_motion = e.friction.iter().chain(&e.torque).chain(e.bridged());
            let by_levels = of_motion.chain(&e.ripple).chain(&e.encoder);
            self.levels |= by_levels.clone().next().is_some();
            let effects = by_levels.chain(&e.saturation).chain(&e.dead_time);
            let mut seen: Vec<EffectKind> = Vec::new();
            for effect in effects {
                let before = seen.iter().filter(|k| **k == effect.kind).count();
                seen.push(effect.kind);
                self.fill(l, effect.kind, before, e.prepared(effect));
            }
            self.electrical |=
                !e.ripple.is_empty() || !e.encoder.is_empty() || e.commutation != 0.0 || e.turns != [1.0; 3];
            self.pole_pairs[l] = e.constants.pole_pairs;
            self.commutation[l] = e.commutation;
            (0..3).for_each(|q| self.turns[q][l] = e.turns[q]);
            self.dead_time |= !e.dead_time.is_empty();
            self.stateful |= e.bristles.is_some() || e.behind.is_some();
            self.behind |= e.behind.is_some();
            self.saturated |= e.saturation.iter().any(|e| e.law != Law::Flux);
            self.flux |= e.saturation.iter().any(|e| e.law == Law::Flux);
            self.delayed |= e.delay.is_some();
            let felt = &mut self.felt;
            felt.sag[l] = 0.5 * e.source * u.volt / u.ampere;
            if e.draw != Law::First {
                felt.bus[l] = 1.0;
            }
            felt.by_size[l] = e.draw == Law::Legs;
            self.currents |= self.electrical || self.dead_time || self.saturated || self.flux;
            self.currents |= e.source != 0.0 || e.offset != 0.0 || e.gains != [1.0; 3] || e.sensors != [0.0; 3];
            (0..3).for_each(|q| felt.gain[q][l] = e.gains[q]);
            felt.uneven[l] = e.gains != [e.gains[0]; 3];
            felt.offset[l] = e.offset * u.ampere;
            (0..3).for_each(|q| felt.sensor[q][l] = e.sensors[q] * u.ampere);
            felt.sensors[l] = e.sensors.iter().sum::<f64>() * u.ampere;
            if e.turns != [1.0; 3] {
                let more = e.turns.map(|t| 1.0 / t);
                (0..3).for_each(|q| felt.more[q][l] = more[q]);
                felt.even[l] = 1.0 / (more[0] + more[1] + more[2]);
            }
            if e.bristles.is_some() {
                felt.dry[l] = 0.0;
            }
            if let Some(b) = &e.behind {
                let j = p.inertia_kg_m2;
                felt.agile[l] = j / (j - b.inertia + b.slope(self.dt) * self.dt);
            }
        }
        self.lanes.push(own);
        self.turn(&[1.0; N], &[0.0; N]);
    }

    /// Another load torque [N m] in lane `l`; in the kernel's unit.
    pub fn set_load(&mut self, l: usize, load_n_m: f64) -> f64 {
        if let Some(mut own) = self.lanes[l].take() {
            own.signals.load = load_n_m;
            let of_load = own
                .friction
                .iter()
                .filter(|e| e.kind == EffectKind::LoadDependentFriction);
            for (before, e) in of_load.enumerate() {
                self.fill(l, e.kind, before, own.prepared(e));
            }
            self.lanes[l] = Some(own);
        }
        load_n_m * self.newton_metre[l]
    }

    /// Takes over what the effects of `other`, of the same actuators, remember.
    pub fn go_on_from(&mut self, other: &Self) {
        let mut memory = Vec::new();
        other.clone().each(&mut |x| memory.push(*x));
        let mut next = memory.into_iter();
        self.each(&mut |x| *x = next.next().unwrap_or(*x));
    }

    /// Shows every number that effects remember from step to step to `see`, which may change it.
    pub fn each(&mut self, see: &mut dyn FnMut(&mut f64)) {
        self.felt.supply.iter_mut().for_each(&mut *see);
        self.felt.th.iter_mut().for_each(&mut *see);
        for own in self.lanes.iter_mut().flatten() {
            if let Some(line) = &mut own.delay {
                line.each(see);
            }
            if let Some(b) = &mut own.bristles {
                see(&mut b.z);
            }
            if let Some(b) = &mut own.behind {
                see(&mut b.angle);
                see(&mut b.speed);
            }
        }
    }

    /// Puts an effect of a lane into its slot.
    fn fill(&mut self, l: usize, kind: EffectKind, before: usize, values: [f64; 3]) {
        let place = self.slots.binary_search_by_key(&(kind, before), |s| (s.kind, s.before));
        let at = place.unwrap_or_else(|at| {
            // no amplitude; what is divided by is 1
            let values = [[0.0; N], [1.0; N], [1.0; N]];
            self.slots.insert(at, Slot { kind, before, values });
            at
        });
        for (to, x) in self.slots[at].values.iter_mut().zip(values) {
            to[l] = x;
        }
    }

    /// Works out what the effects without a state add in all lanes.
    ///
    /// * `th0` angles at rest [rad], `th` angles from there [rad], `turn` speeds
    #[inline(always)]
    pub fn level(&mut self, th0: &[f64; N], th: &[f64; N], turn: &[f64; N]) {
        let (mut friction, mut torque, mut ripple, mut angle) = ([0.0; N], [0.0; N], [1.0; N], [0.0; N]);
        let mut seen = [1.0; N];
        let (mut theta, mut omega) = ([0.0; N], [0.0; N]);
        for l in 0..N {
            theta[l] = th0[l] + th[l];
            omega[l] = turn[l] * self.rad_per_s[l];
        }
        // loops, not closures: only what is inlined is compiled for the instruction set of the caller
        for s in &self.slots {
            let [a, b, d] = &s.values;
            match s.kind {
                EffectKind::Stribeck => {
                    for l in 0..N {
                        friction[l] += equations::stribeck([a[l], b[l], d[l]], omega[l]);
                    }
                }
                EffectKind::LubricatedRise => {
                    for l in 0..N {
                        friction[l] += equations::lubricated([a[l], b[l], d[l]], omega[l]);
                    }
                }
                EffectKind::LoadDependentFriction => {
                    for l in 0..N {
                        friction[l] += a[l];
                    }
                }
                EffectKind::TemperatureDependentFriction => {
                    for l in 0..N {
                        friction[l] += a[l] * (b[l] + d[l] * omega[l].abs());
                    }
                }
                EffectKind::PeriodicFriction => {
                    for l in 0..N {
                        friction[l] += equations::wave([a[l], b[l], d[l]], theta[l]);
                    }
                }
                EffectKind::TightSpot => {
                    for l in 0..N {
                        friction[l] += equations::bell([a[l], b[l], d[l]], theta[l]);
                    }
                }
                EffectKind::QuadraticDrag => {
                    for l in 0..N {
                        torque[l] += a[l] * omega[l] * omega[l].abs();
                    }
                }
                EffectKind::ViscousAsymmetry => {
                    for l in 0..N {
                        torque[l] += a[l] * omega[l].abs();
                    }
                }
                EffectKind::BiasTorque => {
                    for l in 0..N {
                        torque[l] += a[l];
                    }
                }
                EffectKind::Cogging => {
                    for l in 0..N {
                        torque[l] += equations::wave([a[l], b[l], d[l]], theta[l]);
                    }
                }
                EffectKind::TurnShort => {
                    for l in 0..N {
                        torque[l] += equations::brake([a[l], b[l], d[l]], theta[l], omega[l]);
                    }
                }
                EffectKind::SpringLoad => {
                    for l in 0..N {
                        torque[l] += a[l] * (theta[l] - th0[l]);
                    }
                }
                EffectKind::TorqueRipple => {
                    for l in 0..N {
                        ripple[l] *= 1.0 + equations::wave([a[l], b[l], d[l]], theta[l]);
                    }
                }
                EffectKind::EncoderEccentricity => {
                    for l in 0..N {
                        let (of_angle, of_speed) = equations::off_centre([a[l], b[l], d[l]], theta[l]);
                        angle[l] += of_angle;
                        seen[l] += d[l] * of_speed;
                    }
                }
                _ => {}
            }
        }
        for l in 0..N {
            self.felt.friction[l] = friction[l] * self.newton_metre[l];
            self.felt.torque[l] = torque[l] * self.newton_metre[l];
        }
        self.sum = Sum { friction, torque };
        if self.electrical {
            self.felt.seen = seen;
            self.turn(&ripple, &angle);
        }
    }

    /// Works out what the commutation is off by, and the factors of the back-EMF coefficients.
    ///
    /// * `ripple` factors of all three, `angle` measured less true [rad]
    #[inline(always)]
    fn turn(&mut self, ripple: &[f64; N], angle: &[f64; N]) {
        for l in 0..N {
            for q in 0..3 {
                self.felt.emf[q][l] = self.turns[q][l] * ripple[l];
            }
            let error = self.pole_pairs[l] * angle[l] + self.commutation[l];
            self.felt.error[l] = error * (6.0 / std::f64::consts::PI);
        }
    }

    /// Whether there is anything for [`LaneEffects::level`].
    #[inline(always)]
    pub fn has_levels(&self) -> bool {
        self.levels
    }

    /// Whether the kernel has to take part.
    pub fn any(&self) -> bool {
        self.lanes.iter().any(Option::is_some)
    }

    /// The effects of a lane.
    pub fn lane(&self, l: usize) -> Option<&Injection> {
        self.lanes[l].as_ref()
    }

    /// Voltage that the source of lane `l` loses [V]: what it gives at the moment, or, where nothing levels that, in the mean
    /// of an interval.
    ///
    /// * `mean` of the current that is drawn in the interval so far [A], NaN before its first step
    pub fn sag(&self, l: usize, mean: f64) -> f64 {
        let now = self.felt.supply[l] / self.amperes[l];
        let of = |e: &Injection| match e.draw {
            Law::Bridge | Law::Legs if !mean.is_nan() => mean,
            _ => now,
        };
        self.lanes[l].as_ref().map_or(0.0, |e| e.source * of(e))
    }

    /// Delays the current references.
    #[inline]
    pub fn delay(&mut self, i_ref: &mut [f64; N]) {
        if self.delayed {
            for (l, i) in i_ref.iter_mut().enumerate() {
                if let Some(line) = self.lanes[l].as_mut().and_then(|e| e.delay.as_mut()) {
                    *i = line.step(*i);
                }
            }
        }
    }

    /// Works out the loss of each leg.
    ///
    /// * `on` whether each phase conducts, `i` phase currents
    #[inline(always)]
    pub fn drops(&mut self, on: &[[bool; N]; 3], i: &[[f64; N]; 3]) {
        self.felt.drop = [[0.0; N]; 3];
        for s in self.slots.iter().filter(|s| s.kind == EffectKind::DeadTime) {
            for q in 0..3 {
                for l in 0..N {
                    let drop = equations::dead_time(s.values[0][l], i[q][l] / self.amperes[l]);
                    self.felt.drop[q][l] += pick(on[q][l], drop, 0.0);
                }
            }
        }
        for q in 0..3 {
            for l in 0..N {
                self.felt.drop[q][l] *= self.volts[l];
            }
        }
    }

    /// Whether any lane has an effect of bridge, windings, commutation or their sensors.
    pub fn reach_currents(&self) -> bool {
        self.currents
    }

    /// Whether any lane has dead time.
    pub fn has_dead_time(&self) -> bool {
        self.dead_time
    }

    /// Scales the back-EMF coefficients of a phase to those that make torque.
    ///
    /// * `i` its currents
    #[inline(always)]
    pub fn saturate(&self, i: &[f64; N], k: &mut [f64; N]) {
        let mut left = [1.0; N];
        for s in self.slots.iter().filter(|s| s.kind == EffectKind::TorqueSaturation) {
            for l in 0..N {
                let amperes = i[l] / self.amperes[l];
                let straight = s.values[0][l] * (1.0 - s.values[1][l] - s.values[2][l]);
                let square = s.values[0][l] * s.values[2][l];
                left[l] *= equations::saturation(straight, amperes) * equations::square_saturation(square, amperes);
            }
        }
        for l in 0..N {
            k[l] *= left[l];
        }
    }

    /// Scales the back-EMF coefficients of all phases to those of a flux that saturates.
    ///
    /// * `i` currents of the first two phases
    #[inline(always)]
    pub fn saturate_flux(&self, i: [&[f64; N]; 2], k: [&mut [f64; N]; 3]) {
        let mut left = [1.0; N];
        for s in self.slots.iter().filter(|s| s.kind == EffectKind::TorqueSaturation) {
            for l in 0..N {
                let (a, b) = (i[0][l], i[1][l]);
                let size = 0.5 * (a.abs() + b.abs() + (a + b).abs());
                let coefficient = s.values[0][l] * s.values[1][l];
                left[l] *= equations::flux_left(coefficient, size / self.amperes[l]);
            }
        }
        for k in k {
            for l in 0..N {
                k[l] *= left[l];
            }
        }
    }

    /// Works out the torque of what has a state in a lane, beside what [`LaneEffects::level`] says.
    ///
    /// * `th` angle from rest [rad], `turn` speed, `fd` dynamic friction without effects
    #[inline]
    pub fn mechanical(&mut self, l: usize, th: f64, turn: f64, fd: f64) {
        let Some(e) = &mut self.lanes[l] else { return };
        let newton_metre = self.newton_metre[l];
        let (omega, friction, mut torque) = (turn * self.rad_per_s[l], self.sum.friction[l], self.sum.torque[l]);
        if let Some(b) = &mut e.bristles {
            b.slide_at(fd / newton_metre, friction, omega);
            torque += b.step(omega, self.dt);
        }
        if let Some(b) = &e.behind {
            torque += b.torque(th, omega, self.dt);
            self.felt.th[l] = th;
        }
        self.felt.torque[l] = torque * newton_metre;
    }

    /// Whether any lane needs [`LaneEffects::mechanical`].
    pub fn has_state(&self) -> bool {
        self.stateful
    }

    /// Whether any lane needs [`LaneEffects::saturate`].
    pub fn is_saturated(&self) -> bool {
        self.saturated
    }

    /// Whether any lane needs [`LaneEffects::saturate_flux`].
    pub fn has_flux(&self) -> bool {
        self.flux
    }

    /// Whether any lane needs [`LaneEffects::user`].
    pub fn has_behind(&self) -> bool {
        self.behind
    }

    /// Whether any lane needs [`LaneEffects::electrical`].
    pub fn is_electrical(&self) -> bool {
        self.electrical
    }

    /// The angle that moves the user, from rest [rad], after a step which turned the motor by
    /// `moved` to `th`.
    #[inline]
    pub fn user(&mut self, l: usize, th: f64, moved: f64) -> f64 {
        match self.lanes[l].as_mut().and_then(|e| e.behind.as_mut()) {
            Some(b) => b.step(self.felt.th[l], moved / self.dt, self.dt).1,
            None => th,
        }
    }
}
