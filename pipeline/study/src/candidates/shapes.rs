//! Where the search for an effect's shape starts, how it goes on, and where physics ends it.

use crate::candidates::bristles::STATIC;
use crate::candidates::phases::{BRIDGED, LEGS, WARM};
use crate::candidates::springs::{self, BY_TORQUE};
use crate::equations::pieces::RigConstants;
use crate::equations::signals::Signals;
use crate::measured::filter::FilterBank;
use crate::measured::recording::extent;
use sim_worker::effect::EffectKind;
use std::f64::consts::TAU;

/// Whether what it adds repeats with the rotor's angle in an order of the turn that is looked for.
pub fn has_order(kind: EffectKind) -> bool {
    kind.keys().iter().any(|k| k.name == "order")
}

/// From one to another in equal steps of the logarithm.
fn log(from: f64, to: f64, n: usize) -> Vec<f64> {
    (0..n)
        .map(|i| from * (to / from).powf(i as f64 / (n - 1) as f64))
        .collect()
}

/// Frequencies from and, over the rate of a recording, to which loads are looked for that the measured motion drives without its noise
/// [Hz], and the steps between (assumed).
const SLOWEST_HZ: f64 = 4.0;
const SLOW_OF_RATE: f64 = 0.02;
const SLOW_STEP: f64 = 1.27;

/// Frequencies of loads on slow springs [Hz].
fn slow(rate: f64) -> impl Iterator<Item = f64> {
    let faster = |f: &f64| Some(f * SLOW_STEP);
    std::iter::successors(Some(SLOWEST_HZ), faster).take_while(move |f| *f < SLOW_OF_RATE * rate)
}

/// Springs to start from that only the torque shows: a resonance is as narrow as its damping.
pub fn unseen_springs(runs: &[Signals], c: &RigConstants) -> Vec<Vec<f64>> {
    let (low, high) = extent(runs.iter().flat_map(|r| &r.theta).copied());
    if low == high {
        return vec![];
    }
    let rate = runs[0].rate_hz;
    let shares = |f: f64| [0.15, 0.35, 0.6].map(|share| tuned(f, share * c.inertia));
    let of = |f: &f64, dull: f64| {
        let dulled = |[stiffness, damping, inertia]: [f64; 3]| springs::by_torque([stiffness, dull * damping, inertia]);
        shares(*f).map(dulled)
    };
    let mut out: Vec<Vec<f64>> = log(0.004 * rate, 0.09 * rate, 14)
        .iter()
        .flat_map(|f| of(f, 1.0))
        .collect();
    // what swings slowly shows in the motion, and a torque that is not known whole would carry it away
    if runs.iter().all(|r| r.phases.is_none()) {
        out.extend(slow(rate).flat_map(shares).map(springs::by_motion));
    }
    // torques that are on time show a dull one, and one that is faster
    if runs.iter().all(Signals::on_time) {
        out.extend(log(0.02 * rate, 0.15 * rate, 6).iter().flat_map(|f| of(f, DULL)));
    }
    out
}

/// Shapes to start from for a kind, over the range of the signals of the fit runs.
pub fn grid(kind: EffectKind, runs: &[Signals], c: &RigConstants) -> Vec<Vec<f64>> {
    let all = |f: fn(&Signals) -> &Vec<f64>| runs.iter().flat_map(move |r| f(r).iter().copied());
    let (low, high) = extent(all(|s| &s.theta));
    let fastest = all(|s| &s.omega).fold(0.0, |a: f64, x| a.max(x.abs()));
    let stroke = high - low;
    let one = |v: Vec<f64>| -> Vec<Vec<f64>> { v.into_iter().map(|x| vec![x]).collect() };
    match kind {
        // without an angle nothing goes with it
        EffectKind::Eccentricity
        | EffectKind::EncoderEccentricity
        | EffectKind::SpringLoad
        | EffectKind::ControlDelay
        | EffectKind::TurnShort
            if stroke == 0.0 =>
        {
            vec![]
        }
        EffectKind::Stribeck => {
            let speeds = log(1e-3 * fastest, 0.4 * fastest, 9);
            speeds.iter().flat_map(|&w| [1.0, 2.0].map(|d| vec![w, d])).collect()
        }
        EffectKind::LubricatedRise => one(log(1e-3 * fastest, 0.3 * fastest, 9)),
        EffectKind::TightSpot if stroke > 0.0 => {
            let mut out = Vec::new();
            for width in [0.02, 0.05, 0.12, 0.3] {
                let n = ((0.8 / width) as usize).max(8);
                out.extend((0..=n).map(|i| vec![low + stroke * i as f64 / n as f64, width * stroke]));
            }
            out
        }
        EffectKind::PeriodicFriction | EffectKind::Cogging | EffectKind::TorqueRipple => {
            // at least one whole period within the stroke
            let orders = [0.5].into_iter().chain((1..=24).map(f64::from));
            one(orders.filter(|n| n * stroke > 1.2 * TAU).collect())
        }
        EffectKind::Presliding if stroke > 0.0 => one(log(1e-5 * stroke.max(1.0), 0.05 * stroke, 9)),
        EffectKind::CommutationOffset if stroke > 0.0 => {
            let angles = [-0.7, -0.45, -0.25, -0.12, 0.12, 0.25, 0.45, 0.7];
            angles.iter().flat_map(|&a| [0.0, 1.0].map(|f| vec![a, f])).collect()
        }
        EffectKind::Presliding | EffectKind::CommutationOffset | EffectKind::TightSpot | EffectKind::Compliance
            if stroke == 0.0 =>
        {
            vec![]
        }
        EffectKind::Backlash => {
            let free = 1.0 / (0.5 * c.inertia);
            let mut gaps = log(1e-5 * stroke, 0.1 * stroke, 12);
            gaps.extend(parted(runs));
            // its own share of friction and inertia, more or less of either; or nothing but the play
            let usual = c.effect.coulomb / c.inertia;
            let of = |&g: &f64| {
                let slow = [3.0, 1.0, 0.3].map(|of| vec![g, of * usual, free, BOUNCE]);
                [vec![g, STOPS_AT_ONCE, 0.0]].into_iter().chain(slow)
            };
            gaps.iter().flat_map(of).collect()
        }
        EffectKind::Compliance => {
            let rate = runs[0].rate_hz;
            let mut out = Vec::new();
            if let Some((k, j)) = deflected(runs) {
                for share in [0.02, 0.1, 0.4] {
                    out.push(vec![k, share * (k * j).sqrt(), j]);
                }
            }
            for corner in CORNERS {
                if let Some((natural, slowing)) = swinging(runs, corner * rate) {
                    for share in [0.1, 0.25, 0.45, 0.7] {
                        let j = share * c.inertia;
                        out.push(vec![j * natural * natural, j * slowing, j]);
                    }
                }
            }
            for f in log(0.004 * rate, 0.12 * rate, 8) {
                out.extend([0.25, 0.6].map(|share| tuned(f, share * c.inertia).to_vec()));
            }
            out
        }
        // the torque alone, or the flux, about the strongest current
        EffectKind::TorqueSaturation if runs.iter().all(|r| r.phases.is_some()) => vec![vec![], vec![strongest(runs)]],
        EffectKind::TorqueSaturation => vec![vec![], SQUARE.to_vec()],
        EffectKind::TurnShort if runs.iter().all(|r| r.phases.is_some()) => [0.0, 1.0, 2.0]
            .into_iter()
            .flat_map(|q| [vec![q], vec![q, BRIDGED]])
            .collect(),
        EffectKind::TurnShort => one(vec![0.0, 1.0, 2.0]),
        // a speed sensor of its own, or the speed of the same angle
        EffectKind::EncoderEccentricity if runs.iter().all(|r| r.velocity.is_some()) => one(vec![0.0, 1.0]),
        EffectKind::EncoderEccentricity => one(vec![0.0]),
        EffectKind::SupplySag if runs.iter().all(|r| r.phases.is_some()) => one(vec![0.0, LEGS]),
        // the supply is measured, and the voltage of the winding as it is or as it was asked for; or the latter alone
        EffectKind::SupplySag if runs.iter().all(|r| r.supply.is_some()) => one(vec![0.0, 1.0]),
        EffectKind::SupplySag => one(vec![2.0]),
        EffectKind::DeadTime if runs.iter().all(|r| r.phases.is_some()) => one(log(0.02, 0.16, 4)),
        // of the current of nine samples in ten
        EffectKind::DeadTime => {
            let mut sizes: Vec<f64> = all(|s| &s.drive).map(f64::abs).collect();
            let order = sizes.len() * 9 / 10;
            let usual = *sizes.select_nth_unstable_by(order, f64::total_cmp).1;
            one(log((0.003 * usual).max(1e-9), (0.3 * usual).max(2e-9), 5))
        }
        EffectKind::CurrentOffset if runs.iter().all(|r| r.phases.is_some()) => one(vec![0.0, 1.0, 2.0]),
        EffectKind::CurrentOffset => one(vec![0.0]),
        // of all three at once it is all constants together
        EffectKind::CurrentGain if runs.iter().all(|r| r.phases.is_some()) => one(vec![0.0, 1.0, 2.0]),
        EffectKind::WindingHeating if runs.iter().all(|r| r.phases.is_some()) => one(vec![WARM]),
        EffectKind::WindingHeating if runs.iter().all(|r| r.temperature.is_some()) => one(vec![0.0, WARM]),
        EffectKind::WindingHeating => {
            let slow = [1.0, 2.0].map(|by| vec![by, 1e3]);
            let quick = [1.0, 2.0].iter().flat_map(|&by| [0.2, 0.6].map(|t| vec![by, t]));
            slow.into_iter().chain(quick).chain([vec![WARM]]).collect()
        }
        EffectKind::ControlDelay => one(log(0.2 / runs[0].rate_hz, 40.0 / runs[0].rate_hz, 10)),
        _ => vec![vec![]],
    }
}

/// Slowing of a load that never runs on by itself in its play [rad/s2].
pub const STOPS_AT_ONCE: f64 = 1e6;
/// Share of its speed with which a load bounces off, to begin with.
const BOUNCE: f64 = 0.3;

/// The strongest current [A].
pub fn strongest(runs: &[Signals]) -> f64 {
    runs.iter().flat_map(|r| &r.drive).fold(0.0, |a: f64, x| a.max(x.abs()))
}

/// How far user and motor part company, but for the fewest samples [rad].
fn parted(runs: &[Signals]) -> Option<f64> {
    const FEW: usize = 100;
    let of = |s: &Signals| -> Option<f64> {
        let user = s.user.as_ref()?;
        let mut ahead: Vec<f64> = user.iter().zip(&s.position).map(|(u, p)| u - p).collect();
        ahead.sort_by(f64::total_cmp);
        Some(ahead[s.n - 1 - s.n / FEW] - ahead[s.n / FEW])
    };
    runs.iter()
        .map(of)
        .try_fold(0.0, |a: f64, x| Some(a.max(x?)))
        .filter(|x| *x > 0.0)
}

/// Corners of the filters behind which a deflection's own swing is looked for, over the rate (assumed).
const CORNERS: [f64; 3] = [0.06, 0.015, 0.004];

/// Natural frequency [rad/s] and damping over inertia [1/s] of a load on a spring, from the measured deflection:
/// `x'' + theta'' = -slowing x' - natural^2 x`, less drag, dry friction and load, by least squares behind one filter.
fn swinging(runs: &[Signals], corner_hz: f64) -> Option<(f64, f64)> {
    const COLUMNS: usize = 6;
    let mut gram = nalgebra::DMatrix::<f64>::zeros(COLUMNS, COLUMNS);
    let mut right = nalgebra::DVector::<f64>::zeros(COLUMNS);
    for s in runs {
        let user = s.user.as_ref()?;
        let bank = FilterBank::new(corner_hz, s.rate_hz, 0.0);
        let x: Vec<f64> = user.iter().zip(&s.position).map(|(u, p)| u - p).collect();
        let reach = bank.half();
        if s.n < 4 * reach {
            continue;
        }
        let of = |order: usize, x: &[f64]| bank.whole(order, x);
        let (x0, x1, x2) = (of(0, &x), of(1, &x), of(2, &x));
        let (w, a) = (of(1, &s.position), of(2, &s.position));
        let (sign, load) = (of(0, &s.sign), of(0, &s.load));
        for k in reach..s.n - reach {
            let row = [-x1[k], -x0[k], -w[k], -sign[k], -load[k], 1.0];
            for i in 0..COLUMNS {
                right[i] += row[i] * (x2[k] + a[k]);
                (0..COLUMNS).for_each(|j| gram[(i, j)] += row[i] * row[j]);
            }
        }
    }
    // columns that are nothing stay out
    let scale: Vec<f64> = (0..COLUMNS).map(|i| gram[(i, i)].sqrt().max(1e-300)).collect();
    for i in 0..COLUMNS {
        right[i] /= scale[i];
        (0..COLUMNS).for_each(|j| gram[(i, j)] /= scale[i] * scale[j]);
        gram[(i, i)] += 1e-12;
    }
    let found = gram.cholesky()?.solve(&right);
    let (slowing, natural) = (found[0] / scale[0], found[1] / scale[1]);
    (natural > 0.0 && natural.is_finite() && slowing.is_finite()).then(|| {
        let natural = natural.sqrt();
        (natural, slowing.clamp(0.02 * natural, 2.0 * natural))
    })
}

/// Stiffness, damping and inertia of a load that swings at `f` [Hz] on a motor that stands.
fn tuned(f: f64, inertia: f64) -> [f64; 3] {
    let stiffness = inertia * (TAU * f).powi(2);
    [stiffness, 0.1 * (stiffness * inertia).sqrt(), inertia]
}

/// Damping of a dull spring over that of [`tuned`].
const DULL: f64 = 5.0;

/// Stiffness and load inertia from the measured deflection, as a spring without dynamics shows it.
fn deflected(runs: &[Signals]) -> Option<(f64, f64)> {
    let mut g = [[0.0; 2]; 2];
    let mut r = [0.0; 2];
    for s in runs {
        let user = s.user.as_ref()?;
        let smooth = |x: &[f64], k: usize| x[k - 4..=k + 4].iter().sum::<f64>() / 9.0;
        let mean = (4..s.n - 4).map(|k| user[k] - s.position[k]).sum::<f64>() / (s.n - 8) as f64;
        for k in 4..s.n - 4 {
            let v = [smooth(&s.accel, k), smooth(&s.load, k)];
            let y = mean - (user[k] - s.position[k]);
            for i in 0..2 {
                r[i] += v[i] * y;
                for j in 0..2 {
                    g[i][j] += v[i] * v[j];
                }
            }
        }
    }
    let det = g[0][0] * g[1][1] - g[0][1] * g[1][0];
    let (a, b) = if det > 1e-9 * g[0][0] * g[1][1] {
        (
            (r[0] * g[1][1] - r[1] * g[0][1]) / det,
            (r[1] * g[0][0] - r[0] * g[0][1]) / det,
        )
    } else {
        return None;
    };
    (a > 0.0 && b > 0.0).then(|| (1.0 / b, a / b))
}

/// Shape of a torque that saturates by the square of the current: the exponent, and that it is one; a flux has one number.
pub const SQUARE: [f64; 2] = [2.0, 0.0];

/// Whether each of an effect's shape parameters is refined on a logarithmic scale; `None` where it is not refined.
///
/// * `count` of them: some have one only where there are phases
pub fn scales(kind: EffectKind, count: usize) -> &'static [Option<bool>] {
    if kind == EffectKind::TorqueSaturation && count == SQUARE.len() {
        return &[];
    }
    let all = all_scales(kind);
    &all[..count.min(all.len())]
}

fn all_scales(kind: EffectKind) -> &'static [Option<bool>] {
    const LOG: Option<bool> = Some(true);
    const LIN: Option<bool> = Some(false);
    match kind {
        EffectKind::Stribeck => &[LOG, LIN],
        EffectKind::LubricatedRise | EffectKind::ControlDelay | EffectKind::TorqueSaturation => &[LOG],
        EffectKind::Presliding => &[LOG, None],
        EffectKind::Backlash => &[LOG, LOG, LIN, LIN],
        EffectKind::TightSpot => &[LIN, LOG],
        EffectKind::PeriodicFriction | EffectKind::Cogging | EffectKind::TorqueRipple => &[LIN],
        EffectKind::CommutationOffset => &[LIN, None],
        EffectKind::Compliance => &[LOG, LOG, LOG, None, None],
        EffectKind::CurrentOffset | EffectKind::CurrentGain | EffectKind::SupplySag => &[None],
        EffectKind::TurnShort => &[None, None],
        EffectKind::WindingHeating => &[None, LOG],
        EffectKind::DeadTime => &[LOG],
        _ => &[],
    }
}

/// Physical limits of the shape parameters, over those of the effect's keys.
pub fn limits(kind: EffectKind, runs: &[Signals]) -> Vec<(f64, f64)> {
    let fastest = runs.iter().flat_map(|r| &r.omega).fold(0.0, |a: f64, x| a.max(x.abs()));
    let (low, high) = extent(runs.iter().flat_map(|r| &r.theta).copied());
    let stroke = high - low;
    match kind {
        EffectKind::Stribeck => vec![(1e-4 * fastest, 0.7 * fastest), (0.8, 2.2)],
        EffectKind::LubricatedRise => vec![(1e-4 * fastest, 0.5 * fastest)],
        EffectKind::TightSpot => vec![
            (low - 0.05 * stroke, high + 0.05 * stroke),
            (0.004 * stroke, 0.5 * stroke),
        ],
        EffectKind::Presliding => vec![(1e-7 * stroke, 0.2 * stroke), (0.0, STATIC)],
        EffectKind::Backlash => vec![(1e-7 * stroke, stroke), (1e-3, 1e7), (0.0, 1e9), (0.0, 0.8)],
        // beyond, a third of the torque is gone and the motor hardly runs
        EffectKind::CommutationOffset => vec![(-0.9, 0.9), (0.0, 1.0)],
        EffectKind::Compliance => vec![(1e-9, 1e9), (0.0, 1e9), (1e-12, 1e9), (0.0, BY_TORQUE), (0.0, 1.0)],
        EffectKind::WindingHeating => vec![(0.0, WARM), (0.02, 1e3)],
        EffectKind::SupplySag => vec![(0.0, LEGS)],
        EffectKind::TurnShort => vec![(0.0, 2.0), (0.0, BRIDGED)],
        EffectKind::CurrentOffset | EffectKind::CurrentGain | EffectKind::EncoderEccentricity => vec![(0.0, 2.0)],
        EffectKind::DeadTime if runs.iter().all(|r| r.phases.is_some()) => vec![(0.005, 0.5)],
        EffectKind::DeadTime => {
            let most = strongest(runs);
            vec![(1e-4 * most, 0.5 * most)]
        }
        EffectKind::ControlDelay => vec![(1e-6, 0.5)],
        // less than half of the torque is left, or so much that only its first curvature shows
        EffectKind::TorqueSaturation => vec![(0.5 * strongest(runs), 2.0 * strongest(runs))],
        EffectKind::PeriodicFriction | EffectKind::Cogging | EffectKind::TorqueRipple => vec![(0.1, 1000.0)],
        _ => vec![],
    }
}
