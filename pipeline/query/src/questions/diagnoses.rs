//! How good the diagnoses of a fleet are: by tail number, and by region of the fault plane.

use super::{Answer, answer as table, counts, numbers, region, words};
use crate::fleet::{floats, texts};
use crate::{Table, stats};
use anyhow::Result;
use polars::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

const OUTCOMES: [&str; 4] = ["located", "unexplained", "out_of_range", "incomplete"];
const NUMBERS: [&str; 6] = ["fsj", "zeta", "fsj_lo", "fsj_hi", "zeta_lo", "zeta_hi"];

pub fn reads(dir: &Path) -> Result<Vec<LazyFrame>> {
    let wanted = ["maps", "tail", "outcome"].into_iter().chain(NUMBERS).map(col);
    Ok(vec![Table::Diagnoses.scan(dir)?.select(wanted.collect::<Vec<_>>())])
}

/// Diagnoses of one group.
#[derive(Default)]
struct Tally {
    tests: usize,
    outcomes: [usize; 4],
    inside: usize,
    located_inside: usize,
    /// Widths of the intervals of FSJ and of zeta.
    widths: [Vec<f64>; 2],
}

/// Texts as numbers that sort as the texts do.
fn ranked(frame: &DataFrame, name: &str, dir: &Path) -> Result<(Vec<String>, Vec<u32>)> {
    let (distinct, numbers) = texts(frame, name, dir)?;
    let mut order: Vec<usize> = (0..distinct.len()).collect();
    order.sort_by_key(|&i| &distinct[i]);
    let mut rank = vec![0; order.len()];
    order.iter().enumerate().for_each(|(to, &from)| rank[from] = to as u32);
    let sorted = order.iter().map(|&i| distinct[i].clone()).collect();
    Ok((sorted, numbers.into_iter().map(|n| rank[n as usize]).collect()))
}

/// Diagnoses by maps (`own`, `type`) and a second key.
struct Tallies {
    maps: Vec<String>,
    tails: Vec<String>,
    by: BTreeMap<(u32, u32), Tally>,
    notes: Vec<String>,
}

impl Tallies {
    /// * `keys` from the number of the tail and the true pair to the keys to count under
    fn new(dir: &Path, frame: &DataFrame, keys: impl Fn(u32, f64, f64) -> [Option<u32>; 2]) -> Result<Self> {
        let (maps, map) = ranked(frame, "maps", dir)?;
        let (tails, tail) = ranked(frame, "tail", dir)?;
        let (outcomes, outcome) = texts(frame, "outcome", dir)?;
        let columns: Vec<Vec<f64>> = NUMBERS.iter().map(|n| floats(frame, n, dir)).collect::<Result<_>>()?;
        let known: Vec<Option<usize>> = outcomes.iter().map(|o| OUTCOMES.iter().position(|x| x == o)).collect();
        let mut by = BTreeMap::<_, Tally>::new();
        let mut strange = 0;
        for i in 0..frame.height() {
            let [fsj, zeta, fsj_lo, fsj_hi, zeta_lo, zeta_hi] = std::array::from_fn(|k| columns[k][i]);
            let inside = fsj_lo <= fsj && fsj <= fsj_hi && zeta_lo <= zeta && zeta <= zeta_hi;
            let outcome = known[outcome[i] as usize];
            strange += usize::from(outcome.is_none());
            for key in keys(tail[i], fsj, zeta).into_iter().flatten() {
                let t = by.entry((map[i], key)).or_default();
                t.tests += 1;
                t.inside += usize::from(inside);
                if let Some(o) = outcome {
                    t.outcomes[o] += 1;
                    t.located_inside += usize::from(inside && o == 0);
                }
                t.widths[0].push(fsj_hi - fsj_lo);
                t.widths[1].push(zeta_hi - zeta_lo);
            }
        }
        let mut notes = Vec::new();
        if strange > 0 {
            notes.push(format!(
                "{strange} diagnoses have none of the outcomes {}",
                OUTCOMES.join(", ")
            ));
        }
        Ok(Self { maps, tails, by, notes })
    }

    fn maps(&self) -> Column {
        words("maps", self.by.keys().map(|k| self.maps[k.0 as usize].as_str()))
    }

    /// The columns that both questions end with.
    fn columns(&mut self) -> Vec<Column> {
        let mut rows: Vec<&mut Tally> = self.by.values_mut().collect();
        let count = |name: &str, f: &dyn Fn(&Tally) -> usize| counts(name, rows.iter().map(|r| f(r)));
        let share = |name: &str, f: &dyn Fn(&Tally) -> f64| numbers(name, rows.iter().map(|r| f(r)));
        let mut out = vec![count("tests", &|t| t.tests)];
        out.extend((0..4).map(|k| count(OUTCOMES[k], &|t| t.outcomes[k])));
        out.extend([
            count("inside", &|t| t.inside),
            share("inside_share", &|t| t.inside as f64 / t.tests as f64),
            share("inside_share_lo", &|t| stats::wilson(t.inside, t.tests).0),
            share("inside_share_hi", &|t| stats::wilson(t.inside, t.tests).1),
            share("inside_share_of_located", &|t| {
                t.located_inside as f64 / t.outcomes[0] as f64
            }),
        ]);
        for (k, name) in ["median_width_fsj", "median_width_zeta"].into_iter().enumerate() {
            let medians = rows.iter_mut().map(|t| stats::median(stats::numbers(&mut t.widths[k])));
            out.push(numbers(name, medians.collect::<Vec<_>>()));
        }
        out
    }
}

/// One row a set of maps and tail, then one for all tails (`total`).
///
/// `inside`: the true pair lies in both intervals; a test without intervals is not inside. `inside_share` is of
/// all tests, with its 95 % bounds after Wilson; `inside_share_of_located` of those with the outcome `located`.
pub fn coverage(dir: &Path, frames: &[DataFrame]) -> Result<Answer> {
    const TOTAL: u32 = u32::MAX;
    let mut tallies = Tallies::new(dir, &frames[0], |tail, _, _| [Some(tail), Some(TOTAL)])?;
    let label = |k: u32| tallies.tails.get(k as usize).map_or("total", String::as_str);
    let mut out = vec![tallies.maps(), words("tail", tallies.by.keys().map(|k| label(k.1)))];
    out.extend(tallies.columns());
    table(out, tallies.notes)
}

/// One row a set of maps and region of the fault plane in which the true pair lies; the rest as
/// in [`coverage`].
pub fn outcomes(dir: &Path, frames: &[DataFrame]) -> Result<Answer> {
    let key = |_, fsj, zeta| [region::of(fsj, zeta).map(|r| r as u32), None];
    let mut tallies = Tallies::new(dir, &frames[0], key)?;
    let regions: Vec<usize> = tallies.by.keys().map(|k| k.1 as usize).collect();
    let mut out = vec![tallies.maps()];
    out.extend(region::columns(&regions));
    out.extend(tallies.columns());
    table(out, tallies.notes)
}
