"""Where commands run whose files lie in object storage."""

from __future__ import annotations

import subprocess
import sys

import pytest

from pipeline.base.errors import InputError
from pipeline.workflow.object_storage import require_own_captures, start_in


def test_commands_find_the_projects_code_and_settings_and_files_of_the_storage(tmp_path):
    project, copies = tmp_path / "a project", tmp_path / "a project/.snakemake/storage/s3/bucket"
    for folder in ("config", ".snakemake", "pipeline"):
        (project / folder).mkdir(parents=True)
    (project / "config/config.yaml").write_text("settings")
    (project / "pipeline/own.py").write_text("WORD = 'code'")
    # As Snakemake formats a prefix, and starts a command.
    words = "set -euo pipefail; " + start_in(copies.relative_to(project)).format()
    command = (
        "cat config/config.yaml; mkdir -p results; echo made > results/made; "
        f"{sys.executable} -c 'from pipeline.own import WORD; print(WORD)' > .snakemake/storage/s3/bucket/results/log"
    )
    for _ in range(2):
        done = subprocess.run(
            ["bash", "-c", words + command], cwd=project, env={"PATH": "/usr/bin:/bin"}, capture_output=True, text=True
        )
        assert (done.returncode, done.stdout) == (0, "settings"), done.stderr
    assert (copies / "results/made").read_text() == "made\n"
    assert (copies / "results/log").read_text() == "code\n"
    assert not (project / "results").exists()


@pytest.mark.parametrize("captures", ["/data/captures", "../captures", ".."])
def test_captures_that_have_no_place_in_the_storage_are_refused(tmp_path, captures):
    with pytest.raises(InputError, match="captures: expected a folder of the project"):
        require_own_captures(captures, tmp_path)
    require_own_captures(captures, None)
    require_own_captures("captures", tmp_path)
