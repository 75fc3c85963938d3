use super::*;
use crate::{
    dataset::write_trace_parquet,
    formats::{ReadOptions, read_profile},
};
use analysis_forward::forward::{CellWindow, OcvSource, SimModel, SimOptions, simulate};
use analysis_model::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
};
use std::fs;

/// A cell with four RC branches whose OCV is not constant.
fn curved_cell() -> SimModel {
    let erm = Erm {
        r_ohm: 0.006_428_6,
        branches: [0.552_8, 6.979_8, 663.8, 1_084.2]
            .map(|c_f| RcBranch { r_ohm: 0.001, c_f })
            .to_vec(),
    };
    let curve = OcvCurve::monotone(4.2, vec![0.0, 0.5, 1.0], vec![2.6, 3.7, 4.18]).unwrap();
    SimModel::cell(&erm, OcvSource::Curve(curve)).unwrap()
}

fn read(text: &str, change: impl Fn(&mut ReadOptions)) -> Result<Profile, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("load.csv");
    fs::write(&path, text).unwrap();
    let mut options = ReadOptions {
        demand: None,
        interpolation: Interpolation::Hold,
        charge_positive: false,
    };
    change(&mut options);
    read_profile(&path, &options).map_err(|e| {
        e.to_string()
            .replace(&path.display().to_string(), "load.csv")
    })
}

#[test]
fn reads_every_way_of_writing_two_columns() {
    let cases = [
        ("0\t79.5\n0.02\t46.9\n", Demand::Power, (0.02, 46.9)),
        ("time_s,power_w\n0,1\n2,3e1\n", Demand::Power, (2.0, 30.0)),
        (
            "# robot\ntime [s] power [kW]\n0 1\n0.5 2\n",
            Demand::Power,
            (0.5, 2000.0),
        ),
        (
            "\u{feff}Time / s; Current / mA\n0; 5\n\n1; 500\n",
            Demand::Current,
            (1.0, 0.5),
        ),
        (
            "\"t_ms\",\"load_ohm\"\n0,1\n250,0.4\n",
            Demand::Resistance,
            (0.25, 0.4),
        ),
        (
            "Test Time / min\tCurrent / A\n0\t5\n2\t-3\n",
            Demand::Current,
            (120.0, -3.0),
        ),
    ];
    for (text, demand, last) in cases {
        let profile = read(text, |_| ()).unwrap_or_else(|e| panic!("{text:?}: {e}"));
        assert_eq!(profile.demand, demand, "{text:?}");
        let met = (
            *profile.time_s.last().unwrap(),
            *profile.value.last().unwrap(),
        );
        assert!(
            (met.0 - last.0).abs() < 1e-12 && (met.1 - last.1).abs() < 1e-12,
            "{text:?}: {met:?}"
        );
    }
    let charging = read("time_s,current_a\n0,5\n1,6\n", |o| o.charge_positive = true).unwrap();
    assert_eq!(charging.value, [-5.0, -6.0]);
    assert_eq!(
        read("0 1\n1 2\n", |o| o.demand = Some(Demand::Resistance))
            .unwrap()
            .demand,
        Demand::Resistance
    );
}

#[test]
fn names_file_and_line_of_what_is_wrong() {
    let cases = [
        (
            "0 1\n1 x\n",
            "load.csv, line 2: expected a finite demand, met \"x\"",
        ),
        (
            "0 1\n\n1 2 3\n",
            "load.csv, line 3: expected two columns, time and demand, met \"1 2 3\"",
        ),
        (
            "0 1\n0 2\n",
            "load.csv, line 2: expected a time later than the row before, met \"0\"",
        ),
        (
            "0 1\n1 NaN\n",
            "load.csv, line 2: expected a finite demand, met \"NaN\"",
        ),
        (
            "time_s,load_ohm\n0,1\n1,0\n",
            "load.csv, line 3: expected a load resistance above 0 Ω, met \"0\"",
        ),
        (
            "power_w,time_s\n0,1\n",
            "load.csv, line 1: expected first a column of time in s, ms, min or h, \
            met \"power_w,time_s\"",
        ),
        (
            "time_s,torque_nm\n0,1\n",
            "load.csv, line 1: expected second a column of power in W, current in A or resistance \
            in Ω, met \"time_s,torque_nm\"",
        ),
        (
            "",
            "profile load.csv: expected at least 2 rows of time and demand, met 0",
        ),
        (
            "0 1\n",
            "profile load.csv: expected at least 2 rows of time and demand, met 1",
        ),
    ];
    for (text, message) in cases {
        assert_eq!(read(text, |_| ()).unwrap_err(), message);
    }
    let other = read("time_s,power_w\n0,1\n1,2\n", |o| {
        o.demand = Some(Demand::Current);
    })
    .unwrap_err();
    assert_eq!(
        other,
        "load.csv, line 1: expected a column of the kind asked for, Current, met \"time_s,power_w\""
    );
    assert!(read("\u{0}\u{1}", |_| ()).is_err());
}

#[test]
fn the_trace_comes_back_from_parquet_with_both_sides_of_a_jump() {
    let model = curved_cell();
    let profile = Profile::new(
        "test",
        Demand::Power,
        Interpolation::Hold,
        &[(0.0, 50.0), (1.0, 0.0), (2.0, 0.0)],
    )
    .unwrap();
    let run = simulate(
        &model,
        &model.rest(0.5).unwrap(),
        &profile,
        &SimOptions::default(),
    )
    .unwrap();
    assert_eq!(run.trace.time_s, [0.0, 1.0, 1.0, 2.0]);
    assert_eq!(run.trace.demand_w, [50.0, 50.0, 0.0, 0.0]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("trace.parquet");
    write_trace_parquet(&path, &run.trace, CellWindow::THESIS).unwrap();
    use polars::prelude::SerReader;
    let frame = polars::prelude::ParquetReader::new(fs::File::open(&path).unwrap())
        .finish()
        .unwrap();
    let column = |name: &str| -> Vec<f64> {
        frame
            .column(name)
            .unwrap()
            .f64()
            .unwrap()
            .into_no_null_iter()
            .collect()
    };
    assert_eq!(column("ccv_v"), run.trace.ccv_v);
    assert_eq!(column("v4_v"), run.trace.v_rc_v[3]);
    let margins: Vec<f64> = run.trace.cell_v.iter().map(|v| v - 2.5).collect();
    assert_eq!(column("margin_low_v"), margins);
}

#[test]
fn a_header_of_charge_or_discharge_says_the_sign_and_load_alone_nothing() {
    let cases = [
        ("time_s,charge_current_a\n0,5\n1,0\n", Demand::Current, -5.0),
        (
            "time [s] charge power [kW]\n0 5\n1 0\n",
            Demand::Power,
            -5000.0,
        ),
        (
            "time_s,discharge_current_a\n0,5\n1,0\n",
            Demand::Current,
            5.0,
        ),
        ("time_s,discharge_a\n0,5\n1,0\n", Demand::Current, 5.0),
        ("time_s,charging_w\n0,5\n1,0\n", Demand::Power, -5.0),
        ("time_s,load_w\n0,5\n1,0\n", Demand::Power, 5.0),
        ("time_s,load_ohm\n0,5\n1,1\n", Demand::Resistance, 5.0),
        (
            "time_s,load_resistance\n0,5\n1,1\n",
            Demand::Resistance,
            5.0,
        ),
    ];
    for (text, demand, first) in cases {
        let profile = read(text, |_| ()).unwrap_or_else(|e| panic!("{text:?}: {e}"));
        assert_eq!(
            (profile.demand, profile.value[0], profile.negated),
            (demand, first, first < 0.0),
            "{text:?}"
        );
    }
    let series = read("time_s,charge_current_a\n0,5\n1,0\n", |o| {
        o.charge_positive = true;
    })
    .unwrap();
    assert_eq!(series.value[0], -5.0);
    let against = read("time_s,discharge_a\n0,5\n1,0\n", |o| {
        o.charge_positive = true;
    })
    .unwrap_err();
    assert!(
        against
            .contains("line 1: expected a column that counts charge as positive, as was asked for"),
        "{against}"
    );
    for vague in ["load", "charge"] {
        let text = format!("time_s,{vague}\n0,5\n1,1\n");
        let error = read(&text, |_| ()).unwrap_err();
        assert!(
            error.contains("a unit (W, A or Ω) in the second column's name, or --kind"),
            "{error}"
        );
    }
    assert_eq!(
        read("time_s,load\n0,5\n1,1\n", |o| o.demand =
            Some(Demand::Current))
        .unwrap()
        .demand,
        Demand::Current
    );
    assert!(read("time_s,charge_ah\n0,5\n1,1\n", |_| ()).is_err());
}
