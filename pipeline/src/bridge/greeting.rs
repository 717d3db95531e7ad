//! The first bytes of a connection: version, session, and that both ends know the same secret without telling it.
//!
//! Challenge and response with keyed BLAKE3: each end sends a nonce, and proves that it knows the key by the keyed
//! hash of its role and everything that both have said (under TLS also of what only this TLS connection has, so that
//! a proof counts nowhere else). The sender proves first: who only connects gets nothing to try passwords on.

use super::link::{Link, Wait};
use anyhow::{Result, bail};
use blake3::{Hash, Hasher};
use schemas::error::Error;
use std::path::Path;
use std::time::Duration;

/// First bytes both ways, with the version of this greeting.
const MAGIC: [u8; 8] = *b"ema-brg1";

/// Bytes of a greeting: magic, flags (u32), longest silence [ms] (u32), session, nonce; little endian.
const HELLO: usize = 64;

/// Flag: this end has a secret.
const HAS_SECRET: u32 = 1;

/// Shortest and longest secret [bytes].
const SECRET: std::ops::RangeInclusive<usize> = 16..=4096;

/// Names a sender over all its connections.
pub(super) type Token = [u8; 16];

/// A shared secret, kept as a key derived from it.
pub struct Secret([u8; 32]);

impl Secret {
    /// The text of a file, without white space at its end.
    ///
    /// # Errors
    /// A file that cannot be read, or with less than 16 or more than 4096 bytes.
    pub fn read(file: &Path) -> Result<Self> {
        let bytes = std::fs::read(file).map_err(|e| Error::io(file, "cannot be read", e))?;
        let secret = bytes.trim_ascii_end();
        if !SECRET.contains(&secret.len()) {
            let allowed = format!("{} to {} bytes", SECRET.start(), SECRET.end());
            let found = format!("{} bytes", secret.len());
            return Err(Error::bad(file.display().to_string(), "secret", found, allowed).into());
        }
        Ok(Self(blake3::derive_key("ema bridge 2026 shared secret", secret)))
    }

    fn proof(&self, role: &[u8; 8], said: &[u8]) -> Hash {
        Hasher::new_keyed(&self.0).update(role).update(said).finalize()
    }
}

/// What an end says of itself.
#[derive(Clone, Copy)]
struct Hello {
    flags: u32,
    idle_ms: u32,
    session: Token,
    nonce: [u8; 32],
}

impl Hello {
    fn new(secret: Option<&Secret>, idle: Duration, session: Token) -> Self {
        Self {
            flags: if secret.is_some() { HAS_SECRET } else { 0 },
            idle_ms: u32::try_from(idle.as_millis()).unwrap_or(u32::MAX),
            session,
            nonce: rand::random(),
        }
    }
    fn to_bytes(self) -> [u8; HELLO] {
        let mut b = [0; HELLO];
        b[..8].copy_from_slice(&MAGIC);
        b[8..12].copy_from_slice(&self.flags.to_le_bytes());
        b[12..16].copy_from_slice(&self.idle_ms.to_le_bytes());
        b[16..32].copy_from_slice(&self.session);
        b[32..].copy_from_slice(&self.nonce);
        b
    }
    /// Of bytes that begin with [`MAGIC`].
    fn from_bytes(b: &[u8; HELLO]) -> Self {
        let word = |i: usize| u32::from_le_bytes(std::array::from_fn(|k| b[i + k]));
        Self {
            flags: word(8),
            idle_ms: word(12),
            session: std::array::from_fn(|k| b[16 + k]),
            nonce: std::array::from_fn(|k| b[32 + k]),
        }
    }
    fn has_secret(&self) -> bool {
        self.flags & HAS_SECRET != 0
    }
    /// Often enough for the one who said so.
    fn keep_alive(&self) -> Duration {
        Duration::from_millis(u64::from(self.idle_ms.max(100)) / 4)
    }
}

/// What the receiving end makes of a sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum Verdict {
    Welcome = 0,
    OtherSecret = 1,
    TooMany = 2,
}

/// What is known of the other end.
pub(super) struct Peer {
    pub session: Token,
    /// how often it wants to hear from this end
    pub keep_alive: Duration,
    /// what the receiving end proves itself with, once it has made its verdict
    proof: Option<Hash>,
}

fn hello_of(link: &Link, wait: &Wait<'_>) -> Result<([u8; HELLO], Hello)> {
    let mut bytes = [0; HELLO];
    link.read_exact(&mut bytes[..8], wait)?;
    if bytes[..8] != MAGIC {
        bail!("not a bridge of this version");
    }
    link.read_exact(&mut bytes[8..], wait)?;
    Ok((bytes, Hello::from_bytes(&bytes)))
}

fn said(first: &[u8; HELLO], second: &[u8; HELLO], link: &Link) -> Result<Vec<u8>> {
    Ok([&first[..], &second[..], &link.binding()?].concat())
}

/// Why a connection is not tried again: what there is of a secret. Allowed is the same on both sides.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct Hopeless(pub &'static str);

/// The sending end's side.
///
/// # Errors
/// [`Hopeless`] where the secrets are not the same; a connection that breaks, or an end too busy.
pub(super) fn greet(
    link: &Link,
    secret: Option<&Secret>,
    idle: Duration,
    session: Token,
    wait: &Wait<'_>,
) -> Result<Peer> {
    let mine = Hello::new(secret, idle, session).to_bytes();
    link.write_all(&mine, wait)?;
    let (theirs, hello) = hello_of(link, wait)?;
    match (secret.is_some(), hello.has_secret()) {
        (false, true) => return Err(Hopeless("none; the receiving bridge asks for a secret").into()),
        (true, false) => return Err(Hopeless("one; the receiving bridge has none").into()),
        _ => {}
    }
    let said = said(&mine, &theirs, link)?;
    if let Some(secret) = secret {
        link.write_all(secret.proof(b"sender  ", &said).as_bytes(), wait)?;
    }
    let mut verdict = [0; 4];
    link.read_exact(&mut verdict, wait)?;
    match u32::from_le_bytes(verdict) {
        v if v == Verdict::Welcome as u32 => {}
        v if v == Verdict::OtherSecret as u32 => {
            return Err(Hopeless("another secret than the receiving bridge's").into());
        }
        v if v == Verdict::TooMany as u32 => bail!("has as many connections as it allows (its --most-connections)"),
        v => bail!("not a bridge of this version (verdict {v})"),
    }
    if let Some(secret) = secret {
        let mut proof = [0; 32];
        link.read_exact(&mut proof, wait)?;
        // compared in constant time
        if secret.proof(b"receiver", &said) != Hash::from_bytes(proof) {
            return Err(Hopeless("one that the receiving bridge does not know").into());
        }
    }
    let keep_alive = hello.keep_alive();
    let proof = None;
    Ok(Peer {
        session,
        keep_alive,
        proof,
    })
}

/// The receiving end's side, up to its verdict ([`welcome`], [`refuse`]).
///
/// # Errors
/// Who is not a bridge, does not know the secret, or is too slow.
pub(super) fn hear(link: &Link, secret: Option<&Secret>, idle: Duration, wait: &Wait<'_>) -> Result<Peer> {
    let (theirs, hello) = hello_of(link, wait)?;
    let mine = Hello::new(secret, idle, [0; 16]).to_bytes();
    link.write_all(&mine, wait)?;
    match (secret.is_some(), hello.has_secret()) {
        (true, false) => bail!("has no secret; allowed: the same secret on both sides"),
        (false, true) => bail!("has a secret; this end has none (--secret-file)"),
        _ => {}
    }
    let said = said(&theirs, &mine, link)?;
    let mut own = None;
    if let Some(secret) = secret {
        let mut proof = [0; 32];
        link.read_exact(&mut proof, wait)?;
        // compared in constant time
        if secret.proof(b"sender  ", &said) != Hash::from_bytes(proof) {
            refuse(link, Verdict::OtherSecret, wait);
            bail!("does not know the secret");
        }
        own = Some(secret.proof(b"receiver", &said));
    }
    Ok(Peer {
        session: hello.session,
        keep_alive: hello.keep_alive(),
        proof: own,
    })
}

/// The receiving end takes the connection, and proves itself.
///
/// # Errors
/// A broken connection.
pub(super) fn welcome(link: &Link, peer: &Peer, wait: &Wait<'_>) -> std::io::Result<()> {
    let mut bytes = (Verdict::Welcome as u32).to_le_bytes().to_vec();
    bytes.extend(peer.proof.iter().flat_map(|p| *p.as_bytes()));
    link.write_all(&bytes, wait)
}

/// The receiving end says why not; who does not listen has gone.
pub(super) fn refuse(link: &Link, verdict: Verdict, wait: &Wait<'_>) {
    let _ = link.write_all(&(verdict as u32).to_le_bytes(), wait);
}
