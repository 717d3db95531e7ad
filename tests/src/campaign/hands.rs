//! Cases of other hands: servo rigs of `second`, recordings of our actuator by `independent`. The exact set of names counts.

use super::options::Options;
use super::parameters::{Deviation, deviations};
use super::run;
use super::tables::{median, rate, shown, table};
use super::truth::{Hidden, Said};
use crate::{independent, second};
use anyhow::{Context, Result, anyhow, bail};
use pipeline::discrepancy::Request;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// What is true of a case.
struct Truth {
    hidden: Vec<Hidden>,
    constants: BTreeMap<String, f64>,
    rig: String,
}

/// What was said of it.
struct Judged {
    truth: Truth,
    said: Said,
    /// name of the constant, whether its interval holds the truth
    constants: Vec<(String, bool)>,
    deviations: Vec<Deviation>,
}

fn hidden<'a>(name: &str, parameters: impl Iterator<Item = (&'a str, f64)>, phases: bool) -> Hidden {
    // the actuator's generator has the dead time of one leg, the study that of the two that conduct
    let legs = if phases && name == "dead_time" { 2.0 } else { 1.0 };
    Hidden {
        name: name.into(),
        parameters: parameters.map(|(k, v)| (k.into(), legs * v)).collect(),
        comparable: true,
    }
}

/// Writes a case; its recordings or bench file, and the key.
fn made(options: &Options, folder: &Path, case: u64) -> Result<(Vec<PathBuf>, Truth)> {
    let seed = options.seed * 1000 + case;
    if options.bed.as_deref() == Some("servo") {
        let class = second::class_for(&options.class, options.effect.as_deref(), case as usize, seed)?;
        let key = second::make(folder, &class, options.strength, seed)?;
        let of =
            |(name, p): &(String, Vec<(String, f64)>)| hidden(name, p.iter().map(|(k, v)| (k.as_str(), *v)), false);
        let truth = Truth {
            hidden: key.hidden.iter().map(of).collect(),
            constants: key.constants.into_iter().collect(),
            rig: key.rig,
        };
        return Ok((vec![folder.join("bench.toml")], truth));
    }
    let names = independent::EFFECTS;
    let effect = match (options.class.as_str(), &options.effect) {
        ("nothing", _) => None,
        ("one", None) => Some(names[case as usize % names.len()]),
        ("one", Some(e)) => Some(*names.iter().find(|n| *n == e).ok_or_else(|| anyhow!("no effect {e}"))?),
        (other, _) => bail!("--class {other}: the actuator has nothing or one"),
    };
    let key = independent::make(folder, effect, options.strength, seed)?;
    let truth = Truth {
        hidden: key
            .effect
            .iter()
            .map(|e| hidden(e.name, e.parameters.iter().copied(), true))
            .collect(),
        // the study's resistance and inductance are of two phases in series
        constants: key
            .constants
            .iter()
            .map(|(k, v)| {
                (
                    k.to_string(),
                    if ["resistance", "inductance"].contains(k) {
                        2.0 * v
                    } else {
                        *v
                    },
                )
            })
            .collect(),
        rig: String::new(),
    };
    Ok((vec![folder.join("a.csv"), folder.join("b.csv")], truth))
}

/// Makes a case, studies it and opens its key.
fn one(options: &Options, case: u64, pool: &rayon::ThreadPool) -> Result<Judged> {
    let folder = options.out.join("hands").join(case.to_string());
    let (bench, truth) = made(options, &folder, case)?;
    let request = Request {
        bench,
        healthy: true,
        ..Request::default()
    };
    let (mut report, study_s) = run::studied(&request, pool);
    report["case"] = json!(case);
    report["study_s"] = json!(study_s);
    if options.keep {
        std::fs::write(folder.join("report.json"), format!("{report:#}"))?;
        let of = |h: &Hidden| {
            (
                h.name.clone(),
                json!(h.parameters.iter().cloned().collect::<BTreeMap<_, _>>()),
            )
        };
        let key: Value = truth.hidden.iter().map(of).collect();
        let key = json!({ "hidden": key, "constants": truth.constants });
        std::fs::write(folder.join("key.json"), format!("{key:#}"))?;
    } else {
        std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
    }
    let said = Said::read(&report);
    Ok(Judged {
        deviations: deviations(&said, &truth.hidden),
        constants: held(&report["retuned"], &truth.constants),
        said,
        truth,
    })
}

/// Constants of the report that the key knows, and whether their intervals hold.
fn held(retuned: &Value, truth: &BTreeMap<String, f64>) -> Vec<(String, bool)> {
    let one = |(name, p): (&String, &Value)| {
        let x = truth.get(name)?;
        Some((name.clone(), p["lo"].as_f64()? <= *x && *x <= p["hi"].as_f64()?))
    };
    retuned.as_object().into_iter().flatten().filter_map(one).collect()
}

fn names<'a>(all: impl Iterator<Item = &'a str>) -> BTreeSet<&'a str> {
    all.collect()
}

impl Judged {
    fn wanted(&self) -> BTreeSet<&str> {
        names(self.truth.hidden.iter().map(|h| h.name.as_str()))
    }

    fn told(&self) -> BTreeSet<&str> {
        names(self.said.effects.iter().map(|e| e.name.as_str()))
    }

    /// How it ended: `right`, `misnamed` (names, none of them hidden), `further` (one too many), `part`, `unknown`, `missed`
    /// (`none`, `retune`) or `refused`.
    fn end(&self, class: &str) -> &'static str {
        let (wanted, told) = (self.wanted(), self.told());
        let verdict = self.said.verdict.as_str();
        match class {
            _ if verdict == "error" => "refused",
            "outside" if verdict == "unknown" => "right",
            "outside" if !told.is_empty() => "misnamed",
            "nothing" if !told.is_empty() => "misnamed",
            "nothing" if ["none", "retune"].contains(&verdict) => "right",
            _ if verdict == "unknown" => "unknown",
            _ if told.is_empty() => "missed",
            _ if wanted == told => "right",
            _ if wanted.is_subset(&told) => "further",
            _ if told.is_subset(&wanted) => "part",
            // both names stand there, as things that cannot be told apart
            _ if self.said.is_ambiguous()
                && wanted.iter().all(|w| {
                    let set = |e: &super::truth::Found| e.name == *w || e.ambiguous_with.iter().any(|a| a == w);
                    self.said.effects.iter().any(set)
                })
                && told.len() == wanted.len() =>
            {
                "right"
            }
            _ => "misnamed",
        }
    }

    fn line(&self, class: &str) -> String {
        let list = |s: BTreeSet<&str>| s.into_iter().collect::<Vec<_>>().join("+");
        let gap = self.said.gap.map_or(f64::NAN, |g| g.last);
        format!(
            "{} {:8} hidden {:24} told {} {} (gap {gap:.2}, {:.1} s) {} {}",
            self.said.case,
            self.end(class),
            list(self.wanted()),
            self.said.verdict,
            list(self.told()),
            self.said.study_s,
            self.truth.rig,
            self.said.error.as_deref().unwrap_or("")
        )
    }
}

/// Makes, studies and judges `options.cases` cases; a line each on the error stream, the table in return.
pub fn bench(options: &Options) -> Result<String> {
    let bed = options.bed.as_deref().unwrap_or_default();
    if !["servo", "actuator"].contains(&bed) {
        bail!("--bed {bed}: servo or actuator");
    }
    let next = AtomicU64::new(0);
    let done = Mutex::new(Vec::new());
    let worker = || -> Result<()> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        loop {
            let case = next.fetch_add(1, Ordering::Relaxed);
            if case >= options.cases {
                return Ok(());
            }
            let j = one(options, case, &pool)?;
            let mut done = done.lock().unwrap_or_else(|e| e.into_inner());
            // a closed error stream is no reason to stop
            let _ = writeln!(std::io::stderr(), "{}", j.line(&options.class));
            done.push(j);
        }
    };
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..options.jobs).map(|_| scope.spawn(worker)).collect();
        let ends = workers
            .into_iter()
            .map(|w| w.join().unwrap_or_else(|_| bail!("the generator panicked")));
        ends.collect::<Result<Vec<_>>>()
    })?;
    let mut all = done.into_inner().unwrap_or_else(|e| e.into_inner());
    all.sort_by_key(|j| j.said.case);
    Ok(report(options, bed, &all))
}

const ENDS: [&str; 7] = ["right", "misnamed", "further", "part", "unknown", "missed", "refused"];

fn report(options: &Options, bed: &str, all: &[Judged]) -> String {
    let class = options.class.as_str();
    let count = |end: &str, of: &[&Judged]| of.iter().filter(|j| j.end(class) == end).count();
    let mut groups: BTreeMap<String, Vec<&Judged>> = BTreeMap::new();
    for j in all {
        let name = j.wanted().into_iter().collect::<Vec<_>>().join(" + ");
        groups.entry(name).or_default().push(j);
    }
    let everything: Vec<&Judged> = all.iter().collect();
    let row = |name: &str, of: &[&Judged]| {
        let mut cells = vec![name.to_string(), of.len().to_string()];
        cells.extend(ENDS.map(|e| match count(e, of) {
            0 => String::new(),
            n => n.to_string(),
        }));
        let deviations = || of.iter().flat_map(|j| &j.deviations).filter(|d| !d.discrete);
        let inside = deviations().filter(|d| d.inside).count();
        cells.push(format!("{inside} of {}", deviations().count()));
        cells.push(shown(median(deviations().map(|d| 100.0 * d.error)), 2));
        cells
    };
    let mut head = vec!["hidden", "n"];
    head.extend(ENDS);
    head.extend(["intervals of effects hold", "their median error %"]);
    let mut rows: Vec<Vec<String>> = groups.iter().map(|(name, of)| row(name, of)).collect();
    rows.push(row("all", &everything));
    let mut constants: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
    for (name, inside) in all.iter().flat_map(|j| &j.constants) {
        let c = constants.entry(name).or_default();
        *c = (c.0 + usize::from(*inside), c.1 + 1);
    }
    let constants: Vec<Vec<String>> = constants
        .into_iter()
        .map(|(name, (k, n))| vec![name.into(), rate(k, n)])
        .collect();
    let n = all.len();
    format!(
        "## {bed}, {class}, strength {}, seed {}\n\nExact set of names: {} % of {n}. Median time of a study on one thread {} s.\n\n{}\n{}",
        options.strength,
        options.seed,
        rate(count("right", &everything), n),
        shown(median(all.iter().map(|j| j.said.study_s)), 1),
        table(&head, &rows),
        table(&["constant", "interval holds %"], &constants),
    )
}
