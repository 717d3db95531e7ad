//! The report as one self-contained HTML page.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};

use super::{Figure, Report, Section, Table, charts, escape};

const STYLE: &str = r#"
:root { --ink: #1f2933; --muted: #5f6c78; --line: #d8dde3; --soft: #f5f7f9; --accent: #21618c; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0; background: #fff; color: var(--ink); font: 16px/1.55 "Source Sans 3", "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1320px; margin: 0 auto; padding: 40px 32px 64px; }
h1 { font-size: 1.9rem; line-height: 1.25; margin: 0 0 .6rem; letter-spacing: -.01em; }
h2 { font-size: 1.35rem; line-height: 1.3; margin: 0 0 .7rem; }
p, ul.text { max-width: 78ch; margin: 0 0 .8rem; }
ul.text { padding-left: 1.3em; }
a { color: var(--accent); text-decoration: none; }
a:hover { text-decoration: underline; }
dl.facts { display: grid; grid-template-columns: repeat(auto-fill, minmax(210px, 1fr)); gap: 1px; margin: 1.4rem 0; padding: 1px; background: var(--soft); border: 1px solid var(--line); border-radius: 6px; overflow: hidden; }
dl.facts div { background: var(--soft); padding: .55rem .85rem; box-shadow: 0 0 0 1px var(--line); }
dl.facts dt { color: var(--muted); font-size: .8rem; }
dl.facts dd { margin: 0; font-weight: 600; font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
nav { margin: 1.4rem 0 0; padding: .8rem 0; border-top: 1px solid var(--line); border-bottom: 1px solid var(--line); }
nav h2 { font-size: .8rem; margin: 0 0 .3rem; color: var(--muted); font-weight: 600; }
nav ol { margin: 0; padding-left: 1.5em; columns: 2 26em; column-gap: 3em; font-size: .95rem; }
section { margin-top: 2.6rem; }
.table { margin: 1.2rem 0; overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; line-height: 1.4; min-width: 40%; border-bottom: 1.5px solid var(--ink); }
caption { text-align: left; font-weight: 600; padding-bottom: .45rem; }
th, td { padding: .34rem .9rem; text-align: left; vertical-align: top; }
th:first-child, td:first-child { padding-left: .5rem; }
th { border-top: 1.5px solid var(--ink); border-bottom: 1px solid var(--ink); font-weight: 600; vertical-align: bottom; }
td { border-top: 1px solid #e9edf0; }
.num { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.strong td { font-weight: 600; background: #eef4f8; }
.note { color: var(--muted); font-size: .85rem; margin: .45rem 0 0; }
.figures { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 1.8rem 1.6rem; align-items: end; margin-top: 1.2rem; }
figure { margin: 0; min-width: 0; }
figure.only { grid-column: 1 / -1; max-width: 820px; }
figure svg { display: block; width: 100%; height: auto; }
figure.narrow svg { max-width: 510px; margin: 0 auto; }
figure svg text { font-family: inherit; }
figcaption { margin: .25rem 0 0; padding: 0 .6rem; color: var(--muted); font-size: .88rem; line-height: 1.4; text-align: center; }
@media (max-width: 860px) { main { padding: 24px 16px 40px; } .figures { grid-template-columns: minmax(0, 1fr); } }
@media print {
  @page { margin: 14mm; }
  html { font-size: 10pt; }
  body { font-size: 1rem; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  main { max-width: none; padding: 0; }
  a { color: inherit; }
  h2, caption { break-after: avoid; }
  figure, tr, dl.facts { break-inside: avoid; }
  .figures { gap: 1rem; grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .table { overflow: visible; }
}
"#;

/// Sets the whole page.
pub(super) fn page(report: &Report) -> Result<String> {
    let title = escape(&report.title);
    let mut out = String::new();
    write!(
        out,
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n<header>\n<h1>{title}</h1>\n"
    )?;
    prose(&mut out, &report.summary)?;
    if !report.facts.is_empty() {
        out.push_str("<dl class=\"facts\">\n");
        for (name, value) in &report.facts {
            writeln!(out, "<div><dt>{}</dt><dd>{}</dd></div>", escape(name), escape(value))?;
        }
        out.push_str("</dl>\n");
    }
    out.push_str("</header>\n");
    if !report.sections.is_empty() {
        out.push_str("<nav aria-label=\"Contents\">\n<h2>Contents</h2>\n<ol>\n");
        for (i, section) in report.sections.iter().enumerate() {
            writeln!(
                out,
                "<li><a href=\"#section-{}\">{}</a></li>",
                i + 1,
                escape(&section.title)
            )?;
        }
        out.push_str("</ol>\n</nav>\n");
    }
    for (i, part) in report.sections.iter().enumerate() {
        section(&mut out, i + 1, part)?;
    }
    out.push_str("</main>\n</body>\n</html>\n");
    Ok(out)
}

fn section(out: &mut String, number: usize, section: &Section) -> Result<()> {
    writeln!(
        out,
        "<section id=\"section-{number}\">\n<h2>{number}. {}</h2>",
        escape(&section.title)
    )?;
    prose(out, &section.text)?;
    for part in &section.tables {
        table(out, part)?;
    }
    if !section.figures.is_empty() {
        out.push_str("<div class=\"figures\">\n");
        for (stem, figure) in &section.figures {
            let mut classes = Vec::new();
            if section.figures.len() == 1 {
                classes.push("only");
            }
            if matches!(figure, Figure::Region(_)) {
                classes.push("narrow");
            }
            let svg = charts::draw(figure, false).with_context(|| format!("figure {stem:?}"))?;
            let caption = escape(figure.title());
            let class = classes.join(" ");
            writeln!(
                out,
                "<figure class=\"{class}\">\n{svg}<figcaption>{caption}</figcaption>\n</figure>"
            )?;
        }
        out.push_str("</div>\n");
    }
    out.push_str("</section>\n");
    Ok(())
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
        writeln!(out, "<p>{}</p>", escape(&lines.join("\n")))?;
        return Ok(());
    }
    out.push_str("<ul class=\"text\">");
    for (i, line) in lines.iter().enumerate() {
        match line.strip_prefix("- ") {
            Some(item) => write!(out, "{}<li>{}", if i > 0 { "</li>\n" } else { "\n" }, escape(item))?,
            None => write!(out, " {}", escape(line))?,
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
        writeln!(out, "<caption>{}</caption>", escape(&table.caption))?;
    }
    if !table.header.is_empty() {
        out.push_str("<thead><tr>");
        for i in 0..columns {
            let text = table.header.get(i).map(String::as_str).unwrap_or_default();
            write!(out, "<th scope=\"col\"{}>{}</th>", class(i), escape(text))?;
        }
        out.push_str("</tr></thead>\n");
    }
    out.push_str("<tbody>\n");
    for row in &table.rows {
        out.push_str(if row.emphasis { "<tr class=\"strong\">" } else { "<tr>" });
        for i in 0..columns {
            let text = row.cells.get(i).map(String::as_str).unwrap_or_default();
            write!(out, "<td{}>{}</td>", class(i), escape(text))?;
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody>\n</table>\n");
    if !table.note.is_empty() {
        writeln!(out, "<p class=\"note\">{}</p>", escape(&table.note))?;
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
