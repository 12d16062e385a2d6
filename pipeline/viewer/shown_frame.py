"""One frame of an avatar as the page draws it: Gaussians, their visibility and bounces."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, UInt8, UInt16, UInt32

from pipeline.avatar.frames.light_gains import AS_CALIBRATED
from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.matter import read_matter
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.spec.spec_words import describe
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.base.errors import InputError
from pipeline.capture.records import FrameRecord
from pipeline.geometry.texels import Atlas
from pipeline.lighting.distant import FAR_M
from pipeline.lighting.environment import Environment
from pipeline.viewer.packing import LEVELS, half_floats, octahedral, quantized, table

SKY_HEIGHT = 8
"""Rows of the panorama whose pixels are lights of the page: 128 directions, one texel of bits each Gaussian."""

LOG_SCALES = (-16.0, 2.0)
"""Bounds of the logarithms of scales: 0.1 micrometres to 7 m, in steps of 0.03 %."""


@dataclass(frozen=True)
class ShownFrame:
    """Tables of one frame; see `pipeline.viewer.packing`.

    Attributes:
        frame: its number.
        low, high: box around the Gaussians' means and the mesh, metres.
        place: x, y, z in the box, opacity, and the quaternion w, x, y, z.
        shape: logarithms of the scales, 0, shading normal and the mesh's, both in the Gaussian's own axes.
        visibility_bits: rows of the stage's lights, then of the sky's pixels.
        hit_counts, hits: texels hit by the rays of each, one after the other.
        vertices: of the posed mesh in the box: lamps that are placed in the page cast its shadows.
    """

    frame: int
    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]
    place: UInt16[np.ndarray, "n 8"]
    shape: UInt16[np.ndarray, "n 8"]
    visibility_bits: UInt8[np.ndarray, "lights bytes"]
    hit_counts: UInt8[np.ndarray, " n"]
    hits: UInt32[np.ndarray, " hits"]
    vertices: UInt16[np.ndarray, "vertices 3"]


def require_analytic(spec: AvatarSpec, name: str) -> None:
    """Refuse avatars whose light is learned.

    Raises:
        InputError: naming what the page cannot compute.
    """
    if spec.volumes:
        raise InputError(f"{name}: spec: geometry: expected gaussians, which a page can draw, found volumes")
    if spec.shading != "microfacet" or spec.shadow_net or spec.indirect == "ambient":
        raise InputError(
            f"{name}: spec: expected Lambert and GGX with traced shadows and one bounce or none, which a page can "
            f"compute; found {describe(spec)}; train a variant with shading: microfacet and visibility: traced"
        )


def left_out(spec: AvatarSpec) -> list[str]:
    """Sentences on what the pipeline renders and the page does not."""
    eyes = ["Eyes are skin: no reflections on corneas, no shade of the lids, no iris that looks deeper from the side."]
    return eyes if spec.eyes else []


def sky_positions() -> Float64[np.ndarray, "pixels 3"]:
    """Positions of the sky's pixels, as distant lights that relight_avatar would make of them."""
    black = Environment(np.zeros((SKY_HEIGHT, 2 * SKY_HEIGHT, 3), np.float32))
    return FAR_M * black.directions().reshape(-1, 3)


@torch.no_grad()
def shown_frame(
    loaded: LoadedAvatar, record: FrameRecord, lights: Float64[np.ndarray, "lights 3"],
    code: Float32[np.ndarray, " code"] | None = None,
) -> ShownFrame:  # fmt: skip
    """Place an avatar in the pose of a frame, and trace what it sees of all lights.

    Args:
        loaded: of the avatar.
        record: the pose; its own light does not matter.
        lights: positions of the stage's lights, metres.
        code: latent code of a head, in place of what the encoder says of the record.
    """
    places = np.concatenate([lights, sky_positions()]).astype(np.float32)
    lit = replace(record, light_positions=places, light_intensities=np.ones_like(places))
    inputs = replace(loaded.inputs(lit), gains=AS_CALIBRATED)
    prepared = loaded.avatar.prepare(inputs, **({} if code is None else {"code": torch.tensor(code)}))
    means = prepared.gaussians.means.numpy().astype(np.float64)
    together = np.concatenate([means, record.vertices])
    low, high = together.min(0), together.max(0)
    count, bits = len(means), prepared.incident.lights.visibility_bits
    bits = np.full((len(places), -(-count // 8)), 255, np.uint8) if bits is None else bits
    hits = np.zeros((count, 0), np.int64)
    if loaded.avatar.spec.indirect == "bounce":
        hits = np.sort(inputs.bounces.numpy(), 1)  # the order of a sum does not matter, that of what is packed does
    met = hits < count
    return ShownFrame(
        record.frame, low, high, _place(prepared, low, high), _shape(prepared), bits,
        met.sum(1).astype(np.uint8), hits[met].astype(np.uint32), quantized(record.vertices, low, high),
    )  # fmt: skip


def _place(prepared: PreparedFrame, low: np.ndarray, high: np.ndarray) -> UInt16[np.ndarray, "n 8"]:
    gaussians = prepared.gaussians
    means, opacities = gaussians.means.numpy().astype(np.float64), gaussians.opacities.numpy()[:, None]
    quaternions = torch.nn.functional.normalize(gaussians.quaternions, dim=1).numpy()
    return table(quantized(means, low, high), quantized(opacities, 0.0, 1.0), quantized(quaternions, -1.0, 1.0))


def _shape(prepared: PreparedFrame) -> UInt16[np.ndarray, "n 8"]:
    surface = prepared.surface
    inverse = surface.axes.numpy().swapaxes(1, 2)
    local = [
        octahedral((inverse @ normals.numpy()[..., None])[..., 0])
        for normals in (surface.bent_normals, surface.posed.normals)
    ]
    logs = quantized(np.log(surface.gaussians.scales.numpy().clip(np.exp(LOG_SCALES[0]))), *LOG_SCALES)
    return table(logs, np.zeros((len(logs), 1), np.uint16), *local)


def surface_matter(avatar: Avatar) -> UInt16[np.ndarray, "n 8"]:
    """Albedo, width of GGX, scale of its gloss, and share of the coat, as float16.

    No frame changes them. An avatar without gloss has a scale of 0.
    """
    matter = read_matter(avatar)
    columns = (
        matter.albedo,
        matter.width[:, None],
        matter.gloss[:, None],
        np.full((len(matter.gloss), 1), matter.coat),
    )
    return table(*map(half_floats, columns))


def texel_anchors(atlas: Atlas) -> UInt16[np.ndarray, "n 4"]:
    """Face of each texel, low and high bits, and the weights of the face's first two corners."""
    face = atlas.face.astype(np.uint32)
    halves = np.stack([face & LEVELS, face >> 16], 1).astype(np.uint16)
    return np.concatenate([halves, quantized(atlas.barycentric[:, :2], 0.0, 1.0)], 1)
