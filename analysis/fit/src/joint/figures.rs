//! Pictures of the comparison: pulses with both models, resistances over OCV, the DC resistance
//! over the order.

use super::fit::JointFit;
use super::study::{OrderResult, PulseResult, Role, Study, TIMES_S};
use analysis_plot::{AxisSpec, Chart, Panel, Trace, TraceStyle};

/// Most pulses in one picture.
const MOST: usize = 5;
/// Time drawn around an edge, s.
const DRAWN_S: (f64, f64) = (-15.0, 70.0);

impl Study {
    /// The pulses of the range: voltage over time since the edge, the OCV's share of the drift left
    /// in.
    pub fn pulses_chart(&self, name: &str) -> Chart {
        let inside: Vec<&PulseResult> = self
            .pulses
            .iter()
            .filter(|p| p.role != Role::Outside)
            .take(MOST)
            .collect();
        let panel = |(k, p): (usize, &&PulseResult)| {
            let points = |column: usize, keep: &dyn Fn(f64) -> bool| -> Vec<(f64, f64)> {
                p.overlay
                    .iter()
                    .filter(|r| keep(r[0]) && (DRAWN_S.0..=DRAWN_S.1).contains(&r[0]))
                    .map(|r| (r[0], 1e3 * r[column]))
                    .collect()
            };
            let label = |text: &'static str| if k == 0 { text } else { "" };
            let mut traces = vec![Trace::new(
                label("measured, means over bins"),
                0,
                TraceStyle::Points,
                points(1, &|_| true),
            )];
            for (column, text) in [(2, "spectra alone"), (3, "spectra and pulses")] {
                let style = if column == 2 {
                    TraceStyle::Dashed
                } else {
                    TraceStyle::Line
                };
                // A line across an edge would show a slope that was not measured.
                let parts: [&dyn Fn(f64) -> bool; 3] =
                    [&|t| t <= 0.0, &|t| t > 0.0 && t <= p.length_s, &|t| {
                        t > p.length_s
                    }];
                for (j, part) in parts.into_iter().enumerate() {
                    traces.push(Trace::new(
                        if j == 1 { label(text) } else { "" },
                        column - 1,
                        style,
                        points(column, part),
                    ));
                }
            }
            let role = if p.role == Role::Fitted {
                "fitted"
            } else {
                "held out"
            };
            let y = AxisSpec::linear(&format!("{role}, {:.2} V / mV", p.joint.ocv_v));
            Panel {
                aspect: 0.26,
                ..Panel::new(
                    AxisSpec::linear("Time since the edge / s").between(DRAWN_S.0, DRAWN_S.1),
                    y,
                    traces,
                )
            }
        };
        let panels = inside.iter().enumerate().map(panel).collect();
        let subtitle = format!(
            "{name}: less the voltage before the edge; {} and {} RC",
            self.spectra_rc, self.rc
        );
        Chart::new("Pulses measured and predicted", &subtitle, panels)
    }

    /// Apparent resistances of all pulses over OCV, measured and predicted.
    pub fn gaps_chart(&self, name: &str) -> Chart {
        let pick = |p: &PulseResult, time: f64, f: &dyn Fn(&PulseResult, usize) -> (f64, f64)| {
            p.joint
                .at
                .iter()
                .position(|a| a.time_s == time)
                .map(|k| (p.joint.ocv_v, f(p, k)))
        };
        let panel = |(k, time): (usize, &f64)| {
            let mut ordered: Vec<&PulseResult> = self.pulses.iter().collect();
            ordered.sort_by(|a, b| a.joint.ocv_v.total_cmp(&b.joint.ocv_v));
            let trace = |label: &str,
                         colour,
                         style,
                         f: &dyn Fn(&PulseResult, usize) -> (f64, f64),
                         of: &dyn Fn(Role) -> bool| {
                let found: Vec<(f64, (f64, f64))> = ordered
                    .iter()
                    .filter(|p| of(p.role))
                    .filter_map(|p| pick(p, *time, f))
                    .collect();
                let points = found.iter().map(|(u, (r, _))| (*u, 1e3 * r)).collect();
                Trace::new(if k == 0 { label } else { "" }, colour, style, points)
                    .with_spread(found.iter().map(|(_, (_, s))| 2e3 * s).collect())
            };
            let measured = |p: &PulseResult, k: usize| {
                (p.joint.at[k].measured_ohm, p.joint.at[k].measured_sigma_ohm)
            };
            let alone = |p: &PulseResult, k: usize| {
                (
                    p.spectra.at[k].predicted_ohm,
                    p.spectra.at[k].predicted_sigma_ohm.unwrap_or(0.0),
                )
            };
            let joint = |p: &PulseResult, k: usize| (p.joint.at[k].predicted_ohm, 0.0);
            let any = |_: Role| true;
            let traces = vec![
                trace("spectra alone, 2σ", 1, TraceStyle::Band, &alone, &any),
                trace("", 1, TraceStyle::Dashed, &alone, &any),
                trace("spectra and pulses", 2, TraceStyle::Line, &joint, &any),
                trace("measured, fitted", 0, TraceStyle::Points, &measured, &|r| {
                    r == Role::Fitted
                }),
                trace(
                    "measured, held out",
                    3,
                    TraceStyle::Points,
                    &measured,
                    &|r| r == Role::HeldOut,
                ),
                trace(
                    "measured, other OCV",
                    4,
                    TraceStyle::Points,
                    &measured,
                    &|r| r == Role::Outside,
                ),
            ];
            let y = AxisSpec::linear(&format!("after {time} s / mΩ"));
            Panel {
                aspect: 0.3,
                ..Panel::new(AxisSpec::linear("OCV at the edge / V"), y, traces)
            }
        };
        let panels = TIMES_S.iter().enumerate().map(panel).collect();
        Chart::new(
            "Apparent resistance of the pulses",
            &format!("{name}; with the fall of the OCV during the pulse; bars 2σ"),
            panels,
        )
    }

    /// DC resistance and resistance after 10 s over the order.
    pub fn orders_chart(&self, name: &str) -> Chart {
        let place = |o: &OrderResult, shift: f64| o.rc as f64 + shift;
        let trace = |label: &str,
                     colour,
                     shift: f64,
                     value: &dyn Fn(&OrderResult) -> (f64, Option<f64>)| {
            let points = self
                .orders
                .iter()
                .map(|o| (place(o, shift), 1e3 * value(o).0))
                .collect();
            let spread = self
                .orders
                .iter()
                .map(|o| 2e3 * value(o).1.unwrap_or(0.0))
                .collect();
            Trace::new(label, colour, TraceStyle::Points, points).with_spread(spread)
        };
        let dc = |f: &JointFit| (f.dc_resistance_ohm, f.sigma.dc_resistance_ohm);
        let step = |f: &JointFit| {
            f.step_resistance
                .first()
                .map_or((f64::NAN, None), |s| (s.1, s.2))
        };
        let x = || AxisSpec::linear("RC branches");
        let panels = vec![
            Panel::new(
                x(),
                AxisSpec::linear("DC resistance / mΩ"),
                vec![
                    trace("spectra alone, 2σ", 1, -0.06, &|o| dc(&o.spectra)),
                    trace("spectra and pulses, 2σ", 2, 0.06, &|o| dc(&o.joint)),
                ],
            ),
            Panel::new(
                x(),
                AxisSpec::linear("after 10 s / mΩ"),
                vec![
                    trace("", 1, -0.06, &|o| step(&o.spectra)),
                    trace("", 2, 0.06, &|o| step(&o.joint)),
                ],
            ),
        ];
        Chart::new(
            "Resistance over the order of the model",
            &format!("{name}; without the fall of the OCV"),
            panels,
        )
    }
}
