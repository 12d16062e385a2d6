# Nothing needs it; ask for it by the names of an avatar and a light.
rule relight_avatar:
    input:
        atlas="results/{subject}/atlas.safetensors",
        avatar="results/{subject}/avatars/{variant}/avatar.safetensors",
        config="results/{subject}/avatars/{variant}/config.json",
        tracking=of_chunks("results/{subject}/tracking/{chunk}.safetensors"),
        textures=mean_textures,
        index_frames="results/{subject}/index/frames.parquet",
        gaze="results/{subject}/index/gaze.parquet",
        tables=drive_tables,
        cameras="results/{subject}/calibration/cameras.json",
        light=light_file,
    output:
        directory("results/{subject}/relit/{variant}/{light}"),
    log:
        "results/{subject}/logs/relight_avatar.{variant}.{light}.log",
    benchmark:
        "results/{subject}/benchmarks/relight_avatar.{variant}.{light}.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: 16
    resources:
        mem_mb=4000,
    params:
        code=code_of("relight_avatar"),
        avatar=subpath(input.avatar, parent=True),
        index=subpath(input.gaze, parent=True),
        textures=lambda wildcards, input: ["--textures", *input.textures] if input.textures else [],
        kind=lambda wildcards, input: LIGHT_KINDS[Path(input.light).suffix],
        settings=settings_of("relight_avatar"),
    message:
        "{wildcards.subject}: avatar {wildcards.variant} under {wildcards.light}"
    shell:
        "python -m pipeline.stages.relight_avatar --atlas {input.atlas:q} --avatar {params.avatar:q} "
        "--tracking {input.tracking:q} {params.textures:q} --index {params.index:q} --cameras {input.cameras:q} "
        "--{params.kind} {input.light:q} --out {output:q} {params.settings:q} > {log:q} 2>&1"
