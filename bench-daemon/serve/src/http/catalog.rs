//! Routes of the catalogue: questions across runs, benches and cells.

use std::path::Path;

use analysis::catalog::{
    Catalog, CatalogError,
    ageing::Ageing,
    query::{
        CellsFound, Choices, DiagnosesFound, Filter, FitsFound, MOST, RunShown, RunsFound,
        SpectraFound,
    },
    record::CatalogVerdict,
};
use axum::{
    Json,
    extract::{self, Query, State},
    http::StatusCode,
};
use bench_http::Refusal;
use serde::Deserialize;
use utoipa::IntoParams;

use super::{App, aside::aside, caller::Reader};
use bench_plan::support::calendar::unix_s;

/// Conditions on the contents of the catalogue; all of them must hold.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CatalogWanted {
    /// Name, serial number or barcode of a cell.
    cell: Option<String>,
    /// Serial number of a cell, from the experiment or read by a person, or its barcode.
    serial: Option<String>,
    /// Batch of a cell.
    batch: Option<String>,
    /// Name of an experiment.
    experiment: Option<String>,
    /// Name of a bench.
    bench: Option<String>,
    /// Started at this time or later: 2026-11-28, 2026-11-28T12:00:00Z, or s since 1970.
    #[serde(alias = "from_s")]
    from: Option<String>,
    /// Started before this time.
    #[serde(alias = "to_s")]
    to: Option<String>,
    /// Verdict of the run.
    verdict: Option<CatalogVerdict>,
    /// Runs that the interlock ended, also if they were resumed afterwards.
    #[serde(default)]
    trip: bool,
    /// Runs that have fitted a map over charge and temperature.
    #[serde(default)]
    map: bool,
    /// A tag of the run.
    tag: Option<String>,
    /// Words in the name, bench, experiment, operator, end, cells, tags or notes of the run.
    text: Option<String>,
    /// Position of the next part: `after` of the previous answer.
    after: Option<String>,
    /// Maximum number of results.
    #[param(minimum = 1, maximum = 1000)]
    most: Option<u16>,
}

/// Selects a cell and its runs.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct AgeingWanted {
    /// Name or serial number of the cell.
    cell: String,
    /// Its serial number, if several cells have the same name.
    serial: Option<String>,
    /// Number of RC pairs of the models. Left out: the greatest that every run of the cell has.
    rc: Option<u32>,
    /// Started at this time or later: 2026-11-28, 2026-11-28T12:00:00Z, or s since 1970.
    #[serde(alias = "from_s")]
    from: Option<String>,
    /// Started before this time.
    #[serde(alias = "to_s")]
    to: Option<String>,
}

/// A time of a question, s since 1970.
fn time(field: &str, text: Option<String>) -> Result<Option<f64>, Refusal> {
    let parsed = text.map(|text| unix_s(&text)).transpose();
    parsed.map_err(|reason| Refusal::of(StatusCode::BAD_REQUEST, format!("{field}: {reason}")))
}

impl CatalogWanted {
    fn filter(self) -> Result<Filter, Refusal> {
        if let Some(most) = self.most.filter(|most| !(1..=1000).contains(most)) {
            let expected = format!("most: expected 1 to 1000, found {most}");
            return Err(Refusal::of(StatusCode::BAD_REQUEST, expected));
        }
        Ok(Filter {
            cell: self.cell,
            serial: self.serial,
            batch: self.batch,
            experiment: self.experiment,
            bench: self.bench,
            from_unix_s: time("from", self.from)?,
            to_unix_s: time("to", self.to)?,
            verdict: self.verdict,
            trip: self.trip,
            map: self.map,
            tag: self.tag,
            text: self.text,
            after: self.after,
            most: self.most.map_or(MOST, usize::from),
        })
    }
}

/// Answers from the catalogue, on a thread for work that waits.
async fn ask<T: Send + 'static>(
    app: App,
    question: impl FnOnce(&Catalog) -> Result<T, CatalogError> + Send + 'static,
) -> Result<Json<T>, Refusal> {
    aside(move || {
        let catalog = app.server.catalog.open();
        let answer = catalog.and_then(|catalog| question(&catalog));
        answer.map(Json).map_err(|error| refused(&error))
    })
    .await
}

/// Returns the refusal of a question that the catalogue cannot answer.
pub(super) fn refused(error: &CatalogError) -> Refusal {
    match error {
        CatalogError::Cursor { .. } => Refusal::of(StatusCode::BAD_REQUEST, error.to_string()),
        CatalogError::Run { found, number, .. } => Refusal::of(
            StatusCode::NOT_FOUND,
            format!(
                "run: expected the identity or the name of one run, found {number} for {found:?}"
            ),
        ),
        CatalogError::Absent { .. } => Refusal::of(
            StatusCode::SERVICE_UNAVAILABLE,
            "the catalogue is being built: ask again",
        ),
        error => Refusal::machine(error),
    }
}

/// Returns a folder relative to the data folder, because the path of the data folder is not
/// disclosed.
fn within(data: &Path, folder: &str) -> String {
    let data = std::fs::canonicalize(data).unwrap_or_else(|_| data.to_path_buf());
    let within = Path::new(folder).strip_prefix(data);
    within.map_or_else(|_| folder.to_owned(), |path| path.display().to_string())
}

/// Returns the runs of the catalogue that meet all conditions, the latest first.
#[utoipa::path(
    get,
    path = "/api/v1/catalog/runs",
    tag = "catalog",
    params(CatalogWanted),
    responses((status = 200, body = RunsFound)),
    security(("token" = ["read"]))
)]
pub async fn runs(
    _caller: Reader,
    State(app): State<App>,
    Query(wanted): Query<CatalogWanted>,
) -> Result<Json<RunsFound>, Refusal> {
    let filter = wanted.filter()?;
    let data = app.server.catalog.data().to_path_buf();
    ask(app, move |catalog| {
        let mut found = catalog.runs(&filter)?;
        for run in &mut found.runs {
            run.folder = within(&data, &run.folder);
        }
        Ok(found)
    })
    .await
}

/// Returns everything that is known about a run, by its name or identity.
#[utoipa::path(
    get,
    path = "/api/v1/catalog/runs/{run}",
    tag = "catalog",
    params(("run" = String, Path, description = "The run.")),
    responses((status = 200, body = RunShown)),
    security(("token" = ["read"]))
)]
pub async fn run(
    _caller: Reader,
    State(app): State<App>,
    extract::Path(run): extract::Path<String>,
) -> Result<Json<RunShown>, Refusal> {
    let data = app.server.catalog.data().to_path_buf();
    ask(app, move |catalog| {
        let mut shown = catalog.show(&run)?;
        shown.run.folder = within(&data, &shown.run.folder);
        for one in &mut shown.diagnoses {
            one.folder = within(&data, &one.folder);
        }
        Ok(shown)
    })
    .await
}

/// Returns the fitted models of runs that meet all conditions, the latest first.
#[utoipa::path(
    get,
    path = "/api/v1/catalog/fits",
    tag = "catalog",
    params(CatalogWanted),
    responses((status = 200, body = FitsFound)),
    security(("token" = ["read"]))
)]
pub async fn fits(
    _caller: Reader,
    State(app): State<App>,
    Query(wanted): Query<CatalogWanted>,
) -> Result<Json<FitsFound>, Refusal> {
    let filter = wanted.filter()?;
    ask(app, move |catalog| catalog.fits(&filter)).await
}

/// Returns the diagnoses of runs that meet all conditions, those of the latest run first.
#[utoipa::path(
    get,
    path = "/api/v1/catalog/diagnoses",
    tag = "catalog",
    params(CatalogWanted),
    responses((status = 200, body = DiagnosesFound)),
    security(("token" = ["read"]))
)]
pub async fn diagnoses(
    _caller: Reader,
    State(app): State<App>,
    Query(wanted): Query<CatalogWanted>,
) -> Result<Json<DiagnosesFound>, Refusal> {
    let filter = wanted.filter()?;
    let data = app.server.catalog.data().to_path_buf();
    ask(app, move |catalog| {
        let mut found = catalog.diagnoses(&filter)?;
        for one in &mut found.diagnoses {
            one.folder = within(&data, &one.folder);
        }
        Ok(found)
    })
    .await
}

/// Returns the corrected spectra of cells that meet all conditions, the latest first.
#[utoipa::path(
    get,
    path = "/api/v1/catalog/spectra",
    tag = "catalog",
    params(CatalogWanted),
    responses((status = 200, body = SpectraFound)),
    security(("token" = ["read"]))
)]
pub async fn spectra(
    _caller: Reader,
    State(app): State<App>,
    Query(wanted): Query<CatalogWanted>,
) -> Result<Json<SpectraFound>, Refusal> {
    let filter = wanted.filter()?;
    ask(app, move |catalog| catalog.spectra(&filter)).await
}

/// Returns the cells of the runs that meet all conditions, by name and serial number.
#[utoipa::path(
    get,
    path = "/api/v1/catalog/cells",
    tag = "catalog",
    params(CatalogWanted),
    responses((status = 200, body = CellsFound)),
    security(("token" = ["read"]))
)]
pub async fn cells(
    _caller: Reader,
    State(app): State<App>,
    Query(wanted): Query<CatalogWanted>,
) -> Result<Json<CellsFound>, Refusal> {
    let filter = wanted.filter()?;
    ask(app, move |catalog| catalog.cells(&filter)).await
}

/// Returns the cells, benches and tags of all runs: what a person can choose from in a search.
#[utoipa::path(
    get,
    path = "/api/v1/catalog/choices",
    tag = "catalog",
    responses((status = 200, body = Choices)),
    security(("token" = ["read"]))
)]
pub async fn choices(_caller: Reader, State(app): State<App>) -> Result<Json<Choices>, Refusal> {
    ask(app, Catalog::choices).await
}

/// Returns a cell over its runs: resistances and diffusion over time, with uncertainty.
#[utoipa::path(
    get,
    path = "/api/v1/catalog/ageing",
    tag = "catalog",
    params(AgeingWanted),
    responses((status = 200, body = Ageing)),
    security(("token" = ["read"]))
)]
pub async fn ageing(
    _caller: Reader,
    State(app): State<App>,
    Query(wanted): Query<AgeingWanted>,
) -> Result<Json<Ageing>, Refusal> {
    let filter = Filter {
        cell: Some(wanted.cell),
        serial: wanted.serial,
        from_unix_s: time("from", wanted.from)?,
        to_unix_s: time("to", wanted.to)?,
        ..Filter::default()
    };
    ask(app, move |catalog| catalog.ageing(&filter, wanted.rc)).await
}
