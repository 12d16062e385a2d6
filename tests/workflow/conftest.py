"""Copies of the project, and Snakemake to run in them."""

from __future__ import annotations

import pytest

from tests.support.workflow.project_copy import ProjectCopy
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
