//! What a Parquet footer declares, checked before memory is taken for it.

use crate::error::{Error, Result};
use parquet::file::metadata::{ParquetMetaData, RowGroupMetaData};
use std::path::Path;

/// Rows that a byte of a file can stand for: times at a steady rate, packed and compressed, reach a tenth of it.
const MOST_ROWS_A_BYTE: u64 = 1 << 16;

/// Refuses a footer whose numbers contradict each other or the size of the file.
///
/// * `size` of the file [bytes]
///
/// # Errors
/// Rows below zero, more than the file can hold, or other than those of its row groups; pages beyond its end.
pub(crate) fn check(path: &Path, metadata: &ParquetMetaData, size: u64) -> Result<()> {
    let footer = metadata.file_metadata();
    let rows = count(path, "rows of the footer", footer.num_rows())?;
    let most = size.saturating_mul(MOST_ROWS_A_BYTE);
    if rows > most {
        let allowed = format!("at most {most} in a file of {size} bytes");
        return Err(bad(path, "rows of the footer", rows, allowed));
    }
    let mut sum = 0u64;
    for (k, group) in metadata.row_groups().iter().enumerate() {
        let there = count(path, &format!("rows of row group {k}"), group.num_rows())?;
        sum = sum.saturating_add(there);
        check_columns(path, k, group, size)?;
    }
    if sum != rows {
        return Err(bad(
            path,
            "rows of the row groups",
            sum,
            format!("{rows}, those of the footer"),
        ));
    }
    Ok(())
}

fn bad(path: &Path, place: &str, found: impl std::fmt::Display, allowed: String) -> Error {
    Error::bad(path.display().to_string(), place, found, allowed)
}

fn count(path: &Path, place: &str, found: i64) -> Result<u64> {
    u64::try_from(found).map_err(|_| bad(path, place, found, "0 or more".into()))
}

/// Checks where the pages of a row group's columns lie, and how many values they hold.
fn check_columns(path: &Path, k: usize, group: &RowGroupMetaData, size: u64) -> Result<()> {
    for column in group.columns() {
        let place = |what: &str| format!("{what} of column `{}`, row group {k}", column.column_path().string());
        let start = column
            .dictionary_page_offset()
            .unwrap_or_else(|| column.data_page_offset());
        let start = count(path, &place("first byte"), start)?;
        let bytes = count(path, &place("bytes"), column.compressed_size())?;
        count(path, &place("bytes before compression"), column.uncompressed_size())?;
        if start.saturating_add(bytes) > size {
            let found = format!("{bytes} from byte {start} on");
            return Err(bad(path, &place("bytes"), found, format!("a file of {size} bytes")));
        }
        let flat = column.column_descr().max_rep_level() == 0;
        if flat && column.num_values() != group.num_rows() {
            let allowed = format!("{}, the rows of the group", group.num_rows());
            return Err(bad(path, &place("values"), column.num_values(), allowed));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use parquet::basic::Type;
    use parquet::file::metadata::{FileMetaData, ParquetMetaDataBuilder};
    use parquet::schema::types::{SchemaDescriptor, Type as Node};
    use std::sync::Arc;

    /// A footer of so many rows, and row groups of so many, of one column.
    fn footer(rows: i64, groups: &[i64]) -> ParquetMetaData {
        let column = Node::primitive_type_builder("x", Type::DOUBLE).build().unwrap();
        let root = Node::group_type_builder("schema").with_fields(vec![Arc::new(column)]);
        let schema = Arc::new(SchemaDescriptor::new(Arc::new(root.build().unwrap())));
        let group = |&n: &i64| {
            let chunk = parquet::file::metadata::ColumnChunkMetaData::builder(schema.column(0))
                .set_num_values(n)
                .set_data_page_offset(4)
                .set_total_compressed_size(50)
                .build()
                .unwrap();
            let columns = vec![chunk];
            let builder = RowGroupMetaData::builder(schema.clone()).set_num_rows(n);
            builder.set_column_metadata(columns).build().unwrap()
        };
        let file = FileMetaData::new(2, rows, None, None, schema.clone(), None);
        let groups = groups.iter().map(group).collect();
        ParquetMetaDataBuilder::new(file).set_row_groups(groups).build()
    }

    fn refused(footer: &ParquetMetaData, size: u64) -> String {
        check(Path::new("f"), footer, size).unwrap_err().to_string()
    }

    #[test]
    fn the_rows_of_the_groups_are_those_of_the_footer() {
        check(Path::new("f"), &footer(7, &[3, 4]), 100).unwrap();
        let said = refused(&footer(8, &[3, 4]), 100);
        assert_eq!(
            said,
            "f: rows of the row groups: found 7; allowed: 8, those of the footer"
        );
        assert!(refused(&footer(-1, &[]), 100).contains("rows of the footer: found -1"));
        assert!(refused(&footer(7, &[8, -1]), 100).contains("row group 1: found -1"));
        // a sum beyond the range of numbers is no honest one
        assert!(check(Path::new("f"), &footer(7, &[i64::MAX, i64::MAX, 9]), 100).is_err());
    }

    #[test]
    fn a_file_holds_its_rows_and_pages() {
        let most = 100 * MOST_ROWS_A_BYTE as i64;
        check(Path::new("f"), &footer(most, &[most]), 100).unwrap();
        assert!(refused(&footer(most + 1, &[most + 1]), 100).contains("in a file of 100 bytes"));
        check(Path::new("f"), &footer(1, &[1]), 54).unwrap();
        assert!(refused(&footer(1, &[1]), 53).contains("found 50 from byte 4 on; allowed: a file of 53 bytes"));
    }
}
