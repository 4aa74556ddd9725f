# Copyright 2026 vgps_ros maintainers. SPDX-License-Identifier: Apache-2.0
"""Keeps other web pages, which a browser may have open, from the live page's WebSocket.

Browsers let every page open a WebSocket to every address, and name the page's own address in the
header Origin. The library websockets refuses origins that its server does not list, but viser 1.1
starts this server without a list, and has no option for one.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from websockets.asyncio import server
from websockets.typing import Origin

_NAMES = ("127.0.0.1", "localhost")


@contextmanager
def only_own_origin() -> Iterator[None]:
    """Gives a list of origins to the servers that viser starts meanwhile: their own addresses."""
    serve = server.serve

    def serve_itself(handler: Any, host: str, port: int, **options: Any) -> Any:
        origins = [Origin(f"http://{name}:{port}") for name in _NAMES]
        return serve(handler, host, port, origins=origins, **options)

    server.serve = serve_itself  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]
