//! The command line of the campaign.

use std::path::PathBuf;

/// What was asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    pub out: PathBuf,
    /// cases of a class on the servo; the three-phase rig gets two fifths
    pub cases: u64,
    pub seed: u64,
    /// cases studied side by side
    pub jobs: usize,
    /// labels of classes, or their beginnings
    pub only: Vec<String>,
    pub report_only: bool,
    pub keep: bool,
    pub record: Option<PathBuf>,
    /// generator of another hand in place of the own one
    pub bed: Option<String>,
    /// of that generator: what is hidden, and how strongly
    pub class: String,
    pub effect: Option<String>,
    pub strength: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            out: PathBuf::from("target/discrepancy-bench"),
            cases: 100,
            seed: 1,
            jobs: std::thread::available_parallelism().map_or(1, |n| n.get()),
            only: Vec::new(),
            report_only: false,
            keep: false,
            record: None,
            bed: None,
            class: "one".into(),
            effect: None,
            strength: 1.0,
        }
    }
}

/// Text of `--help`, without the classes.
pub const HELP: &str = "\
Blind test bed of the discrepancy study: makes cases with hidden effects, studies them, then opens the keys.
Stopped and started again it goes on where it was.

  discrepancy-bench [OPTIONS]

  --out DIR       results, keys and recordings under work [target/discrepancy-bench]
  --cases N       cases of a class; two fifths of them on the three-phase rig [100]
  --seed S        of the whole campaign [1]
  --jobs J        cases side by side [all cores]; with fewer jobs than cores a study has several threads
  --only CLASS    CLASS, CLASS/SETTING or CLASS/SETTING/SEVERITY, before it three_phase/; may be repeated
  --report-only   no cases, only the report of what there is
  --keep          leave the recordings in DIR/data
  --record FILE   write the report to a file, too
  --bed BED       cases of another hand: servo (rigs with a bench file) or actuator (two recordings of 8 s with phases)
  --class KIND    of that bed: nothing, one, two or outside; an actuator has the first two [one]
  --effect NAME   of that bed: this effect in every case [each in turn]
  --strength X    of that bed: of the hidden effect [1]
  --help          this

Classes:";

impl Options {
    /// From the arguments after the program's name; `None` where help is wanted.
    pub fn parse(arguments: impl IntoIterator<Item = String>) -> Result<Option<Self>, String> {
        let mut o = Self::default();
        let mut rest = arguments.into_iter();
        while let Some(argument) = rest.next() {
            let (name, mut inline) = match argument.split_once('=') {
                Some((n, v)) => (n.to_string(), Some(v.to_string())),
                None => (argument, None),
            };
            let mut value = || {
                inline
                    .take()
                    .or_else(|| rest.next())
                    .ok_or(format!("{name} needs a value"))
            };
            match name.as_str() {
                "--out" => o.out = value()?.into(),
                "--cases" => o.cases = number(&name, &value()?)?,
                "--seed" => o.seed = number(&name, &value()?)?,
                "--jobs" => o.jobs = number::<usize>(&name, &value()?)?.max(1),
                "--only" => o.only.push(value()?),
                "--bed" => o.bed = Some(value()?),
                "--class" => o.class = value()?,
                "--effect" => o.effect = Some(value()?),
                "--strength" => {
                    let text = value()?;
                    let x = text.parse().ok().filter(|x: &f64| x.is_finite() && *x >= 0.0);
                    o.strength = x.ok_or(format!("--strength: {text} is not a number from 0"))?;
                }
                "--record" => o.record = Some(value()?.into()),
                "--report-only" => o.report_only = true,
                "--keep" => o.keep = true,
                "--help" | "-h" => return Ok(None),
                _ => return Err(format!("no option is called {name}; --help lists them")),
            }
            if inline.is_some() {
                return Err(format!("{name} takes no value"));
            }
        }
        Ok(Some(o))
    }
}

fn number<T: std::str::FromStr>(name: &str, text: &str) -> Result<T, String> {
    text.parse()
        .map_err(|_| format!("{name}: {text} is not a whole number from 0"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(line: &str) -> Result<Option<Options>, String> {
        Options::parse(line.split_whitespace().map(str::to_string))
    }

    #[test]
    fn options_are_read() {
        let o = parsed("--bed servo --class nothing --strength 0.3").unwrap().unwrap();
        assert_eq!(
            (o.bed.as_deref(), o.class.as_str(), o.strength),
            (Some("servo"), "nothing", 0.3)
        );
        let o = parsed("--cases 7 --seed=3 --jobs 0 --only one/matched --only two --record r.md --keep")
            .unwrap()
            .unwrap();
        assert_eq!((o.cases, o.seed, o.jobs, o.keep, o.report_only), (7, 3, 1, true, false));
        assert_eq!(o.only, ["one/matched", "two"]);
        assert_eq!(o.record, Some("r.md".into()));
        assert_eq!(parsed("--cases 3 --help"), Ok(None));
        for wrong in ["--cases", "--cases x", "--keep=1", "--no-such", "12", "--strength -1"] {
            assert!(parsed(wrong).is_err(), "{wrong}");
        }
    }
}
