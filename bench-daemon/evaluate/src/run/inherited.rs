//! The correction of an earlier run, as the folder of a run without controls keeps it.

use std::path::Path;

use analysis::{calibration::Correction, run_folder::CORRECTION};
use bench_core::safety::failure::Failure;
use bench_plan::config::Experiment;

/// Returns the correction of an earlier run if a run has no controls of its own.
///
/// # Errors
/// A file that cannot be read.
pub(super) fn inherited_correction(
    experiment: &Experiment,
    folder: &Path,
) -> Result<Option<Correction>, Failure> {
    let path = folder.join(CORRECTION);
    if experiment.fixture_check.is_some() || !path.exists() {
        return Ok(None);
    }
    let failed = |error: String| Failure::Usage(format!("{}: {error}", path.display()));
    let text = std::fs::read_to_string(&path).map_err(|error| failed(error.to_string()))?;
    serde_json::from_str(&text)
        .map(Some)
        .map_err(|error| failed(error.to_string()))
}

/// As [`inherited_correction`], for a run that is resumed. `inherits` states whether the run began after
/// others.
///
/// # Errors
/// A file that cannot be read, or that is missing although the run began after others.
pub(super) fn inherited_by(
    experiment: &Experiment,
    folder: &Path,
    inherits: bool,
) -> Result<Option<Correction>, Failure> {
    let found = inherited_correction(experiment, folder)?;
    if found.is_none() && inherits && experiment.fixture_check.is_none() {
        return Err(Failure::Usage(format!(
            "{}: expected the correction of the earlier run, which this run uses, found no file; begin \
            the run anew in another folder",
            folder.join(CORRECTION).display()
        )));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::config::load_experiment;

    #[test]
    fn a_resumed_run_takes_the_correction_of_its_folder_or_is_refused() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/map.toml");
        let with_controls = load_experiment(&file, None).unwrap();
        let experiment = Experiment {
            fixture_check: None,
            ..with_controls.clone()
        };
        let folder = tempfile::tempdir().unwrap();
        let of =
            |experiment: &Experiment, inherits| inherited_by(experiment, folder.path(), inherits);
        let refused = of(&experiment, true).unwrap_err().to_string();
        assert!(
            refused.contains("correction.json: expected the correction of the earlier run"),
            "{refused}"
        );
        assert!(of(&experiment, false).unwrap().is_none());
        let written =
            serde_json::to_string(&Correction::none(experiment.bench.wiring.shunt)).unwrap();
        std::fs::write(folder.path().join(CORRECTION), written).unwrap();
        assert!(of(&experiment, true).unwrap().is_some());
        assert!(of(&with_controls, true).unwrap().is_none());
    }
}
