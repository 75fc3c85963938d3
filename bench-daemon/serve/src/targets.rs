//! Where notices go.

use std::path::PathBuf;

use jiff::civil::Time;
use lettre::message::Mailbox;

/// Where notices go.
#[derive(Debug, Clone, Default)]
pub struct Targets {
    /// Address of a webhook.
    pub webhook: Option<String>,
    /// E-mail.
    pub email: Option<Email>,
    /// Start and end of quiet hours in local time, in which non-urgent notices are stored.
    pub quiet: Option<(Time, Time)>,
}

/// E-mail by SMTP.
#[derive(Debug, Clone)]
pub struct Email {
    /// Host of the mail server.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// Encryption of the connection.
    pub encryption: Encryption,
    /// User, if the server requires one.
    pub user: Option<String>,
    /// File that holds the password.
    pub password_file: Option<PathBuf>,
    /// Sender.
    pub from: Mailbox,
    /// Receivers.
    pub to: Vec<Mailbox>,
}

/// Encryption of a connection to a mail server.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Encryption {
    /// From the first byte.
    Tls,
    /// After a plain greeting.
    Starttls,
    /// None: to a server on this machine only.
    None,
}
