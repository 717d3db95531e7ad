//! Laws of the stream, beside what the bare transport does: the losses that iceoryx2 does not
//! report are shown on bare ports in the same test, so that it is known when they go away.

use ema_tests::stream::TestDomain;
use iceoryx2::prelude::*;
use schemas::channel::{Channel, ChannelSet};
use schemas::feature::Feature;
use schemas::stream::Ipc;
use schemas::stream::diagnosis::DiagnosisMessage;
use schemas::stream::frame::{BEGIN, END, FrameHeader, RunDescription};
use schemas::stream::publisher::{Delivery, Publisher};
use schemas::stream::subscriber::Subscriber;
use std::sync::atomic::Ordering;
use std::time::Duration;

const LIMIT: Duration = Duration::from_secs(30);
const FRAMES: u64 = 1500;

fn about() -> RunDescription {
    RunDescription {
        actuator: "rig".into(),
        parameters: "0000000000000001".into(),
        sensors: "none".into(),
        sequence: "0000000000000002".into(),
        run: 1,
        rate_hz: 1000.0,
        channels: ChannelSet::of([Channel::Com]),
        total_rows: FRAMES,
        load_n_m: f64::NAN,
    }
}

type Service = iceoryx2::service::port_factory::publish_subscribe::PortFactory<Ipc, [f64], ()>;

/// A bare service with the same settings, and its node.
fn bare(domain: &TestDomain) -> (Node<Ipc>, Service) {
    let node = domain.open().node().unwrap();
    let service = node
        .service_builder(&"bare".try_into().unwrap())
        .publish_subscribe::<[f64]>()
        .enable_safe_overflow(false)
        .subscriber_max_buffer_size(schemas::stream::BUFFER_FRAMES)
        .open_or_create()
        .unwrap();
    (node, service)
}

/// Sends `FRAMES` frames losslessly; returns how many subscribers got all of them.
fn send_all(publisher: &mut Publisher) -> usize {
    let mut pass = publisher.begin(&about(), LIMIT, &|| true).unwrap().unwrap();
    for k in 0..FRAMES {
        let mut frame = publisher.loan(&pass, k + 1, 1).unwrap();
        frame.view_mut().column_mut(Channel::Com).unwrap()[0] = k as f64;
        assert!(publisher.publish(&mut pass, frame).unwrap());
    }
    publisher.end(&pass, LIMIT, &|| true).unwrap().whole
}

/// Reads sample frames until the last one, answering as a subscriber should.
fn read_all(subscriber: &Subscriber) -> Vec<f64> {
    let mut got = Vec::new();
    let start = std::time::Instant::now();
    while start.elapsed() < LIMIT {
        while let Some(f) = subscriber.receive().unwrap() {
            let h = *f.header();
            match h.kind {
                BEGIN => subscriber.answer(&h, 0).unwrap(),
                END => {
                    subscriber.answer(&h, got.len() as u64).unwrap();
                    return got;
                }
                _ => got.push(f.payload()[0]),
            }
        }
        subscriber.wait(Duration::from_millis(20)).unwrap();
    }
    got
}

/// What a subscriber reads that is there from the start, but does not look for the first 0.3 s of
/// `sending`.
fn read_late(domain: &TestDomain, sending: impl FnOnce()) -> Vec<f64> {
    let subscriber = Subscriber::open(&domain.open()).unwrap();
    std::thread::scope(|s| {
        let reader = s.spawn(|| {
            std::thread::sleep(Duration::from_millis(300));
            read_all(&subscriber)
        });
        sending();
        reader.join().unwrap()
    })
}

/// Silent loss 1: a subscriber that has not yet polled a new publisher gets what its queue holds.
#[test]
fn prop_new_publisher_waits_for_subscribers_that_have_not_polled() {
    let domain = TestDomain::default();
    // bare: lossless by its settings, and yet
    let (_node, service) = bare(&domain);
    let reader = service.subscriber_builder().create().unwrap();
    let writer = service
        .publisher_builder()
        .initial_max_slice_len(8)
        .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
        .create()
        .unwrap();
    let mut unheard = 0;
    for k in 0..FRAMES {
        let mut s = writer.loan_slice(1).unwrap();
        s.payload_mut()[0] = k as f64;
        unheard += u64::from(s.send().unwrap() == 0);
    }
    let mut got = 0;
    while reader.receive().unwrap().is_some() {
        got += 1;
    }
    println!("bare: {got} of {FRAMES} received, send said 0 recipients {unheard} times");
    assert!(got < FRAMES && unheard == FRAMES - got);
    // ours
    let got = read_late(&domain, || {
        let mut publisher = Publisher::open(&domain.open(), Delivery::Lossless, 1, 1).unwrap();
        assert_eq!(send_all(&mut publisher), 1);
    });
    assert_eq!(got, (0..FRAMES).map(|k| k as f64).collect::<Vec<_>>());
}

/// Silent loss 2: what a publisher has sent before its end is lost for those who had not
/// connected.
#[test]
fn prop_publisher_stays_until_the_last_frame_is_answered() {
    let domain = TestDomain::default();
    let (_node, service) = bare(&domain);
    let reader = service.subscriber_builder().create().unwrap();
    let writer = service.publisher_builder().initial_max_slice_len(8).create().unwrap();
    assert_eq!(writer.loan_slice(1).unwrap().send().unwrap(), 1);
    drop(writer);
    assert!(
        reader.receive().unwrap().is_none(),
        "bare: one sample delivered, none received"
    );
    // ours, the real-time stream, which does not wait at its beginning
    let got = read_late(&domain, || {
        let mut publisher = Publisher::open(&domain.open(), Delivery::RealTime, 1, 1).unwrap();
        let mut pass = publisher.begin(&about(), LIMIT, &|| true).unwrap().unwrap();
        for k in 0..3 {
            let mut frame = publisher.loan(&pass, k + 1, 1).unwrap();
            frame.view_mut().column_mut(Channel::Com).unwrap()[0] = k as f64;
            assert!(publisher.publish(&mut pass, frame).unwrap());
        }
        publisher.end(&pass, LIMIT, &|| true).unwrap();
    });
    assert_eq!(got, [0.0, 1.0, 2.0]);
}

/// Silent loss 3: growing memory takes unread samples with it when the publisher goes.
#[test]
fn prop_frames_of_all_sizes_come_from_one_block_of_memory() {
    let domain = TestDomain::default();
    let (_node, service) = bare(&domain);
    let reader = service.subscriber_builder().create().unwrap();
    let send = |strategy, sizes: &[usize]| {
        let writer = service
            .publisher_builder()
            .initial_max_slice_len(sizes[0])
            .allocation_strategy(strategy)
            .create()
            .unwrap();
        // connected before anything is sent: this is not the loss above
        assert!(reader.receive().unwrap().is_none());
        for n in sizes {
            assert_eq!(writer.loan_slice(*n).unwrap().send().unwrap(), 1);
        }
        drop(writer);
        let mut got = 0;
        while let Ok(Some(_)) = reader.receive() {
            got += 1;
        }
        got
    };
    let growing = send(AllocationStrategy::PowerOfTwo, &[4, 4, 64, 64]);
    let fixed = send(AllocationStrategy::Static, &[64, 4, 64, 4]);
    println!("bare: {growing} of 4 received from growing memory, {fixed} of 4 from fixed memory");
    assert!(growing < 4 && fixed == 4);
    // ours: frames of any size up to the largest, read after the publisher has gone
    let subscriber = Subscriber::open(&domain.open()).unwrap();
    let mut publisher = Publisher::open(&domain.open(), Delivery::RealTime, 500, 1).unwrap();
    assert!(subscriber.receive().unwrap().is_none());
    let mut pass = publisher.begin(&about(), LIMIT, &|| true).unwrap().unwrap();
    let sizes = [1, 8, 500, 3, 499];
    let mut first = 1;
    for n in sizes {
        let frame = publisher.loan(&pass, first, n).unwrap();
        assert!(publisher.publish(&mut pass, frame).unwrap());
        first += n as u64;
    }
    // a larger one is refused, not grown into
    assert!(publisher.loan(&pass, first, 505).is_err());
    drop(publisher);
    let mut got = Vec::new();
    while let Some(f) = subscriber.receive().unwrap() {
        got.push(f.header().rows as usize);
    }
    assert_eq!(got, [&[0], &sizes[..]].concat());
}

/// A structure of the same size under the name of another version.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
struct FutureHeader {
    words: [u64; 19],
}

// SAFETY: plain numbers
unsafe impl ZeroCopySend for FutureHeader {
    unsafe fn type_name() -> &'static str {
        "ema::FrameHeader/2/0badcafe"
    }
}

#[test]
fn refuse_a_subscriber_of_another_schema_version() {
    assert_eq!(size_of::<FutureHeader>(), size_of::<FrameHeader>());
    let domain = TestDomain::default();
    let node = domain.open().node().unwrap();
    let _theirs = node
        .service_builder(&schemas::stream::TELEMETRY.try_into().unwrap())
        .publish_subscribe::<[f64]>()
        .user_header::<FutureHeader>()
        .create()
        .unwrap();
    let text = Subscriber::open(&domain.open()).err().unwrap().to_string();
    println!("{text}");
    let ours = FrameHeader::wire_name().rsplit('/').next().unwrap();
    for word in ["ema/telemetry", "2 (layout 0badcafe)", &format!("1 (layout {ours})")] {
        assert!(text.contains(word), "no `{word}` in {text}");
    }
    let text = Publisher::open(&domain.open(), Delivery::Lossless, 1, 1)
        .err()
        .unwrap()
        .to_string();
    assert!(text.contains("2 (layout 0badcafe)"), "{text}");
}

#[test]
fn prop_backpressure_ends_when_the_reader_is_dead_or_somebody_stops_it() {
    let domain = TestDomain::default();
    let subscriber = Subscriber::open(&domain.open()).unwrap();
    let mut publisher = Publisher::open(&domain.open(), Delivery::Lossless, 1, 1).unwrap();
    let stop = publisher.stop_flag();
    std::thread::scope(|s| {
        s.spawn(|| {
            // answers the beginning and then reads nothing more
            while subscriber.receive().unwrap().is_none_or(|f| {
                let h = *f.header();
                subscriber.answer(&h, 0).unwrap();
                h.kind != BEGIN
            }) {
                std::thread::sleep(Duration::from_millis(1));
            }
            std::thread::sleep(Duration::from_millis(300));
            stop.store(true, Ordering::Relaxed);
        });
        let mut pass = publisher.begin(&about(), LIMIT, &|| true).unwrap().unwrap();
        let mut heard = 0;
        for k in 0..FRAMES {
            let frame = publisher.loan(&pass, k + 1, 1).unwrap();
            if !publisher.publish(&mut pass, frame).unwrap() {
                break;
            }
            heard += 1;
        }
        assert_eq!(heard, schemas::stream::BUFFER_FRAMES);
    });
}

#[test]
fn prop_specification_and_examples_name_the_layouts() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../schemas");
    let names = [
        FrameHeader::wire_name(),
        schemas::stream::frame::Acknowledgement::wire_name(),
        DiagnosisMessage::wire_name(),
    ];
    for file in ["README.md", "examples/python/ema_stream.py"] {
        let text = std::fs::read_to_string(root.join(file)).unwrap();
        for name in names {
            assert!(text.contains(name), "{file} does not name {name}");
        }
    }
    // every field of the header stands in the specification, at its offset
    let text = std::fs::read_to_string(root.join("README.md")).unwrap();
    for (field, kind, offset) in FrameHeader::FIELDS {
        let row = format!("| `{field}` | {kind} | {offset} |");
        assert!(text.contains(&row), "{row}");
    }
    // and so does every feature of a diagnosis
    let numbers = std::mem::offset_of!(DiagnosisMessage, features);
    let keys = Feature::TOLD.map(|f| format!("`{}`", f.key())).join(", ");
    let offsets: Vec<String> = (0..Feature::TOLD.len())
        .map(|k| (numbers + 8 * k).to_string())
        .collect();
    let row = format!("| {keys} | f64 | {} | features |", offsets.join(", "));
    assert!(text.contains(&row), "{row}");
}
