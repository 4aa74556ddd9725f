# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Runs that stop and go on: not one bit is different, and no file can do harm."""

import dataclasses
import io
import json
import os
import shutil
import zipfile

import numpy as np
import pytest

from tests.search.test_methods import solver
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.optimizer_settings import DdpSettings
from vgps_ros.search.checkpoints import Checkpoints, Run
from vgps_ros.search.iteration import SearchState
from vgps_ros.search.methods import METHODS, search
from vgps_ros.search.settings import MirrorSettings, search_settings
from vgps_ros.search.workspace import Workspace
from vgps_ros.storage.files import part_of, to_tree
from vgps_ros.tasks import make_task
from vgps_ros.tasks.disturbance import DisturbanceSettings
from vgps_ros.tasks.registry import task_file_of

ROTOR = make_task("rotor")
SETTINGS = dataclasses.replace(
    search_settings(ROTOR),
    iterations=4,
    hidden_units=(3,),
    evaluation_rollouts=2,
    supervised_iterations=50,
    policy_rollouts=4,
    situations=2,
    disturb=DisturbanceSettings(payload=0.1, push=0.1),
)
RUN = Run("vgps", ROTOR, SETTINGS, 3)


def run(folder, said=None, method="vgps", seed=3, **settings):
    """Yields the iterations of a run that keeps checkpoints in a folder."""
    tell = (lambda _: None) if said is None else said.append
    chosen = dataclasses.replace(SETTINGS, **settings)
    return search(method, ROTOR, chosen, seed, solver(ROTOR), Checkpoints(folder, tell))


def bits(iteration):
    """All that an iteration ends with but wall times, and the bytes of its arrays."""
    arrays: dict = {}
    tree = to_tree((iteration.policy, iteration.initial_solutions, iteration.solutions), arrays)
    history = [
        {k: v for k, v in vars(figures).items() if not k.endswith("_seconds")}
        for figures in iteration.history
    ]
    return tree, history, {name: array.tobytes() for name, array in arrays.items()}


def stopped_after(k, folder, **options):
    """Leaves what a run leaves that is killed once iteration k is kept."""
    for iteration in run(folder, **options):
        if iteration.k == k:
            return iteration
    raise AssertionError(f"There was no iteration {k}.")


@pytest.mark.parametrize(
    ("method", "own", "stops"),
    [
        *((method, {}, (1, 2, 3, 4) if method == "vgps" else (2,)) for method in METHODS),
        ("mdgps", {"mirror": MirrorSettings("fitted")}, (2,)),
    ],
)
def test_a_run_that_stops_after_an_iteration_ends_with_the_same_bits(method, own, stops, tmp_path):
    undisturbed = []
    for iteration in run(tmp_path / "all", method=method, **own):
        undisturbed.append(bits(iteration))
        shutil.copytree(tmp_path / "all", tmp_path / str(iteration.k))
    for k in stops:
        found = list(run(tmp_path / str(k), method=method, **own))
        # The last one is told again, so that whoever listens gets the policy at once.
        assert [bits(iteration) for iteration in found] == undisturbed[k - 1 :]
        assert [iteration.k for iteration in found] == list(range(k, 5))


def test_a_run_that_stops_again_and_again_ends_with_the_same_bits(tmp_path):
    *_, undisturbed = run(tmp_path / "undisturbed", method="adaptive_gps")
    said: list[str] = []
    for k in range(1, 5):
        last = stopped_after(k, tmp_path / "stopped", said=said, method="adaptive_gps")
    assert bits(last) == bits(undisturbed)
    assert said == [f"Going on from iteration {k} of 4." for k in (1, 2, 3)]


def test_the_initial_solve_is_not_done_twice(tmp_path):
    requests = []

    def fails_later(batch):
        requests.extend(request.iteration for request in batch)
        if batch[0].iteration > 0:
            raise InterruptedError
        return solver(ROTOR)(batch)

    for _ in range(2):
        with pytest.raises(InterruptedError):
            next(search("vgps", ROTOR, SETTINGS, 3, fails_later, Checkpoints(tmp_path)))
    assert requests == [0, 0, 1, 1, 1, 1]
    *_, last = run(tmp_path)
    *_, undisturbed = search("vgps", ROTOR, SETTINGS, 3, solver(ROTOR))
    assert bits(last) == bits(undisturbed)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """The folder of a run that stopped after iteration 3, and what iteration 2 had ended with."""
    folder = tmp_path_factory.mktemp("kept")
    stopped_after(2, folder)
    second = stopped_after(2, folder)
    stopped_after(3, folder)
    return folder, second


@pytest.fixture
def folder(kept, tmp_path):
    return shutil.copytree(kept[0], tmp_path / "copy")


NEWEST, OLDER = "checkpoint-1.npz", "checkpoint-0.npz"  # of iterations 3 and 2


def test_the_last_two_are_kept(folder):
    assert sorted(f.name for f in folder.iterdir()) == [OLDER, NEWEST]
    assert next(run(folder)).k == 3
    (folder / NEWEST).unlink()
    assert next(run(folder)).k == 2


def truncated(content, rng):
    return content[: rng.integers(len(content))]


def empty(content, rng):
    return b""


def flipped(content, rng):
    """With one bit changed in each of a thousand places."""
    found = bytearray(content)
    for place in rng.integers(len(content), size=1000):
        found[place] ^= 1 << rng.integers(8)
    return bytes(found)


def overwritten(content, rng):
    """With a page of the disk lost."""
    start = rng.integers(len(content) - 4096)
    return content[:start] + bytes(4096) + content[start + 4096 :]


def noise(content, rng):
    return rng.bytes(len(content))


@pytest.mark.parametrize("damage", [truncated, empty, flipped, overwritten, noise])
@pytest.mark.parametrize("seed", range(5))
def test_one_that_is_damaged_is_refused_and_the_one_before_is_used(kept, folder, damage, seed):
    path = folder / NEWEST
    path.write_bytes(damage(path.read_bytes(), np.random.default_rng(seed)))
    said: list[str] = []
    assert bits(next(run(folder, said))) == bits(kept[1])
    assert said[0].startswith(f"'{path}' is not a whole checkpoint and is left out: ")
    assert said[1:] == ["Going on from iteration 2 of 4."]


def test_one_flipped_bit_anywhere_changes_no_number(kept, folder, rng):
    """It is found by a check sum, or lies where nothing is read."""
    path, whole = folder / NEWEST, (folder / NEWEST).read_bytes()
    third = bits(next(run(folder)))
    refused = 0
    for place in rng.integers(len(whole), size=40):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << rng.integers(8)
        path.write_bytes(flipped)
        said: list[str] = []
        found = bits(next(run(folder, said)))
        refused += len(said) > 1
        assert found == (third if len(said) == 1 else bits(kept[1]))
    assert refused > 30


def test_if_both_are_damaged_the_training_begins_anew(folder):
    for path in folder.iterdir():
        path.write_bytes(b"PK")
    said: list[str] = []
    iterations = list(run(folder, said))
    assert [i.k for i in iterations] == [1, 2, 3, 4]
    assert said[-1] == "There is no whole checkpoint: the training begins anew."
    *_, undisturbed = search("vgps", ROTOR, SETTINGS, 3, solver(ROTOR))
    assert bits(iterations[-1]) == bits(undisturbed)


@pytest.mark.parametrize(
    ("change", "theirs", "ours"),
    [
        ({"seed": 4}, "seed 3", "seed 4"),
        ({"method": "gps"}, "method vgps", "method gps"),
        ({"hidden_units": (5, 2)}, "hidden_units [3]", "hidden_units [5, 2]"),
        ({"iterations": 9}, "iterations 4", "iterations 9"),
        ({"ddp_iterations": 9}, "ddp_iterations 3", "ddp_iterations 9"),
        ({"visited_limit": 1.0}, "visited_limit 2.0", "visited_limit 1.0"),
    ],
)
def test_those_of_another_run_are_refused_and_stay(folder, change, theirs, ours):
    before = {f.name: f.read_bytes() for f in folder.iterdir()}
    said: list[str] = []
    with pytest.raises(InvalidInputError) as refusal:
        next(run(folder, said, **change))
    assert f"belongs to a training with {theirs}, but this one has {ours};" in str(refusal.value)
    assert f"or remove '{folder}' to begin anew" in str(refusal.value)
    assert said == []  # the refusal says it, once
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == before


def test_those_of_a_run_that_began_with_another_policy_are_refused(folder):
    policy = Workspace(ROTOR, SETTINGS, 3, solver(ROTOR)).first_policy()
    known = Checkpoints(folder)
    with pytest.raises(InvalidInputError, match="with first policy None, but this one has first"):
        next(search("vgps", ROTOR, SETTINGS, 3, solver(ROTOR), known, policy))


def test_those_of_another_run_are_replaced_where_that_is_asked_for_and_other_files_stay(folder):
    (folder / "notes.txt").write_text("mine")
    said: list[str] = []
    checkpoints = Checkpoints(folder, said.append, overwrite=True)
    assert next(search("vgps", ROTOR, SETTINGS, 4, solver(ROTOR), checkpoints)).k == 1
    assert said == [f"The checkpoints of another training in '{folder}' are replaced."]
    assert (folder / "notes.txt").read_text() == "mine"


def test_that_of_another_task_or_demonstration_is_refused(folder):
    demonstrated = dataclasses.replace(ROTOR, lookahead=1)
    for task in (make_task("swimmer"), demonstrated):
        with pytest.raises(InvalidInputError, match="belongs to a training with"):
            Checkpoints(folder).latest(dataclasses.replace(RUN, task=task), METHODS["vgps"].update)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("task.yaml", "weight: 0.1", "weight: 0.2"),
        ("task.yaml", "control_period: 0.05 ", "control_period: 0.1 "),
        ("task.yaml", "cost:", "fallen: [{sensor: rotor/velocity, beyond: 9.0}]\ncost:"),
        ("task.yaml", "cost:", "begin: {law: noise, std: 0.1}\ncost:"),
        ("task.yaml", "cost:", "begin: {law: pd, stiffness: 2.0}\ncost:"),
        ("rotor.xml", 'mass="1"', 'mass="2"'),
    ],
)
def test_that_of_a_changed_task_is_refused_in_one_process_and_in_a_graph(tmp_path, file, old, new):
    copied = shutil.copytree(task_file_of("rotor").parent, tmp_path / "rotor")
    begun, again = (Run("vgps", make_task(str(copied)), SETTINGS, 3) for _ in range(2))
    assert begun.identity() == again.identity()
    text = (copied / file).read_text()
    assert old in text
    (copied / file).write_text(text.replace(old, new))
    changed = dataclasses.replace(begun, task=make_task(str(copied)))
    checkpoints = Checkpoints(tmp_path / "kept")
    checkpoints.save(begun, SearchState((), 0, (), None))
    with pytest.raises(InvalidInputError, match=r"The task has changed since: '.*checkpoint-0"):
        checkpoints.latest(changed, METHODS["vgps"].update)
    assert begun.name() != changed.name()  # a learner in a graph names its folder so


def test_that_of_another_optimizer_is_refused_with_its_setting(folder):
    changed = dataclasses.replace(ROTOR.optimizer, policy_samples=1)
    other = dataclasses.replace(RUN, task=dataclasses.replace(ROTOR, optimizer=changed))
    sentence = "a training with policy_samples 10, but this one has policy_samples 1; name another"
    with pytest.raises(InvalidInputError, match=sentence):
        Checkpoints(folder).latest(other, METHODS["vgps"].update)


def test_a_solve_by_other_settings_ends_the_run(folder, tmp_path):
    """As where one of several optimizers has them, or where it comes back with them."""
    changed = dataclasses.replace(ROTOR.optimizer, ddp=DdpSettings(regularization_floor=1e-3))
    other = solver(dataclasses.replace(ROTOR, optimizer=changed))
    sentence = (
        "solves with ddp.regularization_floor 0.001, but the training was begun with .* 1e-06"
    )
    resumed = search("vgps", ROTOR, SETTINGS, 3, other, Checkpoints(folder))
    assert next(resumed).k == 3
    with pytest.raises(InvalidInputError, match=sentence):
        next(resumed)

    def by_turns(requests):
        mine, *theirs = requests
        return [*solver(ROTOR)([mine]), *other(theirs)]

    with pytest.raises(InvalidInputError, match=sentence):
        next(search("vgps", ROTOR, SETTINGS, 3, by_turns))


def test_where_only_the_newest_is_of_another_run_the_one_before_is_used(kept, folder, tmp_path):
    stopped_after(3, tmp_path / "other", seed=4)
    shutil.copy(tmp_path / "other" / NEWEST, folder / NEWEST)
    said: list[str] = []
    assert bits(next(run(folder, said))) == bits(kept[1])
    assert "seed 4, but this one has seed 3" in said[0]


def edited(path, edit):
    """Replaces an archive by one whose content was changed, with right check sums."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    content = json.loads(arrays["content"].tobytes())
    edit(content, arrays)
    arrays["content"] = np.frombuffer(json.dumps(content).encode(), np.uint8)
    np.savez(path, **arrays)


def other_record(content, arrays):
    content["state"]["last"]["record"] = "GuidedUpdate"


def without_a_field(content, arrays):
    del content["state"]["last"]["policy"]["noise_std"]


def with_a_text_for_a_number(content, arrays):
    content["state"]["history"][0]["alpha"] = "1.0"


@pytest.mark.parametrize("edit", [other_record, without_a_field, with_a_text_for_a_number])
def test_one_whose_records_are_others_is_refused(kept, folder, edit):
    edited(folder / NEWEST, edit)
    said: list[str] = []
    assert bits(next(run(folder, said))) == bits(kept[1])
    assert "is not a whole checkpoint and is left out: " in said[0]


class Trap:
    """Its pickle makes a folder when it is loaded."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("name", ["content", "array_0"])
def test_a_pickle_is_refused_and_its_code_does_not_run(kept, folder, tmp_path, name):
    with np.load(folder / NEWEST) as file:
        arrays = {key: file[key] for key in file.files}
    arrays[name] = np.array([Trap(tmp_path / "sprung")], dtype=object)
    np.savez(folder / NEWEST, **arrays)  # NumPy writes an array of objects as a pickle
    with zipfile.ZipFile(folder / NEWEST) as archive:
        assert b"mkdir" in archive.read(f"{name}.npy")
    said: list[str] = []
    assert bits(next(run(folder, said))) == bits(kept[1])
    assert "allow_pickle=False" in said[0]
    assert not (tmp_path / "sprung").exists()


def test_a_bare_pickle_is_refused(kept, folder, tmp_path):
    stream = io.BytesIO()
    np.save(stream, np.array(Trap(tmp_path / "sprung"), dtype=object), allow_pickle=True)
    for content in (stream.getvalue(), stream.getvalue()[128:]):
        (folder / NEWEST).write_bytes(content)
        assert bits(next(run(folder))) == bits(kept[1])
    assert not (tmp_path / "sprung").exists()


def test_a_folder_that_cannot_be_written_is_an_error_that_leaves_no_part(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        next(run(tmp_path / "file"))
    assert (tmp_path / "file").read_text() == ""


def test_a_full_disk_keeps_the_two_that_are_there(folder):
    before = {f.name: f.read_bytes() for f in folder.iterdir()}
    part_of(folder / OLDER).symlink_to("/dev/full")
    iterations = run(folder)
    assert next(iterations).k == 3
    with pytest.raises(OSError, match="No space left on device"):
        next(iterations)
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == before


def test_removal_takes_only_what_it_has_made(folder):
    (folder / "notes.txt").write_text("mine")
    Checkpoints(folder).remove()
    assert [f.name for f in folder.iterdir()] == ["notes.txt"]
    (folder / "notes.txt").unlink()
    Checkpoints(folder).remove()
    assert not folder.exists()
