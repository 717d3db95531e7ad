//! A connection both ways, plain or TLS: one thread reads, others write, every wait has an end, and the silence of
//! the other end is noticed.

use super::{STALLED, locked};
use std::io::{Error, ErrorKind, Read, Result, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// How long the system waits before the reasons to give up are looked at again.
const LOOK: Duration = Duration::from_millis(100);

/// Bytes taken from the socket at a time under TLS: less than its buffer for what it has decrypted.
const BITE: usize = 4096;

/// How long to wait for bytes.
pub(super) struct Wait<'a> {
    pub go_on: &'a dyn Fn() -> bool,
    /// whatever comes
    pub until: Option<Instant>,
}

impl Wait<'_> {
    fn check(&self) -> Result<()> {
        if !(self.go_on)() {
            return Err(Error::new(ErrorKind::ConnectionAborted, "stopped"));
        }
        if self.until.is_some_and(|t| Instant::now() > t) {
            return Err(Error::new(ErrorKind::TimedOut, "too slow"));
        }
        Ok(())
    }
}

fn blocked(e: &Error) -> bool {
    matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut)
}

/// The socket as TLS wants it during its handshake.
struct Patient<'a> {
    socket: &'a TcpStream,
    wait: &'a Wait<'a>,
}

impl Read for Patient<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        loop {
            self.wait.check()?;
            match (&mut self.socket).read(buffer) {
                Err(e) if blocked(&e) => {}
                other => return other,
            }
        }
    }
}

impl Write for Patient<'_> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        loop {
            self.wait.check()?;
            match (&mut self.socket).write(bytes) {
                Err(e) if blocked(&e) => {}
                other => return other,
            }
        }
    }
    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

pub(super) struct Link {
    socket: TcpStream,
    tls: Option<Mutex<rustls::Connection>>,
    /// held for a whole message
    writing: Mutex<()>,
    start: Instant,
    /// when the last bytes came and went [ms after the start]
    heard_ms: AtomicU64,
    said_ms: AtomicU64,
    idle: Duration,
}

impl Link {
    /// * `tls` begun, its handshake yet to be made
    /// * `idle` longest silence of the other end
    ///
    /// # Errors
    /// A socket that refuses; a handshake that fails or does not end in time.
    pub fn open(socket: TcpStream, tls: Option<rustls::Connection>, idle: Duration, wait: &Wait<'_>) -> Result<Self> {
        socket.set_nonblocking(false)?;
        socket.set_nodelay(true)?;
        socket.set_read_timeout(Some(LOOK))?;
        socket.set_write_timeout(Some(LOOK))?;
        let mut tls = tls;
        if let Some(tls) = &mut tls {
            let mut patient = Patient { socket: &socket, wait };
            while tls.is_handshaking() {
                let (read, written) = tls.complete_io(&mut patient)?;
                if (read, written) == (0, 0) {
                    return Err(ErrorKind::UnexpectedEof.into());
                }
            }
        }
        Ok(Self {
            socket,
            tls: tls.map(Mutex::new),
            writing: Mutex::new(()),
            start: Instant::now(),
            heard_ms: AtomicU64::new(0),
            said_ms: AtomicU64::new(0),
            idle,
        })
    }

    /// What only the two ends of this TLS connection know; empty without TLS.
    ///
    /// # Errors
    /// A handshake that has not been made.
    pub fn binding(&self) -> Result<Vec<u8>> {
        let Some(tls) = &self.tls else { return Ok(Vec::new()) };
        let exported = locked(tls).export_keying_material([0; 32], b"ema bridge", None);
        exported.map(Vec::from).map_err(Error::other)
    }

    fn now_ms(&self) -> u64 {
        self.start.elapsed().as_millis() as u64
    }

    fn since(&self, ms: &AtomicU64) -> Duration {
        Duration::from_millis(self.now_ms().saturating_sub(ms.load(Ordering::Relaxed)))
    }

    /// Whether the other end has said nothing for too long. Counts only while somebody reads.
    pub fn is_silent(&self) -> bool {
        self.since(&self.heard_ms) > self.idle
    }

    /// How long nothing has been sent.
    pub fn quiet_for(&self) -> Duration {
        self.since(&self.said_ms)
    }

    fn silence(&self) -> Error {
        let text = format!("has said nothing for {} s", self.idle.as_secs_f64());
        Error::new(ErrorKind::TimedOut, text)
    }

    /// Some bytes; 0: closed by the other end. One thread reads.
    ///
    /// # Errors
    /// A broken connection; silence; `wait` is over.
    pub fn read(&self, buffer: &mut [u8], wait: &Wait<'_>) -> Result<usize> {
        loop {
            if let Some(n) = self.decrypted(buffer)? {
                return Ok(n);
            }
            let mut raw = [0; BITE];
            let read = match &self.tls {
                None => (&self.socket).read(buffer),
                Some(_) => (&self.socket).read(&mut raw),
            };
            match read {
                Ok(0) => return Ok(0),
                Ok(n) => {
                    self.heard_ms.store(self.now_ms(), Ordering::Relaxed);
                    match &self.tls {
                        None => return Ok(n),
                        Some(tls) => decrypt(&mut locked(tls), &raw[..n])?,
                    }
                    wait.check()?;
                }
                Err(e) if blocked(&e) => {
                    wait.check()?;
                    if self.is_silent() {
                        return Err(self.silence());
                    }
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
    }

    /// What TLS has decrypted already, if anything.
    fn decrypted(&self, buffer: &mut [u8]) -> Result<Option<usize>> {
        let Some(tls) = &self.tls else { return Ok(None) };
        match locked(tls).reader().read(buffer) {
            Ok(n) => Ok(Some(n)),
            Err(e) if e.kind() == ErrorKind::WouldBlock => Ok(None),
            Err(e) => Err(e),
        }
    }

    /// All of `buffer`.
    ///
    /// # Errors
    /// As [`Link::read`]; the other end closes before.
    pub fn read_exact(&self, mut buffer: &mut [u8], wait: &Wait<'_>) -> Result<()> {
        while !buffer.is_empty() {
            let n = self.read(buffer, wait)?;
            if n == 0 {
                return Err(ErrorKind::UnexpectedEof.into());
            }
            wait.check()?;
            buffer = &mut buffer[n..];
        }
        Ok(())
    }

    /// A whole message, never mixed with another thread's.
    ///
    /// # Errors
    /// A broken connection; one that takes no byte for a minute; `wait` is over.
    pub fn write_all(&self, mut bytes: &[u8], wait: &Wait<'_>) -> Result<()> {
        let _whole = locked(&self.writing);
        let Some(tls) = &self.tls else {
            return self.push(bytes, wait);
        };
        while !bytes.is_empty() {
            let mut encrypted = Vec::new();
            {
                let mut tls = locked(tls);
                let n = tls.writer().write(bytes)?;
                bytes = &bytes[n..];
                while tls.wants_write() {
                    tls.write_tls(&mut encrypted)?;
                }
            }
            self.push(&encrypted, wait)?;
        }
        Ok(())
    }

    fn push(&self, mut bytes: &[u8], wait: &Wait<'_>) -> Result<()> {
        let mut moved = Instant::now();
        while !bytes.is_empty() {
            match (&self.socket).write(bytes) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(n) => {
                    bytes = &bytes[n..];
                    moved = Instant::now();
                }
                Err(e) if blocked(&e) => {
                    wait.check()?;
                    if moved.elapsed() > STALLED {
                        return Err(Error::new(ErrorKind::TimedOut, "takes nothing any more"));
                    }
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        self.said_ms.store(self.now_ms(), Ordering::Relaxed);
        Ok(())
    }

    /// Ends the connection for both threads, and says so to the other end.
    pub fn close(&self) {
        if let Some(tls) = &self.tls {
            let mut tls = locked(tls);
            tls.send_close_notify();
            let _ = tls.write_tls(&mut &self.socket);
        }
        let _ = self.socket.shutdown(Shutdown::Both);
    }
}

/// Takes what has come into the TLS connection.
fn decrypt(tls: &mut rustls::Connection, mut raw: &[u8]) -> Result<()> {
    while !raw.is_empty() {
        tls.read_tls(&mut raw)?;
        tls.process_new_packets().map_err(Error::other)?;
    }
    Ok(())
}

/// A link as a byte stream.
pub(super) struct Reader<'a> {
    pub link: &'a Link,
    pub wait: Wait<'a>,
}

impl Read for Reader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        self.link.read(buffer, &self.wait)
    }
}
