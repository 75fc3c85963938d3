//! The experiment with a map from which others are made: the same bench, cell, limits, sweep and
//! pulses, at chosen points.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use analysis::map::{Measurement, Next};
use bench_core::safety::failure::Failure;
use bench_plan::{
    config::{
        ConfigError, Copies, Experiment, MapPlace, MapProcedure, Source, Temperature,
        resolve_experiment,
    },
    procedure,
};

use super::edit::{CONTROLS, named, points_text, seen_from, without_controls};

/// An experiment with a map.
#[derive(Debug, Clone)]
pub struct Base {
    experiment: Experiment,
    map: MapProcedure,
    temperature: Temperature,
    /// Its file, which opens bench, cell and scenario as they were when the experiment was read: an edit
    /// of them during an investigation does not change its limits.
    source: Source,
    /// The file of the bench.
    bench: PathBuf,
}

impl Base {
    /// Takes an experiment as base.
    ///
    /// # Errors
    /// An experiment without `[map]`.
    pub fn of(experiment: &Experiment) -> Result<Self, Failure> {
        let [source, bench, ..] = &experiment.sources[..] else {
            return Err(Failure::Usage(format!(
                "{}: expected an experiment that was read from files",
                experiment.name
            )));
        };
        let (Some(map), Some(temperature)) = (&experiment.map, experiment.temperature) else {
            let reason = "expected a section [map], whose sweep, pulses and limits further points take, \
                found none";
            return Err(source.complain("(whole file)", reason).into());
        };
        let text = |source: &Source| (source.path().to_owned(), source.text().to_owned());
        let copies: Copies = experiment.sources.iter().map(text).collect();
        Ok(Self {
            map: map.clone(),
            temperature,
            source: Source::copy(source.path(), &Arc::new(copies))?,
            bench: bench.path().to_owned(),
            experiment: experiment.clone(),
        })
    }

    /// The experiment.
    pub fn experiment(&self) -> &Experiment {
        &self.experiment
    }

    /// The map of the experiment.
    pub fn map(&self) -> &MapProcedure {
        &self.map
    }

    /// Returns an experiment that measures points after the base on the same bench, whose correction stays:
    /// it has no `[fixture_check]`.
    ///
    /// # Errors
    /// [`ConfigError`] for a point that the limits of cell and bench do not allow.
    pub fn at(&self, name: &str, places: &[MapPlace]) -> Result<Experiment, ConfigError> {
        let text = without_controls(&self.edited(name, places, None)?);
        self.check_edit(&text, &[CONTROLS])?;
        let source = self.source.with_text(self.source.path(), text);
        let mut experiment = resolve_experiment(source, Some(&self.bench))?;
        experiment.seed = self.experiment.seed;
        Ok(experiment)
    }

    /// Returns the text of a file that measures points, after checking it as `plan` does.
    ///
    /// # Errors
    /// A file of bench, cell or scenario that cannot be read or has changed since the experiment was read;
    /// a point that the limits of cell and bench do not allow.
    pub fn text_at(&self, file: &Path, places: &[MapPlace]) -> Result<String, Failure> {
        let name = named(file);
        let folder = folder_of(file);
        let text = self.edited(&name, places, Some(folder))?;
        self.check_edit(&text, &["bench", "cell"])?;
        // What the file names is read from the disk, also if the base is a copy in a run folder.
        self.check_unchanged()?;
        let of_disk = Source::read(&self.bench)?;
        let experiment = resolve_experiment(of_disk.with_text(file, text.clone()), None)?;
        procedure::plan(&experiment).check(&experiment.cell.limits)?;
        let same = experiment
            .map
            .is_some_and(|map| are_same(&map.places, places));
        same.then_some(text).ok_or_else(|| {
            let reason = "expected `soc` or `points` as one list in brackets";
            self.source.complain("map", reason).into()
        })
    }

    /// Refuses files of bench, cell and scenario that differ from those with which the experiment was read.
    fn check_unchanged(&self) -> Result<(), Failure> {
        const OTHER: &str = "--experiment gives another experiment with a [map]";
        for known in self.experiment.sources.iter().skip(1) {
            let found = Source::read(known.path())
                .map_err(|error| Failure::Usage(format!("{error}; {OTHER}")))?;
            if found.text() != known.text() {
                return Err(Failure::Usage(format!(
                    "{}: expected the file as it was in the run that the experiment continues, found \
                    another text; {OTHER}",
                    known.path().display()
                )));
            }
        }
        Ok(())
    }

    /// Checks that an edited text differs from the base in its name, its points and these fields only.
    fn check_edit(&self, text: &str, fields: &[&str]) -> Result<(), ConfigError> {
        let bare = |text: &str| {
            let mut table: toml::Table = text.parse().ok()?;
            table.remove("name");
            for field in fields {
                table.remove(*field);
            }
            let map = table.get_mut("map")?.as_table_mut()?;
            map.remove("soc");
            map.remove("points");
            Some(table)
        };
        let source = &self.source;
        if fields.contains(&CONTROLS)
            && source
                .with_text(source.path(), text.to_owned())
                .place_of(CONTROLS)
                .is_some()
        {
            let reason = "expected sections with headers of their own, [fixture_check] and \
                [fixture_check.…], which further runs leave out; found another form";
            return Err(source.complain(CONTROLS, reason));
        }
        let same = bare(text).is_some_and(|edited| Some(edited) == bare(source.text()));
        same.then_some(()).ok_or_else(|| {
            let reason =
                "expected `soc` or `points` as one list in brackets, which other points replace";
            source.complain("map", reason)
        })
    }

    /// Returns the text of the base with other points and another name; for another folder also with
    /// other paths.
    fn edited(
        &self,
        name: &str,
        places: &[MapPlace],
        folder: Option<&Path>,
    ) -> Result<String, ConfigError> {
        let source = &self.source;
        let listed = ["map.soc", "map.points"];
        let place = listed.iter().find_map(|field| source.place_of(field));
        let place = place
            .ok_or_else(|| source.complain("map", "expected `soc` or `points`, found neither"))?;
        // The header of a list of sections is neither key nor value of a line.
        let line = source.text()[..place.key.start].rsplit('\n').next();
        if line.is_some_and(|line| line.trim_start().starts_with('[')) {
            let reason = "expected `points` as one list in brackets, found sections [[map.points]]";
            return Err(source.complain("map.points", reason));
        }
        let mut edits = vec![(place.key.start..place.value.end, points_text(places))];
        let mut value = |field: &str, text: &str| {
            if let Some(place) = source.place_of(field) {
                let text = toml::Value::String(text.to_owned()).to_string();
                edits.push((place.value, text));
            }
        };
        value("name", name);
        if let Some(folder) = folder {
            value("bench", &seen_from(folder, &self.bench));
            let cell = self.experiment.sources.get(2).map(Source::path);
            if let Some(cell) = cell {
                value("cell", &seen_from(folder, cell));
            }
        }
        edits.sort_by_key(|(range, _)| std::cmp::Reverse(range.start));
        let mut text = source.text().to_owned();
        for (range, new) in edits {
            text.replace_range(range, &new);
        }
        Ok(text)
    }

    /// Returns chosen measurements as points, each once, in the order in which they are measured: the
    /// temperatures nearest to that of the charge first, and at each from high to low charge.
    pub fn in_order(&self, chosen: &[Next]) -> Vec<MapPlace> {
        let mut places: Vec<MapPlace> = Vec::new();
        for next in chosen {
            let (soc, temperature_degc) = (next.soc, next.temperature_degc);
            let is_here = |place: &&mut MapPlace| place.is_at(soc, temperature_degc);
            let (spectrum, pulses) = match next.what {
                Measurement::Spectrum => (true, false),
                Measurement::Pulses => (false, true),
            };
            match places.iter_mut().find(is_here) {
                Some(place) => {
                    place.spectrum |= spectrum;
                    place.pulses |= pulses;
                }
                None => places.push(MapPlace {
                    soc,
                    temperature_degc,
                    spectrum,
                    pulses,
                }),
            }
        }
        let from_charge_k = |place: &MapPlace| {
            (place.temperature_degc - self.temperature.setpoint_degc.value()).abs()
        };
        places.sort_by(|a, b| {
            let by_bath = from_charge_k(a).total_cmp(&from_charge_k(b));
            let by_degc = b.temperature_degc.total_cmp(&a.temperature_degc);
            by_bath.then(by_degc).then(b.soc.total_cmp(&a.soc))
        });
        places
    }
}

/// Checks whether two lists of points are the same within the digits of a file.
fn are_same(one: &[MapPlace], other: &[MapPlace]) -> bool {
    let is_same = |(a, b): (&MapPlace, &MapPlace)| {
        let what = (a.spectrum, a.pulses) == (b.spectrum, b.pulses);
        what && a.is_at(b.soc, b.temperature_degc)
    };
    one.len() == other.len() && one.iter().zip(other).all(is_same)
}

/// The folder of a file.
pub fn folder_of(file: &Path) -> &Path {
    let folder = file.parent().filter(|folder| *folder != Path::new(""));
    folder.unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::config::load_experiment;

    fn example() -> Base {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/map.toml");
        Base::of(&load_experiment(&file, None).unwrap()).unwrap()
    }

    fn next(soc: f64, temperature_degc: f64, what: Measurement) -> Next {
        Next {
            soc,
            temperature_degc,
            what,
            minutes: 10.0,
            error_v: 0.01,
        }
    }

    #[test]
    fn chosen_measurements_become_points_by_temperature_and_falling_charge() {
        let chosen = [
            next(0.2, 10.0, Measurement::Pulses),
            next(0.5, 25.0, Measurement::Spectrum),
            next(0.7, 10.0, Measurement::Spectrum),
            next(0.2, 10.0, Measurement::Spectrum),
            next(0.9, 25.0, Measurement::Pulses),
        ];
        let place = |soc, temperature_degc, spectrum, pulses| MapPlace {
            soc,
            temperature_degc,
            spectrum,
            pulses,
        };
        // The cell is charged at 25 °C.
        let expected = [
            place(0.9, 25.0, false, true),
            place(0.5, 25.0, true, false),
            place(0.7, 10.0, true, false),
            place(0.2, 10.0, true, true),
        ];
        let base = example();
        let places = base.in_order(&chosen);
        assert_eq!(places, expected);
        let experiment = base.at("next", &places).unwrap();
        assert_eq!(experiment.name, "next");
        // 70 % in the file are not 0.7 to the last digit.
        assert!(are_same(&experiment.map.unwrap().places, &expected));
        // The correction of the base stays, also in the text that a run folder keeps.
        assert!(experiment.fixture_check.is_none());
        assert!(!experiment.sources[0].text().contains(CONTROLS));
        // The limits are those of the base.
        assert_eq!(
            experiment.cell.limits.max_v,
            base.experiment().cell.limits.max_v
        );
        let other = place(0.5, 0.0, true, true);
        let refused = base.at("next", &[other]).unwrap_err().to_string();
        assert!(
            refused.contains("map.points.1.temperature: expected one of the temperatures of [map]"),
            "{refused}"
        );
    }

    /// The example with another text, beside copies of its bench, cell and scenario.
    fn edited(folder: &Path, from: &str, to: &str) -> (PathBuf, Base) {
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        for name in ["benches/map.toml", "cells/p45b.toml", "scenarios/map.toml"] {
            let copy = folder.join(name);
            std::fs::create_dir_all(copy.parent().unwrap()).unwrap();
            std::fs::copy(configs.join(name), copy).unwrap();
        }
        let text = std::fs::read_to_string(configs.join("experiments/map.toml")).unwrap();
        assert!(text.contains(from), "{from}");
        let file = folder.join("experiments/map.toml");
        std::fs::create_dir_all(folder.join("experiments")).unwrap();
        std::fs::write(&file, text.replace(from, to)).unwrap();
        let base = Base::of(&load_experiment(&file, None).unwrap()).unwrap();
        (file, base)
    }

    const PLACE: MapPlace = MapPlace {
        soc: 0.5,
        temperature_degc: 25.0,
        spectrum: true,
        pulses: true,
    };

    #[test]
    fn a_cell_file_that_changes_leaves_the_rounds_alone_and_refuses_a_written_file() {
        let outer = tempfile::tempdir().unwrap();
        // A path whose characters Rust and TOML write in different ways.
        let folder = outer.path().join("a\u{200b}b");
        let (_, base) = edited(&folder, "seed = 1", "seed = 2");
        let next = outer.path().join("next.toml");
        let text = base.text_at(&next, &[PLACE]).unwrap();
        assert!(text.contains("[fixture_check]"), "{text}");
        let cell = folder.join("cells/p45b.toml");
        std::fs::write(&cell, "name = 3\n").unwrap();
        let experiment = base.at("next", &[PLACE]).unwrap();
        assert_eq!(
            experiment.cell.limits.max_v,
            base.experiment().cell.limits.max_v
        );
        let refused = base.text_at(&next, &[PLACE]).unwrap_err().to_string();
        assert!(
            refused.contains("p45b.toml: expected the file as it was in the run"),
            "{refused}"
        );
    }

    #[test]
    fn points_as_sections_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let soc = "soc = [\"90 %\", \"50 %\", \"20 %\"]\n";
        let sections = "\n[[map.points]]\nsoc = \"50 %\"\ntemperature = \"25 °C\"\n\n[eis]";
        let (file, _) = edited(folder.path(), "seed = 1", "seed = 2");
        let text = std::fs::read_to_string(&file).unwrap();
        let text = text.replace(soc, "").replace("\n[eis]", sections);
        std::fs::write(&file, text).unwrap();
        let base = Base::of(&load_experiment(&file, None).unwrap()).unwrap();
        let refused = base.at("next", &[PLACE]).unwrap_err().to_string();
        assert!(
            refused.ends_with(
                "map.points: expected `points` as one list in brackets, found sections [[map.points]]"
            ),
            "{refused}"
        );
    }
}
