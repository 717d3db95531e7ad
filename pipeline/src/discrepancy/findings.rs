//! What a study found, in the words and numbers of its reports.

use serde_json::{Map, Value, json};

/// An identified number.
#[derive(Clone, Debug, PartialEq)]
pub struct Identified {
    pub name: String,
    pub value: f64,
    /// 95 % interval
    pub lo: f64,
    pub hi: f64,
    pub unit: String,
    /// value of the model before, for constants
    pub nominal: Option<f64>,
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
    pub parameters: Vec<Identified>,
    /// of the excess energy of its equations, when it was added
    pub explained_share: f64,
    pub runner_up: Option<String>,
    pub ambiguous_with: Vec<String>,
    /// another name of the same term
    pub alias: Option<String>,
}

/// A root mean square, before and after.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GapLine {
    pub nominal: f64,
    pub retuned: f64,
    pub last: f64,
    pub floor: f64,
}

/// The gap of one equation, told as that of the channel it predicts.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelGap {
    pub channel: String,
    pub equation: String,
    pub unit: String,
    pub fit: GapLine,
    pub heldout: Option<GapLine>,
}

/// A place where the gap is.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    pub equation: String,
    /// of the equation's excess energy
    pub share: f64,
    /// of its samples
    pub samples: f64,
    pub text: String,
}

/// A candidate in the ranking of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct Leader {
    pub step: usize,
    pub name: String,
    /// in log-likelihood
    pub gain: f64,
    /// of the excess energy before the step
    pub explained_share: f64,
    pub parameters: String,
    /// why it was taken or not
    pub note: String,
}

/// The residual of an equation along a signal: means in bins.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    pub equation: String,
    pub unit: String,
    pub signal: String,
    pub signal_unit: String,
    pub at: Vec<f64>,
    pub retuned: Vec<f64>,
    pub last: Vec<f64>,
}

/// A piece of a held-out run: what was measured and what the models say.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    pub channel: String,
    pub unit: String,
    pub run: String,
    pub heldout: bool,
    pub time_s: Vec<f64>,
    pub measured: Vec<f64>,
    pub nominal: Vec<f64>,
    pub retuned: Vec<f64>,
    pub last: Vec<f64>,
}

/// All that a study has to say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Findings {
    pub model: String,
    pub bench: String,
    pub verdict: String,
    /// the verdict in a sentence
    pub sentence: String,
    pub effects: Vec<FoundEffect>,
    pub retuned: Vec<Identified>,
    /// the drive channel: the gap that counts
    pub gap: Option<ChannelGap>,
    pub by_channel: Vec<ChannelGap>,
    pub regions: Vec<Region>,
    pub leaders: Vec<Leader>,
    /// name, and why it could not be seen
    pub not_excited: Vec<(String, String)>,
    /// what channels are missing, and which equation they would open
    pub missing: Vec<(String, String)>,
    /// share of the excess that has no name
    pub unnamed_share: f64,
    pub unnamed: Option<String>,
    /// shell command for what comes next
    pub next_command: Option<String>,
    /// why
    pub next_reason: String,
    /// the model's file, line by line: ' ', '+' or '-' in front
    pub diff: Vec<String>,
    pub profiles: Vec<Profile>,
    pub traces: Vec<Trace>,
    /// name and value, for the head of the report
    pub facts: Vec<(String, String)>,
    /// what is assumed
    pub assumptions: Vec<String>,
    /// the rig in closed loop with its known controller; empty without one
    pub closed_loop: Vec<super::closed_loop::ClosedLoop>,
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

impl Findings {
    /// `report.json`.
    pub fn to_json(&self) -> Value {
        let effects: Vec<Value> = self
            .effects
            .iter()
            .map(|e| {
                json!({
                    "name": e.name,
                    "equation": e.equation,
                    "parameters": identified(&e.parameters),
                    "explained_share": e.explained_share,
                    "runner_up": e.runner_up,
                    "ambiguous_with": e.ambiguous_with,
                    "alias": e.alias,
                })
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
            "next_command": self.next_command,
            "next_reason": self.next_reason,
            "model": self.model,
            "bench": self.bench,
            "assumptions": self.assumptions,
        })
    }
}
