//! Units that headers and bench files may use, as factors to SI.

/// What a channel or constant measures; linear quantities are brought to the motor's side by the lead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// s
    Time,
    /// rad
    Angle,
    /// rad/s
    Speed,
    /// A
    Current,
    /// V
    Voltage,
    /// N m
    Torque,
    /// degrees Celsius
    Temperature,
    /// drive unit to torque
    DriveConstant,
    /// kg m2
    Inertia,
    /// N m s/rad
    Viscous,
    /// ohm
    Resistance,
    /// H
    Inductance,
    /// V s/rad
    BackEmf,
    /// a number without unit
    None,
}

impl Quantity {
    const ALL: [Self; 14] = [
        Self::Time,
        Self::Angle,
        Self::Speed,
        Self::Current,
        Self::Voltage,
        Self::Torque,
        Self::Temperature,
        Self::DriveConstant,
        Self::Inertia,
        Self::Viscous,
        Self::Resistance,
        Self::Inductance,
        Self::BackEmf,
        Self::None,
    ];
}

/// Factor to SI and powers of the lead [m/rad] that a linear unit takes to become one of rotation.
struct Unit {
    names: &'static [&'static str],
    factor: f64,
    lead: i32,
}

const fn unit(names: &'static [&'static str], factor: f64, lead: i32) -> Unit {
    Unit { names, factor, lead }
}

const TURN: f64 = std::f64::consts::TAU;

fn units(q: Quantity) -> &'static [Unit] {
    const TIME: &[Unit] = &[
        unit(&["s", "sec", "seconds"], 1.0, 0),
        unit(&["ms"], 1e-3, 0),
        unit(&["us", "µs", "μs"], 1e-6, 0),
        unit(&["ns"], 1e-9, 0),
    ];
    const ANGLE: &[Unit] = &[
        unit(&["rad"], 1.0, 0),
        unit(&["mrad"], 1e-3, 0),
        unit(&["deg", "°", "degree", "degrees"], TURN / 360.0, 0),
        unit(&["turn", "rev", "turns"], TURN, 0),
        unit(&["m"], 1.0, -1),
        unit(&["mm"], 1e-3, -1),
        unit(&["um"], 1e-6, -1),
    ];
    const SPEED: &[Unit] = &[
        unit(&["rad/s", "rad/sec", "rad s-1"], 1.0, 0),
        unit(&["deg/s", "°/s"], TURN / 360.0, 0),
        unit(
            &["rpm", "1/min", "min-1", "min^-1", "U/min", "rev/min", "r/min"],
            TURN / 60.0,
            0,
        ),
        unit(&["m/s"], 1.0, -1),
        unit(&["mm/s"], 1e-3, -1),
    ];
    const CURRENT: &[Unit] = &[unit(&["A"], 1.0, 0), unit(&["mA"], 1e-3, 0)];
    const VOLTAGE: &[Unit] = &[unit(&["V"], 1.0, 0), unit(&["mV"], 1e-3, 0)];
    const TORQUE: &[Unit] = &[
        unit(&["N m", "Nm"], 1.0, 0),
        unit(&["mN m", "mNm"], 1e-3, 0),
        unit(&["N"], 1.0, 1),
        unit(&["kN"], 1e3, 1),
    ];
    const TEMPERATURE: &[Unit] = &[unit(&["degC", "C", "°C"], 1.0, 0)];
    const DRIVE: &[Unit] = &[
        unit(&["N m/A", "Nm/A", "N m/V", "Nm/V", "N m/N m", "-"], 1.0, 0),
        unit(&["mN m/A", "mNm/A"], 1e-3, 0),
        unit(&["N/A", "N/V"], 1.0, 1),
    ];
    const INERTIA: &[Unit] = &[
        unit(&["kg m2", "kg m^2", "kgm2"], 1.0, 0),
        unit(&["g cm2"], 1e-7, 0),
        unit(&["kg"], 1.0, 2),
    ];
    const VISCOUS: &[Unit] = &[
        unit(&["N m s/rad", "N m s", "Nms", "Nms/rad"], 1.0, 0),
        unit(&["N/(m/s)", "N s/m"], 1.0, 2),
    ];
    const RESISTANCE: &[Unit] = &[unit(&["ohm", "Ohm"], 1.0, 0)];
    const INDUCTANCE: &[Unit] = &[unit(&["H"], 1.0, 0), unit(&["mH"], 1e-3, 0)];
    const BACK_EMF: &[Unit] = &[unit(&["V s/rad", "Vs/rad", "V s", "N m/A"], 1.0, 0)];
    const NONE: &[Unit] = &[unit(&["-", ""], 1.0, 0)];
    match q {
        Quantity::Time => TIME,
        Quantity::Angle => ANGLE,
        Quantity::Speed => SPEED,
        Quantity::Current => CURRENT,
        Quantity::Voltage => VOLTAGE,
        Quantity::Torque => TORQUE,
        Quantity::Temperature => TEMPERATURE,
        Quantity::DriveConstant => DRIVE,
        Quantity::Inertia => INERTIA,
        Quantity::Viscous => VISCOUS,
        Quantity::Resistance => RESISTANCE,
        Quantity::Inductance => INDUCTANCE,
        Quantity::BackEmf => BACK_EMF,
        Quantity::None => NONE,
    }
}

impl Quantity {
    /// Factor from `name` to SI at the motor, or the names allowed.
    ///
    /// * `lead` metres in a radian of the motor, for linear rigs
    ///
    /// # Errors
    /// The names of the units that this can have, of a unit that it cannot.
    pub fn factor(self, name: &str, lead: Option<f64>) -> Result<f64, String> {
        let usable = |u: &&Unit| u.lead == 0 || lead.is_some();
        let all = || units(self).iter().filter(usable);
        match all().find(|u| u.names.contains(&name)) {
            Some(u) => Ok(u.factor * lead.unwrap_or(1.0).powi(u.lead)),
            None => Err(all().flat_map(|u| u.names).copied().collect::<Vec<_>>().join(", ")),
        }
    }

    /// The unit at the motor.
    pub fn si(self) -> &'static str {
        units(self)[0].names[0]
    }
}

/// All names of the units of a quantity, linear ones too.
pub(crate) fn names(q: Quantity) -> impl Iterator<Item = &'static str> {
    units(q).iter().flat_map(|u| u.names).copied()
}

/// Whether anything is measured in it.
pub(crate) fn is_known(unit: &str) -> bool {
    !unit.is_empty() && Quantity::ALL.iter().any(|&q| names(q).any(|n| n == unit))
}

/// Factor from a unit that a header states to SI, in any case of letters where that leaves one unit. Of a quantity of
/// rotation.
///
/// # Errors
/// The names of the units that this can have.
pub fn stated(q: Quantity, unit: &str) -> Result<f64, String> {
    q.factor(unit, None).or_else(|allowed| {
        let is_it = |u: &&Unit| u.lead == 0 && u.names.iter().any(|n| n.eq_ignore_ascii_case(unit));
        match units(q).iter().filter(is_it).collect::<Vec<_>>()[..] {
            [one] => Ok(one.factor),
            _ => Err(allowed),
        }
    })
}
