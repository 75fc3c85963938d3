//! Rules of the sources that the compiler does not check: circles of files stay small, file names
//! and decisive numbers have one owner, lines are not wider than 120 columns.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use proc_macro2::{TokenStream, TokenTree};
use syn::{
    UseTree,
    visit::{self, Visit},
};

/// Crates of the daemon, each after those that it uses.
const DAEMON: [&str; 5] = [
    "bench-daemon/plan",
    "bench-daemon/core",
    "bench-daemon/evaluate",
    "bench-daemon/serve",
    "bench-daemon",
];

/// Size of the largest circle of files that use each other, and number of circles, for each crate.
/// Both numbers may only fall. [`arrows`] defines what counts as use.
const CIRCLES: [Circles; 27] = [
    Circles::of("analysis/numeric", 0, 0),
    Circles::of("analysis/plot", 0, 0),
    Circles::of("analysis/signal", 0, 0),
    Circles::of("analysis/model", 0, 0),
    Circles::of("analysis/effects", 0, 0),
    Circles::of("analysis/fit", 0, 0),
    Circles::of("analysis/forward", 0, 0),
    Circles::of("analysis/files", 0, 0),
    Circles::of("analysis/diagnosis", 0, 0),
    Circles::of("analysis/catalog", 0, 0),
    Circles::of("analysis", 0, 0),
    Circles::of("instruments/domain", 0, 0),
    Circles::of("instruments/scpi", 0, 0),
    Circles::of("instruments/link", 0, 0),
    Circles::of("instruments/drivers", 0, 0),
    Circles::of("instruments/mock", 0, 0),
    Circles::of("instruments", 0, 0),
    Circles::of("fixtures", 0, 0),
    Circles::of("fixtures/study", 0, 0),
    Circles::of("bench-daemon/archive", 0, 0),
    Circles::of("bench-daemon/fleet", 0, 0),
    Circles::of("bench-daemon/http", 0, 0),
    Circles::of("bench-daemon/plan", 0, 0),
    Circles::of("bench-daemon/core", 2, 1),
    Circles::of("bench-daemon/evaluate", 0, 0),
    Circles::of("bench-daemon/serve", 0, 0),
    Circles::of("bench-daemon", 0, 0),
];

/// Most columns of a line of a source file.
const MOST_COLUMNS: usize = 120;
/// Extensions of the files whose lines are measured.
const SOURCES: [&str; 7] = ["rs", "js", "css", "html", "toml", "py", "sh"];
/// Folders with built, generated or measured files; hidden ones are skipped too, except `.ci`.
const SKIPPED: [&str; 6] = ["target", "out", "runs", "data", "__pycache__", "vendor"];

struct Circles {
    krate: &'static str,
    largest: usize,
    most: usize,
}

impl Circles {
    const fn of(krate: &'static str, largest: usize, most: usize) -> Self {
        Self {
            krate,
            largest,
            most,
        }
    }
}

type Module = Vec<String>;

/// Returns the source files of a crate by module, without tests.
fn files(krate: &str) -> BTreeMap<Module, PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("..")
        .join(krate)
        .join("src");
    let mut found = BTreeMap::new();
    walk(&root, &mut Vec::new(), &mut found);
    found
}

fn walk(folder: &Path, at: &mut Module, found: &mut BTreeMap<Module, PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_str().unwrap().to_owned();
        if stem == "tests" {
            continue;
        }
        if path.is_dir() {
            at.push(stem);
            walk(&path, at, found);
            at.pop();
        } else if path.extension().is_some_and(|end| end == "rs") {
            let own = (!["lib", "mod"].contains(&stem.as_str())).then_some(stem);
            found.insert(at.iter().cloned().chain(own).collect(), path);
        }
    }
}

/// Paths that a file names, as they stand there, and the names that it defines.
#[derive(Default)]
struct Source {
    /// Paths of its code and of its private imports.
    named: Vec<Module>,
    /// Paths of its public imports.
    exported: Vec<Module>,
    /// Paths of all its imports, by the name that they get.
    imports: BTreeMap<String, Module>,
    /// Paths of the imports that end in `*`.
    globs: Vec<Module>,
    /// Names of its items, and all names in the macros among them, which may define items.
    items: BTreeSet<String>,
}

impl Source {
    fn of(file: &syn::File) -> Self {
        let mut source = Self::default();
        source.visit_file(file);
        for item in &file.items {
            let name = match item {
                syn::Item::Const(item) => &item.ident,
                syn::Item::Enum(item) => &item.ident,
                syn::Item::Fn(item) => &item.sig.ident,
                syn::Item::Mod(item) if item.content.is_some() => &item.ident,
                syn::Item::Static(item) => &item.ident,
                syn::Item::Struct(item) => &item.ident,
                syn::Item::Trait(item) => &item.ident,
                syn::Item::Type(item) => &item.ident,
                syn::Item::Macro(item) => {
                    source
                        .items
                        .extend(item.ident.as_ref().map(ToString::to_string));
                    source.define_all(item.mac.tokens.clone());
                    continue;
                }
                _ => continue,
            };
            source.items.insert(name.to_string());
        }
        source
    }

    fn define_all(&mut self, tokens: TokenStream) {
        for token in tokens {
            match token {
                TokenTree::Ident(name) => _ = self.items.insert(name.to_string()),
                TokenTree::Group(group) => self.define_all(group.stream()),
                _ => (),
            }
        }
    }

    /// Enters the imports of a `use`, and returns their paths.
    fn import(&mut self, before: &[String], tree: &UseTree) -> Vec<Module> {
        let with = |name: &syn::Ident| match name.to_string() {
            name if name == "self" => before.to_vec(),
            name => [before, &[name]].concat(),
        };
        let (name, path) = match tree {
            UseTree::Path(path) => return self.import(&with(&path.ident), &path.tree),
            UseTree::Group(group) => {
                let each = group.items.iter();
                return each.flat_map(|tree| self.import(before, tree)).collect();
            }
            UseTree::Glob(_) => {
                self.globs.push(before.to_vec());
                return vec![before.to_vec()];
            }
            UseTree::Name(name) => (with(&name.ident).last().cloned(), with(&name.ident)),
            UseTree::Rename(name) => (Some(name.rename.to_string()), with(&name.ident)),
        };
        self.imports.extend(name.map(|name| (name, path.clone())));
        vec![path]
    }

    /// Paths in the arguments of macros, which are not parsed.
    fn tokens(&mut self, tokens: TokenStream) {
        let (mut path, mut colons): (Module, usize) = (Vec::new(), 0);
        for token in tokens {
            match token {
                TokenTree::Punct(mark) if mark.as_char() == ':' => colons += 1,
                TokenTree::Ident(name) => {
                    if colons != 2 {
                        self.named.push(std::mem::take(&mut path));
                    }
                    path.push(name.to_string());
                    colons = 0;
                }
                other => {
                    self.named.push(std::mem::take(&mut path));
                    colons = 0;
                    if let TokenTree::Group(group) = other {
                        self.tokens(group.stream());
                    }
                }
            }
        }
        self.named.push(path);
    }
}

/// Parses a source file without the modules that are compiled for tests only.
fn parsed(path: impl AsRef<Path>) -> syn::File {
    let mut file = syn::parse_file(&std::fs::read_to_string(path).unwrap()).unwrap();
    leave_out_tests(&mut file.items);
    file
}

fn leave_out_tests(items: &mut Vec<syn::Item>) {
    items.retain(|item| !matches!(item, syn::Item::Mod(module) if is_test(module)));
    for item in items {
        if let syn::Item::Mod(syn::ItemMod {
            content: Some((_, inner)),
            ..
        }) = item
        {
            leave_out_tests(inner);
        }
    }
}

/// Whether a module is compiled for tests only.
fn is_test(item: &syn::ItemMod) -> bool {
    item.attrs.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute
                .meta
                .require_list()
                .is_ok_and(|list| list.tokens.to_string() == "test")
    })
}

impl<'ast> Visit<'ast> for Source {
    /// `pub(super)` names no module.
    fn visit_visibility(&mut self, _: &'ast syn::Visibility) {}

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        let paths = self.import(&[], &item.tree);
        match item.vis {
            syn::Visibility::Inherited => self.named.extend(paths),
            _ => self.exported.extend(paths),
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names = path.segments.iter();
        self.named
            .push(names.map(|segment| segment.ident.to_string()).collect());
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &'ast syn::Macro) {
        self.visit_path(&item.path);
        self.tokens(item.tokens.clone());
    }
}

type Sources = BTreeMap<Module, Source>;

/// Returns the sources of a crate by module.
fn sources(krate: &str) -> Sources {
    let files = files(krate).into_iter();
    files
        .map(|(module, path)| (module, Source::of(&parsed(path))))
        .collect()
}

/// Returns the file that defines what a path names, as seen from a module, or `None` if the path
/// ends in a module or leaves the crate. Imports are followed: a module that only re-exports a
/// name does not count.
fn definer(path: &[String], from: &[String], sources: &Sources) -> Option<Module> {
    let (name, rest) = path.split_first()?;
    let source = sources.get(from)?;
    let inner = [from, std::slice::from_ref(name)].concat();
    let is_module = sources.contains_key(&inner);
    match name.as_str() {
        "crate" => definer(rest, &[], sources),
        "self" => definer(rest, from, sources),
        "super" => definer(rest, from.split_last()?.1, sources),
        _ if is_module && !rest.is_empty() => definer(rest, &inner, sources),
        _ if source.items.contains(name) => Some(from.to_vec()),
        _ => match source.imports.get(name) {
            // An import that begins with its own name is of another crate.
            Some(import) if is_module || import[0] != *name => {
                definer(&[import, rest].concat(), from, sources)
            }
            Some(_) => None,
            None => {
                let of_a_child =
                    |glob: &&Module| sources.contains_key(&[from, &glob[..1]].concat());
                let within = |glob: &Module| definer(&[glob, path].concat(), from, sources);
                source.globs.iter().filter(of_a_child).find_map(within)
            }
        },
    }
}

type Arrows = BTreeMap<Module, BTreeSet<Module>>;

/// Returns which file uses which other files of its crate.
///
/// An arrow goes from a file to the file that defines what it names. Paths may begin with `crate`,
/// `self`, `super` or a child module. Imports are followed: a file that only re-exports a name
/// gets no arrow. `mod` and `pub use` of files below do not count as use either: a parent may list
/// its children. A parent whose own code uses a child that uses the parent makes a circle. Method
/// calls are not detected.
fn arrows(sources: &Sources) -> Arrows {
    let of = |(module, source): (&Module, &Source)| {
        let find = |path: &Module| definer(path, module, sources);
        let exported = source.exported.iter().filter_map(find);
        let to = exported
            .filter(|to| !to.starts_with(module))
            .chain(source.named.iter().filter_map(find))
            .filter(|to| to != module)
            .collect();
        (module.clone(), to)
    };
    sources.iter().map(of).collect()
}

/// Returns the modules that can be reached from a module.
fn reached<'a>(from: &'a Module, arrows: &'a Arrows) -> BTreeSet<&'a Module> {
    let (mut seen, mut next) = (BTreeSet::new(), vec![from]);
    while let Some(module) = next.pop() {
        for to in arrows.get(module).into_iter().flatten() {
            if seen.insert(to) {
                next.push(to);
            }
        }
    }
    seen
}

/// Returns the circles of files, the largest first.
fn circles(arrows: &Arrows) -> Vec<Vec<String>> {
    let reach: BTreeMap<&Module, BTreeSet<&Module>> = arrows
        .keys()
        .map(|module| (module, reached(module, arrows)))
        .collect();
    let mut found = BTreeSet::new();
    for (module, reached) in &reach {
        let circle: Vec<String> = reached
            .iter()
            .filter(|other| reach.get(*other).is_some_and(|back| back.contains(module)))
            .map(|other| other.join("::"))
            .collect();
        if circle.len() > 1 {
            found.insert(circle);
        }
    }
    let mut found: Vec<_> = found.into_iter().collect();
    found.sort_by_key(|circle| std::cmp::Reverse(circle.len()));
    found
}

/// Returns the circles of a small crate, given by its files.
fn circles_of(files: &[(&str, &str)]) -> Vec<Vec<String>> {
    let module = |path: &str| path.split_terminator("::").map(str::to_owned).collect();
    let source = |text: &str| Source::of(&syn::parse_file(text).unwrap());
    let files = files.iter().chain(&[("", "mod a;")]);
    let sources = files.map(|(path, text)| (module(path), source(text)));
    circles(&arrows(&sources.collect()))
}

#[test]
fn a_parent_whose_code_uses_a_child_that_uses_it_is_a_circle() {
    let child = ("a::b", "use super::Data; pub fn f(_: Data) {}");
    let pair = [["a", "a::b"]];
    for uses in [
        "fn g() { b::f(Data) }",
        "use b::f; fn g() { f(Data) }",
        "pub use b::f; fn g() { f(Data) }",
        "fn g() { call!(b::f(Data)) }",
    ] {
        let parent = format!("mod b; pub struct Data; {uses}");
        assert_eq!(circles_of(&[("a", &parent), child]), pair, "{uses}");
    }
    let lists = "pub mod b; pub use b::f; pub struct Data;";
    assert_eq!(circles_of(&[("a", lists), child]), [[""; 0]; 0]);
}

#[test]
fn a_name_that_a_parent_passes_on_leads_to_the_file_that_defines_it() {
    let parent = "mod b; mod c; pub use b::Data; pub use c::*;";
    let needs = ("a::c", "use super::Data; pub fn f(_: Data) {}");
    let free = ("a::b", "pub struct Data;");
    assert_eq!(circles_of(&[("a", parent), free, needs]), [[""; 0]; 0]);
    for back in ["use super::f;", "use crate::a::f;", "use super::c::f;"] {
        let defines = format!("{back} pub struct Data;");
        let found = circles_of(&[("a", parent), ("a::b", &defines), needs]);
        assert_eq!(found, [["a::b", "a::c"]], "{back}");
    }
}

#[test]
fn circles_of_files_become_fewer_and_smaller_only() {
    for Circles {
        krate,
        largest,
        most,
    } in CIRCLES
    {
        let found = circles(&arrows(&sources(krate)));
        let size = found.first().map_or(0, Vec::len);
        assert!(
            size <= largest && found.len() <= most,
            "{krate}: {found:#?}"
        );
    }
}

/// The module that alone spells the names of a run folder.
const OWNER: &str = "run_folder";
/// Names of folders that are also plain words: they count where they are part of a path.
const PLAIN_WORDS: [&str; 5] = ["config", "plots", "shared", "spectra", "zero"];

/// The texts of a file, attributes and tests left out: all of them, those of constants, and those
/// that are handed to `join` and `path`.
#[derive(Default)]
struct Texts {
    all: Vec<String>,
    constant: Vec<String>,
    joined: Vec<String>,
}

impl Texts {
    fn of(path: &Path) -> Self {
        let mut texts = Self::default();
        texts.visit_file(&parsed(path));
        texts
    }

    /// Texts in the arguments of macros, which are not parsed.
    fn tokens(&mut self, tokens: TokenStream) {
        for token in tokens {
            match token {
                TokenTree::Literal(literal) => {
                    if let syn::Lit::Str(text) = syn::Lit::new(literal) {
                        self.all.push(text.value());
                    }
                }
                TokenTree::Group(group) => self.tokens(group.stream()),
                _ => (),
            }
        }
    }
}

impl<'ast> Visit<'ast> for Texts {
    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}

    fn visit_item_const(&mut self, item: &'ast syn::ItemConst) {
        let before = self.all.len();
        visit::visit_item_const(self, item);
        self.constant.extend_from_slice(&self.all[before..]);
    }

    fn visit_lit_str(&mut self, text: &'ast syn::LitStr) {
        self.all.push(text.value());
    }

    fn visit_expr_method_call(&mut self, call: &'ast syn::ExprMethodCall) {
        if call.method == "join" || call.method == "path" {
            let texts = call.args.iter().filter_map(|argument| match argument {
                syn::Expr::Lit(syn::ExprLit {
                    lit: syn::Lit::Str(text),
                    ..
                }) => Some(text.value()),
                _ => None,
            });
            self.joined.extend(texts);
        }
        visit::visit_expr_method_call(self, call);
    }

    fn visit_macro(&mut self, item: &'ast syn::Macro) {
        self.tokens(item.tokens.clone());
    }
}

/// Names that the owner spells: complete names, and prefixes of names with a variable part.
struct Spelled {
    names: BTreeSet<String>,
    beginnings: BTreeSet<String>,
}

impl Spelled {
    fn read() -> Self {
        let (mut names, mut beginnings) = (BTreeSet::new(), BTreeSet::new());
        let own = files("analysis/files").into_iter();
        for (_, path) in own.filter(|(module, _)| module.first().is_some_and(|m| m == OWNER)) {
            let texts = Texts::of(&path);
            names.extend(texts.constant);
            let depending = texts.all.iter().filter_map(|text| text.split_once('{'));
            beginnings.extend(
                depending
                    .filter(|(beginning, _)| beginning.ends_with('_'))
                    .map(|(beginning, _)| format!("{beginning}{{")),
            );
        }
        Self { names, beginnings }
    }

    /// Whether a text spells a name: all of it, a file in a sentence, or the beginning of a path.
    fn is_in(&self, text: &str, joined: bool) -> bool {
        let whole = text.trim();
        let is_whole = self.names.contains(whole) && (joined || !PLAIN_WORDS.contains(&whole));
        let parts = text.split(|c: char| !(c.is_ascii_alphanumeric() || "._-".contains(c)));
        let is_file = |part: &str| part.contains(|c: char| c == '.' || c.is_ascii_uppercase());
        let mut files = parts
            .map(|part| part.trim_end_matches('.'))
            .filter(|part| is_file(part) && self.names.contains(*part));
        let in_folder = |name: &String| {
            text.strip_prefix(name.as_str())
                .is_some_and(|rest| rest.starts_with('/'))
        };
        is_whole
            || files.next().is_some()
            || self.names.iter().any(in_folder)
            || self.beginnings.iter().any(|start| text.starts_with(start))
    }
}

#[test]
fn the_names_of_a_run_folder_have_one_owner() {
    let spelled = Spelled::read();
    assert!(spelled.names.contains("journal.jsonl") && spelled.beginnings.contains("model_{"));
    let mut found = Vec::new();
    for krate in CIRCLES.map(|circles| circles.krate) {
        if krate.starts_with("instruments") || krate.starts_with("fixtures") {
            continue;
        }
        for (module, path) in files(krate) {
            // The help of the command line may name files.
            if module
                .first()
                .is_some_and(|first| first == OWNER || first == "cli")
            {
                continue;
            }
            let texts = Texts::of(&path);
            let all = texts.all.iter().map(|text| (text, false));
            let spelt = all
                .chain(texts.joined.iter().map(|text| (text, true)))
                .filter(|(text, joined)| spelled.is_in(text, *joined))
                .map(|(text, _)| format!("{krate}::{}: {text:?}", module.join("::")));
            found.extend(spelt);
        }
    }
    assert_eq!(found, [""; 0]);
}

#[test]
fn one_file_of_the_daemon_names_the_mocks() {
    let found: Vec<String> = DAEMON
        .into_iter()
        .flat_map(files)
        .filter(|(_, path)| {
            let Source {
                named, exported, ..
            } = Source::of(&parsed(path));
            let is_mocks = |path: &Module| path.iter().take(2).eq(["instruments", "mock"]);
            named.iter().chain(&exported).any(is_mocks)
        })
        .map(|(module, _)| module.join("::"))
        .collect();
    assert_eq!(found, ["mocks"]);
}

/// Greatest number of fields in a struct of the daemon that changes itself.
const MOST_FIELDS: usize = 8;

/// The number of fields of the structs of a module and of the modules in it, and which structs have
/// methods that change them.
#[derive(Default)]
struct Acting {
    fields: BTreeMap<String, usize>,
    changing: BTreeSet<String>,
}

impl Acting {
    /// Returns the structs that change themselves, with their numbers of fields.
    fn structs(&self) -> impl Iterator<Item = (&str, usize)> {
        self.fields
            .iter()
            .filter(|(name, _)| self.changing.contains(*name))
            .map(|(name, fields)| (name.as_str(), *fields))
    }
}

impl<'ast> Visit<'ast> for Acting {
    /// Of two structs with one name in a module the larger one counts.
    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        let fields = self.fields.entry(item.ident.to_string()).or_default();
        *fields = item.fields.len().max(*fields);
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        let changes = |inner: &syn::ImplItem| match inner {
            syn::ImplItem::Fn(function) => function.sig.receiver().is_some_and(|receiver| {
                receiver.reference.is_some() && receiver.mutability.is_some()
            }),
            _ => false,
        };
        if let syn::Type::Path(path) = item.self_ty.as_ref()
            && let Some(last) = path.path.segments.last()
            && item.items.iter().any(changes)
        {
            self.changing.insert(last.ident.to_string());
        }
    }
}

#[test]
fn what_acts_in_the_daemon_has_few_fields() {
    let mut modules: BTreeMap<String, Acting> = BTreeMap::new();
    for krate in DAEMON {
        for (module, path) in files(krate) {
            let first = module.first().map_or("", String::as_str);
            let module = format!("{krate}/{first}");
            modules.entry(module).or_default().visit_file(&parsed(path));
        }
    }
    let large: Vec<String> = modules
        .iter()
        .flat_map(|(module, acting)| acting.structs().map(move |found| (module, found)))
        .filter(|(_, (_, fields))| *fields > MOST_FIELDS)
        .map(|(module, (name, fields))| format!("{module}: {name} has {fields} fields"))
        .collect();
    let acts = |module: &str, name: &str| modules[module].structs().any(|(of, _)| of == name);
    assert!(
        acts("bench-daemon/core/executor", "Executor")
            && acts("bench-daemon/core/bench", "Bench")
            && acts("bench-daemon/serve/watch", "Watch")
    );
    assert_eq!(large, [""; 0]);
}

/// The module that alone holds numbers of the diagnosis that decide something.
const REGISTRY: &str = "thresholds";
/// Constants of the diagnosis that decide nothing, or whole modules of them, with the reason.
const NO_THRESHOLDS: [(&str, &str); 28] = [
    ("consistency::STEP", "step of a derivative"),
    ("current_filter::LASTING_ROWS", "a count"),
    (
        "current_filter::SPLIT_TRIES",
        "places that a search looks at first",
    ),
    ("edges::COMMON", "a count"),
    ("edges::UNIFORM", "mathematics: 1/√12"),
    ("estimate::ITERATIONS", "limit of a solver"),
    ("experiment::separate::DAMPING", "damping of a solver"),
    ("intervals::MOST_REFITS", "limit of a solver"),
    ("intervals::NEAR", "tolerance of a solver"),
    ("noise::LARGER", "step of a derivative"),
    ("outcome::DIAGNOSIS_SCHEMA_VERSION", "version of a format"),
    ("periodic::TINY", "keeps a quotient finite"),
    ("problem::ITERATIONS", "limit of a solver"),
    ("problem::PROMISE", "tolerance of a solver"),
    ("problem::PROMISE_PART", "tolerance of a solver"),
    ("problem::KEPT_PROMISE", "steps of a solver"),
    ("problem::DAMPING_GROWTH", "steps of a solver"),
    ("problem::BEND_PART", "steps of a solver"),
    ("problem::MOST_ACCELERATION", "steps of a solver"),
    ("problem::UNMOVED", "damping of a solver"),
    ("report", "layout of pages and pictures"),
    ("shared::CHANNELS", "a count"),
    ("shared::OWN", "length of a list"),
    ("shared::DISTORTION", "place in a list"),
    ("stepped", "steps of a solver"),
    ("structure::LONGEST_LOG", "longest step of a solver"),
    ("structure::LONGEST_PART", "longest step of a solver"),
    ("windows::APART", "mathematics: 1/(2√3)"),
];

/// The names of a file's constants of one number, tests left out.
#[derive(Default)]
struct Numbers(Vec<String>);

impl Numbers {
    fn add(&mut self, name: &syn::Ident, of: &syn::Type) {
        let is_number = |path: &syn::Path| {
            ["f64", "usize", "u32"]
                .iter()
                .any(|number| path.is_ident(number))
        };
        if matches!(of, syn::Type::Path(of) if is_number(&of.path)) {
            self.0.push(name.to_string());
        }
    }
}

impl<'ast> Visit<'ast> for Numbers {
    fn visit_item_const(&mut self, item: &'ast syn::ItemConst) {
        self.add(&item.ident, &item.ty);
    }

    fn visit_impl_item_const(&mut self, item: &'ast syn::ImplItemConst) {
        self.add(&item.ident, &item.ty);
    }
}

#[test]
fn the_thresholds_of_the_diagnosis_have_one_owner() {
    let mut found = Vec::new();
    for (module, path) in files("analysis/diagnosis") {
        if module.first().is_some_and(|first| first == REGISTRY) {
            continue;
        }
        let mut numbers = Numbers::default();
        numbers.visit_file(&parsed(path));
        let named = numbers.0.into_iter().map(|name| {
            let path: Module = module.iter().cloned().chain([name]).collect();
            path.join("::")
        });
        found.extend(named);
    }
    let is_excepted = |name: &str, except: &str| {
        name.strip_prefix(except)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with("::"))
    };
    let excepted = |name: &String| NO_THRESHOLDS.iter().any(|(of, _)| is_excepted(name, of));
    let unlisted: Vec<&String> = found.iter().filter(|name| !excepted(name)).collect();
    assert_eq!(unlisted, [""; 0], "they belong to {REGISTRY}");
    let gone: Vec<&str> = NO_THRESHOLDS
        .iter()
        .map(|(of, _)| *of)
        .filter(|of| !found.iter().any(|name| is_excepted(name, of)))
        .collect();
    assert_eq!(gone, [""; 0], "exceptions that no constant needs");
}

/// Returns the lines of source files below a folder with more than [`MOST_COLUMNS`], as `path:line:
/// columns`.
fn wide_lines(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let (path, kind) = (entry.path(), entry.file_type().unwrap());
        let name = entry.file_name().to_string_lossy().into_owned();
        let hidden = name.starts_with('.') && name != ".ci";
        if kind.is_dir() && !hidden && !SKIPPED.contains(&name.as_str()) {
            found.extend(wide_lines(&path));
        }
        let extension = path.extension().and_then(|extension| extension.to_str());
        if !kind.is_file() || !extension.is_some_and(|extension| SOURCES.contains(&extension)) {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        for (number, line) in (1..).zip(text.lines()) {
            let columns = line.chars().count();
            if columns > MOST_COLUMNS {
                found.push(format!("{}:{number}: {columns}", path.display()));
            }
        }
    }
    found
}

#[test]
fn no_line_of_a_source_file_is_wider_than_120_columns() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    assert_eq!(wide_lines(&root), [""; 0]);
}

/// Functions of a file that take a tuple in the place of several arguments, tests left out.
#[derive(Default)]
struct Tuples(Vec<String>);

impl<'ast> Visit<'ast> for Tuples {
    fn visit_signature(&mut self, signature: &'ast syn::Signature) {
        let is_tuple = |of: &syn::Type| match of {
            syn::Type::Tuple(tuple) => tuple.elems.len() > 1,
            syn::Type::Reference(to) => {
                matches!(&*to.elem, syn::Type::Tuple(tuple) if tuple.elems.len() > 1)
            }
            _ => false,
        };
        let takes = signature.inputs.iter().any(|argument| match argument {
            syn::FnArg::Typed(argument) => is_tuple(&argument.ty),
            syn::FnArg::Receiver(_) => false,
        });
        if takes {
            self.0.push(signature.ident.to_string());
        }
    }
}

#[test]
fn no_function_takes_a_tuple_in_the_place_of_arguments() {
    let mut found = Vec::new();
    for krate in CIRCLES.map(|circles| circles.krate) {
        for (module, path) in files(krate) {
            let mut tuples = Tuples::default();
            tuples.visit_file(&parsed(path));
            let named = tuples.0.into_iter();
            found.extend(named.map(|name| format!("{krate}::{}::{name}", module.join("::"))));
        }
    }
    assert_eq!(found, [""; 0]);
}
