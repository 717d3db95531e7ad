//! Recordings as other programs write them: every codec and encoding of Parquet, with and without the metadata.
use crate::common::process::{json, ok, refused, text};
use parquet::arrow::ArrowWriter;
use parquet::basic::{BrotliLevel, Compression, Encoding, GzipLevel, ZstdLevel};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{WriterProperties, WriterPropertiesBuilder, WriterVersion};
use schemas::table::{metadata, read_table};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// A recording without sensors and its diagnosis; made once.
fn recording() -> &'static (PathBuf, Value) {
    static ONCE: OnceLock<(PathBuf, Value)> = OnceLock::new();
    ONCE.get_or_init(|| {
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("codecs.parquet");
        let run = ["run", "--fsj", "3", "--zeta", "0.3", "--rate", "1000", "--out"];
        ok(&[&run[..], &[text(&file)]].concat());
        let d = json(&["diagnose", text(&file), "--json"]);
        assert_eq!(d["outcome"], "located");
        (file, d)
    })
}

/// The recording as it is written with other settings; without metadata, it says nothing of what made it.
fn rewritten(path: &Path, settings: WriterPropertiesBuilder, with_metadata: bool) {
    let (source, _) = recording();
    let (schema, batches) = read_table(source).unwrap();
    let pairs = metadata(source).unwrap().into_iter();
    let ours = pairs.filter(|(k, _)| with_metadata && k.starts_with("ema."));
    let settings = settings.set_key_value_metadata(Some(ours.map(|(k, v)| KeyValue::new(k, v)).collect()));
    let file = std::fs::File::create(path).unwrap();
    let mut w = ArrowWriter::try_new(file, schema, Some(settings.build())).unwrap();
    batches.iter().for_each(|b| w.write(b).unwrap());
    w.close().unwrap();
}

fn codecs() -> Vec<Compression> {
    vec![
        Compression::UNCOMPRESSED,
        Compression::SNAPPY,
        Compression::GZIP(GzipLevel::default()),
        Compression::BROTLI(BrotliLevel::default()),
        Compression::LZ4,
        Compression::LZ4_RAW,
        Compression::ZSTD(ZstdLevel::default()),
    ]
}

#[test]
fn e2e_a_recording_in_every_codec_is_diagnosed_alike() {
    let (_, right) = recording();
    let dir = tempfile::tempdir().unwrap();
    for codec in codecs() {
        for with_metadata in [true, false] {
            let file = dir.path().join(format!("{codec}-{with_metadata}.parquet"));
            rewritten(&file, WriterProperties::builder().set_compression(codec), with_metadata);
            let d = json(&["diagnose", text(&file), "--json"]);
            assert_eq!(&d, right, "{codec}, metadata: {with_metadata}");
        }
    }
}

#[test]
fn e2e_a_recording_in_every_encoding_is_diagnosed_alike() {
    let (_, right) = recording();
    let dir = tempfile::tempdir().unwrap();
    let plain = || WriterProperties::builder().set_dictionary_enabled(false);
    let v2 = || WriterProperties::builder().set_writer_version(WriterVersion::PARQUET_2_0);
    for (name, settings) in [
        ("dictionary", WriterProperties::builder().set_dictionary_enabled(true)),
        ("plain", plain().set_encoding(Encoding::PLAIN)),
        ("split", plain().set_encoding(Encoding::BYTE_STREAM_SPLIT)),
        ("v2", v2()),
        ("v2-snappy", v2().set_compression(Compression::SNAPPY)),
        (
            "small",
            plain()
                .set_data_page_row_count_limit(100)
                .set_max_row_group_row_count(Some(333)),
        ),
    ] {
        let file = dir.path().join(format!("{name}.parquet"));
        rewritten(&file, settings, true);
        assert_eq!(&json(&["diagnose", text(&file), "--json"]), right, "{name}");
    }
}

#[test]
fn e2e_a_recording_that_other_programs_wrote_is_diagnosed_alike() {
    let python = std::env::var("EMA_PYTHON").unwrap_or_else(|_| "python3".into());
    let (source, right) = recording();
    let dir = tempfile::tempdir().unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/rewrite.py");
    let mut c = Command::new(python);
    c.env("PYTHONDONTWRITEBYTECODE", "1")
        .arg(script)
        .arg(source)
        .arg(dir.path());
    let done = c.output();
    let Some(done) = done
        .ok()
        .filter(|o| !String::from_utf8_lossy(&o.stderr).contains("ModuleNotFoundError"))
    else {
        println!("skipped: no Python with pandas, polars, pyarrow, duckdb (EMA_PYTHON names the interpreter)");
        return;
    };
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let made = String::from_utf8(done.stdout).unwrap();
    assert!(made.lines().count() > 35, "{made}");
    for file in made.lines() {
        let mut d = json(&["diagnose", file, "--json"]);
        let read = d.as_object_mut().unwrap().remove("read");
        assert_eq!(&d, right, "{file}");
        assert_eq!(read.is_some(), file.contains("clock-"), "{file}: {read:?}");
    }
}

#[test]
fn e2e_a_table_without_metadata_is_read_as_csv_is() {
    let dir = tempfile::tempdir().unwrap();
    let (source, right) = recording();
    // one of two runs is chosen by its number
    let (schema, batches) = read_table(source).unwrap();
    let twice = dir.path().join("twice.parquet");
    let mut w = ArrowWriter::try_new(std::fs::File::create(&twice).unwrap(), schema.clone(), None).unwrap();
    for run in [4u64, 9] {
        for b in &batches {
            let mut columns = b.columns().to_vec();
            columns[0] = std::sync::Arc::new(arrow::array::UInt64Array::from(vec![run; b.num_rows()]));
            w.write(&arrow::array::RecordBatch::try_new(schema.clone(), columns).unwrap())
                .unwrap();
        }
    }
    w.close().unwrap();
    assert_eq!(&json(&["diagnose", text(&twice), "--run", "9", "--json"]), right);
    refused(
        &["diagnose", text(&twice)],
        &["twice.parquet", "2 runs", "--run NUMBER"],
    );
    refused(&["diagnose", text(&twice), "--run", "5"], &["no run 5", "[4, 9]"]);
    // a table of something else
    let other = dir.path().join("other.parquet");
    let without: Vec<usize> = (0..schema.fields().len())
        .filter(|&i| schema.field(i).name() != "omega_m")
        .collect();
    let batches: Vec<_> = batches.iter().map(|b| b.project(&without).unwrap()).collect();
    let mut w = ArrowWriter::try_new(std::fs::File::create(&other).unwrap(), batches[0].schema(), None).unwrap();
    batches.iter().for_each(|b| w.write(b).unwrap());
    w.close().unwrap();
    refused(
        &["diagnose", text(&other)],
        &["other.parquet", "columns", "theta_m", "omega_m"],
    );
}
