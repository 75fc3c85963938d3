//! Writes one sweep to the files of a run: its points, and its entry in the index.

use analysis::{
    calibration::{Correction, CorrectionModes},
    contract::CommonModeImpedance,
    dataset::{PointConditions, SweepEntry},
    run_folder,
    series::Role,
    spectrum::{ChannelPhasors, FlaggedPoint, ImpedancePoint, Spectrum, at_one_time},
};
use instruments::{
    fixture::Fixture,
    units::{Amps, Celsius, Seconds, Volts},
};
use num_complex::Complex64;

use super::Measured;
use crate::doctor::fixture_check;
use bench_core::{
    executor::Executor,
    journal::PointDone,
    record::{RecordError, Recorder, sweep_name},
};
use bench_plan::{
    config::Experiment,
    measure::{SweepPoint, spectrum_gate::judge_sweep},
    plan::{CampaignRun, Stage, Step, fixture_name},
};

/// A sweep that is being written.
pub(super) struct SweepWriter<'a> {
    experiment: &'a Experiment,
    fixture: Fixture,
    repeat: usize,
    correction: Correction,
    /// Channel phasors of the shunt.
    shunt: Vec<ChannelPhasors>,
    /// Channel phasors in the jig before the first cell; empty without a fake cell.
    jig: Vec<ChannelPhasors>,
    /// The run of the campaign that it belongs to.
    run: Option<CampaignRun>,
    /// Commanded direct current, A.
    bias_a: f64,
    /// Name in file names.
    pub(super) name: String,
    raw: String,
    /// The file of corrected points, if they are corrected.
    file: Option<String>,
}

/// Result of a complete sweep.
pub(super) struct Settled {
    /// Its points, each frequency once.
    pub(super) points: Vec<SweepPoint>,
    /// The corrected spectrum.
    pub(super) spectrum: Spectrum,
    /// The corrected spectrum with the noise of its own records only.
    pub(super) own_noise: Spectrum,
    /// The file that the index names.
    pub(super) file: String,
}

impl<'a> SweepWriter<'a> {
    pub(super) fn new(
        experiment: &'a Experiment,
        fixture: Fixture,
        repeat: usize,
        measured: &Measured,
    ) -> Self {
        let correction = measured.correction.clone();
        let (shunt, jig) = (shunt_phasors(measured), jig_phasors(measured));
        let cell = fixture == Fixture::Cell;
        let run = experiment.run(repeat).filter(|_| cell);
        let name = sweep_name(fixture, repeat);
        let corrected = cell || (repeat > 0 && correction.reduced_chi2.is_some());
        let file = match (cell, &run) {
            (_, Some(run)) => run_folder::campaign_spectrum(&run.name()),
            (true, None) => run_folder::spectrum(repeat),
            (false, None) => run_folder::control_spectrum(&name),
        };
        let (raw, file) = (run_folder::raw(&name), corrected.then_some(file));
        Self {
            experiment,
            fixture,
            repeat,
            correction,
            shunt,
            jig,
            run,
            bias_a: 0.0,
            name,
            raw,
            file,
        }
    }

    /// Sets the direct current under the sinusoids, A.
    pub(super) fn under(self, bias_a: f64) -> Self {
        Self { bias_a, ..self }
    }

    /// Returns the file that the index names.
    pub(super) fn indexed(&self) -> &str {
        self.file.as_deref().unwrap_or(&self.raw)
    }

    /// Corrects a point according to the positions of the voltage probes.
    fn corrected(&self, point: &SweepPoint) -> ImpedancePoint {
        match self.fixture {
            Fixture::Shunt => self.correction.apply_at_shunt(&point.phasors),
            Fixture::Cell | Fixture::FakeCell | Fixture::Short => {
                self.correction.apply(&point.phasors)
            }
        }
    }

    /// Appends a point to the tables. Those of a sweep under a direct current appear when it is
    /// complete, because their columns differ: until then the journal holds the points.
    pub(super) fn record(
        &self,
        recorder: &Recorder,
        point: &SweepPoint,
    ) -> Result<(), RecordError> {
        if self.bias_a != 0.0 {
            return Ok(());
        }
        recorder.spectrum_point(&self.raw, &self.as_read(point))?;
        let Some(file) = &self.file else {
            return Ok(());
        };
        recorder.spectrum_point(file, &self.corrected(point))
    }

    /// Completes a sweep, also in the tables. Points are sorted by rising frequency, with the
    /// records that are used, and each frequency occurs once. A frequency that was visited twice
    /// is stated for the middle of the sweep.
    pub(super) fn settle(
        &self,
        recorder: &Recorder,
        mut points: Vec<SweepPoint>,
    ) -> Result<Settled, RecordError> {
        points.sort_by(|a, b| a.phasors.freq_hz.total_cmp(&b.phasors.freq_hz));
        let at_once = |of: &dyn Fn(&SweepPoint) -> ImpedancePoint| {
            at_one_time(
                &points
                    .iter()
                    .map(|point| (point.time_s.value(), of(point)))
                    .collect::<Vec<_>>(),
            )
        };
        let as_read = at_once(&|point| self.as_read(point));
        let corrected = at_once(&|point| self.corrected(point));
        let own = at_once(&|point| {
            let covariance = self
                .correction
                .measured_parts(&point.phasors)
                .into_iter()
                .sum();
            ImpedancePoint {
                covariance,
                ..self.corrected(point)
            }
        });
        let (begin_s, end_s) = points
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| {
                (a.min(p.time_s.0), b.max(p.time_s.0))
            });
        points.dedup_by(|a, b| {
            let same = a.phasors.freq_hz == b.phasors.freq_hz;
            if same {
                b.failing.append(&mut a.failing);
                // Its impedance is stated for this time.
                b.time_s = Seconds(0.5 * (begin_s + end_s));
            }
            same
        });
        if self.fixture == Fixture::Cell {
            judge_sweep(&mut points, &corrected);
        }
        let flags = flag_texts(&points);
        let named = |points| Spectrum::new(self.spectrum_name(), points);
        let biased = (self.bias_a != 0.0).then(|| self.conditions(&points));
        let table = |file: &str, points: &[ImpedancePoint]| match &biased {
            None => recorder.flagged_spectrum(file, points, &flags),
            Some(conditions) => {
                recorder.biased_spectrum(file, &named(points.to_vec()), conditions, &flags)
            }
        };
        table(&self.raw, &as_read)?;
        if let Some(file) = &self.file {
            table(file, &corrected)?;
        }
        let phasors: Vec<ChannelPhasors> = points.iter().map(|point| point.phasors).collect();
        let spectrum = self.with_shared(named(corrected), &phasors);
        match (&self.file, &biased) {
            (Some(file), None) => write_shared(recorder, file, &spectrum, &flags)?,
            (Some(file), Some(conditions)) if !spectrum.shared.is_empty() => {
                let file = run_folder::shared_spectrum(file);
                recorder.biased_spectrum(&file, &spectrum, conditions, &flags)?;
            }
            _ => {}
        }
        Ok(Settled {
            points,
            spectrum,
            own_noise: named(own),
            file: self.indexed().to_owned(),
        })
    }

    /// Returns the conditions of each point.
    fn conditions(&self, points: &[SweepPoint]) -> Vec<PointConditions> {
        let unknown = PointConditions {
            bias_a: self.bias_a,
            bias_measured_a: f64::NAN,
            sigma_bias_a: f64::NAN,
            charge_coulomb: f64::NAN,
            temperature_degc: None,
        };
        let of = |point: &SweepPoint| point.conditions.unwrap_or(unknown);
        points.iter().map(of).collect()
    }

    /// Adds the shared errors of the correction to a spectrum of the cell; these errors are the
    /// same for all sweeps of the run.
    fn with_shared(&self, spectrum: Spectrum, phasors: &[ChannelPhasors]) -> Spectrum {
        if self.fixture != Fixture::Cell || self.file.is_none() {
            return spectrum;
        }
        with_shared(spectrum, phasors, &self.correction, &self.jig)
    }

    /// Rewrites the tables from the finished points.
    pub(super) fn restore(
        &self,
        recorder: &mut Recorder,
        known: &[&PointDone],
    ) -> Result<(), RecordError> {
        recorder.check_captures(known)?;
        let biased = self.bias_a != 0.0;
        let settle = |recorder: &Recorder, file: &str, points: &[ImpedancePoint]| {
            if biased || (points.is_empty() && !recorder.path(file).exists()) {
                Ok(())
            } else {
                recorder.settle_spectrum(file, points)
            }
        };
        let raw: Vec<ImpedancePoint> = known
            .iter()
            .map(|known| self.as_read(&known.point))
            .collect();
        settle(recorder, &self.raw, &raw)?;
        if let Some(file) = &self.file {
            let corrected: Vec<ImpedancePoint> = known
                .iter()
                .map(|known| self.corrected(&known.point))
                .collect();
            settle(recorder, file, &corrected)?;
        }
        for point in known.iter().map(|known| &known.point) {
            point.warnings.iter().for_each(|warning| {
                recorder.known_point_warning(&self.name, point.phasors.freq_hz, warning);
            });
        }
        Ok(())
    }

    fn spectrum_name(&self) -> String {
        self.run
            .as_ref()
            .map_or_else(|| self.experiment.name.clone(), CampaignRun::name)
    }

    fn as_read(&self, point: &SweepPoint) -> ImpedancePoint {
        analysis::spectrum::raw_impedance(&point.phasors, self.experiment.bench.wiring.shunt.r_ohm)
    }

    /// Returns the sweep's entry for the index.
    pub(super) fn entry(
        &self,
        executor: &Executor<'_>,
        stage: &Stage,
        start_time_s: f64,
        settled: &Settled,
    ) -> SweepEntry {
        let (experiment, cell) = (self.experiment, self.fixture == Fixture::Cell);
        let group = if cell { "eis" } else { "eis_shunt" };
        let driven = stage.steps.iter().find_map(|step| {
            if let Step::Sine { amplitude_a, .. } = step {
                Some(*amplitude_a)
            } else {
                None
            }
        });
        let amplitude_a = driven.unwrap_or(Amps::NAN).value();
        let several = experiment
            .eis
            .as_ref()
            .is_some_and(|eis| eis.steps_a.len() > 1);
        let group = if several {
            format!("{group}_{amplitude_a}A")
        } else {
            group.to_owned()
        };
        let (group, conditions) = if self.bias_a == 0.0 {
            (group, Vec::new())
        } else {
            let group = format!("{group}_bias{:+}A", self.bias_a);
            (group, self.conditions(&settled.points))
        };
        let corrected = self.correction.reduced_chi2.is_some();
        let phasors: Vec<ChannelPhasors> =
            settled.points.iter().map(|point| point.phasors).collect();
        let common_mode = common_mode(&phasors, experiment.bench.wiring.shunt.r_ohm);
        SweepEntry {
            file: self.indexed().to_owned(),
            fixture: fixture_name(self.fixture).to_owned(),
            cell: self.run.as_ref().map(|run| run.cell.name.clone()),
            fixture_ohm: (!cell)
                .then_some(fixture_check::known(&experiment.bench, self.fixture).r_ohm),
            corrected,
            amplitude_a,
            bias_a: self.bias_a,
            repeat: self.run.as_ref().map_or(self.repeat, |run| run.repeat),
            order: executor.rig.recorder.measured(),
            start_time_s,
            start_ocv_v: executor
                .known
                .idle
                .voltage_v
                .filter(|_| cell)
                .map(Volts::value),
            temperature_degc: executor
                .known
                .idle
                .temperature_degc
                .filter(|_| cell)
                .map(Celsius::value),
            role: Role::Train,
            repeat_group: self.run.as_ref().map_or(group, |run| match run.point {
                // Each is at another charge or temperature.
                Some(_) => format!("eis_{}", run.name()),
                None => format!("eis_{}", run.cell.name),
            }),
            flagged: Vec::new(),
            own_sigma_ohm: if corrected {
                own_sigma_ohm(&settled.own_noise)
            } else {
                Vec::new()
            },
            common_error: if cell && corrected {
                self.correction.common_error(&phasors, &self.shunt)
            } else {
                None
            },
            below_ohm: common_mode.map(|common_mode| common_mode.r_ohm),
            below_h: common_mode.map(|common_mode| common_mode.l_h),
            elapsed_s: settled
                .points
                .iter()
                .map(|point| point.time_s.value() - start_time_s)
                .collect(),
            conditions,
        }
    }
}

/// Returns the channel phasors of the shunt from the fixture check.
pub(super) fn shunt_phasors(measured: &Measured) -> Vec<ChannelPhasors> {
    phasors_of(measured, Fixture::Shunt)
}

/// Returns the channel phasors of a control.
fn phasors_of(measured: &Measured, fixture: Fixture) -> Vec<ChannelPhasors> {
    let all = measured
        .sweeps
        .get(fixture_name(fixture))
        .into_iter()
        .flatten();
    // The correction was computed without refused points, too.
    all.filter(|point| point.failing.is_empty())
        .map(|point| point.phasors)
        .collect()
}

/// Returns the channel phasors of the fake cell before the first cell; empty without one.
pub(super) fn jig_phasors(measured: &Measured) -> Vec<ChannelPhasors> {
    phasors_of(measured, Fixture::FakeCell)
}

/// Adds the shared errors of the correction to a spectrum of a cell; `jig` contains the channel
/// phasors of the fake cell.
pub(super) fn with_shared(
    spectrum: Spectrum,
    phasors: &[ChannelPhasors],
    correction: &Correction,
    jig: &[ChannelPhasors],
) -> Spectrum {
    let text = serde_json::to_string(correction).unwrap_or_default();
    let run: String = bench_plan::support::hash::sha256(text)
        .chars()
        .take(12)
        .collect();
    // Selected by the control in the jig, so that they are the same for every sweep of the run.
    correction.with_shared(
        spectrum,
        phasors,
        &CorrectionModes::new(correction, jig, &run),
    )
}

/// Writes a spectrum with its shared errors beside its own file; does nothing if there are none.
pub(super) fn write_shared(
    recorder: &Recorder,
    file: &str,
    spectrum: &Spectrum,
    flags: &[String],
) -> Result<(), RecordError> {
    if spectrum.shared.is_empty() {
        return Ok(());
    }
    recorder.whole_spectrum(&run_folder::shared_spectrum(file), spectrum, flags)
}

/// Returns the impedance between the lower tap and the ground of the channels. The resistance is
/// the median over the points, the inductance that over the upper half of the frequencies, where
/// it is visible. `None` without any points.
pub(super) fn common_mode(
    phasors: &[ChannelPhasors],
    shunt_ohm: f64,
) -> Option<CommonModeImpedance> {
    let of = |point: &ChannelPhasors| {
        let [low, high, tap, _] = point.volts;
        (
            std::f64::consts::TAU * point.freq_hz,
            tap * shunt_ohm / (high - low),
        )
    };
    let mut all: Vec<(f64, Complex64)> = phasors
        .iter()
        .map(of)
        .filter(|(_, z_ohm)| z_ohm.is_finite())
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let upper = all[all.len() / 2..]
        .iter()
        .filter(|(omega, _)| *omega > 0.0);
    let l_h = median(upper.map(|(omega, z_ohm)| z_ohm.im / omega)).unwrap_or(0.0);
    median(all.iter().map(|(_, z_ohm)| z_ohm.re)).map(|r_ohm| CommonModeImpedance { r_ohm, l_h })
}

/// Returns the median.
fn median(of: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = of.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// Returns the standard deviations of both parts of each point.
pub(super) fn own_sigma_ohm(own_noise: &Spectrum) -> Vec<[f64; 2]> {
    let sigma: Vec<[f64; 2]> = own_noise
        .points
        .iter()
        .map(|point| [point.covariance.re_re, point.covariance.im_im].map(|v| v.max(0.0).sqrt()))
        .collect();
    // JSON cannot represent a value that is not a number.
    if sigma.iter().flatten().all(|sigma| sigma.is_finite()) {
        sigma
    } else {
        Vec::new()
    }
}

/// Returns for each point why the quality gate refused it, as text of the tables; empty for the
/// others.
pub(super) fn flag_texts(points: &[SweepPoint]) -> Vec<String> {
    points
        .iter()
        .map(|point| {
            point
                .failing
                .iter()
                .map(ToString::to_string)
                .collect::<Vec<_>>()
                .join("; ")
        })
        .collect()
}

/// Returns the points that the quality gate refused to the end, with texts for the index, and
/// reports each.
pub(super) fn flags(points: &[SweepPoint], tell: &mut dyn FnMut(f64, &str)) -> Vec<FlaggedPoint> {
    let mut flagged = Vec::new();
    for point in points.iter().filter(|point| !point.failing.is_empty()) {
        let freq_hz = point.phasors.freq_hz;
        for failing in &point.failing {
            tell(
                freq_hz,
                &format!(
                    "flagged by the quality gate after {} records: {}",
                    point.captures, failing.criterion
                ),
            );
        }
        flagged.push(FlaggedPoint {
            freq_hz,
            reasons: point.failing.iter().map(ToString::to_string).collect(),
        });
    }
    flagged
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis::spectrum::PhasorVariance;

    /// 2 A through a shunt of 10 mΩ that lies 5 mΩ above ground, and through wires of 35 mΩ and 20
    /// nH below the cell.
    #[test]
    fn what_lies_below_the_cell_is_a_resistance_and_an_inductance() {
        let point = |freq_hz: f64| {
            let common_mode = Complex64::new(35e-3, std::f64::consts::TAU * freq_hz * 20e-9);
            let volts = [
                Complex64::new(10e-3, 0.0),
                Complex64::new(30e-3, 0.0),
                2.0 * common_mode,
                2.0 * common_mode + 0.02,
            ];
            ChannelPhasors {
                freq_hz,
                volts,
                variance: [PhasorVariance::circular(1e-12); 4],
            }
        };
        let met = common_mode(&[point(1.0), point(100.0), point(1e4)], 10e-3).unwrap();
        assert!(
            (met.r_ohm - 35e-3).abs() < 1e-12 && (met.l_h - 20e-9).abs() < 1e-15,
            "{met:?}"
        );
        assert_eq!(common_mode(&[], 10e-3), None);
        let still = ChannelPhasors {
            volts: [Complex64::ZERO; 4],
            ..point(1.0)
        };
        assert_eq!(common_mode(&[still], 10e-3), None, "no current");
    }
}
