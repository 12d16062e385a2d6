"""Copies of the project, and Snakemake to run in them."""

from __future__ import annotations

import pytest

from tests.support.workflow.project_copy import ProjectCopy
from tests.support.workflow.slurm_cluster import lacking
from tests.support.workflow.snakemake_server import SnakemakeServer
from tests.support.workflow.stage_server import StageServer


@pytest.fixture(scope="session")
def snakemake_server():
    with SnakemakeServer() as server:
        yield server


@pytest.fixture(scope="session")
def stage_server():
    with StageServer() as server:
        yield server


@pytest.fixture(scope="session")
def copy_of_project(repo_root, snakemake_server):
    """A function: copies what the workflow needs to a folder."""
    return lambda folder: ProjectCopy.made(repo_root, folder, snakemake_server)


@pytest.fixture(scope="module")
def slurm(request):
    """Skips what was not asked for, and what cannot run here."""
    if "slurm" not in request.config.getoption("markexpr"):
        pytest.skip("takes minutes: make slurm-test")
    if (reason := lacking()) is not None:
        pytest.skip(reason)
