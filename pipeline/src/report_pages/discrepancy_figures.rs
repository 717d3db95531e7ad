//! Tables and figures of the gap for the discrepancy report, and how its numbers are written.

pub(super) use crate::report::escape;
use crate::report::{Figure, Table, TableRow, TracePlot};
use ema_study::told::findings::{ChannelGap, Findings, GapLine, Identified, Profile, Trace};
use ema_study::told::verify::{DrivenTrace, Verification};
use std::fmt::Write as _;

/// What stands for a number that there is not.
pub(super) const NOTHING: &str = "\u{2013}";

/// Power of ten of the first digit.
fn decade(v: f64) -> i32 {
    (v.abs().log10() + 1e-12).floor() as i32
}

fn power(exponent: i32) -> String {
    let digits = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let raised = exponent.to_string();
    let raised = raised
        .chars()
        .map(|c| c.to_digit(10).map_or('⁻', |d| digits[d as usize]));
    format!("10{}", raised.collect::<String>())
}

/// Fixed decimal places, a real minus sign, no negative zero, and groups of three from 10 000 on.
fn fixed(v: f64, places: usize) -> String {
    if v.is_nan() {
        return NOTHING.into();
    }
    let text = if v.is_infinite() {
        "\u{221e}".into()
    } else {
        format!("{:.places$}", v.abs())
    };
    let (whole, rest) = text.split_at(text.find('.').unwrap_or(text.len()));
    let n = whole.chars().count();
    let mut out = String::new();
    if v < 0.0 && text.chars().any(|c| !matches!(c, '0' | '.')) {
        out.push('\u{2212}');
    }
    for (i, c) in whole.chars().enumerate() {
        if n > 4 && i > 0 && (n - i).is_multiple_of(3) {
            out.push('\u{202f}');
        }
        out.push(c);
    }
    out + rest
}

/// A number with the given significant digits, and an exponent where it is very small or very large.
pub(super) fn number(v: f64, digits: i32) -> String {
    if v == 0.0 || !v.is_finite() {
        return fixed(v, 0);
    }
    let d = decade(v);
    if !(-3..7).contains(&d) {
        let exponent = d.div_euclid(3) * 3;
        return format!("{}\u{d7}{}", number(v / 10f64.powi(exponent), digits), power(exponent));
    }
    let unit = 10f64.powi(d + 1 - digits);
    fixed((v / unit).round() * unit, (digits - 1 - d).max(0) as usize)
}

/// A share as percentage.
pub(super) fn share(v: f64) -> String {
    match v {
        v if !v.is_finite() => NOTHING.into(),
        v if v != 0.0 && v.abs() < 1e-3 => "< 0.1 %".into(),
        v => format!("{} %", fixed(100.0 * v, usize::from(v.abs() < 0.0995))),
    }
}

/// Change against a number, as percentage with sign.
pub(super) fn change(v: f64, from: f64) -> String {
    let c = 100.0 * (v / from - 1.0);
    if !c.is_finite() {
        return NOTHING.into();
    }
    let places = usize::from(c.abs() < 99.5) + usize::from(c.abs() < 0.995);
    let text = fixed(c, places);
    if c > 0.0 {
        format!("+{text} %")
    } else {
        format!("{text} %")
    }
}

pub(super) fn ratio(v: f64, floor: f64) -> String {
    if floor > 0.0 {
        number(v / floor, 3)
    } else {
        NOTHING.into()
    }
}

/// The unit as it is printed.
fn printed(unit: &str) -> String {
    let mut out = String::new();
    for c in unit
        .trim()
        .replace("Nm", "N m")
        .replace("ohm", "\u{3a9}")
        .replace("degC", "\u{b0}C")
        .chars()
    {
        let raised = out.ends_with(char::is_alphabetic);
        match c {
            '^' => {}
            '2' if raised => out.push('\u{b2}'),
            '3' if raised => out.push('\u{b3}'),
            c => out.push(c),
        }
    }
    if out.is_empty() { "-".into() } else { out }
}

/// A label of an axis: name and unit.
pub(super) fn label(name: &str, unit: &str) -> String {
    format!("{name} [{}]", printed(unit))
}

/// The power of ten that numbers shown together share, in their unit.
pub(super) struct Scale {
    factor: f64,
    pub unit: String,
}

impl Scale {
    pub(super) fn of(values: &[f64], unit: &str) -> Self {
        let unit = printed(unit);
        let base = unit.split([' ', '/']).next().unwrap_or_default();
        let large = matches!(base, "A" | "V" | "N" | "W" | "Hz" | "\u{3a9}");
        let small = large || matches!(base, "rad" | "m" | "s" | "H");
        let top = values
            .iter()
            .filter(|v| v.is_finite())
            .fold(0.0, |a: f64, v| a.max(v.abs()));
        let plain = if small { 0.1 } else { 1e-3 }..if large { 1e4 } else { 1e6 };
        if top == 0.0 || plain.contains(&top) {
            return Self { factor: 1.0, unit };
        }
        let exponent = decade(top).div_euclid(3) * 3;
        let prefix = match exponent {
            -9 if small => "n",
            -6 if small => "\u{b5}",
            -3 if small => "m",
            3 if large => "k",
            6 if large => "M",
            _ => "",
        };
        let unit = match (prefix, unit.as_str()) {
            ("", "-") => power(exponent),
            ("", u) => format!("{} {u}", power(exponent)),
            (p, u) => format!("{p}{u}"),
        };
        Self {
            factor: 10f64.powi(-exponent),
            unit,
        }
    }

    pub(super) fn show(&self, v: f64) -> String {
        number(v * self.factor, 3)
    }

    /// Decimal places for numbers with an interval: two digits of its width, of the numbers three to five.
    pub(super) fn places(&self, values: &[f64], (lo, hi): (f64, f64)) -> usize {
        let top = values
            .iter()
            .filter(|v| v.is_finite())
            .fold(0.0, |a: f64, v| a.max(v.abs()));
        if top == 0.0 {
            return 0;
        }
        let three = 2 - decade(top * self.factor);
        let width = (hi - lo).abs() * self.factor;
        let wanted = if width > 0.0 && width.is_finite() {
            1 - decade(width)
        } else {
            three + 1
        };
        wanted.clamp(three, three + 2).max(0) as usize
    }

    pub(super) fn fixed(&self, v: f64, places: usize) -> String {
        let v = v * self.factor;
        if v.is_finite() && v.abs() >= 1e5 {
            number(v, 3)
        } else {
            fixed(v, places)
        }
    }
}

pub(super) fn row(cells: Vec<String>, emphasis: bool) -> TableRow {
    TableRow { cells, emphasis }
}

pub(super) fn table(caption: &str, header: &[&str], rows: Vec<TableRow>, note: &str) -> Table {
    let header = header.iter().map(|h| h.to_string()).collect();
    Table {
        caption: caption.into(),
        header,
        rows,
        note: note.into(),
    }
}

/// The headline: the drive channel, one row for each model.
pub(super) fn headline(gap: &ChannelGap, added: bool) -> Table {
    let values = |g: &GapLine| [g.nominal, g.retuned, g.last, g.floor];
    let mut all = values(&gap.fit).to_vec();
    all.extend(gap.heldout.iter().flat_map(values));
    let scale = Scale::of(&all, &gap.unit);
    let shown = gap.heldout.as_ref().unwrap_or(&gap.fit);
    let rows = ["Nominal model", "Re-tuned only", "After the effect", "Noise floor"]
        .into_iter()
        .enumerate()
        .filter(|(i, _)| added || *i != 2)
        .map(|(i, name)| {
            let mut cells = vec![name.to_string()];
            for g in std::iter::once(&gap.fit).chain(&gap.heldout) {
                cells.extend([scale.show(values(g)[i]), ratio(values(g)[i], g.floor)]);
            }
            let against = if (1..3).contains(&i) {
                change(values(shown)[i], shown.nominal)
            } else {
                NOTHING.into()
            };
            cells.push(against);
            row(cells, i == if added { 2 } else { 1 })
        })
        .collect();
    let (fit, held) = (label("Fit runs", &scale.unit), label("Held-out runs", &scale.unit));
    let mut header = vec!["", fit.as_str(), "\u{f7} floor"];
    if gap.heldout.is_some() {
        header.extend([held.as_str(), "\u{f7} floor"]);
    }
    header.push("Against nominal");
    let note = if gap.heldout.is_some() {
        "Held-out runs had no part in the fit; the last column is theirs. \u{f7} floor: divided by the noise floor, \
         which is what measurement noise alone leaves."
    } else {
        "There are no held-out runs: these are the runs that were fitted, which flatters the models. In floors: \
         divided by the noise floor, which is what measurement noise alone leaves."
    };
    let caption = format!(
        "Gap of {} (drive channel): root mean square of measured \u{2212} predicted",
        gap.channel
    );
    table(&caption, &header, rows, note)
}

pub(super) fn by_channel(gaps: &[&ChannelGap], added: bool) -> Table {
    let mut rows = Vec::new();
    for gap in gaps {
        let lines = [("fit", Some(&gap.fit)), ("held\u{2011}out", gap.heldout.as_ref())];
        let lines: Vec<_> = lines.into_iter().filter_map(|(name, g)| Some((name, g?))).collect();
        let all: Vec<f64> = lines
            .iter()
            .flat_map(|(_, g)| [g.nominal, g.retuned, g.last, g.floor])
            .collect();
        let scale = Scale::of(&all, &gap.unit);
        for (i, (name, g)) in lines.into_iter().enumerate() {
            let told = |text: &str| if i == 0 { text.to_string() } else { String::new() };
            let mut cells = vec![told(&gap.channel), told(&gap.equation), name.into(), scale.unit.clone()];
            cells.extend([scale.show(g.nominal), scale.show(g.retuned)]);
            if added {
                cells.push(scale.show(g.last));
            }
            cells.extend([
                scale.show(g.floor),
                ratio(g.nominal, g.floor),
                ratio(g.retuned, g.floor),
            ]);
            if added {
                cells.push(ratio(g.last, g.floor));
            }
            rows.push(row(cells, false));
        }
    }
    let mut header = vec![
        "Channel",
        "Equation",
        "Runs",
        "Unit",
        "Nominal",
        "Re-tuned only",
        "After the effect",
    ];
    header.extend([
        "Noise floor",
        "Nominal \u{f7} floor",
        "Re-tuned \u{f7} floor",
        "After \u{f7} floor",
    ]);
    if !added {
        header.retain(|h| !h.starts_with("After"));
    }
    table(
        "By channel: root mean square of measured \u{2212} predicted",
        &header,
        rows,
        "",
    )
}

/// Nominal value, value, 95 % interval and unit, for a row of a table.
pub(super) fn interval(p: &Identified) -> Vec<String> {
    let mut all = vec![p.value];
    all.extend(p.nominal);
    // a value that may be zero is told in the measure of its interval
    if p.lo < 0.0 && p.hi > 0.0 {
        all.push(p.hi.min(-p.lo));
    }
    let scale = Scale::of(&all, &p.unit);
    let places = scale.places(&all, (p.lo, p.hi));
    let show = |v: f64| scale.fixed(v, places);
    let range = if p.lo.is_nan() || p.hi.is_nan() {
        NOTHING.to_string()
    } else {
        format!("{} to {}", show(p.lo), show(p.hi))
    };
    vec![
        p.nominal.map_or(NOTHING.into(), show),
        show(p.value),
        range,
        scale.unit.clone(),
    ]
}

/// The models that are shown, with the colours that the plots give to their second to fourth series.
const MODELS: [(&str, &str); 3] = [
    ("nominal", "#d55e00"),
    ("re-tuned only", "#00946e"),
    ("after the effect", "#aa5096"),
];

fn rows(g: &GapLine, added: bool) -> Vec<(&'static str, &'static str, f64)> {
    let values = [g.nominal, g.retuned, g.last];
    let models = if added { 3 } else { 2 };
    let mut out: Vec<_> = (0..models).map(|i| (MODELS[i].0, MODELS[i].1, values[i])).collect();
    out.push(("noise floor", "#9aa5b1", g.floor));
    out
}

/// The gap of each channel as bars, each channel on its own scale.
pub(super) fn bars(gaps: &[&ChannelGap], added: bool) -> String {
    const LEFT: f64 = 112.0;
    const LENGTH: f64 = 180.0;
    const ROW: f64 = 25.0;
    let mut out = String::from("<div class=\"bars\">\n");
    for gap in gaps {
        let g = gap.heldout.as_ref().unwrap_or(&gap.fit);
        let rows = rows(g, added);
        let values: Vec<f64> = rows.iter().map(|r| r.2).collect();
        let top = values
            .iter()
            .filter(|v| v.is_finite())
            .fold(0.0, |a: f64, v| a.max(v.abs()));
        let length = |v: f64| {
            if top > 0.0 && v.is_finite() {
                LENGTH * v.abs() / top
            } else {
                0.0
            }
        };
        let scale = Scale::of(&values, &gap.unit);
        let height = ROW * rows.len() as f64 + 8.0;
        let data = if gap.heldout.is_some() {
            "held-out runs"
        } else {
            "fit runs"
        };
        let _ = writeln!(
            out,
            "<figure><figcaption><b>{}</b>, {} equation, {data}</figcaption>\n<svg viewBox=\"0 0 520 {height}\" \
             role=\"img\" aria-label=\"gap of {}\" font-size=\"14\" fill=\"currentColor\">",
            escape(&gap.channel),
            escape(&gap.equation),
            escape(&gap.channel)
        );
        for (i, (name, colour, v)) in rows.iter().enumerate() {
            let y = 4.0 + ROW * i as f64;
            let middle = y + 0.5 * ROW + 4.5;
            let mut value = scale.show(*v);
            let _ = match scale.unit.as_str() {
                "-" => Ok(()),
                u if u.starts_with("10") => write!(value, "\u{d7}{u}"),
                u => write!(value, " {u}"),
            };
            if i + 1 < rows.len() && g.floor > 0.0 && v.is_finite() {
                let _ = write!(value, " = {} \u{d7} floor", ratio(*v, g.floor));
            }
            let _ = writeln!(
                out,
                "<text x=\"{}\" y=\"{middle}\" text-anchor=\"end\">{name}</text><rect x=\"{LEFT}\" y=\"{}\" \
                 width=\"{:.1}\" height=\"{}\" fill=\"{colour}\"/><text x=\"{:.1}\" y=\"{middle}\">{}</text>",
                LEFT - 8.0,
                y + 4.0,
                length(*v).max(1.0),
                ROW - 8.0,
                LEFT + length(*v) + 8.0,
                escape(value.trim())
            );
        }
        let (x, y) = (LEFT + length(g.floor), 4.0 + ROW * (rows.len() - 1) as f64);
        if g.floor > 0.0 {
            let _ = writeln!(
                out,
                "<line x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"4\" y2=\"{y}\" stroke=\"currentColor\" stroke-dasharray=\"3 3\"/>"
            );
        }
        out.push_str("</svg></figure>\n");
    }
    out + "</div>"
}

type Series = (String, Vec<(f64, f64)>);

fn series(name: &str, x: &[f64], y: impl Iterator<Item = f64>) -> Series {
    (name.into(), x.iter().copied().zip(y).collect())
}

/// A series that takes its colour and shows nothing.
fn skipped() -> Series {
    (String::new(), Vec::new())
}

/// The zero line, in the grey of the seventh series.
fn with_zero(mut all: Vec<Series>, x: &[f64]) -> Vec<Series> {
    all.resize_with(6, skipped);
    let finite = || x.iter().copied().filter(|v| v.is_finite());
    let (lo, hi) = (
        finite().fold(f64::INFINITY, f64::min),
        finite().fold(f64::NEG_INFINITY, f64::max),
    );
    if lo < hi {
        all.push((String::new(), vec![(lo, 0.0), (hi, 0.0)]));
    }
    all
}

fn usable(y: &[f64]) -> bool {
    y.iter().any(|v| v.is_finite())
}

fn models(t: &Trace, added: bool) -> Vec<(&'static str, &[f64])> {
    let all = [&t.nominal, &t.retuned, &t.last];
    (0..if added { 3 } else { 2 })
        .map(|i| (MODELS[i].0, all[i].as_slice()))
        .collect()
}

/// What was measured and predicted, and the residual, for each trace that has something to show.
pub(super) fn traces(f: &Findings) -> Vec<[(String, Figure); 2]> {
    let added = !f.effects.is_empty();
    let one = |(i, t): (usize, &Trace)| {
        let told = format!(
            "{}, run {}{}",
            t.channel,
            t.run,
            if t.heldout { " (held-out)" } else { " (fit)" }
        );
        let mut lines = vec![series("measured", &t.time_s, t.measured.iter().copied())];
        let mut residual = vec![skipped()];
        for (name, y) in models(t, added) {
            let name = if usable(y) { name } else { "" };
            lines.push(series(name, &t.time_s, y.iter().copied()));
            residual.push(series(name, &t.time_s, t.measured.iter().zip(y).map(|(m, y)| m - y)));
        }
        let plot = |title: String, y: String, series| {
            Figure::Trace(TracePlot {
                title,
                x_label: "time [s]".into(),
                y_label: y,
                series,
            })
        };
        [
            (
                format!("trace_{i}"),
                plot(told.clone(), label(&t.channel, &t.unit), lines),
            ),
            (
                format!("trace_{i}_residual"),
                plot(
                    format!("Residual of {told}: measured \u{2212} predicted"),
                    label("residual", &t.unit),
                    with_zero(residual, &t.time_s),
                ),
            ),
        ]
    };
    f.traces
        .iter()
        .filter(|t| !t.time_s.is_empty() && usable(&t.measured))
        .enumerate()
        .map(one)
        .collect()
}

/// The actuator under the recorded command: before and after, by channel.
pub(super) fn simulated(v: &Verification) -> Table {
    let rows = v.channels.iter().map(|c| {
        let simple = c.simplified.map(|(a, b)| [a, b]);
        let all: Vec<f64> = [c.parent, c.child]
            .into_iter()
            .chain(simple.into_iter().flatten())
            .collect();
        let scale = Scale::of(&all, &c.unit);
        let mut cells = vec![
            c.channel.clone(),
            scale.unit.clone(),
            scale.show(c.parent),
            scale.show(c.child),
        ];
        cells.push(change(c.child, c.parent));
        cells.extend(match simple {
            Some(x) => x.map(|x| scale.show(x)),
            None => [NOTHING, NOTHING].map(String::from),
        });
        row(cells, false)
    });
    let header = [
        "Channel",
        "Unit",
        "Test bench before",
        "after",
        "Change",
        "Simplified model before",
        "after",
    ];
    let what = if v.heldout { "held\u{2011}out runs" } else { "the runs" };
    let caption = format!("Root mean square of measured \u{2212} simulated, on {what}");
    table(&caption, &header, rows.collect(), "")
}

/// Stretches of the actuator under the recorded command.
pub(super) fn driven(v: &Verification) -> Vec<(String, Figure)> {
    let one = |(i, t): (usize, &DrivenTrace)| {
        let plot = TracePlot {
            title: format!("{} under the recorded command, {}", t.channel, t.run),
            x_label: "time [s]".into(),
            y_label: label(&t.channel, &t.unit),
            series: vec![
                series("measured", &t.time_s, t.measured.iter().copied()),
                series("simulated before", &t.time_s, t.parent.iter().copied()),
                series("simulated after", &t.time_s, t.child.iter().copied()),
            ],
        };
        (format!("simulated_{i}"), Figure::Trace(plot))
    };
    v.traces.iter().enumerate().map(one).collect()
}

/// The residual along the signals.
pub(super) fn profiles(f: &Findings) -> Vec<(String, Figure)> {
    let added = !f.effects.is_empty();
    let one = |(i, p): (usize, &Profile)| {
        let mut all = vec![
            skipped(),
            skipped(),
            series(MODELS[1].0, &p.at, p.retuned.iter().copied()),
        ];
        if added {
            all.push(series(MODELS[2].0, &p.at, p.last.iter().copied()));
        }
        let plot = TracePlot {
            title: format!("Mean residual of the {} equation along {}", p.equation, p.signal),
            x_label: label(&p.signal, &p.signal_unit),
            y_label: label("mean residual", &p.unit),
            series: with_zero(all, &p.at),
        };
        (format!("profile_{i}"), Figure::Trace(plot))
    };
    let some = |p: &&Profile| usable(&p.at) && (usable(&p.retuned) || usable(&p.last));
    f.profiles.iter().filter(some).enumerate().map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_units_read_well() {
        assert_eq!(number(12.3456, 3), "12.3");
        assert_eq!(number(123_456.0, 4), "123\u{202f}500");
        assert_eq!(number(-3.2e-5, 3), "\u{2212}32.0\u{d7}10⁻⁶");
        assert_eq!((number(f64::NAN, 3).as_str(), number(0.0, 3).as_str()), (NOTHING, "0"));
        assert_eq!(
            (share(0.832).as_str(), share(0.0412).as_str(), share(1e-5).as_str()),
            ("83 %", "4.1 %", "< 0.1 %")
        );
        assert_eq!(
            (change(1.5, 1.0).as_str(), change(0.9, 1.0).as_str()),
            ("+50.0 %", "\u{2212}10.0 %")
        );
        assert_eq!(
            (change(1.0, 0.0).as_str(), ratio(1.0, 0.0).as_str()),
            (NOTHING, NOTHING)
        );
        let s = Scale::of(&[0.0125, 4.8e-4], "N m");
        assert_eq!(
            (s.unit.as_str(), s.show(0.0125).as_str(), s.show(4.8e-4).as_str()),
            ("mN m", "12.5", "0.480")
        );
        assert_eq!(Scale::of(&[2.6e-5], "kg m2").unit, "10⁻⁶ kg m\u{b2}");
        assert_eq!(Scale::of(&[0.05], "-").unit, "-");
        assert_eq!(s.fixed(0.0125, s.places(&[0.0125], (0.0123, 0.0127))), "12.50");
    }
}
