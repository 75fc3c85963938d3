"""The law of power for CasADi: against the simulation, and its derivatives against the complex step and differences."""

import json
from pathlib import Path

import numpy as np
import pytest

import eisbench as eb

casadi = pytest.importorskip("casadi")

ROOT = Path(__file__).parents[2]
CELLS = 48
R_OHM = 0.0064286
BRANCHES = [(0.001509, 0.5528), (0.0006628, 6.9798), (0.0004041, 663.8), (0.004774, 1084.2)]


@pytest.fixture(scope="module")
def cell():
    ocv = json.loads((ROOT / "fixtures/data/cells/p45b_25C/ocv.json").read_text())
    return eb.Model(R_OHM, BRANCHES).with_ocv(ocv["capacity_ah"], ocv["soc"], ocv["ocv_v"])


@pytest.fixture(scope="module", params=[None, 0.03], ids=["linear", "bent"])
def mapped(request, tmp_path_factory):
    def surface(ohm):
        ohms = [[ohm * cold * z for z in (2.0, 1.0, 1.2)] for cold in (2.0, 1.0)]
        return {"activation_j_per_mol": 25e3, "r_ohm": ohms}

    branches = [(3e-3, 2.0), (6e-3, 60.0)]
    tables = {
        "soc": [0.1, 0.5, 1.0],
        "temperature_degc": [0.0, 25.0],
        "series": surface(7e-3),
        "branches": [{"tau_s": tau_s, "resistance": surface(ohm)} for ohm, tau_s in branches],
        "ocv_offset_v": [0.002, 0.0, -0.003],
        "ocv_v_per_k": [1e-4, 0.0, -1e-4],
        "ocv_temperature_degc": 25.0,
        "thermal": {"capacity_j_per_k": 60.0, "resistance_k_per_w": 6.0},
    }
    if request.param:
        law = {"voltage_v": request.param, "slowest_s": 100.0}
        tables["charge_transfer"] = law
    ocv = {"capacity_ah": 4.5, "soc": [0, 0.5, 1], "ocv_v": [3, 3.7, 4.2], "slope_v": [2, 1.1, 1]}
    file = tmp_path_factory.mktemp("map") / "map.json"
    plain = {"r_ohm": 7e-3, "branches": [], "map": tables, "ocv": ocv}
    file.write_text(json.dumps({"name": "map", **plain}))
    return eb.Model.read(file)


def profiles():
    for name in ("gap_2m", "lateral_jump", "spin_jump", "walking"):
        path = ROOT / "fixtures/data/profiles" / f"{name}.csv"
        time_s, power_w = np.loadtxt(path, delimiter=",", skiprows=1).T
        yield pytest.param(time_s, power_w / CELLS, 0.95, 1e-4, id=name)
    powers_w = [100, 430, -60, 455, 0, 500, 530, -5, 440, 1]
    yield pytest.param(0.003 * np.arange(10), np.array(powers_w, float), 0.9, 2e-5, id="beyond")


@pytest.mark.parametrize(("time_s", "power_w", "share", "longest_s"), list(profiles()))
def test_a_profile_is_that_of_the_simulation(cell, time_s, power_w, share, longest_s):
    run = cell.simulate(time_s, power_w=power_w, soc=0.6, beyond="extrapolate", fraction=share)
    look = cell.to_casadi("look")
    state, row, worst_v = np.array([0.6, 0, 0, 0, 0]), 0, 0.0
    steps = {}
    for now_s, end_s, power in zip(time_s, time_s[1:], power_w):
        parts = int(np.ceil((end_s - now_s) / longest_s - 1e-9))
        if parts not in steps:
            steps[parts] = cell.to_casadi("power_step", parts=parts)
        following, terminal_v, *_ = steps[parts](state, power, end_s - now_s, share)
        worst_v = max(worst_v, abs(float(terminal_v) - run.ccv_v[row]))
        state, row = np.asarray(following).ravel(), row + 1
        assert abs(run.time_s[row] - end_s) < 1e-9
        terminal_v, current_a, low_v, high_v = map(float, look(state, power, share))
        worst_v = max(worst_v, abs(terminal_v - run.ccv_v[row]))
        assert abs(current_a - run.current_a[row]) < 1e-2
        assert abs(low_v - (terminal_v - 2.5)) < 1e-12 and abs(high_v - (4.2 - terminal_v)) < 1e-12
        row += int(row + 1 < len(run.time_s) and run.time_s[row + 1] == run.time_s[row])
    print(f"{1e6 * worst_v:.2f} µV")
    assert worst_v < 10e-6
    assert run.summary["feasible"] == (power_w.max() < 300)


def test_a_map_under_power_is_that_of_the_simulation(mapped):
    step, look = mapped.to_casadi("power_step"), mapped.to_casadi("look")
    assert step.name_in() == ["state", "power_w", "dt_s", "p0_share", "ambient_degc"]
    state, worst_v = np.array([0.95, 25.0, 0.0, 0.0]), 0.0
    run = mapped.simulate([0, 60, 120, 180], power_w=[40, 5, -30, 0], soc=0.95, max_step_s=60)
    for power_w, end_s in [(40, 60), (5, 120), (-30, 180)]:
        state = step.mapaccum(600)(state, power_w, 0.1, 0.95, 25.0)[0][:, -1]
        at = int(np.argmax(np.abs(run.time_s - end_s) < 1e-9))
        worst_v = max(worst_v, abs(float(look(state, power_w, 0.95)[0]) - run.ccv_v[at]))
    print(f"{1e6 * worst_v:.2f} µV, {float(state[1]):.2f} °C")
    assert worst_v < 10e-6 and float(state[1]) > 25.5


class Plain:
    """Power step and law anew, from the equations of the thesis, for complex numbers too."""

    def __init__(self, soc, ocv_v, slope_v, capacity_ah):
        self.knots, self.capacity_c = (soc, ocv_v, slope_v), 3600 * capacity_ah

    def ocv(self, z):
        soc, ocv_v, slope_v = self.knots
        k = int(np.clip(np.searchsorted(soc, z.real, side="right") - 1, 0, len(soc) - 2))
        h = soc[k + 1] - soc[k]
        t = (z - soc[k]) / h
        return (
            (1 + 2 * t) * (1 - t) ** 2 * ocv_v[k]
            + t * (1 - t) ** 2 * h * slope_v[k]
            + t**2 * (3 - 2 * t) * ocv_v[k + 1]
            + t**2 * (t - 1) * h * slope_v[k + 1]
        )

    def volts(self, x, power_w, share):
        """Open-circuit voltage less the branches, and equations 4.5 and 4.13."""
        e = self.ocv(x[0]) - sum(x[1:])
        p0 = share * e**2 / (4 * R_OHM)
        if power_w.real <= p0.real:
            return e, (e + np.sqrt(e**2 - 4 * power_w * R_OHM)) / 2
        root = np.sqrt(e**2 - 4 * p0 * R_OHM)
        return e, (e + root) / 2 - R_OHM / root * (power_w - p0)

    def look(self, z):
        x, power_w, share = z[:5], z[5], z[-1]
        e, ccv = self.volts(x, power_w, share)
        return np.array([ccv, (e - ccv) / R_OHM, ccv - 2.5, 4.2 - ccv])

    def step(self, z):
        x, power_w, dt_s, share = z[:5], z[5], z[6], z[7]
        start = self.look(np.array([*x, power_w, share]))

        def moved(i0, i1):
            following = [x[0] - dt_s * (i0 + i1) / 2 / self.capacity_c]
            for v, (r, c) in zip(x[1:], BRANCHES):
                q = dt_s / (r * c)
                a = np.exp(-q)
                m = (1 - a) / q
                following.append(a * v + r * ((m - a) * i0 + (1 - m) * i1))
            return np.array(following)

        ahead = moved(start[1], start[1])
        end_a = self.look(np.array([*ahead, power_w, share]))[1]
        return np.array([*moved(start[1], end_a), *start])


def plain(cell):
    names = {}
    exec(cell.code("casadi"), names)
    knots = [np.array(names[key]) for key in ("KNOT_SOC", "KNOT_OCV_V", "KNOT_SLOPE_V")]
    return Plain(*knots, names["CAPACITY_C"] / 3600)


def points(rng, count):
    """State, power (charge, discharge, beyond P₀ and P*), step and P₀, away from the joint and the knots."""
    for k in range(count):
        soc = rng.integers(20, 180) / 200 + 0.0025 + rng.uniform(-0.001, 0.001)
        power_w = (rng.uniform(-200, -1), rng.uniform(1, 350), rng.uniform(520, 900))[k % 3]
        yield np.array([soc, *rng.uniform(-0.05, 0.1, 4), power_w, rng.uniform(2e-3, 0.05), rng.uniform(0.7, 0.97)])


def test_the_jacobian_is_that_of_the_complex_step(cell):
    step, model = cell.to_casadi("power_step"), plain(cell)
    inputs = step.sx_in()
    jacobian = casadi.Function(
        "j", inputs, [casadi.jacobian(casadi.vertcat(*step(*inputs)), casadi.vertcat(*inputs))]
    )
    worst = 0.0
    for z in points(np.random.default_rng(1), 60):
        split = (z[:5], *z[5:])
        value = np.concatenate([np.asarray(part).ravel() for part in step(*split)])
        assert np.abs(value - model.step(z.astype(complex)).real).max() < 1e-11
        met = np.asarray(jacobian(*split))
        for column in range(8):
            moved = z.astype(complex)
            moved[column] += 1e-30j
            exact = model.step(moved).imag / 1e-30
            apart, scale = np.abs(met[:, column] - exact).max(), np.abs(exact).max()
            # Up to P₀ nothing depends on it.
            assert scale > 0 or (column == 7 and apart == 0)
            worst = max(worst, apart / max(scale, 1e-300))
    print(f"{worst:.1e}")
    assert worst < 1e-8


@pytest.mark.parametrize("order", [1, 2])
def test_hessian_times_vector_is_the_difference_of_gradients(cell, order):
    step = cell.to_casadi("power_step", order=order)
    inputs = step.sx_in()
    weights, direction = casadi.SX.sym("w", 9), casadi.SX.sym("d", 8)
    variables = casadi.vertcat(*inputs)
    gradient = casadi.gradient(casadi.dot(weights, casadi.vertcat(*step(*inputs))), variables)
    product = casadi.jtimes(gradient, variables, direction)
    slope = casadi.Function("g", [*inputs, weights], [gradient])
    product = casadi.Function("h", [*inputs, weights, direction], [product])
    rng, worst = np.random.default_rng(2), 0.0
    size = np.array([1e-1, 1e-1, 1e-1, 1e-1, 1e-1, 100, 1e-2, 0.1])
    for z in points(rng, 60):
        w, d = rng.normal(size=9), rng.normal(size=8) * size

        def along(h, z=z, w=w, d=d):
            moved = z + h * d
            return np.asarray(slope(moved[:5], *moved[5:], w)).ravel()

        # Central differences, extrapolated twice.
        rough = [(along(h) - along(-h)) / (2 * h) for h in (4e-4, 2e-4, 1e-4)]
        finer = [(4 * b - a) / 3 for a, b in zip(rough, rough[1:])]
        exact = (16 * finer[1] - finer[0]) / 15
        met = np.asarray(product(z[:5], *z[5:], w, d)).ravel()
        worst = max(worst, (np.abs(met - exact) * size).max() / (np.abs(exact) * size).max())
    print(f"order {order}: {worst:.1e}")
    assert worst < 1e-8


def test_random_states_and_powers_have_numbers_and_derivatives(cell, mapped):
    rng, count = np.random.default_rng(3), 4_000
    for model, states in [(cell, 5), (mapped, 4)]:
        for order in (1, 2):
            step = model.to_casadi("power_step", order=order)
            inputs = step.mx_in()
            outputs = casadi.vertcat(*step(*inputs))
            jacobian = casadi.jacobian(outputs, casadi.vertcat(*inputs))
            many = casadi.Function("all", inputs, [outputs, jacobian]).map(count)
            state = rng.uniform(-1, 2, (states, count))
            if states == 4:
                state[1] = rng.uniform(-60, 120, count)
            power_w = 10 ** rng.uniform(-3, 5, count) * rng.choice([-1, 1, 1], count)
            dt_s, share = 10 ** rng.uniform(-6, 2, count), rng.uniform(0.05, 0.9999, count)
            more = [np.full(count, 25.0)] * (len(inputs) - 4)
            for met in many(state, power_w, dt_s, share, *more):
                assert np.isfinite(np.asarray(met)).all()
            # A step of no length is one, with its derivatives.
            met = many(state, power_w, 0 * dt_s, share, *more)
            assert all(np.isfinite(np.asarray(one)).all() for one in met)
            assert np.allclose(np.asarray(met[0])[[0, *range(2, states)]], state[[0, *range(2, states)]])


def test_the_second_order_has_a_curvature_at_p0_and_the_first_a_jump(cell):
    power_w, share, soc = casadi.SX.sym("p"), 0.9, 0.5025
    ocv_v = plain(cell).ocv(np.complex128(soc)).real
    p0_w = share * ocv_v**2 / (4 * R_OHM)
    for order, kept in [(1, 0.0), (2, 1.0)]:
        ccv_v = cell.to_casadi("look", order=order)(cell_at_rest(soc), power_w, share)[0]
        second = casadi.Function("d2", [power_w], [casadi.hessian(ccv_v, power_w)[0]])
        below, above = float(second(p0_w * (1 - 1e-9))), float(second(p0_w * (1 + 1e-9)))
        assert below < 0 and abs(above / below - kept) < 1e-6
        slope = casadi.Function("d1", [power_w], [casadi.gradient(ccv_v, power_w)])
        # At the end of its curvature, the largest power, the second order goes on along its own tangent.
        ends = [float(slope(p0_w / share * (1 + side))) for side in (-1e-9, 1e-9, 1.0)]
        assert np.allclose(ends, ends[0], rtol=1e-7) and ends[0] < 0
    # Neither costs anything up to P₀.
    first, second = (cell.to_casadi("look", order=order) for order in (1, 2))
    assert float(first(cell_at_rest(soc), p0_w, share)[0]) == float(second(cell_at_rest(soc), p0_w, share)[0])


def cell_at_rest(soc):
    return casadi.DM([soc, 0, 0, 0, 0])


def test_mx_maps_share_their_horizon(cell):
    step = cell.to_casadi("power_step", parts=2)
    state, power_w = casadi.MX.sym("x", 5, 4), casadi.MX.sym("p", 1, 4)
    following, *_, low_v, high_v = step.map(4)(state, power_w, 0.01, 0.95)
    slope = casadi.Function("s", [state, power_w], [low_v, casadi.jacobian(casadi.vec(low_v), casadi.vec(power_w))])
    at = np.tile([[0.6], [0], [0], [0], [0]], 4)
    met, slopes = (np.asarray(one) for one in slope(at, [10, 20, 30, 700]))
    assert following.shape == (5, 4) and high_v.shape == (1, 4)
    assert (np.diff(met.ravel()) < 0).all() and met[0, 3] < 0 < met[0, 2]
    assert np.count_nonzero(slopes) == 4 and (np.diag(slopes) < 0).all()


def test_p0_has_a_default_and_other_functions_are_refused(cell):
    step = cell.to_casadi("power_step")
    call = {"state": cell_at_rest(0.5), "dt_s": 0.01, "power_w": 700}
    default, given = step(**call), step(**call, p0_share=0.95)
    assert float(default["terminal_v"]) == float(given["terminal_v"])
    assert float(step(**call, p0_share=0.8)["terminal_v"]) > float(given["terminal_v"])
    with pytest.raises(eb.EisError, match="to_casadi: expected step, look or power_step, met 'law'"):
        cell.to_casadi("law")
    look = eb.Model(0.01).with_ocv(4.5, [0, 1], [3, 4.2]).to_casadi("look")
    assert abs(float(look([0.5], 10, 0.95)[0]) - 3.5722) < 1e-3
