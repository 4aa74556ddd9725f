# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Learns locomotion policies by variational guided policy search, in this process or in ROS 2."""

import importlib
import os
import re
import signal
import sys
from collections.abc import Sequence
from errno import EDQUOT, ENOSPC
from importlib.util import find_spec
from inspect import cleandoc
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vgps_ros import DRAWS_BY, NODES
from vgps_ros.programs.node import start

if TYPE_CHECKING:
    from vgps_ros.programs.command_line import Parser

# What libraries say where they get no memory, such as a model's arena under a limit.
_SHORT_OF_MEMORY = re.compile(
    "ould not allocate|nable to allocate|bad_alloc|start new thread|failed to map"
)
_SHARED = {"command_line", "policy_card", "policy_run", "training_client"}  # no commands
_EXTRAS = {  # by the package that it brings
    **dict.fromkeys(("mcap", "mcap_ros2", "pyarrow", "rerun", "rosbags"), "bags"),
    "distributed": "cluster",
    "onnxruntime": "onnx",
    "viser": "live",
}
COMMANDS = sorted(
    file.stem.replace("_", "-")
    for file in Path(__file__).parent.glob("[!_]*.py")
    if file.stem not in _SHARED
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command that the arguments name, and ends with a sentence where it fails."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if arguments is None:
        # A shell starts what it puts into the background with INT ignored.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
    if words and words[0] in NODES:  # as in `ros2 run vgps_ros simulation`
        words.insert(0, "node")
    if words and words[0] != "node":
        words[0] = words[0].replace("_", "-")  # as in `ros2 run vgps_ros execute_policy`
    _set_environment()
    try:
        if words[:1] == ["node"] and words[1:2] and words[1] in NODES:
            start(words[1:])
        run_command(words)
    except KeyboardInterrupt:
        sys.exit("vgps: interrupted.")
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package in ("", "vgps_ros"):
            raise
        sys.exit(f"vgps {words[0]}: {_installation_advice(package)}")


def _set_environment() -> None:
    """Sets what env.bash sets in a checkout, as far as the user has not set it himself.

    docs/how_to/install.md says what each variable is for.
    """
    defaults = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "ORT_DISABLE_TELEMETRY": "1"}
    share = Path(sys.prefix, "share")
    if (share / "ament_index/resource_index/packages/rclpy").exists():  # ROS 2 from wheels
        defaults |= {"AMENT_PREFIX_PATH": sys.prefix, "ROS_DISTRO": "jazzy"}
        defaults |= {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "RMW_FASTRTPS_USE_QOS_FROM_XML": "1"}
        profile = share / "vgps_ros/config/fastdds_loopback.xml"
        if profile.exists() and not os.environ.get("FASTDDS_DEFAULT_PROFILES_FILE"):
            defaults["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
    for name, value in defaults.items():
        os.environ.setdefault(name, value)
    # MuJoCo loads at its import what draws, and fails where that is missing, though few draw.
    os.environ.setdefault(DRAWS_BY, os.environ.get("MUJOCO_GL", ""))
    os.environ["MUJOCO_GL"] = "disable"


def _installation_advice(package: str) -> str:
    """Returns a sentence on how to install what a command lacks."""
    if re.fullmatch(r"rclpy|(ament|rosidl)_\w+|\w+_(msgs|interfaces)", package):
        needed, extra = "ROS 2 Jazzy", "ros"
    else:
        needed, extra = f"the package '{package}'", _EXTRAS.get(package, "")
    wheel = f"vgps_ros with the extra [{extra}]" if extra else "vgps_ros"
    return (
        f"this command needs {needed}, which is not installed; install {wheel} by pip, or in a "
        "checkout run `make setup` and `source env.bash`."
    )


def run_command(words: Sequence[str]) -> None:
    """Runs a command as if it were typed; exits with a sentence where it fails."""
    from vgps_ros.core.checks import printable
    from vgps_ros.core.errors import VgpsError

    is_completing = "_ARGCOMPLETE" in os.environ
    if is_completing:
        words = os.environ["COMP_LINE"].split()[1:2]
    words = _without_ros_arguments(words)
    name, sentence = " ".join(["vgps", *words[:1]]), "interrupted."
    try:
        parser = _parser(words)
        if is_completing:
            import argcomplete

            argcomplete.autocomplete(parser)
        parsed, unknown = parser.parse_known_args(words)
        if unknown:
            parsed.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
        name, sentence = parsed.parser.prog, parsed.interrupted
        if find_spec("mujoco"):  # a robot's computer does without it
            importlib.import_module("vgps_ros.simulation.warnings").silence_mujoco()
        _module(parsed.command).run(parsed)
    except KeyboardInterrupt:
        sys.exit(f"{name}: {sentence}")
    except (VgpsError, OSError) as error:
        sys.exit(f"{name}: {printable(_error_sentence(error))}")
    except Exception as error:
        if not (isinstance(error, MemoryError) or _SHORT_OF_MEMORY.search(str(error))):
            raise
        sys.exit(f"{name}: There is too little memory; close other programs, or raise `ulimit -v`.")


def _error_sentence(error: Exception) -> str:
    """Returns an error's sentence; what Python says of a file by itself begins with a number."""
    if isinstance(error, OSError) and error.errno in (ENOSPC, EDQUOT):
        return "The disk is full; free some space, and give the same command again."
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"'{error.filename}' cannot be used ({error.strerror}); name another one."
    return str(error)


def _without_ros_arguments(words: Sequence[str]) -> list[str]:
    """Returns the words without those between --ros-args and --, which ROS reads itself."""
    while "--ros-args" in words:
        start = words.index("--ros-args")
        end = words.index("--", start) + 1 if "--" in words[start:] else len(words)
        words = [*words[:start], *words[end:]]
    return list(words)


def _parser(words: Sequence[str]) -> "Parser":
    """Returns the parser of all commands, with the arguments of the one that the words name."""
    from vgps_ros.programs.command_line import Parser

    parser = Parser(prog="vgps", description=__doc__, words=words)
    commands = parser.add_subparsers(metavar="COMMAND", dest="command", required=True)
    for name in COMMANDS:
        text = _description(name)
        command = commands.add_parser(
            name, help=text.partition("\n")[0], description=text, words=words[1:]
        )
        if words[:1] == [name]:
            _module(name).add_arguments(command)
    return parser


def _description(command: str) -> str:
    """Returns a module's docstring without importing it, which may need packages."""
    file = Path(__file__).parent / f"{command.replace('-', '_')}.py"
    return cleandoc(file.read_text(encoding="utf-8").split('"""', 2)[1])


def _module(command: str) -> Any:
    return importlib.import_module(f"vgps_ros.programs.{command.replace('-', '_')}")


if __name__ == "__main__":
    main()
