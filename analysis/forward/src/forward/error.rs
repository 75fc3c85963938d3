//! Why a simulation cannot be made.

use super::law::Demand;
use analysis_model::pack::PackError;

/// Reason why a simulation cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ForwardError {
    /// A pack or a cell's model that cannot be.
    #[error(transparent)]
    Pack(#[from] PackError),
    /// A number is invalid.
    #[error("{what}: expected {expected}, met {met}")]
    Value {
        /// Name of the quantity.
        what: &'static str,
        /// Requirement on the value.
        expected: &'static str,
        /// Value met.
        met: f64,
    },
    /// A voltage that the OCV curve does not reach.
    #[error(
        "open-circuit voltage: expected one that the model's curve reaches, {low_v:.3} to \
        {high_v:.3} V, met {met} V"
    )]
    OcvRange {
        /// Lowest voltage of the curve, V.
        low_v: f64,
        /// Highest voltage of the curve, V.
        high_v: f64,
        /// Voltage met, V.
        met: f64,
    },
    /// A state of another model.
    #[error("state: expected {expected} branch voltages, as the model has branches, met {met}")]
    Branches {
        /// Branches of the model.
        expected: usize,
        /// Voltages of the state.
        met: usize,
    },
    /// More branches than a batch takes.
    #[error("batch: expected at most {most} RC branches, met {met}")]
    TooManyBranches {
        /// Most that are possible.
        most: usize,
        /// Branches met.
        met: usize,
    },
    /// The voltage behind the series resistance is gone: the model means nothing there.
    #[error(
        "after {time_s} s: expected a positive voltage behind the series resistance, met {e_v} V; \
        the demand is far beyond the model"
    )]
    Collapsed {
        /// Time, s.
        time_s: f64,
        /// OCV less the branch voltages, V.
        e_v: f64,
    },
    /// A step with which explicit Euler diverges.
    #[error(
        "explicit Euler: expected steps below {:.4} ms, twice the shortest time constant of {:.4} \
        ms, met {:.4} ms; {:.4} ms is usable",
        2e3 * tau_s, 1e3 * tau_s, 1e3 * step_s, 1e3 * usable_s
    )]
    Unstable {
        /// Longest step met, s.
        step_s: f64,
        /// Shortest time constant, s.
        tau_s: f64,
        /// A step that is usable, s: a quarter of it.
        usable_s: f64,
    },
    /// A demand that a method cannot answer.
    #[error("{demand:?} demand: expected {expected}")]
    Demand {
        /// Kind of the demand.
        demand: Demand,
        /// Demand that the method takes.
        expected: &'static str,
    },
    /// Additions that a method or a source of the OCV cannot honour.
    #[error("{what}: expected {expected}, met a model with {names}")]
    Additions {
        /// Requested task.
        what: &'static str,
        /// Additions that the task takes.
        expected: &'static str,
        /// Names of the additions.
        names: String,
    },
    /// A map that cannot be.
    #[error("{0}")]
    Map(String),
    /// A map whose integration does not settle.
    #[error("map: expected halved steps to agree within {tolerance_v:.1e} V, met {met_v:.1e} V")]
    MapUnresolved {
        /// Largest difference allowed, V.
        tolerance_v: f64,
        /// Difference met with the shortest steps, V.
        met_v: f64,
    },
    /// Additions whose integration does not settle.
    #[error(
        "additions {names}: expected halved steps to agree within {tolerance_v:.1e} V, met \
        {met_v:.1e} V"
    )]
    Unresolved {
        /// Names of the additions.
        names: String,
        /// Largest difference allowed, V.
        tolerance_v: f64,
        /// Difference found with the shortest steps, V.
        met_v: f64,
    },
}
