"""Spectra of LEDs as factors of the three channels that cameras see."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, listed
from pipeline.capture.index.csv_tables import Kind, complain_repeats, complain_rows, complain_unknown, read_csv
from pipeline.capture.schema.sections import Spectra

SPECTRUM_COLUMNS: Mapping[str, Kind] = {"light": "name", "wavelength_nm": "number", "power": "number"}
SENSITIVITY_COLUMNS: Mapping[str, Kind] = {
    "wavelength_nm": "number", "r": "number", "g": "number", "b": "number",
}  # fmt: skip
CHANNELS = ["r", "g", "b"]


def read_light_gains(root: Path, section: Spectra, lights: pd.DataFrame, complaints: Complaints) -> pd.DataFrame | None:
    """Factors r, g, b by light, of mean 1 in each channel.

    None, with complaints, if the tables do not give them.

    The integral of power times sensitivity, both linear between their rows and nothing beyond.
    """
    spectra = read_csv(root, section.lights, SPECTRUM_COLUMNS, complaints)
    seen = read_csv(root, section.sensitivities, SENSITIVITY_COLUMNS, complaints)
    if spectra is None or seen is None:
        return None
    before = len(complaints.messages)
    for path, table, columns in ((section.lights, spectra, ["power"]), (section.sensitivities, seen, CHANNELS)):
        for column in columns:
            if (bad := table[column] < 0).any():
                complain_rows(complaints, path, column, bad, "0 or more", table[column])
    complain_repeats(complaints, section.lights, spectra, ["light", "wavelength_nm"])
    complain_repeats(complaints, section.sensitivities, seen, ["wavelength_nm"])
    complain_unknown(
        complaints, section.lights, "light", spectra["light"], list(lights["light"]), "the table of lights"
    )
    if dark := sorted(set(lights["light"]) - set(spectra["light"])):
        complaints.add(section.lights, "light", expected="a spectrum of each light", found=f"none of {listed(dark)}")
    if len(complaints.messages) > before:
        return None
    gains = spectra.groupby("light")[["wavelength_nm", "power"]].apply(lambda rows: _integrals(rows, seen))
    if (unseen := ~(gains > 0).all(axis=1)).any():
        found = f"none in some channel of {listed(sorted(gains.index[unseen]))}"
        hint = "in nanometres? over the wavelengths of the LEDs?"
        complaints.add(
            section.sensitivities, "r, g, b", expected="light that each channel sees", found=found, hint=hint
        )
        return None
    return gains / gains.mean()


def with_gains(patterns: pd.DataFrame, gains: pd.DataFrame) -> pd.DataFrame:
    """Patterns whose intensities are times the factors of their lights."""
    columns = [f"intensity_{channel}" for channel in CHANNELS]
    factors = gains.loc[patterns["light"], CHANNELS].to_numpy(np.float64)
    return patterns.assign(**dict(zip(columns, (patterns[columns].to_numpy(np.float64) * factors).T, strict=True)))


def _integrals(spectrum: pd.DataFrame, seen: pd.DataFrame) -> pd.Series:
    """Integrals of power times each sensitivity: of products of lines, by Simpson's rule, which is exact for these."""
    spectrum, seen = spectrum.sort_values("wavelength_nm"), seen.sort_values("wavelength_nm")
    knots = np.union1d(spectrum.wavelength_nm, seen.wavelength_nm)
    low, high = (
        max(t.wavelength_nm.iloc[0] for t in (spectrum, seen)),
        min(t.wavelength_nm.iloc[-1] for t in (spectrum, seen)),
    )
    knots = knots[(knots >= low) & (knots <= high)]
    at = np.stack([knots[:-1], (knots[:-1] + knots[1:]) / 2, knots[1:]])
    power = np.interp(at, spectrum.wavelength_nm, spectrum.power)
    weights = np.diff(knots) * np.array([[1], [4], [1]]) / 6
    return pd.Series({c: float((weights * power * np.interp(at, seen.wavelength_nm, seen[c])).sum()) for c in CHANNELS})
