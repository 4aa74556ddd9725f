"""A graph's parameter file as defaults of a program: what nodes take, `train` takes too."""

from pathlib import Path
from typing import Any, TypeVar

import yaml

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import settings_of, with_values

Record = TypeVar("Record")


def with_parameters_of(record: Record, node: str, path: Path) -> Record:
    """Returns the settings record with what a file says for a node.

    Args:
        record: defaults.
        node: name of the node's block, which may be missing. Other parameters of it are no
            settings of this record, and are left to the node.
        path: in the form of ROS 2, NODE: {ros__parameters: {NAME: VALUE}}.

    Raises:
        InvalidInputError: the file is none of this form, or a value is wrong.
        OSError: it cannot be read.
    """
    try:
        blocks = yaml.safe_load(path.read_text())
        given = _flat(blocks.get(node, {"ros__parameters": {}})["ros__parameters"])
    except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, AttributeError) as error:
        raise InvalidInputError(
            f"'{path}' is no parameter file: it must have blocks of the form "
            "NODE: {ros__parameters: {NAME: VALUE}}, as config/swimmer.yaml has."
        ) from error
    known = {s.name for s in settings_of(record)}
    return with_values(record, {name: value for name, value in given.items() if name in known})


def _flat(block: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Returns a nested block by dotted names, lists as tuples."""
    flat: dict[str, Any] = {}
    for name, value in block.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = tuple(value) if isinstance(value, list) else value
    return flat
