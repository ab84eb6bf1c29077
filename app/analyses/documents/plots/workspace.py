"""Maps over a robot's workspace: repeatability by the joints' noise, and the error of the data sheet's kinematics."""

from __future__ import annotations

import math
from collections.abc import Mapping

from app.analyses.documents.dh import error_map_of
from app.analyses.documents.joint_noise import joint_noise_of
from app.reports.svg import millimetres, unsigned_zero
from app.reports.workspace_map import (
    EXTRAPOLATED,
    MapPanel,
    MarkedPlace,
    PlaceCell,
    workspace_map_svg,
)
from core.session import SessionData


def joint_noise_map(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../joint-noise/map.svg` answers."""
    found = joint_noise_of(data, settings).map
    rp, (low, high) = float(found.worst.rp_l_mm[0]), (float(bound[0]) for bound in found.worst.interval())
    radius, height, place = _place(found.worst_position_mm.tolist())
    said = (
        f"Worst place (×): RP_l {millimetres(rp)} mm [{millimetres(low)}, {millimetres(high)}] at {place}",
    )
    cells = [
        PlaceCell(cell.radius_mm, cell.height_mm, (cell.median_rp_l_mm, cell.largest_rp_l_mm))
        for cell in found.cells
    ]
    return workspace_map_svg(
        cells,
        found.cell_mm,
        [MapPanel(name, "RP_l, mm", rp) for name in ("median of the configurations", "largest")],
        MarkedPlace(radius, height, said),
        "Repeatability over the workspace, predicted from the joints' noise",
        about,
    )


def error_map(data: SessionData, settings: Mapping[str, str], about: str) -> bytes:
    """Return what `GET .../dh/error-map.svg` answers."""
    found = error_map_of(data, settings)[1].map
    worst = found.worst
    radius, height, place = _place(found.worst_position_mm.tolist())
    said = (
        f"Median {millimetres(found.median_mm)} mm (u {millimetres(found.median_uncertainty_mm)} mm) between the joint "
        "angles of the measured poses;",
        f"largest there (×) {millimetres(float(worst.length_mm[0]))} mm (u "
        f"{millimetres(float(worst.standard_uncertainty_mm[0]))} mm) at {place}.",
        *(
            (EXTRAPOLATED,)
            if any(cell.extrapolated for cell in found.cells)
            else ("Circles: measured poses.",)
        ),
    )
    cells = [
        PlaceCell(
            cell.radius_mm,
            cell.height_mm,
            (cell.median_mm, cell.median_uncertainty_mm),
            cell.measured > 0,
            cell.extrapolated,
        )
        for cell in found.cells
    ]
    known = [cell.values for cell in cells if not cell.extrapolated]
    return workspace_map_svg(
        cells,
        found.cell_mm,
        [
            MapPanel(name, label, max(values[number] for values in known))
            for number, (name, label) in enumerate(
                (
                    ("median of the configurations", "position error, mm"),
                    ("its standard uncertainty", "standard uncertainty, mm"),
                )
            )
        ],
        MarkedPlace(radius, height, said),
        "Position error of the data sheet's kinematics over the workspace",
        about,
    )


def _place(position_mm: list[float]) -> tuple[float, float, str]:
    """Return a place's distance from the first axis, its height (mm), and both in words."""
    x, y, z = position_mm
    radius = math.hypot(x, y)
    return radius, z, f"radius {radius:.0f} mm, height {unsigned_zero(f'{z:.0f}')} mm"
