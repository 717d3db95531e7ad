//! The report of map quality for a person.

use super::{
    Break, Candidate, Cell, Convergence, LEAST_GAIN, MOST_CORRELATION, MOST_INTERPOLATION, MapQuality, MapShape,
    PerFault, Sensitivity, Steepness, WORTH_NAMING, median,
};
use schemas::feature::Feature;
use std::fmt::Write;

/// Columns of the text.
pub(super) const WIDTH: usize = 110;

/// Candidates that are listed; all are in the JSON.
const SHOWN: usize = 12;

pub(super) fn text(q: &MapQuality) -> String {
    let mut out = String::new();
    out += &paragraph(&format!("Quality of the failure maps: {}.", q.title));
    out += &shapes(&q.shapes);
    out += &sensitivity(&q.sensitivity);
    out += &isolability(q);
    out += &convergence(&q.convergence);
    out += &worth(q);
    out += &candidates(q);
    out
}

/// Words broken into lines.
fn paragraph(words: &str) -> String {
    let (mut out, mut used) = (String::new(), 0);
    for word in words.split_whitespace() {
        let long = word.chars().count();
        if used > 0 && used + 1 + long > WIDTH {
            out.push('\n');
            used = 0;
        } else if used > 0 {
            out.push(' ');
            used += 1;
        }
        out += word;
        used += long;
    }
    out.push('\n');
    out
}

fn heading(title: &str) -> String {
    format!("\n{title}\n{}\n", "-".repeat(title.len()))
}

/// Three figures.
fn number(x: f64) -> String {
    figures(x, 3)
}

/// * `n` figures, at least one
fn figures(x: f64, n: usize) -> String {
    let size = x.abs();
    if x == 0.0 {
        "0".into()
    } else if x.is_nan() {
        "-".into()
    } else if !x.is_finite() {
        "inf".into()
    } else if !(1e-3..9.995e3).contains(&size) {
        format!("{x:.*e}", n - 1)
    } else {
        let digits = (n as i32 - 1 - size.log10().floor() as i32).max(0) as usize;
        format!("{x:.digits$}")
    }
}

fn percent(share: f64) -> String {
    format!("{} %", number(100.0 * share))
}

fn place((fsj, zeta): (f64, f64)) -> String {
    format!("(FSJ {fsj:.3}, zeta {zeta:.4})")
}

fn names(features: &[Feature]) -> String {
    features.iter().map(|f| f.name()).collect::<Vec<_>>().join(", ")
}

fn shapes(shapes: &[MapShape]) -> String {
    let mut out = heading("1. Shape of each map");
    out += &paragraph(
        "u is the standard uncertainty of one measurement: sensors and, where the feature comes in whole samples, one \
         sample. A plateau is a grid cell over which the feature changes by no more than u. A break is the greatest \
         step the wrong way between two points of a grid line, before the maps are made monotone. A crossing is a pair \
         of simulated curves of neighbouring zeta that cross over FSJ.",
    );
    let _ = writeln!(
        out,
        "\n{:<12}{:>25}{:>11}{:>13}{:>14}{:>22}{:>12}",
        "map", "range", "u", "plateau FSJ", "plateau zeta", "break FSJ / zeta", "crossings"
    );
    for s in shapes {
        let share = |b: &Option<Break>| b.as_ref().map_or("none".into(), |b| percent(b.share));
        let _ = writeln!(
            out,
            "{:<12}{:>25}{:>11}{:>13}{:>14}{:>22}{:>12}",
            s.feature.name(),
            format!("{}..{} {}", number(s.range.0), number(s.range.1), s.feature.unit()),
            number(s.measurement),
            percent(s.plateau.fsj),
            percent(s.plateau.zeta),
            format!("{} / {}", share(&s.broken.fsj), share(&s.broken.zeta)),
            s.crossings.count
        );
    }
    let mut notes = Vec::new();
    for s in shapes {
        let (name, unit) = (s.feature.name(), s.feature.unit());
        let over = |x: f64| match s.measurement > 0.0 {
            true => format!("{} {unit}, {} u", number(x), number(x / s.measurement)),
            false => format!("{} {unit}", number(x)),
        };
        for (fault, b) in [("FSJ", &s.broken.fsj), ("zeta", &s.broken.zeta)] {
            if let Some(b) = b {
                let (from, to) = (place(b.from), place(b.to));
                notes.push(format!(
                    "{name} breaks along {fault} by {} from {from} to {to}",
                    over(b.value)
                ));
            }
        }
        if let Some(c) = &s.crossings.deepest {
            let curves = format!("zeta {:.4} and {:.4}", c.zeta.0, c.zeta.1);
            notes.push(format!(
                "{name}: {curves} cross deepest at FSJ {:.3}, by {}",
                c.fsj,
                over(c.depth)
            ));
        }
    }
    for n in notes {
        out += &paragraph(&format!("- {n}"));
    }
    let flat = |s: &&MapShape| s.plateau.fsj.max(s.plateau.zeta) >= WORTH_NAMING;
    let flat: Vec<Feature> = shapes.iter().filter(flat).map(|s| s.feature).collect();
    let broken = |s: &&MapShape| {
        let share = |b: &Option<Break>| b.as_ref().map_or(0.0, |b| b.share);
        share(&s.broken.fsj).max(share(&s.broken.zeta)) >= WORTH_NAMING
    };
    let broken: Vec<Feature> = shapes.iter().filter(broken).map(|s| s.feature).collect();
    let list = |v: &[Feature]| if v.is_empty() { "none".into() } else { names(v) };
    out += &paragraph(&format!(
        "Plateaus on at least {w} of the cells: {}. Breaks of at least {w} of the range: {}.",
        list(&flat),
        list(&broken),
        w = percent(WORTH_NAMING)
    ));
    out
}

fn sensitivity(all: &[Sensitivity]) -> String {
    let mut out = heading("2. How much each map tells of each fault");
    out += &paragraph(
        "Change of the feature in its unit and, in brackets, in its standard uncertainties (unit's spread included), \
         at the middles of the four quadrants; last, the brackets' least, median and greatest size over all \
         cells.",
    );
    let titles = [("1 % of FSJ", true), ("0.01 of zeta", false)];
    for (title, is_fsj) in titles {
        let of = |s: &Sensitivity| -> Steepness {
            let PerFault { fsj, zeta } = &s.steepness;
            if is_fsj { fsj.clone() } else { zeta.clone() }
        };
        let Some(first) = all.first() else { continue };
        let _ = write!(out, "\nper {title}\n{:<12}", "map");
        for (p, ..) in of(first).middles {
            let _ = write!(out, "{:>18}", format!("({:.2}, {:.3})", p.0, p.1));
        }
        let _ = writeln!(out, "{:>26}", "least / median / greatest");
        for s in all {
            let _ = write!(out, "{:<12}", s.feature.name());
            let steep = of(s);
            for (_, own, u) in steep.middles {
                let _ = write!(out, "{:>18}", format!("{} ({})", number(own), figures(u.abs(), 2)));
            }
            let _ = writeln!(out, "{:>26}", steep.sigmas.map(|u| figures(u, 2)).join(" / "));
        }
    }
    out
}

fn isolability(q: &MapQuality) -> String {
    let mut out = heading("3. Can the maps tell FSJ from zeta?");
    out += &paragraph(&format!(
        "Fisher information of {} together, at each cell of the grid: the least standard deviations that any estimate \
         can have. The area is that of the Gaussian 95 % ellipse (2.45 standard uncertainties); the diagnosis itself \
         reaches {}, by quadrant.",
        names(&q.joint),
        q.reach.map(number).join(", ")
    ));
    let sorted = q.by_area();
    let column = |of: fn(&Cell) -> f64| median(q.cells().iter().map(of).collect());
    let _ = writeln!(
        out,
        "\n{:<10}{:>30}{:>16}{:>14}{:>14}{:>16}",
        "cell", "place", "sigma FSJ", "sigma zeta", "correlation", "95 % area"
    );
    if !sorted.is_empty() {
        let (last, middle) = (sorted.len() - 1, sorted.len() / 2);
        for (name, c) in [("best", sorted[0]), ("median", sorted[middle]), ("worst", sorted[last])] {
            let _ = writeln!(
                out,
                "{name:<10}{:>30}{:>16}{:>14}{:>14}{:>16}",
                place(c.centre()),
                format!("{} %", number(c.sigma_fsj_percent())),
                number(c.sigma_zeta()),
                c.ellipse
                    .map_or("singular".into(), |e| format!("{:+.3}", e.correlation)),
                number(c.area())
            );
        }
    }
    out += &paragraph(&format!(
        "Medians over the cells: sigma FSJ {} %, sigma zeta {}, |correlation| {}.",
        number(column(Cell::sigma_fsj_percent)),
        number(column(Cell::sigma_zeta)),
        number(column(|c| c.ellipse.map_or(1.0, |e| e.correlation.abs())))
    ));
    let blind = q.blind();
    out += &paragraph(&match blind.first() {
        None => format!(
            "All {} cells tell the faults apart (|correlation| at most {MOST_CORRELATION}).",
            q.cells().len()
        ),
        Some(_) => {
            let ends = |of: fn(&Cell) -> (f64, f64)| {
                let lo = blind.iter().map(|c| of(c).0).fold(f64::INFINITY, f64::min);
                let hi = blind.iter().map(|c| of(c).1).fold(f64::NEG_INFINITY, f64::max);
                format!("{} to {}", number(lo), number(hi))
            };
            format!(
                "{} of {} cells do not tell the faults apart (|correlation| above {MOST_CORRELATION}, or singular: \
                 {}). They lie within FSJ {}, zeta {}.",
                blind.len(),
                q.cells().len(),
                blind.iter().filter(|c| c.ellipse.is_none()).count(),
                ends(|c| c.fsj),
                ends(|c| c.zeta)
            )
        }
    });
    out
}

fn convergence(all: &[Convergence]) -> String {
    let mut out = heading("4. Is the grid fine enough?");
    out += &paragraph(
        "Errors where a grid point is left out and read from its neighbours, on this grid and on every second line of \
         it (root mean square). Their ratio is 0.25 or less where a map is smooth, about 1 where its values scatter. \
         In brackets: in u (section 1). The last column is the share of the feature's standard uncertainty, the unit's \
         spread included, that the maps' own error makes up at the median cell.",
    );
    let _ = writeln!(
        out,
        "\n{:<12}{:>11}{:>13}{:>7}{:>20}{:>22}{:>13}{:>12}",
        "map", "left out", "every 2nd", "ratio", "interpolation", "twice as fine", "fine enough", "of whole"
    );
    for c in all {
        let over = |x: f64| format!("{} ({})", number(x), number(x / c.measurement));
        let verdict = match (c.fine_enough(), c.finer_enough()) {
            _ if c.measurement <= 0.0 => "no u",
            (true, _) => "yes",
            (false, true) => "if doubled",
            (false, false) => "no",
        };
        let _ = writeln!(
            out,
            "{:<12}{:>11}{:>13}{:>7}{:>20}{:>22}{:>13}{:>12}",
            c.feature.name(),
            number(c.fine),
            number(c.coarse),
            number(c.ratio()),
            over(c.interpolation),
            over(c.finer),
            verdict,
            percent(c.of_whole)
        );
    }
    let of = |doubling: bool| -> Vec<Feature> {
        let short = all.iter().filter(|c| !c.fine_enough() && c.finer_enough() == doubling);
        short.map(|c| c.feature).collect()
    };
    let limit = number(MOST_INTERPOLATION);
    let (cured, left) = (of(true), of(false));
    if cured.is_empty() && left.is_empty() {
        out += &paragraph(&format!(
            "The error between grid points is at most {limit} u in every map."
        ));
    }
    if !cured.is_empty() {
        let list = names(&cured);
        out += &paragraph(&format!(
            "Above {limit} u, and below it on a grid twice as fine: {list}."
        ));
    }
    if !left.is_empty() {
        let list = names(&left);
        out += &paragraph(&format!("Above {limit} u, also on a grid twice as fine: {list}."));
    }
    out
}

fn worth(q: &MapQuality) -> String {
    let mut out = heading("5. What each map is worth");
    out += &paragraph("Growth of the 95 % area if the map were left out: median over the cells.");
    out.push('\n');
    let mut sorted: Vec<_> = q.worth.iter().filter_map(|w| Some((w.feature, w.without?))).collect();
    sorted.sort_by(|a, b| b.1.total_cmp(&a.1));
    for (f, x) in &sorted {
        let _ = writeln!(out, "{:<12}{:>12}", f.name(), format!("x {}", number(*x)));
    }
    for w in q.worth.iter().filter(|w| w.without.is_none()) {
        let _ = writeln!(
            out,
            "{:<12}{:>12}  (made of others that are inverted)",
            w.feature.name(),
            "-"
        );
    }
    out
}

fn candidates(q: &MapQuality) -> String {
    let mut out = heading("6. What to add next");
    out +=
        &paragraph("What is left of the 95 % area and of the standard deviations, as a share: median over the cells.");
    let title = q.candidates.iter().map(|c| c.remedy.title().chars().count()).max();
    let wide = title.unwrap_or(0).max(12) + 2;
    let _ = writeln!(
        out,
        "\n{:<wide$}{:>10}{:>12}{:>12}",
        "candidate", "area", "sigma FSJ", "sigma zeta"
    );
    for c in q.candidates.iter().take(SHOWN) {
        let _ = writeln!(
            out,
            "{:<wide$}{:>10}{:>12}{:>12}",
            c.remedy.title(),
            number(c.area),
            number(c.sigma_fsj),
            number(c.sigma_zeta)
        );
    }
    if let Some(next) = q.candidates.get(SHOWN) {
        let more = q.candidates.len() - SHOWN;
        let _ = writeln!(
            out,
            "and {more} more, none of which leaves less than {}",
            number(next.area)
        );
    }
    let named = |c: &Candidate| format!("{} (area less {})", c.remedy.title(), percent(1.0 - c.area));
    let gains: Vec<String> = q
        .candidates
        .iter()
        .filter(|c| c.area <= 1.0 - LEAST_GAIN)
        .map(named)
        .collect();
    out += &paragraph(&match gains.split_first() {
        None => format!("None of these takes {} off the median area.", percent(LEAST_GAIN)),
        Some((first, rest)) => {
            let then = match rest {
                [] => format!("; nothing else takes {} off", percent(LEAST_GAIN)),
                [second, ..] => format!("; next by {second}"),
            };
            format!("Most would be gained by {first}{then}.")
        }
    });
    out
}
