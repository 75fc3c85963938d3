//! Packs of cells that differ.

mod network;
mod scatter;

pub use scatter::{
    BandRow, Draws, Outcome, Percentiles, PlacedCell, Scatter, ScatterSetup, Spread, drawn_cells,
    scatter, scatter_cells,
};
