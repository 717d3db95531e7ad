//! Telemetry: sampling, the reference sensor model, and the CSV file.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::plant::DT;
use super::{Command, Plant, Unit};

/// Columns every recording has.
const COLUMNS: [&str; 13] = [
    "t", "com", "theta_u", "theta_m", "omega_m", "i_eq", "i_a", "i_b", "i_c", "v_a", "v_b", "v_c", "v_dc",
];
/// Counts of the resolver a turn.
const RESOLVER: f64 = 65_536.0;
/// Noise of the speed [rad/s], one sigma.
const SPEED_NOISE: f64 = 0.2;
/// Range of a current sensor [A], plus and minus, its counts, its noise (one sigma) and the limit of its offset.
const CURRENT: (f64, f64, f64, f64) = (25.0, 4096.0, 0.02, 0.02);
/// Noise of the thermometer, where there is one [K].
const TEMPERATURE_NOISE: f64 = 0.2;

/// A recording.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Telemetry {
    /// Time stamps, each the end of its interval [s].
    pub t: Vec<f64>,
    /// Command of the interval's last step [rad].
    pub com: Vec<f64>,
    /// User position [rad].
    pub theta_u: Vec<f64>,
    /// Motor position [rad].
    pub theta_m: Vec<f64>,
    /// Motor speed [rad/s].
    pub omega_m: Vec<f64>,
    /// Equivalent current [A].
    pub i_eq: Vec<f64>,
    /// Phase currents, means over the interval [A].
    pub i: [Vec<f64>; 3],
    /// Phase voltages, ideal leg minus star point, means over the interval [V].
    pub v: [Vec<f64>; 3],
    /// Supply voltage, mean over the interval [V].
    pub v_dc: Vec<f64>,
    /// Temperature of the winding [deg C]; empty without a thermometer.
    pub temperature: Vec<f64>,
}

/// Draws of the sensors in one run.
struct Sensors {
    rng: ChaCha8Rng,
    offset: [f64; 3],
    spare: Option<f64>,
}

impl Sensors {
    fn new(seed: u64) -> Sensors {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(7);
        let limit = CURRENT.3;
        let offset = [0; 3].map(|_| rng.random_range(-limit..=limit));
        Sensors {
            rng,
            offset,
            spare: None,
        }
    }

    /// A standard normal number (Box and Muller, in pairs).
    fn normal(&mut self) -> f64 {
        if let Some(value) = self.spare.take() {
            return value;
        }
        let radius = (-2.0 * (1.0 - self.rng.random::<f64>()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.rng.random::<f64>()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }

    fn angle(x: f64) -> f64 {
        let count = std::f64::consts::TAU / RESOLVER;
        (x / count).round() * count
    }

    fn current(&mut self, q: usize, x: f64) -> f64 {
        let (range, counts, noise, _) = CURRENT;
        let count = 2.0 * range / counts;
        let raw = x + self.offset[q] + noise * self.normal();
        ((raw / count).round() * count).clamp(-range, range - count)
    }
}

/// Runs `unit` under `command` with `faults` (friction multiplier, eccentricity) and records it.
///
/// With `sensors` the channels go through the reference sensor model, drawn from `seed`; without, they are exact.
pub fn record(
    unit: &Unit,
    command: &Command,
    seconds: f64,
    rate_hz: f64,
    faults: (f64, f64),
    sensors: bool,
    seed: u64,
) -> Telemetry {
    let per_sample = (1.0 / (rate_hz * DT)).round().max(1.0) as usize;
    let samples = (seconds / DT / per_sample as f64).round() as usize;
    let mut plant = Plant::new(unit, faults);
    let mut steps = command.steps();
    let mut noise = sensors.then(|| Sensors::new(seed));
    let mut telemetry = Telemetry::default();
    let share = 1.0 / per_sample as f64;
    for n in 0..samples {
        let (mut com, mut i_eq, mut i, mut v, mut v_dc) = (0.0, 0.0, [0.0; 3], [0.0; 3], 0.0);
        for _ in 0..per_sample {
            com = steps.next_value();
            plant.step(com);
            for q in 0..3 {
                i[q] += plant.i_measured[q];
                i_eq += plant.i_measured[q].abs();
                v[q] += plant.v[q];
            }
            v_dc += plant.v_dc;
        }
        let row = Row {
            t: ((n + 1) * per_sample) as f64 * DT,
            com,
            i_eq: 0.5 * i_eq * share,
            i: i.map(|x| x * share),
            v: v.map(|x| x * share),
            v_dc: v_dc * share,
        };
        telemetry.push(row, &plant, unit, noise.as_mut());
    }
    telemetry
}

/// What is averaged over an interval.
struct Row {
    t: f64,
    com: f64,
    i_eq: f64,
    i: [f64; 3],
    v: [f64; 3],
    v_dc: f64,
}

/// Rounds to a number of decimals, so that the file and the frame carry the same, short values (and no negative zero).
fn decimals(x: f64, scale: f64) -> f64 {
    (x * scale).round() / scale + 0.0
}

impl Telemetry {
    fn push(&mut self, row: Row, plant: &Plant, unit: &Unit, noise: Option<&mut Sensors>) {
        let mut row = row;
        let (mut theta_m, mut theta_u, mut omega) = (plant.measured_angle(), plant.thu, plant.w);
        let mut temperature = plant.temperature();
        if let Some(noise) = noise {
            theta_m = decimals(Sensors::angle(theta_m), 1e9);
            theta_u = if plant.has_user_sensor() {
                Sensors::angle(theta_u * unit.gear) / unit.gear
            } else {
                (theta_m - unit.th0) / unit.gear
            };
            theta_u = decimals(theta_u, 1e12);
            omega = decimals(omega + SPEED_NOISE * noise.normal(), 1e6);
            for q in 0..3 {
                row.i[q] = decimals(noise.current(q, row.i[q]), 1e9);
                row.v[q] = decimals(row.v[q], 1e6);
            }
            row.i_eq = 0.5 * row.i.iter().map(|x| x.abs()).sum::<f64>();
            row.i_eq = decimals(row.i_eq, 1e9);
            row.v_dc = decimals(row.v_dc, 1e6);
            row.com = decimals(row.com, 1e12);
            if unit.thermometer {
                temperature = decimals(temperature + TEMPERATURE_NOISE * noise.normal(), 10.0);
            }
        }
        self.t.push(decimals(row.t, 1e9));
        self.com.push(row.com);
        self.theta_u.push(theta_u);
        self.theta_m.push(theta_m);
        self.omega_m.push(omega);
        self.i_eq.push(row.i_eq);
        for q in 0..3 {
            self.i[q].push(row.i[q]);
            self.v[q].push(row.v[q]);
        }
        self.v_dc.push(row.v_dc);
        if unit.thermometer {
            self.temperature.push(temperature);
        }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.t.len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.t.is_empty()
    }

    /// Writes the CSV text: one header line, numbers in their shortest exact form.
    pub fn write<W: Write>(&self, mut out: W) -> io::Result<()> {
        write!(out, "{}", COLUMNS.join(","))?;
        writeln!(
            out,
            "{}",
            if self.temperature.is_empty() {
                ""
            } else {
                ",temperature"
            }
        )?;
        let [ia, ib, ic] = &self.i;
        let [va, vb, vc] = &self.v;
        let columns = [
            &self.t,
            &self.com,
            &self.theta_u,
            &self.theta_m,
            &self.omega_m,
            &self.i_eq,
            ia,
            ib,
            ic,
            va,
            vb,
            vc,
            &self.v_dc,
            &self.temperature,
        ];
        for n in 0..self.len() {
            let mut separator = "";
            for column in columns.iter().filter(|c| !c.is_empty()) {
                write!(out, "{separator}{}", column[n])?;
                separator = ",";
            }
            writeln!(out)?;
        }
        Ok(())
    }

    /// Writes the CSV file.
    pub fn write_csv(&self, path: &Path) -> io::Result<()> {
        let mut out = BufWriter::new(File::create(path)?);
        self.write(&mut out)?;
        out.flush()
    }
}
