#!/usr/bin/env python3
"""Simulated fleet of electromechanical actuators: healthy telemetry and pre-flight tests.

  units.py --seed S --units N --tests M --out DIR [--effect NAME|none]
  units.py --selfcheck          compares with the numbers printed for the reference actuator

Half of the units (odd k) hide one effect; with --effect all units have it (or none has one).
A unit is fixed by seed and k alone; 24 successive odd units meet each of the 24 effects once.

Conventions: all torques are on the motor shaft; "resists" = enters like a load, A = TM - C w - T.
th = rotor angle (starts at the rest angle th0), x = th - th0, w = rotor speed, F = dry friction.
FSJ multiplies the static and dynamic friction of the unit (and what is said below to scale).

Effects, what is assumed:
stribeck              sliding friction FD + Ts exp(-(|w|/ws)^d) against the motion, plant; Ts = 0.6..1 of FS - FD, so never above the static level; scales with FSJ
lubricated_rise       sliding friction gains F (1 - exp(-|w|/w0)) against the motion, plant; 0 at standstill; does not scale with FSJ
quadratic_drag        c w |w| resists, plant; does not scale with FSJ
viscous_asymmetry     c |w| resists in both directions of motion, i.e. viscous C + c for w > 0, C - c for w < 0; either sign
bias_torque           constant T0 resists (positive T0 pushes the rotor to negative angles), either sign, below static friction
periodic_friction     friction level, static and dynamic, times (1 + A cos(n th + phi)/FD0), n = 1..3 a motor turn: at FSJ = 1 the dynamic level gains A cos(..); scales with FSJ
tight_spot            friction level, static and dynamic, gains T exp(-((x - c)/s)^2): a place on the stroke, x = motor angle from the rest position (not modulo a turn); does not scale with FSJ
presliding            LuGre instead of stick: F = s0 z + s1 dz/dt, dz/dt = w - |w| s0 z / g, g = FD + (FS - FD) exp(-(w/ws)^2), ws 1..4 rad/s; s0 fixed, FS and FD scale with FSJ
cogging               A cos(n th + phi) resists (conservative, acts at rest too), n = 12 and a second order 24 or 4 of 20..50 % of it
torque_ripple         all three phases' k times (1 + z cos(n th + phi)): back-EMF and torque alike; n = 4, 6 or 12 a motor turn
eccentricity          healthy rotor's own zeta0, Eq. 5, phase 0; a fault adds: zeta0 + zeta in the same equation
torque_saturation     torque of each phase k i (1 - beta |i|); back-EMF and inductance unchanged
spring_load           k x resists, zero at the rest position, both directions
compliance            two masses: rotor J - J_L, load J_L (motor side), spring k and damper d between; all friction on the rotor; user angle (loop) from the load; sqrt(k/J_L) 110..260 Hz, damping ratio 0.18..0.3 (less makes the position loop unstable)
backlash              two masses J - J_L and J_L with a gap (full width, motor rad; the type's play of 2 b remains behind it), stiff damped contact; 30 % of the dry friction sits on the load; user angle (loop) from the load
winding_heating       all windings R (1 + 0.00393 dT), constant over all recordings; magnets cold, ke unchanged
supply_sag            bridge voltage = Vs - Rs i_dc, i_dc = sum(s i)/2, source takes current back; every second such unit (drawn) has a link capacitor of 470 uF behind Rs, else none
dead_time             each half bridge loses Vd sgn(i) of its own phase current, linear within +-0.1 A; v_a.. are the leg voltages the gates command (v_dc and switch states), so the loss lies between v_a.. and the winding
turn_short            one phase has (1 - f) of its turns: R (1-f), ke (1-f), L (1-f)^2; no current in the shorted loop, no mutual inductance
commutation_offset    the drive's electrical angle is P th + delta (current references only; plant unchanged); either sign
encoder_eccentricity  resolver reads th + eps sin(th + phi) and its speed w (1 + eps cos(th + phi)): telemetry, commutation and speed loop; position loop keeps the true user angle
current_offset        the sensor of one phase (drawn) reads i + I0; in the current loop and in telemetry
current_gain          the sensor of one phase (drawn) reads i (1 + g); in the current loop and in telemetry; "gain" is g, "factor" 1 + g
control_delay         the current demand (output of the speed loop) reaches the current regulators tau late
"""
import argparse, json, math, os, time
import numpy as np
from numba import njit

DT = 1e-6
RATE = 2000
REF = dict(supply_voltage=48.0, resistance=1.065, inductance=360e-6, back_emf=0.0376,
           inertia=2.5e-5, viscous=3e-5, static_friction=0.03, friction_ratio=0.7)
KTC = 2 * REF["back_emf"]
N_GEAR, POLES, HB, GAP, WMAX = 500.0, 2, 0.1, 1e5, 838.0
KP, KI, IMAX, TMAX, TINT, BHALF, STOP = 0.05, 0.5, 22.5, 1.7, 1.7, 2e-5, 1.2
EFFECTS = ("stribeck lubricated_rise quadratic_drag viscous_asymmetry bias_torque periodic_friction "
           "tight_spot presliding cogging torque_ripple eccentricity torque_saturation spring_load "
           "compliance backlash winding_heating supply_sag dead_time turn_short commutation_offset "
           "encoder_eccentricity current_offset current_gain control_delay").split()

# plant and effect parameters handed to the kernel: one flat vector
_NAMES = ("Vs J C FS FD zeta th0 Ra Rb Rc La Lb Lc ka kb kc "
          "st_T st_w st_d lr_F lr_w quad vasym bias pf_A pf_n pf_phi ts_T ts_c ts_s "
          "lg_s0 lg_s1 lg_ws cg1_A cg1_n cg1_phi cg2_A cg2_n cg2_phi tr_z tr_n tr_phi sat spring "
          "JL k2 d2 gap2 lf Rs Cdc Vd delta eps eps_phi off_a off_b off_c g_a g_b g_c delay ktc").split()
IX = {n: i for i, n in enumerate(_NAMES)}
for _n, _i in IX.items():
    globals()["_" + _n] = _i


@njit(cache=True, inline="always")
def _trap(x):                       # x in turns, 0..1
    x *= 12.0
    if x < 1.0:
        return x
    if x <= 5.0:
        return 1.0
    if x < 7.0:
        return 6.0 - x
    if x <= 11.0:
        return -1.0
    return x - 12.0


@njit(cache=True, inline="always")
def _rect(x):
    x *= 12.0
    if 1.0 <= x < 5.0:
        return 1.0
    if 7.0 <= x < 11.0:
        return -1.0
    return 0.0


@njit(cache=True)
def simulate(com, m, p):
    """com: command per 1 us step; m: steps per sample. The bridge logic and the loops are clocked
    at 1 MHz; between clock edges the windings are integrated by the explicit midpoint rule with the
    back-EMF at the mid-step angle, torque from the mean current of the step, angle by the trapezoid
    of the speed (second order where no switch is crossed)."""
    dt = 1e-6
    n = com.size // m
    out = np.zeros((n, 12))
    TWO_PI = 2.0 * math.pi
    S3 = math.sqrt(3.0) / 2.0
    Vs = p[_Vs]; J = p[_J] - p[_JL]; C = p[_C]; FS0 = p[_FS]; FD0 = p[_FD]; zeta = p[_zeta]
    th0 = p[_th0]
    Ra, Rb, Rc = p[_Ra], p[_Rb], p[_Rc]
    ga, gb, gc = 1.0 / p[_La], 1.0 / p[_Lb], 1.0 / p[_Lc]
    gs = 1.0 / (ga + gb + gc)
    kea, keb, kec = p[_ka], p[_kb], p[_kc]
    lg = p[_lg_s0] > 0.0
    two = p[_JL] > 0.0
    JL = p[_JL]
    lf = p[_lf]
    half = 0.5 * p[_gap2]
    nd = int(round(p[_delay] / dt))
    buf = np.zeros(nd + 1)
    ip = 0
    ktc = p[_ktc]
    Rs = p[_Rs]; Cdc = p[_Cdc]; Vd = p[_Vd]
    eps = p[_eps]
    ia = ib = ic = 0.0
    sa = sb = sc = 1.0
    w = 0.0; th = th0; I = 0.0; thu = 0.0
    z = 0.0
    thl = th0; wl = 0.0
    vdc = Vs
    for j in range(n):
        ma = mb = mc = me = 0.0
        ua = ub = uc = ud = 0.0
        for kk in range(m):
            cm = com[j * m + kk]
            # measured speed and angle
            wm = w; thm = th
            if eps != 0.0:
                thm = th + eps * math.sin(th + p[_eps_phi])
                wm = w * (1.0 + eps * math.cos(th + p[_eps_phi]))
            # position and speed loops
            wref = GAP * (cm - thu)
            wref = min(WMAX, max(-WMAX, wref))
            e = wref - wm
            T = KP * e + I
            ir = T / ktc
            if not (abs(ir) > IMAX and T * e >= 0.0):
                I = min(TINT, max(-TINT, I + KI * e * dt))
            ir = min(IMAX, max(-IMAX, ir))
            if nd > 0:
                buf[ip] = ir
                ip += 1
                if ip > nd:
                    ip = 0
                ir = buf[ip]
            # commutation and relays on the measured currents
            x = (POLES * thm + p[_delta]) / TWO_PI
            x -= math.floor(x)
            xb = x - 1.0 / 3.0
            if xb < 0.0:
                xb += 1.0
            xc = x - 2.0 / 3.0
            if xc < 0.0:
                xc += 1.0
            er = _rect(x) * ir - (ia * (1.0 + p[_g_a]) + p[_off_a])
            if er > HB:
                sa = 1.0
            elif er < -HB:
                sa = -1.0
            er = _rect(xb) * ir - (ib * (1.0 + p[_g_b]) + p[_off_b])
            if er > HB:
                sb = 1.0
            elif er < -HB:
                sb = -1.0
            er = _rect(xc) * ir - (ic * (1.0 + p[_g_c]) + p[_off_c])
            if er > HB:
                sc = 1.0
            elif er < -HB:
                sc = -1.0
            # supply
            if Rs > 0.0:
                idc = 0.5 * (sa * ia + sb * ib + sc * ic)
                if Cdc > 0.0:
                    vdc += dt / Cdc * ((Vs - vdc) / Rs - idc)
                else:
                    vdc = Vs - Rs * idc
            va = 0.5 * sa * vdc; vb = 0.5 * sb * vdc; vc = 0.5 * sc * vdc
            la = lb = lc = 0.0
            if Vd > 0.0:
                la = Vd * min(1.0, max(-1.0, ia * 10.0))
                lb = Vd * min(1.0, max(-1.0, ib * 10.0))
                lc = Vd * min(1.0, max(-1.0, ic * 10.0))
                va -= la; vb -= lb; vc -= lc
            # flux shapes at mid-step
            thh = th + 0.5 * dt * w
            y = POLES * thh / TWO_PI
            y -= math.floor(y)
            yb = y - 1.0 / 3.0
            if yb < 0.0:
                yb += 1.0
            yc = y - 2.0 / 3.0
            if yc < 0.0:
                yc += 1.0
            ka = kea * _trap(y); kb = keb * _trap(yb); kc = kec * _trap(yc)
            if zeta != 0.0:
                co = math.cos(thh); si = math.sin(thh)
                ka *= 1.0 + zeta * co
                kb *= 1.0 + zeta * (-0.5 * co - S3 * si)
                kc *= 1.0 + zeta * (-0.5 * co + S3 * si)
            if p[_tr_z] != 0.0:
                f = 1.0 + p[_tr_z] * math.cos(p[_tr_n] * thh + p[_tr_phi])
                ka *= f; kb *= f; kc *= f
            # windings, midpoint
            ba = va - ka * w; bb = vb - kb * w; bc = vc - kc * w
            da = ba - Ra * ia; db = bb - Rb * ib; dc = bc - Rc * ic
            vn = (da * ga + db * gb + dc * gc) * gs
            ha = ia + 0.5 * dt * ga * (da - vn)
            hb = ib + 0.5 * dt * gb * (db - vn)
            hc = ic + 0.5 * dt * gc * (dc - vn)
            da = ba - Ra * ha; db = bb - Rb * hb; dc = bc - Rc * hc
            vn = (da * ga + db * gb + dc * gc) * gs
            ia += dt * ga * (da - vn); ib += dt * gb * (db - vn); ic += dt * gc * (dc - vn)
            # torque; a stuck rotor sees the end of the step, where the piecewise linear currents peak
            if w == 0.0:
                ha = ia; hb = ib; hc = ic
            if p[_sat] > 0.0:
                TM = (ka * ha * (1.0 - p[_sat] * abs(ha)) + kb * hb * (1.0 - p[_sat] * abs(hb))
                      + kc * hc * (1.0 - p[_sat] * abs(hc)))
            else:
                TM = ka * ha + kb * hb + kc * hc
            TM = min(TMAX, max(-TMAX, TM))
            # resisting torques that are no dry friction
            xm = th - th0
            aw = abs(w)
            A = TM - C * w - p[_quad] * w * aw - p[_vasym] * aw - p[_bias] - p[_spring] * xm
            if p[_cg1_A] != 0.0:
                A -= (p[_cg1_A] * math.cos(p[_cg1_n] * th + p[_cg1_phi])
                      + p[_cg2_A] * math.cos(p[_cg2_n] * th + p[_cg2_phi]))
            # dry friction levels
            FS = FS0; FD = FD0
            if p[_pf_A] != 0.0:
                f = 1.0 + p[_pf_A] * math.cos(p[_pf_n] * th + p[_pf_phi])
                FS *= f; FD *= f
            if p[_ts_T] != 0.0:
                f = (xm - p[_ts_c]) / p[_ts_s]
                if abs(f) < 6.0:
                    f = p[_ts_T] * math.exp(-f * f)
                    FS += f; FD += f
            if two:
                d = th - thl
                tau = 0.0
                if d > half:
                    tau = p[_k2] * (d - half) + p[_d2] * (w - wl)
                    if half > 0.0 and tau < 0.0:
                        tau = 0.0           # no pull across an open gap
                elif d < -half:
                    tau = p[_k2] * (d + half) + p[_d2] * (w - wl)
                    if half > 0.0 and tau > 0.0:
                        tau = 0.0
                A -= tau
                FSl = lf * FS; FDl = lf * FD
                FS -= FSl; FD -= FDl
                if wl == 0.0:
                    FF = tau if abs(tau) <= FSl else math.copysign(FDl, tau)
                else:
                    FF = math.copysign(FDl, wl)
                wn = wl + dt / JL * (tau - FF)
                if wl * wn < 0.0 and lf > 0.0:
                    wn = 0.0
                thl += 0.5 * dt * (wl + wn)
                wl = wn
            if lg:
                f = w / p[_lg_ws]
                g = FD
                if abs(f) < 6.0:
                    g += (FS - FD) * math.exp(-f * f)
                zn = (z + dt * w) / (1.0 + dt * aw * p[_lg_s0] / g)
                FF = p[_lg_s0] * zn + p[_lg_s1] * (zn - z) / dt
                z = zn
                wn = w + dt / J * (A - FF)
            else:
                if w == 0.0:
                    FF = A if abs(A) <= FS else math.copysign(FD, A)
                else:
                    if p[_st_T] > 0.0:
                        f = aw / p[_st_w]
                        if f < 30.0:
                            FD += p[_st_T] * math.exp(-f ** p[_st_d])
                    if p[_lr_F] > 0.0:
                        FD += p[_lr_F] * (1.0 - math.exp(-aw / p[_lr_w]))
                    FF = math.copysign(FD, w)
                wn = w + dt / J * (A - FF)
                if w * wn < 0.0:
                    wn = 0.0
            th += 0.5 * dt * (w + wn)
            w = wn
            u = (th - th0) / N_GEAR
            if u > STOP:
                u = STOP; th = th0 + STOP * N_GEAR; w = min(w, 0.0)
            elif u < -STOP:
                u = -STOP; th = th0 - STOP * N_GEAR; w = max(w, 0.0)
            if two:
                u = (thl - th0) / N_GEAR
            if thu < u - BHALF:
                thu = u - BHALF
            elif thu > u + BHALF:
                thu = u + BHALF
            ma += ia; mb += ib; mc += ic
            me += 0.5 * (abs(ia) + abs(ib) + abs(ic))
            ua += va + la - vn; ub += vb + lb - vn; uc += vc + lc - vn; ud += vdc
        out[j, 0] = com[j * m + m - 1]
        out[j, 1] = th; out[j, 2] = w
        out[j, 3] = ma / m; out[j, 4] = mb / m; out[j, 5] = mc / m; out[j, 6] = me / m
        out[j, 7] = ua / m; out[j, 8] = ub / m; out[j, 9] = uc / m; out[j, 10] = ud / m
        out[j, 11] = thu
    return out


# ---------------------------------------------------------------- commands

def preflight():
    c = np.zeros(3_000_000)
    t = np.arange(c.size) * DT
    c[:500_000] = 0.001 * t[:500_000]
    c[850_000:1_850_000] = 0.001 * np.sin(2 * np.pi * 5 * (t[850_000:1_850_000] - 0.85))
    c[2_200_000:] = 1.0
    return c


class Path:
    """A command put together from moves, creeps, holds and windowed multi-sines."""
    def __init__(self, total=8.0):
        self.parts, self.x, self.n, self.total = [], 0.0, 0, int(round(total / DT))

    def _add(self, y):
        y = y[:max(0, self.total - self.n)]
        self.parts.append(self.x + y)
        self.n += y.size
        if y.size:
            self.x += y[-1]

    def hold(self, T):
        self._add(np.zeros(int(T / DT)))

    def move(self, to, v, acc=24.0):
        d = to - self.x
        s, D = math.copysign(1.0, d), abs(d)
        v = min(v, math.sqrt(D * acc))
        ta, tc = v / acc, (D - v * v / acc) / v
        t = np.arange(1, int((2 * ta + tc) / DT) + 1) * DT
        up = 0.5 * acc * np.minimum(t, ta) ** 2
        mid = v * np.clip(t - ta, 0, tc)
        td = np.clip(t - ta - tc, 0, ta)
        self._add(s * (up + mid + v * td - 0.5 * acc * td ** 2))

    def creep(self, v, T):
        self._add(v * np.arange(1, int(T / DT) + 1) * DT)

    def sines(self, T, terms, edge=0.12):
        t = np.arange(1, int(T / DT) + 1) * DT
        win = np.sin(0.5 * np.pi * np.clip(np.minimum(t, T - t) / edge, 0, 1)) ** 2
        y = np.zeros(t.size)
        for a, f, ph in terms:
            y += a * np.sin(2 * np.pi * f * t + ph)
        y *= win
        y *= min(1.0, 0.95 * DT / np.abs(np.diff(y)).max())     # speed limit
        self._add(y)

    def array(self):
        if self.n < self.total:
            self.hold((self.total - self.n + 5) * DT)
        y = np.concatenate(self.parts)[:self.total]
        return y


def long_command(which, rng):
    def r(v, s=0.15):
        return v * rng.uniform(1 - s, 1 + s)
    sg = 1.0 if rng.random() < 0.5 else -1.0
    ph = lambda: rng.uniform(0, 2 * np.pi)
    P = Path()
    if which == 1:          # staircase of speeds over the stroke, reversals, slow creep, multi-sine
        P.creep(sg * r(0.004), 0.30)
        P.hold(0.10)
        P.creep(-sg * r(0.01), 0.30)
        P.move(sg * r(0.05), r(0.12))
        P.hold(0.12)
        P.move(sg * r(0.02), r(0.05))
        P.move(sg * r(0.85, 0.04), r(0.75, 0.08))
        P.hold(0.10)
        P.move(sg * r(0.65, 0.04), r(0.35))
        P.move(-sg * r(0.80, 0.04), r(0.95, 0.04))
        P.hold(0.08)
        P.move(-sg * r(0.70, 0.03), r(0.20))
        P.move(-sg * r(0.30, 0.1), r(0.55))
        P.sines(0.9, [(0.012, r(1.7), ph()), (0.006, r(4.3), ph()), (0.003, r(12.0), ph())])
        for v in (.12, -.18, .15, -.08):
            P.creep(sg * r(v), r(0.06))
        P.move(0.0, r(0.60), 40.0)
        P.sines(max(0.3, (P.total - P.n) * DT - 0.1), [(0.0008, r(3.0), ph()), (0.0003, r(9.0), ph())])
    else:                   # multi-sines of three sizes, fast small ones, long sweeps with riding sine
        P.hold(0.05)
        P.sines(1.2, [(0.002, r(2.0), ph()), (0.001, r(5.0), ph()), (0.0004, r(13.0), ph())])
        P.creep(sg * r(0.025), 0.35)
        P.creep(-sg * r(0.06), 0.30)
        P.sines(1.6, [(0.05, r(0.9), ph()), (0.03, r(2.2), ph()), (0.006, r(6.0), ph())])
        P.move(-sg * r(0.75, 0.04), r(0.65, 0.1))
        P.hold(0.15)
        P.move(sg * r(0.70, 0.04), r(0.85, 0.06))
        P.move(sg * r(0.55, 0.04), r(0.30))
        P.hold(0.10)
        P.sines(0.7, [(0.005, r(9.0), ph()), (0.0022, r(17.0), ph())])
        for v in (-.15, .10, -.20, .16):
            P.creep(sg * r(v), r(0.05))
        P.move(sg * r(0.15), r(0.45), 40.0)
        P.move(sg * r(0.22), r(0.15), 6.0)
        P.sines(max(0.3, (P.total - P.n) * DT), [(0.02, r(1.5), ph()), (0.004, r(5.5), ph())])
    return P.array()


# ---------------------------------------------------------------- units

def constants(seed, k):
    g = np.random.default_rng([seed, k, 1])
    spread = dict(inertia=.10, viscous=.20, static_friction=.10, back_emf=.015, resistance=.04,
                  inductance=.05, friction_ratio=.05, supply_voltage=.01)
    return {n: REF[n] * g.uniform(1 - s, 1 + s) for n, s in spread.items()}


def effect_of(seed, k):
    if k % 2 == 0:
        return None
    i = k // 2
    return EFFECTS[np.random.default_rng([seed, i // len(EFFECTS), 2]).permutation(len(EFFECTS))[i % len(EFFECTS)]]


def strength(name, c, seed, k):
    """parameters of the effect, SI, motor side"""
    g = np.random.default_rng([seed, k, 3])
    U = g.uniform
    sgn = lambda: 1.0 if U() < 0.5 else -1.0
    ang = lambda: U(0, 2 * math.pi)
    fs = c["static_friction"]; fd = fs * c["friction_ratio"]; J = c["inertia"]
    if name == "stribeck":
        return dict(torque=U(.6, 1.) * (fs - fd), speed=U(15, 70), exponent=U(1, 2))
    if name == "lubricated_rise":
        return dict(torque=U(.006, .012), speed=U(40, 200))
    if name == "quadratic_drag":
        return dict(coefficient=U(2e-8, 5e-8))
    if name == "viscous_asymmetry":
        return dict(coefficient=sgn() * U(6e-6, 1.5e-5))
    if name == "bias_torque":
        return dict(torque=sgn() * U(.004, .010))
    if name == "periodic_friction":
        return dict(amplitude=U(.25, .5) * fd, phase=ang(), order=int(g.integers(1, 4)))
    if name == "tight_spot":
        return dict(torque=U(.012, .025), centre=N_GEAR * U(-.55, .6), width=N_GEAR * U(.03, .10))
    if name == "presliding":
        s0 = U(.6, 4.0)
        return dict(stiffness=s0, damping=U(.3, 1.0) * math.sqrt(s0 * J), speed=U(1, 4))
    if name == "cogging":
        a = U(.004, .009)
        return dict(amplitude=a, phase=ang(), order=12,
                    second=dict(amplitude=a * U(.2, .5), phase=ang(), order=int(g.choice([4, 24]))))
    if name == "torque_ripple":
        return dict(fraction=U(.04, .10), phase=ang(), order=int(g.choice([4, 6, 12])))
    if name == "eccentricity":
        return dict(zeta=U(.04, .12), phase=0.0)
    if name == "torque_saturation":
        return dict(coefficient=U(.006, .015))
    if name == "spring_load":
        return dict(stiffness=U(1e-5, 3.5e-5))
    if name == "compliance":
        jl = U(.3, .55) * J; wr = 2 * math.pi * U(110, 260)
        return dict(stiffness=jl * wr * wr, damping=2 * U(.18, .3) * jl * wr, inertia=jl)
    if name == "backlash":
        jl = .3 * J; wr = 2 * math.pi * 900
        return dict(gap=U(.04, .12), load_inertia=jl, contact_stiffness=jl * wr * wr,
                    contact_damping=2 * .3 * jl * wr, load_friction_share=.3)
    if name == "winding_heating":
        return dict(delta_t=U(35, 85))
    if name == "supply_sag":
        return dict(resistance=U(.15, .40), capacitance=470e-6 if U() < .5 else 0.0)
    if name == "dead_time":
        return dict(voltage=U(.6, 1.8))
    if name == "turn_short":
        q = int(g.integers(0, 3))
        return dict(fraction=U(.06, .18), phase=q)
    if name == "commutation_offset":
        return dict(angle=sgn() * U(.12, .30))
    if name == "encoder_eccentricity":
        return dict(amplitude=U(.004, .014), phase=ang())
    if name == "current_offset":
        return dict(current=sgn() * U(.08, .25), phase=int(g.integers(0, 3)))
    if name == "current_gain":
        v = sgn() * U(.05, .12)
        return dict(gain=v, factor=1 + v, phase=int(g.integers(0, 3)))
    if name == "control_delay":
        return dict(delay=round(U(2e-4, 4.5e-4), 6))
    raise ValueError(name)


def vector(c, name, e, fsj=1.0, zeta=0.0, th0=0.0):
    p = np.zeros(len(_NAMES))
    v = dict(Vs=c["supply_voltage"], J=c["inertia"], C=c["viscous"], FS=fsj * c["static_friction"],
             zeta=zeta, th0=th0, ktc=KTC)
    v["FD"] = v["FS"] * c["friction_ratio"]
    for q in "abc":
        v["R" + q], v["L" + q], v["k" + q] = c["resistance"], c["inductance"], c["back_emf"]
    if name == "stribeck":
        v.update(st_T=fsj * e["torque"], st_w=e["speed"], st_d=e["exponent"])
    elif name == "lubricated_rise":
        v.update(lr_F=e["torque"], lr_w=e["speed"])
    elif name == "quadratic_drag":
        v.update(quad=e["coefficient"])
    elif name == "viscous_asymmetry":
        v.update(vasym=e["coefficient"])
    elif name == "bias_torque":
        v.update(bias=e["torque"])
    elif name == "periodic_friction":
        v.update(pf_A=e["amplitude"] / (c["static_friction"] * c["friction_ratio"]), pf_n=e["order"], pf_phi=e["phase"])
    elif name == "tight_spot":
        v.update(ts_T=e["torque"], ts_c=e["centre"], ts_s=e["width"])
    elif name == "presliding":
        v.update(lg_s0=e["stiffness"], lg_s1=e["damping"], lg_ws=e["speed"])
    elif name == "cogging":
        s = e["second"]
        v.update(cg1_A=e["amplitude"], cg1_n=e["order"], cg1_phi=e["phase"],
                 cg2_A=s["amplitude"], cg2_n=s["order"], cg2_phi=s["phase"])
    elif name == "torque_ripple":
        v.update(tr_z=e["fraction"], tr_n=e["order"], tr_phi=e["phase"])
    elif name == "eccentricity":
        v["zeta"] += e["zeta"]
    elif name == "torque_saturation":
        v.update(sat=e["coefficient"])
    elif name == "spring_load":
        v.update(spring=e["stiffness"])
    elif name == "compliance":
        v.update(JL=e["inertia"], k2=e["stiffness"], d2=e["damping"])
    elif name == "backlash":
        v.update(JL=e["load_inertia"], k2=e["contact_stiffness"], d2=e["contact_damping"],
                 gap2=e["gap"], lf=e["load_friction_share"])
    elif name == "winding_heating":
        for q in "abc":
            v["R" + q] *= 1 + .00393 * e["delta_t"]
    elif name == "supply_sag":
        v.update(Rs=e["resistance"], Cdc=e["capacitance"])
    elif name == "dead_time":
        v.update(Vd=e["voltage"])
    elif name == "turn_short":
        q, f = "abc"[e["phase"]], 1 - e["fraction"]
        v["R" + q] *= f; v["k" + q] *= f; v["L" + q] *= f * f
    elif name == "commutation_offset":
        v.update(delta=e["angle"])
    elif name == "encoder_eccentricity":
        v.update(eps=e["amplitude"], eps_phi=e["phase"])
    elif name == "current_offset":
        v["off_" + "abc"[e["phase"]]] = e["current"]
    elif name == "current_gain":
        v["g_" + "abc"[e["phase"]]] = e["gain"]
    elif name == "control_delay":
        v.update(delay=e["delay"])
    for n, x in v.items():
        p[IX[n]] = x
    return p


def sensors(raw, p, rng, rate=RATE):
    """The reference sensor model. Columns of a recording."""
    n = raw.shape[0]
    th, w = raw[:, 1], raw[:, 2]
    eps, ph, th0 = p[_eps], p[_eps_phi], p[_th0]
    w_m = w * (1 + eps * np.cos(th + ph)) + 0.2 * rng.standard_normal(n)
    lsb = 2 * math.pi / 65536
    thm = np.round((th + eps * np.sin(th + ph)) / lsb) * lsb
    start = round((th0 + eps * math.sin(th0 + ph)) / lsb) * lsb
    adc = 50.0 / 4096
    off = rng.uniform(-0.02, 0.02, 3)
    cur = np.empty((n, 3))
    for q in range(3):
        i = raw[:, 3 + q] * (1 + p[_g_a + q]) + p[_off_a + q] + off[q] + 0.02 * rng.standard_normal(n)
        cur[:, q] = np.clip(np.round(i / adc), -2048, 2047) * adc + 0.0
    t = np.arange(1, n + 1) / rate
    return np.column_stack([t, raw[:, 0], (thm - start) / N_GEAR, thm, w_m,
                            0.5 * np.abs(cur).sum(1), cur, raw[:, 7:11]])


HEAD = "t,com,theta_u,theta_m,omega_m,i_eq,i_a,i_b,i_c,v_a,v_b,v_c,v_dc"
FMT = "%.7g,%.9g,%.9g,%.9g,%.7g" + ",%.8g" * 8


def write(path, rows):
    with open(path, "w") as f:
        f.write(HEAD + "\n")
        f.write("\n".join([FMT % tuple(r) for r in rows.tolist()]) + "\n")


_PRE = None


def record(c, name, e, com, fsj, zeta, seed, k, tag):
    g = np.random.default_rng([seed, k, *tag])
    th0 = g.uniform(0, 2 * math.pi)
    p = vector(c, name, e, fsj, zeta, th0)
    return sensors(simulate(com, 1_000_000 // RATE, p), p, g), th0


def unit(seed, k, tests, out, forced=None):
    global _PRE
    if _PRE is None:
        _PRE = preflight()
    c = constants(seed, k)
    name = effect_of(seed, k) if forced is None else (None if forced == "none" else forced)
    e = strength(name, c, seed, k) if name else {}
    d = os.path.join(out, f"unit-{k}")
    os.makedirs(d, exist_ok=True)
    rest = {}

    def make(fn, com, fsj, zeta, tag):
        rows, th0 = record(c, name, e, com, fsj, zeta, seed, k, tag)
        write(os.path.join(d, fn + ".csv"), rows)
        rest[fn] = th0

    for w in (1, 2):
        make(f"healthy_long_{w}", long_command(w, np.random.default_rng([seed, k, 4, w])), 1.0, 0.0, (10, w))
    for i in range(3):
        make(f"healthy_{i}", _PRE, 1.0, 0.0, (11, i))
        make(f"fresh_{i}", _PRE, 1.0, 0.0, (12, i))
    faults = []
    for i in range(tests):
        g = np.random.default_rng([seed, k, 5, i])
        f = [g.uniform(1.1, 4.9), g.uniform(0.0, 0.49)]
        make(f"test_{i}", _PRE, f[0], f[1], (13, i))
        faults.append(f)
    truth = dict(seed=seed, unit=k,
                 constants=dict(c, coulomb=c["static_friction"] * c["friction_ratio"],
                                torque_constant=2 * c["back_emf"], ktc=KTC, gear=N_GEAR, pole_pairs=POLES,
                                backlash_half_width_user=BHALF),
                 effect=None if name is None else dict(name=name, **e),
                 tests=faults, rest_angle=rest)
    with open(os.path.join(d, "truth.json"), "w") as f:
        json.dump(truth, f, indent=1)
    return name, e


# ---------------------------------------------------------------- check against the printed numbers

def selfcheck():
    c = dict(REF)
    n = 1_000_000
    t = np.arange(n) * DT
    step, sine, ramp = np.ones(800_000), 0.001 * np.sin(10 * np.pi * t), 0.001 * t

    def run(com, m, f, z):
        return simulate(com, m, vector(c, None, {}, f, z))
    nom_w = run(step, 100, 1, 0)[:, 2] / N_GEAR
    sl = slice(2000, 6500)
    mean0 = nom_w[sl].mean()
    nom_i = run(sine, 100, 1, 0)[:, 6]
    print(f"nominal mean step speed {mean0:.5f} (printed 1.23872)")
    table = [(1, 0, .00022778, .00022778, 0, 4.079), (3, 0, .03686, .00022497, .55957, 15.19),
             (5, 0, .07415, .00041981, 1.1061, 24.78), (1, .3, .018782, .005007, .047767, 4.689),
             (3, .3, .053016, .0048019, .60846, 17.62), (5, .3, .087145, .0046011, 1.1879, 29.03),
             (1, .5, .050979, .0085198, .072774, 5.619), (5, .5, .11493, .007893, 1.2748, 32.58)]
    for f, z, p1, rp, p2, p3 in table:
        w = run(step, 100, f, z)[sl, 2] / N_GEAR
        i = run(sine, 100, f, z)[:, 6]
        r = run(ramp[:100_000], 10, f, z)
        b = r[np.argmax(r[:, 2] != 0), 0] * 1e6
        a1 = math.sqrt(np.mean((w - mean0) ** 2))
        a2 = math.sqrt(np.mean((i - nom_i) ** 2))
        print(f"{f} {z:3.1f}  P1 {a1:.5g} ({p1})  ripple {w.std():.5g} ({rp})  P2 {a2:.5g} ({p2})  P3 {b:.5g} ({p3})")


def main():
    a = argparse.ArgumentParser()
    a.add_argument("--seed", type=int, default=0)
    a.add_argument("--units", type=int, default=2)
    a.add_argument("--tests", type=int, default=2)
    a.add_argument("--out", default="fleet")
    a.add_argument("--effect", choices=list(EFFECTS) + ["none"])
    a.add_argument("--selfcheck", action="store_true")
    o = a.parse_args()
    if o.selfcheck:
        return selfcheck()
    for k in range(o.units):
        t0 = time.time()
        name, e = unit(o.seed, k, o.tests, o.out, o.effect)
        print(f"unit {k}: {name or 'none'} {e}  {time.time() - t0:.1f} s", flush=True)


if __name__ == "__main__":
    main()
