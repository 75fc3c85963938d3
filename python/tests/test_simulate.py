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
