//! Rows of tests of validity and of relaxation times.

use super::{Cell, ResultColumn, ResultRows, RowValues};
use crate::drt::{Drt, drt};
use crate::validity::{Assessed, Grade, Noise, assess, thinned};
use analysis_signal::spectrum::SourcedSpectrum;

/// Number of peaks of a distribution in the columns, the largest first: more than ten are noise,
/// because a band of six decades can resolve about ten time constants.
const PEAKS: usize = 10;

/// The tests of each spectrum by itself: repeats are not compared.
///
/// Columns: `points`, `grade`, `verdict`, `valid_from_hz`, `valid_to_hz`, `bad_points`,
/// `doubtful_points`, `kk_outcome`, `kk_order`, `kk_mu`, `kk_chi2`, `kk_dof`, `kk_p`,
/// `noise_percent`, `kk_worst_percent` at `kk_worst_hz`, `z_hit_worst_percent` at `z_hit_worst_hz`;
/// with `drt` also `drt_r_inf_ohm`, `drt_inductance_h`, `drt_polarisation_ohm` with their sigmas,
/// `drt_reduced_chi2`, `drt_peaks`, and for the peaks by falling resistance `peak1_tau_s`,
/// `peak1_r_ohm`, `peak1_sigma_ohm`, `peak1_width_decades`, ….
#[derive(Debug, Clone, Copy)]
pub struct ValidityRows {
    /// Whether to compute the distribution of relaxation times.
    pub drt: bool,
}

impl ResultRows for ValidityRows {
    fn own_columns(&self) -> Vec<ResultColumn> {
        let mut columns = vec![
            ResultColumn::count("points"),
            ResultColumn::text("grade"),
            ResultColumn::text("verdict"),
            ResultColumn::number("valid_from_hz"),
            ResultColumn::number("valid_to_hz"),
            ResultColumn::count("bad_points"),
            ResultColumn::count("doubtful_points"),
            ResultColumn::text("kk_outcome"),
            ResultColumn::count("kk_order"),
            ResultColumn::number("kk_mu"),
            ResultColumn::number("kk_chi2"),
            ResultColumn::number("kk_dof"),
            ResultColumn::number("kk_p"),
            ResultColumn::number("noise_percent"),
            ResultColumn::number("kk_worst_percent"),
            ResultColumn::number("kk_worst_hz"),
            ResultColumn::number("z_hit_worst_percent"),
            ResultColumn::number("z_hit_worst_hz"),
        ];
        if self.drt {
            columns.extend(
                [
                    "drt_r_inf_ohm",
                    "drt_r_inf_sigma_ohm",
                    "drt_inductance_h",
                    "drt_inductance_sigma_h",
                    "drt_polarisation_ohm",
                    "drt_polarisation_sigma_ohm",
                    "drt_reduced_chi2",
                ]
                .map(ResultColumn::number),
            );
            columns.push(ResultColumn::count("drt_peaks"));
            for k in 1..=PEAKS {
                columns.extend(
                    [
                        format!("peak{k}_tau_s"),
                        format!("peak{k}_r_ohm"),
                        format!("peak{k}_sigma_ohm"),
                        format!("peak{k}_width_decades"),
                    ]
                    .map(ResultColumn::number),
                );
            }
        }
        columns
    }

    fn values(&self, sourced: &SourcedSpectrum) -> Result<RowValues, String> {
        let spectrum = &sourced.spectrum;
        let all = std::slice::from_ref(spectrum);
        let mut assessed = assess(all, &[]).map_err(|error| error.to_string())?.spectra;
        let assessed = assessed.pop().ok_or("no spectrum was judged")?;
        let mut cells = tests(&assessed, spectrum.points.len());
        if self.drt {
            // As `kk --drt`: by no more points than are judged.
            let judged = thinned(spectrum).unwrap_or_else(|| spectrum.clone());
            let noise = Noise::of(&judged, std::slice::from_ref(&judged));
            let noise = noise.map_err(|error| error.to_string())?;
            let found = drt(&judged, &noise.with_shared(&judged));
            cells.extend(times(&found.map_err(|error| error.to_string())?));
        }
        let grade = assessed.verdict.grade;
        let doubts = (grade != Grade::Good).then(|| assessed.verdict.text.clone());
        Ok(RowValues {
            cells,
            warning_codes: doubts
                .iter()
                .map(|_| format!("grade_{}", grade.name()))
                .collect(),
            warnings: doubts.into_iter().collect(),
            fitted: None,
        })
    }
}

fn tests(assessed: &Assessed, points: usize) -> Vec<Cell> {
    let (verdict, kk) = (&assessed.verdict, &assessed.kramers_kronig);
    let of_grade = |grade| Cell::whole(verdict.points.iter().filter(|p| p.grade == grade).count());
    let kk_worst = kk.worst();
    let z_hit_worst = assessed.z_hit.points.iter().max_by(|a, b| {
        let size = |value: f64| value.abs();
        size(a.deviation_percent).total_cmp(&size(b.deviation_percent))
    });
    vec![
        Cell::whole(points),
        Cell::text(verdict.grade.name()),
        Cell::Text(Some(verdict.text.clone())),
        Cell::Number(verdict.valid_band_hz.map(|band| band.0)),
        Cell::Number(verdict.valid_band_hz.map(|band| band.1)),
        of_grade(Grade::Bad),
        of_grade(Grade::Doubtful),
        Cell::Text(Some(kk.outcome.name().to_owned())),
        Cell::whole(kk.order),
        Cell::finite(kk.mu),
        Cell::finite(kk.chi2),
        Cell::finite(kk.dof),
        Cell::finite(kk.p),
        Cell::finite(kk.noise_percent),
        Cell::Number(kk_worst.map(|point| point.percent())),
        Cell::Number(kk_worst.map(|point| point.freq_hz)),
        Cell::Number(z_hit_worst.map(|point| point.deviation_percent)),
        Cell::Number(z_hit_worst.map(|point| point.freq_hz)),
    ]
}

fn times(found: &Drt) -> Vec<Cell> {
    let mut cells: Vec<Cell> = [
        &found.r_inf_ohm,
        &found.inductance_h,
        &found.polarisation_ohm,
    ]
    .into_iter()
    .flat_map(|estimate| [Cell::finite(estimate.value), Cell::finite(estimate.sigma)])
    .collect();
    cells.extend([
        Cell::finite(found.reduced_chi2),
        Cell::whole(found.peaks.len()),
    ]);
    let mut peaks: Vec<_> = found.peaks.iter().collect();
    peaks.sort_by(|a, b| b.r_ohm.total_cmp(&a.r_ohm));
    for k in 0..PEAKS {
        let peak = peaks.get(k);
        cells.extend(
            [
                peak.map(|peak| peak.tau_s),
                peak.map(|peak| peak.r_ohm),
                peak.map(|peak| peak.sigma_ohm),
                peak.map(|peak| peak.width_decades),
            ]
            .map(Cell::Number),
        );
    }
    cells
}
