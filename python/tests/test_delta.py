"""A store as Delta tables: every run once, whoever writes and whatever is killed."""

import threading

import pytest
from test_jobs import exists, long_form, write_store

import eisbench as eb
from eisbench._delta import Written

delta = pytest.importorskip("deltalake")
pa = pytest.importorskip("pyarrow")
from pyarrow import parquet  # noqa: E402

ONLY = ("spectra",)
NONE = {name: Written() for name in ("runs", "spectra", "fits", "diagnoses")}


def rows(address):
    return delta.DeltaTable(str(address)).to_pyarrow_dataset().to_table()


def test_each_run_is_there_once(tmp_path):
    store, out = write_store(tmp_path / "store", runs=4), tmp_path / "delta"
    assert eb.to_delta(store, out) == {**NONE, "spectra": Written(4)}
    assert eb.to_delta(store, out, tables=ONLY) == {"spectra": Written()}
    write_store(store, runs=6)
    assert eb.to_delta(store, out, tables=ONLY) == {"spectra": Written(2)}
    table = rows(out / "spectra")
    assert table.num_rows == 6 * 10 * 16
    assert len(set(table["run_sha256"].to_pylist())) == 6
    assert set(table["site"].to_pylist()) == {"a/b"}
    assert set(table["date"].to_pylist()) == {"2026-11-01", "2026-11-02"}


def test_other_libraries_read_it(tmp_path):
    store = write_store(tmp_path / "store", runs=2)
    eb.to_delta(store, tmp_path / "delta", tables=ONLY)
    polars = pytest.importorskip("polars")
    frame = polars.read_delta(str(tmp_path / "delta/spectra"))
    assert frame.height == 2 * 10 * 16 and frame["bench"].unique().to_list() == ["b1"]
    sent = pa.concat_tables([long_form(0, 10), long_form(10, 10)])
    assert sorted(frame["z_re_ohm"].to_list()) == sorted(sent["z_re_ohm"].to_pylist())


def test_a_column_of_a_newer_version_is_taken(tmp_path):
    store, out = write_store(tmp_path / "store", runs=2), tmp_path / "delta"
    eb.to_delta(store, out, tables=ONLY)
    table = long_form(500, 2)
    table = table.append_column("run_sha256", pa.array(["f" * 64] * table.num_rows))
    table = table.append_column("batch", pa.array(["B7"] * table.num_rows))
    part = store / "tables/spectra/site=a%2Fb/bench=b1/date=2026-11-02"
    parquet.write_table(table, part / f"{'f' * 64}.parquet")
    exists(store, "f" * 64)
    assert eb.to_delta(store, out, tables=ONLY) == {"spectra": Written(1)}
    assert set(rows(out / "spectra")["batch"].to_pylist()) == {None, "B7"}


def test_rows_that_the_store_has_replaced_go(tmp_path):
    store, out = write_store(tmp_path / "store", runs=3), tmp_path / "delta"
    eb.to_delta(store, out, tables=ONLY)
    old = next((store / "tables").rglob(f"{1:064x}.parquet"))
    table = long_form(500, 2)
    table = table.append_column("run_sha256", pa.array(["f" * 64] * table.num_rows))
    parquet.write_table(table, old.with_name(f"{'f' * 64}.parquet"))
    exists(store, "f" * 64)
    old.unlink()
    assert eb.to_delta(store, out, tables=ONLY) == {"spectra": Written(1, 1)}
    runs = rows(out / "spectra")["run_sha256"].to_pylist()
    assert sorted(set(runs)) == [f"{0:064x}", f"{2:064x}", "f" * 64] and len(runs) == 2 * 160 + 32
    # One commit: no reader sees both, or neither.
    assert delta.DeltaTable(str(out / "spectra")).version() == 2
    next((store / "tables").rglob("f" * 64 + ".parquet")).unlink()
    assert eb.to_delta(store, out, tables=ONLY) == {"spectra": Written(0, 1)}
    for file in (store / "tables").rglob("*.parquet"):
        file.unlink()
    with pytest.raises(eb.EisError, match="expected rows of spectra in the store, met none"):
        eb.to_delta(store, out, tables=ONLY)


def test_several_writers_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr("eisbench._delta._ROWS", 1)
    store, out = write_store(tmp_path / "store", runs=8), tmp_path / "delta"
    counts = []
    write = lambda: counts.append(eb.to_delta(store, out, tables=ONLY)["spectra"].new)  # noqa: E731
    threads = [threading.Thread(target=write) for _ in range(3)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert sum(counts) == 8, counts
    assert rows(out / "spectra").num_rows == 8 * 10 * 16


def test_a_writer_that_ends_between_two_commits(tmp_path, monkeypatch):
    monkeypatch.setattr("eisbench._delta._ROWS", 1)
    store, out = write_store(tmp_path / "store", runs=4), tmp_path / "delta"
    real, calls = delta.write_deltalake, []

    def dying(*words, **named):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(*words, **named)

    monkeypatch.setattr(delta, "write_deltalake", dying)
    with pytest.raises(KeyboardInterrupt):
        eb.to_delta(store, out, tables=ONLY)
    assert rows(out / "spectra").num_rows == 2 * 160
    assert eb.to_delta(store, out, tables=ONLY) == {"spectra": Written(2)}
    assert rows(out / "spectra").num_rows == 4 * 160


def test_what_is_no_store_is_refused(tmp_path):
    (tmp_path / "store").mkdir()
    with pytest.raises(eb.EisError, match="store.json: expected a file"):
        eb.to_delta(tmp_path / "store", tmp_path / "delta")
