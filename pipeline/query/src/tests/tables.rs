use super::{near, number, truth, word, write};
use crate::{explain, query};
use arrow::array::{ArrayRef, Float32Array, Float64Array, Int64Array, RecordBatch, UInt64Array};
use parquet::arrow::ArrowWriter;
use parquet::file::metadata::{FileMetaData, ParquetMetaDataBuilder, ParquetMetaDataReader, ParquetMetaDataWriter};
use parquet::file::reader::{FileReader, SerializedFileReader};
use polars::prelude::df;
use std::fs::{File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::Arc;
use tempfile::tempdir;

/// Telemetry of three runs from `first` on, 100 samples each, a row group a run. omega_m is 1000 run + sample.
fn telemetry(path: &Path, first: u64) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let mut writer = None;
    for run in first..first + 3 {
        let phase = |x: f32| Arc::new(Float32Array::from(vec![x; 100])) as ArrayRef;
        let omega: Vec<f32> = (0..100).map(|i| 1000.0 * run as f32 + i as f32).collect();
        let columns: [(&str, ArrayRef); 8] = [
            ("run", Arc::new(UInt64Array::from(vec![run; 100]))),
            ("fsj", Arc::new(Float64Array::from(vec![run as f64; 100]))),
            ("zeta", Arc::new(Float64Array::from(vec![0.0; 100]))),
            (
                "t_ns",
                Arc::new(Int64Array::from((1..=100).map(|i| i * 100_000).collect::<Vec<_>>())),
            ),
            ("omega_m", Arc::new(Float32Array::from(omega))),
            ("i_a", phase(-1.0)),
            ("i_b", phase(0.25)),
            ("i_c", phase(0.75)),
        ];
        let batch = RecordBatch::try_from_iter(columns).unwrap();
        let w = writer
            .get_or_insert_with(|| ArrowWriter::try_new(File::create(path).unwrap(), batch.schema(), None).unwrap());
        w.write(&batch).unwrap();
        w.flush().unwrap();
    }
    writer.unwrap().close().unwrap();
}

fn place(actuator: &str) -> String {
    format!("telemetry/sequence=preflight/actuator={actuator}/part-0000.parquet")
}

/// Overwrites the pages of all columns of all row groups but the named ones.
fn poison(path: &Path, keep: impl Fn(usize, &str) -> bool) -> usize {
    let reader = SerializedFileReader::new(File::open(path).unwrap()).unwrap();
    let mut file = OpenOptions::new().write(true).open(path).unwrap();
    let mut spoilt = 0;
    for (g, group) in reader.metadata().row_groups().iter().enumerate() {
        for column in group.columns().iter().filter(|c| !keep(g, c.column_descr().name())) {
            let (start, length) = column.byte_range();
            file.seek(SeekFrom::Start(start)).unwrap();
            file.write_all(&vec![0xff; length as usize]).unwrap();
            spoilt += 1;
        }
    }
    spoilt
}

#[test]
fn a_filtered_query_reads_the_folders_row_groups_and_columns_that_it_needs_and_no_others() {
    let dir = tempdir().unwrap();
    for (actuator, first) in [("0012", 0), ("A-1.left", 3), ("A-1.right", 6)] {
        telemetry(&dir.path().join(place(actuator)), first);
    }
    let sql =
        "SELECT COUNT(*) AS n, SUM(CAST(omega_m AS DOUBLE)) AS s FROM runs WHERE actuator = 'A-1.left' AND run = 4";
    let check = || {
        let frame = query(dir.path(), sql).unwrap();
        assert_eq!(number(&frame, "n", 0), 100.0);
        near(number(&frame, "s", 0), 100.0 * 4000.0 + 4950.0);
    };
    check();
    // of the file asked for: two columns of the middle row group stay; of the others: nothing at all, except that
    // the schema is taken from the first
    let spoilt = poison(&dir.path().join(place("A-1.left")), |g, c| {
        g == 1 && ["run", "omega_m"].contains(&c)
    });
    assert_eq!(spoilt, 3 * 8 - 2);
    poison(&dir.path().join(place("0012")), |_, _| false);
    std::fs::write(dir.path().join(place("A-1.right")), [0xff; 1000]).unwrap();
    check();
    // the poison is one: whoever reads more stumbles
    for sql in [
        "SELECT SUM(omega_m) AS s FROM runs WHERE actuator = 'A-1.left'",
        "SELECT SUM(omega_m) AS s FROM runs WHERE actuator = 'A-1.left' AND run = 5",
        "SELECT SUM(i_a) AS s FROM runs WHERE actuator = 'A-1.left' AND run = 4",
        "SELECT SUM(omega_m) AS s FROM runs WHERE run = 4",
    ] {
        let e = format!("{:#}", query(dir.path(), sql).unwrap_err());
        assert!(!e.contains('\n'), "{e}");
    }
    let plan = explain(dir.path(), sql).unwrap();
    assert!(
        plan.contains("A-1.left") && !plan.contains("A-1.right") && !plan.contains("0012"),
        "{plan}"
    );
    assert!(plan.contains("SELECTION") && plan.contains("run"), "{plan}");
}

#[test]
fn folders_names_become_text_and_the_equivalent_current_is_formed() {
    let dir = tempdir().unwrap();
    telemetry(&dir.path().join(place("0012")), 0);
    let sql =
        "SELECT actuator, sequence, MAX(i_eq) AS i_eq FROM runs WHERE actuator = '0012' GROUP BY actuator, sequence";
    let frame = query(dir.path(), sql).unwrap();
    assert_eq!(
        (word(&frame, "actuator", 0), word(&frame, "sequence", 0)),
        ("0012".into(), "preflight".into())
    );
    near(number(&frame, "i_eq", 0), 1.0);
    // only the phase currents are read for it
    let plan = explain(dir.path(), "SELECT MAX(i_eq) AS i FROM runs").unwrap();
    assert!(plan.contains("PROJECT 3/"), "{plan}");
}

#[test]
fn the_dataset_of_one_actuator_is_like_any_other() {
    let dir = tempdir().unwrap();
    telemetry(&dir.path().join(place("reference")), 0);
    let maps = df!("feature" => ["p1", "p1"], "fsj" => [1.0, 2.0], "zeta" => [0.0, 0.0], "value" => [0.1, 0.2]);
    write(&dir.path().join("maps/part-0000.parquet"), maps.unwrap());
    // the file that diagnoses are made with is no table
    std::fs::write(dir.path().join("maps.parquet"), b"not read").unwrap();
    let sql = "SELECT COUNT(*) AS n, MIN(run) AS r FROM runs WHERE t_ns > 5000000";
    let n = query(dir.path(), sql).unwrap();
    assert_eq!(number(&n, "n", 0), 150.0);
    let m = query(dir.path(), "SELECT SUM(value) AS v FROM maps").unwrap();
    near(number(&m, "v", 0), 0.3);
    // a table that was not made yet is missing here, and the error says what makes it
    let e = format!("{:#}", query(dir.path(), "SELECT * FROM diagnoses").unwrap_err());
    assert!(
        e.contains("table `diagnoses`") && e.contains("ema dataset diagnose"),
        "{e}"
    );
    let e = format!("{:#}", query(dir.path(), "SELEC 1 FROM maps").unwrap_err());
    assert!(e.contains("SQL") && !e.contains('\n'), "{e}");
    let empty = tempdir().unwrap();
    let e = format!("{:#}", query(empty.path(), "SELECT 1 FROM runs").unwrap_err());
    assert!(e.contains("none of its tables"), "{e}");
    // the layout of version 0.1 is refused, and the command that makes a new dataset named
    std::fs::write(empty.path().join("plan.txt"), "plan 0123\n").unwrap();
    let e = format!("{:#}", crate::tables::refuse_old(empty.path()).unwrap_err());
    assert!(e.contains("plan.txt") && e.contains("ema simulate --out NEW"), "{e}");
}

#[test]
fn intervals_are_diagnoses_by_fault() {
    let dir = tempdir().unwrap();
    super::questions::diagnoses(dir.path());
    let frame = query(dir.path(), "SELECT * FROM intervals ORDER BY run, fault").unwrap();
    assert_eq!(frame.height(), 12);
    let names: Vec<&str> = frame.get_column_names().iter().map(|n| n.as_str()).collect();
    let right = "run actuator tail position sequence maps fault exact lo hi estimate width error inside coverage";
    assert_eq!(names.join(" "), right);
    // run 12, zeta: 0.2 beside 0.21 .. 0.22
    assert_eq!(word(&frame, "fault", 5), "zeta");
    near(number(&frame, "width", 5), 0.01);
    near(number(&frame, "error", 5), 0.015);
    assert_eq!(
        (truth(&frame, "inside", 4), truth(&frame, "inside", 5)),
        (Some(true), Some(false))
    );
    // run 13 has none
    assert!(number(&frame, "width", 6).is_nan());
    assert_eq!(truth(&frame, "inside", 6), None);
}

#[test]
fn files_that_are_none_are_refused_in_one_line() {
    let dir = tempdir().unwrap();
    let file = dir.path().join("features/part-0000.parquet");
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    std::fs::write(&file, b"PAR1 this is no Parquet file PAR1").unwrap();
    let e = format!("{:#}", query(dir.path(), "SELECT * FROM features").unwrap_err());
    assert!(!e.contains('\n'), "{e}");
}

#[test]
fn a_table_that_declares_more_rows_than_it_holds_is_refused() {
    let dir = tempdir().unwrap();
    let file = dir.path().join("features/part-0000.parquet");
    write(&file, df!("run" => [0u64, 1, 2], "p2_a" => [0.1, 0.2, 0.3]).unwrap());
    assert_eq!(query(dir.path(), "SELECT * FROM features").unwrap().height(), 3);
    let bytes = std::fs::read(&file).unwrap();
    let footer = u32::from_le_bytes(bytes[bytes.len() - 8..][..4].try_into().unwrap()) as usize;
    let m = ParquetMetaDataReader::new()
        .parse_and_finish(&File::open(&file).unwrap())
        .unwrap();
    let rows = 1_000_000_000_000;
    let many = FileMetaData::new(2, rows, None, None, m.file_metadata().schema_descr_ptr(), None);
    let group = m.row_groups()[0]
        .clone()
        .into_builder()
        .set_num_rows(rows)
        .build()
        .unwrap();
    let lie = ParquetMetaDataBuilder::new(many).add_row_group(group).build();
    let mut changed = bytes[..bytes.len() - 8 - footer].to_vec();
    ParquetMetaDataWriter::new(&mut changed, &lie).finish().unwrap();
    std::fs::write(&file, changed).unwrap();
    for sql in [
        "SELECT COUNT(*) AS n FROM features",
        "SELECT * FROM features",
        "SELECT SUM(p2_a) AS s FROM features",
    ] {
        let e = format!("{:#}", query(dir.path(), sql).unwrap_err());
        assert!(
            e.contains("part-0000.parquet: rows of the footer: found 1000000000000"),
            "{e}"
        );
    }
}

#[test]
fn tables_in_every_codec_are_read() {
    use parquet::basic::{BrotliLevel, Compression, GzipLevel, ZstdLevel};
    let dir = tempdir().unwrap();
    let file = dir.path().join("features/part-0000.parquet");
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    let words: ArrayRef = Arc::new(arrow::array::StringArray::from_iter_values(
        (0..500).map(|i| ["map", "test"][i % 2]),
    ));
    let numbers: ArrayRef = Arc::new(Float64Array::from_iter_values((0..500).map(|i| i as f64)));
    let batch = RecordBatch::try_from_iter([("kind", words), ("p3", numbers)]).unwrap();
    for codec in [
        Compression::UNCOMPRESSED,
        Compression::SNAPPY,
        Compression::GZIP(GzipLevel::default()),
        Compression::BROTLI(BrotliLevel::default()),
        Compression::LZ4_RAW,
        Compression::ZSTD(ZstdLevel::default()),
    ] {
        let settings = parquet::file::properties::WriterProperties::builder()
            .set_compression(codec)
            .build();
        let mut w = ArrowWriter::try_new(File::create(&file).unwrap(), batch.schema(), Some(settings)).unwrap();
        w.write(&batch).unwrap();
        w.close().unwrap();
        let frame = query(
            dir.path(),
            "SELECT kind, SUM(p3) AS s FROM features GROUP BY kind ORDER BY kind",
        )
        .unwrap();
        near(number(&frame, "s", 0), 62_250.0);
        assert_eq!(word(&frame, "kind", 1), "test", "{codec}");
    }
}
