//! Circuit strings and lists of values.

use crate::model::{Circuit, ElementKind, MAX_DEPTH, MAX_ELEMENTS};
use proptest::prelude::*;

fn error(text: &str) -> String {
    text.parse::<Circuit>().unwrap_err().to_string()
}

#[test]
fn names_and_units_are_those_of_impedance_py() {
    let circuit: Circuit = " R0 - p( R_1 , CPE1 )-p(R2 -Wo2,\tC10)-Gs1"
        .parse()
        .unwrap();
    assert_eq!(circuit.to_string(), "R0-p(R_1,CPE1)-p(R2-Wo2,C10)-Gs1");
    assert_eq!(
        circuit.parameter_names(),
        [
            "R0", "R_1", "CPE1_0", "CPE1_1", "R2", "Wo2_0", "Wo2_1", "C10", "Gs1_0", "Gs1_1",
            "Gs1_2"
        ]
    );
    let units: Vec<&str> = circuit
        .parameter_kinds()
        .iter()
        .map(|kind| kind.unit)
        .collect();
    assert_eq!(
        units,
        ["Ω", "Ω", "Ω^-1 s^α", "", "Ω", "Ω", "s", "F", "Ω", "s", ""]
    );
}

#[test]
fn errors_show_the_place_and_what_was_expected() {
    let known = "R, C, L, La, W, Wo, Ws, CPE, G, Gs, K, Zarc, TLMQ, T, Ga, Ha, H, Tlmbs, Tlmbq, Ls, \
        Tlmns, Tlmnq, or p(…)";
    let cases = [
        ("", "circuit, character 1: expected an element such as R0, or p(…), met the end of the \
        text\n  \n  ^".to_owned()),
        ("R0-", "circuit, character 4: expected an element such as R0, or p(…), met the end of the \
        text\n  R0-\n     ^".to_owned()),
        (
            "R0-p(R1,C1",
            "circuit, character 11: expected \",\", \"-\" or \")\", met the end of the text\n  \
            R0-p(R1,C1\n            ^".to_owned(),
        ),
        ("p(R1)", "circuit, character 5: expected \",\" and a second branch of p(…), met ')'\n  \
        p(R1)\n      ^".to_owned()),
        ("R0 R1", "circuit, character 4: expected \"-\" and another block, or the end, met 'R'\n  \
        R0 R1\n     ^".to_owned()),
        (
            "R0-R",
            "circuit, character 5: expected a number after the element's kind, such as R1, met the \
            end of the text\n  R0-R\n      ^"
                .to_owned(),
        ),
        (
            "R0-p(R0,C1)",
            "circuit, character 6: expected a name that no other element has, met \"R0\" again\n  \
            R0-p(R0,C1)\n       ^".to_owned(),
        ),
        (
            "R0-CPe1",
            format!("circuit, character 4: expected one of the elements {known}, met \"CPe\" (did \
            you mean CPE?)\n  R0-CPe1\n     ^"),
        ),
        ("R0-Q1", format!("circuit, character 4: expected one of the elements {known}, met \"Q\" \
        (did you mean CPE?)\n  R0-Q1\n     ^")),
        ("Xyz1", format!("circuit, character 1: expected one of the elements {known}, \
        met \"Xyz\"\n  Xyz1\n  ^")),
    ];
    for (text, expected) in cases {
        assert_eq!(error(text), expected, "{text}");
    }
    assert!(error("ZARC1").contains("(did you mean Zarc?)"));
}

#[test]
fn a_long_text_is_shown_around_the_place() {
    let text = (0..40)
        .map(|k| format!("R{k}"))
        .collect::<Vec<_>>()
        .join("-")
        + "-X1-"
        + &(40..60)
            .map(|k| format!("C{k}"))
            .collect::<Vec<_>>()
            .join("-");
    let message = error(&text);
    let lines: Vec<&str> = message.lines().collect();
    assert_eq!(lines.len(), 3, "{message}");
    let column = lines[2].chars().position(|c| c == '^').unwrap();
    assert_eq!(lines[1].chars().nth(column), Some('X'), "{message}");
    assert!(
        lines[1].starts_with("  …") && lines[1].ends_with('…') && lines[1].chars().count() < 70
    );
}

#[test]
fn size_is_bounded() {
    let nested =
        |depth: usize| (0..depth).fold("R0".to_owned(), |inner, k| format!("p({inner},C{k})"));
    assert!(nested(MAX_DEPTH).parse::<Circuit>().is_ok());
    assert!(
        error(&nested(MAX_DEPTH + 1)).contains("expected at most 32 levels of p(…), met one more")
    );
    let long = |count: usize| {
        (0..count)
            .map(|k| format!("R{k}"))
            .collect::<Vec<_>>()
            .join("-")
    };
    assert!(long(MAX_ELEMENTS).parse::<Circuit>().is_ok());
    assert!(error(&long(MAX_ELEMENTS + 1)).contains("expected at most 64 elements, met one more"));
    assert!("p(".repeat(100_000).parse::<Circuit>().is_err());
}

#[test]
fn values_are_given_by_name() {
    let circuit: Circuit = "R0-p(R1,CPE1)".parse().unwrap();
    assert_eq!(
        circuit
            .assignments("--guess", "CPE1_1 = 0.9, R0=1e-2")
            .unwrap(),
        [(3, 0.9), (0, 0.01)]
    );
    let cases = [
        (
            "R0=",
            "--guess, character 4: expected a value of R0 from 1e-12 to 1e12 Ω, met \"\"\n  \
            R0=\n     ^",
        ),
        (
            "R9=1",
            "--guess, character 1: expected one of the parameters R0, R1, CPE1_0, CPE1_1, \
            met \"R9\"\n  R9=1\n  ^",
        ),
        (
            "R0 1",
            "--guess, character 4: expected \"=\" and a value, met '1'\n  R0 1\n     ^",
        ),
        (
            "R0=1,R0=2",
            "--guess, character 6: expected each parameter once, met \"R0\" again\n  \
            R0=1,R0=2\n       ^",
        ),
        (
            "CPE1_1=1.2",
            "--guess, character 8: expected a value of CPE1_1 from 5e-2 to 1e0, met \"1.2\"\n  \
            CPE1_1=1.2\n         ^",
        ),
        (
            "R0=1 R1=2",
            "--guess, character 6: expected \",\" or the end, met 'R'\n  R0=1 R1=2\n       ^",
        ),
        (
            "",
            "--guess, character 1: expected one of the parameters R0, R1, CPE1_0, CPE1_1, met the \
            end of the text\n  \n  ^",
        ),
    ];
    for (text, expected) in cases {
        assert_eq!(
            circuit
                .assignments("--guess", text)
                .unwrap_err()
                .to_string(),
            expected,
            "{text}"
        );
    }
}

/// Returns shapes as text, without numbers: `#` replaces each number.
fn shape() -> impl Strategy<Value = String> {
    let element = prop::sample::select(ElementKind::ALL.to_vec())
        .prop_map(|kind| format!("{}#", kind.name()));
    element.prop_recursive(4, 40, 4, |inner| {
        let series = prop::collection::vec(inner.clone(), 1..4).prop_map(|blocks| blocks.join("-"));
        let parallel = prop::collection::vec(inner, 2..4)
            .prop_map(|branches| format!("p({})", branches.join(",")));
        prop_oneof![series, parallel]
    })
}

fn numbered(shape: &str) -> String {
    shape
        .split('#')
        .enumerate()
        .fold(String::new(), |text, (k, part)| {
            if k == 0 {
                part.to_owned()
            } else {
                format!("{text}{}{part}", k - 1)
            }
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn text_and_circuit_are_the_same(shape in shape()) {
        let text = numbered(&shape);
        prop_assume!(text.chars().filter(char::is_ascii_digit).count() < 100);
        if let Ok(circuit) = text.parse::<Circuit>() {
            prop_assert_eq!(&circuit.to_string(), &text);
            let spaced: String = text
                .chars()
                .flat_map(|c| {
                    if "-,()".contains(c) {
                        vec![' ', c, '\t']
                    } else {
                        vec![c]
                    }
                })
                .collect();
            prop_assert_eq!(spaced.parse::<Circuit>().unwrap(), circuit);
        } else {
            prop_assert!(shape.matches('#').count() > MAX_ELEMENTS);
        }
    }

    #[test]
    fn no_text_makes_the_parser_panic(text in r"[RCLWGKZ0-9p(),_ aosrc\[\]{}=F:!Y-]{0,60}", any in any::<String>()) {
        for text in [text, any] {
            match text.parse::<Circuit>() {
                Ok(circuit) => {
                    prop_assert_eq!(circuit.to_string().parse::<Circuit>().unwrap(), circuit.clone());
                    let _ = circuit.assignments("list", &text);
                }
                Err(error) => prop_assert!(error.to_string().contains('^') && error.index() <= text.chars().count()),
            }
        }
    }
}
