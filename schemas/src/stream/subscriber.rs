//! Receiving telemetry: frames are read where the publisher wrote them.

use super::domain::{Domain, failed};
use super::frame::{Acknowledgement, Block, FrameFault, FrameHeader};
use super::publisher::{Factory, acknowledgements, folded, telemetry};
use super::{ACKNOWLEDGEMENT, Ipc, SHORTEST_WAIT, TELEMETRY};
use crate::error::Result;
use crate::telemetry::TelemetryView;
use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::prelude::*;
use std::time::Duration;

/// A received frame; its memory goes back to the publisher when it is dropped.
///
/// Which bytes may still change: a publisher keeps write access to what it has sent, and a faulty or hostile one may
/// write on. So everything that lengths, offsets and interpretations follow from (the header, and how many blocks
/// there are) is copied out of shared memory once, on receipt; checks and uses read the copy alone. What stays in
/// shared memory are the samples. They may change while they are read: that is memory safe, since every bit pattern is
/// an f64 and no length or address is computed from one; the features of such a frame are as wrong as its sender
/// wants them, as they could have been from the start. What iceoryx2 itself keeps in shared memory (offsets of chunks,
/// the files' sizes) it trusts: processes of one domain must be of users who may write each other's files.
pub struct Frame {
    sample: iceoryx2::sample::Sample<Ipc, [Block], FrameHeader>,
    header: FrameHeader,
    blocks: usize,
}

impl Frame {
    /// The frame of a sample, header and length copied.
    fn of(sample: iceoryx2::sample::Sample<Ipc, [Block], FrameHeader>) -> Self {
        // SAFETY: the reference is valid for reads and aligned; volatile, so that the one copy is not taken again
        // later from memory that has changed meanwhile
        let header = unsafe { std::ptr::read_volatile(sample.user_header()) };
        let blocks = sample.payload().len();
        Self { sample, header, blocks }
    }

    /// What the frame said of itself on receipt; not checked yet, see [`Frame::view`].
    pub fn header(&self) -> &FrameHeader {
        &self.header
    }

    /// All values, as they lie in shared memory.
    pub fn payload(&self) -> &[f64] {
        let first = self.sample.payload().as_ptr();
        // SAFETY: `blocks` elements from there on were the payload on receipt, and the sample keeps them; its own
        // length is read anew from shared memory at every call, and may be another by now
        unsafe { std::slice::from_raw_parts(first, self.blocks) }.as_flattened()
    }

    /// The columns in place, checked.
    ///
    /// # Errors
    /// As [`FrameHeader::check`].
    pub fn view(&self) -> Result<TelemetryView<'_>, FrameFault> {
        self.header.view(self.payload())
    }

    /// Which publisher sent it.
    pub fn publisher(&self) -> u64 {
        folded(self.sample.origin().value())
    }
}

/// Receives the frames of all publishers of a domain.
pub struct Subscriber {
    service: Factory,
    port: iceoryx2::port::subscriber::Subscriber<Ipc, [Block], FrameHeader>,
    listener: iceoryx2::port::listener::Listener<Ipc>,
    answers: iceoryx2::port::publisher::Publisher<Ipc, Acknowledgement, ()>,
    domain: Domain,
    node: Node<Ipc>,
    id: u64,
}

impl Subscriber {
    /// Refuses a domain whose telemetry has another schema version, with both versions.
    ///
    /// # Errors
    /// A domain of another layout; shared memory that refuses.
    pub fn open(domain: &Domain) -> Result<Self> {
        let node = domain.node()?;
        let service = telemetry(domain, &node)?;
        // the answering port first: who sees this subscriber shall be able to hear it
        let answers = acknowledgements(domain, &node)?
            .publisher_builder()
            .create()
            .map_err(|e| failed(ACKNOWLEDGEMENT, "no publisher", e))?;
        let listener = domain
            .events(&node, TELEMETRY)?
            .listener_builder()
            .create()
            .map_err(|e| failed(TELEMETRY, "no listener", e))?;
        let port = service
            .subscriber_builder()
            .create()
            .map_err(|e| failed(TELEMETRY, "no subscriber", e))?;
        Ok(Self {
            id: folded(port.id().value()),
            service,
            port,
            listener,
            answers,
            domain: domain.clone(),
            node,
        })
    }

    /// The node that it is on, for further services of the same process.
    pub fn node(&self) -> &Node<Ipc> {
        &self.node
    }

    /// The next frame, if one is there.
    ///
    /// # Errors
    /// A connection that cannot be read.
    pub fn receive(&self) -> Result<Option<Frame>> {
        let sample = self
            .port
            .receive()
            .map_err(|e| failed(TELEMETRY, "cannot be received", e))?;
        Ok(sample.map(Frame::of))
    }

    /// Sleeps until a publisher says that there is something, or `timeout` is over.
    ///
    /// # Errors
    /// A listener that fails.
    pub fn wait(&self, timeout: Duration) -> Result<()> {
        if timeout < SHORTEST_WAIT {
            return Ok(());
        }
        match self.listener.timed_wait(|_| (), timeout) {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
            Err(e) => Err(failed(TELEMETRY, "cannot be waited for", e)),
        }
    }

    /// Answers the first or the last frame of a stream.
    ///
    /// * `frames` sample frames that came before the first gap in their numbers
    ///
    /// # Errors
    /// Shared memory that refuses.
    pub fn answer(&self, header: &FrameHeader, frames: u64) -> Result<()> {
        let answer = Acknowledgement {
            stream: header.stream,
            subscriber: self.id,
            kind: header.kind,
            process: std::process::id(),
            frames,
        };
        self.answers
            .send_copy(answer)
            .map_err(|e| failed(ACKNOWLEDGEMENT, "cannot be sent", e))?;
        Ok(())
    }

    /// Publishers that are alive; what dead ones left is removed.
    pub fn publishers(&self) -> Vec<u64> {
        use iceoryx2::service::port_factory::PortFactory;
        self.domain.clean();
        let mut ids = Vec::new();
        self.service.dynamic_config().list_publishers(|p| {
            ids.push(folded(p.publisher_id.value()));
            CallbackProgression::Continue
        });
        ids
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channel::{Channel, ChannelSet};
    use crate::stream::frame::{FrameHeader, RunDescription};
    use crate::stream::publisher::{Delivery, Publisher};

    const ROWS: usize = 16;

    fn about(actuator: &str) -> RunDescription {
        RunDescription {
            actuator: actuator.into(),
            parameters: "0000000000000001".into(),
            sensors: "none".into(),
            sequence: "0000000000000002".into(),
            run: 1,
            rate_hz: 1000.0,
            channels: ChannelSet::of([Channel::Com, Channel::IB]),
            total_rows: 0,
            load_n_m: 0.0,
        }
    }

    /// Both ends of a domain of this test's own.
    fn ends(name: &str) -> (Subscriber, Publisher) {
        let domain = Domain::new(&format!("unit-{}-{name}", std::process::id())).unwrap();
        let subscriber = Subscriber::open(&domain).unwrap();
        let publisher = Publisher::open(&domain, Delivery::RealTime, ROWS, 2).unwrap();
        (subscriber, publisher)
    }

    /// A hostile publisher: it writes on in what it has sent.
    #[test]
    fn refuse_a_header_rewritten_after_receipt() {
        let (subscriber, mut publisher) = ends("rewritten");
        let mut pass = publisher
            .begin(&about("rig"), Duration::ZERO, &|| true)
            .unwrap()
            .unwrap();
        subscriber.receive().unwrap().unwrap();
        for _ in 0..100 {
            let mut frame = publisher.loan(&pass, 1, ROWS).unwrap();
            frame.view_mut().column_mut(Channel::IB).unwrap().fill(3.0);
            let header: *mut FrameHeader = frame.header_mut();
            publisher.publish(&mut pass, frame).unwrap();
            let received = subscriber.receive().unwrap().unwrap();
            let before = *received.header();
            // SAFETY: the publisher's mapping is there as long as the publisher; nobody else writes
            unsafe {
                header.write_volatile(FrameHeader {
                    rows: 1 << 20,
                    stride: 1 << 20,
                    channels: 0xffff,
                    ..before
                });
            }
            assert_eq!(*received.header(), before);
            let view = received.view().unwrap();
            assert_eq!((view.rows, view.column(Channel::IB)), (ROWS, Some(&[3.0; ROWS][..])));
            assert!(view.column(Channel::IA).is_none());
            let batch = received.into_record_batch().unwrap();
            assert_eq!((batch.num_rows(), batch.num_columns()), (ROWS, 2));
        }
    }

    /// Names are refused at both doors: where a run begins, and where a frame is checked.
    #[test]
    fn refuse_names_that_a_terminal_obeys() {
        let (subscriber, mut publisher) = ends("names");
        for name in ["a\u{1b}[2J", "a\nb", "\u{202e}b"] {
            let refused = publisher.begin(&about(name), Duration::ZERO, &|| true).unwrap_err();
            assert!(refused.to_string().chars().all(crate::foreign::is_plain), "{refused}");
        }
        let pass = publisher
            .begin(&about("rig"), Duration::ZERO, &|| true)
            .unwrap()
            .unwrap();
        subscriber.receive().unwrap().unwrap();
        for name in [&b"a\x1b[2J"[..], b"\xff\xfe", b"a\rb", b"a\0b"] {
            let mut frame = publisher.loan(&pass, 1, ROWS).unwrap();
            let mut field = [0; 32];
            field[..name.len()].copy_from_slice(name);
            frame.header_mut().actuator = field;
            publisher.publish(&mut pass.clone(), frame).unwrap();
            let fault = subscriber.receive().unwrap().unwrap().view().unwrap_err();
            assert_eq!(fault, FrameFault::Actuator(field));
            assert!(fault.to_string().chars().all(crate::foreign::is_plain), "{fault}");
        }
    }
}
