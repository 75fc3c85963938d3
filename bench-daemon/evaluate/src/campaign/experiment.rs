//! Experiments of a campaign: the text of the file with the cell and the seed put in.

use std::path::{Path, PathBuf};

use super::{CampaignFile, Design, Visit};
use bench_plan::config::{ConfigError, load_experiment};

/// Digits of the number that the name of a file begins with.
const NUMBER_WIDTH: usize = 4;

impl CampaignFile {
    /// Returns the experiment of a visit as text. `path` converts the paths of the file to those
    /// in the text; a given bench replaces the bench of the file.
    ///
    /// # Errors
    /// The experiment file is not valid TOML.
    pub fn text(
        &self,
        visit: &Visit,
        bench: Option<String>,
        path: impl Fn(&str) -> String,
    ) -> Result<String, ConfigError> {
        let source = &self.experiment;
        let mut table: toml::Table = source
            .text()
            .parse()
            .map_err(|error: toml::de::Error| source.complain("(whole file)", error.to_string()))?;
        for field in ["bench", "cell"] {
            if let Some(toml::Value::String(text)) = table.get_mut(field) {
                *text = path(text);
            }
        }
        let traces = table.get_mut("traces").and_then(toml::Value::as_array_mut);
        for trace in traces.into_iter().flatten() {
            if let Some(toml::Value::String(text)) = trace.get_mut("file") {
                *text = path(text);
            }
        }
        if let Some(bench) = bench {
            table.insert("bench".to_owned(), bench.into());
        }
        let seed = self.seed_of(visit);
        table.insert("name".to_owned(), self.name.clone().into());
        table.insert("seed".to_owned(), toml::Value::Integer(seed.cast_signed()));
        let mut specimen = toml::Table::new();
        let cell = &visit.cell;
        let known = [
            ("name", Some(&cell.name)),
            ("serial", cell.serial.as_ref()),
            ("batch", cell.batch.as_ref()),
            ("barcode", cell.barcode.as_ref()),
        ];
        for (key, text) in known {
            if let Some(text) = text {
                specimen.insert(key.to_owned(), text.clone().into());
            }
        }
        table.insert("specimen".to_owned(), toml::Value::Table(specimen));
        toml::to_string(&table).map_err(|error| source.complain("(whole file)", error.to_string()))
    }

    /// Writes the experiments into a folder, one folder for each bench, and checks the first of each
    /// bench as a run would: the others differ in cell and seed only. Returns their files, for each
    /// bench in the order in which it takes them.
    ///
    /// # Errors
    /// A bench without a file; an experiment that a bench or a cell refuses; a file that cannot be
    /// written.
    pub fn write(&self, design: &Design, out: &Path) -> Result<Vec<PathBuf>, ConfigError> {
        let mut written = Vec::new();
        for (bench, visits) in self.benches.iter().zip(&design.benches) {
            let Some(bench_file) = &bench.file else {
                let reason = format!(
                    "expected the file of bench {:?}, from which its experiments are made; or \
                    submit the campaign to a fleet",
                    bench.name
                );
                return Err(self.experiment.complain("benches.file", reason));
            };
            let folder = out.join(bench.own_name());
            std::fs::create_dir_all(&folder).map_err(|error| self.unwritten(&folder, &error))?;
            for (number, visit) in (1..).zip(visits) {
                let bench = Some(absolute(bench_file));
                let text = self.text(visit, bench, |path| self.path_from_anywhere(path))?;
                let name = format!(
                    "{number:0width$}_{}_{}.toml",
                    visit.cell.name,
                    visit.repeat,
                    width = NUMBER_WIDTH
                );
                let path = folder.join(name);
                std::fs::write(&path, text).map_err(|error| self.unwritten(&path, &error))?;
                if number == 1 {
                    load_experiment(&path, None)?;
                }
                written.push(path);
            }
        }
        Ok(written)
    }

    /// Returns a seed for each visit, which stays equal if the campaign is created again.
    pub fn seed_of(&self, visit: &Visit) -> u64 {
        let words = [visit.cell.name.as_str(), &self.benches[visit.bench].name];
        let text = format!("{}/{}/{}/{}", self.seed, words[0], words[1], visit.repeat);
        let digest = bench_plan::support::hash::sha256(&text);
        // Twelve digits: a whole number that TOML and JSON carry.
        u64::from_str_radix(&digest[..12], 16).unwrap_or_default()
    }

    fn path_from_anywhere(&self, path: &str) -> String {
        absolute(&self.experiment.relative(path))
    }

    fn unwritten(&self, path: &Path, error: &std::io::Error) -> ConfigError {
        let reason = format!("{}: cannot be written: {error}", path.display());
        self.experiment.complain("(experiments)", reason)
    }
}

fn absolute(path: &Path) -> String {
    std::path::absolute(path)
        .unwrap_or_else(|_| path.to_path_buf())
        .display()
        .to_string()
}
