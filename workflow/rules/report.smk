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
        tracking=of_chunks("results/{subject}/tracking/{chunk}.parquet"),
        atlas="results/{subject}/atlas.png",
        effects="results/{subject}/effects.json",
        metrics="results/{subject}/metrics.csv",
        per_image="results/{subject}/metrics_per_image.parquet",
        ablations="results/{subject}/ablations.csv",
        images=pictures_of_scores,
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
    threads: 1
    resources:
        mem_mb=2000,
    params:
        code=code_of("write_report"),
        results=subpath(input.metrics, parent=True),
        project_results=subpath(input.metrics, ancestor=2),
        # What else is there is shown. No inputs: they would be made, or made anew.
        optional=digests_of_optional,
        subject_settings=lambda wildcards: subject_changes(project.subject(wildcards.subject)),
        settings=settings_of("write_report"),
    message:
        "{wildcards.subject}: writing the report"
    shell:
        "python -m pipeline.stages.write_report --results {params.results:q} --project-results {params.project_results:q} "
        "--out {output:q} --subject-settings {params.subject_settings:q} {params.settings:q} > {log:q} 2>&1"


rule compare_subjects:
    input:
        expand(
            "results/{subject}/metrics_per_image.parquet",
            subject=project.settings.compare_subjects.subjects or subject_names(project),
        ),
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
    threads: 1
    resources:
        mem_mb=2000,
    params:
        code=code_of("compare_subjects"),
        out=subpath(output.table, parent=True),
        settings=flags(project.settings.compare_subjects),
    message:
        "comparing avatars over subjects"
    shell:
        "python -m pipeline.stages.compare_subjects --scores {input:q} --out {params.out:q} {params.settings:q} > {log:q} 2>&1"
