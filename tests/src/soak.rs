//! A soak: diagnoser, publishers, bridge and subscribers are killed at random moments, again and again, with the log on. Nothing may
//! hang, no diagnosis may be wrong, none that was reported may be missing in the log, no stream may have two, runs that no kill
//! touched are located exactly as offline, and nothing is left at the end but what is documented.

use crate::stream::{Program, TestDomain};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schemas::feature::Feature;
use schemas::stream::diagnosis::{DiagnosisMessage, DiagnosisSubscriber};
use schemas::stream::frame::{BEGIN, END};
use schemas::stream::subscriber::Subscriber;
use schemas::stream::wire::from_text;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// How long the diagnosis of a run that nobody disturbed may take: a diagnoser that has just started reads its maps first.
const OWED: Duration = Duration::from_secs(10);

/// Longest time that a run may take: beyond it something hangs.
const HANG: Duration = Duration::from_secs(60);

/// The argument that makes [`listen`] of the soak's program.
pub const LISTENER: &str = "--listen";

/// A stream: name of its actuator, number of the pass.
type StreamName = (String, u64);

/// Who is killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Victim {
    Diagnoser,
    Publisher,
    /// a third process that subscribes to telemetry and diagnoses
    Subscriber,
    /// of the bridge
    Sender,
    /// of the bridge
    Receiver,
}

impl Victim {
    const ALL: [Self; 5] = [
        Self::Diagnoser,
        Self::Publisher,
        Self::Subscriber,
        Self::Sender,
        Self::Receiver,
    ];
}

/// What a soak has seen.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Soaked {
    pub kills: BTreeMap<Victim, u64>,
    /// of the diagnoser's: at the moment when its final diagnosis was heard of
    pub kills_on_hearing: u64,
    pub runs: u64,
    /// of them over the bridge
    pub bridged: u64,
    /// runs that no kill touched (that of a subscriber touches none), begun when whoever had been killed was there again
    pub untouched: u64,
    /// those of them that were located once, exactly as offline
    pub exact: u64,
    /// the others of them, and how often each was located exactly
    pub inexact: BTreeMap<u64, u64>,
    /// other runs that no kill touched, begun before whoever had been killed was there again (any subscriber's answer begins a stream, so
    /// that the diagnoser may come late), or beside a bridge that was connecting again: it sends again what it is not sure of, so that
    /// a run may come twice, or while an earlier one of the same name is under way
    pub begun_early: u64,
    /// those of them that were not located once
    pub early_inexact: u64,
    /// located diagnoses that are not the offline one, heard or logged
    pub wrong: u64,
    /// runs that a kill touched and that were located, exactly, all the same
    pub saved: u64,
    pub located: u64,
    pub incomplete: u64,
    pub other: u64,
    /// final diagnoses that were heard by a subscriber that lived through all
    pub heard: u64,
    /// that were printed
    pub shown: u64,
    pub logged: u64,
    /// heard or printed, and not in the log
    pub lost: Vec<String>,
    /// streams with two final diagnoses, heard or logged
    pub doubled: Vec<String>,
    /// what hung
    pub hangs: Vec<String>,
    /// publishers that ended with a failure though nothing was killed
    pub failures: Vec<String>,
    /// shared memory and files left after the last end
    pub leaks: Vec<String>,
}

impl Soaked {
    pub fn kills(&self) -> u64 {
        self.kills.values().sum()
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
        for (what, list) in [
            ("hangs", &self.hangs),
            ("reported and not in the log", &self.lost),
            ("two final diagnoses", &self.doubled),
            ("left", &self.leaks),
        ] {
            no(!list.is_empty(), format!("{what}: {list:?}"));
        }
        let share = self.exact as f64 / self.untouched.max(1) as f64;
        no(
            self.untouched == 0 || share < 0.99,
            format!(
                "{} of {} untouched runs exact; located so often: {:?}; {:?}",
                self.exact, self.untouched, self.inexact, self.failures
            ),
        );
        v
    }
}

/// The programs and data of a soak.
pub struct Soak<'a> {
    /// the program `ema`
    pub ema: &'a Path,
    /// a program that is [`listen`] when its first argument is [`LISTENER`]
    pub listener: &'a Path,
    pub cache: &'a Path,
    /// where the log goes, `.jsonl` or `.parquet`, in a folder of its own
    pub log: &'a Path,
    /// a recording, and what `ema diagnose --json` says of it
    pub file: &'a Path,
    pub offline: &'a Value,
}

/// A subscriber of another hand: reads telemetry, answers, reads diagnoses, for ever.
pub fn listen() {
    let domain = schemas::stream::Domain::from_environment().unwrap();
    let telemetry = Subscriber::open(&domain).unwrap();
    let mut diagnoses = DiagnosisSubscriber::open(&domain, 0).unwrap();
    let mut frames = BTreeMap::new();
    println!("listening");
    loop {
        while let Ok(Some(f)) = telemetry.receive() {
            let h = *f.header();
            match h.kind {
                BEGIN => drop(telemetry.answer(&h, 0)),
                END => drop(telemetry.answer(&h, frames.remove(&h.stream).unwrap_or(0))),
                _ => *frames.entry(h.stream).or_insert(0) += u64::from(f.view().is_ok()),
            }
        }
        let _ = diagnoses.next(Duration::ZERO);
        let _ = telemetry.wait(Duration::from_millis(20));
    }
}

/// The processes: `near` publishes over the bridge to `far`, where the diagnoser and the subscriber are.
struct State<'a> {
    soak: &'a Soak<'a>,
    near: TestDomain,
    far: TestDomain,
    address: String,
    live: Program,
    subscriber: Program,
    sender: Program,
    /// connections that the sender has told of at the last kill of an end of the bridge
    connected: usize,
    /// an end of the bridge was killed in this run or the one before
    is_bridge_shaken: bool,
    receiver: Program,
    diagnoses: DiagnosisSubscriber,
    /// runs located exactly as offline
    exact: BTreeMap<u64, u64>,
    /// final diagnoses, how often heard
    heard: BTreeMap<StreamName, u64>,
    shown: Vec<StreamName>,
    seen: Soaked,
}

fn program(soak: &Soak<'_>, domain: &TestDomain, args: &[&str]) -> Program {
    let mut c = Command::new(soak.ema);
    c.env("EMA_CACHE_DIR", soak.cache)
        .env("EMA_DOMAIN", &domain.name)
        .args(args);
    Program::start(c)
}

fn live(soak: &Soak<'_>, domain: &TestDomain) -> Program {
    let log = soak.log.to_str().unwrap();
    program(soak, domain, &["live", "--json", "--timeout", "5", "--log", log])
}

fn subscriber(soak: &Soak<'_>, domain: &TestDomain) -> Program {
    let mut c = Command::new(soak.listener);
    c.env("EMA_DOMAIN", &domain.name).arg(LISTENER);
    Program::start(c)
}

fn receiver(soak: &Soak<'_>, domain: &TestDomain, address: &str) -> Program {
    let args = ["bridge", "receive", "--listen", address, "--wait", "20"];
    program(soak, domain, &args)
}

fn sender(soak: &Soak<'_>, domain: &TestDomain, address: &str) -> Program {
    program(soak, domain, &["bridge", "send", "--to", address])
}

/// How often a sender has said that it is connected.
fn connections(sender: &Program) -> usize {
    sender.errors().matches("connected to").count()
}

impl<'a> State<'a> {
    fn new(soak: &'a Soak<'a>) -> Self {
        let (near, far) = (TestDomain::default(), TestDomain::default());
        let diagnoses = DiagnosisSubscriber::open(&far.open(), 0).unwrap();
        let mut receiver = receiver(soak, &far, "127.0.0.1:0");
        let address = receiver.address(HANG);
        Self {
            live: live(soak, &far),
            subscriber: subscriber(soak, &far),
            sender: sender(soak, &near, &address),
            connected: 0,
            is_bridge_shaken: false,
            receiver,
            diagnoses,
            exact: BTreeMap::new(),
            heard: BTreeMap::new(),
            shown: Vec::new(),
            seen: Soaked::default(),
            soak,
            near,
            far,
            address,
        }
    }

    /// Takes what came within `time`; the run of the last final diagnosis.
    fn listen(&mut self, time: Duration) -> Option<u64> {
        let end = Instant::now() + time;
        let mut last = None;
        loop {
            let left = end.saturating_duration_since(Instant::now());
            // a diagnoser that was killed while it sent is no fault of ours
            let Ok(Some(m)) = self.diagnoses.next(left) else {
                if left.is_zero() {
                    return last;
                }
                continue;
            };
            if m.is_final == 0 {
                continue;
            }
            last = Some(m.run);
            *self.heard.entry((from_text(&m.actuator), m.stream)).or_default() += 1;
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
            if left.is_zero() {
                return last;
            }
        }
    }

    /// What the diagnoser has printed up to its end.
    fn read_live(&mut self) {
        for line in self.live.all_lines() {
            let Ok(v) = serde_json::from_str::<Value>(&line) else {
                // torn by the kill
                continue;
            };
            if v["final"] == true {
                self.shown.push(stream_of(&v));
            }
        }
    }

    fn kill(&mut self, victim: Victim, replay: &mut Program) -> bool {
        if victim == Victim::Publisher && replay.has_ended().is_some() {
            return false;
        }
        *self.seen.kills.entry(victim).or_default() += 1;
        match victim {
            Victim::Publisher => replay.kill(),
            Victim::Diagnoser => {
                self.live.kill();
                self.read_live();
            }
            Victim::Subscriber => self.subscriber.kill(),
            Victim::Sender => self.sender.kill(),
            Victim::Receiver => {
                self.connected = connections(&self.sender);
                self.receiver.kill();
            }
        }
        true
    }

    fn start_again(&mut self, victim: Victim) {
        match victim {
            Victim::Publisher => {}
            Victim::Diagnoser => self.live = live(self.soak, &self.far),
            Victim::Subscriber => self.subscriber = subscriber(self.soak, &self.far),
            Victim::Sender => {
                self.sender = sender(self.soak, &self.near, &self.address);
                self.connected = 0;
            }
            Victim::Receiver => self.receiver = receiver(self.soak, &self.far, &self.address),
        }
    }

    /// Whether everybody who was killed is there again.
    fn is_ready(&self) -> bool {
        self.live.errors().contains("waiting for telemetry") && connections(&self.sender) > self.connected
    }

    /// Programs that have ended though nobody killed them are started again, and named.
    fn look_after(&mut self) -> bool {
        let mut ended = Vec::new();
        for (victim, p) in [
            (Victim::Diagnoser, &mut self.live),
            (Victim::Subscriber, &mut self.subscriber),
            (Victim::Sender, &mut self.sender),
            (Victim::Receiver, &mut self.receiver),
        ] {
            if let Some(status) = p.has_ended() {
                ended.push((victim, format!("{victim:?} ended by itself ({status}): {}", p.errors())));
            }
        }
        let any = !ended.is_empty();
        for (victim, said) in ended {
            if victim == Victim::Diagnoser {
                self.read_live();
            }
            self.seen.hangs.push(said);
            self.start_again(victim);
        }
        any
    }

    /// What the log says, against what was heard and printed.
    fn compare(&mut self, logged: &[Value]) {
        let mut rows: BTreeMap<StreamName, u64> = BTreeMap::new();
        for v in logged {
            *rows.entry(stream_of(v)).or_default() += 1;
            self.seen.wrong += u64::from(v["outcome"] == "located" && !is_logged_offline(v, self.soak.offline));
        }
        let seen = &mut self.seen;
        seen.heard = self.heard.values().sum();
        seen.shown = self.shown.len() as u64;
        seen.logged = logged.len() as u64;
        for (how, list) in [
            ("heard", self.heard.keys().collect::<Vec<_>>()),
            ("printed", self.shown.iter().collect()),
        ] {
            let lost = list.into_iter().filter(|s| !rows.contains_key(s));
            seen.lost.extend(lost.map(|s| format!("{how}: {} {:016x}", s.0, s.1)));
        }
        for (how, counts) in [("heard", &self.heard), ("logged", &rows)] {
            let twice = counts.iter().filter(|(_, n)| **n > 1);
            seen.doubled
                .extend(twice.map(|(s, n)| format!("{how} {n} times: {} {:016x}", s.0, s.1)));
        }
    }
}

fn stream_of(v: &Value) -> StreamName {
    let text = |key: &str| v[key].as_str().unwrap_or_default();
    let stream = u64::from_str_radix(text("stream"), 16).unwrap_or_default();
    (text("actuator").into(), stream)
}

/// The rows of a log, keys as in its lines.
///
/// # Panics
/// A log that cannot be read.
pub fn logged(log: &Path) -> Vec<Value> {
    if log.extension().is_some_and(|x| x == "jsonl") {
        let text = std::fs::read_to_string(log).unwrap();
        return text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    }
    use arrow::array::{Array, AsArray};
    use arrow::datatypes::{Float64Type, UInt64Type};
    let mut rows = Vec::new();
    for batch in schemas::table::read_batches(log).unwrap() {
        let text = |n: &str, i: usize| batch[n].as_string::<i32>().value(i).to_string();
        let whole = |n: &str, i: usize| batch[n].as_primitive::<UInt64Type>().value(i);
        let number = |n: &str, i: usize| {
            let c = batch[n].as_primitive::<Float64Type>();
            c.is_valid(i).then(|| c.value(i))
        };
        for i in 0..batch.num_rows() {
            let interval = |f: &str| {
                let of = |part: &str| number(&format!("{f}_{part}"), i);
                serde_json::json!({"lo": of("lo"), "hi": of("hi"), "estimate": of("estimate")})
            };
            rows.push(serde_json::json!({
                "actuator": text("actuator", i),
                "stream": format!("{:016x}", whole("stream", i)),
                "run": whole("run", i),
                "outcome": text("outcome", i),
                "fsj": interval("fsj"),
                "zeta": interval("zeta"),
                "area": number("area", i),
            }));
        }
    }
    rows
}

/// Whether a row of the log has every number of the offline diagnosis.
fn is_logged_offline(row: &Value, offline: &Value) -> bool {
    ["fsj", "zeta", "area"].iter().all(|k| row[k] == offline[k])
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

/// When somebody is killed.
enum Moment {
    After(Duration),
    /// the diagnoser, as soon as its final diagnosis of the run is heard of
    OnHearing,
}

/// Kills until there have been `kills`; `tell` hears of the progress.
pub fn soak(soak: &Soak<'_>, kills: u64, seed: u64, mut tell: impl FnMut(&Soaked)) -> Soaked {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut s = State::new(soak);
    let mut runs = Vec::new();
    let mut run = 0;
    while s.seen.kills() < kills {
        run += 1;
        let fate = one_run(&mut s, run, &mut rng);
        s.seen.runs += 1;
        runs.push((run, fate));
        // received is not diagnosed: a kill before the diagnosis would touch the run after all
        let end = Instant::now() + OWED;
        while fate == Fate::Untouched && !s.exact.contains_key(&run) && Instant::now() < end {
            s.listen(Duration::from_millis(20));
        }
        tell(&s.seen);
    }
    s.listen(Duration::from_millis(300));
    let of = |fate: Fate| {
        let runs = runs.iter().filter(move |r| r.1 == fate);
        runs.map(|(r, _)| (*r, s.exact.get(r).copied().unwrap_or(0)))
    };
    let (untouched, begun_early) = (of(Fate::Untouched).count() as u64, of(Fate::BegunEarly).count() as u64);
    let inexact: BTreeMap<u64, u64> = of(Fate::Untouched).filter(|(_, n)| *n != 1).collect();
    let early_inexact = of(Fate::BegunEarly).filter(|(_, n)| *n != 1).count() as u64;
    let saved = of(Fate::Touched).filter(|(_, n)| *n > 0).count() as u64;
    s.seen = Soaked {
        untouched,
        exact: untouched - inexact.len() as u64,
        inexact,
        begun_early,
        early_inexact,
        saved,
        ..s.seen
    };
    end(s, run + 1)
}

/// What a run went through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Untouched,
    /// begun before whoever had been killed was there again
    BegunEarly,
    /// by a kill while it ran
    Touched,
}

/// Replays the recording once, here or over the bridge, and perhaps kills.
fn one_run(s: &mut State<'_>, run: u64, rng: &mut ChaCha8Rng) -> Fate {
    let number = run.to_string();
    // half of the runs wait for whoever was killed; what the others begin without them is theirs to suffer
    let start = Instant::now();
    let patience = if rng.random_bool(0.5) { OWED } else { Duration::ZERO };
    while !s.is_ready() && start.elapsed() < patience {
        s.listen(Duration::from_millis(2));
    }
    let connected = connections(&s.sender);
    let mut begun_early = std::mem::take(&mut s.is_bridge_shaken) || !s.is_ready();
    let speed = ["max", "max", "40", "15"][rng.random_range(0..4)];
    let frame = ["1", "5", "10", "50"][rng.random_range(0..4)];
    let is_bridged = rng.random_bool(0.5);
    s.seen.bridged += u64::from(is_bridged);
    let domain = if is_bridged { &s.near } else { &s.far };
    let file = s.soak.file.to_str().unwrap();
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
    let mut replay = program(s.soak, domain, &args);
    let start = Instant::now();
    let mut touched = false;
    // who is killed during this run (half of the time nobody), and when: while the programs start, or later
    let mut victims = Vec::new();
    if rng.random_bool(0.5) {
        victims.push(Victim::ALL[rng.random_range(0..Victim::ALL.len())]);
        if rng.random_bool(0.2) {
            victims.push(Victim::ALL[rng.random_range(0..Victim::ALL.len())]);
        }
        victims.sort();
        victims.dedup();
    }
    let longest = [30_000, 400_000][rng.random_range(0..2)];
    let mut moment = Some(Moment::After(Duration::from_micros(rng.random_range(0..longest))));
    if victims.contains(&Victim::Diagnoser) && rng.random_bool(0.5) {
        moment = Some(Moment::OnHearing);
    }
    moment = moment.filter(|_| !victims.is_empty());
    loop {
        let heard = s.listen(Duration::from_millis(2));
        let now = match &moment {
            Some(Moment::After(t)) => start.elapsed() >= *t,
            Some(Moment::OnHearing) => heard == Some(run),
            None => false,
        };
        if now {
            s.seen.kills_on_hearing += u64::from(matches!(moment, Some(Moment::OnHearing)));
            moment = None;
            for v in &victims {
                // nobody waits for a subscriber that is dead, and its death is no excuse
                touched |= s.kill(*v, &mut replay) && *v != Victim::Subscriber;
                s.is_bridge_shaken |= [Victim::Sender, Victim::Receiver].contains(v);
            }
            // sometimes there is nobody for a while
            s.listen(Duration::from_millis(rng.random_range(0..100)));
            victims.iter().for_each(|v| s.start_again(*v));
        }
        if let Some(status) = replay.has_ended() {
            // on hearing: the moment has not come yet
            if matches!(moment, Some(Moment::OnHearing)) && start.elapsed() < OWED && status.code() == Some(0) {
                continue;
            }
            if !touched && !begun_early && status.code() != Some(0) {
                s.seen.failures.push(format!("run {run}: {}", replay.errors()));
            }
            begun_early |= connections(&s.sender) > connected;
            return match (touched, begun_early) {
                (true, _) => Fate::Touched,
                (false, true) => Fate::BegunEarly,
                (false, false) => Fate::Untouched,
            };
        }
        if start.elapsed() > HANG {
            let said = format!("run {run}: {} / {}", replay.errors(), s.live.errors());
            s.seen.hangs.push(said);
            replay.kill();
            s.live.kill();
            s.read_live();
            s.start_again(Victim::Diagnoser);
            return Fate::Touched;
        }
        touched |= s.look_after();
    }
}

/// The last restart, a run in peace, and a proper end of everybody.
fn end(mut s: State<'_>, run: u64) -> Soaked {
    s.live.kill();
    s.read_live();
    s.start_again(Victim::Diagnoser);
    let (number, file) = (run.to_string(), s.soak.file.to_str().unwrap());
    let mut replay = program(s.soak, &s.far, &["replay", file, "--speed", "max", "--run", &number]);
    if replay.ends_within(HANG).is_none() {
        s.seen.hangs.push("the run after the last restart".into());
    }
    s.listen(Duration::from_millis(300));
    s.subscriber.kill();
    for (what, p) in [
        ("sender", &mut s.sender),
        ("receiver", &mut s.receiver),
        ("diagnoser", &mut s.live),
    ] {
        p.interrupt();
        if p.ends_within(HANG).is_none() {
            s.seen.hangs.push(format!("the {what} does not stop"));
        }
    }
    s.read_live();
    s.listen(Duration::from_millis(50));
    let rows = logged(s.soak.log);
    s.compare(&rows);
    let State {
        near,
        far,
        diagnoses,
        mut seen,
        soak,
        ..
    } = s;
    drop(diagnoses);
    // what the killed ones left is removed by whoever comes next
    near.open().clean();
    far.open().clean();
    let mut left: Vec<PathBuf> = near.segments();
    left.extend(far.segments());
    left.extend(beside(soak.log));
    seen.leaks = left.iter().map(|p| p.display().to_string()).collect();
    seen
}

/// What lies beside a log and is not documented: of a table its lock and its journal stay.
fn beside(log: &Path) -> Vec<PathBuf> {
    let name = log.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let documented = [name.clone(), format!(".{name}.lock"), format!(".{name}.journal")];
    let entries = std::fs::read_dir(log.parent().unwrap()).into_iter().flatten().flatten();
    let all = entries.map(|e| e.path());
    all.filter(|p| {
        !documented
            .iter()
            .any(|d| p.file_name().is_some_and(|n| n.to_string_lossy() == *d))
    })
    .collect()
}
