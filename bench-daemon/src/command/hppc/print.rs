//! Prints the table of pulse resistances.

use std::collections::BTreeMap;

use analysis::hppc::{Direction, Hppc, Pulse};

use bench_evaluate::support::present::significant;
use bench_plan::support::terminal::say;

/// Width of a resistance.
const WIDTH: usize = 16;
/// Width of a power with its time.
const POWER_WIDTH: usize = 22;

/// Prints both directions, and why cells are empty and loads are left out.
pub(super) fn table(found: &Hppc, states: &str) {
    let count = found.pulses.len();
    say!(
        "{}: {count} pulse{}; R in mΩ ± one standard uncertainty",
        found.name,
        if count == 1 { "" } else { "s" }
    );
    say!("  {states}");
    for direction in [Direction::Discharge, Direction::Charge] {
        let pulses: Vec<&Pulse> = found
            .pulses
            .iter()
            .filter(|pulse| pulse.direction == direction)
            .collect();
        if !pulses.is_empty() {
            block(found, direction, &pulses);
        }
    }
    for line in empty(found).into_iter().chain(notes(found)) {
        say!("  {line}");
    }
    if let Some(words) = found.left_out_in_words() {
        say!("  left out: {words}");
    }
}

fn block(found: &Hppc, direction: Direction, pulses: &[&Pulse]) {
    let state = if has_soc(found) { "SOC / %" } else { "Q / Ah" };
    let times: String = found
        .at_s
        .iter()
        .map(|at_s| format!(" {:>WIDTH$}", format!("R {at_s} s")))
        .collect();
    let power = if found.limits.is_some() {
        format!(" {:>POWER_WIDTH$}", "P / W")
    } else {
        String::new()
    };
    say!(
        "{}\n  {:>9} {:>8} {state:>8} {:>6} {:>8}{times}{power}",
        direction.word(),
        "start / s",
        "I / A",
        "T / °C",
        "OCV / V"
    );
    for pulse in pulses {
        row(found, pulse);
    }
}

/// Whether the state of charge of a pulse is known.
fn has_soc(found: &Hppc) -> bool {
    found.pulses.iter().any(|pulse| pulse.state.soc.is_some())
}

fn row(found: &Hppc, pulse: &Pulse) {
    let or_dash = |text: Option<String>| text.unwrap_or_else(|| "–".to_owned());
    let state = if has_soc(found) {
        let soc = pulse.state.soc;
        soc.map(|soc| format!("{:.1}", 100.0 * soc.value))
    } else {
        let drawn_ah = pulse.state.drawn_ah;
        drawn_ah.map(|drawn_ah| format!("{drawn_ah:.4}"))
    };
    let cells: String = pulse
        .resistances
        .iter()
        .map(|one| {
            let text = one.found.map(|found| {
                let sigma = found.sigma_ohm.map(|sigma| 1e3 * sigma);
                with_sigma(1e3 * found.ohm, sigma)
            });
            format!(" {:>WIDTH$}", or_dash(text))
        })
        .collect();
    let power = found.limits.map_or_else(String::new, |_| {
        let least = pulse
            .least_power
            .map(|least| format!("{} at {} s", with_sigma(least.w, least.sigma_w), least.at_s));
        format!(" {:>POWER_WIDTH$}", or_dash(least))
    });
    say!(
        "  {:>9.1} {:>8.3} {:>8} {:>6} {:>8}{cells}{power}",
        pulse.start_s,
        pulse.current_a,
        or_dash(state),
        or_dash(
            pulse
                .state
                .temperature_degc
                .map(|celsius| format!("{celsius:.1}"))
        ),
        or_dash(pulse.state.open_circuit.map(|ocv| format!("{:.4}", ocv.v)))
    );
}

/// Number of pulses with one kind of remark, and the first of them.
#[derive(Default)]
struct Kind {
    count: usize,
    first: String,
}

impl Kind {
    fn line(&self) -> String {
        match self.count {
            1 => self.first.clone(),
            count => format!("{} (and the like for {} more)", self.first, count - 1),
        }
    }
}

/// Remarks by their words up to the first number.
fn by_kind(all: impl Iterator<Item = (usize, String)>) -> Vec<(usize, Kind)> {
    let mut kinds: BTreeMap<(usize, String), Kind> = BTreeMap::new();
    for (place, text) in all {
        let words = text.split(|c: char| c.is_ascii_digit()).next();
        let kind = kinds
            .entry((place, words.unwrap_or_default().to_owned()))
            .or_default();
        if kind.count == 0 {
            kind.first = text;
        }
        kind.count += 1;
    }
    kinds
        .into_iter()
        .map(|((place, _), kind)| (place, kind))
        .collect()
}

/// Why cells are empty, by time.
fn empty(found: &Hppc) -> Vec<String> {
    let all = found.pulses.iter().flat_map(|pulse| {
        let each = pulse.resistances.iter().enumerate();
        each.filter_map(|(place, one)| {
            let reason = one.reason.as_ref()?;
            Some((place, format!("{reason} (pulse at {:.1} s)", pulse.start_s)))
        })
    });
    let lines = by_kind(all).into_iter();
    lines
        .map(|(place, kind)| format!("– at {} s: {}", found.at_s[place], kind.line()))
        .collect()
}

/// Remarks on pulses.
fn notes(found: &Hppc) -> Vec<String> {
    let all = found.pulses.iter().flat_map(|pulse| {
        let each = pulse.notes.iter();
        each.map(|note| (0, format!("{note} (pulse at {:.1} s)", pulse.start_s)))
    });
    let lines = by_kind(all).into_iter();
    lines
        .map(|(_, kind)| format!("note: {}", kind.line()))
        .collect()
}

/// A value with its uncertainty, as many digits as that allows, at most three decimals.
fn with_sigma(value: f64, sigma: Option<f64>) -> String {
    match sigma.filter(|sigma| *sigma > 0.0 && sigma.is_finite()) {
        Some(sigma) if sigma < LEAST_SIGMA => format!("{value:.3} ± <{LEAST_SIGMA}"),
        Some(sigma) => {
            // Two digits of the uncertainty.
            let decimals = (1.0 - sigma.log10().floor()).clamp(0.0, 3.0);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "0 to 3"
            )]
            let decimals = decimals as usize;
            format!("{value:.decimals$} ± {sigma:.decimals$}")
        }
        None => format!("{} ± ?", significant(value, 5)),
    }
}

/// Least uncertainty that is printed, in mΩ or W.
const LEAST_SIGMA: f64 = 0.001;
