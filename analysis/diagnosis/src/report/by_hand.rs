//! What was put into the base, or left out of it, by hand: the gap before and after.

use super::numbers::plain;
use super::page::{Item, Section};
use super::words::named_title;
use crate::outcome::Diagnosis;

pub(super) fn section(d: &Diagnosis) -> Section {
    let Some(asked) = &d.by_hand else {
        return Section::default();
    };
    let titles = |names: &[&'static str]| {
        let titles: Vec<String> = names.iter().map(|name| named_title(name)).collect();
        titles.join(", ")
    };
    let mut parts = Vec::new();
    if !asked.added.is_empty() {
        parts.push(format!(
            "Put into the base by hand: {}.",
            titles(&asked.added)
        ));
    }
    if !asked.left_out.is_empty() {
        parts.push(format!("Left out by hand: {}.", titles(&asked.left_out)));
    }
    parts.push(format!(
        "χ² of the fitted runs changes from {:.0} to {:.0}, everything else fitted again.",
        asked.before_chi2, asked.after_chi2
    ));
    let value = |v: f64| format!("{} mV", plain(v));
    let rows = asked.gap.iter().map(|gap| {
        vec![
            gap.run.clone(),
            value(gap.base_mv),
            value(gap.augmented_mv),
            value(gap.floor_mv),
        ]
    });
    let mut items = vec![Item::Text(parts.join(" "))];
    if asked.gap.is_empty() {
        items.push(Item::Text(
            "No held-out record shows the effect.".to_owned(),
        ));
    } else {
        let header = vec!["Held-out run", "Before", "After", "Floor"];
        items.push(Item::Table(header, rows.collect()));
    }
    Section::new("By hand", items)
}
