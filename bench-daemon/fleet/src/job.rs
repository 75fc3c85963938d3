//! Jobs: work that waits for a bench, and its states.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::local::{Capabilities, End};

/// State of a job in the records of the broker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// It waits for a bench.
    Queued,
    /// A bench prepares it. Nothing has begun: the job returns to the queue automatically if the
    /// bench dies.
    Claimed,
    /// Its run may have begun. Only its bench continues it, or a person puts it back.
    Started,
    /// Its run is complete.
    Done,
    /// Its run was aborted or did not begin.
    Failed,
    /// It was cancelled before a bench took it.
    Cancelled,
}

impl JobState {
    /// All states.
    pub const ALL: [Self; 6] = [
        Self::Queued,
        Self::Claimed,
        Self::Started,
        Self::Done,
        Self::Failed,
        Self::Cancelled,
    ];

    /// Returns its index in [`Self::ALL`].
    pub(crate) fn index(self) -> usize {
        self as usize
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Claimed => "claimed",
            Self::Started => "started",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Returns whether it has ended.
    pub fn is_over(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }
}

/// Requirements of a job on its bench.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Needs {
    /// Greatest current that the bench must be able to drive, A.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub current_a: Option<f64>,
    /// Temperature that the bench must be able to hold, °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
    /// Fixture that the jig must be able to take, such as `cell` or `short`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fixture: Option<String>,
    /// This bench and no other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bench: Option<String>,
    /// A bench of this site.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub site: Option<String>,
    /// A simulated bench, or a real one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub simulated: Option<bool>,
}

impl Needs {
    /// Describes the first requirement that a bench does not meet.
    pub fn unmet(&self, place: &Place, can: &Capabilities) -> Option<String> {
        let name = |wanted: &Option<String>, found: &str, what: &str| {
            let wanted = wanted.as_deref().filter(|wanted| *wanted != found)?;
            Some(format!("{what}: expected {wanted}, found {found}"))
        };
        name(&self.site, &place.site, "site")
            .or_else(|| name(&self.bench, &place.bench, "bench"))
            .or_else(|| self.unmet_current(can))
            .or_else(|| self.unmet_temperature(can))
            .or_else(|| self.unmet_fixture(can))
            .or_else(|| self.unmet_kind(can))
    }

    fn unmet_current(&self, can: &Capabilities) -> Option<String> {
        let wanted = self.current_a?;
        (can.current_a < wanted).then(|| {
            let found = can.current_a;
            format!("current: expected at least {wanted} A, found {found} A")
        })
    }

    fn unmet_temperature(&self, can: &Capabilities) -> Option<String> {
        let wanted = self.temperature_degc?;
        match can.temperature_degc {
            Some([least, greatest]) if (least..=greatest).contains(&wanted) => None,
            Some([least, greatest]) => Some(format!(
                "temperature: expected {wanted} °C, found {least} to {greatest} °C"
            )),
            None => Some(format!("temperature: expected {wanted} °C, found no bath")),
        }
    }

    fn unmet_fixture(&self, can: &Capabilities) -> Option<String> {
        let wanted = self.fixture.as_ref()?;
        (!can.fixtures.contains(wanted)).then(|| {
            let found = can.fixtures.join(", ");
            format!("fixture: expected {wanted}, found {found}")
        })
    }

    fn unmet_kind(&self, can: &Capabilities) -> Option<String> {
        let kind = |simulated| if simulated { "simulated" } else { "real" };
        let wanted = self.simulated.filter(|wanted| *wanted != can.simulated)?;
        Some(format!(
            "expected a {} bench, found a {} one",
            kind(wanted),
            kind(can.simulated)
        ))
    }
}

/// A bench of the fleet.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Place {
    /// Its site.
    pub site: String,
    /// Its name there.
    pub bench: String,
}

impl Place {
    /// A bench of a site.
    pub fn new(site: &str, bench: &str) -> Self {
        Self {
            site: site.to_owned(),
            bench: bench.to_owned(),
        }
    }

    /// The bench of a key.
    pub(crate) fn of_key(key: &str) -> Option<Self> {
        let (site, bench) = key.split_once('.')?;
        Some(Self::new(site, bench))
    }

    /// Its key in the buckets of the broker.
    pub fn key(&self) -> String {
        format!("{}.{}", self.site, self.bench)
    }
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.site, self.bench)
    }
}

/// Maximum length of the name of a job, an experiment, a site or a bench, characters.
pub const LONGEST_NAME: usize = 60;

/// Checks whether a text consists of letters, digits, `-` and `_`, so that it cannot leave a
/// folder and is a valid key of the broker.
pub fn is_plain(text: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    (1..=LONGEST_NAME).contains(&text.len()) && text.chars().all(plain)
}

/// The process that has a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// Its bench.
    #[serde(flatten)]
    pub place: Place,
    /// Number of the process.
    pub nonce: String,
}

/// Work for one bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Its name in the fleet; never used again.
    pub job: String,
    /// Name of the experiment.
    pub name: String,
    /// Its state.
    pub state: JobState,
    /// Its requirements.
    #[serde(default)]
    pub needs: Needs,
    /// SHA-256 of the text of the experiment, which is stored separately.
    pub text_sha256: String,
    /// Seed that replaces the seed of the experiment.
    #[serde(default)]
    pub seed: Option<u64>,
    /// Who submitted it, where, and when.
    pub asked: Asked,
    /// Label of the campaign that it belongs to.
    #[serde(default)]
    pub campaign: Option<String>,
    /// Label of the cell that it is for.
    #[serde(default)]
    pub cell: Option<String>,
    /// Number of times that it was put into the queue, from 1. Runs of earlier turns do not count.
    pub turn: u32,
    /// The bench that has it, or had it last.
    #[serde(default)]
    pub holder: Option<Holder>,
    /// SHA-256 of the run's `SHA256SUMS`, once it is done: a catalogue names the run by it.
    #[serde(default)]
    pub content_sha256: Option<String>,
    /// Latest remark on it, in words.
    #[serde(default)]
    pub words: String,
    /// Benches whose check has refused it, with the reasons.
    #[serde(default)]
    pub refused: BTreeMap<String, String>,
}

/// The origin of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Asked {
    /// Name of the token or account.
    pub by: String,
    /// Submission time by their machine's calendar, s since 1970. Shown only, never compared.
    pub unix_s: f64,
}

impl Job {
    /// Returns the name of its run, which is derived from the job and its turn.
    pub fn run_name(&self) -> String {
        match self.turn {
            1 => format!("{}-{}", self.name, self.job),
            turn => format!("{}-{}-t{turn}", self.name, self.job),
        }
    }

    /// Returns its run, once there may be one.
    pub fn run(&self) -> Option<String> {
        let begun = matches!(
            self.state,
            JobState::Started | JobState::Done | JobState::Failed
        );
        (begun && self.holder.is_some()).then(|| self.run_name())
    }

    /// Returns whether a bench has it.
    pub fn is_at(&self, place: &Place) -> bool {
        let has = matches!(self.state, JobState::Claimed | JobState::Started);
        has && self
            .holder
            .as_ref()
            .is_some_and(|holder| holder.place == *place)
    }

    /// Describes why a bench does not take it, or returns `None` if the bench may.
    pub fn unfit(&self, place: &Place, can: &Capabilities) -> Option<String> {
        let refused = self.refused.get(&place.to_string());
        // Both become file names at the bench.
        let is_plain = is_plain(&self.job) && is_plain(&self.name);
        let odd = (!is_plain).then(|| "its name is not one that a client gives".to_owned());
        odd.or_else(|| self.needs.unmet(place, can))
            .or_else(|| refused.map(|why| format!("its check refused it: {why}")))
    }

    /// Returns the job as claimed by a process.
    #[must_use]
    pub fn claimed(&self, by: &Holder) -> Self {
        Self {
            state: JobState::Claimed,
            holder: Some(by.clone()),
            words: String::new(),
            ..self.clone()
        }
    }

    /// Returns the job as started: its run is about to begin.
    #[must_use]
    pub fn started(&self) -> Self {
        Self {
            state: JobState::Started,
            ..self.clone()
        }
    }

    /// Returns the job as queued again before anything has begun.
    #[must_use]
    pub fn returned(&self, words: String) -> Self {
        Self {
            state: JobState::Queued,
            holder: None,
            words,
            ..self.clone()
        }
    }

    /// Returns the job as queued again by a person: any earlier run belongs to another turn.
    #[must_use]
    pub fn released(&self, words: String) -> Self {
        Self {
            turn: self.turn + 1,
            ..self.returned(words)
        }
    }

    /// Returns the job as ended.
    #[must_use]
    pub fn over(&self, end: &End) -> Self {
        Self {
            state: if end.finished {
                JobState::Done
            } else {
                JobState::Failed
            },
            content_sha256: end.content_sha256.clone(),
            words: end.words.clone(),
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn can() -> Capabilities {
        Capabilities {
            current_a: 20.0,
            temperature_degc: Some([-10.0, 60.0]),
            fixtures: vec!["cell".to_owned(), "shunt".to_owned()],
            simulated: true,
        }
    }

    #[test]
    fn a_name_that_leads_out_of_a_folder_is_taken_by_no_bench() {
        for name in ["..", "../x", "a/b", "", "a.b", "a b"] {
            assert!(!is_plain(name), "{name}");
        }
        assert!(is_plain("20261128T070102123-5f0c5f0c5f0c5f0c-0000001") && is_plain("demo_2"));
    }

    #[test]
    fn a_need_that_is_not_met_is_named_with_what_was_found() {
        let place = Place::new("north", "b1");
        let unmet = |needs: &str| {
            let needs: Needs = serde_json::from_str(needs).unwrap();
            needs.unmet(&place, &can()).unwrap_or_default()
        };
        for fits in [
            "{}",
            r#"{"current_a": 20}"#,
            r#"{"temperature_c": -10, "fixture": "cell", "simulated": true}"#,
            r#"{"site": "north", "bench": "b1"}"#,
        ] {
            assert_eq!(unmet(fits), "", "{fits}");
        }
        assert_eq!(
            unmet(r#"{"current_a": 21}"#),
            "current: expected at least 21 A, found 20 A"
        );
        assert_eq!(
            unmet(r#"{"temperature_c": 61}"#),
            "temperature: expected 61 °C, found -10 to 60 °C"
        );
        assert_eq!(
            unmet(r#"{"fixture": "short"}"#),
            "fixture: expected short, found cell, shunt"
        );
        assert_eq!(
            unmet(r#"{"simulated": false}"#),
            "expected a real bench, found a simulated one"
        );
        assert_eq!(
            unmet(r#"{"site": "south", "bench": "b1"}"#),
            "site: expected south, found north"
        );
        let bathless = Capabilities {
            temperature_degc: None,
            ..can()
        };
        let needs: Needs = serde_json::from_str(r#"{"temperature_c": 25}"#).unwrap();
        assert_eq!(
            needs.unmet(&place, &bathless).unwrap(),
            "temperature: expected 25 °C, found no bath"
        );
        assert!(serde_json::from_str::<Needs>(r#"{"amps": 1}"#).is_err());
    }
}
