"""Current and voltage over time, captures, the open-circuit voltage, and folders of runs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

from . import _eisbench
from ._eisbench import EisError, Spectrum
from ._model import Model
from ._ocv import Ocv
from ._table import Table, columns_of, numbers

PathLike = Union[str, "os.PathLike[str]"]


class Series(Table):
    """Current and voltage over time: ``time_s``, ``current_a`` (discharge positive),
    ``voltage_v``, ``temperature_c`` where it was measured, and ``net_ah``, the charge that went in
    less that which came out, where the recorder counts it; arrays of one length."""

    def __init__(self, columns: Mapping[str, NDArray[np.float64]], notes: tuple[str, ...] = ()):
        super().__init__(columns)
        self.notes = list(notes)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time, s, rising."""
        return self["time_s"]

    @property
    def current_a(self) -> NDArray[np.float64]:
        """Current, A, discharge positive."""
        return self["current_a"]

    @property
    def voltage_v(self) -> NDArray[np.float64]:
        """Voltage, V."""
        return self["voltage_v"]


def read_series(path: PathLike, sign: Optional[str] = None) -> Series:
    """Reads current and voltage over time of a cycler's file; formats: ``docs/formats.md``.

    ``sign`` says which direction the file counts positive, ``charge`` or ``discharge``; without it
    the voltage and the file's columns decide.

    Raises EisError, which names file, line and column.
    """
    columns, notes = _eisbench.read_series(path, sign)
    return Series(columns, tuple(notes))


class _Columns:
    """A record as the half in Rust takes it."""

    def __init__(self, series: Any) -> None:
        found = columns_of(series, ("time_s", "current_a", "voltage_v"))
        for name in ("time_s", "current_a", "voltage_v"):
            if name not in found:
                raise EisError(f"series: expected a column {name}, met {', '.join(found) or 'none'}")
        self.time_s = numbers("time_s", found["time_s"])
        self.current_a = numbers("current_a", found["current_a"])
        self.voltage_v = numbers("voltage_v", found["voltage_v"])


def record_of(series: Any) -> Any:
    """A record as the half in Rust takes it."""
    return _Columns(series)


def ocv(
    discharge: Any,
    charge: Any = None,
    *,
    dcir_ohm: float = 0.015,
    low_v: float = 2.5,
    high_v: float = 4.2,
    mean: bool = False,
) -> Ocv:
    """Open-circuit voltage of a slow discharge from ``high_v`` to ``low_v``, V, and perhaps of a
    charge; records as :func:`read_series` gives them. The voltage that the current drops is
    compensated with ``dcir_ohm``. With ``mean`` the curve is that between both directions.

    Raises EisError for a record that is too short or does not reach the limits.
    """
    back = None if charge is None else _Columns(charge)
    text = _eisbench.ocv(_Columns(discharge), back, dcir_ohm, low_v, high_v, mean)
    return Ocv(text)


class Fields:
    """Named values as the half in Rust takes them."""

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)


class Diagnosis:
    """A verdict on a model and its data. ``raw`` is ``diagnosis.json`` of the program."""

    def __init__(self, text: str, words: str) -> None:
        self.raw: dict[str, Any] = json.loads(text)
        self._words = words

    @property
    def verdict(self) -> str:
        """``at_noise_floor``, ``named``, ``mostly``, ``ambiguous``, ``unexplained``, ``invalid``, …"""
        return str(self.raw["verdict"])

    @property
    def summary(self) -> str:
        """The verdict in a sentence or more."""
        return str(self.raw["summary"])

    def __str__(self) -> str:
        return self._words

    def __repr__(self) -> str:
        return f"<Diagnosis: {self.verdict}>"


class DataSet:
    """Runs of one cell that a model is held against: spectra and records that begin at rest.

    A record whose ``held_out`` is true is predicted only. Records of one ``repeat_group`` repeat
    each other; the noise comes from them.
    """

    def __init__(self, name: str = "data set") -> None:
        self._set = _eisbench.DataSet(name)

    @classmethod
    def from_frames(
        cls, records: Mapping[str, Any], *, soc: Optional[float] = None, **options: Any
    ) -> DataSet:
        """A data set of records by name: data frames or mappings with ``time_s``, ``current_a``
        (discharge positive) and ``voltage_v``, which begin at rest at ``soc``."""
        made = cls()
        for name, frame in records.items():
            made.add_series(name, frame, soc=soc, **options)
        return made

    def add_series(
        self,
        name: str,
        series: Any,
        *,
        soc: Optional[float] = None,
        ocv_v: Optional[float] = None,
        held_out: bool = False,
        repeat_group: Optional[str] = None,
        start_s: float = 0.0,
        temperature_c: float = 25.0,
        linear: bool = False,
        compared_from_s: float = 0.0,
    ) -> None:
        """Adds a record that begins at rest at ``soc``, 0…1, or at ``ocv_v``, V. The current stays
        until the next row, or goes there along a straight line with ``linear``."""
        about = _about(name, soc, ocv_v, held_out, repeat_group, start_s, temperature_c)
        self._set.add_series(about, _Columns(series), linear, compared_from_s)

    def add_spectrum(
        self,
        spectrum: Spectrum,
        *,
        name: Optional[str] = None,
        soc: Optional[float] = None,
        ocv_v: Optional[float] = None,
        held_out: bool = False,
        repeat_group: Optional[str] = None,
        start_s: float = 0.0,
        temperature_c: float = 25.0,
    ) -> None:
        """Adds a spectrum."""
        name = spectrum.name if name is None else name
        about = _about(name, soc, ocv_v, held_out, repeat_group, start_s, temperature_c)
        self._set.add_spectrum(about, spectrum)

    def __len__(self) -> int:
        return len(self._set)


def _about(
    name: str,
    soc: Optional[float],
    ocv_v: Optional[float],
    held_out: bool,
    repeat_group: Optional[str],
    start_s: float,
    temperature_c: float,
) -> Fields:
    return Fields(
        name=name,
        held_out=held_out,
        repeat_group=name if repeat_group is None else repeat_group,
        start_s=float(start_s),
        temperature_c=float(temperature_c),
        soc=soc,
        ocv_v=ocv_v,
    )


def diagnose(data: DataSet, model: Model) -> Diagnosis:
    """Holds a model with an OCV curve (:meth:`Model.with_ocv`) against data: where they disagree,
    which effect is missing, and whether adding it closes the gap on runs that were held out.

    Raises EisError for a model without OCV or a data set without runs.
    """
    text, words = data._set.diagnose(model._model)
    return Diagnosis(text, words)


class Run:
    """The folder that a run of the bench has left, or one of its parts."""

    def __init__(self, folder: PathLike) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise EisError(f"{self.folder}: expected the folder of a run, met none")
        if not (self.folder / "manifest.json").is_file():
            raise EisError(f"{self.folder}: expected manifest.json in the folder of a run, met none")

    @property
    def manifest(self) -> dict[str, Any]:
        """The manifest of the run, ``manifest.json``."""
        return self._json("manifest.json")

    @property
    def spectra(self) -> list[Spectrum]:
        """Corrected spectra of cells, by the names of their files."""
        files = sorted(self.folder.glob("spectrum*.csv")) + sorted(
            (self.folder / "spectra").glob("*.csv")
        )
        found: list[Spectrum] = []
        for file in files:
            found.extend(_eisbench.read_spectra(file)[0])
        return found

    @property
    def models(self) -> list[Model]:
        """Fitted models, by rising order."""
        return [Model.read(file) for file in sorted(self.folder.glob("model_*rc.json"))]

    @property
    def readings(self) -> Table:
        """Readings of voltage, current and temperature over the run."""
        return _csv(self.folder / "readings.csv")

    @property
    def diagnosis(self) -> Optional[Diagnosis]:
        """The diagnosis that the run made of itself; None where it made none."""
        file = self.folder / "diagnosis" / "diagnosis.json"
        if not file.is_file():
            return None
        text = file.read_text(encoding="utf-8")
        return Diagnosis(text, str(json.loads(text)["summary"]))

    @property
    def captures(self) -> list[Path]:
        """Files of raw captures, for :func:`read_capture`."""
        return sorted((self.folder / "captures").rglob("*.parquet"))

    def _json(self, name: str) -> dict[str, Any]:
        return json.loads((self.folder / name).read_text(encoding="utf-8"))

    def __repr__(self) -> str:
        return f"<Run: {self.folder}>"


def _csv(file: Path) -> Table:
    """A CSV of numbers as the program writes it; a field that is not a number is a text."""
    if not file.is_file():
        raise EisError(f"{file}: expected a table, met no file")
    lines = file.read_text(encoding="utf-8").splitlines()
    names = lines[0].split(",") if lines else []
    fields = [line.split(",", len(names) - 1) for line in lines[1:]]
    columns: dict[str, Any] = {}
    for k, name in enumerate(names):
        texts = [row[k] if k < len(row) else "" for row in fields]
        try:
            columns[name] = np.array([float(text) if text else np.nan for text in texts])
        except ValueError:
            columns[name] = list[Optional[str]](texts)
    return Table(columns)


class Capture(Table):
    """Raw codes of four channels of a scope, ``code_c1`` … ``code_c4``, and their scaling."""

    def __init__(self, columns: Mapping[str, NDArray[np.int16]], about: str) -> None:
        super().__init__({name: np.asarray(codes, np.int64) for name, codes in columns.items()})
        self.about: dict[str, Any] = json.loads(about)

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Bench time of each sample, s."""
        interval_s = float(self.about["interval_s"])
        count = np.arange(self.rows, dtype=np.float64)
        return np.asarray(float(self.about["start_s"]) + interval_s * count, dtype=np.float64)

    def volts(self, channel: int) -> NDArray[np.float64]:
        """Voltage at a channel's input, 1…4, V."""
        if channel not in (1, 2, 3, 4):
            raise EisError(f"channel: expected 1 to 4, met {channel}")
        scale = self.about["channels"][channel - 1]
        codes = self[f"code_c{channel}"]
        return codes * float(scale["volts_per_code"]) - float(scale["offset_v"])


def read_capture(path: PathLike) -> Capture:
    """Reads a raw capture of a run.

    Raises EisError for a file that is damaged or none.
    """
    return Capture(*_eisbench.read_capture(path))
