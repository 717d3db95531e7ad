//! The paper's own method (5.1), as it stands there: each of the three maps is cut by the band around its measured
//! value, curve by curve of constant eccentricity (G2), which gives intervals of friction (G1); what the intervals of all
//! maps have in common on a curve is kept, and G2 is read off the curves that are left.
//!
//! The paper gives no width of its bands; here they are those of the maps, as they are drawn (assumed). Nor does it say
//! what lies between two curves: the interval of G2 ends half-way to the first curve that is not cut (assumed).

use crate::curves::{Cut, common};
use crate::diagnosis::{Area, Diagnoser, Diagnosis, Outcome};
use crate::paving::{Part, PavedBox};
use schemas::fault::Interval;
use schemas::feature::{Feature, Features};

/// The maps of the paper.
const MAPS: [Feature; 3] = [Feature::P1, Feature::P2, Feature::P3];

/// The fault pairs that the paper's construction gives.
///
/// * `features` measured, over the maps' nominal run
/// * `missing` what the telemetry lacks, in words; empty if nothing
pub fn diagnose(d: &Diagnoser, features: &Features, missing: &[String]) -> Diagnosis {
    Diagnosis {
        outcome: outcome(d, features, missing),
        features: *features,
        // the paper states none
        coverage: f64::NAN,
        calibrated: false,
        misfit: None,
        kinetic: None,
    }
}

fn outcome(d: &Diagnoser, features: &Features, missing: &[String]) -> Outcome {
    let band = d.usual_band();
    let cut = |f: Feature| Some(d.cut(d.maps.map(f)?, features.get(f).filter(|v| v.is_finite())?, band));
    let cuts: Vec<Cut<'_>> = MAPS.into_iter().filter_map(cut).collect();
    if cuts.len() < 2 {
        let mut lacking = missing.to_vec();
        if lacking.is_empty() {
            let names = MAPS.map(Feature::name).join(", ");
            lacking.push(format!(
                "{} of the maps {names}; the method needs at least two",
                cuts.len()
            ));
        }
        return Outcome::Incomplete {
            reason: lacking.join("; "),
            area: None,
        };
    }
    if !missing.is_empty() {
        return Outcome::Incomplete {
            reason: missing.join("; "),
            area: None,
        };
    }
    let map = cuts[0].map;
    let (f0, f1) = (map.fsj[0], map.fsj[map.fsj.len() - 1]);
    // the curve's place, and what is cut from it within the maps
    let strips: Vec<(usize, Interval)> = common(&cuts, map.zeta.iter().copied())
        .into_iter()
        .filter_map(|s| {
            let place = map.zeta.iter().position(|z| *z == s.zeta)?;
            let (lo, hi) = (s.fsj.lo.max(f0), s.fsj.hi.min(f1));
            (lo <= hi).then_some((place, Interval { lo, hi }))
        })
        .collect();
    if strips.is_empty() {
        return Outcome::Unexplained {
            contradicting: cuts.iter().map(|c| c.map.feature).collect(),
            reason: "on no curve of constant eccentricity do the cuts of the maps have friction in common".into(),
        };
    }
    Outcome::Located(area(&map.zeta, &strips, band))
}

/// The area of strips that each reach half-way to the next curve.
fn area(zeta: &[f64], strips: &[(usize, Interval)], band: f64) -> Area {
    let along = |place: usize| Interval {
        lo: if place > 0 {
            0.5 * (zeta[place - 1] + zeta[place])
        } else {
            zeta[0]
        },
        hi: zeta
            .get(place + 1)
            .map_or(zeta[place], |next| 0.5 * (zeta[place] + next)),
    };
    let hull = |all: &mut dyn Iterator<Item = Interval>| {
        all.fold(None, |h: Option<Interval>, i| {
            Some(h.map_or(i, |h| Interval {
                lo: h.lo.min(i.lo),
                hi: h.hi.max(i.hi),
            }))
        })
        .expect("at least one strip")
    };
    let fsj = hull(&mut strips.iter().map(|s| s.1));
    let between = hull(&mut strips.iter().map(|s| along(s.0)));
    // centroid of the strips, on their curves; a strip without width counts as a point
    let least = 1e-12 + 1e-9 * fsj.width();
    let weight = |i: &Interval| i.width().max(least);
    let total: f64 = strips.iter().map(|s| weight(&s.1)).sum();
    let mean =
        |of: &dyn Fn(&(usize, Interval)) -> f64| strips.iter().map(|s| weight(&s.1) * of(s)).sum::<f64>() / total;
    let centroid = (mean(&|s| 0.5 * (s.1.lo + s.1.hi)), mean(&|s| zeta[s.0]));
    let size: f64 = strips.iter().map(|s| s.1.width() * along(s.0).width()).sum();
    let boxes = strips.iter().map(|s| PavedBox {
        fsj: s.1,
        zeta: along(s.0),
        inside: true,
    });
    Area {
        parts: vec![Part {
            fsj,
            zeta: between,
            inner_hull: None,
            inner: size,
            outer: size,
            centroid,
        }],
        boxes: boxes.collect(),
        fsj,
        zeta: between,
        centroid,
        size,
        inner: size,
        outer: size,
        band,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::failure_map::{FailureMap, FailureMapSet, MapSetHeader};
    use schemas::feature::RawFeatures;
    use schemas::test_kind::TestKind;

    fn diagnoser() -> Diagnoser {
        let (fsj, zeta) = (vec![1.0, 2.0, 3.0, 4.0, 5.0], vec![0.0, 0.1, 0.2, 0.3, 0.4]);
        let map = |feature: Feature, of: &dyn Fn(f64, f64) -> f64| {
            let values = zeta.iter().flat_map(|&z| fsj.iter().map(move |&f| of(f, z))).collect();
            FailureMap::build("t", feature, (1.0, 1.0), &fsj, &zeta, values, 0.02, 0.0).unwrap()
        };
        Diagnoser::uncalibrated(FailureMapSet {
            header: MapSetHeader {
                actuator: "t".into(),
                sequence: "none".into(),
                kind: TestKind::default(),
                grid: String::new(),
                step_s: 1e-6,
                seed: 0,
                commit: String::new(),
                left_out: Vec::new(),
            },
            nominal: RawFeatures::default(),
            maps: vec![
                map(Feature::P1, &|f, z| 0.1 * f + 10.0 * z),
                map(Feature::P2, &|f, z| 0.5 * f + z),
                map(Feature::P3, &|f, z| 0.7 * f + 0.2 * z),
            ],
            witnesses: Vec::new(),
        })
    }

    fn measured(f: f64, z: f64) -> Features {
        Features::default()
            .with(Feature::P1, Some(0.1 * f + 10.0 * z))
            .with(Feature::P2, Some(0.5 * f + z))
            .with(Feature::P3, Some(0.7 * f + 0.2 * z))
    }

    #[test]
    fn val_a_pair_on_a_curve_is_read_off_that_curve() {
        let d = diagnose(&diagnoser(), &measured(2.4, 0.2), &[]);
        let Outcome::Located(a) = &d.outcome else {
            panic!("{d:?}")
        };
        assert!(
            (a.centroid.1 - 0.2).abs() < 1e-12 && (a.centroid.0 - 2.4).abs() < 0.05,
            "{a:?}"
        );
        assert!(a.fsj.contains(2.4), "{a:?}");
        assert!(
            (a.zeta.lo - 0.15).abs() < 1e-12 && (a.zeta.hi - 0.25).abs() < 1e-12,
            "{a:?}"
        );
        assert!(d.coverage.is_nan() && !d.calibrated);
    }

    #[test]
    fn prop_values_that_no_curve_shares_are_unexplained_and_missing_ones_said() {
        let off = measured(2.4, 0.2).with(Feature::P3, Some(4.4));
        assert_eq!(diagnose(&diagnoser(), &off, &[]).outcome.name(), "unexplained");
        let few = Features::default().with(Feature::P2, Some(1.0));
        let d = diagnose(&diagnoser(), &few, &[]);
        assert_eq!(d.outcome.name(), "incomplete");
        assert!(
            d.outcome.reason().contains("needs at least two"),
            "{}",
            d.outcome.reason()
        );
    }
}
