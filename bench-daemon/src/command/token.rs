//! `eis-bench token`: who may ask a server for what.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::terminal::{remark, say};
use crate::{
    command::Failure,
    serve::{
        settings::Settings,
        token::{Scope, TokenError, Tokens},
    },
};

/// Arguments of `token`.
#[derive(Debug, Args)]
pub struct TokenArgs {
    #[command(subcommand)]
    act: Act,
}

#[derive(Debug, Subcommand)]
enum Act {
    /// Make a token and show it, this once.
    Add {
        /// The server's file.
        config: PathBuf,
        /// Whose it is.
        name: String,
        /// What it opens; several with commas.
        #[arg(long, value_enum, value_delimiter = ',', default_value = "read")]
        scope: Vec<Scope>,
    },
    /// Show whose tokens there are; not the tokens themselves, which nobody has.
    List {
        /// The server's file.
        config: PathBuf,
    },
    /// Take a token back; it opens nothing from the next request on.
    Revoke {
        /// The server's file.
        config: PathBuf,
        /// Whose it is.
        name: String,
    },
}

impl From<TokenError> for Failure {
    fn from(error: TokenError) -> Self {
        Self::Usage(error.to_string())
    }
}

/// Makes, lists or revokes tokens.
///
/// # Errors
/// A mistake in the server's file; a name that cannot be; tokens that cannot be written.
pub fn token(args: &TokenArgs) -> Result<(), Failure> {
    let (Act::Add { config, .. } | Act::List { config } | Act::Revoke { config, .. }) = &args.act;
    let data = Settings::load(config)?.data;
    std::fs::create_dir_all(&data)?;
    let tokens = Tokens::of(&data);
    match &args.act {
        Act::Add { name, scope, .. } => {
            let secret = tokens.add(name, scope)?;
            remark!("the token of {name}; it is not shown again:");
            say!("{secret}");
        }
        Act::List { .. } => {
            for token in tokens.all()? {
                let scopes: Vec<&str> = token.scopes.iter().map(|scope| scope.name()).collect();
                say!("{:<20} {}", token.name, scopes.join(","));
            }
        }
        Act::Revoke { name, .. } => {
            tokens.revoke(name)?;
            say!("{name} opens nothing any more");
        }
    }
    Ok(())
}
