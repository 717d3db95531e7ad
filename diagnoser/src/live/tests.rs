//! Laws of the live diagnosis, frame by frame: which maps are made, and what is said twice.

use super::*;
use schemas::stream::frame::{BEGIN, END, SAMPLES};

/// A publisher of samples that stand still.
struct Source {
    live: Live,
    rows: usize,
}

impl Source {
    fn new() -> Self {
        Self {
            live: Live::new(Known {
                actuators: vec![Arc::new(ActuatorParameters::reference())],
                sequences: vec![sim_worker::catalogue::sequence("preflight").unwrap()],
                sensors: vec![("none".into(), Default::default())],
                units: Default::default(),
            }),
            rows: 100,
        }
    }

    fn header(&self, name: &str, rate_hz: f64, stream: u64) -> FrameHeader {
        let about = RunDescription {
            actuator: name.into(),
            parameters: self.live.known.actuators[0].fingerprint(),
            sensors: "none".into(),
            sequence: self.live.known.sequences[0].fingerprint(),
            run: 1,
            rate_hz,
            channels: ChannelSet::basic(),
            total_rows: 0,
            load_n_m: 0.0,
        };
        FrameHeader {
            stream,
            ..about.header()
        }
    }

    fn frame(&mut self, header: FrameHeader, kind: u32, frame: u64) {
        let mut header = FrameHeader { kind, frame, ..header };
        if kind == SAMPLES {
            header.set_rows((frame - 1) * self.rows as u64 + 1, self.rows);
        }
        let payload = vec![0.0; header.values().max(8)];
        self.live.frame(&header, &payload, 7, &|_| true, frame);
    }

    /// Sends `frames` frames, and says that there are no saved maps.
    fn send(&mut self, name: &str, rate_hz: f64, frames: u64) -> FrameHeader {
        let header = self.header(name, rate_hz, 1);
        self.frame(header, BEGIN, 0);
        for k in 1..=frames {
            self.frame(header, SAMPLES, k);
            let wishes: Vec<MapKey> = self.live.wishes().collect();
            wishes.iter().for_each(|k| self.live.no_saved_maps(k));
        }
        header
    }

    fn reasons(&mut self) -> Vec<String> {
        while self.live.work() {}
        let reports = self.live.reports();
        let finals = reports.filter(|r| r.is_final);
        finals.map(|r| r.diagnosis.outcome.reason().to_string()).collect()
    }
}

#[test]
fn prop_short_streams_never_have_maps_made() {
    let mut s = Source::new();
    s.rows = 8;
    for k in 0..6 {
        let h = s.send(&format!("rig-{k}"), 9000.5 + k as f64, 1);
        s.frame(h, END, 2);
    }
    let reasons = s.reasons();
    assert_eq!(reasons.len(), 6, "{reasons:?}");
    assert!(
        reasons.iter().all(|r| r.contains("none are made for 8 samples")),
        "{reasons:?}"
    );
    assert_eq!((s.live.to_make().count(), s.live.making()), (0, 0));
}

#[test]
fn prop_maps_are_asked_for_after_half_a_test_and_only_so_many_at_once() {
    let mut s = Source::new();
    // 3 s at 1 kHz: half is 1500 samples
    s.send("early", 1000.0, 14);
    assert_eq!(s.live.to_make().count(), 0);
    let half = s.send("half", 1000.5, 16);
    assert_eq!(s.live.to_make().count(), 1);
    for k in 0..MOST_MAKING + 1 {
        s.send(&format!("rig-{k}"), 1100.0 + k as f64, 18);
    }
    assert_eq!(s.live.to_make().count(), MOST_MAKING - 1);
    assert_eq!(s.live.making(), MOST_MAKING);
    // beyond the bound it is said at the end of the stream, and those that wait for maps go on waiting
    let beyond = s.header(&format!("rig-{MOST_MAKING}"), 1100.0 + MOST_MAKING as f64, 1);
    s.frame(beyond, END, 19);
    s.frame(half, END, 17);
    let reasons = s.reasons();
    assert_eq!(reasons.len(), 1, "{reasons:?}");
    assert!(reasons[0].contains("4 other map sets are being made"), "{reasons:?}");
    // one is ready: the stream that was refused before would be taken now
    let key = s.live.tracks[&(half.actuator, half.stream)].maps().unwrap().clone();
    s.live.maps(&key, Err("no such maps".into()));
    assert!(s.reasons()[0].contains("no such maps"));
    assert_eq!(s.live.making(), MOST_MAKING - 1);
}

#[test]
fn prop_a_concluded_stream_is_not_diagnosed_again() {
    let mut s = Source::new();
    let header = s.header("rig", 1000.0, 9);
    s.live.already_concluded([(header.actuator, 9)]);
    s.frame(header, SAMPLES, 29);
    s.frame(header, END, 31);
    s.live.stop();
    assert_eq!(s.reasons(), Vec::<String>::new());
    assert_eq!((s.live.open_streams(), s.live.is_streaming()), (0, false));
    // another pass of the same run is another stream
    let other = s.header("rig", 1000.0, 10);
    s.frame(other, END, 31);
    assert_eq!(s.reasons().len(), 1);
    // and is not diagnosed again either, when it has been forgotten
    s.live.tracks.clear();
    s.frame(other, END, 31);
    assert_eq!(s.reasons().len(), 0);
}

#[test]
fn prop_counters_saturate() {
    let mut s = Source::new();
    let mut header = s.header("rig", 1000.0, 1);
    header.total_rows = u64::MAX;
    s.frame(header, BEGIN, 0);
    s.frame(header, END, u64::MAX);
    assert_eq!(s.reasons().len(), 1);
    assert_eq!(s.live.lost_samples(), u64::MAX - 1);
    let status = &s.live.statuses()[0];
    assert_eq!((status.samples, status.lost), (u64::MAX, u64::MAX - 1));
}

#[test]
fn refuse_rates_and_kinds_of_tests_that_would_take_all_memory() {
    let mut s = Source::new();
    let mut only = |name: &str, rate_hz: f64| {
        let header = s.header(name, rate_hz, 1);
        s.frame(header, BEGIN, 0);
        s.frame(header, END, 1);
    };
    only("thz", 4_294_967_296_000.0);
    only("slow", 999.0);
    // eleven plans of three million samples, and no more
    for k in 0..14 {
        only(&format!("odd-{k}"), 1e6 - f64::from(k));
    }
    let reasons = s.reasons();
    assert_eq!(reasons.len(), 16, "{reasons:?}");
    let said = |words: &str| reasons.iter().filter(|r| r.contains(words)).count();
    assert_eq!(said("allowed: 1000 to 1000000 Hz"), 2, "{reasons:?}");
    assert_eq!(said("too many other kinds of tests"), 3, "{reasons:?}");
}
