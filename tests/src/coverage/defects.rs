//! Tests of actuators with a defect that the maps know nothing of, simulated by another hand ([`crate::independent`]): its
//! effects, drawn by it, its sensors, and sensors that are wrong.

use super::units::Kind;
use super::{Case, FSJ, ZETA, judge, other_hand, percent};
use crate::independent::{Command, Effect, Telemetry, Unit as OtherUnit};
use anyhow::{Result, anyhow};
use diagnoser::diagnosis::Diagnoser;
use pipeline::calibrate::{Unit, draw_units};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemas::fault::FaultState;
use schemas::feature::{Feature, RawFeatures};
use sim_worker::setup::TestSetup;
use sim_worker::spread::Spread;
use std::fmt::Write;

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Defect {
    /// an effect of the other simulator, by its name
    Effect(&'static str),
    /// friction and viscous friction of a cold or warm actuator, static and dynamic alike
    TemperatureDependentFriction,
    /// friction in proportion to a load on the surface, which the test knows nothing of
    LoadDependentFriction,
    /// the inertia is another one
    Inertia,
    /// the healthy unit has more or less friction than its type
    HealthyFriction,
    /// the recorded speed is too high or too low in proportion
    SpeedGain,
    /// the recorded speed is off
    SpeedOffset,
    /// one recorded phase current is too high or too low in proportion
    PhaseGain,
    /// the recorded supply is too high or too low in proportion
    SupplyGain,
}

use Defect::Effect as Of;

/// Of these witnesses may be designed.
pub const DESIGN: [Defect; 17] = [
    Of("cogging"),
    Of("backlash"),
    Of("turn_short"),
    Of("current_offset"),
    Of("bias_torque"),
    Of("stribeck"),
    Of("current_gain"),
    Of("quadratic_drag"),
    Defect::TemperatureDependentFriction,
    Of("periodic_friction"),
    Of("presliding"),
    Of("eccentricity"),
    Of("spring_load"),
    Of("winding_heating"),
    Of("encoder_eccentricity"),
    Defect::Inertia,
    Defect::SpeedGain,
];

/// On these they are judged; nobody who makes them looks before.
pub const JUDGED: [Defect; 15] = [
    Of("lubricated_rise"),
    Of("viscous_asymmetry"),
    Of("tight_spot"),
    Of("torque_ripple"),
    Of("torque_saturation"),
    Of("compliance"),
    Of("supply_sag"),
    Of("dead_time"),
    Of("commutation_offset"),
    Of("control_delay"),
    Defect::LoadDependentFriction,
    Defect::HealthyFriction,
    Defect::SpeedOffset,
    Defect::PhaseGain,
    Defect::SupplyGain,
];

/// Full severity ("clearly relevant", in the words of the other hand), a third and a tenth.
pub const SEVERITIES: [(f64, &str); 3] = [(1.0, "full"), (1.0 / 3.0, "third"), (0.1, "tenth")];

/// Warmer or colder than its model at full severity [K] (assumed).
const KELVIN: f64 = 35.0;

impl Defect {
    /// Whether a unit has it from its first test on: spreads of units have it already.
    fn is_of_birth(self) -> bool {
        self == Defect::HealthyFriction
    }

    /// Whether it is friction and nothing else: no test tells it from FSJ.
    fn is_friction_itself(self) -> bool {
        matches!(
            self,
            Defect::HealthyFriction | Defect::LoadDependentFriction | Defect::TemperatureDependentFriction
        )
    }

    /// In tables.
    pub fn title(self) -> String {
        match self {
            Of(name) => name.replace('_', " "),
            Defect::TemperatureDependentFriction => "temperature dependent friction".into(),
            Defect::LoadDependentFriction => "load dependent friction".into(),
            Defect::Inertia => "inertia, 10 to 30 %".into(),
            Defect::HealthyFriction => "healthy friction, 10 to 30 %".into(),
            Defect::SpeedGain => "speed sensor's gain, 1 to 5 %".into(),
            Defect::SpeedOffset => "speed sensor's offset, 1 to 5 rad/s".into(),
            Defect::PhaseGain => "one phase's recorded gain, 2 to 10 %".into(),
            Defect::SupplyGain => "recorded supply's gain, 1 to 5 %".into(),
        }
    }

    /// Puts it into a unit; what the sensors need to know of it is returned.
    ///
    /// * `faults` of the test (FSJ, zeta)
    fn hide(self, unit: &mut OtherUnit, faults: (f64, f64), severity: f64, rng: &mut ChaCha8Rng) -> Sensing {
        let signed = |rng: &mut ChaCha8Rng, lo: f64, hi: f64| {
            let size = severity * rng.random_range(lo..hi);
            if rng.random::<bool>() { size } else { -size }
        };
        let mut sensing = Sensing::default();
        match self {
            Of(name) => {
                let effect = Effect::drawn(name, severity, unit, rng).expect("a name of the other simulator");
                unit.effects.push(effect);
            }
            Defect::TemperatureDependentFriction => {
                let warm = signed(rng, 0.5, 1.0) * KELVIN;
                // levels fall by 0.3 to 1 % each kelvin
                unit.fs0 *= 1.0 - warm * rng.random_range(0.003..0.01);
                unit.c *= 1.0 - warm * rng.random_range(0.003..0.01);
            }
            Defect::LoadDependentFriction => {
                // of both levels alike, whatever the friction fault
                let level = severity * rng.random_range(0.004..0.012);
                unit.fs0 += level / faults.0;
            }
            Defect::Inertia => unit.j *= 1.0 + signed(rng, 0.1, 0.3),
            Defect::HealthyFriction => unit.fs0 *= 1.0 + signed(rng, 0.1, 0.3),
            Defect::SpeedGain => sensing.speed.0 = signed(rng, 0.01, 0.05),
            Defect::SpeedOffset => sensing.speed.1 = signed(rng, 1.0, 5.0),
            Defect::PhaseGain => sensing.phase = (rng.random_range(0..3), signed(rng, 0.02, 0.1)),
            Defect::SupplyGain => sensing.supply = signed(rng, 0.01, 0.05),
        }
        sensing
    }

    /// The pair that a diagnosis should find: hidden eccentricity is the fault itself.
    fn truth(self, fault: FaultState, unit: &OtherUnit) -> FaultState {
        let hidden = unit.effects.iter().filter(|e| e.name == "eccentricity");
        let (x, y) = hidden.fold((fault.zeta, 0.0), |(x, y), e| {
            let (size, phase) = (e.get("zeta"), e.get("phase"));
            (x + size * phase.cos(), y + size * phase.sin())
        });
        FaultState {
            fsj: fault.fsj,
            zeta: x.hypot(y),
        }
    }
}

/// What sensors make of what they see.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sensing {
    /// gain less 1, and offset [rad/s]
    speed: (f64, f64),
    /// of which phase, gain less 1
    phase: (usize, f64),
    /// gain less 1
    supply: f64,
}

impl Sensing {
    fn distort(self, t: &mut Telemetry) {
        t.omega_m
            .iter_mut()
            .for_each(|w| *w = *w * (1.0 + self.speed.0) + self.speed.1);
        t.i[self.phase.0].iter_mut().for_each(|i| *i *= 1.0 + self.phase.1);
        t.v_dc.iter_mut().for_each(|v| *v *= 1.0 + self.supply);
    }
}

/// Tests with a defect, and what should be found in them.
pub struct Hidden {
    /// as they are; the faults are those that should be found
    pub units: Vec<Unit>,
    /// as their sensors gave them
    pub measured: Vec<RawFeatures>,
}

/// Puts a defect into tests and measures them.
///
/// * `seed` of the defect's own draws
pub fn hide(
    setup: &TestSetup,
    spread: &Spread,
    command: &Command,
    (defect, severity): (Defect, f64),
    mut units: Vec<Unit>,
    seed: u64,
) -> Hidden {
    let odd = |u: &Unit| {
        let mut unit = other_hand::of(spread, u);
        let mut rng = ChaCha8Rng::seed_from_u64(u.seed ^ seed);
        let sensing = defect.hide(&mut unit, (u.fault.fsj, u.fault.zeta), severity, &mut rng);
        (unit, sensing)
    };
    let measured = other_hand::measure_odd(setup, &units, command, odd, Sensing::distort);
    for u in &mut units {
        u.fault = defect.truth(u.fault, &odd(u).0);
    }
    Hidden { units, measured }
}

/// Of one severity of one defect.
#[derive(Clone, Copy, Debug, Default)]
pub struct Count {
    tests: usize,
    unexplained: usize,
    out_of_range: usize,
    inside: usize,
    /// located, and off by more than the interval is wide
    off: usize,
    /// by more than twice its width
    far: usize,
}

impl Count {
    /// Of cases.
    pub fn of(cases: &[Case]) -> Self {
        let count = |f: &dyn Fn(&Case) -> bool| cases.iter().filter(|c| f(c)).count();
        let by = |c: &Case, widths: f64| {
            c.outcome == "located"
                && c.found
                    .is_some_and(|((wf, wz), (ef, ez))| ef.abs() > widths * wf || ez.abs() > widths * wz)
        };
        Self {
            tests: cases.len(),
            unexplained: count(&|c| c.outcome == "unexplained"),
            out_of_range: count(&|c| c.outcome == "out_of_range"),
            inside: count(&|c| c.inside),
            off: count(&|c| by(c, 1.0)),
            far: count(&|c| by(c, 2.0)),
        }
    }

    /// Tests located off by more than an interval is wide.
    pub fn off(&self) -> usize {
        self.off
    }

    /// Unexplained tests.
    pub fn unexplained(&self) -> usize {
        self.unexplained
    }

    fn add(&mut self, other: Self) {
        self.tests += other.tests;
        self.unexplained += other.unexplained;
        self.out_of_range += other.out_of_range;
        self.inside += other.inside;
        self.off += other.off;
        self.far += other.far;
    }

    fn cells(&self) -> String {
        let n = self.tests.max(1) as f64;
        let share = |k: usize| 100.0 * k as f64 / n;
        format!(
            " {:.0} | {:.0} | {:.0} | **{:.1}** | {:.1} |",
            share(self.unexplained + self.out_of_range),
            share(self.inside),
            share(self.tests - self.unexplained - self.out_of_range - self.inside),
            share(self.off),
            share(self.far)
        )
    }

    /// Located off by more than the width of an interval, and by more than twice, in percent.
    pub fn silent(&self) -> (String, String) {
        (percent(self.off, self.tests), percent(self.far, self.tests))
    }
}

/// How a defect comes to be tested.
pub enum Known<'a> {
    /// units of a fleet of which no test is known
    Nothing {
        /// by all witnesses
        now: &'a Diagnoser,
        /// by those that messages tell
        before: &'a Diagnoser,
    },
    /// units that had an acceptance test before the defect
    Accepted(&'a Kind<'a>),
}

/// What becomes of defects at each severity.
///
/// * `n` tests of each defect and severity
pub fn table(
    defects: &[Defect],
    setup: &TestSetup,
    spread: &Spread,
    command: &Command,
    known: &Known<'_>,
    (n, seed): (usize, u64),
) -> Result<String> {
    let mut out = String::from("| hidden |");
    SEVERITIES
        .iter()
        .for_each(|(_, name)| out += &format!(" {name}: refused % | inside % | outside % | **off** % | far % |"));
    out += " named most |\n|---|";
    out += &"---|".repeat(5 * SEVERITIES.len() + 1);
    out.push('\n');
    let mut all = [Count::default(); SEVERITIES.len()];
    let (mut others, mut before_all) = (Count::default(), Count::default());
    let with_history = matches!(known, Known::Accepted(_));
    for &defect in defects.iter().filter(|d| !(with_history && d.is_of_birth())) {
        let _ = write!(out, "| {} |", defect.title());
        let mut named = Vec::new();
        for (k, &(severity, _)) in SEVERITIES.iter().enumerate() {
            let seed = 0xDEFE_C700_0000_0000 ^ seed.wrapping_mul(64).wrapping_add(number(defect));
            let cases = match known {
                Known::Nothing { now, before } => {
                    let units = draw_units(FSJ, ZETA, spread, n, seed);
                    let hidden = hide(setup, spread, command, (defect, severity), units, seed);
                    before_all.add(Count::of(&judge(before, &hidden.units, &hidden.measured)));
                    judge(now, &hidden.units, &hidden.measured)
                }
                Known::Accepted(kind) => kind.accepted_then(n, seed, |healthy, worn| {
                    let healthy = other_hand::measure(setup, spread, &healthy, command);
                    (healthy, hide(setup, spread, command, (defect, severity), worn, seed))
                })?,
            };
            let count = Count::of(&cases);
            all[k].add(count);
            if !defect.is_friction_itself() {
                others.add(count);
            }
            out += &count.cells();
            named.extend(cases.into_iter().flat_map(|c| c.contradicting));
        }
        let count = |f: Feature| (named.iter().filter(|x| **x == f).count(), f.name());
        let mut names: Vec<(usize, &str)> = Feature::every().map(count).filter(|(k, _)| *k > 0).collect();
        names.sort_by(|a, b| b.cmp(a));
        let names: Vec<String> = names.iter().take(3).map(|(k, name)| format!("{name} {k}")).collect();
        let _ = writeln!(out, " {} |", names.join(", "));
    }
    out += "| **all** |";
    let mut whole = Count::default();
    for count in all {
        out += &count.cells();
        whole.add(count);
    }
    let (off, far) = whole.silent();
    let _ = writeln!(
        out,
        " |\n\n- of all {} tests: off by more than the interval is wide {off} %, by more than twice {far} %",
        whole.tests
    );
    let (off, far) = others.silent();
    let _ = writeln!(
        out,
        "- of {} without what is friction itself (healthy, by load, by temperature): {off} %, {far} %",
        others.tests
    );
    if before_all.tests > 0 {
        let (off, far) = before_all.silent();
        let _ = writeln!(out, "- of all by the five first witnesses alone: {off} %, {far} %");
    }
    out.push('\n');
    Ok(out)
}

/// Of its own draws.
fn number(defect: Defect) -> u64 {
    let all = DESIGN.iter().chain(&JUDGED);
    all.zip(0..).find(|(d, _)| **d == defect).map_or(63, |(_, k)| k)
}

impl Kind<'_> {
    /// Units with an acceptance test, then one with a defect each.
    ///
    /// * `measure` the acceptance tests, then those with the defect
    fn accepted_then(
        &self,
        n: usize,
        seed: u64,
        measure: impl Fn(Vec<Unit>, Vec<Unit>) -> (Vec<RawFeatures>, Hidden),
    ) -> Result<Vec<Case>> {
        let spread = self.prior.spread();
        let (healthy, worn) = self.draw_accepted(n, seed);
        let (first, hidden) = measure(healthy.clone(), worn);
        let mut cases = Vec::new();
        for k in 0..n {
            let tests = [healthy[k].clone(), hidden.units[k].clone()];
            let raw = [first[k], hidden.measured[k]];
            let of = self.followed(&spread, &tests, &raw)?;
            cases.push(of.into_iter().next().ok_or_else(|| anyhow!("a test was not judged"))?);
        }
        Ok(cases)
    }
}
