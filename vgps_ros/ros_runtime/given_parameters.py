# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Checks the parameters that a node's command line and parameter files give to it.

ROS leaves out, without a word, what it cannot use: a misspelt parameter, and a block of a file
whose key is not the node's name.
"""

import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import yaml
from rclpy.node import Node

from vgps_ros.core.checks import nearest, quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.ros_runtime.parameters import DECLARED

_ALL = re.compile(r"/\*\*?")


@dataclass(frozen=True)
class _Given:
    """A parameter as it was given: by the command line, or by a file's block for some nodes."""

    name: str
    key: str  # of the block, such as /**/simulation
    file: str = ""

    @property
    def node(self) -> str:
        """The node's name without a namespace, or a pattern."""
        return self.key.rpartition("/")[2]

    def reaches(self, node: Node) -> bool:
        """Returns True if the block's key matches a node, as ROS matches it."""
        pattern = _ALL.sub(lambda found: r"/\w+" if found[0] == "/*" else r"(/\w+)*", self.key)
        return bool(re.fullmatch(pattern, node.get_fully_qualified_name()))


def check_given_parameters(node: Node) -> None:
    """Checks, once all parameters are declared, that the node was given no others.

    A parameter file's block for all nodes, such as `/**`, may have parameters of other nodes. A
    file whose blocks for this kind of node all have another node's name is worth a warning.

    Raises:
        InvalidInputError: the command line, or the node's own block of a file, names another one.
    """
    given = list(_given(node.get_name()))
    for name in (each.name for each in given if each.node == node.get_name()):
        if not (node.has_parameter(name) or name.startswith("qos_overrides.")):
            declared = [descriptor.name for descriptor, _ in DECLARED]
            raise InvalidInputError(
                f"{node.get_name()} has no parameter {quoted(name)}.{nearest(name, declared)} "
                "Start it with --help alone to see all of them."
            )
    executable = Path(sys.argv[0]).name
    meant = [e for e in given if e.file and e.node in (executable, node.get_name())]
    for file in dict.fromkeys(each.file for each in meant):
        keys = {each.key: each.reaches(node) for each in meant if each.file == file}
        if not any(keys.values()):
            node.get_logger().warning(
                f"'{file}' has parameters for {', '.join(keys)}, which this node, "
                f"{node.get_fully_qualified_name()}, does not take: name their block "
                f"/**/{node.get_name()}, and they reach it in every namespace."
            )


def _given(node: str) -> Iterator[_Given]:
    """Yields the parameters that this process's arguments give to the node, or to others."""
    arguments = sys.argv[sys.argv.index("--ros-args") :] if "--ros-args" in sys.argv else []
    for flag, argument in pairwise(arguments):
        if flag in ("-p", "--param"):
            target, _, name = argument.partition(":=")[0].rpartition(":")
            yield _Given(name, f"/{target or node}")
        elif flag == "--params-file":
            for path in _paths(yaml.safe_load(Path(argument).read_text())):
                block, _, name = "\n".join(path).partition("\nros__parameters\n")
                key = block.replace("\n", "/")
                yield _Given(name.replace("\n", "."), f"/{key.lstrip('/')}", argument)


def _paths(content: object, *above: str) -> Iterator[tuple[str, ...]]:
    """Yields the keys that lead to each value of a parameter file."""
    if isinstance(content, Mapping):
        for key, inner in content.items():
            yield from _paths(inner, *above, str(key))
    else:
        yield above
