//! Units of the project's tables as units of FMI.

/// A unit by its base units.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// after FMI's convention, `N.m.s/rad`
    pub name: String,
    /// exponents of [`BASE`]
    pub exponents: [i32; 6],
    /// of the base units
    pub factor: f64,
    /// value in base units of a value 0
    pub offset: f64,
}

/// Attributes of FMI's `BaseUnit`.
pub const BASE: [&str; 6] = ["kg", "m", "s", "A", "K", "rad"];

/// Symbol, exponents of [`BASE`], factor.
const SYMBOLS: [(&str, [i32; 6], f64); 12] = [
    ("kg", [1, 0, 0, 0, 0, 0], 1.0),
    ("m", [0, 1, 0, 0, 0, 0], 1.0),
    ("s", [0, 0, 1, 0, 0, 0], 1.0),
    ("A", [0, 0, 0, 1, 0, 0], 1.0),
    ("K", [0, 0, 0, 0, 1, 0], 1.0),
    ("rad", [0, 0, 0, 0, 0, 1], 1.0),
    ("N", [1, 1, -2, 0, 0, 0], 1.0),
    ("V", [1, 2, -3, -1, 0, 0], 1.0),
    ("ohm", [1, 2, -3, -2, 0, 0], 1.0),
    ("H", [1, 2, -2, -2, 0, 0], 1.0),
    ("turn", [0, 0, 0, 0, 0, 1], std::f64::consts::TAU),
    ("1", [0; 6], 1.0),
];

/// A unit as the tables of channels, parameters and effects have it (`N m s2/rad2`, `-`); none for a word that is not known.
pub fn unit(text: &str) -> Option<Unit> {
    match text {
        "-" => return unit("1"),
        // motor over user: what is counted is the same on both sides
        "(rad/s motor)/(rad user)" => return unit("1/s"),
        "degC" | "deg C" => {
            return unit("K").map(|k| Unit {
                name: "degC".into(),
                offset: 273.15,
                ..k
            });
        }
        _ => {}
    }
    let (mut exponents, mut factor) = ([0; 6], 1.0);
    for (sign, part) in [1, -1].into_iter().zip(text.split('/')) {
        for word in part.split(' ') {
            let digits = if word == "1" {
                ""
            } else {
                word.trim_start_matches(|c: char| !c.is_ascii_digit())
            };
            let (symbol, power) = word.split_at(word.len() - digits.len());
            let power = sign * if power.is_empty() { 1 } else { power.parse().ok()? };
            let (_, base, times) = SYMBOLS.iter().find(|(s, ..)| *s == symbol)?;
            (0..6).for_each(|k| exponents[k] += power * base[k]);
            factor *= f64::powi(*times, power);
        }
    }
    Some(Unit {
        name: text.replace(' ', "."),
        exponents,
        factor,
        offset: 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_units_are_their_base_units() {
        let is = |text: &str, name: &str, exponents: [i32; 6]| {
            let u = unit(text).unwrap();
            assert_eq!((u.name.as_str(), u.exponents), (name, exponents), "{text}");
        };
        is("rad/s", "rad/s", [0, 0, -1, 0, 0, 1]);
        is("N m", "N.m", [1, 2, -2, 0, 0, 0]);
        is("N m s2/rad2", "N.m.s2/rad2", [1, 2, 0, 0, 0, -2]);
        is("V s/rad", "V.s/rad", [1, 2, -2, -1, 0, -1]);
        is("kg m2", "kg.m2", [1, 2, 0, 0, 0, 0]);
        is("1/K", "1/K", [0, 0, 0, 0, -1, 0]);
        is("-", "1", [0; 6]);
        is("(rad/s motor)/(rad user)", "1/s", [0, 0, -1, 0, 0, 0]);
        assert_eq!(unit("degC").unwrap().offset, 273.15);
        assert_eq!(unit("1/turn").unwrap().factor, 1.0 / std::f64::consts::TAU);
        assert_eq!(unit("furlong"), None);
    }
}
