//! Continues investigations: diagnoses all runs so far, appends the recommended experiment to the
//! queue, and repeats this by the rule of `eis-bench investigate`.
//!
//! It does nothing that a user could not do at the page. A diagnosis is an ordinary analysis, and
//! an experiment passes the checks of any submission. Each step is written to the record before
//! it takes effect, so that a restarted server continues from there. A stop, a hold or a latch of
//! the bench ends an investigation; it never restarts automatically.

use std::{f64::consts::FRAC_2_PI, sync::Arc};

use instruments::{clock, fixture::Fixture, units::Coulombs};

use super::{
    Server,
    analyses::{Analysis, AnalysisError, AnalysisKind, Options, Recommended, Request, State},
    audit::By,
    find,
    investigations::{
        FollowUp, Investigation, InvestigationRequest, InvestigationState, InvestigationStep,
    },
    jobs::{self, Ended},
    live::StopReport,
    queue::{Kind, Wanted},
    submission::{ExperimentRequest, Submission},
    token::Scope,
    watch::Watch,
};
use bench_evaluate::investigate::closed_loop::{
    Budget, End, MOST_AGAIN, MOST_RUNS, most_played, settled,
};
use bench_plan::{
    plan::{Plan, Purpose, Step},
    procedure,
    support::confined_path,
};

/// Maximum number of active investigations.
const MOST_GOING: usize = 20;

/// Why an investigation ends.
struct Ending {
    end: End,
    why: String,
}

impl Ending {
    fn of(end: End, why: impl Into<String>) -> Self {
        Self {
            end,
            why: why.into(),
        }
    }
}

/// Continues all investigations until the server ends. Only events trigger progress: a timer would
/// not survive the end of the runtime.
pub async fn work(server: Arc<Server>) {
    let mut wake = server.hub.wake();
    while !server.hub.closed() {
        look(&server);
        if wake.changed().await.is_err() {
            return;
        }
    }
}

fn look(server: &Server) {
    let investigations = &server.analyses.investigations;
    for id in investigations.going() {
        // What an ending server ends with it is asked for again by the next one.
        if server.analyses.is_ending() {
            return;
        }
        let _turn = investigations.turn();
        let going = investigations.find(&id).filter(|one| one.ended.is_none());
        if let Some(one) = going {
            advance(server, &one);
        }
    }
}

/// Advances an investigation as far as possible now.
fn advance(server: &Server, before: &Investigation) {
    let was_left = server.analyses.investigations.was_left(&before.id);
    let mut one = before.clone();
    if let Err(Ending { end, why }) = next(server, &mut one, was_left) {
        if server.analyses.is_ending() {
            return;
        }
        take_out(server, &one);
        one = one.closed(end, &why);
    }
    if one != *before {
        put(server, &one);
    }
}

/// Saves progress. If it cannot be written, the investigation ends, because it would repeat the
/// step.
fn put(server: &Server, one: &Investigation) {
    let investigations = &server.analyses.investigations;
    if let Err(error) = investigations.put(&server.hub, one) {
        tracing::error!("{}: {error}", one.id);
        let why = format!("its record cannot be written: {error}");
        investigations.show(&server.hub, &one.clone().closed(End::Failed, &why));
    }
}

fn next(server: &Server, one: &mut Investigation, was_left: bool) -> Result<(), Ending> {
    match one.state {
        InvestigationState::Diagnosing => {
            free(server, &one.bench)?;
            diagnosed(server, one, was_left)
        }
        InvestigationState::WaitingForBench | InvestigationState::Measuring => {
            measured(server, one)
        }
        InvestigationState::Ended => Ok(()),
    }
}

/// Returns why no run may begin on a bench, or `None` if it is free for the queue.
fn held(server: &Server, bench: &str) -> Option<String> {
    let stops = server.stops().get(bench).cloned();
    let stopped = stops
        .filter(|stop| !stop.over)
        .as_ref()
        .map(StopReport::held);
    let live = server.live().get(bench).cloned();
    let trip = live.and_then(|live| live.trip);
    let latched = trip.map(|trip| format!("latched: {}", trip.cause));
    let held = server.queue().held(bench).map(|why| format!("held: {why}"));
    stopped.or(latched).or(held)
}

fn free(server: &Server, bench: &str) -> Result<(), Ending> {
    match held(server, bench) {
        Some(why) => Err(Ending::of(
            End::Stopped,
            format!("the bench {bench} is {why}"),
        )),
        None => Ok(()),
    }
}

// ---- the diagnosis ------------------------------------------------------------------------------

/// Continues after the last diagnosis once it has ended.
fn diagnosed(server: &Server, one: &mut Investigation, was_left: bool) -> Result<(), Ending> {
    let asked = one.steps.last().and_then(|step| step.analysis.as_ref());
    let Some(analysis) = asked.and_then(|id| server.analyses.find(id)) else {
        return diagnose(server, one);
    };
    match analysis.state {
        State::Waiting | State::InWork => Ok(()),
        // It has ended with its server.
        State::Failed if was_left => diagnose(server, one),
        State::Failed => {
            let message = analysis.message.as_deref().unwrap_or("it gives no reason");
            let why = format!("the diagnosis {} failed: {message}", analysis.id);
            Err(Ending::of(End::Failed, why))
        }
        State::Cancelled => {
            let why = format!("the diagnosis {} was cancelled", analysis.id);
            Err(Ending::of(End::Cancelled, why))
        }
        State::Done => concluded(server, one, &analysis),
    }
}

/// Asks for a diagnosis of all runs so far.
fn diagnose(server: &Server, one: &mut Investigation) -> Result<(), Ending> {
    let failed = |error: AnalysisError| {
        let why = format!("no diagnosis can be made: {error}");
        Ending::of(End::Failed, why)
    };
    let id = asked(server, one).map_err(failed)?;
    one.state = InvestigationState::Diagnosing;
    if let Some(step) = one.steps.last_mut() {
        step.analysis = Some(id);
    }
    Ok(())
}

/// Requests the diagnosis of all runs so far and returns its name.
fn asked(server: &Server, one: &Investigation) -> Result<String, AnalysisError> {
    let request = Request {
        kind: AnalysisKind::Diagnose,
        runs: one.steps.iter().map(|step| step.run.clone()).collect(),
        spectra: Vec::new(),
        options: Options::default(),
    };
    let taken = server
        .analyses
        .submit(&server.settings, &server.hub, request, &one.by)?;
    Ok(taken.id)
}

/// Ends with a verdict, or runs the recommended experiment.
fn concluded(server: &Server, one: &mut Investigation, analysis: &Analysis) -> Result<(), Ending> {
    let found = server.analyses.conclusion(&server.settings, analysis);
    let Some(found) = found else {
        let why = format!("the diagnosis {} has no results", analysis.id);
        return Err(Ending::of(End::Failed, why));
    };
    if let Some(step) = one.steps.last_mut() {
        step.verdict = Some(found.verdict.label().to_owned());
        step.summary = Some(found.sentence);
    }
    if let Some((end, text)) = settled(found.verdict) {
        return Err(Ending::of(end, text));
    }
    let Some(recommended) = found.next else {
        let why = "a question is open, and no experiment is recommended that this bench could play";
        return Err(Ending::of(End::NoExperiment, why));
    };
    let again = one
        .experiments()
        .filter(|played| played.name == recommended.name)
        .count();
    if again >= MOST_AGAIN {
        let why = format!(
            "{} is recommended once more, and was played {MOST_AGAIN} times",
            recommended.name
        );
        return Err(Ending::of(End::NoExperiment, why));
    }
    if one.experiments().count() >= MOST_RUNS {
        return Err(Ending::of(End::Budget, most_played()));
    }
    play(server, one, &recommended)
}

// ---- the experiment -----------------------------------------------------------------------------

/// Appends the recommended experiment to the queue if it may be run and the budget covers it.
fn play(server: &Server, one: &mut Investigation, recommended: &Recommended) -> Result<(), Ending> {
    let name = &recommended.name;
    let request = ExperimentRequest {
        name: "submitted",
        text: Some(&recommended.text),
        bench: Some(&one.bench),
    };
    let submission = Submission::new(&server.settings, request).map_err(|refused| {
        let why = format!("the next experiment, {name}, cannot be run: {refused}");
        Ending::of(End::NoExperiment, why)
    })?;
    let expected = price(&submission);
    if let Some(lack) = one.budget.less(one.spent).shortfall(expected) {
        let why = format!("the next experiment, {name}, {lack}");
        return Err(Ending::of(End::Budget, why));
    }
    may_energise(server, &one.by)?;
    if let Some(why) = other_cell(server, one) {
        return Err(Ending::of(End::Stopped, why));
    }
    let experiment = FollowUp {
        name: name.clone(),
        place: 0,
        expected,
        spent: None,
    };
    *one = handed_over(server, one, &submission, experiment).map_err(|error| {
        let why = format!("the next experiment, {name}, could not be queued: {error}");
        Ending::of(End::Failed, why)
    })?;
    Ok(())
}

/// Time and charge that an experiment is planned to take.
fn price(submission: &Submission) -> Budget {
    let plan = procedure::plan(&submission.experiment);
    let extent = plan.extent();
    let charge_coulomb = extent.into_coulomb + extent.out_coulomb + alternating_coulomb(&plan);
    Budget {
        minutes: submission.expected_s / 60.0,
        charge_ah: charge_coulomb.value() / 3600.0,
    }
}

/// Charge that the sweeps of the cell move in either direction, C: the mean of |sin| is 2/π.
fn alternating_coulomb(plan: &Plan) -> Coulombs {
    let is_of_cell = |purpose: Purpose| {
        matches!(
            purpose,
            Purpose::Sweep(Fixture::Cell, _) | Purpose::Multisine(_)
        )
    };
    let stages = plan.stages.iter().filter(|stage| is_of_cell(stage.purpose));
    let moved_coulomb = |step: &Step| match step {
        Step::Sine { amplitude_a, .. } => FRAC_2_PI * *amplitude_a * step.expected_s(),
        Step::Multisine(band) => FRAC_2_PI * band.peak_a * step.expected_s(),
        _ => Coulombs(0.0),
    };
    stages
        .flat_map(|stage| &stage.steps)
        .map(moved_coulomb)
        .sum()
}

/// The user that began an investigation may have lost the permission to let current flow.
fn may_energise(server: &Server, by: &str) -> Result<(), Ending> {
    let tokens = server.tokens.all().unwrap_or_default();
    let may = tokens.iter().any(|token| {
        token.name == by && token.scopes.contains(&Scope::Energise) && !token.has_expired()
    });
    if may || server.open_to_all().unwrap_or(false) {
        return Ok(());
    }
    let why = format!("{by}, who began it, may no longer let current flow");
    Err(Ending::of(End::Stopped, why))
}

/// Returns why the cell in the jig may differ from the cell of an investigation: the last run on
/// its bench belongs to another origin and measured a cell with another name or serial number.
/// Cells that no experiment names are distinguished by their kind only.
fn other_cell(server: &Server, one: &Investigation) -> Option<String> {
    let data = &server.settings.data;
    let mut latest = server.jobs.latest();
    let last = latest.find(|job| job.item.bench == one.bench)?;
    let run = &last.item.run;
    let is_own = one.steps.iter().any(|step| step.run == *run);
    if is_own || find::cells_of_run(data, run) == find::cells_of_run(data, &one.run) {
        return None;
    }
    Some(format!(
        "expected the cell of {} in the jig of {}, found a run of another cell since: {run}",
        one.run, one.bench
    ))
}

/// Appends an experiment to the queue and returns the updated investigation.
///
/// # Errors
/// In words: a queue that is held or full, a file that cannot be written. Then nothing is queued.
fn handed_over(
    server: &Server,
    one: &Investigation,
    submission: &Submission,
    experiment: FollowUp,
) -> Result<Investigation, String> {
    let settings = &server.settings;
    let mut queue = server.queue();
    if let Some(why) = queue.held(&one.bench) {
        return Err(format!("the bench {} is held: {why}", one.bench));
    }
    let place = queue.next_id();
    let run = format!("{}-{place}", submission.experiment.name);
    let step = InvestigationStep {
        experiment: Some(FollowUp {
            place,
            ..experiment
        }),
        ..InvestigationStep::of(&run)
    };
    let mut handed = one.clone();
    handed.state = InvestigationState::WaitingForBench;
    handed.steps.push(step);
    submission
        .freeze(&settings.data.join("submitted").join(&run))
        .map_err(|error| error.to_string())?;
    // The record names the run before the queue does. If the server crashes in between, nothing
    // is queued, and the next server detects that: nothing is queued twice.
    server.analyses.investigations.put(&server.hub, &handed)?;
    let wanted = Wanted {
        kind: Kind::Run,
        experiment: submission.experiment.name.clone(),
        bench: submission.experiment.bench.name.clone(),
        seed: None,
        expected_s: submission.expected_s,
        by: one.by.clone(),
        unix_s: clock::unix_time_s(),
        traceparent: None,
    };
    let item = queue
        .submit(&wanted, |_| run)
        .map_err(|error| error.to_string())?;
    drop(queue);
    server.tell_queue();
    let by = By {
        who: &one.by,
        from: "-",
    };
    let outcome = format!("queued {} on {}", item.run, item.bench);
    if let Err(error) = server.audit.write(by, &one.id, &outcome) {
        tracing::error!("the audit trail cannot be written: {error}");
    }
    Ok(handed)
}

/// Continues once the experiment has ended.
fn measured(server: &Server, one: &mut Investigation) -> Result<(), Ending> {
    if let Some(place) = place(server, one) {
        free(server, &one.bench)?;
        one.state = if place.begun {
            InvestigationState::Measuring
        } else {
            InvestigationState::WaitingForBench
        };
        return Ok(());
    }
    let Some(run) = one.steps.last().map(|step| step.run.clone()) else {
        return Err(Ending::of(End::Failed, "its record has no run"));
    };
    // The end of a run is written before its place in the queue goes.
    let ended = jobs::read(&server.settings.data, &run).and_then(|job| job.ended);
    let Some(Ended { finished, how, .. }) = ended else {
        let why = format!("{run} was taken out of the queue");
        return Err(Ending::of(End::Stopped, why));
    };
    account(server, one, &run);
    if !finished {
        let why = format!("{run} did not come to its end: {how}");
        return Err(Ending::of(End::Stopped, why));
    }
    free(server, &one.bench)?;
    diagnose(server, one)
}

/// Subtracts the cost of the last run from the budget: its time, and the charge of its plan.
fn account(server: &Server, one: &mut Investigation, run: &str) {
    let mut watch = Watch::new(&server.runs().join(run));
    watch.look();
    let minutes = watch.now(None, false).bench_time_s / 60.0;
    let last = one.steps.last_mut();
    if let Some(experiment) = last.and_then(|step| step.experiment.as_mut()) {
        let spent = Budget {
            minutes,
            charge_ah: experiment.expected.charge_ah,
        };
        experiment.spent = Some(spent);
        one.spent = one.spent.plus(spent);
    }
}

/// Place of the last experiment in the queue.
struct Place {
    id: u64,
    begun: bool,
}

/// Returns the state of its last experiment in the queue, or `None` if it is not queued.
fn place(server: &Server, one: &Investigation) -> Option<Place> {
    let step = one.steps.last()?;
    let id = step.experiment.as_ref()?.place;
    let queue = server.queue();
    let item = queue
        .items()
        .iter()
        .find(|item| item.id == id && item.run == step.run)?;
    let begun = item.process.is_some();
    Some(Place { id, begun })
}

/// Removes its waiting experiment from the queue: an ended investigation must not let current
/// flow.
fn take_out(server: &Server, one: &Investigation) {
    let Some(place) = place(server, one).filter(|place| !place.begun) else {
        return;
    };
    let taken = server.queue().cancel(place.id);
    match taken {
        Ok(_) => server.tell_queue(),
        Err(error) => tracing::warn!("{}: {error}", one.id),
    }
}

// ---- what people ask for ------------------------------------------------------------------------

/// Begins an investigation with a run that has come to its end.
///
/// # Errors
/// A run or a bench that it cannot be done with, a budget below 0, a bench that is held.
pub fn begin(
    server: &Server,
    request: InvestigationRequest,
    by: &str,
) -> Result<Investigation, AnalysisError> {
    let budget = Budget {
        minutes: request.budget_minutes,
        charge_ah: request.budget_ah,
    };
    let budget = budget
        .checked()
        .map_err(|text| AnalysisError::Unfit(format!("budget_minutes, budget_ah: {text}")))?;
    let run = request.run;
    let bench = bench_of(server, &run, request.bench)?;
    let investigations = &server.analyses.investigations;
    let _turn = investigations.turn();
    if let Some(other) = investigations.going_about(&run) {
        let text = format!("expected no investigation of {run} that goes on, found {other}");
        return Err(AnalysisError::Conflict(text));
    }
    if investigations.going().len() >= MOST_GOING {
        let text = format!("expected at most {MOST_GOING} investigations, found as many");
        return Err(AnalysisError::Conflict(text));
    }
    if let Some(why) = held(server, &bench) {
        let text = format!("expected a bench that is free for its queue, found {bench} {why}");
        return Err(AnalysisError::Conflict(text));
    }
    let mut one = Investigation {
        id: investigations.next_id(),
        bench,
        budget,
        spent: Budget::default(),
        by: by.to_owned(),
        submitted_unix_s: clock::unix_time_s(),
        state: InvestigationState::Diagnosing,
        steps: vec![InvestigationStep::of(&run)],
        ended: None,
        run,
    };
    if let Some(why) = other_cell(server, &one) {
        return Err(AnalysisError::Conflict(why));
    }
    let analysis = asked(server, &one)?;
    one.steps
        .iter_mut()
        .for_each(|step| step.analysis = Some(analysis.clone()));
    investigations
        .put(&server.hub, &one)
        .map_err(AnalysisError::Io)?;
    Ok(one)
}

/// The bench of the experiments after a run.
fn bench_of(server: &Server, run: &str, wanted: Option<String>) -> Result<String, AnalysisError> {
    let unfit = |text: String| Err(AnalysisError::Unfit(text));
    let data = &server.settings.data;
    let job = Some(run)
        .filter(|run| confined_path::plain(run))
        .and_then(|run| jobs::read(data, run));
    let Some(job) = job else {
        return unfit(format!(
            "run: expected the name of a run of this server, found {run:?}"
        ));
    };
    if !job.ended.is_some_and(|ended| ended.finished) {
        let text = format!("run: expected a run that has come to its end, found {run}");
        return Err(AnalysisError::Conflict(text));
    }
    let cells: Vec<String> = find::cells_of_run(data, run)
        .into_iter()
        .map(|cell| cell.name)
        .collect();
    if cells.len() > 1 {
        let found = cells.join(", ");
        return unfit(format!("run: expected a run of one cell, found {found}"));
    }
    let bench = wanted.unwrap_or(job.item.bench);
    if server.settings.bench(&bench).is_none() {
        return unfit(format!(
            "bench: expected a bench of this server, found {bench:?}"
        ));
    }
    Ok(bench)
}

/// Ends an investigation. A waiting experiment is removed from the queue; a running one continues
/// to its end.
///
/// # Errors
/// An unknown name, or that of an ended investigation; a record that cannot be written.
pub fn cancel(server: &Server, id: &str, by: &str) -> Result<Investigation, AnalysisError> {
    let investigations = &server.analyses.investigations;
    let _turn = investigations.turn();
    let one = investigations
        .find(id)
        .ok_or_else(|| AnalysisError::Unknown(id.to_owned()))?;
    if one.ended.is_some() {
        let text = "expected an investigation that goes on, found one that has ended";
        return Err(AnalysisError::Conflict(text.to_owned()));
    }
    let asked = one.steps.last().and_then(|step| step.analysis.as_ref());
    if let Some(analysis) = asked {
        // The analysis may have ended in the meantime.
        let _ = server.analyses.cancel(&server.hub, analysis);
    }
    take_out(server, &one);
    let mut why = format!("cancelled by {by}");
    if place(server, &one).is_some() {
        why.push_str("; its experiment is in work and goes on to its end");
    }
    let one = one.closed(End::Cancelled, &why);
    investigations
        .put(&server.hub, &one)
        .map_err(AnalysisError::Io)?;
    Ok(one)
}
