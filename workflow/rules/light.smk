# A checkpoint: an effect that is off has no job.
checkpoint plan_effects:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        atlas="results/{subject}/atlas.safetensors",
        tracking=each_chunk("tracking/{chunk}.safetensors"),
        images="results/{subject}/index/images.parquet",
        gaze="results/{subject}/index/gaze.parquet",
        estimated=estimated_gaze,
        patterns="results/{subject}/patterns.parquet",
        frames="results/{subject}/frames.parquet",
        lights="results/{subject}/calibration/lights.parquet",
        cameras="results/{subject}/calibration/cameras.json",
        color="results/{subject}/calibration/color.json",
    output:
        effects="results/{subject}/effects.json",
    log:
        "results/{subject}/logs/plan_effects.log",
    benchmark:
        "results/{subject}/benchmarks/plan_effects.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("plan_effects")
    resources:
        mem_mb=memory_for("plan_effects"),
        runtime=minutes_for("plan_effects"),
    params:
        code=code_for("plan_effects"),
        capture=capture_folder,
        named=named,
        arguments=arguments_with_input(
            "plan_effects",
            {"tracking": each_chunk("tracking/{chunk}.safetensors")},
            gaze=lambda input: input.estimated,
        ),
        settings=settings_for("plan_effects"),
    message:
        "{wildcards.subject}: measuring which effects this capture calls for"
    shell:
        "python -m pipeline.stages.plan_effects --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"


rule trace_irradiance:
    input:
        index=ancient("results/{subject}/index/capture.json"),
        atlas="results/{subject}/atlas.safetensors",
        tracking="results/{subject}/tracking/{chunk}.safetensors",
        lights="results/{subject}/calibration/lights.parquet",
        patterns="results/{subject}/patterns.parquet",
        frames="results/{subject}/frames.parquet",
    output:
        irradiance=directory("results/{subject}/irradiance/{chunk}"),
        summary="results/{subject}/irradiance/{chunk}.parquet",
        picture="results/{subject}/irradiance/{chunk}.png",
    log:
        "results/{subject}/logs/trace_irradiance.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/trace_irradiance.{chunk}.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("trace_irradiance")
    resources:
        mem_mb=memory_for("trace_irradiance"),
        runtime=minutes_for("trace_irradiance"),
    params:
        code=code_for("trace_irradiance"),
        # Visibility bits, if they are kept, are found again by their content: no output, and never out of date.
        arguments=arguments_for("trace_irradiance"),
        settings=settings_for("trace_irradiance"),
    message:
        "{wildcards.subject}: tracing shadow rays, chunk {wildcards.chunk}"
    shell:
        "python -m pipeline.stages.trace_irradiance {params.arguments:q} --threads {threads} "
        "{params.settings:q} > {log:q} 2>&1"


# For variants that ask for other maps than their subject.
use rule trace_irradiance as trace_irradiance_of_variant with:
    output:
        irradiance=directory("results/{subject}/variants/{variant}/irradiance/{chunk}"),
        summary="results/{subject}/variants/{variant}/irradiance/{chunk}.parquet",
        picture="results/{subject}/variants/{variant}/irradiance/{chunk}.png",
    log:
        "results/{subject}/logs/trace_irradiance.{variant}.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/trace_irradiance.{variant}.{chunk}.tsv"
    params:
        arguments=arguments_for(
            "trace_irradiance",
            irradiance=lambda wildcards: job(wildcards).path(
                "variants", wildcards.variant, "irradiance", wildcards.chunk
            ),
        ),
    message:
        "{wildcards.subject}: tracing shadow rays of variant {wildcards.variant}, chunk {wildcards.chunk}"
