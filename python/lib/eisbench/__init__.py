"""Impedance spectra of batteries to models that can be trusted.

The numbers are those of the program ``eis-bench``, bit for bit, because it is the same code.

>>> import eisbench as eb
>>> fit = eb.fit_erm(eb.read_spectra("cell.csv"), rc=2, pool=True)  # doctest: +SKIP
>>> print(fit)  # doctest: +SKIP

Every name says its unit: ``freq_hz``, ``z_ohm``, ``tau_s``. Currents of simulations are positive
for discharge.
"""

from ._api import (
    assess,
    circuit_impedance,
    drt,
    fit_circuit,
    fit_erm,
    fit_table,
    kk,
    read_spectra,
    spectra_of_table,
    zhit,
)
from ._eisbench import EisError, FileError, InternalError, Spectrum, __version__
from ._model import Model, Simulation
from ._results import Assessment, Branch, CircuitFit, Drt, ErmFit, Fits, Parameter, Spectra

__all__ = [
    "Assessment",
    "Branch",
    "CircuitFit",
    "Drt",
    "EisError",
    "ErmFit",
    "FileError",
    "Fits",
    "InternalError",
    "Model",
    "Parameter",
    "Simulation",
    "Spectra",
    "Spectrum",
    "__version__",
    "assess",
    "circuit_impedance",
    "drt",
    "fit_circuit",
    "fit_erm",
    "fit_table",
    "kk",
    "read_spectra",
    "spectra_of_table",
    "zhit",
]
