//! What is to be seen of sixty actuators.

use super::*;
use crate::diagnosis::{Area, Outcome};
use crate::live::Foretold;
use ratatui::crossterm::event::{KeyCode, KeyEvent};
use schemas::fault::Interval;
use schemas::feature::{Feature, Features, RawFeatures};

fn located(fsj: (f64, f64), zeta: (f64, f64)) -> Outcome {
    Outcome::Located(Area {
        parts: Vec::new(),
        boxes: Vec::new(),
        fsj: Interval { lo: fsj.0, hi: fsj.1 },
        zeta: Interval { lo: zeta.0, hi: zeta.1 },
        centroid: ((fsj.0 + fsj.1) / 2.0, (zeta.0 + zeta.1) / 2.0),
        size: 1e-5,
        inner: 1e-5,
        outer: 1e-5,
        band: 3.0,
    })
}

fn status(actuator: &str, outcome: Option<Outcome>) -> Status {
    Status {
        actuator: actuator.into(),
        run: 7,
        process: 1234,
        phase: "step".into(),
        sample: 15_000,
        samples: 30_000,
        lost: 100,
        raw: RawFeatures::default(),
        features: Features::default().with(Feature::P1, Some(0.05307)),
        is_final: outcome.is_some(),
        foretold: None,
        outcome,
    }
}

fn foretold(rate: f64, left: (f64, f64, f64)) -> Foretold {
    Foretold {
        fault: "fsj".into(),
        rate: Some(rate),
        left: Some(left),
        clock: "flight",
        status: "ok".into(),
    }
}

/// What a terminal of this size shows, line by line.
fn drawn(screen: &mut Screen, p: &Picture, width: u16, height: u16) -> Vec<String> {
    let backend = ratatui::backend::TestBackend::new(width, height);
    let mut terminal = ratatui::Terminal::new(backend).unwrap();
    terminal.draw(|f| screen.draw(f, p)).unwrap();
    let buffer = terminal.backend().buffer();
    let cells: Vec<&str> = buffer.content().iter().map(|c| c.symbol()).collect();
    cells.chunks(width as usize).map(<[&str]>::concat).collect()
}

/// Sixty actuators, of every outcome some.
fn sixty() -> Picture {
    let mut statuses: Vec<Status> = (0..56)
        .map(|k| status(&format!("healthy-{k:02}"), Some(located((1.0, 1.02), (0.0, 0.001)))))
        .collect();
    let why = "two publishers for actuator `left-wing-inboard-aileron-actuator-7`: process 41 has been sending it, \
               process 42 is refused";
    let incomplete = Outcome::Incomplete {
        reason: why.into(),
        area: None,
    };
    let beyond = Outcome::OutOfRange {
        reason: "FSJ above 5".into(),
    };
    statuses.push(status("zz-worn", Some(located((4.2, 4.3), (0.3, 0.31)))));
    statuses.push(status("left-wing-inboard-aileron-actuator-7", Some(incomplete)));
    statuses.push(status("yaw-trim", Some(beyond)));
    statuses.push(status("in-test", None));
    Picture {
        statuses,
        counts: Counts::default(),
        notes: vec!["frame refused: process 3: truncated".into()],
        version: 1,
    }
}

fn typed(screen: &mut Screen, text: &str) {
    for c in text.chars() {
        assert_eq!(screen.key(KeyEvent::from(KeyCode::Char(c))), Wish::Nothing);
    }
}

#[test]
fn prop_view_shows_interval_loss_and_trouble() {
    let mut p = sixty();
    p.statuses = vec![status("left-aileron", Some(located((2.989, 3.008), (0.2979, 0.3016))))];
    let text = drawn(&mut Screen::default(), &p, 160, 16).join("\n");
    for wanted in [
        "left-aileron",
        "███···",
        "100",
        "0.05307",
        "2.989 .. 3.008",
        "0.2979 .. 0.3016",
        "located",
        "truncated",
    ] {
        assert!(text.contains(wanted), "{wanted} in {text}");
    }
}

#[test]
fn prop_the_worst_come_first_and_every_outcome_is_counted() {
    let text = drawn(&mut Screen::default(), &sixty(), 80, 24);
    let head = " 0 unexplained  1 out of range  1 incomplete  1 testing  57 located";
    assert_eq!(text[0].trim_end(), head);
    assert!(text[1].contains("60 actuators"), "{text:#?}");
    // two lines of head, a border, the columns' names
    let order = ["yaw-trim", "left-w", "in-test", "zz-worn", "healthy-00", "healthy-01"];
    for (k, name) in order.iter().enumerate() {
        assert!(text[4 + k].contains(name), "{name} in line {k} of {text:#?}");
    }
    let mut screen = Screen::default();
    typed(&mut screen, "n");
    assert!(drawn(&mut screen, &sixty(), 80, 24)[4].contains("healthy-00"));
}

#[test]
fn prop_a_filter_leaves_what_was_asked_for_and_the_reason_is_there_at_80_columns() {
    let mut screen = Screen::default();
    // q is a letter while typing
    typed(&mut screen, "/two q");
    screen.key(KeyEvent::from(KeyCode::Backspace));
    screen.key(KeyEvent::from(KeyCode::Backspace));
    screen.key(KeyEvent::from(KeyCode::Enter));
    let text = drawn(&mut screen, &sixty(), 80, 24);
    assert!(text[1].contains("filter `two`: 1 of 60"), "{text:#?}");
    // the name is cut in the middle, and whole below the table with the whole reason
    assert!(text[4].contains('…') && text[4].contains("or-7"), "{text:#?}");
    let words = text
        .iter()
        .flat_map(|l| l.split_whitespace())
        .collect::<Vec<_>>()
        .join(" ");
    for part in ["left-wing-inboard-aileron-actuator-7 run 7", "process 42 is refused"] {
        assert!(words.contains(part), "{part} in {words}");
    }
    assert_eq!(screen.key(KeyEvent::from(KeyCode::Esc)), Wish::Nothing);
    assert!(!drawn(&mut screen, &sixty(), 80, 24)[1].contains("filter"));
    assert_eq!(screen.key(KeyEvent::from(KeyCode::Char('q'))), Wish::Quit);
}

#[test]
fn prop_no_interval_is_shown_by_one_bound() {
    let mut p = sixty();
    let wide = located((10.125, 12.375), (0.2979, 0.3016));
    p.statuses = vec![status("left-wing-inboard-aileron-actuator-7", Some(wide))];
    for width in 1..200 {
        let mut screen = Screen::default();
        let text = drawn(&mut screen, &p, width, 24);
        // the table alone: below it words go on in the next line
        for line in &text[2..18] {
            assert_eq!(line.contains("10.125"), line.contains("12.375"), "{width}: {line}");
            assert_eq!(line.contains("0.2979"), line.contains("0.3016"), "{width}: {line}");
        }
    }
}

#[test]
fn prop_the_selected_row_stays_in_sight() {
    let mut screen = Screen::default();
    let p = sixty();
    drawn(&mut screen, &p, 80, 24);
    for _ in 0..3 {
        screen.key(KeyEvent::from(KeyCode::PageDown));
    }
    let text = drawn(&mut screen, &p, 80, 24);
    assert!(
        text.iter().filter(|l| l.contains("healthy-55")).count() == 2,
        "{text:#?}"
    );
    // a filter leaves fewer rows than that
    typed(&mut screen, "/worn");
    let text = drawn(&mut screen, &p, 80, 24).join(" ");
    assert!(text.contains("zz-worn run 7"), "{text}");
}

#[test]
fn prop_cuts_and_bars_are_as_wide_as_they_may_be() {
    use super::columns::{bar, cut};
    assert_eq!(cut("left-aileron-17", 9), "left…n-17");
    assert_eq!(cut("short", 9), "short");
    for width in 0..12 {
        assert!(cut("left-aileron-17", width).chars().count() <= width);
    }
    assert_eq!(bar(u64::MAX, u64::MAX, 6), "██████");
    assert_eq!(bar(5, 0, 6), "······");
}

#[test]
fn prop_what_is_foretold_is_shown_with_the_soonest_end_first() {
    let mut p = sixty();
    assert!(
        !drawn(&mut Screen::default(), &p, 160, 24)
            .join("")
            .contains("life left"),
        "no history, no column"
    );
    for (name, rate, left) in [
        ("healthy-09", 0.012, (80.2, 240.7, 130.4)),
        ("healthy-30", 0.25, (7.1, 12.9, 9.4)),
        ("healthy-44", 0.0, (900.0, f64::INFINITY, f64::INFINITY)),
    ] {
        let s = p.statuses.iter_mut().find(|s| s.actuator == name).unwrap();
        s.foretold = Some(foretold(rate, left));
    }
    let text = drawn(&mut Screen::default(), &p, 160, 24);
    // what cannot be explained comes before, actuators without a history after
    let place = |name: &str| text[4..].iter().position(|l| l.contains(name)).unwrap();
    assert!(place("in-test") < place("healthy-30"), "{text:#?}");
    assert!(place("healthy-30") < place("healthy-09") && place("healthy-09") < place("healthy-44"));
    assert!(place("healthy-44") < place("zz-worn"));
    let line = |name: &str| text[4..].iter().find(|l| l.contains(name)).unwrap();
    assert!(
        line("healthy-30").contains("fsj 7 .. 13 flights") && line("healthy-30").contains("2.50e-1/flight"),
        "{text:#?}"
    );
    assert!(line("healthy-44").contains("fsj 900 .. never"), "{text:#?}");
    let passed = &mut p
        .statuses
        .iter_mut()
        .find(|s| s.actuator == "healthy-09")
        .unwrap()
        .foretold;
    *passed = Some(Foretold {
        rate: None,
        left: None,
        status: "passed".into(),
        ..foretold(0.0, (0.0, 0.0, 0.0))
    });
    let text = drawn(&mut Screen::default(), &p, 160, 24);
    let place = |name: &str| text[4..].iter().position(|l| l.contains(name)).unwrap();
    assert!(place("healthy-09") < place("healthy-30"), "{text:#?}");
    assert!(text.join("").contains("fsj passed"), "{text:#?}");
}
