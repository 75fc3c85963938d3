//! Reasons why a text is not a program message.

use crate::number::NumberError;

/// A program message that breaks the syntax. [`ProgramError::code`] is the number a device puts in
/// its error queue.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProgramError {
    /// A character that no header may hold.
    #[error("expected letters, digits, `_`, `:` or a leading `*` in a header, found `{0}`")]
    InvalidCharacter(String),
    /// A header with an empty node.
    #[error("expected a mnemonic between the colons of a header, found `{0}`")]
    EmptyMnemonic(String),
    /// The header with its remembered path is too long.
    #[error("expected a header of at most 255 bytes with the path before it, found {0}")]
    HeaderTooLong(usize),
    /// A comma with nothing before or after it.
    #[error("expected an argument on both sides of every comma, found none in `{0}`")]
    MissingArgument(String),
    /// Something follows an argument that is neither a comma nor the end.
    #[error("expected a comma or the end after an argument, found `{0}`")]
    Separator(String),
    /// A number that is invalid.
    #[error(transparent)]
    Number(NumberError),
    /// A string without its closing quote.
    #[error("expected a closing quote, found the end after `{0}`")]
    OpenString(String),
    /// A channel list or expression that cannot be read.
    #[error("expected a channel list such as (@101,103:105) of at most 1024 channels, found `{0}`")]
    Channels(String),
    /// A parenthesis that is not closed.
    #[error("expected a closing parenthesis, found the end after `{0}`")]
    OpenExpression(String),
    /// A block that is shorter than announced or has no proper header.
    #[error("expected a block with its announced bytes, found `{0}`")]
    Block(String),
    /// Character data with characters it may not hold.
    #[error("expected printable ASCII in character data, found `{0}`")]
    CharacterData(String),
}

impl ProgramError {
    /// Returns the standard error number (SCPI-1999 volume 2, 21.8.9).
    pub fn code(&self) -> i32 {
        match self {
            Self::InvalidCharacter(_) => -101,
            Self::EmptyMnemonic(_) => -102,
            Self::Separator(_) => -103,
            Self::MissingArgument(_) => -109,
            Self::HeaderTooLong(_) => -112,
            Self::Number(_) => -121,
            Self::CharacterData(_) => -141,
            Self::OpenString(_) => -151,
            Self::Block(_) => -161,
            Self::Channels(_) | Self::OpenExpression(_) => -171,
        }
    }
}
