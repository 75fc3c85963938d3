"""Small run folders, as a run on a bench leaves them."""

import hashlib
import json
import random
from pathlib import Path

FIRST_S = 1.7e9
POINTS = 20
# Every so many runs have a capture that goes up in parts.
LARGE_EVERY = 50
LARGE_BYTES = 11_000_000


def files(number: int) -> dict[str, bytes]:
    """The files of a run, by path."""
    dice = random.Random(number)
    cell = f"C{number % 100:02}"
    manifest = {
        "program": "eis-bench", "version": "0.1.0", "experiment": "ageing",
        "bench": f"bench{number % 5}",
        "cell": {"name": cell, "serial": f"P45B-{number % 100:04}"}, "seed": number,
        "time": "real", "simulated": False, "config_sha256": "00", "files": {},
        "started_unix_s": FIRST_S + 3600.0 * number, "bench_time_s": 100.0,
    }
    started = {
        "version": "0.1.0", "experiment": "ageing", "seed": number, "time": "real",
        "inherited": False, "files": [], "plan": [],
    }
    entries = [{"started": started}, {"ended": {"how": "finished"}}]
    journal = "".join(
        f'{{"number":{k + 1},"time_s":1.5,"entry":{json.dumps(entry)},"sha256":"00"}}\n'
        for k, entry in enumerate(entries)
    )
    index = {
        "cell": cell, "capacity_c": 16200.0, "traces": [],
        "sweeps": [{
            "file": "spectrum.csv", "fixture": "cell", "fixture_ohm": None, "corrected": True,
            "amplitude_a": 1.0, "repeat": 1, "order": 0, "start_time_s": 50.0,
            "start_ocv_v": 3.7, "temperature_c": 25.0, "role": "train",
            "repeat_group": "eis", "flagged": [],
        }],
    }
    head = "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2,amplitude_a"
    rows = [
        f"{10 ** (-1 + 0.2 * k)!r},{0.006 + 1e-5 * number!r},{-0.001!r},3e-6,3e-6,0.0,1.0"
        for k in range(POINTS)
    ]
    found = {
        "manifest.json": json.dumps(manifest).encode(),
        "journal.jsonl": journal.encode(),
        "traces.json": json.dumps(index).encode(),
        "spectrum.csv": "\n".join([head, *rows, ""]).encode(),
        "captures/cell/point01_1.000000Hz.parquet": dice.randbytes(2000 + number % 1000),
    }
    if number % LARGE_EVERY == 0:
        found["captures/cell/point02_2.000000Hz.parquet"] = dice.randbytes(LARGE_BYTES + number)
    for rc in (1, 2):
        found[f"model_{rc}rc.json"] = json.dumps(model(number, rc, cell)).encode()
    lines = [f"{hashlib.sha256(found[path]).hexdigest()}  {path}\n" for path in sorted(found)]
    found["SHA256SUMS"] = "".join(lines).encode()
    return found


def model(number: int, rc: int, cell: str) -> dict:
    """A fitted model."""
    r_ohm = 0.006 + 1e-5 * number
    return {
        "schema": "eis-bench/model", "schema_version": 1, "name": cell, "rc": rc,
        "fit": {
            "erm": {
                "r_ohm": r_ohm,
                "branches": [{"r_ohm": 0.004 + 0.001 * k, "c_f": 10.0} for k in range(rc)],
            },
            "sigma": {"r_ohm": 1e-6, "branches": [{}] * rc, "dc_resistance_ohm": 2e-6},
            "objective": 1.0, "points": POINTS, "rms_ohm": 3e-6, "reduced_chi2": 1.1,
        },
        "dc_resistance_ohm": r_ohm + 0.004 * rc, "time_constants_s": [0.04] * rc,
        "spectra": ["spectrum"],
    }


def write(runs: Path, count: int) -> None:
    """Writes run folders."""
    for number in range(count):
        for path, data in files(number).items():
            target = runs / f"run{number:06}" / path
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)


def diagnose(data: Path, number: int) -> None:
    """Writes a diagnosis of a run beside it."""
    folder = data / "analyses" / f"diagnosis-{number}" / "out"
    folder.mkdir(parents=True)
    verdict = {
        "data_set": f"run{number:06}", "model": "C", "verdict": "missing-effect",
        "summary": "the model lacks diffusion",
        "effects": [{"name": "diffusion", "parameters": [
            {"name": "tau_s", "value": 12.5 + number, "sigma": 0.5, "unit": "s"},
        ]}],
    }
    (folder / "diagnosis.json").write_text(json.dumps(verdict))
