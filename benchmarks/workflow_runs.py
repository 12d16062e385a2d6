"""Runs of the whole workflow, as a user starts them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path


def run_workflow(target: Path, config: Sequence[str], presets: Sequence[str] = (), cores: int = 2) -> None:
    """Make a file of the workflow.

    Args:
        target: the file.
        config: settings, key=value.
        presets: files of settings.
        cores: that the workflow may use.

    Raises:
        CalledProcessError: if the workflow fails.
    """
    command = [sys.executable, "-m", "snakemake", "--cores", str(cores), "--quiet", "all"]
    command += ["--config", *config] if config else []
    command += ["--configfile", *presets] if presets else []
    subprocess.run([*command, "--", str(target)], check=True, env={**os.environ, "PYTHONPATH": os.getcwd()})
