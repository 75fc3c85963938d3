"""Simulations against other solvers."""

import numpy as np
import pytest

import eisbench as eb

hypothesis = pytest.importorskip("hypothesis")
st = pytest.importorskip("hypothesis.strategies")
integrate = pytest.importorskip("scipy.integrate")


@hypothesis.settings(max_examples=60, deadline=None)
@hypothesis.given(
    r_ohm=st.floats(1e-3, 0.05),
    branches=st.lists(
        st.tuples(st.floats(1e-4, 0.05), st.floats(0.5, 2e3)), min_size=1, max_size=4
    ),
    currents=st.lists(st.floats(-40, 40), min_size=2, max_size=8),
    step_s=st.floats(0.05, 50),
)
def test_currents_against_scipy(r_ohm, branches, currents, step_s):
    time_s = step_s * np.arange(len(currents))
    run = eb.Model(r_ohm, branches).simulate(time_s, current_a=currents, ocv_v=3.7)
    tau_s = np.array([r * c for r, c in branches])
    r_rc = np.array([r for r, _ in branches])
    v_v = np.zeros(len(branches))
    at_end = {0.0: 0.0}
    for k in range(len(currents) - 1):
        solved = integrate.solve_ivp(
            lambda _, v, i=currents[k]: (r_rc * i - v) / tau_s,
            (time_s[k], time_s[k + 1]),
            v_v,
            method="Radau",
            rtol=1e-9,
            atol=1e-11,
        )
        v_v = solved.y[:, -1]
        at_end[time_s[k + 1]] = v_v.sum()
    for end_s, drop_v in at_end.items():
        rows = np.flatnonzero(run.time_s == end_s)
        mine_v = run["ocv_v"][rows] - r_ohm * run.current_a[rows] - run.ccv_v[rows]
        np.testing.assert_allclose(mine_v, drop_v, atol=1e-6)


def test_a_power_is_delivered_and_the_charge_is_counted():
    model = eb.Model(0.01, [(0.005, 100.0)]).with_ocv(4.5, [0.0, 1.0], [3.0, 4.2])
    run = model.simulate([0, 60], power_w=[30.0, 30.0], soc=0.8, max_step_s=1.0)
    np.testing.assert_allclose(run.ccv_v * run.current_a, 30.0, rtol=1e-9)
    charge_c = np.trapezoid(run.current_a, run.time_s)
    assert abs(charge_c / run.summary["charge_c"] - 1) < 1e-4
    assert abs((0.8 - run.soc[-1]) * 4.5 * 3600 / charge_c - 1) < 1e-4


def test_a_pack_is_as_many_cells():
    model = eb.Model(0.01, [(0.005, 100.0)])
    cell = model.simulate([0, 10], current_a=[10.0, 10.0], ocv_v=3.7)
    pack = model.simulate([0, 10], current_a=[30.0, 30.0], ocv_v=3.7, series=16, parallel=3)
    np.testing.assert_allclose(pack.ccv_v, 16 * cell.ccv_v, rtol=1e-12)


def test_power_that_cannot_be_had_is_told():
    run = eb.Model(0.01).simulate([0, 1], power_w=[1e6, 1e6], ocv_v=3.7)
    assert not run.summary["feasible"]


def test_a_fit_becomes_a_model(two_rc):
    fit = eb.fit_erm(two_rc, 2, ocv_slope="none")
    model = eb.Model.from_fit(fit)
    assert model.dc_resistance_ohm == fit.dc_resistance_ohm
    np.testing.assert_array_equal(model.impedance([1.0]), fit.impedance([1.0]))


def test_a_model_is_read(tmp_path):
    file = tmp_path / "cell.json"
    file.write_text('{"r_ohm": 0.005, "branches": [{"r_ohm": 0.003, "c_f": 10.0}]}')
    model = eb.Model.read(file)
    assert model.name == "cell" and model.dc_resistance_ohm == 0.008
    file.write_text('{"r_ohm": -1, "branches": []}')
    with pytest.raises(eb.EisError, match="cell.json"):
        eb.Model.read(file)


def test_a_run_is_drawn_and_printed():
    pytest.importorskip("matplotlib").use("Agg")
    run = eb.Model(0.01).simulate([0, 1], current_a=[1.0, 1.0], ocv_v=3.7)
    assert run.plot().get_xlabel() == "time / s" and "feasible" in str(run)
    assert list(pytest.importorskip("pandas").DataFrame(run.columns)["current_a"]) == [1.0, 1.0]


@hypothesis.settings(max_examples=40, deadline=None)
@hypothesis.given(
    r_ohm=st.floats(1e-3, 0.05),
    r1_ohm=st.floats(1e-3, 0.05),
    c1_f=st.floats(1.0, 2e3),
    current_a=st.floats(-40, 40),
    end_s=st.floats(0.1, 100),
)
def test_sensitivities_are_those_of_the_closed_form(r_ohm, r1_ohm, c1_f, current_a, end_s):
    model = eb.Model(r_ohm, [(r1_ohm, c1_f)])
    table = model.sensitivities([0, end_s], current_a=[current_a] * 2, ocv_v=3.7)
    t, tau_s = table["time_s"], r1_ohm * c1_f
    decay = np.exp(-t / tau_s)
    close = {"rtol": 1e-9, "atol": 1e-11}
    np.testing.assert_allclose(table["R"], -current_a, **close)
    by_r1 = -current_a * (1 - decay - t / tau_s * decay)
    np.testing.assert_allclose(table["R1"], by_r1, rtol=1e-7, atol=1e-9)
    by_c1 = current_a * r1_ohm * t / (tau_s * c1_f) * decay
    np.testing.assert_allclose(table["C1"], by_c1, rtol=1e-7, atol=1e-11)
    np.testing.assert_allclose(table["ocv_v"], 1.0, **close)
    np.testing.assert_allclose(table["demand"], table["ccv_v"] - 3.7, rtol=1e-9, atol=1e-9)


def test_sensitivities_under_power_are_differences_of_simulations():
    truth = {"R": 0.01, "R1": 0.005, "C1": 100.0}

    def end_v(**changed):
        p = truth | changed
        model = eb.Model(p["R"], [(p["R1"], p["C1"])]).with_ocv(4.5, [0, 1], [3.0, 4.2])
        return model.simulate([0, 60], power_w=[30.0, 30.0], soc=0.8, max_step_s=0.05).ccv_v[-1]

    model = eb.Model(0.01, [(0.005, 100.0)]).with_ocv(4.5, [0, 1], [3.0, 4.2])
    table = model.sensitivities([0, 60], power_w=[30.0, 30.0], soc=0.8, max_step_s=0.05)
    for name, value in truth.items():
        step = 1e-3 * value
        slope = (end_v(**{name: value + step}) - end_v(**{name: value - step})) / (2 * step)
        assert abs(table[name][-1] - slope) < 1e-4 * abs(slope) + 1e-7
    with pytest.raises(eb.EisError, match="expected soc"):
        model.sensitivities([0, 60], power_w=[30.0, 30.0])
