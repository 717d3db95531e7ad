//! What an operator sees and does: counts, the table with the worst first, a filter, and all words of the actuator
//! that is selected.

use super::Picture;
use super::columns::{ACTUATOR, OUTCOME, cut, fitting, outcome, reason, verdict};
use crate::diagnosis::Outcome;
use crate::live::{Foretold, Status};
use crate::prognosis::Status as Stand;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::Line;
use ratatui::widgets::{Block, Cell, Paragraph, Row, Table, TableState, Wrap};
use std::cmp::Reverse;

/// Rows that a page key moves by.
const PAGE: usize = 20;

/// Lines of the selected actuator's words.
const DETAIL: u16 = 4;

/// What a key asks of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wish {
    Nothing,
    Quit,
}

/// What the operator has chosen.
#[derive(Debug, Default)]
pub(super) struct Screen {
    filter: String,
    is_typing: bool,
    by_name: bool,
    selected: usize,
    /// of the last picture
    rows: usize,
    table: TableState,
}

/// How bad it is: what the model cannot explain first, then those with a history by their remaining life, a healthy actuator last.
fn rank(s: &Status) -> (u8, u64, Reverse<u64>) {
    let class = match (&s.outcome, s.is_final) {
        (Some(Outcome::Unexplained { .. }), true) => 0,
        (Some(Outcome::OutOfRange { .. }), true) => 1,
        (Some(Outcome::Incomplete { .. }), true) => 2,
        (_, false) if s.lost > 0 => 3,
        (_, false) => 4,
        _ => 5,
    };
    (class, if class == 5 { soonest(s) } else { 0 }, Reverse(severity(s)))
}

/// Lower end of the remaining life in thousandths; passed first, unknown last.
fn soonest(s: &Status) -> u64 {
    match &s.foretold {
        Some(f) if f.status == Stand::Passed.name() => 0,
        // a number that is too great, or infinite, is the greatest one
        Some(Foretold {
            left: Some((lo, ..)), ..
        }) => ((1000.0 * lo) as u64).saturating_add(1).min(u64::MAX - 1),
        _ => u64::MAX,
    }
}

/// Of located faults: the greater of both, as a share of the usual range of maps (FSJ 1 to 5, zeta 0 to 0.5), in
/// thousandths.
fn severity(s: &Status) -> u64 {
    let area = s.outcome.as_ref().filter(|_| s.is_final).and_then(Outcome::area);
    let share = area.map_or(0.0, |a| ((a.fsj.hi - 1.0) / 4.0).max(a.zeta.hi / 0.5));
    (share * 1000.0) as u64
}

fn colour(s: &Status) -> Color {
    match (&s.outcome, s.is_final) {
        (Some(Outcome::Located(_)), true) => Color::Green,
        (Some(Outcome::Incomplete { .. }), true) => Color::Yellow,
        (Some(_), true) => Color::Red,
        _ => Color::Gray,
    }
}

/// How many of the actuators are where.
fn census(statuses: &[Status]) -> String {
    let of = |f: fn(&Outcome) -> bool| {
        let found = statuses
            .iter()
            .filter(|s| s.is_final && s.outcome.as_ref().is_some_and(f));
        found.count()
    };
    let logged = statuses.iter().filter(|s| s.is_final && s.outcome.is_none()).count();
    let counts = [
        (of(|o| matches!(o, Outcome::Unexplained { .. })), "unexplained"),
        (of(|o| matches!(o, Outcome::OutOfRange { .. })), "out of range"),
        (of(|o| matches!(o, Outcome::Incomplete { .. })), "incomplete"),
        (statuses.iter().filter(|s| !s.is_final).count(), "testing"),
        (of(|o| matches!(o, Outcome::Located(_))), "located"),
        (logged, "in the log"),
    ];
    // the last one is seldom: streams that an earlier process has diagnosed
    let shown = if logged > 0 { &counts[..] } else { &counts[..5] };
    let words: Vec<String> = shown.iter().map(|(n, word)| format!("{n} {word}")).collect();
    format!(" {}", words.join("  "))
}

impl Screen {
    /// Takes a key.
    pub fn key(&mut self, key: KeyEvent) -> Wish {
        if key.modifiers.contains(KeyModifiers::CONTROL) {
            return if key.code == KeyCode::Char('c') {
                Wish::Quit
            } else {
                Wish::Nothing
            };
        }
        match key.code {
            KeyCode::Down => self.go(self.selected.saturating_add(1)),
            KeyCode::Up => self.go(self.selected.saturating_sub(1)),
            KeyCode::PageDown => self.go(self.selected.saturating_add(PAGE)),
            KeyCode::PageUp => self.go(self.selected.saturating_sub(PAGE)),
            KeyCode::Home => self.go(0),
            KeyCode::End => self.go(usize::MAX),
            KeyCode::Esc => {
                self.filter.clear();
                self.is_typing = false;
            }
            KeyCode::Enter => self.is_typing = false,
            KeyCode::Backspace if self.is_typing => drop(self.filter.pop()),
            KeyCode::Char(c) if self.is_typing => self.filter.push(c),
            KeyCode::Char('/') => self.is_typing = true,
            KeyCode::Char('n') => self.by_name = !self.by_name,
            KeyCode::Char('q') => return Wish::Quit,
            _ => {}
        }
        Wish::Nothing
    }

    fn go(&mut self, row: usize) {
        self.selected = row.min(self.rows.saturating_sub(1));
    }

    /// The actuators that the filter lets through, in order.
    fn rows<'a>(&self, p: &'a Picture) -> Vec<&'a Status> {
        let wanted = self.filter.to_lowercase();
        let lets = |text: &str| text.to_lowercase().contains(&wanted);
        let through = |s: &&Status| lets(&s.actuator) || lets(&outcome(s)) || lets(reason(s));
        let mut rows: Vec<&Status> = p.statuses.iter().filter(through).collect();
        rows.sort_by(|a, b| a.actuator.cmp(&b.actuator));
        if !self.by_name {
            rows.sort_by_key(|s| rank(s));
        }
        rows
    }

    /// Draws all of it.
    pub fn draw(&mut self, frame: &mut ratatui::Frame<'_>, p: &Picture) {
        let rows = self.rows(p);
        self.rows = rows.len();
        self.go(self.selected);
        let parts = Layout::vertical([
            Constraint::Length(2),
            Constraint::Min(4),
            Constraint::Length(DETAIL),
            Constraint::Length(p.notes.len() as u16),
            Constraint::Length(1),
        ]);
        let [top, middle, detail, below, bottom] = parts.areas(frame.area());
        frame.render_widget(Paragraph::new(self.head(p, rows.len())), top);
        self.draw_table(frame, middle, &rows);
        if let Some(s) = rows.get(self.selected) {
            frame.render_widget(detail_of(s), detail);
        }
        let notes: Vec<Line> = p.notes.iter().map(|n| Line::from(n.as_str()).yellow()).collect();
        frame.render_widget(Paragraph::new(notes), below);
        frame.render_widget(Line::from(self.foot()).dim(), bottom);
    }

    fn head(&self, p: &Picture, shown: usize) -> Vec<Line<'static>> {
        let c = &p.counts;
        let mut since = format!(
            " {} actuators, {} diagnoses, {} frames, {} refused",
            p.statuses.len(),
            c.diagnoses,
            c.frames,
            c.strays
        );
        if !self.filter.is_empty() {
            since = format!(" filter `{}`: {shown} of {}; ", self.filter, p.statuses.len()) + since.trim_start();
        }
        vec![Line::from(census(&p.statuses)).bold(), Line::from(since)]
    }

    fn foot(&self) -> String {
        if self.is_typing {
            return format!(" filter: {}_   Enter keeps it, Esc clears it", self.filter);
        }
        let order = if self.by_name { "worst first" } else { "by name" };
        format!(" q quits   / filters   n {order}   arrows and page keys select")
    }

    fn draw_table(&mut self, frame: &mut ratatui::Frame<'_>, area: Rect, rows: &[&Status]) {
        let columns = fitting(rows, area.width.saturating_sub(2) as usize);
        let body = rows.iter().map(|s| {
            let cells = columns.iter().map(|(c, width)| {
                let cell = Cell::from(cut(&(c.text)(s), *width));
                match c.name {
                    ACTUATOR => cell.bold(),
                    OUTCOME => cell.fg(colour(s)).bold(),
                    "lost" if s.lost > 0 => cell.fg(Color::Yellow),
                    _ => cell,
                }
            });
            Row::new(cells)
        });
        let head = Row::new(columns.iter().map(|(c, _)| c.name));
        let table = Table::new(body, columns.iter().map(|(_, width)| Constraint::Length(*width as u16)))
            .header(head.style(Style::new().dim()))
            .row_highlight_style(Style::new().reversed())
            .block(Block::bordered());
        self.table.select(Some(self.selected));
        frame.render_stateful_widget(table, area, &mut self.table);
    }
}

/// All words of an actuator.
fn detail_of(s: &Status) -> Paragraph<'static> {
    let name = format!("{} run {}, process {}, {}: ", s.actuator, s.run, s.process, s.phase);
    Paragraph::new(name + &verdict(s)).wrap(Wrap { trim: true })
}
