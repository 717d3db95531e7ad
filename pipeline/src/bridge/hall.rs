//! The senders that are connected. A sender that connects again takes its streams over from its former connection,
//! which may not know yet that it is dead.

use super::greeting::Token;
use super::link::Link;
use super::locked;
use super::relay::Streams;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

/// A sender over its connections.
pub(super) struct Session {
    pub streams: Mutex<Streams>,
    /// set: who waits for a subscriber that does not read on waits no more
    pub stop: OnceLock<Arc<AtomicBool>>,
    /// number of the connection that the streams belong to, and its link
    holder: AtomicU64,
    link: Mutex<Arc<Link>>,
}

impl Session {
    /// Whether the streams belong to a connection yet.
    pub fn is_of(&self, connection: u64) -> bool {
        self.holder.load(Ordering::Acquire) == connection
    }
}

#[derive(Default)]
pub(super) struct Hall {
    sessions: Mutex<HashMap<Token, Arc<Session>>>,
}

/// What a connection finds.
pub(super) enum Entrance {
    /// a sender that was not there
    New(Arc<Session>),
    /// one whose former connection is ended with this
    Again(Arc<Session>),
    /// as many as are allowed are there
    Full,
}

impl Hall {
    /// * `connection` its number
    pub fn enter(&self, token: Token, connection: u64, link: &Arc<Link>, most: usize) -> Entrance {
        let mut sessions = locked(&self.sessions);
        let count = sessions.len();
        match sessions.entry(token) {
            Entry::Occupied(o) => {
                let session = o.get().clone();
                session.holder.store(connection, Ordering::Release);
                std::mem::replace(&mut *locked(&session.link), link.clone()).close();
                Entrance::Again(session)
            }
            Entry::Vacant(_) if count >= most => Entrance::Full,
            Entry::Vacant(v) => {
                let session = Arc::new(Session {
                    streams: Mutex::default(),
                    stop: OnceLock::new(),
                    holder: AtomicU64::new(connection),
                    link: Mutex::new(link.clone()),
                });
                Entrance::New(v.insert(session).clone())
            }
        }
    }

    /// A connection ends, and with it its sender's session, unless that has gone over to another one.
    pub fn leave(&self, token: Token, connection: u64) {
        let mut sessions = locked(&self.sessions);
        if sessions.get(&token).is_some_and(|s| s.is_of(connection)) {
            sessions.remove(&token);
        }
    }

    /// Ends all waits for subscribers.
    pub fn stop(&self) {
        for s in locked(&self.sessions).values() {
            if let Some(stop) = s.stop.get() {
                stop.store(true, Ordering::Relaxed);
            }
        }
    }
}
