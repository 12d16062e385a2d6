"""Others' lights, head, panoramas and figure, beside sums by definition: writes a page and its picture.

    python -m benchmarks.bench_real_data --data ../shared/data --page docs/real_data.md

The data stay outside of the repository.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from scipy.spatial.transform import Rotation

from benchmarks.gltf_by_definition import Glb, posed_both_ways
from benchmarks.marked_page import paragraphs
from benchmarks.real_data import (
    HEAD_M,
    HEAD_TEXELS,
    even_deviation,
    fit_sphere,
    irradiance_both_ways,
    lobe_errors,
    matte_errors,
    nearest_distances,
    unwrapped_head,
)
from docs.generate.markdown import table
from pipeline.config.plan_effects import PlanEffects
from pipeline.datasets.openillumination_tables import read_lights
from pipeline.effects.light_evidence import texel_points
from pipeline.effects.scene_evidence import near_field_evidence
from pipeline.figures.style import picture
from pipeline.geometry.texels import Atlas
from pipeline.lighting.environment import read_environment
from pipeline.lighting.irradiance import trace_irradiance
from pipeline.lighting.light_scene import Lights
from pipeline.lighting.visibility import Occluders
from pipeline.stages.plan_effects import decide
from pipeline.stages.unwrap_atlas import measure_atlas

LIGHTS, HEAD = "lights_openillumination", "head_leeperrysmith/LeePerrySmith.glb"
PANORAMAS, FIGURE = "hdr_polyhaven", "rigged_cesiumman/CesiumMan.glb"

DISTANCES = (1, 2, 4, 8)
"""Times as far away as they are that lights are put."""

CHECKED_TEXELS, NORMALS, SIGMAS = 100, 30, (0.025, 0.06, 0.25)

HEADING = """\
Data of others that are no captures: what the pipeline computes from each, beside the same by definition, without its
trees, tables and shortcuts. The data are not part of the repository.
"""

STAGE = """\
Of OpenIllumination (oppo-us-research/OpenIlluminationCapture, MIT licence), as its importer reads them. They lie on a
sphere of radius {radius:.4f} about ({x:.3f}, {y:.3f}, {z:.3f}), to {rms:.0e} rms: directions were calibrated, and the
radius was set. How far each light really is, the file does not say. The next light is {least:.3f} to {most:.3f} away.
With the radius counted as a metre, the scanned head below, {head:g} m high with its shoulders, stands in the middle:
"""

SCAN = """\
Lee Perry-Smith's scan (CC BY 3.0), {faces:,} triangles, on a map of {size} x {size} texels, laid out by its own texture
coordinates and by xatlas:
"""

SEEN = """\
Under all {lights} lights, {texels} random texels receive {mean:.1f} % of the light that is sent to them (normalised
irradiance). By our tracer and by a loop over all triangles in float64, without a tree, they differ by {worst:.0e} at
most; a single ray answered otherwise would show as {one:.0e} or so. Our rays start {lift:.1f} micrometres above the
surface: of rays that start on it, {off} of {rays:,} end otherwise.
"""

SKY = """\
Of Poly Haven (CC0), 1024 x 512 pixels, beside the sum over all pixels for {normals} random directions: relative rms
errors of light on matte surfaces from harmonics up to degree 8, which leave out what a clamped cosine has above, and of
gloss of three roughnesses (radians) looked up in prefiltered panoramas.
"""

RIG = """\
CesiumMan (CC BY 4.0, 2017 Cesium) in all {keys} keys of its clip, rotations alone: vertices by our skinning and by the
formulas of glTF's specification, straight from the file's numbers, differ by {worst:.0e} m at most. {short} of
{vertices:,} vertices have weights that sum to less than 1 ({least:.2f} at least); both divide by the sum. Otherwise
such vertices would be drawn towards the origin.
"""


def stage_part(lights: np.ndarray, head: Atlas) -> list[str]:
    """The lights, and what `near_field` says of them around a head."""
    sphere, next_one, settings = fit_sphere(lights), nearest_distances(lights), PlanEffects()
    points, _ = texel_points(head, head.rest_vertices, np.arange(0, head.texel_count, 10))
    rows = []
    for times in DISTANCES:
        places = times * (lights - sphere.center)
        evidence = near_field_evidence(
            head, [(head.rest_vertices, places)], settings.rays, np.random.default_rng(times)
        )
        said = "on" if decide("auto", evidence, settings.near_field_percent)["on"] else "off"
        rows.append((f"{times} m", f"{evidence.value:.1f} %", f"{even_deviation(points, places):.1f} %", said))
    told = STAGE.format(
        radius=sphere.radius, **dict(zip("xyz", sphere.center, strict=True)), rms=np.sqrt((sphere.off**2).mean()),
        least=next_one.min(), most=next_one.max(), head=HEAD_M,
    )  # fmt: skip
    heads = ("lights at", "95 % of the light is within", "every tenth texel, every light", "near_field")
    return [f"## {len(lights)} lights of a stage\n", paragraphs(told), table(heads, rows)]


def head_part(path: Path, head: Atlas, lights: np.ndarray) -> list[str]:
    """The head's maps, and its irradiance in two ways."""
    rows = []
    for name, atlas in (("its own", head), ("new", unwrapped_head(path, "new"))):
        found = measure_atlas(atlas)
        rows.append((
            name, f"{found.texels:,}", f"{100 * found.use:.0f} %", str(found.charts), f"{found.mean_texel_mm:.2f} mm",
            f"{found.scale_spread:.2f}", f"{found.stretch_95:.2f}", f"{100 * found.uncovered:.1f} %",
        ))  # fmt: skip
    some = np.random.default_rng(0).choice(head.texel_count, CHECKED_TEXELS, replace=False)
    traced = irradiance_both_ways(head, some, lights)
    seen = SEEN.format(
        lights=len(lights), texels=len(some), mean=100 * traced.ours.mean(),
        worst=np.abs(traced.ours - traced.lifted).max(), one=1 / len(lights), lift=1e6 * traced.lift,
        off=traced.rays_off, rays=len(some) * len(lights),
    )  # fmt: skip
    heads = ("layout", "texels", "of the map", "charts", "mean texel", "95 % size over 5 %", "95 % stretch",
             "surface in faces without a texel")  # fmt: skip
    return [
        "## A scanned head\n", paragraphs(SCAN.format(faces=len(head.faces), size=HEAD_TEXELS)), table(heads, rows),
        paragraphs(seen), "![The lights from above, and irradiance on the head](pictures/real_data.png)\n",
    ]  # fmt: skip


def sky_part(folder: Path) -> list[str]:
    """Panoramas by harmonics and by prefiltered lobes."""
    turns, rows = Rotation.random(NORMALS // 3, random_state=0).as_matrix(), []
    axes = turns.transpose(0, 2, 1).reshape(-1, 3)
    for path in sorted(folder.glob("*.hdr")):
        environment = read_environment(path)
        errors = [matte_errors(environment, turns), *lobe_errors(environment, axes, SIGMAS)]
        rows.append((f"`{path.stem}`", *(f"{100 * error:.2f} %" for error in errors)))
    heads = ("panorama", "matte", *(f"gloss {sigma:g}" for sigma in SIGMAS))
    return ["## Panoramas\n", paragraphs(SKY.format(normals=NORMALS)), table(heads, rows)]


def rig_part(path: Path) -> list[str]:
    """Posed vertices in two ways."""
    (ours, true), sums = posed_both_ways(path), Glb(path).weights().sum(1)
    told = RIG.format(
        keys=len(ours), worst=np.abs(ours - true).max(), short=int((sums < 0.999).sum()),
        vertices=len(sums), least=sums.min(),
    )  # fmt: skip
    return ["## A rigged figure\n", paragraphs(told)]


def draw(path: Path, head: Atlas, lights: np.ndarray) -> None:
    """Draw the stage from above with the head in it, and irradiance on the head's front."""
    points, normals = texel_points(head, head.rest_vertices, np.arange(head.texel_count))
    lit = Lights(lights, np.ones(len(lights)))
    light = trace_irradiance(Occluders(head.rest_vertices, head.faces), points, normals, lit).values
    notes = [
        f"Left: lights from above, and the head, {HEAD_M:g} m high with its shoulders.",
        "Right: share of the light sent to each texel that arrives (head: Lee Perry-Smith, CC BY 3.0).",
    ]
    with picture(path, (7.4, 3.4), f"A scanned head among {len(lights)} lights", notes) as figure:
        stage, front = figure.add_axes((0.1, 0.12, 0.35, 0.64)), figure.add_axes((0.54, 0.05, 0.36, 0.74))
        stage.scatter(points[::20, 0], points[::20, 2], s=0.2, color="#626a76")
        shown = stage.scatter(lights[:, 0], lights[:, 2], c=lights[:, 1], s=12, cmap="cividis")
        figure.colorbar(shown, ax=stage, label="height, m", shrink=0.9)
        stage.set(aspect="equal", xlabel="x, m", ylabel="z, m")
        facing = np.flatnonzero(normals[:, 2] > 0)
        facing = facing[np.argsort(points[facing, 2])]
        scale = Normalize(0, 0.6)
        front.scatter(points[facing, 0], points[facing, 1], c=light[facing], s=1.5, lw=0, cmap="gray", norm=scale)
        front.set(aspect="equal")
        front.axis("off")
        figure.colorbar(ScalarMappable(scale, "gray"), ax=front, label="irradiance", shrink=0.9)


def main() -> None:
    """Measure, and write page and picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--page", type=Path, default=Path("docs/real_data.md"))
    chosen = parser.parse_args()
    data, page = chosen.data, chosen.page
    lights, head = read_lights(data / LIGHTS), unwrapped_head(data / HEAD)
    centred = lights - fit_sphere(lights).center
    (page.parent / "pictures").mkdir(exist_ok=True)
    draw(page.parent / "pictures" / "real_data.png", head, centred)
    parts = [
        "# Others' lights, head, panoramas and figure\n",
        "<!-- Written by `python -m benchmarks.bench_real_data`: change it there. -->\n", paragraphs(HEADING),
        *stage_part(lights, head), *head_part(data / HEAD, head, centred), *sky_part(data / PANORAMAS),
        *rig_part(data / FIGURE),
    ]  # fmt: skip
    page.write_text("\n".join(parts))
    print("\n".join(parts[-2:]))


if __name__ == "__main__":
    main()
