//! From noise-free signals to recorded columns: clocks, averaging, delays, noise, hum, quantisation, units.

use super::dice::Dice;
use super::draw::Case;
use super::rig::{Drive, Rig};
use super::sim::Trace;
use std::f64::consts::{PI, TAU};

/// A recorded channel as the bench file describes it.
#[derive(Clone, Debug)]
pub struct Channel {
    /// Key in the bench file.
    pub key: &'static str,
    /// Column in the CSV.
    pub column: String,
    /// Unit.
    pub unit: &'static str,
    /// Unit per motor-side SI unit.
    pub factor: f64,
    /// Averaged over the sample.
    pub mean: bool,
    /// Delay that is true, and whether it is stated.
    pub delay: (f64, bool),
    /// Step of the quantisation, motor-side SI; 0: none.
    pub resolution: f64,
    /// Noise, motor-side SI.
    pub noise: f64,
    /// Resolution and noise are stated.
    pub stated: bool,
}

impl Channel {
    fn new(key: &'static str, column: &str, unit: &'static str, factor: f64) -> Channel {
        let column = column.to_string();
        Channel {
            key,
            column,
            unit,
            factor,
            mean: false,
            delay: (0.0, false),
            resolution: 0.0,
            noise: 0.0,
            stated: true,
        }
    }
}

/// The channels of a rig; `peak` is the largest drive signal, which sets the converter's range.
pub fn channels(case: &Case, peak: f64, d: &mut Dice) -> Vec<Channel> {
    let rig = &case.rig;
    let s = &rig.sees;
    let reach = rig.reach();
    let terse = d.chance(0.5);
    let name = |a: &str, b: &str| if terse { a.to_string() } else { b.to_string() };
    let linear = rig.lead.is_some();
    let delay = |k: usize| match (s.known, s.unknown) {
        (Some((c, x)), _) if c == k => (x, true),
        (_, Some((c, x))) if c == k => (x, false),
        _ => (0.0, false),
    };
    let mut out = vec![];
    let (unit, factor) = if d.chance(0.15) { ("ms", 1e3) } else { ("s", 1.0) };
    out.push(Channel::new("time", &name("t", "time"), unit, factor));
    let plain = rig.control.told || d.chance(0.7);
    let (p_unit, p_factor) = match (linear, plain) {
        (false, true) => ("rad", 1.0),
        (false, false) => ("deg", 180.0 / PI),
        (true, true) => ("m", reach),
        (true, false) => ("mm", 1e3 * reach),
    };
    if !case.runs.iter().any(|r| {
        matches!(
            r.scene.command,
            super::motion::Command::Ideal(_) | super::motion::Command::Spin(_)
        )
    }) {
        out.push(Channel::new(
            "command",
            &name("cmd", "commanded_position"),
            p_unit,
            p_factor / rig.gear,
        ));
    }
    if rig.has.0 {
        let mut c = Channel::new("position", &name("th", "motor_position"), p_unit, p_factor);
        (c.resolution, c.stated) = (rig.encoder, s.stated);
        out.push(c);
    }
    if rig.has.1 {
        let (unit, factor) = match (linear, rig.control.told, d.weighted(&[0.6, 0.2, 0.2])) {
            (true, _, 0) => ("m/s", reach),
            (true, ..) => ("mm/s", 1e3 * reach),
            (false, true, _) | (false, _, 0) => ("rad/s", 1.0),
            (false, _, 1) => ("deg/s", 180.0 / PI),
            _ => ("rpm", 30.0 / PI),
        };
        let mut c = Channel::new("velocity", &name("w", "motor_speed"), unit, factor);
        (c.noise, c.mean, c.delay, c.stated) = (s.velocity, s.mean[2], delay(1), s.stated);
        out.push(c);
    }
    if rig.user {
        let mut c = Channel::new(
            "user_position",
            &name("thu", "user_position"),
            p_unit,
            p_factor / rig.gear,
        );
        (c.resolution, c.stated) = (rig.user_res, s.stated);
        out.push(c);
    }
    let milli = d.chance(0.2);
    let mut c = match rig.drive {
        Drive::Current if milli => Channel::new("current", &name("i", "motor_current"), "mA", 1e3),
        Drive::Current => Channel::new("current", &name("i", "motor_current"), "A", 1.0),
        Drive::Amplifier => Channel::new("voltage", &name("u", "amplifier_input"), "V", 1.0),
        Drive::Torque if linear => Channel::new("force", &name("f", "drive_force"), "N", 1.0 / reach),
        Drive::Torque if milli => Channel::new("torque", &name("m", "drive_torque"), "mN m", 1e3),
        Drive::Torque => Channel::new("torque", &name("m", "drive_torque"), "N m", 1.0),
    };
    c.resolution = 2.5 * peak / 2f64.powi(s.adc as i32);
    (c.noise, c.mean, c.delay, c.stated) = (s.drive, s.mean[0], delay(0), s.stated);
    out.push(c);
    if rig.volt {
        let mut c = Channel::new("voltage", &name("v", "terminal_voltage"), "V", 1.0);
        (c.noise, c.mean, c.stated) = (s.voltage, s.mean[1], s.stated);
        out.push(c);
    }
    if rig.bus {
        let mut c = Channel::new("v_dc", &name("vdc", "bus_voltage"), "V", 1.0);
        (c.noise, c.mean) = (1e-3 * rig.v0, true);
        out.push(c);
    }
    if rig.loaded {
        let (unit, factor) = if linear { ("N", 1.0 / reach) } else { ("N m", 1.0) };
        let mut c = Channel::new("load", &name("tl", "load"), unit, factor);
        c.noise = 2e-3 * rig.t_ref;
        out.push(c);
    }
    if rig.temp {
        let mut c = Channel::new("temperature", &name("temp", "temperature"), "degC", 1.0);
        c.noise = 0.1;
        out.push(c);
    }
    out
}

/// Time stamps of a run, on the clock of its trace.
pub fn clock(rig: &Rig, span: f64, d: &mut Dice) -> Vec<f64> {
    let h = 1.0 / rig.rate;
    // past the longest delay, so that nothing before the start is asked for
    let mut t = ((6e-3 / h).ceil() + 3.0) * h;
    let mut out = vec![];
    let mut k = 0.0;
    let first = t;
    while t < span - h {
        out.push(t);
        if rig.jitter {
            t += h * (0.8 + 1.5 * d.u().powi(3));
        } else {
            k += 1.0;
            t = first + k * h;
        }
    }
    out
}

/// The columns of one run, in the channels' units and order.
pub fn record(case: &Case, trace: &Trace, list: &[Channel], d: &mut Dice) -> Vec<Vec<f64>> {
    let rig = &case.rig;
    let stamps = clock(rig, trace.dt * (trace.th.len() - 2) as f64, d);
    let logged = rig.control.told;
    list.iter()
        .map(|c| {
            let mut x = match c.key {
                "time" => stamps.clone(),
                "command" => hold(&trace.command, trace.dt, &stamps),
                "position" if logged => hold(&trace.seen_th, trace.dt, &stamps),
                "velocity" if logged => hold(&trace.seen_w, trace.dt, &stamps),
                "position" => {
                    let mut x = sample(&trace.th, trace.dt, &stamps, c);
                    let e = case.laws.ecc;
                    x.iter_mut().for_each(|th| *th += e.a * (*th + e.phi).sin());
                    x
                }
                "velocity" if case.laws.ecc.a != 0.0 && !rig.sees.tacho => {
                    let e = case.laws.ecc;
                    let w: Vec<f64> = trace
                        .w
                        .iter()
                        .zip(&trace.th)
                        .map(|(w, th)| w * (1.0 + e.a * (th + e.phi).cos()))
                        .collect();
                    sample(&w, trace.dt, &stamps, c)
                }
                "velocity" => sample(&trace.w, trace.dt, &stamps, c),
                "user_position" => sample(&trace.user, trace.dt, &stamps, c),
                "voltage" if rig.volt => sample(&trace.v, trace.dt, &stamps, c),
                "v_dc" => sample(&trace.v_dc, trace.dt, &stamps, c),
                "load" => sample(&trace.load, trace.dt, &stamps, c),
                "temperature" => sample(&trace.temp, trace.dt, &stamps, c),
                _ => drive(case, sample(&trace.i, trace.dt, &stamps, c), &stamps, d),
            };
            if !(logged && matches!(c.key, "position" | "velocity")) {
                noise(&mut x, c.noise, rig, d);
                if c.resolution > 0.0 {
                    x.iter_mut()
                        .for_each(|v| *v = (*v / c.resolution).round() * c.resolution);
                }
            }
            x.iter_mut().for_each(|v| *v *= c.factor);
            x
        })
        .collect()
}

/// What the drive's sensor does before noise.
fn drive(case: &Case, mut x: Vec<f64>, stamps: &[f64], d: &mut Dice) -> Vec<f64> {
    let s = &case.rig.sees;
    let gain = 1.0 + s.gain + case.laws.i_gain;
    let offset = s.offset + case.laws.i_offset;
    let phase = d.phase();
    for (v, t) in x.iter_mut().zip(stamps) {
        *v = *v * gain + offset;
        if s.hum.0 != 0.0 {
            *v += s.hum.0 * (TAU * s.hum.1 * t + phase).sin();
        }
    }
    x
}

fn noise(x: &mut [f64], rms: f64, rig: &Rig, d: &mut Dice) {
    if rms == 0.0 {
        return;
    }
    if !rig.sees.coloured {
        x.iter_mut().for_each(|v| *v += rms * d.normal());
        return;
    }
    let keep = (-TAU * rig.sees.corner / rig.rate).exp();
    let (part, mut slow) = (rms / 2f64.sqrt(), d.normal());
    for v in x.iter_mut() {
        slow = keep * slow + (1.0 - keep * keep).sqrt() * d.normal();
        *v += part * (slow + d.normal());
    }
}

/// The value last set at or before each stamp.
fn hold(x: &[f64], dt: f64, stamps: &[f64]) -> Vec<f64> {
    stamps
        .iter()
        .map(|t| x[((t / dt + 1e-6) as usize).min(x.len() - 1)])
        .collect()
}

/// Values at the stamps or means since the stamp before, both late by the channel's delay.
pub fn sample(x: &[f64], dt: f64, stamps: &[f64], c: &Channel) -> Vec<f64> {
    let place = |t: f64| {
        let y = (t / dt).max(0.0);
        let k = (y as usize).min(x.len() - 2);
        (k, (y - k as f64).min(1.0))
    };
    if !c.mean {
        return stamps
            .iter()
            .map(|t| {
                let (k, f) = place(t - c.delay.0);
                x[k] + f * (x[k + 1] - x[k])
            })
            .collect();
    }
    // exact integral of the piecewise linear signal
    let mut sum = Vec::with_capacity(x.len());
    let mut s = 0.0;
    sum.push(0.0);
    for k in 1..x.len() {
        s += 0.5 * (x[k] + x[k - 1]);
        sum.push(s);
    }
    let integral = |t: f64| {
        let (k, f) = place(t);
        sum[k] + f * x[k] + 0.5 * f * f * (x[k + 1] - x[k])
    };
    let first = stamps.get(1).map_or(dt, |b| b - stamps[0]);
    let mut before = stamps[0] - first - c.delay.0;
    stamps
        .iter()
        .map(|t| {
            let now = t - c.delay.0;
            let v = (integral(now) - integral(before)) * dt / (now - before);
            before = now;
            v
        })
        .collect()
}
