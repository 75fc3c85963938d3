"""Fits find what was put in, and say how sure they are."""

import numpy as np
import pytest
from conftest import THESIS, impedance

import eisbench as eb


def test_the_thesis_is_met():
    with pytest.warns(UserWarning, match="shunt_0"):
        fit = eb.fit_erm(eb.read_spectra(THESIS), rc=4, pool=True, objective="sum-abs")
    assert round(fit.objective, 6) == 0.033027
    assert fit.rc == 4 and len(fit.branches) == 4
    assert [b.tau_s for b in fit.branches] == sorted(b.tau_s for b in fit.branches)


@pytest.mark.parametrize("seed", range(5))
def test_two_branches_are_found_within_their_intervals(seed):
    freq_hz = np.geomspace(0.01, 1000, 25)
    z_ohm = impedance(freq_hz, 0.006, [(0.002, 1.0), (0.004, 500.0)])
    sigma_ohm = 1e-3 * abs(z_ohm)
    draw = np.random.default_rng(seed)
    noise = draw.standard_normal(25) + 1j * draw.standard_normal(25)
    spectrum = eb.Spectrum("s", freq_hz, z_ohm + sigma_ohm * noise, sigma_ohm)
    fit = eb.fit_erm(spectrum, 2, ocv_slope="none")
    truth = {"R": 0.006, "R1": 0.002, "C1": 1.0, "R2": 0.004, "C2": 500.0}
    off = [(fit[name].value - true) / fit[name].sigma for name, true in truth.items()]
    assert max(map(abs, off)) < 4.0
    assert 0.4 < fit.reduced_chi2 < 2.0


def test_the_data_choose_two_branches(two_rc):
    assert eb.fit_erm(two_rc, "auto").rc == 2


def test_impedances_are_those_of_the_formula(two_rc):
    fit = eb.fit_erm(two_rc, 2, ocv_slope="none")
    freq_hz = np.geomspace(0.1, 100, 7)
    by_hand = impedance(freq_hz, fit.r_ohm, [(b.r_ohm, b.c_f) for b in fit.branches])
    np.testing.assert_allclose(fit.impedance(freq_hz), by_hand, rtol=1e-13)


def test_a_stored_charge_is_taken_out_and_expected_to_be_measured(two_rc):
    slope = 1e-5
    z_ohm = two_rc.z_ohm - 1j * slope / (2 * np.pi * two_rc.freq_hz)
    sigma_ohm = np.sqrt(two_rc.covariance_ohm2[:, 0])
    spectrum = eb.Spectrum("stored", two_rc.freq_hz, z_ohm, sigma_ohm)
    fit = eb.fit_erm(spectrum, 2)
    sigma = fit.raw["charge_storage"]["sigma_v_per_c"]
    assert abs(fit.ocv_slope_v_per_c - slope) < 4 * sigma < slope
    assert abs(fit.dc_resistance_ohm / 0.012 - 1) < 0.01
    assert np.max(abs(fit.impedance(two_rc.freq_hz) - z_ohm) / abs(z_ohm)) < 0.005
    known = eb.fit_erm(spectrum, 2, ocv_slope=slope)
    assert abs(known.dc_resistance_ohm / 0.012 - 1) < 0.005


@pytest.mark.parametrize("circuit", ["R0-p(R1,C1)-p(R2,C2)", "R0-p(R1,CPE1)-p(R2,C2)"])
def test_circuits_need_no_start_values(two_rc, circuit):
    fit = eb.fit_circuit(two_rc, circuit)
    assert fit.rms_ohm < 3e-5
    freq_hz = np.geomspace(0.1, 100, 7)
    same = eb.circuit_impedance(circuit, fit.values, freq_hz)
    np.testing.assert_array_equal(fit.impedance(freq_hz), same)


def test_a_constant_is_held(two_rc):
    fit = eb.fit_circuit(two_rc, "R0-p(R1,C1)-p(R2,C2)", constants={"R0": 0.0061})
    assert fit["R0"].value == 0.0061 and fit["R0"].sigma is None
    assert fit.states["R0"] == "constant"


def test_the_covariance_is_that_of_the_sigmas(two_rc):
    fit = eb.fit_erm(two_rc, 2)
    relative = [p.sigma / p.value for p in fit.parameters]
    np.testing.assert_allclose(np.sqrt(np.diag(fit.log_covariance)), relative, rtol=1e-9)


def test_relaxation_times_have_the_area_of_the_branches(two_rc):
    found = eb.drt(two_rc)
    assert abs(found.polarisation_ohm / 0.006 - 1) < 0.05
    times = sorted(peak["tau_s"] for peak in found.peaks if peak["in_band"])
    assert abs(np.log10(times[0] / 0.002)) < 0.2 and abs(np.log10(times[-1] / 2.0)) < 0.2
    assert found.tau_s.shape == found.gamma_ohm.shape == found.sigma_ohm.shape


def test_a_good_spectrum_is_good_and_a_broken_one_bad(two_rc):
    assert eb.assess(two_rc).grades == {"two": "good"}
    z_ohm = two_rc.z_ohm.copy()
    z_ohm[12] *= 1.3
    sigma_ohm = np.sqrt(two_rc.covariance_ohm2[:, 0])
    broken = eb.Spectrum("broken", two_rc.freq_hz, z_ohm, sigma_ohm)
    assert eb.assess(broken).grades == {"broken": "bad"}


def test_a_table_of_many_gives_a_table(two_rc):
    pandas = pytest.importorskip("pandas")
    frames = [
        pandas.DataFrame(
            {
                "spectrum_id": name,
                "freq_hz": two_rc.freq_hz,
                "z_re_ohm": factor * two_rc.z_ohm.real,
                "z_im_ohm": factor * two_rc.z_ohm.imag,
            }
        )
        for name, factor in [("b", 1.0), ("a", 2.0), ("c", 3.0)]
    ]
    short = frames[0].head(2).assign(spectrum_id="short")
    fitted = eb.fit_table(pandas.concat([*frames, short]), rc=2)
    assert fitted["spectrum_id"] == ["b", "a", "c", "short"]
    np.testing.assert_allclose(fitted["r_ohm"][:3] / fitted["r_ohm"][0], [1.0, 2.0, 3.0], rtol=1e-3)
    assert [error is None for error in fitted["error"]] == [True, True, True, False]
    assert "need as many points" in fitted["error"][3]


def test_a_table_of_fits_has_the_columns_of_all(two_rc):
    fits = eb.Fits([eb.fit_erm(two_rc, 1), eb.fit_erm(two_rc, 2)])
    assert "sigma_C2" in str(fits).splitlines()[0]


def test_results_print(two_rc):
    fit = eb.fit_erm(two_rc, 2)
    assert "R1" in str(fit) and "<table>" in fit._repr_html_() and "2 RC" in repr(fit)
    fits = eb.fit_erm([two_rc, two_rc], 1)
    assert str(fits).count("two") == 2 and "<table>" in fits._repr_html_()
    assert "good" in str(eb.assess(two_rc)) and "mΩ" in str(eb.drt(two_rc))
    assert "two" in str(eb.Spectra([two_rc]))


def test_pictures_are_drawn(two_rc):
    pytest.importorskip("matplotlib").use("Agg")
    assert eb.fit_erm(two_rc, 2).plot().get_xlabel() == "Re Z / mΩ"
    assert eb.drt(two_rc).plot().get_xscale() == "log"
