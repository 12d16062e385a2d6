"""Runs of the whole workflow, as a user starts them."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path


def run_options(description: str, out: Path) -> argparse.ArgumentParser:
    """Command line of a benchmark of whole runs; its table is at `out` unless another is named."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--subjects", nargs="+", required=True)
    parser.add_argument("--captures", default="captures", help="folder of the captures")
    parser.add_argument("--config", default="", help="further settings of the runs, key=value")
    parser.add_argument("--out", type=Path, default=out)
    return parser


def run_workflow(target: Path, config: Sequence[str], presets: Sequence[str] = ()) -> None:
    """Make a file of the workflow on two cores.

    Args:
        target: the file.
        config: settings, key=value.
        presets: files of settings.

    Raises:
        CalledProcessError: if the workflow fails.
    """
    command = [sys.executable, "-m", "snakemake", "--cores", "2", "--quiet", "all"]
    command += ["--config", *config] if config else []
    command += ["--configfile", *presets] if presets else []
    subprocess.run([*command, "--", str(target)], check=True, env={**os.environ, "PYTHONPATH": os.getcwd()})
