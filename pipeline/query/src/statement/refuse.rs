//! What is no query over the tables of a dataset.

use crate::Table;
use schemas::error::{Error, Result};
use sqlparser::ast::{
    DescribeAlias, Ident, ObjectName, ObjectNamePart, Query, SetExpr, Statement, TableFactor, Visit, VisitMut, Visitor,
    VisitorMut,
};
use std::collections::BTreeSet;
use std::ops::ControlFlow;

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
    match statement.visit(&mut Queries) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(found) => Err(bad(&found, ALLOWED)),
    }
}

/// Stops at a query whose body changes something.
struct Queries;

impl Visitor for Queries {
    type Break = String;

    fn pre_visit_query(&mut self, query: &Query) -> ControlFlow<String> {
        match changes(&query.body) {
            Some(found) => ControlFlow::Break(found),
            None => ControlFlow::Continue(()),
        }
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
    let mut ctes = Ctes::default();
    let _ = Visit::visit(statement, &mut ctes);
    ctes.0.iter().try_for_each(|name| new_name(name))?;
    let mut relations = Relations {
        ctes: ctes.0,
        found: Vec::new(),
    };
    match VisitMut::visit(statement, &mut relations) {
        ControlFlow::Continue(()) => Ok(relations.found),
        ControlFlow::Break(e) => Err(e),
    }
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
#[derive(Default)]
struct Ctes(BTreeSet<String>);

impl Visitor for Ctes {
    type Break = ();

    fn pre_visit_query(&mut self, query: &Query) -> ControlFlow<()> {
        let ctes = query.with.iter().flat_map(|w| &w.cte_tables);
        self.0.extend(ctes.map(|c| c.alias.name.value.clone()));
        ControlFlow::Continue(())
    }
}

struct Relations {
    ctes: BTreeSet<String>,
    found: Vec<Table>,
}

impl VisitorMut for Relations {
    type Break = Error;

    fn pre_visit_table_factor(&mut self, factor: &mut TableFactor) -> ControlFlow<Error> {
        let alias = match factor {
            TableFactor::Table { args: None, alias, .. }
            | TableFactor::Derived { alias, .. }
            | TableFactor::NestedJoin { alias, .. }
            | TableFactor::UNNEST { alias, .. } => alias,
            other => return ControlFlow::Break(bad(&other.to_string(), all_tables())),
        };
        match alias.as_ref().map(|a| new_name(&a.name.value)) {
            Some(Err(e)) => ControlFlow::Break(e),
            _ => ControlFlow::Continue(()),
        }
    }

    fn pre_visit_relation(&mut self, name: &mut ObjectName) -> ControlFlow<Error> {
        let known = match name.0.as_mut_slice() {
            [ObjectNamePart::Identifier(ident)] => self.note(ident),
            _ => false,
        };
        match known {
            true => ControlFlow::Continue(()),
            false => ControlFlow::Break(bad(&format!("table {name}"), all_tables())),
        }
    }
}

impl Relations {
    /// Whether a name is that of a table or a common table expression.
    fn note(&mut self, ident: &mut Ident) -> bool {
        let Some(table) = table(&ident.value) else {
            return self.ctes.contains(&ident.value);
        };
        ident.value = table.name().into();
        if !self.found.contains(&table) {
            self.found.push(table);
        }
        true
    }
}
