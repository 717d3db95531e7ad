#!/usr/bin/env python3
"""laws.py - an independent simulator and recording generator of a (possibly faulty) electromechanical actuator.
Written from ntb.md, interfaces.md, paper.txt and discrepancy.md alone; it shares no code with any estimator.

USE   laws.py --seed S --units N --first K0 --tests M --out DIR [--effect auto|none|NAME] [--long-only]
      laws.py --validate [--ref DIR]      figures of ntb.md beside mine (and distance to its reference trajectories)

PHYSICS (SI, motor side; paper Eq. 4-8 as closed by ntb.md)
  Drive: a digital machine with a clock of 1 us. At every tick it reads angle, speed, currents and user position, runs the
    position/speed law of ntb.md (steps 2, 3), the rectangular phase references and the three memory relays (step 5), and holds
    the six gates until the next tick. The 1 us belongs to the actuator (ntb.md says so), it is not my integration error.
  Windings: three R-L-e.m.f. branches in star, e.m.f. by Eq. 5 (trapezoid, eccentricity per phase); gates held.
  Rotor: J dw/dt = TM - C w - friction - resisting torques; Borello friction (FS at rest, FD moving); end stops +-1.2 rad;
    play operator b = 2e-5 rad between screw and user shaft.
INTEGRATOR (between two ticks; not an explicit Euler)
  Currents: exact exponential of the linear circuit with e.m.f. taken at the tick's mid angle and mid speed (scalar exponentials
    for a symmetric winding, a matrix exponential of the 4-current circuit for a shorted one, recomputed as R warms up).
  Mechanics: torque varies linearly over the tick; 2nd order (Heun) in viscous torque; the instants of break-away and of zero
    speed are LOCATED inside the tick and the stick/slip decision is taken there (stays when |A| <= FS, otherwise reverses).
  DC link (if any): exact exponential with the inverter current held. Bristle: exact exponential of the linear-in-z equation.
SENSORS (a bench is drawn per unit; recorded columns are those of interfaces.md)
  t = end of the sample, com = command of the last tick of the sample. theta_m = resolver angle (absolute, turns counted, starts
  at the rest angle), rounded to 14/15/16 bit a turn; theta_u = (theta_m - its rest reading)/500, i.e. user position from the
  resolver through the gear. omega_m: "own" = point value at t + white noise, or "derived" = backward difference of the quantised
  resolver then a one-pole low-pass at the telemetry rate. Phase currents +-25 A, 12/14/16 bit, white noise per recorded sample,
  offset per phase and per recording up to 0.03 A (sensor of the recorder only), mean over the sample or point value at its end;
  i_eq = half the sum of absolute values of the recorded phase currents. v_a..v_c = terminal to star point, mean over sample,
  +-64 V in 13..16 bit, noise; v_dc = mean over the sample, 0..64 V in 12..14 bit, noise.
  Rest angle: one per unit, or drawn anew for each recording. Every recording starts at rest, at the middle of the play.
CONSTANTS  uniform: J, C, FS0 +-12 %, FD/FS +-5 %, ke +-2 %, R, L +-5 %, supply +-1 %; the drive's torque constant stays
  0.0752 N m/A; gains, limits, hysteresis, play, gear as in ntb.md. FSJ multiplies this unit's own FS (and FD by the ratio).
FAULTS  FSJ ~ U(1.1, 4.5), zeta ~ U(0.02, 0.45) in Eq. 5 with phase 0; a hidden eccentricity adds to it as a vector.

EFFECTS: name, law, range. Torques are RESISTING (subtracted from TM) unless said; th = absolute rotor angle, m = th - rest
angle = screw position in motor radians, sw = sgn(w). "scales" = multiplied by FSJ in tests, as it belongs to the dry friction.
  stribeck          +T sw/(1+(|w|/speed)^exponent) on top of FD (Hess-Soom); T = 0.6..1.0 of (FS-FD); speed 10..40, exponent
                    1.5..2.5; scales
  lubricated_rise   +T tanh(|w|/speed) sw (Gecim-Winer limiting shear); T 0.006..0.014, speed 30..120; does not scale
  quadratic_drag    +c w|w|; c 4e-8..1.2e-7
  viscous_asymmetry +c |w|; c = +-(0.8..1.8)e-5
  bias_torque       +T (constant, also at rest); T = +-(0.003..0.008)
  periodic_friction both levels of dry friction times (1 + a cos(order th + phase)); a 0.25..0.5 (amplitude = a FD), order 1..3; scales
  tight_spot        both levels raised by T cos^2(pi (m-centre)/(4 width')) inside |m-centre| < 2 width', 0 outside (Hann bump,
                    width' = 0.833 width, so its half-height width is that of exp(-((m-c)/width)^2)); T 0.01..0.03,
                    centre +-(75..240), width 15..50; does not scale
  presliding        dry friction replaced by the elasto-plastic bristle of Dupont et al.: F = s0 z + s1(w) dz/dt,
                    dz/dt = w (1 - a(z,w) z/zss), zss = g(w)/s0, g = FD+(FS-FD) exp(-(w/2)^2), z_ba = 0.6 zss,
                    s1 = damping exp(-(w/8)^2); stiffness 0.6..3, damping = (0.4..1.0) sqrt(stiffness J); g scales
  cogging           +A cos(n th+phase) + 0.2 A cos(2 n th + phase2); A 0.003..0.008, n in 6, 12, 18, 24
  torque_ripple     k of every phase (e.m.f. and torque alike) times 1 + f cos(n th+phase); f 0.05..0.12, n in 4, 8, 12
  eccentricity      Eq. 5 with own orientation: 1 + zeta cos(th + 2 pi q/3 + phase); zeta 0.08..0.25
  torque_saturation k (e.m.f. and torque) over sqrt(1+(I/Isat)^2), I = half the sum of |i|; Isat 12..22 A; "coefficient" in truth is
                    the least-squares beta of 1 - beta I over 0..20 A
  spring_load       +k m; k 4e-5..1e-4
  compliance        rotor J - J_L, screw J_L (J stays the total), spring and damper between; 30 % of the dry friction on the
                    rotor, 70 % on the screw, viscous on the rotor, each side sticks by itself; the drive's user position comes
                    from the screw; J_L 0.25..0.45 J, stiffness 10..40, damping ratio 0.06..0.2
  backlash          the same two masses with total free angle gap 0.03..0.12 rad; contact stiffness 40, damping ratio 0.15, contacts do not pull
  winding_heating   uniform winding temperature, C_th dT/dt = P_cu + P_ext - (T-T0)/R_th, R_th 2.5..4 K/W, tau 12..25 s,
                    each recording starts at dT0 15..30 K and P_ext would lead to 70..110 K; R(1+0.0039 dT), ke(1-0.0004 dT);
                    "delta_t" in truth: mean over the long recordings (per file: start, mean, end)
  supply_sag        source resistance 0.2..0.6 ohm into a DC-link capacitor 0.5..2 mF (two-quadrant source)
  dead_time         leg voltage lowered by V asinh(i/5mA)/asinh(5A/5mA) (junction-like; V is the loss at 5 A); V 0.8..2
  turn_short        fraction f of the turns of one phase bridged by a contact resistance: circuit with 4 currents, the shorted
                    turns couple with 0.95 to the rest, dissipate and brake; f 0.03..0.06, contact (0..0.5) f R
  commutation_offset  rectangular references taken at P th + angle; angle = +-(0.10..0.30) electrical rad
  encoder_eccentricity  resolver reads th + A sin(th+phase), its speed w (1 + A cos(th+phase)); used by the drive (commutation and
                    speed) and recorded; user position of the drive is not affected; A 0.008..0.03
  current_offset    the sensor of one phase reads i + I, in the drive and in the recording; I = +-(0.10..0.25)
  current_gain      sensors read g i, in drive and recording, of one phase or of all three (drawn); g = 1 +- (0.05..0.12)
  control_delay     current reference (output of the speed loop) acts later by 0.15..0.45 ms
ASSUMPTIONS where documents are silent: the above choices; the drive's own sensors are ideal except for the four sensing effects; telemetry
averages are over ticks; extra temperature channel not recorded; no external load; bench.toml uses drive = "current" (the
normative example's way) with the phase channels, lists the long recordings only, and quantities it has no key for are in comments.
KNOWN  against ntb.md (--validate): the mean step speed differs by 0.006 % (exact exponential against its Euler step), which is up to 0.6 % of
the small P1*; the ripple at zeta = 0 is the relays' own and not reproducible to per cents; P3* (3, 0) is one relay beat earlier.
"""
import argparse, json, math, os, sys, time
import numpy as np
from numba import njit

TAU = 2*math.pi
DT = 1e-6
GEAR = 500.0
EFFECTS = ["stribeck", "lubricated_rise", "quadratic_drag", "viscous_asymmetry", "bias_torque", "periodic_friction",
           "tight_spot", "presliding", "cogging", "torque_ripple", "eccentricity", "torque_saturation", "spring_load",
           "compliance", "backlash", "winding_heating", "supply_sag", "dead_time", "turn_short", "commutation_offset",
           "encoder_eccentricity", "current_offset", "current_gain", "control_delay"]

# ---- parameter vector of the kernel -------------------------------------------------------------------------------------
_names = """VS R L KE J C FS FD KT ZF ZHC ZHS TH0 STR_T STR_W STR_D LUB_T LUB_W QUAD VASY BIAS PF_A PF_N PF_PH TS_T TS_C TS_W
PRE_K PRE_D COG_A COG_N COG_PH COG_PH2 RIP_F RIP_N RIP_PH ISAT KSPR TWO K2 D2 JL GAP FRROT HEAT T0 RTH TAUTH PEXT RS CDC VD
SHORT SHF SHP COMOFF ENC_A ENC_PH OFF0 OFF1 OFF2 G0 G1 G2 DELAY FSJ""".split()
for _i, _n in enumerate(_names):
    globals()["p_" + _n] = _i
NP = len(_names)
NSIN = 8
NSEG = 8 + 3*NSIN          # start tick, value, slope, chirp A, f0, f1, T, nsines, then (A, f, phi)


@njit(cache=False, inline="always")
def trap(x):
    """x in electrical turns; 0..1 over 30 degrees, flat to 150, ..."""
    x = (x - math.floor(x))*12.0
    if x < 1.0:
        return x
    if x < 5.0:
        return 1.0
    if x < 7.0:
        return 6.0 - x
    if x < 11.0:
        return -1.0
    return x - 12.0


@njit(cache=False, inline="always")
def rect(x):
    x = (x - math.floor(x))*12.0
    if x < 1.0:
        return 0.0
    if x < 5.0:
        return 1.0
    if x < 7.0:
        return 0.0
    if x < 11.0:
        return -1.0
    return 0.0


@njit(cache=False)
def slide(w, a0, a1, FS, FD, J, C, h):
    """rigid body with dry friction over one tick; drive torque goes a0 -> a1 linearly; returns speed, travel"""
    t = 0.0
    dth = 0.0
    for _ in range(4):
        if t >= h:
            break
        at = a0 + (a1 - a0)*(t/h)
        if w == 0.0:
            if abs(at) > FS:
                s = 1.0 if at > 0 else -1.0
            elif abs(a1) > FS:
                s = 1.0 if a1 > 0 else -1.0
                t = h*(s*FS - a0)/(a1 - a0)
                if t >= h:
                    break
                at = s*FS
            else:
                break
        else:
            s = 1.0 if w > 0 else -1.0
        d = h - t
        am = 0.5*(at + a1)
        acc0 = (at - s*FD - C*w)/J
        wn = w + d/J*(am - s*FD - C*(w + 0.5*d*acc0))
        if w != 0.0 and wn*s <= 0.0:
            tz = d*w/(w - wn)
            dth += 0.5*w*tz
            t += tz
            w = 0.0
            if wn == 0.0:
                break
        elif wn*s <= 0.0:
            break
        else:
            dth += 0.5*d*(w + wn)
            w = wn
            break
    return w, dth


@njit(cache=False)
def expm_phi(A, B, h):
    """E = exp(A h), G = integral_0^h exp(A s) ds B, by a Taylor series with scaling"""
    n = A.shape[0]
    q = 0
    nrm = 0.0
    for i in range(n):
        r = 0.0
        for j in range(n):
            r += abs(A[i, j])
        nrm = max(nrm, r)
    nrm *= h
    while nrm > 0.25:
        nrm *= 0.5
        q += 1
    hs = h/2.0**q
    M = A*hs
    E = np.eye(n)
    P = np.eye(n)
    term = np.eye(n)
    for k in range(1, 13):
        term = term @ M / k
        E = E + term
        P = P + term/(k + 1)
    P = P*hs
    for _ in range(q):
        P = P + E @ P
        E = E @ E
    return E, P @ B


@njit(cache=False)
def command(seg, s, k):
    tau = (k - seg[s, 0])*1e-6
    v = seg[s, 1] + seg[s, 2]*tau
    if seg[s, 3] != 0.0:
        v += seg[s, 3]*math.sin(6.283185307179586*(seg[s, 4]*tau + (seg[s, 5] - seg[s, 4])*tau*tau/(2*seg[s, 6])))
    for j in range(int(seg[s, 7])):
        o = 8 + 3*j
        v += seg[s, o]*math.sin(6.283185307179586*seg[s, o + 1]*tau + seg[s, o + 2])
    return v


@njit(cache=False)
def run(p, seg, nsamp, nsub, A4, B4, cA, cB, out):
    """out[nsamp, 19]: com th_res w_res thu(true) ieq  ia ib ic (mean)  ia ib ic (point)  va vb vc  vdc  T  th w stuck"""
    h = 1e-6
    Pp = 2.0
    TP = 6.283185307179586
    GAP_, WM, KP, KI, IM, TMAX, TINT, HB, BL, NG = 1e5, 838.0, 0.05, 0.5, 22.5, 1.7, 1.7, 0.1, 2e-5, 500.0
    VS, KE0, J, C = p[p_VS], p[p_KE], p[p_J], p[p_C]
    FS0, FD0, KT = p[p_FS]*p[p_FSJ], p[p_FD]*p[p_FSJ], p[p_KT]
    FSJ = p[p_FSJ]
    zf, zc, zs = p[p_ZF] + p[p_ZHC], 0.0, p[p_ZHS]
    ecc = (zf != 0.0) or (zs != 0.0)
    two = p[p_TWO] > 0.5
    JL = p[p_JL]
    JR = J - JL
    heat = p[p_HEAT] > 0.5
    short = p[p_SHORT] > 0.5
    sq = int(p[p_SHP])
    shf = p[p_SHF]
    pre = p[p_PRE_K] > 0.0
    sag = p[p_RS] > 0.0
    sat = p[p_ISAT] > 0.0
    rip = p[p_RIP_F] != 0.0
    vdrop = p[p_VD] != 0.0
    vdn = math.asinh(5.0/0.005)
    enc = p[p_ENC_A] != 0.0
    anyfr = p[p_STR_T] != 0.0 or p[p_LUB_T] != 0.0 or p[p_PF_A] != 0.0 or p[p_TS_T] != 0.0
    anyres = (p[p_QUAD] != 0.0 or p[p_VASY] != 0.0 or p[p_BIAS] != 0.0 or p[p_COG_A] != 0.0 or p[p_KSPR] != 0.0)
    nd = int(round(p[p_DELAY]/h))
    ring = np.zeros(max(nd, 1))
    th0 = p[p_TH0]
    th = th0
    w = 0.0
    thl = 0.0            # screw position (motor side) counted from rest
    wl = 0.0
    thu = 0.0
    I = 0.0
    i = np.zeros(3)
    im = np.zeros(3)
    x2 = 0.0
    x2m = 0.0
    s = np.ones(3)
    v = np.zeros(3)
    k_ = np.zeros(3)
    zb = 0.0
    vdc = VS
    Tw = p[p_T0]
    R, L, KE = p[p_R], p[p_L], KE0
    if heat:
        R = p[p_R]*(1 + 0.0039*Tw)
        KE = KE0*(1 - 0.0004*Tw)
    ea = math.exp(-R*h/L)
    eb = (1 - ea)/R
    E, G = expm_phi(A4, B4, h)
    x = np.zeros(4)
    u = np.zeros(4)
    acc = 0.0
    ex = math.exp(-h/(p[p_RS]*p[p_CDC])) if sag else 0.0
    sidx = 0
    nseg = seg.shape[0]
    n = 0
    sm = np.zeros(8)
    for m in range(nsamp):
        for j in range(8):
            sm[j] = 0.0
        com = 0.0
        stuck = 0
        pcu = 0.0
        for _k in range(nsub):
            while sidx + 1 < nseg and n >= seg[sidx + 1, 0]:
                sidx += 1
            com = command(seg, sidx, n)
            # ---- drive tick
            thd = th
            wd = w
            if enc:
                thd = th + p[p_ENC_A]*math.sin(th + p[p_ENC_PH])
                wd = w*(1 + p[p_ENC_A]*math.cos(th + p[p_ENC_PH]))
            wref = GAP_*(com - thu)
            wref = min(max(wref, -WM), WM)
            e = wref - wd
            T = KP*e + I
            ir = T/KT
            lim = abs(ir) > IM
            ir = min(max(ir, -IM), IM)
            if not (lim and T*e >= 0.0):
                I += KI*e*h
                I = min(max(I, -TINT), TINT)
            if nd > 0:
                r = ring[n % nd]
                ring[n % nd] = ir
                ir = r
            ph = (Pp*thd + p[p_COMOFF])/TP
            for q in range(3):
                er = rect(ph - q/3.0)*ir - (i[q]*p[p_G0 + q] + p[p_OFF0 + q])
                if er > HB:
                    s[q] = 1.0
                elif er < -HB:
                    s[q] = -1.0
            # ---- windings over the tick
            for q in range(3):
                v[q] = s[q]*vdc*0.5
                if vdrop:
                    v[q] -= p[p_VD]*math.asinh(i[q]/0.005)/vdn
            thm = th + 0.5*h*w
            wm = w + 0.5*h*acc
            fac = KE
            if rip:
                fac *= 1 + p[p_RIP_F]*math.cos(p[p_RIP_N]*thm + p[p_RIP_PH])
            if sat:
                ieq = 0.5*(abs(i[0]) + abs(i[1]) + abs(i[2]))
                fac /= math.sqrt(1 + (ieq/p[p_ISAT])**2)
            ph = Pp*thm/TP
            k0 = trap(ph)*fac
            k1 = trap(ph - 1/3.0)*fac
            k2 = trap(ph - 2/3.0)*fac
            if ecc:
                c = math.cos(thm)
                sn = math.sin(thm)
                # cos(th + a + phase) z_h + z_f cos(th + a), a = 2 pi q/3
                f0 = zf*c - zs*sn
                g0 = zf*sn + zs*c
                k0 *= 1 + f0
                k1 *= 1 - 0.5*f0 - 0.8660254037844386*g0
                k2 *= 1 - 0.5*f0 + 0.8660254037844386*g0
            k_[0] = k0
            k_[1] = k1
            k_[2] = k2
            t0 = k0*i[0] + k1*i[1] + k2*i[2]
            if short:
                t0 += k_[sq]*shf*(x2 - i[sq])
                for q in range(3):
                    u[q] = v[q] - k_[q]*wm*((1 - shf) if q == sq else 1.0)
                    x[q] = i[q]
                u[3] = -shf*k_[sq]*wm
                x[3] = x2
                for q in range(4):
                    y = 0.0
                    for j in range(4):
                        y += E[q, j]*x[j] + G[q, j]*u[j]
                    if q < 3:
                        im[q] = 0.5*(i[q] + y)
                        i[q] = y
                    else:
                        x2m = 0.5*(x2 + y)
                        x2 = y
                vn = 0.0
                for j in range(4):
                    vn += cA[j]*(im[j] if j < 3 else x2m) + cB[j]*u[j]
                t1 = k0*i[0] + k1*i[1] + k2*i[2] + k_[sq]*shf*(x2 - i[sq])
            else:
                vn = (v[0] - k0*wm + v[1] - k1*wm + v[2] - k2*wm)/3.0
                for q in range(3):
                    y = ea*i[q] + eb*(v[q] - k_[q]*wm - vn)
                    im[q] = 0.5*(i[q] + y)
                    i[q] = y
                t1 = k0*i[0] + k1*i[1] + k2*i[2]
            t0 = min(max(t0, -TMAX), TMAX)
            t1 = min(max(t1, -TMAX), TMAX)
            if sag:
                ii = 0.5*(s[0]*im[0] + s[1]*im[1] + s[2]*im[2])
                vf = VS - p[p_RS]*ii
                vn_dc = vf + (vdc - vf)*ex
                sm[7] += 0.5*(vdc + vn_dc)
                vdc = vn_dc
            else:
                sm[7] += vdc
            # ---- mechanics over the tick
            FS = FS0
            FD = FD0
            mpos = thl if two else th - th0
            ws_ = wl if two else w
            if anyfr:
                aw = abs(ws_)
                if p[p_PF_A] != 0.0:
                    f = 1 + p[p_PF_A]*math.cos(p[p_PF_N]*th + p[p_PF_PH])
                    FS *= f
                    FD *= f
                if p[p_TS_T] != 0.0:
                    d = abs(mpos - p[p_TS_C])/(0.833*p[p_TS_W])
                    if d < 2.0:
                        d = math.cos(0.25*math.pi*d)
                        FS += p[p_TS_T]*d*d
                        FD += p[p_TS_T]*d*d
                if p[p_STR_T] != 0.0:
                    FD += p[p_STR_T]*FSJ/(1 + (aw/p[p_STR_W])**p[p_STR_D])
                if p[p_LUB_T] != 0.0:
                    FD += p[p_LUB_T]*math.tanh(aw/p[p_LUB_W])
            if anyres:
                res = p[p_BIAS] + p[p_KSPR]*mpos + p[p_VASY]*abs(wm) + p[p_QUAD]*wm*abs(wm)
                if p[p_COG_A] != 0.0:
                    res += p[p_COG_A]*(math.cos(p[p_COG_N]*thm + p[p_COG_PH]) + 0.2*math.cos(2*p[p_COG_N]*thm + p[p_COG_PH2]))
                t0 -= res
                t1 -= res
            wo = w
            if two:
                dl = (th - th0) - thl
                g2 = 0.5*p[p_GAP]
                tc0 = contact(dl, w - wl, p[p_K2], p[p_D2], g2)
                tc1 = contact(dl + h*(w - wl), w - wl, p[p_K2], p[p_D2], g2)
                fr = p[p_FRROT]
                w, dth = slide(w, t0 - tc0, t1 - tc1, fr*FS, fr*FD, JR, C, h)
                th += dth
                wl, dth = slide(wl, tc0, tc1, (1 - fr)*FS, (1 - fr)*FD, JL, 0.0, h)
                thl += dth
            elif pre:
                # elasto-plastic bristle, midpoint
                K = p[p_PRE_K]
                g = FD + (FS - FD)*math.exp(-(w/2.0)**2)
                zss = g/K
                al = 0.0
                if w*zb > 0.0:
                    az = abs(zb)
                    if az >= zss:
                        al = 1.0
                    elif az > 0.6*zss:
                        al = 0.5*math.sin(math.pi*(az - 0.8*zss)/(0.4*zss)) + 0.5
                lam = al*abs(w)/zss
                if lam*h > 1e-12:
                    zi = w/lam
                    zn = zi + (zb - zi)*math.exp(-lam*h)
                else:
                    zn = zb + w*h
                ff = K*0.5*(zb + zn) + p[p_PRE_D]*math.exp(-(w/8.0)**2)*(zn - zb)/h
                zb = zn
                a_ = (0.5*(t0 + t1) - ff - C*w)/J
                a_ = (0.5*(t0 + t1) - ff - C*(w + 0.5*h*a_))/J
                wn = w + h*a_
                th += 0.5*h*(w + wn)
                w = wn
            else:
                w, dth = slide(w, t0, t1, FS, FD, J, C, h)
                th += dth
            acc = (w - wo)/h
            if w == 0.0:
                stuck += 1
            uu = (thl if two else th - th0)/NG
            if uu > 1.2 or uu < -1.2:
                lim_ = 1.2 if uu > 0 else -1.2
                if two:
                    thl = lim_*NG
                    if wl*lim_ > 0:
                        wl = 0.0
                else:
                    th = th0 + lim_*NG
                    if w*lim_ > 0:
                        w = 0.0
                uu = lim_
            if uu > thu + BL:
                thu = uu - BL
            elif uu < thu - BL:
                thu = uu + BL
            sm[0] += 0.5*(abs(i[0]) + abs(i[1]) + abs(i[2]))
            for q in range(3):
                sm[1 + q] += im[q]
                sm[4 + q] += v[q] - vn
            pcu += im[0]*im[0] + im[1]*im[1] + im[2]*im[2]
            n += 1
        inv = 1.0/nsub
        out[m, 0] = com
        out[m, 1] = th + (p[p_ENC_A]*math.sin(th + p[p_ENC_PH]) if enc else 0.0)
        out[m, 2] = w*(1 + p[p_ENC_A]*math.cos(th + p[p_ENC_PH])) if enc else w
        out[m, 3] = thu
        out[m, 4] = sm[0]*inv
        for q in range(3):
            out[m, 5 + q] = sm[1 + q]*inv
            out[m, 8 + q] = i[q]
            out[m, 11 + q] = sm[4 + q]*inv
        out[m, 14] = sm[7]*inv
        out[m, 15] = Tw
        out[m, 16] = th
        out[m, 17] = w
        out[m, 18] = stuck*inv
        if heat:
            ti = p[p_RTH]*(R*pcu*inv + p[p_PEXT])
            Tw = ti + (Tw - ti)*math.exp(-nsub*h/p[p_TAUTH])
            R = p[p_R]*(1 + 0.0039*Tw)
            KE = KE0*(1 - 0.0004*Tw)
            ea = math.exp(-R*h/L)
            eb = (1 - ea)/R


@njit(cache=False)
def contact(d, dv, K, D, g):
    if g == 0.0:
        return K*d + D*dv
    if d > g:
        return max(K*(d - g) + D*dv, 0.0)
    if d < -g:
        return min(K*(d + g) + D*dv, 0.0)
    return 0.0


# ---- commands ---------------------------------------------------------------------------------------------------------------
class Cmd:
    """a list of segments; add() continues from the last value unless value is given"""

    def __init__(self):
        self.rows, self.t, self.v = [], 0.0, 0.0

    def add(self, dur, slope=0.0, chirp=None, sines=(), value=None):
        r = np.zeros(NSEG)
        v0 = self.v if value is None else value
        off = sum(a*math.sin(ph) for a, f, ph in sines)
        r[0], r[1], r[2] = round(self.t/DT), v0 - off, slope
        r[6] = 1.0
        if chirp:
            r[3:7] = chirp
        r[7] = len(sines)
        for j, (a, f, ph) in enumerate(sines):
            r[8 + 3*j:11 + 3*j] = a, f, ph
        self.rows.append(r)
        self.t += dur
        k = round(self.t/DT)
        self.v = command(np.array([r]), 0, k)
        return self

    def table(self):
        return np.array(self.rows)

    def dense(self, n=4000):
        tab = self.table()
        o = np.empty(n)
        for j in range(n):
            k = int(j*self.t/DT/n)
            s = np.searchsorted(tab[:, 0], k, side="right") - 1
            o[j] = command(tab, s, k)
        return o


def preflight():
    c = Cmd()
    c.add(0.5, slope=0.001, value=0.0).add(0.35, value=0.0).add(1.0, sines=[(0.001, 5.0, 0.0)], value=0.0)
    c.add(0.35, value=0.0).add(0.8, value=1.0)
    return c


def go(c, speeds_durs, sgn, rng, lim=0.9):
    """staircase of speed in one direction, turned round where it would leave the stroke"""
    for sp, du in speeds_durs:
        sp *= rng.uniform(0.85, 1.15)*sgn
        if abs(c.v + sp*du) > lim:
            sp = -sp
        c.add(du, slope=sp)


def long_command(which, rng):
    """8 s as a test engineer would ask for; which = 1 staircases, creeps, chirp, dwells; 2 multisine, steps, other staircases"""
    for _ in range(100):
        c = Cmd()
        g = 1.0 if rng.random() < 0.5 else -1.0
        if which == 1:
            c.add(0.15)
            go(c, [(0.03, 0.30), (0.12, 0.30), (0.35, 0.35), (0.75, 0.35), (1.05, 0.30)], g, rng)
            c.add(0.20)
            go(c, [(1.05, 0.35), (0.6, 0.40), (0.3, 0.40), (0.15, 0.35), (0.05, 0.30), (0.9, 0.35), (0.45, 0.3)], -g, rng)
            c.add(0.15)
            cr = rng.uniform(0.006, 0.015)
            c.add(0.45, slope=cr*g).add(0.45, slope=-cr*g)
            f1 = rng.uniform(9, 14)
            c.add(1.6, chirp=(rng.uniform(0.008, 0.012), 0.8, f1, 1.6))
            c.add(0.10)
            go(c, [(0.5, 0.30), (0.2, 0.30), (0.02, 0.25)], g, rng)
            d = rng.uniform(0.35, 0.5)
            c.add(0.40, value=c.v + (d if c.v < 0 else -d))
            c.add(8.0 - c.t, value=c.v + (d if c.v < 0 else -d)*0.5)
        else:
            c.add(0.10)
            f0 = rng.uniform(0.40, 0.55)
            fr = [1, 2, 3, 5, 9]
            si = [(0.25*rng.uniform(0.8, 1.2)/n**1.15, f0*n, rng.uniform(0, TAU)) for n in fr]
            t = np.linspace(0, 2.4, 3000)
            y = sum(a*np.cos(TAU*f*t + ph)*TAU*f for a, f, ph in si)
            z = sum(a*(np.sin(TAU*f*t + ph) - math.sin(ph)) for a, f, ph in si)
            sc = min(rng.uniform(0.8, 1.1)/np.abs(y).max(), 0.8/np.abs(z).max())
            c.add(2.4, sines=[(a*sc, f, ph) for a, f, ph in si])
            c.add(0.10)
            cr = rng.uniform(0.004, 0.03)
            c.add(0.25, slope=-cr*g).add(0.25, slope=cr*g)
            d = g*rng.uniform(0.75, 0.88) - c.v          # to one end of the stroke at about 1 rad/s
            c.add(abs(d)/1.0, slope=math.copysign(1.0, d))
            c.add(0.10)
            go(c, [(1.0, 0.50), (0.6, 0.45), (0.9, 0.50), (0.3, 0.30), (0.1, 0.20), (0.02, 0.15)], -g, rng)
            c.add(0.45, value=c.v + (0.42 if c.v < 0 else -0.42)*rng.uniform(0.9, 1.1))
            c.add(0.50, sines=[(rng.uniform(0.001, 0.003), 2*round(rng.uniform(2, 4)), 0.0)])
            c.add(0.10)
            if c.t > 7.5:
                continue
            c.add(8.0 - c.t, chirp=(0.004, 2.0, rng.uniform(18, 30), 8.0 - c.t))
        y = c.dense()
        if np.abs(y).max() < 0.94 and min(y.max(), -y.min()) > 0.5 and max(y.max(), -y.min()) > 0.68 and abs(c.t - 8.0) < 1e-9:
            return c
    raise RuntimeError("no command within the stroke")


# ---- units ----------------------------------------------------------------------------------------------------------------------
def rng_of(*key):
    return np.random.default_rng(np.random.SeedSequence([int(k) & 0xffffffff for k in key]))


def base():
    p = np.zeros(NP)
    p[p_VS], p[p_R], p[p_L], p[p_KE], p[p_J], p[p_C] = 48.0, 1.065, 360e-6, 0.0376, 2.5e-5, 3e-5
    p[p_FS], p[p_FD], p[p_KT], p[p_FSJ] = 0.03, 0.021, 0.0752, 1.0
    p[p_G0:p_G0 + 3] = 1.0
    p[p_CDC] = 1e-3
    p[p_TAUTH] = p[p_STR_W] = p[p_LUB_W] = p[p_TS_W] = 1.0
    return p


def draw_constants(seed, K):
    g = rng_of(seed, K, 1)
    p = base()
    u = lambda a: 1 + g.uniform(-a, a)
    for i, a in ((p_J, .12), (p_C, .12), (p_FS, .12), (p_KE, .02), (p_R, .05), (p_L, .05), (p_VS, .01)):
        p[i] *= u(a)
    p[p_FD] = p[p_FS]*0.7*u(.05)
    return p


def draw_effect(seed, K, name, p):
    """sets the kernel parameters and returns the truth record"""
    g = rng_of(seed, K, 2, EFFECTS.index(name))
    U = g.uniform
    sg = 1.0 if g.random() < 0.5 else -1.0
    ph = float(U(0, TAU))
    e = {"name": name}
    if name == "stribeck":
        p[p_STR_T], p[p_STR_W], p[p_STR_D] = U(.6, 1.)*(p[p_FS] - p[p_FD]), U(10, 40), U(1.5, 2.5)
        e.update(torque=p[p_STR_T], speed=p[p_STR_W], exponent=p[p_STR_D], law="T/(1+(|w|/speed)^exponent)", scales_with_fsj=True)
    elif name == "lubricated_rise":
        p[p_LUB_T], p[p_LUB_W] = U(.006, .014), U(30, 120)
        e.update(torque=p[p_LUB_T], speed=p[p_LUB_W], law="T tanh(|w|/speed)")
    elif name == "quadratic_drag":
        p[p_QUAD] = U(4e-8, 1.2e-7)
        e.update(coefficient=p[p_QUAD])
    elif name == "viscous_asymmetry":
        p[p_VASY] = sg*U(.8e-5, 1.8e-5)
        e.update(coefficient=p[p_VASY])
    elif name == "bias_torque":
        p[p_BIAS] = sg*U(.003, .008)
        e.update(torque=p[p_BIAS], sign="resisting")
    elif name == "periodic_friction":
        p[p_PF_A], p[p_PF_N], p[p_PF_PH] = U(.25, .5), g.integers(1, 4), ph
        e.update(amplitude=p[p_PF_A]*p[p_FD], amplitude_static=p[p_PF_A]*p[p_FS], relative=p[p_PF_A], phase=ph, order=p[p_PF_N],
                 scales_with_fsj=True)
    elif name == "tight_spot":
        p[p_TS_T], p[p_TS_C], p[p_TS_W] = U(.01, .03), sg*U(75, 240), U(15, 50)
        e.update(torque=p[p_TS_T], centre=p[p_TS_C], width=p[p_TS_W], centre_from="rest angle (screw position)", law="Hann bump")
    elif name == "presliding":
        p[p_PRE_K] = U(.6, 3.0)
        p[p_PRE_D] = U(.4, 1.0)*math.sqrt(p[p_PRE_K]*p[p_J])
        e.update(stiffness=p[p_PRE_K], damping=p[p_PRE_D], law="elasto-plastic bristle")
    elif name == "cogging":
        p[p_COG_A], p[p_COG_N], p[p_COG_PH], p[p_COG_PH2] = U(.003, .008), g.choice([6, 12, 18, 24]), ph, U(0, TAU)
        e.update(amplitude=p[p_COG_A], phase=ph, order=p[p_COG_N], second=dict(amplitude=.2*p[p_COG_A], phase=p[p_COG_PH2], order=2*p[p_COG_N]),
                 sign="resisting, angle absolute")
    elif name == "torque_ripple":
        p[p_RIP_F], p[p_RIP_N], p[p_RIP_PH] = U(.05, .12), g.choice([4, 8, 12]), ph
        e.update(fraction=p[p_RIP_F], phase=ph, order=p[p_RIP_N])
    elif name == "eccentricity":
        z = U(.08, .25)
        p[p_ZHC], p[p_ZHS] = z*math.cos(ph), z*math.sin(ph)
        e.update(zeta=z, phase=ph, law="1 + zeta cos(th + 2 pi q/3 + phase)")
    elif name == "torque_saturation":
        p[p_ISAT] = U(12, 22)
        x = np.linspace(0, 20, 2001)
        b = float(np.sum(x**2*(1 - 1/np.sqrt(1 + (x/p[p_ISAT])**2)))/np.sum(x**3))
        e.update(coefficient=b, i_sat=p[p_ISAT], law="k/sqrt(1+(I/i_sat)^2), e.m.f. too")
    elif name == "spring_load":
        p[p_KSPR] = U(4e-5, 1e-4)
        e.update(stiffness=p[p_KSPR])
    elif name in ("compliance", "backlash"):
        p[p_TWO], p[p_FRROT], p[p_JL] = 1, .3, U(.25, .45)*p[p_J]
        jr = p[p_JL]*(p[p_J] - p[p_JL])/p[p_J]
        if name == "compliance":
            p[p_K2] = math.exp(U(math.log(10), math.log(40)))
            p[p_D2] = 2*U(.06, .2)*math.sqrt(p[p_K2]*jr)
            e.update(stiffness=p[p_K2], damping=p[p_D2], inertia=p[p_JL], rotor_inertia=p[p_J] - p[p_JL], friction_on_rotor=.3)
        else:
            p[p_K2], p[p_GAP] = 40.0, U(.03, .12)
            p[p_D2] = .3*math.sqrt(p[p_K2]*jr)
            e.update(gap=p[p_GAP], contact_stiffness=40.0, contact_damping=p[p_D2], inertia=p[p_JL], friction_on_rotor=.3,
                     gap_is="total free angle")
    elif name == "winding_heating":
        p[p_HEAT], p[p_T0], p[p_RTH], p[p_TAUTH] = 1, U(15, 30), U(2.5, 4), U(12, 25)
        p[p_PEXT] = U(70, 110)/p[p_RTH]
        e.update(start=p[p_T0], thermal_resistance=p[p_RTH], time_constant=p[p_TAUTH], heating_power=p[p_PEXT],
                 alpha_r=.0039, alpha_ke=-.0004)
    elif name == "supply_sag":
        p[p_RS], p[p_CDC] = U(.2, .6), U(.5e-3, 2e-3)
        e.update(resistance=p[p_RS], capacitor=p[p_CDC])
    elif name == "dead_time":
        p[p_VD] = U(.8, 2.0)
        e.update(voltage=p[p_VD], law="per leg, V asinh(i/5mA)/asinh(5A/5mA)")
    elif name == "turn_short":
        p[p_SHORT], p[p_SHF], p[p_SHP] = 1, U(.03, .06), g.integers(0, 3)
        e.update(fraction=p[p_SHF], phase=int(p[p_SHP]), contact_resistance=U(0, .5)*p[p_SHF]*p[p_R], coupling=.95)
    elif name == "commutation_offset":
        p[p_COMOFF] = sg*U(.10, .30)
        e.update(angle=p[p_COMOFF], angle_is="electrical, added to P th in the references")
    elif name == "encoder_eccentricity":
        p[p_ENC_A], p[p_ENC_PH] = U(.008, .03), ph
        e.update(amplitude=p[p_ENC_A], phase=ph, law="measured = th + A sin(th+phase); speed too; seen by the drive")
    elif name == "current_offset":
        q = int(g.integers(0, 3))
        p[p_OFF0 + q] = sg*U(.10, .25)
        e.update(current=p[p_OFF0 + q], phase_index=q, law="measured = i + current, drive and recording")
    elif name == "current_gain":
        gg = 1 + sg*U(.05, .12)
        q = int(g.integers(0, 3)) if g.random() < .5 else -1
        for j in range(3):
            if q in (-1, j):
                p[p_G0 + j] = gg
        e.update(gain=gg, phase_index="all" if q < 0 else q, law="measured = gain i, drive and recording")
    elif name == "control_delay":
        p[p_DELAY] = round(U(1.5e-4, 4.5e-4), 6)
        e.update(delay=p[p_DELAY], where="current reference")
    else:
        raise SystemExit("unknown effect " + name)
    return {k: (float(v) if isinstance(v, (np.floating, np.integer)) else v) for k, v in e.items()}


def short_matrices(p, eff):
    """circuit with a partly shorted phase: currents a, b, c, shorted turns; star point eliminated"""
    A, B, cA, cB = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    if eff is None or eff["name"] != "turn_short":
        return A, B, cA, cB
    f, q, R, L = p[p_SHF], int(p[p_SHP]), p[p_R], p[p_L]
    Lm, Rm = np.diag([L]*3 + [f*f*L]), np.diag([R]*3 + [f*R + eff["contact_resistance"]])
    Lm[q, q], Rm[q, q] = (1 - f)**2*L, (1 - f)*R
    Lm[q, 3] = Lm[3, q] = eff["coupling"]*f*(1 - f)*L
    # contact carries i2 - i_q: voltage across the shorted turns = -Rc (i2 - i_q), and it lies in series with the phase.
    # x[3] is the current in the shorted turns themselves
    rc = eff["contact_resistance"]
    Rm[3, 3] = f*R + rc
    Rm[3, q] = -rc
    Rm[q, q] += rc
    Rm[q, 3] -= rc
    M = np.zeros((5, 5))
    M[:4, :4] = Lm
    M[:3, 4] = 1
    M[4, :3] = 1
    Mi = np.linalg.inv(M)
    X, Y = Mi @ np.vstack([-Rm, np.zeros(4)]), Mi @ np.vstack([np.eye(4), np.zeros(4)])
    return np.ascontiguousarray(X[:4]), np.ascontiguousarray(Y[:4]), X[4].copy(), Y[4].copy()


def simulate(p, cmd, rate, eff=None):
    nsub = int(round(1/(rate*DT)))
    ns = int(round(cmd.t*rate))
    out = np.zeros((ns, 19))
    A, B, cA, cB = short_matrices(p, eff)
    run(p, cmd.table(), ns, nsub, A, B, cA, cB, out)
    return out


def draw_bench(seed, K):
    g = rng_of(seed, K, 3)
    c = lambda *a: a[int(g.integers(len(a)))]
    b = dict(rate_long=c(1000, 2000, 4000, 5000, 10000))
    b["rate_preflight"] = b["rate_long"] if g.random() < .5 else c(1000, 2000, 4000, 5000, 10000)
    b["channels"] = c("currents", "currents+v_dc", "currents+v_dc+voltages")
    b["current_sampling"] = c("mean", "mean", "point")
    b["current_bits"] = c(12, 13, 14, 16)
    b["current_noise"] = float(g.uniform(.004, .03))
    b["current_offset_max"] = float(g.uniform(.003, .03))
    b["resolver_bits"] = c(14, 15, 16)
    b["speed"] = c("own", "derived")
    b["speed_noise"] = float(g.uniform(.05, .4))
    b["speed_corner_hz"] = float(round(g.uniform(80, 250)))
    b["voltage_bits"], b["voltage_noise"] = c(13, 14, 16), float(g.uniform(.01, .08))
    b["vdc_bits"], b["vdc_noise"] = c(12, 13, 14), float(g.uniform(.005, .03))
    b["rest"] = c("fixed", "per recording")
    b["rest_angle"] = float(g.uniform(0, TAU))
    return b


def record(o, p, b, rate, g, path):
    n = len(o)
    t = np.arange(1, n + 1)/rate
    lsb = TAU/2**b["resolver_bits"]
    th0 = p[p_TH0] + p[p_ENC_A]*math.sin(p[p_TH0] + p[p_ENC_PH])
    q0 = np.round(th0/lsb)*lsb
    th = np.round(o[:, 1]/lsb)*lsb
    if b["speed"] == "own":
        w = o[:, 2] + g.normal(0, b["speed_noise"], n)
    else:
        d = np.diff(np.concatenate([[q0], th]))*rate
        a = 1 - math.exp(-TAU*b["speed_corner_hz"]/rate)
        w = np.empty(n)
        y = 0.0
        for j in range(n):
            y += a*(d[j] - y)
            w[j] = y
    raw = o[:, 5:8] if b["current_sampling"] == "mean" else o[:, 8:11]
    off = g.uniform(-1, 1, 3)*b["current_offset_max"]
    ci = raw*p[p_G0:p_G0 + 3] + p[p_OFF0:p_OFF0 + 3] + off + g.normal(0, b["current_noise"], (n, 3))
    il = 50/2**b["current_bits"]
    ci = np.clip(np.round(ci/il)*il, -25, 25 - il)
    cols = [t, o[:, 0], (th - q0)/GEAR, th, w, .5*np.abs(ci).sum(1), ci[:, 0], ci[:, 1], ci[:, 2]]
    head = "t,com,theta_u,theta_m,omega_m,i_eq,i_a,i_b,i_c"
    fmt = ["%.6f", "%.10g", "%.10g", "%.10g", "%.7g", "%.7g", "%.7g", "%.7g", "%.7g"]
    if "voltages" in b["channels"]:
        vl = 128/2**b["voltage_bits"]
        v = np.round((o[:, 11:14] + g.normal(0, b["voltage_noise"], (n, 3)))/vl)*vl
        cols += [v[:, 0], v[:, 1], v[:, 2]]
        head += ",v_a,v_b,v_c"
        fmt += ["%.7g"]*3
    if "v_dc" in b["channels"]:
        vl = 64/2**b["vdc_bits"]
        cols.append(np.round((o[:, 14] + g.normal(0, b["vdc_noise"], n))/vl)*vl)
        head += ",v_dc"
        fmt += ["%.7g"]
    np.savetxt(path, np.column_stack(cols) + 0.0, fmt=fmt, delimiter=",", header=head, comments="")
    return [float(x) for x in off]


def bench_toml(b):
    il, lsb = 50/2**b["current_bits"], TAU/2**b["resolver_bits"]
    s = ['# electromechanical actuator, pre-flight bench; healthy unit. supply 48 V nominal, drive torque constant 0.0752 N m/A',
         "# long recordings at %d Hz, pre-flight tests at %d Hz; t is the end of the sample, com the command of its last microsecond"
         % (b["rate_long"], b["rate_preflight"]),
         "# current sensors +-25 A; their zero may be off by up to 0.03 A, anew at every switching-on (each recording)",
         "# rest angle of the rotor: %s; theta_m is absolute, theta_u is theta_m from rest through the gear" % b["rest"]]
    if b["speed"] == "derived":
        s.append("# omega_m is the difference of successive resolver readings after a one-pole low-pass of %g Hz at the sampling rate; "
                 "delay_s is that of the long recordings" % b["speed_corner_hz"])
    s += ["[rig]", 'kind = "rotary"', 'drive = "current"', "gear_ratio = 500",
          'drive_constant = { value = 0.0752, unit = "N m/A", trust = 0.02 }',
          'inertia = { value = 2.5e-5, unit = "kg m2", trust = 0.10 }',
          'viscous = { value = 3e-5, unit = "N m s/rad", trust = 0.10 }',
          'coulomb = { value = 0.021, unit = "N m", trust = 0.10 }',
          "[channels]", 'time = { column = "t", unit = "s" }', 'command = { column = "com", unit = "rad" }',
          'position = { column = "theta_m", unit = "rad", sampling = "point", resolution = %.6g }' % lsb]
    if b["speed"] == "own":
        s.append('velocity = { column = "omega_m", unit = "rad/s", sampling = "point", noise = %.2g }' % b["speed_noise"])
    else:
        r = b["rate_long"]
        a = 1 - math.exp(-TAU*b["speed_corner_hz"]/r)
        s.append('velocity = { column = "omega_m", unit = "rad/s", sampling = "mean", delay_s = %.4g, noise = %.2g }'
                 % ((1/a - 1)/r, lsb*r/math.sqrt(6)*a/math.sqrt(2 - a)))
    for q in "abc":
        s.append('i_%s = { column = "i_%s", unit = "A", sampling = "%s", resolution = %.6g, noise = %.2g }'
                 % (q, q, b["current_sampling"], il, b["current_noise"]))
    if "voltages" in b["channels"]:
        for q in "abc":
            s.append('v_%s = { column = "v_%s", unit = "V", sampling = "mean", resolution = %.6g, noise = %.2g }'
                     % (q, q, 128/2**b["voltage_bits"], b["voltage_noise"]))
    if "v_dc" in b["channels"]:
        s.append('v_dc = { column = "v_dc", unit = "V", sampling = "mean", resolution = %.6g, noise = %.2g }'
                 % (64/2**b["vdc_bits"], b["vdc_noise"]))
    for f, r in (("healthy_long_1.csv", "fit"), ("healthy_long_2.csv", "heldout")):
        s += ["[[run]]", 'file = "%s"' % f, 'role = "%s"' % r, 'health = "healthy"']
    return "\n".join(s) + "\n"


def hidden_name(seed, K, effect):
    if effect == "none":
        return None
    if effect != "auto":
        return effect
    if K % 2 == 0:
        return None
    order = rng_of(seed, 77).permutation(len(EFFECTS))
    return EFFECTS[order[(K - 1)//2 % len(EFFECTS)]]


def make_unit(seed, K, tests, out, effect, long_only):
    d = os.path.join(out, "unit-%d" % K)
    os.makedirs(d, exist_ok=True)
    p0 = draw_constants(seed, K)
    b = draw_bench(seed, K)
    name = hidden_name(seed, K, effect)
    eff = draw_effect(seed, K, name, p0) if name else None
    files = [("healthy_long_1", 0, None), ("healthy_long_2", 1, None)]
    if not long_only:
        files += [("healthy_%d" % j, 10 + j, None) for j in range(3)] + [("fresh_%d" % j, 20 + j, None) for j in range(2)]
        for j in range(tests):
            g = rng_of(seed, K, 4, j)
            files.append(("test_%d" % j, 100 + j, (float(g.uniform(1.1, 4.5)), float(g.uniform(.02, .45)))))
    rest, offs, heat, tl = {}, {}, {}, []
    for f, tag, fault in files:
        p = p0.copy()
        g = rng_of(seed, K, 5, tag)
        r = g.uniform(0, TAU)
        p[p_TH0] = b["rest_angle"] if b["rest"] == "fixed" else r
        if fault:
            p[p_FSJ], p[p_ZF] = fault
            tl.append(list(fault))
        islong = tag < 10
        cmd = long_command(tag + 1, rng_of(seed, K, 6, tag)) if islong else preflight()
        rate = b["rate_long"] if islong else b["rate_preflight"]
        o = simulate(p, cmd, rate, eff)
        if not np.isfinite(o).all():
            raise RuntimeError("not finite: unit %d %s" % (K, f))
        offs[f + ".csv"] = record(o, p, b, rate, g, os.path.join(d, f + ".csv"))
        rest[f + ".csv"] = float(p[p_TH0])
        if name == "winding_heating":
            heat[f + ".csv"] = [float(o[0, 15]), float(o[:, 15].mean()), float(o[-1, 15])]
    if name == "winding_heating":
        eff["delta_t"] = float(np.mean([heat["healthy_long_%d.csv" % j][1] for j in (1, 2)]))
        eff["per_file_start_mean_end"] = heat
    with open(os.path.join(d, "bench.toml"), "w") as fh:
        fh.write(bench_toml(b))
    const = dict(j=p0[p_J], c=p0[p_C], fs0=p0[p_FS], fd0=p0[p_FD], ratio=p0[p_FD]/p0[p_FS], ke=p0[p_KE], r=p0[p_R], l=p0[p_L],
                 vs=p0[p_VS], ktc=p0[p_KT])
    with open(os.path.join(d, "truth.json"), "w") as fh:
        json.dump({"hidden": name, "effect": eff, "constants": {k: float(v) for k, v in const.items()}, "bench": b, "rest_angle": rest,
                   "current_sensor_offsets": offs, "tests": tl, "seed": seed, "unit": K}, fh, indent=1)
    return name


# ---- validation -------------------------------------------------------------------------------------------------------------------
TABLE = [(1, 0, .00022778, .00022778, 0, 4.079), (3, 0, .03686, .00022497, .55957, 15.19), (5, 0, .07415, .00041981, 1.1061, 24.78),
         (1, .3, .018782, .005007, .047767, 4.689), (3, .3, .053016, .0048019, .60846, 17.62), (5, .3, .087145, .0046011, 1.1879, 29.03),
         (1, .5, .050979, .0085198, .072774, 5.619), (5, .5, .11493, .007893, 1.2748, 32.58)]


def validate(ref):
    def one(fsj, z, cmd, rate):
        p = base()
        p[p_FSJ], p[p_ZF] = fsj, z
        return simulate(p, cmd, rate)
    step, sine, ramp = Cmd().add(.8, value=1.0), Cmd().add(1.0, sines=[(.001, 5., 0.)]), Cmd().add(.1, slope=.001)
    nom = one(1, 0, sine, 10000)[:, 4]
    print("fsj  zeta |  P1* ntb.md / mine / %%      | ripple* ntb.md / mine / %%   | P2* ntb.md / mine / %%     | P3* urad ntb.md / mine / %%")
    for fsj, z, *r in TABLE:
        o = one(fsj, z, step, 10000)
        u = o[2000:6500, 17]/GEAR
        p1, ri = math.sqrt(np.mean((u - 1.23872)**2)), u.std()
        i = one(fsj, z, sine, 10000)[:, 4]
        p2 = math.sqrt(np.mean((i - nom)**2))
        o = one(fsj, z, ramp, 100000)
        k = np.argmax(o[:, 17] != 0.0)
        p3 = o[k, 0]*1e6
        m = [p1, ri, p2, p3]
        print("%3g %5g | " % (fsj, z) + " | ".join("%10.6g %10.6g %+7.3f" % (a, c, 100*(c/a - 1) if a else 0) for a, c in zip(r, m)),
              "  mean %.6f" % u.mean() if fsj == 1 and z == 0 else "")
    if ref:
        for f, fsj, z, c in (("preflight_fsj1_zeta0", 1, 0, preflight()), ("preflight_fsj3_zeta0.3", 3, .3, preflight()),
                             ("preflight_fsj3_zeta0.3_10kHz", 3, .3, preflight()), ("sine_fsj2_zeta0.2", 2, .2, sine)):
            d = np.genfromtxt(os.path.join(ref, f + ".csv"), delimiter=",", names=True)
            rate = round(1/(d["t"][1] - d["t"][0]))
            o = one(fsj, z, c, rate)
            print(f, "relative rms distance:", *("%s %.2e" % (n, np.sqrt(np.mean((d[n] - y)**2)/np.mean(d[n]**2))) for n, y in
                  (("com", o[:, 0]), ("theta_u", o[:, 3]), ("theta_m", o[:, 16]), ("omega_m", o[:, 17]), ("i_eq", o[:, 4]), ("i_a", o[:, 5]))))


if __name__ == "__main__":
    ap = argparse.ArgumentParser()
    ap.add_argument("--seed", type=int, default=1)
    ap.add_argument("--units", type=int, default=1)
    ap.add_argument("--first", type=int, default=0)
    ap.add_argument("--tests", type=int, default=6)
    ap.add_argument("--out", default="out")
    ap.add_argument("--effect", default="auto")
    ap.add_argument("--long-only", action="store_true")
    ap.add_argument("--validate", action="store_true")
    ap.add_argument("--ref", default=None)
    a = ap.parse_args()
    if a.effect not in ("auto", "none") and a.effect not in EFFECTS:
        sys.exit("--effect: auto, none or one of " + " ".join(EFFECTS))
    if a.validate:
        validate(a.ref)
        sys.exit(0)
    for K in range(a.first, a.first + a.units):
        t = time.time()
        nm = make_unit(a.seed, K, a.tests, a.out, a.effect, a.long_only)
        print("unit-%d done, %.1f s" % (K, time.time() - t), flush=True)
