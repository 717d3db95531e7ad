//! `ema` as people and programs find it: help, completions, manual pages, what is said beside results, and the schema of
//! every JSON output.

use crate::common;

use crate::common::process::*;
use ema_tests::lives::{Options, files, generate};
use ema_tests::stream::TestDomain;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const SCHEMAS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../schemas/json");
const REFERENCE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../datasets/parameters/reference.toml");

/// What is called for each command below `ema`, with the words that lead there.
fn each(mut call: impl FnMut(&[String], &dyn Fn(&str) -> bool, usize, &[String])) {
    let mut waiting = vec![(Vec::new(), pipeline::cli::command())];
    while let Some((path, command)) = waiting.pop() {
        for c in command.get_subcommands() {
            let mut below = path.clone();
            below.push(c.get_name().to_string());
            waiting.push((below, c.clone()));
        }
        let options: Vec<_> = command
            .get_arguments()
            .filter(|a| {
                !a.is_positional() && !a.is_hide_set() && !["help", "version", "quiet"].contains(&a.get_id().as_str())
            })
            .collect();
        let bare = options.iter().filter(|a| a.get_help_heading().is_none());
        let bare: Vec<String> = bare.map(|a| a.get_id().to_string()).collect();
        let has = |id: &str| options.iter().any(|a| a.get_id().as_str() == id);
        call(&path, &has, options.len(), &bare);
    }
}

#[test]
fn long_lists_of_options_stand_under_headings() {
    let grouped = [
        "diagnose",
        "discrepancy",
        "live",
        "replay",
        "simulate",
        "prognosis",
        "run",
    ];
    let mut seen = 0;
    each(|path, _, options, bare| {
        let is_named = path.len() == 1 && grouped.contains(&path[0].as_str());
        seen += usize::from(is_named);
        if is_named || options > 8 {
            assert!(bare.is_empty(), "{path:?}: {bare:?}");
        }
    });
    assert_eq!(seen, grouped.len());
    let help = |how: &str| ok(&["diagnose", how]);
    let (short, long) = (help("-h"), help("--help"));
    for heading in ["Recording:", "Maps and intervals:", "Actuator and test:", "Output:"] {
        assert!(short.contains(heading) && long.contains(heading), "{short}");
    }
    assert!(long.len() > short.len() + 500, "{short}\n{long}");
    assert!(long.contains("phase_resistance_ohm") && !short.contains("phase_resistance_ohm"));
    // a command in one screen
    assert!(short.lines().count() < 50, "{short}");
    let (short, long) = (ok(&["-h"]), ok(&["--help"]));
    assert!(
        long.contains("Exit codes: 0 done") && !short.contains("Exit codes: 0"),
        "{short}"
    );
}

#[test]
fn e2e_a_file_of_parameters_has_one_name() {
    each(|path, has, _, _| assert!(!has("model") || path != ["discrepancy"] || !has("actuator"), "{path:?}"));
    let help = ok(&["discrepancy", "--help"]);
    assert!(
        help.contains("--actuator <FILE>") && !help.contains("--model"),
        "{help}"
    );
    assert!(ok(&["maps", "-h"]).contains("--id <ID>"));
    // the former names still do
    let words = ["none.toml", "cannot be read"];
    for name in ["--actuator", "--model"] {
        refused(&["discrepancy", name, "none.toml", "--bench", "none.csv"], &words);
    }
    let o = run(&["maps", "none", "--actuator", "x"]);
    assert_eq!(o.status.code(), Some(4), "{}", String::from_utf8_lossy(&o.stderr));
}

#[test]
fn e2e_completions_know_every_command() {
    let dir = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = ok(&["completions", shell]);
        each(|path, _, _, _| {
            if let Some(name) = path.last() {
                assert!(script.contains(name.as_str()), "{shell}: {path:?}");
            }
        });
    }
    refuse_shell("tcsh");
    let file = dir.path().join("ema.bash");
    std::fs::write(&file, ok(&["completions", "bash"])).unwrap();
    let bash = |args: &[&str]| Command::new("bash").args(args).output();
    let Ok(o) = bash(&["-n", text(&file)]) else {
        println!("skipped: no bash");
        return;
    };
    assert!(o.status.success(), "{}", String::from_utf8_lossy(&o.stderr));
    // as the shell asks when somebody presses the key
    let asked = |words: &[&str]| {
        let last = words[words.len() - 1];
        let line = format!(
            "source '{}'; COMP_WORDS=({}); COMP_CWORD={}; _ema ema '{last}' '{}'; echo \"${{COMPREPLY[@]}}\"",
            file.display(),
            words.join(" "),
            words.len() - 1,
            words[words.len() - 2],
        );
        let o = bash(&["-c", &line]).unwrap();
        String::from_utf8(o.stdout).unwrap().trim().to_string()
    };
    assert_eq!(asked(&["ema", "dia"]), "diagnose");
    assert_eq!(asked(&["ema", "dataset", "ma"]), "make maps");
    assert_eq!(asked(&["ema", "unit", "u"]), "update");
    assert_eq!(asked(&["ema", "diagnose", "--ref"]), "--refine");
    assert_eq!(asked(&["ema", "discrepancy", "--mod"]), "");
}

fn refuse_shell(name: &str) {
    let o = run(&["completions", name]);
    assert_eq!(o.status.code(), Some(2));
}

#[test]
fn e2e_every_command_has_a_manual_page() {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("a/man1");
    ok(&["man", "--out", text(&out)]);
    let mut pages = 0;
    each(|path, _, _, _| {
        let name = [&["ema".to_string()], path].concat().join("-");
        let page = std::fs::read_to_string(out.join(format!("{name}.1"))).unwrap();
        assert!(page.contains(".TH") && page.len() > 200, "{name}");
        pages += 1;
    });
    assert!(pages > 30, "{pages}");
    let files = std::fs::read_dir(&out).unwrap().count();
    assert_eq!(files, pages, "no page of what is no command");
    let page = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    assert!(page("ema-dataset-make.1").contains("fleet plan"));
    assert!(page("ema.1").contains("Exit codes"));
    assert!(page("ema-discrepancy.1").contains("named_with_remainder"));
    // a file in the place of the folder
    let file = dir.path().join("file");
    std::fs::write(&file, "").unwrap();
    let o = run(&["man", "--out", text(&file)]);
    assert_eq!(o.status.code(), Some(1), "{}", String::from_utf8_lossy(&o.stderr));
}

/// A short history of one unit.
fn history(dir: &Path) -> PathBuf {
    let file = dir.join("history.csv");
    let mut rows = "actuator,cycle,outcome,fsj_lo,fsj_hi,fsj_estimate,zeta_lo,zeta_hi,zeta_estimate\n".to_string();
    for i in 1..=60 {
        let x = 1.0 + 0.02 * f64::from(i) + 0.001 * f64::from(i * 7 % 5);
        let z = 0.05 + 0.003 * f64::from(i) + 0.0002 * f64::from(i * 3 % 5);
        let [x, z] = [(x, 0.01), (z, 0.002)].map(|(x, half)| format!("{:.4},{:.4},{x:.4}", x - half, x + half));
        rows += &format!("tail7,{i},located,{x},{z}\n");
    }
    std::fs::write(&file, rows).unwrap();
    file
}

#[test]
fn e2e_quiet_leaves_results_and_errors() {
    let dir = tempfile::tempdir().unwrap();
    let file = history(dir.path());
    let said = |args: &[&str]| {
        let o = run(args);
        let [out, err] = [o.stdout, o.stderr].map(|b| String::from_utf8(b).unwrap());
        (o.status.code(), out, err)
    };
    let (code, told, note) = said(&["prognosis", text(&file)]);
    assert!(code == Some(0) && note.contains("(assumed)"), "{note}");
    for args in [
        &["--quiet", "prognosis", text(&file)],
        &["prognosis", text(&file), "--quiet"],
    ] {
        assert_eq!(said(args), (Some(0), told.clone(), String::new()));
    }
    // of commands below commands
    let (code, out, err) = said(&["unit", "new", text(&dir.path().join("u.json")), "--quiet"]);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    assert!(!out.is_empty());
    let (code, out, err) = said(&["--quiet", "diagnose", "none.csv"]);
    assert_eq!((code, out.as_str(), err.lines().count()), (Some(4), "", 1), "{err}");
    // and of the other program
    for args in [
        &["--quiet", "query", "--list"],
        &["query", "--list", "--quiet"],
        &["query", "--quiet", "--list"],
    ] {
        let (code, out, err) = said(args);
        assert_eq!((code, err.as_str()), (Some(0), ""), "{args:?}");
        assert!(out.contains("tables for SQL:"));
    }
}

#[test]
fn e2e_progress_is_a_plain_line_every_ten_seconds_where_no_terminal_is() {
    let dir = tempfile::tempdir().unwrap();
    // more than anybody waits for
    let start = |out: &str, more: &[&str]| {
        let out = dir.path().join(out);
        let many = "0,20,40,60,80,100,120,140,160,180,200,220,240,260,280,300,320,340";
        let args = [
            "simulate",
            "--grid",
            "fine",
            "--rest-angle-deg",
            many,
            "--jobs",
            "1",
            "--out",
            text(&out),
        ];
        ema(&[&args[..], more].concat())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let begin = Instant::now();
    let (mut loud, mut quiet) = (start("loud", &[]), start("quiet", &["--quiet"]));
    let mut lines = BufReader::new(loud.stderr.take().unwrap()).lines();
    let line = lines.next().unwrap().unwrap();
    let waited = begin.elapsed();
    std::thread::sleep(Duration::from_secs(1));
    for child in [&mut loud, &mut quiet] {
        assert!(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
    }
    loud.wait().unwrap();
    let silence = quiet.wait_with_output().unwrap().stderr;
    assert!((10..60).contains(&waited.as_secs()), "{waited:?}: {line}");
    assert!(
        line.starts_with("simulate: ") && line.contains(" of 12474 runs"),
        "{line}"
    );
    assert!(line.ends_with(" left"), "{line}");
    assert!(!line.chars().any(char::is_control), "{line:?}");
    assert_eq!(String::from_utf8_lossy(&silence), "");
}

/// Checks an output against its schema, and that the schema knows every key of it.
struct Schema {
    name: String,
    as_is: jsonschema::Validator,
    strict: jsonschema::Validator,
}

impl Schema {
    fn read(name: &str) -> Schema {
        let file = Path::new(SCHEMAS).join(format!("{name}.schema.json"));
        let schema: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
        assert_eq!(
            schema["$schema"], "https://json-schema.org/draft/2020-12/schema",
            "{name}"
        );
        jsonschema::meta::validate(&schema).unwrap_or_else(|e| panic!("{name}: {e}"));
        let mut closed = schema.clone();
        close(&mut closed);
        Schema {
            name: name.into(),
            as_is: jsonschema::validator_for(&schema).unwrap(),
            strict: jsonschema::validator_for(&closed).unwrap(),
        }
    }

    fn check(&self, v: &Value) {
        for validator in [&self.as_is, &self.strict] {
            let errors: Vec<String> = validator
                .iter_errors(v)
                .map(|e| format!("{}: {e}", e.instance_path()))
                .collect();
            assert!(errors.is_empty(), "{}: {errors:#?}\n{v}", self.name);
        }
        if let Value::Object(all) = v {
            assert_eq!(all["schema_version"], schemas::SCHEMA_VERSION, "{}", self.name);
            for key in all.keys() {
                let mut less = v.clone();
                less.as_object_mut().unwrap().remove(key);
                let optional = [
                    "method",
                    "refined",
                    "unit",
                    "read",
                    "next_command",
                    "diagnoses",
                    "reads_as_fsj",
                ];
                let optional = optional.contains(&key.as_str()) && ["diagnose", "discrepancy"].contains(&&*self.name);
                assert!(optional || !self.as_is.is_valid(&less), "{}: without {key}", self.name);
            }
        }
    }
}

/// Other keys than those that are named are refused from now on.
fn close(v: &mut Value) {
    match v {
        Value::Object(o) => {
            if o.contains_key("properties") {
                o.entry("additionalProperties").or_insert(false.into());
            }
            o.values_mut().for_each(close);
        }
        Value::Array(a) => a.iter_mut().for_each(close),
        _ => {}
    }
}

/// Runs, and checks what comes against a schema; the code is one of those that are told.
fn checked(name: &str, args: &[&str]) -> Value {
    let o = run(args);
    let code = o.status.code().unwrap();
    let out = String::from_utf8(o.stdout).unwrap();
    assert!(
        [0, 3].contains(&code),
        "{args:?}: {}",
        String::from_utf8_lossy(&o.stderr)
    );
    exit_code(code);
    let v: Value = serde_json::from_str(&out).unwrap_or_else(|e| panic!("{args:?}: {e}: {out}"));
    Schema::read(name).check(&v);
    v
}

fn exit_code(code: i32) {
    let codes = Schema::read("exit_code");
    assert!(codes.as_is.is_valid(&code.into()), "{code}");
}

/// The commands with `--json`, and the schema of each; `ema query` has `--format json`.
const TOLD: [(&str, &str); 15] = [
    ("bench", "bench"),
    ("calibrate", "calibrate"),
    ("check", "check"),
    ("dataset maps", "maps_quality"),
    ("dataset verify", "dataset_verify"),
    ("diagnose", "diagnose"),
    ("discrepancy", "discrepancy"),
    ("live", "live"),
    ("maps", "maps_quality"),
    ("plan", "plan"),
    ("prognosis", "prognosis"),
    ("prognosis score", "prognosis_score"),
    ("unit repair", "unit"),
    ("unit show", "unit"),
    ("unit update", "unit"),
];

#[test]
fn every_command_that_speaks_json_has_a_schema() {
    let mut found = Vec::new();
    each(|path, has, _, _| {
        if has("json") {
            found.push(path.join(" "));
        }
    });
    found.sort();
    let told: Vec<&str> = TOLD.iter().map(|t| t.0).collect();
    assert_eq!(found, told);
    let mut files: Vec<String> = std::fs::read_dir(SCHEMAS)
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    files.sort();
    let mut wanted: Vec<&str> = TOLD.iter().map(|t| t.1).chain(["exit_code", "query"]).collect();
    wanted.sort_unstable();
    wanted.dedup();
    let wanted: Vec<String> = wanted.iter().map(|n| format!("{n}.schema.json")).collect();
    assert_eq!(files, wanted);
    wanted
        .iter()
        .for_each(|f| drop(Schema::read(f.trim_end_matches(".schema.json"))));
    [0, 1, 2, 3, 4, 130].into_iter().for_each(exit_code);
    assert!(!Schema::read("exit_code").as_is.is_valid(&5.into()));
}

#[test]
fn e2e_diagnoses_units_and_studies_follow_their_schemas() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let [test, broken, unit, csv] = ["test.parquet", "broken.csv", "unit.json", "healthy.csv"].map(path);
    let grid = ["--grid", "coarse"];
    ok(&[
        "run",
        "--fsj",
        "3",
        "--zeta",
        "0.3",
        "--sensors",
        "reference",
        "--rate",
        "1000",
        "--out",
        &test,
    ]);
    ok(&["run", "--sensors", "reference", "--rate", "1000", "--out", &csv]);
    let diagnose = |more: &[&str]| checked("diagnose", &[&["diagnose", &test, "--json"], &grid[..], more].concat());
    assert_eq!(diagnose(&[])["outcome"], "located");
    assert_eq!(diagnose(&["--method", "paper"])["method"], "paper");
    assert!(diagnose(&["--refine"])["refined"]["runs"].is_u64());
    // half a test
    let table = std::fs::read_to_string(&csv).unwrap();
    let half: Vec<&str> = table.lines().take(1500).collect();
    std::fs::write(&broken, half.join("\n")).unwrap();
    let d = checked("diagnose", &[&["diagnose", &broken, "--json"], &grid[..]].concat());
    assert_eq!(d["outcome"], "incomplete", "{d}");
    ok(&["unit", "new", &unit]);
    let show = || checked("unit", &["unit", "show", &unit, "--json"]);
    assert!(show()["present"].is_null());
    checked(
        "unit",
        &[&["unit", "update", &unit, &csv, "--healthy", "--json"], &grid[..]].concat(),
    );
    assert_eq!(show()["history"].as_array().unwrap().len(), 1);
    assert!(diagnose(&["--unit", &unit])["unit"]["name"].is_string());
    let repaired = checked("unit", &["unit", "repair", &unit, "--part", "motor", "--json"]);
    assert_eq!(repaired["repairs"][0]["part"], "motor");
    let out = path("study");
    let study = [
        "discrepancy",
        "--bench",
        &csv,
        "--healthy",
        "--json",
        "--out",
        &out,
        "--diagnose",
        &test,
    ];
    let found = checked("discrepancy", &study);
    assert_eq!(found["diagnoses"].as_array().unwrap().len(), 1);
    let report: Value = serde_json::from_str(&std::fs::read_to_string(path("study/report.json")).unwrap()).unwrap();
    Schema::read("discrepancy").check(&report);
    checked("check", &["check", REFERENCE, "--json"]);
}

#[test]
fn e2e_datasets_and_maps_follow_their_schemas() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("data");
    let data = text(&data);
    let plan = concat!(env!("CARGO_MANIFEST_DIR"), "/../datasets/fleets/demo.toml");
    ok(&[
        "simulate",
        "--grid",
        "coarse",
        "--rate",
        "1000",
        "--sensors",
        "reference",
        "--out",
        data,
    ]);
    assert_eq!(
        checked("dataset_verify", &["dataset", "verify", data, "--json"])["whole"],
        true
    );
    checked("maps_quality", &["maps", data, "--quality", "--json"]);
    checked("maps_quality", &["dataset", "maps", data, "--quality", "--json"]);
    checked("calibrate", &["calibrate", data, "--runs", "256", "--json"]);
    checked(
        "query",
        &["query", "SELECT * FROM features", "--data", data, "--format", "json"],
    );
    // what stands there now is no part of a dataset
    let v = checked("dataset_verify", &["dataset", "verify", data, "--json"]);
    assert!(!v["findings"].as_array().unwrap().is_empty());
    checked("plan", &["plan", plan, "--json"]);
    checked("bench", &["bench", "--json"]);
}

#[test]
fn e2e_prognoses_follow_their_schemas() {
    let dir = tempfile::tempdir().unwrap();
    let file = history(dir.path());
    let thresholds = ["--threshold", "fsj=4", "--threshold", "zeta=0.4", "--json"];
    let lines = ok(&[&["prognosis", text(&file)], &thresholds[..]].concat());
    let schema = Schema::read("prognosis");
    let objects: Vec<Value> = lines.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(objects.len(), 3, "fsj, zeta, joint");
    objects.iter().for_each(|v| schema.check(v));
    let options = Options {
        units: 8,
        seed: 6,
        ..Options::default()
    };
    files::write(dir.path(), &options, &generate(&options)).unwrap();
    let [lives, truth] = ["history.csv", "truth.csv"].map(|n| dir.path().join(n));
    let score = ["prognosis", "score", text(&lives), "--truth", text(&truth)];
    let score = [&score[..], &["--threshold", "fsj=4", "--clock", "cycle", "--json"]].concat();
    checked("prognosis_score", &score);
}

#[test]
fn e2e_live_lines_follow_their_schema() {
    let dir = tempfile::tempdir().unwrap();
    let (domain, log) = (TestDomain::default(), dir.path().join("log.jsonl"));
    let (file, _) = common::recording();
    let mut live = common::live(&domain, &["--exit-after", "1", "--quiet", "--log", text(&log)]);
    common::ok(&domain, &["replay", text(file), "--speed", "max"]);
    assert_eq!(live.code(), Some(0), "{}", live.errors());
    assert_eq!(live.errors(), "");
    let schema = Schema::read("live");
    let lines = live.json();
    assert!(lines.iter().any(|l| l["final"] == true), "{lines:?}");
    lines.iter().for_each(|l| schema.check(l));
    // the log has the same keys but for the version, which is that of the file's readers
    let logged = std::fs::read_to_string(&log).unwrap();
    let mut logged: Value = serde_json::from_str(logged.lines().next().unwrap()).unwrap();
    assert!(logged.get("schema_version").is_none(), "{logged}");
    logged["schema_version"] = schemas::SCHEMA_VERSION.into();
    schema.check(&logged);
}
