//! The pictures of `kk`.

use analysis::{
    drt::Drt,
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
    spectrum::Spectrum,
    validity::{Assessed, KkPoint},
};

use crate::support::present::titled;

fn frequency() -> AxisSpec {
    AxisSpec::logarithmic("Frequency / Hz")
}

/// Residuals of the Kramers–Kronig ladder over frequency.
pub fn residuals(assessed: &Assessed) -> Chart {
    let kk = &assessed.kramers_kronig;
    let panel = |name: &str, label: &str, colour: usize, part: fn(&KkPoint) -> (f64, f64)| {
        let at = |points: &mut dyn Iterator<Item = &KkPoint>| {
            points
                .map(|point| (point.freq_hz, part(point).0))
                .collect::<Vec<_>>()
        };
        let kept = at(&mut kk.points.iter().filter(|point| !point.left_out));
        let out = at(&mut kk.points.iter().filter(|point| point.left_out));
        let zero = kk.points.iter().map(|point| (point.freq_hz, 0.0)).collect();
        // A point that was left out has its own σ; the band shows that of the fitted points.
        let sigma = kk
            .points
            .iter()
            .map(|point| {
                if point.left_out {
                    0.0
                } else {
                    2.0 * part(point).1
                }
            })
            .collect();
        let mut traces = vec![
            Trace::new(&format!("{label}, ±2σ"), colour, TraceStyle::Band, zero).with_spread(sigma),
            Trace::new(label, colour, TraceStyle::Points, kept),
        ];
        if !out.is_empty() {
            traces.push(Trace::new(
                &format!("{label}, left out"),
                6,
                TraceStyle::Points,
                out,
            ));
        }
        Panel::new(frequency(), AxisSpec::linear(name), traces)
    };
    Chart::new(
        &titled("Kramers–Kronig residuals", &assessed.name),
        &format!(
            "{} RC, µ {:.2}, reduced χ² {:.2}: {}",
            kk.order,
            kk.mu,
            kk.chi2 / kk.dof,
            assessed.verdict.grade
        ),
        vec![
            panel("Re: measured − fitted / % of |Z|", "Re", 0, |point| {
                (point.re_percent, point.sigma_re_percent)
            }),
            panel("Im: measured − fitted / % of |Z|", "Im", 1, |point| {
                (point.im_percent, point.sigma_im_percent)
            }),
        ],
    )
}

/// Draws the modulus as measured and as reconstructed from the phase.
pub fn z_hit(assessed: &Assessed, measured: &Spectrum) -> Chart {
    let points = &assessed.z_hit.points;
    let line = |y: fn(&analysis::validity::ZHitPoint) -> f64| {
        points
            .iter()
            .map(|point| (point.freq_hz, y(point)))
            .collect::<Vec<_>>()
    };
    let zero = line(|_| 0.0);
    let sigma = points
        .iter()
        .map(|point| 2.0 * point.sigma_percent)
        .collect();
    let bars = measured
        .points
        .iter()
        .map(|point| 2.0e3 * point.magnitude_sigma_ohm())
        .collect();
    let upper = vec![
        Trace::new(
            "rebuilt from the phase",
            1,
            TraceStyle::Line,
            line(|point| 1.0e3 * point.rebuilt_ohm),
        ),
        Trace::new(
            "measured",
            0,
            TraceStyle::Points,
            line(|point| 1.0e3 * point.measured_ohm),
        )
        .with_spread(bars),
    ];
    let lower = vec![
        Trace::new("±2σ", 0, TraceStyle::Band, zero).with_spread(sigma),
        Trace::new(
            "",
            0,
            TraceStyle::Points,
            line(|point| point.deviation_percent),
        ),
    ];
    let (from, to) = assessed.z_hit.anchor_hz;
    Chart::new(
        &titled("Z-HIT", &assessed.name),
        &format!(
            "the modulus rebuilt from the phase, set equal between {from:.3} Hz and {to:.3} Hz"
        ),
        vec![
            Panel::new(frequency(), AxisSpec::linear("|Z| / mΩ"), upper),
            Panel::new(
                frequency(),
                AxisSpec::linear("measured − rebuilt / %"),
                lower,
            ),
        ],
    )
}

/// The distribution of relaxation times.
pub fn drt(name: &str, drt: &Drt) -> Chart {
    let gamma: Vec<(f64, f64)> = drt
        .tau_s
        .iter()
        .zip(&drt.gamma_ohm)
        .map(|(tau, gamma)| (*tau, 1.0e3 * gamma))
        .collect();
    let spread: Vec<f64> = drt.sigma_ohm.iter().map(|sigma| 2.0e3 * sigma).collect();
    let top = gamma
        .iter()
        .map(|point| point.1)
        .fold(0.0, f64::max)
        .max(1.0e-9);
    let inside = |spread: Vec<f64>| -> (Vec<(f64, f64)>, Vec<f64>) {
        // γ is not negative, and neither is the band drawn.
        let ends = gamma
            .iter()
            .zip(&spread)
            .map(|((tau, gamma), s)| (*tau, (gamma - s).max(0.0), (gamma + s).min(1.4 * top)));
        ends.map(|(tau, low, high)| ((tau, 0.5 * (low + high)), 0.5 * (high - low)))
            .unzip()
    };
    let (middle, half) = inside(spread);
    let (fast, slow) = drt.band_tau_s;
    let edge = |label: &str, tau: f64| {
        Trace::new(
            label,
            6,
            TraceStyle::Dashed,
            vec![(tau, 0.0), (tau, 1.1 * top)],
        )
    };
    let traces = vec![
        Trace::new("±2σ of the noise", 0, TraceStyle::Band, middle).with_spread(half),
        Trace::new("γ", 0, TraceStyle::Line, gamma.clone()),
        edge("ends of the measured band", fast),
        edge("", slow),
    ];
    let peaks: Vec<String> = drt
        .peaks
        .iter()
        .map(|peak| format!("{:.3} mΩ at {:.2e} s", 1.0e3 * peak.r_ohm, peak.tau_s))
        .collect();
    let tail = drt.warburg_ohm_per_sqrt_s.value > 0.0 || drt.elastance_per_f.value > 0.0;
    let subtitle = format!(
        "peaks: {}{}",
        peaks.join(", "),
        if tail {
            "; slower: diffusive tail, not drawn"
        } else {
            ""
        }
    );
    Chart::new(
        &titled("Distribution of relaxation times", name),
        &subtitle,
        vec![Panel::new(
            AxisSpec::logarithmic("Time constant / s"),
            AxisSpec::linear("γ / mΩ per unit of ln τ").between(0.0, 1.15 * top),
            traces,
        )],
    )
}
