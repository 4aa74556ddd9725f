# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Processes of a graph in a ROS domain of its own, for benchmarks."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import rclpy
from ament_index_python.packages import get_package_prefix
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

DOMAIN = 99  # no test's, and no demonstration's
PATIENCE = 60.0  # for anything that must happen [s]


class Bench:
    """A node of the benchmark's own, and the processes that it measures."""

    def __init__(self, folder: Path):
        self._environment = {
            **os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "ROS_LOG_DIR": str(folder)
        }  # fmt: skip
        self._log = folder / "output"
        self._programs = Path(get_package_prefix("vgps_ros"), "lib", "vgps_ros")
        self._clients: dict[str, Client] = {}
        self._processes: list[subprocess.Popen[bytes]] = []
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context, domain_id=DOMAIN,
            signal_handler_options=SignalHandlerOptions.NO,
        )  # fmt: skip
        self.node: Node = rclpy.create_node("benchmark", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def start(
        self,
        executable: str,
        *remappings: str,
        host: Sequence[str] = (),
        nodes: Sequence[str] = (),
        **parameters: Any,
    ) -> int:
        """Starts a node; returns its process id.

        Args:
            executable: its name.
            remappings: of names, `from:=to`.
            host: words before a command that start it on some host.
            nodes: those of the executable `node`.
            parameters: of the node.
        """
        ros = [word for remapping in remappings for word in ("-r", remapping)]
        for name, value in parameters.items():
            ros += ["-p", f"{name}:={value}"]
        return self._start([*host, str(self._programs / executable), *nodes, "--ros-args", *ros])

    def start_module(self, module: str) -> int:
        """Starts a module of Python; returns its process id."""
        return self._start([sys.executable, "-m", module])

    def _start(self, command: list[str]) -> int:
        with self._log.open("ab") as log:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=self._environment
            )
        self._processes.append(process)
        return process.pid

    def spin_until(
        self, condition: Callable[[], Any], what: str, patience: float = PATIENCE
    ) -> None:
        """Spins until a condition is true.

        Raises:
            TimeoutError: it does not become true.
        """
        end = time.monotonic() + patience
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(
                    f"Waited {patience:g} s for {what}; the processes say:\n{self._log.read_text()}"
                )
            self._executor.spin_once(timeout_sec=0.1)

    def spin_to(self, due: float) -> None:
        """Spins until a time of the steady clock [s]."""
        while (left := due - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def call(self, kind: type, name: str, request: Any) -> Any:
        """Calls a service once it is there, and returns its response."""
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        self.spin_until(client.service_is_ready, f"the service {name}")
        future = client.call_async(request)
        self.spin_until(future.done, f"the answer of {name}")
        return future.result()

    def close(self) -> None:
        """Ends the processes and the node."""
        for process in self._processes:
            process.send_signal(signal.SIGINT)
        for process in self._processes:
            _wait(process)
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


def _wait(process: "subprocess.Popen[bytes]") -> None:
    try:
        process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def bench() -> Iterator[Bench]:
    """Gives a graph that ends, with all its processes, at the end of the `with` statement."""
    with TemporaryDirectory() as folder:
        it = Bench(Path(folder))
        try:
            yield it
        finally:
            it.close()


def resident_memory(pid: int) -> float:
    """Returns the largest resident memory that a process had [MB]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(float(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM"))


def processor_seconds(pid: int) -> float:
    """Returns the processor time that a process has taken [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
