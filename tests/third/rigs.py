#!/usr/bin/env python3
"""rigs.py - synthetic recordings of drive rigs, with a key of what is really in them.

  rigs.py --seed S --first K0 --cases N --out DIR [--class nothing|one|two|outside] [--effect NAME]
  rigs.py --selfcheck [--cases N] [--seed S]      rigs.py --list

Writes DIR/case_KKK/{bench.toml,*.csv} and DIR/../keys_<basename DIR>.json (merged by case number if present).
Assumptions (all quantities SI at the motor; theta, w of the rotor):
 1 Rigs: disc, ball screw, belt (kind linear: x = theta lead/2pi), geared servo, torque motor. J 1e-6..1e-2 kg m2.
 2 Closed loop (about 85 %): w_ref = kv (command - position) [+ speed feedforward where no controller is published],
   PI speed with limits and anti-windup at 1-8 kHz, PI current loop of 300-1500 Hz (800-1500 with drive = "voltage"), voltage limit (there ample).
   With drive = "voltage" or a published controller the back-EMF is fed forward: the current is what was asked for, later by 1/(2 pi f_c).
   "Ideal" rigs: motion is prescribed and the drive follows by inverse dynamics; at rest dry friction counts as zero.
 3 Fixed step of 1/24000..1/48000 s. Dry friction is implicit (the impulse that stops the rotor is capped by the
   friction level): real sticking, w = 0 exactly. Static level = Coulomb level unless an effect says otherwise.
 4 kt i = J w' + C w + F sgn w + load + terms; v = R i + L i' + ke w + terms, ke = kt. v is what the current
   controller asks for. load is positive against positive motion. P = v i (the equivalent one-phase machine).
 5 drive = "voltage": the channel voltage is the amplifier's input; the current follows it with the current loop's
   lag, 1/(2 pi f_c) = 0.1-0.2 ms, named in the key under also_true. drive = "torque"/"force": the channel is the motor's torque.
 6 periodic terms use theta as recorded (same zero). Ripple: kt and ke times (1 + fraction cos(..)). Temperature acts on
   dry friction only (there the viscous part is small). presliding: dz = w (1 - stiffness z sgn w/F), force stiffness z + damping dz/dt.
   backlash: gap is the whole play, motor side; user = theta/gear behind +-gap/2, without inertia of its own.
   compliance: inertia = load's; constants.inertia is motor plus load; dry and viscous friction at the motor.
   supply_sag: C dvdc/dt = (Vs - vdc)/Rs - v i/vdc with Rs C <= 0.3 ms. control_delay: torque follows the controller's
   output (the amplifier's input) that much later. Sensor effects (current, encoder) act inside the loop.
 7 current_offset, current_gain only with current and voltage; three-phase effects (eccentricity, turn_short,
   commutation_offset) are left out. backlash only with user_position, load friction only with a load channel, etc.
 8 Severity: rms of the term / rms of the drive torque (motor voltage for electrical ones) in 3..12 %; what is left of
   it after a fit of the base model (w', w, sgn w, for current-like ones i too) at least 1.5 % and 3 x the noise of the
   equation in the term's band (90 % of its power); present in the fit and in the heldout runs. backlash: gap/2 at
   least 5 x the noise of the two positions; presliding: counted where abs(w) > 0.2 % of top speed. Else parameters, sensors and at last the rig are drawn anew.
 9 Channel keys resolution, noise, offset stand in the channel's unit; delay_s > 0: the value belongs to t - delay_s.
   Mean sampling is over the interval that ends at the time stamp. Where `noise` is given it is the truth.
   A current offset of about 0.1 % of the range is in every current channel. An unstated delay (0.2-2 ms) never
   occurs together with a published controller, drive = "voltage" or control_delay.
10 bench.toml constants: truth times (1 + trust N(0,1)), |N| <= 2. kt is always there, others may be missing. winding_heating:
   the true cold R is constants.resistance_cold, trusted to 1-2 %. compliance: inertia, where given, is the total.
11 Class outside: random_friction, eddy_brake, hysteresis, cubic_cable, variable_inertia, current_cubic, ageing,
   critical_speed, saturating_viscous; `near` lists effects of the list that could partly imitate it.
12 A case depends on seed, number, and the options --class and --effect.
"""
import argparse, json, math, os, sys, time
import numpy as np
from numba import njit

# How bare numbers are written in bench.toml: "plain" gives `gear_ratio = 20`, "table" gives `gear_ratio = { value = 20 }`.
STYLE = {"gear_ratio": "plain", "controller": "plain", "lead": "plain"}

TAU = 2 * math.pi
# ------------------------------------------------------------------ effects: codes and parameters
# name: (code, [parameters in order])
EFFECTS = {
    "stribeck": (1, ["torque", "speed", "exponent"]),
    "lubricated_rise": (2, ["torque", "speed"]),
    "quadratic_drag": (3, ["coefficient"]),
    "viscous_asymmetry": (4, ["coefficient"]),
    "bias_torque": (5, ["torque"]),
    "load_dependent_friction": (6, ["coefficient"]),
    "temperature_dependent_friction": (7, ["coefficient"]),
    "periodic_friction": (8, ["amplitude", "phase", "order"]),
    "tight_spot": (9, ["torque", "centre", "width"]),
    "presliding": (10, ["stiffness", "damping"]),
    "cogging": (11, ["amplitude", "phase", "order"]),
    "torque_ripple": (12, ["fraction", "phase", "order"]),
    "torque_saturation": (13, ["coefficient"]),
    "spring_load": (14, ["stiffness", "rest"]),
    "compliance": (15, ["stiffness", "damping", "inertia"]),
    "backlash": (16, ["gap"]),
    "winding_heating": (17, ["delta_t"]),
    "supply_sag": (18, ["resistance"]),
    "dead_time": (19, ["voltage"]),
    "encoder_eccentricity": (20, ["amplitude", "phase"]),
    "current_offset": (21, ["current"]),
    "current_gain": (22, ["gain"]),
    "control_delay": (23, ["delay"]),
}
OUTSIDE = {
    "random_friction": (31, ["torque", "correlation_length"]),
    "eddy_brake": (32, ["coefficient", "speed"]),
    "hysteresis": (33, ["torque", "angle"]),
    "cubic_cable": (34, ["torque_at_reach", "reach", "rest"]),
    "current_cubic": (35, ["coefficient"]),
    "ageing": (36, ["torque", "length", "time"]),
    "critical_speed": (37, ["torque", "speed", "width"]),
    "saturating_viscous": (38, ["torque", "speed"]),
    "variable_inertia": (39, ["inertia", "phase", "order"]),
}
NEAR = {
    "random_friction": ["periodic_friction", "tight_spot"],
    "eddy_brake": ["lubricated_rise", "quadratic_drag", "stribeck"],
    "hysteresis": ["presliding"],
    "cubic_cable": ["spring_load"],
    "current_cubic": ["torque_saturation"],
    "ageing": ["stribeck"],
    "critical_speed": ["stribeck", "lubricated_rise", "quadratic_drag"],
    "saturating_viscous": ["lubricated_rise", "stribeck", "quadratic_drag"],
    "variable_inertia": [],
}
ALL = {**EFFECTS, **OUTSIDE}
CODE = {k: v[0] for k, v in ALL.items()}
CURRENT = {"current", "current_voltage"}
ANY = {"current", "current_voltage", "torque", "voltage"}
# what a rig must have for the effect to be seen
NEED = {
    "stribeck": dict(friction=True, slow=True),
    "lubricated_rise": dict(friction=True),
    "load_dependent_friction": dict(load=True, rotary=True),
    "temperature_dependent_friction": dict(temperature=True, friction=True, runs=3),
    "periodic_friction": dict(friction=True, position=True),
    "tight_spot": dict(friction=True, position=True),
    "presliding": dict(friction=True, position=True, fine=True),
    "cogging": dict(position=True),
    "torque_ripple": dict(drive=CURRENT | {"voltage"}, position=True),
    "torque_saturation": dict(drive=CURRENT | {"voltage"}),
    "spring_load": dict(position=True),
    "compliance": dict(closed=True, fast=True, position=True, fine=True),
    "backlash": dict(user=True, position=True, closed=True),
    "winding_heating": dict(drive={"current_voltage"}, closed=True),
    "supply_sag": dict(drive={"current_voltage"}, closed=True, vdc=True),
    "dead_time": dict(drive={"current_voltage"}, closed=True, amps=True),
    "encoder_eccentricity": dict(closed=True, position=True, fine=True, fast=True),
    "current_offset": dict(drive={"current_voltage"}, closed=True),
    "current_gain": dict(drive={"current_voltage"}, closed=True),
    "control_delay": dict(closed=True, delay=True, fast=True),
    "random_friction": dict(friction=True, position=True),
    "hysteresis": dict(position=True),
    "cubic_cable": dict(position=True),
    "current_cubic": dict(drive={"current", "current_voltage"}, closed=True),
    "ageing": dict(friction=True, closed=True, slow=True),
    "variable_inertia": dict(position=True),
}
ELECTRICAL = {"winding_heating", "dead_time", "supply_sag"}
NO_PAIR = [{"stribeck", "lubricated_rise"}, {"bias_torque", "current_offset"}, {"current_gain", "torque_saturation"},
           {"current_gain", "winding_heating"}, {"presliding", "stribeck"}, {"presliding", "compliance"},
           {"presliding", "lubricated_rise"}, {"backlash", "compliance"}, {"spring_load", "bias_torque"},
           {"encoder_eccentricity", "compliance"}, {"control_delay", "compliance"}, {"current_gain", "current_offset"},
           {"stribeck", "quadratic_drag"}, {"lubricated_rise", "quadratic_drag"}, {"current_gain", "torque_ripple"},
           {"load_dependent_friction", "temperature_dependent_friction"}, {"cogging", "encoder_eccentricity"},
           {"tight_spot", "periodic_friction"}, {"current_gain", "control_delay"}, {"current_offset", "control_delay"}]

# ------------------------------------------------------------------ physics
(J_, C_, FC_, KT_, KE_, R_, L_, KPC_, KIC_, VS_, KPP_, KP_, KI_, WLIM_, ULIM_, FF_, RES_, VMODE_, VSIG_, AF_,
 DT_, M_, CSUP_, PLO_, PSTEP_, EMF_) = range(26)
NP = 26
TH, W, I, V, U, VM, VDC, USER, T1, T2 = range(10)
NCH = 10


@njit(cache=True)
def mech(c, e, th, w, load, temp, fc, prof, plo, pstep, z):
    """(smooth torque, added level of dry friction) of one effect, against positive motion."""
    s = 0.0
    d = 0.0
    if c == 1:
        d = e[0] * math.exp(-((abs(w) / e[1]) ** e[2]))
    elif c == 2:
        d = e[0] * (1.0 - math.exp(-abs(w) / e[1]))
    elif c == 3:
        s = e[0] * w * abs(w)
    elif c == 4:
        s = e[0] * abs(w)
    elif c == 5:
        s = e[0]
    elif c == 6:
        d = e[0] * abs(load)
    elif c == 7:
        d = e[0] * (temp - 20.0) * fc
    elif c == 8:
        d = e[0] * math.cos(e[2] * th + e[1])
    elif c == 9:
        x = (th - e[1]) / e[2]
        if abs(x) < 6.0:
            d = e[0] * math.exp(-x * x)
    elif c == 11:
        s = e[0] * math.cos(e[2] * th + e[1])
    elif c == 14:
        s = e[0] * (th - e[1])
    elif c == 31:
        x = (th - plo) / pstep
        n = len(prof)
        k = int(math.floor(x))
        f = x - k
        d = e[0] * ((1.0 - f) * prof[k % n] + f * prof[(k + 1) % n])
    elif c == 32:
        q = w / e[1]
        s = e[0] * w / (1.0 + q * q)
    elif c == 33:
        s = e[0] * z
    elif c == 34:
        q = (th - e[2]) / e[1]
        s = e[0] * q * q * q
    elif c == 36:
        d = e[0] * math.log(1.0 + z / e[2])
    elif c == 37:
        q = (abs(w) - e[1]) / e[2]
        d = 0.0
        if abs(w) > 0.0:
            s = e[0] * math.exp(-q * q) * (1.0 if w > 0 else -1.0)
    elif c == 38:
        s = e[0] * math.tanh(w / e[1])
    return s, d


@njit(cache=True)
def evolve(c, e, w, dt, z):
    """memory of hysteresis and ageing"""
    if c == 33:
        a = abs(w) * dt / e[1]
        t = 1.0 if w > 0 else -1.0
        return t + (z - t) * math.exp(-a) if w != 0.0 else z
    if c == 36:
        r = abs(w) / e[1]
        if r * dt > 1e-9:
            q = math.exp(-r * dt)
            return z * q + (1.0 - q) / r
        return z + dt
    return z


@njit(cache=True)
def simulate(cmd, load, temp, noise, P, code, E, prof, out):
    N = len(cmd)
    dt = P[DT_]
    m = int(P[M_])
    Tc = m * dt
    kt = P[KT_]; ke = P[KE_]; R = P[R_]; L = P[L_]; fc = P[FC_]
    J = P[J_]
    # parameters of effects with a place of their own
    ga = 0.0; off = 0.0; cub = 0.0; sat = 0.0; rf_a = 0.0; rf_p = 0.0; rf_o = 0.0; vdt = 0.0
    ecc = 0.0; eccp = 0.0; gap = 0.0; rs = 0.0; nd = 0
    ks = 0.0; ds = 0.0; J2 = 0.0; sg = 0.0; sd = 0.0; j1 = 0.0; j1p = 0.0; j1o = 0.0
    R0 = R
    for k in range(2):
        c = code[k]
        if c == 10:
            sg = E[k, 0]; sd = E[k, 1]
        elif c == 12:
            rf_a = E[k, 0]; rf_p = E[k, 1]; rf_o = E[k, 2]
        elif c == 13:
            sat = E[k, 0]
        elif c == 15:
            ks = E[k, 0]; ds = E[k, 1]; J2 = E[k, 2]
        elif c == 16:
            gap = E[k, 0]
        elif c == 17:
            R = R0 * (1.0 + 0.00393 * E[k, 0])
        elif c == 18:
            rs = E[k, 0]
        elif c == 19:
            vdt = E[k, 0]
        elif c == 20:
            ecc = E[k, 0]; eccp = E[k, 1]
        elif c == 21:
            off = E[k, 0]
        elif c == 22:
            ga = E[k, 0]
        elif c == 23:
            nd = int(round(E[k, 0] / dt))
        elif c == 35:
            cub = E[k, 0]
        elif c == 39:
            j1 = E[k, 0]; j1p = E[k, 1]; j1o = E[k, 2]
    Jm = J - J2
    th = 0.0; w = 0.0; i = 0.0; Ic = 0.0; Is = 0.0; vm = 0.0; u = 0.0
    th2 = 0.0; w2 = 0.0; user = 0.0; vdc = P[VS_]; zb = 0.0
    z0 = 0.0; z1 = 0.0
    pm = ecc * math.sin(eccp)
    if P[RES_] > 0:
        pm = round(pm / P[RES_]) * P[RES_]
    for n in range(N):
        if n % m == 0:
            p = th + ecc * math.sin(th + eccp)
            if P[RES_] > 0:
                p = round(p / P[RES_]) * P[RES_]
            if P[VMODE_] == 0:
                vm = w + P[VSIG_] * noise[n // m]
            else:
                vm += P[AF_] * ((p - pm) / Tc - vm)
            pm = p
            wr = P[KPP_] * (cmd[n] - p)
            if P[FF_] > 0 and n >= m:
                wr += P[FF_] * (cmd[n] - cmd[n - m]) / Tc
            wr = min(max(wr, -P[WLIM_]), P[WLIM_])
            er = wr - vm
            Is += P[KI_] * er * Tc
            u = P[KP_] * er + Is
            if u > P[ULIM_]:
                if er > 0: Is -= P[KI_] * er * Tc
                u = P[ULIM_]
            elif u < -P[ULIM_]:
                if er < 0: Is -= P[KI_] * er * Tc
                u = -P[ULIM_]
        out[U, n] = u
        ua = u
        if nd > 0:
            ua = out[U, n - nd] if n >= nd else 0.0
        im = (1.0 + ga) * i + off + cub * i * i * i
        ec = ua - im
        Ic += P[KIC_] * ec * dt
        v = P[KPC_] * ec + Ic + P[EMF_] * ke * w
        if abs(v) > vdc:
            Ic -= P[KIC_] * ec * dt
            v = vdc if v > 0 else -vdc
        rf = 1.0
        if rf_a != 0.0:
            rf = 1.0 + rf_a * math.cos(rf_o * th + rf_p)
        vd = 0.0
        sl = 0.0
        if vdt != 0.0:
            q = math.tanh(i / 0.05)
            vd = vdt * q
            sl = vdt / 0.05 * (1.0 - q * q)
        out[TH, n] = th; out[W, n] = w; out[I, n] = i; out[V, n] = v; out[VM, n] = vm; out[VDC, n] = vdc
        out[USER, n] = user
        if rs > 0.0:
            isup = v * i / vdc
            tau = rs * P[CSUP_]
            q = math.exp(-dt / tau)
            vdc = (P[VS_] - rs * isup) + (vdc - (P[VS_] - rs * isup)) * q
        i += dt * (v - R * i - ke * rf * w - vd) / (L + dt * (R + sl))
        drive = kt * rf * i * (1.0 - sat * abs(i))
        s0, d0 = mech(code[0], E[0], th, w, load[n], temp[n], fc, prof, P[PLO_], P[PSTEP_], z0)
        s1, d1 = mech(code[1], E[1], th, w, load[n], temp[n], fc, prof, P[PLO_], P[PSTEP_], z1)
        lev = max(fc + d0 + d1, 0.0)
        nf = drive - P[C_] * w - load[n] - s0 - s1
        Je = Jm
        tv = 0.0
        if j1 != 0.0:
            a = j1o * th + j1p
            Je = Jm + j1 * math.cos(a)
            tv = -0.5 * j1 * j1o * math.sin(a) * w * w
            nf -= tv
        tc = 0.0
        if J2 > 0.0:
            tc = ks * (th - th2) + ds * (w - w2)
            nf -= tc
        w0 = w
        fr = 0.0
        if sg > 0.0:
            free = w + dt * (nf - sg * zb) / Je
            t = w if w != 0.0 else free
            g = 1.0 - sg * zb / lev * (1.0 if t > 0 else -1.0)
            g = max(g, 0.0)
            w = (Je * w + dt * (nf - sg * zb)) / (Je + dt * g * (sg * dt + sd))
            zb += dt * g * w
            zb = min(max(zb, -lev / sg), lev / sg)
            fr = sg * zb + sd * g * w
        else:
            free = w + dt * nf / Je
            lim = dt * lev / Je
            if free > lim:
                w = free - lim
            elif free < -lim:
                w = free + lim
            else:
                w = 0.0
        th += dt * w
        z0 = evolve(code[0], E[0], w, dt, z0)
        z1 = evolve(code[1], E[1], w, dt, z1)
        sw = 1.0 if w > 0 else (-1.0 if w < 0 else 0.0)
        if J2 > 0.0:
            w2 += dt * tc / J2
            th2 += dt * w2
        y = user
        if th - y > 0.5 * gap: y = th - 0.5 * gap
        if th - y < -0.5 * gap: y = th + 0.5 * gap
        user = y
        for k in range(2):
            c = code[k]
            t = (s0 + d0 * sw) if k == 0 else (s1 + d1 * sw)
            if c == 10: t = (fr - lev * sw) if abs(w) > 1.5e-3 * P[WLIM_] else 0.0
            elif c == 12: t = kt * (rf - 1.0) * i
            elif c == 13: t = kt * sat * i * abs(i)
            elif c == 15: t = tc - J2 * (w - w0) / dt
            elif c == 17: t = (R - R0) * i
            elif c == 18: t = P[VS_] - vdc
            elif c == 19: t = vd
            elif c == 21: t = kt * off
            elif c == 22: t = kt * ga * i
            elif c == 23: t = kt * (u - ua)
            elif c == 35: t = kt * cub * i * i * i
            elif c == 39: t = tv + j1 * math.cos(j1o * th + j1p) * (w - w0) / dt
            out[T1 + k, n] = t


@njit(cache=True)
def inverse(ths, ws, acc, load, temp, P, code, E, prof, out):
    """prescribed motion: the drive that it takes"""
    kt = P[KT_]; fc = P[FC_]; dt = P[DT_]
    sat = 0.0; rf_a = 0.0; rf_p = 0.0; rf_o = 0.0; sg = 0.0; sd = 0.0; j1 = 0.0; j1p = 0.0; j1o = 0.0
    for k in range(2):
        c = code[k]
        if c == 10:
            sg = E[k, 0]; sd = E[k, 1]
        elif c == 12:
            rf_a = E[k, 0]; rf_p = E[k, 1]; rf_o = E[k, 2]
        elif c == 13:
            sat = E[k, 0]
        elif c == 39:
            j1 = E[k, 0]; j1p = E[k, 1]; j1o = E[k, 2]
    zb = 0.0; z0 = 0.0; z1 = 0.0
    for n in range(len(ths)):
        th = ths[n]; w = ws[n]
        s0, d0 = mech(code[0], E[0], th, w, load[n], temp[n], fc, prof, P[PLO_], P[PSTEP_], z0)
        s1, d1 = mech(code[1], E[1], th, w, load[n], temp[n], fc, prof, P[PLO_], P[PSTEP_], z1)
        z0 = evolve(code[0], E[0], w, dt, z0)
        z1 = evolve(code[1], E[1], w, dt, z1)
        lev = max(fc + d0 + d1, 0.0)
        sw = 1.0 if w > 0 else (-1.0 if w < 0 else 0.0)
        fr = lev * sw
        if sg > 0.0:
            g = max(1.0 - sg * zb / lev * sw, 0.0)
            zb += dt * g * w
            zb = min(max(zb, -lev / sg), lev / sg)
            fr = sg * zb + sd * g * w
        tv = 0.0
        if j1 != 0.0:
            a = j1o * th + j1p
            tv = -0.5 * j1 * j1o * math.sin(a) * w * w + j1 * math.cos(a) * acc[n]
        tq = P[J_] * acc[n] + P[C_] * w + load[n] + s0 + s1 + fr + tv
        rf = 1.0 + rf_a * math.cos(rf_o * th + rf_p)
        x = tq / (kt * rf)
        i = x
        if sat > 0.0:
            i = (1.0 - math.sqrt(max(1.0 - 4.0 * sat * abs(x), 0.0))) / (2.0 * sat)
            if x < 0: i = -i
        out[TH, n] = th; out[W, n] = w; out[I, n] = i; out[V, n] = 0.0; out[U, n] = i; out[VM, n] = w
        out[VDC, n] = P[VS_]; out[USER, n] = th
        for k in range(2):
            c = code[k]
            t = (s0 + d0 * sw) if k == 0 else (s1 + d1 * sw)
            if c == 10: t = (fr - lev * sw) if abs(w) > 1.5e-3 * P[WLIM_] else 0.0
            elif c == 12: t = kt * (rf - 1.0) * i
            elif c == 13: t = kt * sat * i * abs(i)
            elif c == 39: t = tv
            out[T1 + k, n] = t


# ------------------------------------------------------------------ commands
def move(x0, x1, v, a, dt):
    """trapezoidal move, without its first point"""
    d = abs(x1 - x0)
    if d < 1e-12:
        return np.full(1, x1)
    v = min(v, math.sqrt(d * a))
    ta = v / a
    tc = max(d / v - ta, 0.0)
    t = np.arange(1, int((2 * ta + tc) / dt) + 2) * dt
    t = np.minimum(t, 2 * ta + tc)
    s = np.where(t < ta, 0.5 * a * t * t, np.where(t < ta + tc, 0.5 * v * ta + v * (t - ta), d - 0.5 * a * (2 * ta + tc - t) ** 2))
    return x0 + math.copysign(1, x1 - x0) * s


def command(kind, rng, T, dt, sc):
    """position of the motor, rad; sc: A (half the travel), wmax, alpha, fhi"""
    n = int(round(T / dt))
    A, wmax, al, fhi = sc["A"], sc["wmax"], sc["alpha"], sc["fhi"]
    rest = rng.uniform(0.1, 0.3)
    lead_in = np.zeros(int(rest / dt))
    t = np.arange(n) * dt
    if kind == "multisine":
        nf = int(rng.integers(7, 15))
        f = np.exp(np.linspace(math.log(0.15 + rng.uniform(0, 0.15)), math.log(fhi), nf)) * rng.uniform(0.93, 1.07, nf)
        a = f ** -rng.uniform(1.1, 1.6)
        ph = rng.uniform(0, TAU, nf)
        tt = np.maximum(t - rest, 0)
        x = np.zeros(n)
        for k in range(nf):
            x += a[k] * np.sin(TAU * f[k] * tt + ph[k])
        x -= x[0]
        ramp = np.clip(tt / 0.8, 0, 1)
        x *= ramp * ramp * (3 - 2 * ramp)
        w = np.diff(x) / dt
        g = min(0.95 * A / np.abs(x).max(), 0.9 * wmax / np.abs(w).max(), 1.0 * al / max(np.abs(np.diff(w[::8]) / (8 * dt)).max(), 1e-12))
        return x * g
    if kind == "sweep":
        up = rng.random() < 0.6
        f0, f1 = rng.uniform(0.2, 0.5), fhi * rng.uniform(0.6, 1.0)
        Tt = T - rest
        tt = np.clip(t - rest, 0, None)
        q = tt / Tt if up else 1 - tt / Tt
        f = f0 * (f1 / f0) ** q
        ph = TAU * np.cumsum(f) * dt
        ph -= ph[0]
        a = 1.0 / (1 / (0.9 * A) + TAU * f / (0.9 * wmax) + (TAU * f) ** 2 / (0.9 * al))
        edge = np.clip(tt / 0.5, 0, 1)
        return a * np.sin(ph) * edge * edge * (3 - 2 * edge)
    if kind == "random_steps":
        x = np.zeros(n)
        k = len(lead_in)
        lev = 0.0
        while k < n:
            d = A * math.exp(rng.uniform(math.log(0.03), math.log(0.6))) * rng.choice([-1, 1])
            if abs(lev + d) > 0.95 * A:
                d = -d
            lev = float(np.clip(lev + d, -A, A))
            j = k + int(rng.uniform(0.2, 0.8) / dt)
            x[k:j] = lev
            k = j
        return x
    parts = [lead_in]
    have = len(lead_in)
    x = 0.0

    def add(p):
        nonlocal have, x
        parts.append(p)
        have += len(p)
        x = float(p[-1])

    if kind == "trapezoid":
        while have < n:
            goal = rng.uniform(-0.95, 0.95) * A
            if abs(goal - x) < 0.15 * A:
                continue
            add(move(x, goal, wmax * rng.uniform(0.25, 1.0), al * rng.uniform(0.35, 1.0), dt))
            add(np.full(int(rng.uniform(0.05, 0.5) / dt), x))
    elif kind == "triangle":
        while have < n:
            a = rng.uniform(0.25, 0.9) * A
            v = wmax * math.exp(rng.uniform(math.log(0.06), math.log(0.8)))
            a = min(a, 0.6 * v)          # a swing of at most 1.2 s
            for g in (a, -a):
                add(move(x, g, v, al * rng.uniform(0.5, 0.9), dt))
                add(np.full(int(rng.uniform(0.1, 0.4) / dt), x))
    else:  # staircase of speeds
        lv = np.array([0.02, 0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.0]) * wmax * rng.uniform(0.8, 1.0)
        if rng.random() < 0.4:
            rng.shuffle(lv)
        tmax = rng.uniform(0.4, 0.9)
        while have < n:
            for v in lv:
                a = min(0.9 * A, 0.5 * v * tmax)
                acc = al * 0.6
                add(move(x, a, v, acc, dt))
                add(move(x, -a, v, acc, dt))
                if rng.random() < 0.2:
                    add(np.full(int(0.2 / dt), x))
    return np.concatenate(parts)[:n]


# ------------------------------------------------------------------ drawing a rig
def lu(rng, a, b):
    return float(math.exp(rng.uniform(math.log(a), math.log(b))))


class Redraw(Exception):
    pass


def merge_needs(names):
    n = {}
    for e in names:
        for k, v in NEED.get(e, {}).items():
            if k == "drive":
                n["drive"] = n.get("drive", ANY) & v
            elif k == "runs":
                n["runs"] = max(v, n.get("runs", 0))
            else:
                n[k] = v
    return n


def draw_rig(rng, names):
    need = merge_needs(names)
    r = dict(need=need)
    drives = sorted(need.get("drive", ANY))
    if not drives:
        raise Redraw("drive")
    wt = dict(current=0.45, current_voltage=0.25, torque=0.12, voltage=0.18)
    p = np.array([wt[d] for d in drives])
    drive = str(rng.choice(drives, p=p / p.sum()))
    ideal = (not need.get("closed")) and drive in ("current", "torque") and rng.random() < 0.22
    if need.get("delay"):
        drive = "voltage" if ("voltage" in drives and rng.random() < 0.6) or "current" not in drives else "current"
        if drive not in drives:
            raise Redraw("delay")
    kinds = ["disc", "screw", "belt", "geared", "torque_motor"]
    pk = np.array([0.3, 0.2, 0.12, 0.23, 0.15])
    if need.get("rotary") or (need.get("delay") and drive == "current"):
        pk[1] = pk[2] = 0
    if need.get("user"):
        pk = np.array([0, 0, 0, 1.0, 0])
    kind = str(rng.choice(kinds, p=pk / pk.sum()))
    r.update(drive=drive, ideal=ideal, kind=kind, linear=kind in ("screw", "belt"))
    lim = dict(disc=(1e-6, 1e-2, 30, 300), screw=(2e-5, 2e-3, 50, 250), belt=(1e-4, 5e-3, 10, 60),
               geared=(1e-6, 1e-3, 50, 400), torque_motor=(1e-3, 1e-2, 3, 20))[kind]
    J = lu(rng, lim[0], lim[1])
    wlo = lim[2] if kind == "torque_motor" else max(lim[2], 150 * (J / 1e-6) ** -0.35)   # small machines are fast ones
    wmax = lu(rng, min(wlo, 0.7 * lim[3]), lim[3])
    tacc = lu(rng, 0.04, 0.25) if not need.get("fast") else lu(rng, 0.03, 0.1)
    al = wmax / tacc
    A = wmax * rng.uniform(0.3, 1.3)
    if need.get("fine"):
        A = wmax * rng.uniform(0.2, 0.6)
    r["lead"] = float(rng.choice([0.004, 0.005, 0.01, 0.02])) if kind == "screw" else float(rng.choice([0.06, 0.1, 0.15]))
    r["gear"] = int(rng.choice([5, 10, 20, 30, 50, 100])) if kind == "geared" else 1
    Td = 0.4 * J * al
    if need.get("friction"):
        Fc = Td * rng.uniform(0.3, 0.8)
    else:
        Fc = Td * rng.uniform(0.08, 0.5)
    C = Td * rng.uniform(0.05, 0.4) / wmax
    if need.get("temperature"):
        C = 0.05 * Fc / wmax * rng.uniform(0.3, 1)
    Tl = 2.2 * (J * al + Fc + C * wmax)
    r.update(J=J, wmax=wmax, alpha=al, A=A, Td=Td, Fc=Fc, C=C, Tl=Tl)
    imax = float(np.clip(lu(rng, 0.3, 1.0) * (Tl * wmax) ** 0.4, 3.0 if need.get("amps") else 0.15, 40))
    kt = Tl / imax
    R = rng.uniform(0.25, 1.3) * kt * wmax / imax
    L = R * lu(rng, 0.7e-3, 5e-3)
    r.update(imax=imax, kt=kt, R=R, L=L, Vs=float(f"{1.8 * (kt * wmax * 1.3 + 1.3 * R * imax):.2g}"))
    if drive == "voltage":
        r["Vs"] *= 8          # an amplifier with headroom: what it is asked for is what flows, but for its lag
    r["fc"] = lu(rng, 300, 1500) if drive != "voltage" else lu(rng, 800, 1500)
    r["fctl"] = int(rng.choice([1000, 2000, 4000, 8000], p=[0.2, 0.3, 0.35, 0.15]))
    r["fs"] = int(rng.choice([24000, 32000, 40000]))
    bw = rng.uniform(14, 45)
    if need.get("fast"):
        bw = rng.uniform(25, 50)
    bw = min(bw, r["fctl"] / 40.0, r["fc"] / 8)
    ws = TAU * bw
    r.update(ws=ws, kv=ws / rng.uniform(4, 6.5), kp=J * ws / kt, ki=J * ws / kt * ws / rng.uniform(4, 8))
    # sensors
    vel = str(rng.choice(["tacho", "drive", "none"], p=[0.42, 0.33, 0.25]))
    pos = True
    if ideal and vel == "drive":
        vel = "tacho"
    if not need.get("position") and vel == "tacho" and not need.get("delay") and rng.random() < 0.12:
        pos = False
    counts = int(rng.choice([1000, 2000, 4000, 4096, 8192, 10000, 16384, 65536, 2 ** 17, 2 ** 20]))
    ff = max(rng.uniform(100, 400), 5 * bw)
    r["ffilt"] = ff
    while vel != "tacho" and TAU / counts * TAU * ff * J * ws > 0.015 * Tl:
        counts *= 4
    while vel == "tacho" and TAU / counts * r["kv"] * J * ws > 0.02 * Tl:
        counts *= 4
    if kind in ("torque_motor",):
        counts = max(counts, 16384)
    r.update(vel=vel, pos=pos, counts=counts, vsig=min(wmax * lu(rng, 3e-4, 3e-3), 0.008 * Tl / (J * ws)), isig=imax * lu(rng, 4e-4, 4e-3),
             ires=2 * imax / 2 ** int(rng.choice([10, 12, 14, 16], p=[0.1, 0.4, 0.3, 0.2])) if rng.random() < 0.7 else 0.0,
             ioff=float(np.clip(rng.normal(0, 1), -2, 2)) * 0.001 * 2 * imax, possig=0.0,
             usersig=0.0, vvsig=r["Vs"] * lu(rng, 5e-4, 3e-3), vdcsig=r["Vs"] * lu(rng, 5e-4, 2e-3))
    # runs
    nr = int(rng.integers(max(2, need.get("runs", 2)), 5))
    cmds = ["multisine", "trapezoid", "triangle", "sweep", "staircase"] + ([] if ideal else ["random_steps"])
    first = []
    if need.get("fast"):
        first = ["multisine"]
    elif need.get("slow"):
        first = [str(rng.choice(["staircase", "triangle"]))]
    rest = [c for c in cmds if c not in first]
    rng.shuffle(rest)
    plan = first + rest[: nr - len(first)]
    nfit = nr - 1 if nr <= 3 else int(rng.integers(2, 4))
    if nr == 2 and need.get("slow") and plan[1] not in ("triangle", "trapezoid", "random_steps", "staircase"):
        plan[1] = [c for c in ("triangle", "trapezoid", "staircase") if c != plan[0]][0]
    if need.get("fast"):
        plan[-1] = "sweep" if plan[-1] not in ("random_steps", "sweep") else plan[-1]
    if len(set(plan)) < nr:
        raise Redraw("plan")
    r["plan"] = plan
    r["roles"] = ["fit"] * nfit + ["heldout"] * (nr - nfit)
    r["fhi"] = float(min(rng.uniform(4, 12) * (2.0 if need.get("fast") else 1.0), bw))
    r["lengths"] = [round(rng.uniform(8, 25), 1) for _ in range(nr)]
    fr = float(rng.choice([500, 1000, 2000, 2500, 4000, 5000, 10000], p=[0.12, 0.28, 0.2, 0.12, 0.12, 0.1, 0.06]))
    if need.get("fast") or drive == "current_voltage" or need.get("delay"):
        fr = max(fr, 1000.0)
    if fr >= 4000:
        r["lengths"] = [round(max(8.0, x * 0.6), 1) for x in r["lengths"]]
    while fr * sum(r["lengths"]) > 300e3:
        r["lengths"] = [round(max(8.0, x * 0.8), 1) for x in r["lengths"]]
        if max(r["lengths"]) <= 8.0:
            break
    r["fr"] = fr
    # the controller is published or not
    ctl = False
    if not ideal and kind in ("disc", "torque_motor") and pos and vel != "none" and drive in ("current", "voltage", "current_voltage"):
        ctl = rng.random() < 0.4
    if need.get("delay") and drive == "current":
        if kind not in ("disc", "torque_motor"):
            r["kind"], r["linear"], r["gear"] = "disc", False, 1
        if vel == "none":
            r["vel"] = vel = "tacho"
        ctl = True
    r["controller"] = ctl
    r["ff"] = 0.0 if ctl or rng.random() < 0.4 else 1.0
    r["show_cmd"] = ctl or (not ideal and rng.random() < 0.35)
    r["show_user"] = bool(need.get("user")) or (kind == "geared" and not ideal and rng.random() < 0.25)
    r["user_counts"] = int(rng.choice([2 ** 16, 2 ** 17, 2 ** 19]))
    r["load"] = bool(need.get("load")) or (not r["linear"] and rng.random() < 0.08)
    r["temp"] = bool(need.get("temperature")) or rng.random() < 0.06
    r["vdc"] = bool(need.get("vdc")) or (drive == "current_voltage" and rng.random() < 0.3)
    # clock and delays
    r["jitter"] = rng.uniform(0.01, 0.1) if rng.random() < 0.33 else 0.0
    r["delay"] = None
    if not ctl and not need.get("delay") and rng.random() < 0.3:
        which = str(rng.choice(["motion", "drive", "velocity"]))
        said = bool(rng.random() < 0.5) or drive == "voltage"
        if which == "velocity" and (vel == "none" or not pos):
            which = "motion"
        r["delay"] = dict(which=which, s=round(float(rng.uniform(0.2e-3, 2e-3)), 5), said=said)
    r["sampling"] = "mean" if rng.random() < (0.85 if drive == "current_voltage" else 0.5) else "point"
    r["seed_runs"] = [int(x) for x in rng.integers(0, 2 ** 31, nr)]
    r["seed_bench"] = int(rng.integers(0, 2 ** 31))
    r["csup"] = None
    return r


def draw_effect(rng, name, r):
    """parameters (amount: first guess), and the index of the amount"""
    w, A, Td, J, Fc = r["wmax"], r["A"], r["Td"], r["J"], r["Fc"]
    ph = float(rng.uniform(0, TAU))
    amt = rng.uniform(0.04, 0.105)      # wanted share
    t0 = amt * Td
    sg = float(rng.choice([-1, 1]))

    def order(lo_n=1, hi=48):
        lo = 2.5 * TAU / A
        top = 35 * TAU / (0.35 * w)
        if r["linear"] or r["kind"] == "geared":
            g = r["gear"] if r["gear"] > 1 else int(rng.choice([2, 3, 5]))
            cand = [1 / g, 2 / g, 3 / g] + list(range(1, hi + 1))
        else:
            cand = list(range(1, hi + 1)) + [1 / 20, 1 / 10, 1 / 3, 2.5, 7.2]
        cand = [c for c in cand if lo <= c <= top]
        if not cand:
            raise Redraw("order")
        c = np.array(cand, float)
        p = 1 / c ** 0.7
        return float(rng.choice(c, p=p / p.sum()))

    lim = (0.0, math.inf)
    g = 1.0
    if name == "stribeck":
        v = [t0 * 2, w * lu(rng, 0.015, 0.12), float(rng.choice([1.0, 1.0, 2.0, round(rng.uniform(0.7, 2), 2)]))]; lim = (0, 1.5 * Fc)
    elif name == "lubricated_rise":
        v = [t0 * 2, w * lu(rng, 0.06, 0.4)]; lim = (0, 2.5 * Fc)
    elif name == "quadratic_drag":
        v = [t0 / (0.2 * w * w)]
    elif name == "viscous_asymmetry":
        v = [sg * t0 / (0.3 * w)]
    elif name == "bias_torque":
        v = [sg * t0]
    elif name == "load_dependent_friction":
        v = [0.08]; lim = (0, 0.6)
    elif name == "temperature_dependent_friction":
        v = [-0.006]; lim = (0, 0.015)
    elif name == "periodic_friction":
        v = [t0 * 1.4, ph, order(hi=12)]; lim = (0, 0.8 * Fc)
    elif name == "tight_spot":
        v = [t0 * 3, rng.uniform(-0.25, 0.25) * A, A * rng.uniform(0.06, 0.2)]; lim = (0, 3 * Fc)
    elif name == "presliding":
        d = lu(rng, 0.0008, 0.008) * A
        k = Fc / d
        v = [k, 2 * rng.uniform(0.15, 0.7) * math.sqrt(k * J)]; g = -1.5
    elif name == "cogging":
        v = [t0 * 1.4, ph, order()]
    elif name == "torque_ripple":
        v = [amt * 1.4, ph, order()]; lim = (0, 0.3)
    elif name == "torque_saturation":
        v = [0.4 / r["imax"]]; lim = (0, 0.22 / r["imax"] * 3)
    elif name == "spring_load":
        v = [t0 / (0.4 * A), rng.uniform(-0.3, 0.3) * A]
    elif name == "compliance":
        q = rng.uniform(0.25, 0.6)
        f = rng.uniform(14, 35)
        J2 = q * J
        k = J2 * (TAU * f) ** 2
        v = [k, 2 * rng.uniform(0.02, 0.08) * math.sqrt(k * J2), J2]; g = -1.0
    elif name == "backlash":
        v = [lu(rng, 0.004, 0.02) * r["gear"]]
    elif name == "winding_heating":
        v = [40.0]; lim = (12, 110)
    elif name == "supply_sag":
        v = [0.03 * r["Vs"] / r["imax"]]
    elif name == "dead_time":
        v = [amt * 0.4 * r["Vs"]]
    elif name == "encoder_eccentricity":
        v = [0.01, ph]; lim = (0, 0.08)
    elif name == "current_offset":
        v = [sg * t0 / r["kt"]]
    elif name == "current_gain":
        v = [sg * amt]; amt = max(amt, 0.06)
    elif name == "control_delay":
        v = [0.002]; lim = (0.4e-3, 5e-3)
    elif name == "random_friction":
        v = [t0 * 1.5, A * rng.uniform(0.06, 0.15)]; lim = (0, 0.45 * Fc)
    elif name == "eddy_brake":
        v = [t0 / (0.25 * w), w * rng.uniform(0.15, 0.4)]
    elif name == "hysteresis":
        v = [t0 * 1.5, A * rng.uniform(0.05, 0.2)]
    elif name == "cubic_cable":
        v = [t0 * 4, A, rng.uniform(-0.1, 0.1) * A]
    elif name == "current_cubic":
        v = [0.5 / r["imax"] ** 2]; lim = (0, 1.5 / r["imax"] ** 2)
    elif name == "ageing":
        v = [t0 * 0.7, A * lu(rng, 0.005, 0.02), 0.01]; lim = (0, 0.25 * Fc)
    elif name == "critical_speed":
        s = w * rng.uniform(0.3, 0.6)
        v = [t0 * 2, s, s * rng.uniform(0.15, 0.3)]
    elif name == "saturating_viscous":
        v = [t0 * 1.2, w * rng.uniform(0.08, 0.25)]
    elif name == "variable_inertia":
        o = order(hi=4)
        v = [0.12 * J, ph, o]; lim = (0, 0.5 * J)
    else:
        raise SystemExit(f"unknown effect {name}")
    return dict(name=name, v=[float(x) for x in v], want=float(amt), lim=lim, power=g)


# ------------------------------------------------------------------ running a rig
def pvec(r):
    P = np.zeros(NP)
    fs = r["fs"]
    P[J_], P[C_], P[FC_], P[KT_], P[KE_], P[R_], P[L_] = r["J"], r["C"], r["Fc"], r["kt"], r["kt"], r["R"], r["L"]
    P[KPC_], P[KIC_], P[VS_] = r["L"] * TAU * r["fc"], r["R"] * TAU * r["fc"], r["Vs"]
    P[KPP_], P[KP_], P[KI_], P[WLIM_], P[ULIM_], P[FF_] = r["kv"], r["kp"], r["ki"], 1.3 * r["wmax"], r["imax"], r["ff"]
    P[RES_] = TAU / r["counts"]
    P[VMODE_] = 0 if r["vel"] == "tacho" else 1
    P[VSIG_] = r["vsig"]
    P[EMF_] = 1.0 if r["drive"] == "voltage" or r["controller"] else 0.0     # back-EMF fed forward: the current is what is asked for, but for the lag
    P[DT_] = 1.0 / fs
    P[M_] = fs // r["fctl"]
    P[AF_] = 1 - math.exp(-TAU * r["ffilt"] / r["fctl"])
    P[PLO_] = -1.3 * r["A"]
    P[PSTEP_] = 2.6 * r["A"] / 600
    return P


def profile(r, effects):
    for e in effects:
        if e["name"] == "random_friction":
            q = np.random.default_rng(r["seed_bench"] + 7)
            x = q.normal(size=600)
            k = e["v"][1] / (2.6 * r["A"] / 600)
            g = np.exp(-0.5 * (np.fft.fftfreq(600) * TAU * k) ** 2)
            x = np.fft.ifft(np.fft.fft(x) * g).real
            x -= x.mean()
            return x / x.std()
    return np.zeros(2)


def run_inputs(r, k):
    rng = np.random.default_rng(r["seed_runs"][k])
    dt = 1.0 / r["fs"]
    T = r["lengths"][k]
    sc = dict(A=r["A"], wmax=r["wmax"], alpha=r["alpha"], fhi=r["fhi"])
    x = command(r["plan"][k], rng, T, dt, sc)
    n = len(x)
    t = np.arange(n) * dt
    load = np.zeros(n)
    if r["load"]:
        a = r["Td"] * rng.uniform(0.5, 0.9)
        lv = rng.uniform(-1, 1, int(T / 1.2) + 3)
        tk = np.arange(len(lv)) * 1.2
        load = a * (0.75 * np.interp(t, np.sort(np.concatenate([tk, tk + 1.0])), np.repeat(lv, 2)) + 0.25 * np.sin(TAU * rng.uniform(0.2, 0.6) * t))
    temp = np.full(n, 22.0)
    if r["temp"]:
        base = [15.0, 46.0, 31.0, 58.0]
        temp = base[k % 4] + rng.uniform(-3, 3) + rng.uniform(4, 12) * (1 - np.exp(-t / 10.0))
    noise = rng.normal(size=n // (r["fs"] // r["fctl"]) + 2)
    return x, load, temp, noise


def run_rig(r, effects, k, inputs):
    x, load, temp, noise = inputs
    code = np.zeros(2, np.int64)
    E = np.zeros((2, 4))
    for j, e in enumerate(effects):
        code[j] = CODE[e["name"]]
        E[j, : len(e["v"])] = e["v"]
    P = pvec(r)
    P[CSUP_] = 1e-4
    for e in effects:
        if e["name"] == "supply_sag":
            P[CSUP_] = 2e-4 / e["v"][0]
    out = np.zeros((NCH, len(x)))
    prof = profile(r, effects)
    if r["ideal"]:
        w = np.zeros_like(x)
        w[1:-1] = (x[2:] - x[:-2]) * (0.5 * r["fs"])
        w[np.abs(w) < 1e-7 * r["wmax"]] = 0.0
        acc = np.zeros_like(x)
        acc[1:-1] = (w[2:] - w[:-2]) * (0.5 * r["fs"])
        inverse(x, w, acc, load, temp, P, code, E, prof, out)
    else:
        simulate(x, load, temp, noise, P, code, E, prof, out)
    return out


def blocks(y, nb):
    n = len(y) // nb * nb
    return y[:n].reshape(-1, nb).mean(1)


def band(y, fb, part=0.9):
    s = np.abs(np.fft.rfft(y - y.mean())) ** 2
    c = np.cumsum(s)
    if c[-1] <= 0:
        return 5.0
    return float(np.searchsorted(c, part * c[-1]) * fb / len(y))


def equation_noise(r, B, electrical=False, name=""):
    """rms of the noise of the drive's equation below B Hz"""
    fr = r["fr"]
    if name == "supply_sag":
        return r["vdcsig"] * math.sqrt(min(1.0, 2 * B / fr))
    si = math.sqrt(r["isig"] ** 2 + r["ires"] ** 2 / 12)
    q = TAU / r["counts"]
    if electrical:
        s = (r["vvsig"] ** 2 + (r["R"] * si) ** 2) * 2 * B / fr + (r["L"] * si * TAU) ** 2 * 2 / fr * B ** 3 / 3
        return math.sqrt(s)
    s = (r["kt"] * si) ** 2 * 2 * B / fr
    cand = []
    if r["vel"] == "tacho":
        cand.append((r["J"] * TAU * r["vsig"]) ** 2 * 2 / fr * B ** 3 / 3)
    if r["pos"]:
        cand.append((r["J"] * TAU ** 2) ** 2 * 2 * q * q / 12 / fr * B ** 5 / 5)
    return math.sqrt(s + min(cand))


def assess(r, effects, outs):
    """shares of every effect, overall and by role; raises Redraw if the rig does not move"""
    nb = int(r["fs"] / 1000)
    fb = r["fs"] / nb
    kt = r["kt"]
    cols = {q: [] for q in ("dw", "w", "s", "i", "di", "v", "role")}
    terms = [[] for _ in effects]
    for k, o in enumerate(outs):
        w = o[W]
        n = len(w) // nb * nb
        wb = w[:n:nb]
        dw = np.append(np.diff(wb), 0) * fb
        i = o[I]
        ib = i[:n:nb]
        cols["dw"].append(dw)
        cols["w"].append(blocks(w, nb))
        cols["s"].append(blocks(np.sign(w), nb))
        cols["i"].append(blocks(i, nb))
        cols["di"].append(np.append(np.diff(ib), 0) * fb)
        cols["v"].append(blocks(o[V], nb))
        cols["role"].append(np.full(n // nb, k))
        for j, e in enumerate(effects):
            if e["name"] == "encoder_eccentricity":
                x = o[TH][:n:nb]
                z = e["v"][0] * np.sin(x + e["v"][1])
                terms[j].append(np.concatenate([[0], z[2:] - 2 * z[1:-1] + z[:-2], [0]]) * fb * fb * r["J"])
            elif e["name"] == "backlash":
                terms[j].append(blocks(o[TH] - o[USER], nb))
            else:
                terms[j].append(blocks(o[T1 + j], nb))
        if np.ptp(o[TH]) < 0.1 * r["A"] and r["plan"][k] not in ("sweep", "multisine"):
            raise Redraw("stands still")
        if not np.isfinite(o[:, -1]).all() or np.abs(o[TH]).max() > 6 * r["A"]:
            raise Redraw("unstable")
        if np.mean(np.abs(o[U]) > 0.99 * r["imax"]) > 0.05 and not r["ideal"]:
            raise Redraw("saturated")
    c = {q: np.concatenate(v) for q, v in cols.items()}
    drive = kt * np.sqrt(np.mean(c["i"] ** 2))
    volt = np.sqrt(np.mean(c["v"] ** 2))
    res = []
    for j, e in enumerate(effects):
        t = np.concatenate(terms[j])
        nm = e["name"]
        el = nm in ELECTRICAL
        ref = volt if el else drive
        if nm == "winding_heating" or nm == "supply_sag" or nm in ("current_offset", "current_gain", "bias_torque"):
            net = t
            if nm == "winding_heating":
                X = np.c_[c["w"], c["di"]]
                net = t - X @ np.linalg.lstsq(X, t, rcond=None)[0]
        else:
            if el:
                X = np.c_[c["i"], c["di"], c["w"]]
            else:
                X = [c["dw"], c["w"], c["s"]]
                if nm in ("torque_saturation", "current_cubic"):
                    X.append(c["i"])
                X = np.array(X).T
            X = X / np.maximum(np.abs(X).max(0), 1e-30)
            net = t - X @ np.linalg.lstsq(X, t, rcond=None)[0]
        B = min(max(max(band(x, fb) for x in terms[j]), 5.0), 150.0)
        rms = lambda y: float(np.sqrt(np.mean(y * y)))
        fit = np.isin(c["role"], [k for k, q in enumerate(r["roles"]) if q == "fit"])
        d = dict(raw=rms(t) / ref, net=rms(net) / ref, noise=equation_noise(r, B, el, nm) / ref, band=B,
                 fit=rms(net[fit]) / ref, heldout=rms(net[~fit]) / ref)
        if nm == "backlash":
            q = e["v"][0]
            un = max(TAU / r["user_counts"] * r["gear"], TAU / r["counts"]) / math.sqrt(12)
            d = dict(raw=0.5 * q / rms(np.concatenate([o[TH][::nb] for o in outs])), net=0.5 * q, noise=un, band=0.0, fit=0.5 * q, heldout=0.5 * q)
        res.append(d)
    return res, drive, volt


def fits(nm, a):
    if nm == "backlash":
        return a["net"] >= 5 * a["noise"]
    return 0.03 <= a["raw"] <= 0.12 and a["net"] >= max(0.015, 3 * a["noise"]) and a["fit"] > 0.012 and a["heldout"] > 0.01


def settle(rng, names):
    """a rig with effects of the wanted severity, and its true motion"""
    r = draw_rig(rng, names)
    effects = [draw_effect(rng, n, r) for n in names]
    inputs = [run_inputs(r, k) for k in range(len(r["plan"]))]
    for it in range(5):
        outs = [run_rig(r, effects, k, inputs[k]) for k in range(len(inputs))]
        res, drive, volt = assess(r, effects, outs)
        if all(fits(e["name"], a) for e, a in zip(effects, res)):
            return r, effects, inputs, outs, res, drive, volt
        for e, a in zip(effects, res):
            if fits(e["name"], a):
                continue
            if a["net"] < 3 * a["noise"] * 1.05 and e["name"] != "backlash" and it < 4:
                r["vsig"] *= 0.4
                r["isig"] *= 0.5
                r["ires"] *= 0.5
                r["vvsig"] *= 0.5
                r["vdcsig"] *= 0.5
                if r["counts"] < 2 ** 20:
                    r["counts"] *= 4
            if e["name"] == "backlash":
                r["user_counts"] = 2 ** 19
                r["counts"] = max(r["counts"], 16384)
                continue
            need = max(0.017 / max(a["net"], 1e-9), 0.014 / max(a["fit"], 1e-9), 0.012 / max(a["heldout"], 1e-9)) * a["raw"]
            want = max(e["want"], need)
            if want > 0.118:
                if need > 0.125:
                    raise Redraw("would be too large: " + e["name"])
                want = 0.116
            k = 1
            f = want / max(a["raw"], 1e-9)
            f = min(max(f, 0.15), 6.0)
            if e["name"] in ("presliding", "compliance"):
                f = f ** (-1.3 if e["name"] == "presliding" else -1.0)
                e["v"][0] *= f
                e["v"][1] *= math.sqrt(f)
            else:
                e["v"][0] *= f
            if not e["lim"][0] <= abs(e["v"][0]) <= e["lim"][1]:
                raise Redraw("limit: " + e["name"])
    raise Redraw("does not settle: " + " ".join(f"{e['name']} {a}" for e, a in zip(effects, res)))


# ------------------------------------------------------------------ measuring
class Fine:
    """a true signal at the fine rate, to be sampled at any moment"""

    def __init__(self, y, fs, held=False):
        self.y, self.fs, self.held, self.c = y, fs, held, None

    def at(self, t):
        x = np.clip(t * self.fs, 0, len(self.y) - 1.001)
        k = x.astype(np.int64)
        if self.held:
            return self.y[k]
        f = x - k
        return self.y[k] * (1 - f) + self.y[k + 1] * f

    def mean(self, t):
        """over the interval that ends at each t"""
        if self.c is None:
            # integral of what at() gives
            s = self.y[:-1] if self.held else 0.5 * (self.y[1:] + self.y[:-1])
            self.c = np.concatenate([[0.0], np.cumsum(s)]) / self.fs
        h = np.diff(t, prepend=2 * t[0] - t[1])
        g = np.arange(len(self.c)) / self.fs
        a = np.interp(t - h, g, self.c)
        b = np.interp(t, g, self.c)
        return (b - a) / h


def grain(y, q):
    return np.round(y / q) * q if q > 0 else y


def num(x):
    return f"{x:.6g}"


def tq(v, unit, trust=None):
    s = f"{{ value = {num(v)}" + (f', unit = "{unit}"' if unit else "")
    if trust is not None:
        s += f", trust = {num(trust)}"
    return s + " }"


def bare(x, style):
    return num(x) if style == "plain" else f"{{ value = {num(x)} }}"


UN = {"s": 1, "ms": 1e-3, "us": 1e-6, "rad": 1, "deg": math.pi / 180, "turn": TAU, "m": 1, "mm": 1e-3, "um": 1e-6, "rad/s": 1,
      "deg/s": math.pi / 180, "rpm": TAU / 60, "m/s": 1, "mm/s": 1e-3, "A": 1, "mA": 1e-3, "V": 1, "mV": 1e-3, "N m": 1, "mN m": 1e-3, "N": 1,
      "degC": 1}


def write_case(path, cls, r, effects, inputs, outs, case):
    rng = np.random.default_rng(r["seed_bench"])
    os.makedirs(path, exist_ok=True)
    lin = r["linear"]
    per = r["lead"] / TAU if lin else 1.0     # metres a rad
    names = [e["name"] for e in effects]
    par = {e["name"]: e["v"] for e in effects}
    pick = lambda *a: str(rng.choice(a))
    ch = {}                                    # channel -> dict(column, unit, keys)

    def say_noise(p=0.5):
        return rng.random() < p

    tu = pick("s", "s", "ms", "us")
    ch["time"] = dict(column=pick("t", "time", "Time_" + tu, "stamp"), unit=tu)
    pu = pick("mm", "mm", "m", "um") if lin else pick("deg", "rad", "deg", "turn")
    vu = pick("mm/s", "m/s") if lin else pick("rpm", "rad/s", "deg/s", "rpm")
    d = r["delay"]
    if r["pos"]:
        ch["position"] = dict(column=pick("pos", "theta", "position", "enc") if not lin else pick("x", "pos", "axis_pos"), unit=pu)
        if rng.random() < 0.7:
            ch["position"]["resolution"] = TAU / r["counts"] * per / UN[pu]
    if r["vel"] != "none":
        ch["velocity"] = dict(column=pick("speed", "omega", "vel", "n_act"), unit=vu)
        if r["vel"] == "tacho" and say_noise():
            ch["velocity"]["noise"] = r["vsig"] * per / UN[vu]
    if r["show_cmd"]:
        ch["command"] = dict(column=pick("cmd", "ref", "setpoint"), unit=pu)
    if r["show_user"]:
        uu = pick("deg", "rad")
        ch["user_position"] = dict(column=pick("out_pos", "load_enc"), unit=uu, resolution=TAU / r["user_counts"] / UN[uu])
    drive = r["drive"]
    mean = r["sampling"] == "mean" and not r["ideal"] or (r["ideal"] and rng.random() < 0.5)
    samp = "mean" if mean else "point"
    cn = math.sqrt(r["isig"] ** 2 + r["ires"] ** 2 / 12)
    iscale = 1.0
    if drive in CURRENT:
        cu = pick("A", "A", "mA")
        c = ch["current"] = dict(column=pick("i_q", "current", "I", "iq_act"), unit=cu, sampling=samp)
        if rng.random() < 0.1:
            iscale = float(rng.choice([-1.0, 2.0, 5.0]))
            c["scale"] = iscale
        else:
            if r["ires"] > 0 and rng.random() < 0.5:
                c["resolution"] = r["ires"] / UN[cu]
            if say_noise():
                c["noise"] = cn / UN[cu]
        if rng.random() < 0.3 and "current_offset" not in names and iscale == 1.0:
            c["offset"] = 0.001 * 2 * r["imax"] / UN[cu]
        if drive == "current_voltage":
            wu = pick("V", "V", "mV")
            ch["voltage"] = dict(column=pick("u_q", "voltage", "V"), unit=wu, sampling=samp)
            if say_noise():
                ch["voltage"]["noise"] = r["vvsig"] / UN[wu]
    elif drive == "torque":
        fu = "N" if lin else pick("N m", "mN m")
        nm = "force" if lin else "torque"
        ch[nm] = dict(column=pick("drive_" + nm, nm[0].upper()), unit=fu)
        if nm == "torque" or not mean:
            ch[nm]["sampling"] = samp
        else:
            ch[nm]["sampling"] = samp
        if say_noise():
            ch[nm]["noise"] = cn * r["kt"] / (per if lin else 1.0) / UN[fu]
    else:
        ga = 10.0 / r["imax"]                 # +-10 V at the limit
        ch["voltage"] = dict(column=pick("u", "amp_in", "dac"), unit=pick("V", "mV"), sampling=samp)
        if say_noise():
            ch["voltage"]["noise"] = cn * ga / UN[ch["voltage"]["unit"]]
    if r["load"]:
        ch["load"] = dict(column="load", unit=pick("N m", "mN m"))
    if r["temp"]:
        ch["temperature"] = dict(column=pick("temp", "T_oil"), unit="degC")
    if r["vdc"]:
        ch["v_dc"] = dict(column=pick("udc", "bus"), unit="V")
        if say_noise():
            ch["v_dc"]["noise"] = r["vdcsig"]
    if d and d["said"]:
        for c in (["position", "velocity", "user_position"] if d["which"] == "motion" else ["velocity"] if d["which"] == "velocity" else ["current", "voltage", "torque", "force"]):
            if c in ch:
                ch[c]["delay_s"] = d["s"]
    # ---- recordings
    files = []
    start = 0.0 if rng.random() < 0.6 else round(float(rng.uniform(0.5, 40)), 3)
    swap = rng.permutation(len(ch) - 1)
    dm = d["s"] if d and d["which"] == "motion" else 0.0
    dv = d["s"] if d and d["which"] in ("motion", "velocity") else 0.0
    dd = d["s"] if d and d["which"] == "drive" else 0.0
    for k, o in enumerate(outs):
        fs = r["fs"]
        T = o.shape[1] / fs
        h = 1 / r["fr"]
        t = np.arange(int((T - 0.01) / h)) * h + 0.004
        if r["jitter"]:
            t = t + rng.normal(0, 1, len(t)).clip(-3, 3) * r["jitter"] * h
        t = np.round(t, 7)
        n = len(t)
        x, load, temp, _ = inputs[k]
        cols = {"time": t - t[0] + start}
        if r["pos"]:
            th = Fine(o[TH], fs).at(t - dm)
            if "encoder_eccentricity" in par:
                th = th + par["encoder_eccentricity"][0] * np.sin(th + par["encoder_eccentricity"][1])
            cols["position"] = grain(th, TAU / r["counts"]) * per
        if r["vel"] == "tacho":
            cols["velocity"] = (Fine(o[W], fs).at(t - dv) + r["vsig"] * rng.normal(size=n)) * per
        elif r["vel"] == "drive":
            cols["velocity"] = Fine(o[VM], fs, True).at(t - dv) * per
        if "command" in ch:
            cols["command"] = Fine(x, fs, True).at(t) * per / r["gear"]
        if "user_position" in ch:
            cols["user_position"] = grain(Fine(o[USER], fs).at(t - dm) / r["gear"], TAU / r["user_counts"])
        get = (lambda y, held=False: Fine(y, fs, held).mean(t - dd)) if mean else (lambda y, held=False: Fine(y, fs, held).at(t - dd))
        if drive in CURRENT:
            i = o[I]
            im = i * (1 + par.get("current_gain", [0])[0]) + par.get("current_offset", [0])[0] + par.get("current_cubic", [0])[0] * i ** 3
            cols["current"] = grain(get(im) + r["ioff"] + r["isig"] * rng.normal(size=n), r["ires"]) / iscale
            if drive == "current_voltage":
                cols["voltage"] = get(o[V], True) + r["vvsig"] * rng.normal(size=n)
        elif drive == "torque":
            y = get(o[I]) + r["ioff"] + r["isig"] * rng.normal(size=n)
            cols["force" if lin else "torque"] = grain(y, r["ires"]) * r["kt"] / (per if lin else 1.0)
        else:
            y = get(o[U], True) + r["ioff"] + r["isig"] * rng.normal(size=n)
            cols["voltage"] = grain(y, r["ires"]) * ga
        if r["load"]:
            cols["load"] = Fine(load, fs).at(t) + 0.004 * r["Td"] * rng.normal(size=n)
        if r["temp"]:
            cols["temperature"] = grain(Fine(temp, fs).at(t) + 0.05 * rng.normal(size=n), 0.1)
        if r["vdc"]:
            cols["v_dc"] = Fine(o[VDC], fs).at(t) + r["vdcsig"] * rng.normal(size=n)
        head = ["time"] + [list(ch)[1 + s] for s in swap]
        data = [cols[c] / UN[ch[c]["unit"]] for c in head]
        f = f"{r['plan'][k]}_{k + 1}.csv"
        files.append(f)
        fm = ",".join("%.10g" for _ in data)
        with open(os.path.join(path, f), "w") as fh:
            fh.write(",".join(ch[c]["column"] for c in head) + "\n")
            fh.write("\n".join(map(fm.__mod__, zip(*[q.tolist() for q in data]))))
            fh.write("\n")
    # ---- constants as believed
    def believe(v, *trusts):
        s = float(rng.choice(trusts))
        return v * (1 + s * float(np.clip(rng.normal(), -2, 2))), s

    L = [f"# {r['kind'].replace('_', ' ')}, " + {"current": "motor current", "current_voltage": "motor current and voltage", "torque": "drive torque", "voltage": "input of the amplifier"}[drive], "[rig]",
         f'kind = "{"linear" if lin else "rotary"}"']
    if lin:
        L.append("lead_m_per_turn = " + bare(r["lead"], STYLE["lead"]))
    dn = {"current": "current", "current_voltage": "current", "torque": "force" if lin else "torque", "voltage": "voltage"}[drive]
    L.append(f'drive = "{dn}"')
    if dn in ("current", "voltage"):
        k0 = r["kt"] if dn == "current" else r["kt"] / ga
        tight = "current_gain" in names
        v, s = believe(k0, 0.01) if tight else believe(k0, 0.01, 0.02, 0.03, 0.05)
        if lin and dn == "voltage":
            L.append("drive_constant = " + tq(v / per, "N/V", s))
        else:
            L.append("drive_constant = " + tq(v, "N m/A" if dn == "current" else "N m/V", s))
    si = lin and rng.random() < 0.7           # a linear rig speaks of masses and forces
    if rng.random() < (0.85 if "compliance" not in names else 0.5):
        v, s = believe(r["J"], 0.03, 0.05, 0.1, 0.2, 0.3)
        L.append("inertia = " + (tq(v / per ** 2, "kg", s) if si else tq(v, "kg m2", s)))
    if rng.random() < 0.6:
        v, s = believe(r["C"], 0.1, 0.2, 0.3)
        L.append("viscous = " + (tq(v / per ** 2, "N/(m/s)", s) if si else tq(v, "N m s/rad", s)))
    if rng.random() < 0.6:
        v, s = believe(r["Fc"], 0.1, 0.2, 0.3)
        L.append("coulomb = " + (tq(v / per, "N", s) if si else tq(v, "N m", s)))
    if drive == "current_voltage":
        hot = "winding_heating" in names
        if hot or rng.random() < 0.9:
            v, s = believe(r["R"], 0.01, 0.02) if hot else believe(r["R"], 0.02, 0.05, 0.1)
            if "current_offset" in names or "current_gain" in names:
                v, s = believe(r["R"], 0.02, 0.03)
            L.append("resistance = " + tq(v, "ohm", s))
        v, s = believe(r["L"], 0.05, 0.1, 0.2)
        L.append("inductance = " + (tq(v * 1e3, "mH", s) if rng.random() < 0.5 else tq(v, "H", s)))
        if "current_gain" in names or rng.random() < 0.7:
            v, s = believe(r["kt"], 0.01) if "current_gain" in names else believe(r["kt"], 0.01, 0.02, 0.04)
            L.append("back_emf_constant = " + tq(v, "V s/rad", s))
    if r["vdc"]:
        v, s = believe(r["Vs"], 0.002, 0.005)
        L.append("supply_voltage = " + tq(v, "V", s))
    if r["gear"] > 1 and ("user_position" in ch or "command" in ch or rng.random() < 0.5):
        L.append("gear_ratio = " + bare(r["gear"], STYLE["gear_ratio"]))
    if r["controller"]:
        c = lambda x: bare(x, STYLE["controller"])
        f = ga if drive == "voltage" else 1.0
        L += ["", "[rig.controller]", "position_gain = " + c(r["kv"]), "speed_gain = " + c(r["kp"] * f), "integral_gain = " + c(r["ki"] * f),
              "speed_limit = " + c(1.3 * r["wmax"]), "drive_limit = " + c(r["imax"] * f), 'velocity = "measured"', 'position = "motor"',
              f"rate_hz = {r['fctl']}", f"current_time_constant_s = {num(1 / (TAU * r['fc']))}"]
    L += ["", "[channels]"]
    for c, q in ch.items():
        s = ", ".join(f'{a} = "{b}"' if isinstance(b, str) else f"{a} = {num(b)}" for a, b in q.items())
        L.append(f"{c} = {{ {s} }}")
    for f, role in zip(files, r["roles"]):
        L += ["", "[[run]]", f'file = "{f}"', f'role = "{role}"', 'health = "healthy"']
    with open(os.path.join(path, "bench.toml"), "w") as fh:
        fh.write("\n".join(L) + "\n")
    return dict(files=files, ga=(ga if drive == "voltage" else None), offset_torque=r["ioff"] * r["kt"], sampling=samp)


def quieten(r):
    """the same rig with almost perfect sensors and a fast, even clock: what then remains is not noise"""
    for q in ("vsig", "isig", "ires", "vvsig", "vdcsig"):
        r[q] *= 1e-3
    r.update(counts=2 ** 25, user_counts=2 ** 25, fr=8000.0, jitter=0.0)


def build(seed, number, cls=None, effect=None, out=None, quiet=False):
    rng = np.random.default_rng([seed, number])
    if effect:
        cls = "outside" if effect in OUTSIDE else "one"
    if cls is None:
        cls = str(rng.choice(["nothing", "one", "two", "outside"], p=[0.3, 0.4, 0.15, 0.15]))
    why = []
    for attempt in range(60):
        q = np.random.default_rng([seed, number, 1 + attempt])
        # what is asked for stays for a while, so that no effect is thinned out by redraws of rigs
        q0 = np.random.default_rng([seed, number, 1000 + attempt // 12])
        if effect:
            names = [effect]
        elif cls == "nothing":
            names = []
        elif cls == "one":
            names = [str(q0.choice(list(EFFECTS)))]
        elif cls == "outside":
            names = [str(q0.choice(list(OUTSIDE)))]
        else:
            while True:
                names = [str(x) for x in q0.choice(list(EFFECTS), 2, replace=False)]
                if set(names) not in NO_PAIR and merge_needs(names).get("drive", ANY):
                    break
        try:
            r, effects, inputs, outs, res, drive, volt = settle(q, names)
            break
        except Redraw as e:
            why.append(str(e))
    else:
        raise SystemExit(f"case {number}: no rig found for {names}: {why[-5:]}")
    if quiet:
        quieten(r)
        outs = [run_rig(r, effects, k, inputs[k]) for k in range(len(inputs))]
    path = os.path.join(out, f"case_{number:03d}")
    os.makedirs(path, exist_ok=True)
    for f in os.listdir(path):
        if f.endswith(".csv") or f == "bench.toml":
            os.remove(os.path.join(path, f))
    m = write_case(path, cls, r, effects, inputs, outs, number)
    eff = []
    for e, a in zip(effects, res):
        p = dict(zip(ALL[e["name"]][1], e["v"]))
        if e["name"] == "control_delay":
            p["delay"] = round(e["v"][0] * r["fs"]) / r["fs"]
        d = dict(name=e["name"], parameters=p, share=a["raw"], share_beyond_base=a["net"], equation_noise=a["noise"], band_hz=a["band"],
                 share_fit=a["fit"], share_heldout=a["heldout"])
        if e["name"] == "encoder_eccentricity":
            d["reads"] = "angle_and_speed" if r["vel"] == "drive" else "angle"
        if e["name"] == "supply_sag":
            d["draw"] = "power"
        if e["name"] in OUTSIDE:
            d["near"] = NEAR[e["name"]]
        if e["name"] == "random_friction":
            d["profile"] = dict(start=-1.3 * r["A"], step=2.6 * r["A"] / 600, values=[round(float(x), 5) for x in profile(r, effects)])
        eff.append(d)
    con = dict(inertia=r["J"], coulomb=r["Fc"], viscous=r["C"], torque_constant=r["kt"], back_emf_constant=r["kt"], resistance=r["R"], inductance=r["L"],
               drive_constant=r["kt"] / m["ga"] if m["ga"] else r["kt"], supply_voltage=r["Vs"], gear_ratio=r["gear"], lead_m_per_turn=r["lead"] if r["linear"] else None)
    for e in effects:
        if e["name"] == "compliance":
            con["motor_inertia"], con["load_inertia"] = r["J"] - e["v"][2], e["v"][2]
        if e["name"] == "winding_heating":
            con["resistance_cold"] = r["R"]
            con["resistance"] = r["R"] * (1 + 0.00393 * e["v"][0])
    also = []
    if r["drive"] == "voltage":
        also.append(dict(name="control_delay", parameters=dict(delay=1 / (TAU * r["fc"])), why="lag of the amplifier's current loop"))
    also.append(dict(name="bias_torque", parameters=dict(torque=m["offset_torque"]), why="offset of the sensor of the drive signal, about 0.1 % of its range"))
    rig = dict(kind=r["kind"], drive=r["drive"], motion="prescribed" if r["ideal"] else "closed loop", control_rate_hz=r["fctl"], current_loop_hz=r["fc"],
               speed_loop_hz=r["ws"] / TAU, position_gain=r["kv"], feedforward=r["ff"], controller_published=r["controller"], encoder_counts=r["counts"],
               velocity={"tacho": "tacho", "drive": "filtered difference of the encoder", "none": "none"}[r["vel"]], velocity_filter_hz=r["ffilt"] if r["vel"] == "drive" else None,
               velocity_noise=r["vsig"] if r["vel"] == "tacho" else None, position_channel=r["pos"], current_noise=r["isig"], current_resolution=r["ires"],
               current_offset=r["ioff"], sampling=m["sampling"], rate_hz=r["fr"], clock_jitter=r["jitter"], delay=r["delay"], load_channel=r["load"],
               temperature_channel=r["temp"], v_dc_channel=r["vdc"], user_position_channel=r["show_user"], runs=list(zip(r["plan"], r["roles"], r["lengths"])),
               step_hz=r["fs"], drive_torque_rms=drive, voltage_rms=volt if not r["ideal"] else None, wmax=r["wmax"], travel=r["A"])
    return {"case": number, "class": cls, "effects": eff, "constants": con, "rig": rig, "also_true": also, "redraws": len(why)}, why


def write_keys(out, keys):
    out = os.path.abspath(out)
    f = os.path.join(os.path.dirname(out), f"keys_{os.path.basename(out)}.json")
    old = {}
    if os.path.exists(f):
        try:
            old = {k["case"]: k for k in json.load(open(f))}
        except (ValueError, KeyError, TypeError):
            old = {}
    old.update({k["case"]: k for k in keys})
    with open(f, "w") as fh:
        json.dump([old[k] for k in sorted(old)], fh, indent=1)
    return f


# ------------------------------------------------------------------ self check: from the files alone, with the key
def read_case(path):
    import tomllib
    b = tomllib.load(open(os.path.join(path, "bench.toml"), "rb"))
    lin = b["rig"]["kind"] == "linear"
    per = b["rig"]["lead_m_per_turn"] / TAU if lin else 1.0
    if isinstance(per, dict):
        per = per["value"]
    runs = []
    for q in b["run"]:
        f = os.path.join(path, q["file"])
        head = open(f).readline().strip().split(",")
        a = np.loadtxt(f, delimiter=",", skiprows=1)
        d = {}
        for c, s in b["channels"].items():
            y = a[:, head.index(s["column"])] * UN[s["unit"]] * s.get("scale", 1.0)
            if s["unit"] in ("m", "mm", "um", "m/s", "mm/s"):
                y = y / per
            if s["unit"] == "N":
                y = y * per
            d[c] = y
        runs.append(d)
    return b, runs


def check_case(path, key, window=0.012):
    """rms of the band-limited equation: drive, left without the effects, left with them"""
    b, runs = read_case(path)
    c, rig = key["constants"], key["rig"]
    par = {e["name"]: e["parameters"] for e in key["effects"]}
    E = {n: [p[k] for k in ALL[n][1]] for n, p in par.items()}
    el = [n for n in par if n in ("winding_heating", "dead_time")]
    acc = dict(drive=[], without=[], withe=[], vd=[], vwithout=[], vwith=[], od=[], owithout=[], owith=[])
    prof = next((e["profile"] for e in key["effects"] if "profile" in e), None)
    for d in runs:
        t = d["time"]
        t = t - t[0]
        fr = rig["rate_hz"]
        h = 1 / fr
        g = np.arange(int(t[-1] / h)) * h
        dly = rig["delay"] or dict(which="", s=0)
        # align: every channel on one even clock, means are worth the middle of their interval
        def ch(name, mean=False):
            s = dly["s"] if (dly["which"] == "motion" and name in ("position", "velocity", "user_position")) or (dly["which"] == "velocity" and name == "velocity") or (
                dly["which"] == "drive" and name in ("current", "voltage", "torque", "force")) else 0.0
            return np.interp(g, t - s - (h / 2 if mean else 0), d[name])
        mean = rig["sampling"] == "mean"
        nw = max(int(fr * window) | 1, 3)
        win = np.hanning(nw + 2)[1:-1]
        win /= win.sum()
        lp = lambda y: np.convolve(y, win, "same")
        if "position" in d:
            th = ch("position")
            if "encoder_eccentricity" in E:
                a, p = E["encoder_eccentricity"]
                x = th.copy()
                for _ in range(20):
                    x = th - a * np.sin(x + p)
                ths = x
                raw = th
            else:
                ths = raw = th
            w1 = np.gradient(lp(ths), h)
            w1raw = np.gradient(lp(raw), h)
        else:
            w1 = w1raw = lp(ch("velocity"))
            ths = np.cumsum(w1) * h
        if rig["velocity"] == "tacho" and "encoder_eccentricity" not in E and rig["encoder_counts"] < 20000:
            w1 = w1raw = lp(ch("velocity"))
        drv = rig["drive"]
        nm = {"current": "current", "current_voltage": "current", "voltage": "voltage"}.get(drv) or ("torque" if "torque" in d else "force")
        k = {"current": c["torque_constant"], "current_voltage": c["torque_constant"], "voltage": c["drive_constant"]}.get(drv, 1.0)
        lag = 0.0
        x = ch(nm, mean)
        # constants known, sensor's small offset known
        off = {"current": rig["current_offset"], "current_voltage": rig["current_offset"]}.get(drv, rig["current_offset"] * c["torque_constant"] / k)
        x = x - off
        i_raw = x.copy()
        shift = lambda y, s: np.interp(g - s, g, y)
        if drv == "voltage":
            x = shift(x, 1 / (TAU * rig["current_loop_hz"]))
            i_raw = x.copy()
        if "control_delay" in E and drv == "voltage":
            x = shift(x, E["control_delay"][0])
        if "current_offset" in E: x = x - E["current_offset"][0]
        if "current_gain" in E: x = x / (1 + E["current_gain"][0])
        if "current_cubic" in E:
            y = x.copy()
            for _ in range(50):
                y = x / (1 + E["current_cubic"][0] * y * y)
            x = y
        i = x
        tq_ = k * x
        if "torque_saturation" in E: tq_ = tq_ * (1 - E["torque_saturation"][0] * (np.abs(x) * (k / c["torque_constant"] if drv == "voltage" else 1)))
        if "torque_ripple" in E:
            a, p, o = E["torque_ripple"]
            tq_ = tq_ * (1 + a * np.cos(o * ths + p))
        w = w1
        eps = 2e-3 * rig["wmax"]
        s = np.where(np.abs(w) > eps, np.sign(w), 0.0)
        load = ch("load") if "load" in d else 0 * g
        temp = ch("temperature") if "temperature" in d else 0 * g + 22
        sm = 0 * g
        lev = c["coulomb"] + 0 * g
        acc_ = np.gradient(w, h)
        J = c["inertia"]
        pre = None
        for n, e in E.items():
            cd = CODE[n]
            if n == "stribeck": lev = lev + e[0] * np.exp(-(np.abs(w) / e[1]) ** e[2])
            elif n == "lubricated_rise": lev = lev + e[0] * (1 - np.exp(-np.abs(w) / e[1]))
            elif n == "quadratic_drag": sm = sm + e[0] * w * np.abs(w)
            elif n == "viscous_asymmetry": sm = sm + e[0] * np.abs(w)
            elif n == "bias_torque": sm = sm + e[0]
            elif n == "load_dependent_friction": lev = lev + e[0] * np.abs(load)
            elif n == "temperature_dependent_friction": lev = lev + e[0] * (temp - 20) * c["coulomb"]
            elif n == "periodic_friction": lev = lev + e[0] * np.cos(e[2] * ths + e[1])
            elif n == "tight_spot": lev = lev + e[0] * np.exp(-((ths - e[1]) / e[2]) ** 2)
            elif n == "cogging": sm = sm + e[0] * np.cos(e[2] * ths + e[1])
            elif n == "spring_load": sm = sm + e[0] * (ths - e[1])
            elif n == "random_friction":
                pv = np.array(prof["values"])
                lev = lev + e[0] * np.interp((ths - prof["start"]) / prof["step"] % len(pv), np.arange(len(pv) + 1), np.append(pv, pv[0]))
            elif n == "eddy_brake": sm = sm + e[0] * w / (1 + (w / e[1]) ** 2)
            elif n == "cubic_cable": sm = sm + e[0] * ((ths - e[2]) / e[1]) ** 3
            elif n == "critical_speed": sm = sm + e[0] * np.exp(-((np.abs(w) - e[1]) / e[2]) ** 2) * s
            elif n == "saturating_viscous": sm = sm + e[0] * np.tanh(w / e[1])
            elif n == "variable_inertia": sm = sm + e[0] * np.cos(e[2] * ths + e[1]) * acc_ - 0.5 * e[0] * e[2] * np.sin(e[2] * ths + e[1]) * w * w
            elif n in ("hysteresis", "ageing"):
                z = 0.0
                zz = np.zeros(len(g))
                ev = np.array(e + [0.0] * 4)[:4]
                for m_ in range(len(g)):
                    z = evolve(cd, ev, w[m_] if s[m_] != 0 else 0.0, h, z)
                    zz[m_] = z
                if n == "hysteresis": sm = sm + e[0] * zz
                else: lev = lev + e[0] * np.log(1 + zz / e[2])
            elif n == "presliding":
                pre = e
            elif n == "compliance":
                y1 = y2 = 0.0
                q = np.zeros(len(g))
                th2 = ths[0]; w2 = 0.0
                sub = max(1, int(20000 / fr))
                lt = lp(ths)
                for m_ in range(len(g) - 1):
                    for u_ in range(sub):
                        f = (u_ + 0.5) / sub
                        tc = e[0] * (lt[m_] * (1 - f) + lt[m_ + 1] * f - th2) + e[1] * (w[m_] * (1 - f) + w[m_ + 1] * f - w2)
                        w2 += tc / e[2] * h / sub
                        th2 += w2 * h / sub
                    q[m_] = tc
                sm = sm + q - e[2] * acc_
        fr_ = lev * s
        if pre:
            z = 0.0
            F = np.zeros(len(g))
            for m_ in range(len(g)):
                sw = np.sign(w[m_])
                gg = max(1 - pre[0] * z / lev[m_] * sw, 0.0)
                z = float(np.clip(z + h * gg * w[m_], -lev[m_] / pre[0], lev[m_] / pre[0]))
                F[m_] = pre[0] * z + pre[1] * gg * w[m_]
            fr_ = F
        base = J * np.gradient(w1raw, h) + c["viscous"] * w1raw + c["coulomb"] * np.sign(w1raw) * (np.abs(w1raw) > eps) + load
        full = J * acc_ + c["viscous"] * w + fr_ + load + sm
        ok = lp((np.abs(w) > 4 * eps).astype(float)) > 0.999
        if pre:
            ok = np.ones(len(g), bool)
        ok &= (g > 0.1) & (g < g[-1] - 0.1)
        rw, ro = lp(lp(tq_) - full), lp(lp(k * i_raw) - base)
        acc["drive"].append(lp(k * i_raw)[ok]); acc["without"].append(ro[ok]); acc["withe"].append(rw[ok])
        # equations of their own: source, play, controller
        if "supply_sag" in E:
            vd_, v_ = ch("v_dc"), ch("voltage", mean)
            acc["od"].append(np.full(1, key["rig"]["voltage_rms"]))
            acc["owithout"].append(lp(vd_ - c["supply_voltage"])[nw:-nw])
            acc["owith"].append(lp(vd_ - c["supply_voltage"] + E["supply_sag"][0] * v_ * i / vd_)[nw:-nw])
        elif "backlash" in E:
            y = ch("user_position") * c["gear_ratio"]
            u_ = 0.0
            q = np.zeros(len(g))
            for m_ in range(len(g)):
                u_ = min(max(u_, th[m_] - 0.5 * E["backlash"][0]), th[m_] + 0.5 * E["backlash"][0])
                q[m_] = u_
            acc["od"].append(th)
            acc["owithout"].append(y - th)
            acc["owith"].append(y - q)
        elif "controller" in b["rig"]:
            k_ = b["rig"]["controller"]
            vl = lambda n_: k_[n_]["value"] if isinstance(k_[n_], dict) else k_[n_]
            if True:
                pos_, vel_ = d["position"], d["velocity"]
                hold = 0.5 / vl("rate_hz")      # positions are held from tick to tick, a velocity of the drive's is so already
                late = lambda y: np.interp(t - hold, t, y)
                vel_ = late(vel_) if rig["velocity"] == "tacho" else vel_
                e_ = np.clip(vl("position_gain") * late(d["command"] - pos_), -vl("speed_limit"), vl("speed_limit")) - vel_
                I_ = 0.0
                uu = np.zeros(len(e_))
                hh = np.diff(t, append=t[-1] + h)
                for m_ in range(len(e_)):
                    I_ += vl("integral_gain") * e_[m_] * hh[m_]
                    y = vl("speed_gain") * e_[m_] + I_
                    uu[m_] = min(max(y, -vl("drive_limit")), vl("drive_limit"))
                    if uu[m_] != y and y * e_[m_] > 0:
                        I_ -= vl("integral_gain") * e_[m_] * hh[m_]
                uu = np.interp(g, t, uu)
                cd_ = E.get("control_delay", [0.0])[0] if drv != "voltage" else 0.0
                lg = vl("current_time_constant_s") if drv != "voltage" else 0.0
                o_ = ch(nm, mean) - off
                hi_ = lambda y: lp(y) - np.convolve(y, np.ones(int(fr * 0.5)) / int(fr * 0.5), "same")
                cut = slice(int(fr), -int(fr))
                acc["od"].append(hi_(o_)[cut])
                acc["owithout"].append(hi_(o_ - shift(uu, lg))[cut])
                acc["owith"].append(hi_(o_ - shift(uu, lg + cd_))[cut])
        if drv == "current_voltage":
            v = ch("voltage", mean)
            Rc = c.get("resistance_cold", c["resistance"])
            di = np.gradient(lp(i), h)
            rip = 1.0
            if "torque_ripple" in E:
                rip = 1 + E["torque_ripple"][0] * np.cos(E["torque_ripple"][2] * ths + E["torque_ripple"][1])
            vd = E["dead_time"][0] * np.tanh(i / 0.05) if "dead_time" in E else 0.0
            acc["vd"].append(lp(v)[ok])
            acc["vwithout"].append((lp(v - Rc * i_raw) - c["inductance"] * np.gradient(lp(i_raw), h) - c["back_emf_constant"] * w1raw)[ok])
            acc["vwith"].append((lp(v - c["resistance"] * i - vd) - c["back_emf_constant"] * rip * w - c["inductance"] * di)[ok])
    rms = lambda k_: float(np.sqrt(np.mean(np.concatenate(acc[k_]) ** 2))) if acc[k_] else float("nan")
    out = {k_: rms(k_) for k_ in acc}
    return out


def selfcheck(seed, n, only=None):
    import tempfile
    bad = 0
    print(f"{'case':>4} {'effects':<34} {'rig':<34} {'drive':>9} {'left without':>12} {'left with':>10} {'quiet':>10}   voltage: without, with, quiet    s")
    todo = [None] * 3 + list(ALL) if n <= 0 else [None] * n
    with tempfile.TemporaryDirectory() as tmp:
        for k, e in enumerate(todo):
            if only and e != only:
                continue
            t0 = time.time()
            key, why = build(seed, k, "nothing" if (e is None and n <= 0) else None, e, tmp)
            t1 = time.time() - t0
            q = check_case(os.path.join(tmp, f"case_{k:03d}"), key)
            nm = "+".join(x["name"] for x in key["effects"]) or "nothing"
            r = key["rig"]
            d = q["drive"]
            key2, _ = build(seed, k, "nothing" if (e is None and n <= 0) else None, e, tmp, quiet=True)
            p = check_case(os.path.join(tmp, f"case_{k:03d}"), key2, 0.004)
            line = f"{k:>4} {nm:<34} {r['kind'] + ' ' + r['drive'] + (' ideal' if r['motion'] == 'prescribed' else ''):<34} {d:9.3g} {100 * q['without'] / d:10.2f} % {100 * q['withe'] / d:8.2f} % {100 * p['withe'] / p['drive']:8.2f} %"
            if q["vd"] == q["vd"]:
                line += f"   {100 * q['vwithout'] / q['vd']:6.2f} % {100 * q['vwith'] / q['vd']:6.2f} % {100 * p['vwith'] / p['vd']:6.2f} %"
            if q["od"] == q["od"]:
                what = "source" if "supply_sag" in nm else "play" if "backlash" in nm else "controller"
                line += f"   {what}: {100 * q['owithout'] / q['od']:.2f} % {100 * q['owith'] / q['od']:.2f} % {100 * p['owith'] / p['od']:.2f} %"
            left = max(p["withe"] / p["drive"], (p["vwith"] / p["vd"]) if q["vd"] == q["vd"] else 0)
            flag = "" if left < 0.01 else "  <-- look"
            bad += left >= 0.01
            print(line + f"   {t1:4.1f} ({key['redraws']}){flag}", flush=True)
    print(f"{len(todo)} cases, {bad} leave more than 1 % of the drive with quiet sensors")
    return bad


def main():
    ap = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ap.add_argument("--seed", type=int, default=1)
    ap.add_argument("--first", type=int, default=0)
    ap.add_argument("--cases", type=int, default=0)
    ap.add_argument("--out")
    ap.add_argument("--class", dest="cls", choices=["nothing", "one", "two", "outside"])
    ap.add_argument("--effect", choices=list(ALL))
    ap.add_argument("--selfcheck", action="store_true", help="close the drive's equation with the truth; --cases N of the usual mix, else one of each effect")
    ap.add_argument("--list", action="store_true")
    a = ap.parse_args()
    if a.list:
        print("\n".join(f"{k}: {', '.join(v[1])}" + ("   (outside)" if k in OUTSIDE else "") for k, v in ALL.items()))
        return 0
    if a.selfcheck:
        return 1 if selfcheck(a.seed, a.cases, a.effect) else 0
    if not a.out or a.cases < 1:
        ap.error("--out and --cases")
    os.makedirs(a.out, exist_ok=True)
    keys = []
    for k in range(a.first, a.first + a.cases):
        t0 = time.time()
        key, why = build(a.seed, k, a.cls, a.effect, a.out)
        keys.append(key)
        print(f"case_{k:03d} {key['class']:<8} {'+'.join(e['name'] for e in key['effects']):<40} {key['rig']['kind']} {key['rig']['drive']}  {time.time() - t0:.1f} s, {len(why)} redraws", flush=True)
    write_keys(a.out, keys)
    return 0


if __name__ == "__main__":
    sys.exit(main())
