//! How visible a hidden effect is: its own contribution against the noise that is left. No estimator is involved but
//! a straight fit of the rig's constants, which tells how much of an effect a re-tuned constant could swallow.

use super::laws::Laws;
use super::rig::{Mode, Rig};
use super::sim::Trace;

/// Averaging time of the noise.
const WINDOW_S: f64 = 0.02;

/// Sizes of one effect in the unit where it shows.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// Rms of the contribution.
    pub signal: f64,
    /// Rms of what is left of it with the constants re-tuned.
    pub residual: f64,
    /// Rms of the noise after averaging.
    pub noise: f64,
    /// Rms of the whole signal to which it contributes.
    #[cfg_attr(not(test), allow(dead_code))]
    pub whole: f64,
}

impl Sight {
    /// Factor at most 1 by which the noise must be scaled for the effect to be fairly visible.
    pub fn quieter(&self) -> f64 {
        let allowed = (self.signal / 6.0).min(self.residual / 1.5);
        if self.noise > allowed {
            (allowed / self.noise).max(1e-3)
        } else {
            1.0
        }
    }
}

/// Rms of noise of the rig's colour, of unit rms per sample, after averaging.
fn averaged(rig: &Rig) -> f64 {
    let n = (WINDOW_S * rig.rate).max(1.0);
    let white = 1.0 / n;
    if !rig.sees.coloured {
        return white.sqrt();
    }
    // first-order colour of corner f: correlation time 1 / (2 pi f)
    let x = WINDOW_S * std::f64::consts::TAU * rig.sees.corner;
    let slow = 2.0 * (x - 1.0 + (-x).exp()) / (x * x);
    (0.5 * white + 0.5 * slow).sqrt()
}

fn rms(x: impl Iterator<Item = f64>) -> f64 {
    let (n, s) = x.fold((0.0f64, 0.0), |(n, s), v| (n + 1.0, s + v * v));
    (s / n.max(1.0)).sqrt()
}

/// Drive signal and nominal terms at moments of plain sliding: (i, acceleration, speed, sign, load).
pub fn moments(rig: &Rig, t: &Trace) -> Vec<[f64; 5]> {
    let n = t.w.len();
    let m = (rig.fine / 2).max(1);
    let mut out = vec![];
    let mut k = 4 * rig.fine;
    while k + 2 * m < n {
        let (a, b) = (t.w[k - m], t.w[k + m]);
        if a * b > 0.0 && t.w[k] * a > 0.0 {
            let span = &t.i[k - m..=k + m];
            // the mean of the drive over the time over which the speed changed
            let mean = (span.iter().sum::<f64>() - 0.5 * (span[0] + span[2 * m])) / (2 * m) as f64;
            out.push([
                mean,
                (b - a) / (2 * m) as f64 / t.dt,
                t.w[k],
                t.w[k].signum(),
                t.load[k],
            ]);
        }
        k += rig.fine;
    }
    out
}

/// Torque balance of the nominal rig: kt i minus all nominal terms.
pub fn extra(laws: &Laws, m: &[f64; 5]) -> f64 {
    laws.kt * m[0] - (laws.j * m[1] + laws.c * m[2] + laws.tc * m[3] + m[4])
}

/// Rms of a target that is left after the best combination of the regressors.
pub fn left_over(target: &[f64], rows: &[Vec<f64>]) -> f64 {
    let p = rows.first().map_or(0, |r| r.len());
    let scale: Vec<f64> = (0..p).map(|c| rms(rows.iter().map(|r| r[c])).max(1e-300)).collect();
    let mut a = vec![vec![0.0; p + 1]; p];
    for (y, r) in target.iter().zip(rows) {
        for i in 0..p {
            for j in 0..p {
                a[i][j] += r[i] * r[j] / (scale[i] * scale[j]);
            }
            a[i][p] += r[i] * y / scale[i];
        }
    }
    let trace = rows.len() as f64 * 1e-9;
    let mut x = vec![0.0; p];
    for (i, row) in a.iter_mut().enumerate() {
        row[i] += trace;
    }
    for i in 0..p {
        for j in i + 1..p {
            let f = a[j][i] / a[i][i];
            let (above, below) = a.split_at_mut(j);
            below[0][i..]
                .iter_mut()
                .zip(&above[i][i..])
                .for_each(|(x, y)| *x -= f * y);
        }
    }
    for i in (0..p).rev() {
        let s: f64 = (i + 1..p).map(|k| a[i][k] * x[k]).sum();
        x[i] = (a[i][p] - s) / a[i][i];
    }
    rms(target
        .iter()
        .zip(rows)
        .map(|(y, r)| y - r.iter().enumerate().map(|(c, v)| x[c] * v / scale[c]).sum::<f64>()))
}

/// How visible an effect is in a run in which it is the only one.
pub fn visible(rig: &Rig, laws: &Laws, t: &Trace, name: &str) -> Sight {
    let part = averaged(rig);
    let (n_i, n_w, n_v) = (rig.sees.drive * part, rig.sees.velocity * part, rig.sees.voltage * part);
    let w_rms = rms(t.w.iter().copied());
    let i_rms = rms(t.i.iter().copied());
    let plain = |signal: f64, noise: f64, whole: f64| Sight {
        signal,
        residual: signal,
        noise,
        whole,
    };
    match name {
        "compliance" | "backlash" => {
            let twist = rms(t.user.iter().zip(&t.th).map(|(a, b)| a - b));
            plain(twist, 0.29 * rig.user_res.hypot(rig.encoder), rms(t.th.iter().copied()))
        }
        "encoder_eccentricity" => {
            let eps = laws.ecc.a / 2f64.sqrt();
            if rig.user {
                plain(eps, 0.29 * rig.user_res.hypot(rig.encoder), rms(t.th.iter().copied()))
            } else if rig.volt {
                plain(eps * w_rms, n_v / rig.kt, w_rms)
            } else {
                plain(eps * w_rms, n_w, w_rms)
            }
        }
        "current_offset" => plain(laws.i_offset.abs(), n_i, i_rms),
        "current_gain" => plain(laws.i_gain.abs() * i_rms, n_i, i_rms),
        "control_delay" => {
            let late = (laws.delay / t.dt).round() as usize;
            plain(rms((late..t.i.len()).map(|k| t.i[k] - t.i[k - late])), n_i, i_rms)
        }
        "winding_heating" | "supply_sag" | "dead_time" => {
            let (mut y, mut rows) = (vec![], vec![]);
            for k in (rig.fine..t.i.len() - 1).step_by(rig.fine) {
                let di = (t.i[k + 1] - t.i[k - 1]) / (2.0 * t.dt);
                y.push(t.v[k] - laws.r * t.i[k] - laws.l * di - laws.ke * t.w[k]);
                rows.push(vec![t.i[k], di, t.w[k]]);
            }
            let noise = n_v.hypot(rig.r * n_i);
            let signal = rms(y.iter().copied());
            Sight {
                signal,
                residual: left_over(&y, &rows),
                noise,
                whole: rms(t.v.iter().copied()),
            }
        }
        _ => {
            let m = moments(rig, t);
            let y: Vec<f64> = m.iter().map(|m| extra(laws, m)).collect();
            let drive: Vec<f64> = m.iter().map(|m| laws.kt * m[0]).collect();
            let rows: Vec<Vec<f64>> = m
                .iter()
                .map(|m| if rig.loaded { m[1..5].to_vec() } else { m[1..4].to_vec() })
                .collect();
            let accel = if rig.has.1 {
                n_w * 2f64.sqrt() / WINDOW_S
            } else {
                rig.encoder * 0.29 / (WINDOW_S * rig.rate).sqrt() * 2.4 / (WINDOW_S * WINDOW_S)
            };
            let signal = rms(y.iter().copied());
            // a constant can stand for an effect in one direction only
            let residual = if rig.mode == Mode::Spin && name == "bias_torque" {
                0.0
            } else {
                left_over(&drive, &rows)
            };
            Sight {
                signal,
                residual,
                noise: (laws.kt * n_i).hypot(rig.j * accel),
                whole: rms(drive.iter().copied()),
            }
        }
    }
}
