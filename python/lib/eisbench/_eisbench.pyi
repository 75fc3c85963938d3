"""The half in Rust. What is public is passed on by the package."""

from os import PathLike
from typing import Any, Optional, Sequence, final

import numpy as np
from numpy.typing import NDArray

__version__: str

class EisError(ValueError):
    """A value or a file that is not as expected."""

class FileError(EisError):
    """A file that is not as expected."""

    file: str
    line: Optional[int]
    field: Optional[str]

class InternalError(RuntimeError):
    """A defect of the package."""

@final
class Spectrum:
    """Impedance over frequency of one fixture in one run; points by rising frequency.

    ``freq_hz`` in Hz and ``z_ohm``, complex, in ohm, of one length, in any order; ``sigma_ohm``,
    where it is known, is the standard deviation of the real and of the imaginary part.
    """

    def __new__(
        cls,
        name: str,
        freq_hz: NDArray[np.float64],
        z_ohm: NDArray[np.complex128],
        sigma_ohm: Optional[NDArray[np.float64]] = None,
    ) -> Spectrum: ...
    @property
    def name(self) -> str:
        """Name: of the file, or of the spectrum in its file."""
    @property
    def fixture(self) -> Optional[str]:
        """Object in the jig: ``cell``, ``shunt``, …; None if the file does not state it."""
    @property
    def cell(self) -> Optional[str]:
        """Name of the cell; None if neither file nor name states it."""
    @property
    def repeat(self) -> Optional[str]:
        """Name of the repetition."""
    @property
    def bias_a(self) -> Optional[float]:
        """Direct current superposed, A; charging is positive."""
    @property
    def is_unbiased_cell(self) -> bool:
        """False for a control impedance, and for a spectrum under direct current."""
    @property
    def flagged_hz(self) -> list[float]:
        """Frequencies that the quality gate of the measurement has refused, Hz."""
    @property
    def freq_hz(self) -> NDArray[np.float64]:
        """Frequencies, Hz, rising; shape (n,)."""
    @property
    def z_ohm(self) -> NDArray[np.complex128]:
        """Impedances, ohm; shape (n,)."""
    @property
    def amplitude_a(self) -> NDArray[np.float64]:
        """Amplitudes of the current, A; not a number where unknown; shape (n,)."""
    @property
    def covariance_ohm2(self) -> NDArray[np.float64]:
        """Variance of Re, covariance, variance of Im, ohm²; not a number where unknown; (n, 3)."""
    def __len__(self) -> int: ...
    def between(self, from_hz: float, to_hz: float) -> Spectrum:
        """The points of a band, both ends included, Hz."""
    def without_flagged(self) -> Spectrum:
        """The spectrum without the points that the quality gate has refused."""

@final
class Model:
    def __new__(
        cls, r_ohm: float, branches: Sequence[tuple[float, float]], name: str = "cell"
    ) -> Model: ...
    @staticmethod
    def read(path: str | PathLike[str]) -> Model: ...
    def to_json(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def r_ohm(self) -> float: ...
    @property
    def branches(self) -> list[tuple[float, float]]: ...
    @property
    def dc_resistance_ohm(self) -> float: ...
    @property
    def additions(self) -> list[str]: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def has_ocv(self) -> bool: ...
    def with_ocv(
        self,
        capacity_ah: float,
        soc: NDArray[np.float64],
        ocv_v: NDArray[np.float64],
        slope_v: Optional[NDArray[np.float64]] = None,
    ) -> Model: ...
    def impedance(self, freq_hz: NDArray[np.float64]) -> NDArray[np.complex128]: ...
    def code(self, to: str, low_v: float, high_v: float, temperature_c: float) -> str: ...
    def write_fmu(
        self, path: str | PathLike[str], low_v: float, high_v: float, temperature_c: float
    ) -> Optional[str]: ...
    def sop(
        self,
        duration_s: float,
        soc: float,
        ocv_v: Optional[float],
        series: int,
        parallel: int,
        interconnect_ohm: float,
        low_v: float,
        high_v: float,
        discharge_a: float,
        charge_a: float,
        ambient_c: float,
    ) -> str: ...
    def simulate(self, play: Any) -> tuple[dict[str, NDArray[np.float64]], str]: ...
    def sensitivities(self, play: Any) -> dict[str, NDArray[np.float64]]: ...

def read_spectra(path: str | PathLike[str]) -> tuple[list[Spectrum], list[str]]: ...
def fit_erm(
    spectra: Sequence[Spectrum],
    rc: Optional[int],
    objective: str,
    ocv_slope: Optional[str],
    seed: int,
    starts: int,
    pool: bool,
) -> list[tuple[Optional[str], Optional[str]]]: ...
def fit_circuit(
    spectra: Sequence[Spectrum], wishes: Any, pool: bool
) -> list[tuple[Optional[str], Optional[str]]]: ...
def circuit_impedance(
    circuit: str, values: Sequence[float], freq_hz: NDArray[np.float64]
) -> NDArray[np.complex128]: ...
def assess(spectra: Sequence[Spectrum]) -> str: ...
def spectra_of_columns(
    names: Sequence[str],
    ends: Sequence[int],
    columns: Any,
) -> list[tuple[Optional[Spectrum], Optional[str]]]: ...
def erm_rows(
    given: Sequence[Any],
    rc: Optional[int],
    objective: str,
    ocv_slope: Optional[str],
    seed: int,
    starts: int,
    alone: bool,
) -> dict[str, tuple[str, Any]]: ...
def circuit_rows(given: Sequence[Any], wishes: Any, alone: bool) -> dict[str, tuple[str, Any]]: ...
def validity_rows(
    given: Sequence[Any], drt: bool, alone: bool
) -> dict[str, tuple[str, Any]]: ...
def read_series(
    path: str | PathLike[str], sign: Optional[str] = None
) -> tuple[dict[str, NDArray[np.float64]], list[str]]: ...
def read_capture(path: str | PathLike[str]) -> tuple[dict[str, NDArray[np.int16]], str]: ...
def ocv(
    discharge: Any, charge: Any, dcir_ohm: float, low_v: float, high_v: float, mean: bool
) -> str: ...
def joint(
    spectra: Sequence[Spectrum], series: Any, curve: Any, wishes: Any
) -> tuple[str, Model, list[list[list[float]]]]: ...
def fit_map(
    records: Sequence[Any], sweeps: Sequence[Any], curve: Any, wishes: Any
) -> tuple[str, Model]: ...
@final
class Catalog:
    def __new__(cls, path: str | PathLike[str]) -> Catalog: ...
    @staticmethod
    def scan(path: str | PathLike[str], roots: Sequence[str | PathLike[str]]) -> str: ...
    def runs(self, wanted: Any) -> str: ...
    def spectra(self, wanted: Any) -> str: ...
    def cells(self, wanted: Any) -> str: ...
    def fits(self, wanted: Any) -> str: ...
    def diagnoses(self, wanted: Any) -> str: ...
    def show(self, run: str) -> str: ...
    def ageing(self, wanted: Any, rc: Optional[int]) -> str: ...
    def folders(self, runs: Sequence[str]) -> list[str]: ...

def points_of_files(
    files: Sequence[str | PathLike[str]],
) -> tuple[dict[str, NDArray[np.float64]], list[tuple[int, Optional[str]]]]: ...
def mixed(rows: Any, intervals: bool) -> dict[str, Any]: ...
def t_factor(level: float, freedom: float) -> float: ...
@final
class DataSet:
    def __new__(cls, name: str) -> DataSet: ...
    def add_series(
        self, about: Any, columns: Any, linear: bool, compared_from_s: float
    ) -> None: ...
    def add_spectrum(self, about: Any, spectrum: Spectrum) -> None: ...
    def __len__(self) -> int: ...
    def diagnose(self, model: Model) -> tuple[str, str]: ...

def drt(spectra: Sequence[Spectrum]) -> list[tuple[Optional[str], Optional[str]]]: ...
