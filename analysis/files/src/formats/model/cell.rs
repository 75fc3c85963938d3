//! A cell with its numbers, and its text in each format.

use super::added::{Added, Split, split};
use super::error::{ModelExportError, ModelFormat};
use super::parts;
use super::tables;
use super::text::{Mark, fill, harmless, identifier, number};
use std::ops::RangeInclusive;

use analysis_fit::given::GivenModel;
use analysis_model::{
    map::{CellMap, ZERO_DEGC_K},
    model::Erm,
    ocv::OcvCurve,
};

/// Largest distance of the open-circuit voltage from its curve in a table with straight lines
/// between, V.
const DENSE_V: f64 = 5e-7;
/// Voltage below which the law of power takes a higher one, as a share of the greatest open-circuit
/// voltage.
const FLOOR_SHARE: f64 = 0.125;
/// The same at least, V.
const LEAST_FLOOR_V: f64 = 0.1;

/// A cell with all inputs of a simulation.
#[derive(Debug, Clone, PartialEq)]
pub struct CellModel {
    pub(super) name: String,
    pub(super) erm: Erm,
    /// Resistances over state of charge and temperature, of which `erm` is one point.
    pub(super) map: Option<CellMap>,
    /// Laws that no linear branch has.
    pub(super) added: Option<Added>,
    pub(super) curve: OcvCurve,
    /// Least and greatest voltage, V.
    pub(super) window_v: RangeInclusive<f64>,
    pub(super) temperature_degc: f64,
    /// Limits of the model that the file states, in sentences.
    pub(super) notes: Vec<String>,
}

impl CellModel {
    /// A model with its open-circuit voltage. `window_v`: the cell's limits; `temperature_degc`: where
    /// it was measured.
    ///
    /// # Errors
    /// [`ModelExportError`].
    pub fn new(
        file: &GivenModel,
        window_v: RangeInclusive<f64>,
        temperature_degc: f64,
    ) -> Result<Self, ModelExportError> {
        let name = file.name.clone();
        let curve = file
            .ocv
            .clone()
            .ok_or_else(|| ModelExportError::NoOcv { name: name.clone() })?;
        let augmented = file
            .augmented()
            .map_err(|error| ModelExportError::Additional {
                name: name.clone(),
                message: error.to_string(),
            })?;
        let Split {
            erm,
            added,
            left_out,
        } = match &augmented {
            Some(augmented) => split(&name, augmented)?,
            None => Split {
                erm: file.erm.clone(),
                added: None,
                left_out: Vec::new(),
            },
        };
        let held = augmented.iter().map(|all| {
            let titles = all.of_the_cell();
            let titles: Vec<&str> = titles.iter().map(|a| a.effect.card().title).collect();
            format!("with the additions of a diagnosis: {}", titles.join(", "))
        });
        let bench = (!left_out.is_empty()).then(|| {
            let titles = left_out.join(", ");
            format!("without the effects of the bench, which no prediction has: {titles}")
        });
        // Beyond its nodes a map is extrapolated, and the file does not say so at run time.
        let warnings = file.map.iter().flat_map(|map| {
            let (soc, degc) = (&map.soc, &map.temperature_degc);
            let range = format!(
                "measured from {:.2} to {:.2} of charge and {:.1} to {:.1} degrees Celsius",
                soc[0],
                soc[soc.len() - 1],
                degc[0],
                degc[degc.len() - 1]
            );
            std::iter::once(range).chain(file.warnings.iter().cloned())
        });
        let notes = file.notes().into_iter().chain(held).chain(bench);
        Ok(Self {
            name,
            erm,
            map: file.map.clone(),
            added,
            curve,
            window_v,
            temperature_degc,
            notes: notes.chain(warnings).collect(),
        })
    }

    /// Adds sentences to the notes at the head of the file.
    #[must_use]
    pub fn with_notes(mut self, notes: impl IntoIterator<Item = String>) -> Self {
        self.notes.extend(notes);
        self
    }

    /// Returns the text of the file.
    ///
    /// # Errors
    /// [`ModelExportError::Additions`] and [`ModelExportError::CurrentLaw`] for what the format cannot
    /// hold.
    pub fn text(&self, format: ModelFormat) -> Result<String, ModelExportError> {
        let holds = matches!(format, ModelFormat::CHeader | ModelFormat::CasAdi);
        if let (false, Some(added)) = (holds, &self.added) {
            return Err(ModelExportError::Additions {
                name: self.name.clone(),
                additions: added.titles.clone(),
            });
        }
        let falls = self
            .map
            .as_ref()
            .is_some_and(|map| map.charge_transfer.is_some());
        if format == ModelFormat::Simscape && falls {
            return Err(ModelExportError::CurrentLaw {
                name: self.name.clone(),
            });
        }
        let parts = parts::of(format, self.map.is_some(), self.added.is_some());
        let whole = fill("@WHOLE@", &parts);
        Ok(fill(&whole, &self.marks(format)))
    }

    /// Returns all numbers and names of the model in the style of a format.
    pub(super) fn marks(&self, format: ModelFormat) -> Vec<Mark> {
        let style = parts::style(format);
        let list = |values: &[f64]| style.list(values.iter().copied());
        let (erm, curve) = (&self.erm, &self.curve);
        let point = || tables::map_of(erm, self.temperature_degc);
        let map = self.map.clone().unwrap_or_else(point);
        let mut marks = tables::marks(&map, style);
        marks.extend(self.added.iter().flat_map(|added| added.marks(style)));
        let branch_r = style.list(erm.branches.iter().map(|branch| branch.r_ohm));
        let branch_c = style.list(erm.branches.iter().map(|branch| branch.c_f));
        marks.extend([
            ("@NAME@", harmless(&self.name)),
            ("@IDENTIFIER@", identifier(&self.name)),
            ("@NOTES@", style.notes(&self.notes)),
            ("@R_OHM@", number(erm.r_ohm)),
            ("@BRANCH_R_OHM@", branch_r),
            ("@BRANCH_C_F@", branch_c),
            ("@CAPACITY_C@", number(3600.0 * curve.capacity_ah)),
            ("@CAPACITY_AH@", number(curve.capacity_ah)),
            ("@KNOTS@", curve.soc.len().to_string()),
            ("@SOC@", list(&curve.soc)),
            ("@OCV_V@", list(&curve.ocv_v)),
            ("@SLOPE_V@", list(&curve.slope_v)),
            ("@LOW_V@", number(*self.window_v.start())),
            ("@HIGH_V@", number(*self.window_v.end())),
            ("@FLOOR_V@", number(self.floor_v())),
            ("@AMBIENT_DEGC@", number(self.temperature_degc)),
            (
                "@TEMPERATURE_K@",
                number(self.temperature_degc + ZERO_DEGC_K),
            ),
        ]);
        if format == ModelFormat::PyBamm {
            let soc = tables::dense_soc(curve, DENSE_V);
            let dense_v: Vec<f64> = soc.iter().map(|soc| curve.voltage_v(*soc)).collect();
            marks.extend([
                ("@DENSE_UV@", number(1e6 * DENSE_V)),
                ("@DENSE_SOC@", list(&soc)),
                ("@DENSE_OCV_V@", list(&dense_v)),
            ]);
        }
        marks.extend(parts::branches(format, &map));
        marks
    }

    /// Returns the voltage below which the law of power takes a higher one, V: far below those of
    /// the cell.
    fn floor_v(&self) -> f64 {
        let greatest_v = self.curve.ocv_v.last().copied().unwrap_or_default();
        (greatest_v * FLOOR_SHARE).max(LEAST_FLOOR_V)
    }
}
