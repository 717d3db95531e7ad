//! Growth laws of one damage, in one equation.
//!
//! Damage is normalised: `x = u / U`, 0 healthy and 1 at the threshold. All laws are
//!
//! `dx/dt = exp(rho) K (x + eps)^m ,   K = integral_0^1 (x + eps)^-m dx`
//!
//! so that `exp(rho)` is one over the life from new whatever the law. `m` = -1 is a square-root wear-in, 0 linear, 1/2
//! quadratic in time, 1 exponential, above 1 like Paris' law. `m` is a multiple of one half: no power is ever taken.

/// One law: exponent and where growth starts from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// exponent m, twice: a whole number from -2 to 4
    twice_m: i32,
    /// start of growth as a share of the threshold's damage
    eps: f64,
    /// K of the equation
    k: f64,
}

/// What the law is called where laws are told apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Family {
    /// slows down: m below 0
    WearIn,
    /// m = 0
    Linear,
    /// m = 1/2: quadratic in time
    Power,
    /// m = 1
    Exponential,
    /// m above 1
    Paris,
}

impl Family {
    /// All, in the order of their exponents.
    pub const ALL: [Family; 5] = [Self::WearIn, Self::Linear, Self::Power, Self::Exponential, Self::Paris];

    /// As keys of outputs have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::WearIn => "wear_in",
            Self::Linear => "linear",
            Self::Power => "power",
            Self::Exponential => "exponential",
            Self::Paris => "paris",
        }
    }
}

/// The most damage that is followed: the threshold is at 1.
pub const MOST: f64 = 2.0;

impl Law {
    /// * `twice_m` twice the exponent, -2 to 4
    /// * `eps` start of growth [share of U], above 0
    pub fn new(twice_m: i32, eps: f64) -> Self {
        let mut law = Self { twice_m, eps, k: 1.0 };
        law.k = law.primitive(1.0) - law.primitive(0.0);
        law
    }

    /// Which kind of growth it is.
    pub fn family(&self) -> Family {
        match self.twice_m {
            ..0 => Family::WearIn,
            0 => Family::Linear,
            1 => Family::Power,
            2 => Family::Exponential,
            _ => Family::Paris,
        }
    }

    /// Least damage that the law is defined for, with a margin.
    fn least(&self) -> f64 {
        if self.twice_m == 0 {
            f64::NEG_INFINITY
        } else {
            -0.9 * self.eps
        }
    }

    /// `(x + eps)^m`.
    fn power(&self, x: f64) -> f64 {
        let z = x + self.eps;
        match self.twice_m {
            -2 => 1.0 / z,
            -1 => 1.0 / z.sqrt(),
            0 => 1.0,
            1 => z.sqrt(),
            2 => z,
            3 => z * z.sqrt(),
            _ => z * z,
        }
    }

    /// Primitive of `(x + eps)^-m`.
    fn primitive(&self, x: f64) -> f64 {
        let z = x + self.eps;
        match self.twice_m {
            -2 => 0.5 * z * z,
            -1 => z * z.sqrt() / 1.5,
            0 => z,
            1 => 2.0 * z.sqrt(),
            2 => z.ln(),
            3 => -2.0 / z.sqrt(),
            _ => -1.0 / z,
        }
    }

    /// Inverse of [`Self::primitive`]; [`MOST`] where growth has blown up.
    fn inverse(&self, p: f64) -> f64 {
        let z = match self.twice_m {
            -2 => (2.0 * p).sqrt(),
            -1 => (1.5 * p).cbrt().powi(2),
            0 => p,
            1 => (0.5 * p).powi(2),
            2 => p.exp(),
            3 if p < -1e-3 => (2.0 / p).powi(2),
            _ if self.twice_m > 3 && p < -1e-3 => -1.0 / p,
            _ => return MOST,
        };
        (z - self.eps).min(MOST)
    }

    /// Rate of damage at `x` for `exp(rho)` = 1 [per life].
    pub fn rate(&self, x: f64) -> f64 {
        self.k * self.power(x.clamp(self.least(), MOST))
    }

    /// Share of the life from new that is spent at damage `x`.
    pub fn spent(&self, x: f64) -> f64 {
        (self.primitive(x.clamp(self.least(), MOST)) - self.primitive(0.0)) / self.k
    }

    /// Growth over `s` lives (`exp(rho) dt`) from `x`: the new damage, its derivative with respect to `x`, and its
    /// derivative with respect to rho.
    pub fn grow(&self, x: f64, s: f64) -> (f64, f64, f64) {
        let x = x.clamp(self.least(), MOST);
        let p0 = self.power(x);
        let step = s * self.k;
        let to = if self.twice_m == 0 {
            x + step
        } else if step * p0 < 0.02 * (x + self.eps) {
            // two terms of the series: closer than rounding asks of noise, and no root
            let rise = step * p0;
            let m = 0.5 * f64::from(self.twice_m);
            let q = rise / (x + self.eps);
            x + rise * (1.0 + 0.5 * m * q * (1.0 + (2.0 * m - 1.0) * q / 3.0))
        } else {
            self.inverse(self.primitive(x) + step)
        };
        let to = to.min(MOST);
        let p1 = self.power(to);
        (to, p1 / p0, step * p1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_life_from_new_ends_at_the_threshold() {
        for twice_m in -2..=4 {
            for eps in [0.02, 0.1, 0.5] {
                let law = Law::new(twice_m, eps);
                let mut x = 0.0;
                for _ in 0..1000 {
                    x = law.grow(x, 1e-3).0;
                }
                assert!((x - 1.0).abs() < 2e-3, "{twice_m} {eps}: {x}");
                assert!((law.grow(0.0, 1.0).0 - 1.0).abs() < 1e-9);
                assert!((law.spent(law.grow(0.0, 0.4).0) - 0.4).abs() < 1e-9);
                let (a, dx, dr) = law.grow(0.3, 0.01);
                let h = 1e-6;
                assert!(
                    ((law.grow(0.3 + h, 0.01).0 - a) / h - dx).abs() < 1e-3,
                    "{twice_m} {eps}"
                );
                assert!(((law.grow(0.3, 0.01 * (1.0 + h)).0 - a) / h - dr).abs() < 1e-3 * dr + 1e-6);
            }
        }
    }
}
