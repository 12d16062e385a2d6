"""The avatar of a body or a head: one primitive per texel, relit by composed parts.

RFGCA 3-16, RGCA 3-9. Every texel has parameters of its own, which are optimised directly; networks may add to them
what changes with pose, expression and view. `prepare` makes what all cameras of a frame share, `view` what each sees.
The parts are listed in `pipeline.avatar.build`.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import accumulate

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from pipeline.avatar.appearance.glossy import GlossySamples
from pipeline.avatar.appearance.layers import Layers
from pipeline.avatar.appearance.lobes import SMALLEST_ALPHA
from pipeline.avatar.build import build_parts
from pipeline.avatar.eyes.corneal_reflections import mirror_pixels
from pipeline.avatar.eyes.explicit_eyes import Eyes
from pipeline.avatar.frames.inputs import FrameInputs, white_once
from pipeline.avatar.frames.light_fields import IncidentLight
from pipeline.avatar.frames.prepared import Decoded, PosedEyes, PreparedFrame, Shading, Surface, ViewedParameters
from pipeline.avatar.networks.body_networks import BodyNetworks
from pipeline.avatar.networks.head_networks import HeadNetworks
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import GEOMETRY
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.eyes.eye_fit import FittedEye
from pipeline.geometry.texel_regions import in_regions
from pipeline.geometry.texels import Atlas
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.splat_types import CameraView


@dataclass(frozen=True)
class Picture:
    """One camera's picture of a frame.

    Attributes:
        rgb: linear RGB over black.
        alpha: coverage in [0, 1).
        normal: blended shading normals, if a lobe is evaluated per pixel.
        eye_visibility: specular visibility of eye texels, if it was decoded for this camera.
    """

    rgb: Float[Tensor, "h w 3"]
    alpha: Float[Tensor, "h w"]
    normal: Float[Tensor, "h w 3"] | None = None
    eye_visibility: Float[Tensor, " eye_texels"] | None = None


class Avatar(TexelStore):
    """Parameters of every texel, and what renders them for a pose, a light and a camera.

    Args:
        atlas: the texels the primitives sit on.
        spacing: size of each texel on the rest surface along tangent and bitangent, metres [texels, 2].
        spec: what is built.
        eyes: of eyes.json, by name, for an avatar with explicit eyes, or whose networks are told where they look.
    """

    def __init__(
        self, atlas: Atlas, spacing: Float[Tensor, "texels 2"], spec: AvatarSpec,
        eyes: Mapping[str, FittedEye] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(atlas, spacing)
        self.spec, self.networks, self.eyes = spec, None, None
        self.built, self.fitted_eyes = build_parts(self, spec), dict(eyes or {})
        for name in GEOMETRY if spec.given_geometry else ():
            self.get_parameter(name).requires_grad_(False)
        if spec.decoded:
            boxes = self.built.primitives.network_atlas
            build = partial(HeadNetworks, eyes=eyes or {}, boxes=boxes) if spec.head else BodyNetworks
            self.networks = build(atlas, spec, self.shared(), float(spacing.mean()))
        if spec.eyes:
            self.eyes = Eyes(atlas, eyes or {}, self.log_scale.detach().exp())
            if spec.eye_parameters == "decoded":
                self.eyes.add_decoders(spec, self.shared())
            with torch.no_grad():
                for name, values in self.eyes.start(spec, dict(self.named_parameters())).items():
                    getattr(self, name)[self.eyes.chosen] = values

    @cached_property
    def shadowed(self) -> Bool[np.ndarray, " texels"] | None:
        """Texels that the surface may hide lights from, and send light to; all if None."""
        return in_regions(self.atlas, self.spec.shadow_regions) if self.spec.shadow_regions else None

    def variant(self, **parts: object) -> Avatar:
        """An avatar of the same parameters, some of whose parts are others. See `Parts` for their names."""
        other = copy.copy(self)
        other.built = replace(self.built, **parts)
        return other

    @torch.no_grad()
    def trace(self, inputs: FrameInputs) -> FrameInputs:
        """Trace what `prepare` would trace of a frame, and return the inputs, which keep it.

        It may run on a thread of its own: most of it is Embree, which releases the interpreter's lock.
        """
        self.built.shadow.bits(inputs)
        self.built.indirect.trace(inputs)
        if self.eyes is not None:
            self.eyes.traced(inputs)
        return inputs

    def prepare(self, inputs: FrameInputs, **expression: Tensor) -> PreparedFrame:
        """Place and light everything of a frame that no camera changes (RFGCA 5-10, 15).

        Args:
            inputs: pose and light.
            expression: of a head, `noise` or `code`, see `HeadNetworks.decode`.
        """
        built, eyes = self.built, None
        lights = white_once(built.field.lights(inputs))
        decoded = self.decode(inputs, **expression)
        if self.eyes is not None:
            decoded, eyes = self.eyes.place(decoded, inputs)
        gaussians, axes = built.primitives.place(decoded.parameters, decoded.posed)
        lights = replace(lights, visibility_bits=built.shadow.bits(inputs))
        normals = built.normals.bend(decoded.parameters, axes, decoded.posed)
        surface = Surface(gaussians, axes, decoded.posed, normals)
        harmonics = built.field.harmonics(inputs) if built.diffuse.reads_harmonics else None
        if eyes is not None and eyes.harmonics is not None:
            harmonics = harmonics.index_copy(0, self.eyes.chosen, eyes.harmonics)
        incident = IncidentLight(built.field, inputs, lights, harmonics)
        shading = self.shade(decoded, surface, incident, eyes)
        return PreparedFrame(surface, decoded, incident, shading, eyes)

    def decode(self, inputs: FrameInputs, **expression: Tensor) -> Decoded:
        """Parameters of the texels in the pose or expression of a frame, and their anchors."""
        if self.networks is None:
            return Decoded(self.shared(), inputs.posed)
        return self.networks.decode(self.shared(), inputs, **expression)

    def shade(self, decoded: Decoded, surface: Surface, incident: IncidentLight, eyes: PosedEyes | None) -> Shading:
        """Light that leaves texels alike in all directions."""
        diffuse = self.built.diffuse.shade(decoded.parameters, surface, incident)
        if eyes is not None:
            diffuse = self.eyes.under_lids(eyes, diffuse)
        shadow = self.built.shadow.factor(incident.inputs)
        return Shading(diffuse, shadow, self.built.indirect.shade(surface, incident, diffuse, shadow))

    def view(self, frame: PreparedFrame, camera: CameraView) -> Picture:
        """Show a prepared frame to one camera."""
        return self.views([frame], camera)[0]

    def views(self, frames: Sequence[PreparedFrame], camera: CameraView) -> list[Picture]:
        """Show a frame to one camera in several lights, for each of which it was prepared.

        All are blended together.
        """
        layers = [self.layers(frame, camera.center) for frame in frames]
        stacks = [of_light.stacked() for of_light in layers]
        widths = [stack.shape[-1] for stack in stacks]
        firsts = accumulate(widths[:-1], initial=0)
        colors = [first + color for first, own in zip(firsts, layers, strict=True) for color in own.colors()]
        blended = self.draw(frames[0], torch.cat(stacks, -1), camera, colors)
        features = blended.features.split(widths, -1)
        return [
            self.picture(frame, own, blended._replace(features=images), camera)
            for frame, own, images in zip(frames, layers, features, strict=True)
        ]

    def picture(self, frame: PreparedFrame, layers: Layers, picture: Splatted, camera: CameraView) -> Picture:
        """Put the blended layers of a frame together."""
        images = layers.images(picture.features)
        rgb, of_eyes = self.shade_pixels(images, picture, frame, camera), None
        if self.eyes is not None and self.eyes.decoders is not None and layers.mirrors is not None:
            of_eyes = layers.mirrors[self.eyes.chosen, 0]
        return Picture(rgb, picture.alpha, images.normal, of_eyes)

    def draw(
        self, frame: PreparedFrame, features: Float[Tensor, "texels channels"], camera: CameraView,
        colors: Collection[int] = (0,),
    ) -> Splatted:  # fmt: skip
        """Blend features of the primitives, by default of those that face the camera (RFGCA 2).

        Colours begin at the channels `colors`.
        """
        gaussians = frame.gaussians
        if self.spec.culls:
            # A closed surface hides its far side; thin Gaussians would let it shine through the gaps.
            toward = camera.center - gaussians.means.detach()
            facing = (frame.surface.posed.normals * toward).sum(-1) > 0
            gaussians = replace(gaussians, opacities=gaussians.opacities * facing)
        return self.built.primitives.draw(gaussians, features, camera, colors)

    def viewed(self, frame: PreparedFrame, center: Float[Tensor, "3"]) -> ViewedParameters:
        """Parameters of texels as a camera at `center` sees them (RFGCA 14, RGCA 9, 10)."""
        viewed = ViewedParameters()
        if self.networks is not None:
            viewed = self.networks.viewed(frame.decoded, frame.surface, center)
        return viewed if frame.eyes is None else self.eyes.viewed(frame, center, viewed)

    def samples(self, frame: PreparedFrame, viewed: ViewedParameters) -> GlossySamples | None:
        """Texels as samples of the lobe, normals as a camera bends them; None without a lobe."""
        samples = self.built.specular.samples(frame, viewed)
        if samples is None or viewed.normal_offset is None:
            return samples
        around = (frame.parameters, frame.surface.axes, frame.surface.posed)
        return replace(samples, normals=self.built.normals.bend(*around, viewed.normal_offset))

    def leaving(
        self, frame: PreparedFrame, center: Float[Tensor, " 3"]
    ) -> tuple[Float[Tensor, "texels 3"], Float[Tensor, "texels 3"] | None]:
        """Diffuse and indirect light that leaves texels for a camera."""
        diffuse, indirect = frame.shading.diffuse, frame.shading.indirect
        passes = self.built.diffuse.passes(frame.surface, center)
        if passes is None:
            return diffuse, indirect
        return diffuse * passes, None if indirect is None else indirect * passes

    def layers(self, frame: PreparedFrame, center: Float[Tensor, " 3"]) -> Layers:
        """Layers that are blended for one camera. Light that the shadow network dims is a layer of its own."""
        specular, lobe, mirrors = self.built.specular, {}, None
        color, indirect = self.leaving(frame, center)
        viewed = self.viewed(frame, center)
        added, samples = specular.texel_light(frame, viewed, center), self.samples(frame, viewed)
        if frame.eyes is not None:
            color = self.eyes.seen_from(frame, center, color, viewed.eye_gain)
            mirrors = self.eyes.mirrors(frame.eyes, specular.mirrors(frame, viewed))
            if mirrors is not None:
                added, samples = self.eyes.without_gloss(added, samples)
        color = color if added is None else color + added
        if samples is not None:
            if specular.deferred:
                lobe = {"normal": samples.normals, "roughness": samples.roughness[:, None]}
                lobe["visibility"] = samples.visibility[:, None]
            else:
                color = color + specular.shade(samples, frame, center)
        shadow = frame.shading.shadow
        if shadow is None and indirect is not None:
            color, indirect = color + indirect, None
        shadow = None if shadow is None else shadow[:, None]
        return Layers(color, **lobe, shadow=shadow, indirect=indirect, mirrors=mirrors)

    def shade_pixels(
        self, images: Layers, picture: Splatted, frame: PreparedFrame, camera: CameraView
    ) -> Float[Tensor, "h w 3"]:
        """Shade pixels: (c_d + c_s) shadow (RFGCA 16).

        The specular lobe is evaluated once per covered pixel (RFGCA 11-12).
        """
        specular, color, alpha = self.built.specular, images.color, picture.alpha
        if images.normal is not None:
            row, column, light = specular.shade_pixels(images, picture, frame, camera)
            color = color.index_put((row, column), light.expand(-1, 3), accumulate=True)
        if images.mirrors is not None:
            row, column, mirrors = mirror_pixels(images.mirrors, frame.eyes, camera)
            passed = frame.eyes.lids.pass_mirrored(mirrors.points, mirrors.normals, camera.center)
            mirrors = replace(mirrors, visibility=mirrors.visibility * passed)
            light = specular.reflect(mirrors, frame, camera.center)
            color = color.index_put((row, column), light.expand(-1, 3), accumulate=True)
        if images.shadow is not None:
            shadow = images.shadow
            if self.spec.screen_maps == "normalised":
                shadow = shadow / alpha[..., None].clamp_min(SMALLEST_ALPHA)
            color = color * shadow
        return color if images.indirect is None else color + images.indirect
