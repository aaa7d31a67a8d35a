"""The layout: pictures above, curves and text below, and no view without data."""

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb

from exumi_data.view.names import TIME
from exumi_data.view.panels import Panel

__all__ = ["blueprint_of"]

_Part = rrb.Container | rrb.View

_COLUMNS = 3
"""Most curves side by side."""
_PICTURES_HIGH, _CURVES_HIGH = 3.0, 2.0


def blueprint_of(panels: Mapping[Panel, int], *, several: bool) -> rrb.Blueprint:
    """Return the layout of panels.

    Parameters
    ----------
    panels : mapping of Panel to int
        What there is, and how many curves of it.
    several : bool
        There is more than one recording: they are listed at the left.
    """
    rows: list[_Part] = []
    shares: list[float] = []
    pictures = _pictures(list(panels))
    if pictures:
        rows.append(rrb.Horizontal(*pictures))
        shares.append(_PICTURES_HIGH)
    rows.append(_below(panels))
    shares.append(_CURVES_HIGH)
    return rrb.Blueprint(
        rrb.Vertical(*rows, row_shares=shares),
        rrb.BlueprintPanel(state="expanded" if several else "collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIME, play_state="playing", loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def _of(panels: Sequence[Panel], *kinds: str) -> list[Panel]:
    return [panel for panel in panels if panel.kind in kinds]


def _pictures(panels: Sequence[Panel]) -> list[_Part]:
    """Return columns: cameras, tactile streams over what differs, taxels, space."""
    columns: list[list[rrb.View]] = [
        [_picture(panel) for panel in _of(panels, "camera")],
        *([_picture(one) for one in pair] for pair in _touches(panels)),
        [_picture(panel) for panel in _of(panels, "taxels")],
        [
            rrb.Spatial3DView(origin=panel.origin, name=panel.title)
            for panel in _of(panels, "space")
        ],
    ]
    filled = [column for column in columns if column]
    if len(filled) == 1:  # there is room side by side
        return [*filled[0]]
    return [column[0] if len(column) == 1 else rrb.Vertical(*column) for column in filled]


def _touches(panels: Sequence[Panel]) -> list[list[Panel]]:
    """Return each tactile stream's frames with what differs from the reference."""
    differences = {panel.origin.rpartition("/")[0]: panel for panel in _of(panels, "difference")}
    frames = {panel.origin.rpartition("/")[0]: panel for panel in _of(panels, "tactile")}
    return [
        [panel, *([differences[base]] if base in differences else [])]
        for base, panel in frames.items()
    ]


def _picture(panel: Panel) -> rrb.View:
    return rrb.Spatial2DView(origin=panel.origin, name=panel.title)


def _below(panels: Mapping[Panel, int]) -> _Part:
    curves = {panel: count for panel, count in panels.items() if panel.kind == "curves"}
    columns: list[_Part] = []
    shares: list[float] = []
    if curves:
        columns.append(_curves(curves))
        shares.append(min(len(curves), _COLUMNS))
    columns.append(_text(list(panels)))
    shares.append(1.0)
    return rrb.Horizontal(*columns, column_shares=shares)


def _curves(panels: Mapping[Panel, int]) -> _Part:
    views = [
        rrb.TimeSeriesView(
            origin=panel.origin,
            name=panel.title,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=count > 1),
        )
        for panel, count in panels.items()
    ]
    return rrb.Grid(*views, grid_columns=min(len(views), _COLUMNS))


def _text(panels: Sequence[Panel]) -> _Part:
    views: list[rrb.View] = [
        rrb.TextLogView(
            origin=panel.origin,
            name=panel.title,
            columns=rrb.TextLogColumns(
                timeline_columns=[TIME], text_log_columns=["LogLevel", "Body"]
            ),
        )
        for panel in _of(panels, "events")
    ]
    views += [
        rrb.TextDocumentView(origin=panel.origin, name=panel.title)
        for panel in _of(panels, "about")
    ]
    tabs = rrb.Tabs(*views)
    segments = [
        rrb.StateTimelineView(origin=panel.origin, name=panel.title)
        for panel in _of(panels, "segments")
    ]
    if not segments:
        return tabs
    return rrb.Vertical(*segments, tabs, row_shares=[*([1.0] * len(segments)), 2.0])
