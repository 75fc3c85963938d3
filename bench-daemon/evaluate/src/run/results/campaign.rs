//! Results of a campaign beyond its spectra: the differences between cells, and between repeats of
//! one cell.

use analysis::{
    fit::ErmFit,
    plot::{self, ImpedancePlot, Series, SeriesStyle},
    report::{Figure, Table},
    run_folder,
    spectrum::{ImpedancePoint, Spectrum},
};
use num_complex::Complex64;
use serde::Serialize;

use crate::{run::Measured, support::present::significant};
use bench_core::{record::Recorder, safety::failure::Failure};
use bench_plan::{
    config::{Campaign, Experiment},
    plan::{CampaignRun, Specimen},
};

use super::validity::Judged;

/// Greatest number of frequencies in the table of the report.
const ROWS: usize = 20;

/// Mean and spread at one frequency.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Spread {
    /// Frequency, Hz.
    freq_hz: f64,
    /// Number of spectra with this frequency.
    spectra: usize,
    /// Mean of the cells' means, Ω.
    mean_re_ohm: f64,
    mean_im_ohm: f64,
    /// Standard deviation of the cells' means, real and imaginary part, Ω; `None` for a single
    /// cell. It includes the scatter of the repeats, divided by their number.
    cells_re_ohm: Option<f64>,
    cells_im_ohm: Option<f64>,
    /// Standard deviation of the repeats of one cell around its mean, over all cells, Ω; `None`
    /// without repeats.
    repeats_re_ohm: Option<f64>,
    repeats_im_ohm: Option<f64>,
    /// Standard deviations of the magnitude, relative to its mean.
    cells_magnitude_rel: Option<f64>,
    repeats_magnitude_rel: Option<f64>,
    /// Uncertainty that a single spectrum states, rms over all, Ω.
    stated_re_ohm: f64,
    stated_im_ohm: f64,
}

#[derive(Serialize)]
struct RunRow {
    number: usize,
    cell: String,
    repeat: usize,
    file: String,
    start_time_s: f64,
    start_ocv_v: Option<f64>,
    #[serde(rename = "temperature_c")]
    temperature_degc: Option<f64>,
    /// Kramers–Kronig, Z-HIT, harmonics and drift.
    validity: String,
    /// Whether the state of charge differs from the requested one.
    soc_missed: bool,
    /// Warnings about the run.
    notes: Vec<String>,
}

#[derive(Serialize)]
struct ModelRow {
    rc: usize,
    file: String,
    r_ohm: f64,
    dc_resistance_ohm: f64,
    rms_ohm: f64,
    reduced_chi2: Option<f64>,
}

#[derive(Serialize)]
struct CampaignFile<'a> {
    schema: &'static str,
    name: &'a str,
    cells: Vec<&'a Specimen>,
    repeats: usize,
    runs: Vec<RunRow>,
    models: Vec<ModelRow>,
    spread: &'a [Spread],
}

/// Additions of a campaign to the report and the summary.
pub(super) struct CampaignResults {
    pub(super) figure: Figure,
    pub(super) table: Table,
    pub(super) text: String,
}

/// Writes `spread.csv`, `campaign.json` and the picture of all spectra.
pub(super) fn write(
    recorder: &Recorder,
    experiment: &Experiment,
    campaign: &Campaign,
    measured: &Measured,
    fits: &[ErmFit],
    judged: &[Judged],
) -> Result<CampaignResults, Failure> {
    let spectra: Vec<&Spectrum> = measured.spectra().collect();
    let cell_of = |spectrum: &Spectrum| {
        campaign
            .runs()
            .find(|run| run.name() == spectrum.name)
            .map_or(0, |run| run.cell.number)
    };
    let cells: Vec<(usize, &Spectrum)> = spectra
        .iter()
        .map(|spectrum| (cell_of(spectrum), *spectrum))
        .collect();
    let spread = spread(&cells);
    recorder.text(run_folder::SPREAD, &csv(&spread))?;
    let models = fits.iter().map(|fit| ModelRow {
        rc: fit.erm.branches.len(),
        file: run_folder::model(fit.erm.branches.len()),
        r_ohm: fit.erm.r_ohm,
        dc_resistance_ohm: fit.erm.dc_resistance_ohm(),
        rms_ohm: fit.rms_ohm,
        reduced_chi2: fit.reduced_chi2,
    });
    let file = CampaignFile {
        schema: run_folder::CAMPAIGN_SCHEMA,
        name: &experiment.name,
        cells: campaign.cells.iter().map(AsRef::as_ref).collect(),
        repeats: campaign.repeats,
        runs: runs(recorder, campaign, judged),
        models: models.collect(),
        spread: &spread,
    };
    recorder.json(run_folder::CAMPAIGN, &file)?;
    let plot = picture(experiment, campaign, &cells, &spread);
    let drawn = |error: plot::PlotError| Failure::Analysis(error.to_string());
    for extension in ["svg", "png"] {
        plot::nyquist(
            &plot,
            &recorder
                .path(run_folder::PLOTS)
                .join(format!("campaign.{extension}")),
        )
        .map_err(drawn)?;
    }
    let caption = "All spectra of the campaign, a colour for each cell, and the mean of the cells."
        .to_owned();
    let figure = Figure {
        svg: plot::nyquist_svg(&plot).map_err(drawn)?,
        caption,
    };
    Ok(CampaignResults {
        figure,
        table: table(&spread),
        text: in_words(campaign, spectra.len(), &spread),
    })
}

fn runs(recorder: &Recorder, campaign: &Campaign, judged: &[Judged]) -> Vec<RunRow> {
    let warnings = recorder.warnings();
    let row = |run: CampaignRun| {
        let file = run_folder::campaign_spectrum(&run.name());
        let entry = recorder
            .index()
            .sweeps
            .iter()
            .find(|entry| entry.file == file)?;
        let prefix = run.prefix();
        let notes: Vec<String> = warnings
            .iter()
            .filter_map(|warning| warning.strip_prefix(&prefix))
            .map(str::to_owned)
            .collect();
        Some(RunRow {
            number: run.number,
            cell: run.cell.name.clone(),
            repeat: run.repeat,
            file,
            start_time_s: entry.start_time_s,
            start_ocv_v: entry.start_ocv_v,
            temperature_degc: entry.temperature_degc,
            validity: judged
                .iter()
                .find(|one| one.name == run.name())
                .map_or_else(|| "not tested".to_owned(), Judged::grade),
            soc_missed: recorder.soc_missed().any(|note| note.starts_with(&prefix)),
            notes,
        })
    };
    campaign.runs().filter_map(row).collect()
}

/// Returns mean and spread at each frequency of the first spectrum.
fn spread(cells: &[(usize, &Spectrum)]) -> Vec<Spread> {
    let Some((_, first)) = cells.first() else {
        return Vec::new();
    };
    first
        .points
        .iter()
        .map(|point| spread_at(point.freq_hz, cells))
        .collect()
}

fn spread_at(freq_hz: f64, cells: &[(usize, &Spectrum)]) -> Spread {
    let mut groups: std::collections::BTreeMap<usize, Vec<&ImpedancePoint>> =
        std::collections::BTreeMap::new();
    for (cell, spectrum) in cells {
        groups.entry(*cell).or_default().extend(
            spectrum
                .points
                .iter()
                .find(|point| point.freq_hz == freq_hz),
        );
    }
    let groups: Vec<Vec<&ImpedancePoint>> = groups
        .into_values()
        .filter(|group| !group.is_empty())
        .collect();
    let of = |part: fn(&ImpedancePoint) -> f64| Scatter::of(&groups, part);
    let (re, im, magnitude) = (
        of(|p| p.z_ohm.re),
        of(|p| p.z_ohm.im),
        of(ImpedancePoint::magnitude_ohm),
    );
    let rms = |part: fn(&ImpedancePoint) -> f64| {
        let all: Vec<f64> = groups.iter().flatten().map(|point| part(point)).collect();
        (all.iter().sum::<f64>() / all.len() as f64).sqrt()
    };
    let share = |sd: Option<f64>| sd.map(|sd| sd / magnitude.mean);
    Spread {
        freq_hz,
        spectra: groups.iter().map(Vec::len).sum(),
        mean_re_ohm: re.mean,
        mean_im_ohm: im.mean,
        cells_re_ohm: re.cells,
        cells_im_ohm: im.cells,
        repeats_re_ohm: re.repeats,
        repeats_im_ohm: im.repeats,
        cells_magnitude_rel: share(magnitude.cells),
        repeats_magnitude_rel: share(magnitude.repeats),
        stated_re_ohm: rms(|p| p.covariance.re_re),
        stated_im_ohm: rms(|p| p.covariance.im_im),
    }
}

/// Mean of the groups' means, their standard deviation, and that within the groups.
struct Scatter {
    mean: f64,
    cells: Option<f64>,
    repeats: Option<f64>,
}

impl Scatter {
    fn of(groups: &[Vec<&ImpedancePoint>], part: fn(&ImpedancePoint) -> f64) -> Self {
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let squares = |values: &[f64], around: f64| {
            values
                .iter()
                .map(|value| (value - around).powi(2))
                .sum::<f64>()
        };
        let groups: Vec<Vec<f64>> = groups
            .iter()
            .map(|group| group.iter().map(|point| part(point)).collect())
            .collect();
        let means: Vec<f64> = groups.iter().map(|group| mean(group)).collect();
        let all = mean(&means);
        let sd =
            |squares: f64, freedom: usize| (freedom > 0).then(|| (squares / freedom as f64).sqrt());
        let within = groups
            .iter()
            .zip(&means)
            .map(|(group, mean)| squares(group, *mean))
            .sum();
        let freedom = groups.iter().map(|group| group.len() - 1).sum();
        Self {
            mean: all,
            cells: sd(squares(&means, all), means.len().saturating_sub(1)),
            repeats: sd(within, freedom),
        }
    }
}

fn csv(spread: &[Spread]) -> String {
    let mut text = format!("{}\n", run_folder::SPREAD_COLUMNS);
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    for s in spread {
        let cells = [
            s.mean_re_ohm,
            s.mean_im_ohm,
            number(s.cells_re_ohm),
            number(s.cells_im_ohm),
            number(s.repeats_re_ohm),
            number(s.repeats_im_ohm),
            number(s.cells_magnitude_rel),
            number(s.repeats_magnitude_rel),
            s.stated_re_ohm,
            s.stated_im_ohm,
        ];
        let cells: Vec<String> = cells.iter().map(|cell| format!("{cell}")).collect();
        text.push_str(&format!(
            "{},{},{}\n",
            s.freq_hz,
            s.spectra,
            cells.join(",")
        ));
    }
    text
}

fn picture(
    experiment: &Experiment,
    campaign: &Campaign,
    cells: &[(usize, &Spectrum)],
    spread: &[Spread],
) -> ImpedancePlot {
    let mut seen = Vec::new();
    let mut series: Vec<Series> = Vec::new();
    for (cell, spectrum) in cells {
        let name = campaign
            .cells
            .iter()
            .find(|known| known.number == *cell)
            .map_or_else(String::new, |known| format!("cell {}", known.name));
        let label = (!seen.contains(cell)).then_some(name.as_str());
        series.push(
            spectrum
                .series(cell.saturating_sub(1))
                .styled(SeriesStyle::Cloud)
                .labelled(label),
        );
        seen.push(*cell);
    }
    let unknown = analysis::numeric::Covariance2::UNKNOWN;
    let point = |s: &Spread| ImpedancePoint {
        freq_hz: s.freq_hz,
        z_ohm: Complex64::new(s.mean_re_ohm, s.mean_im_ohm),
        covariance: unknown,
        amplitude_a: f64::NAN,
    };
    let mean = Spectrum {
        name: "mean of the cells".to_owned(),
        points: spread.iter().map(point).collect(),
        ..Spectrum::default()
    };
    series.push(mean.series(campaign.cells.len()).styled(SeriesStyle::Curve));
    ImpedancePlot::new(
        &format!("All {} spectra of the campaign", cells.len()),
        &experiment.cell.name,
        series,
    )
}

fn percent(share: Option<f64>) -> String {
    share.map_or_else(|| "–".to_owned(), |share| significant(100.0 * share, 3))
}

fn table(spread: &[Spread]) -> Table {
    let step = spread.len().div_ceil(ROWS).max(1);
    let row = |s: &Spread| {
        let milliohms = |ohms: f64| significant(1.0e3 * ohms, 5);
        vec![
            significant(s.freq_hz, 6),
            milliohms(s.mean_re_ohm),
            milliohms(s.mean_im_ohm),
            percent(s.cells_magnitude_rel),
            percent(s.repeats_magnitude_rel),
        ]
    };
    let header = [
        "f / Hz",
        "mean Re Z / mΩ",
        "mean Im Z / mΩ",
        "between cells / % of |Z|",
        "between repeats / % of |Z|",
    ];
    Table {
        caption: "How much the cells differ, and repeats of one cell among themselves (standard \
        deviations)"
            .to_owned(),
        header: header.map(str::to_owned).to_vec(),
        rows: spread.iter().step_by(step).map(row).collect(),
    }
}

fn in_words(campaign: &Campaign, spectra: usize, spread: &[Spread]) -> String {
    let median = |share: fn(&Spread) -> Option<f64>| {
        let mut all: Vec<f64> = spread.iter().filter_map(share).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied()
    };
    let (cells, repeats) = (
        median(|s| s.cells_magnitude_rel),
        median(|s| s.repeats_magnitude_rel),
    );
    format!(
        "campaign: {spectra} spectra of {} cells; |Z| differs by {} % between cells and by {} % \
        between repeats of one cell (medians over frequency)",
        campaign.cells.len(),
        percent(cells),
        percent(repeats)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis::numeric::Covariance2;

    #[test]
    fn cells_and_repeats_are_distinguished() {
        let spectrum = |re: f64| Spectrum {
            name: String::new(),
            points: vec![ImpedancePoint {
                freq_hz: 1.0,
                z_ohm: Complex64::new(re, -0.001),
                covariance: Covariance2 {
                    re_re: 4.0e-12,
                    im_im: 1.0e-12,
                    re_im: 0.0,
                },
                amplitude_a: 1.0,
            }],
            ..Spectrum::default()
        };
        let all = [0.009, 0.011, 0.019, 0.021].map(spectrum);
        let cells: Vec<(usize, &Spectrum)> = [1, 1, 2, 2].into_iter().zip(&all).collect();
        let found = spread(&cells);
        let [s] = found.as_slice() else {
            panic!("{found:?}")
        };
        assert_eq!(s.spectra, 4);
        let near = |met: Option<f64>, expected: f64| {
            assert!(
                (met.unwrap() / expected - 1.0).abs() < 1.0e-9,
                "{met:?}, expected {expected}"
            );
        };
        near(Some(s.mean_re_ohm), 0.015);
        // Means of 10 mΩ and 20 mΩ; deviations of 1 mΩ, four of them with two degrees of freedom.
        near(s.cells_re_ohm, 0.01 / 2.0_f64.sqrt());
        near(s.repeats_re_ohm, 0.002 / 2.0_f64.sqrt());
        near(Some(s.stated_re_ohm), 2.0e-6);
        assert_eq!((s.cells_im_ohm, s.repeats_im_ohm), (Some(0.0), Some(0.0)));
        let single = spread(&cells[..1]);
        assert_eq!(
            (single[0].cells_re_ohm, single[0].repeats_re_ohm),
            (None, None)
        );
        assert!(
            csv(&single)
                .lines()
                .nth(1)
                .unwrap()
                .starts_with("1,1,0.009,-0.001,NaN,NaN,NaN,NaN,NaN,NaN,0.000002,"),
            "{}",
            csv(&single)
        );
    }
}
