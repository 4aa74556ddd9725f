# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The file that an executor drives by, beside the task that it was written of."""

import hashlib
import json
import math
from copy import deepcopy
from functools import reduce
from operator import getitem
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.onnx_models import elu_layers, elu_mean, elu_model
from tests.servo_arm import REMEMBERING, write_arm
from vgps_ros import tasks
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.policies.deployment_file import make_deployment, read_deployment, write_deployment
from vgps_ros.policies.driver import driver_of
from vgps_ros.policies.policy_file import open_policy
from vgps_ros.storage.files import to_tree
from vgps_ros.tasks import BUILT_IN, make_task


def arm(folder, *changes):
    """Makes the task of an arm with servos, with some texts changed."""
    text = REMEMBERING
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return make_task(write_arm(folder, task=text))


def again(task, folder):
    """Writes a task's deployment, and returns what is read of it."""
    write_deployment(task.deployment, folder / "robot.json")
    return read_deployment(folder / "robot.json")


def states_of(task, rng, count=20):
    """Draws states (N, n_x) around the task's start."""
    space = task.dynamics.space
    return space.add(task.initial_state, 0.5 * rng.standard_normal((count, space.tangent_dim)))


def same(one, other):
    """Compares two records with what they hold."""
    mine, its = {}, {}
    assert to_tree(one, mine) == to_tree(other, its)
    assert mine.keys() == its.keys()
    for name, array in mine.items():
        assert_array_equal(array, its[name])


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_deployment_says_of_a_built_in_task_what_the_task_says(name, tmp_path, rng):
    task = make_task(name)
    found, known = again(task, tmp_path), task.deployment
    for field in ("layout", "controls", "signals", "initial_state", "name", "mjcf", "horizon"):
        same(getattr(found, field), getattr(known, field))
    assert found.time_step == known.time_step
    assert found.keyframes.keys() == known.keyframes.keys()
    for key, pose in known.keyframes.items():
        assert_array_equal(found.pose("stand_keyframe", key), pose)

    states = states_of(task, rng)
    context = known.signals.constant_context(known.signals.rest, 1)[0]
    mine, its = (each.observation.within(context) for each in (found, known))
    assert mine.names == its.names
    for x in states:
        assert_allclose(mine(x), its(x), atol=1e-9)
    readings = [(mine.readings, its.readings), (found.limits.readings, known.limits.readings)]
    for read, wanted in readings:
        jacobians = rng.standard_normal((len(states), 3, len(read.names)))
        slopes = (each.pull_back(jacobians, states) for each in (read, wanted))
        assert_allclose(*slopes, atol=1e-6)
    same(found.limits.lowest, known.limits.lowest)
    same(found.limits.highest, known.limits.highest)
    assert [found.limits.broken(x) for x in states] == [known.limits.broken(x) for x in states]
    told = [found.read(found.sensors)(states), known.read(found.sensors)(states)]
    assert_allclose(*told, atol=1e-9)


def test_a_memory_is_kept(tmp_path):
    task = arm(tmp_path)
    found, known = again(task, tmp_path).observation, task.observation
    same(found.past, known.past)
    assert found.names == known.names
    assert found.past is not None


FEET = ("front_left", "front_right", "hind_left", "hind_right")


def quadruped(folder, *changes):
    """Makes the built-in quadruped's task with some texts changed."""
    path = Path(tasks.__file__).parent / "quadruped"
    text = (path / "task.yaml").read_text().replace("model: ", f"model: {path}/")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "task.yaml").write_text(text)
    return make_task(str(folder / "task.yaml"))


@pytest.mark.parametrize("place", ["observe: [", "limits: ["])
def test_what_only_the_model_can_tell_is_refused_by_name(place, tmp_path):
    """The height of a foot, which hangs on two hinges."""
    feet = [f"{{sensor: {at}_foot, index: z}}" for at in FEET]
    changes = {
        "observe: [": ("observe: [", f"observe: [{', '.join(feet)}, "),
        "limits: [": ("fallen:", f"limits: [{feet[0][:-1]}, below: -1.0}}]\nfallen:"),
    }
    task = quadruped(tmp_path, changes[place])
    with pytest.raises(InvalidInputError, match="reads 'front_left_foot/z', which follows from no"):
        write_deployment(task.deployment, tmp_path / "robot.json")
    assert not (tmp_path / "robot.json").exists()


def test_sensors_of_forces_are_left_out(tmp_path):
    task = quadruped(tmp_path, ("sensors:", "sensors:\n  felt: {type: accelerometer, site: imu}"))
    found = again(task, tmp_path)
    assert {"up/x", "turning/z", "velocity/y", "height/z"} <= set(found.sensors)
    assert not {"felt/x", "front_left_foot/z"} & set(found.sensors)
    with pytest.raises(InvalidInputError, match=r"no reading 'heigth/z'.*'height/z'"):
        found.read(["heigth/z"])
    with pytest.raises(InvalidInputError, match="stand_keyframe"):
        found.pose("stand_keyframe", "stnd")


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    folder = tmp_path_factory.mktemp("content")
    write_deployment(arm(folder).deployment, folder / "robot.json")
    return json.loads((folder / "robot.json").read_text())


def entries(tree, *keys):
    """Yields the keys that lead to each entry."""
    for key in tree:
        yield (*keys, key)
        if isinstance(tree[key], dict):
            yield from entries(tree[key], *keys, key)


@pytest.mark.parametrize("damage", [None, "word", -1])
def test_a_damaged_file_is_refused(content, damage, tmp_path):
    """Each entry is taken out, or another stands in its place."""
    file = tmp_path / "robot.json"
    for *keys, last in entries(content):
        tree = deepcopy(content)
        inner = reduce(getitem, keys, tree)
        was = inner.pop(last)
        if damage is not None:
            inner[last] = damage
        if damage == was:
            continue
        file.write_text(json.dumps(tree))
        with pytest.raises(
            InvalidInputError, match=r"is no deployment .*'vgps export --deployment'"
        ):
            read_deployment(file)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("time_step", value) for value in (0.0, -0.02, math.inf, math.nan, 1e308)),
        *(("horizon", value) for value in (0, -1)),
        *((("controls", "limits"), value) for value in ([], [{"array": "array_0"}])),
        *((("controls", of), []) for of in ("kinds", "units", "names")),
        *((("controls", "units", 0), unit) for unit in ("N·m", "deg", "rad/s", "", "\x1b[31m", 1)),
        *((("controls", "kinds", 0), kind) for kind in ("torque", "velocity", "brake", None)),
        *(
            ((of, "names", 0), name)
            for of in ("controls", "layout")
            for name in ("", "a\nb", "\x1b[31mred", "\u202eover", "x" * 10**6, 7, None)
        ),
        (("layout", "joints", 0), "elbow"),
        (("layout", "names", 0), "elbow/position"),
        (("controls", "names", 0), "shoulder"),
        *((("layout", "first_activation"), place) for place in (-1, 0, 99, 2**70)),
        (("layout", "names"), [f"j{i}/position" for i in range(10**5)]),
        *((("signals", of), value) for of in ("frequency", "time_step") for value in (-1.0, 1e300)),
        ("horizon", 2**70),
        (("keyframes",), ["home", "home"]),
        (("layout", "first_body"), "x" * 10**6),
        (("past", "history"), 2**60),
        ("record", "Deployment"),
        ("more", 1),
    ],
)
def test_a_forged_file_whose_digest_is_right_is_refused(content, key, value, tmp_path):
    tree = deepcopy(content)
    *keys, last = [key] if isinstance(key, str) else key
    reduce(getitem, keys, tree["deployment"])[last] = value
    tree["sha256"] = digest_of(tree)
    (tmp_path / "robot.json").write_text(json.dumps(tree))
    with pytest.raises(InvalidInputError, match="is no deployment") as refused:
        read_deployment(tmp_path / "robot.json")
    assert "has changed" not in str(refused.value)
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize("change", ["nan", "longer", "shorter", "flat", "a number", "nothing"])
def test_a_forged_array_is_refused(content, change, tmp_path):
    refused = 0
    for name, values in content["arrays"].items():
        tree, array = deepcopy(content), np.array(values, dtype=float)
        if not array.size or (change == "flat" and array.ndim == 1):
            continue
        array.flat[0] = np.nan if change == "nan" else array.flat[0]
        other = {
            "longer": lambda a=array: np.concatenate([a, a]),
            "shorter": lambda a=array: a[:-1],
            "flat": array.ravel,
            "a number": lambda: np.array(1.0),
            "nothing": lambda: np.empty(0),
        }
        changed = other.get(change, lambda a=array: a)()
        tree["arrays"][name] = np.where(np.isfinite(changed), changed, changed.astype(str)).tolist()
        tree["sha256"] = digest_of(tree)
        (tmp_path / "robot.json").write_text(json.dumps(tree))
        with pytest.raises(InvalidInputError, match=r"is no deployment \((?!its content)"):
            read_deployment(tmp_path / "robot.json")
        refused += 1
    assert refused > 1


def digest_of(tree):
    told = json.dumps([tree["deployment"], tree["arrays"]], sort_keys=True)
    return hashlib.sha256(told.encode()).hexdigest()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "is no deployment"),
        ("[1]", "is no deployment"),
        ("{}", "is no deployment"),
        ('{"format": 1}', "its format is 1, but this version reads 2"),
        ('{"layers": []}', "is no deployment"),
        ("\x00", "is no deployment"),
    ],
)
def test_another_file_is_refused(text, sentence, tmp_path):
    (tmp_path / "robot.json").write_text(text)
    with pytest.raises(InvalidInputError, match=sentence):
        make_deployment(str(tmp_path / "robot.json"))
    with pytest.raises(InvalidInputError, match="is no deployment"):
        read_deployment(tmp_path / "absent.json")


def test_a_third_party_policy_drives_with_its_gains(tmp_path, rng):
    task, layers = arm(tmp_path), elu_layers(6, 2)
    metadata = {
        "joint_names": "shoulder,elbow",
        "default_joint_pos": "-0.7,0.5",
        "action_scale": "0.25",
        "joint_stiffness": "100,50",
        "joint_damping": "2,1",
        "observation_names": "joint_pos,joint_vel,last_action",
        "control_period": "0.02",
    }
    (tmp_path / "policy.onnx").write_bytes(elu_model(layers, metadata).SerializeToString())
    file, states = open_policy(tmp_path / "policy.onnx"), states_of(task, rng, 5)
    drivers = [driver_of(each, file) for each in (again(task, tmp_path), task.deployment)]
    laws = [(driver.new_law(), driver.observation) for driver in drivers]
    action = np.zeros(2)
    for x in states:
        said, known = (law(observation(x[None]))[0] for law, observation in laws)
        assert_array_equal(said, known)
        action = elu_mean(layers, np.r_[x[:2] - [-0.7, 0.5], x[2:], action])
        assert_allclose(drivers[0].policy.contract.stiffness, [100, 50])
