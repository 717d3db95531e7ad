#!/usr/bin/env python3
"""Units of an electromechanical actuator, recorded on benches that differ from unit to unit.

    units.py --seed S --units N --tests M --out DIR [--effect NAME|none] [--first K0]
    units.py --validate            (the printed numbers of ntb.md, reference constants)

Written from ntb.md and interfaces.md alone.  numpy and numba only.  A unit depends on (seed, K) only;
`--effect` changes the effect and nothing else of a unit (constants, bench, tests, noise seeds stay).

PHYSICS AND INTEGRATION
  The drive's logic (position loop, speed loop, commutation, relays with memory) runs on its own 1 us clock.
  The plant is integrated twice per tick with h = 0.5 us:
  * windings: linear system with leg voltages and back-EMF constant over h (back-EMF shape taken at the mid-angle),
    star point solved for unequal phases; series of the exponential to second order (error < 4e-7 of the increment);
  * torque: of the mean current over h (sliding) or the current at the end of h (decision to break away);
  * speed: trapezoidal in the viscous term; the friction is switched AT its event inside h: when the speed passes
    zero the rest of h is stuck or moves on in the other direction; at break-away only the part of h after the
    static level was passed is moved;
  * angle: mean of the speeds at both ends.
  Everything else (gear, end stops, play, clamps, anti-windup, Eq. 5, Eq. 7) is ntb.md's.

SENSORS
  All currents are the drive's own sensors: what the regulators see is recorded (plus noise, offset, quantisation).
  theta_m is the absolute resolver angle (rest angle included), theta_u = (theta_m - theta_m at rest)/500 through the
  gear, i_eq = (|i_a|+|i_b|+|i_c|)/2 of the recorded phase currents.  com = command of the last tick, t = interval end.
  Speed, "own": w at the end of the sample + white noise.  "resolver_derivative": difference of the quantised
  resolver at 10 kHz, times 1e4, through n first-order low-passes y += (1-exp(-2 pi fc/1e4)) (x - y), then sampled.
  v_a, v_b, v_c: always the mean over the sample, 12 bit over +-60 V; "neutral": leg minus mean of the three legs
  (artificial star point), "midpoint": leg against the middle of the DC link (v[q] of ntb.md).  v_dc 12 bit, 0..60 V.

EFFECTS (motor side, SI; "size": range drawn; +- = sign drawn).  F = friction level, opposes motion; they are not
scaled by the fault multiplier FSJ.  x = th - th_rest = 500 u.  FS0 = 0.03, FD0 = 0.021 N m, C0 = 3e-5, J0 = 2.5e-5.
  stribeck            F_dyn += torque exp(-(|w|/speed)^exponent); F_static = max(F_static, F_dyn at w=0).
                      torque 0.0025..0.007, speed 15..80, exponent 0.8..2
  lubricated_rise     F_dyn += torque (1 - exp(-|w|/speed)).  torque 0.003..0.008, speed 40..250
  quadratic_drag      torque -coefficient w|w|.  coefficient 1.2e-8..3e-8 (4..11 mN m at 600 rad/s)
  viscous_asymmetry   torque -(C + coefficient sign(w)) w; positive = more drag in positive motion.  +-(0.3..0.8) C0
  bias_torque         torque -torque on the rotor always; positive = resists positive motion.  +-(0.002..0.006)
  periodic_friction   F_static, F_dyn += amplitude cos(order th + phase).  0.003..0.007, order 1 or 2
  tight_spot          F_static, F_dyn += torque exp(-((x - centre)/width)^2/2), at a place of the travel.
                      torque 0.008..0.02, centre 100..350 rad, width 10..40 rad
  presliding          LuGre in place of the stick law: dz/dt = w - stiffness |w| z/g(w), g = FD + (FS-FD) exp(-(w/1)^2),
                      friction = stiffness z + damping dz/dt.  stiffness 1.5..8 N m/rad,
                      damping = (0.5..1) sqrt(stiffness J0)
  cogging             torque +amplitude sin(order th + phase).  0.004..0.012, order 6, 12 or 24
  torque_ripple       motor torque times 1 + fraction cos(order th + phase) (back-EMF untouched).  0.05..0.15, order 6, 12
  eccentricity        Eq. 5 in the healthy unit too: k_q times 1 + zeta cos(th + 2 pi q/3 + phase) (+ the fault's own
                      term, phase 0).  zeta 0.04..0.10
  torque_saturation   motor torque divided by 1 + coefficient Ieq, Ieq = sum|i|/2.  0.006..0.018 1/A
  spring_load         torque -stiffness x.  1e-5..3e-5 N m/rad (5..15 mN m at 1 rad of the user shaft)
  compliance          second mass `inertia` (added) behind `stiffness`, `damping`: Ts = K (x - xl) + D (w - wl); the
                      user shaft hangs on xl.  inertia (0.10..0.30) J0, sqrt(K/inertia) = 2 pi (250..600), ratio 0.12..0.25
  backlash            play of the user shaft wider by gap (full width, motor rad): b += gap/(2 N).  gap 0.02..0.08 rad
                      (the reference has 0.02)
  winding_heating     R(t) = R (1 + 0.00393 T), T = delta_t (1 - 0.4 exp(-t/10 s)); flux untouched.  delta_t 50..110 K
  supply_sag          DC link of 1 mF behind `resistance`: Vdc' = ((Vs - Vdc)/r - sum s_q i_q/2)/C.  0.3..0.8 ohm
  dead_time           leg voltage lowered by voltage * clip(i_q/0.05 A, -1, 1).  0.5..1.5 V
  turn_short          phase `phase` (0,1,2): k and R times 1 - fraction, L times (1 - fraction)^2.  0.04..0.12
  commutation_offset  commutation uses th + angle (mechanical rad).  +-(0.04..0.12) rad
  encoder_eccentricity  resolver reads th + amplitude sin(th + phase): commutation, recorded theta_m/theta_u and speed
                      from the resolver; the speed loop sees w (1 + amplitude cos(th + phase)).  0.008..0.025 rad
  current_offset      sensor of phase_index reads i + current (regulator and record).  +-(0.12..0.35) A
  current_gain        sensor of phase_index reads (1 + gain) i.  +-(0.05..0.15)
  control_delay       the current reference reaches the relays later by delay.  0.15..0.40 ms
"""
import argparse
import json
import math
import os
import time

import numpy as np
from numba import njit

DT = 1e-6
NGEAR = 500.0
REF = dict(Vs=48.0, R=1.065, L=360e-6, ke=0.0376, P=2, HB=0.1, J=2.5e-5, C=3e-5, FSJ0=0.03, ratio=0.7, N=NGEAR,
           GAP=1e5, Wmax=838.0, Kp=0.05, Ki=0.5, Imax=22.5, Tmax=1.7, Tint=1.7, b=2e-5, stop=1.2, kt_drive=0.0752)
EFFECTS = ["stribeck", "lubricated_rise", "quadratic_drag", "viscous_asymmetry", "bias_torque", "periodic_friction",
           "tight_spot", "presliding", "cogging", "torque_ripple", "eccentricity", "torque_saturation", "spring_load",
           "compliance", "backlash", "winding_heating", "supply_sag", "dead_time", "turn_short", "commutation_offset",
           "encoder_eccentricity", "current_offset", "current_gain", "control_delay"]
PNAMES = ["Vs", "R", "L", "ke", "P", "HB", "J", "C", "FS", "FD", "N", "GAP", "Wmax", "Kp", "Ki", "Imax", "Tmax", "Tint",
          "b", "stop", "kt", "zeta", "th0",
          "str_t", "str_w", "str_n", "lub_t", "lub_w", "quad", "casym", "bias", "pf_a", "pf_p", "pf_n", "ts_t", "ts_c",
          "ts_w", "sig0", "sig1", "cog_a", "cog_p", "cog_n", "rip_f", "rip_p", "rip_n", "hz", "hp", "sat", "spring",
          "ck", "cd", "cj", "heat", "rsag", "dead", "sh_f", "sh_q", "coff", "enc_a", "enc_p", "off_a", "off_q",
          "gain", "gain_q", "delay"]
IX = {n: i for i, n in enumerate(PNAMES)}
NOUT = 14   # th, th_resolver, w, iA..iC mean, iA..iC end, legs A..C mean, vdc mean, i3eq mean
TWO_PI = 2.0 * math.pi


@njit(cache=True, inline="always")
def _trap(a):
    """trapezoid, a in turns, 0 <= a < 1"""
    if a < 1.0 / 12.0:
        return 12.0 * a
    if a <= 5.0 / 12.0:
        return 1.0
    if a < 7.0 / 12.0:
        return 12.0 * (0.5 - a)
    if a <= 11.0 / 12.0:
        return -1.0
    return 12.0 * (a - 1.0)


@njit(cache=True, inline="always")
def _rect(a):
    if a >= 1.0 / 12.0 and a < 5.0 / 12.0:
        return 1.0
    if a >= 7.0 / 12.0 and a < 11.0 / 12.0:
        return -1.0
    return 0.0


@njit(cache=True, inline="always")
def _wrap(a):
    return a - math.floor(a)


@njit(cache=True, error_model="numpy")
def run(cmd, p, nb, out):
    """cmd: command per tick; p: parameters; nb: ticks per output row; out[rows, NOUT]"""
    (Vs, R0, L0, ke, P, HB, J, C, FS, FD, N, GAP, Wmax, Kp, Ki, Imax, Tmax, Tint, b, stop, kt, zeta, th0) = (
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13], p[14], p[15], p[16],
        p[17], p[18], p[19], p[20], p[21], p[22])
    (str_t, str_w, str_n, lub_t, lub_w, quad, casym, bias, pf_a, pf_p, pf_n, ts_t, ts_c, ts_w, sig0, sig1, cog_a, cog_p,
     cog_n, rip_f, rip_p, rip_n) = (p[23], p[24], p[25], p[26], p[27], p[28], p[29], p[30], p[31], p[32], p[33], p[34],
                                    p[35], p[36], p[37], p[38], p[39], p[40], p[41], p[42], p[43], p[44])
    (hz, hp, sat, spring, ck, cd, cj, heat, rsag, dead, sh_f, sh_q, coff, enc_a, enc_p, off_a, off_q, gain, gain_q,
     delay) = (p[45], p[46], p[47], p[48], p[49], p[50], p[51], p[52], p[53], p[54], p[55], p[56], p[57], p[58], p[59],
               p[60], p[61], p[62], p[63], p[64])
    h = 0.5e-6
    third = 1.0 / 3.0
    t23 = 2.0943951023931953
    c3, s3 = -0.5, 0.8660254037844386        # cos, sin of 2 pi/3
    R = np.full(3, R0)
    Li = np.full(3, 1.0 / L0)
    ks = np.full(3, ke)
    if sh_f > 0.0:
        q = int(sh_q)
        R[q] *= 1.0 - sh_f
        ks[q] *= 1.0 - sh_f
        Li[q] /= (1.0 - sh_f) ** 2
    Rb = R.copy()
    SL = Li[0] + Li[1] + Li[2]
    g = np.ones(3)
    g[int(gain_q)] += gain
    of = np.zeros(3)
    of[int(off_q)] += off_a
    i = np.zeros(3)
    s = np.ones(3)
    f = np.zeros(3)
    k3 = np.zeros(3)
    v = np.zeros(3)
    ib = np.zeros(3)
    acc = np.zeros(8)
    w = 0.0
    th = th0
    I = 0.0
    thu = 0.0
    xl = 0.0
    wl = 0.0
    z = 0.0
    vdc = Vs
    nd = int(round(delay / 1e-6))
    ring = np.zeros(nd + 1)
    quot = P / 6.283185307179586
    ecc = (P > 1.0) and (zeta > 0.0 or hz > 0.0)
    pos_dep = (pf_a != 0.0) or (ts_t != 0.0)
    w_dep = (str_t != 0.0) or (lub_t != 0.0)
    cmpl = cj > 0.0
    row = 0
    cnt = 0
    n = cmd.shape[0]
    hJ = h / J
    den = 1.0 / (1.0 + 0.5 * hJ * C)
    for tick in range(n):
        # ---- the drive, 1 us clock
        ew = w
        thm = th
        if enc_a != 0.0:
            thm = th + enc_a * math.sin(th + enc_p)
            ew = w * (1.0 + enc_a * math.cos(th + enc_p))
        wref = GAP * (cmd[tick] - thu)
        if wref > Wmax:
            wref = Wmax
        elif wref < -Wmax:
            wref = -Wmax
        e = wref - ew
        T = Kp * e + I
        ir = T / kt
        sated = False
        if ir > Imax:
            ir = Imax
            sated = True
        elif ir < -Imax:
            ir = -Imax
            sated = True
        if not (sated and T * e >= 0.0):
            I += Ki * e * 1e-6
            if I > Tint:
                I = Tint
            elif I < -Tint:
                I = -Tint
        if nd > 0:
            ring[tick % (nd + 1)] = ir
            ir = ring[(tick + 1) % (nd + 1)]
        a = _wrap((thm + coff) * quot)
        for q in range(3):
            er = _rect(_wrap(a - q * third)) * ir - (g[q] * i[q] + of[q])
            if er > HB:
                s[q] = 1.0
            elif er < -HB:
                s[q] = -1.0
        if heat > 0.0 and tick % 100 == 0:
            fac = 1.0 + 0.00393 * heat * (1.0 - 0.4 * math.exp(-tick * 1e-7))
            for q in range(3):
                R[q] = Rb[q] * fac
        # ---- the plant, two half microseconds
        for sub in range(2):
            thh = th + 0.5 * h * w
            a = _wrap(thh * quot)
            for q in range(3):
                k3[q] = ks[q] * _trap(_wrap(a - q * third))
            if ecc:
                ce = zeta * math.cos(thh)
                se = zeta * math.sin(thh)
                if hz > 0.0:
                    ce += hz * math.cos(thh + hp)
                    se += hz * math.sin(thh + hp)
                k3[0] *= 1.0 + ce
                k3[1] *= 1.0 + ce * c3 - se * s3
                k3[2] *= 1.0 + ce * c3 + se * s3
            hv = 0.5 * vdc
            vn = 0.0
            for q in range(3):
                v[q] = s[q] * hv
                if dead > 0.0:
                    d = i[q] * 20.0
                    if d > 1.0:
                        d = 1.0
                    elif d < -1.0:
                        d = -1.0
                    v[q] -= dead * d
                f[q] = v[q] - k3[q] * w - R[q] * i[q]
                vn += f[q] * Li[q]
            vn /= SL
            c = 0.0
            for q in range(3):
                f[q] = (f[q] - vn) * Li[q]
                c += R[q] * f[q] * Li[q]
            c /= SL
            TA = 0.0      # of the mean current over h
            TE = 0.0      # of the current at its end
            TB = 0.0      # at its beginning
            ie = 0.0
            for q in range(3):
                af = (c - R[q] * f[q]) * Li[q]
                ib[q] = i[q] + h * (0.5 * f[q] + h * af / 6.0)
                TB += k3[q] * i[q]
                ne = i[q] + h * (f[q] + 0.5 * h * af)
                ie += 0.5 * abs(ib[q])
                TA += k3[q] * ib[q]
                TE += k3[q] * ne
                acc[q] += 0.5 * ib[q]
                acc[3 + q] += 0.5 * v[q]
                i[q] = ne
            acc[6] += 0.5 * vdc
            acc[7] += 0.25 * (abs(i[0]) + abs(i[1]) + abs(i[2]))
            if rsag > 0.0:
                vdc += h / 1e-3 * ((Vs - vdc) / rsag - 0.5 * (s[0] * ib[0] + s[1] * ib[1] + s[2] * ib[2]))
            m = 1.0
            if sat > 0.0:
                m /= 1.0 + sat * ie
            if rip_f > 0.0:
                m *= 1.0 + rip_f * math.cos(rip_n * thh + rip_p)
            TA = min(max(TA * m, -Tmax), Tmax)
            TE = min(max(TE * m, -Tmax), Tmax)
            TB = min(max(TB * m, -Tmax), Tmax)
            load = -bias - spring * (th - th0)
            if cog_a != 0.0:
                load += cog_a * math.sin(cog_n * th + cog_p)
            if quad != 0.0:
                load -= quad * w * abs(w)
            if casym != 0.0:
                load -= casym * abs(w)
            if cmpl:
                Ts = ck * (th - th0 - xl) + cd * (w - wl)
                load -= Ts
                wl += h / cj * Ts
                xl += h * wl
            Fs = FS
            Fd = FD
            if pos_dep:
                ad = 0.0
                if pf_a != 0.0:
                    ad += pf_a * math.cos(pf_n * th + pf_p)
                if ts_t != 0.0:
                    y = (th - th0 - ts_c) / ts_w
                    if abs(y) < 8.0:
                        ad += ts_t * math.exp(-0.5 * y * y)
                Fs = max(Fs + ad, 0.0)
                Fd = max(Fd + ad, 0.0)
            if w_dep:
                if str_t != 0.0:
                    Fs = max(Fs, Fd + str_t)
                    Fd += str_t * math.exp(-(abs(w) / str_w) ** str_n)
                if lub_t != 0.0:
                    Fd += lub_t * (1.0 - math.exp(-abs(w) / lub_w))
            if sig0 > 0.0:                       # LuGre
                gw = Fd + (Fs - Fd) * math.exp(-w * w)
                zn = (z + h * w) / (1.0 + h * abs(w) * sig0 / gw)
                fr = sig0 * zn + sig1 * (zn - z) / h
                z = zn
                wn = (w * (1.0 - 0.5 * hJ * C) + hJ * (TA + load - fr)) * den
                th += 0.5 * h * (w + wn)
                w = wn
            elif w == 0.0:
                A = TE + load
                if abs(A) > Fs:                  # breaks away where the static level was passed
                    Ab = TB + load
                    tau = 0.0
                    lim = Fs if A > 0.0 else -Fs
                    if (A > 0.0 and Ab < lim) or (A < 0.0 and Ab > lim):
                        tau = h * (lim - Ab) / (A - Ab)
                    rest = h - tau
                    w = rest / J * (0.5 * (A + (lim if tau > 0.0 else Ab)) - (Fd if A > 0.0 else -Fd))
                    if w * A < 0.0:
                        w = 0.0
                    th += 0.5 * rest * w
            else:
                fr = Fd if w > 0.0 else -Fd
                wn = (w * (1.0 - 0.5 * hJ * C) + hJ * (TA + load - fr)) * den
                if w * wn < 0.0:                 # stops inside h
                    tau = h * w / (w - wn)
                    th += 0.5 * tau * w
                    A = TE + load
                    w = 0.0
                    if abs(A) > Fs:
                        rest = h - tau
                        w = rest / J * (A - (Fd if A > 0.0 else -Fd))
                        th += 0.5 * rest * w
                else:
                    th += 0.5 * h * (w + wn)
                    w = wn
            u = (th - th0) / N
            if u > stop:
                u = stop
                th = th0 + N * stop
                if w > 0.0:
                    w = 0.0
            elif u < -stop:
                u = -stop
                th = th0 - N * stop
                if w < 0.0:
                    w = 0.0
            if cmpl:
                u = xl / N
            if thu < u - b:
                thu = u - b
            elif thu > u + b:
                thu = u + b
        cnt += 1
        if cnt == nb:
            out[row, 0] = th
            out[row, 1] = th + (enc_a * math.sin(th + enc_p) if enc_a != 0.0 else 0.0)
            out[row, 2] = w
            for q in range(3):
                out[row, 3 + q] = g[q] * acc[q] / nb + of[q]
                out[row, 6 + q] = g[q] * i[q] + of[q]
                out[row, 9 + q] = acc[3 + q] / nb
            out[row, 12] = acc[6] / nb
            out[row, 13] = acc[7] / nb
            acc[:] = 0.0
            cnt = 0
            row += 1
    return thu


# ------------------------------------------------------------------------------------------------ parameters
def pack(const, fsj=1.0, zeta=0.0, th0=0.0, effect=None):
    p = np.zeros(len(PNAMES))

    def put(**kw):
        for n, x in kw.items():
            p[IX[n]] = x
    put(str_w=1.0, str_n=1.0, lub_w=1.0, ts_w=1.0)
    fs = fsj * const["FSJ0"]
    put(FS=fs, FD=const["ratio"] * fs, zeta=zeta, th0=th0, kt=const["kt_drive"],
        **{n: const[n] for n in ("Vs", "R", "L", "ke", "P", "HB", "J", "C", "N", "GAP", "Wmax", "Kp", "Ki", "Imax", "Tmax",
                                 "Tint", "b", "stop")})
    if effect:
        e = effect
        n = e["name"]
        if n == "stribeck":
            put(str_t=e["torque"], str_w=e["speed"], str_n=e["exponent"])
        elif n == "lubricated_rise":
            put(lub_t=e["torque"], lub_w=e["speed"])
        elif n == "quadratic_drag":
            put(quad=e["coefficient"])
        elif n == "viscous_asymmetry":
            put(casym=e["coefficient"])
        elif n == "bias_torque":
            put(bias=e["torque"])
        elif n == "periodic_friction":
            put(pf_a=e["amplitude"], pf_p=e["phase"], pf_n=e["order"])
        elif n == "tight_spot":
            put(ts_t=e["torque"], ts_c=e["centre"], ts_w=e["width"])
        elif n == "presliding":
            put(sig0=e["stiffness"], sig1=e["damping"])
        elif n == "cogging":
            put(cog_a=e["amplitude"], cog_p=e["phase"], cog_n=e["order"])
        elif n == "torque_ripple":
            put(rip_f=e["fraction"], rip_p=e["phase"], rip_n=e["order"])
        elif n == "eccentricity":
            put(hz=e["zeta"], hp=e["phase"])
        elif n == "torque_saturation":
            put(sat=e["coefficient"])
        elif n == "spring_load":
            put(spring=e["stiffness"])
        elif n == "compliance":
            put(ck=e["stiffness"], cd=e["damping"], cj=e["inertia"])
        elif n == "backlash":
            put(b=const["b"] + 0.5 * e["gap"] / const["N"])
        elif n == "winding_heating":
            put(heat=e["delta_t"])
        elif n == "supply_sag":
            put(rsag=e["resistance"])
        elif n == "dead_time":
            put(dead=e["voltage"])
        elif n == "turn_short":
            put(sh_f=e["fraction"], sh_q=e["phase"])
        elif n == "commutation_offset":
            put(coff=e["angle"])
        elif n == "encoder_eccentricity":
            put(enc_a=e["amplitude"], enc_p=e["phase"])
        elif n == "current_offset":
            put(off_a=e["current"], off_q=e["phase_index"])
        elif n == "current_gain":
            put(gain=e["gain"], gain_q=e["phase_index"])
        elif n == "control_delay":
            put(delay=e["delay"])
        else:
            raise SystemExit("unknown effect " + n)
    return p


def draw_effect(name, rng):
    r = rng.uniform
    sg = 1.0 if rng.random() < 0.5 else -1.0
    ph = r(0, TWO_PI)
    idx = int(rng.integers(3))
    J0, C0 = REF["J"], REF["C"]
    d = {"name": name}
    if name == "stribeck":
        d.update(torque=r(0.0025, 0.007), speed=r(15, 80), exponent=r(0.8, 2))
    elif name == "lubricated_rise":
        d.update(torque=r(0.003, 0.008), speed=r(40, 250))
    elif name == "quadratic_drag":
        d.update(coefficient=r(1.2e-8, 3e-8))
    elif name == "viscous_asymmetry":
        d.update(coefficient=sg * C0 * r(0.3, 0.8))
    elif name == "bias_torque":
        d.update(torque=sg * r(0.002, 0.006))
    elif name == "periodic_friction":
        d.update(amplitude=r(0.003, 0.007), phase=ph, order=int(rng.choice([1, 2])))
    elif name == "tight_spot":
        d.update(torque=r(0.008, 0.02), centre=r(100, 350), width=r(10, 40))
    elif name == "presliding":
        k = r(1.5, 8)
        d.update(stiffness=k, damping=r(0.5, 1.0) * math.sqrt(k * J0))
    elif name == "cogging":
        d.update(amplitude=r(0.004, 0.012), phase=ph, order=int(rng.choice([6, 12, 24])))
    elif name == "torque_ripple":
        d.update(fraction=r(0.05, 0.15), phase=ph, order=int(rng.choice([6, 12])))
    elif name == "eccentricity":
        d.update(zeta=r(0.04, 0.10), phase=ph)
    elif name == "torque_saturation":
        d.update(coefficient=r(0.006, 0.018))
    elif name == "spring_load":
        d.update(stiffness=r(1e-5, 3e-5))
    elif name == "compliance":
        jl = J0 * r(0.10, 0.30)
        wn = TWO_PI * r(250, 600)
        d.update(stiffness=jl * wn * wn, damping=2 * r(0.12, 0.25) * jl * wn, inertia=jl)
    elif name == "backlash":
        d.update(gap=r(0.02, 0.08))
    elif name == "winding_heating":
        d.update(delta_t=r(50, 110))
    elif name == "supply_sag":
        d.update(resistance=r(0.3, 0.8))
    elif name == "dead_time":
        d.update(voltage=r(0.5, 1.5))
    elif name == "turn_short":
        d.update(fraction=r(0.04, 0.12), phase=idx)
    elif name == "commutation_offset":
        d.update(angle=sg * r(0.04, 0.12))
    elif name == "encoder_eccentricity":
        d.update(amplitude=r(0.008, 0.025), phase=ph)
    elif name == "current_offset":
        d.update(current=sg * r(0.12, 0.35), phase_index=idx)
    elif name == "current_gain":
        d.update(gain=sg * r(0.05, 0.15), phase_index=idx)
    elif name == "control_delay":
        d.update(delay=round(r(0.15e-3, 0.40e-3), 6))
    else:
        raise SystemExit("unknown effect %s; known: %s" % (name, " ".join(EFFECTS)))
    return d


def draw_constants(rng):
    c = dict(REF)
    for n, tol in (("J", 0.12), ("C", 0.25), ("FSJ0", 0.12), ("ratio", 0.06), ("ke", 0.02), ("R", 0.05), ("L", 0.06),
                   ("Vs", 0.015)):
        c[n] = REF[n] * (1.0 + rng.uniform(-tol, tol))
    return c


def strat(seed, K, tag, options):
    """one of options; each block of len(options) units gets all of them, in an order of its own"""
    n = len(options)
    perm = np.random.default_rng([seed, 7001 + tag, K // n]).permutation(n)
    return options[int(perm[K % n])]


def draw_bench(seed, K, rng):
    r = rng.uniform
    rate = strat(seed, K, 1, [1000, 2000, 2500, 5000, 10000])
    chan = strat(seed, K, 2, ["phases_and_voltages", "phases", "phases_and_v_dc"])
    pre = strat(seed, K, 3, [rate, rate, 10000, 10000])
    res = strat(seed, K, 4, [14, 14, 16, 16])
    samp = strat(seed, K, 5, ["mean", "mean", "point", "point"])
    bits = strat(seed, K, 6, [12, 12, 14, 14])
    rest = strat(seed, K, 7, ["fixed", "fixed", "per_recording", "per_recording"])
    spd = strat(seed, K, 8, ["own", "own", "resolver_derivative", "resolver_derivative"])
    b = {"rate_hz": rate, "preflight_rate_hz": pre, "channels": chan, "resolver_bits": res,
         "current_sampling": samp, "current_bits": bits, "current_range_a": 25.0,
         "current_noise_a": r(0.008, 0.03), "current_offset_max_a": r(0.005, 0.03), "rest": rest}
    noise = r(0.1, 0.4)
    order = int(rng.choice([1, 2]))
    fc = r(60, 250)
    b["speed"] = ({"kind": "own", "sampling": "point", "noise_rad_s": noise} if spd == "own" else
                  {"kind": "resolver_derivative", "clock_hz": 10000, "filter": "first-order low-pass, cascaded",
                   "order": order, "cutoff_hz": fc})
    ref = strat(seed, K, 9, ["neutral", "neutral", "midpoint"])
    if chan == "phases_and_voltages":
        b["voltages"] = {"reference": ref, "sampling": "mean", "bits": 12, "range_v": 60.0, "noise_v": 0.03}
    if chan != "phases":
        b["v_dc"] = {"sampling": "mean", "bits": 12, "range_v": 60.0, "noise_v": 0.05}
    return b


# ------------------------------------------------------------------------------------------------ commands
def ticks(seconds):
    return int(round(seconds / DT))


def preflight():
    c = np.zeros(3000000)
    t = np.arange(3000000) * DT
    c[:500000] = 0.001 * t[:500000]
    c[850000:1850000] = 0.001 * np.sin(2 * np.pi * 5 * (t[850000:1850000] - 0.85))
    c[2200000:] = 1.0
    return c


def alone(kind):
    if kind == "step":
        return np.ones(800000)
    t = np.arange(1000000) * DT
    return 0.001 * t if kind == "ramp" else 0.001 * np.sin(2 * np.pi * 5 * t)


class Plan:
    """A command put together from pieces; stays within +-0.95 rad, 1.05 rad/s (except jumps), ~15 A of acceleration."""

    def __init__(self):
        self.parts, self.x, self.n, self.text = [], 0.0, 0, []

    def add(self, arr, text):
        self.text.append([round(self.n * DT, 6), text])
        self.parts.append(arr)
        self.n += len(arr)
        self.x = float(arr[-1])

    def dwell(self, d):
        self.add(np.full(ticks(d), self.x), "dwell")

    def creep(self, v, d):
        self.add(self.x + v * DT * np.arange(ticks(d)), "ramp %.4g rad/s" % v)

    def move(self, x1, v, a):
        D = abs(x1 - self.x)
        sg = 1.0 if x1 > self.x else -1.0
        v = min(v, math.sqrt(D * a))
        ta, tc = v / a, D / v - v / a
        t = np.arange(ticks(2 * ta + tc)) * DT
        y = np.where(t < ta, 0.5 * a * t * t, np.where(t < ta + tc, v * (t - 0.5 * ta), D - 0.5 * a * (2 * ta + tc - t) ** 2))
        y[-1] = D
        self.add(self.x + sg * y, "move to %.3f at %.3f rad/s" % (x1, v))

    def sine(self, A, f, n):
        t = np.arange(ticks(n / f)) * DT
        x = self.x
        self.add(x + A * np.sin(2 * np.pi * f * t), "sine %.4g rad %.3g Hz" % (A, f))
        self.x = x

    def chirp(self, A, f0, f1, T):
        t = np.arange(ticks(T)) * DT
        x = self.x
        self.add(x + A * np.sin(2 * np.pi * (f0 * t + (f1 - f0) * t * t / (2 * T))), "chirp %.4g rad %.3g-%.3g Hz" % (A, f0, f1))

    def multisine(self, A, f, T):
        t = np.arange(ticks(T)) * DT
        x = self.x
        y = sum(A / n * np.sin(2 * np.pi * f * n * t + n * n) for n in range(1, 6))
        y -= y[0]
        self.add(x + y, "multisine %.4g rad %.3g Hz" % (A, f))

    def jump(self, x1, d):
        self.add(np.full(ticks(d), x1), "jump to %.3f" % x1)

    def array(self, T):
        a = np.concatenate(self.parts)
        n = ticks(T)
        return a[:n] if len(a) >= n else np.concatenate([a, np.full(n - len(a), a[-1])])


def long_command(rng, which):
    """which 0: constant speeds and creep in both directions; 1: dynamics (chirp, multisine, jumps)."""
    r = rng.uniform
    T = float(rng.choice([8.0, 9.0, 10.0, 11.0, 12.0]))
    pl = Plan()
    pl.dwell(r(0.1, 0.3))
    if which == 0:
        v = r(0.002, 0.01)
        pl.creep(v, r(0.3, 0.5))
        pl.creep(-v, r(0.4, 0.7))
        pl.sine(r(0.001, 0.003), r(2, 5), 3)
        top = r(0.75, 0.92)
        a = r(25, 60)
        pl.move(top, r(0.75, 1.0), a)
        pl.dwell(r(0.05, 0.2))
        pl.move(-r(0.3, 0.6), r(0.75, 1.0), a)
        speeds = list(rng.permutation([0.02, 0.06, 0.15, 0.3, 0.5, 1.04]) * r(0.9, 1.0, 6))
        while pl.n < ticks(T):
            sp = speeds.pop(0)
            speeds.append(sp * r(0.9, 1.0))
            d = min(max(0.45 * sp, 0.01), 0.45)
            x = pl.x
            there = x + d if x + d < 0.9 else x - d
            if x < 0:
                there = x + d
            pl.move(there, sp, r(20, 60))
            if rng.random() < 0.3:
                pl.dwell(0.08)
            pl.move(x + r(-0.2, 0.2) * d, sp, r(20, 60))
            if rng.random() < 0.3:
                pl.move(r(-0.5, 0.7), 0.9, 50.0)
    else:
        while pl.n < ticks(T):
            order = list(rng.permutation(6))
            for o in order:
                if o == 0:
                    f1 = r(12, 25)
                    pl.chirp(min(r(0.002, 0.006), 80.0 / (2 * math.pi * f1) ** 2), 0.5, f1, r(1.5, 2.5))
                elif o == 1:
                    pl.multisine(r(0.004, 0.012), r(0.8, 1.6), r(1.2, 2.0))
                elif o == 2:
                    d = r(0.08, 0.45) * (1 if pl.x < 0 else -1)
                    x = pl.x
                    pl.jump(x + d, 0.15 + abs(d) / 1.0)
                    pl.jump(x, 0.15 + abs(d) / 1.0)
                elif o == 3:
                    d = r(0.2, 0.5) * (1 if pl.x < 0 else -1)
                    sp = r(0.3, 1.0)
                    x = pl.x
                    pl.move(x + d, sp, 50.0)
                    pl.move(x - 0.2 * d, sp, 50.0)
                elif o == 4:
                    pl.creep(r(0.003, 0.02) * rng.choice([-1, 1]), r(0.3, 0.6))
                    pl.dwell(r(0.05, 0.2))
                else:
                    pl.sine(r(0.001, 0.004), r(3, 8), 4)
                if rng.random() < 0.35:
                    pl.move(r(-0.5, 0.7), r(0.5, 1.0), 50.0)
    return pl.array(T), [x for x in pl.text if x[0] < T]


# ------------------------------------------------------------------------------------------------ sensors
def quant(x, step):
    return np.round(x / step) * step


def record(out, cmd, rate, bench, rng, th0, encoder=None):
    """out at 10 kHz -> columns at rate"""
    m = 10000 // rate
    n = len(out) // m
    end = out[m - 1:n * m:m]
    mean = out[:n * m].reshape(n, m, NOUT).mean(1)
    count = TWO_PI / 2 ** bench["resolver_bits"]
    th = quant(out[:, 1], count)
    r0 = th0 + (encoder["amplitude"] * math.sin(th0 + encoder["phase"]) if encoder else 0.0)
    r0 = quant(r0, count)
    sp = bench["speed"]
    if sp["kind"] == "own":
        om = end[:, 2] + rng.normal(0, sp["noise_rad_s"], n)
    else:
        om = np.diff(th, prepend=r0) * 1e4
        al = 1.0 - math.exp(-TWO_PI * sp["cutoff_hz"] / 1e4)
        for _ in range(sp["order"]):
            om = _lowpass(om, al)
        om = om[m - 1:n * m:m]
    cq = 2 * bench["current_range_a"] / 2 ** bench["current_bits"]
    src = mean[:, 3:6] if bench["current_sampling"] == "mean" else end[:, 6:9]
    off = rng.uniform(-1, 1, 3) * bench["current_offset_max_a"]
    cur = quant(np.clip(src + off + rng.normal(0, bench["current_noise_a"], (n, 3)), -25.0, 25.0 - cq), cq) + 0.0
    nt = 10000 // rate * 100
    t = np.arange(1, n + 1) / rate
    thm = th[m - 1:n * m:m]
    cols = [("t", t), ("com", cmd[nt - 1:n * nt:nt]), ("theta_u", (thm - r0) / NGEAR), ("theta_m", thm),
            ("omega_m", om), ("i_eq", np.abs(cur).sum(1) / 2), ("i_a", cur[:, 0]), ("i_b", cur[:, 1]), ("i_c", cur[:, 2])]
    if "voltages" in bench:
        b = bench["voltages"]
        v = mean[:, 9:12]
        if b["reference"] == "neutral":
            v = v - v.mean(1, keepdims=True)
        v = quant(v + rng.normal(0, b["noise_v"], v.shape), 2 * b["range_v"] / 2 ** b["bits"]) + 0.0
        cols += [("v_a", v[:, 0]), ("v_b", v[:, 1]), ("v_c", v[:, 2])]
    if "v_dc" in bench:
        b = bench["v_dc"]
        cols.append(("v_dc", quant(mean[:, 12] + rng.normal(0, b["noise_v"], n), b["range_v"] / 2 ** b["bits"])))
    return cols, off


@njit(cache=True)
def _lowpass(x, a):
    y = np.empty_like(x)
    s = 0.0
    for j in range(len(x)):
        s += a * (x[j] - s)
        y[j] = s
    return y


def write_csv(path, cols):
    fmt = ",".join("%.10g" if n in ("t", "theta_m", "theta_u") else "%.7g" for n, _ in cols) + "\n"
    data = np.column_stack([c for _, c in cols]).tolist()
    with open(path, "w") as fh:
        fh.write(",".join(n for n, _ in cols) + "\n")
        fh.writelines(fmt % tuple(row) for row in data)


# ------------------------------------------------------------------------------------------------ a unit
def simulate(cmd, p, nb=100):
    out = np.empty((len(cmd) // nb, NOUT))
    run(cmd, p, nb, out)
    return out


def make_unit(seed, K, M, folder, effect="auto"):
    os.makedirs(folder, exist_ok=True)
    R = lambda tag: np.random.default_rng([seed, K, tag])
    const = draw_constants(R(1))
    bench = draw_bench(seed, K, R(2))
    name = (EFFECTS[(K // 2) % len(EFFECTS)] if K % 2 else "none") if effect == "auto" else effect
    eff = None if name == "none" else draw_effect(name, R(3))
    rt = R(4)
    tests = [[float(rt.uniform(1, 5)), float(rt.uniform(0, 0.5))] for _ in range(M)]
    rest0 = float(R(5).uniform(0, TWO_PI))
    pre = preflight()
    jobs = [("healthy_long_%d" % (j + 1), "long", j, 1.0, 0.0) for j in range(2)]
    jobs += [("healthy_%d" % j, "pre", 0, 1.0, 0.0) for j in range(3)]
    jobs += [("fresh_%d" % j, "pre", 0, 1.0, 0.0) for j in range(2)]
    jobs += [("test_%d" % j, "pre", 0, a, z) for j, (a, z) in enumerate(tests)]
    enc = eff if eff and name == "encoder_eccentricity" else None
    rests, offs, plans, cache = {}, {}, {}, {}
    for j, (fn, kind, which, fsj, zeta) in enumerate(jobs):
        fresh = np.random.default_rng([seed, K, 6, j])
        th0 = rest0 if bench["rest"] == "fixed" else float(fresh.uniform(0, TWO_PI))
        rests[fn] = th0
        if kind == "long":
            cmd, plans[fn] = long_command(np.random.default_rng([seed, K, 8, which]), which)
        else:
            cmd = pre
        p = pack(const, fsj, zeta, th0, eff)
        key = (kind, which, fsj, zeta, th0)
        if key not in cache:
            cache = {key: simulate(cmd, p)}
        rate = bench["rate_hz"] if kind == "long" else bench["preflight_rate_hz"]
        cols, off = record(cache[key], cmd, rate, bench, np.random.default_rng([seed, K, 7, j]), th0, enc)
        offs[fn] = [float(x) for x in off]
        write_csv(os.path.join(folder, fn + ".csv"), cols)
    truth = {"seed": seed, "unit": K, "constants": {k: const[k] for k in const}, "effect": eff, "tests": tests,
             "rest_angle": rest0 if bench["rest"] == "fixed" else rests, "bench": bench,
             "sensor_offsets_a": offs, "long_commands": plans}
    with open(os.path.join(folder, "truth.json"), "w") as fh:
        json.dump(truth, fh, indent=1)


# ------------------------------------------------------------------------------------------------ validation
TABLE = [(1, 0, 0.00022778, 0.00022778, 0, 4.079), (3, 0, 0.03686, 0.00022497, 0.55957, 15.19),
         (5, 0, 0.07415, 0.00041981, 1.1061, 24.78), (1, .3, 0.018782, 0.005007, 0.047767, 4.689),
         (3, .3, 0.053016, 0.0048019, 0.60846, 17.62), (5, .3, 0.087145, 0.0046011, 1.1879, 29.03),
         (1, .5, 0.050979, 0.0085198, 0.072774, 5.619), (5, .5, 0.11493, 0.007893, 1.2748, 32.58)]


def validate():
    nom = simulate(alone("sine"), pack(REF))[:, 13]
    print("fsj zeta   P1 (page)            ripple (page)         P2 (page)           P3 urad (page)")
    for fsj, zeta, a, b, c, d in TABLE:
        p = pack(REF, fsj, zeta)
        w = simulate(alone("step"), p)[2000:6500, 2] / NGEAR
        i3 = simulate(alone("sine"), p)[:, 13]
        ramp = simulate(alone("ramp"), p, 10)
        k = int(np.argmax(ramp[:, 2] != 0.0))
        p1 = math.sqrt(np.mean((w - 1.23872) ** 2))
        p2 = math.sqrt(np.mean((i3 - nom) ** 2))
        p3 = 1e6 * 0.001 * ((k + 1) * 10 - 1) * DT
        print("%3g %4g  %.6f (%.6f)  %.6f (%.6f)  %.5f (%.5f)  %.3f (%.3f)" % (fsj, zeta, p1, a, w.std(), b, p2, c, p3, d)
              + ("   mean %.5f (1.23872)" % w.mean() if fsj == 1 and zeta == 0 else ""))


def main():
    ap = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ap.add_argument("--seed", type=int, default=0)
    ap.add_argument("--units", type=int, default=1)
    ap.add_argument("--tests", type=int, default=1)
    ap.add_argument("--first", type=int, default=0, help="number of the first unit (units K0 .. K0+N-1)")
    ap.add_argument("--out")
    ap.add_argument("--effect", default="auto", help="a name, none, or auto (odd units cycle through the list)")
    ap.add_argument("--validate", action="store_true")
    a = ap.parse_args()
    if a.validate:
        return validate()
    if not a.out:
        ap.error("--out is needed")
    if a.effect not in EFFECTS + ["none", "auto"]:
        ap.error("effects: none auto " + " ".join(EFFECTS))
    for K in range(a.first, a.first + a.units):
        t0 = time.time()
        make_unit(a.seed, K, a.tests, os.path.join(a.out, "unit-%d" % K), a.effect)
        print("unit-%d %.1f s" % (K, time.time() - t0), flush=True)


if __name__ == "__main__":
    main()
