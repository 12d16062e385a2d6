# A checkpoint, as index_capture is: training runs only if what it reads has changed.
checkpoint pack_shards:
    input:
        capture="results/{subject}/index/capture.json",
        index_frames="results/{subject}/index/frames.parquet",
        images="results/{subject}/index/images.parquet",
        gaze="results/{subject}/index/gaze.parquet",
        atlas="results/{subject}/atlas.safetensors",
        tracking="results/{subject}/tracking/{chunk}.safetensors",
        cameras="results/{subject}/calibration/cameras.json",
        color="results/{subject}/calibration/color.json",
        lights="results/{subject}/calibration/lights.parquet",
        effects="results/{subject}/effects.json",
        patterns="results/{subject}/patterns.parquet",
        frames="results/{subject}/frames.parquet",
        irradiance=traced_irradiance,
        textures=mean_textures,
    output:
        train="results/{subject}/shards/train/{chunk}.arrow",
        test="results/{subject}/shards/test/{chunk}.arrow",
        frames="results/{subject}/shards/frames/{chunk}.arrow",
    log:
        "results/{subject}/logs/pack_shards.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/pack_shards.{chunk}.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: 1
    resources:
        mem_mb=4000,
    params:
        code=code_of("pack_shards"),
        capture=capture_folder,
        index=subpath(input.capture, parent=True),
        out=subpath(output.train, ancestor=2),
        irradiance=lambda wildcards, input: [
            word for table in input.irradiance for word in ("--irradiance", table.removesuffix(".parquet"))
        ],
        textures=lambda wildcards, input: [word for path in input.textures for word in ("--textures", path)],
        parts=[],
        chunk_size=chunk_size,
        settings=settings_of("pack_shards"),
    message:
        "{wildcards.subject}: packing shards, chunk {wildcards.chunk}"
    shell:
        "python -m pipeline.stages.pack_shards --capture {params.capture:q} --index {params.index:q} "
        "--atlas {input.atlas:q} --tracking {input.tracking:q} --cameras {input.cameras:q} "
        "--color {input.color:q} --lights {input.lights:q} --effects {input.effects:q} "
        "--patterns {input.patterns:q} --frames {input.frames:q} --chunk {wildcards.chunk} "
        "--chunk-size {params.chunk_size} {params.irradiance:q} {params.textures:q} {params.parts:q} --out {params.out:q} "
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
        out=subpath(output.frames, ancestor=2),
        parts=["--only-frames"],
    message:
        "{wildcards.subject}: packing frames of variant {wildcards.variant}, chunk {wildcards.chunk}"


# While it trains it keeps a checkpoint beside its outputs; a run that was stopped goes on from there.
rule train_avatar:
    input:
        index=ancient("results/{subject}/index/capture.json"),
        atlas="results/{subject}/atlas.safetensors",
        effects="results/{subject}/effects.json",
        train=shards_of("train"),
        frames=frame_shards,
        eyes=fitted_eyes,
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
    threads: 16
    resources:
        mem_mb=8000 * project.settings.training_processes,
        launcher=launcher(project.settings.training_processes),
    params:
        code=code_of("train_avatar"),
        shards=lambda wildcards: f"results/{wildcards.subject}/shards",
        frames=frame_folders,
        eyes=lambda wildcards, input: ["--fitted-eyes", *input.eyes] if input.eyes else [],
        out=subpath(output.avatar, parent=True),
        settings=settings_of("train_avatar"),
    message:
        "{wildcards.subject}: training avatar {wildcards.variant}"
    shell:
        "{resources.launcher} -m pipeline.stages.train_avatar --subject {wildcards.subject:q} --atlas {input.atlas:q} "
        "--shards {params.shards:q} --frames {params.frames:q} --effects {input.effects:q} {params.eyes:q} "
        "--out {params.out:q} {params.settings:q} > {log:q} 2>&1"
