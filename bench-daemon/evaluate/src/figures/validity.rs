//! Kramers–Kronig and Z-HIT of one spectrum, for a report.

pub mod plots;

use analysis::{
    plot,
    report::Figure,
    spectrum::Spectrum,
    validity::{Assessed, Record, assess},
};

use bench_core::safety::failure::Failure;

/// Tests one spectrum of a run separately, with the records that it was made from. Otherwise
/// returns why it was not tested.
pub(crate) fn tested(spectrum: &Spectrum, records: &[Record]) -> Result<Assessed, String> {
    let assessment =
        assess(std::slice::from_ref(spectrum), records).map_err(|error| error.to_string())?;
    assessment
        .spectra
        .into_iter()
        .next()
        .ok_or_else(|| "the assessment has no spectrum".to_owned())
}

/// Pictures of a tested spectrum for a report; it is shown with its whole uncertainty.
///
/// # Errors
/// A picture that cannot be drawn.
pub(crate) fn pictures(assessed: &Assessed, shown: &Spectrum) -> Result<Vec<Figure>, Failure> {
    let svg = |chart| plot::chart_svg(&chart).map_err(|error| Failure::Analysis(error.to_string()));
    let residuals = "What no circuit of resistances, capacitances and inductances explains of the \
    spectrum, with ±2σ of its noise.";
    let z_hit = "The modulus as measured and as the phase asks for; they part where the cell \
    changed during the sweep.";
    Ok(vec![
        Figure {
            svg: svg(plots::residuals(assessed))?,
            caption: residuals.to_owned(),
        },
        Figure {
            svg: svg(plots::z_hit(assessed, shown))?,
            caption: z_hit.to_owned(),
        },
    ])
}
