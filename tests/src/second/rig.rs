//! Drawing a rig: kind, sizes, excitation, sampling, sensors.

use super::dice::Dice;
use super::needs::Needs;
use std::f64::consts::{PI, TAU};

/// What is fed into the rig and recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// A current in A.
    Current,
    /// A torque in N m (a force in N on a linear rig).
    Torque,
    /// The input voltage of an amplifier that commands the current.
    Amplifier,
}

/// How the rig is excited.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// An ideal servo prescribes the motion.
    Ideal,
    /// Position and speed controller.
    Loop,
    /// Steps of the drive, one direction.
    Spin,
}

/// Controller: position loop around a PI speed loop.
#[derive(Clone, Copy, Debug, Default)]
pub struct Control {
    /// Fine steps between two ticks; 0: no controller.
    pub every: usize,
    /// Position gain, 1/s.
    pub kpos: f64,
    /// Speed gain, drive unit per rad/s.
    pub kp: f64,
    /// Integral gain, drive unit per rad.
    pub ki: f64,
    /// Limit of the commanded speed.
    pub w_limit: f64,
    /// Limit of the drive.
    pub limit: f64,
    /// Time constant of the drive.
    pub lag: f64,
    /// Bandwidth of the speed loop, rad/s.
    pub band: f64,
    /// Whether the bench file describes it.
    pub told: bool,
}

/// What the sensors do to the signals; motor-side SI units.
#[derive(Clone, Debug, Default)]
pub struct Sees {
    /// Noise of the speed, the drive signal and the voltage: rms per sample.
    pub velocity: f64,
    /// Noise of the drive signal.
    pub drive: f64,
    /// Noise of the voltage.
    pub voltage: f64,
    /// Half of the noise power is coloured.
    pub coloured: bool,
    /// Corner of the coloured part, Hz.
    pub corner: f64,
    /// Bits of the drive's converter.
    pub adc: u32,
    /// Hum on the drive signal: amplitude and frequency.
    pub hum: (f64, f64),
    /// Gain error and offset of the drive signal that are no hidden effect.
    pub gain: f64,
    /// Offset of the drive signal.
    pub offset: f64,
    /// Averaged over the sample: drive, voltage, speed.
    pub mean: [bool; 3],
    /// Delay that the bench file states: on the drive (0) or the speed (1).
    pub known: Option<(usize, f64)>,
    /// Delay that it does not state.
    pub unknown: Option<(usize, f64)>,
    /// Noise and resolution are stated.
    pub stated: bool,
    /// The speed comes from a sensor of its own, not from the encoder.
    pub tacho: bool,
}

/// One rig.
#[derive(Clone, Debug)]
pub struct Rig {
    /// Linear, with metres per turn.
    pub lead: Option<f64>,
    /// Gear between motor and user.
    pub gear: f64,
    /// Drive signal.
    pub drive: Drive,
    /// Terminal voltage measured.
    pub volt: bool,
    /// Bus voltage measured.
    pub bus: bool,
    /// User position measured.
    pub user: bool,
    /// A known load acts and is measured.
    pub loaded: bool,
    /// Temperature measured.
    pub temp: bool,
    /// Position, speed in the file.
    pub has: (bool, bool),
    /// Excitation.
    pub mode: Mode,
    /// Single direction under an ideal servo.
    pub one_way: bool,
    /// Travel centred about zero.
    pub centred: bool,
    /// Constants: inertia, viscous, coulomb, torque per drive unit.
    pub j: f64,
    /// Viscous friction.
    pub c: f64,
    /// Coulomb friction.
    pub tc: f64,
    /// Torque per drive unit.
    pub kt: f64,
    /// Electrical: resistance, inductance, nominal supply.
    pub r: f64,
    /// Inductance.
    pub l: f64,
    /// Nominal supply.
    pub v0: f64,
    /// Largest speed.
    pub w_max: f64,
    /// Frequencies of the motion.
    pub f: (f64, f64),
    /// Typical acceleration.
    pub a_max: f64,
    /// Typical largest torque.
    pub t_ref: f64,
    /// Samples per second, duration.
    pub rate: f64,
    /// Duration of a run.
    pub span: f64,
    /// Fine steps per sample.
    pub fine: usize,
    /// Uneven clock.
    pub jitter: bool,
    /// Resolution of the motor's and of the user's encoder, motor side.
    pub encoder: f64,
    /// Resolution of the user's encoder.
    pub user_res: f64,
    /// Controller.
    pub control: Control,
    /// Sensors.
    pub sees: Sees,
    /// The law's form departs from the table.
    pub other: bool,
    /// One file with windows.
    pub one_file: bool,
}

impl Rig {
    /// Draws a rig that meets the demands of what it shall hide.
    pub fn draw(need: &Needs, names: &[&str], d: &mut Dice) -> Rig {
        let ecc = names.contains(&"encoder_eccentricity");
        let cue = d.pick(&[0, 1, 2]);
        let volt = need.voltage || (ecc && cue == 2);
        let lead = (d.chance(0.25) && !need.controller && !volt).then(|| d.logu(4e-3, 4e-2));
        let mut user = need.user || (ecc && cue == 0) || d.chance(0.12);
        let kind = d.weighted(&[0.5, 0.15, 0.15, 0.2]);
        let extra_volt = kind == 3 && lead.is_none() && !need.controller;
        let volt = volt || extra_volt;
        let drive = match kind {
            _ if volt || need.controller => Drive::Current,
            1 if !need.not_torque => Drive::Torque,
            2 => Drive::Amplifier,
            _ => Drive::Current,
        };
        let gear = if lead.is_none() && d.chance(0.4) && !need.controller {
            d.pick(&[3.7, 5.0, 10.0, 14.0, 27.0, 50.0])
        } else {
            1.0
        };
        let mut mode = match d.weighted(&[0.45, 0.35, 0.2]) {
            0 => Mode::Ideal,
            1 => Mode::Loop,
            _ => Mode::Spin,
        };
        if need.controller {
            mode = Mode::Loop;
        } else if mode == Mode::Spin && (need.both_ways || need.bounded || need.load || need.user) {
            mode = d.pick(&[Mode::Ideal, Mode::Loop]);
        }
        let one_way = mode == Mode::Ideal && !need.both_ways && !need.bounded && !need.load && d.chance(0.2);

        // sampling
        let mut rate: f64 = d.pick(&[
            500.0, 800.0, 1000.0, 1000.0, 1250.0, 2000.0, 2000.0, 4000.0, 5000.0, 10000.0, 20000.0,
        ]);
        if need.controller {
            rate = d.pick(&[1000.0, 2000.0, 4000.0]);
        }
        let mut span: f64 = d.uni(8.0, 30.0);
        span = span.min((40000.0 / rate).max(8.0)).min(118000.0 / rate);
        let jitter = mode != Mode::Loop && d.chance(0.15);
        let step: f64 = if mode == Mode::Ideal { 1e-4 } else { 5e-5 };
        let fine = ((1.0 / rate / step).ceil() as usize).max(if rate > 8000.0 { 2 } else { 4 });

        // sizes
        let j = if lead.is_some() {
            d.logu(1e-6, 3e-4)
        } else {
            d.logu(1e-6, 1e-2)
        };
        let mut w_max = d.logu(5.0, 600.0);
        let mut f_lo: f64 = d.uni(0.15, 0.5);
        if need.revolutions {
            w_max = d.logu(20.0, 150.0);
            f_lo = f_lo.min(w_max / 160.0).max(0.1);
        }
        if need.slow {
            f_lo = f_lo.max(2.0 / span);
        }
        if names.contains(&"presliding") {
            f_lo = d.uni(0.4, 0.8);
        }
        f_lo = f_lo.max(1.0 / span);
        let top = if mode == Mode::Loop { 3.0 } else { 6.0 };
        let f = (f_lo, (f_lo * d.uni(4.0, 15.0)).min(top).max(2.0 * f_lo));
        let a_max = 0.8 * w_max * TAU * (f.0 * f.1).sqrt();
        let t_in = j * a_max;
        let (tc, c) = if mode == Mode::Spin {
            let c = j / d.logu(0.1, 1.2);
            (c * w_max * d.uni(0.2, 0.6), c)
        } else {
            let least = if need.friction || need.both_ways { 0.4 } else { 0.15 };
            let tc = t_in * d.logu(least, 1.3);
            (tc, (tc * d.logu(0.25, 1.5)).max(least * t_in) / w_max)
        };
        let loaded = need.load || (mode != Mode::Spin && d.chance(0.12));
        let t_ref = (if mode == Mode::Spin { 0.0 } else { t_in }) + tc + c * w_max;
        let t_peak = t_ref * if loaded { 1.8 } else { 1.0 };
        let i_ref = match drive {
            Drive::Current => d.logu(0.5, 30.0),
            Drive::Amplifier => d.uni(2.0, 8.0),
            Drive::Torque => t_peak,
        };
        let kt = t_peak / i_ref;
        let r = kt * w_max / i_ref * d.logu(0.4, 1.5);
        let l = r * d.logu(2e-4, 3e-3);
        let v_ref = r * i_ref + kt * w_max;
        let v0 = 1.8 * v_ref;

        // channels
        let has = match d.weighted(&if need.angle {
            [0.35, 0.65, 0.0]
        } else {
            [0.3, 0.45, 0.25]
        }) {
            0 => (true, ecc && cue == 1),
            1 => (true, true),
            _ => (false, true),
        };
        let has = if need.controller { (true, true) } else { has };
        user &= has.0;
        let mut bits = 10 + (d.u() * 11.0) as i32;
        let travel = w_max / (TAU * f.0);
        let unit = |b: i32| TAU / 2f64.powi(b);
        let rough = |b: i32| unit(b) * 0.29 / (rate * 0.02).sqrt() * 2.4 / 4e-4;
        while bits < 22 && (unit(bits) > travel / 1500.0 || (!has.1 && rough(bits) > 0.05 * a_max)) {
            bits += 1;
        }
        if need.user || names.contains(&"presliding") || ecc || need.controller {
            bits = bits.max(14);
        }
        let user_bits = if need.user || ecc {
            15 + (d.u() * 6.0) as i32
        } else {
            13 + (d.u() * 8.0) as i32
        };
        let levels = [0.0004, 0.0015, 0.005, 0.015];
        let w_levels = [0.0002, 0.0008, 0.0025, 0.006];
        let mut sees = Sees {
            velocity: d.pick(&w_levels) * w_max,
            drive: d.pick(&levels) * i_ref,
            voltage: d.pick(&levels) * v_ref * 0.7,
            coloured: d.chance(0.2),
            corner: d.logu(8.0, 60.0),
            adc: d.pick(&[12, 13, 14, 16]),
            hum: (0.0, d.pick(&[50.0, 60.0, 400.0])),
            mean: [!d.chance(0.3), true, d.chance(0.25)],
            stated: d.chance(0.7),
            tacho: d.chance(0.4),
            ..Sees::default()
        };
        if d.chance(0.15) {
            sees.hum.0 = d.uni(0.002, 0.008) * i_ref;
        }
        let sensing = names.iter().any(|n| n.starts_with("current_"));
        if d.chance(0.15) && !sensing {
            sees.gain = d.uni(-0.005, 0.005);
        }
        if d.chance(0.12) && !sensing {
            sees.offset = d.uni(-0.004, 0.004) * i_ref;
        }
        let late = |d: &mut Dice| if has.1 { d.pick(&[0, 1]) } else { 0 };
        if d.chance(0.2) && !need.controller {
            sees.known = Some((late(d), d.uni(0.2, 3.0) / rate));
        } else if d.chance(0.2) && !need.controller {
            sees.unknown = Some((late(d), (d.uni(0.3, 2.5) / rate).min(5e-3)));
        }
        if ecc {
            sees.tacho = cue == 1;
        }
        if need.controller {
            sees.velocity = sees.velocity.min(0.001 * w_max);
        }
        if sees.hum.1 > 0.4 * rate {
            sees.hum.1 = 50.0;
        }
        let mut control = Control::default();
        if mode == Mode::Loop {
            let band = TAU * d.uni(8.0, 20.0);
            let told = need.controller
                || (lead.is_none() && gear == 1.0 && (1000.0..=4000.0).contains(&rate) && d.chance(0.5));
            if told {
                // the log holds what the controller saw, sample by sample
                (sees.known, sees.unknown, sees.mean[2]) = (None, None, false);
            }
            let tick = if told {
                fine
            } else {
                ((5e-4 * rate * fine as f64).round() as usize).max(1)
            };
            let kp = j * band / kt;
            control = Control {
                every: tick,
                kpos: band / d.uni(4.0, 7.0),
                kp,
                ki: kp * band / d.uni(5.0, 10.0),
                w_limit: 1.3 * w_max,
                limit: 2.2 * i_ref,
                lag: d.logu(1e-4, 6e-4),
                band,
                told,
            };
        }
        Rig {
            lead,
            gear,
            drive,
            volt,
            bus: volt && d.chance(0.6),
            user,
            loaded,
            temp: need.temperature || d.chance(0.1) && !names.contains(&"winding_heating"),
            has,
            mode,
            one_way,
            centred: !one_way,
            j,
            c,
            tc,
            kt,
            r,
            l,
            v0,
            w_max,
            f,
            a_max,
            t_ref,
            rate,
            span,
            fine,
            jitter,
            encoder: unit(bits),
            user_res: unit(user_bits) * gear.min(if need.user || ecc { 3.0 } else { 100.0 }),
            control,
            sees,
            other: d.chance(1.0 / 3.0),
            one_file: d.chance(0.2),
        }
    }

    /// Metres per radian of the motor; 1 for a rotary rig.
    pub fn reach(&self) -> f64 {
        self.lead.map_or(1.0, |l| l / (2.0 * PI))
    }

    /// Drive signal that belongs to the typical largest torque.
    pub fn i_ref(&self) -> f64 {
        self.t_ref * if self.loaded { 1.8 } else { 1.0 } / self.kt
    }

    /// Scales the noise of all sensors down; a rig without a speed sensor gets a finer encoder.
    pub fn quieten(&mut self, by: f64) {
        if by >= 1.0 {
            return;
        }
        for x in [&mut self.sees.velocity, &mut self.sees.drive, &mut self.sees.voltage] {
            *x *= by;
        }
        let bits = (-by.log2()).ceil();
        let finest = TAU / 2f64.powi(22);
        if !self.has.1 {
            self.encoder = (self.encoder / bits.exp2()).max(finest);
        }
        self.user_res = (self.user_res / bits.exp2()).max(finest);
    }
}
