"""Light of the pictures of relight_avatar: listed lamps, or a turning sky. And what is seen behind the subject."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Float32, Float64

from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.relighting.driving_signal import DrivingSignal
from pipeline.avatar.relighting.film import Relighter
from pipeline.base.errors import InputError
from pipeline.config.relight_avatar import RelightAvatar
from pipeline.geometry.cameras import Camera
from pipeline.lighting.environment import Environment
from pipeline.lighting.environment_lobes import sample_environment
from pipeline.lighting.frame_lights import FrameLights
from pipeline.lighting.light_lists import LightList


def turned(turns: float, picture: int, pictures: int) -> Float64[np.ndarray, "3 3"]:
    """Rotation of a picture, of so many rounds in all: counter-clockwise as seen from above."""
    angle = 2 * np.pi * turns * picture / pictures
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])


class ListedLights:
    """Point lights, which may move, and turn about a vertical; black behind the subject."""

    def __init__(
        self, relighter: Relighter, lights: LightList, middle: Float64[np.ndarray, " 3"], turns: float, pictures: int
    ) -> None:
        self.relighter, self.lights, self.middle = relighter, lights, middle
        self.turns, self.pictures = turns, pictures
        self.still = turns == 0 and all(len(times) == 1 for times, _ in lights.keys.values())

    def frame(self, pose: Float[np.ndarray, "vertices 3"] | DrivingSignal, picture: int) -> PreparedFrame:
        """The avatar in a pose, lit as in a picture."""
        lights, turn = self.lights.at(picture), turned(self.turns, picture, self.pictures)
        places = lights.positions if self.turns == 0 else self.middle + (lights.positions - self.middle) @ turn.T
        return self.relighter.under_lights(pose, FrameLights(places, lights.intensities))

    def behind(self, camera: Camera, picture: int) -> Float[np.ndarray, "h w 3"]:
        """Linear RGB where the subject is not."""
        return np.zeros((camera.height, camera.width, 3), np.float32)


def reduced_to(sky: Environment, height: int) -> Environment:
    """The map at the largest height up to `height` that divides its own."""
    rows = len(sky.radiance)
    return sky.reduced(max(n for n in range(1, min(height, rows) + 1) if rows % n == 0))


class TurningSky:
    """An environment map, which may turn about the vertical.

    Raises:
        InputError: if `lobes` is asked for and the avatar has no use for them.
    """

    def __init__(self, relighter: Relighter, sky: Environment, settings: RelightAvatar, pictures: int) -> None:
        self.relighter, self.sky, self.pictures = relighter, sky, pictures
        self.turns, self.still = settings.environment_turns, settings.environment_turns == 0
        self.shown = settings.background == "environment"
        self.reduced = reduced_to(sky, settings.environment_height)
        if settings.environment_light == "lobes" and not relighter.prefilters:
            raise InputError(
                "--environment-light lobes: expected an avatar with learned transfer, a lobe about the mirror "
                f"direction and no traced light, found {relighter.avatar.spec}; ask for pixels"
            )
        by_lobes = settings.environment_light != "pixels" and relighter.prefilters
        lit_by = reduced_to(sky, settings.prefiltered_height) if settings.prefiltered_height else sky
        self.prepared = relighter.prepare_sky(lit_by) if by_lobes else None

    def turn(self, picture: int) -> Float64[np.ndarray, "3 3"]:
        """World from map."""
        return turned(self.turns, picture, self.pictures)

    def frame(self, pose: Float[np.ndarray, "vertices 3"] | DrivingSignal, picture: int) -> PreparedFrame:
        """The avatar in a pose, lit as in a picture."""
        if self.prepared is None:
            return self.relighter.under_pixels(pose, self.reduced, self.turn(picture))
        return self.relighter.under_sky(pose, self.prepared, self.reduced, self.turn(picture))

    def behind(self, camera: Camera, picture: int) -> Float32[np.ndarray, "h w 3"]:
        """Linear RGB where the subject is not: the map as the camera sees it, or black."""
        if not self.shown:
            return np.zeros((camera.height, camera.width, 3), np.float32)
        row, column = np.mgrid[: camera.height, : camera.width] + 0.5
        directions = camera.ray_directions(np.stack([column.ravel(), row.ravel()], 1)) @ self.turn(picture)
        return sample_environment(self.sky, directions.astype(np.float32)).reshape(camera.height, camera.width, 3)
