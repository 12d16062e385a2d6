"""An avatar in any pose under any light.

The one place that turns lights into the inputs of a frame.

Point lights go in as they are. An environment map goes in as its pixels, each a point light so far away that its
falloff is even (any avatar; cost grows with the pixels), or as harmonics and prefiltered panoramas (avatars that learn
their transfer; cost does not depend on the map). Shadow rays always go to the pixels of the reduced map.

All is linear in the light but the shadow network: it sees the light's distribution, normalised, not its strength.
Scaling a light scales the picture, exactly for powers of two; the picture of a sum of lights is the sum of the pictures
only without a shadow network.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64
from torch import Tensor

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.light_fields import NearField
from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.frames.sky import PreparedSky
from pipeline.avatar.intrinsic_layers import intrinsic_layers
from pipeline.avatar.relighting.driving_signal import DrivingSignal, as_signal
from pipeline.avatar.relighting.sky_lobe import under_sky, works_under_sky
from pipeline.avatar.training.checkpoint import LoadedAvatar, camera_view
from pipeline.base.errors import InputError
from pipeline.base.seeds import generator_for
from pipeline.capture.records import FrameRecord
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.cameras import Camera
from pipeline.lighting.distant import FAR_M
from pipeline.lighting.environment import Environment
from pipeline.lighting.environment_lobes import prefilter
from pipeline.lighting.environment_sh import project_environment
from pipeline.lighting.frame_irradiance import FrameTracer, StageLights
from pipeline.lighting.frame_lights import NO_LIGHTS, FrameLights
from pipeline.lighting.light_scene import LUMINANCE
from pipeline.lighting.point_lights import PointLights
from pipeline.rendering.splat_ply import Splats
from pipeline.rendering.splat_types import Gaussians

EXPRESSED_SPREAD = 1.5
"""How much rougher and smoother than at rest an expression may make a head before its panoramas run out; beyond, the
last is taken, scaled."""


class Relighter:
    """Prepares frames of one avatar; `view` shows them to cameras."""

    def __init__(self, loaded: LoadedAvatar, trace: TraceIrradiance) -> None:
        self.atlas, self.trace, self.light_gains = loaded.atlas, trace, loaded.light_gains
        # A new light may be nearer than those of the stage, whose distance did not matter.
        self.avatar = loaded.avatar.variant(field=NearField())
        self._under_sky = under_sky(self.avatar)

    @property
    def device(self) -> torch.device:
        """Device of the avatar's parameters."""
        return self.avatar.albedo.device

    @property
    def prefilters(self) -> bool:
        """Maps can go in by harmonics and panoramas.

        The transfer is learned, the lobe is of the mirror direction alone, and nothing is asked of lights one by one.
        """
        return works_under_sky(self.avatar)

    @torch.no_grad()
    def under_lights(self, pose: Float[np.ndarray, "vertices 3"] | DrivingSignal, lights: FrameLights) -> PreparedFrame:
        """A frame under point lights: positions in metres, radiant intensities."""
        return self._prepare(as_signal(pose), lights, lights, distant=False)

    @torch.no_grad()
    def under_pixels(
        self,
        pose: Float[np.ndarray, "vertices 3"] | DrivingSignal,
        environment: Environment,
        turn: Float64[np.ndarray, "3 3"],
    ) -> PreparedFrame:
        """A frame under a map turned by `turn` (world from map), as distant lights."""
        directions, irradiances = environment.directions().reshape(-1, 3) @ turn.T, environment.irradiances()
        far = FrameLights(FAR_M * directions, FAR_M**2 * irradiances)
        return self._prepare(as_signal(pose), FrameLights(directions, irradiances), far, distant=True)

    @torch.no_grad()
    def under_sky(
        self,
        pose: Float[np.ndarray, "vertices 3"] | DrivingSignal,
        sky: PreparedSky,
        environment: Environment,
        turn: Float64[np.ndarray, "3 3"],
    ) -> PreparedFrame:
        """Prepare a frame as `under_pixels` does, shaded by the harmonics and panoramas in `sky`.

        Args:
            environment: only casts shadows, those of lids on eyes, too.
        """
        directions, irradiances = environment.directions().reshape(-1, 3) @ turn.T, environment.irradiances()
        signal = as_signal(pose)
        maps = self._irradiance(signal.vertices, directions, irradiances, distant=True)
        pixels = None
        if self.avatar.eyes is not None:
            lit = irradiances.any(1)
            pixels = PointLights(self._tensor(FAR_M * directions[lit]), self._tensor(FAR_M**2 * irradiances[lit]))
        turned = replace(sky, world_from_map=self._tensor(turn), pixels=pixels)
        record = self._record(signal, NO_LIGHTS, maps)
        inputs = FrameInputs(self.atlas, record, turned, device=self.device)
        return self._under_sky.prepare(inputs, **self._code(signal))

    @torch.no_grad()
    def prepare_sky(self, environment: Environment) -> PreparedSky:
        """Harmonics of a map, and its panoramas for the roughnesses that this avatar has."""
        ladder = None
        if self.avatar.spec.lobe:
            roughness = self.avatar.log_roughness.exp()
            spread = EXPRESSED_SPREAD if self.avatar.spec.head else 1.0
            least, most = float(roughness.min()) / spread, float(roughness.max()) * spread
            ladder = prefilter(environment, least, most).to(self.device)
        harmonics = self._tensor(project_environment(environment))
        return PreparedSky(harmonics, ladder, torch.eye(3, device=self.device))

    @torch.no_grad()
    def view(self, frame: PreparedFrame, camera: Camera) -> tuple[Float[Tensor, "h w 3"], Float[Tensor, "h w"]]:
        """Linear RGB over black and alpha; the camera's distortion is left out."""
        avatar = self._under_sky if frame.under_sky else self.avatar
        picture = avatar.view(frame, camera_view(camera, self.device))
        return picture.rgb, picture.alpha

    @torch.no_grad()
    def render_layers(self, frame: PreparedFrame, camera: Camera) -> dict[str, Float[Tensor, "h w"]]:
        """The picture's parts over black, by channels that programs for compositing know.

        They are the `IntrinsicLayers`, with shadows in them and premultiplied by alpha: diffuse, indirect and specular
        add up to the picture. Normals are in the world; Z is the depth of what is seen, metres.
        """
        layers = intrinsic_layers(self.avatar, frame, camera_view(camera, self.device))
        shadow = 1.0 if frame.shading.shadow is None else layers.shadow
        images = {
            "albedo": layers.alpha * layers.albedo, "normal": layers.alpha * layers.normal,
            "diffuse": shadow * layers.diffuse, "specular": shadow * layers.specular,
            "indirect": torch.zeros_like(layers.diffuse) if layers.indirect is None else layers.indirect,
        }  # fmt: skip
        named = {
            f"{name}.{channel}": image[..., place]
            for name, image in images.items()
            for place, channel in enumerate("XYZ" if name == "normal" else "RGB")
        }
        return named | {"Z": layers.depth[..., 0]}

    @torch.no_grad()
    def code_of(self, signal: DrivingSignal) -> Float32[np.ndarray, " code"]:
        """The latent code that a head's encoder gives a pose: its mean (RGCA 3)."""
        ones = np.ones(self.atlas.texel_count, np.float32)
        inputs = FrameInputs(self.atlas, self._record(signal, NO_LIGHTS, (ones, ones)), device=self.device)
        return self.avatar.networks.encode(inputs).mean.cpu().numpy()

    def _prepare(
        self, signal: DrivingSignal, sources: FrameLights, lights: FrameLights, distant: bool
    ) -> PreparedFrame:
        """A frame under `lights`; shadow rays go to `sources`: the same, or directions and irradiances."""
        maps = self._irradiance(signal.vertices, sources.positions, sources.intensities, distant)
        record = self._record(signal, lights, maps)
        inputs = FrameInputs(
            self.atlas, record, gains=self.light_gains, shadowed=self.avatar.shadowed, device=self.device
        )
        return self.avatar.prepare(inputs, **self._code(signal))

    def _code(self, signal: DrivingSignal) -> dict[str, Tensor]:
        return {} if signal.code is None else {"code": self._tensor(signal.code)}

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.tensor(array, dtype=torch.float32, device=self.device)

    def _irradiance(
        self, vertices: np.ndarray, places: np.ndarray, intensities: np.ndarray, distant: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Both maps of `pipeline.lighting.irradiance`; ones, without a ray, for avatars that read none."""
        if not self.avatar.spec.shadow_net:
            ones = np.ones(self.atlas.texel_count, np.float32)
            return ones, ones
        stage = StageLights(places, {0: intensities @ LUMINANCE}, distant)
        traced = FrameTracer(self.atlas, stage, self.trace).trace(0, vertices, generator_for("relight_avatar"))
        return traced.values.astype(np.float32), traced.cosine_visibility.astype(np.float32)

    def _record(self, signal: DrivingSignal, lights: FrameLights, maps: tuple[np.ndarray, np.ndarray]) -> FrameRecord:
        lit = lights.intensities.any(1)
        return FrameRecord(
            frame=0, segment="", fully_lit=False, vertices=signal.vertices.astype(np.float32), irradiance=maps[0],
            cosine_visibility=maps[1], light_positions=lights.positions[lit].astype(np.float32),
            light_intensities=lights.intensities[lit].astype(np.float32), head_from_world=signal.head_from_world,
            texture=signal.texture, gaze=signal.gaze,
        )  # fmt: skip


def view_independent_color(frame: PreparedFrame) -> Float[Tensor, "texels 3"]:
    """Linear RGB of each Gaussian without its specular part. Diffuse times shadow, and indirect light."""
    shading = frame.shading
    color = shading.diffuse if shading.shadow is None else shading.diffuse * shading.shadow[:, None]
    return color if shading.indirect is None else color + shading.indirect


def splats_of(frame: PreparedFrame, exposure: float) -> Splats:
    """The frame's Gaussians with the colour that all sides share.

    Raises:
        InputError: for an avatar of volumes, which has none.
    """
    rgb, gaussians = exposure * view_independent_color(frame), frame.gaussians
    if not isinstance(gaussians, Gaussians):
        raise InputError("expected an avatar of Gaussians, found geometry: volumes, which has no splats to write")
    shapes = (gaussians.opacities, gaussians.scales, gaussians.quaternions)
    return Splats(gaussians.means, frame.surface.posed.normals, rgb, *shapes)
