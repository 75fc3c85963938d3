//! The picture of a table: resistance over state, discharge and charge below each other.

use analysis_plot::{AxisSpec, Chart, Panel, Trace, TraceStyle};

use super::result::{Direction, Hppc, Pulse, StateAxis};

/// Draws each resistance with its standard uncertainty over the state, one colour for each time.
pub fn chart(table: &Hppc) -> Chart {
    let panels = [Direction::Discharge, Direction::Charge]
        .into_iter()
        .filter_map(|direction| panel(table, direction))
        .collect();
    Chart::new(
        &format!("{}: pulse resistance", table.name),
        "bars: one standard uncertainty",
        panels,
    )
}

fn panel(table: &Hppc, direction: Direction) -> Option<Panel> {
    let pulses = || table.pulses.iter().filter(|one| one.direction == direction);
    let traces: Vec<Trace> = table
        .at_s
        .iter()
        .enumerate()
        .map(|(index, at_s)| {
            let each = pulses().filter_map(|pulse| {
                let found = pulse.resistances.get(index)?.found?;
                let point = (state(table, pulse)?, 1e3 * found.ohm);
                Some((point, 1e3 * found.sigma_ohm.unwrap_or(0.0)))
            });
            let (points, spread): (Vec<(f64, f64)>, Vec<f64>) = each.unzip();
            let label = format!("{} {at_s} s", direction.word());
            (label, index, points, spread)
        })
        .filter(|(_, _, points, _)| !points.is_empty())
        .map(|(label, index, points, spread)| {
            Trace::new(&label, index, TraceStyle::Points, points).with_spread(spread)
        })
        .collect();
    let name = match table.axis {
        StateAxis::Soc => "State of charge",
        StateAxis::ChargeDrawn => "Charge drawn since the first row / Ah",
        StateAxis::RestVoltage => "Voltage of the rest / V",
    };
    let resistance = format!("R, {} / mΩ", direction.word());
    (!traces.is_empty()).then(|| {
        Panel::new(
            AxisSpec::linear(name),
            AxisSpec::linear(&resistance),
            traces,
        )
    })
}

fn state(table: &Hppc, pulse: &Pulse) -> Option<f64> {
    match table.axis {
        StateAxis::Soc => pulse.state.soc.map(|soc| soc.value),
        StateAxis::ChargeDrawn => pulse.state.drawn_ah,
        StateAxis::RestVoltage => pulse.state.open_circuit.map(|ocv| ocv.v),
    }
}
