"""A copy of the project in which tests may run the workflow and edit anything."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

COPIED = ("Snakefile", "workflow", "profiles", "config", "envs", "pipeline")


@dataclass(frozen=True)
class Workflow:
    """Snakemake in a folder with a copy of the project."""

    folder: Path

    def command(self, *words):
        return [sys.executable, "-m", "snakemake", "--cores", "2", *words]

    def snakemake(self, *words):
        """The finished process; its stdout has everything that was printed."""
        return subprocess.run(
            self.command(*words), cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )

    def planned(self, target, *options):
        """What a dry run would run: rule -> number of jobs."""
        done = self.snakemake("--dry-run", *options, "--", target)
        assert done.returncode == 0, done.stdout
        if "Nothing to be done" in done.stdout:
            return {}
        table = done.stdout[done.stdout.rindex("Job stats:") :]
        rows = dict(re.findall(r"^(\w+) +(\d+)$", table, flags=re.MULTILINE))
        rows.pop("total")
        return {rule: int(count) for rule, count in rows.items()}

    def ran(self, target, *options):
        """What a run did run: rules in order of completion."""
        done = self.snakemake(*options, "--", target)
        assert done.returncode == 0, done.stdout
        return re.findall(r"^Finished jobid: \d+ \(Rule: (\w+)\)", done.stdout, flags=re.MULTILINE)

    def refused(self, target, *options):
        """What is printed by a call that has to fail before anything runs."""
        done = self.snakemake("--dry-run", *options, "--", target)
        assert done.returncode != 0, done.stdout
        return done.stdout

    def edit(self, name, old, new):
        path = self.folder / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    def append(self, name, text):
        with open(self.folder / name, "a") as file:
            file.write(text)


@pytest.fixture(scope="session")
def copy_of_project(repo_root):
    """A function: copies what the workflow needs to a folder."""

    def copy(folder):
        for name in COPIED:
            source = repo_root / name
            if source.is_dir():
                shutil.copytree(source, folder / name)  # With __pycache__: kernels that are compiled already.
            else:
                folder.mkdir(parents=True, exist_ok=True)
                shutil.copy(source, folder)
        return Workflow(folder)

    return copy
