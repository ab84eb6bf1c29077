"""Results of kinematics and camera reports as quantities: identified parameters, joint by joint, lens by lens."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from app.records.numbers import DH_PARAMETERS
from app.reports.forms.camera import camera_blocks, estimated_terms
from app.reports.forms.certificate.elements import figure, result, sections
from app.reports.forms.kinematics import kinematics_blocks
from app.reports.forms.wording import Json, words

_SYMBOLS = {"a_mm": "a", "alpha_deg": "α", "d_mm": "d", "theta_offset_deg": "θ₀", "beta_deg": "β"}


def kinematics_results(found: Json, inputs: Json) -> list[Element]:
    """Return the results, without parameters that the poses do not determine; `found` is the analysis `dh`."""
    results: list[Element] = []
    for joint in found["joints"]:
        quantities: list[Element] = []
        for name in DH_PARAMETERS:
            u = joint["standard_uncertainty"][name]
            if u is None:
                continue
            quantities += figure(f"{_SYMBOLS[name]}, identified", name, joint[name], u=u)
            nominal = (joint["nominal"] or {}).get(name)
            quantities += figure(f"{_SYMBOLS[name]}, nominal", f"nominal.{name}", nominal)
        results += result(f"Joint {joint['joint']}", quantities)
    for name, one in (("Residual", found["residual"]), ("Errors at held-out poses", found["validation"])):
        if one is not None:
            quantities = figure("Position, root mean square", "position_rms_mm", one["position_rms_mm"])
            quantities += figure(
                "Rotation, root mean square", "rotation_rms_deg", one.get("rotation_rms_deg")
            )
            results += result(name, quantities)
    return [
        *results,
        *sections(kinematics_blocks(found, inputs), ("Identifiability", "Excluded", "Warnings")),
    ]


def camera_results(found: Json, inputs: Json) -> list[Element]:
    """Return the results; `found` is the analysis `intrinsics`. Pixels are counts: their unit is one."""
    results: list[Element] = []
    for group in found["groups"]:
        uncertainties = group["standard_uncertainty"]
        quantities = [
            quantity
            for name, value in estimated_terms(group)
            for quantity in figure(_named(name), name, value, u=uncertainties.get(name) or None)
        ]
        quantities += figure("Images", "image_count", group["image_count"])
        quantities += figure("Reduced χ²", "reduced_chi2", group["reduced_chi2"])
        model = f"Lens model: {words(group['lens_model'])}"
        results += result(f"Camera of focus group {group['focus_group']}", quantities, model)
    return [
        *results,
        *sections(camera_blocks(found, inputs), ("Shape of the target", "Excluded", "Warnings")),
    ]


def _named(name: str) -> str:
    return f"{name.removesuffix('_px')}, pixels" if name.endswith("_px") else name
