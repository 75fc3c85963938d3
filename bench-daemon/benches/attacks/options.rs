//! Options of the command.

use std::path::PathBuf;

use super::deed::{Attack, Deed};

/// Number of concurrent attacks: each waits most of the time.
const AT_A_TIME: usize = 16;
const EXPECTED: &str =
    "--program PATH, --only WORDS, --sample N, --jobs N, --resume, --stated, --list or --out FILE";

/// The selected attacks, and how to execute them.
#[derive(Debug, Clone)]
pub(crate) struct Options {
    pub(crate) program: String,
    only: String,
    sample: Option<usize>,
    pub(crate) jobs: usize,
    pub(crate) resumes: bool,
    /// Whether the bench file states the delay of answers.
    pub(crate) stated: bool,
    pub(crate) list: bool,
    pub(crate) out: Option<PathBuf>,
}

impl Options {
    /// Parses the command line.
    ///
    /// # Errors
    /// Fails if an argument is unknown or lacks its value.
    pub(crate) fn read(
        mut words: impl Iterator<Item = String>,
        program: &str,
    ) -> Result<Self, String> {
        let mut options = Self {
            program: program.to_owned(),
            only: String::new(),
            sample: None,
            jobs: AT_A_TIME,
            resumes: false,
            stated: false,
            list: false,
            out: None,
        };
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or(format!("{word}: expected a value"));
            let number = |text: String| {
                text.parse::<usize>()
                    .ok()
                    .filter(|number| *number > 0)
                    .ok_or(format!("{word}: expected a number above 0, found {text:?}"))
            };
            match word.as_str() {
                "--program" => options.program = value()?,
                "--only" => options.only = value()?,
                "--sample" => options.sample = Some(number(value()?)?),
                "--jobs" => options.jobs = number(value()?)?,
                "--resume" => options.resumes = true,
                "--stated" => options.stated = true,
                "--list" => options.list = true,
                "--out" => options.out = Some(value()?.into()),
                "--bench" => {}
                other => return Err(format!("expected {EXPECTED}, found {other:?}")),
            }
        }
        Ok(options)
    }

    /// Returns the undisturbed runs for comparison with the selected attacks, one per job, and the
    /// attacks.
    pub(crate) fn select(&self, product: Vec<Attack>) -> (Vec<Attack>, Vec<Attack>) {
        let (quiet, attacks): (Vec<_>, Vec<_>) = product
            .into_iter()
            .partition(|attack| attack.deed == Deed::Nothing);
        let mut attacks: Vec<Attack> = attacks
            .into_iter()
            .filter(|attack| attack.name().contains(&self.only))
            .collect();
        if let Some(sample) = self.sample.filter(|sample| *sample < attacks.len()) {
            let count = attacks.len();
            attacks = (0..sample).map(|k| attacks[k * count / sample]).collect();
        }
        let mut jobs = Vec::new();
        let quiet = quiet
            .into_iter()
            .filter(|one| {
                let job = one.window.job();
                let wanted = attacks.iter().any(|attack| attack.window.job() == job);
                let first = !jobs.contains(&job);
                jobs.push(job);
                wanted && first
            })
            .collect();
        (quiet, attacks)
    }
}
