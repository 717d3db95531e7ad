//! The live view on a terminal.

mod columns;
mod screen;
#[cfg(test)]
mod tests;

use crate::live::Status;
use crate::receive::words::{Complain, Counts};
use ratatui::crossterm::event::{self, Event, KeyEventKind};
use schemas::error::{Error, Result};
use screen::{Screen, Wish};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// Words of trouble that stay on the screen.
const NOTES: usize = 3;

/// Between two looks whether something has changed; a key is heard at once.
const LOOK: Duration = Duration::from_millis(100);

#[derive(Clone, Default)]
struct Picture {
    statuses: Vec<Status>,
    counts: Counts,
    notes: Vec<String>,
    /// grows with every change
    version: u64,
}

/// The terminal, drawn by a thread of its own, and only when something has changed.
pub struct View {
    picture: Arc<Mutex<Picture>>,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Draws what is new and listens to keys until `over`.
fn draw_on(mut terminal: ratatui::DefaultTerminal, picture: &Mutex<Picture>, over: &AtomicBool, stop: &AtomicBool) {
    let mut screen = Screen::default();
    let mut drawn = None;
    while !over.load(Ordering::Relaxed) {
        let new = picture
            .lock()
            .ok()
            .filter(|p| drawn != Some(p.version))
            .map(|p| p.clone());
        if let Some(p) = new {
            drawn = Some(p.version);
            let _ = terminal.draw(|frame| screen.draw(frame, &p));
        }
        if let Ok(true) = event::poll(LOOK) {
            drawn = None;
            match event::read() {
                Ok(Event::Key(key)) if key.kind != KeyEventKind::Release => {
                    if screen.key(key) == Wish::Quit {
                        stop.store(true, Ordering::Relaxed);
                    }
                }
                Ok(_) => {}
                // a terminal that has gone would be asked again and again without a pause
                Err(_) => std::thread::sleep(LOOK),
            }
        }
    }
    ratatui::restore();
}

impl View {
    /// Takes the terminal over; q or Ctrl-C sets `stop`.
    ///
    /// # Errors
    /// Refuses where there is no terminal.
    pub fn open(stop: Arc<AtomicBool>) -> Result<Self> {
        let terminal =
            ratatui::try_init().map_err(|e| Error::io(std::path::Path::new("terminal"), "cannot be used", e))?;
        let picture = Arc::new(Mutex::new(Picture::default()));
        let over = Arc::new(AtomicBool::new(false));
        let (p, o) = (picture.clone(), over.clone());
        let thread = std::thread::spawn(move || draw_on(terminal, &p, &o, &stop));
        let thread = Some(thread);
        Ok(Self { picture, over, thread })
    }

    /// What is to be seen from now on.
    pub fn show(&self, statuses: Vec<Status>, counts: Counts) {
        if let Ok(mut p) = self.picture.lock() {
            p.statuses = statuses;
            p.counts = counts;
            p.version += 1;
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
                p.version += 1;
            }
        })
    }

    /// Gives the terminal back and leaves the last table and notes on it as plain lines.
    pub fn close(mut self) {
        self.restore();
        if let Ok(p) = self.picture.lock() {
            for s in &p.statuses {
                println!("{} run {}: {}", s.actuator, s.run, columns::verdict(s));
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
