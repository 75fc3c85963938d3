//! Prints a map and what it is worth.

use analysis::map::{CellMap, ErrorSource, LogScore, MapFit, SpectrumScore};
use bench_evaluate::investigate::cell_map::{files::role, headline::headline};
use bench_plan::support::terminal::say;

/// States of charge whose resistances are printed, if the map has them as knots.
const SHOWN_SOC: [f64; 5] = [0.1, 0.2, 0.5, 0.8, 1.0];

/// Prints the errors, the resistances and the remarks.
pub(in crate::command) fn print(fit: &MapFit) {
    let map = &fit.map;
    say!("{}", headline(fit));
    print_logs(&fit.logs);
    print_spectra(&fit.spectra);
    say!("");
    say!("  series resistance / mΩ (± standard deviation), and with all branches");
    let shown = |soc: f64| SHOWN_SOC.iter().any(|z| (z - soc).abs() < 1e-9);
    let all = !map.soc.iter().any(|soc| shown(*soc));
    for (j, degc) in map.temperature_degc.iter().enumerate() {
        for (k, soc) in map.soc.iter().enumerate() {
            if !all && !shown(*soc) {
                continue;
            }
            let sigma = map.series.sigma_ohm.get(j).map_or(f64::NAN, |row| row[k]);
            say!(
                "  {degc:>6.1} °C  SOC {soc:.2}  {:>7.2} ± {:.2}  {:>7.2}",
                1e3 * map.series.r_ohm[j][k],
                1e3 * sigma,
                1e3 * map.model_at(*soc, *degc).dc_resistance_ohm()
            );
        }
    }
    let of_branches = map.branches.first().map_or_else(String::new, |branch| {
        let energy = 1e-3 * branch.resistance.activation_j_per_mol;
        format!(", {energy:.1} of the branches")
    });
    say!(
        "  activation energy: {:.1} kJ/mol of the series resistance{of_branches}",
        1e-3 * map.series.activation_j_per_mol
    );
    if let Some(thermal) = map.thermal {
        say!(
            "  heat capacity {:.1} J/K, {:.2} K/W to the surroundings",
            thermal.capacity_j_per_k,
            thermal.resistance_k_per_w
        );
    }
    print_error(map);
    if !fit.logs.is_empty() {
        say!("  residuals are correlated over {:.0} s", fit.correlation_s);
    }
    if fit.lag_s != 0.0 {
        say!(
            "  the voltage of the logs lags their current by {:.0} ms; the errors allow for it",
            1e3 * fit.lag_s
        );
    }
    for note in &fit.notes {
        say!("note: {note}");
    }
}

/// Prints the error that the map states for other loads.
fn print_error(map: &CellMap) {
    let Some(error) = &map.voltage_error else {
        return;
    };
    let shares = map.temperature_degc.iter().zip(&error.share);
    let shares: Vec<String> = shares
        .map(|(degc, share)| format!("{:.1} % at {degc:.0} °C", 100.0 * share))
        .collect();
    let from = match error.from {
        ErrorSource::HeldOut => "from held-out logs",
        ErrorSource::LeftOut => "from left-out pieces; other loads may be farther off",
    };
    say!(
        "  error of the voltage (1σ): {:.1} mV at rest, {:.2} % of charge, of the overpotential {} ({from})",
        1e3 * error.rest_v,
        100.0 * error.soc,
        shares.join(", ")
    );
}

fn print_logs(logs: &[LogScore]) {
    if logs.is_empty() {
        return;
    }
    say!("");
    say!(
        "  {:>7}  {:>10}  {:>7}  {:>9}  {:>8}  {:>22}  log",
        "rms/mV",
        "unseen/mV",
        "bias/mV",
        "in band/%",
        "T/°C",
        "worst band"
    );
    for score in logs {
        let worst = score.worst.map_or_else(String::new, |(low, v)| {
            format!("SOC {low:.1}–{:.1}: {:.1} mV", low + 0.1, 1e3 * v)
        });
        say!(
            "  {:>7.1}  {:>10}  {:>7.1}  {:>9}  {:>8.1}  {worst:>22}  {} ({})",
            1e3 * score.rms_v,
            number(score.unseen_v(), 1e3),
            1e3 * score.bias_v,
            number(score.covered, 100.0),
            score.temperature_degc,
            score.name,
            role(score.role)
        );
        let outside = score.outside;
        if outside.soc > 0.02 || outside.temperature_k > 2.0 {
            say!(
                "           leaves the measured range by up to {:.2} of charge and {:.1} K",
                outside.soc,
                outside.temperature_k
            );
        }
    }
}

fn number(value: Option<f64>, factor: f64) -> String {
    value.map_or_else(|| "–".to_owned(), |v| format!("{:.1}", factor * v))
}

fn print_spectra(spectra: &[SpectrumScore]) {
    if spectra.is_empty() {
        return;
    }
    say!("");
    say!(
        "  {:>5}  {:>6}  {:>8}  {:>10}  spectrum",
        "SOC",
        "T/°C",
        "error/%",
        "left out/%"
    );
    for score in spectra {
        let left_out = score
            .left_out
            .map_or_else(String::new, |left| format!("{:.1}", 100.0 * left.part));
        say!(
            "  {:>5.2}  {:>6.1}  {:>8.1}  {left_out:>10}  {} ({})",
            score.soc,
            score.temperature_degc,
            100.0 * score.rms_part,
            score.name,
            role(score.role)
        );
    }
    let inside: Vec<f64> = spectra
        .iter()
        .filter_map(|score| Some(score.left_out?.inside))
        .collect();
    if !inside.is_empty() {
        say!(
            "  {:.0} % of the parts of all spectra lie in the band of 95 % of a fit without the spectrum",
            100.0 * inside.iter().sum::<f64>() / inside.len() as f64
        );
    }
}
