//! Laws of the log.

use super::*;
use crate::diagnosis::{Diagnosis, Outcome};
use crate::live::Report;
use crate::report::to_batch;
use arrow::array::RecordBatch;
use schemas::channel::ChannelSet;
use schemas::feature::{Feature, Features};
use schemas::stream::frame::RunDescription;
use std::fs::OpenOptions;
use std::io::Write;

fn logged(run: u64) -> Logged {
    let outcome = Outcome::OutOfRange {
        reason: "FSJ above 5".into(),
    };
    Logged {
        report: Report {
            run: RunDescription {
                actuator: "rig".into(),
                parameters: "fd2267d8e432540d".into(),
                sensors: "none".into(),
                sequence: "516bc48aa11e0fd0".into(),
                run,
                rate_hz: 1e4,
                channels: ChannelSet::basic(),
                total_rows: 30_000,
                load_n_m: 0.0,
            },
            stream: u64::MAX - run,
            is_final: true,
            diagnosis: Diagnosis::without_maps(outcome, Features::default().with(Feature::P2, Some(0.5))),
            samples_received: 30_000,
            samples_lost: 0,
            telemetry_ns: 1,
        },
        time_ns: 2,
        publish_ns: 3,
    }
}

/// All rows of a table.
fn rows(path: &Path) -> Vec<RecordBatch> {
    let schema = to_batch(&[]).schema();
    let batches = schemas::table::read_batches(path).unwrap();
    let typed = |b: RecordBatch| RecordBatch::try_new(schema.clone(), b.columns().to_vec()).unwrap();
    batches.into_iter().map(typed).collect()
}

fn write(path: &Path, runs: std::ops::Range<u64>) {
    let log = Log::open(path, Arc::new(|text: &str| panic!("{text}"))).unwrap();
    runs.for_each(|r| log.append(logged(r)));
    log.close().unwrap();
}

#[test]
fn prop_a_log_goes_on_where_it_ended() {
    let dir = std::env::temp_dir().join(format!("ema-log-{}", std::process::id()));
    std::fs::create_dir_all(&dir).unwrap();
    let table = dir.join("log.parquet");
    write(&table, 0..2);
    write(&table, 2..5);
    let rows = arrow::compute::concat_batches(&to_batch(&[]).schema(), &rows(&table)).unwrap();
    let expected: Vec<Logged> = (0..5).map(logged).collect();
    assert_eq!(rows, to_batch(&expected));
    let lines = dir.join("log.jsonl");
    write(&lines, 0..2);
    // a process died in the middle of a line
    let mut torn = OpenOptions::new().append(true).open(&lines).unwrap();
    torn.write_all(b"{\"run\":").unwrap();
    drop(torn);
    write(&lines, 2..3);
    let text = std::fs::read_to_string(&lines).unwrap();
    let runs: Vec<u64> = text
        .lines()
        .map(|l| {
            serde_json::from_str::<serde_json::Value>(l).unwrap()["run"]
                .as_u64()
                .unwrap()
        })
        .collect();
    assert_eq!(runs, [0, 1, 2]);
    // another table is refused, and stays as it is
    let other = dir.join("other.parquet");
    std::fs::write(&other, b"PAR1 not a table").unwrap();
    assert!(Log::open(&other, Arc::new(|_: &str| ())).is_err());
    assert_eq!(std::fs::read(&other).unwrap(), b"PAR1 not a table");
    // also one without rows
    let field = arrow::datatypes::Field::new("x", arrow::datatypes::DataType::Float64, false);
    let empty = RecordBatch::new_empty(Arc::new(arrow::datatypes::Schema::new(vec![field])));
    let bytes = schemas::table::table_bytes(&[empty], Vec::new()).unwrap();
    std::fs::write(&other, &bytes).unwrap();
    assert!(Log::open(&other, Arc::new(|_: &str| ())).is_err());
    assert_eq!(std::fs::read(&other).unwrap(), bytes);
    std::fs::remove_dir_all(&dir).unwrap();
}

fn folder(name: &str) -> PathBuf {
    let dir = std::env::temp_dir().join(format!("ema-log-{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).unwrap();
    dir
}

fn runs_of(path: &Path) -> Vec<u64> {
    let of = |b: &RecordBatch| {
        let column = arrow::array::AsArray::as_primitive::<arrow::datatypes::UInt64Type>(b.column(4));
        column.values().to_vec()
    };
    rows(path).iter().flat_map(of).collect()
}

#[test]
fn prop_a_kill_loses_no_row_and_doubles_none() {
    let dir = folder("kill");
    let path = dir.join("log.parquet");
    // what a killed process left half written goes
    let orphan = dir.join(".log.parquet.tmp-4000000");
    std::fs::write(&orphan, b"half").unwrap();
    let mut table = Table::open(&path).unwrap();
    assert!(!orphan.exists());
    // from the start readers see a table
    assert_eq!(runs_of(&path), [0_u64; 0]);
    table.write(&[logged(0), logged(1)]).unwrap();
    table.rewrite().unwrap();
    table.write(&[logged(2)]).unwrap();
    table.write(&[logged(3)]).unwrap();
    // killed: the table is whole, the rest is in the journal, with a row that was not finished
    drop(table);
    assert_eq!(runs_of(&path), [0, 1]);
    let journal = dir.join(".log.parquet.journal");
    let whole = std::fs::read(&journal).unwrap();
    let mut torn = OpenOptions::new().append(true).open(&journal).unwrap();
    torn.write_all(&whole[whole.len() / 2..whole.len() - 3]).unwrap();
    let table = Table::open(&path).unwrap();
    assert_eq!(runs_of(&path), [0, 1, 2, 3]);
    let streams: Vec<u64> = table.concluded().iter().map(|s| s.1).collect();
    assert_eq!(streams, [u64::MAX, u64::MAX - 1, u64::MAX - 2, u64::MAX - 3]);
    drop(table);
    // killed between the table's renaming and the emptying of its journal
    std::fs::write(&journal, &whole).unwrap();
    drop(Table::open(&path).unwrap());
    assert_eq!(runs_of(&path), [0, 1, 2, 3]);
    std::fs::remove_dir_all(&dir).unwrap();
}

#[test]
fn prop_full_row_groups_are_copied_and_the_rest_stays_in_order() {
    let dir = folder("groups");
    let path = dir.join("log.parquet");
    let mut next = 0;
    for _ in 0..3 {
        let mut table = Table::open(&path).unwrap();
        for n in [1, 63, 64, 65, 130] {
            let list: Vec<Logged> = (next..next + n).map(logged).collect();
            table.write(&list).unwrap();
            table.rewrite().unwrap();
            next += n;
            assert_eq!(runs_of(&path), (0..next).collect::<Vec<_>>());
        }
    }
    let all = arrow::compute::concat_batches(&to_batch(&[]).schema(), &rows(&path)).unwrap();
    let expected: Vec<Logged> = (0..next).map(logged).collect();
    assert_eq!(all, to_batch(&expected));
    let file = std::fs::File::open(&path).unwrap();
    let reader = parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder::try_new(file).unwrap();
    assert_eq!(reader.metadata().num_row_groups() as u64, next.div_ceil(64));
    assert_eq!(schemas::table::metadata(&path).unwrap()["ema.schema_version"], "1");
    std::fs::remove_dir_all(&dir).unwrap();
}

#[test]
fn prop_a_log_that_cannot_be_written_keeps_so_many_and_counts_the_others() {
    let dir = folder("full");
    let path = dir.join("log.jsonl");
    std::os::unix::fs::symlink("/dev/full", &path).unwrap();
    let said: Arc<Mutex<Vec<String>>> = Arc::default();
    let log = {
        let said = said.clone();
        Log::open(
            &path,
            Arc::new(move |text: &str| said.lock().unwrap().push(text.into())),
        )
        .unwrap()
    };
    for run in 0..MOST_KEPT as u64 + 7 {
        log.append(logged(run));
    }
    assert_eq!(log.backlog(), (MOST_KEPT, 7));
    let e = log.close().unwrap_err().to_string();
    assert!(e.contains(&format!("{} diagnoses are not in it", MOST_KEPT + 7)), "{e}");
    let said = said.lock().unwrap();
    let of = |word: &str| said.iter().filter(|s| s.contains(word)).count();
    assert_eq!(
        (of("cannot be written"), of("later ones are dropped")),
        (1, 1),
        "{said:?}"
    );
    std::fs::remove_dir_all(&dir).unwrap();
}

#[test]
fn prop_an_earlier_log_says_which_streams_are_concluded() {
    let dir = folder("concluded");
    for name in ["log.jsonl", "log.parquet"] {
        let path = dir.join(name);
        write(&path, 3..5);
        let log = Log::open(&path, Arc::new(|text: &str| panic!("{text}"))).unwrap();
        let rig = schemas::stream::wire::to_text("rig");
        assert_eq!(log.concluded(), [(rig, u64::MAX - 3), (rig, u64::MAX - 4)], "{name}");
        log.close().unwrap();
    }
    std::fs::remove_dir_all(&dir).unwrap();
}

#[test]
fn prop_a_damaged_table_or_journal_is_taken_up_or_refused_in_one_line() {
    let dir = folder("damaged");
    let path = dir.join("log.parquet");
    write(&path, 0..5);
    let mut table = Table::open(&path).unwrap();
    table.write(&[logged(5), logged(6)]).unwrap();
    drop(table);
    let files = [path.clone(), dir.join(".log.parquet.journal")];
    let whole = files.each_ref().map(|f| std::fs::read(f).unwrap());
    assert!(whole.iter().all(|b| b.len() > 500));
    let mut refused = 0;
    for (k, bytes) in whole.iter().enumerate() {
        for at in (0..bytes.len()).step_by(3) {
            for (file, bytes) in files.iter().zip(&whole) {
                std::fs::write(file, bytes).unwrap();
            }
            let mut changed = bytes.clone();
            changed[at] ^= 0xff;
            std::fs::write(&files[k], changed).unwrap();
            // a panic would end the test
            match Table::open(&path).map(|t| t.concluded()) {
                Err(e) => {
                    refused += 1;
                    assert!(!e.to_string().contains('\n'), "{e}");
                }
                Ok(streams) => assert!(streams.len() <= 7, "byte {at}"),
            }
        }
    }
    assert!(refused > 100, "{refused}");
    std::fs::remove_dir_all(&dir).unwrap();
}
