//! One instance of the FMU: what a master may do when, and what it gets; no C here.

use crate::description::identifier;
use crate::variables::{INPUTS, Role, Variable, guid, variables};
use schemas::error::{Error, Result};
use schemas::fault::FaultState;
use schemas::sequence::TestSequence;
use sim_worker::command::CommandTrack;
use sim_worker::driven::DrivenBench;
use sim_worker::parameters::ActuatorParameters;
use sim_worker::test_bench::Lane;
use std::sync::Arc;

/// Longest communication step [s]: nobody can stop one.
const LONGEST_S: f64 = 3600.0;

/// Share of a step by which a communication point may miss one and still count as on it.
const ON_STEP: f64 = 1e-3;

/// Steps whose commands are worked out at once.
const CHUNK: u64 = 1024;

/// First bytes of a state in bytes; the last is its version.
const MAGIC: &[u8; 8] = b"EMA-FMU1";

/// Where an instance is in the standard's state machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// made or reset: start values may be set
    Instantiated,
    /// between fmi2EnterInitializationMode and fmi2ExitInitializationMode
    Initializing,
    /// steps may be made
    Running,
    /// after fmi2Terminate: values may be read
    Terminated,
    /// a step gave values that are no numbers: values may be read
    Failed,
}

impl Phase {
    const ALL: [Self; 5] = [
        Self::Instantiated,
        Self::Initializing,
        Self::Running,
        Self::Terminated,
        Self::Failed,
    ];

    fn words(self) -> &'static str {
        match self {
            Self::Instantiated => "instantiated",
            Self::Initializing => "initialization mode",
            Self::Running => "step mode",
            Self::Terminated => "terminated",
            Self::Failed => "failed",
        }
    }
}

/// All that changes in an instance: what fmi2GetFMUstate keeps.
#[derive(Clone)]
pub struct Moment {
    phase: Phase,
    /// by value reference; those of outputs are not used
    values: Vec<f64>,
    /// first and second derivative of each input, for the next step
    derivatives: [[f64; 2]; INPUTS],
    start_s: f64,
    /// infinite where no end is said
    stop_s: f64,
    time_s: f64,
    /// whether it was said that steps are no whole number of the simulator's
    warned: bool,
    bench: Option<DrivenBench>,
}

/// An instance.
pub struct Instance {
    actuator: Arc<ActuatorParameters>,
    variables: Vec<Variable>,
    sequences: Vec<TestSequence>,
    now: Moment,
    commands: Vec<f64>,
}

/// An input over one communication step.
#[derive(Clone, Copy)]
struct Course {
    value: f64,
    derivatives: [f64; 2],
}

impl Course {
    fn is_held(self) -> bool {
        self.derivatives == [0.0; 2]
    }

    /// * `t` since the communication point [s]
    fn at(self, t: f64) -> f64 {
        if self.is_held() {
            self.value
        } else {
            self.value + t * (self.derivatives[0] + 0.5 * t * self.derivatives[1])
        }
    }
}

impl Instance {
    /// An instance with all start values.
    ///
    /// * `expected` the guid that the master read in the description
    ///
    /// # Errors
    /// The guid of another actuator or version.
    pub fn new(actuator: ActuatorParameters, expected: &str) -> Result<Self> {
        let own = guid(&actuator);
        if own != expected {
            let allowed = format!("{own}, of resources/actuator.toml and this library");
            return Err(Error::bad(identifier(&actuator), "guid", expected, allowed));
        }
        let variables = variables(&actuator);
        let sequences = sim_worker::catalogue::sequence_names().map(sim_worker::catalogue::sequence);
        Ok(Self {
            now: Self::first(&variables),
            sequences: sequences.collect::<Result<_>>()?,
            variables,
            actuator: actuator.into(),
            commands: Vec::new(),
        })
    }

    fn first(variables: &[Variable]) -> Moment {
        Moment {
            phase: Phase::Instantiated,
            values: variables.iter().map(|v| v.start).collect(),
            derivatives: [[0.0; 2]; INPUTS],
            start_s: 0.0,
            stop_s: f64::INFINITY,
            time_s: 0.0,
            warned: false,
            bench: None,
        }
    }

    /// Where it is in the standard's state machine.
    pub fn phase(&self) -> Phase {
        self.now.phase
    }

    /// Where the last step ended [s].
    pub fn time_s(&self) -> f64 {
        self.now.time_s
    }

    /// A refusal in the project's words.
    pub fn bad(&self, place: impl Into<String>, found: impl std::fmt::Display, allowed: impl Into<String>) -> Error {
        Error::bad(identifier(&self.actuator), place, found, allowed)
    }

    fn expect(&self, call: &str, phases: &[Phase]) -> Result<()> {
        if phases.contains(&self.now.phase) {
            return Ok(());
        }
        let words: Vec<&str> = phases.iter().map(|p| p.words()).collect();
        Err(self.bad(call, format!("the state {}", self.now.phase.words()), words.join(", ")))
    }

    fn variable(&self, reference: u32) -> Result<&Variable> {
        let most = self.variables.len() - 1;
        self.variables.get(reference as usize).ok_or_else(|| {
            self.bad(
                "value reference",
                reference,
                format!("0 to {most}, as in modelDescription.xml"),
            )
        })
    }

    /// As [`Instance::variable`], of the type that the call is for.
    fn typed(&self, reference: u32, is_real: bool) -> Result<&Variable> {
        let v = self.variable(reference)?;
        if v.unit.is_some() == is_real {
            return Ok(v);
        }
        let (found, other) = if is_real {
            ("an Enumeration", "Integer")
        } else {
            ("a Real", "Real")
        };
        let allowed = format!("fmi2Get{other}, fmi2Set{other}");
        Err(self.bad(format!("type of variable `{}`", v.name), found, allowed))
    }

    /// Start and end of the simulation [s].
    ///
    /// # Errors
    /// Another state, times that are no numbers, an end before the start.
    pub fn setup(&mut self, start_s: f64, stop_s: Option<f64>) -> Result<()> {
        self.expect("fmi2SetupExperiment", &[Phase::Instantiated])?;
        if !start_s.is_finite() {
            return Err(self.bad("startTime", start_s, "a finite number of seconds"));
        }
        if let Some(stop) = stop_s.filter(|s| !(s.is_finite() && *s >= start_s)) {
            return Err(self.bad(
                "stopTime",
                stop,
                format!("a finite time of at least startTime, {start_s} s"),
            ));
        }
        let now = &mut self.now;
        (now.start_s, now.time_s, now.stop_s) = (start_s, start_s, stop_s.unwrap_or(f64::INFINITY));
        Ok(())
    }

    /// # Errors
    /// Another state.
    pub fn enter_initialization(&mut self) -> Result<()> {
        self.expect("fmi2EnterInitializationMode", &[Phase::Instantiated])?;
        self.now.phase = Phase::Initializing;
        Ok(())
    }

    /// Makes the test bench of what was set.
    ///
    /// # Errors
    /// Another state; parameters that physics forbids together.
    pub fn exit_initialization(&mut self) -> Result<()> {
        self.expect("fmi2ExitInitializationMode", &[Phase::Initializing])?;
        self.now.bench = Some(self.built(&self.now.values)?);
        self.now.phase = Phase::Running;
        Ok(())
    }

    /// # Errors
    /// Another state.
    pub fn terminate(&mut self) -> Result<()> {
        self.expect("fmi2Terminate", &[Phase::Running, Phase::Failed])?;
        self.now.phase = Phase::Terminated;
        Ok(())
    }

    /// All as after instantiation.
    pub fn reset(&mut self) {
        self.now = Self::first(&self.variables);
    }

    /// The first value of what stands for `role`.
    fn value(&self, values: &[f64], role: Role) -> f64 {
        let of = self.variables.iter().position(|v| v.role == role);
        of.map_or(f64::NAN, |i| values[i])
    }

    fn fault(&self, values: &[f64]) -> FaultState {
        FaultState {
            fsj: self.value(values, Role::Fsj),
            zeta: self.value(values, Role::Zeta),
        }
    }

    /// The test bench of these values, at rest.
    fn built(&self, values: &[f64]) -> Result<DrivenBench> {
        let mut own = ActuatorParameters::clone(&self.actuator);
        let mut others = Vec::new();
        let mut changed = false;
        for (v, &x) in self.variables.iter().zip(values).filter(|(v, x)| v.start != **x) {
            match v.role {
                Role::Parameter(k) => others.push((k, x)),
                Role::Effect(i, j) => {
                    own.effects[i].values[j] = x;
                    // identified is what the file had
                    own.effects[i].intervals = None;
                    changed = true;
                }
                _ => {}
            }
        }
        let actuator = if changed || !others.is_empty() {
            // through the reader of files, which knows what goes together
            let text = own.to_toml();
            ActuatorParameters::parse_with("parameters of the FMU", &text, &others)?.into()
        } else {
            self.actuator.clone()
        };
        Ok(DrivenBench::new(Lane {
            actuator,
            fault: self.fault(values),
            rest_angle_rad: self.value(values, Role::RestAngle),
            load_n_m: self.value(values, Role::Load),
        }))
    }

    /// The value of a real variable, in its unit.
    ///
    /// # Errors
    /// A value reference that is not there or of another type; an output before initialization.
    pub fn real(&self, reference: u32) -> Result<f64> {
        match self.typed(reference, true)?.role {
            Role::Output(channel) => match &self.now.bench {
                Some(bench) => Ok(bench.sample(channel)),
                None => {
                    let later = [Phase::Initializing, Phase::Running, Phase::Terminated, Phase::Failed];
                    self.expect("fmi2GetReal of an output", &later)?;
                    Ok(self.built(&self.now.values)?.sample(channel))
                }
            },
            _ => Ok(self.now.values[reference as usize]),
        }
    }

    /// The value of the enumeration.
    ///
    /// # Errors
    /// A value reference that is not there or of another type.
    pub fn integer(&self, reference: u32) -> Result<i32> {
        self.typed(reference, false)?;
        Ok(self.now.values[reference as usize] as i32)
    }

    fn check(&self, reference: u32, x: f64, is_real: bool) -> Result<()> {
        let v = self.typed(reference, is_real)?;
        let place = || format!("variable `{}`", v.name);
        if !v.role.is_settable() {
            return Err(self.bad(place(), "an output", "inputs and parameters to be set"));
        }
        let call = format!("setting {}", place());
        if v.role.is_tunable() {
            self.expect(&call, &[Phase::Instantiated, Phase::Initializing, Phase::Running])?;
        } else {
            self.expect(&call, &[Phase::Instantiated, Phase::Initializing])?;
        }
        if v.allows(x) {
            Ok(())
        } else {
            Err(self.bad(place(), x, v.allowed()))
        }
    }

    /// Sets real variables, all or none.
    ///
    /// # Errors
    /// A value reference that is not there, of another type or of an output; a value that is not allowed; a fixed parameter
    /// once steps may be made.
    pub fn set_reals(&mut self, references: &[u32], values: &[f64]) -> Result<()> {
        let pairs = || references.iter().zip(values);
        pairs().try_for_each(|(r, x)| self.check(*r, *x, true))?;
        pairs().for_each(|(r, x)| self.now.values[*r as usize] = *x);
        let fault = self.fault(&self.now.values);
        if let Some(bench) = &mut self.now.bench {
            bench.set_fault(fault);
        }
        Ok(())
    }

    /// Sets the enumeration.
    ///
    /// # Errors
    /// As [`Instance::set_reals`].
    pub fn set_integers(&mut self, references: &[u32], values: &[i32]) -> Result<()> {
        let pairs = || references.iter().zip(values);
        pairs().try_for_each(|(r, x)| self.check(*r, f64::from(*x), false))?;
        pairs().for_each(|(r, x)| self.now.values[*r as usize] = f64::from(*x));
        Ok(())
    }

    /// Derivatives of inputs [unit/s, unit/s2], for the next step only; all or none.
    ///
    /// # Errors
    /// What is no input, another order than 1 or 2, a value that is no number.
    pub fn set_derivatives(&mut self, references: &[u32], orders: &[i32], values: &[f64]) -> Result<()> {
        self.expect("fmi2SetRealInputDerivatives", &[Phase::Initializing, Phase::Running])?;
        let all = || references.iter().zip(orders).zip(values);
        for ((r, order), x) in all() {
            let v = self.variable(*r)?;
            let place = format!("derivative of variable `{}`", v.name);
            if *r as usize >= INPUTS {
                return Err(self.bad(place, "no input", "inputs: command, load_torque"));
            }
            if !(1..=2).contains(order) {
                return Err(self.bad(format!("order of the {place}"), order, "1 or 2"));
            }
            if !x.is_finite() {
                return Err(self.bad(place, x, "a finite number"));
            }
        }
        all().for_each(|((r, order), x)| self.now.derivatives[*r as usize][*order as usize - 1] = *x);
        Ok(())
    }

    /// Makes the simulator's steps up to the one nearest to the end of the communication step. True where something is worth a
    /// warning, the first time that the end is between two steps.
    ///
    /// * `at_s` the communication point, `length_s` the communication step [s]
    ///
    /// # Errors
    /// Another state or time than that of the last step's end, a step that is too short or too long or goes beyond stopTime;
    /// values that are no longer numbers, after which the instance has failed.
    pub fn step(&mut self, at_s: f64, length_s: f64) -> Result<bool> {
        self.expect("fmi2DoStep", &[Phase::Running])?;
        let dt = self.now.bench.as_ref().map_or(f64::NAN, DrivenBench::step_s);
        if !(length_s >= dt * (1.0 - ON_STEP) && length_s <= LONGEST_S) {
            let allowed = format!("{dt:e} s, a step of the simulator, to {LONGEST_S} s");
            return Err(self.bad("communicationStepSize", length_s, allowed));
        }
        let apart = (at_s - self.now.time_s).abs();
        if apart.is_nan() || apart > 0.5 * dt {
            let allowed = format!("{} s, where the last step ended", self.now.time_s);
            return Err(self.bad("currentCommunicationPoint", at_s, allowed));
        }
        let end_s = at_s + length_s;
        if end_s > self.now.stop_s + 0.5 * dt {
            let allowed = format!("at most stopTime, {} s", self.now.stop_s);
            return Err(self.bad("end of the communication step", end_s, allowed));
        }
        let course = |input: usize| Course {
            value: self.now.values[input],
            derivatives: self.now.derivatives[input],
        };
        let (command, load) = (course(0), course(1));
        let chosen = self.value(&self.now.values, Role::Sequence) as usize;
        let sequence = chosen.checked_sub(2).and_then(|n| self.sequences.get(n));
        let track = sequence.map(|s| CommandTrack::new(s, dt));
        let now = &mut self.now;
        let bench = now.bench.as_mut().expect("an instance in step mode has a bench");
        let (begin, ends) = (at_s - now.start_s, (end_s - now.start_s) / dt);
        let (mut step, last) = (bench.steps(), ends.round() as u64);
        if step < last {
            bench.next_interval();
        }
        while step < last {
            let n = (last - step).min(CHUNK) as usize;
            self.commands.resize(n, 0.0);
            let after = |j: usize| (step + j as u64) as f64 * dt - begin;
            match &track {
                Some(track) => track.fill(step, &mut self.commands),
                None => self
                    .commands
                    .iter_mut()
                    .enumerate()
                    .for_each(|(j, c)| *c = command.at(after(j))),
            }
            if load.is_held() {
                bench.set_load(load.value);
                bench.advance(&self.commands);
            } else {
                for (j, c) in self.commands.iter().enumerate() {
                    bench.set_load(load.at(after(j)));
                    bench.advance(std::slice::from_ref(c));
                }
            }
            step += n as u64;
        }
        now.time_s = end_s;
        for (input, course) in [command, load].into_iter().enumerate() {
            now.values[input] = course.at(length_s);
        }
        now.derivatives = [[0.0; 2]; INPUTS];
        if let Err(e) = bench.check_finite() {
            now.phase = Phase::Failed;
            return Err(e);
        }
        let between = (ends - ends.round()).abs() > ON_STEP;
        let first = between && !now.warned;
        now.warned |= between;
        Ok(first)
    }

    /// The simulator's step [s]; NaN before initialization.
    pub fn step_s(&self) -> f64 {
        self.now.bench.as_ref().map_or(f64::NAN, DrivenBench::step_s)
    }

    /// All that changes.
    pub fn moment(&self) -> &Moment {
        &self.now
    }

    /// Goes back to a moment of this instance.
    pub fn go_to(&mut self, moment: &Moment) {
        self.now = moment.clone();
    }

    /// A moment in bytes: little endian, behind a mark and the guid.
    pub fn bytes(&self, m: &Moment) -> Vec<u8> {
        let mut numbers = vec![
            f64::from(m.phase as u8),
            m.start_s,
            m.stop_s,
            m.time_s,
            f64::from(u8::from(m.warned)),
        ];
        numbers.extend(&m.values);
        numbers.extend(m.derivatives.as_flattened());
        numbers.extend(m.bench.as_ref().map_or(Vec::new(), DrivenBench::state));
        let mut out = MAGIC.to_vec();
        out.extend(guid(&self.actuator).bytes());
        out.extend(numbers.into_iter().flat_map(f64::to_le_bytes));
        out
    }

    /// The moment of [`Instance::bytes`], of an instance of the same FMU.
    ///
    /// # Errors
    /// Bytes of another FMU, too few, too many, or values that are not allowed.
    pub fn moment_of(&self, bytes: &[u8]) -> Result<Moment> {
        let bad = |found: &str| self.bad("serialized state", found, "the bytes of a state of this very FMU");
        let own = guid(&self.actuator);
        let rest = bytes
            .strip_prefix(&MAGIC[..])
            .and_then(|b| b.strip_prefix(own.as_bytes()))
            .ok_or_else(|| bad("another mark or guid"))?;
        let (numbers, torn) = rest.as_chunks::<8>();
        let numbers: Vec<f64> = numbers.iter().map(|b| f64::from_le_bytes(*b)).collect();
        let (values, fixed) = (self.variables.len(), 5 + self.variables.len() + 2 * INPUTS);
        if !torn.is_empty() || numbers.len() < fixed {
            return Err(bad(&format!("{} bytes", bytes.len())));
        }
        let mut m = Self::first(&self.variables);
        m.phase = *Phase::ALL
            .get(numbers[0] as usize)
            .ok_or_else(|| bad("a state that is not known"))?;
        (m.start_s, m.stop_s, m.time_s, m.warned) = (numbers[1], numbers[2], numbers[3], numbers[4] != 0.0);
        m.values.copy_from_slice(&numbers[5..5 + values]);
        let derivatives = &numbers[5 + values..fixed];
        m.derivatives.as_flattened_mut().copy_from_slice(derivatives);
        let allowed = self.variables.iter().zip(&m.values).all(|(v, x)| v.allows(*x));
        let finite = m.start_s.is_finite() && m.time_s.is_finite() && !m.stop_s.is_nan();
        if !allowed || !finite || derivatives.iter().any(|x| !x.is_finite()) {
            return Err(bad("values that are not allowed"));
        }
        let has_bench = !matches!(m.phase, Phase::Instantiated | Phase::Initializing);
        if has_bench {
            let mut bench = self.built(&m.values)?;
            bench.restore(&numbers[fixed..])?;
            m.bench = Some(bench);
        } else if numbers.len() > fixed {
            return Err(bad("numbers of a bench that is not made yet"));
        }
        Ok(m)
    }
}

#[cfg(test)]
mod tests;
