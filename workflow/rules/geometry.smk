rule track_mesh:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        meshes="results/{subject}/index/meshes.parquet",
        frames="results/{subject}/index/frames.parquet",
        images="results/{subject}/index/images.parquet",
        keypoints="results/{subject}/index/keypoints_2d.parquet",
        cameras="results/{subject}/calibration/cameras.json",
        lights="results/{subject}/calibration/lights.parquet",
        patterns="results/{subject}/patterns.parquet",
    output:
        tracking="results/{subject}/tracking/{chunk}.safetensors",
        quality="results/{subject}/tracking/{chunk}.parquet",
        verdicts="results/{subject}/tracking/verdicts_{chunk}.csv",
    log:
        "results/{subject}/logs/track_mesh.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/track_mesh.{chunk}.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("track_mesh")
    resources:
        mem_mb=memory_for("track_mesh"),
        runtime=minutes_for("track_mesh"),
    params:
        code=code_for("track_mesh"),
        capture=capture_folder,
        arguments=arguments_for("track_mesh"),
        settings=settings_for("track_mesh"),
    message:
        "{wildcards.subject}: tracking the template, chunk {wildcards.chunk}"
    shell:
        "python -m pipeline.stages.track_mesh --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"


rule review_tracking:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        frames="results/{subject}/index/frames.parquet",
        images="results/{subject}/index/images.parquet",
        keypoints="results/{subject}/index/keypoints_2d.parquet",
        cameras="results/{subject}/calibration/cameras.json",
        lights="results/{subject}/calibration/lights.parquet",
        color="results/{subject}/calibration/color.json",
        patterns="results/{subject}/patterns.parquet",
        tracking=each_chunk("tracking/{chunk}.safetensors"),
        quality=each_chunk("tracking/{chunk}.parquet"),
    output:
        review=directory("results/{subject}/tracking/review"),
    log:
        "results/{subject}/logs/review_tracking.log",
    benchmark:
        "results/{subject}/benchmarks/review_tracking.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("review_tracking")
    resources:
        mem_mb=memory_for("review_tracking"),
        runtime=minutes_for("review_tracking"),
    params:
        code=code_for("review_tracking"),
        capture=capture_folder,
        arguments=arguments_for("review_tracking", tracking=each_chunk("tracking/{chunk}.safetensors")),
        settings=settings_for("review_tracking"),
    message:
        "{wildcards.subject}: drawing what the tracking is judged by"
    shell:
        "python -m pipeline.stages.review_tracking --capture {params.capture:q} {params.arguments:q} "
        "--threads {threads} "
        "{params.settings:q} > {log:q} 2>&1"


rule unwrap_atlas:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        rig="results/{subject}/calibration/rig.json",
    output:
        atlas="results/{subject}/atlas.safetensors",
        picture=report(
            "results/{subject}/atlas.png", caption="../report/atlas.rst", category="Inputs", subcategory="{subject}"
        ),
        template="results/{subject}/template.glb",
    log:
        "results/{subject}/logs/unwrap_atlas.log",
    benchmark:
        "results/{subject}/benchmarks/unwrap_atlas.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("unwrap_atlas")
    resources:
        mem_mb=memory_for("unwrap_atlas"),
        runtime=minutes_for("unwrap_atlas"),
    params:
        code=code_for("unwrap_atlas"),
        capture=capture_folder,
        arguments=arguments_for("unwrap_atlas"),
        settings=settings_for("unwrap_atlas"),
    message:
        "{wildcards.subject}: laying the template's surface out on an atlas"
    shell:
        "python -m pipeline.stages.unwrap_atlas --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"


# Only for captures that list eyes and no gaze: `estimated_gaze` asks for it.
rule estimate_gaze:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        eyes="results/{subject}/index/eyes.parquet",
        eye_points="results/{subject}/index/eye_points.parquet",
        images="results/{subject}/index/images.parquet",
        atlas="results/{subject}/atlas.safetensors",
        tracking=each_chunk("tracking/{chunk}.safetensors"),
        cameras="results/{subject}/calibration/cameras.json",
        frames="results/{subject}/frames.parquet",
    output:
        gaze="results/{subject}/gaze.parquet",
        quality="results/{subject}/quality_gaze.parquet",
        verdicts="results/{subject}/verdicts_gaze.csv",
    log:
        "results/{subject}/logs/estimate_gaze.log",
    benchmark:
        "results/{subject}/benchmarks/estimate_gaze.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("estimate_gaze")
    resources:
        mem_mb=memory_for("estimate_gaze"),
        runtime=minutes_for("estimate_gaze"),
    params:
        code=code_for("estimate_gaze"),
        capture=capture_folder,
        arguments=arguments_for("estimate_gaze", tracking=each_chunk("tracking/{chunk}.safetensors")),
        settings=settings_for("estimate_gaze"),
    message:
        "{wildcards.subject}: estimating where the eyes look"
    shell:
        "python -m pipeline.stages.estimate_gaze --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"


# Only for avatars with explicit eyes: `fitted_eyes` asks for it.
rule fit_eyes:
    input:
        eyes="results/{subject}/index/eyes.parquet",
        gaze="results/{subject}/index/gaze.parquet",
        estimated=estimated_gaze,
        atlas="results/{subject}/atlas.safetensors",
        tracking=each_chunk("tracking/{chunk}.safetensors"),
    output:
        eyes="results/{subject}/eyes.json",
        verdicts="results/{subject}/verdicts_eyes.csv",
    log:
        "results/{subject}/logs/fit_eyes.log",
    benchmark:
        "results/{subject}/benchmarks/fit_eyes.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("fit_eyes")
    resources:
        mem_mb=memory_for("fit_eyes"),
        runtime=minutes_for("fit_eyes"),
    params:
        code=code_for("fit_eyes"),
        named=named,
        arguments=arguments_with_input(
            "fit_eyes",
            {"tracking": each_chunk("tracking/{chunk}.safetensors")},
            gaze=lambda input: input.estimated,
        ),
        settings=settings_for("fit_eyes"),
    message:
        "{wildcards.subject}: fitting eyeballs and corneas"
    shell:
        "python -m pipeline.stages.fit_eyes {params.arguments:q} {params.settings:q} > {log:q} 2>&1"
