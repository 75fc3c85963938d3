//! A filter that the logger puts on the current of all records, and its correction.

use super::finding::{Finding, FindingKind, names};
use super::scene::Scene;
use crate::current_filter::Form;

pub(super) fn find(scene: &Scene<'_>) -> Vec<Finding> {
    let Some(filter) = &scene.at.expected.filter else {
        return Vec::new();
    };
    let runs: Vec<String> = filter.records.iter().map(|r| r.run.clone()).collect();
    let what = if filter.form == Form::Mean {
        "of length"
    } else {
        "with a time constant of"
    };
    let [by_voltage, by_log] = filter.at_once.map(|part| 100.0 * part);
    vec![Finding {
        kind: FindingKind::CurrentFilter,
        text: format!(
            "{}: the logged current has passed {} {what} {:.3} ± {:.3} s",
            names(&runs),
            filter.form,
            filter.tau_s,
            filter.sigma_s
        ),
        how_sure: format!(
            "{} edges; it leaves {:.2} % of the squares that no filter leaves. In its first \
            sample the voltage shows {by_voltage:.0} % of a step, the logged current \
            {by_log:.0} %: the logger is slow, not the source",
            filter.edges,
            100.0 * filter.left
        ),
        effect: "Every edge is simulated too late: fast processes of the cell look slow, and laws \
            that no cell has fit best. The steps of the current can be used instead of the logged \
            current."
            .to_owned(),
        runs,
        correctable: true,
    }]
}
