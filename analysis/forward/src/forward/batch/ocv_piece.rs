//! The cubic piece of an OCV curve in which each lane is.

use analysis_model::ocv::OcvCurve;

/// One number per cell.
pub(super) type Row<const W: usize> = [f64; W];

/// A cubic piece of the OCV at the terminals: c₀ + t(c₁ + t(c₂ + t·c₃)), t = (SOC − origin)·rate.
#[derive(Debug, Clone, Copy)]
pub(super) struct OcvPiece<const W: usize> {
    pub(super) c: [Row<W>; 4],
    pub(super) origin: Row<W>,
    pub(super) rate: Row<W>,
    /// The SOC for which the piece is meant.
    pub(super) from: Row<W>,
    pub(super) to: Row<W>,
}

/// The OCV curve of a lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneCurve<'a> {
    /// Curve of one cell.
    pub(super) curve: &'a OcvCurve,
    /// Cells in series.
    pub(super) series: f64,
}

impl<const W: usize> OcvPiece<W> {
    pub(super) fn set(&mut self, l: usize, lane: LaneCurve<'_>, soc: f64) {
        let LaneCurve { curve, series } = lane;
        let last = curve.soc.len() - 1;
        let (first_soc, last_soc) = (curve.soc[0], curve.soc[last]);
        if soc <= first_soc || soc >= last_soc {
            let low = soc <= first_soc;
            let (k, from, to) = if low {
                (0, f64::NEG_INFINITY, first_soc)
            } else {
                (last, last_soc, f64::INFINITY)
            };
            self.put(
                l,
                [curve.ocv_v[k] * series, curve.slope_v[k] * series, 0.0, 0.0],
            );
            (self.origin[l], self.rate[l]) = (curve.soc[k], 1.0);
            (self.from[l], self.to[l]) = (from, to);
            return;
        }
        let k = curve.soc.partition_point(|z| *z <= soc).clamp(1, last) - 1;
        let h = curve.soc[k + 1] - curve.soc[k];
        let (m0, m1) = (h * curve.slope_v[k], h * curve.slope_v[k + 1]);
        let rise = curve.ocv_v[k + 1] - curve.ocv_v[k];
        let c = [
            curve.ocv_v[k],
            m0,
            3.0 * rise - 2.0 * m0 - m1,
            m0 + m1 - 2.0 * rise,
        ];
        self.put(l, c.map(|c| c * series));
        (self.origin[l], self.rate[l]) = (curve.soc[k], 1.0 / h);
        (self.from[l], self.to[l]) = (curve.soc[k], curve.soc[k + 1]);
    }

    fn put(&mut self, l: usize, c: [f64; 4]) {
        self.c.iter_mut().zip(c).for_each(|(row, c)| row[l] = c);
    }
}
