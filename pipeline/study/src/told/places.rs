//! Where the gap is: in words, along signals, and over time.

use crate::equations::problem::Problem;
use crate::search::fit::Fit;
use crate::search::remainder::{self, Regressor};
use crate::search::select::Material;
use crate::search::study::Outcome;
use crate::told::findings::{Profile, Region, Trace};
use crate::told::tell::{channel, to_channel};
use sim_worker::effect::Equation;

/// Bins of a search for regions.
const BINS: usize = 16;

/// Places where an equation's excess is denser than elsewhere.
pub fn regions(m: &Material, fit: &Fit) -> Vec<Region> {
    let p = &m.fit;
    let mut out = Vec::new();
    for &e in m.equations.iter().filter(|e| **e != Equation::Controller) {
        let rows = p.rows_of(e);
        let floor2 = p.floor_of(e).powi(2);
        let energy = fit.score.energy[e.index()];
        let excess = energy - rows as f64 * floor2;
        if excess < 0.25 * rows as f64 * floor2 {
            continue;
        }
        let mut found: Vec<Region> = Vec::new();
        for r in Regressor::ALL
            .into_iter()
            .filter(|r| m.constants.measured_current || *r != Regressor::Drive)
        {
            let absolute = matches!(
                r,
                Regressor::Speed | Regressor::Drive | Regressor::Acceleration | Regressor::Load
            );
            for size in [false, true] {
                if size && !absolute {
                    continue;
                }
                if let Some(region) = densest(p, fit, e, r, size, excess, floor2) {
                    found.push(region);
                }
            }
        }
        let (mut up, mut down) = (0.0, 0.0);
        for b in p.blocks_of(e) {
            for (row, &k) in b.rows.clone().zip(&b.samples) {
                let x = fit.residual[row].powi(2) - floor2;
                if p.signals[b.run].omega[k] > 0.0 {
                    up += x
                } else {
                    down += x
                }
            }
        }
        found.sort_by(|a, b| (b.share - b.samples).total_cmp(&(a.share - a.samples)));
        found.truncate(2);
        let up_share = (up / (up + down)).clamp(0.0, 1.0);
        if (up_share - 0.5).abs() > 0.2 {
            let way = if up_share > 0.5 { "positive" } else { "negative" };
            found.push(Region {
                equation: e.name().to_string(),
                share: up_share.max(1.0 - up_share),
                samples: 0.5,
                text: format!(
                    "{:.0} % of the {} gap lies in {way} motion",
                    100.0 * up_share.max(1.0 - up_share),
                    e.name()
                ),
            });
        } else if let Some(first) = found.first_mut() {
            first.text += ", in both directions";
        }
        out.extend(found);
    }
    out.sort_by(|a, b| (b.share - b.samples).total_cmp(&(a.share - a.samples)));
    out
}

/// The range of a signal that holds most of the excess for the share of samples in it.
fn densest(p: &Problem, fit: &Fit, e: Equation, r: Regressor, size: bool, excess: f64, floor2: f64) -> Option<Region> {
    let mut all: Vec<(f64, f64)> = Vec::new();
    for b in p.blocks_of(e) {
        for (row, &k) in b.rows.clone().zip(&b.samples) {
            let x = r.value(&p.signals[b.run], k);
            all.push((if size { x.abs() } else { x }, fit.residual[row].powi(2) - floor2));
        }
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let n = all.len();
    if n < 4 * BINS || all[n - 1].0 - all[0].0 < 1e-9 {
        return None;
    }
    let edge = |i: usize| i * (n - 1) / BINS;
    let energy: Vec<f64> = (0..BINS)
        .map(|i| all[edge(i)..edge(i + 1)].iter().map(|x| x.1).sum())
        .collect();
    let mut best = (0.0, 0, 0);
    for from in 0..BINS {
        for to in from + 1..=BINS.min(from + BINS / 2) {
            let share = energy[from..to].iter().sum::<f64>() / excess;
            let gain = share.min(1.0) - (to - from) as f64 / BINS as f64;
            if gain > best.0 {
                best = (gain, from, to);
            }
        }
    }
    let (gain, from, to) = best;
    if gain < 0.12 {
        return None;
    }
    let samples = (to - from) as f64 / BINS as f64;
    let share = (energy[from..to].iter().sum::<f64>() / excess).clamp(0.0, 1.0);
    let name = if size {
        format!("|{}|", r.name())
    } else {
        r.name().to_string()
    };
    let (low, high) = (all[edge(from)].0, all[edge(to)].0);
    let place = if from == 0 {
        format!("{name} < {high:.3} {}", r.unit())
    } else if to == BINS {
        format!("{name} > {low:.3} {}", r.unit())
    } else {
        format!("{name} {low:.3} to {high:.3} {}", r.unit())
    };
    Some(Region {
        equation: e.name().to_string(),
        share,
        samples,
        text: format!(
            "{:.0} % of the {} gap lies at {place} ({:.0} % of the samples)",
            100.0 * share,
            e.name(),
            100.0 * samples
        ),
    })
}

/// Mean residual along signals, where it says most.
pub fn profiles(o: &Outcome) -> Vec<Profile> {
    let m = &o.material;
    let p = &m.fit;
    let mut scored: Vec<(f64, Profile)> = Vec::new();
    for &e in m.equations.iter().filter(|e| **e != Equation::Controller) {
        for r in [
            Regressor::Speed,
            Regressor::Position,
            Regressor::Turn,
            Regressor::Drive,
            Regressor::Acceleration,
            Regressor::Load,
            Regressor::Temperature,
        ] {
            if r == Regressor::Drive && !m.constants.measured_current {
                continue;
            }
            let edges = remainder::edges(p, e, r, 24);
            if edges.len() < 8 {
                continue;
            }
            let n = edges.len() + 1;
            let mut sums = vec![[0.0; 4]; n];
            for b in p.blocks_of(e) {
                for (row, &k) in b.rows.clone().zip(&b.samples) {
                    let x = r.value(&p.signals[b.run], k);
                    let s = &mut sums[remainder::bin(&edges, x)];
                    let new = [1.0, x, o.retuned.residual[row], o.model.residual[row]];
                    s.iter_mut().zip(new).for_each(|(s, x)| *s += x);
                }
            }
            sums.retain(|s| s[0] > 0.0);
            let mean = |i: usize| -> Vec<f64> { sums.iter().map(|s| s[i] / s[0]).collect() };
            let profile = Profile {
                equation: e.name().to_string(),
                unit: e.unit().to_string(),
                signal: r.name().to_string(),
                signal_unit: r.unit().to_string(),
                at: mean(1),
                retuned: mean(2),
                last: mean(3),
            };
            let told: f64 = sums.iter().map(|s| s[2] * s[2] / s[0]).sum::<f64>()
                / p.floor_of(e).powi(2)
                / p.rows_of(e).max(1) as f64;
            scored.push((told, profile));
        }
    }
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.into_iter().take(4).map(|s| s.1).collect()
}

/// The drive signal over a stretch of a held-out run, where the re-tuned model is worst.
pub fn traces(o: &Outcome) -> Vec<Trace> {
    let m = &o.material;
    let p = m.held_problem();
    let (retuned, last) = (&o.held_residuals.0, &o.held_residuals.1);
    let Some(block) = p.blocks_of(Equation::Torque).next() else {
        return Vec::new();
    };
    let length = ((1.5 * m.clock.rate_hz) as usize / p.group()).max(50);
    let n = block.samples.len();
    if n < 10 {
        return Vec::new();
    }
    let energy = |from: usize| -> f64 {
        (from..(from + length).min(n))
            .map(|i| retuned[block.rows.start + i].powi(2))
            .sum()
    };
    let from = (0..n.saturating_sub(length).max(1))
        .step_by((length / 4).max(1))
        .max_by(|a, b| energy(*a).total_cmp(&energy(*b)))
        .unwrap_or(0);
    let s = &p.signals[block.run];
    let c = to_channel(m, Equation::Torque);
    let (name, unit) = channel(m, Equation::Torque);
    let mut t = Trace {
        channel: name.to_string(),
        unit: unit.to_string(),
        run: p.names[block.run].clone(),
        heldout: m.held.is_some(),
        time_s: Vec::new(),
        measured: Vec::new(),
        nominal: Vec::new(),
        retuned: Vec::new(),
        last: Vec::new(),
    };
    for i in from..(from + length).min(n) {
        let (row, k) = (block.rows.start + i, block.samples[i]);
        let measured = p.drive[row] * c;
        t.time_s.push(s.start_s + k as f64 / s.rate_hz);
        t.measured.push(measured);
        let nominal = o.held_nominal_residual.get(row).copied().unwrap_or(f64::NAN);
        t.nominal.push(measured - nominal * o.nominal_to_channel);
        t.retuned.push(measured - retuned[row] * c);
        t.last.push(measured - last[row] * c);
    }
    vec![t]
}
