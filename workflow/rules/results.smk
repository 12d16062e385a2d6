# What evaluate_avatar writes with and without pictures.
SCORES = {
    "metrics": report(
        "results/{subject}/metrics.csv",
        caption="../report/metrics.rst",
        category="Scores",
        subcategory="{subject}",
    ),
    "per_image": "results/{subject}/metrics_per_image.parquet",
    "ablations": report(
        "results/{subject}/ablations.csv",
        caption="../report/ablations.rst",
        category="Scores",
        subcategory="{subject}",
    ),
    # Measured: the only one of these files that differs from run to run.
    "times": "results/{subject}/avatar_times.csv",
}


rule evaluate_avatar:
    input:
        index=ancient("results/{subject}/index/capture.json"),
        # Images of other sizes are other shards.
        sizes=ancient("results/{subject}/index/cameras.parquet"),
        eyes=ancient("results/{subject}/index/eyes.parquet"),
        atlas="results/{subject}/atlas.safetensors",
        effects="results/{subject}/effects.json",
        validation=lambda wildcards: job(wildcards).shards("shards/validation"),
        test=lambda wildcards: job(wildcards).shards("shards/test"),
        frames=lambda wildcards: job(wildcards).frame_shards(),
        scores=lambda wildcards: score_tables(job(wildcards)),
        avatars=lambda wildcards: job(wildcards).avatars("avatar.safetensors"),
        configs=lambda wildcards: job(wildcards).avatars("config.json"),
        # Times alone are read from them: a training that ends in the same avatar is not scored again.
        logs=lambda wildcards: ancient(job(wildcards).avatars("log.parquet")),
    output:
        **SCORES,
        images=directory("results/{subject}/images"),
    log:
        "results/{subject}/logs/evaluate_avatar.log",
    benchmark:
        "results/{subject}/benchmarks/evaluate_avatar.tsv"
    wildcard_constraints:
        subject=subject_pattern(project, lambda settings: settings.evaluate_avatar.pictures),
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("evaluate_avatar")
    resources:
        mem_mb=memory_for("evaluate_avatar", size_joining(score_tables)),
        runtime=minutes_for("evaluate_avatar", size_joining(score_tables)),
    params:
        code=code_for("evaluate_avatar"),
        arguments=arguments_for(
            "evaluate_avatar",
            frame_shards=lambda wildcards: job(wildcards).frame_folders(),
            avatar=lambda wildcards: job(wildcards).avatars(),
        ),
        parts=lambda wildcards: ["--scores", job(wildcards).path("scores")] if score_tables(job(wildcards)) else [],
        settings=settings_for("evaluate_avatar"),
    message:
        "{wildcards.subject}: scoring avatars on held-out images"
    shell:
        "python -m pipeline.stages.evaluate_avatar {params.arguments:q} {params.parts:q} "
        "{params.settings:q} > {log:q} 2>&1"


# What is an output has to be there: without pictures their folder is none.
use rule evaluate_avatar as evaluate_avatar_without_pictures with:
    output:
        **SCORES,
    wildcard_constraints:
        subject=subject_pattern(project, lambda settings: not settings.evaluate_avatar.pictures),


# Where images are many: those of some chunks of frames, for one avatar.
use rule evaluate_avatar as score_images with:
    input:
        index=ancient("results/{subject}/index/capture.json"),
        # Images of other sizes are other shards.
        sizes=ancient("results/{subject}/index/cameras.parquet"),
        eyes=ancient("results/{subject}/index/eyes.parquet"),
        atlas="results/{subject}/atlas.safetensors",
        effects="results/{subject}/effects.json",
        shards=lambda wildcards: scored_files(job(wildcards)),
        avatars=lambda wildcards: job(wildcards).avatars("avatar.safetensors"),
        configs=lambda wildcards: job(wildcards).avatars("config.json"),
    output:
        table="results/{subject}/scores/{variant}/{chunk}.parquet",
    log:
        "results/{subject}/logs/evaluate_avatar.{variant}.{chunk}.log",
    benchmark:
        "results/{subject}/benchmarks/evaluate_avatar.{variant}.{chunk}.tsv"
    wildcard_constraints:
        subject="[A-Za-z0-9_][A-Za-z0-9_-]*",
    resources:
        mem_mb=memory_for("evaluate_avatar", size_of_share),
        runtime=minutes_for("evaluate_avatar", size_of_share),
    params:
        arguments=arguments_for(
            "evaluate_avatar",
            frame_shards=lambda wildcards: job(wildcards).frame_folders(),
            avatar=lambda wildcards: job(wildcards).avatars(),
            scores=lambda wildcards: job(wildcards).path("scores", wildcards.variant),
        ),
        parts=lambda wildcards: chunk_words(job(wildcards)),
        settings=lambda wildcards: scoring_flags(job(wildcards)),
    message:
        "{wildcards.subject}: scoring avatar {wildcards.variant}, chunk {wildcards.chunk}"
