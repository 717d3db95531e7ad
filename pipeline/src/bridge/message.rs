//! Messages of an Arrow IPC stream from a peer that nobody vouches for: lengths are checked before anything is made
//! room for, and room is made as bytes come.

use super::link::Reader;
use super::{STALLED, table};
use anyhow::{Context, Result, bail};
use arrow::array::RecordBatch;
use arrow::buffer::Buffer;
use arrow::datatypes::SchemaRef;
use arrow::ipc::convert::try_schema_from_flatbuffer_bytes;
use arrow::ipc::reader::read_record_batch;
use arrow::ipc::{MessageHeader, root_as_message};
use schemas::guard::guarded;
use std::collections::HashMap;
use std::io::{BufReader, Read};
use std::time::Instant;

/// Most bytes of a message without its body: the schema of the table takes some 6 000, a row's description 3 000.
const MOST_META: usize = 64 * 1024;

/// Room made at a time for bytes that are yet to come.
const BITE: usize = 64 * 1024;

/// Most rows of a message.
const MOST_FRAMES: i64 = 4096;

/// A message that can be told from the next one.
pub(super) enum Message {
    /// the other end sends no more
    End,
    /// frames; not looked into yet
    Frames { meta: Vec<u8>, body: Vec<u8> },
}

/// Reads messages one by one.
pub(super) struct Messages<'a> {
    from: BufReader<Reader<'a>>,
    most_body: usize,
    schema: SchemaRef,
}

impl<'a> Messages<'a> {
    /// Reads the schema, which must be the table's.
    ///
    /// # Errors
    /// Another schema; no Arrow IPC stream; a broken connection.
    pub fn begin(reader: Reader<'a>, most_body: usize) -> Result<Self> {
        let mut from = BufReader::new(reader);
        let schema = table::schema();
        let Some((meta, body)) = next(&mut from, 0)? else {
            bail!("no schema");
        };
        if parsed(&meta)?.header_type() != MessageHeader::Schema || !body.is_empty() {
            bail!("does not begin with a schema");
        }
        let found = guarded(|| try_schema_from_flatbuffer_bytes(&meta)).map_err(anyhow::Error::msg)??;
        table::check(&found)?;
        from.get_mut().wait.until = None;
        Ok(Self {
            from,
            most_body,
            schema,
        })
    }

    /// The next message, whole.
    ///
    /// # Errors
    /// A message too large, or that is no frames; a broken connection; silence.
    pub fn next(&mut self) -> Result<Message> {
        let Some((meta, body)) = next(&mut self.from, self.most_body)? else {
            return Ok(Message::End);
        };
        let message = parsed(&meta)?;
        if message.header_type() != MessageHeader::RecordBatch {
            bail!("a message that is no frames");
        }
        Ok(Message::Frames { meta, body })
    }

    /// The rows of a message.
    ///
    /// # Errors
    /// Rows that are not what the message says; the next message can be read all the same.
    pub fn rows(&self, meta: &[u8], body: Vec<u8>) -> Result<RecordBatch> {
        let message = parsed(meta)?;
        let batch = message.header_as_record_batch().context("no frames")?;
        if !(0..=MOST_FRAMES).contains(&batch.length()) {
            bail!("{} frames in a message; allowed: 0 to {MOST_FRAMES}", batch.length());
        }
        if batch.compression().is_some() {
            bail!("a compressed message; allowed: none");
        }
        let (body, version) = (Buffer::from_vec(body), message.version());
        // the Arrow reader panics where some bytes are not what they should be
        let read = || read_record_batch(&body, batch, self.schema.clone(), &HashMap::new(), None, &version);
        Ok(guarded(read).map_err(anyhow::Error::msg)??)
    }
}

/// A message's description, verified.
fn parsed(meta: &[u8]) -> Result<arrow::ipc::Message<'_>> {
    root_as_message(meta).map_err(|e| anyhow::anyhow!("not an Arrow IPC message ({e})"))
}

/// The next message and its body; `None` at the end of the stream.
fn next(from: &mut BufReader<Reader<'_>>, most_body: usize) -> Result<Option<(Vec<u8>, Vec<u8>)>> {
    let mut head = [0; 8];
    let mut got = 0;
    while got < head.len() {
        let n = from.read(&mut head[got..])?;
        match (n, got) {
            (0, 0) => bail!("closed by the far end"),
            (0, _) => bail!("closed by the far end in the middle of a message"),
            _ => got += n,
        }
        begun(from);
    }
    let word = |i: usize| u32::from_le_bytes(std::array::from_fn(|k| head[i + k]));
    let (mark, length) = (word(0), word(4) as usize);
    if mark != u32::MAX {
        bail!("not an Arrow IPC stream");
    }
    if length == 0 {
        return Ok(None);
    }
    if length > MOST_META {
        bail!("a message's description of {length} bytes; allowed: {MOST_META}");
    }
    let meta = take(from, length)?;
    let body = parsed(&meta)?.bodyLength();
    let Some(body) = usize::try_from(body).ok().filter(|n| *n <= most_body) else {
        bail!("a message of {body} bytes; allowed: {most_body} (--most-message-kb)");
    };
    let body = take(from, body)?;
    from.get_mut().wait.until = None;
    Ok(Some((meta, body)))
}

/// A message has begun: it may take its time, but not for ever.
fn begun(from: &mut BufReader<Reader<'_>>) {
    let until = &mut from.get_mut().wait.until;
    until.get_or_insert_with(|| Instant::now() + STALLED);
}

/// `length` bytes; room is made as they come.
fn take(from: &mut impl Read, length: usize) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    while bytes.len() < length {
        let had = bytes.len();
        bytes.resize(had + BITE.min(length - had), 0);
        from.read_exact(&mut bytes[had..])
            .context("in the middle of a message")?;
    }
    Ok(bytes)
}
