//! Fits an equivalent circuit without start values to a spectrum that is simulated here. Needs
//! neither polars nor plotters: `cargo run -p analysis --no-default-features --example fit_circuit`

use analysis::fit::{CircuitOptions, fit_circuit};
use analysis::model::Circuit;
use analysis::numeric::Covariance2;
use analysis::spectrum::{ImpedancePoint, Spectrum};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let circuit: Circuit = "R0-p(R1,CPE1)-Wo1".parse()?;
    let truth = [0.006, 0.002, 20.0, 0.85, 0.004, 60.0];
    let points = (0..31).map(|k| {
        let freq_hz = 10.0_f64.powf(-2.0 + 0.2 * f64::from(k));
        ImpedancePoint {
            freq_hz,
            z_ohm: circuit.impedance(&truth, freq_hz),
            covariance: Covariance2::UNKNOWN,
            amplitude_a: f64::NAN,
        }
    });
    let spectrum = Spectrum {
        name: "cell".to_owned(),
        points: points.collect(),
        ..Spectrum::default()
    };
    let fit = fit_circuit(&[spectrum], &circuit, &CircuitOptions::default())?;
    for (index, name) in fit.names.iter().enumerate() {
        println!(
            "{name}: {:.6} {} (truth {:.6})",
            fit.values[index], fit.units[index], truth[index]
        );
    }
    Ok(())
}
