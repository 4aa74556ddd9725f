# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The manifest of a bag: every altered byte is found, and a signature names its signer."""

import json
import subprocess

import pytest
from rosbags.typesys import Stores, get_typestore

from vgps_ros.bags import BagWriter
from vgps_ros.bags.manifest import FILE_NAME, check_manifest, sign, signer
from vgps_ros.core.errors import InvalidInputError

KIND = "sensor_msgs/msg/JointState"
HASH = get_typestore(Stores.ROS2_JAZZY).hash_rihs01(KIND)


@pytest.fixture
def bag(tmp_path):
    """Two files of three chunks each, the attachments among them."""
    writer = BagWriter(tmp_path / "bag", max_file_duration=20)
    writer.attach("parameters.yaml", "seed: 3", 1)
    writer.add_topic("/a", KIND, HASH, [])
    for i in range(1, 41):
        writer.write("/a", i, bytes([i] * 60))
        if i % 10 == 0:
            writer.flush()
    writer.lost = 2
    writer.close()
    return writer.path


@pytest.fixture
def key(tmp_path):
    path = tmp_path / "key"
    subprocess.run(
        ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "test", "-f", path], check=True
    )
    return path


def test_what_the_recorder_closed_is_proven(bag):
    found = check_manifest(bag)
    assert (found.chunks, found.files, found.wrong, found.lost) == (6, 2, [], 2)
    assert found.messages == {"/a": 40}


def test_each_file_has_the_digest_that_other_tools_compute(bag):
    files = json.loads((bag / FILE_NAME).read_text())["files"]
    for name, file in files.items():
        run = subprocess.run(["sha256sum", bag / name], capture_output=True, text=True, check=True)
        assert run.stdout.split()[0] == file["sha256"]


def test_any_altered_byte_is_found_in_its_chunk(bag):
    file = bag / "bag_1.mcap"
    whole = file.read_bytes()
    chunks = json.loads((bag / FILE_NAME).read_text())["files"]["bag_1.mcap"]["chunks"]
    for at in range(0, len(whole), 37):
        file.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        hit = [begin for begin, end, _ in chunks if begin <= at < end]
        wanted = f"the chunk at byte {hit[0]} of" if hit else "bag_1.mcap is altered outside"
        found = check_manifest(bag)
        assert len(found.wrong) == 1
        assert wanted in found.wrong[0]
        assert (found.chunks, found.files) == (6 - len(hit), 1)


def test_a_missing_and_a_foreign_file_are_found(bag):
    (bag / "bag_1.mcap").rename(bag / "bag_2.mcap")
    wrong = check_manifest(bag).wrong
    assert wrong == ["bag_2.mcap is not in the manifest", "bag_1.mcap is missing"]
    (bag / "metadata.yaml").write_text("{}")
    assert "metadata.yaml is not as the recorder wrote it" in check_manifest(bag).wrong


def test_a_bag_without_a_manifest_has_none_and_a_damaged_one_is_refused(bag):
    manifest = bag / FILE_NAME
    text = manifest.read_text()
    for damaged in (text[:50], "[]", text.replace('"format": 1', '"format": 9'), "[" * 10**5):
        manifest.write_text(damaged)
        with pytest.raises(InvalidInputError, match="is not a manifest of format 1"):
            check_manifest(bag)
    manifest.unlink()
    assert check_manifest(bag) is None


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('"lost": 2', '"lost": Infinity', "inf messages were lost"),
        ('"lost": 2', '"lost": true', "True messages were lost"),
        ('"/a": ', '"/a": -', "'/a' has -20 messages"),
        ('"chunks": [', '"chunks": [[-5, 3, ""],', "a chunk reaches from byte -5 to 3"),
        ('"chunks": [', f'"chunks": [[{2**70}, {2**71}, ""],', "a chunk reaches from byte 118"),
    ],
)
def test_a_manifest_of_impossible_numbers_is_refused(bag, old, new, sentence):
    manifest = bag / FILE_NAME
    text = json.dumps(json.loads(manifest.read_text()))
    assert old in text
    manifest.write_text(text.replace(old, new))
    with pytest.raises(InvalidInputError, match=f"is not a manifest of format 1: {sentence}"):
        check_manifest(bag)


def test_a_signature_names_its_signer_and_holds_for_the_manifest_alone(bag, key, tmp_path):
    signers = tmp_path / "signers"
    public = key.with_suffix(".pub").read_text()
    signers.write_text(f'walker@example.org namespaces="vgps-bag" {public}')
    with pytest.raises(InvalidInputError, match="is not signed"):
        signer(bag, signers)
    sign(bag, key)
    assert signer(bag, signers) == "walker@example.org"
    entry = signers.read_text()
    signers.write_text(f'# Ours\ngit@example.org namespaces="git" {public}\n{entry}')
    assert signer(bag, signers) == "walker@example.org"
    manifest = bag / FILE_NAME
    whole = manifest.read_text()
    manifest.write_text(whole.replace('"lost": 2', '"lost": 0'))
    with pytest.raises(InvalidInputError, match="ssh-keygen does not verify"):
        signer(bag, signers)
    manifest.write_text(whole)
    signers.write_text("")
    with pytest.raises(InvalidInputError, match="ssh-keygen does not find-principals"):
        signer(bag, signers)
    with pytest.raises(InvalidInputError, match="ssh-keygen does not sign"):
        sign(bag, tmp_path / "no_key")
