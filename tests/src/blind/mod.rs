//! Blind test bed: "measured" data of a servo actuator with a hidden physical effect, and the key apart from them.
//!
//! Shares no equation with the simulator: its own integrators, its own step, its own friction. All numbers of the rigs
//! that are not in `BENCH.toml` are assumed.

mod commands;
mod effects;
mod sensors;
mod servo;
mod three_phase;
mod write;

pub use effects::{Effect, Kind, Quantity};
pub use sensors::Sensors;
pub use servo::CURRENT_LOOP;

use commands::Command;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What is hidden.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Class {
    /// Parameters off by up to 10 %, nothing else.
    Nothing,
    One,
    Two,
    /// A law that no candidate describes.
    Outside,
}

/// Shapes and sensors.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Setting {
    /// The laws of the table, white noise.
    Matched,
    /// Other laws, coloured noise, hum, gains and offsets.
    Other,
}

/// Which actuator.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Rig {
    Servo,
    ThreePhase,
}

/// An effect that the caller wants hidden, with parameters if they shall not be drawn.
#[derive(Clone, Debug)]
pub struct Forced {
    kind: Kind,
    parameters: Vec<(String, f64)>,
}

impl Forced {
    /// Checks name and keys. The first key given turns the scaling to a severity off.
    pub fn new(name: &str, parameters: &[(&str, f64)]) -> Result<Forced, String> {
        let kind = Kind::from_name(name).ok_or_else(|| format!("no effect is called {name}"))?;
        for (key, value) in parameters {
            if !kind.keys().contains(key) {
                return Err(format!(
                    "{name} has no parameter {key}, only {}",
                    kind.keys().join(", ")
                ));
            }
            if !value.is_finite() {
                return Err(format!("{name}: {key} must be finite"));
            }
        }
        Ok(Forced {
            kind,
            parameters: parameters.iter().map(|(k, v)| (k.to_string(), *v)).collect(),
        })
    }

    /// The effect.
    pub fn kind(&self) -> Kind {
        self.kind
    }
}

/// What to make.
#[derive(Clone, Debug)]
pub struct Spec {
    pub class: Class,
    pub setting: Setting,
    /// 1 is 100 %: the effect's rms is a tenth of the reference ([`Quantity`]).
    pub severity: f64,
    pub rig: Rig,
    /// In place of drawn effects; the class is then only a label.
    pub forced: Vec<Forced>,
    /// Kinds not to be drawn.
    pub without: Vec<Kind>,
}

impl Default for Spec {
    fn default() -> Spec {
        Spec {
            class: Class::One,
            setting: Setting::Matched,
            severity: 1.0,
            rig: Rig::Servo,
            forced: Vec::new(),
            without: Vec::new(),
        }
    }
}

/// Parameters of the plant, SI, motor side.
#[derive(Clone, Copy, Debug)]
pub struct Nominal {
    pub kt: f64,
    pub ke: f64,
    pub inertia: f64,
    pub viscous: f64,
    pub coulomb: f64,
    /// Of two phases in series.
    pub resistance: f64,
    pub inductance: f64,
    pub gear: f64,
    pub pairs: f64,
}

/// What `BENCH.toml` says of every rig (the Coulomb torque is 0.7 of 0.03 N m).
pub const ASSUMED: Nominal = Nominal {
    kt: 0.0752,
    ke: 0.0752,
    inertia: 2.5e-5,
    viscous: 3e-5,
    coulomb: 0.021,
    resistance: 2.13,
    inductance: 0.72e-3,
    gear: 500.0,
    pairs: 2.0,
};

/// Control law at 10 kHz: `e = clip(Kx (N com - theta), speed_limit) - w`, `i = clip(Kv e + Ki int e, drive_limit)`.
#[derive(Clone, Copy, Debug)]
pub struct Laws {
    /// 1/s, A per rad/s, A per rad.
    pub position_gain: f64,
    pub speed_gain: f64,
    pub integral_gain: f64,
    /// rad/s, A.
    pub speed_limit: f64,
    pub drive_limit: f64,
    /// Supply, V.
    pub supply: f64,
}

/// The control law of every rig (assumed).
pub const LAWS: Laws = Laws {
    position_gain: 40.0,
    speed_gain: 0.05,
    integral_gain: 1.0,
    speed_limit: 700.0,
    drive_limit: 8.0,
    supply: 48.0,
};

/// The true plant.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    pub nominal: Nominal,
    /// Thermal time constant, s, and resistance, K/W (assumed small, so that a run shows it).
    pub thermal_time: f64,
    pub thermal_rise: f64,
}

/// Channel means of one sample: com (user rad), theta_m, omega_m, i_q, v, theta_u, temperature, load.
pub type Row = [f64; 8];

/// Sums of squares over the steps of a run; the effects' of their sample means.
#[derive(Clone, Debug)]
struct Sums {
    torque: f64,
    voltage: f64,
    current: f64,
    effect: Vec<f64>,
    steps: usize,
    warmest: f64,
}

impl Sums {
    fn new(effects: usize) -> Sums {
        Sums {
            torque: 0.0,
            voltage: 0.0,
            current: 0.0,
            effect: vec![0.0; effects],
            steps: 0,
            warmest: 0.0,
        }
    }

    /// Ends a sample: what an effect adds counts by its mean over the sample, as no more is seen at 1 kHz.
    fn close(&mut self, own: &mut [f64], steps: usize) {
        for (sum, x) in self.effect.iter_mut().zip(own) {
            *sum += *x * *x / steps as f64;
            *x = 0.0;
        }
    }
}

/// One run without sensors.
struct Run {
    rows: Vec<Row>,
    sums: Sums,
}

/// One recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    pub file: &'static str,
    pub role: &'static str,
    /// At 1 kHz, the first sample's time stamp is 1 ms.
    pub rows: Vec<Row>,
}

/// A case: what the study may see, and the key.
#[derive(Clone, Debug)]
pub struct Case {
    pub seed: u64,
    pub spec: Spec,
    pub recordings: Vec<Recording>,
    pub truth: Truth,
    pub effects: Vec<Effect>,
    /// Severity reached by each effect: 1 is 100 %.
    pub reached: Vec<f64>,
    /// References over the fit runs: rms torque N m, rms voltage V, rms current A; largest temperature rise, K.
    pub references: [f64; 4],
    pub sensors: Sensors,
}

/// Severity of each effect and the references, from the fit runs.
fn severities(effects: &[Effect], runs: &[Sums]) -> (Vec<f64>, [f64; 4]) {
    let steps = runs.iter().map(|s| s.steps).sum::<usize>().max(1) as f64;
    let rms = |f: &dyn Fn(&Sums) -> f64| (runs.iter().map(f).sum::<f64>() / steps).sqrt();
    let (torque, voltage, current) = (rms(&|s| s.torque), rms(&|s| s.voltage), rms(&|s| s.current));
    let warmest = runs.iter().fold(0.0f64, |m, s| m.max(s.warmest));
    let reached = effects.iter().enumerate().map(|(n, e)| {
        let own = match e.kind {
            Kind::CurrentOffset => e.amp.abs(),
            Kind::CurrentGain => e.amp.abs() * current,
            _ => rms(&|s| s.effect[n]),
        };
        let reference = match e.kind.quantity() {
            Quantity::Torque => torque,
            Quantity::Voltage => voltage,
            Quantity::PlayAngle => 1.0,
            Quantity::EncoderAngle => 0.2,
            Quantity::Current => current,
        };
        own / (0.1 * reference)
    });
    (reached.collect(), [torque, voltage, current, warmest])
}

/// Draws the kinds of a class.
fn drawn(spec: &Spec, rng: &mut ChaCha8Rng) -> Vec<Kind> {
    let all: &[Kind] = match spec.class {
        Class::Outside => Kind::drawn_outside(spec.rig),
        _ => Kind::drawn(spec.rig),
    };
    let list: Vec<Kind> = all.iter().copied().filter(|k| !spec.without.contains(k)).collect();
    let mut pick = |from: &[Kind]| (!from.is_empty()).then(|| from[rng.random_range(0..from.len())]);
    match spec.class {
        Class::Nothing => Vec::new(),
        Class::One | Class::Outside => pick(&list).into_iter().collect(),
        Class::Two => {
            let Some(first) = pick(&list) else { return Vec::new() };
            let rest: Vec<Kind> = list.iter().copied().filter(|k| first.compatible(*k)).collect();
            [Some(first), pick(&rest)].into_iter().flatten().collect()
        }
    }
}

/// Makes a case; the same seed and spec make the same case.
pub fn case(seed: u64, spec: &Spec) -> Case {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut off = |x: f64| x * (0.9 + 0.2 * rng.random::<f64>());
    let kt = off(ASSUMED.kt);
    let nominal = Nominal {
        kt,
        ke: kt,
        inertia: off(ASSUMED.inertia),
        viscous: off(ASSUMED.viscous),
        coulomb: off(ASSUMED.coulomb),
        resistance: off(ASSUMED.resistance),
        inductance: off(ASSUMED.inductance),
        ..ASSUMED
    };
    let mut rise = 12.0 + 20.0 * rng.random::<f64>();
    let mut truth = Truth {
        nominal,
        thermal_time: 2.5 + 2.5 * rng.random::<f64>(),
        thermal_rise: 10.0,
    };
    let mut plans = [
        commands::staircase(&mut rng),
        commands::sines(&mut rng),
        commands::heldout(&mut rng),
    ];
    if spec.rig == Rig::ThreePhase {
        // the relays need voltage in hand at the highest speed
        plans.iter_mut().for_each(|c| c.com.iter_mut().for_each(|q| *q *= 0.85));
    }
    let [fit1, fit2, held] = plans;
    let visited: Vec<f64> = [&fit1, &fit2]
        .iter()
        .flat_map(|c| c.com.iter().step_by(50).copied())
        .collect();
    let sensors = Sensors::draw(spec.setting, &mut rng);
    let kinds: Vec<(Kind, &[(String, f64)])> = if spec.forced.is_empty() {
        drawn(spec, &mut rng).into_iter().map(|k| (k, &[][..])).collect()
    } else {
        spec.forced.iter().map(|f| (f.kind, &f.parameters[..])).collect()
    };
    let mut effects: Vec<Effect> = Vec::new();
    for (kind, given) in kinds {
        let mut e = Effect::draw(kind, spec.setting, &nominal, &visited, &mut rng);
        let power = kind.scale(&nominal).2;
        e.amp *= spec.severity.powf(1.0 / power);
        if kind == Kind::TorqueSaturation && e.other {
            e.amp *= 0.35;
        }
        // the first key first: damping is set for the stiffness that holds
        for key in kind.keys() {
            if let Some((_, value)) = given.iter().find(|(k, _)| k == key) {
                e.set(key, *value, &nominal);
            }
        }
        effects.push(e);
    }

    // jumps at the edges of conduction fall between steps: finer there
    let edges = [Kind::Eccentricity, Kind::TurnShort, Kind::CommutationOffset];
    let fine = if effects.iter().any(|e| edges.contains(&e.kind)) {
        10
    } else {
        4
    };
    let simulate = |truth: &Truth, effects: &[Effect], command: &Command, coarse: bool| match spec.rig {
        Rig::Servo => servo::run(truth, &LAWS, effects, command, if coarse { 2 } else { fine }),
        Rig::ThreePhase => three_phase::run(truth, &LAWS, effects, command, if coarse { 3 } else { 5 }),
    };
    // amplitudes to the severity by a secant in logarithms, and the heating to its rise
    let mut powers: Vec<f64> = effects.iter().map(|e| e.kind.scale(&nominal).2).collect();
    let mut before: Option<(Vec<f64>, Vec<f64>)> = None;
    for _ in 0..7 {
        let sums: Vec<Sums> = [&fit1, &fit2].map(|c| simulate(&truth, &effects, c, true).sums).into();
        let (reached, references) = severities(&effects, &sums);
        let mut settled = true;
        let warm = references[3].max(1e-6);
        if let Some(heat) = effects.iter_mut().find(|e| e.kind == Kind::WindingHeating && !e.fixed) {
            heat.amp = warm;
        }
        let mut next = effects.clone();
        for n in 0..effects.len() {
            let (now, got) = (effects[n].amp.abs(), reached[n].max(1e-9));
            if effects[n].fixed {
                continue;
            }
            if let Some((amps, gots)) = &before {
                let run = (now / amps[n]).ln();
                if run.abs() > 1e-3 {
                    powers[n] = ((got / gots[n].max(1e-9)).ln() / run).clamp(0.3, 3.0);
                }
            }
            let top = effects[n].kind.scale(&nominal).1;
            let wanted = (now * (spec.severity / got).powf(1.0 / powers[n]).clamp(0.05, 20.0)).min(top);
            settled &= (wanted / now).ln().abs() < 0.03;
            next[n].amp = wanted.copysign(effects[n].amp);
        }
        if let Some(heat) = next.iter().find(|e| e.kind == Kind::WindingHeating) {
            rise = heat.amp;
        }
        settled &= (rise / warm).ln().abs() < 0.05;
        truth.thermal_rise *= rise / warm;
        before = Some((effects.iter().map(|e| e.amp.abs()).collect(), reached));
        effects = next;
        if settled {
            break;
        }
    }

    let runs = [
        ("fit1.csv", "fit", fit1),
        ("fit2.csv", "fit", fit2),
        ("heldout.csv", "heldout", held),
    ];
    let mut recordings = Vec::new();
    let mut sums = Vec::new();
    for (file, role, command) in &runs {
        let run = simulate(&truth, &effects, command, false);
        recordings.push(Recording {
            file,
            role,
            rows: sensors.measure(&run, &effects, &mut rng),
        });
        if *role == "fit" {
            sums.push(run.sums);
        }
    }
    let (reached, references) = severities(&effects, &sums);
    if let Some(heat) = effects.iter_mut().find(|e| e.kind == Kind::WindingHeating) {
        heat.amp = references[3];
    }
    Case {
        seed,
        spec: spec.clone(),
        recordings,
        truth,
        effects,
        reached,
        references,
        sensors,
    }
}

#[cfg(test)]
mod tests;
