//! The server of the benches, over its HTTP API. Calls block and are made on blocking threads.

use std::time::Duration;

use axum::http::{HeaderValue, Method, Request, Response, StatusCode, header};
use serde::de::DeserializeOwned;
use serde_json::Value;
use ureq::tls::{Certificate, PemItem, RootCerts, TlsConfig, parse_pem};

use crate::{
    config::{BenchServerAddress, read, read_private},
    failure::Failure,
    local::Away,
};

/// Header with the name of the person for whom the agent acts.
const PERSON_HEADER: &str = "x-eis-bench-person";
/// Timeout of a call. The server answers from memory or after the check of one experiment.
pub(crate) const PATIENCE: Duration = Duration::from_secs(10);
/// Timeout of a call that only reads memory.
pub(crate) const SHORT_PATIENCE: Duration = Duration::from_secs(3);
/// Maximum size of an answer, bytes.
const MOST_BYTES: u64 = 16 << 20;
/// The server closes a connection that is idle for 10 s.
const IDLE: Duration = Duration::from_secs(5);

/// The server of the benches.
pub(crate) struct BenchServer {
    url: String,
    token: Option<HeaderValue>,
    agent: ureq::Agent,
}

/// A call of the agent itself, with its own token.
pub(crate) struct Call<'a> {
    /// Method.
    pub(crate) method: Method,
    /// Path below `/api/v1`.
    pub(crate) path: &'a str,
    /// The person for whom the agent acts.
    pub(crate) person: Option<&'a str>,
    /// Body.
    pub(crate) body: Option<Value>,
    /// Timeout.
    pub(crate) patience: Duration,
}

impl<'a> Call<'a> {
    /// Creates a call that reads.
    pub(crate) fn get(path: &'a str) -> Self {
        Self {
            method: Method::GET,
            path,
            person: None,
            body: None,
            patience: SHORT_PATIENCE,
        }
    }

    /// Creates a call that acts for a person.
    pub(crate) fn post(path: &'a str, person: &'a str, body: Value) -> Self {
        Self {
            method: Method::POST,
            path,
            person: Some(person),
            body: Some(body),
            patience: PATIENCE,
        }
    }
}

/// Why a call has no result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum CallError {
    /// The server does not answer: whether it has acted is unknown.
    Away(Away),
    /// The server has refused the call.
    Refused(ServerRefusal),
}

/// A refusal of the server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct ServerRefusal {
    /// Its status.
    pub(crate) status: StatusCode,
    /// Its message.
    pub(crate) message: String,
}

impl CallError {
    /// Converts a refusal to an error of an unusable server.
    pub(crate) fn into_away(self) -> Away {
        match self {
            Self::Away(away) => away,
            Self::Refused(ServerRefusal { status, message }) => {
                let status = status.as_u16();
                Away(format!(
                    "the server of the bench answers {status}: {message}"
                ))
            }
        }
    }
}

impl BenchServer {
    /// Prepares the client without making a call.
    ///
    /// # Errors
    /// The file with the token or the certificates is invalid.
    pub(crate) fn open(address: &BenchServerAddress) -> Result<Self, Failure> {
        let token = address.token_file.as_deref().map(|path| {
            let text = read_private(path)?;
            let value = HeaderValue::from_str(&format!("Bearer {}", text.trim()));
            value.map_err(|_| {
                let path = path.display();
                Failure::Usage(format!("{path}: expected one line with a token"))
            })
        });
        let mut config = ureq::Agent::config_builder()
            .max_redirects(0)
            .http_status_as_error(false)
            .max_idle_age(IDLE);
        if let Some(ca) = &address.ca {
            let roots = roots(&read(ca)?)
                .map_err(|reason| Failure::Usage(format!("{}: {reason}", ca.display())))?;
            config = config.tls_config(TlsConfig::builder().root_certs(roots).build());
        }
        Ok(Self {
            url: address.url.clone(),
            token: token.transpose()?,
            agent: config.build().into(),
        })
    }

    /// Its address.
    pub(crate) fn url(&self) -> &str {
        &self.url
    }

    /// Makes a call.
    ///
    /// # Errors
    /// The server does not answer or refuses the call.
    pub(crate) fn call<T: DeserializeOwned>(&self, call: Call<'_>) -> Result<T, CallError> {
        let (path, patience) = (call.path, call.patience);
        let odd = |error: &dyn std::fmt::Display| {
            let reason = format!("expected an answer of this version from {path}: {error}");
            CallError::Away(Away(reason))
        };
        let request = self.request(call).map_err(|error| odd(&error))?;
        let answer = self.send(request, patience);
        let answer = answer.map_err(CallError::Away)?;
        let (status, body) = (answer.status(), answer.into_body());
        if !status.is_success() {
            let problem: Value = serde_json::from_slice(&body).unwrap_or_default();
            let message = problem["message"].as_str().map(str::to_owned);
            let message = message.unwrap_or_else(|| status.to_string());
            return Err(CallError::Refused(ServerRefusal { status, message }));
        }
        let body = if body.is_empty() {
            b"null"
        } else {
            body.as_slice()
        };
        serde_json::from_slice(body).map_err(|error| odd(&error))
    }

    fn request(&self, call: Call<'_>) -> Result<Request<Vec<u8>>, axum::http::Error> {
        let uri = format!("{}/api/v1{}", self.url, call.path);
        let mut request = Request::builder().method(call.method).uri(uri);
        if let Some(token) = &self.token {
            request = request.header(header::AUTHORIZATION, token);
        }
        if let Some(person) = call.person {
            let plain: String = person.chars().filter(|c| !c.is_control()).collect();
            request = request.header(PERSON_HEADER, HeaderValue::from_bytes(plain.as_bytes())?);
        }
        let Some(body) = call.body else {
            return request.body(Vec::new());
        };
        request
            .header(header::CONTENT_TYPE, "application/json")
            .body(body.to_string().into_bytes())
    }

    /// Sends a request to an address of this server.
    ///
    /// # Errors
    /// The server does not answer.
    pub(crate) fn send(
        &self,
        request: Request<Vec<u8>>,
        patience: Duration,
    ) -> Result<Response<Vec<u8>>, Away> {
        let away = |error: &dyn std::fmt::Display| {
            let url = &self.url;
            Away(format!(
                "the server of the bench does not answer: {url}: {error}"
            ))
        };
        let (parts, body) = request.into_parts();
        let answer = if body.is_empty() && parts.method != Method::POST {
            let request = self.agent.configure_request(Request::from_parts(parts, ()));
            self.agent
                .run(request.timeout_global(Some(patience)).build())
        } else {
            let request = self
                .agent
                .configure_request(Request::from_parts(parts, body));
            self.agent
                .run(request.timeout_global(Some(patience)).build())
        };
        let (parts, body) = answer.map_err(|error| away(&error))?.into_parts();
        let mut bytes = Vec::new();
        let mut body = body.into_with_config().limit(MOST_BYTES).reader();
        std::io::Read::read_to_end(&mut body, &mut bytes).map_err(|error| away(&error))?;
        Ok(Response::from_parts(parts, bytes))
    }
}

fn roots(pem: &str) -> Result<RootCerts, String> {
    let items = parse_pem(pem.as_bytes()).collect::<Result<Vec<_>, _>>();
    let items = items.map_err(|error| format!("expected certificates, PEM: {error}"))?;
    let certificates = items.into_iter().filter_map(|item| match item {
        PemItem::Certificate(certificate) => Some(certificate),
        _ => None,
    });
    let certificates: Vec<Certificate<'static>> = certificates.collect();
    if certificates.is_empty() {
        return Err("expected at least one certificate, PEM, found none".to_owned());
    }
    Ok(RootCerts::new_with_certs(&certificates))
}
