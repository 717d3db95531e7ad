//! A state against a healthy baseline, for benches with only an unsigned current: no equation can be set
//! up, but friction that rises can be told, and that something else changed.

use crate::measured::bench::{Bench, BenchChannel, Role};
use crate::measured::recording::Run;
use crate::told::compare_motion::{
    FEATURES, MEAN, Record, SETTLED, STANDSTILL, difference, features, largest, mean, part, record, rms, scatter,
    stretches,
};
use crate::told::findings::{ChannelGap, Findings, GapLine, Identified, Profile, Region};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::effect::{EffectKind, Equation};
use std::f64::consts::TAU;

/// Least relative rise of friction, and over the null's 95 % point.
const LEAST_RISE: f64 = 0.05;
const OVER_NULL: f64 = 3.0;
/// Least change of shape over the largest of the null, and its largest chance by permutation.
const OVER_SHAPE: f64 = 1.5;
const CHANCE: f64 = 0.02;
const DRAWS: usize = 1000;
const FEWEST: usize = 4;
/// A feature under one condition, in one direction.
struct Column {
    place: String,
    condition: String,
    positive: bool,
    feature: usize,
    /// by unit
    values: Vec<f64>,
}

impl Column {
    fn of<'a>(&'a self, units: &'a [usize]) -> impl Iterator<Item = f64> + Clone + 'a {
        units.iter().map(|&i| self.values[i])
    }

    fn mean(&self, units: &[usize]) -> f64 {
        mean(self.of(units))
    }
}

/// The features of all units, repeats averaged.
struct Table {
    cells: Vec<Column>,
    shape: Vec<Column>,
    healthy: Vec<usize>,
    state: Vec<usize>,
}

impl Table {
    fn new(records: &[Record], linear: bool) -> Self {
        let mut units: Vec<(bool, &str)> = records.iter().map(|r| (r.healthy, r.unit.as_str())).collect();
        let mut conditions: Vec<&str> = records.iter().map(|r| r.condition.as_str()).collect();
        units.sort_unstable();
        units.dedup();
        conditions.sort_unstable();
        conditions.dedup();
        let (healthy, state): (Vec<usize>, _) = (0..units.len()).partition(|&i| units[i].0);
        let mut columns = Vec::new();
        for condition in conditions {
            for (positive, word) in [(true, ["forwards", "extension"]), (false, ["backwards", "retraction"])] {
                let mut all = Vec::new();
                for r in records.iter().filter(|r| r.condition == condition) {
                    let moves = stretches(r);
                    let here = moves.iter().filter(|s| s.positive == positive);
                    all.extend(here.map(|s| ((r.healthy, r.unit.as_str()), features(r, s))));
                }
                for feature in 0..FEATURES.len() {
                    let of = |unit| mean(all.iter().filter(|(u, _)| *u == unit).map(|(_, v)| v[feature]));
                    let values = units.iter().map(|&u| of(u)).collect();
                    let place = [condition, word[usize::from(linear)]];
                    let place = place
                        .into_iter()
                        .filter(|w| !w.is_empty())
                        .collect::<Vec<_>>()
                        .join(", ");
                    columns.push(Column {
                        place,
                        condition: condition.into(),
                        positive,
                        feature,
                        values,
                    });
                }
            }
        }
        let known = |c: &Column, units: &[usize]| c.of(units).filter(|x| !x.is_nan()).count();
        columns.retain(|c| known(c, &healthy) >= FEWEST && known(c, &state) > 0);
        let (cells, shape) = columns.into_iter().partition(|c| c.feature == MEAN);
        Self {
            cells,
            shape,
            healthy,
            state,
        }
    }

    /// Changes of the cells [A], and their mean, relative.
    fn level(&self, from: &[usize], to: &[usize]) -> (Vec<f64>, f64) {
        let change = |c: &Column| c.mean(to) - c.mean(from);
        let relative = |c: &Column| change(c) / c.mean(from);
        (
            self.cells.iter().map(change).collect(),
            mean(self.cells.iter().map(relative)),
        )
    }

    /// Scatter of the features of shape, not below a thousandth of their means.
    fn scatter(&self, pool: &[usize]) -> Vec<f64> {
        let one = |c: &Column| scatter(c.of(pool)).0.max(1e-3 * c.mean(pool).abs() + 1e-12);
        self.shape.iter().map(one).collect()
    }

    /// Changes of the features of shape, in standard deviations.
    fn shape(&self, from: &[usize], to: &[usize], scatter: &[f64]) -> Vec<f64> {
        let one = |(c, s): (&Column, &f64)| (c.mean(to) - c.mean(from)) / s;
        self.shape.iter().zip(scatter).map(one).collect()
    }
}

/// Random draws of `k` out of `pool`, after the rest.
fn draws(pool: &[usize], k: usize) -> Vec<[Vec<usize>; 2]> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut order = pool.to_vec();
    let one = |_| {
        (0..k).for_each(|i| order.swap(i, rng.random_range(i..pool.len())));
        [order[k..].to_vec(), order[..k].to_vec()]
    };
    (0..DRAWS).map(one).collect()
}

/// Compares the runs to be studied with the baseline.
pub fn compare(bench: &Bench, runs: &[Run]) -> Findings {
    let studied = runs.iter().filter(|r| r.role != Role::Repeat);
    let records: Vec<Record> = studied.filter_map(record).collect();
    let mut f = conclude(&records, bench.rig.linear, bench.rig.lead);
    f.bench = bench.file.clone();
    use BenchChannel as C;
    let opens = [
        (
            C::Current,
            "signed and at 1 kHz: the torque equation, which names effects",
        ),
        (
            C::Position,
            "position error, ripple against the true angle, acceleration",
        ),
        (
            C::UserPosition,
            "with a position at the motor: the transmission equation",
        ),
        (C::Voltage, "with a signed current: the electrical equation"),
        (C::Velocity, "with a position: the kinematic equation"),
    ];
    let missing = opens.iter().filter(|(c, _)| bench.channel(*c).is_none());
    f.missing = missing.map(|(c, opens)| (c.name().into(), opens.to_string())).collect();
    f
}

fn conclude(records: &[Record], linear: bool, lead: Option<f64>) -> Findings {
    let t = Table::new(records, linear);
    let (a, b) = (&t.healthy, &t.state);
    let mut f = Findings {
        not_excited: not_excited(),
        assumptions: ASSUMED.map(String::from).into(),
        ..Default::default()
    };
    let mut fact = |name: &str, value: String| f.facts.push((name.into(), value));
    fact("Runs, baseline and state", format!("{} and {}", a.len(), b.len()));
    if t.cells.is_empty() {
        f.verdict = "unknown".into();
        f.sentence = format!(
            "Nothing can be told: it takes at least {FEWEST} baseline runs and one of the state under the same \
             condition, with steady motion in the command or position."
        );
        return f;
    }
    // the null: the baseline against itself
    let halves = draws(a, a.len() / 2);
    let spread = t.scatter(a);
    let mut nulls: Vec<f64> = halves.iter().map(|[a, b]| t.level(a, b).1.abs()).collect();
    nulls.sort_by(f64::total_cmp);
    let null95 = nulls[DRAWS * 95 / 100];
    let floor: Vec<f64> = halves.iter().map(|[a, b]| rms(&t.level(a, b).0)).collect();
    let shapes = halves.iter().map(|[a, b]| largest(&t.shape(a, b, &spread)));
    let limit = OVER_SHAPE * shapes.fold(0.0, f64::max);
    // the state against the baseline, and against any mixture of both
    let (amps, rise) = t.level(a, b);
    let shape = t.shape(a, b, &spread);
    let pool = [&a[..], &b[..]].concat();
    let wide = t.scatter(&pool);
    let seen = largest(&t.shape(a, b, &wide)) - 1e-9;
    let mixed = draws(&pool, b.len()).into_iter();
    let as_large = mixed.filter(|[a, b]| largest(&t.shape(a, b, &wide)) >= seen).count();
    let chance = (1 + as_large) as f64 / (1 + DRAWS) as f64;
    let far = rise.abs() >= LEAST_RISE.max(OVER_NULL * null95);
    let friction = far && amps.iter().all(|x| *x > 0.0);
    let strange = largest(&shape) > limit && chance <= CHANCE;

    let region = |share: f64, text| Region {
        equation: "comparison".into(),
        share,
        samples: f64::NAN,
        text,
    };
    let energy: f64 = amps.iter().map(|x| x * x).sum();
    for (c, amp) in t.cells.iter().zip(&amps) {
        let (base, (value, lo, hi)) = (c.mean(a), difference(c.of(a), c.of(b)));
        let mut text = format!(
            "{}: {} {:.3} A against {base:.3} A: {value:+.3} A ({lo:+.3} to {hi:+.3}), {:+.1} %",
            c.place,
            FEATURES[MEAN],
            base + value,
            100.0 * value / base
        );
        let mut stills = t
            .shape
            .iter()
            .filter(|s| s.feature == STANDSTILL && s.condition == c.condition);
        if stills.any(|s| (s.mean(a) / base - 1.0).abs() < 0.1) {
            text += "; as at standstill, so that it tells little";
        }
        f.regions.push(region(amp * amp / energy, text));
    }
    let mut order: Vec<usize> = (0..shape.len()).collect();
    order.sort_by(|&i, &j| shape[j].abs().total_cmp(&shape[i].abs()));
    let line = |&i: &usize| {
        let c = &t.shape[i];
        let (scale, unit) = match lead {
            _ if c.feature <= STANDSTILL => (1.0, "A"),
            Some(lead) => (1e3 * lead, "mm"),
            None => (1.0, "rad"),
        };
        let (was, is) = (scale * c.mean(a), scale * c.mean(b));
        let name = FEATURES[c.feature];
        format!(
            "{}: {name} {is:.4} {unit} against {was:.4} {unit} ({:+.1} standard deviations)",
            c.place, shape[i]
        )
    };
    f.regions.extend(order.iter().map(|i| region(f64::NAN, line(i))));
    let level = format!(
        "the mean current at steady speed changed by {:+.1} % (halves of the baseline: up to {:.1} % in 95 of 100)",
        100.0 * rise,
        100.0 * null95
    );
    let told = format!(
        "the largest change of shape is {:.1} standard deviations (counts from {limit:.1}, and a chance of at most \
         {CHANCE}: {chance:.3})",
        largest(&shape)
    );
    fact("Level", level.clone());
    fact("Shape", told.clone());
    let (verdict, sentence) = if friction {
        let rise = |i| mean(t.cells.iter().map(|c| c.values[i] - c.mean(a)));
        let values: Vec<f64> = (0..a.len() + b.len()).map(rise).collect();
        let (value, lo, hi) = difference(a.iter().map(|&i| values[i]), b.iter().map(|&i| values[i]));
        f.retuned.push(Identified {
            name: "coulomb".into(),
            value,
            lo,
            hi,
            unit: "A (supply current)".into(),
            nominal: Some(mean(t.cells.iter().map(|c| c.mean(a)))),
        });
        let cells = amps.len();
        (
            "retune",
            format!(
                "Friction rose by {value:.3} A ({lo:.3} to {hi:.3} A) of supply current, in all {cells} cells: {level}."
            ),
        )
    } else if strange || far {
        (
            "unknown",
            format!("Something changed that an unsigned current cannot name: {level}; {told}."),
        )
    } else {
        (
            "none",
            format!("The state cannot be told from the baseline: {level}; {told}."),
        )
    };
    (f.verdict, f.sentence) = (verdict.into(), sentence);
    if strange {
        let most: Vec<String> = order
            .iter()
            .filter(|&&i| shape[i].abs() > limit)
            .take(5)
            .map(line)
            .collect();
        f.unnamed = Some(format!("The features that changed most: {}", most.join("; ")));
    }
    let common = if friction { mean(amps.iter().copied()) } else { 0.0 };
    let left = rms(&amps.iter().map(|x| x - common).collect::<Vec<_>>());
    f.by_channel.push(ChannelGap {
        channel: BenchChannel::CurrentAbs.name().into(),
        equation: "comparison".into(),
        unit: "A".into(),
        fit: GapLine {
            nominal: rms(&amps),
            retuned: left,
            last: left,
            floor: rms(&floor),
        },
        heldout: None,
    });
    f.profiles = t.cells.iter().map(|c| profile(records, c, lead)).collect();
    f.next_reason =
        "A signed current at 1 kHz with a position opens the torque equation, which can name an effect.".into();
    f
}

/// Mean current along the position in a cell: baseline (`retuned`) and state (`last`).
fn profile(records: &[Record], cell: &Column, lead: Option<f64>) -> Profile {
    let mut samples: Vec<(bool, f64, f64)> = Vec::new();
    for r in records.iter().filter(|r| r.condition == cell.condition) {
        let angle = r.position.or(r.command).unwrap_or_default();
        for s in stretches(r).iter().filter(|s| s.positive == cell.positive) {
            samples.extend(part(&s.all, SETTLED).map(|k| (r.healthy, angle[k], r.current[k])));
        }
    }
    let low = samples.iter().fold(f64::MAX, |m, s| m.min(s.1));
    let span = samples.iter().fold(f64::MIN, |m, s| m.max(s.1)) - low;
    // not narrower than a turn, so that the ripple averages out
    let bins = (span / TAU).clamp(1.0, 24.0).floor();
    let bin = |x: f64| ((x - low) / span * bins).floor().min(bins - 1.0);
    let at = |k: usize, healthy: bool| {
        mean(
            samples
                .iter()
                .filter(|s| s.0 == healthy && bin(s.1) == k as f64)
                .map(|s| s.2),
        )
    };
    let all = 0..bins as usize;
    let (scale, signal_unit) = lead.map_or((1.0, "rad"), |l| (1e3 * l, "mm"));
    Profile {
        equation: format!("comparison ({})", cell.place),
        unit: "A".into(),
        signal: "position".into(),
        signal_unit: signal_unit.into(),
        at: all
            .clone()
            .map(|k| scale * (low + (k as f64 + 0.5) * span / bins))
            .collect(),
        retuned: all.clone().map(|k| at(k, true)).collect(),
        last: all.map(|k| at(k, false)).collect(),
    }
}

fn not_excited() -> Vec<(String, String)> {
    let why = |e| match e {
        Equation::Torque => "unsigned current: no torque equation, only the mean of all friction",
        Equation::Electrical => "unsigned supply current and no phase voltage: no electrical equation",
        Equation::Transmission => "unsigned current, no position on both sides: no transmission equation",
        Equation::Kinematic => "unsigned current, no second sensor of the motion: no kinematic equation",
        Equation::Controller => "unsigned current: the controller's output is not known",
    };
    EffectKind::ALL
        .iter()
        .map(|k| (k.name().into(), why(k.equation()).into()))
        .collect()
}

const ASSUMED: [&str; 4] = [
    "The current is unsigned: direction, offset and a torque in N m cannot be told.",
    "At one speed, viscous friction cannot be told from Coulomb friction, nor either from the drive's losses: all are \
     `coulomb`, in A of supply current. Nothing above half the sampling rate is seen (12.5 Hz at 25 Hz).",
    "A run is the unit: intervals hold the scatter from run to run, not from one assembly of the rig to the next.",
    "Assumed: friction rises from 5 % and three times the 95 % point of the null in all cells; shape changes from 1.5 \
     times the null's largest and a chance of 2 %.",
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Eight runs there and back at 24 mm/s with a lead of 5 mm, at 25 Hz; friction and ripple of the state.
    fn study(friction: f64, ripple: f64) -> Findings {
        let angle: Vec<f64> = (0..325)
            .map(|k| k as f64 / 25.0)
            .map(|s| TAU * 4.8 * (s.min(5.0) - (s - 8.0).max(0.0)))
            .collect();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut current = |healthy: bool| -> Vec<f64> {
            let run = 0.01 * rng.random::<f64>();
            let (friction, ripple) = if healthy { (1.0, 0.01) } else { (friction, ripple) };
            let moving = |k: usize| friction * (0.8 + run) + ripple * angle[k].sin();
            let one = |k: usize| if (125..200).contains(&k) { 0.3 } else { moving(k) };
            (0..325).map(|k| one(k) + 0.02 * rng.random::<f64>()).collect()
        };
        let all: Vec<Vec<f64>> = (0..16).map(|i| current(i < 8)).collect();
        let records = all.iter().enumerate().map(|(i, current)| Record {
            condition: "load 20".into(),
            unit: i.to_string(),
            healthy: i < 8,
            rate_hz: 25.0,
            current,
            command: Some(&angle),
            position: None,
        });
        conclude(&records.collect::<Vec<_>>(), true, Some(0.005 / TAU))
    }

    #[test]
    fn the_same_is_none() {
        let f = study(1.0, 0.01);
        assert_eq!(f.verdict, "none", "{}", f.sentence);
        assert_eq!(
            (f.not_excited.len(), f.by_channel.len(), f.profiles.len()),
            (EffectKind::ALL.len(), 1, 2)
        );
    }

    #[test]
    fn a_tenth_more_friction_is_told_in_amperes() {
        let f = study(1.1, 0.01);
        assert_eq!(f.verdict, "retune", "{}", f.sentence);
        let c = &f.retuned[0];
        assert!(
            c.name == "coulomb" && c.lo < 0.0805 && c.hi > 0.0805 && c.hi - c.lo < 0.02,
            "{c:?}"
        );
    }

    #[test]
    fn more_ripple_is_unknown() {
        let f = study(1.0, 0.04);
        assert_eq!(f.verdict, "unknown", "{}", f.sentence);
        assert!(
            f.unnamed
                .is_some_and(|u| u.contains("load 20, extension: current ripple once a turn 0.0"))
        );
    }
}
