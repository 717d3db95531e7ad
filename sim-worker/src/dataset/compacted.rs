//! Files of features after the merge: the rows of many parts, and the receipts of their telemetry, so that a flipped
//! bit is found without the manifest too.

use super::parts::Part;
use super::plan::DatasetPlan;
use super::tables::{PartRows, Receipt, Table, checksum_of, features_file};
use crate::noise::FeatureValues;
use bytes::Bytes;
use schemas::error::{Error, Result};
use std::path::Path;

/// Metadata with the checksum of all that the file holds.
const CHECKSUM: &str = "ema.checksum";

/// Metadata with a line for each part that keeps telemetry: part, bytes, rows, checksum.
const TELEMETRY: &str = "ema.telemetry";

/// What is in one file of features.
#[derive(Clone, Debug, PartialEq)]
pub struct Compacted {
    /// by part and run, in order
    pub rows: Vec<Vec<FeatureValues>>,
    /// by part; none where no telemetry is kept
    pub telemetry: Vec<Option<Receipt>>,
}

impl Compacted {
    /// As a Parquet file.
    ///
    /// * `parts` of the rows
    ///
    /// # Errors
    /// What the Parquet writer refuses.
    pub fn to_bytes(&self, plan: &DatasetPlan, parts: &[&Part]) -> Result<Vec<u8>> {
        let mut groups: Vec<Vec<PartRows<'_>>> = Vec::new();
        let per_group = plan.actuators_per_row_group();
        let mut last = None;
        for (part, rows) in parts.iter().zip(&self.rows) {
            let group = part.actuator / per_group;
            if last.replace(group) != Some(group) {
                groups.push(Vec::new());
            }
            let rows = rows.clone();
            groups.last_mut().expect("just pushed").push(PartRows { part, rows });
        }
        let receipts = self.receipts(parts);
        let pairs = vec![
            (CHECKSUM.to_string(), self.checksum(&receipts)),
            (TELEMETRY.into(), receipts),
        ];
        features_file(plan, &groups, pairs)
    }

    /// Reads one; `None` where it has no checksum, of a version that wrote none.
    ///
    /// * `parts` whose rows it should have, in order
    /// * `same_program` it was made by this version of the program, so that it can be compared bit by bit
    ///
    /// # Errors
    /// A torn or changed file, rows that are not those of `parts`.
    pub fn from_bytes(
        plan: &DatasetPlan,
        path: &str,
        bytes: Bytes,
        parts: &[&Part],
        same_program: bool,
    ) -> Result<Option<Self>> {
        let table = Table::read(path, bytes.clone())?;
        let stated = table.pair(CHECKSUM);
        let receipts = table.pair(TELEMETRY);
        if stated == "nothing" {
            return Ok(None);
        }
        let changed = |what: &str| Error::torn(Path::new(path), format!("changed: {what}"));
        let planned = parts.iter().flat_map(|p| p.runs.clone());
        if !table.numbers("run")?.into_iter().eq(planned) {
            return Err(changed("other runs than those of its parts"));
        }
        let mut all = table.features()?.into_iter();
        let read = |part: &&Part| receipts.lines().find_map(|line| receipt_of(line, part.number));
        let compacted = Self {
            rows: parts
                .iter()
                .map(|p| all.by_ref().take((p.runs.end - p.runs.start) as usize).collect())
                .collect(),
            telemetry: parts.iter().map(read).collect(),
        };
        if compacted.checksum(&receipts) != stated || compacted.receipts(parts) != receipts {
            return Err(changed("another checksum than when it was put together"));
        }
        if same_program && compacted.to_bytes(plan, parts)? != bytes {
            return Err(changed("its rows are written in another way"));
        }
        Ok(Some(compacted))
    }

    fn receipts(&self, parts: &[&Part]) -> String {
        let line = |(part, receipt): (&&Part, &Option<Receipt>)| {
            let r = receipt.as_ref()?;
            Some(format!("{} {} {} {}\n", part.number, r.bytes, r.rows, r.blake3))
        };
        parts.iter().zip(&self.telemetry).filter_map(line).collect()
    }

    fn checksum(&self, receipts: &str) -> String {
        checksum_of(receipts.to_string(), self.rows.iter().flatten())
    }
}

/// The receipt in a line, if it is that of the part.
fn receipt_of(line: &str, part: usize) -> Option<Receipt> {
    let mut words = line.split(' ');
    let mut number = || words.next()?.parse::<u64>().ok();
    if number()? != part as u64 {
        return None;
    }
    let (bytes, rows) = (number()?, number()?);
    let blake3 = words.next()?.to_string();
    Some(Receipt { bytes, blake3, rows })
}
