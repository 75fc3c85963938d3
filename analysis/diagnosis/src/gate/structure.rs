//! Checks for numbers that cannot come from a measurement: missing ones, not finite ones, times
//! that go back.

use super::super::data::{Run, RunData, Sweep};
use super::{Check, Findings, Inspection};
use analysis_signal::series::TimeSeries;

pub(super) fn check(at: &Inspection<'_>) -> Findings {
    let mut found = Findings::default();
    for subject in &at.runs {
        let fault = match &subject.run.data {
            RunData::Eis(sweep) => of_sweep(sweep),
            RunData::Time(record) => of_series(&record.series),
        };
        let fault = fault.or_else(|| of_circumstances(subject.run));
        if let Some((check, text)) = fault {
            found.add(check, subject.run, text);
        }
    }
    found
}

fn of_circumstances(run: &Run) -> Option<(Check, String)> {
    let known = run.temperature_degc.is_finite() && run.start_s.is_finite();
    (!known).then(|| {
        (
            Check::NotFinite,
            format!(
                "expected a finite temperature and start, met {} °C and {} s",
                run.temperature_degc, run.start_s
            ),
        )
    })
}

fn of_series(series: &TimeSeries) -> Option<(Check, String)> {
    let n = series.len();
    if n < 2 || series.current_a.len() != n || series.voltage_v.len() != n {
        let (i, v) = (series.current_a.len(), series.voltage_v.len());
        return Some((
            Check::Empty,
            format!(
                "expected two samples or more of everything, met {n} times, {i} currents and {v} \
                voltages"
            ),
        ));
    }
    let columns = [
        ("time", &series.time_s),
        ("current", &series.current_a),
        ("voltage", &series.voltage_v),
    ];
    for (name, column) in columns {
        if let Some(k) = column.iter().position(|v| !v.is_finite()) {
            return Some((
                Check::NotFinite,
                format!(
                    "sample {}: expected a finite {name}, met {}",
                    k + 1,
                    column[k]
                ),
            ));
        }
    }
    let k = series.time_s.windows(2).position(|w| w[1] <= w[0])?;
    let (before, after) = (series.time_s[k], series.time_s[k + 1]);
    Some((
        Check::TimesGoBack,
        format!(
            "its times go back: after {before} s comes {after} s (sample {})",
            k + 2
        ),
    ))
}

fn of_sweep(sweep: &Sweep) -> Option<(Check, String)> {
    if sweep.points.is_empty() {
        return Some((
            Check::Empty,
            "expected a point or more, met none".to_owned(),
        ));
    }
    let number = |k: usize| format!("point {} ({} Hz)", k + 1, sweep.points[k].freq_hz);
    let finite = |p: &super::super::data::SweepPoint| {
        p.freq_hz.is_finite() && p.z_ohm.re.is_finite() && p.z_ohm.im.is_finite()
    };
    if let Some(k) = sweep.points.iter().position(|p| !finite(p)) {
        return Some((
            Check::NotFinite,
            format!(
                "{}: expected a finite impedance, met {} Ω",
                number(k),
                sweep.points[k].z_ohm
            ),
        ));
    }
    if let Some(k) = sweep
        .points
        .iter()
        .position(|p| p.freq_hz <= 0.0 || p.z_ohm.norm() == 0.0)
    {
        return Some((
            Check::Empty,
            format!(
                "{}: expected a frequency and an impedance other than zero",
                number(k)
            ),
        ));
    }
    let k = sweep
        .points
        .windows(2)
        .position(|w| w[1].freq_hz <= w[0].freq_hz)?;
    Some((
        Check::TimesGoBack,
        format!("{}: expected rising frequencies", number(k + 1)),
    ))
}
