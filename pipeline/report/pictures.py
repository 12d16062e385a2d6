"""Pictures inside a page: as data URIs, none larger than a limit."""

from __future__ import annotations

import io
from base64 import b64encode
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from pipeline.base.errors import InputError

QUALITIES = (92, 80, 65)
"""Of WebP, tried in turn when a picture is too large without loss; then its sides shrink by `SHRINK` at a time."""

SHRINK = 0.75


@dataclass(frozen=True)
class Pictures:
    """Encodes pictures so that each takes at most `limit_bytes` before base64 adds a third."""

    limit_bytes: int

    def figure(self, path: Path, caption: str = "") -> str:
        """HTML of a picture file, with a caption."""
        text = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
        alt = escape(caption or path.stem.replace("_", " "), quote=True)
        # On a phone a plot keeps a legible width and scrolls by itself.
        image = f'<img src="{self.file_uri(path)}" alt="{alt}">'
        region = f'<div class="scroll plot" tabindex="0" role="region" aria-label="{alt}">{image}</div>'
        return f"<figure>{region}{text}</figure>"

    def file_uri(self, path: Path) -> str:
        """Data URI of a PNG file: its own bytes if they are few enough."""
        try:
            content = path.read_bytes()
            if len(content) <= self.limit_bytes:
                return _uri("png", content)
            with Image.open(path) as image:
                return self.image_uri(np.asarray(image.convert("RGB")))
        except OSError as error:
            raise InputError(f"{path}: expected a PNG picture, found: {error}") from error

    def image_uri(self, image: UInt8[np.ndarray, "h w 3"]) -> str:
        """Data URI of 8-bit sRGB: without loss if that is small enough."""
        picture = Image.fromarray(image)
        content = _webp(picture, lossless=True)
        for quality in QUALITIES:
            if len(content) <= self.limit_bytes:
                break
            content = _webp(picture, quality=quality)
        while len(content) > self.limit_bytes and max(picture.size) > 1:
            picture = picture.resize([max(1, round(SHRINK * side)) for side in picture.size], Image.Resampling.LANCZOS)
            content = _webp(picture, quality=QUALITIES[-1])
        return _uri("webp", content)


def _webp(picture: Image.Image, **options) -> bytes:
    file = io.BytesIO()
    picture.save(file, "WEBP", method=4, **options)
    return file.getvalue()


def _uri(kind: str, content: bytes) -> str:
    return f"data:image/{kind};base64,{b64encode(content).decode()}"
