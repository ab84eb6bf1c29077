"""Sections that every report begins and ends with: what it is about, under which conditions, made from what."""

from __future__ import annotations

from datetime import date, datetime
from typing import Any

from app.records.ids import moment_of
from app.reports.forms.blocks import Block, facts, heading, paragraph
from app.reports.forms.wording import Json, words

_PITCHES = (("x", "pitch_x_mm"), ("y", "pitch_y_mm"))


def opening_blocks(document: Json) -> list[Block]:
    """Return what was measured, with what, and under which conditions."""
    inputs, subject = document["inputs"], document["subject"]
    robot, conditions = inputs["robot"], subject["conditions"] or {}
    rows: list[tuple[str, Any]] = [("session", subject["session"]["name"])]
    if robot is not None:
        rows += [
            ("robot", robot["name"]),
            ("manufacturer, model", _joined(robot["manufacturer"], robot["model"])),
            ("serial number", robot["serial_number"]),
        ]
    rows += [
        ("measured", _measured(document)),
        ("poses from", _source(document)),
        ("qualification", _qualified(subject.get("qualification"), document["made_at"])),
    ]
    stated = [
        ("load", _with_unit(conditions.get("load_kg"), "kg")),
        ("speed", _with_unit(conditions.get("speed_percent"), "%")),
        ("temperature", _with_unit(conditions.get("temperature_c"), "°C")),
        ("warm-up", _with_unit(conditions.get("warm_up_min"), "min")),
        ("operator", conditions.get("operator")),
        ("notes", conditions.get("notes")),
    ]
    return [
        heading("Subject"),
        facts(rows),
        heading("Conditions"),
        facts(stated),
        *_targets(
            inputs["targets"] if document["source"] == "images" else (), conditions.get("temperature_c")
        ),
    ]


def _source(document: Json) -> str:
    if document["source"] != "images":
        return "another instrument"
    is_fixed = document["subject"].get("camera_mount") == "fixed"
    return "images of a fixed camera, the target on the robot" if is_fixed else "images"


def closing_blocks(document: Json) -> list[Block]:
    """Return what the report was made from, by whom and how it is verified, and the lines to sign."""
    inputs, maker = document["inputs"], document["made_by"]
    sources = [
        f"{len(inputs['images'])} images" if inputs["images"] else "",
        f"{len(inputs['measured_poses'])} poses of another instrument" if inputs["measured_poses"] else "",
    ]
    rows = [
        ("report", document["report_id"]),
        ("made", _moment(document["made_at"])),
        ("made by", maker["name"] if maker is not None else "the service, without a key"),
        ("software", f"Gridpose {document['core_version']}"),
        ("made from", ", ".join(filter(None, sources)) or "nothing"),
        ("hash of all inputs", document["inputs_sha256"]),
        ("signing key", document["signing_key"]),
    ]
    return [
        heading("Provenance"),
        facts(rows),
        paragraph(
            "The figures hold for what was measured, at these poses and under these conditions. Every figure is from "
            "stored values. The attached report.json (the form JSON of this report) has all "
            "figures in full and names every image by its SHA-256. The detached signature covers the hash of each "
            "form. The command “gridpose report verify FILE” checks a file; with this report's id in place of FILE it "
            "computes all figures again from the originals."
        ),
        {"block": "signatures", "rows": [dict(one) for one in document["signatories"]]},
    ]


def _targets(targets: Any, temperature_c: float | None) -> list[Block]:
    blocks: list[Block] = []
    for target in targets:
        certificate, u = target["certificate"], target["pitch_standard_uncertainty_mm"]
        rows: list[tuple[str, Any]] = [
            ("name", target["name"]),
            ("kind", f"{words(target['kind'])}, {target['columns']} × {target['rows']} grid points"),
            ("pitch", f"{target['pitch_mm']:g} mm" + (f", u = {u:g} mm" if u is not None else "")),
            ("print", target["print_kind"] and words(target["print_kind"])),
        ]
        if certificate is not None:
            rows += [
                ("certificate", _joined(certificate.get("number"), certificate.get("laboratory"))),
                ("certificate of", certificate.get("issued_on")),
                *_certified(certificate, temperature_c),
            ]
        elif u is None:
            rows.append(("traceability", "none stated: absolute lengths take the pitch as exact"))
        blocks += [heading(f"Target {target['name']}"), facts(rows)]
    return blocks


def _certified(certificate: Json, temperature_c: float | None) -> list[tuple[str, Any]]:
    """Return the lengths that a target's certificate states, with their standard uncertainties, and where they hold."""
    rows: list[tuple[str, Any]] = []
    points, u = certificate.get("points_mm"), certificate.get("standard_uncertainty")
    if points is not None:
        along = certificate["points_standard_uncertainty_mm"]
        rows.append(("certified points", f"{len(points)}, u = {along:g} mm along each axis"))
    elif certificate.get("pitch_x_mm") is not None and u is not None:
        pitches = (f"{axis} {certificate[name]:.9g} mm, u = {u[name]:g} mm" for axis, name in _PITCHES)
        rows.append(("certified pitch", "; ".join(pitches)))
        rows.append(
            (
                "certified squareness",
                f"{certificate.get('squareness_mrad') or 0.0:g} mrad, u = {u['squareness_mrad']:g} mrad",
            )
        )
    if certificate.get("temperature_c") is not None:
        where = f"{certificate['temperature_c']:g} °C, {certificate['expansion_per_k']:g} a kelvin"
        taken = "not taken to another" if temperature_c is None else f"taken to {temperature_c:g} °C"
        rows.append(("certified at", f"{where}; {taken}"))
    return rows


def _qualified(cited: Json | None, made_at: str) -> str:
    """Return what the latest qualification by known lengths says at the time of the report."""
    if cited is None:
        return "none"
    made, due = cited["made_at"][:10], cited["due_at"][:10]
    if cited["decision"] == "fail":
        return f"failed on {made}"
    if datetime.fromisoformat(cited["due_at"]) <= datetime.fromisoformat(made_at):
        return f"due since {due}: the last one was on {made}"
    decided = {"pass": "qualified", "inconclusive": "not decided, holds"}.get(
        cited["decision"] or "", "measured without a limit, holds"
    )
    return f"{decided} until {due}, by that of {made}"


def _joined(*parts: str | None) -> str | None:
    return ", ".join(part for part in parts if part) or None


def _with_unit(value: float | None, unit: str) -> str | None:
    return None if value is None else f"{value:g} {unit}"


def measuring_days(document: Json) -> tuple[date, date]:
    """Return the first and the last day of measuring: those stated, else those on which measurements arrived.

    Of readings, and of images in reports that do not state it, that is the day of their ids.
    """
    subject, inputs = document["subject"], document["inputs"]
    if subject["first_captured_at"] is not None:
        days = [datetime.fromisoformat(subject[f"{end}_captured_at"]).date() for end in ("first", "last")]
    else:
        days = [
            datetime.fromisoformat(came).date()
            if (came := one.get("received_at"))
            else moment_of(one["measurement_id"]).date()
            for one in (*inputs["images"], *inputs["measured_poses"])
        ]
    return min(days), max(days)


def _measured(document: Json) -> str:
    first, last = (document["subject"][f"{end}_captured_at"] for end in ("first", "last"))
    if first is None:
        days = dict.fromkeys(day.isoformat() for day in measuring_days(document))
        return f"not stated; measurements arrived {' to '.join(days)}"
    return _moment(first) if first == last else f"{_moment(first)} to {_moment(last)}"


def _moment(text: str) -> str:
    return f"{text[:10]} {text[11:16]} UTC"
