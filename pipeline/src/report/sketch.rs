//! The sketch of a static eccentricity: a rotor that stands off the centre of its stator.

use anyhow::Result;
use plotters::style::text_anchor::HPos;

use super::canvas::{Canvas, SMALL, Title};
use super::scale::Pt;
use super::theme::{ESTIMATE, INK, MUTED, REGIONS, TRUTH};

pub(super) const SIZE: (u32, u32) = (560, 460);

/// Radii of stator and rotor, and how far the rotor stands off, in pixels: a gap that can be seen.
const STATOR: f64 = 178.0;
const ROTOR: f64 = 126.0;
const OFF: f64 = 24.0;
/// The angle that is shown [rad].
const ANGLE: f64 = 0.62;

fn circle((x, y): Pt, radius: f64) -> Vec<Pt> {
    let at = |k: i32| {
        let a = f64::from(k) / 180.0 * std::f64::consts::TAU;
        (x + radius * a.cos(), y - radius * a.sin())
    };
    (0..=180).map(at).collect()
}

/// Draws it: the gap is widest at the angle 0, as Eq. 2 has it, so the rotor stands off to the other side.
pub(super) fn gap(canvas: &Canvas, title: Option<&str>) -> Result<()> {
    let top = canvas.title(Title {
        text: title,
        width: f64::from(SIZE.0),
    })?;
    let stator = (250.0, top + STATOR + 14.0);
    let rotor = (stator.0 - OFF, stator.1);
    canvas.line(&circle(stator, STATOR + 10.0), MUTED, 0.5, 1.0)?;
    canvas.line(&circle(stator, STATOR), INK, 1.0, 2.0)?;
    canvas.fill(&circle(rotor, ROTOR), ESTIMATE, 0.12)?;
    canvas.line(&circle(rotor, ROTOR), ESTIMATE, 1.0, 2.0)?;
    // the axis that angles count from, and the angle
    canvas.dashes(
        (stator.0 - STATOR - 26.0, stator.1),
        (stator.0 + STATOR + 40.0, stator.1),
        MUTED,
        1.0,
    )?;
    let at = |r: f64, a: f64| (stator.0 + r * a.cos(), stator.1 - r * a.sin());
    let arc: Vec<Pt> = (0..=20).map(|k| at(64.0, ANGLE * f64::from(k) / 20.0)).collect();
    canvas.line(&arc, INK, 1.0, 1.0)?;
    canvas.text("\u{3b8}", at(76.0, 0.5 * ANGLE), SMALL, INK, HPos::Center)?;
    // from the stator's centre to where its ray leaves the rotor, and on to the stator: the gap
    let (c, s) = (ANGLE.cos(), ANGLE.sin());
    let inner = (ROTOR * ROTOR - OFF * OFF * s * s).sqrt() - OFF * c;
    canvas.line(&[stator, at(inner, ANGLE)], MUTED, 1.0, 1.0)?;
    canvas.line(&[at(inner, ANGLE), at(STATOR, ANGLE)], TRUTH, 1.0, 3.0)?;
    canvas.line(&[at(STATOR, ANGLE), at(STATOR + 22.0, ANGLE)], TRUTH, 1.0, 0.75)?;
    let label = at(STATOR + 30.0, ANGLE);
    canvas.text(
        "g\u{2032}(\u{3b8}) = g\u{2080} (1 + \u{3b6} cos \u{3b8})",
        (label.0 - 16.0, label.1 - 8.0),
        SMALL,
        TRUTH,
        HPos::Left,
    )?;
    // radii
    let down = |from: Pt, r: f64, a: f64| [from, (from.0 + r * a.cos(), from.1 + r * a.sin())];
    let of_stator = down(stator, STATOR, 1.15);
    let of_rotor = down(rotor, ROTOR, 2.0);
    canvas.line(&of_stator, INK, 1.0, 1.0)?;
    canvas.line(&of_rotor, ESTIMATE, 1.0, 1.0)?;
    let beside = |[a, b]: [Pt; 2], dx: f64| (0.4 * a.0 + 0.6 * b.0 + dx, 0.4 * a.1 + 0.6 * b.1);
    canvas.text("R_S", beside(of_stator, 12.0), SMALL, INK, HPos::Left)?;
    canvas.text("R_R", beside(of_rotor, -12.0), SMALL, ESTIMATE, HPos::Right)?;
    // how far the centres are apart
    for (at, color) in [(stator, INK), (rotor, ESTIMATE)] {
        canvas.disc(at, 3.0, color, 1.0)?;
        canvas.line(&[(at.0, at.1 - 6.0), (at.0, at.1 - 40.0)], color, 0.8, 0.75)?;
    }
    canvas.line(
        &[(rotor.0, rotor.1 - 34.0), (stator.0, stator.1 - 34.0)],
        REGIONS[0],
        1.0,
        2.0,
    )?;
    let above = (rotor.0 + 0.5 * OFF, rotor.1 - 52.0);
    canvas.text(
        "x\u{2080} = \u{3b6} (R_S \u{2212} R_R)",
        above,
        SMALL,
        INK,
        HPos::Center,
    )?;
    let foot = stator.1 + STATOR + 24.0;
    canvas.text("stator", (stator.0 + 96.0, foot), SMALL, INK, HPos::Left)?;
    canvas.text("rotor", (rotor.0 - 40.0, rotor.1 + 30.0), SMALL, ESTIMATE, HPos::Right)?;
    Ok(())
}
