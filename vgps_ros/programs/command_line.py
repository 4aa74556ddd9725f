# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Command lines: flags from settings, and clear errors."""

import argparse
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from vgps_ros.core.checks import nearest
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.settings import Range, Setting, settings_of, with_values
from vgps_ros.tasks.registry import task_names

Record = TypeVar("Record")

# Endings of pictures that matplotlib writes without another program.
PICTURES = ("png", "svg", "pdf", "jpg", "jpeg", "webp", "tif", "tiff", "eps", "ps")


class Parser(argparse.ArgumentParser):
    """A parser whose help shows defaults, and whose errors are one sentence each.

    Attributes:
        words: the words to be parsed, for defaults and errors that depend on them.
    """

    def __init__(self, *, words: Sequence[str], **options: Any):
        self.words = words
        super().__init__(allow_abbrev=False, **options)
        self.set_defaults(parser=self, interrupted="interrupted.")

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """Adds an argument; its help ends with its default."""
        default = options.get("default")
        if default is not False and default not in (None, "", argparse.SUPPRESS):
            shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
            options["help"] += f"; default {shown}"
        action = super().add_argument(*names, **options)
        if action.dest == "task":
            action.completer = _tasks_or_files  # type: ignore[attr-defined]
        return action

    def add_settings(self, *settings: Setting, unset: str = "") -> None:
        """Adds a flag for each setting, for example `--fit-late` for `fit.late`.

        Args:
            settings: the settings.
            unset: who chooses a value that is left out; the setting's default if empty.
        """
        for s in settings:
            action = self.add_argument(
                "--" + s.name.replace("_", "-").replace(".", "-"),
                dest=s.name,
                type=_parser(s),
                nargs="+" if s.is_list else None,
                default=argparse.SUPPRESS if unset else s.default,
                metavar=s.name.split(".")[-1].upper(),
                help=s.description
                + (f"; {s.range()}" if s.range() else "")
                + (f"; default: {unset}" if unset else ""),
            )
            if s.name != "task":
                action.completer = lambda s=s, **_: s.schema.get("enum", ())  # type: ignore[attr-defined]

    def add_output(self, flag: str, text: str, **options: Any) -> None:
        """Adds a flag for a path to write, and the one that allows it to be replaced."""
        self.add_argument(flag, **{"type": Path, "help": text, **options})
        self.add_argument(
            "--overwrite", action="store_true", help="replace what an earlier run has written"
        )

    def add_ros_arguments(self, awaited: str) -> None:
        """Adds what a client of the graph takes: how long it waits for what, and ROS's arguments.

        ROS reads those itself.
        """
        wait = f"longest wait for {awaited} [s]"
        self.add_settings(Setting("timeout", 20.0, Range(0.1, 86_400.0), wait))
        self.add_argument(
            "--ros-args",
            nargs=argparse.REMAINDER,
            help="arguments of ROS, such as -r NAME:=NEW_NAME",
        )
        self.add_namespace("in which the nodes are")

    def add_namespace(self, text: str) -> None:
        """Adds a flag for the namespace of one robot's nodes and topics."""
        self.add_argument("--namespace", type=_namespace, help=f"namespace {text}, as /robot1")

    def error(self, message: str) -> NoReturn:
        """Ends the program with one sentence, which names what is nearest to a misspelt word."""
        if message.startswith("the following arguments are required"):
            for action in self._actions:
                action.required = False
            if unknown := self.parse_known_args(self.words)[1]:  # may be one of those, misspelt
                message = f"unrecognized arguments: {' '.join(unknown)}"
        word, choices = "", [*self._option_string_actions]
        if found := re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message):
            word, choices = found[1], re.findall(r"[\w-]+", found[2])
        elif found := re.match(r"unrecognized arguments: ([^\s=]+)", message):
            word = found[1]
        end = "" if message.endswith((".", "?")) else "."
        self.exit(
            2, f"{self.prog}: {message}{end}{nearest(word, choices)} See `{self.prog} --help`.\n"
        )


def _tasks_or_files(prefix: str, **_: Any) -> list[str]:
    """Returns the words with which the shell may complete the name of a task."""
    from argcomplete.completers import FilesCompleter

    return [*task_names(), *FilesCompleter(["yaml"])(prefix)]


def picture(text: str) -> Path:
    """Returns the path of a picture to write, whose ending says in which format."""
    path = Path(text)
    if path.suffix.lower().removeprefix(".") not in PICTURES:
        raise argparse.ArgumentTypeError(
            f"'{text}' has no ending of a picture; name a file that ends in one of "
            f"{', '.join(f'.{ending}' for ending in PICTURES)}"
        )
    return path


def deployment_file(text: str) -> Path:
    """Returns the path of a deployment file to write, which an executor knows by its ending."""
    from vgps_ros.policies.deployment_file import DEPLOYMENT

    path = Path(text)
    if path.suffix != DEPLOYMENT:
        raise argparse.ArgumentTypeError(
            f"'{text}' does not end in {DEPLOYMENT}, by which an executor knows such a file; name "
            f"it {path.stem}{DEPLOYMENT}"
        )
    return path


def refuse_existing(paths: Sequence[Path], *, overwrite: bool) -> None:
    """Checks that nothing would be replaced by accident.

    Raises:
        InvalidInputError: two of the paths are one, or one exists and may not be replaced.
    """
    for i, path in enumerate(paths):
        if path.resolve() in [other.resolve() for other in paths[:i]]:
            raise InvalidInputError(
                f"'{path}' is named for two files, of which the second would replace the first; "
                "name a path of its own for each."
            )
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

    def parse(text: str) -> Any:
        value: Any = text
        if s.kind is bool:
            value = {"true": True, "false": False}.get(text.lower(), text)
        # In numbers Python reads other digits and underscores too, a task file does not.
        elif s.kind is not str and text.isascii() and "_" not in text:
            with suppress(ValueError):
                value = s.kind(text)
        try:
            s.check((value,) if s.is_list else value)
        except InvalidInputError as error:
            raise argparse.ArgumentTypeError(str(error)) from error
        return value

    return parse


def _namespace(text: str) -> str:
    if not re.fullmatch(r"/|(/?[A-Za-z_]\w*)+", text, re.ASCII):
        raise argparse.ArgumentTypeError(
            f"'{text}' must be a namespace of ROS: words of letters, digits and '_' behind '/', as "
            "in /robot1"
        )
    return f"/{text.lstrip('/')}"
