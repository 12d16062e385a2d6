"""Types and shapes are checked at the first calls of each function in each file of tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from pipeline.base.spread import evenly
from pipeline.geometry.mesh import area_vectors
from tests.support import first_calls


def test_wrong_shapes_are_refused():
    with pytest.raises(TypeCheckError, match="area_vectors"):
        area_vectors(np.zeros((5, 2)), np.zeros((1, 3), int))


@pytest.mark.parametrize("file", ["a file", "the next"])
def test_each_file_has_its_own_first_calls(file):
    first_calls.in_file(Path(file))
    for _ in range(first_calls.CALLS - 1):
        assert evenly("abc", 2) == ["a", "c"]
    with pytest.raises(TypeCheckError):
        evenly("abc", None)
    evenly("abc", 2)
    with pytest.raises(TypeError) as later:
        evenly("abc", None)
    assert not isinstance(later.value, TypeCheckError)
