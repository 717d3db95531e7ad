//! The files of a bed: history, events, truth and key.

use std::fmt::Write as _;
use std::io;
use std::path::Path;

use super::diagnosis::COVERAGE;
use super::wear::Wear;
use super::{Bed, Fault, Options, Unit};

/// Writes `history.csv`, `events.csv`, `truth.csv` and `key.json` into the
/// folder `out`, which is made if need be.
pub fn write(out: &Path, options: &Options, units: &[Unit]) -> io::Result<()> {
    std::fs::create_dir_all(out)?;
    std::fs::write(out.join("history.csv"), history(options, units))?;
    std::fs::write(out.join("events.csv"), events(units))?;
    std::fs::write(out.join("truth.csv"), truth(units))?;
    std::fs::write(out.join("key.json"), key(options, units))
}

/// A number with six significant digits, without trailing zeros.
pub fn six_digits(x: f64) -> String {
    if x == 0.0 {
        return "0".to_string();
    }
    let decimals = (5 - x.abs().log10().floor() as i32).clamp(0, 12) as usize;
    let text = format!("{x:.decimals$}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_string()
    } else {
        text
    }
}

/// A time (seconds since 1970) as ISO 8601 in UTC.
pub fn iso_time(seconds: i64) -> String {
    let (days, rest) = (seconds.div_euclid(86_400), seconds.rem_euclid(86_400));
    // Days since 0000-03-01, in eras of 400 years.
    let shifted = days + 719_468;
    let era = shifted.div_euclid(146_097);
    let day_of_era = shifted.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted_month + 2) / 5 + 1;
    let month = if shifted_month < 10 {
        shifted_month + 3
    } else {
        shifted_month - 9
    };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    let (hour, minute, second) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}Z")
}

/// The tests of all units, as CSV.
pub fn history(options: &Options, units: &[Unit]) -> String {
    let mut text = String::from("actuator,time,cycle,outcome,fsj_lo,fsj_hi,fsj_estimate,coverage");
    let faults = if options.two_faults { 2 } else { 1 };
    if faults == 2 {
        text.push_str(",zeta_lo,zeta_hi,zeta_estimate");
    }
    text.push('\n');
    for unit in units {
        for test in &unit.tests {
            let time = iso_time(test.time);
            let (flight, outcome) = (test.flight, test.outcome.name());
            let _ = write!(text, "{},{time},{flight},{outcome}", unit.name);
            for fault in 0..faults {
                match test.readings.get(fault) {
                    Some(reading) => {
                        for x in [reading.low, reading.high, reading.estimate] {
                            let _ = write!(text, ",{}", six_digits(x));
                        }
                    }
                    None => text.push_str(",,,"),
                }
                if fault == 0 {
                    let _ = write!(text, ",{COVERAGE}");
                }
            }
            text.push('\n');
        }
    }
    text
}

/// The recorded repairs, as CSV.
pub fn events(units: &[Unit]) -> String {
    let mut text = String::from("actuator,cycle,kind,fault,note\n");
    for unit in units {
        if let Some(repair) = unit.repair.filter(|r| r.recorded) {
            let _ = writeln!(text, "{},{},repair,fsj,screw and nut renewed", unit.name, repair.flight);
        }
    }
    text
}

/// The true ends of life, as CSV.
pub fn truth(units: &[Unit]) -> String {
    let mut text = String::from("actuator,cycle,event\n");
    for unit in units {
        for fault in &unit.faults {
            if let Some(growth) = &fault.growth {
                let (end, event) = (six_digits(growth.end), fault.kind.event());
                let _ = writeln!(text, "{},{end},{event}", unit.name);
            }
        }
    }
    text
}

/// Everything that was drawn, as JSON.
///
/// `start` and parameters named offset are parts of the threshold damage.
/// `target`, `life` and `change` of a wear are flights from the start of that
/// wear; `change_cycle` and `end_cycle` of a fault are on the clock of the
/// history. `damage` holds the true damage at flights 1, 2, ... in the fault's
/// own unit.
pub fn key(options: &Options, units: &[Unit]) -> String {
    let bed = match options.bed {
        Bed::Fleet => "fleet",
        Bed::Healthy { .. } => "healthy",
        Bed::Triple => "triple",
        Bed::RepairsUnrecorded => "repairs-unrecorded",
    };
    let mut text = format!(
        "{{\"options\": {{\"units\": {}, \"seed\": {}, \"bed\": \"{bed}\", \"noise\": \"{}\", \
         \"ar1\": {}, \"two_faults\": {}}},\n\"units\": [",
        options.units,
        options.seed,
        options.noise.name(),
        options.ar1,
        options.two_faults
    );
    for (index, unit) in units.iter().enumerate() {
        text.push_str(if index == 0 { "\n" } else { ",\n" });
        text.push_str(&key_unit(unit));
    }
    text.push_str("\n]}\n");
    text
}

fn key_unit(unit: &Unit) -> String {
    let repair = match unit.repair {
        Some(r) => format!("{{\"flight\": {}, \"recorded\": {}}}", r.flight, r.recorded),
        None => "null".to_string(),
    };
    let wrong: Vec<String> = unit
        .tests
        .iter()
        .filter(|t| t.wrong)
        .map(|t| t.flight.to_string())
        .collect();
    let faults: Vec<String> = unit.faults.iter().map(|f| key_fault(f, unit)).collect();
    format!(
        "{{\"actuator\": \"{}\", \"flights\": {}, \"repair\": {repair}, \
         \"wrong_flights\": [{}], \"faults\": [\n  {}]}}",
        unit.name,
        unit.flights,
        wrong.join(", "),
        faults.join(",\n  ")
    )
}

fn key_fault(fault: &Fault, unit: &Unit) -> String {
    let (law, parameters, before, wear, end, change) = match &fault.growth {
        None => {
            let none = || "null".to_string();
            let healthy = "\"healthy\"".to_string();
            (healthy, "{}".to_string(), none(), none(), none(), none())
        }
        Some(growth) => {
            let parameters: Vec<String> = growth
                .law
                .parameters()
                .iter()
                .map(|(name, value)| format!("\"{name}\": {value}"))
                .collect();
            let offset = match (&growth.before, unit.repair) {
                (Some(_), Some(repair)) => f64::from(repair.flight),
                _ => 0.0,
            };
            (
                format!("\"{}\"", growth.law.name()),
                format!("{{{}}}", parameters.join(", ")),
                growth.before.as_ref().map_or("null".to_string(), key_wear),
                key_wear(&growth.wear),
                growth.end.to_string(),
                number(growth.wear.change.map(|t| t + offset)),
            )
        }
    };
    let damage: Vec<String> = fault.damage.iter().map(|&d| six_digits(d)).collect();
    format!(
        "{{\"fault\": \"{}\", \"law\": {law}, \"parameters\": {parameters}, \
         \"baseline\": {}, \"bias\": {}, \"end_cycle\": {end}, \"change_cycle\": {change}, \
         \"before_repair\": {before}, \"wear\": {wear}, \"damage\": [{}]}}",
        fault.kind.name(),
        fault.baseline,
        fault.bias,
        damage.join(", ")
    )
}

fn key_wear(wear: &Wear) -> String {
    format!(
        "{{\"start\": {}, \"target\": {}, \"life\": {}, \"change\": {}}}",
        wear.start,
        wear.target,
        wear.life,
        number(wear.change)
    )
}

fn number(x: Option<f64>) -> String {
    x.map_or("null".to_string(), |x| x.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms() {
        assert_eq!(iso_time(1_735_711_200), "2025-01-01T06:00:00Z");
        assert_eq!(iso_time(1_709_251_199), "2024-02-29T23:59:59Z");
        assert_eq!(six_digits(1.234_567_8), "1.23457");
        assert_eq!(six_digits(-0.000_123_456_78), "-0.000123457");
        assert_eq!(six_digits(400.0), "400");
        assert_eq!(six_digits(123.456_78), "123.457");
    }
}
