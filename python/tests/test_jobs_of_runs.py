"""Jobs on the runs of a store: replayed and diagnosed by the program."""

import hashlib
import json
import os
from pathlib import Path

import pytest
from conftest import ROOT

import eisbench as eb
from eisbench import jobs

pa = pytest.importorskip("pyarrow")
from pyarrow import parquet  # noqa: E402


@pytest.fixture(scope="module")
def binary():
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    found = Path(os.environ.get("EIS_BENCH", target / "debug" / "eis-bench"))
    if not found.exists():
        pytest.skip("needs target/debug/eis-bench, which `cargo build` makes")
    os.environ["EIS_BENCH"] = str(found)
    return found


@pytest.fixture(scope="module")
def store(binary, tmp_path_factory):
    """A store of one run of the demo."""
    import subprocess

    run = tmp_path_factory.mktemp("run") / "demo"
    demo = ROOT / "configs/experiments/demo.toml"
    subprocess.run([binary, "run", demo, "--out", run], check=True, capture_output=True)
    folder = tmp_path_factory.mktemp("store")
    (folder / "store.json").write_text('{"format":"eis-bench store","version":1}')
    files = []
    for file in sorted(path for path in run.rglob("*") if path.is_file()):
        data = file.read_bytes()
        sha256 = hashlib.sha256(data).hexdigest()
        into = folder / f"objects/sha256/{sha256[:2]}/{sha256}"
        into.parent.mkdir(parents=True, exist_ok=True)
        into.write_bytes(data)
        files.append({"path": str(file.relative_to(run)), "sha256": sha256, "bytes": len(data)})
    lines = sorted(f"{one['sha256']}  {one['path']}\n" for one in files)
    sha256 = hashlib.sha256("".join(lines).encode()).hexdigest()
    (folder / "runs").mkdir()
    (folder / f"runs/{sha256}.json").write_text(json.dumps({"run_sha256": sha256, "files": files}))
    part = folder / "tables/runs/site=a/bench=demo/date=2026-11-28"
    part.mkdir(parents=True)
    parquet.write_table(pa.table({"run_sha256": [sha256]}), part / f"{sha256}.parquet")
    return folder


def test_captures_are_replayed(store, tmp_path):
    done = jobs.run(jobs.replay(), store, tmp_path / "out")
    (row,) = done.table().to_pylist()
    assert row["error"] is None and row["points"] == row["identical_points"] == 60
    assert row["spectra"] == row["identical_spectra"] == 1 and row["changed_spectra"] == "[]"
    assert row["program"].startswith("eis-bench ") and len(row["input_sha256"]) == 64
    again = jobs.run(jobs.replay(), store, tmp_path / "again", workers=2)
    assert again.sha256 == done.sha256


def test_a_run_is_diagnosed_against_its_own_model(store, tmp_path):
    done = jobs.run(jobs.diagnose(2, base_only=True), store, tmp_path / "out")
    rows = done.table().to_pylist()
    assert len(rows) >= 1 and all(row["run_sha256"] for row in rows)
    # A spectrum alone holds nothing out; the reason is stated, without the place of a worker.
    outcomes = [row["verdict"] or row["error"] for row in rows]
    assert all(outcomes) and not any("/tmp" in text for text in outcomes)
    none = jobs.run(jobs.diagnose(9), store, tmp_path / "none").table().to_pylist()
    assert none[0]["error"] == "model_9rc.json: expected this model in the run, met none"


def test_a_byte_that_was_changed_is_told(store, tmp_path):
    sha256 = json.loads(next((store / "runs").iterdir()).read_text())["files"][0]["sha256"]
    file = store / f"objects/sha256/{sha256[:2]}/{sha256}"
    data = file.read_bytes()
    try:
        file.write_bytes(b"x" + data[1:])
        with pytest.raises(eb.EisError, match=f"expected SHA-256 {sha256}, met"):
            jobs.run(jobs.replay(), store, tmp_path / "out")
    finally:
        file.write_bytes(data)


def test_what_is_no_store_of_runs(store, tmp_path, monkeypatch):
    with pytest.raises(eb.EisError, match="expected a store, for its runs; met dict"):
        jobs.run(jobs.replay(), {}, tmp_path / "out")
    task = jobs.replay()
    monkeypatch.setenv("EIS_BENCH", "/nowhere/eis-bench")
    with pytest.raises(eb.EisError, match="expected the program eis-bench on the path"):
        jobs.replay()
    with pytest.raises(eb.EisError, match="1 of 1 shards cannot be done"):
        jobs.run(task, store, tmp_path / "o2")
