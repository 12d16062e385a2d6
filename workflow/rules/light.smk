# A checkpoint: an effect that is off has no job.
checkpoint plan_effects:
    input:
        capture="results/{subject}/index/capture.json",
        atlas="results/{subject}/atlas.safetensors",
        tracking=of_chunks("results/{subject}/tracking/{chunk}.safetensors"),
        images="results/{subject}/index/images.parquet",
        gaze="results/{subject}/index/gaze.parquet",
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
    threads: 1
    resources:
        mem_mb=2000,
    params:
        code=code_of("plan_effects"),
        capture=capture_folder,
        index=subpath(input.capture, parent=True),
        settings=settings_of("plan_effects"),
    message:
        "{wildcards.subject}: measuring which effects this capture calls for"
    shell:
        "python -m pipeline.stages.plan_effects --capture {params.capture:q} --index {params.index:q} "
        "--atlas {input.atlas:q} --tracking {input.tracking:q} --patterns {input.patterns:q} "
        "--booked {input.frames:q} --lights {input.lights:q} --cameras {input.cameras:q} "
        "--color {input.color:q} --out {output.effects:q} "
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
    threads: 2
    resources:
        mem_mb=4000,
    params:
        code=code_of("trace_irradiance"),
        # Visibility bits, if they are kept, are found again by their content: no output, and never out of date.
        cache=lambda wildcards: f"results/{wildcards.subject}/visibility",
        settings=settings_of("trace_irradiance"),
    message:
        "{wildcards.subject}: tracing shadow rays, chunk {wildcards.chunk}"
    shell:
        "python -m pipeline.stages.trace_irradiance --subject {wildcards.subject:q} --atlas {input.atlas:q} "
        "--tracking {input.tracking:q} --lights {input.lights:q} --patterns {input.patterns:q} "
        "--frames {input.frames:q} --out {output.irradiance:q} --cache {params.cache:q} --threads {threads} "
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
    message:
        "{wildcards.subject}: tracing shadow rays of variant {wildcards.variant}, chunk {wildcards.chunk}"
