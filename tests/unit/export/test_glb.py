"""Where numbers lie in a binary glTF file."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.export.glb import GlbFile


@pytest.mark.parametrize("length", [1, 2, 3, 4, 5])
def test_numbers_start_at_a_multiple_of_their_size_behind_a_picture_of_any_length(length: int) -> None:
    """glTF 2.0, 3.6.2.4: offsets of accessors are multiples of the size of a component, 4 bytes here."""
    file = GlbFile()
    file.add_view(b"x" * length)
    view = file.document.accessors[file.add_vertices(np.ones((2, 3)))].bufferView
    assert file.document.bufferViews[view].byteOffset % 4 == 0
    assert [each.byteLength for each in file.document.bufferViews] == [length, 24]
