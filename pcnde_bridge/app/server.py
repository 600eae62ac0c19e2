"""Server of the page, which only this machine and no other site can reach."""

from __future__ import annotations

import contextlib
import socket
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from pcnde_bridge._utils.optional import require
from pcnde_bridge.errors import InputError, PCNDEError
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.uncertainty.novelty import OutsideTrainingWarning

if TYPE_CHECKING:
    from dash import Dash
    from werkzeug.serving import BaseWSGIServer

ADDRESS = "127.0.0.1"
"""Only address at which the server listens."""

HOSTS = ("127.0.0.1", "localhost")
"""Host names to which the server answers."""


def make_app(model: PCNDE, name: str, url: str = "") -> Dash:
    """Create the page of a model, with its callbacks and access checks.

    Parameters
    ----------
    model : PCNDE
        Model on the JAX engine.
    name : str
        Name of the model, for the heading.
    url : str
        Address of the page behind a proxy, such as that of JupyterHub.

    Raises
    ------
    MissingExtraError
        If the extra ``app`` is not installed.
    InputError
        If the address is not usable.
    """
    public = urlsplit(url)
    if url and (public.scheme not in ("http", "https") or not public.hostname):
        raise InputError(f"--url must be like https://hub.org/user/me/proxy/8050/, got {url!r}.")
    new_app = require("dash", "app").Dash
    from pcnde_bridge.app import callbacks, page
    from pcnde_bridge.app.explorer import Explorer

    explorer = Explorer(model)
    with contextlib.suppress(PCNDEError):  # the page shows the error
        explorer.prediction(explorer.choices.initial)  # compiles before the page is opened
    app: Dash = new_app(
        __name__,
        assets_folder=str(Path(__file__).with_name("assets")),
        serve_locally=True,
        title=f"PCNDE – {name}",
        update_title="",
        routes_pathname_prefix="/",
        requests_pathname_prefix=f"{public.path.rstrip('/')}/",
        on_error=callbacks.report,
    )
    app.index_string = app.index_string.replace("<html>", '<html lang="en">')
    app.layout = page.layout(explorer, name)
    callbacks.connect(app, explorer)
    _restrict_access(app, [*HOSTS, public.hostname] if public.hostname else HOSTS)
    return app


def _restrict_access(app: Dash, hosts: Sequence[str]) -> None:
    """Reject requests that another site makes through the browser.

    A site can let its own name point to this machine (DNS rebinding), but it cannot change
    the Host header of such a request; and browsers send the Origin of every POST.
    """
    from flask import abort, request
    from werkzeug.sansio.utils import host_is_trusted

    def check_host() -> None:
        origin = request.headers.get("Origin", f"http://{request.host}")
        if not all(host_is_trusted(h, hosts) for h in (request.host, origin.partition("//")[2])):
            abort(403, "This page is for this machine only; open it as http://127.0.0.1.")

    app.server.before_request(check_host)


def make_server(model: PCNDE, name: str, port: int = 8050, url: str = "") -> BaseWSGIServer:
    """Create the server of a model's page, bound to its port; ``serve_forever`` runs it.

    Parameters
    ----------
    model, name, url
        See :func:`make_app`.
    port : int
        0 selects any free port; it is the server's ``port``.

    Raises
    ------
    MissingExtraError
        If the extra ``app`` is not installed.
    InputError
        If the port cannot be used.
    """
    app = make_app(model, name, url)
    from werkzeug import serving

    class Handler(serving.WSGIRequestHandler):
        protocol_version = "HTTP/1.1"  # keeps connections open, for faster answers

        def log_request(self, *_: object) -> None:
            """Log nothing, because there are many requests."""

    # Werkzeug would print and exit if the port is taken; a bound socket is handed to it.
    try:
        with socket.create_server((ADDRESS, port)) as bound:
            return serving.make_server(
                ADDRESS,
                bound.getsockname()[1],
                app.server,
                threaded=True,
                request_handler=Handler,
                fd=bound.fileno(),  # the server duplicates it
            )
    except (OSError, OverflowError) as error:
        raise InputError(
            f"Port {port} of this machine cannot be used: {error}. Choose another with --port."
        ) from error


def serve(model: PCNDE, name: str, port: int = 8050, url: str = "") -> None:
    """Serve a model's page until Ctrl-C.

    Parameters
    ----------
    model, name, port, url
        See :func:`make_server`.

    Raises
    ------
    MissingExtraError, InputError
        See :func:`make_server`.
    """
    server = make_server(model, name, port, url)
    # The page itself shows these.
    warnings.filterwarnings("ignore", category=OutsideTrainingWarning)
    where = url or f"http://{ADDRESS}:{server.port}"
    print(f"Explore {name} at {where} (Ctrl-C ends).", flush=True)
    server.serve_forever()
