"""Records over time, captures, open-circuit voltages, diagnosis, folders of runs."""

import json
import subprocess

import numpy as np
import pytest
from conftest import DATA, ROOT

import eisbench as eb

OCV_SOC = np.linspace(0, 1, 21)
OCV_V = 3.0 + 1.2 * OCV_SOC


def slow_discharge(noise_v=0.0, seed=1):
    """C/20 from full to empty: 4.5 Ah, a line as open-circuit voltage, 15 mΩ."""
    time_s = np.linspace(0, 20 * 3600, 4001)
    current_a = np.full(4001, 4.5 / 20)
    soc = 1 - time_s / time_s[-1]
    noise = noise_v * np.random.default_rng(seed).standard_normal(4001)
    voltage_v = 3.0 + 1.2 * soc - 0.015 * current_a + noise
    return {"time_s": time_s, "current_a": current_a, "voltage_v": voltage_v}


def test_the_open_circuit_voltage_of_a_line():
    found = eb.ocv(slow_discharge(), low_v=2.95, high_v=4.25)
    assert abs(found.capacity_ah - 4.5) < 1e-6
    at_v = np.interp(OCV_SOC, found.soc, found.ocv_v)
    np.testing.assert_allclose(at_v, OCV_V, atol=2e-3)
    assert "capacity" in str(found)


def test_noise_is_told():
    found = eb.ocv(slow_discharge(noise_v=1e-3), low_v=2.9, high_v=4.3)
    assert 0.8e-3 < found.raw["noise_v"] < 1.2e-3
    assert 0 < found.sigma_v < 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.pop("voltage_v"), "expected a column voltage_v"),
        (lambda r: r.update(time_s=r["time_s"][::-1]), "expected"),
        (lambda r: r.update(current_a=-r["current_a"]), "expected"),
        (lambda r: r.update(voltage_v=np.full(4001, np.nan)), "expected"),
        (lambda r: r.update(voltage_v=r["voltage_v"][:-1]), "expected"),
    ],
    ids=["column", "time", "charge", "nan", "lengths"],
)
def test_records_that_cannot_be(change, message):
    record = slow_discharge()
    change(record)
    with pytest.raises(eb.EisError, match=message):
        eb.ocv(record)


def test_a_record_of_a_cycler():
    file = next((DATA / "series").glob("*.csv"))
    series = eb.read_series(file)
    assert (np.diff(series.time_s) > 0).all()
    assert len(series.time_s) == len(series.current_a) == len(series.voltage_v) == series.rows
    other = eb.read_series(file, sign="discharge")
    turned = eb.read_series(file, sign="charge")
    np.testing.assert_array_equal(other.current_a, -turned.current_a)


@pytest.mark.parametrize("text", ["", "time_s,voltage_v\n1,2\n", "time_s,voltage_v,current_a\n1,2,x\n"])
def test_files_that_are_no_records(tmp_path, text):
    file = tmp_path / "series.csv"
    file.write_text(text)
    with pytest.raises(eb.EisError, match="series.csv"):
        eb.read_series(file)


def test_an_unknown_sign():
    with pytest.raises(eb.EisError, match="sign: expected"):
        eb.read_series("x.csv", sign="left")


def pulses(r_ohm, seed, noise_v=5e-5, tau_s=20.0):
    """Five pulses from rest at half charge with one branch, its model being the caller's."""
    time_s = np.arange(0, 600.0)
    current_a = np.where((time_s % 120 > 20) & (time_s % 120 < 60), 5.0, 0.0)
    v, soc, volts = 0.0, 0.5, []
    for i in current_a:
        volts.append(3.0 + 1.2 * soc - r_ohm * i - v)
        decay = np.exp(-1.0 / tau_s)
        v = v * decay + 0.005 * i * (1 - decay)
        soc -= i / (4.5 * 3600)
    noise = noise_v * np.random.default_rng(seed).standard_normal(len(time_s))
    return {"time_s": time_s, "current_a": current_a, "voltage_v": np.array(volts) + noise}


def model(r_ohm=0.01, tau_s=20.0):
    cell = eb.Model(r_ohm, [(0.005, tau_s / 0.005)])
    return cell.with_ocv(4.5, OCV_SOC, OCV_V)


def data_set(r_ohm=0.01, tau_s=20.0):
    records = {f"pulses {k}": pulses(r_ohm, k, tau_s=tau_s) for k in range(4)}
    data = eb.DataSet.from_frames(records, soc=0.5, repeat_group="pulses")
    data.add_series("later", pulses(r_ohm, 9, tau_s=tau_s), soc=0.5, held_out=True)
    return data


def test_a_model_that_is_right_is_said_to_be():
    diagnosis = eb.diagnose(data_set(), model())
    assert diagnosis.verdict == "at_noise_floor", diagnosis.summary
    assert diagnosis.summary in str(diagnosis)


def test_a_branch_that_is_missing_is_told():
    without = eb.Model(0.01, []).with_ocv(4.5, OCV_SOC, OCV_V)
    diagnosis = eb.diagnose(data_set(), without)
    assert diagnosis.verdict != "at_noise_floor", diagnosis.summary


def test_a_data_set_needs_a_state_and_names_of_its_own():
    data = eb.DataSet()
    with pytest.raises(eb.EisError, match="expected soc or ocv_v.*met neither"):
        data.add_series("a", pulses(0.01, 1))
    with pytest.raises(eb.EisError, match="met both"):
        data.add_series("a", pulses(0.01, 1), soc=0.5, ocv_v=3.7)
    data.add_series("a", pulses(0.01, 1), soc=0.5)
    with pytest.raises(eb.EisError, match="met it twice"):
        data.add_series("a", pulses(0.01, 1), soc=0.5)
    assert len(data) == 1


def test_a_diagnosis_needs_an_open_circuit_voltage():
    with pytest.raises(eb.EisError, match="with_ocv"):
        eb.diagnose(data_set(), eb.Model(0.01))


def test_a_data_set_without_runs_is_refused():
    verdict = None
    try:
        verdict = eb.diagnose(eb.DataSet(), model()).verdict
    except eb.EisError as error:
        assert "expected" in str(error)
    assert verdict in (None, "invalid")


@pytest.fixture(scope="session")
def run_folder(program, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "demo"
    try:
        program("run", ROOT / "configs" / "experiments" / "demo.toml", "--out", out)
    except subprocess.CalledProcessError as error:
        pytest.fail(error.stderr[-2000:])
    return eb.Run(out)


def test_a_run_gives_its_parts(run_folder):
    assert run_folder.manifest
    spectra = run_folder.spectra
    assert spectra and all(len(spectrum) > 3 for spectrum in spectra)
    assert run_folder.models and run_folder.models[0].r_ohm > 0
    readings = run_folder.readings
    assert readings.rows > 0 and "voltage_v" in readings.columns
    assert repr(run_folder).startswith("<Run: ")


def test_a_capture_gives_codes_and_volts(run_folder):
    capture = eb.read_capture(run_folder.captures[0])
    assert capture.columns == ["code_c1", "code_c2", "code_c3", "code_c4"]
    assert len(capture.time_s) == capture.rows > 0
    scale = capture.about["channels"][0]
    volts = capture["code_c1"] * scale["volts_per_code"] - scale["offset_v"]
    np.testing.assert_array_equal(capture.volts(1), volts)
    with pytest.raises(eb.EisError, match="channel: expected 1 to 4"):
        capture.volts(5)


def test_a_damaged_capture_is_refused(run_folder, tmp_path):
    whole = bytearray(run_folder.captures[0].read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    file = tmp_path / "capture.parquet"
    file.write_bytes(whole)
    with pytest.raises(eb.EisError, match="capture.parquet"):
        eb.read_capture(file)


@pytest.mark.parametrize("make", [False, True])
def test_folders_that_are_no_runs(tmp_path, make):
    folder = tmp_path / "nothing"
    if make:
        folder.mkdir()
    with pytest.raises(eb.EisError, match="expected"):
        eb.Run(folder)


def test_a_curve_comes_back_from_its_file_and_goes_into_a_model(tmp_path):
    curve = {"capacity_ah": 4.5, "soc": [0.0, 0.5, 1.0], "ocv_v": [3.0, 3.7, 4.2]}
    file = tmp_path / "ocv.json"
    file.write_text(json.dumps(curve))
    read = eb.Ocv.read(file)
    assert read.capacity_ah == 4.5 and read.ocv_v.tolist() == curve["ocv_v"]
    model = eb.Model(0.01)
    by_hand = model.with_ocv(4.5, curve["soc"], curve["ocv_v"])
    load = {"current_a": [5.0, 5.0], "soc": 0.7}
    one, other = (m.simulate([0, 60], **load) for m in (model.with_ocv(read), by_hand))
    assert one.ccv_v.tolist() == other.ccv_v.tolist()
    file.write_text('{"soc": [0, 1]}')
    with pytest.raises(eb.FileError, match="expected capacity_ah and a curve of soc and ocv_v"):
        eb.Ocv.read(file)


def test_workbooks_and_binary_files_are_read():
    arbin = eb.read_series(DATA / "series" / "arbin.xlsx")
    assert len(arbin.time_s) == 8 and arbin.current_a[0] == 1.5
    sheets = eb.read_spectra(DATA / "spectra" / "vendors" / "sheets.xlsx")
    assert [sheet.name for sheet in sheets] == ["sheets.xlsx#10 degC", "sheets.xlsx#25 degC"]
    (zahner,) = eb.read_spectra(DATA / "spectra" / "vendors" / "zahner.ism")
    fit = eb.fit_circuit(zahner, "L0-R0-p(R1,C1)")
    assert abs(fit["R0"].value / 0.012 - 1) < 1e-6 and abs(fit["L0"].value / 2e-8 - 1) < 1e-6


def test_a_circuit_in_pyimpspec_s_notation_with_values():
    (zahner,) = eb.read_spectra(DATA / "spectra" / "vendors" / "zahner.ism")
    fit = eb.fit_circuit(zahner, "[L{L=1E-8}R{R=0.01}(R{R=0.03}C{C=1.0})]")
    by_name = {parameter.name: parameter.value for parameter in fit.parameters}
    expected = {"R": [0.012, 0.02], "C": [1.5], "L": [2e-8]}
    for kind, values in expected.items():
        met = [value for name, value in by_name.items() if name.startswith(kind)]
        np.testing.assert_allclose(met, values, rtol=1e-6)
