# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Compiled functions work with and without a place for their machine code."""

import re
from pathlib import Path

from vgps_ros.core import compilation
from vgps_ros.core.compilation import compile_at_first_call

SOURCE = "def double(x):\n    return x + x\n"


def defined_in(path):
    scope = {}
    exec(compile(SOURCE, path, "exec"), scope)
    return scope["double"]


def test_without_a_file_to_keep_it_beside_a_function_is_compiled_anew():
    double = compile_at_first_call(defined_in("<nowhere>"))
    assert double(2.5) == 5.0
    assert double.signatures


def test_machine_code_is_kept_between_processes(tmp_path):
    path = tmp_path / "source.py"
    path.write_text(SOURCE)
    first, second = (compile_at_first_call(defined_in(str(path))) for _ in range(2))
    assert first(2.5) == second(2.5) == 5.0
    assert sum(first.stats.cache_misses.values()) == 1
    assert sum(second.stats.cache_hits.values()) == 1


def test_machine_code_is_not_that_of_other_parts(tmp_path, monkeypatch):
    path = tmp_path / "source.py"
    path.write_text(SOURCE)
    assert compile_at_first_call(defined_in(str(path)))(2.5) == 5.0
    monkeypatch.setattr(compilation, "_stamp_of_parts", lambda: b"a part has been edited")
    second = compile_at_first_call(defined_in(str(path)))
    assert second(2.5) == 5.0
    assert not sum(second.stats.cache_hits.values())


def test_parts_that_several_files_share_stand_where_their_edits_are_seen():
    package = Path(compilation.__file__).parents[1]
    for file in package.rglob("*.py"):
        text = file.read_text()
        shared = {*re.findall(r"@compiled_part\ndef (\w+)", text)} - {*re.findall(r"\b_\w+", text)}
        is_known = file.name.startswith("compiled_") or file.name == "compilation.py"
        assert is_known or not shared, f"{file} has parts for others; its name must say compiled_"
