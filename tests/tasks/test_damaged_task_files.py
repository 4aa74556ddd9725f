# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Hundreds of damaged task files: each reads well, or gives one sentence, and nothing is executed.

DAMAGED_SEED changes how they are damaged.
"""

import os
import random
import re
from collections import Counter
from pathlib import Path

import pytest

from tests.tasks.hopper_file import HOPPER, TASK
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks.builder import load_task

COUNT = 500
SEED = int(os.environ.get("DAMAGED_SEED", "0"))
VALUES = [
    *("0.01 s", "1e999", "-1e999", ".nan", ".inf", "-1", "0", "9" * 400, "true", "null", "''"),
    *("[]", "{}", "[[]]", "{a: {b: c}}", "text", "'\\x00'", '"\\0"', '"\\ud800"'),
    *("../../etc/passwd", "~root", "/dev/zero", "&a [*a]", "*a"),
    *("!!python/object/apply:os.system ['touch EXECUTED']", "!!python/name:os.system"),
    *("!!python/object/new:subprocess.Popen [['touch', 'EXECUTED']]", "!!timestamp 2001-01-01"),
    *("!!float one", "2001-01-01", "1:2:3", "0x1f", "0o7", "1_0", "°C", "😀", "package://os/x"),
    *("package://../x", "package://vgps_ros/__init__.py", "{{7*7}}", "$(reboot)", "%s%n"),
    *("[" * 60 + "]" * 60, "{a: " * 60 + "}" * 60, "'" + "x" * 2000 + "'", "1.0e-4", "@", "`"),
]
MODELS = [
    *("", "<mujoco>", "<robot/>", "not xml", HOPPER.replace("hinge", "hing"), HOPPER[:700]),
    *(HOPPER.replace("qpos=", "qpos='1 2' x="), HOPPER.replace("0.05 0.2", "-1 0"), "\0\1\2"),
    HOPPER.replace("<worldbody>", "<include file='/etc/passwd'/><worldbody>"),
    HOPPER.replace("<actuator>", "<asset><mesh file='/etc/passwd'/></asset><actuator>"),
    HOPPER.replace('name="torso" pos', 'name="floor" pos'),
]


def tokens(text):
    """Returns the keys and values of a file, as spans."""
    return [found.span() for found in re.finditer(r"[^\s{}\[\],:#]+", text)]


def replaced(text, span, new):
    return text[: span[0]] + new + text[span[1] :]


def changed_token(rng, text):
    return replaced(text, rng.choice(tokens(text)), rng.choice(VALUES))


def misspelt_token(rng, text):
    begin, end = rng.choice(tokens(text))
    word = list(text[begin:end])
    word[rng.randrange(len(word))] = rng.choice("aeiouxyz_/*[?0")
    return replaced(text, (begin, end), "".join(word))


def swapped_tokens(rng, text):
    (a, b), (c, d) = sorted(rng.sample(tokens(text), 2))
    return text[:a] + text[c:d] + text[b:c] + text[a:b] + text[d:]


def dropped_line(rng, text):
    lines = text.splitlines(keepends=True)
    del lines[rng.randrange(len(lines))]
    return "".join(lines)


def moved_line(rng, text):
    lines = text.splitlines(keepends=True)
    lines.insert(rng.randrange(len(lines)), lines.pop(rng.randrange(len(lines))))
    return "".join(lines)


def repeated_line(rng, text):
    lines = text.splitlines(keepends=True)
    lines.insert(rng.randrange(len(lines)), rng.choice(lines))
    return "".join(lines)


def changed_indent(rng, text):
    lines = text.splitlines(keepends=True)
    at = rng.randrange(len(lines))
    lines[at] = rng.choice([" ", "    ", "\t", "- ", "? ", "--- "]) + lines[at].lstrip()
    return "".join(lines)


def truncated(rng, text):
    return text[: rng.randrange(len(text))]


def flipped_bits(rng, text):
    data = bytearray(text.encode())
    for _ in range(rng.randint(1, 5)):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def garbage(rng, text):
    return rng.randbytes(rng.randrange(1000))


def scaled_number(rng, text):
    span = rng.choice([found.span() for found in re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?", text)])
    return replaced(
        text, span, str(float(text[slice(*span)]) * rng.choice([-1, 0, 1e-9, 1e9, 1e300]))
    )


DAMAGES = [
    *(changed_token, changed_token, misspelt_token, misspelt_token, swapped_tokens, dropped_line),
    *(moved_line, repeated_line, changed_indent, truncated, flipped_bits, garbage, scaled_number),
]


def read(folder):
    """Returns the sentence that a task file gives; empty if it reads well."""
    try:
        load_task(folder / "task.yaml", "hopper")
    except InvalidInputError as error:
        return str(error)
    return ""


@pytest.fixture
def folder(folder, monkeypatch):
    monkeypatch.chdir(folder)
    return folder


def test_each_damaged_file_reads_well_or_gives_one_sentence(folder):
    rng, outcomes = random.Random(SEED), Counter()
    before = sorted(path.name for path in folder.iterdir())
    for i in range(COUNT):
        if i % 25 == 24:
            (folder / "hopper.xml").write_text(rng.choice(MODELS))
            text = TASK
        else:
            (folder / "hopper.xml").write_text(HOPPER)
            damage = DAMAGES[i % len(DAMAGES)]
            text = damage(rng, TASK)
        (folder / "task.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
        found = read(folder)
        outcomes["refused" if found else "read"] += 1
        assert "\n" not in found, (i, found)
        assert found.isprintable(), (i, found)
        assert found.endswith((".", "?")) or not found, (i, found)
        assert len(found) < 500, (i, found)
    assert outcomes["refused"] > COUNT / 2
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize("model", MODELS)
def test_a_model_that_does_not_compile_or_suit_is_named_in_one_sentence(folder, model):
    (folder / "hopper.xml").write_text(model)
    assert re.search(r"line \d+, (model|changes|sensors)\b.*\.$", read(folder)), read(folder)


def test_the_undamaged_file_reads_well(folder):
    assert read(folder) == ""
    assert Path.cwd() == folder
