//! The actuators of a plan: positions of every tail, and what differs between them.

use super::{MOST_ACTUATORS, NAME, PLAIN, PlannedActuator, plain, plain_name, whole};
use crate::dataset::draw::{Distribution, random};
use crate::parameters::{self, ActuatorParameters, PARAMETERS};
use schemas::error::Result;
use schemas::toml_section::Section;
use std::sync::Arc;

/// Place in [`PARAMETERS`] and distribution of what differs.
pub(super) type Spreads = Vec<(usize, Distribution)>;

pub(super) fn spread(s: &mut Section, assumed: &mut Vec<String>) -> Result<Spreads> {
    let mut list = Vec::new();
    if !s.may_have("spread") {
        return Ok(list);
    }
    let mut t = s.section("spread")?;
    for (k, (name, ..)) in PARAMETERS.into_iter().enumerate() {
        if t.may_have(name) {
            let (distribution, source) = Distribution::from_section(t.section(name)?)?;
            if source == "assumed" {
                assumed.push(format!("spread.{name}"));
            }
            list.push((k, distribution));
        }
    }
    t.finish()?;
    Ok(list)
}

/// Tail, position, and what is known of the actuator there.
type Place = (String, String, Vec<(usize, f64)>);

/// `<tail>.<position>`, or the tail alone where there is no position.
fn id_of(tail: &str, position: &str) -> String {
    if position.is_empty() {
        tail.into()
    } else {
        format!("{tail}.{position}")
    }
}

/// Tails by positions, then single actuators with what is known of them.
pub(super) fn actuators(
    s: &mut Section,
    seed: u64,
    (file, text): &(String, String),
    spread: &Spreads,
) -> Result<Vec<PlannedActuator>> {
    let mut places: Vec<Place> = Vec::new();
    if s.may_have("aircraft") {
        let mut t = s.section("aircraft")?;
        let positions = t.texts("positions", "a list of texts")?;
        let tails = if t.is_list("tails") {
            t.texts("tails", "a list of texts, or { prefix, from, count }")?
        } else {
            let mut range = t.section("tails")?;
            let prefix = range.text_or("prefix", "")?;
            let from = whole(&mut range, "from", 1, 1 << 32)?;
            let count = whole(&mut range, "count", 0, MOST_ACTUATORS as u64)?;
            range.finish()?;
            let digits = (from + count).saturating_sub(1).to_string().len();
            (from..from + count).map(|n| format!("{prefix}{n:0digits$}")).collect()
        };
        if let Some(bad) = tails.iter().find(|x| !plain_name(x)) {
            return Err(t.bad("tails", bad, NAME));
        }
        if let Some(bad) = positions.iter().find(|x| !plain(x)) {
            return Err(t.bad("positions", bad, PLAIN));
        }
        t.finish()?;
        // before they are made
        let count = tails.len() * positions.len();
        if count > MOST_ACTUATORS {
            let allowed = format!("1 to {MOST_ACTUATORS} actuators");
            return Err(s.bad("aircraft", format!("{count} actuators"), allowed));
        }
        for tail in &tails {
            for position in &positions {
                places.push((tail.clone(), position.clone(), Vec::new()));
            }
        }
    }
    let listed = s.sections("actuators")?;
    // where there is one actuator only, its name is enough
    let alone = places.is_empty() && listed.len() == 1;
    for mut one in listed {
        let tail = one.text("tail", PLAIN)?;
        let position = if alone {
            one.text_or("position", "")?
        } else {
            one.text("position", PLAIN)?
        };
        if !plain_name(&tail) {
            return Err(one.bad("tail", tail, NAME));
        }
        if !(alone && position.is_empty() || plain(&position)) {
            return Err(one.bad("position", position, PLAIN));
        }
        let mut known = Vec::new();
        for (k, (name, ..)) in PARAMETERS.into_iter().enumerate() {
            if one.may_have(name) {
                known.push((k, one.number(name, |_| true, "a finite number")?));
            }
        }
        one.finish()?;
        match places.iter_mut().find(|p| p.0 == tail && p.1 == position) {
            Some(place) => place.2 = known,
            None => places.push((tail, position, known)),
        }
    }
    if places.is_empty() || places.len() > MOST_ACTUATORS {
        let allowed = format!("1 to {MOST_ACTUATORS} actuators, by [aircraft] or [[actuators]]");
        return Err(s.bad("aircraft", format!("{} actuators", places.len()), allowed));
    }
    // some file systems do not tell upper from lower case
    let mut seen = std::collections::BTreeSet::new();
    if let Some(p) = places.iter().find(|p| !seen.insert(id_of(&p.0, &p.1).to_lowercase())) {
        return Err(s.bad("aircraft", format!("{} twice", id_of(&p.0, &p.1)), "each actuator once"));
    }
    let nominal = ActuatorParameters::parse(file, text)?.values();
    let plan = s.file();
    let one = |(tail, position, known): Place| {
        let id = id_of(&tail, &position);
        let mut values: Vec<(usize, f64)> = Vec::new();
        for &(k, distribution) in spread {
            let drawn = distribution.draw(nominal[k], &mut random(seed, PARAMETERS[k].0, &id));
            values.push((k, drawn.min(parameters::most(k))));
        }
        values.extend(known);
        let mut parameters = ActuatorParameters::parse_with(&format!("{plan}: actuator {id} ({file})"), text, &values)?;
        parameters.name = id.clone();
        Ok(PlannedActuator {
            id,
            tail,
            position,
            parameters: Arc::new(parameters),
        })
    };
    places.into_iter().map(one).collect()
}
