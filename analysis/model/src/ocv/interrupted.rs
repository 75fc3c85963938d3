//! A slow discharge or charge with pauses in it. The change of the voltage in a pause gives the
//! resistance to direct current (DCIR), because no charge moves the open-circuit voltage during the
//! pause. Without the pauses it is a steady current, from which a curve can be found.
//!
//! R = (V at the end of the pause − V under load just before it) / i, with i positive for
//! discharge. It holds all that relaxes within the pause.

use serde::{Deserialize, Serialize};

use analysis_signal::series::TimeSeries;

/// A current below this fraction of the largest counts as zero.
const NONE: f64 = 0.02;
/// Samples before a pause that the voltage under load is a straight line through.
const BEFORE: usize = 20;
/// Samples at the end of a pause that the voltage is the mean of.
const AFTER: usize = 10;
/// The resistance is that of currents of at least this share of the largest.
const LARGE: f64 = 0.5;

/// One pause.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interruption {
    /// Charge drawn until then, C; negative for a charge.
    #[serde(rename = "charge_c")]
    pub charge_coulomb: f64,
    /// Current that was interrupted, discharge positive, A.
    pub current_a: f64,
    /// Resistance, Ω.
    pub resistance_ohm: f64,
    /// Its standard uncertainty by the scatter of the samples, Ω.
    pub sigma_ohm: f64,
    /// Length of the pause, s.
    pub rest_s: f64,
}

/// A series without its pauses, and the results of the pauses.
#[derive(Debug, Clone, PartialEq)]
pub struct Interrupted {
    /// Samples under current only, without those that follow its start so closely that the voltage
    /// had not settled. Its times are such that the trapezia of its current give the charge; they
    /// are not measured times.
    pub steady: TimeSeries,
    /// The pauses that are long enough.
    pub interruptions: Vec<Interruption>,
}

impl Interrupted {
    /// Returns the median of the resistances at the larger currents, Ω, and half their range, or
    /// `None` without a pause.
    pub fn resistance_ohm(&self) -> Option<(f64, f64)> {
        let most = self
            .interruptions
            .iter()
            .map(|pause| pause.current_a.abs())
            .fold(0.0, f64::max);
        let large = self
            .interruptions
            .iter()
            .filter(|pause| pause.current_a.abs() >= LARGE * most);
        let mut found: Vec<f64> = large.map(|pause| pause.resistance_ohm).collect();
        found.sort_by(f64::total_cmp);
        let (least, greatest) = (found.first()?, found.last()?);
        let middle = 0.5 * (found[(found.len() - 1) / 2] + found[found.len() / 2]);
        Some((middle, 0.5 * (greatest - least)))
    }
}

/// Takes the pauses out of a series, and the first `settle_s` after each change of the current.
/// `drawn_coulomb` is the charge drawn at each sample, C.
pub fn interrupted(series: &TimeSeries, drawn_coulomb: &[f64], settle_s: f64) -> Interrupted {
    let most = series
        .current_a
        .iter()
        .fold(0.0_f64, |most, amps| most.max(amps.abs()));
    let flows = |k: usize| series.current_a[k].abs() > NONE * most;
    let count = series.len().min(drawn_coulomb.len());
    let (mut kept, mut pauses, mut changed_s): (Vec<usize>, Vec<Interruption>, f64) =
        (Vec::new(), Vec::new(), f64::NEG_INFINITY);
    let mut leg = 0;
    for k in 0..count {
        let steady = k > 0
            && flows(k) == flows(k - 1)
            && (!flows(k) || (series.current_a[k] / series.current_a[k - 1]).ln().abs() < 0.5);
        if !steady {
            if flows(k) {
                changed_s = series.time_s[k];
            }
            leg = k;
        }
        let ends = k + 1 == count || flows(k + 1) != flows(k);
        if !flows(k) && ends {
            pauses.extend(pause(series, drawn_coulomb, leg..k + 1));
        }
        if flows(k) && series.time_s[k] - changed_s >= settle_s {
            kept.push(k);
        }
    }
    Interrupted {
        steady: squeezed(series, drawn_coulomb, &kept),
        interruptions: pauses,
    }
}

/// Returns the resistance from a pause, or `None` if the pause or the current before it is too
/// short.
fn pause(
    series: &TimeSeries,
    drawn_coulomb: &[f64],
    range: std::ops::Range<usize>,
) -> Option<Interruption> {
    let before = range.start.checked_sub(BEFORE)?..range.start;
    let last = range.start - 1;
    let current_a = series.current_a[last];
    let uniform = before
        .clone()
        .all(|k| (series.current_a[k] - current_a).abs() < 0.1 * current_a.abs());
    if range.len() < AFTER || current_a == 0.0 || !uniform {
        return None;
    }
    let (under_v, under_sigma) =
        line_end(&series.time_s[before.clone()], &series.voltage_v[before]);
    let rest = &series.voltage_v[range.end - AFTER..range.end];
    let rest_v = rest.iter().sum::<f64>() / AFTER as f64;
    let rest_sigma = (rest.iter().map(|v| (v - rest_v).powi(2)).sum::<f64>()
        / (AFTER * (AFTER - 1)) as f64)
        .sqrt();
    Some(Interruption {
        charge_coulomb: drawn_coulomb[last],
        current_a,
        resistance_ohm: (rest_v - under_v) / current_a,
        sigma_ohm: under_sigma.hypot(rest_sigma) / current_a.abs(),
        rest_s: series.time_s[range.end - 1] - series.time_s[last],
    })
}

/// Returns the straight line of least squares at the last point, and its standard uncertainty
/// there.
fn line_end(time_s: &[f64], volts: &[f64]) -> (f64, f64) {
    let n = time_s.len() as f64;
    let (mean_t, mean_v) = (
        time_s.iter().sum::<f64>() / n,
        volts.iter().sum::<f64>() / n,
    );
    let square = time_s
        .iter()
        .map(|t| (t - mean_t).powi(2))
        .sum::<f64>()
        .max(f64::MIN_POSITIVE);
    let slope = time_s
        .iter()
        .zip(volts)
        .map(|(t, v)| (t - mean_t) * (v - mean_v))
        .sum::<f64>()
        / square;
    let residual = time_s
        .iter()
        .zip(volts)
        .map(|(t, v)| (v - mean_v - slope * (t - mean_t)).powi(2))
        .sum::<f64>()
        / (n - 2.0);
    let ahead = time_s.last().map_or(0.0, |t| t - mean_t);
    (
        mean_v + slope * ahead,
        (residual * (1.0 / n + ahead * ahead / square)).sqrt(),
    )
}

/// Returns the samples of these numbers, with times in which the trapezia of their current are the
/// charge.
fn squeezed(series: &TimeSeries, drawn_coulomb: &[f64], kept: &[usize]) -> TimeSeries {
    let mut time_s = Vec::with_capacity(kept.len());
    for (place, &k) in kept.iter().enumerate() {
        let step = place.checked_sub(1).map_or(0.0, |before| {
            let last = kept[before];
            2.0 * (drawn_coulomb[k] - drawn_coulomb[last])
                / (series.current_a[k] + series.current_a[last])
        });
        time_s.push(time_s.last().copied().unwrap_or(0.0) + step);
    }
    let of = |values: &[f64]| kept.iter().map(|&k| values[k]).collect::<Vec<_>>();
    TimeSeries {
        name: series.name.clone(),
        time_s,
        current_a: of(&series.current_a),
        voltage_v: of(&series.voltage_v),
        temperature_degc: series.temperature_degc.as_deref().map(of),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1 A out of a cell of 4 V − 1 mV/C and 20 mΩ that settle with 3 s, for 200 s, four times,
    /// with pauses of 40 s; then 0.2 A.
    fn measured() -> (TimeSeries, Vec<f64>) {
        let (mut time_s, mut current_a, mut voltage_v, mut drawn_coulomb) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (mut q, mut relaxed_v) = (0.0, 0.0);
        let mut legs: Vec<(f64, usize)> = std::iter::repeat_n([(1.0, 200), (0.0, 40)], 4)
            .flatten()
            .collect();
        legs.push((0.2, 100));
        for (amps, seconds) in legs {
            for _ in 0..seconds {
                q += amps;
                relaxed_v += (0.02 * amps - relaxed_v) * (1.0 - (-1.0_f64 / 3.0).exp());
                time_s.push(time_s.last().map_or(1.0, |t| t + 1.0));
                current_a.push(amps);
                voltage_v.push(4.0 - 1.0e-3 * q - relaxed_v);
                drawn_coulomb.push(q);
            }
        }
        (
            TimeSeries {
                name: "legs".to_owned(),
                time_s,
                current_a,
                voltage_v,
                temperature_degc: None,
            },
            drawn_coulomb,
        )
    }

    #[test]
    fn pauses_tell_the_resistance_and_leave_a_steady_current_with_its_charge() {
        let (series, drawn_coulomb) = measured();
        let found = interrupted(&series, &drawn_coulomb, 25.0);
        assert_eq!(found.interruptions.len(), 4);
        assert!(
            found
                .interruptions
                .iter()
                .all(|pause| pause.rest_s == 40.0 && (pause.charge_coulomb % 200.0).abs() < 1e-9)
        );
        let (ohm, spread_ohm) = found.resistance_ohm().unwrap();
        assert!(
            (ohm - 0.02).abs() < 2e-6 && spread_ohm < 1e-6,
            "{ohm} ± {spread_ohm}"
        );
        let steady = &found.steady;
        assert_eq!(steady.len(), 4 * 175 + 75);
        steady.validate().unwrap();
        // From the 26th coulomb to the last; across the pauses and the change to the tail nothing
        // is lost.
        assert!((steady.charge_coulomb().last().unwrap() - (820.0 - 26.0)).abs() < 1e-9);
        for ((amps, volts), drawn) in steady
            .current_a
            .iter()
            .zip(&steady.voltage_v)
            .zip(steady.charge_coulomb())
        {
            assert!(
                (volts + amps * 0.02 - (4.0 - 1e-3 * (drawn + 26.0))).abs() < 1e-5,
                "{volts} V at {drawn} C"
            );
        }
    }

    #[test]
    fn what_is_too_short_says_nothing() {
        let (series, drawn_coulomb) = measured();
        let start = TimeSeries {
            time_s: series.time_s[..205].to_vec(),
            current_a: series.current_a[..205].to_vec(),
            voltage_v: series.voltage_v[..205].to_vec(),
            ..series
        };
        let found = interrupted(&start, &drawn_coulomb[..205], 25.0);
        assert_eq!(
            (found.interruptions.len(), found.resistance_ohm()),
            (0, None)
        );
    }
}
