//! Errors as Python exceptions. A panic becomes one too: none crosses the border.

use std::panic::{AssertUnwindSafe, catch_unwind};

use analysis::formats::{ErrorPlace, FormatError};
use pyo3::{create_exception, exceptions::PyValueError, prelude::*};

create_exception!(
    eisbench,
    EisError,
    PyValueError,
    "A value or a file that is not as expected."
);
create_exception!(
    eisbench,
    FileError,
    EisError,
    "A file that is not as expected; `file`, `line` and `field` give the place, None if unknown."
);
create_exception!(
    eisbench,
    InternalError,
    pyo3::exceptions::PyRuntimeError,
    "A defect of the package."
);

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("EisError", py.get_type::<EisError>())?;
    module.add("FileError", py.get_type::<FileError>())?;
    module.add("InternalError", py.get_type::<InternalError>())
}

pub(crate) fn refused(error: &dyn std::fmt::Display) -> PyErr {
    EisError::new_err(error.to_string())
}

/// Returns a refused file, with its place.
pub(crate) fn of_file(py: Python<'_>, error: &FormatError) -> PyErr {
    let ErrorPlace { file, line, field } = error.place();
    let raised = FileError::new_err(error.to_string());
    let value = raised.value(py);
    let annotated = value
        .setattr("file", file.display().to_string())
        .and_then(|()| value.setattr("line", line))
        .and_then(|()| value.setattr("field", field));
    annotated.err().unwrap_or(raised)
}

/// Works without the interpreter's lock; a panic becomes an exception.
pub(crate) fn apart<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, String> + Send,
) -> PyResult<T> {
    let done = py.detach(|| catch_unwind(AssertUnwindSafe(work)));
    done.map_err(|panic| defect(panic.as_ref()))?
        .map_err(EisError::new_err)
}

/// Works with the interpreter's lock; a panic becomes an exception.
pub(crate) fn caught<T>(work: impl FnOnce() -> PyResult<T>) -> PyResult<T> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| Err(defect(panic.as_ref())))
}

fn defect(panic: &(dyn std::any::Any + Send)) -> PyErr {
    let text = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("unknown");
    InternalError::new_err(format!("a defect of eisbench, please report it: {text}"))
}

/// Returns the JSON text of a result.
pub(crate) fn json(value: &impl serde::Serialize) -> Result<String, String> {
    serde_json::to_string(value).map_err(|error| error.to_string())
}
