"""How the page looks: its controls and its two columns of graphs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from dash import Patch, dcc, html
from plotly import graph_objects as go
from plotly.subplots import make_subplots

from pcnde_bridge.app.explorer import (
    Explorer,
    Line,
    Panel,
)
from pcnde_bridge.app.inputs import Choices, Span
from pcnde_bridge.plots.style import (
    PREDICTED,
    QUANTITIES,
    TRUTH,
)

BAND, GIVEN, TUBE, CURVE = range(4)
"""Order of the traces of a panel."""

LARGEST_UPLOAD = 1_000_000
"""Bytes."""

_DIGITS = 6
_INK, _RULE = "#1f2933", "#e4e7eb"
_BAND_COLOUR = "rgba(0, 114, 178, 0.22)"
_GIVEN_COLOUR = "#6b7280"
_EMPTY: list[float] = []
NOTHING = Panel(Line(np.empty(0), np.empty(0)))
"""Panel without curves."""

_TRACES: tuple[dict[str, Any], ...] = (
    {"name": "90 % interval", "fill": "toself", "fillcolor": _BAND_COLOUR}
    | {"line": {"width": 0}, "hoverinfo": "skip"},
    {"name": "given", "line": {"color": _GIVEN_COLOUR, "width": 1.5, "dash": "dot"}},
    {"name": "1D solver", "line": {"color": TRUTH, "width": 2, "dash": "dash"}},
    {"name": "prediction", "line": {"color": PREDICTED, "width": 2.5}},
)


def layout(explorer: Explorer, name: str) -> html.Div:
    """Page of a model.

    Parameters
    ----------
    explorer : Explorer
        Its choices and variables are laid out.
    name : str
        Of the model, for the heading.
    """
    model, choices = explorer.model, explorer.choices
    n_times, n_points = model.grid.time.size, model.grid.z.size
    cases = model.provenance.get("cases")
    facts = f"trained on {cases} cases, " if cases else ""
    facts += f"{n_times} instants × {n_points} points"
    peak = int(choices.first.waveform.samples(n_times).argmax())
    return html.Div(
        [
            html.Header([html.H1("PCNDE"), html.Strong(name), html.Span(facts)]),
            html.Main(
                [
                    html.Aside(
                        [
                            html.Div(id="novelty", role="status"),
                            html.Div(id="message", role="alert"),
                            *_controls(choices),
                            _beside(explorer),
                            html.Button(
                                [
                                    "Download prediction (CSV)",
                                    html.Small("units s, cm, mL/s, cm², dyn/cm²"),
                                ],
                                id="download",
                                n_clicks=0,
                            ),
                        ]
                    ),
                    html.Section(
                        [
                            _legend(explorer),
                            html.Div(
                                [
                                    _column(explorer, "along", "instant", n_times, peak),
                                    # 90 % of the length, as in the paper's figures.
                                    _column(
                                        explorer, "over", "point", n_points, round(0.9 * n_points)
                                    ),
                                ],
                                className="columns",
                            ),
                        ]
                    ),
                ]
            ),
            dcc.Store(id="waveform"),
            dcc.Store(id="rested"),
            dcc.Store(id="interval"),
            dcc.Store(id="tube"),
            dcc.Store(id="done"),
            dcc.Download(id="csv"),
        ],
        id="page",
    )


def _controls(choices: Choices) -> list[html.Div]:
    inside = "training" if choices.known else "usual"
    length, position = choices.length, choices.position
    return [
        html.Div(
            [
                html.H2("Vessel"),
                _slider("blockage", "Blockage, area (%)", choices.blockage, inside, 100),
                html.Div(
                    [
                        _slider("position", "Throat of the stenosis, z (cm)", position, inside),
                        _slider("length", "Length of the stenosis (cm)", length, inside),
                    ],
                    hidden=not choices.any_grid,
                ),
            ],
            className="group",
        ),
        html.Div(
            [
                html.H2("Inflow"),
                _slider("scale", "Oscillation, factor", choices.scale, inside),
                dcc.Upload(
                    ["Upload a waveform (CSV)", html.Small("columns time (s), flow (mL/s)")],
                    id="upload",
                    className="upload",
                    className_active="upload active",
                    className_reject="upload",
                    max_size=LARGEST_UPLOAD,
                ),
                html.P(base_note(choices), id="uploaded", className="hint"),
                html.Button("Back to the built-in waveform", id="reset", n_clicks=0, hidden=True),
            ],
            className="group",
        ),
    ]


def base_note(choices: Choices) -> str:
    """Say which waveform the scale multiplies when none is uploaded."""
    which = "strongest of the training data" if choices.known else "built-in coronary one"
    return f"Scale 1 is the {which}, mean {choices.base.mean:.3g} mL/s."


def _slider(name: str, label: str, span: Span, inside: str, factor: float = 1) -> html.Div:
    least, low, high, most, step, start = (round(factor * value, _DIGITS) for value in span)
    reach = f"{low:.2g}" if low == high else f"{low:.2g} … {high:.2g}"
    return html.Div(
        [
            html.Div(
                [
                    html.Label(label, htmlFor=name),
                    html.Small(f"{inside} {reach}".replace("-", "−")),
                ],
                className="label",
            ),
            dcc.Slider(
                least,
                most,
                step,
                value=start,
                id=name,
                marks=None,
                updatemode="drag",
                included=False,
            ),
        ],
        className="control",
    )


def _beside(explorer: Explorer) -> html.Div:
    options = [{"label": "1D solver", "value": "tube"}]
    if explorer.samples:
        options.insert(0, {"label": "90 % interval", "value": "interval"})
    return html.Div(
        [
            html.H2("Beside the prediction"),
            dcc.Checklist(
                options, [option["value"] for option in options], inline=True, id="shown"
            ),
            html.P(id="beside", className="hint"),
        ],
        className="group",
    )


def _legend(explorer: Explorer) -> html.Div:
    entries = [("curve", "prediction (PCNDE)")]
    if explorer.samples:
        entries.append(("band", "90 % interval"))
    entries += [("tube", "1D solver"), ("given", "given: inflow, undeformed area")]
    return html.Div(
        [
            html.Span([html.I(className=f"key {kind}"), text], className="entry")
            for kind, text in entries
        ],
        className="legend",
    )


def _column(explorer: Explorer, name: str, control: str, count: int, start: int) -> html.Div:
    return html.Div(
        [
            html.Div(
                [
                    html.H3(id=f"{name}-title"),
                    dcc.Slider(
                        0,
                        count - 1,
                        1,
                        value=min(start, count - 1),
                        id=control,
                        marks=None,
                        updatemode="drag",
                        included=False,
                        allow_direct_input=False,
                    ),
                ],
                className="place",
            ),
            dcc.Graph(
                id=name,
                figure=empty_figure(
                    explorer, "position z (cm)" if name == "along" else "time t (s)"
                ),
                responsive=True,
                config={"displaylogo": False, "displayModeBar": False},
                className="graph",
            ),
        ],
        className="column",
    )


def empty_figure(explorer: Explorer, abscissa: str) -> go.Figure:
    """One panel for each variable, one below the other, with empty traces."""
    names = explorer.variables
    figure = make_subplots(rows=len(names), cols=1, shared_xaxes=True, vertical_spacing=0.05)
    for row, name in enumerate(names, start=1):
        for trace in _TRACES:
            figure.add_trace(go.Scatter(x=_EMPTY, y=_EMPTY, mode="lines", **trace), row=row, col=1)
        figure.update_yaxes(title_text=QUANTITIES[name].label, row=row, col=1)
    figure.update_xaxes(title_text=abscissa, row=len(names), col=1)
    figure.update_xaxes(gridcolor=_RULE, zeroline=False, showline=True, linecolor="#9aa5b1")
    figure.update_yaxes(gridcolor=_RULE, zeroline=False, showline=True, linecolor="#9aa5b1")
    figure.update_yaxes(title_standoff=6, automargin=False, nticks=5)
    figure.add_shape(
        type="line", xref="x", yref="paper", x0=0, x1=0, y0=0, y1=1, layer="below"
    ).update_shapes(line={"color": "#9aa5b1", "width": 1, "dash": "dot"})
    figure.update_layout(
        template="none",
        showlegend=False,
        font={"family": "system-ui, sans-serif", "size": 13, "color": _INK},
        margin={"l": 64, "r": 12, "t": 8, "b": 44},
        paper_bgcolor="white",
        plot_bgcolor="white",
        hovermode="x",
        uirevision="kept",  # a zoom stays when the curves change
    )
    return figure


def redraw(panels: Mapping[str, Panel], mark: float, shown: Mapping[int, bool]) -> Patch:
    """Change an :func:`empty_figure` to show these curves, and nothing else of it.

    Parameters
    ----------
    panels : mapping of str to Panel
        In the order of the figure's rows.
    mark : float
        Abscissa of the vertical line.
    shown : mapping of int to bool
        Traces that are not wanted.
    """
    patch = Patch()
    for row, panel in enumerate(panels.values()):
        band = None
        if panel.low is not None and panel.high is not None:
            band = Line(
                np.concatenate([panel.low.x, panel.high.x[::-1]]),
                np.concatenate([panel.low.y, panel.high.y[::-1]]),
            )
        lines = {BAND: band, GIVEN: panel.given, TUBE: panel.tube, CURVE: panel.predicted}
        for kind, line in lines.items():
            trace = patch["data"][len(_TRACES) * row + kind]
            hidden = line is None or not shown.get(kind, True)
            trace["x"] = _EMPTY if hidden or line is None else _numbers(line.x)
            trace["y"] = _EMPTY if hidden or line is None else _numbers(line.y)
    patch["layout"]["shapes"][0]["x0"] = patch["layout"]["shapes"][0]["x1"] = mark
    return patch


def _numbers(values: npt.NDArray[np.float64]) -> list[float]:
    """Round far below what is seen, so that little is sent."""
    rounded: list[float] = np.round(values, _DIGITS).tolist()
    return rounded
