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
}


rule evaluate_avatar:
    input:
        index=ancient("results/{subject}/index/capture.json"),
        atlas="results/{subject}/atlas.safetensors",
        effects="results/{subject}/effects.json",
        test=shards_of("test"),
        frames=frame_shards,
        avatars=avatars_of("avatar.safetensors"),
        configs=avatars_of("config.json"),
    output:
        **SCORES,
        images=directory("results/{subject}/images"),
    log:
        "results/{subject}/logs/evaluate_avatar.log",
    benchmark:
        "results/{subject}/benchmarks/evaluate_avatar.tsv"
    wildcard_constraints:
        subject=subjects_that(lambda settings: settings.evaluate_avatar.pictures),
    conda:
        "../../envs/cpu.yaml"
    threads: 16
    resources:
        mem_mb=8000,
    params:
        code=code_of("evaluate_avatar"),
        shards=lambda wildcards: f"results/{wildcards.subject}/shards",
        frames=frame_folders,
        avatars=lambda wildcards, input: [os.path.dirname(path) for path in input.avatars],
        out=subpath(output.metrics, parent=True),
        settings=settings_of("evaluate_avatar"),
    message:
        "{wildcards.subject}: scoring avatars on held-out images"
    shell:
        "python -m pipeline.stages.evaluate_avatar --subject {wildcards.subject:q} --atlas {input.atlas:q} "
        "--shards {params.shards:q} --frames {params.frames:q} --effects {input.effects:q} --avatars {params.avatars:q} "
        "--out {params.out:q} {params.settings:q} > {log:q} 2>&1"


# What is an output has to be there: without pictures their folder is none.
use rule evaluate_avatar as evaluate_avatar_without_pictures with:
    output:
        **SCORES,
    wildcard_constraints:
        subject=subjects_that(lambda settings: not settings.evaluate_avatar.pictures),
