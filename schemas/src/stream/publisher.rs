//! Sending telemetry: loan a frame, write its columns in place, publish.
//!
//! Against silent losses of the transport (measured on iceoryx2 0.10):
//! * a subscriber that has not yet polled a new publisher gets what its queue holds and no more,
//!   and `send` says 0 recipients: a lossless stream begins with a frame that subscribers answer,
//!   and 0 recipients is a failure;
//! * samples unread when their publisher goes are lost: a stream ends with a frame that
//!   subscribers answer, and the publisher waits for it;
//! * growing slices lose unread samples: all frames come from one block of memory of fixed size.

use super::domain::{Domain, failed};
use super::frame::{Acknowledgement, BEGIN, Block, END, FrameHeader, NAMES, RunDescription, SAMPLES};
use super::{ACKNOWLEDGEMENT, BUFFER_FRAMES, Ipc, MAX_BORROWED, MAX_NODES, MAX_PUBLISHERS, MAX_SUBSCRIBERS, TELEMETRY};
use crate::error::{Error, Result};
use crate::foreign;
use crate::telemetry::{TelemetryHeader, TelemetrySink, TelemetryView, TelemetryViewMut};
use iceoryx2::port::BackpressureAction;
use iceoryx2::prelude::*;
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// What a full queue of a subscriber means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// the publisher waits: nothing is lost
    Lossless,
    /// the frame is lost to that subscriber, and counted: the publisher's clock does not wait
    RealTime,
}

/// Between two looks for dead processes [ns].
const CLEANING_NS: u64 = 200_000_000;

/// How often an unanswered first frame is sent again.
const AGAIN: Duration = Duration::from_millis(50);

/// How long those who have not answered are waited for after the first answer: programs in other
/// languages need not answer.
const STRAGGLERS: Duration = Duration::from_millis(500);

/// Frames that a publisher may hold on to at once.
const MAX_LOANS: usize = 4;

pub(super) type Factory = PortFactory<Ipc, [Block], FrameHeader>;
pub(super) type Acknowledgements = PortFactory<Ipc, Acknowledgement, ()>;

pub(super) fn telemetry(domain: &Domain, node: &Node<Ipc>) -> Result<Factory> {
    let name = TELEMETRY.try_into().expect("a valid name");
    let open = || {
        node.service_builder(&name)
            .publish_subscribe::<[Block]>()
            .user_header::<FrameHeader>()
            .payload_alignment(Alignment::new(64).expect("a power of two"))
            .enable_safe_overflow(false)
            .max_publishers(MAX_PUBLISHERS)
            .max_subscribers(MAX_SUBSCRIBERS)
            .max_nodes(MAX_NODES)
            .history_size(0)
            .subscriber_max_buffer_size(BUFFER_FRAMES)
            .subscriber_max_borrowed_samples(MAX_BORROWED)
            .open_or_create()
    };
    domain
        .open_or_mend(open)
        .map_err(|e| domain.refused(TELEMETRY, FrameHeader::wire_name(), &e))
}

pub(super) fn acknowledgements(domain: &Domain, node: &Node<Ipc>) -> Result<Acknowledgements> {
    let name = ACKNOWLEDGEMENT.try_into().expect("a valid name");
    let open = || {
        node.service_builder(&name)
            .publish_subscribe::<Acknowledgement>()
            .max_publishers(MAX_SUBSCRIBERS)
            .max_subscribers(MAX_PUBLISHERS)
            .max_nodes(MAX_NODES)
            .subscriber_max_buffer_size(BUFFER_FRAMES)
            .open_or_create()
    };
    domain
        .open_or_mend(open)
        .map_err(|e| domain.refused(ACKNOWLEDGEMENT, Acknowledgement::wire_name(), &e))
}

/// A 128 bit port number folded to 64 bits.
pub(super) fn folded(id: u128) -> u64 {
    (id >> 64) as u64 ^ id as u64
}

/// Refuses what shared memory cannot hold, rather than being killed when it is full.
fn room(bytes: u64) -> Result<()> {
    let Ok(fs) = rustix::fs::statvfs("/dev/shm") else {
        return Ok(());
    };
    let free = fs.f_bavail * fs.f_frsize;
    if bytes > free {
        let found = format!("{} MB free", free / 1_000_000);
        let allowed = format!(
            "{} MB for the frames of a publisher (or shorter frames)",
            bytes / 1_000_000
        );
        return Err(Error::bad("/dev/shm", "shared memory", found, allowed));
    }
    Ok(())
}

/// A run that is being sent.
#[derive(Clone, Debug)]
pub struct Pass {
    header: FrameHeader,
    /// subscribers that answered the first frame
    answered: Vec<u64>,
    /// sample frames that did not reach every subscriber
    pub lost_frames: u64,
    /// sample frames that nobody received
    pub unheard_frames: u64,
}

impl Pass {
    /// Number of this pass: another whenever the run is sent again.
    pub fn stream(&self) -> u64 {
        self.header.stream
    }
    /// Leaves a frame number out: that frame will not be sent. For those who relay the frames of
    /// another publisher, gaps included.
    pub fn skip_frame(&mut self) {
        self.header.frame += 1;
    }
    /// Leaves out every frame number below `frame`; numbers do not go back.
    pub fn skip_to(&mut self, frame: u64) {
        self.header.frame = self.header.frame.max(frame);
    }
    /// Frames sent so far, the first one included.
    pub fn frames(&self) -> u64 {
        self.header.frame
    }
}

/// How a stream ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ending {
    /// subscribers that answered the last frame
    pub answered: usize,
    /// those among them that had received every frame
    pub whole: usize,
}

/// A loaned frame in shared memory.
pub struct FrameMut {
    sample: iceoryx2::sample_mut::SampleMut<Ipc, [Block], FrameHeader>,
}

impl FrameMut {
    /// The frame's columns, to be written in place.
    pub fn view_mut(&mut self) -> TelemetryViewMut<'_> {
        let header = *self.sample.user_header();
        header.view_mut(self.payload_mut())
    }

    /// All values: the columns with their padding, in place.
    pub fn payload_mut(&mut self) -> &mut [f64] {
        self.sample.payload_mut().as_flattened_mut()
    }

    /// The header, for those who want to send something out of order.
    pub fn header_mut(&mut self) -> &mut FrameHeader {
        self.sample.user_header_mut()
    }
}

/// Publishes the frames of any number of actuators.
pub struct Publisher {
    service: Factory,
    port: iceoryx2::port::publisher::Publisher<Ipc, [Block], FrameHeader>,
    notifier: iceoryx2::port::notifier::Notifier<Ipc>,
    answers: iceoryx2::port::subscriber::Subscriber<Ipc, Acknowledgement, ()>,
    domain: Domain,
    _node: Node<Ipc>,
    delivery: Delivery,
    stop: Arc<AtomicBool>,
    cleaned: Instant,
    passes: u64,
}

impl Publisher {
    /// * `rows`, `channels` the largest frame
    ///
    /// # Errors
    /// Shared memory without room for the frames; a domain of another layout; shared memory that refuses.
    pub fn open(domain: &Domain, delivery: Delivery, rows: usize, channels: usize) -> Result<Self> {
        let node = domain.node()?;
        let service = telemetry(domain, &node)?;
        let mut largest = FrameHeader {
            channels: u32::MAX >> (32 - channels.clamp(1, 32)),
            rate_hz: 1.0,
            ..FrameHeader::default()
        };
        largest.set_rows(1, rows.max(1));
        let frames = MAX_SUBSCRIBERS * (BUFFER_FRAMES + MAX_BORROWED) + MAX_LOANS + 1;
        let transport = 256;
        room((frames * (largest.values() * 8 + size_of::<FrameHeader>() + transport)) as u64)?;
        let stop = Arc::new(AtomicBool::new(false));
        let builder = service
            .publisher_builder()
            .initial_max_slice_len(largest.blocks())
            .allocation_strategy(AllocationStrategy::Static)
            .max_loaned_samples(MAX_LOANS);
        let builder = match delivery {
            Delivery::RealTime => builder.backpressure_strategy(BackpressureStrategy::DiscardData),
            Delivery::Lossless => {
                let (domain, stop, last) = (domain.clone(), stop.clone(), AtomicU64::new(0));
                builder
                    .backpressure_strategy(BackpressureStrategy::RetryUntilDelivered)
                    .set_backpressure_handler(move |info| {
                        if stop.load(Ordering::Relaxed) {
                            return BackpressureAction::DiscardDataAndFail;
                        }
                        // who keeps us waiting may be dead
                        let now = super::now_ns();
                        if info.elapsed_time.as_nanos() as u64 > CLEANING_NS
                            && now - last.load(Ordering::Relaxed) > CLEANING_NS
                        {
                            last.store(now, Ordering::Relaxed);
                            domain.clean();
                        }
                        std::thread::sleep(Duration::from_micros(50));
                        BackpressureAction::Retry
                    })
            }
        };
        let port = builder.create().map_err(|e| failed(TELEMETRY, "no publisher", e))?;
        let answers = acknowledgements(domain, &node)?
            .subscriber_builder()
            .create()
            .map_err(|e| failed(ACKNOWLEDGEMENT, "no subscriber", e))?;
        let notifier = domain
            .events(&node, TELEMETRY)?
            .notifier_builder()
            .create()
            .map_err(|e| failed(TELEMETRY, "no notifier", e))?;
        Ok(Self {
            service,
            port,
            notifier,
            answers,
            domain: domain.clone(),
            _node: node,
            delivery,
            stop,
            cleaned: Instant::now(),
            passes: 0,
        })
    }

    /// Set this to end a wait for a subscriber that does not read on.
    pub fn stop_flag(&self) -> Arc<AtomicBool> {
        self.stop.clone()
    }

    /// Subscribers that are connected now, dead ones included until they are cleaned away.
    pub fn subscribers(&self) -> usize {
        use iceoryx2::service::port_factory::PortFactory;
        self.service.dynamic_config().number_of_subscribers()
    }

    fn alive(&self) -> Vec<u64> {
        use iceoryx2::service::port_factory::PortFactory;
        self.domain.clean();
        let mut ids = Vec::new();
        self.service.dynamic_config().list_subscribers(|s| {
            ids.push(folded(s.subscriber_id.value()));
            CallbackProgression::Continue
        });
        ids
    }

    /// Removes what dead processes left, now and then.
    fn clean(&mut self) {
        if self.cleaned.elapsed().as_nanos() as u64 > CLEANING_NS {
            self.cleaned = Instant::now();
            self.domain.clean();
        }
    }

    fn send_empty(&mut self, header: &FrameHeader) -> Result<usize> {
        let mut sample = self
            .port
            .loan_slice(1)
            .map_err(|e| failed(TELEMETRY, "no memory for a frame", e))?;
        *sample.user_header_mut() = FrameHeader {
            publish_ns: super::now_ns(),
            ..*header
        };
        let n = sample.send().map_err(|e| failed(TELEMETRY, "cannot be sent", e))?;
        let _ = self.notifier.notify();
        Ok(n)
    }

    /// Answers to `kind` of `stream` that have come in.
    fn read_answers(&mut self, stream: u64, kind: u32, mut each: impl FnMut(&Acknowledgement)) -> Result<()> {
        while let Some(a) = self
            .answers
            .receive()
            .map_err(|e| failed(ACKNOWLEDGEMENT, "cannot be received", e))?
        {
            if a.stream == stream && a.kind == kind {
                each(&a);
            }
        }
        Ok(())
    }

    /// Begins a run. A lossless publisher waits, at most `patience`, until a subscriber has
    /// answered, and then a moment for the others. `None`: nobody did, or `go_on` said no.
    ///
    /// # Errors
    /// A name that frames cannot have ([`NAMES`]); shared memory that refuses.
    pub fn begin(
        &mut self,
        about: &RunDescription,
        patience: Duration,
        go_on: &dyn Fn() -> bool,
    ) -> Result<Option<Pass>> {
        if !about.actuator.chars().all(foreign::is_plain) {
            return Err(Error::bad("stream", "actuator name", &about.actuator, NAMES));
        }
        self.passes += 1;
        let now = super::now_ns();
        let header = FrameHeader {
            kind: BEGIN,
            stream: now.rotate_left(20) ^ (u64::from(std::process::id()) << 8) ^ self.passes,
            ..about.header()
        };
        let mut pass = Pass {
            header,
            answered: Vec::new(),
            lost_frames: 0,
            unheard_frames: 0,
        };
        self.send_empty(&header)?;
        pass.header.frame = 1;
        if self.delivery == Delivery::RealTime {
            return Ok(Some(pass));
        }
        let start = Instant::now();
        let (mut sent, mut first) = (Instant::now(), None);
        loop {
            let answered = &mut pass.answered;
            self.read_answers(header.stream, BEGIN, |a| {
                if !answered.contains(&a.subscriber) {
                    answered.push(a.subscriber);
                }
            })?;
            if !pass.answered.is_empty() {
                let first = first.get_or_insert_with(Instant::now);
                let all = pass.answered.len() >= self.subscribers();
                if all || first.elapsed() > STRAGGLERS {
                    return Ok(Some(pass));
                }
            }
            if start.elapsed() > patience || !go_on() {
                return Ok(None);
            }
            if sent.elapsed() > AGAIN {
                sent = Instant::now();
                self.clean();
                self.send_empty(&header)?;
            }
            std::thread::sleep(Duration::from_micros(200));
        }
    }

    /// A frame of `rows` samples from number `first` on, its columns zero.
    ///
    /// # Errors
    /// A frame larger than the largest; more than four that are neither sent nor dropped.
    pub fn loan(&mut self, pass: &Pass, first: u64, rows: usize) -> Result<FrameMut> {
        let mut header = FrameHeader {
            kind: SAMPLES,
            frame: pass.header.frame,
            ..pass.header
        };
        header.set_rows(first, rows);
        let mut sample = self
            .port
            .loan_slice(header.blocks())
            .map_err(|e| failed(TELEMETRY, "no memory for a frame", e))?;
        *sample.user_header_mut() = header;
        Ok(FrameMut { sample })
    }

    /// Sends a frame. `false`: it did not reach every subscriber (and of a lossless stream: none).
    ///
    /// # Errors
    /// Shared memory that refuses.
    pub fn publish(&mut self, pass: &mut Pass, mut frame: FrameMut) -> Result<bool> {
        frame.sample.user_header_mut().publish_ns = super::now_ns();
        let n = match frame.sample.send() {
            Ok(n) => n,
            Err(_) if self.stop.load(Ordering::Relaxed) => 0,
            Err(e) => return Err(failed(TELEMETRY, "cannot be sent", e)),
        };
        pass.header.frame += 1;
        let _ = self.notifier.notify();
        let connected = self.subscribers();
        if connected == 0 {
            pass.unheard_frames += 1;
        }
        if n >= connected.max(1) {
            return Ok(true);
        }
        self.clean();
        pass.lost_frames += u64::from(n < self.subscribers());
        Ok(self.delivery == Delivery::Lossless && n > 0)
    }

    /// Ends a run and waits, at most `patience`, for the answers of those who answered its
    /// beginning and are alive (a real-time stream: of all). The frames stay readable meanwhile.
    ///
    /// # Errors
    /// Shared memory that refuses.
    pub fn end(&mut self, pass: &Pass, patience: Duration, go_on: &dyn Fn() -> bool) -> Result<Ending> {
        let header = FrameHeader {
            kind: END,
            ..pass.header
        };
        let sent = pass.header.frame - 1;
        let mut delivered = self.send_empty(&header)? > 0;
        let start = Instant::now();
        let (mut answered, mut whole) = (Vec::new(), 0);
        let mut looked = Instant::now();
        loop {
            self.read_answers(header.stream, END, |a| {
                if !answered.contains(&a.subscriber) {
                    answered.push(a.subscriber);
                    whole += usize::from(a.frames == sent);
                }
            })?;
            let expected = if self.delivery == Delivery::Lossless {
                pass.answered.len()
            } else {
                self.subscribers()
            };
            let mut waiting = answered.len() < expected;
            if waiting && looked.elapsed() > AGAIN {
                looked = Instant::now();
                let alive = self.alive();
                if self.delivery == Delivery::Lossless {
                    let missing = |id: &&u64| alive.contains(id) && !answered.contains(id);
                    waiting = pass.answered.iter().any(|id| missing(&id));
                }
                if !delivered {
                    delivered = self.send_empty(&header)? > 0;
                }
            }
            if !waiting || start.elapsed() > patience || !go_on() {
                return Ok(Ending {
                    answered: answered.len(),
                    whole,
                });
            }
            std::thread::sleep(Duration::from_micros(200));
        }
    }
}

/// A sink that publishes what it accepts, a frame a block; for producers that hold their columns
/// already.
pub struct StreamSink<'a> {
    /// where the frames go
    pub publisher: &'a mut Publisher,
    /// the run that they are of, begun before
    pub pass: &'a mut Pass,
}

impl TelemetrySink for StreamSink<'_> {
    fn accept(&mut self, _: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
        let mut frame = self.publisher.loan(self.pass, view.first, view.rows)?;
        frame.view_mut().copy_from(view);
        self.publisher.publish(self.pass, frame)?;
        Ok(())
    }
}
