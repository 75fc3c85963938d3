"""Work on the runs of a store by the program: captures replayed, effects diagnosed."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Optional, cast

from .._eisbench import EisError
from .._optional import arrow
from ._columns import MADE, canonical
from ._place import PathLike, Place
from ._shard import Piece, Shard

#: Environment variable of the program's place, where no worker has it on its path.
PROGRAM = "EIS_BENCH"

_REPLAY = {
    "captures": "count",
    "samples": "count",
    "points": "count",
    "identical_points": "count",
    "unfinished_points": "count",
    "spectra": "count",
    "identical_spectra": "count",
    "traces": "count",
    "identical_traces": "count",
    "changed_spectra": "text",
    "recorded_by": "text",
}
_DIAGNOSE = {
    "data_set": "text",
    "cell": "text",
    "run": "text",
    "verdict": "text",
    "effects": "text",
    "eis_only_mv": "number",
    "base_mv": "number",
    "augmented_mv": "number",
    "floor_mv": "number",
    "eis_only_percent": "number",
    "base_percent": "number",
    "augmented_percent": "number",
    "floor_percent": "number",
    "base_chi2": "number",
    "degrees_of_freedom": "number",
    "base_z": "number",
    "augmented_chi2": "number",
    "augmented_z": "number",
    "summary": "text",
    "warning_codes": "text",
    "warnings": "text",
}
_COLUMNS = {"replay": _REPLAY, "diagnose": _DIAGNOSE}


@dataclass(frozen=True)
class RunTask:
    """Work on each run of a store by the program ``eis-bench``: its kind, and its parameters as
    canonical JSON. :func:`replay` and :func:`diagnose` make one."""

    kind: str
    parameters: str
    program: str

    #: The column that names a row.
    key = "row_id"

    @property
    def sha256(self) -> str:
        """SHA-256 of kind, parameters and version of the program."""
        identity = {"task": self.kind, "program": self.program, "parameters": self.parameters}
        return hashlib.sha256(canonical(identity).encode()).hexdigest()

    def shards(self, place: Place, files: list[str], _rows: int) -> list[Shard]:
        """One shard for each run."""
        pieces = [Piece(f, hashlib.sha256(place.read(f)).hexdigest(), 0, 1) for f in files]
        return [Shard.of(self, (piece,)) for piece in pieces]

    def results(self, place: Place, shard: Shard) -> Any:
        """The results of the run of a shard."""
        version = version_of()
        if version != self.program:
            raise EisError(f"{_program()}: expected {self.program}, met {version}")
        (piece,) = shard.pieces
        with tempfile.TemporaryDirectory() as aside:
            folder = Path(aside) / "run"
            run = restore(place, piece.file, folder)
            rows = self._rows(folder)
        return self._table(run, rows, piece.sha256)

    def schema(self) -> Any:
        """The Arrow schema of the results."""
        return self._table("", [], "").schema

    def _rows(self, folder: Path) -> list[dict[str, Any]]:
        parameters: dict[str, Any] = json.loads(self.parameters)
        if self.kind == "replay":
            return _replayed(folder)
        return _diagnosed(folder, int(parameters["rc"]), bool(parameters["base_only"]))

    def _table(self, run: str, rows: list[dict[str, Any]], input_sha256: str) -> Any:
        pa = arrow()
        kinds = {"count": pa.int64(), "number": pa.float64(), "text": pa.string()}
        columns: dict[str, Any] = {
            "row_id": pa.array([f"{run}/{k:04}" for k in range(len(rows))], pa.string()),
            "run_sha256": pa.array([run] * len(rows), pa.string()),
        }
        for name, kind in {**_COLUMNS[self.kind], "error": "text"}.items():
            columns[name] = pa.array([_value(kind, row.get(name)) for row in rows], kinds[kind])
        made = [self.kind, self.program, self.parameters, self.sha256, input_sha256]
        for name, text in zip(MADE, made):
            columns[name] = pa.array([text] * len(rows), pa.string())
        return pa.table(columns)


def replay() -> RunTask:
    """Sends the captures of each run through the present analysis; one row for each run, with the
    numbers of points and spectra that are as they were (``docs/replay.md``)."""
    return RunTask("replay", canonical({}), version_of())


def diagnose(rc: int = 4, *, base_only: bool = False) -> RunTask:
    """Diagnoses each run against its own model with ``rc`` RC pairs; rows as in ``eis-bench diagnose
    --table`` (``docs/tables.md``). ``base_only`` looks for no effect, which takes a small part of the
    time."""
    return RunTask("diagnose", canonical({"rc": rc, "base_only": base_only}), version_of())


def _program() -> str:
    return os.environ.get(PROGRAM, "eis-bench")


def version_of() -> str:
    """Name and version of the program on this machine.

    Raises EisError where there is none.
    """
    return _play("--version").stdout.strip()


def _play(*words: PathLike) -> subprocess.CompletedProcess[str]:
    try:
        command = [_program(), *(os.fspath(word) for word in words)]
        return subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        expected = f"expected the program eis-bench on the path or in {PROGRAM}"
        raise EisError(f"{_program()}: {expected}: {error}") from None


def restore(place: Place, name: str, folder: Path) -> str:
    """Writes the files of a run of a store into a folder, each held against its hash; the run."""
    where = place.at(name)
    try:
        record: dict[str, Any] = json.loads(place.read(name))
        run, files = str(record["run_sha256"]), cast("list[dict[str, Any]]", record["files"])
        named = [(str(one["path"]), str(one["sha256"])) for one in files]
    except (ValueError, KeyError, TypeError) as error:
        raise EisError(f"{where}: expected the list of a run: {error!r}") from None
    for path, sha256 in named:
        parts = PurePosixPath(path).parts
        if path.startswith("/") or ".." in parts:
            raise EisError(f"{where}: expected a file in the folder of the run, met {path!r}")
        data = place.read(f"objects/sha256/{sha256[:2]}/{sha256}")
        met = hashlib.sha256(data).hexdigest()
        if met != sha256:
            raise EisError(f"{where}, {path}: expected SHA-256 {sha256}, met {met}")
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)
    return run


def _replayed(folder: Path) -> list[dict[str, Any]]:
    done = _play("replay", folder, "--json")
    try:
        (record,) = json.loads(done.stdout)
    except ValueError:
        return [{"error": _reason(done, folder)}]
    return [{**record, "changed_spectra": canonical(record["changed_spectra"]), "error": None}]


def _diagnosed(folder: Path, rc: int, base_only: bool) -> list[dict[str, Any]]:
    model, table = folder / f"model_{rc}rc.json", folder.parent / "table.csv"
    if not model.is_file():
        return [{"error": f"{model.name}: expected this model in the run, met none"}]
    more = ["--base-only"] if base_only else []
    done = _play("diagnose", folder, "--model", model, "--table", table, *more)
    if not table.is_file():
        return [{"error": _reason(done, folder)}]
    with table.open(encoding="utf-8", newline="") as stream:
        rows = [{k: v or None for k, v in row.items()} for row in csv.DictReader(stream)]
    for row in rows:
        row["error"] = _without(row["error"], folder)
    return rows


def _reason(done: subprocess.CompletedProcess[str], folder: Path) -> Optional[str]:
    lines = done.stderr.strip().splitlines()
    reason = lines[-1] if lines else f"ended with code {done.returncode}"
    return _without(reason, folder)


def _without(text: Optional[str], folder: Path) -> Optional[str]:
    """A reason without the place of a folder that is gone, and that no two workers share."""
    return None if text is None else text.replace(f"{folder}/", "").replace(str(folder), "run")


def _value(kind: str, value: Any) -> Any:
    if value is None or kind == "text":
        return value
    return int(value) if kind == "count" else float(value)
