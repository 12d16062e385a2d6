"""Settings of training."""

from __future__ import annotations

from collections.abc import Collection

from pydantic import model_validator

from pipeline.config.trained_model import ANALYTIC, Kind, TrainedModel
from pipeline.config.training_losses import TrainingLosses


class TrainAvatar(TrainingLosses, TrainedModel):
    """Training of an avatar.

    Loss weights are those of RFGCA 17-18 and its Appendix B, or RGCA 11-15 where named.
    """

    def decided(self, planned: Collection[str], kind: Kind = "body") -> TrainAvatar:
        """Settings with what a plan decided in place of every `auto`.

        Whatever else they say is obeyed.

        Args:
            planned: the effects that are on.
            kind: what the capture is of.
        """
        avatar = kind if self.avatar == "auto" else self.avatar
        shading = self.shading
        if shading == "auto":
            shading = "subsurface" if "learned_transport" in planned else "microfacet"
        if avatar == "head" and shading == "transfer":
            shading = "harmonics"
        if avatar == "head" and shading not in ANALYTIC:
            planned = set(planned) - {"shadow"}  # RGCA 5: what hides a light is in the transfer
        modes: dict[str, object] = {
            name: "on" if name in planned else "off"
            for name in ("specular", "shadow", "near_field", "articulation", "deferred", "eyes")
            if getattr(self, name) == "auto"
        }
        if self.eyes == "auto" and self.geometry == "volumes":
            modes["eyes"] = "off"
        if self.normals == "auto":
            modes["normals"] = "viewed" if avatar == "head" else "learned"
        if self.highlight == "auto":
            modes["highlight"] = "half" if avatar == "head" else "angular"
        if self.visibility == "auto":
            modes["visibility"] = "traced" if shading in ANALYTIC else "learned"
        if self.indirect == "auto":
            # Where nothing is in the way of a light, nothing sends light to another part either.
            shadow = modes.get("shadow", self.shadow)
            modes["indirect"] = "bounce" if shading in ANALYTIC and shadow == "on" else "none"
        # A capture that declares no eyes has no gaze to tell.
        modes["gaze_features"] = self.gaze_features and ("eyes" in planned or self.eyes == "on")
        return self.model_copy(update=modes | {"avatar": avatar, "shading": shading})

    def reads_irradiance(self, planned: Collection[str], kind: Kind = "body") -> bool:
        """True if an avatar with these settings has a shadow network."""
        decided = self.decided(planned, kind)
        return decided.shadow == "on" and decided.visibility == "learned"

    def reads_textures(self, kind: Kind = "body") -> bool:
        """True if an avatar with these settings is encoded from mean textures."""
        return self.decided((), kind).avatar == "head"

    def reads_eyes(self, planned: Collection[str]) -> bool:
        """True if an avatar with these settings has explicit eyes, or is told where they look."""
        decided = self.decided(planned)
        return decided.eyes == "on" or decided.gaze_features

    @model_validator(mode="after")
    def _lids_are_learned_by_decoders(self) -> TrainAvatar:
        if self.lids == "learned" and self.eye_parameters != "decoded":
            raise ValueError("lids: learned: expected eye_parameters: decoded, which learn them, found texels")
        return self

    @model_validator(mode="after")
    def _volumes_stand_on_skin_in_tangent_frames(self) -> TrainAvatar:
        needed = {"eyes": "off", "texel_frame": "tangent"} if self.geometry == "volumes" else {}
        for name, value in needed.items():
            found = getattr(self, name)
            if found not in (value, "auto"):
                raise ValueError(f"geometry: volumes: expected {name}: {value}, which boxes have, found {found}")
        if self.geometry == "volumes" and self.depth == "median":
            raise ValueError(
                "geometry: volumes: expected depth: traced, normalised or expected, found median: rays have no median"
            )
        return self

    @model_validator(mode="after")
    def _gpu_knows_no_median_depth(self) -> TrainAvatar:
        lobe = self.shading in ("transfer", "harmonics") and self.highlight != "harmonics"
        per_pixel = lobe and self.specular != "off" and self.deferred != "off"
        if self.device == "cuda" and self.depth == "median" and per_pixel:
            raise ValueError("device: cuda: expected depth: traced, normalised or expected, found median")
        return self

    @model_validator(mode="after")
    def _light_in_harmonics_has_no_visibility(self) -> TrainAvatar:
        if self.shading == "harmonics" and self.visibility == "traced":
            raise ValueError("shading: harmonics: expected visibility: learned, found traced, which it cannot use")
        return self
