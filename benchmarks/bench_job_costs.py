"""Fit what the jobs of each stage take, in seconds and megabytes, to finished runs of captures of several sizes.

    python -m benchmarks.bench_job_costs --results results/{subjectA,subjectB,walker,WIDE,LONG,SHORT,HEAD,tiny} \
        --measured results/scaling/shared_images.csv results/scaling/scored_images.csv

Logs say how long each job used a processor, and Snakemake's benchmarks the largest resident set that was sampled. The
terms are those that the predicted exponents of `benchmarks.scaling_cases` speak of; coefficients are not negative and
have the least relative error (`benchmarks.scaling_projection.fit_terms`). Writes config/curves/job_costs.csv, from
which `pipeline.workflow.job_requests` takes what jobs ask for, and budgets take how long a run will be. A term needs
runs that differ in its sizes, on one machine. Four were made for it: WIDE, LONG and SHORT are subjectA with images of
480 x 640 pixels and 400 steps, with 96 frames and 400 steps, and with 100 steps on texels of twice the side
(`unwrap_atlas.texel_pixels: 1.2`); HEAD is subjectB with 16 frames, 4 of them of segment b, of 96 x 114 pixels and 100
steps. Irradiance of subjectA, WIDE and LONG was traced for `train_avatar.shading: transfer`. Other benchmarks measured
some jobs at sizes that no run has, as far as the papers'. Rows of stages that none of all these ran stay as they are.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from benchmarks.scaling_projection import fit_terms, product
from pipeline.base.files import read_json, read_table, write_table
from pipeline.base.finished_jobs import finished_jobs
from pipeline.budget.job_costs import TABLE
from pipeline.budget.job_size import KEPT_BYTES, JobSize
from pipeline.geometry.texels import read_atlas

ONCE = ()
IMAGES, ALL_PIXELS = ("frames", "cameras"), ("frames", "cameras", "pixels")
STILLS = ("cameras", "pixels")
AT_ONCE = ("threads", "pixels")

SECONDS = {
    "synthesize_capture": [ONCE, ("cameras", "lights"), ALL_PIXELS],
    "index_capture": [ONCE, IMAGES, ALL_PIXELS],
    "calibrate_cameras": [ONCE, ("cameras",), STILLS],
    "calibrate_color": [ONCE, ("cameras",), STILLS],
    "calibrate_lights": [ONCE, ("cameras", "lights"), ("cameras", "lights", "pixels")],
    "review_calibration": [ONCE, ("cameras",), STILLS],
    "book_patterns": [ONCE, IMAGES, ALL_PIXELS],
    "unwrap_atlas": [ONCE, ("texels",)],
    "track_mesh": [ONCE, ("frames",), IMAGES],
    "review_tracking": [ONCE, ("frames",), IMAGES, ALL_PIXELS],
    "plan_effects": [ONCE, ("texels",), ("frames",)],
    "fit_eyes": [ONCE, ("frames",)],
    "trace_irradiance": [ONCE, ("frames",), ("frames", "texels"), ("frames", "texels", "lights")],
    "bake_textures": [ONCE, IMAGES, ("frames", "cameras", "texels")],
    "pack_shards": [ONCE, IMAGES, ALL_PIXELS],
    "train_avatar": [
        ONCE, ("frames", "texels"), ("steps", "texels"), ("steps", "step_pixels"), ("steps", "head_texels"),
    ],
    "evaluate_avatar": [
        ONCE, ("avatars", *IMAGES), ("avatars", *ALL_PIXELS), ("avatars", "frames", "texels"),
        ("avatars", "frames", "head_texels"),
    ],
    "relight_avatar": [ONCE, ("frames",), ("frames", "texels"), ("frames", "pixels")],
    "export_viewer": [ONCE, ("frames",), ("frames", "texels")],
    "export_avatar": [ONCE, ("frames",), ("texels",)],
    "write_report": [ONCE, IMAGES],
}  # fmt: skip
"""Stage -> products of sizes that the CPU seconds of a job are a sum of."""

MEGABYTES = {
    "synthesize_capture": [ONCE, AT_ONCE],
    "index_capture": [ONCE, AT_ONCE, IMAGES, ("listed",)],
    "calibrate_cameras": [ONCE, AT_ONCE, ("cameras",)],
    "calibrate_color": [ONCE, AT_ONCE, ("cameras",)],
    "calibrate_lights": [ONCE, AT_ONCE, ("cameras", "lights")],
    "review_calibration": [ONCE, AT_ONCE, STILLS],
    "book_patterns": [ONCE, ("pixels",), IMAGES],
    "unwrap_atlas": [ONCE, ("texels",)],
    "track_mesh": [ONCE, IMAGES, ALL_PIXELS],
    "review_tracking": [ONCE, AT_ONCE, IMAGES],
    "plan_effects": [ONCE, ("texels",), STILLS, ("frames",)],
    "fit_eyes": [ONCE, ("frames",)],
    "trace_irradiance": [ONCE, ("threads", "texels"), ("frames",)],
    "bake_textures": [ONCE, ("texels",), ("frames", "texels")],
    "pack_shards": [ONCE, ("pixels",), IMAGES],
    "train_avatar": [
        ONCE, ("processes",), ("processes", "texels"), ("processes", "step_pixels"),
    ],
    "evaluate_avatar": [ONCE, ("texels",), ("pixels",), ("frames", "texels"), ("listed",)],
    "relight_avatar": [ONCE, ("texels",), ("pixels",), ("frames",)],
    "export_viewer": [ONCE, ("texels",), ("frames",), ("frames", "texels")],
    "export_avatar": [ONCE, ("texels",), ("frames",)],
    "write_report": [ONCE, IMAGES],
}  # fmt: skip
"""Stage -> products of sizes that the memory of a job is a sum of."""

KNOWN_MB = {
    "train_avatar": {("kept_texels",): 1e-6 * KEPT_BYTES},
}
"""Memory that is not fitted, of frames that training keeps: in the runs fitted, subjects with more frames have more
texels, too."""

THREADS, PROCESSES = 2, 2
"""Of the runs: `snakemake --cores 2`, and the training processes that it leads to on a CPU."""

DECODE_THREADS = 4
"""Of index_capture, a setting."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--results", type=Path, nargs="*", default=[], help="folders results/SUBJECT of finished runs")
    parser.add_argument("--measured", type=Path, nargs="*", default=[], help="tables of jobs that benchmarks wrote")
    parser.add_argument("--stages", nargs="*", default=list(SECONDS), help="whose rows are written anew; all")
    parser.add_argument("--out", type=Path, default=TABLE, help="table to write")
    options = parser.parse_args()
    jobs = [row for results in options.results for row in jobs_of(results)]
    jobs += [{"head_texels": 0} | row for path in options.measured for row in pd.read_csv(path).to_dict("records")]
    table = cost_table(pd.DataFrame([row for row in jobs if row["stage"] in options.stages]))
    if options.out.exists():
        table = with_others(table, pd.read_csv(options.out, dtype=str, keep_default_na=False))
    write_table(options.out, table)
    print(table.to_string(index=False))


def with_others(table: pd.DataFrame, before: pd.DataFrame) -> pd.DataFrame:
    """A table of some stages with what an earlier one says of all others, in the order of the stages."""
    rows = pd.concat([before[~before.stage.isin(table.stage)], table])
    costs, stages = ["seconds", "mb"], list(SECONDS)
    order = [(costs.index(row.cost), stages.index(row.stage)) for row in rows.itertuples()]
    return rows.iloc[sorted(range(len(rows)), key=order.__getitem__)].reset_index(drop=True)


def jobs_of(results: Path) -> list[dict]:
    """Jobs of a run: stage, sizes, seconds and mb."""
    rows = []
    for job in finished_jobs(results / "benchmarks"):
        if job.stage in SECONDS and not math.isnan(job.cpu_s + job.peak_mb):
            chunk = next((word for word in job.words if word.isdigit()), None)
            size = measured_size(results, job.stage, chunk)
            sizes = {**asdict(size), "kept_texels": size.kept_texels}
            rows.append({"stage": job.stage, **sizes, "seconds": job.cpu_s, "mb": job.peak_mb})
    return rows


def measured_size(results: Path, stage: str, chunk: str | None) -> JobSize:
    """Sizes of a job that has run, by what it and others wrote."""
    cameras, lights = (read_table(results / f"index/{name}.parquet") for name in ("cameras", "lights"))
    frames = read_table(results / ("index/frames.parquet" if chunk is None else f"tracking/{chunk}.parquet"))
    trained = [read_json(path)["settings"] for path in sorted(results.glob("avatars/*/config.json"))]
    pixels = round(float((cameras.width * cameras.height).mean()))
    images = max(one["cameras_per_step"] * one["frames_per_step"] for one in trained)
    listed = len(cameras) * frames.frame.nunique() if chunk is None else 0
    texels = read_atlas(results / "atlas.safetensors").texel_count
    head = read_json(results / "index/capture.json")["kind"] == "head"
    return JobSize(
        cameras=len(cameras), lights=len(lights), frames=frames.frame.nunique(), pixels=pixels,
        texels=texels, head_texels=texels if head else 0, steps=max(one["steps"] for one in trained),
        step_pixels=images * pixels, avatars=len(trained), processes=PROCESSES,
        threads=DECODE_THREADS if stage == "index_capture" else THREADS, listed=listed,
    )  # fmt: skip


def cost_table(jobs: pd.DataFrame) -> pd.DataFrame:
    """A row per stage, cost and term that grows: its coefficient, the runs fitted, and how far off they are."""
    rows = []
    for cost, stages in (("seconds", SECONDS), ("mb", MEGABYTES)):
        for stage, terms in stages.items():
            own = jobs[jobs.stage == stage]
            if not own.empty:
                known = KNOWN_MB.get(stage, {}) if cost == "mb" else {}
                rows += [{"stage": stage, "cost": cost, **row} for row in fitted_terms(own, cost, terms, known)]
    return pd.DataFrame(rows)


def fitted_terms(
    jobs: pd.DataFrame, cost: str, terms: list[tuple[str, ...]], known: dict[tuple[str, ...], float]
) -> list[dict]:  # fmt: skip
    """Rows of a stage's terms, those that are known among them."""
    sizes = jobs.to_dict("records")
    held = [sum(factor * product(row, names) for names, factor in known.items()) for row in sizes]
    fit = fit_terms(jobs.assign(**{cost: jobs[cost] - held}), cost, terms)
    worst = max(row[cost] / (fit.cost(row) + more) for row, more in zip(sizes, held, strict=True))
    coefficients = {**dict(zip(terms, fit.coefficients.tolist(), strict=True)), **known}
    fitted = {"jobs": len(jobs), "worst": math.ceil(1e3 * worst) / 1e3}
    return [
        {"sizes": " ".join(names), "coefficient": f"{factor:.4g}", **fitted}
        for names, factor in coefficients.items()
        if factor > 0
    ]  # fmt: skip


if __name__ == "__main__":
    main()
