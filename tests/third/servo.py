#!/usr/bin/env python3
"""Independent generator of measured-looking recordings of plain servo rigs.

servo.py --seed S --cases N --class nothing|one --out DIR
Case folders DIR/case_NNN/{bench.toml,*.csv}; key -> <dir of this file>/keys/<basename of DIR>.json
"""
import argparse, json, math, os, sys
import numpy as np
import numba as nb

HERE = os.path.dirname(os.path.abspath(__file__))
FINE = 40000.0            # integrator rate [Hz]
DT = 1.0 / FINE

EFFECTS = ["stribeck", "lubricated_rise", "quadratic_drag", "viscous_asymmetry", "bias_torque",
           "load_dependent_friction", "temperature_dependent_friction", "periodic_friction",
           "tight_spot", "presliding", "cogging", "torque_ripple", "torque_saturation",
           "spring_load", "compliance", "backlash", "winding_heating", "supply_sag", "dead_time",
           "encoder_eccentricity", "current_offset", "current_gain", "control_delay"]

# parameter vector layout
(PJ, PC, PT, PKT, PKE, PR, PL, PVS, PTAU, PKPP, PKV, PKI, PWL, PIL, PLSB, PVSRC, PFV,
 PST, PSV, PSE, PLT, PLV, PQD, PVA, PB, PLF, PTF, PTFV, PPA, PPP, PPO, PTT, PTC, PTW, PDS, PDD,
 PCA, PCP, PCO, PRF, PRP, PRO, PTS, PK, PK0, PCK, PCD, PJL, PGAP, PTL, PHT, PRS, PDT, PEA, PEP,
 PDEL, PT0, PT1, PTT2, PBMODE, NP_) = range(61)


@nb.njit(cache=True, fastmath=False)
def sgn(x):
    return 1.0 if x > 0 else (-1.0 if x < 0 else 0.0)


@nb.njit(cache=True)
def resist(p, th, w, load, ft):
    """torque against positive motion that is not dry friction"""
    c = p[PC] * (1.0 + (ft - 1.0) * p[PTFV])
    t = c * w + load + p[PB] + p[PVA] * abs(w) + p[PQD] * w * abs(w)
    if p[PCA] != 0.0:
        t += p[PCA] * math.cos(p[PCO] * th + p[PCP])
    if p[PK] != 0.0:
        t += p[PK] * (th - p[PK0])
    return t


@nb.njit(cache=True)
def dry(p, th, w, load, ft):
    """level of dry friction, acts against the motion"""
    f = p[PT] * ft
    aw = abs(w)
    if p[PST] != 0.0:
        f += p[PST] * math.exp(-(aw / p[PSV]) ** p[PSE])
    if p[PLT] != 0.0:
        f += p[PLT] * (1.0 - math.exp(-aw / p[PLV]))
    if p[PLF] != 0.0:
        f += p[PLF] * abs(load)
    if p[PPA] != 0.0:
        f += p[PPA] * math.cos(p[PPO] * th + p[PPP])
    if p[PTT] != 0.0:
        x = (th - p[PTC]) / p[PTW]
        f += p[PTT] * math.exp(-x * x)
    return f if f > 0.0 else 0.0


@nb.njit(cache=True)
def simulate(p, com, load, n, mrec, mctl, tnoise, usetach):
    """closed loop. com: per control tick; load: per fine step; returns record-rate arrays"""
    nr = n // mrec
    o = np.zeros((16, nr))
    J, kt0, ke0, L = p[PJ], p[PKT], p[PKE], p[PL]
    R = p[PR] * (1.0 + 0.00393 * p[PHT])
    th = com[0]
    w = 0.0
    thl = th
    wl = 0.0
    i = 0.0
    integ = 0.0
    iref = 0.0
    f = 0.0
    wf = 0.0
    lsb = p[PLSB]
    eps0 = p[PEA] * math.sin(th + p[PEP]) if p[PEA] != 0.0 else 0.0
    thm_old = lsb * math.floor((th + eps0) / lsb + 0.5)
    vdc = p[PVS]
    ndel = int(round(p[PDEL] / DT))
    buf = np.zeros(ndel + 1)
    tctl = mctl * DT
    twomass = p[PJL] > 0.0
    s = np.zeros(8)
    play = th
    for k in range(n):
        ft = 1.0
        if p[PTF] != 0.0:
            T = p[PT1] + (p[PT0] - p[PT1]) * math.exp(-k * DT / p[PTT2])
            ft = 1.0 + p[PTF] * (T - 20.0)
            if ft < 0.15:
                ft = 0.15
        if k % mctl == 0:
            kk = k // mctl
            thm = th
            if p[PEA] != 0.0:
                thm += p[PEA] * math.sin(th + p[PEP])
            thm = lsb * math.floor(thm / lsb + 0.5)
            if usetach == 0:
                wm = w
            elif usetach == 1:
                wm = w + tnoise[kk]
            else:
                wf += (1.0 - math.exp(-tctl * p[PFV])) * ((thm - thm_old) / tctl - wf)
                wm = wf
            thm_old = thm
            wref = p[PKPP] * (com[kk] - thm)
            wref = min(max(wref, -p[PWL]), p[PWL])
            e = wref - wm
            u = p[PKV] * e + integ
            if abs(u) <= p[PIL] or u * e < 0:
                integ += p[PKI] * e * tctl
            iref = min(max(u, -p[PIL]), p[PIL])
        irefd = iref
        if ndel > 0:
            buf[k % (ndel + 1)] = iref
            irefd = buf[(k + 1) % (ndel + 1)]
        rip = 1.0
        if p[PRF] != 0.0:
            rip = 1.0 + p[PRF] * math.cos(p[PRO] * th + p[PRP])
        # electrical
        di = (irefd - i) / p[PTAU]
        dtv = p[PDT] * math.tanh(i / 0.05) if p[PDT] != 0.0 else 0.0
        v = R * i + L * di + ke0 * rip * w + dtv
        if p[PRS] > 0.0:
            vdc = p[PVS]
            for _ in range(3):
                vdc = p[PVS] - p[PRS] * v * i / vdc
        if abs(v) > vdc:
            v = vdc if v > 0 else -vdc
            di = (v - R * i - ke0 * rip * w - dtv) / L
        inew = i + di * DT
        im = 0.5 * (i + inew)
        tm = kt0 * rip * im * (1.0 - p[PTS] * abs(im))
        ld = load[k]
        # mechanics
        ext = 0.0
        if twomass:
            d = th - thl
            if p[PGAP] > 0.0:
                h = 0.5 * p[PGAP]
                if d > h:
                    ext = p[PCK] * (d - h) + p[PCD] * (w - wl)
                    if ext < 0.0:
                        ext = 0.0
                elif d < -h:
                    ext = p[PCK] * (d + h) + p[PCD] * (w - wl)
                    if ext > 0.0:
                        ext = 0.0
            else:
                ext = p[PCK] * d + p[PCD] * (w - wl)
        a0 = tm - resist(p, th, w, ld, ft) - ext
        if p[PDS] > 0.0:
            lev = dry(p, th, w, ld, ft)
            x = math.exp(-p[PDS] * abs(w) * DT / lev)
            fn = lev * sgn(w) + (f - lev * sgn(w)) * x if w != 0.0 else f
            a0 -= 0.5 * (f + fn) + p[PDD] * (fn - f) / (p[PDS] * DT)
            f = fn
            wn = w + DT / J * a0
        else:
            wn = w + DT / J * a0
            dl = DT / J * dry(p, th, w, ld, ft)
            if wn > dl:
                wn -= dl
            elif wn < -dl:
                wn += dl
            else:
                wn = 0.0
        wm2 = 0.5 * (w + wn)
        if twomass:
            wln = wl + DT / p[PJL] * ext
            dl = DT / p[PJL] * p[PTL]
            if wln > dl:
                wln -= dl
            elif wln < -dl:
                wln += dl
            else:
                wln = 0.0
            thl += DT * 0.5 * (wl + wln)
            wl = wln
        s[0] += im
        s[1] += v
        s[2] += vdc
        s[3] += ld
        s[4] += (1.0 if wm2 > 0 else (-1.0 if wm2 < 0 else 0.0))
        s[5] += kt0 * rip * im * (1.0 - p[PTS] * abs(im))
        th += DT * wm2
        w = wn
        i = inew
        if not twomass:
            if p[PGAP] > 0.0:
                h = 0.5 * p[PGAP]
                if th - thl > h:
                    thl = th - h
                elif th - thl < -h:
                    thl = th + h
            else:
                thl = th
        if (k + 1) % mrec == 0:
            r = (k + 1) // mrec - 1
            o[0, r] = th
            o[1, r] = w
            o[2, r] = thl
            o[3, r] = s[0] / mrec
            o[4, r] = i
            o[5, r] = s[1] / mrec
            o[6, r] = v
            o[7, r] = s[2] / mrec
            o[8, r] = vdc
            o[9, r] = s[3] / mrec
            o[10, r] = ld
            o[11, r] = s[4] / mrec
            o[12, r] = s[5] / mrec
            o[13, r] = irefd
            o[14, r] = wl
            for q in range(8):
                s[q] = 0.0
    return o


@nb.njit(cache=True)
def prescribed(p, A, F, PH, base, load, n, mrec):
    """exact smooth motion, current by inverse dynamics"""
    nr = n // mrec
    o = np.zeros((16, nr))
    s0 = 0.0
    s3 = 0.0
    s4 = 0.0
    s5 = 0.0
    f = 0.0
    na = len(A)
    for k in range(n):
        t = (k + 0.5) * DT
        th = base
        w = 0.0
        a = 0.0
        for j in range(na):
            om = 2 * math.pi * F[j]
            sn = math.sin(om * t + PH[j])
            cs = math.cos(om * t + PH[j])
            th += A[j] * sn
            w += A[j] * om * cs
            a -= A[j] * om * om * sn
        ft = 1.0
        if p[PTF] != 0.0:
            T = p[PT1] + (p[PT0] - p[PT1]) * math.exp(-k * DT / p[PTT2])
            ft = max(0.15, 1.0 + p[PTF] * (T - 20.0))
        lev = dry(p, th, w, load[k], ft)
        tq = p[PJ] * a + resist(p, th, w, load[k], ft)
        if p[PDS] > 0.0:
            x = math.exp(-p[PDS] * abs(w) * DT / lev)
            fn = lev * sgn(w) + (f - lev * sgn(w)) * x
            tq += 0.5 * (f + fn) + p[PDD] * (fn - f) / (p[PDS] * DT)
            f = fn
        else:
            tq += lev * sgn(w)
        rip = 1.0
        if p[PRF] != 0.0:
            rip = 1.0 + p[PRF] * math.cos(p[PRO] * th + p[PRP])
        im = tq / (p[PKT] * rip)
        if p[PTS] > 0.0:
            z = 1.0 - 4.0 * p[PTS] * abs(im)
            im = sgn(im) * (1.0 - math.sqrt(max(z, 0.0))) / (2.0 * p[PTS])
        s0 += im
        s3 += load[k]
        s4 += sgn(w)
        s5 += tq
        if (k + 1) % mrec == 0:
            r = (k + 1) // mrec - 1
            t = (k + 1) * DT
            th = base
            w = 0.0
            for j in range(na):
                om = 2 * math.pi * F[j]
                th += A[j] * math.sin(om * t + PH[j])
                w += A[j] * om * math.cos(om * t + PH[j])
            o[0, r] = th
            o[1, r] = w
            o[2, r] = th
            o[3, r] = s0 / mrec
            o[4, r] = im
            o[9, r] = s3 / mrec
            o[10, r] = load[k]
            o[11, r] = s4 / mrec
            o[12, r] = s5 / mrec
            s0 = 0.0
            s3 = 0.0
            s4 = 0.0
            s5 = 0.0
    return o


# ---------------------------------------------------------------- commands
def lu(rng, a, b):
    return float(math.exp(rng.uniform(math.log(a), math.log(b))))


def taper(n, f, tt=0.3):
    m = min(int(tt * f), n // 3)
    e = np.ones(n)
    x = np.arange(m) / max(m, 1)
    s = x * x * x * (10 - 15 * x + 6 * x * x)
    e[:m] = s
    e[n - m:] = s[::-1]
    return e


def scale_to(th, f, v, a):
    d1 = np.abs(np.diff(th)).max() * f
    d2 = np.abs(np.diff(th, 2)).max() * f * f
    return th * min(v / max(d1, 1e-12), a / max(d2, 1e-9))


def from_speed(wv, f):
    th = np.concatenate([[0.0], np.cumsum(0.5 * (wv[1:] + wv[:-1]))]) / f
    th -= np.linspace(0, 1, len(th)) * 0  # end may rest elsewhere
    return th


def slew(target, f, a):
    """limits the slope of a speed profile (vectorised enough)"""
    return _slew(target, a / f)


@nb.njit(cache=True)
def _slew(x, d):
    y = np.zeros(len(x))
    c = 0.0
    for k in range(len(x)):
        e = x[k] - c
        if e > d:
            e = d
        elif e < -d:
            e = -d
        c += e
        y[k] = c
    return y


def seg(kind, rng, T, f, v, a, rig):
    n = int(round(T * f))
    t = np.arange(n) / f
    if kind == "multisine":
        k = rng.integers(3, 8)
        fr = np.exp(rng.uniform(np.log(max(0.15, 0.6 / T)), np.log(rng.uniform(3, 12)), k))
        pw = rng.choice([1.0, 1.5, 2.0])
        th = sum(fq ** -pw * np.sin(2 * np.pi * fq * t + rng.uniform(0, 2 * np.pi)) for fq in fr)
        return scale_to(th * taper(n, f), f, v, a)
    if kind == "chirp":
        f0, f1 = rng.uniform(0.2, 0.6), rig.get("chirp_top") or rng.uniform(4, 16)
        fq = f0 + (f1 - f0) * t / T if rng.random() < 0.5 else f0 * (f1 / f0) ** (t / T)
        ph = 2 * np.pi * np.cumsum(fq) / f
        am = 1 / (2 * np.pi * fq / v + (2 * np.pi * fq) ** 2 / a)
        return am * np.sin(ph) * taper(n, f, 0.2)
    if kind == "steps":
        th = np.zeros(n)
        k = 0
        lev = 0.0
        while k < n:
            d = int(rng.uniform(0.35, 0.9) * f)
            th[k:k + d] = lev
            lev = rng.uniform(-1, 1) * v * rng.choice([0.03, 0.12, 0.25])
            k += d
        m = int(0.4 * f)
        th[max(0, n - m):] = 0
        return th
    if kind in ("triangle", "trapezoid", "stair"):
        wv = np.zeros(n)
        k = 0
        if kind == "stair":
            lv = np.array([0.03, 0.08, 0.18, 0.35, 0.6, 1.0])
            lv = lv[np.sort(rng.choice(6, rng.integers(3, 6), replace=False))]
            half = n // 2
            d = half // (len(lv) if rng.random() < .5 else 2 * len(lv) - 1)
            seq = list(lv) if d * len(lv) >= half - len(lv) else list(lv) + list(lv[-2::-1])
            for j, x in enumerate(seq):
                wv[j * d:(j + 1) * d] = x * v
            wv[half:half + len(seq) * d] = -wv[:len(seq) * d]
            wv = slew(wv, f, a * 0.5)
        else:
            fast = True
            while k < n:
                h = rng.uniform(0.15, 0.5) if fast else rng.uniform(0.2, 0.7)
                sp = v * (rng.uniform(0.5, 1.0) if fast else lu(rng, 0.02, 0.3))
                m = int(h * f)
                rest = int(rng.uniform(0.05, 0.3) * f) if kind == "trapezoid" else 0
                if k + 2 * m + 2 * rest > n:
                    break
                sg = rng.choice([-1, 1])
                wv[k:k + m] = sg * sp
                wv[k + m + rest:k + 2 * m + rest] = -sg * sp
                k += 2 * m + 2 * rest
                fast = not fast
            if kind == "trapezoid":
                wv = slew(wv, f, a * 0.7)
        return from_speed(wv, f)
    if kind == "slow":
        wv = np.zeros(n)
        k = 0
        while k < n:
            m = int(rng.uniform(0.3, 0.9) * f)
            sp = v * lu(rng, 0.006, 0.06)
            if k + 2 * m > n:
                m = (n - k) // 2
                if m < 3:
                    break
            wv[k:k + m] = sp
            wv[k + m:k + 2 * m] = -sp
            k += 2 * m
        if rng.random() < 0.5:
            wv = slew(wv, f, v * 0.3)
        return from_speed(wv, f)
    if kind == "small":
        x = rig["small"]
        th = np.zeros(n)
        for _ in range(3):
            th += x * rng.uniform(0.7, 3) * np.sin(2 * np.pi * lu(rng, 0.4, 3) * t + rng.uniform(0, 6.3))
        return th * taper(n, f)
    raise ValueError(kind)


FASTK = ["multisine", "chirp", "triangle", "trapezoid", "stair"]


def command(rng, T, f, v, a, rig, avoid, prefer=()):
    nseg = rng.integers(3, 6) if T > 11 else rng.integers(3, 5)
    kinds = []
    pool = [k for k in FASTK if k not in avoid] or FASTK
    kinds.append(str(rng.choice(pool)))
    if rig.get("small"):
        kinds.append("small")
    else:
        kinds.append("slow")
    for k in prefer:
        if k not in kinds and len(kinds) < nseg + 1:
            kinds.append(k)
    allk = ["multisine", "chirp", "triangle", "trapezoid", "stair", "steps", "slow"]
    if rig.get("nosteps"):
        allk.remove("steps")
    while len(kinds) < nseg:
        kinds.append(str(rng.choice([k for k in allk if k not in avoid or rng.random() < 0.3])))
    kinds = [kinds[j] for j in rng.permutation(len(kinds))]
    w = rng.uniform(0.8, 1.4, len(kinds))
    w = w / w.sum() * T
    parts = []
    end = 0.0
    for j, (kd, d) in enumerate(zip(kinds, w)):
        vv = v * (1.0 if j == 0 or rng.random() < 0.5 else rng.uniform(0.3, 0.9))
        x = seg(kd, rng, d, f, vv, a, rig)
        x = x - x[0] + end
        end = x[-1]
        parts.append(x)
    c = np.concatenate(parts)
    n = int(round(T * f)) + 1
    if len(c) < n:
        c = np.concatenate([c, np.full(n - len(c), c[-1])])
    return c[:n], kinds


# ---------------------------------------------------------------- rig
def draw_motor(rng, effect):
    while True:
        J = lu(rng, 1e-6, 5e-3)
        wr = lu(rng, 50, 600)
        ta = lu(rng, 0.02, 0.12)
        Tr = J * wr / ta
        kt = lu(rng, 0.02, 1.0)
        Ir = Tr / kt
        V = kt * wr / rng.uniform(0.5, 0.7)
        R = V * rng.uniform(0.06, 0.18) / Ir
        if not (0.3 <= Ir <= 40 and 6 <= V <= 400 and 0.2 <= R <= 8):
            continue
        if effect == "dead_time" and Ir < 1.0:
            continue
        if J > 1e-3 and wr > 350 or J < 5e-6 and wr < 100:
            continue
        break
    Tc = Tr * lu(rng, 0.02, 0.10)
    C = Tr * rng.uniform(0.01, 0.08) / wr
    Lh = R * lu(rng, 0.4e-3, 3e-3)
    Vn = float(f"{V:.2g}")
    return dict(J=J, wr=wr, Tr=Tr, kt=kt, Ir=Ir, V=max(Vn, V), R=R, Tc=Tc, C=C, L=Lh)


def base_params(m, rng, lsb, wb):
    p = np.zeros(NP_)
    p[PJ], p[PC], p[PT], p[PKT], p[PKE], p[PR], p[PL] = m["J"], m["C"], m["Tc"], m["kt"], m["kt"], m["R"], m["L"]
    p[PVS] = m["V"]
    p[PTAU] = lu(rng, 0.25e-3, 0.9e-3)
    p[PKPP] = wb / rng.uniform(4.5, 7)
    p[PKV] = m["J"] * wb / m["kt"]
    p[PKI] = p[PKV] * wb / rng.uniform(6, 12)
    p[PWL] = 0.95 * m["wr"]
    p[PIL] = m["Ir"] * rng.uniform(1.2, 1.9)
    p[PLSB] = lsb
    p[PFV] = 2 * math.pi * rng.uniform(250, 500)
    p[PSV] = p[PLV] = p[PTW] = p[PTT2] = p[PSE] = 1.0
    p[PT0] = p[PT1] = 20.0
    return p


def load_profile(rng, n, Tr, strong):
    t = np.arange(n) * DT
    amp = Tr * (rng.uniform(0.25, 0.5) if strong else rng.uniform(0.08, 0.3))
    kind = rng.choice(["levels", "sine", "both"])
    x = np.zeros(n)
    if kind in ("levels", "both"):
        k = 0
        while k < n:
            d = int(rng.uniform(0.8, 2.2) / DT)
            x[k:k + d] = rng.choice([0.0, rng.uniform(-1, 1), rng.uniform(0.4, 1), -rng.uniform(0.4, 1)])
            k += d
        x = _slew(x, DT / 0.06)
    if kind in ("sine", "both"):
        x = x * 0.6 + rng.uniform(-.3, .3) + 0.6 * np.sin(2 * np.pi * rng.uniform(0.12, 0.7) * t + rng.uniform(0, 6.3))
    return x * amp / max(np.abs(x).max(), 0.3)


def rnd(x, span, digits=7):
    """decimal rounding, so that the CSV is compact"""
    span = max(float(span), 1e-12)
    d = max(0, digits - 1 - int(math.floor(math.log10(span))))
    return np.round(x, min(d, 12)) + 0.0


def write_csv(path, cols):
    import pyarrow as pa
    import pyarrow.csv as pc
    tb = pa.table({k: v for k, v in cols})
    with open(path, "wb") as f:
        f.write((",".join(k for k, _ in cols) + "\n").encode())
        pc.write_csv(tb, f, pc.WriteOptions(include_header=False, quoting_style="none"))


def smooth(x, k):
    if k <= 1:
        return x
    return np.convolve(x, np.ones(k) / k, "valid")


# ---------------------------------------------------------------- effect strengths
def draw_effect(name, rng, m, st, rig, k):
    """-> parameters. st: statistics of motion without the effect. k: strength factor"""
    Tc, wp, w9 = m["Tc"], st["wpk"], st["w95"]
    U = rng.uniform
    sg = float(rng.choice([-1, 1]))
    if name == "stribeck":
        return dict(torque=k * Tc * U(.2, .6), speed=wp * lu(rng, .02, .10), exponent=float(rng.choice([1.0, 2.0, U(1, 2)])))
    if name == "lubricated_rise":
        return dict(torque=k * Tc * U(.3, .7), speed=wp * lu(rng, .03, .15))
    if name == "quadratic_drag":
        return dict(coefficient=k * Tc * U(.4, 1.2) / wp ** 2)
    if name == "viscous_asymmetry":
        return dict(coefficient=sg * min(k * Tc * U(.25, .7) / wp, 10 * m["C"]))
    if name == "bias_torque":
        return dict(torque=sg * k * Tc * U(.12, .4))
    if name == "load_dependent_friction":
        return dict(coefficient=min(.5, k * Tc * U(.25, .6) / st["loadabs"]))
    if name == "temperature_dependent_friction":
        return dict(coefficient=-min(.02, k * U(.006, .014)))
    if name == "periodic_friction":
        return dict(amplitude=min(.9, k * U(.15, .45)) * Tc, phase=U(-math.pi, math.pi), order=float(rng.integers(1, 5)))
    if name == "tight_spot":
        return dict(torque=k * Tc * U(.35, .8), centre=st["centre"], width=st["width"])
    if name == "presliding":
        return dict(stiffness=Tc / rig["small"] , damping=rng.uniform(0.1, 0.5) * math.sqrt(Tc / rig["small"] * m["J"]))
    if name == "cogging":
        return dict(amplitude=k * Tc * U(.15, .5), phase=U(-math.pi, math.pi), order=float(rng.choice([4, 6, 8, 10, 12, 14, 18, 24])))
    if name == "torque_ripple":
        return dict(fraction=min(.15, k * U(.03, .08)), phase=U(-math.pi, math.pi), order=float(rng.choice([2, 4, 6, 8, 12])))
    if name == "torque_saturation":
        return dict(coefficient=min(.3, k * U(.10, .2)) / st["ipk"])
    if name == "spring_load":
        return dict(stiffness=k * Tc * U(.3, .9) / st["span"], rest=st["mid"] + U(-.3, .3) * st["span"])
    if name == "compliance":
        fr = rng.uniform(.3, .9)
        JL = fr * m["J"]
        wa = 2 * math.pi * lu(rng, 9, 45)
        return dict(stiffness=JL * wa ** 2, damping=2 * U(.02, .08) * math.sqrt(JL * JL * wa ** 2), inertia=JL)
    if name == "backlash":
        return dict(gap=rig["gap"])
    if name == "winding_heating":
        return dict(delta_t=U(35, 85))
    if name == "supply_sag":
        return dict(resistance=U(.05, .12) * m["V"] / m["Ir"])
    if name == "dead_time":
        return dict(voltage=m["V"] * U(.015, .04))
    if name == "encoder_eccentricity":
        return dict(amplitude=max(lu(rng, .012, .05), 8 * rig["lsb"]), phase=U(-math.pi, math.pi))
    if name == "current_offset":
        return dict(current=sg * max(U(.2, .45) * Tc / m["kt"], U(.015, .03) * st["ipk"]))
    if name == "current_gain":
        return dict(gain=sg * U(.06, .13))
    if name == "control_delay":
        return dict(delay=rig["delay"])
    raise ValueError(name)


def put(p, name, q, rig):
    p = p.copy()
    if name == "stribeck": p[PST], p[PSV], p[PSE] = q["torque"], q["speed"], q["exponent"]
    elif name == "lubricated_rise": p[PLT], p[PLV] = q["torque"], q["speed"]
    elif name == "quadratic_drag": p[PQD] = q["coefficient"]
    elif name == "viscous_asymmetry": p[PVA] = q["coefficient"]
    elif name == "bias_torque": p[PB] = q["torque"]
    elif name == "load_dependent_friction": p[PLF] = q["coefficient"]
    elif name == "temperature_dependent_friction": p[PTF], p[PTFV] = q["coefficient"], rig["temp_viscous"]
    elif name == "periodic_friction": p[PPA], p[PPP], p[PPO] = q["amplitude"], q["phase"], q["order"]
    elif name == "tight_spot": p[PTT], p[PTC], p[PTW] = q["torque"], q["centre"], q["width"]
    elif name == "presliding": p[PDS], p[PDD] = q["stiffness"], q["damping"]
    elif name == "cogging": p[PCA], p[PCP], p[PCO] = q["amplitude"], q["phase"], q["order"]
    elif name == "torque_ripple": p[PRF], p[PRP], p[PRO] = q["fraction"], q["phase"], q["order"]
    elif name == "torque_saturation": p[PTS] = q["coefficient"]
    elif name == "spring_load": p[PK], p[PK0] = q["stiffness"], q["rest"]
    elif name == "compliance":
        p[PCK], p[PCD], p[PJL] = q["stiffness"], q["damping"], q["inertia"]
    elif name == "backlash":
        p[PGAP] = q["gap"]
        if rig["backlash_kind"] == "two_mass":
            p[PJL] = rig["user_inertia"]
            p[PTL] = rig["user_coulomb"]
            p[PT] -= rig["user_coulomb"]
            p[PCK] = p[PJL] * (2 * math.pi * 350) ** 2
            p[PCD] = 2 * .15 * p[PJL] * 2 * math.pi * 350
            p[PJ] -= p[PJL]
    elif name == "winding_heating": p[PHT] = q["delta_t"]
    elif name == "supply_sag": p[PRS] = q["resistance"]
    elif name == "dead_time": p[PDT] = q["voltage"]
    elif name == "encoder_eccentricity": p[PEA], p[PEP] = q["amplitude"], q["phase"]
    elif name == "control_delay": p[PDEL] = q["delay"]
    return p


MECH = set(EFFECTS[:14])


def residuals(o, m, fs, q, name, volt, sig_i, pool):
    """noise-free residual of the nominal equations at the true constants, and what of it is left after a refit"""
    dt = 1 / fs
    th, w = o[0], o[1]
    im = o[3].copy()
    if name == "current_offset": im = im + q["current"]
    if name == "current_gain": im = im * (1 + q["gain"])
    dw = np.diff(w) / dt
    wm = np.diff(th) / dt
    if name == "encoder_eccentricity":
        e = q["amplitude"] * np.sin(th + q["phase"])
        wm = np.diff(th + e) / dt
    s = o[11][1:]
    T = m["kt"] * im[1:] - o[9][1:]
    r = T - m["J"] * dw - m["C"] * wm - m["Tc"] * s
    ok = (np.abs(s) > .5) & (np.abs(wm) > 2e-3 * np.abs(w).max())
    K = max(1, int(fs / 100))
    A = np.stack([smooth(x * ok, K) for x in (dw, wm, s)], 1)
    y = smooth(r * ok, K)
    pool.append((A, y))
    left = y
    noise = m["kt"] * sig_i / math.sqrt(K)
    out = dict(torque_residual_over_coulomb=float(np.sqrt(np.mean(r[ok] ** 2)) / m["Tc"]),
               moving=float(ok.mean()), noise_10ms=float(noise))
    if name == "encoder_eccentricity":
        out["encoder_error_of_speed"] = float(q["amplitude"] * np.sqrt(np.mean(w * w)))
    if name == "supply_sag":
        out["sag_rms_V"] = float(np.std(o[7]))
    if volt:
        di = np.diff(o[4]) / dt
        ev = o[5][1:] - m["R"] * im[1:] - m["L"] * di - m["kt"] * np.diff(th) / dt
        out["voltage_residual_V"] = float(np.sqrt(np.mean(ev ** 2)))
    return out


def g(x):
    return float(f"{x:.5g}")


def residual_set(outs, m, fs, q, name, volt, isig):
    """every run, with one refit of inertia, viscous and dry friction over all of them"""
    pool = []
    chk = [residuals(o[0], m, fs, q, name, volt, isig, pool) for o in outs]
    A = np.concatenate([x for x, _ in pool])
    y = np.concatenate([x for _, x in pool])
    sc = np.abs(A).max(0) + 1e-30
    c, *_ = np.linalg.lstsq(A / sc, y, rcond=None)
    for (a_, y_), k in zip(pool, chk):
        left = math.sqrt(np.mean((y_ - (a_ / sc) @ c) ** 2) / max(k["moving"], 1e-9))
        k["left_after_refit_over_coulomb"] = left / m["Tc"]
        k["left_over_noise_10ms"] = left / k["noise_10ms"]
    return chk


# ---------------------------------------------------------------- one case
def make_case(rng, name, cno, outdir, turn):
    for attempt in range(40):
        r = try_case(rng, name, cno, outdir, turn)
        if r is not None:
            r["attempts"] = attempt + 1
            return r
    raise RuntimeError(f"case {cno} {name}: no plausible rig in 40 attempts")


def try_case(rng, name, cno, outdir, turn):
    U = rng.uniform
    m = draw_motor(rng, name)
    rig = {}
    # ---- features
    needv = name in ("winding_heating", "supply_sag", "dead_time", "current_offset", "current_gain")
    volt = needv or (name == "torque_ripple" and U() < .6) or U() < .45
    is_cmd = name == "control_delay" or (name is None and U() < .1)
    fs = int(rng.choice([500, 1000, 2000, 5000, 10000], p=[.15, .35, .3, .13, .07]))
    if is_cmd: fs = int(rng.choice([1000, 2000, 5000], p=[.4, .4, .2]))
    if name in ("compliance",): fs = int(rng.choice([1000, 2000, 5000]))
    presc = (not volt) and (not is_cmd) and name not in ("compliance", "backlash") and U() < .35
    bits = int(rng.integers(12, 21))
    lsb = 2 * math.pi / 2 ** bits
    rig["lsb"] = lsb
    tach = U() < .6 or name == "encoder_eccentricity" or is_cmd
    mrec = int(FINE / fs)
    # control tick: divides the sample for command rigs
    mctl = int(rng.choice([4, 5, 8, 10]))
    if is_cmd:
        mctl = int(rng.choice([c for c in (4, 8, 10, 20, 40) if mrec % c == 0 and c <= 40]))
    wb = lu(rng, 60, 220)
    if is_cmd: wb = lu(rng, 50, 110)
    if fs == 500: wb = min(wb, 120)
    T = float(round(U(8, 20), 1))
    if fs == 10000: T = float(round(U(8, 10), 1))
    if fs == 5000: T = float(round(U(8, 14), 1))
    p0 = base_params(m, rng, lsb, wb)
    usetach = 0
    if is_cmd:
        usetach = 1
        rig["nosteps"] = True
        p0[PIL] = m["Ir"] * 2.0
        if name == "control_delay":
            rig["delay"] = float(round(U(max(1.5e-3, 1.5 / fs), min(6e-3, .45 / wb)), 5))
            rig["delay"] = round(rig["delay"] / DT) * DT
    elif bits >= 17 and U() < .6 and not presc:
        usetach = 2
    if name == "presliding":
        rig["small"] = max(lu(rng, .03, .15), 25 * lsb)
    N = 1.0
    user = U() < .25 and not is_cmd
    bmode = None
    if name in ("compliance", "backlash"):
        user = turn % 3 != 2
    if name == "backlash":
        rig["backlash_kind"] = bmode = "play" if turn % 3 == 0 else "two_mass"
        rig["gap"] = lu(rng, .03, .2) if user else lu(rng, .12, .4)
        rig["gap"] = max(rig["gap"], 25 * lsb)
        rig["user_inertia"] = m["J"] * U(.25, .6)
        rig["user_coulomb"] = m["Tc"] * U(.15, .35)
    if user:
        N = float(rng.choice([1, 1, 5, 20, 50]))
    ulsb = 2 * math.pi / 2 ** int(rng.integers(14, 21))
    if name == "backlash": ulsb = min(ulsb, 2 * math.pi / 2 ** math.ceil(math.log2(2 * math.pi * 15 * N / rig["gap"])))
    if name == "compliance": rig["chirp_top"] = U(15, 40); ulsb = 2 * math.pi / 2 ** (20 if N > 1 else 18)
    loadch = name == "load_dependent_friction" or (name == "current_gain" and U() < .5) or (name is None and U() < .2)
    tempch = name == "temperature_dependent_friction" or U() < .12
    vdcch = name == "supply_sag" or (volt and U() < .35)
    comch = is_cmd or (not presc and U() < .5)
    nfit, nheld = int(rng.integers(2, 4)), int(rng.integers(1, 3))
    if name == "temperature_dependent_friction": rig["temp_viscous"] = float(turn % 2)
    # ---- commands
    v, a = .9 * m["wr"], U(.4, .8) * m["Tr"] / m["J"]
    if loadch: a *= .7
    base = U(-20, 20)
    fctl = FINE / mctl
    n = int(round(T * fs)) * mrec
    runs = []
    used = []
    pf = {"compliance": ("chirp", "steps"), "backlash": ("slow", "multisine"), "torque_saturation": ("chirp", "trapezoid"),
          "control_delay": ("chirp", "multisine")}.get(name, ())
    lo_hi = []
    tA, tB = U(5, 20), U(38, 60)
    for r in range(nfit + nheld):
        role = "fit" if r < nfit else "heldout"
        if presc:
            while True:
                k = int(rng.integers(4, 9))
                fr = np.exp(rng.uniform(np.log(.08), np.log(U(2, 7)), k))
                am = fr ** -float(rng.choice([1.2, 1.6, 2.0])) * rng.uniform(.5, 1.5, k)
                if rig.get("small"):
                    am[-1] = 0
                ph = rng.uniform(0, 2 * np.pi, k)
                t = np.arange(int(T * 500)) / 500
                om = 2 * np.pi * fr
                wv = (am * om * np.cos(np.outer(t, om) + ph)).sum(1)
                av = (-am * om * om * np.sin(np.outer(t, om) + ph)).sum(1)
                am = am * min(v / np.abs(wv).max(), a / np.abs(av).max())
                wv *= am.max() / am.max()
                break
            cm = (am, fr, ph)
            kinds = ["prescribed multisine"]
            com = None
        else:
            avoid = used[0] if (role == "heldout" and used) else []
            com, kinds = command(rng, T, fctl, v, a, rig, avoid, pf)
            com = com + base
            cm = None
            used.append([x for x in kinds if x in FASTK][:1])
        ld = load_profile(rng, n, m["Tr"], name == "load_dependent_friction") if loadch else np.zeros(n)
        if tempch:
            if name == "temperature_dependent_friction":
                c0 = (tA, tB)[r % 2] if role == "fit" else U(25, 35)
            else:
                c0 = U(18, 28)
            c1 = c0 + (U(3, 12) if c0 < 36 else -U(3, 12))
            tt = U(4, 15)
        else:
            c0 = c1 = 20.0; tt = 1.0
        runs.append(dict(role=role, com=com, kinds=kinds, cm=cm, load=ld, T0=c0, T1=c1, tau=tt))

    tsig = m["wr"] * lu(rng, .0004, .003)
    if is_cmd and mrec != mctl: tsig = m["wr"] * lu(rng, .0001, .0005)
    isig = m["Ir"] * lu(rng, .001, .005)

    def run_sim(p, rr, sd):
        p = p.copy(); p[PT0], p[PT1], p[PTT2] = rr["T0"], rr["T1"], rr["tau"]
        if presc:
            am, fr, ph = rr["cm"]
            return prescribed(p, am, fr, ph, base, rr["load"], n, mrec), None
        tn = np.random.default_rng(sd).normal(0, tsig, n // mctl + 2) if usetach == 1 else np.zeros(1)
        return simulate(p, rr["com"], rr["load"], n, mrec, mctl, tn, usetach), tn

    seeds = [int(rng.integers(1 << 60)) for _ in runs]
    p = p0
    outs = [run_sim(p0, rr, sd) for rr, sd in zip(runs, seeds)]
    allth = np.concatenate([o[0][0] for o in outs])
    allw = np.concatenate([o[0][1] for o in outs])
    if not np.isfinite(allw).all(): return None
    if np.abs(allw).max() < 0.25 * m["wr"] or np.ptp(allth) < 4.5: return None
    st = dict(wpk=float(np.percentile(np.abs(allw), 99.5)), w95=float(np.percentile(np.abs(allw), 95)),
              ipk=float(np.percentile(np.abs(np.concatenate([o[0][4] for o in outs])), 99.7)),
              loadabs=float(np.mean([np.abs(x["load"]).mean() for x in runs])) or 1.0,
              mid=float(np.percentile(allth, 50)), span=float(np.percentile(allth, 90) - np.percentile(allth, 10)))
    if name == "tight_spot":
        best = None
        for _ in range(60):
            c = float(np.percentile(allth, U(12, 88)))
            wd = max(.3, st["span"] * U(.03, .10))
            # passes in every run, both ways, at any speed
            cross = min(int(np.sum(np.diff(np.sign(o[0][0] - c)) != 0)) for o in outs)
            frac = min(float(np.mean(np.abs(o[0][0] - c) < wd)) for o in outs)
            if cross >= 6 and frac > .02 and (best is None or cross > best[0]): best = (cross, c, wd)
        if best is None: return None
        st["centre"], st["width"] = best[1], best[2]
    q = {}
    k = 1.0
    if name:
        state = rng.bit_generator.state
        for _ in range(7):
            rng.bit_generator.state = state
            q = draw_effect(name, rng, m, st, rig, k)
            p = put(p0, name, q, rig)
            outs = [run_sim(p, rr, sd) for rr, sd in zip(runs, seeds)]
            chk = residual_set(outs, m, fs, q, name, volt, isig)
            if name == "encoder_eccentricity" and min(c["encoder_error_of_speed"] for c in chk) < 1.0 * tsig: return None
            if name not in MECH: break
            if name == "presliding":
                break
            if name in ("temperature_dependent_friction", "load_dependent_friction"):
                mn = float(np.mean([c["left_after_refit_over_coulomb"] for c in chk]))
                mm = float(np.mean([c["left_over_noise_10ms"] for c in chk]))
                if mn > .05 and mm > 1.5: break
                k *= 1.4
                continue
            mn = min(c["left_after_refit_over_coulomb"] for c in chk)
            mm = min(c["left_over_noise_10ms"] for c in chk)
            if mn > .05 and mm > 1.5: break
            k *= 1.4
        else:
            return None
    else:
        chk = residual_set(outs, m, fs, q, name, volt, isig)
    for o, _ in outs:
        if not np.isfinite(o).all(): return None
        if not presc and np.mean(np.abs(o[13]) > .999 * p[PIL]) > .12: return None
        if np.abs(o[1]).max() > 1.6 * m["wr"]: return None
        if np.mean(np.abs(o[1]) > .02 * m["wr"]) < .15: return None
        if volt and np.mean(np.abs(o[6]) > .99 * o[8]) > .05: return None
    if not presc:
        ipk_act = max(np.abs(o[4]).max() for o, _ in outs)
    else:
        ipk_act = max(np.abs(o[3]).max() for o, _ in outs)
    st["ipk_act"] = ipk_act

    # ---- sensors
    posu = "deg" if U() < .35 else "rad"
    velu = str(rng.choice(["rad/s", "rpm", "deg/s"], p=[.5, .4, .1]))
    curu = "mA" if (m["Ir"] < 4 and U() < .4) else "A"
    F = {"rad": 1.0, "deg": 180 / math.pi, "rad/s": 1.0, "rpm": 30 / math.pi, "deg/s": 180 / math.pi, "A": 1.0, "mA": 1e3, "V": 1.0}
    fullc = float(f"{ipk_act * U(1.3, 2.2):.2g}")
    ilsb = 2 * fullc / 2 ** int(rng.integers(12, 17))
    imean = U() < .6
    vmean = U() < .7
    fullv = m["V"] * 1.25
    vlsb = 2 * fullv / 2 ** int(rng.integers(12, 16))
    vsig = m["V"] * lu(rng, .0008, .003)
    offs = U() < .5
    ioff = rng.normal(0, .0004) * fullc if offs else 0.0
    voff = rng.normal(0, .0004) * fullv if offs else 0.0
    wlsb = 2 * 1.3 * m["wr"] / 2 ** int(rng.integers(13, 17))
    lsig = m["Tr"] * lu(rng, .001, .004)
    dsig = m["V"] * .0003
    names = dict(time=str(rng.choice(["t", "time", "time_s", "Time"])), position=str(rng.choice(["pos", "theta", "enc_pos", "phi", f"pos_{posu}"])),
                 velocity=str(rng.choice(["vel", "omega", "tacho", "speed"])), current=str(rng.choice(["i", "cur", "current", "i_mot"])),
                 voltage=str(rng.choice(["u", "v_mot", "volt", "voltage"])), user_position=str(rng.choice(["pos_out", "load_pos", "theta_l", "user"])),
                 load=str(rng.choice(["load", "tq_load", "brake"])), temperature=str(rng.choice(["temp", "T_oil", "temperature"])),
                 v_dc=str(rng.choice(["v_dc", "ubus", "vbus"])), command=str(rng.choice(["cmd", "ref", "setpoint", "com"])))
    folder = os.path.join(outdir, f"case_{cno:03d}")
    os.makedirs(folder, exist_ok=True)
    files = []
    nsr = n // mrec
    tt = np.round(np.arange(1, nsr + 1) / fs, 6)
    for r, ((o, tn), rr) in enumerate(zip(outs, runs)):
        th = o[0].copy()
        if name == "encoder_eccentricity":
            th = th + q["amplitude"] * np.sin(th + q["phase"])
        x = lsb * np.floor(th / lsb + .5)
        cols = [(names["time"], tt)]
        body = [(names["position"], rnd(x * F[posu], lsb * F[posu], 3))]
        if tach:
            if usetach == 1:
                idx = (np.arange(1, nsr + 1) * mrec) // mctl
                nz = tn[idx]
            else:
                nz = rng.normal(0, tsig, nsr)
            y = o[1] + nz
            if not is_cmd: y = wlsb * np.round(y / wlsb)
            body.append((names["velocity"], rnd(y * F[velu], tsig * F[velu], 3)))
        ic = (o[3] if imean else o[4]).copy()
        if name == "current_offset": ic = ic + q["current"]
        if name == "current_gain": ic = ic * (1 + q["gain"])
        ic = ic + ioff + rng.normal(0, isig, nsr)
        ic = ilsb * np.round(np.clip(ic, -fullc, fullc) / ilsb)
        body.append((names["current"], rnd(ic * F[curu], ilsb * F[curu], 4)))
        if volt:
            vv = (o[5] if vmean else o[6]) + voff + rng.normal(0, vsig, nsr)
            body.append((names["voltage"], rnd(vlsb * np.round(vv / vlsb), vlsb, 4)))
        if vdcch:
            body.append((names["v_dc"], rnd(o[7] + rng.normal(0, dsig, nsr), dsig, 3)))
        if user:
            uu = ulsb * np.floor(o[2] / N / ulsb + .5)
            body.append((names["user_position"], rnd(uu * F[posu], ulsb * F[posu], 3)))
        if loadch:
            body.append((names["load"], rnd(o[10] + rng.normal(0, lsig, nsr), lsig, 3)))
        if tempch:
            te = rr["T1"] + (rr["T0"] - rr["T1"]) * np.exp(-tt / rr["tau"])
            body.append((names["temperature"], np.round(te + rng.normal(0, .05, nsr), 2)))
        if comch:
            ck = np.minimum(((np.arange(1, nsr + 1) * mrec - (0 if is_cmd else 1)) // mctl), len(rr["com"]) - 1)
            cc = rr["com"][ck] / N * F[posu]
            body.append((names["command"], rnd(cc, max(1e-6, lsb / N) * F[posu], 3)))
        body = [body[j] for j in rng.permutation(len(body))]
        fn = f"{['run', 'log', 'rec', 'meas'][cno % 4]}_{r + 1}.csv"
        write_csv(os.path.join(folder, fn), cols + body)
        files.append((fn, rr["role"]))

    # ---- bench file
    def off(val, trust):
        z = rng.normal()
        while abs(z) > 2.3: z = rng.normal()
        return g(val * (1 + trust * z))
    tight = name == "current_gain"
    tr = dict(inertia=.03 if tight else U(.03, .2), viscous=U(.1, .3), coulomb=U(.1, .3),
              drive_constant=U(.005, .008) if tight else U(.005, .03),
              resistance=.01 if tight else (U(.01, .03) if name == "winding_heating" else U(.01, .04)),
              inductance=U(.05, .2), back_emf_constant=.004 if tight else U(.003, .015))
    tr = {a_: float(f"{b_:.2g}") for a_, b_ in tr.items()}
    Jb = m["J"]
    jkind = None
    if name == "compliance":
        jkind = "total" if turn % 2 == 0 else "motor"
        if jkind == "total":
            Jb = m["J"] + q["inertia"]
        tr["inertia"] = float(f"{U(.15, .3):.2g}")
    noisy = U() < .5
    bench = dict(drive_constant=off(m["kt"], tr["drive_constant"]), inertia=off(Jb, tr["inertia"]))
    cpres = U() > .15
    vpres = U() > .15
    Ttot = m["Tc"]
    if vpres: bench["viscous"] = off(m["C"], tr["viscous"])
    if cpres: bench["coulomb"] = off(Ttot, tr["coulomb"])
    if volt:
        bench["resistance"] = off(m["R"], tr["resistance"])
        bench["inductance"] = off(m["L"], tr["inductance"])
        bench["back_emf_constant"] = off(m["kt"], tr["back_emf_constant"])
    units = dict(drive_constant="N m/A", inertia="kg m2", viscous="N m s/rad", coulomb="N m", resistance="ohm",
                 inductance="H", back_emf_constant="V s/rad")
    L_ = ["[rig]", 'kind = "rotary"', f'drive = "{"command" if is_cmd else "current"}"']
    for k_, b_ in bench.items():
        L_.append(f'{k_} = {{ value = {b_:g}, unit = "{units[k_]}", trust = {tr[k_]:g} }}')
    if vdcch:
        vs_b = off(m["V"], .003)
        L_.append(f'supply_voltage = {{ value = {vs_b:g}, unit = "V", trust = 0.003 }}')
    if user or comch: L_.append(f"gear_ratio = {N:g}")
    if is_cmd:
        L_ += ["", "[rig.controller]", f"position_gain = {p0[PKPP] * N:.6g}", f"speed_gain = {p0[PKV]:.6g}", f"integral_gain = {p0[PKI]:.6g}",
               f"speed_limit = {p0[PWL]:.6g}", f"drive_limit = {p0[PIL]:.6g}", 'velocity = "measured"', 'position = "motor"',
               f"rate_hz = {fctl:g}", f"current_time_constant_s = {p0[PTAU]:.4g}"]
    L_ += ["", "[channels]", f'time = {{ column = "{names["time"]}", unit = "s" }}']

    def ch(c, unit, samp=None, res=None, noise=None):
        s = f'{c} = {{ column = "{names[c]}", unit = "{unit}"'
        if samp: s += f', sampling = "{samp}"'
        if noisy and res is not None: s += f", resolution = {res:.4g}"
        if noisy and noise is not None: s += f", noise = {noise:.3g}"
        L_.append(s + " }")
    ch("position", posu, None, lsb * F[posu])
    if tach: ch("velocity", velu, None, None if is_cmd else wlsb * F[velu], tsig * F[velu])
    ch("current", curu, ("mean" if U() < .6 else None) if imean else "point", ilsb * F[curu], isig * F[curu])
    if volt: ch("voltage", "V", ("mean" if U() < .6 else None) if vmean else "point", vlsb, vsig)
    if vdcch: ch("v_dc", "V", "mean", None, dsig)
    if user: ch("user_position", posu, None, ulsb * F[posu])
    if loadch: ch("load", "N m", None, None, lsig)
    if tempch: ch("temperature", "degC", None, None, .05)
    if comch: ch("command", posu)
    for fn, role in files:
        L_ += ["", "[[run]]", f'file = "{fn}"', f'role = "{role}"', 'health = "healthy"']
    open(os.path.join(folder, "bench.toml"), "w").write("\n".join(L_) + "\n")

    J_key = m["J"] - (rig["user_inertia"] if bmode == "two_mass" else 0)
    key = dict(case=f"case_{cno:03d}", effect=name, parameters={a_: float(b_) for a_, b_ in q.items()},
               constants=dict(inertia=J_key, viscous=m["C"], coulomb=m["Tc"], torque_constant=m["kt"], resistance=m["R"],
                              inductance=m["L"], back_emf_constant=m["kt"], supply_voltage=m["V"]),
               extra=dict(inertia_rigid=float(m["J"] + (q["inertia"] if name == "compliance" else 0)), bench_inertia_is=jkind,
                          backlash_kind=bmode, user_inertia=rig.get("user_inertia"), user_coulomb=rig.get("user_coulomb"),
                          temperature_scales_viscous=rig.get("temp_viscous"), strength_factor=k,
                          current_offset_of_sensor=float(ioff), voltage_offset_of_sensor=float(voff)),
               rig=dict(fs=fs, seconds=T, motion="prescribed" if presc else "closed loop", drive="command" if is_cmd else "current",
                        encoder_bits=bits, velocity=tach, voltage=volt, user_position=user, load=loadch, temperature=tempch, v_dc=vdcch,
                        command=comch, current_sampling="mean" if imean else "point", noise_given=noisy, gear_ratio=N, wr=m["wr"],
                        rated_current=m["Ir"], rated_torque=m["Tr"], current_limit=float(p0[PIL]), noise_current=isig, noise_velocity=tsig,
                        noise_voltage=vsig, loop_bandwidth=wb, loop_feedback=["true speed", "noisy tacho", "encoder difference"][usetach],
                        runs=[dict(file=f_, role=r_, kinds=rr["kinds"]) for (f_, r_), rr in zip(files, runs)]),
               trust={k_: tr[k_] for k_ in bench}, bench=bench, check=chk,
               stats={a_: float(b_) for a_, b_ in st.items()})
    return key


def main():
    ap = argparse.ArgumentParser()
    ap.add_argument("--seed", type=int, required=True)
    ap.add_argument("--cases", type=int, required=True)
    ap.add_argument("--class", dest="cls", choices=["nothing", "one"], required=True)
    ap.add_argument("--out", required=True)
    a = ap.parse_args()
    os.makedirs(a.out, exist_ok=True)
    setn = os.path.basename(os.path.normpath(a.out))
    order = np.random.default_rng([a.seed, 999]).permutation(len(EFFECTS))
    keys = []
    for c in range(a.cases):
        rng = np.random.default_rng([a.seed, c, 1 if a.cls == "one" else 0])
        name = EFFECTS[order[c % len(EFFECTS)]] if a.cls == "one" else None
        kx = make_case(rng, name, c, a.out, c // len(EFFECTS))
        keys.append(kx)
        ck = kx["check"]
        f = lambda s: max(x.get(s, 0) for x in ck)
        mn = lambda s: min(x.get(s, 0) for x in ck)
        print(f"{kx['case']} {str(name):30s} fs {kx['rig']['fs']:5d} J {kx['constants']['inertia']:.1e} res/Tc {f('torque_residual_over_coulomb'):.4f} "
              f"left/Tc {mn('left_after_refit_over_coulomb'):.4f} left/noise {mn('left_over_noise_10ms'):.1f} E {f('voltage_residual_V'):.4f} "
              f"k {kx['extra']['strength_factor']:.2f} att {kx['attempts']} {kx['rig']['motion'][:6]}", flush=True)
    os.makedirs(os.path.join(HERE, "keys"), exist_ok=True)
    json.dump(dict(set=setn, seed=a.seed, **{"class": a.cls}, generator="servo.py", cases=keys),
              open(os.path.join(HERE, "keys", setn + ".json"), "w"), indent=1)


if __name__ == "__main__":
    main()
