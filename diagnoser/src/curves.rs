//! The paper's construction (5.1), for drawings and as a cross-check of the set inversion: the band
//! around each P* cuts each curve of constant eccentricity into an interval of FSJ; intersected over the
//! maps, the cuts of all curves make up the area of possible faults.

use crate::failure_map::FailureMap;
use crate::monotone;
use schemas::fault::Interval;

/// FSJ interval on one curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strip {
    /// of the curve
    pub zeta: f64,
    /// where all bands hold the values measured, unlimited on a side that no band limits
    pub fsj: Interval,
}

/// A map, the value measured for it and the half-width of the band at each grid point.
pub struct Cut<'a> {
    /// the map that is cut
    pub map: &'a FailureMap,
    /// measured, in the feature's unit
    pub value: f64,
    /// in the feature's unit, zeta outer, FSJ inner
    pub half_width: Vec<f64>,
}

impl Cut<'_> {
    /// What the band cuts from the curve at `zeta`, if anything: from where its upper limit reaches the
    /// value to where its lower one leaves it.
    fn on(&self, zeta: f64) -> Option<Interval> {
        let band = self.map.band(zeta, &self.half_width);
        let v = self.map.direction.0 * self.value;
        let (x, low, high) = (&self.map.fsj, &band.low.y, &band.high.y);
        let lo = monotone::rises_to(x, |k| high[k], v, f64::NEG_INFINITY, &mut 0)?;
        let hi = monotone::rises_from(x, |k| low[k], v, f64::INFINITY, &mut 0)?;
        (lo <= hi).then_some(Interval { lo, hi })
    }
}

/// Where all cuts have something in common, on lines of constant zeta.
pub fn common(cuts: &[Cut<'_>], zetas: impl Iterator<Item = f64>) -> Vec<Strip> {
    let strip = |zeta: f64| {
        let whole = Interval {
            lo: f64::NEG_INFINITY,
            hi: f64::INFINITY,
        };
        let fsj = cuts.iter().try_fold(whole, |all, c| all.meet(c.on(zeta)?))?;
        Some(Strip { zeta, fsj })
    };
    zetas.filter_map(strip).collect()
}
