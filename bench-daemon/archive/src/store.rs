//! The store: a folder, or a bucket of an S3-compatible server.

use std::{
    collections::BTreeMap, fs, os::unix::fs::MetadataExt, path::PathBuf, sync::Arc, time::Duration,
};

use object_store::{
    BackoffConfig, ClientOptions, ObjectStore, RetryConfig, aws::AmazonS3Builder,
    local::LocalFileSystem, path::Path, prefix::PrefixStore,
};

use crate::{
    ArchiveError,
    layout::{STORE_FILE, STORE_FORMAT, STORE_VERSION, StoreHead},
};

/// Timeout of one request. A part of a file needs it at 350 kbit/s.
const REQUEST: Duration = Duration::from_secs(120);
/// Timeout of connecting.
const CONNECT: Duration = Duration::from_secs(10);
/// Maximum time in which a request is retried automatically; after it, the whole run is tried
/// again.
const REPEATED: Duration = Duration::from_secs(60);
/// Repetitions of a request.
const REPEATS: usize = 4;
/// Pauses between them, the first and the longest.
const PAUSES: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(5)];

/// Location of a store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StorePlace {
    /// A folder.
    Folder(PathBuf),
    /// A bucket.
    S3(Bucket),
}

/// A bucket of an S3-compatible server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bucket {
    /// Its name.
    pub name: String,
    /// Beginning of all names in it; empty for none.
    pub prefix: String,
    /// The server; `None` for AWS in the region.
    pub endpoint: Option<String>,
    /// The region; `None` for that of the environment.
    pub region: Option<String>,
    /// File with the keys; `None` for those of the environment.
    pub credentials: Option<PathBuf>,
}

impl StorePlace {
    /// Name in receipts and messages.
    pub fn name(&self) -> String {
        match self {
            Self::Folder(folder) => folder.display().to_string(),
            Self::S3(bucket) => {
                let address = format!("s3://{}/{}", bucket.name, bucket.prefix);
                let address = address.trim_end_matches('/');
                match &bucket.endpoint {
                    Some(endpoint) => format!("{address} at {endpoint}"),
                    None => address.to_owned(),
                }
            }
        }
    }
}

/// An open store.
#[derive(Debug, Clone)]
pub struct Store {
    pub(crate) objects: Arc<dyn ObjectStore>,
    pub(crate) name: String,
}

impl Store {
    /// Opens a store without a request to a server.
    ///
    /// # Errors
    /// The folder cannot be created, or the keys are missing or readable for other accounts.
    pub fn open(place: &StorePlace) -> Result<Self, ArchiveError> {
        let objects: Arc<dyn ObjectStore> = match place {
            StorePlace::Folder(folder) => Arc::new(local(folder)?),
            StorePlace::S3(bucket) => remote(bucket)?,
        };
        Ok(Self::of(objects, place.name()))
    }

    /// Creates a store from its parts.
    pub fn of(objects: Arc<dyn ObjectStore>, name: String) -> Self {
        Self { objects, name }
    }

    /// Name in receipts and messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Ensures that the store was written by this program in a known version; initialises an empty
    /// store.
    ///
    /// # Errors
    /// The store has a newer version or is not a store.
    pub async fn begin(&self) -> Result<(), ArchiveError> {
        let own = serde_json::to_vec(&StoreHead::own()).unwrap_or_default();
        let found = match self.bytes(STORE_FILE).await? {
            Some(found) => found,
            None => match self.create(STORE_FILE, own).await? {
                None => return Ok(()),
                Some(found) => found,
            },
        };
        let head: Option<StoreHead> = serde_json::from_slice(&found).ok();
        match head {
            Some(head) if head == StoreHead::own() => Ok(()),
            _ => Err(ArchiveError::Content {
                store: self.name.clone(),
                path: STORE_FILE.to_owned(),
                why: format!(
                    "expected the format {STORE_FORMAT:?} of version {STORE_VERSION}, found {:?}",
                    String::from_utf8_lossy(&found)
                ),
            }),
        }
    }
}

fn local(folder: &std::path::Path) -> Result<LocalFileSystem, ArchiveError> {
    fs::create_dir_all(folder).map_err(ArchiveError::io(folder, "make the folder"))?;
    let local = LocalFileSystem::new_with_prefix(folder).map_err(|source| ArchiveError::Store {
        store: folder.display().to_string(),
        path: String::new(),
        action: "open the folder",
        source: Box::new(source),
    })?;
    Ok(local.with_fsync(true).with_automatic_cleanup(true))
}

fn remote(bucket: &Bucket) -> Result<Arc<dyn ObjectStore>, ArchiveError> {
    // The client uses the cryptography provider of the process; a second installation has no
    // effect.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let keys = Keys::of(bucket)?;
    let client = ClientOptions::new()
        .with_timeout(REQUEST)
        .with_connect_timeout(CONNECT)
        .with_allow_http(true);
    let [init_backoff, max_backoff] = PAUSES;
    let mut builder = AmazonS3Builder::new()
        .with_bucket_name(&bucket.name)
        .with_region(keys.region)
        .with_access_key_id(keys.id)
        .with_secret_access_key(keys.secret)
        .with_client_options(client)
        .with_retry(RetryConfig {
            backoff: BackoffConfig {
                init_backoff,
                max_backoff,
                ..BackoffConfig::default()
            },
            max_retries: REPEATS,
            retry_timeout: REPEATED,
        });
    if let Some(token) = keys.token {
        builder = builder.with_token(token);
    }
    if let Some(endpoint) = &bucket.endpoint {
        builder = builder.with_endpoint(endpoint);
    }
    let wrong = |source: object_store::Error| ArchiveError::Setting {
        field: "store",
        why: source.to_string(),
    };
    let objects = builder.build().map_err(wrong)?;
    if bucket.prefix.is_empty() {
        return Ok(Arc::new(objects));
    }
    let prefix = Path::parse(&bucket.prefix).map_err(|error| ArchiveError::Setting {
        field: "store",
        why: format!("expected s3://BUCKET/PREFIX: {error}"),
    })?;
    Ok(Arc::new(PrefixStore::new(objects, prefix)))
}

/// Keys of a bucket.
struct Keys {
    id: String,
    secret: String,
    token: Option<String>,
    region: String,
}

impl Keys {
    /// Returns the keys from the file of a bucket, otherwise those of the environment.
    fn of(bucket: &Bucket) -> Result<Self, ArchiveError> {
        let from_file = match &bucket.credentials {
            Some(path) => Some(entries(path)?),
            None => None,
        };
        let environment = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
        let key = |name: &str| match &from_file {
            Some(entries) => entries.get(name).cloned(),
            None => environment(&name.to_uppercase()),
        };
        let needed = |name: &str| {
            key(name).ok_or_else(|| ArchiveError::Setting {
                field: "credentials_file",
                why: match &bucket.credentials {
                    Some(path) => format!("expected {name} in {}, found none", path.display()),
                    None => format!(
                        "expected a file with keys, or {} in the environment, found neither",
                        name.to_uppercase()
                    ),
                },
            })
        };
        let region = bucket.region.clone().or_else(|| environment("AWS_REGION"));
        let region = region.or_else(|| environment("AWS_DEFAULT_REGION"));
        Ok(Self {
            id: needed("aws_access_key_id")?,
            secret: needed("aws_secret_access_key")?,
            token: key("aws_session_token"),
            // Servers other than AWS accept any region.
            region: region.unwrap_or_else(|| "us-east-1".to_owned()),
        })
    }
}

/// Reads lines `name = value` of a file that only its owner may read.
fn entries(path: &std::path::Path) -> Result<BTreeMap<String, String>, ArchiveError> {
    let failed = || ArchiveError::io(path, "read the keys of the archive");
    let mode = fs::metadata(path).map_err(failed())?.mode() & 0o777;
    if mode & 0o077 != 0 {
        return Err(ArchiveError::Setting {
            field: "credentials_file",
            why: format!(
                "expected {} with mode 0600, found {mode:04o}",
                path.display()
            ),
        });
    }
    let text = fs::read_to_string(path).map_err(failed())?;
    let entry = |line: &str| {
        let (name, value) = line.split_once('=')?;
        Some((name.trim().to_lowercase(), value.trim().to_owned()))
    };
    Ok(text.lines().filter_map(entry).collect())
}
