//! The file of an archive: the data folder whose runs are sent, and the store.

use std::{
    fs,
    net::IpAddr,
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

use bench_archive::store::{Bucket, StorePlace};
use jiff::{Span, SpanRelativeTo, Unit};
use serde::Deserialize;

use crate::failure::Failure;

/// Shortest and longest time between the upload of a run and the removal of its captures, s.
const CAPTURES_AFTER_S: RangeInclusive<f64> = 3600.0..=36_500.0 * 86_400.0;

/// The file of an archive.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    data: String,
    store: String,
    site: String,
    endpoint: Option<String>,
    region: Option<String>,
    credentials_file: Option<String>,
    #[serde(default)]
    thin: RawThin,
}

/// Captures that are kept in the store only.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawThin {
    captures_after: Option<String>,
}

/// The settings of an archive, checked.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Settings {
    /// Data folder of a server: it holds `runs`, `analyses` and `jobs`.
    pub(crate) data: PathBuf,
    /// The store.
    pub(crate) place: StorePlace,
    /// Name of this site in the store.
    pub(crate) site: String,
    /// Time from the verified upload of a run to the removal of its captures, s; `None` for never.
    pub(crate) captures_after_s: Option<f64>,
}

/// The file that is being read, for error messages.
struct Source<'a> {
    path: &'a Path,
}

impl Source<'_> {
    fn complain(&self, key: &str, reason: impl std::fmt::Display) -> Failure {
        Failure::Usage(format!("{}: {key}: {reason}", self.path.display()))
    }

    /// Resolves a path of the file against the folder of the file.
    fn resolve(&self, path: &str) -> PathBuf {
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let joined = folder.join(path);
        std::path::absolute(&joined).unwrap_or(joined)
    }
}

impl Settings {
    /// Reads the file of an archive.
    ///
    /// # Errors
    /// The first error, with the file and the key.
    pub(crate) fn load(path: &Path) -> Result<Self, Failure> {
        let complain = |reason: &dyn std::fmt::Display| {
            Failure::Usage(format!("{}: {reason}", path.display()))
        };
        let text = fs::read_to_string(path).map_err(|error| complain(&error))?;
        let raw: Raw = toml::from_str(&text).map_err(|error| {
            let before = error.span().and_then(|span| text.get(..span.start));
            let line = before.unwrap_or_default().matches('\n').count() + 1;
            Failure::Usage(format!("{}:{line}: {}", path.display(), error.message()))
        })?;
        let source = Source { path };
        if raw.site.trim().is_empty() || raw.site.chars().any(char::is_control) {
            let reason = format!("expected the name of a site, found {:?}", raw.site);
            return Err(source.complain("site", reason));
        }
        let data = source.resolve(&raw.data);
        if !data.is_dir() {
            let reason = format!(
                "expected the data folder of a server, found none at {}",
                data.display()
            );
            return Err(source.complain("data", reason));
        }
        Ok(Self {
            data,
            place: store_place(&source, &raw)?,
            captures_after_s: captures_after_s(&source, raw.thin.captures_after.as_deref())?,
            site: raw.site,
        })
    }
}

fn captures_after_s(source: &Source<'_>, text: Option<&str>) -> Result<Option<f64>, Failure> {
    let Some(text) = text else { return Ok(None) };
    let seconds = parse_duration_s(text);
    match seconds.filter(|seconds| CAPTURES_AFTER_S.contains(seconds)) {
        Some(seconds) => Ok(Some(seconds)),
        None => Err(source.complain(
            "thin.captures_after",
            format!("expected 1 h to 36500 d, found {text:?}"),
        )),
    }
}

/// Parses a duration such as `30 d` or `12 h`; returns it in seconds.
pub(crate) fn parse_duration_s(text: &str) -> Option<f64> {
    let span: Span = text.parse().ok()?;
    let days = SpanRelativeTo::days_are_24_hours();
    let seconds = span.total((Unit::Second, days)).ok()?;
    (seconds >= 0.0).then_some(seconds)
}

fn store_place(source: &Source<'_>, raw: &Raw) -> Result<StorePlace, Failure> {
    let store = &raw.store;
    let Some(address) = store.strip_prefix("s3://") else {
        if store.trim().is_empty() || store.contains("://") {
            let reason = format!("expected a folder or s3://BUCKET/PREFIX, found {store:?}");
            return Err(source.complain("store", reason));
        }
        for (key, value) in [
            ("endpoint", &raw.endpoint),
            ("region", &raw.region),
            ("credentials_file", &raw.credentials_file),
        ] {
            if value.is_some() {
                let reason = format!("expected with a store s3://… only, found {store:?}");
                return Err(source.complain(key, reason));
            }
        }
        return Ok(StorePlace::Folder(source.resolve(store)));
    };
    let (name, prefix) = address.split_once('/').unwrap_or((address, ""));
    if name.is_empty() {
        let reason = format!("expected s3://BUCKET/PREFIX, found {store:?}");
        return Err(source.complain("store", reason));
    }
    if let Some(endpoint) = &raw.endpoint
        && !is_safe_endpoint(endpoint)
    {
        let reason = format!(
            "expected an address https://HOST/PATH, or http:// on this machine, found {endpoint:?}"
        );
        return Err(source.complain("endpoint", reason));
    }
    let credentials = raw.credentials_file.as_ref();
    Ok(StorePlace::S3(Bucket {
        name: name.to_owned(),
        prefix: prefix.trim_matches('/').to_owned(),
        endpoint: raw.endpoint.clone(),
        region: raw.region.clone(),
        credentials: credentials.map(|path| source.resolve(path)),
    }))
}

/// Returns whether an address is encrypted or on this machine: requests carry keys.
fn is_safe_endpoint(address: &str) -> bool {
    let (scheme, rest) = address.split_once("://").unwrap_or(("", address));
    let host = rest.split(['/', '?', '#']).next().unwrap_or_default();
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    let is_allowed = scheme == "https" || (scheme == "http" && is_this_machine(name));
    is_allowed && !name.is_empty() && !host.contains('@')
}

fn is_this_machine(name: &str) -> bool {
    let address = name.parse::<IpAddr>();
    name.eq_ignore_ascii_case("localhost") || address.is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_have_units() {
        for (text, seconds) in [("30 d", 2_592_000.0), ("12 h", 43_200.0), ("0 s", 0.0)] {
            assert_eq!(parse_duration_s(text), Some(seconds), "{text}");
        }
        for text in ["", "30", "-1 h", "soon"] {
            assert_eq!(parse_duration_s(text), None, "{text:?}");
        }
    }

    #[test]
    fn keys_leave_the_machine_encrypted_only() {
        for address in [
            "https://s3.lab.example/x",
            "http://127.0.0.1:9000",
            "http://[::1]:9000",
            "http://localhost",
        ] {
            assert!(is_safe_endpoint(address), "{address}");
        }
        for address in [
            "http://192.0.2.1:9000",
            "https://",
            "https://user:word@host",
            "ftp://127.0.0.1",
            "127.0.0.1",
        ] {
            assert!(!is_safe_endpoint(address), "{address}");
        }
    }
}
