//! What is no query over the tables of a dataset.

use super::walk::{self, Met, Part};
use crate::Table;
use schemas::error::{Error, Result};
use sqlparser::ast::{DescribeAlias, ObjectName, ObjectNamePart, SetExpr, Statement, TableFactor};
use std::collections::BTreeSet;

const ALLOWED: &str = "one query (SELECT, WITH ... SELECT, UNION and the like), EXPLAIN of one, or SHOW TABLES";

fn bad(found: &str, allowed: impl Into<String>) -> Error {
    Error::bad("query", "SQL", short(found), allowed)
}

/// One line of at most sixty characters.
fn short(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    let line = words.join(" ");
    match line.char_indices().nth(60) {
        Some((end, _)) => format!("{} ...", line[..end].trim_end()),
        None => line,
    }
}

/// The names of all tables, for an error.
fn all_tables() -> String {
    let names: Vec<&str> = Table::ALL.iter().map(|t| t.name()).collect();
    format!("the tables {}", names.join(", "))
}

/// Refuses a number of statements other than one.
pub(super) fn statements(n: usize) -> Error {
    let found = if n == 0 {
        "no statement".to_string()
    } else {
        format!("{n} statements")
    };
    bad(&found, ALLOWED)
}

pub(super) fn is_show_tables(statement: &Statement) -> bool {
    // forms with options answer something else
    matches!(statement, Statement::ShowTables { .. }) && statement.to_string() == "SHOW TABLES"
}

/// Refuses what is no query and no plan of one, also where it stands within a query.
pub(super) fn other_than_query(statement: &Statement) -> Result<()> {
    let asked = match statement {
        Statement::Explain {
            describe_alias: DescribeAlias::Explain,
            analyze: false,
            statement: inner,
            ..
        } => inner,
        other => other,
    };
    if !matches!(asked, Statement::Query(_)) {
        return Err(bad(&statement.to_string(), ALLOWED));
    }
    let mut found = None;
    walk::all(statement, &mut |met| {
        if let Met::Query(query) = met {
            found = found.take().or_else(|| changes(&query.body));
        }
        found.is_none()
    });
    match found {
        Some(found) => Err(bad(&found, ALLOWED)),
        None => Ok(()),
    }
}

fn changes(body: &SetExpr) -> Option<String> {
    match body {
        SetExpr::Select(s) => s.into.as_ref().map(|into| format!("SELECT ... {into}")),
        SetExpr::Insert(s) | SetExpr::Update(s) | SetExpr::Delete(s) | SetExpr::Merge(s) => Some(s.to_string()),
        SetExpr::SetOperation { left, right, .. } => changes(left).or_else(|| changes(right)),
        // a query within is visited by itself
        SetExpr::Query(_) | SetExpr::Values(_) | SetExpr::Table(_) => None,
    }
}

/// The tables of the dataset that a statement names, in whatever case: there they are put into lower case.
///
/// # Errors
/// A table function, such as `read_parquet('...')`: it would read any file of the user.
pub(super) fn tables(statement: &mut Statement) -> Result<Vec<Table>> {
    let ctes = ctes(statement);
    ctes.iter().try_for_each(|name| new_name(name))?;
    let mut found = Vec::new();
    walk::change(statement, &mut |part| match part {
        Part::Table(factor) => check_factor(factor),
        Part::Name(name) => check_name(name, &ctes, &mut found),
        _ => Ok(()),
    })?;
    Ok(found)
}

fn table(name: &str) -> Option<Table> {
    Table::ALL.into_iter().find(|t| t.name().eq_ignore_ascii_case(name))
}

/// Refuses to give something the name of a table: polars would take the one for the other.
fn new_name(name: &str) -> Result<()> {
    match table(name) {
        Some(_) => Err(bad(
            &format!("the alias {name}"),
            format!("a name other than {}", all_tables()),
        )),
        None => Ok(()),
    }
}

/// The names that common table expressions have.
fn ctes(statement: &Statement) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    walk::all(statement, &mut |met| {
        if let Met::Query(query) = met {
            let ctes = query.with.iter().flat_map(|w| &w.cte_tables);
            names.extend(ctes.map(|c| c.alias.name.value.clone()));
        }
        true
    });
    names
}

/// Refuses table functions, and what is called like a table.
fn check_factor(factor: &TableFactor) -> Result<()> {
    let alias = match factor {
        TableFactor::Table { args: None, alias, .. }
        | TableFactor::Derived { alias, .. }
        | TableFactor::NestedJoin { alias, .. }
        | TableFactor::UNNEST { alias, .. } => alias,
        other => return Err(bad(&other.to_string(), all_tables())),
    };
    alias.as_ref().map_or(Ok(()), |a| new_name(&a.name.value))
}

/// Refuses a name that is neither that of a table nor of a common table expression; notes a table.
fn check_name(name: &mut ObjectName, ctes: &BTreeSet<String>, found: &mut Vec<Table>) -> Result<()> {
    let unknown = bad(&format!("table {name}"), all_tables());
    let [ObjectNamePart::Identifier(ident)] = name.0.as_mut_slice() else {
        return Err(unknown);
    };
    match table(&ident.value) {
        Some(table) => {
            ident.value = table.name().into();
            if !found.contains(&table) {
                found.push(table);
            }
            Ok(())
        }
        None if ctes.contains(&ident.value) => Ok(()),
        None => Err(unknown),
    }
}
