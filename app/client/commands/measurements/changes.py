"""`gridpose measurements correct`, `exclude`, `include`, `delete` and `retry`."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ..access import AdminAccess, UploadAccess, act_on_each
from ..console import fail

_SHOWN_BY = "gridpose measurements list SESSION"
One = Annotated[str, typer.Argument(help="Id of the measurement; `gridpose measurements list` shows it.")]
Several = Annotated[
    list[str], typer.Argument(help="Ids of measurements; `gridpose measurements list` shows them.")
]


def correct(
    measurement: One,
    service: UploadAccess,
    pose: Annotated[str | None, typer.Option(help="The pose the image was taken at.")] = None,
    cycle: Annotated[int | None, typer.Option(help="The visit to the pose; 0: not known.", min=0)] = None,
    burst: Annotated[
        int | None, typer.Option(help="Which image of its stop it is, from 1; 0: the first.", min=0)
    ] = None,
    focus_group: Annotated[str | None, typer.Option(help="Tag of images of one camera setting.")] = None,
    joint_angles: Annotated[
        str | None, typer.Option(help="Joint angles in degrees, comma-separated; an empty text: the pose's.")
    ] = None,
) -> None:
    """Correct the pose, cycle, burst index, focus group or joint angles of an image, in all of its measurements."""
    changes: dict[str, Any] = {}
    if pose is not None:
        changes["pose_id"] = pose
    if cycle is not None:
        changes["cycle"] = cycle or None
    if burst is not None:
        changes["burst"] = burst or None
    if focus_group is not None:
        changes["focus_group"] = focus_group
    if joint_angles is not None:
        try:
            angles = [float(part) for part in joint_angles.split(",")] if joint_angles.strip() else None
        except ValueError:
            fail("--joint-angles takes numbers separated by commas.", code=2)
        changes["joint_angles_deg"] = angles
    if not changes:
        fail(
            "Nothing is to be changed.",
            "Give --pose, --cycle, --burst, --focus-group or --joint-angles.",
            code=2,
        )
    _change([measurement], changes, "corrected", service)


def exclude(
    measurements: Several,
    reason: Annotated[str, typer.Option(help="Why; analyses repeat it.")],
    service: UploadAccess,
) -> None:
    """Exclude measurements from analyses, which list them with the reason."""
    _change(measurements, {"excluded": {"reason": reason}}, "excluded", service)


def include(
    measurements: Several,
    service: UploadAccess,
) -> None:
    """Let measurements count again that were excluded from analyses."""
    _change(measurements, {"excluded": None}, "included", service)


def delete(
    measurements: Several,
    service: AdminAccess,
) -> None:
    """Delete measurements with their results, and originals that no other measurement holds."""
    with service.connect() as client:

        def delete_one(measurement: str) -> None:
            client.delete(f"/v1/measurements/{measurement}")
            print(f"{measurement} deleted")

        act_on_each(measurements, delete_one, _SHOWN_BY)


def retry(
    measurements: Several,
    service: UploadAccess,
) -> None:
    """Compute measurements again; their results stay until others replace them."""
    with service.connect() as client:

        def retry_one(measurement: str) -> None:
            client.create(f"/v1/measurements/{measurement}/retry", {})
            print(f"{measurement} queued")

        act_on_each(measurements, retry_one, _SHOWN_BY)


def _change(measurements: list[str], changes: dict[str, Any], done: str, service: UploadAccess) -> None:
    with service.connect() as client:

        def change_one(measurement: str) -> None:
            changed = client.change(f"/v1/measurements/{measurement}", changes)
            siblings = ", ".join(changed["siblings"])
            of_image = f" (other measurements of the image: {siblings})" if siblings else ""
            print(f"{measurement} {done}{of_image}")

        act_on_each(measurements, change_one, _SHOWN_BY)
