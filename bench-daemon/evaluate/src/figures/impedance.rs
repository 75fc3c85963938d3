//! Spectra and the models fitted to them, as Bode plots.

use analysis::{
    fit::ErmFit,
    plot::{ImpedancePlot, Series, SeriesStyle},
    spectrum::Spectrum,
};

/// Spectra as points, every order as a curve.
pub fn bode_plot(title: &str, spectra: &[Spectrum], fits: &[ErmFit]) -> ImpedancePlot {
    let many = spectra.len() > 1;
    let mut series: Vec<Series> = spectra
        .iter()
        .enumerate()
        .map(|(index, spectrum)| {
            let data = spectrum.series(0);
            let data = if many {
                data.styled(SeriesStyle::Cloud)
            } else {
                data
            };
            let label = if many {
                format!("measured, {} spectra", spectra.len())
            } else {
                "measured".to_owned()
            };
            data.labelled((index == 0).then_some(label.as_str()))
        })
        .collect();
    series.extend(model_curves(spectra, fits));
    ImpedancePlot::new(title, "", series)
}

/// Every order as a curve over the band of the spectra.
pub(crate) fn model_curves(spectra: &[Spectrum], fits: &[ErmFit]) -> Vec<Series> {
    let freqs = spectra
        .iter()
        .flat_map(|spectrum| &spectrum.points)
        .map(|point| point.freq_hz);
    let (low, high) = freqs.fold((f64::INFINITY, 0.0_f64), |(low, high), freq| {
        (low.min(freq), high.max(freq))
    });
    if low >= high {
        return Vec::new();
    }
    let curve = |(index, fit): (usize, &ErmFit)| {
        fit.series(
            &format!("{} RC", fit.erm.branches.len()),
            low..=high,
            index + 1,
        )
    };
    fits.iter().enumerate().map(curve).collect()
}

/// Draws a spectrum as points, and the model's values as a line.
pub fn compared(title: &str, measured: &Spectrum, model: Option<&Spectrum>) -> ImpedancePlot {
    let mut series = vec![measured.series(0).labelled(Some("measured"))];
    series.extend(model.map(|model| model.series(1).styled(SeriesStyle::Curve)));
    ImpedancePlot::new(title, "", series)
}
