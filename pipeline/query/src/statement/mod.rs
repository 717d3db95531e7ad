//! A statement before polars reads it: what it may be, and what polars would answer otherwise than other SQL engines.
//!
//! polars takes DDL and DML (`DROP TABLE`, `DELETE`, `CREATE TABLE AS` ...) and readers of files in FROM. A dataset is
//! read here, and nothing else: [`refuse`] lets queries over its tables through. Some queries that SQL allows polars
//! refuses, or answers in a way of its own; they are put into equal ones that it answers as SQL says: [`names`] of
//! columns without an alias, the sort keys of [`order`], the [`conditions`] of joins, of HAVING, and with scalar
//! subqueries.

mod conditions;
mod names;
mod order;
mod refuse;
mod walk;

use crate::Table;
use schemas::error::Result;
use sqlparser::ast::{Expr, Query, Select, SetExpr, Statement};
use sqlparser::dialect::GenericDialect;
use sqlparser::parser::{Parser, ParserError, ParserOptions};
use std::collections::BTreeSet;
use walk::{Met, Part};

/// What a statement asks for.
#[derive(Debug)]
pub(crate) enum Asked {
    /// `SHOW TABLES`: the names of the tables that the dataset has.
    Tables,
    /// A query, or the plan of one.
    Query {
        /// The statement in words that polars answers as SQL says.
        sql: String,
        /// The tables that it names.
        tables: Vec<Table>,
    },
}

/// Checks a statement and puts it into the words of polars.
///
/// # Errors
/// SQL that is none, more than one statement, a statement that is no query, a table function.
pub(crate) fn read(sql: &str) -> Result<Asked> {
    let mut parsed = parser(sql)
        .and_then(|mut p| p.parse_statements())
        .map_err(|e| super::bad_sql(one_line(&e)))?;
    if parsed.len() != 1 {
        return Err(refuse::statements(parsed.len()));
    }
    let mut statement = parsed.remove(0);
    if refuse::is_show_tables(&statement) {
        return Ok(Asked::Tables);
    }
    refuse::other_than_query(&statement)?;
    let tables = refuse::tables(&mut statement)?;
    rewrite(&mut statement)?;
    Ok(Asked::Query {
        sql: statement.to_string(),
        tables,
    })
}

/// The parser as polars sets it up.
fn parser(sql: &str) -> std::result::Result<Parser<'_>, ParserError> {
    let options = ParserOptions {
        trailing_commas: true,
        ..ParserOptions::default()
    };
    Parser::new(&GenericDialect).with_options(options).try_with_sql(sql)
}

fn one_line(e: &ParserError) -> String {
    let text = e.to_string();
    let text = text.strip_prefix("sql parser error: ").unwrap_or(&text);
    text.lines().next().unwrap_or_default().to_string()
}

/// A query made here.
///
/// # Errors
/// None that input could cause: the text is put together from parts of a parsed statement.
fn query(text: &str) -> Result<Query> {
    let parsed = parser(text).and_then(|mut p| p.parse_query());
    parsed.map(|q| *q).map_err(|e| super::bad_sql(one_line(&e)))
}

/// A name as it stands quoted in a statement.
fn quoted(name: &str) -> String {
    format!("\"{}\"", name.replace('"', "\"\""))
}

/// Puts every query of a statement, the innermost first, into words that polars answers as SQL says.
fn rewrite(statement: &mut Statement) -> Result<()> {
    let mut made = 0;
    // names that no table or column has
    let mut name = |what: &str| {
        made += 1;
        format!("__{what}_{made}")
    };
    walk::change(statement, &mut |part| match part {
        Part::Select(select) => rewrite_select(select, &mut name),
        Part::Query(query) => rewrite_query(query, &mut name),
        _ => Ok(()),
    })
}

fn rewrite_select(select: &mut Select, name: &mut dyn FnMut(&str) -> String) -> Result<()> {
    conditions::of_joins(select)?;
    conditions::of_having(select);
    conditions::scalar_subqueries(select, name)?;
    names::of_columns(select);
    Ok(())
}

fn rewrite_query(query: &mut Query, name: &mut dyn FnMut(&str) -> String) -> Result<()> {
    order::nulls_last(query);
    match query.body.as_ref() {
        SetExpr::Select(_) => order::of_select(query, name),
        SetExpr::SetOperation { .. } => order::of_set_operation(query, name),
        _ => Ok(()),
    }
}

/// The names of a column reference, table first; nothing for any other expression.
fn column(e: &Expr) -> Option<Vec<&str>> {
    match e {
        Expr::Identifier(i) => Some(vec![&i.value]),
        Expr::CompoundIdentifier(parts) => Some(parts.iter().map(|i| i.value.as_str()).collect()),
        _ => None,
    }
}

/// The column references of an expression, as [`column`]; nothing if it has a subquery of its own.
fn columns(e: &Expr) -> Option<BTreeSet<Vec<String>>> {
    let mut found = BTreeSet::new();
    let whole = walk::all(e, &mut |met| {
        if let Met::Expr(e) = met {
            found.extend(column(e).map(|c| c.into_iter().map(String::from).collect()));
        }
        !matches!(met, Met::Query(_))
    });
    whole.then_some(found)
}
