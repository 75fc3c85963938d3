//! A cell over its runs: series resistance, resistance at zero frequency and diffusion over time,
//! each with its uncertainty.

use std::collections::{BTreeMap, BTreeSet};

use analysis_plot::{AxisSpec, Chart, Panel, Trace, TraceStyle};
use serde::Serialize;

use crate::{
    Catalog, CatalogError,
    query::{Filter, FitHead, OfRun},
    record::{CatalogFit, CatalogParameter, TimeSource},
};

/// Effects with diffusion parameters, as the catalogue of effects names them.
const DIFFUSION: [&str; 3] = ["diffusion", "warburg", "electrolyte_depletion"];
/// Seconds of a day.
const DAY_S: f64 = 86_400.0;
/// Milliohms of an ohm.
const MILLI: f64 = 1.0e3;

/// A cell at a time.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct AgeingPoint {
    /// The fit.
    #[serde(flatten)]
    pub fit: CatalogFit,
    /// Parameters of diffusion that a diagnosis of the run names.
    pub diffusion: Vec<CatalogParameter>,
}

/// A cell over its runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Ageing {
    /// The requested cell.
    pub cell: String,
    /// Number of RC pairs of the models; only models with the same number can be compared.
    pub rc: Option<u32>,
    /// Numbers of RC pairs that models of the cell have.
    pub orders: Vec<u32>,
    /// Serial numbers that the cells of these models are known to have: several are different cells
    /// of one name, whose values do not belong together.
    pub serials: Vec<String>,
    /// Number of models of several cells together, which are left out.
    pub pooled: u32,
    /// In the order of time.
    pub points: Vec<AgeingPoint>,
}

impl Catalog {
    /// Follows a cell over its runs, by models of one order: `rc`, otherwise the greatest that
    /// every run of the cell has, otherwise the one that most runs have. Every condition applies.
    ///
    /// # Errors
    /// [`CatalogError`].
    pub fn ageing(&self, filter: &Filter, rc: Option<u32>) -> Result<Ageing, CatalogError> {
        let heads = self.fit_heads(filter)?;
        let orders = orders(&heads);
        let rc = rc.or_else(|| common_order(&orders));
        let serials: BTreeSet<String> = heads.into_iter().filter_map(|one| one.serial).collect();
        let fits = match rc {
            Some(rc) => self.single_fits(filter, rc)?,
            None => Vec::new(),
        };
        let cell = filter.cell.as_ref().or(filter.serial.as_ref());
        let cell = cell.cloned().unwrap_or_default();
        Ok(Ageing {
            rc,
            orders: orders.into_keys().collect(),
            serials: serials.into_iter().collect(),
            pooled: self.pooled_fits(&cell)?,
            points: self.points(fits)?,
            cell,
        })
    }

    /// Fits with the parameters of diffusion that diagnoses of their runs name.
    fn points(&self, fits: Vec<CatalogFit>) -> Result<Vec<AgeingPoint>, CatalogError> {
        let runs: Vec<&str> = fits.iter().map(|fit| fit.run.as_str()).collect();
        let mut diffusion: BTreeMap<String, Vec<CatalogParameter>> = BTreeMap::new();
        for OfRun { run, parameters } in self.parameters_of(&runs)? {
            let is_diffusion = |one: &CatalogParameter| DIFFUSION.contains(&one.effect.as_str());
            let named = parameters.into_iter().filter(is_diffusion);
            diffusion.entry(run).or_default().extend(named);
        }
        let point = |fit: CatalogFit| AgeingPoint {
            diffusion: diffusion.remove(&fit.run).unwrap_or_default(),
            fit,
        };
        Ok(fits.into_iter().map(point).collect())
    }
}

/// Numbers of RC pairs, each with the runs that have such a model.
type Orders = BTreeMap<u32, BTreeSet<String>>;

fn orders(heads: &[FitHead]) -> Orders {
    let mut orders = Orders::new();
    for one in heads {
        let runs = orders.entry(one.rc).or_default();
        runs.insert(one.run.clone());
    }
    orders
}

/// Returns the greatest order that every run has, otherwise the one that most runs have, or the
/// greatest of those.
fn common_order(orders: &Orders) -> Option<u32> {
    let runs: BTreeSet<&String> = orders.values().flatten().collect();
    let mut of_all = orders.iter().rev();
    let of_all = of_all.find(|(_, of_order)| of_order.len() == runs.len());
    let of_most = || orders.iter().max_by_key(|(rc, runs)| (runs.len(), **rc));
    of_all.or_else(of_most).map(|(rc, _)| *rc)
}

/// A quantity over the points; `None` where it is not known.
struct Quantity {
    name: String,
    colour: usize,
    values: Vec<Option<Value>>,
}

/// A value with its uncertainty.
#[derive(Debug, Clone, Copy)]
struct Value {
    value: f64,
    sigma: Option<f64>,
}

impl Value {
    fn scaled(value: f64, sigma: Option<f64>, factor: f64) -> Self {
        Self {
            value: factor * value,
            sigma: sigma.map(|sigma| factor * sigma),
        }
    }
}

impl Ageing {
    /// Returns a chart of the points over the days since the first, one panel for each quantity,
    /// with bars of one standard uncertainty.
    pub fn chart(&self) -> Chart {
        let first = self
            .points
            .first()
            .map_or(0.0, |one| one.fit.started_unix_s);
        let days: Vec<f64> = self
            .points
            .iter()
            .map(|one| (one.fit.started_unix_s - first) / DAY_S)
            .collect();
        let quantities = self.quantities();
        let known = quantities
            .iter()
            .filter(|quantity| quantity.values.iter().any(Option::is_some));
        let panels = known.map(|quantity| quantity.panel(&days)).collect();
        let of_files = self
            .points
            .iter()
            .any(|one| one.fit.time_source == TimeSource::File);
        let remark = match of_files {
            true => "; runs in virtual time stand at the time of their files",
            false => "",
        };
        let subtitle = match self.rc {
            Some(rc) => format!(
                "{} models with {rc} RC pairs; bars are one standard uncertainty{remark}",
                self.points.len()
            ),
            None => String::new(),
        };
        Chart::new(&format!("Ageing of {}", self.cell), &subtitle, panels)
    }

    fn quantities(&self) -> Vec<Quantity> {
        let over = |name: &str, colour, of: &dyn Fn(&CatalogFit) -> Option<Value>| Quantity {
            name: name.to_owned(),
            colour,
            values: self.points.iter().map(|one| of(&one.fit)).collect(),
        };
        let milli = |value, sigma| Value::scaled(value, sigma, MILLI);
        let mut all = vec![
            over("R / mΩ", 0, &|fit| Some(milli(fit.r_ohm, fit.r_sigma_ohm))),
            over("DC resistance / mΩ", 1, &|fit| {
                Some(milli(fit.dc_resistance_ohm, fit.dc_resistance_sigma_ohm))
            }),
            over("slowest pair R / mΩ", 2, &|fit| {
                Some(milli(fit.slow_r_ohm?, fit.slow_r_sigma_ohm))
            }),
            over("slowest pair τ / s", 3, &|fit| {
                Some(Value::scaled(fit.slow_tau_s?, fit.slow_tau_sigma_s, 1.0))
            }),
        ];
        all.extend(self.of_diagnoses());
        all
    }

    /// Returns the diffusion quantities from diagnoses, by effect and parameter.
    fn of_diagnoses(&self) -> Vec<Quantity> {
        let named: BTreeSet<(&str, &str, &str)> = self
            .points
            .iter()
            .flat_map(|one| &one.diffusion)
            .map(|one| (one.effect.as_str(), one.name.as_str(), one.unit.as_str()))
            .collect();
        let quantity = |(index, (effect, name, unit)): (usize, (&str, &str, &str))| {
            let of = |point: &AgeingPoint| {
                let mut all = point.diffusion.iter();
                let one = all.find(|one| one.effect == effect && one.name == name)?;
                Some(Value::scaled(one.value, one.sigma, 1.0))
            };
            Quantity {
                name: format!("{effect} {name} / {unit}"),
                colour: 4 + index,
                values: self.points.iter().map(of).collect(),
            }
        };
        named.into_iter().enumerate().map(quantity).collect()
    }
}

impl Quantity {
    fn panel(&self, days: &[f64]) -> Panel {
        let known = days.iter().zip(&self.values);
        let known: Vec<(f64, Value)> = known
            .filter_map(|(day, value)| value.map(|value| (*day, value)))
            .filter(|(_, value)| value.value.is_finite())
            .collect();
        let points = known
            .iter()
            .map(|(day, value)| (*day, value.value))
            .collect();
        let spread = known
            .iter()
            .map(|(_, value)| value.sigma.unwrap_or(f64::NAN));
        let label = self.name.split(" / ").next().unwrap_or_default();
        let trace = Trace::new(label, self.colour, TraceStyle::Points, points)
            .with_spread(spread.collect());
        Panel::new(
            AxisSpec::linear("Time since the first run / d"),
            AxisSpec::linear(&self.name),
            vec![trace],
        )
    }
}
