//! The multisine: the section `[multisine]` against bench and cell.

use analysis_signal::multisine::odd_grid;
use instruments::{
    generator,
    instrument::by_key,
    scope,
    units::{Amps, Hertz, Seconds},
};

use super::{
    ConfigError,
    bias::RawBias,
    check::Check,
    raw_multisine::{Raw, RawBand},
    section::EisBias,
};
use crate::{measure::quality::Quality, plan::LONGEST_FRAME_S};

/// Records of many frequencies at once.
#[derive(Debug, Clone, PartialEq)]
pub struct Multisine {
    /// Peak of the current, A.
    pub peak_a: Amps,
    /// How often the cell is measured.
    pub repeat: usize,
    /// Rest of the cell before each, s.
    pub rest_s: Seconds,
    /// The bands, one record each.
    pub bands: Vec<Band>,
    /// Points in the scope's memory per channel.
    pub memory_points: u64,
    /// Points downloaded per channel.
    pub record_points: u64,
    /// The gate that every line passes, or none.
    pub quality: Option<Quality>,
    /// Direct currents under it; `None` if there is none.
    pub bias: Option<EisBias>,
    /// The bands are repeated under one direct current until it has moved its charge.
    pub operando: bool,
}

/// A band of frequencies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Base frequency, Hz.
    pub base_hz: Hertz,
    /// Slowest and fastest line at most, Hz.
    pub range_hz: (Hertz, Hertz),
    /// Lines.
    pub lines: usize,
    /// Length of the record, s.
    pub span_s: Seconds,
    /// Wait before it, s.
    pub settle_s: Seconds,
    /// Fewest and most steps of a period in the generator, powers of two.
    pub steps: (usize, usize),
    /// Up to here the bipolar supply follows, Hz.
    pub followed_hz: Hertz,
}

/// Greatest charge that a direct current may move before it is brought back, as a share of the
/// capacity, and the greatest along a charge or discharge.
const MOST_CHARGE: f64 = 0.2;
const MOST_OPERANDO: f64 = 0.4;

/// Minimum number of generator steps in a period of the fastest line. The images of the steps lie
/// outside the record's band. The scope folds them back into it; the plan chooses rates and lines
/// so that they miss the lines.
const STEPS_PER_PERIOD: usize = 64;
/// Maximum number of steps: an SDG has no more, and a 33500B receives this many as a hundred
/// kilobytes of text.
const GREATEST_STEPS: usize = 16_384;
/// Samples of the record in a period of the fastest line, at least.
const SAMPLES_PER_PERIOD: f64 = 8.0;
/// The scope rolls from here on, s.
const SHORTEST_SPAN_S: Seconds = Seconds(0.5);

impl Check<'_> {
    pub(super) fn multisine(&self, raw: &Raw) -> Result<Multisine, ConfigError> {
        let instruments = &self.bench.instruments;
        self.refuse_analog("multisine")?;
        self.needs(instruments.supply4q.as_ref(), "supply4q", "multisine")?;
        let generator = self.needs(instruments.generator.as_ref(), "generator", "multisine")?;
        self.needs(instruments.scope.as_ref(), "scope", "multisine")?;
        let Some(most_steps) =
            by_key(generator::DIALECTS, &generator.model).and_then(|dialect| dialect.wave_steps())
        else {
            let reason = format!(
                "expected a generator that plays waves, found {}: [multisine] needs one",
                generator.model
            );
            return Err(self
                .bench_source
                .complain("instruments.generator.model", reason));
        };
        let supply = self.bench.bipolar();
        let full_scale = supply.map_or(Amps::ZERO, |capabilities| capabilities.full_scale);
        let greatest_a = full_scale
            .min(self.cell.limits.charge_a)
            .min(self.cell.limits.discharge_a);
        let driven_hz = supply.map_or(Hertz::ZERO, |capabilities| capabilities.max_freq);
        let mut bands = Vec::new();
        for band in &raw.bands {
            bands.push(self.band(band, driven_hz, most_steps, raw.record_points)?);
        }
        if bands.is_empty() {
            return Err(self.complain("multisine.bands", "expected at least one band, found none"));
        }
        let apart = bands
            .windows(2)
            .all(|pair| pair[0].range_hz.1 < pair[1].range_hz.0);
        if !apart {
            return Err(self.complain(
                "multisine.bands",
                "expected bands that rise and do not overlap",
            ));
        }
        self.within(
            "multisine.memory_points",
            raw.memory_points as f64,
            1_000.0..=1.0e7,
            "points",
        )?;
        self.within(
            "multisine.record_points",
            raw.record_points as f64,
            1_000.0..=raw.memory_points as f64,
            "points",
        )?;
        let bias = self.multisine_bias(raw)?;
        Ok(Multisine {
            bias,
            operando: raw.operando,
            peak_a: self.within(
                "multisine.peak",
                Amps(raw.peak.si),
                Amps(0.01)..=greatest_a,
                "A",
            )?,
            repeat: self
                .within("multisine.repeat", raw.repeat as f64, 1.0..=1000.0, "times")
                .map(|_| raw.repeat)?,
            rest_s: Seconds(raw.rest_first.map_or(Ok(0.0), |rest| {
                self.within("multisine.rest_first", rest.si, 0.0..=86_400.0, "s")
            })?),
            bands,
            memory_points: raw.memory_points,
            record_points: raw.record_points,
            quality: raw
                .quality
                .as_ref()
                .map(|quality| self.quality(quality, "multisine"))
                .transpose()?,
        })
    }

    /// Returns the direct currents; `None` if there is none.
    fn multisine_bias(&self, raw: &Raw) -> Result<Option<EisBias>, ConfigError> {
        let bias = self.bias_of(&RawBias {
            section: "multisine",
            list: raw.bias.as_deref(),
            charge: raw.bias_charge,
            most_charge: if raw.operando {
                MOST_OPERANDO
            } else {
                MOST_CHARGE
            },
            resistance: raw.resistance_max,
            settle: raw.bias_settle,
        })?;
        let again = raw
            .quality
            .as_ref()
            .is_some_and(|quality| quality.again > 0);
        if bias.is_some() && again {
            return Err(self.complain(
                "multisine.quality.again",
                "expected 0 beside a bias: a band that is measured again moves charge that is not \
                planned",
            ));
        }
        let one = bias.as_ref().is_some_and(|bias| bias.levels_a.len() == 1);
        if raw.operando && !one {
            return Err(self.complain(
                "multisine.operando",
                "expected one bias other than 0 A beside it: the impedance is measured along one \
                charge or discharge",
            ));
        }
        Ok(bias)
    }

    fn band(
        &self,
        raw: &RawBand,
        driven_hz: Hertz,
        most_steps: usize,
        record_points: u64,
    ) -> Result<Band, ConfigError> {
        let base_hz = self.within(
            "multisine.bands.base",
            Hertz(raw.base.si),
            Hertz(1.0e-3)..=Hertz(1.0e3),
            "Hz",
        )?;
        let start_hz = raw.start.map_or(base_hz, |start| Hertz(start.si));
        self.within("multisine.bands.start", start_hz, base_hz..=driven_hz, "Hz")?;
        let stop_hz = self.within(
            "multisine.bands.stop",
            Hertz(raw.stop.si),
            start_hz..=driven_hz,
            "Hz",
        )?;
        self.within(
            "multisine.bands.lines",
            raw.lines as f64,
            2.0..=200.0,
            "lines",
        )?;
        let held = |lines: usize| {
            odd_grid(base_hz.value(), start_hz.value()..=stop_hz.value(), lines).len()
        };
        if held(raw.lines) < raw.lines {
            let most = (0..raw.lines)
                .rev()
                .find(|lines| held(*lines) == *lines)
                .unwrap_or(0);
            let reason = format!(
                "expected at most {most} lines, which the odd multiples of {base_hz} from \
                {start_hz} to {stop_hz} have room for with some left \
                 out, found {}",
                raw.lines
            );
            return Err(self.complain("multisine.bands.lines", reason));
        }
        self.within(
            "multisine.bands.periods",
            f64::from(raw.periods),
            3.0..=1000.0,
            "periods",
        )?;
        let last = (stop_hz / base_hz).floor() as usize;
        let steps = (STEPS_PER_PERIOD * last.max(1)).next_power_of_two();
        if steps > most_steps {
            let greatest_hz = (most_steps / STEPS_PER_PERIOD) as f64 * base_hz;
            let reason = format!(
                "expected at most {greatest_hz}, which the generator's {most_steps} steps of a \
                period allow, found {stop_hz}"
            );
            return Err(self.complain("multisine.bands.stop", reason));
        }
        let span_s = f64::from(raw.periods) / base_hz;
        self.within(
            "multisine.bands.periods",
            span_s,
            SHORTEST_SPAN_S..=LONGEST_FRAME_S,
            "s",
        )?;
        let scope = self
            .bench
            .instruments
            .scope
            .as_ref()
            .and_then(|scope| by_key(scope::DIALECTS, &scope.model));
        let screen_s = scope.map_or(span_s, |scope| {
            let capabilities = scope.capabilities();
            Seconds(capabilities.time_per_div(span_s).value() * capabilities.horizontal_div)
        });
        if (screen_s / span_s - 1.0).abs() > 1.0e-9 {
            let reason = format!(
                "expected whole periods that fill a screen of the scope, such as {screen_s}, \
                found {span_s}"
            );
            return Err(self.complain("multisine.bands.periods", reason));
        }
        if SAMPLES_PER_PERIOD * stop_hz * span_s > record_points as f64 {
            let needed = SAMPLES_PER_PERIOD * stop_hz * span_s;
            return Err(self.complain(
                "multisine.record_points",
                format!("expected at least {needed:.0} points, found {record_points}"),
            ));
        }
        let settle_s = self.within("multisine.bands.settle", raw.settle.si, 0.0..=3600.0, "s")?;
        let steps = (steps, most_steps.min(GREATEST_STEPS).max(steps));
        Ok(Band {
            base_hz,
            range_hz: (start_hz, stop_hz),
            lines: raw.lines,
            span_s,
            settle_s: Seconds(settle_s),
            steps,
            followed_hz: driven_hz,
        })
    }
}

impl Multisine {
    /// Returns the direct currents of a round, A, as those of the sweeps.
    pub fn levels_of(&self, round: usize) -> Vec<Amps> {
        let mut levels_a = self
            .bias
            .as_ref()
            .map_or_else(|| vec![Amps::ZERO], |bias| bias.levels_a.clone());
        if round.is_multiple_of(2) {
            levels_a.reverse();
        }
        levels_a
    }
}
