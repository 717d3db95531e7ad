//! Noise-free signals of a run on a fine grid: from a prescribed motion, in closed loop, or spinning freely.

use super::dice::Dice;
use super::laws::{Around, Laws};
use super::motion::Command;
use super::rig::{Drive, Rig};

/// Signals of one run on a grid of step `dt` that starts at zero.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// Step of the grid.
    pub dt: f64,
    /// Motor angle.
    pub th: Vec<f64>,
    /// Motor speed.
    pub w: Vec<f64>,
    /// True drive signal (A, V or N m).
    pub i: Vec<f64>,
    /// Recorded terminal voltage before the sensor.
    pub v: Vec<f64>,
    /// Supply at the bus.
    pub v_dc: Vec<f64>,
    /// Known load.
    pub load: Vec<f64>,
    /// Temperature.
    pub temp: Vec<f64>,
    /// Angle behind the spring or gap (the motor's where there is none).
    pub user: Vec<f64>,
    /// Commanded angle at the motor, closed loop only.
    pub command: Vec<f64>,
    /// Angle as the controller saw it, closed loop only.
    pub seen_th: Vec<f64>,
    /// Speed as the controller saw it, closed loop only.
    pub seen_w: Vec<f64>,
}

/// What varies around the rig in one run.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The command.
    pub command: Command,
    /// Sines of the known load: amplitude, angular frequency, phase.
    pub load: Vec<(f64, f64, f64)>,
    /// Temperature at the start, rise, time constant.
    pub temp: [f64; 3],
    /// Duration.
    pub span: f64,
    /// Random draws of this run.
    pub seed: u64,
}

struct Outside {
    step: f64,
    walk: Vec<f64>,
    on: Vec<f64>,
}

impl Outside {
    fn new(span: f64, d: &mut Dice) -> Outside {
        let step = 0.01;
        let n = (span / step) as usize + 4;
        let (mut x, mut on, mut walk, mut flags) = (0.0, 0.0, vec![], vec![]);
        let tau = 2.0;
        for _ in 0..n {
            // a walk that forgets within two seconds, of unit rms
            x += -x * step / tau + (2.0 * step / tau).sqrt() * d.normal();
            if d.chance(step / 1.1) {
                on = 1.0 - on;
            }
            walk.push(x);
            flags.push(on);
        }
        Outside { step, walk, on: flags }
    }

    fn at(&self, t: f64) -> (f64, f64) {
        let x = (t / self.step).max(0.0);
        let k = (x as usize).min(self.walk.len() - 2);
        let f = (x - k as f64).min(1.0);
        (self.walk[k] * (1.0 - f) + self.walk[k + 1] * f, self.on[k])
    }
}

/// The moving state.
#[derive(Clone, Copy, Debug, Default)]
struct State {
    th: f64,
    w: f64,
    thl: f64,
    wl: f64,
    z: f64,
}

struct Plant<'a> {
    laws: &'a Laws,
    outside: Outside,
    scene: &'a Scene,
    loaded: bool,
    slider: Vec<f64>,
}

impl<'a> Plant<'a> {
    fn around(&self, t: f64) -> Around {
        let load = if self.loaded {
            self.scene.load.iter().map(|p| p.0 * (p.1 * t + p.2).cos()).sum()
        } else {
            0.0
        };
        let [start, rise, tau] = self.scene.temp;
        let temp = start + rise * (1.0 - (-t / tau).exp());
        let (walk, on) = if self.laws.walk != 0.0 || self.laws.intermittent != 0.0 {
            self.outside.at(t)
        } else {
            (0.0, 0.0)
        };
        Around {
            t,
            load,
            temp,
            walk,
            on,
        }
    }

    /// Moves the sliders of the hysteretic spring to an angle and returns their torque.
    fn slide(&mut self, th: f64) -> f64 {
        let mut sum = 0.0;
        for (anchor, s) in self.slider.iter_mut().zip(&self.laws.sliders) {
            let x = (th - *anchor).clamp(-s[1], s[1]);
            *anchor = th - x;
            sum += s[0] * x;
        }
        sum
    }

    /// Bristle state after h seconds at speed w (exact for constant speed), as a fraction of full sliding.
    fn bristle(&self, z: f64, w: f64, level: f64, h: f64) -> f64 {
        let s = if w < 0.0 { -1.0 } else { 1.0 };
        s + (z - s) * (-w.abs() * h / self.laws.slip(level)).exp()
    }

    /// Dry friction with bristles.
    fn dry(&self, z: f64, w: f64, level: f64) -> f64 {
        let dz = w - w.abs() * z;
        z * level + self.laws.bristle.s1 * dz
    }

    /// Torque through the shaft and acceleration behind it; without a second mass the load itself.
    fn behind(&self, x: &State, e: &Around) -> (f64, f64) {
        let two = &self.laws.two;
        if two.jl == 0.0 {
            return (e.load, 0.0);
        }
        let shaft = two.torque(x.th - x.thl, x.w - x.wl);
        let dry = if two.tcl > 0.0 {
            two.tcl * (x.wl / two.eps).tanh()
        } else {
            0.0
        };
        (shaft, (shaft - two.cl * x.wl - dry - e.load) / two.jl)
    }
}

/// Simulates a run.
pub fn run(rig: &Rig, laws: &Laws, scene: &Scene) -> Trace {
    let dt = 1.0 / (rig.rate * rig.fine as f64);
    let n = (scene.span / dt).ceil() as usize + 2;
    let mut dice = Dice::new(scene.seed);
    let mut trace = Trace { dt, ..Trace::default() };
    let outside = Outside::new(scene.span, &mut dice);
    let slider = vec![0.0; laws.sliders.len()];
    let mut plant = Plant {
        laws,
        outside,
        scene,
        loaded: rig.loaded,
        slider,
    };
    match &scene.command {
        Command::Ideal(motion) => {
            let th = motion.angles(dt, n, rig.centred);
            ideal(&mut plant, motion, th, &mut trace);
        }
        _ => free(rig, &mut plant, n, &mut dice, &mut trace),
    }
    if rig.volt {
        voltage(rig, laws, scene.span, &mut trace);
    }
    trace
}

/// Prescribed motion: the torque that it takes.
fn ideal(plant: &mut Plant, motion: &super::motion::Motion, th: Vec<f64>, out: &mut Trace) {
    let laws = plant.laws;
    let dt = out.dt;
    let jm = laws.j - laws.two.jl;
    let mut x = State {
        th: th[0],
        thl: th[0],
        ..State::default()
    };
    x.w = motion.at(0.0).0;
    x.wl = x.w;
    x.z = x.w.signum();
    for (k, &angle) in th.iter().enumerate() {
        let t = k as f64 * dt;
        let (w, a) = motion.at(t);
        let e = plant.around(t);
        if k > 0 && laws.two.jl > 0.0 {
            // the part behind the shaft, two half steps of semi-implicit Euler driven by the interpolated motor
            let h = 0.5 * dt;
            for part in [0.5, 1.0] {
                let at = State {
                    th: x.th + part * (angle - x.th),
                    w: x.w + part * (w - x.w),
                    ..x
                };
                let (_, al) = plant.behind(&at, &e);
                x.wl += al * h;
                x.thl += x.wl * h;
            }
        }
        if laws.bristle.s0 > 0.0 && k > 0 {
            let wm = 0.5 * (x.w + w);
            x.z = plant.bristle(x.z, wm, laws.level(wm, angle, &e), dt);
        }
        (x.th, x.w) = (angle, w);
        let level = laws.level(w, angle, &e);
        let dry = if laws.bristle.s0 > 0.0 {
            plant.dry(x.z, w, level)
        } else if w != 0.0 {
            w.signum() * level
        } else {
            0.0
        };
        let (shaft, _) = plant.behind(&x, &e);
        let torque = jm * a + laws.drag(w, angle, &e) + plant.slide(angle) + dry + shaft;
        out.w.push(w);
        out.i.push(laws.drive(torque, angle));
        out.load.push(e.load);
        out.temp.push(e.temp);
        out.user.push(if laws.two.jl > 0.0 { x.thl } else { angle });
    }
    out.th = th;
}

/// Closed loop or free spin: the motion that the torque makes. Midpoint rule while sliding, events for sticking.
fn free(rig: &Rig, plant: &mut Plant, n: usize, dice: &mut Dice, out: &mut Trace) {
    let laws = plant.laws;
    let dt = out.dt;
    let jm = laws.j - laws.two.jl;
    let ctl = &rig.control;
    let reference = match &plant.scene.command {
        Command::Track(motion) => motion.angles(dt, n, rig.centred),
        _ => vec![],
    };
    let late = (laws.delay / dt).round() as usize;
    let lag = if ctl.lag > 0.0 {
        1.0 - (-dt / ctl.lag).exp()
    } else {
        1.0
    };
    let mut x = State::default();
    match &plant.scene.command {
        Command::Track(motion) => (x.th, x.w) = (reference[0], motion.at(0.0).0),
        Command::Jumps(steps) => x.th = steps.at(0.0),
        _ => {}
    }
    (x.thl, x.wl) = (x.th, x.w);
    let mut commanded: Vec<f64> = Vec::with_capacity(n);
    let (mut u, mut i, mut sum, mut seen) = (0.0, 0.0, 0.0, (x.th, x.w));
    for k in 0..n {
        let t = k as f64 * dt;
        let mut target = 0.0;
        match &plant.scene.command {
            Command::Spin(steps) => u = steps.at(t),
            Command::Track(_) | Command::Jumps(_) => {
                target = match &plant.scene.command {
                    Command::Jumps(steps) => steps.at(t),
                    _ => reference[k],
                };
                if k % ctl.every == 0 {
                    let angle = x.th + ecc(laws, x.th);
                    seen.0 = (angle / rig.encoder).round() * rig.encoder;
                    seen.1 = x.w + rig.sees.velocity * dice.normal();
                    let w_ref = (ctl.kpos * (target - seen.0)).clamp(-ctl.w_limit, ctl.w_limit);
                    let err = w_ref - seen.1;
                    let h = ctl.every as f64 * dt;
                    let raw = ctl.kp * err + ctl.ki * (sum + err * h);
                    if raw.abs() < ctl.limit || raw * err < 0.0 {
                        sum += err * h;
                    }
                    u = raw.clamp(-ctl.limit, ctl.limit);
                }
            }
            Command::Ideal(_) => {}
        }
        commanded.push(u);
        let applied = commanded[k.saturating_sub(late)];
        i += lag * (applied - i);
        let e = plant.around(t);
        out.th.push(x.th);
        out.w.push(x.w);
        out.i.push(i);
        out.load.push(e.load);
        out.temp.push(e.temp);
        out.user.push(if laws.two.jl > 0.0 { x.thl } else { x.th });
        if ctl.every > 0 {
            out.command.push(target);
            out.seen_th.push(seen.0);
            out.seen_w.push(seen.1);
        }
        let next = i + 0.5 * lag * (applied - i);
        step(plant, &mut x, &e, next, jm, dt);
    }
}

fn ecc(laws: &Laws, th: f64) -> f64 {
    if laws.ecc.a == 0.0 {
        0.0
    } else {
        laws.ecc.a * (th + laws.ecc.phi).sin()
    }
}

/// One step of the freely moving rig; `i` is the drive signal in the middle of the step.
fn step(plant: &mut Plant, x: &mut State, e: &Around, i: f64, jm: f64, dt: f64) {
    let laws = plant.laws;
    let slide = if plant.slider.is_empty() {
        0.0
    } else {
        plant.slide(x.th)
    };
    let bristles = laws.bristle.s0 > 0.0;
    let push = |x: &State, plant: &Plant| {
        let (shaft, al) = plant.behind(x, e);
        (laws.torque(i, x.th) - laws.drag(x.w, x.th, e) - slide - shaft, al)
    };
    let mut s = if x.w != 0.0 { x.w.signum() } else { 0.0 };
    if !bristles && s == 0.0 {
        let (net, al) = push(x, plant);
        if net.abs() <= laws.level(0.0, x.th, e) {
            // stuck; only what is behind the shaft moves
            x.wl += al * dt;
            x.thl += x.wl * dt;
            return;
        }
        s = net.signum();
    }
    let rate = |x: &State, plant: &Plant| {
        let (net, al) = push(x, plant);
        let level = laws.level(x.w, x.th, e);
        let dry = if bristles {
            plant.dry(x.z, x.w, level)
        } else {
            s * level
        };
        ((net - dry) / jm, al)
    };
    let h = 0.5 * dt;
    let (a0, al0) = rate(x, plant);
    let mut m = State {
        th: x.th + h * x.w,
        w: x.w + h * a0,
        thl: x.thl + h * x.wl,
        wl: x.wl + h * al0,
        z: x.z,
    };
    if bristles {
        m.z = plant.bristle(x.z, m.w, laws.level(m.w, m.th, e), h);
    }
    let (a1, al1) = rate(&m, plant);
    let w = x.w + dt * a1;
    if !bristles && w * s < 0.0 {
        // the speed passes zero within the step: stop there, the next step decides
        let part = if x.w != 0.0 { x.w / (x.w - w) } else { 0.0 };
        x.th += 0.5 * x.w * part * dt;
        x.w = 0.0;
    } else {
        if bristles {
            x.z = plant.bristle(x.z, m.w, laws.level(m.w, m.th, e), dt);
        }
        x.th += dt * m.w;
        x.w = w;
    }
    x.thl += dt * m.wl;
    x.wl += dt * al1;
}

/// Terminal voltage and bus of a DC motor.
fn voltage(rig: &Rig, laws: &Laws, span: f64, out: &mut Trace) {
    let n = out.i.len();
    let [dt_max, tau] = laws.heat;
    let full = if tau > 0.0 { 1.0 - (-span / tau).exp() } else { 1.0 };
    let (mut heat, mut energy) = (vec![0.0; n], 0.0);
    if dt_max > 0.0 && laws.joule {
        // heated by the losses themselves, scaled so that the wanted rise is the largest
        for (h, i) in heat.iter_mut().zip(&out.i) {
            energy += (i * i - energy) * out.dt / tau;
            *h = energy;
        }
        let most = heat.iter().copied().fold(1e-12, f64::max);
        heat.iter_mut().for_each(|h| *h *= dt_max / most);
    } else if dt_max > 0.0 {
        for (k, h) in heat.iter_mut().enumerate() {
            *h = dt_max * (1.0 - (-(k as f64) * out.dt / tau).exp()) / full;
        }
    }
    for (k, warmer) in heat.into_iter().enumerate() {
        let di = (out.i[(k + 1).min(n - 1)] - out.i[k.saturating_sub(1)]) / (2.0 * out.dt);
        let emf = laws.ke * (1.0 + laws.ripple.at(out.th[k])) * out.w[k];
        let r = laws.r * (1.0 + 0.00393 * warmer);
        let mut v = r * out.i[k] + laws.l * di + emf;
        if laws.dead[0] != 0.0 {
            v += laws.dead[0] * (out.i[k] / laws.dead[1]).tanh();
        }
        // the bus gives v at a duty v / v_dc and is loaded by duty times current
        let root = (laws.v0 * laws.v0 - 4.0 * laws.sag * v * out.i[k]).max(0.0).sqrt();
        let v_dc = 0.5 * (laws.v0 + root);
        out.v.push(v * laws.v0 / v_dc);
        out.v_dc.push(v_dc);
    }
    debug_assert!(matches!(rig.drive, Drive::Current));
}
