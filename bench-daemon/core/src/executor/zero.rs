//! Measures the zero of the scope's channels: their means without a current through a cell. A
//! direct current that starts with the first sinusoid is in every record of a sweep, so that no
//! change between records shows it; compared with this zero, the first record shows it.

use analysis_files::dataset::Capture;
use instruments::{
    fixture::Fixture,
    scope::Waveform,
    units::{Amps, Ohms, Seconds, Volts},
};

use super::{
    ExecuteError, Executor, Rig,
    crest::{Drawn, channel_volts, difference, mean, whole_periods},
    require,
    rig::FirstMean,
};
use bench_plan::{
    measure::{
        repeated::digest_record,
        zero::{ChannelMeans, Zeros, allowed_since_zero_a},
    },
    plan::{Frame, SweepSettings, fixture_name},
};

/// Length of a record of the zero, s: ten periods of a mains of 50 Hz, twelve of 60 Hz.
const ZERO_S: Seconds = Seconds(0.2);
/// Time for the scope to fill its screen, s.
const FILL_S: Seconds = Seconds(0.05);

/// One channel of a record.
struct ChannelSamples {
    volts_per_div: f64,
    volts: Vec<f64>,
    clips: bool,
}

impl ChannelSamples {
    fn of(waveform: &Waveform) -> Self {
        Self {
            volts_per_div: waveform.preamble.volts_per_div,
            volts: channel_volts(waveform),
            clips: waveform.clipped_share() > 0.0,
        }
    }

    fn of_capture(capture: &Capture, slot: usize) -> Self {
        let (channel, codes) = (&capture.meta.channels[slot], &capture.codes[slot]);
        let ends = [channel.scale.code_min, channel.scale.code_max];
        Self {
            volts_per_div: channel.volts_per_div,
            volts: codes
                .iter()
                .map(|code| channel.scale.volts(*code))
                .collect(),
            clips: codes.iter().any(|code| ends.contains(code)),
        }
    }
}

/// Returns means over whole periods, or `None` if a channel clips.
fn means_of(channels: &[ChannelSamples; 3], periods_per_sample: f64) -> Option<ChannelMeans> {
    let clips = channels.iter().any(|channel| channel.clips);
    (!clips).then(|| ChannelMeans {
        volts_per_div: channels.each_ref().map(|channel| channel.volts_per_div),
        volts: channels
            .each_ref()
            .map(|channel| Volts(mean(whole_periods(&channel.volts, periods_per_sample)))),
    })
}

fn means_of_record(asked: &Drawn<'_>) -> Option<ChannelMeans> {
    let [below, above, low, _] = asked.waveforms;
    let channels = [below, above, low].map(ChannelSamples::of);
    means_of(&channels, below.interval_s * asked.freq_hz.value())
}

impl Rig<'_> {
    /// Returns the means that the records on these scales are compared with: that of the first
    /// record, and the zero of the channels if it was measured.
    pub(super) fn first_mean(
        &mut self,
        fixture: Fixture,
        asked: &Drawn<'_>,
        mean_a: Amps,
    ) -> FirstMean {
        let [below, above, ..] = asked.waveforms;
        let volts_per_div = [below, above].map(|waveform| waveform.preamble.volts_per_div);
        let by_itself = FirstMean {
            volts_per_div,
            zero_a: mean_a - self.driving.mean_change_a,
            channels_a: None,
        };
        let means = means_of_record(asked).filter(|_| fixture == Fixture::Cell);
        let zeros = if self.driving.bias.is_on() {
            &self.driving.bias.zeros
        } else {
            &self.driving.zeros
        };
        let zero = means.and_then(|means| zeros.on(&means).copied());
        let Some((means, zero)) = means.zip(zero) else {
            return by_itself;
        };
        let zero_a = (zero.volts[1] - zero.volts[0]) / Ohms(self.setup.wiring.shunt.r_ohm);
        let change_a = mean_a - zero_a;
        if change_a.abs() > allowed_since_zero_a(asked.amplitude_a)
            && zero.volts_per_div == means.volts_per_div
            && self.denies_current(asked, change_a, means.volts[2] - zero.volts[2])
        {
            // The zeros of the shunt's channels have changed without a current.
            self.recorder.warning(&format!(
                "the zero of C1 and C2 moved by {:.2} mV since it was measured; C3 shows no direct \
                current",
                1.0e3 * change_a.value() * self.setup.wiring.shunt.r_ohm
            ));
            return by_itself;
        }
        FirstMean {
            channels_a: Some(zero_a),
            ..by_itself
        }
    }

    /// Checks whether C3 shows less than half of a direct current: it measures shunt and return
    /// wire, so a direct current shifts its mean as the sinusoid shifts its samples.
    fn denies_current(&self, asked: &Drawn<'_>, change_a: Amps, moved_v: Volts) -> bool {
        let [below, above, low, _] = asked.waveforms;
        let shunt_v = effective(&difference(above, below));
        let tap_v = effective(&channel_volts(low));
        let below_ohm = Ohms(self.setup.wiring.shunt.r_ohm * tap_v / shunt_v);
        (moved_v / below_ohm).abs() < 0.5 * change_a.abs()
    }

    /// Stores the means of a record of a control as the zero of the channels.
    pub(super) fn keep_zero(&mut self, asked: &Drawn<'_>) {
        if let Some(means) = means_of_record(asked) {
            self.driving.zeros.keep_of_control(means);
        }
    }

    /// Stores the means of a record at a direct current without a sinusoid.
    pub(super) fn keep_bias_zero(&mut self, waveforms: &[Waveform]) {
        self.driving.bias.zeros = Zeros::default();
        if let Some(means) = steady_means(waveforms) {
            self.driving.bias.zeros.keep(means);
        }
    }

    /// Restores a record that this run had taken before its process died.
    pub fn recall(&mut self, fixture: Fixture, capture: &Capture) {
        let codes = capture.codes.each_ref().map(Vec::as_slice);
        let name = format!("{} at {} Hz", fixture_name(fixture), capture.meta.freq_hz);
        let _ = self.driving.records.remember(digest_record(codes), name);
        let channels = [0, 1, 2].map(|slot| ChannelSamples::of_capture(capture, slot));
        let periods_per_sample = capture.meta.interval_s * capture.meta.freq_hz;
        if let Some(means) = means_of(&channels, periods_per_sample)
            && fixture != Fixture::Cell
        {
            self.driving.zeros.keep_of_control(means);
        }
    }

    /// Rejects a record that the scope has already sent in this run.
    pub(super) fn refuse_old_record(
        &mut self,
        fixture: Fixture,
        asked: &Drawn<'_>,
    ) -> Result<(), ExecuteError> {
        let codes = asked.waveforms.each_ref().map(|one| one.codes.as_slice());
        let name = format!("{} at {} Hz", fixture_name(fixture), asked.freq_hz.0);
        let earlier = self.driving.records.remember(digest_record(codes), name);
        earlier.map_or(Ok(()), |earlier| {
            Err(ExecuteError::Repeated {
                freq_hz: asked.freq_hz,
                earlier,
            })
        })
    }
}

impl Executor<'_> {
    /// Records the zero of the channels with the output on at zero, before the first sinusoid.
    /// Skips this if the controls of the run show it.
    pub(super) async fn measure_zero(
        &mut self,
        fixture: Fixture,
        settings: &SweepSettings,
    ) -> Result<(), ExecuteError> {
        let driving = &self.rig.driving;
        let due =
            driving.first_mean.is_none() && driving.zeros.lacks_controls() && !driving.bias.is_on();
        if fixture != Fixture::Cell || !due {
            return Ok(());
        }
        let capabilities = require(&mut self.rig.bench.instruments.scope, "scope")?.capabilities();
        if self.scope.verticals[0].is_none() {
            self.first_ranges(fixture, settings.amplitude_a, &capabilities)
                .await?;
        }
        let waveforms = self.record_steady(fixture, settings.record_points).await?;
        if let Some(means) = steady_means(&waveforms) {
            self.rig.driving.zeros.keep(means);
        }
        Ok(())
    }

    /// Records the channels while no sinusoid is driven.
    pub(super) async fn record_steady(
        &mut self,
        fixture: Fixture,
        record_points: u64,
    ) -> Result<Vec<Waveform>, ExecuteError> {
        let memory_points = self.scope.memory_points.unwrap_or(record_points);
        self.arm(&Frame {
            start_s: Seconds::ZERO,
            span_s: ZERO_S,
            memory_points,
            record_points,
        })
        .await?;
        let phase = if self.rig.driving.bias.is_on() {
            "bias"
        } else {
            "idle"
        };
        self.rig
            .wait_watching(ZERO_S + FILL_S, phase, fixture)
            .await?;
        self.rig.freeze().await?;
        let error = self.rig.bench.error("scope");
        let mut waveforms = Vec::with_capacity(4);
        for channel in 1..=4 {
            let scope = require(&mut self.rig.bench.instruments.scope, "scope")?;
            let waveform = scope.download(channel, record_points).await;
            waveforms.push(waveform.map_err(&error)?);
        }
        if let [below, above, low, high] = waveforms.as_slice() {
            let codes = [below, above, low, high].map(|waveform| waveform.codes.as_slice());
            let name = "the zero of the channels".to_owned();
            let records = &mut self.rig.driving.records;
            let _ = records.remember(digest_record(codes), name);
        }
        // The time base and the trigger are those of this record now.
        self.scope.armed = None;
        Ok(waveforms)
    }
}

/// Returns the means of C1 to C3 in a record without a sinusoid; `None` if a channel clips.
fn steady_means(waveforms: &[Waveform]) -> Option<ChannelMeans> {
    let [below, above, low, _] = waveforms else {
        return None;
    };
    means_of(&[below, above, low].map(ChannelSamples::of), 0.0)
}

/// Returns the effective value of the alternating part.
fn effective(samples: &[f64]) -> f64 {
    let middle = mean(samples);
    let squares: f64 = samples.iter().map(|v| (v - middle).powi(2)).sum();
    (squares / samples.len().max(1) as f64).sqrt()
}
