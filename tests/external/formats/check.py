"""Files that eis-bench writes, opened by the programs that they are meant for, and theirs by eis-bench.

Prints a line per check and, last, how many passed and failed.
"""

import csv
import json
import math

from harness import OUT, ROOT, check, eis_bench, end, module

# A model and a curve: a fit of two RC to a spectrum of known branches, and a made curve.
BRANCHES = [(0.0017, 1.2), (0.0033, 760.0)]
SPECTRUM = OUT / "cell.csv"
with SPECTRUM.open("w") as file:
    file.write("freq_hz,z_re_ohm,z_im_ohm\n")
    for k in range(61):
        f = 10 ** (-3 + 0.1 * k)
        z = 0.0069 + sum(r / (1 + 2j * math.pi * f * r * c) for r, c in BRANCHES)
        file.write(f"{f!r},{z.real!r},{z.imag!r}\n")
CURVE = OUT / "ocv.json"
SOC = [0.05 * k for k in range(21)]
OCV = [3.0 + 1.1 * z + 0.08 * math.tanh(8 * (z - 0.1)) for z in SOC]
SLOPE = [1.1 + 0.64 / math.cosh(8 * (z - 0.1)) ** 2 for z in SOC]
CURVE.write_text(json.dumps({"capacity_ah": 4.5, "soc": SOC, "ocv_v": OCV, "slope_v": SLOPE}))
eis_bench("fit", SPECTRUM, "--rc", "2", "--out", OUT / "fit")
MODEL = next((OUT / "fit").rglob("model_2rc.json"))
PROFILE = OUT / "profile.csv"
STEPS = [(5.0, 30.0), (-3.0, 120.0), (0.0, 300.0), (20.0, 400.0)]
with PROFILE.open("w") as file:
    file.write("time_s,current_a\n")
    at = 0.0
    for current_a, duration_s in STEPS:
        file.write(f"{at},{current_a}\n")
        at += duration_s
    file.write(f"{at},0\n")


def simulated():
    """Time and voltage by eis-bench simulate."""
    import pyarrow.parquet

    augmented = json.loads(MODEL.read_text())
    augmented["ocv"] = json.loads(CURVE.read_text())
    with_curve = OUT / "with_curve.json"
    with_curve.write_text(json.dumps(augmented))
    eis_bench(
        "simulate", "--model", with_curve, "--profile", PROFILE, "--soc", "0.6", "--out", OUT / "simulated", "--json"
    )
    table = pyarrow.parquet.read_table(next((OUT / "simulated").rglob("*.parquet"))).to_pydict()
    return table["time_s"], table["ccv_v"]


@check("impedance.py reads our spectra and theirs come back")
def _():
    from impedance import preprocessing

    import numpy

    expected = numpy.loadtxt(SPECTRUM, delimiter=",", skiprows=1)
    expected = expected[expected[:, 0].argsort()[::-1]]
    notes = []
    readers = {
        "impedance-py": ("cell.csv", None),
        "gamry": ("cell.DTA", "gamry"),
        "biologic": ("cell.mpt", "biologic"),
        "zview": ("cell.z", "zplot"),
    }
    for to, (name, instrument) in readers.items():
        eis_bench("convert", SPECTRUM, "--to", to, "--out", OUT / to)
        path = str(OUT / to / name)
        if instrument is None:
            f, z = preprocessing.readCSV(path)
        else:
            f, z = preprocessing.readFile(path, instrument=instrument)
        f, z = numpy.asarray(f), numpy.asarray(z)
        order = f.argsort()[::-1]
        worst = max(
            abs(f[order] / expected[:, 0] - 1).max(), abs(z[order] - (expected[:, 1] + 1j * expected[:, 2])).max()
        )
        if len(f) != len(expected) or worst > 1e-12:
            raise AssertionError(f"{to}: {len(f)} points, off by {worst}")
        notes.append(f"{to} {worst:.0e}")
    return ", ".join(notes)


@check("impedance.py and eis-bench read the same numbers from real files of others")
def _():
    from impedance import preprocessing

    notes = []
    for name, instrument in {
        "gamry.DTA": "gamry",
        "biologic.mpt": "biologic",
        "zplot.z": "zplot",
        "autolab.txt": "autolab",
    }.items():
        path = ROOT / "fixtures/data/spectra/vendors" / name
        f, z = preprocessing.readFile(str(path), instrument=instrument)
        out = OUT / f"from_{instrument}"
        eis_bench("convert", path, "--to", "csv", "--out", out)
        rows = list(csv.DictReader(next(out.iterdir()).open()))
        ours = sorted((float(r["freq_hz"]), float(r["z_re_ohm"]), float(r["z_im_ohm"])) for r in rows)
        theirs = sorted(zip(map(float, f), map(float, z.real), map(float, z.imag)))
        if ours != theirs:
            raise AssertionError(f"{name}: {ours[:2]} against {theirs[:2]}")
        notes.append(f"{name} {len(ours)} points")
    return ", ".join(notes)


@check("batterydf opens and validates our BDF, CSV and Parquet")
def _():
    import bdf

    series = OUT / "series.csv"
    series.write_text("time_s,voltage_v,current_a,temperature_c\n0,3.7,0,25\n1,3.65,-2,25.1\n2,3.64,-2,25.2\n")
    notes = []
    for to, name in {"bdf-csv": "series.bdf.csv", "bdf-parquet": "series.bdf.parquet"}.items():
        eis_bench("convert", series, "--to", to, "--out", OUT / to)
        from bdf import io

        frame = io.load(OUT / to / name)
        report = bdf.validate(frame, report=False, raise_on_error=True)
        notes.append(f"{to} {list(frame.columns)} {len(frame)} rows")
        del report
    return "; ".join(notes)


@check("batterydf opens our spectra in BDF and their metadata")
def _():
    from bdf import io

    notes = []
    for to, name in {"bdf-csv": "cell.bdf.csv", "bdf-parquet": "cell.bdf.parquet"}.items():
        out = OUT / f"spectrum-{to}"
        eis_bench("convert", SPECTRUM, "--to", to, "--out", out)
        frame = io.load(out / name)
        rows = list(csv.DictReader(SPECTRUM.open()))
        ours = [(float(r["freq_hz"]), float(r["z_re_ohm"]), float(r["z_im_ohm"])) for r in rows]
        columns = ["Frequency / Hz", "Real Impedance / ohm", "Imaginary Impedance / ohm"]
        theirs = list(zip(*(map(float, frame[column]) for column in columns)))
        if sorted(ours) != sorted(theirs):
            raise AssertionError(f"{to}: {ours[:2]} against {theirs[:2]}")
        metadata = json.loads((out / "cell.bdf.metadata.json").read_text())
        if metadata["battinfo_dataset"]["dataset"]["name"] != "cell":
            raise AssertionError(f"{to}: {metadata}")
        # What batterydf saves, with its metadata, comes back.
        io.save(frame, OUT / f"back-{name}", metadata=metadata)
        eis_bench("convert", OUT / f"back-{name}", "--to", "csv", "--out", OUT / f"back-{to}")
        again = list(csv.DictReader((OUT / f"back-{to}" / "cell.csv").open()))
        if sorted(ours) != sorted((float(r["freq_hz"]), float(r["z_re_ohm"]), float(r["z_im_ohm"])) for r in again):
            raise AssertionError(f"{to}: {again[:2]}")
        notes.append(f"{to} {len(theirs)} points")
    return "; ".join(notes)


@check("eis-bench reads what batterydf writes")
def _():
    import pandas
    from bdf import io

    frame = pandas.DataFrame(
        {"Test Time / s": [0.0, 1.0, 2.0], "Voltage / V": [3.7, 3.6, 3.5], "Current / A": [0.0, -1.0, -2.0]}
    )
    notes = []
    for name in ("theirs.bdf.csv", "theirs.bdf.parquet"):
        io.save(frame, OUT / name)
        out = OUT / f"of_{name}"
        eis_bench("convert", OUT / name, "--to", "bdf-csv", "--out", out)
        rows = list(csv.DictReader((out / "theirs.bdf.csv").open()))
        met = [[float(r[c]) for c in ("Test Time / s", "Voltage / V", "Current / A")] for r in rows]
        if met != [[0.0, 3.7, 0.0], [1.0, 3.6, -1.0], [2.0, 3.5, -2.0]]:
            raise AssertionError(f"{name}: {met}")
        notes.append(name)
    return ", ".join(notes)


@check("fastnda and eis-bench read the same numbers from each version of .nda and .ndax")
def _():
    import fastnda

    notes = []
    for path in sorted((ROOT / "fixtures/data/series/neware").iterdir()):
        frame = fastnda.read(path)
        names = ("total_time_s", "voltage_V", "current_mA")
        theirs = {}
        for time_s, voltage_v, current_ma in zip(*(frame[name].to_list() for name in names)):
            # Of rows at one time eis-bench keeps the last.
            theirs[round(time_s, 6)] = (voltage_v, current_ma / 1000)
        out = OUT / f"neware-{path.name}"
        eis_bench("convert", path, "--to", "bdf-csv", "--out", out)
        rows = list(csv.DictReader(next(out.iterdir()).open()))
        ours = {float(r["Test Time / s"]): (float(r["Voltage / V"]), float(r["Current / A"])) for r in rows}
        if sorted(ours) != sorted(theirs):
            raise AssertionError(f"{path.name}: {sorted(ours)[:5]} against {sorted(theirs)[:5]}")
        worst = max(abs(a - b) for t in ours for a, b in zip(ours[t], theirs[t]))
        # fastnda keeps 32 bits.
        if worst > 5e-7:
            raise AssertionError(f"{path.name}: off by {worst}")
        notes.append(f"{path.name} {len(ours)} rows")
    return ", ".join(notes)


@check("CasADi gives what eis-bench simulate gives")
def _():
    eis_bench("convert", MODEL, "--to", "casadi", "--ocv", CURVE, "--out", OUT / "casadi")
    model = module(OUT / "casadi/model_2rc_casadi.py")
    step, state = model.step(), model.rest(0.6)
    time_s, ccv_v = simulated()
    at, worst = 0.0, 0.0
    for current_a, duration_s in STEPS:
        state, terminal_v = step(state, current_a, duration_s)
        at += duration_s
        row = next(k for k, t in enumerate(time_s) if abs(t - at) < 1e-9)
        worst = max(worst, abs(float(terminal_v) - ccv_v[row]))
    # The derivative that an optimiser asks for.
    import casadi

    current_a = casadi.SX.sym("i")
    slope = casadi.Function(
        "slope", [current_a], [casadi.jacobian(step(model.rest(0.6), current_a, 10.0)[1], current_a)]
    )
    if not (worst < 1e-9 and -0.02 < float(slope(5.0)) < -0.006):
        raise AssertionError(f"off by {worst} V, slope {float(slope(5.0))}")
    return f"largest difference {worst:.1e} V, dV/dI {float(slope(5.0)):.5f} Ω"


@check("PyBaMM's Thevenin model gives what eis-bench simulate gives")
def _():
    import numpy
    import pybamm

    pybamm.set_logging_level("ERROR")
    eis_bench("convert", MODEL, "--to", "pybamm", "--ocv", CURVE, "--out", OUT / "pybamm")
    values = pybamm.ParameterValues(module(OUT / "pybamm/model_2rc_pybamm.py").get_parameter_values())
    times, currents, at = [], [], 0.0
    for current_a, duration_s in STEPS:
        times += [at, at + duration_s - 1e-3]
        currents += [current_a, current_a]
        at += duration_s
    values["Current function [A]"] = pybamm.Interpolant(
        numpy.array(times + [at]), numpy.array(currents + [currents[-1]]), pybamm.t, interpolator="linear"
    )
    values["Initial SoC"] = 0.6
    model = pybamm.equivalent_circuit.Thevenin(options={"number of rc elements": 2})
    # The solver stops at every edge of the current.
    simulation = pybamm.Simulation(model, parameter_values=values, solver=pybamm.IDAKLUSolver(rtol=1e-8, atol=1e-8))
    solution = simulation.solve(t_eval=numpy.array(times))
    time_s, ccv_v = simulated()
    ours = numpy.interp([t for t in range(1, int(at) - 1, 7)], time_s, ccv_v)
    theirs = solution["Voltage [V]"]([t for t in range(1, int(at) - 1, 7)])
    away = numpy.abs(ours - theirs)
    # Within a second of a step the times of both differ.
    edges = numpy.cumsum([d for _, d in STEPS])
    far = [min(abs(t - e) for e in [0, *edges]) > 1.5 for t in range(1, int(at) - 1, 7)]
    worst = away[far].max()
    if worst > 2e-4:
        raise AssertionError(f"off by {worst} V")
    return f"largest difference {worst * 1e6:.0f} µV"


@check("model files follow docs/model.schema.json")
def _():
    import jsonschema

    schema = json.loads((ROOT / "docs/model.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(MODEL.read_text()), schema)
    wrong = json.loads(MODEL.read_text())
    wrong["fit"]["erm"]["r_ohm"] = "6.9 mΩ"
    try:
        jsonschema.validate(wrong, schema)
    except jsonschema.ValidationError:
        return "valid; a resistance with its unit in words is not"
    raise AssertionError("a wrong model was taken")


end()
