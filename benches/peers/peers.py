"""What a user could pick instead, timed on the same work as `cargo bench`; one JSON object per line on standard output.

Every figure is processor time of one thread, the best of a few repeats, after compilation and warm-up.
Needs `requirements.txt`.
"""

import importlib.util
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"

import numba  # noqa: E402
import numpy as np  # noqa: E402
from impedance.models.circuits.fitting import circuit_fit  # noqa: E402
from impedance.validation import linKK  # noqa: E402
from scipy.optimize import differential_evolution  # noqa: E402

# impedance.py builds source text from numbers and needs them printed as numpy 1 did.
np.set_printoptions(legacy="1.25")

# Appendix A of the thesis, four RC circuits by rising time constant: R, then (R, C) each.
R0 = 0.006428631596419841
BRANCHES = [
    (0.0015092416058207665, 0.5528122375316784),
    (0.0006627965074183888, 6.979849139650129),
    (0.0004040655126863733, 663.8165189932115),
    (0.004774060802661011, 1084.2430675670112),
]
FREQ_HZ = 0.1 * 3000.0 ** (np.arange(20) / 20.0)


def report(work, peer, **figures):
    """Prints one result."""
    print(json.dumps({"work": work, "peer": peer, **figures}), flush=True)


def best(task, repeats):
    """Least processor time of a few calls, s, and the last result."""
    times = []
    result = None
    for _ in range(repeats):
        start = time.process_time()
        result = task()
        times.append(time.process_time() - start)
    return min(times), result


def impedance(p, freq_hz):
    """ERM from R, R1, C1, R2, C2, ..."""
    s = 2j * np.pi * freq_hz
    z = np.full(len(freq_hz), p[0], dtype=complex)
    for r, c in zip(p[1::2], p[2::2]):
        z += r / (1.0 + s * r * c)
    return z


TRUTH = np.array([R0] + [x for branch in BRANCHES for x in branch])


def noisy(seed, freq_hz=FREQ_HZ, noise=0.005):
    """A spectrum of the appendix' cell with noise relative to |Z|, half of its power in each part."""
    rng = np.random.default_rng(seed)
    z = impedance(TRUTH, freq_hz)
    parts = rng.standard_normal(len(z)) + 1j * rng.standard_normal(len(z))
    return z + noise / np.sqrt(2.0) * np.abs(z) * parts


@numba.njit(fastmath=True)
def fused(a, b, c, d, omega, out):
    """All sums of a known-frequency fit of four channels in one loop over the samples: what one writes at first."""
    for i in range(len(a)):
        cos, sin = np.cos(omega * i), np.sin(omega * i)
        for k, x in enumerate((float(a[i]), float(b[i]), float(c[i]), float(d[i]))):
            out[k, 0] += x * cos
            out[k, 1] += x * sin
            out[k, 2] += x
            out[k, 3] += x * x


@numba.njit(fastmath=True)
def rotated(a, b, c, d, omega, out):
    """The same with the phase turned from sample to sample instead of evaluated."""
    turn_cos, turn_sin = np.cos(omega), np.sin(omega)
    cos, sin = 1.0, 0.0
    for i in range(len(a)):
        for k, x in enumerate((float(a[i]), float(b[i]), float(c[i]), float(d[i]))):
            out[k, 0] += x * cos
            out[k, 1] += x * sin
            out[k, 2] += x
            out[k, 3] += x * x
        cos, sin = cos * turn_cos - sin * turn_sin, cos * turn_sin + sin * turn_cos


@numba.njit(fastmath=True)
def blocked(codes, cos, sin, step_cos, step_sin, out):
    """The same for one channel with a table for the phases within a block: our own idea, in numba."""
    block = len(cos)
    pc, ps = 1.0, 0.0
    for start in range(0, len(codes), block):
        a = b = c = d = 0.0
        for i in range(block):
            x = float(codes[start + i])
            a += x * cos[i]
            b += x * sin[i]
            c += x
            d += x * x
        out[0] += a * pc - b * ps
        out[1] += a * ps + b * pc
        out[2] += c
        out[3] += d
        pc, ps = pc * step_cos - ps * step_sin, pc * step_sin + ps * step_cos


def sine():
    """Known-frequency fit of four channels."""
    samples, block, omega = 10_000_000, 1000, 2.0 * np.pi * 5.0 / 10_000_000
    rng = np.random.default_rng(1)
    t = np.arange(samples)
    wave = 1500.0 * np.cos(omega * t)
    codes = [(np.round(wave * g + rng.standard_normal(samples))).astype(np.int16) for g in (1.0, 0.9, 0.8, 0.7)]
    table = omega * np.arange(block)
    args = (np.cos(table), np.sin(table), np.cos(omega * block), np.sin(omega * block))

    def by_blocks():
        sums = np.zeros((4, 4))
        for channel, out in zip(codes, sums):
            blocked(channel, *args, out)

    works = {
        "numba, one fused loop": lambda: fused(*codes, omega, np.zeros((4, 4))),
        "numba, one fused loop, phase by rotation": lambda: rotated(*codes, omega, np.zeros((4, 4))),
        "numba, blocks with a phase table": by_blocks,
    }
    for peer, work in works.items():
        work()
        seconds, _ = best(work, 5)
        report("sine-known", peer, samples_per_cpu_s=4 * samples / seconds)

    part = 1_000_000

    wave_and_line = [lambda n: np.cos(omega * n), lambda n: np.sin(omega * n), np.ones_like, lambda n: n / part]
    decays = [lambda n, share=share: np.exp(-n / (share * part)) for share in (0.03, 0.12, 0.4)]
    for work, columns in (("sine-known", wave_and_line), ("sine-settling", wave_and_line + decays)):

        def lstsq(columns=columns):
            n = t[:part].astype(float)
            design = np.column_stack([column(n) for column in columns])
            return np.linalg.lstsq(design, np.column_stack([c[:part] for c in codes]).astype(float), rcond=None)[0]

        seconds, _ = best(lstsq, 3)
        report(work, "numpy lstsq, the same columns", samples_per_cpu_s=4 * part / seconds)


def fits():
    """Global and local fits of the ERM with four RC pairs."""
    bounds_log = [(np.log(1e-6), np.log(0.1))] + [(np.log(1e-6), np.log(0.1)), (np.log(1e-2), np.log(1e5))] * 4
    bounds = [(1e-6, 0.1)] + [(1e-6, 0.1), (1e-2, 1e5)] * 4
    seconds = []
    for seed in range(3):
        z = noisy(seed)
        seconds.append(
            best(
                lambda z=z: differential_evolution(lambda p: np.abs(impedance(p, FREQ_HZ) - z).sum(), bounds, seed=1), 1
            )[0]
        )
    report(
        "fit-global-4rc",
        "scipy differential evolution, the thesis' objective and bounds",
        seconds=float(np.median(seconds)),
    )
    seconds = []
    for seed in range(3):
        z = noisy(seed)
        value = lambda p, z=z: (np.abs((impedance(np.exp(p), FREQ_HZ) - z) / np.abs(z)) ** 2).sum()  # noqa: E731
        seconds.append(best(lambda value=value: differential_evolution(value, bounds_log, seed=1), 1)[0])
    report(
        "fit-global-4rc",
        "scipy differential evolution, relative least squares, logarithmic bounds",
        seconds=float(np.median(seconds)),
    )
    circuit = "R0-p(R1,C1)-p(R2,C2)-p(R3,C3)-p(R4,C4)"
    limits = ([b[0] for b in bounds], [b[1] for b in bounds])
    seconds = []
    for seed in range(5):
        z = noisy(seed)
        fit = lambda z=z: circuit_fit(  # noqa: E731
            FREQ_HZ, z, circuit, list(TRUTH * 1.1), bounds=limits, weight_by_modulus=True
        )
        seconds.append(best(fit, 1)[0])
    report("fit-local-4rc", "impedance.py, good start", seconds=float(np.median(seconds)))


def kramers_kronig():
    """Linear Kramers-Kronig test with automatic order."""
    for points in (20, 57):
        freq_hz = np.logspace(-1, 3.75, points) if points > 20 else FREQ_HZ
        z = noisy(1, freq_hz, 0.002)
        linKK(freq_hz, z, fit_type="complex")
        seconds, _ = best(lambda f=freq_hz, z=z: linKK(f, z, fit_type="complex"), 5)
        report(f"lin-kk-{points}", "impedance.py linKK", seconds=seconds)


@numba.njit(fastmath=True)
def forward_loop(power_w, ocv_v, r_ohm, gain, decay, v, out):
    """Four RC branches under a power profile: voltage from the quadratic, then an exponential step of every branch."""
    for k in range(len(power_w)):
        e = ocv_v - (v[0] + v[1] + v[2] + v[3])
        ccv = 0.5 * (e + np.sqrt(e * e - 4.0 * power_w[k] * r_ohm))
        i = power_w[k] / ccv
        for b in range(4):
            v[b] = v[b] * decay[b] + i * gain[b]
        out[k] = ccv


def forward():
    """60 s at 10 kHz."""
    steps, dt = 600_000, 1e-4
    power = 20.0 + 20.0 * np.sin(np.arange(steps) * dt)
    tau = np.array([r * c for r, c in BRANCHES])
    decay = np.exp(-dt / tau)
    gain = np.array([r for r, _ in BRANCHES]) * (1.0 - decay)
    out = np.zeros(steps)
    run = lambda: forward_loop(power, 3.72, R0, gain, decay, np.zeros(4), out)  # noqa: E731
    run()
    seconds, _ = best(run, 5)
    report("forward-4rc", "numba loop, one cell", steps_per_cpu_s=steps / seconds)
    forward_map()


MAP = pathlib.Path(__file__).parents[2] / "fixtures/data/cells/panasonic_18650pf_25C/map_6rc.json"
AMBIENT_DEGC = 15.0


def resistances(surface, map_degc, degc):
    """Resistance of a surface at its SOC knots and one temperature: the mean of Arrhenius' law from both nodes."""
    inverse = 1.0 / (np.array(map_degc) + 273.15)
    here = 1.0 / (degc + 273.15)
    share = np.clip((here - inverse[0]) / (inverse[1] - inverse[0]), 0.0, 1.0)
    factors = np.exp(surface["activation_j_per_mol"] / 8.31446261815324 * (here - inverse))
    return (np.array([1.0 - share, share]) * factors) @ np.array(surface["r_ohm"])


@numba.njit(fastmath=True)
def between(z, knots):
    """Index of the knot before a SOC, and the share of the next one."""
    k = min(max(np.searchsorted(knots, z) - 1, 0), len(knots) - 2)
    return k, min(max((z - knots[k]) / (knots[k + 1] - knots[k]), 0.0), 1.0)


@numba.njit(fastmath=True)
def map_loop(power_w, dt, coulomb, curve, knots, table, tau_s, z, out):
    """A map at one temperature: OCV correction and resistances over SOC, the voltage from the quadratic, then an
    exponential step of every branch. Of first order in the step, and the OCV is linear between its knots."""
    branches = len(tau_s)
    v = np.zeros(branches)
    decay = np.exp(-dt / tau_s)
    for k in range(len(power_w)):
        low, share = between(z, curve[0])
        e = curve[1, low] + share * (curve[1, low + 1] - curve[1, low])
        low, share = between(z, knots)
        e += table[0, low] + share * (table[0, low + 1] - table[0, low])
        for b in range(branches):
            e -= v[b]
        r = table[1, low] + share * (table[1, low + 1] - table[1, low])
        ccv = 0.5 * (e + np.sqrt(e * e - 4.0 * power_w[k] * r))
        i = power_w[k] / ccv
        for b in range(branches):
            r = table[2 + b, low] + share * (table[2 + b, low + 1] - table[2 + b, low])
            v[b] = v[b] * decay[b] + r * (1.0 - decay[b]) * i
        z -= i * dt / coulomb
        out[k] = ccv
    return z


def forward_map():
    """The fitted map of six branches under a tenth of the power of `forward_map.rs`: numba, and PyBaMM's Thevenin."""
    file = json.loads(MAP.read_text())
    cell, ocv = file["map"], file["ocv"]
    steps, dt = 600_000, 1e-4
    t = np.arange(steps) * dt
    power = 0.1 * (60.0 + 40.0 * np.sin(7.0 * t) + np.where((3.0 * t) % 1.0 < 0.2, 60.0, 0.0))
    at_ambient = lambda surface: resistances(surface, cell["temperature_degc"], AMBIENT_DEGC)  # noqa: E731
    warmer_k = AMBIENT_DEGC - cell["ocv_temperature_degc"]
    offset_v = np.array(cell["ocv_offset_v"]) + warmer_k * np.array(cell["ocv_v_per_k"])
    branches = [at_ambient(branch["resistance"]) for branch in cell["branches"]]
    table = np.array([offset_v, at_ambient(cell["series"]), *branches])
    tau_s = np.array([branch["tau_s"] for branch in cell["branches"]])
    curve = np.array([ocv["soc"], ocv["ocv_v"]])
    knots, coulomb, out = np.array(cell["soc"]), 3600.0 * ocv["capacity_ah"], np.zeros(steps)
    run = lambda: map_loop(power, dt, coulomb, curve, knots, table, tau_s, 0.5, out)  # noqa: E731
    run()
    seconds, _ = best(run, 5)
    report("forward-map", "numba loop, one cell, one temperature, first order", steps_per_cpu_s=steps / seconds)
    thevenin_of_map(t, power, out)


def thevenin_of_map(t, power, expected_v):
    """PyBaMM's Thevenin with the export of the map; its own time steps, the voltage at every time of the power."""
    try:
        import pybamm
    except ImportError:
        return
    program = os.environ.get("EIS_BENCH", str(pathlib.Path(__file__).parents[2] / "target/debug/eis-bench"))
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [program, "convert", MAP, "--to", "pybamm", "--out", folder], check=True, stdout=subprocess.DEVNULL
        )
        spec = importlib.util.spec_from_file_location("map_pybamm", f"{folder}/map_6rc_pybamm.py")
        exported = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(exported)
    pybamm.set_logging_level("ERROR")
    # A hundredth of the time: the solver takes minutes for the whole.
    t, power, expected_v = t[::10][:6000], power[::10][:6000], expected_v[::10][:6000]
    values = pybamm.ParameterValues(exported.get_parameter_values())
    values["Power function [W]"] = pybamm.Interpolant(t, power, pybamm.t, interpolator="linear")
    values["Initial temperature [K]"] = values["Ambient temperature [K]"] = AMBIENT_DEGC + 273.15
    model = exported.thevenin(power=True)
    solver = pybamm.IDAKLUSolver(rtol=1e-6, atol=1e-6)
    simulation = pybamm.Simulation(model, parameter_values=values, solver=solver)
    solve = lambda: simulation.solve(t_eval=t[[0, -1]], t_interp=t)  # noqa: E731
    solve()
    seconds, solution = best(solve, 3)
    apart_v = np.abs(solution["Voltage [V]"](t) - expected_v).max()
    report(
        "forward-map",
        f"PyBaMM Thevenin, points of output 1 ms apart, within {1e6 * apart_v:.0f} µV of numba",
        steps_per_cpu_s=len(t) / seconds,
    )


def main():
    """Runs the peers named on the command line, or all."""
    tasks = {"sine": sine, "fits": fits, "kk": kramers_kronig, "forward": forward}
    for name in sys.argv[1:] or tasks:
        tasks[name]()


if __name__ == "__main__":
    main()
