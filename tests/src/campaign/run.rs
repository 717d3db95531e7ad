//! Makes and studies the cases that are not done yet.

use super::options::Options;
use super::plan::Plan;
use super::store::{Opened, Store};
use super::truth;
use crate::blind;
use anyhow::{Context, Result, bail};
use pipeline::discrepancy::Request;
use rayon::ThreadPool;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::fs::File;
use std::hash::{DefaultHasher, Hasher};
use std::io::{IsTerminal, Read, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// The actuator that every case is studied against.
fn model() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../datasets/parameters/reference.toml")
}

/// Of this program, with generator and study in it, and of the model.
pub fn fingerprint() -> Result<String> {
    let mut hasher = DefaultHasher::new();
    for path in [std::env::current_exe()?, model()] {
        let mut file = File::open(&path).with_context(|| path.display().to_string())?;
        let mut piece = vec![0; 1 << 20];
        loop {
            match file.read(&mut piece)? {
                0 => break,
                n => hasher.write(&piece[..n]),
            }
        }
    }
    Ok(format!("{:016x}", hasher.finish()))
}

/// Results of a class.
pub fn results_path(out: &Path, plan: &Plan) -> PathBuf {
    out.join("results").join(format!("{}.jsonl", plan.slug()))
}

/// Key of a case.
pub fn key_path(out: &Path, plan: &Plan, case: u64) -> PathBuf {
    out.join("keys").join(plan.slug()).join(format!("{}.json", name(case)))
}

fn name(case: u64) -> String {
    format!("case-{case:04}")
}

/// Speed and what is left, on the error stream.
struct Progress {
    start: Instant,
    todo: usize,
    state: Mutex<(usize, Instant)>,
    terminal: bool,
}

impl Progress {
    fn new(todo: usize) -> Self {
        let start = Instant::now();
        Self {
            start,
            todo,
            state: Mutex::new((0, start)),
            terminal: std::io::stderr().is_terminal(),
        }
    }

    fn tick(&self, label: &str) {
        let mut state = self.state.lock().unwrap_or_else(|e| e.into_inner());
        state.0 += 1;
        let done = state.0;
        let pause = Duration::from_millis(if self.terminal { 200 } else { 10_000 });
        if done < self.todo && state.1.elapsed() < pause {
            return;
        }
        state.1 = Instant::now();
        let t = self.start.elapsed().as_secs_f64();
        let left = t / done as f64 * (self.todo - done) as f64;
        let text = format!(
            "{done}/{} cases, {label}, {:.2} a second, {} left",
            self.todo,
            done as f64 / t.max(1e-3),
            clock(left)
        );
        let mut stderr = std::io::stderr();
        // an error stream that is closed is no reason to stop
        let _ = match (self.terminal, done == self.todo) {
            (true, false) => write!(stderr, "\r{text}\x1b[K"),
            (true, true) => writeln!(stderr, "\r{text}\x1b[K"),
            (false, _) => writeln!(stderr, "{text}"),
        };
    }
}

fn clock(seconds: f64) -> String {
    let s = seconds.round() as u64;
    if s < 60 {
        format!("{s} s")
    } else {
        format!("{} min {:02} s", s / 60, s % 60)
    }
}

/// One class at work.
struct Work<'a> {
    plan: &'a Plan,
    store: Store,
}

/// Makes and studies all that is missing. Stopped at any time, it goes on there.
pub fn run(options: &Options, plans: &[Plan]) -> Result<()> {
    std::fs::create_dir_all(&options.out).with_context(|| options.out.display().to_string())?;
    let lock = File::create(options.out.join("lock"))?;
    // one that was just killed takes a moment to die
    let mut tries = (0..20).map(|_| std::thread::sleep(Duration::from_millis(100)));
    while lock.try_lock().is_err() {
        if tries.next().is_some() {
            continue;
        }
        bail!("another campaign is at work in {}", options.out.display());
    }
    let data = options.out.join("data");
    if !options.keep && data.exists() {
        // left behind by one that was stopped
        std::fs::remove_dir_all(&data)?;
    }
    let fingerprint = fingerprint()?;
    let mut works = Vec::new();
    let mut todo = VecDeque::new();
    for plan in plans {
        let path = results_path(&options.out, plan);
        let opened = Store::open(&path, &fingerprint, options.seed).with_context(|| path.display().to_string())?;
        let Opened {
            store,
            stored,
            replaced,
        } = opened;
        if let Some(old) = replaced {
            eprintln!(
                "{}: results of another program or seed, now in {}; the class starts anew",
                plan.label(),
                old.display()
            );
        }
        let has_key = |n: u64| truth::open_key(&key_path(&options.out, plan, n)).is_some();
        let missing = (0..plan.count(options.cases)).filter(|n| !stored.cases.contains_key(n) || !has_key(*n));
        todo.extend(missing.map(|n| (works.len(), n)));
        works.push(Work { plan, store });
    }
    let jobs = options.jobs.min(todo.len()).max(1);
    let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
    let threads = (cores / jobs).max(1);
    eprintln!(
        "{} cases to do, {jobs} side by side, {threads} threads a study",
        todo.len()
    );
    let progress = Progress::new(todo.len());
    let todo = Mutex::new(todo);
    let take = || todo.lock().unwrap_or_else(|e| e.into_inner()).pop_front();
    // a pool for each: a study that waits must not begin another inside its own time
    let worker = || -> Result<()> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        while let Some((w, case)) = take() {
            let Work { plan, store } = &works[w];
            let label = plan.label();
            let mut line = one(options, plan, case, &pool).with_context(|| format!("{label}, case {case}"))?;
            line["threads"] = json!(threads);
            line["jobs"] = json!(jobs);
            store.append(&line)?;
            progress.tick(&label);
        }
        Ok(())
    };
    let end = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs).map(|_| scope.spawn(worker)).collect();
        let mut end = Ok(());
        for w in workers {
            let own = w.join().unwrap_or_else(|_| bail!("the generator panicked"));
            if own.is_err() {
                // the others end after the case they are at
                todo.lock().unwrap_or_else(|e| e.into_inner()).clear();
            }
            end = end.and(own);
        }
        end
    });
    if !options.keep && data.exists() {
        std::fs::remove_dir_all(&data)?;
    }
    end
}

/// Makes a case, studies its files and says what the study says.
fn one(options: &Options, plan: &Plan, case: u64, pool: &ThreadPool) -> Result<Value> {
    let dir = options.out.join("data").join(plan.slug()).join(name(case));
    let keys = options.out.join("keys").join(plan.slug());
    let seed = plan.seed(options.seed, case);
    let start = Instant::now();
    blind::case(seed, &plan.spec()).write(&dir, &keys)?;
    let generate_s = start.elapsed().as_secs_f64();
    let bench = dir.join("BENCH.toml");
    let request = Request::of(&model(), &bench);
    let (report, study_s) = studied(&request, pool);
    if !options.keep {
        std::fs::remove_dir_all(&dir)?;
    }
    let mut line = if report["error"].is_null() {
        kept(&report)
    } else {
        report
    };
    line["case"] = json!(case);
    line["seed"] = json!(seed);
    line["generate_s"] = json!(generate_s);
    line["study_s"] = json!(study_s);
    Ok(line)
}

/// A study's report, or its error in place of one; and how long it took [s].
pub(super) fn studied(request: &Request, pool: &ThreadPool) -> (Value, f64) {
    let start = Instant::now();
    let study = || pipeline::discrepancy::study_file(request, &|_| {});
    let findings = catch_unwind(AssertUnwindSafe(|| pool.install(study)));
    let study_s = start.elapsed().as_secs_f64();
    let error = |text: String| json!({ "verdict": "error", "error": text });
    let report = match findings {
        Ok(Ok(f)) => f.to_json(),
        Ok(Err(e)) => error(format!("{e:#}")),
        Err(panic) => error(format!("panic: {}", schemas::guard::words(&*panic))),
    };
    (report, study_s)
}

/// What of a report is needed to score it, now or by other rules later.
fn kept(report: &Value) -> Value {
    let names = [
        "verdict",
        "sentence",
        "effects",
        "retuned",
        "gap",
        "not_excited",
        "unnamed_share",
        "next_command",
    ];
    names.iter().map(|n| (n.to_string(), report[n].clone())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ema_study::told::findings::{ChannelGap, Findings, FoundEffect, GapLine, Identified};

    #[test]
    fn what_is_kept_is_read_back() {
        let identified = |hi| Identified {
            name: "gap".into(),
            value: 0.2,
            lo: 0.1,
            hi,
            unit: "rad".into(),
            nominal: None,
        };
        let heldout = GapLine {
            nominal: 9.0,
            retuned: 3.0,
            last: 1.5,
            floor: 1.5,
        };
        let findings = Findings {
            verdict: "ambiguous".into(),
            effects: vec![FoundEffect {
                name: "backlash".into(),
                equation: "transmission".into(),
                term: String::new(),
                parameters: vec![identified(f64::INFINITY)],
                correlation: Vec::new(),
                explained_share: 0.9,
                runner_up: None,
                ambiguous_with: vec!["compliance".into()],
                law: Default::default(),
                alias: None,
                channel: "user_position".into(),
                heldout: None,
            }],
            gap: Some(ChannelGap {
                channel: "current".into(),
                equation: "torque".into(),
                unit: "A".into(),
                fit: heldout,
                heldout: Some(heldout),
            }),
            next_command: Some("ema".into()),
            ..Findings::default()
        };
        let text = kept(&findings.to_json()).to_string();
        let said = truth::Said::read(&serde_json::from_str(&text).unwrap());
        assert!(said.is_ambiguous() && said.has_command);
        let effect = &said.effects[0];
        assert_eq!(effect.ambiguous_with, ["compliance"]);
        assert_eq!((effect.parameters[0].lo, effect.parameters[0].hi), (0.1, f64::INFINITY));
        let gap = said.gap.unwrap();
        assert_eq!((gap.nominal, gap.retuned, gap.last), (6.0, 2.0, 1.0));
    }

    #[test]
    fn times_are_told() {
        assert_eq!(clock(59.4), "59 s");
        assert_eq!(clock(125.0), "2 min 05 s");
    }
}
