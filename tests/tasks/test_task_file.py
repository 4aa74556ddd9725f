# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Task files: what a good one says, and the sentence, with its line, for each kind of fault."""

import json
import math
import re
import runpy
from pathlib import Path

import mujoco
import pytest

from tests.tasks.hopper_file import HOPPER, TASK
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.tasks.builder import load_task
from vgps_ros.tasks.registry import task_file_of, task_names
from vgps_ros.tasks.schema import GeomChange, JointChange, Option, Pd
from vgps_ros.tasks.task_file import (
    SCHEMA_PATH,
    find_model,
    read_document,
    read_task_file,
    settings_in,
)

SCRIPT = Path(__file__).parents[2] / "scripts" / "write_task_schema.py"
DESIGN = """
model: hopper.xml                 # or package://…
control_period: 0.01              # [s], a multiple of the model's time step
horizon: 4.0                      # [s]; trained on and scored
lookahead: 0.6                    # [s] optimised beyond it
start: {keyframe: stand, std: {position: 0.01, velocity: 0.1}}
sensors:                          # added to the model; the model's own may be named too
  velocity: {type: subtreelinvel, body: torso}
  height:   {type: framepos, body: torso}
cost:                             # Σ weight · norm(sensor[index] − target), plus torques
  - {sensor: velocity, index: x, target: 1.0, weight: 1.0}
  - {sensor: height, index: z, target: 1.2, weight: 5.0, norm: smooth_abs}
  - {control: all, weight: 1.0e-4}
observe: [joint_positions, joint_velocities, {sensor: up}]      # what the policy reads
fallen: [{sensor: height, index: z, below: 0.7}]
begin: {law: pd, pose: stand}     # or a demonstration, smoothed noise, sampling
search: {hidden_units: [10]}
"""


@pytest.fixture
def sentence(folder):
    """Returns a function that changes the task file, and returns the error that it then gives."""

    def read(old="", new="", text=None):
        assert old in TASK
        text = TASK.replace(old, new, 1) if text is None else text
        (folder / "task.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(InvalidInputError) as caught:
            load_task(folder / "task.yaml", "hopper")
        found = str(caught.value)
        assert "\n" not in found
        assert found.endswith((".", "?"))
        assert len(found) < 500
        return found

    return read


def test_a_task_file_is_read_as_data(folder):
    task, document = read_task_file(folder / "task.yaml")
    assert (task.horizon, task.lookahead, task.control_period) == (4.0, 0.6, 0.01)
    assert task.changes.option.tolerance == 1e-12
    assert task.changes.joints["hip"].range == (-1.0, 1.0)
    assert task.start.positions == {"hip": 0.2}
    assert task.start.varied is None
    assert [term.weight for term in task.cost] == [1.0, 5.0, 1.0, 1e-4]
    assert (task.cost[1].norm, task.cost[1].width) == ("smooth_abs", 0.2)
    assert (task.cost[3].control, task.cost[3].sensor) == ("all", None)
    assert task.observe[0].joint_positions.excluded == ("root_x",)
    assert (task.observe[1], task.observe[2].form) == ("joint_velocities", "sin_cos")
    assert task.fallen[1].beyond == 1.0
    assert task.marginals.std_limit.overrides == {"root_x/position": math.inf}
    assert task.begin == Pd(pose="stand", stiffness=300.0, damping={"*": 30.0})
    assert settings_in(task, document)[1] == {"hidden_units": (10,), "fit.iterations": 50}
    assert document.lines["cost", 1, "norm"] == 26


def test_the_example_of_the_design_is_valid(folder):
    (folder / "task.yaml").write_text(DESIGN)
    task, _ = read_task_file(folder)
    assert task.begin == Pd(pose="stand")
    assert task.cost[1].width == 0.1


def test_a_section_without_a_value_counts_as_left_out(folder):
    (folder / "task.yaml").write_text(TASK + "limits:\n")
    assert read_task_file(folder)[0].limits == ()


def test_the_model_has_what_the_file_says(folder):
    model = load_task(folder, "hopper").dynamics.model
    assert model.opt.timestep == 0.005
    assert [model.sensor(i).name for i in range(model.nsensor)] == [
        *("com", "velocity", "height", "up")
    ]
    assert model.actuator("hip").ctrlrange.tolist() == [-24.0, 24.0]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("1e-4", 1e-4), ("1.E3", 1000.0), ("+.5", 0.5), ("12", 12), (".inf", math.inf)),
        *(("yes", "yes"), ("0x10", 16), ("12:30", "12:30"), ("'1'", "1")),
        *(("True", True), ("[~, null]", [None, None])),
    ],
)
def test_scalars_are_those_of_yaml_1_2(tmp_path, text, value):
    (tmp_path / "file.yaml").write_text(f"key: {text}")
    found = read_document(tmp_path / "file.yaml").data["key"]
    assert found == value
    assert type(found) is type(value)


FAULTS = [
    # Keys and values that do not fit: line, key, what would fit, an example.
    ("horizon: 4.0", "horizon: 4 s",
     "hopper/task.yaml line 14, horizon: it is '4 s', but it must be a number above 0"
     r" and at most .*: time that is trained on and scored, .* \[s\]; for example `horizon: 4.0`"),
    ("horizon: 4.0", "horizn: 4.0",
     "line 14, horizn: 'horizn' is no key .* Did you mean 'horizon'"),
    ("horizon: 4.0\n", "", "line 1: the key 'horizon' is missing.*`horizon: 4.0`"),
    ("horizon: 4.0", "horizon: -4.0", "line 14, horizon: it is -4.0, but it must be above 0"),
    ("horizon: 4.0", "horizon: 1e999", r"line 14, horizon: it is inf, but .* at most 1e\+12"),
    ("horizon: 4.0", f"horizon: {'9' * 5000}", "line 1: this is no plain YAML: .*digits"),
    ("horizon: 4.0", "horizon: .nan", "line 14, horizon: it is nan, but it must be above 0"),
    ("horizon: 4.0", "horizon: .inf", r"line 14, horizon: it is inf, but .* at most 1e\+12"),
    ("horizon: 4.0", "horizon: true", "line 14, horizon: it is true, but it must be a number"),
    ("index: x", "indx: x", r"line 25, cost\[0\].indx: .* Did you mean 'index'"),
    ("norm: smooth_abs", "norm: smooth",
     r"line 26, cost\[1\].norm: it is 'smooth', but it must be one of quadratic, smooth_abs"),
    ("law: pd", "law: pid",
     "line 38, begin.law: .* one of zero, noise, pd, sampling, demons.*Did you mean 'pd'"),
    ("law: pd, ", "", "line 38, begin: the key 'law' is missing: motion from which"),
    ("damping: 1,", "damping: soft,", r"line 6, changes.joints.hip.damping: .* \[N·m·s/rad\]"),
    ("gravity: [0, 0, -9.81]", "gravity: [0, -9.81]",
     "line 3, changes.option.gravity: it is a list of 2, but it must be a list of length 3"),
    ("height: {type: framepos, body: torso}", "height: 1",
     "line 22, sensors.height: it is 1, but it must be a mapping"),
    ("condim: 3", "condim: 2", r"line 8, changes.geoms.\*foot.condim: it is 2, but .* 1, 3, 4, 6"),
    ("norm: smooth_abs", "norm: quadratc", r"line 26, cost\[1\].norm: .* mean 'quadratic'"),
    ('[["floor", "*foot"]]', "[" + 32 * "[a, b]," + "]", "line 12, .* a list of length at most 31"),
    ('[["floor", "*foot"]]', "[[floor]]", r"line 12, .*\[0\]: it is a list of 1, but"),
    ("sensor: velocity", "sensor: ''", r"cost\[0\].sensor: it is '', .* text of length from 1"),
    ("search: {", "observe: []\nsearch: {", "line 29, observe: the key stands twice"),
    # Entries that contradict each other.
    ("control_period: 0.01", "control_period: 0.008",
     "line 13, control_period: .* time step, 0.005"),
    ("horizon: 4.0", "horizon: 4.0e+6", "line 14, horizon: .* but at most 100000 are taken"),
    ("framezaxis", "framezaxs", "line 23, sensors.up.type: .* Did you mean 'framezaxis'"),
    ("framepos, body: torso", "framepos",
     "line 22, sensors.height: exactly one of body, xbody, geom"),
    ("framepos, body: torso", "framepos, body: a, site: b", "line 22, .* here is body and site"),
    ("framepos, body: torso", "framepos, joint: hip",
     "line 22, .*joint: a framepos may name one of"),
    ("framepos, body", "clock, body", "line 22, sensors.height.body: a clock may name .*nothing"),
    ("subtreelinvel, body: torso", "subtreelinvel, body: torso, relative_to: {body: a}",
     "leave it out"),
    ("height: {", "a/b: {", "line 22, sensors.a/b: a sensor's name must not hold a slash"),
    ("sensor: velocity, index: x", "index: x",
     r"line 25, cost\[0\]: exactly one of sensor, control"),
    ("index: x, target: 1.0", "index: q",
     r"line 25, cost\[0\].index: .* has the parts x, y, z, but not 'q'"),
    ("index: x, target: 1.0", "index: 3", r"line 25, cost\[0\].index: .* but not 3"),
    ("index: x, target: 1.0", "target: [1, 2]",
     r"line 25, cost\[0\].target: it has 2 values, but .* 3"),
    ("norm: smooth_abs, ", "", r"line 26, cost\[1\].width: only smooth_abs has a width"),
    ("sensor: com/z", "sensor: hip/velocity, index: x", r"cost\[2\].index: .* is one number"),
    ("sensor: com/z", "sensor: height/u",
     r"line 27, cost\[2\]: .* no reading 'height/u'.* Did you mean 'height/[xyz]'"),
    ("{law: pd, pose: stand, stiffness: 300, damping: {\"*\": 30}}",
     "{law: path, file: ../hopper/../x}", r"begin.file: there is no file '../hopper"),
    ("{law: pd, pose: stand, stiffness: 300, damping: {\"*\": 30}}",
     "{law: path, file: referenc.csv}", "there is no file .* Did you mean 'reference.csv'"),
    ("{law: pd, pose: stand, stiffness: 300, damping: {\"*\": 30}}",
     "{law: path, file: /etc/passwd}", "lies outside this file's folder"),
    ("control: all", "control: [hip, hip]",
     r"line 28, cost\[3\].control\[1\]: this entry stands twice"),
    ("control: all,", "control: all, norm: quadratic,",
     r"cost\[3\].norm: this belongs to a term with"),
    ("as: sin_cos", "index: z", r"line 32, observe\[2\].index: this belongs beside sensor"),
    ("- joint_velocities", "- {sensor: up}", r"line 33, observe\[3\]: 'up/x' is read twice"),
    (", index: z, below", ", below",
     r"line 35, fallen\[0\]: it has the parts height/x, height/y, height/z"),
    ("below: 0.7", "below: 0.7, above: 2",
     r"line 35, fallen\[0\]: exactly one of below, above, bey"),
    ("{law: pd,", "{law: demonstration, file: ../w.csv} #", "begin.file: there is no file"),
    ("floor: 0.1", "flor: 0.1",
     "line 39, optimizer.ddp.regularization_flor: .* Did you mean 'ddp.reg"),
    ("annealing: 0.5", "annealing: high",
     "line 39, optimizer.marginals.std_limit_annealing: .* a number"),
    # The model, and what it lacks.
    ("hopper.xml", "hoper.xml", "line 1, model: there is no file .* Did you mean 'hopper.xml'"),
    ("hopper.xml", "reference.csv", "line 1, model: the model is no valid MJCF"),
    ("hopper.xml", "package://no_such_package/a.xml",
     "line 1, model: there is no package no_such_p"),
    ("hopper.xml", "package://mujoco/../a.xml", "line 1, model: .* inside a package"),
    ("hopper.xml", "package://mujoco", "line 1, model: .* must be package://PACKAGE/PATH"),
    ("hip: {damping", "hipp: {damping",
     "line 6, changes.joints.hipp: 'hipp' matches no joint; .*'hip'"),
    ("subtreelinvel, body: torso", "subtreelinvel, body: torsso",
     "line 21, sensors.velocity.body: there is no body 'torsso'; .*Did you mean 'torso'"),
    ('remove_actuators: ["*"]', 'remove_actuators: ["knee*"]',
     r"line 9, changes.remove_actuators\[0\]"),
    ("solimp: [0, 0.95, 0.02, 0.5, 2]", "solimp: [0, 0, 0, 0, 0, 0]", "line 8, .*solimp: it has 6"),
    ("[0.04, 1]", "[0.04, 1], priority: -1", r"line 8, changes.geoms.\*foot.priority: it is -1"),
    ("  velocity: {type", "  com: {type",
     "line 21, sensors.com: the model has a sensor of this name"),
    ("limit: 24", "limit: 24, joint: hip",
     "line 11, changes.actuators.hip.joint: the key stands twic"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "expected"), FAULTS)
def test_an_entry_that_is_wrong_is_named_with_its_line(sentence, old, new, expected):
    found = sentence(old, new)
    assert re.search(expected, found), found


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "line 1: the file is empty"),
        ("# a comment\n", "line 1: the file is empty"),
        ("- a\n- b\n", "line 1: the file must hold keys with values"),
        ("hello", "line 1: the file must hold keys with values"),
        ("a: &x 1\nb: *x\n", "line 1, a: anchors .* are not read"),
        ("a: 1\nb: *x\n", "line 2: this is no plain YAML, found undefined alias 'x'"),
        ("a: &x [*x]\n", "line 1, a: anchors"),
        ("&a a: 1\n", "line 1: a key must be a plain text"),
        (
            "a: !!python/object/apply:os.system ['touch /tmp/hacked']\n",
            "line 1: this is no plain YAML, could not determine a constructor for the tag",
        ),
        ("model: !!binary aGVsbG8=\n", "line 1"),
        ("a: 1\na: 2\n", "line 1, a: the key stands twice, here and in line 2"),
        ("a: 1\n---\nb: 1\n", "line 2: this is no plain YAML, but found another document"),
        ("a: 1\n\tb: 1\n", "line 2: this is no plain YAML"),
        ("a: [1, 2\n", "line 2: this is no plain YAML"),
        ("a: b: c\n", "line 1: this is no plain YAML, mapping values are not allowed here"),
        ("? [1]\n: 2\n", "line 1: a key must be a plain text"),
        ("a: " + "[" * 10_000 + "]" * 10_000, "line 1: the values are nested too deeply"),
        ("a: " + "{b: " * 10_000, "line 1: the values are nested too deeply"),
        (b"a: 1\nb: \xff\xfe\n", "line 2: the text is not in UTF-8"),
        (b"a: 1\nb: \x00\n", "this is no plain YAML: unacceptable character"),
        ('a: "\\0"\n', "line 1, a: the text .* must stand on one line"),
        ('a: "\\UFFFFFFFF"\n', "line 1: this is no plain YAML"),
        ('a: "\\uD800"\n', "line 1, a: the text .* must stand on one line"),
        ("a: |\n  one\n  two\n", "line 1, a: the text .* must stand on one line"),
        ("a: 1 #" + "x" * 1_000_000, "line 1: the file is larger than 1000000 bytes"),
        ("<<: {horizon: 1}\n", "line 1: the key 'model' is missing"),
    ],
)
def test_a_file_that_is_no_plain_yaml_is_refused(sentence, text, expected):
    found = sentence(text=text)
    assert re.search(expected, found), found
    assert not Path("/tmp/hacked").exists()


@pytest.mark.parametrize("path", ["missing.yaml", "", "a\0b", "x" * 5000, "/dev/null"])
def test_a_path_that_is_no_file_is_refused(tmp_path, path):
    with pytest.raises(InvalidInputError, match=r"^(There is no file|The file) .*\.$"):
        read_task_file(tmp_path / path)


def test_a_file_that_may_not_be_read_or_links_outside_is_refused(folder, tmp_path):
    (tmp_path / "secret.csv").write_text("")
    (folder / "reference.csv").unlink()
    (folder / "reference.csv").symlink_to(tmp_path / "secret.csv")
    text = TASK.replace(
        "begin: {law: pd, pose: stand, ", "begin: {law: path, file: reference.csv} # "
    )
    (folder / "task.yaml").write_text(text)
    with pytest.raises(InvalidInputError, match="lies outside this file's folder"):
        read_task_file(folder)


def test_a_model_of_a_package_is_found_without_importing_it(folder, tmp_path, monkeypatch):
    package = tmp_path / "robots_of_mine"
    package.mkdir()
    (package / "__init__.py").write_text("raise RuntimeError('imported')")
    (package / "hopper.xml").write_text(HOPPER)
    monkeypatch.syspath_prepend(str(tmp_path))
    shared = tmp_path / "prefix" / "share" / "hopper_description"
    (shared / "mjcf").mkdir(parents=True)
    (shared / "mjcf" / "hopper.xml").write_text(HOPPER)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'prefix'}")
    for name, expected in (
        ("robots_of_mine/hopper.xml", package / "hopper.xml"),
        ("hopper_description/mjcf/hopper.xml", shared / "mjcf" / "hopper.xml"),
    ):
        (folder / "task.yaml").write_text(TASK.replace("hopper.xml", f"package://{name}"))
        assert find_model(read_task_file(folder)[0].model, folder) == expected


def test_the_json_schema_is_the_one_that_the_script_writes():
    script = runpy.run_path(str(SCRIPT))
    assert SCHEMA_PATH.read_text() == script["definition"](), (
        "Run `python scripts/write_task_schema.py`: the schema lacks a change of the task file."
    )
    text = script["PAGE"].read_text()
    assert text == script["page"](text), "Run `python scripts/write_task_schema.py`."


@pytest.mark.parametrize("name", task_names())
def test_the_json_schema_takes_the_built_in_tasks(name):
    """An editor that checks by the schema says nothing of them."""
    jsonschema = pytest.importorskip("jsonschema")  # comes with what runs notebooks
    content = read_document(task_file_of(name)).data
    jsonschema.validate(content, json.loads(SCHEMA_PATH.read_text()))


@pytest.mark.parametrize(
    ("key", "settings", "wrong"),
    [
        ("search", {"iterations": 0}, "0 is less than the minimum of 1"),
        ("search", {"iteration": 3}, "'iteration' was unexpected"),
        ("search", {"fit.late": 2.0}, "2.0 is greater than the maximum of 1.0"),
        ("search", {"fit": {"late": 2.0}}, "2.0 is greater than the maximum of 1.0"),
        ("search", {"fit": {"lat": 0.5}}, "'lat' was unexpected"),
        ("search", {"hidden_units": 5}, "5 is not of type 'array'"),
        ("search", {"fit": {"optimizer": "sgd"}}, "'sgd' is not one of"),
        ("search", {"hidden_units": [5, 5], "fit": {"late": 0}, "gps.redraw": True}, ""),
        ("optimizer", {"ddp": {"regularization_floor": -1}}, "less than the minimum of 0.0"),
        ("optimizer", {"ddp.regularization_floor": 1}, ""),
    ],
)
def test_the_json_schema_knows_the_settings_nested_or_dotted(key, settings, wrong):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(SCHEMA_PATH.read_text())
    part = {"$defs": schema["$defs"], **schema["$defs"]["TaskFile"]["properties"][key]}
    errors = [str(e.message) for e in jsonschema.Draft202012Validator(part).iter_errors(settings)]
    assert len(errors) == bool(wrong)
    assert all(wrong in error for error in errors)


def test_every_field_has_a_description_and_every_number_a_unit_or_a_reason():
    schema = json.loads(SCHEMA_PATH.read_text())
    for record, definition in schema["$defs"].items():
        for name, field in definition["properties"].items():
            assert "description" in field or "const" in field or "enum" in field, (record, name)


def test_options_and_changes_are_fields_of_mujoco():
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    for record, element in (
        (Option, spec.option),
        (JointChange, body.add_joint()),
        (GeomChange, body.add_geom()),
    ):
        names = set(record.__struct_fields__) - {"lock"}
        assert all(hasattr(element, name) for name in names)
