//! `eis-bench token`: makes, lists and revokes the tokens of a server.

use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, Subcommand};

use crate::{
    safety::failure::Failure,
    serve::{
        settings::Settings,
        token::{Scope, TokenError, Tokens},
    },
    support::terminal::{remark, say},
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
        /// Scopes that it opens; several with commas.
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
    let Settings { data, listen, .. } = Settings::load(config)?;
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
            if tokens.all()?.is_empty() {
                say!("that was the last token: {}", without_tokens(listen));
            }
        }
    }
    Ok(())
}

/// Who may do what on a server that has no token, in words.
fn without_tokens(listen: SocketAddr) -> String {
    if listen.ip().is_loopback() {
        return "from now on everybody on this machine may do everything".to_owned();
    }
    format!(
        "the server listens beyond this machine (on {listen}) and lets nobody in until `eis-bench \
        token add` makes another"
    )
}
