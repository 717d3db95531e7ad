#!/usr/bin/env python3
"""Recordings of simulated single-axis electromechanical rigs with a known discrepancy from the plain model.

    testbeds.py --seed S --first K --cases N --class nothing|one|two|outside --out DIR [--jobs J] [--selfcheck]

writes DIR/case_NNN/bench.toml with its data files and, beside DIR, keys_<basename of DIR>.json.
A case depends on (seed, case number, class) only.

PLAIN MODEL.  kt i = J dw/dt + C w + Fc sgn w + load (+ a known weight);  v = R i + L di/dt + ke w, ke = kt.
Everything is computed at the rotor in SI; linear rigs are converted on writing with 2 pi / lead.

INTEGRATION.  Fixed step (at most 50 us).  Speed: explicit in all smooth torques; dry friction by an impulse that stops
the rotor if it can and else opposes the motion (Moreau's time stepping), so that an axis sticks exactly and breaks
away exactly.  Position: theta += h w (new speed).  Current: exact lag of the current loop (current source), or
L di/dt = v - R i - ke w with a PI current loop and a bounded voltage, or a voltage fed directly.  Bristles: implicit
in z.  Means over a sample are sums over all its steps.  Controllers run at their own fixed rate.

RIGS.  direct (servo motor with flywheel), geared (servo gearmotor, its user side sometimes measured), spindle (one
direction only), screw (ball screw), vertical (ball screw with a weight: `offset` is stated, 5 % off at the most),
belt (belt axis).  Fed by a current source (drive "current"), an amplifier with input in volts (drive "voltage", N m/V),
a motor with measured torque (drive "torque"), measured screw force (drive "force"), or a DC motor with measured terminal
voltage and current (drive "voltage" + current, closed current loop, or voltage fed directly).  The current, voltage, and
speed are bounded; some runs reach the bounds.  Some rigs have a load machine (channel load), a thermometer, v_dc.

MOTION.  S-curve moves with dwells among random stations; a pick-and-place cycle; strokes at constant speeds; chirps;
pseudo-random speed steps; jogging by hand; speed plateaus in both directions; spindle plateaus; pseudo-random torque
with a weak speed loop.  The position or speed is controlled by a P/PI cascade on the quantised encoder (difference
quotient, filtered) or on a tachometer.  Runs of 5 to 60 s (fewer at high rates, 60 000 samples at the most), 2 to 5 runs and an
`off` record at times.  Held-out runs may have another family of motion, 0.6 to 1.1 of the amplitude, another day (dry
and viscous friction 0.5 to 2.5 % different).

RECORDING.  200 Hz to 10 kHz; position (256 counts to 20 bit a turn), speed (own sensor, mean or point) or both; white
noise on current, voltage, torque (0.3 to 2 % of rms), mains hum of at most 0.7 of that noise, small current-sensor offsets (at most
0.15 % of peak, below the tolerance of 0.2 %, only in current or voltage records), jittered clocks (true stamps),
a gap of 0.2 to 1.5 s, a delay of the drive channel of 1 to 3 samples and at most 4 ms (stated or not).  Stated constants are off by up to
25 %, with the trust to match (deviation at most 1.6 trust).  With an `off` record the current sensor's offset is up to 3 % of the
range; it is then listed under also_true as current_offset.

EFFECTS (README's terms and signs; sizes):
 stribeck 0.35..1 Fc; lubricated_rise, quadratic_drag, viscous_asymmetry, bias_torque, cogging, spring_load 6..35 % of the torque scale;
 load_dependent_friction 0.1..0.35; temperature_dependent_friction -0.018..-0.006 1/K over 15..35 K; periodic_friction 0.35..0.85 Fc,
 orders 1..3; tight_spot 1..3 Fc, width 4..15 % of the travel; presliding bend Fc/stiffness 1..6 % of the travel;
 torque_ripple 6..25 %; torque_saturation 10..35 % at the current's scale; compliance antiresonance 4..22 Hz, load 0.3..0.7 of all inertia
 (J of `constants` is the total, friction acts on the motor); backlash: total play at the motor [rad], user = play operator without drag;
 winding_heating 30..90 K with the resistance stated to 0.5 %; supply_sag 4..15 % of the supply at the current's scale, draw = power;
 dead_time 4..12 % of the supply; encoder_eccentricity 0.005..0.05 rad (reads = angle); current_offset and current_gain 5..20 %
 (with measured voltage; for the gain all constants are stated to 0.5 % or 1 %); control_delay 2..8 ms with [rig.controller] stated.
 Not covered: eccentricity, turn_short, commutation_offset (they need phases).

OUTSIDE LAWS: hardening_spring, one_sided_buffer, friction_grows_with_time, payload_taken_up, dwell_memory, linkage_inertia,
 eddy_brake, dragging_brake, friction_lags_speed, neighbour_machine, viscous_patch, inertial_load_friction, one_way_cogging,
 free_play_coupling, flux_creep, hose_relaxation, power_loss_gear, amplifier_dead_zone, torque_by_sign, one_way_drag, winding_fade.
 Each is defined where it is simulated (function `simulate`).

SELECTION.  Every contribution is summed inside the integrator while the rotor slips.  Signals are smoothed by a moving mean of
1/(2.5 f) where f holds 97 % of the drive's power or 90 % of the contribution's.  Kept if (1) rms >= 5 % of
the drive's; (2) after least squares on acceleration, speed, friction sign, constant (not for bias_torque; for two effects also the other's
contribution) >= 3 x the noise that the actual recording has in this band (current, plus inertia times the better of the two accelerations,
in the same smoothing), in the fit runs;
(3) >= 3 % rms in the held-out ones; (4) for one and two, no other listed effect (library of some 250 shapes on the true motion) alone brings
the rest below the noise; the nearest is named in the key.  Electrical and sensor effects are judged in their channel: 5 x its noise
 after retuning (encoder and delay: smoothed as above).  Effects that few rigs can show are drawn with 2.5 or 6 times the weight.
Outside: rest after the best pair of the library >= 3 x noise and >= 3 % of the drive.
"""
import argparse, json, math, os, sys, time
import numpy as np
from numba import njit
from scipy.ndimage import uniform_filter1d

CLASSES = ["nothing", "one", "two", "outside"]
TORQUE = ["stribeck", "lubricated_rise", "quadratic_drag", "viscous_asymmetry", "bias_torque", "load_dependent_friction",
          "temperature_dependent_friction", "periodic_friction", "tight_spot", "presliding", "cogging", "torque_ripple",
          "torque_saturation", "spring_load", "compliance"]
CHANNEL = ["backlash", "winding_heating", "supply_sag", "dead_time", "encoder_eccentricity", "current_offset", "current_gain",
           "control_delay"]
EFFECTS = TORQUE + CHANNEL
LAWS = ["hardening_spring", "one_sided_buffer", "friction_grows_with_time", "payload_taken_up", "dwell_memory", "linkage_inertia",
        "eddy_brake", "dragging_brake", "friction_lags_speed", "neighbour_machine", "viscous_patch", "inertial_load_friction",
        "one_way_cogging", "free_play_coupling", "flux_creep", "hose_relaxation", "power_loss_gear", "amplifier_dead_zone",
        "torque_by_sign", "one_way_drag", "winding_fade"]
CODE = {n: k + 1 for k, n in enumerate(EFFECTS)}
CODE.update({n: 101 + k for k, n in enumerate(LAWS)})
NOUT = 20
(O_TH, O_W, O_I, O_U, O_USER, O_W2, O_MI, O_MV, O_MW, O_MT, O_MF, O_SLIP, O_SGN, O_MDC, O_C1, O_C2, O_MLOAD, O_MTEMP, O_MTH, O_MU) = range(NOUT)


@njit(cache=True)
def lin(g, t, dt):
    x = t / dt
    k = int(x)
    if k >= g.size - 1:
        return g[g.size - 1]
    return g[k] + (x - k) * (g[k + 1] - g[k])


@njit(cache=True)
def simulate(h, idx, gp, gv, ga, gu, gl, gt, dtg, m, c, e1, p1, e2, p2, x0):
    """m machine: J C Fc kt R L tau ilim vs weight travel_mid; c controller; (e, p) code and parameters of up to two effects."""
    J, C, Fc, kt, R, L, tau, ilim, vs, weight = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9]
    elec, mode = int(c[0]), int(c[1])
    kp, kv, ki, ffv, ffa, wlim, ulim = c[2], c[3], c[4], c[5], c[6], c[7], c[8]
    Tc, res, own, tf, ckp, cki = c[9], c[10], int(c[11]), c[12], c[13], c[14]
    n = idx.size
    out = np.zeros((n, NOUT))
    en = np.zeros(6)
    th, w, i, v, u = x0, 0.0, 0.0, 0.0, 0.0
    th2, w2, z, user = x0, 0.0, 0.0, x0
    s1, s2, s3 = np.zeros(2), np.zeros(2), np.zeros(2)      # states of the laws
    integ, cint, wf, qold = 0.0, 0.0, 0.0, x0
    nc = max(1, int(round(Tc / h)))
    ring = np.zeros(1)
    dl = 0
    ecc_a = ecc_p = 0.0
    cpl = 0.0
    Jl = ks = ds = 0.0
    pre = False
    sig = sdm = 0.0
    gap = 0.0
    Rx = R
    dt_v = 0.0
    sag = 0.0
    play = 0.0
    for q in range(2):
        e = e1 if q == 0 else e2
        p = p1 if q == 0 else p2
        if e == 23:
            dl = int(round(p[0] / h))
            ring = np.zeros(max(dl, 1))
        elif e == 20:
            ecc_a, ecc_p = p[0], p[1]
        elif e == 15 or e == 114:
            ks, ds, Jl = p[0], p[1], p[2]
            if e == 114:
                play = p[3]
        elif e == 10:
            pre = True
            sig, sdm = p[0], p[1]
        elif e == 16:
            gap = p[0]
        elif e == 17:
            Rx = R * (1 + 0.00393 * p[0])
        elif e == 19:
            dt_v = p[0]
        elif e == 18:
            sag = p[0]
    Jm = J - Jl
    ek = 1 - math.exp(-h / tau) if tau > 0 else 1.0
    s = 0
    for k in range(n):
        a = np.zeros(NOUT)
        cnt = 0
        while s < idx[k]:
            t = s * h
            # controller
            if s % nc == 0:
                thm = th + ecc_a * math.sin(th + ecc_p)
                if res > 0:
                    thm = res * math.floor(thm / res + 0.5)
                if own == 1:
                    wm = w
                else:
                    wf += (1 - math.exp(-Tc / tf)) * ((thm - qold) / Tc - wf)
                    wm = wf
                qold = thm
                wr = lin(gv, t, dtg)
                if mode == 2:
                    wr = ffv * wr + kp * (lin(gp, t, dtg) - thm)
                    wr = min(max(wr, -wlim), wlim)
                u = lin(gu, t, dtg) + kv * (wr - wm) + ki * integ + ffa * lin(ga, t, dtg)
                if abs(u) < ulim or u * (wr - wm) < 0:
                    integ += Tc * (wr - wm)
                u = min(max(u, -ulim), ulim)
            ud = u
            if dl > 0:
                ud = ring[s % dl]
                ring[s % dl] = u
            # electrical
            fl = 1.0
            bemf = kt * w
            for q in range(2):
                if (e1 if q == 0 else e2) == 12:
                    p = p1 if q == 0 else p2
                    bemf *= 1 + p[0] * math.cos(p[2] * th + p[1])
            if elec == 0:
                i += ek * (ud - i)
                v = Rx * i + bemf
            else:
                if elec == 1:
                    er = ud - i
                    v = ckp * er + cki * cint + kt * w
                    if abs(v) < vs:
                        cint += h * er
                    v = min(max(v, -vs), vs)
                else:
                    v = min(max(ud, -vs), vs)
                b = i + h / L * (v - bemf)
                i = b / (1 + h * Rx / L)
                if dt_v > 0:                       # implicit, by halving
                    lo, hi = min(0.0, i), max(0.0, i)
                    for _ in range(40):
                        mid = 0.5 * (lo + hi)
                        if mid * (1 + h * Rx / L) + h / L * dt_v * math.tanh(mid / 0.05) > b:
                            hi = mid
                        else:
                            lo = mid
                    i = 0.5 * (lo + hi)
            vdc = vs
            if sag > 0:
                vdc = vs - sag * v * i / vs
                vdc = vs - sag * v * i / vdc
            ld = lin(gl, t, dtg)
            tp = lin(gt, t, dtg)
            sgw = 1.0 if w > 0 else (-1.0 if w < 0 else 0.0)
            Tm = kt * i
            F = Fc
            Cx = C
            X = 0.0            # further smooth torque on the resisting side
            Jx = Jm
            ce = np.zeros(2)
            fr = np.zeros(2)   # share of dry friction, contribution = fr * friction sign
            for q in range(2):
                e = e1 if q == 0 else e2
                p = p1 if q == 0 else p2
                if e == 0:
                    continue
                aw = abs(w)
                if e == 1:
                    fr[q] = p[0] * math.exp(-(aw / p[1]) ** p[2])
                elif e == 2:
                    fr[q] = p[0] * (1 - math.exp(-aw / p[1]))
                elif e == 3:
                    ce[q] = p[0] * w * aw
                elif e == 4:
                    ce[q] = p[0] * aw
                elif e == 5:
                    ce[q] = p[0]
                elif e == 6:
                    fr[q] = p[0] * abs(ld)
                elif e == 7:
                    fr[q] = Fc * p[0] * (tp - 20)
                    ce[q] = C * p[0] * (tp - 20) * w
                elif e == 8:
                    fr[q] = p[0] * math.cos(p[2] * th + p[1])
                elif e == 9:
                    fr[q] = p[0] * math.exp(-((th - p[1]) / p[2]) ** 2)
                elif e == 11:
                    ce[q] = p[0] * math.cos(p[2] * th + p[1])
                elif e == 12:
                    ce[q] = -kt * i * p[0] * math.cos(p[2] * th + p[1])
                elif e == 13:
                    ce[q] = kt * i * p[0] * abs(i)
                elif e == 14:
                    ce[q] = p[0] * (th - p[1])
                # ---- laws outside the list
                elif e == 101:    # k (x - x0)^3
                    ce[q] = p[0] * (th - p[1]) ** 3
                elif e == 102:    # rubber stop: k y + d y', y = x - x1 > 0, never pulling
                    y = th - p[1]
                    if y > 0:
                        ce[q] = max(0.0, p[0] * y + p[2] * w)
                elif e == 103:    # dry friction creeps up with the run's time: A t / 10 s
                    fr[q] = p[0] * t / 10
                elif e == 104:    # payload dJ carried from t1 to t2 of every period: taken up at rest or in motion
                    if (t % p[1]) > p[2]:
                        Jx += p[0]
                elif e == 105:    # break-away grows with the dwell: A log(1+td/t0) while slipped way < D, decays exp(-way/D)
                    if w == 0:
                        s1[q] += h
                        s2[q] = 0.0
                    else:
                        s2[q] += h * aw
                        if s2[q] > 6 * p[2]:
                            s1[q] = 0.0
                    fr[q] = p[0] * math.log(1 + s1[q] / p[1]) * math.exp(-s2[q] / p[2])
                elif e == 106:    # slider crank: J(th) = J (1 + e cos(2 th + f)), with w^2 J'/2
                    dJ = J * p[0] * math.cos(2 * th + p[1])
                    Jx += dJ
                    ce[q] = -J * p[0] * math.sin(2 * th + p[1]) * w * w
                elif e == 107:    # eddy brake past its peak: 2 T (w/wk) / (1 + (w/wk)^2)
                    ce[q] = 2 * p[0] * (w / p[1]) / (1 + (w / p[1]) ** 2)
                elif e == 108:    # holding brake drags now and then
                    if (t + p[3]) % p[1] < p[2]:
                        fr[q] = p[0]
                elif e == 109:    # Stribeck film with memory: friction by the speed of a lag before
                    s1[q] += h / p[2] * (aw - s1[q])
                    fr[q] = p[0] * math.exp(-s1[q] / p[1])
                elif e == 110:    # shaking table: A sin(2 pi f t + g)
                    ce[q] = p[0] * math.sin(6.283185307179586 * p[1] * t + p[2])
                elif e == 111:    # grease on a part of the travel: C' w / (1 + exp(-(x - x1)/b))
                    ce[q] = p[0] * w / (1 + math.exp(-(th - p[1]) / p[2]))
                elif e == 112:    # guide loaded by the inertial force of an overhung slide: m |a| sgn w, a filtered over 5 ms
                    fr[q] = p[0] * J * abs(s1[q])
                elif e == 113:    # pawl: A (1 + cos(n th + f)) when running forward only
                    if w > 0:
                        ce[q] = p[0] * (1 + math.cos(p[2] * th + p[1]))
                elif e == 115:    # flux creep: a part f of the torque follows the current with a lag
                    s1[q] += h / p[1] * (i - s1[q])
                    ce[q] = kt * p[0] * (i - s1[q])
                elif e == 116:    # hose, cable chain: Maxwell element k, relaxation time
                    s1[q] += h * (w - s1[q] / p[1])
                    ce[q] = p[0] * s1[q]
                elif e == 117:    # worm gear: loss p0 |T| driving, p1 |T| driven
                    fr[q] = (p[0] if i * w > 0 else p[1]) * abs(kt * i)
                elif e == 118:    # amplifier's dead zone of current
                    ce[q] = kt * min(max(i, -p[0]), p[0])
                elif e == 119:    # torque constant differs by the current's sign
                    ce[q] = -kt * p[0] * abs(i)
                elif e == 120:    # check valve: c w^2 forward only
                    if w > 0:
                        ce[q] = p[0] * w * w
                elif e == 121:    # magnets fade with dissipated heat: kt (1 - f q), q' = (i/i0)^2/tq - q/tq
                    s1[q] += h / p[1] * ((i / p[2]) ** 2 - s1[q])
                    ce[q] = kt * i * p[0] * min(s1[q], 1.5)
                X += ce[q]
                F += fr[q]
            if F < 0:
                F = 0.0
            N = Tm - Cx * w - ld - weight - X
            cpl = 0.0
            if Jl > 0:
                y = th - th2
                if play > 0:
                    y = y - play if y > play else (y + play if y < -play else 0.0)
                cpl = ks * y
                if play == 0 or y != 0.0:
                    cpl += ds * (w - w2)
                N -= cpl
            w0 = w
            if pre:
                # Dahl: z' = w - |w| sig z / F ; torque sig z + damping z'
                zn = (z + h * w) / (1 + h * abs(w) * sig / max(F, 1e-12))
                Ff = sig * zn + sdm * (zn - z) / h
                z = zn
                w = w + h / Jx * (N - Ff)
                slip = 1.0
                sg = sgw
            else:
                ws = w + h / Jx * N
                lim = h * F / Jx
                if abs(ws) <= lim:
                    w = 0.0
                    Ff = ws * Jx / h
                    slip = 0.0
                    sg = 0.0
                else:
                    sg = 1.0 if ws > 0 else -1.0
                    w = ws - sg * lim
                    Ff = sg * F
                    slip = 1.0
            acc = (w - w0) / h
            for q in range(2):
                e = e1 if q == 0 else e2
                p = p1 if q == 0 else p2
                if e == 112:
                    s1[q] += h / 0.005 * (acc - s1[q])
            wmid = 0.5 * (w + w0)
            if Jl > 0:
                w2 += h * cpl / Jl
                th2 += h * w2
            th += h * w
            if gap > 0:
                if th - user > gap / 2:
                    user = th - gap / 2
                elif th - user < -gap / 2:
                    user = th + gap / 2
            else:
                user = th
            # energy: supplied, dissipated in the plain terms, taken by effects, kinetic of motor
            en[0] += h * Tm * wmid
            en[1] += h * (Cx * w0 + Ff) * wmid
            en[2] += h * (X + ld + weight) * wmid
            en[3] += h * cpl * wmid
            en[4] += h * (Jx * acc) * wmid
            for q in range(2):
                e = e1 if q == 0 else e2
                p = p1 if q == 0 else p2
                if e == 0:
                    continue
                x = (ce[q] + fr[q] * sg) * slip
                if e == 10:
                    x = Ff - F * sg
                elif e == 15 or e == 114:
                    x = (cpl - Jl * acc) * slip
                elif e == 104:
                    x = ((Jx - Jm) * acc) * slip
                elif e == 106:
                    x = ((Jx - Jm) * acc + ce[q]) * slip
                elif e == 17:
                    x = (Rx - R) * i
                elif e == 19:
                    x = dt_v * math.tanh(i / 0.05)
                elif e == 18:
                    x = vdc - vs
                elif e == 23:
                    x = ud - u
                if q == 0:
                    a[O_C1] += x
                else:
                    a[O_C2] += x
            a[O_MI] += i
            a[O_MV] += v
            a[O_MW] += w
            a[O_MT] += Tm
            a[O_MF] += Ff
            a[O_SLIP] += slip
            a[O_SGN] += sg
            a[O_MDC] += vdc
            a[O_MLOAD] += ld
            a[O_MTEMP] += tp
            a[O_MTH] += th
            a[O_MU] += u
            cnt += 1
            s += 1
        for j in range(NOUT):
            out[k, j] = a[j] / max(cnt, 1)
        out[k, O_TH], out[k, O_W], out[k, O_I], out[k, O_U], out[k, O_USER], out[k, O_W2] = th, w, i, u, user, w2
        if not (abs(w) < 1e5):
            break
    en[5] = 0.5 * Jm * w * w
    return out, en


# ------------------------------------------------------------------ rigs
def logu(r, a, b):
    return float(math.exp(r.uniform(math.log(a), math.log(b))))


def pick(r, seq, p=None):
    return seq[int(r.choice(len(seq), p=p))]


def make_rig(r):
    g = {}
    g["kind_rig"] = k = pick(r, ["direct", "geared", "spindle", "screw", "vertical", "belt"], [.26, .22, .08, .18, .1, .16])
    linear = k in ("screw", "vertical", "belt")
    g["linear"] = linear
    g["lead"] = logu(r, .0025, .02) if k in ("screw", "vertical") else (logu(r, .08, .25) if linear else 0.0)
    w0 = {"direct": logu(r, 8, 120), "geared": logu(r, 40, 250), "spindle": logu(r, 60, 300), "screw": logu(r, 40, 200),
          "vertical": logu(r, 40, 160), "belt": logu(r, 15, 70)}[k]
    ta = logu(r, .06, .4)
    isc, load = logu(r, 1, 12), r.uniform(.4, .6)           # the scales of current and speed and the supply give the machine's size
    vs = float(pick(r, [v for v in (12, 24, 48, 80, 160, 300) if .015 <= load * v / w0 <= 1.2]))
    fd, fv, fw = r.uniform(.15, .8), r.uniform(.05, .45), (r.uniform(.3, .7) if k == "vertical" else 0.0)
    Tj = load * vs / w0 * isc / ((1 + fd + fv) * (1 + fw))
    J, Fc, C = Tj * ta / w0, Tj * fd, Tj * fv / w0
    g.update(w0=w0, ta=ta, J=J, Fc=Fc, C=C, Tj=Tj, Tsc=Tj + Fc + C * w0)
    g["weight"] = g["Tsc"] * fw
    g["isc"], g["vs"] = isc, vs
    g["kt"] = (g["Tsc"] + g["weight"]) / isc
    g["R"] = r.uniform(.12, .3) * g["vs"] / isc
    g["L"] = g["R"] * r.uniform(.001, .004)
    g["travel"] = w0 * r.uniform(.5, 2.5) if linear or r.random() < .3 else 0.0      # 0: endless
    if k == "spindle":
        g["travel"] = 0.0
    d = pick(r, ["current", "volts_in", "torque", "loop", "dcvolt"], [.3, .08, .12, .3, .2])
    if k == "vertical" and d == "dcvolt":
        d = "loop"
    g["drive"] = d
    g["elec"] = {"loop": 1, "dcvolt": 2}.get(d, 0)
    g["tau"] = r.uniform(.0003, .0012)
    g["has_v"] = d in ("loop", "dcvolt")
    g["ilim"] = isc * r.uniform(1.6, 3.0)
    g["rate"] = float(pick(r, [200, 250, 500, 1000, 2000, 4000, 5000, 10000], [.08, .08, .17, .27, .17, .08, .08, .07]))
    g["sensors"] = pick(r, ["both", "position", "velocity"], [.55, .35, .1])
    counts = pick(r, [1024, 4096, 10000, 20000, 65536, 2 ** 17, 2 ** 20], [.06, .14, .2, .2, .2, .1, .1])
    g["res"] = 2 * math.pi / counts
    g["opened"] = bool(k in ("direct", "screw", "belt") and d in ("current", "loop") and g["sensors"] == "both" and r.random() < .6)
    if g["opened"]:
        g["drive"] = d = "current"
        g["elec"], g["has_v"] = 0, False
    g["tacho"] = bool(g["sensors"] != "position" and (r.random() < .8 or g["sensors"] == "velocity" or g["opened"]))
    if g["sensors"] == "both" and not g["tacho"]:
        g["sensors"] = "position"
    g["load_machine"] = bool(k in ("direct", "geared", "spindle") and d != "dcvolt" and r.random() < .4)
    g["thermo"] = bool(r.random() < .3)
    g["vdc"] = bool(g["has_v"] and r.random() < .6)
    g["user"] = bool(k == "geared" and g["sensors"] != "velocity" and r.random() < .75)
    g["gear"] = float(pick(r, [5, 10, 16, 25, 50])) if k == "geared" else 1.0
    g["off_record"] = bool(r.random() < .15 and d in ("current", "loop") and not g["opened"])
    return g


def smove(d, w, acc, dtg, jerk):
    """speed profile of one move by d with limits w, acc; S-shaped by a moving mean of `jerk` s."""
    sgn, d = math.copysign(1, d), abs(d)
    w = min(w, math.sqrt(d * acc))
    T1, T = w / acc, d / w
    n = max(4, int(math.ceil((T + T1) / dtg)))
    t = (np.arange(n) + .5) * dtg
    v = np.minimum(np.minimum(t * acc, w), np.maximum(0, (T + T1 - t) * acc))
    v *= d / (v.sum() * dtg)
    m = max(1, int(jerk / dtg))
    v = np.convolve(v, np.ones(m) / m)
    return sgn * v


def motion(r, g, fam, dur, amp, dtg=1e-3):
    """reference speed (1 kHz grid) and feed-forward drive; returns mode, pos, vel, acc, u"""
    n = int(dur / dtg) + 2
    w0, tr = g["w0"] * amp, (g["travel"] or g["w0"] * 1.5)
    acc = g["w0"] / g["ta"]
    half = tr / 2
    v, u = [], np.zeros(n)
    mode = 2
    if fam in ("moves", "pick", "strokes"):
        x, tot = 0.0, 0
        st = r.uniform(-half, half, size=4)
        spd = r.uniform(.4, 1, size=4)
        wv = [.06, .12, .25, .5, .8, 1.0]
        k = 0
        while tot < n:
            if fam == "moves":
                tgt, sp, dw, jk = r.uniform(-half, half), r.uniform(.15, 1), r.uniform(.03, .4), .02
            elif fam == "pick":
                tgt, sp, dw, jk = st[k % 4], spd[k % 4], .12 + .1 * (k % 2), .03
            else:
                sp = wv[(k // 2) % 6]
                tgt, dw, jk = (half if k % 2 == 0 else -half) * min(1, .15 + sp * 1.2), .05, .01
            if abs(tgt - x) < .01 * tr:
                tgt = x + .1 * tr * (1 if x < 0 else -1)
            p = smove(tgt - x, max(sp * w0, .03 * g["w0"]), acc * r.uniform(.6, 1) if fam == "moves" else acc, dtg, jk)
            x += p.sum() * dtg
            v += [p, np.zeros(int(dw / dtg))]
            tot += p.size + int(dw / dtg)
            k += 1
        v = np.concatenate(v)[:n]
    elif fam == "chirp":
        t = np.arange(n) * dtg
        f0, f1 = .15, r.uniform(3, 10)
        per = min(dur, 12.0)
        tt = t % per
        ph = 2 * np.pi * f0 * per / math.log(f1 / f0) * (np.exp(tt / per * math.log(f1 / f0)) - 1)
        f = f0 * (f1 / f0) ** (tt / per)
        A = np.minimum(w0, np.minimum(half * 2 * np.pi * f, acc / (2 * np.pi * f)))
        v = A * np.sin(ph)
        mode = 1
        if g["travel"] or g["opened"]:
            mode = 2
    elif fam == "jog":
        t = np.arange(n) * dtg
        v = np.zeros(n)
        tc = r.uniform(.1, .5)
        x = 0.0
        while tc < dur:
            L = r.uniform(.2, 1.6)
            A = r.uniform(.08, 1) * w0
            s = (1 if x < 0 else -1) if r.random() < .75 else (1 if r.random() < .5 else -1)
            if g["travel"]:
                A = min(A, (half - s * x) / L * 1.8)
            m = (t > tc) & (t < tc + L)
            v[m] += s * A * np.sin(np.pi * (t[m] - tc) / L) ** 2
            x += s * A * L / 2
            tc += L + (r.uniform(0, .5) if r.random() < .5 else 0)
    elif fam in ("plateaus", "spindle", "prs"):
        mode = 1
        v = np.zeros(n)
        t0, cur = 0, 0.0
        while t0 < n:
            if fam == "prs":
                tgt, L = r.uniform(-1, 1) * w0, r.uniform(.12, .8)
            elif fam == "plateaus":
                tgt, L = pick(r, [-1, 1]) * w0 * pick(r, [.04, .1, .2, .4, .6, .8, 1]), r.uniform(.6, 1.6)
            else:
                tgt, L = w0 * r.uniform(.08, 1), r.uniform(.5, 2)
            k = max(1, int(abs(tgt - cur) / acc / dtg))
            e = min(n, t0 + k)
            v[t0:e] = cur + (tgt - cur) * (np.arange(e - t0) + 1) / k
            e2 = min(n, e + int(L / dtg))
            v[e:e2] = tgt
            cur, t0 = tgt, e2
    elif fam == "prbs":
        mode = 3
        v = np.zeros(n)
        t0 = 0
        lv = g["Tsc"] / g["kt"] * amp
        if g["elec"] == 2:
            lv = g["kt"] * g["w0"] * amp + g["R"] * g["Fc"] / g["kt"]
        while t0 < n:
            e = min(n, t0 + int(r.uniform(.05, .5) / dtg))
            u[t0:e] = pick(r, [-1, 1]) * lv * r.uniform(.4, 1.1)
            t0 = e
    v = np.asarray(v)[:n]
    a = np.gradient(v, dtg)
    p = np.concatenate([[0], np.cumsum(.5 * (v[1:] + v[:-1]) * dtg)])
    return mode, p, v, a, u


def draw_effect(r, name, g):
    """parameters in the kernel's order"""
    s = r.uniform(.06, .35) * g["Tsc"]
    w0, Fc = g["w0"], g["Fc"]
    tr = g["travel"] or 1.5 * w0
    ph = r.uniform(-np.pi, np.pi)
    sg = pick(r, [-1, 1])
    fmax = .2 * g["rate"]
    orders = [o for o in (2, 3, 4, 6, 7, 8, 12, 14, 24) if o * w0 / 6.28 < fmax] or [1]
    T = {"stribeck": lambda: [r.uniform(.35, 1) * Fc, w0 * r.uniform(.03, .2), pick(r, [1.0, 1.0, 1.5, 2.0])],
         "lubricated_rise": lambda: [2 * s, w0 * r.uniform(.06, .3)],
         "quadratic_drag": lambda: [s * r.uniform(1, 2.5) / w0 ** 2],
         "viscous_asymmetry": lambda: [sg * s * 1.5 / w0],
         "bias_torque": lambda: [sg * s],
         "load_dependent_friction": lambda: [r.uniform(.1, .35)],
         "temperature_dependent_friction": lambda: [-r.uniform(.006, .018)],
         "periodic_friction": lambda: [r.uniform(.35, .85) * Fc, ph, float(pick(r, [1, 1, 2, 3]))],
         "tight_spot": lambda: [r.uniform(1, 3) * Fc, r.uniform(-.3, .3) * tr, r.uniform(.04, .15) * tr],
         "presliding": lambda: (lambda k: [k, 2 * r.uniform(.1, .7) * math.sqrt(k * g["J"])])(Fc / (r.uniform(.01, .06) * tr)),
         "cogging": lambda: [s * 1.3, ph, float(pick(r, orders))],
         "torque_ripple": lambda: [r.uniform(.06, .25), ph, float(pick(r, [1] + orders))],
         "torque_saturation": lambda: [r.uniform(.1, .35) / g["isc"]],
         "spring_load": lambda: [s / (tr / 2), r.uniform(-.15, .15) * tr],
         "compliance": lambda: (lambda Jl, f: [Jl * (6.283 * f) ** 2, 2 * r.uniform(.02, .1) * 6.283 * f * Jl, Jl])(
             g["J"] * r.uniform(.3, .7), logu(r, 4, 22)),
         "backlash": lambda: [logu(r, .03, .6)],
         "winding_heating": lambda: [r.uniform(30, 90)],
         "supply_sag": lambda: [r.uniform(.04, .15) * g["vs"] / g["isc"]],
         "dead_time": lambda: [r.uniform(.04, .12) * g["vs"]],
         "encoder_eccentricity": lambda: [logu(r, .005, .05), ph],
         "current_offset": lambda: [sg * r.uniform(.05, .2) * g["isc"]],
         "current_gain": lambda: [sg * r.uniform(.06, .2)],
         "control_delay": lambda: [r.uniform(.002, .008)],
         "hardening_spring": lambda: [s * 2.5 / (tr / 2) ** 3, r.uniform(-.1, .1) * tr],
         "one_sided_buffer": lambda: (lambda k: [k, r.uniform(0, .3) * tr, .1 * math.sqrt(k * g["J"])])(5 * s / (.2 * tr)),
         "friction_grows_with_time": lambda: [Fc * r.uniform(.15, .5)],
         "payload_taken_up": lambda: (lambda P: [g["J"] * r.uniform(.25, .9), P, P * r.uniform(.3, .7)])(r.uniform(2.5, 6)),
         "dwell_memory": lambda: [Fc * r.uniform(.5, 1), r.uniform(.01, .06), r.uniform(.03, .2) * tr],
         "linkage_inertia": lambda: [r.uniform(.2, .6), ph],
         "eddy_brake": lambda: [s * 2, w0 * r.uniform(.12, .35)],
         "dragging_brake": lambda: (lambda P: [r.uniform(.6, 1.5) * Fc, P, P * r.uniform(.2, .5), P * r.random()])(r.uniform(1.7, 5)),
         "friction_lags_speed": lambda: [r.uniform(.7, 1.3) * Fc, w0 * r.uniform(.1, .3), r.uniform(.05, .25)],
         "neighbour_machine": lambda: [s, logu(r, 2, 14), ph],
         "viscous_patch": lambda: [s * 2 / w0, r.uniform(-.2, .2) * tr, .03 * tr],
         "inertial_load_friction": lambda: [r.uniform(.25, .6)],
         "one_way_cogging": lambda: [s, ph, float(pick(r, orders))],
         "free_play_coupling": lambda: (lambda Jl, f: [Jl * (6.283 * f) ** 2, .2 * 6.283 * f * Jl, Jl, logu(r, .05, .5)])(
             g["J"] * r.uniform(.35, .65), logu(r, 10, 35)),
         "flux_creep": lambda: [r.uniform(.15, .4), r.uniform(.04, .25)],
         "hose_relaxation": lambda: (lambda tq: [3 * s / (w0 * min(tq, .5)), tq])(logu(r, .1, 1.5)),
         "power_loss_gear": lambda: [r.uniform(.15, .3), r.uniform(.4, .7)],
         "amplifier_dead_zone": lambda: [r.uniform(.06, .2) * g["isc"]],
         "torque_by_sign": lambda: [sg * r.uniform(.06, .2)],
         "one_way_drag": lambda: [s * r.uniform(1.2, 2.5) / w0 ** 2],
         "winding_fade": lambda: [r.uniform(.15, .35), r.uniform(1, 6), g["isc"] * .6]}
    return [float(x) for x in T[name]()]


PAR = {"stribeck": ["torque", "speed", "exponent"], "lubricated_rise": ["torque", "speed"], "quadratic_drag": ["coefficient"],
       "viscous_asymmetry": ["coefficient"], "bias_torque": ["torque"], "load_dependent_friction": ["coefficient"],
       "temperature_dependent_friction": ["coefficient"], "periodic_friction": ["amplitude", "phase", "order"],
       "tight_spot": ["torque", "centre", "width"], "presliding": ["stiffness", "damping"], "cogging": ["amplitude", "phase", "order"],
       "torque_ripple": ["fraction", "phase", "order"], "torque_saturation": ["coefficient"], "spring_load": ["stiffness", "rest"],
       "compliance": ["stiffness", "damping", "inertia"], "backlash": ["gap"], "winding_heating": ["delta_t"],
       "supply_sag": ["resistance"], "dead_time": ["voltage"], "encoder_eccentricity": ["amplitude", "phase"],
       "current_offset": ["current"], "current_gain": ["gain"], "control_delay": ["delay"]}


def possible(name, g):
    d, pos = g["drive"], g["sensors"] != "velocity"
    one_way = g["kind_rig"] == "spindle"
    if name in ("periodic_friction", "cogging", "torque_ripple", "spring_load", "tight_spot", "encoder_eccentricity") and not pos:
        return False
    if name in ("tight_spot", "spring_load", "presliding") and not g["travel"]:
        return False
    if name == "presliding" and g["res"] > .003:
        return False
    if name in ("viscous_asymmetry", "presliding") and one_way:
        return False
    if name == "bias_torque" and (g["weight"] or one_way):
        return False
    if name in ("torque_ripple", "torque_saturation"):
        return d in ("current", "loop", "dcvolt", "volts_in") and not (name == "torque_ripple" and d == "volts_in")
    return {"load_dependent_friction": g["load_machine"], "temperature_dependent_friction": g["thermo"], "backlash": g["user"],
            "winding_heating": g["has_v"], "supply_sag": g["vdc"], "dead_time": g["has_v"], "encoder_eccentricity": not g["linear"],
            "current_offset": g["has_v"] and not g["off_record"], "current_gain": g["has_v"],
            "control_delay": g["opened"]}.get(name, True)


def possible_law(name, g):
    pos, d = g["sensors"] != "velocity", g["drive"]
    if name in ("hardening_spring", "one_sided_buffer", "viscous_patch") and not (g["travel"] and pos):
        return False
    if name in ("linkage_inertia", "one_way_cogging") and not pos:
        return False
    if name in ("flux_creep", "amplifier_dead_zone", "torque_by_sign", "winding_fade") and d == "torque":
        return False
    if name in ("power_loss_gear",) and g["kind_rig"] not in ("geared", "screw"):
        return False
    if name in ("torque_by_sign", "one_way_drag", "one_way_cogging", "viscous_patch", "amplifier_dead_zone") and g["kind_rig"] == "spindle":
        return False
    return True


def plan(r, g):
    """runs, their motions, roles; controller gains"""
    k = g["kind_rig"]
    if k == "spindle":
        fams = ["spindle"]
    elif g["travel"] or g["opened"]:
        fams = ["moves", "pick", "strokes", "chirp", "jog"]
    else:
        fams = ["moves", "pick", "strokes", "chirp", "jog", "plateaus", "prs", "plateaus", "prs"] + (["prbs"] if k != "vertical" else [])
    if not g["travel"] and g["drive"] == "dcvolt":
        fams = [f for f in fams if f not in ("pick",)]
    main = pick(r, fams)
    nfit, nsel, nhel = pick(r, [1, 2, 2, 3]), int(r.random() < .25), pick(r, [1, 1, 2])
    if nfit + nsel + nhel > 5:
        nsel = 0
    dur = min(pick(r, [8, 12, 20, 30, 45, 60]), max(5, 60000 / g["rate"]))
    one_file = nfit == 1 and nhel == 1 and not nsel and dur * g["rate"] <= 40000 and dur >= 20 and r.random() < .5
    runs = []
    n = 1 if one_file else nfit + nsel + nhel
    if k != "spindle" and main in ("plateaus", "pick", "spindle") and nfit == 1 and r.random() < .6 and not one_file:
        nfit, n = 2, n + 1
    for j in range(n):
        role = "fit" if j < nfit else ("select" if j < nfit + nsel else "heldout")
        if one_file:
            role = "both"
        fam = main if j == 0 or r.random() < .45 else pick(r, fams)
        day = j > 0 and r.random() < .4
        runs.append(dict(role=role, fam=fam, dur=float(dur), amp=1.0 if j == 0 else float(r.uniform(.6, 1.1)),
                         fday=1 + (float(r.choice([-1, 1]) * r.uniform(.005, .025)) if day else 0.0),
                         cday=1 + (float(r.choice([-1, 1]) * r.uniform(.005, .025)) if day else 0.0)))
    bw = 2 * np.pi * r.uniform(6, 22)
    unit = g["J"] / g["kt"]
    if g["elec"] == 2:
        unit *= g["R"] * 1.0
    ctl = dict(kv=bw * unit, ki=bw * unit * bw * r.uniform(.04, .2), kp=bw * r.uniform(.1, .22), ffv=float(r.random() < .6),
               ffa=unit * float(r.choice([0, 0, .8])), Tc=pick(r, [2.5e-4, 5e-4, 1e-3]), tf=r.uniform(.001, .003), bw=bw)
    if g["opened"]:
        ctl.update(ffv=0.0, ffa=0.0, ki=0.0 if r.random() < .5 else ctl["ki"])
        ctl["Tc"] = 1 / max(1000.0, min(4000.0, g["rate"]))
    return runs, ctl, one_file


def run_sim(r, g, ctl, run, eff, half=1):
    dtg = 1e-3
    dur, rate = run["dur"], g["rate"]
    if "grid" not in run:
        mode, p, v, a, u = motion(r, g, run["fam"], dur, run["amp"])
        n = p.size
        t = np.arange(n) * dtg
        ld = np.zeros(n)
        if g["load_machine"]:
            A, x = .8 * g["Tsc"], 0
            while x < n:
                e = x + int(r.uniform(.4, 2.5) / dtg)
                ld[x:e] = A * pick(r, [0, .3, .6, 1]) * (pick(r, [-1, 1]) if g["kind_rig"] != "spindle" else 1)
                x = e
            ld = uniform_filter1d(ld, 40)
        T0 = r.uniform(18, 32)
        tp = T0 + r.uniform(15, 32) * (1 - np.exp(-t / (dur * r.uniform(.25, .7)))) if g["thermo"] else np.full(n, 20.0)
        run["grid"] = (mode, p, v, a, u, ld, tp)
        nst = max(1, int(math.ceil(1 / rate / 5e-5)))
        if 1 / rate / nst > 2.5e-5 and g["elec"]:
            nst *= 2
        N = int(dur * rate)
        idx = (np.arange(N) + 1) * nst
        if g["jitter"]:
            idx = idx + r.integers(-int(nst * .3), int(nst * .3) + 1, N)
        run["h"], run["idx"] = 1 / rate / nst, np.maximum.accumulate(idx)
    mode, p, v, a, u, ld, tp = run["grid"]
    h, idx = run["h"] / half, run["idx"] * half
    m = np.array([g["J"], g["C"] * run["cday"], g["Fc"] * run["fday"], g["kt"], g["R"], g["L"], g["tau"], g["ilim"], g["vs"], g["weight"]])
    kv, ki, kp = ctl["kv"], ctl["ki"], ctl["kp"]
    if mode == 3:
        mode, kv, ki = 1, .05 * kv, 0.0
    if g["elec"] == 2:
        mode_ff = g["kt"]
        u = u + mode_ff * v
    c = np.array([g["elec"], mode, kp, kv, ki, ctl["ffv"], ctl["ffa"], 1.6 * g["w0"], g["vs"] if g["elec"] == 2 else g["ilim"], ctl["Tc"], g["res"],
                  float(g["tacho"]), ctl["tf"], g["L"] * 2000, g["R"] * 2000])
    es = [CODE[n] for n, _ in eff] + [0, 0]
    ps = [np.array(q + [0.0] * 5) for _, q in eff] + [np.zeros(6)] * 2
    return simulate(h, idx, p, v, a, u, ld, tp, dtg, m, c, es[0], ps[0], es[1], ps[1], 0.0)


# ------------------------------------------------------------------ recording
def sense(r, g, o, t, eff):
    """measured channels (SI at the motor) and their noise, beside the true ones"""
    E = dict(eff)
    n, rms = t.size, lambda x: float(np.sqrt(np.mean(x ** 2)) + 1e-12)
    rec, tru = {}, {}
    th = o[:, O_TH]
    if g["sensors"] != "velocity":
        ecc = E.get("encoder_eccentricity")
        x = th + (ecc[0] * np.sin(th + ecc[1]) if ecc else 0)
        tru["position"], rec["position"] = x, g["res"] * np.floor(x / g["res"] + .5)
    if g["tacho"]:
        x = o[:, O_MW] if g["wmean"] else o[:, O_W]
        tru["velocity"], rec["velocity"] = x, x + g["nw"] * g["w0"] * r.standard_normal(n)
    hum = lambda s: g["hum"] * s * math.sqrt(2) * np.sin(2 * np.pi * g["mains"] * t + r.uniform(0, 6))
    if g["drive"] == "torque":
        x, s = (o[:, O_MT] if g["imean"] else o[:, O_I] * g["kt"]), g["ni"] * g["kt"] * g["isc"]
        tru["torque"], rec["torque"] = x, x + s * r.standard_normal(n) + hum(s)
    else:
        x, s = (o[:, O_MI] if g["imean"] else o[:, O_I]), g["ni"] * g["isc"]
        x = x * (1 + E.get("current_gain", [0])[0]) + E.get("current_offset", [0])[0]
        tru["current"], rec["current"] = x, x + g["ioff"] + s * r.standard_normal(n) + hum(s)
    if g["has_v"]:
        s = g["nv"] * g["vs"]
        tru["voltage"], rec["voltage"] = o[:, O_MV], o[:, O_MV] + s * r.standard_normal(n) + hum(s)
    if g["vdc"]:
        tru["v_dc"], rec["v_dc"] = o[:, O_MDC], o[:, O_MDC] + .002 * g["vs"] * r.standard_normal(n)
    if g["load_machine"]:
        tru["load"], rec["load"] = o[:, O_MLOAD], o[:, O_MLOAD] + .004 * g["Tsc"] * r.standard_normal(n)
    if g["thermo"]:
        tru["temperature"], rec["temperature"] = o[:, O_MTEMP], np.round(o[:, O_MTEMP] + .05 * r.standard_normal(n), 1)
    if g["user"]:
        x = o[:, O_USER] / g["gear"]
        tru["user_position"], rec["user_position"] = x, g["ures"] * np.floor(x / g["ures"] + .5)
    return rec, tru


def lp(x, m):
    return uniform_filter1d(np.asarray(x, float), max(1, int(m)), axis=0, mode="nearest")


def band(x, rate, q):
    P = np.abs(np.fft.rfft(x - x.mean())) ** 2
    c = np.cumsum(P)
    return float(np.searchsorted(c, q * c[-1]) / x.size * rate) if c[-1] > 0 else 1.0


def rest(y, B):
    if B.shape[1] == 0:
        return y
    s = np.sqrt((B ** 2).mean(0)) + 1e-300
    q = np.linalg.lstsq(B / s, y, rcond=1e-9)[0]
    return y - (B / s) @ q


def rms(x):
    return float(np.sqrt(np.mean(np.asarray(x) ** 2)))


def gather(g, sims, m):
    """smoothed truth of all runs in one table"""
    cols = {k: [] for k in ("y", "a", "w", "s", "one", "c1", "c2", "n", "th", "i", "ld", "tp", "fd", "ff")}
    for run, o, rec, tru, t in sims:
        T = np.diff(t, prepend=t[0] - 1 / g["rate"])
        d = lambda x: np.diff(x, prepend=x[0]) / T
        slip = o[:, O_SLIP]
        if "torque" in rec:
            nt = rec["torque"] - tru["torque"]
        else:
            nt = g["kt"] * (rec["current"] - tru["current"] - g["ioff"])
        cand = []
        if g["tacho"]:
            cand.append(g["J"] * d(rec["velocity"] - tru["velocity"]))
        if "position" in rec:
            cand.append(g["J"] * d(d(rec["position"] - tru["position"])))
        na = min((lp(x, m) for x in cand), key=rms)
        f = lambda x: lp(x, m)
        for k, x in dict(y=o[:, O_MT] * slip, a=d(o[:, O_W]) * slip, w=o[:, O_MW], s=o[:, O_SGN], one=slip, c1=o[:, O_C1], c2=o[:, O_C2],
                         th=o[:, O_MTH], i=o[:, O_MI], ld=o[:, O_MLOAD], tp=o[:, O_MTEMP]).items():
            cols[k].append(f(x) if k not in ("th",) else x)
        cols["n"].append(f(nt) + na)
        cols["fd"].append(run)
    return {k: np.concatenate(v) for k, v in cols.items() if k not in ("fd", "ff")}


def library(g, D, raw):
    """listed effects as shapes on the true motion: (name, columns)"""
    w, s, th, i, a = raw["w"], raw["s"], raw["th"], raw["i"], raw["a"]
    w0, tr = g["w0"], (g["travel"] or 0)
    m = D["m"]
    f = lambda *x: np.stack([lp(q, m) for q in x], 1)
    lib = []
    for v in np.geomspace(.015, .6, 10) * w0:
        for e in (.7, 1, 1.5, 2):
            lib.append(("stribeck", f(s * np.exp(-(abs(w) / v) ** e))))
        lib.append(("lubricated_rise", f(s * (1 - np.exp(-abs(w) / v)))))
    lib += [("quadratic_drag", f(w * abs(w))), ("viscous_asymmetry", f(abs(w)))]
    if g["sensors"] != "velocity":
        for o in list(range(1, 15)) + [16, 18, 24]:
            lib.append(("cogging", f(np.cos(o * th) * raw["one"], np.sin(o * th) * raw["one"])))
            if o <= 4:
                lib.append(("periodic_friction", f(s * np.cos(o * th), s * np.sin(o * th))))
            if g["drive"] != "torque":
                lib.append(("torque_ripple", f(i * np.cos(o * th), i * np.sin(o * th))))
        lib.append(("spring_load", f((th - th.mean()) * raw["one"])))
        lo, hi = th.min(), th.max()
        if tr:
            for c in np.linspace(lo, hi, 14):
                for b in (.05, .12, .3):
                    lib.append(("tight_spot", f(s * np.exp(-((th - c) / (b * (hi - lo))) ** 2))))
    if g["drive"] != "torque":
        lib += [("torque_saturation", f(i * abs(i) * raw["one"])), ("torque_saturation", f(i ** 3 * raw["one"]))]
    if g["load_machine"]:
        lib.append(("load_dependent_friction", f(abs(raw["ld"]) * s)))
    if g["thermo"]:
        lib.append(("temperature_dependent_friction", f((raw["tp"] - 20) * s, (raw["tp"] - 20) * w)))
    for b in np.geomspace(.003, .1, 7) * (tr or 1.5 * w0):                 # bristles on the true motion
        lib.append(("presliding", f(dahl(w, raw["T"], b) - s)))
    for fr in np.geomspace(3, 40, 9):
        for ze in (.03, .1):
            lib.append(("compliance", f(resonance(a, raw["T"], 6.283 * fr, ze) - a)))
    return lib


@njit(cache=True)
def dahl(w, T, b):
    z = np.zeros(w.size)
    x = 0.0
    for k in range(w.size):
        d = w[k] * T[k] / b
        sg = 1.0 if d > 0 else -1.0
        x = sg + (x - sg) * math.exp(-abs(d))
        z[k] = x
    return z


@njit(cache=True)
def resonance(a, T, wn, ze):
    """acceleration of a mass on a spring whose base is accelerated by a"""
    y = np.zeros(a.size)
    x = v = 0.0
    for k in range(a.size):
        n = max(1, int(T[k] * wn * 20))
        h = T[k] / n
        q = 0.0
        for _ in range(n):
            f = -wn * wn * x - 2 * ze * wn * v
            v += h * (f - a[k])
            x += h * v
            q += f
        y[k] = q / n
    return y


def best_fits(y, base, lib, pairs):
    """rms of the rest of y for the best shape of each name, and for the best pair"""
    dec = max(1, y.size // 3000)
    yb, Bb = y[::dec], base[::dec]
    Q, _ = np.linalg.qr(Bb / (np.sqrt((Bb ** 2).mean(0)) + 1e-300))
    proj = lambda X, Q: X - Q @ (Q.T @ X)
    y0 = proj(yb, Q)
    Ls = []
    for nm, X in lib:
        Z = proj(X[::dec], Q)
        U, S, _ = np.linalg.svd(Z, full_matrices=False)
        keep = S > 1e-6 * (np.linalg.norm(X[::dec]) + 1e-300)
        if keep.any():
            Ls.append((nm, U[:, keep]))
    one = {}
    for nm, U in Ls:
        q = rms(y0 - U @ (U.T @ y0))
        if q < one.get(nm, 1e300):
            one[nm] = q
    two = min(one.values()) if one else rms(y0)
    if pairs and Ls:
        off = np.cumsum([0] + [u.shape[1] for _, u in Ls])
        A = np.concatenate([u for _, u in Ls], 1)
        for j, (nm, U) in enumerate(Ls):
            y1 = y0 - U @ (U.T @ y0)
            g1 = A.T @ y1
            G = A.T @ U                     # overlap of each with the first
            for k in range(j + 1, len(Ls)):
                s = slice(off[k], off[k + 1])
                M = np.eye(off[k + 1] - off[k]) - G[s] @ G[s].T
                if M.shape[0] == 1:
                    gain = g1[s][0] ** 2 / max(M[0, 0], 1e-6)
                else:
                    gain = float(g1[s] @ np.linalg.lstsq(M, g1[s], rcond=1e-6)[0])
                q = math.sqrt(max(0.0, (y1 @ y1 - gain) / y1.size))
                two = min(two, q)
    return one, two


def judge(g, sims, eff, cls):
    """selection rule; returns None or a dict of what was measured"""
    fit = [x for x in sims if x[0]["role"] in ("fit", "select", "both")]
    hel = [x for x in sims if x[0]["role"] in ("heldout", "both")]
    info = {}
    y0 = np.concatenate([x[1][:, O_MT] for x in fit])
    fb = band(y0, g["rate"], .97)
    for q, (name, par) in enumerate(eff):
        col = O_C1 + q
        c0 = np.concatenate([x[1][:, col] for x in fit])
        if name in CHANNEL:
            ok, snr = judge_channel(g, fit, name, par, col, [e for e in eff if e[0] != name])
            if not ok:
                return None
            info[name] = dict(over_noise=snr)
            continue
        f = min(max(fb, band(c0, g["rate"], .9), 2.0), g["rate"] / 2)
        m = max(1, g["rate"] / (2.5 * f))
        D = gather(g, fit, m)
        c, n = D["c%d" % (q + 1)], D["n"]
        act = D["one"] > .02
        if act.mean() < .2:
            return None
        yr, cr = rms(D["y"][act]), rms(c[act])
        if cr < .05 * yr:
            return None
        for s in hel:
            if rms(s[1][:, col]) < .03 * rms(s[1][:, O_MT]):
                return None
        B = [D["a"], D["w"], D["s"]] + ([] if name == "bias_torque" else [D["one"]])
        oth = [e for e in eff if e[0] != name and e[0] in TORQUE]
        if oth:
            B.append(D["c%d" % (2 - q)])
        B = np.stack(B, 1)
        rr, nn = rms(rest(c[act], B[act])), rms(n[act])
        if rr < 3 * nn:
            return None
        info[name] = dict(share=cr / yr, over_noise=rr / nn, band_hz=f)
        # others in its place
        raw = {k: np.concatenate([x[1][:, j] for x in fit]) for k, j in
               dict(w=O_MW, s=O_SGN, th=O_MTH, i=O_MI, ld=O_MLOAD, tp=O_MTEMP, one=O_SLIP).items()}
        raw["T"] = np.concatenate([np.diff(x[4], prepend=x[4][0] - 1 / g["rate"]) for x in fit])
        raw["a"] = np.concatenate([np.diff(x[1][:, O_W], prepend=0) for x in fit]) / raw["T"]
        D["m"] = m
        lib = [(k, X[act]) for k, X in library(g, D, raw) if k not in [e[0] for e in eff]]
        one, two = best_fits(c[act], B[act], lib, cls == "outside")
        near = sorted((v / nn, k) for k, v in one.items())
        info[name]["nearest_listed"] = [[k, round(v, 2)] for v, k in near[:3]]
        if cls == "outside":
            info[name]["best_pair_over_noise"] = two / nn
            if two < 3 * nn or two < .03 * yr:
                return None
        elif near and near[0][0] < 1.0:
            return None
    return info


def judge_channel(g, fit, name, par, col, others):
    cat = lambda f: np.concatenate([f(x) for x in fit])
    o = lambda j: cat(lambda x: x[1][:, j])
    nz = lambda ch: cat(lambda x: x[2][ch] - x[3][ch])
    T = cat(lambda x: np.diff(x[4], prepend=x[4][0] - 1 / g["rate"]))
    if name in ("winding_heating", "dead_time", "current_offset", "current_gain"):
        di = np.diff(o(O_I), prepend=0) / T
        i, w = o(O_MI), o(O_MW)
        one = np.ones(i.size)
        c, B = {"winding_heating": (o(col), [di, w, one]), "dead_time": (o(col), [i, di, w, one]),
                "current_offset": (g["R"] * par[0] * one, [i, di, w]), "current_gain": (g["R"] * par[0] * i, [di, w, one])}[name]
        for e, p in others:
            if e in ("winding_heating", "current_gain"):
                B = B + [i]
            elif e == "current_offset":
                B = B + [one]
            elif e == "dead_time":
                B = B + [np.tanh(i / .05)]
            elif e == "torque_ripple":
                B = B + [w * np.cos(p[2] * o(O_MTH) + p[1])]
        n = nz("voltage") + g["R"] * (nz("current") - g["ioff"])
        if name == "current_gain" and rms(w) < .1 * g["w0"]:
            return False, 0
    elif name == "supply_sag":
        c, B, n = o(col), [np.ones(T.size)], nz("v_dc")
    elif name == "backlash":
        c = o(O_USER) / g["gear"] - o(O_TH) / g["gear"]
        B, n = [np.ones(T.size)], nz("user_position")
        if rms(n) < 1e-9 or par[0] / g["gear"] < 3 * g["ures"]:
            return False, 0
    elif name == "encoder_eccentricity":
        th, w = o(O_TH), o(O_MW)
        m = max(1, g["rate"] / (2.5 * min(max(3 * rms(w) / 6.28, 2), g["rate"] / 2)))
        cp = par[0] * np.sin(th + par[1])
        d = lambda x: np.diff(x, prepend=x[0]) / T
        if g["tacho"]:
            c, n, B = lp(d(cp), m), lp(d(nz("position")), m) + lp(nz("velocity"), m), [lp(w, m)]
        else:
            c = lp(g["J"] * d(d(cp)), m)
            n = lp(g["J"] * d(d(nz("position"))), m)
            n = n + (lp(nz("torque"), m) if g["drive"] == "torque" else lp(g["kt"] * nz("current"), m))
            B = [lp(w, m), lp(d(o(O_W)), m), lp(o(O_SGN), m), np.ones(T.size)]
            if rms(c) < .05 * rms(o(O_MT)):
                return False, 0
            for j, (e, p) in enumerate(others):
                B = B + [lp(o(O_C1 if col == O_C2 else O_C2), m)]
    elif name == "control_delay":
        c = o(col)
        n = nz("current") + g["ctl"]["kv"] * nz("velocity") + g["ctl"]["kv"] * g["ctl"]["kp"] * nz("position")
        m = max(1, g["rate"] / (2.5 * min(max(band(o(O_MI), g["rate"], .97), band(c, g["rate"], .9), 2.0), g["rate"] / 2)))
        c, n = lp(c, m), lp(n, m)
        # the known lag of the loop may be re-tuned: leave out the part that goes with the current itself
        B = [lp(o(O_MI), m)]
        if rms(c) < .05 * rms(o(O_MI)):
            return False, 0
    s = rms(rest(c, np.stack(B, 1))) / (rms(n) + 1e-15)
    return s >= 5, s


# ------------------------------------------------------------------ one case
def build(seed, case, cls, verify=False):
    r = np.random.default_rng([seed, case, CLASSES.index(cls), 7041])
    for attempt in range(400):
        g = make_rig(r)
        lin_ = g["linear"]
        g["jitter"] = bool(r.random() < .15)
        g["gap"] = bool(r.random() < .12)
        g["wmean"], g["imean"] = bool(r.random() < .3), bool(r.random() < .75 or g["has_v"] or g["rate"] < 500)
        g["nw"] = logu(r, 5e-4, .006)
        if g["opened"]:
            g["nw"], g["ilim"] = logu(r, 1e-4, 6e-4), g["isc"] * r.uniform(2.5, 4)
        g["ni"], g["nv"] = logu(r, .003, .02), logu(r, .0006, .005)
        g["hum"] = float(r.uniform(.2, .7)) if r.random() < .25 else 0.0
        g["mains"] = float(pick(r, [50, 60]))
        g["ures"] = 2 * math.pi / pick(r, [4096, 10000, 36000, 2 ** 17])
        g["ioff"] = 0.0
        if g["drive"] != "torque":
            g["ioff"] = float(r.uniform(-1, 1)) * (.03 if g["off_record"] else .0015 if r.random() < .5 else 0) * g["isc"]
        runs, ctl, one_file = plan(r, g)
        g["ctl"] = ctl
        nds = int(r.integers(1, 4))
        g["chdelay"] = nds if r.random() < .15 and g["rate"] >= 500 and nds / g["rate"] <= .004 and not g["opened"] and not g["has_v"] else 0
        g["delay_stated"] = bool(r.random() < .5)
        eff = []
        if cls in ("one", "two"):
            names = [n for n in EFFECTS if possible(n, g)]
            wts = np.array([6.0 if n == "control_delay" else 2.5 if n in ("backlash", "winding_heating", "current_gain", "current_offset", "supply_sag", "load_dependent_friction", "temperature_dependent_friction")
                            else 1.0 for n in names])
            k = r.choice(len(names), size=1 if cls == "one" else 2, replace=False, p=wts / wts.sum())
            eff = [(names[j], draw_effect(r, names[j], g)) for j in k]
        elif cls == "outside":
            names = [n for n in LAWS if possible_law(n, g)]
            nm = pick(r, names)
            eff = [(nm, draw_effect(r, nm, g))]
        en = [e[0] for e in eff]
        if "current_offset" in en:
            g["ioff"] = 0.0
        if {"current_gain", "winding_heating"} <= set(en) or {"compliance", "presliding"} <= set(en):
            continue
        if "control_delay" in en:                  # keep the loop stable
            q = dict(eff)["control_delay"][0]
            f = min(1.0, .5 / (ctl["bw"] * q))
            ctl.update(kv=ctl["kv"] * f, kp=ctl["kp"] * f, ki=ctl["ki"] * f * f)
        if "friction_grows_with_time" in en and runs[0]["dur"] > 20:
            eff[0][1][0] *= 20 / runs[0]["dur"]
        sims, bad = [], False
        for run in runs:
            o, e = run_sim(r, g, ctl, run, eff)
            t = run["idx"] * run["h"]
            wmax = np.abs(o[:, O_W]).max()
            if not np.isfinite(o).all() or wmax > 3 * g["w0"] or o[-1, O_TH] == 0 or (o[:, O_SLIP] > .5).mean() < .25 \
                    or rms(o[:, O_W]) < .08 * g["w0"] or (g["travel"] and np.ptp(o[:, O_TH]) > 2.2 * g["travel"]):
                bad = True
                break
            if g["kind_rig"] == "spindle" and o[:, O_W].min() < -.01 * g["w0"]:
                bad = True
                break
            run["energy"] = e
            rec, tru = sense(r, g, o, t, eff)
            sims.append((run, o, rec, tru, t))
        if bad:
            continue
        info = judge(g, sims, eff, cls) if eff else {}
        if info is None:
            continue
        return r, g, ctl, runs, one_file, eff, sims, info, attempt
    raise RuntimeError("no case found")


def dev(r, x, trust):
    return x * (1 + float(r.uniform(-1, 1)) * min(1.6 * trust, .25))


def write_case(seed, case, cls, out):
    import pandas as pd
    t0 = time.time()
    r, g, ctl, runs, one_file, eff, sims, info, attempt = build(seed, case, cls)
    E = dict(eff)
    d = os.path.join(out, "case_%03d" % case)
    os.makedirs(d, exist_ok=True)
    lin_ = g["linear"]
    X = g["lead"] / (2 * math.pi) if lin_ else 1.0            # metres per rad
    sharp = "current_gain" in E
    tr = lambda: float(r.choice([.02, .05, .1, .15]))
    L = ["# simulated test rig %d" % case, "[rig]", 'kind = "%s"' % ("linear" if lin_ else "rotary")]
    if lin_:
        L.append("lead_m_per_turn = %.6g" % g["lead"])
    force = lin_ and g["drive"] == "torque"
    drive = {"current": "current", "volts_in": "voltage", "torque": "force" if force else "torque", "loop": "current" if r.random() < .5 else "voltage",
             "dcvolt": "voltage"}[g["drive"]]
    if g["opened"]:
        drive = "command"
    L.append('drive = "%s"' % drive)
    ktr = .005 if sharp else tr()
    den = "V" if g["drive"] == "volts_in" else "A"
    kt_said = None
    if g["drive"] == "torque":
        L.append("drive_constant = { value = 1.0, trust = 0 }")
    else:
        kt_said = dev(r, g["kt"], ktr) / X
        L.append('drive_constant = { value = %.6g, unit = "%s/%s", trust = %g }' % (kt_said, "N" if lin_ else "N m", den, ktr))
    say = lambda k, v, u, q: L.append('%s = { value = %.6g, unit = "%s", trust = %g }' % (k, v, u, q))
    q = .01 if sharp else tr()
    say("inertia", dev(r, g["J"], q) / X ** 2, "kg" if lin_ else "kg m2", q)
    if r.random() < .75:
        q = float(r.choice([.15, .3]))
        say("viscous", dev(r, g["C"], q) / X ** 2, "N/(m/s)" if lin_ else "N m s/rad", q)
        say("coulomb", dev(r, g["Fc"], q) / X, "N" if lin_ else "N m", q)
    if g["weight"]:
        L.append('offset = { value = %.6g, unit = "%s", trust = 0.05 }' % (g["weight"] * (1 + r.uniform(-.05, .05)) / X, "N" if lin_ else "N m"))
    if g["has_v"]:
        q = .005 if sharp or "winding_heating" in E else float(r.choice([.03, .08]))
        say("resistance", dev(r, g["R"], q), "ohm", q)
        say("inductance", dev(r, g["L"], .1), "H", .1)
        say("back_emf_constant", dev(r, g["kt"], ktr), "V s/rad", ktr)
        L.append("supply_voltage = %.6g" % g["vs"])
    if g["gear"] != 1:
        L.append("gear_ratio = %g" % g["gear"])
    if g["opened"]:
        L += ["", "[rig.controller]", "position_gain = %.8g" % ctl["kp"], "speed_gain = %.8g" % (ctl["kv"] / X), "integral_gain = %.8g" % (ctl["ki"] / X),
              "speed_limit = %.6g" % (1.6 * g["w0"] * X), "drive_limit = %.6g" % g["ilim"], 'velocity = "measured"', 'position = "motor"',
              "rate_hz = %g" % (1 / ctl["Tc"]), "current_time_constant_s = %.6g" % g["tau"]]
    pu = pick(r, ["mm", "m", "um"] if lin_ else ["rad", "deg", "turn"])
    pf = {"mm": 1e3 * X, "m": X, "um": 1e6 * X, "rad": 1, "deg": 180 / math.pi, "turn": 1 / (2 * math.pi)}[pu]
    vu = pick(r, ["m/s", "mm/s"] if lin_ else ["rad/s", "rpm", "deg/s"])
    vf = {"m/s": X, "mm/s": 1e3 * X, "rad/s": 1, "rpm": 30 / math.pi, "deg/s": 180 / math.pi}[vu]
    iname = "voltage" if g["drive"] == "volts_in" else "current"
    iu = "V" if iname == "voltage" else pick(r, ["A", "mA"])
    i_f = 1e3 if iu == "mA" else 1.0
    L += ["", "[channels]", 'time = { column = "time_s", unit = "s" }']
    dl = ', delay_s = %.6g' % (g["chdelay"] / g["rate"]) if g["chdelay"] and g["delay_stated"] else ""
    dsamp = 'sampling = "%s"' % ("mean" if g["imean"] else "point")
    noise_said = r.random() < .6
    cols = {}
    rec0 = sims[0][2]
    if "position" in rec0:
        L.append('position = { column = "pos", unit = "%s", resolution = %.6g }' % (pu, g["res"] * pf))
        cols["position"] = ("pos", pf)
    if "velocity" in rec0:
        L.append('velocity = { column = "speed", unit = "%s"%s%s }' % (vu, ', sampling = "mean"' if g["wmean"] else "",
                 ", noise = %.4g" % (g["nw"] * g["w0"] * vf) if noise_said else ""))
        cols["velocity"] = ("speed", vf)
    if "current" in rec0:
        L.append('%s = { column = "drive", unit = "%s", %s%s%s }' % (iname, iu, dsamp, ", noise = %.4g" % (g["ni"] * g["isc"] * i_f) if noise_said else "", dl))
        cols["current"] = ("drive", i_f)
    if "torque" in rec0:
        f = 1 / X if force else pick(r, [1.0, 1e3])
        L.append('%s = { column = "cell", unit = "%s", %s%s%s }' % ("force" if force else "torque", "N" if force else ("N m" if f == 1 else "mN m"), dsamp,
                 ", noise = %.4g" % (g["ni"] * g["isc"] * g["kt"] * f) if noise_said else "", dl))
        cols["torque"] = ("cell", f)
    if "voltage" in rec0:
        L.append('voltage = { column = "u_motor", unit = "V", sampling = "mean"%s }' % (", noise = %.4g" % (g["nv"] * g["vs"]) if noise_said else ""))
        cols["voltage"] = ("u_motor", 1.0)
    if "v_dc" in rec0:
        L.append('v_dc = { column = "u_link", unit = "V", sampling = "mean", noise = %.4g }' % (.002 * g["vs"]))
        cols["v_dc"] = ("u_link", 1.0)
    if "load" in rec0:
        L.append('load = { column = "load", unit = "N m", sampling = "mean", noise = %.4g }' % (.004 * g["Tsc"]))
        cols["load"] = ("load", 1.0)
    if "temperature" in rec0:
        L.append('temperature = { column = "temp", unit = "degC" }')
        cols["temperature"] = ("temp", 1.0)
    if "user_position" in rec0:
        uf = 180 / math.pi
        L.append('user_position = { column = "out_pos", unit = "deg", resolution = %.6g }' % (g["ures"] * uf))
        cols["user_position"] = ("out_pos", uf)
    if g["opened"]:
        L.append('command = { column = "set", unit = "%s" }' % pu)
    also = []
    used = []
    for j, (run, o, rec, tru, t) in enumerate(sims):
        tab = {"time_s": np.round(t, 7)}
        if g["opened"]:
            tab["set"] = np.interp(t, np.arange(run["grid"][1].size) * 1e-3, run["grid"][1]) * pf
        for k, (c, f) in cols.items():
            x = rec[k]
            if k in ("current", "torque") and g["chdelay"]:
                x = np.concatenate([np.full(g["chdelay"], x[0]), x[:-g["chdelay"]]])
            tab[c] = x * f
        df = pd.DataFrame(tab)
        if g["chdelay"]:
            df = df.iloc[g["chdelay"]:]
        if g["gap"] and j == len(sims) // 2:
            a = r.uniform(.2, .7) * t[-1]
            b = a + r.uniform(.2, 1.5)
            df = df[(df.time_s < a) | (df.time_s > b)]
        base = "%s_%d" % (pick(r, ["log", "run", "test", "axis"]), j + 1)
        fn = base + (".parquet" if len(df) > 25000 or r.random() < .2 else ".csv")
        p = os.path.join(d, fn)
        df.to_parquet(p, index=False) if fn.endswith("parquet") else df.to_csv(p, index=False, float_format="%.9g")
        D = t[-1]
        parts = [("fit", [0.0, round(.62 * D, 3)]), ("heldout", [round(.62 * D, 3), round(D + 1, 3)])] if run["role"] == "both" else [(run["role"], None)]
        for role, win in parts:
            L += ["", "[[run]]", 'file = "%s"' % fn, 'role = "%s"' % role, 'health = "healthy"']
            if win:
                L.append("window_s = [%g, %g]" % tuple(win))
            used.append(dict(file=fn, role=role, motion=run["fam"], amplitude=run["amp"], dry_factor=run["fday"], viscous_factor=run["cday"]))
    if g["off_record"] and "current" in cols:
        n = int(min(3.0 * g["rate"], 20000))
        t = (np.arange(n) + 1) / g["rate"]
        tab = {"time_s": np.round(t, 7)}
        for k, (c, f) in cols.items():
            s = {"current": g["ni"] * g["isc"], "voltage": g["nv"] * g["vs"], "velocity": g["nw"] * g["w0"], "load": .004 * g["Tsc"]}.get(k, 0)
            m = {"current": g["ioff"], "temperature": 22.0, "v_dc": g["vs"]}.get(k, 0.0)
            tab[c] = (m + s * r.standard_normal(n)) * f
        pd.DataFrame(tab).to_csv(os.path.join(d, "drive_off.csv"), index=False, float_format="%.9g")
        L += ["", "[[run]]", 'file = "drive_off.csv"', 'role = "off"', 'health = "healthy"']
        also.append({"name": "current_offset", "parameters": {"current": g["ioff"]}, "known_from": "off record"})
    elif g["ioff"]:
        also.append({"name": "current_offset", "parameters": {"current": g["ioff"]}, "known_from": "within the default tolerance"})
    open(os.path.join(d, "bench.toml"), "w").write("\n".join(L) + "\n")
    keyeff = []
    for n, p in eff:
        e = {"name": n, "parameters": dict(zip(PAR[n], p)) if n in PAR else {"p%d" % k: v for k, v in enumerate(p)}}
        if n == "encoder_eccentricity":
            e["reads"] = "angle"
        if n == "supply_sag":
            e["draw"] = "power"
        if n == "backlash":
            e["half_width_at_motor_rad"] = p[0] / 2
        e["selection"] = info.get(n, {})
        keyeff.append(e)
    const = dict(inertia=g["J"], viscous=g["C"], coulomb=g["Fc"], torque_constant=g["kt"], weight=g["weight"], gear_ratio=g["gear"])
    if g["has_v"]:
        const.update(resistance=g["R"], inductance=g["L"], back_emf_constant=g["kt"], supply_voltage=g["vs"])
    rig = dict(kind=g["kind_rig"], drive=g["drive"], drive_in_toml=drive, motion=[u["motion"] for u in used], rate_hz=g["rate"],
               velocity="own" if g["tacho"] else "none", position="none" if g["sensors"] == "velocity" else "encoder", resolution_rad=g["res"],
               sampling="mean" if g["imean"] else "point", jitter=g["jitter"], gap=g["gap"], hum=g["hum"], channel_delay_s=g["chdelay"] / g["rate"],
               delay_stated=g["delay_stated"], controller_open=g["opened"], load=g["load_machine"], temperature=g["thermo"], user=g["user"],
               one_file=one_file, current_noise=g["ni"] * g["isc"], speed_scale=g["w0"], torque_scale=g["Tsc"], travel_rad=g["travel"],
               lead_m=g["lead"], runs=used, attempts=attempt + 1, seconds=round(time.time() - t0, 2))
    return {"case": case, "class": cls, "effects": keyeff, "also_true": also, "constants": const, "rig": rig}


def selfcheck(seed, case, cls):
    """balance, energy and convergence of one case's runs, without noise; returns the worst relative numbers"""
    r, g, ctl, runs, one_file, eff, sims, info, attempt = build(seed, case, cls)
    E = dict(eff)
    out = []
    for run, o, rec, tru, t in sims[:2]:
        T = np.diff(t, prepend=t[0] - t[0])
        T[0] = t[0]
        s = slice(2, None)
        a = np.diff(o[:, O_W], prepend=0) / T
        # torque balance from the summed terms; contributions count while slipping, so compare moving samples
        mv = (o[s, O_SLIP] > .999) & (np.sign(o[s, O_W]) == np.sign(o[s, O_SGN]))
        C, Fc = g["C"] * run["cday"], g["Fc"] * run["fday"]
        J = g["J"]
        lhs = o[s, O_MT]
        ce = sum((o[s, O_C1 + k] for k, e in enumerate(eff) if e[0] in TORQUE or e[0] in LAWS), np.zeros(lhs.size))
        rhs = J * a[s] + C * o[s, O_MW] + Fc * o[s, O_SGN] + o[s, O_MLOAD] + g["weight"] + ce
        bal = rms((lhs - rhs)[mv]) / rms(lhs)
        ebal = abs(run["energy"][0] - run["energy"][1:5].sum()) / (abs(run["energy"][0]) + 1e-12)
        vb = 0.0
        if g["has_v"]:
            di = np.diff(o[:, O_I], prepend=0) / T
            emf = g["kt"] * o[s, O_MW]
            ve = sum((o[s, O_C1 + k] for k, e in enumerate(eff) if e[0] in ("winding_heating", "dead_time")), np.zeros(lhs.size))
            if "torque_ripple" not in E:
                vb = rms(o[s, O_MV] - g["R"] * o[s, O_MI] - g["L"] * di[s] - emf - ve) / rms(o[s, O_MV])
        n = o.shape[0] // 4
        full, g0 = run["idx"], dict(g, res=0.0)          # a rounding encoder in the loop would amplify the last digit
        o1, _ = run_sim(None, g0, ctl, dict(run, idx=full[:n]), eff)
        o2, _ = run_sim(None, g0, ctl, dict(run, idx=full[:n]), eff, half=2)
        cv = rms(o1[:, O_W] - o2[:, O_W]) / (rms(o2[:, O_W]) + 1e-9)
        ct = rms(o1[:, O_MT] - o2[:, O_MT]) / (rms(o2[:, O_MT]) + 1e-9)
        out.append((bal, ebal, vb, cv, ct))
    return [e[0] for e in eff], np.array(out).max(0)


def _job(a):
    return write_case(*a)


def main():
    ap = argparse.ArgumentParser()
    ap.add_argument("--seed", type=int, required=True)
    ap.add_argument("--first", type=int, default=0)
    ap.add_argument("--cases", type=int, default=1)
    ap.add_argument("--class", dest="cls", choices=CLASSES, required=True)
    ap.add_argument("--out")
    ap.add_argument("--jobs", type=int, default=1)
    ap.add_argument("--selfcheck", action="store_true")
    a = ap.parse_args()
    ks = range(a.first, a.first + a.cases)
    if a.selfcheck:
        print("case  effects  balance  energy  voltage  speed(h/2)  torque(h/2)  relative rms")
        for k in ks:
            n, x = selfcheck(a.seed, k, a.cls)
            print(k, ",".join(n) or "-", " ".join("%.1e" % q for q in x), flush=True)
        return
    if not a.out:
        ap.error("--out is needed")
    out = os.path.abspath(a.out)
    os.makedirs(out, exist_ok=True)
    jobs = [(a.seed, k, a.cls, out) for k in ks]
    if a.jobs > 1:
        import multiprocessing as mp
        with mp.Pool(a.jobs) as pool:
            keys = pool.map(_job, jobs, chunksize=1)
    else:
        keys = [_job(j) for j in jobs]
    p = os.path.join(os.path.dirname(out), "keys_%s.json" % os.path.basename(out))
    with open(p, "w") as f:
        json.dump(keys, f, indent=1)
    print("%d cases, keys in %s" % (len(keys), p))


if __name__ == "__main__":
    main()
