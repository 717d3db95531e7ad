//! Conditions that polars refuses where SQL allows them, moved to where it takes them.

use super::names::alias;
use super::walk::{self, Met, Part};
use super::{columns, query, quoted};
use schemas::error::Result;
use sqlparser::ast::{
    BinaryOperator, Expr, Function, GroupByExpr, Ident, Join, JoinConstraint, JoinOperator, Query, Select, SelectItem,
    SetExpr, TableFactor,
};

/// The parts of `a AND b AND c`.
fn parts(e: Expr) -> Vec<Expr> {
    match e {
        Expr::BinaryOp {
            left,
            op: BinaryOperator::And,
            right,
        } => parts(*left).into_iter().chain(parts(*right)).collect(),
        Expr::Nested(inner) => parts(*inner),
        other => vec![other],
    }
}

/// In parentheses, if `AND` binds tighter.
fn nested(e: Expr) -> Expr {
    match e {
        Expr::BinaryOp {
            op: BinaryOperator::Or | BinaryOperator::Xor,
            ..
        } => Expr::Nested(Box::new(e)),
        other => other,
    }
}

/// `a AND b AND c`; nothing of nothing.
fn all(parts: Vec<Expr>) -> Option<Expr> {
    parts.into_iter().map(nested).reduce(|a, b| Expr::BinaryOp {
        left: Box::new(a),
        op: BinaryOperator::And,
        right: Box::new(b),
    })
}

/// Conditions of a join on its right table alone filter that table before.
pub(super) fn of_joins(select: &mut Select) -> Result<()> {
    let joins = select.from.iter_mut().flat_map(|t| &mut t.joins);
    joins.into_iter().try_for_each(of_join)
}

fn of_join(join: &mut Join) -> Result<()> {
    let Some(name) = name(&join.relation) else {
        return Ok(());
    };
    let (JoinOperator::Join(on) | JoinOperator::Inner(on) | JoinOperator::Left(on) | JoinOperator::LeftOuter(on)) =
        &mut join.join_operator
    else {
        return Ok(());
    };
    let JoinConstraint::On(condition) = on else {
        return Ok(());
    };
    let of_right =
        |e: &Expr| columns(e).is_some_and(|c| !c.is_empty() && c.iter().all(|c| c.len() == 2 && c[0] == name));
    let (right, both): (Vec<Expr>, Vec<Expr>) = parts(condition.clone()).into_iter().partition(of_right);
    if let (Some(filter), Some(rest)) = (all(right), all(both)) {
        *condition = rest;
        join.relation = filtered(&join.relation, &filter, &name)?;
    }
    Ok(())
}

/// The name that columns of a relation are called by.
fn name(relation: &TableFactor) -> Option<String> {
    match relation {
        TableFactor::Table { alias: Some(a), .. } | TableFactor::Derived { alias: Some(a), .. } => {
            Some(a.name.value.clone())
        }
        TableFactor::Table { name, alias: None, .. } => Some(name.0.last()?.as_ident()?.value.clone()),
        _ => None,
    }
}

/// `(SELECT * FROM relation WHERE filter) AS name`
fn filtered(relation: &TableFactor, filter: &Expr, name: &str) -> Result<TableFactor> {
    let text = format!(
        "SELECT * FROM (SELECT * FROM {relation} WHERE {filter}) AS {}",
        quoted(name)
    );
    Ok(relation_of(query(&text)?))
}

/// The first relation of a query made here.
fn relation_of(query: Query) -> TableFactor {
    match *query.body {
        SetExpr::Select(mut s) => s.from.remove(0).relation,
        _ => unreachable!("made as a SELECT"),
    }
}

/// Conditions of HAVING on grouped columns alone filter the rows before.
pub(super) fn of_having(select: &mut Select) {
    let GroupByExpr::Expressions(keys, _) = &select.group_by else {
        return;
    };
    let aliases: Vec<String> = select.projection.iter().filter_map(alias).collect();
    let grouped: Vec<Vec<String>> = keys
        .iter()
        .filter_map(|k| super::column(k).map(|c| c.into_iter().map(String::from).collect()))
        .filter(|c: &Vec<String>| c.len() > 1 || !aliases.contains(&c[0]))
        .collect();
    let Some(having) = select.having.take() else { return };
    let of_keys =
        |e: &Expr| columns(e).is_some_and(|c| !c.is_empty() && c.iter().all(|c| grouped.contains(c))) && !aggregates(e);
    let (rows, groups): (Vec<Expr>, Vec<Expr>) = parts(having).into_iter().partition(of_keys);
    select.having = all(groups);
    select.selection = all(select.selection.take().into_iter().chain(rows).collect());
}

/// Functions of many rows.
const AGGREGATES: &str = "avg corr count covar covar_pop covar_samp first last max median min quantile_cont \
    quantile_disc stddev stddev_pop stddev_samp stdev stdev_samp sum var var_pop var_samp variance";

fn is_aggregate(e: &Expr) -> bool {
    let named = |f: &Function| {
        AGGREGATES
            .split(' ')
            .any(|n| f.name.to_string().eq_ignore_ascii_case(n))
    };
    matches!(e, Expr::Function(f) if f.over.is_none() && named(f))
}

/// Whether an expression has an aggregate in it, outside of subqueries.
fn aggregates(e: &Expr) -> bool {
    let mut depth = 0;
    !walk::all(e, &mut |met| {
        match met {
            Met::Query(_) => depth += 1,
            Met::QueryEnd => depth -= 1,
            Met::Expr(e) => return depth > 0 || !is_aggregate(e),
        }
        true
    })
}

/// `x > (SELECT AVG(x) FROM t)` in WHERE: the subquery, which has one row whatever its table holds, is joined.
pub(super) fn scalar_subqueries(select: &mut Select, name: &mut dyn FnMut(&str) -> String) -> Result<()> {
    let Some(selection) = &mut select.selection else {
        return Ok(());
    };
    if select.from.is_empty() {
        return Ok(());
    }
    let mut depth = 0;
    let mut found = Vec::new();
    walk::change(selection, &mut |part| {
        match part {
            Part::QueryBegin => depth += 1,
            Part::Query(_) => depth -= 1,
            Part::Expr(e) if depth == 0 => found.extend(take_scalar(e, name)),
            _ => {}
        }
        Ok(())
    })?;
    if found.is_empty() {
        return Ok(());
    }
    let hidden: Vec<&str> = found.iter().map(|(column, _)| column.as_str()).collect();
    hide(select, &hidden);
    for (column, subquery) in &found {
        let text = format!(
            "SELECT * FROM t CROSS JOIN ({subquery}) AS {}",
            quoted(&format!("{column}_of"))
        );
        let SetExpr::Select(mut made) = *query(&text)?.body else {
            continue;
        };
        let join = made.from.remove(0).joins.remove(0);
        if let Some(last) = select.from.last_mut() {
            last.joins.push(join);
        }
    }
    Ok(())
}

/// Leaves columns out of `*`.
fn hide(select: &mut Select, columns: &[&str]) {
    use sqlparser::ast::ExcludeSelectItem;
    let names = columns.iter().map(|c| Ident::with_quote('"', *c).into());
    for item in &mut select.projection {
        if let SelectItem::Wildcard(options) = item
            && options.opt_exclude.is_none()
        {
            options.opt_exclude = Some(ExcludeSelectItem::Multiple(names.clone().collect()));
        }
    }
}

/// Puts the name of a column in the place of a scalar subquery; gives the name, and the subquery with its column named.
fn take_scalar(e: &mut Expr, name: &mut dyn FnMut(&str) -> String) -> Option<(String, Box<Query>)> {
    let Expr::Subquery(subquery) = e else { return None };
    let named = scalar(subquery, name)?;
    *e = Expr::Identifier(Ident::with_quote('"', &named.0));
    Some(named)
}

/// A subquery of one aggregate over all rows, its column named.
fn scalar(subquery: &Query, name: &mut dyn FnMut(&str) -> String) -> Option<(String, Box<Query>)> {
    let mut named = Box::new(subquery.clone());
    let SetExpr::Select(select) = named.body.as_mut() else {
        return None;
    };
    let ungrouped = matches!(&select.group_by, GroupByExpr::Expressions(keys, _) if keys.is_empty());
    let [SelectItem::UnnamedExpr(expr) | SelectItem::ExprWithAlias { expr, .. }] = select.projection.as_slice() else {
        return None;
    };
    if !ungrouped || !aggregates(expr) || subquery.limit_clause.is_some() || subquery.fetch.is_some() {
        return None;
    }
    let column = name("scalar");
    select.projection = vec![SelectItem::ExprWithAlias {
        expr: expr.clone(),
        alias: Ident::with_quote('"', &column),
    }];
    Some((column, named))
}
