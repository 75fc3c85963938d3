"""Jobs: the same table whatever is killed, and whoever works."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import impedance

import eisbench as eb
from eisbench import jobs

pa = pytest.importorskip("pyarrow")
from pyarrow import parquet  # noqa: E402

from eisbench.jobs import _shard  # noqa: E402
from eisbench.jobs._place import Place  # noqa: E402

FREQ_HZ = np.geomspace(0.01, 1000, 16)
TASK = jobs.fit(rc=1, ocv_slope="none")


def long_form(first, count, seed=0):
    """Spectra of one RC branch with 0.1 % of noise, as an Arrow table."""
    draw = np.random.default_rng([seed, first])
    ids = [f"r{first + k:05}/s" for k in range(count) for _ in FREQ_HZ]
    z = [impedance(FREQ_HZ, 0.01, [(0.02, 1.0 + 0.01 * k)]) for k in range(first, first + count)]
    z = np.concatenate(z)
    sigma = 1e-3 * abs(z)
    z = z + sigma * (draw.standard_normal(len(z)) + 1j * draw.standard_normal(len(z)))
    columns = {"freq_hz": np.tile(FREQ_HZ, count), "z_re_ohm": z.real, "z_im_ohm": z.imag}
    columns |= {"sigma_re_ohm": sigma, "sigma_im_ohm": 2 * sigma, "ocv_v": 3.7 + 0 * sigma}
    return pa.table({"spectrum_id": ids, **columns, "cell": ["c 1"] * len(ids)})


def write_store(folder, runs=6, per_run=10):
    """A store of some runs on two days."""
    (folder / "store.json").parent.mkdir(parents=True, exist_ok=True)
    (folder / "store.json").write_text('{"format":"eis-bench store","version":1}')
    for run in range(runs):
        part = folder / f"tables/spectra/site=a%2Fb/bench=b1/date=2026-11-{1 + run % 2:02}"
        part.mkdir(parents=True, exist_ok=True)
        table = long_form(run * per_run, per_run)
        table = table.append_column("run_sha256", pa.array([f"{run:064x}"] * table.num_rows))
        parquet.write_table(table, part / f"{run:064x}.parquet")
        exists(folder, f"{run:064x}")
    return folder


def exists(store, run):
    """Writes the list of a run, which makes it exist."""
    (store / "runs").mkdir(exist_ok=True)
    (store / f"runs/{run}.json").write_text("{}")


@pytest.fixture
def store(tmp_path):
    return write_store(tmp_path / "store")


def test_rows_are_those_of_fit_table(store, tmp_path):
    done = jobs.run(TASK, store, tmp_path / "out", rows=200)
    table = done.table()
    ids = table["spectrum_id"].to_pylist()
    assert ids == sorted(ids) and done.rows == len(ids) == 60 and done.errors == 0
    given = pa.concat_tables([long_form(10 * run, 10) for run in range(6)])
    alone = eb.fit_table(given, rc=1, ocv_slope="none")
    for name in alone:
        values = table[name].to_pylist()
        expected = [None if v != v else v for v in list(alone[name])]
        assert values == expected, name
    row = table.slice(17, 1).to_pylist()[0]
    assert row["site"] == "a/b" and row["bench"] == "b1" and row["run_sha256"] == f"{1:064x}"
    assert row["cell"] == "c 1" and row["ocv_v"] == 3.7 and row["chemistry"] is None
    assert row["program"] == eb.__version__ and json.loads(row["parameters"])["rc"] == 1
    assert row["task_sha256"] == TASK.sha256 and len(row["input_sha256"]) == 64


def test_covariances_of_the_input_are_used():
    table = long_form(0, 1)
    both = table.drop(["sigma_re_ohm", "sigma_im_ohm"]).append_column("sigma_ohm", table["sigma_re_ohm"])
    rows = [jobs.work(TASK, one).to_pylist()[0] for one in (table, both)]
    assert rows[0]["r_sigma_ohm"] != rows[1]["r_sigma_ohm"]
    assert rows[0]["input_sha256"] != rows[1]["input_sha256"]
    (spectrum,) = eb.spectra_of_table(table)
    ratio = spectrum.covariance_ohm2[:, 2] / spectrum.covariance_ohm2[:, 0]
    np.testing.assert_allclose(ratio, 4.0)


@pytest.mark.parametrize("rows", [1, 7, 16, 48, 1000])
@pytest.mark.parametrize("group", [5, 16, 100, 10_000])
def test_no_cut_of_a_file_loses_or_doubles_a_row(tmp_path, rows, group):
    whole = long_form(0, 9)
    parquet.write_table(whole, tmp_path / "t.parquet", row_group_size=group)
    place = Place(tmp_path)
    parts = [_shard.read(place, s) for s in _shard.shards(place, ["t.parquet"], TASK, rows)]
    joined = pa.concat_tables(parts)
    assert joined["z_re_ohm"].to_pylist() == whole["z_re_ohm"].to_pylist()
    for part in parts:
        ids = part["spectrum_id"].to_pylist()
        assert len(ids) == 16 * len(set(ids))


def test_columns_of_a_path():
    columns = _shard.partition("tables/spectra/site=S%C3%BCd/bench=__HIVE_DEFAULT_PARTITION__/x.parquet")
    assert columns == {"site": "Süd", "bench": None}


def test_shards_follow_from_the_input_alone(store, tmp_path):
    place = Place(store)
    files = place.names("tables/spectra", ".parquet")
    names = [shard.name for shard in _shard.shards(place, files, TASK, 400)]
    assert names == [shard.name for shard in _shard.shards(place, files, TASK, 400)]
    other = jobs.fit(rc=2, ocv_slope="none")
    assert not set(names) & {s.name for s in _shard.shards(place, files, other, 400)}
    # A run of another day changes no shard of those before.
    part = store / "tables/spectra/site=a%2Fb/bench=b1/date=2026-11-03"
    part.mkdir()
    parquet.write_table(long_form(900, 3), part / "new.parquet")
    files = place.names("tables/spectra", ".parquet")
    assert len(files) == 7
    assert [s.name for s in _shard.shards(place, files, TASK, 400)][: len(names)] == names


def test_any_cut_and_any_number_of_workers_give_the_same_bytes(store, tmp_path):
    cuts = [(1, 100_000), (2, 160), (3, 1)]
    done = [
        jobs.run(TASK, store, tmp_path / str(rows), workers=workers, rows=rows)
        for workers, rows in cuts
    ]
    assert len({one.sha256 for one in done}) == 1
    assert len(done[2].manifest["shards"]) > 60


def test_what_is_done_is_not_done_again(store, tmp_path):
    out = tmp_path / "out"
    first = jobs.run(TASK, store, out, rows=160)
    shards = sorted((out / "shards").iterdir())
    kept = [(one, one.stat().st_mtime_ns) for one in shards[1:]]
    shards[0].unlink()
    seen = []
    again = jobs.run(TASK, store, out, rows=160, progress=lambda *counts: seen.append(counts))
    assert seen == [(1, 1)] and again.sha256 == first.sha256
    assert [(one, one.stat().st_mtime_ns) for one in kept_files(kept)] == kept
    write_store(store, runs=7)
    (store / f"runs/{6:064x}.json").unlink()
    # A run whose list is not there yet is still being sent.
    assert jobs.run(TASK, store, out, rows=160).rows == 60
    exists(store, f"{6:064x}")
    more = jobs.run(TASK, store, out, rows=160)
    assert more.rows == 70 and more.sha256 != first.sha256


def kept_files(kept):
    return [one for one, _ in kept]


def test_a_job_that_was_killed_goes_on(tmp_path):
    store, out = write_store(tmp_path / "store", runs=8, per_run=40), tmp_path / "out"
    words = [sys.executable, "-m", "eisbench.jobs", "fit", store, "--out", out]
    words += ["--rc", "2", "--ocv-slope", "none", "--rows", "160", "--workers", "1"]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    while len(list(out.glob("shards/*.parquet"))) < 3 and process.poll() is None:
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    done = len(list(out.glob("shards/*.parquet")))
    assert 3 <= done < 32 and not (out / "results.parquet").exists()
    subprocess.run(words, check=True, capture_output=True)
    whole = jobs.run(jobs.fit(rc=2, ocv_slope="none"), store, tmp_path / "whole")
    assert (out / "results.parquet").read_bytes() == (tmp_path / "whole/results.parquet").read_bytes()
    assert whole.rows == 320


def test_a_spectrum_that_cannot_be_fitted_costs_no_other(tmp_path):
    table = long_form(0, 3)
    bad = table["z_re_ohm"].to_pylist()
    bad[20] = None
    table = table.set_column(2, "z_re_ohm", pa.array(bad, pa.float64()))
    done = jobs.run(TASK, table, tmp_path / "out")
    errors = done.table()["error"].to_pylist()
    assert done.errors == 1 and [error is None for error in errors] == [True, False, True]
    assert all(name in done.table().column_names for name in ("r_ohm", "r1_ohm"))


def test_every_kind_of_input_gives_the_same_results(tmp_path):
    table = long_form(0, 4)
    parquet.write_table(table, tmp_path / "t.parquet")
    from pyarrow import csv

    csv.write_csv(table, tmp_path / "t.csv")
    (tmp_path / "folder/below").mkdir(parents=True)
    parquet.write_table(table, tmp_path / "folder/below/t.parquet")
    given = [tmp_path / "t.parquet", tmp_path / "t.csv", tmp_path / "folder", table]
    given += [table.to_pandas()] if pytest.importorskip("pandas") else []
    hashes = {jobs.run(TASK, one, tmp_path / f"out{k}").sha256 for k, one in enumerate(given)}
    assert len(hashes) == 1


def test_kk_and_circuits(store, tmp_path):
    judged = jobs.run(jobs.kk(), store, tmp_path / "kk").table()
    assert set(judged["grade"].to_pylist()) == {"good"}
    circuit = jobs.fit(circuit="R0-p(R1,C1)")
    table = jobs.run(circuit, store, tmp_path / "circuit").table()
    np.testing.assert_allclose(table["R0"].to_numpy(), 0.01, rtol=0.01)


def refused(match, *words, **named):
    with pytest.raises(eb.EisError, match=match):
        jobs.run(*words, **named)


def test_what_is_refused_tells_why(store, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(eb.EisError, match="rc: expected a number"):
        jobs.fit(rc="many")
    with pytest.raises(eb.EisError, match="objective|expected"):
        jobs.fit(objective="best")
    refused("engine: expected one of local, ray, spark", TASK, store, out, engine="dask")
    jobs.run(TASK, store, out)
    refused(r"job.json: expected kk by version .* met fit by version", jobs.kk(), store, out)
    (tmp_path / "empty").mkdir()
    refused("expected Parquet files of spectra, met none", TASK, tmp_path / "empty", tmp_path / "o1")
    (store / "store.json").write_text('{"format":"eis-bench store","version":2}')
    refused("store.json: expected 'eis-bench store', version 1", TASK, store, tmp_path / "o2")
    parquet.write_table(pa.table({"spectrum_id": ["a"], "freq_hz": [1.0]}), tmp_path / "t.parquet")
    refused("expected a column z_re_ohm", TASK, tmp_path / "t.parquet", tmp_path / "o3")
    (tmp_path / "x.parquet").write_bytes(b"no")
    refused("x.parquet: expected a Parquet file", TASK, tmp_path / "x.parquet", tmp_path / "o4")
    twice = pa.concat_tables([long_form(0, 2), long_form(0, 1)])
    refused("rows of each spectrum one after another", TASK, twice, tmp_path / "o5")


def test_a_spectrum_in_two_files_is_refused(tmp_path):
    for name in ("a", "b"):
        (tmp_path / "in" / name).mkdir(parents=True)
        parquet.write_table(long_form(0, 2), tmp_path / "in" / name / "t.parquet")
    refused("expected each spectrum_id once, met 'r00000/s'", TASK, tmp_path / "in", tmp_path / "o")


def test_a_damaged_shard_is_named(store, tmp_path):
    out = tmp_path / "out"
    jobs.run(TASK, store, out)
    shard = next((out / "shards").iterdir())
    shard.write_bytes(shard.read_bytes()[:-9])
    refused(f"{shard.name}: expected the results of a shard", TASK, store, out)
    shard.unlink()
    jobs.run(TASK, store, out)


def test_spark(store, tmp_path):
    pyspark = pytest.importorskip("pyspark")
    if not any(os.access(f"{p}/java", os.X_OK) for p in os.environ["PATH"].split(":")):
        pytest.skip("needs Java")
    os.environ["PYSPARK_PYTHON"] = sys.executable
    builder = pyspark.sql.SparkSession.builder.master("local[2]")
    for name, value in {"ui.enabled": "false", "driver.host": "127.0.0.1"}.items():
        builder = builder.config(f"spark.{name}", value)
    session = builder.config("spark.driver.bindAddress", "127.0.0.1").getOrCreate()
    try:
        by_spark = jobs.run(TASK, store, tmp_path / "spark", engine="spark", rows=160)
        own = of_a_data_frame(session, store)
    finally:
        session.stop()
    local = jobs.run(TASK, store, tmp_path / "local")
    assert by_spark.sha256 == local.sha256
    rows = zip(*(local.table()[name].to_pylist() for name in ("spectrum_id", "r_ohm")))
    assert own == dict(rows)


def of_a_data_frame(session, store):
    """The function of the job on a data frame of Spark, as ``docs/jobs.md`` tells it."""
    from pyspark.sql.pandas.types import from_arrow_schema

    numbers_of_it = ("freq_hz", "z_re_ohm", "z_im_ohm", "sigma_re_ohm", "sigma_im_ohm")
    names = [("spectrum_id", pa.string()), *((name, pa.float64()) for name in numbers_of_it)]
    given, task = pa.schema(names), TASK

    def each(batches):
        from eisbench import jobs

        yield from jobs.work(task, pa.Table.from_batches(batches, given)).to_batches()

    spectra = session.read.parquet(str(store / "tables/spectra"))
    apart = spectra.select(given.names).repartition(3, "spectrum_id")
    fits = apart.mapInArrow(each, from_arrow_schema(task.schema()))
    return {row["spectrum_id"]: row["r_ohm"] for row in fits.collect()}


def test_ray(store, tmp_path):
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    ray = pytest.importorskip("ray")
    pytest.importorskip("ray.data")
    ray.init(num_cpus=2, include_dashboard=False, object_store_memory=100 << 20)
    try:
        by_ray = jobs.run(TASK, store, tmp_path / "ray", engine="ray", rows=160)
    finally:
        ray.shutdown()
    assert by_ray.sha256 == jobs.run(TASK, store, tmp_path / "local").sha256


def test_an_object_store(tmp_path, monkeypatch):
    server = pytest.importorskip("moto.server")
    from pyarrow import fs

    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "test")
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    moto = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    moto.start()
    try:
        _, port = moto.get_host_and_port()
        query = f"?scheme=http&endpoint_override=127.0.0.1:{port}&region=us-east-1"
        query += "&allow_bucket_creation=true"
        s3, _ = fs.FileSystem.from_uri(f"s3://lab/store{query}")
        s3.create_dir("lab")
        local = write_store(tmp_path / "store")
        fs.copy_files(str(local), "lab/store", destination_filesystem=s3)
        out = f"s3://lab/fits{query}"
        done = jobs.run(TASK, f"s3://lab/store{query}", out, rows=300)
        seen = []
        again = jobs.run(TASK, f"s3://lab/store{query}", out, rows=300, progress=seen.append)
        assert again.sha256 == done.sha256 and seen == []
        assert done.sha256 == jobs.run(TASK, local, tmp_path / "out").sha256
    finally:
        moto.stop()


def test_a_worker_of_another_version_is_refused():
    other = jobs.Task(TASK.kind, TASK.parameters, "0.0.9")
    with pytest.raises(eb.EisError, match="expected version 0.0.9 of eisbench"):
        jobs.work(other, long_form(0, 1))
