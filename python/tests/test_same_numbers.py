"""The package and the program give the same numbers, to the last bit."""

import json

import pytest
from conftest import DATA, THESIS

import eisbench as eb

pytestmark = pytest.mark.filterwarnings("ignore:not fitted")
FILES = [
    THESIS,
    DATA / "cells" / "panasonic_18650pf_25C" / "eis_07.csv",
]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
@pytest.mark.parametrize("rc", [1, 2, 3, 4])
def test_fits_of_each_spectrum(program, file, rc):
    theirs = json.loads(program("fit", file, "--rc", rc, "--json"))["fits"]
    ours = eb.fit_erm(eb.read_spectra(file), rc)
    assert len(ours) == len(theirs)
    for fit, entry in zip(ours, theirs):
        assert {key: fit.raw[key] for key in entry} == entry


@pytest.mark.parametrize("objective", ["complex", "modulus", "sum-abs"])
@pytest.mark.parametrize("rc", [2, 4])
def test_pooled_fits(program, objective, rc):
    words = ["fit", THESIS, "--pool", "--rc", rc, "--objective", objective, "--json"]
    (entry,) = json.loads(program(*words))["fits"]
    fit = eb.fit_erm(eb.read_spectra(THESIS), rc, pool=True, objective=objective)
    assert {key: fit.raw[key] for key in entry} == entry


def test_a_fit_whose_order_the_data_choose(program):
    report = json.loads(program("fit", FILES[1], "--rc", "auto", "--json"))
    (fit,) = eb.fit_erm(eb.read_spectra(FILES[1]), "auto")
    assert {key: fit.raw[key] for key in report["fits"][0]} == report["fits"][0]
    assert fit.order == report["groups"][0]["order_selection"]


@pytest.mark.parametrize("circuit", ["R0-p(R1,C1)-p(R2,C2)", "L0-R0-p(R1,CPE1)-Wo1"])
def test_fits_of_circuits(program, circuit):
    (entry,) = json.loads(program("fit", FILES[1], "--circuit", circuit, "--json"))["fits"]
    (fit,) = eb.fit_circuit(eb.read_spectra(FILES[1]), circuit)
    assert fit.raw == entry


def test_validity_and_relaxation_times(program):
    (cell,) = json.loads(program("kk", FILES[1], "--drt", "--json"))
    (spectrum,) = eb.read_spectra(FILES[1])
    (judged,) = cell["spectra"]
    assert eb.kk(spectrum) == judged["kramers_kronig"]
    assert eb.zhit(spectrum) == judged["z_hit"]
    assert eb.assess(spectrum).spectra[0]["verdict"] == judged["verdict"]
    (times,) = cell["drt"]
    ours = eb.drt(spectrum).raw
    assert ours == {key: times.get(key, times.get("drt", {}).get(key)) for key in ours}
