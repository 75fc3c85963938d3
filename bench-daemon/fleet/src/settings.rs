//! Settings of a member of a fleet.

use std::path::PathBuf;

/// Membership of this daemon in a fleet.
#[derive(Debug, Clone, PartialEq)]
pub struct FleetSettings {
    /// Name of the fleet.
    pub fleet: String,
    /// The site of this daemon's benches.
    pub site: String,
    /// Address of the broker: `nats://HOST:PORT`, or `tls://HOST:PORT`.
    pub server: String,
    /// Credentials of this daemon for the broker; `None` if it requires none.
    pub credentials: Option<Credentials>,
    /// Certificates that the broker's is checked against, PEM.
    pub ca: Option<PathBuf>,
    /// Lease time, s. A claim that has stood unchanged for this time is revoked, and another
    /// process may register a bench that has not been heard for this time.
    pub lease_s: f64,
}

/// Authentication at the broker.
#[derive(Clone, PartialEq, Eq)]
pub enum Credentials {
    /// A token.
    Token(String),
    /// A user with a password.
    User {
        /// Name of the user.
        user: String,
        /// The password.
        password: String,
    },
    /// Seed of an nkey.
    Nkey(String),
    /// A credentials file of NATS, in full.
    File(String),
}

impl std::fmt::Debug for Credentials {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // A secret must not reach a log.
        f.write_str("Credentials")
    }
}

impl Credentials {
    /// Parses the text of a credentials file: that of NATS, the seed of an nkey, `USER:PASSWORD`,
    /// or a token.
    ///
    /// # Errors
    /// The text is empty.
    pub fn read(text: &str) -> Result<Self, String> {
        let line = text.trim();
        if line.contains("-----BEGIN NATS USER JWT-----") {
            return Ok(Self::File(text.to_owned()));
        }
        if line.is_empty() || line.contains('\n') {
            return Err(
                "expected a credentials file of NATS, or one line with the seed of an nkey, \
                USER:PASSWORD or a token"
                    .to_owned(),
            );
        }
        if line.starts_with("SU") && line.len() == 58 {
            return Ok(Self::Nkey(line.to_owned()));
        }
        Ok(match line.split_once(':') {
            Some((user, password)) => Self::User {
                user: user.to_owned(),
                password: password.to_owned(),
            },
            None => Self::Token(line.to_owned()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn credentials_are_known_by_their_form_and_never_shown() {
        let user = Credentials::read("bench:secret\n").unwrap();
        let (name, password) = ("bench".to_owned(), "secret".to_owned());
        assert_eq!(
            user,
            Credentials::User {
                user: name,
                password
            }
        );
        assert_eq!(format!("{user:?}"), "Credentials");
        let token = Credentials::read("s3cr3t").unwrap();
        assert_eq!(token, Credentials::Token("s3cr3t".to_owned()));
        assert!(Credentials::read(" \n").is_err() && Credentials::read("a\nb").is_err());
    }
}
