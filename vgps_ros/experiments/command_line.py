"""Command lines: flags from settings, defaults in the help, and errors that name what is near."""

import argparse
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from vgps_ros.core.checks import nearest
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Setting, settings_of, with_values

Record = TypeVar("Record")


class Parser(argparse.ArgumentParser):
    """A parser whose help shows defaults, and whose errors are one sentence each.

    Attributes:
        words: the words to be parsed, where defaults depend on some of them.
    """

    def __init__(self, *, words: Sequence[str] = (), **options: Any):
        self.words = words
        self._flags: list[str] = []
        super().__init__(allow_abbrev=False, **options)
        self.set_defaults(parser=self, interrupted="interrupted.")

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """Adds an argument; its help ends with its default."""
        default = options.get("default")
        if default is not False and default not in (None, "", argparse.SUPPRESS):
            shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
            options["help"] += f"; default {shown}"
        action = super().add_argument(*names, **options)
        self._flags += action.option_strings
        return action

    def error(self, message: str) -> NoReturn:
        """Ends the program with one sentence, which names what is nearest to a misspelt word."""
        word, choices = "", self._flags
        if found := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            word, choices = found[1], re.findall(r"[\w-]+", found[2])
        elif found := re.match(r"unrecognized arguments: ([^\s=]+)", message):
            word = found[1]
        end = "" if message.endswith((".", "?")) else "."
        self.exit(
            2, f"{self.prog}: {message}{end}{nearest(word, choices)} See `{self.prog} --help`.\n"
        )


def add_setting(parser: argparse.ArgumentParser, s: Setting, *, unset: str = "") -> None:
    """Adds the flag of a setting, for example `fit.form` as `--fit-form`.

    Args:
        parser: of the command.
        s: the setting.
        unset: who chooses the value where the flag is left out; the setting's default if empty.
    """
    parser.add_argument(
        "--" + s.name.replace("_", "-").replace(".", "-"),
        dest=s.name,
        type=_parser(s),
        nargs="+" if isinstance(s.default, tuple) else None,
        default=argparse.SUPPRESS if unset else s.default,
        metavar="{" + ",".join(s.choices) + "}" if s.choices else s.name.split(".")[-1].upper(),
        help=s.description
        + ("" if s.choices else f"; {s.range()}")
        + (f"; default: {unset}" if unset else ""),
    ).completer = lambda **_: s.choices or ()  # type: ignore[attr-defined]  # of argcomplete


def add_settings(parser: argparse.ArgumentParser, record: Any) -> None:
    """Adds a flag for each setting of a record."""
    for s in settings_of(record):
        add_setting(parser, s)


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """Adds the flag that allows what is there already to be replaced."""
    parser.add_argument(
        "--overwrite", action="store_true", help="replace what an earlier run has written"
    )


def add_ros_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the flag after which ROS, which reads them itself, finds its arguments."""
    parser.add_argument(
        "--ros-args", nargs=argparse.REMAINDER, help="arguments of ROS, such as -r NAME:=NEW_NAME"
    )


def refuse_existing(paths: Sequence[Path], *, overwrite: bool) -> None:
    """Checks that nothing would be replaced by accident.

    Raises:
        InvalidInputError: one of the paths exists, and may not be replaced.
    """
    existing = [path for path in paths if path.exists()]
    if existing and not overwrite:
        raise InvalidInputError(
            f"'{existing[0]}' exists already; name another file or folder, or give --overwrite."
        )


def settings_from(arguments: argparse.Namespace, record: Record) -> Record:
    """Returns the record with the values of the command line.

    Raises:
        InvalidInputError: the values contradict each other.
    """
    given = vars(arguments)
    values = {s.name: given[s.name] for s in settings_of(record) if s.name in given}
    return with_values(
        record, {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    )


def _parser(s: Setting) -> Callable[[str], Any]:
    """Returns a function that reads one value and checks it."""
    is_list = isinstance(s.default, tuple)
    kind = type(s.default[0] if is_list else s.default)

    def parse(text: str) -> Any:
        value = _boolean(text) if kind is bool else kind(text)
        try:
            s.check((value,) if is_list else value)
        except InvalidInputError as error:
            raise argparse.ArgumentTypeError(str(error)) from error
        return value

    parse.__name__ = kind.__name__  # for the sentence "invalid int value: 'many'"
    return parse


def _boolean(text: str) -> bool:
    if text.lower() not in ("true", "false"):
        raise argparse.ArgumentTypeError(f"'{text}' must be true or false")
    return text.lower() == "true"
