"""Layout of the page: its controls and its two columns of graphs."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from dash import Patch, dcc, html
from plotly import graph_objects as go
from plotly.subplots import make_subplots

from pcnde_bridge.app.explorer import Explorer, Line, Panel
from pcnde_bridge.app.inputs import Choices, Span
from pcnde_bridge.plots.style import PREDICTED, QUANTITIES, SPACE_LABEL, TIME_LABEL, TRUTH

LARGEST_UPLOAD = 1_000_000
"""Largest size of an uploaded file, bytes."""

COMPARISONS = {"interval": "90 % interval", "solver": "1D solver"}
"""Titles of the results that the prediction can be compared with."""

_DIFFERENCE = (
    "The 1D solver has the model's outlet and wall, the friction of a parabolic profile, and the "
    "loss of Seeley and Young spread over the stenosis. The model has learned its losses from 3D "
    "simulations, so that the two differ most behind a severe stenosis."
)
_NO_LINE = Line(np.empty(0), np.empty(0))
_DIGITS = 6  # far below the visible differences, so that little is sent
_INK, _RULE, _AXIS = "#1f2933", "#e4e7eb", "#9aa5b1"
_SLIDER: dict[str, Any] = {"marks": None, "updatemode": "drag", "included": False}

_TRACES: dict[str, dict[str, Any]] = {
    "interval": {"name": "90 % interval", "fill": "toself", "fillcolor": "rgba(0, 114, 178, 0.22)"}
    | {"line": {"width": 0}, "hoverinfo": "skip"},
    "given": {"name": "given", "line": {"color": "#6b7280", "width": 1.5, "dash": "dot"}},
    "solver": {"name": "1D solver", "line": {"color": TRUTH, "width": 2, "dash": "dash"}},
    "prediction": {"name": "prediction", "line": {"color": PREDICTED, "width": 2.5}},
}
"""Look of each curve of a panel, in the order in which they are drawn."""


def layout(explorer: Explorer, name: str) -> html.Div:
    """Create the page of a model.

    Parameters
    ----------
    explorer : Explorer
        Model with its choices and variables.
    name : str
        Name of the model, for the heading.
    """
    model, choices = explorer.model, explorer.choices
    n_times, n_points = model.grid.time.size, model.grid.z.size
    cases = model.provenance.get("cases")
    facts = f"trained on {cases} cases, " if cases else ""
    facts += f"{n_times} time points × {n_points} grid points"
    peak = int(choices.initial.waveform.samples(n_times).argmax())
    comparisons = {name: COMPARISONS[name] for name in explorer.comparisons}
    units = html.Small("units s, cm, mL/s, cm², dyn/cm²")
    aside = [
        html.Div(id="numbers", role="status"),
        html.Div(id="novelty", role="status"),
        html.Div(id="message", role="alert"),
        *_controls(choices),
        _group(
            "Compare with",
            dcc.Checklist(comparisons, list(comparisons), inline=True, id="shown"),
            html.P(id="progress", className="hint"),
            html.P(_DIFFERENCE, className="hint"),
        ),
        html.Button(["Download prediction (CSV)", units], id="download", n_clicks=0),
    ]
    columns = [
        _column(explorer, "along", SPACE_LABEL, "time-point", n_times, peak),
        # 90 % of the length, as in the paper's figures.
        _column(explorer, "over", TIME_LABEL, "grid-point", n_points, round(0.9 * n_points)),
    ]
    graphs = html.Section([_legend(comparisons), html.Div(columns, className="columns")])
    stores = [dcc.Store(id=k) for k in ("waveform", "settled", "interval", "solver", "done")]
    header = html.Header([html.H1("PCNDE"), html.Strong(name), html.Span(facts)])
    main = html.Main([html.Aside(aside), graphs])
    return html.Div([header, main, *stores, dcc.Download(id="csv")], id="page")


def _group(title: str, *children: Any) -> html.Div:
    return html.Div([html.H2(title), *children], className="group")


def _controls(choices: Choices) -> list[html.Div]:
    source = "training" if choices.from_training else "usual"
    stenosis = [
        _slider("position", "Throat of the stenosis, z (cm)", choices.position, source),
        _slider("length", "Length of the stenosis (cm)", choices.length, source),
    ]
    upload = dcc.Upload(
        ["Upload a waveform (CSV)", html.Small("columns time (s), flow (mL/s)")],
        id="upload",
        className="upload",
        className_active="upload active",
        className_reject="upload",
        max_size=LARGEST_UPLOAD,
    )
    return [
        _group(
            "Vessel",
            _slider("blockage", "Blockage, area (%)", choices.blockage, source, 100),
            html.Div(stenosis, hidden=not choices.any_grid),
        ),
        _group(
            "Inflow",
            _slider("scale", "Oscillation, factor", choices.scale, source),
            upload,
            html.P(waveform_note(choices), id="uploaded", className="hint"),
            html.Button("Restore the initial waveform", id="reset", n_clicks=0, hidden=True),
        ),
    ]


def waveform_note(choices: Choices) -> str:
    """Describe the waveform that the scale multiplies when none is uploaded."""
    known = "strongest waveform of the training data"
    waveform = known if choices.from_training else "built-in coronary waveform"
    return f"Scale 1 is the {waveform}, mean {choices.base.mean:.3g} mL/s."


def _slider(name: str, label: str, span: Span, source: str, factor: float = 1) -> html.Div:
    minimum, low, high, maximum, step, start = (round(factor * v, _DIGITS) for v in span)
    limits = f"{low:.2g}" if low == high else f"{low:.2g} … {high:.2g}"
    heading = [html.Label(label, htmlFor=name), html.Small(f"{source} {limits}".replace("-", "−"))]
    slider = dcc.Slider(minimum, maximum, step, value=start, id=name, **_SLIDER)
    return html.Div([html.Div(heading, className="label"), slider], className="control")


def _legend(comparisons: Mapping[str, str]) -> html.Div:
    kinds = {"prediction": "prediction (PCNDE)", **comparisons}
    kinds["given"] = "given: inflow, undeformed area"
    entries = [
        html.Span([html.I(className=f"key {kind}"), text], className="entry")
        for kind, text in kinds.items()
    ]
    return html.Div(entries, className="legend")


def _column(
    explorer: Explorer, name: str, abscissa: str, control: str, count: int, start: int
) -> html.Div:
    value = min(start, count - 1)
    slider = dcc.Slider(
        0, count - 1, 1, value=value, id=control, allow_direct_input=False, **_SLIDER
    )
    graph = dcc.Graph(
        id=name,
        figure=empty_figure(explorer, abscissa),
        responsive=True,
        config={"displaylogo": False, "displayModeBar": False},
        className="graph",
        style={"--rows": len(explorer.variables)},
    )
    heading = html.Div([html.H3(id=f"{name}-title"), slider], className="place")
    # Names for assistive technology; page.js names the handles of the sliders.
    name_of: dict[str, Any] = {"aria-labelledby": f"{name}-title"}
    drawn = html.Div(graph, role="img", **name_of)
    return html.Div([heading, drawn], className="column")


def empty_figure(explorer: Explorer, abscissa: str) -> go.Figure:
    """Create a figure with a panel for each variable, one below the other, without curves."""
    names = explorer.variables
    figure = make_subplots(rows=len(names), cols=1, shared_xaxes=True, vertical_spacing=0.05)
    for row, name in enumerate(names, start=1):
        for trace in _TRACES.values():
            figure.add_trace(go.Scatter(x=[], y=[], mode="lines", **trace), row=row, col=1)
        label = "{}<br>({})".format(*QUANTITIES[name])
        figure.update_yaxes(title={"text": label, "font_size": 12}, row=row, col=1)
    figure.update_xaxes(title_text=abscissa, row=len(names), col=1)
    axis = {"gridcolor": _RULE, "zeroline": False, "showline": True, "linecolor": _AXIS}
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis, title_standoff=6, automargin=False, nticks=5)
    marker = {"type": "line", "xref": "x", "yref": "paper", "x0": 0, "x1": 0, "y0": 0, "y1": 1}
    figure.add_shape(**marker, layer="below", line={"color": _AXIS, "width": 1, "dash": "dot"})
    figure.update_layout(
        template="none",
        showlegend=False,
        font={"family": "system-ui, sans-serif", "size": 13, "color": _INK},
        margin={"l": 72, "r": 12, "t": 8, "b": 44},
        paper_bgcolor="white",
        plot_bgcolor="white",
        hovermode="x",
        uirevision="constant",  # a zoom stays when the curves change
    )
    return figure


def redraw(panels: Mapping[str, Panel], marker: float, hidden: Collection[str] = ()) -> Patch:
    """Return the changes of an :func:`empty_figure` that make it show these curves.

    Parameters
    ----------
    panels : mapping of str to Panel
        Panels in the order of the figure's rows.
    marker : float
        Abscissa of the vertical line.
    hidden : collection of str
        Curves that are not shown.
    """
    patch = Patch()
    for row, panel in enumerate(panels.values()):
        for column, kind in enumerate(_TRACES):
            curve = _NO_LINE if kind in hidden else panel.get(kind, _NO_LINE)
            trace = patch["data"][len(_TRACES) * row + column]
            trace["x"], trace["y"] = (np.round(values, _DIGITS).tolist() for values in curve)
    patch["layout"]["shapes"][0]["x0"] = patch["layout"]["shapes"][0]["x1"] = marker
    return patch
