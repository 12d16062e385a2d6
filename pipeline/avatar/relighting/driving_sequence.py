"""Driving signals of a film: tracked frames, a table of latent codes, a table of gaze.

A head that sits on decoded vertices is shown as its codes say: a frame is encoded, and its code and its motion are all
that is kept of it, so that the same codes with the same motion give the same pictures. One that sits on tracked
vertices has those of the frame; driven by codes it has the decoded ones in their place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import repeat
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.avatar.relighting.driving_signal import AT_REST, DrivingSignal, from_code, moved_as
from pipeline.avatar.relighting.driving_tables import KeyedCodes, KeyedGaze, fixed_gaze, read_codes, read_gaze_table
from pipeline.avatar.relighting.film import Relighter
from pipeline.base.errors import InputError, listed
from pipeline.base.files import read_arrays, read_table
from pipeline.capture.head_data import head_motions, read_gaze, read_textures
from pipeline.config.relight_avatar import RelightAvatar
from pipeline.geometry.texels import Atlas
from pipeline.geometry.tracked import read_tracked


def read_poses(
    relighter: Relighter, tracking: tuple[Path, ...], textures: tuple[Path, ...], index: Path | None,
    settings: RelightAvatar, gaze: Path | None = None,
) -> dict[int, DrivingSignal]:  # fmt: skip
    """The tracked frames to show, by number.

    Of heads with motion and latent code, with gaze if it was captured.

    Args:
        tracking, textures: of the same chunks; without textures, those of an average frame are encoded.
        index: folder of index_capture, for segments and gaze.
        gaze: gaze.parquet of estimate_gaze, where the capture declares none.

    Raises:
        InputError: if none is left to show, or files do not belong together.
    """
    if textures and len(textures) != len(tracking):
        raise InputError(f"--textures: expected one for each of {len(tracking)} chunks, found {len(textures)}")
    captured = read_gaze(gaze or index / "gaze.parquet") if gaze or index is not None else {}
    looks = {
        frame: directions.copy() for frame, directions in captured.items()
    }  # tensors share no memory with a table's columns
    wanted, poses, known = frames_of_segment(index, settings.segment), {}, []
    for path, texture_path in zip(tracking, textures or repeat(None), strict=False):
        chunk = read_tracked(path, len(relighter.atlas.rest_vertices))
        head = relighter.avatar.spec.head
        motions = head_motions(read_arrays(path)) if head else {}
        colors = textures_of(texture_path, path, relighter.atlas, motions) if head and texture_path else {}
        known += chunk.frames.tolist()
        for frame, vertices in zip(chunk.frames.tolist(), chunk.vertices, strict=True):
            if (wanted is None or frame in wanted) and is_shown(frame, settings):
                signal = DrivingSignal(vertices, motions.get(frame), colors.get(frame), gaze=looks.get(frame))
                # Only the code is kept: textures of thousands of frames would not fit into memory.
                code = relighter.code_of(signal) if head else None
                poses[frame] = replace(signal, texture=None, code=code)
    if tracking and not poses:
        last = max(known) if settings.last_frame is None else settings.last_frame
        of_segment = f" of segment {settings.segment}" if settings.segment else ""
        raise InputError(
            f"expected tracked frames{of_segment} from {settings.first_frame} to {last}, found {listed(known)}; "
            "change --first-frame or --last-frame"
        )
    return poses


def is_shown(frame: int, settings: RelightAvatar) -> bool:
    """A frame is among those that were asked for by number."""
    return settings.first_frame <= frame and (settings.last_frame is None or frame <= settings.last_frame)


def frames_of_segment(index: Path | None, segment: str) -> set[int] | None:
    """The frames of a segment; None: all there are.

    Raises:
        InputError: if the capture has no such segment.
    """
    if not segment:
        return None
    if index is None:
        raise InputError(f"--segment {segment}: expected --index, the folder of index_capture, found none")
    frames = read_table(index / "frames.parquet")
    found = set(frames.frame[frames.segment == segment].tolist())
    if not found:
        names = listed(list(dict.fromkeys(frames.segment)))
        raise InputError(f"--segment: expected one of {index}/frames.parquet: {names}; found {segment}")
    return found


def textures_of(path: Path, tracking: Path, atlas: Atlas, frames: Mapping[int, object]) -> dict[int, np.ndarray]:
    """Mean textures of a chunk, by frame.

    Raises:
        InputError: if they are of another chunk or another atlas.
    """
    textures = read_textures(path)
    if strange := sorted(textures.keys() - frames.keys()):
        raise InputError(f"{path}: expected textures of frames of {tracking}, found those of {listed(strange)}")
    for texture in textures.values():
        if len(texture) != atlas.texel_count:
            raise InputError(f"{path}: expected {atlas.texel_count} texels, found {len(texture)}; unwrap again")
    return textures


class DrivingSequence:
    """Driving signals of a film, picture by picture.

    Args:
        poses: of `read_poses`; none: the head stands at rest, and codes alone drive it.

    Raises:
        InputError: if the avatar cannot be driven as the settings ask.
    """

    def __init__(self, relighter: Relighter, poses: Mapping[int, DrivingSignal], settings: RelightAvatar) -> None:
        self.avatar, self.frames, self.poses = relighter.avatar, np.array(list(poses), np.int64), list(poses.values())
        self.codes, self.gaze = self._read_codes(settings), self._read_gaze(settings)
        if settings.head_motion != "tracked" and not self.avatar.spec.head:
            raise InputError(f"--head-motion: expected tracked for a body, found {settings.head_motion}")
        if not poses and (self.codes is None or settings.head_motion != "rest"):
            raise InputError(
                "--tracking: expected at least one chunk of track_mesh, found none; --codes with --head-motion rest"
                " does without"
            )
        held = {"tracked": None, "rest": AT_REST, "first": self.poses[0].head_from_world if poses else None}
        self.motion = held[settings.head_motion]
        self.pictures = settings.pictures or (len(poses) if self.codes is None else self.codes.count)
        self._last: tuple[object, DrivingSignal] | None = None

    def _read_codes(self, settings: RelightAvatar) -> KeyedCodes | None:
        spec = self.avatar.spec
        if settings.codes and not spec.head:
            raise InputError(
                f"--codes: expected the avatar of a head, found that of a {spec.avatar}, which has no code"
            )
        return read_codes(Path(settings.codes), spec.code_size) if settings.codes else None

    def _read_gaze(self, settings: RelightAvatar) -> KeyedGaze | None:
        if not settings.gaze and not settings.gaze_direction:
            return None
        if settings.gaze and settings.gaze_direction:
            raise InputError("expected either --gaze or --gaze-direction, found both; name one")
        if not self.avatar.spec.eyes:
            raise InputError("--gaze: expected an avatar with explicit eyes, found one without; they look as tracked")
        eyes = sorted(self.avatar.eyes.fitted)
        if settings.gaze:
            return read_gaze_table(Path(settings.gaze), eyes)
        return fixed_gaze(settings.gaze_direction, eyes)

    def at(self, picture: int) -> DrivingSignal:
        """Driving signal of a picture. The same object as for the picture before, if it is the same pose."""
        pose = self.pose_of(picture)
        code, gaze = (None if table is None else table.at(picture) for table in (self.codes, self.gaze))
        key = (pose, *(None if array is None else array.tobytes() for array in (code, gaze)))
        if self._last is None or self._last[0] != key:
            self._last = key, self._driver(None if pose is None else self.poses[pose], code, gaze)
        return self._last[1]

    def pose_of(self, picture: int) -> int | None:
        """Index of the pose that a picture shows, or moves its head as."""
        return picture * len(self.poses) // self.pictures if self.poses else None

    def middle(self) -> Float64[np.ndarray, " 3"]:
        """The middle of the box around all that is shown, metres."""
        shown = (self.at(picture).vertices.astype(np.float64) for picture in range(self.pictures))
        ends = np.array([[vertices.min(0), vertices.max(0)] for vertices in shown])
        return (ends[:, 0].min(0) + ends[:, 1].max(0)) / 2

    def _driver(self, pose: DrivingSignal | None, code: np.ndarray | None, gaze: np.ndarray | None) -> DrivingSignal:
        spec = self.avatar.spec
        if spec.head and (code is not None or spec.anchors != "tracked"):
            motion = self.motion if self.motion is not None else pose.head_from_world
            signal = from_code(self.avatar, pose.code if code is None else code, motion)
            signal = signal if pose is None else replace(signal, gaze=pose.gaze)
        else:
            signal = pose if self.motion is None else moved_as(pose, self.motion)
        return signal if gaze is None else replace(signal, gaze=gaze)
