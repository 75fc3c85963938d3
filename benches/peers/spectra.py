"""Fits and tests of spectra from Python: eisbench beside impedance.py and pyimpspec, in one run.

    python benches/peers/spectra.py [--spectra 1000] [--slow 100]

Needs eisbench, impedance and pyimpspec. The truth and the noise are made here by their formulas.
Times are of one core, processor time: every program runs one fit after the other. A fit counts as
at the best known optimum where its weighted sum of squares is within 0.1 % of the least that any
of the programs and the fit from the truth have found. `--slow` spectra go to what takes long.
"""

import argparse
import os
import time
import warnings

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np  # noqa: E402

import eisbench as eb  # noqa: E402

warnings.simplefilter("ignore")
FREQ_HZ = np.geomspace(0.01, 1e4, 31)
OMEGA = 2 * np.pi * FREQ_HZ
NOISE = 0.003


def two_rc(p):
    r0, r1, c1, r2, c2 = p
    return r0 + r1 / (1 + 1j * OMEGA * r1 * c1) + r2 / (1 + 1j * OMEGA * r2 * c2)


def cpe(p):
    r0, r1, q, a = p
    return r0 + 1 / (1 / r1 + q * (1j * OMEGA) ** a)


CIRCUITS = {
    "R0-p(R1,C1)-p(R2,C2)": (
        "R(RC)(RC)",
        two_rc,
        lambda draw: [
            10 ** draw.uniform(-2.5, -1.8),
            (r1 := 10 ** draw.uniform(-3.2, -2.2)),
            10 ** draw.uniform(-3.5, -1.5) / r1,
            (r2 := 10 ** draw.uniform(-3.2, -2.2)),
            10 ** draw.uniform(-0.5, 0.8) / r2,
        ],
    ),
    "R0-p(R1,CPE1)": (
        "R(RQ)",
        cpe,
        lambda draw: [
            10 ** draw.uniform(-2.5, -1.8),
            (r1 := 10 ** draw.uniform(-3.0, -2.0)),
            10 ** draw.uniform(-2.5, 0.0) / r1,
            draw.uniform(0.7, 0.95),
        ],
    ),
}


def processor_s(work):
    start = time.process_time()
    result = work()
    return result, time.process_time() - start


def squares(model, values, z_ohm):
    return float(np.sum(np.abs((model(values) - z_ohm) / (NOISE * np.abs(z_ohm))) ** 2))


def least(model, truth, z_ohm):
    """The optimum by SciPy from the truth, in the logarithms."""
    from scipy.optimize import least_squares

    weight = 1 / (NOISE * np.abs(z_ohm))

    def residual(x):
        left = (model(np.exp(x)) - z_ohm) * weight
        return np.concatenate([left.real, left.imag])

    return 2 * least_squares(residual, np.log(truth), method="lm", xtol=1e-12, ftol=1e-12).cost


def fits(count, slow):
    from impedance.models.circuits import CustomCircuit

    for circuit, (description, model, drawn) in CIRCUITS.items():
        draw = np.random.default_rng(2711)
        truths = [drawn(draw) for _ in range(count)]
        measured = []
        for truth in truths:
            z_ohm = model(truth)
            noise = draw.standard_normal(31) + 1j * draw.standard_normal(31)
            measured.append(z_ohm + NOISE / np.sqrt(2) * np.abs(z_ohm) * noise)
        best = [least(model, truth, z_ohm) for truth, z_ohm in zip(truths, measured)]
        print(f"\n{circuit}, {count} spectra of 31 points, {100 * NOISE} % of noise")

        spectra = [eb.Spectrum(f"s{k}", FREQ_HZ, z_ohm) for k, z_ohm in enumerate(measured)]
        ours, ours_s = processor_s(lambda: [eb.fit_circuit(s, circuit) for s in spectra])
        tell("eisbench, no start values", ours_s / count, [f.values for f in ours], best, measured, model)
        names = [parameter.name for parameter in ours[0].parameters]
        starts = [dict(zip(names, truth)) for truth in truths]
        near, near_s = processor_s(
            lambda: [
                eb.fit_circuit(s, circuit, guess=start)
                for s, start in zip(spectra, starts)
            ]
        )
        tell("eisbench, from the truth", near_s / count, [f.values for f in near], best, measured, model)
        table, table_s = processor_s(lambda: eb.fit_table(spectra, circuit=circuit))
        tell("eisbench, as one table", table_s / count, None, best, measured, model)
        one = [[table[name][k] for name in names] for k in range(count)]
        assert all(list(a) == list(b.values) for a, b in zip(one, ours))

        def theirs(start_of, number):
            found = []
            for k in range(number):
                fitted = CustomCircuit(circuit, initial_guess=list(start_of(k)))
                try:
                    fitted.fit(FREQ_HZ, measured[k], weight_by_modulus=True)
                    found.append((fitted.parameters_, fitted.conf_))
                except (RuntimeError, ValueError):
                    found.append(None)
            return found

        def rough(k):
            span = np.abs(measured[k]).max() - np.abs(measured[k]).min()
            if circuit.endswith("CPE1)"):
                return [np.abs(measured[k]).min(), span, 1.0 / span, 0.8]
            return [np.abs(measured[k]).min(), span / 2, 0.01 / span, span / 2, 1.0 / span]

        for label, start in [("from the truth", lambda k: truths[k]), ("from a rough guess", rough)]:
            got, took_s = processor_s(lambda start=start: theirs(start, count))
            values = [None if one is None else one[0] for one in got]
            like = near_s if label == "from the truth" else ours_s
            tell(f"impedance.py, {label}", took_s / count, values, best, measured, model, like / count)
            if label == "from the truth":
                ratios = [
                    mine.parameters[j].sigma / their[1][j]
                    for mine, their in zip(ours, got)
                    if their is not None
                    for j in range(len(their[1]))
                    if mine.parameters[j].sigma and their[1][j] > 0
                ]
                low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
                print(f"    σ of ours over theirs: median {middle:.3f}, 90 % within {low:.3f} to {high:.3f}")
        pyimpspec_fits(description, model, truths, measured[:slow], best, near_s / count)


def pyimpspec_fits(description, model, truths, measured, best, ours_s):
    import pyimpspec

    def started(truth):
        """The circuit with the truth as start, within bounds that hold it."""
        values = iter(truth)
        symbols = {"R": ("R",), "C": ("C",), "Q": ("Y", "n")}
        text = ""
        for symbol in description:
            of = []
            for name in symbols.get(symbol, ()):
                value = next(values)
                upper = 1.0 if name == "n" else 1e3 * value
                of.append(f"{name}={value!r}/{1e-3 * value!r}/{upper!r}")
            text += symbol + ("{" + ",".join(of) + "}" if of else "")
        return pyimpspec.parse_cdc(text)

    def work():
        found = []
        for truth, z_ohm in zip(truths, measured):
            circuit = started(truth)
            data = pyimpspec.DataSet(frequencies=FREQ_HZ, impedances=z_ohm)
            try:
                fitted = pyimpspec.fit_circuit(
                    circuit, data, method="least_squares", weight="modulus", num_procs=1
                )
                values = [
                    value
                    for element in fitted.circuit.get_elements()
                    for value in element.get_values().values()
                ]
                found.append(values)
            except Exception:  # noqa: BLE001
                found.append(None)
        return found

    got, took_s = processor_s(work)
    tell("pyimpspec, from the truth", took_s / len(measured), got, best, measured, model, ours_s)


def tell(label, each_s, values, best, measured, model, ours_s=None):
    share = ""
    if values is not None:
        at = 0
        for one, least_value, z_ohm in zip(values, best, measured):
            at += one is not None and squares(model, one, z_ohm) <= 1.001 * least_value
        share = f", at the best known optimum {100 * at / len(values):.1f} % of {len(values)}"
    ratio = "" if ours_s is None else f", ours is {each_s / ours_s:.0f} ×"
    print(f"  {label:32} {1e3 * each_s:9.3f} ms{ratio}{share}")


def validity(slow):
    import impedance.validation
    from impedance.validation import linKK

    # Its text of a circuit is evaluated where NumPy is called `np`.
    impedance.validation.circuit_elements.setdefault("np", np)

    draw = np.random.default_rng(5)
    truth = CIRCUITS["R0-p(R1,C1)-p(R2,C2)"][2](draw)
    z_ohm = two_rc(truth) * (1 + 1e-3 * draw.standard_normal(31))
    spectrum = eb.Spectrum("s", FREQ_HZ, z_ohm)
    print("\ntests of one spectrum of 31 points")
    many = [spectrum] * 200
    _, kk_s = processor_s(lambda: [eb.kk(s) for s in many])
    _, drt_s = processor_s(lambda: [eb.drt(s) for s in many])
    kk_s, drt_s = kk_s / 200, drt_s / 200
    print(f"  eisbench, kk and zhit together   {1e3 * kk_s:9.3f} ms")
    import pyimpspec

    data = pyimpspec.DataSet(frequencies=FREQ_HZ, impedances=z_ohm)
    few = max(1, slow // 20)
    for label, work, ours_s in [
        ("impedance.py, linKK", lambda: linKK(FREQ_HZ, z_ohm, c=0.85, max_M=50), kk_s),
        ("pyimpspec, kramers-kronig", lambda: pyimpspec.perform_kramers_kronig_test(data, num_procs=1), kk_s),
        ("pyimpspec, zhit", lambda: pyimpspec.perform_zhit(data, num_procs=1), kk_s),
        ("pyimpspec, drt (tr-nnls)", lambda: pyimpspec.calculate_drt(data, method="tr-nnls"), drt_s),
    ]:
        try:
            _, took_s = processor_s(lambda work=work: [work() for _ in range(few)])
            print(f"  {label:32} {1e3 * took_s / few:9.3f} ms, ours is {took_s / few / ours_s:.0f} ×")
        except Exception as error:  # noqa: BLE001
            print(f"  {label:32} failed: {error}")
    print(f"  eisbench, drt                    {1e3 * drt_s:9.3f} ms")


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--spectra", type=int, default=1000)
    words.add_argument("--slow", type=int, default=100)
    asked = words.parse_args()
    fits(asked.spectra, asked.slow)
    validity(asked.slow)
