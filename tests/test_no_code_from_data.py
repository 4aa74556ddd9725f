# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""No data is ever run as code: no pickle, no eval, no shell, and torch files as weights only."""

import ast
from pathlib import Path

import pytest

import vgps_ros

FILES = sorted(Path(vgps_ros.__file__).parent.rglob("*.py"))

MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "marshal", "shelve"}
CALLS = {
    "eval", "exec", "compile", "__import__", "os.system", "os.popen", "subprocess.getoutput",
    "subprocess.getstatusoutput", "yaml.load", "yaml.full_load", "yaml.unsafe_load",
    "yaml.load_all", "yaml.unsafe_load_all", "joblib.load", "torch.jit.load",
}  # fmt: skip


def full_name(node: ast.expr) -> str:
    """`a.b.c` of an expression that is a dotted name; empty for any other."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        inner = full_name(node.value)
        return f"{inner}.{node.attr}" if inner else ""
    return ""


def aliases(tree: ast.AST) -> dict[str, str]:
    """What each imported name stands for."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update({n.asname: n.name for n in node.names if n.asname})
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.update({n.asname or n.name: f"{node.module}.{n.name}" for n in node.names})
    return found


def dangers(source: str) -> list[str]:
    """Every place of a source that could run data as code."""
    tree = ast.parse(source)
    known = aliases(tree)
    found = []
    for node in ast.walk(tree):
        modules = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [node.module or ""]
        found += [name for name in modules if name.partition(".")[0] in MODULES]
        if not isinstance(node, ast.Call):
            continue
        first, dot, rest = full_name(node.func).partition(".")
        name = known.get(first, first) + dot + rest
        name = name.replace("numpy.", "np.")
        options = {k.arg: getattr(k.value, "value", None) for k in node.keywords}
        if name in CALLS or options.get("shell"):
            found.append(name)
        if name == "np.load" and options.get("allow_pickle", False):
            found.append(name)
        if name == "torch.load" and options.get("weights_only") is not True:
            found.append(name)
    return found


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_no_module_runs_data_as_code(file):
    assert dangers(file.read_text()) == []


@pytest.mark.parametrize(
    "source",
    [
        "import pickle",
        "from pickle import loads",
        "eval('1')",
        "import os; os.system('ls')",
        "from os import system as s; s('ls')",
        "import subprocess; subprocess.run('ls', shell=True)",
        "import yaml; yaml.load('a')",
        "import numpy as np; np.load('a', allow_pickle=True)",
        "import numpy; numpy.load('a', allow_pickle=True)",
        "import torch; torch.load('a')",
        "import torch as t; t.load('a', weights_only=False)",
    ],
)
def test_the_check_finds_what_it_is_for(source):
    assert dangers(source)


@pytest.mark.parametrize(
    "source",
    ["import numpy as np; np.load('a')", "import torch; torch.load('a', weights_only=True)"],
)
def test_the_check_lets_pass_what_is_safe(source):
    assert not dangers(source)
