//! Each interlock alone protects the cell: a fault of the simulated bench that no other interlock
//! detects ends in a trip, and the cell's stress log shows no harm. With that one interlock
//! widened or disabled, the same fault harms the cell.

use bench_evaluate::run::Session;
use fixtures::{Witness, witness::AbuseKind};

use crate::support::{CELL, EXPERIMENT, Files, SCENARIO};

/// Slow sinusoids of 1 A through the cell, some four minutes each.
fn sweep(points: usize) -> Files {
    Files::demo()
        .without(EXPERIMENT, "temperature")
        .without(EXPERIMENT, "soc_reset")
        .without(EXPERIMENT, "fixture_check")
        .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"0.05 Hz\"")
        .edit(EXPERIMENT, "stop = \"300 Hz\"", "stop = \"0.1 Hz\"")
        .edit(EXPERIMENT, "points = 20", &format!("points = {points}"))
        .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
}

/// Returns files with the reset of the state of charge, then two fast points.
fn reset() -> Files {
    Files::brief(2).without(EXPERIMENT, "fixture_check")
}

/// Returns the result of a run, and the stress log of the cell.
fn lived(files: &Files) -> (String, Witness) {
    let experiment = files.load();
    let mut session = Session::new(&experiment.bench).unwrap();
    let ended = session
        .run(&experiment, &files.path("run"))
        .err()
        .map_or_else(|| "finished".to_owned(), |failure| failure.to_string());
    let witness = session
        .simulation()
        .unwrap()
        .world()
        .lock()
        .unwrap()
        .witness();
    (ended, witness)
}

struct Case {
    files: fn() -> Files,
    /// Fault: the table `[faults]` and other lines of the bench.
    faults: &'static str,
    /// Changes of `[interlock]` in both runs.
    common: &'static [(&'static str, &'static str)],
    /// Changes that keep the interlock, and those that remove it: the file, the replaced text, and
    /// the replacement.
    with: &'static [(&'static str, &'static str, &'static str)],
    without: &'static [(&'static str, &'static str, &'static str)],
    trip: &'static str,
    harm: AbuseKind,
}

impl Case {
    fn run(&self, changes: &[(&str, &str, &str)]) -> (String, Witness) {
        // The interlock is tested with a limit that would be refused as too wide.
        let files = (self.files)()
            .without(CELL, "absolute")
            .append(SCENARIO, self.faults);
        let files = self
            .common
            .iter()
            .fold(files, |files, (from, to)| files.edit(CELL, from, to));
        lived(
            &changes
                .iter()
                .fold(files, |files, (file, from, to)| files.edit(file, from, to)),
        )
    }

    fn prove(&self) {
        let (ended, witness) = self.run(self.with);
        // If an ammeter has stopped, it cannot be verified afterwards that no current flows.
        assert!(
            ended.contains(&format!("interlock: {}", self.trip)),
            "expected {:?}: {ended}",
            self.trip
        );
        assert_eq!(witness.abuse, [], "{ended}: {witness:?}");
        let (ended, witness) = self.run(self.without);
        assert!(
            witness.abuse.iter().any(|abuse| abuse.kind == self.harm),
            "{}: {ended}: {witness:?}",
            self.trip
        );
    }
}

const NEARLY_FULL: (&str, &str, &str) = (SCENARIO, "initial_soc = 0.60", "initial_soc = 0.981");
/// The crests of 1 A are within 4.15 V at the beginning of a sweep and leave it in its course.
const CHARGED: (&str, &str, &str) = (SCENARIO, "initial_soc = 0.60", "initial_soc = 0.977");
/// The setting for 2.6 V.
const EMPTIED: (&str, &str, &str) = (SCENARIO, "initial_soc = 0.60", "initial_soc = 0.010");
/// Disables the check whether a reading changes with a slow sinusoid.
const BLIND: (&str, &str) = ("frozen_time = \"30 s\"", "frozen_time = \"3600 s\"");
const WEAK: (&str, &str, &str) = (SCENARIO, "[cell]", "[cell]\ngreatest_charge_a = 5.0");

#[test]
#[ignore = "drill"]
fn only_the_voltage_limit_saves_a_cell_that_a_drifting_supply_charges() {
    let case = Case {
        files: || sweep(20),
        faults: "[faults]\nbipolar_drifts = { from_s = 60.0, a_per_s = 0.05, greatest_a = 0.1 }",
        common: &[(
            "charge_drift_max = \"0.5 %\"",
            "charge_drift_max = \"1000 %\"",
        )],
        with: &[
            CHARGED,
            (CELL, "voltage_max = \"4.2 V\"", "voltage_max = \"4.15 V\""),
        ],
        without: &[
            CHARGED,
            (CELL, "voltage_max = \"4.2 V\"", "voltage_max = \"4.9 V\""),
        ],
        trip: "cell voltage 4.15",
        harm: AbuseKind::OverVoltage,
    };
    case.prove();
}

#[test]
#[ignore = "drill"]
fn only_the_charge_balance_saves_a_cell_whose_voltmeter_has_stopped() {
    let case = Case {
        files: || sweep(20),
        faults: "[faults]\nvoltmeter_freezes_s = 55.0\n\
        bipolar_drifts = { from_s = 60.0, a_per_s = 0.05, greatest_a = 0.1 }",
        common: &[
            ("frozen_charge = \"1 %\"", "frozen_charge = \"1000 %\""),
            BLIND,
        ],
        with: &[NEARLY_FULL],
        without: &[
            NEARLY_FULL,
            (
                CELL,
                "charge_drift_max = \"0.5 %\"",
                "charge_drift_max = \"1000 %\"",
            ),
        ],
        trip: "net charge of the step 8",
        harm: AbuseKind::OverVoltage,
    };
    case.prove();
}

#[test]
fn only_the_look_at_frozen_values_saves_a_cell_that_is_discharged_by_a_blind_load() {
    let case = Case {
        files: reset,
        faults: "[faults]\nvoltmeter_freezes_s = 60.0",
        common: &[],
        with: &[],
        // Nor does any noise show.
        without: &[
            (
                CELL,
                "frozen_charge = \"1 %\"",
                "frozen_charge = \"1000 %\"",
            ),
            (SCENARIO, "[faults]", "[meters]\nnoise_v = 0.0\n[faults]"),
        ],
        trip: "charge while the cell voltage stood still 16",
        harm: AbuseKind::UnderVoltage,
    };
    case.prove();
}

#[test]
fn only_the_current_limit_saves_a_cell_from_a_supply_that_runs_away() {
    let case = Case {
        files: || sweep(2),
        faults: "[faults]\nbipolar_drifts = { from_s = 60.0, a_per_s = 0.05, greatest_a = 12.0 }",
        common: &[BLIND],
        with: &[WEAK],
        // No meter shows the current.
        without: &[
            WEAK,
            (SCENARIO, "[faults]", "[faults]\nammeter_freezes_s = 3.0"),
        ],
        trip: "cell current 1.",
        harm: AbuseKind::OverCharge,
    };
    case.prove();
}

#[test]
fn only_the_temperature_limit_saves_a_cell_that_grows_warm_slowly() {
    let case = Case {
        files: || sweep(6),
        faults: "[thermal]\nblock_k_per_w = 50.0\n[faults]\n\
        heater = { from_s = 60.0, watts = 5.0 }",
        common: &[],
        with: &[(
            CELL,
            "temperature_max = \"60 °C\"",
            "temperature_max = \"45 °C\"",
        )],
        without: &[(
            CELL,
            "temperature_max = \"60 °C\"",
            "temperature_max = \"200 °C\"",
        )],
        trip: "cell temperature 45.",
        harm: AbuseKind::OverTemperature,
    };
    case.prove();
}

#[test]
fn only_the_rate_of_the_temperature_saves_a_cell_whose_thermometer_has_come_off() {
    let case = Case {
        files: || sweep(6),
        faults: "[thermal]\nblock_k_per_w = 50.0\n[faults]\n\
        heater = { from_s = 60.0, watts = 10.0 }\nthermometer_ceiling_c = 45.0",
        common: &[],
        with: &[],
        without: &[(CELL, "\"5 K/min\"", "\"600 K/min\"")],
        trip: "rate of the cell temperature ",
        harm: AbuseKind::OverTemperature,
    };
    case.prove();
}

#[test]
fn only_the_age_of_the_readings_saves_a_cell_whose_instruments_become_slow() {
    let case = Case {
        files: || sweep(2),
        faults: "[faults]\nslow_answers = { from_s = 60.0, late_s = 1.5 }\n\
        bipolar_drifts = { from_s = 100.0, a_per_s = 1.0, greatest_a = 12.0 }",
        common: &[],
        with: &[WEAK, (CELL, "\"15 s\"", "\"3 s\"")],
        without: &[WEAK, (CELL, "\"15 s\"", "\"60 s\"")],
        trip: "time without a reading ",
        harm: AbuseKind::OverCharge,
    };
    case.prove();
}

#[test]
fn only_the_chillers_own_word_saves_a_cell_that_is_no_longer_cooled() {
    let tempered = || {
        Files::demo()
            .without(EXPERIMENT, "fixture_check")
            .edit(
                EXPERIMENT,
                "discharge_current = \"5 A\"",
                "discharge_current = \"10 A\"",
            )
            .edit(
                EXPERIMENT,
                "discharge_until = \"3.52 V\"",
                "discharge_until = \"3.00 V\"",
            )
            .edit(EXPERIMENT, "start = \"0.1 Hz\"", "start = \"100 Hz\"")
            .edit(EXPERIMENT, "points = 20", "points = 2")
            .edit(EXPERIMENT, "rc = [1, 2, 3, 4]", "rc = [1]")
    };
    let case = Case {
        files: tempered,
        faults: "[faults]\nthermometer_ceiling_c = 29.0\n\
        chiller_stops = { from_s = 700.0, block_k_per_w = 50.0 }",
        common: &[("frozen_charge = \"1 %\"", "frozen_charge = \"1000 %\"")],
        with: &[(SCENARIO, "[cell]", "[cell]\ngreatest_c = 30.0")],
        without: &[
            (SCENARIO, "[cell]", "[cell]\ngreatest_c = 30.0"),
            (SCENARIO, "50.0 }", "50.0, silent = true }"),
        ],
        trip: "chiller: expected it to run without an alarm, found `-01 LOW LEVEL ALARM`",
        harm: AbuseKind::OverTemperature,
    };
    case.prove();
}

#[test]
#[ignore = "drill"]
fn only_the_voltage_limit_saves_a_cell_that_a_drifting_supply_discharges() {
    let case = Case {
        files: || sweep(20),
        faults: "[faults]\nbipolar_drifts = { from_s = 60.0, a_per_s = -0.05, greatest_a = 0.1 }",
        common: &[(
            "charge_drift_max = \"0.5 %\"",
            "charge_drift_max = \"1000 %\"",
        )],
        with: &[
            EMPTIED,
            (CELL, "voltage_min = \"2.5 V\"", "voltage_min = \"2.6 V\""),
        ],
        without: &[
            EMPTIED,
            (CELL, "voltage_min = \"2.5 V\"", "voltage_min = \"0.5 V\""),
        ],
        trip: "cell voltage 2.5",
        harm: AbuseKind::UnderVoltage,
    };
    case.prove();
}

#[test]
fn only_the_look_at_frozen_values_saves_a_cell_in_a_sweep_whose_ammeter_has_stopped() {
    let case = Case {
        files: || sweep(2),
        faults: "[faults]\nammeter_freezes_s = 3.0\n\
        bipolar_drifts = { from_s = 100.0, a_per_s = 0.05, greatest_a = 12.0 }",
        common: &[],
        with: &[WEAK],
        without: &[WEAK, (CELL, BLIND.0, BLIND.1)],
        trip: "time in which the cell current stood still under a sinusoid ",
        harm: AbuseKind::OverCharge,
    };
    case.prove();
}

#[test]
fn only_the_look_at_frozen_values_saves_a_cell_in_a_sweep_whose_voltmeter_has_stopped() {
    let case = Case {
        files: || sweep(20),
        faults: "[faults]\nvoltmeter_freezes_s = 55.0\n\
        bipolar_drifts = { from_s = 60.0, a_per_s = 0.05, greatest_a = 0.1 }",
        common: &[
            (
                "charge_drift_max = \"0.5 %\"",
                "charge_drift_max = \"1000 %\"",
            ),
            ("frozen_charge = \"1 %\"", "frozen_charge = \"1000 %\""),
        ],
        with: &[NEARLY_FULL],
        without: &[NEARLY_FULL, (CELL, BLIND.0, BLIND.1)],
        trip: "time in which the cell voltage stood still under a sinusoid ",
        harm: AbuseKind::OverVoltage,
    };
    case.prove();
}

#[test]
fn only_the_age_of_the_temperature_saves_a_cell_without_a_sensor() {
    let case = Case {
        files: || sweep(2),
        faults: "[faults]\nslow_answers = { from_s = 60.0, late_s = 1.9 }\n\
        heater = { from_s = 61.0, watts = 60.0 }",
        common: &[
            ("\"5 K/min\"", "\"600 K/min\""),
            ("reading_age_max = \"15 s\"", "reading_age_max = \"600 s\""),
        ],
        with: &[(
            CELL,
            "temperature_age_max = \"60 s\"",
            "temperature_age_max = \"10 s\"",
        )],
        without: &[(
            CELL,
            "temperature_age_max = \"60 s\"",
            "temperature_age_max = \"3600 s\"",
        )],
        trip: "time without a cell temperature ",
        harm: AbuseKind::OverTemperature,
    };
    case.prove();
}

#[test]
fn only_a_missing_reading_tells_of_a_thermometer_that_has_come_off_altogether() {
    let case = Case {
        files: || sweep(6),
        faults: "[thermal]\nblock_k_per_w = 50.0\n[faults]\n\
        heater = { from_s = 60.0, watts = 10.0 }\nthermometer_opens_s = 65.0",
        common: &[("\"5 K/min\"", "\"600 K/min\"")],
        with: &[],
        // It is still connected to the bath, which is not warmer than it should be.
        without: &[(
            SCENARIO,
            "thermometer_opens_s = 65.0",
            "thermometer_ceiling_c = 26.0",
        )],
        trip: "cell temperature cannot be read: its meter gives no number",
        harm: AbuseKind::OverTemperature,
    };
    case.prove();
}
