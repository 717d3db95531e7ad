//! Diagnoses as messages.

use super::domain::{Domain, failed};
use super::wire::{FeatureNumbers, to_text, wire};
use super::{
    DIAGNOSIS, DIAGNOSIS_BUFFER, DIAGNOSIS_HISTORY, Ipc, MAX_NODES, MAX_PUBLISHERS, MAX_SUBSCRIBERS, SHORTEST_WAIT,
};
use crate::error::Result;
use crate::feature::Feature;
use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use std::time::Duration;

wire! {
    /// A diagnosis. NaN stands for what is not known.
    DiagnosisMessage ("") {
        /// [`crate::SCHEMA_VERSION`] of the sender
        schema_version: u32,
        /// 1 located, 2 unexplained, 3 out of range, 4 incomplete
        outcome: u32,
        /// 1: the last word on the stream; 0: so far
        is_final: u32,
        /// bit `n`: the map of feature number `n` ([`Feature`]) contradicts the others, or witness number `n`
        /// overrules them
        contradicting: u32,
        /// which actuator, UTF-8 padded with zeros
        actuator: [u8; 32],
        /// fingerprint of the actuator's parameters, as in the frames
        parameters: u64,
        /// fingerprint of the sequence, as in the frames
        sequence: u64,
        /// number of the run, as in the frames
        run: u64,
        /// pass of the run, as in the frames
        stream: u64,
        /// number of this message from its sender, from 1 on, without gaps
        number: u64,
        /// least FSJ of the area of possible faults
        fsj_lo: f64,
        /// greatest FSJ of the area
        fsj_hi: f64,
        /// FSJ of the area's centroid
        fsj_estimate: f64,
        /// least zeta of the area
        zeta_lo: f64,
        /// greatest zeta of the area
        zeta_hi: f64,
        /// zeta of the area's centroid
        zeta_estimate: f64,
        /// size of the area in FSJ times zeta
        area: f64,
        /// share of tests whose true pair lies in the intervals
        coverage: f64,
        /// see [`DiagnosisMessage::feature`]
        features: FeatureNumbers,
        /// samples taken up to this diagnosis
        samples_received: u64,
        /// samples known to be lost up to this diagnosis
        samples_lost: u64,
        /// when the frame that completed it was published (CLOCK_MONOTONIC) [ns]
        telemetry_ns: u64,
        /// when the diagnosis was published (CLOCK_MONOTONIC) [ns]
        publish_ns: u64,
        /// in words, UTF-8 padded with zeros; empty when located
        reason: [u8; 512],
    }
}

impl DiagnosisMessage {
    /// Writes the reason, cut at 512 bytes.
    pub fn set_reason(&mut self, reason: &str) {
        self.reason = to_text(reason);
    }

    /// A feature in its unit.
    pub fn feature(&self, feature: Feature) -> Option<f64> {
        Some(self.features[feature as usize]).filter(|x| !x.is_nan())
    }
}

type Factory = iceoryx2::service::port_factory::publish_subscribe::PortFactory<Ipc, DiagnosisMessage, ()>;
type Events = iceoryx2::service::port_factory::event::PortFactory<Ipc>;

fn services(domain: &Domain, node: &Node<Ipc>) -> Result<(Factory, Events)> {
    let name = DIAGNOSIS.try_into().expect("a valid name");
    let open = || {
        node.service_builder(&name)
            .publish_subscribe::<DiagnosisMessage>()
            .max_publishers(MAX_PUBLISHERS)
            .max_subscribers(MAX_SUBSCRIBERS)
            .max_nodes(MAX_NODES)
            .history_size(DIAGNOSIS_HISTORY)
            .subscriber_max_buffer_size(DIAGNOSIS_BUFFER)
            .open_or_create()
    };
    let service = domain
        .open_or_mend(open)
        .map_err(|e| domain.refused(DIAGNOSIS, DiagnosisMessage::wire_name(), &e))?;
    Ok((service, domain.events(node, DIAGNOSIS)?))
}

/// Publishes diagnoses.
pub struct DiagnosisPublisher {
    port: iceoryx2::port::publisher::Publisher<Ipc, DiagnosisMessage, ()>,
    notifier: iceoryx2::port::notifier::Notifier<Ipc>,
    number: u64,
}

impl DiagnosisPublisher {
    /// A publisher on `node`; subscribers may come before or after it.
    ///
    /// # Errors
    /// A domain whose diagnoses have another layout (both are named); shared memory that refuses.
    pub fn open(domain: &Domain, node: &Node<Ipc>) -> Result<Self> {
        let (service, events) = services(domain, node)?;
        Ok(Self {
            port: service
                .publisher_builder()
                .create()
                .map_err(|e| failed(DIAGNOSIS, "no publisher", e))?,
            notifier: events
                .notifier_builder()
                .create()
                .map_err(|e| failed(DIAGNOSIS, "no notifier", e))?,
            number: 0,
        })
    }

    /// Hands earlier diagnoses to subscribers that have come meanwhile.
    pub fn welcome(&self) {
        let _ = self.port.update_connections();
    }

    /// Numbers, stamps and sends `message`.
    ///
    /// # Errors
    /// Shared memory that refuses.
    pub fn send(&mut self, message: &mut DiagnosisMessage) -> Result<()> {
        self.number += 1;
        message.schema_version = crate::SCHEMA_VERSION;
        message.number = self.number;
        message.publish_ns = super::now_ns();
        self.port
            .send_copy(*message)
            .map_err(|e| failed(DIAGNOSIS, "cannot be sent", e))?;
        // a listener that has gone is no fault of the diagnosis
        let _ = self.notifier.notify();
        Ok(())
    }
}

/// Receives diagnoses.
pub struct DiagnosisSubscriber {
    service: Factory,
    domain: Domain,
    port: iceoryx2::port::subscriber::Subscriber<Ipc, DiagnosisMessage, ()>,
    listener: iceoryx2::port::listener::Listener<Ipc>,
    _node: Node<Ipc>,
}

impl DiagnosisSubscriber {
    /// * `history` diagnoses sent before this subscriber came, at most [`DIAGNOSIS_HISTORY`]
    ///
    /// # Errors
    /// A domain whose diagnoses have another layout (both are named); shared memory that refuses.
    pub fn open(domain: &Domain, history: usize) -> Result<Self> {
        let node = domain.node()?;
        let (service, events) = services(domain, &node)?;
        Ok(Self {
            port: service
                .subscriber_builder()
                .buffer_size(DIAGNOSIS_BUFFER)
                .history_request(history)
                .create()
                .map_err(|e| failed(DIAGNOSIS, "no subscriber", e))?,
            listener: events
                .listener_builder()
                .create()
                .map_err(|e| failed(DIAGNOSIS, "no listener", e))?,
            service,
            domain: domain.clone(),
            _node: node,
        })
    }

    /// Diagnosers that are alive; what dead ones left is removed.
    pub fn publishers(&self) -> Vec<u128> {
        use iceoryx2::service::port_factory::PortFactory;
        self.domain.clean();
        let mut ids = Vec::new();
        self.service.dynamic_config().list_publishers(|p| {
            ids.push(p.publisher_id.value());
            CallbackProgression::Continue
        });
        ids
    }

    /// The next diagnosis, or `None` when `timeout` is over.
    ///
    /// # Errors
    /// A connection that cannot be read or waited for.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<DiagnosisMessage>> {
        let end = std::time::Instant::now() + timeout;
        loop {
            let sample = self
                .port
                .receive()
                .map_err(|e| failed(DIAGNOSIS, "cannot be received", e))?;
            if let Some(sample) = sample {
                return Ok(Some(*sample));
            }
            let left = end.saturating_duration_since(std::time::Instant::now());
            // a socket's time-out has whole microseconds, and none of them means for ever
            if left < SHORTEST_WAIT {
                return Ok(None);
            }
            match self.listener.timed_wait(|_| (), left) {
                Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
                Err(e) => return Err(failed(DIAGNOSIS, "cannot be waited for", e)),
            }
        }
    }
}
