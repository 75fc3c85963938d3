//! Values of a metric.

/// A value with its labels.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Name and value of each label.
    pub labels: Vec<(&'static str, String)>,
    /// The value.
    pub value: f64,
}

impl Sample {
    /// The only value of a metric without labels.
    pub fn plain(value: f64) -> Vec<Self> {
        vec![Self {
            labels: Vec::new(),
            value,
        }]
    }
}
