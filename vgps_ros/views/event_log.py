# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""The metrics of a training as event files, which TensorBoard draws as they come.

The package tensorboardX, which requirements/tensorboard.txt pins, writes them.
"""

import math
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

from vgps_ros.core.errors import VgpsError
from vgps_ros.search.metrics import IterationMetrics


class EventLog:
    """Writes one event file. What is not finite is left out.

    Args:
        folder: folder of the files. One that is there already stays; TensorBoard shows of it what
            comes before the first iteration of this one.

    Raises:
        VgpsError: the package is not installed.
    """

    def __init__(self, folder: Path):
        try:
            from tensorboardX import SummaryWriter
        except ModuleNotFoundError as error:
            raise VgpsError(
                f"--tensorboard needs the package {error.name}: pip install -r "
                "requirements/tensorboard.txt."
            ) from error
        self._open = partial(SummaryWriter, str(folder))
        self._writer: Any = None

    def iteration(self, metrics: IterationMetrics) -> None:
        """Writes an iteration's metrics, and has them on disk when it returns."""
        if self._writer is None:
            self._writer = self._open(purge_step=metrics.k)
        for field in fields(IterationMetrics):
            value = getattr(metrics, field.name)
            many = isinstance(value, tuple)
            for i, number in enumerate(value if many else (value,)):
                if isinstance(number, int | float) and math.isfinite(number) and field.name != "k":
                    name = f"{field.name}/{i}" if many else field.name
                    self._writer.add_scalar(name, number, metrics.k)
        self._writer.flush()

    def close(self) -> None:
        """Closes the file."""
        if self._writer is not None:
            self._writer.close()
