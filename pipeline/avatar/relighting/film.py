"""An avatar in any pose under any light: the one place that turns lights into what an avatar's frame is made of.

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

from pipeline.avatar.pose import FrameInputs, texel_spacing
from pipeline.avatar.relighting.driving_signal import Driver, driver_of
from pipeline.avatar.relighting.environment_avatar import EnvironmentAvatar, PreparedSky, SkyInputs
from pipeline.avatar.training.checkpoint import LoadedAvatar
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
from pipeline.lighting.irradiance import LUMINANCE


class Relighter:
    """Prepares frames of one avatar; `view` shows them to cameras."""

    def __init__(self, loaded: LoadedAvatar, trace: TraceIrradiance) -> None:
        self.avatar, self.atlas, self.trace = loaded.avatar, loaded.atlas, trace
        # A new light may be nearer than those of the stage, whose distance did not matter.
        self.avatar.spec = replace(self.avatar.spec, near_field=True)
        self._under_sky: EnvironmentAvatar | None = None

    @property
    def device(self) -> torch.device:
        """Where the avatar is."""
        return self.avatar.albedo.device

    @property
    def prefilters(self) -> bool:
        """Whether maps can go in by harmonics and panoramas: the transfer is learned and turns with each Gaussian, the
        lobe is deferred and of the mirror direction alone, and nothing is asked of lights one by one."""
        spec = self.avatar.spec
        one_by_one = spec.traced or spec.indirect == "ambient"
        one_by_one |= spec.lobe and (not spec.deferred or spec.highlight == "half")
        return spec.shading == "transfer" and not one_by_one

    @torch.no_grad()
    def under_lights(self, pose: Float[np.ndarray, "vertices 3"] | Driver, lights: FrameLights) -> dict:
        """A frame under point lights: positions in metres, radiant intensities."""
        return self._prepare(driver_of(pose), lights, lights, distant=False)

    @torch.no_grad()
    def under_pixels(
        self,
        pose: Float[np.ndarray, "vertices 3"] | Driver,
        environment: Environment,
        turn: Float64[np.ndarray, "3 3"],
    ) -> dict:
        """A frame under a map turned by `turn` (world from map), as distant lights."""
        directions, irradiances = environment.directions().reshape(-1, 3) @ turn.T, environment.irradiances()
        far = FrameLights(FAR_M * directions, FAR_M**2 * irradiances)
        return self._prepare(driver_of(pose), FrameLights(directions, irradiances), far, distant=True)

    @torch.no_grad()
    def under_sky(
        self,
        pose: Float[np.ndarray, "vertices 3"] | Driver,
        sky: PreparedSky,
        environment: Environment,
        turn: Float64[np.ndarray, "3 3"],
    ) -> dict:
        """As `under_pixels`, shaded by the harmonics and panoramas in `sky`; `environment` only casts shadows."""
        if self._under_sky is None:
            eyes = self.avatar.eyes.fitted if self.avatar.spec.eyes else None
            spacing = texel_spacing(self.atlas)
            under_sky = EnvironmentAvatar(self.atlas, spacing, self.avatar.spec, eyes).to(self.device)
            under_sky.load_state_dict(self.avatar.state_dict())
            self._under_sky = under_sky.eval()
        directions, irradiances = environment.directions().reshape(-1, 3) @ turn.T, environment.irradiances()
        driver = driver_of(pose)
        maps = self._irradiance(driver.vertices, directions, irradiances, distant=True)
        turned = replace(sky, world_from_map=self._tensor(turn))
        record = self._record(driver, NO_LIGHTS, maps)
        return self._under_sky.prepare(SkyInputs(self.atlas, record, turned, device=self.device))

    @torch.no_grad()
    def prepare_sky(self, environment: Environment) -> PreparedSky:
        """Harmonics of a map, and its panoramas for the roughnesses that this avatar has."""
        ladder = None
        if self.avatar.spec.lobe:
            roughness = self.avatar.log_roughness.exp()
            ladder = prefilter(environment, float(roughness.min()), float(roughness.max())).to(self.device)
        harmonics = self._tensor(project_environment(environment))
        return PreparedSky(harmonics, ladder, torch.eye(3, device=self.device))

    @torch.no_grad()
    def view(self, frame: dict, camera: Camera) -> tuple[Float[Tensor, "h w 3"], Float[Tensor, "h w"]]:
        """Linear RGB over black and alpha; the camera's distortion is left out."""
        avatar = self._under_sky if "sky" in frame else self.avatar
        R, t, K = (self._tensor(array) for array in (camera.R, camera.t, camera.K))
        picture = avatar.view(frame, R, t, K, camera.width, camera.height)
        return picture["rgb"], picture["alpha"]

    @torch.no_grad()
    def code_of(self, driver: Driver) -> Float32[np.ndarray, " code"]:
        """The latent code that a head's encoder gives a pose: its mean (RGCA 3)."""
        ones = np.ones(self.atlas.texel_count, np.float32)
        inputs = FrameInputs(self.atlas, self._record(driver, NO_LIGHTS, (ones, ones)), device=self.device)
        return self.avatar.networks.encode(inputs).mean.cpu().numpy()

    def _prepare(self, driver: Driver, sources: FrameLights, lights: FrameLights, distant: bool) -> dict:
        """A frame under `lights`; shadow rays go to `sources`: the same, or directions and irradiances."""
        maps = self._irradiance(driver.vertices, sources.positions, sources.intensities, distant)
        inputs = FrameInputs(self.atlas, self._record(driver, lights, maps), device=self.device)
        code = {} if driver.code is None else {"code": self._tensor(driver.code)}
        return self.avatar.prepare(inputs, **code)

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
        return traced.values.astype(np.float32), traced.falling.astype(np.float32)

    def _record(self, driver: Driver, lights: FrameLights, maps: tuple[np.ndarray, np.ndarray]) -> FrameRecord:
        lit = lights.intensities.any(1)
        return FrameRecord(
            frame=0, segment="", fully_lit=False, vertices=driver.vertices.astype(np.float32), irradiance=maps[0],
            cosine_visibility=maps[1], light_positions=lights.positions[lit].astype(np.float32),
            light_intensities=lights.intensities[lit].astype(np.float32), head_from_world=driver.head_from_world,
            texture=driver.texture, gaze=driver.gaze,
        )  # fmt: skip


def view_independent_color(frame: dict) -> Float[Tensor, "texels 3"]:
    """Linear RGB of each Gaussian without its specular part: diffuse times shadow, and indirect light."""
    color = frame["diffuse"]
    if "shadow" in frame:
        color = color * frame["shadow"][:, None]
    return color + frame["indirect"] if "indirect" in frame else color
