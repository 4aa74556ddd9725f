# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""What docs/reference/public_interface.md declares exists, and it is documented."""

import ast
import importlib
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

import vgps_ros
from vgps_ros.programs.__main__ import COMMANDS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reference" / "public_interface.md").read_text()
DECLARED = {
    module: re.findall(r"`(\w+)`", names)
    for module, names in re.findall(r"^\| `(vgps_ros[\w.]*)` \| (.*) \|$", PAGE, re.M)
}


def listed(title: str) -> list[str]:
    (names,) = re.findall(rf"^{title}: (.*?)\.$", PAGE, re.M | re.S)
    return re.findall(r"`([\w-]+)`", names)


def test_the_page_lists_all_commands_and_nodes():
    assert listed("Commands") == COMMANDS
    assert listed("Nodes") == vgps_ros.NODES


@pytest.mark.parametrize("module", DECLARED)
def test_each_declared_name_exists_and_is_documented(module):
    found = importlib.import_module(module)
    for name in DECLARED[module]:
        value = getattr(found, name)
        assert not callable(value) or value.__doc__


def test_examples_and_pages_use_declared_names_alone():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    blocks = [re.findall(r"^```python\n(.*?)^```", page.read_text(), re.M | re.S) for page in pages]
    code = [text for texts in blocks for text in texts]
    code += [path.read_text() for path in (ROOT / "examples").glob("*.py")]
    used = {
        (node.module, alias.name)
        for text in code
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and node.module.startswith("vgps_ros")
        for alias in node.names
    }
    assert len(used) > 15
    assert used <= {(module, name) for module, names in DECLARED.items() for name in names}


def test_all_files_name_the_same_version():
    versions = {
        ElementTree.parse(ROOT / folder / "package.xml").findtext("version")
        for folder in (".", "msg_schemas", "requirements/training")
    }
    (in_setup,) = re.findall(r'VERSION = "([\d.]+)"', (ROOT / "setup.py").read_text())
    assert versions == {in_setup} == {vgps_ros.__version__}
    assert f"## {in_setup} " in (ROOT / "CHANGELOG.md").read_text()
    heading = re.compile(rf"^{re.escape(in_setup)} \(\d{{4}}-\d\d-\d\d\)$", re.M)
    for folder in (ROOT, ROOT / "msg_schemas"):
        assert heading.search((folder / "CHANGELOG.rst").read_text())
    assert f"\nversion: {in_setup}\n" in (ROOT / "CITATION.cff").read_text()
