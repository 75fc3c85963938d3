"""Open-circuit voltages."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

from ._eisbench import FileError
from ._results import significant, text_table

PathLike = Union[str, "os.PathLike[str]"]


class Ocv:
    """An open-circuit voltage over the state of charge, and what is known of it."""

    def __init__(self, text: str) -> None:
        self.raw: dict[str, Any] = json.loads(text)

    @classmethod
    def read(cls, path: PathLike) -> Ocv:
        """From the file that ``eis-bench ocv --out`` writes, or from its curve alone.

        Raises FileError for a file that is none.
        """
        try:
            raw = json.loads(Path(path).read_text(encoding="utf-8"))
            curve = raw.get("curve", raw)
            for name in ("soc", "ocv_v"):
                np.asarray(curve[name], dtype=np.float64)
            whole = {"sigma_v": float("nan"), **raw, "curve": curve}
            whole["capacity_ah"] = float(raw.get("capacity_ah", curve.get("capacity_ah")))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            expected = "expected capacity_ah and a curve of soc and ocv_v"
            raise FileError(f"{path}: {expected}, met {error}") from error
        return cls(json.dumps(whole))

    @property
    def capacity_ah(self) -> float:
        """Charge between the ends of the discharge, Ah."""
        return float(self.raw["capacity_ah"])

    @property
    def soc(self) -> NDArray[np.float64]:
        """State of charge at the knots, 0…1, rising."""
        return np.array(self.raw["curve"]["soc"], dtype=np.float64)

    @property
    def ocv_v(self) -> NDArray[np.float64]:
        """Open-circuit voltage at the knots, V."""
        return np.array(self.raw["curve"]["ocv_v"], dtype=np.float64)

    @property
    def slope_v(self) -> Optional[NDArray[np.float64]]:
        """Slope of the curve at the knots, V; None if the file does not contain it."""
        slope_v = self.raw["curve"].get("slope_v")
        return None if slope_v is None else np.array(slope_v, dtype=np.float64)

    @property
    def sigma_v(self) -> float:
        """Standard uncertainty by the scatter of the samples, V."""
        return float(self.raw["sigma_v"])

    def __str__(self) -> str:
        rows = [
            ["capacity / Ah", significant(self.capacity_ah)],
            ["from / V", significant(float(self.ocv_v[0]))],
            ["to / V", significant(float(self.ocv_v[-1]))],
            ["1σ / V", significant(self.sigma_v, 2)],
        ]
        return text_table(["figure", "value"], rows)
