//! `eis-bench token`: makes, lists and revokes the tokens of a server.

use bench_plan::config::quantity::Duration;
use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, Subcommand};
use instruments::clock;
use serde_json::json;

use crate::command::units;
use bench_core::safety::failure::Failure;
use bench_plan::support::terminal::{remark, say};
use bench_serve::{
    settings::Settings,
    token::{Scope, Token, Tokens},
};

/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// Arguments of `token`.
#[derive(Debug, Args)]
pub struct TokenArgs {
    #[command(subcommand)]
    act: Act,
    /// Print JSON.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum Act {
    /// Create a token and print it. It is shown only once.
    Add {
        /// The server's file.
        config: PathBuf,
        /// Name of the holder.
        name: String,
        /// Scopes of the token, separated by commas.
        #[arg(long, value_enum, value_delimiter = ',', default_value = "read")]
        scope: Vec<Scope>,
        /// Validity of the token: a duration such as "90 d", or `never`.
        #[arg(long, default_value = "365 d", value_name = "DURATION", value_parser = validity)]
        valid: Validity,
    },
    /// List the holders of tokens, with scopes and expiry. The tokens themselves are not stored.
    List {
        /// The server's file.
        config: PathBuf,
    },
    /// Revoke a token. It is refused from the next request on.
    Revoke {
        /// The server's file.
        config: PathBuf,
        /// Name of the holder.
        name: String,
    },
}

/// Validity of a token, s; `None` for unlimited.
#[derive(Debug, Clone, Copy)]
struct Validity(Option<f64>);

fn validity(text: &str) -> Result<Validity, String> {
    if text == "never" {
        return Ok(Validity(None));
    }
    match units::of::<Duration>(text) {
        Ok(valid_s) if valid_s > 0.0 => Ok(Validity(Some(valid_s))),
        _ => Err("expected a duration above 0 s, such as \"90 d\", or `never`".to_owned()),
    }
}

/// Makes, lists or revokes tokens.
///
/// # Errors
/// A mistake in the server's file; a name that cannot be; tokens that cannot be written.
pub fn token(args: &TokenArgs) -> Result<(), Failure> {
    let (Act::Add { config, .. } | Act::List { config } | Act::Revoke { config, .. }) = &args.act;
    let Settings { data, listen, .. } = Settings::load(config)?;
    std::fs::create_dir_all(&data)?;
    let tokens = Tokens::of(&data);
    match &args.act {
        Act::Add {
            name, scope, valid, ..
        } => {
            let secret = tokens.add(name, scope, valid.0)?;
            if args.json {
                let scopes: Vec<&str> = scope.iter().map(|scope| scope.name()).collect();
                say!(
                    "{}",
                    json!({ "name": name, "scopes": scopes, "token": secret })
                );
                return Ok(());
            }
            let ends = valid.0.map_or_else(
                || "it never ends".to_owned(),
                |valid_s| format!("it ends in {:.1} days", valid_s / DAY_S),
            );
            remark!("the token of {name}; {ends}; it is not shown again:");
            say!("{secret}");
        }
        Act::List { .. } => {
            let all = tokens.all()?;
            if args.json {
                let one = |token: &Token| {
                    let scopes: Vec<&str> = token.scopes.iter().map(|one| one.name()).collect();
                    json!({
                        "name": token.name,
                        "scopes": scopes,
                        "made_unix_s": token.made_unix_s,
                        "expires_unix_s": token.expires_unix_s,
                        "expired": token.has_expired(),
                    })
                };
                say!("{}", all.iter().map(one).collect::<serde_json::Value>());
                return Ok(());
            }
            for token in all {
                let scopes: Vec<&str> = token.scopes.iter().map(|scope| scope.name()).collect();
                let ends = match token.expires_unix_s {
                    _ if token.has_expired() => "has ended".to_owned(),
                    Some(end_s) => {
                        let left_d = (end_s as f64 - clock::unix_time_s()) / DAY_S;
                        format!("ends in {left_d:.1} days")
                    }
                    None => "never ends".to_owned(),
                };
                say!("{:<20} {:<40} {ends}", token.name, scopes.join(","));
            }
        }
        Act::Revoke { name, .. } => {
            tokens.revoke(name)?;
            if args.json {
                say!(
                    "{}",
                    json!({ "revoked": name, "left": tokens.all()?.len() })
                );
                return Ok(());
            }
            say!("{name} opens nothing any more");
            if tokens.all()?.is_empty() {
                say!("that was the last token: {}", without_tokens(listen));
            }
        }
    }
    Ok(())
}

/// Describes what callers may do on a server without tokens.
fn without_tokens(listen: SocketAddr) -> String {
    if listen.ip().is_loopback() {
        return "from now on everybody on this machine may do everything".to_owned();
    }
    format!(
        "the server listens beyond this machine (on {listen}) and refuses all requests until \
        `eis-bench token add` makes another"
    )
}
