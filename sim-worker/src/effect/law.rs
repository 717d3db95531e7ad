//! The laws that an effect may follow beside the first of its kind, each said by one key of its table `[[effect]]`.

/// Names of the phases.
pub const PHASES: [&str; 3] = ["a", "b", "c"];

/// Which law of its kind an effect follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Law {
    /// the first of the kind, as the list of effects has it
    #[default]
    First,
    /// of `current_offset` and `current_gain` in an actuator of three phases: it is in the sensor of this one (0, 1, 2). By the first
    /// law nobody says, and the equivalent current has it, in the phases that conduct, by their signs
    Phase(usize),
    /// of `supply_sag`: the voltage goes by the current that the bridge draws and gives back at every moment; by the first law the
    /// link's capacitor levels that current
    Bridge,
    /// of `supply_sag`: by the size of the current of the legs that are switched up, at every moment: nothing levels it, and nothing
    /// comes back
    Legs,
    /// of `encoder_eccentricity`: the speed is made of the sensor's angle and has the error too, and the speed loop acts on it; by the
    /// first law the speed has a sensor of its own
    AngleAndSpeed,
    /// of `turn_short`: a contact bridges the turns, and their back-EMF drives a current through them that brakes the rotor; by the
    /// first law the phase has fewer turns
    Bridged,
    /// of `torque_saturation`: the flux is lost, `1/sqrt(1 + (coefficient i)^2)` of it is left, and the back-EMF falls with the torque
    /// (energy; the armature's field stands across the magnets', and iron follows what both add up to: assumed). By the first law the
    /// torque alone falls, by `coefficient |i|`
    Flux,
    /// of `torque_saturation`: the torque alone falls, by `(coefficient i)^2`
    Square,
    /// of `presliding`: the bristles break away at the actuator's static friction, and slide at it up to about 2 rad/s (LuGre: Canudas
    /// de Wit, Olsson, Astrom and Lischinsky, IEEE Trans. Automatic Control 40 (1995); the speed assumed). By the first law they slide
    /// at the dynamic friction
    BreakAway,
}

/// The key that says the law of an effect.
#[derive(Debug, PartialEq)]
pub struct LawKey {
    /// in files and reports
    pub name: &'static str,
    /// why effects of other kinds have it not
    elsewhere: &'static str,
    /// what it may say; the first law need not be said
    laws: &'static [(&'static str, Law)],
}

pub(super) const SENSOR: LawKey = LawKey {
    name: "sensor",
    elsewhere: "it is in no sensor of a phase",
    laws: &[
        (PHASES[0], Law::Phase(0)),
        (PHASES[1], Law::Phase(1)),
        (PHASES[2], Law::Phase(2)),
    ],
};

/// Laws that a source may follow.
pub const SOURCES: [Law; 3] = [Law::First, Law::Bridge, Law::Legs];

pub(super) const DRAW: LawKey = LawKey {
    name: "draw",
    elsewhere: "it is in no source",
    laws: &[("power", SOURCES[0]), ("bridge", SOURCES[1]), ("legs", SOURCES[2])],
};

pub(super) const READS: LawKey = LawKey {
    name: "reads",
    elsewhere: "it is in no sensor of the angle",
    laws: &[("angle", Law::First), ("angle_and_speed", Law::AngleAndSpeed)],
};

pub(super) const TURNS: LawKey = LawKey {
    name: "turns",
    elsewhere: "it is in no winding",
    laws: &[("lost", Law::First), ("bridged", Law::Bridged)],
};

pub(super) const SATURATES: LawKey = LawKey {
    name: "saturates",
    elsewhere: "it is in no iron",
    laws: &[("torque", Law::First), ("square", Law::Square), ("flux", Law::Flux)],
};

pub(super) const BREAKS_AWAY: LawKey = LawKey {
    name: "breaks_away",
    elsewhere: "it is in no bristles",
    laws: &[("dynamic", Law::First), ("static", Law::BreakAway)],
};

impl LawKey {
    /// All keys.
    pub const ALL: [&'static Self; 6] = [&SENSOR, &DRAW, &READS, &TURNS, &SATURATES, &BREAKS_AWAY];

    /// The law of a name.
    pub fn law(&self, name: &str) -> Option<Law> {
        self.laws.iter().find(|l| l.0 == name).map(|l| l.1)
    }

    /// The name of a law; none for a first law without one.
    pub fn of(&self, law: Law) -> Option<&'static str> {
        self.laws.iter().find(|l| l.1 == law).map(|l| l.0)
    }

    /// All laws that have a name.
    pub fn laws(&self) -> impl Iterator<Item = Law> + '_ {
        self.laws.iter().map(|l| l.1)
    }

    /// What is allowed, in words.
    ///
    /// * `here` whether the effect has the key
    pub(super) fn allowed(&self, here: bool) -> String {
        let names: Vec<&str> = self.laws.iter().map(|l| l.0).collect();
        match names.split_last() {
            Some((last, others)) if here => format!("{} or {last}", others.join(", ")),
            _ => format!("nothing: {}", self.elsewhere),
        }
    }
}
