# Nothing needs it; ask for it by the names of an avatar and a light.
rule relight_avatar:
    input:
        atlas="results/{subject}/atlas.safetensors",
        avatar="results/{subject}/avatars/{variant}/avatar.safetensors",
        config="results/{subject}/avatars/{variant}/config.json",
        tracking=each_chunk("tracking/{chunk}.safetensors"),
        textures=mean_textures,
        index="results/{subject}/index/capture.json",
        index_frames="results/{subject}/index/frames.parquet",
        gaze="results/{subject}/index/gaze.parquet",
        estimated=estimated_gaze,
        tables=lambda wildcards: job(wildcards).driving_tables(),
        captured=lambda wildcards: job(wildcards).captured_shards(),
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
    threads: threads_for("relight_avatar")
    resources:
        mem_mb=memory_for("relight_avatar"),
        runtime=minutes_for("relight_avatar"),
    params:
        code=code_for("relight_avatar"),
        named=named,
        arguments=arguments_with_input(
            "relight_avatar",
            {
                "tracking": each_chunk("tracking/{chunk}.safetensors"),
                "environment": light_as("environment"),
                "light_list": light_as("light_list"),
                "captured": captured_folder,
                "relit": lambda wildcards: job(wildcards).path("relit", wildcards.variant, wildcards.light),
            },
            textures=lambda input: input.textures,
            gaze=lambda input: input.estimated,
        ),
        settings=settings_for("relight_avatar"),
    message:
        "{wildcards.subject}: avatar {wildcards.variant} under {wildcards.light}"
    shell:
        "python -m pipeline.stages.relight_avatar {params.arguments:q} {params.settings:q} > {log:q} 2>&1"


# Nothing needs it; ask for it by name. The page is of the subject's first avatar.
rule export_viewer:
    input:
        atlas="results/{subject}/atlas.safetensors",
        avatar=lambda wildcards: job(wildcards).avatars("avatar.safetensors")[0],
        config=lambda wildcards: job(wildcards).avatars("config.json")[0],
        train=lambda wildcards: job(wildcards).shards("shards/train"),
        validation=lambda wildcards: job(wildcards).shards("shards/validation"),
        test=lambda wildcards: job(wildcards).shards("shards/test"),
        frames=lambda wildcards: job(wildcards).frame_shards(),
        index="results/{subject}/index/capture.json",
        lights="results/{subject}/calibration/lights.parquet",
        patterns="results/{subject}/patterns.parquet",
        page="pipeline/viewer/bundle/page.html",
    output:
        "results/{subject}/viewer/index.html",
    log:
        "results/{subject}/logs/export_viewer.log",
    benchmark:
        "results/{subject}/benchmarks/export_viewer.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("export_viewer")
    resources:
        mem_mb=memory_for("export_viewer"),
        runtime=minutes_for("export_viewer"),
    params:
        code=code_for("export_viewer"),
        arguments=arguments_for(
            "export_viewer",
            avatar=lambda wildcards: job(wildcards).avatars()[0],
            frame_shards=lambda wildcards: job(wildcards).frame_folders()[0],
        ),
        settings=settings_for("export_viewer"),
    message:
        "{wildcards.subject}: writing the page that relights the avatar"
    shell:
        "python -m pipeline.stages.export_viewer {params.arguments:q} {params.settings:q} > {log:q} 2>&1"


# The same for the files that other programs open.
rule export_avatar:
    input:
        stored=stored_capture,
        atlas="results/{subject}/atlas.safetensors",
        avatar=lambda wildcards: job(wildcards).avatars("avatar.safetensors")[0],
        config=lambda wildcards: job(wildcards).avatars("config.json")[0],
        frames=lambda wildcards: job(wildcards).frame_shards(),
        tracking=each_chunk("tracking/{chunk}.safetensors"),
        index="results/{subject}/index/capture.json",
        cameras="results/{subject}/calibration/cameras.json",
        lights="results/{subject}/calibration/lights.parquet",
        patterns="results/{subject}/patterns.parquet",
        script="pipeline/export/open_in_blender.py",
    output:
        directory("results/{subject}/export"),
    log:
        "results/{subject}/logs/export_avatar.log",
    benchmark:
        "results/{subject}/benchmarks/export_avatar.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("export_avatar")
    resources:
        mem_mb=memory_for("export_avatar"),
        runtime=minutes_for("export_avatar"),
    params:
        code=code_for("export_avatar"),
        capture=capture_folder,
        arguments=arguments_for(
            "export_avatar",
            avatar=lambda wildcards: job(wildcards).avatars()[0],
            tracking=each_chunk("tracking/{chunk}.safetensors"),
            frame_shards=lambda wildcards: job(wildcards).frame_folders()[0],
        ),
        settings=settings_for("export_avatar"),
    message:
        "{wildcards.subject}: writing the avatar as files for other programs"
    shell:
        "python -m pipeline.stages.export_avatar --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"


# The capture itself, calibrated, in the layout of another program: colmap, nerfstudio or goliath.
rule export_capture:
    input:
        stored=stored_capture,
        images="results/{subject}/index/images.parquet",
        frames="results/{subject}/index/frames.parquet",
        index="results/{subject}/index/capture.json",
        cameras="results/{subject}/calibration/cameras.json",
        color="results/{subject}/calibration/color.json",
        lights=of_goliath("results/{subject}/calibration/lights.parquet"),
        patterns=of_goliath("results/{subject}/patterns.parquet"),
        tracking=tracking_of_layout("tracking/{chunk}.safetensors"),
        statuses=tracking_of_layout("tracking/{chunk}.parquet"),
    output:
        directory("results/{subject}/exports/{layout}"),
    log:
        "results/{subject}/logs/export_capture.{layout}.log",
    benchmark:
        "results/{subject}/benchmarks/export_capture.{layout}.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("export_capture")
    resources:
        mem_mb=memory_for("export_capture"),
        runtime=minutes_for("export_capture"),
    params:
        code=code_for("export_capture"),
        capture=capture_folder,
        arguments=arguments_for(
            "export_capture",
            layout=lambda wildcards: wildcards.layout,
            lights_of_layout=of_goliath("results/{subject}/calibration/lights.parquet"),
            patterns_of_layout=of_goliath("results/{subject}/patterns.parquet"),
            tracking=tracking_of_layout("tracking/{chunk}.safetensors"),
            exported=lambda wildcards: job(wildcards).path("exports", wildcards.layout),
        ),
        settings=settings_for("export_capture"),
    message:
        "{wildcards.subject}: writing the capture in the layout of {wildcards.layout}"
    shell:
        "python -m pipeline.stages.export_capture --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"
