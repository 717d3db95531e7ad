//! Fleet datasets made by real processes: small plans, workers and merges that are killed, stopped and started
//! again, and the files that come of it.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Beyond it something hangs.
pub const HANG: Duration = Duration::from_secs(300);

/// A test of 0.3 s, for what does not need the features of a long one.
pub const BRIEF: &str = r#"name = "brief"
segment = [
    { command = "ramp", slope_rad_per_s = 0.01, duration_s = 0.1 },
    { command = "sine", amplitude_rad = 0.001, frequency_hz = 20.0, duration_s = 0.1 },
    { command = "step", height_rad = 0.2, duration_s = 0.1 },
]
"#;

/// Another one.
pub const SHORT: &str = r#"name = "short"
segment = [
    { command = "hold", value_rad = 0.0, duration_s = 0.05 },
    { command = "step", height_rad = -0.1, duration_s = 0.1 },
]
"#;

pub const GRID: &str = "name = \"small\"\nfsj = [1.0, 2.5]\nzeta = [0.0, 0.3]\n";

/// Three actuators, two sequences, two rest angles, tests, sensors, thinned telemetry: 15 parts.
pub const VARIED: &str = r#"name = "varied"
seed = 7
sequences = ["brief.toml", "short.toml"]
grid = "grid.toml"
rest_angle_deg = [0.0, 12.5]
sensors = "reference"

[aircraft]
tails = { prefix = "T", count = 3 }
positions = ["rudder"]

[spread]
phase_resistance_ohm = { distribution = "uniform", half_width_relative = 0.05, source = "assumed" }
inertia_kg_m2 = { distribution = "normal", sd_relative = 0.02, source = "assumed" }
backlash_half_width_rad = { distribution = "lognormal", sd_log = 0.3, source = "assumed" }

[[actuators]]
tail = "T2"
position = "rudder"
phase_resistance_ohm = 1.11

[tests]
per_actuator = 3

[telemetry]
rate_hz = 2500.0
"#;

/// Without sensors and telemetry: 12 parts.
pub const BARE: &str = r#"name = "bare"
sequences = ["brief.toml"]
grid = "grid.toml"

[aircraft]
tails = { prefix = "T", count = 12 }
positions = ["rudder"]

[spread]
phase_resistance_ohm = { distribution = "uniform", half_width_relative = 0.05, source = "assumed" }
"#;

/// Files below a folder with their bytes.
pub type Files = BTreeMap<String, Vec<u8>>;

/// Everything below a folder, hidden and temporary files included.
pub fn files(root: &Path) -> Files {
    let mut found = Files::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = fs::read_dir(&folder) else { continue };
        for path in entries.flatten().map(|e| e.path()) {
            if path.is_dir() {
                folders.push(path);
            } else if let Ok(bytes) = fs::read(&path) {
                let name = path.strip_prefix(root).expect("below");
                found.insert(name.display().to_string(), bytes);
            }
        }
    }
    found
}

/// Copies a folder.
pub fn copy(from: &Path, to: &Path) {
    for (name, bytes) in files(from) {
        let path = to.join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(path, bytes).expect("a file");
    }
}

/// Panics with the names of what differs.
pub fn same(found: &Files, wanted: &Files) {
    let lost: Vec<_> = wanted.keys().filter(|k| !found.contains_key(*k)).collect();
    let more: Vec<_> = found.keys().filter(|k| !wanted.contains_key(*k)).collect();
    let other: Vec<_> = found
        .iter()
        .filter(|(k, v)| wanted.get(*k).is_some_and(|w| w != *v))
        .map(|(k, _)| k)
        .collect();
    assert!(
        lost.is_empty() && more.is_empty() && other.is_empty(),
        "missing {lost:?}, too many {more:?}, different {other:?}"
    );
}

/// How a process ended.
#[derive(Debug)]
pub struct Ended {
    pub status: ExitStatus,
    pub out: String,
    pub err: String,
}

impl Ended {
    /// Exit code; minus the signal that ended it.
    pub fn code(&self) -> i32 {
        let signal = || self.status.signal().map_or(i32::MIN, |s| -s);
        self.status.code().unwrap_or_else(signal)
    }

    /// Standard output of a process that ended well.
    pub fn done(self) -> String {
        assert_eq!(self.code(), 0, "{self:?}");
        self.out
    }

    /// The only line on standard error of a process that ended with `code`.
    pub fn line(&self, code: i32) -> &str {
        assert_eq!(self.code(), code, "{self:?}");
        let line = self.err.trim_end();
        let one = !line.is_empty() && !line.contains('\n') && line.starts_with("sim-worker: ");
        assert!(one && !line.contains("panicked"), "{self:?}");
        line
    }
}

/// A running process; killed when dropped.
pub struct Started {
    child: Child,
}

impl Started {
    pub fn signal(&self, name: &str) {
        let id = self.child.id().to_string();
        let _ = Command::new("kill").args([&format!("-{name}"), &id]).status();
    }

    pub fn ended(&mut self) -> bool {
        self.child.try_wait().expect("a child").is_some()
    }

    /// Waits until it has ended.
    ///
    /// # Panics
    /// Where it hangs.
    pub fn wait(mut self) -> Ended {
        let read = |pipe: Option<Box<dyn Read + Send>>| {
            std::thread::spawn(move || {
                let mut text = Vec::new();
                pipe.map(|mut p| p.read_to_end(&mut text));
                String::from_utf8_lossy(&text).into_owned()
            })
        };
        let out = read(self.child.stdout.take().map(|p| Box::new(p) as _));
        let err = read(self.child.stderr.take().map(|p| Box::new(p) as _));
        let start = Instant::now();
        while !self.ended() {
            assert!(start.elapsed() < HANG, "hangs");
            std::thread::sleep(Duration::from_millis(2));
        }
        Ended {
            status: self.child.wait().expect("a child"),
            out: out.join().expect("text"),
            err: err.join().expect("text"),
        }
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A folder with a plan, in which workers run.
pub struct Fleet {
    program: PathBuf,
    dir: TempDir,
    /// variables of all its processes
    pub env: Vec<(String, String)>,
}

impl Fleet {
    /// * `program` the worker
    /// * `plan` its text; the files of this module lie beside it
    pub fn new(program: &str, plan: &str) -> Self {
        let fleet = Self {
            program: program.into(),
            dir: tempfile::tempdir().expect("a folder"),
            env: Vec::new(),
        };
        for (name, text) in [
            ("plan.toml", plan),
            ("brief.toml", BRIEF),
            ("short.toml", SHORT),
            ("grid.toml", GRID),
        ] {
            fleet.write(name, text);
        }
        fleet
    }

    pub fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).expect("a file");
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub fn files(&self, name: &str) -> Files {
        files(&self.path(name))
    }

    /// The worker with the plan, away from what the surrounding job or cloud has set.
    pub fn command(&self, args: &[&str]) -> Command {
        self.command_of("plan.toml", args)
    }

    /// As [`Fleet::command`], with another plan.
    pub fn command_of(&self, plan: &str, args: &[&str]) -> Command {
        let mut c = Command::new(&self.program);
        for (name, _) in std::env::vars_os() {
            let text = name.to_string_lossy();
            let outer = ["SLURM_", "EMA_", "AWS_", "JOB_"];
            if outer.iter().any(|p| text.starts_with(p)) {
                c.env_remove(&name);
            }
        }
        c.args(["--plan", plan])
            .args(args)
            .envs(self.env.iter().map(|(k, v)| (k, v)))
            .current_dir(self.dir.path())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        c
    }

    pub fn start(&self, args: &[&str]) -> Started {
        Self::started(self.command(args))
    }

    /// * `command` one of [`Fleet::command`], changed
    pub fn started(mut command: Command) -> Started {
        let child = command.spawn().expect("the worker");
        Started { child }
    }

    pub fn run(&self, args: &[&str]) -> Ended {
        self.start(args).wait()
    }

    /// As one process makes it, undisturbed.
    pub fn single(&self) -> Files {
        self.run(&["--out", "single"]).done();
        self.run(&["--out", "single", "--merge"]).done();
        self.files("single")
    }

    /// Runs the shards that a merge says are missing, then merges; returns how many those were.
    pub fn complete(&self, out: &str) -> usize {
        let first = self.run(&["--out", out, "--merge"]);
        if first.code() == 0 {
            return 0;
        }
        let line = first.line(3);
        let (_, list) = line.split_once("--shard ").expect("shards to run");
        let shards: Vec<&str> = list.split(", ").collect();
        for shard in &shards {
            self.run(&["--out", out, "--shard", shard]).done();
        }
        self.run(&["--out", out, "--merge"]).done();
        shards.len()
    }
}

/// Asks every 2 ms.
///
/// # Panics
/// Where it does not come true.
pub fn until(what: &str, mut true_now: impl FnMut() -> bool) {
    let start = Instant::now();
    while !true_now() {
        assert!(start.elapsed() < HANG, "{what} does not happen");
        std::thread::sleep(Duration::from_millis(2));
    }
}
