# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""How well policies obey commands, on a cart whose speed is known in closed form."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.core.policy import Architecture, GaussianPolicy
from vgps_ros.core.settings import with_values
from vgps_ros.robot.executed_control import Driver
from vgps_ros.search import renewal
from vgps_ros.search.calibration import calibrate
from vgps_ros.search.judgement import (
    Trial,
    behaviour,
    changing_commands,
    command_grid,
    first_phases,
    interval,
    judge_controller,
    judged_times,
    late_error,
)
from vgps_ros.search.renewal import renew
from vgps_ros.search.robustness import robustness, usual_noise
from vgps_ros.search.settings import search_settings
from vgps_ros.search.trajectory_optimization import optimize_all
from vgps_ros.search.workspace import Workspace
from vgps_ros.tasks import make_task
from vgps_ros.tasks.disturbance import DisturbanceSettings

# A cart of 1 kg that nothing brakes. A force of GAIN (command − speed) lets its speed approach the
# command by the factor 1 − GAIN Δt in each step, within two steps at GAIN 50.
CART = """
<mujoco>
  <option timestep="0.01" integrator="Euler"/>
  <worldbody>
    <body name="cart"><joint name="x" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator><motor name="x" joint="x"/></actuator>
</mujoco>
"""
TASK = """
model: cart.xml
control_period: 0.01
horizon: 1.0
commands: {speed: {range: [-1.0, 2.0], unit: m/s}}
cost:
  - {sensor: x/velocity, target: {command: speed}}
  - {sensor: x/velocity, target: {command: speed, rest: 9.0}, weight: 0.1}
observe: [x/velocity, commands]
"""
FALLEN = "fallen: [{sensor: x/velocity, beyond: 1.5}]\n"
GAIN = 50.0


@pytest.fixture
def cart(tmp_path):
    (tmp_path / "cart.xml").write_text(CART)
    (tmp_path / "task.yaml").write_text(TASK + FALLEN)
    return make_task(str(tmp_path))


def reaching(task, share=1.0, offset=0.0):
    """Returns a driver that reaches a share of the command, and an offset [m/s]."""
    shape = Architecture(task.observation.names, (), 1)
    parameters = GAIN * np.array([-1.0, share, offset])  # speed, command, bias
    return Driver(GaussianPolicy(shape, parameters, np.ones(1)), task.observation)


def judged(task, driver, **changes):
    given = {"seconds": 4.0, "rollouts": 3, "perturbation": 0.0, "seed": 0, "stochastic": False}
    return judge_controller(task, driver, **given | changes)


def test_the_grid_has_each_command_alone_and_pairs_half_way(cart):
    assert_array_equal(command_grid(cart.signals), [[0.0], [-1.0], [-0.5], [1.0], [2.0]])
    (speed,) = cart.signals.commands
    two = replace(cart.signals, commands=(speed, replace(speed, name="turn", lowest=0.0)))
    grid = command_grid(two).tolist()
    assert len(grid) == len({*map(tuple, grid)})
    assert [0.0, 2.0] in grid
    assert [1.0, 1.0] in grid
    assert [-0.5, 1.0] in grid
    assert [2.0, 2.0] not in grid


def test_errors_are_those_of_the_speed_that_a_policy_reaches(cart):
    """Nine tenths of the command and 0.05 m/s more miss it by 0.05 − 0.1 of it."""
    found = judged(cart, reaching(cart, 0.9, 0.05))
    assert found["achieved_by"] == {"speed": "x/velocity"}
    assert found["units"] == {"speed": "m/s"}
    for each in found["commands"][:4]:
        error = 0.05 - 0.1 * each["command"]["speed"]
        assert each["mean"]["speed"] == pytest.approx(error, abs=1e-6)
        assert each["rms"]["speed"] == pytest.approx(abs(error), abs=1e-6)
        assert each["survival"] == [1.0]
        assert each["obeys"] == [float(each["command"]["speed"] > -0.5)]  # 0.1 is the limit
    fallen = found["commands"][4]  # 1.8 m/s, within the settling time
    assert fallen["survival"] == fallen["obeys"] == [0.0]
    assert fallen["rms"] == fallen["mean"] == {"speed": None}
    assert found["all_commands"]["survival"] == [pytest.approx(0.8)]
    assert_allclose(found["all_commands"]["survival_interval"], [interval(0.8, 15)])
    squares = [(0.05 - 0.1 * command) ** 2 for command in (0.0, -1.0, -0.5, 1.0)]
    assert found["all_commands"]["rms"]["speed"] == pytest.approx(np.mean(squares) ** 0.5)


def test_a_robot_that_stands_still_is_up_but_does_not_obey(cart):
    found = judged(cart, reaching(cart, 0.0))
    assert [each["survival"] for each in found["commands"]] == [[1.0]] * 5
    assert [each["obeys"] for each in found["commands"]] == [[1.0], [0.0], [0.0], [0.0], [0.0]]


@pytest.mark.parametrize(
    ("unit", "share", "offset", "obeyed"),
    [
        ("m/s", 1.0, 0.09, [1, 1, 1, 1]),  # by 0.1 m/s, at rest too
        ("m/s", 1.0, 0.11, [0, 0, 0, 1]),
        ("rad/s", 0.91, 0.0, [1, 1, 1, 1]),  # by a tenth of 2
        ("rad/s", 0.91, -0.05, [1, 1, 0, 0]),
        ("m", 1.0, 0.3, [1, 1, 1, 1]),  # by an eighth of a range of 3
        ("m", 1.0, 0.4, [0, 0, 0, 0]),
    ],
)
def test_a_tenth_of_a_command_obeys_and_a_little_more_at_rest(
    cart, tmp_path, unit, share, offset, obeyed
):
    (tmp_path / "task.yaml").write_text(TASK.replace("unit: m/s", f"unit: {unit}"))
    found = judged(make_task(str(tmp_path)), reaching(cart, share, offset))
    each = {own["command"]["speed"]: own["obeys"][-1] for own in found["commands"]}
    assert [each[speed] for speed in (0.0, -0.5, 1.0, 2.0)] == obeyed


def test_of_a_small_range_an_eighth_is_asked_at_rest(cart, tmp_path):
    text = TASK.replace("[-1.0, 2.0]", "[-0.1, 0.1]")
    (tmp_path / "task.yaml").write_text(text)
    small = make_task(str(tmp_path))
    for offset, obeyed in ((0.024, 1.0), (0.026, 0.0)):
        found = judged(small, reaching(small, 1.0, offset))
        assert found["commands"][0]["obeys"] == [obeyed]


def test_rollouts_are_judged_at_each_time_by_what_comes_before_it(cart):
    """From 4 s on the command is 1 m/s more than the policy reaches."""
    commands = np.zeros((1, 800, 1))
    commands[:, 400:] = 2.0
    given = Trial(cart.initial_state[None], commands, np.zeros((1, 800, 1)))
    found = behaviour(cart, reaching(cart, 0.5), given, (4.0, 8.0))
    assert found.up.tolist() == [[True, True]]
    assert found.obeys.tolist() == [[True, False]]
    assert found.counts.tolist() == [600]  # a second after the start and the change does not count
    assert found.errors[0, 0] == pytest.approx(-0.5)
    assert found.squares[0, 0] == pytest.approx(0.5)


def test_the_error_late_in_a_rollout_is_a_share_of_the_range(cart):
    """Half of a command of 2 m/s is missed by 1 m/s, a third of the range."""
    commands = np.full((1, 400, 1), 0.3)
    commands[:, 100:] = 2.0
    context = cart.signals.context(commands, np.zeros((1, 400)))
    told, silent = cart.observation.within(context[0]), np.zeros((1, 400, 1))
    states, controls = cart.dynamics.execute(
        reaching(cart, 0.5).policy, told, cart.initial_state[None], silent
    )
    assert late_error(cart, states, controls, context) == pytest.approx(1 / 3)


@pytest.mark.parametrize("law", ["linear", "network"])
def test_calibrated_commands_are_reached(cart, law, rng):
    """A policy that reaches 0.8 of a command and 0.05 m/s more, then reaches each that it bears."""
    policy = reaching(cart, 0.8, 0.05).policy
    if law == "network":  # softplus(z) − softplus(−z) = z
        shape = replace(policy.architecture, hidden_units=(2,))
        row, bias = policy.architecture.unpack(policy.parameters)[0]
        hidden = np.concatenate([row, -row]).ravel(), np.concatenate([bias, -bias])
        parameters = np.concatenate([*hidden, [1.0, -1.0], [0.0]])
        policy = GaussianPolicy(shape, parameters, policy.noise_std)
    found = calibrate(cart, 0, policy)
    told = judged(cart, Driver(found, cart.observation))
    assert [each["survival"] for each in told["commands"][:4]] == [[1.0]] * 4
    assert max(abs(each["mean"]["speed"]) for each in told["commands"][:4]) < 1e-3


def test_a_policy_that_does_less_than_half_of_what_it_is_told_is_told_at_most_twice_as_much(cart):
    """Of 0.2 of a command a pass makes 0.4, and the next one 0.8."""
    found = calibrate(cart, 0, reaching(cart, 0.2, 0.05).policy)
    gain, _ = found.architecture.unpack(found.parameters)[0]
    of_speed = found.architecture.observed.index("command/speed")
    told = reaching(cart, 0.8).policy
    expected = told.architecture.unpack(told.parameters)[0][0]
    np.testing.assert_allclose(gain[:, of_speed], expected[:, of_speed], rtol=0.02)


def test_a_policy_that_falls_is_not_calibrated(cart):
    falls = reaching(cart, 1.0, 1.6).policy
    assert calibrate(cart, 0, falls) is falls
    shape = replace(falls.architecture, output_bias=False)
    unbiased = GaussianPolicy(shape, reaching(cart, 0.8).policy.parameters[:-1], np.ones(1))
    assert calibrate(cart, 0, unbiased) is unbiased


def test_new_situations_begin_where_commands_are_obeyed_least(cart, tmp_path):
    """A policy that reaches half of a command obeys the largest ones least."""
    text = TASK.replace("observe:", "  - {control: all, weight: 1.0e-3}\nobserve:")
    (tmp_path / "task.yaml").write_text(text)
    task = make_task(str(tmp_path))
    values = {"situations": 60, "initial_ddp_iterations": 2, "renew.share": 1.0}
    settings = with_values(search_settings(task), {**values, "renew.seconds": 4.0})
    work = Workspace(task, settings, 0, partial(optimize_all, task))

    def size(policy):
        solutions, _ = renew(work, work.initial_solutions, policy, 4)
        return np.mean([abs(each.situation.context[0, 0]) for each in solutions[1:]])

    assert size(reaching(task, 0.5).policy) > 1.1 * size(reaching(task).policy)


def test_new_situations_begin_at_most_half_way_from_a_push_to_the_fall(tmp_path, monkeypatch):
    """A cart whose speed v grows by 4 v passes √(1.5 v) half way to where it falls, 1.5 m/s."""
    monkeypatch.setattr(renewal, "_NOISE", 0.0)
    text = TASK.replace("observe:", "  - {control: all, weight: 1.0e-3}\nobserve:")
    (tmp_path / "cart.xml").write_text(CART)
    (tmp_path / "task.yaml").write_text(
        text + "start: {std: {position: 0.0, velocity: 0.0}}\n" + FALLEN
    )
    task = make_task(str(tmp_path))
    values = {"situations": 60, "initial_ddp_iterations": 2, "renew.share": 1.0}
    values |= {"renew.worst": 1e6, "renew.push": 0.6, "renew.pushed": 1.0}
    settings = with_values(search_settings(task), {**values, "renew.seconds": 4.0})
    work = Workspace(task, settings, 0, partial(optimize_all, task))
    policy = replace(reaching(task, 0.0).policy, parameters=np.array([4.0, 0.0, 0.0]))
    solutions, _ = renew(work, work.initial_solutions, policy, 4)
    pairs = zip(work.initial_solutions, solutions, strict=True)
    begun = np.array([abs(new.situation.initial_state[1]) for old, new in pairs if new is not old])
    assert len(begun) > 20
    # A push of at most 0.6 N·s ends with at most 0.75 m/s, as the cart drives itself meanwhile.
    assert begun.max() < 1.05 * np.sqrt(0.75 * 1.5)
    assert np.ptp(begun) > 0.3


@pytest.mark.parametrize("lead", [0.15, 0.3])
def test_new_situations_begin_one_to_three_times_the_lead_before_a_fall(
    tmp_path, monkeypatch, lead
):
    """A policy that accelerates by 1 m/s² falls at 1.5 m/s, so its speed tells when."""
    monkeypatch.setattr(renewal, "_NOISE", 0.0)
    monkeypatch.setattr(renewal, "_BEFORE_FALL", 1.0)
    text = TASK.replace("observe:", "  - {control: all, weight: 1.0e-3}\nobserve:")
    (tmp_path / "cart.xml").write_text(CART)
    (tmp_path / "task.yaml").write_text(text.replace("2.0]", "1.0]") + FALLEN)
    task = make_task(str(tmp_path))
    values = {"situations": 40, "initial_ddp_iterations": 2, "renew.share": 1.0}
    values |= {"renew.worst": 1e6}
    settings = with_values(search_settings(task), {**values, "renew.fall_lead": lead})
    work = Workspace(task, settings, 0, partial(optimize_all, task))
    policy = reaching(task, 0.0).policy
    policy = replace(policy, parameters=np.array([0.0, 0.0, 1.0]))
    solutions, _ = renew(work, work.initial_solutions, policy, 4)
    pairs = zip(work.initial_solutions, solutions, strict=True)
    begun = np.array([new.situation.initial_state[1] for old, new in pairs if new is not old])
    assert len(begun) > 10
    assert begun.min() == pytest.approx(1.5 - 3 * lead, abs=0.3 * lead)
    assert begun.max() == pytest.approx(1.5 - lead, abs=0.3 * lead)


def test_a_fall_ends_what_counts(cart):
    """At 3 s the command is 2 m/s, where the cart falls at once."""
    commands = np.full((1, 600, 1), 1.0)
    commands[:, 300:] = 2.0
    given = Trial(cart.initial_state[None], commands, np.zeros((1, 600, 1)))
    found = behaviour(cart, reaching(cart), given, (3.0, 6.0))
    assert found.up.tolist() == [[True, False]]
    assert found.counts.tolist() == [200]


def test_a_late_reading_and_noise_of_sensors_change_what_a_policy_does(cart):
    """At GAIN 50 the loop bears no two steps of latency; an offset of the reading shifts it."""
    commands = np.full((1, 400, 1), 0.5)
    given = Trial(cart.initial_state[None], commands, np.zeros((1, 400, 1)))
    driver = reaching(cart)
    assert behaviour(cart, driver, given, (4.0,)).up.all()
    assert not behaviour(cart, driver, replace(given, lag=5), (4.0,)).up.any()
    misread = np.full((1, 400, 1), 0.2)
    found = behaviour(cart, driver, replace(given, misread=misread), (4.0,))
    assert found.errors[0, 0] == pytest.approx(-0.2)


class Network:
    """A policy that is not ours, of the same controls."""

    def __init__(self, policy):
        self.mean, self.noise_std = policy.mean, policy.noise_std


@pytest.mark.parametrize("lag", [0, 2])
def test_a_policy_that_is_not_ours_is_judged_alike(cart, rng, lag):
    driver = reaching(cart, 0.8)
    commands = np.array([changing_commands(cart, 400, rng) for _ in range(3)]) / 2
    given = Trial(np.tile(cart.initial_state, (3, 1)), commands, np.zeros((3, 400, 1)), lag=lag)
    given = replace(given, misread=0.01 * rng.standard_normal((3, 400, 1)))
    ours = behaviour(cart, driver, given, (4.0,))
    other = behaviour(cart, replace(driver, policy=Network(driver.policy)), given, (4.0,))
    assert_array_equal(ours.up, other.up)
    assert_allclose(ours.errors, other.errors, atol=1e-9)


def test_judgements_are_the_same_again_and_others_for_another_seed(cart):
    driver = reaching(cart, 0.8)
    first, again, other = (judged(cart, driver, stochastic=True, seed=s) for s in (0, 0, 1))
    assert first == again
    assert first["commands"][0]["mean"] != other["commands"][0]["mean"]


def test_first_phases_fill_a_turn_evenly():
    found = np.sort(first_phases(100))
    assert (np.diff(found) < 0.02).all()
    assert found[0] >= 0.0
    assert 0.97 < found[-1] < 1.0


def test_commands_change_every_three_seconds(cart, rng):
    drawn = changing_commands(cart, 700, rng)
    assert drawn.shape == (700, 1)
    changes = 1 + np.flatnonzero(drawn[1:, 0] != drawn[:-1, 0])
    assert changes.tolist() == [300, 600]


def test_long_rollouts_are_judged_on_the_way():
    assert judged_times(6.0) == (6.0,)
    assert judged_times(20.0) == (20.0,)
    assert judged_times(60.0) == (20.0, 60.0)


def test_an_interval_is_wilsons():
    """Of 0 of n it reaches z² / (n + z²)."""
    low, high = interval(0.0, 40)
    assert low == pytest.approx(0.0, abs=1e-12)
    assert high == pytest.approx(1.959964**2 / (40 + 1.959964**2), rel=1e-6)


def test_disturbances_of_a_commanded_robot_tell_who_obeys(cart):
    """Of twice the mass it obeys; a cart of which the policy lags far behind falls."""
    steps = 500
    starts = np.tile(cart.initial_state, (4, 1))
    commands = np.full((4, steps, 1), 0.7)
    given = Trial(starts, commands, np.zeros((4, steps, 1)))
    values = {"masses": [1.0, 2.0], "latencies": [0.045, 0.0]}
    rest = 3, DisturbanceSettings(body="cart")
    found = robustness(cart, reaching(cart), given, values, *rest)
    assert found["masses"]["obeys"] == [1.0, 1.0]
    assert found["masses"]["obeyed"] == found["masses"]["borne"] == [1.0, 2.0]
    assert found["latencies"]["survival"] == [1.0, 0.0]
    assert found["latencies"]["borne"] == [0.0, 0.0]
    assert_allclose(found["latencies"]["survival_interval"], [interval(1.0, 4), interval(0.0, 4)])
    still = robustness(cart, reaching(cart, 0.0), given, {"masses": [1.0]}, *rest)["masses"]
    assert (still["survival"], still["obeys"], still["obeyed"]) == ([1.0], [0.0], None)


def test_usual_sensors_have_noise_by_what_they_measure(cart):
    assert_array_equal(usual_noise(cart, reaching(cart)), [0.1])  # a slide's speed


def test_too_short_and_too_many_rollouts_are_refused(cart):
    with pytest.raises(InvalidInputError, match=r"seconds is 2, .* use at least 3"):
        judged(cart, reaching(cart), seconds=2.0)
    with pytest.raises(InvalidInputError, match="at each of 6 commands are too many"):
        judged(cart, reaching(cart), rollouts=100_000)
