//! Judges the spectra of a file, fits the extended Randles model with the order that the data bear,
//! and prints it.
//!
//! `cargo run -p analysis --example fit_spectrum -- fixtures/data/spectra/p45b_thesis.csv`

use analysis::fit::{ErmRequest, Objective, Slope};
use analysis::formats::read_file;
use analysis::validity::assess;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args()
        .nth(1)
        .ok_or("expected a file of spectra")?;
    let read = read_file(Path::new(&file))?;
    for note in &read.notes {
        eprintln!("{note}");
    }
    let cells: Vec<_> = read
        .spectra
        .into_iter()
        .filter(|sourced| sourced.origin.is_unbiased_cell())
        .collect();
    for sourced in &cells {
        let verdict = &assess(std::slice::from_ref(&sourced.spectrum), &[])?.spectra[0].verdict;
        println!("{}: {}", sourced.spectrum.name, verdict.text);
    }
    let request = ErmRequest {
        rc: None,
        objective: Objective::Complex,
        slope: Slope::Fitted,
        seed: 0,
        starts: 0,
    };
    let fit = request.fit(&cells)?.fit;
    println!("R {:.4} mΩ", 1.0e3 * fit.erm.r_ohm);
    for (branch, sigma) in fit.erm.branches.iter().zip(&fit.sigma.branches) {
        println!(
            "{:.4} mΩ ∥ {:.4} F, τ {:.3e} s ± {:.1e} s",
            1.0e3 * branch.r_ohm,
            branch.c_f,
            branch.r_ohm * branch.c_f,
            sigma.time_constant_s.unwrap_or(f64::NAN),
        );
    }
    for warning in fit.warnings.iter() {
        println!("{}: {warning}", warning.code.name());
    }
    Ok(())
}
