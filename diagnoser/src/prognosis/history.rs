//! Diagnoses over time, as the filter reads them.

use super::filter::Reading;
use super::special::{middle, normal_quantile};

/// Lower end, upper end, estimate.
pub type Ends = (f64, f64, f64);

/// Standard deviations of a 95 % interval.
pub const Z95: f64 = 1.959_963_985;

/// How a test ended, as far as a prognosis is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// with an interval
    Located,
    /// beyond the range of the maps
    OutOfRange,
    /// with an interval, or without one, of a test that was not whole
    Incomplete,
    /// with a contradiction: another defect
    Unexplained,
}

impl Ended {
    /// All.
    pub const ALL: [Ended; 4] = [Self::Located, Self::OutOfRange, Self::Incomplete, Self::Unexplained];

    /// As diagnoses name it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Located => "located",
            Self::OutOfRange => "out_of_range",
            Self::Incomplete => "incomplete",
            Self::Unexplained => "unexplained",
        }
    }
}

/// One test of one fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// when [units of the clock]
    pub at: f64,
    /// how it ended
    pub ended: Ended,
    /// lower end of the interval [unit of the fault]
    pub lo: Option<f64>,
    /// upper end
    pub hi: Option<f64>,
    /// estimate
    pub estimate: Option<f64>,
    /// stated coverage of the interval, within 0 and 1
    pub coverage: f64,
}

/// What happened to a unit beside its tests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Happening {
    /// a repair or a replacement: damage begins anew
    Repair,
    /// a lubricant was lost, dirt came in, it was overloaded: wear is faster from then on
    Loss,
    /// lubrication, configuration, sensor: the rate, or the level, may be another one
    Change,
}

/// The tests of one unit and fault, in their order.
#[derive(Clone, Debug, Default)]
pub struct History {
    /// what the unit is called
    pub actuator: String,
    /// its tests, ascending in time
    pub rows: Vec<Row>,
    /// what happened, ascending in time: the tests from then on come after it
    pub events: Vec<(f64, Happening)>,
    /// rows that stood there twice and were dropped
    pub duplicates: usize,
    /// rows that came out of order and were sorted
    pub disordered: usize,
    /// pairs of tests at one time that contradict each other
    pub conflicting: usize,
}

impl History {
    /// Puts rows in order.
    pub fn new(actuator: String, mut rows: Vec<Row>, mut events: Vec<(f64, Happening)>) -> Self {
        let disordered = rows.windows(2).filter(|w| w[1].at < w[0].at).count();
        rows.sort_by(|a, b| a.at.total_cmp(&b.at));
        events.sort_by(|a, b| a.0.total_cmp(&b.0));
        let before = rows.len();
        rows.dedup_by(|b, a| a == b);
        let duplicates = before - rows.len();
        let apart = |a: &Row, b: &Row| match (a.middle(), b.middle()) {
            (Some(a), Some(b)) => (a.0 - b.0).abs() > 8.0 * (a.1 * a.1 + b.1 * b.1).sqrt(),
            _ => false,
        };
        let conflicting = rows
            .windows(2)
            .filter(|w| w[0].at == w[1].at && apart(&w[0], &w[1]))
            .count();
        Self {
            actuator,
            rows,
            events,
            duplicates,
            disordered,
            conflicting,
        }
    }

    /// Usual time between two tests: the median, above 0.
    pub fn interval(&self) -> Option<f64> {
        let gaps = self.rows.windows(2).map(|w| w[1].at - w[0].at);
        middle(gaps.filter(|g| *g > 0.0).collect())
    }
}

impl Row {
    /// Mean and standard deviation that the interval stands for: of two half normals where the estimate is off its middle by
    /// more than a quarter.
    pub fn middle(&self) -> Option<(f64, f64)> {
        let (lo, hi) = (self.lo?, self.hi?);
        let estimate = self.estimate.unwrap_or(0.5 * (lo + hi));
        let z = normal_quantile(0.5 + 0.5 * self.coverage);
        let (half, off) = (0.5 * (hi - lo), estimate - 0.5 * (lo + hi));
        if off.abs() <= 0.25 * half {
            return Some((estimate, half / z));
        }
        let (below, above) = ((estimate - lo).max(0.0) / z, (hi - estimate).max(0.0) / z);
        let gap = above - below;
        let mean = estimate + (2.0 / std::f64::consts::PI).sqrt() * gap;
        let variance = (1.0 - 2.0 / std::f64::consts::PI) * gap * gap + above * below;
        Some((mean, variance.max(0.0).sqrt()))
    }
}

/// From a fault's unit to damage [share of U] and back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// level of a healthy unit
    pub healthy: f64,
    /// level that ends the life
    pub threshold: f64,
    /// end of the range of diagnoses; a test out of range is beyond it
    pub range: Option<f64>,
}

impl Scale {
    /// Damage [share of U] of a level.
    pub fn damage(&self, level: f64) -> f64 {
        (level - self.healthy) / (self.threshold - self.healthy)
    }

    /// Level of a damage.
    pub fn level(&self, x: f64) -> f64 {
        self.healthy + x * (self.threshold - self.healthy)
    }

    /// A difference of levels as damage, without sign.
    pub fn width(&self, difference: f64) -> f64 {
        (difference / (self.threshold - self.healthy)).abs()
    }

    /// Level of a damage by its mean and standard deviation, with the ends of its 95 % interval.
    pub fn level_of(&self, (x, sd): (f64, f64)) -> Ends {
        let ends = [self.level(x - Z95 * sd), self.level(x + Z95 * sd)];
        (ends[0].min(ends[1]), ends[0].max(ends[1]), self.level(x))
    }

    /// Growth of the level, without sign, by mean and standard deviation of the logarithm of that of damage; with the ends of
    /// its 95 % interval [unit of the fault / unit of the clock].
    pub fn rate_of(&self, (log, sd): (f64, f64)) -> Ends {
        let of = |z: f64| (self.threshold - self.healthy).abs() * (log + z * sd).exp();
        (of(-Z95), of(Z95), of(0.0))
    }

    /// What a test says; nothing where it says nothing of this fault.
    pub fn reading(&self, row: &Row) -> Option<Reading> {
        match row.ended {
            Ended::Unexplained => None,
            Ended::Located | Ended::Incomplete => {
                let (mean, sd) = row.middle()?;
                // an interval of no width is as fine as a number that is written with nine digits
                let sd = self.width(sd).max(1e-9);
                Some(Reading::Damage {
                    y: self.damage(mean),
                    sd,
                    level: self.width(mean),
                })
            }
            Ended::OutOfRange => {
                let bound = self.damage(row.lo.or(self.range)?);
                (bound > 0.0).then_some(Reading::Above(bound))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(at: f64, estimate: f64) -> Row {
        Row {
            at,
            ended: Ended::Located,
            lo: Some(estimate - 0.01),
            hi: Some(estimate + 0.01),
            estimate: Some(estimate),
            coverage: 0.95,
        }
    }

    #[test]
    fn rows_come_into_order_once() {
        let h = History::new(
            "a".into(),
            vec![row(2.0, 1.1), row(1.0, 1.0), row(2.0, 1.1), row(2.0, 3.0)],
            vec![],
        );
        assert_eq!((h.rows.len(), h.duplicates, h.disordered, h.conflicting), (3, 1, 1, 1));
        assert_eq!(h.interval(), Some(1.0));
    }

    #[test]
    fn intervals_become_readings() {
        let s = Scale {
            healthy: 1.0,
            threshold: 4.0,
            range: Some(5.0),
        };
        let Some(Reading::Damage { y, sd, level }) = s.reading(&row(1.0, 2.5)) else {
            panic!()
        };
        assert!(
            (y - 0.5).abs() < 1e-12 && (sd - 0.01 / 1.959964 / 3.0).abs() < 1e-8 && (level - 2.5 / 3.0).abs() < 1e-12
        );
        let skew = Row {
            estimate: Some(2.495),
            ..row(1.0, 2.5)
        };
        assert!(skew.middle().unwrap().0 > 2.495);
        let out = Row {
            ended: Ended::OutOfRange,
            lo: None,
            hi: None,
            estimate: None,
            ..row(1.0, 0.0)
        };
        assert_eq!(s.reading(&out), Some(Reading::Above(4.0 / 3.0)));
        assert_eq!(
            s.reading(&Row {
                ended: Ended::Unexplained,
                ..row(1.0, 2.0)
            }),
            None
        );
    }
}
