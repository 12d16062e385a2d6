"""Writing OpenEXR images where the system refuses to."""

from __future__ import annotations

import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.exr import write_exr


@pytest.fixture
def small_files() -> Iterator[None]:
    """No file may grow beyond 4 KiB: to who writes, it is as if the disk were full."""
    before, heard = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, heard)


@pytest.mark.usefixtures("small_files")
def test_refused_image_is_an_error_of_the_system_and_leaves_nothing(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).uniform(size=(64, 64, 3)).astype(np.float32)
    with pytest.raises(OSError, match=r"a\.exr: .*File too large"):
        write_exr(tmp_path / "a.exr", noise)
    assert list(tmp_path.iterdir()) == []
