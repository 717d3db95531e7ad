//! Figures of the demonstration that have their counterparts in the paper, and its models over time.

use super::{map_plot, traces};
use crate::demo::DemoResult;
use crate::report::{Figure, RegionPlot, Section};
use schemas::channel::Channel;
use schemas::sequence::Command;
use schemas::telemetry::Collector;
use sim_worker::monitor::MonitorTrack;

type Named = (String, Figure);

/// The caption of a figure that the paper has too.
pub(super) fn counterpart(text: &str, number: u32) -> String {
    format!("{text} (counterpart of the paper\u{2019}s Fig. {number})")
}

/// Numerical test bench beside the simplified model: position, speed, current, torque.
fn model_comparison(ntb: &Collector, sm: &MonitorTrack, rate_hz: f64) -> Vec<Named> {
    let pairs: [(&str, &str, Channel, &[f64]); 4] = [
        ("user position", "position", Channel::ThetaU, &sm.theta_u_rad),
        ("motor speed", "speed", Channel::OmegaM, &sm.omega_rad_per_s),
        (
            "equivalent current against |Im|",
            "current",
            Channel::IEq,
            &sm.abs_current_a,
        ),
        ("motor torque", "torque", Channel::TorqueM, &sm.torque_n_m),
    ];
    let mut out = Vec::new();
    for (title, label, channel, model) in pairs {
        let mut plot = traces(
            &format!("NTB and SM: {title}"),
            label,
            &[("NTB", ntb)],
            rate_hz,
            channel,
        );
        plot.series.push(("SM".into(), over_time(model, rate_hz)));
        out.push((format!("models_{label}"), Figure::Trace(plot)));
    }
    out
}

fn over_time(values: &[f64], rate_hz: f64) -> Vec<(f64, f64)> {
    let point = |(i, &y): (usize, &f64)| ((i + 1) as f64 / rate_hz, y);
    values.iter().enumerate().map(point).collect()
}

/// Position of both models in the sine, with the command.
fn sine(r: &DemoResult, sm: &MonitorTrack) -> Option<Named> {
    let e = &r.grid.setup;
    let sine = |s: &&schemas::sequence::Segment| matches!(s.command, Command::Sine { .. });
    let s = e.sequence.segments.iter().find(sine)?;
    let within = s.start_s..=s.start_s + s.duration_s;
    let title = "Position of NTB and SM in the sine, nominal condition";
    let mut plot = traces(
        title,
        "user position",
        &[("NTB", &r.healthy)],
        e.rate_hz,
        Channel::ThetaU,
    );
    // the command lies under what follows it
    plot.series
        .insert(0, ("command".into(), over_time(&sm.com_rad, e.rate_hz)));
    plot.series.push(("SM".into(), over_time(&sm.theta_u_rad, e.rate_hz)));
    for (_, points) in &mut plot.series {
        points.retain(|p| within.contains(&p.0));
    }
    Some(("figure_6_sine".into(), Figure::Trace(plot)))
}

/// The eccentricity, and how the two models follow the sine: before anything is diagnosed.
pub(super) fn background(r: &DemoResult) -> Section {
    let e = &r.grid.setup;
    let sm = MonitorTrack::run(&e.actuator, &e.sequence, e.rate_hz);
    let gap = "Static eccentricity: the rotor stands off the centre of the stator".to_string();
    let mut figures = vec![("figure_1_eccentricity".to_string(), Figure::Gap { title: gap })];
    let mut captions = vec![(
        "figure_1_eccentricity".to_string(),
        counterpart(
            "Static eccentricity: the rotor stands off the centre of the stator by x\u{2080}, a share \u{3b6} of the air gap g\u{2080} = \
             R_S \u{2212} R_R; the gap is not drawn to scale",
            1,
        ),
    )];
    if let Some(f) = sine(r, &sm) {
        let words = "User position of NTB and SM in the sine of 0.001 rad and 5 Hz, nominal condition";
        captions.push((f.0.clone(), counterpart(words, 6)));
        figures.push(f);
    }
    let mut whole = model_comparison(&r.healthy, &sm, e.rate_hz);
    for (channel, label) in [(Channel::OmegaM, "speed"), (Channel::IEq, "current")] {
        let runs = [("healthy", &r.healthy), ("zeta 0.15, FSJ 3.5", &r.table[2].run)];
        let title = format!("Healthy and faulty: {}", channel.meaning());
        let plot = traces(&title, label, &runs, e.rate_hz, channel);
        whole.push((format!("faults_{label}"), Figure::Trace(plot)));
    }
    Section {
        title: "Eccentricity and models".into(),
        text: "NTB is the numerical test bench, the detailed simulation that stands for the real actuator; SM is the simplified \
               model, which P2 is measured against."
            .into(),
        figures,
        captions,
        folded: vec![Section {
            title: "Both models over the whole test, and a healthy beside a faulty actuator".into(),
            figures: whole,
            ..Section::default()
        }],
        ..Section::default()
    }
}

/// The failure maps: how to read one, the paper's three, the others folded.
pub(super) fn maps(r: &DemoResult) -> Section {
    let set = &r.grid.diagnoser.maps;
    let mut figures = Vec::new();
    let mut captions = Vec::new();
    let mut others = Vec::new();
    for m in &set.maps {
        let stem = format!("map_{}", m.feature.name());
        let number = match m.feature {
            schemas::feature::Feature::P1 => 8,
            schemas::feature::Feature::P2 => 9,
            schemas::feature::Feature::P3 => 10,
            _ => {
                others.push((stem, Figure::Map(map_plot(m, None))));
                continue;
            }
        };
        captions.push((stem.clone(), counterpart(m.feature.title(), number)));
        figures.push((stem, Figure::Map(map_plot(m, None))));
    }
    if let Some(m) = set.map(schemas::feature::Feature::P2) {
        let mut plot = map_plot(m, None);
        plot.title = "How to read a failure map".into();
        plot.knots.clear();
        let n = plot.curves.len();
        let shown = |i: usize| i == 0 || i + 1 == n || 2 * i + 1 == n;
        let mut i = 0..;
        plot.curves.retain(|_| i.next().is_some_and(shown));
        let stem = "figure_7_example".to_string();
        let words = "How to read a failure map: one measured parameter upwards, one fault (G1, here FSJ) to the right, a curve for each \
                     size of the other (G2, here zeta)";
        captions.push((stem.clone(), counterpart(words, 7)));
        figures.insert(0, (stem, Figure::Map(plot)));
    }
    Section {
        title: "Failure maps".into(),
        text: format!(
            "Each curve is one eccentricity zeta; dots are simulated runs, averaged over sensor noise. {}",
            super::diagnosis::THREE
        ),
        figures,
        captions,
        folded: vec![Section {
            title:
                "Maps of the further features (the ripple falls slightly with FSJ, the others rise with both faults)"
                    .into(),
            figures: others,
            ..Section::default()
        }],
        ..Section::default()
    }
}

/// All cases in the plane of the faults.
pub(super) fn cases(r: &DemoResult) -> Option<RegionPlot> {
    let maps = r.grid.diagnoser.maps.maps.first()?;
    let truth: Vec<(f64, f64)> = r.table.iter().map(|c| (c.truth().fsj, c.truth().zeta)).collect();
    let found = r.table.iter().filter_map(|c| c.case.diagnosis.outcome.area());
    let mut notes = vec![((1.0, 0.0), "healthy".to_string())];
    notes.extend(truth.iter().enumerate().map(|(i, t)| (*t, format!("case {}", i + 1))));
    Some(RegionPlot {
        title: "The paper's four cases in the plane of the faults".into(),
        fsj_range: (maps.fsj[0], maps.fsj[maps.fsj.len() - 1]),
        zeta_range: (maps.zeta[0], maps.zeta[maps.zeta.len() - 1]),
        regions: Vec::new(),
        area: Vec::new(),
        hull: None,
        truth,
        estimate: found.map(|a| a.centroid).collect(),
        notes,
    })
}
