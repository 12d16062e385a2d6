# From a light-stage capture to a table of metrics. Every rule runs one module of `pipeline`; see README.md.
from snakemake.utils import min_version

min_version("9.0")


configfile: "config/config.yaml"


report: "workflow/report/workflow.rst"


wildcard_constraints:
    subject="[A-Za-z0-9_][A-Za-z0-9_-]*",
    variant="[A-Za-z0-9_][A-Za-z0-9_-]*",
    chunk=r"\d{4}",
    share=r"\d{4}",
    light="[A-Za-z0-9_][A-Za-z0-9_-]*",
    layout="colmap|nerfstudio|goliath",


# Validates the configuration of all subjects, and the subjects named in the targets.
include: "workflow/rules/common.smk"
# The stages, in data order.
include: "workflow/rules/capture.smk"
include: "workflow/rules/calibration.smk"
include: "workflow/rules/geometry.smk"
include: "workflow/rules/light.smk"
include: "workflow/rules/head.smk"
include: "workflow/rules/avatar.smk"
include: "workflow/rules/results.smk"
include: "workflow/rules/relight.smk"
include: "workflow/rules/cost.smk"
include: "workflow/rules/report.smk"


rule all:
    default_target: True
    input:
        expand(
            "results/{subject}/{result}",
            subject=subject_names(project),
            result=["metrics.csv", "calibration/review", "tracking/review"],
        ),
