"""A run whose tests are skipped passes if the machine is the reason, and fails if a package is."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.support.named_skips import is_known

CONFTEST = """
from tests.support.named_skips import NamedSkips

def pytest_configure(config):
    config.pluginmanager.register(NamedSkips())
"""
TESTS = """
import pytest

def test_that_passes(): pass
def test_in_a_browser(): pytest.skip("no Chromium: apt-get install chromium")
def test_that_is_expected_to_fail(): pytest.xfail("not yet")
"""


@pytest.mark.parametrize("reason", ["no Chromium: apt-get install chromium", "needs captures/subjectA: make it first"])
def test_what_a_machine_may_lack_is_a_reason(reason):
    assert is_known(reason) and is_known(f"Skipped: {reason}")


@pytest.mark.parametrize("reason", ["could not import 'mitsuba': No module named 'mitsuba'", "flaky", ""])
def test_a_package_or_a_mood_is_none(reason):
    assert not is_known(reason) and not is_known(f"Skipped: {reason}")


@pytest.mark.parametrize(("package", "code"), [("sys", 0), ("a_package_that_is_not_there", 1)])
def test_run_fails_if_a_package_takes_its_tests_with_it(repo_root, tmp_path, package, code):
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_some.py").write_text(TESTS)
    (tmp_path / "test_others.py").write_text(f"import pytest\npytest.importorskip('{package}')\ndef test_it(): pass\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", "/dev/null", "--rootdir", tmp_path]
    done = subprocess.run([*command, tmp_path], cwd=repo_root, capture_output=True, text=True)
    assert done.returncode == code, done.stdout + done.stderr
    assert (f"could not import '{package}'" in done.stdout) == bool(code)
