# A checkpoint, as index_capture is: training runs only if what it reads has changed.
checkpoint pack_shards:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        index_frames="results/{subject}/index/frames.parquet",
        images="results/{subject}/index/images.parquet",
        gaze="results/{subject}/index/gaze.parquet",
        estimated=estimated_gaze,
        atlas="results/{subject}/atlas.safetensors",
        tracking="results/{subject}/tracking/{chunk}.safetensors",
        cameras="results/{subject}/calibration/cameras.json",
        color="results/{subject}/calibration/color.json",
        lights="results/{subject}/calibration/lights.parquet",
        effects="results/{subject}/effects.json",
        patterns="results/{subject}/patterns.parquet",
        frames="results/{subject}/frames.parquet",
        irradiance=traced_irradiance,
        stored_maps=stored_maps,
        textures=mean_textures,
    output:
        train="results/{subject}/shards/train/{chunk}.arrow",
        validation="results/{subject}/shards/validation/{chunk}.arrow",
        test="results/{subject}/shards/test/{chunk}.arrow",
        frames="results/{subject}/shards/frames/{chunk}.arrow",
    log:
        "results/{subject}/logs/pack_shards.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/pack_shards.{chunk}.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("pack_shards")
    resources:
        mem_mb=memory_for("pack_shards"),
        runtime=minutes_for("pack_shards"),
    params:
        code=code_for("pack_shards"),
        capture=capture_folder,
        named=named,
        arguments=arguments_with_input(
            "pack_shards",
            {},
            irradiance=traced_maps,
            textures=lambda input: input.textures,
            gaze=lambda input: input.estimated,
        ),
        parts=[],
        settings=settings_for("pack_shards"),
    message:
        "{wildcards.subject}: packing shards, chunk {wildcards.chunk}"
    shell:
        "python -m pipeline.stages.pack_shards --capture {params.capture:q} {params.arguments:q} {params.parts:q} "
        "{params.settings:q} > {log:q} 2>&1"


# For variants that ask for other irradiance maps than their subject; the images are the same.
use rule pack_shards as pack_frames_of_variant with:
    output:
        frames="results/{subject}/variants/{variant}/frames/{chunk}.arrow",
    log:
        "results/{subject}/logs/pack_shards.{variant}.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/pack_shards.{variant}.{chunk}.tsv"
    params:
        arguments=arguments_with_input(
            "pack_shards",
            {"shards": lambda wildcards: job(wildcards).path("variants", wildcards.variant)},
            irradiance=traced_maps,
            textures=lambda input: input.textures,
            gaze=lambda input: input.estimated,
        ),
        parts=["--only-frames"],
    message:
        "{wildcards.subject}: packing frames of variant {wildcards.variant}, chunk {wildcards.chunk}"


# While it trains it keeps a checkpoint beside its outputs; a run that was stopped goes on from there.
rule train_avatar:
    input:
        index=ancient("results/{subject}/index/capture.json"),
        atlas="results/{subject}/atlas.safetensors",
        effects="results/{subject}/effects.json",
        train=lambda wildcards: job(wildcards).shards("shards/train"),
        frames=lambda wildcards: job(wildcards).frame_shards(),
        eyes=fitted_eyes,
        geometry=lambda wildcards: job(wildcards).given_geometry(),
    output:
        avatar="results/{subject}/avatars/{variant}/avatar.safetensors",
        config="results/{subject}/avatars/{variant}/config.json",
        log="results/{subject}/avatars/{variant}/log.parquet",
    log:
        "results/{subject}/logs/train_avatar.{variant}.log",
    benchmark:
        "results/{subject}/benchmarks/train_avatar.{variant}.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("train_avatar")
    resources:
        **resources_of_nodes(),
        mem_mb=memory_for("train_avatar"),
        runtime=minutes_for("train_avatar"),
        # Resources, which rerun nothing: the number of processes changes nothing but the order of sums, and what is
        # kept in memory nothing at all.
        processes=project.settings.training_processes,
        cache_mb=project.settings.training_cache_mb,
    params:
        code=code_for("train_avatar"),
        named=named,
        frames=lambda wildcards: job(wildcards).frame_folders(),
        arguments=arguments_with_input(
            "train_avatar",
            {"frame_shards": lambda wildcards: job(wildcards).frame_folders()},
            eyes=lambda input: input.eyes,
            geometry=lambda input: [os.path.dirname(path) for path in input.geometry[:1]],
        ),
        scratch=training_scratch,
        settings=settings_for("train_avatar"),
    message:
        "{wildcards.subject}: training avatar {wildcards.variant}"
    shell:
        "{resources.launcher} "
        "python -m pipeline.stages.train_avatar {params.arguments:q} --processes {resources.processes} "
        "--cache-mb {resources.cache_mb} {params.scratch:q} {params.settings:q} > {log:q} 2>&1"
