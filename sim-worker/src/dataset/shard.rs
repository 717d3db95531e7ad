//! Which share of a plan a worker does: as told, or as a Slurm job array or a Kubernetes indexed job says.

use schemas::error::{Error, Result};
use std::ops::Range;

/// Share `index` of `count`, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// from 0 to `count - 1`
    pub index: usize,
    /// at least 1
    pub count: usize,
}

/// Number of shards, for workers that learn only their own number.
pub const SHARDS: &str = "EMA_SHARDS";

const ALLOWED: &str = "I/N, I from 0 to N - 1";

impl Shard {
    /// All of it: the only share of one.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// From `I/N`.
    ///
    /// # Errors
    /// A text of another form, or an index that is not below the count.
    pub fn parse(text: &str) -> Result<Self> {
        let bad = || Error::bad("command line", "--shard", text, ALLOWED);
        let (index, count) = text.split_once('/').ok_or_else(bad)?;
        let number = |t: &str| t.trim().parse::<usize>().map_err(|_| bad());
        Self::new(number(index)?, number(count)?).ok_or_else(bad)
    }

    fn new(index: usize, count: usize) -> Option<Self> {
        (index < count).then_some(Self { index, count })
    }

    /// From the environment of a job; `None` outside of one.
    ///
    /// Where `EMA_SHARDS` is set it is the number of shards, and the number of the task or pod is the
    /// shard: so single tasks of an array can be run again. Otherwise the whole array must be there.
    ///
    /// * `variable` looks up an environment variable
    ///
    /// # Errors
    /// Variables that do not go together, with what is wanted.
    pub fn from_environment(variable: impl Fn(&str) -> Option<String>) -> Result<Option<Self>> {
        let number = |name: &str| -> Result<Option<usize>> {
            let Some(text) = variable(name).filter(|t| !t.is_empty()) else {
                return Ok(None);
            };
            let bad = |_| Error::bad("environment", name, &text, "a whole number");
            text.parse().map(Some).map_err(bad)
        };
        let task = number("SLURM_ARRAY_TASK_ID")?;
        let pod = number("JOB_COMPLETION_INDEX")?;
        let shards = number(SHARDS)?;
        let bad = |place: &str, found: String, allowed: String| Err(Error::bad("environment", place, found, allowed));
        if let (Some(n), Some(i)) = (shards, task.or(pod)) {
            let name = if task.is_some() {
                "SLURM_ARRAY_TASK_ID"
            } else {
                "JOB_COMPLETION_INDEX"
            };
            return match Self::new(i, n) {
                Some(s) => Ok(Some(s)),
                None => bad(name, i.to_string(), format!("0 to {SHARDS} - 1, {SHARDS} is {n}")),
            };
        }
        if let Some(i) = task {
            let get = |name: &str| {
                Ok(number(name)?.ok_or_else(|| Error::bad("environment", name, "nothing", "that of a job array")))
            };
            let (from, to, count) = (
                get("SLURM_ARRAY_TASK_MIN")??,
                get("SLURM_ARRAY_TASK_MAX")??,
                get("SLURM_ARRAY_TASK_COUNT")??,
            );
            let step = number("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1).max(1);
            // an array with gaps (--array=3,7) does not say how many shards there were
            let whole = from <= i && i <= to && (to - from) / step + 1 == count && (i - from).is_multiple_of(step);
            if !whole {
                let found = format!("tasks {from} to {to} by {step}, {count} of them");
                return bad(
                    "Slurm job array",
                    found,
                    format!("a whole range, or {SHARDS} with the number of all shards"),
                );
            }
            return Ok(Self::new((i - from) / step, count));
        }
        if pod.is_some() {
            return bad(
                SHARDS,
                "nothing".into(),
                "the completions of the indexed job that JOB_COMPLETION_INDEX is of".into(),
            );
        }
        Ok(None)
    }

    /// Its parts of `parts`.
    pub fn range(self, parts: usize) -> Range<usize> {
        let at = |i: usize| (i as u128 * parts as u128 / self.count as u128) as usize;
        at(self.index)..at(self.index + 1)
    }

    /// The shard that does part `part` of `parts`, where there are `count` shards.
    pub fn of(part: usize, parts: usize, count: usize) -> Self {
        // the last shard that begins at or before the part
        let mut index = (part as u128 * count as u128 / parts as u128) as usize;
        while !(Self { index, count }).range(parts).contains(&part) {
            index += 1;
        }
        Self { index, count }
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prop_shards_share_all_parts_once() {
        for (parts, count) in [(187, 8), (3, 8), (0, 4), (1000, 7), (8, 8), (5, 1)] {
            let all: Vec<usize> = (0..count)
                .flat_map(|index| Shard { index, count }.range(parts))
                .collect();
            assert_eq!(all, (0..parts).collect::<Vec<_>>());
            for p in 0..parts {
                assert!(
                    Shard::of(p, parts, count).range(parts).contains(&p),
                    "{p} of {parts}, {count}"
                );
            }
        }
    }

    fn of(pairs: &[(&str, &str)]) -> Result<Option<Shard>> {
        Shard::from_environment(|name| {
            let found = pairs.iter().find(|(k, _)| *k == name);
            found.map(|(_, v)| v.to_string())
        })
    }

    #[test]
    fn prop_jobs_say_their_shard() {
        let array = |id, min, max, count, step| {
            vec![
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_MIN", min),
                ("SLURM_ARRAY_TASK_MAX", max),
                ("SLURM_ARRAY_TASK_COUNT", count),
                ("SLURM_ARRAY_TASK_STEP", step),
            ]
        };
        let shard = |index, count| Some(Shard { index, count });
        assert_eq!(of(&[]).unwrap(), None);
        assert_eq!(of(&array("0", "0", "7", "8", "1")).unwrap(), shard(0, 8));
        assert_eq!(of(&array("8", "1", "8", "8", "1")).unwrap(), shard(7, 8));
        assert_eq!(of(&array("12", "10", "16", "4", "2")).unwrap(), shard(1, 4));
        // two tasks of an array of eight, run again
        let again = array("7", "3", "7", "2", "4");
        assert_eq!(of(&array("7", "3", "7", "2", "1")).unwrap_err().exit_code(), 4);
        assert_eq!(of(&[again, vec![(SHARDS, "8")]].concat()).unwrap(), shard(7, 8));
        assert_eq!(
            of(&[("JOB_COMPLETION_INDEX", "3"), (SHARDS, "8")]).unwrap(),
            shard(3, 8)
        );
        let line = of(&[("JOB_COMPLETION_INDEX", "3")]).unwrap_err().to_string();
        assert!(line.contains(SHARDS), "{line}");
        assert!(of(&[("JOB_COMPLETION_INDEX", "8"), (SHARDS, "8")]).is_err());
        assert_eq!(of(&[(SHARDS, "8")]).unwrap(), None);
    }

    #[test]
    fn refuse_shards_that_are_none() {
        for bad in ["", "3", "8/8", "-1/8", "a/b", "1/0"] {
            assert!(Shard::parse(bad).is_err(), "{bad}");
        }
        assert_eq!(Shard::parse("2/8").unwrap(), Shard { index: 2, count: 8 });
    }
}
