//! Names of columns that a query gives none: polars names an expression after the first column in it, so that
//! `AVG(x)` and `MAX(x)` would both be `x`, and refuses two columns of one name.

use super::column;
use super::walk::{self, Part};
use sqlparser::ast::{
    Expr, Function, FunctionArg, FunctionArgExpr, FunctionArguments, Ident, ObjectNamePart, Select, SelectItem,
};
use std::collections::BTreeSet;

/// The name of an item in the answer; nothing for a wildcard.
pub(super) fn of(item: &SelectItem) -> Option<String> {
    match item {
        SelectItem::ExprWithAlias { alias, .. } => Some(alias.value.clone()),
        SelectItem::UnnamedExpr(e) => column(e).and_then(|c| c.last().map(|n| n.to_string())),
        _ => None,
    }
}

/// The expression of an item; nothing for a wildcard.
pub(super) fn expression(item: &SelectItem) -> Option<&Expr> {
    match item {
        SelectItem::ExprWithAlias { expr, .. } | SelectItem::UnnamedExpr(expr) => Some(expr),
        _ => None,
    }
}

/// Names every expression after its text, and tells columns of one name apart by `_1`, `_2` ...
pub(super) fn of_columns(select: &mut Select) {
    let mut used: BTreeSet<String> = select.projection.iter().filter_map(alias).collect();
    for item in &mut select.projection {
        let SelectItem::UnnamedExpr(e) = item else { continue };
        if many(e) {
            continue;
        }
        let plain = column(e).and_then(|c| c.last().map(|n| n.to_string()));
        let wanted = plain.clone().unwrap_or_else(|| text(e));
        let name = free(&wanted, &used);
        if plain.as_ref() != Some(&name) {
            *item = SelectItem::ExprWithAlias {
                expr: e.clone(),
                alias: Ident::with_quote('"', &name),
            };
        }
        used.insert(name);
    }
}

/// The alias of an item; nothing where it has none.
pub(super) fn alias(item: &SelectItem) -> Option<String> {
    match item {
        SelectItem::ExprWithAlias { alias, .. } => Some(alias.value.clone()),
        _ => None,
    }
}

fn free(wanted: &str, used: &BTreeSet<String>) -> String {
    let numbered = (1..).map(|k| format!("{wanted}_{k}"));
    let mut names = std::iter::once(wanted.to_string()).chain(numbered);
    names.find(|n| !used.contains(n)).expect("one of them is free")
}

/// Whether an expression is more than one column, or more than one row.
fn many(e: &Expr) -> bool {
    let named = |f: &Function| matches!(f.name.to_string().to_lowercase().as_str(), "columns" | "unnest");
    matches!(e, Expr::Function(f) if named(f))
}

/// The text of an expression as DuckDB names it: functions in lower case, `count_star()`, operations in parentheses.
fn text(e: &Expr) -> String {
    let mut e = e.clone();
    // the walk has no errors
    let _ = walk::change(&mut e, &mut |part| {
        match part {
            Part::Expr(Expr::Function(f)) => spell(f),
            Part::Expr(e @ Expr::BinaryOp { .. }) => *e = Expr::Nested(Box::new(e.clone())),
            Part::Expr(e) => unnest(e),
            _ => {}
        }
        Ok(())
    });
    e.to_string()
}

/// One pair of parentheses for two.
fn unnest(e: &mut Expr) {
    if let Expr::Nested(inner) = e
        && matches!(**inner, Expr::Nested(_))
    {
        *e = (**inner).clone();
    }
}

fn spell(f: &mut Function) {
    for part in &mut f.name.0 {
        if let ObjectNamePart::Identifier(i) = part {
            i.value = i.value.to_lowercase();
        }
    }
    let FunctionArguments::List(list) = &mut f.args else {
        return;
    };
    let all = [FunctionArg::Unnamed(FunctionArgExpr::Wildcard)];
    if list.args == all && f.name.to_string() == "count" {
        list.args.clear();
        f.name = Ident::new("count_star").into();
    }
}
