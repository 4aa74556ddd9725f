# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The page on which anyone drives an exported policy, and the files beside it."""

import functools
import http.server
import re
import threading
from contextlib import contextmanager

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from tests.browser import LACKING, opened
from tests.onnx_models import drawn_policy
from tests.servo_arm import REMEMBERING, write_arm
from vgps_ros.core.memory import LAST_ACTION
from vgps_ros.programs.__main__ import main as vgps
from vgps_ros.robot.executed_control import ExactMean, RememberingPolicy
from vgps_ros.storage.run_folder import load_policy, save_policy
from vgps_ros.tasks import make_task
from vgps_ros.tasks.registry import task_file_of, task_names
from vgps_ros.views.web import PAGE_FILES, page
from vgps_ros.views.web.page import for_older_mujoco

needs_parts = pytest.mark.skipif(
    not (page.PARTS / "stamp").is_file(), reason="The page has no parts: make web."
)
POLICY = task_file_of("quadruped").parent / "policy.json"  # which vgps_ros ships


def written(policy, task, folder, *more):
    """Writes the page of a policy, and returns its folder."""
    save_policy(policy, task.name, folder / "policy.json")
    words = ["--output", folder / "policy.onnx", "--web", folder / "page", *more]
    vgps(["export", str(folder / "policy.json"), *map(str, words)])
    return folder / "page"


@pytest.fixture
def swimmers(swimmer, tmp_path):
    return written(drawn_policy(swimmer), swimmer, tmp_path)


@needs_parts
def test_the_folder_has_the_page_and_what_it_holds(swimmers):
    assert sorted(path.name for path in swimmers.iterdir()) == sorted(PAGE_FILES)
    content = (swimmers / "policy.onnx").read_bytes()
    assert content == (swimmers.parent / "policy.onnx").read_bytes()
    mujoco.MjModel.from_xml_path(str(swimmers / "robot.xml"))


@needs_parts
def test_the_page_names_no_other_address_and_allows_no_request(swimmers):
    text = (swimmers / "index.html").read_text()
    outside = re.sub(r'<script type="text/plain".*?</script>', "", text, flags=re.DOTALL)
    assert not re.search(r"https?:|//[a-z]+\.|src=|@import|url\(", outside)
    assert "default-src 'none'" in outside
    assert "connect-src" not in outside


@needs_parts
def test_nothing_is_replaced_unasked(swimmers):
    words = ["export", str(swimmers.parent / "policy.json"), "--output", str(swimmers / "new.onnx")]
    before = (swimmers / "index.html").read_bytes()
    with pytest.raises(SystemExit, match=r"index\.html' exists already"):
        vgps([*words, "--web", str(swimmers)])
    assert not (swimmers / "new.onnx").exists()
    vgps([*words, "--web", str(swimmers), "--overwrite"])
    assert (swimmers / "index.html").read_bytes() == before


def test_without_its_parts_one_sentence_says_how_to_get_them(swimmer, tmp_path, monkeypatch):
    monkeypatch.setattr(page, "PARTS", tmp_path / "none")
    with pytest.raises(SystemExit, match="run `make web`"):
        written(drawn_policy(swimmer), swimmer, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["policy.json"]


@pytest.mark.parametrize("name", task_names())
def test_a_robot_for_an_older_mujoco_moves_to_the_same_bits(name, rng):
    task = make_task(name)
    text = for_older_mujoco(task.mjcf)
    assert " input=" not in text
    models = [mujoco.MjModel.from_xml_string(each) for each in (task.mjcf, text)]
    motions = [mujoco.MjData(model) for model in models]
    for _ in range(50):
        control = rng.uniform(-1.0, 1.0, models[0].nu)
        for model, data in zip(models, motions, strict=True):
            data.ctrl = control
            mujoco.mj_step(model, data)
    assert_array_equal(motions[0].qpos, motions[1].qpos)


# What a browser does.


@contextmanager
def served(folder):
    """Serves a folder as any server of files does, and yields its address."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/index.html"
        server.shutdown()


@contextmanager
def driven(address):
    """Opens a page, small since it is drawn in software, once its robot moves."""
    with opened("about:blank", 700, 440) as view:
        errors, requests = [], []
        view.on("pageerror", lambda error: errors.append(str(error)))
        view.on("request", lambda request: requests.append(request.url))
        view.goto(address)
        wait(view, "globalThis.vgps?.step > 2")
        yield view
        assert not errors
        others = [url for url in requests if not url.startswith(("blob:", "data:"))]
        assert others == [address]


def wait(view, condition):
    view.wait_for_function(condition, polling=200)


def wait_for(view, seconds):
    """Waits for so much of the robot's time."""
    wait(view, f"vgps.time > {view.evaluate('vgps.time') + seconds}")


def steps_of(view, count):
    """Returns commands, observations and controls of the first steps after a reset."""
    view.keyboard.press("r")
    wait(view, f"vgps.step >= {count} && vgps.recent[0].step === 0")
    recent = view.evaluate("vgps.recent")[:count]
    keys = ("command", "observation", "control")
    return (np.array([step[key] for step in recent]) for key in keys)


def assert_steps_are_ours(task, policy, steps, tolerance):
    """Compares what the page has read and done with what we do by MuJoCo 4, from the same start."""
    commands, observations, controls = steps
    observation, past = task.observation, task.observation.past
    context = task.signals.context(commands, task.signals.phases(len(commands), 0.0))
    remembering = RememberingPolicy(policy, past) if past else None
    mean, memory, x = ExactMean(policy), None, task.initial_state
    compared = [i for i, name in enumerate(observation.names) if not name.startswith(LAST_ACTION)]
    deviations = []
    for z, theirs, their_control in zip(context, observations, controls, strict=True):
        read, told = observation.readings(x), z[list(observation.columns)]
        if remembering:
            seen = np.concatenate([read, told])[None]
            (control,), memory = remembering.answer(seen, memory)
            frames = past.numbers(memory._replace(action=past.resting[None] * 0.0))[0]
            ours = np.concatenate([frames, told])
        else:
            ours = np.concatenate([read, told])
            control = mean(ours)
        control = np.clip(control, *task.controls.limits)
        deviations += [np.abs(ours - theirs)[compared].max(), np.abs(control - their_control).max()]
        x = task.dynamics.step(x, control)
    assert max(deviations) < tolerance, deviations


CLOCK = "vgps.recent.at(-1).observation.at(-1)"  # its cosine
browser = [
    needs_parts,
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.skipif(bool(LACKING), reason=LACKING or "There is a browser."),
]


@pytest.fixture(scope="module")
def quadruped():
    if not POLICY.is_file():
        pytest.skip("vgps_ros ships no policy of the quadruped.")
    return make_task("quadruped"), load_policy(POLICY)[0]


class TestInABrowser:
    pytestmark = browser

    def test_a_visitor_drives_and_pushes_the_quadruped(self, quadruped, tmp_path):
        task, policy = quadruped
        with driven(f"file://{written(policy, task, tmp_path) / 'index.html'}") as view:
            standing = commands, observations, _ = [*steps_of(view, 30)]
            assert_steps_are_ours(task, policy, standing, 1e-4)
            assert not commands.any()
            assert not observations[:, -2:].any()  # its clock stands still
            view.keyboard.down("w")
            # It reads float32, and rounding grows at each impact of a foot.
            assert_steps_are_ours(task, policy, steps_of(view, 50), 1e-4)
            wait_for(view, 2.0)
            view.screenshot(path=tmp_path / "0.png")
            fastest = task.signals.commands[0].highest
            assert view.evaluate("vgps.command[0]") == pytest.approx(fastest)
            assert view.evaluate("vgps.done[0]") == pytest.approx(fastest, rel=0.25)
            assert view.evaluate("vgps.position[0]") > 1.5
            view.keyboard.up("w")
            before = view.evaluate("vgps.heading")
            view.keyboard.down("q")
            wait_for(view, 1.0)
            assert 0.5 < view.evaluate("vgps.heading") - before < 3.0
            view.screenshot(path=tmp_path / "1.png")
            view.keyboard.up("q")
            wait_for(view, 0.5)
            pad = view.locator("#push .pad").bounding_box()
            x, y = pad["x"] + pad["width"] / 2, pad["y"] + pad["height"] / 2
            view.mouse.move(x, y)
            view.mouse.down()
            view.mouse.move(x - 0.35 * pad["width"], y)
            view.mouse.up()  # which pushes it to the left
            wait(view, "vgps.done[1] > 0.1")
            wait(view, f"{CLOCK} !== 0")  # it steps
            view.screenshot(path=tmp_path / "2.png")
            wait_for(view, 1.0)
            view.mouse.move(350, 180)  # the robot is in the middle; it is pulled to the right
            view.mouse.down()
            view.mouse.move(450, 180)
            wait(view, "Math.hypot(vgps.done[0], vgps.done[1]) > 0.15")
            view.mouse.up()
            wait_for(view, 2.0)
            wait(view, f"{CLOCK} === 0")  # and stands again
            assert not view.evaluate("vgps.fallen")
            assert view.evaluate("vgps.time") > 6.0  # it never fell and began anew
            view.screenshot(path=tmp_path / "3.png")
        strip = [Image.open(tmp_path / f"{i}.png") for i in range(4)]
        width, height = strip[0].size
        whole = Image.new("RGB", (2 * width, 2 * height))
        for i, picture in enumerate(strip):
            whole.paste(picture, (i % 2 * width, i // 2 * height))
        whole.save(tmp_path / "driven.png")

    def test_a_server_of_files_is_enough_and_memory_is_carried(self, tmp_path):
        task = make_task(write_arm(tmp_path, task=REMEMBERING))
        policy = drawn_policy(task, scale=0.05)
        folder = written(policy, task, tmp_path, "--precision", "float64")
        with served(folder) as address, driven(address) as view:
            assert_steps_are_ours(task, policy, steps_of(view, 50), 1e-9)
