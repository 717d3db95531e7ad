//! What a sending bridge sends, sent again with changes to a receiving bridge with a live diagnoser behind it.

use super::truth::{Taken, beside};
use crate::stream::{Program, TestDomain};
use schemas::fault::Interval;
use schemas::stream::diagnosis::{DiagnosisMessage, DiagnosisSubscriber};
use std::collections::HashSet;
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const LIMIT: Duration = Duration::from_secs(60);

/// A greeting: before anything else.
const HELLO: usize = 64;

fn start(ema: &Path, domain: &TestDomain, args: &[&str]) -> Program {
    let mut c = Command::new(ema);
    c.env("EMA_DOMAIN", &domain.name).args(args);
    Program::start(c)
}

/// The programs behind the door, one input at a time.
pub(super) struct Bridge {
    running: Mutex<Running>,
    finals: Arc<Mutex<Vec<DiagnosisMessage>>>,
    over: Arc<AtomicBool>,
    address: String,
    _domain: TestDomain,
}

struct Running {
    receiver: Program,
    live: Program,
    /// streams that have had their final diagnosis
    concluded: HashSet<([u8; 32], u64)>,
    /// words of the receiving bridge that have been looked at
    read: usize,
}

/// Greatest resident memory that a process has had [kB].
fn greatest_kb(process: u32) -> u64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = text.lines().find(|l| l.starts_with("VmHWM")).unwrap_or_default();
    line.split_whitespace().nth(1).and_then(|n| n.parse().ok()).unwrap_or(0)
}

impl Bridge {
    /// * `maps` of the reference actuator at the recordings' rate
    pub fn start(ema: &Path, maps: &Path) -> Self {
        let domain = TestDomain::default();
        let maps = maps.to_str().expect("a plain path");
        let live = start(ema, &domain, &["live", "--json", "--maps", maps, "--timeout", "3"]);
        let receive = [
            "bridge",
            "receive",
            "--listen",
            "127.0.0.1:0",
            "--wait",
            "2",
            "--idle",
            "3",
        ];
        let mut receiver = start(ema, &domain, &receive);
        let address = receiver.address(LIMIT);
        let (finals, over) = (Arc::<Mutex<Vec<_>>>::default(), Arc::<AtomicBool>::default());
        let (to, until, of) = (finals.clone(), over.clone(), domain.open());
        std::thread::spawn(move || {
            let mut diagnoses = DiagnosisSubscriber::open(&of, 0).unwrap();
            while !until.load(Ordering::Relaxed) {
                if let Ok(Some(m)) = diagnoses.next(Duration::from_millis(200))
                    && m.is_final == 1
                {
                    to.lock().unwrap().push(m);
                }
            }
        });
        let running = Running {
            receiver,
            live,
            concluded: HashSet::new(),
            read: 0,
        };
        Self {
            running: Mutex::new(running),
            finals,
            over,
            address,
            _domain: domain,
        }
    }

    /// What a sending bridge says when a recording is replayed behind it, from its greeting on.
    pub fn recorded(&self, ema: &Path, recording: &Path) -> Vec<u8> {
        let near = TestDomain::default();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let to = listener.local_addr().unwrap().to_string();
        let mut sender = start(ema, &near, &["bridge", "send", "--to", &to, "--idle", "30"]);
        let (mut from, _) = listener.accept().unwrap();
        let mut there = TcpStream::connect(&self.address).unwrap();
        let (mut answers, mut back) = (there.try_clone().unwrap(), from.try_clone().unwrap());
        std::thread::spawn(move || std::io::copy(&mut answers, &mut back));
        let said = Arc::<Mutex<Vec<u8>>>::default();
        let kept = said.clone();
        let carrying = std::thread::spawn(move || {
            let mut bytes = [0; 65536];
            while let Ok(n @ 1..) = from.read(&mut bytes) {
                kept.lock().unwrap().extend(&bytes[..n]);
                there.write_all(&bytes[..n]).unwrap();
            }
        });
        sender.until("connection", LIMIT, |p| p.errors().contains("connected to"));
        let file = recording.to_str().expect("a plain path");
        let mut replay = start(ema, &near, &["replay", file, "--speed", "max", "--frame-ms", "100"]);
        assert_eq!(replay.code(), Some(0), "{}", replay.errors());
        sender.interrupt();
        assert!(sender.ends_within(LIMIT).is_some(), "{}", sender.errors());
        carrying.join().unwrap();
        let bytes = said.lock().unwrap().clone();
        assert!(bytes.len() > HELLO);
        bytes
    }

    /// Sends the bytes of a file, and looks at what came of it.
    pub fn send(&self, file: &Path) -> Result<Taken, String> {
        let bytes = std::fs::read(file).map_err(|e| e.to_string())?;
        let mut running = self.running.lock().unwrap();
        let mut socket = TcpStream::connect(&self.address).map_err(|e| format!("connecting: {e}"))?;
        socket.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        // who is refused early closes, and does not read on
        let _ = socket.write_all(&bytes).and_then(|()| socket.shutdown(Shutdown::Write));
        let (mut answer, start) = ([0; 4096], Instant::now());
        loop {
            match socket.read(&mut answer) {
                Ok(0) => break,
                Ok(_) => {}
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    let s = start.elapsed().as_secs();
                    return Ok(Taken::Wrong(format!("the bridge holds the connection for {s} s")));
                }
                Err(_) => break,
            }
        }
        // what is said of a connection comes when it has been closed
        while running.receiver.errors_after(running.read).is_empty() && start.elapsed() < Duration::from_secs(5) {
            std::thread::sleep(Duration::from_micros(200));
        }
        running.judge(std::mem::take(&mut *self.finals.lock().unwrap()))
    }
}

impl Running {
    fn judge(&mut self, finals: Vec<DiagnosisMessage>) -> Result<Taken, String> {
        let wrong = |text: String| Ok(Taken::Wrong(text));
        for p in [&mut self.receiver, &mut self.live] {
            if let Some(status) = p.has_ended() {
                return wrong(format!("ended ({status}): {}", p.errors().replace('\n', " / ")));
            }
            let kb = greatest_kb(p.id());
            if kb > 1_000_000 {
                return wrong(format!("{kb} kB of memory"));
            }
        }
        for m in &finals {
            if !self.concluded.insert((m.actuator, m.stream)) {
                return wrong("two final diagnoses of a stream".into());
            }
            let (fsj, zeta) = ((m.fsj_lo, m.fsj_hi), (m.zeta_lo, m.zeta_hi));
            let interval = |(lo, hi)| Interval { lo, hi };
            if m.outcome == 1
                && let Some(what) = beside(interval(fsj), interval(zeta))
            {
                return wrong(what);
            }
        }
        let new = self.receiver.errors_after(self.read);
        self.read += new.len();
        if let Some(line) = new
            .iter()
            .find(|l| l.contains("damaged within") && !l.contains("frame refused"))
        {
            return wrong(line.clone());
        }
        if finals.iter().any(|m| m.outcome == 1) {
            return Ok(Taken::Right);
        }
        Err(new.last().cloned().unwrap_or("no word".into()))
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}
