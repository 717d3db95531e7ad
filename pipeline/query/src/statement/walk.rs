//! Walks over a parsed statement. One visitor each for reading and for changing it, which calls back: the parser's trees
//! are large, and each further visitor would be compiled for all of them.

use schemas::error::{Error, Result};
use sqlparser::ast::{Expr, ObjectName, Query, Select, TableFactor, Visit, VisitMut, Visitor, VisitorMut};
use std::ops::ControlFlow;

/// What is met on a walk.
pub(super) enum Met<'a> {
    /// A query, before what is in it.
    Query(&'a Query),
    /// The end of a query.
    QueryEnd,
    /// An expression, before what is in it.
    Expr(&'a Expr),
}

/// Calls `each` for all that is met; stops where it says no. Tells whether it never did.
pub(super) fn all<T: Visit>(tree: &T, each: &mut dyn FnMut(Met<'_>) -> bool) -> bool {
    tree.visit(&mut Walk(each)).is_continue()
}

struct Walk<'f>(&'f mut dyn FnMut(Met<'_>) -> bool);

impl Walk<'_> {
    fn call(&mut self, met: Met<'_>) -> ControlFlow<()> {
        match (self.0)(met) {
            true => ControlFlow::Continue(()),
            false => ControlFlow::Break(()),
        }
    }
}

impl Visitor for Walk<'_> {
    type Break = ();

    fn pre_visit_query(&mut self, query: &Query) -> ControlFlow<()> {
        self.call(Met::Query(query))
    }

    fn post_visit_query(&mut self, _: &Query) -> ControlFlow<()> {
        self.call(Met::QueryEnd)
    }

    fn pre_visit_expr(&mut self, e: &Expr) -> ControlFlow<()> {
        self.call(Met::Expr(e))
    }
}

/// What may be changed on a walk.
pub(super) enum Part<'a> {
    /// The begin of a query.
    QueryBegin,
    /// A query, after what is in it.
    Query(&'a mut Query),
    /// A SELECT, after what is in it.
    Select(&'a mut Select),
    /// An expression, after what is in it.
    Expr(&'a mut Expr),
    /// What stands in FROM, before what is in it.
    Table(&'a mut TableFactor),
    /// The name of a table.
    Name(&'a mut ObjectName),
}

/// Calls `each` for all parts, and stops at its first error.
///
/// # Errors
/// That of `each`.
pub(super) fn change<T: VisitMut>(tree: &mut T, each: &mut dyn FnMut(Part<'_>) -> Result<()>) -> Result<()> {
    match tree.visit(&mut Change(each)) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(e) => Err(e),
    }
}

struct Change<'f>(&'f mut dyn FnMut(Part<'_>) -> Result<()>);

impl Change<'_> {
    fn call(&mut self, part: Part<'_>) -> ControlFlow<Error> {
        match (self.0)(part) {
            Ok(()) => ControlFlow::Continue(()),
            Err(e) => ControlFlow::Break(e),
        }
    }
}

impl VisitorMut for Change<'_> {
    type Break = Error;

    fn pre_visit_query(&mut self, _: &mut Query) -> ControlFlow<Self::Break> {
        self.call(Part::QueryBegin)
    }

    fn post_visit_query(&mut self, query: &mut Query) -> ControlFlow<Self::Break> {
        self.call(Part::Query(query))
    }

    fn post_visit_select(&mut self, select: &mut Select) -> ControlFlow<Self::Break> {
        self.call(Part::Select(select))
    }

    fn post_visit_expr(&mut self, e: &mut Expr) -> ControlFlow<Self::Break> {
        self.call(Part::Expr(e))
    }

    fn pre_visit_table_factor(&mut self, factor: &mut TableFactor) -> ControlFlow<Self::Break> {
        self.call(Part::Table(factor))
    }

    fn pre_visit_relation(&mut self, name: &mut ObjectName) -> ControlFlow<Self::Break> {
        self.call(Part::Name(name))
    }
}
