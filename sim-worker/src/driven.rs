//! One actuator that is driven from outside: whoever knows command and load only as time goes on, a co-simulation for
//! example, hands them over step by step. A run whose sequence is known before goes through [`crate::simulate`].

use crate::test_bench::{Lane, NumericalTestBench};
use schemas::channel::{Channel, ChannelSet, Sampling};
use schemas::error::{Error, Result};
use schemas::fault::FaultState;
use std::sync::Arc;

/// The numerical test bench of one actuator, step by step; driven by the commands of a sequence it gives the samples of
/// [`crate::simulate::simulate`], bit for bit.
///
/// ```
/// use schemas::{Channel, FaultState};
/// use sim_worker::{ActuatorParameters, DrivenBench, Lane};
///
/// let mut bench = DrivenBench::new(Lane {
///     actuator: ActuatorParameters::reference().into(),
///     fault: FaultState { fsj: 3.0, zeta: 0.25 },
///     rest_angle_rad: 0.0,
///     load_n_m: 0.0,
/// });
/// for _ in 0..200 {
///     bench.next_interval();
///     bench.advance(&[0.1; 100]); // 0.1 ms
/// }
/// assert_eq!(bench.steps(), 20_000);
/// assert!(bench.sample(Channel::ThetaM) > 0.0);
/// ```
#[derive(Clone)]
pub struct DrivenBench {
    lane: Lane,
    bench: NumericalTestBench<1>,
    /// of the last step [rad]
    com: f64,
}

/// What [`DrivenBench::sample`] knows.
fn channels() -> ChannelSet {
    ChannelSet::of(DrivenBench::channels())
}

impl DrivenBench {
    /// At rest, command 0, under the load of the lane.
    pub fn new(lane: Lane) -> Self {
        Self {
            bench: NumericalTestBench::new(std::slice::from_ref(&lane), channels()),
            lane,
            com: 0.0,
        }
    }

    /// The channels that it gives samples of: all but the winding temperature, which the model has not.
    pub fn channels() -> impl Iterator<Item = Channel> {
        crate::catalogue::simulated()
    }

    /// Length of a step [s].
    pub fn step_s(&self) -> f64 {
        self.lane.actuator.step_s
    }

    /// Steps done.
    pub fn steps(&self) -> u64 {
        self.bench.step()
    }

    /// Faults, rest angle, present load.
    pub fn lane(&self) -> &Lane {
        &self.lane
    }

    /// Starts a new telemetry interval: means are over the steps since.
    pub fn next_interval(&mut self) {
        self.bench.next_interval();
    }

    /// A step for each command [rad, user side], under the present load.
    pub fn advance(&mut self, com: &[f64]) {
        if let Some(last) = com.last() {
            self.bench.advance(com);
            self.com = *last;
        }
    }

    /// Another load torque from the next step on, positive against positive motion [N m, motor side].
    pub fn set_load(&mut self, load_n_m: f64) {
        if load_n_m.to_bits() != self.lane.load_n_m.to_bits() {
            self.lane.load_n_m = load_n_m;
            self.bench.set_load(0, load_n_m);
        }
    }

    /// Other faults from the next step on; the motion goes on.
    pub fn set_fault(&mut self, fault: FaultState) {
        if fault != self.lane.fault {
            self.lane.fault = fault;
            let mut bench = NumericalTestBench::new(std::slice::from_ref(&self.lane), channels());
            bench.go_on_from(&self.bench);
            self.bench = bench;
        }
    }

    /// The sample of `channel` for the steps since [`DrivenBench::next_interval`], in the channel's unit. Before the first of
    /// them means are 0; [`Channel::Temperature`] is NaN.
    pub fn sample(&self, channel: Channel) -> f64 {
        match channel {
            Channel::Com => self.com,
            // no mean of steps, but what the source gives
            Channel::VDc => self.bench.samples(channel)[0],
            _ if channel.sampling() == Sampling::Mean && self.bench.interval() == 0 => 0.0,
            _ => self.bench.samples(channel)[0],
        }
    }

    /// Refuses a state that is no longer finite, as [`crate::simulate::simulate`] does.
    ///
    /// # Errors
    /// A sample that is no number: parameters may each be allowed and together be more than the step can follow.
    pub fn check_finite(&self) -> Result<()> {
        let samples = Self::channels().map(|c| (c, self.sample(c)));
        match samples.into_iter().find(|(_, x)| !x.is_finite()) {
            Some((channel, x)) => Err(Error::bad(
                format!("actuator `{}`", self.lane.actuator.name),
                format!("{} at step {}", channel.name(), self.steps()),
                x,
                "finite values: parameters or inputs too extreme for the model, or a step_s too long for them",
            )),
            None => Ok(()),
        }
    }

    /// All numbers that steps change, to be put into [`DrivenBench::restore`] of a bench of the same actuator.
    pub fn state(&self) -> Vec<f64> {
        let mut all = vec![self.com, self.lane.load_n_m];
        self.bench.clone().each(&mut |x| all.push(*x));
        all
    }

    /// Goes back to a state, bit for bit; faults and rest angle are not part of it.
    ///
    /// # Errors
    /// Another number of numbers than [`DrivenBench::state`] gives for this actuator; the bench then is as it was.
    pub fn restore(&mut self, state: &[f64]) -> Result<()> {
        let here = self.state().len();
        if state.len() != here {
            let allowed = format!("{here}, of this very actuator");
            return Err(Error::bad("state", "numbers", state.len(), allowed));
        }
        self.com = state[0];
        self.lane.load_n_m = state[1];
        self.bench.set_load(0, state[1]);
        let mut next = state[2..].iter();
        self.bench.each(&mut |x| *x = next.next().copied().unwrap_or(*x));
        Ok(())
    }

    /// The actuator.
    pub fn actuator(&self) -> &Arc<crate::parameters::ActuatorParameters> {
        &self.lane.actuator
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::{Effect, EffectKind};
    use crate::parameters::ActuatorParameters;

    fn lane(effects: Vec<Effect>, load_n_m: f64) -> Lane {
        let mut actuator = ActuatorParameters::reference();
        actuator.effects = effects;
        Lane {
            actuator: actuator.into(),
            fault: FaultState { fsj: 3.0, zeta: 0.3 },
            rest_angle_rad: 0.4,
            load_n_m,
        }
    }

    /// Effects of every kind that remembers something, and those that know the load.
    fn with_memory() -> Vec<Effect> {
        vec![
            Effect::new(EffectKind::LoadDependentFriction, &[0.2]),
            Effect::new(EffectKind::Presliding, &[200.0, 0.001]),
            Effect::new(EffectKind::Compliance, &[50.0, 0.001, 5e-6]),
            Effect::new(EffectKind::SupplySag, &[0.1]),
            Effect::new(EffectKind::ControlDelay, &[20e-6]),
            Effect::new(EffectKind::Cogging, &[0.001, 0.3, 12.0]),
        ]
    }

    fn samples(b: &DrivenBench) -> Vec<u64> {
        DrivenBench::channels().map(|c| b.sample(c).to_bits()).collect()
    }

    /// Samples of `n` intervals of 0.1 ms.
    fn go(b: &mut DrivenBench, n: usize, com: f64) -> Vec<Vec<u64>> {
        (0..n)
            .map(|_| {
                b.next_interval();
                b.advance(&[com; 100]);
                samples(b)
            })
            .collect()
    }

    #[test]
    fn prop_a_load_that_is_set_is_the_load_of_the_lane() {
        for effects in [Vec::new(), with_memory()] {
            let mut a = DrivenBench::new(lane(effects.clone(), 0.1));
            let mut b = DrivenBench::new(lane(effects, 0.0));
            b.set_load(0.1);
            assert_eq!(go(&mut a, 100, 0.2), go(&mut b, 100, 0.2));
        }
    }

    #[test]
    fn prop_a_state_that_is_put_back_goes_on_with_the_same_bits() {
        for effects in [Vec::new(), with_memory()] {
            let mut a = DrivenBench::new(lane(effects.clone(), 0.05));
            go(&mut a, 50, 0.2);
            a.advance(&[0.2; 33]);
            let mut b = DrivenBench::new(lane(effects, 0.0));
            let mut copy = a.clone();
            b.restore(&a.state()).unwrap();
            assert_eq!(samples(&a), samples(&b));
            let next = go(&mut a, 100, -0.1);
            assert_eq!(next, go(&mut b, 100, -0.1));
            assert_eq!(next, go(&mut copy, 100, -0.1));
        }
        let mut b = DrivenBench::new(lane(Vec::new(), 0.0));
        assert!(b.restore(&[0.0; 3]).is_err());
    }

    #[test]
    fn prop_faults_change_on_the_way() {
        for effects in [Vec::new(), with_memory()] {
            let healthy = Lane {
                fault: FaultState::NOMINAL,
                ..lane(effects, 0.0)
            };
            // at rest it is the same as having been so from the start
            let mut a = DrivenBench::new(healthy.clone());
            a.set_fault(FaultState { fsj: 3.0, zeta: 0.3 });
            let mut b = DrivenBench::new(lane(healthy.actuator.effects.clone(), 0.0));
            assert_eq!(go(&mut a, 20, 0.2), go(&mut b, 20, 0.2));
            // on the way position and speed stay, and friction slows it
            let mut a = DrivenBench::new(healthy);
            go(&mut a, 500, 1.0);
            let before = (a.sample(Channel::ThetaM), a.sample(Channel::OmegaM));
            a.set_fault(FaultState { fsj: 5.0, zeta: 0.0 });
            assert_eq!(before, (a.sample(Channel::ThetaM), a.sample(Channel::OmegaM)));
            go(&mut a, 1000, 1.0);
            let slower = a.sample(Channel::OmegaM);
            assert!(
                slower < 0.97 * before.1 && slower > 0.5 * before.1,
                "{slower} {before:?}"
            );
        }
    }
}
