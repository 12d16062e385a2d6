"""Tables of docs/irradiance.md from what `benchmarks.bench_irradiance` told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def throughput_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Table of the ratios of speeds, and what a frame is made of."""
    lines = ["| speed of | over that of | for | ratio | millions of rays a second |", "|---|---|---|---|---|"]
    names = {
        "end to end / raw embreex": ("whole maps", "embreex alone, rays made beforehand"),
        "packets / embreex": ("packets of eight rays", "embreex, ray after ray"),
        "coherent packets / embreex": ("packets, their rays followed together", "embreex, ray after ray"),
        "not robust / embreex": ("trees that may leak between faces", "embreex, ray after ray"),
        "trimesh intersects_any loop / ours": ("our maps", "a loop over trimesh's `intersects_any`"),
    }
    for row in rows:
        name, _, job = str(row["result"]).rpartition(", ")
        if name in names:
            speeds = [f"{value:.2f}" for key, value in reversed(row.items()) if str(key).endswith("_Mray_s")]
            cells = [*names[name], job, f"{row['value']:.2f}", " against ".join(speeds)]
            lines.append("| " + " | ".join(cells) + " |")
    parts = next(row for row in rows if row["result"] == "parts of a frame, one thread")
    tree, texels, whole, rays = (f"{parts[f'{part}_ms']:.0f} ms" for part in ("tree", "texels", "map", "rays alone"))
    made_of = f"Embree's tree {tree}, points and normals of the texels {texels}, the map {whole}, of which rays {rays}"
    return [*lines, "", f"A frame on one thread: {made_of}."]


def bits_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Table of visibility bits beside rays; what the cost model chose is bold."""
    lines = ["| lights lit of 96 | rays per texel | patterns of a pose | by rays, ms | by bits, ms |", "|---" * 5 + "|"]
    for row in rows:
        if row["result"] == "visibility bits or rays":
            times = {way: f"{row[f'{way}_ms']:.1f}" for way in ("traced", "bits")}
            times[str(row["chosen"])] = f"**{times[str(row['chosen'])]}**"
            samples = "all" if row["samples"] == "full" else row["samples"]
            cells = [row["lit"], samples, row["patterns"], times["traced"], times["bits"]]
            lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines
