//! The state of charge of a point that a bench has measured.

use analysis_model::ocv::OcvCurve;

/// Difference between the voltage at rest and the curve, V, and between both states of charge, up to
/// which the counted charge holds.
const CLOSE_V: f64 = 0.03;
const CLOSE_SOC: f64 = 0.03;

/// Returns the state of charge of a point from the charge counted since a full charge and from its
/// voltage at rest, V.
///
/// The counted charge holds if the curve agrees with it within 30 mV or 3 %: a map then finds the error
/// of the curve and its change with temperature, which a state of charge by the voltage would hide.
/// Otherwise the count cannot be right, and the voltage decides; `None` if the curve does not have it.
pub fn soc_of_point(counted: f64, rest_v: f64, ocv: &OcvCurve) -> Option<f64> {
    let by_voltage = ocv.soc_at(rest_v);
    let close_v = (ocv.voltage_v(counted.clamp(0.0, 1.0)) - rest_v).abs() <= CLOSE_V;
    let close_soc = by_voltage.is_some_and(|soc| (soc - counted).abs() <= CLOSE_SOC);
    if (0.0..=1.0).contains(&counted) && (close_v || close_soc) {
        Some(counted)
    } else {
        by_voltage
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counted_charge_holds_where_the_curve_agrees_in_voltage_or_in_charge() {
        // 1 V from empty to 80 %, 10 mV from there to full.
        let curve = OcvCurve::monotone(3.0, vec![0.0, 0.4, 0.8, 1.0], vec![3.0, 3.5, 4.0, 4.01]);
        let curve = curve.unwrap();
        let at = |counted: f64, rest_v: f64| soc_of_point(counted, rest_v, &curve);
        // By 25 mV; on the flat part by 9 mV, which are 18 % of charge.
        assert_eq!(at(0.4, 3.525), Some(0.4));
        assert_eq!(at(0.82, 4.01), Some(0.82));
        // 10 % and 120 mV away: by the voltage.
        let far = at(0.4, 3.62).unwrap();
        assert!((far - curve.soc_at(3.62).unwrap()).abs() < 1e-12 && far > 0.47);
        assert_eq!(at(0.4, 4.2), None);
        assert_eq!(at(1.02, 4.2), None);
    }
}
