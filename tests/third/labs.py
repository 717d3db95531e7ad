#!/usr/bin/env python3
"""labs.py: an independent judge. Simulates recordings of single-axis rigs as laboratories make them.
Written from interfaces.md, ntb.md (background) and issue14.txt only. Assumptions: eighth.md."""
import argparse, json, math, os, zlib
import numpy as np
from numba import njit

ALPHA = 0.0039                      # 1/K, copper
# ---------------------------------------------------------------- codes of laws in the kernels
CODE = dict(stribeck=1, lubricated_rise=2, quadratic_drag=3, viscous_asymmetry=4, bias_torque=5, load_dependent_friction=6,
            temperature_dependent_friction=7, periodic_friction=8, tight_spot=9, presliding=10, cogging=11, torque_ripple=12,
            torque_saturation=13, spring_load=14, compliance=15, winding_heating=16, dead_time=17, encoder_eccentricity=18,
            current_offset=19, backlash=20,
            time_tone=30, inertia_of_angle=31, payload_change=32, dragging_brake=33, damping_of_position=34, gain_drift=35)
EFFECTS = [k for k, v in CODE.items() if v < 30]
OUTSIDE = {
    "time_tone": "torque of a neighbouring machine, A sin(2 pi f t), tied to time and not to the motion",
    "inertia_of_angle": "linkage: inertia J (1 + a cos(n ang + p)) with its centrifugal term",
    "payload_change": "payload picked up and put down during the run: inertia jumps at clock times",
    "dragging_brake": "holding brake that drags at random times: dry friction switches on and off by itself",
    "damping_of_position": "damping that grows with the square of the position, c x^2 w",
    "gain_drift": "the drive's gain falls linearly with time within each run (demagnetised or drifting amplifier)"}
FRICTION = {"stribeck", "lubricated_rise", "quadratic_drag", "load_dependent_friction", "temperature_dependent_friction", "periodic_friction", "tight_spot"}
PAIRS = [("stribeck", "cogging"), ("quadratic_drag", "bias_torque"), ("presliding", "spring_load"), ("periodic_friction", "bias_torque"),
         ("torque_saturation", "cogging"), ("dead_time", "winding_heating"), ("compliance", "bias_torque"), ("load_dependent_friction", "cogging"),
         ("tight_spot", "spring_load"), ("lubricated_rise", "cogging"), ("encoder_eccentricity", "quadratic_drag"), ("backlash", "stribeck"),
         ("temperature_dependent_friction", "bias_torque"), ("viscous_asymmetry", "cogging"), ("stribeck", "spring_load"),
         ("presliding", "cogging"), ("spring_load", "torque_ripple"), ("dead_time", "stribeck"), ("quadratic_drag", "cogging"),
         ("stribeck", "bias_torque"), ("periodic_friction", "spring_load"), ("load_dependent_friction", "bias_torque"),
         ("stribeck", "torque_ripple"), ("backlash", "bias_torque"), ("stribeck", "quadratic_drag"), ("presliding", "bias_torque"),
         ("winding_heating", "quadratic_drag"), ("temperature_dependent_friction", "cogging"), ("torque_saturation", "stribeck"),
         ("tight_spot", "bias_torque"), ("lubricated_rise", "bias_torque"), ("encoder_eccentricity", "bias_torque")]

# ---------------------------------------------------------------- laws
@njit(cache=True)
def mag(c, P, ang, th, aw, load, temp, aux, Fc, B):
    """dry friction magnitude that the law adds; acts against the motion"""
    if c == 1: return P[0] * math.exp(-(aw / P[1]) ** P[2])
    if c == 2: return P[0] * (1.0 - math.exp(-aw / P[1]))
    if c == 3: return P[0] * aw * aw
    if c == 6: return P[0] * abs(load)
    if c == 7: return P[0] * (temp - P[1]) * (Fc + B * aw)
    if c == 8: return P[0] * math.sin(P[2] * ang + P[1])
    if c == 9: return P[0] * math.exp(-0.5 * ((th - P[1]) / P[2]) ** 2)
    if c == 33: return P[0] * aux
    return 0.0

@njit(cache=True)
def pla(c, P, ang, th, w, t, J):
    """torque that the drive must give besides, independent of the drive's own value"""
    if c == 4: return P[0] * abs(w)
    if c == 5: return P[0]
    if c == 11: return P[0] * math.sin(P[2] * ang + P[1])
    if c == 14: return P[0] * th
    if c == 30: return P[0] * math.sin(2 * math.pi * P[1] * t + P[2])
    if c == 31: return -0.5 * J * P[0] * P[1] * P[3] * math.sin(P[1] * ang + P[2]) * w * w
    if c == 34: return P[0] * th * th * w
    return 0.0

@njit(cache=True)
def loss(c, P, ang, i, t):
    """relative loss of the drive's torque"""
    if c == 12: return -P[0] * math.sin(P[2] * ang + P[1])
    if c == 13: return P[0] * i * i
    if c == 35: return P[0] * t / P[1]
    return 0.0

@njit(cache=True)
def jrel(c, P, ang, aux):
    if c == 31: return P[0] * math.cos(P[1] * ang + P[2])
    if c == 32: return P[0] * aux
    return 0.0

@njit(cache=True)
def sums(EC, EP, ang, th, w, aw, i, t, load, temp, aux, Fc, B, J):
    m = 0.0; p = 0.0; l = 0.0; j = 0.0
    for k in range(2):
        c = EC[k]
        if c == 0: continue
        m += mag(c, EP[k], ang, th, aw, load, temp, aux, Fc, B)
        p += pla(c, EP[k], ang, th, w, t, J)
        l += loss(c, EP[k], ang, i, t)
        j += jrel(c, EP[k], ang, aux)
    return m, p, l, j

@njit(cache=True)
def contributions(EC, EP, par, ang, th, w, s, i, a, al, z, t, load, temp, aux, E, n):
    J = par[0]; B = par[1]; Fc = par[2]; kt = par[3]
    for k in range(2):
        c = EC[k]
        if c == 0: continue
        P = EP[k]
        e = s * mag(c, P, ang, th, abs(w), load, temp, aux, Fc, B) + pla(c, P, ang, th, w, t, J)
        e += kt * i * loss(c, P, ang, i, t) + J * jrel(c, P, ang, aux) * a
        if c == 10:
            e += par[5] * z + par[6] * (w - par[5] * abs(w) * z / Fc) - Fc * s
        if c == 15:
            e += par[10] * (al - a)
        E[k, n] = e

# ---------------------------------------------------------------- motion prescribed, drive by inverse dynamics
@njit(cache=True)
def inverse(h, par, EC, EP, TH, W, A, load, temp, aux, I, E, MV):
    J = par[0]; B = par[1]; Fc = par[2]; kt = par[3]
    z = 0.0
    N = len(TH)
    for n in range(N):
        th = TH[n]; w = W[n]; a = A[n]; t = n * h; ang = th * par[4]
        s = 1.0 if w > 0 else (-1.0 if w < 0 else 0.0)
        m, p, l, j = sums(EC, EP, ang, th, w, abs(w), 0.0, t, load[n], temp[n], aux[n], Fc, B, J)
        T = J * (1 + j) * a + B * w + p + load[n]
        if par[7] > 0:
            T += par[5] * z + par[6] * (w - par[5] * abs(w) * z / Fc)
        else:
            T += s * (Fc + m)
        i = T / kt
        for it in range(40):
            l = 0.0; dl = 0.0
            for k in range(2):
                l += loss(EC[k], EP[k], ang, i, t)
                if EC[k] == 13: dl += 2 * EP[k, 0] * i
            f = kt * i * (1 - l) - T
            di = f / (kt * (1 - l - i * dl))
            i -= di
            if abs(di) < 1e-15 * (1 + abs(i)): break
        I[n] = i
        contributions(EC, EP, par, ang, th, w, s, i, a, 0.0, z, t, load[n], temp[n], aux[n], E, n)
        MV[n] = 1.0 if s != 0 else 0.0
        if par[7] > 0 and n + 1 < N:
            wm = 0.5 * (w + W[n + 1]); r = par[5] * abs(wm) / Fc
            if r > 1e-12: z = z * math.exp(-r * h) + wm * (1 - math.exp(-r * h)) / r
            else: z += wm * h

# ---------------------------------------------------------------- closed loop (or open voltage), midpoint rule, true sticking
@njit(cache=True)
def forward(h, par, ctl, EC, EP, rth, rw, ra, inj, load, temp, aux, TH, W, A, I, DI, U, E, MV):
    J = par[0]; B = par[1]; Fc = par[2]; kt = par[3]; lug = par[7] > 0; two = par[11] > 0; Jl = par[10]
    volt = par[18] > 0; R0 = par[12]; L = par[13]; ke = par[14]; Vd = par[15]
    Jm = J - Jl if two else J
    N = len(rth)
    th = rth[0]; w = rw[0]; thl = th; wl = w; z = 0.0; i = 0.0; Ig = 0.0; iref = 0.0; u = 0.0
    if lug and w != 0: z = Fc / par[5] * (1.0 if w > 0 else -1.0)
    i = (B * w + Fc * (1.0 if w > 0 else (-1.0 if w < 0 else 0.0)) + J * ra[0]) / kt
    Nc = int(ctl[5]); qe = ctl[6]; ki = 1 - math.exp(-h / ctl[7])
    for n in range(N):
        t = n * h
        heat = par[16] * (1 - math.exp(-t / par[17])) / (1 - math.exp(-par[19] / par[17])) if par[16] != 0 else 0.0
        R = R0 * (1 + 0.0039 * heat)
        if n % Nc == 0:
            pm = th + ctl[10] * math.sin(th + ctl[11])
            pm = math.floor(pm / qe + 0.5) * qe
            wr = rw[n] + ctl[0] * (rth[n] - pm)
            er = wr - w
            iref = (ctl[3] * J * ra[n] + ctl[1] * er + Ig) / kt + inj[n]
            if abs(iref) < ctl[4]: Ig += ctl[2] * er * Nc * h
            iref = min(max(iref, -ctl[4]), ctl[4])
            if volt:
                u = inj[n] if ctl[9] > 0 else ke * w + R0 * iref + ctl[12] * (iref - i)
                u = min(max(u, -ctl[8]), ctl[8])
        # electrical step
        if volt:
            d = u - ke * w
            si = 1.0 if i > 0 else (-1.0 if i < 0 else (1.0 if d > 0 else -1.0))
            if i == 0.0 and abs(d) <= Vd:
                di = 0.0; i2 = 0.0; i3 = 0.0
            else:
                di = (d - R * i - Vd * si) / L
                iinf = (d - Vd * si) / R
                i2 = iinf + (i - iinf) * math.exp(-h * R / L)
                i3 = iinf + (i - iinf) * math.exp(-0.5 * h * R / L)
                if i * i2 < 0 and Vd > 0:
                    i2 = 0.0; i3 = 0.5 * i
        else:
            di = 0.0; i2 = i + ki * (iref - i); i3 = 0.5 * (i + i2)
        # mechanics at the step's start
        ang = th * par[4]
        s = 1.0 if w > 0 else (-1.0 if w < 0 else 0.0)
        m, p, l, j = sums(EC, EP, ang, th, w, abs(w), i, t, load[n], temp[n], aux[n], Fc, B, J)
        sh = par[8] * (th - thl) + par[9] * (w - wl) if two else 0.0
        net = kt * i * (1 - l) - p - load[n] - B * w - sh
        stuck = False
        if lug:
            a = (net - par[5] * z - par[6] * (w - par[5] * abs(w) * z / Fc)) / (Jm + J * j)
        else:
            if w == 0.0:
                if abs(net) <= Fc + m: stuck = True
                else: s = 1.0 if net > 0 else -1.0
            a = 0.0 if stuck else (net - s * (Fc + m)) / (Jm + J * j)
        al = sh / Jl if two else 0.0
        TH[n] = th; W[n] = w; A[n] = a; I[n] = i; DI[n] = di; U[n] = u
        MV[n] = 0.0 if (stuck or s == 0) else 1.0
        contributions(EC, EP, par, ang, th, w, s, i, a, al, z, t, load[n], temp[n], aux[n], E, n)
        # midpoint
        wm = w + 0.5 * h * a; tm = th + 0.5 * h * w; tlm = thl + 0.5 * h * wl; wlm = wl + 0.5 * h * al
        zm = z
        if lug:
            r = par[5] * abs(wm) / Fc
            if r > 1e-12:
                zm = z * math.exp(-0.5 * r * h) + wm * (1 - math.exp(-0.5 * r * h)) / r
                z = z * math.exp(-r * h) + wm * (1 - math.exp(-r * h)) / r
            else:
                zm = z + 0.5 * h * wm; z += wm * h
        n2 = min(n + 1, N - 1)
        ld = 0.5 * (load[n] + load[n2]); tp = 0.5 * (temp[n] + temp[n2])
        shm = par[8] * (tm - tlm) + par[9] * (wm - wlm) if two else 0.0
        if stuck:
            wn = 0.0; tn = th
        else:
            m, p, l, j = sums(EC, EP, tm * par[4], tm, wm, abs(wm), i3, t + 0.5 * h, ld, tp, aux[n], Fc, B, J)
            net = kt * i3 * (1 - l) - p - ld - B * wm - shm
            if lug: am = (net - par[5] * zm - par[6] * (wm - par[5] * abs(wm) * zm / Fc)) / (Jm + J * j)
            else: am = (net - s * (Fc + m)) / (Jm + J * j)
            wn = w + h * am; tn = th + h * wm
            if not lug and wn * s <= 0.0:
                x = w / (w - wn) if w != wn else 0.0
                wn = 0.0; tn = th + 0.5 * w * h * x
        if two:
            thl += h * wlm; wl += h * shm / Jl
        th = tn; w = wn; i = i2

@njit(cache=True)
def play(x, half, out):
    y = x[0]
    for n in range(len(x)):
        if x[n] - y > half: y = x[n] - half
        elif x[n] - y < -half: y = x[n] + half
        out[n] = y

# ---------------------------------------------------------------- commands
def U(r, a, b): return float(r.uniform(a, b))
def LU(r, a, b): return float(math.exp(r.uniform(math.log(a), math.log(b))))

def nodes(t, tn, wn, kind):
    tn = np.asarray(tn, float); wn = np.asarray(wn, float)
    D = np.diff(tn); dw = np.diff(wn)
    area = D * (wn[:-1] + wn[1:]) / 2                     # the same for straight and cosine
    c0 = np.concatenate([[0], np.cumsum(area)])
    k = np.clip(np.searchsorted(tn, t, side="right") - 1, 0, len(D) - 1)
    x = t - tn[k]; d = D[k]; g = dw[k]; w0 = wn[k]
    if kind == "lin":
        return c0[k] + w0 * x + g * x * x / (2 * d), w0 + g * x / d, g / d
    s = np.pi * x / d
    return c0[k] + w0 * x + g / 2 * (x - d / np.pi * np.sin(s)), w0 + g * (1 - np.cos(s)) / 2, g * np.pi / (2 * d) * np.sin(s)

def command(r, kind, T, h, wmax, fm, amax):
    """position, speed, acceleration on the fine grid; speeds up to wmax, typical frequency fm"""
    t = np.arange(int(round(T / h)) + 1) * h
    lev = U(r, 0.7, 1.0) * wmax
    if kind in ("sines", "multisine"):
        if kind == "sines":
            n = int(r.integers(2, 5)); f = fm * np.exp(r.uniform(math.log(0.3), math.log(2.2), n)); am = r.uniform(0.5, 1, n)
        else:
            n = int(r.integers(6, 13)); f0 = fm * U(r, 0.15, 0.3); f = f0 * np.arange(1, n + 1); am = np.ones(n)
        f = np.maximum(f, 1.5 / T)
        ph = r.uniform(-np.pi, np.pi, n); om = 2 * np.pi * f
        w = (am[:, None] * np.cos(om[:, None] * t + ph[:, None])).sum(0); k = lev / np.abs(w).max(); am = am * k
        w = w * k
        a = -(am[:, None] * om[:, None] * np.sin(om[:, None] * t + ph[:, None])).sum(0)
        x = ((am / om)[:, None] * np.sin(om[:, None] * t + ph[:, None])).sum(0)
        return x, w, a
    if kind == "sweep":
        f0 = max(fm * U(r, 0.25, 0.5), 1.0 / T); f1 = fm * U(r, 2, 4)
        k = (f1 - f0) / T; ph = 2 * np.pi * (f0 * t + k * t * t / 2); om = 2 * np.pi * (f0 + k * t)
        g = lev * (om[0] / om) ** 0.3; gd = -0.3 * g * 2 * np.pi * k / om
        w = g * np.cos(ph); a = gd * np.cos(ph) - g * om * np.sin(ph)
        x = np.concatenate([[0], np.cumsum((w[1:] + w[:-1]) * h / 2)]) - h * h / 12 * (a - a[0])
        return x - x.mean(), w, a
    tn, wn = [0.0], [0.0]
    def to(v, dt): tn.append(tn[-1] + dt); wn.append(v)
    P = 1 / fm; tr = lambda v: max(1.3 * abs(v) / amax, 0.02)
    sg = 1.0 if r.random() < 0.5 else -1.0
    interp = "lin" if r.random() < 0.4 else "cos"
    if kind == "triangle":
        k = 0
        half = U(r, 0.4, 0.7) * P * lev * 0.5                # distance of a leg
        lv = [lev, 0.15 * lev, 0.5 * lev, 0.08 * lev, 0.3 * lev]; first = True
        while tn[-1] < T:
            v = lv[k % 5] * U(r, 0.85, 1.1)
            for q in (1, -1):
                d = half * (0.5 if first else 1.0); first = False
                ta = tr(v) if wn[-1] == 0 else tr(v - wn[-1])
                to(sg * q * v, ta); to(sg * q * v, max(min(d / v, 0.35 * T), 0.05))
            k += 1
    elif kind == "moves":
        pos = 0.0; S = 0.5 * lev * P * U(r, 0.7, 1.1) * 0.6
        to(0, U(r, 0.1, 0.4))
        while tn[-1] < T:
            tgt = U(r, -1, 1) * S
            if abs(tgt - pos) < 0.3 * S: continue
            d = tgt - pos; v = min(lev * U(r, 0.35, 1.0), math.sqrt(abs(d) * amax) * 0.7); v = math.copysign(v, d)
            ta = max(1.3 * abs(v) / amax, 0.02); th = max(abs(d / v) - ta, 0.0)
            to(v, ta)
            if th > 0: to(v, th)
            to(0.0, ta)
            to(0.0, U(r, 0.05, 0.35))
            pos = tgt if th > 0 else pos + v * ta
    elif kind == "staircase":                                 # position up in steps and down again
        n = int(r.integers(3, 7)); S = 0.5 * lev * P * U(r, 0.5, 0.9); d = S / n; up = sg
        to(0, U(r, 0.1, 0.3))
        while tn[-1] < T:
            for k in range(n):
                v = min(lev, math.sqrt(d * amax) * 0.7) * U(r, 0.5, 1.0); ta = max(1.3 * v / amax, 0.02); th = max(d / v - ta, 0.01)
                v = d / (ta + th)
                to(up * v, ta); to(up * v, th); to(0, ta); to(0, U(r, 0.05, 0.3))
            up = -up
    elif kind == "speed_staircase":
        L = list(r.permutation([0.06, 0.15, 0.3, 0.5, 0.75, 1.0]))
        hold = max(T / 14.0, 0.25)
        while tn[-1] < T:
            for f in L:
                v = sg * f * lev
                to(v, tr(v - wn[-1])); to(v, hold * U(r, 0.6, 1.1))
            sg = -sg
    elif kind == "velocity_ramps":
        while tn[-1] < T:
            v = sg * lev * U(r, 0.4, 1.0)
            to(v, max(tr(v - wn[-1]), P * U(r, 0.4, 1.0))); sg = -sg
    elif kind == "long_constant":
        hold = T / U(r, 4.5, 7)
        while tn[-1] < T:
            v = sg * lev * U(r, 0.3, 1.0)
            to(v, tr(v - wn[-1])); to(v, hold); sg = -sg
    else: raise ValueError(kind)
    x, w, a = nodes(t, tn, wn, interp)
    return x, w, a

BOUNDED = ["sines", "multisine", "sweep", "triangle", "moves", "staircase"]
FREE = ["speed_staircase", "velocity_ramps", "long_constant"]

# ---------------------------------------------------------------- recording
class Redraw(Exception): pass

def lowpass(x, f, fc, der=0):
    X = np.fft.rfft(x); q = np.fft.rfftfreq(len(x), 1 / f); X[q > fc] = 0
    if der: X = X * (2j * np.pi * q) ** der
    return np.fft.irfft(X, len(x))

def rms(x): return float(np.sqrt(np.mean(np.square(x)))) if len(x) else 0.0

def rest(e, X):
    """what X leaves of e (least squares, columns scaled)"""
    X = X / np.maximum(np.sqrt((X ** 2).mean(0)), 1e-300)
    c, *_ = np.linalg.lstsq(X, e, rcond=None)
    return e - X @ c

def q(x, res): return np.round(x / res) * res if res else x

def draw(r, cls, eff, law):
    """one attempt; raises Redraw where the effect is not clearly visible or the rig behaves oddly"""
    names = eff if cls != "outside" else [law]
    has = lambda *n: any(x in names for x in n)
    elec = has("winding_heating", "dead_time")
    # ---- which rig
    if elec: fam = "rot_voltage"
    elif has("backlash"): fam = r.choice(["lin_current", "lin_force"], p=[0.7, 0.3])
    elif has("torque_ripple", "torque_saturation", "current_offset"): fam = r.choice(["rot_current", "lin_current"], p=[0.8, 0.2])
    elif has("load_dependent_friction"): fam = r.choice(["rot_current", "rot_torque"], p=[0.7, 0.3])
    elif has("encoder_eccentricity"): fam = r.choice(["rot_current", "rot_torque"], p=[0.75, 0.25])
    elif has("compliance"): fam = r.choice(["rot_current", "rot_torque", "lin_current"], p=[0.7, 0.15, 0.15])
    elif has("gain_drift"): fam = r.choice(["rot_current", "lin_current"], p=[0.7, 0.3])
    else: fam = r.choice(["rot_current", "rot_torque", "rot_voltage", "lin_current", "lin_force"], p=[0.45, 0.13, 0.12, 0.18, 0.12])
    fam = str(fam); linear = fam.startswith("lin"); drive = fam.split("_")[1]; volt = drive == "voltage"
    rate = float(r.choice([500, 1000, 2000, 2500, 4000, 5000, 10000], p=[.14, .3, .25, .05, .1, .09, .07]))
    if has("compliance"): rate = max(rate, 1000.0)
    if has("winding_heating", "temperature_dependent_friction"): rate = min(rate, 2000.0)
    maxT = min(24.0, 44000 / rate)
    F = rate * math.ceil(20000 / rate)
    h = 1 / F
    # ---- speeds, masses
    periodic = has("cogging", "torque_ripple", "periodic_friction", "inertia_of_angle")
    lead = 0.0
    if linear:
        lead = float(r.choice([0.005, 0.01, 0.02])); kpos = 2 * math.pi / lead
        fm = U(r, 0.4, 2.0); wmax = LU(r, 0.04, 0.35)
        if periodic: wmax = min(wmax, lead * U(r, 2, 8)); fm = min(fm, 1.2)
        J = LU(r, 5, 120)
    else:
        kpos = 1.0; fm = U(r, 0.4, 2.5); wmax = LU(r, 25, 220)
        if periodic: wmax = LU(r, 8, 55); fm = min(fm, 1.4)
        if has("encoder_eccentricity"): wmax = LU(r, 10, 80)
        if has("tight_spot"): fm = U(r, 0.35, 1.5); wmax = U(r, 1.2, 2.6) * 2 * math.pi * fm * 0.7
        J = LU(r, 2e-5, 2e-3)
    if maxT < 8: fm = max(fm, 6.0 / maxT)
    Tacc = J * wmax * 2 * math.pi * fm * 0.7
    Fc = LU(r, 0.2, 1.6) * Tacc
    if not linear: Fc = min(max(Fc, 0.0015), 0.4)
    B = U(r, 0.15, 0.9) * Fc / wmax
    Tref = 0.6 * Tacc + Fc + 0.4 * B * wmax
    Iref = LU(r, 0.5, 6.0); kt = Tref / Iref if drive in ("current", "voltage") else 1.0
    par = np.zeros(20); par[:5] = J, B, Fc, kt, kpos
    par[17] = 1.0; par[19] = 1.0
    ctl = np.zeros(16); tau_i = U(r, 0.2, 0.6) * 1e-3
    Rw = L = ke = 0.0
    if volt:
        ke = kt; Ve = kt * wmax
        rho = U(r, 0.5, 1.3) if elec else U(r, 0.25, 1.0)
        Rw = rho * Ve / Iref; L = Rw * U(r, 0.2, 0.7) * 1e-3
        par[12:15] = Rw, L, ke; par[18] = 1.0
    # ---- how it is moved
    bounded = linear or has("tight_spot", "spring_load", "damping_of_position", "presliding", "backlash") or r.random() < 0.35
    prescribed = (not volt) and not has("compliance", "payload_change") and r.random() < 0.38
    kinds = list(BOUNDED) if bounded else list(BOUNDED) + FREE + FREE
    if prescribed: kinds = [k for k in kinds if k not in ("moves", "staircase")]
    if has("encoder_eccentricity"): kinds = [k for k in kinds if k in FREE or k in ("triangle", "sines")] if not bounded else ["triangle", "sines", "sweep"]
    if has("compliance"): kinds = ["triangle", "sines"] + ([] if bounded else ["long_constant", "speed_staircase"])
    if has("presliding"): kinds = ["sines", "multisine", "triangle", "sweep"]
    open_loop = volt and not elec and not bounded and r.random() < 0.3
    if has("tight_spot", "spring_load", "damping_of_position"): stroke_cap = True
    nfit = int(r.integers(2, 4)); nheld = 1 if r.random() < 0.7 else 2
    T0 = U(r, 0.5, 1.0) * maxT
    if rate <= 1000 and r.random() < 0.25: T0 *= 1.4
    # ---- effect parameters
    EC = np.zeros(2, np.int64); EP = np.zeros((2, 6)); params = []
    stroke = wmax / (2 * math.pi * fm)
    def order(cands):
        ok = [o for o in cands if 1.0 < o * kpos * 0.6 * wmax / (2 * math.pi) < min(70.0, 0.1 * rate) and o * kpos * stroke > 3.0]
        if not ok: raise Redraw("order")
        return float(r.choice(ok))
    encA = encP = Ioff = gap = 0.0
    fa = 0.0
    for k, nm in enumerate(names):
        EC[k] = CODE[nm]; P = EP[k]; d = {}
        if nm == "stribeck":
            P[:3] = U(r, 0.35, 1.0) * Fc, U(r, 0.04, 0.15) * wmax, float(r.choice([1.0, 2.0, round(U(r, 0.8, 2.0), 2)]))
            d = dict(torque=P[0], speed=P[1], exponent=P[2])
        elif nm == "lubricated_rise":
            P[:2] = U(r, 0.5, 1.4) * Fc, U(r, 0.06, 0.25) * wmax; d = dict(torque=P[0], speed=P[1])
        elif nm == "quadratic_drag":
            P[0] = U(r, 0.5, 1.5) * (Fc + B * wmax) / wmax ** 2; d = dict(coefficient=P[0])
        elif nm == "viscous_asymmetry":
            P[0] = U(r, 0.3, 0.6) * B * r.choice([-1, 1]); d = dict(coefficient=P[0])
        elif nm == "bias_torque":
            P[0] = U(r, 0.12, 0.5) * Tref * r.choice([-1, 1]); d = dict(torque=P[0])
        elif nm == "load_dependent_friction":
            P[0] = U(r, 0.08, 0.22); d = dict(coefficient=P[0])
        elif nm == "temperature_dependent_friction":
            P[:2] = -U(r, 0.009, 0.018), 20.0; d = dict(coefficient=P[0])
        elif nm == "periodic_friction":
            P[0] = U(r, 0.35, 0.75) * Fc; P[1] = U(r, -3.1, 3.1)
            P[2] = order([1, 1, 2, 2, 3, 4, 0.5, 1.6, 2.4, 3.6, 5.25]); d = dict(amplitude=P[0], phase=P[1], order=P[2])
        elif nm == "tight_spot":
            P[:3] = U(r, 0.7, 1.8) * Fc, U(r, -0.4, 0.4) * stroke, U(r, 0.08, 0.18) * stroke; d = dict(torque=P[0], centre=P[1], width=P[2])
        elif nm == "presliding":
            zs = U(r, 0.05, 0.2) * stroke; par[5] = Fc / zs; par[6] = U(r, 0.3, 0.8) * 2 * math.sqrt(par[5] * J) * 0.5; par[7] = 1
            d = dict(stiffness=par[5], damping=par[6])
        elif nm == "cogging":
            P[0] = U(r, 0.1, 0.35) * Tref; P[1] = U(r, -3.1, 3.1)
            if Fc < 1.2 * P[0] and r.random() < 0.5: P[0] = 0.8 * Fc
            P[2] = order([2, 3, 4, 6, 7, 8, 9, 12, 14, 18, 24, 36] + ([1] if linear else [])); d = dict(amplitude=P[0], phase=P[1], order=P[2])
        elif nm == "torque_ripple":
            P[0] = U(r, 0.05, 0.14); P[1] = U(r, -3.1, 3.1); P[2] = order([1, 2, 3, 4, 5, 6, 7, 10, 12, 14, 18, 24]); d = dict(fraction=P[0], phase=P[1], order=P[2])
        elif nm == "torque_saturation":
            P[0] = 1.0                                       # set below, when the peak current is known
        elif nm == "spring_load":
            P[0] = U(r, 0.4, 1.4) * Tref / stroke; d = dict(stiffness=P[0])
        elif nm == "compliance":
            fa = U(r, 8, 28); Jl = U(r, 0.3, 0.65) * J; kk = Jl * (2 * math.pi * fa) ** 2; dd = 2 * U(r, 0.02, 0.07) * math.sqrt(kk * Jl)
            par[8:12] = kk, dd, Jl, 1; d = dict(stiffness=kk, damping=dd, inertia=Jl)
        elif nm == "winding_heating":
            par[16] = U(r, 45, 90); par[17] = U(r, 6, 18); d = dict(delta_t=par[16])
        elif nm == "dead_time":
            par[15] = U(r, 0.06, 0.16) * (kt * wmax * 0.6 + Rw * Iref); d = dict(voltage=par[15])
        elif nm == "encoder_eccentricity":
            encA = U(r, 0.03, 0.07); encP = U(r, -3.1, 3.1); d = dict(amplitude=encA, phase=encP)
        elif nm == "current_offset":
            Ioff = U(r, 0.12, 0.45) * Tref / kt * r.choice([-1, 1]); d = dict(current=Ioff)
        elif nm == "backlash":
            gap = U(r, 0.05, 0.14) * stroke; d = dict(gap=gap)
        elif nm == "time_tone":
            P[:3] = U(r, 0.2, 0.5) * Tref, U(r, 2.5, 11.0), U(r, -3, 3)
        elif nm == "inertia_of_angle":
            P[0] = U(r, 0.3, 0.55); P[1] = 1.0 if r.random() < .5 else 2.0; P[2] = U(r, -3, 3); P[3] = kpos
            if linear: P[1] = 2 * math.pi / kpos / (U(r, 1.2, 2.5) * stroke)
            if 0.6 * wmax * P[1] * kpos / (2 * math.pi) > 15: raise Redraw("fast")
        elif nm == "payload_change": P[0] = U(r, 0.5, 1.0)
        elif nm == "dragging_brake": P[0] = U(r, 0.7, 1.5) * Fc
        elif nm == "damping_of_position": P[0] = U(r, 2.0, 5.0) * (B * wmax + 0.4 * Fc) / wmax / stroke ** 2
        elif nm == "gain_drift": P[0] = U(r, 0.2, 0.4)
        params.append(d)
    for nm in names:
        if nm == "presliding" and has(*FRICTION): raise Redraw("pair")
    # ---- sensors
    if linear: res = float(r.choice([1e-7, 5e-7, 1e-6, lead / 65536, lead / 10000]))
    else: res = 2 * math.pi / float(r.choice([4000, 8192, 10000, 16384, 20000, 65536, 65536, 131072, 2 ** 20]))
    use_vel = has("encoder_eccentricity") or r.random() < 0.62
    vel_kind = "white"
    if use_vel and not has("encoder_eccentricity") and res * rate < 0.004 * wmax and r.random() < 0.35: vel_kind = "diff"
    if not use_vel and res * rate > 0.08 * wmax: res /= 16 if not linear else 10
    mean = r.random() < 0.42
    jitter = rate <= 2000 and r.random() < 0.16
    cur_chan = drive == "current" or (volt and (elec or r.random() < 0.6))
    lag = dict(drive=0.0, motion=0.0); lag_known = False
    x = r.random()
    if x < 0.14: lag["drive"] = U(r, 0.1, 0.8) * 1e-3
    elif x < 0.22: lag["motion"] = U(r, 0.1, 0.6) * 1e-3
    elif x < 0.30: lag[str(r.choice(["drive", "motion"]))] = round(U(r, 0.2, 2.0), 2) * 1e-3; lag_known = True
    hum = float(r.choice([50, 50, 60, 400])) if r.random() < 0.2 else 0.0
    if hum >= rate / 2.2: hum = 50.0
    use_load = has("load_dependent_friction") or (drive in ("current", "torque") and not linear and not prescribed and not has("presliding", "compliance") and r.random() < 0.06)
    use_temp = has("temperature_dependent_friction") or r.random() < 0.12
    use_user = has("backlash") or (linear and r.random() < 0.1)
    ures = float(r.choice([1e-7, 5e-7, 1e-6])) if use_user else 0.0
    off_run = (cur_chan and r.random() < (0.5 if has("bias_torque", "current_offset") else 0.1))
    # ---- controller
    bw = 2 * math.pi * U(r, 12, 40)
    if has("compliance"): bw = 2 * math.pi * fa * U(r, 0.12, 0.2)
    ctl[0] = bw / U(r, 4, 8); ctl[1] = J * bw; ctl[2] = J * bw * bw / U(r, 6, 14); ctl[3] = 1.0 if r.random() < 0.6 else 0.0
    ctl[4] = 12 * Tref / kt; ctl[5] = max(1, round(F / float(r.choice([2000, 4000, 8000])))); ctl[6] = res; ctl[7] = tau_i
    ctl[8] = 12 * (kt * wmax + Rw * Iref) if volt else 1.0
    ctl[9] = 1.0 if open_loop else 0.0; ctl[10] = encA; ctl[11] = encP; ctl[12] = L * 2 * math.pi * 250 if volt else 0.0
    amax = wmax * 2 * math.pi * fm * U(r, 1.0, 2.0)
    runs = []
    load_amp = U(r, 1.5, 4.0) * Fc
    # ---- runs
    picks = list(r.permutation(kinds))
    while len(picks) < nfit + nheld: picks += list(r.permutation(kinds))
    if nfit + nheld <= len(picks) and r.random() < 0.5: picks[nfit] = picks[int(r.integers(nfit))]   # held-out of the fit runs' sort
    for k in range(nfit + nheld):
        kind = str(picks[k])
        T = T0 * U(r, 0.8, 1.0); T = math.floor(T * rate) / rate
        if has("winding_heating"): T = min(max(T, 15.0), 22.0)
        lo = U(r, 0.55, 1.0) if k else 1.0
        f_run = fm * U(r, 0.8, 1.25)
        if has("tight_spot", "spring_load", "backlash", "damping_of_position"): lo = U(r, 0.85, 1.0); f_run = fm
        x, w, a = command(r, kind, T, h, wmax * lo, f_run, amax)
        if has("tight_spot"):
            if not linear and np.abs(x).max() > 3.1:
                g = 3.0 / np.abs(x).max(); x, w, a = x * g, w * g, a * g
        N = len(x); t = np.arange(N) * h
        par[19] = T
        for q2 in range(2):
            if EC[q2] == 35: EP[q2, 1] = T
        inj = np.zeros(N)
        if has("compliance"):
            A0 = U(r, 0.6, 1.2) * (Fc + 0.3 * Tacc) / kt
            if r.random() < 0.5:
                f0, f1 = 0.3 * fa, 2.4 * fa; inj = A0 * np.sin(2 * np.pi * (f0 * t + (f1 - f0) * t * t / (2 * T)))
            else:
                fr = np.arange(1, 25) * 0.1 * fa; inj = sum(np.sin(2 * np.pi * f * t + p) for f, p in zip(fr, r.uniform(0, 6.28, len(fr)))); inj *= A0 / (2 * rms(inj))
        if open_loop:
            inj = ke * w + Rw / kt * (B * w + Fc * np.tanh(w / (0.02 * wmax)) * U(r, 0.8, 1.2) + J * a)
            if kind in ("sines", "multisine", "sweep"): inj = ke * w * 1.3 + Rw / kt * J * a * U(r, 0, 0.5)
        load = np.zeros(N); temp = np.full(N, 20.0); aux = np.zeros(N)
        if use_load:
            n = int(r.integers(4, 9)); tk = np.linspace(0, T, n + 1); lv = r.uniform(-1, 1, n + 2) * load_amp
            ramp = U(r, 0.05, 0.2)
            load = np.full(N, lv[0])
            for j2 in range(1, n): load = load + (lv[j2] - lv[j2 - 1]) * 0.5 * (1 + np.tanh((t - tk[j2]) / ramp))
            if r.random() < 0.4: load = load + 0.3 * load_amp * np.sin(2 * np.pi * U(r, 0.2, 0.9) * t + 1.0)
        if use_temp:
            st = U(r, 19, 24) + (8.0 * ((k * 2) % 3) if has("temperature_dependent_friction") else 3 * k)
            temp = st + (U(r, 5, 12) if has("temperature_dependent_friction") else U(r, 1, 8)) * (1 - np.exp(-t / (T * U(r, 0.4, 1.0)))) / 0.8
        if has("payload_change"):
            cuts = np.sort(r.uniform(0.1, 0.95, 3)) * T; aux = ((t > cuts[0]) & (t < cuts[1]) | (t > cuts[2])).astype(float)
        if has("dragging_brake"):
            tt = U(r, 0, 0.5); on = 0.0
            while tt < T:
                d2 = r.exponential(0.6) + 0.15; aux[int(tt / h):int(min(tt + d2, T) / h)] = on; on = 1 - on; tt += d2
            aux[0] = 0
        R = dict(kind=kind, T=T, t=t, load=load, temp=temp, ref=x)
        TH = x.copy(); W = w.copy(); A = a.copy(); I = np.zeros(N); DI = np.zeros(N); Uv = np.zeros(N); E = np.zeros((2, N)); MV = np.zeros(N)
        if has("torque_saturation"):
            j2 = names.index("torque_saturation")
            if k == 0:
                g = np.abs(J * a + B * w + Fc * np.sign(w)) / kt; EP[j2, 0] = U(r, 0.15, 0.32) / np.percentile(g, 99.5) ** 2
                params[j2] = dict(coefficient=EP[j2, 0])
            ctl[4] = 0.62 / math.sqrt(EP[j2, 0])              # the drive's own limit
        if prescribed: inverse(h, par, EC, EP, TH, W, A, load, temp, aux, I, E, MV)
        else: forward(h, par, ctl, EC, EP, x, w, a, inj, load, temp, aux, TH, W, A, I, DI, Uv, E, MV)
        if not np.all(np.isfinite(TH)) or not np.all(np.isfinite(I)): raise Redraw("nan")
        if not prescribed and not open_loop and not has("compliance") and (rms(W - w) > 0.6 * rms(w) or rms(TH - x) > 0.5 * rms(x - x.mean()) + 1e-9): raise Redraw("tracking")
        if MV.mean() < 0.45 or rms(W) < 0.08 * wmax or np.abs(W).max() > 4 * wmax: raise Redraw("still")
        if has("torque_saturation") and EP[names.index("torque_saturation"), 0] * np.abs(I).max() ** 2 > 0.4: raise Redraw("too saturated")
        if has("tight_spot") and not linear and np.abs(TH).max() > 3.14: raise Redraw("turn")
        R.update(TH=TH, W=W, A=A, I=I, DI=DI, U=Uv, E=E, MV=MV)
        # the true equation, with derivatives taken from the trajectory itself
        d1 = (W[2:] - W[:-2]) * (0.5 / h); v1 = (TH[2:] - TH[:-2]) * (0.5 / h)
        ok = (MV[1:-1] > 0) & (np.sign(W[2:]) == np.sign(W[:-2]))
        Mv = W[1:-1]
        eq = kt * I[1:-1] - J * A[1:-1] - B * Mv - Fc * np.sign(Mv) - load[1:-1] - E[:, 1:-1].sum(0)
        nz = ok & (Mv != 0)
        R["check"] = (float(np.abs(eq[nz]).max() / (kt * rms(I))), float(np.sqrt(np.mean((d1 - A[1:-1])[ok] ** 2)) / rms(A)), rms((v1 - Mv)[ok]) / rms(W))
        if volt:
            heat = par[16] * (1 - np.exp(-t / par[17])) / (1 - math.exp(-T / par[17])); R["heat"] = heat
            ee = Uv - Rw * (1 + ALPHA * heat) * I - L * DI - ke * W - par[15] * np.sign(I)
            g = np.abs(I) > 0
            R["check"] += (float(np.abs(ee[g]).max() / rms(Uv)),)
        else: R["heat"] = np.zeros(N)
        runs.append(R)
    # ---- noise levels
    Irms = np.sqrt(np.mean([rms(R["I"]) ** 2 for R in runs])); Wrms = np.sqrt(np.mean([rms(R["W"]) ** 2 for R in runs]))
    Urms = np.sqrt(np.mean([rms(R["U"]) ** 2 for R in runs])) if volt else 0.0
    s_i = Irms * LU(r, 0.002, 0.03); s_w = Wrms * LU(r, 0.0005, 0.006); s_u = Urms * LU(r, 0.001, 0.008)
    off_i = s_i * U(r, -0.15, 0.15); hum_a = s_i * U(r, 0.3, 1.5) if hum else 0.0
    adc = 2 * 1.3 * max(np.abs(R["I"]).max() for R in runs) / 4096 if r.random() < 0.35 else 0.0
    if drive == "force" or drive == "torque": adc = 0.0
    s_l = load_amp * LU(r, 0.002, 0.01); s_t = 0.08
    # ---- sampling
    G = {}
    first_stamp = float(r.choice([0.0, 0.0, round(U(r, 0.5, 30), 3)]))
    rows = []
    for R in runs:
        T = R["T"]; n = int(math.floor((T - 0.004) * rate)); t = R["t"]
        k0 = int(math.ceil(0.004 * rate)) + 1
        ts = np.arange(k0, n) / rate
        if jitter: ts = np.sort(np.clip(ts + r.uniform(-0.32, 0.32, len(ts)) / rate, 0.003, T)); ts = np.round(ts, 7)
        pt = lambda s, d: np.interp(ts - d, t, s)
        def mn(s, d):
            c = np.concatenate([[0], np.cumsum((s[1:] + s[:-1]) * (h / 2))]); e = np.concatenate([[ts[0] - 1 / rate], ts]) - d
            return np.diff(np.interp(e, t, c)) / np.diff(e)
        smp = mn if mean else pt
        D, M = lag["drive"], lag["motion"]
        S = dict(ts=ts, n=len(ts))
        src = R["U"] if volt else R["I"]
        pos = R["TH"] + encA * np.sin(R["TH"] + encP)
        c = {}; c0 = {}
        c0["position"] = pt(R["TH"], M); c["position"] = q(pt(pos, M), res)
        hs = hum_a * np.sin(2 * np.pi * hum * ts + U(r, 0, 6.28)) if hum else 0.0
        if drive != "voltage":
            key = "current" if drive == "current" else ("torque" if drive == "torque" else "force")
            c0[key] = smp(R["I"], D); c[key] = q(c0[key] + r.normal(0, s_i, len(ts)) + off_i + Ioff + hs, adc)
        else:
            c0["voltage"] = smp(R["U"], D); c["voltage"] = c0["voltage"] + r.normal(0, s_u, len(ts))
            if cur_chan: c0["current"] = smp(R["I"], D); c["current"] = q(c0["current"] + r.normal(0, s_i, len(ts)) + off_i + Ioff + hs, adc)
        if use_vel:
            if vel_kind == "white": c0["velocity"] = pt(R["W"], M); c["velocity"] = c0["velocity"] + r.normal(0, s_w, len(ts))
            else:
                e = np.concatenate([[ts[0] - 1 / rate], ts]) - M
                c0["velocity"] = np.diff(np.interp(e, t, R["TH"])) / np.diff(e); c["velocity"] = np.diff(q(np.interp(e, t, pos), res)) / np.diff(e)
        if use_load: c0["load"] = pt(R["load"], 0); c["load"] = c0["load"] + r.normal(0, s_l, len(ts))
        if use_temp: c["temperature"] = q(pt(R["temp"], 0) + r.normal(0, s_t, len(ts)), 0.1)
        if use_user:
            y = np.empty(len(R["TH"])); play(R["TH"], gap / 2, y); R["US"] = y
            c0["user_position"] = pt(y, M); c["user_position"] = q(c0["user_position"], ures)
        S.update(c=c, c0=c0, idx=np.clip(np.round(ts * F).astype(int), 0, len(t) - 1)); rows.append(S)
    # ---- is it visible? fit base model to noise-free signals, on fit runs and on held-out runs
    vis = []
    for grp in (range(nfit), range(nfit, nfit + nheld)):
        for k, nm in enumerate(names):
            num = den = noi = cnt = 0.0; es = []; Xs = []; ns = []; ys = []
            for g in grp:
                R, S = runs[g], rows[g]; ix = S["idx"]; gt = lambda s: s[ix]
                mv = (gt(R["MV"]) > 0) & (np.abs(gt(R["W"])) > 1e-3 * wmax)
                c, c0 = S["c"], S["c0"]; f = rate
                posn = c["position"] - (c0["position"] + encA * np.sin(c0["position"] + encP))
                if use_vel: wn, wd = c["velocity"] - c0["velocity"], 0
                else: wn, wd = posn, 1
                W_, A_, I_ = gt(R["W"]), gt(R["A"]), gt(R["I"])
                base = [A_, W_, np.sign(W_)]
                if nm in ("winding_heating", "dead_time"):
                    e = Rw * ALPHA * gt(R["heat"]) * I_ if nm == "winding_heating" else par[15] * np.sign(I_)
                    X = [I_, W_, gt(R["DI"])]
                    for o in names:
                        if o != nm and o == "dead_time": X.append(np.sign(I_))
                        if o != nm and o == "winding_heating": X.append(gt(R["heat"]) * I_)
                    mv = np.abs(I_) > 0.01 * Irms; y = gt(R["U"])
                    nf = lambda fb: lowpass(c["voltage"] - c0["voltage"], f, fb) - Rw * lowpass(c["current"] - c0["current"] - Ioff, f, fb) - ke * lowpass(wn, f, fb, wd)
                elif nm == "encoder_eccentricity":
                    e = encA * np.cos(gt(R["TH"]) + encP) * W_; X = [W_]; y = W_; mv = np.ones(len(W_), bool)
                    nf = lambda fb: lowpass(posn, f, fb, 1) - lowpass(wn, f, fb)
                elif nm == "backlash":
                    e = gt(R["US"] - R["TH"]); X = [np.ones(len(e)), gt(R["TH"])]; y = gt(R["TH"]) - gt(R["TH"]).mean(); mv = np.ones(len(e), bool)
                    nf = lambda fb: lowpass(posn, f, fb) - lowpass(c["user_position"] - c0["user_position"], f, fb)
                else:
                    e = gt(R["E"][k]) if nm != "current_offset" else np.full(len(W_), -kt * Ioff)
                    X = list(base)
                    for o, on in enumerate(names):
                        if o == k or on in ("winding_heating", "dead_time", "encoder_eccentricity", "backlash"): continue
                        X.append(gt(R["E"][o]) if on != "current_offset" else np.ones(len(W_)))
                    if volt and not cur_chan: y = kt / Rw * gt(R["U"]); dn = kt / Rw * (c["voltage"] - c0["voltage"])
                    else:
                        key = "current" if cur_chan else drive
                        y = kt * I_; dn = kt * (c[key] - c0[key] - Ioff)
                    nf = lambda fb, dn=dn, wn=wn, wd=wd: lowpass(dn, f, fb) - J * lowpass(wn, f, fb, wd + 1) - B * lowpass(wn, f, fb, wd)
                X = np.stack(X, 1); full = np.zeros(len(mv)); full[mv] = rest(e[mv], X[mv])
                sp = np.abs(np.fft.rfft(full)) ** 2; fq = np.fft.rfftfreq(len(full), 1 / f); cs = np.cumsum(sp)
                fb = max(5.0, 1.1 * fq[np.searchsorted(cs, 0.95 * cs[-1])]) if cs[-1] > 0 else 5.0
                noise = nf(min(fb, 0.4 * f))
                es.append(e[mv]); Xs.append(X[mv]); ns.append(noise[mv]); ys.append(y)
            rr = rms(rest(np.concatenate(es), np.concatenate(Xs))); nn = rms(np.concatenate(ns)); yy = rms(np.concatenate(ys))
            vis.append((nm, round(rr / max(nn, 1e-300), 2), round(rr / yy, 4)))
            if rr < 3 * nn or rr < 0.02 * yy: raise Redraw("not visible: " + nm)
    # ---- what the lab writes down
    lev = float(r.choice([0.0, 0.03, 0.1, 0.2, 0.3], p=[.12, .22, .33, .18, .15]))
    def told(v, unit, top=1.0, always=False, free=0.15):
        l = lev * top
        if not always and r.random() < 0.12: return None
        dv = float(np.clip(r.normal(0, 0.6), -1, 1)) * l
        val = float("%.4g" % (v * (1 + dv))); tr = None if (not always and r.random() < free) else round(max(l * 0.7, 0.01), 3)
        return "{ value = %s, unit = \"%s\"%s }" % (repr(val), unit, "" if tr is None else ", trust = %s" % repr(tr))
    um, uB, uF, ux, uv = ("kg", "N s/m", "N", "m", "m/s") if linear else ("kg m2", "N m s/rad", "N m", "rad", "rad/s")
    toml = ["# single-axis rig, recorded for identification; SI units", "[rig]", "kind = \"%s\"" % ("linear" if linear else "rotary")]
    if linear: toml.append("lead_m_per_turn = %s                # of the screw; all values below in kg, N, m" % repr(lead))
    toml.append("drive = \"%s\"" % drive)
    if drive in ("current", "voltage"): toml.append("drive_constant = " + told(kt, "N/A" if linear else "N m/A", 0.2, True))
    if volt:
        toml.append("resistance = " + told(Rw, "ohm", 0.5, True)); 
        if r.random() < 0.8: toml.append("inductance = " + told(L, "H", 0.5, True))
    for nm, v, u, al in (("inertia", J, um, not (drive in ("torque", "force"))), ("viscous", B, uB, False), ("coulomb", Fc, uF, False)):
        x = told(v, u, 1.0, al, 0.15)
        if x: toml.append("%s = %s" % (nm, x))
    toml += ["", "[channels]"]
    tcol = str(r.choice(["t", "time_s", "Time"])); cols = {"time": tcol}
    toml.append("time = { column = \"%s\", unit = \"s\" }" % tcol)
    chan_unit = dict(position=ux, velocity=uv, current="A", voltage="V", torque="N m", force="N", load="N m", temperature="degC", user_position="m", command=ux)
    alt = dict(position=["theta_m", "pos", "enc"], velocity=["omega_m", "vel", "speed"], current=["i_q", "cur", "I_act"], voltage=["u", "v_mot"], torque=["torque_m", "trq"], force=["F_act", "force"],
               load=["t_load"], temperature=["temp_housing"], user_position=["x_scale"], command=["com", "setpoint"])
    know_noise = r.random() < 0.6; know_res = r.random() < 0.88
    order_ = [c for c in ("position", "velocity", "current", "voltage", "torque", "force", "load", "temperature", "user_position") if c in rows[0]["c"]]
    use_com = not prescribed and not open_loop and r.random() < 0.35
    for ch in order_ + (["command"] if use_com else []):
        cols[ch] = str(r.choice(alt[ch])); f = ["column = \"%s\"" % cols[ch], "unit = \"%s\"" % chan_unit[ch]]
        grp = "motion" if ch in ("position", "velocity", "user_position") else ("drive" if ch in ("current", "voltage", "torque", "force") else "")
        if grp == "drive" and mean: f.append("sampling = \"mean\"")
        if ch == "velocity" and vel_kind == "diff": f.append("sampling = \"mean\"")
        if grp and lag_known and lag[grp] > 0: f.append("delay_s = %s" % repr(round(lag[grp], 6)))
        if ch == "position" and know_res: f.append("resolution = %.4g" % res)
        if ch == "user_position": f.append("resolution = %.4g" % ures)
        if ch == "current" and adc and know_res: f.append("resolution = %.4g" % adc)
        if ch == "temperature": f.append("resolution = 0.1")
        if know_noise:
            nz = dict(velocity=s_w if vel_kind == "white" else 0, current=s_i, torque=s_i, force=s_i, voltage=s_u, load=s_l).get(ch, 0)
            if nz: f.append("noise = %.2g" % (nz * U(r, 0.9, 1.1)))
        note = ""
        if ch == "load": note = "   # drive torque minus friction minus load accelerates the axis"
        if ch == "voltage": note = "   # commanded by the controller, at the motor's terminals but for the stage"
        if ch == "velocity" and vel_kind == "diff": note = "   # the counter's difference over the sample"
        toml.append("%s = { %s }%s" % (ch, ", ".join(f), note))
    files = []
    for k, (R, S) in enumerate(zip(runs, rows)):
        fn = "%s_%d.csv" % (R["kind"], k); files.append((fn, R, S, "fit" if k < nfit else "heldout"))
    off_ok = off_run
    data = []
    def fmt(ch):
        return {"position": "%.7f" if not linear else "%.8f", "user_position": "%.8f", "command": "%.6f", "temperature": "%.1f", "time": "%.7f" if jitter else "%.5f"}.get(ch, "%.6g")
    for fn, R, S, role in files:
        toml += ["", "[[run]]", "file = \"%s\"" % fn, "role = \"%s\"" % role, "health = \"healthy\""]
        head = ["time"] + order_ + (["command"] if use_com else [])
        arr = [S["ts"] + first_stamp] + [S["c"][c] for c in order_] + ([np.interp(S["ts"], R["t"], R["ref"])] if use_com else [])
        data.append((fn, [cols[c] for c in head], [fmt(c) for c in head], arr))
    if off_ok:                                                  # drive disabled, axis at rest
        n = int(2.0 * rate); ts = np.arange(n) / rate; p0 = runs[0]["TH"][0]
        ch = {"position": np.full(n, q(p0 + encA * math.sin(p0 + encP), res)), "current": q(r.normal(0, s_i, n) + off_i + Ioff, adc)}
        if volt: ch["voltage"] = r.normal(0, s_u, n)
        if use_vel: ch["velocity"] = r.normal(0, s_w, n) if vel_kind == "white" else np.zeros(n)
        if use_load: ch["load"] = r.normal(0, s_l, n)
        if use_temp: ch["temperature"] = q(runs[0]["temp"][0] + r.normal(0, s_t, n), 0.1)
        if use_user: ch["user_position"] = np.full(n, q(p0, ures))
        toml += ["", "[[run]]", "file = \"off.csv\"", "role = \"off\"                    # drive disabled, axis at rest", "health = \"healthy\""]
        head = ["time"] + order_ + (["command"] if use_com else [])
        data.append(("off.csv", [cols[c] for c in head], [fmt(c) for c in head], [ts] + [ch[c] for c in order_] + ([np.full(n, p0)] if use_com else [])))
    # ---- the key
    effects = []
    for nm, d in zip(names, params):
        if cls == "outside": continue
        e = {"name": nm, "params": {k: float(v) for k, v in d.items()}}
        if linear and d:                                        # the words say: SI, motor side
            m = lead / (2 * math.pi); sc = dict(torque=m, speed=1 / m, amplitude=m, centre=1 / m, width=1 / m, stiffness=m * m, damping=m * m, inertia=m * m, gap=1 / m)
            if nm in ("quadratic_drag",): sc = dict(coefficient=m ** 3)
            if nm in ("viscous_asymmetry",): sc = dict(coefficient=m ** 2)
            e["params_linear"] = e["params"]; e["params"] = {k: float(v * sc.get(k, 1.0)) for k, v in d.items()}
        effects.append(e)
    also = []
    if cur_chan and drive == "current" and not off_ok:
        if "bias_torque" in names: also.append({"name": "current_offset"})
        if "current_offset" in names: also.append({"name": "bias_torque"})
    if lag["motion"] and not lag_known: also.append({"name": "control_delay"})
    con = dict(inertia=J, viscous=B, coulomb=Fc, torque_constant=kt if drive in ("current", "voltage") else None, resistance=Rw or None, inductance=L or None, lead_m_per_turn=lead or None,
               noise_drive=s_i if not volt or cur_chan else None, noise_voltage=s_u if volt else None, noise_velocity=s_w if use_vel and vel_kind == "white" else None, resolution=res,
               delay_drive_s=lag["drive"], delay_motion_s=lag["motion"], delay_told=lag_known, hum_hz=hum, offset_drive=off_i, jitter=bool(jitter), wrong_by=lev)
    motion = ("prescribed" if prescribed else ("open loop" if open_loop else "closed loop")) + ": " + ", ".join(R["kind"] for R in runs)
    key = {"class": cls, "effects": effects, "also_true": also,
           "rig": {"kind": "linear" if linear else "rotary", "drive": drive, "motion": motion, "rate_hz": rate, "velocity": "recorded" if use_vel else "derived", "sampling": "mean" if mean else "point"},
           "constants": {k: (float(v) if isinstance(v, (float, np.floating)) else v) for k, v in con.items() if v is not None},
           "visible": vis, "check": [[float("%.2g" % x) for x in R["check"]] for R in runs]}
    if cls == "outside": key["outside"] = law + ": " + OUTSIDE[law]; key["outside_params"] = [float(x) for x in EP[0]]
    return toml, data, key

def case(seed, K, cls, effect, out):
    r = np.random.default_rng([seed, K, zlib.crc32(cls.encode()), zlib.crc32((effect or "").encode())])
    s = np.random.default_rng([seed, zlib.crc32(cls.encode())])
    eff, law = [], None
    if cls == "one": eff = [effect or EFFECTS[s.permutation(len(EFFECTS))[K % len(EFFECTS)]]]
    elif cls == "two":
        c = [p for p in PAIRS if not effect or effect in p]; eff = list(c[s.permutation(len(c))[K % len(c)]])
    elif cls == "outside":
        L = sorted(OUTSIDE); law = effect if effect in OUTSIDE else L[s.permutation(len(L))[K % len(L)]]
    why = {}
    for attempt in range(400):
        try: toml, data, key = draw(r, cls, eff, law); break
        except Redraw as x: why[str(x)] = why.get(str(x), 0) + 1
    else: raise SystemExit("case %d %s %s: no rig found: %s" % (K, cls, eff or law, why))
    d = os.path.join(out, "case_%03d" % K); os.makedirs(d, exist_ok=True)
    for f in os.listdir(d):
        if f.endswith(".csv") or f == "bench.toml": os.remove(os.path.join(d, f))
    with open(os.path.join(d, "bench.toml"), "w") as f: f.write("\n".join(toml) + "\n")
    for fn, head, fm, arr in data:
        row = ",".join(fm); a = np.stack(arr, 1)
        with open(os.path.join(d, fn), "w") as f:
            f.write(",".join(head) + "\n"); f.write("\n".join([row % tuple(x) for x in a.tolist()])); f.write("\n")
    return dict(case=K, **key, redraws=attempt), why

def main():
    p = argparse.ArgumentParser()
    p.add_argument("--seed", type=int, default=1); p.add_argument("--first", type=int, default=0); p.add_argument("--cases", type=int, default=1)
    p.add_argument("--out", required=True); p.add_argument("--class", dest="cls", default="nothing", choices=["nothing", "one", "two", "outside"])
    p.add_argument("--effect"); p.add_argument("--jobs", type=int, default=1); p.add_argument("--verbose", action="store_true")
    a = p.parse_args()
    os.makedirs(a.out, exist_ok=True); Ks = range(a.first, a.first + a.cases)
    if a.jobs > 1:
        from concurrent.futures import ProcessPoolExecutor
        with ProcessPoolExecutor(a.jobs) as ex: res = list(ex.map(case, [a.seed] * a.cases, Ks, [a.cls] * a.cases, [a.effect] * a.cases, [a.out] * a.cases))
    else: res = [case(a.seed, K, a.cls, a.effect, a.out) for K in Ks]
    if a.verbose:
        for k, w in res: print(k["case"], [e["name"] for e in k["effects"]] or k.get("outside", "-")[:20], k["rig"]["kind"], k["rig"]["drive"], k["rig"]["rate_hz"], k["redraws"], w, k["visible"], k["check"])
    o = os.path.abspath(a.out)
    with open(os.path.join(os.path.dirname(o), "keys_%s.json" % os.path.basename(o)), "w") as f: json.dump([k for k, _ in res], f, indent=1)

if __name__ == "__main__": main()
