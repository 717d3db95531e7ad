//! The page of one diagnosed recording; the demonstration shows its cases by the same parts.

use super::conclusion::{self, Around};
use super::{cut_maps, of_paper, plane, region_plot, traces};
use crate::COMMIT;
use crate::case::Case;
use crate::digits;
use crate::prognosis::words::short;
use crate::report::{Figure, Lead, Report, Section, Table, TableRow};
use diagnoser::diagnosis::Outcome;
use schemas::channel::Channel;
use schemas::fault::FaultState;
use schemas::feature::Feature;
use std::path::Path;

/// What the paper's three maps show, where they are first met.
pub(super) const THREE: &str = "P1 is the RMS error of the speed in the step, P2 that of the current in the sine, P3 the command \
                                at which the ramp sets the actuator in motion, relative to the nominal run.";

/// A case that is to be shown.
pub(crate) struct Shown<'a> {
    /// the case
    pub case: &'a Case,
    /// begin of its file stems
    pub stem: &'a str,
    /// the faults that were simulated, where they are known
    pub truth: Option<FaultState>,
}

/// The last part of a path.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name()
        .map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}

/// The conclusion with the plane of the faults beside it.
pub(super) fn lead(shown: &Shown, around: &Around) -> Lead {
    let (case, d) = (shown.case, &shown.case.diagnosis);
    let mut lead = conclusion::of_case(case, around);
    let plot = plane(&case.diagnoser, d);
    let bands = "Each coloured band holds the pairs of faults that one feature allows.";
    let what = match (&d.outcome, d.outcome.area()) {
        (Outcome::Located(_), Some(_)) => "The blue dot is what all features together locate; enlarged below.",
        (_, Some(_)) => "The blue dot is the middle of what the features that there are allow.",
        _ => "No place of the plane lies in all of them.",
    };
    lead.caption = if plot.regions.is_empty() {
        "The plane of the faults: the recording gives no band in it.".into()
    } else {
        format!("{bands} {what} {THREE}")
    };
    lead.figure = Some((format!("{}_plane", shown.stem), Figure::Region(plot)));
    lead
}

/// Where the bands cut each other: the whole plane, and enlarged.
pub(super) fn area_section(title: &str, shown: &Shown) -> Section {
    let (case, d) = (shown.case, &shown.case.diagnosis);
    let plot = |name: &str, title: &str, zoom: bool| {
        let plot = region_plot(title, &case.diagnoser, d, shown.truth, zoom);
        (format!("{}_{name}", shown.stem), Figure::Region(plot))
    };
    let mut figures = vec![plot(
        "region",
        "Bands of all features in the plane of the faults",
        false,
    )];
    if d.outcome.area().is_some() {
        figures.insert(0, plot("area", "Located area, enlarged", true));
    }
    Section {
        title: title.into(),
        text: "A band is the measured value of a feature, give or take its uncertainty, cut out of the feature's failure \
               map. What all bands have in common is the located area; the intervals are its bounding box, the estimate is \
               its centroid."
            .into(),
        figures,
        ..Section::default()
    }
}

/// The features and what the maps say of them.
fn features(case: &Case) -> Table {
    let d = &case.diagnosis;
    let band = d.outcome.area().map_or(case.diagnoser.usual_band(), |a| a.band);
    let row = |f: Feature| {
        let (v, m) = (d.features.get(f)?, case.diagnoser.maps.map(f)?);
        let (lo, hi) = m.range();
        let at = d.outcome.area().map_or((m.fsj[0], m.zeta[0]), |a| a.centroid);
        let half = band * case.diagnoser.uncertainty(f, at.0, at.1).unwrap_or(f64::NAN);
        let told = if half.is_finite() {
            digits::fixed(half, half)
        } else {
            "-".into()
        };
        let cells = vec![
            f.name().to_string(),
            f.title().into(),
            digits::fixed(v, half),
            told,
            f.unit().into(),
            format!("{} to {}", short(lo), short(hi)),
        ];
        Some(TableRow { cells, emphasis: false })
    };
    let header = [
        "feature",
        "what it is",
        "measured",
        "\u{b1}",
        "unit",
        "range of the map",
    ];
    Table {
        caption: "Features of the recording".into(),
        header: header.map(String::from).to_vec(),
        rows: Feature::located_by().filter_map(row).collect(),
        note: "\u{b1}: half-width of the band.".into(),
    }
}

/// What was measured, and the maps that it was held against, folded.
pub(super) fn measured_section(title: &str, shown: &Shown) -> Section {
    let maps = cut_maps(shown.stem, &shown.case.diagnoser, &shown.case.diagnosis, shown.truth);
    let (three, others): (Vec<_>, Vec<_>) = maps.into_iter().partition(|m| of_paper(m.0));
    let folded = [
        ("Maps and cuts: P1, P2, P3", three),
        ("Maps and cuts of the other features", others),
    ];
    let folded = folded
        .into_iter()
        .filter(|f| !f.1.is_empty())
        .map(|(title, maps)| Section {
            title: title.into(),
            figures: maps.into_iter().map(|m| m.1).collect(),
            ..Section::default()
        });
    Section {
        title: title.into(),
        tables: vec![features(shown.case)],
        folded: folded.collect(),
        ..Section::default()
    }
}

/// The recording over time, folded.
fn recording(case: &Case) -> Section {
    let m = &case.measured;
    let some = |c: &&Channel| m.telemetry.column(**c).is_some();
    let currents = [Channel::IEq, Channel::IA];
    let channels = [Channel::ThetaU, Channel::OmegaM].iter().filter(some);
    let channels = channels.chain(currents.iter().find(some));
    let figure = |c: &Channel| {
        let title = format!("Recorded {}", c.meaning());
        let plot = traces(&title, c.name(), &[("", &m.telemetry)], m.rate_hz, *c);
        (format!("diagnosis_{}", c.name()), Figure::Trace(plot))
    };
    let text = m.said.iter().map(|s| format!("- {}\n", schemas::foreign::line(s)));
    Section {
        title: "The recording".into(),
        text: text.collect(),
        folded: vec![Section {
            title: "Traces over time".into(),
            figures: channels.map(figure).collect(),
            ..Section::default()
        }],
        ..Section::default()
    }
}

/// The page.
///
/// * `more` title and text of what else was found (a fit by the test bench, what is known of the unit)
pub(crate) fn report(file: &Path, case: &Case, around: &Around, more: Vec<(String, String)>) -> Report {
    let shown = Shown {
        case,
        stem: "diagnosis",
        truth: None,
    };
    let mut sections = vec![
        area_section(
            if case.diagnosis.outcome.area().is_some() {
                "The located area"
            } else {
                "The bands"
            },
            &shown,
        ),
        measured_section("What was measured", &shown),
    ];
    sections.extend(more.into_iter().map(|(title, text)| Section {
        title,
        text,
        ..Section::default()
    }));
    sections.push(recording(case));
    let h = &case.diagnoser.maps.header;
    let sensors = if h.kind.sensors == "none" {
        "none: noise free"
    } else {
        "as recorded or recognised; their model is assumed"
    };
    let mut facts = vec![
        ("Recording".into(), file.display().to_string()),
        ("Outcome".into(), case.diagnosis.outcome.name().replace('_', " ")),
        ("Actuator of the maps".into(), h.actuator.clone()),
        ("Test".into(), format!("{} at {} Hz", h.sequence, h.kind.rate_hz)),
        (
            "Rotor at rest".into(),
            format!("{:.1} deg", h.kind.rest_angle_rad.to_degrees()),
        ),
        ("Sensors".into(), sensors.into()),
        (
            "Program".into(),
            format!("ema {}, revision {COMMIT}", env!("CARGO_PKG_VERSION")),
        ),
    ];
    facts.extend(h.left_out.iter().map(|l| ("Map left out".into(), l.clone())));
    Report {
        title: format!("Diagnosis of {}", file_name(file)),
        lead: Some(lead(&shown, around)),
        summary: String::new(),
        facts,
        sections,
    }
}
