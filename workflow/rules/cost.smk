from pipeline.config.budget_errors import RETRAINED_STAGES
from pipeline.config.measure_cost import COSTED_STAGES
from pipeline.config.stage_settings import changed_settings


# Takes all cores: whatever ran beside it would be measured, too. Nothing needs it; ask for its table by name.
rule measure_cost:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        index=expand(
            "results/{{subject}}/index/{file}",
            file=[
                "cameras.parquet",
                "frames.parquet",
                "images.parquet",
                "keypoints_2d.parquet",
                "lights.parquet",
                "calibration_cameras.json",
                "calibration_lights.json",
            ],
        ),
        rig="results/{subject}/calibration/rig.json",
        cameras="results/{subject}/calibration/cameras.json",
        lights="results/{subject}/calibration/lights.parquet",
        patterns="results/{subject}/patterns.parquet",
        frames="results/{subject}/frames.parquet",
        atlas="results/{subject}/atlas.safetensors",
        tracking="results/{subject}/tracking/0000.safetensors",
        effects="results/{subject}/effects.json",
        color="results/{subject}/calibration/color.json",
        train=lambda wildcards: job(wildcards).shards("shards/train"),
        validation=lambda wildcards: job(wildcards).shards("shards/validation"),
        avatar=lambda wildcards: job(wildcards).avatars("avatar.safetensors")[0],
    output:
        table="results/{subject}/accuracy_cost.csv",
        picture=report(
            "results/{subject}/accuracy_cost.png",
            caption="../report/accuracy_cost.rst",
            category="Costs",
            subcategory="{subject}",
        ),
    log:
        "results/{subject}/logs/measure_cost.log",
    benchmark:
        "results/{subject}/benchmarks/measure_cost.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: all_cores
    resources:
        mem_mb=memory_for("measure_cost"),
        runtime=minutes_for("measure_cost"),
    params:
        code=lambda wildcards: [code_for(stage)(wildcards) for stage in ("measure_cost", *COSTED_STAGES)],
        capture=capture_folder,
        arguments=arguments_for(
            "measure_cost",
            variant=lambda wildcards: job(wildcards).variants[0],
            stage_settings=lambda wildcards: changed_settings(job(wildcards).settings, COSTED_STAGES),
        ),
        settings=settings_for("measure_cost"),
    message:
        "{wildcards.subject}: measuring what accuracy costs in time"
    shell:
        "python -m pipeline.stages.measure_cost --capture {params.capture:q} {params.arguments:q} "
        "--threads {threads} "
        "{params.settings:q} > {log:q} 2>&1"


# Of synthesised captures, whose truth is known. Nothing needs it; ask for its folder by name.
rule budget_errors:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        frames="results/{subject}/frames.parquet",
        color="results/{subject}/calibration/color.json",
        lights="results/{subject}/calibration/lights.parquet",
        cameras="results/{subject}/calibration/cameras.json",
        tracking=each_chunk("tracking/{chunk}.safetensors"),
        # All that its stages read is there once an avatar is.
        metrics="results/{subject}/metrics.csv",
    output:
        directory("results/{subject}/error_budget"),
    log:
        "results/{subject}/logs/budget_errors.log",
    benchmark:
        "results/{subject}/benchmarks/budget_errors.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: all_cores
    resources:
        mem_mb=memory_for("budget_errors"),
        runtime=minutes_for("budget_errors"),
    params:
        code=lambda wildcards: [code_for(stage)(wildcards) for stage in ("budget_errors", *RETRAINED_STAGES)],
        capture=capture_folder,
        arguments=arguments_for(
            "budget_errors",
            variant=lambda wildcards: job(wildcards).variants[0],
            stage_settings=lambda wildcards: changed_settings(job(wildcards).settings, RETRAINED_STAGES),
        ),
        settings=settings_for("budget_errors"),
    message:
        "{wildcards.subject}: measuring how many decibels each input costs"
    shell:
        "python -m pipeline.stages.budget_errors --capture {params.capture:q} {params.arguments:q} "
        "--threads {threads} "
        "{params.settings:q} > {log:q} 2>&1"


# After a run with --config budget_minutes=...; give the same budget again, or what it chose is undone.
rule check_budget:
    input:
        metrics="results/{subject}/metrics.csv",
    output:
        "results/{subject}/budget.csv",
    log:
        "results/{subject}/logs/check_budget.log",
    benchmark:
        "results/{subject}/benchmarks/check_budget.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("check_budget")
    resources:
        mem_mb=memory_for("check_budget"),
        runtime=minutes_for("check_budget"),
    params:
        code=code_for("check_budget"),
        arguments=arguments_for(
            "check_budget",
            estimate=lambda wildcards: estimate_json(project, wildcards.subject),
        ),
        settings=settings_for("check_budget"),
    message:
        "{wildcards.subject}: comparing what was estimated of the budget with what was achieved"
    shell:
        "python -m pipeline.stages.check_budget {params.arguments:q} {params.settings:q} > {log:q} 2>&1"
