"""Runs of the whole workflow, as a user starts them."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pipeline.base.files import write_table


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


def keep_run(run: Mapping[str, Any], by: Sequence[str], out: Path) -> None:
    """Write a run among the others of a table, in place of the one that is equal in the columns `by`."""
    before = [pd.read_csv(out)] if out.exists() else []
    others = [one[(one[list(by)] != [run[name] for name in by]).any(axis=1)] for one in before]
    write_table(out, pd.concat([*others, pd.DataFrame([run])]))
