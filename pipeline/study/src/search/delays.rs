//! Delays between the channels that a bench does not say: found before anything else, and looked at again beside what was found since.

use crate::equations::clock::MOST_DELAY_S;
use crate::measured::bench::{Bench, BenchChannel, ChannelSpec};
use crate::search::fit::{self, Fit, Term};
use crate::search::select::Material;
use sim_worker::effect::Equation;

/// Greatest delay of a round [s].
const DELAY_STEP_S: f64 = 2.5e-3;
/// Rounds, smallest delay that is moved for [samples], and smallest gain in log-likelihood (assumed).
const DELAY_ROUNDS: usize = 6;
const LEAST_DELAY: f64 = 0.4;
const LEAST_DELAY_GAIN: f64 = 8.0;
const LEAST_VOLTAGE_DELAY: f64 = 1.5;
/// Delays that differ by less are one [s] (assumed).
const SAME_DELAY_S: f64 = 1e-9;

impl Material {
    /// Delays between the channels that the bench does not say, found before anything else: the clocks of the
    /// sensors are let go, and moved as long as that tells more than chance.
    ///
    /// * `terms` effects that are in the model already
    pub fn on_time(self, terms: &[Term]) -> Self {
        let clocks = [
            ("drive_clock", self.bench.rig.drive),
            ("velocity_clock", BenchChannel::Velocity),
            ("voltage_clock", BenchChannel::Voltage),
            ("user_clock", BenchChannel::UserPosition),
        ];
        if self.clock.steady {
            return self;
        }
        let mut m = self;
        let mut tied = m.solve(terms, m.first_sigma());
        for _ in 0..DELAY_ROUNDS {
            let rate = m.clock.rate_hz;
            let mut free = m.nuisances.clone();
            for n in free.iter_mut().filter(|n| clocks.iter().any(|c| c.0 == n.name)) {
                n.trust = Some(MOST_DELAY_S * rate);
            }
            let loose = fit::solve(&m.fit, &m.constants, &free, terms, tied.sigma);
            let mut bench = m.bench.clone();
            let mut moved = false;
            for (n, x) in m.nuisances.iter().zip(&loose.nuisance) {
                let Some((_, channel)) = clocks.iter().find(|c| c.0 == n.name) else {
                    continue;
                };
                // a voltage that is a little late looks like more inductance
                let least = if *channel == BenchChannel::Voltage {
                    LEAST_VOLTAGE_DELAY
                } else {
                    LEAST_DELAY
                };
                if x.abs() < least {
                    continue;
                }
                // a column is what its channel would show a sample earlier
                let late = -x.clamp(-DELAY_STEP_S * rate, DELAY_STEP_S * rate) / rate;
                let spec = bench
                    .channels
                    .iter_mut()
                    .find(|s| s.channel == *channel)
                    .expect("it has a clock");
                if (spec.delay_s + late - m.said_delay(*channel)).abs() <= MOST_DELAY_S {
                    spec.delay_s += late;
                    moved = true;
                }
            }
            if !moved {
                break;
            }
            let tried = |bench: Bench| {
                let next = m.again(bench, m.nuisances.clone(), m.excess);
                let fit = next.solve(terms, next.first_sigma());
                (next, fit)
            };
            // a motion that is early beside all that is electrical, or a drive that is late by itself, where the first leaves more
            // than noise: an inductance takes half of what a current that is moved away from its voltage should not have
            let together = m.with_voltage(&bench).map(&tried);
            let quiet = |(next, fit): &(Self, Fit)| {
                let e = Equation::Electrical;
                fit.score.energy[e.index()] < next.fit.sensor_energy(e.index())
            };
            let (next, again) = match together {
                Some(all) if quiet(&all) => all,
                Some(all) => {
                    let alone = tried(bench);
                    let better = alone.1.score.log_likelihood > all.1.score.log_likelihood;
                    if better { alone } else { all }
                }
                None => tried(bench),
            };
            if again.score.log_likelihood - tied.score.log_likelihood < next.least_gain(&again) {
                break;
            }
            (m, tied) = (next, again);
        }
        m
    }

    /// Gain in log-likelihood from which a delay is one: what is far beyond the noise is no noise, and any shift takes a little of it.
    fn least_gain(&self, fit: &Fit) -> f64 {
        let beyond = |e: &Equation| fit.score.energy[e.index()] / self.fit.sensor_energy(e.index()).max(1e-300);
        LEAST_DELAY_GAIN * self.equations.iter().map(beyond).fold(1.0, f64::max)
    }

    /// Without those of the delays found that the data do not need beside a model: before its effects were in it, their gap had
    /// looked like a delay. All of them, or those that are as late together.
    ///
    /// * `model` polished on this material
    pub fn needed_delays(self, model: Fit) -> (Self, Fit) {
        let mut rest = self.found_delays();
        let mut groups: Vec<Vec<BenchChannel>> = Vec::new();
        while let Some(&(_, late)) = rest.first() {
            let (group, others): (Vec<_>, Vec<_>) = rest.into_iter().partition(|f| (f.1 - late).abs() < SAME_DELAY_S);
            groups.push(group.into_iter().map(|f| f.0).collect());
            rest = others;
        }
        if groups.len() > 1 {
            groups.insert(0, groups.concat());
        }
        let (mut m, mut model) = (self, model);
        for (i, group) in groups.iter().enumerate() {
            let mut bench = m.bench.clone();
            for spec in bench.channels.iter_mut().filter(|s| group.contains(&s.channel)) {
                spec.delay_s = m.said_delay(spec.channel);
            }
            let next = m.again(bench, m.nuisances.clone(), m.excess);
            let fit = next.polish(&next.solve(&model.terms, model.sigma), 1);
            if fit.score.log_likelihood > model.score.log_likelihood - m.least_gain(&model) {
                (m, model) = (next, fit);
                if i == 0 {
                    break;
                }
            }
        }
        (m, model)
    }

    /// The same bench, with the voltages as late as the drive became and the drive alone was not; `None` where no single
    /// voltage was measured beside it.
    fn with_voltage(&self, moved: &Bench) -> Option<Bench> {
        let drive = moved.rig.drive;
        let delay = |b: &Bench, c: BenchChannel| b.channel(c).map(|s| s.delay_s);
        let late = delay(moved, drive)? - delay(&self.bench, drive)?;
        if late == 0.0 || drive == BenchChannel::Voltage || self.bench.has_phases() {
            return None;
        }
        let before = delay(&self.bench, BenchChannel::Voltage)?;
        let mut bench = moved.clone();
        for spec in &mut bench.channels {
            match spec.channel {
                BenchChannel::Voltage => spec.delay_s = before + late,
                BenchChannel::VDc => spec.delay_s += late,
                _ => {}
            }
        }
        Some(bench)
    }

    /// Delay that the bench itself says [s].
    fn said_delay(&self, c: BenchChannel) -> f64 {
        self.said.iter().find(|s| s.0 == c).map_or(0.0, |s| s.1)
    }

    /// Delays of channels that were found beyond what the bench says [s].
    pub fn found_delays(&self) -> Vec<(BenchChannel, f64)> {
        let found = |s: &ChannelSpec| (s.channel, s.delay_s - self.said_delay(s.channel));
        self.bench.channels.iter().map(found).filter(|d| d.1 != 0.0).collect()
    }
}
