"""What the tests share: the project's data, the program beside the package."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

import eisbench as eb

ROOT = Path(__file__).parents[2]
DATA = ROOT / "fixtures" / "data"
THESIS = DATA / "spectra" / "p45b_thesis.csv"


def impedance(freq_hz, r_ohm, branches):
    """The model by its definition, in NumPy."""
    omega = 2 * np.pi * np.asarray(freq_hz)
    return r_ohm + sum(r / (1 + 1j * omega * r * c) for r, c in branches)


@pytest.fixture
def two_rc():
    """A spectrum of two branches, 25 points, with 0.1 % of noise that is stated."""
    freq_hz = np.geomspace(0.01, 1000, 25)
    z_ohm = impedance(freq_hz, 0.006, [(0.002, 1.0), (0.004, 500.0)])
    sigma_ohm = 1e-3 * abs(z_ohm)
    draw = np.random.default_rng(7)
    noise = draw.standard_normal(25) + 1j * draw.standard_normal(25)
    return eb.Spectrum("two", freq_hz, z_ohm + sigma_ohm * noise, sigma_ohm)


@pytest.fixture(scope="session")
def program():
    """The program, as the workspace's build has left it."""
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    binary = target / "debug" / "eis-bench"
    if not binary.exists():
        pytest.skip("needs target/debug/eis-bench, which `cargo build` makes")

    def run(*words):
        words = [str(word) for word in words]
        return subprocess.run([binary, *words], check=True, capture_output=True, text=True).stdout

    return run
