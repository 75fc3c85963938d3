//! A configuration file with its text, so that every complaint names file, line and field.

use std::{
    collections::BTreeMap,
    io::Read,
    ops::Range,
    path::{Component, Path, PathBuf},
    sync::Arc,
};

use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use super::schema::Kind;
use crate::support::confined_path;

/// A complaint about a configuration file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{path}: cannot be read: {reason}", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Message of the operating system.
        reason: String,
    },
    /// A field is not as expected.
    #[error("{path}:{line}: {field}: {reason}", path = path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The field, from the top, such as `eis.amplitude`; items of a list by their number, from
        /// 1: `runs.2.file`.
        field: String,
        /// Expected and found value.
        reason: String,
    },
    /// A file of another kind.
    #[error("{path}: expected {expected}, found {found}{hint}", path = path.display())]
    Kind {
        /// The file.
        path: PathBuf,
        /// Expected kind, with its article.
        expected: &'static str,
        /// Kind that was found, with its article.
        found: &'static str,
        /// What to do, after a semicolon; empty if nothing is known.
        hint: &'static str,
    },
}

/// A file and its text.
#[derive(Debug, Clone)]
pub struct Source {
    path: PathBuf,
    text: String,
    others: Others,
}

/// Bytes of the text that hold a field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldPlace {
    /// Those of its key.
    pub key: Range<usize>,
    /// Those of its value.
    pub value: Range<usize>,
}

/// Source of the files that a file names.
#[derive(Debug, Clone)]
enum Others {
    /// From the disk.
    Disk,
    /// Texts by path are read instead of files.
    Copies(Arc<Copies>),
    /// From the disk, within a fence.
    Fenced(Arc<Fence>),
}

/// Limits on what a file from another person may name.
#[derive(Debug)]
pub struct Fence {
    /// Everything below this folder …
    pub below: PathBuf,
    /// … and these files.
    pub also: Vec<PathBuf>,
    /// Texts that are read instead of files below the folder, by their path relative to it.
    pub instead: Copies,
}

impl Fence {
    /// Returns a path below the folder, relative to it; its dots are not resolved.
    pub fn relative(&self, path: &Path) -> Option<PathBuf> {
        let (path, below) = (plain(path)?, plain(&self.below)?);
        path.strip_prefix(below).ok().map(Path::to_owned)
    }

    fn read(&self, path: &Path) -> Result<String, ConfigError> {
        let unreadable = |reason: String| ConfigError::Unreadable {
            path: path.to_owned(),
            reason,
        };
        if self.also.iter().any(|known| known == path) {
            return std::fs::read_to_string(path).map_err(|error| unreadable(error.to_string()));
        }
        let name = self.relative(path);
        if let Some(text) = name.as_ref().and_then(|name| self.instead.get(name)) {
            return Ok(text.clone());
        }
        let name = name.and_then(|name| name.to_str().map(str::to_owned));
        let file = name.and_then(|name| confined_path::open(&self.below, &name));
        let file = file.ok_or_else(|| {
            unreadable("the file does not exist in the folder of the configuration".to_owned())
        })?;
        let mut text = String::new();
        match file.take(LONGEST).read_to_string(&mut text) {
            Ok(read) if (read as u64) < LONGEST => Ok(text),
            Ok(_) => Err(unreadable(format!("expected fewer than {LONGEST} bytes"))),
            Err(error) => Err(unreadable(error.to_string())),
        }
    }
}

/// Longest file behind a fence, bytes.
const LONGEST: u64 = 64 * 1024 * 1024;

/// A path without `.` and `..`; nothing for one that leaves its root.
fn plain(path: &Path) -> Option<PathBuf> {
    let mut plain = PathBuf::new();
    for part in std::path::absolute(path).ok()?.components() {
        match part {
            Component::ParentDir => {
                if !plain.pop() {
                    return None;
                }
            }
            Component::CurDir => {}
            other => plain.push(other),
        }
    }
    Some(plain)
}

/// Files as they were, by path.
pub type Copies = BTreeMap<PathBuf, String>;

impl Source {
    /// Reads a file.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`].
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Unreadable {
            path: path.to_owned(),
            reason: error.to_string(),
        })?;
        Ok(Self {
            path: path.to_owned(),
            text,
            others: Others::Disk,
        })
    }

    /// Opens a file from copies. Files that it names are read from the copies, too.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`] for a path that is not among them.
    pub fn copy(path: &Path, copies: &Arc<Copies>) -> Result<Self, ConfigError> {
        let reason = || "it is not among the copies of the run folder".to_owned();
        let text = copies.get(path).ok_or_else(|| ConfigError::Unreadable {
            path: path.to_owned(),
            reason: reason(),
        })?;
        Ok(Self {
            path: path.to_owned(),
            text: text.clone(),
            others: Others::Copies(copies.clone()),
        })
    }

    /// Treats a text as a file at `path` by an author with restricted read access: files that it
    /// names are read within the fence only.
    pub fn fenced(path: &Path, text: String, fence: &Arc<Fence>) -> Self {
        Self {
            path: path.to_owned(),
            text,
            others: Others::Fenced(fence.clone()),
        }
    }

    /// Returns another text in the place of this file, which opens other files as this one does.
    pub fn with_text(&self, path: &Path, text: String) -> Self {
        Self {
            path: path.to_owned(),
            text,
            others: self.others.clone(),
        }
    }

    /// Returns where the value of a field stands in the text, with its key; `None` if the file does
    /// not have it.
    pub fn place_of(&self, field: &str) -> Option<FieldPlace> {
        let document = DeTable::parse(&self.text).ok()?;
        let mut table = document.get_ref();
        let (outer, last) = field.rsplit_once('.').unwrap_or(("", field));
        for name in outer.split('.').filter(|name| !name.is_empty()) {
            let (_, value) = table
                .iter()
                .find(|(key, _)| key.get_ref().as_ref() == name)?;
            let DeValue::Table(inner) = value.get_ref() else {
                return None;
            };
            table = inner;
        }
        let (key, value) = table
            .iter()
            .find(|(key, _)| key.get_ref().as_ref() == last)?;
        Some(FieldPlace {
            key: key.span(),
            value: value.span(),
        })
    }

    /// Opens another file from the same origin as this one: from the disk, or from copies.
    ///
    /// # Errors
    /// [`ConfigError::Unreadable`].
    pub fn open(&self, path: &Path) -> Result<Self, ConfigError> {
        match &self.others {
            Others::Disk => Self::read(path),
            Others::Copies(copies) => Self::copy(path, copies),
            Others::Fenced(fence) => Ok(Self::fenced(path, fence.read(path)?, fence)),
        }
    }

    /// The file's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file's text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// A path written in this file, relative to it.
    pub fn relative(&self, path: &str) -> PathBuf {
        self.path.parent().unwrap_or(Path::new(".")).join(path)
    }

    /// Reads the text as the given structure.
    ///
    /// # Errors
    /// [`ConfigError::Field`] with the line and the field of the first mistake.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        toml::from_str(&self.text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            ConfigError::Field {
                path: self.path.clone(),
                line: self.line(at),
                field: self.field_at(at),
                reason: error.message().replace('\n', " "),
            }
        })
    }

    /// Reads the text as [`parse`](Self::parse) does. If this fails because the file is of another
    /// kind, the error names both kinds instead of a field.
    ///
    /// # Errors
    /// [`ConfigError::Kind`] for a file of another kind; otherwise those of `parse`.
    pub fn parse_as<T: DeserializeOwned>(&self, kind: Kind) -> Result<T, ConfigError> {
        self.parse().map_err(|error| {
            let found = match Kind::of(&self.text) {
                Some(found) if found != kind => found.phrase(),
                None if kind == Kind::Dataset && !self.is_toml() => "another file",
                _ => return error,
            };
            ConfigError::Kind {
                path: self.path.clone(),
                expected: kind.phrase(),
                found,
                hint: kind.hint(found),
            }
        })
    }

    /// Checks whether the file is TOML, by its name or its text.
    fn is_toml(&self) -> bool {
        self.path.extension().is_some_and(|end| end == "toml")
            || self.text.parse::<toml::Table>().is_ok()
    }

    /// A complaint about a field that could be read but must not be so. Points at the nearest
    /// ancestor that exists.
    pub fn complain(&self, field: &str, reason: impl Into<String>) -> ConfigError {
        let at = self.span_of(field).map_or(0, |span| span.start);
        ConfigError::Field {
            path: self.path.clone(),
            line: self.line(at),
            field: field.to_owned(),
            reason: reason.into(),
        }
    }

    fn line(&self, at: usize) -> usize {
        self.text
            .bytes()
            .take(at)
            .filter(|&byte| byte == b'\n')
            .count()
            + 1
    }

    fn span_of(&self, field: &str) -> Option<Range<usize>> {
        let document = DeTable::parse(&self.text).ok()?;
        let mut table = document.get_ref();
        let mut found = None;
        let mut names = field.split('.');
        while let Some(name) = names.next() {
            let Some((key, value)) = table.iter().find(|(key, _)| key.get_ref().as_ref() == name)
            else {
                break;
            };
            found = Some(key.span());
            match value.get_ref() {
                DeValue::Table(inner) => table = inner,
                DeValue::Array(all) => {
                    let number = names.next().and_then(|number| number.parse::<usize>().ok());
                    let Some(item) = number.and_then(|number| all.get(number.checked_sub(1)?))
                    else {
                        break;
                    };
                    found = Some(item.span());
                    let DeValue::Table(inner) = item.get_ref() else {
                        break;
                    };
                    table = inner;
                }
                _ => break,
            }
        }
        found
    }

    /// The innermost key that an error position belongs to.
    fn field_at(&self, at: usize) -> String {
        let Ok(document) = DeTable::parse(&self.text) else {
            return "(syntax)".to_owned();
        };
        let mut path = Vec::new();
        descend(document.get_ref(), at, &mut path);
        if path.is_empty() {
            "(whole file)".to_owned()
        } else {
            path.join(".")
        }
    }
}

fn descend(table: &DeTable<'_>, at: usize, path: &mut Vec<String>) {
    let inside = |span: Range<usize>| span.contains(&at);
    for (key, value) in table.iter() {
        if inside(key.span()) || holds(value.get_ref(), value.span(), at) {
            path.push(key.get_ref().to_string());
            match value.get_ref() {
                DeValue::Table(inner) => descend(inner, at, path),
                DeValue::Array(all) => {
                    let Some(index) = all
                        .iter()
                        .position(|item| holds(item.get_ref(), item.span(), at))
                    else {
                        return;
                    };
                    path.push((index + 1).to_string());
                    if let DeValue::Table(inner) = all[index].get_ref() {
                        descend(inner, at, path);
                    }
                }
                _ => {}
            }
            return;
        }
    }
}

/// Returns whether a value, or the text below its header, is at the position.
fn holds(value: &DeValue<'_>, span: Range<usize>, at: usize) -> bool {
    let inner = match value {
        DeValue::Table(inner) => inner.iter().any(|(key, value)| {
            key.span().contains(&at) || holds(value.get_ref(), value.span(), at)
        }),
        DeValue::Array(all) => all
            .iter()
            .any(|item| holds(item.get_ref(), item.span(), at)),
        _ => false,
    };
    inner || span.contains(&at)
}

/// A complaint about a file, as one about the field that names it.
pub(super) fn in_field(source: &Source, field: &str, error: &ConfigError) -> ConfigError {
    source.complain(field, error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct File {
        #[expect(dead_code, reason = "only read by serde")]
        eis: Eis,
        #[expect(dead_code, reason = "only read by serde")]
        #[serde(default)]
        traces: Vec<Eis>,
    }
    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct List {
        #[expect(dead_code, reason = "only read by serde")]
        runs: Vec<Eis>,
    }
    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Eis {
        #[expect(dead_code, reason = "only read by serde")]
        points: u32,
    }

    fn source(text: &str) -> Source {
        Source {
            path: PathBuf::from("a.toml"),
            text: text.to_owned(),
            others: Others::Disk,
        }
    }

    #[test]
    fn a_copy_reads_what_it_names_from_the_copies_and_nothing_else() {
        let copies = Arc::new(Copies::from([
            ("a/x.toml".into(), "x".to_owned()),
            ("a/../b/y.toml".into(), "y".to_owned()),
        ]));
        let x = Source::copy(Path::new("a/x.toml"), &copies).unwrap();
        assert_eq!(x.open(&x.relative("../b/y.toml")).unwrap().text(), "y");
        let message = x.open(&x.relative("z.toml")).unwrap_err().to_string();
        assert_eq!(
            message,
            "a/z.toml: cannot be read: it is not among the copies of the run folder"
        );
    }

    #[test]
    fn mistakes_in_lists_are_located_by_number() {
        let text = "[[runs]]\npoints = 2\n[[runs]]\npoints = \"x\"\n";
        let message = source(text).parse::<List>().unwrap_err().to_string();
        assert!(
            message.starts_with("a.toml:4: runs.2.points: invalid type"),
            "{message}"
        );
        let message = source("[[runs]]\npoints = 2\n[[runs]]\n")
            .parse::<List>()
            .unwrap_err()
            .to_string();
        assert!(
            message.starts_with("a.toml:3: runs.2: missing field `points`"),
            "{message}"
        );
        let text = "[[runs]]\npoints = 2\n\n[[runs]]\npoints = 3\n";
        assert_eq!(
            source(text).complain("runs.2.points", "odd").to_string(),
            "a.toml:5: runs.2.points: odd"
        );
        assert_eq!(
            source(text).complain("runs.2.pints", "odd").to_string(),
            "a.toml:4: runs.2.pints: odd"
        );
    }

    #[test]
    fn mistakes_are_located() {
        for (text, expected) in [
            (
                "\n[eis]\npoints = \"x\"\n",
                "a.toml:3: eis.points: invalid type",
            ),
            (
                "[eis]\npoints = 2\npionts = 3\n",
                "a.toml:3: eis.pionts: unknown field",
            ),
            (
                "[eis]\npoints = 2\n[[traces]]\npoints = 2\n[[traces]]\n\npoints = true\n",
                "a.toml:7: traces.2.points: invalid type",
            ),
            ("[eis\n", "a.toml:1: (syntax)"),
            ("[eis]\n", "a.toml:1: eis: missing field `points`"),
        ] {
            let message = source(text).parse::<File>().unwrap_err().to_string();
            assert!(message.starts_with(expected), "{message}");
        }
        let complaint = source("[eis]\n\npoints = 2\n")
            .complain("eis.points", "too few")
            .to_string();
        assert_eq!(complaint, "a.toml:3: eis.points: too few");
        // A missing field is reported at the position where it would stand.
        let complaint = source("\n[eis]\npoints = 2\n")
            .complain("eis.stop.unit", "missing")
            .to_string();
        assert_eq!(complaint, "a.toml:2: eis.stop.unit: missing");
    }

    #[test]
    fn a_fenced_file_names_nothing_outside_its_fence() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["in/a", "in/b"] {
            std::fs::create_dir_all(path(name)).unwrap();
        }
        for name in ["in/a/x.toml", "in/b/y.toml", "out.toml", "also.toml"] {
            std::fs::write(path(name), name).unwrap();
        }
        std::os::unix::fs::symlink(path("out.toml"), path("in/b/link.toml")).unwrap();
        let fence = Arc::new(Fence {
            below: path("in"),
            also: vec![path("also.toml")],
            instead: Copies::from([(PathBuf::from("b/new.toml"), "new text".to_owned())]),
        });
        let x = Source::fenced(&path("in/a/x.toml"), String::new(), &fence);
        assert_eq!(
            x.open(&x.relative("../b/y.toml")).unwrap().text(),
            "in/b/y.toml"
        );
        assert_eq!(x.open(&path("also.toml")).unwrap().text(), "also.toml");
        assert_eq!(
            x.open(&x.relative("../b/new.toml")).unwrap().text(),
            "new text"
        );
        for name in [
            "../../out.toml",
            "../b/link.toml",
            "/etc/hostname",
            "../b",
            "../../in/../out.toml",
            "none.toml",
        ] {
            let message = x.open(&x.relative(name)).unwrap_err().to_string();
            assert!(
                message.contains("the file does not exist in the folder of the configuration"),
                "{name}: {message}"
            );
        }
        assert_eq!(
            fence.relative(&x.relative("../b/./y.toml")),
            Some("b/y.toml".into())
        );
    }
}
