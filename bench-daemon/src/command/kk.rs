//! `eis-bench kk`: validates spectra by Kramers–Kronig, Z-HIT, linearity and stationarity tests,
//! and computes the distribution of relaxation times.

mod records;

use crate::command::batch::{Batch, Choice, Plots, TableArgs, work_on_spectra};
use bench_core::{operator::progress::Waiting, safety::failure::Failure};
use bench_evaluate::{
    figures::validity::plots,
    files,
    support::present::{refused_in_words, significant},
};
use bench_plan::support::terminal::{remark, say};
use std::path::{Path, PathBuf};

use analysis::{
    drt::{Drt, drt, start_values},
    model::RcBranch,
    rows::ValidityRows,
    spectrum::{SourcedSpectrum, Spectrum},
    validity::{
        Assessed, Assessment, Grade, Linearity, Noise, NoiseSource, Record, Stationarity, assess,
        thinned,
    },
};
use serde::Serialize;

/// Arguments of `kk`.
#[derive(Debug, clap::Args)]
pub struct KkArgs {
    /// Spectra in any format that `fit` reads. Spectra of one cell count as repeats in order of
    /// time, or as a series of amplitudes.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Treat files that do not name a cell as different cells (or states), not as repeats of one.
    #[arg(long)]
    pub separate: bool,
    /// Compute the distribution of relaxation times too, with start values for a fit.
    #[arg(long)]
    pub drt: bool,
    /// Properties of the records: CSV with `freq_hz` and any of `periods,drift_over_amplitude`,
    /// `h2,sigma_h2`, `h3,sigma_h3`, … (relative to the fundamental).
    #[arg(long, value_name = "FILE")]
    pub records: Option<PathBuf>,
    /// Many spectra as one table, each judged by itself.
    #[command(flatten)]
    pub many: TableArgs,
    /// Write plots and `kk.json` into this folder; with --table only pictures.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Branches offered to a fit as start values.
const START_BRANCHES: usize = 4;
/// Maximum number of spectra of a cell that are shown with the table of their points.
const SHOWN_WHOLE: usize = 2;

/// The spectra of one cell and their assessment.
#[derive(Debug, Serialize)]
struct Group {
    cell: String,
    #[serde(flatten)]
    assessment: Assessment,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    drt: Vec<Distribution>,
    #[serde(skip)]
    measured: Vec<Spectrum>,
}

/// A distribution and the start values it gives.
#[derive(Debug, Serialize)]
struct Distribution {
    name: String,
    #[serde(flatten)]
    drt: Drt,
    start: Vec<RcBranch>,
}

/// Assesses spectra, prints the results, and writes plots into a folder if requested.
///
/// # Errors
/// A file or an argument that is not as expected; a folder that cannot be written.
pub fn kk(args: &KkArgs) -> Result<(), Failure> {
    if let Some(table) = &args.many.table {
        return rows(args, table);
    }
    let records = args
        .records
        .as_deref()
        .map_or(Ok(Vec::new()), records::read)?;
    let waiting = Waiting::on(format!("reading {} files", args.files.len()));
    let cells = read(args)?;
    if let Some(path) = &args.records {
        records::belong(
            path,
            &records,
            &cells
                .iter()
                .flat_map(|(_, spectra)| spectra)
                .collect::<Vec<_>>(),
        )?;
    }
    let records: Vec<Record> = records.into_iter().map(|(_, record)| record).collect();
    let groups: Vec<Group> = cells
        .into_iter()
        .map(|(cell, spectra)| {
            waiting.say(format!("testing {} spectra of {cell}", spectra.len()));
            group(cell, spectra, &records, args.drt)
        })
        .collect::<Result<_, _>>()?;
    waiting.end();
    if let Some(folder) = &args.out {
        write(folder, &groups, args.many.plots)?;
    }
    if args.json {
        say!("{}", json(&groups)?);
        return Ok(());
    }
    groups.iter().for_each(print);
    if let Some(folder) = &args.out {
        say!("written to {}", folder.display());
    }
    Ok(())
}

fn json(groups: &[Group]) -> Result<String, Failure> {
    serde_json::to_string_pretty(groups).map_err(|error| Failure::Analysis(error.to_string()))
}

/// One row for each spectrum.
fn rows(args: &KkArgs, table: &Path) -> Result<(), Failure> {
    for (name, given) in [("--json", args.json), ("--records", args.records.is_some())] {
        if given {
            return Err(Failure::Usage(format!(
                "{name}: expected no --table beside it: a table has one row for each spectrum"
            )));
        }
    }
    let choice = Choice {
        from_hz: 0.0,
        to_hz: f64::INFINITY,
        refused_points: true,
        cells_only: false,
        run_slopes: false,
    };
    let kind = ValidityRows { drt: args.drt };
    let batch = Batch {
        files: &args.files,
        choice,
        table,
        call: format!("kk {kind:?} {choice:?}"),
        pictures: args.many.pictures(args.out.as_deref())?,
    };
    work_on_spectra(batch, &kind)
}

/// The spectra by cell, in the order of their first.
fn read(args: &KkArgs) -> Result<Vec<(String, Vec<Spectrum>)>, Failure> {
    let mut cells: Vec<(String, Vec<Spectrum>)> = Vec::new();
    for file in &args.files {
        for SourcedSpectrum {
            origin,
            spectrum,
            flagged,
        } in files::read_spectra(file)?
        {
            if !flagged.is_empty() {
                let (name, refusals) = (&spectrum.name, refused_in_words(&flagged));
                remark!(
                    "{name}: the quality gate refused {} points, which are judged with the others: \
                    {refusals}",
                    flagged.len()
                );
            }
            let bias = origin
                .bias_a
                .filter(|bias| *bias != 0.0)
                .map_or_else(String::new, |bias| format!(", {bias:+} A"));
            let cell = match (&origin.fixture, &origin.cell) {
                (Some(fixture), Some(cell)) => format!("{fixture} {cell}{bias}"),
                (Some(fixture), None) => format!("{fixture}{bias}"),
                _ if args.separate || origin.curve.is_some() => spectrum.name.clone(),
                _ => format!("one cell{bias}"),
            };
            match cells.iter_mut().find(|(name, _)| *name == cell) {
                Some((_, spectra)) => spectra.push(spectrum),
                None => cells.push((cell, vec![spectrum])),
            }
        }
    }
    Ok(cells)
}

fn group(
    cell: String,
    measured: Vec<Spectrum>,
    records: &[Record],
    with_drt: bool,
) -> Result<Group, Failure> {
    let assessment =
        assess(&measured, records).map_err(|error| Failure::Usage(error.to_string()))?;
    // The plots and the distribution use the assessed points.
    let measured: Vec<Spectrum> = measured
        .into_iter()
        .map(|spectrum| thinned(&spectrum).unwrap_or(spectrum))
        .collect();
    let distribution = |spectrum: &Spectrum| {
        let noise =
            Noise::of(spectrum, &measured).map_err(|error| Failure::Usage(error.to_string()))?;
        // The ladder follows what points share; resistances of the distribution are as uncertain as
        // the whole.
        let drt = drt(spectrum, &noise.with_shared(spectrum))
            .map_err(|error| Failure::Usage(error.to_string()))?;
        Ok(Distribution {
            name: spectrum.name.clone(),
            start: start_values(&drt, START_BRANCHES),
            drt,
        })
    };
    let drt = if with_drt {
        measured
            .iter()
            .map(distribution)
            .collect::<Result<_, Failure>>()?
    } else {
        Vec::new()
    };
    Ok(Group {
        cell,
        assessment,
        drt,
        measured,
    })
}

fn write(folder: &Path, groups: &[Group], plots: Option<Plots>) -> Result<(), Failure> {
    files::make_folder(folder)?;
    files::write_text(folder, "kk.json", &json(groups)?)?;
    let spectra = groups.iter().map(|group| group.measured.len()).sum();
    let plots = Plots::chosen(plots, spectra);
    let draws = |assessed: &Assessed| plots.draws(assessed.verdict.grade != Grade::Good);
    for group in groups {
        for (assessed, measured) in group.assessment.spectra.iter().zip(&group.measured) {
            if !draws(assessed) {
                continue;
            }
            files::write_chart(
                folder,
                &format!("kk_{}", assessed.name),
                &plots::residuals(assessed),
            )?;
            files::write_chart(
                folder,
                &format!("zhit_{}", assessed.name),
                &plots::z_hit(assessed, measured),
            )?;
        }
        let judged = group.assessment.spectra.iter();
        for (_, distribution) in judged.zip(&group.drt).filter(|(judged, _)| draws(judged)) {
            files::write_chart(
                folder,
                &format!("drt_{}", distribution.name),
                &plots::drt(&distribution.name, &distribution.drt),
            )?;
        }
    }
    Ok(())
}

fn print(group: &Group) {
    let assessment = &group.assessment;
    say!("{}:", group.cell);
    for (assessed, measured) in assessment.spectra.iter().zip(&group.measured) {
        print_spectrum(assessed, assessment.spectra.len() <= SHOWN_WHOLE);
        let zero = measured.points.iter().find(|p| {
            p.covariance.is_valid() && (p.covariance.re_re == 0.0 || p.covariance.im_im == 0.0)
        });
        if let Some(point) = zero {
            say!(
                "    the stated uncertainty was ignored: it is zero at {} Hz",
                significant(point.freq_hz, 4)
            );
        }
    }
    assessment.linearity.iter().for_each(print_linearity);
    assessment.stationarity.iter().for_each(print_stationarity);
    group.drt.iter().for_each(print_drt);
}

fn print_linearity(linearity: &Linearity) {
    let Some(worst) = linearity
        .points
        .iter()
        .max_by(|a, b| a.change_percent.total_cmp(&b.change_percent))
    else {
        return;
    };
    let (low, high) = linearity.amplitudes_a;
    let changes = match linearity
        .points
        .iter()
        .filter(|point| point.nonlinear)
        .count()
    {
        0 => "no change beyond noise".to_owned(),
        count => format!("Z changes at {count} frequencies"),
    };
    say!(
        "  linearity, {} A to {} A: {changes}; largest change {:.2} ± {:.2} % at {} Hz",
        significant(low, 3),
        significant(high, 3),
        worst.change_percent,
        worst.sigma_percent,
        significant(worst.freq_hz, 3)
    );
}

fn print_stationarity(stationarity: &Stationarity) {
    let scatter = stationarity
        .points
        .iter()
        .map(|point| point.scatter_percent.powi(2))
        .sum::<f64>()
        / stationarity.points.len() as f64;
    let excess = stationarity
        .excess_percent
        .map_or_else(String::new, |excess| {
            format!(", {excess:.2} % of it beyond the noise")
        });
    let shifts: Vec<String> = stationarity
        .shift_percent
        .iter()
        .map(|shift| format!("{shift:+.2}"))
        .collect();
    let trend = match stationarity
        .points
        .iter()
        .filter(|point| point.drifts())
        .count()
    {
        0 => "no trend".to_owned(),
        count => format!("a trend at {count} frequencies"),
    };
    say!(
        "  stationarity, {} repeats: scatter {:.2} % of |Z|{excess}; {trend}",
        stationarity.repeats.len(),
        scatter.sqrt()
    );
    say!("    repeats against their mean, %: {}", shifts.join(" "));
}

fn print_spectrum(assessed: &Assessed, whole: bool) {
    let kk = &assessed.kramers_kronig;
    let source = match kk.noise {
        NoiseSource::Stated => "as stated",
        NoiseSource::Repeats => "from repeats",
        NoiseSource::Smoother => "estimated from the spectrum itself",
    };
    say!(
        "  {}: {}: {}",
        assessed.name,
        assessed.verdict.grade,
        assessed.verdict.text
    );
    say!(
        "    {} RC (µ alone: {}), µ {:.2}, reduced χ² {:.2} (p {:.2}), noise {} % of |Z| {source}",
        kk.order,
        kk.mu_order
            .map_or_else(|| "none".to_owned(), |order| order.to_string()),
        kk.mu,
        kk.chi2 / kk.dof,
        kk.p,
        significant(kk.noise_percent, 2)
    );
    let points = || {
        kk.points
            .iter()
            .zip(&assessed.z_hit.points)
            .zip(&assessed.verdict.points)
    };
    if !whole && points().all(|(_, verdict)| verdict.grade == Grade::Good) {
        return;
    }
    say!("       f / Hz   Re: Δ / %     ±σ   Im: Δ / %     ±σ   size / σ   Z-HIT: Δ / %     ±σ");
    for ((kk, hit), verdict) in
        points().filter(|(_, verdict)| whole || verdict.grade != Grade::Good)
    {
        say!(
            "    {:>9}  {:>+9.3}  {:>7.3} {:>+9.3}  {:>7.3} {:>10} {:>+13.3}  {:>7.3}  {}",
            significant(kk.freq_hz, 4),
            kk.re_percent,
            kk.sigma_re_percent,
            kk.im_percent,
            kk.sigma_im_percent,
            if kk.tested {
                format!("{:.1}", kk.sigmas)
            } else {
                "–".to_owned()
            },
            hit.deviation_percent,
            hit.sigma_percent,
            if verdict.grade == Grade::Good {
                String::new()
            } else {
                verdict.grade.to_string()
            }
        );
    }
}

fn print_drt(distribution: &Distribution) {
    let Distribution { name, drt, start } = distribution;
    let milli = |estimate: analysis::drt::Estimate| {
        format!(
            "{:.4} ± {:.4} mΩ",
            1.0e3 * estimate.value,
            1.0e3 * estimate.sigma
        )
    };
    say!(
        "  {name}: R∞ {}, polarisation {} up to the slow end of the band",
        milli(drt.r_inf_ohm),
        milli(drt.polarisation_ohm)
    );
    for peak in &drt.peaks {
        say!(
            "    peak at {:>9} s: {:.4} ± {:.4} mΩ, {:.2} decades wide{}",
            significant(peak.tau_s, 3),
            1.0e3 * peak.r_ohm,
            1.0e3 * peak.sigma_ohm,
            peak.width_decades,
            if peak.in_band {
                ""
            } else {
                " (beyond the band: a guess)"
            }
        );
    }
    if let Some(slow_loop) = &drt.slow_loop {
        say!("    {}", slow_loop.in_words());
    }
    let branches = start
        .iter()
        .map(|rc| format!("{:.3} mΩ ∥ {} F", 1.0e3 * rc.r_ohm, significant(rc.c_f, 3)));
    let branches = branches.collect::<Vec<_>>();
    say!(
        "    start values: {}",
        if branches.is_empty() {
            "none, no resistance stands out of the noise".to_owned()
        } else {
            branches.join(", ")
        }
    );
}
