"""The four plots: titles with units, series by column of a `Row`. `page.js` fills them, nothing makes them anew."""

from __future__ import annotations

from typing import Any, NamedTuple


class Chart(NamedTuple):
    """One plot."""

    title: str
    series: tuple[tuple[str, int], ...]
    """(name, index into `Row`)."""


ESTIMATED = "q1 from the IMU, estimated"
"""Of a rig whose pivot has no sensor: the recorder's own, by which it keeps the limit."""
DASHED = {"commanded", ESTIMATED}
CHARTS = (
    Chart("Joint angles [rad]", (("q1, pivot (Hall)", 1), ("q2, knee", 2), (ESTIMATED, 8))),
    Chart("Knee torque [N m]", (("measured", 3), ("commanded", 4))),
    Chart("Gyro: speed of link 1 [rad/s]", (("q1 rate", 5),)),
    Chart("Accelerometer [m/s²]", (("x, tangential", 6), ("y, along link 1", 7))),
)


def options(chart: Chart) -> dict[str, Any]:
    """ECharts options of an empty plot; colours come from the page's style."""
    return {
        "animation": False,
        "grid": {"left": 52, "right": 12, "top": 34, "bottom": 40},
        "legend": {"show": len(chart.series) > 1, "top": 2, "left": 48, "itemWidth": 22, "selectedMode": False,
                   "icon": "roundRect", "itemHeight": 4},
        "xAxis": {"type": "value", "name": "time [s]", "nameLocation": "middle", "nameGap": 22, "min": 0, "max": 20,
                  "axisLabel": {"hideOverlap": True}},
        "yAxis": {"type": "value", "scale": True, "splitNumber": 4},
        # page.js moves it: by its own gestures it would take the wheel and one finger, which scroll the page
        "dataZoom": [{"type": "inside", "filterMode": "none", "disabled": True}],
        "series": [{"type": "line", "name": name, "showSymbol": False, "silent": True, "data": [],
                    "lineStyle": {"width": 1.6, "type": "dashed" if name in DASHED else "solid"}}
                   for name, _ in chart.series],
    }
