//! Values of a map around the state of a cell, as polynomials: a table that is made anew when the cell
//! leaves its piece.
//!
//! In SOC a piece ends at the knots of the map and of the curve, between which resistances are linear
//! and the curve is cubic: the table is exact. In temperature it spans [`BAND_K`] and never crosses a
//! node; values are linear between the exact ones at its ends, to (E/(R·T²)·BAND_K)²/8 of themselves:
//! 1.3·10⁻⁵ for 60 kJ/mol at 0 °C, 4·10⁻⁶ for 35 kJ/mol.

use super::super::law::more;
use super::super::ocv_piece::{LaneCurve, OcvPiece, Row};
use analysis_model::map::{CellMap, Drive, MapValues};
use analysis_model::pack::Pack;

/// Width of a piece in temperature, K.
const BAND_K: f64 = 0.125;
/// Widths below it have one value.
const NARROW: f64 = 1e-9;

/// Where a cell is in its piece.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// Place on the cubic piece of the curve, 0…1.
    pub(super) t: f64,
    /// Temperature above the lower end, K.
    pub(super) u: f64,
}

/// A value over SOC and temperature: c₀ + c₁·t + (c₂ + c₃·t)·u.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Bilinear([f64; 4]);

impl Bilinear {
    /// Returns the value through those at the corners, by SOC in each of two temperatures.
    fn through(piece: &Corners, at: [[f64; 2]; 2]) -> Self {
        let line = |[first, last]: [f64; 2]| {
            let slope = piece.slope(last - first);
            [first - slope * piece.t[0], slope]
        };
        let (cold, warm) = (line(at[0]), line(at[1]));
        let per_k = |side: usize| {
            let apart_k = piece.degc[1] - piece.degc[0];
            if apart_k > NARROW {
                (warm[side] - cold[side]) / apart_k
            } else {
                0.0
            }
        };
        Self([cold[0], cold[1], per_k(0), per_k(1)])
    }

    fn scaled(self, factor: f64) -> Self {
        Self(self.0.map(|c| c * factor))
    }
}

/// [`Bilinear`] of W lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Surface<const W: usize>([Row<W>; 4]);

impl<const W: usize> Surface<W> {
    pub(super) const ZERO: Self = Self([[0.0; W]; 4]);

    fn set(&mut self, l: usize, value: Bilinear) {
        self.0
            .iter_mut()
            .zip(value.0)
            .for_each(|(row, c)| row[l] = c);
    }

    /// Returns the value in a lane; without `HEATED` cells do not leave their temperature.
    #[inline(always)]
    pub(super) fn at<const HEATED: bool>(&self, l: usize, place: Place) -> f64 {
        let [c0, c1, c2, c3] = &self.0;
        let (t, u) = (place.t, place.u);
        let cold = c0[l] + c1[l] * t;
        if HEATED {
            cold + (c2[l] + c3[l] * t) * u
        } else {
            cold
        }
    }
}

/// The pieces in which the lanes are, and the values of the cells there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece<const W: usize> {
    /// The curve with the correction at the lower temperature.
    ocv: OcvPiece<W>,
    /// Change of the OCV with temperature, V/K: c₀ + c₁·t.
    warmer: [Row<W>; 2],
    /// Series resistance without the interconnect, Ω.
    series: Surface<W>,
    /// Voltage of charge transfer of all cells in series, V: c₀ + c₁·u.
    bend: [Row<W>; 2],
    /// Whole resistance of the branches of charge transfer, Ω, and the smallest that counts.
    whole: Surface<W>,
    least: Row<W>,
    /// Both ends in temperature, °C.
    degc: [Row<W>; 2],
}

/// Ends of a piece.
struct Corners {
    soc: [f64; 2],
    t: [f64; 2],
    degc: [f64; 2],
}

impl Corners {
    fn slope(&self, rise: f64) -> f64 {
        let width = self.t[1] - self.t[0];
        if width > NARROW { rise / width } else { 0.0 }
    }
}

/// State of a cell, as far as a map depends on it.
#[derive(Debug, Clone, Copy)]
pub(super) struct ChargeAndWarmth {
    pub(super) soc: f64,
    /// Temperature, °C.
    pub(super) degc: f64,
}

/// A cell of a lane.
#[derive(Debug, Clone, Copy)]
pub(super) struct LaneMap<'a> {
    pub(super) map: &'a CellMap,
    pub(super) curve: LaneCurve<'a>,
    pub(super) pack: Pack,
    /// Whether its temperature may move.
    pub(super) heated: bool,
}

impl<const W: usize> Piece<W> {
    pub(super) fn new() -> Self {
        Self {
            ocv: OcvPiece {
                c: [[0.0; W]; 4],
                origin: [0.0; W],
                rate: [1.0; W],
                from: [0.0; W],
                to: [0.0; W],
            },
            warmer: [[0.0; W]; 2],
            series: Surface::ZERO,
            bend: [[0.0; W]; 2],
            whole: Surface::ZERO,
            least: [1.0; W],
            degc: [[0.0; W]; 2],
        }
    }

    /// Returns whether a state is outside the piece.
    #[inline(always)]
    pub(super) fn is_left<const HEATED: bool>(&self, l: usize, soc: f64, degc: f64) -> bool {
        (soc < self.ocv.from[l])
            | (soc > self.ocv.to[l])
            | (HEATED & ((degc < self.degc[0][l]) | (degc > self.degc[1][l])))
    }

    /// Returns where a state is in the piece.
    #[inline(always)]
    pub(super) fn place(&self, l: usize, soc: f64, degc: f64) -> Place {
        Place {
            t: (soc - self.ocv.origin[l]) * self.ocv.rate[l],
            u: degc - self.degc[0][l],
        }
    }

    /// Returns the OCV, V.
    #[inline(always)]
    pub(super) fn ocv_v<const HEATED: bool>(&self, l: usize, place: Place) -> f64 {
        let (c, t) = (&self.ocv.c, place.t);
        let cold = c[0][l] + t * (c[1][l] + t * (c[2][l] + t * c[3][l]));
        if HEATED {
            cold + (self.warmer[0][l] + self.warmer[1][l] * t) * place.u
        } else {
            cold
        }
    }

    /// Returns the series resistance, Ω.
    #[inline(always)]
    pub(super) fn series_ohm<const HEATED: bool>(&self, l: usize, place: Place) -> f64 {
        self.series.at::<HEATED>(l, place)
    }

    /// Returns twice the exchange current, A.
    #[inline(always)]
    pub(super) fn twice_a<const HEATED: bool>(&self, l: usize, place: Place) -> f64 {
        let bend_v = self.bend[0][l] + self.bend[1][l] * place.u;
        bend_v / more(self.whole.at::<HEATED>(l, place), self.least[l])
    }

    /// Moves a lane to the piece of a state. `branch` takes the surface of each branch; `ohm` is room
    /// for the resistances at the four corners.
    #[cold]
    pub(super) fn find(
        &mut self,
        l: usize,
        cell: LaneMap<'_>,
        state: ChargeAndWarmth,
        ohm: &mut [Vec<f64>; 4],
        mut branch: impl FnMut(usize, BranchValue),
    ) {
        let LaneMap { map, pack, .. } = cell;
        let ChargeAndWarmth { soc, degc } = state;
        self.ocv.set(l, cell.curve, soc);
        let above = map.soc.partition_point(|knot| *knot <= soc);
        if let Some(from) = above.checked_sub(1).and_then(|below| map.soc.get(below)) {
            self.ocv.from[l] = self.ocv.from[l].max(*from);
        }
        if let Some(to) = map.soc.get(above) {
            self.ocv.to[l] = self.ocv.to[l].min(*to);
        }
        let ends = [self.ocv.from[l], self.ocv.to[l]];
        let finite = |end: f64, other: f64| if end.is_finite() { end } else { other };
        let soc = [finite(ends[0], ends[1]), finite(ends[1], ends[0])];
        let band = if cell.heated {
            band(&map.temperature_degc, degc)
        } else {
            [degc; 2]
        };
        let corners = Corners {
            soc,
            t: soc.map(|soc| (soc - self.ocv.origin[l]) * self.ocv.rate[l]),
            degc: band,
        };
        for (side, end) in self.degc.iter_mut().zip(corners.degc) {
            side[l] = end;
        }
        let mut values = [MapValues::default(); 4];
        for (corner, (value, ohm)) in values.iter_mut().zip(ohm.iter_mut()).enumerate() {
            *value = map.values(corners.soc[corner % 2], corners.degc[corner / 2], ohm);
        }
        let through = |of: &dyn Fn(usize) -> f64| {
            Bilinear::through(&corners, [[of(0), of(1)], [of(2), of(3)]])
        };
        let (ratio, series) = (pack.ratio(), f64::from(pack.series));
        self.series
            .set(l, through(&|k| values[k].r_ohm).scaled(ratio));
        let correction = through(&|k| values[k].correction_v).scaled(series).0;
        self.ocv.c[0][l] += correction[0];
        self.ocv.c[1][l] += correction[1];
        self.warmer[0][l] = correction[2];
        self.warmer[1][l] = correction[3];
        // Without the law the value only keeps linear branches beside bent ones linear.
        let bend_v = |degc: f64| {
            map.charge_transfer
                .map_or(1.0, |law| series * law.whole_v(degc))
        };
        let [cold, warm] = corners.degc.map(bend_v);
        let apart_k = corners.degc[1] - corners.degc[0];
        self.bend[0][l] = cold;
        self.bend[1][l] = if apart_k > NARROW {
            (warm - cold) / apart_k
        } else {
            0.0
        };
        let whole = through(&|corner| map.transfer_ohm(&ohm[corner])).scaled(ratio);
        self.whole.set(l, whole);
        self.least[l] = ratio * Drive::LEAST_OHM;
        (0..map.branches.len()).for_each(|k| {
            let value = through(&|corner| ohm[corner][k]).scaled(ratio);
            branch(k, BranchValue(value));
        });
    }
}

/// Resistance of a branch in a piece, Ω.
pub(super) struct BranchValue(Bilinear);

impl BranchValue {
    pub(super) fn put<const W: usize>(self, surface: &mut Surface<W>, l: usize) {
        surface.set(l, self.0);
    }
}

/// Returns the ends of the piece in temperature around a temperature, °C.
fn band(nodes: &[f64], degc: f64) -> [f64; 2] {
    let above = nodes.partition_point(|node| *node <= degc);
    let below = above.checked_sub(1).and_then(|k| nodes.get(k));
    let (mut low, mut high) = (degc - 0.5 * BAND_K, degc + 0.5 * BAND_K);
    if let Some(node) = below.filter(|node| **node > low) {
        (low, high) = (*node, *node + BAND_K);
    }
    if let Some(node) = nodes.get(above).filter(|node| **node < high) {
        (low, high) = (
            below.map_or(*node - BAND_K, |b| b.max(*node - BAND_K)),
            *node,
        );
    }
    [low, high]
}
