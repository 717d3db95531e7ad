//! Dry friction after Borello and Dalla Vedova (paper ref. [24]), with the fault factor FSJ.

use crate::control::pick;

/// Friction levels of this step `(FS, FD)` [N m] with a load torque and transmission efficiencies.
///
/// * `fs`, `fd` static and dynamic friction torque [N m]
/// * `tr` load torque, positive against positive motion [N m]
/// * `direction` speed, or the driving torque of a standing rotor: only its sign counts
/// * `opposing` `1/eta_o - 1`, `aiding` `1 - eta_a` (0 for a loss-free transmission)
///
/// Both levels gain `|TR| (1/eta_o - 1)` where the load opposes the (impending) motion and
/// `|TR| (1 - eta_a)` where it aids it.
#[inline(always)]
pub fn with_load(fs: f64, fd: f64, tr: f64, direction: f64, opposing: f64, aiding: f64) -> (f64, f64) {
    let share = if tr * direction > 0.0 { opposing } else { aiding };
    let extra = tr.abs() * share;
    (fs + extra, fd + extra)
}

/// Net torque on the rotor `A - FF` [N m], `A = TM - C w - TR`.
///
/// A standing rotor stays (`FF = A`) while `|A| <= FS` and breaks away against `FF = FD sign A`;
/// a moving one feels `FF = FD sign w`.
///
/// * `drive` `TM - TR` [N m], `viscous` `C w` [N m], `w` motor speed [rad/s]
#[inline(always)]
pub fn net_torque<const ONE: bool>(drive: f64, viscous: f64, w: f64, fs: f64, fd: f64) -> f64 {
    if ONE && w != 0.0 {
        return drive - (viscous + fd.copysign(w));
    }
    let moving = drive - (viscous + fd.copysign(w));
    let away = drive - fd.copysign(drive);
    let standing = pick(drive.abs() <= fs, 0.0, away);
    pick(w == 0.0, standing, moving)
}
