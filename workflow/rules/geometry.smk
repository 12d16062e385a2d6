rule track_mesh:
    input:
        capture="results/{subject}/index/capture.json",
        frames="results/{subject}/index/frames.parquet",
        images="results/{subject}/index/images.parquet",
        keypoints="results/{subject}/index/keypoints_2d.parquet",
        cameras="results/{subject}/calibration/cameras.json",
        lights="results/{subject}/calibration/lights.parquet",
        patterns="results/{subject}/patterns.parquet",
    output:
        tracking="results/{subject}/tracking/{chunk}.safetensors",
        quality="results/{subject}/tracking/{chunk}.parquet",
    log:
        "results/{subject}/logs/track_mesh.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/track_mesh.{chunk}.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: 1
    resources:
        mem_mb=4000,
    params:
        code=code_of("track_mesh"),
        capture=capture_folder,
        index=subpath(input.capture, parent=True),
        out=subpath(output.tracking, parent=True),
        chunk_size=chunk_size,
        settings=settings_of("track_mesh"),
    message:
        "{wildcards.subject}: tracking the template, chunk {wildcards.chunk}"
    shell:
        "python -m pipeline.stages.track_mesh --capture {params.capture:q} --index {params.index:q} "
        "--cameras {input.cameras:q} --lights {input.lights:q} --patterns {input.patterns:q} "
        "--chunk {wildcards.chunk} --chunk-size {params.chunk_size} "
        "--out {params.out:q} {params.settings:q} > {log:q} 2>&1"


rule review_tracking:
    input:
        capture="results/{subject}/index/capture.json",
        frames="results/{subject}/index/frames.parquet",
        images="results/{subject}/index/images.parquet",
        keypoints="results/{subject}/index/keypoints_2d.parquet",
        cameras="results/{subject}/calibration/cameras.json",
        lights="results/{subject}/calibration/lights.parquet",
        color="results/{subject}/calibration/color.json",
        patterns="results/{subject}/patterns.parquet",
        tracking=of_chunks("results/{subject}/tracking/{chunk}.safetensors"),
        quality=of_chunks("results/{subject}/tracking/{chunk}.parquet"),
    output:
        review=directory("results/{subject}/tracking/review"),
    log:
        "results/{subject}/logs/review_tracking.log",
    benchmark:
        "results/{subject}/benchmarks/review_tracking.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: 2
    resources:
        mem_mb=4000,
    params:
        code=code_of("review_tracking"),
        capture=capture_folder,
        index=subpath(input.capture, parent=True),
        calibration=subpath(input.cameras, parent=True),
        settings=settings_of("review_tracking"),
    message:
        "{wildcards.subject}: drawing what the tracking is judged by"
    shell:
        "python -m pipeline.stages.review_tracking --capture {params.capture:q} --index {params.index:q} "
        "--calibration {params.calibration:q} --patterns {input.patterns:q} --tracking {input.tracking:q} "
        "--out {output.review:q} --threads {threads} {params.settings:q} > {log:q} 2>&1"


rule unwrap_atlas:
    input:
        capture="results/{subject}/index/capture.json",
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
    threads: 1
    resources:
        mem_mb=2000,
    params:
        code=code_of("unwrap_atlas"),
        capture=capture_folder,
        index=subpath(input.capture, parent=True),
        out=subpath(output.atlas, parent=True),
        settings=settings_of("unwrap_atlas"),
    message:
        "{wildcards.subject}: laying the template's surface out on an atlas"
    shell:
        "python -m pipeline.stages.unwrap_atlas --capture {params.capture:q} --index {params.index:q} "
        "--out {params.out:q} {params.settings:q} > {log:q} 2>&1"


# Only for avatars with explicit eyes: `fitted_eyes` asks for it.
rule fit_eyes:
    input:
        eyes="results/{subject}/index/eyes.parquet",
        gaze="results/{subject}/index/gaze.parquet",
        atlas="results/{subject}/atlas.safetensors",
        tracking=of_chunks("results/{subject}/tracking/{chunk}.safetensors"),
    output:
        eyes="results/{subject}/eyes.json",
    log:
        "results/{subject}/logs/fit_eyes.log",
    benchmark:
        "results/{subject}/benchmarks/fit_eyes.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: 1
    resources:
        mem_mb=2000,
    params:
        code=code_of("fit_eyes"),
        index=subpath(input.eyes, parent=True),
        settings=settings_of("fit_eyes"),
    message:
        "{wildcards.subject}: fitting eyeballs and corneas"
    shell:
        "python -m pipeline.stages.fit_eyes --index {params.index:q} --atlas {input.atlas:q} "
        "--tracking {input.tracking:q} --out {output.eyes:q} {params.settings:q} > {log:q} 2>&1"
