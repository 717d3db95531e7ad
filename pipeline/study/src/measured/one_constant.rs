//! Two values that a bench file has of one constant.

use crate::measured::bench::Known;

/// Standard deviations by which two values of one constant may differ, and what is allowed beside them (assumed): beyond, they
/// are of two conventions (a current's rms, two phases in series), and their ratio stands.
const ONE_CONSTANT: f64 = 4.0;
const BESIDE: f64 = 0.02;

/// Torque of a current and voltage of a speed are one constant of a motor: the mean of what is said of both, by how far each is
/// trusted. What was said, where they differ.
pub(super) fn taken_for_one(torque: &mut Known, voltage: &mut Known) -> Option<(f64, f64)> {
    let said = (torque.value, voltage.value);
    let trusts = [torque.trust, voltage.trust];
    let of = |t: &Option<f64>| t.unwrap_or(0.3);
    let apart = (said.0 / said.1).ln().abs();
    if apart < 1e-9 || apart > ONE_CONSTANT * of(&trusts[0]).hypot(of(&trusts[1])) + BESIDE {
        return None;
    }
    let weight = |t: Option<f64>| t.map_or(0.0, |t| t.max(1e-6).powi(-2));
    let (a, b) = (weight(trusts[0]), weight(trusts[1]));
    let value = if a + b > 0.0 {
        (a * said.0 + b * said.1) / (a + b)
    } else {
        said.0
    };
    let fixed = trusts.contains(&Some(0.0));
    let trust = match a + b {
        0.0 => None,
        _ if fixed => Some(0.0),
        both => Some(both.sqrt().recip()),
    };
    *torque = Known { value, trust };
    *voltage = *torque;
    Some(said)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(torque: (f64, Option<f64>), voltage: (f64, Option<f64>)) -> Option<(f64, f64, Option<f64>)> {
        let known = |(value, trust)| Known { value, trust };
        let (mut a, mut b) = (known(torque), known(voltage));
        taken_for_one(&mut a, &mut b).map(|_| (a.value, b.value, a.trust))
    }

    #[test]
    fn two_values_are_one_by_their_trust() {
        let (a, b, trust) = taken((0.103, Some(0.03)), (0.099, Some(0.01))).unwrap();
        assert!(a == b && (a - 0.0994).abs() < 1e-9, "{a} {b}");
        assert!((trust.unwrap() - 0.03 / 10f64.sqrt()).abs() < 1e-9);
        // what is fixed is fixed, what is free is found
        let (a, _, trust) = taken((0.1, Some(0.0)), (0.103, Some(0.02))).unwrap();
        assert!((a - 0.1).abs() < 1e-9 && trust == Some(0.0), "{a} {trust:?}");
        assert_eq!(taken((0.1, None), (0.103, None)).unwrap(), (0.1, 0.1, None));
        assert_eq!(taken((0.1, None), (0.103, Some(0.02))).unwrap().2, Some(0.02));
    }

    #[test]
    fn one_value_and_two_conventions_stay() {
        assert_eq!(taken((0.1, Some(0.02)), (0.1, None)), None);
        // the current as rms
        assert_eq!(taken((0.1, Some(0.02)), (0.1 * 1.5f64.sqrt(), Some(0.01))), None);
        assert_eq!(taken((0.1, Some(0.02)), (0.0, Some(0.01))), None);
    }
}
