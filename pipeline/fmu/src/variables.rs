//! Inputs, outputs and parameters of the FMU of an actuator, in one table.

use crate::unit::{Unit, unit};
use schemas::channel::{Channel, Sampling};
use schemas::fingerprint::{checksum, exact};
use sim_worker::driven::DrivenBench;
use sim_worker::parameters::{self, ActuatorParameters, PARAMETERS};

/// What a variable stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// commanded user position
    Command,
    /// load torque at the motor
    Load,
    /// a telemetry channel
    Output(Channel),
    /// what commands: 1 the input, n + 2 the built-in sequence n
    Sequence,
    /// friction factor
    Fsj,
    /// static eccentricity
    Zeta,
    /// rotor angle at rest
    RestAngle,
    /// of [`PARAMETERS`]
    Parameter(usize),
    /// of the actuator's effects, and which of its values
    Effect(usize, usize),
}

impl Role {
    /// Whether it may be set at all.
    pub fn is_settable(self) -> bool {
        !matches!(self, Self::Output(_))
    }

    /// Whether it may be set while the simulation runs.
    pub fn is_tunable(self) -> bool {
        matches!(self, Self::Command | Self::Load | Self::Fsj | Self::Zeta)
    }
}

/// A variable; its value reference is its place in the table.
#[derive(Clone, Debug)]
pub struct Variable {
    /// structured, `motor.inertia_kg_m2`
    pub name: String,
    /// in words
    pub meaning: String,
    /// what it stands for
    pub role: Role,
    /// none for [`Role::Sequence`], which counts
    pub unit: Option<Unit>,
    /// least value, infinite where there is none
    pub low: f64,
    /// greatest value, infinite where there is none
    pub high: f64,
    /// before anybody sets it; of an output 0
    pub start: f64,
}

impl Variable {
    /// Whether `x` may be its value by itself.
    pub fn allows(&self, x: f64) -> bool {
        (self.role != Role::Sequence || x.fract() == 0.0) && x.is_finite() && x >= self.low && x <= self.high
    }

    /// [`Variable::allows`] in words.
    pub fn allowed(&self) -> String {
        if self.role == Role::Sequence {
            let named = sequences()
                .into_iter()
                .enumerate()
                .map(|(i, name)| format!("{} {name}", i + 1));
            return named.collect::<Vec<_>>().join(", ");
        }
        let unit = self
            .unit
            .as_ref()
            .map_or("", |u| if u.name == "1" { "" } else { &u.name });
        let text = match (self.low.is_finite(), self.high.is_finite()) {
            (true, true) => format!("{} to {} {unit}", self.low, self.high),
            (true, false) => format!("a finite number of at least {} {unit}", self.low),
            (false, true) => format!("a finite number of at most {} {unit}", self.high),
            (false, false) => format!("a finite number in {unit}"),
        };
        text.trim_end().trim_end_matches(" in").into()
    }
}

/// Values of `sequence`, from 1 on.
pub fn sequences() -> Vec<&'static str> {
    std::iter::once("external")
        .chain(sim_worker::catalogue::sequence_names())
        .collect()
}

/// Number of inputs; they come first.
pub const INPUTS: usize = 2;

const ANY: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

/// All variables of an actuator: inputs, outputs, parameters.
pub fn variables(actuator: &ActuatorParameters) -> Vec<Variable> {
    let mut all = Vec::new();
    let mut push = |role, name: &str, unit_text: &str, (low, high): (f64, f64), start: f64, meaning: &str| {
        all.push(Variable {
            name: name.into(),
            meaning: meaning.into(),
            role,
            unit: (role != Role::Sequence).then(|| unit(unit_text).unwrap_or_else(|| panic!("unit {unit_text}"))),
            low,
            high,
            start,
        });
    };
    push(
        Role::Command,
        "command",
        "rad",
        ANY,
        0.0,
        "commanded user position, where sequence is external",
    );
    push(
        Role::Load,
        "load_torque",
        "N m",
        ANY,
        0.0,
        "load torque at the motor, positive against positive motion",
    );
    for c in DrivenBench::channels() {
        let how = match c.sampling() {
            Sampling::End => "at the communication point",
            Sampling::Mean => "mean over the communication step",
        };
        push(
            Role::Output(c),
            c.name(),
            c.unit(),
            ANY,
            0.0,
            &format!("{}; {how}", c.meaning()),
        );
    }
    push(
        Role::Sequence,
        "sequence",
        "",
        (1.0, sequences().len() as f64),
        1.0,
        "what commands: the input command, or a built-in test sequence from the start time on",
    );
    push(
        Role::Fsj,
        "fsj",
        "-",
        (1.0, 5.0),
        1.0,
        "friction factor FSJ on the nominal dry friction; 1 is healthy",
    );
    push(
        Role::Zeta,
        "zeta",
        "-",
        (0.0, 0.5),
        0.0,
        "static eccentricity zeta over the air gap; 0 is healthy",
    );
    push(Role::RestAngle, "rest_angle", "rad", ANY, 0.0, "rotor angle at rest");
    for (k, (name, table, key)) in PARAMETERS.into_iter().enumerate() {
        push(
            Role::Parameter(k),
            &format!("{table}.{key}"),
            parameters::unit(k),
            parameters::range(k),
            actuator.values()[k],
            &format!("{} of the actuator", name.replace('_', " ")),
        );
    }
    let kinds = || actuator.effects.iter().map(|e| e.kind);
    for (i, effect) in actuator.effects.iter().enumerate() {
        let kind = effect.kind.name();
        let before = kinds().take(i).filter(|k| *k == effect.kind).count();
        let group = if before == 0 {
            kind.to_string()
        } else {
            format!("{kind}_{}", before + 1)
        };
        for (j, (key, x)) in effect.parameters().enumerate() {
            push(
                Role::Effect(i, j),
                &format!("{group}.{}", key.name),
                key.unit,
                (key.low, key.high),
                x,
                &format!("{} of the effect {}", key.name, kind.replace('_', " ")),
            );
        }
    }
    all
}

/// What tells the FMU of one actuator and version from all others: every variable, every start value.
pub fn guid(actuator: &ActuatorParameters) -> String {
    let mut text = format!("fmu;{};{}", env!("CARGO_PKG_VERSION"), actuator.fingerprint());
    for v in variables(actuator) {
        text += &format!(";{},{}", v.name, exact(v.start));
    }
    let hash = checksum(text.as_bytes());
    let part = |from: usize, to: usize| &hash[from..to];
    format!(
        "{{{}-{}-{}-{}-{}}}",
        part(0, 8),
        part(8, 12),
        part(12, 16),
        part(16, 20),
        part(20, 32)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use sim_worker::effect::{Effect, EffectKind};

    #[test]
    fn prop_every_effect_has_variables_with_units() {
        for &kind in EffectKind::ALL {
            let mut a = ActuatorParameters::reference();
            let values: Vec<f64> = kind.keys().iter().map(|k| k.low.max(0.0)).collect();
            a.effects = vec![Effect::new(kind, &values), Effect::new(kind, &values)];
            let all = variables(&a);
            let names: std::collections::BTreeSet<&str> = all.iter().map(|v| v.name.as_str()).collect();
            assert_eq!(names.len(), all.len());
            assert!(names.contains(format!("{}_2.{}", kind.name(), kind.keys()[0].name).as_str()));
        }
    }

    #[test]
    fn prop_the_guid_is_of_all_values() {
        let mut a = ActuatorParameters::reference();
        let first = guid(&a);
        assert_eq!(first, guid(&a));
        assert_eq!(first.len(), 38);
        a.temperature_degc += 1.0;
        let second = guid(&a);
        assert_ne!(second, first);
        a.effects = vec![Effect::new(EffectKind::Cogging, &[0.001, 0.0, 12.0])];
        assert_ne!(guid(&a), second);
    }

    #[test]
    fn refuse_in_words() {
        let all = variables(&ActuatorParameters::reference());
        let of = |name: &str| all.iter().find(|v| v.name == name).unwrap();
        assert_eq!(of("fsj").allowed(), "1 to 5");
        assert!(!of("fsj").allows(9.0) && of("fsj").allows(5.0));
        assert_eq!(of("command").allowed(), "a finite number in rad");
        assert!(!of("command").allows(f64::NAN));
        assert_eq!(
            of("motor.inertia_kg_m2").allowed(),
            "a finite number of at least 0 kg.m2"
        );
    }
}
