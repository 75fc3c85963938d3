//! The zero of the scope's channels: their means while no current flows through a cell. A direct
//! current that comes with the first sinusoid is in every record of a sweep, so that no change from
//! record to record shows it; against this zero it shows in the first record.

use instruments::{fixture::Fixture, scope::Waveform};

use super::{
    ExecuteError, Executor, Rig,
    crest::{Drawn, channel_volts, difference, mean, whole_periods},
    require,
    rig::FirstMean,
};
use crate::{
    interlock::NO_CURRENT_A,
    plan::{Frame, SweepSettings, fixture_name},
};

/// Name of what trips.
pub(super) const SINCE_ZERO: &str = "mean of the cell current since the zero of the channels";
/// Direct current that a sinusoid may bring with it, as a share of its amplitude: generators are
/// specified to 0.25 % to 0.5 % (33500B, SDG1000X).
const OFFSET_SHARE: f64 = 0.01;
/// Length of a record of the zero, s: ten periods of a mains of 50 Hz, twelve of 60 Hz.
const ZERO_S: f64 = 0.2;
/// For the scope to fill its screen, s.
const FILL_S: f64 = 0.05;

/// Greatest mean of a record beyond the zero of the channels, A: the supply has shown less than
/// this before the first sinusoid.
pub(super) fn allowed_since_zero_a(amplitude_a: f64) -> f64 {
    NO_CURRENT_A + OFFSET_SHARE * amplitude_a
}

/// Means of C1 to C3 in one record, V.
#[derive(Debug, Clone, Copy, PartialEq)]
struct ChannelMeans {
    volts_per_div: [f64; 3],
    volts: [f64; 3],
}

/// Means of the channels while no current flows through a cell, one for each set of scales.
#[derive(Debug, Default)]
pub(super) struct Zeros(Vec<ChannelMeans>);

impl Zeros {
    /// The latest on a set of scales counts.
    fn keep(&mut self, means: ChannelMeans) {
        self.0
            .retain(|known| known.volts_per_div != means.volts_per_div);
        self.0.push(means);
    }

    /// The zero on these scales of the shunt's channels; best that with the same scale of C3.
    fn on(&self, means: &ChannelMeans) -> Option<&ChannelMeans> {
        let same = |known: &&ChannelMeans| known.volts_per_div[..2] == means.volts_per_div[..2];
        let whole = |known: &&ChannelMeans| known.volts_per_div == means.volts_per_div;
        self.0
            .iter()
            .find(whole)
            .or_else(|| self.0.iter().rfind(same))
    }
}

impl ChannelMeans {
    /// Means over whole periods; none where a channel clips.
    fn of(waveforms: [&Waveform; 3], freq_hz: f64) -> Option<Self> {
        let clips = waveforms.iter().any(|one| one.clipped_share() > 0.0);
        let volts = waveforms.map(|waveform| {
            let volts = channel_volts(waveform);
            mean(whole_periods(&volts, waveform.interval_s * freq_hz))
        });
        (!clips).then(|| Self {
            volts_per_div: waveforms.map(|waveform| waveform.preamble.volts_per_div),
            volts,
        })
    }
}

impl Rig<'_> {
    /// The mean that the records on these scales are compared with: the zero of the channels where
    /// it was measured, else the first record itself. The zero of a control is kept.
    pub(super) fn first_mean(
        &mut self,
        fixture: Fixture,
        asked: &Drawn<'_>,
        mean_a: f64,
    ) -> Result<FirstMean, ExecuteError> {
        let [below, above, low, _] = asked.waveforms;
        let volts_per_div = [below, above].map(|waveform| waveform.preamble.volts_per_div);
        let by_itself = FirstMean {
            volts_per_div,
            zero_a: mean_a - self.driving.mean_change_a,
            measured: false,
        };
        let Some(means) = ChannelMeans::of([below, above, low], asked.freq_hz) else {
            return Ok(by_itself);
        };
        if fixture != Fixture::Cell {
            self.driving.zeros.keep(means);
            return Ok(by_itself);
        }
        let Some(zero) = self.driving.zeros.on(&means).copied() else {
            return Ok(by_itself);
        };
        let zero_a = (zero.volts[1] - zero.volts[0]) / self.setup.wiring.shunt.r_ohm;
        let change_a = mean_a - zero_a;
        if change_a.abs() > allowed_since_zero_a(asked.amplitude_a)
            && zero.volts_per_div == means.volts_per_div
            && self.denies_current(asked, change_a, means.volts[2] - zero.volts[2])
        {
            // The zeros of the shunt's channels have moved, and no current flows.
            self.recorder.warning(&format!(
                "the zero of C1 and C2 moved by {:.2} mV since it was measured; C3 shows no direct \
                current",
                1.0e3 * change_a * self.setup.wiring.shunt.r_ohm
            ));
            return Ok(by_itself);
        }
        Ok(FirstMean {
            zero_a,
            measured: true,
            ..by_itself
        })
    }

    /// Whether C3 shows less than half of a direct current: it lies above shunt and return wire, so
    /// that a direct current moves its mean as the sinusoid moves its samples.
    fn denies_current(&self, asked: &Drawn<'_>, change_a: f64, moved_v: f64) -> bool {
        let [below, above, low, _] = asked.waveforms;
        let shunt_v = effective(&difference(above, below));
        let tap_v = effective(&channel_volts(low));
        let below_ohm = self.setup.wiring.shunt.r_ohm * tap_v / shunt_v;
        (moved_v / below_ohm).abs() < 0.5 * change_a.abs()
    }

    /// Refuses a record that the scope has sent before in this run.
    pub(super) fn refuse_old_record(
        &mut self,
        fixture: Fixture,
        asked: &Drawn<'_>,
    ) -> Result<(), ExecuteError> {
        let codes = asked.waveforms.each_ref().map(|one| one.codes.as_slice());
        let name = format!("{} at {} Hz", fixture_name(fixture), asked.freq_hz);
        let earlier = self.driving.records.earlier(codes, name);
        earlier.map_or(Ok(()), |earlier| {
            Err(ExecuteError::Repeated {
                freq_hz: asked.freq_hz,
                earlier,
            })
        })
    }
}

impl Executor<'_> {
    /// Records the zero of the channels with the output on at zero, before the first sinusoid; not
    /// where the controls of the run show it.
    pub(super) async fn measure_zero(
        &mut self,
        fixture: Fixture,
        settings: &SweepSettings,
    ) -> Result<(), ExecuteError> {
        let due = settings.zero_first && self.rig.driving.first_mean.is_none();
        if fixture != Fixture::Cell || !due {
            return Ok(());
        }
        let capabilities = require(&mut self.rig.bench.instruments.scope, "scope")?.capabilities();
        if self.scope.verticals[0].is_none() {
            self.first_ranges(fixture, settings.amplitude_a, &capabilities)
                .await?;
        }
        let memory_points = self.scope.memory_points.unwrap_or(settings.record_points);
        self.arm(&Frame {
            start_s: 0.0,
            span_s: ZERO_S,
            memory_points,
            record_points: settings.record_points,
        })
        .await?;
        self.rig
            .wait_watching(ZERO_S + FILL_S, "idle", fixture)
            .await?;
        self.rig.freeze().await?;
        let error = self.rig.bench.error("scope");
        let mut waveforms = Vec::with_capacity(3);
        for channel in 1..=3 {
            let scope = require(&mut self.rig.bench.instruments.scope, "scope")?;
            let waveform = scope.download(channel, settings.record_points).await;
            waveforms.push(waveform.map_err(&error)?);
        }
        if let [below, above, low] = waveforms.as_slice()
            && let Some(means) = ChannelMeans::of([below, above, low], 0.0)
        {
            self.rig.driving.zeros.keep(means);
        }
        Ok(())
    }
}

/// Effective value of what alternates.
fn effective(samples: &[f64]) -> f64 {
    let middle = mean(samples);
    let squares: f64 = samples.iter().map(|v| (v - middle).powi(2)).sum();
    (squares / samples.len().max(1) as f64).sqrt()
}
