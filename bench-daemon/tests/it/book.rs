//! The documentation: where its links lead, how long its sentences are, and whether the commands
//! of its tutorials run.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use instruments::{chiller, generator, load, logger, scope, supply, supply4q};

/// The longest sentence, in words.
pub(super) const LONGEST: usize = 40;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .canonicalize()
        .unwrap()
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The pages in the folder `docs`, by name.
fn docs() -> Vec<PathBuf> {
    let mut pages: Vec<PathBuf> = fs::read_dir(root().join("docs"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
        .collect();
    pages.sort();
    pages
}

fn name(page: &Path) -> &str {
    page.file_name().unwrap().to_str().unwrap()
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Heading,
    Row,
    /// A paragraph, or an item of a list.
    Prose,
}

/// A piece of a page that is no code; inline code stands as one word.
#[derive(Debug)]
struct Block {
    line: usize,
    kind: Kind,
    text: String,
}

/// Text behind the marker of an item of a list.
fn item(line: &str) -> Option<&str> {
    let numberless = line.trim_start_matches(|c: char| c.is_ascii_digit());
    if numberless.len() < line.len() {
        numberless
            .strip_prefix(". ")
            .or_else(|| numberless.strip_prefix(") "))
    } else {
        ["* ", "- ", "+ "]
            .iter()
            .find_map(|marker| line.strip_prefix(marker))
    }
}

fn is_fence(line: &str) -> bool {
    line.starts_with("```") || line.starts_with("~~~")
}

/// The page without its code blocks, each paragraph and item in one piece.
fn blocks(text: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let (mut fenced, mut open) = (false, false);
    for (at, line) in text.lines().enumerate() {
        let line = line.trim();
        if is_fence(line) {
            fenced = !fenced;
            open = false;
            continue;
        }
        if fenced || line.is_empty() {
            open = false;
            continue;
        }
        let (kind, text, goes_on) = if line.starts_with('#') {
            (Kind::Heading, line.trim_start_matches('#').trim(), false)
        } else if line.starts_with('|') {
            (Kind::Row, line, false)
        } else if let Some(behind) = item(line) {
            (Kind::Prose, behind, false)
        } else {
            (Kind::Prose, line, open)
        };
        match blocks.last_mut() {
            Some(block) if goes_on => {
                block.text.push(' ');
                block.text.push_str(text);
            }
            _ => blocks.push(Block {
                line: at + 1,
                kind,
                text: text.to_owned(),
            }),
        }
        open = kind == Kind::Prose;
    }
    blocks
}

/// The text with every piece of inline code replaced by what `stands_for` makes of it.
fn with_code(text: &str, stands_for: impl Fn(&str) -> String) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(begin) = rest.find('`') {
        out.push_str(&rest[..begin]);
        let ticks = rest[begin..].len() - rest[begin..].trim_start_matches('`').len();
        let (fence, behind) = rest[begin..].split_at(ticks);
        match behind.find(fence) {
            Some(end) => {
                out.push_str(&stands_for(&behind[..end]));
                rest = &behind[end + ticks..];
            }
            None => {
                out.push_str(fence);
                rest = behind;
            }
        }
    }
    out.push_str(rest);
    out
}

fn code_as_a_word(text: &str) -> String {
    with_code(text, |_| "code".to_owned())
}

/// How long the target of a link is, its closing bracket included.
fn length_of_target(text: &str) -> usize {
    let mut depth = 1;
    for (at, c) in text.char_indices() {
        match c {
            '(' => depth += 1,
            ')' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return at + 1;
        }
    }
    text.len()
}

/// The targets of links and pictures.
fn links(text: &str) -> Vec<String> {
    let text = code_as_a_word(text);
    let mut found = Vec::new();
    let mut rest = text.as_str();
    while let Some(at) = rest.find("](") {
        let target = &rest[at + 2..];
        let length = length_of_target(target);
        let inner = target[..length]
            .strip_suffix(')')
            .unwrap_or(&target[..length]);
        found.extend(inner.split_whitespace().next().map(str::to_owned));
        rest = &target[length..];
    }
    found
}

/// The text with links replaced by what they are called.
fn without_targets(text: &str) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some(at) = rest.find("](") {
        out.push_str(&rest[..at]);
        let target = &rest[at + 2..];
        rest = &target[length_of_target(target)..];
    }
    out.push_str(rest);
    out.replace(['[', ']'], "")
}

/// The anchors of a page's headings, as GitHub and mdBook make them.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    blocks(text)
        .into_iter()
        .filter(|block| block.kind == Kind::Heading)
        .map(|heading| {
            let plain = without_targets(&with_code(&heading.text, str::to_owned));
            let slug: String = plain
                .to_lowercase()
                .chars()
                .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
                .map(|c| if c == ' ' { '-' } else { c })
                .collect();
            let times = seen.entry(slug.clone()).or_default();
            *times += 1;
            match *times {
                1 => slug,
                more => format!("{slug}-{}", more - 1),
            }
        })
        .collect()
}

/// The sentences of a paragraph or an item. A full stop, a question mark or an exclamation mark
/// ends one where a blank or nothing follows.
pub(super) fn sentences(text: &str) -> Vec<String> {
    let text = without_targets(&code_as_a_word(text));
    let mut sentences = vec![String::new()];
    for word in text.split_whitespace() {
        let sentence = sentences.last_mut().unwrap();
        sentence.push_str(word);
        sentence.push(' ');
        let bare = word.trim_end_matches([')', '*', '_', '"', '\'', '”', '’']);
        if bare.ends_with(['.', '?', '!']) {
            sentences.push(String::new());
        }
    }
    sentences.retain(|sentence| !sentence.is_empty());
    sentences
}

pub(super) fn words(sentence: &str) -> usize {
    sentence
        .split_whitespace()
        .filter(|word| word.chars().any(char::is_alphanumeric))
        .count()
}

/// The commands of a tutorial: its blocks of `sh`, one after the other.
fn commands(text: &str) -> String {
    let mut commands = String::new();
    let mut inside = false;
    for line in text.lines() {
        if is_fence(line) {
            inside = !inside && line == "```sh";
        } else if inside {
            commands.push_str(line);
            commands.push('\n');
        }
    }
    commands
}

/// Plays the commands of a tutorial in a folder that looks like the root of the repository.
fn play(tutorial: &str) {
    let text = read(&root().join("docs").join(tutorial));
    let commands = commands(&text);
    assert!(!commands.is_empty(), "{tutorial} has no commands");
    let folder = tempfile::tempdir().unwrap();
    for name in ["configs", "fixtures"] {
        symlink(root().join(name), folder.path().join(name)).unwrap();
    }
    let programs = folder.path().join("programs");
    fs::create_dir(&programs).unwrap();
    symlink(env!("CARGO_BIN_EXE_eis-bench"), programs.join("eis-bench")).unwrap();
    let path = std::env::join_paths(
        std::iter::once(programs).chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    )
    .unwrap();
    let output = Command::new("bash")
        .args(["-euo", "pipefail", "-c", &commands])
        .current_dir(folder.path())
        .env("PATH", path)
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{tutorial}: {}\nstandard output:\n{}\nstandard error:\n{}",
        output.status,
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn every_link_of_the_documentation_leads_to_a_file_and_a_heading() {
    let mut pages = docs();
    pages.extend(["README.md", "ARCHITECTURE.md"].map(|name| root().join(name)));
    let mut broken = Vec::new();
    let mut followed = 0;
    for page in &pages {
        for block in blocks(&read(page)) {
            for link in links(&block.text) {
                if link.contains("://") || link.starts_with("mailto:") {
                    continue;
                }
                followed += 1;
                let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
                let target = if file.is_empty() {
                    page.clone()
                } else {
                    page.parent().unwrap().join(file)
                };
                let found = target.exists()
                    && (anchor.is_empty() || anchors(&read(&target)).contains(anchor));
                if !found {
                    broken.push(format!("{}:{}: {link}", name(page), block.line));
                }
            }
        }
    }
    assert!(broken.is_empty(), "broken links:\n{}", broken.join("\n"));
    assert!(followed > 50, "only {followed} links were found");
}

#[test]
fn the_summary_of_the_book_lists_every_page_once() {
    let summary = read(&root().join("docs/SUMMARY.md"));
    let mut listed: Vec<String> = blocks(&summary)
        .iter()
        .flat_map(|block| links(&block.text))
        .collect();
    listed.sort();
    let pages: Vec<String> = docs()
        .iter()
        .map(|page| name(page).to_owned())
        .filter(|page| page != "SUMMARY.md")
        .collect();
    assert_eq!(listed, pages);
}

#[test]
fn no_sentence_of_the_first_pages_is_longer_than_forty_words() {
    let mut pages = ["README.md", "ARCHITECTURE.md"]
        .map(|name| root().join(name))
        .to_vec();
    pages.extend(
        docs()
            .into_iter()
            .filter(|page| name(page).starts_with("tutorial-")),
    );
    let mut long = Vec::new();
    for page in &pages {
        for block in blocks(&read(page)) {
            if block.kind != Kind::Prose {
                continue;
            }
            for sentence in sentences(&block.text) {
                let words = words(&sentence);
                if words > LONGEST {
                    let (page, line) = (name(page), block.line);
                    long.push(format!("{page}:{line}: {words} words: {sentence}"));
                }
            }
        }
    }
    assert!(long.is_empty(), "long sentences:\n{}", long.join("\n"));
}

#[test]
fn pages_are_read_as_github_and_mdbook_read_them() {
    let page = "# One `two`: [three](four.md)\n\nA b. C `d e. f` (g.)\nh\n* i [j](k (l).md#m)\n  n\n\
                1. o?\n\n```sh\n[p](q)\n```\n| r. | [s](t) |\n# One two three\n";
    let read: Vec<(usize, Kind)> = blocks(page)
        .iter()
        .map(|block| (block.line, block.kind))
        .collect();
    let expected = [
        (1, Kind::Heading),
        (3, Kind::Prose),
        (5, Kind::Prose),
        (7, Kind::Prose),
        (12, Kind::Row),
        (13, Kind::Heading),
    ];
    assert_eq!(read, expected);
    let blocks = blocks(page);
    assert_eq!(
        sentences(&blocks[1].text),
        ["A b. ", "C code (g.) ", "h "],
        "a full stop within inline code ends no sentence"
    );
    assert_eq!(sentences(&blocks[2].text), ["i j n "]);
    assert_eq!(links(&blocks[0].text), ["four.md"]);
    assert_eq!(links(&blocks[4].text), ["t"]);
    let expected = ["one-two-three", "one-two-three-1"].map(str::to_owned);
    assert_eq!(anchors(page), BTreeSet::from(expected));
    assert_eq!(commands(page), "[p](q)\n");
}

#[test]
#[ignore = "long drill"]
fn the_commands_of_the_tutorial_from_a_bench_to_a_model_run_in_a_bare_clone() {
    play("tutorial-bench.md");
}

#[test]
#[ignore = "drill"]
fn the_commands_of_the_tutorial_from_a_spectrum_to_a_pack_run_in_a_bare_clone() {
    play("tutorial-spectrum.md");
}

/// Pages whose commands need nothing but the repository, and take a minute together.
const PLAYED: [&str; 8] = [
    "dataset.md",
    "fit.md",
    "formats.md",
    "pack-and-sop.md",
    "replay.md",
    "simulate.md",
    "tables.md",
    "diagnosis.md",
];

#[test]
#[ignore = "drill"]
fn the_commands_of_the_pages_run_in_a_bare_clone() {
    for page in PLAYED {
        play(page);
    }
}

#[test]
fn every_model_stands_on_the_pages_that_tell_of_it() {
    macro_rules! keys {
        ($($role:ident),+) => {
            [$($role::DIALECTS.iter().map(|dialect| dialect.key()).collect::<Vec<_>>()),+].concat()
        };
    }
    let page = |name: &str| read(&root().join("docs").join(name));
    let row = |text: &str, key: &str| {
        text.lines()
            .any(|line| line.starts_with('|') && line.contains(key))
    };
    let (known, safety) = (page("bring-up.md"), page("safety.md"));
    let drivers = keys!(supply4q, generator, load, supply, chiller);
    for key in [drivers.clone(), keys!(scope, logger)].concat() {
        assert!(
            row(&known, &format!("`{key}`")),
            "docs/bring-up.md: expected `{key}` in the table of models that are known"
        );
    }
    for key in drivers {
        assert!(
            row(&safety, key),
            "docs/safety.md: expected {key} in the table of what ends without a message"
        );
    }
}
