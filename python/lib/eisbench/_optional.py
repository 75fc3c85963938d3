"""Packages that only some functions need."""

from __future__ import annotations

import importlib
from typing import Any


def optional(module: str, install: str) -> Any:
    """A module of a package that may not be installed; ``install`` is the argument for pip."""
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        text = f"expected the package {package}: pip install {install}"
        raise ImportError(text) from None


def arrow() -> Any:
    """pyarrow, by which tables are read and written."""
    return optional("pyarrow", "'eisbench[jobs]'")


def parquet() -> Any:
    """The Parquet half of pyarrow."""
    return optional("pyarrow.parquet", "'eisbench[jobs]'")
