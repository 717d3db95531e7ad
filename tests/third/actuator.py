#!/usr/bin/env python3
"""Independent generator: the three-phase actuator of the equations in DESIGN.md and sim-worker, two recordings of telemetry a case.

actuator.py --seed S --cases N --class nothing|one --out DIR
Case folders DIR/case_NNN/{rec_a.csv,rec_b.csv}; key -> <dir of this file>/keys/<basename of DIR>.json
"""
import argparse, json, math, os
import numpy as np
import numba as nb
import servo
from servo import lu, rnd, write_csv, HERE, sgn

EFFECTS = ["stribeck", "lubricated_rise", "quadratic_drag", "viscous_asymmetry", "bias_torque",
           "temperature_dependent_friction", "periodic_friction", "tight_spot", "presliding", "cogging", "torque_ripple",
           "eccentricity", "torque_saturation", "spring_load", "compliance", "backlash", "winding_heating", "supply_sag",
           "dead_time", "turn_short", "commutation_offset", "encoder_eccentricity", "current_gain", "control_delay"]

(PJ, PC, PFS, PFD, PKE, PKTC, PR, PL, PB2, PVS,
 PST, PSV, PSE, PLT, PLV, PQD, PVA, PBT, PTF, PT0, PT1, PTT, PPA, PPP, PPO, PTQ, PTCN, PTW, PDS, PDD, PCA, PCP, PCO, PRF, PRP, PRO,
 PZ, PZP, PTS, PK, PK0, PCK, PCD, PJL, PHT, PRS, PDT, PSF, PSP, PCOM, PEA, PEP, PGA, PDEL, PPLAY, NP_) = range(56)

TWO3 = 2 * math.pi / 3


@nb.njit(cache=True)
def trap(x):
    """x in electrical rad"""
    d = x / (2 * math.pi)
    d = (d - math.floor(d)) * 12.0       # units of 30 deg
    if d < 1.0:
        return d
    if d < 5.0:
        return 1.0
    if d < 7.0:
        return 6.0 - d
    if d < 11.0:
        return -1.0
    return d - 12.0


@nb.njit(cache=True)
def rect(x):
    d = x / (2 * math.pi)
    d = (d - math.floor(d)) * 12.0
    if 1.0 <= d < 5.0:
        return 1.0
    if 7.0 <= d < 11.0:
        return -1.0
    return 0.0


@nb.njit(cache=True)
def sim(p, com, cstep, n, mrec):
    """com at every cstep-th step, linear between (the last value beyond)"""
    dt = 1e-6
    N, GAP, WMAX, KP, KI = 500.0, 1e5, 838.0, 0.05, 0.5
    IMAX, TMAX, TINT, P, HB, STOP = 22.5, 1.7, 1.7, 2.0, 0.1, 1.2
    nr = n // mrec
    o = np.zeros((26, nr))
    i = np.zeros(3)
    i0 = np.zeros(3)
    s = np.ones(3)
    k = np.zeros(3)
    kn = np.zeros(3)
    v = np.zeros(3)
    vt = np.zeros(3)
    e3 = np.zeros(3)
    Rq = np.full(3, p[PR] * (1 + 0.00393 * p[PHT]))
    Lq = np.full(3, p[PL])
    sh = np.ones(3)
    if p[PSF] > 0:
        q = int(p[PSP])
        Rq[q] *= 1 - p[PSF]
        Lq[q] *= (1 - p[PSF]) ** 2
        sh[q] = 1 - p[PSF]
    ilsum = 1 / Lq[0] + 1 / Lq[1] + 1 / Lq[2]
    w = 0.0
    th = 0.0
    I = 0.0
    thu = 0.0
    thl = 0.0
    wl = 0.0
    f = 0.0
    a = np.zeros(24)
    nd = int(round(p[PDEL] / dt))
    buf = np.zeros(nd + 1)
    gi = 1 + p[PGA]
    nc = len(com)
    ft = 1.0
    c = com[0]
    rp = 1.0
    for j in range(n):
        b = j // cstep
        if b < nc - 1:
            c = com[b] + (com[b + 1] - com[b]) * ((j - b * cstep) / cstep)
        else:
            c = com[nc - 1]
        wref = GAP * (c - thu)
        wref = min(max(wref, -WMAX), WMAX)
        e = wref - w
        T = KP * e + I
        ir = T / p[PKTC]
        if not (abs(ir) > IMAX and T * e >= 0):
            I += KI * e * dt
            I = min(max(I, -TINT), TINT)
        ir = min(max(ir, -IMAX), IMAX)
        ird = ir
        if nd > 0:
            buf[j % (nd + 1)] = ir
            ird = buf[(j + 1) % (nd + 1)]
        if p[PRF] != 0.0:
            rp = 1 + p[PRF] * math.cos(p[PRO] * th + p[PRP])
        the = P * th
        thc = the + p[PCOM]
        if p[PEA] != 0.0:
            thc += P * p[PEA] * math.sin(th + p[PEP])
        isup = 0.0
        for q in range(3):
            tr = trap(the - TWO3 * q)
            kn[q] = p[PKE] * tr
            kq = kn[q] * rp * sh[q]
            if p[PZ] != 0.0:
                kq *= 1 + p[PZ] * math.cos(th + TWO3 * q + p[PZP])
            k[q] = kq
            er = rect(thc - TWO3 * q) * ird - gi * i[q]
            if er > HB:
                s[q] = 1.0
            elif er < -HB:
                s[q] = -1.0
            if s[q] > 0:
                isup += i[q]
            i0[q] = i[q]
        vs = p[PVS] - p[PRS] * isup
        vn = 0.0
        for q in range(3):
            v[q] = s[q] * vs / 2
            vt[q] = v[q]
            if p[PDT] > 0.0:
                vt[q] -= p[PDT] * math.tanh(i[q] / 0.05)
            e3[q] = vt[q] - k[q] * w - Rq[q] * i[q]
            vn += e3[q] / Lq[q]
        vn /= ilsum
        TM = 0.0
        tn = 0.0
        iq = 0.0
        for q in range(3):
            i[q] += dt / Lq[q] * (e3[q] - vn)
            tq = k[q] * i[q]
            if p[PTS] > 0.0:
                tq *= 1 - p[PTS] * abs(i[q])
            TM += tq
            tn += kn[q] * i[q]
            a[q] += i[q]
            a[3 + q] += v[q] - vn
            a[6 + q] += kn[q] * w
        iq = tn / (2 * p[PKE])
        TM = min(max(TM, -TMAX), TMAX)
        if p[PTF] != 0.0:
            tmp = p[PT1] + (p[PT0] - p[PT1]) * math.exp(-j * dt / p[PTT])
            ft = max(0.15, 1 + p[PTF] * (tmp - 20.0))
        aw = abs(w)
        ext = 0.0
        if p[PSV] > 0.0 and p[PST] != 0.0:
            ext += p[PST] * math.exp(-(aw / p[PSV]) ** p[PSE])
        if p[PLT] != 0.0:
            ext += p[PLT] * (1 - math.exp(-aw / p[PLV]))
        if p[PPA] != 0.0:
            ext += p[PPA] * math.cos(p[PPO] * th + p[PPP])
        if p[PTQ] != 0.0:
            x = (th - p[PTCN]) / p[PTW]
            if abs(x) < 6.0:
                ext += p[PTQ] * math.exp(-x * x)
        FD = max(0.0, p[PFD] * ft + ext)
        TR = p[PBT]
        if p[PCA] != 0.0:
            TR += p[PCA] * math.cos(p[PCO] * th + p[PCP])
        if p[PK] != 0.0:
            TR += p[PK] * (th - p[PK0])
        if p[PVA] != 0.0:
            TR += p[PVA] * aw
        if p[PQD] != 0.0:
            TR += p[PQD] * w * aw
        if p[PJL] > 0.0:
            ts = p[PCK] * (th - thl) + p[PCD] * (w - wl)
            TR += ts
            wln = wl + dt / p[PJL] * ts
            thl += dt * wln
            wl = wln
        A = TM - p[PC] * ft * w - TR
        if p[PDS] > 0.0:
            fn = f + p[PDS] * w * dt * (1 - f * sgn(w) / FD)
            FF = fn + p[PDD] * (fn - f) / (p[PDS] * dt)
            f = fn
            wn = w + dt / p[PJ] * (A - FF)
        else:
            if w == 0.0:
                FS = max(p[PFS] * ft + (0.0 if (p[PST] != 0.0 or p[PLT] != 0.0) else ext), FD)
                if abs(A) <= FS:
                    FF = A
                else:
                    FF = FD * sgn(A)
            else:
                FF = FD * sgn(w)
            wn = w + dt / p[PJ] * (A - FF)
            if w * wn < 0:
                wn = 0.0
        w = wn
        th += w * dt
        u = th / N
        if u > STOP:
            u = STOP
            th = STOP * N
            w = min(w, 0.0)
        elif u < -STOP:
            u = -STOP
            th = -STOP * N
            w = max(w, 0.0)
        ul = thl / N if p[PJL] > 0.0 else u
        bb = p[PB2]
        if ul - thu > bb:
            thu = ul - bb
        elif ul - thu < -bb:
            thu = ul + bb
        a[9] += vs
        a[10] += (abs(i[0]) + abs(i[1]) + abs(i[2])) / 2
        a[11] += iq
        a[12] += tn
        a[13] += sgn(w)
        a[14] += w
        a[15] += ird
        a[16] += TM
        if (j + 1) % mrec == 0:
            r = (j + 1) // mrec - 1
            for q in range(17):
                o[q, r] = a[q] / mrec
                a[q] = 0.0
            o[17, r] = th
            o[18, r] = w
            o[19, r] = thu
            o[20, r] = c
            for q in range(3):
                o[21 + q, r] = i[q]
            o[24, r] = wl
    return o


REF = dict(J=2.5e-5, C=3e-5, FS0=0.03, ke=0.0376, R=1.065, L=360e-6, ktc=0.0752)


def nominal(c):
    p = np.zeros(NP_)
    p[PJ], p[PC], p[PFS], p[PFD] = c["J"], c["C"], c["FS0"], .7 * c["FS0"]
    p[PKE], p[PKTC], p[PR], p[PL] = c["ke"], c["ktc"], c["R"], c["L"]
    p[PB2], p[PVS] = 2e-5, 48.0
    p[PSV] = p[PLV] = p[PTW] = p[PTT] = p[PSE] = 1.0
    p[PT0] = p[PT1] = 20.0
    return p


def draw(name, rng, c, st):
    U = rng.uniform
    FD = .7 * c["FS0"]
    W = 600.0
    sg = float(rng.choice([-1, 1]))
    if name == "stribeck": return dict(torque=FD * U(.2, .55), speed=lu(rng, 8, 45), exponent=float(rng.choice([1.0, 2.0, U(1, 2)])))
    if name == "lubricated_rise": return dict(torque=FD * U(.3, .7), speed=lu(rng, 15, 70))
    if name == "quadratic_drag": return dict(coefficient=FD * U(.6, 1.5) / W ** 2)
    if name == "viscous_asymmetry": return dict(coefficient=sg * FD * U(.25, .6) / W)
    if name == "bias_torque": return dict(torque=sg * FD * U(.12, .35))
    if name == "temperature_dependent_friction": return dict(coefficient=-U(.006, .014))
    if name == "periodic_friction": return dict(amplitude=FD * U(.15, .4), phase=U(-math.pi, math.pi), order=float(rng.integers(1, 4)))
    if name == "tight_spot": return dict(torque=FD * U(.4, .9), centre=st["centre"], width=st["width"])
    if name == "presliding":
        k = FD / lu(rng, .03, .15)
        return dict(stiffness=k, damping=U(.1, .4) * math.sqrt(k * c["J"]))
    if name == "cogging": return dict(amplitude=FD * U(.15, .45), phase=U(-math.pi, math.pi), order=float(rng.choice([4, 8, 10, 12, 14, 16, 18])))
    if name == "torque_ripple": return dict(fraction=U(.03, .07), phase=U(-math.pi, math.pi), order=float(rng.choice([2, 4, 6, 8, 12])))
    if name == "eccentricity": return dict(zeta=U(.06, .25), phase=0.0 if U() < .5 else U(-math.pi, math.pi))
    if name == "torque_saturation": return dict(coefficient=U(.008, .016))
    if name == "spring_load": return dict(stiffness=FD * U(.6, 1.5) / 300, rest=U(-60, 60))
    if name == "compliance":
        JL = c["J"] * U(.25, .5)          # out of the whole inertia
        wa = 2 * math.pi * lu(rng, 90, 200)
        return dict(stiffness=JL * wa ** 2, damping=2 * U(.15, .25) * JL * wa, inertia=JL)
    if name == "backlash": return dict(gap=lu(rng, .08, .3))
    if name == "winding_heating": return dict(delta_t=U(35, 85))
    if name == "supply_sag": return dict(resistance=U(.15, .45))
    if name == "dead_time": return dict(voltage=U(.5, 1.4))
    if name == "turn_short": return dict(fraction=U(.05, .15), phase=float(rng.integers(0, 3)))
    if name == "commutation_offset": return dict(angle=sg * U(.08, .25))
    if name == "encoder_eccentricity": return dict(amplitude=lu(rng, .008, .03), phase=U(-math.pi, math.pi))
    if name == "current_gain": return dict(gain=sg * U(.06, .13))
    if name == "control_delay": return dict(delay=round(U(.15e-3, .38e-3), 6))
    raise ValueError(name)


SLOT = dict(stribeck=(("torque", PST), ("speed", PSV), ("exponent", PSE)), lubricated_rise=(("torque", PLT), ("speed", PLV)),
            quadratic_drag=(("coefficient", PQD),), viscous_asymmetry=(("coefficient", PVA),), bias_torque=(("torque", PBT),),
            temperature_dependent_friction=(("coefficient", PTF),), periodic_friction=(("amplitude", PPA), ("phase", PPP), ("order", PPO)),
            tight_spot=(("torque", PTQ), ("centre", PTCN), ("width", PTW)), presliding=(("stiffness", PDS), ("damping", PDD)),
            cogging=(("amplitude", PCA), ("phase", PCP), ("order", PCO)), torque_ripple=(("fraction", PRF), ("phase", PRP), ("order", PRO)),
            eccentricity=(("zeta", PZ), ("phase", PZP)), torque_saturation=(("coefficient", PTS),), spring_load=(("stiffness", PK), ("rest", PK0)),
            compliance=(("stiffness", PCK), ("damping", PCD), ("inertia", PJL)), winding_heating=(("delta_t", PHT),), supply_sag=(("resistance", PRS),),
            dead_time=(("voltage", PDT),), turn_short=(("fraction", PSF), ("phase", PSP)), commutation_offset=(("angle", PCOM),),
            encoder_eccentricity=(("amplitude", PEA), ("phase", PEP)), current_gain=(("gain", PGA),), control_delay=(("delay", PDEL),))


def command(rng, T, avoid):
    """user rad at 10 kHz, within +-1 rad"""
    f = 10000.0
    v, a = rng.uniform(.75, 1.0), lu(rng, 6, 35)
    kinds = [str(rng.choice([k for k in ("multisine", "chirp", "triangle", "trapezoid", "stair") if k not in avoid])), "slow"]
    allk = [k for k in ("multisine", "chirp", "triangle", "trapezoid", "stair", "steps") if k not in avoid]
    for _ in range(rng.integers(2, 4)):
        kinds.append(str(rng.choice(allk)))
    kinds = [kinds[j] for j in rng.permutation(len(kinds))]
    w = rng.uniform(.8, 1.3, len(kinds))
    w = w / w.sum() * T
    end = 0.0
    parts = []
    for kd, d in zip(kinds, w):
        x = servo.seg(kd, rng, d, f, v, a, {})
        x = x - x[0]
        if kd in ("triangle", "trapezoid", "stair") and rng.random() < .5:
            x = -x
        hi, lo = x.max(), x.min()
        sc = min(1.0, (1.0 - end) / max(hi, 1e-9), (-1.0 - end) / min(lo, -1e-9))
        if sc < .25:
            x = -x
            hi, lo = -lo, -hi
            sc = min(1.0, (1.0 - end) / max(hi, 1e-9), (-1.0 - end) / min(lo, -1e-9))
        x = x * sc + end
        end = x[-1]
        parts.append(x)
    c = np.concatenate(parts)
    n = int(T * f) + 1
    return np.concatenate([c, np.full(max(0, n - len(c)), c[-1])])[:n], kinds


def check(o, c, fs):
    dt = 1 / fs
    tn, sg_, wm = o[12], o[13], o[14]
    w = np.concatenate([[0.0], o[18]])
    r = tn - c["J"] * np.diff(w) / dt - c["C"] * wm - .7 * c["FS0"] * sg_
    ok = (np.abs(sg_) > .999)
    ok[0] = False
    out = dict(torque_residual_over_FD=float(np.sqrt(np.mean(r[ok] ** 2)) / (.7 * c["FS0"])))
    e = 0
    for q in range(3):
        il = np.concatenate([[0.0], o[21 + q]])
        ev = o[3 + q] - c["R"] * o[q] - c["L"] * np.diff(il) / dt - o[6 + q]
        e += np.mean(ev[1:] ** 2) / 3
    out["voltage_residual_V"] = float(math.sqrt(e))
    out.update(rms_current=float(np.sqrt(np.mean(o[11] ** 2))), peak_current=float(np.abs(o[0:3]).max()), peak_speed=float(np.abs(o[18]).max()),
               moving=float(ok.mean()), v_dc_std=float(np.std(o[9])))
    return out


def make_case(rng, name, cno, out, turn):
    U = rng.uniform
    z = lambda s: float(np.clip(rng.normal(0, s * .6), -s, s))
    c = dict(J=REF["J"] * (1 + z(.10)), C=REF["C"] * (1 + z(.20)), FS0=REF["FS0"] * (1 + z(.10)), ke=REF["ke"] * (1 + z(.015)),
             R=REF["R"] * (1 + z(.04)), L=REF["L"], ktc=REF["ktc"])
    fs = int(rng.choice([2000, 5000]))
    if name == "control_delay": fs = 5000
    T = 8.0
    usens = name in ("compliance", "backlash") or U() < .3
    tch = name == "temperature_dependent_friction" or U() < .15
    mrec = int(1e6 / fs)
    n = int(T * 1e6)
    while True:
        ca, ka = command(rng, T, [])
        cb, kb = command(rng, T, [k for k in ka if k in ("multisine", "chirp", "triangle", "trapezoid", "stair")][:1])
        st = {}
        if max(np.abs(np.diff(x)).max() * 1e4 for x in (ca, cb)) < .5: continue
        if name == "tight_spot":
            best = None
            for _ in range(60):
                ce = float(U(-300, 300))
                wd = U(6, 25)
                x = min(int(np.sum(np.diff(np.sign(q * 500 - ce)) != 0)) for q in (ca, cb))
                if x >= 6 and (best is None or x > best[0]): best = (x, ce, wd)
            if best is None: continue
            st = dict(centre=best[1], width=best[2])
        break
    p = nominal(c)
    q = {}
    ex = {}
    if name:
        q = draw(name, rng, c, st)
        for k_, j in SLOT.get(name, ()):
            p[j] = q[k_]
        if name == "compliance":
            ex = dict(inertia_rigid=c["J"])
            c = dict(c, J=c["J"] - q["inertia"])
            p[PJ] = c["J"]
        if name == "backlash": p[PB2] = q["gap"] / 2 / 500
    temps = []
    for r in range(2):
        if name == "temperature_dependent_friction": t0 = (U(4, 18), U(40, 60))[r]
        else: t0 = U(20, 28)
        temps.append((t0, t0 + (U(4, 12) if t0 < 36 else -U(4, 12)), U(4, 10)))
    ulsb = 2 * math.pi / 2 ** 21
    folder = os.path.join(out, f"case_{cno:03d}")
    os.makedirs(folder, exist_ok=True)
    chk = []
    for r, (cm, fn) in enumerate(((ca, "rec_a.csv"), (cb, "rec_b.csv"))):
        p[PT0], p[PT1], p[PTT] = temps[r]
        o = sim(p, cm, 100, n, mrec)
        if not np.isfinite(o).all(): raise RuntimeError(f"{cno} {name}: not finite")
        chk.append(check(o, c, fs))
        nr = o.shape[1]
        t = np.round(np.arange(1, nr + 1) / fs, 6)
        lsb = 2 * math.pi / 65536
        th = o[17].copy()
        if name == "encoder_eccentricity": th = th + q["amplitude"] * np.sin(th + q["phase"])
        thm = lsb * np.floor(th / lsb + .5)
        thu = ulsb * np.floor(o[19] / ulsb + .5) if usens else thm / 500
        w = o[18] + rng.normal(0, .2, nr)
        il = 50 / 4096
        im = []
        nz = []
        g_ = 1 + q.get("gain", 0.0) if name == "current_gain" else 1.0
        for x in range(3):
            z_ = rng.normal(0, .02, nr) + U(-.02, .02)
            y = il * np.round(np.clip(g_ * o[x] + z_, -25, 25) / il)
            im.append(y)
            nz.append(y - o[x])
        ieq = (np.abs(im[0]) + np.abs(im[1]) + np.abs(im[2])) / 2
        # the drive forms i_q as it goes: mean of the products, with the error of each phase's measurement
        mid = thm - .5 * o[14] / fs
        iq = o[11].copy()
        for x in range(3):
            d = (2 * mid - TWO3 * x) / (2 * math.pi)
            d = (d - np.floor(d)) * 12
            tr = np.where(d < 1, d, np.where(d < 5, 1, np.where(d < 7, 6 - d, np.where(d < 11, -1, d - 12))))
            iq += .5 * nz[x] * tr
        vdc = np.round(o[9] + rng.normal(0, .02, nr), 3)
        cols = [("t", t), ("com", np.round(o[20], 9)), ("theta_u", np.round(thu, 10)), ("theta_m", np.round(thm, 7)), ("omega_m", np.round(w, 4)),
                ("i_eq", np.round(ieq, 6)), ("i_a", np.round(im[0], 6) + 0.0), ("i_b", np.round(im[1], 6) + 0.0), ("i_c", np.round(im[2], 6) + 0.0),
                ("v_a", np.round(o[3], 5)), ("v_b", np.round(o[4], 5)), ("v_c", np.round(o[5], 5)), ("i_q", np.round(iq, 5)), ("v_dc", vdc)]
        if tch:
            te = temps[r][1] + (temps[r][0] - temps[r][1]) * np.exp(-t / temps[r][2])
            cols.append(("temperature", np.round(te + rng.normal(0, .05, nr), 2)))
        write_csv(os.path.join(folder, fn), cols)
    if name == "backlash": ex = dict(gap_beyond_nominal=q["gap"] - .02, half_width_user=q["gap"] / 1000, note="gap: full, motor side, nominal 0.02 rad contained")
    return dict(case=f"case_{cno:03d}", effect=name, parameters=q,
                constants=dict(inertia=c["J"], viscous=c["C"], coulomb=.7 * c["FS0"], torque_constant=2 * c["ke"], resistance=2 * c["R"],
                               static_friction=c["FS0"], ke_phase=c["ke"], resistance_phase=c["R"], inductance_phase=c["L"], drive_torque_constant=c["ktc"]),
                extra=ex, rig=dict(fs=fs, own_user_sensor=bool(usens), temperature=bool(tch), commands=[ka, kb]), check=chk)


def main():
    ap = argparse.ArgumentParser()
    ap.add_argument("--seed", type=int, required=True)
    ap.add_argument("--cases", type=int, required=True)
    ap.add_argument("--class", dest="cls", choices=["nothing", "one"], required=True)
    ap.add_argument("--out", required=True)
    a = ap.parse_args()
    os.makedirs(a.out, exist_ok=True)
    setn = os.path.basename(os.path.normpath(a.out))
    order = np.random.default_rng([a.seed, 888]).permutation(len(EFFECTS))
    keys = []
    for n in range(a.cases):
        rng = np.random.default_rng([a.seed, n, 3 if a.cls == "one" else 2])
        name = EFFECTS[order[n % len(EFFECTS)]] if a.cls == "one" else None
        k = make_case(rng, name, n, a.out, n // len(EFFECTS))
        keys.append(k)
        print(k["case"], f"{str(name):30s} fs {k['rig']['fs']}", " | ".join(f"res/FD {x['torque_residual_over_FD']:.4f} E {x['voltage_residual_V']:.4f} rmsI {x['rms_current']:.2f} "
              f"pkI {x['peak_current']:.1f} pkW {x['peak_speed']:.0f} mov {x['moving']:.2f}" for x in k["check"]), flush=True)
    os.makedirs(os.path.join(HERE, "keys"), exist_ok=True)
    json.dump(dict(set=setn, seed=a.seed, **{"class": a.cls}, generator="actuator.py", cases=keys), open(os.path.join(HERE, "keys", setn + ".json"), "w"), indent=1)


if __name__ == "__main__":
    main()
