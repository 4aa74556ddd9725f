# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Models that ask for too much: refused in a sentence, before or while another process tries."""

import os
from math import cos, sin

import pytest

from vgps_ros.core.errors import InvalidEntryError, InvalidInputError
from vgps_ros.simulation import model as gate
from vgps_ros.simulation.model import compile_model
from vgps_ros.simulation.model_changes import changed_spec


def robot(top="", world="", end=""):
    """A pendulum, with more of a model before it, in its world, or behind."""
    return (
        f'<mujoco>{top}<worldbody><body><joint name="hinge" axis="0 1 0"/>'
        f'<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.5"/></body>{world}</worldbody>'
        f'<actuator><motor joint="hinge"/></actuator>{end}</mujoco>'
    )


def mesh(builtin, params):
    asset = f'<asset><mesh name="m" builtin="{builtin}" params="{params}"/></asset>'
    return robot(asset, '<geom type="mesh" mesh="m"/>')


def option(**values):
    return robot("<option {}/>".format(" ".join(f'{k}="{v}"' for k, v in values.items())))


ABSURD = {
    **{
        f"{name} of {params}": (mesh(name, params), r"[0-9]+ parts of a side in <mesh>, but 200")
        for name, params in (
            ("supertorus", "60000 .5 .5 .5"),
            ("supersphere", "6e4 .5 .5"),
            ("wedge", "9 60000 20 20 .5"),
            ("cone", "10000 1"),
            ("plate", "60000 60000"),
            ("nothing yet", "1000000000"),
        )
    },
    **{
        name: (option(**{name: 2_000_000_000}), "asks for 2000000000 steps of a solver in <option>")
        for name in (
            *("iterations", "ls_iterations", "noslip_iterations", "ccd_iterations"),
            *("sdf_iterations", "sdf_initpoints"),
        )
    },
    **{
        f"timestep {value}": (option(timestep=value), f"a timestep of {value:g} s in <option>")
        for value in (0, -0.01, 1e-9, 1000, float("nan"))
    },
    "contacts": (
        robot(end='<sensor><contact num="1000000000"/></sensor>'),
        "asks for 1000000000 numbers in <contact>",
    ),
    "user": (robot(end='<sensor><user dim="1000000000"/></sensor>'), "numbers in <user>"),
    "rays": (robot(world='<camera resolution="30000 30000"/>'), "900000000 numbers in <camera>"),
    "cells": (robot(world='<flexcomp cellcount="999 999 999"/>'), "numbers in <flexcomp>"),
    "lengths": (
        robot('<compiler><lengthrange mode="all" inttotal="1e9"/></compiler>'),
        "time steps in <lengthrange>",
    ),
}


@pytest.mark.parametrize(("text", "sentence"), ABSURD.values(), ids=ABSURD)
def test_a_text_or_a_file_that_asks_for_too_much_is_refused_before_it_compiles(
    text, sentence, tmp_path, monkeypatch
):
    monkeypatch.delattr(gate.mujoco, "MjModel")
    monkeypatch.delattr(gate.mujoco, "MjSpec")
    with pytest.raises(InvalidInputError, match=sentence):
        compile_model(text)
    (tmp_path / "part.xml").write_text(text)
    (tmp_path / "whole.xml").write_text('<mujoco><include file="part.xml"/></mujoco>')
    for name in ("part.xml", "whole.xml"):
        with pytest.raises(InvalidEntryError, match=sentence):
            changed_spec(tmp_path / name, {}, {})


@pytest.mark.parametrize(
    "reference",
    [
        '<include file="{}"/>',
        '<asset><mesh file="{}"/></asset>',
        '<compiler meshdir="pipes"/><asset><mesh file="pipe"/></asset>',
        '<asset><texture fileright="{}"/></asset>',
        '<asset><hfield file="/dev/zero"/></asset>',
    ],
)
def test_a_model_names_plain_files_alone(reference, tmp_path):
    (tmp_path / "pipes").mkdir()
    os.mkfifo(pipe := tmp_path / "pipes" / "pipe")
    path = tmp_path / "robot.xml"
    path.write_text(robot(reference.format(pipe)))
    with pytest.raises(InvalidEntryError, match="which the MJCF names, is no plain file"):
        changed_spec(path, {}, {})


def round_plate(count=20_000):
    """A disk of that many corners, whose hull takes minutes, without a number above one."""
    corners = (f"{cos(i):.7f} {sin(i):.7f} {z}" for i in range(count) for z in (0, 0.1))
    return robot(
        f'<asset><mesh name="m" vertex="{" ".join(corners)}"/></asset>',
        '<geom type="mesh" mesh="m"/>',
    )


HEAVY = {
    "a mesh": (round_plate, "takes more than 1 s"),
    "many copies": (
        lambda: robot(world='<replicate count="4900"><geom size=".1"/></replicate>' * 100),
        "takes more than 1 s",
    ),
    "memory": (lambda: robot('<size memory="60G"/>'), "[Cc]ould not allocate memory"),
    "sleep": (
        lambda: robot('<option><flag sleep="enable"/></option>'),
        "lets resting bodies sleep",
    ),
}


@pytest.mark.parametrize(("make", "sentence"), HEAVY.values(), ids=HEAVY)
def test_a_text_of_others_that_takes_too_much_ends_another_process(make, sentence, monkeypatch):
    monkeypatch.setattr(gate, "_SECONDS", 1)
    with pytest.raises(InvalidInputError, match=sentence) as refused:
        compile_model(make())
    assert "\n" not in str(refused.value)


def test_an_error_of_mujoco_is_one_line(tmp_path):
    text = robot(world='<geom name="flat" type="box" size="1"/>')  # which it tells in two lines
    with pytest.raises(InvalidInputError, match=r"does not compile: .+line 1") as refused:
        compile_model(text)
    assert "\n" not in str(refused.value)
    (tmp_path / "robot.xml").write_text(text)
    with pytest.raises(InvalidInputError, match=r"model: .+line 1") as refused:
        changed_spec(tmp_path / "robot.xml", {}, {})
    assert "\n" not in str(refused.value)
