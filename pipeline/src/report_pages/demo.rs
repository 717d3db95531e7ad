//! The report of the demonstration.

use super::conclusion::{self, Around, Told};
use super::demo_figures::{background, cases, counterpart, maps};
use super::diagnosis::{self, Shown, area_section, file_name, measured_section};
use crate::COMMIT;
use crate::calibrate::Effort;
use crate::demo::{DemoResult, Grid, TableCase};
use crate::report::{Figure, Lead, Point, Report, Section, Table, TableRow, Tone};
use std::path::Path;

/// Table I of the paper beside what was found.
pub fn table_i(r: &DemoResult) -> Table {
    let row = |c: &TableCase| {
        let [exact, detected, error, median, high, inside] = c.words(" / ");
        let s = &c.statistics;
        let cells = vec![
            exact,
            detected,
            error,
            format!("{:.2} / {:.2}", c.paper.0, c.paper.1),
            if s.by_paper.0.is_finite() {
                format!("{:.2} / {:.2}", s.by_paper.0, s.by_paper.1)
            } else {
                "no curve in common".into()
            },
            median,
            high,
            format!("{:.4} / {:.3}", s.zeta_width, s.fsj_width),
            inside,
            c.noise.map_or("-".into(), |(f, z)| format!("{z:.5} / {f:.4}")),
        ];
        TableRow { cells, emphasis: false }
    };
    Table {
        caption: "Table I of the paper beside this run".into(),
        header: [
            "exact zeta / FSJ",
            "detected",
            "error %",
            "paper's error %",
            "paper's method, our maps: median error %",
            "median error %",
            "95th percentile %",
            "median width",
            "truth inside",
            "noise alone, 1 sigma",
        ]
        .map(String::from)
        .to_vec(),
        rows: r.table.iter().map(row).collect(),
        note: format!(
            "All pairs are zeta / FSJ. Detected: one noise seed, recorded to Parquet and diagnosed from the file. Median, percentile, width and \
             share inside: {} noise seeds each. The paper's cases are noise free; its error 0 is to the grid's resolution. The paper's method \
             (5.1) reads zeta off the curves that are cut, so that its error is 0 where a curve runs through the case.",
            r.seeds
        ),
    }
}

/// What the four cases came to, in a sentence each: the finding, the evidence.
fn of_cases(r: &DemoResult) -> (String, String) {
    let n = r.table.len();
    let held = |c: &&TableCase| {
        let (area, t) = (c.case.diagnosis.outcome.area(), c.truth());
        area.is_some_and(|a| a.fsj.contains(t.fsj) && a.zeta.contains(t.zeta))
    };
    let inside = r.table.iter().filter(held).count();
    let located = r.table.iter().filter(|c| c.case.diagnosis.outcome.area().is_some());
    let error = |exact: f64, found: f64| 100.0 * (exact - found).abs() / exact;
    let worst = located.fold((0.0f64, 0.0f64), |w, c| {
        let (t, a) = (
            c.truth(),
            c.case.diagnosis.outcome.area().map_or((0.0, 0.0), |a| a.centroid),
        );
        (w.0.max(error(t.fsj, a.0)), w.1.max(error(t.zeta, a.1)))
    });
    let whole = if inside == n {
        format!("The faults of all {n} cases of the paper were found, each true pair inside both intervals.")
    } else {
        format!("In {inside} of the paper\u{2019}s {n} cases the true pair lies inside both intervals.")
    };
    let found = format!(
        "Two faults at once from one test of 3 s with sensor noise: in the one recording of each case errors of at most {:.2} % of FSJ \
         and {:.2} % of zeta (the paper: {:.1} and {:.1} %, without noise).",
        worst.0,
        worst.1,
        r.table.iter().fold(0.0f64, |w, c| w.max(c.paper.1)),
        r.table.iter().fold(0.0f64, |w, c| w.max(c.paper.0)),
    );
    (whole, found)
}

/// How far the cases may be trusted.
fn how_sure(r: &DemoResult) -> String {
    let shares = r.table.iter().map(|c| 100.0 * c.statistics.inside);
    let (lo, hi) = shares.fold((100.0f64, 0.0f64), |(l, h), x| (l.min(x), h.max(x)));
    format!(
        "Over {} seeds of sensor noise each, the intervals held the true pair in {lo:.0} to {hi:.0} % of tests; {:.0} % are promised. Test and \
         maps come from the same simulator: this shows that the inversion is accurate and robust against noise, not that the model \
         is right. All values of actuator and sensors are assumed.",
        r.seeds,
        100.0 * r.grid.diagnoser.coverage()
    )
}

/// The first screen: the reader's own recording where there is one, else the paper's cases.
fn lead(r: &DemoResult) -> Lead {
    let (finding, found) = of_cases(r);
    if let Some((path, case)) = &r.own {
        let shown = own_shown(case);
        let mut lead = diagnosis::lead(&shown, &around(path));
        lead.kind = format!("{}: {}", file_name(path), lead.kind);
        lead.points.push(Point {
            label: "The paper\u{2019}s cases beside it".into(),
            text: format!("{finding} {found}"),
            command: None,
        });
        return lead;
    }
    let point = |label: &str, text: String| Point {
        label: label.into(),
        text,
        command: None,
    };
    Lead {
        tone: Tone::Good,
        kind: "Demonstration on simulated tests".into(),
        finding,
        points: vec![
            point("Found", found),
            point("How sure", how_sure(r)),
            Point {
                label: "What next".into(),
                text: "Diagnose a recording of your own; the page says what it found and what to do about it:".into(),
                command: Some("ema diagnose run.csv --plot page".into()),
            },
        ],
        terms: r.table.first().map_or(Vec::new(), |c| conclusion::terms(&c.case, None)),
        figure: cases(r).map(|p| ("cases_plane".into(), Figure::Region(p))),
        caption: "The paper\u{2019}s four cases in the plane of the faults: each blue dot (found) lies on its red triangle (true). The \
                  intervals are smaller than the dots."
            .into(),
    }
}

fn own_shown(case: &crate::case::Case) -> Shown<'_> {
    Shown {
        case,
        stem: "recording",
        truth: None,
    }
}

/// What the conclusion of the reader's own recording names.
fn around(path: &Path) -> Around {
    let recording = crate::case::quoted(path);
    Around {
        next: Some((
            format!(
                "ema discrepancy --actuator {} --bench {recording} --out study",
                crate::discrepancy::REFERENCE
            ),
            "looks for what is missing from the model".into(),
        )),
        recording,
        unit: None,
    }
}

/// A case of the paper, folded.
fn case_section(number: usize, c: &TableCase) -> Section {
    let t = c.truth();
    let stem = format!("case_{number}");
    let shown = Shown {
        case: &c.case,
        stem: &stem,
        truth: Some(t),
    };
    let d = &c.case.diagnosis;
    let found = d.outcome.area().map_or_else(
        || format!("{}: {}", d.outcome.name().replace('_', " "), d.outcome.reason()),
        |a| Told::of(a).sentence(),
    );
    let mut section = area_section(&format!("Case {number}: zeta {}, FSJ {}", t.zeta, t.fsj), &shown);
    let mut measured = measured_section("", &shown);
    section.text = found;
    section.tables = measured.tables;
    for (stem, _) in &section.figures {
        let words = if stem.ends_with("_area") {
            "Located area, enlarged: red triangle true, blue dot found"
        } else {
            "Bands of all features in the plane of the faults"
        };
        section.captions.push((stem.clone(), counterpart(words, 12)));
    }
    if let Some(three) = measured.folded.first_mut() {
        for (stem, figure) in &three.figures {
            three.captions.push((stem.clone(), counterpart(figure.title(), 11)));
        }
    }
    section.folded = measured.folded;
    section
}

/// All that the report shows.
pub fn report(r: &DemoResult) -> Report {
    let (set, e) = (&r.grid.diagnoser.maps, &r.grid.setup);
    let (actuator, sequence) = (&e.actuator, &e.sequence);
    let sensors = e.sensors.as_ref().map_or("none", |s| &s.name);
    let mut sections = Vec::new();
    if let Some((path, case)) = &r.own {
        let shown = own_shown(case);
        let measured = measured_section("", &shown);
        sections.push(Section {
            tables: measured.tables,
            folded: measured.folded,
            ..area_section(&format!("Your recording: {}", file_name(path)), &shown)
        });
    }
    sections.push(Section {
        title: "The paper\u{2019}s four cases".into(),
        tables: vec![table_i(r)],
        folded: r
            .table
            .iter()
            .enumerate()
            .map(|(i, c)| case_section(i + 1, c))
            .collect(),
        ..Section::default()
    });
    sections.push(maps(r));
    sections.push(background(r));
    let assumed = format!(
        "all {} values of the reference actuator and those of the sensors",
        actuator.assumed.len()
    );
    let Grid {
        faults,
        runs,
        steps,
        seconds,
        ..
    } = &r.grid;
    Report {
        title: "Failure maps of an electromechanical actuator".into(),
        lead: Some(lead(r)),
        summary: String::new(),
        facts: vec![
            (
                "Method".into(),
                "Aimasso, Baldo, Dalla Vedova, Maggiore, Int. J. Mechanics and Control 23(1), 2022".into(),
            ),
            (
                "Actuator".into(),
                format!("{} ({})", actuator.name, actuator.fingerprint()),
            ),
            ("Assumed, not sourced".into(), assumed),
            (
                "Sequence and rate".into(),
                format!("{}, {} Hz", sequence.name, e.rate_hz),
            ),
            (
                "Sensors".into(),
                format!("{} (assumed): 16 bit resolver, 12 bit currents, white noise", sensors),
            ),
            (
                "Grid".into(),
                format!(
                    "{} x {} faults, {runs} runs of the 3 s test, {} maps; {steps} steps now, {seconds:.1} s",
                    faults.fsj.len(),
                    faults.zeta.len(),
                    set.maps.len()
                ),
            ),
            (
                "Bands".into(),
                format!(
                    "{:.0} % coverage, calibrated on {} simulated tests; uncertainties from sensor noise, interpolation, one \
                     sample, projection onto a monotone surface",
                    100.0 * r.grid.diagnoser.coverage(),
                    Effort::QUICK.runs
                ),
            ),
            (
                "Program".into(),
                format!("ema {}, revision {COMMIT}", env!("CARGO_PKG_VERSION")),
            ),
        ],
        sections,
    }
}
