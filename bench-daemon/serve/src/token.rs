//! Tokens of the server. A token is 32 random bytes in hexadecimal, shown once. Only its SHA-256
//! is stored: 256 random bits cannot be found by trial, so that no slow hash is needed.

use std::{
    fs,
    os::unix::fs::{MetadataExt, OpenOptionsExt},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use analysis::dataset::write_private;
use instruments::clock;
use serde::{Deserialize, Serialize};
use subtle::ConstantTimeEq;

use super::audit::private;
use bench_core::safety::failure::Failure;
use bench_plan::support::{confined_path::plain, hash};

const FILE: &str = "tokens.json";
const PREFIX: &str = "eb_";
/// File mode: readable and writable by the owner only.
const MODE: u32 = 0o600;

/// Scope of a token.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Serialize,
    Deserialize,
    clap::ValueEnum,
    utoipa::ToSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum Scope {
    /// Permission to read. Stopping needs no scope, because whoever sees a danger must be able to
    /// stop it.
    Read,
    /// Permission to cancel, reorder, hold and pause, and to query the identity of instruments.
    Operate,
    /// Permission to let current flow: to submit, to release a hold, to continue.
    Energise,
    /// Permission to clear a bench that is latched after a trip.
    ClearTrip,
    /// To act for persons of a fleet: the scope of `eis-fleet agent`, beside read, operate and
    /// energise.
    Fleet,
}

impl Scope {
    /// All scopes.
    pub const ALL: [Self; 5] = [
        Self::Read,
        Self::Operate,
        Self::Energise,
        Self::ClearTrip,
        Self::Fleet,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Operate => "operate",
            Self::Energise => "energise",
            Self::ClearTrip => "clear-trip",
            Self::Fleet => "fleet",
        }
    }
}

/// 32 random bytes in hexadecimal.
///
/// # Errors
/// [`TokenError::Random`].
pub fn random() -> Result<String, TokenError> {
    let mut bytes = [0_u8; 32];
    getrandom::fill(&mut bytes).map_err(|error| TokenError::Random(error.to_string()))?;
    Ok(hash::hex(&bytes))
}

/// A token as it is stored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Token {
    /// Name of the holder.
    pub name: String,
    /// Its scopes.
    pub scopes: Vec<Scope>,
    /// Its SHA-256.
    pub sha256: String,
    /// Time of creation, s since 1970.
    pub made_unix_s: u64,
    /// Expiry, s since 1970; null if it never expires, like tokens of versions before 0.2.
    #[serde(default)]
    pub expires_unix_s: Option<u64>,
}

impl Token {
    /// Returns whether it has expired.
    pub fn has_expired(&self) -> bool {
        let now_s = clock::unix_time_s();
        self.expires_unix_s
            .is_some_and(|end_s| now_s >= end_s as f64)
    }
}

/// Reasons why tokens cannot be read, written or created.
#[derive(Debug, thiserror::Error)]
pub enum TokenError {
    /// The file system.
    #[error("{path}: the tokens {what}: {reason}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Operation that was tried.
        what: &'static str,
        /// Error of the operating system.
        reason: String,
    },
    /// The name is invalid.
    #[error("expected a name of letters, digits, `-` and `_`, found {0:?}")]
    Name(String),
    /// The name is in use.
    #[error("expected a new name, found that of a token that is there: {0}; revoke it first")]
    Taken(String),
    /// The name is unknown.
    #[error("expected the name of a token, found {0:?}, which does not exist")]
    Unknown(String),
    /// The machine has no source of random numbers.
    #[error("the system gives no random bytes: {0}")]
    Random(String),
}

impl From<TokenError> for Failure {
    fn from(error: TokenError) -> Self {
        Self::Usage(error.to_string())
    }
}

/// The tokens of a data folder; read again when the file has changed.
#[derive(Debug)]
pub struct Tokens {
    path: PathBuf,
    known: Mutex<(Option<Stamp>, Vec<Token>)>,
}

/// Identity of a state of the file: inode, length and time of the last change.
type Stamp = (u64, u32, u64, i64, i64);

impl Tokens {
    /// Opens the tokens of a data folder.
    pub fn of(data: &Path) -> Self {
        Self {
            path: data.join(FILE),
            known: Mutex::default(),
        }
    }

    /// Returns all tokens.
    ///
    /// # Errors
    /// A file that cannot be read or parsed: then every token is refused.
    pub fn all(&self) -> Result<Vec<Token>, TokenError> {
        let stamp = match fs::metadata(&self.path) {
            Ok(meta) => Some((
                meta.ino(),
                meta.mode(),
                meta.len(),
                meta.mtime(),
                meta.mtime_nsec(),
            )),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
            Err(error) => return Err(self.error("cannot be read", &error)),
        };
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if stamp != known.0 {
            let tokens = if stamp.is_none() {
                Vec::new()
            } else {
                self.read()?
            };
            *known = (stamp, tokens);
        }
        Ok(known.1.clone())
    }

    /// Returns the holder and the scopes of a token, or `None` for an expired one.
    ///
    /// # Errors
    /// As [`Tokens::all`].
    pub fn whose(&self, presented: &str) -> Result<Option<Token>, TokenError> {
        self.whose_sha256(&hash::sha256(presented))
    }

    /// Returns a token by its SHA-256.
    ///
    /// # Errors
    /// As [`Tokens::all`].
    pub fn whose_sha256(&self, sha256: &str) -> Result<Option<Token>, TokenError> {
        // Every hash is compared in constant time, so that the duration reveals nothing.
        let same = |token: &Token| bool::from(token.sha256.as_bytes().ct_eq(sha256.as_bytes()));
        let found =
            self.all()?.into_iter().fold(
                None,
                |found, token| if same(&token) { Some(token) } else { found },
            );
        Ok(found.filter(|token| !token.has_expired()))
    }

    /// Creates a token and returns it; it is shown only once. It expires after `valid_s`, if
    /// given.
    ///
    /// # Errors
    /// A name that is invalid or in use; a file that cannot be written.
    pub fn add(
        &self,
        name: &str,
        scopes: &[Scope],
        valid_s: Option<f64>,
    ) -> Result<String, TokenError> {
        if !plain(name) {
            return Err(TokenError::Name(name.to_owned()));
        }
        let _alone = self.alone()?;
        let mut tokens = self.all()?;
        if tokens.iter().any(|token| token.name == name) {
            return Err(TokenError::Taken(name.to_owned()));
        }
        let secret = format!("{PREFIX}{}", random()?);
        let mut scopes = scopes.to_vec();
        scopes.sort();
        scopes.dedup();
        tokens.push(Token {
            name: name.to_owned(),
            scopes,
            sha256: hash::sha256(&secret),
            made_unix_s: clock::unix_time_s() as u64,
            expires_unix_s: valid_s.map(|valid_s| (clock::unix_time_s() + valid_s) as u64),
        });
        self.write(&tokens)?;
        Ok(secret)
    }

    /// Revokes a token. It is refused from the next request on.
    ///
    /// # Errors
    /// An unknown name; a file that cannot be written.
    pub fn revoke(&self, name: &str) -> Result<(), TokenError> {
        let _alone = self.alone()?;
        let mut tokens = self.all()?;
        let before = tokens.len();
        tokens.retain(|token| token.name != name);
        if tokens.len() == before {
            return Err(TokenError::Unknown(name.to_owned()));
        }
        self.write(&tokens)
    }

    /// Takes an exclusive lock to change the tokens: two concurrent writers would each discard
    /// the other's change.
    fn alone(&self) -> Result<fs::File, TokenError> {
        let path = self.path.with_extension("lock");
        let file = fs::File::options()
            .create(true)
            .append(true)
            .mode(MODE)
            .open(&path);
        let file = file.map_err(|error| self.error("cannot be locked", &error))?;
        file.lock()
            .map_err(|error| self.error("cannot be locked", &error))?;
        Ok(file)
    }

    fn read(&self) -> Result<Vec<Token>, TokenError> {
        private(&self.path, MODE).map_err(|error| self.error("are not to be trusted", &error))?;
        let text =
            fs::read_to_string(&self.path).map_err(|error| self.error("cannot be read", &error))?;
        serde_json::from_str(&text).map_err(|error| self.error("cannot be understood", &error))
    }

    fn write(&self, tokens: &[Token]) -> Result<(), TokenError> {
        let text = serde_json::to_string_pretty(tokens)
            .map_err(|error| self.error("cannot be put into JSON", &error))?;
        write_private(&self.path, format!("{text}\n").as_bytes(), MODE)
            .map_err(|error| self.error("cannot be written", &error))
    }

    fn error(&self, what: &'static str, reason: &dyn std::fmt::Display) -> TokenError {
        TokenError::Io {
            path: self.path.clone(),
            what,
            reason: reason.to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn only_the_hash_is_on_disk_and_a_revoked_token_opens_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = Tokens::of(folder.path());
        assert_eq!(tokens.all().unwrap(), []);
        let secret = tokens
            .add("ann", &[Scope::Operate, Scope::Read, Scope::Read], None)
            .unwrap();
        let text = fs::read_to_string(folder.path().join(FILE)).unwrap();
        assert!(
            secret.len() == 67
                && !text.contains(&secret[PREFIX.len()..])
                && text.contains(&hash::sha256(&secret)),
            "{text}"
        );
        assert_eq!(
            fs::metadata(folder.path().join(FILE))
                .unwrap()
                .permissions()
                .mode()
                & 0o777,
            0o600
        );
        let whose = tokens.whose(&secret).unwrap().unwrap();
        assert_eq!(
            (whose.name.as_str(), whose.scopes.as_slice()),
            ("ann", &[Scope::Read, Scope::Operate][..])
        );
        for wrong in ["", "eb_", &secret[1..], &format!("{secret}0")] {
            assert_eq!(tokens.whose(wrong).unwrap(), None, "{wrong}");
        }
        assert!(
            tokens
                .add("ann", &[], None)
                .unwrap_err()
                .to_string()
                .contains("revoke it first")
        );
        assert!(
            tokens
                .add("a/b", &[], None)
                .unwrap_err()
                .to_string()
                .starts_with("expected a name of letters")
        );
        // Another process takes it back.
        Tokens::of(folder.path()).revoke("ann").unwrap();
        assert_eq!(tokens.whose(&secret).unwrap(), None);
        assert!(
            tokens
                .revoke("ann")
                .unwrap_err()
                .to_string()
                .contains("which does not exist")
        );
    }

    #[test]
    fn a_token_opens_nothing_once_it_has_ended() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = Tokens::of(folder.path());
        let long = tokens.add("long", &[Scope::Read], Some(3600.0)).unwrap();
        let ended = tokens.add("ended", &[Scope::Read], Some(0.0)).unwrap();
        assert_eq!(tokens.whose(&long).unwrap().unwrap().name, "long");
        assert_eq!(tokens.whose(&ended).unwrap(), None);
        // A token of an older file, without an end.
        let path = folder.path().join(FILE);
        let text = fs::read_to_string(&path).unwrap();
        let mut older: serde_json::Value = serde_json::from_str(&text).unwrap();
        for token in older.as_array_mut().unwrap() {
            token.as_object_mut().unwrap().remove("expires_unix_s");
        }
        write_private(&path, older.to_string().as_bytes(), MODE).unwrap();
        assert!(tokens.whose(&ended).unwrap().is_some());
    }

    #[test]
    fn tokens_that_cannot_be_understood_open_nothing() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(FILE), "[{}]").unwrap();
        let message = Tokens::of(folder.path())
            .whose("x")
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("tokens.json: the tokens cannot be understood: "),
            "{message}"
        );
    }
}
