# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Pages of the documentation site that are made from other files, as a hook of MkDocs.

The first page is README.md. The interfaces come from the definitions in msg_schemas, commands and
parameters from what `--help` prints, the library from docstrings, the examples from their files.
Links of all pages are relative paths in the repository, as code hosts follow them; where one leads
to a file that the site shows in another form, it is turned into a link to that page.
"""

import os
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import vgps_ros
from vgps_ros.programs import bag
from vgps_ros.programs.__main__ import COMMANDS

ROOT = Path(__file__).parents[1]
LIBRARY = ("core", "core/ddp", "robot", "simulation", "safety", "policies", "tasks", "search")
# The page of the site that shows a file or a folder outside docs/.
SHOWN_AS = {
    "README.md": "index.md",
    "AGENTS.md": "project/agents.md",
    "CONTRIBUTING.md": "project/contributing.md",
    "CHANGELOG.md": "project/changelog.md",
    "QUALITY_DECLARATION.md": "project/quality_declaration.md",
    "SECURITY.md": "project/security.md",
    "examples": "reference/examples.md",
    "msg_schemas": "reference/interfaces.md",
    "vgps_ros": "reference/api/index.md",
    "vgps_ros/nodes": "reference/parameters.md",
    "vgps_ros/programs": "reference/commands.md",
}
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Adds the library's pages to the part of the navigation that is the reference."""
    assert config.nav
    (reference,) = (part["Reference"] for part in config.nav if "Reference" in part)
    pages = ["reference/api/index.md", *(f"reference/api/{name(f)}.md" for f in folders())]
    reference.append({"Library": pages})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that are made from other files."""
    pages = {
        page: with_links_of_the_site((ROOT / path).read_text(), path, page)
        for path, page in SHOWN_AS.items()
        if path.endswith(".md")
    }
    pages |= {
        "reference/interfaces.md": interfaces(),
        "reference/commands.md": commands(),
        "reference/parameters.md": parameters(),
        "reference/examples.md": examples(),
        "reference/api/index.md": library_index(),
        **{f"reference/api/{name(folder)}.md": library(folder) for folder in folders()},
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Turns the links of a page of docs/ into those of the site."""
    path = page.file.src_uri
    return with_links_of_the_site(markdown, f"docs/{path}", path)


def with_links_of_the_site(text: str, path: str, page: str) -> str:
    """Returns a text of the file `path` with the links that it needs as the site's `page`.

    A link to a file of the repository that the site does not show becomes plain text.
    """

    def link(found: re.Match[str]) -> str:
        picture, title, target, anchor = found.groups("")
        if "://" in target or target.startswith("mailto:"):
            return found[0]
        there = os.path.normpath(os.path.join(os.path.dirname(path), target))
        shown = there.removeprefix("docs/") if there.startswith("docs/") else SHOWN_AS.get(there)
        if shown is None:
            return title
        relative = os.path.relpath(shown, os.path.dirname(page) or ".")
        return f"{picture}[{title}]({relative}{anchor})"

    return LINK.sub(link, text)


def interfaces() -> str:
    """Returns the page of all messages, services and actions."""
    lines = [
        "# Messages, services and actions",
        "",
        "The package `vgps_msgs` defines these types. The graph speaks standard ones beside them: "
        "`sensor_msgs`, `nav_msgs`, `tf2_msgs`, `std_msgs`, and `simulation_interfaces`; see "
        "[topics and frames](graph.md).",
    ]
    for kind, title in (("msg", "Messages"), ("srv", "Services"), ("action", "Actions")):
        lines += ["", f"## {title}"]
        for file in sorted((ROOT / "msg_schemas" / kind).iterdir()):
            lines += ["", f"### {file.stem}", "", "```", file.read_text().strip(), "```"]
    return "\n".join(lines)


def commands() -> str:
    """Returns the page of what each command's --help prints."""
    lines = ["# Commands", "", "This is what `vgps NAME --help` prints."]
    names = [*COMMANDS, *(f"bag {action.__name__}" for action in bag.ACTIONS)]
    for name, text in helps(sorted(names), "vgps {}", 100).items():
        lines += ["", f"## {name}", "", "```text", text.strip(), "```"]
    return "\n".join(lines)


def parameters() -> str:
    """Returns the page of each node's parameters, from the tables that its --help prints."""
    lines = [
        "# Parameters of the nodes",
        "",
        "A parameter is given as `-p NAME:=VALUE` behind `--ros-args`, or in a file, as those in "
        "`config/`. `vgps node NAME --help` prints the same tables.",
    ]
    for name, text in helps(vgps_ros.NODES, "vgps node {}", 2000).items():
        about, heading, rows = re.split(r"^( +parameter .*)$", text, maxsplit=1, flags=re.M)
        columns = [match.start() for match in re.finditer(r"(?<=  )\S", heading)]
        lines += ["", f"## {name}", "", about.partition("\n\n")[2].strip(), ""]
        lines += ["| parameter | default | what it does (valid values) |", "| --- | --- | --- |"]
        for row in rows.splitlines()[2:]:
            if not row.startswith("  ") or not row.strip():  # what a library says
                continue
            edges = zip(columns, [*columns[1:], None], strict=True)
            parameter, default, meaning = (row[a:b].strip().replace("|", "\\|") for a, b in edges)
            lines.append(f"| `{parameter}` | {f'`{default}`' if default else ''} | {meaning} |")
    return "\n".join(lines)


def helps(names: list[str], command: str, width: int) -> dict[str, str]:
    """Returns what `--help` prints for each name of a command or node, from its usage on."""

    def help_of(name: str) -> str:
        printed = subprocess.run(
            [*command.format(name).split(), "--help"],
            env=os.environ | {"COLUMNS": str(width), "NO_COLOR": "1"},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        return printed[printed.index("usage:") :]

    with ThreadPoolExecutor(2) as pool:
        return dict(zip(names, pool.map(help_of, names), strict=True))


def examples() -> str:
    """Returns the page of the numbered examples, whole."""
    lines = [
        "# Examples",
        "",
        "Each example is a file of `examples/` and is run by a test. "
        "`01_linear_system` and `09_quadruped` are notebooks, too.",
    ]
    for file in sorted((ROOT / "examples").glob("*.py")):
        code = file.read_text().partition("\n")[2].strip()  # without the licence
        lines += ["", f"## {file.name}", "", "```python", code, "```"]
    return "\n".join(lines)


def library_index() -> str:
    """Returns the first page of the library's reference."""
    lines = [
        "# Library",
        "",
        "The rows go from the paper's mathematics up to the search; each imports only those above "
        "it. None of them imports ROS.",
        "",
        "| package | about |",
        "| --- | --- |",
    ]
    for folder in folders():
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


def folders() -> list[str]:
    """Returns the folders of the library, which are shown from the bottom upwards."""
    return [folder for folder in LIBRARY if (ROOT / "vgps_ros" / folder).is_dir()]


def name(folder: str) -> str:
    """Returns the dotted name of a folder of the package."""
    return folder.replace("/", ".")


def first_line(file: Path) -> str:
    """Returns the first line of a module's docstring."""
    text = file.read_text().split('"""')
    return text[1].splitlines()[0] if len(text) > 1 else ""
