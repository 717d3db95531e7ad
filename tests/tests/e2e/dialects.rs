//! One recording in the dialects in which people keep tables: read with the same diagnosis, or refused with its cause.
use crate::common::process::{ema, json, ok, refused, succeeded, text};
use serde_json::Value;
use std::path::Path;

/// A recording with the reference sensors as cells of text.
struct Recorded {
    names: Vec<String>,
    rows: Vec<Vec<String>>,
}

const UNITS: [&str; 9] = ["s", "rad", "rad", "rad", "rad/s", "A", "A", "A", "A"];

impl Recorded {
    fn new(dir: &Path) -> Self {
        let file = dir.join("recorded.csv");
        let run = [
            "run",
            "--fsj",
            "3",
            "--zeta",
            "0.3",
            "--rate",
            "1000",
            "--sensors",
            "reference",
            "--out",
        ];
        ok(&[&run[..], &[text(&file)]].concat());
        let all = std::fs::read_to_string(&file).unwrap();
        let mut lines = all
            .lines()
            .map(|l| l.split(',').map(str::to_string).collect::<Vec<_>>());
        Self {
            names: lines.next().unwrap(),
            rows: lines.collect(),
        }
    }

    fn named(&self, names: [&str; 9]) -> Self {
        Self {
            names: names.map(String::from).into(),
            rows: self.rows.clone(),
        }
    }

    /// With other cells in some columns.
    fn with(&self, column: usize, change: impl Fn(usize, f64) -> String) -> Self {
        let mut rows = self.rows.clone();
        for (i, row) in rows.iter_mut().enumerate() {
            row[column] = change(i, self.rows[i][column].parse().unwrap());
        }
        let names = self.names.clone();
        Self { names, rows }
    }

    fn columns(&self, which: &[usize]) -> Self {
        let of = |row: &Vec<String>| which.iter().map(|&c| row[c].clone()).collect::<Vec<_>>();
        Self {
            names: of(&self.names),
            rows: self.rows.iter().map(of).collect(),
        }
    }

    fn decimal_commas(&self) -> Self {
        let rows = self
            .rows
            .iter()
            .map(|r| r.iter().map(|c| c.replace('.', ",")).collect());
        Self {
            names: self.names.clone(),
            rows: rows.collect(),
        }
    }

    /// Every line by `line`.
    fn lines(&self, line: impl Fn(&[String]) -> String) -> String {
        let all = std::iter::once(&self.names).chain(&self.rows);
        all.map(|r| line(r) + "\n").collect()
    }

    fn separated(&self, by: &str) -> String {
        self.lines(|r| r.join(by))
    }
}

fn utf16(text: &str, mark: bool, swap: bool) -> Vec<u8> {
    let units = mark.then_some(0xfeff).into_iter().chain(text.encode_utf16());
    units
        .flat_map(|u| if swap { u.to_be_bytes() } else { u.to_le_bytes() })
        .collect()
}

fn gzip(text: &str) -> Vec<u8> {
    use std::io::Write;
    let mut w = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    w.write_all(text.as_bytes()).unwrap();
    w.finish().unwrap()
}

/// What is read: name of the file, its bytes.
fn accepted(r: &Recorded) -> Vec<(&'static str, Vec<u8>)> {
    let plain = r.separated(",");
    let with_units = |form: fn(&str, &str) -> String| {
        let names: Vec<String> = r.names.iter().zip(UNITS).map(|(n, u)| form(n, u)).collect();
        Recorded {
            names,
            rows: r.rows.clone(),
        }
    };
    let degrees = |t: Recorded| (1..4).fold(t, |t, c| t.with(c, |_, x| format!("{:?}", x.to_degrees())));
    let rpm = |t: Recorded| t.with(4, |_, x| format!("{:?}", x * 60.0 / std::f64::consts::TAU));
    let moments = |day: &str, mark: char, end: &str| {
        let moment = |_: usize, t: f64| {
            let micros = (t * 1e6).round() as u64;
            format!(
                "{day}10:00:{:02}{mark}{:06}{end}",
                micros / 1_000_000,
                micros % 1_000_000
            )
        };
        let mut t = r.with(0, moment);
        t.names[0] = "timestamp".into();
        t
    };
    let shifted = |by: f64| r.with(0, move |_, t| format!("{:.3}", t + by));
    let mut idle = shifted(0.499);
    let still = |i: usize| {
        let zero = std::iter::repeat_n("0".to_string(), 8);
        std::iter::once(format!("{:.3}", i as f64 * 1e-3)).chain(zero).collect()
    };
    idle.rows.splice(0..0, (0..500).map(still));
    let last = idle.rows.last().unwrap().clone();
    idle.rows.extend((0..200).map(|i| {
        let mut row = last.clone();
        row[0] = format!("{:.3}", 3.5 + f64::from(i) * 1e-3);
        row
    }));
    let mut index = r.with(0, |_, t| t.to_string());
    index.names.insert(0, String::new());
    index
        .rows
        .iter_mut()
        .enumerate()
        .for_each(|(i, r)| r.insert(0, i.to_string()));
    let mut below = r.with(0, |_, t| format!("{}", t * 1e3));
    below.rows.insert(0, UNITS.map(String::from).into());
    below.rows[0][0] = "[ms]".into();
    let upper: Vec<String> = r.names.iter().map(|n| n.to_uppercase()).collect();
    let upper = Recorded {
        names: upper,
        rows: r.rows.clone(),
    };
    let quoted = |r: &[String]| r.iter().map(|c| format!("\"{c}\"")).collect::<Vec<_>>().join(",");
    let body = |t: &Recorded, by: &str| t.separated(by).split_once('\n').unwrap().1.to_string();
    let spelt = [
        "t_s",
        "com_deg",
        "theta_u_deg",
        "theta_m (deg)",
        "omega_m_rad_per_s",
        "i_eq_A",
        "I A",
        "i-b",
        "i_c{A}",
    ];
    let degree = r.named([
        "t",
        "com [°]",
        "theta_u [°]",
        "theta_m [°]",
        "omega_m",
        "i_eq",
        "i_a",
        "i_b",
        "i_c",
    ]);
    let latin: Vec<u8> = degrees(degree).separated(",").chars().map(|c| c as u8).collect();
    let milli = with_units(|n, u| match n {
        "t" => "t [ms]".into(),
        "omega_m" => "omega_m (rpm)".into(),
        n if n.starts_with("i_") => format!("{n} [mA]"),
        _ => format!("{n} [{u}]"),
    });
    let milli = rpm((5..9).fold(milli, |t, c| t.with(c, |_, x| format!("{:?}", x * 1e3))));
    vec![
        ("comma.csv", plain.clone().into()),
        ("semicolon.csv", r.separated(";").into()),
        ("tab.tsv", r.separated("\t").into()),
        ("bar.csv", r.separated("|").into()),
        ("blanks.txt", r.separated("   ").into()),
        ("decimal-comma.csv", r.decimal_commas().separated(";").into()),
        ("decimal-comma-tab.txt", r.decimal_commas().separated("\t").into()),
        ("decimal-comma-quoted.csv", r.decimal_commas().lines(quoted).into()),
        ("mark.csv", format!("\u{feff}{plain}").into()),
        ("utf16.csv", utf16(&plain, true, false)),
        ("utf16-swapped.csv", utf16(&plain, true, true)),
        ("utf16-without-mark.csv", utf16(&plain, false, false)),
        ("gzip.csv.gz", gzip(&plain)),
        ("comments.csv", format!("# rig 7\n% 2026\n// left\n\n{plain}").into()),
        ("lines.csv", plain.replace('\n', "\r\n").into()),
        ("quotes.csv", r.lines(quoted).into()),
        ("separator-said.csv", format!("sep=;\n{}", r.separated(";")).into()),
        ("trailing.csv", r.lines(|r| r.join(",") + ",").into()),
        ("index.csv", index.separated(",").into()),
        ("numpy.txt", format!("# {}\n{}", r.names.join(" "), body(r, " ")).into()),
        (
            "header-units.csv",
            milli.with(0, |_, t| format!("{:?}", t * 1e3)).separated(",").into(),
        ),
        (
            "header-in.csv",
            with_units(|n, u| format!("{n} in {u}")).separated(",").into(),
        ),
        (
            "header-slash.csv",
            with_units(|n, u| format!("{n} / {u}")).separated(";").into(),
        ),
        ("units-below.csv", below.separated(",").into()),
        ("units-in-names.csv", degrees(r.named(spelt)).separated(",").into()),
        ("degree-sign.csv", latin),
        ("upper.csv", upper.separated(",").into()),
        ("time.csv", plain.replacen("t,", "Time,", 1).into()),
        ("iso.csv", moments("2026-11-22T", '.', "").separated(",").into()),
        (
            "iso-blank-zone.csv",
            moments("2026-11-22 ", '.', "+01:00").separated(",").into(),
        ),
        ("iso-comma.csv", moments("2026-11-22T", ',', "Z").separated(";").into()),
        ("of-day.csv", moments("", '.', "").separated(",").into()),
        ("elsewhere.csv", shifted(17.3).separated(",").into()),
        ("before.csv", shifted(-0.25).separated(",").into()),
        ("idle.csv", idle.separated(",").into()),
        (
            "without-i_eq.csv",
            r.columns(&[0, 1, 2, 3, 4, 6, 7, 8]).separated(",").into(),
        ),
    ]
}

/// What a diagnosis found, to a part in 10^12: units change the last bits.
fn found(d: &Value) -> (String, Vec<f64>) {
    let number = |fault: &str, key: &str| d[fault][key].as_f64().unwrap();
    let keys = ["lo", "estimate", "hi"];
    let all = ["fsj", "zeta"].into_iter().flat_map(|f| keys.map(|k| number(f, k)));
    (d["outcome"].as_str().unwrap().into(), all.collect())
}

#[test]
fn e2e_a_recording_in_every_dialect_is_diagnosed_alike() {
    let dir = tempfile::tempdir().unwrap();
    let r = Recorded::new(dir.path());
    let right = found(&json(&["diagnose", text(&dir.path().join("recorded.csv")), "--json"]));
    assert_eq!(right.0, "located");
    for (name, bytes) in accepted(&r) {
        let file = dir.path().join(name);
        std::fs::write(&file, bytes).unwrap();
        let d = json(&["diagnose", text(&file), "--json"]);
        let this = found(&d);
        let alike = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-12 * b.abs();
        assert!(
            this.0 == right.0 && this.1.iter().zip(&right.1).all(alike),
            "{name}: {this:?} for {right:?}"
        );
        let read = d["read"].to_string();
        for (part, says) in [
            ("header-units", "omega_m from `omega_m (rpm)` in rpm"),
            ("without-i_eq", "i_eq is half the sum"),
            ("elsewhere", "the first row, at 17.301 s, is sample 1 of the test"),
            ("idle", "sample -499"),
            ("iso", "at a time of day"),
        ] {
            assert!(!name.starts_with(part) || read.contains(says), "{name}: {read}");
        }
    }
    // the study reads the same tables
    let verdicts = ["comma.csv", "header-units.csv", "decimal-comma.csv"].map(|name| {
        let out = dir.path().join("study");
        let file = dir.path().join(name);
        let d = json(&["discrepancy", "--bench", text(&file), "--out", text(&out), "--json"]);
        let zeta = d["findings"][1]["value"].as_f64().unwrap();
        (d["verdict"].clone(), (zeta * 1e9).round())
    });
    assert!(verdicts.iter().all(|v| *v == verdicts[0]), "{verdicts:?}");
}

#[test]
fn e2e_columns_of_other_names_are_mapped() {
    let dir = tempfile::tempdir().unwrap();
    let r = Recorded::new(dir.path());
    let right = found(&json(&["diagnose", text(&dir.path().join("recorded.csv")), "--json"]));
    let names = ["Zeit", "Soll", "user", "angle", "speed", "abs", "u", "v", "w"];
    let file = dir.path().join("own.csv");
    let rpm = |_: usize, x: f64| format!("{:?}", -2.0 * x * 60.0 / std::f64::consts::TAU);
    std::fs::write(&file, r.named(names).with(4, rpm).separated(";")).unwrap();
    refused(
        &["diagnose", text(&file)],
        &[
            "own.csv: header",
            "missing: t, com, theta_m, omega_m, i_eq",
            "--channels",
        ],
    );
    let map = dir.path().join("rig.toml");
    let channels = "[rig]\nkind = \"rotary\"\n[channels]\ntime = { column = \"Zeit\", unit = \"s\" }\ncommand = { column = \"Soll\" }\n\
                    position = { column = \"angle\", resolution = 1e-4 }\nvelocity = { column = \"speed\", unit = \"rpm\", scale = -0.5 }\n\
                    current_abs = { column = \"abs\" }\ni_a = { column = \"u\" }\ni_b = { column = \"v\" }\ni_c = { column = \"w\" }\n";
    std::fs::write(&map, channels).unwrap();
    let d = json(&["diagnose", text(&file), "--channels", text(&map), "--json"]);
    let (this, alike) = (found(&d), |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-12 * b.abs());
    assert!(this.1.iter().zip(&right.1).all(alike), "{this:?} for {right:?}");
    for said in [
        "omega_m from `speed` in rpm times -0.5",
        "t from `Zeit` in s",
        "i_a from `u` in A (assumed",
    ] {
        assert!(d["read"].to_string().contains(said), "{said}: {}", d["read"]);
    }
    // a study of the same table as the diagnosis says that it is to be run
    let odd = dir.path().join("odd.csv");
    let more = |_: usize, x: f64| format!("{:?}", 1.1 * x);
    let currents = (5..9).fold(r.named(names).with(4, rpm), |r, c| r.with(c, more));
    std::fs::write(&odd, currents.separated(";")).unwrap();
    let d = json(&["diagnose", text(&odd), "--channels", text(&map), "--json"]);
    assert_eq!(d["outcome"], "unexplained");
    let next = d["next_command"].as_str().unwrap();
    let words: Vec<&str> = next.split(' ').skip(1).collect();
    let said = succeeded(ema(&words).current_dir(dir.path()));
    assert!(said.contains("written: study/report.json"), "{said}");
    // the intervals of a stranger are no one's own
    let advice = |file: &Path, more: &[&str]| ok(&[&["diagnose", text(file)], more].concat()).contains("\nadvice ");
    let map_of = ["--channels", text(&map)];
    assert!(advice(&file, &map_of) && !advice(&file, &[&map_of[..], &["--spread", "none"]].concat()));
    let ours = dir.path().join("ours.parquet");
    ok(&["run", "--rate", "1000", "--sensors", "reference", "--out", text(&ours)]);
    assert!(!advice(&ours, &[]));
    // a unit that the header states needs no word
    let stated = dir.path().join("stated.csv");
    let names = ["Zeit [s]", "Soll", "user", "angle", "speed [rpm]", "abs", "u", "v", "w"];
    std::fs::write(&stated, r.named(names).with(4, rpm).separated(";")).unwrap();
    let bare = channels.replace(", unit = \"rpm\"", "").replace(", unit = \"s\"", "");
    std::fs::write(&map, bare).unwrap();
    let this = found(&json(&["diagnose", text(&stated), "--channels", text(&map), "--json"]));
    assert!(this.1.iter().zip(&right.1).all(alike), "{this:?} for {right:?}");
    for (from, to, says) in [
        ("\"speed\"", "\"tempo\"", &["own.csv", "no column `tempo`", "speed"][..]),
        (
            "unit = \"rpm\"",
            "unit = \"knots\"",
            &["rig.toml", "knots", "rad/s"][..],
        ),
        ("scale = -0.5", "delay_s = 0.01", &["rig.toml", "delay_s", "0.01"][..]),
        ("command", "comand", &["rig.toml", "comand", "command"][..]),
        (
            "scale",
            "scael",
            &["rig.toml", "velocity.scael", "scale", "minus", "offset"][..],
        ),
        // what does not belong to the angle
        (
            "scale = -0.5",
            "scale = -1",
            &["own.csv", "`speed`", "2.000", "pole pairs", "0.8 to 1.25"][..],
        ),
        (
            "scale = -0.5",
            "scale = 0.5",
            &["own.csv", "`speed`", "reversed sign"][..],
        ),
        (
            "unit = \"rpm\"",
            "unit = \"deg/s\"",
            &["own.csv", "`speed`", "times the speed of the angle"][..],
        ),
    ] {
        std::fs::write(&map, channels.replace(from, to)).unwrap();
        refused(&["diagnose", text(&file), "--channels", text(&map)], says);
    }
}

#[test]
fn e2e_what_cannot_be_read_honestly_is_refused_with_its_cause() {
    let dir = tempfile::tempdir().unwrap();
    let r = Recorded::new(dir.path());
    let plain = r.separated(",");
    let mut twice = r.with(0, |_, t| t.to_string());
    twice.names[0] = "Time".into();
    twice.names.push("TIME".into());
    twice.rows.iter_mut().for_each(|r| r.push(r[0].clone()));
    let seconds = r.with(0, |_, t| format!("2026-11-22T10:00:{:02}", t as u32));
    let other = r.with(1, |i, _| ((i % 77) as f64).to_string());
    let cell = |text: &str| r.with(4, |i, x| if i == 7 { text.into() } else { x.to_string() });
    let named = |c: usize, name: &str| {
        let mut t = r.with(0, |_, t| t.to_string());
        t.names[c] = name.into();
        t.separated(",").into_bytes()
    };
    let mut torn = gzip(&plain);
    torn.truncate(torn.len() / 2);
    let cases: Vec<(&str, Vec<u8>, &[&str])> = vec![
        (
            "no-header.csv",
            plain.split_once('\n').unwrap().1.into(),
            &["line 1", "a header with the names"],
        ),
        (
            "thousands.csv",
            cell("1.234,5").separated(";").into(),
            &["line 9, column `omega_m`", "1.234,5", "none of thousands"],
        ),
        (
            "both-marks.csv",
            cell("1,5").separated(";").into(),
            &["line 9, column `omega_m`", "one decimal mark"],
        ),
        (
            "commas.csv",
            r.decimal_commas().separated(",").into(),
            &["line 2", "9 columns", "decimal commas need another separator"],
        ),
        (
            "book.xlsx",
            b"PK\x03\x04 and so on".into(),
            &["Excel", "save the sheet as CSV"],
        ),
        ("data.mat", b"MATLAB 5.0 MAT-file".into(), &["MATLAB", "parquetwrite"]),
        ("data.h5", b"\x89HDF\r\n".into(), &["HDF5"]),
        (
            "knots.csv",
            named(4, "omega_m [knots]"),
            &["column `omega_m [knots]`", "knots", "rpm"],
        ),
        ("missing.csv", named(4, "speed"), &["header", "missing: omega_m"]),
        ("two-times.csv", twice.separated(",").into(), &["`Time` beside `TIME`"]),
        (
            "seconds.csv",
            seconds.separated(",").into(),
            &["line 3, column `t`", "a time after 0"],
        ),
        (
            "word.csv",
            cell("bad").separated(",").into(),
            &["line 9, column `omega_m`", "found `bad`"],
        ),
        (
            "empty.csv",
            cell("").separated(",").into(),
            &["line 9, column `omega_m`", "found nothing"],
        ),
        (
            "infinite.csv",
            cell("inf").separated(",").into(),
            &["line 9, column `omega_m`", "found inf"],
        ),
        (
            "other-command.csv",
            other.with(0, |_, t| format!("{:.3}", t - 1.0)).separated(",").into(),
            &["-0.999 s", "--sequence"],
        ),
        ("torn.csv.gz", torn, &["gzip", "not whole"]),
        (
            "bytes.csv",
            b"t,com\0\0\x01\x02,".repeat(9),
            &["bytes that are no text"],
        ),
    ];
    for (name, bytes, says) in cases {
        let file = dir.path().join(name);
        std::fs::write(&file, bytes).unwrap();
        refused(&["diagnose", text(&file)], &[&[name], says].concat());
    }
}

#[test]
fn e2e_our_own_csv_is_read_by_others_with_their_defaults() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("run.csv");
    ok(&["run", "--rate", "1000", "--sensors", "reference", "--out", text(&file)]);
    for line in std::fs::read_to_string(&file).unwrap().lines().skip(1) {
        let whole = line.split(',').find(|c| !c.contains(['.', 'e']));
        assert_eq!(whole, None, "{line}");
    }
    let python = std::env::var("EMA_PYTHON").unwrap_or_else(|_| "python3".into());
    let script = "import sys, pandas, polars\n\
                  a, b = pandas.read_csv(sys.argv[1]), polars.read_csv(sys.argv[1])\n\
                  assert all(str(t) == 'float64' for t in a.dtypes), a.dtypes\n\
                  assert all(t == polars.Float64 for t in b.dtypes), b.dtypes\n\
                  assert len(a) == len(b) == 3000\n";
    let done = std::process::Command::new(python)
        .args(["-c", script, text(&file)])
        .output();
    match done {
        Ok(o) if o.status.success() => {}
        Ok(o) if String::from_utf8_lossy(&o.stderr).contains("ModuleNotFoundError") => {
            println!("skipped: no pandas, polars")
        }
        Ok(o) => panic!("{}", String::from_utf8_lossy(&o.stderr)),
        Err(_) => println!("skipped: no Python"),
    }
}
