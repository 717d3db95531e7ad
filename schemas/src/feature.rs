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
}

impl Feature {
    pub const ALL: [Feature; 4] = [Feature::P1, Feature::P2, Feature::P3, Feature::Ripple];

    /// Short name in files and reports.
    pub fn name(self) -> &'static str {
        match self {
            Feature::P1 => "p1",
            Feature::P2 => "p2",
            Feature::P3 => "p3",
            Feature::Ripple => "ripple",
        }
    }
    pub fn unit(self) -> &'static str {
        match self {
            Feature::P1 | Feature::Ripple => "rad/s",
            Feature::P2 => "A",
            Feature::P3 => "-",
        }
    }
    pub fn title(self) -> &'static str {
        match self {
            Feature::P1 => "P1, speed RMS error (step)",
            Feature::P2 => "P2, current RMS error (sine)",
            Feature::P3 => "P3, starting error over nominal (ramp)",
            Feature::Ripple => "speed ripple (step)",
        }
    }
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|f| f.name() == name)
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
    /// motor angle at the first sample, modulo one turn [rad]
    pub rest_angle_rad: Option<f64>,
}

/// Features as failure maps hold them, over the nominal run of the same maps.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Features {
    pub p1_rad_per_s: Option<f64>,
    pub p2_a: Option<f64>,
    pub p3: Option<f64>,
    pub p3_rad: Option<f64>,
    pub ripple_rad_per_s: Option<f64>,
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
        Self {
            p1_rad_per_s: p1,
            p2_a: raw.p2_a,
            p3,
            p3_rad: raw.p3_rad,
            ripple_rad_per_s: raw.ripple_rad_per_s,
        }
    }

    pub fn get(&self, feature: Feature) -> Option<f64> {
        match feature {
            Feature::P1 => self.p1_rad_per_s,
            Feature::P2 => self.p2_a,
            Feature::P3 => self.p3,
            Feature::Ripple => self.ripple_rad_per_s,
        }
    }
}
