//! `eis-bench pack size`: peak, crossing and regeneration power of a pack by the simple-IR model.

use super::model_args::{self, ModelArgs, PackArgs, WindowArgs, required_sizes};
use crate::command::units;
use bench_core::safety::failure::Failure;
use bench_evaluate::files::{self, AMBIENT_DEGC};
use bench_plan::config::quantity::{Duration, Power, Resistance, Temperature, Voltage};
use bench_plan::support::terminal::say;
use std::path::{Path, PathBuf};

use analysis::{
    forward::OcvSource,
    given::GivenModel,
    map::CellMap,
    pack::{
        HeldPower, Hold, OperatingPoint, Pack, PackError, SimpleIr, Sizing, SizingInput,
        ThermalMass,
    },
    plot::{AxisSpec, Chart, Panel, Trace, TraceStyle},
};
use clap::Args;
use serde::Serialize;

const HELP: &str = "\
Every cell is taken as an ideal source (its open-circuit voltage) behind one resistance (its DC \
resistance), the pack as S/P of them plus the
interconnect. Then CCV = (OCV + √(OCV² − 4·P·r))/2, and three powers follow in closed form:
  peak      the most that can be drawn before the pack falls to its lower voltage (or to half the \
OCV, where no load gets more)
  crossing  where the falling voltage meets what the load needs for its power, --required-v-per-w \
times the power
  regen     the charging power (negative) that lifts the pack to its upper voltage
The window is that of the cells times S, at the pack's terminals. What a pack can do for a short \
time only is more: see `eis-bench sop`.

Example, the pack of a humanoid robot (8 kW at 60 V, in proportion below: 0.0075 V/W), and 4 kW \
for 10 s:
  eis-bench pack size --series 16 --parallel 3 --ocv-v 3.6 --dcir-ohm 0.015 --interconnect-ohm \
0.03 \\
    --required-v-per-w 0.0075 --power-w 4000 --hold-s 10";

/// Arguments of `pack size`.
#[derive(Debug, Args)]
#[command(after_help = HELP, mut_args(required_sizes))]
pub struct SizeArgs {
    /// The pack.
    #[command(flatten)]
    pub pack: PackArgs,
    /// Open-circuit voltage of a cell, V.
    #[arg(long, value_name = "V", value_parser = units::of::<Voltage>)]
    pub ocv_v: f64,
    /// DC resistance of a cell, Ω [default: that of the model]
    #[arg(
        long,
        value_name = "OHM",
        required_unless_present_any = ["model", "erm"],
        value_parser = units::of::<Resistance>
    )]
    pub dcir_ohm: Option<f64>,
    /// A model to take the DC resistance from: a file of `fit`, `joint` or a run, JSON of `r_ohm`
    /// and `branches` alone, or circuit.json.
    #[arg(long, value_name = "FILE", conflicts_with = "dcir_ohm")]
    pub model: Option<PathBuf>,
    /// Temperature of the cells, °C, for a model with a map [default: 25]
    #[arg(
        long,
        value_name = "DEGC",
        conflicts_with = "dcir_ohm",
        allow_hyphen_values = true,
        value_parser = units::of::<Temperature>
    )]
    pub ambient_degc: Option<f64>,
    /// The model as text: "6.43 mΩ; 1.51 mΩ, 0.553 F; 0.66 mΩ, 4.6 ms".
    #[arg(long, value_name = "TEXT", conflicts_with_all = ["dcir_ohm", "model"])]
    pub erm: Option<String>,
    /// Bus voltage that the load needs per watt it draws, V/W.
    #[arg(long, value_name = "V/W", allow_negative_numbers = true)]
    pub required_v_per_w: Option<f64>,
    /// Limits of a cell.
    #[command(flatten)]
    pub window: WindowArgs,
    /// A power that is held, W, negative for charging; needs --hold-s.
    #[arg(
        long,
        value_name = "W",
        requires = "hold_s",
        allow_hyphen_values = true,
        value_parser = units::of::<Power>
    )]
    pub power_w: Option<f64>,
    /// Duration for which --power-w is held, s.
    #[arg(long, value_name = "S", requires = "power_w", value_parser = units::of::<Duration>)]
    pub hold_s: Option<f64>,
    /// Mass and specific heat of a cell.
    #[command(flatten)]
    pub thermal: ThermalArgs,
    /// Write sizing.json and the plot of voltage over power into this folder.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Mass and specific heat of a cell.
#[derive(Debug, Clone, Copy, Args)]
pub struct ThermalArgs {
    /// Mass of a cell, kg [default: 0.07, the maximum of the Molicel P45B's data sheet]
    #[arg(long, value_name = "KG", allow_negative_numbers = true)]
    pub cell_mass_kg: Option<f64>,
    /// Specific heat of a cell, J/(kg·K) [default: 950; published values for such cells lie between
    /// 900 and 1000, and none has been measured on the cells of this project]
    #[arg(long, value_name = "J/KG/K", allow_negative_numbers = true)]
    pub specific_heat: Option<f64>,
}

impl ThermalArgs {
    /// As the analysis wants it.
    pub fn mass(self) -> ThermalMass {
        let usual = ThermalMass::P45B;
        ThermalMass {
            mass_kg: self.cell_mass_kg.unwrap_or(usual.mass_kg),
            specific_heat_j_per_kg_k: self.specific_heat.unwrap_or(usual.specific_heat_j_per_kg_k),
        }
    }

    /// Returns the name of the argument that is missing if only one of both is given.
    pub fn missing(self) -> Option<&'static str> {
        match (self.cell_mass_kg, self.specific_heat) {
            (Some(_), None) => Some("--specific-heat"),
            (None, Some(_)) => Some("--cell-mass-kg"),
            _ => None,
        }
    }

    /// Returns whether one of them is given.
    pub fn is_given(self) -> bool {
        self.cell_mass_kg.is_some() || self.specific_heat.is_some()
    }
}

#[derive(Serialize)]
struct SizeReport {
    #[serde(flatten)]
    sizing: Sizing,
    hold: Option<Hold>,
    /// DC resistance of a cell, Ω.
    dcir_ohm: f64,
    /// Limits of the model that it comes from.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    model_notes: Vec<String>,
}

/// Sizes a pack and prints it.
///
/// # Errors
/// An argument that makes no sense; a folder that cannot be written.
pub fn size(args: &SizeArgs) -> Result<(), Failure> {
    let usage = |error: PackError| Failure::Usage(error.to_string());
    let pack = args.pack.pack()?;
    let (dcir_ohm, model_notes) = dc_resistance(args)?;
    let input = SizingInput {
        pack,
        cell_ocv_v: args.ocv_v,
        dcir_ohm,
        window_v: (args.window.v_min, args.window.v_max),
        required_v_per_w: args.required_v_per_w,
    };
    let sizing = Sizing::new(&input).map_err(usage)?;
    let held = args.power_w.zip(args.hold_s);
    let hold = held
        .map(|(power_w, duration_s)| {
            let held = HeldPower {
                power_w,
                duration_s,
            };
            Hold::new(&input, held, args.thermal.mass())
        })
        .transpose()
        .map_err(usage)?;
    let report = SizeReport {
        sizing,
        hold,
        dcir_ohm,
        model_notes,
    };
    let json = serde_json::to_string_pretty(&report)
        .map_err(|error| Failure::Analysis(error.to_string()))?;
    if let Some(out) = &args.out {
        write(
            out,
            &json,
            &voltage_over_power(&input, &report.sizing).map_err(usage)?,
        )?;
    }
    if args.json {
        say!("{json}");
        return Ok(());
    }
    print_text(&input, &report);
    if let Some(out) = &args.out {
        say!("written to {}", out.display());
    }
    Ok(())
}

/// Returns the DC resistance of a cell, Ω, as given or of the model, and what that value does not
/// include.
fn dc_resistance(args: &SizeArgs) -> Result<(f64, Vec<String>), Failure> {
    if let Some(dcir_ohm) = args.dcir_ohm {
        return Ok((dcir_ohm, Vec::new()));
    }
    let named = ModelArgs {
        model: args.model.clone(),
        erm: args.erm.clone(),
        ladder_band_hz: None,
    };
    let model = named.read(None)?;
    let fail = |met: &str| {
        Failure::Usage(format!(
            "{}: expected a model {met}; give --dcir-ohm",
            named.display_name()
        ))
    };
    if !model.additions.is_empty() {
        return Err(fail(
            "without additions, met some, which no single resistance stands for",
        ));
    }
    if let Some(map) = &model.map {
        return resistance_of_map(args, &model, map);
    }
    let dcir_ohm = model
        .dc_resistance_ohm()
        .ok_or_else(|| fail("with a DC resistance, met a circuit without one"))?;
    let mut notes = model_args::notes(&model);
    let soc = model
        .ocv
        .as_ref()
        .and_then(|curve| curve.soc_at(args.ocv_v));
    notes.extend(model.away_note(soc.as_slice(), args.ambient_degc.as_slice()));
    Ok((dcir_ohm, notes))
}

/// Returns the DC resistance of a map where a cell rests at `--ocv-v`, Ω, and at which point that is.
fn resistance_of_map(
    args: &SizeArgs,
    model: &GivenModel,
    map: &CellMap,
) -> Result<(f64, Vec<String>), Failure> {
    const SINGLE: Pack = Pack {
        series: 1,
        parallel: 1,
        interconnect_ohm: 0.0,
    };
    let Some(curve) = &model.ocv else {
        return Err(Failure::Usage(
            "--model: expected an OCV curve for a model with a map, found none; give --dcir-ohm"
                .to_owned(),
        ));
    };
    let degc = args.ambient_degc.unwrap_or(AMBIENT_DEGC);
    let single = files::sim_model(model, OcvSource::Curve(curve.clone()), SINGLE, degc)?;
    let soc = single
        .rest_at(args.ocv_v)
        .map_err(|error| Failure::Usage(format!("--ocv-v: {error}")))?
        .soc;
    let mut notes = model_args::notes(model);
    notes.push(format!(
        "the DC resistance is that of the map at SOC {soc:.3} and {degc:.1} °C, without a current"
    ));
    let outside = map.place(soc, degc).outside;
    if outside.is_outside() {
        notes.push(format!("{outside}; there the resistances are extrapolated"));
    }
    Ok((map.model_at(soc, degc).dc_resistance_ohm(), notes))
}

fn print_text(input: &SizingInput, report: &SizeReport) {
    let s = &report.sizing;
    say!(
        "{} at {} V per cell: OCV {:.2} V, resistance {:.1} mΩ, window {:.1} to {:.1} V",
        s.pack.name(),
        input.cell_ocv_v,
        s.ocv_v,
        1.0e3 * s.resistance_ohm,
        s.v_min_v,
        s.v_max_v
    );
    for (name, point) in [
        ("peak", s.peak),
        ("crossing", s.crossing),
        ("regen", s.regen),
    ] {
        if let Some(p) = point {
            say!("  {name:<9}{}", operating_point(&p));
        }
    }
    say!(
        "  {:<9}{:>8.2} kW, what no load can exceed (OCV²/4r)",
        "maximum",
        1.0e-3 * s.theoretical_maximum_w
    );
    if let Some(h) = &report.hold {
        say!(
            "  {:<9}{:>8.2} kW for {} s: {:.2} V{}, {:.1} A and {:.0} J of heat per cell, +{:.2} K \
            if none leaves it",
            "held",
            1.0e-3 * h.power_w,
            h.duration_s,
            h.voltage_v,
            if h.within_window {
                ""
            } else {
                " OUTSIDE THE WINDOW"
            },
            h.cell_current_a,
            h.cell_heat_j,
            h.temperature_rise_k
        );
    }
    for note in s.notes.iter().chain(&report.model_notes) {
        say!("  note: {note}");
    }
}

fn operating_point(p: &OperatingPoint) -> String {
    format!(
        "{:>8.2} kW at {:.2} V, {:.1} A ({:.1} A per cell), {:.2} kW of heat",
        1.0e-3 * p.power_w,
        p.voltage_v,
        p.current_a,
        p.cell_current_a,
        1.0e-3 * p.heat_w
    )
}

/// The chart of the thesis' figures 2.3 and 2.4.
fn voltage_over_power(input: &SizingInput, s: &Sizing) -> Result<Chart, PackError> {
    let ir = SimpleIr::new(input)?;
    let top = s.v_max_v.max(s.ocv_v) * 1.01;
    let at = |v: f64| (1.0e-3 * ir.at_voltage(v).power_w, v);
    let curve: Vec<(f64, f64)> = (0..=400)
        .map(|k| at(0.5 * s.ocv_v + (top - 0.5 * s.ocv_v) * f64::from(k) / 400.0))
        .collect();
    let (left, right) = (at(top).0, 1.0e-3 * s.theoretical_maximum_w);
    let level = |v: f64| vec![(left, v), (right, v)];
    let low = 0.9 * s.v_min_v.min(0.5 * s.ocv_v);
    let mut traces = vec![
        Trace::new("voltage window", 5, TraceStyle::Dashed, level(s.v_min_v)),
        Trace::new("", 5, TraceStyle::Dashed, level(s.v_max_v)),
        Trace::new("CCV", 0, TraceStyle::Line, curve),
    ];
    if let Some(slope) = input.required_v_per_w {
        // A point below the frame would be drawn at its edge and bend the line.
        let (start, end) = (1.0e-3 * low / slope, right.min(1.0e-3 * top / slope));
        if start < end {
            let line = vec![(start, 1.0e3 * slope * start), (end, 1.0e3 * slope * end)];
            traces.push(Trace::new(
                "bus voltage that the load needs",
                1,
                TraceStyle::Line,
                line,
            ));
        }
    }
    let points = [
        ("peak", s.peak, 2),
        ("crossing", s.crossing, 3),
        ("regeneration", s.regen, 4),
    ];
    for (name, point, colour) in points {
        if let Some(p) = point {
            let power = 1.0e-3 * p.power_w;
            traces.push(Trace::new(
                &format!("{name} {power:.2} kW"),
                colour,
                TraceStyle::Points,
                vec![(power, p.voltage_v)],
            ));
        }
    }
    let title = format!("{}: voltage over power, simple-IR model", s.pack.name());
    let subtitle = format!(
        "{} V and {} mΩ per cell, interconnect {} mΩ; positive power is discharge",
        input.cell_ocv_v,
        1.0e3 * input.dcir_ohm,
        1.0e3 * s.pack.interconnect_ohm
    );
    let panel = Panel::new(
        AxisSpec::linear("Power / kW"),
        AxisSpec::linear("Voltage / V").between(low, top),
        traces,
    );
    Ok(Chart::new(
        &title,
        &subtitle,
        vec![Panel {
            aspect: 0.6,
            ..panel
        }],
    ))
}

fn write(out: &Path, json: &str, picture: &Chart) -> Result<(), Failure> {
    files::make_folder(out)?;
    files::write_text(out, "sizing.json", &format!("{json}\n"))?;
    files::write_chart(out, "voltage_over_power", picture)
}

#[cfg(test)]
mod tests {
    use analysis::pack::Pack;

    use super::*;

    #[test]
    fn the_json_has_the_fixed_names() {
        let pack = Pack::new(16, 3, 0.03).unwrap();
        let input = SizingInput {
            pack,
            cell_ocv_v: 4.0,
            dcir_ohm: 0.015,
            window_v: (2.5, 4.2),
            required_v_per_w: Some(0.0075),
        };
        let report = SizeReport {
            sizing: Sizing::new(&input).unwrap(),
            hold: None,
            dcir_ohm: 0.015,
            model_notes: Vec::new(),
        };
        let json: serde_json::Value = serde_json::to_value(&report).unwrap();
        for (name, kilowatts) in [
            ("peak_power_w", 8.73),
            ("crossing_power_w", 6.58),
            ("regen_power_w", -1.95),
        ] {
            assert!(
                (json[name].as_f64().unwrap() / 1000.0 - kilowatts).abs() < 0.005,
                "{json}"
            );
        }
        assert_eq!(json["series"], 16);
        assert!(voltage_over_power(&input, &report.sizing).is_ok());
    }
}
