//! How parameters differ from actuator to actuator.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use schemas::error::Result;
use schemas::fingerprint::fingerprint;
use schemas::toml_section::Section;

/// Normal deviates beyond this are drawn anew: a part far off its tolerance is not built in (assumed).
const TRUNCATE_SD: f64 = 3.0;

/// Distribution of a parameter around its nominal value x0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distribution {
    /// x0 (1 + h u), u uniform in -1..1
    Uniform {
        /// h, above 0 and at most 0.9
        half_width_relative: f64,
    },
    /// x0 (1 + s z), z standard normal within plus and minus 3
    Normal {
        /// s before the tails are cut, above 0 and at most 0.3
        sd_relative: f64,
    },
    /// x0 exp(s z), z likewise: for what scatters by factors, as friction and backlash
    Lognormal {
        /// s before the tails are cut, above 0 and at most 2
        sd_log: f64,
    },
    /// any of a to b alike, whatever x0: for temperatures
    Range {
        /// a, in the parameter's unit
        from: f64,
        /// b, above a
        to: f64,
    },
}

const KINDS: &str = "uniform, normal, lognormal or range";

impl Distribution {
    /// From a table `{ distribution = "uniform", half_width_relative = 0.05, source = "assumed" }`; also its
    /// source.
    ///
    /// # Errors
    /// Another distribution, a key or value that it may not have.
    pub fn from_section(mut s: Section) -> Result<(Self, String)> {
        const SHARE: &str = "a number above 0 and at most 0.9";
        const ANY: &str = "a finite number";
        let share = |x: f64| x > 0.0 && x <= 0.9;
        let kind = s.text("distribution", KINDS)?;
        let d = match kind.as_str() {
            "uniform" => Self::Uniform {
                half_width_relative: s.number("half_width_relative", share, SHARE)?,
            },
            "normal" => Self::Normal {
                sd_relative: s.number(
                    "sd_relative",
                    |x| x > 0.0 && x <= 0.3,
                    "a number above 0 and at most 0.3",
                )?,
            },
            "lognormal" => Self::Lognormal {
                sd_log: s.number("sd_log", |x| x > 0.0 && x <= 2.0, "a number above 0 and at most 2")?,
            },
            "range" => {
                let from = s.number("from", |_| true, ANY)?;
                Self::Range {
                    from,
                    to: s.number("to", |x| x > from, &format!("a finite number above {from}"))?,
                }
            }
            other => return Err(s.bad("distribution", other, KINDS)),
        };
        let source = s.text_or("source", "")?;
        s.finish()?;
        Ok((d, source))
    }

    /// A value for a nominal one.
    pub fn draw(self, nominal: f64, rng: &mut ChaCha8Rng) -> f64 {
        let mut z = || loop {
            let z: f64 = rng.sample(StandardNormal);
            if z.abs() <= TRUNCATE_SD {
                return z;
            }
        };
        match self {
            Self::Normal { sd_relative } => nominal * (1.0 + sd_relative * z()),
            Self::Lognormal { sd_log } => nominal * (sd_log * z()).exp(),
            Self::Uniform { half_width_relative } => {
                nominal * (1.0 + half_width_relative * rng.random_range(-1.0..1.0))
            }
            Self::Range { from, to } => rng.random_range(from..to),
        }
    }
}

/// A seed for one purpose and thing: what else is drawn, and in what order, does not matter.
pub fn seed(plan_seed: u64, purpose: &str, of: &str) -> u64 {
    let text = fingerprint(&format!("{purpose};{plan_seed};{of}"));
    u64::from_str_radix(&text, 16).expect("a fingerprint is 16 hexadecimal digits")
}

/// Random numbers for one purpose and thing.
pub fn random(plan_seed: u64, purpose: &str, of: &str) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed(plan_seed, purpose, of))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(d: Distribution) -> Vec<f64> {
        (0..4000)
            .map(|i| d.draw(2.0, &mut random(7, "R", &i.to_string())))
            .collect()
    }

    #[test]
    fn prop_draws_have_the_stated_width() {
        let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
        let sd = |v: &[f64]| {
            let m = mean(v);
            (v.iter().map(|x| (x - m) * (x - m)).sum::<f64>() / v.len() as f64).sqrt()
        };
        let v = drawn(Distribution::Uniform {
            half_width_relative: 0.05,
        });
        assert!(v.iter().all(|x| (1.9..2.1).contains(x)));
        assert!((sd(&v) - 0.1 / 3f64.sqrt()).abs() < 0.002, "{}", sd(&v));
        let v = drawn(Distribution::Normal { sd_relative: 0.02 });
        assert!(
            (mean(&v) - 2.0).abs() < 0.003 && (sd(&v) - 0.04).abs() < 0.002,
            "{}",
            sd(&v)
        );
        assert!(v.iter().all(|x| (x - 2.0).abs() <= 0.12 + 1e-12));
        let logs: Vec<f64> = drawn(Distribution::Lognormal { sd_log: 0.3 })
            .iter()
            .map(|x| (x / 2.0).ln())
            .collect();
        assert!(mean(&logs).abs() < 0.02 && (sd(&logs) - 0.3).abs() < 0.01);
        let v = drawn(Distribution::Range { from: -10.0, to: 40.0 });
        assert!(v.iter().all(|x| (-10.0..40.0).contains(x)) && (mean(&v) - 15.0).abs() < 1.0);
    }
}
