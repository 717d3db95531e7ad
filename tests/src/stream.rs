//! Processes on a stream, for tests and for the soak.

use schemas::stream::frame::RunDescription;
use serde_json::Value;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A domain of shared memory for one test alone; what is left of it at the end is removed.
pub struct TestDomain {
    pub name: String,
}

impl Default for TestDomain {
    fn default() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let n = NUMBER.fetch_add(1, Ordering::Relaxed);
        Self {
            name: format!("test-{}-{n}", std::process::id()),
        }
    }
}

impl TestDomain {
    pub fn open(&self) -> schemas::stream::Domain {
        schemas::stream::Domain::new(&self.name).unwrap()
    }

    /// Files of this domain in a folder.
    fn files_in(&self, dir: &Path) -> Vec<PathBuf> {
        let prefix = format!("{}_", self.name);
        let mut found = Vec::new();
        for e in std::fs::read_dir(dir).into_iter().flatten().flatten() {
            if e.file_name().to_string_lossy().starts_with(&prefix) {
                found.push(e.path());
            }
        }
        found
    }

    /// Shared memory segments of this domain; the 16 bytes that hold the domain's state for good
    /// do not count.
    pub fn segments(&self) -> Vec<PathBuf> {
        let mut v = self.files_in(Path::new("/dev/shm"));
        v.retain(|p| !p.to_string_lossy().ends_with(".global_mgmt"));
        v
    }
}

impl Drop for TestDomain {
    fn drop(&mut self) {
        self.open().clean();
        for dir in ["/dev/shm", "/tmp/iceoryx2/nodes", "/tmp/iceoryx2/services"] {
            for f in self.files_in(Path::new(dir)) {
                let _ = std::fs::remove_file(f);
            }
        }
        // folders of nodes that died early hold files of their domain
        let nodes = std::fs::read_dir("/tmp/iceoryx2/nodes").into_iter().flatten().flatten();
        for node in nodes.map(|e| e.path()).filter(|p| p.is_dir()) {
            if !self.files_in(&node).is_empty() {
                let _ = std::fs::remove_dir_all(node);
            }
        }
    }
}

/// How a recording is announced as a stream.
///
/// # Panics
/// A table that is no recording.
pub fn announced(m: &pipeline::input::Measured, run: u64) -> RunDescription {
    RunDescription {
        actuator: "rig".into(),
        parameters: m.parameters.clone(),
        sensors: m.sensors.clone(),
        sequence: m.sequence_fingerprint.clone(),
        run,
        rate_hz: m.rate_hz,
        channels: m.telemetry.header.as_ref().expect("a recording").channels,
        total_rows: m.telemetry.rows() as u64,
        load_n_m: 0.0,
    }
}

/// Arguments of the run that the tests send; the file's name follows.
pub const EXAMPLE_RUN: [&str; 8] = ["run", "--fsj", "3", "--zeta", "0.3", "--sensors", "reference", "--out"];

/// A running program, killed when it goes out of scope.
pub struct Program {
    child: Child,
    lines: Arc<Mutex<Vec<String>>>,
    errors: Arc<Mutex<Vec<String>>>,
    reading: Option<JoinHandle<()>>,
}

fn read_lines(from: impl Read + Send + 'static) -> (Arc<Mutex<Vec<String>>>, JoinHandle<()>) {
    let lines: Arc<Mutex<Vec<String>>> = Arc::default();
    let to = lines.clone();
    let thread = std::thread::spawn(move || {
        for line in BufReader::new(from).lines().map_while(Result::ok) {
            to.lock().unwrap().push(line);
        }
    });
    (lines, thread)
}

impl Program {
    /// Starts `program` with its lines read as they come.
    pub fn start(mut program: Command) -> Self {
        let mut child = program
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (lines, reading) = read_lines(child.stdout.take().unwrap());
        let (errors, _) = read_lines(child.stderr.take().unwrap());
        let reading = Some(reading);
        Self {
            child,
            lines,
            errors,
            reading,
        }
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn lines(&self) -> Vec<String> {
        self.lines.lock().unwrap().clone()
    }

    /// All lines of a program that has ended.
    pub fn all_lines(&mut self) -> Vec<String> {
        if let Some(thread) = self.reading.take() {
            let _ = thread.join();
        }
        self.lines()
    }

    /// Lines of `--json`.
    pub fn json(&self) -> Vec<Value> {
        let lines = self.lines();
        lines.iter().filter_map(|l| serde_json::from_str(l).ok()).collect()
    }

    pub fn errors(&self) -> String {
        self.errors.lock().unwrap().join("\n")
    }

    /// Lines of [`Program::errors`], without the first ones.
    pub fn errors_after(&self, lines: usize) -> Vec<String> {
        self.errors.lock().unwrap().iter().skip(lines).cloned().collect()
    }

    /// Waits until `done` says so; what the program has said when it did not.
    pub fn until(&mut self, what: &str, limit: Duration, done: impl Fn(&Self) -> bool) {
        let start = Instant::now();
        while !done(self) {
            let ended = self.child.try_wait().unwrap();
            assert!(
                start.elapsed() < limit && ended.is_none(),
                "{what}: ended {ended:?}, said {:?} and {}",
                self.lines(),
                self.errors()
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// The address that a receiving bridge says it listens on.
    pub fn address(&mut self, limit: Duration) -> String {
        self.until("listening", limit, |p| p.errors().contains("listening on"));
        let said = self.errors();
        let line = said.lines().find(|l| l.contains("listening on"));
        line.and_then(|l| l.rsplit(' ').next()).expect("an address").into()
    }

    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    pub fn has_ended(&mut self) -> Option<ExitStatus> {
        self.child.try_wait().unwrap()
    }

    /// The exit status, or `None` when it does not end within `limit`.
    pub fn ends_within(&mut self, limit: Duration) -> Option<ExitStatus> {
        let start = Instant::now();
        loop {
            if let Some(status) = self.has_ended() {
                // the readers may have some lines yet
                std::thread::sleep(Duration::from_millis(20));
                return Some(status);
            }
            if start.elapsed() > limit {
                return None;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// The exit code of a program that must end.
    pub fn code(&mut self) -> Option<i32> {
        match self.ends_within(Duration::from_secs(60)) {
            Some(status) => status.code(),
            None => panic!("does not end: {:?} and {}", self.lines(), self.errors()),
        }
    }

    /// Asks to stop, as Ctrl-C does.
    pub fn interrupt(&self) {
        let _ = Command::new("kill").args(["-INT", &self.id().to_string()]).status();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.kill();
    }
}
