# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs nodes until INT or TERM, or prints their `--help`; and the node of a program.

Signals are not left to rclpy, whose handlers end the context at once: a node could say nothing
more, and its last command must be able to be zero torque.
"""

import gc
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from types import FrameType
from typing import Any, Generic, TypeVar

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logging_directory
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from vgps_ros.core.errors import VgpsError
from vgps_ros.ros_runtime.parameters import DECLARED, check_common_parameters
from vgps_ros.ros_runtime.services import guard_services

AnyNode = TypeVar("AnyNode", bound=Node)

_TURN = 0.2  # longest wait of the executor, after which Python takes note of a signal [s]
_failures: list[Exception] = []  # of callbacks, which end this process


@dataclass(frozen=True)
class Runnable(Generic[AnyNode]):
    """A node, and how it is run.

    Attributes:
        make: builds the node; a VgpsError from it, or from a callback, ends the process with its
            sentence. For `--help` it is built too, with its defaults, to see its parameters.
        make_executor: builds what runs the callbacks.
        close: completes what the node has begun, and may still publish.
    """

    make: Callable[[], AnyNode]
    make_executor: Callable[[], Executor] = SingleThreadedExecutor
    close: Callable[[AnyNode], object] = lambda _: None


def run(*runnables: Runnable[Any]) -> int:
    """Runs one or more nodes until INT or TERM, then destroys them.

    Those with the same kind of executor share one, so that messages between them wake no other
    process and no other thread. What ends one of them ends all.

    Returns:
        The process's exit code.
    """
    if (code := _answer_arguments(runnables)) is not None:
        return code
    if "mujoco" in sys.modules:  # an executor may do without it
        import_module("vgps_ros.simulation.warnings").silence_mujoco()
    _on_signals(_interrupt_once)
    _initialise(sys.argv)
    gc.freeze()  # what is imported by now is not searched for garbage
    executors = {make: make() for make in dict.fromkeys(r.make_executor for r in runnables)}
    nodes: list[Node] = []
    code = 0
    try:
        _run_to_the_end(runnables, executors, nodes)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except VgpsError as error:
        print(error, file=sys.stderr)
        code = 1
    except Exception as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):  # while a package was imported
            traceback.print_exc()
            code = 1
    _on_signals(lambda *_: None)  # a second one changes nothing
    rclpy.try_shutdown()  # ends what still waits
    while executors:
        executors.popitem()[1].shutdown()
    has_failed = code or len(nodes) < len(runnables)
    while nodes:
        nodes.pop().destroy_node()
    if has_failed:
        gc.collect()  # a node whose code failed leaves the graph, too
    gc.freeze()  # what the nodes imported and made takes no time at the end, either
    return code


def _run_to_the_end(
    runnables: Sequence[Runnable[Any]],
    executors: Mapping[Callable[[], Executor], Executor],
    nodes: list[Node],
) -> None:
    """Adds the nodes to a list, runs them until one fails or a signal comes, and closes them."""
    is_ending = threading.Event()
    first, *others = executors.values()
    threads = [threading.Thread(target=_spin, args=[is_ending, each]) for each in others]
    with ExitStack() as closing:
        for runnable in runnables:
            nodes.append(node := runnable.make())
            closing.callback(runnable.close, node)
            guard_services(node)
        if len(nodes) > 1:
            check_common_parameters(nodes)
        _on_signals(lambda *_: is_ending.set())  # from here on they interrupt nothing
        for runnable, node in zip(runnables, nodes, strict=True):
            executors[runnable.make_executor].add_node(node)
        for thread in threads:
            thread.start()
        _spin(is_ending, first)
        is_ending.set()
        for thread in threads:
            thread.join()
        if _failures:
            raise _failures.pop()


def _spin(is_ending: threading.Event, executor: Executor) -> None:
    """Runs callbacks until the process is to end; keeps what one of them raises."""
    try:
        while not (is_ending.is_set() or _failures):
            executor.spin_once(timeout_sec=_TURN)
    except Exception as error:
        _failures.append(error)


def _initialise(arguments: Sequence[str]) -> None:
    """Initialises rclpy, which ends with a traceback where it cannot write a log file."""
    try:
        folder = get_logging_directory()
        Path(folder).mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except (RuntimeError, OSError) as error:  # without HOME, or in a folder of others
        print(
            f"ROS cannot write a log file ({error}), so the log is on the terminal alone: set "
            "ROS_LOG_DIR to a folder that may be written.",
            file=sys.stderr,
        )
        arguments = [*arguments, "--ros-args", "--disable-external-lib-logs"]
    rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)


def _on_signals(handler: Callable[[int, FrameType | None], object]) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _interrupt_once(*_: object) -> None:
    _on_signals(lambda *_: None)
    raise KeyboardInterrupt


def end_with(failure: VgpsError) -> None:
    """Ends this process with an error, from within a callback of any executor."""
    _failures.append(failure)


def streaming_executor() -> Executor:
    """Returns the executor that takes least time for each message; it has one thread.

    For each message the public executors ask for all services, timers and topics of a node, which
    takes three times as long.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:  # in the first releases of Jazzy
        return SingleThreadedExecutor()
    return EventsExecutor()


@contextmanager
def client_node(make_node: Callable[[], AnyNode]) -> Iterator[AnyNode]:
    """Makes the node of a program that asks other nodes for something; destroys it at the end."""
    _initialise(sys.argv)
    node = None
    try:
        node = make_node()
        yield node
    finally:
        if node:
            node.destroy_node()
        rclpy.try_shutdown()


def spin_once(executor: Executor, timeout: float) -> None:
    """Runs a program's callbacks once, or waits for one for a time [s].

    INT and TERM raise KeyboardInterrupt afterwards: rclpy's code in C++ would lose it.
    """
    struck: list[int] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {n: signal.signal(n, lambda number, _: struck.append(number)) for n in numbers}
    try:
        executor.spin_once(timeout_sec=timeout)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if struck:
        raise KeyboardInterrupt


def _answer_arguments(runnables: Sequence[Runnable[Any]]) -> int | None:
    """Prints the help that the arguments ask for, or what is wrong with them.

    Returns:
        The process's exit code, or None if the nodes are to run.
    """
    name = Path(sys.argv[0]).name
    try:
        arguments = remove_ros_args(sys.argv)[1:]
    except RuntimeError as error:  # it ends with the places in rcl's source
        words = str(error).partition(", at /")[0].removeprefix("Failed to parse ROS arguments: ")
        print(f"{name} cannot start: {' '.join(words.split())}.", file=sys.stderr)
        return 1
    if {"-h", "--help"} & set(arguments):
        _show_help(runnables, name)
        return 0
    if arguments:
        print(
            f"{name} does not know the argument '{arguments[0]}': give its parameters as "
            f"--ros-args -p NAME:=VALUE; `{name} --help` lists them.",
            file=sys.stderr,
        )
        return 1
    return None


def _show_help(runnables: Sequence[Runnable[Any]], name: str) -> None:
    """Prints descriptions and parameters of nodes.

    A node is built with its defaults, in a graph that nobody discovers and in an empty folder.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    print(f"usage: ros2 run vgps_ros {name} [--ros-args -p PARAMETER:=VALUE ...]\n")
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    for runnable in runnables:
        DECLARED.clear()
        with TemporaryDirectory(prefix="vgps_ros_help_", ignore_cleanup_errors=True) as folder:
            os.chdir(folder)  # for good, since a writing thread may open its file later
            _initialise(["--ros-args", "--log-level", "fatal"])
            with suppress(VgpsError):  # of one that needs more than its defaults, as a player
                runnable.make().destroy_node()
            rclpy.try_shutdown()
        table = Table(box=box.SIMPLE)
        for heading in ("parameter", "default", "what it does (valid values)"):
            table.add_column(heading, overflow="fold")
        for descriptor, default in DECLARED:
            changes = "" if descriptor.read_only else " [may change while it runs]"
            table.add_row(descriptor.name, str(default), descriptor.description + changes)
        print(sys.modules[runnable.make.__module__].__doc__)
        console = Console(markup=False, emoji=False)
        if not console.is_terminal:  # where rich would assume 80 characters
            console.width = max(console.width, 140)
        console.print(table, highlight=False)
