"""What a report was made from and is not the same today, in words."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from app.analyses.inputs.snapshot_reader import EXCLUDED, FOREIGN
from app.records.codec import content_hash

Json = dict[str, Any]
NO_POINTS = content_hash(None, None)
"""The hash of a result without grid points and markers."""
_LISTED = 5
"""Values that are named of one input; of more it is said how many."""
_MAX_TEXT = 80
_OF_RESULT = ("failure_code", "failure_detail", "content_sha256", "labelling", "computed_by", "rms_px")
"""Fields of an image that say what was found in it; they have words of their own."""
_MOVES = ("pose_id", "cycle", "burst")
_ASSUMED: Mapping[str, Json] = {"session": {"camera_mount": "robot"}, "robot": {}}
"""What holds where the inputs do not state it."""
_NAMES = {
    "camera_mount": "camera mount",
    "focus_group": "focus group",
    "joint_angles_deg": "joint angles",
    "target_id": "target",
    "filename": "file name",
    "position_mm": "commanded position (mm)",
    "roll_deg": "commanded roll (°)",
    "pitch_deg": "commanded pitch angle (°)",
    "yaw_deg": "commanded yaw (°)",
}


def changed_inputs(then: Json, now: Json, statuses: Mapping[str, str]) -> Iterator[Json]:
    """Yield each input of a report that is not the same now, with what became of it.

    `statuses` are those of the session's measurements by id: one that waits to be measured anew has no result now.
    """
    for noun in ("session", "robot"):
        before, after = then[noun], now[noun]
        if before is None and after is None:
            continue
        name = str((before or after)["id"])
        if before is None or after is None or before["id"] != after["id"]:
            yield changed_input(noun, name, _replacement(before, after))
        elif parts := list(_differences(_ASSUMED[noun] | before, _ASSUMED[noun] | after)):
            yield changed_input(noun, name, f"changed: {_listed(parts)}")
    yield from _changed_list(
        "target", then["targets"], now["targets"], "id", "no target of the session any more"
    )
    yield from _changed_list(
        "pose", then["poses"], now["poses"], "pose_id", "no measurement is of it any more"
    )
    yield from _changed_images(then["images"], now["images"], statuses)
    yield from _changed_list(
        "measured_pose", then["measured_poses"], now["measured_poses"], "measurement_id", "deleted"
    )


def changed_input(noun: str, name: str, detail: str) -> Json:
    """Return a changed input as verifications name it."""
    return {"noun": noun, "name": name, "detail": detail}


def points_of(before: str | None, after: str | None) -> str:
    """Return in words what one hash of grid points is to another."""
    if before == after:
        return "the same grid points"
    return "no grid points" if after in (None, NO_POINTS) else "other grid points"


def _replacement(before: Json | None, after: Json | None) -> str:
    if before is None:
        return "added"
    return "removed from the session" if after is None else f"replaced by {after['id']}"


def _changed_list(
    noun: str, then: Sequence[Json], now: Sequence[Json], key: str, gone: str
) -> Iterator[Json]:
    present = {one[key]: one for one in now}
    for before in then:
        after = present.pop(before[key], None)
        if after is None:
            yield changed_input(noun, before[key], gone)
        elif parts := list(_differences(before, after)):
            yield changed_input(noun, before[key], f"changed: {_listed(parts)}")
    for name in present:
        yield changed_input(noun, name, "added")


def _changed_images(then: Sequence[Json], now: Sequence[Json], statuses: Mapping[str, str]) -> Iterator[Json]:
    present = {one["measurement_id"]: one for one in now}
    for before in then:
        name = before["measurement_id"]
        after = present.pop(name, None)
        if after is None:
            gone = f"without a result now: {statuses[name]}" if name in statuses else "deleted"
            yield changed_input("image", name, gone)
        elif parts := list(_image_changes(before, after)):
            yield changed_input("image", name, "; ".join(parts))
    for name in present:
        yield changed_input("image", name, "added")


def _image_changes(before: Json, after: Json) -> Iterator[str]:
    """Yield what became of one image: exclusion, place in the session, labels, and what was found in it."""
    codes = before["failure_code"], after["failure_code"]
    if after["failure_code"] == EXCLUDED:
        reason = after["failure_detail"]
        if before["failure_code"] != EXCLUDED or before.get("failure_detail", reason) != reason:
            yield f"excluded: {reason}"
    elif before["failure_code"] == EXCLUDED:
        reason = before.get("failure_detail")
        yield f"included again; it was excluded: {reason}" if reason else "included again"
    elif FOREIGN in codes and codes[0] != codes[1]:
        yield (
            "its target is no target of the session any more"
            if codes[1] == FOREIGN
            else "its target is one of the session's now"
        )
    else:
        yield from _result_changes(before, after)
    if any(before.get(name) != after.get(name) for name in _MOVES):
        yield f"moved from {_place(before)} to {_place(after)}"
    hidden = {*_OF_RESULT, *_MOVES, *({"target_id"} if FOREIGN in codes else ())}
    yield from _differences(before, after, hidden)


def _result_changes(before: Json, after: Json) -> Iterator[str]:
    """Yield what is found in an image that counted then as now."""
    contents = before["content_sha256"], after["content_sha256"]
    if contents[0] != contents[1] or before["computed_by"] != after["computed_by"]:
        by = f" by {after['computed_by']}" if after["computed_by"] is not None else ""
        yield f"measured again{by}, to {points_of(*contents)}"
    if before["failure_code"] != after["failure_code"]:
        code = after["failure_code"]
        yield "no longer refused" if code is None else f"refused: {code}"


def _place(image: Json) -> str:
    parts = [str(image["pose_id"])]
    parts += [f"{name} {image[name]}" for name in ("cycle", "burst") if image.get(name) is not None]
    return " ".join(parts) if len(parts) > 1 else f"{parts[0]} without a cycle"


def _differences(before: Any, after: Any, hidden: Collection[str] = (), path: str = "") -> Iterator[str]:
    """Yield each value that is another one, by its place; what only one of two builds states is no difference."""
    if isinstance(before, dict) and isinstance(after, dict):
        for name in {**before, **after}:
            if name in hidden or (not path and not (name in before and name in after)):
                continue
            inner = _NAMES.get(name, name)
            inner = f"{path}.{inner}" if path else inner
            yield from _differences(before.get(name), after.get(name), (), inner)
        return
    if _is_nested(before) and _is_nested(after) and len(before) == len(after):
        for place, (one, other) in enumerate(zip(before, after, strict=True)):
            yield from _differences(one, other, (), f"{path}[{place}]")
        return
    if before != after:
        yield f"{path} from {_text(before)} to {_text(after)}"


def _is_nested(value: Any) -> bool:
    return isinstance(value, list) and any(isinstance(item, dict | list) for item in value)


def _listed(parts: Sequence[str]) -> str:
    more = f"; and {len(parts) - _LISTED} more" if len(parts) > _LISTED else ""
    return "; ".join(parts[:_LISTED]) + more


def _text(value: Any) -> str:
    """Return a value as it is written in a sentence; of a long one, its beginning."""
    if value is None:
        return "nothing"
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= _MAX_TEXT else f"{text[: _MAX_TEXT - 1]}…"
