//! A bounded run of changed inputs through every door (`mutation-bench` has the long one).

use ema_tests::mutation::{Effort, campaign, doors};
use std::path::Path;

#[test]
fn prop_changed_inputs_are_taken_or_refused_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let doors = doors(Path::new(env!("CARGO_BIN_EXE_ema-under-test")), dir.path());
    let tallies = campaign(&doors, Effort::inputs(6000), 11, dir.path(), |_| ());
    println!("{tallies:#?}");
    assert_eq!(tallies.len(), doors.len());
    for (name, t) in &tallies {
        assert!(t.faults.is_empty(), "{name}: {:?}", t.faults);
        // doors that open for nothing or for everything would show nothing
        assert!(t.refused > 0 || t.inputs < 100, "{name}: {t:?}");
    }
}
