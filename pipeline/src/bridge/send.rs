//! The sending end: an ordinary subscriber of its domain.

use super::greeting::{self, Hopeless, Token};
use super::link::{Link, Wait};
use super::table::{self, to_row};
use super::tls::Client;
use super::{ALIVE, ANSWER, Answer, GREETING, Guard, MOST_ROWS, Traffic, address, note};
use anyhow::{Result, bail};
use arrow::array::RecordBatch;
use arrow::ipc::writer::StreamWriter;
use schemas::error::Error;
use schemas::stream::Domain;
use schemas::stream::frame::{BEGIN, END, FrameHeader, SAMPLES};
use schemas::stream::subscriber::{Frame, Subscriber};
use std::collections::HashMap;
use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

/// Streams whose numbers are remembered, and first and last frames that wait for an answer; the oldest give way.
const REMEMBERED: usize = 4096;

/// Between two attempts at a connection: at first, and at most.
const AGAIN: Duration = Duration::from_millis(100);
const AGAIN_AT_MOST: Duration = Duration::from_secs(2);

/// A first or last frame that waits for the far end's answer.
struct Waiting {
    header: FrameHeader,
    /// its number on the wire
    frame: u64,
}

impl Waiting {
    /// What the near publisher is told: all its frames, or none.
    fn frames(&self, a: Answer) -> u64 {
        match self.header.kind {
            END if a.frames > 0 && a.frames + 1 == self.frame => self.header.frame.saturating_sub(1),
            END => 0,
            _ => a.frames,
        }
    }
}

/// Frames are counted anew for the wire, since a long one goes as several.
#[derive(Clone, Copy)]
struct Numbers {
    /// what is expected of the publisher next, and its number on the wire
    near: u64,
    far: u64,
    seen: u64,
}

/// What lasts longer than a connection.
struct Sender {
    subscriber: Subscriber,
    session: Token,
    numbers: HashMap<u64, Numbers>,
    waiting: Vec<Waiting>,
    seen: u64,
    traffic: Traffic,
}

impl Sender {
    fn new(domain: &Domain) -> schemas::error::Result<Self> {
        Ok(Self {
            subscriber: Subscriber::open(domain)?,
            session: rand::random(),
            numbers: HashMap::new(),
            waiting: Vec::new(),
            seen: 0,
            traffic: Traffic::default(),
        })
    }

    /// Number on the wire of a frame that goes as `parts`; gaps stay gaps. `None`: its number was passed.
    fn number(&mut self, h: &FrameHeader, parts: u64) -> Option<u64> {
        self.seen += 1;
        if self.numbers.len() >= REMEMBERED && !self.numbers.contains_key(&h.stream) {
            let oldest = self.numbers.iter().min_by_key(|(_, n)| n.seen).map(|(k, _)| *k);
            oldest.and_then(|k| self.numbers.remove(&k));
        }
        let (near, seen) = (h.frame, self.seen);
        let n = self
            .numbers
            .entry(h.stream)
            .or_insert(Numbers { near, far: near, seen });
        n.seen = seen;
        let far = n.far + h.frame.checked_sub(n.near)?;
        if h.kind != END {
            (n.near, n.far) = (h.frame + 1, far + parts);
        }
        Some(far)
    }

    /// The rows of a frame; none for one that is known.
    fn rows(&mut self, frame: Frame) -> Result<Vec<RecordBatch>> {
        let h = *frame.header();
        if frame.view().is_err() || h.frame > table::MOST {
            return Ok(Vec::new());
        }
        if h.kind != SAMPLES {
            return self.greeting(&h);
        }
        let rows = h.rows as usize;
        let parts = rows.div_ceil(MOST_ROWS);
        let Some(number) = self.number(&h, parts as u64) else {
            return Ok(Vec::new());
        };
        let step = rows.div_ceil(parts);
        let batch = frame.into_record_batch()?;
        let part = |k: usize| {
            let from = k * step;
            to_row(&h, number + k as u64, Some((&batch, from, step.min(rows - from))))
        };
        (0..parts).map(part).collect()
    }

    /// The row of a first or last frame.
    fn greeting(&mut self, h: &FrameHeader) -> Result<Vec<RecordBatch>> {
        let mut known = self.waiting.iter();
        if known.any(|w| w.header.stream == h.stream && w.header.kind == h.kind) {
            return Ok(Vec::new());
        }
        // a first frame that comes again says nothing of the numbers
        let frame = match h.kind {
            BEGIN => self.number(h, 1).unwrap_or(0),
            _ => self.number(h, 1).unwrap_or(h.frame),
        };
        if self.waiting.len() >= REMEMBERED {
            self.waiting.remove(0);
        }
        self.waiting.push(Waiting { header: *h, frame });
        self.traffic.streams += u64::from(h.kind == BEGIN);
        Ok(vec![to_row(h, frame, None)?])
    }

    /// Passes an answer of the far end on to the publisher.
    fn answered(&mut self, a: Answer) -> Result<()> {
        let mine = |w: &Waiting| w.header.stream == a.stream && w.header.kind == a.kind;
        let Some(i) = self.waiting.iter().position(mine) else {
            return Ok(());
        };
        let w = self.waiting.swap_remove(i);
        if a.kind == END {
            self.numbers.remove(&a.stream);
        }
        Ok(self.subscriber.answer(&w.header, w.frames(a))?)
    }

    /// Carries frames and answers until `go_on` says no.
    fn forward(&mut self, link: &Arc<Link>, keep_alive: Duration, go_on: &dyn Fn() -> bool) -> Result<()> {
        let answers = read_answers(link.clone());
        let heard = || go_on() && !link.is_silent();
        let wait = Wait {
            go_on: &heard,
            until: None,
        };
        let schema = table::schema();
        let mut writer = StreamWriter::try_new(Vec::new(), &schema)?;
        // what the last connection may have swallowed
        for w in &self.waiting {
            writer.write(&to_row(&w.header, w.frame, None)?)?;
        }
        link.write_all(&std::mem::take(writer.get_mut()), &wait)?;
        while go_on() {
            while let Some(frame) = self.subscriber.receive()? {
                for row in self.rows(frame)? {
                    writer.write(&row)?;
                    self.traffic.frames += 1;
                }
                link.write_all(&std::mem::take(writer.get_mut()), &wait)?;
            }
            if link.quiet_for() > keep_alive {
                writer.write(&RecordBatch::new_empty(schema.clone()))?;
                link.write_all(&std::mem::take(writer.get_mut()), &wait)?;
            }
            self.take_answers(&answers)?;
            let nap = if self.waiting.is_empty() { 50 } else { 1 };
            self.subscriber.wait(Duration::from_millis(nap))?;
        }
        writer.finish()?;
        let stopping = Wait {
            go_on: &|| true,
            until: Some(Instant::now() + Duration::from_secs(1)),
        };
        Ok(link.write_all(writer.get_ref(), &stopping)?)
    }

    fn take_answers(&mut self, answers: &Receiver<std::io::Result<Answer>>) -> Result<()> {
        loop {
            match answers.try_recv() {
                Ok(Ok(a)) if a.kind == ALIVE => {}
                Ok(Ok(a)) => self.answered(a)?,
                Ok(Err(e)) => return Err(e.into()),
                Err(TryRecvError::Empty) => return Ok(()),
                Err(TryRecvError::Disconnected) => bail!("closed by the far end"),
            }
        }
    }
}

fn read_answers(link: Arc<Link>) -> Receiver<std::io::Result<Answer>> {
    let (tell, told) = channel();
    std::thread::spawn(move || {
        let wait = Wait {
            go_on: &|| true,
            until: None,
        };
        let mut bytes = [0; ANSWER];
        loop {
            match link.read_exact(&mut bytes, &wait) {
                Ok(()) => {
                    if tell.send(Ok(Answer::from_bytes(&bytes))).is_err() {
                        return;
                    }
                }
                Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => return,
                Err(e) => {
                    let _ = tell.send(Err(e));
                    return;
                }
            }
        }
    });
    told
}

fn connect(to: SocketAddr, patience: Duration, go_on: &dyn Fn() -> bool) -> Result<Option<TcpStream>> {
    let start = Instant::now();
    while go_on() {
        match TcpStream::connect_timeout(&to, Duration::from_secs(2)) {
            Ok(s) => return Ok(Some(s)),
            Err(e) if start.elapsed() > patience => {
                return Err(Error::Stream {
                    service: to.to_string(),
                    why: format!("nobody answers ({e})"),
                }
                .into());
            }
            Err(_) => std::thread::sleep(AGAIN),
        }
    }
    Ok(None)
}

/// Sends the frames of a domain to a far bridge until `go_on` says no. A broken connection is made
/// anew and goes on with the streams; frames that it swallowed are missed by the far end, and a lossless
/// publisher, whose last frame is answered accordingly, sends its run again.
///
/// # Errors
/// An address that nobody answers at; another secret; shared memory that refuses.
pub fn send(
    domain: &Domain,
    to: &str,
    guard: &Guard<Client>,
    patience: Duration,
    go_on: &dyn Fn() -> bool,
    say: &dyn Fn(&str),
) -> Result<Traffic> {
    let to = address(to)?;
    let mut sender = Sender::new(domain)?;
    let mut pause = AGAIN;
    while go_on() {
        let Some(socket) = connect(to, patience, go_on)? else {
            break;
        };
        sender.traffic.connections += 1;
        let began = Instant::now();
        match carry(&mut sender, socket, guard, go_on, &|| {
            note(say, &format!("connected to {to}"))
        }) {
            Ok(()) => {}
            Err(e) if e.is::<Hopeless>() => {
                let allowed = "--secret-file FILE, the same on both sides";
                return Err(Error::bad(to.to_string(), "secret", e, allowed).into());
            }
            Err(_) if !go_on() => {}
            Err(e) => {
                say(&format!("{to}: connection broken ({e:#}); connecting again"));
                pause = if began.elapsed() > AGAIN_AT_MOST {
                    AGAIN
                } else {
                    (pause * 2).min(AGAIN_AT_MOST)
                };
                rest(pause, go_on);
            }
        }
    }
    Ok(sender.traffic)
}

/// Sleeps in short naps, so that Ctrl-C is heard.
fn rest(pause: Duration, go_on: &dyn Fn() -> bool) {
    let start = Instant::now();
    while go_on() && start.elapsed() < pause {
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// One connection from its greeting to its end.
fn carry(
    sender: &mut Sender,
    socket: TcpStream,
    guard: &Guard<Client>,
    go_on: &dyn Fn() -> bool,
    connected: &dyn Fn(),
) -> Result<()> {
    let until = Some(Instant::now() + GREETING);
    let wait = Wait { go_on, until };
    let tls = guard.tls.as_ref().map(|c| c.begin()).transpose()?;
    let link = Arc::new(Link::open(socket, tls, guard.idle, &wait)?);
    let result = greeting::greet(&link, guard.secret.as_ref(), guard.idle, sender.session, &wait).and_then(|peer| {
        connected();
        sender.forward(&link, peer.keep_alive, go_on)
    });
    link.close();
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sender(name: &str) -> Sender {
        let domain = Domain::new(&format!("unit-{}-{name}", std::process::id())).unwrap();
        Sender::new(&domain).unwrap()
    }

    fn header(kind: u32, stream: u64, frame: u64) -> FrameHeader {
        FrameHeader {
            kind,
            stream,
            frame,
            ..FrameHeader::default()
        }
    }

    #[test]
    fn prop_parts_are_numbered_without_gaps_and_gaps_stay() {
        let mut s = sender("numbers");
        let mut number = |kind, frame, parts| s.number(&header(kind, 1, frame), parts);
        assert_eq!(number(BEGIN, 0, 1), Some(0));
        assert_eq!(number(SAMPLES, 1, 3), Some(1));
        assert_eq!(number(SAMPLES, 2, 1), Some(4));
        // sent twice: once
        assert_eq!(number(SAMPLES, 2, 1), None);
        // two frames are missing, and two numbers
        assert_eq!(number(SAMPLES, 5, 2), Some(7));
        assert_eq!(number(END, 6, 1), Some(9));
        // asked again
        assert_eq!(number(END, 6, 1), Some(9));
        // joined in the middle
        assert_eq!(s.number(&header(SAMPLES, 2, 40), 2), Some(40));
        assert_eq!(s.number(&header(SAMPLES, 2, 41), 2), Some(42));
    }

    #[test]
    fn prop_only_a_whole_run_is_answered_as_whole() {
        let w = Waiting {
            header: header(END, 1, 11),
            frame: 21,
        };
        let frames = |frames| {
            w.frames(Answer {
                stream: 1,
                frames,
                kind: END,
            })
        };
        assert_eq!((frames(20), frames(19), frames(0)), (10, 0, 0));
    }

    #[test]
    fn prop_streams_remembered_are_bounded() {
        let mut s = sender("bounded");
        for stream in 0..2 * REMEMBERED as u64 {
            s.number(&header(SAMPLES, stream, 1), 1);
        }
        assert_eq!(s.numbers.len(), REMEMBERED);
        assert!(s.numbers.contains_key(&(2 * REMEMBERED as u64 - 1)));
    }
}
