"""The verification of a report, as a request to the service asks for it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from app.analyses.reporting.orders import VerificationOrder, compute_verification

if TYPE_CHECKING:
    from app.analyses.service import AnalysisService
    from app.services.installation.context import ServiceContext


async def verification(
    installation: ServiceContext,
    analyses: AnalysisService,
    requester: str | None,
    report_id: str,
    *,
    with_originals: bool,
) -> dict[str, Any]:
    """Return what comes of comparing a report with its inputs, computed in a process of the analyses.

    Equal questions share one computation. Raises as `AnalysisService.run` and `verify_report` do.
    """
    settings = installation.settings
    order = VerificationOrder(
        report_id=report_id,
        with_originals=with_originals,
        blob_url=settings.blob_url,
        folder=str(settings.data_dir / "originals"),
        max_image_pixels=settings.max_image_pixels,
    )
    url = installation.database.url.render_as_string(hide_password=False)
    question = ("verify", report_id, with_originals)
    found: dict[str, Any] = await analyses.run(question, requester, compute_verification, url, order)
    return found
