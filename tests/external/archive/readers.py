"""The tables of a store, read as they are by programs that others wrote."""

import os
import shutil
from pathlib import Path

import duckdb
import polars
import pyarrow.dataset

# Rows, runs, benches and a sum, which all must read alike.
COUNTED = {"runs": "started_unix_s", "spectra": "z_re_ohm", "fits": "r_ohm", "diagnoses": None}


def figures(tables: Path) -> dict[str, dict[str, tuple]]:
    """What each program reads, by table."""
    present = {name: column for name, column in COUNTED.items() if (tables / name).is_dir()}
    read = {"duckdb": by_duckdb, "polars": by_polars, "pyarrow": by_pyarrow}
    if shutil.which("java"):
        read["pyspark"] = by_pyspark
    return {
        program: {name: by(tables / name, column) for name, column in present.items()}
        for program, by in read.items()
    }


def by_duckdb(folder: Path, column: str | None) -> tuple:
    """Rows, runs, benches, sum."""
    return duckdb.sql(
        f"SELECT count(*), count(DISTINCT run_sha256), count(DISTINCT bench), "
        f"round(sum({column or 0}), 3), max(schema_version), max(site) "
        f"FROM read_parquet('{folder}/**/*.parquet', hive_partitioning=true)"
    ).fetchall()[0]


def by_polars(folder: Path, column: str | None) -> tuple:
    """The same."""
    table = polars.scan_parquet(f"{folder}/**/*.parquet", hive_partitioning=True).collect()
    total = table[column].sum() if column else 0
    return (
        table.height, table["run_sha256"].n_unique(), table["bench"].n_unique(), round(total, 3),
        table["schema_version"].max(), table["site"].max(),
    )


def by_pyarrow(folder: Path, column: str | None) -> tuple:
    """The same."""
    table = pyarrow.dataset.dataset(str(folder), format="parquet", partitioning="hive").to_table()
    total = pyarrow.compute.sum(table[column]).as_py() if column else 0
    count = lambda name: len(table[name].unique())  # noqa: E731
    return (
        table.num_rows, count("run_sha256"), count("bench"), round(total, 3),
        pyarrow.compute.max(table["schema_version"]).as_py(), table["site"][0].as_py(),
    )


def by_pyspark(folder: Path, column: str | None) -> tuple:
    """The same."""
    from pyspark.sql import SparkSession, functions

    os.environ["SPARK_LOCAL_IP"] = "127.0.0.1"
    spark = (
        SparkSession.builder.master("local[1]").appName("archive")
        .config("spark.ui.enabled", "false")
        .config("spark.ui.showConsoleProgress", "false").config("spark.driver.host", "127.0.0.1")
        .config("spark.driver.bindAddress", "127.0.0.1").getOrCreate()
    )
    spark.sparkContext.setLogLevel("ERROR")
    table = spark.read.parquet(str(folder))
    total = functions.sum(column) if column else functions.lit(0)
    row = table.agg(
        functions.count("*"), functions.countDistinct("run_sha256"), functions.countDistinct("bench"),
        functions.round(total, 3), functions.max("schema_version"), functions.max("site"),
    ).first()
    return tuple(row)
