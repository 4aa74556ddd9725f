# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The workers of a Dask cluster, as an executor of `concurrent.futures`.

Dask gives what a lost worker was doing to another one. It would wait for ever where none is left.
"""

import re
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from typing import Any

from vgps_ros.core.errors import InvalidInputError, VgpsError

_ANSWER = 10.0  # longest wait for the scheduler [s]
_PATIENCE = 60  # how long solves wait for a worker [s]
_LOSSES = {  # what happened, by the error that a solve then raises
    "KilledWorker": "has lost several workers by one solve, as for want of memory",
    "CancelledError": "has lost its scheduler or all of its workers",
    "RuntimeError": "has no vgps_ros, or another one, where its scheduler is",
}


class Cluster(Executor):
    """The workers of the scheduler at an address; InvalidInputError where none answers."""

    def __init__(self, address: str):
        from distributed import Client

        self._address, self._end = address, threading.Event()
        try:
            if not re.fullmatch(r"((tcp|tls)://)?[^/\s]+:\d+", address):
                raise ValueError(address)
            self._client = Client(address, timeout=_ANSWER, set_as_default=False)
        except (OSError, ValueError) as error:
            raise InvalidInputError(
                f"No Dask scheduler answers at '{address}'; start one by `dask scheduler`, give "
                "the address that it prints, such as tcp://10.0.0.1:8786, and add workers by "
                "`dask worker ADDRESS --nthreads 1`."
            ) from error
        self._executor = self._client.get_executor(pure=False)
        threading.Thread(target=self._watch, daemon=True).start()

    def submit(self, function: Callable[..., Any], /, *given: Any, **named: Any) -> "Future[Any]":
        """Calls a function in a worker."""
        return self._executor.submit(function, *given, **named)

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        """Ends the connection; raises a sentence where workers were lost."""
        self._end.set()
        self._client.close()
        what = _LOSSES.get(getattr(kind, "__name__", ""))
        if what and (kind is not RuntimeError or "deserialization" in str(error)):
            raise VgpsError(
                f"The cluster at {self._address} {what}; start `dask scheduler` and `dask worker "
                "ADDRESS --nthreads 1` again, with this vgps_ros installed, and the same command "
                "goes on after the last whole iteration."
            ) from error

    def _watch(self) -> None:
        """Cancels what waits once there has been no worker for a while."""
        lonely = 0
        while not self._end.wait(1.0) and lonely < _PATIENCE:
            with suppress(OSError):  # a scheduler that is gone cancels all by itself
                waits = self._client.futures and not self._client.nthreads()
                lonely = lonely + 1 if waits else 0
        if lonely >= _PATIENCE:
            self._executor.shutdown(wait=False)
