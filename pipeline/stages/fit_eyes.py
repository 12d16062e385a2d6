"""Tracked eye parts and gaze in, two spheres per eye and verdicts out: eyes.json.

For each eye: where it is, how large eyeball and cornea are and where the cornea sits, in the frame of the template at
rest, each with its standard deviation; and whether the template showed a cornea. See `pipeline.eyes.eye_fit`.
Verdicts: on each eye, and on whether it turns as the gaze does.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_table, write_json, write_table
from pipeline.base.verdicts import Verdict, log_verdicts, verdict_table
from pipeline.capture.head_data import head_motions
from pipeline.config.fit_eyes import FitEyes
from pipeline.eyes.eye_fit import fit_eye, tracked_axes
from pipeline.eyes.eye_verdicts import eye_verdict, gaze_verdict
from pipeline.geometry.texels import read_atlas

log = logging.getLogger("fit_eyes")


def run(
    *, index: Path, atlas: Path, tracking: tuple[Path, ...], out: Path, estimated_gaze: Path | None = None,
    settings: FitEyes = FitEyes(),
) -> None:  # fmt: skip
    """Fit the eyes of a capture.

    Args:
        index: folder of index_capture, for eyes.parquet and gaze.parquet.
        atlas: atlas.safetensors of unwrap_atlas, for the template at rest.
        tracking: all chunks of track_mesh.
        out: eyes.json; verdicts_eyes.csv is written beside it.
        estimated_gaze: gaze.parquet of estimate_gaze, where the capture declares none.
        settings: see the flags below.
    """
    eyes, looked = read_table(index / "eyes.parquet"), read_table(estimated_gaze or index / "gaze.parquet")
    if eyes.empty or looked.empty:
        missing = " and ".join(name for name, table in (("template.eyes", eyes), ("gaze", looked)) if table.empty)
        raise InputError(f"{index}: expected eyes and where they look, found no {missing}; set train_avatar.eyes: off")
    rest = read_atlas(atlas).rest_vertices.astype(np.float64)
    tracked = in_head(tracking)
    known = looked[~looked.interpolated & looked.frame.isin(tracked)]
    frames = np.sort(known.frame.unique())
    chosen = frames[np.linspace(0, len(frames) - 1, min(len(frames), settings.frames)).astype(np.int64)]
    log.info("%d of %d frames with a gaze", len(chosen), len(frames))
    found: dict[str, dict] = {}
    verdicts: list[Verdict] = []
    for name, rows in eyes.groupby("eye"):
        vertices = np.sort(rows.vertex.to_numpy())
        if vertices[-1] >= len(rest):
            raise InputError(f"{index}/eyes.parquet: {name}: expected vertices of {atlas}, found {vertices[-1]}")
        looks = directions_of(known[known.eye == name], chosen)
        seen = np.stack([tracked[frame][vertices] for frame in looks]) if looks else np.zeros((0, len(vertices), 3))
        towards = np.array(list(looks.values())).reshape(-1, 3)
        eye = fit_eye(str(name), tuple(vertices.tolist()), rest[vertices], seen, towards, settings.cornea)
        found[str(name)] = eye.as_json()
        axes = tracked_axes(str(name), rest[vertices], seen, towards)[1]
        verdicts += [eye_verdict(str(name), eye, rest), gaze_verdict(str(name), list(looks), axes, towards)]
    log_verdicts(log, verdicts)
    write_json(out, found)
    write_table(out.with_name("verdicts_eyes.csv"), verdict_table(verdicts))


def in_head(tracking: tuple[Path, ...]) -> dict[int, np.ndarray]:
    """Tracked vertices [V, 3] by frame in the head's frame, metres."""
    found = {}
    for path in tracking:
        arrays = read_arrays(path)
        motions = head_motions(arrays)
        for frame, vertices in zip(arrays["frames"].tolist(), arrays["vertices"].astype(np.float64), strict=True):
            found[frame] = vertices @ motions[frame][:, :3].T.astype(np.float64) + motions[frame][:, 3]
    return found


def directions_of(gaze: pd.DataFrame, frames: np.ndarray) -> dict[int, np.ndarray]:
    """Unit directions [3] of one eye in those of the frames in which it has one."""
    some = gaze[gaze.frame.isin(frames)].set_index("frame")[["x", "y", "z"]]
    return {int(frame): direction for frame, direction in zip(some.index, some.to_numpy(np.float64), strict=True)}


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
