# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Names that libraries do not promise still mean what this project takes them for."""

import ctypes
import threading

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.experimental.events_executor import EventsExecutor
from std_srvs.srv import Trigger

from vgps_ros.ros_runtime.rclpy_internals import ThreadedExecutor, wrap_callback, wrap_sender


@pytest.mark.parametrize("make", [SingleThreadedExecutor, EventsExecutor])
def test_rclpys_executors_read_a_services_callback_and_sender_for_each_request(graph, make):
    context, calls = graph.node.context, []
    node, executor = rclpy.create_node("asked", context=context), make(context=context)
    service = node.create_service(Trigger, "ask", lambda _, response: response)
    executor.add_node(node)

    def noting(name):
        return lambda call: lambda *arguments: (calls.append(name), call(*arguments))[1]

    wrap_callback(service, noting("callback"))
    wrap_sender(service, noting("sender"))
    answer = graph.call_async(Trigger, "ask")
    graph.spin_until(lambda: executor.spin_once(timeout_sec=0.05) or calls[1:] or answer.done())
    node.destroy_node()
    assert calls == ["callback", "sender"], (
        "rclpy does not read a service's callback and send_response any more: see rclpy_internals"
    )


def test_the_threads_of_an_executor_end_with_it(graph):
    before = set(threading.enumerate())
    executor = ThreadedExecutor(2, context=graph.node.context)
    executor.create_task(lambda: None)
    executor.spin_once(timeout_sec=1.0)
    assert set(threading.enumerate()) > before
    executor.shutdown()
    left = set(threading.enumerate()) - before
    assert not left, "rclpy keeps an executor's threads elsewhere now: see rclpy_internals"


def test_the_c_library_has_the_timers_that_end_a_process():
    missing = [name for name in ("timer_create", "timer_settime", "_exit")
               if not hasattr(ctypes.CDLL(None), name)]  # fmt: skip
    assert not missing, "exit_timer needs the GNU C library"
