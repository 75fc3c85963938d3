//! Report of a run: one HTML file without external parts, which opens on any machine.
//!
//! Style and figures are inside the file; it loads nothing, and runs only the scripts that the
//! caller passes, which its policy names by their hashes. It is readable on a phone and follows the
//! reader's dark mode. The caller provides text and numbers; this module only typesets and escapes
//! them.

use std::fmt::Write;

/// Level of a line of the verdict.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// As it should be.
    Good,
    /// To be known, but not wrong.
    Note,
    /// Wrong: what follows must not be trusted without thought.
    Bad,
}

/// One line of the verdict.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verdict {
    /// Level of the line.
    pub level: Level,
    /// A sentence.
    pub text: String,
}

/// A table of text and numbers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Table {
    /// Caption of the table.
    pub caption: String,
    /// Names of the columns, with units.
    pub header: Vec<String>,
    /// Rows; a short one is filled with empty cells, a long one is shown whole.
    pub rows: Vec<Vec<String>>,
}

/// A plot with text below it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// Text of an SVG as [`crate`] makes it.
    pub svg: String,
    /// Caption of the plot.
    pub caption: String,
}

/// A part that is drawn by scripts within the file. Without scripts it shows its text.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Scripted {
    /// The heading.
    pub heading: String,
    /// Its text, also for a reader without scripts.
    pub words: String,
    /// Style of the part.
    pub style: String,
    /// Scripts, run in order; the last one draws into the element `scripted`.
    pub scripts: Vec<String>,
    /// Policy (CSP) that allows these scripts and no others.
    pub policy: String,
    /// JSON, found as the text of the element `scripted-data`.
    pub data: String,
}

/// Contents of a report, in the order in which they are shown.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Report {
    /// First line.
    pub title: String,
    /// The outcome in sentences, the most important first.
    pub verdicts: Vec<Verdict>,
    /// Part that is drawn by scripts, before the plots.
    pub scripted: Option<Scripted>,
    /// Plots.
    pub figures: Vec<Figure>,
    /// Tables.
    pub tables: Vec<Table>,
    /// Sections with a heading each, after the tables.
    pub sections: Vec<Section>,
    /// Origin of the numbers: version, configuration, seed, instruments, …
    pub provenance: Vec<(String, String)>,
    /// Files needed to repeat the diagnosis, by name, with their text; folded by default.
    pub files: Vec<(String, String)>,
}

/// A heading and its contents.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Section {
    /// The heading.
    pub heading: String,
    /// From the top.
    pub parts: Vec<Part>,
    /// True if a new page begins in print.
    pub new_page: bool,
}

/// A piece of a section.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Part {
    /// A paragraph.
    Text(String),
    /// Points of a list.
    List(Vec<String>),
    /// A table.
    Table(Table),
    /// A plot.
    Figure(Figure),
    /// A name, which may be empty, with its properties.
    Fields(String, Vec<(String, String)>),
    /// Text set as it is.
    Verbatim(String),
}

/// Reason why a report was not made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// A figure that is not an SVG, or could load or run something.
    #[error(
        "report: figure {index} (counted from 1): expected an SVG that loads and runs nothing, met \
        {met}"
    )]
    ForeignFigure {
        /// Number of the figure, from 1.
        index: usize,
        /// Value found.
        met: String,
    },
}

impl Report {
    /// Returns the whole file.
    ///
    /// # Errors
    /// [`ReportError::ForeignFigure`] for a figure that is not an SVG or contains scripts or
    /// references.
    pub fn to_html(&self) -> Result<String, ReportError> {
        let mut html = String::new();
        let title = escape(&self.title);
        html.push_str("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
        html.push_str(
            "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
        <meta name=\"color-scheme\" content=\"light dark\">\n",
        );
        let style = match &self.scripted {
            Some(scripted) => {
                push(
                    &mut html,
                    format_args!(
                        "<meta http-equiv=\"Content-Security-Policy\" content=\"{}\">\n",
                        escape(&scripted.policy)
                    ),
                );
                scripted.style.as_str()
            }
            None => "",
        };
        push(
            &mut html,
            format_args!(
                "<title>{title}</title>\n<style>{STYLE}{style}</style>\n</head>\n<body>\n<main>\n\
                <h1>{title}</h1>\n"
            ),
        );
        self.push_verdicts(&mut html);
        self.push_contents(&mut html);
        if let Some(scripted) = &self.scripted {
            scripted.push(&mut html);
        }
        if !self.figures.is_empty() {
            html.push_str("<h2 id=\"figures\">Figures</h2>\n");
        }
        let mut figures = 0;
        for figure in &self.figures {
            figure.push(&mut html, &mut figures)?;
        }
        if !self.tables.is_empty() {
            html.push_str("<h2 id=\"tables\">Tables</h2>\n");
        }
        self.tables.iter().for_each(|t| t.push(&mut html));
        for (number, section) in self.filled().enumerate() {
            push(
                &mut html,
                format_args!(
                    "<h2 id=\"section-{number}\"{}>{}</h2>\n",
                    if section.new_page {
                        " class=\"new-page\""
                    } else {
                        ""
                    },
                    escape(&section.heading)
                ),
            );
            section
                .parts
                .iter()
                .try_for_each(|part| part.push(&mut html, &mut figures))?;
        }
        if !self.provenance.is_empty() {
            html.push_str("<h2 id=\"provenance\">Provenance</h2>\n");
            push_fields(&mut html, &self.provenance);
        }
        for (name, text) in &self.files {
            push(
                &mut html,
                format_args!(
                    "<details><summary>{}</summary><pre>{}</pre></details>\n",
                    escape(name),
                    escape(text)
                ),
            );
        }
        html.push_str("</main>\n</body>\n</html>\n");
        Ok(html)
    }

    /// Sections with something in them.
    fn filled(&self) -> impl Iterator<Item = &Section> {
        self.sections
            .iter()
            .filter(|section| !section.parts.is_empty())
    }

    /// Adds links to the headings, if there are enough of them to need a table of contents.
    fn push_contents(&self, html: &mut String) {
        let mut all: Vec<(String, &str)> = Vec::new();
        if let Some(scripted) = &self.scripted {
            all.push(("scripted-part".to_owned(), &scripted.heading));
        }
        let fixed = [
            ("figures", "Figures", self.figures.is_empty()),
            ("tables", "Tables", self.tables.is_empty()),
        ];
        all.extend(
            fixed
                .iter()
                .filter(|one| !one.2)
                .map(|one| (one.0.to_owned(), one.1)),
        );
        let sections = self.filled().enumerate();
        all.extend(
            sections.map(|(number, one)| (format!("section-{number}"), one.heading.as_str())),
        );
        if !self.provenance.is_empty() {
            all.push(("provenance".to_owned(), "Provenance"));
        }
        if all.len() < 3 {
            return;
        }
        html.push_str("<nav aria-label=\"Contents\"><ul>\n");
        for (id, heading) in all {
            push(
                html,
                format_args!("<li><a href=\"#{id}\">{}</a></li>\n", escape(heading)),
            );
        }
        html.push_str("</ul></nav>\n");
    }

    fn push_verdicts(&self, html: &mut String) {
        if self.verdicts.is_empty() {
            return;
        }
        html.push_str("<ul class=\"verdict\">\n");
        for verdict in &self.verdicts {
            // A word beside the colour: not every reader sees the colour.
            let (class, word) = match verdict.level {
                Level::Good => ("good", "Good"),
                Level::Note => ("note", "Note"),
                Level::Bad => ("bad", "Bad"),
            };
            push(
                html,
                format_args!(
                    "<li class=\"{class}\"><strong>{word}</strong> {}</li>\n",
                    escape(&verdict.text)
                ),
            );
        }
        html.push_str("</ul>\n");
    }
}

impl Scripted {
    fn push(&self, html: &mut String) {
        // Within a script element `<` would begin a tag, also in a string.
        let data = self.data.replace('<', "\\u003c");
        push(
            html,
            format_args!(
                "<h2 id=\"scripted-part\">{}</h2>\n<p>{}</p>\n<div id=\"scripted\"></div>\n\
                <script type=\"application/json\" id=\"scripted-data\">{data}</script>\n",
                escape(&self.heading),
                escape(&self.words)
            ),
        );
        for script in &self.scripts {
            push(html, format_args!("<script>{script}</script>\n"));
        }
    }
}

impl Part {
    fn push(&self, html: &mut String, figures: &mut usize) -> Result<(), ReportError> {
        match self {
            Self::Text(text) => push(html, format_args!("<p>{}</p>\n", escape(text))),
            Self::List(points) => {
                html.push_str("<ul>\n");
                points
                    .iter()
                    .for_each(|point| push(html, format_args!("<li>{}</li>\n", escape(point))));
                html.push_str("</ul>\n");
            }
            Self::Table(table) => table.push(html),
            Self::Figure(figure) => figure.push(html, figures)?,
            Self::Fields(name, fields) => {
                if !name.is_empty() {
                    push(html, format_args!("<h3>{}</h3>\n", escape(name)));
                }
                push_fields(html, fields);
            }
            Self::Verbatim(text) => push(
                html,
                format_args!("<pre>{}</pre>\n", escape(text.trim_end())),
            ),
        }
        Ok(())
    }
}

fn push_fields(html: &mut String, fields: &[(String, String)]) {
    html.push_str("<dl>\n");
    for (key, value) in fields {
        push(
            html,
            format_args!("<dt>{}</dt><dd>{}</dd>\n", escape(key), escape(value)),
        );
    }
    html.push_str("</dl>\n");
}

impl Figure {
    /// `before`: number of figures before it.
    fn push(&self, html: &mut String, before: &mut usize) -> Result<(), ReportError> {
        *before += 1;
        check_svg(&self.svg).map_err(|met| ReportError::ForeignFigure {
            index: *before,
            met,
        })?;
        push(
            html,
            format_args!(
                "<figure>\n{}\n<figcaption>{}</figcaption>\n</figure>\n",
                self.svg.trim(),
                escape(&self.caption)
            ),
        );
        Ok(())
    }
}

impl Table {
    fn push(&self, html: &mut String) {
        push(
            html,
            format_args!(
                "<div class=\"table\"><table>\n<caption>{}</caption>\n<thead><tr>",
                escape(&self.caption)
            ),
        );
        for name in &self.header {
            push(
                html,
                format_args!("<th scope=\"col\">{}</th>", escape(name)),
            );
        }
        html.push_str("</tr></thead>\n<tbody>\n");
        for row in &self.rows {
            html.push_str("<tr>");
            for cell in row.iter().map(String::as_str).chain(std::iter::repeat_n(
                "",
                self.header.len().saturating_sub(row.len()),
            )) {
                let class = if is_number(cell) {
                    " class=\"number\""
                } else {
                    ""
                };
                push(html, format_args!("<td{class}>{}</td>", escape(cell)));
            }
            html.push_str("</tr>\n");
        }
        html.push_str("</tbody></table></div>\n");
    }
}

fn push(html: &mut String, text: std::fmt::Arguments<'_>) {
    // Writing to a String cannot fail.
    let _ = html.write_fmt(text);
}

fn is_number(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '-' | '−' | '+' | '.'))
        && text.contains(|c: char| c.is_ascii_digit())
}

/// Returns the text as HTML wants it, in elements and in attributes.
fn escape(text: &str) -> String {
    text.chars()
        .fold(String::with_capacity(text.len()), |mut out, c| {
            match c {
                '&' => out.push_str("&amp;"),
                '<' => out.push_str("&lt;"),
                '>' => out.push_str("&gt;"),
                '"' => out.push_str("&quot;"),
                '\'' => out.push_str("&#39;"),
                _ => out.push(c),
            }
            out
        })
}

/// Checks a figure and returns the fault as the error. Checks tags only, because the text of a
/// label is free.
fn check_svg(svg: &str) -> Result<(), String> {
    let svg = svg.trim();
    if !(svg.starts_with("<svg ") && svg.ends_with("</svg>")) {
        return Err(format!("\"{}\"", svg.chars().take(40).collect::<String>()));
    }
    const ALLOWED: [&str; 9] = [
        "svg", "rect", "circle", "line", "polyline", "polygon", "text", "path", "g",
    ];
    for tag in svg.split('<').skip(1).filter_map(|t| t.split('>').next()) {
        let name: String = tag
            .trim_start_matches('/')
            .chars()
            .take_while(|c| c.is_ascii_alphanumeric())
            .collect();
        if !ALLOWED.contains(&name.as_str()) {
            return Err(format!("<{name}>"));
        }
        let attributes = outside_quotes(tag);
        let foreign = attributes
            .split_whitespace()
            .find(|a| a.starts_with("on") || a.contains("href") || a.starts_with("style"));
        if let Some(met) = foreign.or_else(|| tag.contains("url(").then_some("url(…)")) {
            return Err(format!("{met} in <{name}>"));
        }
    }
    Ok(())
}

/// Returns a tag without the values of its attributes.
fn outside_quotes(tag: &str) -> String {
    tag.split('"').step_by(2).collect::<Vec<_>>().join(" ")
}

const STYLE: &str = "
:root{color-scheme:light \
dark;--ink:#1d1f21;--soft:#5c6166;--page:#fff;--line:#d9dcdf;\
--stripe:#f5f6f7;--good:#00724f;--note:#8a5a00;--bad:#b3261e}
@media (prefers-color-scheme:dark){:root{--ink:#e7e9ea;--soft:#a3a9ae;--page:#16181a;\
--line:#3a3f43;--stripe:#1e2124;--good:#4cc79b;--note:#e0ab4a;--bad:#ff8a80}}
*{box-sizing:border-box}
body{margin:0;background:var(--page);color:var(--ink);font:16px/1.5 \
system-ui,-apple-system,\"Segoe UI\",Roboto,sans-serif}
main{max-width:62rem;margin:0 auto;padding:1.25rem 1rem 3rem}
h1{font-size:1.7rem;line-height:1.2;margin:.5rem 0 1rem;overflow-wrap:anywhere}
h2{font-size:1.2rem;margin:2rem 0 .5rem}
h2.new-page{font-size:1.4rem;margin-top:3rem;padding-top:1.5rem;border-top:2px solid var(--line)}
.verdict{list-style:none;margin:0 0 1.5rem;padding:0}
.verdict li{border-left:.3rem solid;padding:.35rem .75rem;margin:.4rem 0;background:var(--stripe)}
.verdict strong{margin-right:.4rem}
.verdict .good{border-color:var(--good)}.good strong{color:var(--good)}
.verdict .note{border-color:var(--note)}.note strong{color:var(--note)}
.verdict .bad{border-color:var(--bad)}.bad strong{color:var(--bad)}
figure{margin:1.5rem 0;overflow-x:auto}
figure svg{display:block;width:100%;min-width:34rem;height:auto;border:1px solid \
var(--line);border-radius:.4rem;background:#fff}
figcaption{color:var(--soft);font-size:.9rem;margin-top:.4rem}
.table{overflow-x:auto;margin:1.75rem 0}
table{border-collapse:collapse;min-width:100%;font-size:.92rem}
caption{text-align:left;font-weight:600;padding:.25rem 0 .5rem}
th,td{padding:.35rem .7rem;border-bottom:1px solid var(--line);text-align:left;white-space:nowrap}
th{color:var(--soft);font-weight:600}
tbody tr:nth-child(even){background:var(--stripe)}
.number{font-variant-numeric:tabular-nums}
dl{display:grid;grid-template-columns:minmax(7rem,max-content) 1fr;gap:.2rem 1rem;font-size:.9rem}
dt{color:var(--soft)}dd{margin:0;overflow-wrap:anywhere}
h3{font-size:1rem;margin:1.2rem 0 .3rem}
p,li{max-width:48rem}
pre{overflow-x:auto;background:var(--stripe);padding:.6rem \
.8rem;border-radius:.4rem;font-size:.82rem;line-height:1.4}
details{margin:.3rem 0;font-size:.9rem}summary{cursor:pointer;color:var(--soft)}
@media (prefers-color-scheme:dark){figure svg{filter:invert(.91) hue-rotate(180deg)}}
@media print{:root{--ink:#000;--soft:#444;--page:#fff;--line:#bbb;--stripe:#f5f6f7;\
--good:#00724f;--note:#8a5a00;--bad:#b3261e}
html{font-size:9pt}body{font-size:1rem}main{max-width:none;padding:0}figure,.table{margin:.8rem 0}figure \
svg{filter:none;min-width:0}.table,figure,pre{overflow:visible}pre{white-space:pre-wrap}
th,td{white-space:normal}figure,.table,.verdict \
li{break-inside:avoid}h2,h3,caption{break-after:avoid}
h2.new-page{break-before:page;border-top:0;margin-top:0;padding-top:0}@page{margin:1.6cm}}
";

#[cfg(test)]
mod tests {
    use super::*;

    const SVG: &str = "<svg width=\"1\" height=\"1\"><text x=\"1\">\nhref on url\n</text></svg>\n";

    fn report() -> Report {
        Report {
            title: "P45B <cell 3> & friends".into(),
            verdicts: vec![
                Verdict {
                    level: Level::Good,
                    text: "The shunt reads 9.96 mΩ.".into(),
                },
                Verdict {
                    level: Level::Bad,
                    text: "\"R4\" is not identified".into(),
                },
            ],
            figures: vec![Figure {
                svg: SVG.into(),
                caption: "Nyquist <plot>".into(),
            }],
            tables: vec![Table {
                caption: "Fits".into(),
                header: vec!["RC".into(), "R / mΩ".into(), "remark".into()],
                rows: vec![
                    vec![
                        "1".into(),
                        "−6.94".into(),
                        "<script>alert(1)</script>".into(),
                    ],
                    vec!["2".into()],
                ],
            }],
            sections: vec![Section {
                heading: "Where & what".into(),
                parts: vec![
                    Part::Text("1 < 2".into()),
                    Part::List(vec!["a & b".into()]),
                    Part::Figure(Figure {
                        svg: SVG.into(),
                        caption: "map".into(),
                    }),
                    Part::Fields("effect".into(), vec![("p".into(), "<0.01".into())]),
                    Part::Verbatim("x<y\n".into()),
                ],
                new_page: true,
            }],
            provenance: vec![("seed".into(), "7".into()), ("config".into(), "a'b".into())],
            files: vec![("a.toml".into(), "k = \"<v>\"".into())],
            scripted: None,
        }
    }

    #[test]
    fn headings_are_listed_and_led_to() {
        let html = report().to_html().unwrap();
        for id in ["figures", "tables", "section-0", "provenance"] {
            assert_eq!(html.matches(&format!("href=\"#{id}\"")).count(), 1, "{id}");
            assert_eq!(html.matches(&format!("<h2 id=\"{id}\"")).count(), 1, "{id}");
        }
        assert!(!Report::default().to_html().unwrap().contains("<nav"));
    }

    #[test]
    fn data_cannot_end_the_script_that_holds_it() {
        let scripted = Scripted {
            heading: "Spectra".into(),
            data: "{\"name\": \"</script><b>\"}".into(),
            scripts: vec!["draw()".into()],
            policy: "default-src 'none'".into(),
            ..Scripted::default()
        };
        let html = Report {
            scripted: Some(scripted),
            ..report()
        }
        .to_html()
        .unwrap();
        assert_eq!(html.matches("</script>").count(), 2, "data and one script");
        assert!(html.contains("\\u003c/script>"));
        assert!(html.contains("content=\"default-src &#39;none&#39;\""));
    }

    #[test]
    fn everything_is_there_and_escaped() {
        let html = report().to_html().unwrap();
        for expected in [
            "<title>P45B &lt;cell 3&gt; &amp; friends</title>",
            "<h1>P45B &lt;cell 3&gt; &amp; friends</h1>",
            "<li class=\"good\"><strong>Good</strong> The shunt reads 9.96 mΩ.</li>",
            "<li class=\"bad\"><strong>Bad</strong> &quot;R4&quot; is not identified</li>",
            "<figcaption>Nyquist &lt;plot&gt;</figcaption>",
            "<td class=\"number\">−6.94</td><td>&lt;script&gt;alert(1)&lt;/script&gt;</td>",
            "<tr><td class=\"number\">2</td><td></td><td></td></tr>",
            "<dt>config</dt><dd>a&#39;b</dd>",
            "<h2 id=\"section-0\" class=\"new-page\">Where &amp; what</h2>\n",
            "</h2>\n<p>1 &lt; 2</p>\n<ul>\n<li>a &amp; b</li>\n</ul>",
            "<h3>effect</h3>\n<dl>\n<dt>p</dt><dd>&lt;0.01</dd>\n</dl>",
            "<pre>x&lt;y</pre>",
            "<details><summary>a.toml</summary><pre>k = &quot;&lt;v&gt;&quot;</pre></details>",
            "width=device-width",
            "prefers-color-scheme:dark",
        ] {
            assert!(html.contains(expected), "missing {expected} in\n{html}");
        }
        assert!(html.contains(SVG.trim()));
    }

    #[test]
    fn nothing_is_loaded_and_nothing_runs() {
        let html = report().to_html().unwrap();
        for foreign in [
            "<script", "http:", "https:", "src=", "<link", "@import", "url(",
        ] {
            assert!(!html.contains(foreign), "{foreign}");
        }
    }

    #[test]
    fn elements_close() {
        let html = report().to_html().unwrap();
        for tag in [
            "html", "head", "body", "main", "ul", "li", "figure", "table", "tr", "td", "th", "dl",
            "div", "style",
        ] {
            let count = |s: String| html.matches(&s).count();
            let open = count(format!("<{tag}>")) + count(format!("<{tag} "));
            assert_eq!(open, count(format!("</{tag}>")), "<{tag}>");
        }
    }

    #[test]
    fn foreign_figures_are_refused() {
        let cases = [
            ("<p>no</p>", "\"<p>no</p>\""),
            ("<svg ><script>x</script></svg>", "<script>"),
            ("<svg ><image href=\"http://x\"/></svg>", "<image>"),
            (
                "<svg ><text xlink:href=\"http://x\">a</text></svg>",
                "xlink:href= in <text>",
            ),
            ("<svg onload=\"x()\"></svg>", "onload= in <svg>"),
            (
                "<svg ><rect fill=\"url(http://x)\"/></svg>",
                "url(…) in <rect>",
            ),
        ];
        for (svg, met) in cases {
            let bad = Report {
                figures: vec![Figure {
                    svg: svg.into(),
                    caption: String::new(),
                }],
                ..Report::default()
            };
            let expected = format!(
                "report: figure 1 (counted from 1): expected an SVG that loads and runs nothing, \
                met {met}"
            );
            assert_eq!(bad.to_html().unwrap_err().to_string(), expected, "{svg}");
        }
    }
}
