//! Facts of a structure from its source: its keys, their values, their defaults and their meaning.

use std::collections::BTreeMap;

use syn::{
    Attribute, Expr, ExprLit, Fields, GenericArgument, Item, ItemEnum, ItemStruct, Lit, LitStr,
    Macro, PathArguments, Stmt, Token, Type, TypePath, UseTree,
    parse::{Parse, ParseStream},
    punctuated::Punctuated,
};

use super::read;

/// Default of a table whose keys all have defaults.
const ITS_DEFAULTS: &str = "no: its defaults";

/// A source file and its path.
struct Source {
    path: &'static str,
    file: syn::File,
}

/// The sources.
pub(super) struct Library {
    sources: Vec<Source>,
    /// The quantities by the names of their types.
    pub(super) quantities: BTreeMap<String, Quantity>,
}

/// Kind of a quantity, as the macro `dimension!` states it.
pub(super) struct Quantity {
    ident: String,
    /// "a current".
    pub(super) name: String,
    /// "1 A".
    pub(super) example: String,
    /// Units and their factors to SI.
    pub(super) units: Vec<(String, f64)>,
}

/// A structure and the source that it is in.
#[derive(Clone, Copy)]
pub(super) struct Structure<'a> {
    source: &'a Source,
    item: &'a ItemStruct,
}

/// Values of an enumeration, as they are typed, and their meanings.
pub(super) type Words = Vec<(String, String)>;

/// Value of a key.
pub(super) enum Value<'a> {
    /// As text.
    Plain(String),
    /// One of these words; the text states how many.
    Words(&'static str, Words),
    /// A table.
    Table(Structure<'a>),
    /// A list of tables.
    Tables(Structure<'a>),
}

/// A key of a table.
pub(super) struct Key<'a> {
    pub(super) name: String,
    pub(super) value: Value<'a>,
    pub(super) needed: String,
    pub(super) meaning: String,
}

impl Parse for Quantity {
    fn parse(input: ParseStream<'_>) -> syn::Result<Self> {
        Attribute::parse_outer(input)?;
        let ident: syn::Ident = input.parse()?;
        input.parse::<Token![,]>()?;
        let name: LitStr = input.parse()?;
        input.parse::<Token![,]>()?;
        let example: LitStr = input.parse()?;
        input.parse::<Token![,]>()?;
        let Expr::Array(units) = input.parse()? else {
            return Err(input.error("expected an array of units"));
        };
        let unit = |unit: &Expr| match unit {
            Expr::Tuple(pair) => (
                text(&pair.elems[0]).unwrap(),
                number(&pair.elems[1]).unwrap(),
            ),
            _ => panic!("{ident}: expected a unit and its factor"),
        };
        Ok(Self {
            ident: ident.to_string(),
            name: name.value(),
            example: example.value(),
            units: units.elems.iter().map(unit).collect(),
        })
    }
}

impl Library {
    pub(super) fn read(paths: &[&'static str]) -> Self {
        let source = |path: &&'static str| Source {
            path,
            file: syn::parse_file(&read(path)).unwrap(),
        };
        let quantities =
            syn::parse_file(&read("bench-daemon/plan/src/config/quantity.rs")).unwrap();
        let quantity = |item: &Item| match item {
            Item::Macro(item) if item.mac.path.is_ident("dimension") => {
                Some(item.mac.parse_body::<Quantity>().unwrap())
            }
            _ => None,
        };
        Self {
            sources: paths.iter().map(source).collect(),
            quantities: quantities
                .items
                .iter()
                .filter_map(quantity)
                .map(|quantity| (quantity.ident.clone(), quantity))
                .collect(),
        }
    }

    /// Returns a structure by the end of its source's path and its name.
    pub(super) fn structure(&self, path: &str, name: &str) -> Structure<'_> {
        let source = self
            .sources
            .iter()
            .find(|source| source.path.ends_with(&format!("/{path}")))
            .unwrap();
        source
            .structure(name)
            .unwrap_or_else(|| panic!("{path} has no structure {name}"))
    }

    /// Returns the source of a type that another source names: that source itself, otherwise the
    /// one that its path or its import names, otherwise the only one that defines it.
    fn source_of<'a>(&'a self, from: &'a Source, named: &TypePath) -> &'a Source {
        let names: Vec<String> = named
            .path
            .segments
            .iter()
            .map(|segment| segment.ident.to_string())
            .collect();
        let (name, before) = names.split_last().unwrap();
        if before.is_empty() && from.has(name) {
            return from;
        }
        let all: Vec<&Source> = self
            .sources
            .iter()
            .filter(|source| source.has(name))
            .collect();
        let module = before.last().cloned().or_else(|| from.imported_from(name));
        let of_path = module.and_then(|module| {
            let file = format!("/{module}.rs");
            all.iter().find(|source| source.path.ends_with(&file))
        });
        match (of_path, all.as_slice()) {
            (Some(source), _) | (None, [source]) => source,
            _ => panic!(
                "{}: {} sources have the type {name}: list the right one",
                from.path,
                all.len()
            ),
        }
    }

    /// Returns the keys of a table.
    pub(super) fn keys<'a>(&'a self, structure: Structure<'a>) -> Vec<Key<'a>> {
        let Structure { source, item } = structure;
        let all = Serde::of(&item.attrs);
        assert!(
            all.deny_unknown_fields,
            "{}: {} takes keys that no table of the reference lists",
            source.path, item.ident
        );
        let usual = all
            .default
            .is_some()
            .then(|| source.usual(&item.ident.to_string()))
            .flatten();
        let Fields::Named(fields) = &item.fields else {
            panic!("{}: {} has no named fields", source.path, item.ident)
        };
        let key = |field: &'a syn::Field| {
            let ident = field.ident.as_ref().unwrap().to_string();
            let own = Serde::of(&field.attrs);
            let name = own.rename.unwrap_or_else(|| all.name(&ident));
            let meaning = doc(&field.attrs);
            assert!(
                !meaning.is_empty(),
                "{}: {}.{ident} has no doc comment: say what the key means",
                source.path,
                item.ident
            );
            let literal = |value: &Expr| {
                let typed = self.literal(source, value, &field.ty);
                typed.unwrap_or_else(|| match self.value(source, &field.ty) {
                    Value::Table(_) => ITS_DEFAULTS.to_owned(),
                    _ => "no".to_owned(),
                })
            };
            let needed = match (&own.default, &all.default) {
                (Some(Some(function)), _) => literal(source.result(function)),
                (Some(None), _) => self.zero(source, &field.ty),
                (None, Some(_)) => match usual {
                    Some(usual) => usual
                        .fields
                        .iter()
                        .find(|value| matches!(&value.member, syn::Member::Named(n) if *n == ident))
                        .map_or_else(|| "no".to_owned(), |value| literal(&value.expr)),
                    None => self.zero(source, &field.ty),
                },
                (None, None) if generic(&field.ty, "Option").is_some() => "no".to_owned(),
                (None, None) => "yes".to_owned(),
            };
            Key {
                name,
                value: self.value(source, &field.ty),
                needed,
                meaning,
            }
        };
        fields.named.iter().map(key).collect()
    }

    /// Value of a type.
    fn value<'a>(&'a self, source: &'a Source, ty: &'a Type) -> Value<'a> {
        if let Some(inner) = generic(ty, "Option") {
            return self.value(source, inner);
        }
        let list = match ty {
            Type::Array(array) => Some((
                &*array.elem,
                format!("list of {}", source.length(&array.len)),
            )),
            _ => generic(ty, "Vec").map(|inner| (inner, "list".to_owned())),
        };
        if let Some((inner, list)) = list {
            return match self.value(source, inner) {
                Value::Plain(plain) => Value::Plain(match plain.as_str() {
                    "number" | "whole number" if list == "list" => format!("{list} of {plain}s"),
                    "number" | "whole number" => format!("{list} {plain}s"),
                    "text" => format!("{list} of texts"),
                    _ if plain.starts_with(['a', 'e', 'i', 'o', 'u']) => {
                        format!("{list}, each an {plain}")
                    }
                    _ => format!("{list}, each a {plain}"),
                }),
                Value::Words(_, words) => Value::Words("list of ", words),
                Value::Table(structure) | Value::Tables(structure) => Value::Tables(structure),
            };
        }
        if let Some(quantity) = self.quantity(ty) {
            let name = quantity
                .name
                .trim_start_matches("an ")
                .trim_start_matches("a ");
            return Value::Plain(format!("{name}, such as `\"{}\"`", quantity.example));
        }
        let Type::Path(named) = ty else {
            panic!("{}: a type that is not known", source.path)
        };
        let name = named.path.segments.last().unwrap().ident.to_string();
        match name.as_str() {
            "f64" => Value::Plain("number".to_owned()),
            "u8" | "u16" | "u32" | "u64" | "usize" => Value::Plain("whole number".to_owned()),
            "bool" => Value::Plain("true or false".to_owned()),
            "String" => Value::Plain("text".to_owned()),
            "BTreeMap" => Value::Plain("tables of true or false, numbers or words".to_owned()),
            _ => {
                let source = self.source_of(source, named);
                match (source.structure(&name), source.enumeration(&name)) {
                    (Some(structure), _) => Value::Table(structure),
                    (None, Some(item)) => Value::Words("", words(item)),
                    (None, None) => panic!("{}: {name} is not a type of a file", source.path),
                }
            }
        }
    }

    fn quantity(&self, ty: &Type) -> Option<&Quantity> {
        let Some(Type::Path(dimension)) = generic(ty, "Quantity") else {
            return None;
        };
        Some(&self.quantities[&dimension.path.segments.last()?.ident.to_string()])
    }

    /// Returns the default of a type without a specific one.
    fn zero(&self, source: &Source, ty: &Type) -> String {
        let Type::Path(named) = ty else {
            return "no".to_owned();
        };
        let name = named.path.segments.last().unwrap().ident.to_string();
        match name.as_str() {
            "bool" => "`false`".to_owned(),
            "f64" | "u8" | "u16" | "u32" | "u64" | "usize" => "`0`".to_owned(),
            "Option" | "Vec" | "BTreeMap" => "no".to_owned(),
            _ => {
                let item = self.source_of(source, named).enumeration(&name);
                let usual = item.and_then(|item| {
                    let variants = item.variants.iter();
                    variants.zip(words(item)).find_map(|(variant, (word, _))| {
                        let mut attrs = variant.attrs.iter();
                        attrs
                            .any(|attr| attr.path().is_ident("default"))
                            .then_some(word)
                    })
                });
                usual.map_or_else(|| ITS_DEFAULTS.to_owned(), |word| format!("`\"{word}\"`"))
            }
        }
    }

    /// Returns a readable default as a person would type it.
    fn literal(&self, source: &Source, value: &Expr, ty: &Type) -> Option<String> {
        self.typed(source, value, ty)
            .map(|typed| format!("`{typed}`"))
    }

    fn typed(&self, source: &Source, value: &Expr, ty: &Type) -> Option<String> {
        let inner = match ty {
            Type::Array(array) => Some(&*array.elem),
            _ => generic(ty, "Vec"),
        };
        let all = |elements: Vec<&Expr>| {
            let typed: Option<Vec<String>> = elements
                .into_iter()
                .map(|element| self.typed(source, element, inner?))
                .collect();
            typed.map(|typed| format!("[{}]", typed.join(", ")))
        };
        if let Some(number) = number(value) {
            return Some(plain(number));
        }
        match value {
            Expr::Lit(ExprLit {
                lit: Lit::Bool(flag),
                ..
            }) => Some(flag.value.to_string()),
            Expr::Lit(_) => text(value).map(|text| format!("{text:?}")),
            Expr::MethodCall(call) if call.method == "to_owned" => {
                self.typed(source, &call.receiver, ty)
            }
            Expr::Array(array) => all(array.elems.iter().collect()),
            Expr::Macro(made) => {
                let elements = elements(&made.mac)?;
                all(elements.iter().collect())
            }
            Expr::Call(call) => {
                let quantity = self.quantity(ty)?;
                let (unit, factor) = quantity.units.first()?;
                let si = number(call.args.first()?)?;
                Some(format!("\"{} {unit}\"", plain(si / factor)))
            }
            Expr::Path(path) if path.path.segments.len() > 1 => {
                let Type::Path(named) = ty else { return None };
                let name = named.path.segments.last()?.ident.to_string();
                let item = self.source_of(source, named).enumeration(&name)?;
                let variant = &path.path.segments.last()?.ident;
                let at = item.variants.iter().position(|v| v.ident == *variant)?;
                Some(format!("\"{}\"", words(item)[at].0))
            }
            _ => None,
        }
    }
}

impl Source {
    fn has(&self, name: &str) -> bool {
        self.structure(name).is_some() || self.enumeration(name).is_some()
    }

    fn structure(&self, name: &str) -> Option<Structure<'_>> {
        self.file.items.iter().find_map(|item| match item {
            Item::Struct(item) if item.ident == name => Some(Structure { source: self, item }),
            _ => None,
        })
    }

    fn enumeration(&self, name: &str) -> Option<&ItemEnum> {
        self.file.items.iter().find_map(|item| match item {
            Item::Enum(item) if item.ident == name => Some(item),
            _ => None,
        })
    }

    /// Module from which a name is imported.
    fn imported_from(&self, name: &str) -> Option<String> {
        fn within(tree: &UseTree, module: &str, name: &str) -> Option<String> {
            match tree {
                UseTree::Path(path) => within(&path.tree, &path.ident.to_string(), name),
                UseTree::Name(leaf) => (leaf.ident == name).then(|| module.to_owned()),
                UseTree::Group(group) => {
                    let mut items = group.items.iter();
                    items.find_map(|item| within(item, module, name))
                }
                UseTree::Rename(_) | UseTree::Glob(_) => None,
            }
        }
        self.file.items.iter().find_map(|item| match item {
            Item::Use(item) => within(&item.tree, "", name),
            _ => None,
        })
    }

    /// Last expression of a function.
    fn result(&self, function: &str) -> &Expr {
        let block = self.file.items.iter().find_map(|item| match item {
            Item::Fn(item) if item.sig.ident == function => Some(&item.block),
            _ => None,
        });
        match block.and_then(|block| block.stmts.last()) {
            Some(Stmt::Expr(value, _)) => value,
            _ => panic!("{}: expected a function {function}", self.path),
        }
    }

    /// Returns the structure expression of a type's default, or `None` if the default is derived.
    fn usual(&self, name: &str) -> Option<&syn::ExprStruct> {
        let block = self.file.items.iter().find_map(|item| {
            let Item::Impl(item) = item else { return None };
            let (_, of, _) = item.trait_.as_ref()?;
            let Type::Path(made) = &*item.self_ty else {
                return None;
            };
            if !of.is_ident("Default") || !made.path.is_ident(name) {
                return None;
            }
            item.items.iter().find_map(|item| match item {
                syn::ImplItem::Fn(function) => Some(&function.block),
                _ => None,
            })
        })?;
        match block.stmts.last() {
            Some(Stmt::Expr(Expr::Struct(usual), _)) => Some(usual),
            _ => None,
        }
    }

    /// Length of an array.
    fn length(&self, length: &Expr) -> String {
        let constant = |name: &syn::Ident| {
            self.file.items.iter().find_map(|item| match item {
                Item::Const(item) if item.ident == *name => number(&item.expr),
                _ => None,
            })
        };
        let found = match length {
            Expr::Path(path) => path.path.get_ident().and_then(constant),
            other => number(other),
        };
        plain(found.unwrap_or_else(|| panic!("{}: an array of unknown length", self.path)))
    }
}

impl<'a> Structure<'a> {
    pub(super) fn about(self) -> String {
        doc(&self.item.attrs)
    }

    pub(super) fn same_as(self, other: Structure<'a>) -> bool {
        std::ptr::eq(self.item, other.item)
    }
}

/// Attributes of serde that this reads.
#[derive(Default)]
struct Serde {
    rename: Option<String>,
    rename_all: Option<String>,
    /// `Some` if the value may be omitted; contains its function, if it has one.
    default: Option<Option<String>>,
    deny_unknown_fields: bool,
}

impl Serde {
    fn of(attrs: &[Attribute]) -> Self {
        let mut found = Self::default();
        for attr in attrs.iter().filter(|attr| attr.path().is_ident("serde")) {
            attr.parse_nested_meta(|meta| {
                let value = if meta.input.peek(Token![=]) {
                    Some(meta.value()?.parse::<LitStr>()?.value())
                } else {
                    None
                };
                match meta.path.get_ident().unwrap().to_string().as_str() {
                    "rename" => found.rename = value,
                    "rename_all" => found.rename_all = value,
                    "default" => found.default = Some(value),
                    // This affects only writing, not what a user types.
                    "skip_serializing_if" => {}
                    "deny_unknown_fields" => found.deny_unknown_fields = true,
                    other => panic!("serde({other}) is not known to the reference"),
                }
                Ok(())
            })
            .unwrap();
        }
        found
    }

    /// Returns a name of the source as a person types it.
    fn name(&self, ident: &str) -> String {
        let mut snake = String::new();
        for (at, c) in ident.char_indices() {
            if c.is_uppercase() && at > 0 {
                snake.push('_');
            }
            snake.extend(c.to_lowercase());
        }
        match self.rename_all.as_deref() {
            None => ident.to_owned(),
            Some("snake_case") => snake,
            Some("kebab-case") => snake.replace('_', "-"),
            Some("lowercase") => ident.to_lowercase(),
            Some(other) => panic!("rename_all = {other:?} is not known to the reference"),
        }
    }
}

fn words(item: &ItemEnum) -> Words {
    let all = Serde::of(&item.attrs);
    let word = |variant: &syn::Variant| {
        let own = Serde::of(&variant.attrs);
        let name = own
            .rename
            .unwrap_or_else(|| all.name(&variant.ident.to_string()));
        (name, doc(&variant.attrs))
    };
    item.variants.iter().map(word).collect()
}

/// First paragraph of a doc comment.
pub(super) fn doc(attrs: &[Attribute]) -> String {
    let line = |attr: &Attribute| match &attr.meta {
        syn::Meta::NameValue(pair) if pair.path.is_ident("doc") => text(&pair.value),
        _ => None,
    };
    let lines: Vec<String> = attrs
        .iter()
        .filter_map(line)
        .map(|line| line.trim().to_owned())
        .take_while(|line| !line.is_empty())
        .collect();
    lines.join(" ").replace("[`", "`").replace("`]", "`")
}

/// Returns the type within `Option<…>`, `Vec<…>` or another generic one.
fn generic<'a>(ty: &'a Type, name: &str) -> Option<&'a Type> {
    let Type::Path(named) = ty else { return None };
    let last = named.path.segments.last()?;
    let PathArguments::AngleBracketed(arguments) = &last.arguments else {
        return None;
    };
    match arguments.args.first()? {
        GenericArgument::Type(inner) if last.ident == name => Some(inner),
        _ => None,
    }
}

fn elements(made: &Macro) -> Option<Punctuated<Expr, Token![,]>> {
    made.parse_body_with(Punctuated::parse_terminated).ok()
}

/// Text of a literal.
pub(super) fn text(value: &Expr) -> Option<String> {
    match value {
        Expr::Lit(ExprLit {
            lit: Lit::Str(text),
            ..
        }) => Some(text.value()),
        _ => None,
    }
}

/// Number of a literal, or of a quotient of two.
pub(super) fn number(value: &Expr) -> Option<f64> {
    match value {
        Expr::Lit(ExprLit {
            lit: Lit::Float(number),
            ..
        }) => number.base10_parse().ok(),
        Expr::Lit(ExprLit {
            lit: Lit::Int(number),
            ..
        }) => number.base10_parse().ok(),
        Expr::Unary(unary) if matches!(unary.op, syn::UnOp::Neg(_)) => {
            number(&unary.expr).map(|number| -number)
        }
        Expr::Binary(binary) if matches!(binary.op, syn::BinOp::Div(_)) => {
            Some(number(&binary.left)? / number(&binary.right)?)
        }
        _ => None,
    }
}

/// Returns a number as a person types it.
pub(super) fn plain(number: f64) -> String {
    let number: f64 = format!("{number:.9e}").parse().unwrap();
    if number == 0.0 || (1.0e-4..1.0e7).contains(&number.abs()) {
        return number.to_string();
    }
    format!("{number:e}")
}
