"""What jobs take, by a table made by hand."""

from __future__ import annotations

import pytest

from pipeline.budget import job_costs
from tests.support.results.curve_files import STAGE_SECONDS, write_job_costs


@pytest.fixture
def costs(tmp_path, monkeypatch):
    """What jobs take; a function that writes it anew."""

    def write(**stages):
        path = write_job_costs(tmp_path / f"job_costs_{len(stages)}.csv", {**STAGE_SECONDS, **stages})
        monkeypatch.setattr(job_costs, "TABLE", path)

    write()
    return write
