rule synthesize_capture:
    output:
        # Written last: present means complete. The other files of the folder belong to it.
        description=captured(f"{captures}/{{subject}}/capture.yaml"),
    log:
        "results/{subject}/logs/synthesize_capture.log",
    benchmark:
        "results/{subject}/benchmarks/synthesize_capture.tsv"
    wildcard_constraints:
        subject=one_of(project.synthetic_subjects),
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("synthesize_capture")
    resources:
        mem_mb=memory_for("synthesize_capture"),
        runtime=minutes_for("synthesize_capture"),
    params:
        code=code_for("synthesize_capture"),
        arguments=arguments_for("synthesize_capture"),
        settings=settings_for("synthesize_capture"),
    message:
        "{wildcards.subject}: making a synthetic capture"
    shell:
        "python -m pipeline.stages.synthesize_capture {params.arguments:q} --workers {threads} "
        "{params.settings:q} > {log:q} 2>&1"


# A checkpoint, as what it writes decides how many jobs check the images.
checkpoint import_capture:
    input:
        lambda wildcards: job(wildcards).dataset_files(),
    output:
        # Written last: present means complete. Images stay where they are, behind a link.
        description=captured(f"{captures}/{{subject}}/capture.yaml"),
    log:
        "results/{subject}/logs/import_capture.log",
    benchmark:
        "results/{subject}/benchmarks/import_capture.tsv"
    wildcard_constraints:
        subject=one_of(project.imported_subjects),
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("import_capture")
    resources:
        mem_mb=memory_for("import_capture"),
        runtime=minutes_for("import_capture"),
    params:
        code=code_for("import_capture"),
        arguments=arguments_for(
            "import_capture",
            dataset=lambda wildcards: job(wildcards).settings.source,
            source=lambda wildcards: job(wildcards).settings.path,
        ),
        settings=settings_for("import_capture"),
    message:
        "{wildcards.subject}: reading a public set in place"
    shell:
        "python -m pipeline.stages.import_capture {params.arguments:q} {params.settings:q} > {log:q} 2>&1"


# These two only for captures that come without keypoints or masks: `detected_keypoints` and `detected_masks` ask for
# them. What they run has an environment of its own (make detect).
rule detect_landmarks:
    input:
        lambda wildcards: capture_files(wildcards.subject),
    output:
        keypoints="results/{subject}/detected/keypoints_2d.parquet",
        eyes="results/{subject}/detected/eye_points.parquet",
        counts="results/{subject}/detected/landmarks.csv",
        picture="results/{subject}/detected/landmarks.png",
    log:
        "results/{subject}/logs/detect_landmarks.log",
    benchmark:
        "results/{subject}/benchmarks/detect_landmarks.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("detect_landmarks")
    resources:
        mem_mb=memory_for("detect_landmarks"),
        runtime=minutes_for("detect_landmarks"),
    params:
        code=code_for("detect_landmarks"),
        capture=capture_folder,
        arguments=arguments_for("detect_landmarks"),
        origin=lambda wildcards: job(wildcards).capture_origin(),
        settings=settings_for("detect_landmarks"),
    message:
        "{wildcards.subject}: looking for keypoints in the photographs"
    shell:
        "python -m pipeline.stages.detect_landmarks --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"


rule segment_subject:
    input:
        lambda wildcards: capture_files(wildcards.subject),
    output:
        masks="results/{subject}/detected/masks.parquet",
        folder=directory("results/{subject}/detected/masks"),
        picture="results/{subject}/detected/masks.png",
    log:
        "results/{subject}/logs/segment_subject.log",
    benchmark:
        "results/{subject}/benchmarks/segment_subject.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("segment_subject")
    resources:
        mem_mb=memory_for("segment_subject"),
        runtime=minutes_for("segment_subject"),
    params:
        code=code_for("segment_subject"),
        capture=capture_folder,
        arguments=arguments_for("segment_subject"),
        origin=lambda wildcards: job(wildcards).capture_origin(),
        settings=settings_for("segment_subject"),
    message:
        "{wildcards.subject}: masking the subject in the photographs"
    shell:
        "python -m pipeline.stages.segment_subject --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"


# A checkpoint, so that all that follows is decided anew, by content, when the index is there: if it is what it was,
# nothing else runs. Snakemake reconsiders only jobs with an input from the checkpoint; stages that read nothing of the
# index therefore name a file of it, as `ancient`, which by itself reruns nothing.
checkpoint index_capture:
    input:
        capture=lambda wildcards: capture_files(wildcards.subject),
        inspected=inspected_images,
        detected_keypoints=lambda wildcards: detected_keypoints(job(wildcards)),
        detected_masks=lambda wildcards: detected_masks(job(wildcards)),
    output:
        cameras="results/{subject}/index/cameras.parquet",
        frames="results/{subject}/index/frames.parquet",
        lights="results/{subject}/index/lights.parquet",
        patterns="results/{subject}/index/patterns.parquet",
        images="results/{subject}/index/images.parquet",
        keypoints="results/{subject}/index/keypoints_2d.parquet",
        eye_points="results/{subject}/index/eye_points.parquet",
        eyes="results/{subject}/index/eyes.parquet",
        gaze="results/{subject}/index/gaze.parquet",
        meshes="results/{subject}/index/meshes.parquet",
        capture="results/{subject}/index/capture.json",
        calibration_cameras="results/{subject}/index/calibration_cameras.json",
        calibration_lights="results/{subject}/index/calibration_lights.json",
        calibration_color="results/{subject}/index/calibration_color.json",
        verdicts="results/{subject}/index/verdicts_images.csv",
    log:
        "results/{subject}/logs/index_capture.log",
    benchmark:
        "results/{subject}/benchmarks/index_capture.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("index_capture")
    resources:
        mem_mb=memory_for("index_capture", size_joining(inspected_tables)),
        runtime=minutes_for("index_capture", size_joining(inspected_tables)),
    params:
        code=code_for("index_capture"),
        capture=capture_folder,
        arguments=arguments_for(
            "index_capture",
            detected_keypoints=lambda wildcards: detected_keypoints(job(wildcards)),
            detected_masks=lambda wildcards: detected_masks(job(wildcards)),
        ),
        origin=lambda wildcards: job(wildcards).capture_origin(),
        inspected=lambda wildcards, input: ["--inspected", *input.inspected] if input.inspected else [],
        chunks=[],
        settings=settings_for("index_capture"),
    message:
        "{wildcards.subject}: checking and indexing the capture"
    shell:
        "python -m pipeline.stages.index_capture --capture {params.capture:q} {params.arguments:q} "
        "{params.inspected:q} {params.chunks:q} {params.settings:q} > {log:q} 2>&1"


# Where they are many: images of some chunks of frames, each decoded once. Complaints are left to the index.
use rule index_capture as inspect_images with:
    input:
        capture=lambda wildcards: capture_files(wildcards.subject),
    output:
        table="results/{subject}/inspected/{chunk}.parquet",
    log:
        "results/{subject}/logs/index_capture.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/index_capture.{chunk}.tsv"
    resources:
        mem_mb=memory_for("index_capture", size_of_share),
        runtime=minutes_for("index_capture", size_of_share),
    params:
        arguments=arguments_for(
            "index_capture",
            index=lambda wildcards: job(wildcards).path("inspected"),
            detected_keypoints=lambda wildcards: [],
            detected_masks=lambda wildcards: [],
        ),
        inspected=[],
        chunks=lambda wildcards: [*chunk_words(job(wildcards)), "--chunk-size", job(wildcards).settings.chunk_frames],
    message:
        "{wildcards.subject}: checking images, chunk {wildcards.chunk}"


rule book_patterns:
    input:
        stored=stored_capture,
        capture="results/{subject}/index/capture.json",
        frames="results/{subject}/index/frames.parquet",
        patterns="results/{subject}/index/patterns.parquet",
        images="results/{subject}/index/images.parquet",
        lights="results/{subject}/calibration/lights.parquet",
        cameras="results/{subject}/calibration/cameras.json",
    output:
        patterns="results/{subject}/patterns.parquet",
        frames="results/{subject}/frames.parquet",
        sync="results/{subject}/sync.json",
        verdicts="results/{subject}/verdicts_patterns.csv",
        picture=report(
            "results/{subject}/sync.png", caption="../report/sync.rst", category="Inputs", subcategory="{subject}"
        ),
    log:
        "results/{subject}/logs/book_patterns.log",
    benchmark:
        "results/{subject}/benchmarks/book_patterns.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("book_patterns")
    resources:
        mem_mb=memory_for("book_patterns"),
        runtime=minutes_for("book_patterns"),
    params:
        code=code_for("book_patterns"),
        capture=capture_folder,
        arguments=arguments_for("book_patterns"),
        settings=settings_for("book_patterns"),
    message:
        "{wildcards.subject}: booking light patterns and splits, checking that log and images are in step"
    shell:
        "python -m pipeline.stages.book_patterns --capture {params.capture:q} {params.arguments:q} "
        "{params.settings:q} > {log:q} 2>&1"
