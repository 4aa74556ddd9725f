# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Trajectory distributions in files."""

import resource
import zipfile

import numpy as np
import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.storage.run_folder import load_distributions, save_distributions


def arrays_of(q):
    mean, linear = q.mean, q.linear_dynamics
    return (
        *(mean.states, mean.controls, q.gains, q.control_covariances),
        *(linear.f_x, linear.f_u, q.state_covariances),
    )


def test_what_is_written_is_read_back_bit_for_bit_and_nothing_else_is_left(
    random_distribution, tmp_path
):
    written = [random_distribution() for _ in range(3)]
    save_distributions(written, "swimmer", tmp_path / "q.npz")
    read, task = load_distributions(tmp_path / "q.npz")
    assert task == "swimmer"
    assert len(read) == 3
    for before, after in zip(written, read, strict=True):
        for own, other in zip(arrays_of(before), arrays_of(after), strict=True):
            np.testing.assert_array_equal(own, other)
    assert [file.name for file in tmp_path.iterdir()] == ["q.npz"]


def test_a_wrong_file_is_refused_with_a_sentence(random_distribution, tmp_path):
    file = tmp_path / "q.npz"
    with pytest.raises(InvalidInputError, match="not a readable distribution file"):
        load_distributions(file)
    save_distributions([random_distribution()], "swimmer", file)
    whole = file.read_bytes()
    with np.load(file) as loaded:
        good = dict(loaded)

    def refused(sentence):
        with pytest.raises(InvalidInputError, match=sentence):
            load_distributions(file)

    for part in (b"", b"text", whole[:100], whole[: len(whole) // 2]):
        file.write_bytes(part)
        refused("distribution")
    for name, wrong, sentence in (
        ("gains", good["gains"][:, :2], "gains has shape"),
        ("f_x", good["f_x"] * np.nan, "f_x is nan"),
        ("controls", good["controls"][0], "holds no distributions"),
        ("states", np.array("text"), "holds no distributions"),
        ("states", np.array([{"no": "pickle"}]), "holds no distributions"),
    ):
        np.savez(file, **{**good, name: wrong})
        refused(sentence)
    del good["state_covariances"]
    np.savez(file, **good)
    refused("state_covariances")
    with file.open("wb") as stream:
        np.save(stream, np.eye(2))
    refused("holds no distributions")
    no_states = np.empty((10**9, 0, 3))
    np.savez(file, **{**dict.fromkeys(good, no_states), "controls": np.empty((10**9, 0, 1))})
    refused("it has no states")


def test_an_archive_takes_no_more_memory_than_its_file_has_bytes(random_distribution, tmp_path):
    file = tmp_path / "q.npz"
    save_distributions([random_distribution()], "swimmer", file)
    with np.load(file) as loaded:
        good = dict(loaded)
    np.savez_compressed(file, **{**good, "gains": np.zeros((50, 1000, 1000))})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InvalidInputError, match=r"bytes would become 4000.*save it uncompressed"):
        load_distributions(file)
    np.savez_compressed(file, **{name: np.random.default_rng(0).bytes(8) for name in good})
    with pytest.raises(InvalidInputError, match="save it uncompressed"):
        load_distributions(file)
    # An array that says that it is larger than what follows.
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**8,)}
    with zipfile.ZipFile(file, "w") as archive, archive.open("states.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, header)
        member.write(bytes(80))
    with pytest.raises(InvalidInputError, match=r"EOF|allocate"):
        load_distributions(file)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # [KiB]


@pytest.mark.parametrize("seed", range(3))
def test_bytes_that_are_changed_are_refused_or_harmless(random_distribution, tmp_path, seed):
    file = tmp_path / "q.npz"
    save_distributions([random_distribution()], "swimmer", file)
    whole = bytearray(file.read_bytes())
    draws = np.random.default_rng(seed)
    refused = 0
    for _ in range(100):
        changed = bytearray(whole)
        changed[draws.integers(len(whole))] ^= int(draws.integers(1, 256))
        file.write_bytes(changed)
        try:
            load_distributions(file)
        except InvalidInputError:  # any other would fail the test
            refused += 1
    assert refused > 50  # the archive has checksums
