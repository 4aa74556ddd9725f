# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The card of an exported policy: what it says, and that it says nothing that nobody knows."""

import onnxruntime
import pytest
import yaml
from PIL import Image

from vgps_ros.programs import policy_card
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.tasks import make_task
from vgps_ros.views import filmstrip

TRAINED = ["--task", "swimmer", "--hidden-units", "3", "--iterations", "1"]
QUICK = ["--initial-ddp-iterations", "3", "--evaluation-rollouts", "2", "--disturb-payload", "0.1"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of a short training."""
    folder = tmp_path_factory.mktemp("run")
    vgps(["train", *TRAINED, *QUICK, "--situations", "1", "--output", str(folder)])
    return folder


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr(policy_card, "_SHOWN", 0.4)


def sections(folder):
    """Returns the front matter of a card, and its text by title."""
    _, front, text = (folder / "README.md").read_text().split("---\n", 2)
    parts = [part.partition("\n\n") for part in text.replace("\n# ", "\n## ", 1).split("\n## ")[1:]]
    return yaml.safe_load(front), {title: body for title, _, body in parts}


def card(run, tmp_path, *more):
    vgps(["export", str(run), "--output", str(tmp_path / "p.onnx"), "--card", str(tmp_path), *more])
    return sections(tmp_path)


def test_it_says_how_the_policy_was_made_what_it_reads_and_how_it_does(run, tmp_path, capsys):
    front, says = card(run, tmp_path)
    assert front["library_name"] == "vgps_ros"
    assert front["pipeline_tag"] == "robotics"
    assert "license" not in front
    made = says["How it was made"]
    assert f"vgps train {' '.join(TRAINED)}" in made
    assert f"vgps export {run}" in made
    assert "| disturb.payload | 0.1 |" in made
    assert "| seed | 0 |" in made
    names = make_task("swimmer").observation.names
    for i, name in enumerate(names):
        assert f"| {i} | `{name}` | " in says["What it reads"]
    assert "| `front_joint/velocity` | rad/s |" in says["What it reads"]
    assert "| 0 | `front_joint` | torque | N·m |" in says["What it controls"]
    assert "10 rollouts of 10 s" in says["How it does"]
    assert "distance [m]" in says["How it does"]
    assert "It has learned with payloads." in says["Limits"]
    assert "It has not learned with pushes or other friction." in says["Limits"]
    program = says["How to run it"].partition("```python\n")[2].partition("```")[0]
    here = dict[str, object]()
    exec(program.replace("policy.onnx", str(tmp_path / "policy.onnx")), here)
    assert len(here["actions"]) == 2
    assert isinstance(here["policy"], onnxruntime.InferenceSession)
    with pytest.raises(SystemExit, match="exists already"):
        card(run, tmp_path)


def test_it_has_a_moving_picture_or_says_why_not(run, tmp_path, monkeypatch, capsys):
    try:
        next(filmstrip.frames(make_task("swimmer").mjcf, make_task("swimmer").initial_state[None],
                              8, 8))  # fmt: skip
    except filmstrip.RenderingError:
        pytest.skip("MuJoCo cannot draw on this machine")
    _, says = card(run, tmp_path)
    assert says["A policy for the task swimmer"] == "![The policy at work](motion.gif)\n"
    with Image.open(tmp_path / "motion.gif") as picture:
        assert picture.n_frames > 5

    def refuse(*_):
        raise filmstrip.RenderingError("MuJoCo cannot draw here.")

    monkeypatch.setattr(policy_card, "write_moving_picture", refuse)
    (tmp_path / "motion.gif").unlink()
    _, says = card(run, tmp_path, "--overwrite")
    assert "No moving picture: MuJoCo cannot draw here." in says["A policy for the task swimmer"]
    assert "motion.gif" not in capsys.readouterr().out.splitlines()[-1]


def test_of_a_policy_alone_it_says_that_its_training_is_not_recorded(run, tmp_path, capsys):
    (alone := tmp_path / "alone").mkdir()
    (alone / "policy.json").write_bytes((run / "policy.json").read_bytes())
    _, says = card(alone / "policy.json", tmp_path)
    assert "not recorded: this is the policy alone" in says["How it was made"]
    assert "| seed | not recorded |" in says["How it was made"]
    assert "payloads" not in says["Limits"]
