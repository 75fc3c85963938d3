//! Packs of cells that differ.

mod links;
mod mapped;
mod network;
mod scatter;
mod thermal;
mod wiring;

pub use links::{Link, LinkLoad, LinkLoads, Links, LinksError};
pub use scatter::{
    BandRow, Draws, LeftMap, Outcome, Percentiles, PlacedCell, Position, Scatter, ScatterSetup,
    SocRange, Spread, Temperatures, drawn_cells, scatter, scatter_cells,
};
pub use thermal::PackThermal;
