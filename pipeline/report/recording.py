"""Inputs of the avatar: calibration, light patterns, tracking, atlas, and effects."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.files import read_json, read_table
from pipeline.base.spread import evenly
from pipeline.base.verdicts import Verdict
from pipeline.figures.calibration import PARTS, read_verdicts
from pipeline.figures.page import verdict_list, verdict_tiles
from pipeline.report.part import Part
from pipeline.report.results import Results, missing_files
from pipeline.report.tables import Html, folded, html_table, number, paragraph, significant

CALIBRATION_PICTURES = {
    "rig.png": "Do cameras and lights stand where they stand in the room?",
    "corners.png": "Are corners found where they are, and do projections hit them?",
    "coverage.png": "Was the board recorded wherever the lens has to be known?",
    "residuals.png": "Is what is left over random, or has it a pattern?",
    "balls.png": "Is each highlight found on the ball, and where its light predicts it?",
    "charts.png": "Do all cameras show the chart in the same colours, once corrected?",
    "residual_histogram.png": "Is the noise what the fit took it for, with few gross mistakes?",
}
PATTERN_VERDICTS = ("index/verdicts_images.csv", "verdicts_patterns.csv")
"""Verdicts on images and log, below the results of a subject."""

FOLDED_AFTER = 2
"""Pictures that are open from the start."""


def calibration(results: Results) -> Part:
    """Verdicts, and the pictures of review_calibration."""
    files = [results.folder / f"calibration/verdicts_{part}.csv" for part in PARTS]
    verdicts = [verdict for file in files for verdict in read_verdicts(file)]
    html = verdict_tiles(verdicts) + verdict_list(verdicts)
    folder = results.folder / "calibration/review"
    if not folder.is_dir():
        return Part("Calibration", html, "pictures of the calibration", results.make("calibration/review"))
    # A review leaves out what a capture has nothing for, and its own page says why.
    return Part("Calibration", html + _pictures(results, folder, CALIBRATION_PICTURES))


def patterns(results: Results) -> Part:
    """Agreement of log and images, and the timeline of the patterns."""
    sync, frames = read_json(results.folder / "sync.json"), results.table("frames.parquet")
    facts = [
        f"{len(frames)} frames, {int(frames.fully_lit.sum())} of them fully lit, {frames.pattern.nunique()} patterns, "
        f"{number(float(frames.lights_on[~frames.fully_lit].median()), 0)} lights on in the others (median).",
        f"Log and images: {sync['verdict'].replace('_', ' ')}: {sync['why']}.",
    ]
    html = "".join(paragraph(fact) for fact in facts)
    own = [verdict for name in PATTERN_VERDICTS for verdict in _verdicts(results.folder / name)]
    html += verdict_tiles(own) + folded("What needs a look, and all", verdict_list(own)) if own else ""
    missing = missing_files(results.folder, ["sync.png"])
    html += "" if missing else results.pictures.figure(results.folder / "sync.png", "Timeline of light and patterns")
    return Part("Light patterns and sync", html, ", ".join(missing), results.make("sync.png"))


def tracking(results: Results) -> Part:
    """Error per frame, and the template over the images."""
    frames = pd.concat([read_table(path) for path in sorted((results.folder / "tracking").glob("[0-9]*.parquet"))])
    error = frames.rms_px.dropna() if "rms_px" in frames else pd.Series(dtype=float)
    facts = f"{len(frames)} frames tracked."
    if len(error):
        facts += (
            f" Keypoints fit to {number(error.median())} px (RMS, median of frames), {number(error.max())} at worst."
        )
    tables = [*sorted((results.folder / "tracking").glob("verdicts_*.csv")), results.folder / "verdicts_eyes.csv"]
    own = [verdict for table in tables for verdict in _verdicts(table)]
    judged = verdict_tiles(own) + folded("What needs a look, and all", verdict_list(own)) if own else ""
    folder, title = results.folder / "tracking/review", "Tracking"
    if not folder.is_dir():
        return Part(title, paragraph(facts) + judged, "pictures of the tracking", results.make("tracking/review"))
    sheets = evenly(sorted(path.name for path in folder.glob("camera_*.png")), results.settings.most_sheets)
    shown = {
        "errors.png": "Does every frame fit as well as the others?",
        "worst.png": "The frames that fit worst: if the template fits here, it fits everywhere.",
        **{name: f"The template over images of {name.removeprefix('camera_').removesuffix('.png')}" for name in sheets},
    }
    return Part(title, paragraph(facts) + judged + _pictures(results, folder, shown))


def atlas(results: Results) -> Part:
    """Charts and texel sizes, and the light that arrives at texels."""
    shown = {"atlas.png": "Each texel becomes a Gaussian. Left: charts; right: the size of texels on the surface."}
    maps = sorted((results.folder / "irradiance").glob("[0-9]*.png"))[:1]
    if maps:
        shown[f"irradiance/{maps[0].name}"] = "Light that arrives at the texels, with shadows."
    missing = missing_files(results.folder, ["atlas.png"])
    return Part("Atlas", _pictures(results, results.folder, shown), ", ".join(missing), results.make("atlas.png"))


def relit(results: Results) -> Part:
    """Stills of relight_avatar."""
    stills = sorted((results.folder / "relit").glob("*/*/stills/*.png"))
    if not stills:
        return Part("In other light", "", "the avatar under another light", results.make("relit/VARIANT/LIGHT"))
    shown = evenly(stills, results.settings.most_stills)
    figures = (results.pictures.figure(path, f"avatar {path.parts[-4]} under {path.parts[-3]}") for path in shown)
    return Part("In other light", f'<div class="stills">{"".join(figures)}</div>')


def effects(results: Results) -> Part:
    """Plan as a table: what was measured, what decided, and why.

    Keys that a stage adds get a column.
    """
    plan = read_json(results.folder / "effects.json")
    known = ("on", "mode", "evidence", "threshold", "why")
    others = list(dict.fromkeys(key for effect in plan.values() for key in effect if key not in known))
    rows = []
    for name, effect in plan.items():
        state = "on" if effect.get("on") else "off"
        grade = Html(f'<b class="{"good" if state == "on" else "zero"}">{state}</b>')
        reason = Html(f"{escape(name.replace('_', ' '))}<br><small>{escape(_text(effect.get('why')))}</small>")
        measured = (significant(_float(effect.get(key))) for key in ("evidence", "threshold"))
        rows.append([reason, grade, _text(effect.get("mode")), *measured, *(_text(effect.get(key)) for key in others)])
    head = ["effect", "state", "asked for", "measured", "threshold", *(key.replace("_", " ") for key in others)]
    text = paragraph("Only what this capture calls for is simulated: what is off has no job, no channel, no parameter.")
    return Part("Effects", text + html_table("effects", head, rows, "wssnn"))


def _verdicts(path: Path) -> list[Verdict]:
    """Verdicts of a table; none where an earlier version wrote none."""
    return read_verdicts(path) if path.exists() else []


def _pictures(results: Results, folder: Path, captions: dict[str, str]) -> str:
    """The pictures that are there, the first ones open."""
    figures = [
        results.pictures.figure(folder / name, text) for name, text in captions.items() if (folder / name).exists()
    ]
    more = figures[FOLDED_AFTER:]
    rest = folded(f"{len(more)} more pictures", f'<div class="pictures">{"".join(more)}</div>') if more else ""
    return f'<div class="pictures">{"".join(figures[:FOLDED_AFTER])}</div>{rest}'


def _float(value: object) -> float:
    return float(value) if isinstance(value, int | float) else np.nan


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key.replace('_', ' ')} {_text(entry)}" for key, entry in value.items())
    if isinstance(value, float):
        return significant(value)
    return "–" if value is None else str(value)
