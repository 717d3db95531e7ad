//! Checksums of the values in a telemetry file, by run: a flipped bit that a decoder takes for a value is found on
//! reading. They are of the values, not of the bytes: a file written again with another codec keeps them.

use crate::channel::Channel;
use crate::error::{Error, Result};
use arrow::array::{Array, ArrayRef, AsArray, RecordBatch};
use arrow::datatypes::{DataType, FieldRef, Fields, Float32Type, Float64Type, Int64Type, UInt64Type};
use blake3::{Hash, Hasher};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Key of the metadata: a line each run.
pub(crate) const KEY: &str = "ema.checksums";

/// Columns beside the channels that are covered.
const BESIDE: [&str; 4] = ["fsj", "zeta", "rest_angle_rad", "t_ns"];

/// What a file says of itself, but for its checksums.
fn said(pairs: &BTreeMap<String, String>) -> String {
    let ours = pairs.iter().filter(|(k, _)| k.starts_with("ema.") && *k != KEY);
    ours.map(|(k, v)| format!("{k}={v}\n")).collect()
}

/// The values of a run on their way.
#[derive(Debug, Default)]
pub(crate) struct RunSum {
    rows: u64,
    /// by column, in the order of the table
    columns: Vec<(String, Hasher)>,
}

impl RunSum {
    /// The next rows of the run.
    pub(crate) fn take(&mut self, fields: &Fields, columns: &[ArrayRef]) {
        self.rows += columns.first().map_or(0, |c| c.len() as u64);
        let is_covered = |name: &str| BESIDE.contains(&name) || Channel::from_name(name).is_some();
        let covered = fields.iter().zip(columns).filter(|(f, _)| is_covered(f.name()));
        for (n, (field, values)) in covered.enumerate() {
            if self.columns.len() == n {
                self.columns.push((field.name().clone(), Hasher::new()));
            }
            update(&mut self.columns[n].1, values);
        }
    }

    /// Of all that were taken: names and values.
    pub(crate) fn finish(&self) -> RunDigest {
        let mut all = Hasher::new();
        for (name, values) in &self.columns {
            all.update(name.as_bytes());
            all.update(values.finalize().as_bytes());
        }
        RunDigest {
            rows: self.rows,
            values: all.finalize(),
        }
    }
}

/// Of a whole run.
#[derive(Clone, Debug)]
pub(crate) struct RunDigest {
    rows: u64,
    values: Hash,
}

impl RunDigest {
    /// A line of the metadata: number of the run, rows, checksum of what the file says of itself and of the values.
    fn line(&self, run: u64, said: &str) -> String {
        let mut all = Hasher::new();
        all.update(said.as_bytes()).update(self.values.as_bytes());
        format!("{run} {} {}\n", self.rows, all.finalize().to_hex())
    }
}

/// The pair of metadata of a file that holds these runs and says `pairs` of itself.
pub(crate) fn pair<'a>(
    pairs: impl IntoIterator<Item = (String, String)>,
    runs: impl IntoIterator<Item = (u64, &'a RunDigest)>,
) -> (String, String) {
    let said = said(&pairs.into_iter().collect());
    let lines = runs.into_iter().map(|(run, digest)| digest.line(run, &said));
    (KEY.into(), lines.collect())
}

/// The bits of a column's values, little endian; a null has those of the canonical NaN.
fn update(hasher: &mut Hasher, values: &ArrayRef) {
    if values.null_count() > 0 {
        if let Some(numbers) = values.as_primitive_opt::<Float64Type>() {
            for x in numbers {
                hasher.update(&x.unwrap_or(f64::NAN).to_le_bytes());
            }
        }
        return;
    }
    macro_rules! bytes {
        ($kind:ty) => {{
            let numbers = values.as_primitive::<$kind>().values();
            if cfg!(target_endian = "little") {
                hasher.update(numbers.inner().as_slice());
            } else {
                for x in numbers {
                    hasher.update(&x.to_le_bytes());
                }
            }
        }};
    }
    match values.data_type() {
        DataType::Float64 => bytes!(Float64Type),
        DataType::Float32 => bytes!(Float32Type),
        DataType::Int64 => bytes!(Int64Type),
        // another type than the table's: whoever reads the column refuses it
        _ => {}
    }
}

/// Rows of one run each: the number of the run, the first row, one past the last. Empty where there is no column of
/// run numbers.
fn runs(batch: &RecordBatch) -> Vec<(u64, usize, usize)> {
    let run = batch
        .column_by_name("run")
        .and_then(|c| c.as_primitive_opt::<UInt64Type>());
    let mut spans: Vec<(u64, usize, usize)> = Vec::new();
    for (i, &id) in run.iter().flat_map(|r| r.values()).enumerate() {
        match spans.last_mut() {
            Some((last, _, to)) if *last == id => *to = i + 1,
            _ => spans.push((id, i, i + 1)),
        }
    }
    spans
}

/// Compared while a file is read.
#[derive(Debug)]
pub(crate) struct Compared {
    path: PathBuf,
    said: String,
    /// Lines of runs that did not end yet, the next one last.
    due: Vec<String>,
    /// Of the run that is being read.
    run: Option<(u64, RunSum)>,
}

impl Compared {
    /// `None` where the file has no checksums: another program or an earlier version wrote it.
    pub(crate) fn of(path: &Path, pairs: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self {
            path: path.into(),
            due: pairs
                .get(KEY)?
                .split_inclusive('\n')
                .rev()
                .map(str::to_string)
                .collect(),
            said: said(pairs),
            run: None,
        })
    }

    /// The next rows of the file.
    ///
    /// # Errors
    /// A run that ends in them with other values than it was written with; runs that the metadata do not name.
    pub(crate) fn take(&mut self, batch: &RecordBatch) -> Result<()> {
        if batch.columns().iter().zip(batch.schema_ref().fields()).any(is_missed) {
            return Ok(()); // whoever reads it names the row; `end` knows that the run was not whole
        }
        for (id, from, to) in runs(batch) {
            let (run, sum) = self.run.get_or_insert_with(|| (id, RunSum::default()));
            let line = self.due.last().map(String::as_str).unwrap_or_default();
            // how many rows a run has is known before its last ones are handed out
            let rows = line.split(' ').nth(1).and_then(|n| n.parse().ok());
            if *run != id || rows.is_none_or(|n: u64| sum.rows + (to - from) as u64 > n) {
                return Err(changed(&self.path, id));
            }
            sum.take(batch.schema_ref().fields(), batch.slice(from, to - from).columns());
            if Some(sum.rows) == rows {
                if sum.finish().line(id, &self.said) != line {
                    return Err(changed(&self.path, id));
                }
                self.run = None;
                self.due.pop();
            }
        }
        Ok(())
    }

    /// All rows were taken.
    ///
    /// # Errors
    /// A run that did not come whole.
    pub(crate) fn end(&self) -> Result<()> {
        let run = self.due.last().and_then(|line| line.split(' ').next()?.parse().ok());
        self.due
            .last()
            .map_or(Ok(()), |_| Err(changed(&self.path, run.unwrap_or_default())))
    }
}

fn changed(path: &Path, run: u64) -> Error {
    let allowed = format!("the values that were written (without metadata `{KEY}` any are taken)");
    Error::bad(
        path.display().to_string(),
        format!("run {run}"),
        "another checksum",
        allowed,
    )
}

/// Whether a column that has no nulls when it is written has some.
fn is_missed((values, field): (&ArrayRef, &FieldRef)) -> bool {
    let name = field.name().as_str();
    values.null_count() > 0 && (["run", "t_ns"].contains(&name) || Channel::from_name(name).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::channel::ChannelSet;
    use crate::recording::{Provenance, Recorder, Recording};
    use crate::run_encoder::TelemetryLayout;
    use crate::table::{metadata, read_table};
    use crate::telemetry::{Collector, TelemetryBuffer, TelemetryHeader, TelemetrySink, TelemetryView};
    use arrow::array::{Float32Array, Float64Array};
    use parquet::arrow::ArrowWriter;
    use parquet::file::metadata::KeyValue;
    use parquet::file::properties::WriterProperties;
    use std::sync::Arc;

    const ROWS: usize = 500;

    fn channels() -> ChannelSet {
        ChannelSet::of([Channel::Com, Channel::OmegaM])
    }

    fn samples(first: u64) -> TelemetryBuffer {
        let mut buffer = TelemetryBuffer::new(channels(), ROWS);
        for c in channels().iter() {
            let values = buffer.column_mut(c).unwrap();
            values.extend((0..ROWS).map(|i| (first as f64 + i as f64).sin()));
        }
        buffer.first = first;
        buffer.set_rows(ROWS);
        buffer
    }

    fn about() -> Provenance {
        Provenance {
            rate_hz: 1000.0,
            ..Provenance::default()
        }
    }

    fn header(run: u64) -> TelemetryHeader {
        TelemetryHeader {
            run,
            actuator: String::new(),
            parameters: String::new(),
            sensors: String::new(),
            sequence: String::new(),
            rate_hz: 1000.0,
            channels: channels(),
            fault: None,
            rest_angle_rad: None,
        }
    }

    /// Two runs of two blocks each.
    fn recorded(path: &Path, single: bool) {
        let mut r = Recorder::create(path, &about(), channels(), single).unwrap();
        for run in [3, 8] {
            let header = header(run);
            for block in 0..2 {
                r.accept(&header, &samples(1 + block * ROWS as u64).view()).unwrap();
            }
        }
        r.finish().unwrap();
    }

    /// The file with its rows, or what it says of itself, as they are after `change`.
    fn changed_to(path: &Path, change: impl Fn(Vec<RecordBatch>, &mut BTreeMap<String, String>) -> Vec<RecordBatch>) {
        let mut said = metadata(path).unwrap();
        said.retain(|k, _| k.starts_with("ema."));
        let (_, batches) = read_table(path).unwrap();
        let batches = change(batches, &mut said);
        let said = said.into_iter().map(|(k, v)| KeyValue::new(k, v)).collect();
        let settings = WriterProperties::builder().set_key_value_metadata(Some(said)).build();
        let file = std::fs::File::create(path).unwrap();
        let mut w = ArrowWriter::try_new(file, batches[0].schema(), Some(settings)).unwrap();
        batches.iter().for_each(|b| w.write(b).unwrap());
        w.close().unwrap();
    }

    fn with_column(batch: &RecordBatch, name: &str, values: ArrayRef) -> RecordBatch {
        let mut columns = batch.columns().to_vec();
        columns[batch.schema().index_of(name).unwrap()] = values;
        RecordBatch::try_new(batch.schema(), columns).unwrap()
    }

    /// Samples by run.
    #[derive(Default)]
    struct Runs(BTreeMap<u64, usize>);

    impl TelemetrySink for Runs {
        fn accept(&mut self, header: &TelemetryHeader, view: &TelemetryView<'_>) -> Result<()> {
            *self.0.entry(header.run).or_default() += view.rows;
            Ok(())
        }
    }

    #[test]
    fn prop_a_flipped_bit_of_a_value_is_found_before_the_run_ends() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r.parquet");
        for (single, block) in [(true, 64), (false, 333), (false, 100_000)] {
            recorded(&path, single);
            let mut whole = Runs::default();
            Recording::open(&path).unwrap().replay(block, &mut whole).unwrap();
            assert_eq!(whole.0, [(3, 1000), (8, 1000)].into());
            // written again as it is
            changed_to(&path, |b, _| b);
            Recording::open(&path).unwrap().replay(block, &mut whole).unwrap();
            changed_to(&path, |batches, _| {
                let all = arrow::compute::concat_batches(&batches[0].schema(), &batches).unwrap();
                let column = all.column_by_name("omega_m").unwrap();
                let changed: ArrayRef = if single {
                    let mut v = column.as_primitive::<Float32Type>().values().to_vec();
                    v[1200] = f32::from_bits(v[1200].to_bits() ^ 1);
                    Arc::new(Float32Array::from(v))
                } else {
                    let mut v = column.as_primitive::<Float64Type>().values().to_vec();
                    v[1200] = f64::from_bits(v[1200].to_bits() ^ 1);
                    Arc::new(Float64Array::from(v))
                };
                vec![with_column(&all, "omega_m", changed)]
            });
            let mut seen = Runs::default();
            let e = Recording::open(&path).unwrap().replay(block, &mut seen).unwrap_err();
            assert!(
                e.to_string().contains("r.parquet: run 8: found another checksum"),
                "{e}"
            );
            assert!(seen.0.get(&8).is_none_or(|&rows| rows < 1000), "{:?}", seen.0);
            assert!(read_table(&path).is_err());
        }
    }

    #[test]
    fn prop_rows_left_out_other_metadata_and_nulls_are_found() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("r.parquet");
        let refused = || {
            let read = Recording::open(&path).and_then(|r| r.replay(128, &mut Runs::default()));
            read.unwrap_err().to_string()
        };
        recorded(&path, false);
        changed_to(&path, |b, _| {
            b.iter().map(|b| b.slice(0, b.num_rows().min(900))).collect()
        });
        assert!(refused().contains("another checksum"), "{}", refused());
        recorded(&path, false);
        changed_to(&path, |b, said| {
            said.insert("ema.load_n_m".into(), "0.5".into());
            b
        });
        assert!(refused().contains("run 3: found another checksum"), "{}", refused());
        recorded(&path, false);
        changed_to(&path, |b, said| {
            said.remove(KEY);
            b
        });
        Recording::open(&path)
            .unwrap()
            .replay(128, &mut Runs::default())
            .unwrap();
        // a null is refused by its place
        recorded(&path, false);
        changed_to(&path, |batches, _| {
            let fields = batches[0].schema().fields().clone();
            let fields = fields.iter().map(|f| f.as_ref().clone().with_nullable(true));
            let schema = Arc::new(arrow::datatypes::Schema::new(fields.collect::<Vec<_>>()));
            let b = RecordBatch::try_new(schema, batches[0].columns().to_vec()).unwrap();
            let column = b.column_by_name("com").unwrap().as_primitive::<Float64Type>();
            let values: Float64Array = column.iter().enumerate().map(|(i, x)| x.filter(|_| i != 40)).collect();
            vec![with_column(&b, "com", Arc::new(values))]
        });
        assert!(refused().contains("row 41, column `com`: found null"), "{}", refused());
    }

    #[test]
    fn prop_both_writers_of_telemetry_say_the_same_of_the_same_values() {
        let dir = tempfile::tempdir().unwrap();
        let layout = TelemetryLayout::new(channels(), false, 1000.0).unwrap();
        let mut encoder = layout.encoder(8, [2.0, 0.25, 0.5]).unwrap();
        let (a, b) = (dir.path().join("a.parquet"), dir.path().join("b.parquet"));
        let mut recorder = Recorder::create(&a, &about(), channels(), false).unwrap();
        let header = TelemetryHeader {
            fault: Some(crate::fault::FaultState { fsj: 2.0, zeta: 0.25 }),
            rest_angle_rad: Some(0.5),
            ..header(8)
        };
        for first in [1, 1 + ROWS as u64] {
            recorder.accept(&header, &samples(first).view()).unwrap();
            encoder.push(&samples(first).view()).unwrap();
        }
        recorder.finish().unwrap();
        let bytes = layout.file(vec![encoder.finish().unwrap()], about().pairs()).unwrap();
        std::fs::write(&b, bytes).unwrap();
        assert_eq!(metadata(&a).unwrap()[KEY], metadata(&b).unwrap()[KEY]);
        let mut all = Collector::default();
        Recording::open(&b).unwrap().replay(77, &mut all).unwrap();
        assert_eq!(all.rows(), 2 * ROWS);
    }
}
