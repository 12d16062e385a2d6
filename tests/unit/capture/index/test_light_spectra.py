"""Spectra of LEDs: their factors against closed forms, and patterns of a capture that has them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.index.light_spectra import read_light_gains
from pipeline.capture.index.validation import index_folder
from pipeline.capture.schema.sections import Spectra
from tests.support.captures.builder import build_capture, edit_manifest, write_lines

SECTION = Spectra(lights="spectra.csv", sensitivities="seen.csv")
LIGHTS = pd.DataFrame({"light": ["A", "B"]})
LEDS = {"A": (455.0, 12.0), "B": (620.0, 9.0)}
SEEN = {"r": (600.0, 40.0), "g": (540.0, 45.0), "b": (460.0, 35.0)}
"""Middle and standard deviation, nanometres, of Gaussian LEDs and channels."""


def bell(x, middle, sigma):
    return np.exp(-0.5 * ((x - middle) / sigma) ** 2)


def write_spectra(folder, step=1.0, leds=LEDS):
    at = np.arange(300, 800, step)
    rows = [f"{name},{x},{bell(x, *led)}" for name, led in leds.items() for x in at]
    write_lines(folder / "spectra.csv", "light,wavelength_nm,power", *rows)
    rows = [",".join(map(str, (x, *(bell(x, *SEEN[c]) for c in "rgb")))) for x in np.arange(300, 800, 3.0)]
    write_lines(folder / "seen.csv", "wavelength_nm,r,g,b", *rows)


def gains(folder, lights=LIGHTS):
    complaints = Complaints(folder)
    found = read_light_gains(folder, SECTION, lights, complaints)
    complaints.raise_if_any()
    return found


def expected():
    """The integral of two Gaussians' product is a Gaussian of their distance, times sigma a sigma b over its root."""
    rows = {}
    for name, (middle, sigma) in LEDS.items():
        wide = {c: np.hypot(sigma, own) for c, (_, own) in SEEN.items()}
        rows[name] = {c: sigma * SEEN[c][1] / wide[c] * bell(middle, SEEN[c][0], wide[c]) for c in SEEN}
    table = pd.DataFrame(rows).T
    return table / table.mean()


def test_gaussian_leds_have_the_gains_of_the_closed_form(tmp_path):
    write_spectra(tmp_path)
    # Lines between samples 3 nm apart miss h^2 / 12 over the squared width: a thousandth.
    np.testing.assert_allclose(gains(tmp_path)[["r", "g", "b"]], expected()[["r", "g", "b"]], rtol=5e-3, atol=1e-3)


def test_patterns_of_a_capture_are_multiplied(tmp_path):
    root = build_capture(tmp_path / "tiny")
    plain = index_folder(root).tables["patterns"]
    names = plain.light.unique()
    leds = {name: (450.0 + 40 * k, 10.0) for k, name in enumerate(["A", "B", "C"])}
    edit_manifest(root, lambda manifest: manifest.update(spectra=SECTION.model_dump()))
    write_spectra(root, leds=leds)
    colored = index_folder(root).tables["patterns"]
    found = gains(root, pd.DataFrame({"light": list(leds)}))
    assert set(names) <= set(leds)
    for c in "rgb":
        np.testing.assert_allclose(
            colored[f"intensity_{c}"], plain[f"intensity_{c}"] * found.loc[plain.light, c].to_numpy(), rtol=1e-12
        )


@pytest.mark.parametrize(
    ("leds", "complaint"),
    [
        ({"A": LEDS["A"]}, "spectra.csv: light: expected a spectrum of each light, found none of B"),
        (LEDS | {"C": LEDS["A"]}, "C"),
        (LEDS | {"B": (5000.0, 1.0)}, r"seen.csv: r, g, b: expected light that each channel sees, .* of B"),
    ],
    ids=["a light without", "no such light", "other wavelengths"],
)
def test_what_is_wrong_is_named(tmp_path, leds, complaint):
    write_spectra(tmp_path, leds=leds)
    with pytest.raises(InputError, match=complaint):
        gains(tmp_path)
