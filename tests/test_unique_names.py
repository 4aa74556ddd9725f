# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""A public name of the package means one thing."""

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "vgps_ros"
IN_EACH_PROGRAM = {"main", "run", "add_arguments"}


def test_no_public_function_or_class_is_defined_twice():
    defined = defaultdict(list)
    for path in PACKAGE.rglob("*.py"):
        for item in ast.parse(path.read_text()).body:
            if isinstance(item, ast.FunctionDef | ast.ClassDef) and not item.name.startswith("_"):
                defined[item.name].append(str(path.relative_to(PACKAGE)))
    twice = {
        name: sorted(places)
        for name, places in defined.items()
        if len(places) > 1 and name not in IN_EACH_PROGRAM
    }
    assert twice == {}
