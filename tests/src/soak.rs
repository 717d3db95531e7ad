//! A soak: diagnoser and publishers are killed at random moments, again and again. Nothing may
//! hang, no diagnosis may be wrong, runs that no kill touched are located exactly as offline, and
//! no shared memory is left at the end.

use crate::stream::{Program, TestDomain};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemas::feature::Feature;
use schemas::stream::diagnosis::{DiagnosisMessage, DiagnosisSubscriber};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// How long the diagnosis of a run that nobody disturbed may take: a diagnoser that has just started reads its maps first.
const OWED: Duration = Duration::from_secs(10);

/// Longest time that a run may take: beyond it something hangs.
const HANG: Duration = Duration::from_secs(60);

/// What a soak has seen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Soaked {
    pub kills_of_diagnosers: u64,
    pub kills_of_publishers: u64,
    pub runs: u64,
    /// runs during which nothing was killed
    pub untouched: u64,
    /// those of them that were located exactly as offline
    pub exact: u64,
    /// located diagnoses that are not the offline one
    pub wrong: u64,
    /// runs that a kill touched and that were located, exactly, all the same
    pub saved: u64,
    pub located: u64,
    pub incomplete: u64,
    pub other: u64,
    /// what hung
    pub hangs: Vec<String>,
    /// publishers that ended with a failure though nothing was killed
    pub failures: Vec<String>,
    /// shared memory left after the last restart
    pub leaks: Vec<String>,
}

impl Soaked {
    pub fn kills(&self) -> u64 {
        self.kills_of_diagnosers + self.kills_of_publishers
    }

    /// What is not as it should be, in words.
    pub fn faults(&self) -> Vec<String> {
        let mut v = Vec::new();
        let mut no = |bad: bool, text: String| {
            if bad {
                v.push(text)
            }
        };
        no(self.wrong > 0, format!("{} wrong diagnoses", self.wrong));
        no(!self.hangs.is_empty(), format!("hangs: {:?}", self.hangs));
        no(
            !self.leaks.is_empty(),
            format!("left in shared memory: {:?}", self.leaks),
        );
        let share = self.exact as f64 / self.untouched.max(1) as f64;
        no(
            self.untouched == 0 || share < 0.99,
            format!(
                "{} of {} untouched runs exact; {:?}",
                self.exact, self.untouched, self.failures
            ),
        );
        v
    }
}

/// The programs and data of a soak.
pub struct Soak<'a> {
    /// the program `ema`
    pub ema: &'a Path,
    pub cache: &'a Path,
    /// a recording, and what `ema diagnose --json` says of it
    pub file: &'a Path,
    pub offline: &'a Value,
}

struct State<'a> {
    soak: &'a Soak<'a>,
    domain: TestDomain,
    diagnoses: DiagnosisSubscriber,
    /// runs located exactly as offline
    exact: BTreeMap<u64, u64>,
    seen: Soaked,
}

impl State<'_> {
    fn program(&self, args: &[&str]) -> Program {
        let mut c = Command::new(self.soak.ema);
        c.env("EMA_CACHE_DIR", self.soak.cache)
            .env("EMA_DOMAIN", &self.domain.name)
            .args(args);
        Program::start(c)
    }

    /// Reads the diagnoses that came within `time`.
    fn listen(&mut self, time: Duration) {
        let end = Instant::now() + time;
        loop {
            let left = end.saturating_duration_since(Instant::now());
            // a diagnoser that was killed while it sent is no fault of ours
            let Ok(Some(m)) = self.diagnoses.next(left) else {
                if left.is_zero() {
                    return;
                }
                continue;
            };
            if m.is_final == 0 {
                continue;
            }
            match m.outcome {
                1 => {
                    self.seen.located += 1;
                    if is_offline(&m, self.soak.offline) {
                        *self.exact.entry(m.run).or_default() += 1;
                    } else {
                        self.seen.wrong += 1;
                    }
                }
                4 => self.seen.incomplete += 1,
                _ => self.seen.other += 1,
            }
        }
    }
}

/// Whether every number is that of the offline diagnosis.
fn is_offline(m: &DiagnosisMessage, v: &Value) -> bool {
    let pairs = [
        (m.fsj_lo, &v["fsj"]["lo"]),
        (m.fsj_hi, &v["fsj"]["hi"]),
        (m.fsj_estimate, &v["fsj"]["estimate"]),
        (m.zeta_lo, &v["zeta"]["lo"]),
        (m.zeta_hi, &v["zeta"]["hi"]),
        (m.zeta_estimate, &v["zeta"]["estimate"]),
        (m.area, &v["area"]),
    ];
    let features = |f: Feature| m.feature(f) == v["features"][f.key()].as_f64();
    pairs.iter().all(|(a, b)| b.as_f64() == Some(*a)) && Feature::TOLD.into_iter().all(features)
}

/// Kills until there have been `kills`; `tell` hears of the progress.
pub fn soak(soak: &Soak<'_>, kills: u64, seed: u64, mut tell: impl FnMut(&Soaked)) -> Soaked {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let domain = TestDomain::default();
    let diagnoses = DiagnosisSubscriber::open(&domain.open(), 0).unwrap();
    let mut s = State {
        soak,
        domain,
        diagnoses,
        exact: BTreeMap::new(),
        seen: Soaked::default(),
    };
    let file = soak.file.to_str().unwrap();
    let live_args = ["live", "--json", "--timeout", "5"];
    let mut live = s.program(&live_args);
    let mut untouched = Vec::new();
    let mut touched_runs = Vec::new();
    let mut run = 0;
    while s.seen.kills() < kills {
        run += 1;
        let number = run.to_string();
        let speed = ["max", "max", "40", "15"][rng.random_range(0..4)];
        let frame = ["1", "5", "10", "50"][rng.random_range(0..4)];
        let args = [
            "replay",
            file,
            "--speed",
            speed,
            "--frame-ms",
            frame,
            "--run",
            &number,
            "--wait",
            "20",
        ];
        let mut replay = s.program(&args);
        let start = Instant::now();
        let mut touched = false;
        // who is killed during this run, and when
        let plan = rng.random_range(0..4);
        // while the programs start, or later
        let longest = [30_000, 400_000][rng.random_range(0..2)];
        let moment = Duration::from_micros(rng.random_range(0..longest));
        let mut pending = plan > 0;
        loop {
            s.listen(Duration::from_millis(2));
            if pending && start.elapsed() >= moment {
                pending = false;
                touched = true;
                if plan != 2 {
                    live.kill();
                    s.seen.kills_of_diagnosers += 1;
                }
                if plan != 1 && replay.has_ended().is_none() {
                    replay.kill();
                    s.seen.kills_of_publishers += 1;
                }
                if plan != 2 {
                    // sometimes there is nobody for a while
                    s.listen(Duration::from_millis(rng.random_range(0..100)));
                    live = s.program(&live_args);
                }
            }
            if let Some(status) = replay.has_ended() {
                if !touched && status.code() != Some(0) {
                    s.seen.failures.push(format!("run {run}: {}", replay.errors()));
                }
                break;
            }
            if start.elapsed() > HANG {
                let said = format!("run {run}: {} / {}", replay.errors(), live.errors());
                s.seen.hangs.push(said);
                replay.kill();
                live.kill();
                live = s.program(&live_args);
                touched = true;
                break;
            }
            if let Some(status) = live.has_ended() {
                let said = format!("diagnoser ended by itself ({status}): {}", live.errors());
                s.seen.hangs.push(said);
                live = s.program(&live_args);
                touched = true;
            }
        }
        s.seen.runs += 1;
        if touched {
            touched_runs.push(run);
        } else {
            // received is not diagnosed: a kill before the diagnosis would touch the run after all
            let end = Instant::now() + OWED;
            while !s.exact.contains_key(&run) && Instant::now() < end {
                s.listen(Duration::from_millis(20));
            }
            untouched.push(run);
        }
        tell(&s.seen);
    }
    s.listen(Duration::from_millis(300));
    s.seen.untouched = untouched.len() as u64;
    s.seen.exact = untouched.iter().filter(|r| s.exact.get(r) == Some(&1)).count() as u64;
    s.seen.saved = touched_runs.iter().filter(|r| s.exact.contains_key(r)).count() as u64;
    // the last restart, and a proper end of everybody
    live.kill();
    let mut last = s.program(&live_args);
    let number = (run + 1).to_string();
    let mut replay = s.program(&["replay", file, "--speed", "max", "--run", &number]);
    if replay.ends_within(HANG).is_none() {
        s.seen.hangs.push("the run after the last restart".into());
    }
    last.interrupt();
    if last.ends_within(HANG).is_none() {
        s.seen.hangs.push("the diagnoser does not stop".into());
    }
    let State {
        domain,
        diagnoses,
        mut seen,
        ..
    } = s;
    drop(diagnoses);
    seen.leaks = domain.segments().iter().map(|p| p.display().to_string()).collect();
    seen
}
