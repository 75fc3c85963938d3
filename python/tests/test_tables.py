"""Many spectra as one table, from and to other libraries."""

import csv

import numpy as np
import pytest
from conftest import THESIS, impedance

import eisbench as eb

pd = pytest.importorskip("pandas")
na = pytest.importorskip("nanoarrow")
FREQ_HZ = np.geomspace(0.01, 1000, 16)


def long_form(count=3, sigma=False):
    """Columns of spectra of one RC branch of 20 mΩ."""
    ids, freq, z = [], [], []
    for k in range(count):
        ids += [f"cell {k}"] * len(FREQ_HZ)
        freq.append(FREQ_HZ)
        z.append(impedance(FREQ_HZ, 0.01, [(0.02, 1.0 + k)]))
    z = np.concatenate(z)
    columns = {
        "spectrum_id": ids,
        "freq_hz": np.concatenate(freq),
        "z_re_ohm": z.real,
        "z_im_ohm": z.imag,
    }
    if sigma:
        columns["sigma_ohm"] = 1e-3 * abs(z)
    return columns


KINDS = {
    "mapping": lambda columns: columns,
    "pandas": lambda columns: pd.DataFrame(columns),
    "pyarrow": lambda columns: pytest.importorskip("pyarrow").table(columns),
    "polars": lambda columns: pytest.importorskip("polars").DataFrame(columns),
    "nanoarrow": lambda columns: na.Array(pytest.importorskip("pyarrow").table(columns)),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sigma", [False, True])
def test_tables_of_other_libraries(kind, sigma):
    columns = long_form(sigma=sigma)
    spectra = eb.spectra_of_table(KINDS[kind](columns))
    assert [spectrum.name for spectrum in spectra] == ["cell 0", "cell 1", "cell 2"]
    for k, spectrum in enumerate(spectra):
        expected = impedance(FREQ_HZ, 0.01, [(0.02, 1.0 + k)])
        np.testing.assert_array_equal(spectrum.z_ohm, expected)
        known = np.isfinite(spectrum.covariance_ohm2[:, 0]).all()
        assert known == sigma


@pytest.mark.parametrize("kind", KINDS)
def test_fits_of_a_table(kind):
    table = eb.fit_table(KINDS[kind](long_form()), rc=1, ocv_slope="none")
    assert table["spectrum_id"] == ["cell 0", "cell 1", "cell 2"]
    np.testing.assert_allclose(table["r1_ohm"], 0.02, rtol=1e-6)
    np.testing.assert_allclose(table["c1_f"], [1.0, 2.0, 3.0], rtol=1e-6)
    assert table["error"] == [None] * 3
    assert table["points"].dtype.kind == "i"


@pytest.mark.parametrize("rc", [1, 2, 3, 4, "auto"])
def test_a_row_is_what_a_single_fit_gives(rc):
    spectra = [s for s in eb.read_spectra(THESIS) if s.is_unbiased_cell][:4]
    table = eb.fit_table(spectra, rc)
    for row, spectrum in enumerate(spectra):
        fit = eb.fit_erm(spectrum, rc)
        assert table["r_ohm"][row] == fit.r_ohm
        assert table["objective"][row] == fit.objective
        for k, branch in enumerate(fit.branches, start=1):
            assert table[f"r{k}_ohm"][row] == branch.r_ohm
            assert table[f"c{k}_f"][row] == branch.c_f
        if fit.log_covariance is not None:
            assert table["cov_ln_c1_ln_r1"][row] == fit.log_covariance[2, 1]
        codes = set(filter(None, table["warning_codes"][row].split(";")))
        assert codes == set(fit.raw["warning_codes"])


@pytest.mark.parametrize("circuit", ["R0-p(R1,C1)", "R0-p(R1,CPE1)", "L0-R0-p(R1,C1)-p(R2,C2)"])
def test_circuits_of_a_table(circuit):
    (spectrum, *_) = [s for s in eb.read_spectra(THESIS) if s.is_unbiased_cell]
    table = eb.fit_table([spectrum], circuit=circuit)
    fit = eb.fit_circuit(spectrum, circuit)
    for parameter in fit.parameters:
        assert table[parameter.name][0] == parameter.value
        sigma = table[f"{parameter.name}_sigma"][0]
        assert np.isnan(sigma) if parameter.sigma is None else sigma == parameter.sigma


@pytest.mark.parametrize("drt", [False, True])
def test_validity_of_a_table(drt):
    spectra = [s for s in eb.read_spectra(THESIS) if s.is_unbiased_cell][:3]
    table = eb.kk_table(spectra, drt=drt)
    for row, spectrum in enumerate(spectra):
        assert table["grade"][row] == eb.assess(spectrum).grades[spectrum.name]
        assert table["kk_p"][row] == eb.kk(spectrum)["p"]
        if drt:
            assert table["drt_polarisation_ohm"][row] == eb.drt(spectrum).polarisation_ohm


def test_the_same_table_as_the_program(program, tmp_path):
    file, out = tmp_path / "in.csv", tmp_path / "out.csv"
    pd.DataFrame(long_form(5)).to_csv(file, index=False)
    program("fit", file, "--rc", 2, "--table", out)
    theirs = list(csv.DictReader(out.open()))
    ours = eb.fit_table(pd.DataFrame(long_form(5)), 2)
    for row, entry in enumerate(theirs):
        for name, text in entry.items():
            value = ours[name][row]
            if isinstance(value, (str, type(None))):
                assert text == (value or "")
            else:
                assert (np.isnan(value) and text == "") or float(text) == value, name


@pytest.mark.parametrize("library", ["pandas", "pyarrow", "polars", "duckdb"])
def test_results_are_taken_by_other_libraries(library):
    taker = pytest.importorskip(library)
    columns = long_form()
    columns["z_re_ohm"][3] = np.nan
    table = eb.fit_table(columns, 1, ocv_slope="none")
    if library == "pandas":
        values = table.to_pandas()["r1_ohm"].tolist()
    elif library == "pyarrow":
        values = taker.table(table)["r1_ohm"].to_pylist()
    elif library == "polars":
        values = taker.DataFrame(table)["r1_ohm"].to_list()
    else:
        arrow = pytest.importorskip("pyarrow").table(table)
        values = [row[0] for row in taker.sql("select r1_ohm from arrow").fetchall()]
        assert arrow.num_rows == 3
    assert values[0] is None or np.isnan(values[0])
    np.testing.assert_allclose(values[1:], 0.02, rtol=1e-6)


def test_arrow_texts_and_missing_values():
    pa = pytest.importorskip("pyarrow")
    columns = long_form()
    columns["freq_hz"][0] = -1.0
    table = pa.table(eb.fit_table(columns, 1))
    assert table["spectrum_id"].to_pylist() == ["cell 0", "cell 1", "cell 2"]
    errors = table["error"].to_pylist()
    assert "expected" in errors[0] and errors[1:] == [None, None]
    assert table["r_ohm"].null_count == 1


def test_numbers_go_to_arrow_without_a_copy():
    pa = pytest.importorskip("pyarrow")
    table = eb.Table({"a": np.arange(1000.0)})
    column = pa.table(table)["a"].chunk(0)
    assert column.buffers()[1].address == table["a"].ctypes.data


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.pop("freq_hz"), "expected a column freq_hz"),
        (lambda c: c.pop("z_im_ohm"), "expected a column z_im_ohm"),
        (lambda c: c.update(freq_hz=["x"] * 48), "expected numbers in column freq_hz"),
        (lambda c: c.update(z_re_ohm=c["z_re_ohm"][:-1]), "expected columns of one length"),
        (lambda c: c.update(spectrum_id=[None] * 48), "expected a spectrum_id in every row"),
    ],
    ids=["no freq", "no im", "texts", "lengths", "no id"],
)
def test_tables_that_cannot_be(change, message):
    columns = long_form()
    change(columns)
    with pytest.raises(eb.EisError, match=message):
        eb.fit_table(columns)


def test_other_things_are_no_tables():
    with pytest.raises(eb.EisError, match="expected columns or an Arrow table, met int"):
        eb.fit_table(3)


def test_an_empty_table_gives_an_empty_one():
    empty = {"freq_hz": [], "z_re_ohm": [], "z_im_ohm": []}
    assert eb.fit_table(empty).rows == 0


def test_rows_of_a_spectrum_may_stand_apart():
    columns = pd.DataFrame(long_form()).sample(frac=1.0, random_state=3)
    spectra = {spectrum.name: spectrum for spectrum in eb.spectra_of_table(columns)}
    expected = impedance(FREQ_HZ, 0.01, [(0.02, 2.0)])
    np.testing.assert_array_equal(spectra["cell 1"].z_ohm, expected)


def test_a_table_prints(capsys):
    print(eb.fit_table(long_form(12), 1))
    output = capsys.readouterr().out
    assert "spectrum_id" in output and "… 12 rows" in output
    assert "<table>" in eb.fit_table(long_form(1), 1)._repr_html_()


@pytest.mark.parametrize("rc", [-1, 1.5, "many", None, 99])
def test_orders_that_cannot_be(rc):
    if rc == 99:
        table = eb.fit_table(long_form(1), rc)
        assert "expected 0 to" in table["error"][0]
    else:
        with pytest.raises(eb.EisError, match="rc: expected"):
            eb.fit_table(long_form(1), rc)
