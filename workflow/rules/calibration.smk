rule calibrate_cameras:
    input:
        stored=stored_capture,
        calibration="results/{subject}/index/calibration_cameras.json",
        cameras="results/{subject}/index/cameras.parquet",
        found=board_tables,
    output:
        rig="results/{subject}/calibration/rig.json",
        residuals="results/{subject}/calibration/residuals_cameras.parquet",
        quality="results/{subject}/calibration/quality_cameras.parquet",
        pairs="results/{subject}/calibration/pairs_cameras.parquet",
        verdicts="results/{subject}/calibration/verdicts_cameras.csv",
    log:
        "results/{subject}/logs/calibrate_cameras.log",
    benchmark:
        "results/{subject}/benchmarks/calibrate_cameras.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("calibrate_cameras")
    resources:
        mem_mb=memory_for("calibrate_cameras", size_by_boards(boards_joined_size)),
        runtime=minutes_for("calibrate_cameras"),
    params:
        code=code_for("calibrate_cameras"),
        capture=capture_folder,
        arguments=arguments_for("calibrate_cameras"),
        found=lambda wildcards, input: ["--found", *input.found] if input.found else [],
        share=[],
        settings=settings_for("calibrate_cameras"),
    message:
        "{wildcards.subject}: calibrating cameras"
    shell:
        "python -m pipeline.stages.calibrate_cameras --capture {params.capture:q} {params.arguments:q} "
        "{params.found:q} {params.share:q} --threads {threads} "
        "{params.settings:q} > {log:q} 2>&1"


# Where photographs of boards are many: a share of them, each decoded once but for a few that all look at.
use rule calibrate_cameras as find_boards with:
    input:
        stored=stored_capture,
        calibration="results/{subject}/index/calibration_cameras.json",
        cameras="results/{subject}/index/cameras.parquet",
    output:
        table="results/{subject}/found_boards/{share}.parquet",
    log:
        "results/{subject}/logs/find_boards.{share}.log",
    benchmark:
        "results/{subject}/benchmarks/find_boards.{share}.tsv"
    resources:
        mem_mb=memory_for("calibrate_cameras", size_by_boards(boards_share_size)),
        runtime=minutes_for("calibrate_cameras", size_by_boards(boards_share_size)),
    params:
        arguments=arguments_for("calibrate_cameras", calibration=lambda wildcards: job(wildcards).path("found_boards")),
        found=[],
        share=lambda wildcards: ["--share", int(wildcards.share), "--shares", len(board_tables(wildcards))],
    message:
        "{wildcards.subject}: finding boards, share {wildcards.share}"


rule calibrate_color:
    input:
        stored=stored_capture,
        calibration="results/{subject}/index/calibration_color.json",
        cameras="results/{subject}/index/cameras.parquet",
        capture="results/{subject}/index/capture.json",
    output:
        color="results/{subject}/calibration/color.json",
        residuals="results/{subject}/calibration/residuals_color.parquet",
        quality="results/{subject}/calibration/quality_color.parquet",
        verdicts="results/{subject}/calibration/verdicts_color.csv",
    log:
        "results/{subject}/logs/calibrate_color.log",
    benchmark:
        "results/{subject}/benchmarks/calibrate_color.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("calibrate_color")
    resources:
        mem_mb=memory_for("calibrate_color"),
        runtime=minutes_for("calibrate_color"),
    params:
        code=code_for("calibrate_color"),
        capture=capture_folder,
        arguments=arguments_for("calibrate_color"),
        settings=settings_for("calibrate_color"),
    message:
        "{wildcards.subject}: calibrating colour"
    shell:
        "python -m pipeline.stages.calibrate_color --capture {params.capture:q} {params.arguments:q} "
        "--threads {threads} "
        "{params.settings:q} > {log:q} 2>&1"


rule calibrate_lights:
    input:
        stored=stored_capture,
        calibration="results/{subject}/index/calibration_lights.json",
        calibration_cameras="results/{subject}/index/calibration_cameras.json",
        lights="results/{subject}/index/lights.parquet",
        rig="results/{subject}/calibration/rig.json",
        measured=lambda wildcards: measured_lights(job(wildcards)),
    output:
        lights="results/{subject}/calibration/lights.parquet",
        cameras="results/{subject}/calibration/cameras.json",
        residuals="results/{subject}/calibration/residuals_lights.parquet",
        verdicts="results/{subject}/calibration/verdicts_lights.csv",
    log:
        "results/{subject}/logs/calibrate_lights.log",
    benchmark:
        "results/{subject}/benchmarks/calibrate_lights.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("calibrate_lights")
    resources:
        mem_mb=memory_for("calibrate_lights", size_joining_lights),
        runtime=minutes_for("calibrate_lights"),
    params:
        code=code_for("calibrate_lights"),
        capture=capture_folder,
        arguments=arguments_for("calibrate_lights"),
        measured=lambda wildcards, input: ["--measured", *input.measured] if input.measured else [],
        share=[],
        settings=settings_for("calibrate_lights"),
    message:
        "{wildcards.subject}: locating lights and aligning the cameras to the stage"
    shell:
        "python -m pipeline.stages.calibrate_lights --capture {params.capture:q} {params.arguments:q} "
        "{params.measured:q} {params.share:q} --threads {threads} "
        "{params.settings:q} > {log:q} 2>&1"


# Where photographs are many: those of some cameras, each decoded once.
use rule calibrate_lights as measure_lights with:
    input:
        stored=stored_capture,
        calibration="results/{subject}/index/calibration_lights.json",
        lights="results/{subject}/index/lights.parquet",
    output:
        table="results/{subject}/measured_lights/{share}.parquet",
    log:
        "results/{subject}/logs/measure_lights.{share}.log",
    benchmark:
        "results/{subject}/benchmarks/measure_lights.{share}.tsv"
    resources:
        mem_mb=memory_for("calibrate_lights", size_of_lights_share),
        runtime=minutes_for("calibrate_lights", size_of_lights_share),
    params:
        arguments=arguments_for(
            "calibrate_lights", calibration=lambda wildcards: job(wildcards).path("measured_lights")
        ),
        measured=[],
        share=lambda wildcards: ["--share", int(wildcards.share), "--shares", len(measured_lights(job(wildcards)))],
    message:
        "{wildcards.subject}: measuring mirror balls, share {wildcards.share}"


rule review_calibration:
    input:
        stored=stored_capture,
        cameras_index="results/{subject}/index/calibration_cameras.json",
        lights_index="results/{subject}/index/calibration_lights.json",
        color_index="results/{subject}/index/calibration_color.json",
        capture="results/{subject}/index/capture.json",
        survey="results/{subject}/index/lights.parquet",
        cameras="results/{subject}/calibration/cameras.json",
        lights="results/{subject}/calibration/lights.parquet",
        color="results/{subject}/calibration/color.json",
        residuals=expand(
            "results/{{subject}}/calibration/residuals_{part}.parquet",
            part=("cameras", "lights", "color"),
        ),
        verdicts=expand(
            "results/{{subject}}/calibration/verdicts_{part}.csv",
            part=("cameras", "lights", "color"),
        ),
    output:
        residuals="results/{subject}/calibration/residuals.parquet",
        verdicts="results/{subject}/calibration/verdicts.csv",
        pictures=directory("results/{subject}/calibration/review"),
    log:
        "results/{subject}/logs/review_calibration.log",
    benchmark:
        "results/{subject}/benchmarks/review_calibration.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("review_calibration")
    resources:
        mem_mb=memory_for("review_calibration"),
        runtime=minutes_for("review_calibration"),
    params:
        code=code_for("review_calibration"),
        capture=capture_folder,
        arguments=arguments_for("review_calibration"),
        settings=settings_for("review_calibration"),
    message:
        "{wildcards.subject}: drawing what the calibration is judged by"
    shell:
        "python -m pipeline.stages.review_calibration --capture {params.capture:q} {params.arguments:q} "
        "--threads {threads} "
        "{params.settings:q} > {log:q} 2>&1"
