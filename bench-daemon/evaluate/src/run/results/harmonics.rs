//! Second and third harmonic of the cell in each sweep, as a table and a picture.

use analysis::{
    nonlinear::HarmonicPoint,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
    run_folder::{HARMONICS, HARMONICS_FIGURE, SweepHarmonic, harmonics_csv},
    spectrum::ImpedancePoint,
};

use super::multisine_and_trace::{Shown, draw};
use crate::run::Measured;
use bench_core::{record::Recorder, safety::failure::Failure};

/// The harmonics of one sweep.
struct Swept {
    /// Its number, from 1.
    number: usize,
    bias_a: f64,
    points: Vec<HarmonicPoint>,
}

/// Writes the table and the picture of all sweeps of the cell; nothing if no record holds a harmonic.
///
/// # Errors
/// Fails if a file cannot be written or the picture cannot be drawn.
pub(super) fn write(
    recorder: &Recorder,
    measured: &Measured,
    shown: &mut Shown,
) -> Result<(), Failure> {
    let sweeps: Vec<Swept> = (0..measured.points.len())
        .map(|place| swept(measured, place))
        .collect();
    let has_harmonics = |swept: &Swept| swept.points.iter().any(|point| point.order > 1);
    if !sweeps.iter().any(has_harmonics) {
        return Ok(());
    }
    let rows = sweeps.iter().flat_map(|swept| {
        swept.points.iter().map(|point| SweepHarmonic {
            sweep: swept.number,
            bias_a: swept.bias_a,
            point: *point,
        })
    });
    recorder.text(HARMONICS, &harmonics_csv(rows))?;
    let caption =
        "Second and third harmonic of the cell's voltage, without what the harmonics of the \
                   current explain, over the power of the current, with 2σ."
            .to_owned();
    let figure = draw(recorder, HARMONICS_FIGURE, &chart(&sweeps), caption)?;
    shown.figures.push(figure);
    Ok(())
}

fn swept(measured: &Measured, place: usize) -> Swept {
    let correction = &measured.correction;
    let corrected: Vec<ImpedancePoint> = measured
        .spectra()
        .nth(place)
        .map_or_else(Vec::new, |spectrum| spectrum.points.clone());
    let first = corrected.iter().map(HarmonicPoint::first);
    let more = measured.points[place].iter().flat_map(|point| {
        let harmonics = point.harmonics_and_drift.harmonics.iter();
        harmonics.filter_map(|(order, phasors)| {
            HarmonicPoint::of(*order, &point.phasors, phasors, &corrected, correction)
        })
    });
    let mut points: Vec<HarmonicPoint> = first.chain(more).collect();
    points.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz).then(a.order.cmp(&b.order)));
    Swept {
        number: place + 1,
        bias_a: measured.bias_a(place),
        points,
    }
}

fn chart(sweeps: &[Swept]) -> Chart {
    let panels = [(2, "|Z₂| / µV/A²"), (3, "|Z₃| / µV/A³")];
    let panel = |(order, name): (u32, &str)| {
        let traces: Vec<Trace> = sweeps
            .iter()
            .enumerate()
            .map(|(colour, swept)| trace(swept, order, colour))
            .filter(|trace| !trace.points.is_empty())
            .collect();
        let frequency = AxisSpec::logarithmic("Frequency / Hz");
        (!traces.is_empty()).then(|| Panel::new(frequency, AxisSpec::linear(name), traces))
    };
    Chart::new(
        "Harmonics of the cell",
        "bars: 2σ; points whose bars reach zero are noise",
        panels.into_iter().filter_map(panel).collect(),
    )
}

fn trace(swept: &Swept, order: u32, colour: usize) -> Trace {
    let points = swept.points.iter().filter(|point| point.order == order);
    let micro = |value: f64| 1.0e6 * value;
    let (places, spread): (Vec<(f64, f64)>, Vec<f64>) = points
        .map(|point| {
            (
                (point.freq_hz, micro(point.z.norm())),
                micro(2.0 * point.sigma()),
            )
        })
        .unzip();
    let label = match (order, swept.bias_a) {
        (2, 0.0) => format!("sweep {}", swept.number),
        (2, bias_a) => format!("sweep {}, {bias_a:+} A", swept.number),
        _ => String::new(),
    };
    Trace::new(&label, colour, TraceStyle::Points, places).with_spread(spread)
}
