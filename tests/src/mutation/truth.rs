//! What good inputs are of, and when a result beside it is wrong.

use diagnoser::diagnosis::{Diagnosis, Outcome};
use schemas::fault::Interval;

/// FSJ and zeta of every test among the good inputs.
pub(super) const TRUTH: (f64, f64) = (3.0, 0.3);

/// How an input was taken that was not refused.
pub enum Taken {
    Right,
    /// what is wrong with what came of it
    Wrong(String),
}

/// Located with the truth outside by more than the interval's width.
pub(super) fn beside(fsj: Interval, zeta: Interval) -> Option<String> {
    let far = |i: Interval, x: f64| {
        let width = i.hi - i.lo;
        !(x >= i.lo - width && x <= i.hi + width)
    };
    let wrong = far(fsj, TRUTH.0) || far(zeta, TRUTH.1);
    wrong.then(|| format!("located FSJ {fsj:?}, zeta {zeta:?} for {TRUTH:?}"))
}

/// As [`beside`], of a diagnosis.
pub(super) fn silent(diagnosis: &Diagnosis) -> Option<String> {
    let Outcome::Located(area) = &diagnosis.outcome else {
        return None;
    };
    beside(area.fsj, area.zeta)
}

/// A refusal, or what was made of an input that was not refused.
pub(super) fn line<T>(result: Result<T, impl std::fmt::Display>) -> Result<Taken, String> {
    result.map(|_| Taken::Right).map_err(|e| format!("{e:#}"))
}

/// Files that carry a checksum: what is taken is what was written.
pub(super) fn as_written<T: PartialEq>(
    result: Result<T, impl std::fmt::Display>,
    written: &T,
) -> Result<Taken, String> {
    match result {
        Err(e) => Err(format!("{e:#}")),
        Ok(x) if x == *written => Ok(Taken::Right),
        Ok(_) => Ok(Taken::Wrong("changed, and taken for what was written".into())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_beside_is_more_than_a_width_outside() {
        let i = |lo, hi| Interval { lo, hi };
        let zeta = i(0.29, 0.31);
        assert_eq!(beside(i(2.9, 3.1), zeta), None);
        assert_eq!(beside(i(3.05, 3.11), zeta), None);
        assert!(beside(i(3.05, 3.08), zeta).is_some());
        assert!(beside(i(2.9, 2.93), zeta).is_some());
        assert!(beside(i(2.9, 3.1), i(0.31, 0.3101)).is_some());
        assert!(beside(i(f64::NAN, 3.1), zeta).is_some());
    }
}
