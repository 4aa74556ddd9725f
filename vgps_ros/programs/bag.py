# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Reads bags, which are folders with .mcap files and metadata.yaml."""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, TextIO

import yaml

from vgps_ros.core.checks import printable
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.programs.command_line import Parser

_UNPROVEN = 3  # exit code of a check that found nothing wrong, but could not prove everything


def info(arguments: argparse.Namespace) -> None:
    """Prints topics, parameters and versions."""
    from rich.table import Column, Table

    from vgps_ros.bags import BagReader
    from vgps_ros.views.table_console import table_console

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
            "size": sum(file.stat().st_size for file in path.glob("*.mcap")),
            "topics": topics,
            "attachments": {n: _shown(data) for n, data in bag.attached().items()},
            "damages": bag.damages,
        }
    _warn(content["damages"])
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


def _shown(attached: bytes) -> Any:
    """Returns an attachment as JSON can have it; of one that is no YAML, how large it is."""
    from vgps_ros.storage.plain_yaml import as_json, read_yaml

    try:
        return as_json(read_yaml(attached, "It"))
    except InvalidInputError:
        return f"{len(attached)} bytes that are no YAML"


def check(arguments: argparse.Namespace) -> None:
    """Checks torques, policies and files; ends with 1 if any is wrong, with 3 if any is unproven.

    The last line says how much is proven, and of what.
    """
    from vgps_ros.bags.bag_check import check_bag
    from vgps_ros.policies.policy_file import open_policy

    trusted = open_policy(arguments.policy) if arguments.policy else None
    found = check_bag(arguments.bag, trusted, arguments.signers, arguments.namespace)
    torques = found.torques
    print(
        f"{torques.deterministic + torques.stochastic} torques are bit for bit what the policy "
        f"gives for their states: {torques.deterministic} without noise, {torques.stochastic} with "
        "the noise of the seed."
    )
    for count, sentence in (
        (torques.close, "other torques are those of an ONNX network within its rounding."),
        (torques.clipped, "of them are clipped to torque_limits or the robot's own."),
        (torques.rate_limited, "of them are held back by torque_rate_limit."),
        (torques.safe, "other torques are those of the safe action, while it drove."),
        (torques.last, "zero torques end the executor's activity."),
        (torques.unusable, "states could not be used."),
        (torques.skipped, "states came too fast for the executor in real time."),
    ):
        if count:
            print(f"{count} {sentence}")
    if torques.first_difference:
        _say(torques.first_difference)
    for heading, parts in (("Wrong", found.wrong), ("Not proven", found.unproven)):
        for part in parts:
            _say(f"{heading}: {part}.")
    _say(f"Proven: {', '.join(found.proven) or 'nothing'}.")
    if found.wrong:
        raise InvalidInputError(torques.first_difference or f"{found.wrong[0]}.")
    if found.unproven:
        sys.exit(_UNPROVEN)


def sign(arguments: argparse.Namespace) -> None:
    """Signs the bag's manifest with an ssh key, as git signs commits; check --signers verifies."""
    from vgps_ros.bags import manifest

    manifest.sign(arguments.bag, arguments.key)
    print(f"Wrote {arguments.bag / manifest.SIGNATURE}.")


def rerun(arguments: argparse.Namespace) -> None:
    """Writes the bag as a Rerun recording."""
    from rich.console import Console
    from rich.progress import track

    from vgps_ros.bags import BagReader
    from vgps_ros.views.graph_scene import GraphScene, is_drawn

    output = arguments.output or arguments.bag.resolve().with_suffix(".rrd")
    with BagReader(arguments.bag, arguments.namespace) as bag:
        _warn(bag.damages)
        bag.mjcf()
        bag.needed_topic("joint_states")
        of_robot = {*bag.filled_topics.values(), *bag.of_robot_nodes("iterations")}
        topics = [topic for topic in sorted(of_robot) if is_drawn(topic, bag.topics[topic])]
        left_out: Counter[str] = Counter()
        scene = GraphScene(output, lambda _, text: left_out.update([text] if text else []))
        try:
            total = sum(bag.counts[topic] for topic in topics)
            messages = track(bag.messages(topics), "Drawing", total, console=Console(stderr=True))
            for message in messages:
                scene.show(message.topic, bag.decode(message))
        except BaseException:
            scene.close()
            output.unlink()
            raise
        scene.close()
    for sentence, times in left_out.items():
        _say(f"{sentence} ({times} times)", sys.stderr)
    print(f"Wrote {output}; open it with `vgps view {output}`.")


def table(arguments: argparse.Namespace) -> None:
    """Writes the last motion as a table that can be a demonstration."""
    from vgps_ros.bags import BagReader
    from vgps_ros.bags.episode import last_episode, write_table
    from vgps_ros.simulation.model import compile_model

    output = arguments.output or arguments.bag.resolve().with_suffix(".csv")
    with BagReader(arguments.bag, arguments.namespace) as bag:
        _warn(bag.damages)
        episode = last_episode(bag, compile_model(bag.mjcf()))
    if episode is None:
        raise InvalidInputError(f"'{arguments.bag}' has no motion: it needs two states at least.")
    write_table(episode, output)
    print(f"Wrote {len(episode.time)} states, {episode.time[-1]:g} s, to {output}.")


def reindex(arguments: argparse.Namespace) -> None:
    """Rebuilds metadata.yaml and the index after a recorder was killed."""
    from vgps_ros.bags import reindex as bags
    from vgps_ros.bags.storage import StorageScan

    path = arguments.bag
    damages = [s for file in bags.storage_files(path) for s in StorageScan(file).damages]
    if not (damages or bags.missing_parts(path)):
        print(f"'{path}' is whole; there is nothing to rebuild.")
        return
    _warn(damages)
    for file in bags.reindex(path):
        print(f"Rebuilt the index of {file}; {file.name}.unfinished is what was there before.")
    print(f"Rebuilt {path / 'metadata.yaml'}.")


def _warn(damages: Sequence[str]) -> None:
    """Says what is damaged, and so left out."""
    for sentence in damages:
        _say(f"Damaged: {sentence}.", sys.stderr)


def _say(sentence: str, file: TextIO | None = None) -> None:
    """Prints a sentence with names from a bag, which may hold what commands a terminal."""
    print(printable(sentence), file=file)


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    commands = parser.add_subparsers(metavar="COMMAND", dest="action", required=True)
    for action in (info, check, sign, rerun, table, reindex):
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
            command.add_argument(
                "--signers", type=Path, help="trusted signers, of whom one must have signed the bag"
            )
        elif action is sign:
            command.add_argument("--key", type=Path, required=True, help="private ssh key")
        elif action is rerun:
            command.add_argument(
                "--output", type=Path, help="file to write, which must not exist; default BAG.rrd"
            )
        elif action is table:
            command.add_argument(
                "--output", type=Path, help="CSV to write, which must not exist; default BAG.csv"
            )


def run(arguments: argparse.Namespace) -> None:
    """Does to the bag what the arguments say."""
    arguments.action(arguments)
