//! 400 synthetic logs of a cell with known truth: conventions × programs × names × kinds of loads ×
//! noise × slope of the open-circuit voltage. No log may be read with the wrong sign.

use super::*;
use std::fmt::Write as _;

/// A uniform number from 0 to 1, always the same for a log.
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        f64::from(u32::try_from(self.0 >> 33).unwrap()) / f64::from(1_u32 << 31)
    }

    fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[((self.next() * of.len() as f64) as usize).min(of.len() - 1)]
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.next().max(1e-12).ln()).sqrt() * (std::f64::consts::TAU * self.next()).cos()
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Convention {
    Charge,
    Discharge,
    Magnitudes,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Loads {
    Charge,
    Discharge,
    Both,
    Drive,
    /// One constant current without a rest.
    Long,
    /// Discharge and charge without a rest between them.
    Direct,
}

/// Time, voltage and current, discharge positive.
fn log(draws: &mut Draws, loads: Loads, noise_v: f64, slope_v: f64) -> Vec<[f64; 3]> {
    let step_s: f64 = draws.pick(&[0.5, 1.0, 2.0, 10.0, 60.0]);
    let capacity_ah: f64 = draws.pick(&[2.5, 5.0, 50.0]);
    let (r0, r1, tau_s): (f64, f64, f64) = (
        0.05 / capacity_ah,
        0.04 / capacity_ah,
        draws.pick(&[5.0, 30.0, 600.0]),
    );
    let pauses = draws.pick(&[10, 20, 60]);
    let rested = !matches!(loads, Loads::Long | Loads::Direct);
    let pauses = if rested { pauses } else { 0 };
    let mut program: Vec<f64> = vec![0.0; pauses];
    if loads == Loads::Long {
        let amps = capacity_ah * draws.pick(&[0.2, -0.2, 1.0, -1.0]);
        program =
            vec![amps; (0.4 * 3600.0 * capacity_ah / amps.abs() / step_s).min(3000.0) as usize];
    }
    for pulse in 0..if loads == Loads::Long { 0 } else { 6 } {
        let direction = match loads {
            Loads::Charge => -1.0,
            Loads::Discharge => 1.0,
            Loads::Both | Loads::Drive | Loads::Long | Loads::Direct => [1.0, -1.0][pulse % 2],
        };
        let amps = direction * capacity_ah * draws.pick(&[0.2, 0.5, 1.0, 2.0]);
        let rows = draws.pick(&[10, 20, 40]);
        if loads == Loads::Drive {
            program.extend((0..rows).map(|_| amps * (2.0 * draws.next() - 0.7)));
        } else {
            program.extend(vec![amps; rows]);
        }
        program.extend(vec![0.0; pauses]);
    }
    let (mut soc, mut v1) = (0.5, 0.0);
    let mut rows = Vec::new();
    for (k, amps) in program.iter().enumerate() {
        v1 += (amps * r1 - v1) * (1.0 - (-step_s / tau_s).exp());
        soc -= amps * step_s / 3600.0 / capacity_ah;
        let volts = 3.3 + slope_v * soc - amps * r0 - v1 + noise_v * draws.normal();
        let digits = if noise_v == 2e-3 { 1e3 } else { 1e5 };
        rows.push([k as f64 * step_s, (volts * digits).round() / digits, *amps]);
    }
    rows
}

/// The log as a program writes it.
fn text(program: usize, rows: &[[f64; 3]], convention: Convention) -> String {
    let mut text = [
        "Test Time / s,Voltage / V,Current / A\n",
        "Time,Voltage,Current\n",
        "Data_Point,Test_Time(s),Step_Time(s),Current(A),Voltage(V)\n",
        "Rec#\tCyc#\tStep\tTest (Sec)\tState\tAmps\tVolts\n",
        "DataPoint,Step Type,Time,Cumulative Time,Current(mA),Voltage(V)\n",
        "EC-Lab ASCII FILE\nNb header lines : 3\ntime/s\tEwe/V\t<I>/mA\n",
    ][program]
        .to_owned();
    for (k, [t, v, amps]) in rows.iter().enumerate() {
        let a = match convention {
            Convention::Charge => 0.0 - amps,
            Convention::Discharge => *amps,
            Convention::Magnitudes => amps.abs(),
        };
        let letter = if *amps > 0.0 {
            "D"
        } else if *amps < 0.0 {
            "C"
        } else {
            "R"
        };
        let word = if *amps > 0.0 {
            "CC DChg"
        } else if *amps < 0.0 {
            "CC Chg"
        } else {
            "Rest"
        };
        let _ = match program {
            0 => writeln!(text, "{t},{v:.5},{a:.4}"),
            1 => writeln!(text, "{t},{v:.5},{a:.4}"),
            2 => writeln!(text, "{k},{t},0,{a:.4},{v:.5}"),
            3 => writeln!(text, "{k}\t0\t1\t{t}\t{letter}\t{a:.4}\t{v:.5}"),
            4 => {
                let clock = format!(
                    "{}:{:02}:{:04.1}",
                    (t / 3600.0).floor(),
                    (t / 60.0).floor() % 60.0,
                    t % 60.0
                );
                writeln!(text, "{k},{word},{clock},{clock},{},{v:.5}", 1e3 * a)
            }
            _ => writeln!(text, "{t:.4E}\t{v:.6E}\t{:.6E}", 1e3 * a),
        };
    }
    text
}

#[test]
fn of_400_made_logs_none_is_turned_round() {
    let folder = tempfile::tempdir().unwrap();
    let (mut right, mut asked, mut turned, mut lost) = (0, Vec::new(), Vec::new(), Vec::new());
    for nth in 0..400_u64 {
        let mut draws = Draws(0x9E37_79B9 ^ (nth * 7919));
        draws.next();
        let loads = draws.pick(&[
            Loads::Charge,
            Loads::Discharge,
            Loads::Both,
            Loads::Drive,
            Loads::Long,
            Loads::Direct,
        ]);
        let convention = draws.pick(&[
            Convention::Charge,
            Convention::Discharge,
            Convention::Magnitudes,
        ]);
        // Without a rest between the directions, magnitudes contain no direction.
        let drive =
            matches!(loads, Loads::Drive | Loads::Direct) && convention == Convention::Magnitudes;
        let convention = if drive {
            Convention::Charge
        } else {
            convention
        };
        let (program, noise_v) = (
            draws.pick(&[0, 1, 2, 3, 4, 5]),
            draws.pick(&[0.0, 1e-4, 1e-3, 2e-3, 5e-3]),
        );
        let slope_v = draws.pick(&[0.05, 0.5, 1.2]);
        let name = draws.pick(&[
            "log",
            "HPPC_discharge",
            "charge_25C",
            "discharge",
            "cell_charge_discharge",
        ]);
        let rows = log(&mut draws, loads, noise_v, slope_v);
        let path = folder.path().join(format!("{nth}_{name}.txt"));
        std::fs::write(&path, text(program, &rows, convention)).unwrap();
        let about = format!(
            "{nth}: {loads:?} {convention:?} program {program} {noise_v} V {slope_v} V {name}"
        );
        match read_record(&path, &SeriesOptions::default()) {
            Err(SeriesReadError::Sign { .. }) => asked.push(about),
            Err(error) => lost.push(format!("{about}: {error}")),
            Ok(read) => {
                let wrong = rows
                    .iter()
                    .zip(&read.series.current_a)
                    .any(|(row, met)| (row[2] - met).abs() > 1e-3);
                if wrong || read.series.len() != rows.len() {
                    turned.push(about);
                } else {
                    right += 1;
                }
            }
        }
    }
    println!(
        "right {right}, asked {}, turned round {}, lost {}",
        asked.len(),
        turned.len(),
        lost.len()
    );
    println!("asked: {asked:#?}\nturned round: {turned:#?}\nlost: {lost:#?}");
    assert!(
        turned.is_empty() && lost.is_empty(),
        "{turned:#?} {lost:#?}"
    );
    assert!(asked.len() <= 8, "{asked:#?}");
}
