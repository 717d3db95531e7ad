//! Receiving telemetry: frames are read where the publisher wrote them.

use super::domain::{Domain, failed};
use super::frame::{Acknowledgement, Block, FrameFault, FrameHeader};
use super::publisher::{Factory, acknowledgements, folded, telemetry};
use super::{ACKNOWLEDGEMENT, Ipc, TELEMETRY};
use crate::error::Result;
use crate::telemetry::TelemetryView;
use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::prelude::*;
use std::time::Duration;

/// A received frame; its memory goes back to the publisher when it is dropped.
pub struct Frame {
    pub(super) sample: iceoryx2::sample::Sample<Ipc, [Block], FrameHeader>,
}

impl Frame {
    /// What the frame says of itself; not checked yet, see [`Frame::view`].
    pub fn header(&self) -> &FrameHeader {
        self.sample.user_header()
    }

    /// All values, as they lie in shared memory.
    pub fn payload(&self) -> &[f64] {
        self.sample.payload().as_flattened()
    }

    /// The columns in place, checked.
    ///
    /// # Errors
    /// As [`FrameHeader::check`].
    pub fn view(&self) -> Result<TelemetryView<'_>, FrameFault> {
        self.header().view(self.payload())
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
        Ok(sample.map(|sample| Frame { sample }))
    }

    /// Sleeps until a publisher says that there is something, or `timeout` is over.
    ///
    /// # Errors
    /// A listener that fails.
    pub fn wait(&self, timeout: Duration) -> Result<()> {
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
