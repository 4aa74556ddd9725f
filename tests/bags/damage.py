# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Damages bags at random and runs every reader: no traceback, and no loss beyond what was hit.

python -m tests.bags.damage --count 2000 --seed 7
"""

import argparse
import contextlib
import io
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from random import Random
from typing import NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk

from vgps_ros.bags import BagReader, BagWriter
from vgps_ros.programs.__main__ import main as vgps

SAMPLE = Path(__file__).parents[2] / "recordings" / "sample"
TOOLS = ("info", "check", "rerun", "table", "plot", "reindex")
MOST_SECONDS = 20.0  # of the processor, for one tool on a small bag
KINDS = (
    *("bit", "bits", "cut", "zeros", "garbage", "length", "without", "doubled"),
    *("metadata", "digests", "foreign", "missing", "device"),
)


def small_bag(path: Path, source: Path) -> Path:
    """Writes the first seconds of a bag, in many chunks."""
    writer = BagWriter(path, compression="zstd")
    taken: Counter[str] = Counter()
    with BagReader(source) as bag:
        for topic, kind in bag.topics.items():
            writer.add_topic(topic, kind, bag.type_hashes[topic], bag.qos[topic])
        for name, text in bag.attachments().items():
            writer.attach(name, text, bag.start)
        for i, message in enumerate(bag.messages()):
            taken[message.topic] += 1
            if taken[message.topic] <= (1 if "distribution" in message.topic else 80):
                writer.write(message.topic, message.stamp, message.data)
            if i % 50 == 0:
                writer.flush()
    writer.close()
    return path


def damage(bag: Path, kind: str, rng: Random) -> None:
    """Damages a bag."""
    [file] = bag.glob("*.mcap")
    stretches = [(chunk.begin, chunk.end) for chunk in chunks(file)]
    if kind in ("metadata", "digests"):
        file, kind = bag / ("metadata.yaml" if kind == "metadata" else "SHA256SUMS"), "bits"
    if kind in ("device", "missing"):
        file.unlink()
        if kind == "device":
            os.symlink("/dev/zero", file)
        return
    data = bytearray(file.read_bytes())
    (begin, end), (other, _) = sorted(rng.sample(stretches, 2))
    at = rng.randrange(len(data))
    if kind in ("bit", "bits"):
        for _ in range(1 if kind == "bit" else rng.randrange(2, 20)):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del data[at:]
    elif kind == "zeros":
        data[at : at + rng.randrange(1, 5000)] = b""
    elif kind == "garbage":
        data[at:at] = rng.randbytes(rng.randrange(1, 5000))
    elif kind == "length":
        size = rng.choice((0, 1, 2**31, 2**63, rng.randrange(len(data))))
        data[begin + 1 : begin + 9] = size.to_bytes(8, "little")
    elif kind == "without":
        del data[begin:end]
    elif kind == "doubled":
        data[other:other] = data[begin:end]
    elif kind == "foreign":
        data = bytearray(rng.choice((b"", b"SQLite format 3\0", b"\x89MCAP0\r\n")))
        data += rng.randbytes(rng.randrange(5000))
    file.write_bytes(data)


class StoredChunk(NamedTuple):
    """Where a chunk and its indexes of messages begin and end, and where its data stands."""

    begin: int
    end: int
    data: range
    messages: list[Message]


def chunks(file: Path) -> list[StoredChunk]:
    """The chunks of a whole file."""
    found = []
    with file.open("rb") as stream:
        for index in make_reader(stream).get_summary().chunk_indexes:
            begin, end = index.chunk_start_offset, index.chunk_start_offset + index.chunk_length
            stream.seek(begin + 9)
            records = breakup_chunk(Chunk.read(ReadDataStream(stream)))
            messages = [record for record in records if isinstance(record, Message)]
            data = range(end - index.compressed_size, end)
            found.append(StoredChunk(begin, end + index.message_index_length, data, messages))
    return found


def whole_messages(bag: Path, original: Path) -> set[tuple[int, bytes]]:
    """The messages that must still be read, with their times.

    They are those of the chunks before the first damage. Where a single bit of a chunk's data is
    damaged, they are those of all other chunks.
    """
    [before] = original.glob("*.mcap")
    files = [file for file in bag.glob("*.mcap") if file.is_file()]
    if not files:
        return set()
    data, whole = files[0].read_bytes(), before.read_bytes()
    pairs = zip(data, whole, strict=False)
    differing = [i for i, (a, b) in enumerate(pairs) if a != b]
    first = min([*differing, len(data), len(whole)])
    is_one_byte = len(data) == len(whole) and len(differing) == 1
    kept, is_framed = set(), False
    for chunk in chunks(before):
        if chunk.begin <= first < chunk.end:
            is_framed = is_one_byte and first in chunk.data
        elif chunk.end <= first or is_framed:
            kept |= {(message.log_time, message.data) for message in chunk.messages}
    return kept


def run(tool: str, bag: Path) -> str:
    """Runs a tool; returns what is wrong with how it ended."""
    output = bag.with_suffix(".rrd" if tool == "rerun" else ".out")
    words = ["plot", str(bag)] if tool == "plot" else ["bag", tool, str(bag)]
    if tool in ("rerun", "table", "plot"):
        words += ["--output", str(output)]
    began = time.process_time()
    heard, code = io.StringIO(), 0
    with contextlib.redirect_stdout(heard), contextlib.redirect_stderr(heard):
        try:
            vgps(words)
        except SystemExit as stop:
            code = stop.code or 0
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # also a panic of Rerun's
            return f"{type(error).__name__}: {error!s:.200}"
    if time.process_time() - began > MOST_SECONDS:
        return f"it took {time.process_time() - began:.0f} s of the processor"
    if code and tool == "rerun" and output.exists():
        return "half a recording is left"
    return ""


def try_one(original: Path, folder: Path, kind: str, tools: tuple[str, ...], rng: Random) -> str:
    """Damages a copy and runs tools on it; returns what is wrong."""
    bag = folder / "bag"
    shutil.copytree(original, bag)
    damage(bag, kind, rng)
    expected = whole_messages(bag, original)
    for tool in tools:
        if wrong := run(tool, bag):
            return f"{tool}: {wrong}"
    if expected:
        if wrong := run("reindex", bag):
            return f"reindex: {wrong}"
        with BagReader(bag) as reader:
            found = {(m.stamp, m.data) for m in reader.messages()}
        if lost := expected - found:
            return f"{len(lost)} of {len(expected)} whole messages are lost"
    return ""


def campaign(source: Path, count: int, seed: int, tools: int) -> list[str]:
    """Damages a small bag in many ways, tries some tools each time; returns what went wrong."""
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        original = small_bag(Path(folder, "original"), source)
        for i in range(count):
            rng, kind = Random(f"{seed}-{i}"), KINDS[(seed + i) % len(KINDS)]
            with tempfile.TemporaryDirectory(dir=folder) as own:
                some = tuple(rng.sample(TOOLS, tools))
                if found := try_one(original, Path(own), kind, some, rng):
                    wrong.append(f"damage {i} ({kind}): {found}")
                    print(wrong[-1], flush=True)
            if (i + 1) % 100 == 0:
                print(f"{i + 1} damages: {len(wrong)} went wrong.", flush=True)
    return wrong


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bag", type=Path, default=SAMPLE, help="of which a part is damaged")
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    failures = campaign(arguments.bag, arguments.count, arguments.seed, len(TOOLS))
    print(f"{arguments.count} damages of seed {arguments.seed}: {len(failures)} went wrong.")
    sys.exit(bool(failures))
