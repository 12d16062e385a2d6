"""Dials of train_avatar that decide how Gaussians become pixels, judged by the images of short trainings."""

from __future__ import annotations

from typing import get_args

from pipeline.base.files import read_json
from pipeline.config.train_avatar import DepthSource
from pipeline.dials.dial import CostedStage, Dial
from pipeline.dials.trained import psnr_lost

STEPS = 250
"""Enough for the sharpness of the splats to show; what is left to learn after them is the same for all settings."""

FILES = "--subject {subject} --atlas {results}/atlas.safetensors --shards {results}/shards "
EFFECTS = "--effects {results}/effects.json "

SHORT_TRAINING = CostedStage(
    name="train_avatar",
    arguments=FILES + EFFECTS + "--out {out}/avatars/full",
    inputs=("atlas.safetensors", "effects.json", "shards/train", "shards/frames", "shards/test"),
    outputs={"metrics": ("metrics.csv", None), "trained": ("avatars/full/config.json", None)},
    metrics=(psnr_lost("all"), psnr_lost("partial")),
    unit="steps",
    work=lambda output: read_json(output["trained"])["settings"]["steps"],
    afterwards={"evaluate_avatar": FILES + EFFECTS + "--avatars {out}/avatars/full --out {out}"},
)

SPLATTING_DIALS = [
    Dial("dilation", SHORT_TRAINING, "dilation_px2", lambda subject: (0.3, 0.1, 0.03, 0.01), {"steps": STEPS}),
    Dial("compensation", SHORT_TRAINING, "compensate_opacity", lambda subject: (True, False), {"steps": STEPS}),
    Dial("supersampling", SHORT_TRAINING, "supersample", lambda subject: (1, 2, 3), {"steps": STEPS}),
    Dial("depth", SHORT_TRAINING, "depth", lambda subject: get_args(DepthSource), {"steps": STEPS}),
]
