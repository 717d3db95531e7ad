//! What the simulators say of a study of an actuator: the test bench under the recorded command, with the parameters as they were and with
//! what was found. The loop tells what no equation does, and what it does not bear out is not named.

use crate::interruptible::interruptible;
use anyhow::Result;
use ema_study::measured::bench::{Bench, BenchChannel};
use ema_study::search::beside::Beside;
use ema_study::search::study::Outcome;
use ema_study::search::verdict::Verdict;
use ema_study::told::findings::{Findings, Identified};
use ema_study::told::loop_effects::{self, Shown, Told};
use ema_study::told::verify::{self, Verification};
use ema_study::told::{in_loop, scale, sensors, source};
use sim_worker::effect::{EffectKind, Law};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::CurrentSampling;

/// Gap of the simulated motion over that without what was found, from which on it is no model of the actuator (assumed).
const FURTHER: f64 = 2.0;

/// Gap of the simulated speed over the noise of its sensor from which on the loop moves otherwise (assumed: with a torque that does
/// saturate it was 1.0, with a mass behind a spring in its place 3.8).
const SHAKEN: f64 = 2.0;

/// Gap of the simulated angle from which an actuator goes astray (assumed: with its constants right it was up to 0.03) [rad].
const ASTRAY_RAD: f64 = 0.05;
/// Gap of the simulated supply over the noise of its sensor up to which it is as it was measured (assumed).
const FED: f64 = 1.5;
/// Gaps of the simulated loop over those with another effect of the same torque, below which it is the one (assumed).
const NEARER: f64 = 0.95;
/// Constants that voltages tell.
const TOLD_BY_VOLTAGES: [&str; 3] = ["torque_constant", "resistance", "supply_voltage"];
/// Constants that the torque of currents tells that are means.
const TOLD_BY_TORQUE: [&str; 3] = ["inertia", "viscous", "coulomb"];

/// Text of an actuator's file, or why there is none.
type Made = schemas::error::Result<String>;

/// A study of an actuator, and how it is told.
pub(super) struct Judge<'a> {
    /// as it was
    pub actuator: &'a ActuatorParameters,
    /// what is said of an outcome
    pub told: &'a dyn Fn(&Outcome) -> Findings,
    /// the actuator's file with what was found
    pub made: &'a dyn Fn(&Findings) -> Made,
    pub tell_user: &'a dyn Fn(&str),
}

/// What a study comes to with all that the simulators say.
pub(super) struct Judged {
    pub findings: Findings,
    pub made: Made,
    /// the bench, with the jumps of its commands where the motion shows them
    pub bench: Bench,
}

/// An outcome as it is told, made and simulated.
struct Stand {
    findings: Findings,
    made: Made,
    child: ActuatorParameters,
    verification: Verification,
}

impl Stand {
    /// Some constants and their standard deviations, relative.
    fn told(&self, names: &[&str]) -> Vec<(String, f64)> {
        let of = |c: &Identified| (c.name.clone(), 0.25 * (c.hi - c.lo) / c.value.abs().max(1e-300));
        let all = self.findings.retuned.iter();
        all.filter(|c| names.contains(&c.name.as_str())).map(of).collect()
    }
}

impl Judge<'_> {
    /// * `findings`, `made` of the outcome as it is
    ///
    /// # Errors
    /// Recordings that cannot be read; where it was interrupted.
    pub fn judged(&self, mut bench: Bench, outcome: &mut Outcome, findings: Findings, made: Made) -> Result<Judged> {
        bench.made_of_angle = outcome.material.bench.made_of_angle;
        let now = self.simulated(&mut bench, outcome, findings, made)?;
        let mut now = self.with_loop(&mut bench, outcome, now)?;
        let mut against = Vec::new();
        // points of a current that chatters do not tell its scale
        let of_scale = |b: &Beside| b.kind == EffectKind::CurrentGain && b.law == Law::First;
        if bench.own
            && let Some(at) = outcome.beside.iter().position(of_scale)
            && self.sampling(&bench, &now)? == CurrentSampling::Point
        {
            outcome.beside.remove(at);
            if outcome.model.terms.is_empty() && outcome.beside.is_empty() {
                outcome.verdict = Verdict::Retune;
            }
            now = self.again(&mut bench, outcome)?;
            let text = "constants are off as by a gain of all current sensors, which are read at points: as well it may be what points \
                        leave out of a current that chatters";
            against.push(text.to_string());
        }
        // a phase that lost turns moves the motor otherwise than one whose sensor says too much
        if outcome.verdict != Verdict::None && outcome.exchange_short_and_gain() {
            let before = std::mem::take(&mut outcome.by_loop);
            let mut of_other = bench.clone();
            let other = self.again(&mut of_other, outcome)?;
            let other = self.with_loop(&mut of_other, outcome, other)?;
            if nearer(&other.verification, &now.verification) < NEARER {
                outcome.rank_exchanged();
                bench = of_other;
                now = other;
                now.findings = (self.told)(outcome);
                now.made = (self.made)(&now.findings);
            } else {
                outcome.exchange_short_and_gain();
                outcome.by_loop = before;
            }
            let text = "in the torque a phase that lost turns and one whose sensor says too much are alike: the simulated currents and \
                        speed say which";
            against.push(text.to_string());
        }
        let (of_source, of) = (bench.clone(), now.child.clone());
        outcome.source = interruptible(self.tell_user, move |_| source::by_loop(&of_source, &of))??;
        if outcome.source.is_some() {
            now = self.again(&mut bench, outcome)?;
        }
        let late = self.late_control(&bench, &now, outcome)?;
        let found = match late {
            Some(late) => Some(late),
            None => match self.of_loop(&bench, &now, outcome)? {
                // where the equations see something that they have no name for, it is that effect if the loop then moves as it
                // was measured
                Shown::Effect(f) if f.settles || outcome.verdict != Verdict::Unknown => Some(f.beside),
                Shown::Effect(_) | Shown::Nothing => None,
                Shown::Stranger(rms) => {
                    outcome.verdict = Verdict::Unknown;
                    now.findings = (self.told)(outcome);
                    against.push(format!(
                        "the simulated loop moves otherwise than was measured, by {rms:.1} rad/s at the motor, whatever its constants; \
                         no one effect of the list explains it"
                    ));
                    None
                }
            },
        };
        if let Some(found) = found {
            if outcome.verdict == Verdict::Unknown {
                outcome.verdict = Verdict::Retune;
            }
            outcome.verdict = outcome.verdict.beside(std::slice::from_ref(&found));
            outcome.beside.push(found);
            now = self.again(&mut bench, outcome)?;
        }
        // what strong currents say of their torque, they say of a mass behind a spring too: the loop moves as was measured, or
        // it is something else
        let saturates = |b: &Beside| b.kind == EffectKind::TorqueSaturation;
        if is_shaken(&now.verification, outcome)
            && let Some(at) = outcome.beside.iter().position(saturates)
        {
            outcome.beside.remove(at);
            outcome.verdict = Verdict::Unknown;
            now = self.again(&mut bench, outcome)?;
            let text = "strong currents give less torque than their flux makes, but the simulated loop with a torque that \
                        saturates moves otherwise than was measured: something that springs or comes loose, say";
            against.push(text.to_string());
        }
        // what is to be missing brings the simulated actuator nearer to what was measured, or it is not that
        let away = further_away(&now.verification);
        if let Some(text) = away.filter(|_| outcome.verdict != Verdict::None) {
            outcome.verdict = Verdict::Unknown;
            now.findings = (self.told)(outcome);
            against.push(text);
        }
        let mut findings = now.findings;
        findings.assumptions.extend(against);
        // what was named was seen, and a delay shows in a simulated loop
        let seen = |name: &str| {
            findings.effects.iter().any(|e| e.name == name)
                || name == EffectKind::ControlDelay.name() && speed(&now.verification).is_some()
        };
        let unseen = findings.not_excited.iter().filter(|(name, _)| !seen(name)).cloned();
        findings.not_excited = unseen.collect();
        findings.verification = Some(now.verification);
        Ok(Judged {
            findings,
            made: now.made,
            bench,
        })
    }

    /// With the constants that only the loop tells.
    fn with_loop(&self, bench: &mut Bench, outcome: &mut Outcome, now: Stand) -> Result<Stand> {
        if outcome.verdict != Verdict::None && (!scale::told_by_voltages(bench) || self.astray(bench, &now)?) {
            let (bench, of, said) = (
                bench.clone(),
                now.child.clone(),
                now.told(&scale::WINDINGS.map(|w| w.0)),
            );
            let look = move |_: &dyn Fn(&str)| scale::by_loop(&bench, &of, &said);
            outcome.by_loop = interruptible(self.tell_user, look)??.unwrap_or_default();
        }
        if outcome.by_loop.is_empty() {
            return Ok(now);
        }
        self.again(bench, outcome)
    }

    /// Told, made and simulated anew.
    fn again(&self, bench: &mut Bench, outcome: &Outcome) -> Result<Stand> {
        let findings = (self.told)(outcome);
        let made = (self.made)(&findings);
        self.simulated(bench, outcome, findings, made)
    }

    fn simulated(&self, bench: &mut Bench, outcome: &Outcome, findings: Findings, made: Made) -> Result<Stand> {
        let child = match &made {
            Ok(text) if outcome.verdict != Verdict::None => ActuatorParameters::parse(&findings.model, text)?,
            _ => self.actuator.clone(),
        };
        let (mut placed, parent, of) = (bench.clone(), self.actuator.clone(), child.clone());
        (self.tell_user)("the simulators under the recorded command");
        let (placed, verification) = interruptible(self.tell_user, move |_| -> schemas::error::Result<_> {
            verify::place_jumps(&mut placed, &of)?;
            let verified = verify::verify(&placed, &parent, &of)?;
            Ok((placed, verified))
        })??;
        *bench = placed;
        Ok(Stand {
            findings,
            made,
            child,
            verification,
        })
    }

    /// Whether the simulated loop shows the controller's output to be late; nothing where effects are left that have no name.
    fn late_control(&self, bench: &Bench, now: &Stand, outcome: &Outcome) -> Result<Option<Beside>> {
        if !matches!(outcome.verdict, Verdict::None | Verdict::Retune | Verdict::Named) {
            return Ok(None);
        }
        let noise = speed_noise(outcome);
        let (bench, child, verification) = (bench.clone(), now.child.clone(), now.verification.clone());
        let look = move |_: &dyn Fn(&str)| in_loop::late_control(&bench, &child, &verification, noise);
        Ok(interruptible(self.tell_user, look)??)
    }

    /// What only the simulated loop shows to be missing, where the equations show nothing.
    fn of_loop(&self, bench: &Bench, now: &Stand, outcome: &Outcome) -> Result<Shown> {
        let nothing_named = outcome.model.terms.is_empty() && outcome.beside.is_empty();
        if !matches!(outcome.verdict, Verdict::None | Verdict::Retune | Verdict::Unknown) || !nothing_named {
            return Ok(Shown::Nothing);
        }
        // means of the gap are no more than the gap: where its sensor leaves so little of the speed, none of them is worth a look
        let noise = bench
            .made_of_angle
            .map_or_else(|| speed_noise(outcome), |m| m.left_rad_per_s);
        let moves_alike = |c: &verify::VerifiedChannel| c.child.powi(2) - noise.powi(2) < loop_effects::QUIET.powi(2);
        let supply = channel(&now.verification, BenchChannel::VDc);
        let is_fed_alike = supply.is_none_or(|c| c.child < FED * noise_of(outcome, BenchChannel::VDc));
        if noise > 0.0 && is_fed_alike && speed(&now.verification).is_some_and(moves_alike) {
            return Ok(Shown::Nothing);
        }
        let mut told = Told::default();
        if scale::told_by_voltages(bench) && outcome.by_loop.is_empty() {
            told.torque = self.sampling(bench, now)? == CurrentSampling::Mean;
            told.constants = now.told(&TOLD_BY_VOLTAGES);
            if told.torque {
                told.constants.extend(now.told(&TOLD_BY_TORQUE));
            }
        }
        let (bench, child) = (bench.clone(), now.child.clone());
        let look = move |_: &dyn Fn(&str)| loop_effects::scan(&bench, &child, &told);
        Ok(interruptible(self.tell_user, look)??)
    }

    /// Whether an actuator goes astray whose constants were told by voltages beside a current that is read at points: its means are
    /// not known as well then.
    fn astray(&self, bench: &Bench, now: &Stand) -> Result<bool> {
        if channel(&now.verification, BenchChannel::Position).is_none_or(|c| c.child < ASTRAY_RAD) {
            return Ok(false);
        }
        Ok(self.sampling(bench, now)? == CurrentSampling::Point)
    }

    /// What samples of the currents are, by what is simulated.
    fn sampling(&self, bench: &Bench, now: &Stand) -> Result<CurrentSampling> {
        let (bench, child) = (bench.clone(), now.child.clone());
        let look = move |_: &dyn Fn(&str)| sensors::seen(&bench, &child);
        let seen = interruptible(self.tell_user, look)??;
        // the reference's own are means
        Ok(seen.map_or(CurrentSampling::Mean, |s| s.sampling.currents))
    }
}

/// In words, where the test bench with what was found goes further away from the held-out recordings than it did without.
fn further_away(v: &Verification) -> Option<String> {
    let motion = [BenchChannel::Velocity, BenchChannel::Current].map(BenchChannel::name);
    let worst = v
        .channels
        .iter()
        .filter(|c| v.heldout && motion.contains(&c.channel.as_str()) && c.child > FURTHER * c.parent)
        .max_by(|a, b| (a.child / a.parent).total_cmp(&(b.child / b.parent)))?;
    Some(format!(
        "the test bench with what was found goes further away from the held-out recordings than without: {} off by {:.3e} {}, {:.3e} before",
        worst.channel, worst.child, worst.unit, worst.parent
    ))
}

/// Gaps of speed and phase currents over those of another simulation, their geometric mean. (The angle comes as near with a torque constant
/// that is off by what the effect is on average.)
fn nearer(of: &Verification, to: &Verification) -> f64 {
    let channels = BenchChannel::CURRENTS.into_iter().chain([BenchChannel::Velocity]);
    let ratio = |c: BenchChannel| Some((channel(of, c)?.child / channel(to, c)?.child).ln());
    let all: Vec<f64> = channels.filter_map(ratio).collect();
    (all.iter().sum::<f64>() / all.len().max(1) as f64).exp()
}

/// Whether the simulated loop with what was found moves otherwise than was measured, by the speed's own sensor.
fn is_shaken(v: &Verification, outcome: &Outcome) -> bool {
    let noise = speed_noise(outcome);
    noise > 0.0 && speed(v).is_some_and(|c| c.child > SHAKEN * noise)
}

/// Of the speed's own sensor, rms [rad/s]; 0 where there is none.
fn speed_noise(outcome: &Outcome) -> f64 {
    noise_of(outcome, BenchChannel::Velocity)
}

/// Of a channel's sensor, rms, SI; 0 where there is none.
fn noise_of(outcome: &Outcome, of: BenchChannel) -> f64 {
    outcome.material.noise.get(&of).map_or(0.0, |n| n.rms)
}

/// The gap of the speed.
fn speed(v: &Verification) -> Option<&verify::VerifiedChannel> {
    channel(v, BenchChannel::Velocity)
}

fn channel(v: &Verification, of: BenchChannel) -> Option<&verify::VerifiedChannel> {
    v.channels.iter().find(|c| c.channel == of.name())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_makes_the_currents_run_as_measured_is_nearer_whatever_the_angle() {
        let with = |position: f64, others: f64| {
            let of = |(c, child): (BenchChannel, f64)| verify::VerifiedChannel {
                channel: c.name().to_string(),
                unit: String::new(),
                samples: 1,
                parent: 1.0,
                child,
                simplified: None,
            };
            let all = BenchChannel::CURRENTS
                .into_iter()
                .chain([BenchChannel::Velocity])
                .map(|c| (c, others));
            Verification {
                channels: std::iter::once((BenchChannel::Position, position))
                    .chain(all)
                    .map(of)
                    .collect(),
                ..Verification::default()
            }
        };
        assert!((nearer(&with(5.0, 0.1), &with(1.0, 0.2)) - 0.5).abs() < 1e-12);
        // nothing to compare
        assert_eq!(nearer(&Verification::default(), &with(1.0, 1.0)), 1.0);
    }

    #[test]
    fn prop_only_a_motion_twice_as_far_away_in_held_out_data_stands_against_what_was_found() {
        let of = |channel: BenchChannel, parent: f64, child: f64, heldout: bool| {
            let other = verify::VerifiedChannel {
                channel: BenchChannel::Position.name().into(),
                unit: "rad".into(),
                samples: 1,
                parent: 1.0,
                child: 100.0,
                simplified: None,
            };
            let one = verify::VerifiedChannel {
                channel: channel.name().into(),
                unit: "rad/s".into(),
                parent,
                child,
                ..other.clone()
            };
            further_away(&verify::Verification {
                heldout,
                channels: vec![other, one],
                ..Default::default()
            })
        };
        let said = of(BenchChannel::Velocity, 2.5, 190.0, true).expect("it runs away");
        assert!(
            said.contains("velocity") && said.contains("1.900e2") && said.contains("2.500e0"),
            "{said}"
        );
        assert!(of(BenchChannel::Current, 0.5, 14.0, true).is_some());
        assert_eq!(of(BenchChannel::Velocity, 0.2, 0.39, true), None);
        assert_eq!(of(BenchChannel::Velocity, 2.5, 0.2, true), None);
        assert_eq!(of(BenchChannel::Velocity, 2.5, 190.0, false), None);
    }
}
