# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The node `live` and its page, which a real browser clicks through."""

import math
import os
import re
import subprocess
import sys
import time
import urllib.request
from contextlib import suppress

import msgspec
import numpy as np
import pytest
import viser
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import GetSimulationState
from std_msgs.msg import String
from vgps_msgs.msg import LearningProgress, Signals
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol
from zstandard import ZstdDecompressor

from tests.browser import LACKING, opened
from tests.nodes.conftest import EACH_SIGNAL
from tests.nodes.test_simulation import PAUSED, PERIOD, PLAYING
from vgps_ros.core.errors import InvalidInputError
from vgps_ros.messages.conversions import nanoseconds
from vgps_ros.messages.names import SAFE_ACTION, driver
from vgps_ros.ros_runtime.commands import FACTS, commands_of
from vgps_ros.ros_runtime.qos import LATCHED, STREAM

OK, ERROR = DiagnosticStatus.OK, DiagnosticStatus.ERROR


def start(graph):
    """Starts the node; returns the process and the page's address."""
    live = graph.start("live", port=18081)
    graph.spin_until_output(live, "The page is http")
    return live, re.search(r"The page is (\S+)", live.output)[1]


@EACH_SIGNAL
def test_it_serves_a_page_to_this_machine_alone_and_ends_cleanly(graph, number):
    live, address = start(graph)
    assert address.startswith("http://127.0.0.1:")
    page = urllib.request.urlopen(address, timeout=60).read()
    assert b"<html" in page
    assert live.end(number) == 0, live.output
    assert all(line.startswith("[INFO]") for line in live.output.splitlines()), live.output
    assert "Traceback" not in live.output


@pytest.mark.slow
def test_two_pages_have_ports_of_their_own(graph):
    (_, first), (_, second) = start(graph), start(graph)
    assert first != second


@pytest.fixture(scope="module")
def page(shared_graph):
    """A node that some tests share, and its page's address."""
    return start(shared_graph)


def origin_is_refused(address, origin):
    """Returns whether a WebSocket is refused to a page of this origin, or to none if it is None."""
    with suppress(InvalidStatus), connect(address, origin=origin):
        return False
    return True


def test_what_commands_and_pushes_is_for_its_own_page_alone(page):
    _, address = page
    own = [address, address.replace("127.0.0.1", "localhost")]
    others = ["http://example.com", "null", None, "http://127.0.0.1:1", f"{address}.example.com"]
    heard_at = Page(address).heard_at
    assert [o for o in own + others if origin_is_refused(heard_at, o)] == others


def test_a_robot_that_does_not_compile_is_left_out_with_a_sentence(page, shared_graph):
    robots = shared_graph.publisher(String, "mjcf_description", LATCHED)
    robots.publish(String(data="<mujoco><worldbody><geom/></mujoco>"))
    shared_graph.diagnosis("live", ERROR, "Left out a robot: ")


def test_progress_without_a_cost_ends_nothing(page, shared_graph):
    node, address = page
    progress = shared_graph.publisher(LearningProgress, "learning_progress", STREAM)
    for iteration in (1, 2):
        progress.publish(LearningProgress(iteration=iteration))
    shared_graph.spin_for(2.0)
    assert node.running
    assert origin_is_refused(Page(address).heard_at, "null")  # it still answers


def test_without_viser_it_names_the_file_that_installs_it(domain_id):
    code = "import sys; sys.modules['viser'] = None; from vgps_ros.programs.node import start; "
    run = subprocess.run(
        [sys.executable, "-c", f"{code}start(['live'])"],
        env=os.environ | {"ROS_DOMAIN_ID": str(domain_id)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 1
    assert run.stderr.endswith(
        "The page needs the package viser: pip install -r requirements/live.txt.\n"
    )
    assert "Traceback" not in run.stderr


@pytest.mark.parametrize(
    ("message", "values", "said"),
    [
        ("Running.", {"simulated time": "1 s"}, None),
        ("Running.", {"commands sent": "0", "active": "False"}, "nobody: "),
        (
            "It is late.",
            {"commands sent": "3", "active": "True", SAFE_ACTION: "True"},
            "safe action. It is late.",
        ),
        (
            "Running.",
            {"commands sent": "3", "active": "True", "policy of iteration": "7"},
            "the policy of iteration 7. Running.",
        ),
        (
            "Running.",
            {"commands sent": "3", "active": "True", "policy of iteration": "0"},
            "the policy of a file. Running.",
        ),
        (
            "Running.",
            {"commands sent": "3", "active": "True", "plan age": "0.02 s", "plan cost": "4"},
            "plans: plan age 0.02 s, plan cost 4. Running.",
        ),
    ],
)
def test_who_drives_is_said_in_words(message, values, said):
    found = driver(message, values)
    assert found is None if said is None else said in found


def commanding(graph, told, controller="policy_executor"):
    """Starts a controller that is told an angle and a lift, and the page.

    Returns what connects a page, what the graph is told, and a function that connects a stick.
    """
    graph.start(controller, task=told)
    _, address = start(graph)
    commands = graph.messages(Signals, "command")
    page = Page(address)

    def stick():
        return connect(page.heard_at, origin=address)

    def is_heard():  # once the page knows the commands
        with stick() as held:
            held.send("{}")
            graph.spin_for(0.2)
        return commands

    graph.spin_until(is_heard, what="the page to know the commands")
    return page, commands, stick


def test_the_stick_commands_within_bounds_and_only_as_long_as_it_tells(graph, told):
    _, commands, stick = commanding(graph, told)

    def after(held, text, is_heard=True):
        """Returns what is commanded after the stick told a text."""
        graph.spin_for(0.2)
        commands.clear()
        held.send(text)
        if is_heard:
            graph.spin_until(lambda: commands, what=f"what {text:.20} commands")
        graph.spin_for(0.3)
        return [dict(zip(m.names, m.values, strict=True)) for m in commands]

    with stick() as held:
        assert after(held, '{"angle": 0.5}') == [{"angle": 0.5, "lift": 0.0}]
        assert after(held, '{"angle": -7e99, "lift": 9}') == [{"angle": -1.0, "lift": 0.5}]
        for wrong in (
            '{"angle": NaN}',
            '{"angle": 1e999}',
            '{"speed": 1.0}',
            '{"angle": "fast"}',
            '{"angle": null}',
            '{"angle": [0.1, 0.2]}',
            "[0.5]",
            "half",
            "[" * 3000,
            b"\xff",
        ):
            assert after(held, wrong, is_heard=False) == [], wrong
        assert after(held, "{}") == [{"angle": 0.0, "lift": 0.0}]
        assert after(held, '{"lift": 0.1}') == [{"angle": 0.0, "lift": 0.1}]
        commands.clear()
    graph.spin_until(lambda: commands, what="rest, since the page went")
    assert list(commands[-1].values) == [0.0, 0.0]
    with stick() as held:
        assert after(held, '{"lift": 0.1}') == [{"angle": 0.0, "lift": 0.1}]
        assert after(held, "x" * 5000) == [{"angle": 0.0, "lift": 0.0}]
        with pytest.raises(ConnectionClosed):
            held.recv(timeout=10)


def test_a_page_that_dies_while_its_stick_is_held_lets_it_go(graph, told):
    page, commands, _ = commanding(graph, told, "mpc")
    code = (
        "import os, sys; from websockets.sync.client import connect; "
        "held = connect(sys.argv[1], origin=sys.argv[2]); "
        """held.send('{"angle": 1.0}'); sys.stdin.read(); os._exit(1)"""
    )
    words = [sys.executable, "-c", code, page.heard_at, page.address]
    with subprocess.Popen(words, stdin=subprocess.PIPE) as dying:
        graph.spin_until(lambda: commands[-1].values[0] == 1.0, what="the command")
        dying.stdin.close()
    graph.spin_until(lambda: commands[-1].values[0] == 0.0, what="rest")


@pytest.mark.parametrize(
    ("lowest", "highest", "sources"),
    [
        ([0.0, 0.0], [1.0, 1.0], ["", ""]),
        ([0.0], [float("nan")], [""]),
        ([2.0], [1.0], [""]),
        (["slow"], ["fast"], [""]),
        ([0.0], [1.0], ["cmd_vel/linear/w"]),
    ],
)
def test_parameters_that_tell_no_commands_are_refused_with_a_sentence(lowest, highest, sources):
    given = {"name": ["speed"], "lowest": lowest, "highest": highest, "source": sources}
    facts = [given.get(field, ["m/s"]) for field in FACTS.values()]
    with pytest.raises(InvalidInputError, match="must be lists of one length, with finite ranges"):
        commands_of(facts)


def test_without_commands_the_stick_commands_nothing(graph):
    graph.start("policy_executor", task="rotor")
    _, address = start(graph)
    commands = graph.messages(Signals, "command")
    with connect(Page(address).heard_at, origin=address) as held:
        graph.diagnosis("policy_executor", OK)
        held.send('{"angle": 1.0}')
        graph.spin_for(2.0)
    assert commands == []


class Page:
    """What a page's scripts say to the server; the live page's own ones, or another's."""

    def __init__(self, address, origin=None):
        protocol = Subprotocol(f"viser-v{viser.__version__}")
        self.address, self._seen = address, []
        self._socket = connect(
            address.replace("http", "ws"),
            origin=origin or address,
            subprotocols=[protocol],
            compression=None,
            close_timeout=0.1,  # it does not read all that is left
        )
        axes, numbers = (0.0, 0.0, 1.0), {"fov": 1.0, "near": 0.1, "far": 9.0}
        sides = {"image_height": 9, "image_width": 9, "look_at": axes, "up_direction": axes}
        camera = {"wxyz": (1.0, 0.0, 0.0, 0.0), "position": axes}
        self.say("ViewerCameraMessage", **camera, **numbers, **sides)

    def say(self, kind, **fields):
        self._socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def drag(self, phase, end=(1.0, 1.0, 1.0), start=(0.0, 0.0, 0.0)):
        screen = {"start_screen_pos": (0.0, 0.0), "end_screen_pos": (0.0, 0.0)}
        pressed = {"button": "left", "modifier": None, "owner": "", "instance_index": None}
        ends = {"start_position": start, "end_position": end}
        name = {"phase": phase, "name": "/world/geom_1"}
        self.say("SceneNodeDragMessage", **name, **ends, **screen, **pressed)

    def heard(self, kind, prop, text, timeout=30.0):
        """Waits for a message of a kind that shows a text in a property, and returns it."""
        seen, end = iter(self._seen), time.monotonic() + timeout
        while True:
            for m in seen:
                if m["type"] == kind and text in str(m.get("props", m)[prop]):
                    return m
            raw = self._socket.recv(timeout=end - time.monotonic())
            size, length = (int.from_bytes(raw[i : i + 8], "little") for i in (0, 8))
            unpacked = ZstdDecompressor().decompress(raw[16 : 16 + length], max_output_size=size)
            messages = msgspec.msgpack.decode(unpacked)["messages"]
            self._seen += messages
            seen = iter(messages)

    @property
    def heard_at(self):
        """Where the page says that it lives, and what its stick tells."""
        html = self.heard("GuiHtmlMessage", "content", "WebSocket")
        return re.search(r"ws://127.0.0.1:\d+/\d+", html["props"]["content"])[0]

    def pulse(self):
        """Returns the connection on which the page says that it lives."""
        return connect(self.heard_at, origin=self.address)

    def set(self, uuid, value):
        self.say("GuiUpdateMessage", uuid=uuid, updates={"value": value})

    def close(self):
        self._socket.close()


def test_a_drag_pushes_within_bounds_and_only_while_its_page_lives(graph):
    graph.start("simulation", start_paused=True)
    _, address = start(graph)
    pushes = graph.messages(WrenchStamped, "push")
    graph.diagnosis("live", OK)
    page = Page(address)
    pulse = page.pulse()

    def pushes_in(seconds, lives=True):
        """Returns how many pushes come in the last half of a time."""
        for k in range(2 * round(seconds / 0.1)):
            if k == round(seconds / 0.1):
                pushes.clear()
            if lives:
                pulse.send("")
            graph.spin_for(0.05)
        return len(pushes)

    page.drag("update")
    assert pushes_in(1.0) == 0, "a drag that never began"
    page.drag("start")
    assert pushes_in(2.0) > 0, "a pointer that is held still"
    other = Page(address)
    other.drag("update", end=(-9.0, 0.0, 0.0))
    assert pushes_in(0.5) > 0
    assert pushes[-1].wrench.force.x > 0.0, "another page's pointer"
    other.close()
    assert pushes_in(3.0, lives=False) == 0, "a page that is frozen"
    stiffness = page.heard("GuiNumberMessage", "label", "N per m")["uuid"]
    for value in (1e9, 1e308, -1.0, math.nan, math.inf, "many", [1.0], None):
        page.set(stiffness, value)
        for end in ((1.0, 1.0, 1.0), (1e308, -1e308, 0.0), (math.nan, 0.0, 0.0), (0.0,), "far"):
            page.drag("start", start=end)
            page.drag("update", end)
        page.drag("start")
        pushes_in(0.2)
        found = np.array([(f.x, f.y, f.z) for f in (m.wrench.force for m in pushes)])
        assert (np.abs(found) < 1e5).all(), value  # 100 times the weight, and none is NaN
    page.close()  # which viser may have ceased to hear
    pulse.close()
    page = Page(address)
    pulse = page.pulse()
    page.set(stiffness, 1.0)
    page.drag("start")
    assert pushes_in(1.0) > 0
    pulse.close()
    assert pushes_in(1.0, lives=False) == 0, "a page that is gone"
    page.close()


def test_another_page_of_the_browser_presses_no_button_and_shares_nothing(page):
    live, address = page
    own, other = Page(address), Page(address, "http://example.com")
    buttons = own.heard("GuiButtonGroupMessage", "options", "Play")["uuid"]
    answer = "GuiUpdateMessage", "updates", "There is no simulation named simulation"
    other.say("ShareUrlRequest")
    other.set(buttons, "Reset")
    with pytest.raises(TimeoutError):
        own.heard(*answer, timeout=3.0)
    with own.pulse() as pulse:
        pulse.send("")
        time.sleep(0.5)
        own.set(buttons, "Reset")
        own.heard(*answer)
    assert live.running
    assert "hare" not in live.output  # a share URL
    other.close()
    own.close()


@pytest.mark.slow
@pytest.mark.skipif(bool(LACKING), reason=LACKING)
def test_the_page_clicked_through_in_a_browser(graph, tmp_path):
    graph.start("mpc", horizon=0.2, plan_every=5)
    graph.diagnosis("mpc", OK, "Waiting for joint_states")
    graph.start("simulation", start_paused=True)  # its state, once a second, ends the waiting
    _, address = start(graph)
    states = graph.messages(JointState, "joint_states")
    pushes = graph.messages(WrenchStamped, "push")
    progress = graph.publisher(LearningProgress, "learning_progress", STREAM)

    def state():
        return graph.call(GetSimulationState, "simulation/get_simulation_state").state.state

    def latest():
        graph.spin_until(lambda: states, what="a state")
        return max(nanoseconds(message.header.stamp) for message in states)

    def targets():
        request = GetParameters.Request(names=["cost.targets"])
        response = graph.call(GetParameters, "mpc/get_parameters", request)
        return list(response.values[0].double_array_value)

    def no_more_pushes():
        count = len(pushes)
        graph.spin_for(1.0)
        return len(pushes) == count

    with opened(address) as page:
        page.get_by_text("paused 0.00 s").wait_for()
        page.get_by_text("Who drives?").wait_for()
        page.get_by_text("Step", exact=True).click()
        graph.spin_until(lambda: latest() == PERIOD, what="one step")
        page.get_by_text("1 steps: done.").wait_for()
        page.get_by_text("/mpc: plans: plan age").wait_for()

        page.get_by_text("Play", exact=True).click()
        graph.spin_until(lambda: state() == PLAYING, what="the simulation to play")
        page.get_by_text("Step", exact=True).click()
        page.get_by_text("it must be paused before it can step").wait_for()
        page.get_by_text("Pause", exact=True).click()
        graph.spin_until(lambda: state() == PAUSED, what="the pause")
        page.get_by_text("Reset", exact=True).click()
        page.get_by_text("paused 0.00 s").wait_for()

        # The robot's centre of mass, which its middle link has, is in the middle of the picture.
        page.mouse.move(450, 250)
        page.mouse.down()
        page.mouse.move(450, 220, steps=3)
        graph.spin_until(lambda: pushes, what="a push")
        page.mouse.move(450, 150, steps=3)
        page.get_by_text("Last push: middle").wait_for()
        page.screenshot(path=tmp_path / "push.png")
        graph.spin_until(
            lambda: pushes[-1].wrench.force.y > 2 * pushes[0].wrench.force.y, what="a longer pull"
        )
        assert pushes[-1].header.frame_id == "middle"
        # The mouse holds the robot, so the test itself asks for the step.
        assert graph.step(1).result == 1
        page.mouse.up()
        graph.spin_until(no_more_pushes, what="the end of the push")
        pushed = states[-1]
        assert nanoseconds(pushed.header.stamp) == PERIOD
        assert pushed.velocity[list(pushed.name).index("root_y")] > 0.01

        assert targets() == [1.0]
        page.get_by_role("slider").first.focus()
        for _ in range(5):
            page.keyboard.press("ArrowRight")
        graph.spin_until(lambda: targets()[0] > 1.0, what="another target")
        page.get_by_text("The next plan has the new cost.").wait_for()

        for k in range(1, 4):
            message = LearningProgress(iteration=k, initial_ddp_cost=1.0, ddp_cost=1.0)
            message.deterministic_cost, message.stochastic_cost_mean = 3.0 / k, math.inf
            progress.publish(message)
        page.get_by_text("cost ÷ initial DDP cost").wait_for()
        assert np.isfinite([m.position[0] for m in states]).all()


GAMEPAD = """window.pad = {mapping: "standard", axes: [0, 0, 0, 0]};
navigator.getGamepads = () => [null, window.pad]"""


@pytest.mark.slow
@pytest.mark.skipif(bool(LACKING), reason=LACKING)
def test_stick_keys_and_gamepad_of_the_page_in_a_browser(graph, told):
    page, commands, _ = commanding(graph, told)
    told_now = lambda: tuple(commands[-1].values)  # noqa: E731

    with opened(page.address) as page:
        frame = page.frame_locator("iframe[title=stick]")
        frame.get_by_text("lift").wait_for()
        stick = frame.locator(".stick").bounding_box()
        x, y = stick["x"] + stick["width"] / 2, stick["y"] + stick["height"] / 2

        def reaches(condition, what):
            graph.spin_until(lambda: condition(*told_now()), what=what)

        def comes_to_rest():
            reaches(lambda angle, lift: angle == lift == 0.0, "rest")
            graph.spin_for(1.0)
            count = len(commands)
            graph.spin_for(1.0)
            assert len(commands) == count

        page.mouse.move(x + 30, y + 30)
        page.mouse.down()
        reaches(lambda angle, lift: -1.0 < angle < -0.2 and 0.1 < lift < 0.5, "the stick")
        page.mouse.up()
        comes_to_rest()
        page.keyboard.down("ArrowUp")
        page.keyboard.down("d")
        reaches(lambda angle, lift: (angle, lift) == (1.0, 0.5), "the keys")
        page.keyboard.up("ArrowUp")
        page.keyboard.up("d")
        comes_to_rest()
        page.evaluate(GAMEPAD)
        page.evaluate("pad.axes = [0.05, -0.5, 0, 0]")
        reaches(lambda angle, lift: (angle, lift) == (0.5, 0.0), "the gamepad")
        page.evaluate("pad.axes = [0, 0, 0, 0]")
        comes_to_rest()
        commands.clear()
        page.get_by_role("textbox").first.focus()
        page.keyboard.press("w", delay=500)  # is typed
        graph.spin_for(1.0)
        assert commands == []
        page.mouse.click(100, 400)
        page.keyboard.down("w")
        graph.spin_until(lambda: commands, what="a command")
        assert told_now()[0] == 1.0
    comes_to_rest()  # as the page is closed, with the key down
