//! Tables and sentences of models, shared by the reports of `run` and `fit`.

use analysis::{
    fit::{ErmFit, Objective},
    report::{Level, Table, Verdict},
    spectrum::FlaggedPoint,
};
use jiff::Timestamp;

/// JSON of a result: of one alone itself, of several a list.
///
/// # Errors
/// A value that JSON cannot hold.
pub fn one_or_list<T: serde::Serialize>(all: &[T]) -> Result<String, serde_json::Error> {
    match all {
        [one] => serde_json::to_string_pretty(one),
        several => serde_json::to_string_pretty(several),
    }
}

/// A time, s since 1970, as a date in UTC: `2026-11-22T06:07:06Z`.
pub fn utc(unix_s: f64) -> String {
    #[expect(clippy::cast_possible_truncation, reason = "it saturates")]
    let time = Timestamp::from_second(unix_s.max(0.0) as i64).unwrap_or(Timestamp::MAX);
    time.strftime("%Y-%m-%dT%H:%M:%SZ").to_string()
}

/// Returns the title of a picture or a page, with the name of the object if it has one.
pub fn titled(what: &str, name: &str) -> String {
    if name.is_empty() {
        what.to_owned()
    } else {
        format!("{what}, {name}")
    }
}

/// Returns R of a fit with its standard deviation, mΩ.
pub fn r_mohm(fit: &ErmFit) -> String {
    let sigma = fit.sigma.r_ohm.map(|sigma| 1.0e3 * sigma);
    number(1.0e3 * fit.erm.r_ohm, sigma)
}

/// Returns the DC resistance of a fit with its standard deviation, mΩ.
pub fn dc_resistance_mohm(fit: &ErmFit) -> String {
    let sigma = fit.sigma.dc_resistance_ohm.map(|sigma| 1.0e3 * sigma);
    number(1.0e3 * fit.erm.dc_resistance_ohm(), sigma)
}

/// One row per order; the recommended one is marked.
pub fn models_table(fits: &[ErmFit], recommended: Option<usize>) -> Table {
    let header = [
        "RC",
        "objective",
        "R / mΩ",
        "DC resistance / mΩ",
        "rms residual / µΩ",
        "reduced χ²",
    ];
    let row = |fit: &ErmFit| {
        vec![
            match fit.erm.branches.len() {
                rc if Some(rc) == recommended => format!("{rc} (recommended)"),
                rc => rc.to_string(),
            },
            objective(fit),
            r_mohm(fit),
            dc_resistance_mohm(fit),
            format!("{:.2}", 1.0e6 * fit.rms_ohm),
            fit.reduced_chi2
                .map_or_else(|| "–".to_owned(), |chi2| format!("{chi2:.2}")),
        ]
    };
    Table {
        caption: "Fitted extended Randles models (value ± one standard deviation)".to_owned(),
        header: header.map(str::to_owned).to_vec(),
        rows: fits.iter().map(row).collect(),
    }
}

/// One row per branch of each order.
pub fn branches_table(fits: &[ErmFit]) -> Table {
    let header = ["RC", "branch", "R / mΩ", "C / F", "time constant / s"];
    let rows = fits.iter().flat_map(|fit| {
        fit.erm.branches.iter().enumerate().map(|(index, branch)| {
            let sigma = fit.sigma.branches.get(index);
            vec![
                fit.erm.branches.len().to_string(),
                (index + 1).to_string(),
                number(
                    1.0e3 * branch.r_ohm,
                    sigma
                        .and_then(|sigma| sigma.r_ohm)
                        .map(|sigma| 1.0e3 * sigma),
                ),
                number(branch.c_f, sigma.and_then(|sigma| sigma.c_f)),
                number(
                    branch.r_ohm * branch.c_f,
                    sigma.and_then(|sigma| sigma.time_constant_s),
                ),
            ]
        })
    });
    Table {
        caption: "Branches by rising time constant".to_owned(),
        header: header.map(str::to_owned).to_vec(),
        rows: rows.collect(),
    }
}

/// The warnings of the fits as lines of a verdict.
pub fn fit_warnings(fits: &[ErmFit]) -> Vec<Verdict> {
    fits.iter()
        .flat_map(|fit| {
            fit.warnings.iter().map(|warning| Verdict {
                level: Level::Note,
                text: format!("{} RC: {warning}", fit.erm.branches.len()),
            })
        })
        .collect()
}

/// The objective's value with its unit.
pub fn objective(fit: &ErmFit) -> String {
    match fit.objective_kind {
        Objective::Complex => significant(fit.objective, 5),
        kind => format!("{} {}", significant(fit.objective, 5), kind.unit()),
    }
}

/// Formats a value with its standard deviation, if known.
fn number(value: f64, sigma: Option<f64>) -> String {
    sigma.map_or_else(
        || significant(value, 5),
        |sigma| format!("{} ± {}", significant(value, 5), significant(sigma, 2)),
    )
}

/// Formats a number with this many significant digits, without exponent while that is readable.
pub fn significant(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let magnitude = value.abs().log10().floor() as i32;
    if (-4..=6).contains(&magnitude) {
        format!(
            "{value:.*}",
            usize::try_from(digits - 1 - magnitude).unwrap_or(0)
        )
    } else {
        format!("{value:.*e}", usize::try_from(digits - 1).unwrap_or(0))
    }
}

/// Most points that are listed one by one.
const MOST_LISTED: usize = 6;

/// Points that a quality gate has refused, with the reasons.
pub fn refused_in_words(flagged: &[FlaggedPoint]) -> String {
    let listed = flagged.iter().take(MOST_LISTED).map(|point| {
        format!(
            "{} Hz ({})",
            significant(point.freq_hz, 5),
            point.reasons.join("; ")
        )
    });
    let more = flagged.len().saturating_sub(MOST_LISTED);
    listed
        .chain((more > 0).then(|| format!("{more} more")))
        .collect::<Vec<_>>()
        .join(", ")
}

#[cfg(test)]
mod tests {
    use super::significant;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (unix_s, date) in [
            (0.0, "1970-01-01T00:00:00Z"),
            (951_782_399.0, "2000-02-28T23:59:59Z"),
            (951_782_400.0, "2000-02-29T00:00:00Z"),
            (1_735_689_599.9, "2024-12-31T23:59:59Z"),
            (1_795_327_626.0, "2026-11-22T06:07:06Z"),
        ] {
            assert_eq!(super::utc(unix_s), date);
        }
    }

    #[test]
    fn numbers_keep_their_significant_digits() {
        for (value, digits, text) in [
            (1084.243, 5, "1084.2"),
            (0.000_834_33, 4, "0.0008343"),
            (6.43, 3, "6.43"),
            (123_456.0, 2, "123456"),
            (1.5e-9, 3, "1.50e-9"),
        ] {
            assert_eq!(significant(value, digits), text);
        }
    }
}
