//! The stream between computers: frames as Arrow IPC over TCP, a row a frame, columns as lists.
//! Each end is an ordinary subscriber or publisher of its domain; what the far subscribers answer
//! comes back, so that a lossless publisher waits for them as it does for near ones.
//!
//! Rooms: `link` (a connection, plain or TLS), `greeting` (who is there), `message` (bytes to batches, bounded),
//! `table` (frames to rows and back), `send`, `receive` with its `hall` of sessions, `relay` (rows to shared memory).

mod greeting;
mod hall;
mod link;
mod message;
mod receive;
mod relay;
mod send;
mod table;
mod tls;

pub use greeting::Secret;
pub use receive::{Limits, receive};
pub use send::send;
pub use tls::{TlsFiles, client, server};

use anyhow::Result;
use schemas::error::Error;
use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Most rows of a frame on the wire: a longer frame goes as several. The room that the receiving end makes in shared
/// memory is for frames of this size, whoever sends.
pub(crate) const MOST_ROWS: usize = 1000;

/// How long the other end, or a full queue of the far subscribers, may hold a write or a message up.
const STALLED: Duration = Duration::from_secs(60);

/// How long TCP, TLS and greeting may take together.
const GREETING: Duration = Duration::from_secs(5);

/// Bytes of an answer: stream, frames (little endian), kind.
const ANSWER: usize = 20;

/// Kind of an answer that says no more than that the receiving end is alive.
const ALIVE: u32 = 0;

/// Says what is no trouble, unless quiet.
fn note(say: &dyn Fn(&str), text: &str) {
    if !sim_worker::quiet::is_quiet() {
        say(text);
    }
}

/// An answer of the far end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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

/// What has gone through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    pub frames: u64,
    pub streams: u64,
    pub connections: u64,
}

/// How an end makes sure of the other one, and notices that it is gone.
pub struct Guard<T> {
    /// both ends have the same, or none
    pub secret: Option<Secret>,
    /// certificates of this end and of those it trusts; `None`: neither encryption nor certificates
    pub tls: Option<Arc<T>>,
    /// a peer that says nothing for so long is given up
    pub idle: Duration,
}

fn address(text: &str) -> Result<SocketAddr> {
    let allowed = "HOST:PORT";
    let found = text.to_socket_addrs().ok().and_then(|mut a| a.next());
    found.ok_or_else(|| Error::bad("command line", "address", text, allowed).into())
}

/// Locks; what a thread that panicked has left is taken as it is.
fn locked<T>(m: &Mutex<T>) -> MutexGuard<'_, T> {
    m.lock().unwrap_or_else(PoisonError::into_inner)
}
