use super::super::plan::{ALL, chosen};
use super::*;
use serde_json::{Value, json};

/// Writes verdicts and keys of a class as a campaign leaves them.
fn write(out: &Path, plan: &Plan, cases: &[(Value, Value)]) {
    let opened = store::Store::open(&run::results_path(out, plan), "f", 1).unwrap();
    for (n, (said, hidden)) in cases.iter().enumerate() {
        let mut line = said.clone();
        line["case"] = json!(n);
        line["study_s"] = json!(1.0);
        line["generate_s"] = json!(0.5);
        opened.store.append(&line).unwrap();
        let path = run::key_path(out, plan, n as u64);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, json!({ "effects": hidden }).to_string()).unwrap();
    }
}

fn hidden(name: &str) -> Value {
    json!({ "name": name, "parameters": { "gap": 0.2 }, "parameters_comparable": true })
}

fn found(name: &str, set: &[&str]) -> Value {
    json!({ "name": name, "parameters": { "gap": { "value": 0.21, "lo": 0.205, "hi": null } }, "ambiguous_with": set })
}

#[test]
fn a_campaign_is_reported() {
    let dir = tempfile::tempdir().unwrap();
    let one = chosen(&["one/matched/1".into()]).unwrap()[0];
    let gap = json!({ "heldout": { "nominal": 8.0, "retuned": 4.0, "final": 2.0, "floor": 2.0 } });
    let named = json!({ "verdict": "named", "effects": [found("backlash", &[])], "gap": gap });
    let set = json!({ "verdict": "ambiguous", "effects": [found("compliance", &["backlash"])], "next_command": "ema" });
    let wrong = json!({ "verdict": "named", "effects": [found("cogging", &[])] });
    let quiet = json!({ "verdict": "retune", "effects": [] });
    let error = json!({ "verdict": "error", "error": "panic: out of range" });
    let key = json!([hidden("backlash")]);
    write(
        dir.path(),
        &one,
        &[named, set, wrong, quiet, error].map(|s| (s, key.clone())),
    );
    let nothing = ALL[0];
    let alarm = json!({ "verdict": "named", "effects": [found("cogging", &[])] });
    write(
        dir.path(),
        &nothing,
        &[(alarm, json!([])), (json!({ "verdict": "none" }), json!([]))],
    );
    let two = chosen(&["two/matched".into()]).unwrap()[0];
    let half = json!({ "verdict": "named", "effects": [found("backlash", &[])] });
    write(
        dir.path(),
        &two,
        &[(half, json!([hidden("backlash"), hidden("cogging")]))],
    );

    let all = judged(dir.path(), &ALL).unwrap();
    assert_eq!(all.len(), 3);
    let text = report(&all);
    let line = |start: &str| {
        let found = text.lines().find(|l| l.starts_with(start));
        found.unwrap_or_else(|| panic!("{start} is not in\n{text}")).to_string()
    };
    assert!(line("| nothing/matched | 2 |").contains("| 50.0 [9.5, 90.5] | 50.0 [9.5, 90.5] | 0.0 [0.0, 65.8] |"));
    let rates = line("| one/matched/1 | 5 |");
    assert!(
        rates.contains("| 40.0 [11.8, 76.9] | 20.0 [3.6, 62.4] |") && rates.ends_with("1 of 1 |"),
        "{rates}"
    );
    assert!(
        text.contains("| backlash | 5 | 1 | 1 | 1 |  | cogging 1, error 1 |"),
        "{text}"
    );
    assert!(text.contains("| (nothing) | 2 |  |  | 1 |  | cogging 1 |"));
    assert!(text.contains("| cogging | 1 |  |  |  |  | only the other 1 |"));
    assert!(text.contains("| one/matched/1 | 4.00 | 2.00 | 1.000 | 5.00 | 0.0 [0.0, 79.3] | 1 | 0 of 0 | 1.00 |"));
    assert!(text.contains("| one/matched/1 | right % | >= 97 | 40.0 [11.8, 76.9] | NO |"));
    assert!(text.contains("No verdict in case [4]: panic: out of range"));
    assert!(report(&[]).contains("No case has a verdict"));
}

#[test]
fn a_case_without_its_key_is_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let none = json!({ "verdict": "none" });
    write(dir.path(), &ALL[0], &[(none.clone(), json!([])), (none, json!([]))]);
    std::fs::write(run::key_path(dir.path(), &ALL[0], 1), "{\"effects\": [").unwrap();
    assert_eq!(judged(dir.path(), &ALL).unwrap()[0].cases.len(), 1);
}
