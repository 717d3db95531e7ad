//! Names, parameter keys, units, physical bounds and laws of the effects.

use super::law::{self, LawKey};

/// Equation of the actuator in which an effect appears first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Equation {
    /// `kt i = J dw/dt + C w + friction + load + effects`
    Torque,
    /// `v = R i + L di/dt + ke w + effects`
    Electrical,
    /// `theta_u = theta_m / N + effects`
    Transmission,
    /// `w = d theta_m/dt + effects`: two sensors of one motion
    Kinematic,
    /// `u = law(command, position, speed)`
    Controller,
}

impl Equation {
    /// All, in the order of [`Equation::index`].
    pub const ALL: [Self; 5] = [
        Self::Torque,
        Self::Electrical,
        Self::Transmission,
        Self::Kinematic,
        Self::Controller,
    ];

    /// Its place in [`Equation::ALL`].
    pub fn index(self) -> usize {
        self as usize
    }

    /// In files and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Torque => "torque",
            Self::Electrical => "electrical",
            Self::Transmission => "transmission",
            Self::Kinematic => "kinematic",
            Self::Controller => "controller",
        }
    }

    /// Unit of its residual.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Torque => "N m",
            Self::Electrical => "V",
            Self::Transmission => "rad",
            Self::Kinematic => "rad/s",
            Self::Controller => "drive unit",
        }
    }
}

/// A parameter of an effect.
#[derive(Debug, PartialEq)]
pub struct ParameterKey {
    /// in files
    pub name: &'static str,
    /// SI; `-` for a ratio
    pub unit: &'static str,
    /// least value that physics allows, enforced wherever a value enters
    pub low: f64,
    /// greatest value that physics allows
    pub high: f64,
}

const INF: f64 = f64::INFINITY;
const TURN: f64 = std::f64::consts::TAU;

macro_rules! effects {
    ($($(#[$doc:meta])* $variant:ident $name:literal $equation:ident
        [$($key:literal $unit:literal $low:expr, $high:expr);*] $(=> $law:ident)?)+) => {
        /// Every effect that the project knows, after the candidates of the discrepancy method.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub enum EffectKind { $($(#[$doc])* $variant),+ }

        impl EffectKind {
            /// All, in the order of the table.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// Canonical name, as in files.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),+ }
            }

            /// The equation where it appears first.
            pub fn equation(self) -> Equation {
                match self { $(Self::$variant => Equation::$equation),+ }
            }

            /// The key that says which law it follows; none for kinds of one law.
            pub fn law_key(self) -> Option<&'static LawKey> {
                match self { $(Self::$variant => [$(&law::$law)?].first().copied()),+ }
            }

            /// Pairs of its parameters, as [`super::Effect::correlation`] has them.
            pub fn pairs(self) -> usize {
                let n = self.keys().len();
                n * (n - 1) / 2
            }

            /// One to three parameters.
            pub fn keys(self) -> &'static [ParameterKey] {
                match self {
                    $(Self::$variant => {
                        const KEYS: &[ParameterKey] =
                            &[$(ParameterKey { name: $key, unit: $unit, low: $low, high: $high }),*];
                        KEYS
                    }),+
                }
            }
        }
    };
}

effects! {
    /// `Ts exp(-(|w|/ws)^d) sgn w`: friction falls with speed (Armstrong-Helouvry 1991).
    Stribeck "stribeck" Torque ["torque" "N m" 0.0, INF; "speed" "rad/s" 1e-9, INF; "exponent" "-" 0.5, 3.0]
    /// `F (1 - exp(-|w|/w0)) sgn w`: friction rises with speed to a plateau.
    LubricatedRise "lubricated_rise" Torque ["torque" "N m" 0.0, INF; "speed" "rad/s" 1e-9, INF]
    /// `c w |w|`: churning, windage.
    QuadraticDrag "quadratic_drag" Torque ["coefficient" "N m s2/rad2" 0.0, INF]
    /// `c |w|`: another viscous coefficient in each direction.
    ViscousAsymmetry "viscous_asymmetry" Torque ["coefficient" "N m s/rad" -INF, INF]
    /// `T0`, alias Coulomb friction that differs by direction.
    BiasTorque "bias_torque" Torque ["torque" "N m" -INF, INF]
    /// `mu |T_load| sgn w`.
    LoadDependentFriction "load_dependent_friction" Torque ["coefficient" "-" 0.0, INF]
    /// `a (T - 20 degC)` times the nominal friction.
    TemperatureDependentFriction "temperature_dependent_friction" Torque ["coefficient" "1/K" -INF, 0.0]
    /// `A cos(n theta + phi) sgn w`.
    PeriodicFriction "periodic_friction" Torque ["amplitude" "N m" 0.0, INF; "phase" "rad" -TURN, TURN; "order" "1/turn" 1e-9, 1000.0]
    /// `T exp(-((theta - c)/s)^2) sgn w`.
    TightSpot "tight_spot" Torque ["torque" "N m" 0.0, INF; "centre" "rad" -INF, INF; "width" "rad" 1e-9, INF]
    /// Dahl friction (1968) in place of Coulomb's, with a damping of the bristles (LuGre, Canudas de Wit 1995), and
    /// a break-away of its own or none.
    Presliding "presliding" Torque ["stiffness" "N m/rad" 1e-9, INF; "damping" "N m s/rad" 0.0, INF] => BREAKS_AWAY
    /// `A cos(n theta + phi)`.
    Cogging "cogging" Torque ["amplitude" "N m" 0.0, INF; "phase" "rad" -TURN, TURN; "order" "1/turn" 1e-9, 1000.0]
    /// `kt (1 + z cos(n theta + phi))`, in torque and back-EMF.
    TorqueRipple "torque_ripple" Torque ["fraction" "-" 0.0, 1.0; "phase" "rad" -TURN, TURN; "order" "1/turn" 1e-9, 1000.0]
    /// Static eccentricity, Eq. 5 of the paper, per phase, in torque and back-EMF.
    Eccentricity "eccentricity" Torque ["zeta" "-" 0.0, 1.0; "phase" "rad" -TURN, TURN]
    /// `kt i (1 - beta |i|)`; or `kt i (1 - (beta i)^2)`; or `kt i/sqrt(1 + (beta i)^2)`, and so the back-EMF.
    TorqueSaturation "torque_saturation" Torque ["coefficient" "1/A" 0.0, INF] => SATURATES
    /// `k theta`, from the rest angle.
    SpringLoad "spring_load" Torque ["stiffness" "N m/rad" 0.0, INF]
    /// Two masses and a spring; the total inertia stays.
    Compliance "compliance" Torque ["stiffness" "N m/rad" 1e-9, INF; "damping" "N m s/rad" 0.0, INF; "inertia" "kg m2" 0.0, INF]
    /// Play of full width `gap` between motor and user.
    Backlash "backlash" Transmission ["gap" "rad" 0.0, INF]
    /// `R a (T - T0)`: a winding warmer by delta_t.
    WindingHeating "winding_heating" Electrical ["delta_t" "K" 0.0, 300.0]
    /// The source gives `Vs - Rs i_s`.
    SupplySag "supply_sag" Electrical ["resistance" "ohm" 0.0, INF] => DRAW
    /// `Vd sgn i`, smoothed: dead time and diodes of the bridge.
    DeadTime "dead_time" Electrical ["voltage" "V" 0.0, INF]
    /// A fraction of one phase's turns is shorted: its R, L and ke are smaller.
    TurnShort "turn_short" Electrical ["fraction" "-" 0.0, 1.0; "phase" "-" 0.0, 2.0] => TURNS
    /// The electrical angle of the commutation is off.
    CommutationOffset "commutation_offset" Torque ["angle" "rad" -1.6, 1.6]
    /// The measured angle is `theta + eps sin(theta + phi)`.
    EncoderEccentricity "encoder_eccentricity" Kinematic ["amplitude" "rad" 0.0, 1.0; "phase" "rad" -TURN, TURN] => READS
    /// The measured current is `i + i0`.
    CurrentOffset "current_offset" Electrical ["current" "A" -INF, INF] => SENSOR
    /// The measured current is `(1 + g) i`.
    CurrentGain "current_gain" Electrical ["gain" "-" -0.9, 9.0] => SENSOR
    /// The controller's output comes late.
    ControlDelay "control_delay" Controller ["delay" "s" 0.0, 1.0]
}

impl EffectKind {
    /// The effect of a canonical name; none for any other.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|k| k.name() == name)
    }

    /// Whether it is a level of friction, added to FS and FD.
    pub fn is_friction(self) -> bool {
        matches!(
            self,
            Self::Stribeck
                | Self::LubricatedRise
                | Self::LoadDependentFriction
                | Self::TemperatureDependentFriction
                | Self::PeriodicFriction
                | Self::TightSpot
        )
    }

    /// Whether its angle, `phase`, is taken modulo a turn.
    pub fn is_periodic(self) -> bool {
        matches!(
            self,
            Self::PeriodicFriction
                | Self::Cogging
                | Self::TorqueRipple
                | Self::Eccentricity
                | Self::EncoderEccentricity
        )
    }
}
