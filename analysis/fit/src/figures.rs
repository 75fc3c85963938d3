//! The thesis' figures 3.8 and 3.10–3.14 redrawn from data.

use crate::fit::ErmFit;
use analysis_numeric::significant::format_significant;
use analysis_plot::{ImpedancePlot, PlotError, Series, SeriesStyle, nyquist};
use analysis_signal::spectrum::{Spectrum, cell_in_name};
use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
};

impl ErmFit {
    /// The fitted model as a curve over a band of frequencies in Hz, above zero, including the
    /// share of the open-circuit voltage that was subtracted from its data, as
    /// [`ErmFit::impedance`].
    pub fn series(&self, label: &str, band_hz: RangeInclusive<f64>, colour: usize) -> Series {
        Series::curve(label, band_hz, colour, |freq_hz| self.impedance(freq_hz))
    }
}

/// Data that the figures are drawn from.
#[derive(Debug, Clone, Copy)]
pub struct FigureInput<'a> {
    /// Sweeps of cells, named `cell0_3` (cell 0, repeat 3).
    pub sweeps: &'a [Spectrum],
    /// Sweeps of control impedances; without them figure 3.10 is not drawn.
    pub controls: &'a [Spectrum],
    /// Fits of the pooled sweeps; those with 1…4 RC branches become figures 3.11–3.14.
    pub fits: &'a [ErmFit],
}

/// Writes each figure as SVG and PNG to a folder that exists; the files, in the order of the
/// figures.
///
/// # Errors
/// [`PlotError`] when there is nothing to show or a file cannot be written.
pub fn write_thesis_figures(
    input: &FigureInput<'_>,
    folder: &Path,
) -> Result<Vec<PathBuf>, PlotError> {
    let mut figures = vec![("nyquist-sweeps".to_owned(), sweeps_figure(input.sweeps))];
    if !input.controls.is_empty() {
        figures.push((
            "nyquist-controls".to_owned(),
            controls_figure(input.controls),
        ));
    }
    for fit in input.fits {
        let rc = fit.erm.branches.len();
        if (1..=4).contains(&rc) {
            figures.push((format!("nyquist-fit-{rc}rc"), fit_figure(input.sweeps, fit)));
        }
    }
    let mut written = Vec::new();
    for (name, plot) in figures {
        for extension in ["svg", "png"] {
            let path = folder.join(format!("{name}.{extension}"));
            nyquist(&plot, &path)?;
            written.push(path);
        }
    }
    Ok(written)
}

/// All sweeps, one colour per cell (figure 3.8).
pub fn sweeps_figure(sweeps: &[Spectrum]) -> ImpedancePlot {
    let cells = cells(sweeps);
    let mut seen = Vec::new();
    let series = sweeps.iter().map(|s| {
        let cell = cell_of(&s.name);
        let colour = cells.iter().position(|c| *c == cell).unwrap_or(0);
        let first = !seen.contains(&colour);
        seen.push(colour);
        let label = first.then_some(cell);
        s.series(colour)
            .styled(SeriesStyle::Cloud)
            .labelled(label.as_deref())
    });
    let title = format!("Measured impedance, {}", count(sweeps, &cells));
    ImpedancePlot::new(&title, &band_text(sweeps), series.collect())
}

fn controls_figure(controls: &[Spectrum]) -> ImpedancePlot {
    let series = controls.iter().enumerate().map(|(i, s)| {
        let mean =
            s.points.iter().map(|p| p.z_ohm.norm()).sum::<f64>() / s.points.len().max(1) as f64;
        let label = format!("{}, mean |Z| {:.2} mΩ", s.name, mean * 1e3);
        s.series(i)
            .styled(SeriesStyle::Cloud)
            .labelled(Some(&label))
    });
    let plot = ImpedancePlot::new("Control impedances", &band_text(controls), series.collect());
    ImpedancePlot {
        mark_decades: false,
        ..plot
    }
}

/// All sweeps in one colour and a model fitted to them (figures 3.11–3.14).
pub fn fit_figure(sweeps: &[Spectrum], fit: &ErmFit) -> ImpedancePlot {
    let rc = fit.erm.branches.len();
    let cells = cells(sweeps);
    let data = sweeps.iter().enumerate().map(|(i, s)| {
        let label = (i == 0).then(|| format!("measured, {}", count(sweeps, &cells)));
        s.series(0)
            .styled(SeriesStyle::Cloud)
            .labelled(label.as_deref())
    });
    let value = format!("{} = {:.4} {}", symbol(fit), scaled(fit), unit(fit));
    let name = format!("fit with {rc} RC, {value}");
    let curve = band_hz(sweeps).map(|band_hz| fit.series(&name, band_hz, 1));
    let series = data.chain(curve).collect();
    let title = format!(
        "Extended Randles model with {rc} RC {}",
        if rc == 1 { "circuit" } else { "circuits" }
    );
    ImpedancePlot::new(&title, &band_text(sweeps), series)
}

fn symbol(fit: &ErmFit) -> &'static str {
    use crate::fit::Objective;
    match fit.objective_kind {
        Objective::SumAbs => "Σ|ΔZ|",
        Objective::Modulus => "Σ(Δ|Z|)²",
        Objective::Complex => "χ²",
    }
}

fn scaled(fit: &ErmFit) -> f64 {
    use crate::fit::Objective;
    if fit.objective_kind == Objective::Modulus {
        fit.objective * 1e6
    } else {
        fit.objective
    }
}

fn unit(fit: &ErmFit) -> &'static str {
    use crate::fit::Objective;
    if fit.objective_kind == Objective::Modulus {
        "mΩ²"
    } else {
        fit.objective_kind.unit()
    }
}

/// Returns `cell 0` for `cell0_3`. A name without a cell counts as a cell of its own.
fn cell_of(name: &str) -> String {
    cell_in_name(name).map_or_else(|| name.to_owned(), |cell| format!("cell {cell}"))
}

/// Distinct cells in the order of their first sweep.
fn cells(sweeps: &[Spectrum]) -> Vec<String> {
    let mut cells: Vec<String> = Vec::new();
    for s in sweeps {
        if !cells.contains(&cell_of(&s.name)) {
            cells.push(cell_of(&s.name));
        }
    }
    cells
}

fn count(sweeps: &[Spectrum], cells: &[String]) -> String {
    let plural = |n: usize, word: &str| format!("{n} {word}{}", if n == 1 { "" } else { "s" });
    format!(
        "{} of {}",
        plural(sweeps.len(), "sweep"),
        plural(cells.len(), "cell")
    )
}

/// Lowest and highest frequency, Hz.
fn band_hz(spectra: &[Spectrum]) -> Option<RangeInclusive<f64>> {
    let all = spectra.iter().flat_map(|s| &s.points).map(|p| p.freq_hz);
    let (lo, hi) = all.fold((f64::INFINITY, 0.0f64), |(lo, hi), f| {
        (lo.min(f), hi.max(f))
    });
    (lo.is_finite() && lo > 0.0 && hi >= lo).then_some(lo..=hi)
}

fn band_text(spectra: &[Spectrum]) -> String {
    band_hz(spectra).map_or_else(String::new, |band_hz| {
        format!(
            "{} to {} Hz, axes equally scaled",
            format_significant(*band_hz.start(), 3),
            format_significant(*band_hz.end(), 3)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::{FitOptions, fit_erm};
    use analysis_model::model::{Erm, RcBranch};
    use analysis_numeric::Covariance2;
    use analysis_signal::spectrum::ImpedancePoint;

    fn cell() -> Erm {
        Erm {
            r_ohm: 0.0069,
            branches: vec![
                RcBranch {
                    r_ohm: 0.0017,
                    c_f: 1.17,
                },
                RcBranch {
                    r_ohm: 0.0026,
                    c_f: 750.0,
                },
            ],
        }
    }

    fn sweep(name: &str, scale: f64) -> Spectrum {
        let variance = 1e-10;
        let covariance = Covariance2 {
            re_re: variance,
            re_im: 0.3 * variance,
            im_im: 0.5 * variance,
        };
        let at = |k: u32| 0.1 * 3000f64.powf(f64::from(k) / 20.0);
        let point = |freq_hz| ImpedancePoint {
            freq_hz,
            z_ohm: cell().impedance(freq_hz) * scale,
            covariance,
            amplitude_a: 1.0,
        };
        Spectrum {
            name: name.into(),
            points: (0..20).map(|k| point(at(k))).collect(),
            ..Spectrum::default()
        }
    }

    #[test]
    fn the_thesis_figures_are_twelve_files() {
        let dir = tempfile::tempdir().unwrap();
        let sweeps = [
            sweep("cell0_0", 1.0),
            sweep("cell0_1", 1.01),
            sweep("cell1_0", 1.02),
        ];
        let controls = [sweep("shunt_0", 1.4)];
        let fits: Vec<_> = (0..=4)
            .map(|rc| {
                fit_erm(
                    &sweeps,
                    &FitOptions {
                        rc,
                        ..FitOptions::default()
                    },
                )
                .unwrap()
            })
            .collect();
        let written = write_thesis_figures(
            &FigureInput {
                sweeps: &sweeps,
                controls: &controls,
                fits: &fits,
            },
            dir.path(),
        )
        .unwrap();
        let names: Vec<_> = written
            .iter()
            .map(|p| p.file_name().unwrap().to_string_lossy().into_owned())
            .collect();
        let stems = [
            "sweeps", "controls", "fit-1rc", "fit-2rc", "fit-3rc", "fit-4rc",
        ];
        let expected: Vec<String> = stems
            .iter()
            .flat_map(|s| ["svg", "png"].map(|e| format!("nyquist-{s}.{e}")))
            .collect();
        assert_eq!(names, expected);
        let first = std::fs::read_to_string(&written[0]).unwrap();
        assert!(
            first.contains("Measured impedance, 3 sweeps of 2 cells") && first.contains("cell 1")
        );
        assert!(
            std::fs::read_to_string(&written[2])
                .unwrap()
                .contains("shunt_0, mean |Z| ")
        );
    }
}
