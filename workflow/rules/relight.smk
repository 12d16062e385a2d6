# Nothing needs it; ask for it by the names of an avatar and a light.
rule relight_avatar:
    input:
        atlas="results/{subject}/atlas.safetensors",
        avatar="results/{subject}/avatars/{variant}/avatar.safetensors",
        config="results/{subject}/avatars/{variant}/config.json",
        tracking=each_chunk("tracking/{chunk}.safetensors"),
        textures=mean_textures,
        index_frames="results/{subject}/index/frames.parquet",
        gaze="results/{subject}/index/gaze.parquet",
        tables=lambda wildcards: job(wildcards).driving_tables(),
        cameras="results/{subject}/calibration/cameras.json",
        light=lambda wildcards: light_file(wildcards.light),
    output:
        pictures=directory("results/{subject}/relit/{variant}/{light}"),
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
        code=code_for("relight_avatar"),
        named=named,
        arguments=arguments_with_input(
            "relight_avatar",
            {
                "tracking": each_chunk("tracking/{chunk}.safetensors"),
                "environment": light_as("environment"),
                "light_list": light_as("light_list"),
                "relit": lambda wildcards: job(wildcards).path("relit", wildcards.variant, wildcards.light),
            },
            textures=lambda input: input.textures,
        ),
        settings=settings_for("relight_avatar"),
    message:
        "{wildcards.subject}: avatar {wildcards.variant} under {wildcards.light}"
    shell:
        "python -m pipeline.stages.relight_avatar {params.arguments:q} {params.settings:q} > {log:q} 2>&1"
