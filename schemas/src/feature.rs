//! Features: what a run is measured by, and the scalars that failure maps hold. Each is written down once: name,
//! unit, meaning, how it is formed. Columns, keys, messages and what diagnoses iterate over follow from both tables.

use std::ops::{Index, IndexMut};

/// Ending of a column or key by the unit.
#[rustfmt::skip]
macro_rules! ending {
    ("rad/s") => { "_rad_per_s" };
    ("rad") => { "_rad" };
    ("A") => { "_a" };
    ("V") => { "_v" };
    ("s") => { "_s" };
    ("-") => { "" };
}

macro_rules! raw_features {
    ($($variant:ident $name:literal $unit:tt $meaning:literal),+ $(,)?) => {
        /// What the extractor measures in one run, before anything nominal is subtracted. New ones go to the end:
        /// stored maps know them by their place.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(usize)]
        pub enum Raw { $(#[doc = concat!($meaning, " [", $unit, "]")] $variant),+ }

        impl Raw {
            /// All, in the order of columns.
            pub const ALL: [Raw; [$(Raw::$variant),+].len()] = [$(Raw::$variant),+];
        }

        impl RawFeatures {
            /// Number of raw features.
            pub const COUNT: usize = Raw::ALL.len();
            /// Columns of what is measured, without the rest angle.
            pub const COLUMNS: [&str; Self::COUNT] = [$(concat!($name, ending!($unit))),+];
            /// Columns of their standard deviations.
            pub const DEVIATIONS: [&str; Self::COUNT] = [$(concat!($name, "_sd", ending!($unit))),+];
        }
    };
}

raw_features! {
    MeanSpeed "mean_speed" "rad/s" "mean user speed w/N in the regime window of the step, P1's window",
    Ripple "ripple" "rad/s" "standard deviation of w/N in that window",
    P2 "p2" "A" "root mean square of measured minus simplified-model current over the sine",
    P3 "p3" "rad" "command at break-away in the ramp",
    Rise "rise" "s" "time from the step to half the no-load speed",
    CurrentRms "current_rms" "A" "root mean square of the phase currents in the regime window",
    SineTravel "sine_travel" "rad" "motor travel from one turning point of the sine to the other",
    CurrentSum "current_sum" "A" "mean of the sum of the phase currents in the sine",
    CurrentImbalance "current_imbalance" "-" "greatest less smallest RMS phase current over their mean, in the regime window",
    EvenCurrent "even_current" "A" "root mean square over the places of the sine of the torque-giving current's part that does not turn round with the motion, its straight line over the place taken off",
    BiasCurrent "bias_current" "A" "mean of that part",
    KineticCurrent "kinetic_current" "A" "mean over the places of the sine of the torque-giving current's part that turns round with the motion",
    SlowBreakAway "slow_break_away" "A" "greatest mean over 2 ms of the torque-giving current as the motor leaves the turning points of the slow cosine, mean of both directions",
    SlowKinetic "slow_kinetic" "A" "torque-giving current after it has left them, mean of both directions",
    SlowLag "slow_lag" "s" "from the turning points of the slow cosine's command until the motor leaves its own, mean of both directions",
    LegCurrent "leg_current" "A" "half the difference of the mean torque-giving currents of the lines there and back",
    Supply "supply" "V" "mean supply voltage in the regime window",
    ThirdCosine "third_cosine" "rad/s" "amplitude of the motor speed's third order a turn in the regime window, with the cosine of the rotor angle",
    ThirdSine "third_sine" "rad/s" "the same with the sine",
    OtherOrders "other_orders" "rad/s" "root mean square of the motor speed's orders a turn up to 5, halves included, but the third, in the regime window",
    CurrentTrend "current_trend" "A" "mean torque-giving current in the second half of the regime window less that in the first",
    RunUpCurrent "run_up_current" "A" "mean torque-giving current from the step to half the no-load speed",
    KineticTilt "kinetic_tilt" "A" "slope over the place of the torque-giving current's part that turns round with the motion in the sine, places in amplitudes",
    KineticBend "kinetic_bend" "A" "its bend over the place",
}

impl Raw {
    /// Column of the value.
    pub fn column(self) -> &'static str {
        RawFeatures::COLUMNS[self as usize]
    }
    /// Column of its standard deviation.
    pub fn deviation(self) -> &'static str {
        RawFeatures::DEVIATIONS[self as usize]
    }
    /// Those that faults are located by, as they are or formed into features.
    pub fn locating() -> impl Iterator<Item = Raw> {
        let used = |raw: &Raw| Feature::ALL.iter().any(|f| f.form().raws().any(|r| r == *raw));
        Raw::ALL.into_iter().filter(used)
    }
}

/// How a feature is formed from raw ones of a run and of the nominal run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// The raw value.
    Same(Raw),
    /// Over that of the nominal run.
    Ratio(Raw),
    /// Below that of the nominal run.
    Loss(Raw),
    /// Length of (mean less that of the nominal run, deviation about the mean): root mean square about the
    /// nominal mean.
    Length(Raw, Raw),
}

impl Form {
    /// What it takes.
    pub fn raws(self) -> impl Iterator<Item = Raw> {
        let (first, second) = match self {
            Form::Same(raw) | Form::Ratio(raw) | Form::Loss(raw) => (raw, None),
            Form::Length(mean, deviation) => (mean, Some(deviation)),
        };
        std::iter::once(first).chain(second)
    }

    /// The nominal run's raw value, from that of a run and the feature, where one says the other.
    pub fn nominal(self, raw: f64, feature: f64) -> Option<f64> {
        match self {
            Form::Ratio(_) => Some(raw / feature),
            Form::Loss(_) => Some(raw + feature),
            Form::Same(_) | Form::Length(..) => None,
        }
    }
}

/// What a feature is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Failure maps locate faults by it.
    Locates,
    /// The faults hardly change it and other defects do.
    Witness,
    /// Faults are located by it where the unit is known ([`Role::Locates`] beside it): of a unit of which nothing is known
    /// it says what P2 says.
    Unit,
    /// Shown beside the others; it has no map.
    Shown,
    /// Failure maps locate faults by it where the sequence has what it is taken from (`preflight2`). It stands in files and
    /// reports, not in messages.
    Finer,
    /// A witness that stands in files and reports, not in messages.
    Watches,
    /// No fault changes it, but a cause that units differ by: with it that cause is known in the test. A test may lack it.
    Cause,
}

macro_rules! features {
    ($($variant:ident $name:literal $unit:tt $role:ident ($along:literal, $across:literal) $form:ident($($raw:ident),+)
        $title:literal $meaning:literal),+ $(,)?) => {
        /// A feature of one pre-flight test (paper 4.2). New ones go to the end: the number is a bit in messages.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(usize)]
        pub enum Feature { $(#[doc = concat!($meaning, " [", $unit, "]")] $variant),+ }

        impl Feature {
            /// All, in the order of keys, columns and messages.
            pub const TABLE: [Feature; [$(Feature::$variant),+].len()] = [$(Feature::$variant),+];
            /// Short name in files and reports; what is only shown may have that of another one.
            pub fn name(self) -> &'static str { match self { $(Feature::$variant => $name),+ } }
            /// Column and JSON key: the name with the unit.
            pub fn key(self) -> &'static str { match self { $(Feature::$variant => concat!($name, ending!($unit))),+ } }
            /// Unit of the value; `-` for a ratio.
            pub fn unit(self) -> &'static str { match self { $(Feature::$variant => $unit),+ } }
            /// What it is for.
            pub const fn role(self) -> Role { match self { $(Feature::$variant => Role::$role),+ } }
            /// Direction along (FSJ, zeta): +1 where the feature rises, -1 where it falls.
            pub fn direction(self) -> (f64, f64) { match self { $(Feature::$variant => ($along, $across)),+ } }
            /// How it is formed from raw features.
            pub fn form(self) -> Form { match self { $(Feature::$variant => Form::$form($(Raw::$raw),+)),+ } }
            /// Heading of figures and tables, with the segment that it is taken from.
            pub fn title(self) -> &'static str { match self { $(Feature::$variant => $title),+ } }
        }
    };
}

features! {
    P1 "p1" "rad/s" Locates (1.0, 1.0) Length(MeanSpeed, Ripple) "P1, speed RMS error (step)"
        "Speed RMS error in the step, against the nominal steady-state mean (Eq. 11)",
    P2 "p2" "A" Locates (1.0, 1.0) Same(P2) "P2, current RMS error (sine)"
        "Current RMS error in the sine, against the simplified model (Eq. 22)",
    P3 "p3" "-" Locates (1.0, 1.0) Ratio(P3) "P3, starting error over nominal (ramp)"
        "Starting error in the ramp, over that of the nominal run (Eq. 13)",
    Ripple "ripple" "rad/s" Locates (-1.0, 1.0) Same(Ripple) "speed ripple (step)"
        "Speed ripple about its own mean in P1's window",
    SpeedLoss "speed_loss" "rad/s" Locates (1.0, 1.0) Loss(MeanSpeed) "loss of mean speed (step)"
        "Mean speed in P1's window below that of the nominal run. With the ripple it makes up P1: P1^2 = loss^2 + ripple^2, but it has a sign and no cusp at the healthy point (assumed useful, not in the paper)",
    Rise "rise" "s" Locates (1.0, 1.0) Same(Rise) "rise time to half the no-load speed (step)"
        "Time from the step to half the no-load speed, Vs/(4 ke) (not in the paper)",
    CurrentRms "current_rms" "A" Locates (1.0, 1.0) Same(CurrentRms) "RMS phase current (step)"
        "Root mean square of the phase currents in P1's window (not in the paper)",
    SineTravel "sine_travel" "rad" Witness (1.0, 1.0) Same(SineTravel) "motor travel (sine)"
        "Motor travel from one turning point of the sine to the other",
    CurrentSum "current_sum" "A" Witness (1.0, 1.0) Same(CurrentSum) "sum of the phase currents (sine)"
        "Mean of the sum of the phase currents in the sine",
    CurrentImbalance "current_imbalance" "-" Witness (1.0, 1.0) Same(CurrentImbalance) "imbalance of the phase currents (step)"
        "Greatest less smallest RMS phase current over their mean, in P1's window",
    EvenCurrent "even_current" "A" Witness (1.0, 1.0) Same(EvenCurrent) "current that does not turn round with the motion (sine)"
        "Root mean square of the torque-giving current's part that does not turn round with the motion",
    BiasCurrent "bias_current" "A" Witness (1.0, 1.0) Same(BiasCurrent) "mean current that does not turn round with the motion (sine)"
        "Mean of that part",
    BreakAway "p3" "rad" Shown (1.0, 1.0) Same(P3) "P3, command at break-away (ramp)"
        "P3 before it is divided by the nominal one",
    Kinetic "kinetic_current" "A" Unit (1.0, 1.0) Same(KineticCurrent) "current that turns round with the motion (sine)"
        "Mean of the torque-giving current's part that turns round with the motion, over the places of the sine: what dynamic friction takes. Unlike P2 it is straight at the healthy point (not in the paper)",
    SlowBreakAway "slow_break_away" "A" Finer (1.0, 1.0) Same(SlowBreakAway) "current at break-away (slow cosine)"
        "Greatest torque-giving current as the motor leaves the turning points of the slow cosine: what static friction takes (not in the paper)",
    SlowKinetic "slow_kinetic" "A" Finer (1.0, 1.0) Same(SlowKinetic) "current after break-away (slow cosine)"
        "Torque-giving current after that: what dynamic friction takes at hardly any speed (not in the paper)",
    SlowLag "slow_lag" "s" Finer (1.0, 1.0) Same(SlowLag) "lag of break-away (slow cosine)"
        "Time from the turning points of the slow cosine's command until the motor leaves its own: what the controller takes to come to that current (not in the paper)",
    LegCurrent "leg_current" "A" Finer (1.0, 1.0) Same(LegCurrent) "current at low speed (lines)"
        "Torque-giving current at a low steady speed: what dynamic and viscous friction take together (not in the paper)",
    Supply "supply" "V" Cause (-1.0, -1.0) Same(Supply) "supply voltage (step)"
        "Mean supply voltage in P1's window (not in the paper)",
    ThirdCosine "third_cosine" "rad/s" Watches (1.0, 1.0) Same(ThirdCosine) "third order of the speed, cosine (step)"
        "Amplitude of the motor speed's third order a turn with the cosine of the rotor angle: what static eccentricity makes, on the side on which it is (not in the paper)",
    ThirdSine "third_sine" "rad/s" Watches (1.0, 1.0) Same(ThirdSine) "third order of the speed, sine (step)"
        "The same with the sine (not in the paper)",
    OtherOrders "other_orders" "rad/s" Watches (1.0, 1.0) Same(OtherOrders) "other orders of the speed (step)"
        "Root mean square of the motor speed's other orders a turn: what neither eccentricity nor commutation makes (not in the paper)",
    CurrentTrend "current_trend" "A" Watches (1.0, 1.0) Same(CurrentTrend) "trend of the current (step)"
        "Rise of the torque-giving current from the first to the second half of P1's window: what resists more with the way (not in the paper)",
    RunUpCurrent "run_up_current" "A" Watches (1.0, 1.0) Same(RunUpCurrent) "current of the run-up (step)"
        "Mean torque-giving current until half the no-load speed is reached: what the inertia takes by the current sensors (not in the paper)",
    KineticTilt "kinetic_tilt" "A" Watches (1.0, 1.0) Same(KineticTilt) "kinetic current by place (sine)"
        "Slope over the place of the current that turns round with the motion: friction that differs by place (not in the paper)",
    KineticBend "kinetic_bend" "A" Watches (1.0, 1.0) Same(KineticBend) "kinetic current at the ends (sine)"
        "Bend over the place of the current that turns round with the motion: friction that differs by speed (not in the paper)",
}

impl Feature {
    /// Number of features, those that are only shown included.
    pub const COUNT: usize = Self::TABLE.len();
    /// Those that failure maps locate faults by.
    pub const ALL: [Feature; number(Role::Locates)] = of_role(Role::Locates);
    /// Those that the faults hardly change and other defects do.
    pub const WITNESSES: [Feature; number(Role::Witness)] = of_role(Role::Witness);

    /// Those that locate faults only of a unit that is known.
    pub const OF_UNITS: [Feature; number(Role::Unit)] = of_role(Role::Unit);
    /// Those that locate faults where the sequence has what they are taken from.
    pub const FINER: [Feature; number(Role::Finer)] = of_role(Role::Finer);
    /// Those that say by how much a cause deviates in the test.
    pub const CAUSES: [Feature; number(Role::Cause)] = of_role(Role::Cause);
    /// Witnesses that messages do not tell.
    pub const WATCHES: [Feature; number(Role::Watches)] = of_role(Role::Watches);
    /// Those of messages and logs, in the order of the table: all but those of units, of certain sequences and later witnesses.
    pub const TOLD: [Feature;
        Self::COUNT - number(Role::Unit) - number(Role::Finer) - number(Role::Cause) - number(Role::Watches)] = told();

    /// Whether faults hardly change it and other defects do.
    pub fn is_witness(self) -> bool {
        matches!(self.role(), Role::Witness | Role::Watches)
    }

    /// Those that have maps.
    pub fn every() -> impl Iterator<Item = Feature> {
        let of_units = Self::WITNESSES.into_iter().chain(Self::OF_UNITS);
        let others = of_units.chain(Self::FINER).chain(Self::CAUSES).chain(Self::WATCHES);
        Self::ALL.into_iter().chain(others)
    }

    /// Those that diagnoses stand on, whatever the sequence; units' left out.
    pub fn located_by() -> impl Iterator<Item = Feature> {
        Self::ALL.into_iter().chain(Self::FINER).chain(Self::CAUSES)
    }

    /// Those that take the nominal run: raw features give all others.
    pub fn over_nominal() -> impl Iterator<Item = Feature> {
        let is_raw = |f: &Feature| matches!(f.form(), Form::Same(_));
        Self::TABLE.into_iter().filter(move |f| !is_raw(f))
    }

    /// One that has a map, by name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::every().find(|f| f.name() == name)
    }

    /// What a feature is the length of, if it is one: P1 of speed loss and ripple. It says nothing that its parts
    /// do not, and changes by no more than they do together.
    pub fn parts(self) -> Option<[Feature; 2]> {
        let Form::Length(mean, deviation) = self.form() else {
            return None;
        };
        let formed = |form| {
            Self::every()
                .find(|f| f.form() == form)
                .expect("parts are in the table")
        };
        Some([Form::Loss(mean), Form::Same(deviation)].map(formed))
    }

    /// Value in a run.
    ///
    /// * `raw` measured run
    /// * `nominal` nominal run at the same rate through the same sensors
    pub fn value(self, raw: &RawFeatures, nominal: &RawFeatures) -> Option<f64> {
        match self.form() {
            Form::Same(r) => raw[r],
            Form::Ratio(r) => Some(raw[r]? / nominal[r]?),
            Form::Loss(r) => Some(nominal[r]? - raw[r]?),
            Form::Length(mean, deviation) => {
                let (m, r, m0) = (raw[mean]?, raw[deviation]?, nominal[mean]?);
                // mean square about the nominal mean = variance + squared difference of the means
                Some((r * r + (m - m0) * (m - m0)).sqrt())
            }
        }
    }

    /// Standard deviation in a run, from those of its raw features; nothing nominal deviates.
    ///
    /// * `raw`, `nominal` as in [`Feature::value`]
    /// * `sd` standard deviations of `raw`; 0 where there is none
    pub fn deviation(self, raw: &RawFeatures, sd: &RawFeatures, nominal: &RawFeatures) -> f64 {
        let known = |x: Option<f64>| x.unwrap_or(0.0);
        match self.form() {
            Form::Same(r) | Form::Loss(r) => known(sd[r]),
            Form::Ratio(r) => known(sd[r]) / nominal[r].unwrap_or(1.0),
            Form::Length(mean, deviation) => {
                let d = known(raw[mean]) - known(nominal[mean]);
                let about = known(raw[deviation]) * known(sd[deviation]);
                let length = self.value(raw, nominal).unwrap_or(f64::NAN);
                about.hypot(d * known(sd[mean])) / length.abs().max(1e-12)
            }
        }
    }
}

/// How many features have a role.
const fn number(role: Role) -> usize {
    let (mut n, mut k) = (0, 0);
    while k < Feature::COUNT {
        n += (Feature::TABLE[k].role() as usize == role as usize) as usize;
        k += 1;
    }
    n
}

/// The features of all roles but units' and those of certain sequences, in the order of the table.
const fn told<const N: usize>() -> [Feature; N] {
    let (mut found, mut n, mut k) = ([Feature::TABLE[0]; N], 0, 0);
    while k < Feature::COUNT {
        if !matches!(
            Feature::TABLE[k].role(),
            Role::Unit | Role::Finer | Role::Cause | Role::Watches
        ) {
            found[n] = Feature::TABLE[k];
            n += 1;
        }
        k += 1;
    }
    found
}

/// The features of a role, in the order of the table.
const fn of_role<const N: usize>(role: Role) -> [Feature; N] {
    let (mut found, mut n, mut k) = ([Feature::TABLE[0]; N], 0, 0);
    while k < Feature::COUNT {
        if Feature::TABLE[k].role() as usize == role as usize {
            found[n] = Feature::TABLE[k];
            n += 1;
        }
        k += 1;
    }
    found
}

/// The raw features of one run; none where one was not measured.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct RawFeatures {
    values: [Option<f64>; Self::COUNT],
    /// motor angle at the first sample, modulo one turn [rad]
    pub rest_angle_rad: Option<f64>,
}

impl RawFeatures {
    /// Values in the order of [`RawFeatures::COLUMNS`].
    pub fn values(&self) -> [Option<f64>; Self::COUNT] {
        self.values
    }

    /// From values in the order of [`RawFeatures::COLUMNS`].
    pub fn from_values(values: [Option<f64>; Self::COUNT], rest_angle_rad: Option<f64>) -> Self {
        Self { values, rest_angle_rad }
    }

    /// Every bit: the values, then the rest angle.
    pub fn bits(&self) -> [Option<u64>; Self::COUNT + 1] {
        let bits = |k: usize| self.values.get(k).copied().unwrap_or(self.rest_angle_rad);
        std::array::from_fn(|k| bits(k).map(f64::to_bits))
    }
}

impl Index<Raw> for RawFeatures {
    type Output = Option<f64>;
    fn index(&self, raw: Raw) -> &Option<f64> {
        &self.values[raw as usize]
    }
}

impl IndexMut<Raw> for RawFeatures {
    fn index_mut(&mut self, raw: Raw) -> &mut Option<f64> {
        &mut self.values[raw as usize]
    }
}

/// The features of one run, over the nominal run of the same maps; none where one is not known.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Features([Option<f64>; Feature::COUNT]);

impl Features {
    /// * `raw` measured run
    /// * `nominal` nominal run at the same rate through the same sensors
    pub fn over(raw: &RawFeatures, nominal: &RawFeatures) -> Self {
        Self(Feature::TABLE.map(|f| f.value(raw, nominal)))
    }

    /// A value in the unit of the feature; none where it is not known.
    pub fn get(&self, feature: Feature) -> Option<f64> {
        self.0[feature as usize]
    }

    /// The same with another value of `feature`.
    pub fn with(mut self, feature: Feature, value: Option<f64>) -> Self {
        self.0[feature as usize] = value;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_names_and_numbers_of_files_and_messages_stay() {
        let keys = "p1_rad_per_s p2_a p3 ripple_rad_per_s speed_loss_rad_per_s rise_s current_rms_a sine_travel_rad \
                    current_sum_a current_imbalance even_current_a bias_current_a p3_rad kinetic_current_a \
                    slow_break_away_a slow_kinetic_a slow_lag_s leg_current_a supply_v third_cosine_rad_per_s \
                    third_sine_rad_per_s other_orders_rad_per_s current_trend_a run_up_current_a kinetic_tilt_a kinetic_bend_a";
        assert_eq!(Feature::TABLE.map(Feature::key).join(" "), keys);
        let columns = "mean_speed_sd_rad_per_s ripple_sd_rad_per_s p2_sd_a p3_sd_rad rise_sd_s current_rms_sd_a \
                       sine_travel_sd_rad current_sum_sd_a current_imbalance_sd even_current_sd_a bias_current_sd_a \
                       kinetic_current_sd_a slow_break_away_sd_a slow_kinetic_sd_a slow_lag_sd_s leg_current_sd_a supply_sd_v \
                       third_cosine_sd_rad_per_s third_sine_sd_rad_per_s other_orders_sd_rad_per_s current_trend_sd_a \
                       run_up_current_sd_a kinetic_tilt_sd_a kinetic_bend_sd_a";
        assert_eq!(RawFeatures::DEVIATIONS.join(" "), columns);
        assert_eq!(RawFeatures::COLUMNS.join(" "), columns.replace("_sd", ""));
        assert_eq!((Feature::ALL.len(), Feature::WITNESSES.len()), (7, 5));
        let all = Feature::every().map(|f| f as usize);
        assert!(all.eq((0..12).chain(13..26)));
        assert_eq!(Feature::TOLD.map(|f| f as usize).to_vec(), (0..13).collect::<Vec<_>>());
        assert_eq!(Feature::P1.parts(), Some([Feature::SpeedLoss, Feature::Ripple]));
        assert!(Feature::TABLE[1..].iter().all(|f| f.parts().is_none()));
        let over: Vec<Feature> = Feature::over_nominal().collect();
        assert_eq!(over, [Feature::P1, Feature::P3, Feature::SpeedLoss]);
        assert_eq!(
            Raw::locating().map(|r| r as usize).collect::<Vec<_>>(),
            [0, 1, 2, 3, 4, 5]
        );
    }

    #[test]
    fn prop_the_nominal_run_is_found_again_and_deviations_add_in_squares() {
        let nominal = RawFeatures::from_values([2.0; RawFeatures::COUNT].map(Some), None);
        let mut raw = nominal;
        (raw[Raw::MeanSpeed], raw[Raw::Ripple], raw[Raw::P3]) = (Some(1.7), Some(0.4), Some(5.0));
        let sd = RawFeatures::from_values([0.01; RawFeatures::COUNT].map(Some), None);
        let of = |f: Feature| f.value(&raw, &nominal).unwrap();
        assert!((of(Feature::P1) - 0.5).abs() < 1e-12 && of(Feature::P3) == 2.5 && of(Feature::BreakAway) == 5.0);
        for f in [Feature::P3, Feature::SpeedLoss] {
            let r = f.form().raws().next().unwrap();
            assert_eq!(f.form().nominal(raw[r].unwrap(), of(f)), Some(2.0));
        }
        let sd_of = |f: Feature| f.deviation(&raw, &sd, &nominal);
        assert!((sd_of(Feature::P1) - 0.01).abs() < 1e-12);
        assert_eq!([Feature::P3, Feature::SpeedLoss].map(sd_of), [0.005, 0.01]);
        assert_eq!(Feature::P1.value(&raw, &RawFeatures::default()), None);
    }
}
