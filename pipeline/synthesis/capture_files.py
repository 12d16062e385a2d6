"""Files of a synthetic capture besides photographs: tables, capture.yaml, and the truth."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from pipeline.base.files import write_arrays, write_json, write_table
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.cameras import write_cameras
from pipeline.synthesis.stage_rig import StageRig, segment_for, survey_lights
from pipeline.synthesis.subject import Moment, Subject, template_source
from pipeline.synthesis.targets import BOARD_DICTIONARY, CHART_PATCHES

FORMAT = "lightstage-capture/1"


def write_tables(
    root: Path,
    subject: str,
    rig: StageRig,
    patterns: pd.DataFrame,
    keypoints: pd.DataFrame,
    settings: SynthesizeCapture,
) -> None:
    """Write the capture's tables.

    These are cameras.csv, frames.csv, lights.csv, patterns.csv, keypoints_2d.parquet and the chart's values, chart.csv.
    """
    d = settings.downsample_from_sensor
    size = {
        "width": settings.width, "height": settings.height,
        "sensor_width": d * settings.width, "sensor_height": d * settings.height,
    }  # fmt: skip
    write_table(root / "cameras.csv", pd.DataFrame([{"camera": name, **size} for name in rig.cameras]))
    frames = range(settings.frames)
    segments = [segment_for(frame, settings)[0] for frame in frames]
    timestamps = [frame / settings.fps for frame in frames]
    write_table(root / "frames.csv", pd.DataFrame({"frame": frames, "timestamp_s": timestamps, "segment": segments}))
    write_table(root / "lights.csv", survey_lights(subject, rig, settings.survey_error_m))
    write_table(root / "patterns.csv", patterns)
    write_table(root / "keypoints_2d.parquet", keypoints)
    chart = pd.DataFrame(CHART_PATCHES, columns=["r", "g", "b"])
    chart.insert(0, "patch", np.arange(1, len(chart) + 1))
    write_table(root / "calibration/color_chart/chart.csv", chart)


def held_out(rig: StageRig, settings: SynthesizeCapture) -> dict[str, list]:
    """The splits of capture.yaml, by name.

    Held out are cameras, partially lit frames and patterns, spread evenly, and all of segment b.
    """
    names = list(rig.cameras)
    partial = [
        frame for frame in range(settings.frames - settings.frames_b) if frame % settings.fully_lit_every != 0
    ]  # fmt: skip

    def spread(items: list, count: int) -> list:
        return [items[int((i + 0.5) * len(items) / count)] for i in range(count)]

    test_frames = spread(partial, settings.test_frames)
    rest = [frame for frame in partial if frame not in test_frames]
    return {
        "test_cameras": spread(names, settings.test_cameras),
        "test_frames": test_frames,
        "test_segments": ["b"],
        "test_patterns": spread(rest, settings.test_patterns),
    }


def write_gaze(root: Path, moments: list[Moment]) -> None:
    """Write gaze.csv, one row per frame and eye."""
    rows = [(frame, eye, *look) for frame, moment in enumerate(moments) for eye, look in moment.gaze.items()]
    write_table(root / "gaze.csv", pd.DataFrame(rows, columns=["frame", "eye", "x", "y", "z"]))


def write_capture_yaml(root: Path, name: str, shown: Subject, rig: StageRig, settings: SynthesizeCapture) -> None:
    """Write capture.yaml, the file that names everything else."""
    content = {
        "format": FORMAT,
        "subject": name,
        "kind": shown.kind,
        "units": "m",
        "up": "+y",
        "fps": settings.fps,
        "images": {
            "path": "images/{camera}/{frame:06d}.exr",
            "transfer": "linear",
            "black_level": settings.black_level,
            "downsample_from_sensor": settings.downsample_from_sensor,
        },
        "masks": {"path": "masks/{camera}/{frame:06d}.png"},
        "cameras": "cameras.csv",
        "frames": "frames.csv",
        "lights": "lights.csv",
        "patterns": "patterns.csv",
        "keypoints_2d": "keypoints_2d.parquet",
        "template": {
            "mesh": "template/template.glb",
            "keypoints": "template/keypoints.csv",
            "scale_to_m": settings.scale_to_m,
        },
        "calibration": _calibration_entries(settings),
        "splits": held_out(rig, settings),
    }
    if shown.eyes:
        content["template"]["eyes"] = "template/eyes.csv"
        content["gaze"] = "gaze.csv"
    (root / "capture.yaml").write_text(yaml.safe_dump(content, sort_keys=False))


def _calibration_entries(settings: SynthesizeCapture) -> dict[str, dict[str, object]]:
    return {
        "cameras": {
            "method": "charuco",
            "path": "calibration/charuco/{camera}/{view:03d}.jpg",
            "squares_x": settings.board_squares_x,
            "squares_y": settings.board_squares_y,
            "square_m": settings.board_square_m,
            "marker_m": settings.board_marker_m,
            "dictionary": BOARD_DICTIONARY,
        },
        "lights": {
            "method": "mirror_ball",
            "path": "calibration/mirror_ball/{position}/{camera}/{light}.png",
            "silhouette": "calibration/mirror_ball/{position}/{camera}/silhouette.png",
            "radius_m": settings.ball_radius_m,
        },
        "color": {
            "method": "chart",
            "path": "calibration/color_chart/{camera}.exr",
            "patches": "calibration/color_chart/chart.csv",
            "transfer": "linear",
        },
    }


def write_truth(root: Path, rig: StageRig, subject: Subject, moments: list[Moment], uvs: bool) -> None:
    """Write the folder truth/, which no stage may read.

    `vertices` are in the template file's order, everything in metres.
    """
    write_cameras(root / "truth/cameras.json", rig.cameras)
    lights = pd.DataFrame(rig.lights_xyz, columns=["x", "y", "z"])
    lights.insert(0, "light", list(rig.light_positions))
    write_table(root / "truth/lights.parquet", lights)
    responses = {name: matrix.tolist() for name, matrix in rig.raw_from_true.items()}
    write_json(root / "truth/color.json", {"raw_from_true": responses})
    if subject.eyes:
        write_json(root / "truth/eyes.json", subject.eye_truth())
    source = template_source(subject, uvs)
    tracking = {"frames": np.arange(len(moments)), "vertices": np.stack([m.vertices[source] for m in moments])}
    tracking |= {name: np.stack([moment.truth[name] for moment in moments]) for name in moments[0].truth}
    single = {name: a.astype(np.float32) if a.dtype == np.float64 else a for name, a in tracking.items()}
    write_arrays(root / "truth/tracking.safetensors", single)


def write_renderer(root: Path, renderer: str, llvm_version: str) -> None:
    """Write truth/renderer.json: what made the images of frames.

    Their noise depends on it.
    """
    content = {"renderer": renderer, "mitsuba": version("mitsuba")}
    write_json(root / "truth/renderer.json", content | ({"llvm": llvm_version} if llvm_version else {}))
