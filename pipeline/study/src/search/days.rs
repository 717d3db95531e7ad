//! Friction that is another one on another day: of each file its own, within what a day makes.

use crate::measured::bench::{Bench, Role};
use crate::measured::recording::{Run, extent, files};
use crate::search::fit::Fit;
use crate::search::select::Material;
use sim_worker::effect::Equation;
use std::collections::BTreeMap;

/// Standard deviation of a file's dry and viscous friction, as a share of the machine's (assumed: temperature of the room, rest before the run).
const OF_A_DAY: f64 = 0.02;
/// Log-likelihood from which files have frictions of their own (assumed).
const APART: f64 = 60.0;
/// Most that the dry frictions of two files are apart by the day, as a share of the machine's (assumed).
const MOST_APART: f64 = 0.08;

impl Material {
    /// Whether there are two files whose frictions may differ.
    pub(super) fn has_days(&self) -> bool {
        let used = |r: &&Run| !r.steady && matches!(r.role, Role::Fit | Role::Select | Role::HeldOut);
        !self.clock.steady && files(self.runs.iter().filter(used)).len() > 1
    }

    /// Whether a model's files have frictions of their own.
    pub(super) fn days_apart(&self, model: &Fit) -> bool {
        let has_own = self.bench.rig.friction_of_day > 0.0;
        let other = self.again(
            by_days(self.bench.clone(), !has_own),
            self.nuisances.clone(),
            self.excess,
        );
        let (alike, own) = if has_own { (&other, self) } else { (self, &other) };
        let fit = |m: &Self| m.solve(&model.terms, model.sigma);
        let (of_alike, of_own) = (fit(alike), fit(own));
        told(own, &of_own) - told(alike, &of_alike) > APART && spread(alike, &of_alike) < MOST_APART
    }
}

/// A bench with frictions of each file's own, or without.
pub(super) fn by_days(mut bench: Bench, own: bool) -> Bench {
    bench.rig.friction_of_day = if own { OF_A_DAY } else { 0.0 };
    bench
}

/// Log-likelihood of a model on all runs.
fn told(m: &Material, fit: &Fit) -> f64 {
    let (held, e) = (m.held_problem(), Equation::Torque);
    let rows = held.rows_of(e).max(1) as f64;
    let left = held.energy(&m.judged_residual(fit))[e.index()] / rows;
    // what is below the noise is no better than the noise
    let left = left.max(held.floor[e.index()].powi(2)).max(1e-300);
    fit.score.log_likelihood - 0.5 * rows * held.independent[e.index()] * left.ln()
}

/// How far the dry frictions of the files are apart, as a share of the machine's.
fn spread(m: &Material, fit: &Fit) -> f64 {
    let held = m.held.as_ref().map(|p| (p, m.held_residual(fit)));
    let sides = [(&m.fit, fit.residual.clone())].into_iter().chain(held);
    let mut of_files = BTreeMap::<&str, (f64, f64)>::new();
    for (p, residual) in sides {
        let Some(column) = p.dry_friction.map(|i| &p.base[i]) else {
            return f64::INFINITY;
        };
        for b in p.blocks_of(Equation::Torque) {
            let file = of_files.entry(&p.files[b.run]).or_default();
            for row in b.rows.clone() {
                *file = (file.0 + column[row] * residual[row], file.1 + column[row].powi(2));
            }
        }
    }
    let (low, high) = extent(of_files.values().map(|(cr, cc)| cr / cc.max(1e-300)));
    high - low
}

#[cfg(test)]
mod tests {
    use crate::search::study::{Outcome, of_rig};
    use crate::search::verdict::Verdict;

    /// Of a rig whose runs have so much more dry friction [N m] each.
    fn studied(more: [f64; 3], besides: impl Fn([f64; 5]) -> f64) -> Outcome {
        of_rig(|run, at| more[run] * at[2].signum() + besides(at))
    }

    fn names(o: &Outcome) -> Vec<&str> {
        o.model.terms.iter().map(|t| t.kind.name()).collect()
    }

    #[test]
    fn another_friction_on_another_day_is_nothing_that_is_missing() {
        let o = studied([0.0, 0.006, -0.006], |_| 0.0);
        assert!(
            matches!(o.verdict, Verdict::None | Verdict::Retune),
            "{:?} {:?}",
            o.verdict,
            names(&o)
        );
        assert!(o.material.bench.rig.friction_of_day > 0.0);
        // what a day makes of a friction does not hide it
        let widths = crate::search::intervals::intervals(&o.material, &o.model).nuisance;
        for name in ["coulomb", "viscous"] {
            let at = o.material.nuisances.iter().position(|n| n.name == name).unwrap();
            assert!(widths[at] < 0.1, "{name}: {}", widths[at]);
        }
        let alike = studied([0.0; 3], |_| 0.0);
        assert!(alike.material.bench.rig.friction_of_day == 0.0);
    }

    #[test]
    fn what_is_missing_is_found_on_days_of_other_friction() {
        let o = studied([0.0, 0.006, -0.006], |[_, x, ..]| 0.03 * (3.0 * x).sin());
        assert_eq!((o.verdict, names(&o)), (Verdict::Named, vec!["cogging"]));
    }

    #[test]
    fn much_more_friction_in_a_file_is_no_other_day() {
        let o = studied([0.0, 0.1, 0.0], |_| 0.0);
        assert_eq!(o.verdict, Verdict::Unknown, "{:?}", names(&o));
    }
}
