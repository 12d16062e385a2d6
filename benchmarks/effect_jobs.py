"""The jobs that the workflow has left for a scene, once its effects are planned: counted by Snakemake itself.

The scene's files up to the plan are empty: a dry run looks at names and times alone, but for effects.json.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from pipeline.base.code_digest import ROOT
from pipeline.base.errors import InputError

COPIED = ("Snakefile", "workflow", "config")

CHUNK = re.compile(r"/(\d{4})(?=[/.]|$)")

CHUNK_FRAMES = 5
"""Frames of a job: the scenes of 15 frames then have three jobs of each kind that works on chunks."""


def count_jobs(
    folder: Path, plans: Mapping[str, Mapping[str, Any]], variants: Mapping[str, Mapping[str, Any]], frames: int
) -> dict[str, dict[str, int]]:
    """Plan `results/NAME/metrics.csv` of several scenes, each with one avatar.

    Args:
        folder: a project is made there; it need not exist.
        plans: name -> content of effects.json.
        variants: name -> what its avatar changes in train_avatar.
        frames: of each scene.

    Returns:
        Name -> rule -> how many jobs are left after plan_effects.

    Raises:
        InputError: if Snakemake fails, with what it printed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in COPIED:
        source = ROOT / name
        shutil.copytree(source, folder / name) if source.is_dir() else shutil.copy(source, folder)
    shutil.rmtree(folder / "config/subjects")
    for name in plans:
        _write(folder / f"captures/{name}/capture.yaml", "frames: frames.csv\n")
        _write(folder / f"captures/{name}/frames.csv", "frame\n" + "".join(f"{frame}\n" for frame in range(frames)))
        subject = {"chunk_frames": CHUNK_FRAMES, "variants": {"avatar": dict(variants[name])}}
        _write(folder / f"config/subjects/{name}.yaml", yaml.safe_dump(subject))
    for file, _ in _summary(folder, [f"results/{name}/effects.json" for name in plans]):
        _write(folder / file, "")
    for name, plan in plans.items():
        _write(folder / f"results/{name}/index/capture.json", json.dumps({"kind": "body"}))
        _write(folder / f"results/{name}/effects.json", json.dumps(plan))
    for path in folder.rglob("*"):
        os.utime(path, (0, 0))  # Nothing is newer than what was made of it.
    wanted = _summary(folder, [f"results/{name}/metrics.csv" for name in plans])
    # A job makes several files, of one chunk if it works on chunks.
    left = {(Path(file).parts[1], rule, *CHUNK.findall(file)) for file, rule in wanted if not (folder / file).exists()}
    return {name: dict(Counter(rule for subject, rule, *_ in left if subject == name)) for name in plans}


def _summary(folder: Path, targets: Iterable[str]) -> list[tuple[str, str]]:
    """(file, rule) of every file that the targets need and a rule makes."""
    command = [sys.executable, "-m", "snakemake", "--cores", "1", "--summary", "--rerun-triggers", "mtime", "--"]
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [*command, *targets], cwd=folder, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True
    )
    if done.returncode != 0:
        raise InputError(f"snakemake: expected a plan, found:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    lines = [line.split("\t") for line in done.stdout.splitlines() if "\t" in line]
    file, rule = (lines[0].index(name) for name in ("output_file", "rule"))
    return [(line[file], line[rule]) for line in lines[1:]]


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
