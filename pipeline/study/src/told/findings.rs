//! What a study found, in the words and numbers of its reports.

use crate::told::verify::Verification;
use serde_json::{Map, Value, json};
use sim_worker::effect::{EffectKind, Law, LawKey, PHASES};

/// An identified number.
#[derive(Clone, Debug, PartialEq)]
pub struct Identified {
    /// parameter of an effect, or constant of the rig
    pub name: String,
    /// in `unit`
    pub value: f64,
    /// 95 % interval
    pub lo: f64,
    /// upper end; it may be infinite
    pub hi: f64,
    /// SI at the motor unless it says otherwise
    pub unit: String,
    /// value of the model before, for constants
    pub nominal: Option<f64>,
}

impl Identified {
    /// A value and half of its interval.
    pub fn about(name: &str, value: f64, half: f64, unit: &str, nominal: Option<f64>) -> Self {
        Self {
            name: name.to_string(),
            value,
            lo: value - half,
            hi: value + half,
            unit: unit.to_string(),
            nominal,
        }
    }
}

/// An effect that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundEffect {
    /// canonical name
    pub name: String,
    /// equation where it appears
    pub equation: String,
    /// the equation's term, as in the list of effects
    pub term: String,
    /// its amplitudes and shape
    pub parameters: Vec<Identified>,
    /// correlations of their errors, row by row; empty where they are not known
    pub correlation: Vec<f64>,
    /// of the excess energy that its equation has on the fit runs without it, all else fitted again
    pub explained_share: f64,
    /// the best candidate beside it in the same step
    pub runner_up: Option<String>,
    /// effects that the data cannot tell from it
    pub ambiguous_with: Vec<String>,
    /// another name of the same term
    pub alias: Option<String>,
    /// which law of its kind it follows
    pub law: Law,
    /// channel in which the effect lives
    pub channel: String,
    /// gap of that channel on held-out data without it and with it; `None` where nothing was held out
    pub heldout: Option<(f64, f64)>,
}

/// What was found on a unit whose health nobody vouches for, in fault terms.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// `fsj`, `zeta`, or an effect
    pub name: String,
    /// with its 95 % interval
    pub value: f64,
    /// lower end
    pub lo: f64,
    /// upper end
    pub hi: f64,
    /// of the value; `-` for a ratio
    pub unit: String,
    /// in words
    pub meaning: String,
}

/// A root mean square, before and after. In a comparison `nominal` is the state's change against the baseline, and
/// `retuned` and `last` are what a rise that all have in common leaves of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GapLine {
    /// of the model as its file has it, sensors' imperfections allowed for
    pub nominal: f64,
    /// its constants re-tuned
    pub retuned: f64,
    /// with the effects that were found
    pub last: f64,
    /// what the sensors' noise leaves; in a comparison the baseline against itself
    pub floor: f64,
}

/// The gap of one equation, told as that of the channel it predicts.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelGap {
    /// name of the channel
    pub channel: String,
    /// name of the equation
    pub equation: String,
    /// of the gap: the channel's
    pub unit: String,
    /// on the runs that effects were looked for in
    pub fit: GapLine,
    /// on those that were kept for the proof, where there are any
    pub heldout: Option<GapLine>,
}

/// A place where the gap is.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// name of the equation
    pub equation: String,
    /// of the equation's excess energy
    pub share: f64,
    /// of its samples
    pub samples: f64,
    /// in words
    pub text: String,
}

/// A candidate in the ranking of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct Leader {
    /// from 1 on
    pub step: usize,
    /// canonical name of the effect
    pub name: String,
    /// in log-likelihood
    pub gain: f64,
    /// of the excess energy before the step
    pub explained_share: f64,
    /// with units, in words
    pub parameters: String,
    /// why it was taken or not
    pub note: String,
}

/// The residual of an equation along a signal: means in bins.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// name of the equation
    pub equation: String,
    /// of the residual
    pub unit: String,
    /// name of the signal
    pub signal: String,
    /// of `at`
    pub signal_unit: String,
    /// mean of the signal in each bin, rising
    pub at: Vec<f64>,
    /// mean residual in each bin with the constants re-tuned; in a comparison the baseline's current
    pub retuned: Vec<f64>,
    /// with the effects; in a comparison the state's current
    pub last: Vec<f64>,
}

/// A piece of a held-out run: what was measured and what the models say.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// name of the drive channel
    pub channel: String,
    /// of all values
    pub unit: String,
    /// name of the run
    pub run: String,
    /// false where no run was kept for the proof
    pub heldout: bool,
    /// of the samples
    pub time_s: Vec<f64>,
    /// low-passed, as the equations have it
    pub measured: Vec<f64>,
    /// by the model as its file has it
    pub nominal: Vec<f64>,
    /// by the model with its constants re-tuned
    pub retuned: Vec<f64>,
    /// by the model with the effects
    pub last: Vec<f64>,
}

/// All that a study has to say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Findings {
    /// file of the model, or `reference`
    pub model: String,
    /// file of the bench
    pub bench: String,
    /// `none`, `retune`, `named`, `named_with_remainder`, `ambiguous`, `unknown` or `candidate`
    pub verdict: String,
    /// the verdict in a sentence
    pub sentence: String,
    /// in the order in which they were added
    pub effects: Vec<FoundEffect>,
    /// `healthy` where the author vouches for all runs that were used, else `unknown`
    pub health: String,
    /// of a unit of unknown health
    pub findings: Vec<Finding>,
    /// constants of rig and sensors with their 95 % intervals
    pub retuned: Vec<Identified>,
    /// correlations of `retuned`, row by row
    pub correlation: Vec<f64>,
    /// the drive channel: the gap that counts
    pub gap: Option<ChannelGap>,
    /// the gap of every equation
    pub by_channel: Vec<ChannelGap>,
    /// where the gap of the re-tuned model is
    pub regions: Vec<Region>,
    /// of every step, the best seven
    pub leaders: Vec<Leader>,
    /// name, and why it could not be seen
    pub not_excited: Vec<(String, String)>,
    /// what channels are missing, and which equation they would open
    pub missing: Vec<(String, String)>,
    /// share of the excess that has no name
    pub unnamed_share: f64,
    /// the remainder in words, where one is worth it
    pub unnamed: Option<String>,
    /// shell command for what comes next
    pub next_command: Option<String>,
    /// why
    pub next_reason: String,
    /// the model's file, line by line: ' ', '+' or '-' in front
    pub diff: Vec<String>,
    /// the most telling ones, four at most
    pub profiles: Vec<Profile>,
    /// the stretch with the greatest gap
    pub traces: Vec<Trace>,
    /// name and value, for the head of the report
    pub facts: Vec<(String, String)>,
    /// what is assumed
    pub assumptions: Vec<String>,
    /// the rig in closed loop with its known controller; empty without one
    pub closed_loop: Vec<crate::search::closed_loop::ClosedLoop>,
    /// the simulators under the recorded command; `None` for a rig that is no actuator of ours
    pub verification: Option<Verification>,
}

fn line(g: &GapLine) -> Value {
    json!({ "nominal": g.nominal, "retuned": g.retuned, "final": g.last, "floor": g.floor })
}

fn identified(all: &[Identified]) -> Value {
    let mut map = Map::new();
    for p in all {
        let mut v = json!({ "value": p.value, "lo": p.lo, "hi": p.hi, "unit": p.unit });
        if let Some(n) = p.nominal {
            v["nominal"] = json!(n);
        }
        map.insert(p.name.clone(), v);
    }
    Value::Object(map)
}

impl FoundEffect {
    /// What sets its law apart from the first of its kind.
    pub fn law_in_words(&self) -> Option<String> {
        let text = match self.law {
            Law::First => return None,
            Law::Phase(q) => return Some(format!("in the sensor of phase {}", PHASES[q])),
            Law::Bridge => {
                "by the current that the bridge draws and gives back at every moment, which no capacitor levels"
            }
            Law::Legs => {
                "by the size of the legs' current at every moment, not by the power that a link with a capacitor draws"
            }
            Law::AngleAndSpeed => {
                "in the measured speed too, which is of the same sensor, and the speed loop acts on it"
            }
            Law::BreakAway => {
                "the bristles break away at the static friction and slide at it up to about 2 rad/s (assumed)"
            }
            Law::Flux => "the flux saturates, and the back-EMF falls with the torque",
            Law::Square => "by the square of the current",
            Law::Bridged => {
                "a contact bridges the turns, whose own current brakes; the fraction is that of a contact without resistance: with one \
                 there are more turns, with the same effect"
            }
        };
        Some(text.into())
    }
}

impl Findings {
    /// The effects' canonical names, in the order in which they were found.
    pub fn names(&self) -> Vec<&str> {
        self.effects.iter().map(|e| e.name.as_str()).collect()
    }

    /// `report.json`.
    pub fn to_json(&self) -> Value {
        let effects: Vec<Value> = self
            .effects
            .iter()
            .map(|e| {
                let mut of = json!({
                    "name": e.name,
                    "equation": e.equation,
                    "parameters": identified(&e.parameters),
                    "explained_share": e.explained_share,
                    "runner_up": e.runner_up,
                    "ambiguous_with": e.ambiguous_with,
                    "alias": e.alias,
                    "channel": e.channel,
                    "heldout_before": e.heldout.map(|h| h.0),
                    "heldout_after": e.heldout.map(|h| h.1),
                });
                for key in LawKey::ALL {
                    let own = EffectKind::from_name(&e.name).and_then(EffectKind::law_key);
                    of[key.name] = json!(own.filter(|k| *k == key).and_then(|k| k.of(e.law)));
                }
                of
            })
            .collect();
        let channels: Map<String, Value> = self
            .by_channel
            .iter()
            .map(|c| {
                let v = json!({
                    "equation": c.equation,
                    "unit": c.unit,
                    "fit": line(&c.fit),
                    "heldout": c.heldout.as_ref().map(line),
                });
                (c.channel.clone(), v)
            })
            .collect();
        let regions: Vec<Value> = self
            .regions
            .iter()
            .map(|r| json!({ "equation": r.equation, "share": r.share, "samples": r.samples, "text": r.text }))
            .collect();
        let leaders: Vec<Value> = self
            .leaders
            .iter()
            .map(|l| {
                json!({ "step": l.step, "name": l.name, "gain": l.gain, "explained_share": l.explained_share,
                        "parameters": l.parameters, "note": l.note })
            })
            .collect();
        let gap = self.gap.as_ref();
        json!({
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": effects,
            "health": self.health,
            "findings": self.findings.iter().map(|f| json!({
                "name": f.name, "value": f.value, "lo": f.lo, "hi": f.hi, "unit": f.unit, "meaning": f.meaning,
            })).collect::<Vec<_>>(),
            "retuned": identified(&self.retuned),
            "gap": {
                "channel": gap.map(|g| &g.channel),
                "unit": gap.map(|g| &g.unit),
                "fit": gap.map(|g| line(&g.fit)),
                "heldout": gap.and_then(|g| g.heldout.as_ref()).map(line),
                "by_channel": channels,
            },
            "where": regions,
            "leaderboard": leaders,
            "not_excited": self.not_excited.iter().map(|n| &n.0).collect::<Vec<_>>(),
            "not_excited_why": self.not_excited.iter().map(|(n, w)| json!({ "name": n, "why": w })).collect::<Vec<_>>(),
            "missing_channels": self.missing.iter().map(|(n, w)| json!({ "channel": n, "opens": w })).collect::<Vec<_>>(),
            "unnamed_share": self.unnamed_share,
            "unnamed": self.unnamed,
            "closed_loop": self.closed_loop.iter().map(|c| json!({
                "run": c.run, "heldout": c.heldout,
                "drive": { "nominal": c.nominal, "final": c.last },
                "position": { "nominal": c.position_nominal, "final": c.position_last },
            })).collect::<Vec<_>>(),
            "verify": self.verification.as_ref().map(|v| v.channels.iter().map(|c| json!({
                "channel": c.channel, "unit": c.unit, "samples": c.samples, "heldout": v.heldout,
                "parent": c.parent, "child": c.child,
                "simplified": c.simplified.map(|s| json!({ "parent": s.0, "child": s.1 })),
            })).collect::<Vec<_>>()),
            "verify_left_out": self.verification.as_ref().map(|v| &v.left_out),
            "next_command": self.next_command,
            "next_reason": self.next_reason,
            "model": self.model,
            "bench": self.bench,
            "assumptions": self.assumptions,
        })
    }
}
