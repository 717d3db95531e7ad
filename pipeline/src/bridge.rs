//! The stream between computers: frames as Arrow IPC over TCP, a row a frame, columns as lists.
//! Each end is an ordinary subscriber or publisher of its domain; what the far subscribers answer
//! comes back, so that a lossless publisher waits for them as it does for near ones.

use anyhow::{Context, Result, bail};
use arrow::array::{
    Array, ArrayRef, AsArray, Float64Array, ListArray, RecordBatch, StringArray, UInt32Array, UInt64Array,
};
use arrow::buffer::OffsetBuffer;
use arrow::datatypes::{DataType, Field, Float64Type, Schema, UInt32Type, UInt64Type};
use arrow::ipc::reader::StreamReader;
use arrow::ipc::writer::StreamWriter;
use schemas::SCHEMA_VERSION;
use schemas::channel::{Channel, ChannelSet};
use schemas::error::Error;
use schemas::stream::Domain;
use schemas::stream::frame::{BEGIN, END, FrameHeader, RunDescription, SAMPLES};
use schemas::stream::publisher::{Delivery, Pass, Publisher};
use schemas::stream::subscriber::{Frame, Subscriber};
use std::collections::HashMap;
use std::io::{BufReader, BufWriter, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Metadata key of the schema version in the IPC stream.
const VERSION: &str = "ema.schema_version";

/// How long a full queue of the far subscribers, or the network, may hold a write up.
const STALLED: Duration = Duration::from_secs(60);

/// Bytes of an answer: stream, frames (little endian), kind.
const ANSWER: usize = 20;

/// An answer of the far end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Answer {
    stream: u64,
    frames: u64,
    kind: u32,
}

impl Answer {
    fn to_bytes(self) -> [u8; ANSWER] {
        let mut b = [0; ANSWER];
        b[..8].copy_from_slice(&self.stream.to_le_bytes());
        b[8..16].copy_from_slice(&self.frames.to_le_bytes());
        b[16..].copy_from_slice(&self.kind.to_le_bytes());
        b
    }
    fn from_bytes(b: &[u8; ANSWER]) -> Self {
        let word = |i: usize| u64::from_le_bytes(std::array::from_fn(|k| b[i + k]));
        Self {
            stream: word(0),
            frames: word(8),
            kind: u32::from_le_bytes(std::array::from_fn(|k| b[16 + k])),
        }
    }
}

/// The table on the wire.
fn schema() -> Arc<Schema> {
    let mut fields = Vec::new();
    for name in ["kind", "rows"] {
        fields.push(Field::new(name, DataType::UInt32, false));
    }
    for name in ["run", "stream", "frame", "first", "total_rows", "publish_ns"] {
        fields.push(Field::new(name, DataType::UInt64, false));
    }
    for name in ["actuator", "parameters", "sensors", "sequence"] {
        fields.push(Field::new(name, DataType::Utf8, false));
    }
    for name in ["rate_hz", "load_n_m"] {
        fields.push(Field::new(name, DataType::Float64, false));
    }
    for c in Channel::ALL {
        let unit = HashMap::from([("unit".to_string(), c.unit().to_string())]);
        fields
            .push(Field::new_list(c.name(), Field::new_list_field(DataType::Float64, false), true).with_metadata(unit));
    }
    let version = HashMap::from([(VERSION.to_string(), SCHEMA_VERSION.to_string())]);
    Arc::new(Schema::new(fields).with_metadata(version))
}

/// A frame as one row; its columns are not copied.
fn to_row(frame: Frame, schema: &Arc<Schema>) -> Result<RecordBatch> {
    let h = *frame.header();
    let run = h.description();
    let u32s = |x: u32| -> ArrayRef { Arc::new(UInt32Array::from(vec![x])) };
    let u64s = |x: u64| -> ArrayRef { Arc::new(UInt64Array::from(vec![x])) };
    let text = |x: &str| -> ArrayRef { Arc::new(StringArray::from(vec![x])) };
    let number = |x: f64| -> ArrayRef { Arc::new(Float64Array::from(vec![x])) };
    let rows = if h.kind == SAMPLES { h.rows } else { 0 };
    let mut columns = vec![
        u32s(h.kind),
        u32s(rows),
        u64s(h.run),
        u64s(h.stream),
        u64s(h.frame),
        u64s(h.first),
        u64s(h.total_rows),
        u64s(h.publish_ns),
        text(&run.actuator),
        text(&run.parameters),
        text(&run.sensors),
        text(&run.sequence),
        number(h.rate_hz),
        number(h.load_n_m),
    ];
    let batch = (h.kind == SAMPLES).then(|| frame.into_record_batch()).transpose()?;
    for c in Channel::ALL {
        let item = Arc::new(Field::new_list_field(DataType::Float64, false));
        let column: ArrayRef = match batch.as_ref().and_then(|b| b.column_by_name(c.name())) {
            Some(values) => Arc::new(ListArray::new(
                item,
                OffsetBuffer::from_lengths([values.len()]),
                values.clone(),
                None,
            )),
            // what a frame has no samples of: empty where the run has the channel, null where not
            None if run.channels.contains(*c) => Arc::new(ListArray::new(
                item,
                OffsetBuffer::from_lengths([0]),
                Arc::new(Float64Array::from(Vec::<f64>::new())),
                None,
            )),
            None => Arc::new(ListArray::new_null(item, 1)),
        };
        columns.push(column);
    }
    Ok(RecordBatch::try_new(schema.clone(), columns)?)
}

/// One row of a received batch.
struct Row<'a> {
    batch: &'a RecordBatch,
    i: usize,
}

impl Row<'_> {
    fn u64(&self, name: &str) -> u64 {
        self.batch[name].as_primitive::<UInt64Type>().value(self.i)
    }
    fn u32(&self, name: &str) -> u32 {
        self.batch[name].as_primitive::<UInt32Type>().value(self.i)
    }
    fn number(&self, name: &str) -> f64 {
        self.batch[name].as_primitive::<Float64Type>().value(self.i)
    }
    fn text(&self, name: &str) -> String {
        self.batch[name].as_string::<i32>().value(self.i).to_string()
    }
    /// The samples of a channel, if the run has it.
    fn column(&self, c: Channel) -> Option<ArrayRef> {
        let list = self.batch[c.name()].as_list::<i32>();
        list.is_valid(self.i).then(|| list.value(self.i))
    }
    fn description(&self) -> RunDescription {
        let present = Channel::ALL.iter().copied().filter(|c| self.column(*c).is_some());
        RunDescription {
            actuator: self.text("actuator"),
            parameters: self.text("parameters"),
            sensors: self.text("sensors"),
            sequence: self.text("sequence"),
            run: self.u64("run"),
            rate_hz: self.number("rate_hz"),
            channels: ChannelSet::of(present),
            total_rows: self.u64("total_rows"),
            load_n_m: self.number("load_n_m"),
        }
    }
}

fn address(text: &str) -> Result<SocketAddr> {
    let allowed = "HOST:PORT";
    let found = text.to_socket_addrs().ok().and_then(|mut a| a.next());
    found.ok_or_else(|| Error::bad("command line", "address", text, allowed).into())
}

/// What has gone through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    pub frames: u64,
    pub streams: u64,
    pub connections: u64,
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
            Err(_) => std::thread::sleep(Duration::from_millis(100)),
        }
    }
    Ok(None)
}

/// Sends the frames of a domain to a far bridge until `go_on` says no. A broken connection is made
/// anew; frames that it swallowed are missed by the far end, and a lossless publisher, whose last
/// frame stays unanswered, sends its run again.
pub fn send(
    domain: &Domain,
    to: &str,
    patience: Duration,
    go_on: &dyn Fn() -> bool,
    say: &dyn Fn(&str),
) -> Result<Traffic> {
    let to = address(to)?;
    let mut traffic = Traffic::default();
    let subscriber = Subscriber::open(domain)?;
    while go_on() {
        let Some(socket) = connect(to, patience, go_on)? else {
            break;
        };
        traffic.connections += 1;
        say(&format!("connected to {to}"));
        if let Err(e) = forward(&subscriber, socket, go_on, &mut traffic) {
            say(&format!("{to}: connection broken ({e:#}); connecting again"));
        }
    }
    Ok(traffic)
}

fn forward(subscriber: &Subscriber, socket: TcpStream, go_on: &dyn Fn() -> bool, traffic: &mut Traffic) -> Result<()> {
    socket.set_nodelay(true)?;
    socket.set_write_timeout(Some(STALLED))?;
    let answers = read_answers(socket.try_clone()?);
    let schema = schema();
    let mut writer = StreamWriter::try_new(BufWriter::new(&socket), &schema)?;
    writer.get_mut().flush()?;
    // first and last frames wait for the far end's answer
    let mut waiting: Vec<FrameHeader> = Vec::new();
    while go_on() {
        let mut some = false;
        while let Some(frame) = subscriber.receive()? {
            let h = *frame.header();
            if frame.view().is_err() {
                continue;
            }
            if h.kind != SAMPLES {
                let known = waiting.iter().any(|w| w.stream == h.stream && w.kind == h.kind);
                if known {
                    continue;
                }
                waiting.push(h);
                traffic.streams += u64::from(h.kind == BEGIN);
            }
            writer.write(&to_row(frame, &schema)?)?;
            traffic.frames += 1;
            some = true;
        }
        if some {
            writer.get_mut().flush()?;
        }
        loop {
            match answers.try_recv() {
                Ok(Ok(a)) => {
                    let mine = |w: &FrameHeader| w.stream == a.stream && w.kind == a.kind;
                    if let Some(i) = waiting.iter().position(mine) {
                        subscriber.answer(&waiting.swap_remove(i), a.frames)?;
                    }
                }
                Ok(Err(e)) => return Err(e.into()),
                Err(std::sync::mpsc::TryRecvError::Empty) => break,
                Err(std::sync::mpsc::TryRecvError::Disconnected) => bail!("closed by the far end"),
            }
        }
        let nap = if waiting.is_empty() { 50 } else { 1 };
        subscriber.wait(Duration::from_millis(nap))?;
    }
    writer.finish()?;
    writer.get_mut().flush()?;
    Ok(())
}

fn read_answers(mut socket: TcpStream) -> Receiver<std::io::Result<Answer>> {
    let (tell, told) = channel();
    std::thread::spawn(move || {
        let mut bytes = [0; ANSWER];
        loop {
            match socket.read_exact(&mut bytes) {
                Ok(()) => {
                    if tell.send(Ok(Answer::from_bytes(&bytes))).is_err() {
                        return;
                    }
                }
                Err(e) if e.kind() == ErrorKind::UnexpectedEof => return,
                Err(e) => {
                    let _ = tell.send(Err(e));
                    return;
                }
            }
        }
    });
    told
}

/// Publishes in a domain what far bridges send, a thread a connection, until `go_on` says no.
///
/// * `patience` how long a stream waits for a subscriber of this domain
pub fn receive(
    domain: &Domain,
    listen: &str,
    patience: Duration,
    go_on: &(dyn Fn() -> bool + Sync),
    say: &(dyn Fn(&str) + Sync),
) -> Result<Traffic> {
    let listener = TcpListener::bind(address(listen)?).with_context(|| format!("{listen}: cannot be listened on"))?;
    listener.set_nonblocking(true)?;
    say(&format!("listening on {}", listener.local_addr()?));
    // a broken stream is told in one line below, not with a trace
    std::panic::set_hook(Box::new(|_| ()));
    let total = std::sync::Mutex::new(Traffic::default());
    std::thread::scope(|scope| -> Result<()> {
        while go_on() {
            let (socket, from) = match listener.accept() {
                Ok(accepted) => accepted,
                Err(e) if e.kind() == ErrorKind::WouldBlock => {
                    std::thread::sleep(Duration::from_millis(20));
                    continue;
                }
                Err(e) => return Err(e.into()),
            };
            say(&format!("{from} connected"));
            let total = &total;
            scope.spawn(move || {
                let mut traffic = Traffic {
                    connections: 1,
                    ..Traffic::default()
                };
                // the Arrow reader panics where some bytes are not what they should be
                let work = || publish(domain, socket, patience, go_on, &mut traffic);
                let result = catch_unwind(AssertUnwindSafe(work));
                match result.unwrap_or_else(|_| bail!("not a whole Arrow IPC stream")) {
                    Ok(()) => say(&format!("{from} has finished: {} frames", traffic.frames)),
                    Err(e) => say(&format!("{from}: {e:#}; {} frames received", traffic.frames)),
                }
                if let Ok(mut t) = total.lock() {
                    t.frames += traffic.frames;
                    t.streams += traffic.streams;
                    t.connections += 1;
                }
            });
        }
        Ok(())
    })?;
    Ok(total.into_inner().unwrap_or_default())
}

/// Reads so that a silent connection still hears `go_on`.
struct Patient<'a> {
    socket: TcpStream,
    go_on: &'a (dyn Fn() -> bool + Sync),
}

impl Read for Patient<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        loop {
            match self.socket.read(buffer) {
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    if !(self.go_on)() {
                        return Ok(0);
                    }
                }
                other => return other,
            }
        }
    }
}

/// A far stream as it goes on here; `None` where nobody wanted it.
type Passes = HashMap<u64, Option<Pass>>;

fn publish(
    domain: &Domain,
    socket: TcpStream,
    patience: Duration,
    go_on: &(dyn Fn() -> bool + Sync),
    traffic: &mut Traffic,
) -> Result<()> {
    socket.set_nonblocking(false)?;
    socket.set_nodelay(true)?;
    socket.set_read_timeout(Some(Duration::from_millis(100)))?;
    let mut back = socket.try_clone()?;
    let reader = BufReader::new(Patient { socket, go_on });
    let reader = StreamReader::try_new(reader, None).context("not an Arrow IPC stream")?;
    let version = reader.schema().metadata().get(VERSION).cloned().unwrap_or_default();
    if version != SCHEMA_VERSION.to_string() || reader.schema().fields() != schema().fields() {
        bail!("schema version `{version}`; allowed: {SCHEMA_VERSION}");
    }
    let mut passes = Passes::new();
    let mut publisher: Option<(Publisher, usize, usize)> = None;
    for batch in reader {
        let batch = batch?;
        for i in 0..batch.num_rows() {
            let row = Row { batch: &batch, i };
            if let Some(answer) = relay(domain, &row, &mut publisher, &mut passes, patience, go_on)? {
                traffic.streams += u64::from(answer.kind == END);
                back.write_all(&answer.to_bytes())?;
            }
            traffic.frames += 1;
        }
    }
    if !passes.is_empty() && go_on() {
        bail!("ended in the middle of {} streams", passes.len());
    }
    Ok(())
}

/// Publishes one frame; returns what is to be answered.
fn relay(
    domain: &Domain,
    row: &Row<'_>,
    publisher: &mut Option<(Publisher, usize, usize)>,
    passes: &mut Passes,
    patience: Duration,
    go_on: &(dyn Fn() -> bool + Sync),
) -> Result<Option<Answer>> {
    let (kind, stream, number) = (row.u32("kind"), row.u64("stream"), row.u64("frame"));
    let about = row.description();
    let (rows, channels) = (row.u32("rows") as usize, about.channels.iter().count());
    let answer = |frames| Some(Answer { stream, frames, kind });
    let fits = |p: &(Publisher, usize, usize)| p.1 >= rows && p.2 >= channels;
    if !publisher.as_ref().is_some_and(fits) {
        // a larger frame than ever before: streams that have begun cannot go on
        const USUAL_ROWS: usize = 1000;
        passes.clear();
        drop(publisher.take());
        let rows = rows.max(USUAL_ROWS);
        let channels = channels.max(Channel::COUNT);
        *publisher = Some((
            Publisher::open(domain, Delivery::Lossless, rows, channels)?,
            rows,
            channels,
        ));
    }
    let (publisher, _, _) = publisher.as_mut().expect("just opened");
    if kind == END {
        let Some(Some(mut pass)) = passes.remove(&stream) else {
            return Ok(answer(0));
        };
        while pass.frames() < number {
            pass.skip_frame();
        }
        let ending = publisher.end(&pass, patience, go_on)?;
        let frames = if ending.whole > 0 { number.saturating_sub(1) } else { 0 };
        return Ok(answer(frames));
    }
    if let std::collections::hash_map::Entry::Vacant(slot) = passes.entry(stream) {
        slot.insert(publisher.begin(&about, patience, go_on)?);
    }
    let Some(Some(pass)) = passes.get_mut(&stream) else {
        return Ok(None);
    };
    if kind == BEGIN {
        return Ok(answer(0));
    }
    if number < pass.frames() {
        return Ok(None);
    }
    while pass.frames() < number {
        pass.skip_frame();
    }
    let mut frame = publisher.loan(pass, row.u64("first"), rows)?;
    let mut view = frame.view_mut();
    for c in about.channels.iter() {
        let (Some(values), Some(to)) = (row.column(c), view.column_mut(c)) else {
            continue;
        };
        let values = values.as_primitive::<Float64Type>().values();
        if values.len() != to.len() {
            bail!(
                "column `{}` has {} values; allowed: {}",
                c.name(),
                values.len(),
                to.len()
            );
        }
        to.copy_from_slice(values);
    }
    publisher.publish(pass, frame)?;
    Ok(None)
}
