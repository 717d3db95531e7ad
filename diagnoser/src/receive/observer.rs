//! For those who watch over the process: numbers in the text format of Prometheus, and the notifications of
//! systemd (ready, and alive again and again).

use super::words::{Complain, Counts};
use schemas::error::write_whole;
use std::fmt::Write;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::PathBuf;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Between two writings of the numbers.
const EVERY: Duration = Duration::from_secs(5);

/// What there is to know of the process.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct State {
    pub counts: Counts,
    pub open_streams: u64,
    pub lost_samples: u64,
    pub ready_maps: u64,
    pub making: u64,
    pub log_kept: u64,
    pub log_dropped: u64,
}

impl State {
    /// The numbers, a line each, with what they are.
    fn text(&self) -> String {
        let c = &self.counts;
        let mut text = String::new();
        let mut say = |name: &str, kind: &str, help: &str, values: &[(&str, u64)]| {
            let _ = writeln!(text, "# HELP ema_{name} {help}\n# TYPE ema_{name} {kind}");
            for (label, value) in values {
                let _ = writeln!(text, "ema_{name}{label} {value}");
            }
        };
        let outcomes = [
            ("{outcome=\"located\"}", c.located),
            ("{outcome=\"unexplained\"}", c.unexplained),
            ("{outcome=\"out_of_range\"}", c.out_of_range),
            ("{outcome=\"incomplete\"}", c.incomplete),
        ];
        say("diagnoses_total", "counter", "final diagnoses", &outcomes);
        let one = |value| [("", value)];
        say("frames_total", "counter", "frames received", &one(c.frames));
        say("frames_refused_total", "counter", "frames of no stream", &one(c.strays));
        say(
            "streams_open",
            "gauge",
            "streams without a final diagnosis",
            &one(self.open_streams),
        );
        let help = "samples that never came, of the streams that are remembered";
        say("samples_lost", "gauge", help, &one(self.lost_samples));
        say("maps_ready", "gauge", "map sets in memory", &one(self.ready_maps));
        say(
            "maps_making",
            "gauge",
            "map sets that are made or wait for it",
            &one(self.making),
        );
        say(
            "log_kept",
            "gauge",
            "diagnoses not written to the log yet",
            &one(self.log_kept),
        );
        say(
            "log_dropped_total",
            "counter",
            "diagnoses dropped from the log",
            &one(self.log_dropped),
        );
        text
    }
}

/// Tells those who watch.
pub(super) struct Observer {
    /// to the thread that writes: a slow disk delays nobody
    file: Option<SyncSender<String>>,
    written: Option<Instant>,
    systemd: Option<UnixDatagram>,
}

impl Observer {
    /// * `metrics` file of the numbers
    pub fn new(metrics: Option<PathBuf>, complain: Complain) -> Self {
        Self {
            file: metrics.map(|path| writing(path, complain)),
            written: None,
            systemd: std::env::var("NOTIFY_SOCKET").ok().and_then(|name| connect(&name)),
        }
    }

    /// Streams are taken from now on.
    pub fn ready(&self) {
        self.notify("READY=1");
    }

    /// The process goes on; called several times a second.
    pub fn tick(&mut self, state: &State) {
        self.notify("WATCHDOG=1");
        if let Some(file) = &self.file
            && self.written.is_none_or(|t| t.elapsed() > EVERY)
        {
            self.written = Some(Instant::now());
            let _ = file.try_send(state.text());
        }
    }

    fn notify(&self, text: &str) {
        if let Some(socket) = &self.systemd {
            let _ = socket.send(text.as_bytes());
        }
    }
}

/// The socket of systemd's notifications; a name that begins with @ is an abstract one.
fn connect(name: &str) -> Option<UnixDatagram> {
    let address = match name.strip_prefix('@') {
        Some(name) => SocketAddr::from_abstract_name(name),
        None => SocketAddr::from_pathname(name),
    };
    let socket = UnixDatagram::unbound().ok()?;
    socket.connect_addr(&address.ok()?).ok()?;
    socket.set_nonblocking(true).ok()?;
    Some(socket)
}

/// A thread that writes texts to a file, each whole.
fn writing(path: PathBuf, complain: Complain) -> SyncSender<String> {
    let (sender, receiver) = sync_channel::<String>(1);
    std::thread::spawn(move || {
        let mut is_told = false;
        for text in receiver {
            // readers see the old text or the new one
            if let Err(e) = write_whole(&path, text.as_bytes())
                && !is_told
            {
                is_told = true;
                complain(&e.to_string());
            }
        }
    });
    sender
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_numbers_are_those_of_the_process_and_in_the_format() {
        let mut counts = Counts {
            frames: 7,
            ..Counts::default()
        };
        counts.concluded(&crate::diagnosis::Outcome::OutOfRange { reason: String::new() });
        let state = State {
            counts,
            making: 3,
            ..State::default()
        };
        let text = state.text();
        for line in [
            "ema_frames_total 7",
            "ema_diagnoses_total{outcome=\"out_of_range\"} 1",
            "ema_diagnoses_total{outcome=\"located\"} 0",
            "# TYPE ema_maps_making gauge",
            "ema_maps_making 3",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} in {text}");
        }
        let path = std::env::temp_dir().join(format!("ema-metrics-{}.prom", std::process::id()));
        let numbers = writing(path.clone(), std::sync::Arc::new(|text: &str| panic!("{text}")));
        numbers.send(text.clone()).unwrap();
        while std::fs::read_to_string(&path).is_err() {
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn prop_systemd_hears_that_the_process_is_ready_and_alive() {
        let path = std::env::temp_dir().join(format!("ema-notify-{}", std::process::id()));
        let _ = std::fs::remove_file(&path);
        let socket = UnixDatagram::bind(&path).unwrap();
        let mut observer = Observer {
            file: None,
            written: None,
            systemd: connect(path.to_str().unwrap()),
        };
        observer.ready();
        observer.tick(&State::default());
        let mut buffer = [0; 64];
        for expected in ["READY=1", "WATCHDOG=1"] {
            let n = socket.recv(&mut buffer).unwrap();
            assert_eq!(std::str::from_utf8(&buffer[..n]).unwrap(), expected);
        }
        std::fs::remove_file(&path).unwrap();
        assert!(connect("/nowhere/at/all").is_none());
    }
}
