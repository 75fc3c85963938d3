//! A store that fails: from an operation on, by chance, or with wrong bytes.

use std::{
    fmt,
    sync::{Arc, Mutex},
};

use futures_util::{StreamExt, stream::BoxStream};
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload,
    ObjectMeta, ObjectStore, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
    UploadPart, memory::InMemory, path::Path,
};

/// Operations that are to fail.
#[derive(Debug, Default)]
pub(crate) struct Faults(Mutex<Plan>);

#[derive(Debug, Default)]
struct Plan {
    /// Operations so far.
    operations: u64,
    /// Number of the operation from which on all fail.
    dead_from: Option<u64>,
    /// Share of the operations that fail, in 1/256, and the state of the dice.
    share: u64,
    dice: u64,
    /// Objects whose name contains this come back with a wrong byte.
    wrong: Option<String>,
    /// Called at each operation, with its number.
    at: Option<Action>,
}

struct Action(Box<dyn Fn(u64) + Send>);

impl fmt::Debug for Action {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Action")
    }
}

/// Effect of an operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    Fine,
    /// It is not done.
    Refused,
    /// It is done, and its answer is lost; a reading ends early.
    Lost,
    /// A reading gives a wrong byte.
    Wrong,
}

impl Faults {
    pub(crate) fn operations(&self) -> u64 {
        self.0.lock().unwrap().operations
    }

    /// Makes all operations fail after this number of them.
    pub(crate) fn die_after(&self, operations: u64) {
        let mut plan = self.0.lock().unwrap();
        (plan.operations, plan.dead_from) = (0, Some(operations));
    }

    /// Operations fail by chance.
    pub(crate) fn fail_by_chance(&self, share: u64, seed: u64) {
        let mut plan = self.0.lock().unwrap();
        (plan.share, plan.dice) = (share, seed);
    }

    /// Objects come back with a wrong byte.
    pub(crate) fn give_wrong(&self, name: &str) {
        self.0.lock().unwrap().wrong = Some(name.to_owned());
    }

    /// Calls an action at each operation.
    pub(crate) fn at(&self, action: impl Fn(u64) + Send + 'static) {
        self.0.lock().unwrap().at = Some(Action(Box::new(action)));
    }

    /// Nothing fails any more.
    pub(crate) fn mend(&self) {
        *self.0.lock().unwrap() = Plan::default();
    }

    fn fate(&self, path: &Path) -> Fate {
        let mut plan = self.0.lock().unwrap();
        plan.operations += 1;
        let number = plan.operations;
        if let Some(Action(action)) = &plan.at {
            action(number);
        }
        if plan.dead_from.is_some_and(|from| number > from) {
            return Fate::Refused;
        }
        if plan
            .wrong
            .as_ref()
            .is_some_and(|name| path.as_ref().contains(name.as_str()))
        {
            return Fate::Wrong;
        }
        // Numbers of Knuth's MMIX.
        plan.dice = plan
            .dice
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let thrown = plan.dice >> 33;
        match (thrown >> 8) % 256 < plan.share {
            false => Fate::Fine,
            true => [Fate::Refused, Fate::Lost, Fate::Wrong][(thrown % 3) as usize],
        }
    }
}

fn broken<T>() -> Result<T> {
    Err(Error::Generic {
        store: "faulty",
        source: "503 Slow Down".into(),
    })
}

/// A store in memory with faults.
#[derive(Debug)]
pub(crate) struct Faulty {
    pub(crate) inner: Arc<InMemory>,
    pub(crate) faults: Arc<Faults>,
}

impl fmt::Display for Faulty {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("faulty")
    }
}

#[async_trait::async_trait]
impl ObjectStore for Faulty {
    async fn put_opts(
        &self,
        location: &Path,
        payload: PutPayload,
        opts: PutOptions,
    ) -> Result<PutResult> {
        match self.faults.fate(location) {
            Fate::Fine | Fate::Wrong => self.inner.put_opts(location, payload, opts).await,
            Fate::Refused => broken(),
            Fate::Lost => {
                self.inner.put_opts(location, payload, opts).await?;
                broken()
            }
        }
    }

    async fn put_multipart_opts(
        &self,
        location: &Path,
        opts: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        if self.faults.fate(location) != Fate::Fine {
            return broken();
        }
        Ok(Box::new(FaultyUpload {
            inner: self.inner.put_multipart_opts(location, opts).await?,
            faults: self.faults.clone(),
            location: location.clone(),
        }))
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        let fate = self.faults.fate(location);
        if fate == Fate::Refused {
            return broken();
        }
        let head = options.head;
        let found = self.inner.get_opts(location, options).await?;
        if head || fate == Fate::Fine {
            return Ok(found);
        }
        let (meta, range, attributes) = (
            found.meta.clone(),
            found.range.clone(),
            found.attributes.clone(),
        );
        let mut bytes = found.bytes().await?.to_vec();
        let end: Vec<Result<bytes::Bytes>> = match fate {
            Fate::Lost => {
                bytes.truncate(bytes.len() / 2);
                vec![Ok(bytes.into()), broken()]
            }
            _ => {
                if let Some(byte) = bytes.last_mut() {
                    *byte ^= 1;
                }
                vec![Ok(bytes.into())]
            }
        };
        Ok(GetResult {
            payload: GetResultPayload::Stream(futures_util::stream::iter(end).boxed()),
            meta,
            range,
            attributes,
            extensions: Default::default(),
        })
    }

    fn delete_stream(
        &self,
        locations: BoxStream<'static, Result<Path>>,
    ) -> BoxStream<'static, Result<Path>> {
        let faults = self.faults.clone();
        let judged = locations.map(move |location| {
            let location = location?;
            match faults.fate(&location) {
                Fate::Fine => Ok(location),
                _ => broken(),
            }
        });
        self.inner.delete_stream(judged.boxed())
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.inner.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.inner.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.inner.copy_opts(from, to, options).await
    }
}

#[derive(Debug)]
struct FaultyUpload {
    inner: Box<dyn MultipartUpload>,
    faults: Arc<Faults>,
    location: Path,
}

#[async_trait::async_trait]
impl MultipartUpload for FaultyUpload {
    fn put_part(&mut self, data: PutPayload) -> UploadPart {
        match self.faults.fate(&self.location) {
            Fate::Fine => self.inner.put_part(data),
            _ => Box::pin(async { broken() }),
        }
    }

    async fn complete(&mut self) -> Result<PutResult> {
        match self.faults.fate(&self.location) {
            Fate::Fine => self.inner.complete().await,
            Fate::Lost => {
                self.inner.complete().await?;
                broken()
            }
            _ => broken(),
        }
    }

    async fn abort(&mut self) -> Result<()> {
        self.inner.abort().await
    }
}
