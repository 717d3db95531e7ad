//! The bridge on a network that is not friendly: frames of every size, connections that die, peers that lie.

mod common;

use common::*;
use ema_tests::stream::{Program, TestDomain};
use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A receiving bridge, and where it listens.
fn receiver(domain: &TestDomain, args: &[&str]) -> (Program, String) {
    let mut p = Program::start(ema(
        domain,
        &[&["bridge", "receive", "--listen", "127.0.0.1:0"][..], args].concat(),
    ));
    let to = p.address(LIMIT);
    (p, to)
}

fn sender(domain: &TestDomain, to: &str, args: &[&str]) -> Program {
    let mut p = Program::start(ema(domain, &[&["bridge", "send", "--to", to][..], args].concat()));
    p.until("connection", LIMIT, |p| p.errors().contains("connected to"));
    p
}

fn replay(domain: &TestDomain, args: &[&str]) -> Program {
    let file = recording().0.to_str().unwrap();
    Program::start(ema(domain, &[&["replay", file, "--wait", "20"][..], args].concat()))
}

/// A file in a folder that goes away with the test.
fn secret(dir: &tempfile::TempDir, name: &str, text: &str) -> String {
    let path = dir.path().join(name);
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_string()
}

/// Frames of 5 000 samples beside frames of 100, over one connection: each stream has one diagnosis, and the right one.
#[test]
fn e2e_bridge_carries_frames_of_any_size_side_by_side() {
    let offline = &recording().1;
    let (near, far) = (TestDomain::default(), TestDomain::default());
    let mut live = live(&far, &["--exit-after", "3"]);
    let (receiver, to) = receiver(&far, &[]);
    let sender = sender(&near, &to, &[]);
    let mut small = replay(&near, &["--speed", "2", "--id", "small"]);
    live.until("something so far", LIMIT, |p| !p.json().is_empty());
    let mut large = replay(&near, &["--speed", "max", "--id", "large", "--frame-ms", "500"]);
    let mut odd = replay(&near, &["--speed", "max", "--id", "odd", "--frame-ms", "101"]);
    for p in [&mut small, &mut large, &mut odd] {
        assert_eq!(p.code(), Some(0), "{} {}", p.errors(), receiver.errors());
        assert!(p.lines()[0].contains("received by 1;"), "{:?}", p.lines());
    }
    assert_eq!(live.code(), Some(0), "{} {}", live.errors(), sender.errors());
    let finals = finals(&live);
    assert_eq!(finals.len(), 3);
    finals.iter().for_each(|v| same(offline, v));
}

/// A relay between sender and receiver whose connections can be made to die on the sender's side alone.
struct Network {
    address: String,
    /// sockets to the sender, and to the receiver
    pairs: Arc<Mutex<Vec<(TcpStream, TcpStream)>>>,
    /// the next bytes from a sender do not arrive
    losing: Arc<AtomicBool>,
}

impl Network {
    fn to(receiver: String) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let pairs = Arc::new(Mutex::new(Vec::new()));
        let losing = Arc::new(AtomicBool::default());
        let (all, lose) = (pairs.clone(), losing.clone());
        std::thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let Ok(far) = TcpStream::connect(&receiver) else { return };
                for (from, to, lose) in [(&near, &far, Some(lose.clone())), (&far, &near, None)] {
                    let (from, to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    std::thread::spawn(move || carry(from, to, lose.as_deref()));
                }
                all.lock().unwrap().push((near, far));
            }
        });
        Self { address, pairs, losing }
    }

    /// The sender's connection breaks and takes with it what was under way; the receiver does not hear of it.
    fn cut(&self) {
        self.losing.store(true, Ordering::Relaxed);
        let start = Instant::now();
        while self.losing.load(Ordering::Relaxed) {
            assert!(start.elapsed() < LIMIT, "nothing is sent");
            std::thread::sleep(Duration::from_millis(1));
        }
        let pairs = self.pairs.lock().unwrap();
        pairs.last().unwrap().0.shutdown(Shutdown::Both).unwrap();
    }
}

/// Carries bytes until some are lost; an end is not passed on.
fn carry(mut from: TcpStream, mut to: TcpStream, losing: Option<&AtomicBool>) {
    let mut bytes = [0; 65536];
    while let Ok(n) = from.read(&mut bytes) {
        let lost = n > 0 && losing.is_some_and(|l| l.swap(false, Ordering::Relaxed));
        if n == 0 || lost || to.write_all(&bytes[..n]).is_err() {
            return;
        }
    }
}

/// A connection dies in the middle of a run, and the receiving end does not know: the sender's next connection takes
/// the stream over at once, and the run is sent again until it has arrived whole.
#[test]
fn e2e_half_open_connection_does_not_stand_in_its_successors_way() {
    let offline = &recording().1;
    let (near, far) = (TestDomain::default(), TestDomain::default());
    let mut live = live(&far, &["--exit-after", "2"]);
    // the dead connection would be noticed after a minute at the earliest
    let (mut receiver, to) = receiver(&far, &["--idle", "60"]);
    let network = Network::to(to);
    let sender = sender(&near, &network.address, &[]);
    let mut replay = replay(&near, &["--speed", "1"]);
    live.until("something so far", LIMIT, |p| !p.json().is_empty());
    network.cut();
    receiver.until("succession", LIMIT, |p| p.errors().contains("takes over"));
    assert_eq!(replay.code(), Some(0), "{} {}", replay.errors(), sender.errors());
    assert_eq!(live.code(), Some(3), "{} {}", live.errors(), receiver.errors());
    let finals = finals(&live);
    assert_eq!(finals.len(), 2, "{finals:?}");
    // one stream, with a hole where the connection broke
    incomplete(&finals[0], &["samples lost"]);
    same(offline, &finals[1]);
    let reasons = format!("{:?}", finals.iter().map(|v| &v["reason"]).collect::<Vec<_>>());
    assert!(!reasons.contains("two publishers"), "{reasons}");
}

/// Resident memory of a process [kB].
fn resident_kb(process: u32) -> u64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
    let line = text.lines().find(|l| l.starts_with("VmRSS")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// A greeting without secret, as far as it may be known to strangers.
fn hello(flags: u32) -> Vec<u8> {
    let mut b = b"ema-brg1".to_vec();
    b.extend(flags.to_le_bytes());
    b.extend(10_000_u32.to_le_bytes());
    b.extend(rand::random::<[u8; 16]>());
    b.extend(rand::random::<[u8; 32]>());
    b
}

/// Connects and does harm number `kind`; the answer, if any, is not waited for longer than `patience`.
fn attack(to: &str, kind: usize, patience: Duration) {
    let Ok(mut s) = TcpStream::connect(to) else { return };
    let _ = s.set_read_timeout(Some(patience));
    let random: [u8; 256] = std::array::from_fn(|_| rand::random());
    let mut answer = [0; 256];
    let mut say = |bytes: &[u8]| s.write_all(bytes).is_ok();
    match kind {
        // connects and goes
        0 => return,
        1 => say(&random),
        // half a greeting
        2 => say(&hello(1)[..40]),
        // no secret where one is asked for
        3 => say(&hello(0)),
        // another secret
        4 => say(&hello(1)) && say(&random[..32]),
        // an Arrow message of 2 GB instead of a greeting
        5 => say(&[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f]) && say(&random),
        // byte by byte
        6 => hello(1).iter().take(6).all(|b| {
            std::thread::sleep(Duration::from_millis(20));
            say(&[*b])
        }),
        // says nothing
        _ => true,
    };
    let _ = s.read(&mut answer);
}

/// 240 hostile connections of all kinds beside an honest one: the honest diagnosis has the bits of the offline one,
/// and the bridge goes on taking connections.
#[test]
fn e2e_hostile_connections_harm_nobody() {
    let offline = &recording().1;
    let dir = tempfile::tempdir().unwrap();
    let good = secret(&dir, "good", "correct horse battery staple\n");
    let (near, far) = (TestDomain::default(), TestDomain::default());
    let mut live = live(&far, &["--exit-after", "2"]);
    let (mut receiver, to) = receiver(&far, &["--secret-file", &good]);
    let sender_ = sender(&near, &to, &["--secret-file", &good]);
    let before_kb = resident_kb(receiver.id());
    let done = Arc::new(AtomicUsize::new(0));
    let attackers: Vec<_> = (0..240)
        .map(|k| {
            let (to, done) = (to.clone(), done.clone());
            std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(8 * k as u64));
                attack(&to, k % 8, Duration::from_millis(1500));
                done.fetch_add(1, Ordering::Relaxed);
            })
        })
        .collect();
    let mut first = replay(&near, &["--speed", "2", "--frame-ms", "150"]);
    assert_eq!(first.code(), Some(0), "{} {}", first.errors(), receiver.errors());
    attackers.into_iter().for_each(|a| a.join().unwrap());
    assert_eq!(done.load(Ordering::Relaxed), 240);
    // a sender that is new to it
    sender_.interrupt();
    let other = TestDomain::default();
    let _second = sender(&other, &to, &["--secret-file", &good]);
    let mut again = replay(&other, &["--speed", "max"]);
    assert_eq!(again.code(), Some(0), "{} {}", again.errors(), receiver.errors());
    assert_eq!(live.code(), Some(0), "{} {}", live.errors(), receiver.errors());
    let finals = finals(&live);
    assert_eq!(finals.len(), 2);
    finals.iter().for_each(|v| same(offline, v));
    let said = receiver.errors();
    assert!(
        said.contains("does not know the secret") && said.contains("has no secret"),
        "{said}"
    );
    assert!(receiver.has_ended().is_none());
    println!(
        "resident: {before_kb} kB before, {} kB after",
        resident_kb(receiver.id())
    );
}

/// Peers that have been greeted (no secret is asked for) and then lie about lengths hold no memory, and are told apart
/// from an honest one.
#[test]
fn refuse_declared_lengths_without_making_room_for_them() {
    let far = TestDomain::default();
    let (mut receiver, to) = receiver(&far, &[]);
    let before_kb = resident_kb(receiver.id());
    let mut held = Vec::new();
    for k in 0..24 {
        let mut s = TcpStream::connect(&to).unwrap();
        s.set_read_timeout(Some(LIMIT)).unwrap();
        s.write_all(&hello(0)).unwrap();
        s.read_exact(&mut [0; 68]).unwrap();
        // a schema of 64 kB that does not come, or one that is too large
        let declared: u32 = if k % 2 == 0 { 65_000 } else { 0x7fff_ffff };
        let _ = s.write_all(&[&[0xff; 4][..], &declared.to_le_bytes(), &[7; 5000]].concat());
        held.push(s);
    }
    receiver.until("refusals", LIMIT, |p| {
        p.errors().matches("description of 2147483647 bytes").count() == 12
    });
    let grown_kb = resident_kb(receiver.id()).saturating_sub(before_kb);
    assert!(grown_kb < 20_000, "{grown_kb} kB for 24 peers of 5 kB");
    // those that begin and say no more are given up too
    receiver.until("slow ones", LIMIT, |p| p.errors().matches("too slow").count() == 12);
    drop(held);
}

/// Out of files, connections are refused; when there are files again, they are taken.
#[test]
fn e2e_bridge_without_files_refuses_and_goes_on() {
    let offline = &recording().1;
    let (near, far) = (TestDomain::default(), TestDomain::default());
    let mut live = live(&far, &["--exit-after", "1"]);
    let inner = ema(&far, &["bridge", "receive", "--listen", "127.0.0.1:0"]);
    let mut limited = Command::new("sh");
    limited
        .args(["-c", "ulimit -n 90; exec \"$0\" \"$@\""])
        .arg(inner.get_program())
        .args(inner.get_args());
    for (k, v) in inner.get_envs() {
        limited.env(k, v.unwrap());
    }
    let mut receiver = Program::start(limited);
    let to = receiver.address(LIMIT);
    let crowd: Vec<_> = (0..300).filter_map(|_| TcpStream::connect(&to).ok()).collect();
    receiver.until("refusal", LIMIT, |p| p.errors().contains("a connection is refused"));
    drop(crowd);
    let _sender = sender(&near, &to, &[]);
    let mut run = replay(&near, &["--speed", "max"]);
    assert_eq!(run.code(), Some(0), "{} {}", run.errors(), receiver.errors());
    assert_eq!(live.code(), Some(0), "{}", live.errors());
    same(offline, &finals(&live)[0]);
}

fn tls(name: &str) -> Vec<String> {
    let file = |f: &str| -> String {
        let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/tls").join(f);
        path.to_str().unwrap().into()
    };
    let (cert, key) = (file(&format!("{name}.pem")), file(&format!("{name}.key")));
    let ca = file("authority.pem");
    ["--tls-cert", &cert, "--tls-key", &key, "--tls-ca", &ca]
        .map(String::from)
        .into()
}

/// Secret and certificates together; who lacks either does not get in, and is told why.
#[test]
fn e2e_bridge_with_secret_and_certificates() {
    let offline = &recording().1;
    let dir = tempfile::tempdir().unwrap();
    let good = secret(&dir, "good", "correct horse battery staple\n");
    let bad = secret(&dir, "bad", "incorrect horse battery staple");
    let own = tls("end");
    let own: Vec<&str> = own.iter().map(String::as_str).collect();
    let impostor = tls("impostor");
    let impostor: Vec<&str> = impostor.iter().map(String::as_str).collect();
    let (near, far) = (TestDomain::default(), TestDomain::default());
    let mut live = live(&far, &["--exit-after", "1"]);
    let (mut receiver, to) = receiver(&far, &[&["--secret-file", &good][..], &own].concat());
    let refused = |args: &[&str], words: &str| {
        let mut p = Program::start(ema(&near, &[&["bridge", "send", "--to", &to][..], args].concat()));
        assert_eq!(p.code(), Some(4), "{}", p.errors());
        assert!(p.errors().contains(words), "no `{words}` in {}", p.errors());
        assert_eq!(p.errors().lines().count(), 1, "{}", p.errors());
    };
    refused(&[&["--secret-file", &bad][..], &own].concat(), "another secret");
    refused(&own, "asks for a secret");
    let short = secret(&dir, "short", "1234");
    refused(&["--secret-file", &short], "16 to 4096 bytes");
    refused(&["--secret-file", "/nowhere"], "/nowhere");
    refused(
        &["--tls-cert", &short, "--tls-key", &short, "--tls-ca", &short],
        "certificates",
    );
    // a certificate of another authority, and no TLS at all: neither gets as far as a greeting
    for args in [
        &[&["--secret-file", &good][..], &impostor].concat()[..],
        &["--secret-file", &good],
    ] {
        let mut p = Program::start(ema(&near, &[&["bridge", "send", "--to", &to][..], args].concat()));
        p.until("refusal", LIMIT, |p| p.errors().contains("connection broken"));
        assert!(!p.errors().contains("connected to"), "{}", p.errors());
        p.kill();
    }
    let _sender = sender(&near, &to, &[&["--secret-file", &good][..], &own].concat());
    let mut run = replay(&near, &["--speed", "max", "--frame-ms", "200"]);
    assert_eq!(run.code(), Some(0), "{} {}", run.errors(), receiver.errors());
    assert_eq!(live.code(), Some(0), "{}", live.errors());
    same(offline, &finals(&live)[0]);
    receiver.interrupt();
    assert_eq!(receiver.code(), Some(130), "{}", receiver.errors());
}

/// A peer that falls silent is given up by either end; one that is only idle is not.
#[test]
fn e2e_silent_peers_are_given_up_and_idle_ones_are_not() {
    let (near, far) = (TestDomain::default(), TestDomain::default());
    let (mut receiver, to) = receiver(&far, &["--idle", "1"]);
    let mut idle = sender(&near, &to, &["--idle", "1"]);
    let mut mute = TcpStream::connect(&to).unwrap();
    mute.write_all(&hello(0)).unwrap();
    receiver.until("silence", LIMIT, |p| p.errors().contains("has said nothing for 1 s"));
    assert!(!idle.errors().contains("broken"), "{}", idle.errors());
    // the other way round: a receiver that stops
    let signal = |s: &str| {
        let _ = Command::new("kill").args([s, &receiver.id().to_string()]).status();
    };
    signal("-STOP");
    let start = Instant::now();
    idle.until("silence", LIMIT, |p| p.errors().contains("has said nothing for 1 s"));
    println!("noticed after {:.1} s", start.elapsed().as_secs_f64());
    signal("-CONT");
    receiver.until("again", LIMIT, |p| p.errors().matches(" connected").count() >= 2);
}
