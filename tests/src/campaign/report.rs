//! The report: verdicts beside their keys.

use super::parameters::{Deviation, deviations};
use super::plan::Plan;
use super::score::{self, Score};
use super::store;
use super::tables::{median, rate, shown, table};
use super::truth::{self, Gap, Hidden, Said};
use super::{run, score::wilson};
use crate::blind::{Class, Rig, Setting};
use anyhow::{Context, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// A case with its key opened.
pub struct Judged {
    pub said: Said,
    pub hidden: Vec<Hidden>,
    pub score: Score,
    pub deviations: Vec<Deviation>,
}

/// All cases of a class.
pub struct Classed {
    pub plan: Plan,
    pub fingerprint: String,
    pub seed: u64,
    pub cases: Vec<Judged>,
}

impl Classed {
    fn count(&self, f: impl Fn(&Judged) -> bool) -> usize {
        self.cases.iter().filter(|c| f(c)).count()
    }

    fn verdicts(&self, verdict: &str) -> usize {
        self.count(|c| c.said.verdict == verdict)
    }

    fn gap(&self, f: impl Fn(&Gap) -> f64) -> Option<f64> {
        median(self.cases.iter().filter_map(|c| c.said.gap.as_ref()).map(f))
    }

    fn deviations(&self) -> impl Iterator<Item = &Deviation> {
        self.cases.iter().flat_map(|c| &c.deviations)
    }

    fn error(&self) -> Option<f64> {
        median(self.deviations().filter(|d| !d.discrete).map(|d| d.error))
    }

    /// Intervals that hold, of all.
    fn coverage(&self) -> (usize, usize) {
        let measured = || self.deviations().filter(|d| !d.discrete);
        (measured().filter(|d| d.inside).count(), measured().count())
    }
}

/// Opens the keys of all cases that have a verdict.
pub fn judged(out: &Path, plans: &[Plan]) -> Result<Vec<Classed>> {
    let mut all = Vec::new();
    for plan in plans {
        let path = run::results_path(out, plan);
        let stored = store::read(&path).with_context(|| path.display().to_string())?;
        let mut cases = Vec::new();
        for (n, line) in &stored.cases {
            let Some(hidden) = truth::open_key(&run::key_path(out, plan, *n)) else {
                eprintln!("{}, case {n}: no key; left out", plan.label());
                continue;
            };
            cases.push(judge(plan.class, Said::read(line), hidden));
        }
        if !cases.is_empty() {
            all.push(Classed {
                plan: *plan,
                fingerprint: stored.fingerprint,
                seed: stored.seed,
                cases,
            });
        }
    }
    Ok(all)
}

fn judge(class: Class, said: Said, hidden: Vec<Hidden>) -> Judged {
    Judged {
        score: score::score(class, &said, &hidden),
        deviations: deviations(&said, &hidden),
        said,
        hidden,
    }
}

/// The whole report.
pub fn report(all: &[Classed]) -> String {
    let mut out = String::from("# Blind test bed of the discrepancy study\n\n");
    if all.is_empty() {
        return out + "No case has a verdict yet.\n";
    }
    out += &facts(all);
    out += "\n## Rates\n\nPer cent with 95 % Wilson bounds. Wrong: misnamed; with nothing hidden, a false alarm.\n\n";
    out += &rates(all);
    out += "\n## Wanted\n\n";
    out += &wanted(all);
    out += "\n## Verdicts\n\nFurther: right, with a name that is not hidden beside it. One of two: no other name.\n\n";
    out += &verdicts(all);
    out += "\n## Gap, parameters, time\n\nMedians. Gap on held-out runs over the floor, drive channel. Parameters of \
            effects that were named, where the law is the list's: relative errors, phases in rad, places over their \
            width. Intervals: share of true values inside. Whole numbers (of a phase, orders that were not refined) apart.\n\n";
    out += &numbers(all);
    for c in all {
        out += &format!("\n## {}\n\n", c.plan.label());
        out += &confusion(c);
        out += &by_parameter(c);
        out += &errors(c);
    }
    out
}

/// Time that all cases took [min].
fn minutes(all: &[Classed]) -> f64 {
    let cases = all.iter().flat_map(|c| &c.cases).map(|c| &c.said);
    let seconds = cases.map(|s| (s.generate_s + s.study_s) / s.jobs.max(1) as f64);
    seconds.filter(|t| t.is_finite()).sum::<f64>() / 60.0
}

fn facts(all: &[Classed]) -> String {
    let cases = || all.iter().flat_map(|c| &c.cases).map(|c| &c.said);
    let mut ways: Vec<String> = cases()
        .map(|s| format!("{} side by side with {} threads each", s.jobs, s.threads))
        .collect();
    ways.sort();
    ways.dedup();
    let mut programs: Vec<String> = all
        .iter()
        .map(|c| format!("{}, seed {}", c.fingerprint, c.seed))
        .collect();
    programs.sort();
    programs.dedup();
    let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
    format!(
        "{} cases, {:.1} min on {cores} cores ({}). Program {}.\n",
        cases().count(),
        minutes(all),
        ways.join("; "),
        programs.join("; ")
    )
}

fn rates(all: &[Classed]) -> String {
    let row = |c: &Classed| {
        let n = c.cases.len();
        let right = c.count(|j| j.score.right);
        let wrong = c.count(|j| j.score.wrong);
        let ambiguous = c.count(|j| j.said.is_ambiguous());
        let separated = c.count(|j| j.said.is_ambiguous() && j.said.has_command);
        vec![
            c.plan.label(),
            n.to_string(),
            rate(right, n),
            rate(wrong, n),
            rate(n - right - wrong, n),
            rate(ambiguous, n),
            format!("{separated} of {ambiguous}"),
        ]
    };
    let head = [
        "class",
        "n",
        "right",
        "wrong",
        "missed",
        "ambiguity sets",
        "with a command",
    ];
    table(&head, &all.iter().map(row).collect::<Vec<_>>())
}

/// The figures that the project asks for, beside those reached.
fn wanted(all: &[Classed]) -> String {
    let mut rows = Vec::new();
    let percent = |k: usize, n: usize| 100.0 * k as f64 / n.max(1) as f64;
    for c in all {
        let n = c.cases.len();
        let right = percent(c.count(|j| j.score.right), n);
        let wrong = percent(c.count(|j| j.score.wrong), n);
        let bounds = |k: usize| {
            let (lo, hi) = wilson(k, n);
            format!(" [{:.1}, {:.1}]", 100.0 * lo, 100.0 * hi)
        };
        let mut add = |what: &str, bound: String, reached: String, met: bool| {
            let met = if met { "yes" } else { "NO" };
            rows.push(vec![c.plan.label(), what.to_string(), bound, reached, met.to_string()]);
        };
        let mut at_least = |least: f64| {
            let k = c.count(|j| j.score.right);
            let reached = format!("{right:.1}{}", bounds(k));
            add("right %", format!(">= {least}"), reached, right >= least);
        };
        let weak = c.plan.severity < 1.0;
        match (c.plan.class, c.plan.setting) {
            (Class::Nothing, _) => {}
            (Class::One, _) if weak => at_least(80.0),
            (Class::One, Setting::Matched) => at_least(97.0),
            (Class::One | Class::Outside, _) => at_least(92.0),
            (Class::Two, _) => at_least(85.0),
        }
        let most = match c.plan.class {
            Class::Nothing => Some(("false alarms %", 2.0)),
            Class::One if weak => Some(("wrong %", 3.0)),
            Class::Outside => Some(("misnamed %", 3.0)),
            _ => None,
        };
        if let Some((what, most)) = most {
            let reached = format!("{wrong:.1}{}", bounds(c.count(|j| j.score.wrong)));
            add(what, format!("<= {most}"), reached, wrong <= most);
        }
        if c.plan.class != Class::One {
            continue;
        }
        let sets = c.count(|j| j.said.is_ambiguous());
        let share = percent(sets, n);
        add(
            "ambiguity sets %",
            "<= 10".into(),
            format!("{share:.1}{}", bounds(sets)),
            share <= 10.0,
        );
        if weak || c.plan.rig != Rig::Servo {
            continue;
        }
        let most = if c.plan.setting == Setting::Matched { 1.02 } else { 1.10 };
        let gap = c.gap(|g| g.last);
        let met = gap.is_some_and(|g| g <= most);
        add("held-out gap over floor", format!("<= {most:.2}"), shown(gap, 3), met);
        let error = c.error().map(|e| 100.0 * e);
        let met = error.is_some_and(|e| e <= 2.0);
        add("parameter error %", "<= 2".into(), shown(error, 2), met);
        let (k, n) = c.coverage();
        let held = percent(k, n);
        let met = (90.0..=99.0).contains(&held);
        add("intervals that hold %", "90 to 99".into(), rate(k, n), met);
    }
    let times = all.iter().flat_map(|c| &c.cases).map(|c| c.said.study_s);
    let time = median(times);
    let met = if time.is_some_and(|t| t < 4.0) { "yes" } else { "NO" };
    rows.push(
        ["all", "study s", "< 4", &shown(time, 2), met]
            .map(str::to_string)
            .to_vec(),
    );
    let spent = minutes(all);
    let met = if spent <= 60.0 { "yes" } else { "NO" };
    rows.push(
        ["all", "campaign min", "<= 60", &shown(Some(spent), 1), met]
            .map(str::to_string)
            .to_vec(),
    );
    table(&["class", "figure", "wanted", "reached", "met"], &rows)
}

const VERDICTS: [&str; 7] = [
    "none",
    "retune",
    "named",
    "named_with_remainder",
    "ambiguous",
    "unknown",
    "error",
];

fn verdicts(all: &[Classed]) -> String {
    let row = |c: &Classed| {
        let mut cells = vec![c.plan.label()];
        cells.extend(VERDICTS.map(|v| c.verdicts(v).to_string()));
        cells.push(c.count(|j| j.score.by_set).to_string());
        cells.push(c.count(|j| j.score.further).to_string());
        cells.push(c.count(|j| j.score.part).to_string());
        cells
    };
    let mut head = vec!["class"];
    head.extend(VERDICTS);
    head.extend(["right by set", "further", "one of two"]);
    table(&head, &all.iter().map(row).collect::<Vec<_>>())
}

fn numbers(all: &[Classed]) -> String {
    let row = |c: &Classed| {
        let (k, n) = c.coverage();
        let discrete = || c.deviations().filter(|d| d.discrete);
        vec![
            c.plan.label(),
            shown(c.gap(|g| g.nominal), 2),
            shown(c.gap(|g| g.retuned), 2),
            shown(c.gap(|g| g.last), 3),
            shown(c.error().map(|e| 100.0 * e), 2),
            rate(k, n),
            n.to_string(),
            format!(
                "{} of {}",
                discrete().filter(|d| d.error == 0.0).count(),
                discrete().count()
            ),
            shown(median(c.cases.iter().map(|j| j.said.study_s)), 2),
        ]
    };
    let head = [
        "class",
        "gap nominal",
        "re-tuned",
        "final",
        "parameter error %",
        "intervals hold %",
        "of",
        "whole numbers right",
        "study s",
    ];
    table(&head, &all.iter().map(row).collect::<Vec<_>>())
}

/// Outcomes of a hidden effect.
#[derive(Clone, Debug, Default, PartialEq)]
struct Outcomes {
    n: usize,
    right: usize,
    set: usize,
    quiet: usize,
    unknown: usize,
    others: BTreeMap<String, usize>,
}

/// What became of one hidden effect (of nothing, where `name` is none).
fn count(o: &mut Outcomes, class: Class, j: &Judged, name: &str) {
    o.n += 1;
    let said = &j.said;
    let first_only = class == Class::One;
    let found = said
        .effects
        .iter()
        .take(if first_only { 1 } else { MANY })
        .any(|e| e.name == name);
    let right = match class {
        Class::Nothing => false,
        Class::Outside => j.score.right && said.verdict != "unknown",
        _ => found,
    };
    match said.verdict.as_str() {
        "none" | "retune" => o.quiet += 1,
        "unknown" => o.unknown += 1,
        "error" => *o.others.entry("error".into()).or_default() += 1,
        _ if right => o.right += 1,
        _ if class != Class::Nothing && class != Class::Outside && score::in_set(said, name) => o.set += 1,
        _ => {
            let is_hidden = |n: &str| class == Class::Two && j.hidden.iter().any(|h| h.name == n);
            let names: Vec<&str> = said
                .effects
                .iter()
                .map(|e| e.name.as_str())
                .filter(|n| !is_hidden(n))
                .collect();
            let names = if names.is_empty() {
                "only the other".into()
            } else {
                names.join(" + ")
            };
            *o.others.entry(names).or_default() += 1;
        }
    }
}

/// More effects than a study adds.
const MANY: usize = 100;

fn outcomes(c: &Classed) -> BTreeMap<&str, Outcomes> {
    let mut rows: BTreeMap<&str, Outcomes> = BTreeMap::new();
    for j in &c.cases {
        if j.hidden.is_empty() {
            count(rows.entry("(nothing)").or_default(), c.plan.class, j, "");
        }
        for h in &j.hidden {
            count(rows.entry(&h.name).or_default(), c.plan.class, j, &h.name);
        }
    }
    rows
}

fn confusion(c: &Classed) -> String {
    let cell = |n: usize| if n == 0 { String::new() } else { n.to_string() };
    let rows: Vec<Vec<String>> = outcomes(c)
        .into_iter()
        .map(|(name, o)| {
            let others: Vec<String> = o.others.iter().map(|(n, k)| format!("{n} {k}")).collect();
            let [right, set, quiet, unknown] = [o.right, o.set, o.quiet, o.unknown].map(cell);
            vec![
                name.to_string(),
                o.n.to_string(),
                right,
                set,
                quiet,
                unknown,
                others.join(", "),
            ]
        })
        .collect();
    let right = if c.plan.class == Class::Outside {
        "family, with remainder"
    } else {
        "right"
    };
    table(
        &[
            "hidden",
            "n",
            right,
            "in set",
            "none or re-tuned",
            "unknown",
            "other names",
        ],
        &rows,
    )
}

/// Errors and intervals of each parameter.
fn by_parameter(c: &Classed) -> String {
    let mut groups: BTreeMap<(&str, &str), Vec<&Deviation>> = BTreeMap::new();
    for d in c.deviations().filter(|d| !d.discrete) {
        groups.entry((&d.effect, &d.parameter)).or_default().push(d);
    }
    if groups.is_empty() {
        return String::new();
    }
    let rows: Vec<Vec<String>> = groups
        .into_iter()
        .map(|((effect, parameter), all)| {
            let error = median(all.iter().map(|d| 100.0 * d.error));
            let inside = all.iter().filter(|d| d.inside).count();
            let held = format!("{inside} of {}", all.len());
            vec![format!("{effect}, {parameter}"), shown(error, 2), held]
        })
        .collect();
    format!("\n{}", table(&["parameter", "median error %", "intervals hold"], &rows))
}

/// What the study refused, and how often.
fn errors(c: &Classed) -> String {
    let mut all: BTreeMap<&str, Vec<u64>> = BTreeMap::new();
    for j in &c.cases {
        if let Some(e) = &j.said.error {
            all.entry(e).or_default().push(j.said.case);
        }
    }
    let line = |(e, cases): (&str, Vec<u64>)| format!("\nNo verdict in case {cases:?}: {e}\n");
    all.into_iter().map(line).collect()
}

#[cfg(test)]
#[path = "report_tests.rs"]
mod tests;
