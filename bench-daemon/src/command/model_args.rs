//! The model of a command: a file, or typed. Every command that takes a model takes it by these
//! arguments.

use std::path::{Path, PathBuf};

use analysis::{forward::CellWindow, given::GivenModel, pack::Pack};

use crate::command::units;
use bench_core::safety::failure::Failure;
use bench_evaluate::{files, investigate::dataset::NamedFile};
use bench_plan::{
    config::{
        erm_text,
        quantity::{Resistance, Voltage},
    },
    support::quoted::quoted,
};

/// Name of a model that was typed.
pub(super) const TYPED: &str = "typed";

/// Which model.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ModelArgs {
    /// The cell's model: a file of `fit`, `joint` or a run; JSON of `r_ohm` and `branches` alone;
    /// or `circuit.json` of `fit --circuit`, followed by RC branches.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// The model typed: series resistance; then branches of resistance, capacitance or time
    /// constant: "6.43 mΩ; 1.51 mΩ, 0.553 F; 0.66 mΩ, 4.6 ms".
    #[arg(long, value_name = "TEXT", conflicts_with = "model")]
    pub erm: Option<String>,
    /// For circuit.json: lowest and highest frequency, Hz, at which the RC branches follow it
    /// [default: the band of its data, a decade more on each side]
    #[arg(long, value_name = "LOW,HIGH")]
    pub ladder_band_hz: Option<String>,
}

/// Cells of a pack and their connection.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct PackArgs {
    /// Cells in series.
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub series: u32,
    /// Cells in parallel.
    #[arg(long, value_name = "P", default_value_t = 1)]
    pub parallel: u32,
    /// Resistance of busbars, wires and connectors in series with the whole pack, Ω.
    #[arg(
        long,
        value_name = "OHM",
        default_value_t = 0.0,
        allow_hyphen_values = true,
        value_parser = units::of::<Resistance>
    )]
    pub interconnect_ohm: f64,
}

/// Makes the number of cells a required argument.
pub(super) fn required_sizes(arg: clap::Arg) -> clap::Arg {
    match arg.get_id().as_str() {
        "series" | "parallel" => arg.required(true).default_value(None::<&'static str>),
        _ => arg,
    }
}

impl PackArgs {
    /// Returns the pack.
    ///
    /// # Errors
    /// Numbers that make no pack.
    pub(super) fn pack(self) -> Result<Pack, Failure> {
        Pack::new(self.series, self.parallel, self.interconnect_ohm)
            .map_err(|error| Failure::Usage(error.to_string()))
    }
}

/// Limits of the voltage of a cell.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct WindowArgs {
    /// Lowest voltage of a cell, V.
    #[arg(
        long,
        alias = "low-v",
        value_name = "V",
        default_value_t = CellWindow::THESIS.low_v,
        allow_hyphen_values = true,
        value_parser = units::of::<Voltage>
    )]
    pub v_min: f64,
    /// Highest voltage of a cell, V.
    #[arg(
        long,
        alias = "high-v",
        value_name = "V",
        default_value_t = CellWindow::THESIS.high_v,
        allow_hyphen_values = true,
        value_parser = units::of::<Voltage>
    )]
    pub v_max: f64,
}

impl WindowArgs {
    /// Returns the window.
    pub(super) fn window(self) -> CellWindow {
        CellWindow {
            low_v: self.v_min,
            high_v: self.v_max,
        }
    }
}

impl ModelArgs {
    /// A file alone.
    pub(crate) fn file(path: PathBuf) -> Self {
        Self {
            model: Some(path),
            ..Self::default()
        }
    }

    /// Reads the model; the curve of `ocv` replaces its own.
    ///
    /// # Errors
    /// A file or a text that is not a model, a file that is not a curve.
    pub(super) fn read(&self, ocv: Option<&Path>) -> Result<GivenModel, Failure> {
        let curve = ocv.map(files::read_curve).transpose()?;
        let model = match (&self.model, &self.erm) {
            (Some(path), _) => self.read_file(path)?,
            (None, Some(text)) => {
                if self.ladder_band_hz.is_some() {
                    let reason = "--ladder-band-hz: expected a fitted circuit to follow, met --erm";
                    return Err(Failure::Usage(reason.to_owned()));
                }
                let fail = |reason: String| Failure::Usage(format!("--erm: {reason}"));
                GivenModel::typed(TYPED, erm_text::parse(text).map_err(fail)?)
                    .map_err(|error| fail(error.to_string()))?
            }
            (None, None) => {
                return Err(Failure::Usage(
                    "expected --model or --erm, found neither".to_owned(),
                ));
            }
        };
        if model.map.is_some() && curve.is_some() {
            let reason = "--ocv: expected none for a model with a map, which has the curve that its \
                          corrections belong to";
            return Err(Failure::Usage(reason.to_owned()));
        }
        Ok(model.with_ocv(curve))
    }

    fn read_file(&self, path: &Path) -> Result<GivenModel, Failure> {
        let band_hz = self.ladder_band_hz.as_deref().map(band).transpose()?;
        files::read_model(path, band_hz)
            .map_err(|error| Failure::Usage(format!("--model {}: {error}", path.display())))
    }

    /// Whether neither a file nor a text is given.
    pub(super) fn is_absent(&self) -> bool {
        self.model.is_none() && self.erm.is_none()
    }

    /// Reads the model that a data set names. An error names the location in the data set.
    ///
    /// # Errors
    /// A file that is not a model.
    pub(super) fn read_named(&self, file: &NamedFile) -> Result<GivenModel, Failure> {
        let band_hz = self.ladder_band_hz.as_deref().map(band).transpose()?;
        files::read_model(&file.path, band_hz).map_err(|error| {
            let found = file.path.display();
            let reason = format!("expected a model of `fit`, `joint` or a run; {found}: {error}");
            file.complain(reason).into()
        })
    }

    /// Returns the name of the model for messages.
    pub(super) fn display_name(&self) -> String {
        self.model
            .as_ref()
            .map_or_else(|| "--erm".to_owned(), |path| path.display().to_string())
    }

    /// Returns the quoted arguments that read this model again; `path` formats a file.
    pub(super) fn again(&self, path: impl Fn(&Path) -> String) -> String {
        let mut text = match (&self.model, &self.erm) {
            (Some(model), _) => format!(" --model {}", quoted(Path::new(&path(model)))),
            (None, Some(erm)) => format!(" --erm {}", quoted(Path::new(erm))),
            (None, None) => String::new(),
        };
        if let Some(band) = &self.ladder_band_hz {
            text.push_str(&format!(" --ladder-band-hz {}", quoted(Path::new(band))));
        }
        text
    }
}

/// Reads `LOW,HIGH`.
pub(super) fn band(text: &str) -> Result<(f64, f64), Failure> {
    let number = |text: &str| {
        text.trim()
            .parse::<f64>()
            .ok()
            .filter(|value| value.is_finite() && *value > 0.0)
    };
    let ends = text
        .split_once(',')
        .and_then(|(low, high)| number(low).zip(number(high)))
        .filter(|(low, high)| low < high);
    ends.ok_or_else(|| {
        Failure::Usage(format!(
            "--ladder-band-hz: expected a lower and a higher frequency in Hz, \
        such as 0.001,10000, found {text:?}"
        ))
    })
}

/// Returns the warnings of the model's fit and the properties that the model does not contain, in
/// sentences.
pub(super) fn notes(model: &GivenModel) -> Vec<String> {
    let mut notes: Vec<String> = model
        .warnings
        .iter()
        .map(|warning| format!("of the model's fit: {warning}"))
        .collect();
    notes.extend(model.notes());
    notes.extend(files::addition_notes(model));
    notes
}
