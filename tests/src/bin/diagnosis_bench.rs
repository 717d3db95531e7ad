//! `cargo run --release -p ema-tests --bin diagnosis-bench -- --help`: coverage, widths, errors, silent misses and time of
//! diagnoses. Without options some minutes of tests that maps and calibration have not seen.

use anyhow::{Context, Result};
use clap::Parser;
use ema_tests::coverage::defects::{self, DESIGN, JUDGED, Known};
use ema_tests::coverage::other_hand;
use ema_tests::coverage::{
    FSJ, ZETA, calibrated, fresh, judge, maps_of, only, quantile, record, reference_maps, yardstick,
};
use ema_tests::coverage::{circle, temperature, units};
use pipeline::calibrate::{Campaign, Effort, Unit, draw_units};
use schemas::feature::{Feature, RawFeatures, Role};
use std::fmt::Write;
use std::path::PathBuf;

const EFFORT: Effort = Effort {
    runs: 4096,
    surface_runs: 4096,
    seed: 0,
};

/// Coverage, widths, errors, silent misses and time of diagnoses, on tests that maps and calibration have not seen; or one of the other benches.
#[derive(Parser)]
struct Options {
    /// Grid of the maps
    #[arg(long, default_value = "fine")]
    grid: String,
    /// Tests; of `--circle`: faulty ones a unit, or units of `--units`
    #[arg(long, default_value_t = 1000)]
    tests: usize,
    /// Seed of every draw
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Ends after the coverage
    #[arg(long = "coverage")]
    coverage_only: bool,
    /// Tests that the slow estimator is run on, too
    #[arg(long, default_value_t = 120)]
    refined: usize,
    /// The coverage at twelve rest angles with this spread, calibrated as on first use and as `ema calibrate` does; or `none`
    #[arg(long, value_name = "SPREAD")]
    angles: Option<String>,
    /// Both pre-flight tests compared in this spread
    #[arg(long, value_name = "SPREAD")]
    sequences: Option<String>,
    /// Of `--sequences`: this test alone
    #[arg(long, value_name = "SEQUENCE", value_parser = ["preflight", "preflight2"], requires = "sequences")]
    sequence: Option<String>,
    /// Units with a history, of this spread
    #[arg(long, value_name = "SPREAD")]
    units: Option<String>,
    /// The program, for the whole way of actuators of another hand
    #[arg(long, value_name = "PROGRAM")]
    circle: Option<PathBuf>,
    /// Of `--circle`: this effect in every unit, `none`, or `drawn` by the seed for every other unit
    #[arg(long, value_name = "NAME", default_value = "drawn", requires = "circle")]
    effect: circle::Hidden,
    /// Of `--circle`: actuators
    #[arg(long, default_value_t = 20, requires = "circle")]
    actuators: usize,
    /// Of `--circle`: leave the units' files here
    #[arg(long, value_name = "DIR", requires = "circle")]
    keep: Option<PathBuf>,
    /// Tests at any temperature, of this spread
    #[arg(long, value_name = "SPREAD")]
    temperature: Option<String>,
    /// Which half of the defects is hidden
    #[arg(long, value_name = "HALF", value_parser = ["design", "judged"])]
    defects: Option<String>,
    /// Of `--defects`: these kinds alone, as the tables call them
    #[arg(long, value_name = "KIND", requires = "defects")]
    kind: Vec<String>,
    /// Of `--defects`: units without history, of this spread, by the paper's test alone
    #[arg(long, value_name = "SPREAD", requires = "defects")]
    among: Option<String>,
    /// Write the text here, too
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
}

fn main() -> Result<()> {
    let options = Options::parse();
    let cache = std::env::temp_dir().join(format!("ema-diagnosis-bench-{}", std::process::id()));
    let text = match (&options.angles, &options.sequences, &options.units) {
        _ if options.defects.is_some() => with_defects(&cache, &options),
        _ if let Some(ema) = &options.circle => circle::bench(&circle::Plan {
            ema,
            dir: options.keep.as_deref().unwrap_or(&cache),
            keep: options.keep.is_some(),
            units: options.actuators,
            tests: options.tests,
            seed: options.seed,
            hidden: options.effect,
        }),
        _ if let Some(spread) = &options.temperature => {
            temperature::bench(&cache, &options.grid, spread, EFFORT, (options.tests, options.seed))
        }
        (Some(spread), ..) => at_twelve_angles(&cache, spread, &options),
        (None, Some(spread), _) => of_both_sequences(&cache, spread, &options),
        (None, None, Some(spread)) => units::bench(&cache, &options.grid, spread, options.tests, options.seed),
        (None, None, None) => bench(&cache, &options),
    };
    let _ = std::fs::remove_dir_all(&cache);
    let text = text?;
    if let Some(path) = &options.record {
        std::fs::write(path, &text).with_context(|| path.display().to_string())?;
    }
    print!("{text}");
    Ok(())
}

fn bench(cache: &std::path::Path, options: &Options) -> Result<String> {
    let (set, setup) = reference_maps(&cache.join("maps"), &options.grid, 0.0)?;
    let mut out = String::from("# Diagnoses held against what they promise\n\n");
    let _ = writeln!(
        out,
        "Reference actuator and sensors (all values assumed), pre-flight test at 10 kHz, rest angle 0, {} maps on {} x {} \
         points. Calibration: {} tests, {} more for the response to the spread. 95 % Wilson bounds in brackets.\n",
        set.maps.len(),
        set.maps[0].fsj.len(),
        set.maps[0].zeta.len(),
        EFFORT.runs,
        EFFORT.surface_runs
    );
    let sets: [(&str, &[Feature]); 4] = [
        ("the paper's P1, P2, P3", &[Feature::P1, Feature::P2, Feature::P3]),
        (
            "and the ripple",
            &[Feature::P1, Feature::P2, Feature::P3, Feature::Ripple],
        ),
        (
            "and rise time",
            &[
                Feature::P1,
                Feature::P2,
                Feature::P3,
                Feature::Ripple,
                Feature::SpeedLoss,
                Feature::Rise,
            ],
        ),
        ("and RMS current: all", &Feature::ALL),
    ];
    let mut tables = String::new();
    let mut times = String::new();
    let step_ns = pipeline::speed::measure().scalar_ns_per_step;
    for name in ["none", "fleet"] {
        let spread = sim_worker::catalogue::spread(name)?;
        let campaign = Campaign::run(&setup, &spread, EFFORT, FSJ, ZETA)?.context("interrupted")?;
        let (units, measured) = fresh(&setup, &spread, options.tests, options.seed)?;
        let diagnoser = calibrated(&set, &campaign)?;
        let cases = judge(&diagnoser, &units, &measured);
        out += &record::coverage(&format!("Spread {name}"), &cases);
        let part = options.refined.min(units.len());
        if part > 0 {
            let _ = writeln!(out, "Against the slow estimator, spread {name}: ");
            out += &yardstick::compare(&diagnoser, &setup, &spread, &units[..part], &measured[..part], &[])?;
        }
        if options.coverage_only {
            continue;
        }
        let (us, us_95) = record::time_us(&diagnoser, &units, &measured);
        let _ = writeln!(
            times,
            "| {name} | {us:.1} us | {us_95:.1} us | {:.0} |",
            us * 1e3 / step_ns
        );
        let _ = writeln!(
            tables,
            "## What the maps are worth, spread {name}\n\n| maps | truth inside % | width FSJ | width zeta | error FSJ | error \
             zeta |\n|---|---|---|---|---|---|"
        );
        for (title, features) in sets {
            let part = calibrated(&only(&set, features), &campaign)?;
            tables += &record::maps_row(title, &judge(&part, &units, &measured));
        }
        tables.push('\n');
    }
    if options.coverage_only {
        return Ok(out);
    }
    out += &tables;
    let _ = writeln!(
        out,
        "## Time of a diagnosis from features, one core\n\nControl: a step of a single run of the test bench, {step_ns:.1} ns in \
         the same process.\n\n| spread | median | 95th percentile | median in steps |\n|---|---|---|---|\n{times}"
    );
    out += &at_random_angles(cache)?;
    Ok(out)
}

/// Half of the defects in units without a history and with one, by the other simulator.
fn with_defects(cache: &std::path::Path, options: &Options) -> Result<String> {
    let mut half = match options.defects.as_deref() {
        Some("design") => DESIGN.to_vec(),
        Some("judged") => JUDGED.to_vec(),
        other => anyhow::bail!("--defects {}: design or judged", other.unwrap_or("")),
    };
    half.retain(|d| options.kind.is_empty() || options.kind.contains(&d.title()));
    anyhow::ensure!(
        !half.is_empty(),
        "--kind {}: none of this half",
        options.kind.join(" --kind ")
    );
    let defects = &half[..];
    let mut out = format!(
        "## Defects that the maps know nothing of\n\n{} tests of each severity, units and effects simulated by another hand. refused: \
         unexplained or out of range; inside: the true pair in both intervals; off: located with FSJ or zeta off by more than its interval \
         is wide; far: by more than twice.\n\n",
        options.tests
    );
    let draw = (options.tests, options.seed);
    let fleets = match &options.among {
        Some(spread) => vec![("preflight", spread.as_str())],
        None => vec![("preflight", "fleet"), ("preflight2", "field")],
    };
    for (sequence, spread) in fleets {
        if options.coverage_only && sequence == "preflight2" {
            continue;
        }
        let spread = sim_worker::catalogue::spread(spread)?;
        let (set, setup) = maps_of(&cache.join(sequence), sequence, &options.grid, 0.0)?;
        let campaign = Campaign::run(&setup, &spread, EFFORT, FSJ, ZETA)?.context("interrupted")?;
        let now = calibrated(&set, &campaign)?;
        let mut first = set;
        first.witnesses.retain(|w| w.feature.role() == Role::Witness);
        let before = calibrated(&first, &campaign)?;
        let known = Known::Nothing {
            now: &now,
            before: &before,
        };
        let table = defects::table(defects, &setup, &spread, &units::command_of(sequence), &known, draw)?;
        let _ = writeln!(out, "### {sequence}, spread {}, no history\n\n{table}", spread.name);
    }
    if options.among.is_some() {
        return Ok(out);
    }
    for sequence in ["preflight", "preflight2"] {
        if options.coverage_only && sequence == "preflight2" {
            continue;
        }
        let spread = sim_worker::catalogue::spread("unit")?;
        let (set, setup, prior, calibration) = units::ready(cache, sequence, &options.grid, &spread)?;
        let kind = units::Kind {
            set: &set,
            calibration: &calibration,
            prior: &prior,
        };
        let table = defects::table(
            defects,
            &setup,
            &prior.spread(),
            &units::command_of(sequence),
            &Known::Accepted(&kind),
            draw,
        )?;
        let _ = writeln!(out, "### {sequence}, spread unit, after one acceptance test\n\n{table}");
    }
    Ok(out)
}

/// Maps made on first use at other rest angles, calibrated quickly.
fn at_random_angles(cache: &std::path::Path) -> Result<String> {
    let spread = sim_worker::catalogue::spread("none")?;
    let mut out = String::from(
        "## Other rest angles, spread none\n\nMaps and calibration as made on first use (512 tests); 200 fresh tests each. Maps that are \
         not monotone are left out.\n\n| rest angle | maps | truth inside % | width FSJ | width zeta |\n|---|---|---|---|---|\n",
    );
    for degrees in [20.0, 45.0, 77.0, 200.0, 311.0_f64] {
        let (set, setup) = reference_maps(&cache.join(format!("maps-{degrees}")), "fine", degrees.to_radians())?;
        let campaign = Campaign::run(&setup, &spread, Effort::QUICK, FSJ, ZETA)?.context("interrupted")?;
        let (units, measured) = fresh(&setup, &spread, 200, degrees as u64)?;
        let cases = judge(&calibrated(&set, &campaign)?, &units, &measured);
        let inside = cases.iter().filter(|c| c.inside).count();
        let width =
            |f: fn((f64, f64), f64) -> f64| quantile(cases.iter().filter_map(|c| Some(f(c.found?.0, c.fsj))), 0.5);
        let _ = writeln!(
            out,
            "| {degrees} deg | {} | {} | {:.3} % | {:.5} |",
            set.maps.len(),
            ema_tests::coverage::percent(inside, cases.len()),
            width(|w, fsj| 100.0 * w.0 / fsj),
            width(|w, _| w.1)
        );
    }
    Ok(out)
}

/// The paper's pre-flight test and `preflight2` in one spread: what each is worth, with the supply recorded and without.
fn of_both_sequences(cache: &std::path::Path, spread: &str, options: &Options) -> Result<String> {
    let spread = sim_worker::catalogue::spread(spread)?;
    let mut out = format!(
        "## Both pre-flight tests, spread {}\n\n{} tests of known faults, grid `{}`, calibration of {} tests and {} for the response. 95 % Wilson bounds.\n\n",
        spread.name, options.tests, options.grid, EFFORT.runs, EFFORT.surface_runs
    );
    let mut worth = String::from(
        "| maps | truth inside % | width FSJ | width zeta | error FSJ | error zeta |\n|---|---|---|---|---|---|\n",
    );
    let asked = |s: &&str| options.sequence.as_ref().is_none_or(|one| one == s);
    for sequence in ["preflight", "preflight2"].into_iter().filter(asked) {
        let (set, setup) = maps_of(&cache.join(sequence), sequence, &options.grid, 0.0)?;
        for l in &set.header.left_out {
            let _ = writeln!(out, "{sequence}: left out {l}\n");
        }
        let campaign = Campaign::run(&setup, &spread, EFFORT, FSJ, ZETA)?.context("interrupted")?;
        let (units, measured) = fresh(&setup, &spread, options.tests, options.seed)?;
        let command = units::command_of(sequence);
        let others = draw_units(
            FSJ,
            ZETA,
            &spread,
            options.tests / 4,
            0xA407_0000_0000_0000 ^ options.seed,
        );
        let features = other_hand::measure(&setup, &spread, &others, &command);
        let others = (others, features);
        let all: Vec<Feature> = set.maps.iter().map(|m| m.feature).collect();
        let without = |left: &[Feature]| all.iter().copied().filter(|f| !left.contains(f)).collect::<Vec<_>>();
        for (title, left) in [("supply recorded", &[][..]), ("supply not recorded", &Feature::CAUSES)] {
            if left.is_empty() && sequence == "preflight" {
                continue;
            }
            let diagnoser = calibrated(&only(&set, &without(left)), &campaign)?;
            let cases = judge(&diagnoser, &units, &measured);
            out += &record::coverage(&format!("{sequence}, {title}"), &cases);
            out += &record::thirds(&spread, &units, &cases);
            out += &record::fifths(&cases);
            let _ = writeln!(
                out,
                "Reach by quadrant: {:?}\n",
                [0, 1, 2, 3].map(|q| (1e3 * diagnoser.reach(q)).round() / 1e3)
            );
            worth += &record::maps_row(&format!("{sequence}, {title}"), &cases);
            let mut refined = |title: &str, units: &[Unit], measured: &[RawFeatures]| -> Result<()> {
                let part = options.refined.min(units.len());
                if part > 0 {
                    let _ = writeln!(out, "Against the slow estimator, {sequence}, {title}: ");
                    out += &yardstick::compare(&diagnoser, &setup, &spread, &units[..part], &measured[..part], left)?;
                }
                Ok(())
            };
            refined(title, &units, &measured)?;
            refined(&format!("{title}, simulated by another hand"), &others.0, &others.1)?;
            let (units, measured) = &others;
            let cases = judge(&diagnoser, units, measured);
            out += &record::coverage(&format!("{sequence}, {title}, simulated by another hand"), &cases);
            worth += &record::maps_row(&format!("{sequence}, {title}, simulated by another hand"), &cases);
        }
        for f in Feature::FINER
            .into_iter()
            .filter(|f| all.contains(f) && !options.coverage_only)
        {
            for more in [&[][..], &Feature::CAUSES] {
                let left = [&[f], more].concat();
                let names: Vec<&str> = left.iter().map(|f| f.name()).collect();
                let part = calibrated(&only(&set, &without(&left)), &campaign)?;
                worth += &record::maps_row(
                    &format!("{sequence} without {}", names.join(", ")),
                    &judge(&part, &units, &measured),
                );
            }
        }
    }
    Ok(out + "### What the maps are worth\n\n" + &worth)
}

/// Degrees that no symmetry of phases and poles ties together.
const ANGLES: [f64; 12] = [
    0.0, 20.0, 45.0, 77.0, 108.0, 141.0, 171.0, 200.0, 233.0, 264.0, 297.0, 331.0,
];

/// Coverage at each angle, with either effort of calibration, on the same fresh tests.
fn at_twelve_angles(cache: &std::path::Path, spread: &str, options: &Options) -> Result<String> {
    let spread = sim_worker::catalogue::spread(spread)?;
    let mut out = format!(
        "## Twelve rest angles, spread {}\n\nMaps on the grid `{}`; {} fresh tests at each angle. Truth inside both intervals, of all tests [95 % \
         Wilson].\n\n| rest angle | maps | as on first use % | unexplained | width FSJ, zeta | {} runs % | unexplained | width FSJ, zeta |\n\
         |---|---|---|---|---|---|---|---|\n",
        spread.name, options.grid, options.tests, EFFORT.runs
    );
    let mut sums = [0; 2];
    for degrees in ANGLES {
        let dir = cache.join(format!("maps-{degrees}"));
        let (set, setup) = reference_maps(&dir, &options.grid, degrees.to_radians())?;
        let (units, measured) = fresh(&setup, &spread, options.tests, options.seed ^ ((degrees as u64) << 32))?;
        let _ = write!(out, "| {degrees} deg | {} |", set.maps.len());
        for (effort, sum) in [Effort::QUICK, EFFORT].into_iter().zip(&mut sums) {
            let campaign = Campaign::run(&setup, &spread, effort, FSJ, ZETA)?.context("interrupted")?;
            let cases = judge(&calibrated(&set, &campaign)?, &units, &measured);
            let inside = cases.iter().filter(|c| c.inside).count();
            *sum += inside;
            let width =
                |f: fn((f64, f64), f64) -> f64| quantile(cases.iter().filter_map(|c| Some(f(c.found?.0, c.fsj))), 0.5);
            let _ = write!(
                out,
                " {} | {} | {:.2} %, {:.4} |",
                ema_tests::coverage::percent(inside, cases.len()),
                cases.iter().filter(|c| c.outcome == "unexplained").count(),
                width(|w, fsj| 100.0 * w.0 / fsj),
                width(|w, _| w.1)
            );
        }
        out.push('\n');
    }
    let all = sums.map(|s| ema_tests::coverage::percent(s, ANGLES.len() * options.tests));
    let _ = writeln!(out, "| all | | {} | | | {} | | |", all[0], all[1]);
    Ok(out)
}
