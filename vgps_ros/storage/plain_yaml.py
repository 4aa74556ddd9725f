# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads YAML of strangers: no objects, and no more than its text has room for."""

import base64
import math
from typing import Any

import yaml

from vgps_ros.core.errors import InvalidInputError

_LARGEST = 2**24  # [characters]
_MOST = 10**6  # values, where each alias counts as what it stands for
_DEEPEST = 100  # nesting


def read_yaml(text: str | bytes, what: str) -> Any:
    """Returns the content of a YAML text, or of the bytes of one.

    Args:
        text: the text.
        what: names it in the error.

    Raises:
        InvalidInputError: it is no YAML, or would become much larger than it is.
    """
    try:
        if len(text) > _LARGEST:
            raise ValueError(f"it has {len(text)} characters, and at most {_LARGEST} are read")

        node = yaml.compose(text, yaml.SafeLoader)
        if node is None:
            return None
        if _size(node, {}, _DEEPEST) > _MOST:
            raise ValueError(f"its aliases stand for more than {_MOST} values")
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError, TypeError) as error:
        sentence = " ".join(str(error).split())
        raise InvalidInputError(f"{what} is no YAML that can be read: {sentence:.200}.") from error


def as_json(value: Any) -> Any:
    """Returns what `read_yaml` gave with nothing that JSON lacks: what it lacks becomes a text."""
    if isinstance(value, dict):
        return {one if isinstance(one, str) else str(one): as_json(v) for one, v in value.items()}
    if isinstance(value, list | tuple | set):
        return [as_json(one) for one in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    is_plain = value is None or isinstance(value, str | int)
    is_plain |= isinstance(value, float) and math.isfinite(value)
    return value if is_plain else str(value)


def _size(node: yaml.Node, known: dict[int, int], depth: int) -> int:
    """Counts the values of a node, where those that it shares count each time."""
    if not depth:
        raise ValueError("it is nested too deeply, or holds itself")
    if id(node) not in known:
        parts = node.value if isinstance(node, yaml.CollectionNode) else []
        inner = [one for part in parts for one in (part if isinstance(part, tuple) else (part,))]
        known[id(node)] = 1 + sum(_size(one, known, depth - 1) for one in inner)
    return known[id(node)]
