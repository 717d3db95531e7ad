//! Actuator parameters: TOML in, checked values out.

use crate::effect::{self, Effect, REFERENCE_TEMPERATURE_DEGC};
use schemas::error::{Error, Result};
use schemas::fingerprint::{exact, fingerprint};
use schemas::toml_section::{self, Section, quoted};
use std::borrow::Cow;
use std::path::Path;

const REFERENCE: &str = include_str!("../../datasets/parameters/reference.toml");

/// Shortest step of a simulation [s] (assumed): a test of 3 s is then 300 million of them.
const LEAST_STEP_S: f64 = 1e-8;

/// What a parameter may be.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Bound {
    AboveZero,
    AtLeastZero,
    /// 0 to 1
    Share,
    /// above 0, at most 1, and 1 where the file is silent
    Efficiency,
    /// a whole number, the same for all units of a type
    PolePairs,
    /// short against L/R, the same for all units of a type
    Step,
    /// [`REFERENCE_TEMPERATURE_DEGC`] where the file is silent
    Temperature,
    /// of the drive, 0 where it is that of the motor; the same for all units of a type
    DriveConstant,
}

impl Bound {
    /// Whether units of one type may differ in it.
    const fn varies(self) -> bool {
        !matches!(self, Self::PolePairs | Self::Step | Self::DriveConstant)
    }

    /// What it is where the file is silent.
    const fn default(self) -> Option<f64> {
        match self {
            Self::Efficiency => Some(1.0),
            Self::Temperature => Some(REFERENCE_TEMPERATURE_DEGC),
            Self::DriveConstant => Some(0.0),
            _ => None,
        }
    }

    /// Whether [`ActuatorParameters::assumed`] and [`ActuatorParameters::identified`] name it.
    const fn is_marked(self) -> bool {
        self.default().is_none() && !matches!(self, Self::Step)
    }

    /// * `electrical` time constant of the windings, L/R [s]
    fn allows(self, x: f64, electrical: f64) -> bool {
        match self {
            Self::AboveZero => x > 0.0,
            Self::AtLeastZero | Self::DriveConstant => x >= 0.0,
            Self::Share => (0.0..=1.0).contains(&x),
            Self::Efficiency => x > 0.0 && x <= 1.0,
            Self::PolePairs => x.fract() == 0.0 && (1.0..=100.0).contains(&x),
            Self::Step => x >= LEAST_STEP_S && x <= 0.1 * electrical && x <= 1e-4,
            Self::Temperature => (-100.0..=300.0).contains(&x),
        }
    }

    /// [`Bound::allows`] in words.
    fn allowed(self, electrical: f64) -> Cow<'static, str> {
        match self {
            Self::AboveZero => "a finite number above 0".into(),
            Self::AtLeastZero | Self::DriveConstant => "a finite number of at least 0".into(),
            Self::Share => "0 to 1".into(),
            Self::Efficiency => "a number above 0 and at most 1".into(),
            Self::PolePairs => "a whole number from 1 to 100".into(),
            Self::Step => {
                format!("at least 1e-8 s, at most a tenth of L/R = {electrical:.3e} s and at most 1e-4 s").into()
            }
            Self::Temperature => "-100 to 300 degC".into(),
        }
    }
}

/// A row of the table of parameters.
#[derive(Clone, Copy)]
struct Parameter {
    name: &'static str,
    table: &'static str,
    key: &'static str,
    unit: &'static str,
    bound: Bound,
}

/// How well the values of an actuator's file are known that were identified from measurements: standard deviations
/// and correlations of a study.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Uncertainty {
    /// keys as in the file, `motor.inertia_kg_m2`
    pub parameters: Vec<String>,
    /// relative standard deviations, in the order of the keys
    pub deviation: Vec<f64>,
    /// correlations, row by row
    pub correlation: Vec<f64>,
}

impl Uncertainty {
    /// Relative standard deviation of a key; `None` where nothing is said of it.
    pub fn of(&self, key: &str) -> Option<f64> {
        let i = self.parameters.iter().position(|p| p == key)?;
        self.deviation.get(i).copied()
    }

    fn read(s: &mut Section) -> Result<Self> {
        if !s.may_have("uncertainty") {
            return Ok(Self::default());
        }
        let mut t = s.section("uncertainty")?;
        let parameters = t.texts("parameters", "a list of keys, `motor.inertia_kg_m2`")?;
        let n = parameters.len();
        let known = |key: &String| ALL.iter().any(|p| key.split_once('.') == Some((p.table, p.key)));
        if let Some(key) = parameters.iter().find(|key| !known(key)) {
            return Err(t.bad("parameters", key, "keys of the file, `motor.inertia_kg_m2`"));
        }
        let deviation = t.numbers("deviation_relative", 0.0..=10.0, n)?;
        let correlation = t.numbers("correlation", -1.0..=1.0, n * n)?;
        t.finish()?;
        Ok(Self {
            parameters,
            deviation,
            correlation,
        })
    }

    /// Its table in a file; nothing where nothing is known.
    pub fn to_toml(&self) -> String {
        if self.parameters.is_empty() {
            return String::new();
        }
        let keys: Vec<String> = self.parameters.iter().map(|k| quoted(k)).collect();
        let numbers = |x: &[f64]| x.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(", ");
        format!(
            "\n# standard deviations of what was identified, relative, and their correlations row by row\n[uncertainty]\n\
             parameters = [{}]\ndeviation_relative = [{}]\ncorrelation = [{}]\n",
            keys.join(", "),
            numbers(&self.deviation),
            numbers(&self.correlation)
        )
    }
}

macro_rules! parameters {
    ($($(#[$doc:meta])* $field:ident: $type:ty, $table:literal $key:literal $unit:literal $bound:ident;)+) => {
        /// Parameters of one actuator; SI units, motor side unless said.
        #[derive(Clone, Debug, PartialEq)]
        pub struct ActuatorParameters {
            /// for messages and files; does not enter the fingerprint
            pub name: String,
            $(
                $(#[$doc])*
                #[doc = concat!(" [", $unit, "]; `", $key, "` in the table `", $table, "` of a file")]
                pub $field: $type,
            )+
            /// physical effects beyond the paper's, at most [`effect::MOST`]
            pub effects: Vec<Effect>,
            /// keys whose value is assumed rather than sourced
            pub assumed: Vec<String>,
            /// keys whose value was identified from measurements
            pub identified: Vec<String>,
            /// how well what was identified is known
            pub uncertainty: Uncertainty,
        }

        const ALL: &[Parameter] = &[$(Parameter {
            name: stringify!($field),
            table: $table,
            key: $key,
            unit: $unit,
            bound: Bound::$bound,
        }),+];

        impl ActuatorParameters {
            /// Without name, effects and marks.
            fn of(values: [f64; ALL.len()]) -> Self {
                let [$($field),+] = values;
                Self {
                    name: String::new(),
                    $($field: $field as $type,)+
                    effects: Vec::new(),
                    assumed: Vec::new(),
                    identified: Vec::new(),
                    uncertainty: Uncertainty::default(),
                }
            }

            /// Values in the order of [`ALL`].
            fn all(&self) -> [f64; ALL.len()] {
                [$(f64::from(self.$field)),+]
            }
        }
    };
}

// Every parameter once: field, type, table and key and unit in the file, bound. The tables follow each
// other as they are read, and the text of the fingerprint has the values in this order.
parameters! {
    /// supply voltage Vs
    supply_voltage_v: f64, "supply" "voltage_v" "V" AboveZero;
    /// resistance R of one phase of the star
    phase_resistance_ohm: f64, "motor" "phase_resistance_ohm" "ohm" AboveZero;
    /// inductance L of one phase of the star
    phase_inductance_h: f64, "motor" "phase_inductance_h" "H" AboveZero;
    /// back-EMF coefficient ke of one phase; two phases in series give kt = 2 ke
    back_emf_v_s_per_rad: f64, "motor" "back_emf_v_s_per_rad" "V s/rad" AboveZero;
    /// pole pairs P
    pole_pairs: u32, "motor" "pole_pairs" "-" PolePairs;
    /// inertia J
    inertia_kg_m2: f64, "motor" "inertia_kg_m2" "kg m2" AboveZero;
    /// viscous friction C
    viscous_n_m_s_per_rad: f64, "motor" "viscous_n_m_s_per_rad" "N m s/rad" AtLeastZero;
    /// greatest motor torque Tmax
    torque_limit_n_m: f64, "motor" "torque_limit_n_m" "N m" AboveZero;
    /// nominal static dry friction FSJ0; the fault FSJ multiplies it
    static_friction_n_m: f64, "friction" "static_n_m" "N m" AtLeastZero;
    /// dynamic over static dry friction, FDJ/FSJ; `dynamic_ratio` in files and among what is known of a unit, `dynamic_ratio_relative` in
    /// spreads, by its own name in plans
    dynamic_friction_ratio: f64, "friction" "dynamic_ratio" "-" Share;
    /// gear ratio N, motor to user
    gear_ratio: f64, "transmission" "gear_ratio" "-" AboveZero;
    /// backlash half-width b, at the user shaft
    backlash_half_width_rad: f64, "transmission" "backlash_half_width_rad" "rad" AtLeastZero;
    /// end stops at plus and minus this, at the user shaft
    end_stop_rad: f64, "transmission" "end_stop_rad" "rad" AboveZero;
    /// efficiency eta_o of the transmission where the load opposes the motion; 1 = no loss
    opposing_efficiency: f64, "transmission" "opposing_efficiency" "-" Efficiency;
    /// efficiency eta_a where the load aids it; 1 = no loss
    aiding_efficiency: f64, "transmission" "aiding_efficiency" "-" Efficiency;
    /// gain GAP of the position loop
    position_gain_per_s: f64, "controller" "position_gain_per_s" "(rad/s motor)/(rad user)" AboveZero;
    /// greatest speed reference Wmax
    speed_reference_limit_rad_per_s: f64, "controller" "speed_reference_limit_rad_per_s" "rad/s" AboveZero;
    /// proportional gain Kp of the speed loop
    speed_proportional_n_m_s_per_rad: f64, "controller" "speed_proportional_n_m_s_per_rad" "N m s/rad" AboveZero;
    /// integral gain Ki of the speed loop
    speed_integral_n_m_per_rad: f64, "controller" "speed_integral_n_m_per_rad" "N m/rad" AtLeastZero;
    /// limit Tint of the speed loop's integrator
    integrator_limit_n_m: f64, "controller" "integrator_limit_n_m" "N m" AtLeastZero;
    /// greatest current reference Imax
    current_limit_a: f64, "controller" "current_limit_a" "A" AboveZero;
    /// torque of an ampere that the drive reckons with, by which it divides its torque demand; 0: twice the back-EMF
    /// coefficient. A unit whose flux differs keeps that of its type
    drive_constant_n_m_per_a: f64, "controller" "drive_constant_n_m_per_a" "N m/A" DriveConstant;
    /// half-band HB of the hysteresis current control
    hysteresis_half_band_a: f64, "controller" "hysteresis_half_band_a" "A" AboveZero;
    /// step dt of the numerical test bench
    step_s: f64, "numerics" "step_s" "s" Step;
    /// temperature of friction and surroundings
    temperature_degc: f64, "environment" "temperature_degc" "degC" Temperature;
}

const fn count_varying() -> usize {
    let (mut k, mut n) = (0, 0);
    while k < ALL.len() {
        n += ALL[k].bound.varies() as usize;
        k += 1;
    }
    n
}

/// Places in [`ALL`] of [`PARAMETERS`].
const VARYING: [usize; count_varying()] = {
    let mut places = [0; count_varying()];
    let (mut k, mut n) = (0, 0);
    while k < ALL.len() {
        if ALL[k].bound.varies() {
            places[n] = k;
            n += 1;
        }
        k += 1;
    }
    places
};

/// Physical parameters that may differ from one actuator of a fleet to another: name, and table and key
/// of the actuator's file. The name is that of the field, and of the column in `actuators`.
pub const PARAMETERS: [(&str, &str, &str); VARYING.len()] = {
    let mut all = [("", "", ""); VARYING.len()];
    let mut n = 0;
    while n < VARYING.len() {
        let p = ALL[VARYING[n]];
        all[n] = (p.name, p.table, p.key);
        n += 1;
    }
    all
};

/// Unit of a parameter, as in files.
///
/// * `parameter` its place in [`PARAMETERS`]
pub fn unit(parameter: usize) -> &'static str {
    ALL[VARYING[parameter]].unit
}

/// Least and greatest value that a parameter may have by itself; a least value of 0 may be excluded.
///
/// * `parameter` its place in [`PARAMETERS`]
pub fn range(parameter: usize) -> (f64, f64) {
    match ALL[VARYING[parameter]].bound {
        Bound::Temperature => (-100.0, 300.0),
        _ => (0.0, most(parameter)),
    }
}

/// Greatest value that a draw of a parameter may have: a share and an efficiency end at one.
///
/// * `parameter` its place in [`PARAMETERS`]
pub fn most(parameter: usize) -> f64 {
    match ALL[VARYING[parameter]].bound {
        Bound::Share | Bound::Efficiency => 1.0,
        _ => f64::INFINITY,
    }
}

impl ActuatorParameters {
    /// Stands for the reference actuator in place of a file.
    pub const BUILT_IN: &str = "reference";

    /// Values in the order of [`PARAMETERS`].
    pub fn values(&self) -> [f64; PARAMETERS.len()] {
        let all = self.all();
        VARYING.map(|k| all[k])
    }

    /// Parses the text of a file, with other values of some of [`PARAMETERS`] (by their place there).
    ///
    /// # Errors
    /// Those of the file, and values that physics forbids.
    pub fn parse_with(file: &str, text: &str, values: &[(usize, f64)]) -> Result<Self> {
        let mut s = toml_section::parse(file, text)?;
        for &(k, x) in values {
            s.put(PARAMETERS[k].1, PARAMETERS[k].2, x)?;
        }
        Self::from_section(s)
    }

    /// Every parameter: name of the field, unit, value; in the order of a file.
    pub fn parameters(&self) -> impl Iterator<Item = (&'static str, &'static str, f64)> {
        ALL.iter().zip(self.all()).map(|(p, x)| (p.name, p.unit, x))
    }

    /// The same with other values of some parameters, which are checked as those of a file are.
    ///
    /// * `changes` names as in [`ActuatorParameters::parameters`]
    ///
    /// # Errors
    /// A name that is none, and values that physics forbids.
    pub fn with(&self, changes: &[(&str, f64)]) -> Result<Self> {
        let file = format!("actuator `{}`", self.name);
        let mut s = toml_section::parse(&file, &self.to_toml())?;
        for &(name, x) in changes {
            let Some(p) = ALL.iter().find(|p| p.name == name) else {
                let names: Vec<&str> = ALL.iter().map(|p| p.name).collect();
                return Err(Error::bad(file, "parameter", name, names.join(", ")));
            };
            s.put(p.table, p.key, x)?;
        }
        Self::from_section(s)
    }

    /// The reference actuator of `datasets/parameters/reference.toml`.
    pub fn reference() -> Self {
        Self::parse("datasets/parameters/reference.toml", REFERENCE).expect("the built-in parameters are valid")
    }

    /// Text of the reference actuator's file.
    pub fn reference_text() -> &'static str {
        REFERENCE
    }

    /// Reads a file. `reference` is the reference actuator, unless a file has that name.
    ///
    /// # Errors
    /// A file that cannot be read; else as [`ActuatorParameters::parse`].
    pub fn read(path: &Path) -> Result<Self> {
        if path == Path::new(Self::BUILT_IN) && !path.exists() {
            return Ok(Self::reference());
        }
        Self::from_section(toml_section::read(path)?)
    }

    /// Parses the text of a file.
    ///
    /// * `file` for messages
    ///
    /// # Errors
    /// A missing or unknown key, a value that physics forbids, an effect that is not known.
    pub fn parse(file: &str, text: &str) -> Result<Self> {
        Self::parse_with(file, text, &[])
    }

    fn from_section(mut s: Section) -> Result<Self> {
        let name = s.text("name", "a text")?;
        let (mut assumed, mut identified) = (Vec::new(), Vec::new());
        let mut values = [f64::NAN; ALL.len()];
        let mut k = 0;
        for rows in ALL.chunk_by(|a, b| a.table == b.table) {
            let table = rows[0].table;
            let may_be_absent = rows.iter().all(|p| p.bound.default().is_some());
            let mut t = if may_be_absent && !s.may_have(table) {
                None
            } else {
                Some(s.section(table)?)
            };
            for Parameter { key, bound, .. } in rows {
                // of what was read before it
                let so_far = Self::of(values);
                let electrical = so_far.phase_inductance_h / so_far.phase_resistance_ohm;
                let ok = |x: f64| bound.allows(x, electrical);
                let allowed = bound.allowed(electrical);
                values[k] = match (&mut t, bound.default()) {
                    (None, default) => default.expect("of a table that may be absent"),
                    (Some(t), Some(default)) => t.number_or(key, default, ok, &allowed)?,
                    (Some(t), None) => {
                        let (x, source) = t.sourced(key, ok, &allowed)?;
                        if bound.is_marked() && source.as_deref() == Some("assumed") {
                            assumed.push(format!("{table}.{key}"));
                        } else if bound.is_marked() && source.is_some_and(|s| s.starts_with("identified")) {
                            identified.push(format!("{table}.{key}"));
                        }
                        x
                    }
                };
                k += 1;
            }
            t.map_or(Ok(()), Section::finish)?;
        }
        let plain = Self::of(values);
        let effects = effect::read(&mut s, plain.inertia_kg_m2)?;
        let uncertainty = Uncertainty::read(&mut s)?;
        s.finish()?;
        Ok(Self {
            name,
            effects,
            assumed,
            identified,
            uncertainty,
            ..plain
        })
    }

    /// A file that reads back as this actuator, bit for bit; of the sources it has what is assumed and
    /// what was identified.
    pub fn to_toml(&self) -> String {
        let mut out = format!("name = {}\n", quoted(&self.name));
        let mut table = "";
        for (p, x) in ALL.iter().zip(self.all()) {
            if p.table != table {
                table = p.table;
                out += &format!("\n[{table}]\n");
            }
            if p.bound == Bound::DriveConstant && x == 0.0 {
                continue;
            }
            let has = |list: &[String]| list.iter().any(|k| k.split_once('.') == Some((p.table, p.key)));
            let source = match (has(&self.assumed), has(&self.identified)) {
                (true, _) => ", source = \"assumed\"",
                (_, true) => ", source = \"identified\"",
                _ => "",
            };
            out += &format!("{} = {{ value = {x:?}, unit = \"{}\"{source} }}\n", p.key, p.unit);
        }
        out += &self.uncertainty.to_toml();
        for e in &self.effects {
            out += &format!("\n{}", e.to_toml());
        }
        out
    }

    /// kt of two phases in series [N m/A].
    pub fn torque_constant_n_m_per_a(&self) -> f64 {
        2.0 * self.back_emf_v_s_per_rad
    }

    /// Static over dynamic dry friction; 1 where there is no dynamic one, which nothing can be a multiple of.
    pub fn break_away_ratio(&self) -> f64 {
        if self.dynamic_friction_ratio > 0.0 {
            1.0 / self.dynamic_friction_ratio
        } else {
            1.0
        }
    }

    /// By which the drive divides its torque demand [N m/A].
    pub fn drive_constant(&self) -> f64 {
        if self.drive_constant_n_m_per_a > 0.0 {
            self.drive_constant_n_m_per_a
        } else {
            self.torque_constant_n_m_per_a()
        }
    }

    /// Of every value, not of the name; an actuator without effects has the one that it had before
    /// effects were known.
    pub fn fingerprint(&self) -> String {
        // the temperature only where effects know it
        let values = ALL.iter().zip(self.all());
        let values = values.filter(|(p, _)| !matches!(p.bound, Bound::Temperature | Bound::DriveConstant));
        let mut text = format!(
            "actuator;{}",
            values.map(|(_, x)| exact(x)).collect::<Vec<_>>().join(",")
        );
        if self.drive_constant() != self.torque_constant_n_m_per_a() {
            text += &format!(";drive,{}", exact(self.drive_constant_n_m_per_a));
        }
        if !self.effects.is_empty() {
            text += &format!(";temperature,{}", exact(self.temperature_degc));
        }
        for e in &self.effects {
            let values: Vec<String> = e.parameters().map(|(_, x)| exact(x)).collect();
            text += &format!(";{},{}", e.kind.name(), values.join(","));
            if e.grows != 0.0 {
                text += &format!(",grows,{}", exact(e.grows));
            }
            // a phase stands as its number
            if let Some(q) = e.sensor() {
                text += &format!(",sensor,{q}");
            } else if let Some((key, law)) = e.said_law() {
                text += &format!(",{key},{law}");
            }
        }
        fingerprint(&text)
    }
}

#[cfg(test)]
mod tests;
