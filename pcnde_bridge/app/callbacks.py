"""Callbacks of the page.

One callback draws with the results that are available at once: the prediction, and whatever
has been computed before for the same inputs.  When the controls have settled, two others
compute the interval and the 1D solver's solution, and trigger drawing again.  Their results
are cached with the inputs, so that a late result is never drawn with other curves.

These two report that they are done through ``set_props``, not through an output, because
Dash would delay drawing until the outputs that it depends on are available.
"""

import base64
import contextlib
import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from dash import ClientsideFunction, Dash, Input, Output, State, ctx, html, no_update, set_props
from dash.exceptions import PreventUpdate

from pcnde_bridge._utils.archive import interpreting
from pcnde_bridge._utils.validation import finite
from pcnde_bridge.app import page
from pcnde_bridge.app.explorer import Explorer
from pcnde_bridge.app.inputs import Inputs, read_waveform
from pcnde_bridge.errors import InputError, PCNDEError
from pcnde_bridge.hemodynamics.waveform import Waveform
from pcnde_bridge.uncertainty.novelty import EDGE

_NUMBERS = ("blockage", "position", "length", "scale")
_CONTROLS = {name: (name, "value") for name in _NUMBERS} | {"uploaded": ("waveform", "data")}
"""Component and property of each choice."""

_COLUMNS = ("along", "over")

_log = logging.getLogger("pcnde_bridge")


def connect(app: Dash, explorer: Explorer) -> None:
    """Register the callbacks of a page with this explorer."""
    for part in (_connect_drawing, _connect_comparison, _connect_upload, _connect_download):
        part(app, explorer)


def report(error: Exception) -> None:
    """Show an error that no message was written for on the page, and its traceback here."""
    _log.error("A callback of the page failed.", exc_info=error)
    set_props("message", {"children": f"Unexpected error, see the terminal: {error!r}"})


def _inputs(explorer: Explorer, values: dict[str, Any]) -> Inputs:
    """Return the inputs for the values of the controls.

    Raises
    ------
    PreventUpdate
        While a number is being typed.
    PCNDEError
        If a value is invalid.
    """
    if any(values[name] is None for name in _NUMBERS):
        raise PreventUpdate
    numbers = {name: finite(name, values[name]) for name in _NUMBERS}
    numbers["blockage"] /= 100
    for name, value in numbers.items():
        span = getattr(explorer.choices, name)
        if not span.minimum <= round(value, 6) <= span.maximum:
            raise InputError(f"{name} is outside its control: move the control.")
    waveform = None
    uploaded = values.get("uploaded")  # browsers omit values that are not set
    if uploaded is not None:
        with interpreting("The upload", "waveform"):
            waveform = Waveform(**uploaded)
        if waveform.n_terms > explorer.model.grid.time.size:
            raise InputError("The waveform has more harmonics than the model has time points.")
    return explorer.choices.inputs(**numbers, waveform=waveform)


def _connect_drawing(app: Dash, explorer: Explorer) -> None:
    @app.callback(
        [Output(column, "figure") for column in _COLUMNS],
        [Output(f"{column}-title", "children") for column in _COLUMNS],
        [Output(name, "children") for name in ("message", "progress", "numbers", "novelty")],
        Output("novelty", "className"),
        {name: Input(*component) for name, component in _CONTROLS.items()},
        Input("time-point", "value"),
        Input("grid-point", "value"),
        Input("shown", "value"),
        Input("done", "data"),
    )
    def draw(
        values: dict[str, Any], time_index: int, z_index: int, shown: list[str], _done: str | None
    ) -> tuple[Any, ...]:
        grid = explorer.model.grid
        valid = time_index in range(grid.time.size) and z_index in range(grid.z.size)
        if not valid or shown is None:  # the page itself never asks for these
            raise PreventUpdate
        try:
            inputs = _inputs(explorer, values)
            found = explorer.prediction(inputs)
        except PCNDEError as error:
            empty = page.redraw({name: {} for name in explorer.variables}, 0)
            return empty, empty, no_update, no_update, str(error), "", "", "", ""
        t, z = float(found.time[time_index]), float(found.z[z_index])
        hidden = page.COMPARISONS.keys() - set(shown)
        return (
            page.redraw(explorer.curves(inputs, "along", time_index), z, hidden),
            page.redraw(explorer.curves(inputs, "over", z_index), t, hidden),
            f"Along the vessel at t = {t:.2f} s",
            f"Over one cycle at z = {z:.2f} cm",
            "",
            _describe_progress(explorer, inputs, shown),
            _describe_numbers(explorer, inputs),
            *_describe_novelty(explorer.novelty(inputs)),
        )


def _describe_numbers(explorer: Explorer, inputs: Inputs) -> list[Any]:
    """Return mean pressure drop and FFR, with intervals as soon as they are computed."""
    numbers, limits = explorer.indices(inputs), explorer.interval.cached(inputs)
    lines: list[Any] = []
    for name, label, digits in (("mean_drop_mmHg", "Drop, mmHg", 2), ("ffr", "FFR", 3)):
        if name in numbers:
            text = f"{label} {numbers[name]:.{digits}f}"
            lines.append(html.Strong(text))
            if isinstance(limits, Mapping):
                low, high = (f"{limit[0]:.{digits}f}" for limit in limits[name])
                lines.append(html.Div(f"90 % interval {low} to {high}"))
    if numbers:
        lines.append(html.Small(f"Drop of Seeley and Young: {numbers['empirical']:.2f} mmHg"))
    return lines


def _describe_novelty(scores: Mapping[str, float]) -> tuple[list[Any], str]:
    """Return a description, and whether the inputs are ``inside`` or ``outside``."""
    if not scores:
        return ["No novelty score: this model has no record of its training data."], "outside"
    beyond = [name for name, score in scores.items() if score > EDGE]
    largest = sorted(scores, key=lambda name: -scores[name])[: max(len(beyond), 1)]
    numbers = ", ".join(f"{name} {scores[name]:.2f}" for name in largest)
    small = html.Small(f"Largest novelty: {numbers}; above 1 is outside.")
    if not beyond:
        return [html.Strong("Inside the training data"), small], "inside"
    text = [
        html.Strong("Outside the training data"),
        f"The {' and the '.join(beyond)} {'is' if len(beyond) == 1 else 'are'} unlike any "
        "training case. The model extrapolates: do not rely on this prediction.",
        small,
    ]
    return text, "outside"


def _describe_progress(explorer: Explorer, inputs: Inputs, shown: list[str]) -> list[Any]:
    """Report the state of the interval and the 1D solver."""
    lines = []
    for name, cache in explorer.comparisons.items():
        if name in shown:
            result = cache.cached(inputs)
            state = result if isinstance(result, PCNDEError) else "shown."
            state, css = ("computing …", "computing") if result is None else (state, "")
            lines.append(html.Span(f"{page.COMPARISONS[name]}: {state}", className=css))
    return lines


def _connect_comparison(app: Any, explorer: Explorer) -> None:
    app.clientside_callback(
        ClientsideFunction("pcnde", "settled"),
        *(Input(*component) for component in _CONTROLS.values()),
        Input("shown", "value"),
    )
    for name, compute in explorer.comparisons.items():
        callback = _compute_latest(explorer, name, compute)
        app.callback(Output(name, "data"), Input("settled", "data"))(callback)


def _compute_latest(
    explorer: Explorer, name: str, compute: Callable[[Inputs], Any]
) -> Callable[[dict[str, Any] | None], int]:
    """Create the callback that computes the latest request of each open page."""
    latest: dict[str, int] = {}
    one_at_a_time = threading.Lock()

    def callback(settled: dict[str, Any] | None) -> int:
        if settled is None or name not in settled["shown"]:
            raise PreventUpdate
        page_id, number = str(settled["page"]), int(settled["number"])
        latest[page_id] = max(number, latest.get(page_id, 0))
        with one_at_a_time:
            if number < latest[page_id]:  # there is a newer request
                raise PreventUpdate
            with contextlib.suppress(PCNDEError):  # cached, and shown when the page is drawn
                compute(_inputs(explorer, settled))
        set_props("done", {"data": f"{name} {number}"})
        return number

    return callback


def _connect_upload(app: Dash, explorer: Explorer) -> None:
    choices = explorer.choices

    def use(waveform: dict[str, Any] | None, note: str, scale: float) -> None:
        set_props("uploaded", {"children": note, "className": "hint"})
        set_props("reset", {"hidden": waveform is None})
        set_props("scale", {"value": scale})
        set_props("waveform", {"data": waveform})

    @app.callback(
        Output("upload", "contents"),
        Input("upload", "contents"),
        Input("reset", "n_clicks"),
        State("upload", "filename"),
        prevent_initial_call=True,
    )
    def upload(contents: str | None, _reset: int, name: str | None) -> None:
        if ctx.triggered_id == "reset":
            use(None, page.waveform_note(choices), choices.scale.start)
        elif contents is not None:
            try:
                content = base64.b64decode(contents.partition(",")[2])  # data:TYPE;base64,…
                waveform, note = read_waveform(content, name or "The file", explorer.model)
            except InputError as error:
                problem = {"children": f"The file was rejected. {error}", "className": "problem"}
                set_props("uploaded", problem)
            else:
                use(asdict(waveform), f"Scale 1 is {note}", 1.0)
        # The contents are cleared, so that the same file can be uploaded again.


def _connect_download(app: Dash, explorer: Explorer) -> None:
    @app.callback(
        Output("csv", "data"),
        Input("download", "n_clicks"),
        {name: State(*component) for name, component in _CONTROLS.items()},
        prevent_initial_call=True,
    )
    def download(_clicks: int, values: dict[str, Any]) -> Any:
        try:
            table = explorer.csv(_inputs(explorer, values))
        except PCNDEError as error:
            set_props("message", {"children": str(error)})
            return no_update
        return {"content": table, "filename": "prediction.csv", "type": "text/csv"}
