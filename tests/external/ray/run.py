"""The same job on this machine's cores and on a Ray cluster of two nodes, one of which is killed in
the middle: the tables must be the same to the last bit. Prints time, scaling and overhead."""

import argparse
import logging
import os
import resource
import sys
import time
from pathlib import Path

os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
# Every address is 127.0.0.1.
os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
os.environ["RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO"] = "0"

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from eisbench import jobs

POINTS = 25


def spectra(count, seed):
    """Spectra of cells with three RC pairs, each drawn anew, with 0.2 % of noise."""
    draw = np.random.default_rng(seed)
    freq_hz = np.geomspace(0.05, 2000, POINTS)
    omega = 2j * np.pi * freq_hz
    z = draw.lognormal(np.log(8e-3), 0.2, (count, 1)) * np.ones(POINTS)
    for tau_s, r_ohm in ((0.001, 2e-3), (0.05, 3e-3), (3.0, 5e-3)):
        tau = tau_s * draw.lognormal(0, 0.3, (count, 1))
        z = z + r_ohm * draw.lognormal(0, 0.3, (count, 1)) / (1 + omega * tau)
    sigma = 2e-3 * abs(z)
    z = z + sigma * (draw.standard_normal(z.shape) + 1j * draw.standard_normal(z.shape))
    return np.tile(freq_hz, count), z.ravel(), sigma.ravel()


def store(folder, count, seed):
    """Writes a store of runs with 50 spectra each."""
    (folder / "runs").mkdir(parents=True)
    (folder / "store.json").write_text('{"format":"eis-bench store","version":1}\n')
    per_run = 50
    for run in range(-(-count // per_run)):
        of_run = min(per_run, count - run * per_run)
        freq_hz, z, sigma = spectra(of_run, (seed, run))
        sha = f"{run:064x}"
        ids = np.repeat([f"{sha}/spectra/s{k:03}" for k in range(of_run)], POINTS)
        columns = {
            "run_sha256": pa.array([sha] * len(ids)),
            "spectrum_id": pa.array(ids.tolist()),
            "freq_hz": freq_hz,
            "z_re_ohm": z.real,
            "z_im_ohm": z.imag,
            "sigma_re_ohm": sigma,
            "sigma_im_ohm": sigma,
            "cell": pa.array([f"cell {run % 20}"] * len(ids)),
        }
        part = folder / f"tables/spectra/site=lab/bench=b{run % 2}/date=2026-11-{1 + run // 500:02}"
        part.mkdir(parents=True, exist_ok=True)
        parquet.write_table(pa.table(columns), part / f"{sha}.parquet")
        (folder / f"runs/{sha}.json").write_text("{}")


class Timed:
    """Seconds of the clock, and processor time of this process and of children that ended."""

    def __enter__(self):
        self.begin, self.cpu = time.monotonic(), self._cpu()
        return self

    def __exit__(self, *_):
        self.s, self.cpu_s = time.monotonic() - self.begin, self._cpu() - self.cpu

    @staticmethod
    def _cpu():
        of = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(one.ru_utime + one.ru_stime for one in of)


def local(task, place, out, workers):
    with Timed() as timed:
        done = jobs.run(task, place, out, workers=workers)
    return done, timed


def on_ray(task, place, out, kill):
    """The job on two nodes with one core each; ``kill`` ends the second at half of the shards."""
    import ray
    from ray.cluster_utils import Cluster

    each = {"num_cpus": 1, "object_store_memory": 200 << 20, "node_ip_address": "127.0.0.1"}
    # A node that is silent for 5 s is dead; by default that takes half a minute.
    silent = {"health_check_initial_delay_ms": 1000, "health_check_period_ms": 1000}
    head = {**each, "include_dashboard": False, "_system_config": silent}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    node = cluster.add_node(**each)
    cluster.wait_for_nodes()
    ray.init(address=cluster.address, log_to_driver=False, logging_level="error")
    logging.getLogger("ray.data").setLevel(logging.ERROR)
    ray.data.DataContext.get_current().enable_progress_bars = False
    killed = []

    def watch(done, of):
        if kill and not killed and done >= of // 2:
            killed.append((done, of))
            # Killed, not asked to end: its worker processes die with it.
            cluster.remove_node(node, allow_graceful=False)

    with Timed() as timed:
        done = jobs.run(task, place, out, engine="ray", progress=watch)
    nodes = alive(ray, 1 if kill else 2)
    ray.shutdown()
    cluster.shutdown()
    return done, timed, killed, nodes


def alive(ray, expected):
    """Number of nodes that the cluster counts; it may take a minute to notice a death."""
    for _ in range(60):
        nodes = sum(one["Alive"] for one in ray.nodes())
        if nodes == expected:
            break
        time.sleep(1)
    return nodes


def bytes_of(out):
    return (Path(out) / "results.parquet").read_bytes()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--spectra", type=int, default=100_000)
    parser.add_argument("--rc", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    place, task = options.folder / "store", jobs.fit(rc=options.rc, ocv_slope="none")
    store(place, options.spectra, options.seed)
    print(f"{options.spectra} spectra of {POINTS} points, {options.rc} RC pairs")

    one, t1 = local(task, place, options.folder / "one", 1)
    rate = options.spectra / t1.s
    each_ms = 1e3 * t1.cpu_s / options.spectra
    print(f"local, 1 worker:  {t1.s:7.1f} s, {rate:6.0f} spectra/s, {each_ms:.2f} ms of processor time each")
    two, t2 = local(task, place, options.folder / "two", 2)
    rate = options.spectra / t2.s
    print(f"local, 2 workers: {t2.s:7.1f} s, {rate:6.0f} spectra/s, {t1.s / t2.s:.2f} times 1 worker")
    ray_done, t3, _, _ = on_ray(task, place, options.folder / "ray", kill=False)
    rate, more = options.spectra / t3.s, 100 * (t3.s / t2.s - 1)
    print(f"Ray, 2 nodes:     {t3.s:7.1f} s, {rate:6.0f} spectra/s, {more:+.0f} % of time against local")
    cut, t4, killed, nodes = on_ray(task, place, options.folder / "killed", kill=True)
    at, of = killed[0]
    print(f"Ray, one killed:  {t4.s:7.1f} s, killed after {at} of {of} shards, {nodes} node left")

    assert one.rows == options.spectra and nodes == 1, (one.rows, nodes)
    whole = bytes_of(options.folder / "one")
    same = [bytes_of(options.folder / name) == whole for name in ("two", "ray", "killed")]
    print(f"without a result: {one.errors}; sha256 {one.sha256}")
    names = ("2 workers", "Ray", "Ray with a node killed")
    print("the same to the last bit:", ", ".join(f"{n} {s}" for n, s in zip(names, same)))
    return 0 if all(same) and two.sha256 == ray_done.sha256 == cut.sha256 else 1


if __name__ == "__main__":
    sys.exit(main())
