"""Compiled kernels: what voids the binaries that are kept, and where none can be."""

from __future__ import annotations

import logging
import shutil
import subprocess
import sys

import numba.core.caching
import pytest

from pipeline.base import kernel_cache
from pipeline.base.code_digest import imported_modules


def test_kernel_runs_where_no_folder_can_be_written_to(monkeypatch, caplog) -> None:
    """numba refuses even to define a function that it cannot keep, so that --help broke."""
    monkeypatch.setattr(numba.core.caching.CacheImpl, "_locator_classes", [])
    monkeypatch.setattr(numba.core.caching.CompileResultCacheImpl, "_locator_classes", [], raising=False)

    def twice(number: float) -> float:
        return 2 * number

    with pytest.raises(RuntimeError, match="no locator available"):
        numba.njit(cache=True)(twice)
    with caplog.at_level(logging.WARNING):
        compiled = kernel_cache.kernel()(twice)
    assert compiled(3.0) == 6.0
    assert "NUMBA_CACHE_DIR" in caplog.text


IMPORT_STAGES = """
import importlib, pkgutil
import numba.core.caching as caching
caching.CacheImpl._locator_classes = caching.CompileResultCacheImpl._locator_classes = []
import pipeline.stages
for module in pkgutil.iter_modules(pipeline.stages.__path__, "pipeline.stages."):
    importlib.import_module(module.name)
"""


def test_stages_start_where_no_folder_can_be_written_to(repo_root) -> None:
    """One kernel that is defined in another way than by `kernel_cache` would end all stages that import it."""
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_STAGES], cwd=repo_root, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("NUMBA_CACHE_DIR") == 1


def test_change_of_any_module_that_kernels_import_voids_what_is_kept(repo_root, tmp_path) -> None:
    """numba itself looks at the file of the outermost function alone."""
    package = shutil.copytree(repo_root / "pipeline", tmp_path / "pipeline", ignore=shutil.ignore_patterns("*cache*__"))
    users = [path for path in package.rglob("*.py") if "base.kernel_cache import" in path.read_text()]
    names = [".".join(path.relative_to(tmp_path).with_suffix("").parts) for path in users]
    imported = {module for name in names for module in imported_modules(name, tmp_path)}
    files = [path for module in imported if (path := tmp_path / f"{module.replace('.', '/')}.py").is_file()]
    assert len(files) > len(users)
    digests = [kernel_cache.sources_digest(package)]
    for path in files:
        path.write_text(f"{path.read_text()}NUMBER = 1\n")
        kernel_cache.sources_digest.cache_clear()
        digests.append(kernel_cache.sources_digest(package))
    kernel_cache.sources_digest.cache_clear()
    assert len(set(digests)) == len(files) + 1
