# What only avatars of heads read: a job only if there is one.
rule bake_textures:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        images="results/{subject}/index/images.parquet",
        atlas="results/{subject}/atlas.safetensors",
        tracking="results/{subject}/tracking/{chunk}.safetensors",
        cameras="results/{subject}/calibration/cameras.json",
        color="results/{subject}/calibration/color.json",
        effects="results/{subject}/effects.json",
        frames="results/{subject}/frames.parquet",
    output:
        textures="results/{subject}/textures/{chunk}.safetensors",
        picture="results/{subject}/textures/{chunk}.png",
    log:
        "results/{subject}/logs/bake_textures.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/bake_textures.{chunk}.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("bake_textures")
    resources:
        mem_mb=memory_for("bake_textures"),
        runtime=minutes_for("bake_textures"),
    params:
        code=code_for("bake_textures"),
        capture=capture_folder,
        arguments=arguments_for("bake_textures"),
        settings=settings_for("bake_textures"),
    message:
        "{wildcards.subject}: averaging what cameras see of the surface, chunk {wildcards.chunk}"
    shell:
        "python -m pipeline.stages.bake_textures --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"
