//! Rows of a table that a bench file makes runs of, and their channels in SI.

use crate::measured::bench::{ChannelSpec, RunSpec};
use ema_tables::{Table, UnitFrom};
use schemas::error::{Error, Result};

pub(crate) type Labels = Vec<(String, String)>;

/// Rows of each run that a `[[run]]` makes of its file.
pub(crate) fn split(table: &Table, spec: &RunSpec) -> Result<Vec<(Labels, Vec<usize>)>> {
    let mut rows: Vec<usize> = (0..table.rows).collect();
    for (column, values) in &spec.filter {
        let texts = table.texts(column)?;
        rows.retain(|&r| values.contains(&texts[r]));
        if rows.is_empty() {
            let found = format!("no row with {column} = {}", values.join(" or "));
            return Err(Error::bad(&table.file, "where", found, "a value that is there"));
        }
    }
    let single = |f: &&(String, Vec<String>)| f.1.len() == 1;
    let fixed: Labels = spec
        .filter
        .iter()
        .filter(single)
        .map(|(c, v)| (c.clone(), v[0].clone()))
        .collect();
    if spec.split.is_empty() {
        return Ok(vec![(fixed, rows)]);
    }
    let keys = spec.split.iter().map(|c| table.texts(c));
    let keys = keys.collect::<Result<Vec<_>>>()?;
    let mut groups: Vec<(Labels, Vec<usize>)> = Vec::new();
    for r in rows {
        let values = spec.split.iter().zip(&keys).map(|(c, k)| (c.clone(), k[r].clone()));
        let labels: Labels = fixed.iter().cloned().chain(values).collect();
        match groups.iter_mut().find(|(l, _)| *l == labels) {
            Some((_, rows)) => rows.push(r),
            None => groups.push((labels, vec![r])),
        }
    }
    Ok(groups)
}

/// A column of a channel, and its factor to SI at the motor. A unit that the file states itself is obeyed.
pub(crate) fn column<'a>(table: &'a Table, c: &ChannelSpec, name: &str) -> Result<(&'a [f64], f64)> {
    let values = table.numbers(name)?;
    let q = c.channel.quantity();
    let own = c.factor / c.unit_factor;
    let factor = match table.unit_from(name, c.unit.as_deref(), q.si())? {
        UnitFrom::File => own,
        UnitFrom::Bench | UnitFrom::Nobody => c.factor,
        // what is in brackets need not be a unit
        UnitFrom::Header(unit) => q.factor(unit, c.lead).map_or(c.factor, |f| own * f),
    };
    Ok((values, factor))
}

/// A channel in the rows of a run, less the column that is to be taken off, SI at the motor.
pub(crate) fn in_si(table: &Table, c: &ChannelSpec, rows: &[usize]) -> Result<Vec<f64>> {
    let (x, factor) = column(table, c, &c.column)?;
    let Some(minus) = &c.minus else {
        return Ok(rows.iter().map(|&r| x[r] * factor).collect());
    };
    let (m, of_minus) = column(table, c, minus)?;
    let value = |&r: &usize| {
        if factor == of_minus {
            (x[r] - m[r]) * factor
        } else {
            x[r] * factor - m[r] * of_minus
        }
    };
    Ok(rows.iter().map(value).collect())
}
