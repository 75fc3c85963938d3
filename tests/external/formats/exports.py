"""A whole discharge under the four robot profiles, one after the other until the cell is empty: exports of a model of
one point, of a map, of a map with charge transfer and of a model with additions, each against eis-bench simulate.

PART, a share of the capacity [default 0.01], makes the discharge short; 1 is the whole one, in CasADi and an FMU.
"""

import json
import math
import os
import shutil
import subprocess

import numpy

from harness import OUT, ROOT, check, eis_bench, end, module

PART = float(os.environ.get("PART", "0.01"))
CELLS = ROOT / "fixtures/data/cells"
AMBIENT_DEGC, P0_SHARE, START = 20.0, 0.95, 0.98
# Equal parts of a row are at most as long, s.
STEP_S = 2.5e-4
MAPS = ("map", "bent")
LIMIT_UV = 10.0
ADDITIONS = {
    "rc_slow": {"r_ohm": 3e-3, "tau_s": 50.0},
    "soc_resistance": {"k": -0.3},
    "self_heating": {"g_per_j": 1e-3, "tau_s": 600.0},
    "hysteresis": {"m_v": 0.02, "gamma": 60.0, "carried": 0.0, "first": 0.0},
}


def cycle():
    """Lengths and powers of the rows of the four profiles, of one cell of 16S3P."""
    rows = []
    for name in ("gap_2m", "lateral_jump", "spin_jump", "walking"):
        t, w = numpy.loadtxt(ROOT / f"fixtures/data/profiles/{name}.csv", delimiter=",", skiprows=1).T
        rows += zip(numpy.diff(t), w[:-1] / 48)
    return rows


CYCLE = cycle()


def models():
    """Name, file, scale of the powers and share of the capacity of each model; written once."""
    curve = json.loads((CELLS / "p45b_25C/ocv.json").read_text())
    erm = json.loads((CELLS / "p45b_25C/model_4rc.json").read_text())["fit"]["erm"]
    point = {"name": "point", "r_ohm": erm["r_ohm"], "branches": erm["branches"], "ocv": curve}
    soc, degc, shape = [0.1, 0.5, 1.0], [0.0, 25.0], [2.0, 1.0, 1.2]
    surface = {ohm: [[ohm * cold * z for z in shape] for cold in (2.0, 1.0)] for ohm in (7e-3, 3e-3, 6e-3)}
    over = {ohm: {"activation_j_per_mol": 25e3, "r_ohm": rows} for ohm, rows in surface.items()}
    branches = [{"tau_s": tau_s, "resistance": over[ohm]} for tau_s, ohm in ((2.0, 3e-3), (60.0, 6e-3))]
    thermal = {"capacity_j_per_k": 60.0, "resistance_k_per_w": 6.0}
    mapped = {"soc": soc, "temperature_degc": degc, "series": over[7e-3], "branches": branches, "thermal": thermal}
    mapped.update(ocv_offset_v=[2e-3, 0.0, -3e-3], ocv_v_per_k=[1e-4, 0.0, -1e-4], ocv_temperature_degc=25.0)
    changing = dict(point, name="map", ocv=dict(curve), map=mapped)
    law = {"voltage_v": 0.05, "slowest_s": 100.0}
    bent = dict(point, name="bent", ocv=dict(curve), map=dict(mapped, charge_transfer=law))
    added = dict(point, name="added", ocv=dict(curve))
    added["facts"] = {
        "lowest_hz": 0.1, "highest_hz": 201.0, "longest_s": 600.0, "shortest_s": 0.1, "greatest_a": 30.0,
        "widest_soc": 0.5, "soc": 0.5, "temperature_c": 25.0, "orders": 0.0, "span_s": 0.0,
    }  # fmt: skip
    evidence = {"text": "", "lambda": 0, "score": 0, "held_out_gap_before_v": None, "held_out_gap_after_v": None}
    added["additions"] = [
        {
            "name": name,
            "title": name,
            "group": "cell",
            "parameters": [{"name": key, "value": value, "sigma": None, "unit": ""} for key, value in values.items()],
            "evidence": evidence,
            "data_set": "none",
            "added_by": "a test",
        }
        for name, values in ADDITIONS.items()
    ]
    found = {}
    for model, scale in ((point, 1.0), (changing, 1.0), (bent, 1.0), (added, 0.8)):
        # Additions are slow to simulate: one cycle of the whole cell.
        model["ocv"]["capacity_ah"] *= 1.0 if model is added else PART
        file = OUT / f"{model['name']}.json"
        file.write_text(json.dumps(model))
        found[model["name"]] = (file, scale)
    return found


class Discharge:
    """Rows of power until empty, and the voltage at the start and at the end of each by eis-bench simulate."""

    def __init__(self, name, file, scale, rows=CYCLE, until_s=None):
        import pyarrow.parquet

        # Rows that end before the cell is empty are for solvers with steps of their own: straight lines.
        interpolation = "linear" if until_s else "hold"

        self.name, self.file = name, file
        curve = json.loads(file.read_text())["ocv"]
        mean_w = scale * sum(h * w for h, w in rows) / sum(h for h, _ in rows)
        count = math.ceil(1.1 * 3600 * curve["capacity_ah"] * 4.2 / mean_w / sum(h for h, _ in rows))
        if name == "added":
            count = 1
        lengths, powers = numpy.array(rows * count).T
        if until_s:
            kept = numpy.cumsum(lengths) <= until_s
            lengths, powers = lengths[kept], powers[kept]
        times = numpy.concatenate([[0.0], numpy.cumsum(lengths)])
        profile = OUT / f"{name}-{len(rows)}.csv"
        with profile.open("w") as out:
            out.write("time_s,power_w\n")
            for t, w in zip(times, scale * numpy.append(powers, rows[len(powers) % len(rows)][1])):
                out.write(f"{float(t)!r},{float(w)!r}\n")
        out = OUT / f"simulated-{name}-{len(rows)}"
        words = ["simulate", "--model", file, "--profile", profile, "--soc", START, "--out", out]
        words += ["--interpolation", interpolation]
        eis_bench(*words, "--beyond", "extrapolate", "--p0-share", P0_SHARE, "--ambient-degc", AMBIENT_DEGC)
        table = pyarrow.parquet.read_table(next(out.rglob("*.parquet"))).to_pydict()
        t, v, soc = (numpy.array(table[key]) for key in ("time_s", "ccv_v", "soc"))
        # A jump of the power has two rows; the rows end where the cell is empty.
        first, last = numpy.searchsorted(t, times - 1e-7), numpy.searchsorted(t, times + 1e-7) - 1
        full = [k for k in range(len(times)) if first[k] <= last[k] < len(t) and soc[last[k]] > 0]
        self.count = full[-1]
        self.time_s, self.power_w = times[: self.count + 1], scale * powers[: self.count]
        self.start_v, self.end_v = v[last[: self.count]], v[first[1 : self.count + 1]]
        self.soc = soc[last[: self.count]]
        # Near the end the voltage falls ever faster.
        self.almost_s = float(t[numpy.argmax(soc < 0.03)]) or times[-1]

    def parts(self, row):
        return max(1, math.ceil((self.time_s[row + 1] - self.time_s[row]) / STEP_S - 1e-9))

    def compare(self, start_v, end_v):
        """Largest difference, as text; raises beyond the limit."""
        count = min(len(end_v), self.count)
        away = numpy.abs(numpy.asarray(end_v)[:count] - self.end_v[:count])
        if start_v is not None:
            away = numpy.maximum(away, numpy.abs(numpy.asarray(start_v)[:count] - self.start_v[:count]))
        worst = int(away.argmax())
        text = f"{self.name} {1e6 * away[worst]:.2f} µV in {count} rows to SOC {self.soc[count - 1]:.3f}"
        if not away[worst] * 1e6 < LIMIT_UV or count < 0.98 * self.count:
            raise AssertionError(f"{text}, worst at SOC {self.soc[worst]:.3f}")
        return text


MODELS = models()
DISCHARGES = [Discharge(name, file, scale) for name, (file, scale) in MODELS.items()]
SHORT = PART <= 0.05
ALMOST_S = {discharge.name: discharge.almost_s for discharge in DISCHARGES}


def exported(discharge, to):
    out = OUT / f"{to}-{discharge.name}"
    if not out.exists():
        eis_bench("convert", discharge.file, "--to", to, "--temperature-c", AMBIENT_DEGC, "--out", out)
    return next(path for path in out.iterdir() if path.is_file())


@check("CasADi")
def _():
    import casadi

    notes = []
    for discharge in DISCHARGES:
        made = module(exported(discharge, "casadi"))
        step = made.power_step()
        state = made.rest(START, AMBIENT_DEGC) if discharge.name in MAPS else made.rest(START)
        rows = numpy.repeat(numpy.arange(discharge.count), [discharge.parts(k) for k in range(discharge.count)])
        lengths = numpy.diff(discharge.time_s) / numpy.bincount(rows)
        more = [AMBIENT_DEGC] if discharge.name in MAPS else []
        chain = step.mapaccum(1000)
        start_v = []
        for first in range(0, len(rows), 1000):
            block = rows[first : first + 1000]
            pad = 1000 - len(block)
            power, dt = (numpy.append(values[block], numpy.zeros(pad)) for values in (discharge.power_w, lengths))
            found = chain(state, power.reshape(1, -1), dt.reshape(1, -1), P0_SHARE, *more)
            state = found[0][:, -1]
            start_v.append(numpy.array(found[1]).ravel())
        start_v = numpy.concatenate(start_v)[: len(rows)]
        first = numpy.searchsorted(rows, numpy.arange(discharge.count))
        notes.append(discharge.compare(start_v[first], discharge.end_v))
    return "; ".join(notes)


@check("FMU, co-simulation")
def _():
    import fmpy
    from fmpy import fmi3
    from fmpy.validation import validate_fmu

    notes = []
    for discharge in DISCHARGES:
        path = exported(discharge, "fmu")
        problems = validate_fmu(str(path))
        if problems:
            raise AssertionError(f"{discharge.name}: {problems}")
        description = fmpy.read_model_description(str(path))
        vr = {variable.name: variable.valueReference for variable in description.modelVariables}
        slave = fmi3.FMU3Slave(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="cell",
        )
        slave.instantiate()
        given = {"soc_start": START, "ambient_degc": AMBIENT_DEGC, "p0_share": P0_SHARE, "longest_step_s": STEP_S}
        slave.setFloat64([vr[key] for key in given], list(given.values()))
        slave.setBoolean([vr["power_in"]], [True])
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        start_v, end_v = [], []
        for row, power_w in enumerate(discharge.power_w):
            slave.setFloat64([vr["power_w"]], [power_w])
            start_v += slave.getFloat64([vr["terminal_v"]])
            at = discharge.time_s[row]
            slave.doStep(currentCommunicationPoint=at, communicationStepSize=discharge.time_s[row + 1] - at)
            end_v += slave.getFloat64([vr["terminal_v"]])
        low_v, high_v = slave.getFloat64([vr["low_v"], vr["high_v"]])
        if abs(low_v - (end_v[-1] - 2.5)) > 1e-12 or abs(high_v - (4.2 - end_v[-1])) > 1e-12:
            raise AssertionError(f"margins {low_v} and {high_v} at {end_v[-1]} V")
        slave.terminate()
        slave.freeInstance()
        notes.append(discharge.compare(start_v, end_v))
    return "; ".join(notes)


@check("FMU, model exchange")
def _():
    import ctypes

    import fmpy
    from fmpy import fmi3

    if not SHORT:
        return "left out: Runge and Kutta's steps in Python take long"
    notes = []
    for discharge in DISCHARGES:
        path = exported(discharge, "fmu")
        description = fmpy.read_model_description(str(path))
        vr = {variable.name: variable.valueReference for variable in description.modelVariables}
        model = fmi3.FMU3Model(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path)),
            modelIdentifier=description.modelExchange.modelIdentifier,
            instanceName="cell",
        )
        model.instantiate()
        model.setFloat64([vr["soc_start"], vr["ambient_degc"], vr["p0_share"]], [START, AMBIENT_DEGC, P0_SHARE])
        model.setBoolean([vr["power_in"]], [True])
        model.enterInitializationMode()
        model.exitInitializationMode()
        model.enterContinuousTimeMode()
        size = description.numberOfContinuousStates
        x, rate = (ctypes.c_double * size)(), (ctypes.c_double * size)()
        state = numpy.frombuffer(x)
        model.getContinuousStates(x, size)

        def slope(at):
            state[:] = at
            model.setContinuousStates(x, size)
            model.getContinuousStateDerivatives(rate, size)
            return numpy.array(rate)

        end_v, here = [], state.copy()
        for row, power_w in enumerate(discharge.power_w):
            model.setFloat64([vr["power_w"]], [power_w])
            parts = discharge.parts(row)
            h = (discharge.time_s[row + 1] - discharge.time_s[row]) / parts
            for _ in range(parts):
                k1 = slope(here)
                k2 = slope(here + 0.5 * h * k1)
                k3 = slope(here + 0.5 * h * k2)
                here = here + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(here + h * k3))
            state[:] = here
            model.setContinuousStates(x, size)
            end_v += model.getFloat64([vr["terminal_v"]])
        model.terminate()
        model.freeInstance()
        notes.append(discharge.compare(None, end_v))
    return "; ".join(notes)


def coarse(count):
    """The cycle as straight lines between means over equal times, which solvers with a step of their own take."""
    times = numpy.cumsum([h for h, _ in CYCLE])
    energy = numpy.cumsum([h * w for h, w in CYCLE])
    ticks = numpy.linspace(0, times[-1], count + 1)
    means = numpy.diff(numpy.interp(ticks, [0, *times], [0, *energy])) / numpy.diff(ticks)
    return [(ticks[1], w) for w in means]


@check("PyBaMM")
def _():
    import pybamm

    if not SHORT:
        return "left out: its solver takes long"
    pybamm.set_logging_level("ERROR")
    notes = []
    for name in ("point", *MAPS):
        discharge = Discharge(name, *MODELS[name], coarse(368), ALMOST_S[name])
        made = module(exported(discharge, "pybamm"))
        values = pybamm.ParameterValues(made.get_parameter_values())
        at, watts = discharge.time_s[:-1], discharge.power_w
        values["Power function [W]"] = pybamm.Interpolant(at, watts, pybamm.t, interpolator="linear")
        values["Initial SoC"] = START
        # The cut-offs would end the discharge before it is empty.
        values["Lower voltage cut-off [V]"], values["Upper voltage cut-off [V]"] = 0.1, 10.0
        solver = pybamm.IDAKLUSolver(rtol=1e-9, atol=1e-10)
        model = made.thevenin(power=True, p0_share=P0_SHARE)
        simulation = pybamm.Simulation(model, parameter_values=values, solver=solver)
        solution = simulation.solve(t_eval=at[[0, -1]], t_interp=at)
        voltage = solution["Voltage [V]"](at)
        margin = solution["Margin above lower voltage [V]"](at)
        if numpy.abs(voltage - margin - 2.5).max() > 1e-12:
            raise AssertionError("margins")
        notes.append(discharge.compare(None, voltage[1:]))
    return "; ".join(notes)


MODELICA = """
%s
function profile
  input Real t;
  output Real w;
protected
  constant Real power_w[%d] = {%s};
  Real at;
  Integer k;
algorithm
  at := mod(t / %r, %d.0);
  k := integer(floor(at));
  w := power_w[k + 1] + (at - k) * (power_w[mod(k + 1, %d) + 1] - power_w[k + 1]);
end profile;
model Test
  %s.Cell c(power_in = true, p0_share = %r, soc_start = %r, degc_start = %r);
equation
  c.demand = profile(time);
  c.ambient_degc = %r;
end Test;
"""


@check("Modelica, compiled by Rumoca")
def _():
    import rumoca

    if not SHORT:
        return "left out: its solver takes long"
    notes = []
    for name in ("point", *MAPS):
        # Rumoca is slow where a function has many numbers.
        rows = coarse(73)
        discharge = Discharge(name, *MODELS[name], rows, ALMOST_S[name])
        path = exported(discharge, "modelica")
        count, tick = len(rows), rows[0][0]
        watts = ", ".join(repr(float(MODELS[name][1] * w)) for _, w in rows)
        text = MODELICA % (path.read_text(), count, watts, float(tick), count, count, name, P0_SHARE, START,
                           AMBIENT_DEGC, AMBIENT_DEGC)  # fmt: skip
        model = rumoca.Session().loads(text, model="Test")
        config = rumoca.SimConfig(rtol=1e-9, atol=1e-11)
        found = model.simulate(t=(0, float(discharge.time_s[-1])), dt=float(tick), config=config).to_dict()
        voltage, low_v = (numpy.array(found["data"][f"c.{key}"]) for key in ("terminal_v", "low_v"))
        if numpy.abs(voltage - low_v - 2.5).max() > 1e-12:
            raise AssertionError("margins")
        notes.append(discharge.compare(None, voltage[1:]))
    return "; ".join(notes)


OCTAVE = """
source('%s');
given = dlmread('%s');
Q = 3600 * AH; n = numel(tau_s); tau = tau_s(:);
C = thermal_mass; G = 0; if C > 0, G = thermal_resistance_K_per_W; end
z = %r; T = %r + 273.15; ambient = T; v = zeros(n, 1);
dT = T_vec(2) - T_vec(1); nT = numel(T_vec);
function [row, share] = place(list, x)
  row = max(1, min(lookup(list, x), numel(list) - 1));
  share = (x - list(row)) / (list(row + 1) - list(row));
end
function y = table(m, i, a, j, b)
  y = (1 - a) * ((1 - b) * m(i, j, :) + b * m(i, j + 1, :)) + a * ((1 - b) * m(i + 1, j, :) + b * m(i + 1, j + 1, :));
  y = y(:);
end
function [E, R] = source_of(z, T, v, S, Tv, V0, Rm)
  [i, a] = place(S, z); [j, b] = place(Tv, T);
  E = table(V0, i, a, j, b) - sum(v); R = table(Rm, i, a, j, b);
end
out = zeros(rows(given), 2);
for k = 1:rows(given)
  h = given(k, 1) / given(k, 3); p = given(k, 2); x = h ./ tau; decay = exp(-x); mean_decay = -expm1(-x) ./ x;
  for part = 1:given(k, 3)
    [E, R] = source_of(z, T, v, SOC_vec, T_vec, V0_mat, R_mat);
    i0 = power_current(E, R(1), p, %r);
    if part == 1, out(k, 1) = E - R(1) * i0; end
    w0 = R(1) * i0 ^ 2 + sum(v .^ 2 ./ max(R(2:end), 1e-5)); d0 = R(2:end) * i0;
    i1 = i0; d1 = d0; w1 = w0;
    for round = 1:2
      z1 = z - 0.5 * (i0 + i1) * h / Q;
      T1 = T; if C > 0, s = ambient + G * 0.5 * (w0 + w1); T1 = s + (T - s) * exp(-h / (C * G)); end
      v1 = decay .* v + (mean_decay - decay) .* d0 + (1 - mean_decay) .* d1;
      [E1, R1] = source_of(z1, T1, v1, SOC_vec, T_vec, V0_mat, R_mat);
      i1 = power_current(E1, R1(1), p, %r); d1 = R1(2:end) * i1;
      w1 = R1(1) * i1 ^ 2 + sum(v1 .^ 2 ./ max(R1(2:end), 1e-5));
    end
    z = z - 0.5 * (i0 + i1) * h / Q; T = T1;
    v = decay .* v + (mean_decay - decay) .* d0 + (1 - mean_decay) .* d1;
  end
  [E, R] = source_of(z, T, v, SOC_vec, T_vec, V0_mat, R_mat);
  out(k, 2) = E - R(1) * power_current(E, R(1), p, %r);
end
dlmwrite('%s', out, 'precision', 17);
"""


@check("Simscape's tables, in GNU Octave")
def _():
    if not shutil.which("octave"):
        return "left out: no octave"
    if not SHORT:
        return "left out: a loop in Octave takes long"
    notes = []
    # Octave is slow: longer parts, and fewer watts for the cell that would need short ones beyond its P0.
    for discharge in (Discharge("gentle", MODELS["point"][0], 0.7), DISCHARGES[1]):
        script, given, found = exported(discharge, "simscape"), OUT / "octave.csv", OUT / "octave.out"
        rows = range(min(discharge.count, 60000))
        lengths = numpy.diff(discharge.time_s)
        with given.open("w") as file:
            for row in rows:
                parts = max(1, math.ceil(lengths[row] / (1.5 * STEP_S) - 1e-9))
                file.write(f"{float(lengths[row])!r},{float(discharge.power_w[row])!r},{parts}\n")
        code = OCTAVE % (script, given, START, AMBIENT_DEGC, P0_SHARE, P0_SHARE, P0_SHARE, found)
        (OUT / "run.m").write_text(code)
        done = subprocess.run(["octave", "--no-gui", "--quiet", OUT / "run.m"], capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(done.stderr.strip())
        start_v, end_v = numpy.loadtxt(found, delimiter=",").T
        notes.append(discharge.compare(start_v, end_v))
    return "; ".join(notes)


end()
