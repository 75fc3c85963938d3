"""What is not as expected is refused with a sentence; nothing panics, nothing is guessed."""

import numpy as np
import pytest

import eisbench as eb

FREQ_HZ = np.geomspace(0.1, 1000, 9)
Z_OHM = 0.01 + 0.005 / (1 + 2j * np.pi * FREQ_HZ * 0.01)


@pytest.mark.parametrize(
    ("freq_hz", "z_ohm"),
    [
        (FREQ_HZ, Z_OHM[:-1]),
        (FREQ_HZ[:0], Z_OHM[:0]),
        (np.where(FREQ_HZ > 500, np.nan, FREQ_HZ), Z_OHM),
        (FREQ_HZ, np.where(FREQ_HZ > 500, np.nan, Z_OHM)),
        (FREQ_HZ, np.where(FREQ_HZ > 500, np.inf, Z_OHM)),
        (-FREQ_HZ, Z_OHM),
        (0 * FREQ_HZ, Z_OHM),
    ],
    ids=["lengths", "empty", "freq nan", "z nan", "z inf", "negative", "zero"],
)
def test_spectra_that_cannot_be(freq_hz, z_ohm):
    with pytest.raises(eb.EisError, match="expected"):
        eb.Spectrum("s", freq_hz, z_ohm)


@pytest.mark.parametrize("shape", [(3, 3), (9, 1)])
def test_arrays_of_another_shape(shape):
    with pytest.raises((TypeError, ValueError)):
        eb.Spectrum("s", np.resize(FREQ_HZ, shape), Z_OHM)


@pytest.mark.parametrize(
    ("text", "line", "field"),
    [
        ("freq_hz,z_re_ohm,z_im_ohm\n1,2,x\n", 2, "z_im_ohm"),
        ("freq_hz,z_re_ohm,z_im_ohm\n1,2\n", 2, "3"),
        ("freq_hz,z_re_ohm,z_im_ohm\n", None, None),
        ("what is this\n", 1, None),
        ("", None, None),
    ],
    ids=["no number", "fields", "no rows", "unknown", "empty"],
)
def test_files_are_refused_with_their_place(tmp_path, text, line, field):
    file = tmp_path / "cell.csv"
    file.write_text(text)
    with pytest.raises(eb.FileError, match="cell.csv") as refused:
        eb.read_spectra(file)
    error = refused.value
    assert (error.file, error.line, error.field) == (str(file), line, field)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(eb.FileError, match="none.csv"):
        eb.read_spectra(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda s: eb.fit_erm(s, 99), "RC branches"),
        (lambda s: eb.fit_erm(s.between(1, 50), 4), "need as many points"),
        (lambda s: eb.fit_erm(s, 2, ocv_slope="steep"), "ocv_slope: expected `fit`, `none`"),
        (lambda s: eb.fit_erm(s, 2, objective="modulus", ocv_slope="fit"), "objective complex"),
        (lambda s: eb.fit_erm(s, "many"), "rc: expected"),
        (lambda s: eb.fit_erm(s, 2, objective="best"), "objective: expected"),
        (lambda s: eb.fit_erm([], 2), "at least one spectrum"),
        (lambda s: eb.fit_circuit(s, "R0-p(R1"), "expected"),
        (lambda s: eb.fit_circuit(s, "R0", guess={"R9": 1.0}), "guess: expected one of R0"),
        (lambda s: eb.fit_circuit(s, "R0", weight="none"), "weight"),
        (lambda s: eb.circuit_impedance("R0-C1", [1.0], [1.0]), "expected 2 values"),
        (lambda s: s.between(1e6, 1e7), "expected points"),
        (lambda s: eb.spectra_of_table({"freq_hz": [1.0]}), "column z_re_ohm"),
        (
            lambda s: eb.spectra_of_table({"freq_hz": [1.0], "z_re_ohm": [1, 2], "z_im_ohm": [1]}),
            "one length",
        ),
        (
            lambda s: eb.spectra_of_table({"freq_hz": ["a"], "z_re_ohm": [1], "z_im_ohm": [1]}),
            "numbers in column freq_hz",
        ),
        (lambda s: eb.fit_erm(s, -1), "rc: expected 0 or more"),
        (lambda s: eb.fit_erm(s, 2, seed=-1), "seed: expected 0 or more"),
    ],
)
def test_arguments_that_cannot_be(call, words):
    with pytest.raises(eb.EisError, match=words):
        call(eb.Spectrum("s", FREQ_HZ, Z_OHM))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"current_a": [1, 1]}, "OCV"),
        ({"current_a": [1, 1], "power_w": [1, 1], "ocv_v": 3.7}, "one of current_a and power_w"),
        ({"ocv_v": 3.7}, "one of current_a and power_w"),
        ({"current_a": [1], "ocv_v": 3.7}, "for each of 2 times"),
        ({"current_a": [1, np.nan], "ocv_v": 3.7}, "finite"),
        ({"current_a": [1, 1], "ocv_v": np.nan}, "expected"),
        ({"current_a": [1, 1], "ocv_v": 3.7, "series": 0}, "expected"),
        ({"current_a": [1, 1], "ocv_v": 3.7, "beyond": "fly"}, "stop, clamp or extrapolate"),
        ({"current_a": [1, 1], "ocv_v": 3.7, "max_step_s": 0.0}, "longest step"),
        ({"current_a": [1, 1], "ocv_v": 3.7, "max_step_s": 1e-12}, "longest step"),
    ],
)
def test_simulations_that_cannot_be(options, words):
    with pytest.raises(eb.EisError, match=words):
        eb.Model(0.01, [(0.005, 10.0)]).simulate([0.0, 1.0], **options)


@pytest.mark.parametrize("branch", [(-1.0, 1.0), (1.0, 0.0), (np.nan, 1.0), (1.0, np.inf)])
def test_models_that_cannot_be(branch):
    with pytest.raises(eb.EisError):
        eb.Model(0.01, [branch])


def test_a_curve_needs_a_state_of_charge():
    model = eb.Model(0.01).with_ocv(4.5, [0.0, 1.0], [3.0, 4.2])
    with pytest.raises(eb.EisError, match="state of charge"):
        model.simulate([0, 1], current_a=[1, 1])


def test_times_that_go_back():
    with pytest.raises(eb.EisError, match="later than the row before"):
        eb.Model(0.01).simulate([0.0, 1.0, 1.0], current_a=[1, 1, 1], ocv_v=3.7)
