//! A model as people type it: `6.43 mΩ; 1.51 mΩ, 0.553 F; 0.66 mΩ, 4.6 ms`.
//!
//! Elements in series stand between semicolons: first the series resistance, then branches of a
//! resistance and a capacitance, or a resistance and a time constant.

use analysis_model::model::{Erm, RcBranch};

use super::quantity::{Capacitance, Dimension, Duration, Quantity, Resistance};

/// Parses a typed model; branches stay in the order in which they were typed.
///
/// # Errors
/// Which element is wrong, what was expected and what was found.
pub fn parse(text: &str) -> Result<Erm, String> {
    let mut elements: Vec<&str> = text.split(';').map(str::trim).collect();
    // A semicolon at the end ends the last element.
    if elements.len() > 1 && elements.last().is_some_and(|last| last.is_empty()) {
        elements.pop();
    }
    let place = |k: usize, element: &str, reason: String| {
        format!("element {}, \"{element}\": {reason}", k + 1)
    };
    let mut erm: Option<Erm> = None;
    for (k, element) in elements.into_iter().enumerate() {
        match &mut erm {
            None => {
                let r_ohm = series(element).map_err(|reason| place(k, element, reason))?;
                erm = Some(Erm {
                    r_ohm,
                    branches: Vec::new(),
                });
            }
            Some(erm) => erm
                .branches
                .push(branch(element).map_err(|reason| place(k, element, reason))?),
        }
    }
    erm.ok_or_else(|| {
        format!("expected a model such as \"6.43 mΩ; 1.51 mΩ, 0.553 F\", found \"{text}\"")
    })
}

fn series(element: &str) -> Result<f64, String> {
    if element.contains(',') {
        let reason = "expected the series resistance by itself, such as \"6.43 mΩ\" (commas part a \
        branch's two values, decimals have a point)";
        return Err(format!("{reason}, found two values"));
    }
    positive::<Resistance>(element)
}

fn branch(element: &str) -> Result<RcBranch, String> {
    let values: Vec<&str> = element.split(',').map(str::trim).collect();
    let [r, second] = values.as_slice() else {
        let reason = "expected a branch of a resistance and a capacitance or time constant, such \
        as \"1.51 mΩ, 0.553 F\"";
        let decimals = if values.len() > 2 {
            " (decimals have a point)"
        } else {
            ""
        };
        return Err(format!(
            "{reason}{decimals}, found {} value{}",
            values.len(),
            if values.len() == 1 { "" } else { "s" }
        ));
    };
    let r_ohm = positive::<Resistance>(r)?;
    match (
        Quantity::<Capacitance>::parse(second),
        Quantity::<Duration>::parse(second),
    ) {
        (Ok(_), _) => Ok(RcBranch {
            r_ohm,
            c_f: positive::<Capacitance>(second)?,
        }),
        (_, Ok(_)) => Ok(RcBranch {
            r_ohm,
            c_f: positive::<Duration>(second)? / r_ohm,
        }),
        _ => {
            let expected =
                "a capacitance or a time constant with its unit, such as \"0.553 F\" or \"0.8 ms\"";
            Err(format!("expected {expected}, found {second:?}"))
        }
    }
}

/// A quantity above zero.
fn positive<D: Dimension>(text: &str) -> Result<f64, String> {
    let si = Quantity::<D>::parse(text)?.si;
    if si > 0.0 {
        Ok(si)
    } else {
        Err(format!("expected {} above zero, found {text:?}", D::NAME))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_appendix_is_read_as_it_is_printed() {
        let erm = parse(
            " 6.43 mΩ; 1.51 mOhm,0.553 F ; 0.66 mohm, 4.6 ms; 4.77 m\u{2126}, 1.084 \
        kF; 2e-4 Ohm, 550 mF;",
        )
        .unwrap();
        assert_eq!(erm.r_ohm, 6.43 * 1e-3);
        let expected = [
            (1.51e-3, 0.553),
            (0.66e-3, 4.6 / 0.66),
            (4.77e-3, 1084.0),
            (2e-4, 0.55),
        ];
        assert_eq!(erm.branches.len(), expected.len());
        for (met, (r_ohm, c_f)) in erm.branches.iter().zip(expected) {
            assert!(
                (met.r_ohm / r_ohm - 1.0).abs() < 1e-12 && (met.c_f / c_f - 1.0).abs() < 1e-12,
                "{met:?}"
            );
        }
        assert!(parse("0.01 Ω").unwrap().branches.is_empty());
    }

    #[test]
    fn what_is_wrong_is_reported_with_its_element() {
        for (text, expected) in [
            (
                "",
                "element 1, \"\": expected a resistance with its unit, such as \"9.96 mΩ\", \
                found \"\"",
            ),
            (
                "6.43",
                "element 1, \"6.43\": expected a resistance with its unit, such as \"9.96 mΩ\", \
                found \"6.43\"",
            ),
            (
                "6,43 mΩ",
                "element 1, \"6,43 mΩ\": expected the series resistance by itself, such as \"6.43 \
                mΩ\" (commas part a branch's two values, decimals have a point), found two values",
            ),
            (
                "1 Ω; 2 Ω",
                "element 2, \"2 Ω\": expected a branch of a resistance and a capacitance or time \
                constant, such as \"1.51 mΩ, 0.553 F\", found 1 value",
            ),
            (
                "1 Ω; 1,51 mΩ, 2 F",
                "element 2, \"1,51 mΩ, 2 F\": expected a branch of a resistance and a capacitance \
                or time constant, such as \"1.51 mΩ, 0.553 F\" (decimals have a point), found 3 \
                values",
            ),
            (
                "1 Ω; 2 F, 1 Ω",
                "element 2, \"2 F, 1 Ω\": expected a resistance with its unit, such as \"9.96 \
                mΩ\", found \"2 F\"",
            ),
            (
                "1 Ω; 2 Ω, 1 V",
                "element 2, \"2 Ω, 1 V\": expected a capacitance or a time constant with its unit, \
                such as \"0.553 F\" or \"0.8 ms\", found \"1 V\"",
            ),
            (
                "0 Ω",
                "element 1, \"0 Ω\": expected a resistance above zero, found \"0 Ω\"",
            ),
            (
                "1 Ω; 1 Ω, -2 F",
                "element 2, \"1 Ω, -2 F\": expected a capacitance above zero, found \"-2 F\"",
            ),
            (
                "1 Ω; 1 Ω, 0 s",
                "element 2, \"1 Ω, 0 s\": expected a duration above zero, found \"0 s\"",
            ),
            (
                "1 Ω;; 1 Ω, 1 F",
                "element 2, \"\": expected a branch of a resistance and a capacitance or time \
                constant, such as \"1.51 mΩ, 0.553 F\", found 1 value",
            ),
        ] {
            assert_eq!(parse(text).unwrap_err(), expected);
        }
    }
}
