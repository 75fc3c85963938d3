//! `eis-bench convert`: spectra, time series and models as the files of other programs, and theirs
//! as the project's.

mod model;
mod nleis;
mod place;

use std::path::{Path, PathBuf};

use analysis::{
    batch::write_long_form,
    dataset,
    formats::{
        BdfMetadata, CurrentSign, FileSpectra, FormatError, SeriesOptions, SeriesReadError,
        SpectrumFormat, bdf_metadata_path, bdf_metadata_text, bdf_spectrum_text, bdf_text,
        model::ModelFormat, read_bdf_metadata, read_file, read_record, spectrum_text,
        write_bdf_parquet, write_bdf_spectrum_parquet,
    },
    spectrum::{FlaggedPoint, ImpedancePoint, SourcedSpectrum, Spectrum},
};
use clap::Args;

use super::{
    model_args::{self, ModelArgs, TYPED},
    ocv,
};
use bench_core::{record::RecordError, safety::failure::Failure};
use bench_evaluate::{files, support::present::refused_in_words};
use bench_plan::support::terminal::{remark, say};
pub use model::CellArgs;
use model::{Given, Goal};
use place::{free, stem, write};

/// Arguments of `convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// Spectra, time series or models; the format is detected from the content.
    #[arg(required_unless_present = "erm", value_name = "FILE")]
    pub files: Vec<PathBuf>,
    /// A model as text instead of files: "6.43 mΩ; 1.51 mΩ, 0.553 F; 0.66 mΩ, 4.6 ms". It is
    /// written as `typed`.
    #[arg(long, value_name = "TEXT", conflicts_with = "files")]
    pub erm: Option<String>,
    /// For circuit.json: lowest and highest frequency, Hz, at which RC branches follow it [default:
    /// the band of its data, a decade more on each side]
    #[arg(long, value_name = "LOW,HIGH")]
    pub ladder_band_hz: Option<String>,
    /// Kind of file to write.
    #[arg(long, value_enum)]
    pub to: To,
    /// The folder to write into. Existing files are not overwritten.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// For time series: the direction of positive current, `discharge` or `charge` [default: from
    /// the voltage and the file's columns]
    #[arg(long, value_name = "DIRECTION")]
    pub positive: Option<CurrentSign>,
    /// Numbers of a cell that a model lacks.
    #[command(flatten)]
    pub cell: CellArgs,
}

/// Kind of file that can be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum To {
    /// Spectra as the project's CSV.
    Csv,
    /// Spectra as impedance.py's `f,re,im`.
    ImpedancePy,
    /// Spectra as Gamry's DTA.
    Gamry,
    /// Spectra as BioLogic EC-Lab's mpt.
    Biologic,
    /// Spectra as ZPlot's and ZView's z.
    Zview,
    /// The `harmonics.csv` of a run folder as columns of frequency, Z1 and Z2 for nleis.py, one file for
    /// each sweep.
    Nleis,
    /// All spectra as one CSV in long form, `spectra.csv`, as `fit --table` reads it.
    TableCsv,
    /// All spectra as one Parquet in long form, `spectra.parquet`.
    TableParquet,
    /// Time series and spectra as BDF CSV; of a spectrum the metadata stand beside it.
    BdfCsv,
    /// Time series and spectra as BDF Parquet; of a spectrum the metadata stand beside it.
    BdfParquet,
    /// A model as a C header.
    C,
    /// A model as a Python module with a model and parameters for PyBaMM.
    Pybamm,
    /// A model as CasADi functions of one step, under a current or a power.
    Casadi,
    /// A model as a MATLAB script that fills the tables of Simscape Battery.
    Simscape,
    /// A model as an FMU (FMI 3.0) for model exchange and co-simulation, with its sources, and a library for Linux on
    /// x86-64 if a C compiler (`cc`) is there.
    Fmu,
    /// A model as a Modelica package.
    Modelica,
    /// A model as the project's JSON: a circuit as its ladder, a typed model as a file.
    Model,
}

/// Converts files.
///
/// # Errors
/// A file that is not what `--to` needs; a goal that is there already.
pub fn convert(args: &ConvertArgs) -> Result<(), Failure> {
    if args.erm.is_some() {
        let expected = "--erm: expected with --to c, pybamm, casadi, simscape, fmu, modelica or model, met \
            another goal: it is a model";
        let goal = args
            .to
            .of_model()
            .ok_or_else(|| Failure::Usage(expected.to_owned()))?;
        let named = ModelArgs {
            model: None,
            erm: args.erm.clone(),
            ladder_band_hz: args.ladder_band_hz.clone(),
        };
        let read = named.read(None)?;
        files::make_folder(&args.out)?;
        let given = Given {
            model: read,
            named: "--erm".to_owned(),
            stem: TYPED.to_owned(),
        };
        return model::write(&args.cell, &args.out, given, goal);
    }
    files::make_folder(&args.out)?;
    let each =
        |work: &dyn Fn(&PathBuf) -> Result<(), Failure>| args.files.iter().try_for_each(work);
    let format_of = |format| each(&|file| spectra(args, file, format));
    match args.to {
        To::TableCsv => table(args, ".csv"),
        To::TableParquet => table(args, ".parquet"),
        To::Csv => format_of(None),
        To::ImpedancePy => format_of(Some(SpectrumFormat::ImpedancePy)),
        To::Gamry => format_of(Some(SpectrumFormat::Gamry)),
        To::Biologic => format_of(Some(SpectrumFormat::BioLogic)),
        To::Zview => format_of(Some(SpectrumFormat::ZView)),
        To::BdfCsv | To::BdfParquet => each(&|file| bdf(args, file)),
        To::Nleis => each(&|file| harmonics(args, file)),
        To::C | To::Pybamm | To::Casadi | To::Simscape | To::Fmu | To::Modelica | To::Model => {
            each(&|file| {
                let band_hz = args
                    .ladder_band_hz
                    .as_deref()
                    .map(model_args::band)
                    .transpose()?;
                let fail = |error: String| Failure::Usage(format!("{}: {error}", file.display()));
                let read = files::read_model(file, band_hz).map_err(fail)?;
                args.to.of_model().map_or(Ok(()), |goal| {
                    let given = Given {
                        model: read,
                        named: file.display().to_string(),
                        stem: stem(file),
                    };
                    model::write(&args.cell, &args.out, given, goal)
                })
            })
        }
    }
}

impl To {
    /// Returns the target format of a model, or `None` if a model has no such format.
    fn of_model(self) -> Option<Goal> {
        match self {
            Self::C => Some(Goal::Text(ModelFormat::CHeader)),
            Self::Pybamm => Some(Goal::Text(ModelFormat::PyBamm)),
            Self::Casadi => Some(Goal::Text(ModelFormat::CasAdi)),
            Self::Simscape => Some(Goal::Text(ModelFormat::Simscape)),
            Self::Modelica => Some(Goal::Text(ModelFormat::Modelica)),
            Self::Fmu => Some(Goal::Fmu),
            Self::Model => Some(Goal::Json),
            _ => None,
        }
    }
}

fn spectra(args: &ConvertArgs, file: &Path, format: Option<SpectrumFormat>) -> Result<(), Failure> {
    if let Some(metadata) = metadata(file)? {
        let unread = metadata.unread();
        if !unread.is_empty() {
            let (met, sections) = (metadata.file.display(), unread.join(", "));
            remark!("{met}: this format has no place for metadata: {sections}");
        }
    }
    for SourcedSpectrum {
        spectrum, flagged, ..
    } in files::read_spectra(file)?
    {
        let path = free(
            &args.out,
            &spectrum.name,
            format.map_or(".csv", SpectrumFormat::extension),
        )?;
        match format {
            None => {
                let flags: Vec<String> = spectrum
                    .points
                    .iter()
                    .map(|point| reasons(point, &flagged))
                    .collect();
                dataset::write_whole_spectrum_csv(&path, &spectrum, &flags)
                    .map_err(RecordError::from)?;
            }
            Some(format) => {
                tell_left_out(&spectrum, &flagged, format.keeps_sigma());
                write(&path, &spectrum_text(&spectrum, format))?;
            }
        }
        say!("{}: {} points", path.display(), spectrum.points.len());
    }
    Ok(())
}

/// The harmonics of each sweep of a run.
fn harmonics(args: &ConvertArgs, file: &Path) -> Result<(), Failure> {
    for (sweep, text) in nleis::texts(file)? {
        let path = free(&args.out, &format!("nleis_{sweep}"), ".csv")?;
        write(&path, &text)?;
        say!(
            "{}: {} frequencies",
            path.display(),
            text.lines().count() - 1
        );
    }
    Ok(())
}

/// All spectra of all files as one table.
fn table(args: &ConvertArgs, ending: &str) -> Result<(), Failure> {
    let path = free(&args.out, "spectra", ending)?;
    let mut all = Vec::new();
    for file in &args.files {
        for sourced in files::read_spectra(file)? {
            tell_left_out(&sourced.spectrum, &sourced.flagged, true);
            all.push(sourced.spectrum);
        }
    }
    write_long_form(&path, &all).map_err(|error| Failure::Usage(error.to_string()))?;
    let points: usize = all.iter().map(|spectrum| spectrum.points.len()).sum();
    say!("{}: {} spectra, {points} points", path.display(), all.len());
    Ok(())
}

/// Returns why the quality gate refused a point; empty if it did not.
fn reasons(point: &ImpedancePoint, flagged: &[FlaggedPoint]) -> String {
    let reasons = flagged
        .iter()
        .filter(|one| one.freq_hz == point.freq_hz)
        .flat_map(|one| one.reasons.clone());
    reasons.collect::<Vec<_>>().join("; ")
}

/// Reports the data of a spectrum that the format cannot hold.
fn tell_left_out(spectrum: &Spectrum, flagged: &[FlaggedPoint], keeps_sigma: bool) {
    let name = &spectrum.name;
    if !flagged.is_empty() {
        let (count, refusals) = (flagged.len(), refused_in_words(flagged));
        remark!(
            "{name}: the quality gate refused {count} points, which this format cannot mark: \
            {refusals}"
        );
    }
    let has_sigma = spectrum
        .points
        .iter()
        .any(|point| point.covariance.re_re.is_finite());
    if has_sigma && !keeps_sigma {
        remark!("{name}: this format has no place for the uncertainties of the points");
    }
    if !spectrum.shared.is_empty() {
        let names: Vec<&str> = spectrum.shared.iter().map(|error| &*error.name).collect();
        remark!(
            "{name}: this format has no place to say which errors the points share: {}",
            names.join(", ")
        );
    }
}

/// The metadata beside a file of BDF.
fn metadata(file: &Path) -> Result<Option<BdfMetadata>, Failure> {
    read_bdf_metadata(file).map_err(|error| Failure::Usage(error.to_string()))
}

/// Writes the spectra of a file and its record over time, whichever it holds.
fn bdf(args: &ConvertArgs, file: &Path) -> Result<(), Failure> {
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
    let sign = args.positive;
    match (read_file(file), read_record(file, &SeriesOptions { sign })) {
        (
            Err(error),
            Err(SeriesReadError::UnknownFormat { .. } | SeriesReadError::Foreign { .. }),
        ) if !is_unknown(&error) => Err(usage(&error)),
        (Err(_), Err(error)) => Err(usage(&error)),
        (Err(_), Ok(_)) => series(args, file, ""),
        (Ok(read), Ok(_)) => {
            bdf_spectra(args, file, &read)?;
            series(args, file, ".series")
        }
        (Ok(read), Err(_)) => bdf_spectra(args, file, &read),
    }
}

/// Whether a file was refused because no reader of spectra knows it.
fn is_unknown(error: &FormatError) -> bool {
    matches!(
        error,
        FormatError::UnknownFormat { .. } | FormatError::Foreign { .. }
    )
}

fn bdf_spectra(args: &ConvertArgs, file: &Path, read: &FileSpectra) -> Result<(), Failure> {
    read.notes.iter().for_each(|note| remark!("{note}"));
    let source = metadata(file)?;
    for one in &read.spectra {
        let (spectrum, name) = (&one.spectrum, &one.spectrum.name);
        let beside = free(&args.out, name, ".bdf.metadata.json")?;
        let path = if args.to == To::BdfCsv {
            let path = free(&args.out, name, ".bdf.csv")?;
            write(&path, &bdf_spectrum_text(one))?;
            path
        } else {
            let path = free(&args.out, name, ".bdf.parquet")?;
            tell_left_out(spectrum, &one.flagged, true);
            write_bdf_spectrum_parquet(&path, spectrum).map_err(RecordError::from)?;
            path
        };
        debug_assert_eq!(beside, bdf_metadata_path(&path));
        write(&beside, &bdf_metadata_text(one, source.as_ref()))?;
        say!("{}: {} points", path.display(), spectrum.points.len());
    }
    Ok(())
}

fn series(args: &ConvertArgs, file: &Path, infix: &str) -> Result<(), Failure> {
    let series = ocv::read(file, args.positive)?;
    let stem = stem(file);
    let ending = match args.to {
        To::BdfCsv => ".bdf.csv",
        _ => ".bdf.parquet",
    };
    let path = free(
        &args.out,
        stem.trim_end_matches(".bdf"),
        &format!("{infix}{ending}"),
    )?;
    match args.to {
        To::BdfCsv => write(&path, &bdf_text(&series))?,
        _ => write_bdf_parquet(&path, &series).map_err(RecordError::from)?,
    }
    say!("{}: {} rows", path.display(), series.time_s.len());
    Ok(())
}
