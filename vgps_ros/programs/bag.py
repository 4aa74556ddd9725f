"""Reads bags, which are folders with .mcap files and metadata.yaml."""

import argparse
import json
import sys
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console
from rich.progress import track

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.experiments.command_line import Parser


def info(path: Path, *, as_json: bool) -> None:
    """Prints what is in a bag.

    Raises:
        VgpsError: it cannot be read.
    """
    from rich.table import Table

    from vgps_ros.views.table_console import table_console

    content = _content(path)
    if as_json:
        print(json.dumps(content, indent=2))
        return
    console = table_console()
    started = datetime.fromtimestamp(content["start"]).isoformat(" ", "seconds")
    console.print(
        f"{path}: {content['messages']} messages over {content['duration']:.3f} s from {started}, "
        f"{content['size'] / 1e6:.2f} MB"
    )
    table = Table()
    for name in ("topic", "type"):
        table.add_column(name, overflow="fold")  # a narrow terminal cuts no name
    for heading in ("messages", "per second"):
        table.add_column(heading, justify="right")
    for topic in content["topics"]:
        rate = "" if topic["rate"] is None else f"{topic['rate']:.1f}"
        table.add_row(topic["name"], topic["type"], str(topic["messages"]), rate)
    console.print(table)
    for name, text in content["attachments"].items():
        console.print(f"\n[bold]{name}[/bold]")
        console.print(yaml.safe_dump(text, sort_keys=False), highlight=False, markup=False)


def check(path: Path) -> None:
    """Checks that a bag is whole, and its torques against its policy.

    Raises:
        VgpsError: it is not whole, cannot be checked, or a torque is not what the policy gives.
    """
    from vgps_ros.bags import BagReader
    from vgps_ros.bags.reindex import missing_parts
    from vgps_ros.bags.torque_check import check_torques

    if missing := missing_parts(path):
        raise InvalidInputError(missing)
    with BagReader(path) as bag:
        found = check_torques(bag)
    print(
        f"{found.deterministic + found.stochastic} torques are bit for bit what the policy gives "
        f"for their states: {found.deterministic} without noise, {found.stochastic} with the noise "
        f"of the seed. {found.unanswered} states have no torque."
    )
    for count, sentence in (
        (found.clipped, "of them are clipped to torque_limits."),
        (found.rate_limited, "of them are held back by torque_rate_limit."),
        (found.safe, "other torques are those of the safe action, or zero."),
        (
            found.unchecked,
            "torques follow one that is not in the bag, which torque_rate_limit needs.",
        ),
        (found.unusable, "states could not be used."),
    ):
        if count:
            print(f"{count} {sentence}")
    if found.stateless:
        print(f"{found.stateless} torques answer states that are not in the bag.")
    if found.different:
        print(f"{found.different} torques differ from what the policy gives.")
    if not found.is_good:
        raise InvalidInputError(
            found.first_difference or "The bag lacks states, so not all torques can be checked."
        )


def to_rerun(path: Path, output: Path) -> None:
    """Writes a bag as the Rerun recording that the node `visualizer` would have made.

    Raises:
        VgpsError: the bag cannot be read or has nothing to draw, or the output exists.
    """
    from vgps_ros.bags import BagReader
    from vgps_ros.views.graph_scene import GraphScene, is_drawn

    with BagReader(path) as bag:
        topics = [topic for topic, kind in bag.topics.items() if is_drawn(topic, kind)]
        for needed in ("robot_description", "joint_states"):
            bag.needed_topic(needed)
        left_out: dict[str, int] = {}

        def report(_: str, sentence: str | None) -> None:
            if sentence:
                left_out[sentence] = left_out.get(sentence, 0) + 1

        scene = GraphScene(output, report)
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


def to_table(path: Path, output: Path) -> None:
    """Writes the last motion of a bag as a table that can serve as a demonstration.

    Raises:
        VgpsError: the bag cannot be read or has no motion with torques, or the output exists.
    """
    from vgps_ros.bags import BagReader
    from vgps_ros.bags.episode import last_episode, write_table

    with BagReader(path) as bag:
        description, states = (
            bag.needed_topic(name) for name in ("robot_description", "joint_states")
        )
        mjcf = bag.decode(next(bag.messages([description]))).data
        episode = last_episode(bag, states, mjcf)
    if episode is None:
        raise InvalidInputError(f"'{path}' has no motion: it needs two states at least.")
    write_table(episode, output)
    print(f"Wrote {len(episode.time)} states, {episode.time[-1]:g} s, to {output}.")


def make_whole(path: Path) -> None:
    """Rebuilds what a killed recorder left undone.

    Raises:
        VgpsError: nothing can be read.
    """
    from vgps_ros.bags.reindex import missing_parts, reindex

    if not missing_parts(path):
        print(f"'{path}' is whole; there is nothing to rebuild.")
        return
    for file in reindex(path):
        print(f"Rebuilt the index of {file}; {file.name}.unfinished is what was there before.")
    print(f"Rebuilt {path / 'metadata.yaml'}.")


def _content(path: Path) -> dict[str, Any]:
    from vgps_ros.bags import BagReader

    with BagReader(path) as bag:
        seconds = bag.duration * 1e-9
        return {
            "messages": sum(bag.counts.values()),
            "start": bag.start * 1e-9 if any(bag.counts.values()) else 0.0,
            "duration": seconds,
            "size": sum(file.stat().st_size for file in path.glob("*.mcap")),
            "topics": [
                {
                    "name": topic,
                    "type": kind,
                    "messages": bag.counts[topic],
                    "rate": bag.counts[topic] / seconds if seconds else None,
                }
                for topic, kind in sorted(bag.topics.items())
            ],
            "attachments": {name: yaml.safe_load(text) for name, text in bag.attachments().items()},
        }


def add_arguments(parser: Parser) -> None:
    """Declares the arguments of the command."""
    commands = parser.add_subparsers(metavar="COMMAND", dest="action", required=True)

    def add(name: str, text: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=text)
        command.add_argument("bag", type=Path, help="folder of the bag")
        return command

    add("info", "Prints topics, parameters and versions.").add_argument(
        "--json", action="store_true", help="print JSON instead of tables"
    )
    add("check", "Checks that the torques are those that the policy gives; ends with 1 if not.")
    add("rerun", "Writes the bag as a Rerun recording.").add_argument(
        "--output", type=Path, help="file to write, which must not exist; default BAG.rrd"
    )
    add("table", "Writes the last motion as a table that can be a demonstration.").add_argument(
        "--output", type=Path, help="CSV to write, which must not exist; default BAG.csv"
    )
    add("reindex", "Rebuilds metadata.yaml and the index after a recorder was killed.")


def run(arguments: argparse.Namespace) -> None:
    """Does to the bag what the arguments say."""
    bag = arguments.bag
    match arguments.action:
        case "info":
            info(bag, as_json=arguments.json)
        case "check":
            check(bag)
        case "rerun":
            to_rerun(bag, arguments.output or bag.resolve().with_suffix(".rrd"))
        case "table":
            to_table(bag, arguments.output or bag.resolve().with_suffix(".csv"))
        case "reindex":
            make_whole(bag)
