//! Files whose numbers lie, and files with bytes changed at random: one line each, and no more memory than the file
//! is worth.
use ema_tests::mutation::changed;
use parquet::file::metadata::{ColumnChunkMetaData, ParquetMetaData, ParquetMetaDataReader};
use parquet::file::metadata::{ParquetMetaDataWriter, RowGroupMetaData};
use pipeline::input::{How, open};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use schemas::channel::{Channel, ChannelSet};
use schemas::recording::{Provenance, Recorder};
use schemas::telemetry::{TelemetryBuffer, TelemetryHeader, TelemetrySink};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant};

const ROWS: usize = 60;
const CHANNELS: [Channel; 4] = [Channel::Com, Channel::ThetaM, Channel::OmegaM, Channel::IEq];

/// A short recording.
fn write(path: &Path) {
    let about = Provenance {
        actuator: "rig".into(),
        rate_hz: 1000.0,
        step_s: 1e-6,
        model: "measured".into(),
        ..Provenance::default()
    };
    let channels = ChannelSet::of(CHANNELS);
    let header = TelemetryHeader {
        run: 0,
        actuator: "rig".into(),
        parameters: String::new(),
        sensors: String::new(),
        sequence: String::new(),
        rate_hz: 1000.0,
        channels,
        fault: None,
        rest_angle_rad: None,
    };
    let mut samples = TelemetryBuffer::new(channels, ROWS);
    let mut block = samples.view_mut(1, ROWS);
    for (k, c) in CHANNELS.into_iter().enumerate() {
        let column = block.column_mut(c).unwrap();
        column
            .iter_mut()
            .enumerate()
            .for_each(|(i, x)| *x = (i * (k + 1)) as f64 * 0.01);
    }
    let mut recorder = Recorder::create(path, &about, channels, false).unwrap();
    recorder.accept(&header, &samples.view()).unwrap();
    recorder.finish().unwrap();
}

/// The same as a CSV.
fn csv() -> Vec<u8> {
    let mut text = "t,com,theta_m,omega_m,i_eq\n".to_string();
    for i in 1..=ROWS {
        let x = i as f64 * 0.01;
        text += &format!("{},{x},{},{},{}\n", i as f64 * 1e-3, 2.0 * x, 3.0 * x, 4.0 * x);
    }
    text.into_bytes()
}

/// A recording whose footer was changed.
fn lying(path: &Path, change: impl FnOnce(ParquetMetaData) -> ParquetMetaData) {
    write(path);
    let bytes = std::fs::read(path).unwrap();
    let end = bytes.len();
    let footer = u32::from_le_bytes(bytes[end - 8..end - 4].try_into().unwrap()) as usize;
    let file = std::fs::File::open(path).unwrap();
    let honest = ParquetMetaDataReader::new().parse_and_finish(&file).unwrap();
    let mut changed = bytes[..end - 8 - footer].to_vec();
    ParquetMetaDataWriter::new(&mut changed, &change(honest))
        .finish()
        .unwrap();
    std::fs::write(path, changed).unwrap();
}

/// Changes the first row group.
fn of_group(m: ParquetMetaData, change: impl FnOnce(RowGroupMetaData) -> RowGroupMetaData) -> ParquetMetaData {
    let group = m.row_groups()[0].clone();
    m.into_builder().set_row_groups(vec![change(group)]).build()
}

/// Changes every column of the first row group.
fn of_columns(m: ParquetMetaData, change: impl Fn(ColumnChunkMetaData) -> ColumnChunkMetaData) -> ParquetMetaData {
    of_group(m, |g| {
        let columns = g.columns().iter().cloned().map(change).collect();
        g.into_builder().set_column_metadata(columns).build().unwrap()
    })
}

/// The most memory that this process had so far [bytes].
fn peak() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kib = line.and_then(|l| l.trim().trim_end_matches(" kB").parse::<u64>().ok());
    1024 * kib.unwrap_or(0)
}

const GIB: u64 = 1 << 30;

#[track_caller]
fn refused(path: &Path, words: &[&str]) {
    let line = format!("{:#}", open(path, How::default()).err().expect("refused"));
    assert!(!line.contains('\n') && line.len() < 400, "{line}");
    for w in words {
        assert!(line.contains(w), "no `{w}` in: {line}");
    }
}

#[test]
fn refuse_footers_that_declare_more_than_the_file_holds() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("lying.parquet");
    lying(&file, |m| m);
    open(&file, How::default()).expect("nothing was changed");
    const MANY: i64 = 1_000_000_000_000;
    let huge = 1i64 << 60;
    lying(&file, |m| {
        of_group(m, |g| g.into_builder().set_num_rows(MANY).build().unwrap())
    });
    refused(
        &file,
        &["lying.parquet", "rows of the footer", "1000000000000", "at most"],
    );
    // the columns as well, so that nothing contradicts it but the size of the file
    lying(&file, |m| {
        let m = of_columns(m, |c| c.into_builder().set_num_values(MANY).build().unwrap());
        of_group(m, |g| g.into_builder().set_num_rows(MANY).build().unwrap())
    });
    refused(&file, &["rows of the footer", "1000000000000"]);
    // more than there are, and no more than the file could hold
    lying(&file, |m| {
        let m = of_columns(m, |c| c.into_builder().set_num_values(1_000_000).build().unwrap());
        of_group(m, |g| g.into_builder().set_num_rows(1_000_000).build().unwrap())
    });
    refused(&file, &["lying.parquet", "999940 rows fewer than its footer declares"]);
    lying(&file, |m| {
        of_columns(m, |c| c.into_builder().set_num_values(MANY).build().unwrap())
    });
    refused(
        &file,
        &["values of column", "1000000000000", "60, the rows of the group"],
    );
    lying(&file, |m| {
        of_columns(m, |c| c.into_builder().set_total_compressed_size(huge).build().unwrap())
    });
    refused(&file, &["bytes of column", "1152921504606846976", "a file of"]);
    lying(&file, |m| {
        of_columns(m, |c| {
            c.into_builder()
                .set_data_page_offset(huge)
                .set_dictionary_page_offset(None)
                .build()
                .unwrap()
        })
    });
    refused(&file, &["bytes of column", "from byte 1152921504606846976 on"]);
    lying(&file, |m| {
        of_columns(m, |c| c.into_builder().set_total_uncompressed_size(-7).build().unwrap())
    });
    refused(&file, &["bytes before compression", "-7"]);
    assert!(peak() < GIB, "{} MiB", peak() >> 20);
}

/// The Parquet library passes over fields that it does not know, as many values as their headers declare; at the end of a file it
/// went on doing so, for minutes.
#[test]
fn refuse_a_page_header_that_declares_more_than_the_file_holds() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("page.parquet");
    write(&file);
    let mut bytes = std::fs::read(&file).unwrap();
    let honest = ParquetMetaDataReader::new()
        .parse_and_finish(&std::fs::File::open(&file).unwrap())
        .unwrap();
    let page = honest.row_groups()[0].columns().last().unwrap().data_page_offset() as usize;
    // Thrift: field 15, a list of 2^31 - 1 doubles
    bytes[page..page + 7].copy_from_slice(&[0xf9, 0xf7, 0xff, 0xff, 0xff, 0xff, 0x07]);
    std::fs::write(&file, bytes).unwrap();
    refused(&file, &["page.parquet", "end of file"]);
}

#[test]
fn refuse_a_csv_of_many_columns_in_one_short_line() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("wide.csv");
    let names: Vec<String> = (0..400_000).map(|i| format!("c{i}")).collect();
    std::fs::write(&file, names.join(",") + "\n").unwrap();
    // comparing each name with all before it took 80 000 million comparisons
    refused(
        &file,
        &["wide.csv", "header", "c0,c1,", "(400000 columns)", "missing: t, com"],
    );
    let again = names.join(",") + ",c7\n";
    std::fs::write(&file, again).unwrap();
    refused(&file, &["header, column 400001", "`c7` again"]);
    // what is not known is ignored, however much
    let head = format!("t,com,theta_m,omega_m,i_eq,{}\n", names[..20_000].join(","));
    let row = |i: usize| format!("{},0,0,0,0{}\n", i as f64 * 1e-3, ",1".repeat(20_000));
    std::fs::write(&file, head + &(1..20).map(row).collect::<String>()).unwrap();
    assert_eq!(open(&file, How::default()).unwrap().telemetry.rows(), 19);
}

/// Mutations of each sort of file: `EMA_MUTATIONS`, or few enough for every day.
fn mutations() -> u64 {
    let asked = std::env::var("EMA_MUTATIONS").ok();
    asked.map_or(300, |n| n.parse().expect("EMA_MUTATIONS is a number"))
}

#[test]
fn prop_damaged_files_are_read_or_refused_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let good = dir.path().join("good.parquet");
    write(&good);
    let ours = std::fs::read(&good).unwrap();
    let kinds = [
        ("ours.parquet", ours),
        ("plain.parquet", plain(&good)),
        ("table.csv", csv()),
    ];
    let mut counts = [0u64; 2];
    let mut slowest = Duration::ZERO;
    for (k, (name, bytes)) in kinds.iter().enumerate() {
        let file = dir.path().join(name);
        std::fs::write(&file, bytes).unwrap();
        open(&file, How::default()).expect(name);
        for seed in 0..mutations() {
            let mut rng = ChaCha8Rng::seed_from_u64(seed + ((k as u64) << 32));
            std::fs::write(&file, changed(&mut rng, bytes)).unwrap();
            let start = Instant::now();
            let done = catch_unwind(AssertUnwindSafe(|| open(&file, How::default()).map(|_| ())));
            slowest = slowest.max(start.elapsed());
            let done = done.unwrap_or_else(|_| panic!("{name}, seed {seed}: a panic"));
            counts[done.is_err() as usize] += 1;
            if let Err(e) = done {
                let line = format!("{e:#}");
                assert!(!line.contains('\n'), "{name}, seed {seed}: {line}");
                assert!(
                    line.starts_with(&*file.to_string_lossy()),
                    "{name}, seed {seed}: {line}"
                );
            }
        }
    }
    println!(
        "{} read, {} refused, slowest {slowest:?}, at most {} MiB",
        counts[0],
        counts[1],
        peak() >> 20
    );
    assert!(counts[1] > counts[0] / 4, "{counts:?}");
    // hangs, not slowness
    assert!(slowest < Duration::from_secs(30), "{slowest:?}");
    assert!(peak() < 4 * GIB, "{} MiB", peak() >> 20);
}

/// The recording with the settings of other programs, and without metadata.
fn plain(source: &Path) -> Vec<u8> {
    use parquet::basic::Compression;
    let (schema, batches) = schemas::table::read_table(source).unwrap();
    let settings = parquet::file::properties::WriterProperties::builder().set_compression(Compression::SNAPPY);
    let mut bytes = Vec::new();
    let mut w = parquet::arrow::ArrowWriter::try_new(&mut bytes, schema, Some(settings.build())).unwrap();
    batches.iter().for_each(|b| w.write(b).unwrap());
    w.close().unwrap();
    bytes
}
