//! The whole way of an actuator of another hand, by the program as its users have it: a study of healthy telemetry, a unit
//! file with three healthy pre-flight tests, then faulty ones.

use super::{percent, quantile};
use crate::independent::{self, Command as Motion, EFFECTS, Unit};
use anyhow::{Context, Result, anyhow};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;
use std::str::FromStr;

/// Rate of the recordings [Hz] and their length [s].
const RATE_HZ: f64 = 2000.0;
const SECONDS: f64 = 3.0;

/// Lower end of the FSJ interval that no healthy test should lie above.
const HEALTHY: f64 = 1.1;

/// What one test came to.
struct Test {
    outcome: String,
    inside: bool,
    /// widths and errors of FSJ and zeta
    found: Option<[f64; 4]>,
    fsj: f64,
}

/// Runs the program; standard output as JSON, if it is.
fn run(ema: &Path, cache: &Path, args: &[&str]) -> Result<(bool, Value, String)> {
    let out = Command::new(ema)
        .env("EMA_CACHE_DIR", cache)
        .args(args)
        .output()
        .with_context(|| ema.display().to_string())?;
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    let json = serde_json::from_slice(&out.stdout).unwrap_or(Value::Null);
    Ok((out.status.success(), json, said))
}

fn judged(d: &Value, (fsj, zeta): (f64, f64)) -> Test {
    let of = |fault: &str, end: &str| d[fault][end].as_f64();
    let one = |fault: &str, truth: f64| {
        let (lo, hi, e) = (of(fault, "lo")?, of(fault, "hi")?, of(fault, "estimate")?);
        Some((lo <= truth && truth <= hi, hi - lo, e - truth))
    };
    let both = one("fsj", fsj).zip(one("zeta", zeta));
    let outcome: String = d["outcome"].as_str().unwrap_or("refused").into();
    Test {
        inside: outcome == "located" && both.is_some_and(|(f, z)| f.0 && z.0),
        outcome,
        found: both.map(|(f, z)| [f.1, f.2, z.1, z.2]),
        fsj,
    }
}

/// What is to be run.
pub struct Plan<'a> {
    /// the program
    pub ema: &'a Path,
    /// where the units' files are written
    pub dir: &'a Path,
    /// whether they stay there
    pub keep: bool,
    pub units: usize,
    /// faulty tests of each unit
    pub tests: usize,
    pub seed: u64,
    pub hidden: Hidden,
}

/// What the units hide.
#[derive(Clone, Copy)]
pub enum Hidden {
    /// nothing in every other unit, one effect that the seed draws in those between
    Drawn,
    /// the same in every unit, or nothing in any
    Every(Option<&'static str>),
}

impl FromStr for Hidden {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s {
            "drawn" => Ok(Self::Drawn),
            "none" => Ok(Self::Every(None)),
            name => match EFFECTS.iter().find(|e| **e == name) {
                Some(known) => Ok(Self::Every(Some(known))),
                None => Err(format!("allowed are drawn, none, {}", EFFECTS.join(", "))),
            },
        }
    }
}

/// The way of `plan.units` actuators.
///
/// # Errors
/// Files that cannot be written; a program that does not run.
pub fn bench(plan: &Plan<'_>) -> Result<String> {
    let &Plan {
        ema,
        dir,
        keep,
        units,
        tests,
        seed,
        hidden,
    } = plan;
    let told = match hidden {
        Hidden::Drawn => "every other one with one effect at full strength".to_string(),
        Hidden::Every(None) => "no effect in any".to_string(),
        Hidden::Every(Some(effect)) => format!("every one with `{effect}` at full strength"),
    };
    let mut out = format!(
        "## Actuators of another hand: one study, three healthy tests, {tests} faulty ones\n\n{units} units, constants off by up to 10 %, \
         {told}; simulator, sensors, draws and effects are another hand's. Truth inside both 95 % \
         intervals.\n\n| unit | hidden | study | healthy tests taken | inside % | not located | width FSJ %, median | width zeta | healthy \
         tests above FSJ {HEALTHY} |\n|---|---|---|---|---|---|---|---|---|\n"
    );
    let mut all: Vec<Test> = Vec::new();
    let mut above = (0, 0);
    for k in 0..units {
        let own_seed = seed.wrapping_mul(1000) + k as u64;
        let mut rng = ChaCha8Rng::seed_from_u64(own_seed);
        let effect = match hidden {
            Hidden::Drawn => (k % 2 == 1).then(|| EFFECTS[rng.random_range(0..EFFECTS.len())]),
            Hidden::Every(effect) => effect,
        };
        let folder = dir.join(format!("unit-{k}"));
        independent::make_unit(&folder, effect, 1.0, own_seed)?;
        let unit = Unit::drawn(own_seed, effect, 1.0).map_err(|e| anyhow!(e))?;
        let path = |name: &str| folder.join(name).display().to_string();
        let cache = folder.join("cache");
        let study = path("study");
        let (long, second) = (path("healthy_long_1.csv"), path("healthy_long_2.csv"));
        let (done, said, _) = run(
            ema,
            &cache,
            &[
                "discrepancy",
                "--bench",
                &long,
                &second,
                "--healthy",
                "--out",
                &study,
                "--json",
            ],
        )?;
        let names: Vec<String> = said["effects"]
            .as_array()
            .map(|e| {
                e.iter()
                    .map(|e| e["name"].as_str().unwrap_or("?").to_string())
                    .collect()
            })
            .unwrap_or_default();
        let verdict = format!(
            "{} {}",
            said["verdict"].as_str().unwrap_or(if done { "?" } else { "refused" }),
            names.join("+")
        );
        let file = path("unit.json");
        run(ema, &cache, &["unit", "new", &file, "--study", &study])?;
        let healthy: Vec<String> = (0..3).map(|n| path(&format!("healthy_{n}.csv"))).collect();
        let mut args = vec!["unit", "update", &file];
        args.extend(healthy.iter().map(String::as_str));
        args.push("--healthy");
        run(ema, &cache, &args)?;
        let (_, shown, _) = run(ema, &cache, &["unit", "show", &file, "--json"])?;
        let mut own = Vec::new();
        for n in 0..tests {
            let faults = (rng.random_range(1.1..4.9), rng.random_range(0.0..0.49));
            let test = path(&format!("test_{n}.csv"));
            independent::record(
                &unit,
                &Motion::Preflight,
                SECONDS,
                RATE_HZ,
                faults,
                true,
                own_seed ^ ((n as u64 + 50) << 32),
            )
            .write_csv(Path::new(&test))?;
            let (_, d, _) = run(ema, &cache, &["diagnose", &test, "--unit", &file, "--json"])?;
            let t = judged(&d, faults);
            if !t.inside {
                let of = |f: &str| ["lo", "estimate", "hi"].map(|k| d[f][k].as_f64().unwrap_or(f64::NAN));
                eprintln!(
                    "  {} at {faults:?}: fsj {:?}, zeta {:?}",
                    t.outcome,
                    of("fsj"),
                    of("zeta")
                );
            }
            own.push(t);
        }
        let mut own_above = 0;
        for n in 0..3 {
            let test = path(&format!("fresh_{n}.csv"));
            independent::record(
                &unit,
                &Motion::Preflight,
                SECONDS,
                RATE_HZ,
                (1.0, 0.0),
                true,
                own_seed ^ ((n + 20) << 32),
            )
            .write_csv(Path::new(&test))?;
            let (_, d, _) = run(ema, &cache, &["diagnose", &test, "--unit", &file, "--json"])?;
            own_above += usize::from(d["fsj"]["lo"].as_f64().is_some_and(|x| x > HEALTHY));
        }
        above = (above.0 + own_above, above.1 + 3);
        let width = |i: usize, relative: bool| {
            quantile(
                own.iter()
                    .filter_map(|t| Some(t.found?[i] / if relative { 0.01 * t.fsj } else { 1.0 })),
                0.5,
            )
        };
        let line = format!(
            "| {k} | {} | {verdict} | {} | {} | {} | {:.2} | {:.4} | {own_above} of 3 |\n",
            effect.unwrap_or("nothing"),
            shown["healthy_tests"],
            percent(own.iter().filter(|t| t.inside).count(), own.len()),
            own.iter().filter(|t| t.outcome != "located").count(),
            width(0, true),
            width(2, false),
        );
        eprint!("{line}");
        out += &line;
        all.extend(own);
        if !keep {
            std::fs::remove_dir_all(&folder)?;
        }
    }
    let located = || all.iter().filter(|t| t.outcome == "located");
    let off = |by: f64| {
        let beyond = |f: [f64; 4]| f[1].abs() > by * f[0] || f[3].abs() > by * f[2];
        located().filter(|t| t.found.is_some_and(beyond)).count()
    };
    let outside = located().filter(|t| !t.inside).count();
    let _ = writeln!(
        out,
        "\n- truth inside both intervals: {} % of all {}, {} % of those located\n- located, truth outside: {} %; off by more than the \
         interval is wide: {} %, twice: {} %\n- not located: {} %\n- width of FSJ, median (95th percentile): {:.2} % ({:.2} %)\n- healthy \
         tests above FSJ {HEALTHY}: {} of {}",
        percent(all.iter().filter(|t| t.inside).count(), all.len()),
        all.len(),
        percent(located().filter(|t| t.inside).count(), located().count()),
        percent(outside, all.len()),
        percent(off(1.0), all.len()),
        percent(off(2.0), all.len()),
        percent(all.len() - located().count(), all.len()),
        quantile(located().filter_map(|t| Some(100.0 * t.found?[0] / t.fsj)), 0.5),
        quantile(located().filter_map(|t| Some(100.0 * t.found?[0] / t.fsj)), 0.95),
        above.0,
        above.1
    );
    Ok(out)
}
