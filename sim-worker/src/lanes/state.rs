//! What the kernel reads and changes: constants, state and sums of all lanes, and the units it counts in.

use crate::effect::EffectKind;
use crate::parameters::ActuatorParameters;
use crate::trig;
use schemas::fault::FaultState;

macro_rules! lane_struct {
    ($(#[$doc:meta])* $name:ident { $($(#[$fdoc:meta])* $field:ident),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug)]
        #[repr(C, align(64))]
        pub struct $name<const N: usize> { $($(#[$fdoc])* pub $field: [f64; N]),+ }
        impl<const N: usize> Default for $name<N> {
            fn default() -> Self { Self { $($field: [0.0; N]),+ } }
        }
        impl<const N: usize> $name<N> {
            /// Shows every number to `see`, which may change it; always in the same order.
            pub fn each(&mut self, see: &mut dyn FnMut(&mut f64)) {
                $(self.$field.iter_mut().for_each(&mut *see);)+
            }

            /// Adds every number of another.
            pub fn add(&mut self, other: &Self) {
                $(self.$field.iter_mut().zip(&other.$field).for_each(|(x, o)| *x += o);)+
            }
        }
    };
}

/// Units of the kernel: angles in motor rad, speeds in rad per step (`w dt`), currents times
/// `dt sqrt(L/J)`, so that half the square of either is an energy in the same unit. The one
/// coefficient `k/sqrt(L J) dt` then serves both Eq. 6 (times a speed: the current that the
/// back-EMF takes off in a step) and Eq. 7 (times a current: the speed that the torque adds).
#[derive(Clone, Copy, Debug)]
pub struct Units {
    /// one A
    pub ampere: f64,
    /// one V, as the current that it adds to a phase in a step
    pub volt: f64,
    /// one N m, as the speed that it adds in a step
    pub newton_metre: f64,
    /// one rad/s
    pub rad_per_s: f64,
    /// one V s/rad, equal to one N m/A
    pub volt_second: f64,
}

impl Units {
    /// Of an actuator: its step, L and J.
    pub fn new(p: &ActuatorParameters) -> Self {
        let dt = p.step_s;
        let ampere = dt * (p.phase_inductance_h / p.inertia_kg_m2).sqrt();
        Self {
            ampere,
            volt: ampere * dt / p.phase_inductance_h,
            newton_metre: dt * dt / p.inertia_kg_m2,
            rad_per_s: dt,
            volt_second: dt / (p.phase_inductance_h * p.inertia_kg_m2).sqrt(),
        }
    }
}

lane_struct!(
    /// Constants of each lane, in [`Units`].
    Constants {
        /// `GAP/N`
        gap,
        /// lower limit of the speed reference, `-Wmax`
        w_min,
        /// upper limit of the speed reference, `Wmax`
        w_max,
        /// `Kp/kt`
        kp,
        /// `Ki dt/kt`
        ki_dt,
        /// lower limit of the current reference, `-Imax`
        i_min,
        /// upper limit of the current reference, `Imax`
        i_max,
        /// lower limit of the integrator, `-Tint/kt`
        x_min,
        /// upper limit of the integrator, `Tint/kt`
        x_max,
        /// units of 30 electrical degrees in a rad of the rotor
        flanks,
        /// `ke`
        ke,
        /// `ke zeta` (0 for one pole pair, Eq. 5)
        ke_zeta,
        /// half-band HB of the relays
        hb,
        /// `Vs/2`
        volts,
        /// `1 - R dt/L`
        decay,
        /// least motor torque, `-Tmax`
        t_min,
        /// greatest motor torque, `Tmax`
        t_max,
        /// C
        viscous,
        /// static dry friction, FSJ times the nominal
        fs,
        /// dynamic dry friction
        fd,
        /// gear ratio N
        n,
        /// backlash half-width times N
        gap_half,
        /// end stop, displacement from rest times N
        stop,
        /// load torque TR, positive against positive motion
        load,
        /// `1/eta_o - 1`, see [`friction::with_load`]
        opposing,
        /// `1 - eta_a`
        aiding,
        /// rotor angle at rest [rad]
        th0,
        /// `ke zeta` of eccentricity a quarter of a turn ahead of the fault's
        ke_ahead,
    }
);

lane_struct!(
    /// State of each lane, in [`Units`].
    State {
        /// current of phase 0
        ia,
        /// current of phase 1; that of phase 2 is minus the sum of both
        ib,
        /// state of relay 0, plus or minus HB, less the current of its phase
        ma,
        /// of relay 1 likewise
        mb,
        /// of relay 2 likewise
        mc,
        /// motor speed
        turn,
        /// motor angle from rest [rad]
        th,
        /// angle moved in the last step [rad]: the speed, but for the end stops. `r`, `c`, `b` are
        /// of the angle before it.
        moved,
        /// electrical angle less 90 degrees, wrapped at each resync [30 degrees]
        r,
        /// integrator I/kt
        x,
        /// user angle times N
        th_u,
        /// eccentricity vector, the part with the angle's cosine, see [`back_emf::gains`]
        c,
        /// eccentricity vector, the part with the angle's sine
        b,
    }
);

lane_struct!(
    /// Sums over the steps of a telemetry interval, in [`Units`].
    Sums {
        /// current of phase 0, as measured
        ia,
        /// current of phase 1, as measured
        ib,
        /// sizes of all three phase currents: twice the equivalent current (Eq. 4)
        abs,
        /// voltage of phase 0 against the star point
        va,
        /// voltage of phase 1 against the star point
        vb,
        /// voltage of phase 2 against the star point
        vc,
        /// measured current of the third phase, with effects
        ic,
        /// supply current of the bridge
        supply,
        /// motor torque (Eq. 7)
        torque,
        /// half the sum of phase currents times normalised back-EMF shapes
        iq,
    }
);

impl<const N: usize> Constants<N> {
    /// Writes lane `l` for an actuator with faults, resting at `rest_angle_rad`, under a constant load torque.
    pub fn set(&mut self, l: usize, p: &ActuatorParameters, f: FaultState, rest_angle_rad: f64, load_n_m: f64) {
        let u = Units::new(p);
        let kt = p.drive_constant();
        let flanks = 6.0 * p.pole_pairs as f64 / std::f64::consts::PI;
        let fs = f.fsj * p.static_friction_n_m;
        // the effects that are constants; adding 0 or multiplying by 1 changes no bit
        let (mut zeta, mut ahead) = (if p.pole_pairs > 1 { f.zeta } else { 0.0 }, 0.0);
        let (mut resistance, mut play) = (p.phase_resistance_ohm, 0.0);
        for e in p.effects.iter().filter(|e| e.is_present()) {
            resistance *= e.resistance_factor();
            match e.kind {
                EffectKind::Eccentricity => {
                    let (sin, cos) = trig::sin_cos(e.values[1]);
                    zeta += e.values[0] * cos;
                    ahead += e.values[0] * sin;
                }
                EffectKind::Backlash => play += 0.5 * e.values[0],
                _ => {}
            }
        }
        self.gap[l] = p.position_gain_per_s / p.gear_ratio * u.rad_per_s;
        self.w_max[l] = p.speed_reference_limit_rad_per_s * u.rad_per_s;
        self.w_min[l] = -self.w_max[l];
        self.kp[l] = p.speed_proportional_n_m_s_per_rad / kt * u.ampere / u.rad_per_s;
        self.ki_dt[l] = p.speed_integral_n_m_per_rad / kt * p.step_s * u.ampere / u.rad_per_s;
        self.i_max[l] = p.current_limit_a * u.ampere;
        self.i_min[l] = -self.i_max[l];
        self.x_max[l] = p.integrator_limit_n_m / kt * u.ampere;
        self.x_min[l] = -self.x_max[l];
        self.flanks[l] = flanks;
        self.ke[l] = p.back_emf_v_s_per_rad * u.volt_second;
        self.ke_zeta[l] = self.ke[l] * zeta;
        self.ke_ahead[l] = self.ke[l] * ahead;
        self.hb[l] = p.hysteresis_half_band_a * u.ampere;
        self.volts[l] = 0.5 * p.supply_voltage_v * u.volt;
        self.decay[l] = 1.0 - resistance * p.step_s / p.phase_inductance_h;
        self.t_max[l] = p.torque_limit_n_m * u.newton_metre;
        self.t_min[l] = -self.t_max[l];
        self.viscous[l] = p.viscous_n_m_s_per_rad * u.newton_metre / u.rad_per_s;
        self.fs[l] = fs * u.newton_metre;
        self.fd[l] = fs * p.dynamic_friction_ratio * u.newton_metre;
        self.n[l] = p.gear_ratio;
        self.gap_half[l] = p.backlash_half_width_rad * p.gear_ratio + play;
        self.stop[l] = p.end_stop_rad * p.gear_ratio;
        self.load[l] = load_n_m * u.newton_metre;
        self.opposing[l] = 1.0 / p.opposing_efficiency - 1.0;
        self.aiding[l] = 1.0 - p.aiding_efficiency;
        self.th0[l] = rest_angle_rad;
    }
}

lane_struct!(
    /// What the stages of one step hand on: current reference, folded angles, back-EMF
    /// coefficients, angle moved.
    Handed {
        /// current reference of the speed loop
        i_ref,
        /// folded electrical angle of phase 0 [30 degrees], see [`back_emf::fold`]
        f0,
        /// of phase 1
        f1,
        /// of phase 2
        f2,
        /// back-EMF coefficient of phase 0 (Eq. 5)
        k0,
        /// of phase 1
        k1,
        /// of phase 2
        k2,
    }
);
