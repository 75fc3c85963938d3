//! Checks whether the last report of the doctor is still valid for a bench: same file, same
//! instruments, unaltered, complete, and not too old.

use instruments::{clock, exchange::fold};

use super::{Outcome, Report};
use bench_core::{bench::Identified, safety::state::State};
use bench_plan::{config, support::hash};

/// Its name in the state folder.
pub const REPORT: &str = "doctor.json";

/// Returns why no report is valid for the bench, or `None` if one is valid, or if the bench is
/// simulated in this process.
pub fn standing(config: &config::Bench, text: &str, identities: &[Identified]) -> Option<String> {
    let state = State::of(config).ok().flatten()?;
    let path = state.path(REPORT);
    // A resumed run reports the same, regardless of the spelling of the path.
    let path = path.canonicalize().unwrap_or(path);
    let Ok(found) = std::fs::read_to_string(&path) else {
        return Some("`eis-bench doctor` has never looked at this bench".to_owned());
    };
    let Ok(report) = serde_json::from_str::<Report>(&found) else {
        return Some(format!(
            "{}: expected a report of the doctor, found another text",
            path.display()
        ));
    };
    judge(&report, config, text, identities)
}

fn judge(
    report: &Report,
    config: &config::Bench,
    text: &str,
    identities: &[Identified],
) -> Option<String> {
    let of = format!("the doctor's report of {}", report.date);
    if !report.is_whole() {
        return Some(format!("{of} was changed after it was written"));
    }
    match report.outcome {
        Outcome::Passed => {}
        Outcome::Incomplete => {
            return Some(format!(
                "{of} is incomplete: nothing was proven with a fixture in the jig"
            ));
        }
        Outcome::Failed => return Some(format!("{of} found the bench wanting")),
    }
    if report.config_sha256 != hash::sha256(text) {
        return Some(format!("the bench file has changed since {of}"));
    }
    for identified in identities {
        let known = report
            .instruments
            .iter()
            .find(|instrument| instrument.role == identified.role);
        if known.is_none_or(|known| fold(&known.identity) != fold(&identified.identity.raw)) {
            return Some(format!(
                "another {} answers than in {of}: {}",
                identified.role, identified.identity.raw
            ));
        }
    }
    let age_s = clock::unix_time_s() - report.unix_s;
    let valid_s = config.doctor.valid_for_s;
    (age_s > valid_s.0).then(|| {
        format!(
            "{of} is {:.0} days old, and valid for {:.0}",
            age_s / 86_400.0,
            valid_s.value() / 86_400.0
        )
    })
}
