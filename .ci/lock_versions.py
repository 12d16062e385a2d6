"""Exact versions with hashes for the ranges of pyproject.toml: `make lock` runs this.

uv resolves for every Python and platform at once; pip installs the result. No index is named: packages come from where
pip (for installing) and uv (for this) are told to look. Versions that a lock already holds stay as long as they fit;
with `--upgrade` all are the newest that fit. `envs/README.md` says which lock is for what.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import textwrap
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

OLDEST_PYTHON = "3.11"
"""The oldest Python that the locks serve: `requires-python` of pyproject.toml, which a test checks."""

NOT_TRIED = """\
Not tried: processors other than x86-64, Python after 3.13, systems other than Linux, an index that has other files.
One package, connection-pool, has no wheel: pip builds it with a setuptools that it fetches for the build, which no
hash here covers. pip itself is the one that Python brings."""


@dataclass(frozen=True)
class Lock:
    """A lock file of `envs/`.

    Attributes:
        name: of the file.
        extras: of pyproject.toml that are in it, besides what the project itself needs.
        text: of the header: its use, and what was tried.
        builds: packages with a local version label, as `torch+cpu`: that build is taken in place of the registry's.
        versions_of: another lock, before this one in `LOCKS`, with which all versions agree.
    """

    name: str
    extras: tuple[str, ...]
    text: str
    builds: tuple[str, ...] = ()
    versions_of: str | None = None


LOCKS = (
    Lock(
        "lock-cuda.txt",
        extras=("dev",),
        text="""\
The versions of lock.txt, but torch as the registry serves it. On Linux that is the build for GPUs, and CUDA's
libraries (cuda-*, nvidia-*, triton) come with it. `make` installs this where pip finds no CPU build of torch.
Tried on x86-64 Linux: Python 3.12, installed into an empty environment, and some of the tests there (base, synthesis,
rendering); Python 3.13, all files found and their hashes right (`pip install --dry-run`).
Not tried: the other tests with these files, Python 3.11 with them, and a GPU.""",
    ),
    Lock(
        "lock.txt",
        extras=("dev",),
        builds=("torch+cpu",),
        versions_of="lock-cuda.txt",
        text="""\
The ranges of pyproject.toml and its extra `dev` as exact versions, with torch's CPU build. The registry does not have
that build: pip finds it in a folder of wheels, or on an index that it is told of. CUDA's libraries are not in here.
Where pip finds no such build, `make` installs lock-cuda.txt.
Tried on x86-64 Linux: Python 3.11, installed into an empty environment. The tests are run with these versions.
Not tried: Python 3.12 and 3.13. Of the CPU build only the wheel for Python 3.11 was there to take a hash of; where
others are, `make lock` adds theirs.""",
    ),
)
"""All locks, in the order in which they are made. One for another extra, as lock-docs.txt, is one more entry."""


def header(lock: Lock) -> str:
    """The comment on top of a lock: its maker, its contents, and what nobody has tried."""
    text = f"Made by `make lock`, not by hand.\n{lock.text}\n{NOT_TRIED}"
    return textwrap.indent("\n".join(text.splitlines()), "# ") + "\n"


def exact_builds(lock: Lock, dependencies: list[str]) -> list[str]:
    """The requirements that ask for a lock's builds, e.g. `torch==2.13.0+cpu`.

    Raises:
        ValueError: a package of `builds` has no exact version in pyproject.toml, so there is no version to label.
    """
    pinned = dict(item.split("==") for item in dependencies if "==" in item)
    missing = [build for build in lock.builds if build.partition("+")[0] not in pinned]
    if missing:
        raise ValueError(f"pyproject.toml has to name exact versions (==) of {missing}")
    return [f"{name}=={pinned[name]}+{label}" for name, _, label in (build.partition("+") for build in lock.builds)]


def folders_of_wheels() -> list[str]:
    """The folders and pages of wheels that pip is told of: uv does not read pip's settings."""
    printed = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=True
    )
    settings = dict(line.split("=", 1) for line in printed.stdout.splitlines())
    found = [value.strip("'").split() for name, value in settings.items() if name.endswith("find-links")]
    return sorted({place for places in found for place in places})


def resolved(lock: Lock, project: dict, folder: Path, upgrade: bool) -> str:
    """The lines of a lock, as uv resolves them for `project`, the content of pyproject.toml."""
    output, build_tools, builds = (folder / f"{lock.name}.{part}" for part in ("out", "build", "builds"))
    if not upgrade and lock_path(lock.name).exists():
        output.write_text(lock_path(lock.name).read_text())
    # The project itself is built without fetching anything: its build tools are locked too.
    build_tools.write_text("\n".join(project["build-system"]["requires"]) + "\n")
    options = [f"--extra={extra}" for extra in lock.extras]
    if lock.builds:
        builds.write_text("\n".join(exact_builds(lock, project["project"]["dependencies"])) + "\n")
        options += [f"--overrides={builds}", *(f"--find-links={place}" for place in folders_of_wheels())]
    if lock.versions_of:
        options += [f"--constraints={lock_path(lock.versions_of)}"]
    asked = ["--universal", "--generate-hashes", f"--python-version={OLDEST_PYTHON}", "--prerelease=disallow"]
    written = ["--no-header", "--no-annotate", f"--output-file={output}"]
    uv = [sys.executable, "-m", "uv", "pip", "compile", "--quiet"]
    subprocess.run([*uv, *asked, *written, *options, "pyproject.toml", build_tools], cwd=ROOT, check=True)
    return output.read_text()


def lock_path(name: str) -> Path:
    """The file of a lock."""
    return ROOT / "envs" / name


def main() -> None:
    """Write all locks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--upgrade", action="store_true", help="take the newest versions that fit")
    arguments = parser.parse_args()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    with tempfile.TemporaryDirectory() as folder:
        for lock in LOCKS:
            lines = resolved(lock, project, Path(folder), arguments.upgrade)
            lock_path(lock.name).write_text(header(lock) + lines)


if __name__ == "__main__":
    main()
