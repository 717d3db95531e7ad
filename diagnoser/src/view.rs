//! The live view on a terminal.

use crate::diagnosis::Outcome;
use crate::live::Status;
use crate::receive::words::{Complain, Counts};
use ratatui::crossterm::event::{self, Event, KeyCode, KeyModifiers};
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::Line;
use ratatui::widgets::{Block, Cell, Paragraph, Row, Table};
use schemas::error::{Error, Result};
use schemas::feature::{Feature, Raw};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// Words of trouble that stay on the screen.
const NOTES: usize = 3;

/// Narrower terminals do without the features, still narrower ones without run, phase and reason.
const WIDE: u16 = 140;
const NARROW: u16 = 110;

#[derive(Clone, Default)]
struct Picture {
    statuses: Vec<Status>,
    counts: Counts,
    notes: Vec<String>,
    /// actuators scrolled past
    above: usize,
}

/// The terminal, drawn by a thread of its own.
pub struct View {
    picture: Arc<Mutex<Picture>>,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl View {
    /// Takes the terminal over; q or Ctrl-C sets `stop`.
    ///
    /// # Errors
    /// Refuses where there is no terminal.
    pub fn open(stop: Arc<AtomicBool>) -> Result<Self> {
        let mut terminal =
            ratatui::try_init().map_err(|e| Error::io(std::path::Path::new("terminal"), "cannot be used", e))?;
        let picture = Arc::new(Mutex::new(Picture::default()));
        let over = Arc::new(AtomicBool::new(false));
        let thread = {
            let (picture, over) = (picture.clone(), over.clone());
            std::thread::spawn(move || {
                let mut above = 0;
                while !over.load(Ordering::Relaxed) {
                    let mut now = picture.lock().map(|p| p.clone()).unwrap_or_default();
                    above = above.min(now.statuses.len().saturating_sub(1));
                    now.above = above;
                    let _ = terminal.draw(|frame| draw(frame, &now));
                    if let Ok(true) = event::poll(Duration::from_millis(100))
                        && let Ok(Event::Key(key)) = event::read()
                    {
                        match key.code {
                            KeyCode::Down => above += 1,
                            KeyCode::Up => above = above.saturating_sub(1),
                            KeyCode::PageDown => above += 20,
                            KeyCode::PageUp => above = above.saturating_sub(20),
                            _ => {}
                        }
                        let control = key.modifiers.contains(KeyModifiers::CONTROL);
                        if key.code == KeyCode::Char('q') || (control && key.code == KeyCode::Char('c')) {
                            stop.store(true, Ordering::Relaxed);
                        }
                    }
                }
                ratatui::restore();
            })
        };
        let thread = Some(thread);
        Ok(Self { picture, over, thread })
    }

    /// What is to be seen from now on.
    pub fn show(&self, statuses: Vec<Status>, counts: Counts) {
        if let Ok(mut p) = self.picture.lock() {
            p.statuses = statuses;
            p.counts = counts;
        }
    }

    /// Shows words of trouble below the table.
    pub fn complain(&self) -> Complain {
        let picture = self.picture.clone();
        Arc::new(move |text: &str| {
            if let Ok(mut p) = picture.lock() {
                p.notes.push(text.into());
                let many = p.notes.len().saturating_sub(NOTES);
                p.notes.drain(..many);
            }
        })
    }

    /// Gives the terminal back and leaves the last table and notes on it as plain lines.
    pub fn close(mut self) {
        self.restore();
        if let Ok(p) = self.picture.lock() {
            for s in &p.statuses {
                println!("{} run {}: {}", s.actuator, s.run, verdict(s));
            }
            p.notes.iter().for_each(|n| eprintln!("{n}"));
        }
    }
}

impl View {
    fn restore(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for View {
    /// An error on the way gives the terminal back too, before it is told.
    fn drop(&mut self) {
        self.restore();
    }
}

/// Outcome and intervals in words.
fn verdict(s: &Status) -> String {
    let Some(o) = &s.outcome else { return "-".into() };
    let so_far = if s.is_final { "" } else { " (so far)" };
    match o.area() {
        Some(a) => format!(
            "{}{so_far} FSJ {:.3} ({:.3} .. {:.3}) zeta {:.4} ({:.4} .. {:.4})",
            name(o, s.is_final),
            a.centroid.0,
            a.fsj.lo,
            a.fsj.hi,
            a.centroid.1,
            a.zeta.lo,
            a.zeta.hi
        ),
        None => format!("{}{so_far} {}", name(o, s.is_final), o.reason()),
    }
}

fn name(o: &Outcome, is_final: bool) -> String {
    if is_final {
        o.name().replace('_', " ")
    } else {
        "forming".into()
    }
}

fn colour(s: &Status) -> Color {
    match (&s.outcome, s.is_final) {
        (Some(Outcome::Located(_)), true) => Color::Green,
        (Some(Outcome::Incomplete { .. }), true) => Color::Yellow,
        (Some(_), true) => Color::Red,
        _ => Color::Gray,
    }
}

/// A bar of `width` characters.
fn bar(done: u64, of: u64, width: u64) -> String {
    let filled = (done * width).checked_div(of).unwrap_or(0).min(width) as usize;
    "█".repeat(filled) + &"·".repeat(width as usize - filled)
}

fn draw(frame: &mut ratatui::Frame<'_>, p: &Picture) {
    let notes = p.notes.len() as u16;
    let parts = Layout::vertical([
        Constraint::Length(1),
        Constraint::Min(4),
        Constraint::Length(notes),
        Constraint::Length(1),
    ]);
    let [top, middle, below, bottom] = parts.areas(frame.area());
    let c = &p.counts;
    let title = format!(
        " ema live   {} actuators   {} frames   {} diagnoses: {} located, {} incomplete   {} refused frames",
        p.statuses.len(),
        c.frames,
        c.diagnoses,
        c.located,
        c.incomplete,
        c.strays
    );
    frame.render_widget(Line::from(title).bold(), top);
    let number = |x: Option<f64>, digits: usize| x.map_or("-".into(), |x| format!("{x:.digits$}"));
    let interval = |lo: f64, hi: f64, digits: usize| format!("{lo:.digits$} .. {hi:.digits$}");
    let wide = frame.area().width >= WIDE;
    let longest = p.statuses.iter().map(|s| s.actuator.chars().count()).max();
    let mut columns: Vec<(&str, Constraint)> = vec![
        ("actuator", Constraint::Length(longest.unwrap_or(8).clamp(8, 32) as u16)),
        ("run", Constraint::Length(5)),
        ("phase", Constraint::Length(9)),
        ("test", Constraint::Length(12)),
        ("lost", Constraint::Length(6)),
        ("FSJ", Constraint::Length(14)),
        ("zeta", Constraint::Length(16)),
        ("outcome", Constraint::Length(12)),
        ("reason", Constraint::Min(10)),
    ];
    if wide {
        let features = [("P1 rad/s", 8), ("P2 A", 7), ("P3 -", 6), ("ripple", 8)];
        columns.splice(5..5, features.map(|(name, width)| (name, Constraint::Length(width))));
    }
    let narrow = frame.area().width < NARROW;
    if narrow {
        columns = vec![
            ("actuator", Constraint::Min(8)),
            ("test", Constraint::Length(6)),
            ("lost", Constraint::Length(5)),
            ("FSJ", Constraint::Length(14)),
            ("zeta", Constraint::Length(16)),
            ("outcome", Constraint::Length(12)),
        ];
    }
    let rows = p.statuses.iter().skip(p.above).map(|s| {
        let area = s.outcome.as_ref().and_then(|o| o.area());
        let outcome = s.outcome.as_ref().map_or("-".into(), |o| name(o, s.is_final));
        let reason = s.outcome.as_ref().map_or("", |o| o.reason());
        let mut cells = vec![
            Cell::from(s.actuator.clone()).bold(),
            Cell::from(s.run.to_string()),
            Cell::from(s.phase.clone()),
            Cell::from(bar(s.sample, s.samples, if narrow { 6 } else { 12 })),
            Cell::from(s.lost.to_string()).fg(if s.lost > 0 { Color::Yellow } else { Color::Gray }),
            Cell::from(area.map_or("-".into(), |a| interval(a.fsj.lo, a.fsj.hi, 3))),
            Cell::from(area.map_or("-".into(), |a| interval(a.zeta.lo, a.zeta.hi, 4))),
            Cell::from(outcome).fg(colour(s)).bold(),
            Cell::from(if s.is_final { reason.to_string() } else { String::new() }),
        ];
        if narrow {
            cells.remove(8);
            cells.drain(1..3);
        }
        if wide {
            let f = &s.features;
            // before there are maps only what needs no nominal run is known
            let features = [
                number(f.get(Feature::P1), 5),
                number(f.get(Feature::P2).or(s.raw[Raw::P2]), 4),
                number(f.get(Feature::P3), 3),
                number(f.get(Feature::Ripple).or(s.raw[Raw::Ripple]), 6),
            ];
            cells.splice(5..5, features.map(Cell::from));
        }
        Row::new(cells)
    });
    let head = Row::new(columns.iter().map(|c| c.0));
    let table = Table::new(rows, columns.iter().map(|c| c.1))
        .header(head.style(Style::new().dim()))
        .block(Block::bordered());
    frame.render_widget(table, middle);
    let notes: Vec<Line> = p.notes.iter().map(|n| Line::from(n.as_str()).yellow()).collect();
    frame.render_widget(Paragraph::new(notes), below);
    frame.render_widget(Line::from(" q quits   arrows and page keys scroll").dim(), bottom);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::Area;
    use schemas::fault::Interval;
    use schemas::feature::{Features, RawFeatures};

    #[test]
    fn prop_view_shows_interval_loss_and_trouble() {
        let area = Area {
            parts: Vec::new(),
            boxes: Vec::new(),
            fsj: Interval { lo: 2.989, hi: 3.008 },
            zeta: Interval { lo: 0.2979, hi: 0.3016 },
            centroid: (2.9988, 0.29978),
            size: 1e-5,
            inner: 1e-5,
            outer: 1e-5,
            band: 3.0,
        };
        let status = Status {
            actuator: "left-aileron".into(),
            run: 7,
            process: 1,
            phase: "step".into(),
            sample: 15_000,
            samples: 30_000,
            lost: 100,
            raw: RawFeatures::default(),
            features: Features::default().with(Feature::P1, Some(0.05307)),
            outcome: Some(Outcome::Located(area)),
            is_final: true,
        };
        let picture = Picture {
            statuses: vec![status],
            counts: Counts::default(),
            notes: vec!["frame refused: process 3: truncated".into()],
            above: 0,
        };
        let backend = ratatui::backend::TestBackend::new(160, 10);
        let mut terminal = ratatui::Terminal::new(backend).unwrap();
        terminal.draw(|f| draw(f, &picture)).unwrap();
        let text: String = terminal
            .backend()
            .buffer()
            .content()
            .iter()
            .map(|c| c.symbol())
            .collect();
        for wanted in [
            "left-aileron",
            "██████······",
            "100",
            "0.05307",
            "2.989 .. 3.008",
            "0.2979 .. 0.3016",
            "located",
            "truncated",
        ] {
            assert!(text.contains(wanted), "{wanted} in {text}");
        }
    }
}
