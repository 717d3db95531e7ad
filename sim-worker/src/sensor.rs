//! Sensor model: what a resolver and current sensors make of the true values. Samples are
//! quantised here, once; files and frames carry the same values.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use schemas::channel::Channel;
use schemas::error::Result;
use schemas::fingerprint::{exact, fingerprint};
use schemas::telemetry::{TelemetryBuffer, TelemetryView, TelemetryViewMut};
use schemas::toml_section::{Section, quoted};
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Properties of samples that a file says in a word; the first is the usual one, and need not be said.
macro_rules! words {
    ($($(#[$doc:meta])* $name:ident { $(#[$first_doc:meta])* $first:ident $usual:literal, $($(#[$value_doc:meta])* $value:ident $word:literal),+ })+) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        pub enum $name { $(#[$first_doc])* #[default] $first, $($(#[$value_doc])* $value),+ }

        impl $name {
            /// Word of a file.
            fn word(self) -> &'static str {
                match self { Self::$first => $usual, $(Self::$value => $word),+ }
            }

            /// Of a key that may be left out.
            fn read(s: &mut Section, key: &str) -> Result<Self> {
                if !s.may_have(key) {
                    return Ok(Self::default());
                }
                let of = |word: &str| [Self::$first, $(Self::$value),+].into_iter().find(|v| v.word() == word);
                s.one_of(key, [$usual, $($word),+].join(", ").as_str(), of)
            }
        }
    )+};
}

words! {
    /// What a sample of a phase current is.
    CurrentSampling {
        /// its mean over the sample's interval
        Mean "mean",
        /// its value at the end of the interval, chatter of the relays included
        Point "point"
    }
    /// Where the motor speed comes from.
    SpeedSource {
        /// a sensor of its own
        Sensor "sensor",
        /// no sensor that says more than the angle does, later: features take the angle's own mean over a moment in its place
        Angle "angle"
    }
    /// Where the rotor rests of which a recording says the count of its resolver.
    Rest {
        /// at the angle that is recorded
        AtAngle "at_angle",
        /// anywhere within the count
        WithinCount "within_count"
    }
}

/// What the samples of a recording are, whatever their noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Sampling {
    /// of the phase currents and of what is made of them
    pub currents: CurrentSampling,
    /// of the motor speed
    pub speed: SpeedSource,
    /// of the rotor before a test
    pub rest: Rest,
}

impl Sampling {
    const KEYS: [&str; 3] = ["current_sampling", "speed_source", "rest"];

    fn read(s: &mut Section) -> Result<Self> {
        let [currents, speed, rest] = Self::KEYS;
        Ok(Self {
            currents: CurrentSampling::read(s, currents)?,
            speed: SpeedSource::read(s, speed)?,
            rest: Rest::read(s, rest)?,
        })
    }

    /// Keys and words of what is not as telemetry usually is.
    fn unusual(self) -> impl Iterator<Item = (&'static str, &'static str)> {
        let words = |s: Self| [s.currents.word(), s.speed.word(), s.rest.word()];
        let of_both = words(self).into_iter().zip(words(Self::default()));
        let all = Self::KEYS.into_iter().zip(of_both);
        all.filter(|(_, (own, usual))| own != usual)
            .map(|(key, (own, _))| (key, own))
    }
}

/// The mean speed over the last moment, of the angle alone.
#[derive(Clone, Debug)]
pub struct SpeedOfAngle {
    rate_hz: f64,
    /// samples that the moment has
    most: usize,
    /// number of the last sample, and the last angles [rad]
    last: u64,
    angles: VecDeque<f64>,
}

/// The moment [s] (assumed): a count of the angle is then small beside its change, and a turn long beside it.
const MOMENT_S: f64 = 1e-3;

impl SpeedOfAngle {
    /// * `rate_hz` of the samples
    pub fn new(rate_hz: f64) -> Self {
        let most = Self::samples(rate_hz);
        Self {
            rate_hz,
            most,
            last: 0,
            angles: VecDeque::with_capacity(most + 1),
        }
    }

    /// Before sample 1 of a rotor that rests at an angle [rad].
    pub fn at_rest(rate_hz: f64, angle_rad: f64) -> Self {
        let mut speed = Self::new(rate_hz);
        speed.angles.extend(std::iter::repeat_n(angle_rad, speed.most));
        speed
    }

    /// Samples before one that its speed is made of.
    pub fn samples(rate_hz: f64) -> usize {
        ((MOMENT_S * rate_hz).round() as usize).max(1)
    }

    /// Speed at sample `n` of angle `x` [rad], in rad/s; 0 at the first one of all and after a gap.
    pub fn next(&mut self, n: u64, x: f64) -> f64 {
        if n != self.last + 1 {
            self.angles.clear();
        }
        self.last = n;
        self.angles.push_back(x);
        if self.angles.len() > self.most + 1 {
            self.angles.pop_front();
        }
        let steps = (self.angles.len() - 1).max(1) as f64;
        (x - self.angles[0]) * self.rate_hz / steps
    }
}

/// Resolution and noise of the sensors. All values of the built-in model are assumed.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorModel {
    /// for messages and files; does not enter the fingerprint
    pub name: String,
    /// motor resolver, bits a turn
    pub resolver_bits: u32,
    /// white noise of the motor speed, rms [rad/s]
    pub speed_noise_rad_per_s: f64,
    /// full scale of a phase current, plus and minus [A]
    pub current_range_a: f64,
    /// resolution of a phase current over the range [bits]
    pub current_bits: u32,
    /// white noise of a phase current, rms [A]
    pub current_noise_a: f64,
    /// half-width of the uniform offset of each phase, drawn once a run [A]
    pub current_offset_a: f64,
    /// what samples are: keys `current_sampling`, `speed_source` and `rest`, which may be left out
    pub sampling: Sampling,
}

impl SensorModel {
    /// From a TOML file's table.
    ///
    /// # Errors
    /// A missing or unknown key, a value that is not allowed.
    pub fn from_section(mut s: Section) -> Result<Self> {
        let bits = |x: f64| x.fract() == 0.0 && (1.0..=24.0).contains(&x);
        let low = |x: f64| x >= 0.0;
        const BITS: &str = "a whole number from 1 to 24";
        const LOW: &str = "a finite number of at least 0";
        let m = Self {
            sampling: Sampling::read(&mut s)?,
            name: s.text("name", "a text")?,
            resolver_bits: s.number("resolver_bits", bits, BITS)? as u32,
            speed_noise_rad_per_s: s.number("speed_noise_rad_per_s", low, LOW)?,
            current_range_a: s.number("current_range_a", |x| x > 0.0, "a finite number above 0")?,
            current_bits: s.number("current_bits", bits, BITS)? as u32,
            current_noise_a: s.number("current_noise_a", low, LOW)?,
            current_offset_a: s.number("current_offset_a", low, LOW)?,
        };
        s.finish()?;
        Ok(m)
    }

    /// One resolver count [rad].
    pub fn resolver_count_rad(&self) -> f64 {
        TAU / (1u64 << self.resolver_bits) as f64
    }

    /// One current count [A].
    pub fn current_count_a(&self) -> f64 {
        2.0 * self.current_range_a / (1u64 << self.current_bits) as f64
    }

    /// Keys and values, in the order of the fingerprint.
    fn values(&self) -> [(&'static str, f64); 6] {
        [
            ("resolver_bits", self.resolver_bits.into()),
            ("speed_noise_rad_per_s", self.speed_noise_rad_per_s),
            ("current_range_a", self.current_range_a),
            ("current_bits", self.current_bits.into()),
            ("current_noise_a", self.current_noise_a),
            ("current_offset_a", self.current_offset_a),
        ]
    }

    /// A file that reads back as this model, bit for bit.
    pub fn to_toml(&self) -> String {
        let lines = self.values().map(|(key, x)| format!("{key} = {x:?}\n"));
        let words = self
            .sampling
            .unusual()
            .map(|(key, word)| format!("{key} = \"{word}\"\n"));
        format!(
            "name = {}\n{}{}",
            quoted(&self.name),
            lines.concat(),
            words.collect::<String>()
        )
    }

    /// Of all values, not of the name.
    pub fn fingerprint(&self) -> String {
        let v = self.values().map(|(_, x)| exact(x));
        let words = self.sampling.unusual().map(|(key, word)| format!(";{key} {word}"));
        fingerprint(&format!("sensors;{}{}", v.join(","), words.collect::<String>()))
    }

    /// What the samples of a model are, or of true values.
    pub fn sampling_of(model: Option<&Self>) -> Sampling {
        model.map_or_else(Sampling::default, |m| m.sampling)
    }

    /// Fingerprint of a model, or `none`.
    pub fn fingerprint_of(model: Option<&Self>) -> String {
        model.map_or("none".into(), Self::fingerprint)
    }
}

/// The random numbers of one run: offsets of the phases, then normal deviates row by row.
/// The same seed gives the same deviates, whatever the run.
#[derive(Clone, Debug)]
pub struct SensorNoise {
    /// uniform in -1..1
    offset: [f64; 3],
    /// speed, phase A, B, C of each row, standard normal
    rows: Vec<[f32; 4]>,
    /// where the rotor rests within a count of its resolver, uniform in -0.5..0.5, where no recording says it
    within_count: f64,
}

impl SensorNoise {
    /// * `seed` of the run
    /// * `rows` number of samples of the run
    pub fn new(seed: u64, rows: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let offset = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let rows = (0..rows)
            .map(|_| std::array::from_fn(|_| rng.sample::<f32, _>(StandardNormal)))
            .collect();
        let within_count = rng.random_range(-0.5..0.5);
        Self {
            offset,
            rows,
            within_count,
        }
    }
}

/// A sensor model on one run.
#[derive(Clone, Debug)]
pub struct Sensors<'a> {
    /// resolution and noise
    pub model: &'a SensorModel,
    /// of this run, as many samples as it has
    pub noise: &'a SensorNoise,
    /// N, motor to user
    pub gear_ratio: f64,
    /// rotor angle at rest [rad]
    pub rest_angle_rad: f64,
}

impl Sensors<'_> {
    /// Measures `view` into `out`.
    pub fn measure(&self, view: &TelemetryView<'_>, out: &mut TelemetryBuffer) {
        out.copy_from(view);
        self.apply(&mut out.view_mut(view.first, view.rows));
    }

    /// Turns true values into measured ones, in place: positions in resolver counts (the user
    /// position from the motor's through the gear), speed and phase currents with noise, currents
    /// in counts, the equivalent current from the measured phases. Every value is rounded to f32,
    /// those of channels that the model does not name too.
    pub fn apply(&self, block: &mut TelemetryViewMut<'_>) {
        let round = |x: f64| x as f32 as f64;
        let noise = &self.noise.rows[(block.first - 1) as usize..][..block.rows];
        let lsb = self.model.resolver_count_rad();
        let inv_lsb = 1.0 / lsb;
        let nearest = crate::trig::nearest;
        let within = match self.model.sampling.rest {
            Rest::AtAngle => 0.0,
            Rest::WithinCount => self.noise.within_count,
        };
        let counts = |x: f64| {
            if within == 0.0 {
                x * inv_lsb
            } else {
                x * inv_lsb + within
            }
        };
        let rest = nearest(counts(self.rest_angle_rad));
        let mut user = block.take(Channel::ThetaU);
        if let Some(theta) = block.column_mut(Channel::ThetaM) {
            if let Some(user) = &mut user {
                for (o, &x) in user.iter_mut().zip(&*theta) {
                    *o = round((nearest(counts(x)) - rest) * lsb / self.gear_ratio);
                }
            }
            for x in theta {
                *x = round(nearest(counts(*x)) * lsb);
            }
        }
        block.put(Channel::ThetaU, user);
        if let Some(column) = block.column_mut(Channel::OmegaM) {
            for (o, n) in column.iter_mut().zip(noise) {
                *o = round(*o + self.model.speed_noise_rad_per_s * n[0] as f64);
            }
        }
        let count = self.model.current_count_a();
        let inv_count = 1.0 / count;
        let full = (1u64 << (self.model.current_bits - 1)) as f64;
        for (q, c) in [Channel::IA, Channel::IB, Channel::IC].into_iter().enumerate() {
            let offset = self.noise.offset[q] * self.model.current_offset_a;
            if let Some(column) = block.column_mut(c) {
                for (o, n) in column.iter_mut().zip(noise) {
                    let x = *o + offset + self.model.current_noise_a * n[1 + q] as f64;
                    *o = round(nearest(x * inv_count).clamp(-full, full - 1.0) * count);
                }
            }
        }
        let mut equivalent = block.take(Channel::IEq);
        let phases = [Channel::IA, Channel::IB, Channel::IC].map(|c| block.column(c));
        if let (Some(eq), [Some(a), Some(b), Some(c)]) = (&mut equivalent, phases) {
            for (((o, a), b), c) in eq.iter_mut().zip(a).zip(b).zip(c) {
                *o = round(0.5 * (a.abs() + b.abs() + c.abs()));
            }
        }
        block.put(Channel::IEq, equivalent);
        use Channel::{Com, ISupply, Temperature, TorqueM, VA, VB, VC, VDc};
        for c in [Com, VA, VB, VC, TorqueM, Channel::IQ, ISupply, VDc, Temperature] {
            if let Some(column) = block.column_mut(c) {
                column.iter_mut().for_each(|o| *o = round(*o));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use schemas::toml_section::parse;

    #[test]
    fn prop_a_sensor_model_written_and_read_is_the_same() {
        let mut m = crate::catalogue::sensors("reference").unwrap().unwrap();
        m.name = "a \"b\"".into();
        m.current_noise_a = 0.1 / 3.0;
        m.speed_noise_rad_per_s = 0.0;
        let usual = m.fingerprint();
        m.sampling.currents = CurrentSampling::Point;
        m.sampling.speed = SpeedSource::Angle;
        m.sampling.rest = Rest::WithinCount;
        assert_ne!(m.fingerprint(), usual);
        let again = SensorModel::from_section(parse("a.toml", &m.to_toml()).unwrap()).unwrap();
        assert_eq!(again, m);
        assert_eq!(again.fingerprint(), m.fingerprint());
        let wrong = m.to_toml().replace("\"point\"", "\"points\"");
        let e = SensorModel::from_section(parse("a.toml", &wrong).unwrap())
            .unwrap_err()
            .to_string();
        assert!(e.contains("current_sampling") && e.contains("mean, point"), "{e}");
    }
}
