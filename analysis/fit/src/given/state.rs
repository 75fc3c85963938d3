//! State of the runs that a map is compared with.

/// Distance of two states of charge, and of two temperatures, K, that one model of small signals covers.
const NEAR_SOC: f64 = 0.1;
const NEAR_K: f64 = 5.0;

/// State at which the runs of a cell start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StateOfRuns {
    /// Mean state of charge, 0…1.
    pub soc: f64,
    /// Mean temperature, °C.
    pub temperature_degc: f64,
    /// Largest difference of the states of charge.
    pub spread_soc: f64,
    /// Largest difference of the temperatures, K.
    pub spread_k: f64,
}

impl StateOfRuns {
    /// Returns a remark if one model does not cover the runs.
    pub(super) fn remark(&self) -> Option<String> {
        (self.spread_soc > NEAR_SOC || self.spread_k > NEAR_K).then(|| {
            format!(
                "the runs start at states up to {:.2} of charge and {:.1} K apart, which one model of small \
                signals does not cover: part of the gap may be the distance from its state",
                self.spread_soc, self.spread_k
            )
        })
    }
}
