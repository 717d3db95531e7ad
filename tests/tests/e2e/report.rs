//! The pages for people: what stands on the first screen, that they need nothing from elsewhere, and what they weigh.

use crate::common::process::*;
use std::path::Path;
use std::sync::OnceLock;

/// A recording of a simulated test.
fn recorded(dir: &Path, name: &str, fsj: &str, zeta: &str) -> String {
    let path = dir.join(name);
    ok(&[
        "run",
        "--fsj",
        fsj,
        "--zeta",
        zeta,
        "--sensors",
        "reference",
        "--out",
        text(&path),
    ]);
    text(&path).to_string()
}

/// Standard output and page of a diagnosis, whatever it finds.
fn page_of(file: &str, dir: &Path) -> (String, String) {
    let o = run(&["diagnose", file, "--plot", text(dir)]);
    assert!(
        matches!(o.status.code(), Some(0 | 3)),
        "{}",
        String::from_utf8_lossy(&o.stderr)
    );
    let page = std::fs::read_to_string(dir.join("diagnosis.html")).unwrap();
    self_contained(&page, 1_500_000);
    (String::from_utf8(o.stdout).unwrap(), page)
}

/// What stands before the contents.
fn first_screen(page: &str) -> &str {
    page.split_once("<nav")
        .expect("contents")
        .0
        .split_once("<h1>")
        .unwrap()
        .1
}

fn holds(place: &str, words: &[&str]) {
    for w in words {
        assert!(place.contains(w), "no `{w}` in {}", without_figures(place));
    }
}

fn without_figures(page: &str) -> String {
    let mut parts = page.split("<svg");
    let first = parts.next().unwrap_or_default().to_string();
    parts.fold(first, |all, p| all + p.split_once("</svg>").map_or("", |p| p.1))
}

/// No script, no font, picture or style from elsewhere; light enough to be mailed; it can be dark and be printed.
fn self_contained(page: &str, most: usize) {
    for foreign in [
        "<script", "<link", "<img", "<iframe", "src=", "url(", "@import", "NaN", "\u{e000}",
    ] {
        assert!(!page.contains(foreign), "{foreign}");
    }
    let addresses = page.matches("://").count();
    assert_eq!(addresses, page.matches("xmlns=\"http://www.w3.org/2000/svg\"").count());
    assert!(page.len() < most, "{} bytes", page.len());
    assert_eq!(page.matches("<style>").count(), 1, "one shell, one style");
    holds(
        page,
        &["prefers-color-scheme: dark", "@media print", "name=\"viewport\""],
    );
    // figures have no ground of their own
    assert!(!page.contains("<rect x=\"0\" y=\"0\""), "a ground under a figure");
}

#[test]
fn e2e_a_fault_is_told_with_how_sure_and_what_next() {
    let dir = tempfile::tempdir().unwrap();
    let file = recorded(dir.path(), "run.csv", "3", "0.3");
    let out = dir.path().join("page");
    let (said, page) = page_of(&file, &out);
    holds(
        &said,
        &[
            "FSJ       2.99",
            &format!("page      {}", text(&out.join("diagnosis.html"))),
        ],
    );
    holds(
        first_screen(&page),
        &[
            "Located: friction and eccentricity",
            "3.00 times its healthy dry friction",
            "30.0&nbsp;% of the air gap",
            "How sure",
            "95&nbsp;% of tests",
            "512 simulated tests",
            "What next",
            "ema prognosis",
            "<b>FSJ</b> is the factor of dry friction in the transmission",
            "is the static eccentricity of the rotor as a share of the air gap",
            "P1 is the RMS error of the speed",
            "<svg",
        ],
    );
    for stem in ["plane", "area", "region", "map_p1"] {
        let svg = std::fs::read_to_string(out.join(format!("diagnosis_{stem}.svg"))).unwrap();
        assert!(svg.contains("prefers-color-scheme: dark") && svg.contains("</svg>"));
    }
    // maps are folded
    holds(&page, &["<details>", "Maps and cuts: P1, P2, P3"]);
    // programs have all digits, and the page's place
    let v = json(&["diagnose", &file, "--json", "--plot", text(&out)]);
    assert!(v["fsj"]["estimate"].to_string().len() > 10, "{v}");
    assert_eq!(v["page"], text(&out.join("diagnosis.html")));
    assert!(json(&["diagnose", &file, "--json"])["page"].is_null());
    holds(&ok(&["diagnose", "--help"]), &["diagnosis.html"]);
}

#[test]
fn e2e_a_healthy_test_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let file = recorded(dir.path(), "well.csv", "1", "0");
    let (_, page) = page_of(&file, &dir.path().join("page"));
    holds(
        first_screen(&page),
        &[
            "Located: healthy",
            "No fault found",
            "would not be seen",
            "ema unit new",
        ],
    );
}

#[test]
fn e2e_digits_follow_the_interval() {
    let dir = tempfile::tempdir().unwrap();
    let file = recorded(dir.path(), "run.csv", "3", "0.3");
    let said = ok(&["diagnose", &file, "--spread", "fleet"]);
    let line = said.lines().find(|l| l.starts_with("FSJ")).unwrap();
    // an interval of some per cent leaves three decimal places
    let number = line.split_whitespace().nth(1).unwrap();
    assert_eq!(number.split_once('.').unwrap().1.len(), 3, "{line}");
}

#[test]
fn e2e_what_cannot_be_told_says_what_is_missing() {
    let dir = tempfile::tempdir().unwrap();
    let file = recorded(dir.path(), "run.csv", "3", "0.3");
    let whole = std::fs::read_to_string(&file).unwrap();
    // the step is missing
    let kept: Vec<&str> = whole.lines().take(21_000).collect();
    // a name from outside with marks of HTML in it
    let cut = dir.path().join("<i>cut-7 & more.csv");
    std::fs::write(&cut, kept.join("\n")).unwrap();
    let (_, page) = page_of(text(&cut), &dir.path().join("page"));
    holds(
        first_screen(&page),
        &[
            "Incomplete",
            "What is missing",
            "Record the whole test again",
            "&lt;i&gt;cut-7 &amp; more.csv",
        ],
    );
    assert!(!page.contains("<i>"));
}

/// The demonstration's page and folder, made once.
fn demo() -> &'static str {
    static ONCE: OnceLock<String> = OnceLock::new();
    ONCE.get_or_init(|| {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("demo");
        ok(&["demo", "--grid", "standard", "--seeds", "4", "--out", text(&out)]);
        std::fs::read_to_string(out.join("report.html")).unwrap()
    })
}

#[test]
fn e2e_the_demo_tells_its_conclusion_first() {
    let page = demo();
    self_contained(page, 2_600_000);
    holds(
        first_screen(page),
        &[
            "all 4 cases of the paper were found",
            "errors of at most",
            "How sure",
            "What next",
            "ema diagnose run.csv --plot page",
            "<b>FSJ</b> is the factor",
            "four cases in the plane of the faults",
            "<svg",
        ],
    );
    // FSJ and zeta stand nowhere before they are explained on the first screen, NTB where it is first used
    holds(page, &["NTB is the numerical test bench"]);
}

#[test]
fn e2e_the_papers_figures_have_their_counterparts() {
    let page = demo();
    for n in [1, 6, 7, 8, 9, 10, 11, 12] {
        let words = format!("(counterpart of the paper\u{2019}s Fig. {n})");
        assert!(page.contains(&words), "Fig. {n}");
    }
}
