"""Pictures in a page are no larger than allowed, and without loss if they can be."""

from __future__ import annotations

import io
from base64 import b64decode

import numpy as np
import pytest
from PIL import Image

from pipeline.base.errors import InputError
from pipeline.report.pictures import Pictures


def decoded(uri: str) -> tuple[str, bytes, np.ndarray]:
    kind, _, text = uri.partition(";base64,")
    content = b64decode(text)
    return kind, content, np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))


NOISE = np.random.default_rng(0).integers(0, 256, (120, 200, 3)).astype(np.uint8)
FLAT = np.full((120, 200, 3), 90, np.uint8)


@pytest.mark.parametrize("limit", [100_000, 20_000, 4_000, 500])
def test_pictures_keep_to_the_limit(limit):
    kind, content, _ = decoded(Pictures(limit).image_uri(NOISE))
    assert kind == "data:image/webp" and len(content) <= limit


def test_what_fits_is_not_changed(tmp_path):
    np.testing.assert_array_equal(decoded(Pictures(10**6).image_uri(NOISE))[2], NOISE)
    np.testing.assert_array_equal(decoded(Pictures(500).image_uri(FLAT))[2], FLAT)
    Image.fromarray(NOISE).save(tmp_path / "noise.png")
    assert decoded(Pictures(10**6).file_uri(tmp_path / "noise.png"))[1] == (tmp_path / "noise.png").read_bytes()
    assert len(decoded(Pictures(9_000).file_uri(tmp_path / "noise.png"))[1]) <= 9_000


def test_captions_are_escaped(tmp_path):
    Image.fromarray(FLAT).save(tmp_path / "a.png")
    html = Pictures(10**6).figure(tmp_path / "a.png", '<b> & "c"')
    assert "&lt;b&gt; &amp; &quot;c&quot;" in html and "<b>" not in html


def test_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"gone\.png: expected a PNG picture"):
        Pictures(1000).file_uri(tmp_path / "gone.png")
