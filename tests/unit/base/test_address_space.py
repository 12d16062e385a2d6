"""A stage in too small an address space does not start, and says so."""

from __future__ import annotations

import resource

import pytest

from pipeline.base.address_space import LEAST_BYTES, require_address_space
from pipeline.base.errors import InputError

TAKEN = 3 << 30


@pytest.fixture
def limited(monkeypatch):
    """A function: sets the limit, in bytes above those that are taken."""
    taken = type("Memory", (), {"memory_info": lambda self: type("Info", (), {"vms": TAKEN})})
    monkeypatch.setattr("pipeline.base.address_space.psutil.Process", taken)
    return lambda left: monkeypatch.setattr(resource, "getrlimit", lambda kind: (TAKEN + left, resource.RLIM_INFINITY))


@pytest.mark.parametrize(("left", "found"), [(8 << 20, 8), (LEAST_BYTES - 1, 1023), (-(1 << 20), 0)])
def test_too_little_is_refused_with_what_to_do(limited, left, found):
    limited(left)
    with pytest.raises(
        InputError, match=rf"at least 1024 MiB .* found {found} MiB: .*3072 are taken; raise it \(ulimit"
    ):
        require_address_space()


def test_enough_is_taken_and_so_is_no_limit(limited, monkeypatch):
    limited(LEAST_BYTES)
    require_address_space()
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    require_address_space()
