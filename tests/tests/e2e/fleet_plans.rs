//! Fleet plans that are wrong or were changed: one line says what and where, nothing is lost, nothing panics.

use ema_tests::fleet::{BARE, Ended, Fleet, VARIED, same};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sim_worker::dataset::plan::DatasetPlan;
use std::path::Path;

const PROGRAM: &str = env!("CARGO_BIN_EXE_sim-worker-under-test");

/// [`BARE`] with `from` replaced by `to`.
fn bare(from: &str, to: &str) -> String {
    assert!(BARE.contains(from), "{from}");
    BARE.replace(from, to)
}

#[test]
fn refuse_a_plan_that_was_changed_on_the_way() {
    let fleet = Fleet::new(PROGRAM, BARE);
    let whole = fleet.single();
    fleet.run(&["--out", "a", "--shard", "0/2"]).done();
    let before = fleet.files("a");
    let grid = ema_tests::fleet::GRID;
    // what differs, in the plan or in a file that it names
    for (plan, grid, there, here) in [
        (format!("seed = 9\n{BARE}"), grid.into(), "", "seed = 9"),
        (
            bare("count = 12", "count = 13"),
            grid.into(),
            "count = 12",
            "count = 13",
        ),
        (
            BARE.into(),
            grid.replace("2.5", "2.0"),
            "fsj = [1.0, 2.5]",
            "fsj = [1.0, 2.0]",
        ),
        // a comment before it is not what differs
        (
            format!("# mine\n\n{}", bare("0.05", "0.06")),
            grid.into(),
            "half_width_relative = 0.05",
            "half_width_relative = 0.06",
        ),
        (
            bare("sequences", "load_n_m = 0.01\nsequences"),
            grid.into(),
            "",
            "load_n_m = 0.01",
        ),
    ] {
        fleet.write("plan.toml", &plan);
        fleet.write("grid.toml", &grid);
        for args in [&["--out", "a", "--shard", "1/2"][..], &["--out", "a", "--merge"]] {
            let ended = fleet.run(args);
            let line = ended.line(4);
            assert!(line.contains("plan.toml") && line.contains("--out"), "{line}");
            assert!(line.contains(there) && line.contains(here), "{here}: {line}");
            same(&fleet.files("a"), &before);
        }
    }
    fleet.write("plan.toml", BARE);
    fleet.write("grid.toml", grid);
    fleet.complete("a");
    same(&fleet.files("a"), &whole);
}

#[test]
fn e2e_comments_and_order_do_not_change_a_plan() {
    let fleet = Fleet::new(PROGRAM, BARE);
    let whole = fleet.single();
    fleet.run(&["--out", "a", "--shard", "0/2"]).done();
    let (head, tables) = BARE.split_once("[aircraft]").unwrap();
    let mut lines: Vec<&str> = head.lines().filter(|l| !l.is_empty()).collect();
    lines.reverse();
    fleet.write(
        "plan.toml",
        &format!(
            "# another order\n{}\n\n[aircraft]  # the same{tables}",
            lines.join("\n")
        ),
    );
    fleet.write("grid.toml", &format!("# two by two\n{}", ema_tests::fleet::GRID));
    fleet.run(&["--out", "a", "--shard", "1/2"]).done();
    fleet.run(&["--out", "a", "--merge"]).done();
    same(&fleet.files("a"), &whole);
}

/// The line about a plan that must be refused.
fn refused(fleet: &Fleet, plan: &str) -> String {
    fleet.write("plan.toml", plan);
    let ended: Ended = fleet.run(&["--out", "a", "--merge"]);
    let line = ended.line(4).to_string();
    println!("{line}");
    assert!(fleet.files("a").is_empty());
    line
}

#[test]
fn refuse_wrong_plans_with_file_place_found_and_allowed() {
    let fleet = Fleet::new(PROGRAM, BARE);
    fleet.write("nothing.toml", "name = \"nothing\"\nsegment = []\n");
    fleet.write("number.toml", &ema_tests::fleet::BRIEF.replace("brief", "1e5"));
    fleet.write("same.toml", ema_tests::fleet::BRIEF);
    fleet.write(
        "falling.toml",
        "name = \"falling\"\nfsj = [1.0, 2.0, 1.5]\nzeta = [0.0]\n",
    );
    fleet.write(
        "endless.toml",
        "name = \"endless\"\nfsj = { from = 0, to = 9, points = 10000 }\nzeta = { from = 0, to = 0.9, points = 10000 }\n",
    );
    fleet.write(
        "long.toml",
        "name = \"long\"\n[[segment]]\ncommand = \"hold\"\nvalue_rad = 0.0\nduration_s = 3600.0\n",
    );
    fleet.write(
        "instant.toml",
        "name = \"instant\"\n[[segment]]\ncommand = \"hold\"\nvalue_rad = 0.0\nduration_s = 1e-5\n",
    );
    let top = |line: &str| format!("{line}\n{BARE}");
    let seq = |name: &str| bare("\"brief.toml\"", &format!("\"{name}\""));
    let grid = |name: &str| bare("\"grid.toml\"", &format!("\"{name}\""));
    let spread = |line: &str| format!("{BARE}{line}\n");
    let uniform = "{ distribution = \"uniform\", half_width_relative = 0.05 }";
    let tails = |list: &str| bare("{ prefix = \"T\", count = 12 }", list);
    let telemetry = |text: &str| format!("{BARE}\n[telemetry]\n{text}\n");
    let one = |text: &str| format!("{BARE}\n[[actuators]]\ntail = \"T01\"\nposition = \"rudder\"\n{text}\n");
    let cases: Vec<(String, &[&str])> = vec![
        // keys and types
        (
            top("colour = \"red\""),
            &["key `colour`", "unknown key", "rest_angle_deg"],
        ),
        (bare("count", "number"), &["aircraft.tails.number", "prefix"]),
        (
            bare("count = 12", "count = 1.5"),
            &["aircraft.tails.count", "1.5", "whole number"],
        ),
        (
            bare("count = 12", "count = \"12\""),
            &["aircraft.tails.count", "\"12\""],
        ),
        (bare("count = 12", "count = -1"), &["aircraft.tails.count", "-1"]),
        (bare("count = 12", "count = 0"), &["0 actuators"]),
        (bare("count = 12", "count = 1e18"), &["aircraft.tails.count", "100000"]),
        (
            bare("count = 12", "count = 9223372036854775807"),
            &["aircraft.tails.count"],
        ),
        (top("seed = -1"), &["`seed`", "-1"]),
        (top("seed = nan"), &["`seed`", "NaN"]),
        (top("rate_hz = \"fast\""), &["`rate_hz`", "fast", "1000 to 1000000"]),
        (top("rate_hz = 10"), &["`rate_hz`", "10", "1000 to 1000000"]),
        (top("load_n_m = inf"), &["`load_n_m`", "inf"]),
        (top("rest_angle_deg = [10, 0]"), &["rest_angle_deg[1]", "rising"]),
        (top("rest_angle_deg = []"), &["rest_angle_deg", "empty"]),
        (top("rest_angle_deg = [720]"), &["rest_angle_deg[0]", "720", "360"]),
        (top("feature_seeds = 65"), &["`feature_seeds`", "65", "64"]),
        (top("tests = 4"), &["`tests`", "4", "table"]),
        (
            top("tests = { per_actuator = 1e9 }"),
            &["tests.per_actuator", "1000000000", "100000"],
        ),
        (bare("name = \"bare\"", "name = \"b/re\""), &["`name`", "b/re"]),
        (bare("name = \"bare\"", ""), &["`name`", "nothing"]),
        (BARE.replace("[aircraft]", "[aircrafts]"), &["aircraft"]),
        // TOML
        (top("seed = "), &["line 1", "TOML"]),
        (top("seed = 1\nseed = 2"), &["line 2", "TOML"]),
        (format!("{BARE}[spread]\n"), &["line", "TOML"]),
        ("\u{feff}\u{0}".into(), &["line 1", "TOML"]),
        // files and names
        (seq("missing.toml"), &["missing.toml", "cannot be read"]),
        (seq("wobble"), &["plan.toml", "`sequences`", "wobble", "preflight"]),
        (seq("nothing.toml"), &["nothing.toml", "segment"]),
        (
            seq("instant.toml"),
            &["plan.toml", "`sequences`", "instant", "first sample"],
        ),
        (telemetry("rate_hz = 1"), &["plan.toml", "`sequences`", "brief"]),
        (seq("number.toml"), &["`sequences`", "1e5", "letter first"]),
        (seq("grid.toml"), &["grid.toml"]),
        (
            seq("brief.toml\", \"same.toml"),
            &["`sequences`", "brief", "different names"],
        ),
        (bare("[\"brief.toml\"]", "[]"), &["`sequences`", "at least one"]),
        (bare("[\"brief.toml\"]", "\"brief.toml\""), &["`sequences`", "a list"]),
        (grid("missing.toml"), &["missing.toml", "cannot be read"]),
        (grid("huge"), &["plan.toml", "`grid`", "huge", "standard"]),
        (grid("falling.toml"), &["falling.toml", "fsj[2]", "1.5"]),
        (grid("brief.toml"), &["brief.toml"]),
        (top("sensors = \"good\""), &["plan.toml", "`sensors`", "good", "none"]),
        (top("sensors = \"grid.toml\""), &["grid.toml"]),
        (top("actuator = \"big\""), &["`actuator`", "big", "reference"]),
        (top("actuator = \"grid.toml\""), &["grid.toml"]),
        // spreads and draws
        (
            spread(&format!("colour = {uniform}")),
            &["spread.colour", "unknown key", "inertia_kg_m2"],
        ),
        (spread("inertia_kg_m2 = 0.1"), &["spread.inertia_kg_m2", "table"]),
        (
            spread("inertia_kg_m2 = { distribution = \"cauchy\" }"),
            &["spread.inertia_kg_m2.distribution", "cauchy", "lognormal"],
        ),
        (
            spread("inertia_kg_m2 = { distribution = \"uniform\", sd_relative = 0.1 }"),
            &["spread.inertia_kg_m2.half_width_relative", "nothing"],
        ),
        (
            spread("inertia_kg_m2 = { distribution = \"normal\", sd_relative = 0.31 }"),
            &["spread.inertia_kg_m2.sd_relative", "0.31"],
        ),
        (
            spread("inertia_kg_m2 = { distribution = \"range\", from = 1.0, to = 1.0 }"),
            &["spread.inertia_kg_m2.to", "above 1"],
        ),
        (
            spread("inertia_kg_m2 = { distribution = \"range\", from = -2.0, to = -1.0 }"),
            &["plan.toml", "T01.rudder", "inertia_kg_m2", "-1."],
        ),
        (
            one("phase_resistance_ohm = 0.0"),
            &["T01.rudder", "phase_resistance_ohm", "found 0"],
        ),
        (
            one("opposing_efficiency = 1.5"),
            &["T01.rudder", "opposing_efficiency", "1.5"],
        ),
        (one("colour = 1"), &["actuators[0].colour", "unknown key"]),
        (
            one("phase_resistance_ohm = \"1\""),
            &["actuators[0].phase_resistance_ohm"],
        ),
        // ids
        (tails("[\"A\", \"A\"]"), &["A.rudder twice"]),
        (tails("[\"A\", \"a\"]"), &["a.rudder twice"]),
        (tails("{ count = 3 }"), &["aircraft.tails", "letter first"]),
        (tails("[\"12\"]"), &["aircraft.tails", "12", "letter first"]),
        (tails("[\"NaN\"]"), &["aircraft.tails", "NaN"]),
        (tails("[\"true\"]"), &["aircraft.tails", "true"]),
        (tails("[\"..\"]"), &["aircraft.tails", ".."]),
        (tails("[\"a b\"]"), &["aircraft.tails", "a b"]),
        (tails("[\"\"]"), &["aircraft.tails"]),
        (tails("[1]"), &["aircraft.tails", "[1]"]),
        (tails("\"A\""), &["aircraft.tails", "\"A\""]),
        (bare("[\"rudder\"]", "[]"), &["0 actuators"]),
        (bare("[\"rudder\"]", "[\"\"]"), &["aircraft.positions"]),
        (bare("[\"rudder\"]", "[\"../x\"]"), &["aircraft.positions", "../x"]),
        (
            one("[[actuators]]\ntail = \"T01\""),
            &["actuators[1].position", "nothing"],
        ),
        (
            format!("{BARE}\n[actuators]\ntail = \"A\"\n"),
            &["`actuators`", "array of tables"],
        ),
        // telemetry
        (telemetry("rate_hz = 3000"), &["telemetry.rate_hz", "3000", "10000"]),
        (telemetry("rate_hz = 20000"), &["telemetry.rate_hz", "20000"]),
        (telemetry("rate_hz = 0"), &["telemetry.rate_hz", "found 0"]),
        (
            telemetry("channels = [\"speed\"]"),
            &["telemetry.channels", "speed", "omega_m"],
        ),
        (telemetry("channels = []"), &["plan.toml", "telemetry.channels"]),
        (
            telemetry("channels = [\"com\"]"),
            &["plan.toml", "telemetry.channels", "com"],
        ),
        (telemetry("of = \"some\""), &["telemetry.of", "some", "map"]),
        (telemetry("every = 2"), &["telemetry.every", "unknown key"]),
        // too much
        (
            bare("[\"rudder\"]", &format!("{:?}", vec!["x"; 20_000])).replace("count = 12", "count = 100000"),
            &["2000000000 actuators", "100000"],
        ),
        (grid("endless.toml"), &["plan.toml", "100000000"]),
        (
            format!("rate_hz = 1e6\n{}\n[telemetry]\n", seq("long.toml")),
            &["plan.toml", "telemetry"],
        ),
    ];
    let mut wrong = Vec::new();
    for (plan, named) in &cases {
        let line = refused(&fleet, plan);
        if let Some(n) = named.iter().find(|n| !line.contains(**n)) {
            wrong.push(format!("no {n} in: {line}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn refuse_plans_that_are_no_text() {
    let fleet = Fleet::new(PROGRAM, BARE);
    std::fs::write(fleet.path("plan.toml"), [0xff, 0xfe, 0]).unwrap();
    assert!(fleet.run(&[]).line(4).contains("plan.toml"));
    std::fs::remove_file(fleet.path("plan.toml")).unwrap();
    assert!(fleet.run(&[]).line(4).contains("plan.toml: cannot be read"));
    std::fs::create_dir(fleet.path("plan.toml")).unwrap();
    assert!(fleet.run(&[]).line(4).contains("plan.toml: cannot be read"));
}

/// Mutations of a text: bytes, numbers, words and lines change, go, or come twice.
fn mutated(text: &str, rng: &mut ChaCha8Rng) -> String {
    const WORDS: [&str; 24] = [
        "nan",
        "-1",
        "0",
        "1e308",
        "-1e308",
        "9223372036854775807",
        "\"\"",
        "[]",
        "{}",
        "true",
        "\"x\"",
        "[[a]]",
        "[spread]",
        "'",
        "\"\"\"",
        "\\",
        "=",
        "\u{0}",
        "\u{1F6E9}",
        "1e-320",
        "\"none\"",
        "inf",
        "[telemetry]",
        "\n",
    ];
    let mut text = text.to_string();
    for _ in 0..rng.random_range(1..4) {
        let places: Vec<usize> = text.char_indices().map(|(i, _)| i).collect();
        if places.is_empty() {
            return text;
        }
        let at = places[rng.random_range(0..places.len())];
        let end = places[rng.random_range(0..places.len())];
        let lines: Vec<String> = text.lines().map(String::from).collect();
        let line = rng.random_range(0..lines.len().max(1));
        let word = WORDS[rng.random_range(0..WORDS.len())];
        match rng.random_range(0..6) {
            0 => text.insert_str(at, word),
            1 if at < end && end - at < 12 => text.replace_range(at..end, word),
            2 if !lines.is_empty() => {
                let mut l = lines;
                l.remove(line);
                text = l.join("\n");
            }
            3 if !lines.is_empty() => {
                let mut l = lines;
                let again = l[line].clone();
                l.insert(rng.random_range(0..l.len()), again);
                text = l.join("\n");
            }
            // the value of a key
            _ if !lines.is_empty() => {
                let mut l = lines;
                if let Some((key, _)) = l[line].clone().split_once('=') {
                    l[line] = format!("{key}= {word}");
                }
                text = l.join("\n");
            }
            _ => {}
        }
    }
    text
}

#[test]
fn prop_mutated_plans_are_read_or_refused_in_one_line() {
    let fleet = Fleet::new(PROGRAM, VARIED);
    let dir = fleet.path("");
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let (mut read, mut refused) = (0, 0);
    for _ in 0..3000 {
        let text = mutated(VARIED, &mut rng);
        match DatasetPlan::parse("plan.toml", &text, &dir) {
            Ok(plan) => {
                // what follows from a plan must not fail either
                let parts = plan.parts();
                assert!(!parts.is_empty() && plan.runs() > 0, "{text}");
                // and a dataset's own copy is the same plan
                let own = DatasetPlan::parse("plan.toml", &plan.text, Path::new("")).expect("its own text");
                assert_eq!(own.fingerprint(), plan.fingerprint(), "{text}");
                read += 1;
            }
            Err(e) => {
                let line = e.to_string();
                assert!(e.exit_code() == 4 && !line.contains('\n'), "{line}\n{text}");
                refused += 1;
            }
        }
    }
    println!("{read} read, {refused} refused");
    assert!(read > 100 && refused > 100);
}

#[test]
fn e2e_odd_but_valid_plans_are_worked_through() {
    let fleet = Fleet::new(PROGRAM, BARE);
    let sequence = |name: &str, rest: &str| format!("name = \"{name}\"\nsegment = [{rest}]\n");
    let hold = "{ command = \"hold\", value_rad = 0.1, duration_s = 0.05 }";
    let step = "{ command = \"step\", height_rad = 0.1, duration_s = 0.002 }";
    let instant = "{ command = \"sine\", amplitude_rad = 0.1, frequency_hz = 1000.0, duration_s = 1e-5 }";
    fleet.write("hold.toml", &sequence("hold", hold));
    fleet.write(
        "steps.toml",
        &sequence("steps", &format!("{step}, {instant}, {hold}, {step}")),
    );
    fleet.write("tiny.toml", &sequence("tiny", &instant.replace("1e-5", "1e-4")));
    fleet.write("point.toml", "name = \"point\"\nfsj = [1.0]\nzeta = [0.0]\n");
    fleet.write("sick.toml", "name = \"sick\"\nfsj = [0.0, 100.0]\nzeta = [0.99]\n");
    for (name, sequence, grid, more) in [
        ("a", "hold.toml", "point.toml", "[tests]\nper_actuator = 2"),
        ("b", "steps.toml", "sick.toml", "[telemetry]\nrate_hz = 100"),
        ("c", "tiny.toml", "point.toml", "[telemetry]\nof = \"map\""),
        (
            "d",
            "steps.toml",
            "grid.toml",
            "[telemetry]\nchannels = [\"i_q\", \"v_dc\", \"com\"]\nof = \"test\"",
        ),
    ] {
        let plan = bare("brief.toml", sequence)
            .replace("grid.toml", grid)
            .replace("count = 12", "count = 2");
        for sensors in ["none", "reference"] {
            let out = format!("{name}-{sensors}");
            fleet.write("plan.toml", &format!("sensors = \"{sensors}\"\n{plan}\n{more}\n"));
            fleet.run(&["--out", &out]).done();
            fleet.run(&["--out", &out, "--merge"]).done();
            let storage = sim_worker::dataset::storage::Storage::open(fleet.path(&out).to_str().unwrap()).unwrap();
            let report = sim_worker::dataset::verify::verify(&storage, |_, _| ()).unwrap();
            assert_eq!(report.findings, [], "{out}");
        }
    }
}
