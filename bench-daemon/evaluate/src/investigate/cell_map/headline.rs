//! The error of a map in one line.

use analysis::{
    map::{LogScore, MapFit, SpectrumScore},
    series::Role,
};

/// What the map is worth: on logs in mV, on spectra as a part of the impedance.
pub fn headline(fit: &MapFit) -> String {
    let of_spectra = headline_of_spectra(&fit.spectra);
    match (fit.logs.is_empty(), of_spectra) {
        (true, Some(of_spectra)) => of_spectra,
        (false, Some(of_spectra)) => {
            format!("{}; {of_spectra}", headline_of_logs(&fit.logs))
        }
        (_, None) => headline_of_logs(&fit.logs),
    }
}

/// Error on spectra that the fit has not seen, else on those that each fit leaves out, else on the
/// fitted ones.
fn headline_of_spectra(spectra: &[SpectrumScore]) -> Option<String> {
    let held_out: Vec<(&SpectrumScore, f64)> = spectra
        .iter()
        .filter(|score| score.role == Role::HeldOut)
        .map(|score| (score, score.rms_part))
        .collect();
    let left_out: Vec<(&SpectrumScore, f64)> = spectra
        .iter()
        .filter_map(|score| Some((score, score.left_out?.part)))
        .collect();
    let (mut chosen, what) = match (held_out.is_empty(), left_out.is_empty()) {
        (false, _) => (held_out, "held-out spectra"),
        (true, false) => (left_out, "spectra, each left out of a fit"),
        (true, true) => {
            let all = spectra
                .iter()
                .map(|score| (score, score.rms_part))
                .collect();
            (all, "fitted spectra (none was held out)")
        }
    };
    chosen.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (worst, most) = chosen.last()?;
    Some(format!(
        "error on {what}: {:.1} % of the impedance in the median; weakest at SOC {:.2} and {:.0} °C: \
        {:.1} %",
        100.0 * chosen[chosen.len() / 2].1,
        worst.soc,
        worst.temperature_degc,
        100.0 * most
    ))
}

/// What the map is worth on logs, and where it is weakest.
fn headline_of_logs(logs: &[LogScore]) -> String {
    let unseen: Vec<(&LogScore, f64)> = logs
        .iter()
        .filter_map(|log| Some((log, log.unseen_v()?)))
        .collect();
    let is_held_out = logs.iter().any(|log| log.role == Role::HeldOut);
    let (chosen, what) = match (is_held_out, unseen.is_empty()) {
        (true, _) => (unseen, "held-out logs"),
        (false, false) => (unseen, "pieces of the logs, each left out of a fit"),
        (false, true) => (
            logs.iter().map(|log| (log, log.rms_v)).collect(),
            "fitted logs (none was held out)",
        ),
    };
    let rms_v = || {
        let all = chosen.iter().map(|(_, rms_v)| *rms_v);
        all.filter(|rms_v| rms_v.is_finite())
    };
    let Some(most) = rms_v().max_by(f64::total_cmp) else {
        return format!("error on {what}: none reaches a state of charge above 0.1");
    };
    let least = rms_v().fold(most, f64::min);
    let worst = chosen
        .iter()
        .filter_map(|(l, _)| l.worst.map(|(soc, v)| (soc, v, l.temperature_degc)))
        .max_by(|a, b| a.1.total_cmp(&b.1));
    let weakest = worst.map_or_else(String::new, |(soc, v, degc)| {
        format!(
            "; weakest at SOC {soc:.1}–{:.1} and {degc:.0} °C: {:.1} mV",
            soc + 0.1,
            1e3 * v
        )
    });
    format!(
        "error on {what}: {:.1} to {:.1} mV rms{weakest}",
        1e3 * least,
        1e3 * most
    )
}
