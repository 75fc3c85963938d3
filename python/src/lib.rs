//! The analysis as a Python package. Numbers go over as NumPy arrays, results as the JSON text that
//! the program prints, so that both hold the same numbers. The Python half gives them their shape.

#![expect(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arguments over by value"
)]

mod catalog;
mod diagnosis;
mod error;
mod fit;
mod joint;
mod map;
mod mixed;
mod model;
mod play;
mod series;
mod spectrum;
mod table;

use pyo3::prelude::*;

#[pymodule]
fn _eisbench(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    error::register(module)?;
    module.add_class::<spectrum::Spectrum>()?;
    module.add_class::<model::Model>()?;
    module.add_class::<diagnosis::DataSet>()?;
    module.add_class::<catalog::Catalog>()?;
    module.add_function(wrap_pyfunction!(catalog::points_of_files, module)?)?;
    module.add_function(wrap_pyfunction!(spectrum::read_spectra, module)?)?;
    module.add_function(wrap_pyfunction!(fit::fit_erm, module)?)?;
    module.add_function(wrap_pyfunction!(fit::fit_circuit, module)?)?;
    module.add_function(wrap_pyfunction!(fit::circuit_impedance, module)?)?;
    module.add_function(wrap_pyfunction!(fit::assess, module)?)?;
    module.add_function(wrap_pyfunction!(fit::drt, module)?)?;
    module.add_function(wrap_pyfunction!(table::spectra_of_columns, module)?)?;
    module.add_function(wrap_pyfunction!(table::erm_rows, module)?)?;
    module.add_function(wrap_pyfunction!(table::circuit_rows, module)?)?;
    module.add_function(wrap_pyfunction!(table::validity_rows, module)?)?;
    module.add_function(wrap_pyfunction!(series::read_series, module)?)?;
    module.add_function(wrap_pyfunction!(series::read_capture, module)?)?;
    module.add_function(wrap_pyfunction!(series::ocv, module)?)?;
    module.add_function(wrap_pyfunction!(joint::joint, module)?)?;
    module.add_function(wrap_pyfunction!(map::fit_map, module)?)?;
    module.add_function(wrap_pyfunction!(mixed::mixed, module)?)?;
    module.add_function(wrap_pyfunction!(mixed::t_factor, module)?)?;
    Ok(())
}
