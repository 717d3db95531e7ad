//! Numbers and geometry behind the plots: ranges, ticks, number formats, clipping, thinning.

pub(super) type Pt = (f64, f64);

/// A rectangle given by its x range and its y range.
pub(super) type Rect = (Pt, Pt);

/// Whether a value can be drawn; NaN, infinities and absurd magnitudes cannot.
pub(super) fn usable(v: f64) -> bool {
    v.abs() < 1e150
}

/// Smallest and largest usable value.
pub(super) fn span(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.filter(|v| usable(*v)).fold(None, |acc, v| match acc {
        None => Some((v, v)),
        Some((lo, hi)) => Some((lo.min(v), hi.max(v))),
    })
}

/// Makes a range drawable: ordered, finite and wide enough for ticks to differ.
pub(super) fn widen(range: Pt) -> Pt {
    let (a, b) = range;
    if !usable(a) || !usable(b) {
        return (0.0, 1.0);
    }
    let (lo, hi) = (a.min(b), a.max(b));
    let size = lo.abs().max(hi.abs());
    if size > 1e-150 && hi - lo > size * 1e-9 {
        (lo, hi)
    } else if size < 1e-150 {
        (0.0, 1.0)
    } else {
        (lo - 0.1 * size, hi + 0.1 * size)
    }
}

/// Adds a margin on both sides of a range.
pub(super) fn pad((lo, hi): Pt, share: f64) -> Pt {
    let margin = (hi - lo) * share;
    (lo - margin, hi + margin)
}

/// Tick positions of an axis and how they are written.
pub(super) struct Axis {
    pub lo: f64,
    pub hi: f64,
    pub ticks: Vec<(f64, String)>,
    /// Power of ten, a multiple of three, by which the tick labels must be multiplied.
    pub exponent: i32,
}

impl Axis {
    pub(super) fn new(range: Pt, target: f64) -> Self {
        let (lo, hi) = widen(range);
        let raw = (hi - lo) / target.max(2.0);
        let decade = 10f64.powf(raw.log10().floor());
        let nice = [1.0, 2.0, 2.5, 5.0, 10.0];
        let step = decade * nice.into_iter().find(|n| n * decade >= raw * 0.999).unwrap_or(10.0);
        // An end which just misses a tick, as the last sample of a record does, moves to it.
        let snap = |end: f64| {
            let tick = (end / step).round() * step;
            if (tick - end).abs() < 2e-3 * (hi - lo) {
                tick
            } else {
                end
            }
        };
        let (lo, hi) = (lo.min(snap(lo)), hi.max(snap(hi)));
        let exponent = engineering(lo.abs().max(hi.abs()), 2e-3);
        let unit = 10f64.powi(exponent);
        let places = places(&[step / unit]);
        let first = (lo / step - 1e-6).ceil();
        let ticks = (0..40)
            .map(|i| (first + f64::from(i)) * step)
            .take_while(|v| *v <= hi + 1e-6 * step)
            .map(|v| (v, fixed(v / unit, places)))
            .collect();
        Self {
            lo,
            hi,
            ticks,
            exponent,
        }
    }
}

/// Engineering exponent of a magnitude: 0 for ordinary numbers, else a multiple of three.
fn engineering(magnitude: f64, small: f64) -> i32 {
    if magnitude == 0.0 || (small..1e5).contains(&magnitude) {
        0
    } else {
        3 * ((magnitude.log10() + 1e-9) / 3.0).floor() as i32
    }
}

/// Fewest decimal places which write all values exactly, at most eight.
pub(super) fn places(values: &[f64]) -> usize {
    (0..8)
        .find(|p| {
            let scale = 10f64.powi(*p);
            values
                .iter()
                .all(|v| (v * scale - (v * scale).round()).abs() < 1e-4 * (v * scale).abs().clamp(1e-3, 1.0))
        })
        .unwrap_or(8) as usize
}

/// A number with fixed decimal places, a real minus sign and no negative zero.
pub(super) fn fixed(v: f64, places: usize) -> String {
    if !v.is_finite() {
        return "\u{2013}".to_owned();
    }
    let text = format!("{v:.places$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.to_owned(),
        Some(rest) => format!("\u{2212}{rest}"),
        None => text,
    }
}

/// "×10⁻⁶" for an exponent.
pub(super) fn power(exponent: i32) -> String {
    let digits = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let mut text = String::from("\u{d7}10");
    for c in exponent.to_string().chars() {
        text.push(c.to_digit(10).map_or('⁻', |d| digits[d as usize]));
    }
    text
}

/// Decimal places which show `digits` significant digits of a value.
fn places_for(v: f64, digits: i32) -> usize {
    if v == 0.0 {
        0
    } else {
        (digits - 1 - (v.abs().log10() + 1e-12).floor() as i32).clamp(0, 9) as usize
    }
}

/// A number with the given significant digits; very small and very large ones get an engineering exponent.
pub(super) fn number(v: f64, digits: i32) -> String {
    if !v.is_finite() {
        return "\u{2013}".to_owned();
    }
    let exponent = engineering(v.abs(), 1e-3);
    let scaled = v / 10f64.powi(exponent);
    let text = fixed(scaled, places_for(scaled, digits));
    if exponent == 0 {
        text
    } else {
        format!("{text}{}", power(exponent))
    }
}

/// A value with its tolerance, both with the same decimal places.
pub(super) fn tolerance(v: f64, half: f64) -> String {
    if !v.is_finite() || !half.is_finite() || half <= 0.0 || half < v.abs() * 1e-6 {
        return number(v, 4);
    }
    let exponent = engineering(v.abs().max(half), 1e-3);
    let unit = 10f64.powi(exponent);
    let places = places_for(half / unit, 2);
    let text = format!("{} \u{b1} {}", fixed(v / unit, places), fixed(half / unit, places));
    if exponent == 0 {
        text
    } else {
        format!("({text}){}", power(exponent))
    }
}

/// The parts of a line inside a rectangle; unusable points break the line.
pub(super) fn clip_line(points: &[Pt], rect: Rect) -> Vec<Vec<Pt>> {
    let mut parts: Vec<Vec<Pt>> = Vec::new();
    let mut open = false;
    for pair in points.windows(2) {
        let Some((a, b)) = clip_segment(pair[0], pair[1], rect) else {
            open = false;
            continue;
        };
        match parts.last_mut() {
            Some(part) if open => part.push(b),
            _ => parts.push(vec![a, b]),
        }
        open = b == pair[1];
    }
    parts
}

fn clip_segment(a: Pt, b: Pt, ((x0, x1), (y0, y1)): Rect) -> Option<(Pt, Pt)> {
    if ![a.0, a.1, b.0, b.1].into_iter().all(usable) {
        return None;
    }
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for (p, q) in [(-dx, a.0 - x0), (dx, x1 - a.0), (-dy, a.1 - y0), (dy, y1 - a.1)] {
        if p == 0.0 {
            if q < 0.0 {
                return None;
            }
        } else if p < 0.0 {
            from = from.max(q / p);
        } else {
            to = to.min(q / p);
        }
    }
    if from > to {
        return None;
    }
    let at = |t: f64| (a.0 + t * dx, a.1 + t * dy);
    Some((
        if from == 0.0 { a } else { at(from) },
        if to == 1.0 { b } else { at(to) },
    ))
}

/// The part of a closed polygon inside a rectangle.
pub(super) fn clip_polygon(points: &[Pt], ((x0, x1), (y0, y1)): Rect) -> Vec<Pt> {
    // Signed distance to each side, positive inside.
    let sides: [&dyn Fn(Pt) -> f64; 4] = [&|p| p.0 - x0, &|p| x1 - p.0, &|p| p.1 - y0, &|p| y1 - p.1];
    let mut current: Vec<Pt> = points.iter().copied().filter(|p| usable(p.0) && usable(p.1)).collect();
    for side in sides {
        let mut next = Vec::with_capacity(current.len() + 4);
        for (i, b) in current.iter().copied().enumerate() {
            let a = current[(i + current.len() - 1) % current.len()];
            let (da, db) = (side(a), side(b));
            if (da >= 0.0) != (db >= 0.0) {
                let t = da / (da - db);
                next.push((a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1)));
            }
            if db >= 0.0 {
                next.push(b);
            }
        }
        current = next;
    }
    current
}

/// Drops points which lie closer than `tolerance` to the line through their kept neighbours.
pub(super) fn simplify(points: &[Pt], tolerance: f64) -> Vec<Pt> {
    if points.len() < 3 {
        return points.to_vec();
    }
    let mut keep = vec![false; points.len()];
    keep[0] = true;
    keep[points.len() - 1] = true;
    let mut work = vec![(0, points.len() - 1)];
    while let Some((first, last)) = work.pop() {
        let (a, b) = (points[first], points[last]);
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        let length = dx.hypot(dy);
        let distance = |p: Pt| {
            if length > 0.0 {
                ((p.0 - a.0) * dy - (p.1 - a.1) * dx).abs() / length
            } else {
                (p.0 - a.0).hypot(p.1 - a.1)
            }
        };
        let far = (first + 1..last)
            .map(|i| (i, distance(points[i])))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|f| f.1 > tolerance);
        if let Some((middle, _)) = far {
            keep[middle] = true;
            work.push((first, middle));
            work.push((middle, last));
        }
    }
    points
        .iter()
        .zip(keep)
        .filter_map(|(p, keep)| keep.then_some(*p))
        .collect()
}

/// Reduces a long series to the extreme values per pixel column; unusable points break the line.
///
/// A gap shorter than one column is invisible and is closed.
pub(super) fn decimate(points: &[Pt], (lo, hi): Pt, columns: usize) -> Vec<Vec<Pt>> {
    let columns = columns.max(1);
    let good = |p: &Pt| usable(p.0) && usable(p.1);
    let short = points.len() <= 2 * columns;
    let sorted = {
        let mut previous = f64::NEG_INFINITY;
        points.iter().filter(|p| good(p)).all(|p| {
            let ordered = p.0 >= previous;
            previous = p.0;
            ordered
        })
    };
    // Columns follow x where x runs forward, otherwise (loops) they follow the index.
    let column = |i: usize| -> usize {
        if short {
            i
        } else if sorted {
            (((points[i].0 - lo) / (hi - lo)).clamp(0.0, 1.0) * columns as f64) as usize
        } else {
            i * columns / points.len()
        }
    };

    let mut parts: Vec<Vec<Pt>> = vec![Vec::new()];
    let mut bucket: Vec<usize> = Vec::new();
    let mut current = usize::MAX;
    let mut gap = false;
    let flush = |bucket: &mut Vec<usize>, parts: &mut Vec<Vec<Pt>>| {
        let by_y = |a: &&usize, b: &&usize| points[**a].1.total_cmp(&points[**b].1);
        let by_x = |a: &&usize, b: &&usize| points[**a].0.total_cmp(&points[**b].0);
        let mut keep: Vec<usize> = bucket
            .iter()
            .min_by(by_y)
            .into_iter()
            .chain(bucket.iter().max_by(by_y))
            .copied()
            .collect();
        if !sorted {
            keep.extend(bucket.iter().min_by(by_x).into_iter().chain(bucket.iter().max_by(by_x)));
        }
        keep.sort_unstable();
        keep.dedup();
        if let Some(part) = parts.last_mut() {
            part.extend(keep.into_iter().map(|i| points[i]));
        }
        bucket.clear();
    };
    for (i, p) in points.iter().enumerate() {
        if !good(p) {
            gap = true;
            continue;
        }
        let here = column(i);
        if here != current {
            flush(&mut bucket, &mut parts);
            if gap && current != usize::MAX {
                parts.push(Vec::new());
            }
            current = here;
        }
        gap = false;
        bucket.push(i);
    }
    flush(&mut bucket, &mut parts);
    parts.retain(|part| !part.is_empty());
    parts
}

/// Moves labels apart until neighbours are at least `gap` apart, inside `lo..hi`; `wanted` must ascend.
pub(super) fn spread(wanted: &[f64], gap: f64, (lo, hi): Pt) -> Vec<f64> {
    // Each group is (sum of wanted positions of its first label, number of labels).
    let mut groups: Vec<(f64, usize)> = Vec::new();
    let start = |group: &(f64, usize)| {
        let height = (group.1 - 1) as f64 * gap;
        (group.0 / group.1 as f64).min(hi - height).max(lo)
    };
    for w in wanted {
        groups.push((*w, 1));
        while let [.., a, b] = groups.as_slice() {
            if start(a) + a.1 as f64 * gap <= start(b) {
                break;
            }
            let merged = (a.0 + b.0 - (a.1 * b.1) as f64 * gap, a.1 + b.1);
            groups.truncate(groups.len() - 2);
            groups.push(merged);
        }
    }
    groups
        .iter()
        .flat_map(|group| (0..group.1).map(|i| start(group) + i as f64 * gap).collect::<Vec<_>>())
        .collect()
}
