"""Reads bags, which are folders with .mcap files and metadata.yaml."""

import argparse
import json
import sys
from collections import Counter
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.experiments.command_line import Parser


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
            "attachments": {name: yaml.safe_load(text) for name, text in bag.attachments().items()},
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
        table.add_row(topic["name"], topic["type"], str(topic["messages"]), rate)
    console.print(table)
    for name, text in content["attachments"].items():
        console.print(f"\n[bold]{name}[/bold]")
        console.print(yaml.safe_dump(text, sort_keys=False), highlight=False, markup=False)


def check(arguments: argparse.Namespace) -> None:
    """Checks that the torques are those that the policy gives; ends with 1 if not."""
    from vgps_ros.bags import BagReader
    from vgps_ros.bags.reindex import missing_parts
    from vgps_ros.bags.torque_check import check_torques

    if missing := missing_parts(arguments.bag):
        raise InvalidInputError(missing)
    with BagReader(arguments.bag) as bag:
        found = check_torques(bag)
    print(
        f"{found.deterministic + found.stochastic} torques are bit for bit what the policy gives "
        f"for their states: {found.deterministic} without noise, {found.stochastic} with the noise "
        f"of the seed. {found.unanswered} states have no torque."
    )
    for count, sentence in (
        (found.clipped, "of them are clipped to torque_limits or the robot's own."),
        (found.rate_limited, "of them are held back by torque_rate_limit."),
        (found.safe, "other torques are those of the safe action, or zero."),
        (
            found.unchecked,
            "torques follow one that is not in the bag, which torque_rate_limit needs.",
        ),
        (found.unusable, "states could not be used."),
        (found.stateless, "torques answer states that are not in the bag."),
        (found.different, "torques differ from what the policy gives."),
    ):
        if count:
            print(f"{count} {sentence}")
    if not found.is_good:
        raise InvalidInputError(
            found.first_difference or "The bag lacks states, so not all torques can be checked."
        )


def rerun(arguments: argparse.Namespace) -> None:
    """Writes the bag as a Rerun recording."""
    from rich.console import Console
    from rich.progress import track

    from vgps_ros.bags import BagReader
    from vgps_ros.views.graph_scene import GraphScene, is_drawn

    output = arguments.output or arguments.bag.resolve().with_suffix(".rrd")
    with BagReader(arguments.bag) as bag:
        topics = [topic for topic, kind in bag.topics.items() if is_drawn(topic, kind)]
        for needed in ("robot_description", "joint_states"):
            bag.needed_topic(needed)
        left_out: Counter[str] = Counter()
        scene = GraphScene(output, lambda _, text: left_out.update([text] if text else []))
        try:
            total = sum(bag.counts[topic] for topic in topics)
            messages = track(bag.messages(topics), "Drawing", total, console=Console(stderr=True))
            for message in messages:
                scene.show(message.topic, bag.decode(message))
        finally:
            scene.close()
    for sentence, times in left_out.items():
        print(f"{sentence} ({times} times)", file=sys.stderr)
    print(f"Wrote {output}; open it with `rerun --bind 127.0.0.1 {output}`.")


def table(arguments: argparse.Namespace) -> None:
    """Writes the last motion as a table that can be a demonstration."""
    from vgps_ros.bags import BagReader
    from vgps_ros.bags.episode import last_episode, write_table
    from vgps_ros.simulation.model import compile_model

    output = arguments.output or arguments.bag.resolve().with_suffix(".csv")
    with BagReader(arguments.bag) as bag:
        mjcf = next(bag.decoded(bag.needed_topic("robot_description")))[1].data
        episode = last_episode(bag, compile_model(mjcf))
    if episode is None:
        raise InvalidInputError(f"'{arguments.bag}' has no motion: it needs two states at least.")
    write_table(episode, output)
    print(f"Wrote {len(episode.time)} states, {episode.time[-1]:g} s, to {output}.")


def reindex(arguments: argparse.Namespace) -> None:
    """Rebuilds metadata.yaml and the index after a recorder was killed."""
    from vgps_ros.bags import reindex as bags

    path = arguments.bag
    if not bags.missing_parts(path):
        print(f"'{path}' is whole; there is nothing to rebuild.")
        return
    for file in bags.reindex(path):
        print(f"Rebuilt the index of {file}; {file.name}.unfinished is what was there before.")
    print(f"Rebuilt {path / 'metadata.yaml'}.")


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    commands = parser.add_subparsers(metavar="COMMAND", dest="action", required=True)
    for action in (info, check, rerun, table, reindex):
        name, text = action.__name__, action.__doc__
        command = commands.add_parser(name, help=text, description=text, words=parser.words[1:])
        command.add_argument("bag", type=Path, help="folder of the bag")
        command.set_defaults(action=action)
        if action is info:
            command.add_argument("--json", action="store_true", help="print JSON instead of tables")
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
