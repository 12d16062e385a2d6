# `make results/<subject>/metrics.csv` makes that file; so with any other file or rule of the Snakefile.
# The environment, .venv, is set up on first use and again when pyproject.toml or a lock of exact versions changes.
CORES ?= 2
PYTHON ?= python3
# More options for snakemake, e.g. FLAGS='--config captures=/data/captures' or FLAGS='--configfile config/presets/draft.yaml'
FLAGS ?=
# The first of these that pip can install is the environment: with torch's CPU build where pip is told of one, otherwise
# with the registry's torch and CUDA's libraries. For a GPU, without a .venv: make LOCKS=envs/lock-cuda.txt TARGET
LOCKS ?= envs/lock.txt envs/lock-cuda.txt

BIN := .venv/bin
READY := .venv/.ready
# Waiting threads sleep, and small matrices stay on one thread: spinning slows everything else many times. Memory that
# was given back is kept for the next array: fetching it from the system anew costs as much as filling it.
QUIET := OMP_WAIT_POLICY=passive OPENBLAS_NUM_THREADS=1 \
    MALLOC_MMAP_THRESHOLD_=33554432 MALLOC_TRIM_THRESHOLD_=1073741824

MAKEFLAGS += --no-builtin-rules
.SUFFIXES:
.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help test slurm slurm-test storage-test left evidence hard-cases chaos mutants verdicts audit scaling growth effects time lint docs detect schema curves presets lock viewer FORCE

help:
	@echo 'make results/SUBJECT/metrics.csv   run the workflow for a subject, e.g. subjectA'
	@echo 'make test                          run all tests'
	@echo 'make left                          jobs that a run has left, and how long: TARGET=results/SUBJECT/metrics.csv'
	@echo 'make slurm                         install what hands jobs to Slurm; slurm-test: also test it on a cluster here'
	@echo 'make storage-test                  test the workflow with files in object storage, of a local S3 server'
	@echo 'make hard-cases                    print the table of hard cases; also in results/hard_cases.csv'
	@echo 'make chaos                         attack stages and workflow, into results/chaos; PARTS="captures settings"'
	@echo 'make mutants                       plant bugs and count those that tests see, into results/mutants; LAYERS="sync"'
	@echo 'make verdicts                      false alarms and misses of every verdict, into results/verdicts'
	@echo 'make audit                         look up known vulnerabilities of the locked packages'
	@echo 'make scaling                       measure how time and memory grow with sizes, into results/scaling'
	@echo 'make effects                       planned effects against all on, into results/effects_comparison.csv'
	@echo 'make time                          measure where the time goes, and write that page; TIMED=results/SUBJECT ...'
	@echo 'make evidence                      measure irradiance, scaling, time, hard cases and effects again, into the docs'
	@echo 'make lint                          check style of code and workflow'
	@echo 'make docs                          build the documentation into build/docs'
	@echo 'make detect                        install what finds keypoints and masks in photographs, into .venv-detect'
	@echo 'make schema                        write what is generated: config.yaml, its schema, pages of settings and commands'
	@echo 'make curves                        measure what accuracy costs on some subjects, for presets and budgets'
	@echo 'make presets                       write the presets draft, standard and reference from these curves'
	@echo 'make viewer                        build the page of results/SUBJECT/viewer from viewer/; needs node'
	@echo 'make lock                          write exact versions of the ranges in pyproject.toml, envs/lock*.txt'
	@echo 'make TARGET                        snakemake --cores $(CORES) TARGET'

# Files of tests side by side, the longest first; each on one thread, or they wait for each other's. Three more processes
# than cores: many tests wait for what they have started. Bytecode is kept whatever else is asked for: without, each
# process compiles all tests anew, 15 s of a processor.
test: $(READY)
	$(QUIET) OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= \
	    $(BIN)/python -m pytest -q -n $$(($(CORES) + 3)) --dist loadfile --no-loadscope-reorder

slurm: $(READY)
	$(INSTALL) --no-build-isolation --editable '.[slurm]'

# Twenty minutes, of clusters of two or three nodes on this machine; needs Debian's munge, slurmctld, slurmd and slurm-client.
slurm-test: slurm
	$(QUIET) $(BIN)/python -m pytest -q -rs -m slurm -o faulthandler_timeout=0 tests/workflow/test_slurm.py \
	    tests/workflow/test_slurm_stopping.py tests/workflow/test_slurm_nodes.py

# Four minutes.
storage-test: $(READY)
	$(INSTALL) --no-build-isolation --editable '.[storage]'
	$(QUIET) $(BIN)/python -m pytest -q -rs -m storage tests/workflow/test_object_storage.py

# TARGET is what the run is to make; FLAGS="--cores 16" for more processors.
left: $(READY)
	$(QUIET) $(BIN)/python -m pipeline.workflow.time_left '$(TARGET)' $(FLAGS)

hard-cases: $(READY)
	$(QUIET) OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q -n $(CORES) --dist loadfile --no-loadscope-reorder \
	    tests/hard_cases --hard-cases results/hard_cases.csv

# Kills, bad captures, settings and surroundings: PARTS alone, or all. What was interrupted goes on; a table of what an
# older code did is to be deleted first.
PARTS ?= captures settings kills surroundings twice
chaos: $(READY)
	$(QUIET) $(BIN)/python -m tests.chaos --parts $(PARTS) --out results/chaos

# Bugs of LAYERS alone, or all. What was interrupted goes on; what has changed since, or whose tests have, is judged anew.
LAYERS ?=
mutants: $(READY)
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m tests.mutants $(if $(LAYERS),--layers $(LAYERS)) --out results/mutants

verdicts: $(READY)
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_verdicts --out results/verdicts
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_verdict_sizes --out results/verdicts

# pip-audit has an environment of its own: it only reads the locks.
audit:
	test -x .venv-audit/bin/python || $(PYTHON) -m venv .venv-audit
	.venv-audit/bin/python -m pip install --quiet 'pip-audit>=2.9,<3'
	.venv-audit/bin/python .ci/audit_locks.py envs/lock.txt envs/lock-cuda.txt

# On one thread: more would count what they wait for.
ONE_THREAD := OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1

scaling: $(READY)
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_scaling --out results/scaling

# As it was called before.
growth: scaling

# Two hours and a half of two processors; what was interrupted goes on.
effects: $(READY)
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_effects --draws report report_2 report_3 --turned \
	    --jobs $(CORES) --out results/effects_comparison.csv

# Subjects whose runs and training are looked at: finished ones of these.
FINISHED = $(patsubst %/metrics.csv,%,$(wildcard $(patsubst %,results/%/metrics.csv,subjectA walker subjectB)))
TIMED ?= $(or $(FINISHED),results/subjectA)
time: $(READY)
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_limits --out results/time/limits.json
	$(foreach subject,$(TIMED),$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_training_parts \
	    --results $(subject) --out results/time/training_$(notdir $(subject)).json &&) true
	$(BIN)/python -m docs.generate.where_time_goes --results $(TIMED) --measured results/time

# What docs/evidence.md names, and the pages that it is written to; not what takes hours or other subjects: curves, attacks,
# planted bugs, verdicts, error budgets, comparisons.
evidence: results/subjectA/metrics.csv hard-cases effects scaling
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_irradiance_cost --results results/subjectA \
	    --page docs/irradiance.md
	$(QUIET) $(BIN)/python -m benchmarks.bench_irradiance --page docs/irradiance.md
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_single_draws --results results/subjectA \
	    --page docs/irradiance.md
	$(BIN)/python -m docs.generate.hard_case_table
	$(BIN)/python -m docs.generate.effects_table
	$(BIN)/python -m docs.generate.scaling_table
	$(MAKE) time

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint
	$(BIN)/python .ci/lint_docstrings.py

schema: $(READY)
	$(BIN)/python -m pipeline.config.schema
	$(BIN)/python -m pipeline.capture.schema.format_page
	$(BIN)/python -m docs.generate

# The documentation's tools have an environment of their own: nothing else needs them.
DOCS_BIN := .venv-docs/bin
DOCS_READY := .venv-docs/.ready
docs: $(DOCS_READY)
	NO_MKDOCS_2_WARNING=1 $(DOCS_BIN)/python -m mkdocs build --strict

$(DOCS_READY): pyproject.toml
	test -x $(DOCS_BIN)/python || $(PYTHON) -m venv .venv-docs
	$(DOCS_BIN)/python -c 'import tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	    print(*project["optional-dependencies"]["docs"], sep="\n")' > .venv-docs/requirements.txt
	$(DOCS_BIN)/python -m pip install --requirement .venv-docs/requirements.txt
	touch '$@'

# The detector wants another NumPy than the stages, and has an environment of its own.
DETECT_READY := .venv-detect/.ready
detect: $(DETECT_READY)

$(DETECT_READY): envs/detect.yaml
	test -x .venv-detect/bin/python || $(PYTHON) -m venv .venv-detect
	sed -n 's/^ *- "\(.*\)"$$/\1/p' envs/detect.yaml > .venv-detect/requirements.txt
	.venv-detect/bin/python -m pip install --requirement .venv-detect/requirements.txt
	touch '$@'

# Subjects whose curves are measured, hours for each; those of others that were kept before stay.
CURVES_OF ?= results/subjectA results/subjectB results/subjectC
curves: $(READY)
	$(QUIET) $(BIN)/snakemake --cores $(CORES) $(addsuffix /metrics.csv,$(CURVES_OF))
	$(foreach results,$(CURVES_OF),$(QUIET) $(ONE_THREAD) $(BIN)/snakemake --cores 1 --forcerun measure_cost -- \
	    $(results)/accuracy_cost.csv && $(BIN)/python -m pipeline.dials.curves --results $(results) &&) true

presets: $(READY)
	$(BIN)/python -m pipeline.budget.presets

# New versions where the ranges ask for them; with UPGRADE=--upgrade the newest everywhere. uv has an environment of its
# own: it only writes the locks, pip installs them.
lock:
	test -x .venv-lock/bin/python || $(PYTHON) -m venv .venv-lock
	.venv-lock/bin/python -m pip install --quiet 'uv>=0.13'
	.venv-lock/bin/python .ci/lock_versions.py $(UPGRADE)

INSTALL := $(BIN)/python -m pip install
$(READY): pyproject.toml $(LOCKS)
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(foreach lock,$(LOCKS),$(INSTALL) --require-hashes -r $(lock) ||) \
	    { echo 'pip can install none of $(LOCKS)' >&2; false; }
	$(INSTALL) --no-deps --no-build-isolation --editable .
	$(BIN)/python -m pipeline.avatar.training.compile_kernels
	touch '$@'

# The viewer's page without an avatar, which the package ships; only a change to viewer/ needs node and npm.
viewer:
	cd viewer && npm ci && npm run build

# Everything else is Snakemake's to make, and to decide whether it is up to date.
Makefile pyproject.toml envs/detect.yaml $(LOCKS): ;

# The folder of a report, and that of a viewer, is its page.
results/%/report: $(READY) FORCE
	$(BIN)/snakemake --cores $(CORES) $(FLAGS) -- '$@/index.html'

results/%/viewer: $(READY) FORCE
	$(BIN)/snakemake --cores $(CORES) $(FLAGS) -- '$@/index.html'

%: $(READY) FORCE
	$(BIN)/snakemake --cores $(CORES) $(FLAGS) -- '$@'

FORCE: ;
