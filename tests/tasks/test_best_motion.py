# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""First motions of which several are tried: `begin: {law: best}`."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.limited_pendulum import write_task
from vgps_ros.programs.__main__ import main
from vgps_ros.search.optimization_request import first_request
from vgps_ros.search.trajectory_optimization import optimize
from vgps_ros.tasks import make_task
from vgps_ros.tasks.first_motion import AlongPath, Best, FunctionMotion, RandomControls
from vgps_ros.tasks.sampled_motion import Arrival, SampledMotion

UP = "  - {sensor: tip, index: z, target: 1.0}"


def hanging(folder, begin):
    """The pendulum hangs at rest, and its motor is too weak to lift it without a swing."""
    return make_task(
        write_task(
            folder,
            ("  - {sensor: hinge/position, target: 1.5, weight: 100.0}", UP),
            ("horizon: 1.0", "horizon: 4.0"),
            ("search:", f"begin: {begin}\nsearch:"),
        )
    )


def end_of(task):
    return optimize(task, first_request(task, 0, 60)).distribution.mean.states[-25:, 0]


def test_it_swings_up_what_hangs_at_rest_where_nothing_would_move_it(tmp_path):
    swung = end_of(hanging(tmp_path, "{law: best}"))
    assert np.cos(swung).max() < -0.9  # the tip is up for the last half second
    assert np.cos(end_of(hanging(tmp_path, "{law: zero}"))).max() > 0.99


@pytest.mark.slow
def test_the_choice_is_the_same_in_each_process_and_goes_on_from_other_starts(tmp_path, rng):
    one, other = (hanging(tmp_path, "{law: best, iterations: 2}") for _ in range(2))
    start, steps = one.initial_state, one.planned_horizon
    first = one.begin(one, start, steps, rng).trajectory
    assert_array_equal(first.states, other.begin(other, start, steps, rng).trajectory.states)
    beside = one.begin(one, start + 0.01, steps, rng)
    assert_array_equal(beside.trajectory.states[0], start + 0.01)
    assert np.abs(beside.gaps[0]).max() > 0.0  # which a solve closes
    assert one.begin(one, start, 20, rng).trajectory.horizon == 20


def test_one_that_falls_is_worse_than_any_that_does_not(tmp_path):
    task = hanging(tmp_path, "{law: best, iterations: 1}")
    file = tmp_path / "task.yaml"
    file.write_text(file.read_text() + "fallen: [{sensor: hinge/position, beyond: 0.5}]\n")
    careful = make_task(str(file))
    assert not careful.fallen(careful.begin.choose()[1].states).any()
    assert careful.fallen(task.begin.choose()[1].states).any()


@pytest.mark.parametrize(
    "kind", [FunctionMotion, AlongPath, RandomControls, Arrival, SampledMotion]
)
def test_it_tries_laws_paths_noise_arrivals_and_short_plans(tmp_path, kind):
    begin = hanging(tmp_path, "{law: best}").begin
    assert isinstance(begin, Best)
    assert any(isinstance(each, kind) for each in begin.candidates)


def test_an_arrival_comes_up_early_and_rests_there(tmp_path, rng):
    task = hanging(tmp_path, "{law: zero}")
    steps = task.planned_horizon
    found = Arrival(1.0, 0)(task, task.initial_state, steps, rng)
    angles, speeds = found.trajectory.states.T
    assert np.cos(angles[-50:]).max() < 0.0  # it hangs no longer, for the last second at the least
    assert np.abs(speeds[-50:]).max() == 0.0
    (open_gaps,) = np.nonzero(np.abs(found.gaps).max(axis=1) > 1e-9)
    arrived = int(np.argmin(np.abs(np.diff(angles))[::-1] == 0.0))
    assert open_gaps.min() >= steps - arrived - 1  # until then it was executed


@pytest.mark.slow
def test_a_check_does_not_ask_for_another_motion_than_the_best(tmp_path, capsys):
    task = hanging(tmp_path, "{law: best}")
    main(["check", task.name, "--iterations", "1"])
    assert "hardly lowers" not in capsys.readouterr().out


def test_a_choice_that_is_cancelled_is_the_best_so_far_and_made_anew_the_next_time(tmp_path):
    begin = hanging(tmp_path, "{law: best, iterations: 2}").begin
    asked = iter([False] * 60 + [True] * 10_000)
    law, motion = begin.choose(lambda: next(asked))
    assert law in begin.candidates
    assert np.isfinite(motion.states).all()
    assert next(asked)  # it was cancelled
    whole = begin.choose()
    assert begin.choose() is whole


def test_a_check_says_that_no_time_was_left_for_all_first_motions(tmp_path, capsys):
    task = hanging(tmp_path, "{law: best}")
    main(["check", task.name, "--seconds", "0"])
    assert "ended after 0 s" in " ".join(capsys.readouterr().out.split())
