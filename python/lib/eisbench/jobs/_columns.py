"""Columns that all tables of results have."""

from __future__ import annotations

import json
from typing import Any

#: Columns of the input that stand in the results too, each with its kind; null where the input does
#: not have them. They are of the whole spectrum: its first point's.
CARRIED = {
    "run_sha256": "text",
    "run": "text",
    "cell": "text",
    "serial": "text",
    "batch": "text",
    "chemistry": "text",
    "site": "text",
    "bench": "text",
    "started_unix_s": "number",
    "temperature_c": "number",
    "ocv_v": "number",
}
#: Columns that state how a row was made.
MADE = ("task", "program", "parameters", "task_sha256", "input_sha256")


def canonical(value: Any) -> str:
    """The one JSON text of a value: names in order, no blanks."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
