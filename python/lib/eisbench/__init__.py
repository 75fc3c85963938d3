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
    kk_table,
    read_spectra,
    spectra_of_table,
    zhit,
)
from ._catalog import Ageing, Catalog
from ._client import ApiError, AsyncClient, Client, Event, Job, OutcomeUnknown, Unreachable
from ._delta import to_delta
from ._eisbench import EisError, FileError, InternalError, Spectrum, __version__
from ._hierarchy import Hierarchy, hierarchy
from ._joint import Joint, Pulse, joint
from ._map import CellMap, MapRecord, MapSpectrum, fit_map
from ._model import Model, PowerLimits, Simulation
from ._ocv import Ocv
from ._results import Assessment, Branch, CircuitFit, Drt, ErmFit, Fits, Parameter, Spectra
from ._series import (
    Capture,
    DataSet,
    Diagnosis,
    Run,
    Series,
    diagnose,
    ocv,
    read_capture,
    read_series,
)
from ._table import Table

__all__ = [
    "Ageing",
    "ApiError",
    "Assessment",
    "AsyncClient",
    "Branch",
    "Capture",
    "Catalog",
    "CellMap",
    "CircuitFit",
    "Client",
    "DataSet",
    "Diagnosis",
    "Drt",
    "EisError",
    "ErmFit",
    "Event",
    "FileError",
    "Fits",
    "Hierarchy",
    "InternalError",
    "Job",
    "Joint",
    "MapRecord",
    "MapSpectrum",
    "Model",
    "Ocv",
    "OutcomeUnknown",
    "Parameter",
    "PowerLimits",
    "Pulse",
    "Run",
    "Series",
    "Simulation",
    "Spectra",
    "Spectrum",
    "Table",
    "Unreachable",
    "__version__",
    "assess",
    "circuit_impedance",
    "diagnose",
    "drt",
    "fit_circuit",
    "fit_erm",
    "fit_map",
    "fit_table",
    "hierarchy",
    "joint",
    "kk",
    "kk_table",
    "ocv",
    "read_capture",
    "read_series",
    "read_spectra",
    "spectra_of_table",
    "to_delta",
    "zhit",
]
