//! The usual mistakes of a bench file, looked for before anything is fitted: units, swapped columns,
//! reversed signs, a machine that never moves. Each is told in one line with its likely cause.

use crate::measured::bench::{Bench, BenchChannel, ChannelSpec, Role};
use crate::measured::filter::FilterBank;
use crate::measured::recording::{Run, extent};
use schemas::error::{Error, Result};

/// Factors that wrong units make, and what they are.
const FACTORS: [(f64, &str); 10] = [
    (1000.0, "a factor of 1000: milli or kilo"),
    (1e6, "a factor of 1e6: micro, or a time in ms"),
    (
        std::f64::consts::TAU,
        "a factor of 2 pi: turns for rad, or Hz for rad/s",
    ),
    (
        6.0,
        "a factor of 6: deg/s for rpm, or degrees and rpm said of rad and rad/s",
    ),
    (60.0, "a factor of 60: per minute for per second"),
    (60.0 / std::f64::consts::TAU, "a factor of 60/(2 pi): rpm for rad/s"),
    (180.0 / std::f64::consts::PI, "a factor of 57.3: degrees for rad"),
    (100.0, "a factor of 100: centi or per cent"),
    (10.0, "a factor of 10"),
    (3600.0, "a factor of 3600: hours for seconds"),
];

/// A ratio is a factor's where it is within this factor of it: parameters are not known better (assumed).
const NEAR: f64 = 1.43;

/// Rows that two windows which meet at a time have in common: the one at that time.
const AT_THE_BORDER: usize = 1;

/// The likely cause of a ratio that should be 1.
///
/// * `gear` ratio of the gear
pub fn cause(ratio: f64, gear: f64) -> String {
    let size = ratio.abs().max(1e-300);
    // how far from it, as a factor, either way
    let away = |f: f64| (size.ln().abs() - f.ln()).abs();
    let near = |f: f64| away(f) < NEAR.ln();
    if gear > 1.5 && near(gear) {
        return format!("a factor of {gear:.4}: the gear ratio (motor side for user side)");
    }
    let nearest = FACTORS.iter().min_by(|a, b| away(a.0).total_cmp(&away(b.0)));
    match nearest.filter(|(f, _)| near(*f)) {
        Some((_, text)) => (*text).to_string(),
        None => "unit or scale".to_string(),
    }
}

/// Slope of `y` on `x`, and their correlation.
fn slope(x: &[f64], y: &[f64]) -> (f64, f64) {
    let n = x.len().min(y.len()) as f64;
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for (x, y) in x.iter().zip(y) {
        xx += (x - mx) * (x - mx);
        xy += (x - mx) * (y - my);
        yy += (y - my) * (y - my);
    }
    (xy / xx.max(1e-300), xy / (xx * yy).sqrt().max(1e-300))
}

/// What of `x` is not a multiple of `of`.
fn without(x: &[f64], of: &[f64]) -> Vec<f64> {
    let (g, _) = slope(of, x);
    x.iter().zip(of).map(|(x, o)| x - g * o).collect()
}

/// Span of a motion channel up to which a machine stands still: a few grains of its sensor.
fn still(c: BenchChannel, spec: &ChannelSpec) -> f64 {
    if c == BenchChannel::Position {
        (5.0 * spec.resolution).max(1e-9)
    } else {
        1e-9
    }
}

/// Whether the machine moves in a run, by its angle.
pub fn moves(bench: &Bench, run: &Run) -> bool {
    let c = BenchChannel::Position;
    run.channel(c).zip(bench.channel(c)).is_none_or(|(x, spec)| {
        let (low, high) = extent(x.iter().copied());
        high - low > still(c, spec)
    })
}

/// Checks all runs of a bench.
pub fn check(bench: &Bench, runs: &[Run]) -> Result<()> {
    use BenchChannel as C;
    let rate = runs[0].rate_hz;
    for (i, a) in runs.iter().enumerate() {
        let proves = |r: &Run| r.role == Role::HeldOut;
        let finds = |r: &Run| matches!(r.role, Role::Fit | Role::Select);
        let against = |b: &&Run| b.hash == a.hash && (proves(a) && finds(b) || proves(b) && finds(a));
        for b in runs[..i].iter().filter(against) {
            let is_common = |r: &usize| b.rows.binary_search(r).is_ok();
            let common: Vec<usize> = a.rows.iter().copied().filter(is_common).collect();
            if common.len() > AT_THE_BORDER {
                let (first, last) = (common[0] + 1, common[common.len() - 1] + 1);
                let found = format!(
                    "{} rows ({first} to {last} of the file) that stand in {} too, with the role {}",
                    common.len(),
                    b.name,
                    b.role.name()
                );
                let allowed =
                    "rows that prove what others found: windows that do not overlap, but for one row where they meet";
                return Err(Error::bad(&a.name, format!("role {}", a.role.name()), found, allowed));
            }
        }
    }
    for run in runs.iter().filter(|r| !r.steady) {
        let file = &run.name;
        let column = |c: C| {
            bench.channel(c).map_or_else(String::new, |s| {
                format!("channel `{}`, column `{}`", c.name(), s.column)
            })
        };
        if (run.rate_hz / rate - 1.0).abs() > 0.02 {
            let found = format!("{:.3} Hz where {} has {rate:.3} Hz", run.rate_hz, runs[0].name);
            return Err(Error::bad(
                file,
                column(C::Time),
                found,
                "one sampling rate in all runs",
            ));
        }
        let range = |x: &[f64]| extent(x.iter().copied());
        for c in [C::Position, C::Velocity] {
            if let (Some(x), Some(spec)) = (run.channel(c), bench.channel(c)) {
                let (low, high) = range(x);
                if high - low <= still(c, spec) {
                    let found = format!("{low:e} to {high:e} over the whole run: it never moves");
                    return Err(Error::bad(file, column(c), found, "a run in which the actuator moves"));
                }
            }
        }
        if let Some(t) = run.channel(C::Temperature) {
            let (low, high) = range(t);
            if low < -80.0 || high > 350.0 {
                let found = format!("{low:.1} to {high:.1} degC (likely cause: kelvin, or another column)");
                return Err(Error::bad(file, column(C::Temperature), found, "-80 to 350 degC"));
            }
        }
        // a short piece of a run may hardly move: its sensors need not agree
        if run.duration_s() < 1.0 {
            continue;
        }
        let smooth = FilterBank::new(0.03 * rate, rate, 0.0);
        let gear = bench.rig.gear_ratio;
        let speed = run.channel(C::Position).map(|x| smooth.whole(1, x));
        if let (Some(s), Some(w)) = (&speed, run.channel(C::Velocity)) {
            let w = smooth.whole(0, w);
            let (g, r) = slope(s, &w);
            // a speed that hardly changes has nothing to correlate with
            let (low, high) = range(s);
            let changes = high - low > 0.3 * (high.abs() + low.abs());
            if changes && r.abs() < 0.3 {
                let found =
                    format!("a correlation of {r:.2} with the speed of the position (likely cause: swapped columns)");
                return Err(Error::bad(
                    file,
                    column(C::Velocity),
                    found,
                    "the velocity that belongs to the position",
                ));
            }
            if changes && !(0.5..2.0).contains(&g) {
                let why = if g < 0.0 && (0.5..2.0).contains(&-g) {
                    "reversed sign".into()
                } else {
                    cause(g, gear)
                };
                let found = format!(
                    "{g:.4} times the speed of the position (likely cause: {why}, of position, velocity or time)"
                );
                return Err(Error::bad(file, column(C::Velocity), found, "0.5 to 2 times"));
            }
        }
        for (c, least) in [(C::UserPosition, 0.8), (C::Command, 0.9)] {
            // what lags behind its command says nothing in a short time
            if c == C::Command && run.duration_s() < 1.5 {
                continue;
            }
            let (Some(x), Some(p)) = (run.channel(c), run.channel(C::Position)) else {
                continue;
            };
            let (g, r) = slope(x, p);
            if c == C::UserPosition && r.abs() < 0.5 {
                let found = format!("a correlation of {r:.2} with the position (likely cause: swapped columns)");
                return Err(Error::bad(file, column(c), found, "the user's side of the same motion"));
            }
            if r.abs() > least && !(0.4..2.5).contains(&g) {
                let why = if g < 0.0 {
                    "reversed sign".into()
                } else {
                    cause(g, gear)
                };
                let found = format!(
                    "the motor's position is {g:.4} times it (likely cause: {why}, of {} or position)",
                    c.name()
                );
                return Err(Error::bad(
                    file,
                    column(c),
                    found,
                    "0.4 to 2.5 times, both brought to the motor",
                ));
            }
        }
        if let (Some(v), Some(w), Some(i)) = (
            run.channel(C::Voltage),
            speed.as_ref().or(run.channel(C::Velocity).map(|x| x.to_vec()).as_ref()),
            run.channel(C::Current),
        ) && bench.rig.drive == C::Current
        {
            // what the winding's resistance takes follows the speed too, where friction brakes
            let i = smooth.whole(0, i);
            let (g, r) = slope(&without(w, &i), &without(&smooth.whole(0, v), &i));
            let ratio = g / bench.rig.back_emf.value;
            if bench.rig.back_emf.value > 0.0 && r.abs() > 0.7 && !(0.2..5.0).contains(&ratio) {
                let why = if ratio < 0.0 {
                    "reversed sign".into()
                } else {
                    cause(ratio, gear)
                };
                let found =
                    format!("{ratio:.4} times what the back-EMF makes (likely cause: {why}, of voltage or speed)");
                return Err(Error::bad(file, column(C::Voltage), found, "0.2 to 5 times"));
            }
        }
    }
    // all that comes from one file together: a piece of it may be nothing but braking
    let mut files: Vec<&str> = runs.iter().map(|r| r.hash.as_str()).collect();
    files.dedup();
    for hash in files {
        let moving = |r: &&Run| !r.steady && r.role != Role::Baseline;
        let (own, others): (Vec<&Run>, Vec<&Run>) = runs.iter().filter(moving).partition(|r| r.hash == hash);
        drive(bench, &own, &others)?;
    }
    Ok(())
}

/// A straight fit of inertia, viscous and dry friction and a constant to smoothed signals.
#[derive(Clone, Copy)]
struct Straight {
    /// coefficients of the terms
    x: nalgebra::Vector4<f64>,
    /// products of the terms
    g: nalgebra::Matrix4<f64>,
    /// of the terms and the torque
    r: nalgebra::Vector4<f64>,
    /// of the torque
    energy: f64,
}

impl Straight {
    /// Share of the torque's energy that a term makes.
    fn share(&self, term: usize) -> f64 {
        self.x[term].powi(2) * self.g[(term, term)] / self.energy.max(1e-300)
    }
}

/// * `corner` of the smoothing, as a share of the sampling rate
/// * `scale` of the terms of inertia, viscous and dry friction
///
/// `None` where a channel is missing or the fit has no solution.
fn straight(bench: &Bench, runs: &[&Run], corner: f64, scale: [f64; 3]) -> Option<Straight> {
    straight_where(bench, runs, corner, scale, f64::INFINITY)
}

/// The same where the drive signal is at most `most`.
fn straight_where(bench: &Bench, runs: &[&Run], corner: f64, scale: [f64; 3], most: f64) -> Option<Straight> {
    use BenchChannel as C;
    let rig = &bench.rig;
    let mut g = nalgebra::Matrix4::<f64>::zeros();
    let mut r = nalgebra::Vector4::<f64>::zeros();
    let mut energy = 0.0;
    for run in runs {
        let smooth = FilterBank::new(corner * run.rate_hz, run.rate_hz, 0.0);
        let u = smooth.whole(0, run.channel(rig.drive)?);
        let (w, a) = match (run.channel(C::Position), run.channel(C::Velocity)) {
            (Some(x), _) => (smooth.whole(1, x), smooth.whole(2, x)),
            (None, Some(w)) => (smooth.whole(0, w), smooth.whole(1, w)),
            _ => return None,
        };
        let load = run.channel(C::Load).map(|x| smooth.whole(0, x));
        let fastest = w.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        // moving clearly: friction has its sign, and standing samples tell nothing; nothing was measured in a gap
        let reach = smooth.half();
        let near_gap = |k: usize| {
            let around = run.lost.iter().skip(k.saturating_sub(reach)).take(2 * reach + 1);
            around.into_iter().any(|l| *l)
        };
        for k in (0..w.len()).filter(|&k| w[k].abs() > 0.03 * fastest && u[k].abs() <= most && !near_gap(k)) {
            let x = nalgebra::Vector4::new(a[k] * scale[0], w[k] * scale[1], w[k].signum() * scale[2], 1.0);
            let y = u[k] * rig.drive_constant.value - load.as_ref().map_or(0.0, |l| l[k]);
            g += x * x.transpose();
            r += x * y;
            energy += y * y;
        }
    }
    let norm = nalgebra::Vector4::from_fn(|i, _| g[(i, i)].sqrt().max(1e-300));
    let unit = nalgebra::Matrix4::from_fn(|i, j| g[(i, j)] / (norm[i] * norm[j]) + if i == j { 1e-9 } else { 0.0 });
    let x = unit.cholesky()?.solve(&r.component_div(&norm)).component_div(&norm);
    Some(Straight { x, g, r, energy })
}

/// Inertia, viscous and dry friction of nobody's knowledge: a place to begin.
pub fn rough(bench: &Bench, runs: &[&Run]) -> Option<[f64; 3]> {
    let Straight { x, g, energy, .. } = straight(bench, runs, WIDE, [1.0; 3])?;
    // a spring turns the sign of an inertia, or it makes too little of the torque: none would leave no equation
    let little = LITTLE * (energy / g[(0, 0)].max(1e-300)).sqrt();
    Some([if x[0] > 0.0 { x[0] } else { little }, x[1], x[2]])
}

/// Share of the torque that an inertia has to begin with where none is seen (assumed).
const LITTLE: f64 = 0.01;

/// Corners of the smoothing, as shares of the sampling rate.
const WIDE: f64 = 0.03;
const NARROW: f64 = 0.008;

/// The drive signal against the torque that the nominal constants ask for, over the runs of a file.
///
/// * `others` those of the other files
fn drive(bench: &Bench, runs: &[&Run], others: &[&Run]) -> Result<()> {
    drive_at(bench, runs, others, WIDE)?.map_or(Ok(()), |wide| {
        // noise of the acceleration shrinks an inertia, the less the narrower the band
        drive_at(bench, runs, others, NARROW)?.map_or(Ok(()), |_| Err(wide))
    })
}

/// Share of the torque's energy from which an inertia tells something (assumed).
const TOLD: f64 = 0.02;

/// Share of the torque's energy from which friction is seen to brake (assumed).
const BRAKED: f64 = 0.1;

/// Share of the torque's energy that no other term explains from which friction is told from a weight (assumed).
const TELLS: f64 = 0.1;

/// Share of the strongest drive signal up to which no torque saturates (assumed).
const WEAK: f64 = 0.5;

/// Share of the torque's energy that a straight fit leaves where something else goes with the acceleration (assumed).
const MUCH_LEFT: f64 = 0.1;

/// Cosine between torque and speed from which the drive is seen to do work (assumed): a spring and an inertia take none.
const WORKS: f64 = 0.05;

/// The mistake that is seen with a corner at this share of the sampling rate.
fn drive_at(bench: &Bench, runs: &[&Run], others: &[&Run], corner: f64) -> Result<Option<Error>> {
    use BenchChannel as C;
    let rig = &bench.rig;
    let (Some(spec), Some(run)) = (bench.channel(rig.drive), runs.first()) else {
        return Ok(None);
    };
    let place = format!("channel `{}`, column `{}`", rig.drive.name(), spec.column);
    if let Some(run) = runs
        .iter()
        .find(|r| r.channel(C::Position).or(r.channel(C::Velocity)).is_none())
    {
        let found = "neither position nor velocity";
        return Err(Error::bad(&run.name, "channels", found, "one of them"));
    }
    let scale = [rig.inertia.value, rig.viscous.value, rig.coulomb.value].map(|x| x.max(1e-12));
    let Some(fit) = straight(bench, runs, corner, scale) else {
        return Ok(None);
    };
    let share = |term: usize| fit.share(term);
    let Straight { x, g, r, energy } = fit;
    let (told, frictional) = (share(0) > TOLD, share(2));
    // an axis that mostly goes one way cannot tell friction from weight: what friction alone explains decides there
    let by_itself = g.try_inverse().map_or(0.0, |v| 1.0 / v[(2, 2)].max(1e-300));
    let by_friction = x[2] * x[2] * by_itself / energy.max(1e-300);
    // nobody's sign or unit makes an inertia negative and leaves a friction that brakes: a spring does
    let braked: f64 = [1, 2].iter().map(|t| x[*t].signum() * share(*t)).sum();
    let works = r[1] > WORKS * (g[(1, 1)] * energy).sqrt();
    if x[0] < 0.0 && (braked > BRAKED || works) {
        return Ok(None);
    }
    if (told && x[0] < 0.0 && (x[2] < 0.0 || frictional < 0.05))
        || (x[2] < 0.0 && frictional > 0.2 && by_friction > TELLS && (x[0] < 0.0 || !told))
    {
        let found = "a torque against the motion (likely cause: reversed sign of the drive signal or of the position)";
        let allowed = "torque, speed and position of one sense";
        return Ok(Some(Error::bad(&run.name, place, found, allowed)));
    }
    let alike = |ratio: f64| (0.25..4.0).contains(&ratio);
    if told && rig.inertia.value > 0.0 && rig.inertia.trust != Some(0.0) && !alike(x[0]) {
        let ratio = x[0];
        // a unit is the same at any current; a torque that saturates makes much of the inertia at strong ones alone
        let drive = runs.iter().filter_map(|r| r.channel(rig.drive)).flatten();
        let strongest = drive.fold(0.0, |m: f64, u| m.max(u.abs()));
        let weak = straight_where(bench, runs, corner, scale, WEAK * strongest);
        if weak.is_some_and(|w| alike(w.x[0]) && w.share(0) > TOLD) {
            return Ok(None);
        }
        // what goes with the acceleration in this file alone, and leaves much of its torque, is an effect
        let left = 1.0 - x.dot(&r) / energy.max(1e-300);
        let of_others = straight(bench, others, corner, scale);
        if left > MUCH_LEFT && (0.1..10.0).contains(&ratio) && of_others.is_some_and(|o| alike(o.x[0])) {
            return Ok(None);
        }
        let same = rig.coulomb.value > 0.0 && (0.4..2.5).contains(&(x[2] / ratio));
        let of = if same {
            "of the drive signal or its constant"
        } else {
            "of position or time, or of the inertia"
        };
        let found = format!(
            "an inertia of {ratio:.4} times the nominal one (likely cause: {}, {of})",
            cause(if same { ratio } else { 1.0 / ratio }, rig.gear_ratio)
        );
        return Ok(Some(Error::bad(&run.name, place, found, "0.25 to 4 times")));
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measured::prescribed::{INERTIA, rig};
    use crate::measured::recording::read_runs;
    use std::fmt::Write;

    #[test]
    fn a_stiff_spring_is_no_reversed_sign() {
        let (bench, runs) = rig(|_, [_, x, ..]| 0.25 * x);
        let fit = straight(&bench, &[&runs[0]], NARROW, [INERTIA, 1.0, 1.0]).unwrap();
        let inertial = fit.x[0] * fit.x[0] * fit.g[(0, 0)] / fit.energy;
        assert!(fit.x[0] < 0.0 && inertial > 0.02, "{} {inertial}", fit.x[0]);
        check(&bench, &runs).unwrap();
        // one that leaves hardly anything for friction neither
        let (bench, runs) = rig(|_, [_, x, ..]| 1.5 * x);
        let braked = drive_at(&bench, &[&runs[0]], &[], NARROW).unwrap();
        assert!(braked.is_none(), "{braked:?}");
        check(&bench, &runs).unwrap();
        let (bench, runs) = rig(|_, [_, x, _, _, torque]| -2.0 * torque - 1.5 * x);
        assert!(check(&bench, &runs).is_err());
        // a reversed sign is one
        let (bench, runs) = rig(|_, [_, _, _, _, torque]| -2.0 * torque);
        let said = check(&bench, &runs).unwrap_err().to_string();
        assert!(said.contains("reversed sign"), "{said}");
    }

    /// A torque that saturates makes much of the inertia at strong signals alone; another unit makes it at any.
    #[test]
    fn a_torque_that_saturates_is_no_other_unit() {
        // the inertia that is seen grows with the square of the acceleration
        let (bench, runs) = rig(|_, [.., a, _]| INERTIA * a * (a / 60.0).powi(2));
        let seen = |most: f64| {
            let fit = straight_where(&bench, &[&runs[1]], NARROW, [INERTIA, 1.0, 1.0], most);
            fit.unwrap().x[0]
        };
        let strongest = runs[1]
            .channel(BenchChannel::Torque)
            .unwrap()
            .iter()
            .fold(0.0, |m: f64, x| m.max(x.abs()));
        assert!(
            seen(strongest) > 4.0 && seen(WEAK * strongest) < 4.0,
            "{} {}",
            seen(strongest),
            seen(WEAK * strongest)
        );
        check(&bench, &runs).unwrap();
        let (bench, runs) = rig(|_, [.., a, _]| 5.0 * INERTIA * a);
        let said = check(&bench, &runs).unwrap_err().to_string();
        assert!(said.contains("a factor of 6"), "{said}");
        // nor is one of a file's own that goes with the acceleration for a part, unless little else is in it
        for (rest, alone, refused) in [(0.5, true, false), (0.5, false, true), (0.01, true, true)] {
            let (bench, runs) = rig(|run, [_, x, _, a, _]| {
                let here = run == 1 || !alone;
                if here {
                    5.0 * INERTIA * a + rest * (9.0 * x).sin()
                } else {
                    0.0
                }
            });
            assert_eq!(check(&bench, &runs).is_err(), refused, "{rest} {alone}");
        }
    }

    /// A motor whose dry friction takes most of its voltage over a small resistance, recorded with another unit of it.
    fn winding(unit_of_voltage: f64) -> Result<()> {
        let dir = tempfile::tempdir().unwrap();
        let mut csv = "t,x,i,v\n".to_string();
        for k in 0..4000 {
            let t = f64::from(k) * 1e-3;
            let (x, w) = (1.0 - (3.0 * t).cos(), 3.0 * (3.0 * t).sin());
            let current = 1.5 * w.signum() + 0.05 * w + 0.1 * (40.0 * t).sin();
            let voltage = unit_of_voltage * (2.0 * current + 0.3 * w);
            writeln!(csv, "{t:.4},{x:.7},{current:.5},{voltage:.5}").unwrap();
        }
        std::fs::write(dir.path().join("run.csv"), csv).unwrap();
        let bench = dir.path().join("bench.toml");
        let text = "[rig]\nkind = \"rotary\"\ndrive = \"current\"\ndrive_constant = { value = 0.3, unit = \"N m/A\" }\n\
             inertia = { value = 0.01, unit = \"kg m2\" }\nviscous = { value = 0.015, unit = \"N m s/rad\" }\n\
             coulomb = { value = 0.45, unit = \"N m\" }\n[channels]\ntime = { column = \"t\", unit = \"s\" }\n\
             position = { column = \"x\", unit = \"rad\" }\ncurrent = { column = \"i\", unit = \"A\" }\n\
             voltage = { column = \"v\", unit = \"V\" }\n[[run]]\nfile = \"run.csv\"\nrole = \"fit\"\n";
        std::fs::write(&bench, text).unwrap();
        let bench = Bench::read(&bench, None).unwrap();
        check(&bench, &read_runs(&bench).unwrap())
    }

    #[test]
    fn what_the_resistance_takes_is_no_back_emf() {
        winding(1.0).unwrap();
        let said = winding(1000.0).unwrap_err().to_string();
        assert!(said.contains("what the back-EMF makes"), "{said}");
    }

    #[test]
    fn prop_the_nearest_factor_is_the_likely_cause() {
        for (ratio, words) in [
            (6.0, "factor of 6:"),
            (1.0 / 6.0, "factor of 6:"),
            (6.25, "2 pi"),
            (9.55, "60/(2 pi)"),
            (57.0, "57.3"),
            (60.0, "per minute"),
            (-1100.0, "1000"),
            (500.0, "gear ratio"),
            (20.0, "unit or scale"),
        ] {
            assert!(cause(ratio, 500.0).contains(words), "{ratio}: {}", cause(ratio, 500.0));
        }
    }
}
