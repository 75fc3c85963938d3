"""Models of a cell, and their simulation."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional, Union, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._eisbench import EisError
from ._eisbench import Model as _Model
from ._ocv import Ocv
from ._results import Branch, ErmFit, significant, text_table
from ._table import Table


class Simulation:
    """A simulated run. Columns are arrays of one length; discharge is positive."""

    def __init__(self, columns: dict[str, NDArray[np.float64]], summary: str) -> None:
        self.columns = columns
        self.summary: dict[str, Any] = json.loads(summary)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        return self.columns[name]

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Time, s."""
        return self.columns["time_s"]

    @property
    def current_a(self) -> NDArray[np.float64]:
        """Current, A, discharge positive."""
        return self.columns["current_a"]

    @property
    def ccv_v(self) -> NDArray[np.float64]:
        """Voltage at the terminals, V."""
        return self.columns["ccv_v"]

    @property
    def soc(self) -> NDArray[np.float64]:
        """State of charge, 0…1; not a number for a constant open-circuit voltage."""
        return self.columns["soc"]

    def to_pandas(self) -> Any:
        """The columns as a pandas data frame."""
        import pandas

        return pandas.DataFrame(self.columns)

    def __str__(self) -> str:
        keys = ("min_ccv_v", "max_ccv_v", "margin_low_v", "energy_j", "charge_c", "heat_j")
        rows = [[key, significant(self.summary[key])] for key in keys]
        rows.append(["feasible", str(self.summary["feasible"])])
        return text_table(["figure", "value"], rows)

    def plot(self, axes: Any = None) -> Any:
        """Voltage and current over time; gives matplotlib axes."""
        from ._plot import run

        return run(self, axes)


class _Play:
    """A profile and the options of its simulation, as the Rust part takes them. By default the
    simulation stops if the power cannot be delivered, and has no limits of the voltage."""

    beyond, fraction, ambient_c = "stop", 0.95, 25.0
    low_v, high_v = 0.0, float("inf")

    def __init__(
        self,
        time_s: ArrayLike,
        current_a: Optional[ArrayLike],
        power_w: Optional[ArrayLike],
        **options: Any,
    ) -> None:
        if (current_a is None) == (power_w is None):
            raise EisError("simulate: expected one of current_a and power_w, met both or neither")
        self.demand, value = ("power", power_w) if current_a is None else ("current", current_a)
        self.time_s = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        self.value = np.atleast_1d(np.asarray(value, dtype=np.float64))
        self.__dict__.update(options)


@dataclass(frozen=True)
class PowerLimits:
    """Powers that can be held, W at the terminals: discharge zero or more, charge zero or less, and
    what ends them."""

    discharge_w: float
    charge_w: float
    discharge_limited_by: str
    charge_limited_by: str


class Model:
    """A cell's model: a series resistance and RC branches, with additions where a file holds some.

    ``branches`` are pairs of ohm and farad.
    """

    def __init__(
        self, r_ohm: float, branches: Iterable[tuple[float, float]] = (), name: str = "cell"
    ) -> None:
        self._model = _Model(r_ohm, list(branches), name)

    @classmethod
    def of(cls, model: _Model) -> Model:
        """Around the half in Rust."""
        made = cls.__new__(cls)
        made._model = model
        return made

    @classmethod
    def read(cls, path: Union[str, "os.PathLike[str]"]) -> Model:
        """From the file of a model, of a typed model or of a fitted circuit."""
        return cls.of(_Model.read(path))

    def write(self, path: Union[str, "os.PathLike[str]"]) -> None:
        """Writes a file that :meth:`read` and the program (``--model``) take."""
        Path(path).write_text(self._model.to_json(), encoding="utf-8")

    @classmethod
    def from_fit(cls, fit: ErmFit) -> Model:
        """From a fit."""
        return cls(fit.r_ohm, [(b.r_ohm, b.c_f) for b in fit.branches], "+".join(fit.spectra))

    @property
    def name(self) -> str:
        """Name."""
        return self._model.name

    @property
    def r_ohm(self) -> float:
        """Series resistance, ohm."""
        return self._model.r_ohm

    @property
    def branches(self) -> list[Branch]:
        """Branches by rising time constant."""
        return [Branch(r_ohm, c_f) for r_ohm, c_f in self._model.branches]

    @property
    def dc_resistance_ohm(self) -> float:
        """Resistance at zero frequency, ohm."""
        return self._model.dc_resistance_ohm

    @property
    def additions(self) -> list[str]:
        """Names of the effects that were added."""
        return self._model.additions

    @property
    def notes(self) -> list[str]:
        """What is to be known of the model, in sentences."""
        return self._model.notes

    @overload
    def with_ocv(self, capacity_ah: Ocv) -> Model: ...
    @overload
    def with_ocv(self, capacity_ah: float, soc: ArrayLike, ocv_v: ArrayLike) -> Model: ...
    def with_ocv(
        self, capacity_ah: Union[float, Ocv], soc: ArrayLike = (), ocv_v: ArrayLike = ()
    ) -> Model:
        """The same with an open-circuit voltage: an :class:`Ocv`, or a capacity in Ah and knots of
        state of charge, 0…1, and V.
        """
        if isinstance(capacity_ah, Ocv):
            curve = capacity_ah
            knots = (curve.soc, curve.ocv_v, curve.slope_v)
            return self.of(self._model.with_ocv(curve.capacity_ah, *knots))
        lists = (np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in (soc, ocv_v))
        return self.of(self._model.with_ocv(capacity_ah, *lists))

    def impedance(self, freq_hz: ArrayLike) -> NDArray[np.complex128]:
        """Impedance of the resistance and the branches, ohm, at frequencies in Hz. Additions, which
        a simulation plays, are not in it.
        """
        return self._model.impedance(np.atleast_1d(np.asarray(freq_hz, dtype=np.float64)))

    def simulate(
        self,
        time_s: ArrayLike,
        *,
        current_a: Optional[ArrayLike] = None,
        power_w: Optional[ArrayLike] = None,
        soc: Optional[float] = None,
        ocv_v: Optional[float] = None,
        ambient_c: float = 25.0,
        linear: bool = False,
        series: int = 1,
        parallel: int = 1,
        interconnect_ohm: float = 0.0,
        beyond: str = "stop",
        fraction: float = 0.95,
        window_v: tuple[float, float] = (2.5, 4.2),
        max_step_s: float = float("inf"),
    ) -> Simulation:
        """Simulates the cell, or a pack of ``series`` times ``parallel`` of it, from rest.

        Either ``current_a`` or ``power_w`` is given, at the terminals, discharge positive, one
        value for each of ``time_s``; it holds until the next time, or goes there along a line
        (``linear``). ``soc`` is the state of charge at the start, which a model with an
        open-circuit voltage needs; ``ocv_v`` is a constant voltage in its place.
        ``ambient_c`` is the temperature of the surroundings, and of the cell at the start, °C, for a
        model with a map; the result then has ``temperature_c``, and ``cell_sigma_v``, the standard
        deviation of the cell's voltage, if the map states its error. ``beyond`` says what happens
        where more power is asked for than there is: ``stop``, ``clamp`` or ``extrapolate`` along
        the tangent from ``fraction`` of it. ``max_step_s`` makes the rows of the result denser; it
        does not change them.

        Raises EisError for a profile that cannot be and a model without open-circuit voltage.
        """
        play = _Play(
            time_s,
            current_a,
            power_w,
            soc=soc,
            ocv_v=ocv_v,
            ambient_c=ambient_c,
            linear=linear,
            series=series,
            parallel=parallel,
            interconnect_ohm=interconnect_ohm,
            beyond=beyond,
            fraction=fraction,
            low_v=window_v[0],
            high_v=window_v[1],
            max_step_s=max_step_s,
        )
        return Simulation(*self._model.simulate(play))

    def sensitivities(
        self,
        time_s: ArrayLike,
        *,
        current_a: Optional[ArrayLike] = None,
        power_w: Optional[ArrayLike] = None,
        soc: Optional[float] = None,
        ocv_v: Optional[float] = None,
        linear: bool = False,
        series: int = 1,
        parallel: int = 1,
        interconnect_ohm: float = 0.0,
        max_step_s: float = 0.1,
    ) -> Table:
        """The voltage at the terminals and its derivatives, exact to the step; the profile is given
        as to :meth:`simulate`.

        Columns: ``time_s``, s; ``ccv_v``, V; the derivative by a common factor of the whole profile
        (``demand``, V), by the parameters of the cell or pack (``R``, ``R1``, …, V per ohm; ``C1``,
        …, V per farad), by an offset of the open-circuit voltage at the terminals (``ocv_v``), and
        by the state of charge at the start (``soc``, V). Both sides of a jump have a row.

        Raises EisError as :meth:`simulate`, and for a model with additions.
        """
        play = _Play(
            time_s,
            current_a,
            power_w,
            soc=soc,
            ocv_v=ocv_v,
            linear=linear,
            series=series,
            parallel=parallel,
            interconnect_ohm=interconnect_ohm,
            max_step_s=max_step_s,
        )
        return Table(self._model.sensitivities(play))

    def sop(
        self,
        duration_s: float,
        *,
        soc: float = 0.5,
        ocv_v: Optional[float] = None,
        series: int = 1,
        parallel: int = 1,
        interconnect_ohm: float = 0.0,
        window_v: tuple[float, float] = (2.5, 4.2),
        discharge_a: float = float("inf"),
        charge_a: float = float("inf"),
        ambient_c: float = 25.0,
    ) -> PowerLimits:
        """The largest powers that the cell, or a pack of ``series`` times ``parallel`` of it, can
        hold for ``duration_s``, s, from rest at ``soc``, within ``window_v``, V of a cell, and
        the currents of a cell, A; a model with a map is at ``ambient_c``, °C.

        Raises EisError for a model without open-circuit voltage and for limits that cannot be.
        """
        text = self._model.sop(
            duration_s,
            soc,
            ocv_v,
            series,
            parallel,
            interconnect_ohm,
            window_v[0],
            window_v[1],
            discharge_a,
            charge_a,
            ambient_c,
        )
        discharge, charge = json.loads(text)
        return PowerLimits(
            float(discharge["power_w"]),
            float(charge["power_w"]),
            str(discharge["limited_by"]),
            str(charge["limited_by"]),
        )

    def code(
        self,
        to: str,
        *,
        window_v: tuple[float, float] = (2.5, 4.2),
        temperature_c: float = 25.0,
    ) -> str:
        """The model as the text of a C header (``c``), of a Python module for PyBaMM (``pybamm``)
        or CasADi (``casadi``), of a script for Simscape (``simscape``) or of a package for
        Modelica (``modelica``), as ``eis-bench convert`` writes it.

        Raises EisError for a model without open-circuit voltage, and for additions that the format
        cannot hold.
        """
        return self._model.code(to, window_v[0], window_v[1], temperature_c)

    def write_fmu(
        self,
        path: Union[str, os.PathLike[str]],
        *,
        window_v: tuple[float, float] = (2.5, 4.2),
        temperature_c: float = 25.0,
    ) -> None:
        """Writes the model as an FMU (FMI 3.0, model exchange and co-simulation), as ``eis-bench
        convert --to fmu`` does: with its sources and a library for Linux on x86-64. Warns if the
        library cannot be compiled here.

        Raises EisError for a model without open-circuit voltage and for a path that cannot be written.
        """
        reason = self._model.write_fmu(path, window_v[0], window_v[1], temperature_c)
        if reason is not None:
            warnings.warn(f"{path} holds sources only: {reason}", stacklevel=2)

    def to_casadi(
        self, function: str = "step", *, window_v: tuple[float, float] = (2.5, 4.2), **options: int
    ) -> Any:
        """A ``casadi.Function`` with derivatives. Needs CasADi.

        ``step``: (state, current in A, step in s) → (next state, voltage at the terminals in V).
        ``look``: (state, power in W, P₀) → (voltage at the terminals in V, current in A, margins in V
        above the lower and below the upper end of ``window_v``). ``power_step``: (state, power in W,
        step in s, P₀) → (next state, and those of ``look`` at the start of the step).

        P₀ is the share of the most power from which the voltage follows its tangent, by default
        0.95. ``order``, 1 or 2, is the number of continuous derivatives there, and ``parts`` the
        number of equal parts of a ``power_step``. A model with a map has the temperature in °C as
        second state, and that of the surroundings as last input of the steps.

        Raises EisError for another function, and as :meth:`code`.
        """
        if function not in ("step", "look", "power_step"):
            expected = "expected step, look or power_step"
            raise EisError(f"to_casadi: {expected}, met {function!r}")
        return self._module("casadi", window_v=window_v)[function](**options)

    def to_pybamm(self, **options: Any) -> Any:
        """``pybamm.ParameterValues`` for ``pybamm.equivalent_circuit.Thevenin``. Needs PyBaMM."""
        import importlib

        values: Any = self._module("pybamm", **options)["get_parameter_values"]()
        return importlib.import_module("pybamm").ParameterValues(values)

    def _module(self, to: str, **options: Any) -> dict[str, Any]:
        """What the module that :meth:`code` writes defines."""
        names: dict[str, Any] = {"__name__": f"eisbench_{to}"}
        exec(compile(self.code(to, **options), f"<{self.name} for {to}>", "exec"), names)
        return names

    def __repr__(self) -> str:
        added = f" + {', '.join(self.additions)}" if self.additions else ""
        dc = significant(1e3 * self.dc_resistance_ohm, 4)
        return f"<Model {self.name!r}: {len(self.branches)} RC{added}, {dc} mΩ>"
