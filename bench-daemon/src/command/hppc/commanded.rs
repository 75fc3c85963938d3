//! The current of a trace of a run beside that of its command: what the drive leaves while the command
//! is zero is a rest.

use analysis::{
    dataset::{Commanded, TraceEntry},
    series::TimeSeries,
};

/// Sets the current to zero where it was commanded to be, and subtracts what the drive has left there
/// from all other rows: the voltage before a pulse contains it, too. Returns the current that was left,
/// A, discharge positive; `None` if the steps of the trace are not known.
pub(super) fn subtract_residual(series: &mut TimeSeries, trace: &TraceEntry) -> Option<f64> {
    let Some(Commanded::Steps(levels)) = &trace.commanded else {
        return None;
    };
    if levels.len() != trace.steps_s.len() + 1 {
        return None;
    }
    let level_a = |time_s: f64| {
        let passed = trace.steps_s.iter().filter(|step_s| **step_s < time_s);
        levels.get(passed.count()).map_or(0.0, |(_, amps)| *amps)
    };
    let at_zero: Vec<bool> = series
        .time_s
        .iter()
        .map(|time_s| level_a(*time_s) == 0.0)
        .collect();
    let mut resting: Vec<f64> = series
        .current_a
        .iter()
        .zip(&at_zero)
        .filter(|(amps, zero)| **zero && amps.is_finite())
        .map(|(amps, _)| *amps)
        .collect();
    resting.sort_by(f64::total_cmp);
    let residual_a = resting.get(resting.len() / 2).copied()?;
    for (amps, zero) in series.current_a.iter_mut().zip(at_zero) {
        *amps = if zero { 0.0 } else { *amps - residual_a };
    }
    Some(residual_a)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace(commanded: &str) -> TraceEntry {
        let text = format!(
            r#"{{"file":"series_p_1.bdf.csv","name":"p","repeat":1,"order":0,"start_time_s":100,
            "start_ocv_v":3.7,"charge_before_c":0,"temperature_c":null,"role":"train",
            "repeat_group":"p","current_positive":"charge","current_between_samples":"linear",
            "steps_s":[10.0,20.0],"sample_sigma_a":0.01,"sample_sigma_v":0.001,
            "commanded":{commanded}}}"#
        );
        serde_json::from_str(&text).unwrap()
    }

    #[test]
    fn what_is_left_at_a_command_of_zero_is_a_rest_and_no_part_of_a_pulse() {
        let series = || TimeSeries {
            name: "s".to_owned(),
            time_s: vec![1.0, 5.0, 9.0, 10.1, 19.9, 20.1, 30.0],
            current_a: vec![-0.04, -0.05, -0.04, 2.21, 2.20, -0.03, f64::NAN],
            voltage_v: vec![3.7; 7],
            temperature_degc: None,
        };
        let mut settled = series();
        let steps = trace(r#"{"steps":[[100,0.0],[110,-2.25],[120,0.0]]}"#);
        assert_eq!(subtract_residual(&mut settled, &steps), Some(-0.04));
        assert_eq!(settled.current_a[..3], [0.0; 3]);
        assert!((settled.current_a[3] - 2.25).abs() < 1.0e-12);
        assert_eq!(settled.current_a[5..], [0.0; 2]);
        // A trace whose steps were not all found, or that is a wave, stays as it is.
        for unknown in [
            r#"{"steps":[[100,0.0],[110,-2.25]]}"#,
            r#"{"wave":{"sent_s":100,"step_s":0.001}}"#,
        ] {
            let mut same = series();
            assert_eq!(subtract_residual(&mut same, &trace(unknown)), None);
            assert_eq!(same.current_a[..6], series().current_a[..6]);
        }
    }
}
