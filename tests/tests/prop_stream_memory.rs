//! Frames are written and read in shared memory itself, and nothing is allocated for a frame on
//! either side beyond the handle of fixed size that iceoryx2 0.10 itself allocates for each loan
//! (shown on a bare port in the same test). Alone in its program, since it counts what the program
//! allocates.

use diagnoser::live::{Known, Live};
use ema_tests::reference_run;
use ema_tests::stream::TestDomain;
use schemas::channel::Channel;
use schemas::stream::frame::RunDescription;
use schemas::stream::publisher::{Delivery, Publisher};
use schemas::stream::subscriber::Subscriber;
use sim_worker::parameters::ActuatorParameters;
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);
static BYTES: AtomicU64 = AtomicU64::new(0);

/// Allocations and bytes so far.
fn allocated() -> (u64, u64) {
    (ALLOCATIONS.load(Ordering::Relaxed), BYTES.load(Ordering::Relaxed))
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
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        BYTES.fetch_add(layout.size() as u64, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, p: *mut u8, layout: Layout) {
        unsafe { System.dealloc(p, layout) }
    }
    unsafe fn realloc(&self, p: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        BYTES.fetch_add(size as u64, Ordering::Relaxed);
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
    let telemetry = reference_run(2.0, 0.2, "preflight", 10_000.0);
    let actuator = Arc::new(ActuatorParameters::reference());
    let sequence = sim_worker::catalogue::sequence("preflight").unwrap();
    let about = RunDescription {
        actuator: "rig".into(),
        parameters: actuator.fingerprint(),
        sensors: "none".into(),
        sequence: sequence.fingerprint(),
        run: 1,
        rate_hz: 10_000.0,
        channels: telemetry.header.as_ref().unwrap().channels,
        total_rows: 30_000,
        load_n_m: 0.0,
    };
    let subscriber = Subscriber::open(&domain.open()).unwrap();
    // the real-time publisher does not wait, so that one thread can be both ends
    let mut publisher = Publisher::open(&domain.open(), Delivery::RealTime, 100, 8).unwrap();
    let mut live = Live::new(Known {
        actuators: vec![actuator],
        sequences: vec![sequence],
        sensors: vec!["none".into()],
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
