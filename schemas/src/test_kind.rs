//! What kind of test a recording is, and maps are for: all that failure maps depend on.

use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Tests of one kind may differ in the rotor's rest angle by no more than this [rad] (0.1 degrees).
pub const REST_ANGLE_TOLERANCE_RAD: f64 = TAU / 3600.0;

/// Rates of one kind agree to this share.
const RATE_TOLERANCE: f64 = 1e-6;

/// Everything that a failure map depends on, objects by their fingerprints. An empty text or `None` says that it is
/// not known.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct TestKind {
    /// fingerprint of the actuator's parameters
    pub parameters: String,
    /// fingerprint of the sequence
    #[serde(rename = "sequence_fingerprint")]
    pub sequence: String,
    /// fingerprint of the sensor model, or `none`
    pub sensors: String,
    /// telemetry rate [Hz]
    pub rate_hz: f64,
    /// rotor angle at the first sample, any turn [rad]
    pub rest_angle_rad: f64,
    /// constant load torque [N m, motor side]
    pub load_n_m: Option<f64>,
    /// P2 from i_eq, because the telemetry has no phase currents
    pub equivalent_current: bool,
}

/// The first thing in which a test is not of a kind, in words.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// what differs, with its unit
    pub place: &'static str,
    /// of the test
    pub found: String,
    /// of the kind
    pub allowed: String,
}

impl TestKind {
    /// The first thing in which this test is not of the kind `maps`; what is not known is no difference.
    pub fn difference(&self, maps: &Self) -> Option<Difference> {
        let differs = |place, found: String, allowed: String| Some(Difference { place, found, allowed });
        for (place, found, allowed) in [
            ("parameter fingerprint", &self.parameters, &maps.parameters),
            ("sequence fingerprint", &self.sequence, &maps.sequence),
            ("fingerprint of the sensors", &self.sensors, &maps.sensors),
        ] {
            if !found.is_empty() && found != allowed {
                return differs(place, found.clone(), allowed.clone());
            }
        }
        if (self.rate_hz - maps.rate_hz).abs() > RATE_TOLERANCE * maps.rate_hz {
            return differs("rate [Hz]", self.rate_hz.to_string(), maps.rate_hz.to_string());
        }
        let turn = (self.rest_angle_rad - maps.rest_angle_rad + PI).rem_euclid(TAU) - PI;
        if turn.abs() > REST_ANGLE_TOLERANCE_RAD {
            let degrees = |x: f64| format!("{:.2}", x.to_degrees());
            let allowed = format!("{} +- 0.1", degrees(maps.rest_angle_rad));
            return differs("rotor angle at rest [deg]", degrees(self.rest_angle_rad), allowed);
        }
        if self.equivalent_current != maps.equivalent_current {
            return differs("currents", self.currents().into(), maps.currents().into());
        }
        match (self.load_n_m, maps.load_n_m) {
            (Some(found), Some(allowed)) if found != allowed => {
                differs("load torque [N m]", found.to_string(), allowed.to_string())
            }
            _ => None,
        }
    }

    /// Every bit of it but the load, for keys: whoever asks for maps may not know the load.
    pub fn bits(&self) -> (&str, &str, &str, u64, u64, bool) {
        let (rate, angle) = (self.rate_hz.to_bits(), self.rest_angle_rad.to_bits());
        let (parameters, sequence, sensors) = (&self.parameters, &self.sequence, &self.sensors);
        (parameters, sequence, sensors, rate, angle, self.equivalent_current)
    }

    /// What P2 is taken from, in words.
    pub fn currents(&self) -> &'static str {
        if self.equivalent_current {
            "i_eq only"
        } else {
            "phase currents"
        }
    }

    /// In words, for those who have to make maps.
    pub fn describe(&self) -> String {
        format!(
            "parameters {}, sequence {}, {} Hz, sensors {}, rest angle {:.2} deg, {}",
            self.parameters,
            self.sequence,
            self.rate_hz,
            self.sensors,
            self.rest_angle_rad.to_degrees(),
            self.currents(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind() -> TestKind {
        TestKind {
            parameters: "a".into(),
            sequence: "b".into(),
            sensors: "none".into(),
            rate_hz: 1e4,
            rest_angle_rad: 0.5,
            load_n_m: Some(0.0),
            equivalent_current: false,
        }
    }

    #[test]
    fn prop_every_condition_of_maps_makes_a_difference_and_the_unknown_none() {
        type Change = fn(&mut TestKind);
        let changes: [(&str, Change); 7] = [
            ("parameter fingerprint", |k| k.parameters = "x".into()),
            ("sequence fingerprint", |k| k.sequence = "x".into()),
            ("fingerprint of the sensors", |k| k.sensors = "x".into()),
            ("rate [Hz]", |k| k.rate_hz = 5e3),
            ("rotor angle at rest [deg]", |k| k.rest_angle_rad += 0.01),
            ("currents", |k| k.equivalent_current = true),
            ("load torque [N m]", |k| k.load_n_m = Some(0.1)),
        ];
        for (place, change) in changes {
            let mut other = kind();
            change(&mut other);
            assert_eq!(other.difference(&kind()).map(|d| d.place), Some(place));
        }
        assert_eq!(kind().difference(&kind()), None);
        let unknown = TestKind {
            parameters: String::new(),
            load_n_m: None,
            // the same angle, a turn on
            rest_angle_rad: 0.5 + TAU,
            ..kind()
        };
        assert_eq!(unknown.difference(&kind()), None);
    }
}
