"""How the page reacts.

One callback draws, and it only takes what is ready at once: the prediction, and what else
has been computed before for the same inputs.  When the controls have rested, two others
compute the interval and the 1D solver's solution, and have it drawn again.  What they
compute is kept under its inputs, so that a late result is never drawn beside other curves.

That they are done they say by ``set_props``, not by an output: Dash would draw nothing
before the outputs that the drawing depends on are there.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import threading
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from dash import ClientsideFunction, Dash, Input, Output, State, ctx, html, no_update, set_props
from dash.exceptions import PreventUpdate

from pcnde_bridge.app import page
from pcnde_bridge.app.explorer import Explorer, Scores
from pcnde_bridge.app.inputs import Inputs, read_waveform
from pcnde_bridge.errors import InputError, PCNDEError
from pcnde_bridge.hemodynamics.waveform import Waveform
from pcnde_bridge.uncertainty.novelty import EDGE

CONTROLS = {
    "blockage": ("blockage", "value"),
    "position": ("position", "value"),
    "length": ("length", "value"),
    "scale": ("scale", "value"),
    "uploaded": ("waveform", "data"),
}
"""Component and property that hold each choice."""


def connect(app: Dash, explorer: Explorer) -> None:
    """Register the callbacks of a page with this explorer."""
    _draw(app, explorer)
    _beside(app, explorer)
    _upload(app, explorer)
    _download(app, explorer)


def chosen(explorer: Explorer, values: dict[str, Any]) -> Inputs:
    """Return what the controls' values mean.

    Raises
    ------
    PreventUpdate
        While a number is being typed.
    InputError
        If a value is not usable.
    """
    numbers = {name: values[name] for name in ("blockage", "position", "length", "scale")}
    if any(value is None for value in numbers.values()):
        raise PreventUpdate
    numbers["blockage"] /= 100
    uploaded = values.get("uploaded")  # what a browser has not set it leaves out
    waveform = None if uploaded is None else Waveform(**uploaded)
    return explorer.choices.inputs(**numbers, waveform=waveform)


def _draw(app: Dash, explorer: Explorer) -> None:
    @app.callback(
        output={
            "along": Output("along", "figure"),
            "over": Output("over", "figure"),
            "along_title": Output("along-title", "children"),
            "over_title": Output("over-title", "children"),
            "novelty": Output("novelty", "children"),
            "outside": Output("novelty", "className"),
            "message": Output("message", "children"),
            "beside": Output("beside", "children"),
        },
        inputs={
            "values": {name: Input(*where) for name, where in CONTROLS.items()},
            "instant": Input("instant", "value"),
            "point": Input("point", "value"),
            "shown": Input("shown", "value"),
            "_done": Input("done", "data"),
        },
    )
    def draw(
        values: dict[str, Any], instant: int, point: int, shown: list[str], _done: str | None
    ) -> dict[str, Any]:
        grid = explorer.model.grid
        known = instant in range(grid.time.size) and point in range(grid.z.size)
        if not known or shown is None:  # the page itself never asks for such
            raise PreventUpdate
        try:
            inputs = chosen(explorer, values)
            along, over = explorer.along(inputs, instant), explorer.over(inputs, point)
        except PCNDEError as error:
            nothing = page.redraw(dict.fromkeys(explorer.variables, page.NOTHING), 0, {})
            return {
                "along": nothing,
                "over": nothing,
                "along_title": no_update,
                "over_title": no_update,
                "novelty": "",
                "outside": "",
                "message": str(error),
                "beside": "",
            }
        found = explorer.prediction(inputs)
        t, z = float(found.time[instant]), float(found.z[point])
        wanted = {page.BAND: "interval" in shown, page.TUBE: "tube" in shown}
        outside, novelty = _novelty(explorer.novelty(inputs))
        return {
            "along": page.redraw(along, z, wanted),
            "over": page.redraw(over, t, wanted),
            "along_title": f"Along the vessel at t = {t:.2f} s",
            "over_title": f"Over one cycle at z = {z:.2f} cm",
            "novelty": novelty,
            "outside": "outside" if outside else "inside",
            "message": "",
            "beside": _progress(explorer, inputs, shown),
        }


def _novelty(scores: Scores | None) -> tuple[bool, list[Any]]:
    """Whether the input lies outside the training data, and what to say of it."""
    if scores is None:
        return True, ["This model does not say what it was trained on: no novelty score."]
    parts = scores._asdict()
    beyond = [name for name, score in parts.items() if score > EDGE]
    numbers = ", ".join(f"{name} {score:.2f}" for name, score in parts.items())
    small = html.Small(f"Novelty: {numbers}; 1 is the edge.")
    if not beyond:
        return False, [html.Strong("Inside the training data"), small]
    return True, [
        html.Strong("Outside the training data"),
        f"The {' and the '.join(beyond)} {'is' if len(beyond) == 1 else 'are'} unlike any case "
        "that the model has learnt from. It extrapolates: do not rely on this prediction.",
        small,
    ]


def _progress(explorer: Explorer, inputs: Inputs, shown: list[str]) -> list[Any]:
    """Say how the interval and the 1D solver are getting on."""
    said = []
    for name, what, kept in (
        ("interval", "90 % interval", explorer.interval),
        ("tube", "1D solver", explorer.tube),
    ):
        if name in shown:
            result = kept.look(inputs)
            if result is None:
                said.append(html.Span(f"{what}: computing …", className="computing"))
            elif isinstance(result, PCNDEError):
                said.append(html.Span(f"{what}: {result}"))
            else:
                said.append(html.Span(f"{what}: shown."))
    return said


def _beside(app: Any, explorer: Explorer) -> None:
    app.clientside_callback(
        ClientsideFunction("pcnde", "rested"),
        *(Input(*where) for where in CONTROLS.values()),
        Input("shown", "value"),
    )
    for name, compute in (("interval", explorer.interval), ("tube", explorer.tube)):
        later = _later(explorer, name, compute)
        app.callback(Output(name, "data"), Input("rested", "data"))(later)


def _later(
    explorer: Explorer, name: str, compute: Callable[[Inputs], Any]
) -> Callable[[dict[str, Any] | None], int]:
    """Make the callback that computes what is asked for last, on each page."""
    last: dict[str, int] = {}
    one_at_a_time = threading.Lock()

    def later(rested: dict[str, Any] | None) -> int:
        if rested is None or name not in rested["shown"]:
            raise PreventUpdate
        asker, number = str(rested["page"]), int(rested["number"])
        last[asker] = max(number, last.get(asker, 0))
        with one_at_a_time:
            if number < last[asker]:  # the page has moved on meanwhile
                raise PreventUpdate
            with contextlib.suppress(PCNDEError):  # kept, and said when the page is drawn
                compute(chosen(explorer, rested))
        set_props("done", {"data": f"{name} {number}"})
        return number

    return later


def _upload(app: Dash, explorer: Explorer) -> None:
    @app.callback(
        output={
            "waveform": Output("waveform", "data"),
            "note": Output("uploaded", "children"),
            "look": Output("uploaded", "className"),
            "scale": Output("scale", "value"),
            "no_way_back": Output("reset", "hidden"),
            "contents": Output("upload", "contents"),
        },
        inputs={
            "contents": Input("upload", "contents"),
            "_reset": Input("reset", "n_clicks"),
            "name": State("upload", "filename"),
        },
        prevent_initial_call=True,
    )
    def upload(contents: str | None, _reset: int, name: str | None) -> dict[str, Any]:
        # Emptied afterwards, so that the same file can be uploaded again.
        result = {"look": "hint", "scale": 1.0, "contents": None}
        if ctx.triggered_id == "reset":
            start, note = explorer.choices.scale.start, page.base_note(explorer.choices)
            return result | {"waveform": None, "note": note, "scale": start, "no_way_back": True}
        if contents is None:
            raise PreventUpdate
        try:
            waveform, note = read_waveform(decoded(contents), name or "The file", explorer.model)
        except InputError as error:
            kept = {"waveform": no_update, "scale": no_update, "no_way_back": no_update}
            return result | kept | {"note": f"Not taken. {error}", "look": "problem"}
        note = f"Scale 1 is {note}"
        return result | {"waveform": asdict(waveform), "note": note, "no_way_back": False}


def decoded(contents: str) -> bytes:
    """Bytes of what the browser sends of a file: ``data:TYPE;base64,…``.

    Raises
    ------
    InputError
        If it is not that.
    """
    try:
        return base64.b64decode(contents.partition(",")[2], validate=True)
    except (binascii.Error, ValueError) as error:
        raise InputError(f"The upload did not arrive whole: {error}; try again.") from error


def _download(app: Dash, explorer: Explorer) -> None:
    @app.callback(
        Output("csv", "data"),
        Output("message", "children", allow_duplicate=True),
        Input("download", "n_clicks"),
        {name: State(*where) for name, where in CONTROLS.items()},
        prevent_initial_call=True,
    )
    def download(_clicks: int, values: dict[str, Any]) -> tuple[Any, Any]:
        try:
            table = explorer.csv(chosen(explorer, values))
        except PCNDEError as error:
            return no_update, str(error)
        return {"content": table, "filename": "prediction.csv", "type": "text/csv"}, no_update
