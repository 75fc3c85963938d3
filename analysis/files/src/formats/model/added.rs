//! The additions of a diagnosis, as numbers of their laws.

use super::error::ModelExportError;
use super::text::{Mark, Style, number};
use analysis_effects::{
    augmented::{Augmented, network},
    contract::{Branch, Equation, Law, Relaxation},
};
use analysis_model::model::Erm;

/// Laws of a cell beyond a linear network.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Added {
    /// Titles of the effects, with commas.
    pub(super) titles: String,
    branches: Vec<Branch>,
    equations: Vec<Equation>,
}

/// A cell's network for small signals, and its laws; none if all is linear.
pub(super) struct Split {
    pub(super) erm: Erm,
    pub(super) added: Option<Added>,
    /// Titles of effects of the bench, which no prediction has.
    pub(super) left_out: Vec<&'static str>,
}

/// Splits an augmented model into branches and laws.
///
/// # Errors
/// [`ModelExportError::Unwritten`] for an effect that has no equation,
/// [`ModelExportError::Twice`] for two with the same equation.
pub(super) fn split(name: &str, cell: &Augmented) -> Result<Split, ModelExportError> {
    let (base, added) = (&cell.base, cell.of_the_cell());
    let mut whole = network(base, &added);
    whole.branches.retain(|b| b.r_ohm != 0.0);
    let mut titles = Vec::new();
    let mut equations: Vec<Equation> = Vec::new();
    for one in &added {
        let title = one.effect.card().title;
        let alone = network(base, std::slice::from_ref(one));
        let bends = alone.branches.iter().any(|b| !b.is_linear());
        match one.effect.equation(one.p, base) {
            Some(equation) => {
                let same = |other: &Equation| {
                    std::mem::discriminant(other) == std::mem::discriminant(&equation)
                };
                if equations.iter().any(same) {
                    let (name, addition) = (name.to_owned(), title.to_owned());
                    return Err(ModelExportError::Twice { name, addition });
                }
                titles.push(title);
                equations.push(equation);
            }
            None if bends => titles.push(title),
            None if alone != network(base, &[]) || one.p.first() == Some(&0.0) => {}
            None => {
                let (name, addition) = (name.to_owned(), title.to_owned());
                return Err(ModelExportError::Unwritten { name, addition });
            }
        }
    }
    Ok(Split {
        erm: whole.linearised(),
        added: (!titles.is_empty()).then(|| Added {
            titles: titles.join(", "),
            branches: whole.branches,
            equations,
        }),
        left_out: cell.left_out(),
    })
}

/// Numbers of the equations: without any, nothing is added.
struct Numbers {
    scalars: Vec<(&'static str, f64)>,
    surface: Vec<Relaxation>,
}

impl Numbers {
    fn none() -> Self {
        let zeros = [
            "@FACTOR_PER_SOC@",
            "@FACTOR_SOC@",
            "@FACTOR_LEAST@",
            "@FACTOR_PER_J@",
            "@FACTOR_BEND_PER_J@",
            "@ENTROPIC_V_PER_K@",
            "@HYSTERESIS_V@",
            "@HYSTERESIS_PER_C@",
            "@SLOPE_EXCESS@",
            "@CURVATURE_V@",
            "@LEAK_PER_S@",
            "@MISSING_PER_A@",
            "@MISSING_V@",
        ];
        // Time constants and what is divided by must not be zero.
        let ones = [
            "@FACTOR@",
            "@FACTOR_CHARGING@",
            "@FACTOR_TAU_S@",
            "@ENTROPIC_START_K@",
            "@ENTROPIC_J_PER_K@",
            "@ENTROPIC_TAU_S@",
            "@MISSING_TAU_S@",
            "@MISSING_LEAST@",
        ];
        Self {
            scalars: zeros
                .map(|mark| (mark, 0.0))
                .into_iter()
                .chain(ones.map(|mark| (mark, 1.0)))
                .collect(),
            surface: Vec::new(),
        }
    }

    fn set(&mut self, values: &[(&'static str, f64)]) {
        for (mark, value) in values {
            let known = self.scalars.iter_mut().find(|(known, _)| known == mark);
            if let Some((_, number)) = known {
                *number = *value;
            }
        }
    }

    fn take(&mut self, equation: &Equation) {
        match equation {
            Equation::Factor { factor } => self.set(&[("@FACTOR@", *factor)]),
            Equation::FactorOfCharge {
                k,
                reference,
                least,
            } => self.set(&[
                ("@FACTOR_PER_SOC@", *k),
                ("@FACTOR_SOC@", *reference),
                ("@FACTOR_LEAST@", *least),
            ]),
            Equation::FactorOfCharging { factor } => self.set(&[("@FACTOR_CHARGING@", *factor)]),
            Equation::FactorOfHeat {
                per_j,
                bend_per_j,
                tau_s,
            } => self.set(&[
                ("@FACTOR_PER_J@", *per_j),
                ("@FACTOR_BEND_PER_J@", *bend_per_j),
                ("@FACTOR_TAU_S@", *tau_s),
            ]),
            Equation::Entropic {
                v_per_k,
                start_k,
                heat_j_per_k,
                tau_s,
            } => self.set(&[
                ("@ENTROPIC_V_PER_K@", *v_per_k),
                ("@ENTROPIC_START_K@", *start_k),
                ("@ENTROPIC_J_PER_K@", *heat_j_per_k),
                ("@ENTROPIC_TAU_S@", *tau_s),
            ]),
            Equation::Hysteresis { m_v, per_coulomb } => self.set(&[
                ("@HYSTERESIS_V@", *m_v),
                ("@HYSTERESIS_PER_C@", *per_coulomb),
            ]),
            Equation::Slope { excess } => self.set(&[("@SLOPE_EXCESS@", *excess)]),
            Equation::Curvature { half_v } => self.set(&[("@CURVATURE_V@", *half_v)]),
            Equation::Leak { per_s } => self.set(&[("@LEAK_PER_S@", *per_s)]),
            Equation::Surface { elements } => self.surface.clone_from(elements),
            Equation::Depletion {
                missing,
                scale_v,
                least,
            } => self.set(&[
                ("@MISSING_PER_A@", missing.per_a),
                ("@MISSING_TAU_S@", missing.tau_s),
                ("@MISSING_V@", *scale_v),
                ("@MISSING_LEAST@", *least),
            ]),
        }
    }
}

impl Added {
    /// Returns the marks of the laws.
    pub(super) fn marks(&self, style: Style) -> Vec<Mark> {
        let mut numbers = Numbers::none();
        self.equations
            .iter()
            .for_each(|equation| numbers.take(equation));
        let beta = self.branches.iter().map(|b| kinetics(b).0);
        let alpha = self.branches.iter().map(|b| kinetics(b).1);
        let surface = &numbers.surface;
        let mut marks = vec![
            ("@BETA@", style.list(beta)),
            ("@ALPHA@", style.list(alpha)),
            ("@SURFACE@", surface.len().to_string()),
            (
                "@SURFACE_PER_A@",
                style.list(surface.iter().map(|r| r.per_a)),
            ),
            (
                "@SURFACE_TAU_S@",
                style.list(surface.iter().map(|r| r.tau_s)),
            ),
        ];
        let scalars = numbers.scalars.into_iter();
        marks.extend(scalars.map(|(mark, value)| (mark, number(value))));
        marks
    }

    /// Returns the names of the states beyond charge and branches, in the order of the C header.
    pub(super) fn states(&self) -> Vec<String> {
        let surface = self.equations.iter().find_map(|equation| match equation {
            Equation::Surface { elements } => Some(elements.len()),
            _ => None,
        });
        let named = ["start_soc", "leaked", "heat_j", "rise_k", "path", "missing"];
        // An array in C has at least one element.
        let elements = (1..=surface.unwrap_or(1)).map(|k| format!("surface[{k}]"));
        named
            .iter()
            .map(|name| (*name).to_owned())
            .chain(elements)
            .collect()
    }
}

/// β, 1/A, and α of a branch; β is zero for a linear one.
fn kinetics(branch: &Branch) -> (f64, f64) {
    match branch.law {
        Law::Symmetric { beta } => (beta, 0.5),
        Law::Asymmetric { beta, alpha } => (beta, alpha),
        Law::Linear => (0.0, 0.5),
    }
}
