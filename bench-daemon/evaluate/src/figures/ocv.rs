//! The open-circuit voltage over state of charge: table, curve and picture.

use std::path::Path;

use analysis::{
    ocv::OcvExtraction,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
    run_folder::{OCV, OCV_COLUMNS, OCV_CURVE},
};

use crate::files;
use bench_core::safety::failure::Failure;

/// Points per trace of a plot.
const DRAWN: usize = 1500;
/// Rows of the table less one.
const TABLE_STEPS: u32 = 200;

/// Writes table and curve into a folder.
pub fn write(folder: &Path, found: &OcvExtraction) -> Result<(), Failure> {
    files::make_folder(folder)?;
    let put = |name: &str, text: &str| files::write_text(folder, name, text);
    let mut table = format!("{OCV_COLUMNS}\n");
    for k in 0..=TABLE_STEPS {
        let soc = f64::from(k) / f64::from(TABLE_STEPS);
        let (ocv_v, slope_v) = found.curve.at(soc);
        table.push_str(&format!("{soc:.4},{ocv_v:.6},{slope_v:.6}\n"));
    }
    put(OCV, &table)?;
    let json = serde_json::to_string_pretty(&found.curve)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    put(OCV_CURVE, &(json + "\n"))
}

/// The measured and the compensated curve as figure 3.3 of the thesis, the slope, and the samples
/// less the spline; `points` are (SOC, compensated voltage) of the samples.
pub fn picture(name: &str, points: &[(f64, f64)], found: &OcvExtraction) -> Chart {
    let every = points.len().div_ceil(DRAWN).max(1);
    let thin: Vec<(f64, f64)> = points.iter().step_by(every).copied().collect();
    let drop = found.current_a * found.dcir_ohm;
    let soc = || AxisSpec::linear("State of charge").between(0.0, 1.0);
    let curve = |f: &dyn Fn(f64) -> f64| {
        (0..=DRAWN)
            .map(|k| k as f64 / DRAWN as f64)
            .map(|z| (z, f(z)))
            .collect::<Vec<_>>()
    };
    let mut upper = vec![
        Trace::new(
            &format!("measured at {:.2} A", found.current_a),
            0,
            TraceStyle::Line,
            thin.iter().map(|(z, u)| (*z, u - drop)).collect(),
        ),
        Trace::new(
            &format!("OCV, compensated by {:.1} mΩ", 1e3 * found.dcir_ohm),
            1,
            TraceStyle::Line,
            curve(&|z| found.curve.voltage_v(z)),
        ),
    ];
    let mut lower = vec![Trace::new(
        "samples less the spline",
        0,
        TraceStyle::Line,
        thin.iter()
            .map(|(z, u)| (*z, 1e3 * (u - found.curve.voltage_v(*z))))
            .collect(),
    )];
    if let Some(p) = &found.polynomial {
        let label = format!("polynomial of order {}", p.order);
        upper.push(Trace::new(
            &label,
            2,
            TraceStyle::Dashed,
            curve(&|z| p.voltage_v(z)),
        ));
        lower.push(Trace::new(
            "",
            2,
            TraceStyle::Dashed,
            curve(&|z| 1e3 * (p.voltage_v(z) - found.curve.voltage_v(z))),
        ));
    }
    let slope = Trace::new("", 1, TraceStyle::Line, curve(&|z| found.curve.slope_v(z)));
    // The knee at the empty end would hide all else.
    let ordinary = (20..=DRAWN)
        .map(|k| found.curve.slope_v(k as f64 / DRAWN as f64 * 0.95 + 0.05))
        .fold(0.0, f64::max);
    let panels = vec![
        Panel::new(soc(), AxisSpec::linear("Voltage / V"), upper),
        Panel {
            aspect: 0.25,
            ..Panel::new(
                soc(),
                AxisSpec::linear("dOCV/dSOC / V").between(0.0, 1.1 * ordinary),
                vec![slope],
            )
        },
        Panel {
            aspect: 0.2,
            ..Panel::new(soc(), AxisSpec::linear("Residual / mV"), lower)
        },
    ];
    let subtitle = format!(
        "{name}: {:.3} Ah between {:.2} V and {:.2} V",
        found.capacity_ah, found.span_v.1, found.span_v.0
    );
    Chart::new(
        "Open-circuit voltage over state of charge",
        &subtitle,
        panels,
    )
}
