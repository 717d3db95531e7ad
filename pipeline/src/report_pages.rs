//! What the report shows: maps with cuts, located areas, traces, tables.

pub(crate) mod conclusion;
pub(crate) mod demo;
mod demo_figures;
pub(crate) mod diagnosis;
pub(crate) mod discrepancy;
mod discrepancy_figures;

use crate::report::{Band, Curve, Figure, MapPlot, RegionPlot, Strip, TracePlot};
use diagnoser::curves::common;
use diagnoser::diagnosis::{Area, Diagnoser, Diagnosis};
use diagnoser::failure_map::FailureMap;
use diagnoser::monotone;
use schemas::channel::Channel;
use schemas::fault::FaultState;
use schemas::feature::Feature;
use schemas::telemetry::Collector;

/// Most curves of a map that are drawn.
const CURVES: usize = 11;

/// A map with its curves, and the band of a measured value if there is one.
///
/// * `band` value and half-width in the feature's unit
pub fn map_plot(map: &FailureMap, band: Option<(f64, f64)>) -> MapPlot {
    let step = (map.zeta.len() - 1).div_ceil(CURVES - 1).max(1);
    let rows: Vec<usize> = (0..map.zeta.len()).step_by(step).collect();
    let (f0, f1) = (map.fsj[0], map.fsj[map.fsj.len() - 1]);
    let curves = rows
        .iter()
        .map(|&r| {
            let c = map.curve(map.zeta[r]);
            let points = (0..=120).map(|k| {
                let f = f0 + (f1 - f0) * k as f64 / 120.0;
                (f, map.direction.0 * monotone::at(&map.fsj, &c.y, &c.d, f))
            });
            Curve {
                zeta: map.zeta[r],
                points: points.collect(),
            }
        })
        .collect();
    let n = map.fsj.len();
    let knots = rows
        .iter()
        .flat_map(|&r| (0..n).map(move |c| (map.fsj[c], map.raw[r * n + c])))
        .collect();
    MapPlot {
        name: label(map.feature),
        title: map.feature.title().into(),
        unit: map.feature.unit().into(),
        curves,
        knots,
        band: band.map(|(value, half_width)| Band { value, half_width }),
        truth: None,
        estimate: None,
    }
}

/// The value of a map at a fault pair.
fn value_of(map: &FailureMap, (fsj, zeta): (f64, f64)) -> (f64, f64) {
    let c = map.curve(zeta);
    (fsj, map.direction.0 * monotone::at(&map.fsj, &c.y, &c.d, fsj))
}

/// The bands in the plane of the faults: whole range, or zoomed on the located area.
pub fn region_plot(
    title: &str,
    diagnoser: &Diagnoser,
    d: &Diagnosis,
    truth: Option<FaultState>,
    zoom: bool,
) -> RegionPlot {
    let set = &diagnoser.maps;
    let m = &set.maps[0];
    let whole = (
        (m.fsj[0], m.fsj[m.fsj.len() - 1]),
        (m.zeta[0], m.zeta[m.zeta.len() - 1]),
    );
    let area = d.outcome.area();
    let (fsj_range, zeta_range) = match (area, zoom) {
        (Some(a), true) => {
            let wide = |lo: f64, hi: f64, t: Option<f64>, (min, max): (f64, f64)| {
                let (lo, hi) = t.map_or((lo, hi), |t| (lo.min(t), hi.max(t)));
                let pad = 0.6 * (hi - lo).max(0.004 * (max - min));
                ((lo - pad).max(min), (hi + pad).min(max))
            };
            (
                wide(a.fsj.lo, a.fsj.hi, truth.map(|t| t.fsj), whole.0),
                wide(a.zeta.lo, a.zeta.hi, truth.map(|t| t.zeta), whole.1),
            )
        }
        _ => whole,
    };
    let lines = |k: i32| zeta_range.0 + (zeta_range.1 - zeta_range.0) * k as f64 / 240.0;
    let strips = |s: Vec<diagnoser::curves::Strip>| {
        s.into_iter()
            .map(|s| Strip {
                zeta: s.zeta,
                fsj_lo: s.fsj.lo,
                fsj_hi: s.fsj.hi,
            })
            .collect::<Vec<_>>()
    };
    let band = area.map_or(diagnoser.usual_band(), |a| a.band);
    let regions = diagnoser
        .shown_maps()
        // what says a cause allows every pair
        .filter(|m| !Feature::CAUSES.contains(&m.feature))
        .filter_map(|m| {
            let v = d.features.get(m.feature)?;
            let name = label(m.feature);
            let cut = [diagnoser.cut(m, v, band)];
            Some((name, strips(common(&cut, (0..=240).map(lines)))))
        })
        .collect();
    RegionPlot {
        title: title.into(),
        fsj_range,
        zeta_range,
        regions,
        area: area.map_or(Vec::new(), outline),
        hull: area.map(|a| ((a.fsj.lo, a.fsj.hi), (a.zeta.lo, a.zeta.hi))),
        truth: truth.map(|t| (t.fsj, t.zeta)).into_iter().collect(),
        estimate: area.map(|a| a.centroid).into_iter().collect(),
        notes: Vec::new(),
    }
}

/// Name in figures.
fn label(f: Feature) -> String {
    match f {
        Feature::P1 | Feature::P2 | Feature::P3 => f.name().to_uppercase(),
        f => f.name().replace('_', " "),
    }
}

/// What the boxes of an area cover, on lines of constant zeta.
fn outline(a: &Area) -> Vec<Strip> {
    const LINES: usize = 160;
    let line = |k: usize| {
        let zeta = a.zeta.lo + a.zeta.width() * (k as f64 + 0.5) / LINES as f64;
        let hit = a.boxes.iter().filter(|b| b.zeta.contains(zeta));
        let fsj = hit.map(|b| b.fsj).reduce(schemas::fault::Interval::join)?;
        Some(Strip {
            zeta,
            fsj_lo: fsj.lo,
            fsj_hi: fsj.hi,
        })
    };
    (0..LINES).filter_map(line).collect()
}

/// Whether a feature is one of the paper's three.
fn of_paper(f: Feature) -> bool {
    matches!(f, Feature::P1 | Feature::P2 | Feature::P3)
}

/// The plane of the faults for the first screen: the bands of the paper's three maps, what was found, the healthy point.
fn plane(diagnoser: &Diagnoser, d: &Diagnosis) -> RegionPlot {
    let mut plot = region_plot("Where the faults lie", diagnoser, d, None, false);
    let names: Vec<String> = [Feature::P1, Feature::P2, Feature::P3].map(label).to_vec();
    plot.regions.retain(|r| names.contains(&r.0));
    plot.notes = vec![((1.0, 0.0), "healthy".into())];
    plot
}

/// The maps of a diagnosis with their cuts, those of the paper first.
fn cut_maps(
    stem: &str,
    diagnoser: &Diagnoser,
    d: &Diagnosis,
    truth: Option<FaultState>,
) -> Vec<(Feature, (String, Figure))> {
    let area = d.outcome.area();
    let one = |m: &FailureMap| {
        let n = (m.fsj.len() / 2, m.zeta.len() / 2);
        let at = area.map_or((m.fsj[n.0], m.zeta[n.1]), |a| a.centroid);
        let band = area.map_or(diagnoser.usual_band(), |a| a.band);
        let half = band * diagnoser.uncertainty(m.feature, at.0, at.1).unwrap_or(f64::NAN);
        let mut plot = map_plot(m, d.features.get(m.feature).map(|v| (v, half)));
        plot.truth = truth.map(|t| value_of(m, (t.fsj, t.zeta)));
        plot.estimate = area.map(|a| value_of(m, a.centroid));
        (
            m.feature,
            (format!("{stem}_map_{}", m.feature.name()), Figure::Map(plot)),
        )
    };
    let mut all: Vec<_> = diagnoser.shown_maps().map(one).collect();
    all.sort_by_key(|m| !of_paper(m.0));
    all
}

/// Telemetry against time.
pub fn traces(title: &str, label: &str, runs: &[(&str, &Collector)], rate_hz: f64, channel: Channel) -> TracePlot {
    let series = runs
        .iter()
        .filter_map(|(name, c)| {
            let v = c.column(channel)?;
            let first = c.first;
            let points = v
                .iter()
                .enumerate()
                .map(|(i, &y)| ((first + i as u64) as f64 / rate_hz, y))
                .collect();
            Some((name.to_string(), points))
        })
        .collect();
    TracePlot {
        title: title.into(),
        x_label: "time [s]".into(),
        y_label: format!("{label} [{}]", channel.unit()),
        series,
    }
}
