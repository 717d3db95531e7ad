//! What was renewed in a unit, and what is therefore no longer known of it.

use super::constants::{Constants, renewable};
use serde::{Deserialize, Serialize};
use sim_worker::spread::Cause;

/// Part of an actuator that was replaced or repaired.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RepairedPart {
    /// gears and ball screw: friction, and inertia
    Transmission,
    /// winding, magnets, rotor and its bearings
    Motor,
    /// the whole actuator
    All,
}

impl RepairedPart {
    /// All, by name.
    pub const ALL: [(&'static str, Self); 3] = [
        ("transmission", Self::Transmission),
        ("motor", Self::Motor),
        ("all", Self::All),
    ];

    /// As it is named.
    pub fn name(self) -> &'static str {
        Self::ALL.into_iter().find(|p| p.1 == self).map_or("", |p| p.0)
    }

    /// Whether the new part has a value of this constant of its own. A rotor's bearings have a part in the friction.
    fn renews(self, cause: Cause) -> bool {
        match self {
            Self::Transmission => !matches!(cause, Cause::Resistance | Cause::BackEmf | Cause::Inductance),
            Self::Motor => cause != Cause::FrictionSlope,
            Self::All => true,
        }
    }
}

/// A recorded repair.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Repair {
    /// what was renewed
    pub part: RepairedPart,
    /// in the words of those who did it; may be empty
    pub note: String,
}

impl Constants {
    /// The same where a part was renewed: its constants may be anything that the type has.
    ///
    /// * `of_type` how units of the type differ
    pub(super) fn renewed(&self, of_type: &Self, part: RepairedPart) -> Self {
        let touched = |c: &Cause| renewable(*c) && part.renews(*c);
        let mut causes = self.causes.clone();
        causes.extend(of_type.causes.iter().filter(|c| touched(c) && !self.causes.contains(c)));
        let n = causes.len();
        let of = |from: &Self, a: usize, b: usize| {
            let place = |k: usize| from.causes.iter().position(|c| *c == causes[k]);
            place(a)
                .zip(place(b))
                .map_or(0.0, |(i, j)| from.covariance[i * from.causes.len() + j])
        };
        let covariance = (0..n * n).map(|k| match (k / n, k % n) {
            (i, j) if i == j && touched(&causes[i]) => of(self, i, i).max(of(of_type, i, i)),
            (i, j) if i != j && (touched(&causes[i]) || touched(&causes[j])) => 0.0,
            (i, j) => of(self, i, j),
        });
        let covariance = covariance.collect();
        Self {
            mean: vec![0.0; n],
            covariance,
            causes,
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_worker::parameters::ActuatorParameters;

    #[test]
    fn prop_a_renewed_part_is_as_uncertain_as_the_type_and_the_rest_is_known() {
        let mut a = ActuatorParameters::reference();
        a.uncertainty.parameters = vec!["motor.inertia_kg_m2".into(), "motor.phase_resistance_ohm".into()];
        a.uncertainty.deviation = vec![0.001, 0.002];
        a.uncertainty.correlation = vec![1.0, -0.5, -0.5, 1.0];
        let spread = sim_worker::catalogue::spread("unit").unwrap();
        let studied = Constants::prior(&a, &spread);
        let of_type = Constants::prior(&ActuatorParameters::reference(), &spread);
        let sd = |c: &Constants, cause: Cause| c.of(cause).unwrap().1;
        let gears = studied.renewed(&of_type, RepairedPart::Transmission);
        assert_eq!(sd(&gears, Cause::Resistance), sd(&studied, Cause::Resistance));
        assert_eq!(sd(&gears, Cause::Inertia), sd(&of_type, Cause::Inertia));
        assert_eq!(sd(&gears, Cause::HealthyFriction), sd(&of_type, Cause::HealthyFriction));
        // nothing of the old inertia says anything of the resistance
        let place = |c: Cause| gears.causes.iter().position(|x| *x == c).unwrap();
        let n = gears.causes.len();
        assert_eq!(
            gears.covariance[place(Cause::Inertia) * n + place(Cause::Resistance)],
            0.0
        );
        let motor = studied.renewed(&of_type, RepairedPart::Motor);
        assert_eq!(sd(&motor, Cause::Resistance), sd(&of_type, Cause::Resistance));
        // each constant of the type has its place
        assert!(of_type.causes.iter().all(|c| motor.causes.contains(c)));
        for (name, part) in RepairedPart::ALL {
            assert_eq!(part.name(), name);
        }
    }
}
