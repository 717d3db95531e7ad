//! Why a test is not located, in words: maps that contradict each other, witnesses that speak against a pair, a pair beyond the
//! maps, a unit whose own healthy tests its model does not explain.

use super::{Diagnoser, Kinetic, Outcome};
use crate::estimate::Estimate;
use crate::uncertainty::Row;
use schemas::feature::{Feature, Features};

impl Diagnoser {
    /// Witnesses that speak against the pair that the maps agree on.
    pub(super) fn overruled(&self, values: &Row, features: &Features, best: &Estimate) -> Option<Outcome> {
        // what they should be beyond the maps nobody knows
        let limits = self.estimator.limits();
        let within = |x: f64, (lo, hi): (f64, f64)| lo <= x && x <= hi;
        if !(within(best.fsj, limits.f) && within(best.zeta, limits.z)) {
            return None;
        }
        let mut odd = self.estimator.witnesses(values, features, best);
        odd.retain(|(.., z)| z.abs() > self.witness_gate);
        odd.sort_by(|a, b| b.3.abs().total_cmp(&a.3.abs()));
        if odd.is_empty() {
            return None;
        }
        let word = |&(f, found, expected, z): &(Feature, f64, f64, f64)| {
            let (name, unit) = (f.name(), f.unit());
            format!(
                "{name} is {found:.4e} {unit} instead of {expected:.4e} ({:.1} u)",
                z.abs()
            )
        };
        let words: Vec<String> = odd.iter().map(word).collect();
        Some(Outcome::Unexplained {
            contradicting: odd.iter().map(|o| o.0).collect(),
            reason: format!(
                "the maps agree on FSJ {:.3}, zeta {:.4}, but these faults do not explain that {}",
                best.fsj,
                best.zeta,
                words.join(", nor that ")
            ),
        })
    }

    /// The maps agree on a pair beyond their range.
    pub(super) fn outside(&self, best: &Estimate) -> Outcome {
        let limits = self.estimator.limits();
        let (f0, f1, z1) = (limits.f.0, limits.f.1, limits.z.1);
        let mut sides = Vec::new();
        if best.fsj > f1 {
            sides.push(format!("FSJ above {f1} (about {:.2})", best.fsj));
        }
        if best.fsj < f0 {
            sides.push(format!("FSJ below {f0} (about {:.2})", best.fsj));
        }
        if best.zeta > z1 {
            sides.push(format!("zeta above {z1} (about {:.3})", best.zeta));
        }
        let reason = sides.join(", ");
        Outcome::OutOfRange { reason }
    }

    /// Why there is no area.
    pub(super) fn nowhere(&self, values: &Row, misfit: Option<f64>) -> Outcome {
        let beyond = self.beyond(values);
        // one feature alone beyond its map is no worse fault: the others would follow it
        let worse = beyond.iter().filter(|b| b.1).count();
        let words: Vec<String> = beyond.into_iter().map(|b| b.0).collect();
        if worse >= 2 {
            let reason = words.join("; ");
            return Outcome::OutOfRange { reason };
        }
        match self.contradiction(values, misfit) {
            Outcome::Unexplained { contradicting, reason } if !words.is_empty() => Outcome::Unexplained {
                contradicting,
                reason: format!("{reason}; {}", words.join("; ")),
            },
            outcome => outcome,
        }
    }

    /// Values that lie beyond every curve of their maps, in words, and whether greater faults would move
    /// them there.
    fn beyond(&self, values: &Row) -> Vec<(String, bool)> {
        let features = self.estimator.features();
        let text = |(&f, &value): (&Feature, &f64)| {
            let m = self.maps.map(f)?;
            let (lo, hi) = m.range();
            let corner = |f, z| self.uncertainty(m.feature, f, z).unwrap_or(0.0);
            let (fs, zs) = (
                [m.fsj[0], m.fsj[m.fsj.len() - 1]],
                [m.zeta[0], m.zeta[m.zeta.len() - 1]],
            );
            let widest = fs.iter().flat_map(|&f| zs.iter().map(move |&z| corner(f, z)));
            let half = self.gate.sqrt() * widest.fold(0.0_f64, f64::max);
            let (side, end) = if value - half > hi {
                ("above", hi)
            } else if value + half < lo {
                ("below", lo)
            } else {
                return None;
            };
            let (name, unit) = (f.name(), f.unit());
            let words = format!("{name} = {value:.5e} {unit} is {side} the map's end {end:.5e}");
            // where the direction is not the same along both faults, either may
            let worse = (side == "above") == (m.direction.0 > 0.0) || (side == "above") == (m.direction.1 > 0.0);
            Some((words, worse))
        };
        features.iter().zip(values).filter_map(text).collect()
    }

    /// Which maps contradict each other: those without which, one or two at a time, the rest agree.
    fn contradiction(&self, values: &Row, misfit: Option<f64>) -> Outcome {
        let features = self.estimator.features();
        let agree = |skipped: &[usize]| {
            let mut rest = *values;
            skipped.iter().for_each(|&k| rest[k] = f64::NAN);
            let gate = self.gate_of(&rest);
            self.estimator.best(&rest, gate).is_some_and(|b| b.misfit <= gate)
        };
        let names = |list: &[usize]| list.iter().map(|&k| features[k].name()).collect::<Vec<_>>();
        let n = features.len();
        let by = misfit.map_or(String::new(), |q| {
            format!(" (misfit {:.1}, at most {:.1})", q.sqrt(), self.gate.sqrt())
        });
        let found = |contradicting: Vec<usize>, reason: String| Outcome::Unexplained {
            contradicting: contradicting.into_iter().map(|k| features[k]).collect(),
            reason: format!("no fault pair fits all maps{by}; {reason}"),
        };
        if n > 2 {
            let odd: Vec<usize> = (0..n).filter(|&k| agree(&[k])).collect();
            if !odd.is_empty() {
                let reason = format!("without {} the others agree", names(&odd).join(" or without "));
                return found(odd, reason);
            }
        }
        if n > 3 {
            let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| [i, j]));
            let odd: Vec<[usize; 2]> = pairs.filter(|p| agree(p)).collect();
            if !odd.is_empty() {
                let list: Vec<String> = odd.iter().map(|p| names(p).join(" and ")).collect();
                let mut involved = odd.concat();
                involved.sort_unstable();
                involved.dedup();
                let reason = format!("without {} the others agree", list.join(", or without "));
                return found(involved, reason);
            }
        }
        found((0..n).collect(), "nor do most of them fit".into())
    }

    /// What is left of an outcome where the maps are not to be trusted with the unit: no pair, whatever they agree on.
    pub(super) fn doubted(&self, outcome: Outcome, kinetic: &mut Option<Kinetic>) -> Outcome {
        let Some(reason) = &self.distrust else { return outcome };
        *kinetic = None;
        match outcome {
            Outcome::Incomplete { reason, .. } => Outcome::Incomplete { reason, area: None },
            Outcome::Unexplained { .. } => outcome,
            Outcome::Located(_) | Outcome::OutOfRange { .. } => Outcome::Unexplained {
                contradicting: Vec::new(),
                reason: reason.clone(),
            },
        }
    }
}
