//! Runs and their results: the proof of a bench, whole runs, the path from a run folder to spectra,
//! models and reports, and the next experiment. It knows neither HTTP nor the command line.
//!
//! In reading order, each module using earlier ones only: [`support`] (numbers, telemetry),
//! [`files`] (models and curves), [`figures`] (pictures), [`doctor`] (proof of a bench), [`run`] (a
//! whole run), [`investigate`] (runs → diagnosis → the recommended run; a run of a map
//! takes its data sets and maps), [`mod@campaign`] (cells
//! over benches).

pub mod campaign;
pub mod doctor;
pub mod figures;
pub mod files;
pub mod investigate;
pub mod run;
pub mod support;
