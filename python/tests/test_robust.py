"""Whatever is given, there is a result or a sentence: no panic, no crash."""

import numpy as np
import pytest

import eisbench as eb

hypothesis = pytest.importorskip("hypothesis")
st = pytest.importorskip("hypothesis.strategies")
ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)
QUICK = hypothesis.settings(
    max_examples=80, deadline=None, suppress_health_check=list(hypothesis.HealthCheck)
)


def tried(work):
    """Runs something that may be refused by a sentence, and by nothing else."""
    try:
        return work()
    except eb.InternalError as error:
        raise AssertionError(f"a panic: {error}") from error
    except (eb.EisError, TypeError, OverflowError) as error:
        assert str(error)
        return None


@QUICK
@hypothesis.given(st.lists(st.tuples(ANY, ANY, ANY), max_size=12), st.integers(0, 5))
def test_fits_of_any_numbers(points, rc):
    freq_hz = np.array([p[0] for p in points])
    z_ohm = np.array([complex(p[1], p[2]) for p in points], dtype=complex)
    spectrum = tried(lambda: eb.Spectrum("any", freq_hz, z_ohm))
    if spectrum is not None:
        tried(lambda: eb.fit_erm(spectrum, rc))


@QUICK
@hypothesis.given(
    st.lists(st.tuples(st.floats(1e-9, 1e12), ANY, ANY), min_size=4, max_size=30, unique_by=lambda p: p[0])
)
def test_validity_of_any_numbers(points):
    freq_hz = np.array([p[0] for p in points])
    z_ohm = np.array([complex(p[1], p[2]) for p in points], dtype=complex)
    spectrum = tried(lambda: eb.Spectrum("any", freq_hz, z_ohm))
    if spectrum is not None:
        tried(lambda: eb.assess(spectrum))
        tried(lambda: eb.drt(spectrum))


@QUICK
@hypothesis.given(ANY, st.lists(st.tuples(ANY, ANY), max_size=4), st.lists(ANY, max_size=6), ANY)
def test_simulations_of_any_numbers(r_ohm, branches, currents, ocv_v):
    model = tried(lambda: eb.Model(r_ohm, branches))
    if model is not None:
        time_s = np.arange(len(currents), dtype=float)
        tried(lambda: model.simulate(time_s, current_a=currents, ocv_v=ocv_v))
        tried(lambda: model.simulate(time_s, power_w=currents, ocv_v=ocv_v))


@QUICK
@hypothesis.given(st.text(max_size=30))
def test_circuits_of_any_text(text):
    tried(lambda: eb.circuit_impedance(text, [1.0], [1.0]))


@QUICK
@hypothesis.given(st.binary(max_size=400))
def test_files_of_any_bytes(tmp_path_factory, content):
    file = tmp_path_factory.mktemp("any") / "file"
    file.write_bytes(content)
    tried(lambda: eb.read_spectra(file))
    tried(lambda: eb.read_series(file))
    tried(lambda: eb.read_capture(file))
    tried(lambda: eb.Model.read(file))


@pytest.mark.parametrize("size", [1e-300, 1e-150, 1e150, 1e300])
@pytest.mark.parametrize("work", ["fit_erm", "fit_circuit", "assess", "drt"])
def test_huge_and_tiny_impedances(size, work):
    freq_hz = np.geomspace(0.01, 1e4, 25)
    z_ohm = size * (1 + 1 / (1 + 2j * np.pi * freq_hz * 0.1))
    spectrum = eb.Spectrum("huge", freq_hz, z_ohm)
    words = {"fit_erm": (1,), "fit_circuit": ("R0-p(R1,C1)",)}.get(work, ())
    tried(lambda: getattr(eb, work)(spectrum, *words))


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("work", ["fit_erm", "fit_circuit", "assess", "drt"])
def test_spectra_of_few_points(count, work):
    freq_hz = np.geomspace(0.01, 1e4, count) if count > 1 else np.array([1.0])
    spectrum = eb.Spectrum("few", freq_hz, 1 / (1 + 2j * np.pi * freq_hz * 0.1))
    words = {"fit_erm": (1,), "fit_circuit": ("R0-p(R1,C1)",)}.get(work, ())
    tried(lambda: getattr(eb, work)(spectrum, *words))


def test_a_long_spectrum_is_fitted():
    freq_hz = np.geomspace(0.01, 1e4, 100_000)
    z_ohm = 0.01 + 0.02 / (1 + 2j * np.pi * freq_hz * 0.02)
    fit = eb.fit_erm(eb.Spectrum("long", freq_hz, z_ohm), 1, ocv_slope="none")
    assert abs(fit.branches[0].r_ohm / 0.02 - 1) < 1e-6
