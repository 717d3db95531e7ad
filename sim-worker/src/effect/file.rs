//! An effect as a table `[[effect]]` of the actuator's file.

use super::{Effect, EffectKind, LawKey, Note};
use schemas::error::Result;
use schemas::toml_section::{Section, quoted};

/// Greatest number of effects of an actuator.
pub const MOST: usize = 16;

/// Reads the tables `[[effect]]` of an actuator whose rotor has the inertia `inertia` [kg m2].
///
/// # Errors
/// An effect that is not known, keys and values that are not allowed, more than [`MOST`].
pub fn read(s: &mut Section, inertia: f64) -> Result<Vec<Effect>> {
    let sections = s.sections("effect")?;
    if sections.len() > MOST {
        return Err(s.bad("effect", sections.len(), format!("at most {MOST} effects")));
    }
    let mut effects: Vec<Effect> = Vec::new();
    for mut t in sections {
        let names = || {
            let names: Vec<&str> = EffectKind::ALL.iter().map(|k| k.name()).collect();
            names.join(", ")
        };
        let name = t.text("name", "the name of an effect")?;
        let kind = EffectKind::from_name(&name).ok_or_else(|| t.bad("name", &name, names()))?;
        let single = matches!(
            kind,
            EffectKind::Presliding | EffectKind::Compliance | EffectKind::ControlDelay
        );
        if single && effects.iter().any(|e| e.kind == kind) {
            return Err(t.bad("name", &name, format!("{name} once")));
        }
        let mut e = Effect::new(kind, &[]);
        let mut intervals = [(0.0, 0.0); 3];
        let mut known = false;
        for (i, key) in kind.keys().iter().enumerate() {
            let phase = kind == EffectKind::TurnShort && key.name == "phase";
            let behind = kind == EffectKind::Compliance && key.name == "inertia";
            let allowed = match (phase, behind) {
                (true, _) => "0, 1 or 2".to_string(),
                (_, true) => format!("0 to less than motor.inertia_kg_m2 = {inertia}"),
                _ => match (key.low.is_finite(), key.high.is_finite()) {
                    (true, true) => format!("{} to {} {}", key.low, key.high, key.unit),
                    (true, false) => format!("a finite number of at least {} {}", key.low, key.unit),
                    (false, true) => format!("a finite number of at most {} {}", key.high, key.unit),
                    (false, false) => format!("a finite number in {}", key.unit),
                },
            };
            let ok = |x: f64| x >= key.low && x <= key.high && (!phase || x.fract() == 0.0) && (!behind || x < inertia);
            if key.name == "damping" && !t.may_have("damping") {
                continue;
            }
            let (x, interval) = t.estimate(key.name, key.unit, ok, &allowed)?;
            e.values[i] = x;
            known |= interval.is_some();
            intervals[i] = interval.unwrap_or((x, x));
        }
        e.intervals = known.then_some(intervals);
        let pairs = kind.pairs();
        if pairs > 0 && t.may_have("correlation") {
            let mut r = [0.0; 3];
            r[..pairs].copy_from_slice(&t.numbers("correlation", -1.0..=1.0, pairs)?);
            e.correlation = Some(r);
        }
        if t.may_have("grows") {
            let allowed = if kind.is_friction() {
                "0 to 1"
            } else {
                "0: it is no level of friction"
            };
            e.grows = t.number(
                "grows",
                |x| (0.0..=f64::from(u8::from(kind.is_friction()))).contains(&x),
                allowed,
            )?;
        }
        for key in LawKey::ALL {
            if t.may_have(key.name) {
                let own = kind.law_key().filter(|k| *k == key);
                e.law = t.one_of(key.name, &key.allowed(own.is_some()), |name| own?.law(name))?;
            }
        }
        e.source = t.text_or("source", "assumed")?;
        if t.may_have("parent") {
            e.parent = Some(t.text("parent", "the fingerprint of an actuator")?);
        }
        if t.may_have("provenance") {
            let mut notes = t.section("provenance")?;
            for key in notes.keys() {
                let note = if notes.is_text(&key) {
                    Note::Text(notes.text(&key, "a text")?)
                } else {
                    Note::Number(notes.number(&key, |_| true, "a text or a finite number")?)
                };
                e.provenance.push((key, note));
            }
            notes.finish()?;
        }
        t.finish()?;
        effects.push(e);
    }
    Ok(effects)
}

impl Effect {
    /// The table `[[effect]]` that reads back as this effect, bit for bit.
    pub fn to_toml(&self) -> String {
        let mut out = format!("[[effect]]\nname = \"{}\"\n", self.kind.name());
        if let Some(parent) = &self.parent {
            out += &format!("parent = {}\n", quoted(parent));
        }
        for (i, (key, x)) in self.parameters().enumerate() {
            let interval = self.intervals.map_or(String::new(), |all| {
                let (lo, hi) = all[i];
                format!("lo = {lo:?}, hi = {hi:?}, ")
            });
            out += &format!(
                "{} = {{ value = {x:?}, {interval}unit = \"{}\" }}\n",
                key.name, key.unit
            );
        }
        if let Some(r) = &self.correlation {
            let all: Vec<String> = r[..self.kind.pairs()].iter().map(|x| format!("{x:?}")).collect();
            out += &format!("correlation = [{}]\n", all.join(", "));
        }
        if self.grows != 0.0 {
            out += &format!("grows = {:?}\n", self.grows);
        }
        if let Some((key, law)) = self.said_law() {
            out += &format!("{key} = \"{law}\"\n");
        }
        out += &format!("source = {}\n", quoted(&self.source));
        if !self.provenance.is_empty() {
            out += "[effect.provenance]\n";
            for (key, note) in &self.provenance {
                out += &match note {
                    Note::Text(text) => format!("{} = {}\n", quoted(key), quoted(text)),
                    Note::Number(x) => format!("{} = {x:?}\n", quoted(key)),
                };
            }
        }
        out
    }
}
