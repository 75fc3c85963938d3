//! Stands in for the spans of the server in a program that is built without the feature `otlp`.

use std::convert::Infallible;

use axum::{
    extract::{FromRequestParts, Request},
    http::{Method, StatusCode, request::Parts},
};

use super::{Server, jobs::Ended, queue::Item};

/// The trace context of the work for a request: always empty.
#[derive(Debug, Clone, Default)]
pub struct Traced(pub Option<String>);

impl<S: Sync> FromRequestParts<S> for Traced {
    type Rejection = Infallible;

    async fn from_request_parts(_: &mut Parts, _: &S) -> Result<Self, Self::Rejection> {
        Ok(Self::default())
    }
}

/// Begins no span.
pub fn begin(_server: &Server, _request: &mut Request) -> Option<Infallible> {
    None
}

/// Returns an empty name.
pub fn name(_method: &Method, _path: &str) -> String {
    String::new()
}

/// There is no span to end.
pub fn answered(span: Infallible, _name: String, _status: StatusCode) {
    match span {}
}

/// Records nothing.
pub fn waited(_server: &Server, _item: &Item) {}

/// Records nothing.
pub fn ended(_server: &Server, _item: &Item, _ended: &Ended) {}
