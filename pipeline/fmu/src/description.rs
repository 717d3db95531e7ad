//! The files of an FMU but for the library itself.

use crate::unit::{BASE, Unit};
use crate::variables::{Role, Variable, guid, sequences, variables};
use schemas::foreign;
use sim_worker::parameters::ActuatorParameters;

/// Where the resolved parameters stand in the FMU, and where an instance reads them.
pub const ACTUATOR: &str = "actuator.toml";

/// Communication step that is proposed [s]: the telemetry rate of 10 kHz.
const STEP_S: f64 = 1e-4;
/// End of a simulation that is proposed [s]: the length of the pre-flight test.
const STOP_S: f64 = 3.0;

/// Categories of messages.
pub const CATEGORIES: [(&str, &str); 2] = [
    (
        "logStatusError",
        "why a call was refused: place, value found, what is allowed",
    ),
    ("logStatusWarning", "what was done otherwise than asked"),
];

/// Name of the library in the FMU: letters, digits and `_` of the actuator's name.
pub fn identifier(actuator: &ActuatorParameters) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let name: String = actuator.name.chars().take(48).map(plain).collect();
    format!("ema_{name}")
}

/// Path in the FMU and bytes of each file but for the library, in the order of an archive.
pub fn files(actuator: &ActuatorParameters) -> Vec<(String, Vec<u8>)> {
    let own = |path: &str, text: String| (path.to_string(), text.into_bytes());
    vec![
        own("modelDescription.xml", model_description(actuator)),
        own("documentation/index.html", documentation(actuator)),
        own(
            "documentation/licenses/LICENSE-MIT",
            include_str!("../../../LICENSE-MIT").into(),
        ),
        own(
            "documentation/licenses/LICENSE-APACHE",
            include_str!("../../../LICENSE-APACHE").into(),
        ),
        own(&format!("resources/{ACTUATOR}"), actuator.to_toml()),
    ]
}

/// Text of an attribute or element.
fn escaped(text: &str) -> String {
    let text = foreign::line(text).to_string();
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

fn unit_definition(u: &Unit) -> String {
    let mut base = String::new();
    for (name, power) in BASE.iter().zip(u.exponents).filter(|(_, p)| *p != 0) {
        base += &format!(" {name}=\"{power}\"");
    }
    if u.factor != 1.0 {
        base += &format!(" factor=\"{:?}\"", u.factor);
    }
    if u.offset != 0.0 {
        base += &format!(" offset=\"{:?}\"", u.offset);
    }
    format!("    <Unit name=\"{}\"><BaseUnit{base}/></Unit>\n", escaped(&u.name))
}

fn scalar_variable(v: &Variable, reference: usize) -> String {
    let (causality, variability, initial) = match v.role {
        Role::Command | Role::Load => ("input", "continuous", ""),
        Role::Output(_) => ("output", "continuous", " initial=\"calculated\""),
        r if r.is_tunable() => ("parameter", "tunable", " initial=\"exact\""),
        _ => ("parameter", "fixed", " initial=\"exact\""),
    };
    let number = match &v.unit {
        None => format!("<Enumeration declaredType=\"Sequence\" start=\"{}\"/>", v.start),
        Some(u) => {
            let mut attributes = format!(" unit=\"{}\"", escaped(&u.name));
            for (name, x) in [("min", v.low), ("max", v.high)] {
                if x.is_finite() {
                    attributes += &format!(" {name}=\"{x:?}\"");
                }
            }
            if !matches!(v.role, Role::Output(_)) {
                attributes += &format!(" start=\"{:?}\"", v.start);
            }
            format!("<Real{attributes}/>")
        }
    };
    format!(
        "    <ScalarVariable name=\"{}\" valueReference=\"{reference}\" description=\"{}\" causality=\"{causality}\" \
         variability=\"{variability}\"{initial}>{number}</ScalarVariable>\n",
        escaped(&v.name),
        escaped(&v.meaning)
    )
}

/// `modelDescription.xml` of an actuator.
pub fn model_description(actuator: &ActuatorParameters) -> String {
    let all = variables(actuator);
    let mut units: Vec<&Unit> = all.iter().filter_map(|v| v.unit.as_ref()).collect();
    units.sort_by(|a, b| a.name.cmp(&b.name));
    units.dedup();
    let units: String = units.into_iter().map(unit_definition).collect();
    let items: String = sequences()
        .iter()
        .enumerate()
        .map(|(i, name)| format!("        <Item name=\"{name}\" value=\"{}\"/>\n", i + 1))
        .collect();
    let categories: String = CATEGORIES
        .iter()
        .map(|(name, words)| format!("    <Category name=\"{name}\" description=\"{words}\"/>\n"))
        .collect();
    let scalars: String = all.iter().enumerate().map(|(i, v)| scalar_variable(v, i)).collect();
    let outputs = || {
        all.iter()
            .enumerate()
            .filter(|(_, v)| matches!(v.role, Role::Output(_)))
    };
    let unknowns = |more: &str| -> String {
        outputs()
            .map(|(i, _)| format!("      <Unknown index=\"{}\"{more}/>\n", i + 1))
            .collect()
    };
    // an output is of the step before: it does not know the inputs of its communication point
    let (at_once, initial) = (unknowns(" dependencies=\"\""), unknowns(""));
    let version = env!("CARGO_PKG_VERSION");
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
         <fmiModelDescription fmiVersion=\"2.0\" modelName=\"{name}\" guid=\"{guid}\" \
         description=\"Numerical test bench of an electromechanical actuator with friction and eccentricity faults\" \
         version=\"{version}\" license=\"MIT OR Apache-2.0\" generationTool=\"ema {version}\" \
         variableNamingConvention=\"structured\">\n\
         \x20 <CoSimulation modelIdentifier=\"{id}\" canHandleVariableCommunicationStepSize=\"true\" \
         canInterpolateInputs=\"true\" maxOutputDerivativeOrder=\"0\" canNotUseMemoryManagementFunctions=\"true\" \
         canGetAndSetFMUstate=\"true\" canSerializeFMUstate=\"true\"/>\n\
         \x20 <UnitDefinitions>\n{units}  </UnitDefinitions>\n\
         \x20 <TypeDefinitions>\n    <SimpleType name=\"Sequence\" description=\"what commands\">\n      <Enumeration>\n{items}\
         \x20     </Enumeration>\n    </SimpleType>\n  </TypeDefinitions>\n\
         \x20 <LogCategories>\n{categories}  </LogCategories>\n\
         \x20 <DefaultExperiment startTime=\"0\" stopTime=\"{STOP_S:?}\" stepSize=\"{STEP_S:?}\"/>\n\
         \x20 <ModelVariables>\n{scalars}  </ModelVariables>\n\
         \x20 <ModelStructure>\n    <Outputs>\n{at_once}    </Outputs>\n    <InitialUnknowns>\n{initial}\
         \x20   </InitialUnknowns>\n  </ModelStructure>\n\
         </fmiModelDescription>\n",
        name = escaped(&format!("EMA {}", actuator.name)),
        guid = guid(actuator),
        id = identifier(actuator),
    )
}

/// `documentation/index.html` of an actuator.
fn documentation(actuator: &ActuatorParameters) -> String {
    let mut rows = String::new();
    for v in variables(actuator) {
        let kind = match v.role {
            Role::Command | Role::Load => "input",
            Role::Output(_) => "output",
            r if r.is_tunable() => "tunable parameter",
            _ => "fixed parameter",
        };
        let unit = v.unit.as_ref().map_or("", |u| &u.name);
        let allowed = if v.role.is_settable() {
            v.allowed()
        } else {
            String::new()
        };
        rows += &format!(
            "<tr><td>{}</td><td>{kind}</td><td>{unit}</td><td>{allowed}</td><td>{}</td></tr>\n",
            escaped(&v.name),
            escaped(&v.meaning)
        );
    }
    let assumed = if actuator.assumed.is_empty() {
        String::new()
    } else {
        format!(
            "<p><b>Assumed</b> (not from a data sheet or a measurement): {}.</p>\n",
            escaped(&actuator.assumed.join(", "))
        )
    };
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>EMA {name}</title></head><body>\n\
         <h1>Electromechanical actuator {name}</h1>\n\
         <p>The numerical test bench (three-phase motor with hysteresis current control, position and speed loop, dry friction, \
         backlash, end stops) with two faults: friction factor FSJ and static eccentricity zeta. Explicit steps of {dt:e} s. \
         Parameters: <code>resources/actuator.toml</code>, fingerprint {fingerprint}. Made by ema {version}.</p>\n{assumed}\
         <h2>Time</h2>\n<p>A communication step makes the simulator's steps up to the one nearest to its end; it lasts at least \
         one of them and at most an hour. Where it is no whole number of them, one warning says so.</p>\n\
         <h2>Inputs</h2>\n<p>An input is <b>held</b> over the communication step, unless fmi2SetRealInputDerivatives gave its first \
         derivative (and, for curved signals, its second): then it follows the polynomial for this one step, and stays where \
         it has got to until it is set again. Holding a command of 10 kHz delays it by half a step, which a diagnosis of \
         faults notices: give the derivative, or let <code>sequence</code> command. After its end a sequence's \
         last segment goes on.</p>\n\
         <h2>Outputs</h2>\n<p>Positions and speed are values at the communication point, currents, voltages and torque means over \
         the communication step, both without sensors and without noise. Before the first step means are 0.</p>\n\
         <h2>Variables</h2>\n<table border=\"1\">\n<tr><th>name</th><th>kind</th><th>unit</th><th>allowed</th><th>meaning</th></tr>\n\
         {rows}</table>\n\
         <h2>Licence</h2>\n<p>MIT OR Apache-2.0, at your choice: texts in <code>licenses</code>.</p>\n</body></html>\n",
        name = escaped(&actuator.name),
        dt = actuator.step_s,
        fingerprint = actuator.fingerprint(),
        version = env!("CARGO_PKG_VERSION"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_a_name_is_an_identifier_and_stays_text() {
        let mut a = ActuatorParameters::reference();
        assert_eq!(identifier(&a), "ema_reference");
        a.name = "5 <\"ä\">&\n".into();
        assert_eq!(identifier(&a), "ema_5________");
        let xml = model_description(&a);
        assert!(xml.contains("modelName=\"EMA 5 &lt;&quot;ä&quot;&gt;&amp;"), "{xml}");
        assert_eq!(xml.matches("<ScalarVariable").count(), variables(&a).len());
    }
}
