//! What becomes of a run after it has been received: received and diagnosed are two things.

use diagnoser::live::StreamId;
use schemas::error::Result;
use schemas::stream::Domain;
use schemas::stream::diagnosis::{DiagnosisMessage, DiagnosisSubscriber};
use schemas::stream::wire::from_text;
use std::time::{Duration, Instant};

/// Whether a replay waits for final diagnoses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Await {
    /// where a diagnoser is in the domain
    Auto,
    /// always: without a diagnoser it is a loss
    Required,
    /// never
    Off,
}

/// What is known of a run's diagnosis.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// nobody was asked
    NotAwaited,
    /// no diagnoser in this domain, and none is required
    NobodyThere,
    /// `located`, `unexplained` or `out_of_range`
    Diagnosed(&'static str),
    /// the final diagnosis says what is missing
    Incomplete(String),
    /// no final diagnosis, and why
    Missing(String),
}

impl Verdict {
    /// Whether nothing is missing that was asked for.
    pub fn is_good(&self) -> bool {
        matches!(self, Self::NotAwaited | Self::NobodyThere | Self::Diagnosed(_))
    }
}

/// Longest time between two looks whether a diagnoser is alive.
const LOOK: Duration = Duration::from_millis(200);

/// How long a diagnoser that came after the stream had begun is listened to.
const SUCCESSION: Duration = Duration::from_secs(2);

/// Listens to the final diagnoses of one stream at a time.
pub(super) struct Jury {
    diagnoses: DiagnosisSubscriber,
    required: bool,
    stream: Option<StreamId>,
    /// diagnosers that were there when the stream began
    there: Vec<u128>,
    /// a diagnoser has been there since the stream began
    seen: bool,
    finals: Vec<DiagnosisMessage>,
}

impl Jury {
    /// Listens from now on, where diagnoses are awaited.
    pub fn open(domain: &Domain, when: Await) -> Result<Option<Self>> {
        if when == Await::Off {
            return Ok(None);
        }
        Ok(Some(Self {
            diagnoses: DiagnosisSubscriber::open(domain, 0)?,
            required: when == Await::Required,
            stream: None,
            there: Vec::new(),
            seen: false,
            finals: Vec::new(),
        }))
    }

    /// A stream has begun: subscribers have answered, and their diagnoses are connected to here.
    pub fn begin(&mut self, actuator: [u8; 32], stream: u64) -> Result<()> {
        self.stream = Some((actuator, stream));
        self.finals.clear();
        self.there = self.diagnoses.publishers();
        self.seen = !self.there.is_empty();
        self.listen(Duration::ZERO)
    }

    /// Takes what has come, and waits at most `time` for the first of it.
    pub fn listen(&mut self, time: Duration) -> Result<()> {
        let mut left = time;
        while let Some(m) = self.diagnoses.next(left)? {
            left = Duration::ZERO;
            if m.is_final == 1 && self.stream == Some((m.actuator, m.stream)) {
                self.finals.push(m);
            }
        }
        Ok(())
    }

    /// The best of what diagnosers have said: one of several may have had no maps.
    fn best(&self) -> Option<Verdict> {
        let found = self.finals.iter().find_map(|m| match m.outcome {
            1 => Some("located"),
            2 => Some("unexplained"),
            3 => Some("out_of_range"),
            _ => None,
        });
        let last = self.finals.last();
        found
            .map(Verdict::Diagnosed)
            .or_else(|| Some(Verdict::Incomplete(from_text(&last?.reason))))
    }

    /// Whether a diagnosis of the stream, with nothing missing, has come already.
    pub fn is_diagnosed(&mut self) -> Result<bool> {
        self.listen(Duration::ZERO)?;
        Ok(matches!(self.best(), Some(Verdict::Diagnosed(_))))
    }

    /// Waits for the final diagnosis of a stream that has been received whole, at most `patience`.
    pub fn verdict(&mut self, patience: Duration, go_on: &dyn Fn() -> bool) -> Result<Verdict> {
        let start = Instant::now();
        loop {
            let now = self.diagnoses.publishers();
            let alive = now.len();
            self.seen |= alive > 0;
            // who has come since, in the place of another or the first, knows nothing of the stream's beginning, and may say
            // nothing of it: any subscriber's answer begins a stream
            let came_late = !now.iter().any(|d| self.there.contains(d));
            let left = patience.saturating_sub(start.elapsed());
            // whatever a diagnoser said before it died is here now
            self.listen(if alive > 0 { left.min(LOOK) } else { Duration::ZERO })?;
            match self.best() {
                Some(Verdict::Incomplete(_)) if self.finals.len() < alive && !left.is_zero() && go_on() => {}
                Some(verdict) => return Ok(verdict),
                None if alive == 0 || (came_late && start.elapsed() > SUCCESSION) => return Ok(self.nobody()),
                None if left.is_zero() || !go_on() => {
                    let s = start.elapsed().as_secs_f64();
                    return Ok(Verdict::Missing(format!("no final diagnosis within {s:.1} s")));
                }
                None => {}
            }
        }
    }

    fn nobody(&self) -> Verdict {
        match (self.seen, self.there.is_empty(), self.required) {
            (true, true, _) => Verdict::Missing("the diagnoser came when the run had begun".into()),
            (true, false, _) => Verdict::Missing("the diagnoser has gone without a final diagnosis".into()),
            (false, _, true) => Verdict::Missing("no diagnoser in this domain".into()),
            (false, _, false) => Verdict::NobodyThere,
        }
    }
}
