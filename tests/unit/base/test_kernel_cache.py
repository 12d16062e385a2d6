"""Kernels where compiled binaries cannot be kept."""

from __future__ import annotations

import logging

import numba.core.caching
import pytest

from pipeline.base import kernel_cache


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
