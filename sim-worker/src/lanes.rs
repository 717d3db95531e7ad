//! One step of the numerical test bench over N lanes: N runs side by side, each with its own
//! actuator and faults. The equations stand once, in [`crate::control`] and [`crate::plant`];
//! this file puts them in the order of a step and picks the instruction set.
//!
//! Lane count, grouping and instruction set never change a bit: every lane does the same
//! IEEE operations in the same order, and nothing is contracted to fused multiply-adds.

mod instruction_set;
mod state;

use crate::control::{commutation, hysteresis, pick, position, speed};
use crate::effect::LaneEffects;
use crate::plant::{back_emf, backlash, end_stop, friction, inverter, mechanics, torque, windings};
use crate::trig;
pub use instruction_set::InstructionSet;
use instruction_set::Name;
pub use state::{Constants, Handed, State, Sums, Units};

/// Steps after which the rotation of the eccentricity vector is started anew from the angle.
/// Counted from step 0 of the run, so that sampling has no influence.
pub const RESYNC_STEPS: u64 = 256;

/// Terms that a call of the kernel contains; an absent term costs nothing.
pub mod term {
    /// End stops are within reach.
    pub const STOPS: u32 = 1;
    /// Load torque and transmission efficiencies.
    pub const LOAD: u32 = 2;
    /// Sums of the additional channels (voltages, supply current, torque, i_q).
    pub const EXTRA: u32 = 4;
    /// Effects beyond the paper's; needs stops and load.
    pub const EFFECTS: u32 = 8;
    /// Those of bridge, windings, commutation and their sensors; needs effects.
    pub const CURRENTS: u32 = 16;
}

/// Where a lane's constant stands: where all lanes hold the same actuator, in the first.
#[inline(always)]
fn at<const SAME: bool>(l: usize) -> usize {
    if SAME { 0 } else { l }
}

/// The body of every instantiation: `com.len()` steps over all lanes. A step goes through four
/// loops over the lanes rather than one: shorter chains of dependent operations, of which the
/// processor's window then holds several.
#[inline(always)]
fn steps_body<const N: usize, const F: u32, const SAME: bool, const ONE: bool>(
    k: &Constants<N>,
    state: &mut State<N>,
    sums: &mut Sums<N>,
    fx: &mut LaneEffects<N>,
    com: &[f64],
) {
    let mut on = Handed::<N>::default();
    // a single lane then lives in registers
    let mut st = state.clone();
    let mut sum = sums.clone();
    for &com in com {
        if F & term::EFFECTS != 0 && fx.has_levels() {
            fx.level(&k.th0, &st.th, &st.turn);
        }
        // controller
        for l in 0..N {
            let w_ref = position::speed_reference::<ONE>(
                k.gap[at::<SAME>(l)],
                com * k.n[at::<SAME>(l)],
                st.th_u[l],
                k.w_min[at::<SAME>(l)],
                k.w_max[at::<SAME>(l)],
            );
            let gains = speed::Gains {
                kp: k.kp[at::<SAME>(l)],
                ki_dt: k.ki_dt[at::<SAME>(l)],
                i_min: k.i_min[at::<SAME>(l)],
                i_max: k.i_max[at::<SAME>(l)],
                x_min: k.x_min[at::<SAME>(l)],
                x_max: k.x_max[at::<SAME>(l)],
            };
            let seen = if F & term::CURRENTS != 0 {
                st.turn[l] * fx.felt.seen[l]
            } else {
                st.turn[l]
            };
            (on.i_ref[l], st.x[l]) = speed::current_reference::<ONE>(&gains, w_ref - seen, st.x[l]);
        }
        if F & term::EFFECTS != 0 {
            fx.delay(&mut on.i_ref);
        }
        // electrical angle and back-EMF coefficients
        for l in 0..N {
            let moved = if F & term::STOPS != 0 { st.moved[l] } else { st.turn[l] };
            (st.c[l], st.b[l]) = back_emf::rotate(st.c[l], st.b[l], moved);
            st.r[l] += moved * k.flanks[at::<SAME>(l)];
            let fold = back_emf::fold(st.r[l]);
            let gain = back_emf::gains(k.ke[at::<SAME>(l)], st.c[l], st.b[l]);
            let coefficient = |q: usize| back_emf::coefficient::<ONE>(fold[q], gain[q]);
            (on.f0[l], on.f1[l], on.f2[l]) = (fold[0], fold[1], fold[2]);
            (on.k0[l], on.k1[l], on.k2[l]) = (coefficient(0), coefficient(1), coefficient(2));
        }
        if F & term::CURRENTS != 0 {
            if fx.is_electrical() {
                for l in 0..N {
                    let felt = &fx.felt;
                    on.k0[l] *= felt.emf[0][l];
                    on.k1[l] *= felt.emf[1][l];
                    on.k2[l] *= felt.emf[2][l];
                    let r = st.r[l] + felt.error[l];
                    let fold = back_emf::fold(r - 12.0 * trig::nearest(r * (1.0 / 12.0)));
                    // a lane without any stays the same to the bit
                    let same = felt.error[l] == 0.0;
                    on.f0[l] = pick(same, on.f0[l], fold[0]);
                    on.f1[l] = pick(same, on.f1[l], fold[1]);
                    on.f2[l] = pick(same, on.f2[l], fold[2]);
                }
            }
            if fx.has_flux() {
                fx.saturate_flux([&st.ia, &st.ib], [&mut on.k0, &mut on.k1, &mut on.k2]);
            }
            if fx.has_dead_time() {
                let (mut conducts, mut ic) = ([[false; N]; 3], [0.0; N]);
                for l in 0..N {
                    conducts[0][l] = on.f0[l].abs() >= 1.0;
                    conducts[1][l] = on.f1[l].abs() >= 1.0;
                    conducts[2][l] = on.f2[l].abs() >= 1.0;
                    ic[l] = -(st.ia[l] + st.ib[l]);
                }
                fx.drops(&conducts, &[st.ia, st.ib, ic]);
            }
        }
        // current control, bridge and windings; the third current is minus the sum of the others
        for l in 0..N {
            let (ia, ib) = (st.ia[l], st.ib[l]);
            let relay = |fold: f64, margin: f64| {
                hysteresis::relay(
                    commutation::phase_reference::<ONE>(fold, on.i_ref[l]),
                    margin,
                    k.hb[at::<SAME>(l)],
                )
            };
            let h = [
                relay(on.f0[l], st.ma[l]),
                relay(on.f1[l], st.mb[l]),
                relay(on.f2[l], st.mc[l]),
            ];
            let v = [
                inverter::leg_voltage(h[0], k.volts[at::<SAME>(l)]),
                inverter::leg_voltage(h[1], k.volts[at::<SAME>(l)]),
                inverter::leg_voltage(h[2], k.volts[at::<SAME>(l)]),
            ];
            let ke = [on.k0[l], on.k1[l], on.k2[l]];
            let mut i = if F & term::CURRENTS != 0 {
                let felt = &fx.felt;
                let volts = k.volts[at::<SAME>(l)] - felt.sag[l] * felt.supply[l];
                let volts = if volts > 0.0 { volts } else { 0.0 };
                let leg = |q: usize| inverter::leg_voltage(h[q], volts) - felt.drop[q][l];
                let (v, decay) = ([leg(0), leg(1), leg(2)], k.decay[at::<SAME>(l)]);
                let i = windings::step([ia, ib], v, ke, st.turn[l], decay);
                let more = [felt.more[0][l], felt.more[1][l], felt.more[2][l]];
                let uneven = windings::uneven_step([ia, ib], v, ke, st.turn[l], decay, more, felt.even[l]);
                let even = felt.even[l] == 0.0;
                [pick(even, i[0], uneven[0]), pick(even, i[1], uneven[1])]
            } else {
                windings::step([ia, ib], v, ke, st.turn[l], k.decay[at::<SAME>(l)])
            };
            (st.ia[l], st.ib[l]) = (i[0], i[1]);
            // measured current of the third phase
            let mut last = 0.0;
            if F & term::CURRENTS != 0 {
                let supply = inverter::supply_current(h, [i[0], i[1], -(i[0] + i[1])]);
                let supply = pick(fx.felt.by_size[l], supply.abs(), supply);
                sum.supply[l] += supply;
                let level = fx.felt.supply[l] + fx.felt.bus[l] * (supply - fx.felt.supply[l]);
                fx.felt.supply[l] = pick(level.abs() < GONE, 0.0, level);
                // from here on the measured currents
                let felt = &fx.felt;
                let measured = |i: f64, fold: f64, q: usize| {
                    felt.gain[q][l] * i + commutation::phase_reference::<ONE>(fold, felt.offset[l]) + felt.sensor[q][l]
                };
                last = measured(-(i[0] + i[1]), on.f2[l], 2);
                i = [measured(i[0], on.f0[l], 0), measured(i[1], on.f1[l], 1)];
            }
            let mut minus_ic = i[0] + i[1];
            if F & term::CURRENTS != 0 {
                minus_ic = pick(fx.felt.uneven[l], -last, minus_ic - fx.felt.sensors[l]);
                sum.ic[l] -= minus_ic;
            }
            (st.ma[l], st.mb[l], st.mc[l]) = (h[0] - i[0], h[1] - i[1], h[2] + minus_ic);
            sum.ia[l] += i[0];
            sum.ib[l] += i[1];
            sum.abs[l] += i[0].abs() + i[1].abs() + minus_ic.abs();
            if F & term::EXTRA != 0 {
                let n = (v[0] + v[1] + v[2] - (ke[0] + ke[1] + ke[2]) * st.turn[l]) * (1.0 / 3.0);
                let ic = -minus_ic;
                sum.va[l] += v[0] - n;
                sum.vb[l] += v[1] - n;
                sum.vc[l] += v[2] - n;
                if F & term::CURRENTS == 0 {
                    sum.supply[l] += inverter::supply_current(h, [i[0], i[1], ic]);
                }
                let half_shape = |fold: f64| back_emf::coefficient::<false>(fold, 0.5);
                sum.iq[l] += half_shape(on.f0[l]) * i[0] + half_shape(on.f1[l]) * i[1] + half_shape(on.f2[l]) * ic;
            }
        }
        if F & term::CURRENTS != 0 && fx.is_saturated() {
            let mut ic = [0.0; N];
            for l in 0..N {
                ic[l] = -(st.ia[l] + st.ib[l]);
            }
            fx.saturate(&st.ia, &mut on.k0);
            fx.saturate(&st.ib, &mut on.k1);
            fx.saturate(&ic, &mut on.k2);
        }
        if F & term::EFFECTS != 0 && fx.has_state() {
            effects_with_state(k, &st, fx);
        }
        // torque and mechanics
        for l in 0..N {
            let w = st.turn[l];
            let tm = torque::motor::<ONE>(
                [on.k0[l], on.k1[l], on.k2[l]],
                [st.ia[l], st.ib[l]],
                k.t_min[at::<SAME>(l)],
                k.t_max[at::<SAME>(l)],
            );
            let (drive, fs, fd) = if F & term::LOAD != 0 {
                let mut drive = tm - k.load[at::<SAME>(l)];
                if F & term::EFFECTS != 0 {
                    drive -= fx.felt.torque[l];
                }
                let direction = if w == 0.0 { drive } else { w };
                let (fs, fd) = friction::with_load(
                    k.fs[l],
                    k.fd[l],
                    k.load[at::<SAME>(l)],
                    direction,
                    k.opposing[at::<SAME>(l)],
                    k.aiding[at::<SAME>(l)],
                );
                if F & term::EFFECTS != 0 {
                    let felt = |level: f64| {
                        let sum = level + fx.felt.friction[l];
                        fx.felt.dry[l] * if sum > 0.0 { sum } else { 0.0 }
                    };
                    (drive, felt(fs), felt(fd))
                } else {
                    (drive, fs, fd)
                }
            } else {
                (tm, k.fs[l], k.fd[l])
            };
            let mut net = friction::net_torque::<ONE>(drive, k.viscous[at::<SAME>(l)] * w, w, fs, fd);
            if F & term::EFFECTS != 0 {
                net *= fx.felt.agile[l];
            }
            let mut turn = mechanics::speed::<ONE>(w, net);
            if F & term::EFFECTS != 0 {
                // nothing but dry friction stops a rotor dead
                turn = pick(fx.felt.dry[l] == 0.0, w + net, turn);
            }
            let mut th = st.th[l] + turn;
            if F & term::STOPS != 0 {
                let (th1, turn1) = end_stop::stop(th, turn, k.stop[at::<SAME>(l)]);
                st.moved[l] = if th1 == th { turn } else { th1 - st.th[l] };
                (th, turn) = (th1, turn1);
            }
            st.th[l] = th;
            st.turn[l] = turn;
            if F & term::EFFECTS == 0 {
                st.th_u[l] = backlash::play::<ONE>(st.th_u[l], th, k.gap_half[at::<SAME>(l)]);
            }
            if F & term::EXTRA != 0 {
                sum.torque[l] += tm;
            }
        }
        if F & term::EFFECTS != 0 {
            let mut user = st.th;
            if fx.has_behind() {
                for l in 0..N {
                    user[l] = fx.user(l, st.th[l], st.moved[l]);
                }
            }
            for l in 0..N {
                st.th_u[l] = backlash::play::<ONE>(st.th_u[l], user[l], k.gap_half[at::<SAME>(l)]);
            }
        }
    }
    if F & term::STOPS == 0 {
        st.moved = st.turn;
    }
    *state = st;
    *sums = sum;
}

/// What decays below it is 0, long before it becomes subnormal.
const GONE: f64 = 1e-100;

/// Torques of effects that have a state. Lane by lane, apart from the loops over lanes: what a lane without them computes
/// there stays the same to the bit.
#[inline(never)]
fn effects_with_state<const N: usize>(k: &Constants<N>, st: &State<N>, fx: &mut LaneEffects<N>) {
    for l in 0..N {
        fx.mechanical(l, st.th[l], st.turn[l], k.fd[l]);
    }
}

/// Starts the eccentricity vector anew from the rotor angle and clears decayed currents before
/// they become subnormal (a standing rotor's common-mode rounding rest decays for ever).
#[inline(always)]
fn resync_body<const N: usize>(k: &Constants<N>, st: &mut State<N>) {
    for l in 0..N {
        let (s, c) = trig::sin_cos(k.th0[l] + (st.th[l] - st.moved[l]));
        (st.c[l], st.b[l]) = back_emf::eccentricity_vector(k.ke_zeta[l], s, c);
        let ahead = back_emf::eccentricity_vector(k.ke_ahead[l], c, -s);
        (st.c[l], st.b[l]) = (st.c[l] + ahead.0, st.b[l] + ahead.1);
        let r = ((k.th0[l] + (st.th[l] - st.moved[l])) * k.flanks[l]) - 3.0;
        st.r[l] = r - 12.0 * trig::nearest(r * (1.0 / 12.0));
        let keep = |x: f64| if x.abs() < GONE { 0.0 } else { x };
        st.ia[l] = keep(st.ia[l]);
        st.ib[l] = keep(st.ib[l]);
        st.turn[l] = keep(st.turn[l]);
        st.x[l] = keep(st.x[l]);
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::*;

    #[target_feature(enable = "avx2")]
    pub fn steps_avx2<const N: usize, const F: u32, const SAME: bool, const ONE: bool>(
        k: &Constants<N>,
        st: &mut State<N>,
        sum: &mut Sums<N>,
        fx: &mut LaneEffects<N>,
        com: &[f64],
    ) {
        steps_body::<N, F, SAME, ONE>(k, st, sum, fx, com);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
    pub fn steps_avx512<const N: usize, const F: u32, const SAME: bool, const ONE: bool>(
        k: &Constants<N>,
        st: &mut State<N>,
        sum: &mut Sums<N>,
        fx: &mut LaneEffects<N>,
        com: &[f64],
    ) {
        steps_body::<N, F, SAME, ONE>(k, st, sum, fx, com);
    }

    #[target_feature(enable = "avx2")]
    pub fn sines_avx2(amplitude: f64, x: &mut [f64]) {
        sines_body(amplitude, x);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
    pub fn sines_avx512(amplitude: f64, x: &mut [f64]) {
        sines_body(amplitude, x);
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
    pub fn resync_avx512<const N: usize>(k: &Constants<N>, st: &mut State<N>) {
        resync_body(k, st);
    }
}

/// `x = amplitude sin x` for each element.
#[inline(always)]
fn sines_body(amplitude: f64, x: &mut [f64]) {
    for x in x {
        *x = amplitude * trig::sin_cos(*x).0;
    }
}

/// `x = amplitude sin x` for each element; the same bits on every instruction set.
pub fn sines(set: InstructionSet, amplitude: f64, x: &mut [f64]) {
    match set.which() {
        // SAFETY: as in `steps_on`.
        #[cfg(target_arch = "x86_64")]
        Name::Avx512 => unsafe { x86::sines_avx512(amplitude, x) },
        #[cfg(target_arch = "x86_64")]
        Name::Avx2 => unsafe { x86::sines_avx2(amplitude, x) },
        _ => sines_body(amplitude, x),
    }
}

fn steps_on<const N: usize, const F: u32, const SAME: bool, const ONE: bool>(
    set: InstructionSet,
    k: &Constants<N>,
    st: &mut State<N>,
    sum: &mut Sums<N>,
    fx: &mut LaneEffects<N>,
    com: &[f64],
) {
    match set.which() {
        Name::Baseline => steps_body::<N, F, SAME, ONE>(k, st, sum, fx, com),
        // SAFETY: an `InstructionSet` exists only where the processor has it.
        #[cfg(target_arch = "x86_64")]
        Name::Avx2 => unsafe { x86::steps_avx2::<N, F, SAME, ONE>(k, st, sum, fx, com) },
        #[cfg(target_arch = "x86_64")]
        Name::Avx512 => unsafe { x86::steps_avx512::<N, F, SAME, ONE>(k, st, sum, fx, com) },
    }
}

/// `com.len()` steps over all lanes with the terms `F`; `same`: all lanes hold the same actuator,
/// so that its constants are read once.
pub(crate) fn steps<const N: usize, const F: u32>(
    set: InstructionSet,
    same: bool,
    k: &Constants<N>,
    st: &mut State<N>,
    sum: &mut Sums<N>,
    fx: &mut LaneEffects<N>,
    com: &[f64],
) {
    if N == 1 {
        steps_on::<N, F, true, true>(set, k, st, sum, fx, com);
    } else if same {
        steps_on::<N, F, true, false>(set, k, st, sum, fx, com);
    } else {
        steps_on::<N, F, false, false>(set, k, st, sum, fx, com);
    }
}

/// See [`resync_body`].
pub(crate) fn resync<const N: usize>(set: InstructionSet, k: &Constants<N>, st: &mut State<N>) {
    match set.which() {
        // SAFETY: as in `steps_on`.
        #[cfg(target_arch = "x86_64")]
        Name::Avx512 => unsafe { x86::resync_avx512(k, st) },
        _ => resync_body(k, st),
    }
}
