//! The 346 bytes that describe a waveform, little-endian throughout.

use super::{Channel, Transfer, acquisition::Frame};

pub(super) const LENGTH: usize = 346;
/// Codes per division of a 16-bit word.
const CODES_PER_DIV: f32 = 7680.0;
const WORD_BITS: i16 = 16;
/// Time scale of index 0, s/div; one index per step of 1-2-5.
const FIRST_TIME_SCALE: f64 = 200e-12;

/// Content of the descriptor.
pub(super) struct Descriptor<'a> {
    pub(super) frame: &'a Frame,
    pub(super) channel: &'a Channel,
    pub(super) transfer: &'a Transfer,
}

impl Descriptor<'_> {
    /// Returns the descriptor. Points and bytes are those of the whole record, regardless of the
    /// requested part.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the format has single precision and 32-bit counts; records hold at most 10^7 \
        points"
    )]
    pub(super) fn bytes(&self) -> Vec<u8> {
        let (points, interval_s) = self.frame.panel.sampling();
        let points = points as i32;
        let width = if self.transfer.words { 2 } else { 1 };
        let mut bytes = vec![0; LENGTH];
        let mut put = |offset: usize, field: &[u8]| {
            if let Some(place) = bytes.get_mut(offset..offset + field.len()) {
                place.copy_from_slice(field);
            }
        };
        put(0, b"WAVEDESC");
        put(16, b"WAVEACE");
        put(32, &i16::from(self.transfer.words).to_le_bytes());
        put(34, &i16::from(self.transfer.big_endian).to_le_bytes());
        put(36, &(LENGTH as i32).to_le_bytes());
        put(60, &(points * width).to_le_bytes());
        put(76, b"Siglent SDS");
        put(116, &points.to_le_bytes());
        put(132, &(self.transfer.start as i32).to_le_bytes());
        put(136, &(self.transfer.interval as i32).to_le_bytes());
        put(144, &1_i32.to_le_bytes());
        put(148, &1_i32.to_le_bytes());
        put(156, &(self.channel.input_scale() as f32).to_le_bytes());
        put(160, &(self.channel.input_offset() as f32).to_le_bytes());
        put(164, &CODES_PER_DIV.to_le_bytes());
        put(172, &WORD_BITS.to_le_bytes());
        put(176, &(interval_s as f32).to_le_bytes());
        put(180, &self.frame.panel.centre_delay_s().to_le_bytes());
        put(
            324,
            &time_scale_index(self.frame.panel.time_scale).to_le_bytes(),
        );
        put(326, &coupling_index(self.channel.coupling).to_le_bytes());
        put(328, &(self.channel.probe as f32).to_le_bytes());
        put(
            334,
            &i16::from(self.channel.bandwidth == "20M").to_le_bytes(),
        );
        put(344, &(self.transfer.source as i16).to_le_bytes());
        bytes
    }
}

#[expect(clippy::cast_possible_truncation, reason = "some forty steps")]
fn time_scale_index(time_scale: f64) -> i16 {
    // Three steps a decade; 1-2-5 are near enough to thirds of a decade for rounding.
    (3.0 * (time_scale / FIRST_TIME_SCALE).log10()).round() as i16
}

fn coupling_index(coupling: &str) -> i16 {
    match coupling {
        "AC" => 1,
        "GND" => 2,
        _ => 0,
    }
}
