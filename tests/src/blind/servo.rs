//! Rig 1: a current-driven servo. Leapfrog in angle and speed, dry friction by its proximal step (exact for a level
//! that holds over the step, no chatter at rest), bristles by their exact exponential.

use super::commands::{Command, RATE};
use super::effects::{Adds, Effect, Kind, Seen};
use super::{Laws, Row, Run, Sums, Truth};
use std::collections::VecDeque;

/// Time constant of the current loop, s (assumed).
pub const CURRENT_LOOP: f64 = 3e-4;
/// Below this speed, rad/s, friction is not told from rest when a severity is measured.
const AT_REST: f64 = 0.5;
/// Presliding and compliance act in spikes: their severity is that of the torque behind this lag, s.
const SLOW: f64 = 2e-3;

/// The second mass and what joins it to the motor.
struct Second {
    inertia: f64,
    stiffness: f64,
    damping: f64,
    gap: f64,
    harden: f64,
    /// Share of the Coulomb friction that sits at the load.
    share: f64,
    index: usize,
}

impl Second {
    fn of(effects: &[Effect], t: &Truth) -> Option<Second> {
        let p = &t.nominal;
        effects.iter().enumerate().find_map(|(index, e)| match e.kind {
            Kind::Compliance => Some(Second {
                inertia: e.shape[1],
                stiffness: 1.0 / e.amp,
                damping: e.shaft_damping(p),
                gap: 0.0,
                // at 0.03 N m of twist the hardening adds 30 %
                harden: if e.other { 0.3 / (0.03 * e.amp).powi(2) } else { 0.0 },
                share: 0.0,
                index,
            }),
            // the flank: 200 N m/rad and half of critical damping (assumed)
            Kind::Backlash if !e.other => {
                let reduced = e.shape[0] * (p.inertia - e.shape[0]) / p.inertia;
                let damping = (200.0 * reduced).sqrt();
                Some(Second {
                    inertia: e.shape[0],
                    stiffness: 200.0,
                    damping,
                    gap: e.amp,
                    harden: 0.0,
                    share: 0.3,
                    index,
                })
            }
            _ => None,
        })
    }

    /// Torque from motor to load.
    fn torque(&self, twist: f64, rate: f64) -> f64 {
        let past = if self.gap == 0.0 {
            twist
        } else {
            twist - twist.clamp(-self.gap / 2.0, self.gap / 2.0)
        };
        if past == 0.0 && self.gap > 0.0 {
            return 0.0;
        }
        let t = self.stiffness * past * (1.0 + self.harden * past * past) + self.damping * rate;
        // a flank pushes only
        if self.gap > 0.0 && t * past < 0.0 { 0.0 } else { t }
    }
}

/// Speed after a step under dry friction: towards rest by `level dt/J`, never past it.
pub(super) fn proximal(w: f64, reach: f64) -> f64 {
    if w.abs() <= reach { 0.0 } else { w - reach.copysign(w) }
}

/// Runs the servo on a command with `sub` steps per controller sample.
pub(super) fn run(t: &Truth, laws: &Laws, effects: &[Effect], command: &Command, sub: usize) -> Run {
    let p = &t.nominal;
    let dt = 1.0 / RATE / sub as f64;
    let decay = (-dt / CURRENT_LOOP).exp();
    let find = |kind| effects.iter().position(|e| e.kind == kind);
    let second = Second::of(effects, t);
    let play = find(Kind::Backlash).filter(|_| second.is_none());
    let bristle = find(Kind::Presliding);
    let encoder = find(Kind::EncoderEccentricity);
    let late = find(Kind::ControlDelay);
    let sag = find(Kind::SupplySag);
    let swell = find(Kind::SpeedDependentInertia);
    let slip = find(Kind::SlippingCoupling);
    let plain: Vec<(usize, &Effect)> = effects.iter().enumerate().collect();
    let bristles: [(f64, f64); 2] = match bristle.map(|b| &effects[b]) {
        Some(e) if e.other => [(0.6 * p.coulomb, 1.0 / e.amp), (0.4 * p.coulomb, 0.2 / e.amp)],
        Some(e) => [(p.coulomb, 1.0 / e.amp), (0.0, 1.0)],
        None => [(0.0, 1.0); 2],
    };
    let bristle_damping = bristle.map_or(0.0, |b| effects[b].bristle_damping(p));
    let jm = p.inertia - second.as_ref().map_or(0.0, |s| s.inertia);
    let share = second.as_ref().map_or(0.0, |s| s.share);
    let level = if bristle.is_some() {
        0.0
    } else {
        p.coulomb * (1.0 - share)
    };

    let (mut th, mut w, mut i, mut integral, mut warm) = (0.0f64, 0.0f64, 0.0f64, 0.0f64, 0.0f64);
    let (mut th_l, mut w_l, mut crept, mut played) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
    let (mut acc, mut acc_slow, mut since, mut last_sign) = (0.0f64, 0.0f64, 1.0f64, 0.0f64);
    let mut z = [0.0f64; 2];
    let mut slow = [0.0f64; 2];
    let history = late.map_or(0.0, |e| effects[e].amp * RATE);
    let mut demands = VecDeque::from(vec![0.0; history as usize + 2]);
    let mut sums = Sums::new(effects.len());
    let mut own = vec![0.0f64; effects.len()];
    let mut rows = Vec::with_capacity(command.com.len() / 10);
    let mut row: Row = [0.0; 8];
    let per_row = (RATE / 1000.0) as usize;
    let share_of_row = 1.0 / (per_row * sub) as f64;

    for (k, (&com, &load)) in command.com.iter().zip(&command.load).enumerate() {
        let seen_th = th + encoder.map_or(0.0, |e| effects[e].encoder(th));
        let e = (laws.position_gain * (com - seen_th)).clamp(-laws.speed_limit, laws.speed_limit) - w;
        let u = laws.speed_gain * e + laws.integral_gain * integral;
        if u.abs() < laws.drive_limit || u * e < 0.0 {
            integral += e / RATE;
        }
        let now = u.clamp(-laws.drive_limit, laws.drive_limit);
        demands.push_front(now);
        demands.pop_back();
        let at = history as usize;
        let demand = demands[at] + (history - at as f64) * (demands[at + 1] - demands[at]);
        if let Some(e) = late {
            own[e] += (demand - now) * sub as f64;
        }

        let next = command.com.get(k + 1).copied().unwrap_or(com);
        for s in 0..sub {
            let i_new = demand + (i - demand) * decay;
            let im = 0.5 * (i + i_new);
            let th_half = th + 0.5 * dt * w;
            let wm = w + 0.5 * dt * acc;
            let sgn = if w == 0.0 { 0.0 } else { w.signum() };
            let seen = Seen {
                th: th_half,
                w: wm,
                sgn,
                i: im,
                load,
                warm,
                acc: acc_slow,
                since,
            };
            let (mut dry, mut extra, mut kf, mut rf, mut lf, mut volt) = (level, 0.0, 1.0, 1.0, 1.0, 0.0);
            for &(n, e) in &plain {
                let a: Adds = e.adds(&seen, p, true);
                dry += a.dry;
                extra += a.torque;
                kf *= a.k;
                rf *= a.r;
                lf *= a.l;
                volt += a.volt;
                own[n] += match e.kind.quantity() {
                    super::Quantity::Torque => a.dry * sgn + a.torque + p.kt * im * (1.0 - a.k),
                    super::Quantity::Voltage => a.volt + (a.r - 1.0) * p.resistance * im,
                    super::Quantity::EncoderAngle => e.encoder(th_half),
                    _ => 0.0,
                };
            }
            if let Some(b) = bristle {
                let before = z;
                let mut force = 0.0;
                for (n, &(top, stiffness)) in bristles.iter().enumerate().filter(|(_, b)| b.0 > 0.0) {
                    let end = sgn * top / stiffness;
                    z[n] = end + (z[n] - end) * (-stiffness * (w * dt).abs() / top).exp();
                    force += stiffness * 0.5 * (z[n] + before[n]);
                }
                force += bristle_damping * (z[0] - before[0]) / dt;
                // at rest Coulomb's law holds any force: only motion counts
                // the other dry friction goes through the bristles too
                extra += force * ((p.coulomb + dry) / p.coulomb).max(0.0);
                dry = 0.0;
                let gap = if w.abs() > AT_REST {
                    force - p.coulomb * sgn
                } else {
                    0.0
                };
                slow[0] += (gap - slow[0]) * dt / SLOW;
                own[b] += slow[0];
            }
            if let Some(n) = slip {
                // the load side carries half of the inertia and 30 % of the Coulomb friction (assumed)
                let [limit, rate] = effects[n].shape;
                let through = load + 0.5 * p.inertia * acc_slow + 0.3 * p.coulomb * sgn;
                let over = (through.abs() - limit).max(0.0);
                crept -= dt * rate * over.copysign(through);
                dry += effects[n].amp * over;
                own[n] += effects[n].amp * over * sgn;
            }
            let mut j = jm;
            if let Some(n) = swell {
                let more = p.inertia * effects[n].amp * wm * wm;
                j += more;
                own[n] += more * acc;
            }
            let through = match &second {
                Some(s) => s.torque(th_half - (th_l + 0.5 * dt * w_l), w - w_l),
                None => load,
            };
            let free = (w * (1.0 - 0.5 * dt * p.viscous / j) + dt / j * (p.kt * kf * im - extra - through))
                / (1.0 + 0.5 * dt * p.viscous / j);
            let w_new = proximal(free, dt / j * dry.max(0.0));
            acc = (w_new - w) / dt;
            acc_slow += (acc - acc_slow) * dt / 2e-3;
            let w_mid = 0.5 * (w + w_new);
            // mean over the step of the angle that the speeds integrate to
            let th_mid = th_half + 0.125 * dt * (w_new - w);
            let mut user = th_mid + crept;
            if let Some(s) = &second {
                let free = w_l + dt / s.inertia * (through - load);
                let new = proximal(free, dt / s.inertia * s.share * p.coulomb);
                user = th_l + 0.5 * dt * w_l + 0.125 * dt * (new - w_l);
                th_l += 0.5 * dt * (w_l + new);
                let lumped = through - load - s.inertia * acc - s.share * p.coulomb * sgn;
                own[s.index] += match effects[s.index].kind {
                    Kind::Compliance => {
                        let gap = if w.abs() > AT_REST { lumped } else { 0.0 };
                        slow[1] += (gap - slow[1]) * dt / SLOW;
                        slow[1]
                    }
                    _ => user - th_mid,
                };
                w_l = new;
            }
            let real = rf * p.resistance * im + lf * p.inductance * (i_new - i) / dt + p.ke * kf * w_mid;
            let mut v = real + volt;
            if let Some(n) = sag {
                // duty of the sagging supply that gives the real voltage, by three Picard steps
                let mut duty = real / laws.supply;
                for _ in 0..3 {
                    let drawn = if effects[n].other {
                        (duty * im).max(0.0)
                    } else {
                        duty * im
                    };
                    duty = real / (laws.supply - effects[n].amp * drawn).max(0.2 * laws.supply);
                }
                v = duty * laws.supply + volt;
                own[n] += duty * laws.supply - real;
            }
            let signed = if w_new == 0.0 { 0.0 } else { w_new.signum() };
            since += dt;
            if signed != 0.0 && signed != last_sign {
                (since, last_sign) = (0.0, signed);
            }
            th = th_half + 0.5 * dt * w_new;
            if let Some(n) = play {
                let half = 0.5 * effects[n].amp;
                played = played.clamp(th_mid - half, th_mid + half);
                own[n] += played - th_mid;
                user = played;
            }
            warm += dt / t.thermal_time * (t.thermal_rise * p.resistance * rf * im * im - warm);
            sums.warmest = sums.warmest.max(warm);
            sums.torque += (p.kt * im).powi(2);
            sums.voltage += (real - p.ke * kf * w_mid).powi(2);
            sums.current += im * im;
            sums.steps += 1;
            let measured = th_mid + encoder.map_or(0.0, |e| effects[e].encoder(th_mid));
            let asked = com + (next - com) * (s as f64 + 0.5) / sub as f64;
            for (sum, x) in row.iter_mut().zip([asked, measured, w_mid, im, v, user, warm, load]) {
                *sum += x * share_of_row;
            }
            (w, i) = (w_new, i_new);
        }
        if (k + 1) % per_row == 0 {
            row[0] /= p.gear;
            row[5] /= p.gear;
            row[6] += 20.0;
            rows.push(row);
            row = [0.0; 8];
            sums.close(&mut own, per_row * sub);
        }
    }
    Run { rows, sums }
}
