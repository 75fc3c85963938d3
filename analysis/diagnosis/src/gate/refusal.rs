//! The diagnosis behind the gate: runs the workflow only on data that the gate accepts.

use super::super::current_filter::Filter;
use super::super::data::{DataSet, Run, RunData};
use super::super::findings::{FindingKind, Inspected};
use super::super::outcome::{
    DIAGNOSIS_SCHEMA, DIAGNOSIS_SCHEMA_VERSION, Diagnosis, NoiseReport, Quality, Verdict,
};
use super::super::{
    BaseModel, DataSetError, DiagnosisOptions, Outcome, diagnose::diagnose_with, guards::Guards,
};
use super::{Check, Reason, gate};
use analysis_fit::fit::PROGRAM;

/// Diagnoses a data set if it passes the gate; otherwise the verdict is [`Verdict::Invalid`].
/// `unreadable` are the runs whose data could not be read.
///
/// # Errors
/// [`DataSetError`] for a set or run that is unusable although it passed the gate.
pub fn diagnose(
    set: &DataSet,
    unreadable: Vec<Reason>,
    model: &BaseModel,
    options: &DiagnosisOptions,
) -> Result<Outcome, DataSetError> {
    let inspected = Inspected::new(set, model);
    let wanted = options.accept.contains(&FindingKind::CurrentFilter);
    let used = inspected.corrected.as_ref().filter(|_| wanted);
    let (used_set, expected) = used.map_or((set, &inspected.expected), |(set, expected)| {
        (set, expected)
    });
    // A record whose current is not known does not count as a repeat of another one, and is left
    // out.
    let unseen = inspected.unseen();
    let mut report = gate(used_set, expected);
    let is_used = |run: &String| !unseen.contains(run);
    report
        .invalid
        .retain(|reason| reason.runs.iter().any(is_used));
    let found = inspected.findings(&report.invalid);
    let accepted: Vec<FindingKind> = used
        .map(|_| FindingKind::CurrentFilter)
        .into_iter()
        .collect();
    let filter_note = wanted.then(|| {
        inspected.expected.filter.as_ref().map_or_else(
            || {
                "current_filter was accepted, but no filter of the logged current was found: the \
                logged current was used"
                    .to_owned()
            },
            Filter::describe,
        )
    });
    let mut seen = used_set.clone();
    seen.runs.retain(|run| is_used(&run.name));
    let is_record = |run: &Run| matches!(run.data, RunData::Time(_));
    let all_unseen = !unseen.is_empty() && !seen.runs.iter().any(is_record);
    let all_unseen = all_unseen.then(|| Reason {
        check: Check::CurrentUnseen,
        text: "the current of every record changes faster than it is logged".to_owned(),
        runs: unseen.clone(),
    });
    let refusing = unreadable.into_iter().chain(report.invalid);
    let reasons: Vec<Reason> = refusing.chain(all_unseen).collect();
    if !reasons.is_empty() {
        let mut diagnosis = refused(set, model, &reasons, report.notes);
        (diagnosis.findings, diagnosis.accepted) = (found, accepted);
        diagnosis.notes.extend(filter_note);
        return Ok(Outcome {
            diagnosis,
            curves: Vec::new(),
            facts: None,
            next_runs: Vec::new(),
        });
    }
    let mut outcome = diagnose_with(&seen, model, options, Guards::default())?;
    (outcome.diagnosis.findings, outcome.diagnosis.accepted) = (found, accepted);
    if !unseen.is_empty() {
        let held_out = set.runs.iter().any(Run::is_held_out);
        let none_left = held_out && !seen.runs.iter().any(Run::is_held_out);
        outcome.diagnosis.notes.push(format!(
            "left out, for their current changes faster than it is logged: {}{}",
            unseen.join(", "),
            if none_left {
                "; no held-out run is left, so that nothing tests the model"
            } else {
                ""
            }
        ));
    }
    outcome.diagnosis.notes.extend(filter_note);
    outcome.diagnosis.notes.extend(report.notes);
    Ok(outcome)
}

fn refused(set: &DataSet, model: &BaseModel, reasons: &[Reason], notes: Vec<String>) -> Diagnosis {
    let sentences: String = reasons.iter().map(|reason| format!(" {reason}.")).collect();
    // Not a number is written as null: nothing was fitted.
    let none = f64::NAN;
    Diagnosis {
        schema: DIAGNOSIS_SCHEMA,
        schema_version: DIAGNOSIS_SCHEMA_VERSION,
        program: PROGRAM,
        data_set: set.name.clone(),
        model: model.name.clone(),
        verdict: Verdict::Invalid,
        summary: format!("The data cannot be used.{sentences}"),
        effects: Vec::new(),
        rivals: Vec::new(),
        blocks: Vec::new(),
        where_after: Vec::new(),
        gap: Vec::new(),
        gap_spectra: Vec::new(),
        next_experiment: None,
        inseparable: Vec::new(),
        findings: Vec::new(),
        accepted: Vec::new(),
        notes,
        quality: Quality {
            base_chi2: none,
            degrees_of_freedom: none,
            base_z: none,
            augmented_chi2: none,
            augmented_z: none,
        },
        noise: NoiseReport {
            from_repeats: false,
            terms: Vec::new(),
        },
        ranking: Vec::new(),
        base: None,
        augmented: None,
        predictive: None,
        shares: Vec::new(),
        given: Vec::new(),
        by_hand: None,
    }
}
