//! One sweep in the files of a run: where its points go, and what the index says of it.

use analysis::{
    calibration::Correction,
    dataset::{Role, SweepEntry},
    spectrum::{ImpedancePoint, Spectrum},
};
use instruments::mock::plant::Fixture;

use crate::{
    config::{CampaignRun, Experiment},
    executor::{Executor, SweepPoint},
    fixture_check,
    journal::PointDone,
    plan::fixture_name,
    record::{RecordError, Recorder, sweep_name},
};

/// A sweep that is being written.
pub(super) struct Sweeping<'a> {
    experiment: &'a Experiment,
    fixture: Fixture,
    repeat: usize,
    correction: Correction,
    /// The run of the campaign that it is of.
    run: Option<CampaignRun>,
    /// In names of files.
    pub(super) name: String,
    raw: String,
    /// The file of corrected points, where they are corrected.
    file: Option<String>,
}

impl<'a> Sweeping<'a> {
    pub(super) fn new(experiment: &'a Experiment, (fixture, repeat): (Fixture, usize), correction: Correction) -> Self {
        let cell = fixture == Fixture::Cell;
        let run = experiment.campaign.as_ref().filter(|_| cell).and_then(|campaign| campaign.run(repeat));
        let name = sweep_name(fixture, repeat);
        let corrected = cell || (repeat > 0 && correction.reduced_chi2.is_some());
        let file = match (cell, repeat, &run) {
            (_, _, Some(run)) => format!("spectra/{}.csv", run.name()),
            (true, 0 | 1, None) => "spectrum.csv".to_owned(),
            (true, _, None) => format!("spectrum_{repeat}.csv"),
            (false, _, None) => format!("spectrum_{name}.csv"),
        };
        let (raw, file) = (format!("raw_{name}.csv"), corrected.then_some(file));
        Self { experiment, fixture, repeat, correction, run, name, raw, file }
    }

    /// The file that the index names.
    pub(super) fn indexed(&self) -> &str {
        self.file.as_deref().unwrap_or(&self.raw)
    }

    /// Appends a point to the tables; the corrected point, where there is one.
    pub(super) fn record(&self, recorder: &Recorder, point: &SweepPoint) -> Result<Option<ImpedancePoint>, RecordError> {
        recorder.spectrum_point(&self.raw, &self.as_read(point))?;
        let Some(file) = &self.file else { return Ok(None) };
        let corrected = self.correction.apply(&point.phasors);
        recorder.spectrum_point(file, &corrected)?;
        Ok(Some(corrected))
    }

    /// Makes the tables what the finished points say; their corrected points.
    pub(super) fn restore(&self, recorder: &mut Recorder, known: &[&PointDone]) -> Result<Spectrum, RecordError> {
        recorder.check_captures(known)?;
        let settle = |recorder: &Recorder, file: &str, points: &[ImpedancePoint]| {
            if points.is_empty() && !recorder.path(file).exists() { Ok(()) } else { recorder.settle_spectrum(file, points) }
        };
        let raw: Vec<ImpedancePoint> = known.iter().map(|known| self.as_read(&known.point)).collect();
        settle(recorder, &self.raw, &raw)?;
        let mut spectrum = Spectrum { name: self.spectrum_name(), points: Vec::new() };
        if let Some(file) = &self.file {
            spectrum.points = known.iter().map(|known| self.correction.apply(&known.point.phasors)).collect();
            settle(recorder, file, &spectrum.points)?;
        }
        for point in known.iter().map(|known| &known.point) {
            point.warnings.iter().for_each(|warning| recorder.known_point_warning(&self.name, point.phasors.freq_hz, warning));
        }
        Ok(spectrum)
    }

    fn spectrum_name(&self) -> String {
        self.run.as_ref().map_or_else(|| self.experiment.name.clone(), CampaignRun::name)
    }

    fn as_read(&self, point: &SweepPoint) -> ImpedancePoint {
        analysis::spectrum::raw_impedance(&point.phasors, self.experiment.bench.wiring.shunt.r_ohm)
    }

    /// The sweep in words of the index.
    pub(super) fn entry(&self, executor: &Executor<'_>, start_time_s: f64) -> SweepEntry {
        let (experiment, cell) = (self.experiment, self.fixture == Fixture::Cell);
        let group = if cell { "eis" } else { "eis_shunt" };
        SweepEntry {
            file: self.indexed().to_owned(),
            fixture: fixture_name(self.fixture).to_owned(),
            fixture_ohm: (!cell).then_some(fixture_check::known(&experiment.bench, self.fixture).r_ohm),
            corrected: self.correction.reduced_chi2.is_some(),
            amplitude_a: experiment.eis.as_ref().map_or(f64::NAN, |eis| eis.amplitude_a),
            repeat: self.run.as_ref().map_or(self.repeat, |run| run.repeat),
            order: executor.recorder.measured(),
            start_time_s,
            start_ocv_v: executor.idle.voltage_v.filter(|_| cell),
            temperature_c: executor.idle.temperature_c.filter(|_| cell),
            role: Role::Train,
            repeat_group: self.run.as_ref().map_or_else(|| group.to_owned(), |run| format!("eis_{}", run.cell.name)),
        }
    }
}
