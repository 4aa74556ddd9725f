"""Command-line flags from settings, so that `--help` teaches what the parameters do."""

import argparse
from typing import Any, TypeVar

from vgps_ros.core.settings import Setting, settings_of, with_values

Record = TypeVar("Record")


def add_flags(parser: argparse.ArgumentParser, record: Any) -> None:
    """Adds a flag for each setting of a record, `fit.form` as `--fit-form`."""
    for s in settings_of(record):
        parser.add_argument(
            _flag(s),
            dest=s.name,
            type=_parser(s.default),
            nargs="+" if isinstance(s.default, tuple) else None,
            choices=s.choices,
            default=s.default,
            metavar=None if s.choices else s.name.split(".")[-1].upper(),
            help=f"{s.description}; {s.range()}; default {_show(s.default)}",
        )


def settings_from(arguments: argparse.Namespace, record: Record) -> Record:
    """Returns the record with the values of the command line, all of them checked.

    Raises:
        InvalidInputError: a value is out of range.
    """
    given = vars(arguments)
    values = {s.name: given[s.name] for s in settings_of(record) if s.name in given}
    return with_values(
        record, {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    )


def _flag(s: Setting) -> str:
    return "--" + s.name.replace("_", "-").replace(".", "-")


def _parser(default: Any) -> Any:
    if isinstance(default, bool):
        return _boolean
    return type(default[0]) if isinstance(default, tuple) else type(default)


def _boolean(text: str) -> bool:
    if text.lower() not in ("true", "false"):
        raise argparse.ArgumentTypeError(f"'{text}' must be true or false")
    return text.lower() == "true"


def _show(default: Any) -> str:
    return " ".join(map(str, default)) if isinstance(default, tuple) else str(default)
