//! What a sender's rows become in shared memory: its streams, in one room of fixed size.

use super::table::Row;
use super::{Answer, MOST_ROWS};
use anyhow::Result;
use arrow::array::AsArray;
use arrow::datatypes::Float64Type;
use schemas::channel::{Channel, ChannelSet};
use schemas::stream::Domain;
use schemas::stream::frame::{BEGIN, END};
use schemas::stream::publisher::{Delivery, Pass, Publisher};
use std::collections::{HashMap, VecDeque};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Ended streams whose answers are remembered, for a sender that has not heard them.
const ENDED: usize = 1024;

/// A stream that has said nothing for so long may give way to another one.
const FORGOTTEN: Duration = Duration::from_secs(60);

/// A far stream as it goes on here.
struct Stream {
    /// `None` where nobody wanted it
    pass: Option<Pass>,
    channels: ChannelSet,
    seen: Instant,
}

/// The streams of a sender.
#[derive(Default)]
pub(super) struct Streams {
    publisher: Option<Publisher>,
    streams: HashMap<u64, Stream>,
    ended: VecDeque<Answer>,
}

/// Where rows go, and on which terms.
pub(super) struct Terms<'a> {
    pub domain: &'a Domain,
    pub patience: Duration,
    pub most_streams: usize,
    pub go_on: &'a dyn Fn() -> bool,
    pub stop: &'a OnceLock<Arc<AtomicBool>>,
}

/// What a row has led to.
#[derive(Debug)]
pub(super) enum Outcome {
    Nothing,
    Answer(Answer),
    /// the frame is left out, and is a gap in its stream: why
    Refused(String),
}

impl Streams {
    /// Streams that have begun and not ended.
    pub fn open(&self) -> usize {
        self.streams.len()
    }

    /// Publishes one frame. A frame that cannot be is left out; the others go on.
    ///
    /// # Errors
    /// Shared memory that refuses; `go_on` said no while a stream began.
    pub fn relay(&mut self, row: Row<'_>, terms: &Terms<'_>) -> Result<Outcome> {
        if let Err(why) = row.check() {
            return Ok(Outcome::Refused(why));
        }
        let (kind, stream) = (row.u32("kind"), row.u64("stream"));
        if let Some(a) = self.ended.iter().find(|a| a.stream == stream) {
            // asked again, or too late
            return Ok(if kind == END {
                Outcome::Answer(*a)
            } else {
                Outcome::Nothing
            });
        }
        if kind == END {
            return self.end(row, terms);
        }
        if !self.streams.contains_key(&stream) {
            if let Some(why) = self.no_room(terms.most_streams) {
                return Ok(Outcome::Refused(why));
            }
            self.begin(row, terms)?;
        }
        if kind == BEGIN {
            let wanted = self.streams.get(&stream).is_some_and(|s| s.pass.is_some());
            let answer = Outcome::Answer(Answer {
                stream,
                frames: 0,
                kind,
            });
            return Ok(if wanted { answer } else { Outcome::Nothing });
        }
        self.samples(row)
    }

    /// Makes room for another stream, or says why there is none.
    fn no_room(&mut self, most: usize) -> Option<String> {
        if self.streams.len() < most {
            return None;
        }
        let oldest = self.streams.iter().min_by_key(|(_, s)| s.seen);
        match oldest.filter(|(_, s)| s.seen.elapsed() > FORGOTTEN).map(|(k, _)| *k) {
            Some(k) => {
                self.streams.remove(&k);
                None
            }
            None => Some(format!("one stream more than {most} at once (--most-streams)")),
        }
    }

    /// The room in shared memory, made for the first stream and never exchanged: every frame fits.
    fn publisher(&mut self, terms: &Terms<'_>) -> Result<&mut Publisher> {
        if self.publisher.is_none() {
            let p = Publisher::open(terms.domain, Delivery::Lossless, MOST_ROWS, Channel::COUNT)?;
            let _ = terms.stop.set(p.stop_flag());
            self.publisher = Some(p);
        }
        Ok(self.publisher.as_mut().expect("just opened"))
    }

    fn begin(&mut self, row: Row<'_>, terms: &Terms<'_>) -> Result<()> {
        let about = row.description();
        let channels = about.channels;
        let pass = self.publisher(terms)?.begin(&about, terms.patience, terms.go_on)?;
        if pass.is_none() && !(terms.go_on)() {
            // not that nobody wanted it: a successor of this connection will ask again
            anyhow::bail!("stopped");
        }
        let seen = Instant::now();
        self.streams.insert(row.u64("stream"), Stream { pass, channels, seen });
        Ok(())
    }

    fn end(&mut self, row: Row<'_>, terms: &Terms<'_>) -> Result<Outcome> {
        let (stream, number) = (row.u64("stream"), row.u64("frame"));
        let mut answer = Answer {
            stream,
            frames: 0,
            kind: END,
        };
        if let Some(Stream {
            pass: Some(mut pass), ..
        }) = self.streams.remove(&stream)
        {
            pass.skip_to(number);
            let ending = self.publisher(terms)?.end(&pass, terms.patience, terms.go_on)?;
            answer.frames = if ending.whole > 0 { number.saturating_sub(1) } else { 0 };
        }
        if self.ended.len() >= ENDED {
            self.ended.pop_front();
        }
        self.ended.push_back(answer);
        Ok(Outcome::Answer(answer))
    }

    fn samples(&mut self, row: Row<'_>) -> Result<Outcome> {
        let (Some(publisher), Some(s)) = (self.publisher.as_mut(), self.streams.get_mut(&row.u64("stream"))) else {
            return Ok(Outcome::Nothing);
        };
        s.seen = Instant::now();
        let (number, channels) = (row.u64("frame"), row.description().channels);
        let Some(pass) = s.pass.as_mut().filter(|p| number >= p.frames()) else {
            return Ok(Outcome::Nothing);
        };
        if channels != s.channels {
            return Ok(Outcome::Refused("other channels than its stream began with".into()));
        }
        pass.skip_to(number);
        let mut frame = publisher.loan(pass, row.u64("first"), row.u32("rows") as usize)?;
        let mut view = frame.view_mut();
        for c in channels.iter() {
            if let (Some(values), Some(to)) = (row.column(c), view.column_mut(c)) {
                to.copy_from_slice(values.as_primitive::<Float64Type>().values());
            }
        }
        publisher.publish(pass, frame)?;
        Ok(Outcome::Nothing)
    }
}
