//! The connection to the broker: buckets with compare-and-swap, subjects of orders, and a stream
//! of events. Reconnects automatically.

use std::{sync::Arc, time::Duration};

use async_nats::{
    Client, ConnectOptions, Event, Subscriber,
    connection::State,
    jetstream::{self, Context, kv, stream},
};
use bytes::Bytes;
use instruments_link::clock::{Clock, TimeMode};
use serde::{Serialize, de::DeserializeOwned};
use tokio::sync::watch;

use crate::{
    error::FleetError,
    job::{Job, Place},
    settings::{Credentials, FleetSettings},
    standing::Standing,
};

/// Timeout of an answer of the broker. On one machine it arrives within milliseconds.
const ANSWER: Duration = Duration::from_secs(3);
/// Interval of pings on an idle connection; after two pings without a reply it counts as cut.
const PING: Duration = Duration::from_secs(4);
/// Maximum interval between two attempts to connect.
const RETRY: Duration = Duration::from_secs(2);
/// Maximum age and size of stored events and telemetry, so that they never fill the disk of a
/// broker.
const EVENTS_AGE: Duration = Duration::from_secs(30 * 86_400);
const TELEMETRY_AGE: Duration = Duration::from_secs(86_400);
const STREAM_BYTES: i64 = 64 << 20;

/// One connection of this process to the broker of a fleet.
pub(crate) struct Link {
    /// Jobs by name.
    pub(crate) jobs: Bucket,
    /// Texts of experiments by SHA-256.
    pub(crate) texts: Bucket,
    /// Reports of the benches.
    pub(crate) benches: Bucket,
    /// Standing orders to benches.
    pub(crate) orders: Bucket,
    /// Real time.
    pub(crate) clock: Clock,
    client: Client,
    context: Context,
    prefix: String,
    connected: watch::Receiver<u64>,
}

/// A bucket of records.
#[derive(Clone)]
pub(crate) struct Bucket(kv::Store);

/// A record with its revision.
#[derive(Debug, Clone)]
pub(crate) struct Stored<T> {
    /// Its revision, which increases with each change.
    pub(crate) revision: u64,
    /// The record.
    pub(crate) value: T,
    /// When the broker stored it by the broker's calendar, s since 1970. For display only.
    pub(crate) broker_unix_s: f64,
}

/// Definite outcome of a compare-and-swap. If the broker does not answer, there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Swap {
    /// The record was written with this revision.
    Written(u64),
    /// The revision differs from the expected one: nothing was written.
    Lost,
}

/// Name of a bucket or stream.
fn bucket(fleet: &str, what: &str) -> String {
    format!("eis-{fleet}-{what}")
}

impl Link {
    /// Connects; waits until the broker is reachable.
    ///
    /// # Errors
    /// The credentials or certificates cannot be used, or the broker refuses them.
    pub(crate) async fn open(settings: &FleetSettings) -> Result<Arc<Self>, FleetError> {
        let (connections, connected) = watch::channel(0);
        let client = options(settings, connections)?
            .connect(settings.server.as_str())
            .await
            .map_err(|error| FleetError::unreachable(&error))?;
        let mut context = jetstream::new(client.clone());
        context.set_timeout(ANSWER);
        let clock = Clock::start(TimeMode::Real);
        let named = |what| bucket(&settings.fleet, what);
        let link = Self {
            jobs: Bucket::open(&context, named("jobs")).await?,
            texts: Bucket::open(&context, named("texts")).await?,
            benches: Bucket::open(&context, named("benches")).await?,
            orders: Bucket::open(&context, named("orders")).await?,
            clock,
            client,
            prefix: format!("eis.{}", settings.fleet),
            connected,
            context,
        };
        for (what, age) in [("event", EVENTS_AGE), ("telemetry", TELEMETRY_AGE)] {
            link.open_stream(named(what), what, age).await?;
        }
        Ok(Arc::new(link))
    }

    async fn open_stream(&self, name: String, what: &str, age: Duration) -> Result<(), FleetError> {
        if self.context.get_stream(&name).await.is_ok() {
            return Ok(());
        }
        let config = stream::Config {
            name,
            subjects: vec![format!("{}.{what}.>", self.prefix)],
            max_age: age,
            max_bytes: STREAM_BYTES,
            ..Default::default()
        };
        let made = self.context.create_stream(config).await;
        made.map(drop)
            .map_err(|error| FleetError::unreachable(&error))
    }

    /// Returns whether the broker was reachable at the last contact.
    pub(crate) fn is_connected(&self) -> bool {
        self.client.connection_state() == State::Connected
    }

    /// Returns a counter of the connections.
    pub(crate) fn connections(&self) -> watch::Receiver<u64> {
        self.connected.clone()
    }

    /// Publishes an event, or telemetry of a bench. It may be lost while the broker is unreachable;
    /// data that must not be lost are stored in the records.
    pub(crate) async fn publish(&self, what: &str, place: &Place, value: &impl Serialize) {
        let Ok(text) = serde_json::to_vec(value) else {
            return;
        };
        if !self.is_connected() {
            return;
        }
        let subject = format!("{}.{what}.{}", self.prefix, place.key());
        // Do not wait for the answer of the stream.
        if let Err(error) = self.context.publish(subject, text.into()).await {
            tracing::debug!("an event is lost: {error}");
        }
    }

    /// Subscribes to queries and stops for a bench.
    ///
    /// # Errors
    /// The connection was closed.
    pub(crate) async fn listen(&self, place: &Place) -> Result<Subscriber, FleetError> {
        let subject = self.order_subject(place);
        let heard = self.client.subscribe(subject).await;
        heard.map_err(|error| FleetError::unreachable(&error))
    }

    /// Queries a bench and waits for its reply; returns `None` if it does not reply in time.
    pub(crate) async fn ask<T: DeserializeOwned>(
        &self,
        place: &Place,
        question: &impl Serialize,
        patience: Duration,
    ) -> Option<T> {
        // A query during a cut would be sent once the broker is back, however old it is.
        if !self.is_connected() {
            return None;
        }
        let text = serde_json::to_vec(question).ok()?;
        let request = async_nats::Request::new()
            .payload(text.into())
            .timeout(Some(patience));
        let subject = self.order_subject(place);
        let answer = self.client.send_request(subject, request).await.ok()?;
        serde_json::from_slice(&answer.payload).ok()
    }

    /// Answers a query.
    pub(crate) async fn answer(&self, question: &async_nats::Message, value: &impl Serialize) {
        let Some(reply) = question.reply.clone() else {
            return;
        };
        let Ok(text) = serde_json::to_vec(value) else {
            return;
        };
        if let Err(error) = self.client.publish(reply, text.into()).await {
            tracing::debug!("an answer is lost: {error}");
        }
        if let Err(error) = self.client.flush().await {
            tracing::debug!("an answer may be lost: {error}");
        }
    }

    fn order_subject(&self, place: &Place) -> String {
        format!("{}.order.{}", self.prefix, place.key())
    }

    /// Returns a job by its name.
    ///
    /// # Errors
    /// The broker does not answer, or a record cannot be parsed.
    pub(crate) async fn job(&self, job: &str) -> Result<Option<Stored<Job>>, FleetError> {
        self.jobs.get(job).await
    }

    /// Returns the standing orders of a bench; revision 0 if there are none.
    ///
    /// # Errors
    /// As [`Self::job`].
    pub(crate) async fn standing(&self, place: &Place) -> Result<Stored<Standing>, FleetError> {
        let found = self.orders.get(&place.key()).await?;
        Ok(found.unwrap_or(Stored {
            revision: 0,
            value: Standing::default(),
            broker_unix_s: 0.0,
        }))
    }

    /// Writes a record and retries until the outcome is known. This may take until the broker is
    /// back.
    ///
    /// A write whose reply was lost may have happened, or may still happen. In that case the
    /// write is sent again. It is refused if the first one succeeded, and `mine` recognises that
    /// record.
    pub(crate) async fn swap_surely<T: Serialize + DeserializeOwned>(
        &self,
        write: Write<'_, T>,
        mine: impl Fn(&T) -> bool,
    ) -> Swap {
        let Write {
            bucket,
            key,
            value,
            revision,
        } = write;
        loop {
            match bucket.swap(key, value, revision).await {
                Ok(Swap::Written(revision)) => return Swap::Written(revision),
                Ok(Swap::Lost) => match bucket.get(key).await {
                    Ok(Some(found)) if mine(&found.value) => return Swap::Written(found.revision),
                    Ok(_) => return Swap::Lost,
                    Err(error) => tracing::debug!("{key}: {error}"),
                },
                Err(error) => tracing::debug!("{key}: {error}"),
            }
            self.clock.sleep_s(0.3).await;
        }
    }
}

/// A compare-and-swap.
pub(crate) struct Write<'a, T> {
    /// The bucket.
    pub(crate) bucket: &'a Bucket,
    /// Key of the record.
    pub(crate) key: &'a str,
    /// The record.
    pub(crate) value: &'a T,
    /// Expected revision; 0 if there must be no record.
    pub(crate) revision: u64,
}

fn options(
    settings: &FleetSettings,
    connected: watch::Sender<u64>,
) -> Result<ConnectOptions, FleetError> {
    let connected = Arc::new(connected);
    let mut options = ConnectOptions::new()
        .name(format!("eis-bench {}", settings.site))
        .retry_on_initial_connect()
        .connection_timeout(ANSWER)
        .request_timeout(Some(ANSWER))
        .ping_interval(PING)
        .reconnect_delay_callback(|attempts| {
            let doubled = Duration::from_millis(50 << attempts.min(6));
            doubled.min(RETRY)
        })
        .event_callback(move |event| {
            if matches!(event, Event::Connected) {
                connected.send_modify(|number| *number += 1);
            }
            tracing::debug!("fleet: {event}");
            std::future::ready(())
        });
    if let Some(ca) = &settings.ca {
        options = options.add_root_certificates(ca.clone());
    }
    if settings.server.starts_with("tls://") {
        options = options.require_tls(true);
    }
    Ok(match settings.credentials.clone() {
        None => options,
        Some(Credentials::Token(token)) => options.token(token),
        Some(Credentials::User { user, password }) => options.user_and_password(user, password),
        Some(Credentials::Nkey(seed)) => options.nkey(seed),
        Some(Credentials::File(text)) => options
            .credentials(&text)
            .map_err(|error| FleetError::Settings(format!("credentials: {error}")))?,
    })
}

impl Bucket {
    /// Opens a bucket and creates it if it does not exist.
    async fn open(context: &Context, name: String) -> Result<Self, FleetError> {
        if let Ok(store) = context.get_key_value(&name).await {
            return Ok(Self(store));
        }
        // A bucket is a stream of this form. The call that creates buckets first queries the
        // account, in a form that servers before 2.10 do not answer.
        let config = stream::Config {
            name: format!("KV_{name}"),
            subjects: vec![format!("$KV.{name}.>")],
            max_messages_per_subject: 1,
            discard: stream::DiscardPolicy::New,
            storage: stream::StorageType::File,
            allow_rollup: true,
            deny_delete: true,
            allow_direct: true,
            ..Default::default()
        };
        let made = context.create_stream(config).await;
        made.map_err(|error| FleetError::unreachable(&error))?;
        let opened = context.get_key_value(&name).await;
        opened
            .map(Self)
            .map_err(|error| FleetError::unreachable(&error))
    }

    /// Returns a record if there is one.
    ///
    /// # Errors
    /// The broker does not answer, or a record cannot be parsed.
    pub(crate) async fn get<T: DeserializeOwned>(
        &self,
        key: &str,
    ) -> Result<Option<Stored<T>>, FleetError> {
        let entry = self.0.entry(key).await;
        let entry = entry.map_err(|error| FleetError::unreachable(&error))?;
        let put = entry.filter(|entry| entry.operation == kv::Operation::Put);
        put.map(|entry| stored(&entry)).transpose()
    }

    /// Writes a record if its revision is still the expected one; 0 means that there is none.
    ///
    /// # Errors
    /// The broker does not answer: it is then unknown whether the record was written.
    pub(crate) async fn swap<T: Serialize>(
        &self,
        key: &str,
        value: &T,
        revision: u64,
    ) -> Result<Swap, FleetError> {
        let text = serde_json::to_vec(value).map_err(|error| FleetError::Record {
            key: key.to_owned(),
            reason: error.to_string(),
        })?;
        if revision == 0 {
            // A deleted record leaves a marker with a revision.
            return match self.0.create(key, Bytes::from(text)).await {
                Ok(revision) => Ok(Swap::Written(revision)),
                Err(error) if error.kind() == kv::CreateErrorKind::AlreadyExists => Ok(Swap::Lost),
                Err(error) => Err(FleetError::unreachable(&error)),
            };
        }
        match self.0.update(key, Bytes::from(text), revision).await {
            Ok(revision) => Ok(Swap::Written(revision)),
            Err(error) => lost(&error),
        }
    }

    /// Removes a record with this revision.
    ///
    /// # Errors
    /// As [`Self::swap`].
    pub(crate) async fn forget(&self, key: &str, revision: u64) -> Result<Swap, FleetError> {
        match self.0.purge_expect_revision(key, Some(revision)).await {
            Ok(()) => Ok(Swap::Written(revision)),
            Err(error) => lost(&error),
        }
    }

    /// Watches a bucket: delivers every present record, and then each change.
    ///
    /// # Errors
    /// As [`Self::swap`].
    pub(crate) async fn watch(&self) -> Result<kv::Watch, FleetError> {
        let watch = self.0.watch_with_history(">").await;
        watch.map_err(|error| FleetError::unreachable(&error))
    }

    /// Returns the greatest revision that was written; 0 if no record exists.
    ///
    /// # Errors
    /// As [`Self::swap`].
    pub(crate) async fn latest(&self) -> Result<u64, FleetError> {
        let info = self.0.stream.get_info().await;
        let state = info.map_err(|error| FleetError::unreachable(&error))?.state;
        Ok(if state.messages == 0 {
            0
        } else {
            state.last_sequence
        })
    }
}

/// Classifies a failed write: refused, or of unknown outcome.
fn lost(error: &kv::UpdateError) -> Result<Swap, FleetError> {
    match error.kind() {
        kv::UpdateErrorKind::WrongLastRevision => Ok(Swap::Lost),
        _ => Err(FleetError::unreachable(error)),
    }
}

/// Parses the record of an entry.
///
/// # Errors
/// The record cannot be parsed.
pub(crate) fn stored<T: DeserializeOwned>(entry: &kv::Entry) -> Result<Stored<T>, FleetError> {
    let value = serde_json::from_slice(&entry.value).map_err(|error| FleetError::Record {
        key: entry.key.clone(),
        reason: error.to_string(),
    })?;
    Ok(Stored {
        revision: entry.revision,
        value,
        broker_unix_s: entry.created.unix_timestamp_nanos() as f64 / 1.0e9,
    })
}

/// Returns a random number in hexadecimal, for unique names.
///
/// # Errors
/// The operating system has no random numbers.
pub(crate) fn random() -> Result<String, FleetError> {
    let mut bytes = [0_u8; 8];
    getrandom::fill(&mut bytes).map_err(|error| FleetError::File(error.to_string()))?;
    Ok(hex(&bytes))
}

/// Formats bytes in hexadecimal.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
