"""The locks of exact versions are in step with the ranges of pyproject.toml."""

from __future__ import annotations

import importlib.util
import re
import sys
import tomllib

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PYTHONS = ("3.11", "3.12", "3.13")
LOCKS = ("lock.txt", "lock-cuda.txt")
CUDA = re.compile(r"(nvidia|cuda)-|triton$")


@pytest.fixture(scope="module")
def pyproject(repo_root):
    return tomllib.loads((repo_root / "pyproject.toml").read_text())


@pytest.fixture(scope="module")
def lines(repo_root):
    """Lock -> its requirements with their hashes, in the order of the file."""

    def read(path):
        text = re.sub(r"\\\n", " ", re.sub(r"(?m)^#.*\n", "", path.read_text()))
        split = [re.split(r"\s+--hash=", line.strip()) for line in text.splitlines() if line.strip()]
        return [(Requirement(requirement), hashes) for requirement, *hashes in split]

    return {name: read(repo_root / "envs" / name) for name in LOCKS}


def on_linux(python):
    return {
        "python_version": python, "python_full_version": f"{python}.0", "sys_platform": "linux", "os_name": "posix",
        "platform_system": "Linux", "platform_machine": "x86_64", "implementation_name": "cpython",
        "platform_python_implementation": "CPython", "extra": "",
    }  # fmt: skip


def versions(lock, python):
    """Package -> locked versions, for one Python on Linux."""
    found = {}
    for requirement, _ in lock:
        if requirement.marker is None or requirement.marker.evaluate(on_linux(python)):
            (pin,) = requirement.specifier
            found.setdefault(canonicalize_name(requirement.name), []).append(pin.version)
    return found


@pytest.mark.parametrize("name", LOCKS)
@pytest.mark.parametrize("python", PYTHONS)
def test_lock_has_one_version_in_the_range_of_every_requirement(pyproject, lines, name, python):
    project, locked = pyproject["project"], versions(lines[name], python)
    assert {package: found for package, found in locked.items() if len(found) > 1} == {}
    asked = project["dependencies"] + project["optional-dependencies"]["dev"] + pyproject["build-system"]["requires"]
    for requirement in map(Requirement, asked):
        (version,) = locked.get(canonicalize_name(requirement.name), [None])
        assert version and requirement.specifier.contains(version), f"{requirement} in {name}: run `make lock`"


@pytest.mark.parametrize("name", LOCKS)
def test_every_line_is_exact_and_hashed_and_names_no_index(repo_root, lines, name):
    for requirement, hashes in lines[name]:
        (pin,) = requirement.specifier
        assert pin.operator == "==" and "*" not in pin.version and requirement.url is None, str(requirement)
        assert hashes and all(re.fullmatch(r"sha256:[0-9a-f]{64}", one) for one in hashes), str(requirement)
    text = (repo_root / "envs" / name).read_text()
    assert not re.search(r"(?m)^-|://|^[^#\n]*\s--(?!hash=sha256:)", text)


@pytest.mark.parametrize("python", PYTHONS)
def test_locks_differ_in_torch_and_its_cuda_libraries_alone(lines, python):
    cpu, cuda = (versions(lines[name], python) for name in LOCKS)
    assert not [package for package in cpu if CUDA.match(package)]
    assert cpu == {p: v if p != "torch" else [f"{v[0]}+cpu"] for p, v in cuda.items() if not CUDA.match(p)}


def test_locks_start_at_the_oldest_python(repo_root, pyproject):
    spec = importlib.util.spec_from_file_location("lock_versions", repo_root / ".ci/lock_versions.py")
    maker = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = maker  # Where dataclasses look their module up.
    spec.loader.exec_module(maker)
    assert pyproject["project"]["requires-python"] == f">={maker.OLDEST_PYTHON}"
    assert {lock.name for lock in maker.LOCKS} == {path.name for path in (repo_root / "envs").glob("lock*.txt")}
    for lock in maker.LOCKS:
        assert (repo_root / "envs" / lock.name).read_text().startswith(maker.header(lock))
