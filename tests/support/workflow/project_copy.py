"""A copy of the project in which tests run the workflow and edit anything."""

from __future__ import annotations

import re
import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.base.code_digest import KEPT
from tests.support.workflow.snakemake_server import SnakemakeServer
from tests.support.workflow.stage_server import StageServer

COPIED = ("workflow", "profiles", "config", "envs")
CODE = "pipeline"
CORES = ("--cores", "2")


@dataclass(frozen=True)
class ProjectCopy:
    """Snakemake in a folder with a copy of the project."""

    folder: Path
    server: SnakemakeServer
    python: Path | None = None
    """What jobs are started with instead of Python, if anything: that of a `StageServer`."""

    @classmethod
    def made(cls, root: Path, folder: Path, server: SnakemakeServer) -> ProjectCopy:
        """Copy what the workflow needs; the code is a link, so that all copies share what is kept beside it.

        That is compiled kernels, and the parsed code that plans digest, where there is a folder for it.
        """
        folder.mkdir(parents=True, exist_ok=True)
        (root / KEPT).parent.mkdir(exist_ok=True)
        shutil.copy(root / "Snakefile", folder)
        for name in COPIED:
            shutil.copytree(root / name, folder / name)
        (folder / CODE).symlink_to(root / CODE)
        return cls(folder, server)

    def copied(self, folder: Path) -> ProjectCopy:
        """The project as it is, elsewhere; times are kept. The code is a link to this one's, until it is edited."""
        code = self.folder / CODE
        shutil.copytree(self.folder, folder, symlinks=True, ignore=lambda at, _: [CODE] * (at == str(self.folder)))
        (folder / CODE).symlink_to(code.resolve())
        return replace(self, folder=folder)

    def with_stages_of(self, server: StageServer) -> ProjectCopy:
        """The same with jobs that do not import the libraries each for itself."""
        return replace(self, python=server.python)

    def with_own_code(self) -> ProjectCopy:
        """The same with code that may be edited."""
        code = self.folder / CODE
        if code.is_symlink():
            linked = code.resolve()
            code.unlink()
            shutil.copytree(linked, code, ignore=shutil.ignore_patterns("__pycache__"))
        return self

    def command(self, *words):
        """The words that start Snakemake as a process of its own."""
        return [sys.executable, "-m", "snakemake", *CORES, *words]

    def snakemake(self, *words):
        """The finished process; its stdout has everything that was printed."""
        return self.server.run([*CORES, *words], self.folder, self.python)

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
        path = self._own(name)
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    def append(self, name, text):
        with open(self._own(name), "a") as file:
            file.write(text)

    def _own(self, name):
        """A file that is nobody else's."""
        if Path(name).parts[0] == CODE:
            self.with_own_code()
        return self.folder / name
