"""Take the screenshots of docs/dashboard.md.

A rendered session goes through the real service; Debian's Chromium shows its pages. All pages, in light, dark and at
a phone's width, go to build/screenshots, to be looked at; those that the document shows into docs/figures/dashboard.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from app.cli.demo.service_process import ServiceProcess
from app.cli.demo.session import joint_rows
from app.client import ServiceClient
from core.simulation import KR5_ARC
from tests.support.contract.cell import TARGET, CellImage, take_images

PROJECT = Path(__file__).parents[2]
ALL = PROJECT / "build" / "screenshots"
SHOWN = Path(__file__).parent / "dashboard"
IN_THE_DOCUMENT = ("session", "repeatability", "image")
LOOKS = {"light": (1280, "light"), "dark": (1280, "dark"), "phone": (390, "light")}
POSES, REPEATED, CYCLES = 28, 4, 12
"""As many as identify the robot, a few of them repeated."""
WEEKS, CYCLES_A_WEEK = 6, 6
"""Earlier sessions of the robot, as many as a control chart takes."""
WITHIN_MS = 120_000
"""The first drawing of each kind starts a process that loads the numerics."""
SHOWN_WHOLE = """[...document.images].every((one) => {
  one.loading = "eager";
  return one.complete && one.naturalWidth > 0 || !one.checkVisibility();
}) && !document.querySelector("[data-headline], [aria-busy=true]")"""
"""Every image has come, those below the window's edge, too, and every headline: the screenshot is of the whole page."""


def fill(client: ServiceClient) -> dict[str, str]:
    """Store a robot, a target and a session with rendered images; return the pages to show, by name."""
    target = client.create("/v1/targets", TARGET)["id"]
    robot = client.create(
        "/v1/robots",
        {
            **{"name": "KR 5 arc, cell 4", "manufacturer": "KUKA", "model": "KR 5 arc"},
            **{"joints": joint_rows(KR5_ARC)},
            **{"datasheet_repeatability_mm": 0.1, "datasheet_accuracy_mm": 0.6},
        },
    )["id"]
    conditions = {"temperature_c": 21.5, "load_kg": 2.0, "speed_percent": 100.0, "operator": "M. Ito"}
    fields = {"target_ids": [target], "robot_id": robot, "conditions": conditions}
    earlier = file_weeks(client, robot, fields)
    session = client.create("/v1/sessions", {"name": f"Cell 4, week {WEEKS + 1}", **fields})["id"]
    images = take_images(POSES, repeated=REPEATED, cycles=CYCLES)
    measure(client, session, images, datetime.now(UTC) - timedelta(minutes=30))
    report = report_on(client, session)
    measured = client.get(f"/v1/sessions/{session}/measurements")["items"][0]["id"]
    here = f"/ui/sessions/{session}"
    return {
        **{"start": "/ui/", "session": here, "image": f"/ui/measurements/{measured}"},
        **{
            name: f"{here}/{name}"
            for name in (
                "repeatability",
                "camera",
                "robot",
                "comparison",
                "reports",
                "upload",
                "poses",
                "error-map",
                "joint-noise",
            )
        },
        "next-view": f"{here}/next-view",
        **{f"next-view-{name}": f"{here}/next-view?purpose={name}" for name in ("hand_eye", "dh")},
        "history": f"/ui/robots/{robot}/history",
        "report-comparison": f"/ui/reports/comparison?report={earlier[0]}&report={earlier[-1]}",
        **{"all-reports": "/ui/reports", "report": f"/ui/reports/{report}"},
        **{"new-session": "/ui/sessions/new", "robots": "/ui/robots", "robot-sheet": f"/ui/robots/{robot}"},
        "plan-iso9283": f"/ui/plans/iso9283?target={target}&side_mm=100&focal_length_mm=8&limit_mm=0.1",
        "plan-robot": f"/ui/robots/{robot}/plan?target={target}&home=0,-65,75,10,55,0",
        **{"targets": "/ui/targets", "target": f"/ui/targets/{target}", "design": "/ui/targets/new"},
        **{name: f"/ui/{name}" for name in ("keys", "audit", "system")},
    }


def file_weeks(client: ServiceClient, robot: str, fields: dict[str, Any]) -> list[str]:
    """Measure the same poses week by week, something done to the robot midway; return the reports."""
    images = take_images(2, repeated=2, cycles=WEEKS * CYCLES_A_WEEK)
    reports = []
    for week in range(WEEKS):
        if week == WEEKS // 2:
            at = datetime.now(UTC) - timedelta(weeks=WEEKS - week, days=3)
            event = {"at": at.isoformat(), "note": "Belt of joint 5 replaced"}
            client.create(f"/v1/robots/{robot}/events", {**event, "restarts_charts": False})
        session = client.create("/v1/sessions", {"name": f"Cell 4, week {week + 1}", **fields})["id"]
        first = week * CYCLES_A_WEEK
        taken = [one for one in images if first < one.cycle <= first + CYCLES_A_WEEK]
        measure(client, session, taken, datetime.now(UTC) - timedelta(weeks=WEEKS - week))
        reports.append(report_on(client, session))
    return reports


def measure(client: ServiceClient, session: str, images: list[CellImage], begun: datetime) -> None:
    """Send images with their commanded poses, taken every ten seconds, and wait until all are computed."""
    for number, image in enumerate(images):
        client.put(f"/v1/sessions/{session}/poses/{image.pose_id}", image.commanded)
        send(client, session, image, begun + timedelta(seconds=10 * number))
    while any(client.get(f"/v1/sessions/{session}")["counts"][one] for one in ("queued", "running")):
        time.sleep(0.2)


def report_on(client: ServiceClient, session: str) -> str:
    """Order a session's report on repeatability and wait until it is made."""
    report: str = client.create(f"/v1/sessions/{session}/reports", {"kind": "repeatability"})["id"]
    while client.get(f"/v1/reports/{report}")["status"] in ("queued", "running"):
        time.sleep(0.2)
    return report


def send(client: ServiceClient, session: str, image: CellImage, taken: datetime) -> None:
    """Upload one image."""
    named = {"cycle": image.cycle, "filename": image.filename, "captured_at": taken.isoformat()}
    client.put_image(session, image.pose_id, image.sha256, image.data, **named)


def sign_in(page: Any, key: str) -> None:
    page.goto("/ui/sign-in")
    page.fill("#key", key)
    page.press("#key", "Enter")
    page.wait_for_url("**/ui/")


def shoot(page: Any, path: str, file: Path, *, whole: bool) -> None:
    """Show a page until nothing more comes, opened wide, and take its screenshot."""
    page.goto(path, wait_until="domcontentloaded")
    page.wait_for_selector("#theme:not([hidden])")
    page.wait_for_timeout(500)
    if path.endswith("/robot"):
        page.wait_for_selector("#main .refusal, #dh-title", timeout=WITHIN_MS)
    ends = time.monotonic() + WITHIN_MS / 1e3
    while not page.evaluate(SHOWN_WHOLE):  # the policy of the pages lets no waiting function in
        if time.monotonic() > ends:
            raise SystemExit(f"{path}: images do not come")
        page.wait_for_timeout(250)
    if "/repeatability" in path:
        page.wait_for_selector("#scatter[data-ready=yes]", timeout=WITHIN_MS)
    if "/measurements/" in path:
        page.wait_for_selector("#viewer[data-ready=yes]", timeout=WITHIN_MS)
    if "/ui/sessions/ses_" in path:
        page.wait_for_timeout(1500)
    page.screenshot(path=file, full_page=whole)


def shrink(file: Path) -> None:
    """Keep 256 colours of a screenshot, the rare ones of states among them: it takes a third of the room."""
    with Image.open(file) as screenshot:
        found = screenshot.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE)
    found.save(file, optimize=True)


def main() -> None:
    """Take all screenshots."""
    chromium = os.environ.get("GRIDPOSE_TEST_CHROMIUM") or shutil.which("chromium")
    if chromium is None:
        raise SystemExit("Chromium is needed: apt-get install chromium")
    ALL.mkdir(parents=True, exist_ok=True)
    SHOWN.mkdir(exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        sync_playwright() as playwright,
        ServiceProcess(Path(folder) / "data", {"GRIDPOSE_WORKERS": "2"}) as service,
    ):
        assert service.admin_key is not None
        with ServiceClient(service.url, service.admin_key) as client:
            pages = fill(client)
        flags = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=chromium, args=flags)
        for look, (width, scheme) in LOOKS.items():
            context = browser.new_context(
                base_url=service.url, viewport={"width": width, "height": 860}, color_scheme=scheme
            )
            page = context.new_page()
            page.set_default_timeout(WITHIN_MS)
            sign_in(page, service.admin_key)
            for name, path in pages.items():
                shoot(page, path, ALL / f"{name}-{look}.png", whole=True)
                if look == "light" and name in IN_THE_DOCUMENT:
                    page.screenshot(path=SHOWN / f"{name}.png")
                    shrink(SHOWN / f"{name}.png")
            context.close()
        browser.close()


if __name__ == "__main__":
    main()
