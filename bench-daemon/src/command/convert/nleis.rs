//! `eis-bench convert --to nleis`: first and second harmonic of a sweep as the columns that nleis.py
//! takes.

use std::{collections::BTreeMap, fmt::Write as _, path::Path};

use analysis::{
    nonlinear::HarmonicPoint,
    run_folder::{SweepHarmonic, read_harmonics},
};

use bench_core::safety::failure::Failure;

/// Columns of the file: frequency of the fundamental, Z₁, Z₂ and their standard uncertainties.
const COLUMNS: &str = "freq_hz,z1_re_ohm,z1_im_ohm,z2_re_ohm_per_a,z2_im_ohm_per_a,sigma_z1_re,\
    sigma_z1_im,sigma_z2_re,sigma_z2_im";

/// Returns the text of each sweep in a table of harmonics, by its number.
///
/// # Errors
/// A file that is not such a table; a field that is not a number; a file without a second harmonic.
pub(super) fn texts(path: &Path) -> Result<Vec<(String, String)>, Failure> {
    let mut sweeps: BTreeMap<usize, Vec<HarmonicPoint>> = BTreeMap::new();
    for SweepHarmonic { sweep, point, .. } in read_harmonics(path).map_err(Failure::Usage)? {
        sweeps.entry(sweep).or_default().push(point);
    }
    let texts: Vec<(String, String)> = sweeps
        .into_iter()
        .map(|(sweep, points)| (sweep.to_string(), text(&points)))
        .filter(|(_, text)| text.lines().count() > 1)
        .collect();
    if texts.is_empty() {
        return Err(Failure::Usage(format!(
            "{}: expected frequencies with orders 1 and 2, found none",
            path.display()
        )));
    }
    Ok(texts)
}

/// Returns the frequencies that have both orders.
fn text(points: &[HarmonicPoint]) -> String {
    let mut text = format!("{COLUMNS}\n");
    for second in points.iter().filter(|point| point.order == 2) {
        let is_its_first = |p: &&HarmonicPoint| p.order == 1 && p.freq_hz == second.freq_hz;
        let Some(first) = points.iter().find(is_its_first) else {
            continue;
        };
        let parts = |p: &HarmonicPoint| [p.z.re, p.z.im];
        let sigmas = |p: &HarmonicPoint| [p.covariance.re_re.sqrt(), p.covariance.im_im.sqrt()];
        let numbers = [parts(first), parts(second), sigmas(first), sigmas(second)].concat();
        let fields: Vec<String> = numbers.iter().map(|v| format!("{v:e}")).collect();
        let _ = writeln!(text, "{},{}", second.freq_hz, fields.join(","));
    }
    text
}
