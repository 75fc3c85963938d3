//! The text as a person reads it.

use super::sample;
use crate::{
    outcome::{Diagnosis, NoiseReport},
    report::{Distinguishability, catalogue_markdown, catalogue_text, markdown, pictures, text},
};
use analysis_effects::{contract::Card, effects::catalogue};

#[test]
fn every_verdict_for_a_terminal() {
    let cases: [(&str, Diagnosis); 5] = [
        ("explained", sample::explained()),
        ("ambiguous", sample::ambiguous()),
        ("unexplained", sample::unexplained()),
        ("at_floor", sample::at_floor()),
        ("invalid", sample::invalid()),
    ];
    for (name, d) in cases {
        let words = text(&d);
        assert!(
            words.lines().all(|l| l.chars().count() <= 100),
            "{name}: {words}"
        );
        insta::assert_snapshot!(name, words);
    }
}

#[test]
fn markdown_has_its_pictures_in_their_places() {
    let d = sample::explained();
    let page = markdown(&d, &pictures(&d, &sample::runs()));
    insta::assert_snapshot!("explained_markdown", page);
    let at = |needle: &str| page.find(needle).unwrap_or_else(|| panic!("{needle}"));
    let order = [
        "## Where",
        "(where.png)",
        "(residual-1-profile_B.png)",
        "## What\n",
        "(ranking.png)",
        "## Gap",
        "(gap.png)",
    ];
    assert!(order.windows(2).all(|w| at(w[0]) < at(w[1])));
}

/// Names of the code have an underscore between letters; names of runs may have one before a number.
fn is_of_the_code(word: &str) -> bool {
    let letters = |c: Option<char>| c.is_some_and(char::is_alphabetic);
    word.match_indices('_').any(|(at, _)| {
        letters(word[..at].chars().next_back()) && letters(word[at + 1..].chars().next())
    })
}

#[test]
fn the_first_page_has_no_name_of_the_code_and_no_statistics() {
    let several = Diagnosis {
        effects: [sample::explained().effects, sample::ambiguous().effects].concat(),
        ..sample::unexplained()
    };
    for d in [
        sample::explained(),
        sample::ambiguous(),
        sample::unexplained(),
        sample::at_floor(),
        sample::invalid(),
        several,
    ] {
        let words = text(&d);
        let (first, details) = words.split_once("DETAILS").unwrap();
        for word in first.split_whitespace() {
            let statistics = ["χ", "λ", "σ", "Holm", "Lagrange", "p-value"];
            assert!(
                !is_of_the_code(word) && !statistics.iter().any(|s| word.contains(s)),
                "{word} in {first}"
            );
        }
        assert!(
            details.contains("χ²") && first.contains("What to do next"),
            "{words}"
        );
    }
}

/// That six of four blocks are left is understandable only if the text states that new ones have
/// appeared.
#[test]
fn blocks_that_come_with_the_effects_are_distinguished_from_those_that_stay() {
    let mut d = sample::explained();
    d.blocks.truncate(4);
    d.where_after = sample::explained().blocks.split_off(3);
    d.where_after.truncate(3);
    let words = text(&d).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        words.contains("1 of them is left. 2 others are outside then that were not before"),
        "{words}"
    );
}

#[test]
fn no_floor_is_claimed_without_repeats() {
    for base in [
        sample::explained(),
        sample::unexplained(),
        sample::at_floor(),
    ] {
        let d = Diagnosis {
            noise: NoiseReport {
                from_repeats: false,
                ..base.noise.clone()
            },
            ..base
        };
        let words = text(&d);
        assert!(
            words.contains("no floor is claimed")
                && words.contains("without repeats the floor is unknown"),
            "{words}"
        );
        assert!(
            !words.contains("Floor  ") && !words.contains("At the noise floor"),
            "{words}"
        );
    }
}

#[test]
fn the_catalogue_with_its_matrix() {
    let cards: Vec<&Card> = ["rc_slow", "time_skew"]
        .iter()
        .filter_map(|n| analysis_effects::effects::find(n))
        .map(|e| e.card())
        .collect();
    let matrix = matrix();
    insta::assert_snapshot!("catalogue", catalogue_text(&cards, Some(&matrix)));
    let all: Vec<&Card> = catalogue().iter().map(|e| e.card()).collect();
    let page = catalogue_markdown(&all, Some(&matrix), &matrix.pictures());
    assert!(
        all.iter()
            .all(|c| page.contains(&format!("### {}: ", c.name.replace('_', "\\_")))),
        "{page}"
    );
    assert!(page.contains("(distinguishability.png)") && page.contains("(separation.png)"));
}

pub(super) fn matrix() -> Distinguishability {
    let labels = [
        "rc_slow",
        "diffusion",
        "hysteresis",
        "self_heating",
        "soc_resistance",
        "inductance",
        "time_skew",
    ]
    .map(str::to_owned);
    let mut r = vec![vec![0.97; 7]; 7];
    for (a, b, v) in [
        (0, 1, 0.03),
        (1, 0, 0.04),
        (0, 2, 0.6),
        (1, 2, 0.34),
        (2, 0, 0.64),
        (3, 4, 0.42),
        (4, 3, 0.99),
        (5, 6, 0.0007),
    ] {
        r[a][b] = v;
    }
    r[2][3] = f64::NAN;
    let separation_sigma = r
        .iter()
        .map(|row| row.iter().map(|v| (v * 100.0).sqrt()).collect())
        .collect();
    Distinguishability {
        labels: labels.to_vec(),
        r,
        separation_sigma,
    }
}
