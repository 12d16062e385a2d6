"""Training: shards in, an avatar out.

Adam on the per-texel parameters and the shadow network of `pipeline.avatar.model`, against the training images of the
shards (losses: RFGCA 17, 18, Appendix B). A checkpoint is written as it goes, and when a signal asks to stop; a run
that was stopped continues from it to the same result, provided that code, settings, shards, atlas and plan are what
they were. Several processes work side by side, on one machine by themselves; on several, srun starts the stage on each
node of a Slurm cluster, and elsewhere `python -m torch.distributed.run ... -m pipeline.stages.train_avatar ...`.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from pipeline.avatar.frames.camera_offsets import MovedImages
from pipeline.avatar.frames.frame_stream import FrameStream
from pipeline.avatar.frames.scratch import own_scratch
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.spec.gpu_limits import require_drawable
from pipeline.avatar.spec.planned import (
    read_gloss_width,
    read_plan,
    read_regions_on,
    reason_of,
    resolve_spec,
    unread_settings,
)
from pipeline.avatar.spec.spec_words import describe
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import save_avatar
from pipeline.avatar.training.distributed import joined_processes
from pipeline.avatar.training.expression_statistics import learn_expressions, statistics_frames
from pipeline.avatar.training.given_geometry import take_geometry, with_given_geometry
from pipeline.avatar.training.lacking import lacking_in_tables, unusual_size
from pipeline.avatar.training.local_processes import cache_bytes, partners, suggested_processes
from pipeline.avatar.training.loop import BROKEN, CHECKPOINT, train, warn_of
from pipeline.avatar.training.losses import dropped_terms
from pipeline.avatar.training.read_ahead import frames_in_use
from pipeline.avatar.training.slurm_nodes import become_torchrun, shares_a_step
from pipeline.avatar.training.training import Position, Training
from pipeline.avatar.training.training_images import chosen_images, require_no_held_out
from pipeline.base.code_digest import code_digest
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import digest_file, write_table
from pipeline.base.seeds import seed_for
from pipeline.base.spread import evenly
from pipeline.capture.shards import FrameShards, read_frame_shards, read_image_shards
from pipeline.config.train_avatar import TrainAvatar
from pipeline.eyes.eye_fit import read_eyes
from pipeline.geometry.texels import read_atlas

log = logging.getLogger("train_avatar")

WATCHED_BY = {"checkpoint_every", "log_every", "preview_every", "device"}
"""Settings that change how a training is run and watched, but not where it goes: checkpoints stay valid."""


def run(
    *,
    subject: str,
    atlas: Path,
    shards: Path,
    effects: Path,
    out: Path,
    frames: Path | None = None,
    fitted_eyes: Path | None = None,
    given_geometry: Path | None = None,
    processes: int = 0,
    cache_mb: int = 16_000,
    scratch: Path | None = None,
    settings: TrainAvatar = TrainAvatar(),
) -> None:
    """Train an avatar on the shards of a subject.

    Args:
        subject: name of the subject; seeds the order of the images.
        atlas: atlas.safetensors of unwrap_atlas.
        shards: folder with train/*.arrow and frames/*.arrow of pack_shards.
        effects: effects.json of plan_effects: what is off there is not built, unless the settings insist.
        out: folder of the avatar: avatar.safetensors, config.json, log.parquet, TensorBoard events, previews/, and
            checkpoint.safetensors while training is under way; broken.safetensors if a number was not finite.
        frames: folder of frame shards with other irradiance maps than SHARDS/frames.
        fitted_eyes: eyes.json of fit_eyes, for an avatar with explicit eyes.
        given_geometry: folder of the avatar that `geometry_from` names.
        processes: that train together, on each node; 0: on a CPU one per thread, at most `steps_together`; on a GPU
            one.
        cache_mb: megabytes that frames may be kept in, at most half of the memory that is free at the start; all others
            are read from the shards and traced again at each visit, ahead of it. It changes no result.
        scratch: folder on a local disk, for traced light of those others, which is then read and not traced again. At
            most half of the disk's free space is filled; what was written is deleted at the end.
        settings: see the flags below.
    """
    if shares_a_step():
        become_torchrun(processes or suggested_processes(settings))
    paths = {"atlas": atlas, "shards": shards, "effects": effects, "out": out}
    arguments = {"subject": subject, "frames": frames, "fitted_eyes": fitted_eyes, "settings": settings, **paths}
    arguments |= {"given_geometry": given_geometry, "cache_mb": cache_mb, "scratch": scratch}
    together = partners(processes or suggested_processes(settings), run, arguments)
    with together, joined_processes(settings.device) as processes, own_scratch(scratch) as traced:
        images = MovedImages(read_image_shards([shards / "train"]))
        if not len(images):
            raise InputError(f"{shards}/train: expected training images, found none; check `splits` in capture.yaml")
        require_no_held_out(images.table, shards / "train")
        texels = read_atlas(atlas)
        frames = frames or shards / "frames"
        records, planned = read_frame_shards([frames]), read_plan(effects)
        kind = "head" if records.table.is_head.any() else "body"
        spec = resolve_spec(settings, planned, kind, read_regions_on(effects), read_gloss_width(effects))
        require_drawable(spec, processes.device)
        require_inputs(spec, settings, records, frames, fitted_eyes, given_geometry)
        spec = spec if given_geometry is None else with_given_geometry(spec, given_geometry)
        read = [*(shards / "train").glob("[!.]*.arrow"), *frames.glob("[!.]*.arrow"), *[fitted_eyes] * spec.reads_eyes]
        read += [] if given_geometry is None else [given_geometry / "avatar.safetensors"]
        fingerprint = fingerprint_of(settings, spec, [atlas, *sorted(read)])

        drawn = f"{subject}, seed {settings.seed}" if settings.seed else subject
        torch.manual_seed(seed_for(drawn, "train_avatar"))
        fitted = read_eyes(fitted_eyes) if spec.reads_eyes else None
        avatar = Avatar(texels, texel_spacing(texels), spec, fitted).to(processes.device)
        if given_geometry is not None:
            take_geometry(avatar, given_geometry, atlas)
        inputs = FrameStream(
            texels, records, cache_bytes(cache_mb, processes.device), frames_in_use(settings, processes),
            processes.device, traced, avatar.shadowed,
        )  # fmt: skip
        chosen = chosen_images(images.table, records, settings, subject)
        if spec.head:
            seen = sorted(set(images.table.frame.iloc[chosen].tolist()))
            learn_expressions(avatar, (inputs[number] for number in evenly(seen, statistics_frames(texels))))
        facts = {
            "subject": subject, "settings": settings.model_dump(), "effects": sorted(planned),
            "dropped_terms": dropped_terms(settings), "built": describe(spec), "why": reason_of(settings, effects),
            "texels": len(texels.face),
        }  # fmt: skip
        work = f"{len(chosen)} images, {len(texels.face)} texels, {processes.count} x {processes.device.type}"
        log_start(facts, work, unread_settings(settings, spec))
        if processes.is_main:
            warn_of(unusual_size(avatar) + lacking_in_tables(images.table.iloc[chosen], records))
        training = Training(avatar, settings, processes, drawn, len(chosen))
        done = train(drawn, training, images, chosen, inputs, out, fingerprint)
        if processes.is_main:
            write_avatar(out, avatar, done, facts)


def require_inputs(
    spec: AvatarSpec, settings: TrainAvatar, records: FrameShards, frames: Path, fitted_eyes: Path | None,
    given_geometry: Path | None,
) -> None:  # fmt: skip
    """Require what the avatar is built from.

    Raises:
        InputError: if traced shadows, fitted eyes or another avatar's Gaussians are missing, or there for nothing.
    """
    if spec.shadow_net and all((record.irradiance == 1).all() for record in records.values()):
        raise InputError(f"{frames}: expected traced shadows, found none; run pack_shards with --irradiance")
    if spec.reads_eyes and fitted_eyes is None:
        raise InputError(
            "--fitted-eyes: expected eyes.json of fit_eyes, as eyes are on, found none; set eyes: off and "
            "gaze_features: false"
        )
    if bool(settings.geometry_from) != (given_geometry is not None):
        expected = "the folder of an avatar" if settings.geometry_from else "none, as geometry_from is empty"
        raise InputError(f"--given-geometry: expected {expected}, found {given_geometry or 'none'}")


def log_start(facts: Mapping[str, Any], work: str, unread: Sequence[str]) -> None:
    """Log what is trained, on what, and which settings do nothing."""
    log.info("%s: %s", facts["built"], facts["why"])
    if unread:
        log.warning("set, but read by nothing that is built: %s", ", ".join(unread))
    for name, why in facts["dropped_terms"].items():
        log.info("the loss has no term %s: %s", name, why)
    log.info("%s, effects: %s", work, ", ".join(facts["effects"]) or "none")


def write_avatar(out: Path, avatar: Avatar, done: Position, facts: Mapping[str, Any]) -> None:
    """Write the trained avatar and the log; the checkpoint has served."""
    write_table(out / "log.parquet", pd.DataFrame(done.rows))
    # No times: those are in the log alone.
    parameters = sum(parameter.numel() for parameter in avatar.parameters())
    found = {"light_gains": done.light_gains, "camera_offsets": done.camera_offsets}
    save_avatar(out, avatar, {**facts, **found, "parameters": parameters})
    for name in (CHECKPOINT, BROKEN):
        (out / name).unlink(missing_ok=True)
    log.info("%d steps in %.0f s, photometric %.4f", done.step, done.seconds, done.rows[-1]["photometric"])


def fingerprint_of(settings: TrainAvatar, spec: AvatarSpec, inputs: list[Path]) -> str:
    """Fingerprint of a checkpoint: code, settings, what is built, and the content of all inputs.

    Of settings only those count that change the result. A run that goes on with other code than it began with would end
    as neither does from the start.
    """
    parts = [code_digest("pipeline.stages.train_avatar"), settings.model_dump_json(exclude=WATCHED_BY), str(spec)]
    parts += [digest_file(path) for path in inputs]
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=16).hexdigest()


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
