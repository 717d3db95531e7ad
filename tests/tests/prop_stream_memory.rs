//! Frames are written and read in shared memory itself, and nothing is allocated for a frame on
//! either side beyond the handle of fixed size that iceoryx2 0.10 itself allocates for each loan
//! (shown on a bare port in the same test). Over an hour of streams the diagnosing core allocates nothing for a frame, a bounded amount
//! for a diagnosis, and holds no more at the end than at the beginning. Each counts what its own thread allocates: what runs the tests
//! allocates too, at times of its own.

use diagnoser::diagnosis::{Diagnoser, Outcome};
use diagnoser::failure_map::FailureMapSet;
use diagnoser::live::{Known, Live};
use diagnoser::report::to_message;
use ema_tests::stream::TestDomain;
use ema_tests::{reference_run, reference_runs};
use schemas::channel::Channel;
use schemas::stream::frame::{BEGIN, END, FrameHeader, RunDescription, SAMPLES};
use schemas::stream::publisher::{Delivery, Publisher};
use schemas::stream::subscriber::Subscriber;
use sim_worker::parameters::ActuatorParameters;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

/// What one thread has allocated.
#[derive(Clone, Copy)]
struct Count {
    allocations: u64,
    bytes: u64,
    /// Bytes allocated less bytes given back.
    held: i64,
}

thread_local! {
    static COUNT: Cell<Count> = const { Cell::new(Count { allocations: 0, bytes: 0, held: 0 }) };
}

/// Adds an allocation of `bytes`, and `held` to what is held.
fn count(allocations: u64, bytes: usize, held: i64) {
    let add = |c: Count| Count {
        allocations: c.allocations + allocations,
        bytes: c.bytes + bytes as u64,
        held: c.held + held,
    };
    // a thread that is ending counts no more
    let _ = COUNT.try_with(|c| c.set(add(c.get())));
}

/// Allocations and bytes of this thread so far.
fn allocated() -> (u64, u64) {
    let c = COUNT.get();
    (c.allocations, c.bytes)
}

/// Bytes that this thread holds.
fn held_now() -> i64 {
    COUNT.get().held
}

/// Allocations and bytes since.
fn since(before: (u64, u64)) -> (u64, u64) {
    let now = allocated();
    (now.0 - before.0, now.1 - before.1)
}

/// What a bare iceoryx2 port allocates for a frame sent.
fn bare(domain: &TestDomain) -> (u64, u64) {
    let node = domain.open().node().unwrap();
    let service = node
        .service_builder(&"bare".try_into().unwrap())
        .publish_subscribe::<[f64]>()
        .open_or_create()
        .unwrap();
    let port = service.publisher_builder().initial_max_slice_len(800).create().unwrap();
    let mut last = (0, 0);
    for _ in 0..3 {
        let before = allocated();
        port.loan_slice(800).unwrap().send().unwrap();
        last = since(before);
    }
    last
}

struct Counting;

// SAFETY: passes everything on to the system's allocator
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(1, layout.size(), layout.size() as i64);
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, p: *mut u8, layout: Layout) {
        count(0, 0, -(layout.size() as i64));
        unsafe { System.dealloc(p, layout) }
    }
    unsafe fn realloc(&self, p: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(1, size, size as i64 - layout.size() as i64);
        unsafe { System.realloc(p, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The file that the memory at `address` belongs to.
fn mapped_file(address: usize) -> String {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    let holds = |line: &&str| {
        let range = line.split(' ').next().unwrap();
        let (a, b) = range.split_once('-').unwrap();
        let hex = |t| usize::from_str_radix(t, 16).unwrap();
        (hex(a)..hex(b)).contains(&address)
    };
    maps.lines().find(holds).unwrap_or("").to_string()
}

#[test]
fn prop_no_copy_and_no_allocation_per_frame() {
    let domain = TestDomain::default();
    let telemetry = reference_run(2.0, 0.2, "preflight2", 10_000.0);
    let actuator = Arc::new(ActuatorParameters::reference());
    let sequence = sim_worker::catalogue::sequence("preflight2").unwrap();
    let channels = telemetry.header.as_ref().unwrap().channels;
    let about = RunDescription {
        actuator: "rig".into(),
        parameters: actuator.fingerprint(),
        sensors: "none".into(),
        sequence: sequence.fingerprint(),
        run: 1,
        rate_hz: 10_000.0,
        channels,
        total_rows: 30_000,
        load_n_m: 0.0,
    };
    let subscriber = Subscriber::open(&domain.open()).unwrap();
    // the real-time publisher does not wait, so that one thread can be both ends
    let mut publisher = Publisher::open(&domain.open(), Delivery::RealTime, 100, channels.iter().count()).unwrap();
    let mut live = Live::new(Known {
        actuators: vec![actuator],
        sequences: vec![sequence],
        sensors: vec![("none".into(), Default::default())],
        units: Default::default(),
    });
    let mut pass = publisher.begin(&about, Duration::ZERO, &|| true).unwrap().unwrap();
    let view = telemetry.view();
    let handle = bare(&domain);
    println!("a bare port allocates {} time(s), {} bytes, a loan", handle.0, handle.1);
    let (mut sent, mut received) = (Vec::new(), Vec::new());
    for k in 0..300 {
        let block = view.slice(k * 100, (k + 1) * 100);
        let before = allocated();
        let mut frame = publisher.loan(&pass, block.first, block.rows).unwrap();
        frame.view_mut().copy_from(&block);
        assert!(publisher.publish(&mut pass, frame).unwrap());
        sent.push(since(before));
        let before = allocated();
        subscriber.wait(Duration::from_secs(1)).unwrap();
        while let Some(frame) = subscriber.receive().unwrap() {
            let (h, now) = (frame.header(), schemas::stream::now_ns());
            live.frame(h, frame.payload(), frame.publisher(), &|_| true, now);
        }
        received.push(since(before));
    }
    let s = &live.statuses()[0];
    assert_eq!((s.sample, s.lost), (30_000, 0));
    assert!(s.raw.values().iter().all(Option::is_some), "{:?}", s.raw);
    // the first frames open the run, ask for maps and make connections
    println!("first frames: sent {:?}, received {:?}", &sent[..3], &received[..3]);
    assert!(received[4..].iter().all(|n| *n == (0, 0)), "{received:?}");
    assert!(sent[4..].iter().all(|n| *n == handle), "{sent:?}");

    // in place: the columns lie in the publisher's shared memory, and Arrow arrays over them too
    let block = view.slice(0, 96);
    let mut frame = publisher.loan(&pass, 30_001, block.rows).unwrap();
    frame.view_mut().copy_from(&block);
    publisher.publish(&mut pass, frame).unwrap();
    let frame = subscriber.receive().unwrap().unwrap();
    let column = frame.view().unwrap().column(Channel::OmegaM).unwrap().as_ptr();
    let file = mapped_file(column as usize);
    assert!(file.contains("/dev/shm/") && file.contains(&domain.name), "{file}");
    assert_eq!(column as usize % 64, 0);
    let batch = frame.into_record_batch().unwrap();
    let array = batch.column_by_name("omega_m").unwrap();
    let array = array.as_any().downcast_ref::<arrow::array::Float64Array>().unwrap();
    assert_eq!(array.values().as_ptr(), column);
    assert_eq!(&array.values()[..], block.column(Channel::OmegaM).unwrap());
    let schema = batch.schema();
    assert_eq!(schema.field_with_name("omega_m").unwrap().metadata()["unit"], "rad/s");
    // what is still held stays whole while the publisher goes on
    let first = array.values()[95];
    for _ in 0..600 {
        let mut frame = publisher.loan(&pass, 40_000, 100).unwrap();
        frame.view_mut().column_mut(Channel::OmegaM).unwrap().fill(7.0);
        publisher.publish(&mut pass, frame).unwrap();
    }
    assert_eq!(array.values()[95], first);
}

/// Maps of the reference actuator without sensors at 10 kHz.
fn maps() -> Diagnoser {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    let data = data.to_str().unwrap();
    for args in [
        &["simulate", "--grid", "standard", "--keep", "features", "--out", data][..],
        &["maps", data],
    ] {
        let done = Command::new(env!("CARGO_BIN_EXE_ema-under-test"))
            .args(args)
            .output()
            .unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    }
    Diagnoser::uncalibrated(FailureMapSet::load(&Path::new(data).join("maps.parquet")).unwrap())
}

/// Tests of 3 s, and actuators that they come from in turn.
const HOUR: u64 = 1200;
const ACTUATORS: usize = 6;
/// Tests after which all that is remembered has been filled.
const FILLED: u64 = 100;
/// What a diagnosis may take, and all of them together may still hold in the end [bytes].
const ROOM: u64 = 4 << 20;
const STAYS: i64 = 4 * 1024;

#[test]
fn prop_an_hour_of_streams_allocates_nothing_for_a_frame() {
    let maps = Arc::new(maps());
    let recordings = reference_runs(&[(2.0, 0.2), (3.3, 0.11), (1.4, 0.4)], "preflight", 10_000.0);
    let actuator = Arc::new(ActuatorParameters::reference());
    let sequence = sim_worker::catalogue::sequence("preflight").unwrap();
    // frames of 10 ms, made before anything is counted
    let frames = |r: &schemas::telemetry::Collector, name: &str| -> Vec<(FrameHeader, Vec<f64>)> {
        let about = RunDescription {
            actuator: name.into(),
            parameters: actuator.fingerprint(),
            sensors: "none".into(),
            sequence: sequence.fingerprint(),
            run: 1,
            rate_hz: 10_000.0,
            channels: r.header.as_ref().unwrap().channels,
            total_rows: 30_000,
            load_n_m: 0.0,
        };
        let header = |kind: u32, frame: u64| FrameHeader {
            kind,
            frame,
            ..about.header()
        };
        let mut list = vec![(header(BEGIN, 0), Vec::new())];
        for k in 0..300 {
            let block = r.view().slice(k * 100, (k + 1) * 100);
            let mut h = header(SAMPLES, k as u64 + 1);
            h.set_rows(block.first, block.rows);
            let mut values = vec![0.0; h.values()];
            h.view_mut(&mut values).copy_from(&block);
            list.push((h, values));
        }
        list.push((header(END, 301), Vec::new()));
        list
    };
    let names: Vec<String> = (0..ACTUATORS).map(|k| format!("actuator-{k}")).collect();
    let tests: Vec<Vec<_>> = (0..ACTUATORS)
        .map(|k| frames(&recordings[k % recordings.len()], &names[k]))
        .collect();
    let mut live = Live::new(Known {
        actuators: vec![actuator.clone()],
        sequences: vec![sequence.clone()],
        sensors: vec![("none".into(), Default::default())],
        units: Default::default(),
    });
    let (mut now, mut located, mut finals) = (0, 0, 0);
    let (mut frames, mut allocating) = (0u64, 0u64);
    let (mut most_of_begin, mut most_of_diagnosis, mut held) = ((0, 0), (0, 0), 0);
    for test in 0..HOUR {
        if test == FILLED {
            held = held_now();
        }
        for (header, payload) in &tests[test as usize % ACTUATORS] {
            now += 10_000_000;
            let h = FrameHeader {
                stream: test + 1,
                run: test,
                publish_ns: now,
                ..*header
            };
            let before = allocated();
            live.frame(&h, payload, 1, &|_| true, now);
            let took = since(before);
            if test >= FILLED && h.kind == BEGIN {
                most_of_begin = (most_of_begin.0.max(took.0), most_of_begin.1.max(took.1));
            } else if test >= FILLED {
                frames += 1;
                allocating += u64::from(took != (0, 0));
            }
            let wishes: Vec<_> = live.wishes().collect();
            for key in &wishes {
                assert!(key.is_served_by(&maps.maps.header));
                live.maps(key, Ok(maps.clone()));
            }
            loop {
                let before = allocated();
                let done = live.work();
                for report in live.reports() {
                    let message = to_message(&report);
                    finals += u64::from(message.is_final);
                    located += u64::from(report.is_final && matches!(report.diagnosis.outcome, Outcome::Located(_)));
                }
                if !done {
                    break;
                }
                let took = since(before);
                if test >= FILLED {
                    most_of_diagnosis = (most_of_diagnosis.0.max(took.0), most_of_diagnosis.1.max(took.1));
                }
            }
        }
    }
    let grown = held_now() - held;
    println!(
        "{frames} frames, {allocating} of them allocate; a beginning {most_of_begin:?}, a diagnosis {most_of_diagnosis:?} at most \
         (allocations, bytes); held after {HOUR} tests {grown} bytes more than after {FILLED}"
    );
    assert_eq!((finals, located), (HOUR, HOUR));
    // the frame by which the rest angle is known names the maps
    assert!(allocating <= HOUR - FILLED, "{allocating} of {frames}");
    assert!(most_of_begin.1 < ROOM && most_of_diagnosis.1 < ROOM);
    assert!(grown.abs() < STAYS, "{grown}");
}
