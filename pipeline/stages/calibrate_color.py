"""Bring every camera to the average camera's colours by a 3 x 3 matrix.

It reads one image of a chart per camera.

raw = M_c @ patch value for each camera c, by robust least squares; the light is common to all cameras and part of
M_c, as is exposure. The average camera has the mean of all M_c, so corrected_from_raw_c = mean(M) @ inverse(M_c). With
`method: known` the matrices are taken as they are given; with `none` all are the identity.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints
from pipeline.base.files import read_json, read_table, write_json, write_table
from pipeline.base.verdicts import Verdict, log_verdicts, verdict_table
from pipeline.calibration.color.chart_images import ChartFormat, MeasuredChart, measure_chart, read_linearity
from pipeline.calibration.color.chart_layout import ChartLayout
from pipeline.calibration.color.color_response import Response, corrections, fit_response
from pipeline.calibration.color.color_tables import quality_table, residual_table
from pipeline.calibration.color.color_verdicts import Flaw, black_flaws, light_flaws, patch_flaws, response_flaws
from pipeline.calibration.color.sensor_linearity import Linearity
from pipeline.config.calibrate_color import CalibrateColor
from pipeline.figures.refused_chart import draw_refused_chart

log = logging.getLogger("calibrate_color")


def run(
    *, capture: Path, index: Path, out: Path, threads: int = 1, settings: CalibrateColor = CalibrateColor()
) -> None:
    """Fit every camera's colour response to a chart and bring all cameras to their average.

    Args:
        capture: folder of the capture.
        index: folder that index_capture wrote.
        out: folder to write color.json, residuals_color.parquet, quality_color.parquet and verdicts_color.csv to.
        threads: images searched at a time.
    """
    calibration = read_json(index / "calibration_color.json")
    names = sorted(read_table(index / "cameras.parquet").camera)
    if calibration["method"] == "known":
        log.info("taken as they are given: the colour matrices of %d cameras", len(names))
        given = {name: np.asarray(calibration["cameras"][name], np.float64) for name in names}
        write(out, given, {}, {}, [Verdict("color", name, "good", "given, not calibrated here") for name in names])
        return
    if calibration["method"] == "none":
        write(out, {name: np.eye(3) for name in names}, {}, {}, [])
        return
    black_level = read_json(index / "capture.json")["images"]["black_level"]
    paths = {entry["camera"]: capture / entry["path"] for entry in calibration["images"]}
    values = np.asarray(calibration["patches"], np.float64)
    layout = ChartLayout.from_index(calibration)
    check(capture, paths, names, values, layout)

    form = ChartFormat.from_index(calibration, black_level)
    sensors = measure_sensors(capture, calibration, form, settings)

    def measure(name: str) -> MeasuredChart:
        corners = calibration.get("corners", {}).get(name)
        limit = sensors[name].up_to if name in sensors else float("nan")
        return measure_chart(paths[name], form, corners, limit, settings, layout)

    with ThreadPoolExecutor(threads) as pool:
        measured = dict(zip(names, pool.map(measure, names), strict=True))
    flaws = {name: patch_flaws(m.patches, m.saturated_share, settings) for name, m in measured.items()}
    for name, sensor in sensors.items():
        flaws[name] += black_flaws(sensor, form)
    responses = {name: fit_response(measured[name].patches, values) for name in names if not is_failed(flaws[name])}
    for name, response in responses.items():
        flaws[name] += response_flaws(response, settings)
    sound = {name: response for name, response in responses.items() if not is_failed(flaws[name])}
    for name, more in light_flaws(sound, settings).items():
        flaws[name] += more
    matrices = corrections({name: response.matrix for name, response in sound.items()}) if sound else {}
    verdicts = [judge(name, flaws[name], responses.get(name), matrices.get(name)) for name in names]
    log_verdicts(log, verdicts)
    draw_refused(out, paths, form, measured, responses, flaws, settings)
    refuse(capture, out, paths, flaws)
    write(out, matrices, responses, sensors, verdicts)


def check(capture: Path, paths: dict[str, Path], names: list[str], values: np.ndarray, layout: ChartLayout) -> None:
    """Refuse cameras without an image, and patch values that are not a colour for each patch.

    Raises:
        InputError: naming cameras without an image, or patch values that are not a colour for each patch.
    """
    complaints = Complaints(capture)
    for name in names:
        if name not in paths:
            complaints.add("calibration.color", f"camera {name}", expected="an image of the chart", found="none")
    if values.shape != (layout.patches, 3) or not np.isfinite(values).all() or np.linalg.matrix_rank(values) < 3:
        expected = f"{layout.patches} rows of linear r, g, b that are not all of one hue"
        complaints.add("calibration.color.patches", "values", expected=expected, found=f"shape {values.shape}")
    complaints.raise_if_any()


def measure_sensors(
    capture: Path, calibration: Mapping[str, Any], form: ChartFormat, settings: CalibrateColor
) -> dict[str, Linearity]:
    """Linearity of each sensor of which there is a series of exposures that tells."""
    found = {}
    for camera in sorted({entry["camera"] for entry in calibration.get("exposures", [])}):
        entries = [entry for entry in calibration["exposures"] if entry["camera"] == camera]
        linearity = read_linearity(capture, entries, form, settings.largest_nonlinearity)
        if linearity is None:
            log.warning("%s: the series of exposures does not show where the sensor stops being linear: it needs "
                        "the same pixels dark in one image and bright in another", camera)  # fmt: skip
        else:
            log.info("%s: %s (to %.1f %%)", camera, linearity, 100 * settings.largest_nonlinearity)
            found[camera] = linearity
    return found


def is_failed(flaws: list[Flaw]) -> bool:
    """True if any of the flaws makes the camera's colours useless."""
    return any(flaw.grade == "failed" for flaw in flaws)


def judge(name: str, flaws: list[Flaw], response: Response | None, matrix: np.ndarray | None) -> Verdict:
    """The camera's verdict: the numbers that its flaws are judged by, and the flaws."""
    numbers = []
    if response is not None:
        residual, sigma = np.nanmedian(response.relative_residual()), response.relative_sigma()
        numbers += [f"{response.patches.used.sum()} patches", f"residual {residual:.2%} (median) of the brightest"]
        numbers += [f"response +-{sigma:.2%}"]
    if matrix is not None:
        numbers += [f"correction {np.abs(matrix - np.eye(3)).max():.1%}"]
    grade = "failed" if is_failed(flaws) else "weak" if flaws else "good"
    reasons = [", ".join(numbers), *map(str, flaws)]
    return Verdict("color", name, grade, "; ".join(reason for reason in reasons if reason))


def draw_refused(
    out: Path, paths: Mapping[str, Path], form: ChartFormat, measured: Mapping[str, MeasuredChart],
    responses: Mapping[str, Response], flaws: Mapping[str, list[Flaw]], settings: CalibrateColor,
) -> None:  # fmt: skip
    """Draw the chart of each camera that is refused, and delete such pictures of earlier runs.

    Their images are read again: those of all cameras would not fit into memory.
    """
    for name, chart in measured.items():
        path = refused_picture(out, name)
        path.unlink(missing_ok=True)
        if is_failed(flaws[name]):
            response = responses.get(name)
            found = chart.patches if response is None else response.patches
            used = np.zeros(0, bool) if found is None else found.used
            fits = np.zeros_like(used) if response is None else ~response.odd(settings.largest_residual)
            draw_refused_chart(path, form.read(paths[name]), None if found is None else found.corners, used, fits)


def refused_picture(out: Path, camera: str) -> Path:
    """Picture of the chart of a camera that is refused."""
    return out / f"refused_color_{camera}.png"


def refuse(capture: Path, out: Path, paths: Mapping[str, Path], flaws: Mapping[str, list[Flaw]]) -> None:
    """Refuse cameras whose colours stay unknown.

    Raises:
        InputError: naming cameras whose colours stay unknown.
    """
    complaints = Complaints(capture)
    for name, found in flaws.items():
        for flaw in found:
            if flaw.grade == "failed":
                key, file = f"camera {name}", paths[name].relative_to(capture)
                hint = f"{flaw.hint}; see {refused_picture(out, name)}"
                complaints.add(file, key, expected=flaw.expected, found=flaw.found, hint=hint)
    complaints.raise_if_any()


def write(
    out: Path, matrices: Mapping[str, np.ndarray], responses: Mapping[str, Response], sensors: Mapping[str, Linearity],
    verdicts: list[Verdict],
) -> None:  # fmt: skip
    """All outputs of the stage."""
    write_json(out / "color.json", {"cameras": {name: matrix.tolist() for name, matrix in matrices.items()}})
    write_table(out / "residuals_color.parquet", residual_table(responses))
    write_table(out / "quality_color.parquet", quality_table(responses, sensors))
    write_table(out / "verdicts_color.csv", verdict_table(verdicts))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
