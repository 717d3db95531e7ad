//! Sort keys. polars looks for them in the answer, where a column of a joined or grouped table has another name or is
//! none any more; and it puts nulls first where it sorts downwards.

use super::{names, query, quoted};
use schemas::error::Result;
use sqlparser::ast::{
    Distinct, Expr, GroupByExpr, Ident, OrderByExpr, OrderByKind, OrderByOptions, Query, Select, SelectItem, SetExpr,
    Value,
};

/// Nulls come last unless a key says otherwise, as in DuckDB.
pub(super) fn nulls_last(query: &mut Query) {
    let last = |o: &mut OrderByOptions| o.nulls_first = Some(o.nulls_first.unwrap_or(false));
    match query.order_by.as_mut().map(|o| &mut o.kind) {
        Some(OrderByKind::All(options)) => last(options),
        Some(OrderByKind::Expressions(keys)) => keys.iter_mut().for_each(|k| last(&mut k.options)),
        None => {}
    }
}

/// Whether a key is a place in the list of columns: `ORDER BY 2`.
fn is_place(key: &Expr) -> bool {
    matches!(key, Expr::Value(v) if matches!(v.value, Value::Number(..)))
}

/// The name of the column of the answer that a key is.
fn in_answer(key: &Expr, select: &Select) -> Option<String> {
    let items = select.projection.iter();
    if let Expr::Identifier(i) = key
        && items.clone().any(|item| names::of(item).as_ref() == Some(&i.value))
    {
        return Some(i.value.clone());
    }
    let mut same = items.filter(|item| names::expression(item) == Some(key));
    same.find_map(names::of)
}

/// Whether `*` stands for columns of the answer.
fn has_wildcard(select: &Select) -> bool {
    select.projection.iter().any(|i| matches!(i, SelectItem::Wildcard(_)))
}

/// Turns the sort keys of a SELECT into columns of its answer, of columns that a query around it leaves out.
pub(super) fn of_select(ask: &mut Query, name: &mut dyn FnMut(&str) -> String) -> Result<()> {
    let SetExpr::Select(select) = ask.body.as_mut() else {
        return Ok(());
    };
    let Some(OrderByKind::Expressions(keys)) = ask.order_by.as_mut().map(|o| &mut o.kind) else {
        return Ok(());
    };
    for key in keys.iter_mut() {
        if let Some(found) = in_answer(&key.expr, select) {
            key.expr = Expr::Identifier(Ident::with_quote('"', found));
        }
    }
    let missing = |k: &&mut OrderByExpr| !is_place(&k.expr) && in_answer(&k.expr, select).is_none();
    let hidden: Vec<_> = keys.iter_mut().filter(missing).collect();
    // a name alone polars finds by itself
    if hidden.iter().all(|k| matches!(k.expr, Expr::Identifier(_))) || !may_have_more(select) {
        return Ok(());
    }
    let left_out = hide(hidden, select, name);
    around(ask, &left_out, &name("sorted"))
}

/// Makes sort keys columns of the answer, and gives the names of these.
fn hide(keys: Vec<&mut OrderByExpr>, select: &mut Select, name: &mut dyn FnMut(&str) -> String) -> Vec<String> {
    let wild = has_wildcard(select);
    let in_wildcard = |k: &&mut OrderByExpr| wild && matches!(k.expr, Expr::Identifier(_));
    let mut names = Vec::new();
    for key in keys.into_iter().filter(|k| !in_wildcard(k)) {
        names.push(name("order"));
        let alias = Ident::with_quote('"', &names[names.len() - 1]);
        let expr = std::mem::replace(&mut key.expr, Expr::Identifier(alias.clone()));
        select.projection.push(SelectItem::ExprWithAlias { expr, alias });
    }
    names
}

/// Whether another column leaves the rows of a SELECT as they are.
fn may_have_more(select: &Select) -> bool {
    let distinct = matches!(select.distinct, Some(Distinct::Distinct | Distinct::On(_)));
    !distinct && !matches!(select.group_by, GroupByExpr::All(_)) && !select.projection.is_empty()
}

/// Puts a query, without its order and limit, into one that sorts and limits it and leaves columns out.
fn around(ask: &mut Query, left_out: &[String], name: &str) -> Result<()> {
    let SetExpr::Select(select) = ask.body.as_ref() else {
        return Ok(());
    };
    let list = |names: Vec<String>| names.iter().map(|n| quoted(n)).collect::<Vec<_>>().join(", ");
    let all: Option<Vec<String>> = select.projection.iter().map(names::of).collect();
    let shown = match all {
        Some(all) => list(all.into_iter().filter(|n| !left_out.contains(n)).collect()),
        None => format!("* EXCLUDE ({})", list(left_out.to_vec())),
    };
    let text = format!("SELECT {shown} FROM ({}) AS {}", ask.body, quoted(name));
    ask.body = query(&text)?.body;
    Ok(())
}

/// Sorts the union itself: polars would sort its sides too, by columns that only the first has.
pub(super) fn of_set_operation(ask: &mut Query, name: &mut dyn FnMut(&str) -> String) -> Result<()> {
    if ask.order_by.is_some() {
        let text = format!("SELECT * FROM ({}) AS {}", ask.body, quoted(&name("sorted")));
        ask.body = query(&text)?.body;
    }
    Ok(())
}
