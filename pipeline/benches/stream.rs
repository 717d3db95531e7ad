//! The live path beside controls in the same run: frames in place beside the same path with a copy
//! on either side, and a Unix socket; what the diagnosis adds; how much one core carries. The
//! receivers are processes of their own (this program again, with a role).

use diagnoser::live::Known;
use diagnoser::map_library::{Choice, MapLibrary};
use diagnoser::receive::maps::MapSource;
use diagnoser::receive::{Options, Show, receive};
use pipeline::maps::{self, MapRequest};
use schemas::channel::{Channel, ChannelSet};
use schemas::fault::FaultState;
use schemas::feature::Raw;
use schemas::stream::diagnosis::DiagnosisSubscriber;
use schemas::stream::frame::{BEGIN, END, FrameHeader, RunDescription, SAMPLES};
use schemas::stream::publisher::{Delivery, Pass, Publisher};
use schemas::stream::subscriber::Subscriber;
use schemas::stream::{Domain, now_ns};
use schemas::telemetry::{Collector, TelemetryView};
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::setup::TestSetup;
use sim_worker::simulate::{Experiment, LANES, Run, simulate};
use sim_worker::test_bench::Lane;
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

const RATE_HZ: f64 = 10_000.0;
const CHANNELS: usize = 8;
const FRAMES: usize = 2000;
const WARM_UP: usize = 100;

fn domain() -> Domain {
    Domain::new(&format!(
        "bench-{}",
        std::env::var("EMA_BENCH_PARENT").unwrap_or_default()
    ))
    .unwrap()
}

/// This program again, in a role.
fn child(role: &str, more: &[&str]) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--role", role])
        .args(more)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

fn said(child: Child) -> String {
    String::from_utf8(child.wait_with_output().unwrap().stdout).unwrap()
}

/// p50, p99 and p99.9 in microseconds.
fn quantiles(mut ns: Vec<u64>) -> [f64; 3] {
    ns.sort_unstable();
    [0.5, 0.99, 0.999].map(|q| ns[((ns.len() - 1) as f64 * q) as usize] as f64 * 1e-3)
}

fn about(actuator: &str, rows: u64) -> RunDescription {
    RunDescription {
        actuator: actuator.into(),
        parameters: ActuatorParameters::reference().fingerprint(),
        sensors: sim_worker::catalogue::sensors("reference")
            .unwrap()
            .unwrap()
            .fingerprint(),
        sequence: sim_worker::catalogue::sequence("preflight").unwrap().fingerprint(),
        run: 1,
        rate_hz: RATE_HZ,
        channels: ChannelSet::basic(),
        total_rows: rows,
        load_n_m: 0.0,
    }
}

// ---- one-way latency

/// What a consumer does with a frame at the least: reads every value.
fn consume(values: &[f64]) -> f64 {
    values.iter().sum()
}

/// Receives frames of shared memory; prints the latencies.
fn role_frames(copy: bool, busy: bool) {
    let s = Subscriber::open(&domain()).unwrap();
    let mut own = Vec::new();
    let mut ns = Vec::new();
    let mut sink = 0.0;
    loop {
        while let Some(f) = s.receive().unwrap() {
            let h = *f.header();
            match h.kind {
                SAMPLES => {
                    if copy {
                        own.clear();
                        own.extend_from_slice(f.payload());
                        sink += consume(&own);
                    } else {
                        sink += consume(f.payload());
                    }
                    // the producer's clock when it began to write
                    ns.push(now_ns() - f.payload()[0] as u64);
                }
                BEGIN => s.answer(&h, 0).unwrap(),
                END => {
                    s.answer(&h, ns.len() as u64).unwrap();
                    print_latencies(&ns, sink);
                    return;
                }
                _ => {}
            }
        }
        if !busy {
            s.wait(Duration::from_millis(100)).unwrap();
        }
    }
}

fn print_latencies(ns: &[u64], sink: f64) {
    let text: Vec<String> = ns.iter().skip(WARM_UP).map(u64::to_string).collect();
    println!("{}", text.join(" "));
    assert!(!sink.is_nan());
}

fn latencies(text: &str) -> [f64; 3] {
    quantiles(text.split_whitespace().map(|t| t.parse().unwrap()).collect())
}

/// Values as a producer makes them: written once.
fn produce(out: &mut [f64], k: usize) {
    for (i, x) in out.iter_mut().enumerate() {
        *x = (i + k) as f64;
    }
}

fn frames_latency(rows: usize, copy: bool, busy: bool) -> [f64; 3] {
    let receiver = child(
        "frames",
        &[if copy { "copy" } else { "place" }, if busy { "busy" } else { "wait" }],
    );
    let mut p = Publisher::open(&domain(), Delivery::Lossless, rows, CHANNELS).unwrap();
    let mut pass = p
        .begin(&about("a", 0), Duration::from_secs(10), &|| true)
        .unwrap()
        .unwrap();
    let mut own = vec![0.0; rows.next_multiple_of(8) * CHANNELS];
    for k in 0..FRAMES + WARM_UP {
        std::thread::sleep(Duration::from_millis(1));
        let t0 = now_ns();
        let mut frame = p.loan(&pass, (k * rows) as u64 + 1, rows).unwrap();
        let payload = frame.payload_mut();
        if copy {
            produce(&mut own, k);
            own[0] = t0 as f64;
            payload.copy_from_slice(&own);
        } else {
            produce(payload, k);
            payload[0] = t0 as f64;
        }
        p.publish(&mut pass, frame).unwrap();
    }
    p.end(&pass, Duration::from_secs(10), &|| true).unwrap();
    latencies(&said(receiver))
}

fn socket_path() -> std::path::PathBuf {
    std::env::temp_dir().join(format!("ema-bench-{}", std::env::var("EMA_BENCH_PARENT").unwrap()))
}

fn role_socket(rows: usize) {
    let mut socket = UnixStream::connect(socket_path()).unwrap();
    let values = rows.next_multiple_of(8) * CHANNELS;
    let mut bytes = vec![0; size_of::<FrameHeader>() + values * 8];
    let mut own = vec![0.0; values];
    let (mut ns, mut sink) = (Vec::new(), 0.0);
    while socket.read_exact(&mut bytes).is_ok() {
        let body = &bytes[size_of::<FrameHeader>()..];
        for (x, b) in own.iter_mut().zip(body.chunks_exact(8)) {
            *x = f64::from_le_bytes(b.try_into().unwrap());
        }
        sink += consume(&own);
        ns.push(now_ns() - own[0] as u64);
    }
    print_latencies(&ns, sink);
}

fn socket_latency(rows: usize) -> [f64; 3] {
    let path = socket_path();
    let _ = std::fs::remove_file(&path);
    let listener = UnixListener::bind(&path).unwrap();
    let receiver = child("socket", &[&rows.to_string()]);
    let (mut socket, _) = listener.accept().unwrap();
    let mut own = vec![0.0; rows.next_multiple_of(8) * CHANNELS];
    let mut bytes = vec![0; size_of::<FrameHeader>() + own.len() * 8];
    for k in 0..FRAMES + WARM_UP {
        std::thread::sleep(Duration::from_millis(1));
        let t0 = now_ns();
        produce(&mut own, k);
        own[0] = t0 as f64;
        for (b, x) in bytes[size_of::<FrameHeader>()..].chunks_exact_mut(8).zip(&own) {
            b.copy_from_slice(&x.to_le_bytes());
        }
        socket.write_all(&bytes).unwrap();
    }
    drop(socket);
    let _ = std::fs::remove_file(&path);
    latencies(&said(receiver))
}

// ---- the diagnosis

fn recordings(n: usize) -> Vec<Collector> {
    let actuator = Arc::new(ActuatorParameters::reference());
    let sequence = sim_worker::catalogue::sequence("preflight").unwrap();
    let sensors = sim_worker::catalogue::sensors("reference").unwrap();
    let e = Experiment::new(sequence, RATE_HZ, ChannelSet::basic(), sensors, actuator.step_s).unwrap();
    let runs: Vec<Run> = (0..n)
        .map(|i| Run {
            number: i as u64,
            lane: Lane {
                actuator: actuator.clone(),
                fault: FaultState {
                    fsj: 1.3 + 3.2 * (i as f64 * 0.618).fract(),
                    zeta: 0.05 + 0.4 * (i as f64 * 0.755).fract(),
                },
                rest_angle_rad: 0.0,
                load_n_m: 0.0,
            },
            seed: i as u64,
        })
        .collect();
    let mut all = Vec::new();
    for group in runs.chunks(LANES) {
        let mut sinks = vec![Collector::default(); group.len()];
        simulate(&e, group, &mut sinks, || true).unwrap();
        all.extend(sinks);
    }
    all
}

/// Makes the maps of the recordings, so that the diagnoser finds them.
fn make_maps() {
    let sequence = sim_worker::catalogue::sequence("preflight").unwrap();
    let setup = TestSetup {
        sensors: sim_worker::catalogue::sensors("reference").unwrap(),
        ..TestSetup::new(Arc::new(ActuatorParameters::reference()), sequence, RATE_HZ)
    };
    let grid = sim_worker::catalogue::grid("fine").unwrap();
    let request = MapRequest { setup, grid };
    maps::cached(&request, &Choice::usual(), &Vec::new()).unwrap();
}

/// Processor time of this process [s].
fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let rest = stat.rsplit(')').next().unwrap();
    let ticks: Vec<f64> = rest.split_whitespace().filter_map(|t| t.parse().ok()).collect();
    // after the state: utime and stime are the 11th and 12th number, in hundredths of a second
    (ticks[10] + ticks[11]) / 100.0
}

/// The live diagnoser; `core` pins it.
fn role_live(diagnoses: u64, busy: bool, core: Option<usize>) {
    if let Some(core) = core {
        let pid = std::process::id().to_string();
        let _ = Command::new("taskset")
            .args(["-cp", &core.to_string(), &pid])
            .stdout(Stdio::null())
            .status();
    }
    let sensors = sim_worker::catalogue::sensors("reference").unwrap().unwrap();
    let known = Known {
        actuators: vec![Arc::new(ActuatorParameters::reference())],
        sequences: vec![sim_worker::catalogue::sequence("preflight").unwrap()],
        sensors: vec![(sensors.fingerprint(), sensors.sampling)],
        units: Default::default(),
    };
    let library = MapLibrary::cache(&sim_worker::cache::cache_dir().join("maps"));
    let options = Options {
        domain: domain(),
        known,
        log: None,
        record: None,
        busy,
        show: Show::Nothing,
        exit_after: Some(diagnoses),
        timeout: Duration::from_secs(10),
        metrics: None,
        foresight: None,
    };
    let source = MapSource::saved(library, Choice::usual(), "none in the cache");
    let start = cpu_s();
    let counts = receive(options, source, &Arc::new(AtomicBool::new(false))).unwrap();
    println!("{} {} {}", counts.located, counts.incomplete, cpu_s() - start);
}

/// The third process: prints the time from the telemetry's publication to the diagnosis's arrival.
fn role_third(diagnoses: usize) {
    let mut s = DiagnosisSubscriber::open(&domain(), 0).unwrap();
    let mut ns = Vec::new();
    let mut inner = Vec::new();
    while ns.len() < diagnoses {
        if let Some(m) = s.next(Duration::from_secs(30)).unwrap()
            && m.is_final == 1
        {
            ns.push(now_ns() - m.telemetry_ns);
            inner.push(m.publish_ns - m.telemetry_ns);
        }
    }
    for list in [ns, inner] {
        let text: Vec<String> = list.iter().map(u64::to_string).collect();
        println!("{}", text.join(" "));
    }
}

/// Sends a recording, frames paced by `pause`.
fn send(p: &mut Publisher, view: &TelemetryView<'_>, rows: usize, pause: Duration) {
    let mut pass = p
        .begin(&about("a", view.rows as u64), Duration::from_secs(20), &|| true)
        .unwrap()
        .unwrap();
    for k in 0..view.rows / rows {
        std::thread::sleep(pause);
        let block = view.slice(k * rows, (k + 1) * rows);
        let mut frame = p.loan(&pass, block.first, rows).unwrap();
        frame.view_mut().copy_from(&block);
        p.publish(&mut pass, frame).unwrap();
    }
    p.end(&pass, Duration::from_secs(10), &|| true).unwrap();
}

fn diagnosis_latency(busy: bool) -> ([f64; 3], [f64; 3]) {
    const RUNS: usize = 400;
    let third = child("third", &[&(RUNS + 1).to_string()]);
    let live = child(
        "live",
        &[&(RUNS + 1).to_string(), if busy { "busy" } else { "wait" }, "any"],
    );
    let all = recordings(16);
    let mut p = Publisher::open(&domain(), Delivery::Lossless, 300, CHANNELS).unwrap();
    for k in 0..=RUNS {
        send(&mut p, &all[k % all.len()].view(), 300, Duration::from_micros(300));
    }
    let text = said(third);
    let mut lines = text.lines().map(|l| {
        let list: Vec<u64> = l.split_whitespace().map(|t| t.parse().unwrap()).collect();
        // the first one waits for its maps
        quantiles(list[1..].to_vec())
    });
    let result = (lines.next().unwrap(), lines.next().unwrap());
    let counts = said(live);
    assert!(
        counts.starts_with(&format!("{} 0 ", RUNS + 1)),
        "located, incomplete, s: {counts}"
    );
    result
}

/// 200 actuators in real time; located, lost frames, and the diagnoser's share of a core.
fn many(rows: usize) -> String {
    const ACTUATORS: usize = 200;
    let all = recordings(16);
    let live = child("live", &[&ACTUATORS.to_string(), "wait", "1"]);
    let mut p = Publisher::open(&domain(), Delivery::RealTime, rows, CHANNELS).unwrap();
    while p.subscribers() == 0 {
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(Duration::from_millis(200));
    let mut passes: Vec<Pass> = (0..ACTUATORS)
        .map(|i| {
            p.begin(&about(&format!("a{i:03}"), 30_000), Duration::ZERO, &|| true)
                .unwrap()
                .unwrap()
        })
        .collect();
    let start = Instant::now();
    let mut late = Duration::ZERO;
    for k in 0..30_000 / rows {
        let due = Duration::from_secs_f64((k + 1) as f64 * rows as f64 / RATE_HZ);
        std::thread::sleep(due.saturating_sub(start.elapsed()));
        for (i, pass) in passes.iter_mut().enumerate() {
            let block = all[i % all.len()].view().slice(k * rows, (k + 1) * rows);
            let mut frame = p.loan(pass, block.first, rows).unwrap();
            frame.view_mut().copy_from(&block);
            p.publish(pass, frame).unwrap();
        }
        late = late.max(start.elapsed().saturating_sub(due));
    }
    let wall = start.elapsed().as_secs_f64();
    let lost: u64 = passes.iter().map(|p| p.lost_frames).sum();
    for pass in &passes {
        p.end(pass, Duration::from_secs(5), &|| true).unwrap();
    }
    let counts = said(live);
    let parts: Vec<f64> = counts.split_whitespace().map(|t| t.parse().unwrap()).collect();
    format!(
        "{} of {ACTUATORS} located, {lost} of {} frames lost, diagnoser {:.2} s of processor in {wall:.2} s ({:.0} %), \
         publisher late by {:.1} ms at most",
        parts[0],
        ACTUATORS * 30_000 / rows,
        parts[2],
        100.0 * parts[2] / wall,
        late.as_secs_f64() * 1e3
    )
}

// ---- the extractor alone

/// Rows a second through `work`, the best of some rounds.
fn rate(rows: usize, mut work: impl FnMut() -> f64) -> f64 {
    let mut best = f64::INFINITY;
    let mut check = 0.0;
    for _ in 0..30 {
        let start = Instant::now();
        check += work();
        best = best.min(start.elapsed().as_secs_f64());
    }
    assert!(!check.is_nan());
    rows as f64 / best
}

fn extractor() {
    let run = recordings(1).remove(0);
    let view = run.view();
    let actuator = ActuatorParameters::reference();
    let sequence = sim_worker::catalogue::sequence("preflight").unwrap();
    let made = || {
        let plan = FeaturePlan::new(&actuator, &sequence, RATE_HZ, false, Default::default());
        Arc::new(plan)
    };
    let plan = made();
    let bare = |v: &TelemetryView<'_>| {
        [Channel::Com, Channel::ThetaM, Channel::OmegaM]
            .iter()
            .fold(TelemetryView::new(v.first, v.rows), |b, &c| {
                b.with(c, run.column(c).map(|x| &x[v.first as usize - 1..][..v.rows]).unwrap())
            })
    };
    let through = |plan: &Arc<FeaturePlan>, all: bool, from: usize, to: usize| {
        let mut x = FeatureExtractor::new(plan.clone());
        let mut k = from;
        while k < to {
            let block = view.slice(k, (k + 100).min(to));
            x.push(&if all { block } else { bare(&block) });
            k += 100;
        }
        let f = x.features();
        f[Raw::MeanSpeed].unwrap_or(0.0) + f[Raw::P2].unwrap_or(0.0)
    };
    let mut own = vec![0.0; 30_000 * CHANNELS];
    let copy = rate(30_000, || {
        for (o, c) in own.chunks_mut(30_000).zip(ChannelSet::basic().iter()) {
            o.copy_from_slice(run.column(c).unwrap());
        }
        own[12_345]
    });
    let sparse = rate(30_000, || through(&plan, false, 0, 30_000));
    let window = plan.regime.unwrap();
    let (from, to) = (window.from as usize - 1, window.to as usize);
    let dense = rate(to - from, || through(&plan, false, from, to));
    let all = rate(30_000, || through(&plan, true, 0, 30_000));
    let with_sm = rate(30_000, || through(&made(), true, 0, 30_000));
    println!("\nextractor, one core, frames of 100 rows [million rows a second]");
    println!("  control: copying the 8 columns           {:8.0}", copy * 1e-6);
    println!("  P1, P3, ripple, whole test               {:8.0}", sparse * 1e-6);
    println!("  P1 and ripple, rows of their window only {:8.0}", dense * 1e-6);
    println!("  all features, P2's model kept            {:8.0}", all * 1e-6);
    println!(
        "  all features, P2's model run for the test {:7.1}   ({:.0} times real time at 10 kHz)",
        with_sm * 1e-6,
        with_sm / RATE_HZ
    );
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    if let Some(i) = args.iter().position(|a| a == "--role") {
        let more = &args[i + 2..];
        match args[i + 1].as_str() {
            "frames" => role_frames(more[0] == "copy", more[1] == "busy"),
            "socket" => role_socket(more[0].parse().unwrap()),
            "third" => role_third(more[0].parse().unwrap()),
            "live" => role_live(more[0].parse().unwrap(), more[1] == "busy", more[2].parse().ok()),
            other => panic!("no role {other}"),
        }
        return;
    }
    // SAFETY: no thread has been started yet
    unsafe { std::env::set_var("EMA_BENCH_PARENT", std::process::id().to_string()) };
    extractor();
    println!(
        "\none way: from before the frame is written to after all of it is read, {FRAMES} frames, 1 ms apart [us]"
    );
    println!("  frame    path                                 p50      p99    p99.9");
    for (name, rows) in [("1 ms", 10), ("10 ms", 100), ("100 ms", 1000)] {
        let paths = [
            ("in place, woken by an event", frames_latency(rows, false, false)),
            (
                "control: the same with a copy at each end",
                frames_latency(rows, true, false),
            ),
            ("control: Unix socket", socket_latency(rows)),
            ("in place, polling", frames_latency(rows, false, true)),
        ];
        for (path, [a, b, c]) in paths {
            println!("  {name:7}  {path:41} {a:7.1}  {b:7.1}  {c:7.1}");
        }
    }
    make_maps();
    println!(
        "\nfrom the publication of the last needed sample to the diagnosis, 400 runs, frames of 30 ms every 0.3 ms [us]"
    );
    println!("  path                                         p50      p99    p99.9");
    for (name, busy) in [("woken by events", false), ("diagnoser polling", true)] {
        let (third, inner) = diagnosis_latency(busy);
        for (what, [a, b, c]) in [
            ("received by a third process", third),
            ("published by the diagnoser", inner),
        ] {
            println!("  {name:17} {what:27} {a:7.1}  {b:7.1}  {c:7.1}");
        }
    }
    println!("\n200 actuators at 10 kHz in real time, the diagnoser on one core");
    for (name, rows) in [("10 ms", 100), ("100 ms", 1000)] {
        println!("  frames of {name}: {}", many(rows));
    }
    domain().clean();
}
