"""`gridpose sessions joint-noise`: noise of a robot's joints, and the repeatability that it predicts."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from ... import Json, find_session
from ..access import ReadAccess
from ..console import output_console, print_json


def joint_noise(
    session: Annotated[str, typer.Argument(help="Id or name of the session.")],
    service: ReadAccess,
    at: Annotated[
        list[str] | None,
        typer.Option(help="Joint angles to predict at, degrees: 0,-65,75,10,55,0; as often as needed."),
    ] = None,
    source: Annotated[str, typer.Option(help="images, or measured_poses of another instrument.")] = "images",
    estimator: Annotated[str, typer.Option(help="How images are combined.")] = "pooled",
    as_json: Annotated[bool, typer.Option("--json", help="Print the service's answer unchanged.")] = False,
) -> None:
    """Show the noise of a robot's joints by the scatter of repeated poses, and the repeatability it predicts."""
    with service.connect() as client:
        query = {"source": source, "estimator": estimator} | ({"at": at} if at else {})
        found = client.get(f"/v1/sessions/{find_session(client, session)['id']}/joint-noise", **query)
        if as_json:
            print_json(found)
        else:
            print_joint_noise(found)


def print_joint_noise(found: Json) -> None:
    """Print the joints' noise, how held-out poses compare, the predictions and the worst place."""
    console = output_console()
    table = Table(title="Noise of the joints", title_justify="left")
    for column in ("joint", "sigma °", "95 %"):
        table.add_column(column, justify="right")
    for joint in found["joint_noise"]:
        seen = joint["sigma_deg"] is not None
        interval = "{:.2g} to {:.2g}".format(*joint["interval_deg"]) if seen else "not observable"
        table.add_row(str(joint["joint"]), f"{joint['sigma_deg']:.2g}" if seen else "-", interval)
    console.print(table)
    held_out = found["scatter_validation"]
    console.print(
        f"held-out poses scatter {held_out['scatter_ratio']:.2f} times as predicted; log-likelihood "
        f"{held_out['log_likelihood_gain']:+.1f} ± {held_out['log_likelihood_gain_standard_error']:.1f} over one "
        "covariance for all poses"
    )
    for predicted in found["predictions"]:
        console.print(f"at {_angles(predicted)}: {_repeatability(predicted)}")
    worst = found["worst_place"]
    place = ", ".join(f"{value:.0f}" for value in worst["position_mm"])
    console.print(f"worst place ({place}) mm, at {_angles(worst)}: {_repeatability(worst)}")
    for warning in found["warnings"]:
        console.print(escape(f"{warning['detail']} {warning['advice'] or ''}".rstrip()))


def _angles(predicted: Json) -> str:
    return ", ".join(f"{angle:.1f}" for angle in predicted["joint_angles_deg"]) + "°"


def _repeatability(predicted: Json) -> str:
    low, high = predicted["interval_mm"]
    return f"RP_l {predicted['rp_l_mm']:.4f} mm ({low:.4f} to {high:.4f})"
