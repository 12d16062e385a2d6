"""One image of a 24-patch chart per camera -> 3 x 3 matrices that bring every camera to the average camera's colours.

raw = M_c @ patch value for each camera c, by robust least squares; the light is common to all cameras and part of
M_c, as is exposure. The average camera has the mean of all M_c, so corrected_from_raw_c = mean(M) @ inverse(M_c). With
`method: none` all matrices are the identity.
"""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints
from pipeline.base.files import read_json, read_table, write_json, write_table
from pipeline.capture.color_chart import (
    PATCHES,
    Patches,
    Response,
    corrections,
    find_chart,
    fit_response,
    measure_patches,
)
from pipeline.capture.images import read_image
from pipeline.config.calibrate_color import CalibrateColor

log = logging.getLogger("calibrate_color")

RESIDUAL_COLUMNS = ["camera", "patch", "r", "g", "b", "residual_r", "residual_g", "residual_b", "weight", "used"]


def run(
    *, capture: Path, index: Path, out: Path, threads: int = 1, settings: CalibrateColor = CalibrateColor()
) -> None:
    """Fit every camera's colour response to a chart and bring all cameras to their average.

    Args:
        capture: folder of the capture.
        index: folder that index_capture wrote.
        out: folder to write color.json and residuals_color.parquet to.
        threads: images searched at a time.
    """
    calibration = read_json(index / "calibration_color.json")
    names = sorted(read_table(index / "cameras.parquet").camera)
    if calibration["method"] == "none":
        write_json(out / "color.json", {"cameras": {name: np.eye(3).tolist() for name in names}})
        write_table(out / "residuals_color.parquet", pd.DataFrame(columns=RESIDUAL_COLUMNS))
        return
    black_level = read_json(index / "capture.json")["images"]["black_level"]
    paths = {entry["camera"]: capture / entry["path"] for entry in calibration["images"]}
    values = np.asarray(calibration["patches"], np.float64)
    check(capture, paths, names, values)

    def measure(name: str) -> Patches | None:
        image = read_image(paths[name], calibration["transfer"], black_level)
        squares = find_chart(image)
        if squares is None:
            return None
        return measure_patches(image, squares, settings.patch_interior, settings.saturation)

    with ThreadPoolExecutor(threads) as pool:
        measured = dict(zip(names, pool.map(measure, names), strict=True))
    check_patches(capture, paths, measured, settings)
    responses = {name: fit_response(patches, values) for name, patches in measured.items() if patches is not None}
    check_responses(capture, paths, responses, settings)
    matrices = corrections({name: response.matrix for name, response in responses.items()})
    for name, response in responses.items():
        report(name, response, matrices[name], settings)
    write_json(out / "color.json", {"cameras": {name: matrix.tolist() for name, matrix in matrices.items()}})
    write_table(out / "residuals_color.parquet", residual_table(responses))


def check(capture: Path, paths: dict[str, Path], names: list[str], values: np.ndarray) -> None:
    """Raises:
    InputError: naming cameras without an image, or patch values that are not 24 colours.
    """
    complaints = Complaints(capture)
    for name in names:
        if name not in paths:
            complaints.add("calibration.color", f"camera {name}", expected="an image of the chart", found="none")
    if values.shape != (PATCHES, 3) or not np.isfinite(values).all() or np.linalg.matrix_rank(values) < 3:
        expected = "24 rows of linear r, g, b that are not all of one hue"
        complaints.add("calibration.color.patches", "values", expected=expected, found=f"shape {values.shape}")
    complaints.raise_if_any()


def check_patches(
    capture: Path, paths: dict[str, Path], measured: dict[str, Patches | None], settings: CalibrateColor
) -> None:
    """Raises:
    InputError: naming cameras that do not see the chart, or too little of it.
    """
    complaints = Complaints(capture)
    for name, patches in measured.items():
        if patches is None:
            mend = "is it whole, sharp and larger than a tenth of the image?"
            complaints.add(paths[name], f"camera {name}", expected="a 24-patch chart", found="none", mend=mend)
        elif patches.used.sum() < settings.least_patches:
            expected = f"at least {settings.least_patches} patches that are not saturated"
            complaints.add(paths[name], f"camera {name}", expected=expected, found=str(int(patches.used.sum())))
    complaints.raise_if_any()


def relative_residual(response: Response) -> float:
    """Root mean square residual over the brightest patch."""
    return float(np.sqrt(np.nanmean(response.residual**2)) / np.nanmax(response.patches.color))


def check_responses(
    capture: Path, paths: dict[str, Path], responses: dict[str, Response], settings: CalibrateColor
) -> None:
    """Raises:
    InputError: naming cameras in which something else was taken for the chart.
    """
    complaints = Complaints(capture)
    for name, response in responses.items():
        relative = relative_residual(response)
        if relative > settings.largest_residual:
            expected = f"patches that fit the chart's values to {100 * settings.largest_residual:g} % of the brightest"
            mend = "is it the chart that patches describes, and is transfer right?"
            complaints.add(paths[name], f"camera {name}", expected=expected, found=f"{100 * relative:.0f} %", mend=mend)
    complaints.raise_if_any()


def report(name: str, response: Response, matrix: np.ndarray, settings: CalibrateColor) -> None:
    """Log one line per camera: patches, residual over the brightest patch, size of the correction."""
    relative, correction = relative_residual(response), np.abs(matrix - np.eye(3)).max()
    verdict = "good" if relative <= settings.good_residual else "POOR: look at its residuals"
    text = "%s: %d patches, residual %.2f %% of the brightest, correction %.1f %%: %s"
    log.info(text, name, response.patches.used.sum(), 100 * relative, 100 * correction, verdict)


def residual_table(responses: dict[str, Response]) -> pd.DataFrame:
    """One row per camera and patch (from 1, as in the chart's csv): raw colour, raw minus fitted, weight, used."""
    parts = []
    for name, response in responses.items():
        columns = [*response.patches.color.T, *response.residual.T, response.weight, response.patches.used]
        part = pd.DataFrame(dict(zip(RESIDUAL_COLUMNS[2:], columns, strict=True)))
        parts.append(part.assign(camera=name, patch=np.arange(1, PATCHES + 1))[RESIDUAL_COLUMNS])
    return pd.concat(parts, ignore_index=True)


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
