//! Maps of a cell: the data of a fit from data sets and run folders ([`data`]), its files ([`files`]),
//! its error in one line ([`headline`]), the current of a cell under the loads of a pack ([`loads`]), and
//! the experiment that measures chosen points ([`base`]), of those that a bench offers ([`offers`]).

pub mod base;
pub mod data;
mod edit;
pub mod files;
pub mod headline;
pub mod loads;
pub mod offers;
