//! Plots (SVG) and one self-contained HTML report for failure maps and the diagnoses made with them.
//!
//! A failure map shows a measured parameter P over the friction factor FSJ [-], one curve per static
//! eccentricity zeta [-]. A diagnosis cuts a band through each map; the cuts become regions in the
//! FSJ-zeta plane and their intersection is the located area.

mod canvas;
mod charts;
mod html;
mod scale;
mod sketch;
#[cfg(test)]
mod tests;
mod theme;

use std::collections::HashSet;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, ensure};

/// One curve of a failure map at a fixed eccentricity.
#[derive(Clone, Debug)]
pub struct Curve {
    /// Static eccentricity [-].
    pub zeta: f64,
    /// Dense, already interpolated points (FSJ [-], P in the unit of the map).
    pub points: Vec<(f64, f64)>,
}

/// The horizontal band which a diagnosis cuts through a map.
#[derive(Clone, Debug)]
pub struct Band {
    /// Measured value P*, in the unit of the map.
    pub value: f64,
    /// Half of the height of the band, in the unit of the map.
    pub half_width: f64,
}

/// A failure map, with the cut band when a diagnosis is shown.
#[derive(Clone, Debug)]
pub struct MapPlot {
    /// Short name of the parameter, for instance "P1".
    pub name: String,
    /// Title of the figure.
    pub title: String,
    /// Unit of the parameter, "-" when it has none.
    pub unit: String,
    /// One curve per eccentricity.
    pub curves: Vec<Curve>,
    /// Simulated grid points (FSJ [-], P in the unit of the map), drawn as small dots.
    pub knots: Vec<(f64, f64)>,
    /// The cut, if any.
    pub band: Option<Band>,
    /// The true fault (FSJ [-], P in the unit of the map), drawn as a red triangle.
    pub truth: Option<(f64, f64)>,
    /// What was found (FSJ [-], P in the unit of the map), drawn as a blue dot.
    pub estimate: Option<(f64, f64)>,
}

/// An FSJ interval at one eccentricity; a region is a list of such strips.
#[derive(Clone, Debug)]
pub struct Strip {
    /// Static eccentricity [-].
    pub zeta: f64,
    /// Lower end of the interval, friction factor [-].
    pub fsj_lo: f64,
    /// Upper end of the interval, friction factor [-].
    pub fsj_hi: f64,
}

/// The located area in the FSJ-zeta plane; all pairs are (FSJ [-], zeta [-]).
#[derive(Clone, Debug)]
pub struct RegionPlot {
    /// Title of the figure.
    pub title: String,
    /// Shown range of the friction factor [-].
    pub fsj_range: (f64, f64),
    /// Shown range of the static eccentricity [-].
    pub zeta_range: (f64, f64),
    /// The region of each map, with the name of its parameter.
    pub regions: Vec<(String, Vec<Strip>)>,
    /// The intersection of all regions.
    pub area: Vec<Strip>,
    /// Bounding box of the area: ((FSJ low, FSJ high), (zeta low, zeta high)), all [-].
    pub hull: Option<((f64, f64), (f64, f64))>,
    /// True faults (FSJ [-], zeta [-]), drawn as red triangles.
    pub truth: Vec<(f64, f64)>,
    /// Estimated faults (FSJ [-], zeta [-]), drawn as blue dots.
    pub estimate: Vec<(f64, f64)>,
    /// Words beside places of the plane.
    pub notes: Vec<((f64, f64), String)>,
}

/// Several curves over a common axis; units belong into the axis labels.
#[derive(Clone, Debug)]
pub struct TracePlot {
    /// Title of the figure.
    pub title: String,
    /// Label of the x axis with its unit, for instance "time [s]".
    pub x_label: String,
    /// Label of the y axis with its unit, for instance "current [A]".
    pub y_label: String,
    /// Name and points of each series; a NaN breaks the line.
    pub series: Vec<(String, Vec<(f64, f64)>)>,
}

/// One row of a table.
#[derive(Clone, Debug)]
pub struct TableRow {
    /// Finished texts, one per column.
    pub cells: Vec<String>,
    /// Whether the row is set off from the others.
    pub emphasis: bool,
}

/// A table with caption and an optional note below it.
#[derive(Clone, Debug)]
pub struct Table {
    /// Caption above the table.
    pub caption: String,
    /// Column headings, with units where there are any.
    pub header: Vec<String>,
    /// The rows in the order of display.
    pub rows: Vec<TableRow>,
    /// Note below the table, left out when empty.
    pub note: String,
}

/// Any of the plots.
#[derive(Clone, Debug)]
pub enum Figure {
    /// A failure map.
    Map(MapPlot),
    /// The located area in the FSJ-zeta plane.
    Region(RegionPlot),
    /// Curves over a common axis.
    Trace(TracePlot),
    /// Sketch of a rotor that stands off the centre of its stator.
    Gap {
        /// Title of the figure.
        title: String,
    },
}

impl Figure {
    /// The title of the figure.
    pub fn title(&self) -> &str {
        match self {
            Figure::Map(plot) => &plot.title,
            Figure::Region(plot) => &plot.title,
            Figure::Trace(plot) => &plot.title,
            Figure::Gap { title } => title,
        }
    }
}

/// How the figures of a section stand.
#[derive(Clone, Copy, Debug, Default)]
pub enum Layout {
    /// Two side by side.
    #[default]
    Pairs,
    /// One below the other.
    One,
    /// Down the first column, then down the second, so many in each.
    Columns(usize),
    /// Two side by side, the lines of a few points broader.
    Broad,
}

/// One section of the report.
#[derive(Clone, Debug, Default)]
pub struct Section {
    /// Heading.
    pub title: String,
    /// Plain text; a blank line separates paragraphs, lines which start with "- " become a list.
    pub text: String,
    /// Tables, shown before the figures.
    pub tables: Vec<Table>,
    /// Figures, each with the stem of its file name.
    pub figures: Vec<(String, Figure)>,
    /// What the page says below a figure in place of its title, by the figure's stem.
    pub captions: Vec<(String, String)>,
    /// How the figures stand.
    pub layout: Layout,
    /// What is folded under its title, behind the figures.
    pub folded: Vec<Section>,
}

impl Section {
    /// All figures, those that are folded too.
    fn every_figure(&self) -> Vec<&(String, Figure)> {
        let folded = self.folded.iter().flat_map(Section::every_figure);
        self.figures.iter().chain(folded).collect()
    }
}

/// The colour of a conclusion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Tone {
    /// Neither good nor bad.
    #[default]
    Plain,
    /// As it should be.
    Good,
    /// A question stays open.
    Open,
    /// Something is broken or worn.
    Fault,
}

/// One point of a conclusion.
#[derive(Clone, Debug, Default)]
pub struct Point {
    /// What it answers, for instance "How sure".
    pub label: String,
    /// The answer, one paragraph.
    pub text: String,
    /// A command to copy.
    pub command: Option<String>,
}

/// What the reader is to know before anything else: the first screen.
#[derive(Clone, Debug, Default)]
pub struct Lead {
    /// Its colour.
    pub tone: Tone,
    /// The kind of the finding in a word or two.
    pub kind: String,
    /// The finding, one sentence.
    pub finding: String,
    /// How sure, what it means, what next.
    pub points: Vec<Point>,
    /// Names that the conclusion uses, each with the rest of the sentence that explains it.
    pub terms: Vec<(String, String)>,
    /// Stem and figure beside the words.
    pub figure: Option<(String, Figure)>,
    /// What the page says below the figure in place of its title; left out when empty.
    pub caption: String,
}

/// The whole report.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Title of the page.
    pub title: String,
    /// The conclusion.
    pub lead: Option<Lead>,
    /// Plain text below title and conclusion, set like the text of a section.
    pub summary: String,
    /// What the findings rest on, as (name, value with unit); shown last.
    pub facts: Vec<(String, String)>,
    /// The sections in the order of display.
    pub sections: Vec<Section>,
}

/// Draws one figure as a complete SVG document (720 x 460 px, region plots 560 x 460 px).
pub fn svg(figure: &Figure) -> Result<String> {
    let body = charts::draw(figure, true)?;
    Ok(format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{body}"))
}

/// Sets the report as one self-contained HTML page with inline styles and inline figures.
pub fn html(report: &Report) -> Result<String> {
    html::page(report)
}

/// Writes the page as `file_name` and each figure as `<stem>.svg` into `dir`, and returns the paths, the page last.
///
/// Every file is written under a temporary name and renamed, so a reader never sees a partial file.
/// Stems must be unique plain file names.
pub fn write(report: &Report, dir: &Path, file_name: &str) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let lead = report.lead.iter().filter_map(|l| l.figure.as_ref());
    for (stem, figure) in lead.chain(report.sections.iter().flat_map(Section::every_figure)) {
        let document = svg(figure).with_context(|| format!("figure {stem:?}"))?;
        files.push((format!("{stem}.svg"), document));
    }
    files.push((file_name.to_owned(), html(report)?));

    let mut seen = HashSet::new();
    for (name, _) in &files {
        let plain = Path::new(name).file_name().is_some_and(|part| part == name.as_str());
        ensure!(plain && name != ".svg", "{name:?} is not a plain file name");
        ensure!(seen.insert(name.as_str()), "two files of the report are named {name:?}");
    }

    fs::create_dir_all(dir).with_context(|| format!("creating {}", dir.display()))?;
    let mut paths = Vec::with_capacity(files.len());
    for (name, content) in &files {
        let path = dir.join(name);
        replace(dir, name, content).with_context(|| format!("writing {}", path.display()))?;
        paths.push(path);
    }
    Ok(paths)
}

/// Writes a file under a temporary name in the same folder and renames it.
fn replace(dir: &Path, name: &str, content: &str) -> Result<()> {
    let temporary = dir.join(format!(".{name}.{}.tmp", std::process::id()));
    let fill = || -> std::io::Result<()> {
        let mut file = fs::File::create(&temporary)?;
        file.write_all(content.as_bytes())?;
        file.sync_all()?;
        fs::rename(&temporary, dir.join(name))
    };
    fill().inspect_err(|_| {
        // The first error is the one worth reporting; a leftover temporary file is harmless.
        let _ = fs::remove_file(&temporary);
    })?;
    Ok(())
}

/// Replaces the characters which have a meaning in HTML and XML.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() && !matches!(c, '\n' | '\t') => out.push(' '),
            c => out.push(c),
        }
    }
    out
}
