//! `report.html`: what a study found, as one page that can be mailed.

use super::discrepancy_figures::{
    NOTHING, bars, by_channel, change, driven, escape, headline, interval, number, profiles, row, share, simulated,
    table, traces,
};
use crate::report::{Layout, Lead, Report, Section, Table, TableRow, Tone, html};
use anyhow::{Context as _, Result};
use ema_study::told::findings::{ChannelGap, Findings, FoundEffect};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Writes `report.html` into `dir`, complete or not at all, and returns its path.
pub fn write(findings: &Findings, dir: &Path) -> Result<PathBuf> {
    let page = page(findings)?;
    let path = dir.join("report.html");
    let temporary = dir.join(format!(".report.html.{}.tmp", std::process::id()));
    let put = || {
        fs::create_dir_all(dir)?;
        fs::write(&temporary, page)?;
        fs::rename(&temporary, &path)
    };
    put().with_context(|| format!("writing {}", path.display()))?;
    Ok(path)
}

/// Parts of the page that the report has no words for: a paragraph holds their place.
#[derive(Default)]
struct Blocks(Vec<String>);

impl Blocks {
    /// Text that stands for a block, a paragraph of its own.
    fn put(&mut self, html: String) -> String {
        self.0.push(html);
        format!("\n\n\u{e000}{}\u{e001}\n\n", self.0.len() - 1)
    }

    fn code(&mut self, text: &str) -> String {
        self.put(format!(
            "<pre class=\"wrap\"><code>{}</code></pre>",
            escape(text.trim())
        ))
    }

    fn set(&self, page: String) -> String {
        self.0.iter().enumerate().fold(page, |page, (i, block)| {
            page.replacen(&format!("<p>\u{e000}{i}\u{e001}</p>"), block, 1)
        })
    }
}

/// A text of the findings in one line, so that it makes no paragraphs or lists of its own.
fn line(text: &str) -> String {
    let text: String = text.chars().filter(|c| !matches!(c, '\u{e000}' | '\u{e001}')).collect();
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The text with a full stop.
fn sentence(text: &str) -> String {
    let text = line(text);
    if text.is_empty() || text.ends_with(['.', '!', '?', ':']) {
        text
    } else {
        text + "."
    }
}

fn section(title: &str, text: String, tables: Vec<Table>) -> Section {
    Section {
        title: title.into(),
        text,
        tables,
        ..Section::default()
    }
}

fn verdict(f: &Findings) -> Lead {
    let (tone, name) = match f.verdict.as_str() {
        "none" => (Tone::Good, "No gap"),
        "retune" => (Tone::Good, "Re-tuning is enough"),
        "named" => (Tone::Good, "Effect named"),
        "named_with_remainder" => (Tone::Open, "Effect named, with a remainder"),
        "ambiguous" => (Tone::Open, "Ambiguous"),
        "unknown" => (Tone::Open, "Unknown"),
        other => (Tone::Plain, other),
    };
    Lead {
        tone,
        kind: format!("Verdict: {name}"),
        finding: line(&f.sentence),
        ..Lead::default()
    }
}

/// The gap by channel, or that of the drive channel alone.
fn gaps(f: &Findings) -> Vec<&ChannelGap> {
    if f.by_channel.is_empty() {
        f.gap.iter().collect()
    } else {
        f.by_channel.iter().collect()
    }
}

fn gap(f: &Findings) -> Section {
    let added = !f.effects.is_empty();
    let mut tables: Vec<Table> = f.gap.iter().map(|g| headline(g, added)).collect();
    let mut text = String::new();
    if !f.by_channel.is_empty() {
        tables.push(by_channel(&gaps(f), added));
    } else if f.gap.is_none() {
        text = "No equation could be evaluated: there is no gap to show.".into();
    }
    section("The gap", text, tables)
}

fn gap_bars(f: &Findings, blocks: &mut Blocks) -> Option<Section> {
    let gaps = gaps(f);
    if gaps.is_empty() {
        return None;
    }
    let text = "Root mean square of measured \u{2212} predicted. Each channel has its own scale; the dashed line is its \
                noise floor.";
    let text = text.to_string() + &blocks.put(bars(&gaps, !f.effects.is_empty()));
    Some(section("The gap before and after", text, Vec::new()))
}

fn places(f: &Findings) -> Option<Section> {
    if f.regions.is_empty() {
        return None;
    }
    let mut text = String::from("Where the excess over the noise is:\n\n");
    for r in &f.regions {
        // the text says the shares itself
        text += &format!("- {}\n", line(&r.text).trim_end_matches('.'));
    }
    Some(section("Where the gap is", text, Vec::new()))
}

fn effect(n: usize, e: &FoundEffect, blocks: &mut Blocks) -> Section {
    let mut text = format!("{} appears in the {} equation as", line(&e.name), line(&e.equation));
    text += &blocks.code(&e.term);
    if e.explained_share.is_finite() {
        text += &format!(
            "- It explains {} of the excess that its equation has without it.\n",
            share(e.explained_share)
        );
    }
    if let Some(alias) = &e.alias {
        text += &format!("- Another name of the same term: {}\n", line(alias));
    }
    if let Some(law) = e.law_in_words() {
        text += &format!("- Its law: {law}.\n");
    }
    match &e.runner_up {
        Some(r) => text += &format!("- Runner-up: {}\n", line(r)),
        None => text += "- There was no runner-up.\n",
    }
    if e.ambiguous_with.is_empty() {
        text += "- No other effect of the list fits as well.\n";
    } else {
        let names: Vec<String> = e.ambiguous_with.iter().map(|a| line(a)).collect();
        text += &format!("- It could not be told from: {}\n", names.join(", "));
    }
    let rows: Vec<TableRow> = e
        .parameters
        .iter()
        .map(|p| {
            let cells = interval(p);
            row(
                std::iter::once(p.name.clone())
                    .chain(cells.into_iter().skip(1))
                    .collect(),
                false,
            )
        })
        .collect();
    let parameters = table(
        &format!("Parameters of {}", e.name),
        &["Parameter", "Value", "95 % interval", "Unit"],
        rows,
        "",
    );
    let tables = if e.parameters.is_empty() {
        Vec::new()
    } else {
        vec![parameters]
    };
    section(&format!("Effect {n}: {}", e.name), text, tables)
}

fn unnamed(f: &Findings) -> Option<Section> {
    let much = f.unnamed_share.is_finite() && f.unnamed_share >= 5e-4 && f.verdict != "none";
    if !much && f.unnamed.is_none() {
        return None;
    }
    let mut text = String::new();
    if much {
        text += &format!("{} of the excess over the noise has no name. ", share(f.unnamed_share));
    }
    text += &f.unnamed.as_deref().map(sentence).unwrap_or_default();
    Some(section("What has no name", text, Vec::new()))
}

fn retuned(f: &Findings) -> Option<Section> {
    if f.retuned.is_empty() {
        return None;
    }
    let rows = f
        .retuned
        .iter()
        .map(|p| {
            let mut cells = interval(p);
            let inside = p
                .nominal
                .filter(|_| !p.lo.is_nan() && !p.hi.is_nan())
                .map(|n| (p.lo..=p.hi).contains(&n));
            cells.insert(0, p.name.clone());
            cells.push(p.nominal.map_or(NOTHING.into(), |n| change(p.value, n)));
            cells.push(inside.map_or(NOTHING, |i| if i { "yes" } else { "no" }).into());
            row(cells, false)
        })
        .collect();
    let header = [
        "Constant",
        "Nominal",
        "Value",
        "95 % interval",
        "Unit",
        "Change",
        "Nominal inside the interval",
    ];
    let constants = table(
        "Constants of the model, identified from the fit runs",
        &header,
        rows,
        "",
    );
    Some(section("Re-tuned constants", String::new(), vec![constants]))
}

fn leaderboard(f: &Findings) -> Option<Section> {
    let steps: BTreeSet<usize> = f.leaders.iter().map(|l| l.step).collect();
    if steps.is_empty() {
        return None;
    }
    let first = usize::from(!steps.contains(&0));
    let tables = steps.iter().map(|step| {
        let rows = f.leaders.iter().filter(|l| l.step == *step).map(|l| {
            let named = l.note.starts_with("taken");
            let cells = [
                l.name.clone(),
                number(l.gain, if l.gain.abs() < 1000.0 { 3 } else { 4 }),
                share(l.explained_share),
                line(&l.parameters),
                line(&l.note),
            ];
            row(cells.to_vec(), named)
        });
        let header = [
            "Candidate",
            "Gain in log-likelihood",
            "Explained share",
            "Parameters",
            "Note",
        ];
        table(&format!("Step {}", step + 1 - first), &header, rows.collect(), "")
    });
    let taken = if f.effects.is_empty() {
        "None was taken."
    } else {
        "The one that was taken is set off."
    };
    let text = format!(
        "Candidates of each step by their gain in log-likelihood on the fit runs, with the constants re-tuned for \
         each; the share is of the excess before the step. {taken}"
    );
    Some(section("Leaderboard", text, tables.collect()))
}

fn measured(f: &Findings) -> Option<Section> {
    let figures: Vec<_> = traces(f).into_iter().flatten().collect();
    if figures.is_empty() {
        return None;
    }
    let text = "Measured and predicted over time, each with the residuals of the models.";
    // each residual below its trace
    let layout = if figures.len() == 2 {
        Layout::One
    } else {
        Layout::Columns(2 * figures.len().div_ceil(4))
    };
    Some(Section {
        figures,
        layout,
        ..section("Measured and predicted", text.into(), Vec::new())
    })
}

fn simulation(f: &Findings) -> Option<Section> {
    let v = f.verification.as_ref()?;
    let mut text = String::new();
    if !v.channels.is_empty() {
        text += "The numerical test bench and the simplified model, run under the command that was recorded: with the \
                 parameters of the model as it was, and with what was found. In closed loop the controller hides part \
                 of what is missing, so that these gaps are not those of the equations above.";
    }
    for l in &v.left_out {
        text += &format!("\n\n- not simulated: {}", line(l));
    }
    if text.is_empty() {
        return None;
    }
    let tables = (!v.channels.is_empty()).then(|| simulated(v)).into_iter().collect();
    Some(Section {
        figures: driven(v),
        ..section("The actuator under the recorded command", text, tables)
    })
}

fn along(f: &Findings) -> Option<Section> {
    let figures = profiles(f);
    if figures.is_empty() {
        return None;
    }
    let text = "Means of the residual in bins: what the model has right lies on the zero line.";
    Some(Section {
        figures,
        // few points each
        layout: Layout::Broad,
        ..section("Residual along the signals", text.into(), Vec::new())
    })
}

fn unseen(f: &Findings) -> Option<Section> {
    let rows = |pairs: &[(String, String)]| -> Vec<TableRow> {
        pairs
            .iter()
            .map(|(name, why)| row(vec![name.clone(), line(why)], false))
            .collect()
    };
    let mut tables = Vec::new();
    if !f.not_excited.is_empty() {
        let caption = "Not excited: present or not, these runs cannot show it";
        tables.push(table(caption, &["Effect", "Why"], rows(&f.not_excited), ""));
    }
    if !f.missing.is_empty() {
        let caption = "Missing channels";
        tables.push(table(caption, &["Channel", "What it would open"], rows(&f.missing), ""));
    }
    (!tables.is_empty()).then(|| section("What could not be seen", String::new(), tables))
}

fn next(f: &Findings, blocks: &mut Blocks) -> Option<Section> {
    let mut text = sentence(&f.next_reason);
    if let Some(command) = f.next_command.as_deref().filter(|c| !c.trim().is_empty()) {
        text += &blocks.code(command);
    }
    (!text.is_empty()).then(|| section("What comes next", text, Vec::new()))
}

fn diff(f: &Findings, blocks: &mut Blocks) -> Option<Section> {
    if f.diff.is_empty() {
        return None;
    }
    let mut html = String::from("<pre class=\"diff\"><code>");
    for l in &f.diff {
        let class = match l.chars().next() {
            Some('+') => " class=\"add\"",
            Some('-') => " class=\"del\"",
            _ => "",
        };
        let text = if l.trim().is_empty() { " " } else { l.trim_end() };
        html += &format!("<span{class}>{}</span>", escape(text));
    }
    html += "</code></pre>";
    let text = format!("What changes in {}:", file_name(&f.model)) + &blocks.put(html);
    Some(section("The model\u{2019}s file", text, Vec::new()))
}

fn assumptions(f: &Findings, blocks: &mut Blocks) -> Option<Section> {
    if f.assumptions.is_empty() {
        return None;
    }
    let items: String = f
        .assumptions
        .iter()
        .map(|a| {
            format!(
                "<li><span class=\"tag\">assumed</span><span>{}</span></li>\n",
                escape(&line(a))
            )
        })
        .collect();
    let text = blocks.put(format!("<ul class=\"assumed\">\n{items}</ul>"));
    Some(section(
        "Assumptions",
        "Neither measured nor checked by this study:".to_string() + &text,
        Vec::new(),
    ))
}

/// The last part of a path.
fn file_name(path: &str) -> String {
    let name = Path::new(path).file_name().map_or(path.into(), |n| n.to_string_lossy());
    line(&name)
}

/// The whole page.
fn page(f: &Findings) -> Result<String> {
    let mut blocks = Blocks::default();
    let mut sections = vec![gap(f)];
    sections.extend(gap_bars(f, &mut blocks));
    sections.extend(places(f));
    sections.extend(f.effects.iter().enumerate().map(|(i, e)| effect(i + 1, e, &mut blocks)));
    sections.extend(unnamed(f));
    sections.extend(leaderboard(f));
    sections.extend(measured(f));
    sections.extend(simulation(f));
    sections.extend(along(f));
    sections.extend(retuned(f));
    sections.extend(unseen(f));
    sections.extend(next(f, &mut blocks));
    sections.extend(diff(f, &mut blocks));
    sections.extend(assumptions(f, &mut blocks));
    let mut facts = Vec::new();
    for (name, value) in [("Model", &f.model), ("Bench", &f.bench)] {
        if !value.is_empty() && !f.facts.iter().any(|(n, _)| n.eq_ignore_ascii_case(name)) {
            facts.push((name.to_string(), value.clone()));
        }
    }
    facts.extend(f.facts.iter().cloned());
    let report = Report {
        title: {
            // a rig may have no model's file
            let files = [file_name(&f.model), file_name(&f.bench)];
            let files: Vec<&str> = files.iter().map(|x| &x[..]).filter(|x| !x.is_empty()).collect();
            format!("Model against measurement: {}", files.join(", "))
        },
        lead: Some(verdict(f)),
        facts,
        sections,
        ..Report::default()
    };
    Ok(blocks.set(html(&report)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ema_study::told::findings::{GapLine, Identified};

    fn plain() -> Findings {
        Findings {
            model: "ema.toml".into(),
            verdict: "none".into(),
            sentence: "The gap is below a < b of the noise.".into(),
            unnamed_share: f64::NAN,
            ..Findings::default()
        }
    }

    #[test]
    fn sentence_is_escaped_and_empty_sections_left_out() {
        let page = page(&plain()).expect("set");
        assert!(page.contains("The gap is below a &lt; b of the noise.") && !page.contains("a < b"));
        for absent in [
            "Leaderboard",
            "Re-tuned",
            "What comes next",
            "Assumptions",
            "<pre",
            "Effect",
            "\u{e000}",
            "NaN",
        ] {
            assert!(!page.contains(absent), "{absent}");
        }
        assert!(page.contains("there is no gap to show"));
    }

    #[test]
    fn wide_intervals_stay_short() {
        let told = |value, lo, hi| {
            interval(&Identified {
                name: "k".into(),
                value,
                lo,
                hi,
                unit: "N m".into(),
                nominal: None,
            })[1..]
                .join("; ")
        };
        assert_eq!(told(0.01, 0.0, 1e9), "10.0; 0.0 to 1.00\u{d7}10\u{b9}\u{b2}; mN m");
        assert_eq!(told(1e-9, -0.01, 0.02), "0.0; \u{2212}10.0 to 20.0; mN m");
        assert_eq!(told(2.0, 1.5, f64::INFINITY), "2.000; 1.500 to \u{221e}; N m");
    }

    #[test]
    fn odd_numbers_and_texts_do_no_harm() {
        let nan = f64::NAN;
        let broken = GapLine {
            nominal: nan,
            retuned: f64::INFINITY,
            last: 0.0,
            floor: 0.0,
        };
        let channel = ChannelGap {
            channel: "<i>".into(),
            equation: "torque".into(),
            unit: "A".into(),
            fit: broken,
            heldout: None,
        };
        let constant = Identified {
            name: "J".into(),
            value: nan,
            lo: nan,
            hi: nan,
            unit: "kg m2".into(),
            nominal: Some(0.0),
        };
        let found = Findings {
            gap: Some(channel.clone()),
            by_channel: vec![channel],
            retuned: vec![constant],
            diff: vec!["+ name = \"<b>\"".into(), "-x".into(), String::new()],
            next_command: Some("ema a && b <c>".into()),
            ..plain()
        };
        let page = page(&found).expect("set");
        assert!(page.contains("no held-out runs") && page.contains("&lt;i&gt;") && !page.contains("<i>"));
        assert!(
            page.contains("ema a &amp;&amp; b &lt;c&gt;") && page.contains("class=\"add\">+ name = &quot;&lt;b&gt;")
        );
        assert!(!page.contains("NaN") && !page.contains(">inf"), "{page}");
    }
}
