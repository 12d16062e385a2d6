"""Films read back to what was written, up to the codec's loss."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.capture.video import write_video

CODEC_LOSS = 8
"""Of 255, on flat colours: quantisation and the colour space of films, without chroma edges."""


def test_film_holds_the_pictures_in_order_and_colour(tmp_path) -> None:
    colors = [(200, 40, 30), (30, 180, 60), (20, 60, 190), (128, 128, 128)]
    write_video(tmp_path / "film.mp4", (np.full((47, 63, 3), color, np.uint8) for color in colors), 12.0)
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == 12
    for color in colors:
        read, image = film.read()
        assert read
        assert image.shape == (48, 64, 3)  # odd sides are made even
        np.testing.assert_allclose(image[..., ::-1].mean((0, 1)), color, atol=CODEC_LOSS)
    assert not film.read()[0]
