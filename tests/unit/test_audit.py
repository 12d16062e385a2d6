"""What the audit of the locks makes of pip-audit's reports."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

LOCK = Path("envs/lock.txt")
SOUND = {"name": "numpy", "version": "2.4.0", "vulns": []}
OLD = {
    "name": "pillow", "version": "8.0.0",
    "vulns": [{"id": "PYSEC-1", "fix_versions": ["8.1.1"]}, {"id": "PYSEC-2", "fix_versions": []}],
}  # fmt: skip
UNKNOWN = {"name": "torch", "skip_reason": "not found on PyPI"}


@pytest.fixture(scope="module")
def audit_locks(repo_root):
    spec = importlib.util.spec_from_file_location("audit_locks", repo_root / ".ci/audit_locks.py")
    sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_advisories_fail_and_say_where_they_are_mended(audit_locks):
    found = audit_locks.judge(LOCK, {"dependencies": [SOUND, OLD, UNKNOWN]}, "")
    assert found.code == 1
    assert found.lines == [
        "envs/lock.txt: 2 packages looked up, 1 that the database does not know",
        "  pillow 8.0.0: PYSEC-1, mended in 8.1.1",
        "  pillow 8.0.0: PYSEC-2, mended in no version yet",
    ]


def test_packages_without_advisories_pass(audit_locks):
    assert audit_locks.judge(LOCK, {"dependencies": [SOUND]}, "").code == 0


def test_database_that_knows_nothing_is_no_clean_audit(audit_locks):
    found = audit_locks.judge(LOCK, {"dependencies": [UNKNOWN, UNKNOWN]}, "No known vulnerabilities found")
    assert found.code == 0
    assert found.lines == ["envs/lock.txt: audit skipped: the database of advisories knows none of its 2 packages"]


def test_database_that_does_not_answer_is_named_and_other_failures_fail(audit_locks):
    away = audit_locks.judge(LOCK, None, "ERROR:pip_audit._cli:Could not connect to PyPI's vulnerability feed\n")
    assert away.code == 0 and "audit skipped" in away.lines[0] and "Could not connect" in away.lines[0]
    broken = audit_locks.judge(LOCK, None, "ERROR: requirements file has no hashes\n")
    assert broken.code == 2 and "no hashes" in broken.lines[0]
