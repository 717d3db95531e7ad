//! The receiving end: an ordinary publisher of its domain for every sender that connects.

use super::greeting::{self, Verdict};
use super::hall::{Entrance, Hall, Session};
use super::link::{Link, Reader, Wait};
use super::message::{Message, Messages};
use super::relay::{Outcome, Terms};
use super::table::Row;
use super::{ALIVE, Answer, GREETING, Guard, Traffic, address, locked, note};
use anyhow::{Context, Result, bail};
use arrow::array::RecordBatch;
use rustls::{ServerConfig, ServerConnection};
use schemas::foreign;
use schemas::stream::Domain;
use std::fs::File;
use std::io::ErrorKind;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Connections in their greeting at once; the oldest gives way to the next one.
const GREETINGS: usize = 64;

/// Between two words about connections that cannot be taken.
const COMPLAINT: Duration = Duration::from_secs(5);

/// Refused frames of a connection that are named; the others are counted.
const NAMED: u64 = 5;

/// What a receiving end takes upon itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// senders at once
    pub most_connections: usize,
    /// bytes of a message
    pub most_message: usize,
    /// streams (actuators under test) of a sender at once
    pub most_streams: usize,
    /// how long a stream waits for a subscriber of this domain
    pub patience: Duration,
}

/// What all connections share.
struct Desk<'a> {
    domain: &'a Domain,
    guard: &'a Guard<ServerConfig>,
    limits: Limits,
    go_on: &'a (dyn Fn() -> bool + Sync),
    say: &'a (dyn Fn(&str) + Sync),
    hall: Hall,
    /// connections in their greeting
    greetings: Mutex<Vec<(u64, TcpStream)>>,
    total: Mutex<Traffic>,
}

/// Publishes in a domain what far bridges send, a thread a connection, until `go_on` says no.
///
/// # Errors
/// An address that cannot be listened on. What single connections do wrong is said, and ends them alone.
pub fn receive(
    domain: &Domain,
    listen: &str,
    guard: &Guard<ServerConfig>,
    limits: Limits,
    go_on: &(dyn Fn() -> bool + Sync),
    say: &(dyn Fn(&str) + Sync),
) -> Result<Traffic> {
    let listener = TcpListener::bind(address(listen)?).with_context(|| format!("{listen}: cannot be listened on"))?;
    listener.set_nonblocking(true)?;
    let local = listener.local_addr()?;
    if guard.secret.is_none() && guard.tls.is_none() && !local.ip().is_loopback() {
        say("neither --secret-file nor --tls-cert: whoever reaches this address may send");
    }
    note(say, &format!("listening on {local}"));
    // a broken stream is told in one line below, not with a trace
    std::panic::set_hook(Box::new(|_| ()));
    let desk = Desk {
        domain,
        guard,
        limits,
        go_on,
        say,
        hall: Hall::default(),
        greetings: Mutex::default(),
        total: Mutex::default(),
    };
    std::thread::scope(|scope| {
        let mut door = Door::new(listener);
        let mut number = 0;
        while go_on() {
            let Some((socket, from)) = door.next(say) else { continue };
            number += 1;
            let (desk, n) = (&desk, number);
            let thread = std::thread::Builder::new().spawn_scoped(scope, move || desk.attend(socket, from, n));
            if let Err(e) = thread {
                door.complain(say, &e);
            }
        }
        desk.hall.stop();
    });
    Ok(desk.total.into_inner().unwrap_or_default())
}

/// The listener, and one file more than it needs: when there are no more files, that one is given up to take a
/// connection and close it, so that its peer hears of it and the next one is not kept waiting.
struct Door {
    listener: TcpListener,
    spare: Option<File>,
    complained: Option<Instant>,
}

impl Door {
    fn new(listener: TcpListener) -> Self {
        Self {
            listener,
            spare: File::open("/dev/null").ok(),
            complained: None,
        }
    }

    /// The next connection; `None` after a moment without one.
    fn next(&mut self, say: &dyn Fn(&str)) -> Option<(TcpStream, SocketAddr)> {
        match self.listener.accept() {
            Ok(accepted) => return Some(accepted),
            Err(e) if e.kind() == ErrorKind::WouldBlock => std::thread::sleep(Duration::from_millis(20)),
            Err(e) => {
                self.complain(say, &e);
                self.spare = None;
                while self.listener.accept().is_ok() {}
                self.spare = File::open("/dev/null").ok();
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        None
    }

    fn complain(&mut self, say: &dyn Fn(&str), e: &std::io::Error) {
        if self.complained.is_none_or(|t| t.elapsed() > COMPLAINT) {
            self.complained = Some(Instant::now());
            say(&format!("a connection is refused: {e}"));
        }
    }
}

impl Desk<'_> {
    /// One connection from beginning to end; whatever happens, only it ends.
    fn attend(&self, socket: TcpStream, from: SocketAddr, number: u64) {
        let mut traffic = Traffic::default();
        let work = || self.serve(socket, from, number, &mut traffic);
        let result = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| bail!("damaged within"));
        self.greeted(number);
        let frames = traffic.frames;
        match result {
            Ok(()) => note(self.say, &format!("{from} has finished: {frames} frames")),
            Err(_) if !(self.go_on)() => {}
            Err(e) => {
                let why = format!("{e:#}");
                (self.say)(&format!("{from}: {}; {frames} frames received", foreign::value(&why)));
            }
        }
        let mut t = locked(&self.total);
        t.frames += traffic.frames;
        t.streams += traffic.streams;
        t.connections += traffic.connections;
    }

    /// A connection begins its greeting; there is room for it, if need be the oldest one's.
    fn greet(&self, number: u64, socket: &TcpStream) -> std::io::Result<()> {
        let clone = socket.try_clone()?;
        let mut greetings = locked(&self.greetings);
        if greetings.len() >= GREETINGS {
            let _ = greetings.remove(0).1.shutdown(Shutdown::Both);
        }
        greetings.push((number, clone));
        Ok(())
    }

    /// Its greeting is over.
    fn greeted(&self, number: u64) {
        locked(&self.greetings).retain(|(n, _)| *n != number);
    }

    fn serve(&self, socket: TcpStream, from: SocketAddr, number: u64, traffic: &mut Traffic) -> Result<()> {
        self.greet(number, &socket)?;
        let until = Some(Instant::now() + GREETING);
        let wait = Wait {
            go_on: self.go_on,
            until,
        };
        let tls = self
            .guard
            .tls
            .as_ref()
            .map(|c| ServerConnection::new(c.clone()))
            .transpose()?;
        let idle = self.guard.idle;
        let link = Link::open(socket, tls.map(rustls::Connection::from), idle, &wait).context("refused")?;
        let link = Arc::new(link);
        let peer = greeting::hear(&link, self.guard.secret.as_ref(), idle, &wait).context("refused")?;
        let session = match self
            .hall
            .enter(peer.session, number, &link, self.limits.most_connections)
        {
            Entrance::New(s) => s,
            Entrance::Again(s) => {
                note(self.say, &format!("{from} takes over from its former connection"));
                s
            }
            Entrance::Full => {
                greeting::refuse(&link, Verdict::TooMany, &wait);
                bail!(
                    "refused: {} are connected (--most-connections)",
                    self.limits.most_connections
                );
            }
        };
        // whatever happens, the session is left
        let work = || -> Result<()> {
            greeting::welcome(&link, &peer, &wait)?;
            self.take(&link, &session, number, peer.keep_alive, until, from, traffic)
        };
        let result = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| bail!("damaged within"));
        let taken_over = !session.is_of(number);
        self.hall.leave(peer.session, number);
        link.close();
        match result {
            Err(_) if taken_over => bail!("taken over by the sender's next connection"),
            other => other,
        }
    }

    /// Everything that a sender sends.
    #[allow(clippy::too_many_arguments)]
    fn take(
        &self,
        link: &Link,
        session: &Session,
        number: u64,
        keep_alive: Duration,
        until: Option<Instant>,
        from: SocketAddr,
        traffic: &mut Traffic,
    ) -> Result<()> {
        let go_on = || (self.go_on)() && session.is_of(number);
        let wait = Wait { go_on: &go_on, until };
        let mut messages = Messages::begin(Reader { link, wait }, self.limits.most_message)?;
        self.greeted(number);
        note(self.say, &format!("{from} connected"));
        traffic.connections = 1;
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            // a stream may wait for its subscriber; the sender hears of this end all the same
            std::thread::Builder::new().spawn_scoped(scope, || say_alive(link, keep_alive, &over))?;
            let publishing = Publishing {
                desk: self,
                link,
                session,
                number,
                from,
            };
            let work = || publishing.run(&mut messages, traffic);
            let result = catch_unwind(AssertUnwindSafe(work));
            over.store(true, Ordering::Relaxed);
            result.unwrap_or_else(|_| bail!("damaged within"))
        })
    }
}

/// Says now and then that this end is alive, until it is over.
fn say_alive(link: &Link, every: Duration, over: &AtomicBool) {
    let go_on = || !over.load(Ordering::Relaxed);
    let wait = Wait {
        go_on: &go_on,
        until: None,
    };
    let alive = Answer {
        kind: ALIVE,
        ..Answer::default()
    }
    .to_bytes();
    while go_on() {
        if link.quiet_for() >= every && link.write_all(&alive, &wait).is_err() {
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A connection whose sender is known.
struct Publishing<'a> {
    desk: &'a Desk<'a>,
    link: &'a Link,
    session: &'a Session,
    number: u64,
    from: SocketAddr,
}

impl Publishing<'_> {
    fn run(&self, messages: &mut Messages<'_>, traffic: &mut Traffic) -> Result<()> {
        let mut refused = 0;
        let result = loop {
            let (meta, body) = match messages.next() {
                Ok(Message::Frames { meta, body }) => (meta, body),
                Ok(Message::End) => break Ok(()),
                Err(e) => break Err(e),
            };
            match messages.rows(&meta, body) {
                Ok(batch) => {
                    if let Err(e) = self.publish(&batch, traffic, &mut refused) {
                        break Err(e);
                    }
                }
                Err(e) => self.refuse(&format!("{e:#}"), &mut refused),
            }
        };
        if refused > NAMED {
            (self.desk.say)(&format!("{}: {refused} frames refused in all", self.from));
        }
        let open = locked(&self.session.streams).open();
        if open > 0 && (self.desk.go_on)() {
            let how = result.err().map_or("ended".into(), |e| format!("{e:#}"));
            bail!("{how}, in the middle of {open} streams");
        }
        result
    }

    fn publish(&self, batch: &RecordBatch, traffic: &mut Traffic, refused: &mut u64) -> Result<()> {
        let go_on = || (self.desk.go_on)() && self.session.is_of(self.number);
        let terms = Terms {
            domain: self.desk.domain,
            patience: self.desk.limits.patience,
            most_streams: self.desk.limits.most_streams,
            go_on: &go_on,
            stop: &self.session.stop,
        };
        for i in 0..batch.num_rows() {
            let outcome = {
                let mut streams = locked(&self.session.streams);
                if !self.session.is_of(self.number) {
                    bail!("taken over");
                }
                streams.relay(Row { batch, i }, &terms)?
            };
            traffic.frames += 1;
            match outcome {
                Outcome::Nothing => {}
                Outcome::Refused(why) => self.refuse(&why, refused),
                Outcome::Answer(answer) => {
                    traffic.streams += u64::from(answer.kind == schemas::stream::frame::END);
                    let wait = Wait {
                        go_on: &go_on,
                        until: None,
                    };
                    self.link.write_all(&answer.to_bytes(), &wait)?;
                }
            }
        }
        Ok(())
    }

    /// A frame is left out; the first ones are named.
    fn refuse(&self, why: &str, refused: &mut u64) {
        *refused += 1;
        if *refused <= NAMED {
            (self.desk.say)(&format!("{}: frame refused: {}", self.from, foreign::value(why)));
        }
    }
}
