//! `ema demo`: grid, maps, the four cases of the paper's Table I, and a report.

use crate::COMMIT;
use crate::calibrate::Effort;
use crate::case::{self, Settings};
use crate::dataset::Dataset;
use crate::maps;
use crate::report::{self, Figure, Report, Section, Table, TableRow};
use crate::report_pages;
use anyhow::Result;
use diagnoser::diagnosis::{Diagnoser, Outcome};
use diagnoser::map_library::Choice;
use diagnoser::sensitivity::noise_sigma;
use rayon::prelude::*;
use schemas::channel::{Channel, ChannelSet};
use schemas::fault::FaultState;
use schemas::recording::Recorder;
use schemas::telemetry::{Collector, TelemetryBuffer, TelemetrySink};
use sim_worker::dataset::one::OneActuator;
use sim_worker::dataset::plan::DatasetPlan;
use sim_worker::dataset::storage::Storage;
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use sim_worker::monitor::MonitorTrack;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::{SensorNoise, Sensors};
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{Run, simulate};
use sim_worker::test_bench::Lane;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Table I of the paper: zeta, FSJ, and the paper's errors in percent of each.
pub const TABLE_I: [(f64, f64, f64, f64); 4] = [
    (0.30, 2.0, 0.0, 3.0350),
    (0.17, 1.2, 11.7647, 5.4333),
    (0.15, 3.5, 0.0, 0.1829),
    (0.27, 2.2, 0.0, 1.2500),
];

/// Statistics of one case over noise seeds.
#[derive(Clone, Debug)]
pub struct CaseStatistics {
    pub truth: FaultState,
    pub seeds: u64,
    /// share of seeds that are located with the truth inside
    pub inside: f64,
    /// errors in percent, sorted: zeta, FSJ (not located counts as infinite)
    pub zeta_error: Vec<f64>,
    pub fsj_error: Vec<f64>,
    /// median widths of the intervals: FSJ, zeta
    pub fsj_width: f64,
    pub zeta_width: f64,
}

/// Quantile of a sorted list.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * q).round() as usize]
}

/// Diagnoses one simulated run under many noise seeds.
pub fn statistics(
    run: &Collector,
    truth: FaultState,
    diagnoser: &Diagnoser,
    plan: &Arc<FeaturePlan>,
    sensors: &sim_worker::sensor::SensorModel,
    seeds: u64,
) -> CaseStatistics {
    let set = &diagnoser.maps;
    let rest_angle_rad = set.header.kind.rest_angle_rad;
    let results: Vec<(f64, f64, bool, f64, f64)> = (0..seeds)
        .into_par_iter()
        .map(|seed| {
            let noise = SensorNoise::new(seed, run.rows());
            let s = Sensors {
                model: sensors,
                noise: &noise,
                gear_ratio: plan.gear_ratio,
                rest_angle_rad,
            };
            let mut out = TelemetryBuffer::new(ChannelSet::basic(), run.rows());
            s.measure(&run.view(), &mut out);
            let mut x = FeatureExtractor::new(plan.clone());
            x.push(&out.view());
            let d = diagnoser.diagnose(&set.features(&x.features()), &x.missing());
            match &d.outcome {
                Outcome::Located(a) => {
                    let percent = |exact: f64, found: f64| 100.0 * (exact - found).abs() / exact;
                    let inside = a.fsj.contains(truth.fsj) && a.zeta.contains(truth.zeta);
                    (
                        percent(truth.zeta, a.centroid.1),
                        percent(truth.fsj, a.centroid.0),
                        inside,
                        a.fsj.width(),
                        a.zeta.width(),
                    )
                }
                _ => (f64::INFINITY, f64::INFINITY, false, f64::INFINITY, f64::INFINITY),
            }
        })
        .collect();
    let sorted = |f: fn(&(f64, f64, bool, f64, f64)) -> f64| {
        let mut v: Vec<f64> = results.iter().map(f).collect();
        v.sort_by(f64::total_cmp);
        v
    };
    CaseStatistics {
        truth,
        seeds,
        inside: results.iter().filter(|r| r.2).count() as f64 / seeds as f64,
        zeta_error: sorted(|r| r.0),
        fsj_error: sorted(|r| r.1),
        fsj_width: quantile(&sorted(|r| r.3), 0.5),
        zeta_width: quantile(&sorted(|r| r.4), 0.5),
    }
}

/// Simulates the grid, builds the maps, diagnoses the paper's cases (and `file`), writes the report.
pub fn demo(out: &Path, grid: &str, seeds: u64, file: Option<&Path>) -> Result<()> {
    let begin = Instant::now();
    let actuator = Arc::new(ActuatorParameters::reference());
    let sequence = sim_worker::catalogue::sequence("preflight")?;
    let sensors = sim_worker::catalogue::sensors("reference")?.expect("built in");
    let channels = ChannelSet::basic();
    let setup = TestSetup {
        sensors: Some(sensors.clone()),
        ..TestSetup::new(actuator.clone(), sequence.clone(), 10_000.0)
    };
    let grid = sim_worker::catalogue::grid(grid)?;
    let plan = DatasetPlan::of_one(&OneActuator {
        setup: &setup,
        grid: &grid,
        rest_angles_rad: &[],
        seed: 0,
        telemetry: None,
    })?;
    let dataset = out.join("dataset");
    let runs = plan.runs();
    let storage = Storage::open(&dataset.display().to_string())?;
    let (done, _) = crate::dataset::make(&plan, &storage, "grid")?.ok_or(crate::Interrupted)?;
    let (steps, grid_s) = (done.steps, begin.elapsed().as_secs_f64());
    let set = crate::dataset::maps::of_one(&Dataset::of(storage)?, false)?;
    let maps_file = dataset.join("maps.parquet");
    set.save(&maps_file)?;
    let experiment = setup.experiment(channels)?;
    let choice = Choice::usual();
    let diagnoser = maps::calibrated(&maps_file, set, &setup, &choice, &Vec::new())?;
    let set = &diagnoser.maps;

    // the cases: simulated noise free once, recorded through the sensors
    let bare = experiment.bare(channels.with(Channel::TorqueM));
    let faults: Vec<FaultState> = TABLE_I
        .iter()
        .map(|&(zeta, fsj, _, _)| FaultState { fsj, zeta })
        .chain([FaultState::NOMINAL])
        .collect();
    let lanes: Vec<Run> = faults
        .iter()
        .enumerate()
        .map(|(i, &fault)| Run {
            number: i as u64,
            lane: Lane {
                actuator: actuator.clone(),
                fault,
                rest_angle_rad: 0.0,
                load_n_m: 0.0,
            },
            seed: i as u64,
        })
        .collect();
    let mut collected = vec![Collector::default(); lanes.len()];
    simulate(&bare, &lanes, &mut collected, || !crate::progress::interrupted())?.ok_or(crate::Interrupted)?;
    let feature_plan = Arc::new(FeaturePlan::new(&actuator, &sequence, experiment.rate_hz, false));

    let settings = Settings {
        actuator: Some(actuator.clone()),
        maps: Some(dataset.clone()),
        run: None,
        sequence: None,
        sensors: "auto".into(),
        grid: grid.clone(),
        choice: choice.clone(),
        known: Vec::new(),
    };
    let cases_dir = out.join("cases");
    std::fs::create_dir_all(&cases_dir)?;
    let mut rows = Vec::new();
    let mut sections = Vec::new();
    let mut text_table = vec![format!(
        "{:>14}  {:>16}  {:>17}  {:>17}  {:>17}  {:>6}",
        "exact", "detected", "error % (paper)", "median % of seeds", "95th % of seeds", "inside"
    )];
    for (i, &(zeta, fsj, paper_zeta, paper_fsj)) in TABLE_I.iter().enumerate() {
        let truth = FaultState { fsj, zeta };
        let path = cases_dir.join(format!("case_{}.parquet", i + 1));
        let seed = 1000 + i as u64;
        record(&path, &setup, &collected[i], seed)?;
        let c = case::run(&path, &settings)?;
        let s = statistics(&collected[i], truth, &diagnoser, &feature_plan, &sensors, seeds);
        let area = c.diagnosis.outcome.area();
        let found = area.map_or((f64::NAN, f64::NAN), |a| a.centroid);
        let percent = |exact: f64, x: f64| 100.0 * (exact - x).abs() / exact;
        let (ez, ef) = (percent(zeta, found.1), percent(fsj, found.0));
        let sigma = noise_sigma(set, fsj, zeta);
        rows.push(TableRow {
            cells: vec![
                format!("{zeta:.2} / {fsj:.1}"),
                format!("{:.4} / {:.4}", found.1, found.0),
                format!("{ez:.2} / {ef:.2}"),
                format!("{paper_zeta:.2} / {paper_fsj:.2}"),
                format!(
                    "{:.2} / {:.2}",
                    quantile(&s.zeta_error, 0.5),
                    quantile(&s.fsj_error, 0.5)
                ),
                format!(
                    "{:.2} / {:.2}",
                    quantile(&s.zeta_error, 0.95),
                    quantile(&s.fsj_error, 0.95)
                ),
                format!("{:.4} / {:.3}", s.zeta_width, s.fsj_width),
                format!("{:.0} %", 100.0 * s.inside),
                sigma.map_or("-".into(), |(f, z)| format!("{z:.5} / {f:.4}")),
            ],
            emphasis: false,
        });
        text_table.push(format!(
            "{:>14}  {:>16}  {:>17}  {:>17}  {:>17}  {:>6}",
            format!("{zeta:.2} {fsj:.1}"),
            format!("{:.4} {:.4}", found.1, found.0),
            format!("{ez:.2} {ef:.2} ({paper_zeta:.1} {paper_fsj:.1})"),
            format!("{:.2} {:.2}", quantile(&s.zeta_error, 0.5), quantile(&s.fsj_error, 0.5)),
            format!(
                "{:.2} {:.2}",
                quantile(&s.zeta_error, 0.95),
                quantile(&s.fsj_error, 0.95)
            ),
            format!("{:.0} %", 100.0 * s.inside),
        ));
        sections.push(case_section(
            &format!("Case {}: zeta {zeta}, FSJ {fsj}", i + 1),
            &format!("case_{}", i + 1),
            &c,
            Some(truth),
        ));
    }
    if let Some(path) = file {
        let own = Settings {
            maps: None,
            ..settings.clone()
        };
        let c = case::run(path, &own)?;
        crate::cli::say(&case::to_text(&c));
        sections.push(case_section(
            &format!("Your recording: {}", path.display()),
            "recording",
            &c,
            None,
        ));
    }

    let table = Table {
        caption: "Table I of the paper beside this run".into(),
        header: [
            "exact zeta / FSJ",
            "detected",
            "error %",
            "paper's error %",
            "median error %",
            "95th percentile %",
            "median width",
            "truth inside",
            "noise alone, 1 sigma",
        ]
        .map(String::from)
        .to_vec(),
        rows,
        note: format!(
            "All pairs are zeta / FSJ. Detected: one noise seed, recorded to Parquet and diagnosed from the file. Median, percentile, width and \
             share inside: {seeds} noise seeds each. The paper's cases are noise free; its error 0 is to the grid's resolution."
        ),
    };
    let nominal = &collected[4];
    let sm = MonitorTrack::run(&actuator, &sequence, experiment.rate_hz);
    let map_figures: Vec<(String, Figure)> = set
        .maps
        .iter()
        .map(|m| {
            (
                format!("map_{}", m.feature.name()),
                Figure::Map(report_pages::map_plot(m, None)),
            )
        })
        .collect();
    let mut trace_figures = report_pages::model_comparison(nominal, &sm, experiment.rate_hz);
    for (channel, label) in [(Channel::OmegaM, "speed"), (Channel::IEq, "current")] {
        let runs: Vec<(&str, &Collector)> = vec![("healthy", nominal), ("zeta 0.15, FSJ 3.5", &collected[2])];
        let plot = report_pages::traces(
            &format!("Healthy and faulty: {}", channel.meaning()),
            label,
            &runs,
            experiment.rate_hz,
            channel,
        );
        trace_figures.push((format!("faults_{label}"), Figure::Trace(plot)));
    }
    let mut all = vec![
        Section {
            title: "Four diagnoses".into(),
            text: String::new(),
            tables: vec![table],
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
    all.extend(sections);
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
    let report = Report {
        title: "Failure maps of an electromechanical actuator".into(),
        summary: format!(
            "{runs} runs of the 3 s pre-flight test ({} x {} faults) became {} failure maps; the paper's four cases were \
             diagnosed from recordings with sensor noise.",
            grid.fsj.len(),
            grid.zeta.len(),
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
                format!("{}, {} Hz", sequence.name, experiment.rate_hz),
            ),
            (
                "Sensors".into(),
                format!(
                    "{} (assumed): 16 bit resolver, 12 bit currents, white noise",
                    sensors.name
                ),
            ),
            ("Grid".into(), format!("{runs} runs, {steps} steps now, {grid_s:.1} s")),
            (
                "Bands".into(),
                format!(
                    "{:.0} % coverage, calibrated on {} simulated tests; uncertainties from sensor noise, interpolation, one \
                     sample, projection onto a monotone surface",
                    100.0 * choice.coverage,
                    Effort::QUICK.runs
                ),
            ),
            (
                "Program".into(),
                format!("ema {}, revision {COMMIT}", env!("CARGO_PKG_VERSION")),
            ),
        ],
        sections: all,
    };
    report::write(&report, out, "report.html")?;
    crate::cli::say(&format!(
        "zeta FSJ of the paper's Table I, {seeds} noise seeds each\n{}",
        text_table.join("\n")
    ));
    crate::cli::say(&format!(
        "\n{runs} runs, maps, diagnoses and report in {:.1} s: {}",
        begin.elapsed().as_secs_f64(),
        out.join("report.html").display()
    ));
    Ok(())
}

/// Writes a simulated run through the sensors as a recording.
fn record(path: &Path, setup: &TestSetup, run: &Collector, seed: u64) -> Result<()> {
    let sensors = setup.sensors.as_ref().expect("the demo has sensors");
    let noise = SensorNoise::new(seed, run.rows());
    let s = Sensors {
        model: sensors,
        noise: &noise,
        gear_ratio: setup.actuator.gear_ratio,
        rest_angle_rad: 0.0,
    };
    let channels = ChannelSet::basic();
    let mut out = TelemetryBuffer::new(channels, run.rows());
    s.measure(&run.view(), &mut out);
    let mut recorder = Recorder::create(path, &setup.provenance(seed, COMMIT), channels, true)?;
    let header = run.header.clone().expect("a run that was collected");
    let header = schemas::telemetry::TelemetryHeader {
        channels,
        sensors: sensors.fingerprint(),
        ..header
    };
    recorder.accept(&header, &out.view())?;
    recorder.finish()?;
    Ok(())
}

fn case_section(title: &str, stem: &str, c: &case::Case, truth: Option<FaultState>) -> Section {
    let d = &c.diagnosis;
    let figures = report_pages::case_figures(stem, &c.diagnoser, d, truth);
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
