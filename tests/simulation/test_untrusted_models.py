# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Models that ask for too much: another process finds out, and they are refused in a sentence."""

import os
import resource
from math import cos, sin
from multiprocessing import get_context

import pytest

from vgps_ros.core.errors import InvalidInputError
from vgps_ros.simulation import model as gate
from vgps_ros.simulation.model import compile_model
from vgps_ros.tasks import make_task

TASK = """
model: robot.xml
control_period: 0.02
horizon: 1.0
cost: [{control: all}]
"""


def robot(top="", world="", end=""):
    """A pendulum, with more of a model before it, in its world, or behind."""
    return (
        f'<mujoco>{top}<worldbody><body><joint name="hinge" axis="0 1 0"/>'
        f'<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.5"/></body>{world}</worldbody>'
        f'<actuator><motor joint="hinge"/></actuator>{end}</mujoco>'
    )


def mesh(params, builtin="supertorus"):
    asset = f'<asset><mesh name="m" builtin="{builtin}" params="{params}"/></asset>'
    return robot(asset, '<geom type="mesh" mesh="m"/>')


def option(**values):
    return robot("<option {}/>".format(" ".join(f'{k}="{v}"' for k, v in values.items())))


def round_plate(count=20_000):
    """A disk of that many corners, whose hull takes minutes, without a number above one."""
    corners = (f"{cos(i):.7f} {sin(i):.7f} {z}" for i in range(count) for z in (0, 0.1))
    return robot(
        f'<asset><mesh name="m" vertex="{" ".join(corners)}"/></asset>',
        '<geom type="mesh" mesh="m"/>',
    )


TORUS = '<asset><mesh name="m" builtin="supertorus" params="3000 .5 .5 .5"/></asset>'
BODY = '<worldbody><body name="b"><geom type="mesh" mesh="m" mass="1"/></body></worldbody>'
ATTACHED = (
    '<asset><model name="a" file="a.xml"/></asset>',
    '<attach model="a" body="b" prefix="a"/>',
)
INSIDE = f"<mujoco>{TORUS}{BODY}</mujoco>".replace('"', "'")

# What a text or a file asks for, and other files beside it, by name.
ABSURD = {
    "a torus": mesh("3000 .5 .5 .5"),
    "a hexadecimal torus": mesh("0xBB8 .5 .5 .5"),
    "a plate": mesh("60000 60000", "plate"),
    "a hull": round_plate(),
    "many copies": robot(world='<replicate count="4900"><geom size=".1"/></replicate>' * 100),
    "copies of copies": robot(
        world='<replicate count="99">' * 9 + '<geom size=".1"/>' + "</replicate>" * 9
    ),
    "many small elements": robot(world='<geom size=".1"/>' * 1_000_000),
    "contacts": robot(end='<sensor><contact num="1000000000"/></sensor>'),
    "user": robot(end='<sensor><user dim="1000000000"/></sensor>'),
    "numbers": robot('<size nuserdata="2000000000"/>'),
    "memory": robot('<size memory="60G"/>'),
    "a picture": robot('<asset><texture builtin="flat" width="90000" height="90000"/></asset>'),
    "heights": robot('<asset><hfield nrow="90000" ncol="90000" size="1 1 1 1"/></asset>'),
    "lengths": robot('<compiler><lengthrange mode="all" inttotal="1e9"/></compiler>'),
    "a document type": f'<!DOCTYPE mujoco [<!ENTITY a ">{INSIDE}<!--"> ]>{robot()}<!-- -->',
    "iterations": option(iterations=2_000_000_000),
    "points": option(sdf_initpoints=2_000_000_000),
    **{f"timestep {value}": option(timestep=value) for value in (0, -0.01, 1e-9, 1000, "nan")},
    "sleep": robot('<option><flag sleep="enable"/></option>'),
}


@pytest.fixture
def loaded(tmp_path, monkeypatch):
    """Returns a function that loads a task of a model and of files beside it, in a second each."""
    monkeypatch.setattr(gate, "_SECONDS", 1)
    monkeypatch.setattr(gate, "_OWN_SECONDS", 1)
    (tmp_path / "task.yaml").write_text(TASK)

    def load(text, **files):
        (tmp_path / "robot.xml").write_text(text)
        for name, content in files.items():
            (tmp_path / f"{name}.xml").write_text(content)
        return make_task(str(tmp_path))

    return load


def refused_in_a_sentence(load, *arguments, match="MJCF|model"):
    with pytest.raises(InvalidInputError, match=match) as refused:
        load(*arguments)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ABSURD.values(), ids=ABSURD)
def test_a_model_that_asks_for_too_much_is_refused_as_a_text_and_as_a_file(text, loaded):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused_in_a_sentence(compile_model, text)
    refused_in_a_sentence(loaded, text)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before  # [KiB]
    assert grown < 500_000


@pytest.mark.parametrize(
    ("text", "files"),
    [
        (robot(*ATTACHED), {"a": f"<mujoco>{TORUS}{BODY}</mujoco>"}),
        (
            robot('<include file="a.xml"/>'),
            {
                "a": '<mujocoinclude><include file="b.xml"/></mujocoinclude>',
                "b": f"<mujocoinclude>{TORUS}{BODY}</mujocoinclude>",
            },
        ),
    ],
    ids=["attached", "included by an included one"],
)
def test_a_file_beside_a_model_that_asks_for_too_much_is_refused(text, files, loaded):
    with pytest.raises(InvalidInputError, match="takes more than 1 s or 2 GiB"):
        loaded(text, **files)


@pytest.mark.parametrize(
    "reference",
    [
        '<include file="{}"/>',
        '<asset><mesh file="{}"/></asset>',
        '<asset><hfield size="1 1 1 1" file="{}"/></asset>',
        '<asset><model name="m" file="{}"/></asset>',
    ],
)
@pytest.mark.parametrize("kind", ["a pipe", "/dev/zero"])
def test_files_that_never_end_are_refused(kind, reference, loaded, tmp_path):
    path = tmp_path / "pipe.stl" if kind == "a pipe" else kind
    if kind == "a pipe":
        os.mkfifo(path)
    refused_in_a_sentence(loaded, robot(reference.format(path)))


def test_a_text_opens_no_file(tmp_path):
    part = tmp_path / "part.xml"
    part.write_text('<mujocoinclude><option timestep="0.01"/></mujocoinclude>')
    included = robot(f'<include file="{part}"/>')
    assert gate.mujoco.MjModel.from_xml_string(included).nv == 1
    refused_in_a_sentence(compile_model, included, match="which must need no file, .*part.xml")


def test_a_limit_of_memory_from_outside_is_kept(monkeypatch):
    def limited(sends):
        resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
        monkeypatch.setattr(gate, "count_cores", lambda: 2)
        compile_model(robot())
        with pytest.raises(InvalidInputError, match="ould not allocate memory"):
            compile_model(robot('<size memory="1800M"/>'))  # of which a training takes several
        with pytest.raises(InvalidInputError) as refused:
            compile_model(robot('<size memory="60G"/>'))
        sends.send(str(refused.value))

    found, sends = get_context("fork").Pipe(duplex=False)
    child = get_context("fork").Process(target=limited, args=(sends,))
    child.start()
    sends.close()
    assert "ould not allocate memory" in found.recv()
    child.join()
    assert child.exitcode == 0


def test_an_error_of_mujoco_is_one_line(loaded):
    text = robot(world='<geom name="flat" type="box" size="1"/>')  # which it tells in two lines
    refused_in_a_sentence(compile_model, text, match=r"does not compile: .+line 1")
    refused_in_a_sentence(loaded, text, match=r"line 2, model: .+line 1")
