//! Fetches the samples of a frame: whole, every n-th point, channel by channel.

use instruments_link::link::LinkError;

use super::{Dialect, Intent, Preamble, Waveform};
use crate::{
    exchange::{Exchange, leading_number},
    instrument::Instrument,
};

/// Settings that were chosen for a download before there was a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chosen {
    channel: u8,
    stride: u64,
    in_memory: u64,
}

impl Instrument<dyn Dialect> {
    /// Downloads one channel of the stopped frame, at most about `points` of its points, evenly
    /// spread.
    ///
    /// # Errors
    /// The link's errors; a descriptor that cannot be parsed (zeroed if no frame was ever
    /// completed); an empty page.
    pub async fn download(&mut self, channel: u8, points: u64) -> Result<Waveform, LinkError> {
        let in_memory = self.points_in_memory().await?;
        let stride = stride_of(in_memory, points);
        if self.dialect.capabilities().thins_out {
            let waveform = self
                .transfer(Chosen {
                    channel,
                    stride,
                    in_memory,
                })
                .await?;
            if waveform.codes.len() as u64 >= waveform.preamble.points.div_ceil(stride) {
                return Ok(waveform);
            }
        }
        // No manual states whether the start of a second page counts points of the record or those
        // left by the stride. A record that the scope decimates must therefore fit one page; the
        // rest is decimated here. The length of a page is known only when it arrives; some are
        // shorter than announced.
        let mut whole = self
            .transfer(Chosen {
                channel,
                stride: 1,
                in_memory,
            })
            .await?;
        whole.codes = whole
            .codes
            .into_iter()
            .step_by(usize::try_from(stride).unwrap_or(usize::MAX))
            .collect();
        whole.interval_s *= stride as f64;
        whole.thinned_here = stride > 1;
        Ok(whole)
    }

    /// Selects the channel to download while the scope still acquires, so that only the samples
    /// remain to be requested when it has stopped. Selects nothing on a model that accepts such
    /// settings only when it has stopped, or does not show that it accepted them.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn choose(&mut self, channel: u8, points: u64) -> Result<Option<Chosen>, LinkError> {
        if !self.dialect.capabilities().thins_out {
            return Ok(None);
        }
        match self.try_choose(channel, points).await {
            Ok(chosen) => Ok(Some(chosen)),
            Err(LinkError::ReadBack { .. } | LinkError::Unexpected { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    async fn try_choose(&mut self, channel: u8, points: u64) -> Result<Chosen, LinkError> {
        let in_memory = self.points_in_memory().await?;
        let stride = stride_of(in_memory, points);
        self.set_changes(&Intent::Transfer { channel, stride })
            .await?;
        Ok(Chosen {
            channel,
            stride,
            in_memory,
        })
    }

    /// Downloads the selection that was made before the scope stopped. Starts over if the frame is
    /// shorter than planned, or longer than a page.
    ///
    /// # Errors
    /// As [`Self::download`].
    pub async fn download_chosen(
        &mut self,
        chosen: Chosen,
        points: u64,
    ) -> Result<Waveform, LinkError> {
        let Chosen {
            channel, stride, ..
        } = chosen;
        let waveform = self.chosen(chosen, &[]).await?;
        let whole = waveform.codes.len() as u64 >= waveform.preamble.points.div_ceil(stride);
        let as_chosen = stride_of(waveform.preamble.points, points) == stride && whole;
        if as_chosen {
            Ok(waveform)
        } else {
            self.download(channel, points).await
        }
    }

    async fn points_in_memory(&mut self) -> Result<u64, LinkError> {
        let question = self.dialect.queries().points;
        let answer = self.link.query(question).await?;
        let in_memory = leading_number(&answer).filter(|count| *count >= 1.0);
        in_memory.map(|count| count as u64).ok_or_else(|| {
            LinkError::unexpected(self.link.name(), question, &answer, "a number of points")
        })
    }

    /// Downloads another channel of the frame of which `before` was downloaded just now with as
    /// many points: what both have in common is not sent again.
    ///
    /// # Errors
    /// As [`Self::download`].
    pub async fn download_beside(
        &mut self,
        channel: u8,
        points: u64,
        before: &Waveform,
    ) -> Result<Waveform, LinkError> {
        let in_memory = before.preamble.points;
        let stride = stride_of(in_memory, points);
        let whole = before.codes.len() as u64 >= in_memory.div_ceil(stride);
        if !self.dialect.capabilities().thins_out && stride == 1 {
            return self.download_unchanged(channel, in_memory).await;
        }
        // A record that was decimated here left the scope at another stride and page.
        if !(self.dialect.capabilities().thins_out && whole && !before.thinned_here) {
            return self.download(channel, points).await;
        }
        let script = self.dialect.beside(channel, stride);
        let waveform = self
            .chosen(
                Chosen {
                    channel,
                    stride,
                    in_memory,
                },
                &script,
            )
            .await?;
        // A page that was too short for the channel before, which was thinned out here then, is too
        // short for this one.
        let whole = waveform.codes.len() as u64 >= waveform.preamble.points.div_ceil(stride);
        if whole {
            Ok(waveform)
        } else {
            self.download(channel, points).await
        }
    }

    /// Downloads one channel as [`Self::download`], with the transfer settings of the record before
    /// it, if the memory is as deep and sends every point.
    ///
    /// # Errors
    /// As [`Self::download`].
    pub async fn download_again(
        &mut self,
        channel: u8,
        points: u64,
    ) -> Result<Waveform, LinkError> {
        let in_memory = self.points_in_memory().await?;
        let same =
            self.standing.sent_points == Some(in_memory) && stride_of(in_memory, points) == 1;
        if same {
            self.download_unchanged(channel, in_memory).await
        } else {
            self.download(channel, points).await
        }
    }

    /// Downloads another channel of a record that is sent whole; only the channel is chosen. The
    /// descriptor shows whether format and mode are still those that were set.
    async fn download_unchanged(
        &mut self,
        channel: u8,
        in_memory: u64,
    ) -> Result<Waveform, LinkError> {
        let script = self.dialect.beside(channel, 1);
        let chosen = Chosen {
            channel,
            stride: 1,
            in_memory,
        };
        self.chosen(chosen, &script).await
    }

    /// Downloads one channel with a stride; with a stride above 1, one page of it.
    async fn transfer(&mut self, chosen: Chosen) -> Result<Waveform, LinkError> {
        let script = self.dialect.script(&Intent::Transfer {
            channel: chosen.channel,
            stride: chosen.stride,
        });
        self.chosen(chosen, &script).await
    }

    async fn chosen(&mut self, chosen: Chosen, script: &[Exchange]) -> Result<Waveform, LinkError> {
        let Chosen {
            channel,
            stride,
            in_memory,
        } = chosen;
        self.standing.sent_points = None;
        let transfer = Intent::Transfer { channel, stride };
        self.play_and_keep(script, &transfer).await?;
        let preamble = self.preamble(in_memory).await?;
        let total = preamble.points.div_ceil(stride);
        if !self.dialect.capabilities().thins_out {
            self.set_changes(&Intent::Page { start: 0, total }).await?;
        }
        let mut codes = self.page(0, total).await?;
        while stride == 1 && (codes.len() as u64) < total {
            let start = codes.len() as u64;
            self.set(&Intent::Page { start, total }).await?;
            codes.extend(self.page(start, total).await?);
        }
        codes.truncate(usize::try_from(total).unwrap_or(usize::MAX));
        self.standing.sent_points = Some(in_memory);
        Ok(Waveform {
            channel,
            codes,
            preamble,
            interval_s: preamble.interval_s * stride as f64,
            thinned_here: false,
        })
    }

    /// Reads the descriptor of the chosen channel. If it does not contain the number of points, the
    /// record has the points of the memory.
    async fn preamble(&mut self, in_memory: u64) -> Result<Preamble, LinkError> {
        let query = self.dialect.queries().preamble;
        let (bytes, met) = if self.dialect.preamble_is_text() {
            let text = self.link.query(query).await?;
            (text.clone().into_bytes(), text)
        } else {
            let block = self.link.query_block(query).await?;
            let met = format!("{} bytes", block.len());
            (block, met)
        };
        let preamble = self
            .dialect
            .preamble(&bytes)
            .map_err(|expected| LinkError::unexpected(self.link.name(), query, &met, &expected))?;
        if preamble.points > 0 {
            return Ok(preamble);
        }
        let delay_s = preamble.delay_s + 0.5 * in_memory as f64 * preamble.interval_s;
        Ok(Preamble {
            points: in_memory,
            delay_s,
            ..preamble
        })
    }

    async fn page(&mut self, start: u64, total: u64) -> Result<Vec<i16>, LinkError> {
        let query = self.dialect.queries().data;
        let block = self.link.query_block(query).await?;
        let unexpected = |expected: &str| {
            let met = format!(
                "a page of {} bytes after {start} of {total} points",
                block.len()
            );
            LinkError::unexpected(self.link.name(), query, &met, expected)
        };
        let codes = self
            .dialect
            .codes(&block)
            .map_err(|expected| unexpected(&expected))?;
        if codes.is_empty() {
            Err(unexpected("samples"))
        } else {
            Ok(codes)
        }
    }
}

/// Returns how many points of the memory correspond to one of `points` downloaded points.
fn stride_of(in_memory: u64, points: u64) -> u64 {
    ((in_memory as f64 / points.max(1) as f64).round() as u64).max(1)
}
