# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Pages of the documentation site that are made from the code, as a hook of MkDocs.

The interfaces come from the definitions in msg_schemas, the parameters from the nodes' own --help,
the library from docstrings, and the examples from their files, so that none of them can grow old.
"""

import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
LIBRARY = (
    "core",
    "core/ddp",
    "core/sampling",
    "simulation",
    "tasks",
    "search",
    "safety",
    "storage",
)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Adds the library's pages to the navigation."""
    assert config.nav
    config.nav.insert(-1, {"Library": ["api/index.md", *(f"api/{name(f)}.md" for f in LIBRARY)]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that are made from the code."""
    pages = {
        "interfaces.md": interfaces(),
        "parameters.md": parameters(),
        "examples.md": examples(),
        "api/index.md": library_index(),
        **{f"api/{name(folder)}.md": library(folder) for folder in LIBRARY},
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def interfaces() -> str:
    """Returns the page of all messages, services and actions."""
    lines = [
        "# Interfaces",
        "",
        "The package `vgps_msgs` defines these types. The graph speaks standard ones beside them: "
        "`sensor_msgs`, `nav_msgs`, `tf2_msgs`, `std_msgs`, and `simulation_interfaces`; see "
        "[the graph of nodes](graph.md).",
    ]
    for kind, title in (("msg", "Messages"), ("srv", "Services"), ("action", "Actions")):
        lines += ["", f"## {title}"]
        for file in sorted((ROOT / "msg_schemas" / kind).iterdir()):
            lines += ["", f"### {file.stem}", "", "```", file.read_text().strip(), "```"]
    return "\n".join(lines)


def parameters() -> str:
    """Returns the page of the parameters of each node, as its --help prints them."""
    names = sorted(p.stem for p in (ROOT / "vgps_ros" / "nodes").glob("[a-z]*.py"))

    def help_of(node: str) -> str:
        return subprocess.run(
            ["vgps", "node", node, "--help"],
            env=os.environ | {"COLUMNS": "110", "NO_COLOR": "1"},
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    with ThreadPoolExecutor(2) as pool:
        texts = list(pool.map(help_of, names))
    lines = ["# Parameters", "", "This is what `vgps node NAME --help` prints."]
    for node, text in zip(names, texts, strict=True):
        lines += ["", f"## {node}", "", "```", text.strip(), "```"]
    return "\n".join(lines)


def examples() -> str:
    """Returns the page of the numbered examples, whole."""
    lines = [
        "# Examples",
        "",
        "Each example is a file of `examples/` and is run by a test. "
        "The first one is also a notebook, `examples/01_linear_system.ipynb`.",
    ]
    for file in sorted((ROOT / "examples").glob("*.py")):
        lines += ["", f"## {file.name}", "", "```python", file.read_text().strip(), "```"]
    return "\n".join(lines)


def library_index() -> str:
    """Returns the first page of the library's reference."""
    lines = [
        "# Library",
        "",
        "The rows go from the paper's mathematics up to the search; each imports those above it "
        "alone. None of them imports ROS.",
        "",
        "| package | about |",
        "| --- | --- |",
    ]
    for folder in LIBRARY:
        about = first_line(ROOT / "vgps_ros" / folder / "__init__.py")
        lines.append(f"| [`vgps_ros.{name(folder)}`]({name(folder)}.md) | {about} |")
    return "\n".join(lines)


def library(folder: str) -> str:
    """Returns the reference of one package: all its modules."""
    modules = sorted((ROOT / "vgps_ros" / folder).glob("[a-z]*.py"))
    lines = [f"# vgps_ros.{name(folder)}"]
    for module in modules:
        lines += ["", f"::: vgps_ros.{name(folder)}.{module.stem}"]
    return "\n".join(lines)


def name(folder: str) -> str:
    """Returns the dotted name of a folder of the package."""
    return folder.replace("/", ".")


def first_line(file: Path) -> str:
    """Returns the first line of a module's docstring."""
    text = file.read_text().split('"""')
    return text[1].splitlines()[0] if len(text) > 1 else ""
