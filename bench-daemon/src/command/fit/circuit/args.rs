//! Arguments of `fit` that concern circuits.

/// Arguments of `fit` that concern circuits.
#[derive(Debug, clap::Args)]
pub struct CircuitArgs {
    /// The circuit: elements in series `-` and in parallel `p(…,…)`, of the kinds R C L La W Wo Ws
    /// CPE G Gs K Zarc TLMQ T Ga Ha H Tlmbs Tlmbq Ls Tlmns Tlmnq with a number; or pyimpspec's
    /// code, such as `R{R=0.01}(R[CW])`, its values start values or, with F, held.
    #[arg(long, value_name = "CIRCUIT", conflicts_with = "rc")]
    pub circuit: Option<String>,
    /// Weight of the residuals: `unit`, `modulus` or `covariance` [default: for `complex` the
    /// covariance where all points have one, else the modulus; for the others unit]
    #[arg(long, requires = "circuit")]
    pub weight: Option<String>,
    /// Optional start values. If all are given, only the nearest optimum is searched, unless
    /// --starts is given.
    #[arg(long, requires = "circuit", value_name = "NAME=VALUE,…")]
    pub guess: Option<String>,
    /// Parameters that are held constant.
    #[arg(long, requires = "circuit", value_name = "NAME=VALUE,…")]
    pub constants: Option<String>,
    /// Search for the global optimum: `starts` (many local fits) or `evolution` (differential
    /// evolution, then local fits).
    #[arg(long, requires = "circuit", default_value = "starts")]
    pub search: String,
}
