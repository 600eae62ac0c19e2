"""Who may reach the page: this machine alone, and no other page through its browser."""

from __future__ import annotations

import contextlib
import logging
import socket
import warnings
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from pcnde_bridge.errors import InputError, PCNDEError
from pcnde_bridge.model.pcnde import PCNDE
from pcnde_bridge.uncertainty.novelty import OutsideTrainingWarning

if TYPE_CHECKING:
    from dash import Dash
    from werkzeug.serving import BaseWSGIServer

ADDRESS = "127.0.0.1"
"""The page listens nowhere else."""

HOSTS = ("127.0.0.1", "localhost")
"""Names under which it answers."""

_MISSING = 'The page needs packages that are not installed: pip install "pcnde-bridge[app]".'


def make_app(model: PCNDE, name: str) -> Dash:
    """Page of a model, with its callbacks and guards.

    Parameters
    ----------
    model : PCNDE
        Computed by the JAX engine.
    name : str
        Of the model, for the heading.

    Raises
    ------
    PCNDEError
        If the extra ``app`` is not installed.
    """
    if find_spec("dash") is None:
        raise PCNDEError(_MISSING)
    from dash import Dash

    from pcnde_bridge.app import callbacks, page
    from pcnde_bridge.app.explorer import Explorer

    explorer = Explorer(model)
    with contextlib.suppress(PCNDEError):  # the page says it
        explorer.prediction(explorer.choices.first)  # compiles, so that the page need not wait
    app = Dash(
        __name__,
        assets_folder=str(Path(__file__).with_name("assets")),
        serve_locally=True,
        title=f"PCNDE – {name}",
        update_title="",
    )
    app.index_string = app.index_string.replace("<html>", '<html lang="en">')
    app.layout = page.layout(explorer, name)
    callbacks.connect(app, explorer)
    _guard(app)
    return app


def _guard(app: Dash) -> None:
    """Refuse requests that another site has the browser send.

    A site can have its own name lead to this machine (DNS rebinding), but not change the
    Host that the browser names then; and a browser says from which Origin it posts.
    """
    from flask import abort, request

    def only_this_machine() -> None:
        origin = request.headers.get("Origin")
        if _name(f"//{request.host}") not in HOSTS or (
            origin is not None and _name(origin) not in HOSTS
        ):
            abort(403, "This page is for this machine only; open it as http://127.0.0.1.")

    app.server.before_request(only_this_machine)


def _name(url: str) -> str | None:
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


def make_server(model: PCNDE, name: str, port: int = 8050) -> BaseWSGIServer:
    """Server of a model's page, bound and ready; its ``serve_forever`` serves.

    Parameters
    ----------
    model, name
        See :func:`make_app`.
    port : int
        0 takes any free one; the server's ``port`` says which.

    Raises
    ------
    PCNDEError
        If the extra ``app`` is not installed.
    InputError
        If the port cannot be used.
    """
    app = make_app(model, name)
    from werkzeug import serving

    class Handler(serving.WSGIRequestHandler):
        protocol_version = "HTTP/1.1"  # keeps connections, for quicker answers

        def log_request(self, *_: object) -> None:
            """Say nothing of every request."""

    bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.bind((ADDRESS, port))
        bound.listen()
        return serving.make_server(
            ADDRESS,
            bound.getsockname()[1],
            app.server,
            threaded=True,
            request_handler=Handler,
            fd=bound.fileno(),
        )
    except (OSError, OverflowError) as error:
        raise InputError(
            f"Port {port} of this machine cannot be used: {error}. Choose another with --port."
        ) from error
    finally:
        bound.close()  # the server has its own copy


def serve(model: PCNDE, name: str, port: int = 8050) -> None:
    """Serve a model's page until Ctrl-C.

    Parameters
    ----------
    model, name, port
        See :func:`make_server`.

    Raises
    ------
    PCNDEError, InputError
        See :func:`make_server`.
    """
    server = make_server(model, name, port)
    # The page says it itself.
    warnings.filterwarnings("ignore", category=OutsideTrainingWarning)
    logging.getLogger("pcnde_bridge.hemodynamics.solver").setLevel(logging.WARNING)
    print(f"Explore {name} at http://{ADDRESS}:{server.port} (Ctrl-C ends).", flush=True)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        pass
    finally:
        server.server_close()
