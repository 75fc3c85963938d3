//! Sends the newest frame: the preamble as ten numbers, the samples from one point to another.

use super::{Channel, Dho, Panel, SCREEN_POINTS};
use crate::{
    acquisition::Frame,
    number::nr3,
    plant::DigitiseRequest,
    tree::{Answer, Fallible, text},
};

/// Steps of the converter in a division; its calibrated values are spread over 7500 codes.
const STEPS_PER_DIV: f64 = 433.0;
const CODES_PER_DIV: f64 = 7500.0;
const CENTRE: f64 = 32_768.0;
/// Greatest |step| of the converter.
const LAST_STEP: i16 = 1892;

impl Dho {
    /// `1.000E+6`.
    pub(super) fn depth(&self) -> Fallible<Answer> {
        let (points, _) = self.panel.sampling();
        let text_of = nr3(points, 4);
        let (mantissa, exponent) = text_of.split_once("E+").unwrap_or((text_of.as_str(), "0"));
        text(format!(
            "{mantissa}E+{}",
            exponent.trim_start_matches('0').parse::<u32>().unwrap_or(0)
        ))
    }

    fn source_frame(&self) -> Option<(Frame<Panel>, Channel)> {
        let frame = self.acquisition.remembered(self.world.now_s)?;
        // The memory can be read only when nothing is written into it.
        if self.transfer.raw && self.acquisition.running {
            return None;
        }
        let channel = *frame.panel.channels.get(self.transfer.source)?;
        channel.on.then_some((frame, channel))
    }

    /// Returns format, type, points of a page, count, then the scaling of times and codes. The
    /// scales are zero without a record.
    pub(super) fn preamble(&self) -> Fallible<Answer> {
        let (format, kind) = (
            u8::from(self.transfer.words),
            if self.transfer.raw { 2 } else { 0 },
        );
        let Some((frame, channel)) = self.source_frame() else {
            return text(format!("{format},{kind},0,1,0,0,0,0,0,32768"));
        };
        let (points, interval_s) = self.spacing(&frame.panel);
        let step_v = channel.scale / CODES_PER_DIV * if self.transfer.words { 1.0 } else { 256.0 };
        let origin = (channel.offset / step_v).round();
        let reference = if self.transfer.words { 32_768 } else { 128 };
        let page = points.min(1_000.0);
        let start_s = frame.panel.start_after_trigger_s();
        text(format!(
            "{format},{kind},{page},1,{interval_s:.6E},{start_s:.6E},0.000000E-12,{step_v:.6E},{origin},{reference}"
        ))
    }

    /// Returns the points in the chosen mode and their distance, s.
    fn spacing(&self, panel: &Panel) -> (f64, f64) {
        let (points, interval_s) = panel.sampling();
        if self.transfer.raw || points <= SCREEN_POINTS {
            (points, interval_s)
        } else {
            (SCREEN_POINTS, panel.span_s() / SCREEN_POINTS)
        }
    }

    /// A definite block and one line end.
    pub(super) fn data(&self) -> Answer {
        let mut payload = Vec::new();
        if let Some((frame, channel)) = self.source_frame() {
            for step in self.digitise(&frame, &channel) {
                // The origin is a whole number of codes, so that the offset's remainder shows in
                // the codes.
                let code = (CENTRE + f64::from(step) * CODES_PER_DIV / STEPS_PER_DIV)
                    .round()
                    .clamp(0.0, 65_535.0);
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "clamped"
                )]
                let code = code as u16;
                if self.transfer.words {
                    payload.extend(code.to_le_bytes());
                } else {
                    payload.push(code.to_be_bytes()[0]);
                }
            }
        }
        let mut bytes = format!("#9{:09}", payload.len()).into_bytes();
        bytes.extend_from_slice(&payload);
        bytes
    }

    fn digitise(&self, frame: &Frame<Panel>, channel: &Channel) -> Vec<i16> {
        let (points, interval_s) = self.spacing(&frame.panel);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at least 1 and at most 10^7"
        )]
        let last = self.transfer.stop.min(points as u64);
        let first = self.transfer.start - 1;
        let count = usize::try_from(last.saturating_sub(first))
            .unwrap_or(usize::MAX)
            .min(self.page_points);
        if count == 0 {
            return Vec::new();
        }
        let scale = channel.scale / channel.probe;
        // The offset as reported by the preamble, a whole number of codes.
        let code_v = scale / CODES_PER_DIV;
        let offset_v = (channel.offset / channel.probe / code_v).round() * code_v;
        let sign = if channel.inverted { -1 } else { 1 };
        let request = DigitiseRequest {
            channel: u8::try_from(self.transfer.source + 1).unwrap_or(u8::MAX),
            start_s: frame.start_s,
            interval_s,
            first,
            stride: 1,
            count,
            volts_per_div: scale,
            offset_v: f64::from(sign) * offset_v,
            codes_per_volt: STEPS_PER_DIV / scale,
            code_min: -LAST_STEP,
            code_max: LAST_STEP,
            acquisition: frame.number,
        };
        let mut steps = self.world.plant().digitise(self.world.now_s, &request);
        steps.iter_mut().for_each(|step| *step *= sign);
        if channel.coupling == "GND" {
            vec![0; steps.len()]
        } else {
            steps
        }
    }
}
