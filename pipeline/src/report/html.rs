//! The report as one self-contained HTML page.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};

use super::theme::dark_rules;
use super::{Figure, Layout, Lead, Report, Section, Table, Tone, charts, escape};

/// The look of every page.
const STYLE: &str = include_str!("style.css");

/// Longest name that is kept on one line.
const LONGEST_NAME: usize = 40;

/// Sets the whole page.
pub(super) fn page(report: &Report) -> Result<String> {
    let title = escape(&report.title);
    let mut out = String::new();
    write!(
        out,
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{STYLE}{}</style>\n</head>\n<body>\n<main>\n<header>\n<h1>{}</h1>\n",
        dark_rules(),
        heading(&report.title)
    )?;
    if let Some(l) = &report.lead {
        lead(&mut out, l)?;
    }
    prose(&mut out, &report.summary)?;
    if report.sections.iter().any(|s| !s.folded.is_empty()) {
        out.push_str(
            "<p class=\"note paper-only\">Folded parts are not printed; unfold them on the screen first.</p>\n",
        );
    }
    out.push_str("</header>\n");
    let about = (!report.facts.is_empty()).then_some(FACTS);
    let titles: Vec<&str> = report.sections.iter().map(|s| s.title.as_str()).chain(about).collect();
    if titles.len() > 1 {
        out.push_str("<nav aria-label=\"Contents\">\n<h2>Contents</h2>\n<ol>\n");
        for (i, title) in titles.iter().enumerate() {
            writeln!(out, "<li><a href=\"#section-{}\">{}</a></li>", i + 1, heading(title))?;
        }
        out.push_str("</ol>\n</nav>\n");
    }
    for (i, part) in report.sections.iter().enumerate() {
        writeln!(
            out,
            "<section id=\"section-{0}\"{1}>\n<h2>{0}. {2}</h2>",
            i + 1,
            layout(part.layout),
            heading(&part.title)
        )?;
        inside(&mut out, part)?;
        out.push_str("</section>\n");
    }
    if about.is_some() {
        let n = titles.len();
        writeln!(
            out,
            "<section id=\"section-{n}\">\n<h2>{n}. {FACTS}</h2>\n<dl class=\"facts\">"
        )?;
        for (name, value) in &report.facts {
            writeln!(out, "<div><dt>{}</dt><dd>{}</dd></div>", flowing(name), flowing(value))?;
        }
        out.push_str("</dl>\n</section>\n");
    }
    out.push_str("</main>\n</body>\n</html>\n");
    Ok(out)
}

/// Heading of the facts.
const FACTS: &str = "What this rests on";

/// The first screen: the conclusion, and the figure that shows it.
fn lead(out: &mut String, lead: &Lead) -> Result<()> {
    let tone = match lead.tone {
        Tone::Plain => "",
        Tone::Good => " good",
        Tone::Open => " open",
        Tone::Fault => " fault",
    };
    let alone = if lead.figure.is_none() { " alone" } else { "" };
    writeln!(
        out,
        "<div class=\"lead{tone}{alone}\">\n<div>\n<p class=\"kind\">{}</p>\n<p class=\"finding\">{}</p>",
        flowing(&lead.kind),
        flowing(&lead.finding)
    )?;
    if !lead.points.is_empty() {
        out.push_str("<dl>\n");
        for (i, p) in lead.points.iter().enumerate() {
            write!(out, "<div><dt>{}</dt><dd>{}", flowing(&p.label), flowing(&p.text))?;
            if let Some(command) = &p.command {
                write!(out, "<pre class=\"wrap\"><code>{}</code></pre>", escape(command.trim()))?;
            }
            out.push_str("</dd></div>\n");
            // where they were first used
            if i == 0 {
                terms(out, &lead.terms)?;
            }
        }
        out.push_str("</dl>\n");
    }
    out.push_str("</div>\n");
    if let Some((stem, f)) = &lead.figure {
        let caption = if lead.caption.is_empty() {
            f.title()
        } else {
            &lead.caption
        };
        figure(out, stem, f, caption, false)?;
    }
    out.push_str("</div>\n");
    Ok(())
}

/// What the names mean that the first point uses.
fn terms(out: &mut String, terms: &[(String, String)]) -> Result<()> {
    if terms.is_empty() {
        return Ok(());
    }
    out.push_str("<div class=\"terms\"><dt>The names</dt><dd>");
    for (name, rest) in terms {
        writeln!(out, "<b>{}</b> {}", flowing(name), flowing(rest))?;
    }
    out.push_str("</dd></div>\n");
    Ok(())
}

/// Attributes of a part by how its figures stand.
fn layout(layout: Layout) -> String {
    match layout {
        Layout::Pairs => String::new(),
        Layout::One => " class=\"one\"".into(),
        Layout::Columns(rows) => format!(" class=\"columns\" style=\"--rows: {rows}\""),
        Layout::Broad => " class=\"broad\"".into(),
    }
}

/// What stands below the heading of a section.
fn inside(out: &mut String, section: &Section) -> Result<()> {
    prose(out, &section.text)?;
    for part in &section.tables {
        table(out, part)?;
    }
    if !section.figures.is_empty() {
        out.push_str("<div class=\"figures\">\n");
        for (stem, f) in &section.figures {
            let own = section.captions.iter().find(|c| c.0 == *stem);
            let caption = own.map_or(f.title(), |c| &c.1);
            figure(out, stem, f, caption, section.figures.len() == 1)?;
        }
        out.push_str("</div>\n");
    }
    for part in &section.folded {
        writeln!(
            out,
            "<details>\n<summary>{}</summary>\n<div class=\"inside\"><div{}>",
            heading(&part.title),
            layout(part.layout)
        )?;
        inside(out, part)?;
        out.push_str("</div></div>\n</details>\n");
    }
    Ok(())
}

fn figure(out: &mut String, stem: &str, figure: &Figure, caption: &str, only: bool) -> Result<()> {
    let mut classes = Vec::new();
    if only {
        classes.push("only");
    }
    if matches!(figure, Figure::Region(_) | Figure::Gap { .. }) {
        classes.push("narrow");
    }
    let svg = charts::draw(figure, false).with_context(|| format!("figure {stem:?}"))?;
    writeln!(
        out,
        "<figure class=\"{}\">\n{svg}<figcaption>{}</figcaption>\n</figure>",
        classes.join(" "),
        flowing(caption)
    )?;
    Ok(())
}

/// A text with names such as EMA-1 or aileron-002 kept on one line: browsers break at hyphens.
fn flowing(text: &str) -> String {
    unbroken(text, |word| word.contains(|c: char| c.is_ascii_digit()))
}

/// A heading: every word with a hyphen may be a name.
fn heading(text: &str) -> String {
    unbroken(text, |_| true)
}

/// Escaped, with those hyphenated words kept on one line that `is_name` says are names.
fn unbroken(text: &str, is_name: impl Fn(&str) -> bool) -> String {
    let part = |piece: &str| {
        let word = piece.trim_end();
        let inner = word.trim_matches('-');
        if inner.contains('-') && word.chars().count() <= LONGEST_NAME && is_name(word) {
            format!("<span class=\"name\">{}</span>{}", escape(word), &piece[word.len()..])
        } else {
            escape(piece)
        }
    };
    let all: String = text.split_inclusive(char::is_whitespace).map(part).collect();
    // a percentage is one word too
    all.replace(" %", "&nbsp;%")
}

/// Plain text as paragraphs and lists.
fn prose(out: &mut String, text: &str) -> Result<()> {
    let mut lines: Vec<&str> = Vec::new();
    let mut list = false;
    // A blank line at the end closes the last block.
    for line in text.lines().map(str::trim).chain([""]) {
        let item = line.strip_prefix("- ");
        let continues = list && !line.is_empty() && item.is_none();
        if (line.is_empty() || item.is_some() != list) && !continues {
            block(out, &lines, list)?;
            lines.clear();
            list = item.is_some();
        }
        if !line.is_empty() {
            lines.push(line);
        }
    }
    Ok(())
}

fn block(out: &mut String, lines: &[&str], list: bool) -> Result<()> {
    if lines.is_empty() {
        return Ok(());
    }
    if !list {
        writeln!(out, "<p>{}</p>", flowing(&lines.join("\n")))?;
        return Ok(());
    }
    out.push_str("<ul class=\"text\">");
    for (i, line) in lines.iter().enumerate() {
        match line.strip_prefix("- ") {
            Some(item) => write!(out, "{}<li>{}", if i > 0 { "</li>\n" } else { "\n" }, flowing(item))?,
            None => write!(out, " {}", flowing(line))?,
        }
    }
    out.push_str("</li>\n</ul>\n");
    Ok(())
}

fn table(out: &mut String, table: &Table) -> Result<()> {
    let columns = table
        .rows
        .iter()
        .map(|row| row.cells.len())
        .chain([table.header.len()])
        .max()
        .unwrap_or(0);
    if columns == 0 {
        return Ok(());
    }
    // A column whose filled cells are all numbers is set flush right.
    let right: Vec<bool> = (0..columns)
        .map(|i| {
            let mut filled = table
                .rows
                .iter()
                .filter_map(|row| row.cells.get(i))
                .filter(|c| !blank(c))
                .peekable();
            filled.peek().is_some() && filled.all(|c| numeric(c))
        })
        .collect();
    let class = |i: usize| if right[i] { " class=\"num\"" } else { "" };

    out.push_str("<div class=\"table\">\n<table>\n");
    if !table.caption.is_empty() {
        writeln!(out, "<caption>{}</caption>", flowing(&table.caption))?;
    }
    if !table.header.is_empty() {
        out.push_str("<thead><tr>");
        for i in 0..columns {
            let text = table.header.get(i).map(String::as_str).unwrap_or_default();
            write!(out, "<th scope=\"col\"{}>{}</th>", class(i), flowing(text))?;
        }
        out.push_str("</tr></thead>\n");
    }
    out.push_str("<tbody>\n");
    for row in &table.rows {
        out.push_str(if row.emphasis { "<tr class=\"strong\">" } else { "<tr>" });
        for i in 0..columns {
            let text = row.cells.get(i).map(String::as_str).unwrap_or_default();
            write!(out, "<td{}>{}</td>", class(i), flowing(text))?;
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody>\n</table>\n");
    if !table.note.is_empty() {
        writeln!(out, "<p class=\"note\">{}</p>", flowing(&table.note))?;
    }
    out.push_str("</div>\n");
    Ok(())
}

fn blank(cell: &str) -> bool {
    matches!(cell.trim(), "" | "-" | "\u{2013}" | "\u{2014}" | "n/a")
}

/// Whether a cell reads as a number, possibly with a sign, an exponent, a tolerance, a range or a short unit.
fn numeric(cell: &str) -> bool {
    let start = cell
        .trim()
        .trim_start_matches(['+', '-', '\u{2212}', '\u{b1}', '<', '>', '(', '[', '~', ' ']);
    start.starts_with(|c: char| c.is_ascii_digit()) && cell.chars().filter(|c| c.is_alphabetic()).count() <= 4
}
