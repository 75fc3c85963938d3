//! Reason why a text is not a valid address.

/// An address that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: expected {expected}, found `{found}`")]
pub struct AddressError {
    pub(super) field: &'static str,
    pub(super) expected: String,
    pub(super) found: String,
}

impl AddressError {
    pub(super) fn new(field: &'static str, expected: &str, found: &str) -> Self {
        Self {
            field,
            expected: expected.to_owned(),
            found: found.to_owned(),
        }
    }

    /// Returns the invalid part of the address: `address`, `host`, `port`, `path`, `baud`,
    /// `parity`, `data`, `stop`, `flow`, `option`, `name`, `device`, `usb device` or
    /// `gpib address`.
    pub fn field(&self) -> &'static str {
        self.field
    }
}
