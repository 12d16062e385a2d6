"""Near lights on a real face: writes docs/near_lights.md and its picture.

    python -m benchmarks.bench_face_lights --data ../shared/data/face_near_lights

The photographs and their licence (GPL-3) stay outside of the repository: the picture shows numbers alone.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from matplotlib.lines import Line2D

from benchmarks.face_lights import LitFace, Model, face_evidence, read_lit_face, unexplained
from benchmarks.marked_page import paragraphs
from pipeline.config.plan_effects import PlanEffects
from pipeline.figures.style import FAINT, GRADE_COLORS, INK, MUTED, picture
from pipeline.stages.plan_effects import decide

PAGE = Path("docs/near_lights.md")
PICTURE = Path("docs/pictures/near_lights.png")

FALLOFFS, LOBES = np.linspace(0, 4, 41), np.linspace(0, 2.5, 26)
"""Exponents of distance and of the cosine to an LED's axis that are tried."""

STEP = 5
"""Of the head's pixels every fifth counts; the results are those of all to a hundredth of a per cent."""

MODELS: dict[str, tuple[Model, float, float]] = {
    "near: inverse square, lobe": ("near", 2.0, 1.0),
    "distant: as bright as at the middle of the head": ("distant", 2.0, 1.0),
    "near, without the lobe": ("near", 2.0, 0.0),
    "near, without the inverse square": ("near", 0.0, 1.0),
    "distant, as bright as their intensities": ("distant", 0.0, 0.0),
}

CHANNELS = {"red": GRADE_COLORS["failed"], "green": GRADE_COLORS["good"]}
"""Channels that are drawn. Blue is the darkest, and the one whose stored values are the least linear."""

TEXT = """\
A head under seven LEDs 0.25 to 0.4 m away, by one camera: yqueau/near_ps, `Datasets/Human1` (GPL-3; the photographs
are not part of the repository). A matte head with a normal and an albedo per pixel, three numbers against seven
photographs, leaves a share of the photographs' energy unexplained. The smaller, the better the light is described.
Shadows and gloss stay unexplained by all rows. The head is a plane at {distance} m; stored values less ambient light
count as linear.
"""

AFTER = """\
What costs most is to forget how far each LED is and where it faces. That is a matter of calibration: an avatar with
distant lights still has each as bright as it is at the middle of the subject. What then is left between distant and
near lights is what `near_field` decides: here {gain:.0f} % of the red energy that is unexplained. The plan measures
{evidence:.0f} %, its threshold is {threshold:g} %: {state}.

The exponents that explain most are those of physics: distance to the power of {falloff:.1f} (red), cosine to the power
of {lobe:.1f}. A capture's lights have no lobe: where LEDs are as near as here, their intensities are those towards the
subject.
"""


def page(face: LitFace, settings: PlanEffects) -> str:
    """The page as Markdown."""
    shares = {label: 100 * unexplained(face, *model) for label, model in MODELS.items()}
    rows = "\n".join(f"| {label} | {' | '.join(f'{x:.2f} %' for x in found)} |" for label, found in shares.items())
    near, distant = (found[0] for found in list(shares.values())[:2])
    evidence = face_evidence(face, settings.rays, np.random.default_rng(0))
    decided = decide("auto", evidence, settings.near_field_percent)
    after = AFTER.format(
        gain=100 * (1 - near / distant), evidence=evidence.value, threshold=settings.near_field_percent,
        state="on" if decided["on"] else "off", falloff=FALLOFFS[scan_falloffs(face)[:, 0].argmin()],
        lobe=LOBES[scan_lobes(face)[:, 0].argmin()],
    )  # fmt: skip
    return "\n".join([
        "# Near lights on a face\n",
        "<!-- Written by `python -m benchmarks.bench_face_lights`: change it there. -->\n",
        paragraphs(TEXT.format(distance=np.round(face.points[0, 2], 2))),
        f"| energy unexplained, lights | red | green | blue |\n|---|---|---|---|\n{rows}\n",
        paragraphs(after),
        "![Unexplained energy by the exponents of distance and of the lobe](pictures/near_lights.png)",
    ]) + "\n"  # fmt: skip


def scan_falloffs(face: LitFace) -> Float64[np.ndarray, "exponents 3"]:
    """Shares unexplained for each of `FALLOFFS`."""
    return np.stack([unexplained(face, "near", falloff=float(exponent)) for exponent in FALLOFFS])


def scan_lobes(face: LitFace) -> Float64[np.ndarray, "exponents 3"]:
    """Shares unexplained for each of `LOBES`."""
    return np.stack([unexplained(face, "near", lobe=float(exponent)) for exponent in LOBES])


def draw(face: LitFace, path: Path) -> None:
    """Unexplained energy over both exponents, in red and green."""
    panels = [
        ("exponent of distance", FALLOFFS, scan_falloffs(face), 2.0),
        ("exponent of the cosine to the LED's axis", LOBES, scan_lobes(face), 1.0),
    ]
    distant = 100 * unexplained(face, "distant")
    legend = [Line2D([], [], color=color, label=f"{name}, near lights") for name, color in CHANNELS.items()]
    legend.append(Line2D([], [], color=MUTED, ls="--", label="distant, as bright as at the middle of the head"))
    notes = ["Share of the photographs' energy that a matte head leaves unexplained, in per cent.",
             "Grey lines: inverse square, and a Lambertian emitter."]  # fmt: skip
    with picture(path, (8.4, 2.9), "A real face under seven near LEDs", notes, legend) as figure:
        for k, (label, exponents, shares, physical) in enumerate(panels):
            axes = figure.add_axes((0.06 + 0.49 * k, 0.13, 0.42, 0.56))
            axes.axvline(physical, color=FAINT, lw=3)
            for c, color in enumerate(CHANNELS.values()):
                axes.plot(exponents, 100 * shares[:, c], color=color)
                axes.axhline(distant[c], color=color, ls="--", lw=0.8)
            axes.set(xlabel=label, ylim=(0, 4), xlim=(exponents[0], exponents[-1]))
            axes.tick_params(colors=INK)


def main() -> None:
    """Measure, and write page and picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data/face_near_lights"))
    face = read_lit_face(parser.parse_args().data, STEP)
    draw(face, PICTURE)
    PAGE.write_text(page(face, PlanEffects()))


if __name__ == "__main__":
    main()
