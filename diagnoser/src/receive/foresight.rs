//! What is foretold of actuators while they are tested: worked out by a thread of its own, never by the one that diagnoses.

use crate::live::Foretold;
use crate::report::Logged;
use std::collections::BTreeMap;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};

/// By actuator, and how often it has changed.
type Known = Arc<Mutex<(BTreeMap<String, Foretold>, u64)>>;

/// A thread that is told final diagnoses, and knows what they mean for the life that is left.
pub struct Foresight {
    to: Sender<Logged>,
    known: Known,
}

impl Foresight {
    /// * `first` what is foretold by the history alone
    /// * `next` what a final diagnosis makes of it, by the actuator's name; may take its time
    pub fn new(
        first: BTreeMap<String, Foretold>,
        mut next: impl FnMut(&Logged) -> Option<(String, Foretold)> + Send + 'static,
    ) -> Self {
        let known: Known = Arc::new(Mutex::new((first, 0)));
        let (to, from) = channel::<Logged>();
        let out = known.clone();
        // ends with the sender
        std::thread::spawn(move || {
            while let Ok(logged) = from.recv() {
                if let Some((actuator, foretold)) = next(&logged) {
                    let mut known = out.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
                    known.0.insert(actuator, foretold);
                    known.1 += 1;
                }
            }
        });
        Self { to, known }
    }

    /// Takes a final diagnosis.
    pub fn hear(&self, logged: &Logged) {
        let _ = self.to.send(logged.clone());
    }

    /// How often it has changed.
    pub fn changes(&self) -> u64 {
        self.known.lock().map_or(0, |k| k.1)
    }

    /// What is foretold of an actuator.
    pub fn of(&self, actuator: &str) -> Option<Foretold> {
        self.known.lock().ok()?.0.get(actuator).cloned()
    }
}
