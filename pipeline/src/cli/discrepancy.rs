//! `ema discrepancy`.

use super::{MODEL, OUTPUT, RECORDING, say};
use crate::Findings;
use crate::case::{self, Case};
use crate::discrepancy::{self, Request};
use crate::progress;
use anyhow::Result;
use clap::Args;
use diagnoser::diagnosis::Outcome;
use diagnoser::report::versioned;
use ema_study::measured::bench::is_recording;
use ema_study::told::verify::Verification;
use schemas::error::{EXIT_LOSS, Error};
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct DiscrepancyArgs {
    /// The actuator's parameters, a TOML file, or `reference`
    ///
    /// What the simulation believes. A bench file does without for a rig that is no actuator of ours; recordings of
    /// telemetry are then taken for the reference actuator's.
    // a file of parameters has this name everywhere; the first one is still understood
    #[arg(long = "actuator", alias = "model", value_name = "FILE", help_heading = MODEL)]
    model: Option<PathBuf>,
    /// What was measured: a bench file (datasets/benches/README.md), or one or more recordings of telemetry
    #[arg(long, required = true, num_args = 1.., value_name = "FILE", help_heading = RECORDING)]
    bench: Vec<PathBuf>,
    /// Which column of the recordings is which channel, and in what unit: the section [channels] of a bench file
    #[arg(long, value_name = "BENCH.toml", help_heading = RECORDING)]
    channels: Option<PathBuf>,
    /// The machine was healthy in all that was recorded: what is proven may be written into its model
    #[arg(long, help_heading = RECORDING)]
    healthy: bool,
    /// Also simulate the recorded command, with the model as it was and with what was found
    ///
    /// By the test bench and the simplified model. Recordings of telemetry always are; of a bench file, where --actuator
    /// is the actuator that was recorded.
    #[arg(long, help_heading = OUTPUT)]
    verify: bool,
    /// Then diagnose these pre-flight tests of the same actuator
    ///
    /// With the model that was written, or with the model as it was where none was written.
    #[arg(long, help_heading = OUTPUT, num_args = 1.., value_name = "RECORDING", requires = "out")]
    diagnose: Vec<PathBuf>,
    /// Folder for report.html, report.json, and actuator.toml or model.toml; nothing is written if left out
    ///
    /// actuator.toml is the file of --actuator with what was found, sensors.toml, where it is written too, its sensors as they
    /// were seen; without one, model.toml has constants and effects of the
    /// rig. Both only where held-out data prove them and all runs are said to be healthy.
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    out: Option<PathBuf>,
    /// report.json on standard output (schemas/json/discrepancy.schema.json)
    #[arg(long, help_heading = OUTPUT)]
    json: bool,
}

pub fn discrepancy(a: &DiscrepancyArgs) -> Result<ExitCode> {
    let shown = progress::spinner("discrepancy");
    let tell = |text: &str| shown.set_message(text);
    let request = Request {
        model: a.model.clone(),
        bench: a.bench.clone(),
        healthy: a.healthy,
        verify: a.verify,
        channels: a.channels.clone(),
    };
    if !a.diagnose.is_empty() && a.model.is_none() && !a.bench.iter().all(|b| is_recording(b)) {
        let allowed = "--actuator: the actuator that was tested";
        return Err(Error::bad("command line", "--diagnose", "no --actuator", allowed).into());
    }
    let study = discrepancy::study(&request, a.out.as_deref(), &tell)?;
    drop(shown);
    let mut cases = Vec::new();
    for test in &a.diagnose {
        let case = discrepancy::diagnose(&study, test)?;
        cases.extend(case.map(|c| (test.as_path(), c)));
    }
    if a.json {
        let json = discrepancy::to_json(&study.findings, (!a.diagnose.is_empty()).then_some(cases.as_slice()));
        say(&serde_json::to_string_pretty(&versioned(json))?);
    } else {
        say(&to_text(&study.findings));
        let json = study.report.as_ref().map(|r| r.with_extension("json"));
        for path in [study.report, json, study.model, study.rig].into_iter().flatten() {
            say(&format!("written: {}", path.display()));
        }
        for (test, c) in &cases {
            say(&format!(
                "\ndiagnosis of {}\n{}",
                test.display(),
                case::to_text(c, None)
            ));
        }
    }
    let incomplete = |c: &Case| matches!(c.diagnosis.outcome, Outcome::Incomplete { .. });
    Ok(if cases.iter().any(|(_, c)| incomplete(c)) {
        ExitCode::from(EXIT_LOSS)
    } else {
        ExitCode::SUCCESS
    })
}

/// The findings on a terminal.
fn to_text(f: &Findings) -> String {
    let mut t = format!("{}\n{}\n", f.verdict.replace('_', " ").to_uppercase(), f.sentence);
    for e in &f.effects {
        t += &format!(
            "\n{}   ({} equation; explains {:.0} % of the gap without it)\n",
            e.name,
            e.equation,
            100.0 * e.explained_share
        );
        for p in &e.parameters {
            t += &(row(12, 8, &p.name, &p.unit, [p.value, p.lo, p.hi]) + "\n");
        }
        if let Some(law) = e.law_in_words() {
            t += &format!("  {law}\n");
        }
        if let Some(r) = &e.runner_up {
            t += &format!("  runner-up: {r}\n");
        }
        if !e.ambiguous_with.is_empty() {
            t += &format!("  cannot be told from: {}\n", e.ambiguous_with.join(", "));
        }
    }
    if !f.findings.is_empty() {
        t += "\nof a unit whose health nobody vouches for\n";
        for x in &f.findings {
            t += &(row(12, 8, &x.name, &x.unit, [x.value, x.lo, x.hi]) + &format!("   {}\n", x.meaning));
        }
    }
    if f.effects.is_empty() && f.verdict != "none" || !f.effects.is_empty() {
        t += "\nconstants\n";
        for p in &f.retuned {
            let nominal = p.nominal.map_or(String::new(), |n| format!(" (was {:.5})", Short(n)));
            t += &(row(16, 12, &p.name, &p.unit, [p.value, p.lo, p.hi]) + &nominal + "\n");
        }
    }
    if !f.by_channel.is_empty() {
        t += "\ngap (rms)                     nominal    re-tuned       final       floor\n";
        for c in &f.by_channel {
            for (what, g) in [("fit", Some(c.fit)), ("held-out", c.heldout)] {
                if let Some(g) = g {
                    t += &format!(
                        "  {:14} {:9} {:>11.4} {:>11.4} {:>11.4} {:>11.4} {}\n",
                        c.channel,
                        what,
                        Short(g.nominal),
                        Short(g.retuned),
                        Short(g.last),
                        Short(g.floor),
                        c.unit
                    );
                }
            }
        }
    }
    if let Some(v) = f.verification.as_ref() {
        t += &verification(v);
    }
    if !f.regions.is_empty() {
        t += "\nwhere (before any effect was added)\n";
        for r in f.regions.iter().take(5) {
            t += &format!("  {}\n", r.text);
        }
    }
    if let Some(u) = &f.unnamed {
        t += &format!("\n{u}\n");
    }
    if !f.not_excited.is_empty() {
        t += "\nnot excited\n";
        for (name, why) in &f.not_excited {
            t += &format!("  {name}: {why}\n");
        }
    }
    for (name, what) in &f.missing {
        t += &format!("missing: {name} would open {what}\n");
    }
    match &f.next_command {
        Some(c) => t += &format!("\nnext: {c}\n  {}\n", f.next_reason),
        None => t += &format!("\nnext: {}\n", f.next_reason),
    }
    t
}

/// The simulators under the recorded command, on a terminal.
fn verification(v: &Verification) -> String {
    let mut t = String::new();
    if !v.channels.is_empty() {
        let of = if v.heldout { "held-out" } else { "fit" };
        t += &format!("\nsimulated under the recorded command, {of} (rms)\n");
        t += "                       test bench: before       after   simplified: before       after\n";
        for c in &v.channels {
            let simple = c
                .simplified
                .map_or(String::new(), |(a, b)| format!("{:>21.4} {:>11.4}", Short(a), Short(b)));
            t += &format!(
                "  {:18} {:>21.4} {:>11.4}{simple} {}\n",
                c.channel,
                Short(c.parent),
                Short(c.child),
                c.unit
            );
        }
    }
    for l in &v.left_out {
        t += &format!("  not simulated: {l}\n");
    }
    t
}

/// A value with its unit and 95 % interval, in columns.
///
/// * `wide`, `unit_wide` of name and unit, in characters
/// * `number` value, lower and upper end
fn row(wide: usize, unit_wide: usize, name: &str, unit: &str, number: [f64; 3]) -> String {
    let [value, lo, hi] = number.map(Short);
    format!("  {name:wide$} {value:>12.5} {unit:unit_wide$} 95 % {lo:.5} to {hi:.5}")
}

/// A number with some significant digits.
struct Short(f64);

impl std::fmt::Display for Short {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let digits = f.precision().unwrap_or(4);
        let x = self.0;
        let text = if x != 0.0 && (x.abs() < 1e-3 || x.abs() >= 1e6) {
            format!("{x:.*e}", digits - 1)
        } else {
            let before = if x == 0.0 {
                1
            } else {
                (x.abs().log10().floor() as i32 + 1).max(1) as usize
            };
            format!("{x:.*}", digits.saturating_sub(before))
        };
        f.pad_integral(true, "", &text)
    }
}
