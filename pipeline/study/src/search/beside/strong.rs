//! What strong currents say of their torque. No equation has their stretches.

use super::{Both, found, holds, noise_of};
use crate::equations::signals::Signals;
use crate::measured::bench::BenchChannel;
use crate::measured::recording::Run;
use crate::measured::sums::{Sums, jackknife};
use crate::search::beside::Beside;
use crate::search::fit::{self, Fit};
use crate::search::select::Material;
use sim_worker::effect::EffectKind;

/// Least loss of torque at the greatest current that matters (assumed).
const LEAST_LOSS: f64 = 0.03;
/// Share of a sample by which the impulse of a stretch of strong current is off, one sigma (assumed): a current that jumps may do so
/// anywhere within a sample at either end, and points of it do not say where.
const AT_ENDS: f64 = 0.4;
/// Fewest samples of a stretch, three of which are its ends (assumed): what one or two points of a current gave nobody knows.
const LEAST_STRETCH: usize = 6;
/// Share of an impulse by which the strokes of the commutation make it uncertain (assumed).
const ROUGH: f64 = 0.02;

/// Stretches of strong current: what they give to the motion beside what the flux makes of them. `y = x - coefficient z`,
/// impulses over the stretch, each over its own uncertainty. And the greatest current.
fn strong(m: &Material, model: &Fit, run: &Run, s: &Signals) -> (Vec<Sums>, f64) {
    let constant = |name: &str| fit::constant(&m.nuisances, model, name);
    let (Some(p), Some(w)) = (&s.phases, run.channel(BenchChannel::Velocity)) else {
        return (Vec::new(), 0.0);
    };
    let (j, c, f, ke) = (
        constant("inertia"),
        constant("viscous"),
        constant("coulomb"),
        0.5 * constant("torque_constant"),
    );
    let dt = 1.0 / s.rate_hz;
    let shapes: [Vec<f64>; 3] = std::array::from_fn(|q| p.mean_over_support(s, q, |trap| trap));
    let mut out = Vec::new();
    let mut greatest: f64 = 0.0;
    let mut k = 2;
    while k + 3 < s.n {
        if !s.stepping[k] {
            k += 1;
            continue;
        }
        let from = k;
        while k + 3 < s.n && s.stepping[k] {
            k += 1;
        }
        let (mut given, mut lost, mut taken) = (0.0, 0.0, 0.0);
        for k in from..k {
            for q in 0..3 {
                let t = ke * p.current[q][k] * shapes[q][k] * dt;
                given += t;
                lost += t * p.current[q][k].abs();
            }
            let speed = 0.5 * (w[k] + w[k - 1]);
            taken += dt * (c * speed + f * speed.signum());
            greatest = greatest.max(p.size(k));
        }
        taken += j * (w[k - 1] - w[from - 1]);
        // where it turns round friction is not known
        let turns = (from..k).any(|k| w[k] * w[k - 1] <= 0.0);
        let noise = 2.0 * j * noise_of(m, BenchChannel::Velocity);
        if given.abs() < 10.0 * noise || turns || k - from < LEAST_STRETCH {
            continue;
        }
        let at_ends = AT_ENDS * given / (k - from) as f64;
        let size = (ROUGH * given).hypot(noise).hypot(at_ends);
        let (y, x) = ((given - taken) / size, lost / size);
        out.push(Sums {
            xx: x * x,
            xy: x * y,
            yy: y * y,
            rows: 1.0,
        });
    }
    (out, greatest)
}

/// What strong currents do against what the flux makes of them.
pub(super) struct Strong {
    /// loss of torque a unit of current [1/A] and its standard deviation
    loss: (f64, f64),
    /// greatest current [A]
    greatest: f64,
    /// root mean square of the impulses over their uncertainty, without the loss and with it
    pub rms: (f64, f64),
}

/// No equation has the stretches of strong currents, so they are shared out by themselves: every third of them proves what the
/// others find. Only where the equations found nothing.
pub(super) fn strong_currents(m: &Material, model: &Fit, [find, prove]: Both) -> Option<Strong> {
    if !model.terms.is_empty() || m.held.is_none() {
        return None;
    }
    let mut runs: Vec<&(&Run, &Signals)> = find.iter().chain(prove).collect();
    runs.sort_by(|a, b| a.1.start_s.total_cmp(&b.1.start_s).then(a.0.name.cmp(&b.0.name)));
    let all: Vec<(Vec<Sums>, f64)> = runs.iter().map(|(r, s)| strong(m, model, r, s)).collect();
    let greatest = all.iter().fold(0.0, |a: f64, b| a.max(b.1));
    let mut stretches: Vec<Sums> = all.into_iter().flat_map(|a| a.0).collect();
    // the strongest among those that prove as among those that find
    stretches.sort_by(|a, b| b.xx.total_cmp(&a.xx));
    let proves = |i: usize| i % 3 == 1;
    let of = |wanted: bool| -> Vec<Sums> {
        let all = stretches.iter().enumerate().filter(|(i, _)| proves(*i) == wanted);
        all.map(|(_, s)| *s).collect()
    };
    let loss = jackknife(&of(false))?;
    let proof = Sums::all(&of(true));
    Some(Strong {
        loss,
        greatest,
        rms: (proof.rms(0.0), proof.rms(loss.0)),
    })
}

/// Torque that strong currents do not give.
pub(super) fn saturation(strong: &Strong) -> Option<Beside> {
    let ((value, sd), (before, after)) = (strong.loss, strong.rms);
    let seen = (
        "impulses of strong currents against what the flux makes of them, over their uncertainty",
        "-",
    );
    // what something else makes of strong currents is only a little less by it
    (value > 0.0
        && strong.greatest > 0.0
        && after < MOST_LEFT
        && holds(value, sd, LEAST_LOSS / strong.greatest, before, after))
    .then(|| found(EffectKind::TorqueSaturation, (value, sd), seen, (before, after)))
}

/// Most that a loss of torque leaves of the impulses of strong currents, over their uncertainty (assumed).
pub(super) const MOST_LEFT: f64 = 4.0;
