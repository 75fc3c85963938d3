//! `eis-bench mock --replay`: serves a recorded conversation on a port, and accepts no deviation
//! from it.
//!
//! The replies are those of the record. For a long block, the record contains length and hash
//! only; its bytes are searched in the captures of the same run folder. A page that was discarded
//! and never became a capture is unavailable, and the replay ends there.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use analysis::{
    dataset::read_capture,
    run_folder::{self, CAPTURES, MANIFEST},
};
use instruments::{
    chiller,
    clock::{Clock, TimeMode},
    generator,
    instrument::{Model, by_key},
    jig::{self, Jig},
    load, logger, scope,
    scpi::decode::Terminator,
    supply, supply4q,
    transcript::{BlockRecord, Payload, Record, Transcript},
};

use crate::command::mock::MockArgs;
use bench_core::safety::failure::Failure;
use bench_evaluate::run::StopSignals;
use bench_plan::{
    mocks::{self, Outcome, Replay},
    support::terminal::say,
};

/// Interval between two checks of the progress of the conversation, s.
const LOOK_S: f64 = 0.1;

/// Reads a transcript as a device that replies according to it, and the expected outcome of the
/// conversation; `model` is used if the file does not name the instrument's model.
///
/// # Errors
/// A file that cannot be read or is not a transcript; an unknown model; several conversations in
/// one file.
pub fn load(path: &Path, model: Option<&str>) -> Result<(Replay, Outcome), Failure> {
    let complain = |reason: String| Failure::Usage(format!("{}: {reason}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|error| complain(error.to_string()))?;
    let mut transcript = Transcript::parse(&text).map_err(|error| complain(error.to_string()))?;
    let mut links: Vec<&str> = transcript
        .records
        .iter()
        .map(|record| record.link.as_str())
        .collect();
    links.sort_unstable();
    links.dedup();
    let link = match links.as_slice() {
        [link] => (*link).to_owned(),
        [] => return Err(complain("expected a conversation, found none".to_owned())),
        several => {
            return Err(complain(format!(
                "expected the conversation of one instrument, found those of {}",
                several.join(", ")
            )));
        }
    };
    let key = model
        .map(str::to_owned)
        .or_else(|| model_name(path))
        .ok_or_else(|| {
            complain(format!(
                "expected a {MANIFEST} beside the folder of the transcript that names the model, \
                found none: give --model KEY"
            ))
        })?;
    let terminator = terminator(&key)
        .ok_or_else(|| complain(format!("expected the key of a known model, found {key:?}")))?;
    if let Some(captures) = beside(path, CAPTURES) {
        restore(&mut transcript, &captures);
    }
    Ok(Replay::new(&transcript, &link, terminator))
}

/// Serves a transcript until the client has reached its end, has disconnected, or the server is
/// stopped.
///
/// # Errors
/// As [`load()`]; a port that is in use; the first difference.
pub(super) fn serve_record(path: &Path, args: &MockArgs) -> Result<(), Failure> {
    let (device, outcome) = load(path, args.model.as_deref())?;
    let expected = device.messages().count();
    Clock::runtime(TimeMode::Real)?.block_on(async {
        let mut stop = StopSignals::install()?;
        let clock = Clock::start(TimeMode::Real);
        let served = mocks::serve_tcp(Box::new(device), args.listen.as_str(), clock.clone()).await;
        let (bound, _task) =
            served.map_err(|error| Failure::Usage(format!("--listen {}: {error}", args.listen)))?;
        if args.json {
            say!(
                "{}",
                serde_json::json!({
                    "replay": path.display().to_string(),
                    "address": format!("tcp://{bound}"),
                    "messages": expected,
                })
            );
        } else {
            say!(
                "{} with {expected} messages at tcp://{bound}; ends with the last of them, or at \
            the first difference",
                path.display()
            );
        }
        let followed = async {
            while outcome.divergence().is_none() && outcome.followed() < expected {
                clock.sleep_s(LOOK_S).await;
            }
            // The last answer is on its way.
            clock.sleep_s(LOOK_S).await;
        };
        tokio::select! {
            () = followed => {}
            () = stop.requested() => {}
        }
        match outcome.divergence() {
            Some(divergence) => Err(Failure::Usage(format!("{}: {divergence}", path.display()))),
            None => {
                say!(
                    "{} of {expected} messages were as recorded",
                    outcome.followed()
                );
                Ok(())
            }
        }
    })
}

/// A folder of the run that a transcript belongs to.
fn beside(path: &Path, name: &str) -> Option<PathBuf> {
    let folder = path.parent()?.parent()?.join(name);
    folder.exists().then_some(folder)
}

/// The model by the file's name, or by the manifest of its run.
fn model_name(path: &Path) -> Option<String> {
    let stem = path.file_stem()?.to_str()?;
    if terminator(stem).is_some() {
        return Some(stem.to_owned());
    }
    let instruments = run_folder::instruments(path.parent()?.parent()?)?;
    let of_role = instruments
        .as_array()?
        .iter()
        .find(|instrument| instrument.get("role").and_then(|role| role.as_str()) == Some(stem))?;
    Some(of_role.get("model")?.as_str()?.to_owned())
}

/// Terminator of messages to a model.
fn terminator(key: &str) -> Option<Terminator> {
    fn of<D: Model + ?Sized>(dialects: &[&'static D], key: &str) -> Option<Terminator> {
        by_key(dialects, key).map(|dialect| dialect.profile().terminator)
    }
    of(supply4q::DIALECTS, key)
        .or_else(|| of(generator::DIALECTS, key))
        .or_else(|| of(scope::DIALECTS, key))
        .or_else(|| of(load::DIALECTS, key))
        .or_else(|| of(supply::DIALECTS, key))
        .or_else(|| of(chiller::DIALECTS, key))
        .or_else(|| of(logger::DIALECTS, key))
        .or_else(|| (key == jig::MOCK_JIG).then(|| Jig::profile().terminator))
}

/// Restores the bytes of long blocks from captures: signed little-endian words, or these relative
/// to the least code.
fn restore(transcript: &mut Transcript, captures: &Path) {
    let missing = |record: &Record| match &record.payload {
        Payload::Block(block) if block.bytes.is_none() => Some(block.len),
        _ => None,
    };
    // A memory that takes more than one page comes in pages of this length, the last one shorter.
    let Some(page) = transcript
        .records
        .iter()
        .filter_map(missing)
        .max()
        .filter(|page| *page > 0)
    else {
        return;
    };
    let inside = |folder: &Path| {
        std::fs::read_dir(folder)
            .into_iter()
            .flatten()
            .filter_map(Result::ok)
            .map(|entry| entry.path())
    };
    let mut known: HashMap<(usize, u64), Vec<u8>> = HashMap::new();
    // A folder for each fixture, sweep or trace.
    for capture in inside(captures)
        .flat_map(|folder| inside(&folder))
        .filter_map(|file| read_capture(&file).ok())
    {
        for codes in &capture.codes {
            for offset in [0, i16::MIN] {
                let bytes: Vec<u8> = codes
                    .iter()
                    .flat_map(|code| (code ^ offset).to_le_bytes())
                    .collect();
                for bytes in bytes.chunks(page) {
                    known.insert(
                        (bytes.len(), BlockRecord::new("", bytes).fnv1a64),
                        bytes.to_vec(),
                    );
                }
            }
        }
    }
    for record in &mut transcript.records {
        if let Payload::Block(block) = &mut record.payload
            && block.bytes.is_none()
        {
            block.bytes = known.get(&(block.len, block.fnv1a64)).cloned();
        }
    }
}
