# `make results/<subject>/metrics.csv` makes that file; so with any other file or rule of the Snakefile.
# The environment, .venv, is set up on first use and again when pyproject.toml changes.
CORES ?= 2
PYTHON ?= python3
# More options for snakemake, e.g. FLAGS='--config captures=/data/captures' or FLAGS='--configfile config/presets/draft.yaml'
FLAGS ?=

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
.PHONY: help test hard-cases scaling growth effects lint schema curves presets FORCE

help:
	@echo 'make results/SUBJECT/metrics.csv   run the workflow for a subject, e.g. subjectA'
	@echo 'make test                          run all tests'
	@echo 'make hard-cases                    print the table of hard cases; also in results/hard_cases.csv'
	@echo 'make scaling                       measure how time and memory grow with sizes, into results/scaling'
	@echo 'make effects                       planned effects against all on, into results/effects_comparison.csv'
	@echo 'make lint                          check style of code and workflow'
	@echo 'make schema                        write config/config.yaml, its schema and capture_format.md from the models'
	@echo 'make curves                        measure what accuracy costs on subjectA, for presets and budgets'
	@echo 'make presets                       write the presets draft, standard and reference from these curves'
	@echo 'make TARGET                        snakemake --cores $(CORES) TARGET'

test: $(READY)
	$(QUIET) $(BIN)/python -m pytest -q

hard-cases: $(READY)
	$(QUIET) $(BIN)/python -m pytest -q tests/hard_cases --hard-cases results/hard_cases.csv

# On one thread: more would count what they wait for.
ONE_THREAD := OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1

scaling: $(READY)
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_scaling --out results/scaling

# As it was called before.
growth: scaling

effects: $(READY)
	$(QUIET) $(ONE_THREAD) $(BIN)/python -m benchmarks.bench_effects --out results/effects_comparison.csv

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint

schema: $(READY)
	$(BIN)/python -m pipeline.config.schema
	$(BIN)/python -m pipeline.capture.schema.format_page

CURVES_OF := results/subjectA
curves: $(READY)
	$(BIN)/snakemake --cores $(CORES) $(CURVES_OF)/metrics.csv
	$(BIN)/snakemake --cores 1 --forcerun measure_cost -- $(CURVES_OF)/accuracy_cost.csv
	$(BIN)/python -m pipeline.dials.curves --results $(CURVES_OF)

presets: $(READY)
	$(BIN)/python -m pipeline.budget.presets

$(READY): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --editable '.[dev]'
	touch '$@'

# Everything else is Snakemake's to make, and to decide whether it is up to date.
Makefile pyproject.toml: ;

# A report's folder is its page.
results/%/report: $(READY) FORCE
	$(BIN)/snakemake --cores $(CORES) $(FLAGS) -- '$@/index.html'

%: $(READY) FORCE
	$(BIN)/snakemake --cores $(CORES) $(FLAGS) -- '$@'

FORCE: ;
