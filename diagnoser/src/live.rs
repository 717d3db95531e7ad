//! Live diagnosis without input or output: frames in, diagnoses out. Every stream that is seen
//! ends in exactly one final diagnosis, and what was lost or wrong is said in it.

mod concluded;
mod making;
#[cfg(test)]
mod tests;
mod track;

use crate::diagnosis::{Diagnoser, Diagnosis, Outcome};
use crate::map_library::MapKey;
use crate::prognosis::history::Ends;
use concluded::Concluded;
pub use concluded::StreamId;
pub use making::{MOST_MAKING, SHARE_FOR_MAKING};
use schemas::channel::{Channel, ChannelSet};
use schemas::feature::{Features, RawFeatures};
use schemas::sequence::TestSequence;
use schemas::stream::frame::{FrameHeader, RunDescription};
use schemas::stream::wire::to_number;
use schemas::test_kind::TestKind;
use sim_worker::extractor::{FeatureExtractor, FeaturePlan};
use sim_worker::parameters::ActuatorParameters;
use sim_worker::sensor::Sampling;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;
use track::{Arrival, Track};

/// Lowest telemetry rate that a diagnosis takes [Hz].
pub const LOWEST_RATE_HZ: f64 = 1000.0;

/// Highest telemetry rate that a diagnosis takes [Hz]: what is worked out for a kind of test grows with it.
pub const HIGHEST_RATE_HZ: f64 = 1e6;

/// Finished streams remembered per actuator, so that a late frame does not look like a new run.
const REMEMBERED: usize = 8;
/// And of all actuators, whatever names they are given.
const REMEMBERED_IN_ALL: usize = 4096;

/// Map sets kept in memory.
const KEPT_MAPS: usize = 256;
/// Plans of features kept in memory, one a kind of test and rate, and samples of all of them: 256 MB.
const KEPT_PLANS: usize = 256;
const KEPT_PLAN_ROWS: u64 = 32 << 20;

/// What the diagnoser can interpret: a frame names actuator, sequence and sensors by fingerprint.
#[derive(Clone, Debug, Default)]
pub struct Known {
    /// whose parameters frames may name
    pub actuators: Vec<Arc<ActuatorParameters>>,
    /// that frames may name
    pub sequences: Vec<TestSequence>,
    /// fingerprints of sensor models, `none` included, and what samples are by them
    pub sensors: Vec<(String, Sampling)>,
    /// models of units that are known, by the names of their actuators: these are interpreted by them, whatever their frames
    /// name
    pub units: BTreeMap<String, Arc<ActuatorParameters>>,
}

impl Known {
    fn actuator(&self, fingerprint: &str) -> Option<&Arc<ActuatorParameters>> {
        self.actuators.iter().find(|a| a.fingerprint() == fingerprint)
    }
    fn sequence(&self, fingerprint: &str) -> Option<&TestSequence> {
        self.sequences.iter().find(|s| s.fingerprint() == fingerprint)
    }
}

/// A diagnosis of a stream.
#[derive(Clone, Debug)]
pub struct Report {
    /// what the stream says of its run
    pub run: RunDescription,
    /// this pass of the run: another number whenever it starts anew
    pub stream: u64,
    /// the last word; otherwise what is known so far
    pub is_final: bool,
    /// outcome and features
    pub diagnosis: Diagnosis,
    /// taken into the features
    pub samples_received: u64,
    /// that never came
    pub samples_lost: u64,
    /// when the frame that brought it was published [ns, CLOCK_MONOTONIC]
    pub telemetry_ns: u64,
}

/// What a person sees of an actuator.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// name
    pub actuator: String,
    /// number of the run, chosen by the sender
    pub run: u64,
    /// process number of the sender
    pub process: u32,
    /// what the command does now, in words
    pub phase: String,
    /// the last sample that came or was passed over
    pub sample: u64,
    /// of the whole run, 0 where unknown
    pub samples: u64,
    /// samples that never came
    pub lost: u64,
    /// features so far
    pub raw: RawFeatures,
    /// over the maps' nominal run, once there are maps
    pub features: Features,
    /// the last diagnosis, final or so far
    pub outcome: Option<Outcome>,
    /// nothing more will be said of this run
    pub is_final: bool,
    /// what its history foretells, where somebody works it out
    pub foretold: Option<Foretold>,
}

/// What is foretold of one actuator: of its faults the one whose life ends first.
#[derive(Clone, Debug, PartialEq)]
pub struct Foretold {
    /// fault or indicator
    pub fault: String,
    /// growth a unit of the clock
    pub rate: Option<f64>,
    /// remaining life: ends of the interval, and median [units of the clock]; infinite is never
    pub left: Option<Ends>,
    /// unit of the clock: flight, cycle, hour or day
    pub clock: &'static str,
    /// what stands in place of a remaining life
    pub status: String,
}

enum Maps {
    /// saved ones are being looked for
    Wanted,
    /// there are no saved ones; they may be made
    Absent,
    /// asked to be made
    Making,
    Ready(Arc<Diagnoser>),
    Refused(String),
}

type Key = StreamId;

/// Work that a frame has made, to be done when no frame is waiting.
enum Task {
    Provisional(Key),
    Conclude(Key),
}

fn incomplete(lacking: &[String]) -> Outcome {
    Outcome::Incomplete {
        reason: lacking.join("; "),
        area: None,
    }
}

/// What can be said without maps: the features, and what is lacking.
fn without_maps(mut lacking: Vec<String>, x: &FeatureExtractor) -> Diagnosis {
    lacking.extend(x.missing());
    let features = Features::over(&x.features(), &RawFeatures::default());
    Diagnosis::without_maps(incomplete(&lacking), features)
}

type Plans = HashMap<(u64, u64, u64, (bool, Sampling)), Arc<FeaturePlan>>;

/// Forgets plans that no remembered stream uses, where there are many; whether there is room for one of `rows` samples.
fn make_room(plans: &mut Plans, rows: u64) -> bool {
    let is_full = |plans: &Plans| {
        let held = plans.values().map(|p| p.rows).fold(rows, u64::saturating_add);
        held > KEPT_PLAN_ROWS
    };
    if plans.len() >= KEPT_PLANS || is_full(plans) {
        plans.retain(|_, p| Arc::strong_count(p) > 1);
    }
    !is_full(plans)
}

/// The state of all streams.
#[derive(Default)]
pub struct Live {
    tasks: VecDeque<Task>,
    known: Known,
    tracks: HashMap<Key, Track>,
    plans: Plans,
    maps: HashMap<MapKey, Maps>,
    wishes: Vec<MapKey>,
    to_make: Vec<MapKey>,
    reports: Vec<Report>,
    concluded: Concluded,
    /// frames that no stream could be found for, and why the last one
    strays: u64,
    last_stray: String,
}

impl Live {
    /// No streams yet, and no maps: they are wished for when they are needed ([`Live::wishes`]).
    pub fn new(known: Known) -> Self {
        Self {
            known,
            tasks: VecDeque::with_capacity(1024),
            ..Self::default()
        }
    }

    /// Streams that have had their final diagnosis from an earlier process: they get no other one.
    pub fn already_concluded(&mut self, streams: impl IntoIterator<Item = StreamId>) {
        streams.into_iter().for_each(|s| self.concluded.insert(s));
    }

    /// Takes a frame, in place.
    ///
    /// * `publisher` who sent it
    /// * `is_alive` whether a publisher is alive; asked only when two want the same actuator
    /// * `now_ns` CLOCK_MONOTONIC
    ///
    /// Returns the number of frames to be answered with, where the frame wants an answer.
    pub fn frame(
        &mut self,
        header: &FrameHeader,
        payload: &[f64],
        publisher: u64,
        is_alive: &dyn Fn(u64) -> bool,
        now_ns: u64,
    ) -> Option<u64> {
        let key = (header.actuator, header.stream);
        let view = match header.view(payload) {
            Ok(view) => view,
            Err(fault) => {
                let text = format!("frame {}: {fault}", header.frame);
                match self.tracks.get_mut(&key) {
                    Some(t) if header.schema_version == schemas::SCHEMA_VERSION => t.damaged(header.frame, text),
                    _ => {
                        self.strays = self.strays.saturating_add(1);
                        self.last_stray = format!("process {}: {text}", header.process);
                    }
                }
                return None;
            }
        };
        if !self.tracks.contains_key(&key) {
            self.open(header, publisher, is_alive, now_ns);
        }
        let track = self.tracks.get_mut(&key)?;
        let whole_frames = |t: &Track| Some(t.whole_frames());
        match track.arrive(header, now_ns) {
            Arrival::Greeting => whole_frames(track),
            Arrival::Late => None,
            Arrival::Samples => {
                track.samples(header, &view);
                self.progress(key);
                None
            }
            Arrival::End => {
                let answer = whole_frames(track);
                self.conclude(key);
                answer
            }
        }
    }

    /// A new stream.
    fn open(&mut self, header: &FrameHeader, publisher: u64, is_alive: &dyn Fn(u64) -> bool, now_ns: u64) {
        let run = header.description();
        let sequence = self.known.sequence(&run.sequence).cloned();
        let mut track = Track::new(header, sequence, publisher, now_ns);
        if self.concluded.contains(&(header.actuator, header.stream)) {
            track.stay_silent();
        } else if let Err(why) = self.prepare(&mut track) {
            track.give_up(why);
        }
        // who else sends this actuator?
        let same = |k: &Key| k.0 == header.actuator && k.1 != header.stream;
        let others: Vec<Key> = self
            .tracks
            .iter()
            .filter(|(k, t)| same(k) && !t.is_final() && t.is_streaming())
            .map(|(k, _)| *k)
            .collect();
        for other in others {
            let old = self.tracks.get_mut(&other).expect("just found");
            let process = old.header().process;
            let why = if old.publisher() == publisher {
                "sent anew from the start".into()
            } else if is_alive(old.publisher()) {
                track.give_up(format!(
                    "two publishers for actuator `{}`: process {process} has been sending it, process {} is refused",
                    track.run().actuator,
                    header.process
                ));
                continue;
            } else {
                format!("the publisher (process {process}) died after sample {}", old.sample())
            };
            old.break_off(why);
            self.conclude(other);
        }
        // forget the oldest finished streams of this actuator
        self.forget(REMEMBERED, same);
        self.forget(REMEMBERED_IN_ALL, |_| true);
        let key = (header.actuator, header.stream);
        self.tracks.insert(key, track);
        self.conclude(key);
    }

    /// Forgets the oldest finished streams among `which`, but for `kept`.
    fn forget(&mut self, kept: usize, which: impl Fn(&Key) -> bool) {
        let finished = self.tracks.iter().filter(|(k, t)| which(k) && t.is_final());
        let mut finished: Vec<(u64, Key)> = finished.map(|(k, t)| (t.last_ns(), *k)).collect();
        if finished.len() > kept {
            finished.sort_unstable();
            finished.truncate(finished.len() - kept);
            finished.iter().for_each(|(_, k)| {
                self.tracks.remove(k);
            });
        }
    }

    /// Finds what the stream is to be interpreted with.
    fn prepare(&mut self, track: &mut Track) -> Result<(), String> {
        let run = track.run();
        let list = |v: Vec<String>| v.join(", ");
        let unit = self.known.units.get(&run.actuator);
        let Some(actuator) = unit.or(self.known.actuator(&run.parameters)) else {
            let known = self.known.actuators.iter();
            let known = known.map(|a| format!("{} ({})", a.fingerprint(), a.name)).collect();
            let found = &run.parameters;
            return Err(format!("unknown actuator: parameters {found}; known: {}", list(known)));
        };
        let Some(sequence) = self.known.sequence(&run.sequence) else {
            let known = self.known.sequences.iter();
            let known = known.map(|s| format!("{} ({})", s.fingerprint(), s.name)).collect();
            return Err(format!("unknown sequence {}; known: {}", run.sequence, list(known)));
        };
        let Some((_, sampling)) = self.known.sensors.iter().find(|s| s.0 == run.sensors) else {
            let known = list(self.known.sensors.iter().map(|s| s.0.clone()).collect());
            return Err(format!("unknown sensors `{}`; known: {known}", run.sensors));
        };
        let sampling = *sampling;
        if !(LOWEST_RATE_HZ * (1.0 - 1e-6)..=HIGHEST_RATE_HZ * (1.0 + 1e-6)).contains(&run.rate_hz) {
            return Err(format!(
                "rate {} Hz; allowed: {LOWEST_RATE_HZ} to {HIGHEST_RATE_HZ} Hz",
                run.rate_hz
            ));
        }
        let equivalent = FeaturePlan::lacks_phases(|c| run.channels.contains(c));
        let unit = unit.map(|u| u.fingerprint());
        let id = (
            unit.as_ref().map_or(track.header().parameters, |u| to_number(u)),
            track.header().sequence,
            run.rate_hz.to_bits(),
            (equivalent, sampling),
        );
        let rows = (sequence.duration_s() * run.rate_hz) as u64;
        if !self.plans.contains_key(&id) && !make_room(&mut self.plans, rows) {
            return Err("too many other kinds of tests are remembered; no more are taken at once".into());
        }
        let plan = self
            .plans
            .entry(id)
            .or_insert_with(|| Arc::new(FeaturePlan::new(actuator, sequence, run.rate_hz, equivalent, sampling)))
            .clone();
        let needed = if equivalent {
            ChannelSet::of([Channel::Com, Channel::ThetaM, Channel::OmegaM, Channel::IEq])
        } else {
            plan.channels()
        };
        if let Some(c) = needed.iter().find(|c| !run.channels.contains(*c)) {
            return Err(format!("channel `{}` is missing", c.name()));
        }
        let more = plan.wanted().iter().filter(|c| run.channels.contains(*c));
        let taken = more.fold(needed, ChannelSet::with);
        track.interpret(plan, taken, unit);
        Ok(())
    }

    /// Asks for maps once the rest angle is known, and says what the features say.
    fn progress(&mut self, key: Key) {
        let track = self.tracks.get_mut(&key).expect("called with a track");
        if let Some(wish) = track.wish()
            && !self.maps.contains_key(&wish)
        {
            self.trim_maps();
            self.wishes.push(wish.clone());
            self.maps.insert(wish, Maps::Wanted);
        }
        self.make_if_worth_it(key);
        let track = self.tracks.get_mut(&key).expect("called with a track");
        let Some(x) = track.extractor().filter(|_| !track.is_final()) else {
            return;
        };
        if x.is_complete() {
            if track.make_due() {
                self.tasks.push_back(Task::Conclude(key));
            }
            return;
        }
        let maps = track.maps().and_then(|k| self.maps.get(k));
        if matches!(maps, Some(Maps::Ready(_))) && track.has_more() {
            self.tasks.push_back(Task::Provisional(key));
        }
    }

    /// Does one piece of work that frames have made: an inversion takes as long as taking in fifty
    /// frames, so frames go first. Returns whether there was any.
    pub fn work(&mut self) -> bool {
        let task = self.tasks.pop_front();
        match &task {
            Some(Task::Provisional(key)) if self.tracks.contains_key(key) => self.provisional(*key),
            Some(Task::Conclude(key)) if self.tracks.contains_key(key) => self.conclude(*key),
            _ => {}
        }
        task.is_some()
    }

    /// What the maps say of the features so far.
    fn provisional(&mut self, key: Key) {
        let track = self.tracks.get_mut(&key).expect("called with a track");
        let (Some(x), Some(k), false) = (track.extractor(), track.maps(), track.is_final()) else {
            return;
        };
        let Some(Maps::Ready(diagnoser)) = self.maps.get(k) else {
            return;
        };
        let features = diagnoser.maps.features(&x.features());
        let diagnosis = diagnoser.diagnose(&features, &x.missing());
        self.reports.push(track.so_far(diagnosis));
    }

    /// The final diagnosis of a stream that is due, if its maps are there.
    fn conclude(&mut self, key: Key) {
        let track = self.tracks.get_mut(&key).expect("called with a track");
        if !track.is_due() {
            return;
        }
        self.make_if_worth_it(key);
        let track = self.tracks.get_mut(&key).expect("called with a track");
        let mut lacking = track.notes();
        let diagnosis = match (track.extractor(), track.maps()) {
            (Some(x), Some(k)) => match self.maps.get(k) {
                Some(Maps::Ready(diagnoser)) => {
                    let test = TestKind {
                        load_n_m: track.run().load(),
                        ..k.kind().clone()
                    };
                    if let Some(d) = test.difference(&diagnoser.maps.header.kind) {
                        lacking.push(format!("{} {}; the maps are for {}", d.place, d.found, d.allowed));
                    }
                    lacking.extend(x.missing());
                    let features = diagnoser.maps.features(&x.features());
                    diagnoser.diagnose(&features, &lacking)
                }
                Some(Maps::Refused(why)) => {
                    lacking.push(why.clone());
                    without_maps(lacking, x)
                }
                Some(Maps::Absent) => {
                    lacking.push(making::why_not_made(track, k));
                    without_maps(lacking, x)
                }
                // a diagnosis follows when they come
                _ => return,
            },
            (Some(x), None) => {
                if !track.begins() {
                    lacking.insert(0, "sample 1 is missing: the rotor angle at rest is unknown".into());
                }
                without_maps(lacking, x)
            }
            (None, _) => Diagnosis::without_maps(incomplete(&lacking), Features::default()),
        };
        self.concluded.insert(key);
        self.reports.push(track.finish(diagnosis));
    }

    /// Maps that came, or why they cannot.
    pub fn maps(&mut self, key: &MapKey, maps: Result<Arc<Diagnoser>, String>) {
        let state = match maps {
            Ok(diagnoser) => Maps::Ready(diagnoser),
            Err(why) => Maps::Refused(why),
        };
        self.maps.insert(key.clone(), state);
        self.go_on_with(key);
    }

    /// Goes on with the streams that have been waiting for news of these maps.
    fn go_on_with(&mut self, key: &MapKey) {
        let waiting: Vec<Key> = self
            .tracks
            .iter()
            .filter(|(_, t)| t.maps() == Some(key) && !t.is_final())
            .map(|(k, _)| *k)
            .collect();
        for k in waiting {
            self.progress(k);
            self.conclude(k);
        }
    }

    /// Forgets map sets that no open stream uses, when there are many; a refusal is asked again.
    fn trim_maps(&mut self) {
        let tracks = &self.tracks;
        let used = |k: &MapKey| tracks.values().any(|t| !t.is_final() && t.maps() == Some(k));
        let many = self.maps.len() >= KEPT_MAPS;
        self.maps
            .retain(|k, m| used(k) || !(many || matches!(m, Maps::Refused(_) | Maps::Absent)));
    }

    /// Ends streams whose publisher is gone or has been silent for `timeout_ns`.
    pub fn tick(&mut self, now_ns: u64, timeout_ns: u64, is_alive: &dyn Fn(u64) -> bool) {
        let mut over = Vec::new();
        for (k, t) in &mut self.tracks {
            if !t.is_open() {
                continue;
            }
            let (n, of) = (t.sample(), t.run().total_rows);
            t.break_off(if !is_alive(t.publisher()) {
                let p = t.header().process;
                format!("the publisher (process {p}) died after sample {n} of {of}")
            } else if now_ns.saturating_sub(t.last_ns()) > timeout_ns {
                let s = timeout_ns as f64 * 1e-9;
                format!("no frame for {s} s after sample {n} of {of}")
            } else {
                continue;
            });
            over.push(*k);
        }
        for k in over {
            self.conclude(k);
        }
    }

    /// Ends all streams: nobody will take their frames any more.
    pub fn stop(&mut self) {
        for m in self
            .maps
            .values_mut()
            .filter(|m| !matches!(m, Maps::Ready(_) | Maps::Refused(_)))
        {
            *m = Maps::Refused("stopped before the maps were there".into());
        }
        let open: Vec<Key> = self
            .tracks
            .iter()
            .filter(|(_, t)| !t.is_final())
            .map(|(k, _)| *k)
            .collect();
        for k in open {
            let t = self.tracks.get_mut(&k).expect("just found");
            if t.is_open() {
                let (n, of) = (t.sample(), t.run().total_rows);
                t.give_up(format!("the diagnoser was stopped after sample {n} of {of}"));
            }
            self.conclude(k);
        }
    }

    /// Whether an open stream has had no frame for `quiet_ns`, so that [`Live::tick`] may have
    /// something to do.
    pub fn is_waiting(&self, now_ns: u64, quiet_ns: u64) -> bool {
        let quiet = |t: &Track| now_ns.saturating_sub(t.last_ns()) > quiet_ns;
        self.tracks.values().any(|t| t.is_open() && quiet(t))
    }

    /// Whether a stream has not had its last frame yet.
    pub fn is_streaming(&self) -> bool {
        self.tracks.values().any(Track::is_streaming)
    }

    /// Streams that have not had their final diagnosis.
    pub fn open_streams(&self) -> usize {
        self.tracks.values().filter(|t| !t.is_final()).count()
    }

    /// Samples that never came, of the streams that are remembered.
    pub fn lost_samples(&self) -> u64 {
        let lost = self.tracks.values().map(Track::lost_samples);
        lost.fold(0, u64::saturating_add)
    }

    /// Frames that no stream could be found for, and why the last one.
    pub fn strays(&self) -> (u64, &str) {
        (self.strays, &self.last_stray)
    }

    /// Diagnoses since the last call.
    pub fn reports(&mut self) -> std::vec::Drain<'_, Report> {
        self.reports.drain(..)
    }

    /// Maps asked for since the last call; the answer is [`Live::maps`] or [`Live::no_saved_maps`].
    pub fn wishes(&mut self) -> std::vec::Drain<'_, MapKey> {
        self.wishes.drain(..)
    }

    /// The newest stream of every actuator, by name.
    pub fn statuses(&self) -> Vec<Status> {
        let mut newest: HashMap<[u8; 32], &Track> = HashMap::new();
        for (k, t) in &self.tracks {
            let slot = newest.entry(k.0).or_insert(t);
            if t.last_ns() > slot.last_ns() {
                *slot = t;
            }
        }
        let mut v: Vec<Status> = newest.values().map(|t| t.status()).collect();
        v.sort_by(|a, b| a.actuator.cmp(&b.actuator));
        v
    }
}
