# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads bags, which are folders with .mcap files and metadata.yaml."""

import argparse
import json
import os
import shlex
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any, TextIO

import yaml

from vgps_ros.core.checks import printable
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.programs.command_line import Parser, refuse_existing
from vgps_ros.storage.files import as_json, part_of, read_yaml

_MISSING = 3  # exit code of a check that found nothing wrong, but lacked something


def info(arguments: argparse.Namespace) -> None:
    """Prints topics, parameters and versions."""
    from rich.table import Column, Table

    from vgps_ros.bags import BagReader
    from vgps_ros.views.console import table_console

    path = arguments.bag
    with BagReader(path) as bag:
        seconds = bag.duration * 1e-9
        topics: list[dict[str, Any]] = [
            {
                "name": topic,
                "type": kind,
                "messages": bag.counts[topic],
                "rate": bag.counts[topic] / seconds if seconds else None,
            }
            for topic, kind in sorted(bag.topics.items())
        ]
        content = {
            "messages": sum(bag.counts.values()),
            "start": bag.start * 1e-9 if any(bag.counts.values()) else 0.0,
            "duration": seconds,
            "size": sum(file.stat().st_size for file in path.iterdir()),
            "topics": topics,
            "attachments": {n: _to_json(data) for n, data in bag.attached().items()},
        }
    if arguments.json:
        print(json.dumps(content, indent=2))
        return
    console = table_console()
    started = datetime.fromtimestamp(content["start"]).isoformat(" ", "seconds")
    console.print(
        f"{path}: {content['messages']} messages over {seconds:.3f} s from {started}, "
        f"{content['size'] / 1e6:.2f} MB"
    )
    table = Table(
        *(Column(name, overflow="fold") for name in ("topic", "type")),  # which cuts no name
        *(Column(name, justify="right") for name in ("messages", "per second")),
    )
    for topic in topics:
        rate = "" if topic["rate"] is None else f"{topic['rate']:.1f}"
        names = (printable(topic[key]) for key in ("name", "type"))
        table.add_row(*names, str(topic["messages"]), rate)
    console.print(table)
    for name, text in content["attachments"].items():
        console.print(f"\n{printable(name)}", style="bold", highlight=False)
        shown = text if isinstance(text, str) else yaml.safe_dump(text, sort_keys=False)
        console.print(printable(shown), highlight=False)


def _to_json(attached: bytes) -> Any:
    """Returns an attachment as JSON can have it; of one that is no YAML, how large it is."""
    try:
        return as_json(read_yaml(attached, "It"))
    except InvalidInputError:
        return f"{len(attached)} bytes that are no YAML"


def check(arguments: argparse.Namespace) -> None:
    """Computes controls and states again; 1 if any differs, 3 if anything is missing.

    The last line says what is proved, and what is not.
    """
    from vgps_ros.bags.bag_check import UNPROVED, check_bag
    from vgps_ros.bags.control_check import AGREEING
    from vgps_ros.policies.policy_file import open_policy

    trusted = open_policy(arguments.policy) if arguments.policy else None
    found = check_bag(arguments.bag, trusted, arguments.namespace)
    for kind, sentence in AGREEING.items():
        if count := found.counts[kind]:
            print(f"{count} {sentence}")
    for heading, parts in (("Wrong", found.wrong), ("Missing", found.missing)):
        for part in parts:
            _say(f"{heading}: {part}.")
    proved = ", ".join(found.proved) or "nothing"
    _say(f"Proved: {proved}. Not proved: {'; '.join([*found.unproved, UNPROVED])}.")
    if found.wrong:
        raise InvalidInputError(f"{found.wrong[0]}.")
    if found.missing or not found.proved:
        sys.exit(_MISSING)


def rerun(arguments: argparse.Namespace) -> None:
    """Writes the bag as a Rerun recording."""
    from rich.console import Console
    from rich.progress import track

    from vgps_ros.bags import BagReader
    from vgps_ros.bags.episode import episodes
    from vgps_ros.simulation.model import compile_model
    from vgps_ros.views.graph_scene import GraphScene, is_drawn

    output = _output(arguments, ".rrd")
    part = part_of(output)
    part.unlink(missing_ok=True)
    faults = list[str]()
    with BagReader(arguments.bag, arguments.namespace) as bag:
        model = compile_model(bag.mjcf())
        bag.needed_topic("joint_states")
        with suppress(InvalidInputError):  # a real robot's states may lack what odometry tells
            episodes(bag, model, faults)
        _warn(faults)
        of_robot = {*bag.filled_topics.values(), *bag.of_robot_nodes("iterations")}
        topics = [topic for topic in sorted(of_robot) if is_drawn(topic, bag.topics[topic])]
        left_out: Counter[str] = Counter()
        scene = GraphScene(part, lambda _, text: left_out.update([text] if text else []))
        try:
            total = sum(bag.counts[topic] for topic in topics)
            messages = track(bag.messages(topics), "Drawing", total, console=Console(stderr=True))
            for message in messages:
                scene.show(message.topic, bag.decode(message))
            scene.close()
            os.replace(part, output)
        finally:
            part.unlink(missing_ok=True)
    for sentence, times in left_out.items():
        _say(f"{sentence} ({times} times)", sys.stderr)
    print(f"Wrote {output}; open it with `vgps view {shlex.quote(str(output))}`.")


def table(arguments: argparse.Namespace) -> None:
    """Writes the last motion as a table that can be a demonstration."""
    from vgps_ros.bags import BagReader
    from vgps_ros.bags.episode import driven_episodes
    from vgps_ros.simulation.model import compile_model
    from vgps_ros.tasks.motion_table import write_motion

    output, faults = _output(arguments, ".csv"), list[str]()
    with BagReader(arguments.bag, arguments.namespace) as bag:
        *_, last = driven_episodes(bag, compile_model(bag.mjcf()), faults)
    _warn(faults)
    write_motion(output, last.model, last.time, last.trajectory)
    print(f"Wrote {len(last.time)} states, {last.time[-1]:g} s, to {output}.")


def reindex(arguments: argparse.Namespace) -> None:
    """Rebuilds metadata.yaml and the index after a recorder was killed."""
    from vgps_ros.bags.repair import repair

    rebuilt = repair(arguments.bag)
    for file, faults in rebuilt.items():
        _warn(faults)
        before = f"; {file.name}.unfinished is what was there before" if faults else ""
        print(f"Rebuilt {file}{before}.")
    if not rebuilt:
        print(f"'{arguments.bag}' is whole; there is nothing to rebuild.")


def _output(arguments: argparse.Namespace, ending: str) -> Path:
    """Returns the file to write, which must not be there, or may be replaced."""
    output: Path = arguments.output or arguments.bag.resolve().with_suffix(ending)
    refuse_existing([output], overwrite=arguments.overwrite)
    return output


def _warn(faults: Sequence[str]) -> None:
    """Says what is damaged or missing, and so left out."""
    for sentence in faults:
        _say(f"Not whole: {sentence}.", sys.stderr)


def _say(sentence: str, file: TextIO | None = None) -> None:
    """Prints a sentence with names from a bag, which may hold what commands a terminal."""
    print(printable(sentence), file=file)


ACTIONS = (info, check, rerun, table, reindex)


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    commands = parser.add_subparsers(metavar="COMMAND", dest="action", required=True)
    for action in ACTIONS:
        name, text = action.__name__, action.__doc__
        command = commands.add_parser(name, help=text, description=text, words=parser.words[1:])
        command.add_argument("bag", type=Path, help="folder of the bag")
        command.set_defaults(action=action)
        if action in (check, rerun, table):
            command.add_namespace("of the robot that is meant, for a bag of several")
        if action is info:
            command.add_argument("--json", action="store_true", help="print JSON instead of tables")
        elif action is check:
            command.add_argument(
                "--policy", type=Path, help="file that was policy_file of the executor"
            )
        elif action in (rerun, table):
            ending = ".rrd" if action is rerun else ".csv"
            command.add_output("--output", f"file to write; default BAG{ending}")


def run(arguments: argparse.Namespace) -> None:
    """Does to the bag what the arguments say."""
    arguments.action(arguments)
