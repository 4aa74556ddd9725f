# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Prints the package's lines and public names, and fails where they have grown.

The limits are lowered whenever that is possible, and raised only with a reason in the same commit.
Example: python scripts/check_size.py
"""

import ast
import sys
from pathlib import Path

LINES, NAMES = 44111, 855  # what the package may have
PACKAGE = Path(__file__).parents[1] / "vgps_ros"


def count() -> tuple[int, int]:
    """Returns the lines of the package's Python files, and the public names at their top levels."""
    lines, names = 0, 0
    for file in PACKAGE.rglob("*.py"):
        text = file.read_text()
        lines += len(text.splitlines())
        for node in ast.parse(text).body:
            is_named = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
            names += is_named and not node.name.startswith("_")
    return lines, names


if __name__ == "__main__":
    lines, names = count()
    print(f"The package has {lines} lines (at most {LINES}), {names} public names ({NAMES}).")
    if lines > LINES or names > NAMES:
        sys.exit(
            "It has grown: remove as much, or raise the limit in scripts/check_size.py and give "
            "the reason in the commit."
        )
