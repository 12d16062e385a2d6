# Nothing needs them; ask for the page, or the comparison, by name.
rule write_report:
    input:
        index="results/{subject}/index/capture.json",
        verdicts=expand(
            "results/{{subject}}/calibration/verdicts_{part}.csv",
            part=("cameras", "lights", "color"),
        ),
        sync=multiext("results/{subject}/sync", ".json", ".png"),
        frames="results/{subject}/frames.parquet",
        judged_images="results/{subject}/index/verdicts_images.csv",
        judged_patterns="results/{subject}/verdicts_patterns.csv",
        judged_tracking=each_chunk("tracking/verdicts_{chunk}.csv"),
        tracking=each_chunk("tracking/{chunk}.parquet"),
        atlas="results/{subject}/atlas.png",
        effects="results/{subject}/effects.json",
        metrics="results/{subject}/metrics.csv",
        per_image="results/{subject}/metrics_per_image.parquet",
        ablations="results/{subject}/ablations.csv",
        times="results/{subject}/avatar_times.csv",
        images=lambda wildcards: job(wildcards).score_pictures(),
    output:
        report(
            "results/{subject}/report/index.html",
            caption="../report/report.rst",
            category="Reports",
            subcategory="{subject}",
        ),
    log:
        "results/{subject}/logs/write_report.log",
    benchmark:
        "results/{subject}/benchmarks/write_report.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("write_report")
    resources:
        mem_mb=memory_for("write_report"),
        runtime=minutes_for("write_report"),
    params:
        code=code_for("write_report"),
        arguments=arguments_for(
            "write_report",
            subject_settings=lambda wildcards: subject_changes(job(wildcards).settings),
            requests=lambda wildcards: request_words(job(wildcards)),
        ),
        # What else is there is shown. No inputs: they would be made, or made anew.
        optional=lambda wildcards: job(wildcards).optional_digests(),
        settings=settings_for("write_report"),
    message:
        "{wildcards.subject}: writing the report"
    shell:
        "python -m pipeline.stages.write_report {params.arguments:q} {params.settings:q} > {log:q} 2>&1"


rule compare_subjects:
    input:
        compared_scores(project),
    output:
        table=report(
            "results/comparison.csv",
            caption="../report/comparison.rst",
            category="Comparison",
        ),
        page="results/comparison/index.html",
    log:
        "results/comparison/compare_subjects.log",
    benchmark:
        "results/comparison/compare_subjects.tsv"
    conda:
        "../../envs/cpu.yaml"
    threads: threads_for("compare_subjects")
    resources:
        mem_mb=memory_for("compare_subjects"),
        runtime=minutes_for("compare_subjects"),
    params:
        code=code_for("compare_subjects"),
        arguments=arguments_for(
            "compare_subjects",
            score_tables=lambda wildcards: compared_scores(project),
            project_results=lambda wildcards: RESULTS,
        ),
        settings=flags(project.settings.compare_subjects),
    message:
        "comparing avatars over subjects"
    shell:
        "python -m pipeline.stages.compare_subjects {params.arguments:q} {params.settings:q} > {log:q} 2>&1"
