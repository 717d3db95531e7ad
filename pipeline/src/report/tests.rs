use super::charts::polygons;
use super::scale::{Axis, clip_polygon, decimate, number, spread, tolerance};
use super::*;

fn trace(series: Vec<(String, Vec<(f64, f64)>)>) -> Figure {
    Figure::Trace(TracePlot {
        title: "Speed".into(),
        x_label: "time [s]".into(),
        y_label: "speed [rad/s]".into(),
        series,
    })
}

fn map(curves: Vec<Curve>, band: Option<Band>) -> Figure {
    let (name, title, unit) = ("P1".into(), "Map".into(), "rad/s".into());
    Figure::Map(MapPlot {
        name,
        title,
        unit,
        curves,
        knots: vec![(1.0, f64::NAN)],
        band,
        truth: Some((1.0, f64::NAN)),
        estimate: None,
    })
}

fn region(regions: Vec<(String, Vec<Strip>)>, area: Vec<Strip>) -> RegionPlot {
    RegionPlot {
        title: "Area".into(),
        fsj_range: (1.0, 5.0),
        zeta_range: (0.0, 0.5),
        regions,
        area,
        hull: None,
        truth: Vec::new(),
        estimate: Vec::new(),
        notes: Vec::new(),
    }
}

fn strip(zeta: f64, fsj_lo: f64, fsj_hi: f64) -> Strip {
    Strip { zeta, fsj_lo, fsj_hi }
}

fn report(figures: Vec<(String, Figure)>) -> Report {
    let row = TableRow {
        cells: vec!["<b>".into(), "1.5".into(), "surplus".into()],
        emphasis: true,
    };
    let table = Table {
        caption: "a < b".into(),
        header: vec!["x & y".into()],
        rows: vec![row],
        note: "\"n\"".into(),
    };
    let section = Section {
        title: "<i>".into(),
        text: "one\n\n- two\n- <u>\nmore".into(),
        tables: vec![table],
        figures,
        ..Section::default()
    };
    let facts = vec![("<f>".into(), "'v'".into())];
    Report {
        title: "T <script>".into(),
        summary: "S <em>".into(),
        facts,
        sections: vec![section],
        ..Report::default()
    }
}

#[test]
fn empty_or_broken_data_does_not_panic() {
    let nan = f64::NAN;
    let mut odd = region(
        vec![("P1".into(), vec![strip(nan, 1.0, 2.0), strip(0.1, 2.0, 1.0)])],
        vec![],
    );
    odd.fsj_range = (nan, 1.0);
    odd.zeta_range = (0.2, 0.2);
    odd.hull = Some(((nan, 2.0), (f64::INFINITY, 0.1)));
    odd.truth = vec![(nan, 0.1)];
    odd.estimate = vec![(9.0, 9.0)];
    let band = Some(Band {
        value: 1.0,
        half_width: f64::INFINITY,
    });
    let figures = [
        trace(vec![]),
        trace(vec![(String::new(), vec![])]),
        trace(vec![
            ("a".into(), vec![(nan, nan), (0.0, f64::INFINITY)]),
            ("b".into(), vec![(2.0, 3.0)]),
        ]),
        trace(vec![(
            "a".into(),
            vec![(0.0, 1e300), (1.0, -1e300), (2.0, 5e-320), (3.0, 0.0)],
        )]),
        map(vec![], None),
        map(
            vec![Curve {
                zeta: nan,
                points: vec![],
            }],
            Some(Band {
                value: nan,
                half_width: 0.0,
            }),
        ),
        map(
            vec![
                Curve {
                    zeta: 0.0,
                    points: vec![(1.0, 2.0)],
                },
                Curve {
                    zeta: 0.0,
                    points: vec![(1.0, nan)],
                },
            ],
            band,
        ),
        Figure::Region(region(vec![], vec![])),
        Figure::Region(odd),
    ];
    for figure in &figures {
        let text = svg(figure).expect("drawn");
        assert!(text.ends_with("</svg>\n") && !text.contains("NaN"), "{text}");
    }
    assert!(html(&Report::default()).expect("set").contains("</html>"));
}

#[test]
fn texts_are_escaped() {
    let mut figure = region(vec![("<P1>".into(), vec![])], vec![]);
    figure.title = "a \"<b>\" & c".into();
    let page = html(&report(vec![("area".into(), Figure::Region(figure))])).expect("set");
    for raw in ["<script", "<b>", "<i>", "<u>", "<em>", "<f>", "<P1>", "\"n\"", " & "] {
        assert!(!page.contains(raw), "{raw}");
    }
    for set in [
        "&lt;script",
        "&lt;u&gt; more</li>",
        "a &quot;&lt;b&gt;&quot; &amp; c",
        "x &amp; y",
        "&#39;v&#39;",
    ] {
        assert!(page.contains(set), "{set}");
    }
}

#[test]
fn the_conclusion_comes_first_and_names_stay_whole() {
    let point = |label: &str, command: Option<&str>| Point {
        label: label.into(),
        text: "aileron-2 <b>".into(),
        command: command.map(String::from),
    };
    let lead = Lead {
        tone: Tone::Fault,
        kind: "Located".into(),
        finding: "1.5 % & more".into(),
        points: vec![point("Found", None), point("What next", Some("ema <i>"))],
        terms: vec![("FSJ".into(), "is friction.".into())],
        figure: Some(("plane".into(), Figure::Region(region(vec![], vec![])))),
        caption: "the plane".into(),
    };
    let folded = Section {
        title: "Maps".into(),
        figures: vec![("one".into(), trace(vec![]))],
        captions: vec![("one".into(), "in other words".into())],
        ..Section::default()
    };
    let report = Report {
        title: "T".into(),
        lead: Some(lead),
        sections: vec![Section {
            title: "left-aileron, fsj".into(),
            folded: vec![folded],
            ..Section::default()
        }],
        facts: vec![("a".into(), "b".into())],
        ..Report::default()
    };
    let page = html(&report).expect("set");
    let place = |words: &str| page.find(words).unwrap_or_else(|| panic!("no {words}"));
    let order = [
        "class=\"lead fault\"",
        "1.5&nbsp;% &amp; more",
        "<b>FSJ</b> is friction.",
        "ema &lt;i&gt;",
        "<figcaption>the plane",
        "<nav",
        "<summary>Maps",
        "in other words",
    ];
    for w in order.windows(2) {
        assert!(place(w[0]) < place(w[1]), "{w:?}");
    }
    for name in [
        "<span class=\"name\">aileron-2</span>",
        "<span class=\"name\">left-aileron,</span> fsj",
    ] {
        assert!(page.contains(name), "{name}");
    }
    // a figure that is folded is a file too
    let dir = std::env::temp_dir().join(format!("report-lead-{}", std::process::id()));
    assert_eq!(write(&report, &dir, "page.html").expect("written").len(), 3);
    fs::remove_dir_all(&dir).expect("removed");
}

#[test]
fn decimation_keeps_extremes_and_gaps() {
    let mut points: Vec<(f64, f64)> = (0..30_000)
        .map(|i| (f64::from(i) * 1e-4, (f64::from(i) * 0.01).sin()))
        .collect();
    points[12_345].1 = 7.5;
    points[20_001].1 = -9.25;
    for p in &mut points[5_000..6_000] {
        p.1 = f64::NAN;
    }
    let parts = decimate(&points, (0.0, 3.0), 600);
    assert_eq!(parts.len(), 2);
    assert!(parts.iter().map(Vec::len).sum::<usize>() <= 1300);
    assert!(parts.concat().contains(&points[12_345]) && parts.concat().contains(&points[20_001]));

    // A loop is thinned along its index.
    let turn: Vec<(f64, f64)> = (0..30_000).map(|i| (f64::from(i).sin(), f64::from(i).cos())).collect();
    assert!(decimate(&turn, (-1.0, 1.0), 600).concat().len() <= 2400);
}

#[test]
fn long_series_stay_small() {
    let noisy = |k: i32| {
        (0..30_000)
            .map(|i| (f64::from(i), f64::from((i * 7919 + k) % 1009)))
            .collect()
    };
    for n in [1, 6, 12] {
        let text = svg(&trace((0..n).map(|k| (format!("s{k}"), noisy(k))).collect())).expect("drawn");
        assert!(text.len() < 150_000, "{n} series: {} bytes", text.len());
    }
}

#[test]
fn numbers_read_well() {
    assert_eq!(number(0.00005, 3), "50.0×10⁻⁶");
    assert_eq!(number(-1.23456, 3), "−1.23");
    assert_eq!(tolerance(12.3456, 0.5), "12.35 ± 0.50");
    assert_eq!(tolerance(5e-5, 2e-6), "(50.0 ± 2.0)×10⁻⁶");
    let axis = Axis::new((0.0, 5e-5), 5.0);
    assert_eq!((axis.exponent, axis.ticks[1].1.as_str()), (-6, "10"));
    let axis = Axis::new((2.1, 2.1004), 4.0);
    assert_eq!(axis.ticks[1].1, "2.1001");
}

#[test]
fn regions_are_clipped_and_labels_kept_apart() {
    let square = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)];
    let cut = clip_polygon(&square, ((1.0, 2.0), (-1.0, 3.0)));
    assert!(
        cut.iter()
            .all(|p| (1.0..=2.0).contains(&p.0) && (0.0..=3.0).contains(&p.1))
            && cut.len() == 4
    );
    let placed = spread(&[10.0, 10.0, 11.0, 40.0, 99.0], 12.0, (5.0, 100.0));
    assert!(placed.windows(2).all(|w| w[1] - w[0] > 11.999) && placed[0] >= 5.0 && placed[4] <= 100.0);
}

#[test]
fn strips_join_to_outlines() {
    let run = |zetas: &[f64]| zetas.iter().map(|z| strip(*z, 2.0 + z, 2.1 + z)).collect::<Vec<_>>();
    let lengths = |strips: &[Strip]| polygons(strips, 0.01).iter().map(Vec::len).collect::<Vec<_>>();
    assert_eq!(lengths(&run(&[0.10, 0.11, 0.12, 0.13])), [8]);
    assert_eq!(lengths(&run(&[0.10, 0.11, 0.20, 0.21, 0.22])), [4, 6]);
    assert_eq!(polygons(&run(&[0.1]), 0.02)[0][2].1, 0.11);
    // Two intervals at the same eccentricity stay two outlines.
    let pair = [0.1, 0.11, 0.12]
        .map(|z| [strip(z, 1.0, 1.2), strip(z, 3.0, 3.2)])
        .concat();
    assert_eq!(lengths(&pair), [6, 6]);
}

#[test]
fn files_are_written_whole_and_names_checked() {
    let dir = std::env::temp_dir().join(format!("report-test-{}", std::process::id()));
    let figures = vec![("one".to_owned(), trace(vec![])), ("two".to_owned(), map(vec![], None))];
    let paths = write(&report(figures.clone()), &dir, "report.html").expect("written");
    assert_eq!(paths.len(), 3);
    assert_eq!(fs::read_dir(&dir).expect("listed").count(), 3);
    assert!(fs::read_to_string(&paths[2]).expect("read").ends_with("</html>\n"));
    fs::remove_dir_all(&dir).expect("removed");

    let twice = vec![figures[0].clone(), figures[0].clone()];
    assert!(write(&report(twice), &dir, "report.html").is_err());
    assert!(write(&report(vec![("../one".to_owned(), trace(vec![]))]), &dir, "report.html").is_err());
    assert!(!dir.exists());
}
