"""Spectra and pulses together: a cell by its own formulas, and the program beside the package."""

import json

import numpy as np
import pytest
from conftest import impedance

import eisbench as eb

R_OHM, BRANCH = 0.010, (0.005, 1600.0)
TAU_S = BRANCH[0] * BRANCH[1]


def record(pulses):
    """A cell of 1 Ah whose open-circuit voltage is 3 V + SOC · 1 V, discharged with 1 A."""
    time_s = 0.2 * np.arange(17_900)
    pulse = (time_s % 600 >= 400) & (time_s % 600 < 410)
    current_a = np.where(pulse & pulses, 2.0, 1.0)
    charge_c = 0.2 * np.concatenate([[0.0], np.cumsum(current_a)[:-1]])
    keep = charge_c < 3590
    decay, v_v = np.exp(-0.2 / TAU_S), BRANCH[0]
    slow_v = []
    for i in current_a:
        slow_v.append(v_v)
        v_v = BRANCH[0] * i + (v_v - BRANCH[0] * i) * decay
    noise_v = np.random.default_rng(5).uniform(-5e-5, 5e-5, len(time_s))
    voltage_v = 4.0 - charge_c / 3600 - current_a * R_OHM - np.array(slow_v) + noise_v
    return {"time_s": time_s[keep], "current_a": current_a[keep], "voltage_v": voltage_v[keep]}


@pytest.fixture(scope="module")
def cell():
    freq_hz = 0.05 * 2.0 ** np.arange(16)
    z_ohm = impedance(freq_hz, R_OHM, [BRANCH])
    draw = np.random.default_rng(3)
    sweeps = [
        eb.Spectrum(f"cell0_{k}", freq_hz, z_ohm * (1 + 5e-4 * draw.standard_normal(16)))
        for k in range(4)
    ]
    curve = eb.ocv(record(False), low_v=2.9, high_v=4.0)
    return sweeps, record(True), curve


@pytest.fixture(scope="module")
def found(cell):
    return eb.joint(*cell, rc=1, at_v=3.5, within_v=0.45)


def test_spectra_and_pulses_give_one_model(found):
    assert found.rc == 1
    assert abs(found.model.r_ohm / R_OHM - 1) < 0.01
    assert abs(found.model.branches[0].r_ohm / BRANCH[0] - 1) < 0.02
    assert found.model.simulate([0, 10], current_a=[5.0, 5.0], soc=0.5).soc[-1] < 0.5
    roles = [pulse.role for pulse in found.pulses]
    assert {"fitted", "held-out"} <= set(roles)
    spectra_v, joint_v = found.held_out_rms_v
    assert joint_v < 1e-4 and joint_v <= 1.2 * spectra_v
    assert abs(found.gain - 1) < 0.02


def test_pulses_are_those_of_the_record(found):
    pulse = next(one for one in found.pulses if one.role == "held-out")
    inside = (pulse.time_s > 0.3) & (pulse.time_s < 9.5)
    expected_v = -(R_OHM + BRANCH[0] * (1 - np.exp(-pulse.time_s[inside] / TAU_S)))
    # 2 A flow during the pulse.
    expected_v -= 2 * pulse.time_s[inside] / 3600
    np.testing.assert_allclose(pulse.measured_v[inside], expected_v, atol=1.5e-3)
    np.testing.assert_allclose(pulse.by_joint_v, pulse.measured_v, atol=1.5e-3)


def test_it_prints_and_shows(found):
    text = str(found)
    assert "spectra alone / mΩ" in text and "pulses held out" in text
    assert "<table>" in found._repr_html_()


def test_it_plots(found):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    axes = found.plot()
    assert axes.get_xlabel() == "time since the edge / s"


def test_the_program_gives_the_same(cell, found, program, tmp_path):
    sweeps, series, curve = cell
    files = []
    for sweep in sweeps:
        file = tmp_path / f"{sweep.name}.csv"
        rows = zip(sweep.freq_hz, sweep.z_ohm.real, sweep.z_ohm.imag)
        lines = [f"{float(f)!r},{float(re)!r},{float(im)!r}" for f, re, im in rows]
        file.write_text("\n".join(["freq_hz,z_re_ohm,z_im_ohm", *lines]) + "\n")
        files.append(file)
    pulsed = tmp_path / "pulsed.bdf.csv"
    rows = zip(series["time_s"], -series["current_a"], series["voltage_v"])
    lines = [f"{float(t)!r},{float(i)!r},{float(v)!r}" for t, i, v in rows]
    pulsed.write_text("\n".join(["Test Time / s,Current / A,Voltage / V", *lines]) + "\n")
    ocv = tmp_path / "ocv.json"
    ocv.write_text(json.dumps(curve.raw["curve"]))
    options = ["--rc", 1, "--at-v", 3.5, "--within-v", 0.45, "--json"]
    words = ["joint", "--spectra", *files, "--series", pulsed, "--ocv", ocv, *options]
    theirs = json.loads(program(*words))
    assert {key: found.raw[key] for key in theirs} == theirs


def test_refusals_are_errors(cell):
    sweeps, series, curve = cell
    with pytest.raises(eb.EisError, match="expected a pulse of 1 to 60 s"):
        eb.joint(sweeps, series, curve, rc=1, at_v=2.0, within_v=0.1)
    with pytest.raises(eb.EisError, match="rc: expected a number or 'auto', met 'many'"):
        eb.joint(sweeps, series, curve, rc="many")
    with pytest.raises(eb.EisError, match="RC branches"):
        eb.joint(sweeps, series, curve, rc=99, at_v=3.5, within_v=0.45)
    with pytest.raises(eb.EisError):
        eb.joint([], series, curve, rc=1)
