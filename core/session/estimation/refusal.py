"""What is said where no image serves an analysis: the reasons by their number, advice for the commonest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from core.errors import GridposeError, NothingUsable

_OF_SESSION = {
    "target_mismatch": "The images show another grid than the session's target. Check columns and rows, which count "
    "inner corners; give the session the target that they show (PATCH `target_ids`, "
    "`gridpose sessions change --target`).",
    "target_not_in_session": "Add the target that these images were measured for to the session's target_ids (PATCH "
    "`target_ids`, `gridpose sessions change --target`).",
    "target_not_found": "Look at the overlays. Show the whole grid, sharp and evenly lit; if the images do, the "
    "session's target may be another one (PATCH `target_ids`, `gridpose sessions change --target`).",
    "excluded_by_user": "Let measurements count again (PATCH `excluded: null`, `gridpose measurements include`), or "
    "upload others.",
}
"""Advice for all images of a session, where it differs from what is said of one."""


def refusal_of_all(images: int, reasons: Mapping[str, int]) -> NothingUsable:
    """Return the refusal of a session of so many images, with the number of those excluded for each code."""
    found = ", ".join(f"{code} ({count})" for code, count in sorted(reasons.items()))
    commonest = min(reasons, key=lambda code: (-reasons[code], code), default="")
    advice = _OF_SESSION.get(commonest) or dict(_advice_by_code(GridposeError)).get(commonest)
    return NothingUsable(f"None of the {images} images serves this analysis: {found}.", advice)


def _advice_by_code(kind: type[GridposeError]) -> Iterator[tuple[str, str]]:
    for one in kind.__subclasses__():
        if one.default_advice is not None:
            yield one.code, one.default_advice
        yield from _advice_by_code(one)
