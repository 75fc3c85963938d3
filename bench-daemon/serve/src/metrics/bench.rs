//! Quantities of each bench.

use super::{
    metric::{Metric, counter, gauge, metrics},
    sample::Sample,
    snapshot::Snapshot,
};
use crate::{
    controls::{ControlNow, Deviation},
    live::{BenchState, Live, ReadingNow},
};

fn flag(on: bool) -> Option<f64> {
    Some(f64::from(on))
}

/// Returns the reading of the cell. A time series must not contain an old reading, or one of a
/// control, as the present state of the cell.
fn of_cell(live: &Live) -> Option<&ReadingNow> {
    let reading = live.reading.as_ref()?;
    (reading.fresh && reading.fixture == "cell").then_some(reading)
}

/// One row for each state, of which one is 1.
fn states(now: &Snapshot<'_>) -> Vec<Sample> {
    let rows = |live: &Live| {
        let (bench, is) = (live.bench.clone(), live.state);
        BenchState::ALL.map(|state| Sample {
            labels: vec![("bench", bench.clone()), ("state", state.name().to_owned())],
            value: f64::from(state == is),
        })
    };
    now.live.iter().flat_map(rows).collect()
}

fn controls(
    now: &Snapshot<'_>,
    rows: impl Fn(&ControlNow) -> Vec<(Option<&'static str>, f64)>,
) -> Vec<Sample> {
    let of_bench = |live: &Live| {
        let noted = now.noted.benches.get(&live.bench);
        let controls = noted.map_or(&[][..], |health| &health.controls);
        let of_control = |control: &ControlNow| {
            let labels = vec![
                ("bench", live.bench.clone()),
                ("control", control.control.clone()),
            ];
            let sample = |(reading, value): (Option<&'static str>, f64)| {
                let mut labels = labels.clone();
                labels.extend(reading.map(|reading| ("reading", reading.to_owned())));
                Sample { labels, value }
            };
            rows(control).into_iter().map(sample).collect::<Vec<_>>()
        };
        controls.iter().flat_map(of_control).collect::<Vec<_>>()
    };
    now.live.iter().flat_map(of_bench).collect()
}

fn deviations(now: &Snapshot<'_>, value: impl Fn(Deviation) -> f64) -> Vec<Sample> {
    controls(now, |control| {
        let corrected = control
            .corrected
            .map(|found| (Some("corrected"), value(found)));
        [(Some("as_read"), value(control.as_read))]
            .into_iter()
            .chain(corrected)
            .collect()
    })
}

fn oldest_s(now: &Snapshot<'_>, live: &Live) -> f64 {
    let ages = now.waiting(&live.bench);
    ages.map(|item| (now.unix_s - item.submitted_unix_s).max(0.0))
        .fold(0.0, f64::max)
}

metrics! {
    /// All metrics of benches.
    gauge "state" ("") "State of the bench: 1 for the state that it is in." = states;
    gauge "running" ("") "A run is in work."
        = |now| now.benches(|live| flag(live.run.as_ref().is_some_and(|run| run.going)));
    gauge "latched" ("") "The bench is latched after a trip."
        = |now| now.benches(|live| flag(live.trip.is_some()));
    gauge "stopping" ("") "The bench is being stopped."
        = |now| now.benches(|live| flag(live.state == BenchState::Stopping));
    gauge "held" ("") "No run starts on the bench."
        = |now| now.benches(|live| flag(live.held.is_some()));
    gauge "outputs_verified" ("")
        "Nothing runs, and every output was last read back as off, by a reading that is current."
        = |now| now.benches(|live| flag(live.verified));
    gauge "outputs_need_look" ("")
        "Nothing runs, and the outputs were not read since a run, or not read as off."
        = |now| now.benches(|live| flag(live.needs_look));
    counter "trips_total" ("{trip}") "Trips since the server was started."
        = |now| now.noted(|health| Some(health.trips as f64));
    counter "runs_finished_total" ("{run}") "Runs of the queue that came to their end."
        = |now| now.noted(|health| Some(health.finished as f64));
    counter "runs_stopped_total" ("{run}") "Runs of the queue that a person stopped."
        = |now| now.noted(|health| Some(health.stopped as f64));
    counter "runs_failed_total" ("{run}")
        "Runs of the queue that did not come to their end and that no person stopped."
        = |now| now.noted(|health| Some(health.failed as f64));
    gauge "run_ended_timestamp_seconds" ("s")
        "Time at which the last run of the queue ended, since 1970."
        = |now| now.noted(|health| health.ended_unix_s);
    gauge "run_finished_timestamp_seconds" ("s")
        "Time at which the last run of the queue came to its end, since 1970."
        = |now| now.noted(|health| health.finished_unix_s);
    gauge "bench_queue_waiting" ("{run}") "Runs that wait for the bench."
        = |now| now.benches(|live| Some(now.waiting(&live.bench).count() as f64));
    gauge "bench_queue_oldest_age_seconds" ("s")
        "Time that the oldest of them has waited; 0 where none waits."
        = |now| now.benches(|live| Some(oldest_s(now, live)));
    gauge "run_started_timestamp_seconds" ("s")
        "Time at which the process of the run in work was started, since 1970."
        = |now| now.benches(|live| Some(now.in_work(&live.bench)?.process.as_ref()?.started_unix_s));
    gauge "run_expected_seconds" ("s") "Expected duration of the run in work, in bench time."
        = |now| now.benches(|live| Some(now.in_work(&live.bench)?.expected_s));
    gauge "run_left_seconds" ("s") "Time that the run in work has left, by the clock on the wall."
        = |now| now.benches(|live| live.run.as_ref().filter(|run| run.going)?.left_s);
    gauge "run_bench_time_seconds" ("s")
        "Bench time of the last entry or reading of the run in work, or of the last one."
        = |now| now.benches(|live| Some(live.run.as_ref()?.bench_time_s));
    gauge "run_points_done" ("{point}") "Points of the run that are finished."
        = |now| now.benches(|live| Some(live.run.as_ref()?.points_done as f64));
    gauge "run_done_ratio" ("1") "Share of the run that is done."
        = |now| now.benches(|live| Some(live.run.as_ref()?.done));
    gauge "cell_voltage_volts" ("V") "Last reading of the run in work."
        = |now| now.benches(|live| of_cell(live)?.voltage_v);
    gauge "cell_current_amperes" ("A") "Last reading of the run in work; positive for charge."
        = |now| now.benches(|live| of_cell(live)?.current_a);
    gauge "cell_temperature_celsius" ("Cel") "Last reading of the run in work."
        = |now| now.benches(|live| of_cell(live)?.temperature_degc);
    gauge "cell_soc_ratio" ("1") "State of charge, while a run is in work."
        = |now| now.benches(|live| of_cell(live).and(live.soc).map(|soc| soc.share));
    gauge "control_impedance_ohms" ("{ohm}")
        "Control impedance as read by the last run that has measured it, middle of its points."
        = |now| controls(now, |control| vec![(None, control.as_read_ohm)]);
    gauge "control_certified_ohms" ("{ohm}") "Certified resistance of the control impedance."
        = |now| controls(now, |control| vec![(None, control.certified_ohm)]);
    gauge "control_deviation_ratio" ("1")
        "Deviation of the control impedance from its certified value, as read (middle of its \
        points) and corrected (worst point)."
        = |now| deviations(now, |deviation| deviation.ratio);
    gauge "control_deviation_sigmas" ("")
        "The same in standard deviations of certificate and noise."
        = |now| deviations(now, |deviation| deviation.sigmas);
}
