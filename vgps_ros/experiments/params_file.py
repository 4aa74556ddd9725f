"""A graph's parameter file as defaults of a program: what nodes take, `train` takes too."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import yaml

from vgps_ros import NODES
from vgps_ros.core.checks import nearest, quoted
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import settings_of, with_values

Record = TypeVar("Record")

# Parameters that only the nodes heed: no settings of a search, but in its nodes' blocks.
OF_NODES = {
    *("task", "method", "demonstration", "checkpoint_folder", "optimizers", "optimizer_timeout"),
    *("peer_timeout", "wait_timeout", "use_sim_time"),
}


def parameters_of(node: str, path: Path | None) -> dict[str, Any]:
    """Returns what a parameter file, if there is one, says for a node, by dotted name.

    Args:
        node: name of the node's block, which may be missing.
        path: in the form of ROS 2, NODE: {ros__parameters: {NAME: VALUE}}; the block `/**` is
            for all nodes.

    Raises:
        InvalidInputError: the file cannot be read, has another form, or has a block that is no
            node's.
    """
    if path is None:
        return {}
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InvalidInputError(
            f"'{path}' cannot be read ({error.strerror}); name a parameter file, such as those in "
            "config/."
        ) from error
    try:
        blocks = {
            name.rpartition("/")[2]: _flat(block["ros__parameters"])
            for name, block in yaml.safe_load(text).items()
        }
        optimizers = map(str, blocks.get("policy_learner", {}).get("optimizers", ()))
    except (yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        raise InvalidInputError(
            f"'{path}' is no parameter file: it must have blocks of the form "
            "NODE: {ros__parameters: {NAME: VALUE}}, as config/swimmer.yaml has."
        ) from error
    _check_names(path, "block", blocks, {*NODES, *optimizers, "**"})
    return blocks.get("**", {}) | blocks.get(node, {})


def with_parameters_of(record: Record, node: str, path: Path | None) -> Record:
    """Returns a settings record with what a parameter file, if there is one, says for a node.

    Raises:
        InvalidInputError: as above, or a parameter is unknown, or its value is wrong.
    """
    given = parameters_of(node, path)
    known = {s.name for s in settings_of(record)}
    _check_names(path, "parameter", given, known | OF_NODES)
    return with_values(record, {name: given[name] for name in known & given.keys()})


def _check_names(path: Path | None, kind: str, names: Iterable[str], known: set[str]) -> None:
    for name in names:
        if name not in known:
            raise InvalidInputError(
                f"'{path}' has the {kind} {quoted(name)}, which is unknown.{nearest(name, known)}"
            )


def _flat(block: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Returns a nested block by dotted names, lists as tuples."""
    flat: dict[str, Any] = {}
    for name, value in block.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = tuple(value) if isinstance(value, list) else value
    return flat
