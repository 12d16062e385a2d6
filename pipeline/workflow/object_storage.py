"""Runs whose files lie in object storage, where machines share no file system.

Snakemake then fetches what a job declares as input into a folder of the machine that runs it, and stores what it
declares as output from there: `--default-storage-provider s3 --default-storage-prefix s3://BUCKET`. Stages know nothing
of that. Their commands name files by paths below the project's folder, and run in that local folder in place of it.
"""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import Any

from pipeline.base.errors import InputError
from pipeline.workflow.job_files import RESULTS

LINKED = (".snakemake", "config")
"""Folders of the project that the local folder has as links: logs and inputs are named by their place in the first,
relative to the project, and settings by theirs in the second."""


def local_copies(workflow: Any) -> Path | None:
    """Folder in which a job's files lie as else in the project's; None without storage.

    Args:
        workflow: Snakemake's.
    """
    settings = workflow.storage_settings
    if settings.default_storage_provider is None:
        return None
    query = f"{settings.default_storage_prefix.rstrip('/')}/{RESULTS}"
    return Path(workflow.storage_registry.default_storage_provider.object(query).local_path()).parent


def start_in(copies: Path) -> str:
    """Shell words before a command that make it run in the folder of local copies.

    With the project's code. Several jobs may set the folder up at a time. Braces are doubled: Snakemake takes others
    for its own.
    """
    there = shlex.quote(str(copies))
    links = " ".join(f'; [ -e {there}/{name} ] || ln -s "$PWD/{name}" {there}/ 2> /dev/null || true' for name in LINKED)
    code = 'export PYTHONPATH="$PWD:${{PYTHONPATH:-}}"'
    return f"mkdir -p {there}{links}; {code}; cd {there}; "


def require_own_captures(captures: str, copies: Path | None) -> None:
    """Refuse captures that have no place in the storage.

    Raises:
        InputError: if they lie outside the project's folder.
    """
    if copies is not None and (os.path.isabs(captures) or captures.split("/")[0] == ".."):
        raise InputError(
            f"configuration: captures: expected a folder of the project, such as captures, found {captures}: files "
            "of the storage are named by their paths below the project"
        )
