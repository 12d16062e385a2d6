"""Training: shards in, an avatar out.

Adam on the per-texel parameters and the shadow network of `pipeline.avatar.model`, against the training images of the
shards (losses: RFGCA 17, 18, Appendix B). A checkpoint is written as it goes; a run that is stopped continues from it
to the same result, provided that settings, shards, atlas and plan are what they were.
"""

from __future__ import annotations

import hashlib
import logging
import time
from pathlib import Path

import pandas as pd
import torch
from torch.utils.tensorboard import SummaryWriter

from pipeline.avatar.checkpoint import save_avatar
from pipeline.avatar.model import Avatar
from pipeline.avatar.pose import FrameInputs, texel_spacing
from pipeline.avatar.spec import AvatarSpec, read_plan, spec_of
from pipeline.avatar.training import Schedule, make_optimizer, restore_state, save_state, take_step
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import digest_file, write_table
from pipeline.base.progress import progress
from pipeline.base.seeds import seed_for
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import read_atlas

log = logging.getLogger("train_avatar")


def run(
    *,
    subject: str,
    atlas: Path,
    shards: Path,
    effects: Path,
    out: Path,
    settings: TrainAvatar = TrainAvatar(),
) -> None:
    """Train an avatar on the shards of a subject.

    Args:
        subject: name of the subject; seeds the order of the images.
        atlas: atlas.safetensors of unwrap_atlas.
        shards: folder with train/*.arrow and frames/*.arrow of pack_shards.
        effects: effects.json of plan_effects: what is off there is not built, unless the settings insist.
        out: folder of the avatar: avatar.safetensors, config.json, log.parquet, TensorBoard events, and
            checkpoint.safetensors while training is under way.
        settings: see the flags below.
    """
    started = time.monotonic()
    images = read_image_shards([shards / "train"])
    if not len(images):
        raise InputError(f"{shards}/train: expected training images, found none; check `splits` in capture.yaml")
    texels = read_atlas(atlas)
    frames = {number: FrameInputs(texels, record) for number, record in read_frame_shards([shards / "frames"]).items()}
    planned = read_plan(effects)

    torch.manual_seed(seed_for(subject, "train_avatar"))
    spec = spec_of(settings, planned)
    if spec.shadow_net and all((frame.record.irradiance == 1).all() for frame in frames.values()):
        raise InputError(f"{shards}/frames: expected traced shadows, found none; run pack_shards with --irradiance")
    avatar = Avatar(texels, texel_spacing(texels), spec)
    optimizer = make_optimizer(avatar, settings)
    schedule = Schedule(subject, images.table.frame.tolist(), settings.cameras_per_step)
    fingerprint = fingerprint_of(settings, spec, [atlas, *sorted(shards.glob("*/*.arrow"))])
    checkpoint = out / "checkpoint.safetensors"
    first, rows = restore_state(checkpoint, fingerprint, avatar, optimizer)
    if checkpoint.exists():
        log.info("continuing after %d steps", first) if first else log.info("checkpoint of another training: not used")

    log.info("%d images, %d texels, effects: %s", len(images), len(texels.face), ", ".join(sorted(planned)) or "none")
    events = SummaryWriter(str(out / "events"), purge_step=first)
    for step in progress(range(first, settings.steps), "train_avatar"):
        batch = [images[index] for index in schedule[step]]
        values = take_step(step, avatar, optimizer, frames[batch[0].frame], batch, settings)
        if step % settings.log_every == 0 or step == settings.steps - 1:
            rows.append({"step": step, "seconds": time.monotonic() - started, "loss": sum(values.values()), **values})
            for name, value in rows[-1].items():
                events.add_scalar(name, value, step)
        if (step + 1) % settings.checkpoint_every == 0 and step + 1 < settings.steps:
            save_state(checkpoint, step + 1, rows, fingerprint, avatar, optimizer)
    events.close()
    write_table(out / "log.parquet", pd.DataFrame(rows))
    parameters = sum(parameter.numel() for parameter in avatar.parameters())
    seconds = round(time.monotonic() - started, 1)
    facts = {"subject": subject, "settings": settings.model_dump(), "effects": sorted(planned), "seconds": seconds}
    save_avatar(out, avatar, {**facts, "texels": len(texels.face), "parameters": parameters})
    checkpoint.unlink(missing_ok=True)
    log.info("%d steps in %.0f s, photometric %.4f", settings.steps, seconds, rows[-1]["photometric"])


def fingerprint_of(settings: TrainAvatar, spec: AvatarSpec, inputs: list[Path]) -> str:
    """What a checkpoint belongs to: settings, what is built, and the content of all inputs."""
    parts = [settings.model_dump_json(), str(spec), *(digest_file(path) for path in inputs)]
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=16).hexdigest()


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
