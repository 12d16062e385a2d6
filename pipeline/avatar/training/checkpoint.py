"""Avatars and training states on disk: safetensors and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from pipeline.avatar.frames.camera_offsets import CAMERAS_AS_CALIBRATED, CameraOffsets
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.light_gains import AS_CALIBRATED, LightGains
from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.intrinsic_layers import IntrinsicLayers, intrinsic_layers
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json, written_whole
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.eyes.eye_fit import eyes_from_json
from pipeline.geometry.cameras import Camera
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.rendering.splat_types import CameraView


def save_avatar(folder: Path, avatar: Avatar, config: Mapping) -> None:
    """Write avatar.safetensors, then config.json with what was built and how it was trained."""
    with written_whole(folder / "avatar.safetensors") as temporary:
        temporary.write_bytes(safetensors.torch.save(avatar.state_dict()))
    eyes = {name: eye.as_json() for name, eye in avatar.fitted_eyes.items()}
    write_json(folder / "config.json", {"spec": avatar.spec.as_json(), "eyes": eyes, **config})


class LoadedAvatar:
    """An avatar with its atlas, ready to render the frames and cameras of shards.

    Attributes:
        light_gains: of the capture's lights, as training refined them.
        camera_offsets: of the capture's cameras, as training refined them; `render` sees images by these.
    """

    def __init__(
        self, avatar: Avatar, atlas: Atlas, light_gains: LightGains = AS_CALIBRATED,
        camera_offsets: CameraOffsets = CAMERAS_AS_CALIBRATED,
    ) -> None:  # fmt: skip
        self.avatar, self.atlas, self.light_gains = avatar.eval(), atlas, light_gains
        self.camera_offsets = camera_offsets
        self._frame: tuple[object, PreparedFrame] | None = None  # cameras of one frame share its light and shadow

    def trace(self, frame: FrameRecord) -> FrameInputs:
        """Trace a frame for `render`, so that it need not; it may be done on another thread."""
        return self.avatar.trace(self.inputs(frame))

    @torch.no_grad()
    def render(self, frame: FrameRecord | FrameInputs, image: ImageRecord) -> tuple[Tensor, Tensor]:
        """Linear RGB [h, w, 3] over black and alpha [h, w] of the crop that `image` describes."""
        picture = self.avatar.view(self._prepared(frame), self._camera(image))
        return picture.rgb, picture.alpha

    @torch.no_grad()
    def intrinsic_layers(self, frame: FrameRecord | FrameInputs, image: ImageRecord) -> IntrinsicLayers:
        """Layers that the light of that crop is made of."""
        return intrinsic_layers(self.avatar, self._prepared(frame), self._camera(image))

    def _camera(self, image: ImageRecord) -> CameraView:
        return camera_view(self.camera_offsets.moved(image), self.avatar.albedo.device)

    def _prepared(self, frame: FrameRecord | FrameInputs) -> PreparedFrame:
        if self._frame is None or self._frame[0] is not frame:
            inputs = frame if isinstance(frame, FrameInputs) else self.inputs(frame)
            self._frame = (frame, self.avatar.prepare(inputs))
        return self._frame[1]

    def inputs(self, frame: FrameRecord) -> FrameInputs:
        """Inputs of a frame, as this avatar reads them."""
        avatar = self.avatar
        return FrameInputs(
            self.atlas, frame, gains=self.light_gains, shadowed=avatar.shadowed, device=avatar.albedo.device
        )


def camera_view(image: ImageRecord | Camera, device: torch.device | str = "cpu") -> CameraView:
    """The camera of a crop, or one without its distortion, in float32."""
    tensors = (torch.tensor(array, dtype=torch.float32, device=device) for array in (image.R, image.t, image.K))
    return CameraView(*tensors, image.width, image.height)


def load_avatar(folder: Path, atlas_path: Path) -> LoadedAvatar:
    """Read an avatar that `save_avatar` wrote.

    Raises:
        InputError: if the folder holds no avatar, one of another version, or one trained on another atlas.
    """
    atlas = read_atlas(atlas_path)
    described = read_json(folder / "config.json")
    stored, eyes = described["spec"], eyes_from_json(described.get("eyes", {}), f"{folder}/config.json: eyes")
    if stored.keys() != {field.name for field in fields(AvatarSpec)}:
        raise InputError(f"{folder}/config.json: spec: expected the keys of this version, found others; train again")
    avatar = Avatar(atlas, texel_spacing(atlas), AvatarSpec.from_json(stored), eyes)
    state, built = load_tensors(folder / "avatar.safetensors")[0], avatar.state_dict()
    if state.keys() == built.keys() and len(state["albedo"]) != len(built["albedo"]):
        found, expected = len(state["albedo"]), len(built["albedo"])
        raise InputError(f"{folder}: expected {expected} texels as in {atlas_path}, found {found}; train again")
    if {name: tensor.shape for name, tensor in state.items()} != {name: tensor.shape for name, tensor in built.items()}:
        raise InputError(
            f"{folder}/avatar.safetensors: expected the tensors of this version, found others; train again"
        )
    avatar.load_state_dict(state)
    cameras = CameraOffsets.from_json(described.get("camera_offsets", {}))
    return LoadedAvatar(avatar, atlas, LightGains.from_json(described.get("light_gains", [])), cameras)


def load_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and text metadata of a safetensors file.

    Raises:
        InputError: if the file is missing or damaged.
    """
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            return {key: file.get_tensor(key) for key in file.keys()}, dict(file.metadata() or {})  # noqa: SIM118
    except (OSError, safetensors.SafetensorError) as error:
        raise InputError(f"{path}: expected a safetensors file, found: {error}") from error
