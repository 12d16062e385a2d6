"""Light of a frame as texels gather it. From lamps where they are, from far lamps, or from a sky."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.lighting.distant import LIGHTS_THAT_PAY, gather_distant
from pipeline.lighting.environment_sh import gather_environment, turned_light
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal import gather_light


class LightField(ABC):
    """Dependence of the light on the place."""

    @abstractmethod
    def lights(self, inputs: FrameInputs) -> PointLights:
        """Point lights of the frame; none where the light is no sum over them."""

    @abstractmethod
    def harmonics(self, inputs: FrameInputs) -> Float[Tensor, "#texels 81 channels"]:
        """Light at every texel in spherical harmonics of the body's frame."""

    @abstractmethod
    def along_axes(
        self, inputs: FrameInputs, lights: PointLights, points: Tensor, axes: Tensor, degrees: int
    ) -> Float[Tensor, "texels 3 {degrees} channels"]:
        """Incident light per axis and degree, see `pipeline.lighting.zonal.gather_light`."""


class NearField(LightField):
    """Lights at their distance."""

    def lights(self, inputs: FrameInputs) -> PointLights:
        """The lights as they are."""
        return inputs.lights

    def harmonics(self, inputs: FrameInputs) -> Float[Tensor, "texels 81 channels"]:
        """Light of each texel's own place."""
        return inputs.harmonics

    def along_axes(
        self, inputs: FrameInputs, lights: PointLights, points: Tensor, axes: Tensor, degrees: int
    ) -> Float[Tensor, "texels 3 {degrees} channels"]:
        """Sum over the lights."""
        return gather_light(points, axes, lights, degrees)


class FarField(LightField):
    """One direction and strength of each light for all texels."""

    def lights(self, inputs: FrameInputs) -> PointLights:
        """The lights moved far away."""
        return inputs.far_lights

    def harmonics(self, inputs: FrameInputs) -> Float[Tensor, "1 81 channels"]:
        """Light at the subject's centre."""
        return inputs.body_light[None]

    def along_axes(
        self, inputs: FrameInputs, lights: PointLights, points: Tensor, axes: Tensor, degrees: int
    ) -> Float[Tensor, "texels 3 {degrees} channels"]:
        """Light by harmonics where lights are many and none is shadowed; else the sum over them."""
        if lights.visibility_bits is None and len(lights) >= LIGHTS_THAT_PAY:
            return gather_distant(axes, inputs.world_light[: degrees**2])
        return gather_light(points, axes, lights, degrees)


class SkyField(NearField):
    """Sky of a frame's inputs, for learned transfer (RFGCA 7-9, RGCA 5)."""

    def harmonics(self, inputs: FrameInputs) -> Float[Tensor, "texels 81 channels"]:
        """Harmonics of the map in the frame of the body or head, alike at all texels."""
        light = turned_light(inputs.sky.harmonics, inputs.root_from_world @ inputs.sky.world_from_map)
        return light.expand(len(inputs.posed.points), -1, -1)

    def along_axes(
        self, inputs: FrameInputs, lights: PointLights, points: Tensor, axes: Tensor, degrees: int
    ) -> Float[Tensor, "texels 3 {degrees} channels"]:
        """Harmonics of the map, turned with it."""
        return gather_environment(inputs.sky.world_from_map.T @ axes, inputs.sky.harmonics[: degrees**2])


@dataclass(frozen=True)
class IncidentLight:
    """Light of one frame, as the parts of an appearance are given it.

    Attributes:
        field: how it depends on the place.
        lights: point lights with their shadows, if these are traced.
        harmonics: the light at texels in spherical harmonics of the body's frame, where the diffuse model reads them;
            that of eyes in the frames of eyes.
    """

    field: LightField
    inputs: FrameInputs
    lights: PointLights
    harmonics: Float[Tensor, "#texels 81 channels"] | None = None

    def along_axes(self, points: Tensor, axes: Tensor, degrees: int) -> Float[Tensor, "texels 3 {degrees} channels"]:
        """Incident light per axis of a texel and degree."""
        return self.field.along_axes(self.inputs, self.lights, points, axes, degrees)
