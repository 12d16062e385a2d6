"""Settings of the evaluation."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from pipeline.config.datasets import DATASETS
from pipeline.config.settings import Settings


class EvaluateAvatar(Settings):
    """Scoring of renderings."""

    metrics: tuple[Literal["ms_ssim", "st_lpips", "psnr_image", "psnr_face"], ...] = Field(
        (),
        description="Further image metrics to score, a column each. ms_ssim: multi-scale SSIM (Wang, Simoncelli and "
        "Bovik 2003); images of less than 161 pixels a side leave it empty. st_lpips: shift-tolerant LPIPS (Ghildyal "
        "and Liu 2022), whose network comes with its package; its numbers do not compare with those of LPIPS. "
        "psnr_image: PSNR over all pixels of the image, those beside the subject being right: what programs say that "
        "mask both images first. psnr_face: PSNR over the pixels that show the face, as the template labels "
        "it, or a joint moves the head, or as near as a face reaches from two eyes",
    )
    splits: tuple[Literal["test", "validation"], ...] = Field(
        ("test", "validation"),
        min_length=1,
        description="Held-out images to score: test and validation images, or either",
    )
    protocol: Literal["ours", *DATASETS] = Field(
        "ours",
        description="Whose protocol splits, sizes and metrics follow: ours, or that of a public set, whose preset "
        "config/presets/set_NAME.yaml says it beside all else that belongs to it. It stands in metrics.csv, and "
        "changes no number",
    )
    lpips_net: Literal["alex", "vgg"] = Field(
        "alex",
        description="LPIPS backbone; alex is the authors' choice for scoring. Numbers of the two do not compare",
    )
    lpips_backbone: str = Field(
        "",
        description="File with the backbone's ImageNet weights (alexnet-owt-7be5be79.pth or vgg16-397923af.pth); "
        "empty: torch's hub cache; download: fetched to that cache. Without it LPIPS stays empty",
    )
    pictures: bool = Field(True, description="Write the worst, median and best image of each avatar side by side")
    intrinsic_layers: bool = Field(
        True,
        description="Beside pictures, write of what each avatar's light is made in its median image: albedo, normal, "
        "roughness, visibility, diffuse and specular light, shadow",
    )

    @model_validator(mode="after")
    def _pictures_are_of_test_images(self) -> EvaluateAvatar:
        if self.pictures and "test" not in self.splits:
            raise ValueError("splits: expected test among them, of which pictures are, or pictures: false; found none")
        return self
