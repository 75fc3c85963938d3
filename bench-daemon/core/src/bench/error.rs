//! Reason why a bench cannot be used.

use instruments::link::LinkError;

use super::output::Unsafe;

/// Reason why a bench cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// An instrument does not answer as expected.
    #[error("{role} ({model}): {source}")]
    Link {
        /// Its role.
        role: &'static str,
        /// Its model in the configuration.
        model: String,
        /// Error of the link.
        source: Box<LinkError>,
    },
    /// The instrument that answers is not of the configured model.
    #[error(
        "{role}: expected a {model}, found {found:?} at {address}; check model and address in the \
        bench file"
    )]
    Identity {
        /// Its role.
        role: &'static str,
        /// Its model in the configuration.
        model: String,
        /// Its address.
        address: String,
        /// Its answer.
        found: String,
    },
    /// Outputs are not known to be off.
    #[error(transparent)]
    Unsafe(#[from] Unsafe),
    /// A step needs a role that the bench lacks.
    #[error("the bench has no {role}, which this step needs")]
    Missing {
        /// The role.
        role: &'static str,
    },
    /// A model key has no dialect: the configuration should have rejected it.
    #[error("{role}: no dialect {model:?}")]
    Dialect {
        /// The role.
        role: &'static str,
        /// The key.
        model: String,
    },
}

impl BenchError {
    /// Returns the role of the instrument that the error concerns, or `None` if it concerns
    /// several.
    pub fn role(&self) -> Option<&'static str> {
        match self {
            Self::Link { role, .. }
            | Self::Identity { role, .. }
            | Self::Missing { role }
            | Self::Dialect { role, .. } => Some(role),
            Self::Unsafe(_) => None,
        }
    }
}

/// Wraps a link error with its role and its configured model.
pub(super) fn wrap(role: &'static str, model: &str, source: LinkError) -> BenchError {
    BenchError::Link {
        role,
        model: model.to_owned(),
        source: Box::new(source),
    }
}
