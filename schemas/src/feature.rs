//! Features: the scalars that failure maps hold.

/// A feature of one pre-flight test (paper 4.2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(usize)]
pub enum Feature {
    /// Speed RMS error in the step, against the nominal steady-state mean (Eq. 11) [rad/s].
    P1,
    /// Current RMS error in the sine, against the simplified model (Eq. 22) [A].
    P2,
    /// Starting error in the ramp, over that of the nominal run (Eq. 13) [-].
    P3,
    /// Speed ripple about its own mean in P1's window [rad/s].
    Ripple,
    /// Mean speed in P1's window below that of the nominal run [rad/s]. With the ripple it makes up P1:
    /// P1^2 = loss^2 + ripple^2, but it has a sign and no cusp at the healthy point (assumed useful, not
    /// in the paper).
    SpeedLoss,
    /// Time from the step to half the no-load speed, Vs/(4 ke) [s] (not in the paper).
    Rise,
    /// Root mean square of the phase currents in P1's window [A] (not in the paper).
    CurrentRms,
    /// Witness: motor travel from one turning point of the sine to the other [rad].
    SineTravel,
    /// Witness: mean of the sum of the phase currents in the sine [A].
    CurrentSum,
    /// Witness: greatest less smallest RMS phase current over their mean, in P1's window [-].
    CurrentImbalance,
    /// Witness: root mean square over the places of the sine of the torque-giving current's part that does not
    /// turn round with the motion, its straight line over the place taken off [A].
    EvenCurrent,
    /// Witness: mean of that part [A].
    BiasCurrent,
}

impl Feature {
    /// Those that failure maps locate faults by.
    pub const ALL: [Feature; 7] = [
        Feature::P1,
        Feature::P2,
        Feature::P3,
        Feature::Ripple,
        Feature::SpeedLoss,
        Feature::Rise,
        Feature::CurrentRms,
    ];

    /// Those that the faults hardly change and other defects do.
    pub const WITNESSES: [Feature; 5] = [
        Feature::SineTravel,
        Feature::CurrentSum,
        Feature::CurrentImbalance,
        Feature::EvenCurrent,
        Feature::BiasCurrent,
    ];

    /// Both.
    pub fn every() -> impl Iterator<Item = Feature> {
        Self::ALL.into_iter().chain(Self::WITNESSES)
    }

    /// Short name in files and reports.
    pub fn name(self) -> &'static str {
        match self {
            Feature::P1 => "p1",
            Feature::P2 => "p2",
            Feature::P3 => "p3",
            Feature::Ripple => "ripple",
            Feature::SpeedLoss => "speed_loss",
            Feature::Rise => "rise",
            Feature::CurrentRms => "current_rms",
            Feature::SineTravel => "sine_travel",
            Feature::CurrentSum => "current_sum",
            Feature::CurrentImbalance => "current_imbalance",
            Feature::EvenCurrent => "even_current",
            Feature::BiasCurrent => "bias_current",
        }
    }
    /// Column and JSON key: the name with the unit.
    pub fn key(self) -> &'static str {
        match self {
            Feature::P1 => "p1_rad_per_s",
            Feature::P2 => "p2_a",
            Feature::P3 => "p3",
            Feature::Ripple => "ripple_rad_per_s",
            Feature::SpeedLoss => "speed_loss_rad_per_s",
            Feature::Rise => "rise_s",
            Feature::CurrentRms => "current_rms_a",
            Feature::SineTravel => "sine_travel_rad",
            Feature::CurrentSum => "current_sum_a",
            Feature::CurrentImbalance => "current_imbalance",
            Feature::EvenCurrent => "even_current_a",
            Feature::BiasCurrent => "bias_current_a",
        }
    }
    pub fn unit(self) -> &'static str {
        match self {
            Feature::P1 | Feature::Ripple | Feature::SpeedLoss => "rad/s",
            Feature::P2 | Feature::CurrentRms | Feature::CurrentSum | Feature::EvenCurrent | Feature::BiasCurrent => {
                "A"
            }
            Feature::P3 | Feature::CurrentImbalance => "-",
            Feature::SineTravel => "rad",
            Feature::Rise => "s",
        }
    }
    pub fn title(self) -> &'static str {
        match self {
            Feature::P1 => "P1, speed RMS error (step)",
            Feature::P2 => "P2, current RMS error (sine)",
            Feature::P3 => "P3, starting error over nominal (ramp)",
            Feature::Ripple => "speed ripple (step)",
            Feature::SpeedLoss => "loss of mean speed (step)",
            Feature::Rise => "rise time to half the no-load speed (step)",
            Feature::CurrentRms => "RMS phase current (step)",
            Feature::SineTravel => "motor travel (sine)",
            Feature::CurrentSum => "sum of the phase currents (sine)",
            Feature::CurrentImbalance => "imbalance of the phase currents (step)",
            Feature::EvenCurrent => "current that does not turn round with the motion (sine)",
            Feature::BiasCurrent => "mean current that does not turn round with the motion (sine)",
        }
    }
    pub fn from_name(name: &str) -> Option<Self> {
        Self::every().find(|f| f.name() == name)
    }
    /// Direction along (FSJ, zeta): +1 where the feature rises, -1 where it falls.
    pub fn direction(self) -> (f64, f64) {
        match self {
            Feature::Ripple => (-1.0, 1.0),
            _ => (1.0, 1.0),
        }
    }
}

/// What the extractor measures in one run, before anything nominal is subtracted.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct RawFeatures {
    /// mean user speed w/N in the regime window of the step [rad/s]
    pub mean_speed_rad_per_s: Option<f64>,
    /// standard deviation of w/N in that window [rad/s]
    pub ripple_rad_per_s: Option<f64>,
    /// root mean square of measured minus simplified-model current over the sine [A]
    pub p2_a: Option<f64>,
    /// command at break-away in the ramp [rad]
    pub p3_rad: Option<f64>,
    /// time from the step to half the no-load speed [s]
    pub rise_s: Option<f64>,
    /// root mean square of the phase currents in the regime window [A]
    pub current_rms_a: Option<f64>,
    /// witnesses, see [`Feature`]
    pub sine_travel_rad: Option<f64>,
    pub current_sum_a: Option<f64>,
    pub current_imbalance: Option<f64>,
    pub even_current_a: Option<f64>,
    pub bias_current_a: Option<f64>,
    /// motor angle at the first sample, modulo one turn [rad]
    pub rest_angle_rad: Option<f64>,
}

impl RawFeatures {
    pub const COUNT: usize = 11;

    /// Columns of what is measured, without the rest angle.
    pub const COLUMNS: [&str; Self::COUNT] = [
        "mean_speed_rad_per_s",
        "ripple_rad_per_s",
        "p2_a",
        "p3_rad",
        "rise_s",
        "current_rms_a",
        "sine_travel_rad",
        "current_sum_a",
        "current_imbalance",
        "even_current_a",
        "bias_current_a",
    ];

    /// Columns of their standard deviations.
    pub const DEVIATIONS: [&str; Self::COUNT] = [
        "mean_speed_sd_rad_per_s",
        "ripple_sd_rad_per_s",
        "p2_sd_a",
        "p3_sd_rad",
        "rise_sd_s",
        "current_rms_sd_a",
        "sine_travel_sd_rad",
        "current_sum_sd_a",
        "current_imbalance_sd",
        "even_current_sd_a",
        "bias_current_sd_a",
    ];

    /// Values in the order of [`RawFeatures::COLUMNS`].
    pub fn values(&self) -> [Option<f64>; Self::COUNT] {
        [
            self.mean_speed_rad_per_s,
            self.ripple_rad_per_s,
            self.p2_a,
            self.p3_rad,
            self.rise_s,
            self.current_rms_a,
            self.sine_travel_rad,
            self.current_sum_a,
            self.current_imbalance,
            self.even_current_a,
            self.bias_current_a,
        ]
    }

    /// From values in the order of [`RawFeatures::COLUMNS`].
    pub fn from_values(values: [Option<f64>; Self::COUNT], rest_angle_rad: Option<f64>) -> Self {
        let [mean, ripple, p2, p3, rise, rms, travel, sum, imbalance, even, bias] = values;
        Self {
            mean_speed_rad_per_s: mean,
            ripple_rad_per_s: ripple,
            p2_a: p2,
            p3_rad: p3,
            rise_s: rise,
            current_rms_a: rms,
            sine_travel_rad: travel,
            current_sum_a: sum,
            current_imbalance: imbalance,
            even_current_a: even,
            bias_current_a: bias,
            rest_angle_rad,
        }
    }
}

/// Features as failure maps hold them, over the nominal run of the same maps.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Features {
    pub p1_rad_per_s: Option<f64>,
    pub p2_a: Option<f64>,
    pub p3: Option<f64>,
    pub p3_rad: Option<f64>,
    pub ripple_rad_per_s: Option<f64>,
    pub speed_loss_rad_per_s: Option<f64>,
    pub rise_s: Option<f64>,
    pub current_rms_a: Option<f64>,
    pub sine_travel_rad: Option<f64>,
    pub current_sum_a: Option<f64>,
    pub current_imbalance: Option<f64>,
    pub even_current_a: Option<f64>,
    pub bias_current_a: Option<f64>,
}

impl Features {
    /// * `raw` measured run
    /// * `nominal` nominal run at the same rate through the same sensors
    pub fn over(raw: &RawFeatures, nominal: &RawFeatures) -> Self {
        let p1 = match (
            raw.mean_speed_rad_per_s,
            raw.ripple_rad_per_s,
            nominal.mean_speed_rad_per_s,
        ) {
            // mean square about the nominal mean = variance + squared difference of the means
            (Some(m), Some(r), Some(m0)) => Some((r * r + (m - m0) * (m - m0)).sqrt()),
            _ => None,
        };
        let p3 = match (raw.p3_rad, nominal.p3_rad) {
            (Some(p), Some(p0)) => Some(p / p0),
            _ => None,
        };
        let speed_loss = match (raw.mean_speed_rad_per_s, nominal.mean_speed_rad_per_s) {
            (Some(m), Some(m0)) => Some(m0 - m),
            _ => None,
        };
        Self {
            p1_rad_per_s: p1,
            p2_a: raw.p2_a,
            p3,
            p3_rad: raw.p3_rad,
            ripple_rad_per_s: raw.ripple_rad_per_s,
            speed_loss_rad_per_s: speed_loss,
            rise_s: raw.rise_s,
            current_rms_a: raw.current_rms_a,
            sine_travel_rad: raw.sine_travel_rad,
            current_sum_a: raw.current_sum_a,
            current_imbalance: raw.current_imbalance,
            even_current_a: raw.even_current_a,
            bias_current_a: raw.bias_current_a,
        }
    }

    pub fn get(&self, feature: Feature) -> Option<f64> {
        match feature {
            Feature::P1 => self.p1_rad_per_s,
            Feature::P2 => self.p2_a,
            Feature::P3 => self.p3,
            Feature::Ripple => self.ripple_rad_per_s,
            Feature::SpeedLoss => self.speed_loss_rad_per_s,
            Feature::Rise => self.rise_s,
            Feature::CurrentRms => self.current_rms_a,
            Feature::SineTravel => self.sine_travel_rad,
            Feature::CurrentSum => self.current_sum_a,
            Feature::CurrentImbalance => self.current_imbalance,
            Feature::EvenCurrent => self.even_current_a,
            Feature::BiasCurrent => self.bias_current_a,
        }
    }
}
