//! Ranges of the numbers of a scenario, as `validate.rs` checks them.

use std::collections::BTreeMap;

use syn::{
    Expr, Ident, ItemFn, LitStr, Local, Pat, Token,
    ext::IdentExt,
    parse::{Parse, ParseStream},
    visit::{self, Visit},
};

use super::{
    read,
    sources::{number, plain, text},
};

/// A bound that is not a number in the source is left open.
type Range = (Option<f64>, Option<f64>);

/// Ranges by the paths of their keys.
#[derive(Default)]
pub(super) struct Ranges {
    found: BTreeMap<String, Range>,
    /// Name of the function that is read.
    function: String,
    /// Ranges with a name.
    named: BTreeMap<String, Range>,
}

impl Ranges {
    pub(super) fn read() -> Self {
        let file = syn::parse_file(&read("fixtures/src/scenario/validate.rs")).unwrap();
        let mut ranges = Self::default();
        ranges.visit_file(&file);
        assert!(ranges.found.len() > 100, "{} ranges", ranges.found.len());
        ranges
    }

    /// Returns the range of a key as text, with a blank before it, or nothing if it is not known.
    pub(super) fn words(&self, path: &str) -> String {
        match self.found.get(path) {
            Some((Some(least), Some(greatest))) => {
                format!(" from {} to {}", plain(*least), plain(*greatest))
            }
            Some((Some(least), None)) => format!(" from {}", plain(*least)),
            Some((None, Some(greatest))) => format!(" up to {}", plain(*greatest)),
            _ => String::new(),
        }
    }
}

/// Rows of the macro `ranges`: fields of a part, each with its range.
struct Rows(Vec<(String, Range)>);

impl Parse for Rows {
    fn parse(input: ParseStream<'_>) -> syn::Result<Self> {
        input.parse::<Expr>()?;
        input.parse::<Token![,]>()?;
        let part: LitStr = input.parse()?;
        input.parse::<Token![;]>()?;
        let mut rows = Vec::new();
        while !input.is_empty() {
            let mut name = input.call(Ident::parse_any)?.to_string();
            if input.parse::<Option<Token![as]>>()?.is_some() {
                name = input.parse::<LitStr>()?.value();
            }
            let bounds;
            syn::bracketed!(bounds in input);
            let (least, _, greatest) = (
                bounds.parse::<Expr>()?,
                bounds.parse::<Token![,]>()?,
                bounds.parse::<Expr>()?,
            );
            input.parse::<LitStr>()?;
            input.parse::<Token![;]>()?;
            let range = (number(&least), number(&greatest));
            rows.push((format!("{}.{name}", part.value()), range));
        }
        Ok(Self(rows))
    }
}

/// Returns the path of a key: a literal, or a pattern without the numbers of elements.
fn path_of(value: &Expr) -> Option<String> {
    match value {
        Expr::Reference(reference) => path_of(&reference.expr),
        Expr::Macro(made) => {
            let pattern: syn::LitStr = made.mac.parse_body().ok()?;
            Some(pattern.value().replace("[{index}]", ""))
        }
        other => text(other),
    }
}

fn pair(value: &Expr) -> Option<Range> {
    match value {
        Expr::Tuple(pair) if pair.elems.len() == 2 => {
            Some((number(&pair.elems[0]), number(&pair.elems[1])))
        }
        _ => None,
    }
}

impl<'ast> Visit<'ast> for Ranges {
    fn visit_item_fn(&mut self, function: &'ast ItemFn) {
        self.function = function.sig.ident.to_string();
        visit::visit_item_fn(self, function);
    }

    fn visit_macro(&mut self, made: &'ast syn::Macro) {
        if made.path.is_ident("ranges") {
            self.found.extend(made.parse_body::<Rows>().unwrap().0);
        }
    }

    fn visit_local(&mut self, local: &'ast Local) {
        if let (Pat::Ident(name), Some(begin)) = (&local.pat, &local.init)
            && let Some(range) = pair(&begin.expr)
        {
            self.named.insert(name.ident.to_string(), range);
        }
        visit::visit_local(self, local);
    }

    fn visit_expr_call(&mut self, call: &'ast syn::ExprCall) {
        if let (Expr::Path(function), 5) = (&*call.func, call.args.len())
            && function.path.is_ident("range")
            && let Some(path) = path_of(&call.args[0])
        {
            let range = (number(&call.args[2]), number(&call.args[3]));
            self.found.insert(path, range);
        }
        visit::visit_expr_call(self, call);
    }

    fn visit_expr_tuple(&mut self, tuple: &'ast syn::ExprTuple) {
        if let (Some(path), 4) = (tuple.elems.first().and_then(text), tuple.elems.len()) {
            let range = match &tuple.elems[2] {
                Expr::Path(name) => {
                    let name = name.path.get_ident().map(ToString::to_string);
                    name.and_then(|name| self.named.get(&name).copied())
                }
                other => pair(other),
            };
            let path = format!("{}.{path}", self.function);
            self.found.extend(range.map(|range| (path, range)));
        }
        visit::visit_expr_tuple(self, tuple);
    }
}
