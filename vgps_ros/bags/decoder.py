# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Decodes messages with the definitions that a bag holds, which may be a stranger's."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc, Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vgps_ros.core.checks import told
from vgps_ros.core.errors import InvalidInputError

_LONGEST = 2**18  # definition that is read [characters]
_MOST_PARTS = 1024  # of arrays of a fixed size, for each of which rosbags writes lines of code


class Decoder:
    """Decodes messages.

    Args:
        definitions: of the types, by their names.
    """

    def __init__(self, definitions: Mapping[str, str]):
        self._definitions = definitions
        self._store = get_typestore(Stores.EMPTY)
        self._parts = 0

    @property
    def types(self) -> set[str]:
        """The types of the messages that were decoded so far, and of their fields."""
        return set(self._store.fielddefs)

    def decode(self, data: bytes, kind: str) -> Any:
        """Returns an object that has the message's fields as attributes.

        Args:
            data: the message, as CDR.
            kind: its type.

        Raises:
            InvalidInputError: the message does not fit the definition; the error ends with the
                cause.
        """
        with _told():
            self._register(kind)
            return self._store.deserialize_cdr(data, kind)

    def hash(self, kind: str) -> str:
        """Returns the RIHS01 hash of a type's definition.

        Raises:
            InvalidInputError: it is not a definition; the error ends with the cause.
        """
        with _told():
            self._register(kind)
            return self._store.hash_rihs01(kind)

    def _register(self, kind: str) -> None:
        if kind not in self._store.fielddefs:
            self._store.register(self._types(kind))

    def _types(self, kind: str) -> Typesdict:
        """Reads a definition.

        Raises:
            ValueError: its code, or reading it, would take too much memory.
            Exception: it is no definition.
        """
        definition = self._definitions[kind]
        if len(definition) > _LONGEST:
            raise ValueError(
                f"its definition has {len(definition)} characters, and at most {_LONGEST} are read"
            )
        types = get_types_from_msg(definition, kind)
        self._parts += sum(_parts(field) for _, fields in types.values() for _, field in fields)
        if self._parts > _MOST_PARTS:
            raise ValueError(
                f"with its definition there are {self._parts} texts and messages in arrays of a "
                f"fixed size, and at most {_MOST_PARTS} are read"
            )
        return types


@contextmanager
def _told() -> Iterator[None]:
    """Gives a sentence's end to the errors of many kinds that are raised deep inside rosbags."""
    try:
        yield
    except Exception as error:
        raise InvalidInputError(told(error)) from error


def _parts(field: FieldDesc) -> int:
    """Returns how many parts a field has that are decoded one by one, as numbers are not."""
    if field[0] != Nodetype.ARRAY:
        return 0
    (kind, name), size = field[1]
    return 0 if kind == Nodetype.BASE and name[0] not in ("string", "wstring") else int(size)
