//! The report of the demonstration.

use super::{case_figures, map_plot, model_comparison, traces};
use crate::COMMIT;
use crate::calibrate::Effort;
use crate::case::Case;
use crate::demo::{DemoResult, Grid, TableCase};
use crate::report::{Figure, Report, Section, Table, TableRow};
use schemas::channel::Channel;
use schemas::fault::FaultState;
use schemas::telemetry::Collector;
use sim_worker::monitor::MonitorTrack;

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

/// All that the report shows.
pub fn report(r: &DemoResult) -> Report {
    let (set, e) = (&r.grid.diagnoser.maps, &r.grid.setup);
    let (actuator, sequence) = (&e.actuator, &e.sequence);
    let sensors = e.sensors.as_ref().map_or("none", |s| &s.name);
    let sm = MonitorTrack::run(actuator, sequence, e.rate_hz);
    let map_figures: Vec<(String, Figure)> = set
        .maps
        .iter()
        .map(|m| (format!("map_{}", m.feature.name()), Figure::Map(map_plot(m, None))))
        .collect();
    let mut trace_figures = model_comparison(&r.healthy, &sm, e.rate_hz);
    for (channel, label) in [(Channel::OmegaM, "speed"), (Channel::IEq, "current")] {
        let runs: Vec<(&str, &Collector)> = vec![("healthy", &r.healthy), ("zeta 0.15, FSJ 3.5", &r.table[2].run)];
        let plot = traces(
            &format!("Healthy and faulty: {}", channel.meaning()),
            label,
            &runs,
            e.rate_hz,
            channel,
        );
        trace_figures.push((format!("faults_{label}"), Figure::Trace(plot)));
    }
    let mut all = vec![
        Section {
            title: "Four diagnoses".into(),
            text: String::new(),
            tables: vec![table_i(r)],
            figures: Vec::new(),
        },
        Section {
            title: "Failure maps".into(),
            text:
                "Each curve is one eccentricity zeta; dots are simulated runs, averaged over sensor noise. The ripple \
                   falls slightly with FSJ, the others rise with both faults."
                    .into(),
            tables: Vec::new(),
            figures: map_figures,
        },
    ];
    all.extend(r.table.iter().enumerate().map(|(i, c)| {
        let t = c.truth();
        let title = format!("Case {}: zeta {}, FSJ {}", i + 1, t.zeta, t.fsj);
        case_section(&title, &format!("case_{}", i + 1), &c.case, Some(t))
    }));
    all.extend(r.own.iter().map(|(path, c)| {
        let title = format!("Your recording: {}", path.display());
        case_section(&title, "recording", c, None)
    }));
    all.push(Section {
        title: "Models".into(),
        text: "The numerical test bench (NTB) beside the simplified model (SM) in nominal condition, and beside a faulty run.".into(),
        tables: Vec::new(),
        figures: trace_figures,
    });
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
        summary: format!(
            "{runs} runs of the 3 s pre-flight test ({} x {} faults) became {} failure maps; the paper's four cases were \
             diagnosed from recordings with sensor noise.",
            faults.fsj.len(),
            faults.zeta.len(),
            set.maps.len()
        ),
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
            ("Grid".into(), format!("{runs} runs, {steps} steps now, {seconds:.1} s")),
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
        sections: all,
    }
}

fn case_section(title: &str, stem: &str, c: &Case, truth: Option<FaultState>) -> Section {
    let d = &c.diagnosis;
    let figures = case_figures(stem, &c.diagnoser, d, truth);
    let text = match d.outcome.area() {
        Some(a) => format!(
            "{}: FSJ {:.4} in {:.4} to {:.4}, zeta {:.5} in {:.5} to {:.5}. {}",
            d.outcome.name().replace('_', " "),
            a.centroid.0,
            a.fsj.lo,
            a.fsj.hi,
            a.centroid.1,
            a.zeta.lo,
            a.zeta.hi,
            d.outcome.reason()
        ),
        None => format!("{}: {}", d.outcome.name().replace('_', " "), d.outcome.reason()),
    };
    Section {
        title: title.into(),
        text,
        tables: Vec::new(),
        figures,
    }
}
