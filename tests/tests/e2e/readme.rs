//! README and guide say what the program does: what README shows of commands comes from them, every command stands in the
//! guide, the live table is today's, and no link leads nowhere.

use crate::common::process::*;
use ema_tests::stream::{Program, TestDomain};
use std::path::{Path, PathBuf};
use std::time::Duration;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

fn text_of(file: &str) -> String {
    let path = root().join(file);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Fenced blocks: what stands behind the fence, and the lines within.
fn blocks(text: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if let Some(info) = line.strip_prefix("```") {
            let body: Vec<_> = lines.by_ref().take_while(|l| *l != "```").collect();
            found.push((info.to_string(), body.join("\n") + "\n"));
        }
    }
    found
}

/// `run.csv` as a test stand of a German hand would have written it.
fn bench_csv(run: &str) -> String {
    let mut lines = run.lines();
    let names: Vec<_> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|n| *n == name).unwrap();
    let (degrees, rpm) = (180.0 / std::f64::consts::PI, 30.0 / std::f64::consts::PI);
    let columns = [
        ("t", 1e3),
        ("com", degrees),
        ("theta_m", degrees),
        ("omega_m", rpm),
        ("i_a", 1.0),
        ("i_b", 1.0),
        ("i_c", 1.0),
    ]
    .map(|(name, factor)| (column(name), factor));
    let mut out = String::from("Zeit [ms];Soll [deg];Motor [deg];Drehzahl [1/min];Iu [A];Iv [A];Iw [A]\n");
    for line in lines {
        let values: Vec<f64> = line.split(',').map(|v| v.parse().unwrap()).collect();
        // nine digits, without zeros at the end
        let cells = columns.map(|(k, factor)| {
            let rounded: f64 = format!("{:.8e}", values[k] * factor).parse().unwrap();
            rounded.to_string().replace('.', ",")
        });
        out += &(cells.join(";") + "\n");
    }
    out
}

#[test]
fn what_readme_shows_is_what_is_printed() {
    let dir = tempfile::tempdir().unwrap();
    let mut printed = String::new();
    let mut compared = 0;
    for (info, body) in blocks(&text_of("README.md")) {
        if info == "sh" {
            printed = succeeded(shell(&body).current_dir(dir.path()));
            let bench = dir.path().join("bench.csv");
            if !bench.exists() {
                let run = std::fs::read_to_string(dir.path().join("run.csv")).unwrap();
                std::fs::write(bench, bench_csv(&run)).unwrap();
            }
        } else if info == "text" {
            assert_eq!(printed, body);
            compared += 1;
        } else if info == "csv" {
            let bench = std::fs::read_to_string(dir.path().join("bench.csv")).unwrap();
            let shown = body.strip_suffix("...\n").unwrap();
            assert!(bench.starts_with(shown), "{}", &bench[..200]);
            compared += 1;
        } else if let Some(file) = info.strip_prefix("toml file=") {
            std::fs::write(dir.path().join(file), body).unwrap();
        }
    }
    // the last block diagnoses with the unit's file
    assert!(printed.contains("located") && printed.contains("tail7"), "{printed}");
    assert_eq!(compared, 2);
}

#[test]
fn the_guide_names_every_command() {
    let guide = text_of("pipeline/book/src/guide/commands.md");
    let rows: Vec<_> = guide.lines().filter_map(|l| l.strip_prefix("| `")).collect();
    for command in pipeline::cli::command().get_subcommands() {
        let name = command.get_name();
        let is_there = rows.iter().any(|r| r.starts_with(&format!("{name}`")));
        assert!(is_there || name == "help" || command.is_hide_set(), "{name}");
    }
}

#[test]
fn the_live_table_of_the_guide_is_todays() {
    let guide = text_of("pipeline/book/src/guide/live.md");
    let table = blocks(&guide).into_iter().find(|(info, _)| info == "text").unwrap().1;
    let domain = TestDomain::default();
    let domain = &domain.name;
    let mut live = Program::start(ema(&[
        "live",
        "--json",
        "--exit-after",
        "6",
        "--timeout",
        "120",
        "--domain",
        domain,
    ]));
    live.until("ready", Duration::from_secs(60), |p| p.errors().contains("waiting"));
    let said = ok(&[
        "bench-live",
        "--actuators",
        "6",
        "--random-faults",
        "5",
        "--id",
        "aileron",
        "--domain",
        domain,
    ]);
    assert!(live.ends_within(Duration::from_secs(120)).is_some_and(|s| s.success()));
    live.all_lines();
    let rows: Vec<_> = table.lines().filter(|l| l.contains("aileron")).collect();
    assert!(rows.len() > 3);
    for row in rows {
        // actuator, run, bar, lost, lo .. hi, lo .. hi
        let words: Vec<_> = row.trim_matches('│').split_whitespace().collect();
        let diagnoses = live.json();
        let is_it = |d: &&serde_json::Value| d["actuator"] == words[0] && d["outcome"] == "located";
        let d = diagnoses
            .iter()
            .find(is_it)
            .unwrap_or_else(|| panic!("{row}\n{diagnoses:?}\n{said}"));
        for (word, found) in [
            (4, &d["fsj"]["lo"]),
            (6, &d["fsj"]["hi"]),
            (7, &d["zeta"]["lo"]),
            (9, &d["zeta"]["hi"]),
        ] {
            let decimals = words[word].split_once('.').unwrap().1.len();
            assert_eq!(words[word], format!("{:.decimals$}", found.as_f64().unwrap()), "{row}");
        }
    }
}

#[test]
fn no_link_leads_nowhere() {
    let mut files = vec![
        PathBuf::from("README.md"),
        "CONTRIBUTING.md".into(),
        "DESIGN.md".into(),
        "SECURITY.md".into(),
    ];
    files.extend(
        [
            "schemas/README.md",
            "datasets/benches/README.md",
            "pipeline/python/README.md",
        ]
        .map(PathBuf::from),
    );
    let mut folders = vec![PathBuf::from("pipeline/book/src")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root().join(&folder)).unwrap() {
            let path = folder.join(entry.unwrap().file_name());
            if root().join(&path).is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "md") {
                files.push(path);
            }
        }
    }
    let mut seen = 0;
    for file in files {
        let text = text_of(file.to_str().unwrap());
        for part in text.split("](").skip(1) {
            let target = part.split([')', '\n']).next().unwrap();
            let (path, anchor) = target.split_once('#').unwrap_or((target, ""));
            if target.contains(':') || target.contains(' ') {
                continue;
            }
            let there = if path.is_empty() {
                file.clone()
            } else {
                file.parent().unwrap().join(path)
            };
            assert!(root().join(&there).exists(), "{}: {target}", file.display());
            if !anchor.is_empty() {
                let text = text_of(there.to_str().unwrap());
                assert!(headings(&text).any(|h| h == anchor), "{}: {target}", file.display());
            }
            seen += 1;
        }
    }
    assert!(seen > 40, "{seen}");
}

/// Anchors of the headings.
fn headings(text: &str) -> impl Iterator<Item = String> {
    text.lines().filter(|l| l.starts_with('#')).map(|l| {
        let words = l.trim_start_matches('#').trim().to_lowercase();
        words
            .chars()
            .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
            .map(|c| if c == ' ' { '-' } else { c })
            .collect()
    })
}
