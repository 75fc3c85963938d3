//! Writes objects to the store and reads them back, verified by their hashes.

use std::{
    fs::File,
    io::{Read, Write},
    path::Path as FilePath,
};

use futures_util::StreamExt;
use object_store::{
    Error, GetResult, MultipartUpload, ObjectStoreExt, PutMode, PutOptions, PutPayload, path::Path,
};

use crate::{
    ArchiveError, Store,
    hash::{Hashed, Hasher},
};

/// Size of a part of a large file: the minimum of S3, to limit the memory.
const PART: usize = 5 * 1024 * 1024;
/// Maximum number of attempts to send bytes that read back differently.
const SENDINGS: usize = 3;
/// Number of reads of an object before its bytes count as wrong.
const READINGS: usize = 2;

impl Store {
    pub(crate) fn failed(
        &self,
        path: &str,
        action: &'static str,
    ) -> impl FnOnce(Error) -> ArchiveError {
        let (store, path) = (self.name.clone(), path.to_owned());
        move |source| ArchiveError::Store {
            store,
            path,
            action,
            source: Box::new(source),
        }
    }

    pub(crate) fn content(&self, path: &str, why: String) -> ArchiveError {
        ArchiveError::Content {
            store: self.name.clone(),
            path: path.to_owned(),
            why,
        }
    }

    fn at(&self, path: &str) -> Result<Path, ArchiveError> {
        let wrong = |error| self.content(path, format!("expected the name of an object: {error}"));
        Path::parse(path).map_err(wrong)
    }

    /// Returns an object, or `None` if it does not exist.
    async fn get(&self, path: &str) -> Result<Option<GetResult>, ArchiveError> {
        match self.objects.get(&self.at(path)?).await {
            Ok(object) => Ok(Some(object)),
            Err(Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(self.failed(path, "read it")(error)),
        }
    }

    /// Returns all bytes of a small object, or `None` if it does not exist.
    pub(crate) async fn bytes(&self, path: &str) -> Result<Option<Vec<u8>>, ArchiveError> {
        let Some(object) = self.get(path).await? else {
            return Ok(None);
        };
        let bytes = object.bytes().await;
        Ok(Some(bytes.map_err(self.failed(path, "read it"))?.to_vec()))
    }

    /// Creates a small object if it does not exist; returns the bytes of the object in the store.
    pub(crate) async fn create(
        &self,
        path: &str,
        bytes: Vec<u8>,
    ) -> Result<Option<Vec<u8>>, ArchiveError> {
        let options = PutOptions {
            mode: PutMode::Create,
            ..PutOptions::default()
        };
        let (at, payload) = (self.at(path)?, PutPayload::from(bytes.clone()));
        match self.objects.put_opts(&at, payload, options).await {
            Ok(_) => {}
            Err(Error::AlreadyExists { .. }) => {}
            Err(error) => return Err(self.failed(path, "make it")(error)),
        }
        // If the reply was lost, it is unknown whether this request created the object; the
        // stored content decides.
        match self.bytes(path).await? {
            Some(found) if found == bytes => Ok(None),
            Some(found) => Ok(Some(found)),
            None => Err(self.content(path, "expected it, found none after it was made".to_owned())),
        }
    }

    /// Removes an object; succeeds if it does not exist.
    pub(crate) async fn remove(&self, path: &str) -> Result<(), ArchiveError> {
        match self.objects.delete(&self.at(path)?).await {
            Ok(()) | Err(Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(self.failed(path, "remove it")(error)),
        }
    }

    /// Reads an object back and returns its hash and size, or `None` if it does not exist.
    pub(crate) async fn hashed(&self, path: &str) -> Result<Option<Hashed>, ArchiveError> {
        self.read(path, &mut std::io::sink(), FilePath::new(path))
            .await
    }

    /// Returns hash and size of an object if two reads agree, otherwise `None`.
    pub(crate) async fn hashed_twice(&self, path: &str) -> Result<Option<Hashed>, ArchiveError> {
        let first = self.hashed(path).await?;
        let second = match first {
            Some(_) => self.hashed(path).await?,
            None => None,
        };
        Ok(first.filter(|first| Some(first) == second.as_ref()))
    }

    /// Reads an object into a writer; `target` is its path for messages.
    async fn read(
        &self,
        path: &str,
        into: &mut (dyn Write + Send),
        target: &FilePath,
    ) -> Result<Option<Hashed>, ArchiveError> {
        let Some(object) = self.get(path).await? else {
            return Ok(None);
        };
        let (mut hasher, mut stream) = (Hasher::default(), object.into_stream());
        while let Some(piece) = stream.next().await {
            let piece = piece.map_err(self.failed(path, "read it"))?;
            hasher.take(&piece);
            into.write_all(&piece)
                .map_err(ArchiveError::io(target, "write the file"))?;
        }
        Ok(Some(hasher.end()))
    }

    /// Checks whether an object exists with these bytes. Queries its size first, and then reads
    /// it back.
    async fn has(&self, path: &str, wanted: &Hashed) -> Result<bool, ArchiveError> {
        match self.objects.head(&self.at(path)?).await {
            Ok(meta) if meta.size == wanted.bytes => self.comes_back(path, wanted).await,
            Ok(_) | Err(Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(self.failed(path, "ask for its size")(error)),
        }
    }

    /// Checks whether an object reads back with these bytes. Reads it a second time after a
    /// mismatch, because the transfer may be at fault.
    async fn comes_back(&self, path: &str, wanted: &Hashed) -> Result<bool, ArchiveError> {
        for _ in 0..READINGS {
            if self.hashed(path).await?.as_ref() == Some(wanted) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Ensures that an object exists with these bytes: sends it if necessary, and reads it back.
    /// Returns the number of bytes sent.
    pub(crate) async fn ensure(
        &self,
        path: &str,
        wanted: &Hashed,
        source: Source<'_>,
    ) -> Result<u64, ArchiveError> {
        if self.has(path, wanted).await? {
            return Ok(0);
        }
        let mut sent_bytes = 0;
        for _ in 0..SENDINGS {
            self.send(path, wanted, source).await?;
            sent_bytes += wanted.bytes;
            if self.comes_back(path, wanted).await? {
                return Ok(sent_bytes);
            }
        }
        Err(self.wrong(path, wanted).await)
    }

    /// Checks that an object exists with these bytes.
    ///
    /// # Errors
    /// [`ArchiveError::Bytes`] if it does not.
    pub(crate) async fn check(&self, path: &str, wanted: &Hashed) -> Result<(), ArchiveError> {
        match self.has(path, wanted).await? {
            true => Ok(()),
            false => Err(self.wrong(path, wanted).await),
        }
    }

    async fn wrong(&self, path: &str, wanted: &Hashed) -> ArchiveError {
        let found = self.hashed(path).await.ok().flatten();
        ArchiveError::Bytes {
            store: self.name.clone(),
            path: path.to_owned(),
            expected: wanted.words(),
            found: found.map_or_else(|| "none".to_owned(), |found| found.words()),
        }
    }

    /// Reads an object into a new file, which is kept only if its bytes match.
    pub(crate) async fn fetch(
        &self,
        path: &str,
        wanted: &Hashed,
        file: &FilePath,
    ) -> Result<(), ArchiveError> {
        for _ in 0..READINGS {
            let failed = || ArchiveError::io(file, "write the file");
            let mut made = File::create(file).map_err(failed())?;
            let read = self.read(path, &mut made, file).await?;
            if read.as_ref() == Some(wanted) {
                return made.sync_all().map_err(failed());
            }
        }
        let _ = std::fs::remove_file(file);
        Err(self.wrong(path, wanted).await)
    }

    async fn send(
        &self,
        path: &str,
        wanted: &Hashed,
        source: Source<'_>,
    ) -> Result<(), ArchiveError> {
        match source {
            Source::Memory(bytes) => self.put(path, bytes.to_vec()).await,
            Source::File(file) if wanted.bytes > PART as u64 => {
                self.send_parts(path, wanted, file).await
            }
            Source::File(file) => {
                let bytes = std::fs::read(file).map_err(ArchiveError::io(file, "read the file"))?;
                same(&Hashed::of(&bytes), wanted, file)?;
                self.put(path, bytes).await
            }
        }
    }

    async fn put(&self, path: &str, bytes: Vec<u8>) -> Result<(), ArchiveError> {
        let at = self.at(path)?;
        let put = self.objects.put(&at, PutPayload::from(bytes)).await;
        put.map(drop).map_err(self.failed(path, "write it"))
    }

    /// Sends a large file in parts, with one part in memory.
    async fn send_parts(
        &self,
        path: &str,
        wanted: &Hashed,
        file: &FilePath,
    ) -> Result<(), ArchiveError> {
        let mut upload = self
            .objects
            .put_multipart(&self.at(path)?)
            .await
            .map_err(self.failed(path, "begin to write it"))?;
        let sent = self.parts(path, upload.as_mut(), file).await;
        let sent = sent.and_then(|sent| same(&sent, wanted, file));
        if let Err(error) = sent {
            // Parts that remain do not form an object; the lifecycle rules of the bucket remove
            // them.
            let _ = upload.abort().await;
            return Err(error);
        }
        let completed = upload.complete().await;
        completed.map(drop).map_err(self.failed(path, "write it"))
    }

    async fn parts(
        &self,
        path: &str,
        upload: &mut dyn MultipartUpload,
        file: &FilePath,
    ) -> Result<Hashed, ArchiveError> {
        let failed = || ArchiveError::io(file, "read the file");
        let mut reader = File::open(file).map_err(failed())?;
        let mut hasher = Hasher::default();
        loop {
            let mut part = Vec::with_capacity(PART);
            let taken = (&mut reader).take(PART as u64).read_to_end(&mut part);
            if taken.map_err(failed())? == 0 {
                return Ok(hasher.end());
            }
            hasher.take(&part);
            let put = upload.put_part(PutPayload::from(part));
            put.await.map_err(self.failed(path, "write a part"))?;
        }
    }
}

/// Source of the bytes of an object.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Source<'a> {
    /// A file.
    File(&'a FilePath),
    /// Bytes in memory.
    Memory(&'a [u8]),
}

/// Checks whether a file still has the bytes that were hashed.
fn same(found: &Hashed, wanted: &Hashed, file: &FilePath) -> Result<(), ArchiveError> {
    match found == wanted {
        true => Ok(()),
        false => Err(ArchiveError::Changed {
            file: file.to_path_buf(),
        }),
    }
}
