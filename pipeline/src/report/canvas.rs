//! Drawing surface in pixels with a fourfold finer internal grid, plus the layout shared by all plots.

use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::scale::{Axis, Pt, Rect, power};
use super::theme::{FRAME, GRID, INK, MUTED, WHITE, dark_rules};

/// Internal units per pixel; the backend only knows whole units.
const FINE: f64 = 4.0;

pub(super) const SMALL: f64 = 13.0;
const LABEL: f64 = 14.0;
const TITLE: f64 = 15.5;
const ROW: f64 = 20.0;

/// A title above a drawing of some width.
pub(super) struct Title<'a> {
    pub text: Option<&'a str>,
    pub width: f64,
}

/// How a legend entry is drawn.
#[derive(Clone, Copy)]
pub(super) enum Mark {
    Line,
    Patch,
    Area,
    Dash,
    Triangle,
    Dot,
}

pub(super) struct Entry {
    pub mark: Mark,
    pub color: RGBColor,
    pub label: String,
}

pub(super) struct Canvas<'a> {
    root: DrawingArea<SVGBackend<'a>, Shift>,
}

/// Runs the drawing and returns the SVG element.
///
/// * `alone` a file of its own, with its own ground and its own colours on a dark one; a page has them once for all
pub(super) fn render(
    size: (u32, u32),
    name: &str,
    alone: bool,
    draw: impl FnOnce(&Canvas) -> Result<()>,
) -> Result<String> {
    let (width, height) = size;
    let (w, h) = (width * FINE as u32, height * FINE as u32);
    let mut buffer = String::new();
    {
        let root = SVGBackend::with_string(&mut buffer, (w, h)).into_drawing_area();
        if alone {
            root.fill(&WHITE)?;
        }
        let canvas = Canvas { root };
        draw(&canvas)?;
        canvas.root.present()?;
    }
    let (_, body) = buffer
        .split_once('>')
        .ok_or_else(|| anyhow!("the backend wrote no SVG element"))?;
    // Full opacity is the default, and leaving it out saves a tenth of the size.
    let body = body.replace(" opacity=\"1\"", "");
    let style = if alone {
        format!("<style>\n{}</style>", dark_rules())
    } else {
        String::new()
    };
    Ok(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {w} {h}\" \
         role=\"img\" aria-label=\"{}\" stroke-linejoin=\"round\">{style}{body}",
        super::escape(name)
    ))
}

fn grid(p: Pt) -> (i32, i32) {
    let unit = |v: f64| (v * FINE).round().clamp(-1e6, 1e6) as i32;
    (unit(p.0), unit(p.1))
}

impl Canvas<'_> {
    pub(super) fn line(&self, points: &[Pt], color: RGBColor, alpha: f64, width: f64) -> Result<()> {
        if points.len() < 2 {
            return Ok(());
        }
        let mut path: Vec<_> = points.iter().map(|p| grid(*p)).collect();
        path.dedup();
        if path.len() == 1 {
            path.push(path[0]);
        }
        let style = color.mix(alpha).stroke_width((width * FINE).round().max(1.0) as u32);
        self.root.draw(&PathElement::new(path, style))?;
        Ok(())
    }

    pub(super) fn dashes(&self, a: Pt, b: Pt, color: RGBColor, width: f64) -> Result<()> {
        const ON: f64 = 7.0;
        const PERIOD: f64 = 11.0;
        let length = (b.0 - a.0).hypot(b.1 - a.1);
        let at = |d: f64| (a.0 + (b.0 - a.0) * d / length, a.1 + (b.1 - a.1) * d / length);
        let mut d = 0.0;
        while d < length {
            self.line(&[at(d), at((d + ON).min(length))], color, 1.0, width)?;
            d += PERIOD;
        }
        Ok(())
    }

    pub(super) fn fill(&self, points: &[Pt], color: RGBColor, alpha: f64) -> Result<()> {
        if points.len() < 3 {
            return Ok(());
        }
        let path: Vec<_> = points.iter().map(|p| grid(*p)).collect();
        self.root.draw(&Polygon::new(path, color.mix(alpha).filled()))?;
        Ok(())
    }

    pub(super) fn rect(&self, ((x0, x1), (y0, y1)): Rect, color: RGBColor, alpha: f64) -> Result<()> {
        self.root.draw(&Rectangle::new(
            [grid((x0, y0)), grid((x1, y1))],
            color.mix(alpha).filled(),
        ))?;
        Ok(())
    }

    pub(super) fn disc(&self, center: Pt, radius: f64, color: RGBColor, alpha: f64) -> Result<()> {
        self.root.draw(&Circle::new(
            grid(center),
            (radius * FINE).round() as i32,
            color.mix(alpha).filled(),
        ))?;
        Ok(())
    }

    /// A triangle with a white rim, centred on its centroid.
    pub(super) fn triangle(&self, (x, y): Pt, radius: f64, color: RGBColor) -> Result<()> {
        for (r, color) in [(radius + 2.6, WHITE), (radius, color)] {
            self.fill(
                &[(x, y - r), (x + 0.866 * r, y + 0.5 * r), (x - 0.866 * r, y + 0.5 * r)],
                color,
                1.0,
            )?;
        }
        Ok(())
    }

    /// A dot with a white rim.
    pub(super) fn dot(&self, center: Pt, radius: f64, color: RGBColor) -> Result<()> {
        self.disc(center, radius + 1.3, WHITE, 1.0)?;
        self.disc(center, radius, color, 1.0)
    }

    /// Text centred vertically on the point.
    pub(super) fn text(&self, text: &str, at: Pt, size: f64, color: RGBColor, anchor: HPos) -> Result<()> {
        self.write(
            text,
            at,
            FontDesc::new(FontFamily::SansSerif, size * FINE * 1.24, FontStyle::Normal),
            color,
            anchor,
        )
    }

    fn write(&self, text: &str, at: Pt, font: FontDesc, color: RGBColor, anchor: HPos) -> Result<()> {
        let text: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        let style = TextStyle::from(font).color(&color).pos(Pos::new(anchor, VPos::Center));
        self.root.draw(&Text::new(text, grid(at), style))?;
        Ok(())
    }

    /// Writes a title in at most two lines, and returns where the drawing may begin.
    pub(super) fn title(&self, title: Title) -> Result<f64> {
        let mut top = 12.0;
        if let Some(text) = title.text {
            for line in wrap(text, TITLE, title.width - 32.0, 2) {
                let font = FontDesc::new(FontFamily::SansSerif, TITLE * FINE * 1.24, FontStyle::Bold);
                self.write(&line, (16.0, top + 8.0), font, INK, HPos::Left)?;
                top += 20.0;
            }
            top += 8.0;
        }
        Ok(top)
    }

    fn entry(&self, entry: &Entry, (x, y): Pt) -> Result<()> {
        let color = entry.color;
        let patch = ((x, x + 18.0), (y - 5.0, y + 5.0));
        let outline = [
            (x, y - 5.0),
            (x + 18.0, y - 5.0),
            (x + 18.0, y + 5.0),
            (x, y + 5.0),
            (x, y - 5.0),
        ];
        match entry.mark {
            Mark::Line => self.line(&[(x, y), (x + 18.0, y)], color, 1.0, 2.0)?,
            Mark::Patch => {
                self.rect(patch, color, 0.35)?;
                self.line(&outline, color, 0.9, 1.0)?;
            }
            Mark::Area => {
                self.rect(patch, color, 0.75)?;
                self.line(&outline, color, 1.0, 1.5)?;
            }
            Mark::Dash => self.dashes((x, y), (x + 18.0, y), color, 1.25)?,
            Mark::Triangle => self.triangle((x + 9.0, y + 1.5), 7.0, color)?,
            Mark::Dot => self.dot((x + 9.0, y), 5.0, color)?,
        }
        self.text(&entry.label, (x + 24.0, y), SMALL, INK, HPos::Left)
    }
}

/// Estimated width of a text in pixels, rather too wide than too narrow.
pub(super) fn text_width(text: &str, size: f64) -> f64 {
    let em: f64 = text
        .chars()
        .map(|c| match c {
            'i' | 'j' | 'l' | '.' | ',' | ':' | ';' | '|' | '\'' | '!' => 0.30,
            'f' | 't' | 'r' | ' ' | '(' | ')' | '[' | ']' | '/' | '-' => 0.40,
            'm' | 'w' | 'M' | 'W' | '@' | '%' => 0.92,
            '⁰'..='⁹' | '⁻' | '²' | '³' | '¹' => 0.42,
            c if c.is_uppercase() => 0.70,
            _ => 0.61,
        })
        .sum();
    em * size
}

/// Breaks a text into at most `lines` lines of the given width and cuts what does not fit.
fn wrap(text: &str, size: f64, width: f64, lines: usize) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match out.last_mut() {
            Some(line) if out_fits(line, word, size, width) => {
                line.push(' ');
                line.push_str(word);
            }
            _ => out.push(word.to_owned()),
        }
    }
    if out.len() > lines {
        let rest = out.split_off(lines - 1).join(" ");
        out.push(rest);
    }
    out.into_iter().map(|line| shorten(&line, size, width)).collect()
}

fn out_fits(line: &str, word: &str, size: f64, width: f64) -> bool {
    text_width(line, size) + text_width(word, size) + 0.4 * size <= width
}

/// Cuts a text to a width and marks the cut with an ellipsis.
fn shorten(text: &str, size: f64, width: f64) -> String {
    if text_width(text, size) <= width {
        return text.to_owned();
    }
    let mut out: String = text.to_owned();
    while !out.is_empty() && text_width(&out, size) + size > width {
        out.pop();
    }
    format!("{}\u{2026}", out.trim_end())
}

/// What surrounds a plot.
pub(super) struct Setup<'a> {
    pub size: (f64, f64),
    pub title: Option<&'a str>,
    pub entries: Vec<Entry>,
    pub x_label: &'a str,
    pub y_label: &'a str,
    pub x: Pt,
    pub y: Pt,
    /// Room kept free on the right, in pixels.
    pub right: f64,
}

/// The plot area with its axes.
pub(super) struct Plot {
    pub left: f64,
    pub right: f64,
    pub top: f64,
    pub bottom: f64,
    pub x: Axis,
    pub y: Axis,
}

impl Plot {
    /// Lays the plot out and draws title, legend, grid and axes.
    pub(super) fn new(canvas: &Canvas, setup: Setup) -> Result<Self> {
        let (width, height) = setup.size;
        let mut top = canvas.title(Title {
            text: setup.title,
            width,
        })?;

        // The legend needs the left edge, which needs the y ticks, which need the height: estimate the rows first.
        let widths: Vec<f64> = setup
            .entries
            .iter()
            .map(|e| 24.0 + 0.92 * text_width(&e.label, SMALL) + 14.0)
            .collect();
        let usable_width = width - setup.right - 72.0;
        let mut places = Vec::new();
        let (mut dx, mut row) = (0.0, 0.0);
        for w in &widths {
            if dx > 0.0 && dx + w - 14.0 > usable_width {
                (dx, row) = (0.0, row + 1.0);
            }
            places.push((dx, row));
            dx += w;
        }
        let legend_top = top;
        if !places.is_empty() {
            top += (row + 1.0) * ROW + 4.0;
        }

        let bottom = height - 50.0;
        let y = Axis::new(setup.y, (bottom - top) / 52.0);
        if y.exponent != 0 {
            top += 14.0;
        }
        let tick_width = y
            .ticks
            .iter()
            .map(|(_, text)| text_width(text, SMALL))
            .fold(0.0, f64::max);
        let left = (16.0 + LABEL + 6.0 + tick_width + 7.0).max(60.0);
        let right = width - setup.right;
        let x = Axis::new(setup.x, (right - left) / 84.0);
        for (entry, (dx, row)) in setup.entries.iter().zip(places) {
            let label = shorten(&entry.label, SMALL, usable_width - 24.0);
            let entry = Entry { label, ..*entry };
            canvas.entry(&entry, (left + dx, legend_top + 8.0 + row * ROW))?;
        }
        let plot = Self {
            left,
            right,
            top,
            bottom,
            x,
            y,
        };
        plot.axes(canvas, setup.x_label, setup.y_label)?;
        Ok(plot)
    }

    /// Position of a data point in pixels.
    pub(super) fn at(&self, p: Pt) -> Pt {
        let x = self.left + (p.0 - self.x.lo) / (self.x.hi - self.x.lo) * (self.right - self.left);
        let y = self.bottom - (p.1 - self.y.lo) / (self.y.hi - self.y.lo) * (self.bottom - self.top);
        (x, y)
    }

    pub(super) fn path(&self, points: &[Pt]) -> Vec<Pt> {
        points.iter().map(|p| self.at(*p)).collect()
    }

    /// The shown ranges in data units.
    pub(super) fn range(&self) -> Rect {
        ((self.x.lo, self.x.hi), (self.y.lo, self.y.hi))
    }

    fn axes(&self, canvas: &Canvas, x_label: &str, y_label: &str) -> Result<()> {
        let (left, right, top, bottom) = (self.left, self.right, self.top, self.bottom);
        for (value, text) in &self.x.ticks {
            let x = self.at((*value, self.y.lo)).0;
            canvas.line(&[(x, top), (x, bottom)], GRID, 1.0, 1.0)?;
            canvas.line(&[(x, bottom), (x, bottom + 4.0)], FRAME, 1.0, 1.0)?;
            canvas.text(text, (x, bottom + 14.0), SMALL, MUTED, HPos::Center)?;
        }
        for (value, text) in &self.y.ticks {
            let y = self.at((self.x.lo, *value)).1;
            canvas.line(&[(left, y), (right, y)], GRID, 1.0, 1.0)?;
            canvas.line(&[(left - 4.0, y), (left, y)], FRAME, 1.0, 1.0)?;
            canvas.text(text, (left - 7.0, y), SMALL, MUTED, HPos::Right)?;
        }
        if self.x.exponent != 0 {
            canvas.text(
                &power(self.x.exponent),
                (right, bottom + 35.0),
                SMALL,
                MUTED,
                HPos::Right,
            )?;
        }
        if self.y.exponent != 0 {
            canvas.text(&power(self.y.exponent), (left, top - 9.0), SMALL, MUTED, HPos::Left)?;
        }
        let x_text = shorten(x_label, LABEL, right - left);
        canvas.text(&x_text, ((left + right) / 2.0, bottom + 35.0), LABEL, INK, HPos::Center)?;
        let y_text = shorten(y_label, LABEL, bottom - top + 30.0);
        let font = FontDesc::new(FontFamily::SansSerif, LABEL * FINE * 1.24, FontStyle::Normal);
        canvas.write(
            &y_text,
            (16.0, (top + bottom) / 2.0),
            font.transform(FontTransform::Rotate270),
            INK,
            HPos::Center,
        )
    }

    /// The frame, drawn last so that it covers the ends of the curves.
    pub(super) fn frame(&self, canvas: &Canvas) -> Result<()> {
        let (l, r, t, b) = (self.left, self.right, self.top, self.bottom);
        canvas.line(&[(l, t), (r, t), (r, b), (l, b), (l, t)], FRAME, 1.0, 1.0)
    }

    /// A note in the middle of a plot without data.
    pub(super) fn empty(&self, canvas: &Canvas) -> Result<()> {
        let middle = ((self.left + self.right) / 2.0, (self.top + self.bottom) / 2.0);
        canvas.text("no data", middle, LABEL, MUTED, HPos::Center)
    }
}
