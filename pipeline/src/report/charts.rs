//! The three kinds of plots.

use anyhow::Result;
use plotters::style::RGBColor;
use plotters::style::text_anchor::HPos;

use super::canvas::{Canvas, Entry, Mark, Plot, SMALL, Setup, render, text_width};
use super::scale::{
    Pt, clip_line, clip_polygon, decimate, fixed, pad, places, simplify, span, spread, tolerance, usable, widen,
};
use super::theme::{AREA, BAND, BAND_TEXT, ESTIMATE, FRAME, INK, REGIONS, SERIES, TRUTH, WHITE, sequential};
use super::{Band, Figure, MapPlot, RegionPlot, Strip, TracePlot, sketch};

const WIDE: (u32, u32) = (720, 460);
const NARROW: (u32, u32) = (560, 460);

/// Bytes which the lines of one trace plot may take, with room for the rest of the document.
const TRACE_BYTES: usize = 110_000;

/// Draws a figure as an SVG element, with its title when it stands alone.
pub(super) fn draw(figure: &Figure, titled: bool) -> Result<String> {
    match figure {
        Figure::Map(plot) => render(WIDE, &plot.title, titled, |canvas| map(canvas, plot, titled)),
        Figure::Region(plot) => render(NARROW, &plot.title, titled, |canvas| region(canvas, plot, titled)),
        Figure::Trace(plot) => render(WIDE, &plot.title, titled, |canvas| trace(canvas, plot, titled)),
        Figure::Gap { title } => render(sketch::SIZE, title, titled, |canvas| {
            sketch::gap(canvas, titled.then_some(title))
        }),
    }
}

fn extent(size: (u32, u32)) -> (f64, f64) {
    (f64::from(size.0), f64::from(size.1))
}

fn map(canvas: &Canvas, map: &MapPlot, titled: bool) -> Result<()> {
    let every = || {
        map.curves
            .iter()
            .flat_map(|c| &c.points)
            .chain(&map.knots)
            .filter(|p| usable(p.0) && usable(p.1))
    };
    let data = span(every().map(|p| p.0)).zip(span(every().map(|p| p.1)));
    let (x, mut y) = data.unwrap_or(((1.0, 5.0), (0.0, 1.0)));
    if let Some(band) = map.band.as_ref().filter(|band| usable(band.value)) {
        // The band may widen the plot, but a far or very high one must not flatten the curves.
        let (lo, hi) = pad(widen(y), 0.3);
        let half = if usable(band.half_width) {
            band.half_width.abs()
        } else {
            0.0
        };
        y.0 = y.0.min((band.value - half).max(lo));
        y.1 = y.1.max((band.value + half).min(hi));
    }
    let unit = map.unit.trim();
    let y_label = if unit.is_empty() {
        map.name.clone()
    } else {
        format!("{} [{unit}]", map.name)
    };
    let plot = Plot::new(
        canvas,
        Setup {
            size: extent(WIDE),
            title: titled.then_some(map.title.as_str()),
            entries: marks(map.truth, map.estimate),
            x_label: "Friction factor FSJ [-]",
            y_label: &y_label,
            x: widen(x),
            y: pad(widen(y), 0.05),
            right: 68.0,
        },
    )?;
    if data.is_none() {
        plot.empty(canvas)?;
        return plot.frame(canvas);
    }

    let range = plot.range();
    let zetas = span(map.curves.iter().map(|c| c.zeta)).map_or((0.0, 1.0), widen);
    let color = |zeta: f64| sequential((zeta - zetas.0) / (zetas.1 - zetas.0));
    let band = map.band.as_ref().filter(|b| usable(b.value) && usable(b.half_width));
    let cut = band.map(|b| (b.value - b.half_width.abs(), b.value + b.half_width.abs()));
    if let Some((lo, hi)) = cut {
        let (top, bottom) = (
            plot.at((range.0.0, hi)).1.max(plot.top),
            plot.at((range.0.0, lo)).1.min(plot.bottom),
        );
        if top < bottom {
            canvas.rect(((plot.left, plot.right), (top, bottom)), BAND, 0.16)?;
        }
    }
    let mut drawn: Vec<Pt> = Vec::new();
    for curve in &map.curves {
        for part in clip_line(&curve.points, range) {
            let path = plot.path(&part);
            canvas.line(&simplify(&path, 0.12), color(curve.zeta), 1.0, 1.5)?;
            drawn.extend(path);
        }
        // The part which the band cuts out is what the diagnosis uses.
        if let Some((lo, hi)) = cut {
            for part in clip_line(&curve.points, (range.0, (lo.max(range.1.0), hi.min(range.1.1)))) {
                canvas.line(&simplify(&plot.path(&part), 0.12), color(curve.zeta), 1.0, 3.25)?;
            }
        }
    }
    for knot in map.knots.iter().filter(|p| usable(p.0) && usable(p.1)) {
        canvas.disc(plot.at(*knot), 1.5, INK, 0.75)?;
    }
    if let Some(band) = band {
        mark_band(canvas, &plot, map, band, &drawn)?;
    }
    plot.frame(canvas)?;
    if let Some(p) = map.truth.filter(|p| usable(p.0) && usable(p.1)) {
        canvas.triangle(plot.at(p), 9.0, TRUTH)?;
    }
    if let Some(p) = map.estimate.filter(|p| usable(p.0) && usable(p.1)) {
        canvas.dot(plot.at(p), 4.5, ESTIMATE)?;
    }
    label_curves(canvas, &plot, map, &color)
}

/// What the marks of a map mean.
fn marks(truth: Option<Pt>, estimate: Option<Pt>) -> Vec<Entry> {
    let entry = |mark, color, label: &str| Entry {
        mark,
        color,
        label: label.into(),
    };
    let truth = truth.map(|_| entry(Mark::Triangle, TRUTH, "true fault"));
    let estimate = estimate.map(|_| entry(Mark::Dot, ESTIMATE, "estimate"));
    truth.into_iter().chain(estimate).collect()
}

/// Draws the line of P* and its label, placed where it hides least of the curves.
fn mark_band(canvas: &Canvas, plot: &Plot, map: &MapPlot, band: &Band, drawn: &[Pt]) -> Result<()> {
    let y = plot.at((plot.x.lo, band.value)).1;
    if (plot.top..=plot.bottom).contains(&y) {
        canvas.line(&[(plot.left, y), (plot.right, y)], BAND, 1.0, 1.25)?;
    }
    let half = band.half_width.abs();
    let unit = if map.unit.trim() == "-" { "" } else { map.unit.trim() };
    let text = format!("{}* = {} {unit}", map.name, tolerance(band.value, half));
    let text = text.trim_end();
    let width = 0.93 * text_width(text, SMALL) + 10.0;
    let above = plot.at((plot.x.lo, band.value + half)).1 - 11.0;
    let below = plot.at((plot.x.lo, band.value - half)).1 + 11.0;
    let inside = |y: f64| y.clamp(plot.top + 11.0, plot.bottom - 11.0);
    let room = (plot.right - plot.left - width - 12.0).max(0.0);
    let mut best: Option<(f64, Pt)> = None;
    for y in [inside(above), inside(below), inside(y)] {
        for step in 0..=8 {
            let x = plot.left + 6.0 + room * f64::from(step) / 8.0;
            let hidden = drawn
                .iter()
                .filter(|p| (p.0 - x) > -4.0 && p.0 < x + width + 4.0 && (p.1 - y).abs() < 9.0)
                .count();
            if best.is_none_or(|(least, _)| (hidden as f64) < least) {
                best = Some((hidden as f64, (x, y)));
            }
        }
    }
    if let Some((_, (x, y))) = best {
        canvas.rect(((x, x + width), (y - 7.5, y + 7.5)), WHITE, 0.85)?;
        canvas.text(text, (x + width / 2.0, y), SMALL, BAND_TEXT, HPos::Center)?;
    }
    Ok(())
}

/// Writes zeta at the right end of the curves, moved apart where the ends are close.
fn label_curves(canvas: &Canvas, plot: &Plot, map: &MapPlot, color: &dyn Fn(f64) -> RGBColor) -> Result<()> {
    const GAP: f64 = 14.0;
    let mut ends: Vec<(f64, Pt)> = Vec::new();
    for curve in map.curves.iter().filter(|c| usable(c.zeta)) {
        if let Some(end) = clip_line(&curve.points, plot.range())
            .last()
            .and_then(|part| part.last())
        {
            ends.push((curve.zeta, plot.at(*end)));
        }
    }
    if ends.is_empty() {
        return Ok(());
    }
    let zetas: Vec<f64> = ends.iter().map(|e| e.0).collect();
    let decimals = places(&zetas).clamp(1, 4);
    ends.sort_by(|a, b| a.1.1.total_cmp(&b.1.1));
    // With too many curves only every n-th gets a label, counted from the last one.
    let most = (((plot.bottom - plot.top) / GAP) as usize).clamp(1, 16);
    let stride = ends.len().div_ceil(most);
    let last = ends.len() - 1;
    let shown: Vec<_> = ends
        .into_iter()
        .enumerate()
        .filter(|(i, _)| (last - i).is_multiple_of(stride))
        .map(|(_, e)| e)
        .collect();
    let wanted: Vec<f64> = shown.iter().map(|e| e.1.1).collect();
    let heights = spread(&wanted, GAP, ((plot.top + 4.0).max(26.0), plot.bottom - 2.0));
    for ((zeta, end), y) in shown.iter().zip(&heights) {
        let x = plot.right;
        canvas.line(
            &[(end.0 + 1.0, end.1), (x + 4.0, end.1), (x + 14.0, *y), (x + 17.0, *y)],
            color(*zeta),
            0.7,
            0.75,
        )?;
        canvas.text(&fixed(*zeta, decimals), (x + 20.0, *y), SMALL, color(*zeta), HPos::Left)?;
    }
    let header = heights.first().map_or(plot.top, |y| y - 16.5);
    canvas.text("\u{3b6} [-]", (plot.right + 20.0, header), SMALL, INK, HPos::Left)
}

fn region(canvas: &Canvas, map: &RegionPlot, titled: bool) -> Result<()> {
    let range = (widen(map.fsj_range), widen(map.zeta_range));
    let ((x0, x1), (y0, y1)) = range;
    let visible = |p: Pt| (x0..=x1).contains(&p.0) && (y0..=y1).contains(&p.1);
    let named = |name: &str, p: Pt| {
        let hint = if visible(p) { "" } else { ", outside" };
        // as many digits as the interval warrants, and not more than a legend has room for
        let digits = map.hull.map_or((2, 3), |((fa, fb), (za, zb))| {
            (decimals(fb - fa, 3), decimals(zb - za, 4))
        });
        format!("{name} ({}, {}){hint}", fixed(p.0, digits.0), fixed(p.1, digits.1))
    };
    let entry = |mark, color, label: String| Entry { mark, color, label };
    let paint = |i: usize| REGIONS[i % REGIONS.len()];
    let mut entries: Vec<Entry> = map
        .regions
        .iter()
        .enumerate()
        .map(|(i, (name, _))| entry(Mark::Patch, paint(i), name.clone()))
        .collect();
    // several diagnoses in one plane have no area that is drawn
    if map.estimate.len() < 2 {
        let area_label = if map.area.is_empty() {
            "located area (empty)"
        } else {
            "located area"
        };
        entries.push(entry(Mark::Area, AREA, area_label.to_owned()));
    }
    if map.hull.is_some() {
        entries.push(entry(Mark::Dash, INK, "bounding box".to_owned()));
    }
    for (mark, color, name, at) in [
        (Mark::Triangle, TRUTH, "true fault", &map.truth),
        (Mark::Dot, ESTIMATE, "estimate", &map.estimate),
    ] {
        match at.as_slice() {
            [] => {}
            [p] => entries.push(entry(mark, color, named(name, *p))),
            _ => entries.push(entry(mark, color, format!("{name}s"))),
        }
    }
    let plot = Plot::new(
        canvas,
        Setup {
            size: extent(NARROW),
            title: titled.then_some(map.title.as_str()),
            entries,
            x_label: "Friction factor FSJ [-]",
            y_label: "Static eccentricity \u{3b6} [-]",
            x: range.0,
            y: range.1,
            right: 20.0,
        },
    )?;

    let range = plot.range();
    let lists = || map.regions.iter().map(|r| r.1.as_slice()).chain([map.area.as_slice()]);
    let common = lists().filter_map(spacing).fold(f64::INFINITY, f64::min);
    let common = if common.is_finite() { common } else { (y1 - y0) * 0.01 };
    let outline = |strips: &[Strip]| -> Vec<Vec<Pt>> {
        let clipped = polygons(strips, common).into_iter().map(|p| clip_polygon(&p, range));
        clipped
            .filter(|p| p.len() > 2)
            .map(|p| simplify(&plot.path(&p), 0.12))
            .collect()
    };
    let closed = |mut path: Vec<Pt>| {
        path.extend(path.first().copied());
        path
    };
    for (i, (_, strips)) in map.regions.iter().enumerate() {
        for path in outline(strips) {
            canvas.fill(&path, paint(i), 0.26)?;
        }
    }
    for (i, (_, strips)) in map.regions.iter().enumerate() {
        for path in outline(strips) {
            canvas.line(&closed(path), paint(i), 0.9, 1.0)?;
        }
    }
    for path in outline(&map.area) {
        canvas.fill(&path, AREA, 0.72)?;
        canvas.line(&closed(path), AREA, 1.0, 1.75)?;
    }
    if let Some(((fa, fb), (za, zb))) = map.hull {
        for side in [
            [(fa, za), (fb, za)],
            [(fa, zb), (fb, zb)],
            [(fa, za), (fa, zb)],
            [(fb, za), (fb, zb)],
        ] {
            for part in clip_line(&side, range) {
                canvas.dashes(plot.at(part[0]), plot.at(part[1]), INK, 1.25)?;
            }
        }
    }
    plot.frame(canvas)?;
    // a small area is found by the lines from it to the axes
    if let ([p], Some(((fa, fb), (za, zb)))) = (map.estimate.as_slice(), map.hull)
        && visible(*p)
        && fb - fa < 0.1 * (x1 - x0)
        && zb - za < 0.1 * (y1 - y0)
    {
        canvas.dashes(plot.at((p.0, y0)), plot.at(*p), ESTIMATE, 1.0)?;
        canvas.dashes(plot.at((x0, p.1)), plot.at(*p), ESTIMATE, 1.0)?;
    }
    for (p, text) in map.notes.iter().filter(|n| visible(n.0)) {
        let (x, y) = plot.at(*p);
        canvas.disc((x, y), 2.0, INK, 1.0)?;
        let wide = text_width(text, SMALL);
        let (x, anchor) = if x + 12.0 + wide > plot.right {
            (x - 10.0, HPos::Right)
        } else {
            (x + 10.0, HPos::Left)
        };
        canvas.text(text, (x, (y - 11.0).max(plot.top + 10.0)), SMALL, INK, anchor)?;
    }
    for p in map.truth.iter().filter(|p| visible(**p)) {
        canvas.triangle(plot.at(*p), 9.0, TRUTH)?;
    }
    for p in map.estimate.iter().filter(|p| visible(**p)) {
        canvas.dot(plot.at(*p), 4.5, ESTIMATE)?;
    }
    Ok(())
}

/// Decimal places for two digits of half an interval, at most `most`.
fn decimals(width: f64, most: usize) -> usize {
    crate::digits::places(0.5 * width).min(most)
}

/// Smallest distance between neighbouring eccentricities of a region.
fn spacing(strips: &[Strip]) -> Option<f64> {
    let mut zetas: Vec<f64> = strips.iter().map(|s| s.zeta).filter(|z| usable(*z)).collect();
    zetas.sort_by(f64::total_cmp);
    zetas
        .windows(2)
        .map(|w| w[1] - w[0])
        .filter(|d| *d > 1e-9)
        .reduce(f64::min)
}

/// Joins the strips of neighbouring eccentricities to closed outlines (FSJ, zeta).
///
/// A missing eccentricity starts a new outline; a strip without neighbours gets half a spacing of height each way.
pub(super) fn polygons(strips: &[Strip], common: f64) -> Vec<Vec<Pt>> {
    let good = |s: &&Strip| [s.zeta, s.fsj_lo, s.fsj_hi].into_iter().all(usable) && s.fsj_lo <= s.fsj_hi;
    let mut sorted: Vec<&Strip> = strips.iter().filter(good).collect();
    sorted.sort_by(|a, b| a.zeta.total_cmp(&b.zeta).then(a.fsj_lo.total_cmp(&b.fsj_lo)));
    // With two strips only, their own distance says nothing about a gap between them.
    let step = if sorted.len() > 2 {
        spacing(strips).unwrap_or(common)
    } else {
        common
    };
    let layers: Vec<&[&Strip]> = sorted.chunk_by(|a, b| b.zeta - a.zeta <= 1e-9).collect();

    let mut done: Vec<Vec<&Strip>> = Vec::new();
    let mut open: Vec<Vec<&Strip>> = Vec::new();
    for (i, layer) in layers.iter().enumerate() {
        if i > 0 && layer[0].zeta - layers[i - 1][0].zeta > 1.6 * step {
            done.append(&mut open);
        }
        let one_to_one = open.len() == layer.len();
        let mut next: Vec<Vec<&Strip>> = Vec::new();
        for strip in *layer {
            let found = if one_to_one {
                Some(0)
            } else {
                open.iter().position(|chain| {
                    chain
                        .last()
                        .is_some_and(|last| last.fsj_lo <= strip.fsj_hi && strip.fsj_lo <= last.fsj_hi)
                })
            };
            let mut chain = found.map(|index| open.remove(index)).unwrap_or_default();
            chain.push(strip);
            next.push(chain);
        }
        done.append(&mut open);
        open = next;
    }
    done.append(&mut open);

    let outline = |chain: Vec<&Strip>| -> Vec<Pt> {
        if let [only] = chain.as_slice() {
            let (lo, hi) = (only.zeta - step / 2.0, only.zeta + step / 2.0);
            return vec![
                (only.fsj_lo, lo),
                (only.fsj_hi, lo),
                (only.fsj_hi, hi),
                (only.fsj_lo, hi),
            ];
        }
        let right = chain.iter().map(|s| (s.fsj_hi, s.zeta));
        let left = chain.iter().rev().map(|s| (s.fsj_lo, s.zeta));
        right.chain(left).collect()
    };
    done.into_iter().map(outline).collect()
}

fn trace(canvas: &Canvas, trace: &TracePlot, titled: bool) -> Result<()> {
    let every = || {
        trace
            .series
            .iter()
            .flat_map(|s| &s.1)
            .filter(|p| usable(p.0) && usable(p.1))
    };
    let data = span(every().map(|p| p.0)).zip(span(every().map(|p| p.1)));
    let (x, y) = data.unwrap_or(((0.0, 1.0), (0.0, 1.0)));
    let color = |i: usize| SERIES[i % SERIES.len()];
    let named = trace
        .series
        .iter()
        .enumerate()
        .filter(|(_, (name, _))| !name.trim().is_empty());
    let plot = Plot::new(
        canvas,
        Setup {
            size: extent(WIDE),
            title: titled.then_some(trace.title.as_str()),
            entries: named
                .map(|(i, s)| Entry {
                    mark: Mark::Line,
                    color: color(i),
                    label: s.0.clone(),
                })
                .collect(),
            x_label: &trace.x_label,
            y_label: &trace.y_label,
            x: widen(x),
            y: pad(widen(y), 0.05),
            right: 24.0,
        },
    )?;
    if data.is_none() {
        plot.empty(canvas)?;
        return plot.frame(canvas);
    }
    if plot.y.lo < 0.0 && plot.y.hi > 0.0 {
        canvas.line(&[plot.at((plot.x.lo, 0.0)), plot.at((plot.x.hi, 0.0))], FRAME, 0.7, 1.0)?;
    }
    // Two points of about ten bytes each per column and series.
    let columns = (plot.right - plot.left) as usize;
    let columns = columns.min(TRACE_BYTES / (20 * trace.series.len().max(1))).max(20);
    for (i, (_, points)) in trace.series.iter().enumerate() {
        for part in decimate(points, (plot.x.lo, plot.x.hi), columns) {
            let path = plot.path(&part);
            match path.as_slice() {
                [single] => canvas.disc(*single, 1.25, color(i), 1.0)?,
                _ => canvas.line(&simplify(&path, 0.1), color(i), 0.92, 1.1)?,
            }
        }
    }
    plot.frame(canvas)
}
