# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Survival under disturbances as `evaluate` measures it, on a sled whose motion is known."""

import json
import re
from functools import partial

import numpy as np
import pytest

from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.storage.run_folder import save_policy
from vgps_ros.tasks import make_task

# A sled of 2 kg that no friction brakes has fallen where it is faster than 1 m/s.
SLED = """
<mujoco>
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody>
    <body name="sled">
      <joint name="x" type="slide" axis="1 0 0"/>
      <geom type="sphere" size="0.1" mass="2"/>
    </body>
  </worldbody>
  <actuator><motor name="x" joint="x"/></actuator>
</mujoco>
"""
TASK = """
model: sled.xml
control_period: 0.01
horizon: 1.0
cost: [{sensor: x/velocity}]
"""
COASTING = "start: {velocities: {x: 0.5}}\nfallen: [{sensor: x/position, beyond: 0.5}]\n"
FALLEN = "fallen: [{sensor: x/velocity, beyond: 1.0}]\n"


@pytest.fixture
def judged(tmp_path):
    """Returns a function that evaluates a linear policy of the sled, with a task's text."""

    def run(text, weights, seconds, *arguments):
        (tmp_path / "sled.xml").write_text(SLED)
        (tmp_path / "task.yaml").write_text(text)
        task = make_task(str(tmp_path))
        shape = Architecture(task.observation.names, (), 1)
        policy = GaussianPolicy(shape, np.array(weights), np.ones(1))
        save_policy(policy, task.name, tmp_path / "policy.json")
        output = tmp_path / "evaluation.json"
        given = ["--rollouts", "6", "--seconds", seconds, "--perturbation", "0", *arguments]
        vgps(["evaluate", str(tmp_path / "policy.json"), "--json", str(output), *given])
        return json.loads(output.read_text())

    return run


@pytest.fixture
def evaluated(judged):
    def run(*arguments, fallen=FALLEN):
        return judged(TASK + fallen, [0.0] * 3, "2", *arguments)["robustness"]

    return run


def test_a_push_a_slope_and_a_payload_are_survived_up_to_where_mechanics_says(
    evaluated, tmp_path, capsys
):
    picture = tmp_path / "survival.png"
    found = evaluated(
        *("--pushes", "2.1", "0", "1.9", "--slopes", "-0.06", "-0.03", "0.03", "0.06"),
        *("--payloads", "1", "--plot", str(picture)),
    )
    # p / m is 1 m/s at 2 N·s; g sin(s) t passes it within 2 s at 0.051 rad.
    for each in found.values():
        fallen = each.pop("fallen")
        assert [not rollouts for rollouts in fallen] == [share == 1.0 for share in each["survival"]]
    assert found == {
        "pushes": {"values": [0.0, 1.9, 2.1], "survival": [1.0, 1.0, 0.0], "borne": [0.0, 1.9]},
        "slopes": {
            "values": [-0.06, -0.03, 0.03, 0.06],
            "survival": [0.0, 1.0, 1.0, 0.0],
            "borne": [-0.03, 0.03],
        },
        "payloads": {"values": [1.0], "survival": [1.0], "borne": [0.0, 1.0]},
    }
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert "-0.03 to 0.03" in capsys.readouterr().out


def test_no_range_is_borne_where_the_undisturbed_robot_falls(evaluated, tmp_path, capsys):
    found = evaluated("--payloads", "1", fallen=COASTING)
    assert found["payloads"]["borne"] is None
    assert "none" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "fallen", "sentence"),
    [
        (["--pushes", "1"], "", "does not say when the robot has fallen"),
        (["--pushes", "-1"], FALLEN, "pushes is -1.0, but it must be from 0"),
        (["--pushes", "1", "--body", "slet"], FALLEN, "there is no body 'slet'"),
        (["--pushes", "0", "--body", "slet"], FALLEN, "there is no body 'slet'"),
        (["--slopes", "0.1", "--body", "sled"], FALLEN, "add --pushes or --payloads"),
        (["--frictions", "0.5"], FALLEN, "no two geoms of the robot of .* can touch"),
        (
            ["--pushes", "9", "--push-duration", "1.5"],
            FALLEN,
            "as late as 1 s and lasts 1.5 s, but a rollout ends after 2 s",
        ),
        (["--plot", "survival.png"], FALLEN, "--plot draws disturbances, but none is named"),
    ],
)
def test_what_tells_nothing_is_refused(evaluated, arguments, fallen, sentence, capsys):
    with pytest.raises(SystemExit) as stop:
        evaluated(*arguments, fallen=fallen)
    assert re.search(sentence, str(stop.value.code) + capsys.readouterr().err)


# A cart whose policy reaches its command, or falls where it is told to go fast.
COMMANDED = """
commands: {speed: {range: [-1.0, 2.0], unit: m/s}}
observe: [x/velocity, commands]
cost: [{sensor: x/velocity, target: {command: speed}}]
fallen: [{sensor: x/velocity, beyond: 1.5}]
"""


@pytest.fixture
def commanded(judged):
    text = TASK.replace("cost: [{sensor: x/velocity}]\n", COMMANDED)
    return partial(judged, text, [-50.0, 50.0, 0.0], "4")


def test_a_robot_with_commands_is_judged_at_each_and_under_usual_disturbances(commanded, capsys):
    found = commanded()
    by_command = {each["command"]["speed"]: each for each in found["commands"]}
    assert by_command[1.0]["survival"] == by_command[1.0]["obeys"] == [1.0]
    assert by_command[1.0]["rms"]["speed"] < 1e-6
    assert by_command[2.0]["survival"] == [0.0]
    # It has no contact and no damping, so that neither of their kinds can be tried.
    kinds = ["pushes", "slopes", "masses", "latencies", "sensor_noise", "engines"]
    assert [*found["robustness"]] == kinds
    assert by_command[1.0]["gait"]["slip"] is None
    table = capsys.readouterr().out
    assert "speed 2" in table
    assert "changing each 3 s" in table
    assert "90 % obey" in table
    assert "cost of transport" in table


def test_of_named_disturbances_only_those_are_tried(commanded, tmp_path):
    picture = tmp_path / "survival.png"
    found = commanded("--latencies", "0", "0.05", "--plot", str(picture))["robustness"]
    assert [*found] == ["latencies"]
    assert found["latencies"]["survival"][1] < found["latencies"]["survival"][0]
    calm, late = (errors["speed"] for errors in found["latencies"]["rms"])
    assert calm < 1e-6 < late
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--seconds", "2"], "seconds is 2, but the errors of commands count after 1 s"),
        (["--contacts", "1"], "contacts shall be MuJoCo's, but no two geoms"),
        (["--dampings", "2"], "No joint of the robot of .* has damping.*leave out --dampings"),
        (["--strengths", "0.5"], "by the factor 0.5, but no actuator has one.*--strengths"),
        (["--contacts", "2"], "contacts is 2, but it must be from 0 to 1"),
        (["--latencies", "-1"], "latencies is -1.0, but it must be from 0"),
        (["--masses", "0"], "masses is 0.0, but it must be from 0.01"),
        (["--sensor-noise", "nan"], "sensor_noise is nan"),
    ],
)
def test_what_tells_nothing_of_commands_is_refused(commanded, arguments, sentence, capsys):
    with pytest.raises(SystemExit) as stop:
        commanded(*arguments)
    assert re.search(sentence, str(stop.value.code) + capsys.readouterr().err)
