//! Frames of the scope while nothing changes: half a second of four channels, on ranges that are
//! widened until nothing clips.

mod ranges;

use instruments::{
    scope::{Intent, Trigger, Vertical, Waveform},
    units::{Seconds, Volts},
};

use super::Examination;
use bench_core::bench::BenchError;
pub(super) use ranges::Ranges;

/// Length of a frame, s. From this length on a roll keeps the contents of the screen.
const SPAN_S: f64 = 0.5;
/// Wait for a frame, as a multiple of its length.
const WAIT: f64 = 2.5;
const POINTS: u64 = 10_000;
/// Factor by which a range that clips is widened, and greatest number of times.
const WIDER: f64 = 5.0;
const TRIES: usize = 4;

/// Mean and standard deviation of a channel, V; also its scale, V per division.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Level {
    pub(super) mean_v: f64,
    pub(super) sigma_v: f64,
    pub(super) per_div_v: f64,
}

impl Level {
    pub(super) fn of(waveform: &Waveform) -> Self {
        let count = waveform.codes.len().max(1) as f64;
        let mean = waveform
            .codes
            .iter()
            .map(|code| f64::from(*code))
            .sum::<f64>()
            / count;
        let variance = waveform
            .codes
            .iter()
            .map(|code| (f64::from(*code) - mean).powi(2))
            .sum::<f64>()
            / count;
        let preamble = &waveform.preamble;
        let mean_v = mean * preamble.volts_per_code - preamble.offset_v;
        Self {
            mean_v,
            sigma_v: variance.sqrt() * preamble.volts_per_code,
            per_div_v: preamble.volts_per_div,
        }
    }
}

impl Examination<'_> {
    /// Takes a frame of the four channels.
    pub(super) async fn frame(&mut self) -> Result<[Waveform; 4], BenchError> {
        let missing = BenchError::Missing { role: "scope" };
        let error = self.bench.error("scope");
        let Some(scope) = self.bench.instruments.scope.as_mut() else {
            return Err(missing);
        };
        if !self.scope.session {
            scope
                .set(&Intent::Session {
                    memory_points: POINTS,
                })
                .await
                .map_err(&error)?;
            self.scope.session = true;
        }
        let capabilities = scope.capabilities();
        let mut last = None;
        for _ in 0..TRIES {
            for (slot, channel) in (1..=4_u8).enumerate() {
                let per_div_v = self.scope.per_div_v[slot].clamp(
                    capabilities.per_div.0.value(),
                    capabilities.per_div.1.value(),
                );
                if per_div_v != self.scope.applied[slot] {
                    let vertical = Vertical {
                        channel,
                        per_div: Volts(per_div_v),
                        offset: Volts(0.0),
                    };
                    scope
                        .set(&Intent::Vertical(vertical))
                        .await
                        .map_err(&error)?;
                    self.scope.applied[slot] = per_div_v;
                }
            }
            let per_div = capabilities.time_per_div(Seconds(SPAN_S));
            let span_s = per_div.value() * capabilities.horizontal_div;
            for intent in [
                Intent::Timebase(per_div),
                Intent::Trigger(Trigger {
                    channel: 2,
                    level: Volts(0.0),
                }),
                Intent::Roll,
            ] {
                scope.set(&intent).await.map_err(&error)?;
            }
            self.clock.sleep_s(WAIT * span_s).await;
            scope.stop().await.map_err(&error)?;
            let mut waveforms = Vec::with_capacity(4);
            for channel in 1..=4 {
                waveforms.push(scope.download(channel, POINTS).await.map_err(&error)?);
            }
            let clipped: Vec<usize> = (0..4)
                .filter(|slot| waveforms[*slot].clipped_share() > 0.0)
                .collect();
            last = waveforms.try_into().ok();
            if clipped.is_empty() {
                break;
            }
            for slot in clipped {
                self.scope.per_div_v[slot] *= WIDER;
            }
        }
        last.ok_or(missing)
    }
}
