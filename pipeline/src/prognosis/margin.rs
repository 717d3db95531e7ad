//! A threshold of function: the faults at which an actuator no longer moves a load in time, by simulation.
//!
//! How the mean speed of the step falls with FSJ is flat at first and then a cliff, which no law of growth runs along. What is followed is
//! therefore the way to the cliff: (FSJ - 1) / (FSJ*(zeta) - 1), 0 where the transmission is healthy and 1 where the load is no longer
//! moved in time. In time: with at least half of the mean speed of the healthy actuator without a load (assumed).

use crate::calibrate::simulate_features;
use anyhow::Result;
use schemas::error::Error;
use schemas::fault::FaultState;
use schemas::feature::Raw;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::setup::TestSetup;
use sim_worker::test_bench::Lane;
use std::sync::Arc;

/// Name of the indicator, in place of a fault.
pub const STALL: &str = "stall";

/// Share of the healthy actuator's speed without a load that is in time (assumed).
const IN_TIME: f64 = 0.5;

/// Rate at which tests are simulated [Hz].
const RATE_HZ: f64 = 5000.0;

/// Points of the grid: FSJ from 1 by a half to 12, zeta from 0 by 0.1 to 0.5.
const FSJ: (f64, usize) = (0.5, 23);
const ZETA: (f64, usize) = (0.1, 6);

/// Where a load is no longer moved in time.
#[derive(Clone, Debug, PartialEq)]
pub struct Margin {
    /// load torque [N m, motor side]
    pub load_n_m: f64,
    /// FSJ at which it is no longer moved, at each zeta of the grid; infinite where none is
    pub fsj: Vec<f64>,
}

impl Margin {
    /// A load in words: `5Nm`, `5 N m`, or the number alone [N m].
    ///
    /// # Errors
    /// Another text, or no load above 0.
    pub fn load(text: &str) -> Result<f64> {
        let plain: String = text.chars().filter(|c| !c.is_whitespace()).collect();
        let number = plain.strip_suffix("Nm").unwrap_or(&plain);
        let load = number.parse::<f64>().ok().filter(|x| x.is_finite() && *x > 0.0);
        let allowed = "a load torque at the motor above 0, such as 0.4Nm";
        load.ok_or_else(|| Error::bad("command line", "--threshold stall", text, allowed).into())
    }

    /// Simulates the pre-flight test of an actuator under a load over the grid of faults.
    ///
    /// # Errors
    /// A load that the healthy actuator does not move, or that every actuator of the grid moves; interrupted.
    pub fn simulate(actuator: &Arc<ActuatorParameters>, load_n_m: f64) -> Result<Self> {
        let sequence = sim_worker::catalogue::sequence("preflight")?;
        let mut setup = TestSetup::new(actuator.clone(), sequence, RATE_HZ);
        setup.load_n_m = load_n_m;
        let faults = (0..ZETA.1).flat_map(|z| {
            (0..FSJ.1).map(move |f| FaultState {
                fsj: 1.0 + FSJ.0 * f as f64,
                zeta: ZETA.0 * z as f64,
            })
        });
        // first without a load: what the healthy actuator can do
        let lane = |fault, load_n_m| Lane {
            actuator: actuator.clone(),
            fault,
            rest_angle_rad: setup.rest_angle_rad,
            load_n_m,
        };
        let healthy = FaultState { fsj: 1.0, zeta: 0.0 };
        let lanes = std::iter::once(lane(healthy, 0.0)).chain(faults.map(|f| lane(f, load_n_m)));
        let lanes = lanes.map(|l| (l, 0)).collect();
        let features = simulate_features(&setup, lanes, "margin")?.ok_or(crate::Interrupted)?;
        let speeds: Vec<f64> = features.iter().map(|f| f[Raw::MeanSpeed].unwrap_or(0.0)).collect();
        let of = |found: String, allowed: &str| Error::bad("command line", "--threshold stall", found, allowed);
        let text = format!("{load_n_m} N m at the motor");
        if speeds[1] < IN_TIME * speeds[0] {
            let found = format!(
                "{text}, which {} does not move in time when it is healthy",
                actuator.name
            );
            let allowed = format!("a load below its torque limit of {} N m", actuator.torque_limit_n_m);
            return Err(of(found, &allowed).into());
        }
        let fsj: Vec<f64> = speeds[1..]
            .chunks(FSJ.1)
            .map(|row| crossing(row, IN_TIME * speeds[0]))
            .collect();
        if fsj.iter().all(|f| f.is_infinite()) {
            let most = 1.0 + FSJ.0 * (FSJ.1 - 1) as f64;
            let found = format!("{text}, which {} moves in time up to FSJ {most}", actuator.name);
            return Err(of(found, "a greater load, or --threshold fsj=LEVEL").into());
        }
        Ok(Self { load_n_m, fsj })
    }

    /// The way to the stall at a fault pair: 0 healthy, 1 no longer in time.
    pub fn at(&self, fsj: f64, zeta: f64) -> f64 {
        let x = (zeta / ZETA.0).clamp(0.0, (self.fsj.len() - 1) as f64);
        let k = (x as usize).min(self.fsj.len() - 2);
        let f = x - k as f64;
        // of the ways, so that one that never stalls counts as none
        let way = |limit: f64| (fsj - 1.0) / (limit - 1.0);
        (1.0 - f) * way(self.fsj[k]) + f * way(self.fsj[k + 1])
    }

    /// Least and greatest way over an interval of both faults.
    pub fn over(&self, fsj: (f64, f64), zeta: (f64, f64)) -> (f64, f64) {
        // linear in FSJ and piecewise in zeta: the ends, and the grid between them
        let nodes = (0..ZETA.1)
            .map(|k| ZETA.0 * k as f64)
            .filter(|z| (zeta.0..=zeta.1).contains(z));
        let places: Vec<f64> = nodes.chain([zeta.0, zeta.1]).collect();
        let at = |fsj: f64| places.iter().map(move |&z| self.at(fsj, z));
        (
            at(fsj.0).fold(f64::INFINITY, f64::min),
            at(fsj.1).fold(f64::NEG_INFINITY, f64::max),
        )
    }
}

/// FSJ at which a speed over FSJ first falls below `least`.
fn crossing(speeds: &[f64], least: f64) -> f64 {
    let Some(k) = speeds.iter().position(|s| *s < least) else {
        return f64::INFINITY;
    };
    let fsj = |k: usize| 1.0 + FSJ.0 * k as f64;
    if k == 0 {
        // already without friction: the way is as good as done
        return 1.0 + 1e-3 * FSJ.0;
    }
    let (a, b) = (speeds[k - 1], speeds[k]);
    fsj(k - 1) + FSJ.0 * (a - least) / (a - b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_the_way_to_the_stall_is_1_where_the_load_is_not_moved() {
        let actuator = Arc::new(ActuatorParameters::reference());
        let load = 0.7;
        let m = Margin::simulate(&actuator, load).unwrap();
        assert!(m.fsj.iter().all(|f| *f > 1.5), "{m:?}");
        assert_eq!(m.at(1.0, 0.3), 0.0);
        assert!((m.at(m.fsj[0], 0.0) - 1.0).abs() < 1e-12);
        let (lo, hi) = m.over((1.9, 2.1), (0.05, 0.35));
        assert!(lo <= m.at(2.0, 0.2) && m.at(2.0, 0.2) <= hi);
        // more load, less friction to the stall
        let heavier = Margin::simulate(&actuator, 0.75).unwrap();
        assert!(heavier.fsj[0] < m.fsj[0], "{heavier:?} {m:?}");
    }

    #[test]
    fn refuse_loads_that_say_nothing() {
        let actuator = Arc::new(ActuatorParameters::reference());
        let no = |load: f64| Margin::simulate(&actuator, load).unwrap_err().to_string();
        assert!(
            no(5.0).contains("does not move in time when it is healthy"),
            "{}",
            no(5.0)
        );
        assert!(no(1e-3).contains("moves in time up to FSJ"), "{}", no(1e-3));
        for text in ["-1Nm", "0", "heavy", "NaN"] {
            assert!(Margin::load(text).is_err(), "{text}");
        }
        assert_eq!(Margin::load("0.4 N m").unwrap(), 0.4);
    }
}
