//! Fitted models of a run over one of its spectra.

use std::path::Path;

use super::spectra;
use analysis::{fit::ModelFile, run_folder};
pub use bench_evaluate::figures::curves::ModelOver;
use bench_evaluate::files;
use bench_plan::support::confined_path;

/// Returns all models of a run over the spectrum of this name, the recommended one first and then
/// the highest order, or `None` if the run has no such spectrum.
pub fn over(folder: &Path, spectrum: &str) -> Option<Vec<ModelOver>> {
    let file = format!("{spectrum}.csv");
    if !spectra::stamps(folder).contains_key(&file) {
        return None;
    }
    let spectrum = spectra::read(folder, &file)?;
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    let recommended = files::recommended_order(folder);
    let mut models: Vec<ModelOver> = names
        .filter(|name| run_folder::is_model(name))
        .filter_map(|name| {
            let file = confined_path::open(folder, &name)?;
            let model: ModelFile = serde_json::from_reader(file).ok()?;
            let name = name.trim_end_matches(".json");
            let over = ModelOver::new(&model.fit, name, &spectrum.name, &spectrum.points);
            Some(over.marked(recommended == Some(model.rc)))
        })
        .collect();
    models.sort_by(|a, b| a.place().cmp(&b.place()).then(a.file.cmp(&b.file)));
    Some(models)
}
