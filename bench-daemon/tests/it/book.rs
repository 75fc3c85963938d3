//! The documentation: the targets of its links, the length of its sentences, whether its commands
//! run, and the owners of the addresses in its examples.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    net::{Ipv4Addr, TcpListener},
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

/// Returns the pages in the folder `docs`, by name.
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

/// A piece of a page without code; inline code counts as one word.
#[derive(Debug)]
struct Block {
    line: usize,
    kind: Kind,
    text: String,
}

/// Returns the text after the marker of a list item.
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

/// Returns the page without its code blocks, each paragraph and item in one piece.
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

/// Replaces every piece of inline code in a text by the result of `stands_for`.
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

/// Returns the length of a link target including its closing bracket.
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

/// Returns the targets of links and pictures.
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

/// Replaces links in a text by their labels.
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

/// Returns the anchors of a page's headings, as GitHub and mdBook create them.
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

/// Returns the sentences of a paragraph or an item. A full stop, a question mark or an exclamation
/// mark ends a sentence if a blank or nothing follows.
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

/// A fenced block: its language, and its lines.
struct Fence<'a> {
    language: &'a str,
    lines: Vec<&'a str>,
}

fn fences(text: &str) -> Vec<Fence<'_>> {
    let mut fences = Vec::new();
    let mut inside = false;
    for line in text.lines() {
        if is_fence(line.trim()) {
            inside = !inside;
            if inside {
                let language = line.trim().trim_start_matches(['`', '~']);
                let lines = Vec::new();
                fences.push(Fence { language, lines });
            }
        } else if let Some(fence) = fences.last_mut().filter(|_| inside) {
            fence.lines.push(line);
        }
    }
    fences
}

/// Returns the commands of a page: its blocks of `sh`, one after the other.
fn commands(text: &str) -> String {
    let mut commands = String::new();
    for fence in fences(text) {
        if fence.language == "sh" {
            commands.push_str(&fence.lines.join("\n"));
            commands.push('\n');
        }
    }
    commands
}

/// Returns the path of a page: in the folder `docs`, except for the README.
fn page(name: &str) -> PathBuf {
    let folder = if name == "README.md" { "." } else { "docs" };
    root().join(folder).join(name)
}

/// Returns the README and the pages in `docs`, by name.
fn pages() -> Vec<String> {
    let docs = docs();
    let names = docs.iter().map(|page| name(page).to_owned());
    std::iter::once("README.md".to_owned())
        .chain(names)
        .collect()
}

/// Bash functions with which the commands of a page are run. A command that serves runs in
/// parallel with the next ones, once it has printed its address, and is ended after the last one.
const PRELUDE: &str = r#"
served=()
until_ctrl_c() {
    local printed="served${#served[@]}.txt"
    : > "$printed"
    "$@" > "$printed" 2>&1 &
    served+=($!)
    until grep -q 127.0.0.1 "$printed"; do
        kill -0 $! || { cat "$printed"; return 1; }
        sleep 0.1
    done
}
trap 'for one in "${served[@]}"; do kill "$one" && wait "$one" || true; done' EXIT
command -v curl > /dev/null || curl() { echo "curl is missing, not played: $*"; }
"#;

/// The port of the server in the examples.
const PORT: &str = "7420";

/// Returns the bash script for the commands of a page. A command runs in parallel with the others
/// if its comment begins with `until Ctrl-C`.
fn script(commands: &str) -> String {
    let mut script = PRELUDE.to_owned();
    for line in commands.lines() {
        if line.contains("# until Ctrl-C") {
            script.push_str("until_ctrl_c ");
        }
        script.push_str(&as_installed(line));
        script.push('\n');
    }
    script
}

/// Replaces `cargo run --` in the command by `eis-bench`, as in the README.
fn as_installed(command: &str) -> String {
    command.replace("cargo run -- ", "eis-bench ")
}

fn free_port() -> String {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    listener.local_addr().unwrap().port().to_string()
}

/// Makes a folder resemble the root of the repository. `configs` is a copy, because the server
/// writes beside it. The port is a free one, because a server may already run on this machine.
fn bare_clone(folder: &Path, port: &str) {
    symlink(root().join("fixtures"), folder.join("fixtures")).unwrap();
    let copied = Command::new("cp")
        .arg("-R")
        .args([root().join("configs"), folder.join("configs")])
        .status()
        .unwrap();
    assert!(copied.success());
    let server = folder.join("configs/serve.toml");
    fs::write(&server, read(&server).replace(PORT, port)).unwrap();
}

/// Runs the commands of a page in a folder that resembles the root of the repository.
fn play(name: &str) {
    let commands = commands(&read(&page(name)));
    assert!(!commands.is_empty(), "{name} has no commands");
    let (folder, port) = (tempfile::tempdir().unwrap(), free_port());
    bare_clone(folder.path(), &port);
    let programs = folder.path().join("programs");
    fs::create_dir(&programs).unwrap();
    symlink(env!("CARGO_BIN_EXE_eis-bench"), programs.join("eis-bench")).unwrap();
    let path = std::env::join_paths(
        std::iter::once(programs).chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    )
    .unwrap();
    let output = Command::new("bash")
        .args(["-euo", "pipefail", "-c"])
        .arg(script(&commands).replace(PORT, &port))
        .current_dir(folder.path())
        .env("PATH", path)
        .env("HOME", folder.path())
        .stdin(Stdio::null())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{name}: {}\nstandard output:\n{}\nstandard error:\n{}",
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

/// Pages with a separate test, because each takes half a minute or more.
const ALONE: [&str; 5] = [
    "README.md",
    "diagnosis.md",
    "transports.md",
    "tutorial-bench.md",
    "tutorial-spectrum.md",
];

#[test]
#[ignore = "drill"]
fn the_commands_of_the_readme_run_in_a_bare_clone() {
    play("README.md");
}

#[test]
#[ignore = "drill"]
fn the_commands_of_the_page_on_diagnosis_run_in_a_bare_clone() {
    play("diagnosis.md");
}

#[test]
#[ignore = "long drill"]
fn the_commands_of_the_page_on_transports_run_in_a_bare_clone() {
    play("transports.md");
}

#[test]
#[ignore = "drill"]
fn the_commands_of_the_tutorial_from_a_bench_to_a_model_run_in_a_bare_clone() {
    play("tutorial-bench.md");
}

#[test]
#[ignore = "drill"]
fn the_commands_of_the_tutorial_from_a_spectrum_to_a_pack_run_in_a_bare_clone() {
    play("tutorial-spectrum.md");
}

#[test]
#[ignore = "drill"]
fn the_commands_of_all_other_pages_run_in_a_bare_clone() {
    for name in pages() {
        let has_commands = !commands(&read(&page(&name))).is_empty();
        if has_commands && !ALONE.contains(&name.as_str()) {
            play(&name);
        }
    }
}

/// Blocks that are not run, by page and first command, and the reason.
struct NotPlayed {
    reason: &'static str,
    blocks: &'static [&'static str],
}

const NOT_PLAYED: [NotPlayed; 10] = [
    NotPlayed {
        reason: "it needs measured data that are not part of the project",
        blocks: &[
            "map.md: eis-bench map 25C/cycle_1.parquet 10C/cycle_1.parquet m10C/cycle_1.parquet \\",
            "thesis.md: D=../shared/data",
        ],
    },
    NotPlayed {
        reason: "it needs `eis-archive`, whose own tests play it",
        blocks: &["archive.md: cargo install --path bench-daemon/archive --locked"],
    },
    NotPlayed {
        reason: "it needs the Python package, whose own tests play it",
        blocks: &["jobs.md: python -m eisbench.jobs fit store --rc 4 --out fits"],
    },
    NotPlayed {
        reason: "it needs a file of several benches, which the test of campaigns writes",
        blocks: &[
            "campaign.md: eis-bench campaign plan batch.toml --out experiments",
            "campaign.md: eis-bench campaign report north.sqlite batch-7 --and south.sqlite \
             --and west.sqlite --out report",
            "campaign.md: eis-fleet --config fleet.toml campaign batch.toml",
        ],
    },
    NotPlayed {
        reason: "it builds or installs what the tests have built",
        blocks: &[
            "install.md: cargo install --path bench-daemon --locked",
            "install.md: packaging/build --target x86_64-unknown-linux-musl \
             --target aarch64-unknown-linux-musl",
            "install.md: podman load -i eis-bench-0.2.0-amd64.oci.tar",
            "install.md: sha256sum --check --ignore-missing SHA256SUMS",
            "install.md: sudo -u eis-bench eis-bench token add /etc/eis-bench/serve.toml lab-pc \
             --scope read,operate",
            "install.md: sudo apt install ./eis-bench_0.2.0_amd64.deb",
            "install.md: sudo apt remove eis-bench",
            "install.md: tar -xzf eis-bench-0.2.0-amd64.tar.gz",
            "python.md: pip install ./python",
            "tutorial-bench.md: cargo build",
            "tutorial-spectrum.md: cargo build",
        ],
    },
    NotPlayed {
        reason: "it plays the tests, this one among them",
        blocks: &[
            "README.md: cargo test",
            "README.md: cargo test -- --ignored",
            "drivers.md: cargo test -p instruments -p instruments-drivers -p instruments-mock -p fixtures",
            "extend.md: EIS_BENCH_WRITE_REFERENCE=1 cargo test -p bench-daemon --test it reference",
            "extend.md: cargo test -p analysis-effects -p fixtures -p study -p bench-daemon \
             -- effects hidden names reference",
            "extend.md: cargo test -p analysis-files -p bench-daemon --lib formats",
            "transports.md: EIS_BENCH_FUZZ=10000000 cargo test -p instruments --test it fuzz -- --nocapture",
        ],
    },
    NotPlayed {
        reason: "it measures for minutes to hours",
        blocks: &[
            "attacks.md: cargo bench --profile dev -p bench-daemon --bench attacks -- --out attacks.md",
            "coverage.md: cargo bench --profile dev -p bench-daemon --bench coverage -- demo --drawn \
             --seeds 100 --from 1 --out FOLDER",
            "coverage.md: EIS_BENCH_SEEDS=100 cargo test -p bench-daemon --test it \
             the_uncertainty_of_a_point -- --ignored --nocapture",
            "speed.md: python3 -m venv benches/peers/.venv \
             && benches/peers/.venv/bin/pip install -r benches/peers/requirements.txt",
            "thresholds.md: fixtures/study/sensitivity/sensitivity.py --seed 987123 --out table.md \\",
            "thresholds.md: fixtures/study/sensitivity/sensitivity.py --seed 987123 --out table.md \\",
            "thresholds.md: fixtures/study/sensitivity/sensitivity.py --seed 987123 --out table.md \\",
        ],
    },
    NotPlayed {
        reason: "it needs a NATS server, which bench-daemon/fleet/tests starts where there is one",
        blocks: &[
            "fleet.md: eis-fleet --config fleet.toml status",
            "fleet.md: nats-server -js -sd /var/lib/nats -a 127.0.0.1",
            "fleet.md: umask 077",
        ],
    },
    NotPlayed {
        reason: "it needs instruments; the simulated ones are asked on the same page",
        blocks: &[
            "bring-up.md: eis-bench identify configs/benches/thesis.toml",
            "bring-up.md: eis-bench doctor configs/benches/thesis.toml",
        ],
    },
    NotPlayed {
        reason: "it needs a bench outside its process; transports.md does it to served instruments",
        blocks: &[
            "safety.md: eis-bench clear configs/benches/mine.toml",
            "safety.md: eis-bench safe configs/benches/mine.toml",
        ],
    },
];

#[test]
fn a_block_of_commands_is_played_or_has_a_reason() {
    let mut unplayed = Vec::new();
    for name in pages() {
        for fence in fences(&read(&page(&name))) {
            let first = fence.lines.first().copied().unwrap_or_default();
            let (command, prompt) = match first.strip_prefix("$ ") {
                Some(command) => (command, true),
                None => (first, false),
            };
            match fence.language {
                "console" => {
                    assert!(prompt, "{name}: expected `$ ` before {first:?}");
                    let command = command.split("  #").next().unwrap().trim_end();
                    unplayed.push(format!("{name}: {command}"));
                }
                "sh" => assert!(!prompt, "{name}: expected no `$ ` before {command:?}"),
                "text" | "toml" | "python" | "nginx" => assert!(
                    !fence.lines.iter().any(|line| line.starts_with("$ ")),
                    "{name}: expected `sh` or `console` for {first:?}, found {:?}",
                    fence.language
                ),
                other => panic!("{name}: expected a language that is known, found {other:?}"),
            }
        }
    }
    assert!(NOT_PLAYED.iter().all(|group| !group.reason.is_empty()));
    let mut known = NOT_PLAYED
        .iter()
        .flat_map(|group| group.blocks)
        .collect::<Vec<_>>();
    known.sort();
    unplayed.sort();
    assert_eq!(unplayed.iter().collect::<Vec<_>>(), known);
}

#[test]
fn a_command_in_a_sentence_that_names_a_file_of_the_repository_is_played() {
    let played: String = pages()
        .iter()
        .map(|name| as_installed(&commands(&read(&page(name)))))
        .collect();
    for name in pages() {
        for block in blocks(&read(&page(&name))) {
            for code in block.text.split('`').skip(1).step_by(2).map(as_installed) {
                let names_a_file = code.split(' ').skip(1).any(|word| {
                    word.contains('/') && !word.starts_with('/') && root().join(word).exists()
                });
                assert!(
                    !(code.starts_with("eis-bench ") && names_a_file)
                        || played.lines().any(|line| line.starts_with(&code)),
                    "{name}:{}: expected `{code}` in a block of `sh` of a page",
                    block.line
                );
            }
        }
    }
}

/// Returns the files below a folder, or the file itself.
fn files_below(path: &Path) -> Vec<PathBuf> {
    if !path.is_dir() {
        return vec![path.to_owned()];
    }
    fs::read_dir(path)
        .unwrap()
        .flat_map(|entry| files_below(&entry.unwrap().path()))
        .collect()
}

/// Checks whether the address is this machine, or one reserved for documentation (RFC 5737).
fn is_reserved(address: Ipv4Addr) -> bool {
    address.is_loopback() || address.is_unspecified() || address.is_documentation()
}

/// Returns addresses and host names in a text that may belong to others.
fn addresses_of_others(text: &str) -> Vec<&str> {
    let numbers = text
        .split(|c: char| !c.is_ascii_digit() && c != '.')
        .map(|number| number.trim_matches('.'))
        .filter(|number| {
            number
                .parse::<Ipv4Addr>()
                .is_ok_and(|address| !is_reserved(address))
        });
    let names = ["tcp://", "tcp:", "vxi11:", "hislip:"]
        .into_iter()
        .flat_map(|scheme| text.split(scheme).skip(1))
        .filter_map(|behind| {
            behind
                .split(|c: char| !c.is_ascii_alphanumeric() && !".-".contains(c))
                .next()
        })
        .filter(|host| host.contains('.') && !host.ends_with(".example"))
        .filter(|host| host.trim_matches('.').parse::<Ipv4Addr>().is_err());
    numbers.chain(names).collect()
}

#[test]
fn no_example_names_the_address_of_somebody() {
    let places = [
        "README.md",
        "ARCHITECTURE.md",
        "CHANGELOG.md",
        "docs",
        "configs",
        "packaging",
        "bench-daemon/serve/src/page",
        "bench-daemon/tests",
        "python/README.md",
        "python/lib",
        "python/notebooks",
        "tests",
    ];
    let mut found = Vec::new();
    for file in places
        .iter()
        .flat_map(|place| files_below(&root().join(place)))
    {
        let Ok(text) = fs::read_to_string(&file) else {
            continue;
        };
        for address in addresses_of_others(&text) {
            found.push(format!("{}: {address}", file.display()));
        }
    }
    assert!(
        found.is_empty(),
        "expected addresses such as 192.0.2.20 and names such as scope.lab.example, found\n{}",
        found.join("\n")
    );
    // Written without points, because this file is among those that are checked.
    let pointed = |text: &str| text.replace('_', ".");
    let text = pointed("at 8_8_8_8_ and tcp://scope_lab:5025, not tcp://a_example:1");
    let expected = ["8_8_8_8", "scope_lab"].map(pointed);
    assert_eq!(addresses_of_others(&text), expected);
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
