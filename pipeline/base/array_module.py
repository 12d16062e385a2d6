"""Functions of NumPy arrays and torch tensors alike, for modules without torch.

torch takes two seconds to import, and most stages start without it: whoever has a tensor has imported it.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np

Array = Any
"""A NumPy array or a torch tensor: `Float[Array, "n 3"]`, whose shape and kind of number are checked in both."""


def is_tensor(array: Array) -> bool:
    """Tell torch tensors from other arrays."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(array, torch.Tensor)


def array_module(array: Array) -> ModuleType:
    """`torch` for tensors, else `numpy`.

    Both have the functions that are called through it under the same names.
    """
    return sys.modules["torch"] if is_tensor(array) else np
