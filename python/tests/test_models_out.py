"""Models for other programs, and the power that they can give."""

import ast
import json
import zipfile

import numpy as np
import pytest

import eisbench as eb


@pytest.fixture
def cell():
    model = eb.Model(0.01, [(0.005, 100.0), (0.004, 5000.0)])
    return model.with_ocv(4.5, [0.0, 0.5, 1.0], [3.0, 3.7, 4.2])


@pytest.mark.parametrize(
    ("to", "text"),
    [
        ("c", "#"),
        ("pybamm", "get_parameter_values"),
        ("casadi", "def "),
        ("simscape", "R0_mat = "),
        ("modelica", "model Cell "),
    ],
)
def test_the_text_of_a_model(cell, to, text):
    assert text in cell.code(to)


def test_an_unknown_program(cell):
    with pytest.raises(eb.EisError, match="to: expected c, pybamm, casadi, simscape or modelica, met \"matlab\""):
        cell.code("matlab")


@pytest.mark.parametrize("to", ["c", "pybamm", "casadi", "simscape", "modelica"])
def test_a_text_needs_an_open_circuit_voltage(to):
    with pytest.raises(eb.EisError, match="open-circuit voltage"):
        eb.Model(0.01).code(to)


@pytest.mark.parametrize("to", ["pybamm", "casadi"])
def test_texts_of_a_model_file_do_not_become_code(tmp_path, to):
    evil = "x\nEVIL = 1\rEVIL = 1\n\"\"\"EVIL"
    content = {"name": evil, "r_ohm": 0.01, "branches": [], "warnings": [evil]}
    content["ocv"] = {"capacity_ah": 4.5, "soc": [0, 1], "ocv_v": [3, 4.2], "slope_v": [1.2, 1.2]}
    file = tmp_path / "model.json"
    file.write_text(json.dumps(content))
    tree = ast.parse(eb.Model.read(file).code(to))
    names = [node.id for node in ast.walk(tree) if isinstance(node, ast.Name)]
    assert "R_OHM" in names or "MAP_SOC" in names
    assert "EVIL" not in names


def test_an_fmu_holds_its_description_its_sources_and_a_library(cell, tmp_path):
    file = tmp_path / "cell.fmu"
    cell.write_fmu(file)
    names = zipfile.ZipFile(file).namelist()
    assert {"modelDescription.xml", "sources/fmu.c", "sources/model.h"} <= set(names)
    assert any(name.endswith(".so") for name in names)
    assert list(tmp_path.iterdir()) == [file]
    with pytest.raises(eb.EisError, match="missing/cell.fmu"):
        cell.write_fmu(tmp_path / "missing" / "cell.fmu")
    with pytest.raises(eb.EisError, match="open-circuit voltage"):
        eb.Model(0.01).write_fmu(file)


def test_without_a_compiler_an_fmu_holds_sources(cell, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.warns(UserWarning, match="holds sources only: cc: "):
        cell.write_fmu(tmp_path / "cell.fmu")
    names = zipfile.ZipFile(tmp_path / "cell.fmu").namelist()
    assert "sources/fmu.c" in names and not any(name.endswith(".so") for name in names)


@pytest.mark.parametrize("current_a", [-10.0, 1.0, 20.0])
def test_a_casadi_step_is_that_of_a_simulation(cell, current_a):
    pytest.importorskip("casadi")
    step = cell.to_casadi()
    state = np.zeros(step.numel_in(0))
    state[0] = 0.5
    for _ in range(10):
        following, volts = step(state, current_a, 1.0)
        state = np.asarray(following).ravel()
    run = cell.simulate([0, 10], current_a=[current_a] * 2, soc=0.5)
    assert abs(float(volts) - run.ccv_v[-1]) < 1e-6


@pytest.mark.parametrize("duration_s", [0.1, 1.0, 10.0, 60.0])
@pytest.mark.parametrize("soc", [0.2, 0.5, 0.9])
def test_the_power_that_is_told_can_be_held(cell, duration_s, soc):
    limits = cell.sop(duration_s, soc=soc)
    assert limits.discharge_w > 0 > limits.charge_w
    for power_w, bound in [(limits.discharge_w, 2.5), (limits.charge_w, 4.2)]:
        run = cell.simulate([0, duration_s], power_w=[power_w] * 2, soc=soc)
        assert run.summary["feasible"]
        assert abs(run.ccv_v - bound).min() < 2e-3 or "maximum" in limits.discharge_limited_by


def test_a_pack_gives_the_power_of_its_cells(cell):
    one, pack = cell.sop(10.0), cell.sop(10.0, series=16, parallel=3)
    assert abs(pack.discharge_w / (48 * one.discharge_w) - 1) < 1e-6


def test_a_current_limits_the_power(cell):
    limits = cell.sop(1.0, discharge_a=5.0)
    assert limits.discharge_limited_by == "current"
    assert limits.discharge_w < cell.sop(1.0).discharge_w


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan"), float("inf")])
def test_durations_that_cannot_be(cell, duration_s):
    with pytest.raises(eb.EisError, match="expected"):
        cell.sop(duration_s)


@pytest.mark.parametrize("soc", [-0.1, 1.1, float("nan")])
def test_states_that_cannot_be(cell, soc):
    with pytest.raises(eb.EisError, match="expected"):
        cell.sop(1.0, soc=soc)
