//! The page of the command line: the help of the program and of each of its commands, and the exit
//! codes, compared with `failure.rs`.

use std::{collections::BTreeSet, process::Command};

use syn::{
    Item,
    visit::{self, Visit},
};

use super::read;

/// Width of the help, in columns.
const COLUMNS: &str = "100";

/// Returns the page; the given text states how it is generated.
pub(super) fn page(made: &str) -> String {
    let whole = help(&[]);
    let (help_text, codes) = whole.split_once("Exit codes:\n").unwrap();
    let codes = exit_codes(codes);
    let mut text = format!(
        "# Command line\n\n{made}\n`eis-bench COMMAND --help` prints the same.\n\n\
        ## Exit codes\n\n| code | meaning |\n|---|---|\n"
    );
    for (code, meaning) in &codes {
        text.push_str(&format!("| {code} | {meaning} |\n"));
    }
    let documented: BTreeSet<u8> = codes.iter().map(|(code, _)| *code).collect();
    let mut returned = returned_codes();
    returned.insert(0);
    assert_eq!(
        documented, returned,
        "the help against `Failure::exit_code`"
    );
    text.push_str(&section("eis-bench", help_text));
    let mut waiting: Vec<Vec<String>> = commands(&whole).into_iter().map(|c| vec![c]).collect();
    waiting.reverse();
    while let Some(command) = waiting.pop() {
        let own = help(&command);
        text.push_str(&section(&format!("eis-bench {}", command.join(" ")), &own));
        for inner in commands(&own).into_iter().rev() {
            waiting.push(command.iter().cloned().chain([inner]).collect());
        }
    }
    text
}

fn section(command: &str, help: &str) -> String {
    format!("\n## `{command}`\n\n```text\n{}\n```\n", help.trim_end())
}

/// Returns the help of a command.
fn help(command: &[String]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_eis-bench"))
        .args(command)
        .arg("--help")
        .env("COLUMNS", COLUMNS)
        .stdin(std::process::Stdio::null())
        .output()
        .unwrap();
    assert!(output.status.success(), "{command:?}: {}", output.status);
    let help = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
    lines.join("\n")
}

/// Returns the commands that a help lists.
fn commands(help: &str) -> Vec<String> {
    let Some((_, listed)) = help.split_once("\nCommands:\n") else {
        return Vec::new();
    };
    listed
        .lines()
        .take_while(|line| line.is_empty() || line.starts_with(' '))
        .filter_map(|line| line.strip_prefix("  "))
        .filter(|line| line.starts_with(|c: char| c.is_ascii_lowercase()))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|command| *command != "help")
        .map(str::to_owned)
        .collect()
}

/// Returns codes and meanings of the help; a meaning may continue on the next line.
fn exit_codes(listed: &str) -> Vec<(u8, String)> {
    let mut codes: Vec<(u8, String)> = Vec::new();
    for line in listed
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
    {
        let code = line
            .split_once(' ')
            .and_then(|(code, meaning)| Some((code.parse().ok()?, meaning.trim().to_owned())));
        match (code, codes.last_mut()) {
            (Some(code), _) => codes.push(code),
            (None, Some((_, meaning))) => {
                meaning.push(' ');
                meaning.push_str(line);
            }
            (None, None) => panic!("expected an exit code, found {line}"),
        }
    }
    codes
}

/// Codes that the program returns.
fn returned_codes() -> BTreeSet<u8> {
    struct Codes(BTreeSet<u8>);
    impl<'ast> Visit<'ast> for Codes {
        fn visit_impl_item_fn(&mut self, function: &'ast syn::ImplItemFn) {
            if function.sig.ident == "exit_code" {
                visit::visit_impl_item_fn(self, function);
            }
        }
        fn visit_arm(&mut self, arm: &'ast syn::Arm) {
            if let syn::Expr::Lit(syn::ExprLit {
                lit: syn::Lit::Int(code),
                ..
            }) = &*arm.body
            {
                self.0.insert(code.base10_parse().unwrap());
            }
        }
    }
    let file = syn::parse_file(&read("bench-daemon/core/src/safety/failure.rs")).unwrap();
    let mut codes = Codes(BTreeSet::new());
    for item in &file.items {
        match item {
            Item::Impl(item) => codes.visit_item_impl(item),
            Item::Const(named) if named.ident.to_string().ends_with("_CODE") => {
                if let syn::Expr::Lit(syn::ExprLit {
                    lit: syn::Lit::Int(code),
                    ..
                }) = &*named.expr
                {
                    codes.0.insert(code.base10_parse().unwrap());
                }
            }
            _ => {}
        }
    }
    codes.0
}
