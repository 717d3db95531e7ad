//! Time of every ready question over a synthetic fleet of 5400 actuators (1.0 million map runs, 0.1 million
//! tests), warm, beside controls in the same run: the same columns read and not used, and SQL over the same files.

use arrow::array::{ArrayRef, Float64Array, RecordBatch, StringArray, UInt64Array};
use ema_query::{Question, query};
use parquet::arrow::ArrowWriter;
use polars::prelude::Engine;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

const ACTUATORS: usize = 5400;
const TESTS: usize = 19;
const POSITIONS: usize = 12;
const REPEATS: usize = 9;

/// Numbers in -1 to 1, the same for the same seed.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 as f64 / (1u64 << 63) as f64 - 1.0
    }
}

#[derive(Default)]
struct Columns(Vec<(String, Column)>);

enum Column {
    Text(Vec<String>),
    Float(Vec<Option<f64>>),
    Number(Vec<u64>),
}

impl Columns {
    fn text(&mut self, name: &str, value: impl Into<String>) {
        match self.at(name, || Column::Text(Vec::new())) {
            Column::Text(v) => v.push(value.into()),
            _ => unreachable!("a text"),
        }
    }

    fn float(&mut self, name: &str, value: impl Into<Option<f64>>) {
        match self.at(name, || Column::Float(Vec::new())) {
            Column::Float(v) => v.push(value.into()),
            _ => unreachable!("a float"),
        }
    }

    fn number(&mut self, name: &str, value: u64) {
        match self.at(name, || Column::Number(Vec::new())) {
            Column::Number(v) => v.push(value),
            _ => unreachable!("a number"),
        }
    }

    fn at(&mut self, name: &str, new: impl Fn() -> Column) -> &mut Column {
        let i = self.0.iter().position(|(n, _)| n == name).unwrap_or_else(|| {
            self.0.push((name.into(), new()));
            self.0.len() - 1
        });
        &mut self.0[i].1
    }

    fn rows(&self) -> usize {
        match &self.0[0].1 {
            Column::Text(v) => v.len(),
            Column::Float(v) => v.len(),
            Column::Number(v) => v.len(),
        }
    }

    fn batch(self) -> RecordBatch {
        let array = |c| match c {
            Column::Text(v) => Arc::new(StringArray::from(v)) as ArrayRef,
            Column::Float(v) => Arc::new(Float64Array::from(v)) as ArrayRef,
            Column::Number(v) => Arc::new(UInt64Array::from(v)) as ArrayRef,
        };
        RecordBatch::try_from_iter(self.0.into_iter().map(|(n, c)| (n, array(c)))).expect("columns of one length")
    }
}

/// A Parquet file written as those of a dataset are.
struct File(Option<ArrowWriter<std::fs::File>>, std::path::PathBuf);

impl File {
    fn new(path: &Path) -> Self {
        std::fs::create_dir_all(path.parent().expect("in a folder")).expect("a folder");
        Self(None, path.into())
    }

    /// Writes the columns as a row group of its own.
    fn group(&mut self, columns: Columns) {
        let batch = columns.batch();
        let writer = self.0.get_or_insert_with(|| {
            let properties = schemas::table::query_properties(&batch.schema(), Vec::new());
            let file = std::fs::File::create(&self.1).expect("a file");
            ArrowWriter::try_new(file, batch.schema(), Some(properties)).expect("a writer")
        });
        writer.write(&batch).expect("written");
        writer.flush().expect("a row group");
    }
}

impl Drop for File {
    fn drop(&mut self) {
        if let Some(w) = self.0.take() {
            w.close().expect("closed");
        }
    }
}

/// A fleet dataset; `shift` moves its maps.
fn dataset(dir: &Path, shift: f64) {
    let mut noise = Noise(0x9e37_79b9_7f4a_7c15);
    let mut features = File::new(&dir.join("features/part-0000.parquet"));
    let mut actuators = File::new(&dir.join("actuators/part-0000.parquet"));
    let mut diagnoses = File::new(&dir.join("diagnoses/part-0000.parquet"));
    let (mut f, mut a, mut d) = (Columns::default(), Columns::default(), Columns::default());
    let mut run = 0;
    for k in 0..ACTUATORS {
        let tail = format!("T-{:04}", k / POSITIONS);
        let position = format!("aileron-{:02}", k % POSITIONS);
        let name = format!("{tail}.{position}");
        let drawn: [f64; 4] = std::array::from_fn(|_| noise.next());
        a.text("actuator", &name);
        a.text("tail", &tail);
        a.text("position", &position);
        for (n, v) in [
            ("supply_voltage_v", 48.0 * (1.0 + 0.02 * drawn[0])),
            ("phase_resistance_ohm", 0.4 * (1.0 + 0.05 * drawn[1])),
            ("inertia_kg_m2", 2e-5 * (1.0 + 0.05 * drawn[2])),
            ("dynamic_friction_ratio", 0.5 * (1.0 + 0.1 * drawn[3])),
            ("gear_ratio", 500.0),
        ] {
            a.float(n, v);
        }
        for test in 0..187 + TESTS {
            let (kind, fsj, zeta) = if test < 187 {
                ("map", 1.0 + 0.25 * (test % 17) as f64, 0.05 * (test / 17) as f64)
            } else {
                ("test", 3.0 + 2.0 * noise.next(), 0.25 + 0.25 * noise.next())
            };
            let (ripple, loss) = (
                0.0005 + 0.016 * zeta,
                0.02 * (fsj - 1.0) * (1.0 + 0.05 * drawn[3]) + 0.01 * zeta,
            );
            let mut jitter = |x: f64, by: f64| x * (1.0 + by * noise.next()) + shift;
            let p2 = jitter((0.03 + 0.2 * (fsj - 1.0) + zeta) * (1.0 + 0.05 * drawn[1]), 0.01);
            let p3 = jitter(1.0 + (fsj - 1.0) * (1.0 + 0.1 * drawn[3]), 0.02);
            let rise = jitter(0.007 * (1.0 + 0.05 * drawn[2]) + 0.0002 * fsj, 0.005);
            let rms = jitter(0.43 + 0.4 * fsj + 0.3 * zeta * (1.0 + 0.02 * drawn[0]), 0.005);
            let (ripple, loss) = (jitter(ripple, 0.01), jitter(loss, 0.01));
            f.number("run", run);
            for (n, v) in [("actuator", &name), ("tail", &tail), ("position", &position)] {
                f.text(n, v);
            }
            f.text("sequence", "preflight");
            f.text("kind", kind);
            for (n, v) in [
                ("fsj", fsj),
                ("zeta", zeta),
                ("rest_angle_rad", 0.0),
                ("p1_rad_per_s", ripple.hypot(loss)),
                ("p3", p3),
                ("speed_loss_rad_per_s", loss),
                ("mean_speed_rad_per_s", 1.24 - loss),
                ("ripple_rad_per_s", ripple),
                ("p2_a", p2),
                ("p3_rad", 6.3e-6 * p3),
                ("rise_s", rise),
                ("current_rms_a", rms),
            ] {
                f.float(n, v);
            }
            for n in [
                "mean_speed_sd_rad_per_s",
                "ripple_sd_rad_per_s",
                "p2_sd_a",
                "p3_sd_rad",
                "rise_sd_s",
            ] {
                f.float(n, 1e-5 * (2.0 + noise.next()));
            }
            f.float("current_rms_sd_a", 1e-4 * (2.0 + noise.next()));
            if kind == "test" {
                d.number("run", run);
                for (n, v) in [("actuator", &name), ("tail", &tail), ("position", &position)] {
                    d.text(n, v);
                }
                d.text("sequence", "preflight");
                d.float("fsj", fsj);
                d.float("zeta", zeta);
                let located = noise.next() < 0.95;
                d.text("outcome", if located { "located" } else { "unexplained" });
                for (fault, exact, width) in [("fsj", fsj, 0.1), ("zeta", zeta, 0.005)] {
                    let estimate = exact + 0.4 * width * noise.next();
                    for (end, by) in [("lo", -0.5), ("hi", 0.5), ("estimate", 0.0)] {
                        d.float(&format!("{fault}_{end}"), located.then_some(estimate + by * width));
                    }
                }
                d.float("coverage", 0.95);
                d.text("maps", if run % 2 == 0 { "own" } else { "type" });
            }
            run += 1;
        }
        // row groups of about 64k rows, cut between actuators
        if f.rows() + 187 + TESTS > 65_536 {
            features.group(std::mem::take(&mut f));
        }
    }
    features.group(f);
    actuators.group(a);
    diagnoses.group(d);
}

/// Processor time of this process so far [ms], in ticks of 10 ms; NaN where the system does not say.
fn processor() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = stat.rsplit(')').next().unwrap_or_default();
    let fields: Vec<f64> = after.split(' ').flat_map(str::parse).collect();
    // numbers after the name and the state; 10 and 11 are user and system time
    fields.get(10..12).map_or(f64::NAN, |t| 10.0 * (t[0] + t[1]))
}

/// Median time [ms], mean processor time of all cores [ms], and the last answer; the first one is not counted.
fn time<T>(mut work: impl FnMut() -> T) -> (f64, f64, T) {
    let mut answer = work();
    let begin = processor();
    let mut times: Vec<f64> = (0..REPEATS)
        .map(|_| {
            let start = Instant::now();
            answer = work();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    (times[REPEATS / 2], (processor() - begin) / REPEATS as f64, answer)
}

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [first, second] = ["first", "second"].map(|n| folder.path().join(n));
    dataset(&first, 0.0);
    dataset(&second, 1e-4);
    let count = |table: &str| {
        let n = query(&first, &format!("SELECT COUNT(*) AS n FROM {table}")).expect("counted");
        n.column("n").and_then(|c| c.get(0)).expect("one row").to_string()
    };
    println!(
        "{} features, {} diagnoses, {} actuators; median of {REPEATS}, warm [ms]",
        count("features"),
        count("diagnoses"),
        count("actuators")
    );
    println!(
        "{:24} {:>8} {:>8} {:>9} {:>20} {:>9}",
        "question", "rows", "answer", "processor", "control: reading", "processor"
    );
    for q in Question::ALL {
        let other = q.compares().then_some(second.as_path());
        let (whole, cpu, answer) = time(|| q.ask(&first, other).expect("an answer"));
        let (read, read_cpu, _) = time(|| {
            for frame in q.reads(&first, other).expect("a plan") {
                frame.collect_with_engine(Engine::Streaming).expect("columns");
            }
        });
        let rows = answer.frame.height();
        println!(
            "{:24} {rows:>8} {whole:>8.1} {cpu:>9.0} {read:>20.1} {read_cpu:>9.0}",
            q.name()
        );
    }
    println!("control: SQL over the same files");
    for sql in [
        "SELECT fsj, zeta, AVG(p2_a) AS p2, STDDEV(p2_a) AS sd FROM features WHERE kind = 'map' GROUP BY fsj, zeta",
        "SELECT AVG(p1_rad_per_s) AS p1 FROM features WHERE run = 500000",
        "SELECT maps, fault, AVG(width) AS width, AVG(CAST(inside AS DOUBLE)) AS inside FROM intervals GROUP BY maps, fault",
    ] {
        let (ms, _, answer) = time(|| query(&first, sql).expect("an answer"));
        println!("{ms:>8.1}  {} rows  {sql}", answer.height());
    }
}
