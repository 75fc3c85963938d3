"""A catalogue from Python: of a file and of a daemon, with the same answers as the program."""

import csv
import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT

import eisbench as eb

pd = pytest.importorskip("pandas")
CELL = "Molicel P45B"
SERVE = """listen = "127.0.0.1:0"
data = "data"
configs = "."
benches = ["benches/demo.toml"]
"""


@pytest.fixture(scope="module")
def binary():
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    found = Path(os.environ.get("EIS_BENCH", target / "debug" / "eis-bench"))
    if not found.exists():
        pytest.skip("needs target/debug/eis-bench, which `cargo build` makes")
    return found


@pytest.fixture(scope="module")
def daemon(binary, tmp_path_factory):
    """A daemon that has played two runs; its address, and the file of its catalogue."""
    folder = tmp_path_factory.mktemp("catalog") / "configs"
    shutil.copytree(ROOT / "configs", folder)
    (folder / "own.toml").write_text(SERVE)
    words = [binary, "serve", folder / "own.toml"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    process = subprocess.Popen(words, **pipes)
    try:
        address = process.stdout.readline().split()[-1]
        client = eb.Client(address)
        for seed in (1, 2):
            assert client.wait(client.submit("demo", seed=seed)).how == "finished"
        file = next(folder.rglob("catalog.sqlite"))
        for _ in client.watch():
            # The catalogue is brought up to date behind the end of a run.
            break
        yield address, file
    finally:
        process.terminate()
        process.wait(20)


@pytest.fixture(scope="module")
def both(daemon, tmp_path_factory):
    """The catalogue of the daemon, and one of a file that was scanned anew from the same folders."""
    address, file = daemon
    anew = eb.Catalog(tmp_path_factory.mktemp("anew") / "c.sqlite")
    assert anew.scan(file.parent)["runs"] == 2
    served = eb.Catalog(address)
    while len(served.runs()) < 2:
        pass
    return served, anew


def same(left, right, without=()):
    pd.testing.assert_frame_equal(left.drop(columns=list(without)), right.drop(columns=list(without)))


def test_a_file_and_a_daemon_answer_the_same(both, daemon):
    served, anew = both
    # The place of a folder on the machine of a daemon is nobody's business. Who asked for a run
    # the daemon knows, and not the folder.
    without = ["folder", "operator"]
    same(served.runs(), anew.runs(), without)
    same(served.runs(text="demo", most=1), anew.runs(text="demo", most=1), without)
    its_own = eb.Catalog(daemon[1])
    same(served.runs(), its_own.runs(), ["folder"])
    assert set(its_own.runs()["operator"]) != {None}
    same(served.spectra(), anew.spectra())
    same(served.spectra(cell=CELL, verdict="good"), anew.spectra(cell=CELL, verdict="good"))
    same(served.cells(), anew.cells())
    same(served.cells(verdict="good"), anew.cells(verdict="good"))
    same(served.fits(), anew.fits())
    assert (anew.fits()["cells"] == 1).all() and len(anew.fits(trip=True)) == 0
    same(served.diagnoses(), anew.diagnoses())
    shown = [one.show(anew.runs()["run"][0]) for one in both]
    assert shown[0]["fits"] == shown[1]["fits"] and shown[1]["instruments"]
    assert len(anew.spectra(text="demo")) == 2 and len(anew.spectra(text="swollen")) == 0
    same(served.points(), anew.points())
    left, right = (one.ageing(CELL) for one in both)
    assert left.raw == right.raw and len(left) == 2
    same(left.table, right.table)


def test_answers_are_those_of_the_program(both, binary):
    _, anew = both
    file = anew._source.path
    done = subprocess.run([binary, "catalog", "find", file, "--json"], capture_output=True, check=True)
    runs = json.loads(done.stdout)["runs"]
    found = anew.runs()
    assert found["run"].tolist() == [run["run"] for run in runs]
    assert found["cells"].tolist() == [CELL, CELL] and found["verdict"].tolist() == ["good"] * 2
    assert str(found["started"].dtype).endswith("UTC]")
    expected = [run["started_unix_s"] for run in runs]
    np.testing.assert_allclose([t.timestamp() for t in found["started"]], expected, atol=1e-6)


def test_points_are_those_of_the_export(both, binary, tmp_path):
    _, anew = both
    out = tmp_path / "spectra.csv"
    subprocess.run([binary, "catalog", "export", anew._source.path, "--out", out], check=True)
    rows = list(csv.DictReader(out.open()))
    points = anew.points()
    assert len(points) == len(rows) > 0
    assert points["spectrum_id"].tolist() == [row["spectrum_id"] for row in rows]
    for name in ("freq_hz", "z_re_ohm", "z_im_ohm", "sigma_re_ohm", "cov_re_im_ohm2", "ocv_v"):
        assert points[name].tolist() == [float(row[name]) for row in rows], name
    assert eb.fit_table(points, rc=2).rows == 2


def test_conditions(both):
    _, anew = both
    assert len(anew.runs(bench="none")) == 0 and "cells" in anew.runs(bench="none").columns
    assert len(anew.points(bench="none")) == 0
    assert len(anew.runs(from_="2000-01-01", to="2000-01-02T00:00:00Z")) == 0
    assert len(anew.runs(from_="2000-01-01")) == 2
    assert len(anew.spectra(most=1)) == 1
    with pytest.raises(eb.EisError, match="verdict: expected one of good, doubtful"):
        anew.runs(verdict="fine")
    with pytest.raises(eb.EisError, match="from_: expected a time as 2026-11-28"):
        anew.runs(from_="yesterday")
    with pytest.raises(eb.EisError, match="most: expected 1 or more"):
        anew.runs(most=0)
    with pytest.raises(TypeError, match="colour"):
        anew.runs(colour="red")


def test_cells_of_one_name_are_told_apart(both, monkeypatch):
    from eisbench import _catalog

    raw = both[1].ageing(CELL).raw
    mixed = {**raw, "serials": ["S-1", "S-2"]}
    monkeypatch.setattr(_catalog._OfFile, "ageing", lambda self, wanted, rc: mixed)
    with pytest.raises(eb.EisError, match="serial: expected one of S-1, S-2"):
        both[1].ageing(CELL)
    assert len(both[1].ageing(CELL, serial="S-1")) == 2


def test_ageing_is_drawn_with_bars(both):
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.switch_backend("Agg")
    ageing = both[1].ageing(CELL)
    assert ageing.rc in ageing.orders
    assert (ageing.table["r_sigma_ohm"] > 0).all()
    axes = ageing.plot()
    assert [one.get_ylabel() for one in axes][:2] == ["R / mΩ", "DC resistance / mΩ"]
    (bars,) = axes[0].containers
    heights = [abs(part[1][1] - part[0][1]) / 2 for part in bars[2][0].get_segments()]
    np.testing.assert_allclose(heights, 1e3 * ageing.table["r_sigma_ohm"])


def test_a_page_goes_on_where_the_last_has_ended(both, monkeypatch):
    whole = [one.spectra() for one in both]
    monkeypatch.setattr("eisbench._catalog.PAGE", 1)
    for one, expected in zip(both, whole):
        same(one.spectra(), expected)


def test_what_is_no_catalogue(tmp_path):
    with pytest.raises(eb.EisError, match="expected a catalogue, found no file"):
        eb.Catalog(tmp_path / "none.sqlite").runs()
    (tmp_path / "text").write_text("a text, and no database at all")
    with pytest.raises(eb.EisError):
        eb.Catalog(tmp_path / "text").runs()
    with pytest.raises(eb.EisError, match="expected none for a file"):
        eb.Catalog(tmp_path / "c.sqlite", token="t")
    with pytest.raises(eb.EisError, match="a daemon scans its own"):
        eb.Catalog("http://127.0.0.1:1").scan(tmp_path)
    with pytest.raises(eb.EisError, match="expected a folder to scan"):
        eb.Catalog(tmp_path / "c.sqlite").scan(tmp_path / "none")


def test_without_pandas_answers_are_tables(both, monkeypatch):
    import builtins
    import importlib

    def without(name, *words):
        if name == "pandas":
            raise ImportError(name)
        return real(name, *words)

    real = importlib.import_module
    monkeypatch.setattr(importlib, "import_module", without)
    runs = both[1].runs()
    assert isinstance(runs, eb.Table) and runs.rows == 2 and "started_unix_s" in runs
    assert builtins.len(both[1].ageing(CELL).table["r_ohm"]) == 2
