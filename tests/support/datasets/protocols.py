"""What the documentation promises of each public set's own protocol, and whether scores keep it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.yaml_files import read_yaml

ROOT = Path(__file__).resolve().parents[3]
HEADING = "\n## Each set's own protocol\n"
ALWAYS = {"psnr_db", "ssim", "lpips", "flip"}
"""Metrics of every table."""


@dataclass(frozen=True)
class Protocol:
    """A row of the table in docs/datasets.md.

    Attributes:
        preset: file that the row names; empty if it says that there is none.
        splits: those of `metrics.csv` that are why an image is held out for testing.
        row: the split to compare.
        size: width and height of images, if the row has them.
        metrics: columns to compare.
        ours: True if the row says that the metrics are our choice.
    """

    preset: str
    splits: frozenset[str]
    row: str
    size: tuple[int, int] | None
    metrics: frozenset[str]
    ours: bool

    @property
    def settings(self) -> dict:
        """What the preset sets."""
        return read_yaml(ROOT / self.preset) if self.preset else {}


def documented_protocols() -> dict[str, Protocol]:
    """All rows of the table, by their sets."""
    section = (ROOT / "docs/datasets.md").read_text().partition(HEADING)[2].partition("\n## ")[0]
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("| ")][1:]
    return {cells[0]: _protocol(*cells[1:]) for cells in rows}


def _protocol(preset: str, splits: str, row: str, size: str, metrics: str, *_: str) -> Protocol:
    file, sides = re.search(r"`(set_\w+\.yaml)`", preset), re.search(r"(\d+) x (\d+)", size)
    return Protocol(
        f"config/presets/{file[1]}" if file else "", frozenset(re.findall(r"`(test_\w+)`", splits)),
        row.strip("`"), (int(sides[1]), int(sides[2])) if sides else None,
        frozenset(re.findall(r"`([a-z_]+)`", metrics)), "ours" in metrics,
    )  # fmt: skip


def assert_kept(dataset: str, results: Path, sizes: Mapping[str, tuple[int, int]]) -> None:
    """Scores are of the promised splits, and have the promised columns, of the promised parts of images.

    Args:
        results: folder of metrics.csv.
        sizes: width and height of each camera's images, as they are trained on.
    """
    promised = documented_protocols()[dataset]
    table = pd.read_csv(results / "metrics.csv", keep_default_na=False, na_values=[""])
    scored = table[table.images > 0]
    assert {split for split in scored.split if split.startswith("test_")} == promised.splits
    assert scored.split.eq(promised.row).any()
    assert set(table.protocol) == {dataset if promised.preset else "ours"} and set(table.color_space) == {"sRGB"}
    assert promised.metrics <= ALWAYS | {"psnr_image"} and set(table) >= ALWAYS
    assert ("psnr_image" in table) == ("psnr_image" in promised.metrics)
    assert table.region.str.startswith("psnr: pixels with mask >= 0.5").all()
    assert table.region.str.contains("psnr_image: all pixels of the image").all() == ("psnr_image" in table)
    assert set(table.lpips_net) == {promised.settings.get("evaluate_avatar", {}).get("lpips_net", "alex")}
    # No backbone lies beside the tests: LPIPS is empty, which the table says.
    assert np.isfinite(scored[sorted((promised.metrics | {"psnr_db"}) - {"lpips"})]).all(axis=None)
    if "psnr_image" in table:
        images = pd.read_parquet(results / "metrics_per_image.parquet")
        whole = images.camera.map({name: width * height for name, (width, height) in sizes.items()})
        gain = 10 * np.log10(whole / images.foreground_pixels)
        # Images of a light behind the subject may be black, and exact.
        exact = np.isinf(images.psnr_db)
        assert (exact == np.isinf(images.psnr_image)).all() and not exact.all()
        np.testing.assert_allclose((images.psnr_image - images.psnr_db)[~exact], gain[~exact], atol=1e-6)
