//! Arguments of `fit`, and the spectra that they name.

use crate::command::units;
use bench_plan::config::quantity::Frequency;
use std::path::PathBuf;

use analysis::spectrum::{SourcedSpectrum, Spectrum};

use super::{circuit, more};
use crate::command;
use bench_core::safety::failure::Failure;
use bench_evaluate::files;
use bench_plan::support::terminal::remark;

/// Arguments of `fit`.
#[derive(Debug, clap::Args)]
pub struct FitArgs {
    /// Spectra: the project's CSV, impedance.py's plain `f,re,im`, the thesis'
    /// `freq,offset,resistance,theta`, files of the programs that docs/formats.md lists.
    #[arg(required = true, value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// Lowest frequency to fit, Hz.
    #[arg(long, default_value_t = 0.0, value_name = "HZ", value_parser = units::of::<Frequency>)]
    pub from_hz: f64,
    /// Highest frequency to fit, Hz.
    #[arg(
        long,
        default_value_t = f64::INFINITY,
        value_name = "HZ",
        hide_default_value = true,
        value_parser = units::of::<Frequency>
    )]
    pub to_hz: f64,
    /// Also fit points that the quality gate of their measurement refused, marked in the column
    /// `flags`.
    #[arg(long)]
    pub refused_points: bool,
    /// Fit one model to all spectra instead of one to each.
    #[arg(long)]
    pub pool: bool,
    /// Compare spectra with a direct current with those without: the change of each resistance, and
    /// how certain it is. --rc is one number, or `auto`.
    #[arg(long)]
    pub under_current: bool,
    /// The spectra with a direct current are of one cell: compare them with each other as well.
    #[arg(long, requires = "under_current")]
    pub same_cell: bool,
    /// The files are logs of ordinary use: time, current and voltage of a cell, or a table with the
    /// columns `time_s`, `current_a` and a voltage `NAME_v` of each cell of a string. Prints impedance,
    /// model and the weak cell of a string.
    #[arg(long, conflicts_with_all = ["under_current", "pool", "circuit", "table"])]
    pub usage: bool,
    /// Orders: a number of RC pairs, several separated by commas, `all` for 1 to 4, or `auto` for
    /// the order that the data support.
    #[arg(long, default_value = "auto", value_name = "N|all|auto")]
    pub rc: String,
    /// Objective to minimise: `sum-abs` (Σ|Z_model − Z_data|, as the thesis), `modulus` (|Z| only)
    /// or `complex` (least squares).
    #[arg(long, default_value = "complex")]
    pub objective: String,
    /// Charge storage of the cell.
    #[command(flatten)]
    pub slope: command::ocv_slope::SlopeArgs,
    /// A circuit instead of the extended Randles model, and how to fit it.
    #[command(flatten)]
    pub circuit: circuit::CircuitArgs,
    /// Seed of the global search.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Many spectra as one table.
    #[command(flatten)]
    pub many: command::batch::TableArgs,
    /// Write models, plots and a report into this folder; with --table only pictures.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Order, uncertainty and search in depth.
    #[command(flatten)]
    pub more: more::MoreArgs,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// The spectra of the files.
pub(super) struct Spectra {
    /// Cells without a direct current.
    pub(super) cells: Vec<SourcedSpectrum>,
    /// Cells with one.
    pub(super) biased: Vec<SourcedSpectrum>,
    /// Control impedances.
    pub(super) controls: Vec<Spectrum>,
}

/// The spectra to be fitted, and the control impedances that came with them. Sweeps with a bias
/// belong to neither.
pub(crate) fn read(args: &FitArgs) -> Result<(Vec<SourcedSpectrum>, Vec<Spectrum>), Failure> {
    let Spectra {
        cells,
        biased,
        controls,
    } = read_all(args)?;
    let controls_passed_over = controls.iter().map(|spectrum| &spectrum.name);
    let passed_over: Vec<&str> = biased
        .iter()
        .map(|one| &one.spectrum.name)
        .chain(controls_passed_over)
        .map(String::as_str)
        .collect();
    if !passed_over.is_empty() {
        remark!(
            "not fitted, because they are controls or carry a direct current: {}",
            passed_over.join(", ")
        );
    }
    if args.pool {
        files::refuse_curves(&cells)?;
    }
    if cells.is_empty() {
        return Err(Failure::Usage(
            "expected at least one spectrum of a cell without direct current, found none"
                .to_owned(),
        ));
    }
    Ok((cells, controls))
}

/// Reads the files, in the band of the fit and without refused points.
pub(super) fn read_all(args: &FitArgs) -> Result<Spectra, Failure> {
    let mut spectra = Spectra {
        cells: Vec::new(),
        biased: Vec::new(),
        controls: Vec::new(),
    };
    let mut slopes = command::ocv_slope::KnownSlopes::default();
    for file in &args.files {
        // The elements of a circuit define what stores charge. A comparison leaves it in both.
        let is_erm = args.circuit.circuit.is_none() && !args.under_current;
        let slope = is_erm.then(|| slopes.of(&args.slope, file)).flatten();
        for mut sourced in files::read_spectra(file)? {
            sourced
                .spectrum
                .keep(|p| (args.from_hz..=args.to_hz).contains(&p.freq_hz));
            sourced
                .flagged
                .retain(|p| (args.from_hz..=args.to_hz).contains(&p.freq_hz));
            if sourced.spectrum.points.is_empty() {
                let met = format!("none from {} Hz to {} Hz", args.from_hz, args.to_hz);
                return Err(Failure::Usage(format!(
                    "{}: expected frequencies to be fitted, found {met}",
                    file.display()
                )));
            }
            let is_cell = sourced
                .origin
                .fixture
                .as_deref()
                .is_none_or(|f| f == "cell");
            let is_biased = sourced.origin.bias_a.is_some_and(|bias| bias != 0.0);
            match (is_cell, is_biased) {
                (true, false) => {
                    files::leave_out_refused(&mut sourced, args.refused_points)?;
                    if let Some(slope) = slope {
                        sourced.spectrum = sourced.spectrum.less_charge_storage(slope);
                    }
                    spectra.cells.push(sourced);
                }
                (true, true) => {
                    if args.under_current {
                        files::leave_out_refused(&mut sourced, args.refused_points)?;
                    }
                    spectra.biased.push(sourced);
                }
                (false, _) => spectra.controls.push(sourced.spectrum),
            }
        }
    }
    Ok(spectra)
}
