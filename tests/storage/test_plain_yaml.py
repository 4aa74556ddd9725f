# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""YAML of strangers is read as plain values, in bounded memory."""

import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage import files
from vgps_ros.storage.files import read_yaml


@pytest.mark.parametrize("empty", ["", "# nothing but words\n", b""])
def test_a_text_without_values_is_none(empty):
    assert read_yaml(empty, "The file") is None


def test_values_come_as_yaml_has_them_and_shared_ones_at_each_place():
    text = "base: &b {x: 1.5, on: [a, null]}\nagain: *b\nmerged: {<<: *b, x: 2}\n"
    base = {"x": 1.5, True: ["a", None]}
    assert read_yaml(text, "It") == {"base": base, "again": base, "merged": {**base, "x": 2}}
    assert read_yaml(text.encode(), "It") == read_yaml(text, "It")


def test_aliases_that_stand_for_a_billion_values_are_not_followed():
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 10)]
    with pytest.raises(InvalidInputError, match=r"is no YAML .* for more than 1000000 values"):
        read_yaml("\n".join(lines), "The file")


def test_many_values_are_read_where_they_stand_in_the_text():
    assert read_yaml(f"[{', '.join(['1'] * 2000)}]", "It") == [1] * 2000


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("&a [*a]", "nested too deeply, or holds itself"),
        ("[" * 101 + "]" * 101, "nested too deeply"),
        ("[" * 5000, "is no YAML"),
        ("a: [1", "is no YAML"),
        ("\x02", "is no YAML"),
        ("!!python/object/apply:os.system [ls]", "is no YAML .* could not determine a constructor"),
        ("? [1]\n: 2", "is no YAML .* unhashable"),
        ("a: 2026-99-99", "is no YAML .* month must be"),
        (b"\xff\xfe\xfa", "is no YAML"),
    ],
)
def test_what_is_no_plain_yaml_is_refused_with_a_sentence(text, sentence):
    with pytest.raises(InvalidInputError, match=rf"(?s)^The file.*{sentence}.*\.$"):
        read_yaml(text, "The file")


def test_a_hundred_levels_are_read():
    found = read_yaml("[" * 99 + "]" * 99, "It")
    for _ in range(98):
        (found,) = found
    assert found == []


def test_a_text_that_is_too_large_is_not_parsed(monkeypatch):
    monkeypatch.setattr(files, "_LARGEST", 8)
    assert read_yaml("[1, 2,3]", "It") == [1, 2, 3]
    with pytest.raises(InvalidInputError, match="it has 9 characters, and at most 8 are read"):
        read_yaml("[1, 2, 3]", "It")
