//! What a study said and what the key says, read from their files.

use serde_json::Value;
use std::path::Path;

/// A parameter with its interval; a bound that is not finite is open.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    pub name: String,
    pub value: f64,
    pub lo: f64,
    pub hi: f64,
}

/// An effect that a study found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    pub name: String,
    pub parameters: Vec<Parameter>,
    pub ambiguous_with: Vec<String>,
}

/// Gap on held-out runs over the floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    pub nominal: f64,
    pub retuned: f64,
    pub last: f64,
}

/// A line of the results.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Said {
    pub case: u64,
    /// `error` where there was no verdict
    pub verdict: String,
    pub error: Option<String>,
    pub effects: Vec<Found>,
    pub has_command: bool,
    pub gap: Option<Gap>,
    pub generate_s: f64,
    pub study_s: f64,
    pub threads: u64,
    pub jobs: u64,
}

/// An effect of the key.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hidden {
    pub name: String,
    pub parameters: Vec<(String, f64)>,
    /// its law is the list's, so that parameters mean the same
    pub comparable: bool,
}

fn text(v: &Value) -> String {
    v.as_str().unwrap_or_default().to_string()
}

fn list(v: &Value) -> impl Iterator<Item = &Value> {
    v.as_array().into_iter().flatten()
}

/// Members of an object, by name.
fn members(v: &Value) -> impl Iterator<Item = (&String, &Value)> {
    v.as_object().into_iter().flatten()
}

impl Said {
    pub fn read(v: &Value) -> Self {
        let effect = |e: &Value| Found {
            name: text(&e["name"]),
            parameters: members(&e["parameters"])
                .map(|(name, p)| Parameter {
                    name: name.clone(),
                    value: p["value"].as_f64().unwrap_or(f64::NAN),
                    lo: p["lo"].as_f64().unwrap_or(f64::NEG_INFINITY),
                    hi: p["hi"].as_f64().unwrap_or(f64::INFINITY),
                })
                .collect(),
            ambiguous_with: list(&e["ambiguous_with"]).map(text).collect(),
        };
        let held = &v["gap"]["heldout"];
        let over = |name: &str| Some(held[name].as_f64()? / held["floor"].as_f64().filter(|f| *f > 0.0)?);
        let gap = || {
            Some(Gap {
                nominal: over("nominal")?,
                retuned: over("retuned")?,
                last: over("final")?,
            })
        };
        Self {
            case: v["case"].as_u64().unwrap_or(0),
            verdict: text(&v["verdict"]),
            error: v["error"].as_str().map(str::to_string),
            effects: list(&v["effects"]).map(effect).collect(),
            has_command: v["next_command"].as_str().is_some_and(|c| !c.trim().is_empty()),
            gap: gap(),
            generate_s: v["generate_s"].as_f64().unwrap_or(f64::NAN),
            study_s: v["study_s"].as_f64().unwrap_or(f64::NAN),
            threads: v["threads"].as_u64().unwrap_or(0),
            jobs: v["jobs"].as_u64().unwrap_or(0),
        }
    }

    /// Names and what they may be confused with are claimed.
    pub fn names_something(&self) -> bool {
        ["named", "named_with_remainder", "ambiguous"].contains(&self.verdict.as_str())
    }

    /// A set of names was given in place of one.
    pub fn is_ambiguous(&self) -> bool {
        let set = self.effects.iter().any(|e| !e.ambiguous_with.is_empty());
        self.verdict == "ambiguous" || (self.names_something() && set)
    }
}

/// The effects of a key.
pub fn hidden(key: &Value) -> Vec<Hidden> {
    let effect = |e: &Value| Hidden {
        name: text(&e["name"]),
        parameters: members(&e["parameters"])
            .filter_map(|(k, v)| Some((k.clone(), v.as_f64()?)))
            .collect(),
        comparable: e["parameters_comparable"].as_bool().unwrap_or(false),
    };
    list(&key["effects"]).map(effect).collect()
}

/// Opens a key; `None` where it is not there or torn.
pub fn open_key(path: &Path) -> Option<Vec<Hidden>> {
    let key: Value = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    key["effects"].is_array().then(|| hidden(&key))
}
