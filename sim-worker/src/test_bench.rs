//! The numerical test bench (paper 3.1): N actuators side by side, stepped together.

use crate::effect::LaneEffects;
use crate::lanes::{self, Constants, InstructionSet, RESYNC_STEPS, State, Sums, Units, term};
use crate::parameters::ActuatorParameters;
use crate::simulate::LANES;
use schemas::channel::{Channel, ChannelSet};
use schemas::fault::FaultState;
use std::sync::Arc;

/// What one lane simulates.
#[derive(Clone, Debug)]
pub struct Lane {
    /// parameters; lanes may differ in all of them but the step
    pub actuator: Arc<ActuatorParameters>,
    /// faults of this lane
    pub fault: FaultState,
    /// motor angle at rest [rad]
    pub rest_angle_rad: f64,
    /// constant load torque, positive against positive motion [N m, motor side]
    pub load_n_m: f64,
}

/// One over the kernel's units, for sampling.
#[derive(Clone)]
struct Inverse<const N: usize> {
    ampere: [f64; N],
    half_ampere: [f64; N],
    volt: [f64; N],
    newton_metre: [f64; N],
    rad_per_s: [f64; N],
}

/// Numerical test bench of N lanes. All start at rest: position and currents 0, relays at +1.
#[derive(Clone)]
pub struct NumericalTestBench<const N: usize> {
    set: InstructionSet,
    constants: Constants<N>,
    state: State<N>,
    sums: Sums<N>,
    effects: Box<LaneEffects<N>>,
    has_effects: bool,
    inverse: Inverse<N>,
    supply_voltage_v: [f64; N],
    same: bool,
    loaded: bool,
    /// more than the basic channels
    extra: bool,
    step: u64,
    interval: u64,
    /// sums of the last step alone, of an interval that was advanced to points
    of_last: Sums<N>,
}

/// What is compiled once for each number of lanes, here rather than in every crate that uses it: the
/// kernel is heavy.
pub trait Built<const N: usize> {
    /// All lanes at rest; lanes without an entry do as the last.
    ///
    /// * `channels` that will be asked for; the sums of others are left out
    fn at_rest(lanes: &[Lane], channels: ChannelSet, set: InstructionSet) -> NumericalTestBench<N>;
    /// A step for each command [rad, user side].
    fn advance(bench: &mut NumericalTestBench<N>, com: &[f64]);
}

/// The kernel; the numbers of lanes that it is built for are those for which it is [`Built`].
pub struct Kernel;

macro_rules! built {
    ($($n:expr),+) => {
        $(impl Built<{ $n }> for Kernel {
            fn at_rest(lanes: &[Lane], channels: ChannelSet, set: InstructionSet) -> NumericalTestBench<{ $n }> {
                NumericalTestBench::prepare(lanes, channels, set)
            }
            fn advance(bench: &mut NumericalTestBench<{ $n }>, com: &[f64]) {
                bench.steps(com);
            }
        })+
    };
}

built!(1, LANES / 2, LANES);

impl<const N: usize> NumericalTestBench<N>
where
    Kernel: Built<N>,
{
    /// * `lanes` one to N; where there are fewer the last is repeated
    /// * `channels` additional channels make every step a little dearer
    ///
    /// # Panics
    /// If `lanes` is empty or the lanes have different steps.
    pub fn new(lanes: &[Lane], channels: ChannelSet) -> Self {
        Self::with_instruction_set(lanes, channels, InstructionSet::detect())
    }

    /// As [`NumericalTestBench::new`] on a given instruction set.
    pub fn with_instruction_set(lanes: &[Lane], channels: ChannelSet, set: InstructionSet) -> Self {
        Kernel::at_rest(lanes, channels, set)
    }

    /// Steps all lanes through `com` [rad], one command a step.
    pub fn advance(&mut self, com: &[f64]) {
        Kernel::advance(self, com);
    }

    /// As [`NumericalTestBench::advance`], for [`NumericalTestBench::points`].
    pub fn advance_to_points(&mut self, com: &[f64]) {
        let Some((last, most)) = com.split_last() else { return };
        Kernel::advance(self, most);
        let before = std::mem::take(&mut self.sums);
        Kernel::advance(self, std::slice::from_ref(last));
        self.of_last.clone_from(&self.sums);
        self.sums.add(&before);
    }
}

impl<const N: usize> NumericalTestBench<N> {
    fn prepare(lanes: &[Lane], channels: ChannelSet, set: InstructionSet) -> Self {
        let dt = lanes[0].actuator.step_s;
        assert!(
            lanes.iter().all(|l| l.actuator.step_s == dt),
            "lanes of different steps"
        );
        let mut constants = Constants::default();
        let mut state = State::default();
        let mut effects = Box::<LaneEffects<N>>::default();
        let at = |l: usize| &lanes[l.min(lanes.len() - 1)];
        for l in 0..N {
            constants.set(l, &at(l).actuator, at(l).fault, at(l).rest_angle_rad, at(l).load_n_m);
            effects.push(&at(l).actuator, at(l).fault, at(l).rest_angle_rad, at(l).load_n_m);
        }
        state.ma = constants.hb;
        state.mb = constants.hb;
        state.mc = constants.hb;
        let felt = &effects.felt.sensor;
        for (m, offset) in [
            (&mut state.ma, felt[0]),
            (&mut state.mb, felt[1]),
            (&mut state.mc, felt[2]),
        ] {
            m.iter_mut().zip(offset).for_each(|(m, offset)| *m -= offset);
        }
        let loaded = lanes.iter().any(|l| l.load_n_m != 0.0);
        let extra = channels.iter().any(|c| !c.is_basic());
        let units: [Units; N] = std::array::from_fn(|l| Units::new(&at(l).actuator));
        Self {
            set,
            inverse: Inverse {
                ampere: units.map(|u| 1.0 / u.ampere),
                half_ampere: units.map(|u| 0.5 / u.ampere),
                volt: units.map(|u| 1.0 / u.volt),
                newton_metre: units.map(|u| 1.0 / u.newton_metre),
                rad_per_s: units.map(|u| 1.0 / u.rad_per_s),
            },
            supply_voltage_v: std::array::from_fn(|l| at(l).actuator.supply_voltage_v),
            same: lanes
                .iter()
                .all(|l| Arc::ptr_eq(&l.actuator, &lanes[0].actuator) && l.load_n_m == lanes[0].load_n_m),
            has_effects: effects.any(),
            effects,
            loaded,
            extra,
            constants,
            state,
            sums: Sums::default(),
            step: 0,
            interval: 0,
            of_last: Sums::default(),
        }
    }

    fn steps(&mut self, mut com: &[f64]) {
        self.interval += com.len() as u64;
        while !com.is_empty() {
            if self.step.is_multiple_of(RESYNC_STEPS) {
                lanes::resync(self.set, &self.constants, &mut self.state);
            }
            let n = (RESYNC_STEPS - self.step % RESYNC_STEPS).min(com.len() as u64) as usize;
            let (now, later) = com.split_at(n);
            let (set, same) = (self.set, self.same);
            let (k, st, sum) = (&self.constants, &mut self.state, &mut self.sums);
            let fx = &mut *self.effects;
            const LOADED: u32 = term::STOPS | term::LOAD;
            const ALL: u32 = LOADED | term::EXTRA;
            const CURRENTS: u32 = term::EFFECTS | term::CURRENTS;
            if self.has_effects && self.extra {
                lanes::steps::<N, { ALL | CURRENTS }>(set, same, k, st, sum, fx, now);
            } else if self.has_effects && fx.reach_currents() {
                lanes::steps::<N, { LOADED | CURRENTS }>(set, same, k, st, sum, fx, now);
            } else if self.has_effects {
                lanes::steps::<N, { LOADED | term::EFFECTS }>(set, same, k, st, sum, fx, now);
            } else if self.loaded || self.extra {
                lanes::steps::<N, ALL>(set, same, k, st, sum, fx, now);
            } else if Self::stops_within_reach(k, st, n) {
                lanes::steps::<N, { term::STOPS }>(set, same, k, st, sum, fx, now);
            } else {
                lanes::steps::<N, 0>(set, same, k, st, sum, fx, now);
            }
            self.step += n as u64;
            com = later;
        }
    }

    /// Whether any lane could touch an end stop within `n` steps at the greatest torque.
    fn stops_within_reach(k: &Constants<N>, st: &State<N>, n: usize) -> bool {
        let n = n as f64;
        (0..N).any(|l| st.th[l].abs() + n * (st.turn[l].abs() + n * (k.t_max[l] + k.load[l].abs())) >= k.stop[l])
    }

    /// Number of steps done.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// The samples of `channel` of all lanes for the interval since
    /// [`NumericalTestBench::next_interval`]; `Com` is not the bench's to know.
    #[inline]
    pub fn samples(&self, channel: Channel) -> [f64; N] {
        self.of_sums(channel, &self.sums, self.interval)
    }

    /// As [`NumericalTestBench::samples`] after [`NumericalTestBench::advance_to_points`], with currents at the end of the
    /// interval.
    pub fn points(&self, channel: Channel) -> [f64; N] {
        match channel {
            Channel::IA | Channel::IB | Channel::IC | Channel::IEq | Channel::IQ => {
                self.of_sums(channel, &self.of_last, 1)
            }
            _ => self.samples(channel),
        }
    }

    #[inline]
    fn of_sums(&self, channel: Channel, sum: &Sums<N>, steps: u64) -> [f64; N] {
        let (st, k) = (&self.state, &self.constants);
        let per_step = 1.0 / steps as f64;
        let mean = |sum: &[f64; N], unit: &[f64; N]| std::array::from_fn(|l| sum[l] * (unit[l] * per_step));
        let u = &self.inverse;
        match channel {
            Channel::Com | Channel::Temperature => [f64::NAN; N],
            Channel::ThetaU => std::array::from_fn(|l| st.th_u[l] / k.n[l]),
            Channel::ThetaM => std::array::from_fn(|l| {
                let theta = k.th0[l] + st.th[l];
                self.effects.lane(l).map_or(theta, |e| theta + e.angle_error(theta))
            }),
            Channel::OmegaM => std::array::from_fn(|l| {
                let (omega, theta) = (st.turn[l] * u.rad_per_s[l], k.th0[l] + st.th[l]);
                self.effects.lane(l).map_or(omega, |e| omega * e.seen_speed(theta))
            }),
            Channel::IEq => mean(&sum.abs, &u.half_ampere),
            Channel::IA => mean(&sum.ia, &u.ampere),
            Channel::IB => mean(&sum.ib, &u.ampere),
            Channel::IC => std::array::from_fn(|l| {
                if self.effects.felt.uneven[l] {
                    return sum.ic[l] * (u.ampere[l] * per_step);
                }
                let offsets = self.effects.felt.sensors[l] * steps as f64;
                -(sum.ia[l] + sum.ib[l] - offsets) * (u.ampere[l] * per_step)
            }),
            Channel::VA => mean(&sum.va, &u.volt),
            Channel::VB => mean(&sum.vb, &u.volt),
            Channel::VC => mean(&sum.vc, &u.volt),
            Channel::TorqueM => mean(&sum.torque, &u.newton_metre),
            Channel::IQ => mean(&sum.iq, &u.ampere),
            Channel::ISupply => mean(&sum.supply, &u.ampere),
            Channel::VDc => {
                let drawn = mean(&sum.supply, &u.ampere);
                std::array::from_fn(|l| self.supply_voltage_v[l] - self.effects.sag(l, drawn[l]))
            }
        }
    }

    /// Another load torque for lane `l`, from the next step on.
    ///
    /// * `load_n_m` positive against positive motion [N m, motor side]
    pub fn set_load(&mut self, l: usize, load_n_m: f64) {
        self.constants.load[l] = self.effects.set_load(l, load_n_m);
        self.loaded |= load_n_m != 0.0;
        // lanes of one actuator read the load of the first
        self.same &= N == 1;
    }

    /// Goes on from where `other` is, a bench of the same actuators at other faults. The angle's vector is started
    /// anew, since eccentricity enters there.
    pub(crate) fn go_on_from(&mut self, other: &Self) {
        self.state = other.state.clone();
        self.sums = other.sums.clone();
        (self.step, self.interval) = (other.step, other.interval);
        self.effects.go_on_from(&other.effects);
        self.loaded |= other.loaded;
        self.extra |= other.extra;
        lanes::resync(self.set, &self.constants, &mut self.state);
    }

    /// Shows every number that a step changes to `see`, which may put back an earlier one; always in the same order.
    pub(crate) fn each(&mut self, see: &mut dyn FnMut(&mut f64)) {
        self.state.each(see);
        self.sums.each(see);
        self.effects.each(see);
        for count in [&mut self.step, &mut self.interval] {
            let mut x = *count as f64;
            see(&mut x);
            *count = x as u64;
        }
    }

    /// Steps since the last [`NumericalTestBench::next_interval`].
    pub(crate) fn interval(&self) -> u64 {
        self.interval
    }

    /// Starts a new telemetry interval.
    pub fn next_interval(&mut self) {
        self.sums = Sums::default();
        self.interval = 0;
    }
}
