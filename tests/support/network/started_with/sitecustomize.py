"""Python imports this at its start where the folder is on its path: the hook of `tests.support.network.guard`."""

import importlib.util
import sys
from pathlib import Path

_spec = importlib.util.spec_from_file_location("network_guard", Path(__file__).parents[1] / "guard.py")
_guard = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_guard)
sys.addaudithook(_guard.hook)
