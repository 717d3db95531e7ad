//! Maps made by hand, of which the answers are known.

use super::*;
use crate::calibration::{COVERAGE, Calibration};
use crate::failure_map::{FailureMap, FailureMapSet, MapSetHeader};
use crate::uncertainty::{MOST, ResponseSurfaces, Sample, Scale};
use schemas::feature::RawFeatures;
use sim_worker::spread::{Cause, Spread};
use std::f64::consts::PI;

const FSJ: (f64, f64) = (1.0, 5.0);
const ZETA: (f64, f64) = (0.0, 0.5);

fn axis((lo, hi): (f64, f64), n: usize) -> Vec<f64> {
    (0..n).map(|k| lo + (hi - lo) * k as f64 / (n - 1) as f64).collect()
}

/// On 17 x 11 points.
fn map(feature: Feature, noise: f64, sample: f64, value: impl Fn(f64, f64) -> f64) -> FailureMap {
    let (fsj, zeta) = (axis(FSJ, 17), axis(ZETA, 11));
    let raw = zeta
        .iter()
        .flat_map(|&z| fsj.iter().map(move |&f| (f, z)))
        .map(|(f, z)| value(f, z));
    let direction = feature.direction();
    FailureMap::build("test", feature, direction, &fsj, &zeta, raw.collect(), noise, sample).unwrap()
}

fn set(maps: Vec<FailureMap>) -> FailureMapSet {
    let text = || "test".to_string();
    FailureMapSet {
        header: MapSetHeader {
            actuator: text(),
            sequence: text(),
            kind: schemas::test_kind::TestKind::default(),
            grid: text(),
            step_s: 1e-6,
            seed: 0,
            commit: text(),
            left_out: Vec::new(),
        },
        nominal: RawFeatures::default(),
        maps,
        witnesses: Vec::new(),
    }
}

fn quality(maps: Vec<FailureMap>) -> MapQuality {
    MapQuality::of(&Diagnoser::uncalibrated(set(maps)))
}

fn near(found: f64, expected: f64, share: f64) {
    assert!((found / expected - 1.0).abs() < share, "{found}, not {expected}");
}

fn left_by(q: &MapQuality, remedy: Remedy) -> &Candidate {
    q.candidates.iter().find(|c| c.remedy == remedy).unwrap()
}

#[test]
fn prop_a_map_too_many_is_refused_by_name_and_what_has_parts_does_not_count() {
    let maps = |n: usize| vec![map(Feature::P2, 0.01, 0.0, |f, z| f + z); n];
    let mut many = set(maps(MOST));
    assert!(many.check("test").is_ok());
    for feature in [Feature::Ripple, Feature::SpeedLoss, Feature::P1] {
        let direction = feature.direction();
        many.maps.push(map(feature, 0.01, 0.0, |f, z| direction.0 * f + z));
        assert!(many.check("test").is_err());
    }
    let e = Diagnoser::new(many.clone(), None, COVERAGE, &Vec::new())
        .unwrap_err()
        .to_string();
    assert!(e.contains("ripple") && e.contains(&format!("{MOST} at most")), "{e}");
    many.maps.drain(..2);
    // P1 says nothing that its parts do not
    let joint: Vec<Feature> = many.joint().map(|m| m.feature).collect();
    assert_eq!(joint[MOST - 2..], [Feature::Ripple, Feature::SpeedLoss]);
    assert!(many.check("test").is_ok());
    many.witnesses = maps(MOST + 1);
    assert!(many.check("test").is_err());
}

#[test]
fn prop_parallel_maps_cannot_isolate_and_a_third_that_is_not_can() {
    let along = |f: f64, z: f64| f + 4.0 * z;
    let pair = || {
        vec![
            map(Feature::P2, 0.01, 0.0, along),
            map(Feature::CurrentRms, 0.02, 0.0, move |f, z| 2.0 * along(f, z)),
        ]
    };
    let q = quality(pair());
    assert_eq!((q.cells().len(), q.columns(), q.blind().len()), (160, 16, 160));
    assert!(
        q.cells()
            .iter()
            .all(|c| c.ellipse.is_none() && c.sigma_zeta().is_infinite())
    );
    assert!(q.best().is_none(), "{:?}", q.best());
    assert!(q.to_text().contains("160 of 160 cells do not tell the faults apart"));
    // not quite parallel: an ellipse, but a slender one
    let q = quality(vec![
        map(Feature::P2, 0.01, 0.0, along),
        map(Feature::CurrentRms, 0.02, 0.0, |f, z| 2.0 * f + 8.4 * z),
    ]);
    assert!(q.cells().iter().all(|c| c.ellipse.is_some() && !c.isolates()));
    let mut three = pair();
    three.push(map(Feature::Ripple, 0.01, 0.0, |f, z| 4.0 * z - f));
    let q = quality(three);
    assert!(q.blind().is_empty());
    // nothing without the third
    let without = |f| q.worth.iter().find(|w| w.feature == f).unwrap().without.unwrap();
    assert!(without(Feature::Ripple).is_infinite());
    assert!(without(Feature::P2) < 2.0, "{}", without(Feature::P2));
}

#[test]
fn val_ellipse_of_two_planes() {
    // slopes J = ((a, b), (c, d)), one unit of noise each: (J^T N^-1 J)^-1 by hand
    let (a, b, c, d) = (1.0, 2.0, 0.5, 6.0);
    let (n1, n2) = (0.01, 0.03);
    let q = quality(vec![
        map(Feature::P2, n1, 0.0, |f, z| a * f + b * z),
        map(Feature::CurrentRms, n2, 0.0, |f, z| c * f + d * z),
    ]);
    let det = a * d - b * c;
    let sigma_fsj = f64::hypot(d * n1, b * n2) / det;
    let sigma_zeta = f64::hypot(c * n1, a * n2) / det;
    let covariance = -(c * d * n1 * n1 + a * b * n2 * n2) / (det * det);
    let area = 2.447_746_830_680_816_f64.powi(2) * PI * n1 * n2 / det;
    for cell in q.cells() {
        let e = cell.ellipse.unwrap();
        near(e.sigma_fsj, sigma_fsj, 1e-6);
        near(e.sigma_zeta, sigma_zeta, 1e-6);
        near(e.correlation, covariance / (sigma_fsj * sigma_zeta), 1e-6);
        near(e.area, area, 1e-6);
        near(cell.sigma_fsj_percent(), 100.0 * sigma_fsj / cell.centre().0, 1e-6);
    }
    let s = &q
        .sensitivity
        .iter()
        .find(|s| s.feature == Feature::CurrentRms)
        .unwrap()
        .steepness;
    let ((f, z), own, u) = s.fsj.middles[3];
    assert_eq!((f, z), (4.0, 0.375));
    near(own, 0.01 * 4.0 * c, 1e-9);
    near(u, 0.01 * 4.0 * c / n2, 1e-6);
    near(s.zeta.middles[0].1, 0.01 * d, 1e-9);
    near(s.zeta.sigmas[1], 0.01 * d / n2, 1e-6);
    near(s.fsj.own[2], 0.01 * 4.875 * c, 1e-9);
}

#[test]
fn val_worse_and_better_cells_lie_where_they_were_put() {
    // zeta acts through a bend: the slope, and with it the information, grows with zeta
    let q = quality(vec![
        map(Feature::P2, 0.1, 0.0, |f, _| f * f),
        map(Feature::CurrentRms, 0.1, 0.0, |_, z| z + 10.0 * z * z),
    ]);
    let sorted = q.by_area();
    let (best, worst) = (sorted[0], sorted[sorted.len() - 1]);
    assert_eq!((best.fsj, best.zeta), ((4.75, 5.0), (0.45, 0.5)));
    assert_eq!((worst.fsj, worst.zeta), ((1.0, 1.25), (0.0, 0.05)));
    assert!(std::ptr::eq(best, &q.cells()[159]) && std::ptr::eq(worst, &q.cells()[0]));
}

#[test]
fn prop_planted_break_and_crossing_are_named_with_their_place() {
    // steps of 4 along FSJ and 0.5 along zeta; one point lifted by 1.6: a step of -2.4 along FSJ is none
    let lifted = |f: f64, z: f64| if (f, z) == (3.0, ZETA.1 * 4.0 / 10.0) { 1.6 } else { 0.0 };
    let bent = map(Feature::P2, 0.1, 0.0, |f, z| 16.0 * f + 10.0 * z + lifted(f, z));
    let straight = map(Feature::CurrentRms, 0.1, 0.0, |f, z| f + z);
    let q = quality(vec![bent, straight]);
    let s = q.shapes.iter().find(|s| s.feature == Feature::P2).unwrap();
    assert_eq!(s.broken.fsj, None);
    let b = s.broken.zeta.as_ref().unwrap();
    // the next curve is 0.5 higher
    near(b.value, 1.6 - 0.5, 1e-9);
    near(b.share, 1.1 / (s.range.1 - s.range.0), 1e-9);
    assert_eq!(b.from, (3.0, 0.2));
    assert!((b.to.1 - 0.25).abs() < 1e-12 && b.to.0 == 3.0);
    // the lifted curve goes through the next one and back
    assert_eq!(s.crossings.count, 2);
    let c = s.crossings.deepest.as_ref().unwrap();
    near(c.depth, 1.1, 1e-9);
    assert_eq!(c.fsj, 3.0);
    assert!((c.zeta.0 - 0.2).abs() < 1e-12 && (c.zeta.1 - 0.25).abs() < 1e-12);
    assert!(
        q.to_text()
            .contains("p2 breaks along zeta by 1.10 A, 11.0 u from (FSJ 3.000, zeta 0.2000)")
    );
    let whole = q.shapes.iter().find(|s| s.feature == Feature::CurrentRms).unwrap();
    assert_eq!(
        (whole.crossings.count, &whole.broken.fsj, &whole.broken.zeta),
        (0, &None, &None)
    );
}

#[test]
fn prop_a_break_over_several_points_counts_as_a_whole_and_a_touch_does_not_cross() {
    // falls by 0.2 at each of three steps, on the lowest curve only; and two curves that meet
    let sag = |f: f64, z: f64| {
        if z == 0.0 {
            -1.2 * (f - 2.0).clamp(0.0, 0.75)
        } else {
            0.0
        }
    };
    let q = quality(vec![
        map(Feature::P2, 0.1, 0.0, |f, z| 40.0 * z + 0.4 * f.max(2.75) + sag(f, z)),
        map(Feature::CurrentRms, 0.1, 0.0, |f, z| {
            f + (z - 0.05).max(0.0) * (f - 3.0).abs()
        }),
    ]);
    let b = q.shapes[0].broken.fsj.clone().unwrap();
    near(b.value, 0.9, 1e-9);
    assert_eq!((b.from, b.to), ((2.0, 0.0), (2.75, 0.0)));
    assert_eq!((q.shapes[0].crossings.count, q.shapes[1].crossings.count), (0, 0));
}

#[test]
fn val_plateaus_are_counted() {
    // flat along FSJ below 2 (4 of 16 columns, of which the bend at 2 may take one); along zeta never below the
    // noise
    let q = quality(vec![
        map(Feature::P2, 0.01, 0.0, |f, z| f.max(2.0) + z),
        map(Feature::P3, 0.0, 0.03, |f, z| f + 0.2 * z),
    ]);
    assert!(
        (0.1875..=0.25).contains(&q.shapes[0].plateau.fsj),
        "{}",
        q.shapes[0].plateau.fsj
    );
    assert_eq!(q.shapes[0].plateau.zeta, 0.0);
    // whole samples: a step of 0.01 along zeta is below 0.03 / sqrt(3)
    assert_eq!((q.shapes[1].plateau.fsj, q.shapes[1].plateau.zeta), (0.0, 1.0));
}

#[test]
fn val_less_noise_shrinks_the_area_as_it_must() {
    // FSJ by two features, zeta by one: information adds
    let (n1, n2, n3) = (0.01, 0.03, 0.02);
    let maps = || {
        vec![
            map(Feature::P2, n1, 0.0, |f, _| f),
            map(Feature::CurrentRms, n2, 0.0, |f, _| f),
            map(Feature::Rise, n3, 0.0, |_, z| z),
        ]
    };
    let q = quality(maps());
    let (i1, i2) = (1.0 / (n1 * n1), 1.0 / (n2 * n2));
    near(
        left_by(&q, Remedy::Again(Feature::P2)).area,
        ((i1 + i2) / (2.0 * i1 + i2)).sqrt(),
        1e-6,
    );
    near(
        left_by(&q, Remedy::Again(Feature::CurrentRms)).area,
        ((i1 + i2) / (i1 + 2.0 * i2)).sqrt(),
        1e-6,
    );
    let zeta = left_by(&q, Remedy::Again(Feature::Rise));
    near(zeta.area, 0.5f64.sqrt(), 1e-6);
    near(zeta.sigma_zeta, 0.5f64.sqrt(), 1e-6);
    near(zeta.sigma_fsj, 1.0, 1e-6);
    near(left_by(&q, Remedy::BetterSensors).area, 0.25, 1e-6);
    near(left_by(&q, Remedy::FinerGrid).area, 1.0, 1e-6);
    let without = |f| q.worth.iter().find(|w| w.feature == f).unwrap().without.unwrap();
    near(without(Feature::P2), ((i1 + i2) / i2).sqrt(), 1e-6);
    near(without(Feature::CurrentRms), ((i1 + i2) / i1).sqrt(), 1e-6);
    assert!(without(Feature::Rise).is_infinite());
    // the same of maps that are really made with half the noise in the dominant feature
    let mut better = maps();
    better[0] = map(Feature::P2, 0.5 * n1, 0.0, |f, _| f);
    let ratio = quality(better).cells()[80].area() / q.cells()[80].area();
    near(ratio, ((i1 + i2) / (4.0 * i1 + i2)).sqrt(), 1e-6);
}

#[test]
fn prop_ranking_finds_the_weak_spot() {
    // P3 in coarse samples and no noise where it matters: measure P3 twice
    let q = quality(vec![
        map(Feature::P2, 0.0, 0.0, |f, z| f + 5.0 * z),
        map(Feature::P3, 0.0, 0.1, |f, z| f + 10.0 * z),
        map(Feature::Rise, 1.0, 0.0, |f, z| f + z),
    ]);
    let best = q.best().unwrap();
    assert_eq!(best.remedy, Remedy::Again(Feature::P3));
    assert!(
        q.to_text()
            .contains("Most would be gained by p3 measured twice, same map (area less 29.3 %)")
    );
    // a smooth map, strongly bent for its grid, and hardly any noise: a finer grid
    let q = quality(vec![
        map(Feature::P2, 1e-5, 0.0, |f, z| f + 0.1 * z),
        map(Feature::CurrentRms, 1e-5, 0.0, |f, z| {
            5.0 * z + 0.3 * (f * 1.3).sin() + f
        }),
    ]);
    assert_eq!(q.best().unwrap().remedy, Remedy::FinerGrid);
    let c = q.convergence.iter().find(|c| c.feature == Feature::CurrentRms).unwrap();
    assert!(!c.fine_enough() && c.ratio() < 0.4, "{c:?}");
    assert!(c.finer < 0.4 * c.interpolation && q.convergence.iter().any(|c| c.fine_enough()));
    // plenty of noise: sensors
    let q = quality(vec![
        map(Feature::P2, 0.1, 0.0, |f, z| f + z),
        map(Feature::P3, 0.1, 0.0, |f, z| f + 9.0 * z),
    ]);
    assert_eq!(q.best().unwrap().remedy, Remedy::BetterSensors);
    // a grid cannot mend what scatters
    let scatter = |f: f64, z: f64| 0.05 * ((f * 7919.0 + z * 104_729.0).sin());
    let q = quality(vec![
        map(Feature::P2, 1e-4, 0.0, |f, z| 2.0 * f + 4.0 * z + scatter(f, z)),
        map(Feature::P3, 0.0, 0.0, |f, z| f + 9.0 * z),
    ]);
    let c = q.convergence.iter().find(|c| c.feature == Feature::P2).unwrap();
    assert!(
        !c.fine_enough() && !c.finer_enough() && c.finer > 0.6 * c.interpolation,
        "{c:?}"
    );
    assert_eq!(q.best().unwrap().remedy, Remedy::Another(Feature::P2));
}

/// Units whose supply moves P2 and whose resistance moves it a tenth as much.
fn fleet(maps: &FailureMapSet) -> Calibration {
    // -1 to 1 (Steele et al. 2014, SplitMix)
    let number = |i: usize, k: usize| {
        let mut x = ((i * 8 + k) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (x >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    let sample = |i: usize| {
        let mut deviations = [0.0; Cause::COUNT];
        deviations[Cause::Supply as usize] = 0.05 * number(i, 3);
        deviations[Cause::Resistance as usize] = 0.05 * number(i, 4);
        let y = 10.0 * deviations[Cause::Supply as usize] + deviations[Cause::Resistance as usize];
        Sample {
            fsj: 3.0 + 2.0 * number(i, 1),
            zeta: 0.25 + 0.25 * number(i, 2),
            deviations,
            residual: vec![(Feature::P2, y, 0.0), (Feature::P3, 0.0, 0.0)],
        }
    };
    let samples: Vec<Sample> = (0..400).map(sample).collect();
    let mut half_width = Spread::none().half_width;
    half_width[Cause::Supply as usize] = 0.05;
    half_width[Cause::Resistance as usize] = 0.05;
    Calibration {
        spread: "planted".into(),
        half_width,
        friction_per_k: 0.0,
        runs: 4,
        surface_runs: 400,
        seed: 0,
        maps: maps.fingerprint(),
        commit: String::new(),
        scores: std::array::from_fn(|_| vec![2.0]),
        misfits: vec![10.0],
        deviations: Vec::new(),
        strips: Vec::new(),
        kinetic: Vec::new(),
        surfaces: Some(ResponseSurfaces::fit(Scale { fsj: FSJ, zeta: ZETA }, &samples)),
    }
}

#[test]
fn val_knowing_a_cause_takes_its_share_away() {
    let noise = 0.01;
    let maps = set(vec![
        map(Feature::P2, noise, 0.0, |f, _| f),
        map(Feature::P3, noise, 0.0, |_, z| z),
    ]);
    let calibration = fleet(&maps);
    let known = |list: Vec<(Cause, f64)>| {
        MapQuality::of(&Diagnoser::new(maps.clone(), Some(calibration.clone()), COVERAGE, &list).unwrap())
    };
    let q = known(Vec::new());
    // standard deviations in P2: of the supply, of the resistance
    let (supply, resistance) = (0.5 / 3f64.sqrt(), 0.05 / 3f64.sqrt());
    let now = noise * noise + supply * supply + resistance * resistance;
    let best = q.best().unwrap();
    assert_eq!(best.remedy, Remedy::Known(Cause::Supply));
    near(best.area, ((now - supply * supply) / now).sqrt(), 1e-3);
    near(
        left_by(&q, Remedy::Known(Cause::Resistance)).area,
        ((now - resistance * resistance) / now).sqrt(),
        1e-3,
    );
    assert!(
        q.to_text()
            .contains("Most would be gained by the supply voltage known exactly")
    );
    // and where it is known, that is what is left, and it is no candidate any more
    let after = known(vec![(Cause::Supply, 0.0)]);
    near(after.cells()[80].area(), best.area * q.cells()[80].area(), 1e-6);
    assert!(
        after
            .candidates
            .iter()
            .all(|c| c.remedy != Remedy::Known(Cause::Supply))
    );
}

#[test]
fn prop_covariance_is_that_of_the_diagnosis() {
    let maps = set(vec![
        map(Feature::P2, 0.01, 0.0, |f, z| f + 0.1 * (3.0 * f).sin() + z),
        map(Feature::P3, 0.02, 0.03, |f, z| z * f),
    ]);
    let d = Diagnoser::new(maps.clone(), Some(fleet(&maps)), COVERAGE, &Vec::new()).unwrap();
    for l in Local::all(&d) {
        let centre = l.cell(Change::Nothing).centre();
        let c = l.covariance(Change::Nothing, &[0, 1]);
        for (k, f) in d.joint_features().iter().enumerate() {
            near(c[(k, k)].sqrt(), d.uncertainty(*f, centre.0, centre.1).unwrap(), 1e-9);
        }
    }
}

#[test]
fn prop_text_is_narrow_and_json_whole() {
    let maps = set(vec![
        map(Feature::P2, 0.0123, 0.0, |f, z| 1e5 * f + z),
        map(Feature::P3, 0.0, 1e-5, |f, z| f * (1.0 + z)),
        map(Feature::SpeedLoss, 1e-6, 0.0, |f, z| 1e-4 * (f + z)),
        map(Feature::Ripple, 1e-6, 0.0, |f, z| 1e-4 * (z - f)),
        map(Feature::P1, 1e-6, 0.0, |f, z| 1e-4 * (z + f * f)),
    ]);
    let q = MapQuality::of(&Diagnoser::new(maps.clone(), Some(fleet(&maps)), COVERAGE, &Vec::new()).unwrap());
    let text = q.to_text();
    let wide: Vec<&str> = text.lines().filter(|l| l.chars().count() > text::WIDTH).collect();
    assert!(wide.is_empty(), "{wide:?}");
    assert!(!text.contains("NaN"), "{text}");
    let json = q.to_json();
    assert_eq!(json["cells"].as_array().unwrap().len(), q.cells().len());
    assert_eq!(json["cells"][7]["sigma_zeta"].as_f64(), Some(q.cells()[7].sigma_zeta()));
    assert_eq!(json["maps"].as_array().unwrap().len(), 5);
    // P1 is made of others: it is described, but not inverted
    assert_eq!(q.joint.len(), 4);
    let p1 = q.worth.iter().find(|w| w.feature == Feature::P1).unwrap();
    assert_eq!(p1.without, None);
    assert!(q.candidates.is_sorted_by(|a, b| a.area <= b.area));
}
